"""Simulated electronics from cells to readings.

The simulation includes circuit, multiplexers, converter, and effects outside the scene.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.applications import loaded
from lampest.files.document import INLINE
from lampest.files.typed import (
    Extensible,
    check_not_negative,
    check_positive_fields,
    check_range,
    check_ranges,
)
from lampest.panel.effects import LISTED_SHARED, shared_effect_of
from lampest.panel.lines import of_side
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts import Readout
from lampest.panel.readouts.channel_memory import with_memory
from lampest.panel.readouts.converter import noise_volt
from lampest.panel.readouts.scan_order import in_panel_order
from lampest.panel.readouts.tolerances import simulated
from lampest.panel.readouts.wiring import Contacts
from lampest.panel.scene import Scene
from lampest.panel.sizes import LINE_EFFECTS, LISTED, LISTED_AT_LINES, added_effects, has_file

# limits of true cells: a strip of copper tape, and the insulation between two lines
SHORT_OHM = 1e-3
OPEN_OHM = 1e12
# Entry of `unmodelled` → its effect, 'module:class'.
OF_EFFECTS = {
    effect.at_converter[0]: effect.path
    for effect in (*LISTED, *LISTED_AT_LINES)
    if effect.at_converter
}


@dataclass(frozen=True)
class Unmodelled(Extensible):
    """Effects in the data that the recording's scene does not contain. Zero or None: absent.

    Attributes
    ----------
    series_resistance_ohm : float
        Series resistance in addition to the scene's.
    channel_spread_ohm : float
        Standard deviation of the on-resistance of a multiplexer's channels, one for each line.
    reference_tolerance : float
        Largest relative error of the reference resistor, drawn uniformly.
    drift_per_minute : float
        Standard deviation of the drift rates of cells, of the logarithm of their resistance.
    common_drift_per_minute : float, or None
        Drift rate of all cells, in addition.
    leak_ohm : float, or None
        Resistance between each line and the next one.
    ground_ohm : float, or None
        Resistance to ground that all idle driven lines share.
    contact_ohm : float, or None
        Additional resistance in series with one row, which is drawn.
    begins_s : float, or None
        Time after the first frame at which leak and contact begin; None: 0.
    saturation : float, or None
        Share of the supply at which a stage before the converter clips.
    outlier_probability : float
        Chance that one reading is a random code instead of a conversion.
    noise_factor : float, or None
        Factor on the scene's noise of one reading.
    supply_ripple_lsb, supply_ripple_hz : float, or None
        Amplitude and frequency of a sine at the converter, with a random phase in every frame.
        None: one period is as long as the scan of a line.
    gain_spread : float, or None
        Standard deviation of a factor on all voltages of a frame, drawn for every frame.
    load_speed_mm_s : float, or None
        Speed of loads along x, back and forth over TRAVEL_MM, also during a scan; the truth is that
        of the middle of the scan.
    inl_lsb : float, or None
        Largest, smooth deviation of the converter's curve from a straight line, in least
        significant bits.
    wire_ohm_per_cell : float, or None
        Resistance of rows and columns from cell to cell, in addition to the scene's, in ohm.
    reading_error : float, or None
        Standard deviation of the logarithm of a factor on each recorded reading, the same in all
        frames.
    response_loss : float, or None
        Fraction by which the film's response is smaller, in the logarithm of its resistance.
    response_spread : float, or None
        Standard deviation of the logarithm of a factor on each cell's response.
    own : tuple of (str, float)
        Sizes of further errors, those of installed packages; each is a key in a file.

    >>> lampest.Unmodelled(channel_spread_ohm=3.0).channel_spread_ohm
    3.0
    """

    series_resistance_ohm: float = 0.0
    channel_spread_ohm: float = 0.0
    reference_tolerance: float = 0.0
    drift_per_minute: float = 0.0
    outlier_probability: float = 0.0
    noise_factor: float | None = None
    supply_ripple_lsb: float | None = None
    supply_ripple_hz: float | None = None
    gain_spread: float | None = None
    load_speed_mm_s: float | None = None
    inl_lsb: float | None = None
    wire_ohm_per_cell: float | None = None
    reading_error: float | None = None
    response_loss: float | None = None
    response_spread: float | None = None
    common_drift_per_minute: float | None = None
    leak_ohm: float | None = None
    ground_ohm: float | None = None
    contact_ohm: float | None = None
    begins_s: float | None = None
    saturation: float | None = None
    own: tuple[tuple[str, float], ...] = field(default=(), metadata={INLINE: True})

    @classmethod
    def added_keys(cls) -> tuple[str, ...]:
        """Return the settings of shared effects that are no fields of `Systematic`."""
        return added_effects()

    def __post_init__(self) -> None:
        names = [entry.name for entry in fields(self) if entry.name != "own"]
        check_not_negative(self, *names)
        for name in names:
            path = LISTED_SHARED.get(name) or OF_EFFECTS.get(name)
            if path and getattr(self, name) and not has_file(path):
                raise ValueError(f"{name}: no installed effect has this key")
        for setting, size in self.own:
            check_range(setting, size, *shared_effect_of(setting).limits)
        check_ranges(self, 0, 1, "outlier_probability")
        check_ranges(self, 0, 0.999, "reference_tolerance", "response_loss")
        check_positive_fields(self, "leak_ohm")


def random_stream(seed: int, purpose: str) -> np.random.Generator:
    """Return a random generator for one purpose, independent of draws for others."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),))
    )


def measured(
    scene: Scene,
    cells: Array,
    unmodelled: Unmodelled,
    seed: int,
    period_s: float = 1.0,
    scanned: Sequence[Array] = (),
    on_frame: Callable[[], None] = lambda: None,
) -> tuple[Array, NDArray[np.int64] | None]:
    """Return recorded readings, and the sums of the converter's codes.

    Codes follow from the true reference resistor, readings from the mean code and the nominal one.
    Without a readout, readings are exact and there are no sums. Raises ValueError if the spread of
    the channels makes a resistance negative.

    Parameters
    ----------
    cells : array, shape (frames, rows, columns)
        True cells in ohm.
    period_s : float
        Time between frames in s.
    scanned : sequence of array
        For moving loads, the cells (frames, rows, columns) while each line is read, in order.
    on_frame : callable
        Called after each frame is converted.

    Returns
    -------
    recorded : array, shape (frames, rows, columns)
        Recorded readings.
    sums : array of int, shape (frames, rows, columns), or None
        Sums of the codes; None without a readout.
    """
    if scene.panel.modules is not None:
        for _ in cells:
            on_frame()
        return _measured_modules(
            scene, scene.panel.modules, cells, unmodelled, seed, period_s, scanned
        )
    actual, scene = _true_circuit(scene, unmodelled, seed)
    total = _exact_readings(actual, scene, unmodelled, seed, period_s, scanned or [cells])
    if scene.readout is None:
        return total, None
    volt = actual.volt_from_recorded(total)
    if scene.known_memory is not None:
        volt = with_memory(actual, scene.known_memory, volt)
    for listed in LISTED:
        sizes = [getattr(unmodelled, name) for name in listed.at_converter]
        if sizes and sizes[0]:
            effect = loaded(listed.path)()
            random = random_stream(seed, effect.stream)
            volt = effect.disturbed(actual, volt, random, period_s, *sizes)
    sums = sums_of_codes(actual, volt, unmodelled, seed, on_frame)
    mean_volt = scene.readout.volt_from_code(sums / scene.readout.readings)
    return scene.readout.recorded_from_volt(mean_volt), sums


def _exact_readings(
    actual: Readout,
    scene: Scene,
    unmodelled: Unmodelled,
    seed: int,
    period_s: float,
    scanned: Sequence[Array],
) -> Array:
    """Return readings before the converter, of moving loads line by line, each with its error."""
    passes = np.stack([_read(actual, scene, part, unmodelled, seed, period_s) for part in scanned])
    # Every reading is of the pass in which its line of the scan was read.
    crossings = scene.panel.crossings
    lines = np.repeat(np.arange(len(passes)), -(-crossings // len(passes)))[:crossings]
    read_in = in_panel_order(actual, lines.astype(float), scene.panel.shape).astype(int)
    total: Array = np.take_along_axis(passes, read_in[None, None], axis=0)[0]
    if unmodelled.reading_error:
        from lampest.panel.effects.reading_error import READING_ERROR  # for this key alone

        random = random_stream(seed, "readings")
        total *= READING_ERROR.drawn(scene.panel.shape, unmodelled.reading_error, random)
    if actual.unit == "ohm" and not np.all(total > 0):
        raise ValueError(
            "unmodelled.channel_spread_ohm makes a resistance negative; "
            "give a series resistance above it"
        )
    return total


def _measured_modules(
    scene: Scene,
    layout: Modules,
    cells: Array,
    unmodelled: Unmodelled,
    seed: int,
    period_s: float,
    scanned: Sequence[Array],
) -> tuple[Array, NDArray[np.int64] | None]:
    """Return recorded readings and sums of a panel of modules; see `measured`.

    Every module has its own random numbers. The readings of dead modules are NaN.
    """
    modules = []
    for number, module_scene in enumerate(scene.of_modules):
        inside = (..., *layout.cells(number))
        drawn = int(random_stream(seed, f"module {number}").integers(2**63))
        travelling = [part[inside] for part in scanned]
        own = cells[inside]
        modules.append(measured(module_scene, own, unmodelled, drawn, period_s, travelling))
    recorded = np.stack([values for values, _ in modules], axis=-3)
    recorded[..., list(scene.dead_modules), :, :] = np.nan
    codes = [sums for _, sums in modules if sums is not None]
    return layout.joined(recorded), layout.joined(np.stack(codes, axis=-3)) if codes else None


def _true_circuit(scene: Scene, unmodelled: Unmodelled, seed: int) -> tuple[Readout, Scene]:
    """Return the true circuit, and the scene with the true contacts and wire."""
    actual = scene.circuit
    if unmodelled.reference_tolerance:
        from lampest.panel.effects.reference import REFERENCE  # for this key alone

        random = random_stream(seed, "reference")
        actual = REFERENCE.drawn(actual, unmodelled.reference_tolerance, random)
    if scene.contact_prior is not None:
        scene = replace(scene, contacts=true_contacts(scene, seed))
    if unmodelled.wire_ohm_per_cell:
        from lampest.panel.effects.wire import WIRE  # for this key alone

        scene = WIRE.in_scene(scene, unmodelled.wire_ohm_per_cell)
    return actual, scene


def _read(
    actual: Readout, scene: Scene, cells: Array, unmodelled: Unmodelled, seed: int, period_s: float
) -> Array:
    """Return recorded readings of cells (frames, rows, columns) ohm, with leak and contact.

    The leak and the contact resistance begin at `unmodelled.begins_s`. Errors of installed packages
    are in all frames.
    """
    begin = int(np.ceil((unmodelled.begins_s or 0.0) / period_s))
    cells = np.where(scene.panel.present, cells, np.inf)
    channels = _channel_errors(scene, unmodelled, seed, late=False)
    recorded = simulated(actual, cells, scene, *channels)
    if unmodelled.contact_ohm:
        channels = _channel_errors(scene, unmodelled, seed, late=True)
        recorded[begin:] = simulated(actual, cells, scene, *channels)[begin:]
    at_lines = [
        loaded(listed.path).simulated(size, *scene.panel.shape)
        for listed in LINE_EFFECTS
        for size in (getattr(unmodelled, name) for name in listed.at_converter)
        if size
    ]
    named = any(isinstance(getattr(scene, listed.key), float) for listed in LINE_EFFECTS)
    if not (at_lines or named or unmodelled.own):
        return recorded
    from lampest.panel.effects.line_effect import effect_on_readings, stated_effects

    at_lines += stated_effects(scene)
    reading = actual.from_recorded(recorded, scene)
    for frame in range(len(cells)):
        network = actual.network(cells[frame], actual.ties(reading[frame]), scene.wiring)
        exact = reading[frame]
        present = [effect for effect in at_lines if frame >= begin or not effect.may_begin]
        reading[frame] = exact + effect_on_readings(present, scene, network)
        for setting, size in unmodelled.own:
            random = random_stream(seed, setting)
            drawn = shared_effect_of(setting).simulated(network, exact, scene, size, random)
            reading[frame] += drawn - exact
    return actual.to_recorded(reading, scene)


def true_contacts(scene: Scene, seed: int) -> Contacts:
    """Return contacts drawn from the scene's prior, truncated at zero, with deviations of zero."""
    contacts = scene.contact_prior or Contacts()
    shape = scene.panel.shape
    normal = random_stream(seed, "contacts").standard_normal(sum(shape))
    ohm = np.maximum(contacts.mean(shape) + contacts.deviation(shape) * normal, 0.0)
    return Contacts.of(ohm, np.zeros(len(ohm)), shape[0])


def _channel_errors(
    scene: Scene, unmodelled: Unmodelled, seed: int, *, late: bool
) -> tuple[Array, Array]:
    """Return the additional channel resistances of rows, (rows,), and of columns, (columns,), ohm.

    Unmodelled series resistance is added on the driven side. `late` adds the resistance of a bad
    contact.
    """
    rows, columns = scene.panel.shape
    channel = np.zeros(rows + columns)
    if unmodelled.channel_spread_ohm:
        from lampest.panel.effects.channels import CHANNELS  # for this key alone

        random = random_stream(seed, "channels")
        channel += CHANNELS.drawn(rows + columns, unmodelled.channel_spread_ohm, random)
    if late and unmodelled.contact_ohm:
        channel[int(random_stream(seed, "contact").integers(rows))] += unmodelled.contact_ohm
    driven, sensed = of_side(scene.circuit.noisy_side, channel[:rows], channel[rows:])
    return of_side(scene.circuit.noisy_side, unmodelled.series_resistance_ohm + driven, sensed)


def sums_of_codes(
    readout: Readout,
    volt: Array,
    unmodelled: Unmodelled,
    seed: int,
    on_frame: Callable[[], None] = lambda: None,
) -> NDArray[np.int64]:
    """Return Σ code(V + noise) over `readings` conversions of voltages V, (frames, rows, columns).

    Outliers are random codes.
    """
    noise = random_stream(seed, "noise")
    outliers = random_stream(seed, "outliers")
    factor = unmodelled.noise_factor
    sigma = noise_volt(readout) if factor is None else factor * noise_volt(readout)
    sums = np.zeros(volt.shape, dtype=np.int64)
    for frame, exact in enumerate(volt):
        for first in range(0, readout.readings, 64):  # 64 conversions at once
            shape = (min(64, readout.readings - first), *exact.shape)
            codes = readout.code_from_volt(exact + sigma * noise.standard_normal(shape))
            if unmodelled.outlier_probability > 0:
                hit = outliers.random(shape) < unmodelled.outlier_probability
                codes = np.where(
                    hit, outliers.integers(readout.codes[0], readout.codes[1] + 1, shape), codes
                )
            sums[frame] += codes.sum(axis=0)
        on_frame()
    return sums


def raw_sums(readout: Readout | None, sums: NDArray[np.int64] | None) -> NDArray[np.uint16] | None:
    """Return the sums as 16-bit integers for a recording, or None if they do not fit.

    The largest sum is `readings` times the highest code. Signed codes have negative sums.
    """
    if readout is None or sums is None:
        return None
    lowest, highest = readout.codes
    if lowest < 0 or readout.readings * highest >= 2**16:
        return None
    return sums.astype(np.uint16)
