"""Figures as pages write them, and the template in which whatever comes from a file is escaped."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined

from lampest.panel.panel import Array
from lampest.report.page.measures import Interval
from lampest.report.words import digits

NONE = "–"
HARD = "\N{NO-BREAK SPACE}"


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
    """'2.13 (1.95 to 2.36) %': two digits of the interval's length, three of the figure at most, on one line.

    sign : '+' of differences, before positive numbers.
    """
    length = interval.upper - interval.lower
    like = max(length, abs(interval.value) / 10) if np.isfinite(length) else None
    ends = (interval.value, interval.lower, interval.upper)
    value, lower, upper = (sign * (end > 0) + digits(end, 2, like) for end in ends)
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """'gradient λ = 0.001' of the penalties used; median and range where they differ; empty where nothing is known."""
    found: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            found.setdefault(term, []).append(values[np.isfinite(values)])
    parts = []
    for term, each in found.items():
        known, text = np.concatenate(each), NONE
        if known.size:
            low, text, high = (f"{value:.3g}" for value in (known.min(), np.median(known), known.max()))
            text += f" ({low} to {high})" if low != high else ""
        parts += [f"{term.replace('_', ' ')} λ = {text}"] if term != "misfit" else []
    return ", ".join(parts) or ("no penalty" if found else "")


def frames_text(frames: Sequence[int]) -> str:
    """'3, 5 to 7'."""
    runs = np.split(np.asarray(frames), np.flatnonzero(np.diff(frames) != 1) + 1)
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
