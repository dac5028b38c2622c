"""Whether the cost really falls where its second derivatives bend down."""

from collections.abc import Iterator

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array

LENGTHS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of log r, of the cell that moves most
STILL = 1e-12  # of the cost's scale: what falls by less is its rounding


def downhill(at: Evaluation, along: Array) -> Evaluation | None:
    """A point from u forth or back along a direction (cells) where the cost is lower; None where there is none."""
    least = settled(at) - STILL * at.cost_scale
    return next((one for one in _beside(at, along) if settled(one) < least), None)


def settled(at: Evaluation) -> float:
    """φ without what absolute losses hold of residuals that are zero but for their last bits."""
    if not len(at.rough):
        return at.objective
    return at.objective - float(np.sum(at.cost.slope * np.minimum(np.abs(at.rough), at.last_bits)))


def stepped(at: Evaluation, step: Array) -> Evaluation | None:
    """The cost after a step of u (cells), within the bounds; None where the network cannot be solved."""
    cells = np.exp(at.position + step.reshape(at.position.shape))
    try:
        return at.elsewhere(np.clip(cells, at.data.lower, at.data.upper))
    except np.linalg.LinAlgError:
        return None


def _beside(at: Evaluation, along: Array) -> Iterator[Evaluation]:
    size = float(np.abs(along).max(initial=0.0)) or 1.0
    steps = (sign * length / size * along for length in LENGTHS for sign in (1.0, -1.0))
    yield from (there for step in steps if (there := stepped(at, step)) is not None)
