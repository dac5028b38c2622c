"""Patterns of excitation, and the network of one frame.

The patterns are the one place in which the formulations differ. A pattern is a distribution of
currents into the terminals, with one voltage an unknown for each node and pattern:

    per_pixel   one pattern a pixel, as the electronics drive it: current enters row j and leaves
                column k
    nodal       one pattern a line: a unit current enters it. Those of the pixels are sums of these
                (superposition)

Source: paper, equations (2)-(9).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import casadi
import numpy as np

from lampest.formulation.circuit import Circuit, ConductanceSymbols
from lampest.panel.compiled import guarded
from lampest.panel.equation import equation_of
from lampest.panel.law import ENTRY_NAMES
from lampest.panel.panel import Array, Numbers
from lampest.panel.readouts import Readout

Voltages = dict[str, Array]
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
    """

    voltages: dict[str, casadi.SX]
    units: dict[str, casadi.SX]
    balance: casadi.SX
    reading: casadi.SX


def joined_addresses(
    circuits: Sequence[Circuit], networks: Sequence[NetworkSymbols]
) -> NetworkSymbols:
    """Return the network of one frame, joined from the networks of its addresses.

    Every address contributes the readings that it takes.
    """
    if len(networks) == 1:
        return networks[0]
    names = networks[0].voltages
    reading = casadi.SX(networks[0].reading.shape[0], 1)
    for circuit, network in zip(circuits, networks, strict=True):
        chosen = np.flatnonzero(circuit.read).tolist()
        reading[chosen] = network.reading[chosen]
    return NetworkSymbols(
        {name: casadi.vertcat(*(network.voltages[name] for network in networks)) for name in names},
        {name: casadi.vertcat(*(network.units[name] for network in networks)) for name in names},
        casadi.vertcat(*(network.balance for network in networks)),
        reading,
    )


@dataclass(eq=False)
class _Unknowns:
    """Voltages of one network while it is built."""

    voltages: dict[str, casadi.SX] = field(default_factory=dict)
    units: dict[str, casadi.SX] = field(default_factory=dict)

    def new(self, name: str, rows: int, columns: int = 1) -> casadi.SX:
        """Return new voltages in the unit of resistances, (rows, columns)."""
        symbol = casadi.SX.sym(name, rows, columns)
        unit = casadi.SX.sym(f"unit_{name}", rows, columns)
        self.voltages[name] = casadi.vec(symbol)
        self.units[name] = casadi.vec(unit)
        return unit * symbol

    def network(self, balance: casadi.SX, reading: casadi.SX) -> NetworkSymbols:
        """Return the network of these voltages."""
        return NetworkSymbols(self.voltages, self.units, balance, reading)


@dataclass(frozen=True)
class Excitation(ABC):
    """Patterns of excitation of one frame, and the network with them."""

    if TYPE_CHECKING:

        @property
        def kind(self) -> str:
            """The name in `formulation:`."""

    @abstractmethod
    def network(
        self, circuit: Circuit, readout: Readout, symbols: ConductanceSymbols
    ) -> NetworkSymbols:
        """Return the unknown voltages and the equations of one frame's network."""

    @abstractmethod
    def voltages(self, circuit: Circuit, readout: Readout, response: Array) -> Voltages:
        """Return the values of `NetworkSymbols.voltages` in a solved network, V/A.

        `response`, (nodes, lines), are the voltages of all nodes for a unit current into each
        terminal; those by the ends of the lines follow, if they have potentials.
        """


@dataclass(frozen=True)
class Nodal(Excitation):
    """One pattern a line.

    The voltages of lines without wire are the symmetric matrix Z. With the n lines of the shorter
    side driven, and the m others far, the unknowns are half of the driven block of Z, the voltages
    of the far lines, and the far lines' own voltage Z_ff where the readout reads it. By reciprocity
    the balance of a far line under its own current needs no further voltage. The unknowns number
    n(n + 1)/2 + mn + m in place of (m + n)².
    """

    kind: Literal["nodal"] = "nodal"

    def network(
        self, circuit: Circuit, readout: Readout, symbols: ConductanceSymbols
    ) -> NetworkSymbols:
        """Return the network; see `Excitation.network`."""
        if circuit.lines_only:
            return _network_of_lines(circuit, readout, symbols)
        lines, pattern = _patterns(circuit, readout)
        unknowns = _Unknowns()
        entries, balance = _excited(unknowns, "node_voltage", circuit, lines, symbols)
        impedance = casadi.SX(len(pattern), len(pattern))
        for line, number in enumerate(pattern):
            if number >= 0:
                impedance[:, line] = entries[:, int(number)]
                impedance[line, :] = impedance[:, line].T
        at_ends, more = _at_ends(unknowns, circuit, symbols)
        return unknowns.network(
            casadi.vertcat(balance, more),
            _reading(circuit, readout, _of_lines(circuit, impedance), symbols, at_ends),
        )

    def voltages(self, circuit: Circuit, readout: Readout, response: Array) -> Voltages:
        """Return the voltages of a solved network; see `Excitation.voltages`."""
        if not circuit.lines_only:
            lines, _ = _patterns(circuit, readout)
            voltages = {"node_voltage": response[np.ix_(circuit.free, lines)].T.ravel()}
            return voltages | _end_voltages(circuit, response)
        driven, far = _sides(circuit.shape)
        half = response[np.ix_(driven, driven)][np.tril_indices(len(driven))]
        voltages = {"driven_voltage": half, "far_voltage": response[np.ix_(far, driven)].T.ravel()}
        if _reads_far(circuit, readout):
            voltages["own_voltage"] = np.diag(response)[far]
        return voltages | _end_voltages(circuit, response)


def _network_of_lines(
    circuit: Circuit, readout: Readout, symbols: ConductanceSymbols
) -> NetworkSymbols:
    """Return the nodal network of lines without wire, in the unknowns of a symmetric Z.

    The class `Nodal` describes these unknowns.
    """
    driven, far = (numbers.tolist() for numbers in _sides(circuit.shape))
    driven_count = len(driven)
    far_count = len(far)
    count = circuit.count
    reads_far = _reads_far(circuit, readout)
    unknowns = _Unknowns()
    half = unknowns.new("driven_voltage", driven_count * (driven_count + 1) // 2)
    far_voltage = unknowns.new("far_voltage", far_count, driven_count)
    own = unknowns.new("own_voltage", far_count) if reads_far else casadi.SX.zeros(far_count)
    # Columns of Z: the driven lines' own patterns; of each far line's pattern only its voltage and,
    # by reciprocity, those of the driven lines, which are all neighbours of its node.
    impedance = casadi.SX(count, count)
    upper = casadi.SX(casadi.Sparsity.upper(driven_count), half)
    impedance[driven, driven] = casadi.triu2symm(upper)
    impedance[far, driven] = far_voltage
    impedance[driven, far] = far_voltage.T
    impedance[far, far] = casadi.diag(own)
    balance = circuit.balance(symbols, impedance) - casadi.DM.eye(count)
    lower = casadi.vertcat(
        *(balance[line, driven[: place + 1]].T for place, line in enumerate(driven))
    )
    equations = [lower, casadi.vec(balance[far, driven])]
    if reads_far:
        equations.append(casadi.diag(balance)[far])
    at_ends, more = _at_ends(unknowns, circuit, symbols)
    return unknowns.network(
        casadi.vertcat(*equations, more),
        _reading(circuit, readout, _of_lines(circuit, impedance), symbols, at_ends),
    )


@dataclass(frozen=True)
class PerPixel(Excitation):
    """One pattern a pixel (paper, equations 5 to 9).

    Two-point: a unit current enters row j and leaves column k, R_jk = V_j − V_k. Other readouts
    take two patterns, a unit current into row j and one into column k, or the first alone where
    their reading does not depend on Z_kk.
    """

    kind: Literal["per_pixel"] = "per_pixel"

    def network(
        self, circuit: Circuit, readout: Readout, symbols: ConductanceSymbols
    ) -> NetworkSymbols:
        """Return the network; see `Excitation.network`."""
        unknowns = _Unknowns()
        row, column = _lines_of_cells(circuit)
        numbers = list(range(len(row)))
        if readout.two_point and not circuit.held.any():
            voltage = unknowns.new("pixel_voltage", circuit.count, len(row))
            into = circuit.excitations(row)[1] - circuit.excitations(column)[1]
            balance = casadi.vec(circuit.balance(symbols, voltage) - casadi.DM(into))
            at_row, at_column = (
                _chosen(voltage, circuit.terminals[line], numbers) for line in (row, column)
            )
            return unknowns.network(balance, symbols.scale * (at_row - at_column))
        from_row, balance = _excited(unknowns, "from_row_voltage", circuit, row, symbols)
        own_row, mutual = (_chosen(from_row, line, numbers) for line in (row, column))
        own_column = mutual
        if _reads_own(circuit, readout)[1]:
            from_column, more = _excited(unknowns, "from_column_voltage", circuit, column, symbols)
            own_column = _chosen(from_column, column, numbers)
            balance = casadi.vertcat(balance, more)
        entries = [_grid(circuit, entry) for entry in (own_row, own_column, mutual)]
        at_ends, more = _at_ends(unknowns, circuit, symbols)
        return unknowns.network(
            casadi.vertcat(balance, more),
            _reading(circuit, readout, entries, symbols, at_ends),
        )

    def voltages(self, circuit: Circuit, readout: Readout, response: Array) -> Voltages:
        """Return the voltages of a solved network; see `Excitation.voltages`."""
        row, column = _lines_of_cells(circuit)
        if readout.two_point and not circuit.held.any():
            return {"pixel_voltage": (response[:, row] - response[:, column]).T.ravel()}
        values = {"from_row_voltage": response[np.ix_(circuit.free, row)].T.ravel()}
        if _reads_own(circuit, readout)[1]:
            values["from_column_voltage"] = response[np.ix_(circuit.free, column)].T.ravel()
        return values | _end_voltages(circuit, response)


EXCITATIONS: dict[str, Excitation] = {patterns.kind: patterns for patterns in (Nodal(), PerPixel())}


def _sides(shape: tuple[int, int]) -> tuple[Numbers, Numbers]:
    """Return the numbers of the lines of the shorter side, and of the longer one.

    The lines of the shorter side are driven, those of the longer one are far.
    """
    rows, columns = shape
    sides = np.split(np.arange(rows + columns), [rows])
    return (sides[1], sides[0]) if rows >= columns else (sides[0], sides[1])


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
    driven = np.concatenate([np.full(rows, reads[0]), np.full(columns, reads[1])])
    _, first, inverse = np.unique(circuit.points[driven], return_index=True, return_inverse=True)
    pattern = np.full(len(driven), -1)
    pattern[driven] = inverse
    return np.flatnonzero(driven)[first], pattern


def _reads_far(circuit: Circuit, readout: Readout) -> bool:
    """Return whether the reading depends on the voltage of a far line under its own current."""
    rows, columns = circuit.shape
    return _reads_own(circuit, readout)[0 if rows >= columns else 1]


def _reads_own(circuit: Circuit, readout: Readout) -> tuple[bool, bool]:
    """Return whether readings depend on Z_jj of the rows, and whether on Z_kk of the columns."""
    return _entries_read(readout, circuit.shape, with_potentials=circuit.ends is not None)


@guarded
@lru_cache(maxsize=64)
def _entries_read(
    readout: Readout, shape: tuple[int, int], *, with_potentials: bool
) -> tuple[bool, bool]:
    """Return the same for a readout and the shape of its panel."""
    names = ENTRY_NAMES if with_potentials else ENTRY_NAMES[:3]
    row, column, *others = (casadi.MX.sym(name, *shape) for name in names)
    reading = equation_of(readout, *shape).reading(row, column, *others)
    return bool(casadi.depends_on(reading, row)), bool(casadi.depends_on(reading, column))


def _at_ends(
    unknowns: _Unknowns, circuit: Circuit, symbols: ConductanceSymbols
) -> tuple[casadi.SX | None, casadi.SX]:
    """Return the voltages v of all lines, and the current balance while they are at their ends.

    A line that is held has its current in v; see `DifferenceNetwork`. Lines without potentials have
    neither v nor an equation.
    """
    if circuit.ends is None:
        return None, casadi.SX(0, 1)
    # In volt, where all other voltages are for unit currents in the unit of resistances
    volt = casadi.DM(np.where(circuit.held, 0.0, circuit.ends))
    into = casadi.SX(circuit.at_terminals @ (symbols.tie * volt))
    given = circuit.held_potentials
    return _solved(unknowns, END_VOLTAGE, circuit, given, into, symbols, symbols.scale)


def _end_voltages(circuit: Circuit, response: Array) -> Voltages:
    """Return the values of the voltages by the ends of lines; none without potentials."""
    if circuit.ends is None:
        return {}
    return {END_VOLTAGE: response[circuit.free, -1]}


def _excited(
    unknowns: _Unknowns,
    name: str,
    circuit: Circuit,
    lines: Numbers,
    symbols: ConductanceSymbols,
) -> tuple[casadi.SX, casadi.SX]:
    """Return the entries K of all lines for the excitation of some, (lines, patterns).

    The current balance is returned, too. K is the voltage of a line, or the current that a line at
    ground takes; see `DifferenceNetwork`.
    """
    given, into = circuit.excitations(lines)
    return _solved(unknowns, name, circuit, given, casadi.DM(into), symbols)


def _solved(
    unknowns: _Unknowns,
    name: str,
    circuit: Circuit,
    given: Array,
    into: casadi.SX | casadi.DM,
    symbols: ConductanceSymbols,
    unit: casadi.SX | float = 1.0,
) -> tuple[casadi.SX, casadi.SX]:
    """Return the voltages of lines, or the currents of held ones in `unit`, and the balance.

    The nodes that are free have unknown voltages, `given` (nodes, patterns) are those of the
    others. The currents `into` the nodes have the same shape.
    """
    free = circuit.free.tolist()
    voltage = casadi.SX(casadi.DM(given))
    voltage[free, :] = unknowns.new(name, *given[circuit.free].shape)
    out = circuit.balance(symbols, voltage) - into
    entries = voltage[circuit.points.tolist(), :]
    held = np.flatnonzero(circuit.held)
    if len(held):
        entries[held.tolist(), :] = -out[circuit.terminals[held].tolist(), :] / unit
    return entries, casadi.vec(out[free, :])


def _unit(circuit: Circuit, first: Numbers, second: Numbers, scale: casadi.SX) -> casadi.SX:
    """Return the unit of K between pairs of lines, (pairs, 1).

    The unit is `scale` ohm between two free lines, 1 between a free and a held line, and the
    inverse of `scale` between two held lines.
    """
    power = 1.0 - circuit.held[first].astype(float) - circuit.held[second].astype(float)
    return casadi.SX(casadi.vertcat(*(scale**exponent for exponent in power.tolist())))


def _chosen(values: casadi.SX, rows: Numbers, columns: list[int]) -> casadi.SX:
    """Return one entry of each column, (columns, 1)."""
    return casadi.vertcat(
        *(values[int(row), column] for row, column in zip(rows, columns, strict=True))
    )


def _of_lines(circuit: Circuit, impedance: casadi.SX) -> list[casadi.SX]:
    """Return K_jj, K_kk and K_jk, (rows, columns) each, of K between the lines, (lines, lines)."""
    rows, columns = circuit.shape
    own = casadi.diag(impedance)
    return [
        casadi.repmat(own[:rows], 1, columns),
        casadi.repmat(own[rows:].T, rows, 1),
        impedance[:rows, rows:],
    ]


def _reading(
    circuit: Circuit,
    readout: Readout,
    entries: list[casadi.SX],
    symbols: ConductanceSymbols,
    at_ends: casadi.SX | None,
) -> casadi.SX:
    """Return the readings (cells, 1) from K_jj, K_kk and K_jk, (rows, columns) each.

    The entries are in units of the symbols' scale; `at_ends` is v of the lines, (lines, 1), or None
    without potentials.
    """
    if readout.two_point and not circuit.held.any():
        return casadi.vec(casadi.SX(symbols.scale * symbols.reading(*entries)).T)
    rows, columns = circuit.shape
    row, column = _lines_of_cells(circuit)
    pairs = ((row, row), (column, column), (row, column))
    scaled = [
        _grid(circuit, _unit(circuit, first, second, symbols.scale)) * entry
        for (first, second), entry in zip(pairs, entries, strict=True)
    ]
    if at_ends is not None:
        scaled.append(casadi.repmat(at_ends[:rows], 1, columns))
        scaled.append(casadi.repmat(at_ends[rows:].T, rows, 1))
    return casadi.vec(casadi.SX(symbols.reading(*scaled)).T)


def _grid(circuit: Circuit, values: casadi.SX) -> casadi.SX:
    """Return a column of values of the cells as a matrix (rows, columns)."""
    rows, columns = circuit.shape
    return casadi.reshape(values, columns, rows).T


def _lines_of_cells(circuit: Circuit) -> tuple[Numbers, Numbers]:
    """Return the numbers of the row line and of the column line of every cell, (cells,) each."""
    row, column = (numbers.ravel() for numbers in np.indices(circuit.shape))
    return row, circuit.shape[0] + column
