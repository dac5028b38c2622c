"""The sides that are drawn, from shipped files: which recordings, and how they are solved."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from lampest.files.errors import InputError
from lampest.recording.recording import Recording
from lampest.recording.simulation.files import run as simulated
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import Results, read_results
from lampest.studies.paper.published import Published
from lampest.studies.paper.side import LeftBySolver, LoadSeen, OptimalSide, Side, SolverSide, Weights, unloaded
from lampest.studies.study import published_code

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
WEIGHTS = Weights(relative=1e-3, start=1.66)


def all_sides(
    shipped: Path, folder: Path, published: Published, jobs: int | None, on_case: Callable[[int, int], None]
) -> tuple[Side, ...]:
    """Simulate, solve and read; what was solved in the folder before is taken from it.

    shipped : holds `configs/` and `data/`. Raises InputError where a file is missing, a case fails, or the folder
    cannot be written.
    """
    configs, data = shipped / "configs", shipped / "data"
    files = {load.letter: data / f"{load.recording}.h5" for load in published.loads.maps}
    loads = {letter: LoadSeen.of(Recording.load(file)) for letter, file in files.items()}
    mouths = _both(data / "lamprey_35mm.h5", data / "lamprey_25mm.h5")
    results = _solved(configs / "table1.yaml", (), folder / "clean", jobs, on_case)
    clean = OptimalSide("clean scenes", "clean", CLEAN, mouths, loads, False, results)
    return (clean, *_of_panel(configs, folder, published, jobs, on_case))


def _of_panel(
    configs: Path, folder: Path, published: Published, jobs: int | None, on_case: Callable[[int, int], None]
) -> tuple[Side, Side]:
    """The paper's panel twice: optima, and what the paper's solver leaves."""
    made = folder / "recordings"
    names = ("paper_35mm", "paper_25mm")
    files = [_made(configs / f"{name}.yaml", made) for name in names]
    mouths = _both(*files)
    loads: Mapping[str, LoadSeen] = {
        load.letter: LoadSeen.of(Recording.load(_made(configs / f"real_{load.recording}.yaml", made)))
        for load in published.loads.maps
    }
    told = (f"recordings=[{', '.join(repr(str(file.resolve())) for file in files)}]",)
    results = _solved(configs / "paper_run.yaml", told, folder / "panel", jobs, on_case)
    optima = OptimalSide("paper's panel", "panel", PANEL, mouths, loads, True, results)
    solve: Callable[[str, Recording], LeftBySolver] = partial(_left, WEIGHTS)
    methods, method = tuple(published_code("as_published").METHODS), published.mouths.method
    return optima, SolverSide("its solver", "solver", SOLVER, mouths, loads, True, solve, methods, method)


def _made(config: Path, folder: Path) -> Path:
    """The recording of a simulation's file; made once."""
    file = folder / f"{config.stem}.h5"
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        simulated(config, file)
    return file


def _both(large: Path, small: Path) -> tuple[Recording, Recording]:
    return Recording.load(large), Recording.load(small)


def _solved(
    config: Path, told: tuple[str, ...], folder: Path, jobs: int | None, on_case: Callable[[int, int], None]
) -> Results:
    run = read_run(config, (FASTEST, *told))
    report = run_batch(run, folder, local(jobs, len(run.cases)), on_case=on_case)
    if report.results is None or report.failed:
        raise InputError(f"{config}: {'; '.join(f'{case}: {why}' for case, why in report.failed)}")
    return read_results(report.results)


def _left(weights: Weights, method: str, recording: Recording) -> LeftBySolver:
    frames = recording.recorded[recording.measured_frames()]
    panel, resting = recording.scene.panel, unloaded(recording)
    left: LeftBySolver = published_code("as_published").left_by_solver(method, panel, resting, frames, weights)
    return left
