"""Potentials in which the lines of a driven circuit end, and the equation of its readings.

While idle, driven line i ends in Rp and Vp, sensed line j in Rq and Vq; while used, in Rd and the
source U, and in Rs and Vs. With Z of all lines idle, x the excitation of the lines by their idle
potentials (V/R, or V where a line is held) and v = Z·x,

    (A + A' Z_ii) d + A' Z_ij s = E − A' v_i
    B' Z_ij d + (B + B' Z_jj) s = F − B' v_j

for the excitations d and s of the driven and the sensed line, and V_j = v_j + Z_ij d + Z_jj s, or
Vq + s of a sensed line that is held while idle. A, A', B, B' are those of
`lampest.panel.readouts.driven_network`; E = U − Vp Rd/Rp, or U − Vp of a driven line that is held;
F = Vs/Rs − Vq/Rq, (Vs − Vq)/Rs of a sensed line that is held, or 0 where its load is a part of Z.

All potentials are taken from that of the line ends that are furthest from the source. Where all
ends but the source have it, d and s are those of the equation without potentials.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.readouts.converter import MAX_VOLT
from lampest.panel.readouts.lines import Groups

FOLLOWS = "follows"


@dataclass(frozen=True)
class LineEnds:
    """Potentials in which lines end, in volt.

    Attributes
    ----------
    source : float
        U, of a driven line.
    idle : float or {'follows'}
        Vp, of an idle driven line; 'follows': that of the sensed line.
    load, idle_load : float
        Vs and Vq, of a sensed line while it is read and while it is idle.
    connected : tuple of bool
        Whether any line ends in Vp, in Vs and in Vq; all others float.
    """

    source: float
    idle: float | Literal["follows"]
    load: float
    idle_load: float
    connected: tuple[bool, bool, bool]

    @cached_property
    def reference(self) -> float:
        """Potential from which all others are counted.

        Of the potentials in which lines end, the reference is the one furthest from the source, so
        that the potential of every line lies on one side of it. Where idle lines follow the sensed
        one, the reference is the potential of idle sensed lines, because v is then linear in Vp.
        """
        idle, loads, idle_loads = self.connected
        if self.idle == FOLLOWS:
            return self.idle_load if idle_loads else self.load
        ends = [
            float(end)
            for end, connects in (
                (self.load, loads),
                (self.idle_load, idle_loads),
                (self.idle, idle),
            )
            if connects
        ]
        if not ends:
            return 0.0
        if self.source - min(ends) >= max(ends) - self.source:
            return min(ends)
        return max(ends)

    @cached_property
    def sign(self) -> float:
        """1 if the source is above the reference, −1 if it is below it."""
        return 1.0 if self.source >= self.reference else -1.0

    def relative(self, volt: float) -> float:
        """Return a potential taken from the reference, positive towards the source."""
        return self.sign * (volt - self.reference)


@dataclass(frozen=True, eq=False)
class PotentialTerms:
    """Numbers of the equation with potentials on a panel; see the module.

    Attributes
    ----------
    of_drive, of_load : array, shape (rows, columns)
        E and F.
    held : boolean array, shape (rows, columns)
        Whether the sensed line is held while it is idle.
    held_volt : array, shape (rows, columns)
        Vq.
    load_volt : array, shape (rows, columns)
        Vs.
    ends : array, shape (addresses, lines)
        Potentials in which the lines end in Z, those of an address's loads included.
    follows : array, shape (rows, columns), or None
        A' of E = U − Vp·(Rd/Rp) by Vp, where idle driven lines follow the sensed one.
    """

    of_drive: Array
    of_load: Array
    held: NDArray[np.bool_]
    held_volt: Array
    load_volt: Array
    ends: Array
    follows: Array | None

    @cached_property
    def sourced(self) -> bool:
        """Whether Z is excited by idle potentials, so that readings depend on v."""
        return self.follows is not None or bool(self.ends.any())

    @cached_property
    def loaded(self) -> bool:
        """Whether a sensed line that is read has a potential of its own, F ≠ 0."""
        return bool(self.of_load.any())

    @cached_property
    def shares(self) -> tuple[Array, Array] | None:
        """1 where sensed lines are held while idle, and where they are not; None: none is held."""
        held = self.held.astype(float)
        return (held, 1 - held) if self.held.any() else None

    def line_volt(
        self,
        terms: tuple[tuple[Array, Array], tuple[Array, Array]],
        entries: tuple[Any, Any, Any],
        potentials: tuple[Any, Any],
    ) -> Any:
        """Return V_j, (rows, columns); NumPy and CasADi.

        Parameters
        ----------
        terms : pair of pairs of arrays
            (A, A') and (B, B').
        entries : tuple
            Z_ii, Z_jj and Z_ij.
        potentials : tuple
            v_i and v_j.
        """
        if self.follows is None:
            return self._line_volt(terms, entries, potentials, self.of_drive, self.of_load)
        # V_j = V_0 + V_1 Vp with Vp = V_j, where V_1 is excited by idle driven lines alone
        alone = (0.0 * potentials[0], 0.0 * potentials[1])
        without = self._line_volt(terms, entries, alone, self.of_drive, self.of_load)
        share = self._line_volt(terms, entries, potentials, self.follows, 0.0 * self.of_load)
        return without / (1 - share)

    def _line_volt(
        self,
        terms: tuple[tuple[Array, Array], tuple[Array, Array]],
        entries: tuple[Any, Any, Any],
        potentials: tuple[Any, Any],
        of_drive: Array,
        of_load: Array,
    ) -> Any:
        """Return V_j by the equations of this module, solved for one pair of lines.

        Parameters
        ----------
        terms : pair of pairs of array
            (A, A') and (B, B').
        entries : tuple
            Z_ii, Z_jj and Z_ij, numbers or symbols.
        potentials : tuple
            v_i and v_j.
        of_drive, of_load : array
            E and F.
        """
        (drive, by_drive), (load, by_load) = terms
        own_driven, own_sensed, mutual = entries
        driven_volt, sensed_volt = potentials
        driving = drive + own_driven * by_drive
        square = mutual * mutual
        determinant = driving * (load + own_sensed * by_load) - square * (by_drive * by_load)
        lifted = sensed_volt
        held, free = self.shares or (None, 1.0)
        if self.loaded:
            # Of a sensed line that is tied while idle B = 1, and 1/Rs of one that is held
            through = own_sensed if held is None else free * own_sensed + held
            lifted = sensed_volt + through * of_load
        rises = mutual * (of_drive - driven_volt * by_drive) + driving * lifted
        if self.loaded:
            rises = rises - free * (of_load * by_drive) * square
        volt = rises / determinant
        return volt if held is None else volt + held * self.held_volt


class EndedCircuit(Protocol):
    """Part of a circuit whose line ends are checked."""

    @property
    def groups(self) -> Groups | None:
        """Sensed lines behind one multiplexer each."""

    @property
    def driven_groups(self) -> Groups | None:
        """Driven lines behind one multiplexer each."""

    @property
    def idle_volt(self) -> float | Literal["follows"] | None:
        """Potential of idle driven lines."""

    @property
    def idle_connected(self) -> bool:
        """Whether idle driven lines end anywhere."""

    @property
    def loads_connected(self) -> tuple[bool, bool]:
        """Whether sensed lines end anywhere while read, and elsewhere while idle."""

    @property
    def line_ends(self) -> LineEnds:
        """Potentials in which lines end."""


def check_line_ends(circuit: EndedCircuit) -> None:
    """Raise ValueError if potentials contradict the circuit."""
    volts = {name: getattr(circuit, name) for name in ("idle_volt", "load_volt", "idle_load_volt")}
    for name, volt in volts.items():
        if isinstance(volt, float | int) and not abs(volt) <= MAX_VOLT:
            raise ValueError(f"{name} must lie within {MAX_VOLT:g} V of ground")
    loads, idle_loads = circuit.loads_connected
    for name, connected, lines in (
        ("idle_volt", circuit.idle_connected, "idle driven lines"),
        ("load_volt", loads, "sensed lines"),
        ("idle_load_volt", idle_loads, "idle sensed lines keep their load or"),
    ):
        if volts[name] is not None and not connected:
            raise ValueError(f"{name} has no place where {lines} float: name their resistor")
    if circuit.idle_volt == FOLLOWS:
        if circuit.groups is not None and len(circuit.groups) > 1:
            raise ValueError(
                "idle_volt: follows needs one sensed line at a time, not groups in parallel"
            )
        if circuit.driven_groups is not None:
            raise ValueError("idle_volt: follows has no place with driven_groups")
    ends = circuit.line_ends
    if circuit.idle_volt != FOLLOWS and ends.source == ends.reference:
        raise ValueError(
            f"all lines end at {ends.source:g} V, as the driven one does: no current flows"
        )
