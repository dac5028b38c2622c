"""The page itself: everything put in order, and written as one HTML file that needs nothing else."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.page import pictures
from lampest.report.page.batch import Batch, read_batch, without_copies
from lampest.report.page.compared import advise, compared, doubts
from lampest.report.page.measures import DRAWS, disagreements, figures
from lampest.report.page.tables import case_table, failures, standing_table, unit_table
from lampest.report.page.template import filled
from lampest.report.plots.style import verbatim
from lampest.report.strongest import strongest_index
from lampest.report.words import counted, digits
from lampest.runs.case import CaseResult
from lampest.runs.executors import each_of

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
    """The page as HTML; on_recording as `write_report` has it."""
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
    """What the template says of a recording: contours and a table; of the first ones every other figure, too."""
    name, every, number, drawn = task
    whole = number < MOST
    cases = [case for estimator, case in every.items() if estimator in drawn] or [*every.values()][:1]
    place, pairs = strongest_index(cases), disagreements(cases) if whole else ()
    with verbatim():
        shown = [pictures.contours(cases)]
        if whole:
            shown += [*pictures.certainty(cases, place), pictures.misfits(cases, place)]
            shown += pictures.differences(cases, place, pairs)
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
