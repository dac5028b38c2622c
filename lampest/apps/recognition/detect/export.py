"""Export of visits: one table of columns, in CSV, Parquet or MATLAB 5."""

from pathlib import Path

from lampest.apps.recognition.detect.visits import COLUMNS, visits_in
from lampest.files.errors import InputError
from lampest.files.whole import refuse_inputs, sparing, whole_file
from lampest.report.compare import comma_separated
from lampest.report.export.formats import Export, write_matlab, write_parquet

KINDS = ("csv", "parquet", "mat")


def export_visits(path: Path, to: str | Export, out: str | Path | None) -> Path:
    """Write the visits of a file of detections in a format, atomically; return the file.

    Raises InputError for a damaged file, a format that has no table, or a place that cannot be
    written.
    """
    kind = to if isinstance(to, str) else to.kind
    if kind not in KINDS:
        raise InputError(f"{path}: visits are exported as {', '.join(KINDS)}, not as {kind}")
    target = path.with_name(f"visits.{kind}") if out is None else Path(out)
    with sparing((path,)):
        refuse_inputs((target,))
        visits = visits_in(path)
        columns = {name: [getattr(visit, name) for visit in visits] for name in COLUMNS}
        with whole_file(target) as unfinished:
            if kind == "csv":
                rows = zip(*columns.values(), strict=True)
                unfinished.write_text(comma_separated([COLUMNS, *rows]), encoding="utf-8")
            elif kind == "parquet":
                write_parquet(unfinished, columns, COLUMNS)
            else:
                write_matlab(unfinished, "visits", columns)
    return target
