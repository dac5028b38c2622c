"""Export of visits: one table of columns, in CSV, Parquet or MATLAB 5."""

from collections.abc import Callable, Sequence
from pathlib import Path

from lampest.apps.recognition.detect.visits import COLUMNS, Visit, visits_in
from lampest.files.errors import InputError
from lampest.files.whole import refuse_inputs, sparing, whole_file
from lampest.report.compare import comma_separated
from lampest.report.export.formats import Export, write_matlab, write_parquet


def export_visits(path: Path, to: str | Export, out: str | Path | None) -> Path:
    """Write the visits of a file of detections in a format, atomically; return the file.

    Raises InputError for a damaged file, a format that has no table, or a place that cannot be
    written.
    """
    kind = to if isinstance(to, str) else to.kind
    if kind not in WRITERS:
        raise InputError(f"{path}: visits are exported as {', '.join(WRITERS)}, not as {kind}")
    target = path.with_name(f"visits.{kind}") if out is None else Path(out)
    with sparing((path,)):
        refuse_inputs((target,))
        visits = visits_in(path)
        with whole_file(target) as unfinished:
            WRITERS[kind](unfinished, visits)
    return target


def _csv(path: Path, visits: Sequence[Visit]) -> None:
    path.write_text(
        comma_separated([list(COLUMNS), *(visit.row for visit in visits)]), encoding="utf-8"
    )


def _parquet(path: Path, visits: Sequence[Visit]) -> None:
    write_parquet(path, _columns(visits), COLUMNS)


def _matlab(path: Path, visits: Sequence[Visit]) -> None:
    write_matlab(path, "visits", _columns(visits))


def _columns(visits: Sequence[Visit]) -> dict[str, list[object]]:
    return {name: [getattr(visit, name) for visit in visits] for name in COLUMNS}


WRITERS: dict[str, Callable[[Path, Sequence[Visit]], None]] = {
    "csv": _csv,
    "parquet": _parquet,
    "mat": _matlab,
}
