"""CasADi functions of flat arrays, called without the cost of CasADi's own conversions."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

if TYPE_CHECKING:
    import casadi


@dataclass(frozen=True, eq=False)
class Compiled:
    """A CasADi function of flat arrays; returns the nonzeros of its one output. Ten times faster than a plain call."""

    function: "casadi.Function"

    @cached_property
    def _buffer(self) -> tuple[Any, Any, list[Array], Array]:
        """(buffer, what evaluates it, its arguments, its result): arrays that stay where they are."""
        buffer: Any
        buffer, trigger = self.function.buffer()
        held: list[Array] = [np.empty(self.function.nnz_in(number)) for number in range(self.function.n_in())]
        result: Array = np.empty(self.function.nnz_out(0))
        for number, argument in enumerate(held):
            buffer.set_arg(number, argument.data)
        buffer.set_res(0, result.data)
        return buffer, trigger, held, result

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the inputs, in their order."""
        return tuple(self.function.name_in())

    def __call__(self, *arguments: Array) -> Array:
        _, trigger, held, result = self._buffer
        for place, argument in zip(held, arguments, strict=True):
            place[:] = argument.reshape(-1)
        trigger()
        return result.copy()

    @cached_property
    def pattern(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(rows, columns) of the nonzeros, column by column."""
        rows, columns = self.function.sparsity_out(0).get_triplet()
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)

    @cached_property
    def by_columns(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """(row of every nonzero, number of the first nonzero of every column and of all)."""
        sparsity = self.function.sparsity_out(0)
        return np.array(sparsity.row(), dtype=np.int32), np.array(sparsity.colind(), dtype=np.int32)
