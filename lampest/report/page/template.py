"""What pages are made of: pictures, texts of figures, and a template in which whatever comes from a file is escaped."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined

from lampest.panel.panel import Array
from lampest.report.page.measures import Interval
from lampest.report.words import digits

NONE = "–"
HARD = "\N{NO-BREAK SPACE}"


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
        home = "lampest.report.page" if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)


def between(interval: Interval, unit: str = "", sign: str = "") -> str:
    """'2.13 (1.95 to 2.36) %', all with the decimals that the interval's length deserves, in brackets on one line."""
    value, lower, upper = (_together(part, interval, sign) for part in (interval.value, interval.lower, interval.upper))
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


def signed(interval: Interval, unit: str = "") -> str:
    """'+1.3 (+0.9 to +1.7) %'."""
    return between(interval, unit, "+")


def _together(value: float, interval: Interval, sign: str) -> str:
    """A number with two digits of an interval's length, but no more than three of the figure."""
    sizes = [size for size in (interval.upper - interval.lower, abs(interval.value)) if size > 0 and np.isfinite(size)]
    if not np.isfinite(value) or not sizes or not 1e-6 < min(sizes) < 1e6:
        return digits(value)
    length, size = np.floor(np.log10([sizes[0], max(sizes)])).astype(int)
    return f"{value:{sign},.{max(0, min(1 - length, 2 - size))}f}".replace("-", "−")


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """'gradient λ = 0.001' of the penalties used; median and range where they differ; empty where nothing is known."""
    found: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            found.setdefault(term, []).append(values)
    parts = [
        f"{term.replace('_', ' ')} λ = {_weight(np.concatenate(found[term]))}" for term in found if term != "misfit"
    ]
    return ", ".join(parts) or ("no penalty" if found else "")


def _weight(values: Array) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return NONE
    low, middle, high = (f"{value:.3g}" for value in (known.min(), np.median(known), known.max()))
    return middle if low == high else f"{middle} ({low} to {high})"


def frames_text(frames: Sequence[int]) -> str:
    """'3, 5 to 7'."""
    ends = np.flatnonzero(np.diff(frames) != 1) + 1
    runs = [(int(run[0]), int(run[-1])) for run in np.split(np.asarray(frames), ends)]
    texts = [f"{low}" if low == high else f"{low}{', ' if high == low + 1 else ' to '}{high}" for low, high in runs]
    return ", ".join(texts)
