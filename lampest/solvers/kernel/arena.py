"""What the machine code of a frame needs of a cost and a readout: functions by address, and memory bound to them."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost, CostFunctions
from lampest.cost.problem import Data
from lampest.panel.compiled import Compiled, evaluation_address
from lampest.panel.machine import blas_address, capsule_address, clock_address
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.equation import PARTS, compiled_equation

UNKNOWNS = ("cell_resistance", "reading")


@dataclass(frozen=True, eq=False)
class Arena:
    """functions : of the cost. equation : of the readout. rows, cells, terms : how many.

    One block of memory holds all inputs and outputs: the unknowns, the entries of Z, what the three functions return,
    and at its end what the terms are given. Every solve overwrites it within one call.
    """

    functions: CostFunctions
    equation: Compiled
    rows: int
    cells: int
    terms: int

    @cached_property
    def _sizes(self) -> dict[str, int]:
        """Of the parts of the memory, in their order."""
        outputs = {"entries": 3 * self.cells, "first": 2 * (self.terms + self.cells)}
        outputs |= {"equation": len(PARTS) * self.cells, "hessian": len(self.functions.hessian.pattern[0])}
        return dict.fromkeys(UNKNOWNS, self.cells) | outputs | {name: self._inputs[name] for name in self.given}

    @cached_property
    def _inputs(self) -> dict[str, int]:
        """name → size of what the cost reads."""
        functions = (self.functions.first.function, self.functions.hessian.function)
        return {
            name: function.nnz_in(number) for function in functions for number, name in enumerate(function.name_in())
        }

    @cached_property
    def given(self) -> tuple[str, ...]:
        """The names of what is given, in the order of the memory's end."""
        return tuple(name for name in self._inputs if name not in (*UNKNOWNS, "dual"))

    @cached_property
    def _starts(self) -> dict[str, int]:
        """Where every part begins."""
        ends = np.cumsum([0, *self._sizes.values()])
        return dict(zip([*self._sizes, "end"], (int(end) for end in ends), strict=True))

    @cached_property
    def memory(self) -> Array:
        """The memory."""
        return np.zeros(self._starts["end"])

    @cached_property
    def where(self) -> NDArray[np.int64]:
        """Where the parts begin, and what else the machine code asks for; see `lampest.solvers.kernel.points`."""
        names = ("cell_resistance", "reading", "entries", "first", "equation", "hessian")
        given = self._starts[self.given[0]] if self.given else self._starts["end"]
        parts = [self._starts[name] for name in names]
        return np.array([*parts, given, self.terms, self._sizes["hessian"], self.rows], dtype=np.int64)

    @cached_property
    def entries(self) -> NDArray[np.int64]:
        """(2, nonzeros) rows and columns of the terms' second derivatives."""
        return np.array(self.functions.hessian.pattern, dtype=np.int64)

    @cached_property
    def band(self) -> int:
        """How far apart cells stand, by number, of which a term's second derivatives know both."""
        one, other = self.entries[:, self.entries[0] < self.cells]
        return int(np.abs(one - other).max(initial=0))

    @cached_property
    def _buffers(self) -> list[Any]:
        """The three functions with their memory, which lives as long as they do."""
        return [
            self._bound(self.functions.first, "first"),
            self._bound(self.functions.hessian, "hessian"),
            self._bound(self.equation, "equation"),
        ]

    def _bound(self, compiled: Compiled, output: str) -> Any:
        buffer: Any = compiled.function.buffer()[0]
        begin = self._starts["entries"]
        for number, name in enumerate(compiled.names):
            size = compiled.function.nnz_in(number)
            start = begin + number * self.cells if output == "equation" else self._starts.get(name, 0)
            buffer.set_arg(number, self.memory[start : start + size].data)
        buffer.set_res(0, self.memory[self._starts[output] :][: self._sizes[output]].data)
        return buffer

    @cached_property
    def addresses(self) -> NDArray[np.int64]:
        """Of what evaluates, of the three functions, of BLAS, and of the clock."""
        buffers = [capsule_address(buffer._self()) for buffer in self._buffers]
        subroutines = [blas_address(name) for name in ("dsyrk", "dpotrf", "dpotrs", "dgemm")]
        larger = [blas_address(name) for name in ("dpbtrf", "dpbtrs", "dgesv")]
        return np.array([evaluation_address(), *buffers, *subroutines, clock_address(), *larger], dtype=np.int64)

    def told(self, cost: Cost, data: Data) -> Array:
        """What the terms are given, as the memory's end holds it."""
        field = data.given.flat_field
        return np.concatenate([cost.weights if name == "weights" else field(name) for name in self.given])


@lru_cache(maxsize=32)
def arena(functions: CostFunctions, readout: Readout, rows: int, columns: int, terms: int) -> Arena:
    """Built once for a cost and a readout."""
    return Arena(functions, compiled_equation(readout, rows, columns), rows, rows * columns, terms)
