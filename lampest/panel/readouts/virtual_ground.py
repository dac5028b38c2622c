"""Virtual ground: every line is held at a potential all the time, and amplifiers read the sensed lines' currents."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.free_test import FreeTest
from lampest.panel.readouts.held import (
    LEAST_DRIVE,
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
    per_line,
    scaled,
)
from lampest.panel.readouts.readout import LEAST_SHARE, SHORT_SHARE, Readout

if TYPE_CHECKING:
    from lampest.panel.scene import Scene

END = 1e-9  # of the largest current that a drive can give: a reading so small says that a cell is open


@dataclass(frozen=True, kw_only=True)
class VirtualGroundReadout(Readout):
    """V = Rf_j·i_j = Vcc·Rf_j·Z_ij/(Rd_i·Rc_j): driven line i at the supply, all other lines held at ground.

    Idle driven lines are grounded through their Rd. Every sensed line stands at the virtual ground of an amplifier, or,
    while another one is read, at ground, through its channel Rc. The amplifier inverts: its output lies Rf·i_j below
    its reference. What is recorded is how far, a positive number, between 0 and the supply, which is its rail.

    Parameters
    ----------
    driven : the lines that are driven, one after the other.
    drive_ohm : Rd, output and channel of every driven line. sense_ohm : Rc, between every sensed line and the
        amplifier. feedback_ohm : Rf. Each a number or one for each line. Rd and Rc of zero are taken for a micro-ohm.
    supply_volt, adc_bits, readings, noise_lsb : the converter; see `Readout`.

    No bound but r > 0 holds: other cells raise and lower a reading. Raises ValueError where a number is out of range.
    Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rd at the driven and 1/Rc at the sensed lines.
    """

    signal_name: ClassVar[str] = "output of the amplifier below its reference"
    kind: Literal["virtual_ground"] = "virtual_ground"
    driven: Side = "rows"
    drive_ohm: PerLine = 50.0
    sense_ohm: PerLine = 0.0
    feedback_ohm: PerLine = 1000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_resistors("drive_ohm", self.drive_ohm, open_end=False)
        check_resistors("sense_ohm", self.sense_ohm, open_end=False)
        check_resistors("feedback_ohm", self.feedback_ohm)

    def check(self, scene: "Scene") -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        per_line("drive_ohm", self.drive_ohm, driven)
        per_line("sense_ohm", self.sense_ohm, sensed)
        per_line("feedback_ohm", self.feedback_ohm, sensed)

    def description(self) -> str:
        """The circuit and the converter."""
        return (
            f"virtual ground, {self.driven} driven while all other lines are grounded, {self.supply_volt:g} V, "
            f"drive {lines_text(self.drive_ohm)}, sense {lines_text(self.sense_ohm)}, "
            f"feedback {lines_text(self.feedback_ohm)}, {self.converter_description()}"
        )

    @property
    def noisy_side(self) -> Side:
        """The driven one."""
        return self.driven

    def _of_lines(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """(Rd, Rc, Rf), each to be broadcast to (rows, columns)."""
        (driven, sensed), other = of_side(self.driven, *shape), opposite(self.driven)
        feedback = per_line("feedback_ohm", self.feedback_ohm, sensed)
        drive, sense = drives_of(self.drive_ohm, driven), self._senses(sensed)
        return along(self.driven, drive), along(other, sense), along(other, feedback)

    def _senses(self, sensed: int) -> Array:
        return np.maximum(per_line("sense_ohm", self.sense_ohm, sensed), LEAST_DRIVE)

    def ties(self, measured: Array) -> Array:
        """1/Rd at the driven lines, 1/Rc at the sensed ones."""
        driven, sensed = of_side(self.driven, *measured.shape)
        return np.concatenate(of_side(self.driven, 1 / drives_of(self.drive_ohm, driven), 1 / self._senses(sensed)))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """V = Vcc·Rf_j·Z_ij/(Rd_i·Rc_j)."""
        shape = mutual.shape
        drive, sense, feedback = (np.broadcast_to(part, shape) for part in self._of_lines(shape))
        return mutual * (self.supply_volt * feedback / (drive * sense))

    def apparent_resistance(self, measured: Array) -> Array:
        """Rf·Vcc/V − Rd − Rc."""
        drive, sense, feedback = self._of_lines(measured.shape[-2:])
        whole = feedback * self.supply_volt / np.maximum(measured, END * self.supply_volt)
        return np.asarray(np.maximum(whole - drive - sense, LEAST_SHARE * whole))

    def uniform_start(self, measured: Array) -> Array:
        """Right where Rd = 0; see `at_ideal_drives`."""
        _, sense, feedback = self._of_lines(measured.shape[-2:])
        return at_ideal_drives(self.driven, measured * sense / (feedback * self.supply_volt), sense)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """See `held_start`."""
        driven, sensed = of_side(self.driven, *measured.shape)
        _, sense, feedback = self._of_lines(measured.shape)
        voltage, drive = measured * sense / (feedback * self.supply_volt), drives_of(self.drive_ohm, driven)
        cells = held_start(self, self.driven, voltage, drive, self._senses(sensed), near, one=False)
        return np.asarray(np.minimum(cells, upper))

    def nearly_shorted(self, measured: Array) -> Array:
        """A share of the start, too."""
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Σ_i v_ij ≤ 1, and v_ij + Σ_k v_ik·Rd_i/Rc_k ≤ 1 of v = V·Rc/(Rf·Vcc); see `held_tests`."""
        drive, sense, feedback = self._of_lines(measured.shape[-2:])
        value, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) * (sense / (feedback * self.supply_volt))
        return held_tests(self.driven, value, noise, drive / sense)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """See `most_drive`."""
        _, sense, feedback = self._of_lines(measured.shape[-2:])
        value = np.where(np.isfinite(sigma), measured, 0.0) * (sense / (feedback * self.supply_volt))
        return most_drive(self.driven, value, sense)

    def simulated(self, cell_resistance: Array, scene: "Scene", row_ohm: Array, column_ohm: Array) -> Array:
        """With every line's channel in its drive or sense resistance; no sense_ohm, no channel."""
        drive, sense = with_both_channels(self.drive_ohm, self.sense_ohm, *of_side(self.driven, row_ohm, column_ohm))
        actual = replace(self, drive_ohm=drive, sense_ohm=sense)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def off_by(self, fraction: float) -> Self:
        """Every Rf·(1 + fraction)."""
        return replace(self, feedback_ohm=scaled(self.feedback_ohm, 1 + fraction))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """The drive and the feedback resistances; the sense channels are taken as the scene tells them."""
        return (
            LineNumber("drive_ohm", (self.driven,), channel=True),
            LineNumber("feedback_ohm", (opposite(self.driven),)),
        )
