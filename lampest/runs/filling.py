"""A reconstruction → what its results file keeps."""

from collections.abc import Sequence
from importlib.metadata import version

from lampest.estimate.sequence import Reconstruction
from lampest.runs.case import CaseResult
from lampest.runs.columns import FIGURES, Column, all_columns
from lampest.runs.config import Case

LIBRARIES = ("lampest", "casadi", "numpy", "h5py")


def case_result(case: Case, reconstruction: Reconstruction, columns: Sequence[Column] = ()) -> CaseResult:
    """What the results file keeps of a reconstruction: every column that it can fill.

    columns : besides those of lampest and of installed packages. Raises InputError where a column's values are of
    another shape than its axes, or impossible.
    """
    table = all_columns(columns)
    values = {column.name: column.filled(reconstruction) for column in table}
    result = CaseResult.of(
        {name: held for name, held in values.items() if held is not None},
        recording=case.recording,
        estimator=case.name,
        case_id=case.case_id,
        case_yaml=case.resolved,
        versions={library: version(library) for library in LIBRARIES},
        scene=reconstruction.recording.scene,
        baseline_status=reconstruction.baseline.solution.status.value,
        baseline_solve_time=reconstruction.baseline.seconds,
        joint_start=reconstruction.joint_start,
        **{folder.name: folder.value(reconstruction) for folder in FIGURES},
    )
    result.check(table)
    return result
