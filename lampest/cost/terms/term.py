"""What a cost term reads and what it must say. cost = weight · loss(residual)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import Any, ClassVar, Literal

import casadi

from lampest.cost.given import Given
from lampest.cost.losses import AnyLoss, Squared
from lampest.panel.panel import Panel

Reference = Literal["baseline", "previous"]


@dataclass(frozen=True, eq=False, kw_only=True)
class State(Given):
    """One frame as a term sees it; columns of (cells, 1) in row-major order, symbolic or numeric.

    Parameters
    ----------
    panel : shape of the panel.
    cell_resistance : r, ohm.
    reading : y = f(r) as the model has it, in the readout's unit (ohm or volt).

    and all that `Given` declares: what was measured, and what is known from earlier frames.
    """

    panel: Panel
    cell_resistance: Any
    reading: Any

    def relative_change(self) -> Any:
        """100·(r − r0)/r0 in percent; paper, equation (15)."""
        return 100 * (self.cell_resistance - self.previous) / self.previous

    def ratio(self, reference: Reference) -> Any:
        """r/r0, r0 the baseline's or the previous frame's, (cells, 1)."""
        return self.cell_resistance / (self.baseline if reference == "baseline" else self.previous)

    def log_steps(self, values: Any) -> Any:
        """100·log(x_b/x_a) over all pairs of neighbours, b below or right of a, (pairs, 1) percent."""
        first, second = neighbour_operators(self.panel.rows, self.panel.columns)
        return 100 * casadi.log((second @ values) / (first @ values))

    def gradient(self, values: Any) -> Any:
        """(row part; column part) of ∇x over the panel, (2·cells, 1), per unit cell; paper, section IV.D."""
        return gradient_operator(self.panel.rows, self.panel.columns) @ values


@cache
def gradient_operator(rows: int, columns: int) -> casadi.DM:
    """Sparse (2·cells, cells): the panel's finite differences for row-major columns."""
    panel = Panel(rows, columns)
    along_rows = casadi.sparsify(casadi.DM(panel.row_gradient()))
    along_columns = casadi.sparsify(casadi.DM(panel.column_gradient()))
    return casadi.vertcat(
        casadi.kron(along_rows, casadi.DM.eye(columns)), casadi.kron(casadi.DM.eye(rows), along_columns)
    )


@cache
def neighbour_operators(rows: int, columns: int) -> tuple[casadi.DM, casadi.DM]:
    """Sparse (pairs, cells), twice: what picks the first and the second cell of every pair of neighbours."""

    def picked(below: tuple[int, int], right: tuple[int, int]) -> casadi.DM:
        """Rows from `below[0]` to `below[1]` of the panel, then columns from `right[0]` to `right[1]`."""
        down = casadi.kron(casadi.DM.eye(rows)[slice(*below), :], casadi.DM.eye(columns))
        return casadi.vertcat(down, casadi.kron(casadi.DM.eye(rows), casadi.DM.eye(columns)[slice(*right), :]))

    return picked((0, rows - 1), (0, columns - 1)), picked((1, rows), (1, columns))


Weight = float | Literal["auto"]


@dataclass(frozen=True)
class Term(ABC):
    """A summand of the cost function: weight · loss(residual(state)).

    weight : a number, or 'auto' where the data are to choose it, which is what lampest's penalties have where none is
    named. reads_measurement : whether it is a data term, which reads what was measured; all others are penalties.
    needs_previous : whether it compares with the previous frame or the baseline. weighs_previous : whether it reads
    how well the previous frame is known, so that its variance is that of the change and of the previous frame's error
    together. convex_in_log : whether it is convex in log r once those are known. Raises ValueError unless the weight
    is finite and not negative.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    reads_measurement: ClassVar[bool] = False
    needs_previous: ClassVar[bool] = False
    weighs_previous: ClassVar[bool] = False
    convex_in_log: ClassVar[bool] = False
    unit: ClassVar[str]
    weight: Weight = 1.0
    loss: AnyLoss = Squared()

    def __post_init__(self) -> None:
        if self.weight != "auto" and not (isfinite(self.weight) and self.weight >= 0):
            raise ValueError("weight must be zero or positive, and finite")

    @abstractmethod
    def residual(self, state: State) -> Any:
        """The column of residuals, in `unit`."""
