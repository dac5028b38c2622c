"""What the paper publishes as numbers, and what stands beside: shipped scenes, and what five methods make of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from math import nan
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import numpy as np

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
FASTEST = "formulation=reduced"  # finds the optima that a file's formulation finds, sooner
OnCase = Callable[[int, int], None]
FILE = "published.yaml"
MOUTHS = ("35mm", "25mm")


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


@dataclass(frozen=True, eq=False)
class LoadSeen:
    """What was measured of one load: relative change in percent, (rows, columns); felt : (lowest, highest) kPa."""

    change: Array
    felt: tuple[float, float]

    @classmethod
    def of(cls, recording: Recording) -> "LoadSeen":
        """The frame in which cells have moved furthest; of a simulated recording."""
        frame = int(recording.measured_frames()[furthest_frame(recording)])
        assert recording.truth_pressure is not None
        felt = recording.truth_pressure[frame]
        change = percent_change(recording.recorded[frame], unloaded(recording))
        return cls(change, (float(felt.min()), float(felt.max())))


class StepsSeen(NamedTuple):
    """Of some steps: mean and standard deviation of the data error in percent, mean time in s; NaN: none."""

    error: float = nan
    error_sd: float = nan
    time: float = nan


@dataclass(frozen=True, eq=False)
class Side:
    """One set of scenes that stands beside the paper.

    name, word : for the page, for files. mouths : the large and the small one. loads : letter of figure 6 → what was
    seen. first : whether the first frame is shown, else the strongest one.
    estimated : (method, number of the mouth) → relative change in percent, (frames, rows, columns).
    steps : (method, steps) → what they took with the large mouth.
    """

    name: str
    word: str
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
    configs, data = shipped / "configs", shipped / "data"

    def made(name: str) -> Path:
        """The recording of a simulation's file; made once."""
        file = folder / "recordings" / f"{name}.h5"
        if not file.is_file():
            file.parent.mkdir(parents=True, exist_ok=True)
            simulated(configs / f"{name}.yaml", file)
        return file

    def side(name: str, word: str, files: Sequence[Path], loads: dict[str, LoadSeen], run: str, *assigned: str) -> Side:
        mouths = Recording.load(files[0]), Recording.load(files[1])
        results = _solved(configs / run, assigned, folder / word, jobs, on_case)
        return Side(name, word, mouths, loads, word != "clean", *_optima(name, results, mouths))

    letters = {load.letter: load.recording for load in published.loads}
    loads = {letter: LoadSeen.of(Recording.load(data / f"{name}.h5")) for letter, name in letters.items()}
    clean = side("clean scenes", "clean", [data / f"lamprey_{size}.h5" for size in MOUTHS], loads, "table1.yaml")
    files = [made(f"paper_{size}") for size in MOUTHS]
    loads = {letter: LoadSeen.of(Recording.load(made(f"real_{name}"))) for letter, name in letters.items()}
    recordings = f"recordings=[{', '.join(repr(str(file.resolve())) for file in files)}]"
    panel = side("paper's panel", "panel", files, loads, "paper_run.yaml", recordings)
    estimated, steps = _left_by_solver(panel.mouths)
    return clean, panel, replace(panel, name="its solver", word="solver", estimated=estimated, steps=steps)


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
                time = nan if row.solve_time is None else row.solve_time.mean
                return StepsSeen(row.data_error.mean, row.data_error.sd or nan, time)
        return StepsSeen()

    return estimated, taken


def _left_by_solver(
    mouths: tuple[Recording, Recording],
) -> tuple[Callable[[str, int], Array], Callable[[str, Steps], StepsSeen]]:
    """What the paper's solver leaves; times are evaluations, at what one of them took the paper."""

    @cache
    def left(method: str, number: int) -> Any:
        recording = mouths[number]
        frames, solve = recording.recorded[recording.measured_frames()], published_code("as_published").left_by_solver
        return solve(method, recording.scene.panel, unloaded(recording), frames)

    def taken(method: str, steps: Steps) -> StepsSeen:
        found = left(method, 0)
        parts = {"initial": slice(1), "following": slice(1, None)} if found.joint else {"all": slice(None)}
        if steps not in parts:
            return StepsSeen()
        error = spread(found.data_error[parts[steps]])
        # Table I: LSM's 16.45 ± 0.40 s are its limit of 10,000 evaluations and one derivative.
        time = 16.45 / 10_100 * float(found.evaluations[parts[steps]].mean())
        return StepsSeen(time=time) if error is None else StepsSeen(error.mean, error.sd or nan, time)

    return lambda method, number: left(method, number).change, taken


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
