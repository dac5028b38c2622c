"""`lampest study paper`: the paper's figures and table beside ours as one HTML file, with pictures and numbers.csv."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lampest.files.whole import write_whole
from lampest.loads.response import relative_change_from_pressure
from lampest.panel.film import Film
from lampest.recording.datasets import folder as shipped_folder
from lampest.report.compare import Table
from lampest.report.page.template import filled
from lampest.report.plots.style import data_uri, plain_number, save, verbatim
from lampest.report.words import digits
from lampest.studies.paper import figures
from lampest.studies.paper.sides import Published, Side, all_sides, published_numbers
from lampest.studies.study import Reported, comma_separated


def write_paper(numbers: Path | None, folder: Path, jobs: int | None, on_case: Callable[[int, int], None]) -> Reported:
    """Solve, draw and write all of it into a folder; what was solved there before is taken from it.

    numbers : a file of published ones, or None. Raises InputError where a shipped file is missing, a case fails, or the
    folder cannot be written.
    """
    published = published_numbers(numbers)
    return Reported((), write_page(folder, all_sides(shipped_folder(), folder, published, jobs, on_case), published))


def write_page(folder: Path, sides: Sequence[Side], published: Published) -> tuple[Path, ...]:
    """Write paper.html, numbers.csv and every picture as PNG; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    names = tuple(side.name for side in sides)
    numbers = [*map_ranges(sides, published), *covered_cells(sides, published), *data_errors(sides, published)]
    times, own = step_times(sides, published), built_in(published, len(sides))

    def rows(figure: str) -> list[PublishedNumber]:
        return [row for row in (*numbers, *own) if row.figure.startswith(figure)]

    with verbatim():
        drawn = {"fig1e": figures.response_figure(published), "fig2": figures.bending_figure(published)}
        for side in sides:
            if side.word != "solver":  # its scenes are those of the paper's panel
                drawn[f"fig6_{side.word}"] = figures.loads_figure(side, published)
            drawn[f"fig8_{side.word}"] = figures.methods_figure(side, published)
            drawn[f"fig9_{side.word}"] = figures.mouths_figure(side, published)
        pictures = {folder / f"{word}.png": figure for word, figure in drawn.items()}
        for file, figure in pictures.items():
            save(figure, file)
        uris = {word: data_uri(figure, "png") for word, figure in drawn.items()}
    checked = [row for row in numbers if row.figure.startswith("Fig. 8") or row.quantity.endswith("data error")]
    sheets = {figure: sheet(rows(figure), ("lampest",)) for figure in ("Fig. 1", "Fig. 2")}
    sheets |= {figure: sheet(rows(figure), names) for figure in ("Fig. 8", "Fig. 9", "Table I")}
    counted = {figure: counts(rows(figure), names) for figure in ("Fig. 8", "Fig. 9", "Table I")}
    text = filled(
        "lampest.studies.paper",
        names=names,
        places=published.places,
        uris=uris,
        sheets=sheets | {"times": sheet(times, names)},
        counts=counted | {"all": counts(checked, names)},
    )
    lines: list[list[object]] = [["figure", "quantity", "unit", "published", *names]]
    lines += [[row.figure, row.quantity, row.unit, row.published, *row.ours] for row in (*numbers, *times, *own)]
    texts = {folder / "paper.html": text, folder / "numbers.csv": comma_separated(lines)}
    for file, content in texts.items():
        write_whole(file, content)
    return (*texts, *pictures)


@dataclass(frozen=True)
class PublishedNumber:
    """A published number and ours. ours : one for each side, NaN where it is not to be had."""

    figure: str
    quantity: str
    unit: str
    published: float
    ours: tuple[float, ...]

    def reproduced(self, number: int) -> bool:
        """Whether ours lies within a quarter of the published number."""
        return abs(self.ours[number] - self.published) <= 0.25 * abs(self.published)


def built_in(published: Published, sides: int) -> list[PublishedNumber]:
    """Figures 1-e and 2: what lampest's response was made from, read back; the same on every side."""
    found = [
        ("Fig. 1-e", f"ΔR/R₀ at {plain_number(one.kpa)} kPa", "%", one.percent, 100 * _change(one.kpa))
        for one in published.changes
    ]
    for part in published.slopes:
        slope = (_change(part.to_kpa) - _change(part.from_kpa)) / (part.to_kpa - part.from_kpa)
        name = f"sensitivity from {part.from_kpa:g} to {part.to_kpa:g} kPa"
        found.append(("Fig. 1-e, inset", name, "1/kPa", part.per_kpa, slope))
    flat = published.bent_cells[0].ohm
    for cell in published.bent_cells:
        film, at = Film(curvature_per_m=cell.curvature_per_m), f"at {cell.curvature_per_m:g} 1/m"
        found.append(("Fig. 2-a", f"unloaded resistance {at}", "ohm", cell.ohm, flat * film.lowering))
        change = 100 * ((1 + _change(40.0)) ** film.answer - 1)
        found.append(("Fig. 2-d", f"ΔR/R₀ at 40 kPa, {at}", "%", cell.percent, change))
    return [
        PublishedNumber(place, name, unit, number, (float(ours),) * sides) for place, name, unit, number, ours in found
    ]


def _change(kpa: float) -> float:
    return float(relative_change_from_pressure(kpa))


def map_ranges(sides: Sequence[Side], published: Published) -> list[PublishedNumber]:
    """Figure 8: the smallest and the largest change of every map."""
    rows = []
    for one in published.ranges:
        changes = [side.change(one.method) for side in sides]
        for name, value, end in (("smallest", one.low, np.nanmin), ("largest", one.high, np.nanmax)):
            ours = tuple(float(end(change)) for change in changes)
            rows.append(PublishedNumber(f"Fig. 8-{one.letter}", f"{one.method}, {name} change", "%", value, ours))
    return rows


def covered_cells(sides: Sequence[Side], published: Published) -> list[PublishedNumber]:
    """Figure 9: how many rows and columns a mouth covers."""
    rows = []
    for number, mouth in enumerate(published.mouths):
        seen = [figures.covered(side.change(published.mouth_method, number)) for side in sides]
        for name, place in (("rows", 0), ("columns", 1)):
            quantity = f"mouth of {mouth.diameter_mm:g} mm, {name} covered"
            ours = tuple(float(one[place]) for one in seen)
            rows.append(PublishedNumber(f"Fig. 9-{mouth.letter}", quantity, "cells", float(mouth.cells), ours))
    return rows


def data_errors(sides: Sequence[Side], published: Published) -> list[PublishedNumber]:
    """Table I: data errors, mean and standard deviation over the readings of all steps."""
    rows = []
    for row in published.errors:
        seen = [side.steps(row.method, row.steps) for side in sides]
        name = f"{row.method}, {row.steps} steps"
        means, deviations = tuple(one.error for one in seen), tuple(one.error_sd for one in seen)
        rows.append(PublishedNumber("Table I", f"{name}: data error", "%", row.error_percent, means))
        rows.append(
            PublishedNumber("Table I", f"{name}: its standard deviation", "%", row.error_sd_percent, deviations)
        )
    return rows


def step_times(sides: Sequence[Side], published: Published) -> list[PublishedNumber]:
    """Table I: time of a step. Ours is another program on another machine."""
    rows = []
    for row in published.errors:
        ours = tuple(side.steps(row.method, row.steps).time for side in sides)
        rows.append(PublishedNumber("Table I", f"{row.method}, {row.steps} steps: time", "s", row.time_s, ours))
    return rows


def sheet(rows: Sequence[PublishedNumber], names: Sequence[str]) -> Table:
    """Rows as texts; set off are those of ours that lie within a quarter of the published number."""
    headers, texts, best = ("", "place", "published", *names), [], set()
    for place, row in enumerate(rows):
        ours = ["–" if np.isnan(one) else digits(one) for one in row.ours[: len(names)]]
        texts.append((f"{row.quantity} [{row.unit}]", row.figure, digits(row.published), *ours))
        best |= {(place, 3 + number) for number in range(len(names)) if row.reproduced(number)}
    return Table(headers, tuple(texts), best=frozenset(best))


def counts(rows: Sequence[PublishedNumber], names: Sequence[str]) -> str:
    """'13 of 19 within a quarter (clean scenes), …' over rows that all sides have."""
    parts = [
        f"{sum(row.reproduced(number) for row in rows)} of {len(rows)} ({name})" for number, name in enumerate(names)
    ]
    return f"within a quarter of the published number: {', '.join(parts)}."
