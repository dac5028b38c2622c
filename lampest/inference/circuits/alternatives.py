"""Alternative circuits of a recording, and the frames that they have to explain.

Alternatives are circuits of the one equation with the scene's converter and resistor
(`lampest.inference.circuits.kinds`), and the scene's circuit with readings in another order or with
another converter. Each has any resistance in series. All alternatives share the converter's
voltages: where the scene's circuit has computed resistances from them, that computation is
inverted.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.files.levels import FALSE_ALARM_RATE, OUTLIER_THRESHOLD
from lampest.inference.circuits.kinds import (
    HELD_OHM,
    circuits_beside,
    entries_in_words,
    entries_of,
    open_number_of,
    with_potentials,
)
from lampest.panel.lines import SeriesPerLine, opposite
from lampest.panel.panel import Array, Numbers
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import Characteristic
from lampest.panel.readouts.scan_order import by_columns
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, MIN_CHANGE, UNLOADED

USUAL_BITS = (8, 10)  # of converters that are described with more: of an ATmega, and half of it
ESP32_BITS = 12  # of the ADC of an ESP32 (its technical reference manual, chapter on the SAR ADC)
BY_COLUMNS = "readings listed column by column (lampest import --transpose)"
# Largest noise of a resistance with which the divider's function of Gaussian voltages is still
# nearly Gaussian, as a fraction. Largest shift of a mean by the same curvature, in its standard
# deviations.
MAX_RELATIVE_NOISE = 0.05
MAX_SHIFT = 0.1


@dataclass(frozen=True, eq=False)
class Alternative:
    """A circuit that may have made a recording.

    Attributes
    ----------
    scene : Scene
        The recording's scene with this circuit.
    recorded : array, shape (frames, rows, columns)
        Values that this circuit would have recorded from the same codes.
    sigma : array or None
        Standard deviations of the recorded values, where the recording has its own; None: those of
        the readout.
    kind : str
        The kind in words; '' for the specified circuit.
    entries : mapping
        Entries of a scene by which it differs from the specified one, without a resistance in
        series and the order of the readings.
    in_series : float or None
        The tried resistance in series, ohm; None: that of the scene.
    at_limit : bool
        Whether this number is at the end of its range, where it is no finding.
    order : array of int, or None
        Numbers of the recorded readings, rows first, in the order in which this alternative takes
        them; None: as recorded.
    number : str
        The setting of the readout whose value is to be estimated, ohm; ''.
    """

    scene: Scene
    recorded: Array
    sigma: Array | None
    kind: str = ""
    entries: Mapping[str, Any] = field(default_factory=dict)
    in_series: float | None = None
    at_limit: bool = False
    order: Numbers | None = None
    number: str = ""

    @property
    def name(self) -> str:
        """Circuit in the words of a scene.

        The value is '' for the specified one, also with a number at its limit.
        """
        if self.in_series is None or self.at_limit:
            return self.kind
        series = f"{self.scene.series_name} near {float(f'{self.in_series:.2g}'):g}"
        return f"{self.kind}, {series}" if self.kind else series

    @property
    def addition(self) -> dict[str, Any]:
        """Entries that make the specified scene one of this circuit, numbers with two digits.

        No entry states another order of the readings: the mapping is then empty.
        """
        if self.order is not None:
            return {}
        entries = dict(self.entries)
        circuit = self.scene.circuit
        if self.in_series is not None and not self.at_limit:
            series = {self.scene.series_name: float(f"{self.in_series:.2g}")}
            entries |= (
                series
                if circuit.unit == "ohm"
                else {"readout": {**entries.get("readout", {}), **series}}
            )
        return entries

    @property
    def ohm(self) -> float:
        """The resistance in series, ohm: the tried one, or that of the scene."""
        return self.scene.specified_in_series if self.in_series is None else self.in_series

    def with_memory(self, fraction: float) -> "Alternative":
        """Return the alternative with a converter that keeps a fraction of the channel before."""
        named = f"converter_memory near {fraction:.2g}"
        return replace(
            self,
            scene=replace(self.scene, converter_memory=fraction),
            kind=f"{self.kind}, {named}" if self.kind else named,
            entries={**self.entries, "converter_memory": float(f"{fraction:.2g}")},
        )

    def with_number(self, ohm: float) -> "Alternative":
        """Return the alternative with another value of its open number, ohm."""
        specified: Any = self.scene.readout
        readout = replace(specified, **{self.number: ohm})
        entries = {**self.entries["readout"], self.number: float(f"{ohm:.2g}")}
        return replace(
            self,
            scene=replace(self.scene, readout=readout),
            kind=entries_in_words(entries),
            entries={"readout": entries},
        )

    @property
    def with_tried_numbers(self) -> "Iterator[Alternative]":
        """The alternative with every tried value of its open number; itself without one."""
        yield self
        yield from map(self.with_number, HELD_OHM[1:] if self.number else ())

    def ordered(self, values: Array) -> Array:
        """Return recorded readings (…, rows, columns) in the order of this alternative."""
        if self.order is None:
            return values
        return np.asarray(
            values.reshape(*values.shape[:-2], -1)[..., self.order].reshape(values.shape)
        )

    def with_series(self, ohm: float) -> "Alternative":
        """Return the alternative with another resistance in series, ohm."""
        return replace(self, scene=self.scene.with_series(float(ohm)), in_series=float(ohm))

    @cached_property
    def readings(self) -> Readings:
        """Readings of all frames.

        Raises InputError where the circuit cannot have recorded the values.
        """
        return Readings.of(self.scene, self.recorded, self.sigma)

    def nearly_gaussian(self, frames: int) -> Array:
        """Return 1 where the noise of a recorded value is nearly Gaussian, else 0.

        Shape (all frames, rows, columns). Voltages are as Gaussian as the converter's noise.
        Resistances that were computed from them are nearly Gaussian while the noise is small.

        Parameters
        ----------
        frames : int
            Number of frames that are averaged.
        """
        sigma = self.readings.sigma
        if self.scene.circuit.unit != "ohm" or sigma is None:
            return np.ones(self.recorded.shape)
        # The curvature shifts a mean by about (σ/R)² R, which is √n σ/R standard deviations of a
        # mean of n frames.
        most = min(MAX_RELATIVE_NOISE, MAX_SHIFT / np.sqrt(frames))
        return np.where(sigma <= most * self.recorded, 1.0, 0.0)


def alternatives_of(specified: Alternative, *, reversed_too: bool = False) -> Iterator[Alternative]:
    """Generate the alternatives: all variants of every kind but the specified circuit.

    Parameters
    ----------
    specified : Alternative
    reversed_too : bool
        Whether to include circuits under which the readings decrease with a load where those of the
        specified circuit increase.
    """
    scene = specified.scene
    readout = specified.scene.readout
    if readout is None:
        return
    volt = readout.volt_from_recorded(specified.recorded)
    apparent = _logarithm(readout, scene, specified.recorded)
    # With potentials a reading may rise and fall with its cell, so that no sense is known
    of_potentials = tuple(with_potentials(readout, scene))
    for circuit in (*of_potentials, *circuits_beside(readout, scene)):
        if circuit == readout:
            continue
        with suppress(ValueError):  # the kind may have no model of the panel, or of another entry
            alike = type(circuit) is type(readout) and circuit.unit == "ohm"
            series = scene.series_resistance_ohm if alike else 0.0
            alternative = replace(
                scene, readout=circuit, series_resistance_ohm=series, systematic=None
            )
            values = circuit.recorded_from_volt(volt)
            sense = _sense(apparent, _logarithm(circuit, scene, values))
            if circuit in of_potentials or sense > 0 or (reversed_too and sense < 0):
                entries = entries_of(circuit, readout)
                yield Alternative(
                    alternative,
                    values,
                    specified.sigma if circuit.unit == readout.unit else None,
                    entries_in_words(entries),
                    {"readout": entries},
                    number=open_number_of(circuit),
                )
    yield from _listed_by_columns(specified, readout)


def rounded_down(specified: Alternative) -> Alternative | None:
    """Return the specified circuit with a converter that rounds down: code c is c + ½ steps.

    Such codes stand half a step too low. None where the scene states the converter.
    """
    readout = specified.scene.readout
    if readout is None or readout.converter is not None:
        return None
    half = readout.lsb_volt / 2
    ends = Characteristic(zero_volt=half, full_volt=readout.full_scale_volt + half)
    kind = f"readout.converter.zero_volt near {half:.2g} (codes are rounded down)"
    entry = {"converter": {"zero_volt": float(f"{half:.2g}")}}
    return with_converter(specified, kind, entry, converter=ends)


def in_other_scan_order(specified: Alternative) -> Iterator[Alternative]:
    """Generate the specified circuit with readings taken in the other order.

    Only a memory of the converter distinguishes it from the specified one. None is generated where
    the scene states the order.
    """
    readout: Any = specified.scene.readout
    if readout is None or readout.scan_order is not None or specified.scene.panel.modules:
        return
    order = "rows" if by_columns(readout) else "columns"
    yield replace(
        specified,
        scene=replace(specified.scene, readout=replace(readout, scan_order=order)),
        kind=f"readout.scan_order: {order}",
        entries={"readout": {"scan_order": order}},
    )


def other_converters(specified: Alternative, *, reversed_too: bool) -> Iterator[Alternative]:
    """Generate the specified circuit with converters of another range or of fewer bits.

    None are generated where the scene states the converter. An esp32 is tried for readings of 12
    bits, an inverting amplifier where readings may fall with a load (`reversed_too`), and fewer
    bits where no code lies beyond them.
    """
    readout = specified.scene.readout
    if readout is None or readout.converter is not None:
        return
    names = ["inverting amplifier"] if reversed_too else []
    names += ["esp32"] if readout.adc_bits == ESP32_BITS else []
    for name in names:
        kind = f"readout.converter: {name}"
        yield with_converter(specified, kind, {"converter": name}, converter=name)
    codes = readout.steps_from_volt(readout.volt_from_recorded(specified.recorded))
    for bits in USUAL_BITS:
        if bits < readout.adc_bits and np.max(codes, where=np.isfinite(codes), initial=0) < 2**bits:
            kind = f"readout.adc_bits: {bits}"
            yield with_converter(specified, kind, {"adc_bits": bits}, adc_bits=bits)


def with_converter(
    specified: Alternative, kind: str, entry: Mapping[str, Any], **settings: Any
) -> Alternative:
    """Return the specified circuit whose codes stand for other voltages.

    `entry` states the settings of its converter in a scene.
    """
    readout: Any = specified.scene.readout
    circuit = replace(readout, **settings)
    codes = readout.steps_from_volt(readout.volt_from_recorded(specified.recorded))
    return replace(
        specified,
        scene=replace(specified.scene, readout=circuit),
        recorded=circuit.recorded_from_volt(circuit.volt_from_code(codes)),
        kind=kind,
        entries={"readout": entry},
    )


def _listed_by_columns(specified: Alternative, readout: Any) -> Iterator[Alternative]:
    """Generate the specified circuit with readings that a file lists column by column.

    The scene's rows may be those of the file, too: the other side of its lines is driven then. None
    are generated where a crossing has no reading, or where the order is the same.
    """
    scene = specified.scene
    rows, columns = scene.panel.shape
    if not scene.whole or scene.panel.modules is not None or min(rows, columns) == 1:
        return
    side = getattr(readout, "driven", None)
    told = getattr(readout, "groups", None) or scene.wiring is not None or side is not None
    if rows == columns and not told and not isinstance(scene.series_resistance_ohm, SeriesPerLine):
        return  # a relabelling
    order = np.arange(rows * columns).reshape(columns, rows).T.ravel()
    reordered = replace(specified, order=order)
    sigma = None if specified.sigma is None else reordered.ordered(specified.sigma)
    recorded = reordered.ordered(specified.recorded)
    reordered = replace(reordered, recorded=recorded, sigma=sigma, kind=BY_COLUMNS)
    yield reordered
    if side is None:
        return
    kind = f"{BY_COLUMNS}, readout.driven: {opposite(side)}"
    with suppress(ValueError):
        exchanged = replace(readout, driven=opposite(side))
        yield replace(
            reordered, scene=replace(scene, readout=exchanged, systematic=None), kind=kind
        )


def _logarithm(circuit: Readout, scene: Scene, recorded: Array) -> Array:
    """Return ln of the apparent resistances; NaN where the circuit cannot have the values."""
    with suppress(InputError, ValueError), np.errstate(all="ignore"):
        return np.asarray(
            np.log(circuit.apparent_resistance(circuit.from_recorded(recorded, scene)))
        )
    return np.full(recorded.shape, np.nan)


def _sense(first: Array, second: Array) -> float:
    """Return the sign of the covariance of two sets of log resistances.

    The sign is positive if a load moves both in one direction. Values that are not finite are
    ignored; without any other the result is 0.
    """
    finite = np.isfinite(first) & np.isfinite(second)
    deviation = second[finite] - second[finite].sum() / max(finite.sum(), 1)
    return float(first[finite] @ deviation)


@np.errstate(all="ignore")
def changes_beyond_noise(scene: Scene, readings: Readings, role: NDArray[np.uint8]) -> Array:
    """Return ln(R/R_unloaded) of the apparent resistances; 0 where insignificant.

    Shape (measured frames, rows, columns).
    """
    unloaded = role == UNLOADED
    measured = role == MEASURED
    if not unloaded.any() or not measured.any() or readings.sigma is None:
        return np.zeros((0, *scene.panel.shape))
    resting = readings[unloaded].mean().value
    values = readings[measured].plain_values
    change = np.log(
        scene.circuit.apparent_resistance(values) / scene.circuit.apparent_resistance(resting)
    )
    # a change counts if it exceeds six standard deviations of the reading and MIN_CHANGE
    beyond = (np.abs(values - resting) > OUTLIER_THRESHOLD * readings.sigma[measured]) & (
        np.abs(change) > MIN_CHANGE
    )
    return np.where(beyond, change, 0.0)


def standing_frames(readings: Readings, frame: int, candidates: Numbers, noise: float) -> Numbers:
    """Return the frames that are equal to one frame within their noise, to be averaged.

    Parameters
    ----------
    readings : Readings
        (frames, rows, columns).
    frame : int
        The number of the frame; it is always included.
    candidates : integer array
        Numbers of the frames that are compared with it.
    noise : float
        Factor on every σ.
    """
    plain = readings.plain & readings.plain[frame]
    sigma = readings.known_sigma
    spread = noise * np.hypot(sigma, sigma[frame])
    # χ² of the difference of two frames, Σ (y − y₀)²/(σ² + σ₀²)
    square = np.where(plain, (readings.value - readings.value[frame]) / spread, 0.0) ** 2
    similar = (
        chi_square_tail(square.sum(axis=(1, 2)), np.maximum(plain.sum(axis=(1, 2)), 1))
        >= FALSE_ALARM_RATE
    )
    standing: Numbers = candidates[similar[candidates] | (candidates == frame)]
    return standing
