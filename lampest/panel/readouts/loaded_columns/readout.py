"""Loaded columns: one line is driven through a resistor, the other driven lines float, every sensed line has a load."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.lines import PerLine, as_tuple, check_lines, lines_text, per_line
from lampest.panel.readouts.loaded_columns.start import kirchhoff_start
from lampest.panel.readouts.readout import LEAST_SHARE, Readout

if TYPE_CHECKING:
    from lampest.panel.scene import Scene

RELAXED = 3.0  # σ of the data by which bounds give way: with 1 % noise the truth itself breaks them in a third of cases
END = 1e-9  # of the supply: a reading so near to an end says that a cell is open or a short


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(Readout):
    """V = Vcc·Z_ij/(Rd_i + Z_ii): driven line i, sensed line j with its load Rs_j, other driven lines floating.

    Parameters
    ----------
    driven : the lines that are driven, one after the other.
    polarity : 'up': the driven line is put to the supply and loads lead to ground; 'down': the driven line is put to
        ground and loads lead to the supply (internal pull-ups), so that the converter sees Vcc − V.
    load_ohm : Rs, a number or one for each sensed line. drive_ohm : Rd, between the supply and the driven line, the
        channel included; a number or one for each driven line.
    supply_volt, adc_bits, readings, noise_lsb : the converter; see `Readout`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError where a number is out
    of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the sensed lines.
    """

    kind: Literal["loaded_columns"] = "loaded_columns"
    driven: Literal["rows", "columns"] = "rows"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 10_000.0
    drive_ohm: PerLine = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lines("load_ohm", self.load_ohm, least=0.0, open_end=True)
        check_lines("drive_ohm", self.drive_ohm, least=0.0)

    def check(self, scene: "Scene") -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = self._sides(*scene.panel.shape)
        per_line("load_ohm", self.load_ohm, sensed)
        per_line("drive_ohm", self.drive_ohm, driven)

    def description(self) -> str:
        """The circuit and the converter."""
        sensed = "columns" if self.driven == "rows" else "rows"
        return (
            f"loaded {sensed}, {self.driven} driven {self.polarity} one after the other, {self.supply_volt:g} V, "
            f"load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}, {self.converter_description()}"
        )

    def _sides(self, rows: Any, columns: Any) -> tuple[Any, Any]:
        """(driven, sensed) of what rows and columns have."""
        return (rows, columns) if self.driven == "rows" else (columns, rows)

    def _loads(self, shape: tuple[int, ...]) -> Array:
        """Rs of the sensed line, to be broadcast to (rows, columns)."""
        _, sensed = self._sides(*shape)
        load = per_line("load_ohm", self.load_ohm, sensed)
        return load[None, :] if self.driven == "rows" else load[:, None]

    def _drives(self, shape: tuple[int, ...]) -> Array:
        """Rd of the driven line, to be broadcast to (rows, columns)."""
        driven, _ = self._sides(*shape)
        drive = per_line("drive_ohm", self.drive_ohm, driven)
        return drive[:, None] if self.driven == "rows" else drive[None, :]

    def ties(self, measured: Array) -> Array:
        """1/Rs at the sensed lines, none at the driven ones."""
        rows, columns = measured.shape
        driven, sensed = self._sides(rows, columns)
        load = 1 / per_line("load_ohm", self.load_ohm, sensed)
        parts = (np.zeros(driven), load) if self.driven == "rows" else (load, np.zeros(driven))
        return np.concatenate(parts)

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """V = Vcc·Z_ij/(Rd_i + Z_ii)."""
        driven, _ = self._sides(row, column)
        shape = mutual.shape
        return self.supply_volt * mutual / (driven + np.broadcast_to(self._drives(shape), shape))

    def apparent_resistance(self, measured: Array) -> Array:
        """Rs·(1/v − 1) − Rd: what the naive divider makes of a reading."""
        share = np.clip(measured / self.supply_volt, END, 1 - END)
        shape = measured.shape[-2:]
        load = self._loads(shape)
        return np.asarray(np.maximum(load * (1 / share - 1) - self._drives(shape), LEAST_SHARE * load))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells that satisfy Kirchhoff's law at the voltages that were read; see `kirchhoff_start`."""
        if near is not None:
            return near
        shape = measured.shape
        load, drive = np.broadcast_to(self._loads(shape), shape), np.broadcast_to(self._drives(shape), shape)
        share = np.clip(measured / self.supply_volt, END, 1 - END)
        if self.driven == "rows":
            conductance = kirchhoff_start(share, load, drive[:, 0])
        else:
            conductance = kirchhoff_start(share.T, load.T, drive[0]).T
        return np.asarray(np.minimum(1 / conductance, upper))

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """r_ij ≥ u_i/I_i − Rs_j with the driven line's current I_i = Σ_j V_ij/Rs_j and potential u_i = Vcc − Rd_i I_i.

        Every sensed line takes at least what flows through its own cell, and I_i is all of it. RELAXED by the noise.
        """
        shape = measured.shape[-2:]
        load, drive = self._loads(shape), self._drives(shape)
        along = -1 if self.driven == "rows" else -2
        noise = np.zeros_like(measured) if sigma is None else np.where(np.isfinite(sigma), sigma, measured)
        current = (measured / load).sum(axis=along, keepdims=True)
        current = current + RELAXED * np.sqrt(((noise / load) ** 2).sum(axis=along, keepdims=True))
        least = np.maximum(self.supply_volt - drive * current, 0) / current - load
        return np.asarray(np.maximum(least, super().least_cells(measured, sigma)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """max_j V_ij ≤ Vcc − Rd_i I_i, I_i = Σ_j V_ij/Rs_j: no sensed line stands above the one that is driven."""
        shape = measured.shape[-2:]
        load, drive = np.broadcast_to(self._loads(shape), shape), np.broadcast_to(self._drives(shape), shape)
        value, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0)
        along = -1 if self.driven == "rows" else -2
        fall = drive * (value / load).sum(axis=along, keepdims=True)
        spread = np.sqrt(noise**2 + drive**2 * ((noise / load) ** 2).sum(axis=along, keepdims=True))
        excess = (value + fall - self.supply_volt) / np.where(noise > 0, spread, np.inf)
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        return (FreeTest(law, excess.max(axis=(-2, -1)), measured[0].size),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Rd ≤ min_i (Vcc − max_j V_ij)/I_i."""
        along = -1 if self.driven == "rows" else -2
        value = np.where(np.isfinite(sigma), measured, 0.0)
        current = (value / self._loads(measured.shape[-2:])).sum(axis=along)
        left = self.supply_volt - value.max(axis=along)
        return float(np.min(left / np.maximum(current, 1e-300)))

    def with_series(self, scene: "Scene", ohm: float) -> "Scene":
        """As the drive resistance of all lines."""
        return replace(scene, readout=replace(self, drive_ohm=ohm))

    def in_series(self, scene: "Scene") -> float:
        """The mean drive resistance."""
        return float(np.mean(as_tuple(self.drive_ohm)))

    @property
    def series_name(self) -> str:
        """The readout's own."""
        return "drive_ohm"

    def simulated(self, cell_resistance: Array, scene: Any, row_ohm: Array, column_ohm: Array) -> Array:
        """With the driven lines' channels in the drive resistance; the sensed lines have none."""
        driven, _ = self._sides(row_ohm, column_ohm)
        drive = per_line("drive_ohm", self.drive_ohm, len(driven)) + driven
        if np.any(drive < 0):
            raise ValueError("the spread of the channels makes a drive resistance negative; give a larger drive_ohm")
        actual = replace(self, drive_ohm=tuple(float(ohm) for ohm in drive))
        return actual.to_recorded(actual.exact_reading(cell_resistance), scene)

    def off_by(self, fraction: float) -> Self:
        """Every Rs·(1 + fraction)."""
        scaled = tuple(ohm * (1 + fraction) for ohm in as_tuple(self.load_ohm))
        return replace(self, load_ohm=scaled if isinstance(self.load_ohm, tuple) else scaled[0])

    def from_recorded(self, recorded: Array, scene: Any) -> Array:
        """The voltage across the load: V, or Vcc − V where loads lead to the supply."""
        return recorded if self.polarity == "up" else self.supply_volt - recorded

    @property
    def direction(self) -> float:
        """-1 where loads lead to the supply."""
        return 1.0 if self.polarity == "up" else -1.0

    def to_recorded(self, reading: Array, scene: Any) -> Array:
        """The same way back."""
        return self.from_recorded(reading, scene)
