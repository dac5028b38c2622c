"""Whether something is on the panel, in a word: by its readings' noise, without recognising what it is."""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.recording.readings import Readings

NOTHING, PRESSING, SUCKING, BOTH, UNSOLVED = VERDICTS = (
    "nothing",
    "pressing",
    "sucking",
    "pressing and sucking",
    "unsolved",
)
# Standard deviations that one reading of 100 passes by chance about twice in 10⁷ frames of normal noise: four days at
# 30 frames a second have 10⁷.
NOTICED = 6.0
NOTICED_PERCENT = 1.0  # where the noise is unknown: far above that of any readout here, and what a finger does
SHARE = 0.3  # of the strongest |ln r/r₀|: what penalties leave beside a load stays below, a mouth's inside lies above


def verdict_of(readings: Readings, resting: Readings, ratio: Array, open_cell: NDArray[np.bool_]) -> str:
    """One of VERDICTS of a frame that was solved.

    Nothing where no reading differs from its unloaded value by more than six standard deviations of the difference,
    the median of all differences left aside, which a drift of the supply moves; else pressing where the lowest
    ln r/r₀, and sucking where the highest, is more than three tenths of the strongest. ratio : r/r₀ (rows, columns).
    open_cell : (rows, columns) where a cell cannot be told from an open one, which do not count.
    """
    moved = np.log(readings.shown / resting.shown)
    moved -= np.nanmedian(moved)
    noise = _relative_noise(readings, resting)
    with np.errstate(invalid="ignore"):
        noticed = np.abs(moved) > (NOTICED_PERCENT / 100 if noise is None else NOTICED * noise)
    if not np.any(noticed):
        return NOTHING
    change = np.log(ratio[~open_cell & np.isfinite(ratio)])
    if not change.size:
        return NOTHING
    strongest = float(np.max(np.abs(change)))
    pressing, sucking = (float(np.max(sign * change)) > SHARE * strongest for sign in (-1, 1))
    if pressing and sucking:
        return BOTH
    return SUCKING if sucking else PRESSING


def _relative_noise(readings: Readings, resting: Readings) -> Array | None:
    """Standard deviation of ln(y/y₀) (rows, columns), infinite where a reading is a bound; None where it is unknown."""
    now, before = readings.sigma_of_values, resting.sigma_of_values
    if now is None or before is None:
        return None
    return np.asarray(np.hypot(now / readings.shown, before / resting.shown))
