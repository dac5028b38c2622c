"""Trade-off of budgets, measured on a recording's own frames.

A budget is judged by its deviation from the optimum, its operations, and its time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lampest.apps.microcontroller.constants import Budget, Constants
from lampest.apps.microcontroller.host import Host
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.runs.case import CaseResult

# Clock in MHz, and least and most cycles of an instruction: estimates from manuals for this mix of
# loads, stores and fused products, which were not measured on boards.
PROCESSORS = {
    # Technical reference manual: one cycle, and one or two more for loads, stores and waits of the
    # FPU; divisions take 14.
    "cortex-m4f": (120.0, 1.6, 1.8),
    "cortex-m7": (600.0, 0.7, 1.1),  # two instructions at once, where they do not wait
    "rp2350": (150.0, 1.5, 1.8),  # one Cortex-M33, whose pipeline is that of the M4
    "esp32": (240.0, 1.6, 2.5),  # loads wait
}
BUDGETS = (
    *(Budget(1, products, 0.0) for products in (3, 5, 8)),
    *(Budget(2, products, 0.0) for products in (3, 4, 5, 6, 8, 10, 14, 20)),
    *(Budget(3, products, 0.0) for products in (8, 12, 20, 30)),
    *(Budget(5, products, 0.0) for products in (20, 40)),
)
# Standard deviations after two frames of a touch: half of what shows, as loads move meanwhile.
MAX_TOUCH = 0.5
DEFAULT_WITHIN = 0.05  # standard deviations of a cell's own error, which is not noticeable
# the first ones of a recording: enough for a median
MIN_FRAMES = 6
MAX_FRAMES = 40
# Operations of a product of all frames; all budgets take a minute at 64 × 64 cells.
MAX_OPERATIONS = 2_000_000
# Instructions of a Cortex-M4F, fitted to 60 counts of QEMU from 4 × 4 to 16 × 16 cells, all within
# 10 % (tests/apps/board/test_estimate.py): of a product for each operation of its matrices and each
# cell, of a step, of a frame.
FOR_OPERATION = 3.56
FOR_CELL = 136.0
FOR_STEP_CELL = 3040.0
FOR_STEP_LINES = 7.4
FOR_FRAME_CELL = 271.0


@dataclass(frozen=True)
class Trade:
    """Accuracy and work of a budget.

    Attributes
    ----------
    budget : Budget
    median, worst : float
        Deviation from the optimum, rms over the cells, in standard deviations of their own errors:
        median and worst of the frames.
    touch : float
        The same after two frames of the strongest load, begun at the unloaded panel.
    instructions, most_instructions : float
        Of a Cortex-M4F for a frame, mean and largest.
    """

    budget: Budget
    median: float
    worst: float
    touch: float
    instructions: float
    most_instructions: float

    def milliseconds(self, processor: str) -> tuple[float, float]:
        """Return the range of the estimated time of the costliest frame.

        Returns
        -------
        least, most : float
            In milliseconds.
        """
        megahertz, least, most = PROCESSORS[processor]
        of_cycle = self.most_instructions / megahertz / 1000
        return least * of_cycle, most * of_cycle


Trades = tuple[Trade, ...]


def operations_of(constants: Constants) -> int:
    """Return 6·m·n² + 2·n³, the multiplications of the matrices of a product, m ≥ n lines."""
    longer, shorter = sorted(constants.scene.panel.shape, reverse=True)
    return int(6 * longer * shorter**2 + 2 * shorter**3)


def instructions(constants: Constants, products: Array, steps: Array) -> Array:
    """Return the instructions of frames on a Cortex-M4F by their conjugate-gradient iterations."""
    rows, columns = constants.scene.panel.shape
    cells = rows * columns
    of_product = FOR_OPERATION * operations_of(constants) + FOR_CELL * cells
    of_step = FOR_STEP_CELL + FOR_STEP_LINES * max(rows, columns)
    return products * of_product + cells * (steps * of_step + FOR_FRAME_CELL)


def trades(host: Host, constants: Constants, case: CaseResult) -> Trades:
    """Return effort and accuracy of each budget on the first frames of a case.

    Raises InputError without error bars.
    """
    if case.sigma_own is None:
        raise InputError("these results have no error bars, the unit of the deviation")
    affordable = max(MIN_FRAMES, MAX_OPERATIONS // operations_of(constants))
    count = min(MAX_FRAMES, affordable)
    sums = constants.sums_of(case)[:count]
    with np.errstate(invalid="ignore", divide="ignore"):
        optimum = np.log(case.cell_resistance / case.baseline_resistance)[:count]
        own = np.where(case.sigma_own > 0, case.sigma_own, np.nan)[:count]
    # An open cell has no value, and a cell at a bound no error.
    own[case.open_cell[:count] | case.at_lower_bound[:count] > 0] = np.nan
    solved = np.isfinite(optimum / own).any(axis=(1, 2))
    if not np.any(solved):
        raise InputError(
            "no frame of these results is solved, so that there is nothing to compare with"
        )
    squares = np.where(np.isfinite(own), optimum, 0.0) ** 2
    strongest = int(np.argmax(np.nansum(squares, axis=(1, 2))))
    trades = []
    for budget in BUDGETS:
        frames = host.frames(sums, budget)
        deviation = _deviation(frames.log_change[solved], optimum[solved], own[solved])
        touched = host.frames(sums[[strongest, strongest]], budget).log_change[1]
        touch = _deviation(touched, optimum[strongest], own[strongest])
        spent = instructions(constants, frames.products - frames.steps, frames.steps)
        measures = np.median(deviation), deviation.max(), touch, spent.mean(), spent.max()
        trades.append(Trade(budget, *map(float, measures)))
    return tuple(trades)


def _deviation(log_change: Array, optimum: Array, own: Array) -> Array:
    """Return the rms deviation of maps (..., rows, columns) in standard deviations, (...)."""
    with np.errstate(invalid="ignore"):
        square = ((log_change - optimum) / own) ** 2
    return np.asarray(np.sqrt(np.nanmean(square, axis=(-2, -1))))


def chosen_budget(
    table: Sequence[Trade], within: float | None, milliseconds: float | None, processor: str | None
) -> tuple[Trade, float]:
    """Return the budget that fits a user's wishes.

    Parameters
    ----------
    table : sequence of Trade
    within : float or None
        Largest deviation of the median frame, in standard deviations. The second frame of a touch
        ends within MAX_TOUCH, or this, where a budget can.
    milliseconds : float or None
        Longest time of a frame on the processor, by the upper end of the estimate; without `within`
        the most exact budget that takes no longer.
    processor : str or None
        One of PROCESSORS.

    Returns
    -------
    budget : Trade
    deviation : float
        Deviation in standard deviations at which a frame may end before it has used its budget.

    Raises
    ------
    InputError
        If no budget fits.
    """
    by_cost = sorted(table, key=lambda trade: trade.most_instructions)
    if milliseconds is not None:
        if processor is None:
            raise InputError(f"--milliseconds needs --processor: one of {', '.join(PROCESSORS)}")
        fits = [trade for trade in by_cost if trade.milliseconds(processor)[1] <= milliseconds]
        if not fits:
            least, most = by_cost[0].milliseconds(processor)
            raise InputError(
                f"no budget takes {milliseconds:g} ms on {processor}: "
                f"the smallest takes {least:.2g} to {most:.2g} ms"
            )
        if within is None:
            return min(fits, key=lambda trade: trade.median), DEFAULT_WITHIN
        by_cost = fits
    aim = DEFAULT_WITHIN if within is None else within
    exact = [trade for trade in by_cost if trade.median <= aim]
    if not exact and within is not None:
        least = min(trade.median for trade in by_cost)
        raise InputError(
            f"no budget ends within {within:g} σ in the median frame: the best one at {least:.2g}"
        )
    prompt = [trade for trade in exact if trade.touch <= max(MAX_TOUCH, aim)]
    if prompt:
        return prompt[0], aim
    if exact:
        return min(exact, key=lambda trade: trade.touch), aim
    return min(by_cost, key=lambda trade: trade.median), aim


def table_of(table: Sequence[Trade]) -> Table:
    """Return the table of budgets with their effort and accuracy."""
    headers = (
        "steps",
        "products",
        "σ median",
        "σ worst",
        "σ touch",
        "million instructions",
        "at most",
    )
    cells = tuple(
        (
            str(trade.budget.steps),
            str(trade.budget.products),
            *(f"{value:.2g}" for value in (trade.median, trade.worst, trade.touch)),
            *(f"{value / 1e6:.2f}" for value in (trade.instructions, trade.most_instructions)),
            *(
                "{:.2g} to {:.2g}".format(*trade.milliseconds(processor))
                for processor in PROCESSORS
            ),
        )
        for trade in table
    )
    return Table((*headers, *(f"{processor}, about ms" for processor in PROCESSORS)), cells)
