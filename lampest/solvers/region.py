"""Only what changed is unknown: blocks of cells are estimated, all others keep their baseline value.

A cell moves the other readings of its row and column by about 1/N or 1/M of its own, an error of the converter none.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Block, Network
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import REPRODUCED
from lampest.solvers.hessian import DENSE_STIFF_CELLS
from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Solution, Status, approximation

DRIFT = 0.02
SHARE = 0.2  # of the strongest change; what is weaker waits until that is explained
MOST_GROWTHS, SWEEPS = 6, 2
MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution
# Of a block's cells: beyond 1.5 in log r a reading's slope no longer predicts it.
FIT = LevenbergMarquardt(evaluations=30, settled=0.0, damping=1e-12, longest=1.5)
UNSURE = 0.2  # of what a load would do, a median's standard deviation: beyond, noise hides whether there is one


@dataclass(frozen=True, eq=False)
class RegionSolver:
    """baseline : the cost at its optimum. significance : what a changed reading stands out by, times its noise."""

    baseline: Evaluation
    significance: float
    settings: Settings

    def solve(self, cost: Cost, data: Data, previous: Array) -> Solution:
        """The estimate of a frame after the last one, (rows, columns) ohm; the whole panel where most of it changed.

        Blocks are rectangles round readings whose change stands out. They grow until what fitted cells leave
        unexplained does not; the cost is then minimised over their cells.
        """
        network, before = self._exact, self.baseline.data
        change = np.log(data.measured[0] / before.measured[0])
        noise = np.hypot(data.sigma[0] / data.measured[0], before.sigma[0] / before.measured[0])
        plain = data.plain[0] & before.plain[0]
        outliers = np.zeros_like(plain)
        blocks: tuple[Block, ...] = ()
        for _ in range(MOST_GROWTHS):
            left = change - np.log(network.reading() / self._exact.reading())
            covered = covered_by(blocks, plain.shape)
            kept = np.where(outliers & covered, np.nan, left)
            outliers = self._outliers(network, data, kept, noise, plain & ~covered)
            outstanding = self._outstanding(np.where(outliers, np.nan, left), noise) & plain
            found = grown(outstanding, blocks)
            large = covered_by(found, plain.shape).sum() > min(change.size / 2, DENSE_STIFF_CELLS)
            if large or (found == blocks and self._drifted(left, noise)):
                return best_solution(ProjectedNewton(cost, self.settings), data, previous[None])
            if found == blocks:
                if not outstanding.any():
                    break
                # No cells of a block give this reading: without it, from the beginning.
                outliers, network = outliers | outstanding, self._exact
            blocks = found
            for block in blocks * (1 if len(blocks) == 1 else SWEEPS):
                given = (data.measured[0][block], 1 / data.upper[0][block], (plain & ~outliers)[block])
                network = fitted_block(network, block, *given)
        measured = np.where(outliers, network.reading(), data.measured[0])[None]
        used = replace(data, given=replace(data.given, measured=measured))
        inside = covered_by(blocks, plain.shape)
        resting, ways = self.baseline.cell_resistance, (network.cell_resistance, previous)
        starts = (evaluated(cost, used, np.where(inside, cells, resting)) for cells in ways)
        begun = min(starts, key=lambda point: point.objective)
        return self._minimised(cost, data, used, begun.cell_resistance, inside)

    @cached_property
    def _exact(self) -> Network:
        """A network that reproduces the baseline's readings, which a baseline with penalties does not."""
        resting, data = self.baseline.networks[0], self.baseline.data
        if all(term.reads_measurement for term in self.baseline.cost.terms):
            return resting
        cells = data.readout.start(data.measured[0], data.upper[0])
        return data.network(0, np.clip(cells, data.lower[0], data.upper[0]))

    def _outliers(
        self, network: Network, data: Data, change: Array, noise: Array, asked: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Readings that are no load's: NaN already, or of `asked` and isolated without their cells' footprint."""
        outliers = np.isnan(change)
        for _ in range(MOST_GROWTHS):
            left = np.where(outliers, np.nan, change)
            alone = isolated(np.nan_to_num(_apart(left)), SHARE) & self._outstanding(left, noise) & asked & ~outliers
            found = np.zeros_like(alone)
            for row, column in np.argwhere(alone):
                found[row, column] = not has_footprint(network, data, left, noise, (row, column))
            if not found.any():
                break
            outliers |= found
        return outliers

    def _drifted(self, change: Array, noise: Array) -> bool:
        # Cells that change at random by x change their readings by about 2x/(M + N − 1); by the same x, by x.
        common = np.nanmedian(change)
        spread = MAD * np.nanmedian(np.abs(change - common))
        least = self.significance * float(np.median(noise))
        return bool(abs(common) > max(DRIFT, least) or spread > max(2 * DRIFT / (sum(change.shape) - 1), least))

    def _outstanding(self, change: Array, noise: Array) -> NDArray[np.bool_]:
        """Only the strongest of what noise does not explain: they spread along lines and hide what is weaker."""
        apart = _apart(change)
        spread = MAD * float(np.nanmedian(apart))
        excess = np.where(apart > self.significance * np.maximum(noise, spread), apart, 0.0)
        return np.asarray(excess > SHARE * excess.max())

    def _minimised(self, cost: Cost, data: Data, used: Data, start: Array, inside: NDArray[np.bool_]) -> Solution:
        fixed = replace(used, lower=np.where(inside, data.lower, start), upper=np.where(inside, data.upper, start))
        found = solved_from(ProjectedNewton(cost, self.settings), Evaluation.at(cost, fixed, start))
        cells = found.cell_resistance if found.solved else start
        outcome = Outcome(cells, np.zeros(len(cost.slope)), Status.APPROXIMATE, found.iterations)
        return approximation(cost, data, outcome)


def _apart(change: Array) -> Array:
    """By how much a change differs from those of its row and column, either way."""
    rest = change - np.nanmedian(change, axis=1, keepdims=True)
    return np.asarray(np.abs(rest - np.nanmedian(rest, axis=0, keepdims=True)))


def fitted_block(network: Network, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]) -> Network:
    """The network with a block's cells such that they reproduce its chosen readings, as far as bounds allow.

    measured, least : (rows, columns) of the block: readings, and the least conductance in siemens.
    """
    whole = np.zeros(network.conductance.shape, dtype=bool)
    whole[block] = chosen
    cells, size = np.flatnonzero(whole), float(np.abs(measured).max())

    def changed(logarithm: Array) -> Network:
        conductance = network.conductance[block].copy()
        conductance[chosen] = np.exp(-logarithm)
        return network.changed(block, np.maximum(conductance, least))

    def missed(logarithm: Array) -> SumOfSquares:
        there = changed(logarithm)
        return SumOfSquares((there.reading()[block] - measured)[chosen] / size, there.sensitivity(cells, cells) / size)

    start, highest = (-np.log(part[chosen]) for part in (network.conductance[block], least))
    found = FIT.minimum(
        missed, start, (-np.inf, highest), lambda at, _: bool(np.abs(at.residual).max(initial=0.0) <= REPRODUCED)
    )
    return changed(found.position)


def grown(cells: NDArray[np.bool_], blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """The rectangles round neighbouring cells with a margin of one, and round earlier blocks; none overlap."""
    touching = np.ones((3, 3))  # scipy.ndimage is imported by its first use: few estimates need it
    covered = covered_by(blocks, cells.shape) | scipy.ndimage.binary_dilation(cells, touching)
    while True:
        found = tuple(scipy.ndimage.find_objects(scipy.ndimage.label(covered, touching)[0]))
        filled = covered_by(found, cells.shape)
        if np.array_equal(filled, covered):
            return found
        covered = filled


def covered_by(blocks: tuple[Block, ...], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(rows, columns) which cells some block covers."""
    covered = np.zeros(shape, dtype=bool)
    for block in blocks:
        covered[block] = True
    return covered


def isolated(values: Array, share: float) -> NDArray[np.bool_]:
    """(rows, columns) which values have at most one neighbour, corners included, that exceeds a share of them."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 1), values.shape)  # (3, 3, rows, columns)
    exceeds = around > share * values
    return np.asarray(exceeds.sum(axis=(0, 1)) - exceeds[1, 1] <= 1)


def has_footprint(network: Network, data: Data, change: Array, noise: Array, place: tuple[int, int]) -> bool:
    """Whether an isolated reading that stands out comes of its cell, as far as noise lets that be seen.

    change : of the logarithm of readings, beyond what `network` explains; NaN where unknown. noise : its deviation.
    """
    row, column = place
    block = (slice(row, row + 1), slice(column, column + 1))
    given = (data.measured[0][block], 1 / data.upper[0][block], np.ones((1, 1), dtype=bool))
    predicted = np.log(fitted_block(network, block, *given).reading() / network.reading())
    if abs(predicted[place]) < abs(change[place]) / 2:  # nearer to nothing than to all of what a load would do
        return False
    common = np.nanmedian(change)
    for line, own in ((np.s_[row, :], column), (np.s_[:, column], row)):
        others = np.delete(change[line], own)
        expected = float(np.median(np.delete(predicted[line], own))) if others.size else 0.0
        if expected == 0.0:
            continue
        error = float(np.median(noise)) * np.sqrt(np.pi / 2 / others.size) / abs(expected)
        observed = (float(np.nanmedian(others)) - common) / expected
        if error <= UNSURE and observed < 0.5:
            return False
    return True
