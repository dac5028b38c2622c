"""The cost function: terms over one frame, or over a baseline and its first frame jointly, with sparse derivatives.

φ = Σ_terms weight · loss(residual). This module is symbolic; values and the way from potentials to cells are elsewhere.
Weights are parameters of what is compiled: costs that differ in nothing else share it.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from lampest.cost.losses import Absolute, Huber
from lampest.cost.terms.term import State, Term
from lampest.panel.panel import Array, Panel


@dataclass(frozen=True)
class Cost:
    """φ over `frames` frames of a panel, built once and evaluated for any data.

    With two frames the first is the baseline and the previous frame of the second; terms that need those skip it.
    Residuals that read a `faulty` cell (numbers) are left out. With `partial`, readings may be bounds or say nothing.
    An absolute loss enters derivatives through its dual variables z, |z| ≤ 1: weight · Σ z·x.
    """

    panel: Panel
    terms: tuple[Term, ...]
    frames: int = 1
    faulty: tuple[int, ...] = ()
    partial: bool = False

    @property
    def needs_previous(self) -> bool:
        """Whether a single frame needs a known previous one."""
        return self.frames == 1 and any(term.needs_previous for term in self.terms)

    @cached_property
    def weights(self) -> Array:
        """Of the terms, in their order. Raises ValueError where one is still to be chosen."""
        return np.array([float(term.weight) for term in self.terms])

    @cached_property
    def unweighted(self) -> "Cost":
        """The same cost with weights of one."""
        return replace(self, terms=tuple(replace(term, weight=1.0) for term in self.terms))

    def residuals(self, *symbols: casadi.SX) -> list[tuple[int, casadi.SX]]:
        """(number of the term, residual) pairs of expressions in the order of `symbols`, frame by frame."""
        pairs = self._all_residuals(*symbols)
        if not self.faulty:
            return pairs
        return [(number, part[rows]) for (number, part), rows in zip(pairs, self._sound_rows, strict=True)]

    def _all_residuals(
        self,
        cells: casadi.SX,
        two_point: casadi.SX,
        measured: casadi.SX,
        sigma: casadi.SX,
        previous: casadi.SX,
        baseline: casadi.SX,
        previous_deviation: casadi.SX,
        *marks: casadi.SX,
    ) -> list[tuple[int, casadi.SX]]:
        pairs = []
        for frame in range(self.frames):
            before = cells[:, frame - 1] if frame else (previous if self.needs_previous else None)
            deviation = casadi.SX.zeros(self.panel.cells) if frame else previous_deviation
            resting = cells[:, 0] if frame else (baseline if self.needs_previous else None)
            cell, model, reading, noise = (part[:, frame] for part in (cells, two_point, measured, sigma))
            side, seen = (mark[:, frame] for mark in marks) if marks else (None, None)
            state = State(self.panel, cell, model, reading, noise, before, side, seen, resting, deviation)
            for number, term in enumerate(self.terms):
                if before is not None or not term.needs_previous:
                    pairs.append((number, term.residual(state)))
        return pairs

    @cached_property
    def _sound_rows(self) -> list[list[int]]:
        """Of each residual, the rows that read no faulty cell."""
        symbols = self.symbols()
        every = [frame * self.panel.cells + cell for frame in range(self.frames) for cell in self.faulty]
        rows = []
        for _, residual in self._all_residuals(*symbols):
            reads = casadi.jacobian(residual, casadi.vec(symbols[0]))[:, every].sparsity()
            touched = set(reads.row())
            rows.append([row for row in range(residual.shape[0]) if row not in touched])
        return rows

    def symbols(self) -> list[casadi.SX]:
        """Cells, two-point resistance, measured, σ (cells, frames) ohm; what is known (cells, 1); side, seen.

        Known are the previous cells and the baseline, in ohm, and the standard deviation of the former's logarithm.
        """
        shape = (self.panel.cells, self.frames)
        given = [casadi.SX.sym(name, *shape) for name in ("cells", "two_point", "measured", "sigma")]
        marks = [casadi.SX.sym(name, *shape) for name in ("side", "seen")] if self.partial else []
        known = [casadi.SX.sym(name, self.panel.cells) for name in ("previous", "baseline", "previous_deviation")]
        return [*given, *known, *marks]

    @cached_property
    def functions(self) -> "CostFunctions":
        """The cost and its derivatives, compiled at first use."""
        return _functions(self.unweighted)

    @cached_property
    def slope(self) -> Array:
        """The weight of every residual with an absolute loss."""
        return self.weights[self.functions.rough_terms]


@dataclass(frozen=True, eq=False)
class Compiled:
    """A CasADi function of flat arrays; returns the nonzeros of its one output. Ten times faster than a plain call."""

    function: casadi.Function

    @cached_property
    def _buffer(self) -> Any:
        return self.function.buffer()

    def __call__(self, *arguments: Array) -> Array:
        buffer, trigger = self._buffer
        held = [np.ascontiguousarray(argument, dtype=float) for argument in arguments]
        for number, argument in enumerate(held):
            buffer.set_arg(number, argument.data)
        result = np.empty(self.function.nnz_out(0))
        buffer.set_res(0, result.data)
        trigger()
        return result

    @cached_property
    def pattern(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(rows, columns) of the nonzeros."""
        rows, columns = self.function.sparsity_out(0).get_triplet()
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class CostFunctions:
    """Functions of what `Cost.symbols` lists, flat, of the terms' weights and of the duals.

    costs : of each term. gradient, hessian : of the Lagrangian Σ smooth + Σ weight·z·x with respect to (cells;
    two-point resistances). rough, rough_jacobian : residuals x with an absolute loss, whose terms are `rough_terms`.
    huber : residuals with Huber's loss.
    """

    costs: Compiled
    gradient: Compiled
    hessian: Compiled
    rough: Compiled
    rough_jacobian: Compiled
    huber: Compiled
    rough_terms: NDArray[np.intp]

    @classmethod
    def build(cls, cost: Cost) -> "CostFunctions":
        """Differentiate the terms symbolically; sparse."""
        symbols, weights = cost.symbols(), casadi.SX.sym("weights", len(cost.terms))
        pairs = cost.residuals(*symbols)
        costs = [casadi.SX(0) for _ in cost.terms]
        for number, residual in pairs:
            costs[number] += weights[number] * cost.terms[number].loss.cost(residual)
        smooth, rough, slope = smooth_and_rough(cost, pairs, weights)
        dual = casadi.SX.sym("dual", rough.shape[0])
        lagrangian = smooth + casadi.dot(slope * dual, rough)
        unknown = casadi.vertcat(casadi.vec(symbols[0]), casadi.vec(symbols[1]))
        gradient = casadi.gradient(lagrangian, unknown)
        corners = [residual for *_, residual in huber_residuals(cost, pairs)]
        outputs = {
            "costs": casadi.vertcat(*costs),
            "gradient": casadi.densify(gradient),
            "hessian": casadi.jacobian(gradient, unknown, {"symmetric": True}),
            "rough": casadi.densify(rough),
            "rough_jacobian": casadi.jacobian(rough, unknown),
            "huber": casadi.densify(casadi.vertcat(casadi.SX(0, 1), *corners)),
        }
        inputs = [*(casadi.vec(symbol) for symbol in symbols), weights, dual]
        compiled = {name: Compiled(casadi.Function(name, inputs, [output])) for name, output in outputs.items()}
        rough_pairs = [pair for pair in pairs if isinstance(cost.terms[pair[0]].loss, Absolute)]
        owners = [number for number, part in rough_pairs for _ in range(part.shape[0])]
        return cls(**compiled, rough_terms=np.array(owners, dtype=np.intp))


@lru_cache(maxsize=128)
def _functions(cost: Cost) -> CostFunctions:
    return CostFunctions.build(cost)


def smooth_and_rough(
    cost: Cost, pairs: list[tuple[int, casadi.SX]], weights: casadi.SX
) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    """Σ weight·loss over terms with a differentiable loss; the residuals with an absolute loss, and their weights."""
    smooth, rough, slopes = casadi.SX(0), [casadi.SX(0, 1)], [casadi.SX(0, 1)]
    for number, residual in pairs:
        loss = cost.terms[number].loss
        if isinstance(loss, Absolute):
            rough.append(residual)
            slopes.append(casadi.repmat(weights[number], residual.shape[0], 1))
        else:
            smooth += weights[number] * loss.cost(residual)
    return smooth, casadi.vertcat(*rough), casadi.vertcat(*slopes)


def huber_residuals(cost: Cost, pairs: list[tuple[int, casadi.SX]]) -> list[tuple[int, float, casadi.SX]]:
    """(number of the term, corner, residual) of the terms with Huber's loss."""
    losses = [(number, cost.terms[number].loss, residual) for number, residual in pairs]
    return [(number, loss.corner, residual) for number, loss, residual in losses if isinstance(loss, Huber)]
