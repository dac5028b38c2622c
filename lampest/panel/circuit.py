"""A circuit is how each line ends, at every address of a scan.

A line ends in a resistance and a potential, in several such ends, or nowhere: it floats. `Ends` are
those of several lines, `Terminations` those of all lines at every address. The equation of the
readings follows from them: `lampest.panel.equation`. A diode may stand in series with a driven
line.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import e
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from lampest.files.typed import Configuration, Validated, check_ranges, real_array, typed
from lampest.panel.lines import Groups, Side, listed_lines
from lampest.panel.panel import Array

FOLLOWS = "follows"
NOMINAL_LINES = 2  # of a side, where no list tells their number: one is used, one is idle
# Five suffice for the value at any resistance, second derivatives need two more.
NEWTON_STEPS = 7


@dataclass(frozen=True)
class Diode(Configuration):
    """Diode by Shockley's law, V_d = s·ln(1 + I/I_s).

    I_s is such that V_d is drop_volt at at_ampere.

    Attributes
    ----------
    drop_volt : float
        Voltage drop in volt at the current at_ampere, as in a data sheet.
    at_ampere : float
        Current in ampere.
    slope_volt : float
        s = n·kT/q in volt, the increase of the drop for an e-fold current; 2.303 s for a decade.

    >>> lampest.Diode(drop_volt=0.6, at_ampere=1e-3, slope_volt=0.05).drop_volt
    0.6
    """

    drop_volt: float = 0.6
    at_ampere: float = 1e-3
    slope_volt: float = 0.05

    def __post_init__(self) -> None:
        # n·kT/q is 0.02 V in the cold with n = 1, and 0.2 V for an LED; a Schottky diode drops 0.1
        # V, an LED 4 V.
        check_ranges(self, 0.01, 10, "drop_volt")
        check_ranges(self, 1e-7, 10, "at_ampere")
        check_ranges(self, 0.015, 0.5, "slope_volt")

    def description(self) -> str:
        """Return the drop and its slope in words."""
        return (
            f"diode {self.drop_volt:g} V at {1e3 * self.at_ampere:g} mA, "
            f"{1e3 * np.log(10) * self.slope_volt:.3g} mV a decade"
        )

    @cached_property
    def _saturation(self) -> float:
        """Saturation current I_s in ampere."""
        return float(self.at_ampere / np.expm1(self.drop_volt / self.slope_volt))

    def drop(self, current: Array) -> Array:
        """Return the drop V_d in volt at a current in ampere, any shape."""
        return np.asarray(self.slope_volt * np.log1p(current / self._saturation))

    def resistor_volt(self, supply_volt: float, resistance: Any) -> Any:
        """Return the voltage I·R across a resistance in series with the diode.

        Vcc = I·R + V_d(I); NumPy and CasADi. With A = I_s R/s and w = A e^{V_d/s} the equation is w
        + ln w = Vcc/s + A + ln A, and I·R = s (w − A). Newton's method begins above the root. As
        the equation is concave, all further iterates are below it and increase.
        """
        # A = I_s R/s, right-hand side Vcc/s + A + ln A, and the start w = right + ln(1 + e^−right)
        part = resistance * (self._saturation / self.slope_volt)
        right = part + _logarithm(part) + supply_volt / self.slope_volt
        omega = right + _logarithm(1 + e**-right)
        # Newton: w ← w (1 + right − ln w)/(1 + w) for w + ln w = right
        for _ in range(NEWTON_STEPS):
            omega = omega * (1 + right - _logarithm(omega)) / (1 + omega)
        return self.slope_volt * (omega - part)


def _logarithm(value: Any) -> Any:
    """Return ln of an array or of a CasADi matrix."""
    return value.log() if hasattr(value, "log") else np.log(value)


@dataclass(frozen=True, eq=False)
class Ends(Validated):
    """Ends of lines: a resistance and a potential each.

    Attributes
    ----------
    ohm : array, shape (…, lines)
        Infinite: the line floats; 0: it is held.
    volt : array, same shape
        0 of a line that floats.
    follows : bool
        Whether connected lines end at the potential of the line that is read, not at `volt`.

    >>> import numpy as np
    >>> lampest.Ends.of(np.array([50.0, 200.0]), 5.0).siemens
    array([0.02 , 0.005])
    """

    ohm: Array
    volt: Array
    follows: bool = False

    def __post_init__(self) -> None:
        ohm, volt = real_array(self.ohm, "ohm"), real_array(self.volt, "volt")
        if ohm.shape != volt.shape or not ohm.ndim:
            raise ValueError(
                f"ohm of shape {ohm.shape} and volt of {volt.shape}: one of each a line"
            )
        if not (np.all(ohm >= 0) and np.all(np.isfinite(volt))):
            raise ValueError("ohm must be zero or positive, volt finite")
        super().__post_init__()

    @classmethod
    def of(cls, ohm: Array, volt: Array | float | str = 0.0) -> Self:
        """Return ends at a potential in volt, or at that of the line that is read ('follows')."""
        if isinstance(volt, str):
            return cls(ohm, np.zeros(ohm.shape), follows=True)
        return cls(ohm, np.where(np.isinf(ohm), 0.0, volt))

    @classmethod
    def floating(cls, count: int) -> Self:
        """Return the ends of lines that float."""
        return cls.of(np.full(count, np.inf))

    @property
    def siemens(self) -> Array:
        """Conductances of the ends, infinite where a line is held."""
        with np.errstate(divide="ignore"):
            return 1 / self.ohm

    def connected(self, *, own: bool) -> Array:
        """Return the potentials of connected lines of a table (lines, lines), in volt.

        They are those of the lines that the addresses name, or of all others.
        """
        named = np.eye(len(self.ohm), dtype=bool)
        return self.volt[np.isfinite(self.ohm) & (named if own else ~named)]

    def of_at_least(self, ohm: float) -> Self:
        """Return the ends with resistances of at least so many ohm."""
        return replace(self, ohm=np.maximum(self.ohm, ohm))

    def behind(self, ohm: Array) -> Self:
        """Return the ends behind resistances in series."""
        return replace(self, ohm=self.ohm + ohm)

    def beside(self, other: "Ends") -> Self:
        """Return lines that end in both, as one end each (Thévenin).

        Raises ValueError if 0 ohm hold a line at two potentials.
        """
        if np.any((self.ohm == 0) & (other.ohm == 0) & (self.volt != other.volt)):
            raise ValueError("0 ohm hold a line at two potentials: name the resistors")
        with np.errstate(divide="ignore", invalid="ignore"):
            ohm = 1 / (self.siemens + other.siemens)
            # 0 where lines float in both
            share = np.where(self.ohm == 0, 1.0, np.nan_to_num(ohm / self.ohm))
        return replace(self, ohm=ohm, volt=share * self.volt + (1 - share) * other.volt)


@dataclass(frozen=True, eq=False)
class Terminations(Validated):
    """Ends of all lines of a panel, at every address of a scan.

    Attributes
    ----------
    driven : {'rows', 'columns'}
        Side that is driven.
    driving : Ends, shape (driven, driven)
        Row i has the ends of all driven lines while line i is driven.
    sensing : Ends, shape (sensed, sensed)
        Row j has the ends of all sensed lines while line j is read.
    gain : array, shape (sensed,)
        Voltage at the converter per voltage across the end of the line that is read.
    at_far_end : bool
        Whether the converter reads the far end of the sensed line's wire, which draws no current.
    amplified : bool
        Whether 0 is recorded of a line that is read without current, not the potential of its end.
    as_resistance : bool
        Whether a reading is the resistance between the ends of both lines by the equation of a
        divider, in ohm, not a voltage.
    diode : Diode, or None
        Diode in series with the end of the driven line.

    >>> import numpy as np
    >>> source, load = lampest.Ends.of(np.zeros(2), 5.0), lampest.Ends.of(np.full(3, 1000.0))
    >>> driving = lampest.scanned(source, lampest.Ends.floating(2))
    >>> lampest.Terminations("rows", driving, lampest.scanned(load, load), np.ones(3)).source
    array([5., 5.])
    """

    driven: Side
    driving: Ends
    sensing: Ends
    gain: Array
    at_far_end: bool = False
    amplified: bool = False
    as_resistance: bool = False
    diode: Diode | None = None

    @cached_property
    def two_point(self) -> bool:
        """Whether a reading is the resistance between two lines while all others float."""
        idle_ends = self.driving.connected(own=False).size + self.sensing.connected(own=False).size
        return self.as_resistance and not idle_ends

    @property
    def source(self) -> Array:
        """Potentials in which driven lines end while they are driven, (driven,) volt."""
        return self.driving.volt.diagonal()

    @property
    def source_volt(self) -> float:
        """Voltage of the source against the reference; the mean of unlike ones."""
        return float(np.mean(self.relative(self.source)))

    @cached_property
    def potentials(self) -> Array:
        """Potentials of all ends but the sources, in volt."""
        loads, idle_loads = (self.sensing.connected(own=own) for own in (True, False))
        if self.driving.follows:
            # V is linear in the potential that follows if all others are counted from one
            return idle_loads if idle_loads.size else loads
        return np.concatenate([self.driving.connected(own=False), loads, idle_loads])

    @cached_property
    def reference(self) -> float:
        """Potential from which readings are counted: of the ends', the furthest from the source.

        The potential of every line lies on one side of it.
        """
        if not self.potentials.size:
            return 0.0
        source = np.mean(self.source)
        ends = float(self.potentials.min()), float(self.potentials.max())
        return max(ends, key=lambda volt: abs(source - volt))

    @property
    def sign(self) -> float:
        """1 if the source is above the reference, −1 if it is below it."""
        return 1.0 if float(np.mean(self.source)) >= self.reference else -1.0

    @property
    def recorded_reference(self) -> float:
        """Recorded voltage of a reading of 0."""
        return 0.0 if self.amplified else self.reference

    def relative(self, volt: Array) -> Array:
        """Return potentials taken from the reference, positive towards the source."""
        return self.sign * (volt - self.reference)


@typed
def scanned(
    own: Ends, idle: Ends, groups: Groups | None = None, together: Ends | None = None
) -> Ends:
    """Return the ends of a side's lines at each of its addresses, (lines, lines).

    Parameters
    ----------
    own : Ends, shape (lines,)
        Of the line that the address names.
    idle : Ends, shape (lines,)
        Of all other lines.
    groups : tuple of tuple of int, or None
        Lines behind one multiplexer each. Line k of every other group is selected, too.
    together : Ends, shape (lines,), or None
        Of the lines that are selected with the named one; None: `own`.

    >>> import numpy as np
    >>> lampest.scanned(lampest.Ends.of(np.zeros(2), 5.0), lampest.Ends.floating(2)).ohm
    array([[ 0., inf],
           [inf,  0.]])
    """
    named = np.eye(len(own.ohm), dtype=bool)
    selected = named
    if groups is not None:
        place = np.full(len(own.ohm), -1)
        for group in groups:
            for number, line in enumerate(group):
                if line is not None:
                    place[line] = number
        selected = place[:, None] == place
    others = own if together is None else together
    of_own, of_others, of_idle = (
        np.stack([ends.ohm, ends.volt])[:, None] for ends in (own, others, idle)
    )
    ohm, volt = np.where(named, of_own, np.where(selected, of_others, of_idle))
    return Ends(ohm, volt, follows=idle.follows or others.follows)


class CircuitOfLines(Hashable, Protocol):
    """Interface of a readout that states how each line ends."""

    of_driven: ClassVar[tuple[str, ...]]
    of_sensed: ClassVar[tuple[str, ...]]

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of the lines of a panel with so many driven and sensed lines."""


@lru_cache(maxsize=256)
def nominal_terminations(circuit: CircuitOfLines) -> Terminations:
    """Return the ends of a circuit's lines on a panel of its nominal size.

    Each side has as many lines as lists and groups tell, otherwise NOMINAL_LINES. Potentials do not
    depend on the number of lines, so that they hold for any panel.
    """
    counts = []
    for keys, groups in (
        (circuit.of_driven, "driven_groups"),
        ((*circuit.of_sensed, "offset_volt"), "groups"),
    ):
        values = (getattr(circuit, key, None) for key in keys)
        listed = [len(value) for value in values if isinstance(value, tuple)]
        listed += [line + 1 for line in listed_lines(getattr(circuit, groups, None) or ())]
        counts.append(max(listed, default=NOMINAL_LINES))
    return circuit.terminations(*counts)
