"""Only what changed is unknown: blocks of cells are estimated, all others keep their baseline value."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Term
from lampest.panel.network import Block, Network
from lampest.panel.panel import Array, Panel
from lampest.solvers.hessian import Hessian, weighted_square
from lampest.solvers.multistart import best_solution
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.region.blocks import alone_among, area, covered_by, grown, widened
from lampest.solvers.region.footprint import moved_lines
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import OPEN_FRACTION, Outcome, Settings, Solution, Status, approximation

HALO = 2  # cells round a block that a gradient inside it reads
DRIFT = 0.02
SHARE = 0.2  # of the strongest change; what is weaker waits until that is explained
MOST_GROWTHS, SWEEPS = 6, 2
LARGEST_SHARE, MOST_CELLS = 0.5, 600
MAD = 1.4826  # of a normal distribution, from median absolute deviation to standard deviation
MOST_STEPS, SMALL_STEP, UNSEEN, LONGEST_STEP, LARGEST_DAMPING = 40, 1e-6, 1e-4, 2.5, 1e8
SHARPEST = 4
MOST_ALONE = 8  # readings: of more at once that stand out alone, those that noise leaves open are taken for errors


@dataclass(frozen=True, eq=False)
class RegionSolver:
    """baseline : the cost at the solved baseline, given its readings.

    significance : in units of the noise, what a reading must stand out by to count as changed.
    """

    baseline: Evaluation
    significance: float
    settings: Settings

    def solve(self, cost: Cost, data: Data, previous: Array) -> Solution:
        """The estimate of a frame after the last one, (rows, columns) ohm; the whole panel where most of it changed.

        Blocks are the rectangles round readings whose change stands out from that of their row and column. They grow
        until the change that cells fitted to the readings leave unexplained does not stand out; the cost is minimised
        there once they are known.
        """
        network = self._exact
        change, noise = np.log(data.measured[0] / self.baseline.data.measured[0]), self._noise(data)
        plain = data.plain[0] & self.baseline.data.plain[0]
        wild = np.zeros_like(plain)
        blocks: tuple[Block, ...] = ()
        for _ in range(MOST_GROWTHS):
            left = change - np.log(network.reading() / self._exact.reading())
            covered = covered_by(blocks, plain.shape)
            wild = self._wild(network, data, np.where(wild & covered, np.nan, left), noise, plain & ~covered)
            outstanding = self._outstanding(np.where(wild, np.nan, left), noise) & plain
            found = grown(outstanding, blocks)
            large = sum(map(area, found)) > min(LARGEST_SHARE * change.size, MOST_CELLS)
            if large or (found == blocks and self._moved(left, noise)):
                return best_solution(ProjectedNewton(cost, self.settings), data, previous[None])
            if found == blocks:
                if not outstanding.any():
                    break
                # No cells of a block give this reading: without it, from the beginning.
                wild, network = wild | outstanding, self._exact
            blocks = found
            for block in blocks * (1 if len(blocks) == 1 else SWEEPS):
                chosen = (plain & ~wild)[block]
                given = (data.measured[0][block], 1 / data.upper[0][block], chosen)
                network = data.readout.fitted_block(network, block, *given)
        return self._minimised(cost, data, _repaired(data, wild, network), previous, network, blocks)

    def _wild(
        self, network: Network, data: Data, change: Array, noise: Array, asked: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Readings that are no load's: NaN already, or standing out alone without their cells' footprint.

        asked : those that may be. The strongest hide weaker ones, which are asked in turn.
        """
        wild = np.isnan(change)
        for _ in range(MOST_GROWTHS):
            left = np.where(wild, np.nan, change)
            alone = alone_among(np.nan_to_num(_apart(left)), SHARE) & self._outstanding(left, noise) & asked & ~wild
            many = bool(np.count_nonzero(alone | (wild & asked)) > MOST_ALONE)
            found = alone & ~moved_lines(network, data, left, noise, alone, many)
            if not found.any():
                break
            wild |= found
        return wild

    @cached_property
    def _exact(self) -> Network:
        """A network that reproduces the baseline's readings, which a baseline with penalties does not."""
        resting, data = self.baseline.networks[0], self.baseline.data
        if all(term.reads_measurement for term in self.baseline.cost.terms):
            return resting
        cells = data.readout.exact_start(data.measured[0], data.upper[0])
        return data.network(0, np.clip(cells, data.lower[0], data.upper[0]))

    def _minimised(
        self, cost: Cost, data: Data, used: Data, previous: Array, fit: Network, blocks: tuple[Block, ...]
    ) -> Solution:
        """The cost's minimum over the cells of each block in turn, all others as they are; used : without wild ones.

        What it costs is told of all readings.
        """
        network, steps = self.baseline.networks[0], 0
        for block in blocks:
            network = network.changed(block, fit.conductance[block])
        for block in blocks:
            part = Inside.of(cost, used, network, block)
            starts = [part.at(np.log(cells[block]).ravel()) for cells in (1 / fit.conductance, previous)]
            network, taken = minimised(part, min(starts, key=lambda point: point.objective))
            steps += taken
        cells = self.baseline.cell_resistance.copy()
        for block in blocks:
            cells[0][block] = 1 / network.conductance[block]
        return self._solution(cost, data, network.relabelled(cells[0]), cells, steps)

    def _solution(self, cost: Cost, data: Data, network: Network, cells: Array, steps: int) -> Solution:
        """What `approximation` gives; without solving the network once more, unless changes of it have lost digits."""
        if np.any(network.reading() <= 0):
            return approximation(cost, data, Outcome(cells, np.zeros(len(cost.slope)), Status.APPROXIMATE, steps))
        at = Evaluation(cost, data, cells, network.reading()[None], (network,))
        residual = at.kkt_residual(np.zeros(len(cost.slope)))
        low, open_cell = cells <= data.lower / OPEN_FRACTION, cells >= data.upper * OPEN_FRACTION
        found = (at.costs, at.objective, residual, low, open_cell, Status.APPROXIMATE, steps)
        return Solution(cells, at.reading, *found)

    def _noise(self, data: Data) -> Array:
        """Standard deviation of a reading's logarithmic change."""
        before = self.baseline.data
        noise: Array = np.hypot(data.sigma[0] / data.measured[0], before.sigma[0] / before.measured[0])
        return noise

    def _moved(self, change: Array, noise: Array) -> bool:
        """Whether cells outside have changed by more than a drift that may be ignored: where all do none stands out.

        Cells that change at random by x change their readings by about 2x/(M + N − 1); by the same x, by x.
        """
        common = np.nanmedian(change)
        spread = MAD * np.nanmedian(np.abs(change - common))
        tolerated = DRIFT * np.array([1.0, 2 / (sum(change.shape) - 1)])
        return bool(
            np.any(np.array([abs(common), spread]) > np.maximum(tolerated, self.significance * np.median(noise)))
        )

    def _outstanding(self, change: Array, noise: Array) -> NDArray[np.bool_]:
        """Of what stands out only the strongest: they spread along rows and columns, and hide what is weaker."""
        excess = self._excess(_apart(change), noise)
        outstanding: NDArray[np.bool_] = excess > SHARE * excess.max()
        return outstanding

    def _excess(self, apart: Array, noise: Array) -> Array:
        """The same where noise does not explain it, 0 elsewhere; NaN does not count."""
        spread = MAD * float(np.nanmedian(apart))
        return np.where(apart > self.significance * np.maximum(noise, spread), apart, 0.0)


@dataclass(frozen=True, eq=False)
class Inside:
    """φ as a function of one block's cells.

    Readings count that share a line with the block, and penalties that read its cells: all that the block can move.

    resting : the network whose other cells stay. block, around : the cells that move, and with those that penalties
    read. reads : (readings) flat numbers on the panel. misfit, penalty : the terms on those readings, taken as a panel
    of one row, and on `around`; None without such terms. readings, cells : what they are given.
    """

    resting: Network
    block: Block
    around: Block
    reads: NDArray[np.intp]
    lower: Array
    upper: Array
    misfit: Cost | None
    penalty: Cost | None
    readings: Data
    cells: Data

    @classmethod
    def of(cls, cost: Cost, data: Data, network: Network, block: Block) -> "Inside":
        """Of a block of the panel that `cost` and `data` are for."""
        shape = network.conductance.shape
        cross = np.zeros(shape, dtype=bool)
        cross[block[0]] = cross[:, block[1]] = True
        around = widened(block, HALO, shape)
        reads = np.flatnonzero(cross)
        misfit = tuple(term for term in cost.terms if term.reads_measurement)
        penalty = tuple(term for term in cost.terms if not term.reads_measurement)
        high, wide = data.measured[0][around].shape
        return cls(
            network,
            block,
            around,
            reads,
            np.log(data.lower[0][block]).ravel(),
            np.log(data.upper[0][block]).ravel(),
            _part(cost, misfit, (1, len(reads)), ()) if misfit else None,
            _part(cost, penalty, (high, wide), _within(cost, around)) if penalty else None,
            _chosen(data, lambda part: part.reshape(-1)[reads][None]),
            _chosen(data, lambda part: np.ascontiguousarray(part[around])),
        )

    def at(self, position: Array) -> "BlockPoint":
        """The point u = log r of the block's cells, held to their bounds."""
        position = np.clip(position, self.lower, self.upper)
        conductance = np.exp(-position).reshape(self.resting.conductance[self.block].shape)
        network = self.resting.changed(self.block, conductance)
        cells, model = 1 / network.conductance, network.reading()
        parts = []
        if self.misfit is not None:
            own, read = (np.atleast_2d(whole.reshape(-1)[self.reads])[None] for whole in (cells, model))
            parts.append(Evaluation(self.misfit, self.readings, own, read, ()))
        if self.penalty is not None:
            own, read = (np.ascontiguousarray(whole[self.around])[None] for whole in (cells, model))
            parts.append(Evaluation(self.penalty, self.cells, own, read, ()))
        return BlockPoint(position, network, tuple(parts), sum(part.objective for part in parts))


@dataclass(frozen=True, eq=False)
class BlockPoint:
    """A point of a block: u, the whole panel's network, the misfit and the penalty there (those that exist), and φ."""

    position: Array
    network: Network
    parts: tuple[Evaluation, ...]
    objective: float


def minimised(inside: Inside, here: BlockPoint) -> tuple[Network, int]:
    """(network, steps) of damped, projected Gauss-Newton steps in u = log r that lower φ until they are small."""
    damping = 0.0
    for count in range(MOST_STEPS):
        slope, matrix = _model(inside, here, min(count, SHARPEST))
        low, high = inside.lower, inside.upper
        free = (low < high) & ~(((here.position <= low) & (slope > 0)) | ((here.position >= high) & (slope < 0)))
        size = np.diag(matrix) + 1e-12 * np.abs(np.diag(matrix)).max(initial=1e-300)
        while True:
            step = np.zeros(len(slope))
            system = matrix[np.ix_(free, free)] + np.diag((damping + 1e-12) * size[free])
            step[free] = np.clip(np.linalg.solve(system, -slope[free]), -LONGEST_STEP, LONGEST_STEP)
            there = inside.at(here.position + step)
            if there.objective < here.objective:
                break
            damping = max(10 * damping, 1e-3)
            if damping > LARGEST_DAMPING or np.abs(step).max(initial=0) < SMALL_STEP:
                return here.network, count
        moved, here = np.abs(there.position - here.position).max(initial=0), there
        damping = damping / 10 if damping > 1e-3 else 0.0
        # A step by a hundredth of the standard deviation lowers φ by 1e-4 of a reading's share of it.
        if moved < SMALL_STEP or -float(slope @ step) < UNSEEN * here.objective / len(inside.reads):
            return here.network, count + 1
    return here.network, MOST_STEPS


def _model(inside: Inside, here: BlockPoint, sharpness: int) -> tuple[Array, Array]:
    """(∇φ, its curvature without that of R) in u over the block's cells; absolute losses smoothed more or less."""
    block = np.zeros(here.network.conductance.shape, dtype=bool)
    block[inside.block] = True
    own = np.flatnonzero(block)
    cells = np.exp(here.position)
    slope, matrix = np.zeros(len(own)), np.zeros((len(own), len(own)))
    for part in here.parts:
        smoothing = Smoothing.start(part)
        smoothing = replace(smoothing, width=smoothing.width / 10**sharpness)
        smoothing = replace(smoothing, dual=smoothing.slope(part.rough))
        direct, through = (side.ravel() for side in part.partials(smoothing.dual))
        terms, count = Hessian(part, smoothing).terms, part.cell_resistance.size
        if part.cost is inside.misfit:
            jacobian = here.network.sensitivity(own, inside.reads)
            slope += jacobian.T @ through
            matrix += weighted_square(jacobian, terms.diagonal()[count:])  # a misfit speaks of one reading each
        else:
            place = np.flatnonzero(block[inside.around])
            bend = np.maximum(direct[place] * cells, 0)
            slope += direct[place] * cells
            matrix += terms[place][:, place].toarray() * np.outer(cells, cells) + np.diag(bend)
    return slope, matrix


def _apart(change: Array) -> Array:
    """By how much a change differs from those of its row and column, either way."""
    rest = change - np.nanmedian(change, axis=1, keepdims=True)
    return np.asarray(np.abs(rest - np.nanmedian(rest, axis=0, keepdims=True)))


def _repaired(data: Data, wild: NDArray[np.bool_], fit: Network) -> Data:
    """The data with the fit's readings in the place of wild ones."""
    if not wild.any():
        return data
    measured = np.where(wild, fit.reading(), data.measured[0])[None]
    return replace(data, given=replace(data.given, measured=measured))


def _chosen(data: Data, pick: Callable[[Array], Array]) -> Data:
    """The data of some of a panel's readings or cells; pick : (rows, columns) → their own shape."""
    sources = Given.sources()
    parts = {
        name: pick(value[0])[None] if sources[name].per_frame else pick(value) for name, value in data.given.named()
    }
    return Data(Given(**parts), pick(data.lower[0])[None], pick(data.upper[0])[None], data.readout, data.wiring)


@lru_cache(maxsize=64)
def _part(cost: Cost, terms: tuple[Term, ...], shape: tuple[int, int], faulty: tuple[int, ...]) -> Cost:
    """Some of the terms on another panel; one object for a shape, so that it is compiled once."""
    return replace(cost, panel=Panel(*shape), terms=terms, faulty=faulty)


def _within(cost: Cost, block: Block) -> tuple[int, ...]:
    """The numbers that faulty cells have within a block."""
    broken = np.zeros(cost.panel.cells, dtype=bool)
    broken[list(cost.faulty)] = True
    return tuple(int(cell) for cell in np.flatnonzero(broken.reshape(cost.panel.shape)[block]))
