"""The one lock of CasADi, and its functions of flat arrays, called without the cost of CasADi's own conversions.

CasADi releases Python's lock in every call, and counts the owners of its nodes without one of its own. Whatever builds,
calls or frees its objects therefore is `guarded`: one thread at a time. Objects that outlive such a call belong to a
`CasadiOwner`. Within such a call no cached property is read that makes another one: Python 3.11 locks those as well.
"""

import os
import sys
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property, wraps
from threading import RLock
from traceback import clear_frames
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.panel.panel import Array

if TYPE_CHECKING:
    import casadi

P = ParamSpec("P")
R = TypeVar("R")
_LOCK = RLock()
_DROPPED: deque[dict[str, Any]] = deque()  # contents of owners that are gone


def _unlock_child() -> None:
    """Release the lock in a forked child, and renew the locks of cached properties (Python 3.11)."""
    _LOCK.release()
    modules = [module for name, module in sys.modules.items() if name.startswith("lampest.")]
    classes = {member for module in modules for member in vars(module).values() if isinstance(member, type)}
    for member in (member for owner in classes for member in vars(owner).values()):
        if isinstance(member, cached_property) and hasattr(member, "lock"):
            member.lock = RLock()


# A process that forks waits for the lock, so that the child inherits no half-built node.
os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_unlock_child)


def guarded(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function while no other thread uses CasADi; also frees objects that any thread dropped before."""

    @wraps(function)
    def alone(*arguments: P.args, **named: P.kwargs) -> R:
        with _LOCK:
            _DROPPED.clear()
            try:
                return function(*arguments, **named)
            except BaseException as error:
                clear_frames(error.__traceback__)  # whoever handles it later would free the frames' symbols
                raise

    return alone


class CasadiOwner:
    """An object that holds CasADi's: any thread may drop it, and the next guarded call frees them.

    Waiting for the lock at once could wait for ever, as the collector may run while the thread holds any other lock.
    """

    def __del__(self, drop: Callable[[dict[str, Any]], None] = _DROPPED.append) -> None:
        drop(vars(self).copy())


@dataclass(frozen=True, eq=False)
class Compiled(CasadiOwner):
    """A CasADi function of flat arrays; returns the nonzeros of its one output. Ten times faster than a plain call."""

    function: "casadi.Function"

    @cached_property
    def _buffer(self) -> tuple[Any, Any, list[Array], Array]:
        """Buffer, trigger of the evaluation, arguments and result: arrays with fixed addresses."""
        buffer: Any
        buffer, trigger = self.function.buffer()
        held: list[Array] = [np.empty(self.function.nnz_in(number)) for number in range(self.function.n_in())]
        result: Array = np.empty(self.function.nnz_out(0))
        for number, argument in enumerate(held):
            buffer.set_arg(number, argument.data)
        buffer.set_res(0, result.data)
        return buffer, trigger, held, result

    def __call__(self, *arguments: Array) -> Array:
        with _LOCK:
            _, trigger, held, result = self._buffer
            for place, argument in zip(held, arguments, strict=True):
                place[:] = argument.reshape(-1)
            trigger()
            return result.copy()

    @guarded
    def mapped(self, count: int) -> "Compiled":
        """Return the function of `count` points at once."""
        return Compiled(self.function.map(count))

    @cached_property
    @guarded
    def names(self) -> tuple[str, ...]:
        """Names of the inputs, in their order."""
        return tuple(self.function.name_in())

    @cached_property
    @guarded
    def sizes(self) -> tuple[int, ...]:
        """Numbers of nonzeros of the inputs, in their order."""
        return tuple(self.function.nnz_in(number) for number in range(self.function.n_in()))

    @cached_property
    @guarded
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the output."""
        rows, columns = self.function.size_out(0)
        return int(rows), int(columns)

    @cached_property
    @guarded
    def pattern(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(rows, columns) of the nonzeros, column by column."""
        rows, columns = self.function.sparsity_out(0).get_triplet()
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)

    @cached_property
    @guarded
    def structure(self) -> "scipy.sparse.csc_array":
        """The output with entries of one."""
        sparsity = self.function.sparsity_out(0)
        rows, first = (np.array(numbers, dtype=np.int32) for numbers in (sparsity.row(), sparsity.colind()))
        return scipy.sparse.csc_array((np.ones(len(rows)), rows, first), shape=self.function.size_out(0))


def with_entries(structure: "scipy.sparse.csc_array", entries: Array) -> "scipy.sparse.csc_array":
    """Return a matrix of the same structure with other entries, without the checks of SciPy's constructor."""
    matrix = copy(structure)
    matrix.data = entries
    return matrix
