"""Error bars along a sequence: of every frame, and of its change against the baseline."""

from dataclasses import dataclass

import numpy as np

from lampest.panel import Array
from lampest.posterior.certainty import Certainty
from lampest.posterior.dense import DenseErrors, DenseMemory
from lampest.posterior.interval import TWO_SIDED
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SampledErrors, SampledMemory

MOST_DENSE = 1200  # unknowns; from there on samples are faster


@dataclass(frozen=True, eq=False)
class Change:
    """Of log r − log r_baseline: standard deviation, and how far the 95 % interval reaches down and up; any shape."""

    deviation: Array
    below: Array
    above: Array

    @classmethod
    def between(cls, frame: Certainty, baseline: Certainty, shared: Array) -> "Change":
        """√(a² + b² − 2·shared), ends apart; shared : covariance of the two errors, (rows, columns)."""

        def joined(one: Array, other: Array, shared: Array) -> Array:
            with np.errstate(invalid="ignore"):
                size: Array = np.sqrt(np.maximum(one**2 + other**2 - 2 * shared, 0))
            return size

        ends = TWO_SIDED**2 * shared
        return cls(
            joined(frame.deviation, baseline.deviation, shared),
            joined(frame.below, baseline.above, ends),
            joined(frame.above, baseline.below, ends),
        )


@dataclass(frozen=True, eq=False)
class Bars:
    """One frame's error bars, all (rows, columns). change : None where the baseline's are not known."""

    frame: Certainty
    change: Change | None


@dataclass(frozen=True, eq=False)
class Track:
    """What error bars of later frames need of earlier ones.

    baseline : of the baseline, (rows, columns). memory : of the last frame's error, for costs that look back at it.
    """

    baseline: Certainty | None = None
    memory: DenseMemory | SampledMemory | None = None

    def resting(self, model: LinearModel) -> "Track":
        """After a baseline that is solved alone. Raises numpy.linalg.LinAlgError where the cost is flat."""
        return Track(Certainty.of(_errors(model, None)).of_frame(0))

    def advanced(self, model: LinearModel) -> tuple["Track", Bars]:
        """After a frame, or after the baseline and the first frame together. Raises as `resting`."""
        relative = any(term.needs_previous for term in model.at.cost.terms)
        errors = _errors(model, self.memory)
        certainty = Certainty.of(errors)
        memory = errors.memory() if relative else None
        joint = len(model.at.cell_resistance) == 2
        track = Track(certainty.of_frame(0) if joint else self.baseline, memory)
        frame = certainty.of_frame(-1)
        if track.baseline is None:
            return track, Bars(frame, None)
        shared = np.zeros(frame.deviation.shape) if memory is None else memory.shared().reshape(frame.deviation.shape)
        return track, Bars(frame, Change.between(frame, track.baseline, shared))


def _errors(model: LinearModel, memory: DenseMemory | SampledMemory | None) -> DenseErrors | SampledErrors:
    if isinstance(memory, SampledMemory) or model.at.cell_resistance.size > MOST_DENSE:
        return SampledErrors(model, memory if isinstance(memory, SampledMemory) else None)
    return DenseErrors(model, memory)
