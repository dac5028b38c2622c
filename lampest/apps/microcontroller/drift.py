"""Time constant with which a board's baseline follows the drift of a recording's cells."""

import numpy as np

from lampest.panel.panel import Array
from lampest.runs.case import CaseResult

# Frames. The shortest one averages over enough frames for a quarter of their noise, the longest one
# makes up a drift of 20 % in 2,000 frames to 1.3 %.
CANDIDATES = (8, 16, 32, 64, 128)
MIN_FRAMES = 8  # unloaded ones; fewer show no drift
MAX_EXCESS = 1.05  # mean square of the prediction's error, relative to the best candidate


def frames_to_follow(case: CaseResult, loaded_limit: float) -> float:
    """Return the time constant of the baseline in frames, as `lampest_follow` takes it.

    The exponential mean b ← b + (x − b)/T of ln r predicts the next unloaded frame x. The longest
    of CANDIDATES that predicts about as well as the best one is taken, and the longest of all where
    fewer than MIN_FRAMES frames are unloaded.

    Parameters
    ----------
    case : CaseResult
    loaded_limit : float
        ln r. A frame with a cell that lies further below the median change is loaded.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.log(case.cell_resistance / case.baseline_resistance)[case.solved]
    flat = change.reshape(len(change), -1)
    flat = flat[:, np.isfinite(flat).all(axis=0)]
    if not flat.size:
        return float(max(CANDIDATES))
    errors = {frames: _prediction_error(flat, 1 / frames, loaded_limit) for frames in CANDIDATES}
    largest = MAX_EXCESS * min(errors.values())
    return float(max(frames for frames, error in errors.items() if error <= largest))


def _prediction_error(change: Array, share: float, loaded_limit: float) -> float:
    """Return the mean square by which unloaded frames (frames, cells) differ from the baseline.

    Fewer than MIN_FRAMES unloaded frames give infinity.
    """
    baseline = np.zeros(change.shape[1])
    squares = []
    for frame in change:
        deviation = frame - baseline
        if deviation.min() < np.median(deviation) - loaded_limit:
            continue
        squares.append(float(np.median(deviation**2)))
        baseline = baseline + share * deviation
    return float(np.mean(squares)) if len(squares) >= MIN_FRAMES else np.inf
