"""The command `detect`."""

import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lampest.cli import screen
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lampest.apps.recognition.detect.answer import Detected
    from lampest.apps.recognition.detect.detection import Unchecked
    from lampest.apps.recognition.detect.pressed import PressedCells
    from lampest.apps.recognition.detect.visits import Visit


def detect(
    files: list[Path],
    out: screen.Output = None,
    json_: bool = False,
    all_: bool = False,
    patch: screen.Amount = None,
    threshold: Annotated[float, screen.option(min=0.5, max=1.0)] = 0.9,
    estimator: str | None = None,
    frames: screen.FramesNamed = None,
    no_check: bool = False,
) -> None:
    """Detect contacts: since when, where, how large, and whether one sucks.

    The output is one sentence per recording, then events. Writes detections.h5, visits.csv with one
    row for each visit, and a timeline of each recording. Of several visits, but not of contacts of
    mats, also visits.png; of results with pressures also pressed.csv with every frame.

    Parameters
    ----------
    files
        Recordings, results files, or folders of recordings.
    out
        Output folder. Default: results/<recording>, of several results/visits (of mats
        results/contacts), or beside the results.
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
    no_check
        Leave out whether the circuits of recordings explain their readings.
    """
    from lampest.apps.recognition.detect.detection import named_apart, recordings_in
    from lampest.files.whole import refuse_inputs

    sources = recordings_in(files)
    pending, loads = _examined(sources, patch, threshold, estimator, frames, check=not no_check)
    answers = named_apart([unchecked.answer for unchecked in pending])
    if out is None:
        out = _folder_of_answers(sources, answers)
    if not json_:
        # Before anything is said.
        refuse_inputs(_tables(out, loads))
        _say_answers(answers)
    answers = _with_checks(answers, pending)
    if json_:
        content = [answer.content() for answer in answers]
        screen.say_text(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False))
        return
    _tell(answers, loads, out, everything=all_)


def _examined(
    sources: "Sequence[Path]",
    patch: float | None,
    threshold: float,
    estimator: str | None,
    frames: str | None,
    *,
    check: bool,
) -> "tuple[list[Unchecked], list[PressedCells]]":
    """Return the answers to recordings and results, and the cells that are pressed in results."""
    from lampest.apps.recognition.detect.detection import Unchecked, answer_recording
    from lampest.apps.recognition.detect.of_results import detect_results
    from lampest.apps.recognition.detect.pressed import pressed
    from lampest.runs.results import read_results

    named = screen.frames_of(frames)
    pending: list[Unchecked] = []
    loads: list[PressedCells] = []
    recordings = [source for source in sources if not _is_results(source)]
    if estimator is not None and recordings:
        raise InputError(f"{recordings[0]}: --estimator: a recording has none; name a results file")
    for source in sources:
        if source in recordings:
            with screen.progress("frames") as on_case:
                pending.append(
                    answer_recording(source, patch, named, threshold, on_case, check=check)
                )
            continue
        with screen.progress("recordings") as on_case:
            results = read_results(source, frames=named)
            pending += map(Unchecked.never, detect_results(results, patch, threshold, on_case))
            loads += pressed(results.named("estimator", (estimator or results.estimators()[0],)))
    return pending, loads


def _is_results(source: Path) -> bool:
    """Return whether a file is one of results."""
    from lampest.files.hdf5 import format_of

    return format_of(source).startswith("results/")


def _with_checks(answers: "Sequence[Detected]", pending: "Sequence[Unchecked]") -> "list[Detected]":
    """Check the circuits of the answers' recordings, and return the answers with warnings."""
    checked = []
    count = sum(unchecked.waits for unchecked in pending)
    bar: AbstractContextManager[Callable[..., None]]
    bar = screen.progress("checks") if count else nullcontext(lambda *counts: None)
    with bar as on_check:
        on_check(0, count)
        done = 0
        for answer, unchecked in zip(answers, pending, strict=True):
            checked.append(replace(answer, warnings=unchecked.checked().warnings))
            done += unchecked.waits
            on_check(done, count)
    return checked


def _folder_of_answers(sources: "Sequence[Path]", answers: "Sequence[Detected]") -> Path:
    """Return the default folder of the answers of some files."""
    if len(sources) > 1:
        return Path("results") / ("contacts" if all(answer.mat for answer in answers) else "visits")
    return sources[0].parent if _is_results(sources[0]) else Path("results") / sources[0].stem


def _say_answers(answers: "Sequence[Detected]") -> None:
    """Print the sentences of the answers, of several behind their common headline."""
    from lampest.apps.recognition.detect.answer import headline

    several = len(answers) > 1
    if several:
        called = [name for answer in answers for name in answer.called]
        screen.say(f"{len(answers)} recordings: {headline(called)}")
    for answer in answers:
        screen.say(f"{answer.recording}: {answer.sentence}" if several else answer.sentence)


def _tables(folder: Path, loads: "Sequence[PressedCells]") -> list[Path]:
    """Return the files of the answers without pictures: events, visits, and pressed cells."""
    from lampest.apps.recognition.detect import answer, pressed, visits

    names = (answer.FILE, visits.FILE, *((pressed.FILE,) if loads else ()))
    return [folder / name for name in names]


def _tell(
    answers: "Sequence[Detected]",
    loads: "Sequence[PressedCells]",
    folder: Path,
    *,
    everything: bool,
) -> None:
    """Write the files of the answers, print their warnings and tables, and draw the pictures."""
    from lampest.apps.recognition.detect import answer, pressed, visits

    # days and nights, and hours, are counted for animals alone
    animals = [each for each in answers if not each.mat]
    counted = visits.visits_of(animals)
    files = _tables(folder, loads)
    answer.write_detections(files[0], answers)
    visits.write_visits(files[1], visits.visits_of(answers))
    if loads:
        pressed.write_pressed(files[2], loads)
    for each in answers:
        screen.print_notes(f"warning: {each.recording}: {line}" for line in each.warnings)
    screen.print_table(answer.event_table(answers))
    several = len(counted) > 1  # which days and hours a table and a picture show
    if several:
        screen.print_table(visits.count_table(animals, counted))
    if everything:
        screen.print_table(answer.load_table(answers))
        screen.print_table(pressed.pressed_table(loads))
        for each in answers:
            screen.print_notes(f"{each.recording}: {note}" for note in each.notes)
    drawing = find_spec("matplotlib") is not None
    if drawing:
        files += _draw(answers, counted if several else [], folder)
    for path in files:
        screen.say(path)
    if not drawing:
        screen.print_notes(
            ["no pictures: matplotlib is not installed; pip install 'lampest[plots]' brings it"]
        )


def _draw(answers: "Sequence[Detected]", season: "Sequence[Visit]", folder: Path) -> list[Path]:
    """Draw the timelines of the answers, and the visits, and return the files."""
    from lampest.apps.recognition.detect import timeline as pictures
    from lampest.apps.recognition.detect import visits
    from lampest.files.whole import refuse_inputs
    from lampest.report.plots.style import write_all

    figures = {
        folder / f"timeline_{answer.recording}.png": partial(pictures.timeline, answer)
        for answer in answers
        if answer.course is not None
    }
    if season:
        figures[folder / visits.PICTURE] = partial(pictures.season, season)
    files = list(figures)
    refuse_inputs(files)
    with screen.progress("pictures") as on_picture:
        return write_all(list(figures.values()), files, on_picture)
