"""A second witness of an estimate: the frame solved again by IPOPT on the nodal program.

The second solve has another start. The witness sees the data of the frame and nothing of the first
solve: neither its cells nor its carried state.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.levels import Witness
from lampest.files.typed import Configuration
from lampest.panel.panel import Array
from lampest.recording.readings import Readings, strongest_frame
from lampest.solvers.multistart import evaluated, scattered, solved_from
from lampest.solvers.solution import Settings, Solution

# Cells up to which `strongest` is verified: beyond, the witness takes longer than all solves of a
# short recording (docs/studies/speed.md).
MAX_CELLS = 144
SAME_COST = 1e-6  # relative difference of costs below which two optima are one


@dataclass(frozen=True)
class Verify(Configuration):
    """Frames that IPOPT solves again on the nodal program, from another start.

    Attributes
    ----------
    frames : 'none', 'strongest', 'all' or float
        'strongest' is the frame of the largest change from rest, on panels of up to 144 cells; a
        number is the share of the frames, evenly spread.

    Raises ValueError unless a share lies between 0 and 1.

    >>> lampest.Verify("strongest").frames
    'strongest'
    """

    frames: Literal["none", "strongest", "all"] | float = "none"

    def __post_init__(self) -> None:
        if not isinstance(self.frames, str) and not 0 < self.frames <= 1:
            raise ValueError("frames must be none, strongest, all, or a share between 0 and 1")

    def chosen(self, readings: Readings, resting: Readings) -> NDArray[np.bool_]:
        """Return which of the measured frames are verified, boolean (frames,).

        Parameters
        ----------
        readings : Readings
            The measured frames, (frames, rows, columns).
        resting : Readings
            The unloaded ones, (rows, columns).
        """
        count = len(readings.value)
        chosen = np.zeros(count, dtype=bool)
        if self.frames == "all":
            chosen[:] = True
        elif self.frames == "strongest":
            if count and readings.value[0].size <= MAX_CELLS:
                chosen[strongest_frame(readings.plain_values, resting.value, np.arange(count))] = (
                    True
                )
        elif not isinstance(self.frames, str):
            chosen[np.linspace(0, count - 1, max(1, round(self.frames * count))).astype(int)] = (
                count > 0
            )
        return chosen


@dataclass(frozen=True)
class Verification:
    """Comparison of an estimate with that of the witness.

    Attributes
    ----------
    witness : Witness
    difference : float
        Largest difference of ln r between both; NaN where the witness has no optimum.
    decrease : float
        Decrease of the cost relative to the first solve; 0 unless the witness is lower.
    """

    witness: Witness
    difference: float = float("nan")
    decrease: float = 0.0


def testimony(cost: Cost, data: Data, previous: Array | None, settings: Settings) -> Solution:
    """Return the solution of IPOPT on the nodal program, from another start.

    The start differs from that of the first solve.

    Parameters
    ----------
    cost : Cost
    data : Data
    previous : array, shape (frames, rows, columns), or None
        Start of the first solve, ohm; None where it began at equal cells.
    settings : Settings
    """
    from lampest.formulation.patterns import Nodal
    from lampest.solvers.by_ipopt import Ipopt

    solver = Ipopt(cost, settings, data.readout, data.wiring, Nodal())
    with np.errstate(all="ignore"):
        start = another_start(cost, data, previous)
        return replace(solved_from(solver, start), solver=solver.name)


def another_start(cost: Cost, data: Data, previous: Array | None) -> Evaluation:
    """Return a start that the first solve did not have.

    The start has equal cells, or scattered ones after a start at equal cells. Where two panels read
    alike, the equal cells lie on the branch of the first start.
    """
    if previous is None:
        return evaluated(cost, data, next(scattered(data)))
    equal = evaluated(cost, data, data.uniform_start)
    if np.array_equal(equal.branch, evaluated(cost, data, previous).branch):
        return equal
    return evaluated(
        cost,
        data,
        np.broadcast_to(np.median(previous, axis=(-2, -1), keepdims=True), previous.shape),
    )


def compared(solution: Solution, witness: Solution) -> Verification:
    """Return the comparison of a solution with that of the witness."""
    if not witness.optimum:
        return Verification(Witness.FAILED)
    if not solution.optimum:
        return Verification(Witness.LOWER)
    ratio = np.abs(np.log(solution.cell_resistance / witness.cell_resistance))
    difference = float(ratio.max())
    negligible = 0.0 if witness.at is None else SAME_COST * witness.at.cost_scale
    scale = max(abs(solution.objective), negligible)
    change = (witness.objective - solution.objective) / scale
    if abs(change) <= SAME_COST:
        return Verification(Witness.SAME, difference)
    return Verification(
        Witness.HIGHER if change > 0 else Witness.LOWER, difference, max(-change, 0.0)
    )
