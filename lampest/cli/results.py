"""Commands that read, compare, draw, export and describe recordings and results."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli.screen import (
    WRONG_INPUT,
    option,
    print_notes,
    print_table,
    progress,
    say,
    say_text,
    warn,
    written,
)
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lampest.report.detect.answer import Detected
    from lampest.report.detect.pressed import PressedCells

FramesNamed = Annotated[str | None, option("Range of frames: 40:50 is 40 to 49.", metavar="RANGE")]


def _frames(text: str | None) -> range | None:
    """Return the frames that an option names, or None for all. Raises InputError unless it names some."""
    from lampest.recording.recording import frames_named

    return None if text is None else frames_named(text)


def compare(
    results: Annotated[list[Path], typer.Argument(help="Results files.")],
    csv: Annotated[Path | None, written("--csv", "Also write the table to this file.")] = None,
    report: Annotated[
        Path | None, written("--report", "Write a page with figures, intervals and a recommendation.")
    ] = None,
    frames: FramesNamed = None,
    published: Annotated[bool, option("Also print published figures that the run file quotes.", "--published")] = False,
) -> None:
    """Compare methods over recordings: frames solved, time, data error, and cell error where the truth is known."""
    from lampest.report.compare import compare_files, legend, model_notes, screen_blocks, write_csv

    with progress("recordings") as on_recording:
        rows = compare_files(results, _frames(frames))
        if csv:
            write_csv(csv, rows)
        if report:
            from lampest.report.page.page import write_report

            write_report(results, report, on_recording, _frames(frames))
    blocks = screen_blocks(rows, published=published)
    for block in blocks:
        say(block.title)
        print_table(block)
    print_notes((*legend(rows, blocks), *model_notes(rows)))


def plot(
    results: Annotated[Path, typer.Argument(help="A results file.")],
    out: Annotated[
        Path | None, written("--out", "Output folder, or one picture such as x.svg. Default: beside the results.")
    ] = None,
    show: Annotated[
        str | None,
        option(
            "contours, change, resistance, residuals, pressure, certainty, sweep. Default: contours, of sweeps errors.",
            metavar="KIND",
        ),
    ] = None,
    frame: Annotated[int | None, option("Frame index, such as 12. Default: a frame of strong change.", min=0)] = None,
    recording: Annotated[list[str] | None, option("Recording to plot, such as mine. Default: all. Repeatable.")] = None,
    estimator: Annotated[list[str] | None, option("Estimator to plot, such as LSM. Default: all. Repeatable.")] = None,
    frames: FramesNamed = None,
) -> None:
    """Plot contours of every recording side by side, or error bars, or pressures."""
    from lampest.report.plots import plot_results

    with progress("pictures") as on_picture:
        files = plot_results(
            results,
            out,
            show,
            on_picture=on_picture,
            frame=frame,
            estimators=tuple(estimator or ()),
            frames=_frames(frames),
            recordings=tuple(recording or ()),
        )
    for path in files:
        say(path)


def export(
    results: Annotated[Path, typer.Argument(help="A results file.")],
    to: Annotated[str, option("csv, parquet, mat, zarr or nwb.", metavar="FORMAT")],
    out: Annotated[Path | None, written("--out", "Output file. Default: beside the results.")] = None,
    recording: Annotated[str | None, option("Export this recording only; nwb takes one.")] = None,
    start: Annotated[str | None, option("Start time for nwb if the file has none: 2026-05-04T09:30:00+02:00.")] = None,
    frames: FramesNamed = None,
) -> None:
    """Export results to pandas and R, MATLAB and Octave, xarray or NWB, with units and descriptions."""
    from lampest.report.export import export_results

    for file in export_results(results, to, out, recording, start, _frames(frames)):
        say(file)


def detect(
    file: Annotated[Path, typer.Argument(help="A recording or a results file.")],
    out: Annotated[
        Path | None, written("--out", "Output folder. Default: results/<recording>, or beside the results.")
    ] = None,
    as_json: Annotated[bool, option("Print the answers as JSON, and write no files.", "--json")] = False,
    everything: Annotated[
        bool, option("Also print notes and, for results, the frame of the largest force.", "--all")
    ] = False,
    patch: Annotated[
        float | None, option("Edge length of a cell's film in mm, such as 6. Default: 0.6 of the pitch.")
    ] = None,
    estimator: Annotated[
        str | None, option("Estimator whose force and area are printed, such as LSM. Default: the first.")
    ] = None,
    frames: FramesNamed = None,
) -> None:
    """Detect contacts: since when, where, how large, and whether one sucks. One sentence per recording, then events.

    Writes detections.h5 and a timeline of each recording; of results with pressures also pressed.csv with every frame.
    """
    from lampest.report.detect.detection import detect_recording, detect_results, is_results
    from lampest.report.detect.pressed import pressed
    from lampest.runs.results import read_results

    if patch is not None and not 0 < patch < float("inf"):
        raise InputError("--patch must be positive and finite")
    results = read_results(file, frames=_frames(frames)) if is_results(file) else None
    if results is None and estimator is not None:
        raise InputError(f"{file}: --estimator: a recording has none; name a results file")
    loads: Sequence[PressedCells] = ()
    with progress("recordings" if results else "frames") as on_case:
        if results is None:
            answers = [detect_recording(file, patch, _frames(frames), on_case)]
        else:
            answers = detect_results(results, patch, on_case)
            loads = pressed(results.named("estimator", (estimator or results.estimators()[0],)))
    if as_json:
        content = [answer.content() for answer in answers]
        say_text(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False))
    else:
        folder = file.parent if results is not None else Path("results") / file.stem
        _tell(answers, loads, folder if out is None else out, everything=everything)


def _tell(answers: "Sequence[Detected]", loads: "Sequence[PressedCells]", folder: Path, *, everything: bool) -> None:
    """Write the files of the answers, and print their sentences and tables."""
    from lampest.files.whole import refuse_inputs
    from lampest.report.detect.answer import FILE, event_table, load_table, write_detections
    from lampest.report.detect.pressed import FILE as PRESSED
    from lampest.report.detect.pressed import pressed_table, write_pressed
    from lampest.report.plots.timeline import plot_timelines, timeline_files

    refuse_inputs([folder / FILE, *timeline_files(answers, folder), *([folder / PRESSED] if loads else [])])
    with progress("pictures") as on_picture:
        files = [write_detections(folder / FILE, answers), *plot_timelines(answers, folder, on_picture)]
    files += [write_pressed(folder / PRESSED, loads)] if loads else []
    for answer in answers:
        say(f"{answer.recording}: {answer.sentence}" if len(answers) > 1 else answer.sentence)
    print_notes(f"warning: {answer.recording}: {line}" for answer in answers for line in answer.warnings)
    print_table(event_table(answers))
    if everything:
        print_table(load_table(answers))
        print_table(pressed_table(loads))
        print_notes(tuple(f"{answer.recording}: {note}" for answer in answers for note in answer.notes))
    for path in files:
        say(path)


def terms() -> None:
    """List the cost terms with their formulas, units and options."""
    from lampest.cost.terms import term_types
    from lampest.report.compare import Table

    rows = []
    for kind, term in term_types().items():
        options = ", ".join(
            f"{field.name}: {getattr(field.default, 'kind', field.default)}"
            for field in dataclasses.fields(term)
            if field.name != "kind"
        )
        rows.append((kind, " ".join((term.__doc__ or "").split("\n\n")[0].split()), term.unit, options))
    print_table(Table(("term", "residual", "unit", "options and defaults"), tuple(rows)))


def schema() -> None:
    """Print the JSON schema of a run's file."""
    from lampest.runs.config import json_schema

    say_text(json.dumps(json_schema(), indent=2))


def info(
    file: Annotated[Path, typer.Argument(help="A recording or a results file.")],
    picture: Annotated[
        Path | None, written("--picture", "Draw the strongest frame into this .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Describe a file and draw the frame with the strongest change as a small map."""
    from lampest.report.info import describe

    with progress("reading"):
        lines = describe(file)
    for line in lines:
        say(line)
    if picture is not None:
        from lampest.report.plots import plot_file

        say(plot_file(file, picture))


def check(
    files: Annotated[list[Path], typer.Argument(parser=Path, metavar="FILE...", help="Recordings or results.")],
    repair: Annotated[bool, option("Recover recordings after a crash.", "--repair")] = False,
) -> None:
    """Verify the checksums of files and name the first damaged dataset of each."""
    from lampest.report.info import checked_sentence

    damaged = 0
    with progress("files") as on_file:
        for number, file in enumerate(files, 1):
            try:
                say(_repaired(file) if repair else checked_sentence(file))
            except InputError as error:
                warn(error)
                damaged += 1
            on_file(number, len(files))
    if damaged:
        raise typer.Exit(WRONG_INPUT)


def _repaired(file: Path) -> str:
    from lampest.recording.board.record import repair

    frames, dropped = repair(file)
    single = dropped == 1
    damage = f"; {dropped} damaged frame{' is' if single else 's are'} dropped and count{'s' if single else ''} as lost"
    return f"{frames} frames: {file}{damage if dropped else ''}"
