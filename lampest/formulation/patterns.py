"""Patterns of excitation, and the network of one frame.

The patterns are the one place in which the formulations differ. A pattern is a distribution of
currents into the terminals, with one voltage an unknown for each node and pattern:

    per_pixel   one pattern a pixel, as the electronics drive it: current enters row j and leaves
                column k
    nodal       one pattern a line: a unit current enters it. Those of the pixels are sums of these
                (superposition)

Source: paper, equations (2)-(9).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import casadi
import numpy as np

from lampest.formulation.circuit import Circuit, ConductanceSymbols
from lampest.panel.compiled import guarded
from lampest.panel.equation import equation_of
from lampest.panel.law import ENTRY_NAMES
from lampest.panel.panel import Array, Numbers
from lampest.panel.readouts import Readout

END_VOLTAGE = "end_voltage"  # in volt; all others are for unit currents, in V/A


@dataclass(frozen=True, eq=False)
class NetworkSymbols:
    """Symbols and equations of one frame's network.

    Attributes
    ----------
    voltages : mapping of str to casadi.SX
        Unknown voltages by name, one column each, for unit currents, in `units`.
    units : mapping of str to casadi.SX
        Unit of every voltage, a parameter: voltages of driven, floating and sensed lines differ by
        decades.
    balance : casadi.SX, shape (equations, 1)
        Kirchhoff's current law at every node: the net current out of it, less the current that
        enters. Zero at a solution, bilinear in conductances and voltages.
    reading : casadi.SX, shape (cells, 1)
        Readings y = h(V), row-major, in the readout's unit.
    places : mapping of str to list of arrays of int
        Of one address: the node of every voltage, the line that is excited, and if the current
        leaves at another line, that line.
    """

    voltages: dict[str, casadi.SX]
    units: dict[str, casadi.SX]
    balance: casadi.SX
    reading: casadi.SX
    places: Mapping[str, Sequence[Numbers]] = field(default_factory=dict)

    def values(self, response: Array) -> dict[str, Array]:
        """Return the values of the voltages in a solved network, V/A.

        `response`, (nodes, lines), are the voltages of all nodes for a unit current into each
        terminal; those by the ends of the lines follow, if they have potentials.
        """
        return {
            name: response[nodes, line] - sum(response[nodes, other] for other in others)
            for name, (nodes, line, *others) in self.places.items()
        }


def joined_addresses(
    circuits: Sequence[Circuit], networks: Sequence[NetworkSymbols]
) -> NetworkSymbols:
    """Return the network of one frame, joined from the networks of its addresses.

    Every address contributes the readings that it takes.
    """
    reading = casadi.SX(networks[0].reading.shape[0], 1)
    for circuit, network in zip(circuits, networks, strict=True):
        chosen = np.flatnonzero(circuit.read).tolist()
        reading[chosen] = network.reading[chosen]
    return replace(stacked_networks(networks), reading=reading)


def stacked_networks(networks: Sequence[NetworkSymbols]) -> NetworkSymbols:
    """Return networks of equal patterns one below the other, their readings side by side."""
    names = networks[0].voltages
    return NetworkSymbols(
        {name: casadi.vertcat(*(network.voltages[name] for network in networks)) for name in names},
        {name: casadi.vertcat(*(network.units[name] for network in networks)) for name in names},
        casadi.vertcat(*(network.balance for network in networks)),
        casadi.horzcat(*(network.reading for network in networks)),
    )


@dataclass(eq=False)
class FrameNetwork:
    """Network of one frame while it is built: voltages and units by name, balances."""

    circuit: Circuit
    readout: Readout
    symbols: ConductanceSymbols
    voltages: dict[str, casadi.SX] = field(default_factory=dict)
    units: dict[str, casadi.SX] = field(default_factory=dict)
    places: dict[str, list[Numbers]] = field(default_factory=dict)
    balances: list[casadi.SX] = field(default_factory=list)

    def new(self, name: str, *places: Numbers) -> casadi.SX:
        """Return new voltages in the unit of resistances, (rows, columns).

        Their places, see `NetworkSymbols`, are broadcast to this shape.
        """
        shape = np.broadcast_shapes(*(place.shape for place in places))
        self.places[name] = [np.broadcast_to(place, shape).ravel(order="F") for place in places]
        symbol = casadi.SX.sym(name, *shape)
        unit = casadi.SX.sym(f"unit_{name}", *shape)
        self.voltages[name] = casadi.vec(symbol)
        self.units[name] = casadi.vec(unit)
        return unit * symbol

    def excited(self, name: str, lines: Numbers) -> casadi.SX:
        """Return the entries K of all lines for the excitation of some, (lines, patterns).

        K is the voltage of a line, or the current that a line at ground takes; see
        `DifferenceNetwork`.
        """
        given, into = self.circuit.excitations(lines)
        return self.solved(name, given, casadi.DM(into), lines)

    def solved(
        self,
        name: str,
        given: Array,
        into: casadi.SX | casadi.DM,
        lines: Numbers,
        unit: casadi.SX | float = 1.0,
    ) -> casadi.SX:
        """Return the voltages of lines, or the currents of held ones in `unit`.

        The nodes that are free have unknown voltages, `given` (nodes, patterns) are those of the
        others. The currents `into` the nodes have the same shape. `lines` (patterns,) are excited.
        """
        circuit = self.circuit
        free = circuit.free.tolist()
        voltage = casadi.SX(casadi.DM(given))
        voltage[free, :] = self.new(name, circuit.free[:, None], lines)
        out = circuit.balance(self.symbols, voltage) - into
        self.balances.append(casadi.vec(out[free, :]))
        entries = voltage[circuit.points.tolist(), :]
        held = np.flatnonzero(circuit.held)
        if len(held):
            entries[held.tolist(), :] = -out[circuit.terminals[held].tolist(), :] / unit
        return entries

    def read(self, entries: list[casadi.SX]) -> NetworkSymbols:
        """Return the network with the readings by K_jj, K_kk and K_jk, (rows, columns) each.

        The unit of K is the symbols' scale in ohm between two free lines, 1 between a free and a
        held line, and the inverse of the scale between two held lines. The voltages v of all lines
        while these are at their ends follow, if they have potentials; a line that is held has its
        current in v.
        """
        circuit, scale = self.circuit, self.symbols.scale
        row, column = _lines_of_cells(circuit)
        held = circuit.held.astype(float)
        known = list[casadi.SX]()
        for first, second, entry in zip(
            (row, column, row), (row, column, column), entries, strict=True
        ):
            powers = 1.0 - held[first] - held[second]
            unit = casadi.vertcat(*(scale**power for power in powers.tolist()))
            known.append(_grid(circuit, unit) * entry)
        if circuit.ends is not None:
            # In volt, where all other voltages are for unit currents in the unit of resistances
            volt = casadi.DM(np.where(circuit.held, 0.0, circuit.ends))
            into = casadi.SX(circuit.at_terminals @ (self.symbols.tie * volt))
            last = np.array([-1])
            given = circuit.held_potentials
            known += _grids(circuit, self.solved(END_VOLTAGE, given, into, last, scale))
        return self.reading(casadi.vec(casadi.SX(self.symbols.reading(*known)).T))

    def reading(self, reading: casadi.SX) -> NetworkSymbols:
        """Return the network with its readings, (cells, 1)."""
        balance = casadi.vertcat(*self.balances)
        return NetworkSymbols(self.voltages, self.units, balance, reading, self.places)


def nodal(network: FrameNetwork) -> NetworkSymbols:
    """Return a network with one pattern a line, its equations and readings.

    The voltages of lines without wire are the symmetric matrix Z. With the n lines of the shorter
    side driven, and the m others far, the unknowns are half of the driven block of Z, the voltages
    of the far lines, and the far lines' own voltage Z_ff where the readout reads it. By reciprocity
    the balance of a far line under its own current needs no further voltage. The unknowns number
    n(n + 1)/2 + mn + m in place of (m + n)².
    """
    circuit = network.circuit
    if circuit.lines_only:
        impedance = _impedance_of_lines(network)
    else:
        lines, pattern = _patterns(circuit, network.readout)
        entries = network.excited("node_voltage", lines)
        impedance = casadi.SX(len(pattern), len(pattern))
        for line, number in enumerate(pattern):
            if number >= 0:
                impedance[:, line] = entries[:, int(number)]
                impedance[line, :] = impedance[:, line].T
    rows = circuit.shape[0]
    return network.read([*_grids(circuit, casadi.diag(impedance)), impedance[:rows, rows:]])


def _impedance_of_lines(network: FrameNetwork) -> casadi.SX:
    """Return the symmetric matrix Z of lines without wire, in the unknowns of `nodal`."""
    circuit = network.circuit
    rows, columns = circuit.shape
    # Lines of the shorter side are driven, those of the longer one are far.
    sides = np.split(np.arange(circuit.count)[:, None], [rows])
    lines, others = sides[::-1] if rows >= columns else sides
    driven, far = (side.ravel().tolist() for side in (lines, others))
    first, second = np.tril_indices(len(driven))
    half = network.new("driven_voltage", lines[first], lines[second])
    far_voltage = network.new("far_voltage", others, lines.T)
    # Whether the reading depends on the voltage of a far line under its own current
    reads_far = _reads_own(circuit, network.readout)[rows < columns]
    own = network.new("own_voltage", others, others) if reads_far else casadi.SX.zeros(len(far))
    # Columns of Z: the driven lines' own patterns; of each far line's pattern only its voltage and,
    # by reciprocity, those of the driven lines, which are all neighbours of its node.
    impedance = casadi.SX(circuit.count, circuit.count)
    upper = casadi.SX(casadi.Sparsity.upper(len(driven)), half)
    impedance[driven, driven] = casadi.triu2symm(upper)
    impedance[far, driven] = far_voltage
    impedance[driven, far] = far_voltage.T
    impedance[far, far] = casadi.diag(own)
    balance = circuit.balance(network.symbols, impedance) - casadi.DM.eye(circuit.count)
    network.balances += (balance[line, driven[: place + 1]].T for place, line in enumerate(driven))
    network.balances.append(casadi.vec(balance[far, driven]))
    if reads_far:
        network.balances.append(casadi.diag(balance)[far])
    return impedance


def per_pixel(network: FrameNetwork) -> NetworkSymbols:
    """Return a network with one pattern a pixel, its equations and readings.

    Two-point: a unit current enters row j and leaves column k, R_jk = V_j − V_k. Other readouts
    take two patterns, a unit current into row j and one into column k, or the first alone where
    their reading does not depend on Z_kk. Source: paper, equations (5) to (9).
    """
    circuit = network.circuit
    row, column = _lines_of_cells(circuit)
    if network.readout.two_point and not circuit.held.any():
        voltage = network.new("pixel_voltage", np.arange(circuit.count)[:, None], row, column)
        into = circuit.excitations(row)[1] - circuit.excitations(column)[1]
        balance = circuit.balance(network.symbols, voltage) - casadi.DM(into)
        network.balances.append(casadi.vec(balance))
        at_row, at_column = (
            casadi.diag(voltage[circuit.terminals[line].tolist(), :]) for line in (row, column)
        )
        return network.reading(network.symbols.scale * (at_row - at_column))
    from_row = network.excited("from_row_voltage", row)
    own_row, mutual = (casadi.diag(from_row[line.tolist(), :]) for line in (row, column))
    own_column = mutual
    if _reads_own(circuit, network.readout)[1]:
        from_column = network.excited("from_column_voltage", column)
        own_column = casadi.diag(from_column[column.tolist(), :])
    return network.read([_grid(circuit, entry) for entry in (own_row, own_column, mutual)])


# By the names in `formulation:`, the patterns of excitation of one frame, and the network with them
EXCITATIONS: dict[str, Callable[[FrameNetwork], NetworkSymbols]] = {
    "nodal": nodal,
    "per_pixel": per_pixel,
}


def _patterns(circuit: Circuit, readout: Readout) -> tuple[Numbers, Numbers]:
    """Return the driven lines, and the number of each line's pattern.

    Touching lines are driven as one. The number of a line without a pattern is −1. Lines of a side
    whose own voltage the readout does not read need no pattern: by reciprocity, the patterns of the
    other side have the voltages between both.

    Returns
    -------
    driven : array of int
        Driven lines, the first of lines that touch.
    pattern : array of int, shape (rows + columns,)
    """
    rows, columns = circuit.shape
    reads = _reads_own(circuit, readout)
    if not any(reads):
        reads = (rows <= columns, rows > columns)
    driven = np.repeat(reads, circuit.shape)
    _, first, inverse = np.unique(circuit.points[driven], return_index=True, return_inverse=True)
    pattern = np.full(len(driven), -1)
    pattern[driven] = inverse
    return np.flatnonzero(driven)[first], pattern


@guarded
@lru_cache(maxsize=64)
def _reads_own(circuit: Circuit, readout: Readout) -> tuple[bool, bool]:
    """Return whether readings depend on Z_jj of the rows, and whether on Z_kk of the columns."""
    names = ENTRY_NAMES[:3] if circuit.ends is None else ENTRY_NAMES
    row, column, *others = (casadi.MX.sym(name, *circuit.shape) for name in names)
    reading = equation_of(readout, *circuit.shape).reading(row, column, *others)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))


def _grid(circuit: Circuit, values: casadi.SX) -> casadi.SX:
    """Return a column of values of the cells as a matrix (rows, columns)."""
    rows, columns = circuit.shape
    return casadi.reshape(values, columns, rows).T


def _grids(circuit: Circuit, values: casadi.SX) -> list[casadi.SX]:
    """Return the value of the row line and of the column line of every cell, (rows, columns)."""
    rows, columns = circuit.shape
    return [casadi.repmat(values[:rows], 1, columns), casadi.repmat(values[rows:].T, rows, 1)]


def _lines_of_cells(circuit: Circuit) -> tuple[Numbers, Numbers]:
    """Return the numbers of the row line and of the column line of every cell, (cells,) each."""
    row, column = (numbers.ravel() for numbers in np.indices(circuit.shape))
    return row, circuit.shape[0] + column
