"""Results files put together: every recording with all that was made of it, and who can be compared on what."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.report.words import listed
from lampest.runs.results import CaseResult, read_results


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording's name on the page, and its cases."""

    name: str
    cases: tuple[CaseResult, ...]


@dataclass(frozen=True, eq=False)
class Batch:
    """sources : the files as they were named."""

    sources: tuple[str, ...]
    subjects: tuple[Subject, ...]

    @property
    def estimators(self) -> tuple[str, ...]:
        """All names in order, each once."""
        return tuple(dict.fromkeys(case.estimator for subject in self.subjects for case in subject.cases))

    @property
    def frames(self) -> int:
        return sum(len(subject.cases[0].time) for subject in self.subjects)


@dataclass(frozen=True, eq=False)
class Matched:
    """Estimators that can be compared: the same frames of the same recordings, solved by all of them.

    chosen : for each recording (frames) which of its frames. left_out : sentences on those that cannot.
    """

    estimators: tuple[str, ...]
    subjects: tuple[Subject, ...]
    chosen: tuple[NDArray[np.bool_], ...]
    left_out: tuple[str, ...]

    @property
    def frames(self) -> int:
        return int(sum(np.sum(frames) for frames in self.chosen))

    def cases(self, estimator: str) -> list[CaseResult]:
        """The estimator's case of each recording."""
        return [case for subject in self.subjects for case in subject.cases if case.estimator == estimator]


def read_batch(paths: Sequence[Path], frames: range | None = None) -> Batch:
    """The cases of all files; those of one recording stand together wherever they were made.

    frames : as `read_results` takes them. Where two files hold the same name for different things, the name gets the
    file's number: 'LSM [2]'. Raises InputError where a file cannot be read, is named twice, or all are empty.
    """
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError("a results file is named twice")
    cases: list[CaseResult] = []
    for number, path in enumerate(paths, 1):
        cases += [_renamed(case, cases, number) for case in read_results(path, frames=frames).cases]
    if not cases:
        raise InputError(f"{', '.join(map(str, paths))}: no results to report")
    names = dict.fromkeys(case.recording for case in cases)
    subjects = (Subject(name, tuple(case for case in cases if case.recording == name)) for name in names)
    return Batch(tuple(map(str, paths)), tuple(subjects))


def _renamed(case: CaseResult, before: Sequence[CaseResult], number: int) -> CaseResult:
    """The case under names that those before do not have."""
    same = [other for other in before if other.recording == case.recording]
    given = ("frame", "time", "measured", "measured_baseline", "truth", "truth_baseline")
    if same and not all(_equal(getattr(case, name), getattr(same[0], name)) for name in given):
        return replace(case, recording=f"{case.recording} [{number}]")
    if any(other.estimator == case.estimator for other in same):
        return replace(case, estimator=f"{case.estimator} [{number}]")
    return case


def _equal(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    return one is other


def without_copies(subjects: Sequence[Subject]) -> tuple[list[Subject], list[str]]:
    """The recordings that are no copies, and a sentence on each of the others.

    One is a copy of an earlier one where more than half of its frames have that one's readings, to the seven digits of
    single precision: its frames would count twice.
    """
    kept: list[tuple[Subject, set[bytes]]] = []
    copies: list[str] = []
    for subject in subjects:
        measured = subject.cases[0].measured
        own = [np.float32(frame).tobytes() for frame in measured if np.isfinite(frame).any()]
        before = next((one.name for one, seen in kept if sum(frame in seen for frame in own) > len(own) / 2), None)
        if before is None:
            kept.append((subject, set(own)))
        else:
            copies.append(f"{subject.name}, whose readings are those of {before}: a copy does not count again")
    return [subject for subject, _ in kept], copies


def matched(subjects: Sequence[Subject]) -> Matched:
    """Who can be compared on what: as many estimators on as many recordings as possible, each on all of them.

    One that failed in more than a twentieth of the frames is left out, so that it does not profit from having skipped
    what is hard; of the others, the frames count that all of them solved.
    """
    subjects, left_out = without_copies(subjects)
    often = Counter(case.estimator for subject in subjects for case in subject.cases)
    names, common = _shared(subjects, often)
    fewer = [name for name in often if name not in names]
    if fewer:
        left_out.append(f"{listed(fewer)}, for want of results of the same recordings")
    if len(common) < len(subjects):
        left_out.append(f"{len(subjects) - len(common)} of {len(subjects)} recordings lack some of the estimators")
    for name in tuple(names) if common else ():
        solved = np.concatenate([case.solved for subject in common for case in subject.cases if case.estimator == name])
        if np.mean(solved) < 0.95:
            names.remove(name)
            left_out.append(f"{name} failed in {int(np.sum(~solved))} of {len(solved)} frames")
    kept = []
    for subject in common if names else ():
        frames = np.all([case.solved for case in subject.cases if case.estimator in names], axis=0)
        if np.any(frames):
            kept.append((subject, frames))
    chosen = tuple(frames for _, frames in kept)
    return Matched(tuple(names), tuple(subject for subject, _ in kept), chosen, tuple(left_out))


def _shared(subjects: Sequence[Subject], often: Counter[str]) -> tuple[list[str], list[Subject]]:
    """Estimators and the recordings that all of them have: those with the most differences that can be paired."""
    options = []
    for least in sorted(set(often.values()), reverse=True):
        names = [name for name, count in often.items() if count >= least]
        held = [subject for subject in subjects if {*names} <= {case.estimator for case in subject.cases}]
        options.append((names, held))
    return max(options, key=lambda option: (len(option[0]) - 1) * len(option[1]))
