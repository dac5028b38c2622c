"""Circuits that drive the lines of one side, one after the other, and sense the other side.

One equation describes them all. Driven line i is at the source U through Rd, idle driven lines are
at ground through Rp (infinite: they float; 0: they are held). Sensed line j is at ground through Rs
while it is read, and through Rq while it is idle. With a = 1/Rd − 1/Rp, b = 1/Rs − 1/Rq and Z of
the panel with all lines idle,

    V_ij = (U/Rd) Z_ij / ((1 + a Z_ii)(1 + b Z_jj) − a b Z_ij²)

at sensed line j; c_j is the share of it at the converter. Multiplied by Rd, the formula has no
division by zero:

    V_ij = U Z_ij / ((A + A' Z_ii)(B + B' Z_jj) − A' B' Z_ij²),
    A = Rd, A' = 1 − Rd/Rp, B = 1, B' = b

A side whose idle lines are held at ground by 0 ohm has A = 1, A' = −Rd, or B = 1/Rs, B' = −1, with
the entries of `DifferenceNetwork` instead of Z. Where several sensed lines are read at one address,
their Rs is a part of Z, and b = 0: Z has one version for each address. The same holds where the
driven lines are behind several multiplexers, which hold a line each.

Readings and voltages are counted from the potential of the line ends that are furthest from the
source. Where line ends have several potentials, `lampest.panel.readouts.potentials` has the
equation.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from math import inf
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network
from lampest.panel.panel import Array, connected_parts
from lampest.panel.readouts.diode import Diode
from lampest.panel.readouts.equation import Equation, LineStates, equation_of
from lampest.panel.readouts.lines import (
    Groups,
    PerLine,
    Side,
    as_tuple,
    check_apart,
    check_groups,
    check_resistors,
    load_share,
    of_side,
    opposite,
    per_line,
)
from lampest.panel.readouts.potentials import FOLLOWS, LineEnds, check_line_ends
from lampest.panel.readouts.readout import (
    Address,
    Readout,
    Surroundings,
)
from lampest.panel.readouts.wiring import Wiring


class DrivenNetwork(Readout):
    """Base of circuits with driven and sensed lines: lines, ties, network and readings.

    Kinds are dataclasses that declare their keys in the files' order.

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
    diode : Diode, or None
        Diode in series with Rd.
    input_ohm : float, or None
        Input resistance of the converter in ohm.
    groups : tuple of tuple of int, or None
        Sensed lines behind one multiplexer each, in the order of its addresses. The groups are read
        in parallel.
    driven_groups : tuple of tuple of int, or None
        Driven lines behind one multiplexer each. While a line is driven, the lines at its place in
        the other groups end in Rd at idle_volt, and all others float.
    idle_volt : float or {'follows'}, or None
        Potential in which idle driven lines end, in volt; 'follows': that of the sensed line, as
        with voltage feedback. None: ground, or the supply with polarity: down.
    load_volt, idle_load_volt : float, or None
        Potential in which the load of a sensed line ends, and an idle sensed line, in volt. None:
        ground, or the supply with polarity: down, and load_volt.
    of_sensed : tuple of str
        Keys of resistances of sensed lines; the first one is the reference resistor of a reading.
    may_be_zero : tuple of str
        Keys of resistances that may be 0.
    may_be_infinite : tuple of str
        Keys of resistances that may be infinite.
    """

    of_sensed: ClassVar[tuple[str, ...]]
    may_be_zero: ClassVar[tuple[str, ...]] = ("drive_ohm", "sense_ohm")
    may_be_infinite: ClassVar[tuple[str, ...]] = ()
    of_driven: ClassVar[tuple[str, ...]] = ("drive_ohm",)
    series_name: ClassVar[str] = "drive_ohm"
    driven: Side
    drive_ohm: PerLine
    sense_ohm: PerLine = 0.0
    polarity: Literal["up", "down"] = "up"
    diode: Diode | None = None
    input_ohm: float | None = None
    groups: Groups | None = None
    driven_groups: Groups | None = None
    idle_volt: float | Literal["follows"] | None = None
    load_volt: float | None = None
    idle_load_volt: float | None = None

    @property
    def source_volt(self) -> float:
        """Voltage of the source of a driven line, before Rd, in volt."""
        return 0.0 if self.polarity == "down" else self.supply_volt

    @property
    def idle_connected(self) -> bool:
        """Whether idle driven lines end anywhere."""
        return True

    @property
    def loads_connected(self) -> tuple[bool, bool]:
        """Whether sensed lines end anywhere while read, and elsewhere while idle."""
        return True, True

    @cached_property
    def line_ends(self) -> LineEnds:
        """Potentials in which lines end."""
        ground = self.supply_volt if self.polarity == "down" else 0.0
        end = ground if self.load_volt is None else self.load_volt
        share = self._load_share
        # Lines of unlike loads have shares of their own (`LineStates.load_share`).
        load = end if isinstance(share, tuple) else end * share
        idle_load = load if getattr(self, "idle_load_ohm", None) is None else end
        return LineEnds(
            source=self.source_volt,
            idle=ground if self.idle_volt is None else self.idle_volt,
            load=load,
            idle_load=idle_load if self.idle_load_volt is None else self.idle_load_volt,
            connected=(self.idle_connected, *self.loads_connected),
        )

    @property
    def _load_share(self) -> PerLine:
        """Share of a load's potential that the converter's input to ground leaves."""
        return load_share(getattr(self, self.of_sensed[0]), self.input_ohm)

    @property
    def driving_volt(self) -> float:
        """Voltage of the source against the reference of the line ends, in volt."""
        return self.line_ends.relative(self.line_ends.source)

    def load_shares(self, sensed: int) -> Array | None:
        """Return the shares of the loads' potential of unlike loads, (sensed,); None for one."""
        share = self._load_share
        return per_line("load_ohm", share, sensed) if isinstance(share, tuple) else None

    @abstractmethod
    def states(self, driven: int, sensed: int) -> LineStates:
        """Return the resistances of all lines, for their numbers on a panel."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (*self.of_driven, *self.of_sensed):
            value = getattr(self, name)
            limited = tuple(
                ohm for ohm in as_tuple(value) if not (ohm == inf and name in self.may_be_infinite)
            )
            if value is not None and (limited or not as_tuple(value)):
                check_resistors(name, limited, open_end=name not in self.may_be_zero)
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)
        if self.groups is not None:
            check_apart(self.groups)
        if self.driven_groups is not None:
            check_apart(self.driven_groups, "driven_groups")
        check_line_ends(self)

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as `Readout.check`, or if a list does not fit the panel's lines.

        Resistances and groups may be lists.
        """
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        for name in (*self.of_driven, *self.of_sensed):
            value = getattr(self, name)
            if value is not None:
                per_line(name, value, driven if name in self.of_driven else sensed)
        if self.diode is not None and equation_of(self, *scene.panel.shape).potentials is not None:
            raise ValueError("diode: circuits with several potentials have no diode in this model")
        if self.diode is not None and self.driven_groups is not None:
            raise ValueError("diode: circuits with driven_groups have no diode in this model")
        check_groups(self.groups, opposite(self.driven), sensed)
        check_groups(self.driven_groups, self.driven, driven, "driven_groups")
        equation = equation_of(self, *scene.panel.shape)
        if scene.wiring is not None and scene.wiring.joined and np.isinf(equation.ties).any():
            raise ValueError(
                "faults: lines that touch cannot be joined to idle ones that 0 ohm hold at ground"
            )

    @property
    def _end_text(self) -> str:
        """Description of the groups and of the converter, with its input resistance."""
        text = ""
        if self.groups is not None:
            text += f", {len(self.groups)} {opposite(self.driven)} read in parallel"
        if self.driven_groups is not None:
            text += f", {len(self.driven_groups)} multiplexers of {self.driven}"
        if self.idle_volt is not None:
            volt = "those of the sensed line"
            if self.idle_volt != FOLLOWS:
                volt = f"{self.idle_volt:g} V"
            text += f", idle {self.driven} at {volt}"
        if self.load_volt is not None:
            text += f", loads end at {self.load_volt:g} V"
        if self.idle_load_volt is not None:
            text += f", idle {opposite(self.driven)} at {self.idle_load_volt:g} V"
        if self.input_ohm is not None:
            text += f", converter input {self.input_ohm:g} ohm"
        return f"{text}, {self.converter_description()}"

    @property
    def noisy_side(self) -> Side:
        return self.driven

    @property
    def mirrored(self) -> bool:
        return self.line_ends.sign < 0

    @property
    def recorded_reference_volt(self) -> float:
        """Recorded value of a network's reading of 0."""
        return self.line_ends.reference

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        if not (self.mirrored or self.recorded_reference_volt):
            return recorded
        return np.asarray(self.line_ends.sign * (recorded - self.recorded_reference_volt))

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        if not (self.mirrored or self.recorded_reference_volt):
            return reading
        return np.asarray(self.recorded_reference_volt + self.line_ends.sign * reading)

    @property
    def by_columns(self) -> bool:
        return self.driven == "columns" if self.scan_order is None else super().by_columns

    @property
    def _along_sensed(self) -> int:
        """Axis of an array (…, rows, columns) that counts the sensed lines."""
        return -1 if self.driven == "rows" else -2

    def _equation(self, shape: tuple[int, ...]) -> Equation:
        """Return the numbers of the equation for arrays (…, rows, columns)."""
        return equation_of(self, *shape[-2:])

    def addresses(self, measured: Array) -> tuple[Address, ...]:
        equation = self._equation(measured.shape)
        ties = self._ties(measured, None)
        terms = equation.potentials
        ends: Sequence[Array | None] = [None] * len(ties)
        if terms is not None and terms.sourced:
            ends = list(terms.ends)
        return tuple(
            Address(of_address, read > 0, volts)
            for of_address, read, volts in zip(ties, equation.read_at, ends, strict=True)
        )

    def ties(self, measured: Array) -> Array:
        """Return the ties, (lines,) siemens.

        A circuit with several addresses has (addresses, lines). Driven lines have 1/Rp, sensed
        lines 1/Rq, or 1/Rs if an address reads them. Lines that 0 ohm hold at ground have infinite
        ties.
        """
        return self.ties_of_parts(measured, None)

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        ties = self._ties(measured, parts)
        return ties[0] if len(ties) == 1 else ties

    def _ties(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        """Return the ties (addresses, lines).

        In a part of the panel that has none, a single line gets one. Such a tie carries no current,
        and its size has no effect.
        """
        ties = self._equation(measured.shape).ties
        parts = np.zeros(ties.shape[1], dtype=np.intp) if parts is None else parts
        member = parts == np.unique(parts)[:, None]
        # Whether a part has a tie at an address, (addresses, parts)
        tied = (ties > 0) @ member.T
        if tied.all():
            return ties
        ties = ties.copy()
        for address, part in zip(*np.nonzero(~tied), strict=True):
            ties[address, np.argmax(member[part])] = 1 / np.median(
                self.apparent_resistance(measured)
            )
        return ties

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network for ties (lines,).

        The ties are (addresses, lines) of a circuit with several addresses.
        """
        equation = self._equation(cell_resistance.shape)
        terms = equation.potentials
        each = np.atleast_2d(ties)
        ends: Sequence[Array | None] = [None] * len(each)
        if terms is not None and terms.sourced:
            ends = list(terms.ends)
        networks = list[Network]()
        for of_address, volts in zip(each, ends, strict=True):
            sources = None
            if volts is not None:
                # Potentials of held lines, currents into the others
                sources = np.where(np.isinf(of_address), 1.0, of_address) * volts
            networks.append(self.solved_network(cell_resistance, of_address, wiring, sources))
        if ties.ndim == 1:
            return networks[0]
        return JoinedNetwork.addressed(networks, equation.read_at > 0)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings of cells of any contrast.

        Open cells may divide the panel into parts.
        """
        if cell_resistance.ndim == 3:
            return np.stack([self.exact_reading(frame, wiring) for frame in cell_resistance])
        volt = np.full(cell_resistance.shape, self.driving_volt / 2)
        ties = self.ties_of_parts(volt, connected_parts(np.isfinite(cell_resistance)))
        with np.errstate(divide="ignore"):
            return self.network(cell_resistance, ties, wiring).reading()

    def reading(self, row: Any, column: Any, mutual: Any, *potentials: Any) -> Any:
        """Return c·V_ij, see the module; NumPy and CasADi."""
        equation = self._equation(mutual.shape)
        own_driven, own_sensed = of_side(self.driven, row, column)
        terms = equation.potentials
        if terms is not None:
            at_lines = (0.0, 0.0)
            if potentials:
                at_lines = of_side(self.driven, *potentials)
            volt = terms.line_volt(
                (equation.drive_terms, equation.load_terms),
                (own_driven, own_sensed, mutual),
                at_lines,
            )
            return self._end_volt(terms.load_volt) + equation.gain * (volt - terms.load_volt)
        if equation.floating:
            # Nothing but the read lines conducts to ground: one loop of Rd, R and Rs
            loop = (own_driven + own_sensed - 2 * mutual) + (equation.drive + equation.load)
            return self._supply(loop) * (equation.load * equation.gain) / loop
        # A, A' and B, B'
        drive, by_drive = equation.drive_terms
        load, by_load = equation.load_terms
        of_load = own_sensed * by_load + load
        of_drive = own_driven * by_drive + drive
        determinant = of_drive * of_load - mutual * mutual * (by_drive * by_load)
        if self.diode is None:
            return mutual * (equation.gain * self.driving_volt) / determinant
        # Resistance U/I of the driven path, from the excitation x and the potential u of the driven
        # line: x = U of_load/determinant, u = U (Z_ii of_load − B' Z_ij²)/determinant
        by_excitation, by_potential = equation.current_terms
        potential = own_driven * of_load - mutual * mutual * by_load
        current = of_load * by_excitation + potential * by_potential
        return mutual * equation.gain * self._supply(determinant / current) / determinant

    def _end_volt(self, load_volt: Array) -> Array:
        """Return the reading of a load without current, whose end has a potential."""
        return load_volt

    def _supply(self, resistance: Any) -> Any:
        """Return U for a resistance of the driven path, volt; NumPy and CasADi."""
        if self.diode is None:
            return self.driving_volt
        return self.diode.resistor_volt(self.driving_volt, resistance)

    def _lost(self, current: Array) -> Array:
        """Return Vcc − U for a current through the driven line, volt."""
        return np.zeros(1) if self.diode is None else self.diode.drop(current)

    def _sum_together(self, values: Array) -> Array:
        """Return sums of values (…, rows, columns) over sensed lines.

        A sum has the sensed lines that have their loads at the same time.
        """
        together = self._equation(values.shape).together
        if together is None:
            return np.asarray(
                np.broadcast_to(values.sum(axis=self._along_sensed, keepdims=True), values.shape)
            )
        return np.asarray(values @ together if self.driven == "rows" else together @ values)

    def _driven_volt(self, current: Array, drive: Array | float) -> Array:
        """Return the potential Vcc − Rd I − V_d(I) of a driven line with the current I.

        The result is in volt, and has the shape of the current.
        """
        return np.asarray(self.driving_volt - drive * current - self._lost(current))
