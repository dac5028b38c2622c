"""How a panel is read: lines tied to ground, a reading as an equation, and the converter that turns it into codes.

A kind of readout is one file: it states its ties and its reading. All else has a default that follows from these two.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Block, Network, inverse_of
from lampest.panel.panel import Array
from lampest.panel.readouts.block import newton_fitted
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.lines import (
    LineNumber,
    PerLine,
    Side,
    along,
    as_tuple,
    check_lines,
    lines_text,
    of_side,
    per_line,
)
from lampest.panel.readouts.tied import TiedNetwork
from lampest.panel.readouts.wired import WiredNetwork
from lampest.panel.readouts.wiring import Wiring

if TYPE_CHECKING:
    from lampest.panel.scene import Scene

LEAST_SHARE = 1e-3  # of a load: what a reading at its end leaves of the apparent resistance
SHORT_SHARE = 1e-6  # of the apparent resistance: from here to a dead short readings move by a millionth
USUAL_NOISE_LSB = 0.7  # enough to dither: what the shipped boards show, and what averaging needs
LEAST_VOLT, MOST_VOLT = 1e-3, 1e5  # a thermocouple's, a transmission line's
HARMONICS = 2000  # of quantisation noise; the tail beyond is 1/(2π²·2000), and matters only where there is no noise


@dataclass(frozen=True, kw_only=True)
class Readout(ABC):
    """The converter, and what every kind of readout must say of its circuit.

    Parameters
    ----------
    supply_volt : supply of the circuit and reference of the converter in volt.
    adc_bits : resolution of the converter.
    readings : conversions that are averaged for one cell.
    noise_lsb : standard deviation of one reading before quantisation, in least significant bits; a number or one for
        each driven line (`noisy_side`). 'estimated': as the unloaded frames show it. None: not said; then as five or
        more unloaded frames show it, else USUAL_NOISE_LSB.

    unit : of a reading, 'ohm' or 'volt'. signal, signal_name : its dataset in files, and that in words. homogeneous :
    whether readings grow with all cells by one factor. unique : whether theory promises that plain least squares
    without noise has one minimum; where it does not, the reduced solver searches and others go on from what it finds.
    in_series : whether the scene's series resistance adds to every reading. noisy_side : whose lines `noise_lsb` lists.
    mirrored : whether loads lead to the supply, so that the converter sees Vcc minus the network's reading.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    unit: ClassVar[str] = "volt"
    signal: ClassVar[str] = "volt"
    signal_name: ClassVar[str] = "voltage at the converter"
    homogeneous: ClassVar[bool] = False
    unique: ClassVar[bool] = False
    in_series: ClassVar[bool] = False
    supply_volt: float = 5.0
    adc_bits: int = 10
    readings: int = 20
    noise_lsb: PerLine | Literal["estimated"] | None = None

    def __post_init__(self) -> None:
        check_supply(self.supply_volt)
        if not 1 <= self.adc_bits <= 32:
            raise ValueError("adc_bits must lie between 1 and 32")
        if not 1 <= self.readings <= 65535:
            raise ValueError("readings must lie between 1 and 65535")
        check_lines("noise_lsb", self.assumed_noise)
        if max(as_tuple(self.assumed_noise)) > 2**self.adc_bits:
            raise ValueError(f"noise_lsb must not exceed the converter's range, {2**self.adc_bits} LSB")

    def check(self, scene: "Scene") -> None:
        """Raise ValueError where the scene says what the readout has no model of, or it does not fit the panel."""
        per_line("noise_lsb", self.assumed_noise, of_side(self.noisy_side, *scene.panel.shape)[0])
        if scene.series_resistance_ohm and not self.in_series:
            raise ValueError(
                "series_resistance_ohm belongs to readout.kind: two_point; with others a channel's resistance is part "
                "of the readout's drive_ohm or sense_ohm"
            )

    @property
    def assumed_noise(self) -> PerLine:
        """`noise_lsb` where it is told; else what is taken until frames have shown it."""
        return USUAL_NOISE_LSB if self.noise_lsb is None or self.noise_lsb == "estimated" else self.noise_lsb

    @property
    def noise_told(self) -> bool:
        """Whether the noise is told, and not left to the frames."""
        return self.noise_lsb is not None and self.noise_lsb != "estimated"

    @property
    def noisy_side(self) -> Side:
        """The driven lines; rows unless a kind says otherwise."""
        return "rows"

    @property
    def mirrored(self) -> bool:
        """No, unless a kind says otherwise."""
        return False

    @abstractmethod
    def description(self) -> str:
        """The circuit and its numbers with their units, for people."""

    def converter_description(self) -> str:
        """The converter's part of that."""
        return f"{self.adc_bits} bits, {self.readings} readings, noise {self._noise_text}"

    @property
    def _noise_text(self) -> str:
        return lines_text(self.assumed_noise, "LSB") if self.noise_told else "as the unloaded frames show it"

    # The circuit: what a kind must state.

    @abstractmethod
    def ties(self, measured: Array) -> Array:
        """t (rows + columns) siemens: what ties every line to ground, for the readings (rows, columns) of a panel."""

    @abstractmethod
    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """y = h(Z_jj, Z_kk, Z_jk), element by element of (rows, columns) in ohm; numpy arrays and CasADi alike."""

    @abstractmethod
    def apparent_resistance(self, measured: Array) -> Array:
        """The cell (…, rows, columns) ohm that would give each reading if it were the only one of the panel."""

    # What follows from the circuit.

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """The solved network of cells (rows, columns) ohm; wiring : what lies between them and the terminals, or None.

        Raises numpy.linalg.LinAlgError where a line is loose.
        """
        if wiring is not None:
            return WiredNetwork.solve(cell_resistance, ties, self, wiring)
        conductance = 1 / cell_resistance
        return TiedNetwork(cell_resistance, conductance, inverse_of(conductance, ties), self)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """y of cells (rows, columns) or (frames, rows, columns) ohm, any contrast; the same shape."""
        if cell_resistance.ndim == 3:
            return np.stack([self.exact_reading(frame, wiring) for frame in cell_resistance])
        with np.errstate(divide="ignore"):
            return self.network(cell_resistance, self.ties(cell_resistance), wiring).reading()

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells (rows, columns) ohm to begin a search at, from readings, upper bounds, an earlier estimate or None."""
        return self.uniform_start(measured) if near is None else near

    def exact_start(self, measured: Array, upper: Array) -> Array:
        """Cells (rows, columns) ohm that reproduce the readings as nearly as the kind can tell without a search."""
        return self.start(measured, upper)

    def uniform_start(self, measured: Array) -> Array:
        """Cells (…, rows, columns) ohm as if all were alike, as far as the kind knows better than apparent ones."""
        return self.apparent_resistance(measured)

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """What no cell can lie below, given its readings (…, rows, columns), ohm."""
        return self.nearly_shorted(measured)

    def nearly_shorted(self, measured: Array) -> Array:
        """Cells (…, rows, columns) ohm that no reading tells from dead shorts."""
        return SHORT_SHARE * self.apparent_resistance(measured)

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """r_max = |∂y_c/∂g_c|/σ at the start: an open cell in its place changes its reading by just the noise σ.

        (…, rows, columns) ohm. Never below twice the start.
        """
        if measured.ndim > 2:
            pairs = zip(measured, sigma, strict=True)
            return np.stack([self.resolution(frame, noise) for frame, noise in pairs])
        start = self.uniform_start(measured)
        network = self.network(start, self.ties(measured))
        limit = np.abs(network.own_response()) * start / sigma
        return np.asarray(np.maximum(limit, 2 * start))

    def common_step(self, measured: Array, expected: Array, chosen: NDArray[np.bool_]) -> float:
        """The factor by which all cells seem to have grown together; 1 where readings do not tell it.

        measured, expected : (rows, columns) readings, and what was expected of them; chosen : those that count.
        """
        return 1.0

    def fitted_block(
        self, network: Network, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]
    ) -> Network:
        """The network with a block's cells such that they reproduce its chosen readings, as far as bounds allow.

        measured, least : (rows, columns) of the block: readings, and the least conductance in siemens.
        """
        return newton_fitted(network, block, measured, least, chosen)

    # What readings tell of the circuit.

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Inequalities that the circuit's readings (frames, rows, columns) keep whatever the cells are; σ likewise.

        σ is infinite where a reading is no value.
        """
        return ()

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """The largest resistance that may stand in series with the panel, ohm; 0 where the kind has none.

        measured, sigma : as above, by a circuit that has none in series.
        """
        return 0.0

    def with_series(self, scene: "Scene", ohm: float) -> "Scene":
        """The scene, of this circuit, with a resistance in series with the panel: what all lines are driven through.

        Itself where the kind has none.
        """
        other: Any = {self.series_name: ohm}
        return replace(scene, readout=replace(self, **other)) if self.series_name else scene  # type: ignore[arg-type]

    def told_in_series(self, scene: "Scene") -> float:
        """What the scene says of it, ohm; the mean where lines differ."""
        return float(np.mean(as_tuple(getattr(self, self.series_name)))) if self.series_name else 0.0

    @property
    def series_name(self) -> str:
        """What scenes call that resistance; empty where the kind has none."""
        return "drive_ohm" if hasattr(self, "drive_ohm") else ""

    # Between what is recorded and what the network is read by.

    @property
    def by_columns(self) -> bool:
        """Whether a scan goes column by column: kinds that drive the lines of one side say which, others go by rows."""
        return bool(getattr(self, "driven", "rows") == "columns")

    def from_recorded(self, recorded: Array, scene: "Scene") -> Array:
        """The network's reading of a recorded one, any shape ending in (rows, columns)."""
        return self.supply_volt - recorded if self.mirrored else recorded

    @property
    def direction(self) -> float:
        """1 where a network's reading grows with the recorded one, -1 where it falls."""
        return -1.0 if self.mirrored else 1.0

    def to_recorded(self, reading: Array, scene: "Scene") -> Array:
        """The recorded reading of a network's, any shape ending in (rows, columns)."""
        return self.supply_volt - reading if self.mirrored else reading

    def sigma_of_reading(self, recorded: Array, sigma: Array) -> Array:
        """σ of the network's readings from that of recorded ones, the same shape."""
        return sigma

    def simulated(self, cell_resistance: Array, scene: "Scene", row_ohm: Array, column_ohm: Array) -> Array:
        """Recorded readings (frames, rows, columns) of cells, without the converter.

        row_ohm, column_ohm : what every line's channel has in series beyond what the scene tells, ohm.
        """
        return self.to_recorded(self.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """The same circuit with its reference resistor larger by a fraction."""
        return self

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """What known resistors in place of the cells determine of the circuit; none, unless a kind says so."""
        return ()

    def shared_errors(self, cells: Array, measured: Array, scene: "Scene", reference: float, channel: float) -> Array:
        """What errors of all readings together do to them, (1 + rows + columns, rows, columns): secants of the model.

        cells : the estimate, (rows, columns) ohm. measured : its readings. reference : by this fraction the reference
        resistor is off, see `off_by`. channel : by so many ohm one line's channel is, rows first, see `simulated`.
        """
        rows, columns = cells.shape
        errors, still = np.zeros((1 + rows + columns, rows, columns)), self.exact_reading(cells, scene.wiring)
        if reference:
            errors[0] = self.off_by(reference).exact_reading(cells, scene.wiring) - still
        for line, more in enumerate(channel * np.eye(rows + columns) if channel else ()):
            recorded = self.simulated(cells, scene, more[:rows], more[rows:])
            errors[1 + line] = self.from_recorded(recorded, scene) - still
        return errors

    # The converter.

    def recorded_from_volt(self, volt: Array) -> Array:
        """A recorded reading from what the converter sees, any shape."""
        return np.asarray(volt, dtype=float)

    def volt_from_recorded(self, recorded: Array) -> Array:
        """What the converter sees of a recorded reading, any shape, volt."""
        return np.asarray(recorded, dtype=float)

    @property
    def lsb_volt(self) -> float:
        """Vcc / 2^bits: one least significant bit in volt."""
        return self.supply_volt / 2.0**self.adc_bits

    def code_from_volt(self, volt: Array) -> NDArray[np.int64]:
        """code = ⌊V/Vcc · 2^bits⌋, held within 0 and 2^bits − 1; any shape."""
        code = np.floor(np.asarray(volt) / self.lsb_volt)
        held: NDArray[np.int64] = np.clip(code, 0, 2**self.adc_bits - 1).astype(np.int64)
        return held

    def volt_from_code(self, mean_code: Array) -> Array:
        """V = (code + ½)·Vcc/2^bits: the middle of what a converter calls by this code; means of codes too."""
        return (np.asarray(mean_code, dtype=float) + 0.5) * self.lsb_volt

    def recorded_from_sums(self, sums: NDArray[np.integer[Any]], readings: int) -> Array:
        """A recorded reading from the sum of so many codes; a rail stands for its interval's middle, and is finite."""
        return self.recorded_from_volt(self.volt_from_code(sums / readings))

    def noise_volt(self) -> Array:
        """The noise of one reading, to be broadcast to (rows, columns)."""
        return self._of_driven_lines(np.array(self.assumed_noise)) * self.lsb_volt

    def _of_driven_lines(self, values: Array) -> Array:
        """One number, or one for each driven line, to be broadcast to (rows, columns)."""
        return along(self.noisy_side, values) if values.ndim else values

    def sigma_code(self) -> Array:
        """σ of the mean of `readings` codes, in LSB: σ² = (noise² + 1/12 − b²)/readings + b²; as `noise_lsb` is given.

        b² = Σ_h exp(−4π²h²·noise²)/(2π²h²) is what averaging cannot remove, because without noise all readings agree:
        1/12 for no noise, 0.0000 above half an LSB. Source: Widrow & Kollár, Quantization Noise, 2008 (dither).
        """
        noise, bias = np.array(self.assumed_noise), self._bias
        return np.asarray(np.sqrt((noise**2 + 1 / 12 - bias) / self.readings + bias))

    @cached_property
    def _bias(self) -> Array:
        """b² of `sigma_code`; a sum that is the same for every frame."""
        harmonic, noise = np.arange(1, HARMONICS + 1, dtype=float), np.array(self.assumed_noise)
        damped = np.exp(-((2 * np.pi * harmonic * noise[..., None]) ** 2)) / (2 * np.pi**2 * harmonic**2)
        return np.asarray(np.where(noise == 0, 1 / 12, np.minimum(np.sum(damped, axis=-1), 1 / 12)))

    def sigma(self, recorded: Array) -> Array:
        """σ of recorded readings, the same shape and unit."""
        return np.broadcast_to(self.sigma_volt(), np.shape(recorded)).copy()

    def sigma_volt(self) -> Array:
        """σ of a mean reading at the converter, to be broadcast to (rows, columns)."""
        return self._sigma_volt

    @cached_property
    def _sigma_volt(self) -> Array:
        return np.asarray(self._of_driven_lines(self.sigma_code()) * self.lsb_volt)

    def rails(self) -> tuple[float, float]:
        """(least, largest) recorded reading that a code between the first and the last one can mean.

        A reading beyond is a bound, not a value: a code at a rail only says that the voltage is beyond the code's edge.
        """
        return self._rails

    @cached_property
    def _rails(self) -> tuple[float, float]:
        top = 2.0**self.adc_bits - 1
        ends = self.recorded_from_volt(np.array([1.0, top]) * self.lsb_volt)
        return float(ends.min()), float(ends.max())


def check_supply(volt: float) -> None:
    """Raise ValueError unless a supply is positive, finite, and one that a circuit can have."""
    if not (isfinite(volt) and volt > 0):
        raise ValueError("supply_volt must be positive and finite")
    if not LEAST_VOLT <= volt <= MOST_VOLT:
        raise ValueError(f"supply_volt must lie between {LEAST_VOLT:g} and {MOST_VOLT:g} V")
