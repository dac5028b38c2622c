"""Numbers published in the paper, and the shipped scenes solved by the five methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.recording.datasets import folder as shipped_folder
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation import run as simulated
from lampest.report.compare import Steps, compare
from lampest.report.strongest import furthest, percent_change
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import Results, read_results
from lampest.studies.study import read_settings

MEASURED = "measured"
FASTEST = "formulation={kind: reduced, joint: true}"  # finds the optima that the files' formulations find, sooner
OnCase = Callable[[int, int], None]
FILE = Path(__file__).with_name("published.yaml")
MOUTHS = {"lamprey_35mm": "paper_35mm", "lamprey_25mm": "paper_25mm"}  # shipped recording → as the paper's panel has it


class ChangeAt(NamedTuple):
    """Figure 1-e: ΔR/R₀ of a flat cell in percent at a pressure in kPa."""

    kpa: float
    percent: float


class SlopeOver(NamedTuple):
    """Inset with δ(ΔR/R₀)/δP per kPa between two pressures in kPa."""

    from_kpa: float
    to_kpa: float
    per_kpa: float


class BentCell(NamedTuple):
    """Figure 2, a bent cell: unloaded resistance, and ΔR/R₀ in percent at 40 kPa."""

    curvature_per_m: float
    ohm: float
    percent: float
    radius_mm: float | None = None


class LoadMap(NamedTuple):
    """A map of figure 6: the load on the panel, and its shipped recording."""

    letter: str
    recording: str
    condition: str


class RangeMap(NamedTuple):
    """A map of figure 8: smallest and largest relative change in percent."""

    letter: str
    method: str
    low: float
    high: float


class MouthMap(NamedTuple):
    """A map of figure 9: `cells` by `cells` of the grid are covered."""

    letter: str
    diameter_mm: float
    cells: int


class ErrorRow(NamedTuple):
    """A row of table I: time of a step in s, and |f(r) − R_m|/R_m in percent, mean and standard deviation."""

    method: str
    steps: Steps
    time_s: float
    error_percent: float
    error_sd_percent: float
    time_sd_s: float | None = None


class Published(NamedTuple):
    """All published numbers; `places` are their places in the paper, by subject."""

    schema: Literal[1]
    places: dict[str, str]
    changes: tuple[ChangeAt, ...]
    slopes: tuple[SlopeOver, ...]
    bent_cells: tuple[BentCell, ...]
    loads: tuple[LoadMap, ...]
    ranges: tuple[RangeMap, ...]
    mouth_method: str
    mouths: tuple[MouthMap, ...]
    errors: tuple[ErrorRow, ...]


read_published = read_settings(Published)


class LoadSeen(NamedTuple):
    """Measurement of a load: relative change in percent, (rows, columns); lowest and highest pressure in kPa."""

    change: Array
    felt: tuple[float, float]


class StepsSeen(NamedTuple):
    """Mean and standard deviation of the data error in percent, and mean time in s of some steps; NaN: none."""

    error: float = nan
    error_sd: float = nan
    time: float = nan


@dataclass(frozen=True, eq=False)
class Side:
    """A set of scenes that is compared with the paper.

    Attributes
    ----------
    name, word : str
        Name on the page and in files.
    mouths : sequence of Recording
        The large and the small one.
    loads : mapping
        Letter of figure 6 → measurement.
    changes : mapping
        (method, number of the mouth) → relative change in percent of the shown frame, (rows, columns). Measured ones
        include the series resistance, as in the paper.
    steps : mapping
        (method, steps) → figures of the large mouth.
    """

    name: str
    word: str
    mouths: Sequence[Recording]
    loads: Mapping[str, LoadSeen]
    changes: Mapping[tuple[str, int], Array]
    steps: Mapping[tuple[str, Steps], StepsSeen]

    @property
    def panel(self) -> Panel:
        """Panel of the recordings."""
        return self.mouths[0].scene.panel

    def change(self, method: str, number: int = 0) -> Array:
        """Return a relative change. Raises InputError if there is none."""
        if (method, number) not in self.changes:
            raise InputError(f"{self.name}: there are no results of {method}")
        return self.changes[method, number]


def all_sides(folder: Path, published: Published, jobs: int | None, on_case: OnCase) -> tuple[Side, ...]:
    """Simulate and solve all scenes, reusing results in the folder.

    Raises InputError for a missing shipped file, a failed case, and a folder that cannot be written.
    """
    configs, data = shipped_folder() / "configs", shipped_folder() / "data"

    def made(name: str) -> Path:
        """Return the recording of the paper's panel, simulated once."""
        word = MOUTHS.get(name, f"real_{name}")
        file = folder / "recordings" / f"{word}.h5"
        if not file.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            simulated(configs / f"{word}.yaml", file)
        return file

    def side(name: str, word: str, run: str, recorded: Callable[[str], Path]) -> Side:
        files = [recorded(mouth) for mouth in MOUTHS]
        named = f"recordings=[{', '.join(repr(str(file.resolve())) for file in files)}]"
        cases = read_run(configs / run, (FASTEST, named))
        report = run_batch(cases, folder / word, local(jobs, len(cases.cases)), on_frames=on_case)
        if report.results is None or report.failed:
            raise InputError(f"{configs / run}: {'; '.join(f'{case}: {why}' for case, why in report.failed)}")
        mouths = [Recording.load(file) for file in files]
        loads = {load.letter: _load(recorded(load.recording)) for load in published.loads}
        return shown(Side(name, word, mouths, loads, *_optima(read_results(report.results), mouths)))

    clean = side("clean scenes", "clean", "table1.yaml", lambda name: data / f"{name}.h5")
    panel = side("paper's panel", "panel", "paper_run.yaml", made)
    return clean, panel


def shown(side: Side) -> Side:
    """Return the side with changes of its shown frame (clean: the strongest, else the first) and measured ones."""
    frames = [furthest_frame(mouth) if side.word == "clean" else 0 for mouth in side.mouths]
    changes = {key: np.asarray(change[frames[key[1]]]) for key, change in side.changes.items()}
    for number, (mouth, frame) in enumerate(zip(side.mouths, frames, strict=True)):
        changes[MEASURED, number] = percent_change(mouth.recorded[mouth.measured_frames()[frame]], unloaded(mouth))
    return replace(side, changes=changes)


def _load(file: Path) -> LoadSeen:
    """Return the measurement of the strongest frame of a simulated recording."""
    recording = Recording.load(file)
    assert recording.truth_pressure is not None
    frame = int(recording.measured_frames()[furthest_frame(recording)])
    felt = recording.truth_pressure[frame]
    change = percent_change(recording.recorded[frame], unloaded(recording))
    return LoadSeen(change, (float(felt.min()), float(felt.max())))


def _optima(results: Results, mouths: Sequence[Recording]) -> tuple[dict[Any, Array], dict[Any, StepsSeen]]:
    """Return changes and figures of all methods from a results file; steps are those of `lampest compare`."""
    changes = {
        (case.estimator, number): np.asarray(case.relative_change)
        for number, mouth in enumerate(mouths)
        for case in results.of(mouth.name)
    }
    steps = {}
    for row in compare(results):
        if row["recording"] == mouths[0].name:
            names = ("data error mean [%]", "data error sd [%]", "solve time mean [s]")
            figures = (nan if row[name] is None else row[name] for name in names)
            steps[row["estimator"], row["steps"]] = StepsSeen(*figures)
    return changes, steps


def unloaded(recording: Recording) -> Array:
    """Return the mean of the unloaded frames as recorded, (rows, columns) ohm."""
    return np.asarray(recording.recorded[recording.role == UNLOADED].mean(axis=0))


def furthest_frame(recording: Recording) -> int:
    """Return the index of the strongest measured frame."""
    readings = Readings.of(recording.scene, recording.recorded, recording.sigma)
    resting = readings[recording.role == UNLOADED].mean().value
    return furthest(readings.value[recording.measured_frames()], resting)
