"""Only what changed is unknown: a block of cells is estimated, all others keep their baseline value."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lampest.cost import Cost
from lampest.kirchhoff import Network, Surroundings
from lampest.panel import Array, Panel
from lampest.problem import Data, Evaluation
from lampest.search import best_solution, evaluated
from lampest.solvers.newton import Newton
from lampest.solvers.solution import Outcome, Settings, Solution, Status, approximation

MARGIN = 1
MOST_GROWTHS = 6
LARGEST_SHARE = 0.5
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

        The region is the rectangle round the readings whose change stands out from that of their row and column; it
        grows until the change that the estimate leaves unexplained outside does not stand out.
        """
        cells = self.baseline.cell_resistance[0]
        expected, iterations = self.baseline.two_point_resistance[0], 0
        noise = self._noise(data)
        block: Block | None = None
        for _ in range(MOST_GROWTHS):
            left = np.log(data.measured[0] / self.baseline.data.measured[0]) - np.log(
                expected / self.baseline.two_point_resistance[0]
            )
            grown = rectangle(self._outstanding(left, noise), block)
            if grown is None or grown == block:
                break
            if (grown[0].stop - grown[0].start) * (grown[1].stop - grown[1].start) > LARGEST_SHARE * cells.size:
                return best_solution(Newton(self.cost, self.settings), data, previous[None])
            block = grown
            outcome = self._solve_block(data, previous, block)
            iterations += outcome.iterations
            cells = self.baseline.cell_resistance[0].copy()
            cells[block] = outcome.cell_resistance[0]
            expected = data.network(0, cells).two_point_resistance()
        slope = np.zeros(len(self.cost.functions.slope))
        return approximation(self.cost, data, Outcome(cells[None], slope, Status.APPROXIMATE, iterations))

    def _solve_block(self, data: Data, previous: Array, block: Block) -> Outcome:
        network = self.baseline.networks[0]
        assert isinstance(network, Network)
        names = ("measured", "sigma", "lower", "upper")
        parts = {name: np.ascontiguousarray(getattr(data, name)[:, *block]) for name in names}
        known = None if data.previous is None else data.previous[block]
        inside = Data(**parts, previous=known, surroundings=Surroundings.of(network, *block))
        _, rows, columns = inside.measured.shape
        cost = block_cost(self.cost, (rows, columns))
        return Newton(cost, self.settings).solve(inside, evaluated(cost, inside, previous[block][None]))

    def _noise(self, data: Data) -> Array:
        """Standard deviation of a reading's logarithmic change."""
        before = self.baseline.data
        noise: Array = np.hypot(data.sigma[0] / data.measured[0], before.sigma[0] / before.measured[0])
        return noise

    def _outstanding(self, change: Array, noise: Array) -> NDArray[np.bool_]:
        """Where a change differs from those of its row and column by more than the noise explains."""
        rest = change - np.median(change, axis=1, keepdims=True)
        rest -= np.median(rest, axis=0, keepdims=True)
        spread = MAD * float(np.median(np.abs(rest)))
        outstanding: NDArray[np.bool_] = np.abs(rest) > self.significance * np.maximum(noise, spread)
        return outstanding


def rectangle(cells: NDArray[np.bool_], within: Block | None) -> Block | None:
    """The rectangle round the chosen cells with a margin of one, and round an earlier one; None for no cell at all."""
    found = np.argwhere(cells)
    if len(found) == 0:
        return within
    first, last = np.maximum(found.min(axis=0) - MARGIN, 0), found.max(axis=0) + MARGIN + 1
    last = np.minimum(last, cells.shape)
    if within is not None:
        first = np.minimum(first, [side.start for side in within])
        last = np.maximum(last, [side.stop for side in within])
    return slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))


@lru_cache(maxsize=64)
def block_cost(cost: Cost, shape: tuple[int, int]) -> Cost:
    """The same terms on a block; one object for a shape, so that it is compiled once."""
    return replace(cost, panel=Panel(*shape))
