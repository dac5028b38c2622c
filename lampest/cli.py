"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.errors import InputError
from lampest.executors import ONE_THREAD

if TYPE_CHECKING:
    from lampest.acquire.record import Progress, Recorded
    from lampest.compare import Table

WRONG_INPUT, SOME_FAILED, INTERRUPTED = 2, 3, 130

app = typer.Typer(
    help="Cell resistances of passive resistive matrix sensors from two-point measurements.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
Out = Annotated[Path | None, typer.Option("--out", help="Where the output goes.")]
Port = Annotated[str | None, typer.Option("--port", help="Port or URL; else the one that looks like an Arduino.")]
SceneFile = Annotated[Path | None, typer.Option("--scene", help="YAML file of the scene; else what the board says.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, help="End after so many frames.")]
Period = Annotated[float | None, typer.Option("--period", help="Seconds between frames; 1 if the board can.")]


@app.command()
def run(
    config: Annotated[Path, typer.Argument(help="The run's YAML file.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results; results/<config> by default.")
    ] = None,
    assign: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE, overrides one entry.")] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Processes here; else the file's executor, or all cores.")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Solve again what is done.")] = False,
) -> None:
    """Reconstruct recordings with every estimator of a run's file; cases that are done are skipped."""
    from lampest.batch import run_batch
    from lampest.config import read_run
    from lampest.executors import local

    cases = read_run(config, tuple(assign or ()))
    executor = cases.executor if cases.executor and not jobs else local(jobs, len(cases.cases))
    with progress("cases") as on_case:
        report = run_batch(cases, out or Path("results") / config.stem, executor, fresh, on_case)
    print(
        f"{report.done} cases solved, {report.skipped} were done before, {len(report.failed)} failed: {report.results}"
    )
    for name, sentence in report.failed:
        print(f"lampest: {name} failed: {sentence}", file=sys.stderr)
    if report.failed:
        raise typer.Exit(SOME_FAILED)


@app.command()
def starts(
    config: Annotated[Path, typer.Argument(help="The run's YAML file.")],
    random: Annotated[int, typer.Option("--random", min=1, help="Random starts for every frame.")] = 20,
    seed: Annotated[int, typer.Option("--seed")] = 0,
) -> None:
    """Say how often every case of a run reaches the best objective known from random starts."""
    from lampest.compare import Table
    from lampest.config import read_run
    from lampest.starts import tally

    cases = read_run(config).cases
    rows = []
    with progress("cases") as on_case:
        for number, case in enumerate(cases, 1):
            found = tally(case, random, seed)
            share = f"{found.best}/{found.frames}"
            excess = f"{100 * found.worst_excess:.2g}"
            ended = f"{found.random_solved}/{found.random}"
            rows.append((found.recording, found.estimator, share, excess, str(found.most_minima), ended))
            on_case(number, len(cases))
    headers = ("recording", "estimator", "frames at the best", "worst excess [%]", "most minima", "random solved")
    print_table(Table(headers, tuple(rows)))


@app.command()
def simulate(
    config: Annotated[Path, typer.Argument(help="The simulation's YAML file.")],
    out: Annotated[Path | None, typer.Option("--out", help="The recording, or a folder where the file sweeps.")] = None,
) -> None:
    """Make recordings with their truth from a scene."""
    from lampest.simulate import run as run_simulation

    for path in run_simulation(config, out):
        print(path)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="CSV, .npy or .mat.")],
    rows: Annotated[int, typer.Option("--rows", min=1)],
    columns: Annotated[int, typer.Option("--columns", min=1)],
    out: Annotated[Path, typer.Option("--out", help="The recording that is written.")],
    scene: Annotated[Path | None, typer.Option("--scene", help="YAML file of the scene.")] = None,
    unit: Annotated[str, typer.Option("--unit", help="ohm, volt or code.")] = "ohm",
    baseline: Annotated[int, typer.Option("--baseline", min=0, help="The first so many frames are unloaded.")] = 0,
    transpose: Annotated[bool, typer.Option("--transpose", help="Rows and columns of the file are swapped.")] = False,
    variable: Annotated[str | None, typer.Option("--variable", help="The variable of a .mat file.")] = None,
) -> None:
    """Turn a table of two-point measurements into a recording."""
    from lampest.importing import import_file, read_scene

    recording, notes = import_file(
        file, rows, columns, read_scene(scene) if scene else None, unit, baseline, transpose, variable
    )
    recording.save(out)
    for note in notes:
        print(note)
    print(out)


@app.command()
def compare(
    results: Annotated[list[Path], typer.Argument(help="Results files.")],
    csv: Annotated[Path | None, typer.Option("--csv", help="Write the table to this file too.")] = None,
) -> None:
    """Table over methods and recordings: times, data errors, cell errors, published figures."""
    from lampest.compare import compare_files, screen_table, write_csv

    rows = compare_files(results)
    if csv:
        write_csv(csv, rows)
    print_table(screen_table(rows))


@app.command()
def plot(results: Annotated[Path, typer.Argument(help="A results file.")], out: Out = None) -> None:
    """Mapping contours of every recording, side by side."""
    from lampest.plot import plot_results

    for path in plot_results(results, out):
        print(path)


@app.command()
def terms() -> None:
    """List the cost terms with their formulas, units and options."""
    import dataclasses

    from lampest.compare import Table
    from lampest.terms import term_types

    rows = []
    for kind, term in term_types().items():
        options = ", ".join(
            f"{field.name}: {getattr(field.default, 'kind', field.default)}"
            for field in dataclasses.fields(term)
            if field.name != "kind"
        )
        rows.append((kind, " ".join((term.__doc__ or "").split("\n\n")[0].split()), term.unit, options))
    print_table(Table(("term", "residual", "unit", "options and defaults"), tuple(rows)))


@app.command()
def schema() -> None:
    """Print the JSON schema of a run's file."""
    import json

    from lampest.config import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def info(file: Annotated[Path, typer.Argument(help="A recording or a results file.")]) -> None:
    """Say what a file holds and draw the first frame as a small map."""
    from lampest.info import describe

    for line in describe(file):
        print(line)


@app.command()
def ports() -> None:
    """List the serial ports, those that look like an Arduino first."""
    from lampest.acquire.port import ports as all_ports

    found = all_ports()
    for port in found:
        print(f"{port.url}  {port.description}{'  (looks like an Arduino)' if port.likely else ''}")
    if not found:
        print("there is no serial port", file=sys.stderr)


@app.command()
def record(
    out: Annotated[Path, typer.Option("--out", help="The recording that is written; must not exist.")],
    port: Port = None,
    frames: Frames = None,
    seconds: Annotated[float | None, typer.Option("--seconds", help="End after so many seconds of frames.")] = None,
    scene: SceneFile = None,
    baseline: Annotated[int, typer.Option("--baseline", min=0, help="The first so many frames are unloaded.")] = 0,
    period: Period = None,
) -> None:
    """Record a board until the frames have come, the time is over, or Ctrl-C; a key that is pressed marks an event."""
    from lampest.acquire.keys import pressed_keys
    from lampest.acquire.record import record as record_board
    from lampest.importing import read_scene

    if frames is not None and seconds is not None:
        raise InputError("--frames and --seconds: give one of them")
    check_positive("--seconds", seconds)
    check_positive("--period", period)
    agreed = read_scene(scene) if scene else None
    with pressed_keys() as keys, recording_line() as on_progress:
        done = record_board(
            port,
            out,
            frames=frames,
            seconds=seconds,
            scene=agreed,
            baseline=baseline,
            period=period,
            on_progress=on_progress,
            keys=keys,
        )
    report_recorded(done)


@app.command()
def repair(file: Annotated[Path, typer.Argument(help="A recording that was not closed.")]) -> None:
    """Turn what a crash left into a clean recording; one that is clean stays as it is."""
    from lampest.acquire.record import repair as repair_recording

    print(f"{repair_recording(file)} frames: {file}")


@app.command()
def calibrate(
    file: Annotated[Path, typer.Argument(help="A recording of shorted lines or known resistors.")],
    known: Annotated[
        str, typer.Option("--known", help="Resistors in place of the cells: ohm, or a .csv or .npy table of them.")
    ] = "0",
    out: Annotated[Path | None, typer.Option("--out", help="The scene that is written; else it is printed.")] = None,
) -> None:
    """Find the resistance in series with every reading and write it into a scene, with its uncertainty."""
    from lampest.acquire.calibrate import calibrate as calibrate_recording
    from lampest.acquire.calibrate import calibrated_scene_text
    from lampest.acquire.known import known_resistors
    from lampest.files import write_text
    from lampest.recording import Recording

    recording = Recording.load(file)
    found = calibrate_recording(recording, known_resistors(known, recording.scene.panel))
    text = calibrated_scene_text(recording.scene, found)
    if out is None:
        print(text, end="")
        return
    write_text(out, text)
    print(f"series resistance {found.series_ohm:.3f} ± {found.sigma_ohm:.3f} ohm from {found.cells} cells: {out}")
    if found.lines_differ:
        print("lampest: the lines differ by more than their noise; the scene's comments say how much", file=sys.stderr)


@app.command()
def live(
    port: Port = None,
    recording: Annotated[Path | None, typer.Option("--recording", help="A recording to replay instead.")] = None,
    estimator: Annotated[
        str | None, typer.Option("--estimator", help="LSR-gCR by default; with --config its first.")
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", help="A run's YAML file with estimators.")] = None,
    speed: Annotated[float, typer.Option("--speed", help="So many times as fast as the recording.")] = 1.0,
    http: Annotated[
        str, typer.Option("--http", help="HOST:PORT of the page; only this computer sees 127.0.0.1.")
    ] = "127.0.0.1:8137",
    frames: Frames = None,
    baseline: Annotated[
        int, typer.Option("--baseline", min=1, help="The first so many are unloaded, unless a recording says which.")
    ] = 3,
    scene: SceneFile = None,
    period: Period = None,
    out: Annotated[Path | None, typer.Option("--out", help="Record the board into this file as well.")] = None,
) -> None:
    """Reconstruct each frame as it comes and show it in the browser."""
    import signal

    from lampest.importing import read_scene
    from lampest.live.run import Board, Replay
    from lampest.live.run import live as run_live

    check_positive("--speed", speed)
    check_positive("--period", period)
    if recording is not None and (port or scene or period or out):
        raise InputError("--recording: --port, --scene, --period and --out are for a board")
    if recording is None:
        source: Board | Replay = Board(port, read_scene(scene) if scene else None, baseline, period, out)
    else:
        source = Replay(recording, speed, baseline)
    # A board is told to stop, however live ends.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        done = run_live(source, estimator, config, http, frames, lambda url: print(f"{url}  (Ctrl-C ends)", flush=True))
    finally:
        signal.signal(signal.SIGTERM, before)
    if done is not None:
        report_recorded(done)


@app.command()
def bench(
    config: Annotated[Path, typer.Argument(help="The benchmark's YAML file.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the output; results/<config> by default.")
    ] = None,
) -> None:
    """Compare the speed of reduced, nodal and scipy's solvers over panel sizes, with the accuracy that each reaches."""
    from lampest.bench.report import remarks, summary_table, write_bench
    from lampest.bench.run import run_bench
    from lampest.bench.settings import read_bench

    settings = read_bench(config)
    with progress("methods") as on_step:
        found = run_bench(settings, on_step)
    files = write_bench(out or Path("results") / config.stem, found)
    print_table(summary_table(found))
    for line in (*remarks(found), *files):
        print(line)


@app.command()
def tradeoff(
    config: Annotated[Path, typer.Argument(help="The trade-off's YAML file.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the output; results/<config> by default.")
    ] = None,
) -> None:
    """Measure what every rung of the ladder of efforts costs in time and in accuracy; table, HDF5 and figure."""
    from lampest.plot.tradeoff import plot_tradeoff
    from lampest.tradeoff.report import summary_table, write_tradeoff
    from lampest.tradeoff.run import run_tradeoff
    from lampest.tradeoff.settings import read_plan

    plan = read_plan(config)
    with progress("measurements") as on_step:
        found = run_tradeoff(plan, on_step)
    folder = out or Path("results") / config.stem
    files = (*write_tradeoff(folder, found), plot_tradeoff(found, folder / "tradeoff.png"))
    print_table(summary_table(found))
    for file in files:
        print(file)


@app.command()
def extremes(
    config: Annotated[Path, typer.Argument(help="The atlas' YAML file.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the output; results/<config> by default.")
    ] = None,
) -> None:
    """Solve scenes at the edge of what can be measured and tell how each ended; table, HDF5 and heat map."""
    from lampest.extremes.report import remarks, summary_table, write_atlas
    from lampest.extremes.run import run_atlas
    from lampest.extremes.settings import read_atlas
    from lampest.plot.extremes import plot_extremes

    atlas = read_atlas(config)
    with progress("scenes") as on_step:
        found = run_atlas(atlas, on_step)
    folder = out or Path("results") / config.stem
    files = (*write_atlas(folder, found), plot_extremes(found, folder / "extremes.png"))
    print_table(summary_table(found))
    for line in (*remarks(found), *files):
        print(line)


def check_positive(name: str, value: float | None) -> None:
    """Raise InputError unless a number that was given is positive and finite."""
    if value is not None and not 0 < value < float("inf"):
        raise InputError(f"{name} must be positive and finite")


def report_recorded(done: "Recorded") -> None:
    """Say what was recorded; a recording that was interrupted ends with 130."""
    noise = "" if done.noise_lsb is None else f", noise of one reading {done.noise_lsb:.2f} LSB"
    print(f"{done.frames} frames, {done.lost} lost, {done.restarts} restarts of the board{noise}: {done.path}")
    if done.interrupted:
        raise typer.Exit(INTERRUPTED)


@contextmanager
def recording_line() -> Iterator[Callable[["Progress"], None]]:
    """One line on stderr that says where a recording stands, silent where that is no terminal."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return
    from rich.console import Console

    with Console(stderr=True).status("waiting for the board") as line:

        def update(progress: "Progress") -> None:
            at = "" if progress.sample is None else f" at {progress.sample.time:.1f} s"
            line.update(f"{progress.frames} frames{at}, {progress.lost} lost{progress.state and '; ' + progress.state}")

        yield update


def print_table(table: "Table") -> None:
    """Draw a table; as wide as the terminal, or as it needs where the output is no terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as RichTable

    drawn = RichTable(*table.headers, box=box.SIMPLE)
    for cells in table.cells:
        drawn.add_row(*cells)
    Console(width=None if sys.stdout.isatty() else 200, highlight=False, markup=False).print(drawn)


class progress:  # noqa: N801
    """A progress bar on stderr, silent where that is no terminal."""

    def __init__(self, what: str) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True), disable=not sys.stderr.isatty())
        self._task = self._bar.add_task(what, total=None)

    def __enter__(self) -> Any:
        self._bar.__enter__()
        return lambda done, total: self._bar.update(self._task, completed=done, total=total)

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)


def main() -> None:
    """Run the command; input errors end with code 2 and one sentence, Ctrl-C with 130."""
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    try:
        app()
    except InputError as error:
        print(f"lampest: {error}", file=sys.stderr)
        sys.exit(WRONG_INPUT)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            print("lampest: interrupted; what was finished is kept", file=sys.stderr)
        raise
