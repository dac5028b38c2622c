"""The page itself: everything put in order, and written as one HTML file that needs nothing else."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.page import pictures
from lampest.report.page.batch import Batch, Subject, read_batch, without_copies
from lampest.report.page.compared import advise, compared, doubts
from lampest.report.page.measures import DRAWS, Measures, disagreements, measures
from lampest.report.page.tables import batch_table, failures, recording_table, standing_table, unit_table
from lampest.report.page.template import filled
from lampest.report.plots.style import verbatim
from lampest.report.strongest import strongest_index
from lampest.report.words import counted, digits, listed
from lampest.runs.executors import each_of

MOST = 6  # recordings with all figures, and estimators in them
WISHED = {
    "sigma": "the noise of the readings",
    "cell_resistance_lower": "error bars",
    "resolution": "resolution",
    "truth": "the truth",
    "weights": "the weights",
}


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
    over_all, each = np.random.default_rng(20190604).spawn(2)  # always the same draws
    own, _ = without_copies(batch.subjects)
    comparison = compared(batch, over_all)
    advice = advise(batch, comparison)
    found = {
        subject.name: {case.estimator: measures(case, each) for case in subject.cases} for subject in batch.subjects
    }
    if advice.estimator is not None:
        taken = [known[advice.estimator] for known in found.values() if advice.estimator in known]
        advice = replace(advice, warnings=(*advice.warnings, *doubts(advice.estimator, taken)))
    first = [row.estimator for row in comparison.standings] if comparison else []
    drawn = [*dict.fromkeys((*first, *batch.estimators))][:MOST]
    tasks = [(subject, number, found[subject.name], drawn) for number, subject in enumerate(batch.subjects)]
    sections = each_of(_section, tasks, on_recording)
    return filled(
        "lampest.report.page",
        batch=batch,
        advice=advice,
        missing=missing(batch),
        comparison=comparison,
        standings=comparison and standing_table(comparison),
        units=comparison and len(comparison.scores.units) <= 200 and unit_table(comparison),
        together=batch_table(replace(batch, subjects=tuple(own)), found) if len(own) > 1 else None,
        whole=sections[:MOST],
        others=sections[MOST:],
        most=MOST,
        origins={case.estimator: case for subject in batch.subjects[::-1] for case in subject.cases[::-1]},
        draws=DRAWS,
        counted=counted,
        digits=digits,
    )


def _section(task: tuple[Subject, int, Mapping[str, Measures], Sequence[str]]) -> dict[str, Any]:
    """What the template says of a recording: contours and a table; of the first ones every other figure, too."""
    subject, number, found, drawn = task
    whole = number < MOST
    cases = tuple(case for case in subject.cases if case.estimator in drawn) or subject.cases[:1]
    place, pairs = strongest_index(cases), disagreements(cases) if whole else ()
    with verbatim():
        shown = [pictures.contours(cases)]
        if whole:
            shown += [*pictures.certainty(cases, place), pictures.misfits(cases, place)]
            shown += pictures.differences(cases, place, pairs)
    return {
        "name": subject.name,
        "anchor": f"recording-{number + 1}",
        "case": cases[0],
        "place": place,
        "table": recording_table(found),
        "pictures": shown,
        "undecided": whole and len(cases) > 1 and not pairs,
        "failed": failures(found),
    }


def missing(batch: Batch) -> str:
    """What the results do not hold; empty where they hold all."""
    cases = [case for subject in batch.subjects for case in subject.cases]
    parts = []
    for field, name in WISHED.items():
        known = [getattr(case, field) for case in cases]
        lacking = sum(values is None or len(values) == 0 for values in known)
        if lacking:
            parts.append(name + ("" if lacking == len(cases) else f" (in {lacking} of {len(cases)} cases)"))
    return listed(parts)
