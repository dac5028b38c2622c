"""Descriptions of recordings, results files and imports as text with a small map."""

import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.applications import applications
from lampest.files.document import plain_content
from lampest.files.errors import InputError, first_and_more
from lampest.files.whole import own
from lampest.inference.estimated import estimated_lines
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import Scene
from lampest.recording.processed import processing_of
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import MAX_READINGS, PART_READINGS, StoredRecording, opened, too_long
from lampest.report.strongest import (
    as_recorded,
    mean_reading,
    reference_words,
    strongest_index,
    strongest_readings,
)
from lampest.report.words import spanned
from lampest.runs.provenance import digest
from lampest.runs.results import FORMAT, CaseResult, Results, read_each, read_results, stored_cases

if TYPE_CHECKING:
    from lampest.audit.advice import Audit
    from lampest.runs.checks import RecordingCheck

MAX_ROWS = 48  # of a map
MAX_NAMED = 4  # datasets in a sentence
MAX_LISTED = 4  # numbers of an entry; of more the range is given
FALLS = " ░▒▓█"
RISES = " .+*#"
UNKNOWN = "?"
READINGS = ("/entry/two_point/resistance", "/entry/readings/volt")
SEALED = "as written: {bytes} bytes in {datasets} datasets agree with their checksums"
TOO_LONG = "too long for memory; frames {} to {}:"
Sentence = tuple[str, object]  # heading, text
Sentences = Iterator[Sentence]
UNSEALED = (
    "readable, but without checksums: "
    "written by an older version or another program, or never closed"
)
WEAK = (
    "readable; its checksums notice turned bits, but neither zeroed nor exchanged values "
    "(no digests: {paths})"
)


def describe(path: str | Path) -> Iterator[str]:
    """Yield the description of a file line by line.

    The lines state format, frames, panel, scene, times, roles, range of readings, and the strongest
    change. The verdict on a recording's circuit comes last, because nothing else waits for it.

    All frames of a file that exceeds the memory are counted, and the first ones are described.
    The check of a recording's circuit is written beside the file, unless it is kept there already.
    Raises InputError for a damaged file and for one that is neither a recording nor results.
    """
    path = Path(path)
    form = hdf5.format_of(path)
    with hdf5.existing_file(path) as file:
        if not form and not any(hdf5.has(file, place) for place in READINGS):
            raise InputError(f"{path}: neither a recording nor results (no lampest_format)")
    head = f"{path}: {form or 'a recording without lampest_format'}"
    if form == FORMAT:
        cases = stored_cases(path)
        if not any(too_long(case.frames, case.cells) for case in cases):
            yield from (head, *_results_lines(read_results(path)))
            return
        part = next(read_each(path, PART_READINGS))
        first, last = part.frame[[0, -1]].tolist()
        long = [f"  {case.estimator}  {case.frames} frames  case {case.case_id}" for case in cases]
        shown = _results_lines(read_results(path, frames=range(first, last + 1)))
        yield from (head, *long, TOO_LONG.format(first, last), *shown)
        return
    sha256 = digest(path)
    recording = opened(path)
    yield head
    if isinstance(recording, Recording):
        yield from _recording_lines(recording, (path, sha256))
        return
    block, *_ = blocks = recording.blocks
    parts = ((part.role, part.time) for part in map(recording.part, blocks))
    yield from _lines([_frames(*map(np.concatenate, zip(*parts, strict=True)))])
    yield TOO_LONG.format(block[0], block[-1])
    yield from _recording_lines(recording.part(block))


def _lines(sentences: Iterable[Sentence]) -> Iterator[str]:
    """Yield a line for each sentence that is not empty, behind its heading.

    Files hold ± as ASCII.
    """
    return (f"{head:10} {text}".replace("+-", "±") for head, text in sentences if text)


def _frames(role: NDArray[np.uint8], time: Array) -> Sentence:
    """Return the numbers of frames and their times."""
    unloaded, measured = (np.sum(role == kind) for kind in (UNLOADED, MEASURED))
    kinds = f"{len(role)}: {unloaded} unloaded, {measured} measured"
    return "frames", f"{kinds}; {time.min():g} to {time.max():g} s"


def _recording_lines(
    recording: Recording, of_file: tuple[Path, str] | None = None
) -> Iterator[str]:
    """Yield the content of a recording, the map of its strongest change, and the verdict.

    The check is that kept for a file and its digest; without one it is computed, and kept beside
    the file.
    """
    from lampest.runs.checks import RecordingCheck, keep_beside  # results do without it

    found = _found(recording, of_file)
    yield from _lines(_content(recording))
    with suppress(InputError):  # an estimate raises it; a description of the file does not
        if isinstance(found, RecordingCheck):
            health: Iterable[str] = found.health.split("\n")
            noise = found.noise
        else:
            health = found.health.lines
            noise = found.prepared.frame_noise.summary
        named = zip(chain(["health"], repeat("")), health, strict=False)
        yield from _lines([*named, ("noise", noise)])
    strongest = strongest_readings(recording)
    if strongest is None:
        yield f"readings of frame 0 in {recording.scene.circuit.unit}:"
        yield from text_map(recording.recorded[0])
    else:
        frame, change = strongest
        where = f"frame {frame} at {recording.time[frame]:g} s"
        yield f"readings of {where}, the strongest change against the unloaded ones:"
        yield from shaded_map(change)
    with suppress(InputError):
        yield from _lines(_estimated(recording, found))
        if not isinstance(found, RecordingCheck):
            found = RecordingCheck.of(found)
            if of_file is not None:
                keep_beside(*of_file, found)
        yield from _lines(_verdict(found))
        yield from _advice(found.advice)


def _found(recording: Recording, of_file: tuple[Path, str] | None) -> "Audit | RecordingCheck":
    """Return the kept check of a recording, or its audit, which loads the whole estimate."""
    from lampest.runs.checks import kept_check

    if of_file is not None and (kept := kept_check(*of_file)):
        return kept
    from lampest.audit.advice import Audit
    from lampest.inference.prepared import Prepared

    return Audit(Prepared(recording))


def _content(recording: Recording) -> Sentences:
    """Yield frames, scene, and the readings and values of a recording."""
    scene = recording.scene
    circuit = scene.circuit
    extras = {
        "σ": recording.sigma,
        "true cell resistance": recording.truth_cell_resistance,
        "true pressure": recording.truth_pressure,
        "sums of ADC codes": recording.raw_sums,
        "the board's estimate": recording.board_log_change,
    }
    yield _frames(recording.role, recording.time)
    yield "start", recording.start_time and f"{recording.start_time} at 0 s"
    yield from _scene(scene)
    yield "readings", f"{spanned(recording.recorded, circuit.unit)} ({circuit.signal_name})"
    readings = recording.readings()
    yield "", holes_sentence(readings.missing(scene), readings.bounds)
    estimable = readings.enough(scene)
    unloaded = recording.role == UNLOADED
    if not np.all(estimable):
        few = f"{np.sum(~estimable)} of {len(estimable)} frames"
        yield "", f"{few} have too few values to be estimated"
    if np.any(unloaded) and np.any(estimable) and not readings[unloaded].mean().enough(scene):
        yield (
            "",
            "the unloaded frames have too few values: the first frame with enough stands for them",
        )
    yield from applications().advice(recording)
    held = (name for name, values in extras.items() if values is not None)
    yield "besides", ", ".join(held) or "nothing"


def _estimated(recording: Recording, found: "Audit | RecordingCheck") -> Sentences:
    """Yield sentences on processing by firmware, and on the numbers that the scene estimates."""
    from lampest.runs.checks import RecordingCheck

    readout = recording.scene.readout
    if readout is not None and readout.floor_code is None and recording.scene.baseline is None:
        codes = np.rint(readout.steps_from_volt(readout.volt_from_recorded(recording.recorded)))
        resting = recording.role == UNLOADED
        if reason := processing_of(codes, resting, recording.scene.panel.present):
            yield "warning", f"these are no readings as the converter gives them: {reason}"
    if isinstance(found, RecordingCheck):
        lines: Iterable[str] = found.estimated.split("\n")
    else:
        lines = estimated_lines(found.prepared.noise.estimated)
    yield from zip(repeat("estimated"), lines, strict=False)


def _verdict(check: "RecordingCheck") -> Sentences:
    """Yield warnings, the verdict on the circuit, and widths."""
    without = check.without.split("\n")
    yield from zip(repeat("warning"), without, strict=False)
    yield "model", f"{check.mark}: {check.sentence}"
    for warning in check.warnings.split("\n"):
        if warning not in without and warning not in check.sentence:
            yield "warning", warning
    yield from zip(chain(["width"], repeat("")), check.widths.split("\n"), strict=False)


def _advice(advice: str) -> Iterator[str]:
    """Yield the sentences of advice behind their heading, and entries of a scene as they stand."""
    from lampest.audit.finding import sentences_and_entries

    sentences, entries = sentences_and_entries(advice)
    yield from _lines(("advice", sentence) for sentence in sentences)
    yield from entries


def apply_advice(path: str | Path) -> list[str]:
    """Write the lines of a recording's advice into its scene, and return sentences on the changes.

    Raises InputError where the file is no recording that fits into memory.
    """
    from lampest.audit.advice import Audit
    from lampest.audit.finding import with_lines
    from lampest.inference.prepared import Prepared

    path = Path(path)
    own(path)
    if hdf5.format_of(path) == FORMAT:
        raise InputError(
            f"{path}: --apply: results keep the scene of their run; name the recording"
        )
    recording = opened(path)
    if not isinstance(recording, Recording):
        raise InputError(
            f"{path}: --apply: too long for memory; write the lines into its scene before import"
        )
    scene, written, refused = with_lines(recording.scene, Audit(Prepared(recording)).advice)
    lines = [f"written to the scene of {path}: {line}" for line in written]
    if written:
        before = path.with_suffix(f".before{path.suffix}")
        numbered = (before.with_stem(f"{before.stem}{number}") for number in count(2))
        before = next(free for free in chain([before], numbered) if not free.exists())
        shutil.copyfile(path, before)
        replace(recording, scene=scene).save(path)
        lines.append(f"the file before: {before}")
    lines += [f"not written: {sentence}" for sentence in refused]
    return lines or [f"{path}: no advice has a line to write"]


def _scene(scene: Scene) -> Sentences:
    """Describe panel, readout and series resistance in words, and other entries by their keys."""
    # Circuits are loaded for a scene's words alone.
    from lampest.inference.circuits.open_ends import open_ends

    panel = scene.panel
    cells = ""
    if panel.cells is not None:
        wide, tall = (most - least for least, most in panel.extents_mm)
        cells = f", {len(panel.cells)} cells at listed places over {wide:g} × {tall:g} mm"
    modules = panel.modules
    if modules is not None:
        each = f"{modules.each.rows} × {modules.each.columns}"
        seam = f"seams of {modules.seam_mm:g} mm"
        cells = f", {modules.rows} × {modules.columns} modules of {each} cells with {seam}"
    size = f"{panel.rows} rows × {panel.columns} columns"
    yield "panel", f"{size}{cells}, pitch {panel.pitch_mm:g} mm"
    readout = scene.readout
    yield "readout", "unknown, resistances alone" if readout is None else readout.description()
    yield "assumed", scene.assumed and f"{scene.assumed_text}: the scene does not say"
    excluded = "; ".join(f"{end.words} ({end.key})" for end in open_ends(scene))
    yield "excluded", excluded and f"{excluded}; readings seldom show them"
    yield "series", scene.series_text if scene.circuit.unit == "ohm" else ""
    for name, part in plain_content(scene).items():
        if name not in ("panel", "readout", "assumed", "series_resistance_ohm"):
            yield name, _in_words(part) or "none"


def _in_words(part: Any) -> str:
    """Return an entry as text, such as 'hysteresis 0.2, creep_per_decade auto'.

    Many numbers are given as their range. Entries of a list of mappings are separated by
    semicolons.
    """
    if isinstance(part, dict):
        entries = ((key, _in_words(value)) for key, value in part.items())
        return ", ".join(f"{key} {words}" for key, words in entries if words)
    if isinstance(part, list) and any(isinstance(item, dict) for item in part):
        return "; ".join(map(_in_words, part))
    numbers = _numbers(part) if isinstance(part, list) else []
    if len(numbers) > MAX_LISTED:
        return f"{min(numbers):.3g} to {max(numbers):.3g}"
    return f"{part:g}" if isinstance(part, float) else f"{part or ''}"


def _numbers(value: Any) -> list[float]:
    """Return the numbers of nested lists, in their order."""
    if isinstance(value, list):
        return list(chain.from_iterable(map(_numbers, value)))
    return [value] if isinstance(value, int | float) else []


def _results_lines(results: Results) -> list[str]:
    """Return the recordings, the cases, and the cells of the first case in words."""
    lines = list[str]()
    for recording in results.recordings():
        cases = results.of(recording)
        lines += _measurement_lines(cases[0])
        width = max(len(case.estimator) for case in cases)
        for case in cases:
            solved = f"solved {np.sum(case.solved)}/{len(case.measured)}"
            if case.local_optima is not None:
                _, least, most = case.local_optima
                starts = f"{least}" if least == most else f"{least} to {most}"
                starts += f" start{'' if most == 1 else 's'} a frame"
                solved += f", verified local optima, best of {starts}"
            cells = f"r {spanned(case.cell_resistance, 'ohm')}  case {case.case_id}"
            lines.append(f"  {case.estimator:{width}}  {solved}  {cells}")
            if case.error_words:
                lines.append(f"  {'':{width}}  {case.error_words} (medians)")
    if results.published:
        lines.append(f"published figures of {', '.join(results.published)}")
    for case in results.cases[:1]:
        place = strongest_index([case])
        where = f"frame {case.frame[place]} at {case.time[place]:g} s"
        shown = f"cells of {case.recording} × {case.estimator} in {where}"
        lines.append(f"{shown}, change against {reference_words(case)}:")
        lines += shaded_map(case.relative_change[place])
    return lines


def _measurement_lines(case: CaseResult) -> list[str]:
    """Return the data that all cases of a recording share, in words."""
    scene = case.scene
    frames, rows, columns = case.measured.shape
    truth = "not in" if case.truth is None else "in"
    taken_off = ", series resistance taken off" if scene.circuit.unit == "ohm" else ""
    values = spanned(as_recorded(case.measured, scene), scene.circuit.unit)
    headline = (
        f"recording {case.recording}: {frames} frames, "
        f"{case.time.min():g} to {case.time.max():g} s, {rows} rows × {columns} columns, "
        f"pitch {scene.panel.pitch_mm:g} mm, truth {truth} the file"
    )
    missing = np.isnan(case.measured) & scene.requested
    # results of older versions do not say what are bounds
    bounds = np.zeros(missing.shape) if case.reading_side is None else case.reading_side
    model = ""
    if case.model_mark and case.model_sentence not in case.warnings:
        model = f"{case.model_mark}: {case.model_sentence}"
    sentences = [
        ("readings", f"{values} ({scene.circuit.signal_name}{taken_off})"),
        ("", holes_sentence(missing, bounds != 0)),
        ("model", model),
        *(("warning", line) for line in case.warnings.split("\n")),
        *(("estimated", line) for line in estimated_lines(scene.estimated)),
        ("film", case.film_sentence),
        ("noise", case.noise_learned),
    ]
    return [headline, *_lines(sentences), *_advice(case.advice)]


def holes_sentence(missing: Mask, bounds: Mask) -> str:
    """Return a sentence on missing readings and readings at a rail; '' if every one is a value.

    An example is `12 readings missing (0.4 %), 30 at a rail, ... (1 %), in 7 of 40 frames`. Lines
    without readings are named.

    Parameters
    ----------
    missing, bounds : boolean array, shape (frames, rows, columns)
    """
    parts = list[str]()
    for kind, words in (
        (missing, "missing"),
        (bounds, "at a rail, zero or below the series resistance"),
    ):
        if number := np.sum(kind):
            noun = "" if parts else " reading" if number == 1 else " readings"
            share = float(f"{100 * number / missing.size:.2g}")
            parts.append(f"{number}{noun} {words} ({share:g} %)")
    if not parts:
        return ""
    frames = np.sum((missing | bounds).any(axis=(1, 2)))
    sentence = f"{', '.join(parts)}, in {frames} of {len(missing)} frames"
    lines = [f"row {number}" for number in np.flatnonzero(missing.all(axis=(0, 2)))]
    lines += [f"column {number}" for number in np.flatnonzero(missing.all(axis=(0, 1)))]
    if not lines:
        return sentence
    named = " and ".join(lines) if len(lines) < 3 else first_and_more(lines)
    return f"{sentence}; {named} {'has' if len(lines) == 1 else 'have'} none"


def understood_lines(recording: Recording, notes: Sequence[str]) -> list[str]:
    """Return the notes of an import and a map of mean readings.

    Swapped rows and columns show in the map.
    """
    return [
        *notes,
        f"mean reading in {recording.scene.circuit.unit}:",
        *text_map(mean_reading(recording.recorded)),
    ]


def checked_sentence(path: Path) -> str:
    """Read a whole file and return a sentence on its integrity.

    The sentence names datasets that cannot be verified.

    Raises InputError with the path of a damaged dataset.
    """
    form = hdf5.format_of(path)
    size, verified = hdf5.checked(path)
    if form == FORMAT:
        for _ in read_each(path, MAX_READINGS):
            pass
    elif form.startswith("recording/") or verified.without_checksum:
        recording = opened(path)
        if isinstance(recording, StoredRecording):
            for part in recording.blocks:
                recording.part(part)
    if verified.without_checksum:
        return f"{path}: {UNSEALED} ({first_and_more(verified.without_checksum, MAX_NAMED)})"
    if verified.without_digest:
        return f"{path}: {WEAK.format(paths=first_and_more(verified.without_digest, MAX_NAMED))}"
    return f"{path}: {SEALED.format(bytes=size, datasets=verified.datasets)}"


def text_map(values: Array) -> list[str]:
    """Return a matrix (rows, columns) as lines of numbers, cropped to the screen."""
    lines = [[*map(str, range(values.shape[1]))]]
    lines += [
        ["-" if np.isnan(value) else f"{value:.4g}" for value in row] for row in values[:MAX_ROWS]
    ]
    labels = ["column", *(f"row {row}" for row in range(len(lines) - 1))]
    width = 2 + max(map(len, chain.from_iterable(lines)))
    drawn, remark = _fitted(labels, lines, width, values.shape)
    return drawn + remark


def shaded_map(change: Array) -> list[str]:
    """Return changes (rows, columns) in percent as shaded characters.

    Falls are blocks and rises are signs; each has its own scale up to its largest value. A cell is
    two characters wide if all columns fit, else one.
    """
    known = np.isfinite(change)
    signs = np.where(known, " ", UNKNOWN)
    keys = []
    for name, shades, part in (("falls by", FALLS, -change), ("rises by", RISES, change)):
        finite = np.where(known, part, 0.0)
        end = max(np.max(finite), 1.0)  # changes from noise alone stay white
        steps = np.clip(np.rint(4 * finite / end), 0, 4).astype(int)
        signs = np.where(steps > 0, np.array(list(shades))[steps], signs)
        if np.any(steps > 0):
            parts = (f"{sign} {end * step / 4:.3g} %" for step, sign in enumerate(shades) if step)
            keys.append(f"{name} {' '.join(parts)}")
    if not known.all():
        keys.append(f"{UNKNOWN} no value")
    labels = [f"{row:>2} " for row in range(min(len(change), MAX_ROWS))]
    width = 2 if 2 * change.shape[1] + len(labels[-1]) <= _room() else 1
    lines = [[width * sign for sign in line] for line in signs[:MAX_ROWS].tolist()]
    drawn, remark = _fitted(labels, lines, width, change.shape)
    return [*(line.rstrip() for line in drawn), "; ".join(keys) or "nothing changes", *remark]


def _room() -> int:
    """Return the width of the terminal in characters, 100 if it is unknown."""
    return max(shutil.get_terminal_size((100, 24)).columns, 20)


def _fitted(
    labels: Sequence[str], lines: Sequence[Sequence[str]], width: int, shape: tuple[int, ...]
) -> tuple[list[str], list[str]]:
    """Return lines of texts with their labels, and a remark, as far as the screen has room.

    `shape` is the shape of the whole map.

    Returns
    -------
    drawn : list of str
        One line for each label.
    remark : list of str
        A sentence if the map has more rows or columns than are drawn, else nothing.
    """
    label_width = max(map(len, labels))
    rows = min(shape[0], MAX_ROWS)
    columns = min(shape[1], max(1, (_room() - label_width) // width))
    drawn = [
        f"{label:>{label_width}}" + "".join(f"{text:>{width}}" for text in line[:columns])
        for label, line in zip(labels, lines, strict=True)
    ]
    remark = f"(the first {rows} of {shape[0]} rows and {columns} of {shape[1]} columns)"
    return drawn, [] if (rows, columns) == shape else [remark]
