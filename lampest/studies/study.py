"""What studies of lampest itself have in common: rows as CSV, and a file that holds every sample."""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import version
from math import isnan
from pathlib import Path
from typing import Any

from lampest.files import hdf5
from lampest.files.whole import write_whole

LIBRARIES = ("lampest", "casadi", "numpy", "scipy", "h5py")


def write_rows(path: Path, kind: type[Any], rows: Sequence[Any]) -> None:
    """Dataclass objects of one kind as CSV, a column for each field; six digits, empty where there is no number.

    Raises InputError where the place cannot be written.
    """
    names = [field.name for field in fields(kind)]
    write_whole(path, comma_separated([names, *([csv_value(getattr(row, name)) for name in names] for row in rows)]))


def comma_separated(rows: Sequence[Sequence[Any]]) -> str:
    """Rows of values as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def csv_value(value: Any) -> Any:
    """A value for CSV: six digits of a number, nothing for None and NaN."""
    if value is None or (isinstance(value, float) and isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value


@contextmanager
def samples_file(path: Path, form: str, **attributes: Any) -> Iterator[Any]:
    """/entry of a new file of the format `form`, with the versions of the libraries; whole or not at all."""
    with hdf5.new_file(path) as file:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=form)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", **attributes)
        hdf5.set_attributes(entry, **{f"{library}_version": version(library) for library in LIBRARIES})
        yield entry
