"""Circuits that drive the lines of one side, one after the other, each through a resistance, and sense the other side.

    V_ij = c_j·U_i·Z_ij/D_i/k_j

U_i is the supply, and c_j the share of a sensed line's voltage at the converter. Idle driven lines either are held at
ground through their Rd (ties 1/Rd, D_i = Rd_i), or float (no ties, D_i = Rd_i + Z_ii). Either all sensed lines have
their loads all the time (ties 1/Rs, k_j = 1), or only the one that is read (no ties, k_j = 1 + Z_jj/Rs_j by Sherman and
Morrison's formula).
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
        whole = load * (self.driving_volt - self._lost(volt / load)) / volt
        return np.asarray(np.maximum(whole - load - drive, MIN_LOAD_SHARE * whole))

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
        own = np.broadcast_to(at_supply[:count].T, (len(load), count, count))
        if self.all_loaded:
            return own
        # Sherman–Morrison: the load of line j draws V_j/(Rs_j + Z_jj), which lowers u_p by Z_jp times this current.
        sinking = at_supply[count:] / (load + np.diag(impedance)[count:])[:, None]
        return np.asarray(own - sinking[:, :, None] * impedance[count:, None, :count])

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
