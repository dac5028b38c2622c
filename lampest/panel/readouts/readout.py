"""Base of the readouts: a circuit that states how each line ends, and its converter.

A kind of readout is one file with its keys and one function from keys to ends, `terminations`. All
else follows from the ends: `lampest.panel.equation` has the equation of the readings,
`lampest.panel.readouts.starts` the cells at which solves begin,
`lampest.panel.readouts.starts` the bounds, and `lampest.panel.readouts.tolerances` the
errors of resistors and channels.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Completed, check_range, check_ranges
from lampest.panel.circuit import Terminations, nominal_terminations
from lampest.panel.equation import equation_of
from lampest.panel.lines import (
    PerLine,
    Side,
    along,
    as_tuple,
    check_lines,
    of_side,
    opposite,
    per_line,
)
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Numbers, Panel, Shape
from lampest.panel.readouts import starts
from lampest.panel.readouts.converter import (
    KNOWN_CONVERTERS,
    MAX_VOLT,
    MIN_VOLT,
    USUAL_NOISE_LSB,
    Characteristic,
    Known,
    KnownConverter,
    mean_sigma,
    relative_step,
    stated_characteristic,
)
from lampest.panel.readouts.floating import grounding, two_point_resistance
from lampest.panel.readouts.keys import check_keys, check_on_panel, entry
from lampest.panel.readouts.scan_order import check_scan_order
from lampest.panel.readouts.starts import USUAL_OHM
from lampest.panel.readouts.wiring import Wiring, connected_parts


class Surroundings(Protocol):
    """Interface of a scene for a readout."""

    @property
    def panel(self) -> Panel:
        """Panel that is read."""

    @property
    def series_ohm(self) -> Array:
        """Resistance in series with every reading, ohm, to be broadcast to (rows, columns)."""

    @property
    def series_lines(self) -> tuple[Array, Array]:
        """Resistance in series with each row, (rows,), and with each column, (columns,), ohm."""

    @property
    def wiring(self) -> Wiring | None:
        """Wire, contacts and touching lines; None without any."""


@dataclass(frozen=True, kw_only=True)
class Readout(Completed, ABC):
    """Base of readouts: the circuit of a kind, and its converter.

    Code c stands for c steps of 2^−bits of the converter's range, which by default reaches from 0
    to the supply. The range of signed codes reaches as far below the voltage of code 0 as above it.

    At the converter, recorded readings are voltages between 0 and the supply; `rails` are the
    limits of valid readings.

    Attributes
    ----------
    supply_volt : float
        Supply of the circuit and reference of the converter in volt.
    adc_bits : int
        Resolution of the converter; without a number that of the named converter, otherwise 10.
    readings : int
        Conversions that are averaged for one cell.
    noise_lsb : PerLine or {'estimated'}, or None
        Standard deviation of one reading before quantisation, in least significant bits; a number
        or one for each driven line (`noisy_side`). 'estimated': from the unloaded frames. None:
        from five or more unloaded frames, otherwise that of a named converter by its data sheet, or
        of the shipped boards, which is sufficient dither for averaging.
    floor_code : int, or None
        Codes at or below it were not recorded: such a reading, zero or infinite by its unit, is a
        bound.
    passes_volt : tuple[float, float] or {'estimated'}, or None
        Smallest and largest voltage that a stage before the converter passes; a reading within its
        noise of either is a bound. 'estimated': from the frames. None: all.
    converter : Characteristic or Known, or None
        Voltages that the codes stand for, or a converter's name (`KNOWN_CONVERTERS`). None: from 0
        to full scale.
    scan_order : {'rows', 'columns'} or tuple of (int, int), or None
        Order in which the readings of a frame are taken: row by row, column by column, or a list of
        [row, column]. Memory, motion and times within a frame follow it. None: driven line by
        driven line.
    unit : {'ohm', 'volt'}
        Unit of a reading.
    signal_name : str
        Long name of the dataset of readings in files.
    of_driven, of_sensed : tuple of str
        Keys of numbers of driven, and of sensed lines; the first one of sensed lines is the
        reference resistor of a reading.
    may_be_zero, may_be_infinite : tuple of str
        Keys of resistances that may be 0, or infinite.
    channels : tuple of str
        Keys, a number or one for each line, of the channels of driven, and of sensed lines; ''
        without any. Sensed lines without a channel have 0.

    >>> issubclass(lampest.GroundedReadout, lampest.Readout)
    True
    """

    unit: ClassVar[str] = "volt"
    signal_name: ClassVar[str] = "voltage at the converter"
    of_driven: ClassVar[tuple[str, ...]] = ("drive_ohm",)
    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm",)
    may_be_zero: ClassVar[tuple[str, ...]] = ("drive_ohm", "sense_ohm")
    may_be_infinite: ClassVar[tuple[str, ...]] = ()
    channels: ClassVar[tuple[str, str]] = ("", "")

    supply_volt: float = 5.0
    adc_bits: int = 10
    readings: int = 20
    noise_lsb: PerLine | Literal["estimated"] | None = None
    floor_code: int | None = None
    passes_volt: tuple[float, float] | Literal["estimated"] | None = None
    converter: Characteristic | Known | None = None
    scan_order: Literal["rows", "columns"] | tuple[tuple[int, int], ...] | None = None

    @classmethod
    def completed(cls, content: Any) -> Any:
        """Return arguments, or the content of a file, with the bits of a named converter."""
        named = content.get("converter") if isinstance(content, Mapping) else None
        name = named.get("name") if isinstance(named, Mapping) else getattr(named, "name", named)
        known: Mapping[Any, KnownConverter] = KNOWN_CONVERTERS
        bits = known[name].adc_bits if isinstance(name, str) and name in known else None
        return content if bits is None else {"adc_bits": bits} | content

    def __post_init__(self) -> None:
        own_volts = [name for name in ("drive_volt", "converter_volt") if hasattr(self, name)]
        check_ranges(self, MIN_VOLT, MAX_VOLT, *own_volts)
        check_range("supply_volt", self.supply_volt, MIN_VOLT, MAX_VOLT, " V")
        check_ranges(self, 1, 32, "adc_bits")
        stated = stated_characteristic(self)
        bits = stated.numbers.adc_bits
        if bits not in (None, self.adc_bits):
            raise ValueError(
                f"adc_bits: {self.adc_bits} contradicts the converter {stated.name}, "
                f"which has {bits} bits"
            )
        check_ranges(self, 1, 65535, "readings")
        check_lines("noise_lsb", self.assumed_noise)
        if max(as_tuple(self.assumed_noise)) > 2**self.adc_bits:
            raise ValueError(
                f"noise_lsb must not exceed the converter's range, {2**self.adc_bits} LSB"
            )
        lowest, highest = self.codes
        check_ranges(self, lowest, highest - 2, "floor_code")
        curve = self.characteristic.curve
        if curve is not None and not all(lowest <= code <= highest + 1 for _, code in curve):
            raise ValueError(f"converter.curve: codes lie between {lowest} and {highest + 1}")
        if self._ends[0] == self._ends[1]:
            raise ValueError(f"converter: code 0 stands at the end of the range, {self._ends[0]} V")
        if not isinstance(self.passes_volt, str | None):
            least, most = self.range_volt
            lower, upper = self.passes_volt
            if not least <= lower < upper <= most:
                raise ValueError(
                    f"passes_volt must be two voltages from {least:g} to {most:g}, "
                    "the lower one first"
                )
        super().__post_init__()
        check_keys(self)

    @abstractmethod
    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of the lines of a panel with so many driven and sensed lines."""

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError if the scene does not fit the readout, or lists do not fit its panel.

        A scene does not fit the readout if it has keys that the readout cannot model.
        """
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        check_scan_order(self, scene.panel)
        if np.any(scene.series_ohm) and self.unit != "ohm":
            raise ValueError(
                "series_resistance_ohm belongs to readout.kind: two_point; "
                "with others a channel's resistance is part of the readout's drive_ohm or sense_ohm"
            )
        check_on_panel(self, scene)

    def in_scene(self, scene: Surroundings) -> "Readout":
        """Return the circuit that gives the readings of a scene."""
        return self

    @abstractmethod
    def description(self) -> str:
        """Return the circuit and its numbers with their units, in words."""

    @property
    def signal(self) -> str:
        """Name of the dataset of readings in files, 'resistance' or 'volt'."""
        return "resistance" if self.unit == "ohm" else "volt"

    @cached_property
    def two_point(self) -> bool:
        """Whether a reading is the resistance between two lines while all others float.

        Then a common factor on all cells multiplies all readings, and plain least squares without
        noise has one minimum.
        """
        return nominal_terminations(self).two_point

    # Readings of cells.

    def ties(self, measured: Array, parts: Numbers | None = None) -> Array:
        """Return the ties to ground of the bases, (lines,) siemens, or (addresses, lines).

        Lines that 0 ohm hold have infinite ties. `parts`, (lines,), is the number of each line's
        part of a panel that open cells divide; None for a connected panel.
        """
        if self.two_point:
            return grounding(measured, parts)
        equation = equation_of(self, *measured.shape[-2:])
        ties = equation.ties_of_parts(parts, lambda: self.apparent_resistance(measured))
        return ties[0] if len(ties) == 1 else ties

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network of cells (rows, columns) ohm, with `wiring` before them.

        The ties are those of `ties`. Cells and ties of two-point readings may have leading axes,
        for many panels. Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        equation = equation_of(self, *cell_resistance.shape[-2:])
        excited = equation.excitations(ties)
        circuit = None if self.two_point else self
        wire = None
        if wiring is not None and not wiring.at_terminals:
            from lampest.panel.readouts.ladder import Wire  # for wire

            wire = Wire.of(cell_resistance, wiring)

        def of_bases(bases: Any, cells: Array = cell_resistance) -> SolvedNetwork:
            """Return the network of one state of the lines, or of many as its leading axis."""
            tied = ties[bases]
            sources = None if excited is None else excited[bases]
            if wire is None and not np.isinf(tied).any():
                leaks = None if wiring is None else wiring.leak_admittance(cells.shape[-2:])
                return SolvedNetwork.tied(cells, tied, circuit, sources, leaks)
            from lampest.panel.difference_network import DifferenceNetwork  # wire and held lines

            return DifferenceNetwork.of(cells, tied, circuit, sources, wiring, wire)

        if self.two_point:
            return of_bases(slice(None))
        ties = np.atleast_2d(ties)
        if len(ties) == 1:
            return of_bases(0)
        from lampest.panel.joined_network import JoinedNetwork  # for several bases

        if wire is None and not np.isinf(ties).any():
            cells = np.broadcast_to(cell_resistance, equation.read_at.shape)
            networks = [of_bases(slice(None), cells)]
        else:
            networks = [of_bases(number) for number in range(len(ties))]
        return JoinedNetwork.of(cell_resistance, networks, equation.read_at > 0)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings y of cells of any contrast.

        The cells are (rows, columns) or (frames, rows, columns) ohm; the readings have the same
        shape. Open cells may divide the panel into parts. Resistances between two lines have at
        least ten correct digits without wiring.
        """
        if wiring is None and self.two_point:
            return two_point_resistance(cell_resistance)
        if cell_resistance.ndim == 3:
            return np.stack([self.exact_reading(frame, wiring) for frame in cell_resistance])
        conducting = np.isfinite(cell_resistance)
        if wiring is not None:
            conducting = wiring.connecting(conducting)
        equation = equation_of(self, *cell_resistance.shape)
        ties = equation.ties_of_parts(connected_parts(conducting), lambda: np.array(USUAL_OHM))
        with np.errstate(divide="ignore"):
            return self.network(cell_resistance, np.squeeze(ties), wiring).reading()

    # Cells at which solves begin, and their bounds.

    def apparent_resistance(self, measured: Array) -> Array:
        """Return the cells that would give each reading if they were alone on the panel.

        Shape (…, rows, columns), in ohm.
        """
        return starts.apparent_resistance(self, measured)

    def uniform_start(self, measured: Array) -> Array:
        """Return cells (…, rows, columns) ohm as if all were equal."""
        return starts.uniform_start(self, measured)

    def start(
        self, measured: Array, limits: tuple[Array, Array], near: Array | None = None
    ) -> Array:
        """Return cells to start a solve from, (rows, columns) ohm.

        Parameters
        ----------
        measured : array, shape (rows, columns)
            Readings.
        limits : tuple of two arrays, shape (rows, columns)
            Smallest and largest resistances, ohm; equal where a cell is known.
        near : array, shape (rows, columns), or None
            Earlier estimate, ohm.
        """
        return starts.start(self, measured, limits, near)

    # Between recorded values and the network's readings.

    def _level(self, shape: Shape) -> Array | float:
        """Return the recorded value of a reading of 0, to be broadcast to (rows, columns), volt.

        Amplifiers add their offsets; an inverting one is recorded below its reference.
        """
        ends = nominal_terminations(self)
        offset = entry(self, "offset_volt")
        if offset is None:
            return ends.recorded_reference
        sensed = of_side(ends.driven, *shape[-2:])[1]
        of_lines = along(opposite(ends.driven), per_line("offset_volt", offset, sensed))
        return ends.recorded_reference + (-of_lines if ends.amplified else of_lines)

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        """Return the network's readings of recorded values, (…, rows, columns)."""
        return nominal_terminations(self).sign * (recorded - self._level(recorded.shape))

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        """Return the recorded values of the network's readings, (…, rows, columns)."""
        return self._level(reading.shape) + nominal_terminations(self).sign * reading

    def sigma_of_reading(self, recorded: Array, sigma: Array) -> Array:
        """Return the σ of the network's readings y, σ·|∂y/∂(recorded)|.

        `sigma` is the σ of the recorded values; all have the same shape.
        """
        return sigma

    # Codes, voltages and recorded values.

    @property
    def full_scale_volt(self) -> float:
        """Voltage at the end of the converter's range, where `converter` does not name another."""
        own = entry(self, "converter_volt")
        return self.supply_volt if own is None else float(own)

    @property
    def noisy_side(self) -> Side:
        """Side whose lines `noise_lsb` lists: the driven one."""
        side: Side = getattr(self, "driven", "rows")
        return side

    @cached_property
    def characteristic(self) -> Characteristic:
        """Voltages that the codes stand for, in numbers."""
        return stated_characteristic(self).within(self.full_scale_volt)

    @property
    def codes(self) -> tuple[int, int]:
        """Lowest and highest code: 0 and 2^bits − 1, or −2^(bits−1) and 2^(bits−1) − 1."""
        lowest = -(2 ** (self.adc_bits - 1)) if self.characteristic.signed else 0
        return lowest, lowest + 2**self.adc_bits - 1

    @property
    def _ends(self) -> tuple[float, float]:
        """Voltages of code 0 and of the one above the highest.

        A voltage to be estimated is that of a scene without `converter`.
        """
        characteristic = self.characteristic
        if characteristic.curve is not None:
            volt, _ = characteristic.points
            return float(volt[0]), float(volt[-1])
        zero = characteristic.zero_volt
        full = characteristic.full_volt
        return (
            0.0 if isinstance(zero, str) else zero,
            full if isinstance(full, float | int) else self.full_scale_volt,
        )

    @property
    def zero_volt(self) -> float:
        """Voltage of code 0."""
        return self._ends[0]

    @property
    def range_volt(self) -> tuple[float, float]:
        """Least and largest voltage of the converter's range, in this order."""
        zero, full = self._ends
        if self.characteristic.signed and self.characteristic.curve is None:
            zero = 2 * zero - full
        return min(zero, full), max(zero, full)

    @property
    def code_sign(self) -> float:
        """1 if codes rise with the voltage, −1 if they fall."""
        return 1.0 if self._ends[0] < self._ends[1] else -1.0

    @property
    def assumed_noise(self) -> PerLine:
        """`noise_lsb` if it is specified, otherwise that of the named converter or the usual one.

        The latter is the assumption until frames determine it.
        """
        if self.noise_lsb is None or self.noise_lsb == "estimated":
            noise = stated_characteristic(self).numbers.noise_lsb
            return USUAL_NOISE_LSB if noise is None else noise
        return self.noise_lsb

    def recorded_from_volt(self, volt: Array) -> Array:
        """Return recorded readings of voltages at the converter, any shape."""
        return np.asarray(volt, dtype=float)

    def volt_from_recorded(self, recorded: Array) -> Array:
        """Return the voltages at the converter of recorded readings, any shape."""
        return np.asarray(recorded, dtype=float)

    @property
    def lsb_volt(self) -> float:
        """One least significant bit in volt: range/2^bits; of a curve, its mean step."""
        curve = self.characteristic.curve
        if curve is None:
            return abs(self._ends[1] - self._ends[0]) / (self.codes[1] + 1.0)
        volt, code = self.characteristic.points
        return float(abs(volt[-1] - volt[0]) / (code[-1] - code[0]))

    def steps_from_volt(self, volt: Array) -> Array:
        """Return voltages as codes that are neither rounded nor clipped; any shape."""
        if self.characteristic.curve is None:
            return np.asarray((volt - self.zero_volt) * self.code_sign / self.lsb_volt)
        points, codes = self.characteristic.points
        order = np.argsort(points)
        return np.interp(volt, points[order], codes[order])

    def code_from_volt(self, volt: Array) -> NDArray[np.int64]:
        """Return the nearest code, clipped to the lowest and the highest one; any shape."""
        return np.clip(np.rint(self.steps_from_volt(volt)), *self.codes).astype(np.int64)

    def volt_from_code(self, mean_code: Array) -> Array:
        """Return the voltage that a code stands for, the middle of its interval.

        Codes may be means.
        """
        code = np.asarray(mean_code, dtype=float)
        if self.characteristic.curve is None:
            return np.asarray(self.zero_volt + self.code_sign * self.lsb_volt * code)
        volt, codes = self.characteristic.points
        return np.asarray(np.interp(code, codes, volt))

    def sigma(self, recorded: Array) -> Array:
        """Return σ of recorded readings, the same shape and unit."""
        volt = self.volt_from_recorded(recorded)
        return np.broadcast_to(mean_sigma(self), volt.shape) * relative_step(self, volt)

    def rails(self) -> tuple[float, float]:
        """Return the range of recorded values that are no bounds.

        A reading outside it is one-sided: a code at a rail, or at the floor, only bounds the
        voltage by its edge.

        Returns
        -------
        least, most : float
            Recorded values, in the readout's unit.
        """
        lowest, top = self.codes
        floor = lowest if self.floor_code is None else self.floor_code
        # Lower edge of the first valid code, and of the last code; stages before the converter may
        # narrow the range.
        edges = np.sort(self.volt_from_code(np.array([floor + 0.5, top - 0.5])))
        if not isinstance(self.passes_volt, str | None):
            margin = NOISE_REACH * np.mean(mean_sigma(self))
            edges = np.clip(edges, self.passes_volt[0] + margin, self.passes_volt[1] - margin)
        ends = self.recorded_from_volt(edges)
        return float(ends.min()), float(ends.max())
