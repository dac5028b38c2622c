"""Where two estimates differ by more than their error bars explain."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.runs.case import CaseResult


@dataclass(frozen=True, eq=False)
class Disagreement:
    """Two estimators of one recording; over the frames that both solved.

    difference : (frames, rows, columns) relative change of the first − second, percentage points; NaN elsewhere.
    significant : (frames, rows, columns). share : of the cells of these frames, percent.
    """

    first: str
    second: str
    difference: Array
    significant: NDArray[np.bool_]
    share: float


def disagreements(cases: Sequence[CaseResult]) -> tuple[Disagreement, ...]:
    """Every two cases with error bars that both solved something, those that disagree most first."""
    known = [
        case for case in cases if case.relative_change_lower is not None and case.relative_change_upper is not None
    ]
    found = [_disagreement(one, other) for one, other in combinations(known, 2) if np.any(one.solved & other.solved)]
    return tuple(sorted(found, key=lambda pair: -pair.share))


def _disagreement(one: CaseResult, other: CaseResult) -> Disagreement:
    """a − b is significant where its 95 % interval excludes zero: a − b > √((a − a_low)² + (b_high − b)²) for a > b.

    That is exact for independent normal errors. Both estimates rest on the same readings, so that their errors agree in
    part, and fewer than one cell in twenty is marked by chance. Source: Zou and Donner, Stat. Med. 27, 2008.
    """
    both = one.solved & other.solved
    difference = one.relative_change - other.relative_change
    with np.errstate(invalid="ignore"):
        above = np.where(difference > 0, _arm(one, False), _arm(one, True))
        below = np.where(difference > 0, _arm(other, True), _arm(other, False))
        significant: NDArray[np.bool_] = np.abs(difference) > np.hypot(above, below)
    return Disagreement(
        one.estimator, other.estimator, difference, significant, 100 * float(np.mean(significant[both]))
    )


def _arm(case: CaseResult, upward: bool) -> Array:
    """Distance from the estimate to the upper or lower end of its interval, percentage points, never negative."""
    assert case.relative_change_lower is not None and case.relative_change_upper is not None
    end = case.relative_change_upper if upward else case.relative_change_lower
    arm: Array = np.maximum((end - case.relative_change) * (1 if upward else -1), 0.0)
    return arm
