"""What circuits share that drive the lines of one side, one after the other, each through a resistance Rd."""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Any, ClassVar, Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.lines import (
    LineNumber,
    PerLine,
    Side,
    as_tuple,
    check_resistors,
    of_side,
    opposite,
    per_line,
    with_channels,
)
from lampest.panel.readouts.readout import Readout, Surroundings

END = 1e-9  # (of the supply) a reading so near to an end shows an open cell or a short
# Of the alternating start: rounds, the change of log g at which it ends, and the range of conductances about those of
# the closed form, beyond which a reading no longer depends on its cell.
MOST_ROUNDS, SETTLED, LEAST, LARGEST = 40, 1e-3, 0.02, 1e3


class DrivenReadout(Readout):
    """driven : the side that is driven. drive_ohm : Rd, a number or one for each driven line.

    of_sensed : the keys of resistances that every sensed line has; the first is the reference of a reading. Kinds are
    dataclasses and declare the keys themselves, in the order in which files have them. A key `polarity` says whether
    loads lead to ground ('up') or to the supply ('down'); `input_ohm`, what the converter takes.
    """

    of_sensed: ClassVar[tuple[str, ...]]
    driven: Side
    drive_ohm: PerLine

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("drive_ohm", *self.of_sensed):
            check_resistors(name, getattr(self, name), open_end=name not in ("drive_ohm", "sense_ohm"))
        if self._input_ohm is not None:
            check_resistors("input_ohm", self._input_ohm, most=inf)

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        per_line("drive_ohm", self.drive_ohm, driven)
        for name in self.of_sensed:
            per_line(name, getattr(self, name), sensed)

    @property
    def _input_ohm(self) -> float | None:
        value: float | None = getattr(self, "input_ohm", None)
        return value

    @property
    def _input_text(self) -> str:
        return "" if self._input_ohm is None else f", converter input {self._input_ohm:g} ohm"

    @property
    def noisy_side(self) -> Side:
        """The driven one."""
        return self.driven

    @property
    def mirrored(self) -> bool:
        """Where loads lead to the supply."""
        return bool(getattr(self, "polarity", "up") == "down")

    @property
    def _along_sensed(self) -> int:
        """The axis from one sensed line to the next."""
        return -1 if self.driven == "rows" else -2

    def simulated(self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array) -> Array:
        """With every line's channel in its drive or sense resistance; no sense_ohm, no channel."""
        driven, sensed = of_side(self.driven, row_ohm, column_ohm)
        changes: dict[str, Any] = {"drive_ohm": with_channels("drive_ohm", self.drive_ohm, driven)}
        sense: PerLine = getattr(self, "sense_ohm", 0.0)
        if sense:
            changes["sense_ohm"] = with_channels("sense_ohm", sense, sensed)
        actual = replace(self, **changes)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """Every reference·(1 + fraction)."""
        name = self.of_sensed[0]
        value: PerLine = getattr(self, name)
        larger = tuple(number * (1 + fraction) for number in as_tuple(value))
        changes: dict[str, Any] = {name: larger if isinstance(value, tuple) else larger[0]}
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """The drive resistances, which may be channels alone, and the references; sense channels are as specified."""
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        return drive, LineNumber(self.of_sensed[0], (opposite(self.driven),))


def alternated(ideal: Array, near: Array | None, next_round: Callable[[Array], Array]) -> Array:
    """Conductances (any shape, siemens) of the fixed point of `next_round`, from `near` or from those of a closed form.

    A start, not an estimate: clipped to LEAST and LARGEST of the closed form's, and stopped after MOST_ROUNDS.
    """
    conductance: Array = ideal if near is None else np.clip(near, LEAST * ideal, LARGEST * ideal)
    for _ in range(MOST_ROUNDS):
        before = conductance
        conductance = np.clip(next_round(before), LEAST * ideal, LARGEST * ideal)
        if np.abs(np.log(conductance / before)).max() < SETTLED:
            break
    return conductance
