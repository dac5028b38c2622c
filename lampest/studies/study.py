"""What every study is: settings from YAML → records, one an experiment → HDF5, CSV, Markdown, figures, tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from string import Formatter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from lampest.files import hdf5
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.files.whole import refuse_inputs, write_whole
from lampest.recording.datasets import folder as shipped_folder
from lampest.report.compare import Table, comma_separated
from lampest.report.plots.style import save
from lampest.report.words import digits
from lampest.runs.config import Case, Run
from lampest.runs.executors import Executor, local

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Settings = TypeVar("Settings")
Found = TypeVar("Found")
Kind = TypeVar("Kind")
Task = TypeVar("Task")
OnStep = Callable[..., None]
Row = SimpleNamespace  # one line of a study's CSV file
Screen = Mapping[str, str | Callable[[Any], str]]  # title → template over a row's values, or the text of a row
LIBRARIES = ("lampest", "casadi", "numpy", "scipy", "h5py")


def column(unit: str, meaning: str, default: Any = MISSING) -> Any:
    """A field of a record that becomes a dataset with that unit and meaning."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


@dataclass(frozen=True)
class RecordGroup:
    """Records of one dataclass as a group of the HDF5 file, with a dataset for every field that is a `column`.

    path : in /entry. signal : what a viewer draws. axis : the column along which it does; '': the records' number.
    units : in place of those of the columns. attributes : of the group.
    """

    path: str
    records: Sequence[Any]
    signal: str
    axis: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    def write(self, entry: Any) -> None:
        """Truth values become 0 and 1, text ASCII, None NaN."""
        group, axis = entry.create_group(self.path), self.axis or "record"
        hdf5.set_attributes(group, NX_class="NXdata", signal=self.signal, axes=[axis], **self.attributes)
        if not self.axis:
            hdf5.write_scale(group, axis, np.arange(len(self.records)), "1", "number of the record")
        columns = [one for one in fields(self.records[0]) if one.metadata]
        for one in sorted(columns, key=lambda one: one.name != axis):  # the scale is there before others need it
            values = np.array([getattr(record, one.name) for record in self.records])
            if values.dtype.kind in "bO":
                values = values.astype(np.uint8 if values.dtype.kind == "b" else float)
            data = hdf5.ascii_array(values) if values.dtype.kind == "U" else values
            unit, meaning = self.units.get(one.name, one.metadata["unit"]), one.metadata["meaning"]
            if one.name == axis:
                hdf5.write_scale(group, axis, data, unit, meaning)
            else:
                hdf5.write_dataset(group, one.name, data, unit, meaning, (axis,))


@dataclass(frozen=True)
class Reported:
    """What a study leaves. tables : with their titles, '' for none. remarks, left_out : sentences. files : written."""

    tables: Sequence[tuple[str, Table]]
    files: Sequence[Path]
    remarks: Sequence[str] = ()
    left_out: Sequence[str] = ()


@dataclass(frozen=True)
class Study(Generic[Settings, Found]):
    """A study as a declaration; `run` makes files, tables and figures of it.

    name : of its files. counts : what the progress bar counts. config : the shipped file, where none is named.
    read : (file, overriding entries) → settings; raises InputError with line and column.
    measure : (settings, on_step) → what was found. All others take what was found:
    rows : of the CSV file, at least one; screen : their table. tables : further ones, with their titles.
    form, records : of the HDF5 file; none without.
    figures : by name of the file. texts : of further files, by their names. remarks, left_out : sentences.
    """

    name: str
    counts: str
    config: str
    read: Callable[[Path, tuple[str, ...]], Settings]
    measure: Callable[[Settings, OnStep], Found]
    rows: Callable[[Found], Sequence[Any]]
    screen: Screen = field(default_factory=dict)
    tables: Callable[[Found], Sequence[tuple[str, Table]]] = lambda found: ()
    form: str = ""
    records: Callable[[Found], Iterable[RecordGroup]] = lambda found: ()
    figures: "Callable[[Found], Mapping[str, Figure]]" = lambda found: {}
    texts: Callable[[Found], Mapping[str, str]] = lambda found: {}
    remarks: Callable[[Found], Sequence[str]] = lambda found: ()
    left_out: Callable[[Found], Sequence[str]] = lambda found: ()

    def run(self, config: Path | None, out: Path | None, assigned: tuple[str, ...], on_step: OnStep) -> Reported:
        """Read, measure and write into a folder, results/<config> by default.

        Raises InputError where the file is at fault or the folder cannot be written.
        """
        file = config or shipped_folder() / "configs" / self.config
        found = self.measure(self.read(file, assigned), on_step)
        rows, remarks, folder = self.rows(found), self.remarks(found), out or Path("results") / file.stem
        tables = [("", screen_table(rows, self.screen))] if self.screen else []
        tables += self.tables(found)
        texts = {f"{self.name}.csv": csv_of(rows), **self.texts(found)}
        texts |= {f"{self.name}.md": page(self.name, tables, remarks)} if tables else {}
        return Reported(tables, self._write(found, folder, texts), remarks, self.left_out(found))

    def _write(self, found: Found, folder: Path, texts: Mapping[str, str]) -> list[Path]:
        figures = {folder / f"{name}.png": figure for name, figure in self.figures(found).items()}
        data = [folder / f"{self.name}.h5"] if self.form else []
        files = [*(folder / name for name in texts), *data, *figures]
        refuse_inputs(files)
        for name, text in texts.items():
            write_whole(folder / name, text)
        for path in data:
            with hdf5.new_file(path) as file:
                hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=self.form)
                entry = file.create_group("entry")
                groups = list(self.records(found))
                hdf5.set_attributes(entry, NX_class="NXentry", default=groups[0].path)
                hdf5.set_attributes(entry, **{f"{library}_version": version(library) for library in LIBRARIES})
                for group in groups:
                    group.write(entry)
        for path, figure in figures.items():
            save(figure, path)
        return files


def page(name: str, tables: Sequence[tuple[str, Table]], remarks: Sequence[str]) -> str:
    """Tables and remarks as sections of Markdown."""
    sections = [f"## {title or name}\n\n{markdown(table)}" for title, table in tables]
    sections += ["## remarks\n\n" + "".join(f"- {line}\n" for line in remarks)] if remarks else []
    return "\n".join(sections)


def markdown(table: Table) -> str:
    """A table as GitHub's Markdown."""
    lines = (table.headers, tuple("---" for _ in table.headers), *table.cells)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def read_settings(kind: type[Kind]) -> Callable[..., Kind]:
    """What reads a YAML file as a dataclass, with entries overridden; raises InputError with line and column."""

    def read(path: Path, assigned: tuple[str, ...] = ()) -> Kind:
        found: Kind = validated(read_document(path, assigned), kind)
        return found

    return read


def of_tasks(
    function: Callable[[Task], tuple[Found, ...]],
    tasks: Sequence[Task],
    executor: Executor | None,
    lost: Callable[[Task, object], Found],
    on_step: OnStep,
) -> tuple[Found, ...]:
    """What a function finds of every task, in order, on an executor or all cores; `lost` stands for a task that died.

    on_step is called with how many of how many are done. Raises InputError where the executor cannot run here.
    """
    executor = executor or local(None, len(tasks))
    executor.ready()
    found: dict[int, tuple[Found, ...]] = {}
    for task, result in executor.results(function, tasks):
        found[id(task)] = result if isinstance(result, tuple) else (lost(task, result),)
        on_step(len(found), len(tasks))
    return tuple(one for task in tasks for one in found[id(task)])


@dataclass(frozen=True, eq=False)
class Cases(Generic[Found]):
    """What was found in the cases of a run. left_out : 'recording/estimator left out: why'."""

    found: Sequence[Found]
    left_out: Sequence[str]


def of_cases(
    function: Callable[[Case], Sequence[Found] | str], run: Run, on_step: OnStep, purpose: str = "measure"
) -> Cases[Found]:
    """What a function finds in every case of a run, in order; a text says why one is left out.

    on_step is called with how many of how many are done. Raises InputError where there is nothing for the purpose.
    """
    found: list[Found] = []
    left_out = {}
    for number, case in enumerate(run.cases, 1):
        found_here = function(case)
        if isinstance(found_here, str):
            left_out[f"{case.recording}/{case.name}"] = found_here
        else:
            found += found_here
        on_step(number, len(run.cases))
    if not found:
        raise InputError(f"nothing to {purpose}: {'; '.join(f'{name}: {why}' for name, why in left_out.items())}")
    return Cases(found, [f"{name} left out: {why}" for name, why in left_out.items()])


def grouped(records: Iterable[Any], key: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Records by what the key says of them, in the order in which that first appears."""
    found: dict[Any, list[Any]] = {}
    for record in records:
        found.setdefault(key(record), []).append(record)
    return found


def rows_by(key: Callable[[Any], Any], row: Callable[[Any], Row]) -> Callable[[Iterable[Any]], list[Row]]:
    """What makes a row of each group of records."""
    return lambda records: [row(own) for own in grouped(records, key).values()]


def text_of(value: Any, form: str = "digits") -> str:
    """A number as text, nothing for None and NaN; digits : three of them, with commas."""
    if value is None or value != value:
        return ""
    return digits(value) if form == "digits" else format(value, form)


class _Texts(Formatter):
    """Templates over the values of a row."""

    def format_field(self, value: Any, format_spec: str) -> str:
        return text_of(value, format_spec)


def screen_table(rows: Iterable[Any], columns: Screen) -> Table:
    """Rows for the screen; columns in which no row has anything are left out."""
    rows, texts = list(rows), _Texts()
    shown = {
        title: [of(row) if callable(of) else texts.vformat(of, (), vars(row)).strip(" ±") for row in rows]
        for title, of in columns.items()
    }
    shown = {title: cells for title, cells in shown.items() if any(cells)}
    return Table(tuple(shown), tuple(zip(*shown.values(), strict=True)))


def csv_of(rows: Sequence[Any], names: Iterable[str] = ()) -> str:
    """Rows as CSV, a column for each name, by default those of the first row; empty where there is no number."""
    names = list(names or vars(rows[0]))
    table = ([getattr(row, name) for name in names] for row in rows)
    return comma_separated([names, *([None if one != one else one for one in line] for line in table)])
