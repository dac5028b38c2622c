"""Circuits whose idle driven lines are held at a potential all the time, each through its resistance Rd.

A resistance of zero has no tie; a micro-ohm in its place moves readings by some 1e-8, below what any converter sees.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.driven import END, DrivenReadout, alternated
from lampest.panel.readouts.lines import (
    LEAST_OHM,
    PerLine,
    Side,
    along,
    lines_text,
    of_side,
    opposite,
    parallel,
    per_line,
)
from lampest.panel.readouts.readout import LEAST_SHARE, SHORT_SHARE, FreeTest


def at_least_a_tie(name: str, value: PerLine, lines: int) -> Array:
    """(lines) ohm, never below LEAST_OHM."""
    return np.maximum(per_line(name, value, lines), LEAST_OHM)


class IdleGroundedReadout(DrivenReadout):
    """y = c_j·v_ij, v_ij = Z_ij/Rd_i/k_j: the sensed line's voltage while line i is driven, in units of the supply.

    all_loaded : whether every sensed line has its load Rs_j all the time. Then k_j = 1; else the load is at the line
    that is read alone, and draws it down by k_j = 1 + Z_jj/Rs_j (Sherman and Morrison).
    """

    @property
    def all_loaded(self) -> bool:
        """Unless a kind says otherwise."""
        return True

    @abstractmethod
    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """(Rs, c) of the sensed lines: all that stands between one and ground while it is read, ohm; y/v, volt."""

    def _circuit(self, shape: tuple[int, ...]) -> tuple[Array, Array, Array]:
        """(Rd, Rs, c), each to be broadcast to (rows, columns)."""
        driven, sensed = of_side(self.driven, *shape)
        load, gain = (along(opposite(self.driven), values) for values in self._sensed(sensed))
        return along(self.driven, at_least_a_tie("drive_ohm", self.drive_ohm, driven)), load, gain

    def ties(self, measured: Array) -> Array:
        """1/Rd at the driven lines; 1/Rs at the sensed ones, or none."""
        drive, load, _ = (part.ravel() for part in self._circuit(measured.shape))
        return np.concatenate(of_side(self.driven, 1 / drive, 1 / load if self.all_loaded else np.zeros(len(load))))

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """c_j·Z_ij/Rd_i/k_j."""
        drive, load, gain = (np.broadcast_to(part, mutual.shape) for part in self._circuit(mutual.shape))
        volt = mutual * (gain / drive)
        if self.all_loaded:
            return volt
        _, own = of_side(self.driven, row, column)
        return volt / (own * (1 / load) + 1)

    def _at_ideal_drives(self, share: Array, load: Array) -> Array:
        """r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij: cells (…, rows, columns) ohm that give v where Rd = 0.

        Then no sensed line knows of another, and with its load or without, all others stay as they are.
        """
        along_driven = -2 if self.driven == "rows" else -1
        voltage = np.maximum(share, END * share.max(axis=(-2, -1), keepdims=True))
        rest = 1 - voltage.sum(axis=along_driven, keepdims=True)
        # A rest below zero is noise, or what stands in for a dead line. Then the load counts as one more cell.
        return np.asarray(load * np.where(rest > LEAST_SHARE, rest, 1 / (1 + share.shape[along_driven])) / voltage)

    def uniform_start(self, measured: Array) -> Array:
        """Right where Rd = 0."""
        _, load, gain = self._circuit(measured.shape[-2:])
        return self._at_ideal_drives(measured / gain, load)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Cells (rows, columns) ohm that reproduce the readings: potentials and cells in turn.

        Given cells, the network says where all driven lines p stand while i is driven and j is read, u_p. Given those,
        Σ_p g_pj (u_p − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line. Both in turn converge to cells that
        reproduce the readings: some six rounds, up to 40 where drives are large.
        """
        rows, columns = measured.shape
        by_driven = self.driven == "rows"
        driven_lines, sensed_lines = of_side(self.driven, *np.split(np.arange(rows + columns), [rows]))
        drive, load, gain = self._circuit(measured.shape)
        share = measured / gain
        voltage = (share if by_driven else share.T).T  # (sensed, driven)
        ideal = 1 / self._at_ideal_drives(share, load)
        drive, load, ties = drive.ravel(), load.ravel(), self.ties(measured)

        def next_round(conductance: Array) -> Array:
            potential = self.network(1 / conductance, ties).potentials()
            at_supply = potential[:, driven_lines] / drive  # (line, driven): while the driven one is at 1 volt
            own = np.broadcast_to(at_supply[driven_lines].T, (len(load), len(drive), len(drive)))
            if not self.all_loaded:
                sinking = at_supply[sensed_lines] / (load + np.diag(potential)[sensed_lines])[:, None]
                own = own - sinking[:, :, None] * potential[np.ix_(sensed_lines, driven_lines)][:, None, :]
            cells = np.linalg.solve(own - voltage[:, :, None], (voltage / load[:, None])[:, :, None])[:, :, 0]
            return cells.T if by_driven else cells

        conductance = alternated(ideal, None if near is None else 1 / near, next_round)
        return np.asarray(np.minimum(1 / conductance, upper))

    def nearly_shorted(self, measured: Array) -> Array:
        """A share of the start, too: idle lines at ground make a lone cell of each reading many times too large."""
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured)))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Σ_i v_ij ≤ 1, and v_ij + Σ_k v_ik·Rd_i/Rs_k ≤ 1 with the loads k that are there at once.

        With all driven lines at the supply at once no sensed line stands above it (superposition: Z·t ≤ 1); and none
        stands above the driven one, which lies below the supply by the loads' current through its Rd.
        """
        drive, load, gain = self._circuit(measured.shape[-2:])
        share, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / gain
        drop = drive / load if self.all_loaded else np.zeros(1)
        sensed, driven = self._along_sensed, -3 - self._along_sensed
        below = share + (share * drop).sum(axis=sensed, keepdims=True)
        of_below = np.hypot(noise, np.sqrt(((noise * drop) ** 2).sum(axis=sensed, keepdims=True)))
        tests = {
            "readings of a sensed line add up to no more than the supply": (
                share.sum(axis=driven),
                np.sqrt((noise**2).sum(axis=driven)),
            ),
            "no sensed line stands above the driven one behind its drive_ohm": (below, of_below),
        }
        return tuple(FreeTest(law, _worst(*sides), sides[0][0].size) for law, sides in tests.items())

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Rd ≤ min_i (1 − max_j v_ij)/Σ_j v_ij/Rs_j; with one load at a time of each reading alone Rs (1/v − 1)."""
        _, load, gain = self._circuit(measured.shape[-2:])
        current = np.where(np.isfinite(sigma), measured, 0.0) / gain / load
        left = 1 - current * load
        if self.all_loaded:
            current, left = current.sum(axis=self._along_sensed), left.min(axis=self._along_sensed)
        return float(np.min(np.where(current > 0, left / np.where(current > 0, current, 1.0), np.inf)))


def _worst(share: Array, noise: Array) -> Array:
    """max (share − 1)/σ of every frame, (frames); −∞ where there is no value."""
    excess = np.where(noise > 0, (share - 1) / np.where(noise > 0, noise, 1.0), -np.inf)
    return np.asarray(excess.reshape(len(share), -1).max(axis=1))


@dataclass(frozen=True, kw_only=True)
class GroundedReadout(IdleGroundedReadout):
    """V = Vcc·Z_ij/Rd_i·Rs_j/(Rc_j + Rs_j)/k_j: driven line i at the supply, idle ones at ground, each through its Rd.

    sense: all : every sensed line j has its load Rs_j, behind its channel Rc_j, all the time: ties 1/Rd_i and
    1/(Rc_j + Rs_j), k_j = 1. sense: one : a multiplexer takes the load from one sensed line to the next and leaves the
    idle ones floating: ties 1/Rd_i and none, and k_j = 1 + Z_jj/(Rc_j + Rs_j) is what the load does to the line that
    is read.

    Parameters
    ----------
    driven : the lines that are driven, one after the other. sense : see above.
    polarity : 'up': the driven line is put to the supply, idle ones and loads lead to ground; 'down': the driven line
        is put to ground, idle ones and loads (internal pull-ups) to the supply; the converter then sees Vcc − V.
    load_ohm : Rs, a number or one for each sensed line. drive_ohm : Rd, output and channel of every driven line; a
        number or one for each driven line. Zero is taken for a micro-ohm. sense_ohm : Rc, the channel between every
        sensed line and its load; a number or one for each sensed line.
    input_ohm : input resistance of the converter, parallel to the load; None: none that matters.
    supply_volt, adc_bits, readings, noise_lsb : see `Converter`.

    The network's reading is the voltage across the load, for either polarity. No bound but r > 0 holds: other cells
    raise and lower a reading. Raises ValueError where a number is out of range. Source: node analysis with Z =
    (L(g) + diag(t))⁻¹.

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
        """The circuit and the converter."""
        sensed = opposite(self.driven)
        loads = f"all {sensed} loaded" if self.all_loaded else f"one of the {sensed} loaded, the others floating"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        return (
            f"grounded, {self.driven} driven {self.polarity} while the others are held, {loads}, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, drive {lines_text(self.drive_ohm)}"
            f"{channel}{self._input_text}, {self.converter_description()}"
        )

    @property
    def all_loaded(self) -> bool:
        """sense: all."""
        return self.sense == "all"

    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """(Rc + Rs, Vcc·Rs/(Rc + Rs)), the converter parallel to Rs."""
        load = parallel(per_line("load_ohm", self.load_ohm, lines), self.input_ohm)
        total = load + per_line("sense_ohm", self.sense_ohm, lines)
        return total, self.supply_volt * (load / total)

    def apparent_resistance(self, measured: Array) -> Array:
        """Rs·Vcc/V − Rc − Rs − Rd: what the naive divider makes of a reading."""
        drive, total, gain = self._circuit(measured.shape[-2:])
        volt = np.clip(measured, END * self.supply_volt, (1 - END) * self.supply_volt)
        return np.asarray(np.maximum(total * (gain / volt - 1) - drive, LEAST_SHARE * total))


@dataclass(frozen=True, kw_only=True)
class VirtualGroundReadout(IdleGroundedReadout):
    """V = Rf_j·i_j = Vcc·Rf_j·Z_ij/(Rd_i·Rc_j): driven line i at the supply, all other lines held at ground.

    Idle driven lines are grounded through their Rd. Every sensed line stands at the virtual ground of an amplifier, or,
    while another one is read, at ground, through its channel Rc. The amplifier inverts: its output lies Rf·i_j below
    its reference. What is recorded is how far, a positive number, between 0 and the supply, which is its rail.

    Parameters
    ----------
    driven : the lines that are driven, one after the other.
    drive_ohm : Rd, output and channel of every driven line. sense_ohm : Rc, between every sensed line and the
        amplifier. feedback_ohm : Rf. Each a number or one for each line. Rd and Rc of zero are taken for a micro-ohm.
    supply_volt, adc_bits, readings, noise_lsb : see `Converter`.

    No bound but r > 0 holds: other cells raise and lower a reading. Raises ValueError where a number is out of range.
    Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rd at the driven and 1/Rc at the sensed lines.

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

    def description(self) -> str:
        """The circuit and the converter."""
        return (
            f"virtual ground, {self.driven} driven while all other lines are grounded, {self.supply_volt:g} V, "
            f"drive {lines_text(self.drive_ohm)}, sense {lines_text(self.sense_ohm)}, "
            f"feedback {lines_text(self.feedback_ohm)}, {self.converter_description()}"
        )

    def _sensed(self, lines: int) -> tuple[Array, Array]:
        """(Rc, Vcc·Rf/Rc)."""
        sense = at_least_a_tie("sense_ohm", self.sense_ohm, lines)
        return sense, self.supply_volt * per_line("feedback_ohm", self.feedback_ohm, lines) / sense

    def apparent_resistance(self, measured: Array) -> Array:
        """Rf·Vcc/V − Rd − Rc."""
        drive, sense, gain = self._circuit(measured.shape[-2:])
        whole = gain * sense / np.maximum(measured, END * self.supply_volt)
        return np.asarray(np.maximum(whole - drive - sense, LEAST_SHARE * whole))
