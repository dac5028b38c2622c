"""The terms' residuals and their first derivatives, as Gauss-Newton methods need them; symbolic, compiled once."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.cost import Cost, Symbols
from lampest.cost.problem import Evaluation
from lampest.panel.compiled import Compiled
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class Part:
    """Some rows of the residuals x, unweighted: functions of what `Evaluation` holds.

    value : x. by_cells, by_model, by_previous, by_baseline : ∂x/∂ cells, readings, previous and baseline, sparse.
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
        return at.of_terms(self.value)

    def jacobian(self, name: str, at: Evaluation) -> sparse.csc_array:
        """One of the derivatives at a point, (rows, unknowns) sparse."""
        structure = self._structures[name]
        if not structure.nnz:
            return structure
        values = at.of_terms(getattr(self, name))
        return sparse.csc_array((values, structure.indices, structure.indptr), shape=structure.shape)

    @cached_property
    def _structures(self) -> dict[str, sparse.csc_array]:
        names = ("by_cells", "by_model", "by_previous", "by_baseline")
        patterns = {name: getattr(self, name).function.sparsity_out(0) for name in names}
        return {
            name: sparse.csc_array((np.ones(pattern.nnz()), pattern.row(), pattern.colind()), shape=pattern.shape)
            for name, pattern in patterns.items()
        }


@dataclass(frozen=True, eq=False)
class Residuals:
    """data : the rows that read readings. penalties : all others."""

    data: Part
    penalties: Part


def residuals(cost: Cost) -> Residuals:
    """The residuals of a cost, compiled once for all weights."""
    return _residuals(cost.unweighted)


@lru_cache(maxsize=64)
def _residuals(cost: Cost) -> Residuals:
    symbols = cost.symbols
    pairs = cost.residuals(symbols)
    stacked = casadi.vertcat(*(part for _, part in pairs))
    term = np.concatenate([np.full(part.shape[0], number, dtype=np.intp) for number, part in pairs])
    reads = set(casadi.jacobian_sparsity(stacked, symbols.inputs()["reading"]).row())
    rows = ([row for row in range(len(term)) if (row in reads) is data] for data in (True, False))
    return Residuals(*(_part(symbols, stacked[chosen], term[chosen]) for chosen in rows))


def _part(symbols: Symbols, rows: casadi.SX, term: NDArray[np.intp]) -> Part:
    inputs = symbols.inputs()
    outputs = {
        "value": casadi.densify(rows),
        "by_cells": casadi.jacobian(rows, inputs["cell_resistance"]),
        "by_model": casadi.jacobian(rows, inputs["reading"]),
        "by_previous": casadi.jacobian(rows, inputs["previous"]),
        "by_baseline": casadi.jacobian(rows, inputs["baseline"]),
    }
    return Part(**{name: symbols.compiled(name, output) for name, output in outputs.items()}, term=term)
