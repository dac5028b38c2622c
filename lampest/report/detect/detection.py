"""What was seen in a recording, frame by frame."""

from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.candidates import KINDS, LOADS, Several
from lampest.loads.recognition.detector import MOST_AT_ONCE
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.verdict import Verdict, further
from lampest.loads.shapes.round import QUANTITIES as DISC_QUANTITIES
from lampest.panel.panel import Array

NOT_SOLVED = "not solved"
PLACE = 0.25


# Those of a disc first, in their order; then what other shapes report beside them.
QUANTITIES = tuple(dict.fromkeys((*DISC_QUANTITIES, *(quantity for load in LOADS for quantity in load.quantities))))


@dataclass(frozen=True, eq=False)
class Detection:
    """One recording as one estimate of it, or the readings themselves, show it.

    Parameters
    ----------
    recording, source : the recording's name, and the estimator's, or `runs.case.SHARED` for the readings themselves.
    frame, time : (frames) index into the recording, and s.
    labels : (frames) what the frame may be called. probabilities : (frames, kinds) in the order of KINDS.
    values, errors : (frames, quantities) and their standard deviations; NaN where there is no such load or number.
    further : the same for the second load and the third, where several are there at once. count : (frames) of loads.
    goodness : (frames) χ² per reading of the most probable candidate; NaN where the frame was not solved.
    tared : (frames) why the unloaded panel was taken anew after a frame; '' where it was not.
    """

    recording: str
    source: str
    frame: NDArray[np.int64]
    time: Array
    labels: tuple[str, ...]
    probabilities: Array
    values: Array
    errors: Array
    further: tuple[tuple[Array, Array], ...]
    count: NDArray[np.int64]
    goodness: Array
    tared: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        recording: str,
        source: str,
        frame: NDArray[np.int64],
        time: Array,
        verdicts: tuple[Verdict | None, ...],
        tared: tuple[str, ...] = (),
    ) -> "Detection":
        """From the verdicts on all frames; None where a frame was not solved."""
        numbers = [numbers_of(verdict) for verdict in verdicts]
        unknown = np.full(len(KINDS), np.nan)
        return cls(
            recording,
            source,
            frame,
            time,
            tuple(NOT_SOLVED if verdict is None else verdict.label for verdict in verdicts),
            np.array([unknown if verdict is None else verdict.probabilities for verdict in verdicts]),
            np.array([values for values, _ in numbers]),
            np.array([errors for _, errors in numbers]),
            tuple(_further(verdicts, number) for number in range(1, MOST_AT_ONCE)),
            np.array([_count(verdict) for verdict in verdicts]),
            np.array([np.nan if verdict is None else verdict.goodness for verdict in verdicts]),
            tared or ("",) * len(verdicts),
        )


def _further(verdicts: tuple[Verdict | None, ...], number: int) -> tuple[Array, Array]:
    """(values, errors) of the load with that number, (frames, quantities)."""
    both = [numbers_of(verdict, number) for verdict in verdicts]
    return np.array([values for values, _ in both]), np.array([errors for _, errors in both])


def _count(verdict: Verdict | None) -> int:
    """How many loads the most probable candidate has; 0 where there is none or nobody knows which."""
    if verdict is None or verdict.best not in verdict.loads:
        return 0
    return 1 + further(verdict.best.candidate)


def numbers_of(verdict: Verdict | None, number: int = 0) -> tuple[Array, Array]:
    """(values, errors) of one load of the most probable candidate, (quantities); NaN for what it has none of.

    Of a single load Σ P v, and √(Σ P (σ² + v²) − (Σ P v)²), over all single loads in its place that have the quantity:
    what is a cup or a mouth is as large as either may be.
    """
    values, errors = np.full((2, len(QUANTITIES)), np.nan)
    if verdict is None or number > further(verdict.best.candidate):
        return values, errors
    best = _reported(verdict.best, number)
    if isinstance(verdict.best.candidate, Several):
        return best
    weights = np.array([_in_place(fit, verdict.best) for fit in verdict.fits]) * verdict.shares
    each = np.array([_reported(fit) for fit in verdict.fits])
    known = np.isfinite(each[:, 0]) * np.isfinite(best[0]) * weights[:, None]
    total = known.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = np.nansum(known * each[:, 0], axis=0) / total
        square = np.nansum(known * (each[:, 1] ** 2 + (each[:, 0] - mean) ** 2), axis=0) / total
    return np.where(total > 0, mean, values), np.where(total > 0, np.sqrt(square), errors)


def _in_place(fit: Fit, best: Fit) -> bool:
    """Whether a fit is one load where the best one is, within PLACE of its diameter."""
    if fit is best or isinstance(fit.candidate, Several):
        return fit is best
    one, other = fit.candidate.disc(fit.parameters), best.candidate.disc(best.parameters)
    if one is None or other is None:
        return False
    return hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm) < PLACE * other.diameter_mm


def _reported(fit: Fit, number: int = 0) -> tuple[Array, Array]:
    """(values, errors) of one load of a fit, (quantities); NaN for what it has none of."""
    values, errors = np.full((2, len(QUANTITIES)), np.nan)
    one, (found, slopes) = fit.candidate, fit.candidate.report(fit.parameters)
    if isinstance(fit.candidate, Several):
        one, (found, slopes) = fit.candidate.parts[number], fit.candidate.of_part(number, fit.parameters)
    columns = [QUANTITIES.index(quantity) for quantity in one.quantities]
    values[columns], errors[columns] = found, np.sqrt(np.einsum("qi,ij,qj->q", slopes, fit.covariance, slopes))
    return values, errors
