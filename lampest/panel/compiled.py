"""Lock of CasADi, and compiled CasADi functions of flat arrays.

The functions are without the cost of CasADi's conversions. CasADi releases Python's global lock in
every call, and its reference counts are not thread-safe. All code that builds, calls or frees its
objects is therefore `guarded`: one thread at a time. Objects that outlive such a call belong to a
`CasadiOwner`. A guarded call must not read a cached property that makes another guarded call:
Python 3.11 locks cached properties as well, so that two threads could wait for each other.
"""

import os
import pickle
import sys
from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property, partial, wraps
from threading import RLock
from traceback import clear_frames
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
import scipy

from lampest.files.typed import ReadOnlyArrays
from lampest.panel.panel import Array, Numbers

if TYPE_CHECKING:
    import casadi

P = ParamSpec("P")
R = TypeVar("R")
_LOCK = RLock()
_DROPPED: deque[Any] = deque()  # owners that nothing refers to any more


def _unlock_child() -> None:
    """Release the lock in a forked child, and renew the locks of cached properties.

    The latter are those of Python 3.11.
    """
    _LOCK.release()
    modules = [module for name, module in sys.modules.items() if name.startswith("lampest.")]
    classes = set[type]()
    for module in modules:
        classes.update(member for member in vars(module).values() if isinstance(member, type))
    for owner in classes:
        for member in vars(owner).values():
            if isinstance(member, cached_property) and hasattr(member, "lock"):
                member.lock = RLock()


# A process that forks waits for the lock, so that the child inherits no half-built node.
os.register_at_fork(
    before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_unlock_child
)


def guarded(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs while no other thread uses CasADi.

    Before the call, objects that any thread dropped are freed.
    """

    @wraps(function)
    def alone(*arguments: P.args, **named: P.kwargs) -> R:
        with _LOCK:
            _DROPPED.clear()
            try:
                return function(*arguments, **named)
            except BaseException as error:
                # a later handler would free the frames' symbols without the lock
                clear_frames(error.__traceback__)
                raise

    return alone


class CasadiOwner:
    """Base of objects with CasADi attributes.

    Any thread may drop them, and the next guarded call frees them. Waiting for the lock in the
    destructor could deadlock, because the garbage collector may run while the thread holds another
    lock. The destructor keeps the object itself. None of its steps is Python code, in which an
    interrupt could land and be lost.
    """

    __del__ = property(partial(partial, _DROPPED.append))  # self.__del__() is _DROPPED.append(self)

    def __getstate__(self) -> Any:
        """Return the fields, without what follows from them."""
        return _fields_of(self)


class SymbolsOwner(ReadOnlyArrays, CasadiOwner):
    """Base of objects that CasADi pickles as a whole, so that their symbols stay the same."""

    @guarded
    def __reduce__(self) -> tuple[Any, ...]:
        """Return the class and its fields; what follows from these is computed again."""
        import casadi

        with casadi.global_pickle_context():
            return _with_symbols, (type(self), pickle.dumps(_fields_of(self)))


def _with_symbols(owner: type[Any], state: bytes) -> Any:
    """Return the object of a pickle's fields."""
    import casadi

    with _LOCK, casadi.global_unpickle_context():
        return owner(**pickle.loads(state))  # a part of a pickle that is loaded


def _fields_of(owner: Any) -> dict[str, Any]:
    return {field.name: getattr(owner, field.name) for field in fields(owner)}


@dataclass(frozen=True, eq=False)
class Compiled(CasadiOwner):
    """CasADi function of flat arrays that returns the nonzeros of its output.

    A call takes a tenth of the time of a plain CasADi call.
    """

    function: "casadi.Function"

    @cached_property
    def _buffer(self) -> tuple[Any, Any, list[Array], Array]:
        """Buffer, evaluation, argument arrays and result array; the arrays have fixed addresses."""
        buffer: Any
        buffer, trigger = self.function.buffer()
        held: list[Array] = [
            np.empty(self.function.nnz_in(number)) for number in range(self.function.n_in())
        ]
        result: Array = np.empty(self.function.nnz_out(0))
        for number, argument in enumerate(held):
            buffer.set_arg(number, argument.data)
        buffer.set_res(0, result.data)
        return buffer, trigger, held, result

    @guarded
    def __getstate__(self) -> str:
        """Return the function as text; a buffer belongs to its process and is made again."""
        return str(self.function.serialize())

    @guarded
    def __setstate__(self, text: str) -> None:
        import casadi

        object.__setattr__(self, "function", casadi.Function.deserialize(text))

    def __call__(self, *arguments: Array) -> Array:
        with _LOCK:
            _, trigger, held, result = self._buffer
            for place, argument in zip(held, arguments, strict=True):
                place[:] = argument.reshape(-1)
            trigger()
            return result.copy()

    @guarded
    def mapped(self, count: int) -> "Compiled":
        """Return the function mapped over `count` points."""
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
    def structure(self) -> "scipy.sparse.csc_array":
        """Sparse matrix with the output's pattern and entries of one."""
        sparsity = self.function.sparsity_out(0)
        rows, first = (
            np.array(numbers, dtype=np.int32) for numbers in (sparsity.row(), sparsity.colind())
        )
        return scipy.sparse.csc_array(
            (np.ones(len(rows)), rows, first), shape=self.function.size_out(0)
        )

    @cached_property
    def pattern(self) -> tuple[Numbers, Numbers]:
        """Places of the nonzeros, column by column.

        Returns
        -------
        rows, columns : integer arrays, shape (nonzeros,)
        """
        places = self.structure.tocoo()
        return places.row.astype(np.intp), places.col.astype(np.intp)


def with_entries(structure: "scipy.sparse.csc_array", entries: Array) -> "scipy.sparse.csc_array":
    """Return a matrix of a given structure with new entries.

    The checks of SciPy's constructor are left out.
    """
    matrix = copy(structure)
    matrix.data = entries
    return matrix
