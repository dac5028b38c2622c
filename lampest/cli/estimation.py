"""Commands that write starter files and recordings, and estimate cells."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lampest.cli.screen import (
    SOME_FAILED,
    Assign,
    AssignToScene,
    as_options,
    check_positive,
    option,
    print_notes,
    progress,
    say,
    say_text,
    scene_of,
    warn,
    written,
)
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lampest.panel.panel import Panel
    from lampest.runs.config import Case


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder, created if missing; existing files are kept.")
    ] = Path(),
    readout: Annotated[
        str, option("Your circuit: two_mux, pull_ups, grounded or amplifiers.", metavar="CIRCUIT")
    ] = "two_mux",
    rows: Annotated[int, option("Rows of your panel, such as 16.", min=1)] = 10,
    columns: Annotated[int, option("Columns of your panel, such as 16.", min=1)] = 10,
    purpose: Annotated[str | None, option("mat: contacts alone. Default: mouths and cups, too.")] = None,
) -> None:
    """Write starter files for your circuit: a scene, a run, a simulated recording and its simulation."""
    from lampest.runs.starter import RECORDING, RUN, SCENE, circuit_called, write_starter

    circuit = circuit_called(readout)
    for path in write_starter(folder, readout, rows, columns, purpose):
        say(path)
    run, scene = folder / RUN, folder / SCENE
    say_text(f"\nthe wiring that {scene} describes ({circuit.kind}); another one: lampest init --readout CIRCUIT")
    say_text(circuit.sketch)
    say(f"software: {circuit.software}")
    say_text(
        f"\nnow: lampest run {run}                    ({RECORDING}, simulated for this circuit)"
        f"\n     lampest plot results/{run.stem}/results.h5 --show change"
        f"\nthen, with the numbers of your circuit in {scene}:"
        f"\n     lampest import YOURS.csv --scene {scene} --baseline 3 --out mine.h5, and mine.h5 in {run}"
    )


def run(
    config: Annotated[Path, typer.Argument(help="The run's YAML file.")],
    out: Annotated[Path | None, written("--out", "Results folder. Default: results/<config>.")] = None,
    assign: Assign = None,
    jobs: Annotated[
        int | None, option("Processes, such as 2. Default: the file's executor, or all cores.", min=1)
    ] = None,
    fresh: Annotated[bool, option("Solve finished cases again.", "--fresh")] = False,
    yes: Annotated[
        bool, option("Also solve panels whose first frame takes minutes or more memory than there is.", "--yes")
    ] = False,
) -> None:
    """Reconstruct recordings with every estimator of a run file; finished cases are skipped."""
    from lampest.report.words import counted
    from lampest.runs.batch import run_batch
    from lampest.runs.config import read_run
    from lampest.runs.executors import local

    cases = read_run(config, tuple(assign or ()))
    if not yes:
        refuse_large(cases.cases)
    limited = any(case.estimator.solver.time_limit_s is not None for case in cases.cases)
    for name, text in cases.assumed:
        warn(f"{name}: {text} assumed; the scene does not say")
    executor = cases.executor if cases.executor and not jobs else local(jobs, len(cases.cases), separate=limited)
    with progress("frames", counted=True) as on_frames:
        report = run_batch(cases, out or Path("results") / config.stem, executor, fresh=fresh, on_frames=on_frames)
    counts = f"{counted(report.done, 'case')} solved, {report.skipped} were done before, {len(report.failed)} failed"
    say(f"{counts}: {report.results or 'no results'}")
    if report.aside:
        warn(f"existing results of other cases were renamed: {report.aside}")
    print_notes(f"warning: {line}" for line in report.warnings)
    for name, sentence in report.failed:
        warn(f"{name} failed: {sentence}")
    if report.lost:
        left = f"{counted(report.not_run, 'case')} were not run: {report.lost}; repeat the command to run them"
        warn(left)
    if report.failed or report.not_run:
        raise typer.Exit(SOME_FAILED)


def refuse_large(cases: "Sequence[Case]") -> None:
    """Raise InputError where a case's first frame takes more than two minutes, or more memory than there is."""
    from lampest.files.process import in_bytes, memory_limit
    from lampest.recording.recording import recording_file

    panels: dict[Path, Panel | None] = {}
    for path in {case.path for case in cases}:
        # An unreadable recording fails later, as a case of its own.
        with suppress(InputError), recording_file(path) as (_, scene, _, _):
            panels[path] = scene.panel
    for case in cases:
        panel = panels.get(case.path)
        seconds, size = case.estimator.effort(panel) if panel else (0.0, 0.0)
        if seconds > 120 or size > memory_limit():
            raise InputError(
                f"{case.path}: {case.name} takes about {seconds / 60:.0f} min and {in_bytes(size)} of memory for the "
                "first frame; --yes solves it, and a formulation such as linearised takes less"
            )


def simulate(
    config: Annotated[Path, typer.Argument(help="The simulation's YAML file.")],
    out: Annotated[Path | None, written("--out", "The recording, or a folder where the file sweeps.")] = None,
    assign: Assign = None,
) -> None:
    """Simulate recordings with known truth from a scene."""
    from lampest.recording.simulation import run as run_simulation

    with progress("frames", counted=True) as on_frame:
        written_files = run_simulation(config, out, on_frame, tuple(assign or ()))
    for path in written_files:
        say(path)


def import_(
    file: Annotated[Path, typer.Argument(help="CSV or other text, .xlsx, .npy, .npz or .mat.")],
    out: Annotated[Path, written("--out", "New recording file.")],
    rows: Annotated[int | None, option("Rows of the panel, such as 10. Default: the scene's.", min=1)] = None,
    columns: Annotated[int | None, option("Columns of the panel, such as 10. Default: the scene's.", min=1)] = None,
    scene: Annotated[Path | None, option("The scene's YAML file; lampest init writes one.")] = None,
    assign: AssignToScene = None,
    unit: Annotated[str | None, option("ohm, kohm, volt, mV or code. Default: by header or values.")] = None,
    period: Annotated[float | None, option("Seconds between frames, such as 0.1. Default: the file's times.")] = None,
    time_unit: Annotated[
        Literal["s", "ms", "us"] | None, option("Unit of the file's times. Default: by header or values.")
    ] = None,
    missing: Annotated[str, option("Missing readings: mark (NaN), skip-frame or refuse.")] = "mark",
    baseline: Annotated[int, option("Number of unloaded frames at the beginning, such as 3.", min=0)] = 0,
    transpose: Annotated[bool, option("Rows and columns of the file are swapped.", "--transpose")] = False,
    variable: Annotated[str | None, option("The variable of a .mat or .npz file, the sheet of an .xlsx file.")] = None,
    layout: Annotated[
        str | None, option("A table's columns, such as time,row,column,value, or an installed layout.")
    ] = None,
) -> None:
    """Convert measurements of another program to a recording, and report how they were interpreted."""
    from lampest.recording.foreign.importing import import_file
    from lampest.report.info import understood_lines

    check_positive("--period", period)
    agreed = scene_of(scene, assign)
    with progress("reading"):
        recording, notes = import_file(
            file,
            rows,
            columns,
            agreed,
            unit,
            baseline,
            transpose=transpose,
            variable=variable,
            period=period,
            missing=missing,
            layout=layout,
            time_unit=time_unit,
        )
        recording.save(out)
    for line in understood_lines(recording, notes):
        say(as_options(line))
    say(out)


def tare(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    frames: Annotated[str, option("Range of unloaded frames: 40:50 is 40 to 49.")],
    out: Annotated[Path, written("--out", "New recording file.")],
) -> None:
    """Choose new baseline frames; all other frames become measured ones, and no reading changes."""
    from lampest.recording.recording import MIN_CHANGE, Recording, frames_named, tared

    recording = Recording.load(file)
    named = frames_named(frames, len(recording.role))
    made, change = tared(recording, named)
    made.save(out)
    say(f"unloaded: frames {named[0]} to {named[-1]}: {out}")
    if change > MIN_CHANGE:
        warn(f"readings change by up to {100 * change:.1f} % within these frames; did a load come or go?")
