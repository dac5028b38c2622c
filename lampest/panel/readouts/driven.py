"""Circuits that drive the lines of one side, one after the other, each through a resistance, and sense all others.

    V_ij = c_j·U_i·Z_ij/D_i/k_j

U_i : the supply. Idle driven lines are held at ground through their Rd, ties 1/Rd and D_i = Rd_i, or float, no ties and
D_i = Rd_i + Z_ii. All sensed lines have their loads all the time, ties 1/Rs and k_j = 1, or the one that is read alone,
no ties and k_j = 1 + Z_jj/Rs_j (Sherman and Morrison). c_j : share of a sensed line's voltage at the converter.
"""

from abc import abstractmethod
from dataclasses import replace
from math import inf
from typing import Any, ClassVar, Literal, Self

import numpy as np

from lampest.panel.network import inverse_of
from lampest.panel.panel import Array
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
    per_line,
    with_channels,
)
from lampest.panel.readouts.readout import MIN_LOAD_SHARE, SHORT_SHARE, FreeTest, Readout, Surroundings

OPEN_SHARE = 1e-9  # share of the supply below which a reading shows an open cell
# Alternating start: rounds, change of log g at convergence, and range of conductances about those of the closed form,
# beyond which a reading no longer depends on its cell (tests/oracles).
MAX_ROUNDS, CONVERGED, MIN_RATIO, MAX_RATIO = 40, 1e-3, 0.02, 1e3


class DrivenReadout(Readout):
    """Base of the circuits; kinds are dataclasses that declare their keys in the order of files.

    Attributes
    ----------
    driven : {'rows', 'columns'}
        Side that is driven.
    drive_ohm : float, or one for each driven line
        Rd.
    sense_ohm : float, or one for each sensed line
        Channels of the sensed lines.
    polarity : {'up', 'down'}
        Whether loads lead to ground or to the supply.
    input_ohm : float, or None
        Input resistance of the converter.
    of_sensed : tuple of str
        Keys of resistances of sensed lines; the first is the reference of a reading.
    idle_floats : bool
        Whether idle driven lines float, or are held at ground.
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
        """Voltage that a driven line is put to, before its resistance."""
        return self.supply_volt

    @property
    def all_loaded(self) -> bool:
        """Whether every sensed line has its load all the time."""
        return True

    @abstractmethod
    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """(Rs, c) of the sensed lines: all that stands between one and ground while it is read, ohm; and c."""

    def _supply(self, resistance: Any) -> Any:
        """U of a resistance D, volt; arrays and CasADi alike."""
        return self.driving_volt

    def _lost(self, current: Array) -> Array:
        """Vcc − U of a current through the driven line."""
        return np.zeros(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("drive_ohm", *self.of_sensed):
            check_resistors(name, getattr(self, name), open_end=name not in ("drive_ohm", "sense_ohm"))
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as every kind does, and unless a list has one resistance for each line."""
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        for name in ("drive_ohm", *self.of_sensed):
            per_line(name, getattr(self, name), driven if name == "drive_ohm" else sensed)

    @property
    def _end_text(self) -> str:
        """The end of descriptions."""
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
        """The axis from one sensed line to the next."""
        return -1 if self.driven == "rows" else -2

    def _circuit(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """(Rd, Rs, c), each to be broadcast to (rows, columns)."""
        driven, sensed = of_side(self.driven, *shape)
        load, gain = (along(opposite(self.driven), values) for values in self._sensed(sensed))
        drive = along(self.driven, per_line("drive_ohm", self.drive_ohm, driven))
        return drive if self.idle_floats else np.maximum(drive, MIN_OHM), load, gain

    def ties(self, measured: Array) -> Array:
        """1/Rd at the driven lines or none; 1/Rs at the sensed ones or none."""
        drive, load, _ = (part.ravel() for part in self._circuit(measured.shape))
        held = np.zeros(len(drive)) if self.idle_floats else 1 / drive
        return np.concatenate(of_side(self.driven, held, 1 / load if self.all_loaded else np.zeros(len(load))))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """c_j·U_i·Z_ij/D_i/k_j."""
        drive, load, gain = (np.broadcast_to(part, mutual.shape) for part in self._circuit(mutual.shape))
        driven, sensed = of_side(self.driven, row, column)
        if self.idle_floats:
            resistance = driven + drive
            volt = mutual * gain * self._supply(resistance) / resistance
        else:
            volt = mutual * (self.driving_volt * gain / drive)
        return volt if self.all_loaded else volt / (sensed * (1 / load) + 1)

    def apparent_resistance(self, measured: Array) -> Array:
        """Return Rs·((Vcc − V_d)·c/V − 1) − Rd, the naive divider's resistance of a reading."""
        drive, load, gain = self._circuit(measured.shape[-2:])
        volt = np.maximum(measured / gain, OPEN_SHARE * self.driving_volt)
        whole = load * (self.driving_volt - self._lost(volt / load)) / volt
        return np.asarray(np.maximum(whole - load - drive, MIN_LOAD_SHARE * whole))

    def uniform_start(self, measured: Array) -> Array:
        """Return r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij (…, rows, columns) ohm of idle lines at ground, right where Rd = 0.

        Then no sensed line depends on another, and with its load or without, all others stay as they are.
        """
        if self.idle_floats:
            return super().uniform_start(measured)
        _, load, gain = self._circuit(measured.shape[-2:])
        driven = -3 - self._along_sensed
        share = measured / (self.driving_volt * gain)
        share = np.maximum(share, OPEN_SHARE * share.max(axis=(-2, -1), keepdims=True))
        remainder = 1 - share.sum(axis=driven, keepdims=True)
        # A negative remainder is noise, or the substitute of a dead line. Then the load counts as one more cell.
        return np.asarray(load * np.where(remainder > MIN_LOAD_SHARE, remainder, 1 / (1 + share.shape[driven])) / share)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells (rows, columns) ohm that reproduce the readings: potentials and cells in turn.

        Given cells, all driven lines p stand at u_p while i is driven and j is read. Given those, Σ_p g_pj (u_p − v_ij)
        = v_ij/Rs_j is linear in the cells of one sensed line. Both in turn converge to cells that reproduce the
        readings: some six rounds, up to 40 where drives are large. A start, not an estimate: within MIN_RATIO and
        MAX_RATIO of the uniform start's.
        """
        drive, load, gain = self._circuit(measured.shape)
        volt, ideal = self._turned(measured / gain), self._turned(1 / self.uniform_start(measured))
        drive, load = drive.ravel(), load.ravel()
        conductance = ideal if near is None else np.clip(self._turned(1 / near), MIN_RATIO * ideal, MAX_RATIO * ideal)
        for _ in range(MAX_ROUNDS):
            potentials, before = self._driven_potentials(conductance, volt, drive, load), conductance
            solved = np.linalg.solve(potentials - volt.T[:, :, None], (volt / load).T[:, :, None])[:, :, 0].T
            conductance = np.clip(solved, MIN_RATIO * ideal, MAX_RATIO * ideal)
            if np.abs(np.log(conductance / before)).max() < CONVERGED:
                break
        return np.asarray(np.minimum(self._turned(1 / conductance), upper))

    def _turned(self, values: Array) -> Array:
        """(rows, columns) → (driven, sensed), or back."""
        return values if self.driven == "rows" else values.T

    def _driven_potentials(self, conductance: Array, volt: Array, drive: Array, load: Array) -> Array:
        """Return u (sensed, driven, driven) volt of driven lines p, the last axis, while j is read and i is driven.

        Parameters
        ----------
        conductance, volt : array
            (driven, sensed) siemens, and voltages of sensed lines.
        drive, load : array
            Rd and Rs.
        """
        count = len(drive)
        impedance = inverse_of(conductance, np.concatenate([1 / drive, 1 / load if self.all_loaded else 0 * load]))
        at_supply = impedance[:, :count] * (self.driving_volt / drive)
        own = np.broadcast_to(at_supply[:count].T, (len(load), count, count))
        if self.all_loaded:
            return own
        sinking = at_supply[count:] / (load + np.diag(impedance)[count:])[:, None]
        return np.asarray(own - sinking[:, :, None] * impedance[count:, None, :count])

    def nearly_shorted(self, measured: Array) -> Array:
        """Return shorts, bounded by a share of the start: idle lines at ground make lone cells many times too large."""
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured)))

    def _driven_volt(self, current: Array, drive: Array | float) -> Array:
        """Vcc − Rd I − V_d(I): where a driven line stands while it takes a current, any shape."""
        return np.asarray(self.driving_volt - drive * current - self._lost(current))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Test v_ij ≤ Vcc − Rd_i Σ_k v_ik/Rs_k over the simultaneous loads k; with idle lines at ground Σ_i v_ij ≤ Vcc.

        No sensed line stands above the driven one, which lies below the supply by the loads' current through its Rd.
        With all driven lines at the supply at once no sensed line stands above it (superposition: Z·t ≤ 1).
        """
        drive, load, gain = self._circuit(measured.shape[-2:])
        volt, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / gain
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
        """Rd ≤ min_i (Vcc − V_d − max_j v_ij)/Σ_j v_ij/Rs_j; with one load at a time, of each reading alone."""
        _, load, gain = self._circuit(measured.shape[-2:])
        volt = np.where(np.isfinite(sigma), measured, 0.0) / gain
        current = volt / load
        if self.all_loaded:
            volt, current = volt.max(axis=self._along_sensed), current.sum(axis=self._along_sensed)
        drop = self._driven_volt(current, 0.0) - volt
        return float(np.min(np.where(current > 0, drop / np.where(current > 0, current, 1.0), np.inf)))

    def simulated(self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array) -> Array:
        """Simulate with every line's channel in its drive or sense resistance; no sense_ohm, no channel."""
        actual = self.with_channels(row_ohm, column_ohm)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def with_channels(self, row_ohm: Array, column_ohm: Array) -> Self:
        """Return the circuit with additional resistances in every line's channel, ohm."""
        driven, sensed = of_side(self.driven, row_ohm, column_ohm)
        changes: dict[str, Any] = {"drive_ohm": with_channels("drive_ohm", self.drive_ohm, driven)}
        if self.sense_ohm:
            changes["sense_ohm"] = with_channels("sense_ohm", self.sense_ohm, sensed)
        return replace(self, **changes)

    def off_by(self, fraction: float) -> Self:
        """Return the readout with every reference times 1 + fraction."""
        name = self.of_sensed[0]
        value: PerLine = getattr(self, name)
        larger = tuple(number * (1 + fraction) for number in as_tuple(value))
        changes: dict[str, Any] = {name: larger if isinstance(value, tuple) else larger[0]}
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Return the drive resistances, which may be channels alone, and the references; sense channels are fixed."""
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        return drive, LineNumber(self.of_sensed[0], (opposite(self.driven),))
