"""The estimation problem: cost terms over one frame, or over a baseline and its first frame jointly.

φ(r) = Σ_terms weight · loss(residual), lower ≤ r ≤ upper, with f(r) from Kirchhoff's law. This module holds what every
solver shares: the data of a solve, the cost with its derivatives, and the test of optimality outside any solver.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi
import numpy as np

from lampest.kirchhoff import Network, grounding
from lampest.panel import Array, Panel
from lampest.terms.losses import Absolute
from lampest.terms.term import State, Term


@dataclass(frozen=True, eq=False)
class Data:
    """What one solve is given.

    measured : (frames, rows, columns) ohm, series resistance taken off.
    sigma : same shape, ohm; ones where unknown.
    lower, upper : same shape, ohm; bounds of the cell resistance.
    previous : (rows, columns) ohm, the known r0, or None.
    """

    measured: Array
    sigma: Array
    lower: Array
    upper: Array
    previous: Array | None = None

    @property
    def resistance_scale(self) -> float:
        """Geometric mean of the measured resistances, ohm."""
        return float(np.exp(np.mean(np.log(self.measured))))


@dataclass(frozen=True)
class Cost:
    """φ over `frames` frames of a panel, built once and evaluated for any data.

    With two frames the first is the previous frame of the second; terms that need a previous frame skip the first.
    An absolute loss enters derivatives through its dual variables z, |z| ≤ 1: weight · Σ z·x.
    """

    panel: Panel
    terms: tuple[Term, ...]
    frames: int = 1

    @property
    def needs_previous(self) -> bool:
        """Whether a single frame needs a known previous one."""
        return self.frames == 1 and any(term.needs_previous for term in self.terms)

    def residuals(
        self, cells: casadi.SX, two_point: casadi.SX, measured: casadi.SX, sigma: casadi.SX, previous: casadi.SX
    ) -> list[tuple[Term, casadi.SX]]:
        """(term, residual) pairs; arguments are (cells, frames) in ohm, previous (cells, 1)."""
        pairs = []
        for frame in range(self.frames):
            before = cells[:, frame - 1] if frame else (previous if self.needs_previous else None)
            state = State(self.panel, cells[:, frame], two_point[:, frame], measured[:, frame], sigma[:, frame], before)
            pairs += [
                (term, term.residual(state)) for term in self.terms if before is not None or not term.needs_previous
            ]
        return pairs

    def symbols(self) -> list[casadi.SX]:
        """Cells, two-point resistance, measured, σ (cells, frames) and previous (cells, 1), in ohm."""
        shape = (self.panel.cells, self.frames)
        names = ("cells", "two_point", "measured", "sigma")
        return [casadi.SX.sym(name, *shape) for name in names] + [casadi.SX.sym("previous", self.panel.cells)]

    def parameters(self, data: Data) -> list[Array]:
        """The last three of `symbols` as numbers."""
        previous = np.ones(self.panel.cells) if data.previous is None else data.previous.ravel()
        return [columns(data.measured), columns(data.sigma), previous]

    @cached_property
    def _functions(self) -> dict[str, casadi.Function]:
        symbols = self.symbols()
        pairs = self.residuals(*symbols)
        costs = {id(term): casadi.SX(0) for term in self.terms}
        for term, residual in pairs:
            costs[id(term)] += term.weight * term.loss.cost(residual)
        smooth, rough, slope = smooth_and_rough(pairs)
        dual = casadi.SX.sym("dual", rough.shape[0])
        lagrangian = smooth + casadi.dot(casadi.DM(slope) * dual, rough)
        unknown = casadi.vertcat(casadi.vec(symbols[0]), casadi.vec(symbols[1]))
        arguments = [*symbols, dual]
        gradient = casadi.gradient(lagrangian, unknown)
        hessian = casadi.jacobian(gradient, unknown, {"symmetric": True})
        return {
            "costs": casadi.Function("costs", symbols, [casadi.vertcat(*costs.values())]),
            "gradient": casadi.Function("gradient", arguments, [gradient]),
            "hessian": casadi.Function("hessian", arguments, [hessian]),
            "rough": casadi.Function("rough", symbols, [rough, casadi.SX(casadi.DM(slope))]),
        }

    def evaluate(self, data: Data, cell_resistance: Array) -> "Evaluation":
        """The cost and what it is made of at a cell resistance (frames, rows, columns) ohm."""
        networks = tuple(
            Network.solve(1 / cells, grounding(measured))
            for cells, measured in zip(cell_resistance, data.measured, strict=True)
        )
        two_point = np.stack([network.two_point_resistance() for network in networks])
        arguments = [columns(cell_resistance), columns(two_point), *self.parameters(data)]
        return Evaluation(self, data, cell_resistance, two_point, networks, arguments)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """φ and its derivatives at one point."""

    cost: Cost
    data: Data
    cell_resistance: Array
    two_point_resistance: Array
    networks: tuple[Network, ...]
    arguments: list[Array]

    @cached_property
    def costs(self) -> Array:
        """weight · loss of each term, summed over frames, in the order of the terms."""
        return np.asarray(self.cost._functions["costs"](*self.arguments)).ravel()

    @property
    def objective(self) -> float:
        """φ."""
        return float(self.costs.sum())

    def log_gradient(self, dual: Array) -> Array:
        """∂φ/∂log r, (frames, rows, columns): r·∂φ/∂r − g·(∂R/∂g)ᵀ ∂φ/∂R, in product form."""
        both = np.asarray(self.cost._functions["gradient"](*self.arguments, dual)).ravel()
        direct, through = (
            part.reshape(self.cell_resistance.shape) for part in np.split(both, [self.cell_resistance.size])
        )
        gradient: Array = direct * self.cell_resistance
        for frame, network in enumerate(self.networks):
            gradient[frame] -= network.conductance * network.conductance_product(through[frame])
        return gradient

    def cost_scale(self) -> float:
        """φ with the terms at f(r) = 0 for one cell, plus φ here: the size against which a gradient is small."""
        blank = list(self.arguments)
        blank[1] = np.zeros_like(blank[1])
        without_model = float(np.asarray(self.cost._functions["costs"](*blank)).sum())
        return (without_model / self.cell_resistance.size + self.objective) or 1.0

    @cached_property
    def rough(self) -> tuple[Array, Array]:
        """Residuals x with an absolute loss, and their weights."""
        rough, slope = (np.asarray(part).ravel() for part in self.cost._functions["rough"](*self.arguments))
        return rough, slope

    def dual_gap(self, dual: Array) -> float:
        """Σ weight·(|x| − z·x) of the absolute losses: zero where z is a subgradient."""
        rough, slope = self.rough
        return float(np.sum(slope * (np.abs(rough) - dual * rough)))

    def kkt_residual(self, dual: Array) -> float:
        """max |u − Π(u − ∇φ/s)| over u = log r, Π onto the bounds, s = `cost_scale`; with the dual gap φ/s added.

        Zero exactly at a point that satisfies the first-order optimality conditions. The duals of absolute losses
        come from the solver and are held to |z| ≤ 1 here.
        """
        dual = np.clip(dual, -1, 1)
        scale = self.cost_scale()
        position = np.log(self.cell_resistance)
        target = position - self.log_gradient(dual) / scale
        target = np.clip(target, np.log(self.data.lower), np.log(self.data.upper))
        return float(np.max(np.abs(position - target)) + self.dual_gap(dual) / scale)


def smooth_and_rough(pairs: list[tuple[Term, casadi.SX]]) -> tuple[casadi.SX, casadi.SX, Array]:
    """Σ weight·loss over terms with a differentiable loss; the residuals with an absolute loss, and their weights."""
    smooth, rough, slopes = casadi.SX(0), [casadi.SX(0, 1)], [np.zeros(0)]
    for term, residual in pairs:
        if isinstance(term.loss, Absolute):
            rough.append(residual)
            slopes.append(np.full(residual.shape[0], term.weight))
        else:
            smooth += term.weight * term.loss.cost(residual)
    return smooth, casadi.vertcat(*rough), np.concatenate(slopes)


def columns(frames: Array) -> Array:
    """(frames, rows, columns) → (cells, frames), row-major cells: how CasADi symbols are laid out."""
    return frames.reshape(len(frames), -1).T
