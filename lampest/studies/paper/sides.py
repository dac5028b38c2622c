"""What the paper publishes as numbers, and what stands beside: shipped scenes, and what five methods make of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from lampest.files.document import parse_document, read_document, validated
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.files import run as simulated
from lampest.report.compare import Steps, compare, spread
from lampest.report.strongest import furthest, percent_change
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import Results, read_results
from lampest.studies.study import published_code

MEASURED = "measured"
EVALUATION_S = 16.45 / 10_100  # table I: LSM's 16.45 ± 0.40 s are its limit of 10,000 evaluations and one derivative
NAN = float("nan")
FASTEST = "formulation=reduced"  # finds the optima that a file's formulation finds, sooner
CLEAN = (
    "The shipped recordings: readings within half a percent of the circuit, series resistance told and taken off for "
    "the estimates (not in maps of measured resistance, as in the paper), optima verified."
)
PANEL = (
    "The scene that was fitted to these numbers (configs/paper_35mm.yaml): unloaded cells differ by factors, every "
    "reading is off by a static error, and the relative methods weigh changes as fractions, not as percent. Optima "
    "verified."
)
SOLVER = (
    "The same recordings as MATLAB's lsqnonlin leaves them, in kind: bounds, tolerances and limits are its defaults. "
    "Times are its evaluations, at the 1.63 ms that one took the paper if LSM met the limit of 10,000."
)
OnCase = Callable[[int, int], None]
FILE = "published.yaml"


class ChangeAt(NamedTuple):
    """Figure 1-e: ΔR/R₀ of a flat cell in percent at a pressure in kPa."""

    kpa: float
    percent: float


class SlopeOver(NamedTuple):
    """Its inset: δ(ΔR/R₀)/δP per kPa between two pressures in kPa."""

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
    """A map of figure 6: what was on the panel; recording : the shipped one of it."""

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
    """All of it; places : where in the paper, by subject."""

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


def published_numbers(path: Path | None = None) -> Published:
    """The numbers of a file, the package's own by default. Raises InputError with line and column."""
    if path is not None:
        return cast(Published, validated(read_document(path), Published))
    text = files("lampest.studies.paper").joinpath(FILE).read_text(encoding="utf-8")
    return cast(Published, validated(parse_document(text, FILE), Published))


@dataclass(frozen=True)
class Weights:
    """λ of absolute penalties (resistances in ohm), of relative ones (changes in percent), and the start over R_m."""

    absolute: float = 1e-3
    relative: float = 10.0
    start: float = 1.0


@dataclass(frozen=True, eq=False)
class LeftBySolver:
    """What one method leaves of a recording.

    baseline : (rows, columns) ohm. cells, model, measured : (frames, rows, columns) ohm. evaluations : (frames) solves
    of the forward problem that MATLAB would have needed, derivatives included. why : (frames) what ended it.
    joint : whether the first frame was solved together with the baseline.
    """

    baseline: Array
    cells: Array
    model: Array
    measured: Array
    evaluations: NDArray[np.int64]
    why: tuple[str, ...]
    joint: bool

    @property
    def change(self) -> Array:
        """100·(r/r₀ − 1), (frames, rows, columns) percent."""
        return np.asarray(100 * (self.cells / self.baseline - 1))

    @property
    def data_error(self) -> Array:
        """100·|f(r) − R_m|/R_m, (frames, rows, columns) percent."""
        return np.asarray(100 * np.abs(self.model - self.measured) / self.measured)


WEIGHTS = Weights(relative=1e-3, start=1.66)


@dataclass(frozen=True, eq=False)
class LoadSeen:
    """What was measured of one load: relative change in percent, (rows, columns); felt : (lowest, highest) kPa."""

    panel: Panel
    change: Array
    felt: tuple[float, float]

    @classmethod
    def of(cls, recording: Recording) -> "LoadSeen":
        """The frame in which cells have moved furthest; of a simulated recording."""
        frame = int(recording.measured_frames()[furthest_frame(recording)])
        assert recording.truth_pressure is not None
        felt = recording.truth_pressure[frame]
        change = percent_change(recording.recorded[frame], unloaded(recording))
        return cls(recording.scene.panel, change, (float(felt.min()), float(felt.max())))


class StepsSeen(NamedTuple):
    """Of some steps: mean and standard deviation of the data error in percent, mean time in s."""

    error: float
    error_sd: float
    time: float


@dataclass(frozen=True, eq=False)
class Side:
    """One set of scenes that stands beside the paper.

    name, word, about : for the page, for files, a sentence. mouths : the large and the small one.
    loads : letter of figure 6 → what was seen. first : whether the first frame is shown, else the strongest one.
    estimated : (method, number of the mouth) → relative change in percent, (frames, rows, columns).
    steps : (method, steps) → what they took with the large mouth; NaN where there are no such steps.
    """

    name: str
    word: str
    about: str
    mouths: tuple[Recording, Recording]
    loads: Mapping[str, LoadSeen]
    first: bool
    estimated: Callable[[str, int], Array]
    steps: Callable[[str, Steps], StepsSeen]

    @property
    def panel(self) -> Panel:
        """Of all its recordings."""
        return self.mouths[0].scene.panel

    def change(self, method: str, number: int = 0) -> Array:
        """Relative change in percent of the shown frame, (rows, columns): by a method, or as measured.

        As the paper does, what is measured keeps its series resistance.
        """
        recording = self.mouths[number]
        shown = 0 if self.first else furthest_frame(recording)
        if method != MEASURED:
            return np.asarray(self.estimated(method, number)[shown])
        return percent_change(recording.recorded[recording.measured_frames()[shown]], unloaded(recording))


def all_sides(shipped: Path, folder: Path, published: Published, jobs: int | None, on_case: OnCase) -> tuple[Side, ...]:
    """Simulate, solve and read; what was solved in the folder before is taken from it.

    shipped : holds `configs/` and `data/`. Raises InputError where a file is missing, a case fails, or the folder
    cannot be written.
    """
    configs, data, made = shipped / "configs", shipped / "data", folder / "recordings"
    letters = {load.letter: load.recording for load in published.loads}
    loads = {letter: LoadSeen.of(Recording.load(data / f"{name}.h5")) for letter, name in letters.items()}
    mouths = Recording.load(data / "lamprey_35mm.h5"), Recording.load(data / "lamprey_25mm.h5")
    results = _solved(configs / "table1.yaml", (), folder / "clean", jobs, on_case)
    clean = Side("clean scenes", "clean", CLEAN, mouths, loads, False, *_optima("clean scenes", results, mouths))
    files = [_made(configs / f"{name}.yaml", made) for name in ("paper_35mm", "paper_25mm")]
    mouths = Recording.load(files[0]), Recording.load(files[1])
    loads = {
        letter: LoadSeen.of(Recording.load(_made(configs / f"real_{name}.yaml", made)))
        for letter, name in letters.items()
    }
    assigned = (f"recordings=[{', '.join(repr(str(file.resolve())) for file in files)}]",)
    results = _solved(configs / "paper_run.yaml", assigned, folder / "panel", jobs, on_case)
    panel = "paper's panel"
    optima = Side(panel, "panel", PANEL, mouths, loads, True, *_optima(panel, results, mouths))
    return clean, optima, Side("its solver", "solver", SOLVER, mouths, loads, True, *_left_by_solver(mouths))


def _optima(
    name: str, results: Results, mouths: tuple[Recording, Recording]
) -> tuple[Callable[[str, int], Array], Callable[[str, Steps], StepsSeen]]:
    """Verified optima, from a results file with a case of every method; steps are those of `lampest compare`."""

    def estimated(method: str, number: int) -> Array:
        for case in results.of(mouths[number].name):
            if case.estimator == method:
                return np.asarray(case.relative_change)
        raise InputError(f"{name}: there are no results of {method}")

    def taken(method: str, steps: Steps) -> StepsSeen:
        for row in compare(results):
            if (row.recording, row.estimator, row.steps) == (mouths[0].name, method, steps) and row.data_error:
                time = NAN if row.solve_time is None else row.solve_time.mean
                return StepsSeen(row.data_error.mean, row.data_error.sd or NAN, time)
        return StepsSeen(NAN, NAN, NAN)

    return estimated, taken


def _left_by_solver(
    mouths: tuple[Recording, Recording],
) -> tuple[Callable[[str, int], Array], Callable[[str, Steps], StepsSeen]]:
    """What the paper's solver leaves; times are evaluations, at what one of them took the paper."""

    @cache
    def left(method: str, number: int) -> LeftBySolver:
        recording = mouths[number]
        frames, solve = recording.recorded[recording.measured_frames()], published_code("as_published").left_by_solver
        found: LeftBySolver = solve(method, recording.scene.panel, unloaded(recording), frames, WEIGHTS)
        return found

    def taken(method: str, steps: Steps) -> StepsSeen:
        found = left(method, 0)
        parts = {"initial": slice(1), "following": slice(1, None)} if found.joint else {"all": slice(None)}
        if steps not in parts:
            return StepsSeen(NAN, NAN, NAN)
        error = spread(found.data_error[parts[steps]])
        time = EVALUATION_S * float(found.evaluations[parts[steps]].mean())
        return StepsSeen(NAN, NAN, time) if error is None else StepsSeen(error.mean, error.sd or NAN, time)

    return lambda method, number: left(method, number).change, taken


def _made(config: Path, folder: Path) -> Path:
    """The recording of a simulation's file; made once."""
    file = folder / f"{config.stem}.h5"
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        simulated(config, file)
    return file


def _solved(config: Path, assigned: tuple[str, ...], folder: Path, jobs: int | None, on_case: OnCase) -> Results:
    run = read_run(config, (FASTEST, *assigned))
    report = run_batch(run, folder, local(jobs, len(run.cases)), on_case=on_case)
    if report.results is None or report.failed:
        raise InputError(f"{config}: {'; '.join(f'{case}: {why}' for case, why in report.failed)}")
    return read_results(report.results)


def unloaded(recording: Recording) -> Array:
    """The mean of the unloaded frames as recorded, (rows, columns) ohm."""
    return np.asarray(recording.recorded[recording.role == UNLOADED].mean(axis=0))


def furthest_frame(recording: Recording) -> int:
    """Of the measured frames the one whose cells have moved furthest."""
    readings = Readings.of(recording.scene, recording.recorded, recording.sigma)
    resting = readings[recording.role == UNLOADED].mean().value
    return furthest(readings.value[recording.measured_frames()], resting)
