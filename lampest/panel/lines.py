"""Numbers of lines: one for all lines of a side of the panel, or one for each.

The module has the resistance in series with every line, too.
"""

from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal

import numpy as np

from lampest.files.typed import Configuration
from lampest.panel.panel import Array, Panel

PerLine = float | tuple[float, ...]
# Lines behind one multiplexer each, in the order of its addresses; None: a channel without a line.
Groups = tuple[tuple[int | None, ...], ...]
Side = Literal["rows", "columns"]
# Limits of resistances next to cells of kilo-ohms: a wire, and an insulator that leaves ten of
# sixteen digits.
MIN_OHM = 1e-6
MAX_OHM = 1e9


@dataclass(frozen=True)
class LineNumber:
    """Number of the electronics that known resistors in place of the cells determine.

    Attributes
    ----------
    name : str
        Key in a scene, dotted if it belongs to a part.
    sides : tuple of Side
        Sides whose lines have one number each; with both, a reading depends on their sum. (): one
        number for all.
    channel : bool
        Whether the number is, or includes, the resistance of a multiplexer's channel.
    in_scene : bool
        Whether the key belongs to the scene, not to the readout.
    unit : {'ohm', 'volt', '1'}
    """

    name: str
    sides: tuple[Side, ...]
    channel: bool = False
    in_scene: bool = False
    unit: Literal["ohm", "volt", "1"] = "ohm"


def opposite(side: Side) -> Side:
    """Return the other side of the panel."""
    return "columns" if side == "rows" else "rows"


def of_side(side: Side, rows: Any, columns: Any) -> tuple[Any, Any]:
    """Order values of rows and columns by a side, or restore the order of rows and columns.

    Returns
    -------
    own, opposite
        Values of the side and of its opposite side; of these again, values of rows and columns.
    """
    return (rows, columns) if side == "rows" else (columns, rows)


def along(side: Side, values: Array) -> Array:
    """Return values of the lines of one side, to be broadcast to (rows, columns)."""
    return values[:, None] if side == "rows" else values[None, :]


def as_tuple(value: PerLine) -> tuple[float, ...]:
    """Return all numbers as a tuple."""
    return value if isinstance(value, tuple) else (value,)


def lines_text(value: PerLine, unit: str = "ohm") -> str:
    """Return '10000 ohm', or 'from 980 to 1020 ohm' if lines differ."""
    low, high = min(as_tuple(value)), max(as_tuple(value))
    return f"{low:g} {unit}" if low == high else f"from {low:g} to {high:g} {unit}"


def check_lines(name: str, value: PerLine, *, open_end: bool = False) -> None:
    """Raise ValueError unless every number is finite and not negative.

    With an open end, every number must also be positive.
    """
    if not as_tuple(value):
        raise ValueError(f"{name} lists no number")
    if not all(0 < number < np.inf or (number == 0 and not open_end) for number in as_tuple(value)):
        raise ValueError(
            f"{name} must be {'positive' if open_end else 'zero or positive'} and finite"
        )


def check_resistors(
    name: str, value: PerLine, *, open_end: bool = True, most: float = MAX_OHM
) -> None:
    """Raise ValueError as `check_lines`, or if a nonzero resistance is out of range.

    The range is MIN_OHM to `most`; resistances outside it raise.
    """
    check_lines(name, value, open_end=open_end)
    if not all(MIN_OHM <= number <= most for number in as_tuple(value) if number):
        raise ValueError(f"{name} must lie between {MIN_OHM:g} and {most:g} ohm")


def per_line(name: str, value: PerLine, lines: int) -> Array:
    """Return the number of every line, (lines,). Raises ValueError if a list has another length."""
    if isinstance(value, tuple) and len(value) != lines:
        raise ValueError(f"{name} lists {len(value)} numbers, but there are {lines} such lines")
    return np.array(value) if isinstance(value, tuple) else np.full(lines, value)


def with_channels(name: str, value: PerLine, channels: Array) -> tuple[float, ...]:
    """Return the numbers of all lines plus their additional channels, ohm.

    Raises ValueError if a sum is negative.
    """
    total = per_line(name, value, len(channels)) + channels
    if min(total) < 0:
        raise ValueError(
            f"the spread of the channels makes a resistance negative; give a larger {name}"
        )
    return tuple(total.tolist())


def listed_lines(groups: Groups) -> list[int]:
    """Return the lines of all groups, without channels that have none."""
    return [line for line in chain.from_iterable(groups) if line is not None]


def check_apart(groups: Groups, key: str) -> None:
    """Raise ValueError unless groups are not empty and name every line once."""
    if not groups or not all(listed_lines((group,)) for group in groups):
        raise ValueError(f"{key}: every multiplexer has at least one line")
    lines = listed_lines(groups)
    for line in lines:
        if lines.count(line) > 1:
            raise ValueError(
                f"{key} overlap: line {line} is listed twice, but it is behind one multiplexer"
            )


def check_groups(groups: Groups | None, side: Side, count: int, key: str = "groups") -> None:
    """Raise ValueError unless groups, if any, name every one of `count` lines of a side."""
    if groups is None:
        return
    listed, lines = set(listed_lines(groups)), set(range(count))
    name = side.removesuffix("s")
    if listed - lines:
        raise ValueError(
            f"readout.{key}: there is no {name} {min(listed - lines)}; "
            f"{side} are numbered from 0 to {count - 1}"
        )
    if lines - listed:
        raise ValueError(
            f"readout.{key}: {name} {min(lines - listed)} is left out; "
            "every one is behind a multiplexer"
        )


@dataclass(frozen=True)
class SeriesPerLine(Configuration):
    """Resistance in series with every line.

    The reading of row j and column k includes rows[j] + columns[k].

    Attributes
    ----------
    rows, columns : PerLine
        Resistances in ohm, one for each line, or one for all lines of a side.

    Raises ValueError if one is negative.

    >>> lampest.SeriesPerLine(rows=(70.0, 72.0), columns=(69.0, 71.0)).ohm(lampest.Panel(2, 2))
    array([[139., 141.],
           [141., 143.]])
    """

    rows: PerLine
    columns: PerLine

    def __post_init__(self) -> None:
        check_resistors("rows", self.rows, open_end=False)
        check_resistors("columns", self.columns, open_end=False)

    def ohm(self, panel: Panel) -> Array:
        """Return the resistance in series with every reading, (rows, columns) ohm.

        Raises ValueError if a list has another length.
        """
        row, column = self.of_lines(panel)
        return row[:, None] + column

    def of_lines(self, panel: Panel) -> tuple[Array, Array]:
        """Return the resistances of all rows, (rows,), and of all columns, (columns,) ohm."""
        return (
            per_line("series_resistance_ohm.rows", self.rows, panel.rows),
            per_line("series_resistance_ohm.columns", self.columns, panel.columns),
        )
