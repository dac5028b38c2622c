"""The circuit that a scene describes by the states of its lines, where no preset names them."""

from dataclasses import dataclass
from math import inf
from typing import Literal

from lampest.panel.circuit import FOLLOWS, Diode, Terminations
from lampest.panel.lines import (
    Groups,
    PerLine,
    Side,
    as_tuple,
    lines_text,
    opposite,
    per_line,
)
from lampest.panel.readouts.keys import driven_ends, ends_in_words, ends_with_loads, idle_ends
from lampest.panel.readouts.readout import Readout


@dataclass(frozen=True, kw_only=True)
class DrivenReadout(Readout):
    """Circuit with driven and sensed lines, named by the resistances of its lines.

    Each resistance holds while a line is used, or while it is idle. Loaded columns, grounded lines
    and virtual grounds are presets of this circuit. The equation stands in
    `lampest.panel.equation`.

    Attributes
    ----------
    driven : Side
        Side whose lines are driven, one after the other.
    polarity : {'up', 'down'}
        'up': the driven line is at the source, idle ones and loads lead to ground; 'down': the
        driven line is at ground, idle ones and loads lead to the supply, and the voltage at the
        converter is Vcc − V.
    drive_ohm : PerLine
        Rd in ohm, between the source and the driven line.
    idle_ohm : PerLine
        Rp in ohm, between an idle driven line and ground: a resistor, an output at LOW, 0 if it is
        held without any resistance, infinite if it floats.
    idle_stays : bool
        Whether the resistors idle_ohm stay at their lines while these are driven, as pull-downs
        behind a multiplexer do. With `driven_groups` every line has one.
    load_ohm : PerLine
        Rs in ohm, between a sensed line and ground while it is read, behind its channel; infinite:
        none.
    sense_ohm : PerLine
        Rc in ohm, the channel between a sensed line and its load.
    idle_load_ohm : PerLine or None
        Rq in ohm, between an idle sensed line and ground: 0, a resistor, or infinite. None: the
        load stays; with `groups`, whose multiplexers take it along, infinite.
    groups : tuple of tuple of int, or None
        Sensed lines behind one multiplexer each, in the order of its addresses. At every address
        one line of each group is read. None: at every address one line is read.
    driven_groups : tuple of tuple of int, or None
        Driven lines behind one multiplexer each. While line k of a group is driven, line k of every
        other group ends in drive_ohm at idle_volt; all other driven lines float.
    idle_volt : float or {'follows'}, or None
        Potential in which idle driven lines end, in volt; 'follows': that of the sensed line, as
        with voltage feedback. None: ground, or the supply with polarity: down.
    load_volt, idle_load_volt : float, or None
        Potential in which a load ends, and an idle sensed line, in volt. None: ground, or the
        supply with polarity: down, and load_volt.
    offset_volt : PerLine, or None
        Voltage that the amplifier of each sensed line adds to what is recorded.
    diode : Diode, or None
        Diode in series with Rd.
    drive_volt, converter_volt : float, or None
        Source, and end of the converter's range, in volt; None: supply_volt.
    input_ohm : float, or None
        Input resistance of the converter to ground in ohm, at the load; None: negligible.
    read_at : 'far_end', or None
        Where the converter reads a sensed line: at the other end of its wire (`Lines`) than its
        load, beyond the last cell. None: at its terminal, where the load is.
    supply_volt, adc_bits, readings, noise_lsb
        See `Readout`.

    A resistance is a number, or one for each line. Raises ValueError if a number is out of range,
    or if readings do not depend on the cells or on their common scale. Source: node analysis.

    >>> lampest.DrivenReadout(load_ohm=1000.0, idle_ohm=3300.0, idle_load_ohm=float("inf")).unit
    'volt'
    """

    of_sensed = ("load_ohm", "sense_ohm", "idle_load_ohm")
    of_driven = ("drive_ohm", "idle_ohm")
    may_be_zero = ("drive_ohm", "sense_ohm", "idle_ohm", "idle_load_ohm")
    may_be_infinite = ("load_ohm", "idle_ohm", "idle_load_ohm")
    channels = ("drive_ohm", "sense_ohm")
    kind: Literal["driven"] = "driven"
    driven: Side = "rows"
    polarity: Literal["up", "down"] = "up"
    drive_ohm: PerLine = 0.0
    idle_ohm: PerLine = inf
    idle_stays: bool = False
    load_ohm: PerLine = 10_000.0
    sense_ohm: PerLine = 0.0
    idle_load_ohm: PerLine | None = None
    groups: Groups | None = None
    driven_groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None
    idle_load_volt: float | None = None
    offset_volt: PerLine | None = None
    diode: Diode | None = None
    drive_volt: float | None = None
    converter_volt: float | None = None
    input_ohm: float | None = None
    read_at: Literal["far_end"] | None = None

    def __post_init__(self) -> None:
        if self.idle_stays:
            ohm = as_tuple(self.idle_ohm) or (inf,)
            if max(ohm) == inf:
                raise ValueError("idle_stays: idle_ohm names no resistor that could stay")
            if min(ohm) == 0:
                raise ValueError(
                    "idle_stays: a line that 0 ohm hold cannot be driven; see idle_ohm"
                )
            if self.idle_volt == FOLLOWS:
                raise ValueError("idle_stays has no place with idle_volt: follows")
            if self.diode is not None:
                raise ValueError(
                    "idle_stays: a diode beside resistors that stay is not in this model"
                )
        super().__post_init__()
        if self.polarity == "down" and (
            self.drive_volt is not None or self.converter_volt is not None
        ):
            raise ValueError(
                "drive_volt and converter_volt have no place with polarity: down, "
                "where the driven line is at ground"
            )
        pulled = min(as_tuple(self.idle_ohm)) < inf and not self.idle_stays
        if self.driven_groups is not None and pulled:
            raise ValueError(
                "idle_ohm has no place with driven_groups, whose other lines float: leave it out, "
                "or say that resistors stay at all lines (idle_stays: true)"
            )
        to_ground = [
            *(as_tuple(self.idle_ohm) if self.driven_groups is None else as_tuple(self.drive_ohm)),
            *as_tuple(self.load_ohm),
            inf if self.input_ohm is None else self.input_ohm,
        ]
        some_idle = self.groups is None or max(map(len, self.groups)) > 1
        if self.idle_load_ohm is not None and some_idle:
            to_ground += as_tuple(self.idle_load_ohm)
        if min(to_ground) == inf:
            raise ValueError(
                "load_ohm, idle_ohm and idle_load_ohm are all infinite: "
                "no current flows through any cell; name the resistors that lead to ground"
            )
        if not any(0 < ohm < inf for ohm in (*to_ground, *as_tuple(self.drive_ohm))):
            raise ValueError(
                "drive_ohm, idle_ohm, load_ohm and idle_load_ohm name no resistor: "
                "readings then depend on ratios of cells alone"
            )

    def description(self) -> str:
        diode = "" if self.diode is None else f", {self.diode.description()}"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        source = "" if self.drive_volt is None else f" from {self.drive_volt:g} V"
        load = (
            "loads stay"
            if self.idle_load_ohm is None
            else f"idle {opposite(self.driven)} {_state(self.idle_load_ohm)}"
        )
        if self.idle_load_ohm is None and self.groups is not None:
            load = f"idle {opposite(self.driven)} float"
        return (
            f"{self.driven} driven {self.polarity}{source} "
            f"one after the other through {lines_text(self.drive_ohm)}, "
            f"idle ones {_state(self.idle_ohm)}{' all the time' if self.idle_stays else ''}, "
            f"load {lines_text(self.load_ohm)}{channel}, {load}, "
            f"{self.supply_volt:g} V{diode}{ends_in_words(self)}"
        )

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends that the keys state."""
        drive = driven_ends(self, driven)
        together = idle_ends(self, drive.ohm)
        idle = idle_ends(self, per_line("idle_ohm", self.idle_ohm, driven))
        if self.idle_stays:
            drive = drive.beside(idle)
            together = together.beside(idle)
        stay = self.idle_load_ohm is None and self.groups is None
        return ends_with_loads(self, drive, idle, together, sensed, loads_stay=stay)


def _state(ohm: PerLine) -> str:
    """Return 'float', 'are held at ground', or the resistance from idle lines to ground."""
    states = {inf: "float", 0.0: "are held at ground"}
    return states.get(max(as_tuple(ohm)), f"at ground through {lines_text(ohm)}")
