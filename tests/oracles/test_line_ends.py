"""Random terminations against the formula of currents into the lines, and against mpmath.

    (L⁺ + diag R) j + v = volt,   Σ j = 0,   V = L⁺ j + v

The package solves one inverse for each base and two lines that change; the oracle solves the
formula anew for every reading, with all lines that end anywhere.
"""

from dataclasses import dataclass, replace
from typing import Literal

import mpmath
import numpy as np
import pytest

from lampest import (
    Array,
    DrivenReadout,
    NeighbourLeaks,
    Panel,
    Readout,
    Scene,
    VirtualGroundReadout,
)
from lampest.panel.circuit import Ends, Terminations, scanned
from lampest.panel.equation import equation_of
from lampest.panel.lines import PerLine, Side

COUNT = 200
SHAPES = ((3, 4), (4, 3), (5, 5), (2, 6), (1, 4), (4, 1))
DIGITS = 40
TOLERANCE = 1e-9  # of the largest potential, at contrasts e^±4
AT_EXTREMES = 1e-8  # at e^±8: the condition of L takes seven of sixteen digits
OF_DIFFERENCES = 1e-6  # central differences, h² and rounding/h


@dataclass(frozen=True, kw_only=True)
class RandomEnds(Readout):
    """Circuit whose lines end at random, the same way for each seed."""

    kind: Literal["random_ends"] = "random_ends"
    seed: int = 0
    driven: Side = "rows"
    drive_ohm: PerLine = 0.0
    load_ohm: PerLine = 1.0

    def description(self) -> str:
        return f"random ends {self.seed}"

    def terminations(self, driven: int, sensed: int) -> Terminations:
        rng = np.random.default_rng(self.seed)
        driving, sensing = (random_table(rng, count) for count in (driven, sensed))
        # One line of each side ends somewhere whichever is used, so that no potential is undefined
        ohm = driving.ohm.copy()
        ohm[:, -1] = np.where(np.isinf(ohm[:, -1]), 470.0, ohm[:, -1])
        driving = replace(driving, ohm=ohm)
        return Terminations(self.driven, driving, sensing, gain=np.ones(sensed))


def random_ends(rng: np.random.Generator, count: int, *, used: bool) -> Ends:
    """Return ends of which some float and some are held, but not while they are used."""
    ohm = 10 ** rng.uniform(1, 5, count)
    chance = rng.uniform(size=count)
    if not used:
        ohm = np.where(chance < 0.3, np.inf, np.where(chance < 0.45, 0.0, ohm))
    return Ends.of(ohm, rng.uniform(-5, 5, count) if rng.uniform() < 0.5 else rng.uniform(-5, 5))


def random_table(rng: np.random.Generator, count: int) -> Ends:
    """Return the ends of a side: scanned one by one, by multiplexers, or at random each time."""
    own, idle, together = (random_ends(rng, count, used=used) for used in (True, False, True))
    scheme = rng.integers(4)
    if scheme == 0:
        return scanned(own, idle)
    if scheme == 1:
        lines = rng.permutation(count).tolist()
        return scanned(own, idle, (tuple(lines[::2]), (None, *lines[1::2])), together)
    if scheme == 2:
        return scanned(own, Ends.floating(count))
    rows = [random_ends(rng, count, used=False) for _ in range(count)]
    ohm, volt = (np.stack([getattr(row, name) for row in rows]) for name in ("ohm", "volt"))
    named = np.arange(count)
    ohm[named, named] = own.ohm
    volt[named, named] = own.volt
    return Ends(ohm, volt)


def circuit_of(seed: int) -> tuple[RandomEnds, Array]:
    """Return a circuit and cells (rows, columns) ohm at contrasts e^±4."""
    rng = np.random.default_rng(1000 + seed)
    shape = SHAPES[seed % len(SHAPES)]
    circuit = RandomEnds(seed=seed, driven="columns" if seed % 3 == 0 else "rows")
    return circuit, np.exp(np.log(3000) + rng.uniform(-4, 4, shape))


def ends_of(circuit: RandomEnds, shape: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
    """Return ohm and volt, (rows, columns, lines) each, the lines that are read, and the gain."""
    rows, columns = shape
    by_rows = circuit.driven == "rows"
    table = circuit.terminations(*(shape if by_rows else shape[::-1]))
    ohm, volt = np.empty((2, rows, columns, rows + columns))
    read = np.empty(shape, dtype=int)
    for row, column in np.ndindex(shape):
        driven, sensed = (row, column) if by_rows else (column, row)
        sides = ((table.driving.ohm[driven], table.sensing.ohm[sensed]))[:: 1 if by_rows else -1]
        ohm[row, column] = np.concatenate(sides)
        sides = ((table.driving.volt[driven], table.sensing.volt[sensed]))[:: 1 if by_rows else -1]
        volt[row, column] = np.concatenate(sides)
        read[row, column] = rows + column if by_rows else row
    return ohm, volt, read, table.gain


def by_currents(
    cells: Array, ohm: Array, volt: Array, read: int, leak_ohm: float = np.inf
) -> float:
    """Return the potential of one line by the formula of the module, beside leaks."""
    rows, columns = cells.shape
    matrix = np.zeros((rows + columns,) * 2)
    matrix[:rows, rows:] = -1 / cells
    for line in range(rows + columns - 1):
        if line != rows - 1:
            matrix[line, line + 1] -= 1 / leak_ohm
    matrix += matrix.T
    inverse = np.linalg.pinv(matrix - np.diag(matrix.sum(axis=1)))
    ending = np.flatnonzero(np.isfinite(ohm))
    count = len(ending)
    system = np.zeros((count + 1,) * 2)
    system[:count, :count] = inverse[np.ix_(ending, ending)] + np.diag(ohm[ending])
    system[:count, count] = system[count, :count] = 1.0
    solved = np.linalg.solve(system, [*volt[ending], 0.0])
    return float(inverse[read, ending] @ solved[:count] + solved[count])


def by_digits(cells: Array, ohm: Array, volt: Array, read: int) -> float:
    """Return the potential of one line from node analysis with many digits."""
    rows, columns = cells.shape
    lines = rows + columns
    with mpmath.workdps(DIGITS):
        matrix = mpmath.zeros(lines)
        current = mpmath.zeros(lines, 1)
        for (row, column), value in np.ndenumerate(cells):
            conductance = 1 / mpmath.mpf(float(value))
            for first, second in ((row, rows + column), (rows + column, row)):
                matrix[first, first] += conductance
                matrix[first, second] -= conductance
        for line in range(lines):
            if ohm[line] == 0:
                for other in range(lines):
                    matrix[line, other] = float(line == other)
                current[line] = float(volt[line])
            elif np.isfinite(ohm[line]):
                matrix[line, line] += 1 / mpmath.mpf(float(ohm[line]))
                current[line] += mpmath.mpf(float(volt[line])) / float(ohm[line])
        return float(mpmath.lu_solve(matrix, current)[int(read)])


@pytest.mark.parametrize("seed", range(COUNT))
def test_readings_are_those_of_the_currents_into_the_lines(seed: int) -> None:
    circuit, cells = circuit_of(seed)
    scene = Scene(Panel(*cells.shape), circuit)
    recorded = circuit.to_recorded(circuit.exact_reading(cells), scene)
    ohm, volt, read, _ = ends_of(circuit, cells.shape)
    expected = np.empty(cells.shape)
    for at in np.ndindex(cells.shape):
        expected[at] = by_currents(cells, ohm[at], volt[at], read[at])
    assert np.abs(recorded - expected).max() < TOLERANCE * np.abs(volt).max()


@pytest.mark.parametrize("seed", range(0, COUNT, 8))
def test_leaks_between_neighbours_are_conductances_of_the_graph(seed: int) -> None:
    circuit, cells = circuit_of(seed)
    rows, columns = cells.shape
    leaks = NeighbourLeaks(
        rows=4700.0 if rows > 1 else np.inf, columns=4700.0 if columns > 1 else np.inf
    )
    scene = Scene(Panel(rows, columns), circuit, leak_ohm=leaks)
    recorded = circuit.to_recorded(circuit.exact_reading(cells, scene.wiring), scene)
    ohm, volt, read, _ = ends_of(circuit, cells.shape)
    for at in np.ndindex(cells.shape):
        expected = by_currents(cells, ohm[at], volt[at], read[at], 4700.0)
        assert abs(recorded[at] - expected) < TOLERANCE * np.abs(volt).max()


PULL_DOWNS = DrivenReadout(
    drive_ohm=95.0, idle_ohm=10_000.0, idle_stays=True, load_ohm=10_000.0, sense_ohm=70.0
)


def expected_of(cells: Array, ends: dict[int, list[tuple[float, float]]], read: int) -> float:
    """Return the potential of a line whose lines have several ends (ohm, volt) each."""
    lines = sum(cells.shape)
    ohm, volt = np.full(lines, np.inf), np.zeros(lines)
    for line, several in ends.items():
        siemens = sum(1 / own_ohm for own_ohm, _ in several)
        ohm[line] = 1 / siemens
        volt[line] = sum(own_volt / own_ohm for own_ohm, own_volt in several) / siemens
    return by_currents(cells, ohm, volt, read)


def test_pull_downs_stay_at_the_driven_line_and_behind_multiplexers() -> None:
    cells = np.exp(np.log(3000) + np.random.default_rng(3).normal(size=(4, 3)))
    load = 10_000 / 10_070
    readings = replace(PULL_DOWNS, idle_load_ohm=np.inf).exact_reading(cells)
    pulled = {line: [(10_000.0, 0.0)] for line in range(4)}
    for row, column in np.ndindex(4, 3):
        ends = pulled | {
            row: [(10_000.0, 0.0), (95.0, 5.0)],
            4 + column: [(10_070.0, 0.0)],
        }
        assert readings[row, column] == pytest.approx(load * expected_of(cells, ends, 4 + column))
    groups = replace(PULL_DOWNS, driven_groups=((0, None, 1), (2, 3)), idle_load_ohm=np.inf)
    readings = groups.exact_reading(cells)
    together = {0: 2, 2: 0, 1: None, 3: None}  # 1 and 3 are at other addresses of the multiplexers
    for row, column in np.ndindex(4, 3):
        ends = pulled | {row: [(10_000.0, 0.0), (95.0, 5.0)], 4 + column: [(10_070.0, 0.0)]}
        if together[row] is not None:
            ends[together[row]] = [(10_000.0, 0.0), (95.0, 0.0)]
        assert readings[row, column] == pytest.approx(load * expected_of(cells, ends, 4 + column))


def test_offsets_hold_the_sensed_lines_of_inverting_amplifiers_and_are_recorded() -> None:
    """An amplifier off by v holds its line v above the reference, and its output is v higher."""
    cells = np.exp(np.log(3000) + np.random.default_rng(4).normal(size=(3, 3)))
    offset = (0.004, -0.003, 0.001)
    board = VirtualGroundReadout(
        drive_volt=0.5, drive_ohm=30.0, sense_ohm=20.0, feedback_ohm=2200.0, offset_volt=offset
    )
    recorded = board.to_recorded(board.exact_reading(cells), Scene(Panel(3, 3), board))
    for row, column in np.ndindex(3, 3):
        ends = {line: [(30.0, 0.5 * (line == row))] for line in range(3)}
        ends |= {3 + line: [(20.0, offset[line])] for line in range(3)}
        line_volt = expected_of(cells, ends, 3 + column)
        output = offset[column] - 2200 * (line_volt - offset[column]) / 20
        assert recorded[row, column] == pytest.approx(-output)
    follower = DrivenReadout(load_ohm=1000.0, offset_volt=offset)
    plain = replace(follower, offset_volt=None)
    scene = Scene(Panel(3, 3), follower)
    added = follower.to_recorded(follower.exact_reading(cells), scene) - plain.exact_reading(cells)
    assert added == pytest.approx(np.broadcast_to(offset, (3, 3)))


def test_idle_lines_that_end_let_a_line_be_read_without_a_resistor() -> None:
    held = DrivenReadout(idle_ohm=40.0, load_ohm=(np.inf, 1e4, np.inf), idle_load_ohm=np.inf)
    assert np.all(np.isfinite(held.exact_reading(np.full((2, 3), 3e3))))
    assert Scene(Panel(2, 3), held).readout == held


@pytest.mark.parametrize("seed", range(0, COUNT, 10))
def test_readings_of_extreme_cells_keep_their_digits(seed: int) -> None:
    circuit, cells = circuit_of(seed)
    cells = 3000 * (cells / 3000) ** 2
    scene = Scene(Panel(*cells.shape), circuit)
    recorded = circuit.to_recorded(circuit.exact_reading(cells), scene)
    ohm, volt, read, _ = ends_of(circuit, cells.shape)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        at = tuple(rng.integers(cells.shape))
        expected = by_digits(cells, ohm[at], volt[at], read[at])
        assert abs(recorded[at] - expected) < AT_EXTREMES * np.abs(volt).max()


@pytest.mark.parametrize("seed", range(0, COUNT, 4))
def test_derivatives_are_those_of_differences(seed: int) -> None:
    """The adjoint and the second directional derivative, by the network of the bases."""
    circuit, cells = circuit_of(seed)
    cells = 3000 * (cells / 3000) ** 0.25
    rng = np.random.default_rng(seed)
    step, weights = rng.normal(size=(2, *cells.shape))
    ties = circuit.ties(cells)

    def network(length: float):
        return circuit.network(cells * np.exp(length * step), ties)

    size = 1e-4
    slopes = (network(size).reading() - network(-size).reading()) / (2 * size)
    scale = np.abs(slopes).max() + np.abs(network(0).reading()).max()
    assert np.abs(network(0).forward(step) - slopes).max() < OF_DIFFERENCES * scale
    gradient = network(0).adjoint(weights)
    assert np.sum(gradient * step) == pytest.approx(
        np.sum(weights * slopes), abs=OF_DIFFERENCES * scale * weights.size
    )
    bend = (network(size).adjoint(weights) - network(-size).adjoint(weights)) / (2 * size)
    second = network(0).second_order(weights).products(step)[1] - gradient * step
    assert np.abs(second - bend).max() < 10 * OF_DIFFERENCES * (scale + np.abs(bend).max())


def test_a_scan_of_multiplexers_has_one_base_for_each_address() -> None:
    """Sixteen lines on two multiplexers of eight: eight inverses, and one without multiplexers."""
    own, idle = Ends.of(np.full(16, 70.0), 5.0), Ends.of(np.full(16, 70.0))
    groups = (tuple(range(8)), tuple(range(8, 16)))

    class Mat(RandomEnds):
        def terminations(self, driven: int, sensed: int) -> Terminations:
            floating = Ends.floating(driven)
            groups_here = groups if driven == 16 else None
            driving = scanned(
                Ends(own.ohm[:driven], own.volt[:driven]),
                floating,
                groups_here,
                Ends(idle.ohm[:driven], idle.volt[:driven]),
            )
            load = Ends.of(np.full(sensed, 1000.0))
            return Terminations("rows", driving, scanned(load, load), gain=np.ones(sensed))

    assert len(equation_of(Mat(seed=1), 16, 4).ties) == 8
    assert len(equation_of(Mat(seed=2), 15, 4).ties) == 1


def test_two_ends_of_a_line_are_one_by_thevenin() -> None:
    source, pull_down = Ends.of(np.array([95.0]), 5.0), Ends.of(np.array([10_000.0]))
    both = source.beside(pull_down)
    assert both.ohm == pytest.approx(95 * 10_000 / 10_095)
    assert both.volt == pytest.approx(5 * 10_000 / 10_095)
    held = source.beside(Ends.of(np.array([0.0]), 1.5))
    assert (held.ohm[0], held.volt[0]) == (0.0, 1.5)
    floating = Ends.floating(1)
    assert np.isinf(floating.beside(floating).ohm[0])
    with pytest.raises(ValueError, match="0 ohm hold a line at two potentials"):
        Ends.of(np.array([0.0]), 1.5).beside(Ends.of(np.array([0.0]), 2.5))


@pytest.mark.parametrize("lines", [(1, 3), (3, 1), (4, 6)])
def test_lists_of_both_sides_may_differ_in_length(lines: tuple[int, int]) -> None:
    """Each side has as many lines as its own lists tell, one line included."""
    driven, sensed = lines
    listed = VirtualGroundReadout(drive_ohm=(30.0,) * driven, offset_volt=(0.001,) * sensed)
    single = VirtualGroundReadout(drive_ohm=30.0, offset_volt=0.001)
    cells = np.full(lines, 2000.0)
    np.testing.assert_allclose(listed.exact_reading(cells), single.exact_reading(cells), rtol=1e-9)
