"""The cost function: terms over one frame, or over a baseline and its first frame jointly, with sparse derivatives.

φ = Σ_terms weight · loss(residual). This module is symbolic; values and the way from potentials to cells are elsewhere.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from lampest.panel import Array, Panel
from lampest.terms.losses import Absolute, Huber
from lampest.terms.term import State, Term


@dataclass(frozen=True)
class Cost:
    """φ over `frames` frames of a panel, built once and evaluated for any data.

    With two frames the first is the previous frame of the second; terms that need a previous frame skip the first.
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

    def residuals(self, *symbols: casadi.SX) -> list[tuple[Term, casadi.SX]]:
        """(term, residual) pairs of expressions in the order of `symbols`."""
        pairs = self._all_residuals(*symbols)
        if not self.faulty:
            return pairs
        return [(term, part[rows]) for (term, part), rows in zip(pairs, self._sound_rows, strict=True)]

    def _all_residuals(
        self,
        cells: casadi.SX,
        two_point: casadi.SX,
        measured: casadi.SX,
        sigma: casadi.SX,
        previous: casadi.SX,
        *marks: casadi.SX,
    ) -> list[tuple[Term, casadi.SX]]:
        pairs = []
        for frame in range(self.frames):
            before = cells[:, frame - 1] if frame else (previous if self.needs_previous else None)
            cell, model, reading, noise = (part[:, frame] for part in (cells, two_point, measured, sigma))
            side, seen = (mark[:, frame] for mark in marks) if marks else (None, None)
            state = State(self.panel, cell, model, reading, noise, before, side, seen)
            terms = [term for term in self.terms if before is not None or not term.needs_previous]
            pairs += [(term, term.residual(state)) for term in terms]
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
        """Cells, two-point resistance, measured, σ (cells, frames) and previous (cells, 1), in ohm; side and seen."""
        shape = (self.panel.cells, self.frames)
        given = [casadi.SX.sym(name, *shape) for name in ("cells", "two_point", "measured", "sigma")]
        marks = [casadi.SX.sym(name, *shape) for name in ("side", "seen")] if self.partial else []
        return [*given, casadi.SX.sym("previous", self.panel.cells), *marks]

    @cached_property
    def functions(self) -> "CostFunctions":
        """The cost and its derivatives, compiled at first use."""
        return CostFunctions.build(self)


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
    """Functions of flat cells, two-point resistances, measured, σ, previous and, but for costs and rough, the duals.

    costs : of each term. gradient, hessian : of the Lagrangian Σ smooth + Σ weight·z·x with respect to (cells;
    two-point resistances). rough, rough_jacobian, slope : residuals x with an absolute loss, their weights.
    huber : residuals with Huber's loss.
    """

    costs: Compiled
    gradient: Compiled
    hessian: Compiled
    rough: Compiled
    rough_jacobian: Compiled
    huber: Compiled
    slope: Array

    @classmethod
    def build(cls, cost: Cost) -> "CostFunctions":
        """Differentiate the terms symbolically; sparse."""
        symbols = cost.symbols()
        pairs = cost.residuals(*symbols)
        costs = {id(term): casadi.SX(0) for term in cost.terms}
        for term, residual in pairs:
            costs[id(term)] += term.weight * term.loss.cost(residual)
        smooth, rough, slope = smooth_and_rough(pairs)
        dual = casadi.SX.sym("dual", rough.shape[0])
        lagrangian = smooth + casadi.dot(casadi.DM(slope) * dual, rough)
        unknown = casadi.vertcat(casadi.vec(symbols[0]), casadi.vec(symbols[1]))
        gradient = casadi.gradient(lagrangian, unknown)
        outputs = {
            "costs": casadi.vertcat(*costs.values()),
            "gradient": casadi.densify(gradient),
            "hessian": casadi.jacobian(gradient, unknown, {"symmetric": True}),
            "rough": casadi.densify(rough),
            "rough_jacobian": casadi.jacobian(rough, unknown),
            "huber": casadi.densify(casadi.vertcat(casadi.SX(0, 1), *(part for *_, part in huber_residuals(pairs)))),
        }
        inputs = [casadi.vec(symbol) for symbol in symbols]
        compiled = {
            name: Compiled(casadi.Function(name, [*inputs, dual], [output])) for name, output in outputs.items()
        }
        return cls(**compiled, slope=slope)


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


def huber_residuals(pairs: list[tuple[Term, casadi.SX]]) -> list[tuple[float, float, casadi.SX]]:
    """(weight, corner, residual) of the terms with Huber's loss."""
    return [(term.weight, term.loss.corner, residual) for term, residual in pairs if isinstance(term.loss, Huber)]
