"""Recognition of readings that firmware has changed.

The changes are a subtracted baseline, a threshold, a scale of its own. The circuit relates readings
of all cells to each other. What was subtracted, clipped or scaled before they were sent no longer
satisfies it, and nothing computed from them is right.
"""

import numpy as np

from lampest.panel.panel import Array, Mask

ZERO_SHARE = 0.5  # of the resting readings exactly at 0: noise about 0 is clipped at half of them
NEGATIVE_SHARE = 0.05  # of all readings; single ones are marks of a failed conversion
# Codes between 0 and the next reading; noise and small loads fill them in readings as converted.
MIN_THRESHOLD = 8
MIN_READINGS = 50  # of a file; with fewer, empty codes and zeros are chance
AS_CONVERTED = (
    "send what the converter gives (analogRead), without subtraction, threshold, scale or filter"
)
OPEN_CELLS = (
    "if all cells are open at rest and nothing is subtracted, say baseline: raw in the scene"
)


def processing_of(codes: Array, resting: Mask, present: Mask, lowest: float = 0.0) -> str:
    """Return a sentence on the processing of readings by firmware, and on the remedy.

    The sentence is '' if no processing is evident.

    Parameters
    ----------
    codes : array, shape (frames, rows, columns)
        Codes of the converter, NaN where missing; any other number that is proportional to the
        voltage.
    resting : boolean array, shape (frames,)
        Unloaded frames.
    present : boolean array, shape (rows, columns)
        Crossings with a cell.
    lowest : float
        Lowest code that the converter gives.
    """
    read = codes[:, present]
    known = np.isfinite(read)
    if known.sum() < MIN_READINGS:
        return ""
    if np.sum(read < lowest) > NEGATIVE_SHARE * known.sum():
        return (
            f"codes below {lowest:g}, down to {np.nanmin(read):g}: "
            f"the firmware subtracts a resting frame; {AS_CONVERTED}"
        )
    zero = read == 0
    above = read[known & ~zero]
    if resting.any() and known[resting].any():
        share = zero[resting].sum() / known[resting].sum()
        if share > ZERO_SHARE:
            return (
                f"{100 * share:.0f} % of the unloaded readings are exactly 0: "
                "the firmware subtracts a resting frame and clips at 0, or has a threshold; "
                f"{AS_CONVERTED}; {OPEN_CELLS}"
            )
    if above.size and zero.sum() > ZERO_SHARE * known.sum() and above.min() >= MIN_THRESHOLD:
        return (
            f"{100 * zero.sum() / known.sum():.0f} % of the readings are exactly 0, "
            f"and none lies between 0 and {above.min():g}: "
            f"the firmware has a threshold; {AS_CONVERTED}; {OPEN_CELLS}"
        )
    return ""


def normalised(values: Array, full_scale_volt: float) -> str:
    """Return a sentence for voltages that are shares of their range, '' for others.

    Shares of a range are values from exactly 0 to exactly 1.
    """
    known = values[np.isfinite(values)]
    if (
        known.size >= MIN_READINGS
        and known.min() == 0
        and known.max() == 1
        and full_scale_volt != 1
    ):
        return (
            "readings from exactly 0 to exactly 1 are scaled to some range, not in volt; "
            f"{AS_CONVERTED}"
        )
    return ""


def restored(values: Array, resting: Array) -> Array:
    """Return readings with their subtracted resting frame added again, (frames, rows, columns).

    Readings are exact where nothing was clipped. If no value is negative, a reading of 0 may have
    been clipped: it says nothing, and is NaN.
    """
    clipped = (values == 0) & ~np.any(values < 0)
    return np.where(clipped, np.nan, values + resting)
