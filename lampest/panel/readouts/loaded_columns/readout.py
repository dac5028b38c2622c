"""Loaded columns: one line is driven through a resistor, the other driven lines float, every sensed line has a load."""

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.lines import (
    LineNumber,
    PerLine,
    Side,
    along,
    check_resistors,
    lines_text,
    of_side,
    opposite,
    parallel,
    per_line,
    scaled,
    with_channels,
)
from lampest.panel.readouts.loaded_columns.diode import Diode
from lampest.panel.readouts.loaded_columns.start import kirchhoff_start
from lampest.panel.readouts.readout import LEAST_SHARE, Readout

if TYPE_CHECKING:
    from lampest.panel.scene import Scene

RELAXED = 3.0  # σ of the data by which bounds give way: with 1 % noise the truth itself breaks them in a third of cases
END = 1e-9  # of the supply: a reading so near to an end says that a cell is open or a short


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(Readout):
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
    supply_volt, adc_bits, readings, noise_lsb : the converter; see `Readout`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError where a number is out
    of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the sensed lines.
    """

    kind: Literal["loaded_columns"] = "loaded_columns"
    driven: Side = "rows"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 10_000.0
    drive_ohm: PerLine = 0.0
    diode: Diode | None = None
    input_ohm: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_resistors("load_ohm", self.load_ohm)
        check_resistors("drive_ohm", self.drive_ohm, open_end=False)
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)

    def check(self, scene: "Scene") -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        per_line("load_ohm", self.load_ohm, sensed)
        per_line("drive_ohm", self.drive_ohm, driven)

    def description(self) -> str:
        """The circuit and the converter."""
        diode = "" if self.diode is None else f", {self.diode.description()}"
        converter = "" if self.input_ohm is None else f", converter input {self.input_ohm:g} ohm"
        return (
            f"loaded {opposite(self.driven)}, {self.driven} driven {self.polarity} one after the other, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{diode}{converter}, {self.converter_description()}"
        )

    @property
    def noisy_side(self) -> Side:
        """The driven one."""
        return self.driven

    @property
    def mirrored(self) -> bool:
        """Where loads lead to the supply."""
        return self.polarity == "down"

    def _load(self, lines: int) -> Array:
        """Rs of the sensed lines, the converter parallel to it."""
        return parallel(per_line("load_ohm", self.load_ohm, lines), self.input_ohm)

    def _loads(self, shape: tuple[int, ...]) -> Array:
        """The same, to be broadcast to (rows, columns)."""
        return along(opposite(self.driven), self._load(of_side(self.driven, *shape)[1]))

    def _drives(self, shape: tuple[int, ...]) -> Array:
        """Rd of the driven line, to be broadcast to (rows, columns)."""
        return along(self.driven, per_line("drive_ohm", self.drive_ohm, of_side(self.driven, *shape)[0]))

    def ties(self, measured: Array) -> Array:
        """1/Rs at the sensed lines, none at the driven ones."""
        driven, sensed = of_side(self.driven, *measured.shape)
        return np.concatenate(of_side(self.driven, np.zeros(driven), 1 / self._load(sensed)))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """V = U·Z_ij/(Rd_i + Z_ii)."""
        driven, _ = of_side(self.driven, row, column)
        shape = mutual.shape
        resistance = driven + np.broadcast_to(self._drives(shape), shape)
        supply = self.supply_volt if self.diode is None else self.diode.left(self.supply_volt, resistance)
        return supply * mutual / resistance

    def _driven_volt(self, current: Array, drive: Array) -> Array:
        """Vcc − Rd I − V_d(I): where a driven line stands while it takes a current, any shape."""
        volt = self.supply_volt - drive * current
        return volt if self.diode is None else volt - self.diode.drop(current)

    def apparent_resistance(self, measured: Array) -> Array:
        """Rs·(Vcc − V_d)/V − Rs − Rd: what the naive divider makes of a reading."""
        share = np.clip(measured / self.supply_volt, END, 1 - END)
        shape = measured.shape[-2:]
        load = self._loads(shape)
        lost = 0.0 if self.diode is None else self.diode.drop(share * self.supply_volt / load) / self.supply_volt
        return np.asarray(np.maximum(load * ((1 - lost) / share - 1) - self._drives(shape), LEAST_SHARE * load))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells that satisfy Kirchhoff's law at the voltages that were read; see `kirchhoff_start`."""
        shape, begin = measured.shape, None if near is None else 1 / near
        volt = np.clip(measured, END * self.supply_volt, (1 - END) * self.supply_volt)
        load, drive = np.broadcast_to(self._loads(shape), shape), np.broadcast_to(self._drives(shape), shape)
        if self.driven == "columns":
            volt, load, drive = volt.T, load.T, drive.T
            begin = None if begin is None else begin.T
        potential = self._driven_volt((volt / load).sum(axis=1), drive[:, 0])
        conductance = kirchhoff_start(volt, load, potential, begin)
        if self.driven == "columns":
            conductance = conductance.T
        return np.asarray(np.minimum(1 / conductance, upper))

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """r_ij ≥ u_i/I_i − Rs_j with the driven line's current I_i = Σ_j V_ij/Rs_j and potential u_i = Vcc − Rd_i I_i
        − V_d.
        Every sensed line takes at least what flows through its own cell, and I_i is all of it. RELAXED by the noise.
        """
        shape = measured.shape[-2:]
        load, drive = self._loads(shape), self._drives(shape)
        along = -1 if self.driven == "rows" else -2
        noise = np.zeros_like(measured) if sigma is None else np.where(np.isfinite(sigma), sigma, measured)
        current = (measured / load).sum(axis=along, keepdims=True)
        current = current + RELAXED * np.sqrt(((noise / load) ** 2).sum(axis=along, keepdims=True))
        least = np.maximum(self._driven_volt(current, drive), 0) / current - load
        return np.asarray(np.maximum(least, super().least_cells(measured, sigma)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """max_j V_ij ≤ Vcc − Rd_i I_i, I_i = Σ_j V_ij/Rs_j: no sensed line stands above the one that is driven."""
        shape = measured.shape[-2:]
        load, drive = np.broadcast_to(self._loads(shape), shape), np.broadcast_to(self._drives(shape), shape)
        value, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0)
        sensed = -1 if self.driven == "rows" else -2
        driven = self._driven_volt((value / load).sum(axis=sensed, keepdims=True), drive)
        spread = np.sqrt(noise**2 + drive**2 * ((noise / load) ** 2).sum(axis=sensed, keepdims=True))
        excess = (value - driven) / np.where(noise > 0, spread, np.inf)
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        return (FreeTest(law, excess.max(axis=(-2, -1)), measured[0].size),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Rd ≤ min_i (Vcc − max_j V_ij)/I_i."""
        sensed = -1 if self.driven == "rows" else -2
        value = np.where(np.isfinite(sigma), measured, 0.0)
        current = (value / self._loads(measured.shape[-2:])).sum(axis=sensed)
        left = self._driven_volt(current, np.zeros(1)) - value.max(axis=sensed)
        return float(np.min(left / np.maximum(current, 1e-300)))

    def simulated(self, cell_resistance: Array, scene: Any, row_ohm: Array, column_ohm: Array) -> Array:
        """With the driven lines' channels in the drive resistance; the sensed lines have none."""
        driven, _ = of_side(self.driven, row_ohm, column_ohm)
        actual = replace(self, drive_ohm=with_channels("drive_ohm", self.drive_ohm, driven))
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """Every Rs·(1 + fraction)."""
        return replace(self, load_ohm=scaled(self.load_ohm, 1 + fraction))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """The drive resistances, which may be channels alone, the loads, and the drop of a diode that is there."""
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return drive, LineNumber("load_ohm", (opposite(self.driven),)), *diode
