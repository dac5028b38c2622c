"""Export of results for other programs.

To add a format, write its `Export` into a file here and add it to EXPORTS. A package adds formats
by naming them in the entry point group `lampest.exports`, a script by handing one to
`export_results`.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from lampest.files.applications import applications
from lampest.files.errors import InputError
from lampest.files.hdf5 import format_of
from lampest.files.typed import installed, of_kind, typed
from lampest.files.whole import refuse_inputs, sparing, whole_file
from lampest.report.export.formats import (
    CsvExport,
    ExcelExport,
    Export,
    MatlabExport,
    ParquetExport,
    ZarrExport,
)
from lampest.report.export.nwb import NwbExport
from lampest.runs.case import CaseResult
from lampest.runs.results import read_results

__all__ = ["EXPORTS", "Export", "export_results"]
EXPORTS: tuple[Export, ...] = (
    CsvExport(),
    ExcelExport(),
    ParquetExport(),
    MatlabExport(),
    ZarrExport(),
    NwbExport(),
)


@typed
def export_results(
    results: str | Path,
    to: str | Export,
    out: str | Path | None = None,
    recording: str | None = None,
    start: str | None = None,
    frames: range | None = None,
) -> tuple[Path, ...]:
    """Write a results file, or the visits of a file of detections, in another format, atomically.

    Parameters
    ----------
    results : path
        Results, or detections.h5, of which csv, parquet and mat have one row for each visit.
    to : str or Export
        ``csv``, ``xlsx``, ``parquet``, ``mat``, ``zarr``, ``nwb``, or an own `Export`.
    out : path, optional
        The new file; by default beside the results with the suffix of the format.
    recording : str, optional
        The only recording to export.
    start : str, optional
        Date and time at 0 s (ISO 8601) for recordings without one.
    frames : range, optional
        As in `read_results`.

    Returns
    -------
    tuple of Path
        The files that were written.

    Raises
    ------
    InputError
        For damaged or unfit results, an unknown recording, a missing library, or a bad place.

    >>> recording = lampest.datasets.load("rod")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.save("results.h5", "LSM")
    >>> lampest.export_results("results.h5", "mat")[0].name
    'results.mat'
    """
    source = Path(results)
    if format_of(source).startswith("detections/"):
        return (applications().required("recognition", "visits", f"{results}")(source, to, out),)
    export = to
    if isinstance(export, str):
        export = of_kind(export, "format", (*EXPORTS, *installed("lampest.exports", Export)))
    path = source.with_suffix(export.suffix) if out is None else Path(out)
    written = (path, path.with_name(path.name + export.beside)) if export.beside else (path,)
    with sparing((source,)), ExitStack() as files:
        refuse_inputs(written)
        read = read_results(source, frames=frames)
        cases = _started(read.cases if recording is None else read.of(recording), start)
        if not cases:
            raise InputError(f"{source}: holds no case that could be exported")
        # The last file that is opened is the first that appears.
        *beside, unfinished = (files.enter_context(whole_file(file)) for file in written[::-1])
        export.write(cases, path.name, unfinished, beside[0] if beside else None)
    return written


def _started(cases: Sequence[CaseResult], start: str | None) -> tuple[CaseResult, ...]:
    """Return the cases with a start time.

    Raises InputError for an invalid date or a different recorded start.
    """
    if start is None:
        return tuple(cases)
    try:
        datetime.fromisoformat(start)
    except ValueError as error:
        raise InputError(
            f"--start: '{start}' is no date and time such as 2026-05-04T09:30:00+02:00"
        ) from error
    for case in cases:
        if case.start_time not in ("", start):
            raise InputError(
                f"--start: {case.recording} says itself that it began at {case.start_time}"
            )
    return tuple(replace(case, start_time=start) for case in cases)
