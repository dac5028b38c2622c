"""NWB (Neurodata Without Borders): one session, every estimator a processing module."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lampest.files.errors import InputError
from lampest.files.extras import extra
from lampest.panel.scene import Scene
from lampest.report.export.export import Export
from lampest.runs.case import CaseResult
from lampest.runs.columns import CELLS, FIGURES, TIME, Column, all_columns
from lampest.runs.labelled import about


class NwbExport(Export):
    """What was measured stands under acquisition, what an estimator made of it in the module of its name.

    Maps and numbers of frames are TimeSeries (time × rows × columns), sentences stand in a table of frames, maps that
    have no time in a table of cells with their positions in mm. The format holds one session, and
    must know when it began.
    """

    kind: ClassVar[str] = "nwb"
    suffix: ClassVar[str] = ".nwb"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """The session. Raises InputError also where there are several recordings, or none says when it began."""
        with extra("export"):
            from pynwb import NWBHDF5IO
        first, recordings = cases[0], dict.fromkeys(case.recording for case in cases)
        if len(recordings) > 1:
            raise InputError(f"an NWB file is one session: choose with --recording one of {', '.join(recordings)}")
        session = _session(cases)
        for thing in _things(first, [column for column in all_columns() if column.shared and column != TIME]):
            session.add_acquisition(thing)
        for case in cases:
            module = session.create_processing_module(name=_called(case.estimator), description=_words(case))
            for thing in _things(case, [column for column in all_columns() if not column.shared]):
                module.add(thing)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*does not end in '.nwb'")  # it will, once it is whole
            with NWBHDF5IO(path, mode="w") as file:
                file.write(session)


def _session(cases: Sequence[CaseResult]) -> Any:
    from pynwb import NWBFile

    first = cases[0]
    start = _start(first)
    together = "".join(case.case_id for case in cases)
    session = NWBFile(
        session_description=f"cells of a resistive panel estimated from its readings, recording {first.recording}",
        identifier=hashlib.sha256(f"{first.recording}{together}".encode()).hexdigest()[:32],
        session_start_time=start,
        session_id=first.recording,
        notes=about(first)["scene"],
        source_script_file_name="lampest export",
        source_script=f"lampest {first.versions.get('lampest', '')}",
    )
    _tell(session, first.scene)
    rows, columns = first.scene.panel.shape
    session.create_device(
        name="panel", description=f"{rows} × {columns} cells, {first.scene.panel.pitch_mm:g} mm apart"
    )
    return session


def _tell(session: Any, scene: Scene) -> None:
    """Who was measured and for what, where the scene says it."""
    from pynwb.file import Subject

    subject, experiment = scene.subject, scene.experiment
    if subject is not None:
        length = "" if subject.length_mm is None else f"{subject.length_mm:g} mm long"
        session.subject = Subject(
            subject_id=subject.id or None,
            species=subject.species or None,
            weight=None if subject.mass_g is None else f"{subject.mass_g / 1000:g} kg",
            description="; ".join(filter(None, (length, subject.note))) or None,
        )
    if experiment is not None:
        celsius = experiment.water_temperature_celsius
        water = "" if celsius is None else f"water at {celsius:g} degrees Celsius"
        told = "; ".join(filter(None, (experiment.title, water, experiment.note)))
        session.experiment_description = told or None
        session.experimenter = (experiment.experimenter,) if experiment.experimenter else None
        session.institution = experiment.institution or None


def _start(case: CaseResult) -> datetime:
    """When the session began. Raises InputError where nobody says, or not in which zone."""
    try:
        start = datetime.fromisoformat(case.start_time)
    except ValueError:
        start = None
    if start is None or start.tzinfo is None:
        said = f"at {case.start_time}, without a zone" if case.start_time else "nowhere"
        raise InputError(
            f"an NWB file says when a session began; {case.recording} says it {said}: give it with "
            "--start 2026-05-04T09:30:00+02:00"
        )
    return start


def _things(case: CaseResult, columns: Sequence[Column]) -> Iterator[Any]:
    """A series for every number over time, a table of frames for texts, a table of cells for what has no time.

    The case's own figures, such as costs, follow where its own columns are asked for.
    """
    from pynwb import TimeSeries

    held = [column.of(case.scene.circuit) for column in columns if case.column(column.name) is not None]
    for column in held:
        if column.dtype is not str and column.axes != CELLS:
            told = {"unit": column.units, "description": _meaning(column)}
            values = column.stored(case.column(column.name))
            yield TimeSeries(name=column.name, data=values, timestamps=case.time, **told)
    if not all(column.shared for column in held):
        for folder in FIGURES:
            for name, figures in getattr(case, folder.name).items():
                told = {"unit": folder.units(name), "description": folder.long_name(name)}
                series = f"{folder.folder}_{name}"
                yield TimeSeries(name=series, data=np.asarray(figures), timestamps=case.time, **told)
    yield from _tables(case, held)


def _tables(case: CaseResult, columns: Sequence[Column]) -> Iterator[Any]:
    """What no series holds: texts, a line for every frame; maps without a time, a line for every cell."""
    rows, lines = np.indices(case.scene.panel.shape)
    x, y = case.scene.panel.centres_mm()
    cells = {
        ("row", "row line"): rows,
        ("column", "column line"): lines,
        ("y_mm", "position of the row, mm"): y[rows],
        ("x_mm", "position of the column, mm"): x[lines],
    }
    frames = {("time", "time of the frame, s"): case.time}
    for name, words, start, wanted in (
        ("frames", "what frames say in words", frames, [column for column in columns if column.dtype is str]),
        ("cells", "what has no time", cells, [column for column in columns if column.axes == CELLS]),
    ):
        if wanted:
            further = {
                (column.name, f"{_meaning(column)}, {column.units}"): case.column(column.name) for column in wanted
            }
            yield _table(name, words, start | further)


def _table(name: str, words: str, held: Mapping[tuple[str, str], Any]) -> Any:
    """(name, description) of every column → its values, in order."""
    from hdmf.common import DynamicTable, VectorData

    columns = [
        VectorData(name=name, description=words, data=list(values) if isinstance(values, tuple) else np.ravel(values))
        for (name, words), values in held.items()
    ]
    return DynamicTable(name=name, description=words, columns=columns)


def _meaning(column: Column) -> str:
    flags = "; ".join(f"{value}: {word.replace('_', ' ')}" for value, word in column.flags)
    return f"{column.long_name} ({flags})" if flags else column.long_name


def _words(case: CaseResult) -> str:
    """What of a case is no series."""
    return "\n".join(f"{name}: {text}" for name, text in about(case).items() if name != "scene")


def _called(name: str) -> str:
    """A name as NWB allows it."""
    return name.replace(":", "_").replace("/", "_")
