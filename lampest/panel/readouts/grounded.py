"""Grounded lines: a line is driven, the other ones of its side are held at ground."""

from dataclasses import dataclass
from typing import Literal

from lampest.panel.circuit import Terminations
from lampest.panel.lines import MIN_OHM, Groups, PerLine, Side, lines_text, opposite
from lampest.panel.readouts.keys import driven_ends, ends_in_words, ends_with_loads, idle_ends
from lampest.panel.readouts.readout import Readout


@dataclass(frozen=True, kw_only=True)
class GroundedReadout(Readout):
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
    idle_load_ohm : PerLine, or None
        Rq in ohm, between an idle sensed line and the end of the loads, with sense: one: 0 of an
        output at LOW. None: idle sensed lines float.
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
    read_at : 'far_end', or None
        Where the converter reads a sensed line: at the other end of its wire (`Lines`) than its
        load, beyond the last cell. None: at its terminal, where the load is.
    supply_volt, adc_bits, readings, noise_lsb
        See `Readout`.

    The network's reading is the voltage across the load, for either polarity. No bound except r > 0
    holds, because other cells can increase and decrease a reading. Raises ValueError if a number is
    out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹.

    >>> lampest.GroundedReadout(load_ohm=1000.0).unit
    'volt'
    """

    of_sensed = ("load_ohm", "sense_ohm", "idle_load_ohm")
    may_be_zero = ("drive_ohm", "sense_ohm", "idle_load_ohm")
    may_be_infinite = ("idle_load_ohm",)
    channels = ("drive_ohm", "sense_ohm")
    kind: Literal["grounded"] = "grounded"
    driven: Side = "rows"
    sense: Literal["all", "one"] = "all"
    polarity: Literal["up", "down"] = "up"
    load_ohm: PerLine = 1000.0
    drive_ohm: PerLine = 50.0
    sense_ohm: PerLine = 0.0
    idle_load_ohm: PerLine | None = None
    input_ohm: float | None = None
    groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None
    read_at: Literal["far_end"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.idle_load_ohm is not None and self._all_loaded:
            raise ValueError(
                "idle_load_ohm has no place with sense: all, where every sensed line keeps its load"
            )

    def description(self) -> str:
        sensed = opposite(self.driven)
        loads = f"one of the {sensed} loaded, the others floating"
        if self._all_loaded:
            loads = f"all {sensed} loaded"
        elif self.idle_load_ohm is not None:
            idle = lines_text(self.idle_load_ohm)
            loads = f"one of the {sensed} loaded, the others held through {idle}"
        channel = f", sense channels {lines_text(self.sense_ohm)}" if self.sense_ohm else ""
        return (
            f"grounded, {self.driven} driven {self.polarity} while the others are held, {loads}, "
            f"{self.supply_volt:g} V, load {lines_text(self.load_ohm)}, "
            f"drive {lines_text(self.drive_ohm)}{channel}{ends_in_words(self)}"
        )

    @property
    def _all_loaded(self) -> bool:
        """Whether every sensed line has its load all the time."""
        return self.sense == "all" and self.groups is None

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends: idle driven lines end through their Rd, as the driven one does.

        Idle sensed lines are loaded or floating.
        """
        drive = driven_ends(self, driven).of_at_least(MIN_OHM)
        idle = idle_ends(self, drive.ohm)
        return ends_with_loads(self, drive, idle, idle, sensed, loads_stay=self._all_loaded)
