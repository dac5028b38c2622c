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


@lru_cache(maxsize=256)
def equation_of(circuit: DrivenLines, rows: int, columns: int) -> Equation:
    """Return the numbers of a circuit's equation on a panel."""
    driven, sensed = of_side(circuit.driven, rows, columns)
    states = circuit.states(driven, sensed)
    ends = circuit.line_ends
    loads_stay = np.array_equal(states.load, states.idle_load) and ends.load == ends.idle_load
    addresses = [np.arange(sensed)]
    parallel = False
    if circuit.groups is not None and len(circuit.groups) > 1 and not loads_stay:
        addresses = _addresses(circuit.groups)
        parallel = True
    drive_addresses = [np.arange(driven)]
    if circuit.driven_groups is not None:
        # While a line is driven, those at its place of the other multiplexers end in Rd
        drive_addresses = _addresses(circuit.driven_groups)
        states = replace(states, idle=states.drive)
    drive_terms, current_terms = _drive_terms(states)
    load_terms = _load_terms(states, in_ties=loads_stay or parallel)
    # Ties at every address: of idle lines, and of the loads of the lines that are read together.
    load_volt, idle_load_volt = _load_volts(ends, states, loads_stay=loads_stay)
    idle_volt = 1.0 if isinstance(ends.idle, str) else ends.relative(ends.idle)
    ties = []
    tie_volts = []
    read = []
    read_sensed = []
    with np.errstate(divide="ignore"):
        for driven_lines, lines in product(drive_addresses, addresses):
            tied = np.isin(np.arange(driven), driven_lines)
            of_driven_ties = np.where(tied, 1 / states.idle, 0.0)
            chosen = np.isin(np.arange(sensed), lines)
            loaded = chosen & parallel
            of_sensed = np.where(loaded, 1 / states.load, 1 / states.idle_load)
            ties.append(np.concatenate(of_side(circuit.driven, of_driven_ties, of_sensed)))
            sensed_volt = np.where(loaded, load_volt, idle_load_volt)
            volts = of_side(circuit.driven, np.full(driven, idle_volt), sensed_volt)
            tie_volts.append(np.where(ties[-1] > 0, np.concatenate(volts), 0.0))
            read.append(tied[:, None] * chosen[None, :] * 1.0)
            read_sensed.append(chosen.astype(float))
    together = None
    if parallel:
        together = np.transpose(read_sensed[: len(addresses)]) @ np.array(
            read_sensed[: len(addresses)]
        )
    elif not loads_stay:
        together = np.eye(sensed)

    def of_driven(values: Array) -> Array:
        return np.broadcast_to(along(circuit.driven, values), (rows, columns)).copy()

    def of_sensed_lines(values: Array) -> Array:
        return np.broadcast_to(along(opposite(circuit.driven), values), (rows, columns)).copy()

    potentials = None
    in_ties = loads_stay or parallel
    reduced = np.where(
        np.isinf(states.idle),
        0.0,
        np.divide(states.drive, states.idle, out=np.ones(driven), where=states.idle > 0),
    )
    held = (states.idle_load == 0) & (not in_ties)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_load = np.where(
            held,
            (load_volt - idle_load_volt) / states.load,
            load_volt / states.load - idle_load_volt / states.idle_load,
        )
    of_load = np.zeros(sensed) if in_ties else of_load
    if ends.idle == FOLLOWS or np.any(tie_volts) or of_load.any() or load_volt.any():
        follows = of_driven(-reduced) if ends.idle == FOLLOWS else None
        drive_volt = ends.relative(ends.source) - (
            0.0 if follows is not None else idle_volt * reduced
        )
        potentials = PotentialTerms(
            of_drive=of_driven(np.broadcast_to(drive_volt, (driven,))),
            of_load=of_sensed_lines(of_load),
            held=of_sensed_lines(held.astype(float)) > 0,
            held_volt=of_sensed_lines(idle_load_volt),
            load_volt=of_sensed_lines(load_volt),
            ends=np.stack(tie_volts),
            follows=follows,
        )
    return Equation(
        states=states,
        drive=of_driven(states.drive),
        load=of_sensed_lines(states.load),
        gain=of_sensed_lines(states.gain),
        drive_terms=(of_driven(drive_terms[0]), of_driven(drive_terms[1])),
        load_terms=(of_sensed_lines(load_terms[0]), of_sensed_lines(load_terms[1])),
        current_terms=(of_driven(current_terms[0]), of_driven(current_terms[1])),
        floating=not np.any(ties),
        grounded=bool(np.all(states.idle <= states.drive)) and len(drive_addresses) == 1,
        ties=np.stack(ties),
        read_at=np.stack([chosen if circuit.driven == "rows" else chosen.T for chosen in read]),
        together=together,
        potentials=potentials,
        drive_addresses=len(drive_addresses),
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
