"""Prediction of a frame's readings from the frames around it, for all judgements of readings."""

from collections.abc import Callable

import numpy as np

from lampest.files.levels import MAD_TO_SIGMA
from lampest.panel.panel import Array, Numbers
from lampest.recording.readings import median

WINDOW = 4  # neighbouring frames that are compared
# Deviation over the scatter of the neighbours, so that an arriving load is not flagged.
MIN_RATIO_TO_SCATTER = 3.0

# (prediction from the neighbours in time, its standard deviation by their scatter, standard
# deviation of the deviation by noise alone as a multiple of σ).
Expected = tuple[Array, Array, Array]
# arguments: the neighbours, and their offsets in frames
Predictor = Callable[[Array, Numbers], Expected]


def first_of_windows(frames: int) -> Numbers:
    """Return the first frame of the window of WINDOW + 1 frames about each frame, (frames,)."""
    width = min(frames, WINDOW + 1)
    return np.clip(np.arange(frames) - WINDOW // 2, 0, frames - width)


def from_window(value: Array, first: Numbers, place: Numbers, predict: Predictor) -> Expected:
    """Return the prediction of frames first + place from the other frames of their window.

    The window of a prediction begins at `first`. The neighbours are gathered as (width − 1, frames,
    ...), with their offsets (width − 1, frames).
    """
    width = min(len(value), WINDOW + 1)
    within = first[:, None] + np.arange(width)
    target = first + place
    nearest = within[within != target[:, None]].reshape(len(first), width - 1).T
    return predict(value[nearest], nearest - target)


def by_median(neighbours: Array, offset: Numbers | None = None) -> Expected:
    """Return the median of the neighbours, (frames, …), with their scatter.

    Parameters
    ----------
    neighbours : array, shape (neighbours, frames, …)
    offset : integer array
        Not used.
    """
    middle = median(neighbours)[0]
    # var(y − median of n) = σ² (1 + π/(2n))
    noise = np.sqrt(1 + np.pi / (2 * len(neighbours)))
    return (
        middle,
        MAD_TO_SIGMA * median(np.abs(neighbours - middle))[0],
        np.full(middle.shape, noise),
    )
