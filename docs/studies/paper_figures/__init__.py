"""Figures and table of the paper compared with ours, for `docs.studies.paper`.

The comparison is written as one HTML file, pictures and numbers.csv. The shipped scenes are solved
by the five methods. Figures show the published numbers as marks or in words, together with ours.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.apps.page.page import filled
from lampest.apps.studies import study
from lampest.apps.studies.study import OnStep, read_settings
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Film, ratio_from_pressure
from lampest.recording.datasets import folder as shipped_folder
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation import run as simulated
from lampest.report.compare import Row, Steps, Table, compare
from lampest.report.plots import style
from lampest.report.plots.maps import Tile, banded_scale, maps_figure
from lampest.report.strongest import mean_reading, percent_change, strongest_readings
from lampest.report.words import digits, text_of
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import Results, read_results

MEASURED = "measured"
# Finds the optima that the files' formulations find, sooner.
FASTEST = "formulation={kind: reduced, joint: true}"
FILE = Path(__file__).with_name("published.yaml")
# Shipped recording → as the paper's panel has it.
MOUTHS = {"lamprey_35mm": "paper_35mm", "lamprey_25mm": "paper_25mm"}
CHANGE = "relative change of resistance [%]"
# Quantity and unit, and where it is: the field of the published row, the header of the table of
# `lampest compare`.
ERROR = ("data error", "%", "error_percent", "data error mean [%]")
ERROR_SD = ("its standard deviation", "%", "error_sd_percent", "data error sd [%]")
TIME = ("time", "s", "time_s", "solve time mean [s]")
COLOURS = ("#222222", "#0072B2", "#E69F00", "#009E73")


class ChangeAt(NamedTuple):
    """Figure 1-e: ΔR/R₀ of a flat cell in percent at a pressure in kPa."""

    kpa: float
    percent: float


class SlopeOver(NamedTuple):
    """Inset with δ(ΔR/R₀)/δP per kPa between two pressures in kPa."""

    from_kpa: float
    to_kpa: float
    per_kpa: float


class BentCell(NamedTuple):
    """Figure 2, a bent cell: unloaded resistance, and ΔR/R₀ in percent at 40 kPa."""

    curvature_per_m: float
    ohm: float
    percent: float
    radius_mm: float | None = None


class LoadMap(NamedTuple):
    """A map of figure 6: the load on the panel, and its shipped recording."""

    letter: str
    recording: str
    condition: str


class RangeMap(NamedTuple):
    """A map of figure 8: smallest and largest relative change in percent."""

    letter: str
    method: str
    low: float
    high: float


class MouthMap(NamedTuple):
    """A map of figure 9: `cells` by `cells` of the grid are covered."""

    letter: str
    diameter_mm: float
    cells: int


class ErrorRow(NamedTuple):
    """A row of table I: time of a step in s, and |f(r) − R_m|/R_m in percent.

    A number is given by its mean and standard deviation.
    """

    method: str
    steps: Steps
    time_s: float
    error_percent: float
    error_sd_percent: float
    time_sd_s: float | None = None


class Published(NamedTuple):
    """All published numbers; `places` are their places in the paper, by subject."""

    schema: Literal[1]
    places: dict[str, str]
    changes: tuple[ChangeAt, ...]
    slopes: tuple[SlopeOver, ...]
    bent_cells: tuple[BentCell, ...]
    loads: tuple[LoadMap, ...]
    ranges: tuple[RangeMap, ...]
    mouth_method: str
    mouths: tuple[MouthMap, ...]
    errors: tuple[ErrorRow, ...]


read_published = read_settings(Published)


@dataclass(frozen=True, eq=False)
class Side:
    """A set of scenes that is compared with the paper.

    Attributes
    ----------
    name, word : str
        Name on the page and in files.
    mouths : sequence of Recording
        The large and the small one.
    loads : mapping
        Letter of figure 6 → relative change in percent, and pressure of the film in kPa, (rows,
        columns) each.
    changes : mapping
        (method, number of the mouth) → relative change in percent of the shown frame, (rows,
        columns). Measured ones include the series resistance, as in the paper.
    steps : mapping
        (method, steps) → row of `lampest compare` of the large mouth.
    """

    name: str
    word: str
    mouths: Sequence[Recording]
    loads: Mapping[str, tuple[Array, Array]]
    changes: Mapping[tuple[str, int], Array]
    steps: Mapping[tuple[str, Steps], Row]

    @property
    def panel(self) -> Panel:
        """Panel of the recordings."""
        return self.mouths[0].scene.panel

    def change(self, method: str, number: int = 0) -> Array:
        """Return a relative change. Raises InputError if there is none."""
        if (method, number) not in self.changes:
            raise InputError(f"{self.name}: there are no results of {method}")
        return self.changes[method, number]


def all_sides(
    folder: Path, published: Published, jobs: int | None, on_case: OnStep
) -> tuple[Side, ...]:
    """Simulate and solve all scenes, reusing results in the folder.

    Raises InputError for a missing shipped file, a failed case, and a folder that cannot be
    written.
    """
    configs = shipped_folder() / "configs"
    data = shipped_folder() / "data"

    def made(name: str) -> Path:
        """Return the recording of the paper's panel, simulated once."""
        word = MOUTHS.get(name, f"real_{name}")
        file = folder / "recordings" / f"{word}.h5"
        if not file.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            simulated(configs / f"{word}.yaml", file)
        return file

    def side(name: str, word: str, run: str, recorded: Callable[[str], Path]) -> Side:
        files = [recorded(mouth) for mouth in MOUTHS]
        named = f"recordings=[{', '.join(repr(str(file.resolve())) for file in files)}]"
        cases = read_run(configs / run, (FASTEST, named))
        report = run_batch(
            cases,
            folder / word,
            local(jobs, len(cases.cases)),
            on_frames=lambda done, frames, left_s: on_case(done, frames),
        )
        if report.results is None or report.failed:
            raise InputError(
                f"{configs / run}: {'; '.join(f'{case}: {why}' for case, why in report.failed)}"
            )
        mouths = [Recording.load(file) for file in files]
        loads = {
            load.letter: load_of(Recording.load(recorded(load.recording)))
            for load in published.loads
        }
        return shown(Side(name, word, mouths, loads, *optima(read_results(report.results), mouths)))

    clean = side("clean scenes", "clean", "table1.yaml", lambda name: data / f"{name}.h5")
    return clean, side("paper's panel", "panel", "paper_run.yaml", made)


def optima(
    results: Results, mouths: Sequence[Recording]
) -> tuple[dict[Any, Array], dict[Any, Row]]:
    """Return the maps of both mouths, and the table of the large one.

    Returns
    -------
    changes : dict
        Changes of all frames in percent by (estimator, number of the mouth).
    rows : dict
        Rows of `lampest compare` for the large mouth by (estimator, steps).
    """
    numbers = {mouth.name: number for number, mouth in enumerate(mouths)}
    changes = {
        (case.estimator, numbers[case.recording]): np.asarray(case.relative_change)
        for case in results.cases
    }
    rows = (row for row in compare(results) if numbers[row["recording"]] == 0)
    return changes, {(row["estimator"], row["steps"]): row for row in rows}


def shown(side: Side) -> Side:
    """Return the side with changes of its shown frame and measured ones.

    The shown frame of a clean side is the strongest, else the first.
    """
    changes = dict(side.changes)
    for number, mouth in enumerate(side.mouths):
        measured = mouth.measured_frames()
        frame = shown_change(mouth)[0] if side.word == "clean" else measured[0]
        place = int(np.searchsorted(measured, frame))
        changes |= {
            key: np.asarray(change[place])
            for key, change in side.changes.items()
            if key[1] == number
        }
        changes[MEASURED, number] = percent_change(mouth.recorded[frame], unloaded(mouth))
    return replace(side, changes=changes)


def shown_change(recording: Recording) -> tuple[int, Array]:
    """Return the strongest frame of a recording with unloaded frames.

    Returns
    -------
    frame : int
    change : array, shape (rows, columns)
        Change of the readings in percent, as recorded.
    """
    change = strongest_readings(recording)
    assert change is not None
    return change


def load_of(recording: Recording) -> tuple[Array, Array]:
    """Return the strongest frame of a simulated recording and its load.

    Returns
    -------
    change : array, shape (rows, columns)
        Change of the readings in percent.
    pressure : array, shape (rows, columns)
        True pressure in kPa.
    """
    frame, change = shown_change(recording)
    assert recording.truth_pressure is not None
    return change, recording.truth_pressure[frame]


def unloaded(recording: Recording) -> Array:
    """Return the mean of the unloaded frames as recorded, (rows, columns) ohm."""
    return mean_reading(recording.recorded[recording.role == UNLOADED])


class Paper(NamedTuple):
    """Published numbers and ours, and the figures by the names of their files."""

    published: Published
    names: tuple[str, ...]
    numbers: list["PublishedNumber"]
    figures: dict[str, Figure]


def paper_study(
    folder: Path, jobs: int | None, further: Callable[[Side, Published], Side] | None = None
) -> study.Study[Published, Paper]:
    """Return the study; results that exist in the folder are reused.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    jobs : int or None
        Processes, None for all cores.
    further : callable or None
        Makes a third side of the paper's panel.
    """

    def measured(published: Published, on_step: OnStep) -> Paper:
        sides = all_sides(folder, published, jobs, on_step)
        sides += (further(sides[1], published),) if further else ()
        pictures = {"fig1e": response_figure(published), "fig2": bending_figure(published)}
        for side in sides:
            for name, tiles in tiles_of(side, published).items():
                # The loads of a third side are those of the paper's panel.
                if name != "fig6" or side in sides[:2]:
                    pictures[f"{name}_{side.word}"] = tiles_figure(tiles, side.panel, side.name)
        return Paper(
            published,
            tuple(side.name for side in sides),
            [*published_beside(sides, published)],
            pictures,
        )

    return study.Study(
        "numbers",
        "cases",
        str(FILE),
        read_published,
        style.verbatim()(measured),
        rows=rows,
        figures=lambda paper: paper.figures,
        texts=lambda paper: {"paper.html": page_of(paper)},
    )


def rows(paper: Paper) -> list[study.Row]:
    """Return every published number with ours, a column for each side."""
    names = ("figure", "quantity", "unit", "published", *paper.names)
    return [
        study.Row(**dict(zip(names, (*number[:4], *number.ours), strict=True)))
        for number in paper.numbers
    ]


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
        "docs.studies.paper_figures",
        names=names,
        places=paper.published.places,
        uris={word: style.data_uri(figure) for word, figure in paper.figures.items()},
        sheets=sheets | {"times": sheet(of("Table I", times=True), names)},
        counts={figure: counts(of(figure), names) for figure in set_beside}
        | {"all": counts(checked, names)},
    )


class PublishedNumber(NamedTuple):
    """A published number and ours for each side, NaN if unavailable."""

    figure: str
    quantity: str
    unit: str
    published: float
    ours: tuple[float, ...]

    def reproduced(self, number: int) -> bool:
        """Return whether ours lies within a quarter of the published number."""
        return abs(self.ours[number] - self.published) <= 0.25 * abs(self.published)


def published_beside(sides: Sequence[Side], published: Published) -> Iterator[PublishedNumber]:
    """Yield every published number with ours.

    The numbers are ranges of maps, cells that mouths cover, data errors, times, and lampest's
    response read back. Times are those of another program on another machine; the response is the
    same on every side.
    """
    yield from _maps_beside(sides, published)
    yield from _table_beside(sides, published)
    for place, name, unit, number, ours in _response_beside(published):
        yield PublishedNumber(place, name, unit, float(number), (float(ours),) * len(sides))


def _maps_beside(sides: Sequence[Side], published: Published) -> Iterator[PublishedNumber]:
    """Yield the ranges of the maps, and the numbers of cells that mouths cover."""
    for extremes in published.ranges:
        place = f"Fig. 8-{extremes.letter}"
        changes = [side.change(extremes.method) for side in sides]
        smallest = tuple(float(np.nanmin(change)) for change in changes)
        largest = tuple(float(np.nanmax(change)) for change in changes)
        name = f"{extremes.method}, smallest change"
        yield PublishedNumber(place, name, "%", float(extremes.low), smallest)
        name = f"{extremes.method}, largest change"
        yield PublishedNumber(place, name, "%", float(extremes.high), largest)
    for at, mouth in enumerate(published.mouths):
        counts_of_sides = [covered(side.change(published.mouth_method, at)) for side in sides]
        by_axis = zip(*counts_of_sides, strict=True)
        for axis, ours in zip(("rows", "columns"), by_axis, strict=True):
            name = f"mouth of {mouth.diameter_mm:g} mm, {axis} covered"
            place = f"Fig. 9-{mouth.letter}"
            numbers = tuple(map(float, ours))
            yield PublishedNumber(place, name, "cells", float(mouth.cells), numbers)


def _table_beside(sides: Sequence[Side], published: Published) -> Iterator[PublishedNumber]:
    """Yield the data errors of Table I, then its times; NaN where a side has none."""
    for kinds in ((ERROR, ERROR_SD), (TIME,)):
        for step in published.errors:
            figures = [side.steps.get((step.method, step.steps), {}) for side in sides]
            for kind, unit, theirs, header in kinds:
                values = (figure.get(header) for figure in figures)
                ours = tuple(np.nan if value is None else float(value) for value in values)
                name = f"{step.method}, {step.steps} steps: {kind}"
                yield PublishedNumber("Table I", name, unit, float(getattr(step, theirs)), ours)


def _response_beside(published: Published) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield place, name, unit, published and own number of the film's response."""
    for point in published.changes:
        name = f"ΔR/R₀ at {point.kpa:g} kPa".replace("-", "−")
        yield "Fig. 1-e", name, "%", point.percent, 100 * _change(point.kpa)
    for part in published.slopes:
        slope = (_change(part.to_kpa) - _change(part.from_kpa)) / (part.to_kpa - part.from_kpa)
        name = f"sensitivity from {part.from_kpa:g} to {part.to_kpa:g} kPa"
        yield "Fig. 1-e, inset", name, "1/kPa", part.per_kpa, slope
    for cell in published.bent_cells:
        film = Film(curvature_per_m=cell.curvature_per_m)
        where = f"at {cell.curvature_per_m:g} 1/m"
        unloaded = published.bent_cells[0].ohm * film.lowering
        change = (1 + _change(40.0)) ** film.answer - 1
        yield "Fig. 2-a", f"unloaded resistance {where}", "ohm", cell.ohm, unloaded
        yield "Fig. 2-d", f"ΔR/R₀ at 40 kPa, {where}", "%", cell.percent, 100 * change


def _change(kpa: float) -> float:
    return float(ratio_from_pressure(kpa)) - 1


def sheet(numbers: Sequence[PublishedNumber], names: Sequence[str]) -> Table:
    """Return numbers as texts; ours within a quarter of the published one are highlighted."""
    cells = tuple(
        (
            f"{row.quantity} [{row.unit}]",
            row.figure,
            digits(row.published),
            *(text_of(our) or "–" for our in row.ours),
        )
        for row in numbers
    )
    places = np.ndindex(len(numbers), len(names))
    best = frozenset((row, 3 + side) for row, side in places if numbers[row].reproduced(side))
    headers = ("", "place", "published", *names)
    return Table(headers, tuple(line[: len(headers)] for line in cells), best=best)


def counts(rows: Sequence[PublishedNumber], names: Sequence[str]) -> str:
    """Return the number of reproduced rows of each side in words.

    An example is '13 of 19 (clean scenes)'.
    """
    parts = [
        f"{sum(row.reproduced(number) for row in rows)} of {len(rows)} ({name})"
        for number, name in enumerate(names)
    ]
    return f"within a quarter of the published number: {', '.join(parts)}."


def _through(axes: Axes, x: Array, y: Array, points: Sequence[tuple[float, float]]) -> None:
    """Draw lampest's curve and published points."""
    axes.plot(x, y, color=style.BLUE, lw=1.2, label="lampest")
    axes.plot(*zip(*points, strict=True), "o", color=style.ORANGE, ms=4.5, label="published")


def response_figure(published: Published) -> Figure:
    """Draw figure 1-e with its inset.

    The figure shows the response curve of lampest through the published numbers.
    """
    figure = style.new_figure(3.2)
    axes = figure.subplots()
    pressures = np.linspace(-10.0, 235.0, 981)
    fine = np.linspace(0, 60, 601)
    _through(axes, pressures, 100 * (ratio_from_pressure(pressures) - 1), published.changes)
    style.dressed(axes, "pressure [kPa]", "relative change of resistance ΔR/R₀ [%]")
    axes.legend(
        fontsize=style.SMALL_POINT, frameon=False, loc="upper left", bbox_to_anchor=(0.12, 1.0)
    )
    inset = axes.inset_axes((0.42, 0.38, 0.55, 0.52))
    inset.plot(fine, np.gradient(ratio_from_pressure(fine), fine), color=style.BLUE, lw=1.1)
    look: dict[str, Any] = {"color": style.ORANGE, "lw": 3, "alpha": 0.6, "solid_capstyle": "butt"}
    for part in published.slopes:
        inset.plot([part.from_kpa, part.to_kpa], [part.per_kpa] * 2, **look)
    style.dressed(inset, "pressure [kPa]", "sensitivity S [1/kPa]")
    return figure


def bending_figure(published: Published) -> Figure:
    """Draw figures 2-a and 2-d.

    The left axes show unloaded resistance over curvature, the right ones the response of bent cells
    up to 40 kPa.
    """
    figure = style.new_figure(2.9)
    left, right = figure.subplots(1, 2)
    curvature = np.linspace(0, published.bent_cells[-1].curvature_per_m, 120)
    lowering = np.array([Film(curvature_per_m=float(value)).lowering for value in curvature])
    points = [(cell.curvature_per_m, cell.ohm) for cell in published.bent_cells]
    _through(left, curvature, published.bent_cells[0].ohm * lowering, points)
    left.set_yscale("log")
    left.set_yticks([300, 500, 1000, 2000, 3000], ["300", "500", "1000", "2000", "3000"])
    left.minorticks_off()
    left.legend(fontsize=style.SMALL_POINT, frameon=False)
    style.dressed(left, "curvature [1/m]", "unloaded resistance R₀ [ohm]")
    pressures = np.linspace(0.0, 40.0, 161)
    for cell, colour in zip(published.bent_cells, COLOURS, strict=True):
        change = 100 * (
            ratio_from_pressure(pressures) ** Film(curvature_per_m=cell.curvature_per_m).answer - 1
        )
        name = "flat" if cell.radius_mm is None else f"radius {cell.radius_mm:g} mm"
        right.plot(pressures, change, color=colour, lw=1.1, label=name)
        right.plot(40, cell.percent, "o", color=colour, ms=4.5, clip_on=False)
    right.legend(
        fontsize=style.SMALL_POINT,
        frameon=False,
        title="dots: published",
        title_fontsize=style.SMALL_POINT,
    )
    style.dressed(right, "pressure [kPa]", CHANGE)
    return figure


def tiles_of(side: Side, published: Published) -> dict[str, list[Tile]]:
    """Return the maps of each figure.

    Figure 6 has six measured loads; 8, six methods on one frame; 9, two mouths.
    """
    tiles: dict[str, list[Tile]] = {"fig6": [], "fig8": [], "fig9": []}
    for load in published.loads:
        change, felt = side.loads[load.letter]
        note = f"measured {_span(change)} %\nfilm feels {_span(felt)} kPa"
        tiles["fig6"].append(Tile(f"({load.letter}) {load.condition}", change, note))
    for extremes in published.ranges:
        change = side.change(extremes.method)
        method = extremes.method.replace(MEASURED, "measured two-point")
        note = f"ours {_span(change)} %\npaper {_span(np.array([extremes.low, extremes.high]))} %"
        tiles["fig8"].append(Tile(f"({extremes.letter}) {method}", change, note))
    for number, mouth in enumerate(published.mouths):
        change = side.change(published.mouth_method, number)
        title = f"({mouth.letter}) mouth of {mouth.diameter_mm:g} mm, {published.mouth_method}"
        note = (
            f"ours {' × '.join(map(str, covered(change)))} cells, "
            f"paper {mouth.cells} × {mouth.cells}"
        )
        tiles["fig9"].append(Tile(title, change, note))
    return tiles


def covered(change: Array) -> tuple[int, int]:
    """Count the rows and columns with a cell that fell strongly.

    Such a cell fell by more than half of the largest fall.

    Returns
    -------
    rows, columns : int
    """
    fallen = change < 0.5 * np.nanmin(change)
    return int(np.sum(fallen.any(axis=1))), int(np.sum(fallen.any(axis=0)))


def tiles_figure(tiles: Sequence[Tile], panel: Panel, title: str) -> Figure:
    """Draw contoured maps on one scale of ±100 %, with arrows for larger changes."""
    largest = max(float(np.nanmax(tile.values)) for tile in tiles if tile.values is not None)
    scale = banded_scale([np.array([-100.0, 100.0, max(largest, 100.0)])], CHANGE)
    return maps_figure(tiles, panel, scale, title, contoured=True)


def _span(values: Array) -> str:
    return " … ".join(
        style.change_text(float(end(values)), 100.0) for end in (np.nanmin, np.nanmax)
    )
