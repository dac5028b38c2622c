"""The terms' residuals and their first derivatives, as Gauss-Newton methods need them; symbolic, compiled once."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.cost import Compiled, Cost
from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Part:
    """Some rows of the residuals x, unweighted: functions of what `Evaluation` holds.

    value : x. by_cells, by_model, by_previous, by_baseline : ∂x/∂ cells, two-point resistances, previous and baseline,
    sparse.
    term : the number of the term that every row belongs to.
    """

    value: Compiled
    by_cells: Compiled
    by_model: Compiled
    by_previous: Compiled
    by_baseline: Compiled
    term: NDArray[np.intp]

    def values(self, at: Evaluation) -> Array:
        """x at a point."""
        return self._call(self.value, at)

    def jacobian(self, name: str, at: Evaluation) -> sparse.csc_array:
        """One of the derivatives at a point, (rows, unknowns) sparse."""
        structure = self._structures[name]
        if not structure.nnz:
            return structure
        values = self._call(getattr(self, name), at)
        return sparse.csc_array((values, structure.indices, structure.indptr), shape=structure.shape)

    @cached_property
    def _structures(self) -> dict[str, sparse.csc_array]:
        names = ("by_cells", "by_model", "by_previous", "by_baseline")
        patterns = {name: getattr(self, name).function.sparsity_out(0) for name in names}
        return {
            name: sparse.csc_array((np.ones(pattern.nnz()), pattern.row(), pattern.colind()), shape=pattern.shape)
            for name, pattern in patterns.items()
        }

    @staticmethod
    def _call(function: Compiled, at: Evaluation) -> Array:
        return function(at.cell_resistance.ravel(), at.two_point_resistance.ravel(), *at.data.parameters)


@dataclass(frozen=True, eq=False)
class Residuals:
    """data : the rows that read two-point resistances. penalties : all others."""

    data: Part
    penalties: Part


def residuals(cost: Cost) -> Residuals:
    """The residuals of a cost, compiled once for all weights."""
    return _residuals(cost.unweighted)


@lru_cache(maxsize=64)
def _residuals(cost: Cost) -> Residuals:
    symbols = cost.symbols()
    pairs = cost.residuals(*symbols)
    stacked = casadi.vertcat(*(part for _, part in pairs))
    term = np.concatenate([np.full(part.shape[0], number, dtype=np.intp) for number, part in pairs])
    reads = set(casadi.jacobian_sparsity(stacked, casadi.vec(symbols[1])).row())
    rows = ([row for row in range(len(term)) if (row in reads) is data] for data in (True, False))
    return Residuals(*(_part(symbols, stacked[chosen], term[chosen]) for chosen in rows))


def _part(symbols: list[casadi.SX], rows: casadi.SX, term: NDArray[np.intp]) -> Part:
    inputs = [casadi.vec(symbol) for symbol in symbols]
    outputs = {
        "value": casadi.densify(rows),
        "by_cells": casadi.jacobian(rows, inputs[0]),
        "by_model": casadi.jacobian(rows, inputs[1]),
        "by_previous": casadi.jacobian(rows, inputs[4]),
        "by_baseline": casadi.jacobian(rows, inputs[5]),
    }
    compiled = {name: Compiled(casadi.Function(name, inputs, [output])) for name, output in outputs.items()}
    return Part(**compiled, term=term)
