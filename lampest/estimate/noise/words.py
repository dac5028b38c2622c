"""What frames tell of their noise, in words."""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.hidden import BENDS, Possible

CROWDED = 0.05  # of the unloaded readings: where more leap, neighbours in time leap too and replace them badly


def said_of_factor(factor: float, error: float, used: float) -> str:
    """'unloaded frames scatter ...', where that contradicts the scene; ''."""
    if used == 1:
        return ""
    return (
        f"unloaded frames scatter {factor:.2g} +- {error:.1g} times as much as the scene says, "
        "and error bars are wider by that"
    )


def said_of_frames(gain: float, together: float, apart: float) -> list[str]:
    """What the readings of a frame share, in words; error bars hold it."""
    said = []
    if gain:
        said.append(f"the gain of a frame varies by {100 * gain:.2g} %")
    if together:
        said.append(f"the lines of a scan vary together by {together:.2g} LSB")
    if apart:
        said.append(f"the readings of a scanned line vary together by {apart:.2g} LSB")
    return [f"{', '.join(said)}, which error bars allow for"] if said else []


def said_of_outliers(outliers: NDArray[np.bool_], rate: float) -> str:
    """How many readings leap, and what became of them; ''."""
    count = int(outliers.sum())
    if count == 0:
        return ""
    text = f"{count} of {outliers.size} readings leap for one frame alone and were replaced by their neighbours in time"
    if rate <= CROWDED:
        return text
    return f"{text}; with {100 * rate:.2g} % of them there are more that nobody sees, and error bars do not hold them"


def said_of_sizes(hidden: Possible | None) -> list[str]:
    """How large hidden errors are taken to be once still cells were asked; [] where there are none."""
    if hidden is None:
        return []
    sizes = hidden.sizes
    own = f"each reading off by {100 * sizes.reading_error:.2g} %" if sizes.reading_error else "no reading's own error"
    parts, row = [], 0
    for name, unit, size, count in (
        ("series", "ohm", sizes.series_ohm, 1),
        ("curve", "LSB", sizes.inl_lsb, BENDS),
        ("wire", "ohm a cell", sizes.wire_ohm_per_cell, 2),
    ):
        if size:
            left = 1.0 if hidden.root is None else np.sqrt((hidden.root[row : row + count] ** 2).sum() / count)
            parts.append(f"{name} {size * left:.2g} {unit}")
            row += count
    return [f"{own}; left possible, as standard deviations: {', '.join(parts) or 'nothing else'}"]


def joined(said: list[str]) -> str:
    """One after the other, what is empty left out."""
    return "; ".join(part for part in said if part)
