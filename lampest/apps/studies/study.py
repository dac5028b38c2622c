"""Framework of studies.

A study reads its settings from YAML, makes records of experiments, and writes HDF5, CSV, Markdown,
figures and tables.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from lampest.files import hdf5
from lampest.files.document import read_document, validated
from lampest.files.whole import refuse_inputs, write_whole
from lampest.recording.datasets import folder as shipped_folder
from lampest.report.compare import Columns, Table, comma_separated, grouped, screen_table
from lampest.report.plots.style import save
from lampest.runs.provenance import library_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Settings = TypeVar("Settings")
Measured = TypeVar("Measured")
Kind = TypeVar("Kind")
OnStep = Callable[..., None]
Row = SimpleNamespace  # one line of a study's CSV file
Sheet = tuple[str, Sequence[Row], Columns]  # a table: title, rows, and its columns on the screen


def column(unit: str, meaning: str, default: Any = MISSING) -> Any:
    """Return a field of a record that becomes a dataset with that unit and meaning."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


@dataclass(frozen=True)
class RecordGroup:
    """Records of a dataclass as a group of an HDF5 file.

    The group has a dataset for every field that is a `column`.

    Attributes
    ----------
    path : str
        Group in /entry.
    records : sequence
    signal, axis : str
        Columns that a viewer draws, and along which; axis '' is the number of the record.
    units : mapping
        Units that replace those of the columns.
    attributes : mapping
        Attributes of the group.
    """

    path: str
    records: Sequence[Any]
    signal: str
    axis: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def write(self, entry: Any) -> None:
        """Write the records; truth values become 0 and 1, None becomes NaN."""
        group = entry.create_group(self.path)
        axis = self.axis or "record"
        hdf5.set_attributes(
            group, NX_class="NXdata", signal=self.signal, axes=[axis], **self.attributes
        )
        if not self.axis:
            hdf5.write_scale(group, axis, np.arange(len(self.records)), "1", "number of the record")
        columns = [column for column in fields(self.records[0]) if column.metadata]
        # The scale comes first.
        for column in sorted(columns, key=lambda column: column.name != axis):
            values = np.array([getattr(record, column.name) for record in self.records])
            values = values.astype({"b": np.uint8, "O": float}.get(values.dtype.kind, values.dtype))
            data = hdf5.ascii_array(values) if values.dtype.kind == "U" else values
            about = self.units.get(column.name, column.metadata["unit"]), column.metadata["meaning"]
            if column.name == axis:
                hdf5.write_scale(group, axis, data, *about)
            else:
                hdf5.write_dataset(group, column.name, data, *about, (axis,))


class Reported(NamedTuple):
    """Report of a study: titled tables, files, and sentences of remarks and omissions."""

    tables: Sequence[tuple[str, Table]]
    files: Sequence[Path]
    remarks: Sequence[str] = ()
    left_out: Sequence[str] = ()


@dataclass(frozen=True)
class Study(Generic[Settings, Measured]):
    """Declaration of a study; `run` makes files, tables and figures of it.

    Attributes
    ----------
    name : str
        Stem of its files.
    counts : str
        Things that the progress bar counts.
    config : str
        The shipped settings.
    read : callable
        (file, overrides) → settings; raises InputError with line and column.
    measure : callable
        (settings, on_step) → measurements, the argument of all following functions.
    rows : callable
        Rows of the CSV file, at least one.
    sheets : callable
        Tables for the screen and for Markdown.
    form, records : str, callable
        Format and groups of the HDF5 file; '' for none.
    figures, texts : callable
        Figures and texts of further files, by name.
    remarks, left_out : callable
        Sentences.
    """

    name: str
    counts: str
    config: str
    read: Callable[[Path, tuple[str, ...]], Settings]
    measure: Callable[[Settings, OnStep], Measured]
    rows: Callable[[Measured], Sequence[Any]]
    sheets: Callable[[Measured], Sequence[Sheet]] = lambda measured: ()
    form: str = ""
    records: Callable[[Measured], Iterable[RecordGroup]] = lambda measured: ()
    figures: "Callable[[Measured], Mapping[str, Figure]]" = lambda measured: {}
    texts: Callable[[Measured], Mapping[str, str]] = lambda measured: {}
    remarks: Callable[[Measured], Sequence[str]] = lambda measured: ()
    left_out: Callable[[Measured], Sequence[str]] = lambda measured: ()

    def run(
        self, config: Path | None, out: Path | None, assigned: tuple[str, ...], on_step: OnStep
    ) -> Reported:
        """Read, measure and write into a folder, results/<config> by default.

        Raises InputError for a faulty file and a folder that cannot be written.
        """
        file = config or shipped_folder() / "configs" / self.config
        measured = self.measure(self.read(file, assigned), on_step)
        remarks = self.remarks(measured)
        folder = out or Path("results") / file.stem
        tables = [
            (title, screen_table(rows, columns)) for title, rows, columns in self.sheets(measured)
        ]
        texts = {f"{self.name}.csv": csv_of(self.rows(measured)), **self.texts(measured)}
        texts |= {f"{self.name}.md": page(self.name, tables, remarks)} if tables else {}
        figures = {
            folder / f"{name}.png": figure for name, figure in self.figures(measured).items()
        }
        data = [folder / f"{self.name}.h5"] if self.form else []
        files = [*(folder / name for name in texts), *data, *figures]
        refuse_inputs(files)
        for name, text in texts.items():
            write_whole(folder / name, text)
        for path in data:
            groups = list(self.records(measured))
            versions = library_versions("scipy").items()
            with hdf5.new_file(path) as file:
                hdf5.set_attributes(
                    file, NX_class="NXroot", default="entry", lampest_format=self.form
                )
                entry = file.create_group("entry")
                hdf5.set_attributes(
                    entry,
                    NX_class="NXentry",
                    default=groups[0].path,
                    **{f"{library}_version": text for library, text in versions},
                )
                for group in groups:
                    group.write(entry)
        for path, figure in figures.items():
            save(figure, path)
        return Reported(tables, files, remarks, self.left_out(measured))


def page(name: str, tables: Sequence[tuple[str, Table]], remarks: Sequence[str]) -> str:
    """Return tables and remarks as sections of Markdown."""
    sections = [f"## {title or name}\n\n{markdown(table)}" for title, table in tables]
    sections += ["## remarks\n\n" + "".join(f"- {line}\n" for line in remarks)] if remarks else []
    return "\n".join(sections)


def markdown(table: Table) -> str:
    """Return a table as GitHub's Markdown."""
    lines = (table.headers, ["---"] * len(table.headers), *table.cells)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def read_settings(kind: type[Kind]) -> Callable[..., Kind]:
    """Return a reader of YAML files for a dataclass; it raises InputError with line and column."""
    return lambda path, assigned=(): validated(read_document(path, assigned), kind)


def named_values(record: Any, *names: str) -> dict[str, Any]:
    """Return name → value for some attributes of a record."""
    return {name: getattr(record, name) for name in names}


def rows_by(
    key: Callable[[Any], Any], row: Callable[[Any], Row]
) -> Callable[[Iterable[Any]], list[Row]]:
    """Return a function that makes a row of each group of records."""
    return lambda records: [row(group) for group in grouped(records, key).values()]


def csv_of(rows: Sequence[Any], names: Iterable[str] = ()) -> str:
    """Return rows as CSV with a column for each name; empty for NaN.

    By default the names are those of the first row.
    """
    names = list(names or vars(rows[0]))
    table = (named_values(row, *names).values() for row in rows)
    return comma_separated(
        [names, *([None if value != value else value for value in line] for line in table)]
    )
