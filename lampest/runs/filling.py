"""Estimates → what their results file keeps."""

import hashlib
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version

from lampest.cost.terms import term_kind
from lampest.estimate.estimates import Estimates
from lampest.files.document import plain_content, to_yaml
from lampest.runs.case import CaseResult
from lampest.runs.columns import FIGURES, Column, all_columns
from lampest.runs.config import Case
from lampest.runs.results.reader import arrays_of

LIBRARIES = ("lampest", "casadi", "numpy", "h5py")


def case_result(case: Case, estimates: Estimates) -> CaseResult:
    """A run's case: every column that its estimates can fill.

    Raises InputError where a column's values are of another shape than its axes, or impossible.
    """
    return _filled(estimates, (), case.recording, case.name, case.resolved, case.case_id)


def named_result(estimates: Estimates, name: str | None, columns: Sequence[Column] = ()) -> CaseResult:
    """The same of estimates that no run's file asked for.

    name : of the estimator; None: its terms, `misfit + gradient`. columns : besides those of lampest and of installed
    packages. Raises InputError as `case_result`.
    """
    recording, estimator = estimates.recording, estimates.estimator
    name = " + ".join(map(term_kind, estimator.terms)) if name is None else name
    readings = hashlib.sha256(recording.recorded.tobytes()).hexdigest()
    content = {"recording": recording.name, "readings_sha256": readings, "estimator": name}
    resolved = to_yaml(content | plain_content(recording.scene) | plain_content(estimator))
    case_id = hashlib.sha256(resolved.encode()).hexdigest()[:24]
    return _filled(estimates, columns, recording.name, name, resolved, case_id)


def _filled(
    estimates: Estimates, columns: Sequence[Column], recording: str, name: str, resolved: str, case_id: str
) -> CaseResult:
    table = all_columns(columns)
    values = {column.name: column.filled(estimates) for column in table}
    result = CaseResult.of(
        {column: held for column, held in values.items() if held is not None},
        recording=recording,
        estimator=name,
        case_id=case_id,
        case_yaml=resolved,
        versions=_versions(),
        scene=estimates.recording.scene,
        baseline_status=estimates.baseline.status,
        baseline_solve_time=estimates.baseline.seconds,
        joint_start=estimates.joint_start,
        model_mark=estimates.model_check.mark,
        model_sentence=estimates.model_check.sentence,
        noise_sentence=estimates.noise.sentence,
        noise_learned=estimates.noise.learned,
        warnings="\n".join(estimates.checks),
        reading_error=estimates.noise.reading_error,
        frame_noise=arrays_of(estimates.noise.frame),
        start_time=estimates.recording.start_time or "",
        film_sentence="" if estimates.film is None else estimates.film.sentence,
        **{folder.name: folder.value(estimates) for folder in FIGURES},
    )
    result.check(table)
    return result


@cache
def _versions() -> dict[str, str]:
    return {library: version(library) for library in LIBRARIES}
