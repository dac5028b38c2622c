"""Report page: one self-contained HTML file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.page.compared import Batch, advise, compared, doubts, read_batch, without_copies
from lampest.report.page.measures import DRAWS, Disagreement, disagreements, figures, filled
from lampest.report.page.tables import case_table, failures, standing_table, unit_table
from lampest.report.plots.contours import CertaintyPlot, ContourPlot, ResidualPlot
from lampest.report.plots.maps import Scale, Tile, maps_figure, signed_scale, values_of
from lampest.report.plots.plot import Plot
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
MOST = 6  # recordings with all figures, and estimators in them


def write_report(
    paths: Sequence[Path],
    out: Path,
    on_recording: Callable[[int, int], None] = lambda done, total: None,
    frames: range | None = None,
) -> None:
    """Write the report of some results files; the same files give the same bytes.

    on_recording : gets how many of how many recordings are drawn. frames : as `read_results` takes them.
    Raises InputError where a file cannot be read, there is nothing in them, or the place cannot be written.
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
    drawn = [*dict.fromkeys((*first, *batch.estimators))][:MOST]
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
        whole=sections[:MOST],
        others=sections[MOST:],
        most=MOST,
        origins={name: case for cases in [*batch.recordings.values()][::-1] for name, case in cases.items()},
        draws=DRAWS,
        counted=counted,
        digits=digits,
    )


def _section(task: tuple[str, Mapping[str, CaseResult], int, Sequence[str]]) -> dict[str, Any]:
    """Return the content of a recording's section: contours and a table; for the first ones, all figures."""
    name, every, number, drawn = task
    whole = number < MOST
    cases = [case for estimator, case in every.items() if estimator in drawn] or [*every.values()][:1]
    place, pairs = strongest_index(cases), disagreements(cases) if whole else ()
    with verbatim():
        shown = [contours(cases)]
        if whole:
            shown += [*certainty(cases, place), residual_maps(cases, place)]
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


def contours(cases: Sequence[CaseResult]) -> Illustration:
    """Draw maps of relative change."""
    words = f"Maps of relative change of {cases[0].recording}: measured, by every estimator, and true where known"
    return _wide(ContourPlot(), cases, words, CHANGED)


def certainty(cases: Sequence[CaseResult], place: int) -> list[Illustration]:
    """Draw standard deviation, resolution, and errors if the truth is known; none without error bars."""
    plot = CertaintyPlot(int(cases[0].frame[place]))
    known = plot.drawable(cases)
    return [_wide(plot, known, "Maps of standard deviation and resolution", CERTAIN)] if known else []


def residual_maps(cases: Sequence[CaseResult], place: int) -> Illustration:
    """Draw maps of the residuals."""
    return _wide(ResidualPlot(int(cases[0].frame[place])), cases, "Maps of the residuals", UNEXPLAINED)


def differences(cases: Sequence[CaseResult], place: int, pairs: Sequence[Disagreement]) -> list[Illustration]:
    """Draw maps of the pairs that differ most."""
    tiles = [Tile(pair.title, pair.significant[place], f"{digits(pair.share, 2)} %") for pair in pairs[:9]]
    most = f" The 9 of {len(pairs)} pairs that differ most." if len(pairs) > 9 else ""
    scale = signed_scale(values_of(tiles), "difference of relative change [percentage points]", 1.0, 100.0)
    return [_maps(cases, tiles, scale, "significant differences", DIFFERENT + most)] if tiles else []


def _wide(plot: Plot, cases: Sequence[CaseResult], words: str, caption: str) -> Illustration:
    return Illustration(data_uri(plot.draw(cases), "png"), words, caption, wide=True)


def _maps(cases: Sequence[CaseResult], tiles: list[Tile], scale: Scale, of_what: str, caption: str) -> Illustration:
    """Draw maps of half the width, as SVG, or as PNG if there are many cells."""
    panel = cases[0].scene.panel
    kind: Literal["svg", "png"] = "svg" if panel.crossings * len(tiles) <= 1500 else "png"
    figure = maps_figure(tiles, panel, scale, width=HALF_INCH)
    return Illustration(data_uri(figure, kind), f"Maps of {of_what}", caption)
