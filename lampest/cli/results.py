"""Commands that read, compare, draw, export and describe recordings and results."""

import json
from dataclasses import fields
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import typer

from lampest.cli import screen
from lampest.files.applications import applications
from lampest.files.errors import InputError


def compare(
    results: list[Path],
    csv: screen.Output = None,
    report: screen.Output = None,
    frames: screen.FramesNamed = None,
    published: bool = False,
) -> None:
    """Compare methods over recordings.

    The table has frames solved, time, data error, and cell error where the truth is known.

    Parameters
    ----------
    results
        Results files.
    csv
        Also write the table to this file.
    report
        Write a page with figures, intervals and a recommendation.
    published
        Also print published figures that the run file quotes.
    """
    from lampest.report.compare import compare_files, legend, model_notes, screen_blocks, write_csv
    from lampest.runs.results import Reader, read_results

    read: Reader = partial(read_results, frames=screen.frames_of(frames))
    if report:
        read = cache(read)  # the table and the page are made of the same results
    with screen.progress("recordings") as on_recording:
        rows = compare_files(results, read)
        if csv:
            write_csv(csv, rows)
        if report:
            write = applications().required("page", "report", "--report")
            write(results, report, on_recording, read)
    blocks = screen_blocks(rows, published=published)
    for block in blocks:
        screen.say(block.title)
        screen.print_table(block)
    screen.print_notes((*legend(rows, blocks), *model_notes(rows)))


def plot(
    results: Path,
    out: screen.Output = None,
    show: Annotated[str | None, screen.option(metavar="KIND")] = None,
    frame: Annotated[int | None, screen.option(min=0)] = None,
    recording: list[str] | None = None,
    estimator: list[str] | None = None,
    frames: screen.FramesNamed = None,
) -> None:
    """Plot contours of every recording side by side, or error bars, or pressures.

    Parameters
    ----------
    results
        A results file; a recording for readings.
    out
        Output folder, or one picture such as x.svg. Default: beside the results.
    show
        contours, change, resistance, residuals, pressure, certainty, sweep, or an added plot;
        readings for those of a recording that are missing, impossible or outliers. Default:
        contours, of sweeps errors.
    frame
        Frame index, such as 12. Default: a frame of strong change.
    recording
        Recording to plot, such as mine. Default: all. Repeatable.
    estimator
        Estimator to plot, such as LSM. Default: all. Repeatable.
    """
    if show == "readings":
        from lampest.report.plots.readings import plot_readings

        if frame is not None or frames or recording or estimator:
            raise InputError("--show readings draws a whole recording; name the file alone")
        screen.say(plot_readings(results, out))
        return
    from lampest.report.plots import plot_results

    with screen.progress("pictures") as shown:
        files = plot_results(
            results,
            out,
            show,
            on_picture=shown,
            frame=frame,
            estimators=tuple(estimator or ()),
            recordings=tuple(recording or ()),
            frames=screen.frames_of(frames),
        )
    for path in files:
        screen.say(path)


def export(
    results: Path,
    to: Annotated[str, screen.option(metavar="FORMAT")],
    out: screen.Output = None,
    recording: str | None = None,
    start: str | None = None,
    frames: screen.FramesNamed = None,
    estimator: str | None = None,
    within: screen.Amount = None,
    milliseconds: screen.Amount = None,
    processor: str | None = None,
) -> None:
    """Export results to pandas and R, MATLAB and Octave, xarray or NWB.

    Or export an estimator to a microcontroller.

    Parameters
    ----------
    results
        A results file, or detections.h5, whose visits are exported.
    to
        csv, xlsx, parquet, mat, zarr, nwb, c, or an added format. Visits: csv, parquet or mat.
    out
        Output file, of c a folder. Default: beside the results.
    recording
        Export this recording only; nwb and c take one.
    start
        Start time for nwb if the file has none: 2026-05-04T09:30:00+02:00.
    estimator
        Estimator for c, such as LSM. Default: the first.
    within
        For c: largest deviation from the optimum in the median frame, in standard deviations of the
        cells, such as 0.1.
    milliseconds
        For c: longest time of a frame on --processor, such as 20.
    processor
        For c: cortex-m4f, cortex-m7, rp2350 or esp32.
    """
    if to == "c":
        if start is not None or frames is not None:
            raise InputError(
                "--to c takes no --start and no --frames: it exports an estimator, not frames"
            )
        write = applications().required("microcontroller", "sketch", "--to c")
        write(results, out, recording, estimator, (within, milliseconds, processor))
        return
    if {estimator, within, milliseconds, processor} != {None}:
        raise InputError("--estimator, --within, --milliseconds and --processor belong to --to c")
    from lampest.report.export import export_results

    for file in export_results(results, to, out, recording, start, screen.frames_of(frames)):
        screen.say(file)


def terms() -> None:
    """List the cost terms with their formulas, units and options."""
    from lampest.cost.terms import term_types
    from lampest.report.compare import Table

    rows = []
    for kind, term in term_types().items():
        about, *_ = (term.__doc__ or "").split("\n\n")
        options = ", ".join(
            f"{field.name}: {getattr(field.default, 'kind', field.default)}"
            for field in fields(term)
            if field.name != "kind"
        )
        rows.append((kind, " ".join(about.split()), term.unit, options))
    screen.print_table(Table(("term", "residual", "unit", "options and defaults"), tuple(rows)))


def schema() -> None:
    """Print the JSON schema of a run's file."""
    from lampest.runs.config import json_schema

    screen.say_text(json.dumps(json_schema(), indent=2))


def info(file: Path, picture: screen.Output = None, apply: bool = False) -> None:
    """Describe a file and draw the frame with the strongest change as a small map.

    Of a recording also the health of the panel, the verdict on its circuit, and advice: what the
    recording suggests beyond its scene, with the evidence and the line to add. The verdict comes
    last. It is computed once, and kept beside the recording.

    Parameters
    ----------
    file
        A recording or a results file.
    picture
        Draw the strongest frame into this .png, .svg or .pdf.
    apply
        Write the lines of the advice into the recording's scene.
    """
    from lampest.report.info import apply_advice, describe

    for line in apply_advice(file) if apply else describe(file):
        screen.say(line)
    if picture is not None:
        from lampest.report.plots import plot_file

        screen.say(plot_file(file, picture))


def check(
    files: Annotated[list[Path], typer.Argument(parser=Path, metavar="FILE...")],
    repair: bool = False,
) -> None:
    """Verify the checksums of files and name the first damaged dataset of each.

    Parameters
    ----------
    files
        Recordings or results.
    repair
        Recover recordings after a crash.
    """
    from lampest.report.info import checked_sentence

    if repair:
        checked_sentence = applications().required("board", "repair", "--repair")
    damaged = 0
    with screen.progress("files") as on_file:
        on_file(0, len(files))
        for number, file in enumerate(files, 1):
            try:
                screen.say(checked_sentence(file))
            except InputError as error:
                screen.warn(error)
                damaged += 1
            on_file(number, len(files))
    if damaged:
        raise typer.Exit(screen.WRONG_INPUT)
