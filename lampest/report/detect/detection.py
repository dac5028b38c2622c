"""What was seen in a recording, frame by frame."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.loads import RING, ROD, Round
from lampest.loads.recognition.verdict import KINDS, Verdict
from lampest.panel.panel import Array

NOT_SOLVED = "not solved"


class Quantity(NamedTuple):
    """A number of a load as files and tables name it."""

    name: str
    units: str
    long_name: str


QUANTITIES = (
    Quantity("centre_x", "mm", "centre of the load across the columns, column 0 at 0"),
    Quantity("centre_y", "mm", "centre of the load across the rows, row 0 at 0"),
    Quantity("diameter", "mm", "outer diameter of the load; of a mouth over its rim"),
    Quantity("rim_width", "mm", "width of the rim"),
    Quantity("inner_pressure", "kPa", "pressure inside the rim against the surroundings; suction is negative"),
    Quantity("rim_pressure", "kPa", "mean contact pressure under the rim, or under a rod"),
)
# (x, y, d, w, s, p) from the numbers of a disc.
CHOICE = np.zeros((6, 8))
CHOICE[[0, 1, 2, 3, 4, 5], [0, 1, 2, 2, 4, 5]] = 1, 1, 1, 0.5, 1, 1
CHOICE[3, 3] = -0.5


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
    """(values, errors) of the most probable load, (quantities); NaN for what it has none of."""
    nothing = np.full(len(QUANTITIES), np.nan)
    fit = None if verdict is None else verdict.best
    if fit is None or not isinstance(fit.candidate, Round):
        return nothing, nothing
    kind = fit.candidate
    disc, slopes = kind.disc(fit.parameters)
    choice = CHOICE.copy()
    choice[3:5] *= np.nan if kind is ROD else 1.0
    choice[4] *= np.nan if kind is RING else 1.0
    spread = choice @ slopes
    return choice @ np.array(disc), np.sqrt(np.einsum("qi,ij,qj->q", spread, fit.covariance, spread))
