"""Circuits that drive the lines of one side, one after the other, each through a resistance, and sense the other side.

    V_ij = c_j·U_i·Z_ij/D_i/k_j

U_i is the supply, and c_j the share of a sensed line's voltage at the converter. Idle driven lines either are held at
ground through their Rd (ties 1/Rd, D_i = Rd_i), or float (no ties, D_i = Rd_i + Z_ii). Either all sensed lines have
their loads all the time (ties 1/Rs, k_j = 1), or only the one that is read (no ties, k_j = 1 + Z_jj/Rs_j by Sherman and
Morrison's formula). A tie through a resistance of zero would be infinite. It is replaced by a micro-ohm, which changes
readings by 1e-8, less than the resolution of any converter.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import e, inf
from typing import Any, ClassVar, Literal, Self

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Configuration, check_ranges
from lampest.panel.network import inverse_of
from lampest.panel.panel import Array
from lampest.panel.readouts.converter import MAX_VOLT, MIN_VOLT
from lampest.panel.readouts.lines import (
    MIN_OHM,
    LineNumber,
    PerLine,
    Side,
    along,
    as_tuple,
    check_resistors,
    lines_text,
    of_side,
    opposite,
    parallel,
    per_line,
    with_channels,
)
from lampest.panel.readouts.readout import MIN_LOAD_SHARE, SHORT_SHARE, FreeTest, Readout, Surroundings

OPEN_SHARE = 1e-9  # share of the supply below which a reading shows an open cell
# Alternating start: rounds, change of log g at convergence, and range of conductances about those of the closed form,
# beyond which a reading no longer depends on its cell (tests/oracles).
MAX_ROUNDS, CONVERGED, MIN_RATIO, MAX_RATIO = 40, 1e-3, 0.02, 1e3


class DrivenReadout(Readout):
    """Base of circuits with driven and sensed lines; kinds are dataclasses that declare their keys in the files' order.

    Attributes
    ----------
    driven : {'rows', 'columns'}
        Side that is driven.
    drive_ohm : float, or one for each driven line
        Rd in ohm.
    sense_ohm : float, or one for each sensed line
        Resistance of the channels of the sensed lines in ohm.
    polarity : {'up', 'down'}
        Whether loads lead to ground or to the supply.
    input_ohm : float, or None
        Input resistance of the converter in ohm.
    of_sensed : tuple of str
        Keys of resistances of sensed lines; the first one is the reference resistor of a reading.
    idle_floats : bool
        Whether idle driven lines float; otherwise they are held at ground.
    """

    of_sensed: ClassVar[tuple[str, ...]]
    idle_floats: ClassVar[bool] = False
    series_name: ClassVar[str] = "drive_ohm"
    driven: Side
    drive_ohm: PerLine
    sense_ohm: PerLine = 0.0
    polarity: Literal["up", "down"] = "up"
    input_ohm: float | None = None

    @property
    def driving_volt(self) -> float:
        """Voltage of the source of a driven line, before Rd, in volt."""
        return self.supply_volt

    @property
    def all_loaded(self) -> bool:
        """Whether every sensed line has its load all the time."""
        return True

    @abstractmethod
    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """Return (Rs, c) of the sensed lines, (lines,): total resistance to ground while read in ohm, and c."""

    def _supply(self, resistance: Any) -> Any:
        """Return U for a resistance D of the driven path, volt; NumPy and CasADi."""
        return self.driving_volt

    def _lost(self, current: Array) -> Array:
        """Return Vcc − U for a current through the driven line, volt."""
        return np.zeros(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("drive_ohm", *self.of_sensed):
            check_resistors(name, getattr(self, name), open_end=name not in ("drive_ohm", "sense_ohm"))
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as `Readout.check`, or if a list does not have one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        for name in ("drive_ohm", *self.of_sensed):
            per_line(name, getattr(self, name), driven if name == "drive_ohm" else sensed)

    @property
    def _end_text(self) -> str:
        """Description of the converter, with its input resistance."""
        taken = "" if self.input_ohm is None else f", converter input {self.input_ohm:g} ohm"
        return f"{taken}, {self.converter_description()}"

    @property
    def noisy_side(self) -> Side:
        return self.driven

    @property
    def mirrored(self) -> bool:
        return self.polarity == "down"

    @property
    def by_columns(self) -> bool:
        return self.driven == "columns"

    @property
    def _along_sensed(self) -> int:
        """Axis of an array (…, rows, columns) that counts the sensed lines."""
        return -1 if self.driven == "rows" else -2

    def _circuit(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return (Rd, Rs, c), each to be broadcast to (rows, columns); Rd is at least MIN_OHM where it is a tie."""
        driven, sensed = of_side(self.driven, *shape)
        load, gain = (along(opposite(self.driven), values) for values in self._sensed(sensed))
        drive = along(self.driven, per_line("drive_ohm", self.drive_ohm, driven))
        return drive if self.idle_floats else np.maximum(drive, MIN_OHM), load, gain

    def lines_of_circuit(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """Return Rd of the driven lines in ohm, Rs of the sensed lines in ohm, and their c."""
        drive, load, gain = (part.ravel() for part in self._circuit(shape))
        return drive, load, gain

    def ties(self, measured: Array) -> Array:
        """Return the ties: 1/Rd of driven lines unless they float, 1/Rs of sensed lines if all are loaded, siemens."""
        drive, load, _ = (part.ravel() for part in self._circuit(measured.shape))
        held = np.zeros(len(drive)) if self.idle_floats else 1 / drive
        return np.concatenate(of_side(self.driven, held, 1 / load if self.all_loaded else np.zeros(len(load))))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """Return V_ij = c_j·U_i·Z_ij/D_i/k_j."""
        drive, load, gain = (np.broadcast_to(part, mutual.shape) for part in self._circuit(mutual.shape))
        driven, sensed = of_side(self.driven, row, column)
        if self.idle_floats:
            # Floating idle lines: V = c·U(D)·Z_ij/D with D = Rd + Z_ii
            resistance = driven + drive
            volt = mutual * gain * self._supply(resistance) / resistance
        else:
            volt = mutual * (self.driving_volt * gain / drive)
        # One load at a time: /k_j, k_j = 1 + Z_jj/Rs_j
        return volt if self.all_loaded else volt / (sensed * (1 / load) + 1)

    def apparent_resistance(self, measured: Array) -> Array:
        """Return Rs·((Vcc − V_d)·c/V − 1) − Rd, the resistance of a single divider with this reading."""
        drive, load, gain = self._circuit(measured.shape[-2:])
        volt = np.maximum(measured / gain, OPEN_SHARE * self.driving_volt)
        # (Vcc − V_d)/I with the current I = V/(c·Rs): the sum of cell, load and drive
        total = load * (self.driving_volt - self._lost(volt / load)) / volt
        return np.asarray(np.maximum(total - load - drive, MIN_LOAD_SHARE * total))

    def uniform_start(self, measured: Array) -> Array:
        """Return r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij, (…, rows, columns) ohm, for idle lines at ground.

        This is exact for Rd = 0, where no sensed line depends on another one or on its load. For floating lines it is
        the apparent resistance.
        """
        if self.idle_floats:
            return super().uniform_start(measured)
        _, load, gain = self._circuit(measured.shape[-2:])
        driven = -3 - self._along_sensed
        # Voltages over the supply, with a lower limit for open cells.
        share = measured / (self.driving_volt * gain)
        share = np.maximum(share, OPEN_SHARE * share.max(axis=(-2, -1), keepdims=True))
        remainder = 1 - share.sum(axis=driven, keepdims=True)
        # A negative remainder is noise, or the substitute of a dead line. Then the load counts as one more cell.
        return np.asarray(load * np.where(remainder > MIN_LOAD_SHARE, remainder, 1 / (1 + share.shape[driven])) / share)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce the readings, (rows, columns) ohm, by alternating potentials and cells.

        The cells determine the potentials u_p of all driven lines p while i is driven and j is read. Given these
        potentials, Σ_p g_pj (u_p − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line. The alternation
        converges in about six rounds, and in up to 40 for large Rd. The result is a start, not an estimate: its
        conductances stay within MIN_RATIO and MAX_RATIO of those of the uniform start.
        """
        drive, load, gain = self._circuit(measured.shape)
        volt, ideal = self._turned(measured / gain), self._turned(1 / self.uniform_start(measured))
        drive, load = drive.ravel(), load.ravel()
        conductance = ideal if near is None else np.clip(self._turned(1 / near), MIN_RATIO * ideal, MAX_RATIO * ideal)
        for _ in range(MAX_ROUNDS):
            potentials, before = self._driven_potentials(conductance, volt, drive, load), conductance
            # One linear system for each sensed line j: rows i (driven while j is read), unknowns g_pj.
            solved = np.linalg.solve(potentials - volt.T[:, :, None], (volt / load).T[:, :, None])[:, :, 0].T
            conductance = np.clip(solved, MIN_RATIO * ideal, MAX_RATIO * ideal)
            if np.abs(np.log(conductance / before)).max() < CONVERGED:
                break
        return np.asarray(np.minimum(self._turned(1 / conductance), upper))

    def _turned(self, values: Array) -> Array:
        """Return values (rows, columns) as (driven, sensed), or the reverse."""
        return values if self.driven == "rows" else values.T

    def _driven_potentials(self, conductance: Array, volt: Array, drive: Array, load: Array) -> Array:
        """Return the potentials of driven lines p while j is read and i is driven, (sensed j, driven i, driven p) volt.

        Parameters
        ----------
        conductance : array, shape (driven, sensed)
            Siemens.
        volt : array, shape (driven, sensed)
            Voltages of the sensed lines.
        drive, load : array, shapes (driven,), (sensed,)
            Rd and Rs, ohm.
        """
        count = len(drive)
        impedance = inverse_of(conductance, np.concatenate([1 / drive, 1 / load if self.all_loaded else 0 * load]))
        # Potentials of all lines while line i is driven: Z_·i·Vcc/Rd_i
        at_supply = impedance[:, :count] * (self.driving_volt / drive)
        open_circuit = np.broadcast_to(at_supply[:count].T, (len(load), count, count))
        if self.all_loaded:
            return open_circuit
        # Sherman–Morrison: the load of line j draws V_j/(Rs_j + Z_jj), which lowers u_p by Z_jp times this current.
        sinking = at_supply[count:] / (load + np.diag(impedance)[count:])[:, None]
        return np.asarray(open_circuit - sinking[:, :, None] * impedance[count:, None, :count])

    def nearly_shorted(self, measured: Array) -> Array:
        """Return cells that count as shorts, also bounded by a share of the uniform start, (…, rows, columns) ohm.

        With idle lines at ground the apparent resistance is many times too large.
        """
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured)))

    def _driven_volt(self, current: Array, drive: Array | float) -> Array:
        """Return the potential Vcc − Rd I − V_d(I) of a driven line with the current I, volt, any shape."""
        return np.asarray(self.driving_volt - drive * current - self._lost(current))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the tests v_ij ≤ Vcc − Rd_i Σ_k v_ik/Rs_k over simultaneous loads k, and Σ_i v_ij ≤ Vcc.

        The first one: no sensed line has a higher potential than the driven one, which is below the supply by the
        loads' current through its Rd. The second one, for idle lines at ground: if all driven lines were at the supply,
        no sensed line would be above it (superposition, Z·t ≤ 1).
        """
        drive, load, gain = self._circuit(measured.shape[-2:])
        volt, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / gain
        # Vcc ≥ v_ij + Rd_i Σ_k v_ik/Rs_k + V_d, with the propagated noise of both terms
        drop = (drive if self.all_loaded else 0.0) / load
        sensed, driven = self._along_sensed, -3 - self._along_sensed
        lost = self._lost((volt / load).sum(axis=sensed, keepdims=True))
        below = volt + (volt * drop).sum(axis=sensed, keepdims=True) + lost
        spread = np.hypot(noise, np.sqrt(((noise * drop) ** 2).sum(axis=sensed, keepdims=True)))
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        tests = [(law, below, np.where(noise > 0, spread, 0.0))]
        if not self.idle_floats:
            law = "readings of a sensed line add up to no more than the supply"
            tests = [(law, volt.sum(axis=driven), np.sqrt((noise**2).sum(axis=driven))), *tests]
        results = []
        for law, value, spread in tests:
            excess = np.where(spread > 0, (value - self.driving_volt) / np.where(spread > 0, spread, 1.0), -np.inf)
            results.append(FreeTest(law, excess.reshape(len(value), -1).max(axis=1), value[0].size))
        return tuple(results)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Return the upper bound of Rd, min_i (Vcc − V_d − max_j v_ij)/Σ_j v_ij/Rs_j, ohm.

        With one load at a time each reading is taken alone.
        """
        _, load, gain = self._circuit(measured.shape[-2:])
        volt = np.where(np.isfinite(sigma), measured, 0.0) / gain
        current = volt / load
        if self.all_loaded:
            volt, current = volt.max(axis=self._along_sensed), current.sum(axis=self._along_sensed)
        # Voltage across Rd and the current through it: Rd ≤ (Vcc − V_d − v)/I
        drop = self._driven_volt(current, 0.0) - volt
        return float(np.min(np.where(current > 0, drop / np.where(current > 0, current, 1.0), np.inf)))

    def simulated(self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array) -> Array:
        """Return recorded values with the channels added to drive_ohm, and to sense_ohm unless it is zero."""
        actual = self.with_channels(row_ohm, column_ohm)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def with_channels(self, row_ohm: Array, column_ohm: Array) -> Self:
        """Return the circuit with additional channel resistances, (rows,) and (columns,) ohm."""
        driven, sensed = of_side(self.driven, row_ohm, column_ohm)
        changes: dict[str, Any] = {"drive_ohm": with_channels("drive_ohm", self.drive_ohm, driven)}
        if self.sense_ohm:
            changes["sense_ohm"] = with_channels("sense_ohm", self.sense_ohm, sensed)
        return replace(self, **changes)

    def off_by(self, fraction: float) -> Self:
        """Return the circuit with every reference resistor larger by a fraction."""
        name = self.of_sensed[0]
        value: PerLine = getattr(self, name)
        larger = tuple(number * (1 + fraction) for number in as_tuple(value))
        changes: dict[str, Any] = {name: larger if isinstance(value, tuple) else larger[0]}
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Return the numbers to calibrate: drive resistances, which include channels, and reference resistors."""
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        return drive, LineNumber(self.of_sensed[0], (opposite(self.driven),))


@dataclass(frozen=True)
class Diode(Configuration):
    """Diode by Shockley's law, V_d = s·ln(1 + I/I_s), with I_s such that V_d is drop_volt at at_ampere.

    Attributes
    ----------
    drop_volt : float
        Voltage drop in volt at the current at_ampere, as in a data sheet.
    at_ampere : float
        Current in ampere.
    slope_volt : float
        s = n·kT/q in volt, the increase of the drop for an e-fold current; 2.303 s for a decade.

    >>> lampest.Diode(drop_volt=0.6, at_ampere=1e-3, slope_volt=0.05).drop_volt
    0.6
    """

    drop_volt: float = 0.6
    at_ampere: float = 1e-3
    slope_volt: float = 0.05

    def __post_init__(self) -> None:
        # n·kT/q is 0.02 V in the cold with n = 1, and 0.2 V for an LED; a Schottky diode drops 0.1 V, an LED 4 V.
        check_ranges(self, 0.01, 10, "drop_volt")
        check_ranges(self, 1e-7, 10, "at_ampere")
        check_ranges(self, 0.015, 0.5, "slope_volt")

    def description(self) -> str:
        """Return the drop and its slope in words."""
        decade = 1e3 * np.log(10) * self.slope_volt
        return f"diode {self.drop_volt:g} V at {1e3 * self.at_ampere:g} mA, {decade:.3g} mV a decade"

    @cached_property
    def _saturation(self) -> float:
        """Saturation current I_s in ampere."""
        return float(self.at_ampere / np.expm1(self.drop_volt / self.slope_volt))

    def drop(self, current: Array) -> Array:
        """Return the drop V_d in volt at a current in ampere, any shape."""
        return np.asarray(self.slope_volt * np.log1p(current / self._saturation))

    def left(self, supply_volt: float, resistance: Any) -> Any:
        """Return the voltage I·R across a resistance in series with the diode, Vcc = I·R + V_d(I); NumPy and CasADi.

        With A = I_s R/s and w = A e^{V_d/s} the equation is w + ln w = Vcc/s + A + ln A, and I·R = s (w − A). Newton's
        method begins above the root. As the equation is concave, all further iterates are below it and increase.
        """
        # A = I_s R/s, right-hand side Vcc/s + A + ln A, and the start w = right + ln(1 + e^−right)
        part = resistance * (self._saturation / self.slope_volt)
        right = part + _logarithm(part) + supply_volt / self.slope_volt
        omega = right + _logarithm(1 + e**-right)
        # Newton: w ← w (1 + right − ln w)/(1 + w) for w + ln w = right
        for _ in range(7):  # five suffice for the value at any resistance, second derivatives need two more
            omega = omega * (1 + right - _logarithm(omega)) / (1 + omega)
        return self.slope_volt * (omega - part)


def _logarithm(value: Any) -> Any:
    """Return ln of an array or of a CasADi matrix."""
    return value.log() if hasattr(value, "log") else np.log(value)


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(DrivenReadout):
    """Loaded columns: one line is driven, all sensed lines are loaded, all other driven lines float.

    V = Vcc·Z_ij/(Rd_i + Z_ii) for driven line i and sensed line j with its load Rs_j. With a diode it is
    V = U·Z_ij/(Rd_i + Z_ii), U the remaining voltage; see `Diode.left`.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    polarity : {'up', 'down'}
        'up': the driven line is at the supply and loads lead to ground; 'down': the driven line is at ground
        and loads lead to the supply (internal pull-ups), so that the voltage at the converter is Vcc − V.
    load_ohm : PerLine
        Rs in ohm, a number or one for each sensed line.
    drive_ohm : PerLine
        Rd in ohm, between the supply and the driven line, including the channel; a number or one for each driven line.
    diode : Diode, or None
        Diode in series with Rd.
    input_ohm : float, or None
        Input resistance of the converter in ohm, parallel to every load; None: negligible.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError if a number is out
    of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the sensed lines.

    >>> lampest.LoadedColumnsReadout(load_ohm=10000.0).unit
    'volt'
    """

    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm",)
    idle_floats: ClassVar[bool] = True
    kind: Literal["loaded_columns"] = "loaded_columns"
    driven: Side = "rows"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 10_000.0
    drive_ohm: PerLine = 0.0
    diode: Diode | None = None
    input_ohm: float | None = None

    def description(self) -> str:
        diode = "" if self.diode is None else f", {self.diode.description()}"
        return (
            f"loaded {opposite(self.driven)}, {self.driven} driven {self.polarity} one after the other, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{diode}{self._end_text}"
        )

    def _sensed(self, lines: int) -> tuple[Array, Array]:
        return parallel(per_line("load_ohm", self.load_ohm, lines), self.input_ohm), np.ones(lines)

    def _supply(self, resistance: Any) -> Any:
        return self.supply_volt if self.diode is None else self.diode.left(self.supply_volt, resistance)

    def _lost(self, current: Array) -> Array:
        return super()._lost(current) if self.diode is None else self.diode.drop(current)

    def _driven_potentials(self, conductance: Array, volt: Array, drive: Array, load: Array) -> Array:
        """Return the potentials from currents: Σ_j v_ij/Rs_j through the driven line, none through floating ones.

        For a floating line u_p Σ_j g_pj = Σ_j g_pj v_ij.
        """
        potentials = (volt @ conductance.T) / conductance.sum(axis=1)
        # The driven line is above every sensed one: a lower limit against noise.
        driven = self._driven_volt((volt / load).sum(axis=1), drive)
        np.fill_diagonal(potentials, np.maximum(driven, volt.max(axis=1) * (1 + 1e-6)))
        return np.asarray(potentials[None])

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """Return the lower bounds r_ij ≥ u_i/I_i − Rs_j of the cells, (…, rows, columns) ohm.

        I_i = Σ_j V_ij/Rs_j is the current of the driven line, increased by its noise, and u_i = Vcc − Rd_i I_i − V_d
        its potential. The bound holds because I_i is at least the current through each cell and its load alone.
        """
        drive, load, _ = self._circuit(measured.shape[-2:])
        sensed = self._along_sensed
        noise = np.zeros_like(measured) if sigma is None else np.where(np.isfinite(sigma), sigma, measured)
        current = (measured / load).sum(axis=sensed, keepdims=True)
        # Upper bound of the current, and with it a lower bound of the potential
        current = current + NOISE_REACH * np.sqrt(((noise / load) ** 2).sum(axis=sensed, keepdims=True))
        least = np.maximum(self._driven_volt(current, drive), 0) / current - load
        return np.asarray(np.maximum(least, super().least_cells(measured, sigma)))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return *super().line_numbers(), *diode


@dataclass(frozen=True, kw_only=True)
class GroundedReadout(DrivenReadout):
    """Grounded readout: driven line i is at the supply, idle driven lines at ground, each through its Rd.

    V = Vcc·Z_ij/Rd_i·Rs_j/(Rc_j + Rs_j)/k_j. With sense: all, every sensed line j has its load Rs_j, behind its channel
    Rc_j, all the time: ties 1/Rd_i and 1/(Rc_j + Rs_j), k_j = 1. With sense: one, a multiplexer connects the load to
    one sensed line after the other, and idle sensed lines float: ties 1/Rd_i only, and k_j = 1 + Z_jj/(Rc_j + Rs_j) is
    the effect of the load on the line that is read.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    sense : {'all', 'one'}
        Loads that are connected at the same time, see above.
    polarity : {'up', 'down'}
        'up': the driven line is at the supply, idle ones and loads lead to ground; 'down': the driven line is at
        ground, idle ones and loads (internal pull-ups) lead to the supply, and the voltage at the converter is Vcc − V.
    load_ohm : PerLine
        Rs in ohm, a number or one for each sensed line.
    drive_ohm : PerLine
        Rd in ohm, output and channel of every driven line; a number or one for each driven line. Zero counts as a
        micro-ohm.
    sense_ohm : PerLine
        Rc in ohm, the channel between every sensed line and its load; a number or one for each sensed line.
    input_ohm : float, or None
        Input resistance of the converter in ohm, parallel to the load; None: negligible.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    The network's reading is the voltage across the load, for either polarity. No bound except r > 0 holds, because
    other cells can increase and decrease a reading. Raises ValueError if a number is out of range. Source: node
    analysis with Z = (L(g) + diag(t))⁻¹.

    >>> lampest.GroundedReadout(load_ohm=1000.0).unit
    'volt'
    """

    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm", "sense_ohm")
    kind: Literal["grounded"] = "grounded"
    driven: Side = "rows"
    sense: Literal["all", "one"] = "all"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 1000.0
    drive_ohm: PerLine = 50.0
    sense_ohm: PerLine = 0.0
    input_ohm: float | None = None

    def description(self) -> str:
        sensed = opposite(self.driven)
        loads = f"all {sensed} loaded" if self.all_loaded else f"one of the {sensed} loaded, the others floating"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        return (
            f"grounded, {self.driven} driven {self.polarity} while the others are held, {loads}, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{channel}{self._end_text}"
        )

    @property
    def all_loaded(self) -> bool:
        return self.sense == "all"

    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """Return (Rc + Rs, Rs/(Rc + Rs)) of the sensed lines, with the converter's input parallel to Rs."""
        load = parallel(per_line("load_ohm", self.load_ohm, lines), self.input_ohm)
        total = load + per_line("sense_ohm", self.sense_ohm, lines)
        return total, load / total


@dataclass(frozen=True, kw_only=True)
class VirtualGroundReadout(DrivenReadout):
    """Virtual-ground readout: driven line i is at the voltage U, all other lines are held at ground.

    V = Rf_j·i_j = U·Rf_j·Z_ij/(Rd_i·Rc_j). Idle driven lines are grounded through their Rd. Every sensed line is at the
    virtual ground of an amplifier, through its channel Rc, or at ground while another one is read. The amplifier
    inverts: its output is Rf·i_j below its reference. The recorded value is this difference, a positive number from 0
    to the end of the converter's range. Both ends are rails.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    drive_ohm : PerLine
        Rd in ohm, output and channel of every driven line.
    sense_ohm : PerLine
        Rc in ohm, between every sensed line and the amplifier.
    feedback_ohm : PerLine
        Rf in ohm. Each resistance is a number or one for each line; Rd and Rc of zero count as a micro-ohm.
    drive_volt : float, or None
        U in volt; None: supply_volt.
    converter_volt : float, or None
        End of the converter's range in volt; None: supply_volt.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    No bound except r > 0 holds, because other cells can increase and decrease a reading. Raises ValueError if a number
    is out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rd at the driven and 1/Rc at the sensed
    lines.

    >>> lampest.VirtualGroundReadout(feedback_ohm=1000.0).unit
    'volt'
    """

    of_sensed: ClassVar[tuple[str, ...]] = ("feedback_ohm", "sense_ohm")
    signal_name: ClassVar[str] = "output of the amplifier below its reference"
    kind: Literal["virtual_ground"] = "virtual_ground"
    driven: Side = "rows"
    drive_ohm: PerLine = 50.0
    sense_ohm: PerLine = 0.0
    feedback_ohm: PerLine = 1000.0
    drive_volt: float | None = None
    converter_volt: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, MIN_VOLT, MAX_VOLT, "drive_volt", "converter_volt")

    @property
    def driving_volt(self) -> float:
        return self.supply_volt if self.drive_volt is None else self.drive_volt

    @property
    def full_scale_volt(self) -> float:
        return self.supply_volt if self.converter_volt is None else self.converter_volt

    def description(self) -> str:
        return (
            f"virtual ground, {self.driven} driven to {self.driving_volt:g} V while all other lines are grounded, "
            f"converter to {self.full_scale_volt:g} V, "
            f"drive {lines_text(self.drive_ohm)}, sense {lines_text(self.sense_ohm)}, "
            f"feedback {lines_text(self.feedback_ohm)}{self._end_text}"
        )

    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """Return (Rc, Rf/Rc) of the sensed lines."""
        sense = np.maximum(per_line("sense_ohm", self.sense_ohm, lines), MIN_OHM)
        return sense, per_line("feedback_ohm", self.feedback_ohm, lines) / sense
