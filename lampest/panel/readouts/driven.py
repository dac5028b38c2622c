"""Circuits that drive the lines of one side, one after the other, and sense the other side.

They have one equation for all. Driven line i is at the source U through Rd, idle driven lines are
at ground through Rp (infinite: they float; 0: they are held). Sensed line j is at ground through Rs
while it is read, and through Rq while it is idle. With a = 1/Rd − 1/Rp, b = 1/Rs − 1/Rq and Z of
the panel with all lines idle,

    V_ij = (U/Rd) Z_ij / ((1 + a Z_ii)(1 + b Z_jj) − a b Z_ij²)

at sensed line j; c_j is the share of it at the converter. Multiplied by Rd, it has no division by
zero:

    V_ij = U Z_ij / ((A + A' Z_ii)(B + B' Z_jj) − A' B' Z_ij²),
    A = Rd, A' = 1 − Rd/Rp, B = 1, B' = b

A side whose idle lines are held at ground by 0 ohm has A = 1, A' = −Rd, or B = 1/Rs, B' = −1, with
the entries of `DifferenceNetwork` instead of Z. Where several sensed lines are read at one address,
their Rs is a part of Z, and b = 0: Z has one version an address. So it has where the driven lines
are behind several multiplexers, which hold a line each.

Readings and voltages are counted from the potential of the line ends that are furthest from the
source. Where line ends have several potentials, `lampest.panel.readouts.potentials` has the
equation.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from math import inf
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import check_ranges
from lampest.panel.addressed import AddressedNetwork
from lampest.panel.difference_network import HeldNetwork
from lampest.panel.impedance import inverse_of
from lampest.panel.network import Network
from lampest.panel.panel import Array, connected_parts
from lampest.panel.readouts.alternation import Alternation
from lampest.panel.readouts.branches import LEVELS, MAX_MISFIT, misfit, panels_alike, uniform_panels
from lampest.panel.readouts.channels import errors_of_channels
from lampest.panel.readouts.characteristic import MAX_VOLT
from lampest.panel.readouts.converter import MIN_VOLT
from lampest.panel.readouts.diode import Diode
from lampest.panel.readouts.equation import Equation, LineStates, equation_of
from lampest.panel.readouts.floating import convex_start, uniform_factor
from lampest.panel.readouts.lines import (
    Groups,
    LineNumber,
    PerLine,
    Side,
    as_tuple,
    check_apart,
    check_groups,
    check_resistors,
    lines_text,
    of_side,
    opposite,
    per_line,
    with_channels,
)
from lampest.panel.readouts.potentials import FOLLOWS, LineEnds, check_line_ends
from lampest.panel.readouts.readout import (
    MIN_LOAD_SHARE,
    SHORT_SHARE,
    Address,
    FreeTest,
    Readout,
    Surroundings,
)
from lampest.panel.readouts.unseen import Scale, unseen_scales
from lampest.panel.readouts.wiring import WiredNetwork, Wiring
from lampest.panel.tied_network import TiedNetwork

USUAL_OHM = 10_000.0  # of cells whose scale no resistor sets
LARGEST_OHM = 1e8  # of such cells: insulation beside usual ones
UNIFORM_LEVELS = 140  # of uniform panels, from 10 ohm to 100 Mohm: 12 % from one to the next
OPEN_SHARE = 1e-9  # share of the supply below which a reading shows an open cell


class DrivenCircuit(Readout):
    """Base of circuits with driven and sensed lines.

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
        """Whether sensed lines end anywhere while read, and elsewhere than that while idle."""
        return True, True

    @cached_property
    def line_ends(self) -> LineEnds:
        """Potentials in which lines end."""
        ground = self.supply_volt if self.polarity == "down" else 0.0
        load = ground if self.load_volt is None else self.load_volt
        return LineEnds(
            source=self.source_volt,
            idle=ground if self.idle_volt is None else self.idle_volt,
            load=load,
            idle_load=load if self.idle_load_volt is None else self.idle_load_volt,
            connected=(self.idle_connected, *self.loads_connected),
        )

    @property
    def driving_volt(self) -> float:
        """Voltage of the source against the reference of the line ends, in volt."""
        return self.line_ends.relative(self.line_ends.source)

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
        """Raise ValueError as `Readout.check`, or if lists do not fit the panel's lines.

        These are lists of resistances or groups.
        """
        super().check(scene)
        driven, sensed = of_side(self.driven, *scene.panel.shape)
        for name in (*self.of_driven, *self.of_sensed):
            value = getattr(self, name)
            if value is not None:
                per_line(name, value, driven if name in self.of_driven else sensed)
        if self.diode is not None and equation_of(self, *scene.panel.shape).potentials is not None:
            raise ValueError("diode: circuits with several potentials have no diode in this model")
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

        They are (addresses, lines) of a circuit with several addresses. They are 1/Rp of driven
        lines and 1/Rq of sensed lines, or 1/Rs of those that an address reads; infinite for lines
        that 0 ohm hold at ground.
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
        networks = tuple(
            self._network(cell_resistance, of_address, volts, wiring)
            for of_address, volts in zip(each, ends, strict=True)
        )
        if ties.ndim == 1:
            return networks[0]
        return AddressedNetwork.of(networks, equation.read_at)

    def _network(
        self, cell_resistance: Array, ties: Array, ends: Array | None, wiring: Wiring | None
    ) -> Network:
        """Return the network of one address, whose idle lines end in potentials `ends`."""
        held = np.isinf(ties)
        # Potentials of held lines, currents into the others
        sources = None if ends is None else np.where(held, ends, np.where(held, 0.0, ties) * ends)
        if wiring is not None:
            return WiredNetwork.solve(cell_resistance, ties, self, wiring, sources)
        if held.any():
            return HeldNetwork.solve(cell_resistance, ties, self, sources)
        impedance = inverse_of(1 / cell_resistance, ties)
        return TiedNetwork(cell_resistance, impedance, self, sources=sources)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings of cells of any contrast.

        It does so also if open cells divide the panel into parts.
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
        """Return the sum of values (…, rows, columns) over sensed lines.

        It is over the sensed lines that have their loads at the same time.
        """
        together = self._equation(values.shape).together
        if together is None:
            return np.asarray(
                np.broadcast_to(values.sum(axis=self._along_sensed, keepdims=True), values.shape)
            )
        return np.asarray(values @ together if self.driven == "rows" else together @ values)

    def _reference(self, equation: Equation) -> Array:
        """Return the resistor that scales a reading, (rows, columns) ohm.

        It is Rs. Where no resistor sets the scale of cells, it is one that gives usual cells.
        """
        return np.where(np.isfinite(equation.load), equation.load, USUAL_OHM)

    def apparent_resistance(self, measured: Array) -> Array:
        """Return the resistance of a single divider with this reading.

        It is Rs·((Vcc − V_d)·c/V − 1) − Rd.
        """
        equation = self._equation(measured.shape)
        if self._by_uniform_panels(equation, measured):
            return self._of_uniform_panels(measured)
        load = self._reference(equation)
        drive = equation.drive
        volt = np.maximum(measured / equation.gain, OPEN_SHARE * self.driving_volt)
        # (Vcc − V_d)/I with the current I = V/(c·Rs): the sum of cell, load and drive
        total = load * (self.driving_volt - self._lost(volt / load)) / volt
        return np.asarray(np.maximum(total - load - drive, MIN_LOAD_SHARE * total))

    def uniform_start(self, measured: Array) -> Array:
        """Return r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij, (…, rows, columns) ohm, for idle lines at ground.

        This is exact for Rd = Rp = 0, where no sensed line depends on another one or on its load.
        Where idle lines float, or are at ground through more than a cell has, it is the apparent
        resistance.
        """
        equation = self._equation(measured.shape)
        if self._by_uniform_panels(equation, measured):
            return self._of_uniform_panels(measured)
        if equation.floating:
            return np.asarray(
                self.apparent_resistance(measured) / uniform_factor(*measured.shape[-2:])
            )
        if not equation.grounded:
            apparent = self.apparent_resistance(measured)
            if np.mean(equation.states.idle) > np.median(apparent):
                return apparent
        load = self._reference(equation)
        driven = -3 - self._along_sensed
        # Voltages over the supply, with a lower limit for open cells.
        share = measured / (self.driving_volt * equation.gain)
        share = np.maximum(share, OPEN_SHARE * share.max(axis=(-2, -1), keepdims=True))
        remainder = 1 - share.sum(axis=driven, keepdims=True)
        # A negative remainder is noise, or the substitute of a dead line. Then the load counts as
        # one more cell.
        return np.asarray(
            load
            * np.where(remainder > MIN_LOAD_SHARE, remainder, 1 / (1 + share.shape[driven]))
            / share
        )

    def unseen_scales(self, rows: int, columns: int) -> tuple[Scale, ...]:
        equation = equation_of(self, rows, columns)
        # A load, or nothing that conducts elsewhere, shows the scale
        if np.isfinite(equation.load).all() or equation.floating:
            return ()
        return unseen_scales(self, rows, columns)

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """Return the resolution limit, see `Readout.resolution`.

        Without a scale it is that of any cell: no reading says more.
        """
        if self.unseen_scales(*measured.shape[-2:]):
            return np.full(measured.shape, LARGEST_OHM)
        return super().resolution(measured, sigma)

    def _by_uniform_panels(self, equation: Equation, measured: Array) -> bool:
        """Return whether no closed form gives a cell by its reading, but a uniform panel does."""
        if equation.plain and np.isfinite(equation.load).all():
            return False
        return not self.unseen_scales(*measured.shape[-2:])

    def _of_uniform_panels(self, measured: Array) -> Array:
        """Return the uniform panels that come nearest to each reading, (…, rows, columns) ohm."""
        rows, columns = measured.shape[-2:]
        levels, readings = uniform_readings(self, rows, columns)
        flat = measured.reshape(-1, rows, columns)
        distance = np.abs(readings[None] - flat[:, None])
        return np.asarray(levels[np.argmin(distance, axis=1)]).reshape(measured.shape)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce the readings, (rows, columns) ohm.

        They are found by alternation of potentials and cells (`Alternation`), or, where it moves
        away or several panels give the same readings, by Newton's method from uniform panels.
        Without loads the equations of floating lines determine ratios of cells alone, and the start
        is the uniform one.
        """
        equation = self._equation(measured.shape)
        if equation.floating:
            return convex_start(self.apparent_resistance(measured), upper, near)
        positive = np.maximum(measured, OPEN_SHARE * measured.max())
        if near is not None:
            firsts = [near]
        elif self.unseen_scales(*measured.shape):
            firsts = [self.uniform_start(measured)]
        else:
            firsts = uniform_panels(self.exact_reading, positive)
        if len(firsts) == 1 and equation.plain and np.isfinite(equation.states.load).all():
            alternation = Alternation(
                equation,
                self._ties(measured, None),
                self.driven,
                self.driving_volt,
                self._driven_volt,
            )
            alternated = alternation.cells(measured, self.uniform_start(measured), near)
            cells = np.minimum(alternated, upper)
            if misfit(self.network(cells, self.ties(measured)), positive) < MAX_MISFIT:
                return np.asarray(cells)
            firsts.append(cells)
        return self._panels_from(positive, firsts, upper)[0][1]

    def panels_alike(self, measured: Array) -> list[tuple[float, Array]]:
        if self._equation(measured.shape).floating or self.unseen_scales(*measured.shape):
            return []
        positive = np.maximum(measured, OPEN_SHARE * measured.max())
        firsts = uniform_panels(self.exact_reading, positive)
        if len(firsts) == 1:
            return []
        return self._panels_from(positive, firsts, np.full(measured.shape, np.inf))

    def _panels_from(
        self, measured: Array, firsts: Sequence[Array], upper: Array
    ) -> list[tuple[float, Array]]:
        """Return the panels that give the readings, as `panels_alike`, from the first ones."""
        return panels_alike(
            lambda cells: self.network(cells, self.ties(measured)), measured, firsts, upper
        )

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """Return the lower bounds r_ij ≥ u_i/I_i − Rs_j of the cells, where idle lines float.

        Shape (…, rows, columns), ohm. I_i = Σ_j V_ij/Rs_j is the current of the driven line,
        increased by its noise, and u_i = Vcc − Rd_i I_i − V_d its potential. The bound holds
        because I_i is at least the current through each cell and its load alone. Where other lines
        conduct to ground, cells can increase and decrease a reading, and r > 0 alone holds.
        """
        equation = self._equation(measured.shape)
        least = super().least_cells(measured, sigma)
        states = equation.states
        quiet = equation.plain and (equation.together is None or np.isinf(states.idle_load).all())
        if not (quiet and np.isinf(states.idle).all() and np.isfinite(states.load).all()):
            return least
        noise = np.zeros_like(measured)
        if sigma is not None:
            noise = np.where(np.isfinite(sigma), sigma, measured)
        by_volt = 1 / (equation.gain * equation.load)
        # Upper bound of the current, and with it a lower bound of the potential
        current = self._sum_together(measured * by_volt)
        current = current + NOISE_REACH * np.sqrt(self._sum_together((noise * by_volt) ** 2))
        bound = np.maximum(self._driven_volt(current, equation.drive), 0) / current - equation.load
        return np.asarray(np.maximum(bound, least))

    def nearly_shorted(self, measured: Array) -> Array:
        """Return cells that count as shorts, (…, rows, columns) ohm.

        They are also bounded by a share of the uniform start. With idle lines at ground the
        apparent resistance is many times too large.
        """
        return np.asarray(
            np.minimum(super().nearly_shorted(measured), SHORT_SHARE * self.uniform_start(measured))
        )

    def _driven_volt(self, current: Array, drive: Array | float) -> Array:
        """Return the potential Vcc − Rd I − V_d(I) of a driven line with the current I.

        It is in volt, of any shape.
        """
        return np.asarray(self.driving_volt - drive * current - self._lost(current))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the tests v_ij ≤ Vcc − Rd_i Σ_k v_ik/Rs_k and Σ_i v_ij ≤ Vcc.

        The sum over k is over simultaneous loads. The first one: no sensed line has a higher
        potential than the driven one, which is below the supply by the loads' current through its
        Rd. The second one, for idle lines at ground through no more than Rd: if all driven lines
        were at the supply, no sensed line would be above it (superposition, Z·t ≤ 1).
        """
        equation = self._equation(measured.shape)
        if equation.potentials is not None:
            return self._tests_of_potentials(measured, sigma)
        load = equation.load
        volt, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / equation.gain
        # Vcc ≥ v_ij + Rd_i Σ_k v_ik/Rs_k + V_d, with the propagated noise of both terms
        simultaneous = equation.together is None or len(equation.ties) > 1
        drop = (equation.drive if simultaneous else 0.0) / load
        driven = -3 - self._along_sensed
        lost = self._lost(self._sum_together(volt / load))
        below = volt + self._sum_together(volt * drop) + lost
        spread = np.hypot(noise, np.sqrt(self._sum_together((noise * drop) ** 2)))
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        tests = [(law, below, np.where(noise > 0, spread, 0.0))]
        if equation.grounded:
            law = "readings of a sensed line add up to no more than the supply"
            tests = [(law, volt.sum(axis=driven), np.sqrt((noise**2).sum(axis=driven))), *tests]
        results = []
        for law, value, spread in tests:
            excess = np.where(
                spread > 0, (value - self.driving_volt) / np.where(spread > 0, spread, 1.0), -np.inf
            )
            results.append(FreeTest(law, excess.reshape(len(value), -1).max(axis=1), value[0].size))
        return tuple(results)

    def _tests_of_potentials(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the test that no line is beyond the potentials in which lines end."""
        terms = self._equation(measured.shape).potentials
        assert terms is not None
        most = max(self.driving_volt, float(terms.ends.max()), float(terms.load_volt.max()))
        gain = self._equation(measured.shape).gain
        end = self._end_volt(terms.load_volt)
        volt = terms.load_volt + (measured - end) / gain
        known = np.isfinite(sigma) & (sigma > 0)
        spread = np.where(known, sigma, 1.0) / gain
        excess = np.where(known, np.maximum(volt - most, -volt) / spread, -np.inf)
        law = "no sensed line stands beyond the potentials in which lines end"
        return (FreeTest(law, excess.reshape(len(excess), -1).max(axis=1), excess[0].size),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Return the upper bound of Rd, min_i (Vcc − V_d − max_j v_ij)/Σ_j v_ij/Rs_j, ohm.

        The sum is over simultaneous loads; with one load at a time each reading is taken alone.
        """
        equation = self._equation(measured.shape)
        if not equation.plain:
            return 0.0
        volt = np.where(np.isfinite(sigma), measured, 0.0) / equation.gain
        current = self._sum_together(volt / equation.load)
        if equation.together is None:
            volt = volt.max(axis=self._along_sensed, keepdims=True)
        # Voltage across Rd and the current through it: Rd ≤ (Vcc − V_d − v)/I
        drop = self._driven_volt(current, 0.0) - volt
        return float(
            np.min(np.where(current > 0, drop / np.where(current > 0, current, 1.0), np.inf))
        )

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return recorded values with the channels added to the resistances.

        They are added to drive_ohm, and to sense_ohm unless it is zero.
        """
        actual = self.with_channels(row_ohm, column_ohm)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def channel_errors(self, cells: Array, scene: Surroundings, channel: float) -> Array:
        return errors_of_channels(self, cells, scene.wiring, channel)

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
        """Return the numbers to calibrate.

        They are drive resistances, which include channels, and reference resistors.
        """
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        reference = getattr(self, self.of_sensed[0])
        resistors = (
            (LineNumber(self.of_sensed[0], (opposite(self.driven),)),)
            if max(as_tuple(reference)) < inf
            else ()
        )
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return drive, *resistors, *diode


@lru_cache(maxsize=32)
def uniform_readings(circuit: DrivenCircuit, rows: int, columns: int) -> tuple[Array, Array]:
    """Return resistances of uniform panels, (levels,) ohm, and their readings.

    The readings have shape (levels, rows, columns).
    """
    levels = np.geomspace(LEVELS[0], LEVELS[-1], UNIFORM_LEVELS)
    panels = np.broadcast_to(levels[:, None, None], (len(levels), rows, columns))
    return levels, circuit.exact_reading(panels)


class SourcedCircuit(DrivenCircuit):
    """Base of circuits whose source and converter may have voltages of their own.

    Attributes
    ----------
    drive_volt : float, or None
        Source of a driven line in volt; None: supply_volt.
    converter_volt : float, or None
        End of the converter's range in volt; None: supply_volt.
    """

    drive_volt: float | None = None
    converter_volt: float | None = None

    def __post_init__(self) -> None:
        check_ranges(self, MIN_VOLT, MAX_VOLT, "drive_volt", "converter_volt")
        super().__post_init__()

    @property
    def source_volt(self) -> float:
        return super().source_volt if self.drive_volt is None else self.drive_volt

    @property
    def full_scale_volt(self) -> float:
        return self.supply_volt if self.converter_volt is None else self.converter_volt
