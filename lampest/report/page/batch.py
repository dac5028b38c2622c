"""Results files put together: every recording with all that was made of it, and who can be compared on what."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.report.words import listed
from lampest.runs.results import CaseResult, read_results

Recordings = Mapping[str, Mapping[str, CaseResult]]  # name → estimator → case


@dataclass(frozen=True, eq=False)
class Batch:
    """sources : the files as they were named."""

    sources: tuple[str, ...]
    recordings: Recordings

    @classmethod
    def of(cls, sources: Sequence[str], cases: Sequence[CaseResult]) -> "Batch":
        """Cases of one recording together; no two have the same names."""
        recordings: dict[str, dict[str, CaseResult]] = {}
        for case in cases:
            recordings.setdefault(case.recording, {})[case.estimator] = case
        return cls(tuple(sources), recordings)

    @property
    def estimators(self) -> tuple[str, ...]:
        """All names in order, each once."""
        return tuple(dict.fromkeys(name for cases in self.recordings.values() for name in cases))

    @property
    def frames(self) -> int:
        return sum(len(first_of(cases).time) for cases in self.recordings.values())


@dataclass(frozen=True, eq=False)
class Matched:
    """Estimators that can be compared: the same frames of the same recordings, solved by all of them.

    chosen : for each recording (frames) which of its frames. left_out : sentences on those that cannot.
    """

    estimators: tuple[str, ...]
    recordings: Recordings
    chosen: tuple[NDArray[np.bool_], ...]
    left_out: tuple[str, ...]

    @property
    def frames(self) -> int:
        return int(sum(np.sum(frames) for frames in self.chosen))

    def cases(self, estimator: str) -> list[CaseResult]:
        """The estimator's case of each recording."""
        return [cases[estimator] for cases in self.recordings.values()]


def first_of(cases: Mapping[str, CaseResult]) -> CaseResult:
    """One of a recording's cases, for what all of them were given."""
    return next(iter(cases.values()))


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
    return Batch.of([str(path) for path in paths], cases)


def _renamed(case: CaseResult, before: Sequence[CaseResult], number: int) -> CaseResult:
    """The case under names that those before do not have."""
    same = [other for other in before if other.recording == case.recording]
    given = ("frame", "time", "measured", "measured_baseline", "truth", "truth_baseline")
    pairs = [(getattr(case, name), getattr(same[0], name)) for name in given] if same else []
    arrays = [(one, other) for one, other in pairs if one is not None or other is not None]
    if not all(np.array_equal(*pair, equal_nan=pair[0] is not None and pair[1] is not None) for pair in arrays):
        return replace(case, recording=f"{case.recording} [{number}]")
    if any(other.estimator == case.estimator for other in same):
        return replace(case, estimator=f"{case.estimator} [{number}]")
    return case


def without_copies(recordings: Recordings) -> tuple[Recordings, list[str]]:
    """The recordings that are no copies, and a sentence on each of the others.

    One is a copy of an earlier one where more than half of its frames have that one's readings, to the seven digits of
    single precision: its frames would count twice.
    """
    seen: dict[str, set[bytes]] = {}
    copies: list[str] = []
    for name, cases in recordings.items():
        own = [np.float32(frame).tobytes() for frame in first_of(cases).measured if np.isfinite(frame).any()]
        before = next((one for one, held in seen.items() if sum(frame in held for frame in own) > len(own) / 2), None)
        if before is None:
            seen[name] = set(own)
        else:
            copies.append(f"{name}, whose readings are those of {before}: a copy does not count again")
    return {name: recordings[name] for name in seen}, copies


def matched(recordings: Recordings) -> Matched:
    """Who can be compared on what: as many estimators on as many recordings as possible, each on all of them.

    They have the most differences that can be paired. One that failed in more than a twentieth of the frames is left
    out, so that it does not profit from having skipped what is hard; of the others, the frames count that all solved.
    """
    kept, left_out = without_copies(recordings)
    often = Counter(name for cases in kept.values() for name in cases)
    options = []
    for least in sorted(set(often.values()), reverse=True):
        known = [name for name, count in often.items() if count >= least]
        options.append((known, {name: cases for name, cases in kept.items() if {*known} <= cases.keys()}))
    names, common = max(options, key=lambda option: (len(option[0]) - 1) * len(option[1]))
    fewer = [name for name in often if name not in names]
    if fewer:
        left_out.append(f"{listed(fewer)}, without results of the same recordings")
    if len(common) < len(kept):
        left_out.append(f"{len(kept) - len(common)} of {len(kept)} recordings lack some of the estimators")
    for name in tuple(names) if common else ():
        solved = np.concatenate([cases[name].solved for cases in common.values()])
        if np.mean(solved) < 0.95:
            names.remove(name)
            left_out.append(f"{name} failed in {int(np.sum(~solved))} of {len(solved)} frames")
    solved_by_all = {
        recording: np.all([cases[name].solved for name in names], axis=0)
        for recording, cases in (common.items() if names else ())
    }
    chosen = {recording: frames for recording, frames in solved_by_all.items() if np.any(frames)}
    found = {recording: common[recording] for recording in chosen}
    return Matched(tuple(names), found, tuple(chosen.values()), tuple(left_out))
