"""What pages are made of: tables, pictures, and a template in which whatever comes from a file is escaped."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined

from lampest.panel.panel import Array
from lampest.report.page.measures import Interval

SHARED = "lampest.report.page"
NONE = "–"
HARD = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class Sheet:
    """A table: headers, then rows whose first cell is their name; `best` : (row, column) of cells to set off."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True)
class Illustration:
    """An image as text, what it shows in words, its caption; wide : over the whole page."""

    uri: str
    alternative: str
    caption: str
    wide: bool = False


def filled(package: str, **values: Any) -> str:
    """`page.html` of a package as HTML; it may take `parts.html`, the look and the tables of all pages."""

    def source(name: str) -> str:
        home = SHARED if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)


def digits(value: float, count: int = 3) -> str:
    """A number with so many significant digits, without an exponent wherever that is short: '0.0012', '3,050'."""
    if not np.isfinite(value):
        return "not a number" if np.isnan(value) else ("−∞" if value < 0 else "∞")
    if value and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{count - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", "−")
    places = max(0, count - 1 - int(np.floor(np.log10(abs(value))))) if value else 0
    return f"{value:,.{places}f}".replace("-", "−")


def between(interval: Interval, unit: str = "") -> str:
    """'2.13 (1.95 to 2.36) %'; all three with the decimals that the interval's length deserves."""
    return _between(interval, unit, "")


def signed(interval: Interval, unit: str = "") -> str:
    """'+1.3 (+0.9 to +1.7) %'."""
    return _between(interval, unit, "+")


def _between(interval: Interval, unit: str, sign: str) -> str:
    """No line is broken within the brackets."""
    value, lower, upper = (_together(part, interval, sign) for part in (interval.value, interval.lower, interval.upper))
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


def _together(value: float, interval: Interval, sign: str) -> str:
    """A number with the decimals that an interval's length deserves: two digits of it, three of the figure."""
    sizes = [size for size in (interval.upper - interval.lower, abs(interval.value)) if size > 0 and np.isfinite(size)]
    if not np.isfinite(value) or not sizes or not 1e-6 < min(sizes) < 1e6:
        return digits(value)
    places = min(
        max(0, 1 - int(np.floor(np.log10(sizes[0])))), max(0, 2 - int(np.floor(np.log10(max(sizes[-1], sizes[0])))))
    )
    return f"{value:{sign},.{places}f}".replace("-", "−")


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """'gradient λ = 0.001' of the penalties used; median and range where they differ; empty where nothing is known."""
    found: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            found.setdefault(term, []).append(values)
    parts = [
        f"{term.replace('_', ' ')} λ = {_weight(np.concatenate(values))}"
        for term, values in found.items()
        if term != "misfit"
    ]
    return ", ".join(parts) or ("no penalty" if found else "")


def _weight(values: Array) -> str:
    values = values[np.isfinite(values)]
    if values.size == 0:
        return NONE
    low, middle, high = (f"{value:.3g}" for value in (values.min(), np.median(values), values.max()))
    return middle if low == high else f"{middle} ({low} to {high})"


def frames_text(frames: Sequence[int]) -> str:
    """'3, 5 to 7'."""
    runs: list[list[int]] = []
    for frame in frames:
        if runs and frame == runs[-1][-1] + 1:
            runs[-1].append(frame)
        else:
            runs.append([frame])
    return ", ".join(
        str(run[0]) if len(run) == 1 else f"{run[0]}{', ' if len(run) == 2 else ' to '}{run[-1]}" for run in runs
    )


def listed(names: Sequence[str]) -> str:
    """'A', 'A and B', 'A, B and C'."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
