"""Commands that read, compare, draw, export and describe recordings and results."""

import dataclasses
import json
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.cli import screen
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lampest.apps.recognition.detect.answer import Detected
    from lampest.apps.recognition.detect.pressed import PressedCells
    from lampest.apps.recognition.detect.visits import Visit

FramesNamed = Annotated[
    str | None, screen.option("Range of frames: 40:50 is 40 to 49.", metavar="RANGE")
]


def _frames(text: str | None) -> range | None:
    """Return the frames that an option names, or None for all.

    Raises InputError unless it names some.
    """
    from lampest.recording.tare import frames_named

    return None if text is None else frames_named(text)


def compare(
    results: list[Path],
    csv: screen.Output = None,
    report: screen.Output = None,
    frames: FramesNamed = None,
    published: bool = False,
) -> None:
    """Compare methods over recordings.

    They are compared by frames solved, time, data error, and cell error where the truth is known.

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

    with screen.progress("recordings") as on_recording:
        rows = compare_files(results, _frames(frames))
        if csv:
            write_csv(csv, rows)
        if report:
            from lampest.apps.page.page import write_report

            write_report(results, report, on_recording, _frames(frames))
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
    frames: FramesNamed = None,
) -> None:
    """Plot contours of every recording side by side, or error bars, or pressures.

    Parameters
    ----------
    results
        A results file.
    out
        Output folder, or one picture such as x.svg. Default: beside the results.
    show
        contours, change, resistance, residuals, pressure, certainty, sweep, or an added plot.
        Default: contours, of sweeps errors.
    frame
        Frame index, such as 12. Default: a frame of strong change.
    recording
        Recording to plot, such as mine. Default: all. Repeatable.
    estimator
        Estimator to plot, such as LSM. Default: all. Repeatable.
    """
    from lampest.report.plots import plot_results

    chosen: dict[str, Any] = {
        "estimators": tuple(estimator or ()),
        "recordings": tuple(recording or ()),
    }
    with screen.progress("pictures") as shown:
        files = plot_results(
            results, out, show, on_picture=shown, frame=frame, frames=_frames(frames), **chosen
        )
    for path in files:
        screen.say(path)


def export(
    results: Path,
    to: Annotated[str, screen.option(metavar="FORMAT")],
    out: screen.Output = None,
    recording: str | None = None,
    start: str | None = None,
    frames: FramesNamed = None,
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
        _export_sketch(results, out, recording, estimator, (within, milliseconds, processor))
        return
    if any(value is not None for value in (estimator, within, milliseconds, processor)):
        raise InputError("--estimator, --within, --milliseconds and --processor belong to --to c")
    from lampest.report.export import export_results

    for file in export_results(results, to, out, recording, start, _frames(frames)):
        screen.say(file)


def _export_sketch(
    results: Path,
    out: Path | None,
    recording: str | None,
    estimator: str | None,
    wishes: tuple[float | None, float | None, str | None],
) -> None:
    """Write a sketch for a microcontroller, and print what budgets buy."""
    from lampest.apps.microcontroller.sketch import Wishes, export_sketch
    from lampest.apps.microcontroller.trade import table_of

    sketch = export_sketch(results, out, recording, estimator, Wishes(*wishes))
    for line in sketch.about:
        screen.say(line)
    if sketch.table:
        screen.print_table(table_of(sketch.table))
    screen.print_notes(sketch.notes)
    for path in sketch.files:
        screen.say(path)


def detect(
    files: list[Path],
    out: screen.Output = None,
    json_: bool = False,
    all_: bool = False,
    patch: screen.Amount = None,
    threshold: Annotated[float, screen.option(min=0.5, max=1.0)] = 0.9,
    estimator: str | None = None,
    frames: FramesNamed = None,
) -> None:
    """Detect contacts: since when, where, how large, and whether one sucks.

    The output is one sentence per recording, then events. Writes detections.h5, visits.csv with one
    row for each visit, visits.png and a timeline of each recording; of results with pressures also
    pressed.csv with every frame.

    Parameters
    ----------
    files
        Recordings, results files, or folders of recordings.
    out
        Output folder. Default: results/<recording>, of several results/visits, or beside the
        results.
    json_
        Print the answers as JSON, and write no files.
    all_
        Also print notes and, for results, the frame of the largest force.
    patch
        Edge length of a cell's film in mm, such as 6. Default: 0.6 of the pitch.
    threshold
        Probability from which something is called a lamprey or a suction cup. Default: 0.9.
    estimator
        Estimator whose force and area are printed, such as LSM. Default: the first.
    """
    from lampest.apps.recognition.detect.detection import (
        detect_recording,
        detect_results,
        named_apart,
        recordings_in,
    )
    from lampest.apps.recognition.detect.pressed import pressed
    from lampest.files.hdf5 import format_of
    from lampest.runs.results import read_results

    sources = recordings_in(files)
    answers: list[Detected] = []
    loads: list[PressedCells] = []
    is_results = [format_of(source).startswith("results/") for source in sources]
    if estimator is not None and not all(is_results):
        which = sources[is_results.index(False)]
        raise InputError(f"{which}: --estimator: a recording has none; name a results file")
    for source, of_results in zip(sources, is_results, strict=True):
        with screen.progress("recordings" if of_results else "frames") as on_case:
            if of_results:
                results = read_results(source, frames=_frames(frames))
                answers += detect_results(results, patch, threshold, on_case)
                loads += pressed(
                    results.named("estimator", (estimator or results.estimators()[0],))
                )
            else:
                answers.append(detect_recording(source, patch, _frames(frames), threshold, on_case))
    answers = named_apart(answers)
    if json_:
        content = [answer.content() for answer in answers]
        screen.say_text(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False))
    else:
        if out is None:
            out = _folder_of_answers(sources, is_results=is_results[0])
        _tell(answers, loads, out, everything=all_)


def _folder_of_answers(sources: "Sequence[Path]", *, is_results: bool) -> Path:
    """Return the default folder of the answers of some files.

    `is_results` states whether the first file is one of results.
    """
    if len(sources) > 1:
        return Path("results") / "visits"
    return sources[0].parent if is_results else Path("results") / sources[0].stem


def _tell(
    answers: "Sequence[Detected]",
    loads: "Sequence[PressedCells]",
    folder: Path,
    *,
    everything: bool,
) -> None:
    """Write the files of the answers, and print their sentences and tables."""
    from lampest.apps.recognition.detect import visits
    from lampest.apps.recognition.detect.answer import (
        FILE,
        event_table,
        headline,
        load_table,
        write_detections,
    )
    from lampest.apps.recognition.detect.pressed import FILE as PRESSED
    from lampest.apps.recognition.detect.pressed import pressed_table, write_pressed
    from lampest.files.whole import refuse_inputs

    season = visits.visits_of(answers)
    files = [folder / FILE, folder / visits.FILE]
    if loads:
        files.append(folder / PRESSED)
    refuse_inputs(files)
    write_detections(folder / FILE, answers)
    visits.write_visits(folder / visits.FILE, season)
    if loads:
        write_pressed(folder / PRESSED, loads)
    drawing = find_spec("matplotlib") is not None
    if drawing:
        files += _draw(answers, season, folder)
    several = len(answers) > 1
    if several:
        screen.say(f"{len(answers)} recordings: {headline([visit.answer for visit in season])}")
    for answer in answers:
        screen.say(f"{answer.recording}: {answer.sentence}" if several else answer.sentence)
    for answer in answers:
        screen.print_notes(f"warning: {answer.recording}: {line}" for line in answer.warnings)
    screen.print_table(event_table(answers))
    if len(season) > 1:
        screen.print_table(visits.count_table(answers, season))
    if everything:
        screen.print_table(load_table(answers))
        screen.print_table(pressed_table(loads))
        for answer in answers:
            screen.print_notes(f"{answer.recording}: {note}" for note in answer.notes)
    for path in files:
        screen.say(path)
    if not drawing:
        screen.print_notes(
            ["no pictures: matplotlib is not installed; pip install 'lampest[plots]' brings it"]
        )


def _draw(answers: "Sequence[Detected]", season: "Sequence[Visit]", folder: Path) -> list[Path]:
    """Draw the timelines of the answers, and the visits, and return the files."""
    from lampest.apps.recognition.detect import visits
    from lampest.apps.recognition.detect.season import plot_season
    from lampest.apps.recognition.detect.timeline import plot_timelines, timeline_files
    from lampest.files.whole import refuse_inputs

    files = list(timeline_files(answers, folder))
    if season:
        files.append(folder / visits.PICTURE)
    refuse_inputs(files)
    with screen.progress("pictures") as on_picture:
        files = list(plot_timelines(answers, folder, on_picture))
    if season:
        files.append(plot_season(folder / visits.PICTURE, season))
    return files


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
        rows.append(
            (kind, " ".join((term.__doc__ or "").split("\n\n")[0].split()), term.unit, options)
        )
    screen.print_table(Table(("term", "residual", "unit", "options and defaults"), tuple(rows)))


def schema() -> None:
    """Print the JSON schema of a run's file."""
    from lampest.runs.config import json_schema

    screen.say_text(json.dumps(json_schema(), indent=2))


def info(file: Path, picture: screen.Output = None, apply: bool = False) -> None:
    """Describe a file and draw the frame with the strongest change as a small map.

    Of a recording also the health of the panel, the verdict on its circuit, and advice: what the
    recording suggests beyond its scene, with the evidence and the line to add.

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

    with screen.progress("reading"):
        lines = apply_advice(file) if apply else describe(file)
    for line in lines:
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

    damaged = 0
    with screen.progress("files") as on_file:
        for number, file in enumerate(files, 1):
            try:
                screen.say(_repaired(file) if repair else checked_sentence(file))
            except InputError as error:
                screen.warn(error)
                damaged += 1
            on_file(number, len(files))
    if damaged:
        raise typer.Exit(screen.WRONG_INPUT)


def _repaired(file: Path) -> str:
    from lampest.apps.board.journal import repair

    frames, dropped = repair(file)
    single = dropped == 1
    damage = (
        f"; {dropped} damaged frame{' is' if single else 's are'} dropped and "
        f"count{'s' if single else ''} as lost"
    )
    return f"{frames} frames: {file}{damage if dropped else ''}"
