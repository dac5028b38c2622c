"""Circuit of one panel: nodes, and the branches between them.

Every line has a terminal, where the electronics connect. Between the terminals lie the cells and,
where the lines resist, the wire: one node on the row and one on the column of every crossing. Nodes
that are joined by no resistance are one node. Without wire, contacts and touching lines the nodes
are the lines, rows before columns.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from lampest.files.typed import ReadOnlyArrays
from lampest.panel.equation import equation_of
from lampest.panel.kirchhoff import current_balance
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, eq=False)
class ConductanceSymbols:
    """Symbols of the conductances of one frame, and the equation of its readings.

    Attributes
    ----------
    conductance : casadi.SX, shape (cells, 1)
        Conductances g of the cells in 1/`scale`.
    tie : casadi.SX, shape (lines, 1)
        Ties t of the terminals to ground in 1/`scale`.
    scale : casadi.SX
        Unit of resistances in ohm; voltages for unit currents have the same unit.
    reading : callable
        Equation of the readings, see `Equation.reading`.
    """

    conductance: casadi.SX
    tie: casadi.SX
    scale: casadi.SX
    reading: Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Circuit(ReadOnlyArrays):
    """Nodes and branches of a panel.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns.
    count : int
        Number of nodes.
    terminals : array of int, shape (rows + columns,)
        Node of the terminal of every line, rows before columns.
    points : array of int, shape (rows + columns,)
        Node at which every line is excited and read: its terminal, or the far end of its wire.
    cell_ends : array of int, shape (2, cells)
        Nodes on the row and on the column of every cell, row-major.
    wire_ends : array of int, shape (2, wires)
        Nodes at both ends of every piece of wire or contact.
    wire_siemens : array, shape (wires,)
    held : boolean array, shape (rows + columns,)
        Whether a line's terminal is held at ground.
    read : boolean array, shape (rows, columns)
        Readings that are taken with this state of the lines.
    ends : array, shape (rows + columns,), or None
        Potentials in which the lines end, volt; None: at the ground of the circuit.
    """

    shape: tuple[int, int]
    count: int
    terminals: Numbers
    points: Numbers
    cell_ends: Numbers
    wire_ends: Numbers
    wire_siemens: Array
    held: Mask
    read: Mask
    ends: Array | None = None

    @classmethod
    def of_readout(
        cls, readout: Readout, shape: tuple[int, int], wiring: Wiring | None
    ) -> "tuple[Circuit, ...]":
        """Return the circuit of every address of a readout."""
        equation = equation_of(readout, *shape)
        circuit = cls.of(shape, wiring, equation.read_at_far_end)
        terms = equation.potentials
        ends = [None] * len(equation.ties) if terms is None or not terms.sourced else terms.ends
        addresses = []
        for ties, read, volts in zip(equation.ties, equation.read_at, ends, strict=True):
            held = np.isinf(ties)
            points = np.where(held, circuit.terminals, circuit.points)
            addresses.append(replace(circuit, points=points, held=held, read=read > 0, ends=volts))
        return tuple(addresses)

    @classmethod
    def of(
        cls, shape: tuple[int, int], wiring: Wiring | None, at_far_end: Mask | None = None
    ) -> "Circuit":
        """Return the circuit of a panel of rows × columns cells, without lines at ground.

        Lines `at_far_end`, (lines,), are read there; None: none.
        """
        rows, columns = shape
        wiring = Wiring() if wiring is None else wiring
        lines = np.arange(rows + columns)
        # Before nodes are joined: terminals, then the row's and the column's node of every
        # crossing.
        crossings = np.arange(rows * columns).reshape(shape)
        on_row = len(lines) + crossings
        on_column = on_row + crossings.size
        # Contacts, and segments between crossings: pieces follow line by line, from the terminal to
        # the last crossing.
        wire = wiring.lines
        contacts = wiring.contact_ohm(shape)
        along_rows = on_row if wire.rows_enter == "left" else on_row[:, ::-1]
        along_columns = on_column if wire.columns_leave == "top" else on_column[::-1]
        pieces = list[tuple[int, int]]()
        of_pieces = list[float]()
        for line, nodes in enumerate([*along_rows.tolist(), *along_columns.T.tolist()]):
            segment = wire.row_ohm_per_cell if line < rows else wire.column_ohm_per_cell
            pieces += pairwise([line, *nodes])
            of_pieces += [contacts[line] + segment, *[segment] * (len(nodes) - 1)]
        ends = np.array(pieces, dtype=np.intp).T
        ohm = np.array(of_pieces)
        last = ends[1, np.cumsum(np.repeat((columns, rows), shape)) - 1]
        points = lines if at_far_end is None else np.where(at_far_end, last, lines)
        joined = [(group[0], line) for group in wiring.joined for line in group[1:]]
        pairs = np.array(joined, dtype=np.intp).reshape(-1, 2)
        touching = np.concatenate([ends[:, ohm == 0], pairs.T], axis=1)
        total = len(lines) + 2 * crossings.size
        links = scipy.sparse.coo_array((np.ones(touching.shape[1]), touching), shape=(total, total))
        count, node = scipy.sparse.csgraph.connected_components(links, directed=False)
        resisting = ohm > 0
        branches = ends[:, resisting]
        siemens = 1 / ohm[resisting]
        if wiring.leaks is not None:
            between, of_leaks = wiring.leaks.between(shape)
            branches = np.concatenate([branches, between], axis=1)
            siemens = np.concatenate([siemens, of_leaks])
        cell_ends = node[np.stack([on_row.ravel(), on_column.ravel()])]
        return cls(
            shape,
            count=int(count),
            terminals=node[lines],
            points=node[points],
            cell_ends=cell_ends,
            wire_ends=node[branches],
            wire_siemens=siemens,
            held=np.zeros(len(lines), dtype=bool),
            read=np.ones(shape, dtype=bool),
        )

    @property
    def lines_only(self) -> bool:
        """Whether every line is one node of its own, without wire, and none is held at ground."""
        own_nodes = self.count == len(self.terminals)
        return own_nodes and not len(self.wire_siemens) and not self.held.any()

    @cached_property
    def free(self) -> Numbers:
        """Nodes that are not held at ground."""
        return np.setdiff1d(np.arange(self.count), self.terminals[self.held])

    def excitations(self, lines: Numbers) -> tuple[Array, Array]:
        """Return what excites each of some lines; zero at all other nodes.

        Returns
        -------
        potentials, currents : arrays, shape (nodes, patterns)
            1 V of a line that is held, 1 A of any other one.
        """
        held, free = np.zeros((2, self.count, len(lines)))
        patterns = np.arange(len(lines))
        held[self.points[lines], patterns] = self.held[lines]
        free[self.points[lines], patterns] = ~self.held[lines]
        return held, free

    @cached_property
    def held_potentials(self) -> Array:
        """Given potentials while the lines are at their ends: those of held lines, (nodes, 1)."""
        assert self.ends is not None
        volt = np.zeros((self.count, 1))
        volt[self.terminals[self.held], 0] = self.ends[self.held]
        return volt

    @cached_property
    def incidence(self) -> casadi.DM:
        """B, (nodes, cells): +1 at a cell's node on the row, −1 at its node on the column."""
        return _symbolic(self._cell_incidence)

    @cached_property
    def _cell_incidence(self) -> scipy.sparse.csc_array:
        return _incidence(self.count, self.cell_ends)

    @cached_property
    def _wire_admittance(self) -> scipy.sparse.csc_array:
        """Conductance matrix of the wire alone, (nodes, nodes) siemens."""
        incidence = _incidence(self.count, self.wire_ends)
        return scipy.sparse.csc_array((incidence * self.wire_siemens) @ incidence.T)

    @cached_property
    def at_terminals(self) -> casadi.DM:
        """T, (nodes, lines): 1 where a line's terminal is the node."""
        lines = len(self.terminals)
        return casadi.DM.triplet(
            self.terminals.tolist(), list(range(lines)), casadi.DM.ones(lines), self.count, lines
        )

    def balance(self, symbols: ConductanceSymbols, voltage: casadi.SX) -> casadi.SX:
        """Return the net current out of every node: B(g ∘ BᵀV) + W V + diag(T t) V.

        `voltage` and the balance have shape (nodes, patterns).
        """
        out = current_balance(self.incidence, symbols.conductance, voltage)
        if len(self.wire_siemens):
            out += symbols.scale * (_symbolic(self._wire_admittance) @ voltage)
        return casadi.SX(out + casadi.diag(self.at_terminals @ symbols.tie) @ voltage)

    def voltages(self, cell_resistance: Array, tie: Array) -> Array:
        """Return the voltages of all nodes for each line's excitation, (nodes, lines).

        A line that is held at ground is excited by 1 V, any other line by 1 A into its terminal.
        The voltages while all lines are at their ends follow, if they have potentials.

        Parameters
        ----------
        cell_resistance : array, shape (rows, columns)
            Ohm.
        tie : array, shape (lines,)
            Ties of the terminals to ground in siemens; those of held lines do not count.

        Raises
        ------
        RuntimeError
            If a node is not connected.
        """
        ground = np.bincount(self.terminals, np.where(self.held, 0.0, tie), self.count)
        cells = self._cell_incidence
        admittance = scipy.sparse.csc_array(
            (cells * (1 / cell_resistance.ravel())) @ cells.T
            + self._wire_admittance
            + scipy.sparse.diags_array(ground)
        )
        lines = np.arange(len(self.terminals))
        volt, currents = self.excitations(lines)
        if self.ends is not None:
            volt = np.hstack([volt, self.held_potentials])
            by_ends = np.where(self.held, 0.0, tie * self.ends)
            into_nodes = np.bincount(self.terminals, by_ends, self.count)
            currents = np.hstack([currents, into_nodes[:, None]])
        into = currents - admittance @ volt
        free = self.free
        if not len(free):
            return volt
        between = admittance if len(free) == self.count else admittance[free][:, free].tocsc()
        volt[free] = scipy.sparse.linalg.splu(between).solve(into[free])
        return volt


def _incidence(nodes: int, ends: Numbers) -> scipy.sparse.csc_array:
    """Return the incidence matrix of branches, sparse (nodes, branches); 1 and −1 at the ends."""
    branch = np.arange(ends.shape[1])
    entries = np.repeat([1.0, -1.0], len(branch))
    places = ends.ravel(), np.tile(branch, 2)
    return scipy.sparse.csc_array((entries, places), shape=(nodes, len(branch)))


def _symbolic(matrix: scipy.sparse.csc_array) -> casadi.DM:
    """Return a sparse matrix of CasADi."""
    entries = matrix.tocoo()
    places = entries.row.tolist(), entries.col.tolist()
    return casadi.DM.triplet(*places, casadi.DM(entries.data), *matrix.shape)
