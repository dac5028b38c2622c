"""How two-point resistance follows from cell resistance inside an optimisation problem."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import casadi

from lampest.panel.network import Network
from lampest.panel.panel import Array, Panel


@dataclass(frozen=True, eq=False)
class NetworkSymbols:
    """Decision variables and equations of one network.

    potentials : (n, 1) node voltages for unit currents.
    balance : (n, 1) Kirchhoff's current law; zero at a solution, bilinear in conductances and potentials.
    two_point_resistance : (cells, 1) row-major, linear in the potentials.
    """

    potentials: casadi.SX
    balance: casadi.SX
    two_point_resistance: casadi.SX


class Formulation(ABC):
    """Node voltages as decision variables, Kirchhoff's current law as constraints."""

    @abstractmethod
    def network(self, panel: Panel, conductance: casadi.SX, tie: casadi.SX, prefix: str) -> NetworkSymbols:
        """Variables and equations for a (rows, columns) conductance and a (rows + columns, 1) tie to ground."""

    @abstractmethod
    def potentials(self, network: Network) -> Array:
        """The values of `NetworkSymbols.potentials` in a solved network; the start of a solver."""
