"""Grounded drives: idle driven lines are held at ground, and every sensed line, or the one that is read, has a load."""

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.held import (
    at_ideal_drives,
    drives_of,
    held_start,
    held_tests,
    most_drive,
    with_both_channels,
)
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
)
from lampest.panel.readouts.readout import LEAST_SHARE, SHORT_SHARE, Readout

if TYPE_CHECKING:
    from lampest.panel.scene import Scene

END = 1e-9  # of the supply: a reading so near to an end says that a cell is open or a short


@dataclass(frozen=True, kw_only=True)
class GroundedReadout(Readout):
    """V = Vcc·Z_ij/Rd_i·Rs_j/(Rc_j + Rs_j)/k_j: driven line i at the supply, idle ones at ground, each through its Rd.

    sense: all : every sensed line j has its load Rs_j, behind its channel Rc_j, all the time: ties 1/Rd_i and
    1/(Rc_j + Rs_j), k_j = 1. sense: one : a multiplexer takes the load from one sensed line to the next and leaves the
    idle ones floating: ties 1/Rd_i and none, and k_j = 1 + Z_jj/(Rc_j + Rs_j) is what the load does to the line that
    is read (Sherman and Morrison).

    Parameters
    ----------
    driven : the lines that are driven, one after the other. sense : see above.
    polarity : 'up': the driven line is put to the supply, idle ones and loads lead to ground; 'down': the driven line
        is put to ground, idle ones and loads (internal pull-ups) to the supply; the converter then sees Vcc − V.
    load_ohm : Rs, a number or one for each sensed line. drive_ohm : Rd, output and channel of every driven line; a
        number or one for each driven line. Zero is taken for a micro-ohm. sense_ohm : Rc, the channel between every
        sensed line and its load; a number or one for each sensed line.
    input_ohm : input resistance of the converter, parallel to the load; None: none that matters.
    supply_volt, adc_bits, readings, noise_lsb : the converter; see `Readout`.

    The network's reading is the voltage across the load, for either polarity. No bound but r > 0 holds: other cells
    raise and lower a reading. Raises ValueError where a number is out of range. Source: node analysis with Z =
    (L(g) + diag(t))⁻¹.
    """

    kind: Literal["grounded"] = "grounded"
    driven: Side = "rows"
    sense: Literal["all", "one"] = "all"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 1000.0
    drive_ohm: PerLine = 50.0
    sense_ohm: PerLine = 0.0
    input_ohm: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_resistors("load_ohm", self.load_ohm)
        check_resistors("drive_ohm", self.drive_ohm, open_end=False)
        check_resistors("sense_ohm", self.sense_ohm, open_end=False)
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)

    def check(self, scene: "Scene") -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        per_line("drive_ohm", self.drive_ohm, driven)
        self._behind(sensed)

    def description(self) -> str:
        """The circuit and the converter."""
        sensed = opposite(self.driven)
        loads = f"all {sensed} loaded" if self.sense == "all" else f"one of the {sensed} loaded, the others floating"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        converter = "" if self.input_ohm is None else f", converter input {self.input_ohm:g} ohm"
        return (
            f"grounded, {self.driven} driven {self.polarity} while the others are held, {loads}, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{channel}{converter}, {self.converter_description()}"
        )

    @property
    def noisy_side(self) -> Side:
        """The driven one."""
        return self.driven

    @property
    def mirrored(self) -> bool:
        """Where loads lead to the supply."""
        return self.polarity == "down"

    def _behind(self, sensed: int) -> tuple[Array, Array]:
        """(Rc + Rs, Rs/(Rc + Rs)) of the sensed lines, the converter parallel to Rs."""
        load = parallel(per_line("load_ohm", self.load_ohm, sensed), self.input_ohm)
        total = load + per_line("sense_ohm", self.sense_ohm, sensed)
        return total, load / total

    def _between(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """(Rd, Rc + Rs, Rs/(Rc + Rs)), each to be broadcast to (rows, columns)."""
        driven, sensed = of_side(self.driven, *shape)
        total, share = (along(opposite(self.driven), values) for values in self._behind(sensed))
        return along(self.driven, drives_of(self.drive_ohm, driven)), total, share

    def ties(self, measured: Array) -> Array:
        """1/Rd at the driven lines; 1/(Rc + Rs) at the sensed ones, or none."""
        driven, sensed = of_side(self.driven, *measured.shape)
        at_sensed = 1 / self._behind(sensed)[0] if self.sense == "all" else np.zeros(sensed)
        return np.concatenate(of_side(self.driven, 1 / drives_of(self.drive_ohm, driven), at_sensed))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """V = Vcc·Z_ij/Rd_i·Rs_j/(Rc_j + Rs_j)/k_j."""
        shape = mutual.shape
        drive, total, share = (np.broadcast_to(part, shape) for part in self._between(shape))
        volt = mutual * (self.supply_volt * share / drive)
        if self.sense == "all":
            return volt
        _, own = of_side(self.driven, row, column)
        return volt / (own * (1 / total) + 1)

    def apparent_resistance(self, measured: Array) -> Array:
        """Rs·Vcc/V − Rc − Rs − Rd: what the naive divider makes of a reading."""
        drive, total, share = self._between(measured.shape[-2:])
        part = np.clip(measured / self.supply_volt, END, 1 - END)
        return np.asarray(np.maximum(total * (share / part - 1) - drive, LEAST_SHARE * total))

    def uniform_start(self, measured: Array) -> Array:
        """Right where Rd = 0; see `at_ideal_drives`."""
        _, total, share = self._between(measured.shape[-2:])
        return at_ideal_drives(self.driven, measured / (self.supply_volt * share), total)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """See `held_start`."""
        driven, sensed = of_side(self.driven, *measured.shape)
        total, share = self._behind(sensed)
        voltage = measured / (self.supply_volt * along(opposite(self.driven), share))
        drive = drives_of(self.drive_ohm, driven)
        cells = held_start(self, self.driven, voltage, drive, total, near, one=self.sense == "one")
        return np.asarray(np.minimum(cells, upper))

    def nearly_shorted(self, measured: Array) -> Array:
        """A share of the start, too: idle lines at ground make a lone cell of each reading many times too large."""
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Σ_i v_ij ≤ 1, and v_ij + Σ_k v_ik·Rd_i/(Rc_k + Rs_k) ≤ 1; see `held_tests`."""
        drive, total, share = self._between(measured.shape[-2:])
        drop = drive / total if self.sense == "all" else np.zeros(1)
        value, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / (self.supply_volt * share)
        return held_tests(self.driven, value, noise, drop)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """See `most_drive`; with one load at a time each reading says it alone: Rd ≤ (Rc + Rs)(1/v − 1)."""
        _, total, share = self._between(measured.shape[-2:])
        value = np.where(np.isfinite(sigma), measured, 0.0) / (self.supply_volt * share)
        if self.sense == "all":
            return most_drive(self.driven, value, total)
        return float(np.min(np.where(value > 0, total * (1 / np.where(value > 0, value, 1.0) - 1), np.inf)))

    def simulated(self, cell_resistance: Array, scene: "Scene", row_ohm: Array, column_ohm: Array) -> Array:
        """With every line's channel in its drive or sense resistance; no sense_ohm, no channel."""
        drive, sense = with_both_channels(self.drive_ohm, self.sense_ohm, *of_side(self.driven, row_ohm, column_ohm))
        actual = replace(self, drive_ohm=drive, sense_ohm=sense)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """Every Rs·(1 + fraction)."""
        return replace(self, load_ohm=scaled(self.load_ohm, 1 + fraction))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """The drive resistances and the loads; the sense channels are taken as the scene tells them."""
        return (LineNumber("drive_ohm", (self.driven,), channel=True), LineNumber("load_ohm", (opposite(self.driven),)))
