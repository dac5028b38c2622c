"""Networks whose derivatives follow from potential differences across their cells.

A line that is held at ground without any resistance has a tie of infinite conductance, and Z does
not exist. The potential differences do. Where lines have wire, the differences across cells are not
those between terminals. `DifferenceNetwork` has the equations. The responses of readings to the
wire and the contacts of lines follow from it, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.panel.circuit import CircuitOfLines
from lampest.panel.equation import equation_of
from lampest.panel.kirchhoff import NormalByLines, laplacian
from lampest.panel.law import Entries, Loading
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.ladder import FarEnds, Wire, incidence, into_lines
from lampest.panel.readouts.wiring import Lines, Wiring


@dataclass(frozen=True, eq=False)
class DifferenceNetwork(SolvedNetwork):
    """Network whose derivatives follow from the potential differences D across its cells.

    A line with a tie of infinite conductance is held at ground. A held line is excited by a unit
    potential, any other line by a unit current. With C the conductances between lines that are not
    held (ties included), −G those between held and other lines, and A those between held lines, K =
    [[−(A − G C⁻¹ Gᵀ), G C⁻¹], [C⁻¹ Gᵀ, C⁻¹]] and the potentials of all lines for each excitation
    are P = [[1, G C⁻¹], [0, C⁻¹]], held lines first. Without held lines K = P = Z.

    In every case ∂K_ab/∂g_c = −D_ac D_bc and ∂D_ac/∂g_d = −D_ad X_dc with D = P·B and X = Bᵀ Z₀ B,
    Z₀ the impedance between the lines that are not held, zero for held ones. With wire B is that of
    `Wire`, and X has the part X₀ of the cells while all terminals are held. Cells are summed after
    differences are taken: nothing is lost to a tie that is only nearly infinite, or where cells are
    decades apart, at (rows + columns)·cells more operations a product than `SolvedNetwork` has
    (docs/studies/circuits.md).

    Attributes
    ----------
    ties : array, shape (lines,)
        Ties t of the terminals to ground, siemens; infinite where a line is held.
    excited : array, shape (lines, lines)
        P; row a is the excitation of line a.
    wire : Wire or None
        Wire between terminals and cells.
    far : FarEnds or None
        Far ends at which lines are read, in place of their terminals. Such a line is excited at its
        far end, by a unit current, and K has the potential there.
    """

    ties: Array
    excited: Array
    wire: Wire | None = None
    far: FarEnds | None = None

    @classmethod
    def of(
        cls,
        cell_resistance: Array,
        ties: Array,
        circuit: CircuitOfLines | None,
        sources: Array | None = None,
        wiring: Wiring | None = None,
        wire: Wire | None = None,
    ) -> "DifferenceNetwork":
        """Return the network of cells (rows, columns) ohm, with wiring between them and terminals.

        `wire` is that of the cells, which addresses share; None: the cells lie at the terminals.
        The currents of the terminals at potentials p are BC·p, and Z = (BC + diag t)⁻¹ with
        touching lines as one node. Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        wiring = wiring or Wiring()
        admittance = laplacian(1 / cell_resistance) if wire is None else wire.admittance
        leaks = wiring.leak_admittance(cell_resistance.shape)
        if leaks is not None:
            admittance = admittance + leaks
        if not wiring.joined:
            entries, excited = excitations(admittance, ties)
        else:
            # Touching lines are one node, with the sum of their ties: E (Eᵀ (BC + diag t) E)⁻¹ Eᵀ
            nodes = wiring.nodes(len(ties))
            node_ties = np.where(nodes > 0, ties[:, None], 0.0).sum(axis=0)
            of_nodes = excitations(nodes.T @ admittance @ nodes, node_ties)
            entries, excited = (nodes @ part @ nodes.T for part in of_nodes)
        far = None
        if wire is not None and circuit is not None:
            lines = equation_of(circuit, *cell_resistance.shape).read_at_far_end & ~np.isinf(ties)
            if lines.any():
                far = FarEnds.of(wire, wiring, lines)
                risen = excited @ far.of_lines.T
                entries = entries + risen + risen.T
        return cls(cell_resistance, entries, circuit, ties, excited, wire, far, sources=sources)

    @property
    def of_free(self) -> Mask:
        """Whether a line is not held at ground, (lines, 1)."""
        return ~np.isinf(self.ties)[:, None]

    def potentials(self) -> Array:
        return self.excited

    def read_potentials(self) -> Array:
        return self._read(self.excited)

    def _read(self, potentials: Array, currents: Array | None = None) -> Array:
        """Return the potentials at which lines are read, (lines, patterns).

        `potentials` are those of the terminals, P·B·i for currents i driven through the cells,
        (cells, patterns), if any.
        """
        if self.far is None:
            return potentials
        read = potentials + self.far.of_lines @ self.free(potentials)
        return read if currents is None else read + self.far.of_cells @ currents

    def free(self, values: Array) -> Array:
        return np.where(self.of_free, values, 0.0)

    def across_cells(self, values: Array) -> Array:
        return super().across_cells(values) if self.wire is None else self.wire.across(values)

    def entering(self, currents: Array) -> Array:
        """Return B·i, (lines, patterns), for currents i driven through the cells, in ampere."""
        if self.wire is not None:
            return self.wire.entering(currents)
        return into_lines(currents.reshape(*self.shape, -1))

    def driven(self, currents: Array, potentials: Array) -> Array:
        """Return X·i, (cells, patterns) volt, for currents i driven through the cells, in ampere.

        `potentials` are P·B·i of the lines, (lines, patterns).
        """
        differences = self.across_cells(self.free(potentials).T).T
        return differences if self.wire is None else differences + self.wire.within(currents)

    @cached_property
    def potential_differences(self) -> Array:
        """D (lines, cells), see `SolvedNetwork`."""
        differences = self.across_cells(self.read_potentials())
        return differences if self.far is None else differences + self.far.of_cells

    def changes(self, step: Array) -> Entries:
        if self.far is None:
            return super().changes(step)
        currents = self._currents(step)
        return self.entries(self._read(self.excited @ self.entering(currents), currents))

    @cached_property
    def transfer(self) -> Array:
        """X (cells, cells): the potential differences for a unit current through every cell."""
        if self.wire is None:
            return self.between(self.free(self.excited))
        each = np.eye(self.cell_resistance.size)
        return self.driven(each, self.excited @ self.entering(each))

    @property
    def across_readings(self) -> Array:
        """Difference across every cell for each reading, D_jc − D_kc, (readings, cells)."""
        differences = self.potential_differences
        return (differences[: self.rows, None] - differences[None, self.rows :]).reshape(
            self.transfer.shape
        )

    def own_differences(self) -> tuple[Array, Array]:
        of_rows, of_columns = np.split(
            self.potential_differences.reshape(-1, *self.shape), [self.rows]
        )
        return np.einsum("jjk->jk", of_rows), np.einsum("kjk->jk", of_columns)

    def currents(self, step: Array) -> Array:
        return self.entering(self._currents(step))

    def _currents(self, step: Array) -> Array:
        """Return diag(s)·Dᵀ, (cells, lines), for steps s (rows, columns)."""
        return self.potential_differences.T * step.reshape(-1, 1)

    def drawn(self, loading: Loading) -> Array:
        return self.drawn_of(self.weighed(loading))

    def weighed(self, loading: Loading) -> Array:
        """Return the product with W that second derivatives share, W D (lines, cells)."""
        if self.far is None:
            return self.across_cells(self.loaded(loading, self.excited))
        return self.loaded(loading, self.potential_differences)

    def drawn_of(self, weighed: Array) -> Array:
        """Return diag(DᵀWD) from `weighed`, (rows, columns)."""
        return np.asarray(np.sum(self.potential_differences * weighed, axis=0)).reshape(self.shape)

    def between_cells(self, weighed: Array) -> Array:
        """Return DᵀWD from `weighed`, (cells, cells)."""
        return self.potential_differences.T @ weighed

    def moved(self, weighed: Array, step: Array) -> tuple[Entries, Array]:
        currents = self._currents(step)
        changed = self.excited @ self.entering(currents)
        drawn = np.sum(self.driven(currents, changed).T * weighed, axis=0)
        return self.entries(self._read(changed, currents)), 2 * drawn.reshape(self.shape)

    @property
    def terminal_currents(self) -> Array:
        """Current that enters each line while a line is excited, (lines, patterns).

        The currents are 1 − diag(t) Z, and −K of a held line. At a far end none enters.
        """
        through_ties = self.free(self.ties[:, None]) * self.read_potentials().T
        excited = np.eye(len(self.ties)) if self.far is None else np.diag(~self.far.lines)
        return np.where(self.of_free, excited - through_ties, -self._impedance)

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        return Network.normal_by_lines(self, weight)


def excitations(admittance: Array, ties: Array) -> tuple[Array, Array]:
    """Return K and P of `DifferenceNetwork`.

    Raises numpy.linalg.LinAlgError if a line is not connected.

    Parameters
    ----------
    admittance : array, shape (lines, lines)
        Admittance of the lines without ties, siemens.
    ties : array, shape (lines,)
        Siemens; infinite where a line is held.

    Returns
    -------
    entries, potentials : arrays, shape (lines, lines)
        K and P.
    """
    is_held = np.isinf(ties)
    both_free = ~(is_held | is_held[:, None])
    between_free = np.where(both_free, admittance, 0.0)
    within = np.linalg.inv(between_free + np.diag(np.where(is_held, 1.0, ties)))
    # G of each held line, 0 of the others
    towards = np.where(is_held[:, None] & ~is_held, -admittance, 0.0)
    potentials = within + towards @ within
    of_held = np.where(is_held[:, None], potentials @ towards.T - admittance, potentials.T)
    return np.where(is_held, of_held, potentials), potentials


def contact_responses(networks: Sequence[Network]) -> Array:
    """Return ∂y/∂c of wired networks, one after the other, (networks · cells, lines)."""

    def of_one(solved: SolvedNetwork) -> Array:
        assert isinstance(solved, DifferenceNetwork)
        # ∂Z_ab/∂c_l = I_la I_lb, I_la the current that enters line l while line a is excited
        changes = (solved.entries(np.outer(line, line)) for line in solved.terminal_currents)
        return np.stack([solved.read_change(change) for change in changes], axis=-1)

    maps = (network.response_of(of_one) for network in networks)
    return np.concatenate([part.reshape(-1, part.shape[-1]) for part in maps])


def wire_responses(network: Network, lines: Lines) -> Array:
    """Return ∂y/∂ρ for the wire ρ per cell of all rows, and of all columns, (2, …, rows, columns).

    ∂Z_ab/∂ρ = Σ I_a I_b over all segments of the wire. I_a is the current through a segment for the
    excitation of line a, which is the sum of the currents through all cells beyond the segment.
    """

    def of_one(solved: SolvedNetwork) -> Array:
        # Currents through the cells, g·D, then cumulated from the far end to each segment.
        currents = solved.potential_differences * solved.flat_conductance[..., None, :]
        rows, columns = solved.conductance.shape[-2:]
        maps = currents.reshape(*currents.shape[:-1], rows, columns)
        circuit = solved.circuit
        far = np.zeros(rows + columns, dtype=bool)
        if circuit is not None:
            far = equation_of(circuit, rows, columns).read_at_far_end
        responses = []
        for axis, near, of_side in (
            (-1, lines.rows_enter == "left", slice(rows)),
            (-2, lines.columns_leave == "top", slice(rows, None)),
        ):
            from_far_end = np.flip(maps, axis) if near else maps
            beyond = np.cumsum(from_far_end, axis).reshape(currents.shape)
            if far[of_side].any():
                # A line that is read at its far end carries the current of its excitation, too.
                along = incidence(rows, columns).reshape(-1, rows + columns).T
                beyond[..., of_side, :] -= along[of_side]
            responses.append(solved.read_change(solved.entries(beyond @ beyond.swapaxes(-1, -2))))
        return np.stack(responses, axis=-1)

    return np.moveaxis(network.response_of(of_one), -1, 0)
