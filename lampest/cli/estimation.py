"""Commands that write starter files and recordings, and estimate cells."""

from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli import screen
from lampest.files.errors import InputError, counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lampest.runs.batch import Report
    from lampest.runs.config import Case


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR")] = Path(),
    readout: Annotated[str, screen.option(metavar="CIRCUIT")] = "two_mux",
    rows: screen.Count = 10,
    columns: screen.Count = 10,
    purpose: str | None = None,
) -> None:
    """Write starter files for your circuit.

    The files are a scene, a run, a simulated recording and its simulation.

    Parameters
    ----------
    folder
        Folder, created if missing; existing files are kept.
    readout
        Your circuit, a word of the list below.
    rows
        Rows of your panel, such as 16.
    columns
        Columns of your panel, such as 16.
    purpose
        mat: contacts alone. Default: mouths and cups, too.
    """
    from lampest.runs.starter import RECORDING, RUN, SCENE, circuit_called, write_starter

    circuit = circuit_called(readout)
    for path in write_starter(folder, readout, rows, columns, purpose):
        screen.say(path)
    run = folder / RUN
    scene = folder / SCENE
    screen.say_text(
        f"\nthe wiring that {scene} describes ({circuit.kind}); "
        "another one: lampest init --readout CIRCUIT"
    )
    screen.say_text(circuit.sketch)
    screen.say(f"software: {circuit.software}")
    screen.say_text(
        f"\nnow: lampest run {run}                    ({RECORDING}, simulated for this circuit)"
        f"\n     lampest plot results/{run.stem}/results.h5 --show change"
        f"\nthen, with the numbers of your circuit in {scene}:"
        f"\n     lampest import YOURS.csv --scene {scene} --baseline 3 --out mine.h5, "
        f"and mine.h5 in {run}"
    )


def run(
    config: Path,
    out: screen.Output = None,
    assign: screen.Assign = None,
    jobs: Annotated[int | None, screen.option(min=1)] = None,
    fresh: bool = False,
    yes: bool = False,
    no_check: bool = False,
) -> None:
    """Reconstruct recordings with every estimator of a run file; finished cases are skipped.

    Parameters
    ----------
    config
        The run's YAML file.
    out
        Results folder. Default: results/<config>.
    jobs
        Processes, such as 2. Default: the file's executor, or all cores.
    fresh
        Solve finished cases again.
    yes
        Also solve panels whose first frame takes minutes or more memory than there is.
    no_check
        Leave out whether the circuits explain their readings.
    """
    from lampest.runs.batch import run_batch
    from lampest.runs.config import read_run
    from lampest.runs.executors import local

    cases = read_run(config, tuple(assign or ()))
    if no_check:
        cases = replace(cases, check="none")
    if not yes:
        refuse_large(cases.cases)
    for name, text in cases.assumed:
        screen.warn(f"{name}: {text} assumed; the scene does not say")
    executor = cases.executor
    if jobs or executor is None:
        limited = any(case.estimator.solver.time_limit_s is not None for case in cases.cases)
        tasks = sum(case.segments for case in cases.cases) if jobs else cases.tasks
        executor = local(jobs, tasks, separate=limited)
    with screen.progress("frames", counted=True) as on_frames:
        report = run_batch(
            cases,
            out or Path("results") / config.stem,
            executor,
            fresh=fresh,
            on_frames=on_frames,
            on_checks=partial(on_frames, step="checks"),
        )
    _print_report(report)
    if report.failed or report.not_run:
        raise typer.Exit(screen.SOME_FAILED)


def _print_report(report: "Report") -> None:
    """Print the counts of a run, and what it has found, assumed and failed at."""
    from lampest.audit.finding import sentences_and_entries

    screen.say(
        f"{counted(report.done, 'case')} solved, {report.skipped} were done before, "
        f"{len(report.failed)} failed: {report.results or 'no results'}"
    )
    if report.aside:
        screen.warn(f"existing results of other cases were renamed: {report.aside}")
    screen.print_notes(f"estimated: {line}" for line in report.estimated)
    screen.print_notes(f"warning: {line}" for line in report.warnings)
    for recording, advice in report.advice:
        sentences, entries = sentences_and_entries(advice)
        screen.print_notes(f"advice: {recording}: {sentence}" for sentence in sentences)
        for entry in entries:
            screen.say(entry)
    for name, sentence in report.failed:
        screen.warn(f"{name} failed: {sentence}")
    if report.lost:
        screen.warn(
            f"{counted(report.not_run, 'case')} were not run: {report.lost}; "
            "repeat the command to run them"
        )


def refuse_large(cases: "Sequence[Case]") -> None:
    """Raise InputError where a case's first frame takes more than two minutes.

    Raise it also where the frame takes more memory than there is.
    """
    from lampest.files.process import in_bytes, memory_limit
    from lampest.recording.file import recording_file

    panels = {}
    for path in {case.path for case in cases}:
        # An unreadable recording fails later, as a case of its own.
        with suppress(InputError), recording_file(path) as (_, scene, _):
            panels[path] = scene.panel
    for case in cases:
        if case.path not in panels:
            continue
        seconds, size = case.estimator.effort(panels[case.path])
        if seconds > 120 or size > memory_limit():
            raise InputError(
                f"{case.path}: {case.name} takes about {seconds / 60:.0f} min "
                f"and {in_bytes(size)} of memory for the first frame; "
                "--yes solves it, and a formulation such as linearised takes less"
            )


def simulate(config: Path, out: screen.Output = None, assign: screen.Assign = None) -> None:
    """Simulate recordings with known truth from a scene.

    Parameters
    ----------
    config
        The simulation's YAML file.
    out
        The recording, or a folder where the file sweeps.
    """
    from lampest.recording.simulation import run as run_simulation

    replaced = out is not None and out.is_file()
    with screen.progress("frames", counted=True) as on_frame:
        paths = run_simulation(config, out, on_frame, tuple(assign or ()))
    for path in paths:
        screen.say(screen.written(path, replaced=replaced))


def tare(file: Path, frames: Annotated[str, screen.option()], out: screen.NewFile) -> None:
    """Choose new baseline frames; all other frames become measured ones, and no reading changes.

    Parameters
    ----------
    file
        A recording.
    frames
        Range of unloaded frames: 40:50 is 40 to 49.
    out
        New recording file.
    """
    from lampest.recording.recording import MIN_CHANGE, Recording
    from lampest.recording.tare import frames_named, tared

    recording = Recording.load(file)
    named = frames_named(frames, len(recording.role))
    made, change = tared(recording, named)
    replaced = out.is_file()
    made.save(out)
    screen.say(
        f"unloaded: frames {named[0]} to {named[-1]}: {screen.written(out, replaced=replaced)}"
    )
    if change > MIN_CHANGE:
        screen.warn(
            f"readings change by up to {100 * change:.1f} % within these frames; "
            "did a load come or go?"
        )
