"""What loads a panel in one frame: pressures, total force, and whether something presses or sucks."""

import numpy as np
from numpy.typing import NDArray

from lampest.loads.force import Force, pressing_cells, total_force
from lampest.loads.pressure import Pressure, PressureTrack
from lampest.panel.panel import Array
from lampest.posterior.track import Bars
from lampest.recording.readings import Readings
from lampest.report.live.message import BOTH, NOTHING, PRESSING, SUCKING

# Standard deviations that one reading of 100 passes by chance about twice in 10⁷ frames of normal noise: four days at
# 30 frames a second have 10⁷.
NOTICED = 6.0
NOTICED_PERCENT = 1.0  # where the noise is unknown: far above that of any readout here, and what a finger does
SHARE = 0.3  # of the strongest |ln r/r₀|: what penalties leave beside a load stays below, a mouth's inside lies above


def read_load(load: PressureTrack, ratio: Array, bars: Bars | None, time: float) -> tuple[Pressure | None, Force]:
    """Pressures of a frame's cells, and their total force; none where the scene names no response.

    The estimate's own errors do not decide which cells are saturated. ratio : r/r_baseline (rows, columns).
    bars : of the estimate, or None. time : s.
    """
    if load.scene.response is None:
        return None, Force(np.nan, np.nan)
    found, errors, deviation = load.pressure(ratio, ratio, ratio, time), None, None
    if bars is not None and bars.change is not None:
        with np.errstate(over="ignore"):
            ends = ratio * np.exp(-bars.change.below), ratio * np.exp(bars.change.above)
            errors, deviation = load.pressure(ratio, *ends, time).errors, ratio * bars.change.deviation
    pressed = pressing_cells(load.scene, ratio, deviation, found.pressure)
    return found, total_force(load.scene, found.pressure, pressed, found.saturated != 0, errors)


def verdict_of(readings: Readings, resting: Readings, ratio: Array, open_cell: NDArray[np.bool_]) -> str:
    """One of `message.VERDICTS` of a frame that was solved.

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
    change = np.log(ratio[~open_cell & np.isfinite(ratio)])
    if not np.any(noticed) or not change.size:
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
