"""Loaded columns: one line is driven through a resistor, the other driven lines float, every sensed line has a load."""

from dataclasses import dataclass
from functools import cached_property
from math import e
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.files.typed import Configuration, check_ranges
from lampest.panel.panel import Array
from lampest.panel.readouts.driven import END, DrivenReadout, alternated
from lampest.panel.readouts.lines import (
    RELAXED,
    LineNumber,
    PerLine,
    Side,
    along,
    lines_text,
    of_side,
    opposite,
    parallel,
    per_line,
)
from lampest.panel.readouts.readout import LEAST_SHARE, FreeTest


@dataclass(frozen=True)
class Diode(Configuration):
    """V_d = s·ln(1 + I/I_s), I_s such that V_d is drop_volt at at_ampere; Shockley's law.

    Parameters
    ----------
    drop_volt : at the current at_ampere, as a data sheet says. slope_volt : s = n·kT/q, what an e-fold of current adds
        to the drop; 2.303 s is a decade's.

    Raises ValueError where a number is out of range.

    >>> lampest.Diode(drop_volt=0.6, at_ampere=1e-3, slope_volt=0.05).drop_volt
    0.6
    """

    drop_volt: float = 0.6
    at_ampere: float = 1e-3
    slope_volt: float = 0.05

    def __post_init__(self) -> None:
        # n·kT/q is 0.02 V in the cold with n = 1, and an LED's 0.2 V; a Schottky drops 0.1 V, an LED 4 V.
        check_ranges(self, 0.01, 10, "drop_volt")
        check_ranges(self, 1e-7, 10, "at_ampere")
        check_ranges(self, 0.015, 0.5, "slope_volt")

    def description(self) -> str:
        """The drop and its slope."""
        decade = 1e3 * np.log(10) * self.slope_volt
        return f"diode {self.drop_volt:g} V at {1e3 * self.at_ampere:g} mA, {decade:.3g} mV a decade"

    @cached_property
    def _saturation(self) -> float:
        """I_s ampere."""
        return float(self.at_ampere / np.expm1(self.drop_volt / self.slope_volt))

    def drop(self, current: Array) -> Array:
        """V_d at a current, ampere → volt."""
        return np.asarray(self.slope_volt * np.log1p(current / self._saturation))

    def left(self, supply_volt: float, resistance: Any) -> Any:
        """I·R with Vcc = I·R + V_d(I): what the diode leaves to a resistance, volt; arrays and CasADi alike.

        With A = I_s R/s and w = A e^{V_d/s} the equation is w + ln w = Vcc/s + A + ln A, and I·R = s (w − A). Newton's
        method begins right of the root, and the equation's concavity keeps all further steps left of it, growing.
        """
        part = resistance * (self._saturation / self.slope_volt)
        right = part + _logarithm(part) + supply_volt / self.slope_volt
        omega = right + _logarithm(1 + e**-right)
        for _ in range(7):  # five suffice for the value at any resistance, its second derivatives need two more
            omega = omega * (1 + right - _logarithm(omega)) / (1 + omega)
        return self.slope_volt * (omega - part)


def _logarithm(value: Any) -> Any:
    """ln of an array, or of CasADi's matrices by their own method."""
    return value.log() if hasattr(value, "log") else np.log(value)


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(DrivenReadout):
    """V = Vcc·Z_ij/(Rd_i + Z_ii): driven line i, sensed line j with its load Rs_j, other driven lines floating.

    Behind a diode it is V = U·Z_ij/(Rd_i + Z_ii), U what the diode leaves of Vcc; see `Diode.left`.

    Parameters
    ----------
    driven : the lines that are driven, one after the other.
    polarity : 'up': the driven line is put to the supply and loads lead to ground; 'down': the driven line is put to
        ground and loads lead to the supply (internal pull-ups), so that the converter sees Vcc − V.
    load_ohm : Rs, a number or one for each sensed line. drive_ohm : Rd, between the supply and the driven line, the
        channel included; a number or one for each driven line.
    diode : in series with Rd, or None. input_ohm : input resistance of the converter, parallel to every load; None:
        none that matters.
    supply_volt, adc_bits, readings, noise_lsb : see `Converter`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError where a number is out
    of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the sensed lines.

    >>> lampest.LoadedColumnsReadout(load_ohm=10000.0).unit
    'volt'
    """

    of_sensed: ClassVar[tuple[str, ...]] = ("load_ohm",)
    kind: Literal["loaded_columns"] = "loaded_columns"
    driven: Side = "rows"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 10_000.0
    drive_ohm: PerLine = 0.0
    diode: Diode | None = None
    input_ohm: float | None = None

    def description(self) -> str:
        """The circuit and the converter."""
        diode = "" if self.diode is None else f", {self.diode.description()}"
        return (
            f"loaded {opposite(self.driven)}, {self.driven} driven {self.polarity} one after the other, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{diode}{self._input_text}, {self.converter_description()}"
        )

    def _circuit(self, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """(Rd, Rs with the converter parallel to it), each to be broadcast to (rows, columns)."""
        driven, sensed = of_side(self.driven, *shape)
        load = parallel(per_line("load_ohm", self.load_ohm, sensed), self.input_ohm)
        return along(self.driven, per_line("drive_ohm", self.drive_ohm, driven)), along(opposite(self.driven), load)

    def ties(self, measured: Array) -> Array:
        """1/Rs at the sensed lines, none at the driven ones."""
        drive, load = (part.ravel() for part in self._circuit(measured.shape))
        return np.concatenate(of_side(self.driven, np.zeros(len(drive)), 1 / load))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """V = U·Z_ij/(Rd_i + Z_ii)."""
        driven, _ = of_side(self.driven, row, column)
        drive = along(self.driven, per_line("drive_ohm", self.drive_ohm, of_side(self.driven, *mutual.shape)[0]))
        resistance = driven + np.broadcast_to(drive, mutual.shape)
        supply = self.supply_volt if self.diode is None else self.diode.left(self.supply_volt, resistance)
        return supply * mutual / resistance

    def _driven_volt(self, current: Array, drive: Array) -> Array:
        """Vcc − Rd I − V_d(I): where a driven line stands while it takes a current, any shape."""
        volt = self.supply_volt - drive * current
        return volt if self.diode is None else volt - self.diode.drop(current)

    def apparent_resistance(self, measured: Array) -> Array:
        """Rs·(Vcc − V_d)/V − Rs − Rd: what the naive divider makes of a reading."""
        share = np.clip(measured / self.supply_volt, END, 1 - END)
        drive, load = self._circuit(measured.shape[-2:])
        lost = 0.0 if self.diode is None else self.diode.drop(share * self.supply_volt / load) / self.supply_volt
        return np.asarray(np.maximum(load * ((1 - lost) / share - 1) - drive, LEAST_SHARE * load))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells that satisfy Kirchhoff's law at the voltages that were read: potentials and cells in turn.

        While line i is driven, sensed line j stands at v_ij, which is read, and the driven one at a potential that
        follows from its current I_i = Σ_j v_ij/Rs_j. Only the floating lines' potentials w_r are unknown: w_r Σ_j g_rj
        = Σ_j g_rj v_ij. Given those, Σ_r g_rj (w_r − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line.
        """
        volt = np.clip(measured, END * self.supply_volt, (1 - END) * self.supply_volt)
        drive, load = (np.broadcast_to(part, measured.shape) for part in self._circuit(measured.shape))
        begin = None if near is None else 1 / near
        if self.driven == "columns":
            volt, load, drive = volt.T, load.T, drive.T
            begin = None if begin is None else begin.T
        current: Array = volt / load
        driven = np.maximum(self._driven_volt(current.sum(axis=1), drive[:, 0]), volt.max(axis=1) * (1 + 1e-6))

        def next_round(conductance: Array) -> Array:
            floating = (volt @ conductance.T) / conductance.sum(axis=1)  # (pattern, line)
            floating[np.diag_indices(len(driven))] = driven
            system = floating[None] - volt.T[:, :, None]  # (sensed, pattern, line)
            return np.asarray(np.linalg.solve(system, current.T[:, :, None])[:, :, 0].T)

        conductance = alternated(current / (driven[:, None] - volt), begin, next_round)
        return np.asarray(np.minimum(1 / (conductance.T if self.driven == "columns" else conductance), upper))

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """r_ij ≥ u_i/I_i − Rs_j with the driven line's current I_i = Σ_j V_ij/Rs_j and potential u_i = Vcc − Rd_i I_i
        − V_d.
        Every sensed line takes at least what flows through its own cell, and I_i is all of it. RELAXED by the noise.
        """
        drive, load = self._circuit(measured.shape[-2:])
        sensed = self._along_sensed
        noise = np.zeros_like(measured) if sigma is None else np.where(np.isfinite(sigma), sigma, measured)
        current = (measured / load).sum(axis=sensed, keepdims=True)
        current = current + RELAXED * np.sqrt(((noise / load) ** 2).sum(axis=sensed, keepdims=True))
        least = np.maximum(self._driven_volt(current, drive), 0) / current - load
        return np.asarray(np.maximum(least, super().least_cells(measured, sigma)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """max_j V_ij ≤ Vcc − Rd_i I_i, I_i = Σ_j V_ij/Rs_j: no sensed line stands above the one that is driven."""
        drive, load = self._circuit(measured.shape[-2:])
        value, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0)
        sensed = self._along_sensed
        driven = self._driven_volt((value / load).sum(axis=sensed, keepdims=True), drive)
        spread = np.sqrt(noise**2 + drive**2 * ((noise / load) ** 2).sum(axis=sensed, keepdims=True))
        excess = (value - driven) / np.where(noise > 0, spread, np.inf)
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        return (FreeTest(law, excess.max(axis=(-2, -1)), measured[0].size),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Rd ≤ min_i (Vcc − max_j V_ij)/I_i."""
        value, sensed = np.where(np.isfinite(sigma), measured, 0.0), self._along_sensed
        current = (value / self._circuit(measured.shape[-2:])[1]).sum(axis=sensed)
        left = self._driven_volt(current, np.zeros(1)) - value.max(axis=sensed)
        return float(np.min(left / np.maximum(current, 1e-300)))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Those of driven lines, and the drop of a diode that is there."""
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return *super().line_numbers(), *diode
