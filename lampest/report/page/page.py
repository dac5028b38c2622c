"""The page itself: everything put in order, and written as one HTML file that needs nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.page.advice import Advice, advise, doubts
from lampest.report.page.batch import Batch, Subject, read_batch, without_copies
from lampest.report.page.compared import Comparison, compared
from lampest.report.page.measures import Measures, measures
from lampest.report.page.section import Section, section, standing_section
from lampest.report.page.statistics import DRAWS
from lampest.report.page.tables import batch_sheet
from lampest.report.page.template import SHARED, filled
from lampest.report.page.words import counted, listed
from lampest.report.plots.style import verbatim
from lampest.runs.executors import each_of

SEED = 20190604
MOST_WHOLE, MOST_DRAWN = 6, 6  # recordings with all figures, estimators in them
WISHED = (
    ("sigma", "the noise of the readings"),
    ("cell_resistance_lower", "error bars"),
    ("resolution", "resolution"),
    ("truth", "the truth"),
)


@dataclass(frozen=True)
class Origin:
    """An estimator's resolved case as YAML text, and the versions that solved it."""

    estimator: str
    text: str
    versions: str


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
    generator = np.random.default_rng(SEED)
    over_all, each = generator.spawn(2)
    own, _ = without_copies(batch.subjects)
    comparison = compared(batch, over_all)
    advice = advise(batch, comparison)
    found = {
        subject.name: {case.estimator: measures(case, each) for case in subject.cases} for subject in batch.subjects
    }
    if advice.estimator is not None:
        taken = [own[advice.estimator] for own in found.values() if advice.estimator in own]
        advice = replace(advice, warnings=(*advice.warnings, *doubts(advice.estimator, taken)))
    whole, drawn = shown_whole(batch, comparison, advice), shown_estimators(batch, comparison)
    with verbatim():
        standing = None if comparison is None else standing_section(comparison)
    tasks = [
        (subject, number, found[subject.name], drawn, subject.name in whole)
        for number, subject in enumerate(batch.subjects, 1)
    ]
    sections = each_of(_section, tasks, on_recording)
    return filled(
        SHARED,
        size=f"{counted(len(batch.subjects), 'recording')}, {counted(batch.frames, 'frame')}, "
        f"{counted(len(batch.estimators), 'estimator')}",
        sources=batch.sources,
        advice=advice,
        missing=missing(batch),
        standing=standing,
        together=batch_sheet(replace(batch, subjects=tuple(own)), found) if len(own) > 1 else None,
        whole=[part for part in sections if part.name in whole],
        others=[part for part in sections if part.name not in whole],
        chosen=(*_why_whole(comparison, advice, len(batch.subjects)), *_why_drawn(comparison, len(batch.estimators))),
        origins=origins(batch),
        draws=f"{DRAWS:,}",
    )


def _section(task: tuple[Subject, int, dict[str, Measures], tuple[str, ...], bool]) -> Section:
    with verbatim():
        return section(*task)


def shown_whole(batch: Batch, comparison: Comparison | None, advice: Advice) -> frozenset[str]:
    """The recordings that get all figures: everyone of a few; else the two best, middle and worst ones.

    By the criterion, for the estimator that is recommended or stands first.
    """
    names = [subject.name for subject in batch.subjects]
    if len(names) <= MOST_WHOLE or comparison is None or comparison.scores.over_frames:
        return frozenset(names[:MOST_WHOLE])
    units = comparison.scores.units
    column = comparison.scores.estimators.index(_shown(comparison, advice))
    order = np.argsort(comparison.scores.values[:, column], kind="stable")
    middle = len(order) // 2
    return frozenset(units[place] for place in (*order[:2], *order[middle - 1 : middle + 1], *order[-2:]))


def _shown(comparison: Comparison, advice: Advice) -> str:
    return advice.estimator or comparison.standings[0].estimator


def shown_estimators(batch: Batch, comparison: Comparison | None) -> tuple[str, ...]:
    """The estimators that figures of recordings show: the first ones by the criterion, else as they were named."""
    standing = [] if comparison is None else [row.estimator for row in comparison.standings]
    return tuple(dict.fromkeys((*standing, *batch.estimators)))[:MOST_DRAWN]


def _why_drawn(comparison: Comparison | None, count: int) -> tuple[str, ...]:
    if count <= MOST_DRAWN:
        return ()
    first = "first" if comparison is None else f"first by the {comparison.criterion.name}"
    return (f"The figures of recordings show the {MOST_DRAWN} estimators that stand {first}, the tables all {count}.",)


def _why_whole(comparison: Comparison | None, advice: Advice, count: int) -> tuple[str, ...]:
    if count <= MOST_WHOLE:
        return ()
    if comparison is None or comparison.scores.over_frames:
        return (f"All figures for the first {MOST_WHOLE} of {count} recordings.",)
    return (
        f"All figures for {MOST_WHOLE} of {count} recordings: those where {_shown(comparison, advice)} has the two "
        f"smallest, the two middle and the two largest values of the {comparison.criterion.name}.",
    )


def missing(batch: Batch) -> str:
    """One sentence on what the results do not hold; empty where they hold all."""
    cases = [case for subject in batch.subjects for case in subject.cases]
    parts = []
    for field, name in WISHED:
        lacking = sum(getattr(case, field) is None for case in cases)
        if lacking:
            parts.append(name + ("" if lacking == len(cases) else f" (in {lacking} of {len(cases)} cases)"))
    lacking = sum(not case.weights for case in cases)
    if lacking:
        parts.append("the weights" + ("" if lacking == len(cases) else f" (in {lacking} of {len(cases)} cases)"))
    return f"These results lack {listed(parts)}; what follows from them is left out." if parts else ""


def origins(batch: Batch) -> tuple[Origin, ...]:
    """The first case of every estimator."""
    found = []
    for name in batch.estimators:
        case = next(case for subject in batch.subjects for case in subject.cases if case.estimator == name)
        versions = ", ".join(f"{library} {number}" for library, number in sorted(case.versions.items()))
        found.append(Origin(name, case.case_yaml, versions))
    return tuple(found)
