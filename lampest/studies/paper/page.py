"""`lampest study paper`: the paper's figures and table compared with ours, as one HTML file, pictures and numbers.csv.

Figures show the published numbers as marks or in words beside the results of our scenes.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from lampest.panel.panel import Array, Panel
from lampest.panel.response import Film, ratio_from_pressure, relative_change_from_pressure
from lampest.report.compare import Table
from lampest.report.page.page import filled
from lampest.report.plots import style
from lampest.report.plots.maps import Tile, banded_scale, maps_figure
from lampest.report.words import digits
from lampest.studies.paper.sides import FILE, MEASURED, Published, Side, StepsSeen, all_sides, read_published
from lampest.studies.study import OnStep, Row, Study, named_values

CHANGE = "relative change of resistance [%]"
# Of some steps: quantity, unit, the field of the published row, and of what was seen.
STEPS = (
    (("data error", "%", "error_percent", "error"), ("its standard deviation", "%", "error_sd_percent", "error_sd")),
    (("time", "s", "time_s", "time"),),
)
COLOURS = ("#222222", "#0072B2", "#E69F00", "#009E73")


class Paper(NamedTuple):
    """Published numbers and ours; figures : by the names of their files."""

    published: Published
    names: tuple[str, ...]
    numbers: list["PublishedNumber"]
    figures: dict[str, Figure]


def paper_study(
    folder: Path, jobs: int | None, further: Callable[[Side, Published], Side] | None = None
) -> Study[Published, Paper]:
    """Return the study; results that exist in the folder are reused.

    Parameters
    ----------
    jobs : int or None
        Processes, None for all cores.
    further : callable or None
        Makes a third side of the paper's panel.
    """

    def measured(published: Published, on_step: OnStep) -> Paper:
        sides = all_sides(folder, published, jobs, on_step)
        sides += (further(sides[1], published),) if further else ()
        names = tuple(side.name for side in sides)
        pictures = {"fig1e": response_figure(published), "fig2": bending_figure(published)}
        for side in sides:
            for name, tiles in tiles_of(side, published).items():
                if name != "fig6" or side in sides[:2]:  # the loads of a third side are those of the paper's panel
                    pictures[f"{name}_{side.word}"] = tiles_figure(tiles, side.panel, side.name)
        return Paper(published, names, list(published_beside(sides, published)), pictures)

    return Study(
        "numbers",
        "cases",
        str(FILE),
        read_published,
        style.verbatim()(measured),
        rows=rows,
        figures=lambda paper: paper.figures,
        texts=lambda paper: {"paper.html": page_of(paper)},
    )


def rows(paper: Paper) -> list[Row]:
    """Return every published number with ours, a column for each side."""
    beside = [dict(zip(paper.names, number.ours, strict=True)) for number in paper.numbers]
    names = ("figure", "quantity", "unit", "published")
    return [Row(**named_values(number, *names), **ours) for number, ours in zip(paper.numbers, beside, strict=True)]


def page_of(paper: Paper) -> str:
    """Return the self-contained page."""
    names = paper.names

    def of(figure: str, *, times: bool = False) -> list[PublishedNumber]:
        chosen = [row for row in paper.numbers if row.quantity.endswith(": time") == times]
        return [row for row in chosen if row.figure.startswith(figure)]

    checked = of("Fig. 8") + [row for row in of("Table I") if row.quantity.endswith("data error")]
    set_beside = ("Fig. 8", "Fig. 9", "Table I")
    sheets = {figure: sheet(of(figure), ("lampest",)) for figure in ("Fig. 1", "Fig. 2")}
    sheets |= {figure: sheet(of(figure), names) for figure in set_beside}
    return filled(
        "lampest.studies.paper",
        names=names,
        places=paper.published.places,
        uris={word: style.data_uri(figure, "png") for word, figure in paper.figures.items()},
        sheets=sheets | {"times": sheet(of("Table I", times=True), names)},
        counts={figure: counts(of(figure), names) for figure in set_beside} | {"all": counts(checked, names)},
    )


class PublishedNumber(NamedTuple):
    """A published number and ours; ours : one for each side, NaN if unavailable."""

    figure: str
    quantity: str
    unit: str
    published: float
    ours: tuple[float, ...]

    def reproduced(self, number: int) -> bool:
        """Return whether ours lies within a quarter of the published number."""
        return abs(self.ours[number] - self.published) <= 0.25 * abs(self.published)


def published_beside(sides: Sequence[Side], published: Published) -> Iterator[PublishedNumber]:
    """Yield every number: ranges of maps, cells that mouths cover, data errors, times, lampest's response read back.

    Times are those of another program on another machine; the response is the same on every side.
    """

    def row(place: str, name: str, unit: str, number: float, *ours: Any) -> PublishedNumber:
        each = ours if len(ours) == len(sides) else ours * len(sides)
        return PublishedNumber(place, name, unit, float(number), tuple(map(float, each)))

    for extremes in published.ranges:
        place, changes = f"Fig. 8-{extremes.letter}", [side.change(extremes.method) for side in sides]
        yield row(place, f"{extremes.method}, smallest change", "%", extremes.low, *map(np.nanmin, changes))
        yield row(place, f"{extremes.method}, largest change", "%", extremes.high, *map(np.nanmax, changes))
    for at, mouth in enumerate(published.mouths):
        seen = [covered(side.change(published.mouth_method, at)) for side in sides]
        for axis, ours in zip(("rows", "columns"), zip(*seen, strict=True), strict=True):
            name = f"mouth of {mouth.diameter_mm:g} mm, {axis} covered"
            yield row(f"Fig. 9-{mouth.letter}", name, "cells", mouth.cells, *ours)
    for kinds in STEPS:
        for step in published.errors:
            taken = [side.steps.get((step.method, step.steps), StepsSeen()) for side in sides]
            for what, unit, theirs, our in kinds:
                name = f"{step.method}, {step.steps} steps: {what}"
                yield row("Table I", name, unit, getattr(step, theirs), *(getattr(steps, our) for steps in taken))
    for point in published.changes:
        name = f"ΔR/R₀ at {point.kpa:g} kPa".replace("-", "−")
        yield row("Fig. 1-e", name, "%", point.percent, 100 * _change(point.kpa))
    for part in published.slopes:
        slope = (_change(part.to_kpa) - _change(part.from_kpa)) / (part.to_kpa - part.from_kpa)
        name = f"sensitivity from {part.from_kpa:g} to {part.to_kpa:g} kPa"
        yield row("Fig. 1-e, inset", name, "1/kPa", part.per_kpa, slope)
    for cell in published.bent_cells:
        film, where = Film(curvature_per_m=cell.curvature_per_m), f"at {cell.curvature_per_m:g} 1/m"
        unloaded, change = published.bent_cells[0].ohm * film.lowering, (1 + _change(40.0)) ** film.answer - 1
        yield row("Fig. 2-a", f"unloaded resistance {where}", "ohm", cell.ohm, unloaded)
        yield row("Fig. 2-d", f"ΔR/R₀ at 40 kPa, {where}", "%", cell.percent, 100 * change)


def _change(kpa: float) -> float:
    return float(relative_change_from_pressure(kpa))


def sheet(rows: Sequence[PublishedNumber], names: Sequence[str]) -> Table:
    """Return rows as texts; our numbers within a quarter of the published one are highlighted."""
    headers, texts, best = ("", "place", "published", *names), [], set()
    for place, row in enumerate(rows):
        ours = ["–" if np.isnan(number) else digits(number) for number in row.ours[: len(names)]]
        texts.append((f"{row.quantity} [{row.unit}]", row.figure, digits(row.published), *ours))
        best |= {(place, 3 + number) for number in range(len(names)) if row.reproduced(number)}
    return Table(headers, tuple(texts), best=frozenset(best))


def counts(rows: Sequence[PublishedNumber], names: Sequence[str]) -> str:
    """Return the number of reproduced rows of each side in words, such as '13 of 19 (clean scenes)'."""
    parts = [
        f"{sum(row.reproduced(number) for row in rows)} of {len(rows)} ({name})" for number, name in enumerate(names)
    ]
    return f"within a quarter of the published number: {', '.join(parts)}."


def response_figure(published: Published) -> Figure:
    """Draw figure 1-e with its inset: the response curve of lampest through the published numbers."""
    figure = style.new_figure(3.2)
    axes = figure.subplots()
    pressures = np.linspace(-10.0, 235.0, 981)
    axes.plot(pressures, 100 * relative_change_from_pressure(pressures), color=style.BLUE, lw=1.2, label="lampest")
    points = [(point.kpa, point.percent) for point in published.changes]
    axes.plot(*zip(*points, strict=True), "o", color=style.ORANGE, ms=4.5, label="published")
    style.dressed(axes, "pressure [kPa]", "relative change of resistance ΔR/R₀ [%]")
    axes.legend(fontsize=style.SMALL_POINT, frameon=False, loc="upper left", bbox_to_anchor=(0.12, 1.0))
    inset = axes.inset_axes((0.42, 0.38, 0.55, 0.52))
    fine = np.linspace(0, 60, 601)
    slope = np.gradient(relative_change_from_pressure(fine), fine)
    inset.plot(fine, slope, color=style.BLUE, lw=1.1)
    for part in published.slopes:
        inset.plot(
            [part.from_kpa, part.to_kpa], [part.per_kpa] * 2, color=style.ORANGE, lw=3, alpha=0.6, solid_capstyle="butt"
        )
    style.dressed(inset, "pressure [kPa]", "sensitivity S [1/kPa]")
    return figure


def bending_figure(published: Published) -> Figure:
    """Draw figures 2-a and 2-d: unloaded resistance over curvature, and the response of bent cells up to 40 kPa."""
    figure = style.new_figure(2.9)
    left, right = figure.subplots(1, 2)
    curvature = np.linspace(0, published.bent_cells[-1].curvature_per_m, 120)
    lowering = [Film(curvature_per_m=float(value)).lowering for value in curvature]
    unloaded = published.bent_cells[0].ohm * np.array(lowering)
    left.plot(curvature, unloaded, color=style.BLUE, lw=1.2, label="lampest")
    points = [(cell.curvature_per_m, cell.ohm) for cell in published.bent_cells]
    left.plot(*zip(*points, strict=True), "o", color=style.ORANGE, ms=4.5, label="published")
    left.set_yscale("log")
    left.set_yticks([300, 500, 1000, 2000, 3000], ["300", "500", "1000", "2000", "3000"])
    left.minorticks_off()
    left.legend(fontsize=style.SMALL_POINT, frameon=False)
    style.dressed(left, "curvature [1/m]", "unloaded resistance R₀ [ohm]")
    pressures = np.linspace(0.0, 40.0, 161)
    for cell, colour in zip(published.bent_cells, COLOURS, strict=True):
        answer = Film(curvature_per_m=cell.curvature_per_m).answer
        change = 100 * (ratio_from_pressure(pressures) ** answer - 1)
        name = "flat" if cell.radius_mm is None else f"radius {cell.radius_mm:g} mm"
        right.plot(pressures, change, color=colour, lw=1.1, label=name)
        right.plot(40, cell.percent, "o", color=colour, ms=4.5, clip_on=False)
    right.legend(fontsize=style.SMALL_POINT, frameon=False, title="dots: published", title_fontsize=style.SMALL_POINT)
    style.dressed(right, "pressure [kPa]", CHANGE)
    return figure


def tiles_of(side: Side, published: Published) -> dict[str, list[Tile]]:
    """Return the maps of each figure: 6, six measured loads; 8, six methods on one frame; 9, two mouths."""
    tiles: dict[str, list[Tile]] = {"fig6": [], "fig8": [], "fig9": []}
    for load in published.loads:
        change, felt = side.loads[load.letter]
        note = f"measured {_span(change)} %\nfilm feels {_span(np.array(felt))} kPa"
        tiles["fig6"].append(Tile(f"({load.letter}) {load.condition}", change, note))
    for extremes in published.ranges:
        change = side.change(extremes.method)
        method = extremes.method.replace(MEASURED, "measured two-point")
        note = f"ours {_span(change)} %\npaper {_span(np.array([extremes.low, extremes.high]))} %"
        tiles["fig8"].append(Tile(f"({extremes.letter}) {method}", change, note))
    for number, mouth in enumerate(published.mouths):
        change = side.change(published.mouth_method, number)
        title = f"({mouth.letter}) mouth of {mouth.diameter_mm:g} mm, {published.mouth_method}"
        note = f"ours {' × '.join(map(str, covered(change)))} cells, paper {mouth.cells} × {mouth.cells}"
        tiles["fig9"].append(Tile(title, change, note))
    return tiles


def covered(change: Array) -> tuple[int, int]:
    """Return the numbers of rows and columns with a cell that fell by more than half of the largest fall."""
    fallen = change < 0.5 * np.nanmin(change)
    return int(np.sum(fallen.any(axis=1))), int(np.sum(fallen.any(axis=0)))


def tiles_figure(tiles: Sequence[Tile], panel: Panel, title: str) -> Figure:
    """Draw contoured maps on one scale of ±100 %, with arrows for larger changes."""
    largest = max(float(np.nanmax(tile.values)) for tile in tiles if tile.values is not None)
    scale = banded_scale([np.array([-100.0, 100.0, max(largest, 100.0)])], CHANGE)
    return maps_figure(tiles, panel, scale, title, contoured=True)


def _span(values: Array) -> str:
    return " … ".join(style.change_text(float(end(values)), 100.0) for end in (np.nanmin, np.nanmax))
