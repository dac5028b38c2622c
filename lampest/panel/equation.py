"""Equation of the readings of a circuit, found from the ends of its lines.

With j the currents into the lines that end somewhere, v the level of the whole panel and L⁺ the
pseudoinverse of the Laplacian of the cells, all readings follow from

    (L⁺ + diag R) j + v = volt,   Σ j = 0,   V = L⁺ j + v

Addresses share most of their ends. While line i is driven and line j is read, the ends of these two
lines alone differ from those of a base that many addresses share: Z = (L(g) + diag(1/R))⁻¹ of the
base serves all of them. With Rp, Vp the end of line i in the base and Rd, U its own, Rq, Vq and Rs,
Vs those of line j, x the excitation of the lines by the potentials of the base (V/R, or V where a
line is held) and v = Z·x,

    (A + A' Z_ii) d + A' Z_ij s = E − A' v_i
    B' Z_ij d + (B + B' Z_jj) s = F − B' v_j

for the excitations d and s of both lines, and V_j = v_j + Z_ij d + Z_jj s. A = Rd, A' = 1 − Rd/Rp,
E = U − Vp Rd/Rp, B = 1, B' = 1/Rs − 1/Rq, F = Vs/Rs − Vq/Rq. A line that 0 ohm hold in the base has
A = 1, A' = −Rd, E = U − Vp, or B = 1/Rs, B' = −1, F = (Vs − Vq)/Rs, with the entries of
`lampest.panel.difference_network` instead of Z, and V_j = Vq + s. Where one potential besides the
source exists, V_ij = U Z_ij / ((A + A' Z_ii)(B + B' Z_jj) − A' B' Z_ij²).

A far end of a wire takes no current. Where lines are read there, the line that is read ends in its
base as in its address, so that B' = F = 0 and s = 0, and Z_ij and v_j are those of the far end.

`Equation` has the bases and these numbers. Readings and potentials are counted from that of the
ends that is furthest from the source.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any, Self

import numpy as np

from lampest.panel.circuit import CircuitOfLines, Diode, Ends, Terminations, nominal_terminations
from lampest.panel.lines import Side, along, of_side, opposite
from lampest.panel.panel import Array, Mask, Numbers, check_line_memory


@dataclass(frozen=True, eq=False)
class LineChange:
    """Change of the ends of one side's lines from a base to an address; see the module.

    Attributes
    ----------
    own, base : Ends, shape (lines,)
        Ends of each line while it is used, and in the base of its address.
    bases : Ends, shape (bases, lines)
        Ends of all lines in each base.
    of_base : boolean array, shape (bases, lines)
        Lines whose addresses have the base.
    """

    own: Ends
    base: Ends
    bases: Ends
    of_base: Mask

    @classmethod
    def of(cls, table: Ends, alone: Ends | None, *, whole: bool = False) -> Self:
        """Return the bases of the ends of a side, (lines, lines).

        Addresses share a base if their ends are those of the base but for the line that the address
        names, or with `whole` if all are. `alone` are the ends, (lines,), in the base of an address
        that shares its own with no other one; None: those of the address.
        """
        count = len(table.ohm)
        lines = np.arange(count)
        states = np.stack([table.ohm, table.volt])
        waiting = np.ones(count, dtype=bool)
        bases = list[Array]()
        of_base = list[Mask]()

        def sharing(base: Array, but_for: list[int]) -> Mask:
            """Return the waiting addresses that differ from a base in their own line alone.

            The ends of the lines `but_for` do not count.
            """
            differ = (states != base[:, None]).any(axis=0)
            differ[lines, lines] &= whole
            differ[:, but_for] = False
            return np.asarray(waiting & ~differ.any(axis=1))

        while waiting.any():
            first = int(np.argmax(waiting))
            base = states[:, first].copy()
            single = states[:, first, first]
            if alone is not None:
                single = np.array([alone.ohm[first], alone.volt[first]])
            others = np.flatnonzero(sharing(base, [first]) & (lines != first))
            if not whole:
                base[:, first] = states[:, others[0], first] if others.size else single
            shared = sharing(base, [])
            mixed = bool(bases) or not shared.all()
            if mixed and np.isinf(base[0]).all() and np.isfinite(single[0]):
                # Where other bases end somewhere, one that floats has no equation of its own
                base[:, first] = single
                shared = lines == first
            bases.append(base)
            of_base.append(shared)
            waiting = waiting & ~shared
        ohm, volt = np.stack(bases, axis=1)
        used = np.array(of_base)
        number = used.argmax(axis=0)
        return cls(
            own=Ends(table.ohm.diagonal(), table.volt.diagonal()),
            base=Ends(ohm[number, lines], volt[number, lines], follows=table.follows),
            bases=Ends(ohm, volt, follows=table.follows),
            of_base=used,
        )

    @property
    def stays(self) -> Mask:
        """Whether a line ends in the base as it does while it is used, (lines,)."""
        same = (self.own.ohm == self.base.ohm) & (self.own.volt == self.base.volt)
        return np.asarray(same & (not self.base.follows))

    @property
    def held(self) -> Mask:
        """Whether 0 ohm hold a line in its base, but not while it is used, (lines,)."""
        return np.asarray((self.base.ohm == 0) & ~self.stays)

    @cached_property
    def ratio(self) -> Array:
        """Rd/Rp, (lines,): 0 of lines that float in the base, 1 of lines that are held."""
        own, base = self.own.ohm, self.base.ohm
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where((base == 0) | (own == base), 1.0, own / base)
        return np.where(np.isinf(base), 0.0, ratio)

    def drive_terms(self) -> Array:
        """Return A and A', then both terms of the current, (4, lines); see `Equation`."""
        own = self.own.ohm
        ones = np.ones(len(own))
        held = [ones, -own, 0 * ones, -ones]
        tied = [own, 1 - self.ratio, ones, -self.base.siemens]
        return np.where(self.base.ohm == 0, held, tied)

    def load_terms(self) -> Array:
        """Return B and B', (2, lines); see `Equation`."""
        siemens = self.own.siemens
        with np.errstate(invalid="ignore"):
            change = np.where(self.stays, 0.0, siemens - self.base.siemens)
        ones = np.ones(len(change))
        return np.where(self.held, [siemens, -ones], [ones, change])


@dataclass(frozen=True, eq=False)
class PotentialTerms:
    """Numbers of the equation with several potentials on a panel; see the module.

    Attributes
    ----------
    of_drive, of_load : array, shape (rows, columns)
        E and F.
    held : boolean array, shape (rows, columns)
        Whether the sensed line is held in the base.
    held_volt : array, shape (rows, columns)
        Vq.
    load_volt : array, shape (rows, columns)
        Vs.
    level : array, shape (rows, columns)
        Reading of a line that is read without current.
    ends : array, shape (addresses, lines)
        Potentials in which the lines end in each base.
    loaded : bool
        Whether a sensed line that is read has a potential of its own, F ≠ 0.
    follows : array, shape (rows, columns), or None
        Change of E by Vp, where idle driven lines follow the sensed one.
    """

    of_drive: Array
    of_load: Array
    held: Mask
    held_volt: Array
    load_volt: Array
    level: Array
    ends: Array
    loaded: bool
    follows: Array | None

    @cached_property
    def sourced(self) -> bool:
        """Whether potentials of the bases excite Z, so that readings depend on v."""
        return self.follows is not None or bool(self.ends.any())

    @cached_property
    def shares(self) -> tuple[Array, Array] | None:
        """1 where sensed lines are held in the base, and where they are not; None: none is held."""
        held = self.held.astype(float)
        return (held, 1 - held) if self.held.any() else None


@dataclass(frozen=True, eq=False)
class Equation:
    """Numbers of the equation of the readings on a panel.

    Arrays without another shape are (rows, columns).

    Attributes
    ----------
    terminations : Terminations
        Ends of the lines.
    driving, sensing : LineChange
        Bases of both sides.
    source : float
        U from the reference, volt; the mean of unlike ones.
    drive, load, gain : array
        Rd, Rs and the gain of every reading.
    drive_terms : tuple of two arrays
        A and A'.
    load_terms : tuple of two arrays
        B and B'; B' is 0 where the end of a sensed line is that of the base.
    current_terms : tuple of two arrays
        The current through Rd is the excitation of line i times the first one plus its potential
        times the second one.
    floating : bool
        Whether no line ends anywhere in the base. Then readings follow from R = Z_ii + Z_jj − 2
        Z_ij.
    grounded : bool
        Whether idle driven lines end in no more than Rd, in one base.
    ties : array, shape (addresses, lines)
        Ties of the lines in every base, siemens; infinite where a line is held.
    read_at : array, shape (addresses, rows, columns)
        1 for the readings of each base, else 0.
    together : array, shape (sensed, sensed), or None
        1 for sensed lines that have their loads at the same time; None: all have.
    potentials : PotentialTerms or None
        Numbers of the equation with potentials; None where one potential but the source's exists.
    """

    terminations: Terminations
    driving: LineChange
    sensing: LineChange
    source: float
    drive: Array
    load: Array
    gain: Array
    drive_terms: tuple[Array, Array]
    load_terms: tuple[Array, Array]
    current_terms: tuple[Array, Array]
    floating: bool
    grounded: bool
    ties: Array
    read_at: Array
    together: Array | None
    potentials: PotentialTerms | None

    @property
    def plain(self) -> bool:
        """Whether one source drives all currents, and one set of idle driven lines is tied."""
        return self.potentials is None and len(self.driving.of_base) == 1

    @cached_property
    def read_at_far_end(self) -> Mask:
        """Whether a line is read at the far end of its wire, (lines,)."""
        ends = self.terminations
        sides = np.repeat(of_side(ends.driven, "driven", "sensed"), self.drive.shape)
        return np.asarray((sides == "sensed") & ends.at_far_end)

    @property
    def diode(self) -> Diode | None:
        """Diode in series with the end of the driven line."""
        return self.terminations.diode

    def reading(self, row: Any, column: Any, mutual: Any, *potentials: Any) -> Any:
        """Return the readings of impedances Z_jj, Z_kk, Z_jk (rows, columns) and of v_j, v_k.

        The arguments are arrays of NumPy or matrices of CasADi; see the module.
        """
        driven = self.terminations.driven
        own_driven, own_sensed = of_side(driven, row, column)
        terms = self.potentials
        if terms is not None:
            entries = own_driven, own_sensed, mutual
            at_lines = of_side(driven, *potentials) if potentials else (0.0, 0.0)
            if terms.follows is None:
                volt = self._solved(entries, at_lines, terms.of_drive, terms.of_load)
            else:
                # V_j = V_0 + V_1 Vp with Vp = V_j, where V_1 is excited by idle driven lines alone
                without = self._solved(entries, (0.0, 0.0), terms.of_drive, terms.of_load)
                share = self._solved(entries, at_lines, terms.follows, 0.0 * terms.of_load)
                volt = without / (1 - share)
            return terms.level + self.gain * (volt - terms.load_volt)
        if self.floating:
            # Nothing but the read lines conducts elsewhere: one loop of Rd, R and Rs
            between = row + column - 2 * mutual
            if self.terminations.as_resistance:
                return between
            loop = between + (self.drive + self.load)
            return self._supply(loop) * (self.load * self.gain) / loop
        _, of_load, determinant = self.determinant(own_driven, own_sensed, mutual)
        if self.diode is None:
            volt = mutual * (self.gain * self.source) / determinant
            if self.terminations.as_resistance:
                return self._current_volt / volt - (self.drive + self.load)
            return volt
        # Resistance U/I of the driven path, from the excitation x and the potential u of the driven
        # line: x = U of_load/determinant, u = U (Z_ii of_load − B' Z_ij²)/determinant
        by_excitation, by_potential = self.current_terms
        potential = own_driven * of_load - mutual * mutual * self.load_terms[1]
        current = of_load * by_excitation + potential * by_potential
        return mutual * self.gain * self._supply(determinant / current) / determinant

    def determinant(self, own_driven: Any, own_sensed: Any, mutual: Any) -> tuple[Any, Any, Any]:
        """Return A + A' Z_ii, B + B' Z_jj, and the determinant of the two equations."""
        drive, by_drive = self.drive_terms
        load, by_load = self.load_terms
        of_drive = own_driven * by_drive + drive
        of_load = own_sensed * by_load + load
        coupling = mutual * mutual * (by_drive * by_load)
        return of_drive, of_load, of_drive * of_load - coupling

    def _solved(
        self,
        entries: tuple[Any, Any, Any],
        at_lines: tuple[Any, Any],
        of_drive: Array,
        of_load: Array,
    ) -> Any:
        """Return V_j of the two equations of the module, for E and F."""
        terms = self.potentials
        assert terms is not None
        by_drive = self.drive_terms[1]
        _, own_sensed, mutual = entries
        driven_volt, sensed_volt = at_lines
        driving, _, determinant = self.determinant(*entries)
        lifted = sensed_volt
        held, free = terms.shares or (None, 1.0)
        if terms.loaded:
            # Of a sensed line that is tied in the base B = 1, and 1/Rs of one that is held
            through = own_sensed if held is None else free * own_sensed + held
            lifted = sensed_volt + through * of_load
        rises = mutual * (of_drive - driven_volt * by_drive) + driving * lifted
        if terms.loaded:
            rises = rises - free * (of_load * by_drive) * (mutual * mutual)
        volt = rises / determinant
        return volt if held is None else volt + held * terms.held_volt

    def _supply(self, resistance: Any) -> Any:
        """Return U behind the diode for a resistance of the driven path; NumPy and CasADi."""
        if self.diode is None:
            return self.source
        return self.diode.resistor_volt(self.source, resistance)

    @property
    def _current_volt(self) -> Array:
        """U·Rref, (rows, columns): what a voltage of the converter is divided by for U/I."""
        return self.source * self.gain * self.load

    def volt(self, reading: Array) -> Array:
        """Return the voltages at the converter of readings (…, rows, columns)."""
        if not self.terminations.as_resistance:
            return reading
        return self._current_volt / (reading + self.drive + self.load)

    def volt_sigma(self, reading: Array, sigma: Array) -> Array:
        """Return σ of the voltages at the converter for σ of the readings, (…, rows, columns)."""
        if not self.terminations.as_resistance:
            return sigma
        return np.where(
            np.isfinite(sigma), sigma * self.volt(reading) ** 2 / self._current_volt, np.inf
        )

    def lost(self, current: Array) -> Array:
        """Return the voltage of the diode for a current through the driven line, volt."""
        return np.zeros(1) if self.diode is None else self.diode.drop(current)

    def driven_volt(self, current: Array, drive: Array | float) -> Array:
        """Return the potential U − Rd I − V_d(I) of a driven line with the current I, volt."""
        return self.source - drive * current - self.lost(current)

    def sum_together(self, values: Array) -> Array:
        """Return sums of values (…, rows, columns) over the sensed lines with simultaneous loads.

        The result has the shape of the values.
        """
        by_rows = self.terminations.driven == "rows"
        if self.together is None:
            total = values.sum(axis=-1 if by_rows else -2, keepdims=True)
            return np.broadcast_to(total, values.shape)
        return values @ self.together if by_rows else self.together @ values

    def ties_of_parts(self, parts: Numbers | None, cells: Callable[[], Array]) -> Array:
        """Return the ties (addresses, lines) of a panel that open cells may divide into parts.

        In a part that has none, a single line gets one: it carries no current, and its size has no
        effect. `parts`, (lines,), is the number of each line's part, None for a connected panel;
        `cells` gives resistances such as those of the cells.
        """
        ties = self.ties
        parts = np.zeros(ties.shape[1], dtype=np.intp) if parts is None else parts
        member = parts == np.unique(parts)[:, None]
        # Whether a part has a tie at an address, (addresses, parts)
        tied = (ties > 0) @ member.T
        if tied.all():
            return ties
        ties = ties.copy()
        for address, part in zip(*np.nonzero(~tied), strict=True):
            ties[address, np.argmax(member[part])] = 1 / np.median(cells())
        return ties

    def excitations(self, ties: Array) -> Array | None:
        """Return the excitations x of the lines by the potentials of each base; None without any.

        The shape is that of the ties, (addresses, lines). x is the potential of a held line, and
        the current V/R into any other one.
        """
        terms = self.potentials
        if terms is None or not terms.sourced:
            return None
        return np.where(np.isinf(ties), 1.0, ties) * terms.ends


@lru_cache(maxsize=256)
def equation_of(circuit: CircuitOfLines, rows: int, columns: int) -> Equation:
    """Return the numbers of a circuit's equation on a panel, found from its terminations."""
    check_line_memory(rows, columns)
    nominal = nominal_terminations(circuit)
    driven_count, sensed_count = of_side(nominal.driven, rows, columns)
    ends = circuit.terminations(driven_count, sensed_count)
    side = ends.driven

    def on_panel(of_lines: Side, values: Array) -> Array:
        return np.broadcast_to(along(of_lines, values), (rows, columns)).copy()

    def at_addresses(of_driven: Array, of_sensed: Array) -> Array:
        """Return values of all lines, (addresses, lines), from those of both sides in each base."""
        bases = product(of_driven, of_sensed)
        return np.stack([np.concatenate(of_side(side, *values)) for values in bases])

    of_driven, of_sensed = (partial(on_panel, line) for line in (side, opposite(side)))
    # Where nothing but both read lines ends anywhere, a resistance is that of floating lines
    alone = Ends.floating(sensed_count) if ends.two_point else None
    sensing = LineChange.of(ends.sensing, alone, whole=ends.at_far_end)
    # A driven line that no other address shows idle rests behind its resistance, or floats if it
    # has none, unless nothing else ends
    resting = ends.driving.ohm.diagonal()
    if ends.two_point or np.isfinite(sensing.bases.ohm).any(axis=1).all():
        resting = np.where(resting > 0, resting, np.inf)
    driving = LineChange.of(ends.driving, Ends.of(resting, nominal.reference))
    ties = at_addresses(driving.bases.siemens, sensing.bases.siemens)
    idle_volt = driving.bases.volt
    idle_volt = np.ones(idle_volt.shape) if driving.base.follows else nominal.relative(idle_volt)
    tie_volts = at_addresses(idle_volt, nominal.relative(sensing.bases.volt))
    read = product(driving.of_base, sensing.of_base)
    together = (ends.sensing.ohm == sensing.own.ohm) & (ends.sensing.volt == sensing.own.volt)
    drive, by_drive, by_excitation, by_potential = map(of_driven, driving.drive_terms())
    load, by_load = map(of_sensed, sensing.load_terms())
    return Equation(
        terminations=ends,
        driving=driving,
        sensing=sensing,
        source=float(np.mean(nominal.relative(ends.source))),
        drive=of_driven(driving.own.ohm),
        load=of_sensed(sensing.own.ohm),
        gain=of_sensed(ends.gain),
        drive_terms=(drive, by_drive),
        load_terms=(load, by_load),
        current_terms=(by_excitation, by_potential),
        floating=not ties.any(),
        grounded=bool(np.all(driving.base.ohm <= driving.own.ohm)) and len(driving.of_base) == 1,
        ties=ties,
        read_at=np.stack([np.multiply.outer(*of_side(side, *lines)) * 1.0 for lines in read]),
        together=None if together.all() else together.T * 1.0,
        potentials=_potential_terms(
            ends,
            nominal,
            (driving, sensing),
            np.where(ties > 0, tie_volts, 0.0),
            (of_driven, of_sensed),
        ),
    )


def _potential_terms(
    ends: Terminations,
    nominal: Terminations,
    changes: tuple[LineChange, LineChange],
    tie_volts: Array,
    on_panel: tuple[Any, Any],
) -> PotentialTerms | None:
    """Return E, F and the potentials of the ends; None where only the source has one.

    Parameters
    ----------
    ends, nominal : Terminations
        Those of the panel, and those that define the reference.
    changes : tuple of LineChange
        Of the driven and of the sensed side.
    tie_volts : array, shape (addresses, lines)
        Potentials in which the tied lines end in every base, V.
    on_panel : tuple of callables
        Values of driven, and of sensed lines → (rows, columns).
    """
    driving, sensing = changes
    of_driven, of_sensed = on_panel
    own, base = (
        np.where(np.isinf(state.ohm), 0.0, nominal.relative(state.volt))
        for state in (sensing.own, sensing.base)
    )
    held = sensing.held
    with np.errstate(divide="ignore", invalid="ignore"):
        of_load = np.where(
            held, (own - base) / sensing.own.ohm, own / sensing.own.ohm - base / sensing.base.ohm
        )
    of_load = np.where(sensing.stays, 0.0, of_load)
    source = nominal.relative(ends.source)
    follows = driving.base.follows
    several = follows or np.any(tie_volts) or of_load.any() or own.any() or np.ptp(source) > 0
    if not several:
        return None
    idle_volt = 0.0 if follows else nominal.relative(driving.base.volt)
    return PotentialTerms(
        of_drive=of_driven(source - idle_volt * driving.ratio),
        of_load=of_sensed(of_load),
        held=of_sensed(held.astype(float)) > 0,
        held_volt=of_sensed(base),
        load_volt=of_sensed(own),
        level=of_sensed(0.0 * own if ends.amplified else own),
        ends=tie_volts,
        loaded=bool(of_load.any()),
        follows=of_driven(-driving.ratio) if follows else None,
    )
