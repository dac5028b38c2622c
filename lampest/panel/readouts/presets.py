"""Circuits that many people build, as presets of the equation of driven circuits.

Each preset is a choice of idle states.
"""

from dataclasses import dataclass
from math import inf
from typing import ClassVar, Literal

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.diode import Diode
from lampest.panel.readouts.driven import DrivenCircuit, SourcedCircuit
from lampest.panel.readouts.equation import LineStates
from lampest.panel.readouts.lines import (
    MIN_OHM,
    Groups,
    PerLine,
    Side,
    lines_text,
    opposite,
    parallel,
    per_line,
)
from lampest.panel.readouts.potentials import FOLLOWS


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(DrivenCircuit):
    """Loaded columns: one line is driven, all sensed lines are loaded.

    All other driven lines float. V = Vcc·Z_ij/(Rd_i + Z_ii) for driven line i and sensed line j
    with its load Rs_j. With a diode it is V = U·Z_ij/(Rd_i + Z_ii), U the remaining voltage; see
    `Diode.resistor_volt`.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    polarity : {'up', 'down'}
        'up': the driven line is at the supply and loads lead to ground; 'down': the driven line is
        at ground and loads lead to the supply (internal pull-ups), so that the voltage at the
        converter is Vcc − V.
    load_ohm : PerLine
        Rs in ohm, a number or one for each sensed line.
    drive_ohm : PerLine
        Rd in ohm, between the supply and the driven line, including the channel; a number or one
        for each driven line.
    diode : Diode, or None
        Diode in series with Rd.
    input_ohm : float, or None
        Input resistance of the converter to ground in ohm, at every load; None: negligible.
    groups : tuple of tuple of int, or None
        Sensed lines behind one multiplexer each, with their load behind it; one line of each group
        is read at every address, and idle ones float. None: the loads stay.
    driven_groups : tuple of tuple of int, or None
        Driven lines behind one multiplexer each. While line k of a group is driven, line k of every
        other group ends in drive_ohm at idle_volt; all other driven lines float.
    load_volt : float, or None
        Potential in which the loads end, in volt; None: ground, or the supply with polarity: down.
    idle_volt : float, or None
        Potential of the lines of other groups that are held with driven_groups.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError if
    a number is out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the
    sensed lines.

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
    groups: Groups | None = None
    driven_groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None

    @property
    def idle_connected(self) -> bool:
        return self.driven_groups is not None

    @property
    def loads_connected(self) -> tuple[bool, bool]:
        return True, False

    def description(self) -> str:
        diode = "" if self.diode is None else f", {self.diode.description()}"
        return (
            f"loaded {opposite(self.driven)}, {self.driven} driven {self.polarity} "
            f"one after the other, {self.supply_volt:g} V, load {lines_text(self.load_ohm)}, "
            f"drive {lines_text(self.drive_ohm)}{diode}{self._end_text}"
        )

    def states(self, driven: int, sensed: int) -> LineStates:
        """Return the states: idle driven lines float, loads stay.

        Groups have their loads behind the multiplexers.
        """
        load = parallel(per_line("load_ohm", self.load_ohm, sensed), self.input_ohm)
        idle_load = load if self.groups is None else np.full(sensed, inf)
        drive = per_line("drive_ohm", self.drive_ohm, driven)
        share = self.load_shares(sensed)
        return LineStates(drive, np.full(driven, inf), load, idle_load, np.ones(sensed), share)


@dataclass(frozen=True, kw_only=True)
class GroundedReadout(DrivenCircuit):
    """Grounded readout: driven line i is at the supply, idle driven lines at ground.

    Each is connected through its Rd. V = Vcc·Z_ij/Rd_i·Rs_j/(Rc_j + Rs_j)/k_j. With sense: all,
    every sensed line j has its load Rs_j, behind its channel Rc_j, all the time: ties 1/Rd_i and
    1/(Rc_j + Rs_j), k_j = 1. With sense: one, a multiplexer connects the load to one sensed line
    after the other, and idle sensed lines float: ties 1/Rd_i only, and k_j = 1 + Z_jj/(Rc_j + Rs_j)
    is the effect of the load on the line that is read.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    sense : {'all', 'one'}
        Loads that are connected at the same time, see above.
    polarity : {'up', 'down'}
        'up': the driven line is at the supply, idle ones and loads lead to ground; 'down': the
        driven line is at ground, idle ones and loads (internal pull-ups) lead to the supply, and
        the voltage at the converter is Vcc − V.
    load_ohm : PerLine
        Rs in ohm, a number or one for each sensed line.
    drive_ohm : PerLine
        Rd in ohm, output and channel of every driven line; a number or one for each driven line.
        Zero counts as a micro-ohm.
    sense_ohm : PerLine
        Rc in ohm, the channel between every sensed line and its load; a number or one for each
        sensed line.
    input_ohm : float, or None
        Input resistance of the converter to ground in ohm, at the load; None: negligible.
    groups : tuple of tuple of int, or None
        Sensed lines behind one multiplexer each, with their load behind it; one line of each group
        is read at every address, and idle ones float, as with sense: one. None: as `sense` says.
    idle_volt : float or {'follows'}, or None
        Potential in which idle driven lines end, in volt; 'follows': that of the sensed line, as
        with voltage feedback. None: ground, or the supply with polarity: down.
    load_volt : float, or None
        Potential in which the loads end, in volt; None: ground, or the supply with polarity: down.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    The network's reading is the voltage across the load, for either polarity. No bound except r > 0
    holds, because other cells can increase and decrease a reading. Raises ValueError if a number is
    out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹.

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
    groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None

    @property
    def loads_connected(self) -> tuple[bool, bool]:
        return True, False

    def description(self) -> str:
        sensed = opposite(self.driven)
        loads = f"one of the {sensed} loaded, the others floating"
        if self.all_loaded:
            loads = f"all {sensed} loaded"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        return (
            f"grounded, {self.driven} driven {self.polarity} while the others are held, {loads}, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, "
            f"drive {lines_text(self.drive_ohm)}{channel}{self._end_text}"
        )

    @property
    def all_loaded(self) -> bool:
        """Whether every sensed line has its load all the time."""
        return self.sense == "all" and self.groups is None

    def states(self, driven: int, sensed: int) -> LineStates:
        """Return the states: idle driven lines are at ground through their Rd.

        Idle sensed lines are loaded or floating.
        """
        drive = np.maximum(per_line("drive_ohm", self.drive_ohm, driven), MIN_OHM)
        load = parallel(per_line("load_ohm", self.load_ohm, sensed), self.input_ohm)
        total = load + per_line("sense_ohm", self.sense_ohm, sensed)
        idle_load = total if self.all_loaded else np.full(sensed, inf)
        share = self.load_shares(sensed)
        return LineStates(drive, drive, total, idle_load, load / total, share)


@dataclass(frozen=True, kw_only=True)
class VirtualGroundReadout(SourcedCircuit):
    """Virtual-ground readout: driven line i is at the voltage U.

    All other lines are held at ground. V = Rf_j·i_j = U·Rf_j·Z_ij/(Rd_i·Rc_j). Idle driven lines
    are grounded through their Rd. Every sensed line is at the virtual ground of an amplifier,
    through its channel Rc, or at ground while another one is read. The amplifier inverts: its
    output is Rf·i_j below its reference. The recorded value is this difference, a positive number
    from 0 to the end of the converter's range. Both ends are rails.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    drive_ohm : PerLine
        Rd in ohm, output and channel of every driven line.
    sense_ohm : PerLine
        Rc in ohm, between every sensed line and the amplifier.
    feedback_ohm : PerLine
        Rf in ohm. Each resistance is a number or one for each line; Rd and Rc of zero count as a
        micro-ohm.
    drive_volt : float, or None
        U in volt; None: supply_volt.
    converter_volt : float, or None
        End of the converter's range in volt; None: supply_volt.
    idle_volt : float or {'follows'}, or None
        Potential in which idle driven lines end, in volt; 'follows': that of the sensed line, as
        with voltage feedback. None: ground, or the supply with polarity: down.
    load_volt, idle_load_volt : float, or None
        Reference of the amplifiers, and potential of idle sensed lines, in volt. None: ground, and
        load_volt.
    supply_volt, adc_bits, readings, noise_lsb
        See `Converter`.

    No bound except r > 0 holds, because other cells can increase and decrease a reading. Raises
    ValueError if a number is out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t =
    1/Rd at the driven and 1/Rc at the sensed lines.

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
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None
    idle_load_volt: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = self.line_ends
        others = [ends.idle_load] if ends.idle == FOLLOWS else [ends.idle, ends.idle_load]
        if min(ends.sign * (float(volt) - ends.load) for volt in others) < 0:
            raise ValueError(
                "idle_volt and idle_load_volt must not lie on the other side of load_volt than "
                "the source: amplifiers then have currents of both signs, which this model lacks"
            )

    @property
    def recorded_reference_volt(self) -> float:
        return 0.0

    def _end_volt(self, load_volt: Array) -> Array:
        """Return 0: an amplifier without current is at its reference."""
        return 0.0 * load_volt

    def description(self) -> str:
        return (
            f"virtual ground, {self.driven} driven to {self.driving_volt:g} V "
            f"while all other lines are grounded, converter to {self.full_scale_volt:g} V, "
            f"drive {lines_text(self.drive_ohm)}, sense {lines_text(self.sense_ohm)}, "
            f"feedback {lines_text(self.feedback_ohm)}{self._end_text}"
        )

    def states(self, driven: int, sensed: int) -> LineStates:
        """Return the states: all lines at ground through their channels, all the time.

        c is Rf/Rc.
        """
        drive = np.maximum(per_line("drive_ohm", self.drive_ohm, driven), MIN_OHM)
        channel = np.maximum(per_line("sense_ohm", self.sense_ohm, sensed), MIN_OHM)
        feedback = per_line("feedback_ohm", self.feedback_ohm, sensed)
        return LineStates(drive, drive, channel, channel, feedback / channel)
