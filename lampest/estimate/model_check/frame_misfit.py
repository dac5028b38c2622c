"""What estimates leave of their readings, against the noise; penalties and bounds have their part in it."""

import numpy as np

from lampest.panel.panel import Array
from lampest.posterior.interval import chi_square_tail


def frame_misfit(model: Array, measured: Array, sigma: Array, resolution: Array | None) -> dict[str, Array]:
    """χ² = Σ ((model − measured)/σ)² of every frame, all (frames, rows, columns); σ is infinite where no value is.

    Gives, each (frames), NaN where a frame failed: chi_square; degrees_of_freedom = readings − tr A, A the averaging
    kernel with `resolution` on its diagonal, and tail = P(χ² ≥ chi_square), both NaN where that is unknown; worst_row
    and worst_column, the lines that hold most of it, and their shares.
    """
    squares = ((model - measured) / sigma) ** 2
    chi_square = squares.sum(axis=(1, 2))
    readings = np.isfinite(sigma).sum(axis=(1, 2))
    followed = np.full(len(model), np.nan) if resolution is None else resolution.sum(axis=(1, 2))
    degrees = np.where(np.isnan(chi_square), np.nan, np.maximum(readings - followed, 1.0))
    found = {"chi_square": chi_square, "degrees_of_freedom": degrees, "tail": chi_square_tail(chi_square, degrees)}
    for name, lines in (("row", squares.sum(axis=2)), ("column", squares.sum(axis=1))):
        solved = ~np.isnan(chi_square)
        worst = np.where(solved, np.argmax(lines, axis=1), np.nan)
        share = lines.max(axis=1) / np.where(chi_square > 0, chi_square, 1.0)
        found |= {f"worst_{name}": worst, f"worst_{name}_share": share}
    return found
