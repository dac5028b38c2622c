"""Report page: one self-contained HTML file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.compare import MIN_DIFFERENCE, Table
from lampest.report.page.compared import Batch, Comparison, advise, compared, doubts, read_batch, without_copies
from lampest.report.page.measures import (
    DRAWS,
    HARD,
    NONE,
    Disagreement,
    between,
    disagreements,
    figures,
    filled,
    frames_text,
    weights_text,
)
from lampest.report.plots.contours import CertaintyPlot, ContourPlot, Plot, ResidualPlot
from lampest.report.plots.maps import Tile, maps_figure, signed_scale, values_of
from lampest.report.plots.style import HALF_INCH, data_uri, verbatim
from lampest.report.strongest import strongest_index
from lampest.report.words import counted, digits
from lampest.runs.case import CaseResult
from lampest.runs.executors import each_of

CHANGED = "Relative change of resistance against the unloaded panel."
CERTAIN = (
    "Posterior standard deviation of each cell, in logarithmic colours, and the resolution: the part of a cell's "
    "change that its estimate follows. Where it is 0, the penalty alone decides."
)
UNEXPLAINED = (
    "Residuals of the readings. A pattern names an effect that the model lacks, or a penalty that is too strong."
)
DIFFERENT = (
    "Cells in which two estimators differ by more than their joint 95 % interval; grey: they do not. The titles give "
    "the share of such cells over all frames. Up to 5 % are expected by chance."
)
MAX_FIGURES = 6  # recordings with all figures, and estimators in them


def write_report(
    paths: Sequence[Path],
    out: Path,
    on_recording: Callable[[int, int], None] = lambda done, total: None,
    frames: range | None = None,
) -> None:
    """Write the report of some results files; the same files give the same bytes.

    Raises InputError where a file cannot be read, there is nothing in them, or the place cannot be written.

    Parameters
    ----------
    on_recording : callable
        Gets how many of how many recordings are drawn.
    frames : range or None
        As `read_results` takes them.
    """
    write_whole(out, report(read_batch(paths, frames), on_recording))


def report(batch: Batch, on_recording: Callable[[int, int], None] = lambda done, total: None) -> str:
    """Return the page as HTML; on_recording : as in `write_report`."""
    own, _ = without_copies(batch.recordings)
    comparison = compared(batch, np.random.default_rng(20190604).spawn(1)[0])  # always the same draws
    advice = advise(batch, comparison)
    by_estimator = {name: [cases[name] for cases in own.values() if name in cases] for name in batch.estimators}
    if advice.estimator is not None:
        doubted = doubts(advice.estimator, list(map(figures, by_estimator[advice.estimator])))
        advice = replace(advice, warnings=(*advice.warnings, *doubted))
    first = [row.estimator for row in comparison.standings] if comparison else []
    drawn = [*dict.fromkeys((*first, *batch.estimators))][:MAX_FIGURES]
    tasks = [(name, cases, number, drawn) for number, (name, cases) in enumerate(batch.recordings.items())]
    sections = each_of(_section, tasks, on_recording)
    return filled(
        "lampest.report.page",
        batch=batch,
        advice=advice,
        comparison=comparison,
        standings=comparison and standing_table(comparison),
        units=comparison and len(comparison.units) <= 200 and unit_table(comparison),
        together=case_table(by_estimator) if len(own) > 1 else None,
        whole=sections[:MAX_FIGURES],
        others=sections[MAX_FIGURES:],
        most=MAX_FIGURES,
        origins={name: case for cases in [*batch.recordings.values()][::-1] for name, case in cases.items()},
        draws=DRAWS,
        counted=counted,
        digits=digits,
    )


def _section(task: tuple[str, Mapping[str, CaseResult], int, Sequence[str]]) -> dict[str, Any]:
    """Return the content of a recording's section: contours and a table; for the first ones, all figures."""
    name, every, number, drawn = task
    whole = number < MAX_FIGURES
    cases = [case for estimator, case in every.items() if estimator in drawn] or [*every.values()][:1]
    place, pairs = strongest_index(cases), disagreements(cases) if whole else ()
    with verbatim():
        words = f"Maps of relative change of {name}: measured, by every estimator, and true where known"
        shown = wide(ContourPlot(), cases, words, CHANGED)
        if whole:
            frame = int(cases[0].frame[place])
            shown += wide(CertaintyPlot(frame), cases, "Maps of standard deviation and resolution", CERTAIN)
            shown += wide(ResidualPlot(frame), cases, "Maps of the residuals", UNEXPLAINED)
            shown += differences(cases, place, pairs)
    return {
        "name": name,
        "anchor": f"recording-{number + 1}",
        "case": cases[0],
        "place": place,
        "table": case_table({estimator: [case] for estimator, case in every.items()}),
        "pictures": shown,
        "undecided": whole and len(cases) > 1 and not pairs,
        "failed": failures([*every.values()]),
    }


@dataclass(frozen=True)
class Illustration:
    """Image as a data URI with alternative text and caption; wide : whether it spans the page."""

    uri: str
    alternative: str
    caption: str
    wide: bool = False


def wide(plot: Plot, cases: Sequence[CaseResult], words: str, caption: str) -> list[Illustration]:
    """Draw a plot over the whole page; empty if no case has its columns."""
    drawable = plot.drawable(cases)
    return [Illustration(data_uri(plot.draw(drawable), "png"), words, caption, wide=True)] if drawable else []


def differences(cases: Sequence[CaseResult], place: int, pairs: Sequence[Disagreement]) -> list[Illustration]:
    """Draw maps of the pairs that differ most, of half the width: as SVG, or as PNG if there are many cells."""
    tiles = [Tile(pair.title, pair.significant[place], f"{digits(pair.share, 2)} %") for pair in pairs[:9]]
    if not tiles:
        return []
    most = f" The 9 of {len(pairs)} pairs that differ most." if len(pairs) > 9 else ""
    scale = signed_scale(values_of(tiles), "difference of relative change [percentage points]", 1.0, 100.0)
    panel = cases[0].scene.panel
    kind: Literal["svg", "png"] = "svg" if panel.crossings * len(tiles) <= 1500 else "png"
    uri = data_uri(maps_figure(tiles, panel, scale, width=HALF_INCH), kind)
    return [Illustration(uri, "Maps of significant differences", DIFFERENT + most)]


def case_table(groups: Mapping[str, Sequence[CaseResult]]) -> Table:
    """Return a table with a column for each estimator and a line for each figure.

    Figures are medians over the cases, counts are sums. Lines without figures are omitted.
    """
    known = [[figures(case) for case in cases] for cases in groups.values()]
    rows = [
        ("frames at a verified optimum", *map(_optima, groups.values())),
        ("weights", *(weights_text([case.weights for case in cases]) or NONE for cases in groups.values())),
    ]
    for line in dict.fromkeys(line for column in known for case in column for line in case):
        values = [[case[line] for case in column if isinstance(case.get(line), int | float)] for column in known]
        rows.append((line, *map(_figure, values)))
    return Table(("", *groups), tuple(row for row in rows if set(row[1:]) != {NONE}))


def _figure(values: Sequence[float]) -> str:
    if not values:
        return NONE
    if all(isinstance(value, int) for value in values):
        return f"{sum(values):,}"
    value = float(np.median(values))
    return f"<{HARD}{MIN_DIFFERENCE:g}" if 0 < value < MIN_DIFFERENCE else digits(value)


def _optima(cases: Sequence[CaseResult]) -> str:
    """Return the number of frames at a verified optimum, such as '21 of 22 (1 to 7 starts each)'."""
    known = [case.local_optima for case in cases if case.local_optima is not None]
    if not known:
        return NONE
    optima, frames = sum(each[0] for each in known), sum(len(case.time) for case in cases)
    least, most = min(each[1] for each in known), max(each[2] for each in known)
    starts = counted(most, "start") if least == most else f"{least} to {most} starts"
    return f"{optima:,} of {frames:,} ({starts} each)"


def failures(cases: Sequence[CaseResult]) -> list[str]:
    """Return a sentence for each way in which an estimator failed."""
    sentences = []
    for case in cases:
        for status in dict.fromkeys(case.status[index] for index in np.flatnonzero(~case.solved)):
            frames = case.frame[[text == status for text in case.status]]
            noun = "frame" if len(frames) == 1 else "frames"
            sentences.append(f"{case.estimator}, {noun} {frames_text(frames.tolist())}: {status}")
    return sentences


def standing_table(comparison: Comparison) -> Table:
    """Compare every estimator with the best one: criterion, difference, wins, time."""
    criterion, best = comparison.criterion, comparison.standings[0].estimator
    headers = (
        "",
        f"{criterion.name}, mean [{criterion.unit}] (95 % interval)",
        f"difference from {best} [{criterion.difference_unit}] (95 % interval)",
        "significance",
        f"units with the smallest error, of {len(comparison.units)}",
        "time per frame [ms]",
        f"times as fast as {best}",
    )
    rows = []
    for row in comparison.standings:
        speed = comparison.milliseconds[row.estimator]
        difference, verdict, ratio = NONE, "smallest", NONE
        if row.estimator != best:
            difference, ratio = between(row.difference, sign="+"), digits(comparison.milliseconds[best] / speed, 2)
            verdict = "significant" if row.told_apart else "not significant"
        rows.append((row.estimator, between(row.mean), difference, verdict, str(row.wins), digits(speed), ratio))
    return Table(headers, tuple(rows))


def unit_table(comparison: Comparison) -> Table:
    """Return a table of the criterion by unit, with the smallest values highlighted."""
    rows = [(unit, *map(digits, values)) for unit, values in zip(comparison.units, comparison.values, strict=True)]
    smallest = np.argwhere(comparison.values == comparison.values.min(axis=1, keepdims=True))
    best = frozenset((int(row), int(column) + 1) for row, column in smallest)
    return Table(("", *comparison.match.estimators), tuple(rows), best=best)
