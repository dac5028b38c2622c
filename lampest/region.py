"""Only what changed is unknown: blocks of cells are estimated, all others keep their baseline value."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.cost import Cost
from lampest.kirchhoff import Network, Surroundings, laplacian
from lampest.panel import Array, Panel
from lampest.problem import Data, Evaluation
from lampest.search import best_solution, evaluated
from lampest.solvers.newton import Newton
from lampest.solvers.solution import Outcome, Settings, Solution, Status, approximation
from lampest.terms.misfit import Misfit

MARGIN = 1
HALO = 2  # cells round a block that a gradient inside it reads
SHARE = 0.2  # of the strongest change; what is weaker waits until that is explained
MOST_GROWTHS = 6
LARGEST_SHARE = 0.5
MOST_FITS, FITTED, ROUNDING = 30, 1e-7, 1e-14
LENGTHS = tuple(0.5**power for power in range(20))
MAD = 1.4826  # of a normal distribution, from median absolute deviation to standard deviation

Block = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class RegionSolver:
    """cost : of one frame of the whole panel. baseline : the cost at the solved baseline, given its readings.

    significance : in units of the noise, what a reading must stand out by to count as changed.
    """

    cost: Cost
    baseline: Evaluation
    significance: float
    settings: Settings

    def solve(self, data: Data, previous: Array) -> Solution:
        """The estimate of a frame after the last one, (rows, columns) ohm; the whole panel where most of it changed.

        Blocks are the rectangles round readings whose change stands out from that of their row and column. They grow
        until the change that cells fitted to the readings leave unexplained does not stand out; the cost is minimised
        there once they are known.
        """
        network = self._resting()
        change, noise = np.log(data.measured[0] / self.baseline.data.measured[0]), self._noise(data)
        plain = np.ones(change.shape, dtype=bool)
        for marks in (data.marks, self.baseline.data.marks):
            plain &= True if marks is None else (marks[0][0] == 0) & (marks[1][0] > 0)
        blocks: tuple[Block, ...] = ()
        for _ in range(MOST_GROWTHS):
            explained = np.log(network.two_point_resistance() / self.baseline.two_point_resistance[0])
            found = grown(self._outstanding(change - explained, noise) & plain, blocks)
            if found == blocks:
                break
            if sum(map(area, found)) > LARGEST_SHARE * change.size:
                return best_solution(Newton(self.cost, self.settings), data, previous[None])
            blocks = found
            for block in blocks:
                network = fitted(network, data, block, plain)
        return self._minimised(data, previous, network, blocks)

    def _resting(self) -> Network:
        network = self.baseline.networks[0]
        assert isinstance(network, Network)
        return network

    def _minimised(self, data: Data, previous: Array, network: Network, blocks: tuple[Block, ...]) -> Solution:
        """The cost's minimum over the cells of each block in turn, all others as they are."""
        dual, iterations = np.zeros(len(self.cost.functions.slope)), 0
        for block in blocks:
            outcome, around = self._solve_block(data, previous, network, block)
            iterations += outcome.iterations
            network = changed(network, around, 1 / outcome.cell_resistance[0])
        found = Outcome(1 / network.conductance[None], dual, Status.APPROXIMATE, iterations)
        return approximation(self.cost, data, found)

    def _solve_block(self, data: Data, previous: Array, network: Network, block: Block) -> tuple[Outcome, Block]:
        """The cells of a block with what penalties read round it, where nothing may move; and those cells' place."""
        plain = all(isinstance(term, Misfit) for term in self.cost.terms)
        around = block if plain else widened(block, HALO, data.measured[0].shape)
        given = (data.measured, data.sigma, data.lower, data.upper, *(data.marks or ()))
        measured, sigma, lower, upper, *marks = (np.ascontiguousarray(part[:, *around]) for part in given)
        cells = 1 / network.conductance
        for bound in (lower, upper):
            own = bound.copy()
            bound[:] = cells[around]
            inner = tuple(slice(b.start - a.start, b.stop - a.start) for b, a in zip(block, around, strict=True))
            bound[:, *inner] = own[:, *inner]
        known = None if data.previous is None else data.previous[around]
        surroundings = Surroundings.of(network, *around)
        inside = Data(measured, sigma, lower, upper, known, surroundings, (marks[0], marks[1]) if marks else None)
        _, rows, columns = measured.shape
        cost = block_cost(self.cost, (rows, columns), faulty_within(self.cost, around))
        starts = [evaluated(cost, inside, start[around][None]) for start in (cells, previous)]
        start = min(starts, key=lambda point: point.objective)
        return Newton(cost, self.settings).solve(inside, start), around

    def _noise(self, data: Data) -> Array:
        """Standard deviation of a reading's logarithmic change."""
        before = self.baseline.data
        noise: Array = np.hypot(data.sigma[0] / data.measured[0], before.sigma[0] / before.measured[0])
        return noise

    def _outstanding(self, change: Array, noise: Array) -> NDArray[np.bool_]:
        """Where a change differs from those of its row and column by more than the noise explains.

        Only the strongest count: they spread along rows and columns, and hide what is weaker.
        """
        rest = change - np.median(change, axis=1, keepdims=True)
        rest -= np.median(rest, axis=0, keepdims=True)
        rest = np.abs(rest)
        spread = MAD * float(np.median(rest))
        excess = np.where(rest > self.significance * np.maximum(noise, spread), rest, 0.0)
        outstanding: NDArray[np.bool_] = excess > SHARE * excess.max()
        return outstanding


def changed(network: Network, block: Block, conductance: Array) -> Network:
    """The network with other conductances in a block: Z − Z_S (1 + ΔL Z_SS)⁻¹ ΔL Z_Sᵀ, S the lines of the block."""
    lines = lines_of(network, block)
    change = laplacian(conductance - network.conductance[block])
    towards = network.impedance[:, lines]
    core = np.linalg.solve(np.eye(len(lines)) + change @ towards[lines], change)
    whole = network.conductance.copy()
    whole[block] = conductance
    return Network(whole, network.impedance - towards @ core @ towards.T)


def lines_of(network: Network, block: Block) -> NDArray[np.intp]:
    """The numbers of a block's lines, rows first."""
    rows, columns = network.conductance.shape
    return np.concatenate([np.arange(rows)[block[0]], rows + np.arange(columns)[block[1]]])


def fitted(network: Network, data: Data, block: Block, plain: NDArray[np.bool_]) -> Network:
    """The network with the block's cells such that they reproduce its plain readings, as far as bounds allow.

    g* = argmin ⟨R_m, g⟩ − log det C(g), convex; see `lampest.solvers.convex`.
    """
    measured, least = data.measured[0][block], 1 / data.upper[0][block]
    lines = lines_of(network, block)
    resting, impedance = network.conductance[block], network.impedance[np.ix_(lines, lines)]

    def at(conductance: Array) -> tuple[float, Network]:
        system = np.eye(len(lines)) + impedance @ laplacian(conductance - resting)
        value = float(np.sum(measured * conductance)) - float(np.linalg.slogdet(system)[1])
        return value, Network(conductance, np.linalg.solve(system, impedance))

    conductance = resting
    value, here = at(conductance)
    for _ in range(MOST_FITS):
        gradient = measured - here.two_point_resistance()
        free = plain[block] & ((conductance > least * (1 + 1e-12)) | (gradient < 0))
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < FITTED:
            break
        chosen, step = np.flatnonzero(free), np.zeros(measured.shape)
        curvature = here.transfer()[np.ix_(chosen, chosen)] ** 2
        step[free] = np.linalg.solve(curvature, -gradient[free])
        for length in LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, there = at(trial)
            if trial_value <= value + 1e-4 * float(np.sum(gradient * (trial - conductance))) + ROUNDING * abs(value):
                break
        else:
            break
        conductance, value, here = trial, trial_value, there
    return changed(network, block, conductance)


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    covered = np.zeros(cells.shape, dtype=bool)
    for row, column in np.argwhere(cells):
        covered[max(row - MARGIN, 0) : row + MARGIN + 1, max(column - MARGIN, 0) : column + MARGIN + 1] = True
    for block in blocks:
        covered[block] = True
    count = -1
    while count != np.count_nonzero(covered):
        count = np.count_nonzero(covered)
        found = tuple(patches(covered))
        for block in found:
            covered[block] = True
    return found


def patches(cells: NDArray[np.bool_]) -> Iterator[Block]:
    """The rectangle round each group of cells that touch, corners included."""
    left = {(int(row), int(column)) for row, column in np.argwhere(cells)}
    while left:
        group = [left.pop()]
        for row, column in group:  # grows while it is walked through
            near = {(row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)} & left
            left -= near
            group += near
        sides = [[cell[axis] for cell in group] for axis in (0, 1)]
        down, across = (slice(min(side), max(side) + 1) for side in sides)
        yield down, across


def area(block: Block) -> int:
    """Number of cells."""
    return int((block[0].stop - block[0].start) * (block[1].stop - block[1].start))


def widened(block: Block, by: int, shape: tuple[int, ...]) -> Block:
    """The block with so many more cells on every side, as far as the panel goes."""
    down, across = (
        slice(max(side.start - by, 0), min(side.stop + by, n)) for side, n in zip(block, shape, strict=True)
    )
    return down, across


@lru_cache(maxsize=64)
def block_cost(cost: Cost, shape: tuple[int, int], faulty: tuple[int, ...]) -> Cost:
    """The same terms on a block; one object for a shape, so that it is compiled once."""
    return replace(cost, panel=Panel(*shape), faulty=faulty)


def faulty_within(cost: Cost, block: Block) -> tuple[int, ...]:
    """The numbers that faulty cells have within a block."""
    broken = np.zeros(cost.panel.cells, dtype=bool)
    broken[list(cost.faulty)] = True
    return tuple(int(cell) for cell in np.flatnonzero(broken.reshape(cost.panel.shape)[block]))
