"""Virtual ground: amplifiers hold every sensed line and measure its current."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lampest.panel.circuit import Ends, Terminations, nominal_terminations, scanned
from lampest.panel.lines import MIN_OHM, PerLine, Side, as_tuple, lines_text, per_line
from lampest.panel.readouts.keys import driven_ends, ends_in_words, idle_ends, load_volts
from lampest.panel.readouts.readout import Readout


@dataclass(frozen=True, kw_only=True)
class VirtualGroundReadout(Readout):
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
    offset_volt : PerLine, or None
        Input offset of each amplifier in volt: its sensed line is held so far above the reference.
    supply_volt, adc_bits, readings, noise_lsb
        See `Readout`.

    No bound except r > 0 holds, because other cells can increase and decrease a reading. Raises
    ValueError if a number is out of range. Source: node analysis with Z = (L(g) + diag(t))⁻¹, t =
    1/Rd at the driven and 1/Rc at the sensed lines.

    >>> lampest.VirtualGroundReadout(feedback_ohm=1000.0).unit
    'volt'
    """

    of_sensed = ("feedback_ohm", "sense_ohm")
    signal_name = "output of the amplifier below its reference"
    channels = ("drive_ohm", "sense_ohm")
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
    offset_volt: PerLine | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = nominal_terminations(self)
        offset = np.array(as_tuple(self.offset_volt or 0.0))
        loads = ends.relative(ends.sensing.volt.diagonal() - offset)
        if float(loads.min()) > np.abs(offset).max():
            raise ValueError(
                "idle_volt and idle_load_volt must not lie on the other side of load_volt than "
                "the source: amplifiers then have currents of both signs, which this model lacks"
            )

    def description(self) -> str:
        return (
            f"virtual ground, {self.driven} driven to {nominal_terminations(self).source_volt:g} V "
            f"while all other lines are grounded, converter to {self.full_scale_volt:g} V, "
            f"drive {lines_text(self.drive_ohm)}, sense {lines_text(self.sense_ohm)}, "
            f"feedback {lines_text(self.feedback_ohm)}{ends_in_words(self)}"
        )

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends: all lines at ground through their channels, all the time.

        The gain is Rf/Rc.
        """
        drive = driven_ends(self, driven).of_at_least(MIN_OHM)
        channel = np.maximum(per_line("sense_ohm", self.sense_ohm, sensed), MIN_OHM)
        feedback = per_line("feedback_ohm", self.feedback_ohm, sensed)
        offset = per_line("offset_volt", self.offset_volt or 0.0, sensed)
        volt, idle_volt = load_volts(self)
        return Terminations(
            self.driven,
            scanned(drive, idle_ends(self, drive.ohm)),
            scanned(Ends.of(channel, volt + offset), Ends.of(channel, idle_volt + offset)),
            gain=feedback / channel,
            amplified=True,
        )
