"""Where a step of u = log r leads: straight, or along what is straight in the conductances g.

Cells that only their sum tells apart, beside shorts and between lines that touch, lie in a valley Σ g = const that is
narrow and, in u, bent. A straight step leaves it; Newton's method would follow it by hundreds of steps of a hundredth.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array

LONGEST_STEP = 2.5
BENT = 0.1  # of log r: a step that is shorter is the same in r and g but for a twentieth of itself
NO_CONDUCTANCE = 1e-12  # of a cell's own: beyond any bound


def ways(at: Evaluation, step: Array, moving: NDArray[np.bool_]) -> tuple[Array, ...]:
    """(cells) changes of u, the straight one first; later ones are for where those before do not lower the cost.

    In general straight in g: u − log(1 − p) for a step p. Where lines touch: along the sums of parallel cells, or,
    where no penalty says how a sum is shared and any share is as good, straight alone, so that shares stay near the
    start's.
    """
    straight = np.clip(step, -LONGEST_STEP, None)
    wiring = at.data.wiring
    group = None if wiring is None else wiring.side_by_side(at.data.measured.shape[1:])
    if group is not None:
        if all(term.reads_measurement for term in at.cost.terms):
            return (straight,)
        whole = (np.arange(len(at.data.measured))[:, None] * (1 + group.max()) + group).ravel()
        return (along_sums(at.position.ravel(), straight, moving, whole),)
    if np.abs(step).max(initial=0.0) < BENT:
        return (straight,)
    return straight, -np.log(np.maximum(1 - step, NO_CONDUCTANCE))


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
