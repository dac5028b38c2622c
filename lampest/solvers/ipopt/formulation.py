"""How readings follow from cell resistance inside an optimisation problem."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import casadi

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout


@dataclass(frozen=True, eq=False)
class NetworkSymbols:
    """Decision variables and equations of one network.

    potentials : (n, 1) node voltages for unit currents.
    balance : (n, 1) Kirchhoff's current law; zero at a solution, bilinear in conductances and potentials.
    reading : (cells, 1) row-major, in the readout's unit.
    """

    potentials: casadi.SX
    balance: casadi.SX
    reading: casadi.SX


class Formulation(ABC):
    """Node voltages as decision variables, Kirchhoff's current law as constraints."""

    @abstractmethod
    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Variables and equations for a (rows, columns) conductance and (rows + columns, 1) ties to ground.

        Conductances and ties are in 1/`scale`, potentials for unit currents in units of `scale`, an ohm.
        """

    @abstractmethod
    def potentials(self, readout: Readout, network: Network) -> Array:
        """The values of `NetworkSymbols.potentials` in a solved network, in ohm; the start of a solver."""

    @abstractmethod
    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """λ of `NetworkSymbols.balance` in a solved network: ∂φ/∂V + λᵀ ∂balance/∂V = 0 for slope = ∂φ/∂V, 1/ohm.

        tie : (lines) siemens. V : `potentials`. Raises numpy.linalg.LinAlgError where digits do not suffice.
        """

    def check(self, readout: Readout) -> None:  # noqa: B027 - unless a formulation says otherwise it knows them all
        """Raise InputError where the formulation cannot say what the readout reads."""
