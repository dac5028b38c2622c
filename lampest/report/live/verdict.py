"""Whether something is on the panel, in a word: by its readings' noise, without recognising what it is."""

import numpy as np

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
SHARE = 0.1  # of all that presses and sucks; less of either is not worth a word


def verdict_of(readings: Readings, resting: Readings, pressure: Array) -> str:
    """One of VERDICTS of a frame that was solved.

    Nothing where no reading differs from its unloaded value by more than six standard deviations of the difference,
    the median of all differences left aside, which a drift of the supply moves; else what presses or sucks by
    Σ p of each sign over Σ |p|. pressure : (rows, columns) kPa.
    """
    moved = np.log(readings.shown / resting.shown)
    moved -= np.nanmedian(moved)
    noise = _relative_noise(readings, resting)
    with np.errstate(invalid="ignore"):
        noticed = np.abs(moved) > (NOTICED_PERCENT / 100 if noise is None else NOTICED * noise)
    if not np.any(noticed):
        return NOTHING
    every = float(np.nansum(np.abs(pressure)))
    pressing, sucking = (float(np.nansum(np.maximum(sign * pressure, 0))) > SHARE * every for sign in (1, -1))
    if pressing and sucking:
        return BOTH
    return SUCKING if sucking else PRESSING


def _relative_noise(readings: Readings, resting: Readings) -> Array | None:
    """Standard deviation of ln(y/y₀) (rows, columns), infinite where a reading is a bound; None where it is unknown."""
    now, before = readings.sigma_of_values, resting.sigma_of_values
    if now is None or before is None:
        return None
    return np.asarray(np.hypot(now / readings.shown, before / resting.shown))
