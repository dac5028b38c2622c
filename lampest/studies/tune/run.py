"""The cases of a run, one after the other; those that cannot be tuned are named with their reason."""

from collections.abc import Callable
from dataclasses import dataclass

from lampest.files.errors import InputError
from lampest.recording.recording import Recording
from lampest.runs.config import Case, Run
from lampest.studies.tune.choices import Tuned, tune
from lampest.studies.tune.subject import TuneSubject, why_not


@dataclass(frozen=True, eq=False)
class Study:
    """tuned : in the order of the run. left_out : (recording/estimator, why)."""

    tuned: tuple[Tuned, ...]
    left_out: tuple[tuple[str, str], ...]


def run_tune(run: Run, on_case: Callable[[int, int], None] = lambda done, total: None) -> Study:
    """Tune every case that has one penalty with a squared loss. on_case is told how many of how many are done.

    Raises InputError where there is none, or where a rule needs the noise and it is unknown.
    """
    tuned: list[Tuned] = []
    left_out: list[tuple[str, str]] = []
    for number, case in enumerate(run.cases, 1):
        found = _tuned(case)
        if isinstance(found, Tuned):
            tuned.append(found)
        else:
            left_out.append((f"{case.recording}/{case.name}", found))
        on_case(number, len(run.cases))
    if not tuned:
        raise InputError(f"nothing to tune: {'; '.join(f'{name}: {reason}' for name, reason in left_out)}")
    return Study(tuple(tuned), tuple(left_out))


def _tuned(case: Case) -> Tuned | str:
    recording = Recording.load(case.path)
    frames = 2 if case.estimator.relative else 1
    reason = why_not(case.estimator, frames * recording.scene.panel.cells)
    if reason is not None:
        return reason
    subject = TuneSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    found = tune(subject)
    return found if any(point.solved for point in found.curves.points) else "it was solved for no weight"
