"""NWB (Neurodata Without Borders): one session, every estimator a processing module."""

import hashlib
import warnings
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files.errors import InputError, extra
from lampest.panel.conditions import Experiment, MeasuredSubject
from lampest.report.export.formats import Export
from lampest.runs.case import TIME, CaseResult, Cases
from lampest.runs.columns import CELLS


class NwbExport(Export):
    """Neurodata Without Borders.

    Measurements are under acquisition, each estimator is in a processing module. Maps and figures
    of frames are TimeSeries (time × rows × columns). Texts are in a table of frames. Maps without
    time are in a table of cells with positions in mm. A file holds one session with a start time.
    """

    kind = "nwb"
    suffix = ".nwb"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the session.

        Raises InputError also for several recordings and for an unknown start.
        """
        with extra("export"):
            from pynwb import NWBHDF5IO
        recordings = dict.fromkeys(case.recording for case in cases)
        if len(recordings) > 1:
            named = ", ".join(recordings)
            raise InputError(f"an NWB file is one session: choose with --recording one of {named}")
        session = _session(cases)
        for element in _elements(cases[0], shared=True):
            session.add_acquisition(element)
        for case in cases:
            words = "\n".join(
                f"{name}: {text}" for name, text in case.attributes.items() if name != "scene"
            )
            called = case.estimator.replace(":", "_").replace("/", "_")  # NWB allows neither
            session.create_processing_module(name=called, description=words).add(
                [*_elements(case, shared=False)]
            )
        with warnings.catch_warnings():
            # The temporary name does not.
            warnings.filterwarnings("ignore", ".*does not end in '.nwb'")
            with NWBHDF5IO(path, mode="w") as file:
                file.write(session)


def _session(cases: Cases) -> Any:
    """Return subject, time and purpose of the session.

    Raises InputError without a start time in a time zone.
    """
    from pynwb import NWBFile
    from pynwb.file import Subject

    first = cases[0]
    subject = first.scene.subject
    experiment = first.scene.experiment or Experiment()
    start = None
    with suppress(ValueError):
        start = datetime.fromisoformat(first.start_time)
    if start is None or start.tzinfo is None:
        message = f"at {first.start_time}, without a zone" if first.start_time else "nowhere"
        raise InputError(
            f"an NWB file says when a session began; {first.recording} says it {message}: "
            "give it with --start 2026-05-04T09:30:00+02:00"
        )
    celsius = experiment.water_temperature_celsius
    water = "" if celsius is None else f"water at {celsius:g} degrees Celsius"
    session_name = first.recording + "".join(case.case_id for case in cases)
    return NWBFile(
        session_description="cells of a resistive panel estimated from its readings, "
        f"recording {first.recording}",
        identifier=hashlib.sha256(session_name.encode()).hexdigest()[:32],
        session_start_time=start,
        session_id=first.recording,
        notes=first.attributes["scene"],
        experiment_description="; ".join(filter(None, (experiment.title, water, experiment.note)))
        or None,
        experimenter=(experiment.experimenter,) if experiment.experimenter else None,
        institution=experiment.institution or None,
        subject=None if subject is None else Subject(**_described(subject)),
    )


def _described(subject: MeasuredSubject) -> dict[str, str | None]:
    """Return the entries of an NWB subject; None where the scene states none."""
    length = "" if subject.length_mm is None else f"{subject.length_mm:g} mm long"
    return {
        "subject_id": subject.id or None,
        "species": subject.species or None,
        "weight": None if subject.mass_g is None else f"{subject.mass_g / 1000:g} kg",
        "description": "; ".join(filter(None, (length, subject.note))) or None,
    }


def _elements(case: CaseResult, *, shared: bool) -> Iterator[Any]:
    """Yield time series of numbers, a table of frames with texts, and a table of cells.

    The table of cells is for columns without time.
    """
    from hdmf.common import DynamicTable, VectorData
    from pynwb import TimeSeries

    held = {
        name: column
        for name, column in case.variables().items()
        if column.shared == shared and name != TIME.name
    }
    for name, column in held.items():
        if column.dtype is not str and column.axes != CELLS:
            known = {"name": name, "unit": column.units, "description": column.meaning}
            yield TimeSeries(data=column.stored, timestamps=case.time, **known)
    panel = case.scene.panel
    rows, lines = np.indices(panel.shape)
    x, y = panel.places_mm
    place = "position of the cell, mm"
    places = [
        ("row", "row line", rows),
        ("column", "column line", lines),
        ("y_mm", place, y),
        ("x_mm", place, x),
    ]
    if panel.heights_mm is not None:
        places.append(("z_mm", place, panel.heights_mm))
    time = [("time", "time of the frame, s", case.time)]
    texts = {name: each for name, each in held.items() if each.dtype is str}
    fixed = {name: each for name, each in held.items() if each.axes == CELLS}
    for table, words, columns, requested in (
        ("frames", "what frames say in words", time, texts),
        ("cells", "what has no time", places, fixed),
    ):
        columns += [
            (name, f"{each.meaning}, {each.units}", each.values) for name, each in requested.items()
        ]
        vectors = [
            VectorData(
                name=name,
                description=text,
                data=list(values) if isinstance(values, tuple) else np.ravel(values),
            )
            for name, text, values in columns
        ]
        if requested:
            yield DynamicTable(name=table, description=words, columns=vectors)
