"""Numbers of the equation of circuits that drive lines one after the other.

    c·V_ij = c U Z_ij / ((A + A' Z_ii)(B + B' Z_jj) − A' B' Z_ij²)

The equation and its states stand in `lampest.panel.readouts.driven_network`. Its numbers depend on
the circuit and on the size of the panel alone, and are kept.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.readouts.lines import Groups, Side, along, of_side, opposite
from lampest.panel.readouts.potentials import FOLLOWS, LineEnds, PotentialTerms


@dataclass(frozen=True, eq=False)
class LineStates:
    """Resistances of the lines to ground or to the source, ohm, in both of their states.

    Attributes
    ----------
    drive, idle : array, shape (driven,)
        Rd and Rp; Rp infinite: the line floats, 0: it is held at ground.
    load, idle_load : array, shape (sensed,)
        Rs and Rq.
    gain : array, shape (sensed,)
        c, the share of a sensed line's voltage at the converter.
    load_share : array, shape (sensed,), or None
        Share of Vs that the converter's input to ground leaves of each of unlike loads; None: 1.
    """

    drive: Array
    idle: Array
    load: Array
    idle_load: Array
    gain: Array
    load_share: Array | None = None


@dataclass(frozen=True, eq=False)
class Equation:
    """Numbers of the equation of the readings on a panel.

    Arrays without another shape are (rows, columns).

    Attributes
    ----------
    states : LineStates
        Resistances of the lines.
    drive, load, gain : array
        Rd, Rs and c of every reading.
    drive_terms : tuple of two arrays
        A and A'.
    load_terms : tuple of two arrays
        B and B'; B' is 0 where the loads of an address are a part of Z.
    current_terms : tuple of two arrays
        The current through Rd is the excitation of line i times the first one plus its potential
        times the second one.
    floating : bool
        Whether no line is tied while all are idle. Then readings follow from R = Z_ii + Z_jj − 2
        Z_ij.
    grounded : bool
        Whether idle driven lines are at ground through no more than Rd.
    ties : array, shape (addresses, lines)
        Ties of the lines at every address, siemens; infinite where a line is held at ground.
    read_at : array, shape (addresses, rows, columns)
        1 for the readings of each address, else 0.
    together : array, shape (sensed, sensed), or None
        1 for sensed lines that have their loads at the same time; None: all have.
    potentials : PotentialTerms or None
        Numbers of the equation with potentials; None where one potential but the source's exists.
    drive_addresses : int
        Number of addresses of the driven side.
    """

    states: LineStates
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
    potentials: PotentialTerms | None = None

    drive_addresses: int = 1

    @property
    def plain(self) -> bool:
        """Whether one source drives all currents, and one set of idle driven lines is tied."""
        return self.potentials is None and not self.several_driven

    @property
    def several_driven(self) -> bool:
        """Whether the driven lines that are tied change from address to address."""
        return self.drive_addresses > 1


class DrivenLines(Protocol):
    """Part of a circuit that its equation depends on; hashable."""

    @property
    def driven(self) -> Side:
        """Side that is driven."""

    @property
    def groups(self) -> Groups | None:
        """Sensed lines behind one multiplexer each; None: one line is read at an address."""

    @property
    def driven_groups(self) -> Groups | None:
        """Driven lines behind one multiplexer each; None: idle ones end as `states` says."""

    @property
    def line_ends(self) -> LineEnds:
        """Potentials in which lines end."""

    def states(self, driven: int, sensed: int) -> LineStates:
        """Return the resistances of the lines of a panel.

        The arguments are the panel's numbers of driven and sensed lines.
        """


@dataclass(frozen=True)
class _Crossings:
    """Values of lines at the crossings of a panel, whose `driven` side is driven."""

    driven: Side
    shape: tuple[int, int]

    def of_driven(self, values: Array) -> Array:
        """Return values of the driven lines, (driven,), as (rows, columns)."""
        return np.broadcast_to(along(self.driven, values), self.shape).copy()

    def of_sensed(self, values: Array) -> Array:
        """Return values of the sensed lines, (sensed,), as (rows, columns)."""
        return np.broadcast_to(along(opposite(self.driven), values), self.shape).copy()


@lru_cache(maxsize=256)
def equation_of(circuit: DrivenLines, rows: int, columns: int) -> Equation:
    """Return the numbers of a circuit's equation on a panel."""
    driven, sensed = of_side(circuit.driven, rows, columns)
    states = circuit.states(driven, sensed)
    ends = circuit.line_ends
    loads_stay = np.array_equal(states.load, states.idle_load) and ends.load == ends.idle_load
    groups = circuit.groups or ()
    parallel = len(groups) > 1 and not loads_stay
    addresses = _addresses(groups) if parallel else [np.arange(sensed)]
    drive_addresses = [np.arange(driven)]
    if circuit.driven_groups is not None:
        # While a line is driven, those at its place of the other multiplexers end in Rd
        drive_addresses = _addresses(circuit.driven_groups)
        states = replace(states, idle=states.drive)
    tied = [np.isin(np.arange(driven), lines) for lines in drive_addresses]
    read = [np.isin(np.arange(sensed), lines) for lines in addresses]
    in_ties = loads_stay or parallel
    drive_terms, current_terms = _drive_terms(states)
    load_terms = _load_terms(states, in_ties=in_ties)
    load_volts = _load_volts(ends, states, loads_stay=loads_stay)
    # Ties at every address: of idle lines, and of the loads of the lines that are read together.
    ties = []
    tie_volts = []
    read_at = []
    for of_driven, of_sensed in product(tied, read):
        loaded = of_sensed & parallel
        with np.errstate(divide="ignore"):
            driven_ties = np.where(of_driven, 1 / states.idle, 0.0)
            sensed_ties = np.where(loaded, 1 / states.load, 1 / states.idle_load)
        ties.append(np.concatenate(of_side(circuit.driven, driven_ties, sensed_ties)))
        volts = np.full(driven, _idle_volt(ends)), np.where(loaded, *load_volts)
        at_ends = np.concatenate(of_side(circuit.driven, *volts))
        tie_volts.append(np.where(ties[-1] > 0, at_ends, 0.0))
        read_at.append(np.multiply.outer(of_driven, of_sensed) * 1.0)
    together = None
    if parallel:
        together = np.array(read, dtype=float).T @ np.array(read, dtype=float)
    elif not loads_stay:
        together = np.eye(sensed)
    crossings = _Crossings(circuit.driven, (rows, columns))
    current, by_potential = map(crossings.of_driven, current_terms)
    return Equation(
        states=states,
        drive=crossings.of_driven(states.drive),
        load=crossings.of_sensed(states.load),
        gain=crossings.of_sensed(states.gain),
        drive_terms=(crossings.of_driven(drive_terms[0]), crossings.of_driven(drive_terms[1])),
        load_terms=(crossings.of_sensed(load_terms[0]), crossings.of_sensed(load_terms[1])),
        current_terms=(current, by_potential),
        floating=not np.any(ties),
        grounded=bool(np.all(states.idle <= states.drive)) and len(drive_addresses) == 1,
        ties=np.stack(ties),
        read_at=np.stack([at if circuit.driven == "rows" else at.T for at in read_at]),
        together=together,
        potentials=_potential_terms(
            ends, states, load_volts, np.stack(tie_volts), crossings, in_ties=in_ties
        ),
        drive_addresses=len(drive_addresses),
    )


def _idle_volt(ends: LineEnds) -> float:
    """Return Vp from the reference, V; 1 where idle lines follow the sensed one."""
    return 1.0 if isinstance(ends.idle, str) else ends.relative(ends.idle)


def _potential_terms(
    ends: LineEnds,
    states: LineStates,
    load_volts: tuple[Array, Array],
    tie_volts: Array,
    crossings: _Crossings,
    *,
    in_ties: bool,
) -> PotentialTerms | None:
    """Return E, F and the potentials of the lines' ends; None where only the source has one.

    Parameters
    ----------
    ends : LineEnds
    states : LineStates
    load_volts : tuple of array, shapes (sensed,)
        Vs and Vq from the reference, V.
    tie_volts : array, shape (addresses, lines)
        Potentials in which the tied lines end at every address, V.
    crossings : _Crossings
    in_ties : bool
        Whether the loads are a part of the ties.
    """
    load_volt, idle_load_volt = load_volts
    held = (states.idle_load == 0) & (not in_ties)
    # F, 0 where the loads are a part of Z
    with np.errstate(divide="ignore", invalid="ignore"):
        of_load = np.where(
            held,
            (load_volt - idle_load_volt) / states.load,
            load_volt / states.load - idle_load_volt / states.idle_load,
        )
    of_load = np.zeros(len(load_volt)) if in_ties else of_load
    follows = ends.idle == FOLLOWS
    if not (follows or np.any(tie_volts) or of_load.any() or load_volt.any()):
        return None
    # E = U − Vp Rd/Rp; Rd/Rp is 0 of floating lines and 1 of held ones
    ratio = np.where(
        np.isinf(states.idle),
        0.0,
        np.divide(states.drive, states.idle, out=np.ones(len(states.drive)), where=states.idle > 0),
    )
    drive_volt = ends.relative(ends.source) - (0.0 if follows else _idle_volt(ends) * ratio)
    return PotentialTerms(
        of_drive=crossings.of_driven(np.broadcast_to(drive_volt, ratio.shape)),
        of_load=crossings.of_sensed(of_load),
        held=crossings.of_sensed(held.astype(float)) > 0,
        held_volt=crossings.of_sensed(idle_load_volt),
        load_volt=crossings.of_sensed(load_volt),
        ends=tie_volts,
        follows=crossings.of_driven(-ratio) if follows else None,
    )


def _load_volts(ends: LineEnds, states: LineStates, *, loads_stay: bool) -> tuple[Array, Array]:
    """Return Vs and Vq of the sensed lines, (sensed,) each, taken from the reference.

    The converter's input leaves a share of Vs at the end of a load.
    """
    load = np.full(len(states.load), ends.load)
    if states.load_share is not None:
        load = load * states.load_share
    idle_load = load if loads_stay else np.full(len(load), ends.idle_load)
    relative = [ends.sign * (volt - ends.reference) for volt in (load, idle_load)]
    return (
        np.where(np.isinf(states.load), 0.0, relative[0]),
        np.where(np.isinf(states.idle_load), 0.0, relative[1]),
    )


def _drive_terms(states: LineStates) -> tuple[Array, Array]:
    """Return (A, A'), and the terms of the current, (2, driven) each; see `Equation`.

    Lines that 0 ohm hold at ground while they are idle have an equation of their own.
    """
    drive = states.drive
    idle = states.idle
    ones = np.ones(len(drive))
    held = idle == 0
    with np.errstate(divide="ignore", invalid="ignore"):
        by_own = np.where(drive == idle, 0.0, 1 - drive / idle)
        drive_terms = np.where(held, (ones, -drive), (drive, by_own))
        current_terms = np.where(held, [[0.0], [-1.0]], (ones, -1 / idle))
    return drive_terms, current_terms


def _load_terms(states: LineStates, *, in_ties: bool) -> Array:
    """Return (B, B'), (2, sensed); see `Equation`.

    `in_ties` states whether the loads are a part of the ties.
    """
    ones = np.ones(len(states.load))
    if in_ties:
        return np.stack([ones, np.zeros(len(states.load))])
    with np.errstate(divide="ignore", invalid="ignore"):
        load_ties = 1 / states.load
        of_tied = (ones, load_ties - 1 / states.idle_load)
        return np.where(states.idle_load == 0, (load_ties, -ones), of_tied)


def _addresses(groups: Groups) -> list[NDArray[np.intp]]:
    """Return the sensed lines of each address: the k-th one of every group that has so many."""
    count = max(map(len, groups))
    return [
        np.array([group[k] for group in groups if k < len(group)], dtype=np.intp)
        for k in range(count)
    ]
