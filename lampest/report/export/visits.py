"""Export of visits: one table of columns, in CSV, Parquet or MATLAB 5."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lampest.files.errors import InputError, extra
from lampest.files.whole import refuse_inputs, sparing, whole_file
from lampest.report.compare import comma_separated
from lampest.report.detect.visits import COLUMNS, Visit, visits_in
from lampest.report.export.formats import Export


def export_visits(path: Path, to: str | Export, out: str | Path | None) -> Path:
    """Write the visits of a file of detections in a format, atomically; return the file.

    Raises InputError for a damaged file, a format that has no table, or a place that cannot be written.
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
    path.write_text(comma_separated([list(COLUMNS), *(visit.row for visit in visits)]), encoding="utf-8")


def _parquet(path: Path, visits: Sequence[Visit]) -> None:
    with extra("export"):
        import pyarrow
        from pyarrow import parquet
    table = pyarrow.table({name: [getattr(visit, name) for visit in visits] for name in COLUMNS})
    fields = [field.with_metadata({"long_name": COLUMNS[field.name]}) for field in table.schema]
    parquet.write_table(table.cast(pyarrow.schema(fields)), path, compression="zstd")


def _matlab(path: Path, visits: Sequence[Visit]) -> None:
    from scipy.io import savemat

    columns = dict[str, object]()
    for name in COLUMNS:
        values = [getattr(visit, name) for visit in visits]
        words = any(isinstance(value, str) for value in values)
        blank = "" if words else np.nan
        known = [blank if value is None else value for value in values]
        columns[name] = np.array(known, dtype=object if words else float)[:, None]
    savemat(path, {"visits": columns})


WRITERS: dict[str, Callable[[Path, Sequence[Visit]], None]] = {"csv": _csv, "parquet": _parquet, "mat": _matlab}
