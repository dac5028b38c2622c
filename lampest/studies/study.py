"""What every study is: settings from YAML → measurements → rows as CSV, samples as HDF5, figures, tables."""

import importlib.util
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from lampest.files import hdf5
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.files.whole import write_whole
from lampest.recording.datasets import folder as shipped_folder
from lampest.report.compare import Table, comma_separated
from lampest.report.plots.style import save
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
Figures = Mapping[str, Callable[[Any], Any]]  # column of the CSV file → its value for a group of samples
Column = tuple[str, str, str] | tuple[str, str, str, str]  # name, unit, meaning; path where it is not the name


@dataclass(frozen=True)
class Reported:
    """What a study leaves. tables : with their titles, '' for none. remarks, left_out : sentences. files : written."""

    tables: Sequence[tuple[str, Table]]
    files: Sequence[Path]
    remarks: Sequence[str] = ()
    left_out: Sequence[str] = ()


@dataclass(frozen=True)
class Study(Generic[Settings, Found]):
    """A study as a declaration; files, tables and pictures follow from it.

    name : of its files. counts : what the progress bar counts. config : the shipped file, where none is named.
    read : (file, overriding entries) → settings; raises InputError with line and column.
    measure : (settings, on_step) → what was found. All others take what was found:
    columns, rows : of the CSV file. tables : with their titles. form, samples : format of the HDF5 file, and what
    writes into its /entry; none without. figures : by name of the file. texts : of further files, by their names.
    remarks, left_out : sentences.
    """

    name: str
    counts: str
    config: str
    read: Callable[[Path, tuple[str, ...]], Settings]
    measure: Callable[[Settings, OnStep], Found]
    columns: Iterable[str]
    rows: Callable[[Found], Sequence[Any]]
    tables: Callable[[Found], Sequence[tuple[str, Table]]]
    form: str = ""
    samples: Callable[[Any, Found], None] = lambda entry, found: None
    figures: "Callable[[Found], Mapping[str, Figure]]" = lambda found: {}
    texts: Callable[[Found], Mapping[str, str]] = lambda found: {}
    remarks: Callable[[Found], Sequence[str]] = lambda found: ()
    left_out: Callable[[Found], Sequence[str]] = lambda found: ()

    def run(self, config: Path | None, out: Path | None, assigned: tuple[str, ...], on_step: OnStep) -> Reported:
        """Read, measure and write into a folder, results/<config> by default.

        Raises InputError where the file is at fault or the folder cannot be written.
        """
        file = config or shipped_folder() / "configs" / self.config
        folder = out or Path("results") / file.stem
        found = self.measure(self.read(file, assigned), on_step)
        return Reported(self.tables(found), self._write(found, folder), self.remarks(found), self.left_out(found))

    def _write(self, found: Found, folder: Path) -> list[Path]:
        texts = {f"{self.name}.csv": csv_of(self.columns, self.rows(found))} | dict(self.texts(found))
        for name, text in texts.items():
            write_whole(folder / name, text)
        files = [folder / name for name in texts]
        if self.form:
            files.append(folder / f"{self.name}.h5")
            with hdf5.new_file(files[-1]) as file:
                hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=self.form)
                entry = file.create_group("entry")
                hdf5.set_attributes(entry, NX_class="NXentry")
                libraries = ("lampest", "casadi", "numpy", "scipy", "h5py")
                hdf5.set_attributes(entry, **{f"{library}_version": version(library) for library in libraries})
                self.samples(entry, found)
        for name, figure in self.figures(found).items():
            files.append(folder / f"{name}.png")
            save(figure, files[-1])
        return files


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
    numbers = {id(task): number for number, task in enumerate(tasks)}
    for task, result in executor.results(function, tasks):
        found[numbers[id(task)]] = result if isinstance(result, tuple) else (lost(task, result),)
        on_step(len(found), len(tasks))
    return tuple(one for number in range(len(tasks)) for one in found[number])


@cache
def published_code(name: str) -> ModuleType:
    """A module of tests/oracles/ with solvers that others have published; a wheel carries it beside `configs/`.

    Raises InputError where it is not there.
    """
    file = shipped_folder() / "tests" / "oracles" / f"{name}.py"
    if not file.is_file():
        raise InputError(f"{file}: the solvers of others, to compare with, are not there")
    described = importlib.util.spec_from_file_location(f"lampest_{name}", file)
    assert described is not None and described.loader is not None
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    return module


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
    left_out = []
    for number, case in enumerate(run.cases, 1):
        found_here = function(case)
        if isinstance(found_here, str):
            left_out.append((f"{case.recording}/{case.name}", found_here))
        else:
            found += found_here
        on_step(number, len(run.cases))
    if not found:
        raise InputError(f"nothing to {purpose}: {'; '.join(f'{name}: {why}' for name, why in left_out)}")
    return Cases(found, [f"{name} left out: {why}" for name, why in left_out])


def grouped(samples: Iterable[Any], key: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Samples by what the key says of them, in the order in which that first appears."""
    found: dict[Any, list[Any]] = {}
    for sample in samples:
        found.setdefault(key(sample), []).append(sample)
    return found


def rows_of(groups: Iterable[Any], figures: Figures) -> list[Row]:
    """A row for each group of samples: all figures of it."""
    return [Row(**{name: figure(own) for name, figure in figures.items()}) for own in groups]


def screen_table(rows: Iterable[Any], columns: Mapping[str, Callable[[Any], str]]) -> Table:
    """Rows for the screen, by title: the text of a row."""
    return Table(tuple(columns), tuple(tuple(text(row) for text in columns.values()) for row in rows))


def text_of(value: float | None, form: str = ".3g") -> str:
    """A number as text; nothing for None and NaN."""
    return "" if value is None or np.isnan(value) else f"{value:{form}}"


def csv_of(names: Iterable[str], rows: Sequence[Any]) -> str:
    """Rows as CSV, a column for each name; six digits, empty where there is no number."""
    names = list(names)
    table = ([getattr(row, name) for name in names] for row in rows)
    texts = ([text_of(one, ".6g") if isinstance(one, float) else one for one in line] for line in table)
    return comma_separated([names, *texts])


def write_columns(
    group: Any, rows: Any, columns: Sequence[Column], scales: tuple[str, ...] = (), dtype: Any = None
) -> None:
    """A dataset for every column: one number or text of each row of a sequence, or an object's own array.

    Truth values become 0 and 1, text ASCII, None NaN where dtype is float.
    """
    for name, units, meaning, *path in columns:
        value = attrgetter(*(path or [name]))
        values = np.asarray([value(row) for row in rows] if isinstance(rows, list | tuple) else value(rows), dtype)
        if values.dtype == bool:
            values = values.astype(np.uint8)
        hdf5.write_dataset(
            group, name, hdf5.ascii_array(values) if values.dtype.kind == "U" else values, units, meaning, scales
        )


def write_sequence(
    entry: Any, name: str, signal: str, axis: tuple[str, str], rows: Sequence[Any], columns: Sequence[Column]
) -> None:
    """/entry/<name>: a dataset for every column, with a value for each row; axis : name and meaning."""
    hdf5.set_attributes(entry, default=name)
    group = entry.create_group(name)
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=[axis[0]])
    hdf5.write_scale(group, axis[0], np.arange(len(rows)), "1", axis[1])
    write_columns(group, rows, columns, (axis[0],))
