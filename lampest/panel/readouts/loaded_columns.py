"""Loaded columns: one line is driven, all sensed lines are loaded, all other driven lines float."""

from dataclasses import dataclass
from functools import cached_property
from math import e
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Configuration, check_ranges
from lampest.panel.panel import Array
from lampest.panel.readouts.driven import DrivenReadout
from lampest.panel.readouts.lines import LineNumber, PerLine, Side, lines_text, opposite, parallel, per_line


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
