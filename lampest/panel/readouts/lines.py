"""Numbers that hold for all lines of one side of the panel, or are given for each."""

from math import isfinite

import numpy as np

from lampest.panel.panel import Array

PerLine = float | tuple[float, ...]


def as_tuple(value: PerLine) -> tuple[float, ...]:
    """All numbers, be it one."""
    return value if isinstance(value, tuple) else (value,)


def lines_text(value: PerLine) -> str:
    """'10000 ohm', or 'from 980 to 1020 ohm' where lines differ."""
    numbers = as_tuple(value)
    low, high = min(numbers), max(numbers)
    return f"{low:g} ohm" if low == high else f"from {low:g} to {high:g} ohm"


def check_lines(name: str, value: PerLine, least: float, open_end: bool = False) -> None:
    """Raise ValueError unless every number is finite and at least `least`, or above it with an open end."""
    for number in as_tuple(value):
        if not isfinite(number) or number < least or (open_end and number == least):
            bound = "positive" if open_end else "zero or positive"
            raise ValueError(f"{name} must be {bound} and finite")


def per_line(name: str, value: PerLine, lines: int) -> Array:
    """(lines) the number for every line. Raises ValueError where a list has another length."""
    if not isinstance(value, tuple):
        return np.full(lines, value)
    if len(value) != lines:
        raise ValueError(f"{name} lists {len(value)} numbers, but there are {lines} such lines")
    return np.array(value)
