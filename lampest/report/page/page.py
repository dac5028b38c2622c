"""The page itself: everything put in order, and written as one HTML file that needs nothing else."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lampest.files.whole import write_whole
from lampest.report.page.advice import Advice, advise, doubts
from lampest.report.page.batch import Batch, Subject, read_batch, without_copies
from lampest.report.page.compared import Comparison, compared
from lampest.report.page.measures import DRAWS, Measures, measures
from lampest.report.page.section import Section, section, standing_section
from lampest.report.page.tables import batch_sheet
from lampest.report.page.template import SHARED, filled, listed
from lampest.report.plots.style import verbatim
from lampest.report.strongest import counted
from lampest.runs.executors import each_of

SEED = 20190604  # of the bootstrap: the same files give the same page
MOST_WHOLE, MOST_DRAWN = 6, 6  # recordings with all figures, estimators in them
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
        chosen=tuple(_why_shown(batch, comparison, advice)),
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


def _why_shown(batch: Batch, comparison: Comparison | None, advice: Advice) -> Iterator[str]:
    """Why these recordings are shown whole, and why these estimators in figures, where not all are."""
    recordings, estimators = len(batch.subjects), len(batch.estimators)
    if recordings > MOST_WHOLE:
        if comparison is None or comparison.scores.over_frames:
            yield f"All figures for the first {MOST_WHOLE} of {recordings} recordings."
        else:
            yield (
                f"All figures for {MOST_WHOLE} of {recordings} recordings: those where {_shown(comparison, advice)} "
                f"has the two smallest, the two middle and the two largest values of the {comparison.criterion.name}."
            )
    if estimators > MOST_DRAWN:
        first = "first" if comparison is None else f"first by the {comparison.criterion.name}"
        shown = f"The figures of recordings show the {MOST_DRAWN} estimators that stand {first}"
        yield f"{shown}, the tables all {estimators}."


def missing(batch: Batch) -> str:
    """One sentence on what the results do not hold; empty where they hold all."""
    cases = [case for subject in batch.subjects for case in subject.cases]
    parts = []
    for field, name in WISHED.items():
        known = [getattr(case, field) for case in cases]
        lacking = sum(value is None or (isinstance(value, dict) and not value) for value in known)
        if lacking:
            parts.append(name + ("" if lacking == len(cases) else f" (in {lacking} of {len(cases)} cases)"))
    return f"These results lack {listed(parts)}; what follows from them is left out." if parts else ""


def origins(batch: Batch) -> list[dict[str, str]]:
    """The first case of every estimator: `estimator`, the resolved case as YAML `text`, `versions` that solved it."""
    first = {case.estimator: case for subject in reversed(batch.subjects) for case in reversed(subject.cases)}
    return [
        {
            "estimator": name,
            "text": first[name].case_yaml,
            "versions": ", ".join(f"{library} {number}" for library, number in sorted(first[name].versions.items())),
        }
        for name in batch.estimators
    ]
