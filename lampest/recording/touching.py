"""Lines that seem to touch each other: two rows that are one node are read alike by every column, and no others are."""

import numpy as np
import scipy

from lampest.panel.panel import Panel
from lampest.recording.readings import Readings


def touching_rows(readings: Readings) -> tuple[tuple[int, ...], ...]:
    """Groups of rows that are read alike in all frames (frames, rows, columns); none where the noise is unknown."""
    sigma, rows = readings.sigma_of_values, readings.value.shape[-2]
    if sigma is None:
        return ()
    Panel(rows, 1).check_memory()
    value, noise = (part.swapaxes(-1, -2).reshape(-1, rows) for part in (readings.value, sigma))
    unlike, count = np.zeros((rows, rows)), np.zeros((rows, rows), dtype=np.intp)
    for row in range(rows):  # mean square difference from every other in units of their noise, of how many readings
        spread = np.hypot(noise[:, [row]], noise)
        plain = np.isfinite(spread)
        square = np.where(plain, (value[:, [row]] - value) / np.where(plain, spread, 1.0), 0.0) ** 2
        count[row] = plain.sum(axis=0)
        unlike[row] = square.sum(axis=0) / np.maximum(count[row], 1)
    # Standard deviations of the mean of squares.
    alike = (unlike <= 1 + 4 * np.sqrt(2 / np.maximum(count, 1))) & (count >= 4)  # readings of two lines
    others = np.where(alike | (count < 4), np.nan, unlike)
    with np.errstate(invalid="ignore"):
        # Mean square difference in σ from which other lines count as unlike.
        distinct = np.array([np.nanmedian(row) if np.any(row > 0) else 0.0 for row in others]) > 25
    groups, group = scipy.sparse.csgraph.connected_components(alike & distinct & distinct[:, None], directed=False)
    members = (np.flatnonzero(group == number) for number in range(groups))
    return tuple(tuple(found.tolist()) for found in members if len(found) > 1)


def touching_columns(readings: Readings) -> tuple[tuple[int, ...], ...]:
    """The same of columns."""
    return touching_rows(readings.each(lambda part: part.swapaxes(-1, -2)))
