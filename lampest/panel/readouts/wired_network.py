"""Exact networks with wire resistance, contacts and touching lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.panel.difference_network import DifferenceNetwork, excitations
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.wiring import Lines, Wiring
from lampest.panel.tied_network import ReadCircuit


@dataclass(frozen=True, eq=False)
class Ladder:
    """Factorisation of K·i = e for the currents i through cells.

    The potential differences are e = Bᵀp of the terminals. K = diag(r) + T, T_cd the resistance of
    the wire that the paths of cells c and d to the terminals share. K is solved by block
    elimination along a ladder: the rows are its rungs, the wire of the columns its rails. The rungs
    passed so far act as a source with an internal conductance. Each rung adds its own conductance
    to it, and each segment of the rails its resistance. The cost is rows·columns³.

    Attributes
    ----------
    outer, inner : slice
        Slices that order the rungs, and the cells of a rung: a rung enters at its first cell, rails
        leave at the last rung.
    rung : array, shape (rungs, n, n)
        Inverse of K of every rung alone, siemens.
    passed : array, shape (rungs, n, n)
        Share of the source current that passes the next segment of the rails.
    shown : array, shape (rungs, n, n)
        Conductance of all rungs so far, as seen behind that segment, siemens.
    segment_ohm : array, shape (rungs, n)
        Resistance of the segments of the rails, ohm; the last one includes the contacts.
    """

    outer: slice
    inner: slice
    rung: Array
    passed: Array
    shown: Array
    segment_ohm: Array

    @classmethod
    def of(cls, cells: Array, wiring: Wiring) -> "Ladder":
        """Return the ladder of cells (rows, columns) ohm."""
        lines = wiring.lines
        contacts = wiring.contact_ohm(cells.shape)
        outer = slice(None, None, -1 if lines.columns_leave == "top" else 1)
        inner = slice(None, None, -1 if lines.rows_enter == "right" else 1)
        turned = cells[outer, inner]
        count, size = turned.shape
        steps = np.arange(1, size + 1)
        index = np.arange(size)
        # K of one rung: cells c and d share min(c, d) segments and the rung's contact; r on the
        # diagonal.
        matrix = np.tile(
            lines.row_ohm_per_cell * np.minimum.outer(steps, steps).astype(float), (count, 1, 1)
        )
        matrix += contacts[:count][outer, None, None]
        matrix[:, index, index] += turned
        segment = np.full((count, size), lines.column_ohm_per_cell)
        segment[-1] += contacts[count:][inner]
        rung = np.linalg.inv(matrix)
        passed = np.empty_like(rung)
        shown = np.empty_like(rung)
        conductance = np.zeros((size, size))
        for number in range(count):
            # Y ← (1 + (Y + Y_rung)·diag(segment))⁻¹ (Y + Y_rung), the conductance behind the next
            # segment
            total = conductance + rung[number]
            passed[number] = np.linalg.inv(np.eye(size) + total * segment[number])
            conductance = passed[number] @ total
            shown[number] = conductance
        return cls(outer, inner, rung, passed, shown, segment)

    def solve(self, differences: Array) -> Array:
        """Return i = K⁻¹·e, the currents through the cells, in ampere.

        e is (rows, columns, patterns) volt; the result has the same shape.
        """
        driven = self.rung @ differences[self.outer, self.inner]
        source = np.empty_like(driven)
        potential = np.empty_like(driven)
        # Forward: source current of all rungs so far, behind each segment.
        behind = np.zeros(driven.shape[1:])
        for number in range(len(driven)):
            behind = self.passed[number] @ (behind + driven[number])
            source[number] = behind
        # Backward: currents through the segments, and potentials of the rails at each rung.
        rail = np.zeros(driven.shape[1:])
        for number in reversed(range(len(driven))):
            current = source[number] - self.shown[number] @ rail
            rail = rail + self.segment_ohm[number, :, None] * current
            potential[number] = rail
        return np.asarray((driven - self.rung @ potential)[self.outer, self.inner])


@dataclass(frozen=True, eq=False)
class WiredNetwork(DifferenceNetwork):
    """Network with wiring between terminals and cells.

    The currents of the terminals at potentials p are BC·p with C = K⁻¹Bᵀ, and Z = (BC + diag t)⁻¹
    with touching lines as one node. D = (r C Pᵀ)ᵀ are the potential differences across the cells
    for the excitation of every terminal; ∂Z_ab/∂g_c = −D_ac D_bc as without wiring. X = diag(r) − r
    K⁻¹ r + DᵀCᵀ r are the differences for a unit current through every cell; ∂D_ac/∂g_d = −D_ad
    X_dc. Without wiring X = BᵀZB.

    Attributes
    ----------
    wiring : Wiring
        Wire, contacts and touching lines.
    ladder : Ladder
        Factorisation of K.
    currents : array, shape (cells, lines)
        C in siemens.
    """

    wiring: Wiring
    ladder: Ladder
    currents: Array

    @classmethod
    def solve(
        cls,
        cell_resistance: Array,
        ties: Array,
        readout: ReadCircuit,
        wiring: Wiring,
        sources: Array | None = None,
    ) -> "WiredNetwork":
        """Return the solved network of cells (rows, columns) ohm.

        Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        rows, columns = cell_resistance.shape
        ladder = Ladder.of(cell_resistance, wiring)
        currents = ladder.solve(incidence(rows, columns)).reshape(-1, rows + columns)
        through = currents.reshape(rows, columns, -1)
        # B C: currents of every terminal for a unit potential at each
        admittance = np.concatenate([through.sum(axis=1), -through.sum(axis=0)])
        nodes = wiring.nodes(rows + columns)
        # Touching lines are one node, with the sum of their ties: E (Eᵀ (BC + diag t) E)⁻¹ Eᵀ
        node_ties = np.where(nodes > 0, ties[:, None], 0.0).sum(axis=0)
        entries, potentials = (
            nodes @ part @ nodes.T for part in excitations(nodes.T @ admittance @ nodes, node_ties)
        )
        return cls(
            cell_resistance,
            entries,
            readout,
            ties,
            potentials,
            wiring,
            ladder,
            currents,
            sources=sources,
        )

    @cached_property
    def potential_differences(self) -> Array:
        """D = (r C Pᵀ)ᵀ, (lines, cells) ohm."""
        return np.asarray(
            (self.cell_resistance.reshape(-1, 1) * (self.currents @ self.excited.T)).T
        )

    def driven_through(self, sources: Array) -> Array:
        """Return X·s, (cells, patterns) volt, for currents that are driven through cells.

        The currents s are (cells, patterns) ampere.
        """
        resistance = self.cell_resistance.reshape(-1, 1)
        pushed = resistance * sources
        drawn = self.ladder.solve(pushed.reshape(*self.conductance.shape, -1)).reshape(pushed.shape)
        # Currents of the terminals that are not held meet the impedance between them.
        entering = np.where(self.held[:, None], 0.0, self.currents.T @ pushed)
        return np.asarray(pushed - resistance * drawn + self.potential_differences.T @ entering)

    def contact_response(self) -> Array:
        """Return ∂y/∂c for the lines' contacts c, (rows, columns, lines) per ohm.

        ∂Z_ab/∂c_l = X_la X_lb. X_la is the current that enters line l while line a is excited: 1 −
        diag(t) Z, and −K of a held line.
        """
        ties = np.where(self.held, 0.0, self.ties)
        entering = np.eye(len(ties)) - ties[:, None] * self.excited.T
        entering = np.where(self.held[:, None], -self._impedance, entering)
        return np.stack(
            [self.read_change(self.entries(np.outer(line, line))) for line in entering], axis=-1
        )


def contact_responses(networks: Sequence[Network]) -> Array:
    """Return ∂y/∂c of wired networks, one after the other, (networks · cells, lines)."""

    def of_one(network: Network) -> Array:
        assert isinstance(network, WiredNetwork)
        return network.contact_response()

    maps = (network.response_of(of_one) for network in networks)
    return np.concatenate([part.reshape(-1, part.shape[-1]) for part in maps])


def wire_responses(network: Network, lines: Lines) -> Array:
    """Return ∂y/∂ρ for the wire ρ per cell of all rows, and of all columns, (2, …, rows, columns).

    ∂Z_ab/∂ρ = Σ I_a I_b over all segments of the wire. I_a is the current through a segment for the
    excitation of line a, which is the sum of the currents through all cells beyond the segment.
    """

    def of_one(solved: Network) -> Array:
        # Currents through the cells, g·D, then cumulated from the far end to each segment.
        currents = solved.potential_differences * solved.flat_conductance[..., None, :]
        maps = currents.reshape(*currents.shape[:-1], *solved.conductance.shape[-2:])
        responses = []
        for axis, near in ((-1, lines.rows_enter == "left"), (-2, lines.columns_leave == "top")):
            from_far_end = np.flip(maps, axis) if near else maps
            beyond = np.cumsum(from_far_end, axis).reshape(currents.shape)
            responses.append(solved.read_change(solved.entries(beyond @ beyond.swapaxes(-1, -2))))
        return np.stack(responses, axis=-1)

    return np.moveaxis(network.response_of(of_one), -1, 0)


def incidence(rows: int, columns: int) -> Array:
    """Return Bᵀ, (rows, columns, lines): +1 at a cell's row, −1 at its column."""
    matrix = np.zeros((rows, columns, rows + columns))
    row, column = np.indices((rows, columns))
    matrix[row, column, row] = 1.0
    matrix[row, column, rows + column] = -1.0
    return matrix
