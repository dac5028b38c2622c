"""Panels as lists of resistors, solved as such: oracles that share nothing with the house."""

from collections.abc import Hashable, Iterable
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np

from lampest import (
    Array,
    Lines,
    LoadedColumnsReadout,
    Scene,
    TwoPointReadout,
    VirtualGroundReadout,
)

Node = Hashable
Resistor = tuple[Node, Node, float]


def laplacian(resistors: Iterable[Resistor]) -> tuple[dict[Node, int], Array]:
    """Node → line of the matrix of conductances, and this matrix; 0 ohm join nodes."""
    resistors = list(resistors)
    name = {node: node for first, second, _ in resistors for node in (first, second)}
    for first, second, ohm in resistors:
        if ohm == 0:
            name = {
                node: name[first] if label == name[second] else label
                for node, label in name.items()
            }
    index = {label: number for number, label in enumerate(dict.fromkeys(name.values()))}
    matrix = np.zeros((len(index),) * 2)
    for first, second, ohm in resistors:
        pair = [index[name[first]], index[name[second]]]
        if pair[0] != pair[1]:
            matrix[np.ix_(pair, pair)] += np.array([[1, -1], [-1, 1]]) / ohm
    return {node: index[label] for node, label in name.items()}, matrix


def potentials(resistors: Iterable[Resistor], held: dict[Node, float]) -> dict[Node, float]:
    """Node → volt, for nodes that ideal sources hold at a potential."""
    number, matrix = laplacian(resistors)
    volt = np.zeros(len(matrix))
    fixed = [number[node] for node in held if node in number]
    volt[fixed] = [held[node] for node in held if node in number]
    free = np.setdiff1d(np.arange(len(matrix)), fixed)
    volt[free] = np.linalg.solve(matrix[np.ix_(free, free)], -matrix[free] @ volt)
    return {node: float(volt[line]) for node, line in number.items()}


def resistors(cells: Array, scene: Scene) -> Iterable[Resistor]:
    """(node, node, ohm) of cells (rows, columns) ohm and all wire.

    Nodes 0 … M + N − 1 are the terminals, rows first.

    Of every crossing the row's node is M + N + 2·number, the column's the next one; behind the
    contacts, the lines' own nodes come last.
    """
    rows, columns = cells.shape
    lines = scene.lines
    faults = scene.faults
    row_ohm, column_ohm = (
        (0.0, 0.0) if lines is None else (lines.row_ohm_per_cell, lines.column_ohm_per_cell)
    )
    crossing = rows + columns + 2 * np.arange(rows * columns).reshape(cells.shape)
    behind = rows + columns + 2 * rows * columns
    contacts = (
        np.zeros(rows + columns) if scene.contacts is None else scene.contacts.mean((rows, columns))
    )
    yield from ((line, behind + line, float(ohm)) for line, ohm in enumerate(contacts))
    along = -1 if lines is not None and lines.rows_enter == "right" else 1
    down = -1 if lines is None or lines.columns_leave == "bottom" else 1
    chains = [((behind + row, *crossing[row, ::along].tolist()), row_ohm) for row in range(rows)]
    ends = behind + rows
    chains += [
        ((ends + place, *(crossing[::down, place] + 1).tolist()), column_ohm)
        for place in range(columns)
    ]
    yield from ((first, second, ohm) for chain, ohm in chains for first, second in pairwise(chain))
    yield from (
        (node, node + 1, float(ohm)) for node, ohm in zip(crossing.flat, cells.flat, strict=True)
    )
    if scene.leak_ohm is not None:
        gaps = (
            per_line(scene.leak_ohm.rows, rows - 1),
            per_line(scene.leak_ohm.columns, columns - 1),
        )
        yield from ((line, line + 1, ohm) for line, ohm in enumerate(gaps[0]) if ohm < np.inf)
        yield from (
            (rows + line, rows + line + 1, ohm) for line, ohm in enumerate(gaps[1]) if ohm < np.inf
        )
    if faults is not None:
        yield from ((group[0], line, 0.0) for group in faults.joined_rows for line in group[1:])
        yield from (
            (rows + group[0], rows + line, 0.0)
            for group in faults.joined_columns
            for line in group[1:]
        )


def impedance_of(cells: Array, scene: Scene, ties: Array) -> Array:
    """Z (lines, lines) ohm between the nodes at which lines are driven and read.

    Terminals have ties (lines) siemens to ground. Nodes joined by 0 ohm are one.
    """
    number, matrix = laplacian(resistors(cells, scene))
    lines = [number[line] for line in range(sum(cells.shape))]
    np.add.at(matrix, (lines, lines), ties)
    read = [number[node] for node in read_nodes(scene)]
    return np.asarray(np.linalg.inv(matrix)[np.ix_(read, read)])


def read_nodes(scene: Scene) -> list[Node]:
    """Return the node of each line at which it is driven or read; see `resistors`."""
    rows, columns = scene.panel.shape
    nodes = list(range(rows + columns))
    if getattr(scene.readout, "read_at", None) is None:
        return list(nodes)
    lines = scene.lines or Lines()
    crossing = rows + columns + 2 * np.arange(rows * columns).reshape(rows, columns)
    if scene.readout.driven == "columns":
        nodes[:rows] = crossing[:, -1 if lines.rows_enter == "left" else 0].tolist()
    else:
        nodes[rows:] = (crossing[-1 if lines.columns_leave == "top" else 0] + 1).tolist()
    return list(nodes)


def two_point_resistances(cells: Array, leak_ohm: float = np.inf) -> Array:
    """R between rows and columns of cells, by the pseudoinverse; leaks join neighbouring lines."""
    rows, columns = cells.shape
    matrix = np.zeros((rows + columns,) * 2)
    matrix[:rows, rows:] = -1 / cells
    line = np.delete(np.arange(rows + columns - 1), rows - 1)
    matrix[line, line + 1] -= 1 / leak_ohm
    matrix += matrix.T
    inverse = np.linalg.pinv(matrix - np.diag(matrix.sum(axis=1)))
    own = np.diag(inverse)
    return np.asarray(own[:rows, None] + own[None, rows:] - 2 * inverse[:rows, rows:])


def in_digits(cells: Array, digits: int = 50) -> Array:
    """Return R between lines of cells by mpmath, infinite where no path joins them."""
    rows, columns = cells.shape
    with mpmath.workdps(digits):
        matrix = mpmath.zeros(rows + columns)
        for (row, column), ohm in np.ndenumerate(cells):
            conductance = 1 / mpmath.mpf(float(ohm))
            line = rows + column
            for first, second, sign in (
                (row, row, 1),
                (line, line, 1),
                (row, line, -1),
                (line, row, -1),
            ):
                matrix[first, second] += sign * conductance
        inverse = mpmath.zeros(rows + columns)
        inverse[1:, 1:] = mpmath.inverse(matrix[1:, 1:])
        between = [
            inverse[j, j] + inverse[k, k] - 2 * inverse[j, k]
            for j in range(rows)
            for k in range(rows, matrix.rows)
        ]
    return np.array([float(resistance) for resistance in between]).reshape(cells.shape)


def per_line(ohm: float | tuple[float, ...], lines: int) -> tuple[float, ...]:
    return ohm if isinstance(ohm, tuple) else (ohm,) * lines


def volts(cells: Array, readout: Any) -> Array:
    """Return the voltage at the converter, (rows, columns), by a netlist for every reading."""
    turned = getattr(readout, "driven", "rows") == "columns"
    matrix = cells.T if turned else cells
    volt = np.empty(matrix.shape)
    for driven, sensed in np.ndindex(matrix.shape):
        volt[driven, sensed] = volt_of(matrix, readout, driven, sensed)
    return volt.T if turned else volt


def volt_of(matrix: Array, readout: Any, driven: int, sensed: int) -> float:
    """Return the voltage of one reading of a panel (driven lines, sensed lines) ohm."""
    if isinstance(readout, TwoPointReadout):
        return divider(matrix, readout, driven, sensed)
    network = network_of(matrix, readout, driven, sensed)
    high, low = (0.0, readout.supply_volt)[
        :: 1 if getattr(readout, "polarity", "up") == "down" else -1
    ]
    if has_potentials(readout):
        return with_potentials(network, readout, low, sensed)
    volt = potentials(network, {"high": high, "low": low, "ground": 0.0})
    if isinstance(readout, VirtualGroundReadout):
        through = [
            (volt["d", line] - volt["s", sensed]) / ohm
            for line, ohm in enumerate(matrix[:, sensed])
        ]
        return per_line(readout.feedback_ohm, matrix.shape[1])[sensed] * sum(through)
    return volt[("load", sensed) if ("load", sensed) in volt else ("s", sensed)]


def has_potentials(readout: Any) -> bool:
    """Whether lines of a circuit end in potentials of their own."""
    keys = ("idle_volt", "load_volt", "idle_load_volt")
    return any(getattr(readout, key, None) is not None for key in keys)


def with_potentials(network: list[Resistor], readout: Any, low: float, sensed: int) -> float:
    """Return the voltage of one reading whose line ends have potentials.

    Idle lines that follow the sensed one are at a potential at which the sensed one is, too; it is
    between the answers to two trials, because the network is linear.
    """
    load, idle_load, idle = (
        getattr(readout, key, None) for key in ("load_volt", "idle_load_volt", "idle_volt")
    )
    load = low if load is None else load
    source = getattr(readout, "drive_volt", None)
    if source is None:
        source = readout.supply_volt if low == 0 else 0.0
    held = {
        "high": source,
        "low": low,
        "ground": 0.0,
        "load end": load,
        "idle load end": load if idle_load is None else idle_load,
    }

    def of_idle(idle_volt: float, *, at_line: bool = False) -> float:
        volt = potentials(network, held | {"idle": idle_volt})
        line = volt["s", sensed]
        if at_line:
            return line
        if isinstance(readout, VirtualGroundReadout):
            channel = next(ohm for a, b, ohm in network if a == ("s", sensed) and b == "load end")
            lines = len([node for node in volt if isinstance(node, tuple) and node[0] == "s"])
            feedback = per_line(readout.feedback_ohm, lines)[sensed]
            return feedback * (line - load) / channel
        return volt.get(("load", sensed), line)

    if idle != "follows":
        return of_idle(low if idle is None else idle)
    at_zero = of_idle(0.0, at_line=True)
    slope = of_idle(1.0, at_line=True) - at_zero
    return of_idle(at_zero / (1 - slope))


def cells_between(matrix: Array) -> list[Resistor]:
    return [
        (("d", line), ("s", sense_line), ohm) for (line, sense_line), ohm in np.ndenumerate(matrix)
    ]


def divider(
    matrix: Array,
    readout: TwoPointReadout,
    row: int,
    column: int,
    row_ohm: float = 0.0,
    column_ohm: float = 0.0,
) -> float:
    """Volt at the converter: reference, row's channel, panel and column's channel are in a row."""
    across_sensor = readout.measured_across == "sensor"
    above, below = (readout.reference_ohm, 0.0)[:: 1 if across_sensor else -1]
    tap: Node = "row end" if across_sensor else "column end"
    network = [*cells_between(matrix), ("high", "row end", above), ("column end", "low", below)]
    network += [("row end", ("d", row), row_ohm), (("s", column), "column end", column_ohm)]
    network += [] if readout.input_ohm is None else [(tap, "low", readout.input_ohm)]
    return potentials(network, {"high": readout.supply_volt, "low": 0.0})[tap]


def load_of(
    line: int, channel: float, load: float, input_ohm: float | None, end: Node = "low"
) -> list[Resistor]:
    """Channel and load of a sensed line, and the converter's input beside the load."""
    resistors: list[Resistor] = [
        (("s", line), ("load", line), channel),
        (("load", line), end, load),
    ]
    return resistors + ([] if input_ohm is None else [(("load", line), "ground", input_ohm)])


def network_of(matrix: Array, readout: Any, driven: int, sensed: int) -> list[Resistor]:
    """Return drives, panel, channels and loads of a readout in volt, for one pair of lines."""
    count, sense_count = matrix.shape
    drive = per_line(readout.drive_ohm, count)
    idle = per_line(
        getattr(
            readout, "idle_ohm", np.inf if isinstance(readout, LoadedColumnsReadout) else drive
        ),
        count,
    )
    several = has_potentials(readout)
    idle_end, load_end, idle_load_end = (
        ("idle", "load end", "idle load end") if several else ("low",) * 3
    )
    driven_groups = getattr(readout, "driven_groups", None)
    if driven_groups is not None:
        place = next(list(group).index(driven) for group in driven_groups if driven in group)
        at_place = {group[place] for group in driven_groups if place < len(group)}
        idle = tuple(drive[line] if line in at_place else np.inf for line in range(count))
    network = cells_between(matrix)
    network += [
        (
            ("d", line),
            "high" if line == driven else idle_end,
            (drive if line == driven else idle)[line],
        )
        for line in range(count)
    ]
    if getattr(readout, "idle_stays", False):
        network.append((("d", driven), idle_end, per_line(readout.idle_ohm, count)[driven]))
    if isinstance(readout, VirtualGroundReadout):
        channels = per_line(getattr(readout, "sense_ohm", 0.0), sense_count)
        ends = [load_end if line == sensed else idle_load_end for line in range(sense_count)]
        return [
            *network,
            *((("s", line), ends[line], channels[line]) for line in range(sense_count)),
        ]
    groups = getattr(readout, "groups", None) or [range(sense_count)]
    turn = next(list(group).index(sensed) for group in groups if sensed in group)
    read = [group[turn] for group in groups if turn < len(group)]
    loads = per_line(readout.load_ohm, sense_count)
    channels = per_line(getattr(readout, "sense_ohm", 0.0), sense_count)
    stays = (
        getattr(readout, "idle_load_ohm", None) is None and getattr(readout, "groups", None) is None
    )
    stays = stays and getattr(readout, "sense", "all") == "all"
    for line in range(sense_count):
        if line in read or stays:
            network += load_of(
                line, channels[line], loads[line], getattr(readout, "input_ohm", None), load_end
            )
        elif getattr(readout, "idle_load_ohm", None) is not None:
            ohm = per_line(readout.idle_load_ohm, sense_count)[line]
            network.append((("s", line), idle_load_end, ohm))
    return [(first, second, ohm) for first, second, ohm in network if ohm < np.inf]


def wired_volts(cells: Array, scene: Scene) -> Array:
    """Volt at the converter, or at the far ends, of a wired panel, resistor by resistor."""
    readout: Any = scene.circuit
    rows, columns = cells.shape
    turned = readout.driven == "columns"
    terminals = {
        ("d" if (line < rows) != turned else "s", line if line < rows else line - rows): line
        for line in range(rows + columns)
    }
    high, low = (0.0, readout.supply_volt)[:: 1 if readout.polarity == "down" else -1]
    wires = [(int(first), int(second), ohm) for first, second, ohm in resistors(cells, scene)]
    ends = read_nodes(scene)
    volt = np.empty(cells.shape)
    matrix = cells.T if turned else cells
    for place in np.ndindex(cells.shape):
        driven, sensed = place[::-1] if turned else place
        outside = network_of(matrix, readout, driven, sensed)[cells.size :]
        network = wires + [
            (terminals.get(first, first), terminals.get(second, second), ohm)
            for first, second, ohm in outside
        ]
        at = potentials(network, {"high": high, "low": low, "ground": 0.0})
        far = getattr(readout, "read_at", None) is not None
        end = ends[terminals["s", sensed]]
        volt[place] = at[end] if far else at.get(("load", sensed), at[end])
    return volt
