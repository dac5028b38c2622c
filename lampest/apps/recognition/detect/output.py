"""What `lampest detect` prints and writes."""

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from lampest.apps.recognition.detect import answer, pressed, visits
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import (
    Unchecked,
    answer_recording,
    detect_results,
    named_apart,
    recordings_in,
)
from lampest.cli import screen
from lampest.files.errors import InputError
from lampest.files.hdf5 import format_of
from lampest.files.whole import refuse_inputs
from lampest.runs.results import read_results


def examined(
    paths: Sequence[Path],
    patch_mm: float | None,
    threshold: float,
    estimator: str | None,
    frames: range | None,
    *,
    check: bool,
) -> tuple[Path, list[Unchecked], list[pressed.PressedCells]]:
    """Return the default folder, and the answers and pressed cells of files; see `lampest detect`.

    Cells are pressed in results with pressures.
    """
    sources = recordings_in(paths)
    recordings = [each for each in sources if not format_of(each).startswith("results/")]
    if estimator is not None and recordings:
        raise InputError(f"{recordings[0]}: --estimator: a recording has none; name a results file")
    answers = list[Unchecked]()
    loads = list[pressed.PressedCells]()
    for source in sources:
        if source in recordings:
            with screen.progress("frames") as on_case:
                answers.append(
                    answer_recording(source, patch_mm, frames, threshold, on_case, check=check)
                )
            continue
        with screen.progress("recordings") as on_case:
            results = read_results(source, frames=frames)
            answers += map(Unchecked, detect_results(results, patch_mm, threshold, on_case))
            named = (estimator or results.estimators()[0],)
            loads += pressed.pressed(results.named("estimator", named))
    folder = sources[0].parent
    if len(sources) > 1:
        mats = all(unchecked.answer.mat for unchecked in answers)
        folder = Path("results") / ("contacts" if mats else "visits")
    elif recordings:
        folder = Path("results") / sources[0].stem
    return folder, answers, loads


def tell_answers(
    folder: Path,
    pending: Sequence[Unchecked],
    loads: Sequence[pressed.PressedCells],
    *,
    as_json: bool,
    everything: bool,
) -> None:
    """Print the answers, and write their files; with `as_json` print alone."""
    answers = named_apart([unchecked.answer for unchecked in pending])
    if as_json:
        content = [each.content() for each in with_checks(answers, pending)]
        screen.say_text(json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False))
        return
    refuse_inputs(_tables(folder, loads))  # before anything is said
    several = len(answers) > 1
    if several:
        called = [name for each in answers for name in each.called]
        screen.say(f"{len(answers)} recordings: {answer.headline(called)}")
    for each in answers:
        screen.say(f"{each.recording}: {each.sentence}" if several else each.sentence)
    tell(with_checks(answers, pending), loads, folder, everything=everything)


def with_checks(answers: Sequence[Detected], pending: Sequence[Unchecked]) -> list[Detected]:
    """Check the circuits of the answers' recordings, and return the answers with warnings."""
    checked = []
    count = sum(unchecked.doubts is not None for unchecked in pending)
    bar: AbstractContextManager[Callable[..., None]]
    bar = screen.progress("checks") if count else nullcontext(lambda *counts: None)
    with bar as on_check:
        on_check(0, count)
        done = 0
        for each, unchecked in zip(answers, pending, strict=True):
            checked.append(replace(each, warnings=unchecked.checked().warnings))
            done += unchecked.doubts is not None
            on_check(done, count)
    return checked


def _tables(folder: Path, loads: Sequence[pressed.PressedCells]) -> list[Path]:
    """Return the files of the answers without pictures: events, visits, and pressed cells."""
    names = (answer.FILE, visits.FILE, *((pressed.FILE,) if loads else ()))
    return [folder / name for name in names]


def tell(
    answers: Sequence[Detected],
    loads: Sequence[pressed.PressedCells],
    folder: Path,
    *,
    everything: bool,
) -> None:
    """Write the files of the answers, print their warnings and tables, and draw the pictures."""
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
        files += draw(answers, counted if several else [], folder)
    for path in files:
        screen.say(path)
    if not drawing:
        screen.print_notes(
            ["no pictures: matplotlib is not installed; pip install 'lampest[plots]' brings it"]
        )


def draw(answers: Sequence[Detected], season: Sequence[visits.Visit], folder: Path) -> list[Path]:
    """Draw the timelines of the answers, and the visits, and return the files."""
    from lampest.apps.recognition.detect import timeline as pictures
    from lampest.report.plots.style import write_all

    figures = {
        folder / f"timeline_{each.recording}.png": partial(pictures.timeline, each)
        for each in answers
        if each.course is not None
    }
    if season:
        figures[folder / visits.PICTURE] = partial(pictures.season, season)
    files = list(figures)
    refuse_inputs(files)
    with screen.progress("pictures") as on_picture:
        return write_all(list(figures.values()), files, on_picture)
