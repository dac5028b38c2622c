"""What was seen in a recording, frame by frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.candidates import KINDS, LOADS
from lampest.loads.recognition.verdict import Verdict
from lampest.loads.shapes.round import QUANTITIES as DISC_QUANTITIES
from lampest.panel.panel import Array

NOT_SOLVED = "not solved"


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
    goodness : (frames) χ² per reading of the most probable candidate; NaN where the frame was not solved.
    """

    recording: str
    source: str
    frame: NDArray[np.int64]
    time: Array
    labels: tuple[str, ...]
    probabilities: Array
    values: Array
    errors: Array
    goodness: Array

    @classmethod
    def of(
        cls, recording: str, source: str, frame: NDArray[np.int64], time: Array, verdicts: tuple[Verdict | None, ...]
    ) -> "Detection":
        """From the verdicts on all frames; None where a frame was not solved."""
        numbers = [_numbers(verdict) for verdict in verdicts]
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
            np.array([np.nan if verdict is None else verdict.goodness for verdict in verdicts]),
        )


def _numbers(verdict: Verdict | None) -> tuple[Array, Array]:
    """(values, errors) of the most probable candidate, (quantities); NaN for what it has none of."""
    values, errors = np.full((2, len(QUANTITIES)), np.nan)
    if verdict is not None:
        fit = verdict.best
        columns = [QUANTITIES.index(quantity) for quantity in fit.candidate.quantities]
        values[columns], slopes = fit.candidate.report(fit.parameters)
        errors[columns] = np.sqrt(np.einsum("qi,ij,qj->q", slopes, fit.covariance, slopes))
    return values, errors
