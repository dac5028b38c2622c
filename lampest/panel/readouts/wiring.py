"""Wire, contacts and touching lines between the terminals and the cells, all exact; the network seen from terminals.

Every cell takes one segment of wire more than the one before it, the first included, as in badcrossbar (Joksas &
Mehonic, SoftwareX 12, 2020). A contact is in series with the first segment; lines touch beyond the contacts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import Configuration
from lampest.panel.kirchhoff import bipartite
from lampest.panel.network import Entries, Loading, Network, Numbers, ReadCircuit, SecondOrder
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import PerLine, check_lines, per_line
from lampest.panel.readouts.tied import TiedNetwork


@dataclass(frozen=True)
class Lines(Configuration):
    """Resistance of the lines themselves (conductive thread, ITO), in ohm for the way from one cell to the next.

    row_ohm_per_cell, column_ohm_per_cell : of a row from column to column, and of a column from row to row; the way
        from the terminal to the first cell counts as one more. Zero: none.
    rows_enter : the side at which the rows' terminals are; at the left, column 0 is the nearest.
    columns_leave : the side at which the columns' terminals are; at the bottom, the last row is the nearest.

    >>> lampest.Lines(row_ohm_per_cell=1.0).resist
    True
    """

    row_ohm_per_cell: float = 0.0
    column_ohm_per_cell: float = 0.0
    rows_enter: Literal["left", "right"] = "left"
    columns_leave: Literal["bottom", "top"] = "bottom"

    def __post_init__(self) -> None:
        check_lines("row_ohm_per_cell", self.row_ohm_per_cell)
        check_lines("column_ohm_per_cell", self.column_ohm_per_cell)

    @property
    def resist(self) -> bool:
        """Whether there is any resistance."""
        return self.row_ohm_per_cell > 0 or self.column_ohm_per_cell > 0


@dataclass(frozen=True)
class ContactPrior(Configuration):
    """Prior of the contacts of one side's lines, in ohm: a number, or one for each line.

    mean_ohm, sd_ohm : mean and standard deviation. sd_ohm 0: known.

    >>> lampest.ContactPrior(mean_ohm=5.0, sd_ohm=2.0).sd_ohm
    2.0
    """

    mean_ohm: PerLine = 0.0
    sd_ohm: PerLine = 0.0

    def __post_init__(self) -> None:
        check_lines("mean_ohm", self.mean_ohm)
        check_lines("sd_ohm", self.sd_ohm)


@dataclass(frozen=True)
class Contacts(Configuration):
    """Resistance between every line and its terminal, the same in all frames, as far as it is known.

    rows, columns : of the lines of either side.

    >>> lampest.Contacts(rows=lampest.ContactPrior(5.0, 2.0)).rows.mean_ohm
    5.0
    """

    rows: ContactPrior = ContactPrior()
    columns: ContactPrior = ContactPrior()

    def mean(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm. Raises ValueError where a list has another length."""
        return self._of_lines("mean_ohm", shape)

    def deviation(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm. Raises ValueError where a list has another length."""
        return self._of_lines("sd_ohm", shape)

    def _of_lines(self, name: str, shape: tuple[int, ...]) -> Array:
        sides = zip(("rows", "columns"), (self.rows, self.columns), shape, strict=True)
        return np.concatenate([per_line(f"contacts.{side}.{name}", getattr(own, name), n) for side, own, n in sides])

    @classmethod
    def of(cls, mean: Array, deviation: Array, rows: int) -> "Contacts":
        """Return the contacts from (lines) ohm each, rows first."""
        both = np.stack([mean, deviation])
        return cls(*(ContactPrior(*map(tuple, part.tolist())) for part in (both[:, :rows], both[:, rows:])))


@dataclass(frozen=True)
class Wiring:
    """Lines, contacts and joined lines of a panel.

    Attributes
    ----------
    lines : Lines
        Their wire.
    joined : tuple of tuple of int
        Groups of lines that touch, by their numbers, rows first.
    contacts : Contacts or None
        Or None.
    """

    lines: Lines = Lines()
    joined: tuple[tuple[int, ...], ...] = ()
    contacts: Contacts | None = None

    def contact_ohm(self, shape: tuple[int, ...]) -> Array:
        """(lines) ohm, as far as it is known."""
        return np.zeros(sum(shape)) if self.contacts is None else self.contacts.mean(shape)

    def path_ohm(self, shape: tuple[int, ...]) -> Array:
        """Wire from terminal to terminal through every cell, (rows, columns) ohm; of contacts as much as may be."""
        rows, columns = shape
        along, down = np.arange(1, columns + 1), np.arange(1, rows + 1)
        along = along[::-1] if self.lines.rows_enter == "right" else along
        down = down[::-1] if self.lines.columns_leave == "bottom" else down
        wire = self.lines.row_ohm_per_cell * along + self.lines.column_ohm_per_cell * down[:, None]
        if self.contacts is None:
            return np.asarray(wire)
        most = self.contacts.mean(shape) + NOISE_REACH * self.contacts.deviation(shape)
        return np.asarray(wire + most[:rows, None] + most[rows:])

    def nodes(self, count: int) -> Array:
        """Return E (lines, nodes): 1 where a line belongs to a node; lines that touch are one."""
        first = np.arange(count)
        for group in self.joined:
            first[list(group)] = min(group)
        return np.asarray(first[:, None] == np.unique(first), dtype=float)


@dataclass(frozen=True, eq=False)
class Ladder:
    """K·i = e, the currents i through cells under potential differences e = Bᵀp of terminals at p.

    K = diag(r) + T, T_cd = Σ of the wire that cells c and d share on their ways to terminals. Block elimination: the
    lines of one side are rungs, the others' wire the rails. The rungs passed so far are a source with an internal
    conductance, to which each rung adds its own and each segment of the rails its resistance. Costs long·short³.

    Attributes
    ----------
    swapped : bool
        Whether the columns are the rungs.
    outer, inner : slice
        Steps that put rungs and their cells in order; rungs enter at their first cell, rails leave at the last.
    rung : array
        (rungs, n, n) siemens, of every rung's own K⁻¹.
    passed : array
        (rungs, n, n), the share of the current that gets through the next segment of the rails.
    shown : array
        (rungs, n, n) siemens, the conductance of all rungs so far beyond that segment.
    segment_ohm : array
        (rungs, n) of the rails, the contacts in the last.
    """

    swapped: bool
    outer: slice
    inner: slice
    rung: Array
    passed: Array
    shown: Array
    segment_ohm: Array

    @classmethod
    def of(cls, cells: Array, wiring: Wiring) -> "Ladder":
        """Return the ladder of cells (rows, columns) ohm in the panel's order.

        The longer side's lines are the rungs.
        """
        lines, swapped = wiring.lines, cells.shape[1] > cells.shape[0]
        flipped = [lines.columns_leave == "top", lines.rows_enter == "right"]
        ohm = [lines.row_ohm_per_cell, lines.column_ohm_per_cell]
        contacts = np.split(wiring.contact_ohm(cells.shape), [len(cells)])
        if swapped:
            flipped, ohm, contacts = [not flip for flip in flipped[::-1]], ohm[::-1], contacts[::-1]
        outer, inner = (slice(None, None, -1 if flip else 1) for flip in flipped)
        turned = (cells.T if swapped else cells)[outer, inner]
        count, size = turned.shape
        steps, every = np.arange(1, size + 1), np.arange(size)
        matrix = np.tile(ohm[0] * np.minimum.outer(steps, steps).astype(float), (count, 1, 1))
        matrix += contacts[0][outer, None, None]
        matrix[:, every, every] += turned
        segment = np.full((count, size), ohm[1])
        segment[-1] += contacts[1][inner]
        rung = np.linalg.inv(matrix)
        passed, shown, before = np.empty_like(rung), np.empty_like(rung), np.zeros((size, size))
        for number in range(count):
            total = before + rung[number]
            passed[number] = np.linalg.inv(np.eye(size) + total * segment[number])
            before = shown[number] = passed[number] @ total
        return cls(swapped, outer, inner, rung, passed, shown, segment)

    def solve(self, differences: Array) -> Array:
        """Return i = K⁻¹·e: currents through the cells for e (rows, columns, patterns) volt, the same shape, ampere."""
        turned = (differences.swapaxes(0, 1) if self.swapped else differences)[self.outer, self.inner]
        own = self.rung @ turned
        source, potential = np.empty_like(own), np.empty_like(own)
        before, after = np.zeros(own.shape[1:]), np.zeros(own.shape[1:])
        for number in range(len(own)):
            before = source[number] = self.passed[number] @ (before + own[number])
        for number in reversed(range(len(own))):
            current = source[number] - self.shown[number] @ after
            after = potential[number] = after + self.segment_ohm[number, :, None] * current
        current = (own - self.rung @ potential)[self.outer, self.inner]
        return current.swapaxes(0, 1) if self.swapped else current


@dataclass(frozen=True, eq=False)
class WiredNetwork(TiedNetwork):
    """Network with wire: the terminals' currents are BC·p, C = K⁻¹Bᵀ; Z = (BC + diag t)⁻¹, touching lines taken as one.

    D = (r C Z)ᵀ are the potential differences across the cells for a unit current into every terminal; ∂Z_ab/∂g_c =
    −D_ac D_bc as without wire. With X = diag(r) − r K⁻¹ r + DᵀCᵀ r, those for a unit current through every cell,
    ∂D_ac/∂g_d = −D_ad X_dc. Without wire X = BᵀZB.

    Attributes
    ----------
    ties : array, shape (lines)
        Siemens.
    wiring, ladder : Ladder or Wiring
        Wire between terminals and cells, and its K⁻¹.
    currents : array
        C (cells, lines) siemens.
    """

    ties: Array
    wiring: Wiring
    ladder: Ladder
    currents: Array

    @classmethod
    def solve(cls, cell_resistance: Array, ties: Array, readout: ReadCircuit, wiring: Wiring) -> "WiredNetwork":
        """Solve cells (rows, columns) ohm. Raises numpy.linalg.LinAlgError where a line is not connected."""
        rows, columns = cell_resistance.shape
        ladder = Ladder.of(cell_resistance, wiring)
        currents = ladder.solve(incidence(rows, columns)).reshape(-1, rows + columns)
        through = currents.reshape(rows, columns, -1)
        admittance = np.concatenate([through.sum(axis=1), -through.sum(axis=0)])
        nodes = wiring.nodes(rows + columns)
        impedance = nodes @ np.linalg.inv(nodes.T @ (admittance + np.diag(ties)) @ nodes) @ nodes.T
        return cls(cell_resistance, 1 / cell_resistance, impedance, readout, ties, wiring, ladder, currents)

    @cached_property
    def potential_differences(self) -> Array:
        """D = (r C Z)ᵀ (lines, cells) ohm."""
        return np.asarray((self.cell_resistance.reshape(-1, 1) * (self.currents @ self._impedance)).T)

    def changes(self, step: Array) -> Entries:
        """Return the entries of dZ = D·diag(g·p)·Dᵀ."""
        differences = self.potential_differences
        return self.entries((differences * (self.conductance * step).ravel()) @ differences.T)

    def drawn(self, loading: Loading) -> Array:
        """diag(Dᵀ W D)."""
        differences = self.potential_differences
        drawn = np.sum(differences * bipartite(*loading, differences), axis=0)
        return np.asarray(drawn.reshape(self.conductance.shape))

    def _own_differences(self) -> tuple[Array, Array]:
        rows, columns = self.conductance.shape
        row, column = np.indices((rows, columns))
        differences = self.potential_differences.reshape(-1, rows, columns)
        return differences[row, row, column], differences[rows + column, row, column]

    def driven_through(self, sources: Array) -> Array:
        """X·s (cells, patterns) volt of currents s (cells, patterns) that are driven through cells."""
        resistance = self.cell_resistance.reshape(-1, 1)
        pushed = resistance * sources
        drawn = self.ladder.solve(pushed.reshape(*self.conductance.shape, -1)).reshape(pushed.shape)
        return np.asarray(pushed - resistance * drawn + self.potential_differences.T @ (self.currents.T @ pushed))

    def transfer_between(self, cells: Numbers | None) -> Array:
        """X, which wire makes another matrix than BᵀZB."""
        whole = self.driven_through(np.eye(self.conductance.size))
        return whole if cells is None else whole[np.ix_(cells, cells)]

    def contact_response(self) -> Array:
        """∂y/∂c of the lines' contacts c, (rows, columns, lines): ∂Z_ab/∂c_l = X_la X_lb with X = 1 − diag(t) Z.

        X_la is the current that enters line l while a unit current enters terminal a.
        """
        entering = np.eye(len(self.ties)) - self.ties[:, None] * self._impedance
        return np.stack([self.read_change(self.entries(np.outer(line, line))) for line in entering], axis=-1)

    def second_order(self, weights: Array) -> SecondOrder:
        return WiredSecondOrder(self, weights)


@dataclass(frozen=True, eq=False)
class WiredSecondOrder(SecondOrder):
    """H of weights at a network with wire."""

    network: WiredNetwork

    def adjoint(self) -> Array:
        """g·diag(Dᵀ W D)."""
        return np.asarray(self.network.conductance * self.network.drawn(self.loading))

    def products(self, step: Array) -> tuple[Array, Array]:
        """Return (J·p, g·(2 diag(Dᵀ W dD) + diag(Dᵀ W' D))), dDᵀ = X·(g·p·Dᵀ), W' from the slopes' change."""
        network, change = self.network, self.network.changes(step)
        differences = network.potential_differences
        moved = network.driven_through((differences * (network.conductance * step).ravel()).T).T
        twice = 2 * np.sum(moved * bipartite(*self.loading, differences), axis=0).reshape(step.shape)
        return network.read_change(change), network.conductance * (twice + network.drawn(self.loading_change(change)))

    def _twice_between(self, cells: Numbers | None) -> Array:
        chosen = self.network.potential_differences[:, slice(None) if cells is None else cells]
        return np.asarray(chosen.T @ bipartite(*self.loading, chosen))


def contact_responses(networks: Sequence[Network]) -> Array:
    """∂y/∂c (networks · cells, lines) of wired networks, one after the other."""
    wired = [network for network in networks if isinstance(network, WiredNetwork)]
    return np.concatenate([network.contact_response().reshape(network.conductance.size, -1) for network in wired])


def wire_responses(network: Network, lines: Lines) -> Array:
    """Return ∂y/∂ρ of the wire of all rows and of all columns from cell to cell, (2, …, rows, columns).

    ∂Z_ab/∂ρ = Σ I_a I_b over its segments, I_a the current through a segment, and so through all cells beyond it, for
    a unit current into a.
    """
    currents = network.potential_differences * network.flat_conductance[..., None, :]
    maps, responses = currents.reshape(*currents.shape[:-1], *network.conductance.shape[-2:]), []
    for axis, near_first in ((-1, lines.rows_enter == "left"), (-2, lines.columns_leave == "top")):
        beyond = np.cumsum(np.flip(maps, axis) if near_first else maps, axis).reshape(currents.shape)
        responses.append(network.read_change(network.entries(beyond @ beyond.swapaxes(-1, -2))))
    return np.stack(responses)


def incidence(rows: int, columns: int) -> Array:
    """Bᵀ (rows, columns, lines): +1 at a cell's row, −1 at its column."""
    matrix = np.zeros((rows, columns, rows + columns))
    row, column = np.indices((rows, columns))
    matrix[row, column, row], matrix[row, column, rows + column] = 1.0, -1.0
    return matrix
