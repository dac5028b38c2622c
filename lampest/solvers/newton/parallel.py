"""Steps of cells that are parallel, because lines touch: along the sum of their conductances, which readings decide.

Any shares of one sum give the same readings, so the cost has a valley along Σ g = const, narrow and, in u = log r,
bent. A straight step leaves it by half the variance of the group's steps; Newton's method would follow it by hundreds
of steps of a hundredth. So the sum is put where the step has it to first order, and the shares where the step has them.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array


def groups_of(at: Evaluation) -> NDArray[np.intp] | None:
    """(frames · cells) the number of the group that every cell is parallel in.

    None where none is parallel, or no penalty says how a sum is shared: then the shares stay near the start's.
    """
    frames, *shape = at.data.measured.shape
    group = None if at.data.wiring is None else at.data.wiring.side_by_side(tuple(shape))
    if group is None or all(term.reads_measurement for term in at.cost.terms):
        return None
    return np.asarray((np.arange(frames)[:, None] * (1 + group.max()) + group).ravel())


def along_sums(position: Array, step: Array, moving: NDArray[np.bool_], group: NDArray[np.intp]) -> Array:
    """s + δ with Σ g·exp(−s − δ) = Σ g·exp(−Σ g s/Σ g), δ one number for the moving cells of a group; in u = log r.

    No δ where the other cells alone have more than that sum.
    """
    conductance = np.exp(-position)
    share = conductance / np.bincount(group, conductance)[group]
    moved = share * np.exp(-step)
    left = np.exp(-np.bincount(group, share * step)) - np.bincount(group, moved * ~moving)
    free = np.bincount(group, moved * moving)
    both = (free > 0) & (left > 0)
    beside = np.log(np.where(both, free, 1.0) / np.where(both, left, 1.0))
    return np.asarray(step + moving * beside[group])
