"""Numbers that hold for all lines of one side of the panel, or are given for each."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lampest.panel.panel import Array

PerLine = float | tuple[float, ...]
Side = Literal["rows", "columns"]
# Beside cells of kilo-ohms: a wire, and an insulator that leaves ten of sixteen digits.
LEAST_OHM, MOST_OHM = 1e-6, 1e9
# (σ) by which bounds give way: with 1 % noise the truth itself breaks exact ones in a third of cases.
RELAXED = 3.0


@dataclass(frozen=True)
class LineNumber:
    """A number of the electronics that known resistors in place of the cells determine.

    name : its key in a scene, dotted where it is a part's. sides : whose lines have one each; where both have, a
    reading has their sum; none: it is one for all. channel : whether it is a multiplexer's channel, or with one, rather
    than a resistor. in_scene : whether the key is the scene's, and not the readout's.
    """

    name: str
    sides: tuple[Side, ...]
    channel: bool = False
    in_scene: bool = False
    unit: Literal["ohm", "volt", "1"] = "ohm"


def opposite(side: Side) -> Side:
    """The other side of the panel."""
    return "columns" if side == "rows" else "rows"


def of_side(side: Side, rows: Any, columns: Any) -> tuple[Any, Any]:
    """(what the side has, what the other side has), of what rows and columns have; and the same way back."""
    return (rows, columns) if side == "rows" else (columns, rows)


def along(side: Side, values: Array) -> Array:
    """Values of the lines of one side, to be broadcast to (rows, columns)."""
    return values[:, None] if side == "rows" else values[None, :]


def as_tuple(value: PerLine) -> tuple[float, ...]:
    """All numbers, be it one."""
    return value if isinstance(value, tuple) else (value,)


def lines_text(value: PerLine, unit: str = "ohm") -> str:
    """'10000 ohm', or 'from 980 to 1020 ohm' where lines differ."""
    low, high = min(as_tuple(value)), max(as_tuple(value))
    return f"{low:g} {unit}" if low == high else f"from {low:g} to {high:g} {unit}"


def check_lines(name: str, value: PerLine, open_end: bool = False) -> None:
    """Raise ValueError unless every number is finite and not negative, nor zero with an open end."""
    if not as_tuple(value):
        raise ValueError(f"{name} lists no number")
    if not all(0 < number < np.inf or (number == 0 and not open_end) for number in as_tuple(value)):
        raise ValueError(f"{name} must be {'positive' if open_end else 'zero or positive'} and finite")


def check_resistors(name: str, value: PerLine, open_end: bool = True, most: float = MOST_OHM) -> None:
    """The same for resistances, and raise ValueError where one is so small or so large that digits are lost."""
    check_lines(name, value, open_end)
    if not all(LEAST_OHM <= number <= most for number in as_tuple(value) if number):
        raise ValueError(f"{name} must lie between {LEAST_OHM:g} and {most:g} ohm")


def per_line(name: str, value: PerLine, lines: int) -> Array:
    """(lines) the number for every line. Raises ValueError where a list has another length."""
    if isinstance(value, tuple) and len(value) != lines:
        raise ValueError(f"{name} lists {len(value)} numbers, but there are {lines} such lines")
    return np.array(value) if isinstance(value, tuple) else np.full(lines, value)


def with_channels(name: str, value: PerLine, channels: Array) -> tuple[float, ...]:
    """The numbers with what every line's channel (lines) has more. Raises ValueError where one turns negative."""
    total = per_line(name, value, len(channels)) + channels
    if np.any(total < 0):
        raise ValueError(f"the spread of the channels makes a resistance negative; give a larger {name}")
    return tuple(float(ohm) for ohm in total)


def parallel(ohm: Array, other: float | None) -> Array:
    """Two resistances side by side; the other may not be there."""
    return ohm if other is None else np.asarray(1 / (1 / ohm + 1 / other))
