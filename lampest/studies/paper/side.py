"""One set of scenes that stands beside the paper: its recordings, and what the five methods make of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.plots.contours import percent_change
from lampest.report.plots.plot import furthest, strongest_index
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import CaseResult, Results, read_results
from lampest.studies.paper.published import Published

MEASURED = "measured"
FASTEST = "formulation=reduced"  # finds the optima that the file's formulation finds, sooner


@dataclass(frozen=True)
class SceneSet:
    """A set of scenes: name and sentence for the page, word for files, the run's file, and the recordings of figure 6.

    The run's first two recordings are the large and the small mouth. prefix : of figure 6's recordings.
    """

    name: str
    word: str
    about: str
    run: Path
    prefix: str = ""


@dataclass(frozen=True, eq=False)
class LoadSeen:
    """What was measured of one load: relative change in percent, (rows, columns); felt : (lowest, highest) kPa."""

    panel: Panel
    change: Array
    felt: tuple[float, float]
    frame: int


@dataclass(frozen=True, eq=False)
class Side:
    """What is drawn and held against the paper."""

    scenes: SceneSet
    results: Results
    loads: Mapping[str, LoadSeen]

    def mouth(self, number: int) -> tuple[CaseResult, ...]:
        """The cases of the large (0) or the small (1) mouth."""
        return self.results.of(self.results.recordings()[number])

    def case(self, method: str, number: int = 0) -> CaseResult:
        """One method's case. Raises InputError where the run has none."""
        for case in self.mouth(number):
            if case.estimator == method:
                return case
        raise InputError(f"{self.scenes.run}: has no estimator {method}")

    def shown(self, number: int = 0) -> int:
        """Which frame of a mouth is shown."""
        return strongest_index(self.mouth(number))

    def change(self, method: str, number: int = 0) -> Array:
        """Relative change in percent of the shown frame, (rows, columns): of a method, or as measured."""
        place = self.shown(number)
        if method == MEASURED:
            case = self.mouth(number)[0]
            return percent_change(recorded(case, case.measured[place]), recorded(case, case.measured_baseline))
        return np.asarray(self.case(method, number).relative_change[place])


def recorded(case: CaseResult, network: Array) -> Array:
    """Readings of the network as the divider gives them, series resistance included: the paper takes none off."""
    return np.asarray(case.scene.circuit.to_recorded(network, case.scene))


def solved(
    scenes: SceneSet,
    published: Published,
    folder: Path,
    data: Path,
    jobs: int | None,
    on_case: Callable[[int, int], None],
) -> Side:
    """Run what is planned; results are kept in the folder, so that nothing is solved twice.

    Raises InputError where a file is wrong, a case fails, or the folder cannot be written.
    """
    run = read_run(scenes.run, (FASTEST,))
    report = run_batch(run, folder / scenes.word, local(jobs, len(run.cases)), on_case=on_case)
    if report.results is None or report.failed:
        raise InputError(f"{scenes.run}: {'; '.join(f'{case}: {why}' for case, why in report.failed)}")
    loads = {
        load.letter: load_seen(Recording.load(data / f"{scenes.prefix}{load.recording}.h5"))
        for load in published.loads.maps
    }
    return Side(scenes, read_results(report.results), loads)


def load_seen(recording: Recording) -> LoadSeen:
    """The frame in which cells have moved furthest, the last within a tenth of that."""
    readings = Readings.of(recording.scene, recording.recorded, recording.sigma)
    resting = readings[recording.role == UNLOADED].mean().value
    frames = recording.measured_frames()
    frame = int(frames[furthest(readings.value[frames], resting)])
    assert recording.truth_pressure is not None
    felt = recording.truth_pressure[frame]
    baseline = recording.recorded[recording.role == UNLOADED].mean(axis=0)
    change = percent_change(recording.recorded[frame], baseline)
    return LoadSeen(recording.scene.panel, change, (float(felt.min()), float(felt.max())), frame)
