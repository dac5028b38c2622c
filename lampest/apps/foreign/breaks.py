"""Frames of files without marks between them: lines that are lost or doubled, and cut frames.

The rows of a panel differ from each other more than a row differs from itself a frame later. Where
s lines are too many (or too few, s < 0), the lines x before have their equals s lines farther on:

    D_s(b) = Σ_l |x_(l + rows + s) − x_l|,   l over the lines of one frame before the break b

is small there, and D_0 is large. Where a load changes, both are large.
"""

from typing import NamedTuple

import numpy as np

from lampest.panel.panel import Array

MIN_FRAMES = 4  # fewer show nothing: they are taken from the first line on
MAX_SHIFT = 3  # lines too many or too few at one place
MIN_LIKENESS = 1.5  # D_0/D_s at a break; without one the film makes it less than 1
MAX_MISFIT = 0.98  # mean distance from the rows' medians, over that without breaks
MIN_STEP = 3.0  # times the second largest step between neighbouring lines: the end of a frame


class Break(NamedTuple):
    """Lines too many (positive) or too few at a place, which is between two lines."""

    first: int
    last: int
    shift: int


def whole_parts(values: Array, rows: int) -> list[range] | None:
    """Return the parts of whole frames in lines without marks, (lines, columns).

    The parts are lines between breaks; the last one may end with a cut frame. None if the lines are
    no whole number of frames, and the readings do not show why.
    """
    values = np.where(np.isinf(values), np.nan, values)
    surplus = len(values) % rows
    breaks = _breaks(values, rows)
    if sum(place.shift for place in breaks) % rows != surplus:  # they do not account for all lines
        alone = [place for place in breaks if place.shift % rows == surplus]
        if surplus == 0 or len(values) < MIN_FRAMES * rows:
            breaks = []
        elif len(alone) == 1:
            breaks = alone
        elif breaks:
            return None
        else:
            # The first whole frame begins at the largest step between lines: the last row and the
            # first one of the next frame are no neighbours.
            steps = _distances(values, 1)
            usual = np.array([np.median(steps[(row - 1) % rows :: rows]) for row in range(rows)])
            order = np.argsort(usual)
            clear = rows > 2 and usual[order[-1]] > MIN_STEP * usual[order[-2]]
            return [range(int(order[-1]), len(values))] if clear else None
    # Whole frames stand between the breaks.
    parts = list[range]()
    begin = 0
    displacement = 0
    for first, last, shift in breaks:
        displacement += shift
        parts.append(range(begin, max(begin + (first - begin) // rows * rows, begin)))
        begin = last + max(shift, 0)
        begin += (displacement - begin) % rows
    parts = [*parts, range(begin, len(values))]
    plain = [range(len(values))]
    if not breaks or _misfit(values, rows, parts) < MAX_MISFIT * _misfit(values, rows, plain):
        return parts
    return None if surplus else plain


def _misfit(values: Array, rows: int, parts: list[range]) -> float:
    """Return the mean distance of all lines of whole frames from the median of their row."""
    frames = np.concatenate(
        [
            values[part[: len(part) // rows * rows]].reshape(-1, rows, values.shape[1])
            for part in parts
        ]
    )
    return float(np.nan_to_num(np.abs(frames - np.median(frames, axis=0))).mean())


def _breaks(values: Array, rows: int) -> list[Break]:
    """Return the breaks that the lines show, in their order."""
    found = list[tuple[float, Break]]()
    own = _distances(values, rows)
    most = min(MAX_SHIFT, rows // 3) if len(values) >= MIN_FRAMES * rows else 0
    for shift in (*range(-most, 0), *range(1, most + 1)):
        length = rows + min(shift, 0)  # lines of a frame whose equals stand behind the break
        other = _distances(values, rows + shift)
        size = min(len(own), len(other))
        before, after = (_sums(distances[:size], length) for distances in (own, other))
        contrast = np.where(before > MIN_LIKENESS * after, before - after, 0.0)
        while contrast.any():
            at = int(np.argmax(contrast))
            near = slice(max(at - rows, 0), at + rows + 1)
            # Places at which no line, but for one that is like its neighbour, speaks against it.
            likely = near.start + np.flatnonzero(contrast[near] >= (1 - 1 / rows) * contrast[at])
            place = Break(int(likely[0]) + length, int(likely[-1]) + length, shift)
            found.append((float(contrast[at]) / length, place))
            contrast[max(at - 2 * rows, 0) : at + 2 * rows + 1] = 0.0
    chosen = list[Break]()
    for _, place in sorted(found, reverse=True):
        if all(abs(place.first - other.first) >= 2 * rows for other in chosen):
            chosen.append(place)
    return sorted(chosen)


def _distances(values: Array, lag: int) -> Array:
    """Return the mean distance of each line from the one `lag` lines later; missing ones have 0."""
    return np.asarray(np.nan_to_num(np.abs(values[lag:] - values[:-lag])).mean(axis=1))


def _sums(values: Array, length: int) -> Array:
    """Return the sums of `length` successive values."""
    total = np.cumsum(np.concatenate([[0.0], values]))
    return np.asarray(total[length:] - total[:-length])
