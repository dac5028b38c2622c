"""Loaded columns: a line is driven, the other ones float, and every sensed line has a load."""

from dataclasses import dataclass
from typing import Literal

from lampest.panel.circuit import Diode, Ends, Terminations
from lampest.panel.lines import Groups, PerLine, Side, lines_text, opposite
from lampest.panel.readouts.keys import driven_ends, ends_in_words, ends_with_loads, idle_ends
from lampest.panel.readouts.readout import Readout


@dataclass(frozen=True, kw_only=True)
class LoadedColumnsReadout(Readout):
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
    read_at : 'far_end', or None
        Where the converter reads a sensed line: at the other end of its wire (`Lines`) than its
        load, beyond the last cell. None: at its terminal, where the load is.
    supply_volt, adc_bits, readings, noise_lsb
        See `Readout`.

    The network's reading is the voltage across the load, for either polarity. Raises ValueError if
    a number is out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t = 1/Rs at the
    sensed lines.

    >>> lampest.LoadedColumnsReadout(load_ohm=10000.0).unit
    'volt'
    """

    channels = ("drive_ohm", "")
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
    read_at: Literal["far_end"] | None = None

    def description(self) -> str:
        diode = "" if self.diode is None else f", {self.diode.description()}"
        return (
            f"loaded {opposite(self.driven)}, {self.driven} driven {self.polarity} "
            f"one after the other, {self.supply_volt:g} V, load {lines_text(self.load_ohm)}, "
            f"drive {lines_text(self.drive_ohm)}{diode}{ends_in_words(self)}"
        )

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends: idle driven lines float, loads stay.

        Groups have their loads behind the multiplexers.
        """
        drive = driven_ends(self, driven)
        together = idle_ends(self, drive.ohm)
        idle = Ends.floating(driven)
        stay = self.groups is None
        return ends_with_loads(self, drive, idle, together, sensed, loads_stay=stay)
