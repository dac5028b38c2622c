"""What may be wrong with a column's values: the end of a sentence that begins with their path, or None."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

Solved = NDArray[np.bool_]  # (frames)
Check = Callable[[Any, Solved], str | None]


def finite(values: Array, solved: Solved) -> str | None:
    """Every value is a number."""
    return None if np.all(np.isfinite(values)) else "must be finite"


def positive(values: Array, solved: Solved) -> str | None:
    """Every value is a number above zero."""
    return None if np.all(np.isfinite(values) & (values > 0)) else "must be positive and finite everywhere"


def positive_or_missing(values: Array, solved: Solved) -> str | None:
    """Every value is a number above zero, or NaN."""
    fine = np.isnan(values) | (np.isfinite(values) & (values > 0))
    return None if np.all(fine) else "must be positive and finite, or NaN"


def positive_or_infinite(values: Array, solved: Solved) -> str | None:
    """Every value is above zero."""
    return None if np.all(values > 0) else "must be positive everywhere"


def numbers_if_solved(values: Array, solved: Solved) -> str | None:
    """(frames, ...): numbers where a frame was solved, NaN where it failed."""
    frames = np.asarray(values).reshape(len(solved), -1)
    right = np.where(solved, np.isfinite(frames).all(axis=1), np.isnan(frames).all(axis=1))
    return None if np.all(right) else "must be numbers where solved is 1, and NaN elsewhere"


def whole_frames_if_solved(values: Array, solved: Solved) -> str | None:
    """(frames, ...): NaN where a frame failed; else all of it numbers, or none where there is no baseline."""
    frames = np.asarray(values).reshape(len(solved), -1)
    missing = np.isnan(frames).all(axis=1)
    right = missing | (solved & np.isfinite(frames).all(axis=1))
    return None if np.all(right) else "must be numbers or NaN throughout where solved is 1, and NaN elsewhere"


def told_if_solved(values: Array, solved: Solved) -> str | None:
    """(frames, ...): numbers or infinite where a frame was solved, NaN where it failed."""
    missing = np.isnan(np.asarray(values).reshape(len(solved), -1))
    right = np.where(solved, ~missing.any(axis=1), missing.all(axis=1))
    return None if np.all(right) else "must be NaN where solved is 0, only"


def not_negative(values: Array, solved: Solved) -> str | None:
    """No value is below zero."""
    return "must not be negative" if np.any(values < 0) else None


def not_zero_or_less(values: Array, solved: Solved) -> str | None:
    """No value is zero or below."""
    return "must be positive" if np.any(values <= 0) else None
