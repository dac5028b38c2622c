"""What a recording, a results file or an import holds, in a few lines of text with a small map."""

import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.noise import frame_noise_seen
from lampest.estimate.warnings import warnings_of
from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.loads.recognition.breathing import too_slow
from lampest.panel.film import Film
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.lines import lines_text
from lampest.panel.response import Response
from lampest.panel.scene import Faults, Scene
from lampest.recording.recording import FORMAT as RECORDING
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import BLOCK, WHOLE, StoredRecording, opened, too_long
from lampest.recording.touching import touching_columns, touching_rows
from lampest.report.strongest import mean_reading, strongest_index, strongest_readings
from lampest.runs.results import FORMAT, CaseResult, Results, read_each, read_results, stored_cases

MOST_ROWS = 48  # of a map
FALLS, RISES, UNKNOWN = " ░▒▓█", " .+*#", "?"
READINGS = ("/entry/two_point/resistance", "/entry/readings/volt")
SEALED = "as written: {bytes} bytes in {datasets} datasets agree with their checksums"
UNSEALED = "readable, but without checksums: an older version or another program wrote it, or it was never closed"


def describe(path: str | Path) -> list[str]:
    """Lines on a file: format, frames, panel, scene, times, roles, range of readings, and the strongest change.

    Raises InputError where the file is neither a recording nor results, or is damaged.
    """
    path = Path(path)
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
        form = form if isinstance(form, str) else None
        if form is None and not any(hdf5.has(file, path) for path in READINGS):
            raise InputError(f"{path}: neither a recording nor results (no lampest_format)")
    if form == FORMAT:
        return [f"{path}: {form}", *_stored_lines(path)]
    recording, head = opened(path), f"{path}: {form or 'a recording without lampest_format'}"
    return [head, *(_recording_lines(recording) if isinstance(recording, Recording) else _long_lines(recording))]


def _stored_lines(path: Path) -> list[str]:
    """Of results; of those that are too long to be held, their number and what the first frames say."""
    cases = stored_cases(path)
    if not any(too_long(case.frames, case.cells) for case in cases):
        return _results_lines(read_results(path))
    part = next(read_each(path, BLOCK))
    long = [f"  {case.estimator}  {case.frames} frames  case {case.case_id}" for case in cases]
    first, last = int(part.frame[0]), int(part.frame[-1])
    shown = _results_lines(read_results(path, frames=range(first, last + 1)))
    return [*long, f"too long to be held at once; of frames {first} to {last}:", *shown]


def _long_lines(recording: StoredRecording) -> list[str]:
    """Of a recording that is too long to be held: all of its roles and times, and what the first frames say."""
    blocks = recording.blocks()
    parts = ((part.role, part.time) for part in map(recording.part, blocks))
    role, time = (np.concatenate(values) for values in zip(*parts, strict=True))
    part = f"too long to be held at once; of frames {blocks[0][0]} to {blocks[0][-1]}:"
    return [*_frames_lines(role, time), part, *_recording_lines(recording.part(blocks[0]))]


def _frames_lines(role: NDArray[np.uint8], time: Array) -> list[str]:
    """How many frames, when, and whether there are too few a second to see breathing."""
    unloaded, measured = int(np.sum(role == UNLOADED)), int(np.sum(role == MEASURED))
    frames = f"frames    {len(role)}: {unloaded} unloaded, {measured} measured; {time.min():g} to {time.max():g} s"
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    slow = too_slow(1 / step) if step > 0 else ""
    return [frames, *([f"{'':9} {slow}"] if slow else [])]


def _recording_lines(recording: Recording) -> list[str]:
    circuit = recording.scene.circuit
    extras = {
        "σ": recording.sigma,
        "true cell resistance": recording.truth_cell_resistance,
        "true pressure": recording.truth_pressure,
        "sums of ADC codes": recording.raw_sums,
    }
    held = ", ".join(name for name, values in extras.items() if values is not None)
    return [
        *_frames_lines(recording.role, recording.time),
        *([] if recording.start_time is None else [f"start     {recording.start_time} at 0 s"]),
        *_scene_lines(recording.scene),
        *_noise_lines(recording),
        f"readings  {_range(recording.recorded, circuit.unit)} ({circuit.signal_name})",
        *(f"{'':9} {sentence}" for sentence in _holes(recording)),
        f"besides   {held or 'nothing'}",
        *_map_lines(recording),
    ]


def _map_lines(recording: Recording) -> list[str]:
    """The frame that changed most against the unloaded ones; numbers of the first one where there are none."""
    found = strongest_readings(recording)
    if found is None:
        return [f"readings of frame 0 in {recording.scene.circuit.unit}:", *text_map(recording.recorded[0])]
    where = f"frame {found[0]} at {recording.time[found[0]]:g} s"
    return [f"readings of {where}, the strongest change against the unloaded ones:", *shaded_map(found[1])]


def _noise_lines(recording: Recording) -> list[str]:
    """Which lines seem to touch that the scene does not name, and what the frames alone say of their noise."""
    lines = []
    with suppress(InputError):  # said where an estimate is asked for; a look at the file is free
        readings, faults = recording.readings(), recording.scene.faults or Faults()
        for name, known, found in (
            ("rows", faults.joined_rows, touching_rows(readings)),
            ("columns", faults.joined_columns, touching_columns(readings)),
        ):
            lines += [
                f"alike     {name} {', '.join(map(str, group))} in every frame: if they touch, faults: "
                f"{{joined_{name}: [{list(group)}]}} says so"
                for group in found
                if not any(set(group) <= set(one) for one in known)
            ]
    with suppress(InputError):
        learned = frame_noise_seen(recording).learned
        lines += [f"noise     {_plain(learned)}"] if learned else []
        lines += [f"warning   {_plain(one)}" for one in warnings_of(recording)]
    return lines


def _listed(panel: Panel) -> str:
    """Of a panel whose cells are listed, how many there are and over what they lie."""
    if panel.cells is None:
        return ""
    wide, tall = (most - least for least, most in panel.extents_mm)
    return f", {len(panel.cells)} cells at places of their own over {wide:g} × {tall:g} mm"


def _scene_lines(scene: Scene) -> list[str]:
    panel, wire, heat, faults = scene.panel, scene.lines, scene.temperature, scene.faults
    off = scene.specified_systematic
    texts: list[tuple[str, object]] = [
        ("panel", f"{panel.rows} rows × {panel.columns} columns{_listed(panel)}, pitch {panel.pitch_mm:g} mm"),
        ("readout", "unknown, resistances alone" if scene.readout is None else scene.readout.description()),
        ("assumed", scene.assumed and f"{scene.assumed_text}: the scene does not say"),
        ("series", scene.circuit.unit == "ohm" and scene.series_text),
    ]
    if wire is not None:
        rows = f"rows {wire.row_ohm_per_cell:g} ohm a cell, entering at the {wire.rows_enter}"
        columns = f"columns {wire.column_ohm_per_cell:g} ohm a cell, leaving at the {wire.columns_leave}"
        texts.append(("lines", f"{rows}; {columns}"))
    if scene.contacts is not None:
        sides = (("rows", scene.contacts.rows), ("columns", scene.contacts.columns))
        known = "; ".join(f"{name} {lines_text(side.mean_ohm)} ± {lines_text(side.sd_ohm)}" for name, side in sides)
        texts.append(("contacts", known))
    if scene.converter_memory is not None:
        texts.append(("memory", f"{100 * scene.converter_memory:g} % of the channel converted before"))
    if off is not None:
        channels = f"channels by {off.channel_spread_ohm:g} ohm"
        texts.append(("together", f"off by up to {100 * off.reference_tolerance:g} %, {channels}"))
    if scene.water is not None:
        texts.append(("water", f"{scene.water.top_row_depth_mm:g} mm above the top row"))
    if heat is not None:
        celsius = f"{heat.baseline_celsius:g} °C unloaded, {heat.measured_celsius:g} °C measured"
        texts.append(("film", f"{100 * heat.coefficient_per_kelvin:g} % per kelvin, {celsius}"))
    texts += [
        ("response", scene.response and _response_text(scene.response)),
        ("film", scene.film and _film_text(scene.film)),
    ]
    if faults is not None:
        known = ", ".join(f"{name.replace('_', ' ')} {list(value)}" for name, value in vars(faults).items() if value)
        texts.append(("faults", known or "none"))
    return [f"{head:9} {text}" for head, text in texts if text]


def _response_text(response: Response) -> str:
    """'table, -10 to 40 kPa; gains of cells 0.85 to 1.2'."""
    least, most = response.told_kpa
    text = f"{getattr(response, 'kind', type(response).__name__)}, {least:g} to {most:g} kPa"
    if response.gain is not None:
        text += f"; gains of cells {response.gains.min():.2g} to {response.gains.max():.2g}"
    return text


def _film_text(film: Film) -> str:
    """What it does beside its response curve, in words."""
    shares = (("hysteresis", film.hysteresis, ""), ("creep", film.creep_per_decade, " for each decade"))
    parts = [
        f"{name} not known" if value == "auto" else f"{name} {100 * value:g} %{each}" for name, value, each in shares
    ]
    return ", ".join(parts + [f"bent by {film.curvature_per_m:g} / m"] * bool(film.curvature_per_m))


def _results_lines(results: Results) -> list[str]:
    lines = []
    for recording in results.recordings():
        cases = results.of(recording)
        first = cases[0]
        frames, rows, columns = first.measured.shape
        truth = "not in" if first.truth is None else "in"
        lines += [
            f"recording {recording}: {frames} frames, {first.time.min():g} to {first.time.max():g} s, "
            f"{rows} rows × {columns} columns, pitch {first.scene.panel.pitch_mm:g} mm, truth {truth} the file",
            f"readings  {_range(first.measured, first.scene.circuit.unit)} "
            "(as the network is read, series resistance taken off)",
            *(f"{'':9} {sentence}" for sentence in (_holes_of_case(first),) if sentence),
        ]
        if first.model_mark and first.model_sentence not in first.warnings:
            lines.append(f"model     {first.model_mark}: {first.model_sentence}")
        lines += [f"warning   {_plain(one)}" for one in first.warnings.split("\n") if one]
        if first.film_sentence:
            lines.append(f"film      {first.film_sentence}")
        lines += [f"noise     {_plain(first.noise_learned)}"] if first.noise_learned else []
        width = max(len(case.estimator) for case in cases)
        for case in cases:
            lines.append(
                f"  {case.estimator:{width}}  solved {int(np.sum(case.solved))}/{frames}{_starts(case)}  "
                f"r {_range(case.cell_resistance, 'ohm')}  case {case.case_id}"
            )
            if case.error_words:
                lines.append(f"  {'':{width}}  {case.error_words} (standard deviations, medians)")
    if results.published:
        lines.append(f"published figures of {', '.join(results.published)}")
    for case in results.cases[:1]:
        place = strongest_index([case])
        where = f"frame {case.frame[place]} at {case.time[place]:g} s"
        lines.append(f"cells of {case.recording} × {case.estimator} in {where}, change against the unloaded panel:")
        lines += shaded_map(case.relative_change[place])
    return lines


def _plain(sentence: str) -> str:
    """As a screen shows what files hold in ASCII."""
    return sentence.replace("+-", "±")


def _starts(case: CaseResult) -> str:
    """'', or of how many starts the estimates of the solved frames are the lowest local optimum."""
    if case.local_optima is None:
        return ""
    _, least, most = case.local_optima
    if most == 1:
        return ", local optima from one start a frame"
    return f", local optima, the lowest from {least if least == most else f'{least} to {most}'} starts a frame"


def _holes(recording: Recording) -> list[str]:
    """What is missing or only a bound, readings of faulty cells aside, and what follows from it."""
    readings = recording.readings()
    sentences = [holes_sentence(readings.missing(recording.scene), readings.bounds)]
    enough = readings.enough(recording.scene)
    if not np.all(enough):
        sentences.append(f"{int(np.sum(~enough))} of {len(enough)} frames have too few values to be estimated")
    unloaded = recording.role == UNLOADED
    if np.any(unloaded) and np.any(enough) and not readings[unloaded].mean().enough(recording.scene):
        sentences.append("the unloaded frames have too few values: the first frame with enough stands for them")
    return [sentence for sentence in sentences if sentence]


def _holes_of_case(case: CaseResult) -> str:
    """Of the measured frames. Results that do not say which readings are bounds have none."""
    missing = np.isnan(case.measured) & case.scene.asked
    bounds = np.zeros(missing.shape, bool) if case.reading_side is None else case.reading_side != 0
    return holes_sentence(missing, bounds)


def holes_sentence(missing: NDArray[np.bool_], bounds: NDArray[np.bool_]) -> str:
    """`12 readings missing (0.4 %), 30 at a rail, zero or below the series resistance (1 %), in 7 of 40 frames`.

    missing, bounds : (frames, rows, columns). Lines that have no reading are named. Empty where every one is a value.
    """
    kinds = (missing, "missing"), (bounds, "at a rail, zero or below the series resistance")
    counts = [(int(np.sum(kind)), words) for kind, words in kinds if np.any(kind)]
    if not counts:
        return ""
    parts = [f"{count} {words} ({float(f'{100 * count / missing.size:.2g}'):g} %)" for count, words in counts]
    parts[0] = parts[0].replace(" ", " reading " if counts[0][0] == 1 else " readings ", 1)
    frames = int(np.sum((missing | bounds).any(axis=(1, 2))))
    empty = (("row", missing.all(axis=(0, 2))), ("column", missing.all(axis=(0, 1))))
    lines = [f"{name} {number}" for name, blank in empty for number in np.flatnonzero(blank)]
    none = f"; {' and '.join(lines)} {'has' if len(lines) == 1 else 'have'} none" if lines else ""
    return f"{', '.join(parts)}, in {frames} of {len(missing)} frames{none}"


def understood_lines(recording: Recording, notes: Sequence[str]) -> list[str]:
    """The sentences of an import, and a map of mean readings, which shows rows and columns that were swapped."""
    return [*notes, f"mean reading in {recording.scene.circuit.unit}:", *text_map(mean_reading(recording.recorded))]


def _range(values: Array, unit: str) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g} {unit}" if known.size else "unknown"


def checked_sentence(path: Path) -> str:
    """Reads all of a file, and says what vouches for it.

    Raises InputError where a dataset is not what was written, with its path, or the file cannot be read.
    """
    with hdf5.existing_file(path) as file:
        form = hdf5.read_attribute(file, "/", "lampest_format")
    size, datasets = hdf5.checked(path)
    if form == FORMAT:
        for _ in read_each(path, WHOLE):
            pass
    elif form == RECORDING or not datasets:
        recording = opened(path)
        if isinstance(recording, StoredRecording):
            for part in recording.blocks():
                recording.part(part)
    return f"{path}: {SEALED.format(bytes=size, datasets=datasets) if datasets else UNSEALED}"


def text_map(values: Array) -> list[str]:
    """A matrix (rows, columns) as numbers, row 0 on top and columns to the right; what is cropped is said below."""
    columns = values.shape[1]
    texts = [["-" if np.isnan(value) else f"{value:.4g}" for value in row] for row in values[:MOST_ROWS]]
    width = max(len(text) for text in (*(text for row in texts for text in row), str(columns - 1))) + 2
    labels = ["column", *(f"row {row}" for row in range(len(texts)))]
    left = max(map(len, labels))
    fitting = max(1, (_room() - left) // width)
    lines = [
        f"{label:>{left}}" + "".join(f"{text:>{width}}" for text in line[:fitting])
        for label, line in zip(labels, [list(map(str, range(columns))), *texts], strict=True)
    ]
    return lines + _cropped(values, len(texts), min(fitting, columns))


def shaded_map(change: Array) -> list[str]:
    """Changes (rows, columns) in percent as shades, row 0 on top and columns to the right.

    Falls are blocks, rises signs; each reaches its full shade at the largest of its own. A cell is two signs wide where
    that leaves room for all columns, else one.
    """
    rows, columns = change.shape
    label = max(3, len(str(rows - 1)) + 1)
    wide = 2 if 2 * columns + label <= _room() else 1
    fitting = min(columns, (_room() - label) // wide)
    known = np.where(np.isfinite(change), change, 0.0)
    most = [max(float(np.max(sign * known)), 1.0) for sign in (-1, 1)]  # changes from noise alone stay white
    steps = [
        np.clip(np.rint(4 * part / end), 0, 4).astype(int) for part, end in zip((-known, known), most, strict=True)
    ]
    signs = np.where(steps[0] > 0, np.array(list(FALLS))[steps[0]], np.array(list(RISES))[steps[1]])
    signs = np.where(np.isfinite(change), signs, UNKNOWN)
    lines = [
        f"{row:>{label - 1}} " + "".join(wide * str(sign) for sign in line[:fitting])
        for row, line in enumerate(signs[:MOST_ROWS])
    ]
    keys = [
        f"{name} {' '.join(f'{sign} {end * part / 4:.3g} %' for part, sign in enumerate(shades) if part)}"
        for name, shades, end, sign in (("falls by", FALLS, most[0], -1), ("rises by", RISES, most[1], 1))
        if np.max(sign * known) >= 0.125
    ]
    keys += [f"{UNKNOWN} no value"] if not np.all(np.isfinite(change)) else []
    return [
        *(line.rstrip() for line in lines),
        "; ".join(keys) or "nothing changes",
        *_cropped(change, len(lines), fitting),
    ]


def _room() -> int:
    return max(shutil.get_terminal_size((100, 24)).columns, 20)  # where no terminal says how many signs it has


def _cropped(values: Array, rows: int, columns: int) -> list[str]:
    if (rows, columns) == values.shape:
        return []
    return [f"(the first {rows} of {values.shape[0]} rows and {columns} of {values.shape[1]} columns)"]
