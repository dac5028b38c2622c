"""The estimation problem: lower ≤ r ≤ upper minimising φ(r), with f(r) from Kirchhoff's law eliminated in closed form.

What every solver shares: the data of a solve, the cost at a point with its derivatives, and the test of optimality.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.cost.cost import Compiled, Cost
from lampest.panel.network import Network, grounding
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Data:
    """What one solve is given.

    measured : (frames, rows, columns) ohm, series resistance taken off.
    sigma : same shape, ohm; ones where unknown.
    lower, upper : same shape, ohm; bounds of the cell resistance.
    previous : (rows, columns) ohm, the known r0, or None.
    baseline : (rows, columns) ohm, the known cells of the unloaded panel; None where they are the previous ones.
    previous_deviation : (rows, columns), standard deviation of log r0; None where no term reads it.
    marks : side and seen of the readings (frames, rows, columns), as `Readings` has them; None: all are values.
    """

    measured: Array
    sigma: Array
    lower: Array
    upper: Array
    previous: Array | None = None
    marks: tuple[Array, Array] | None = None
    baseline: Array | None = None
    previous_deviation: Array | None = None

    @property
    def resistance_scale(self) -> float:
        """Geometric mean of the measured resistances, ohm."""
        return float(np.exp(np.mean(np.log(self.measured))))

    @cached_property
    def log_bounds(self) -> tuple[Array, Array]:
        """Logarithms of the bounds."""
        return np.log(self.lower), np.log(self.upper)

    @cached_property
    def ties(self) -> Array:
        """(frames, rows + columns) siemens: each frame's tie to ground."""
        return np.stack([grounding(measured) for measured in self.measured])

    def network(self, frame: int, cell_resistance: Array) -> Network:
        """The solved network of one frame's cells (rows, columns) ohm."""
        return Network.solve(1 / cell_resistance, self.ties[frame])

    @cached_property
    def parameters(self) -> tuple[Array, ...]:
        """Measured, σ (frames · cells), previous, baseline (cells; ones where unknown) ohm; deviation; marks; flat."""
        previous = np.ones(self.measured[0].size) if self.previous is None else self.previous.ravel()
        baseline = previous if self.baseline is None else self.baseline.ravel()
        deviation = np.zeros_like(previous) if self.previous_deviation is None else self.previous_deviation.ravel()
        marks = () if self.marks is None else tuple(mark.ravel() for mark in self.marks)
        return self.measured.ravel(), self.sigma.ravel(), previous, baseline, deviation, *marks


@dataclass(frozen=True, eq=False)
class Evaluation:
    """φ and its derivatives at one point: cell and two-point resistance (frames, rows, columns) ohm."""

    cost: Cost
    data: Data
    cell_resistance: Array
    two_point_resistance: Array
    networks: tuple[Network, ...]

    @classmethod
    def at(cls, cost: Cost, data: Data, cell_resistance: Array) -> "Evaluation":
        """Solve the networks of a cell resistance (frames, rows, columns) ohm."""
        networks = tuple(data.network(frame, cells) for frame, cells in enumerate(cell_resistance))
        two_point = np.stack([network.two_point_resistance() for network in networks])
        return cls(cost, data, cell_resistance, two_point, networks)

    def call(self, function: Compiled, dual: Array) -> Array:
        """One of the cost's functions at this point."""
        return self._called(function, self.two_point_resistance, dual)

    def _called(self, function: Compiled, two_point_resistance: Array, dual: Array) -> Array:
        given = (*self.data.parameters, self.cost.weights)
        return function(self.cell_resistance.ravel(), two_point_resistance.ravel(), *given, dual)

    @cached_property
    def costs(self) -> Array:
        """weight · loss of each term, summed over frames, in the order of the terms."""
        return self.call(self.cost.functions.costs, self._no_dual)

    @property
    def objective(self) -> float:
        """φ."""
        return float(self.costs.sum())

    @property
    def _no_dual(self) -> Array:
        return np.zeros(len(self.cost.slope))

    def partials(self, dual: Array) -> tuple[Array, Array]:
        """(∂φ/∂r at fixed R, ∂φ/∂R), each (frames, rows, columns)."""
        direct, through = np.split(self.call(self.cost.functions.gradient, dual), 2)
        shape = self.cell_resistance.shape
        return direct.reshape(shape), through.reshape(shape)

    def log_gradient(self, dual: Array) -> Array:
        """∂φ/∂log r, (frames, rows, columns): r·∂φ/∂r − g·(∂R/∂g)ᵀ ∂φ/∂R, in product form."""
        direct, through = self.partials(dual)
        gradient: Array = direct * self.cell_resistance
        for frame, network in enumerate(self.networks):
            gradient[frame] -= network.conductance * network.conductance_product(through[frame])
        return gradient

    @cached_property
    def cost_scale(self) -> float:
        """φ with the terms at f(r) = 0 for one cell, plus φ here: the size against which a gradient is small."""
        blank = self._called(self.cost.functions.costs, np.zeros(self.cell_resistance.shape), self._no_dual)
        return (float(blank.sum()) / self.cell_resistance.size + self.objective) or 1.0

    @cached_property
    def rough(self) -> Array:
        """Residuals x with an absolute loss."""
        return self.call(self.cost.functions.rough, self._no_dual)

    def dual_gap(self, dual: Array) -> float:
        """Σ weight·(|x| − z·x) of the absolute losses: zero where z is a subgradient."""
        return float(np.sum(self.cost.slope * (np.abs(self.rough) - dual * self.rough)))

    def kkt_residual(self, dual: Array) -> float:
        """max |u − Π(u − ∇φ/s)| over u = log r, Π onto the bounds, s = `cost_scale`; with the dual gap φ/s added.

        Zero exactly at a point that satisfies the first-order optimality conditions. The duals of absolute losses
        come from the solver and are held to |z| ≤ 1 here.
        """
        dual = np.clip(dual, -1, 1)
        gap = self.dual_gap(dual) / self.cost_scale if len(dual) else 0.0
        return self.projected_gradient(self.log_gradient(dual)) + gap

    def projected_gradient(self, log_gradient: Array) -> float:
        """max |u − Π(u − ∇φ/s)| for a gradient that is known already."""
        position = np.log(self.cell_resistance)
        target = np.clip(position - log_gradient / self.cost_scale, *self.data.log_bounds)
        return float(np.max(np.abs(position - target)))
