"""What the electronics make of cells: their circuit, multiplexers, converter → recorded readings."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.panel.memory import with_memory
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.lines import of_side
from lampest.panel.readouts.wiring import Contacts
from lampest.panel.scene import Scene
from lampest.recording.simulation.unmodelled import Unmodelled, disturbed, random_stream, static_factors, with_wire

AT_ONCE = 64
MOST_RAW = np.iinfo(np.uint16).max


def measured(
    scene: Scene,
    cells: Array,
    unmodelled: Unmodelled,
    seed: int,
    period_s: float = 1.0,
    scanned: Sequence[Array] = (),
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[Array, NDArray[np.int64] | None]:
    """(recorded readings, Σ code): what the readout's equation gives, and the sums of the converter's codes.

    Both (frames, rows, columns). Readings come from the mean code with the nominal reference; the codes from the true
    one. Without a readout readings are exact and there are no sums.

    cells : (frames, rows, columns) ohm. period_s : between frames.
    scanned : for loads that travel, the cells while each line is read, in order.
    on_frame : called after each frame was converted.
    Raises ValueError where the spread of the channels leaves a reading without positive resistance.
    """
    if scene.panel.modules is not None:
        return _of_modules(scene, scene.panel.modules, cells, unmodelled, seed, period_s, scanned, on_frame)
    off = unmodelled.reference_tolerance * random_stream(seed, "reference").uniform(-1, 1)
    actual = scene.circuit.off_by(off)
    if scene.contacts is not None:
        scene = replace(scene, contacts=true_contacts(scene, seed))
    if unmodelled.wire_ohm_per_cell:
        scene = replace(scene, lines=with_wire(scene, unmodelled.wire_ohm_per_cell))
    channels = channel_errors(scene, unmodelled, seed)
    total = _line_by_line([actual.simulated(part, scene, *channels) for part in scanned or [cells]], actual.by_columns)
    if unmodelled.reading_error:
        total = total * static_factors(unmodelled.reading_error, scene.panel.shape, seed)
    if actual.unit == "ohm" and not np.all(total > 0):
        raise ValueError("unmodelled.channel_spread_ohm makes a resistance negative; give a series resistance above it")
    if scene.readout is None:
        return total, None
    if scene.converter_memory is not None:
        volt = with_memory(actual, scene.converter_memory, actual.volt_from_recorded(total))
        total = actual.recorded_from_volt(volt)
    if unmodelled.disturbs:
        volt = disturbed(actual, actual.volt_from_recorded(total), unmodelled, seed, period_s)
        total = actual.recorded_from_volt(volt)
    sums = sums_of_codes(actual, total, unmodelled, seed, on_frame)
    return scene.readout.recorded_from_sums(sums, scene.readout.readings), sums


def _of_modules(
    scene: Scene,
    layout: Modules,
    cells: Array,
    unmodelled: Unmodelled,
    seed: int,
    period_s: float,
    scanned: Sequence[Array],
    on_frame: Callable[[], None],
) -> tuple[Array, NDArray[np.int64] | None]:
    """The same of a panel of modules, each with random numbers of its own; NaN where one is dead."""
    recorded, sums = [], []
    for number, own in enumerate(scene.of_modules):
        inside = (..., *layout.cells(number))
        drawn = int(random_stream(seed, f"module {number}").integers(2**63))
        parts = [part[inside] for part in scanned]
        values, codes = measured(own, cells[inside], unmodelled, drawn, period_s, parts)
        recorded.append(np.full_like(values, np.nan) if number in scene.dead_modules else values)
        sums.append(codes)
    for _ in cells:
        on_frame()
    codes_of_all = None if any(part is None for part in sums) else layout.joined(np.stack(sums, axis=-3))  # type: ignore[arg-type]
    return layout.joined(np.stack(recorded, axis=-3)), codes_of_all


def _line_by_line(passes: Sequence[Array], by_columns: bool) -> Array:
    """Readings (frames, rows, columns) of which each line was read in its own pass; one pass: all lines."""
    if len(passes) == 1:
        return passes[0]
    axis = 2 if by_columns else 1
    return np.stack([part.take(line, axis) for line, part in enumerate(passes)], axis=axis)


def true_contacts(scene: Scene, seed: int) -> Contacts:
    """Contacts drawn as the scene says what is known of them; none is below zero."""
    contacts, shape = scene.contacts or Contacts(), scene.panel.shape
    normal = random_stream(seed, "contacts").standard_normal(sum(shape))
    ohm = np.maximum(contacts.mean(shape) + contacts.deviation(shape) * normal, 0.0)
    return Contacts.of(ohm, np.zeros(len(ohm)), shape[0])


def channel_errors(scene: Scene, unmodelled: Unmodelled, seed: int) -> tuple[Array, Array]:
    """Series resistance beyond the scene's: (rows) and (columns) ohm, δ_j of rows and δ_k of columns.

    The series resistance that the scene is silent about stands on the driven side.
    """
    rows, columns = scene.panel.shape
    channel = unmodelled.channel_spread_ohm * random_stream(seed, "channels").standard_normal(rows + columns)
    driven, sensed = of_side(scene.circuit.noisy_side, channel[:rows], channel[rows:])
    row_ohm, column_ohm = of_side(scene.circuit.noisy_side, unmodelled.series_resistance_ohm + driven, sensed)
    return row_ohm, column_ohm


def sums_of_codes(
    readout: Readout, total: Array, unmodelled: Unmodelled, seed: int, on_frame: Callable[[], None] = lambda: None
) -> NDArray[np.int64]:
    """Σ over the readings of code(V + noise), recorded readings (frames, rows, columns) → 1; outliers are random."""
    noise, outliers = random_stream(seed, "noise"), random_stream(seed, "outliers")
    sigma = readout.noise_volt() * (1.0 if unmodelled.noise_factor is None else unmodelled.noise_factor)
    sums = np.empty(total.shape, dtype=np.int64)
    for frame, volt in enumerate(readout.volt_from_recorded(total)):
        sums[frame] = 0
        for first in range(0, readout.readings, AT_ONCE):
            shape = (min(AT_ONCE, readout.readings - first), *volt.shape)
            codes = readout.code_from_volt(volt + sigma * noise.standard_normal(shape))
            if unmodelled.outlier_probability > 0:
                hit = outliers.random(shape) < unmodelled.outlier_probability
                codes = np.where(hit, outliers.integers(0, 2**readout.adc_bits, shape), codes)
            sums[frame] += codes.sum(axis=0)
        on_frame()
    return sums


def raw_sums(readout: Readout | None, sums: NDArray[np.int64] | None) -> NDArray[np.uint16] | None:
    """The sums as a recording holds them; None where readings · (2^bits − 1) does not fit into 16 bits."""
    if readout is None or sums is None or readout.readings * (2**readout.adc_bits - 1) > MOST_RAW:
        return None
    return sums.astype(np.uint16)
