"""A second witness of an estimate: the frame solved again by IPOPT on the nodal program.

The second solve has another start. The witness sees the data of the frame and nothing of the first
solve: neither its cells nor its carried state.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.levels import Witness
from lampest.panel.panel import Array
from lampest.solvers.multistart import evaluated, scattered, solved_from
from lampest.solvers.solution import Settings, Solution

SAME_COST = 1e-6  # relative difference of costs below which two optima are one


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
    from lampest.solvers.by_ipopt import Ipopt

    solver = Ipopt(cost, settings, data.readout, data.wiring, "nodal")
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
    return evaluated(cost, data, np.median(previous, axis=(-2, -1), keepdims=True))


def compared(solution: Solution, witness: Solution) -> Verification:
    """Return the comparison of a solution with that of the witness."""
    if not witness.optimum:
        return Verification(Witness.FAILED)
    if not solution.optimum:
        return Verification(Witness.LOWER)
    difference = float(np.abs(np.log(solution.cell_resistance / witness.cell_resistance)).max())
    negligible = 0.0 if witness.at is None else SAME_COST * witness.at.cost_scale
    scale = max(abs(solution.objective), negligible)
    change = (witness.objective - solution.objective) / scale
    if abs(change) <= SAME_COST:
        return Verification(Witness.SAME, difference)
    return Verification(
        Witness.HIGHER if change > 0 else Witness.LOWER, difference, max(-change, 0.0)
    )
