"""A user's own term, loss, readout, method, shape, column and plot.

The classes use public names alone, as a notebook or a package would. `test_extending` uses them
through Python, and installs this file as a package.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import casadi
import numpy as np
from matplotlib.figure import Figure

import lampest
from lampest import Array


@dataclass(frozen=True)
class Leash(lampest.Term):
    """r − length in ohm: pulls all cells to one resistance."""

    unit: ClassVar[str] = "ohm"
    kind: Literal["leash"] = "leash"
    length_ohm: float = 1000.0

    def residual(self, state: lampest.State) -> Any:
        """(cells, 1)."""
        return state.cell_resistance - self.length_ohm


@dataclass(frozen=True)
class Cushion(lampest.Loss):
    """Σ 2c²·(√(1 + (x/c)²) − 1), c the softness in the unit of the residual.

    `cost` avoids the cancellation in √(1 + (x/c)²) − 1.
    """

    softness: float = 1.0
    kind: Literal["cushion"] = "cushion"

    def cost(self, residual: Any) -> Any:
        """The sum, symbolic or numeric."""
        return 2 * casadi.sum1(residual**2 / ((1 + (residual / self.softness) ** 2) ** 0.5 + 1))


@dataclass(frozen=True, kw_only=True)
class Divider(lampest.Readout):
    """V = Vcc·Z_jk/(Rd + Z_jj), with a load at every column.

    Rd drives one row; other rows float.
    """

    kind: Literal["divider"] = "divider"
    load_ohm: float = 10_000.0
    drive_ohm: float = 100.0

    def description(self) -> str:
        """The two resistors."""
        return f"divider of {self.load_ohm:g} ohm, driven through {self.drive_ohm:g} ohm"

    def terminations(self, driven: int, sensed: int) -> lampest.Terminations:
        """Return the ends: the supply behind Rd at one row, Rs at every column."""
        load = lampest.Ends.of(np.full(sensed, self.load_ohm))
        return lampest.Terminations(
            "rows",
            lampest.scanned(
                lampest.Ends.of(np.full(driven, self.drive_ohm), self.supply_volt),
                lampest.Ends.floating(driven),
            ),
            lampest.scanned(load, load),
            gain=np.ones(sensed),
        )


@dataclass(frozen=True)
class Even(lampest.Method):
    """Every cell as large as the geometric mean of the apparent resistances, times `factor`."""

    factor: float = 1.0
    kind: Literal["even"] = "even"

    def solution(
        self, solver: lampest.Solver, data: lampest.Data, previous: Array | None, prepared: Any
    ) -> lampest.Solution:
        """The same number in all cells."""
        apparent = data.readout.apparent_resistance(data.measured)
        cells = np.full_like(apparent, self.factor * np.exp(np.log(apparent).mean()))
        outcome = lampest.Outcome(cells, np.zeros(0), lampest.Status.APPROXIMATE, 0)
        return lampest.approximation(solver.cost, data, outcome)


@dataclass(frozen=True, kw_only=True)
class Ellipse(lampest.Shape):
    """The same pressure all over an ellipse, and no suction."""

    kind: Literal["ellipse"] = "ellipse"
    long_mm: float
    short_mm: float
    pressure_kpa: float

    @property
    def reach_mm(self) -> float:
        """Half its longer axis."""
        return self.long_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """kPa."""
        inside = (x / self.long_mm) ** 2 + (y / self.short_mm) ** 2 < 0.25
        return inside * self.pressure_kpa, np.zeros_like(x)


def contrast(estimates: lampest.Estimates) -> Array:
    """Largest cell over the smallest one, (frames)."""
    cells = estimates.cell_resistance
    return np.asarray(cells.max(axis=(1, 2)) / cells.min(axis=(1, 2)))


CONTRAST = lampest.Column("contrast", ("time",), "1", "largest cell over the smallest", contrast)


@dataclass(frozen=True)
class Histogram(lampest.Plot):
    """How many cells of the shown frame have which resistance."""

    kind: ClassVar[str] = "histogram"

    def draw(self, cases: Sequence[lampest.CaseResult]) -> Figure:
        """One colour a case."""
        figure = Figure()
        axes = figure.subplots()
        for case in cases:
            index = -1 if self.frame is None else int(np.flatnonzero(case.frame == self.frame)[0])
            axes.hist(case.cell_resistance[index].ravel(), label=case.estimator)
        return figure


HISTOGRAM = Histogram()
