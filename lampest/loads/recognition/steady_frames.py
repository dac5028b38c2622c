"""Frames of a window between steps of the readings, and their changes.

The changes are without those by the water's pressure.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANT
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.observation import Observation
from lampest.panel.panel import Array

MIN_PART = 4  # frames between two steps, with which a part says more than its mean


class SteadyFrames(NamedTuple):
    """Frames of a window without those in which the readings step.

    Attributes
    ----------
    times : array, shape (frames,)
        s.
    logarithms : array, shape (frames, readings)
        ln y.
    part : integer array, shape (frames,)
        Number of the steps before each frame.
    period : float
        Median step of time, s.
    """

    times: Array
    logarithms: Array
    part: NDArray[np.intp]
    period: float

    @classmethod
    def of(cls, times: Array, logarithms: Array, steps: Sequence[float] = ()) -> "SteadyFrames":
        """Return the interval of all frames but the ones about steps.

        It also lacks parts of less than MIN_PART frames.
        """
        none = np.zeros(len(times), dtype=np.intp)
        return cls(times, logarithms, none, float(np.median(np.diff(times)))).parted(steps)[0]

    def parted(self, steps: Sequence[float]) -> tuple["SteadyFrames", NDArray[np.bool_]]:
        """Return the interval with further steps, and which of its frames are left, (frames,)."""
        at = np.array(sorted(steps))
        apart = np.searchsorted(at, self.times) + (len(at) + 1) * self.part
        still = np.all(
            np.abs(self.times - at[:, None] - self.period / 2) > 1.6 * self.period, axis=0
        )
        still &= np.array(
            [np.sum(still & (apart == number)) >= MIN_PART for number in apart], dtype=bool
        )
        _, part = np.unique(apart[still], return_inverse=True)
        return SteadyFrames(self.times[still], self.logarithms[still], part, self.period), still

    def only(self, frames: NDArray[np.bool_]) -> "SteadyFrames":
        """Return the interval of some frames, (frames,)."""
        _, part = np.unique(self.part[frames], return_inverse=True)
        return SteadyFrames(self.times[frames], self.logarithms[frames], part, self.period)

    def pulled(self, series: Array, wave: float) -> tuple[float, ...]:
        """Return the times between which a series, (frames,), is at another level.

        () where a wave explains it better. Both ends of the best level, or one, are compared by the
        squares that they explain, `wave` by the best wave.
        """
        trend = self.trend()
        count = len(series)
        begins, ends = np.triu_indices(count + 1, MIN_PART)
        numbers = np.arange(count)[:, None]
        level = ((numbers >= begins) & (numbers < ends)).astype(float)
        level -= trend @ (trend.T @ level)
        size = np.sum(level**2, axis=0)
        explained = np.where(size > 1e-3, (level.T @ series) ** 2 / np.maximum(size, 1e-3), 0.0)
        best = int(np.argmax(explained))
        total = float(series @ series)
        scatter = (total - explained[best]) / max(count - trend.shape[1] - 1, 1)
        if explained[best] <= max(wave, SIGNIFICANT**2 * scatter):
            return ()
        edges = (int(edge) for edge in (begins[best], ends[best]))
        return tuple(float(self.times[edge - 1]) for edge in edges if 0 < edge < count)

    def trend(self) -> Array:
        """Return an orthonormal basis of 1, t, t², ln(1 + t), and of a step between the parts.

        ln(1 + t), the last of the functions of t, is for creep.
        """
        at = (self.times - self.times[0]) / max(float(np.ptp(self.times)), self.period)
        steps = [self.part > number for number in range(self.part.max(initial=0))]
        return np.linalg.qr(
            np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at), *steps])
        )[0]


def changes_without_water(interval: SteadyFrames, frame: Observation, fit: Fit) -> Array:
    """Return the changes of ln y, (frames, readings), since the recognised frame.

    They are less those by the water's pressure. Outliers of each part between steps are drawn in.
    The water's effect is estimated from lines without a load; it is 0 if all lines are loaded.

    Parameters
    ----------
    interval : SteadyFrames
    frame : Observation
        The recognised frame.
    fit : Fit
        Its fit.
    """
    changes = interval.logarithms - np.log(frame.measured.ravel())
    for number in range(interval.part.max(initial=-1) + 1):
        own = interval.part == number
        changes[own] = settled(changes[own])
    loaded = fit.change != 0
    response = frame.baseline.response
    free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
    pressure = (
        response.pressure(fit.change / response.gains + response.logarithm(frame.water))
        - frame.water
    )
    slope = frame.slope(fit.change) @ frame.change(pressure)[1].ravel() / frame.measured.ravel()
    return changes - np.outer(
        changes[:, free] @ slope[free] / max(float(slope[free] @ slope[free]), 1e-300), slope
    )


def settled(series: Array) -> Array:
    """Return a series (frames, …) clipped at four robust standard deviations from its median."""
    middle = np.median(series, axis=0)
    most = 4 * MAD_TO_SIGMA * np.median(np.abs(series - middle), axis=0)
    return np.asarray(np.clip(series, middle - most, middle + most))
