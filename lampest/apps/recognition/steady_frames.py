"""Frames of a window between steps of the readings, and their changes.

The changes are without those by the water's pressure.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lampest.apps.recognition.observation import Observation
from lampest.files.levels import MAD_TO_SIGMA
from lampest.panel.conditions import motion_patterns
from lampest.panel.panel import Array, Mask, Numbers

LEVEL_FRAMES = 9  # two seconds at four frames a second: more than one breath
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
    leak_s : float
        Time from which the suction falls by a leak, s; infinite without one.
    """

    times: Array
    logarithms: Array
    part: Numbers
    period: float
    leak_s: float = np.inf

    @classmethod
    def of(cls, times: Array, logarithms: Array, steps: Sequence[float] = ()) -> "SteadyFrames":
        """Return the interval of all frames but the ones about steps.

        Parts of less than MIN_PART frames are left out, too.
        """
        none = np.zeros(len(times), dtype=np.intp)
        return cls(times, logarithms, none, float(np.median(np.diff(times)))).parted(steps)[0]

    def parted(self, steps: Sequence[float]) -> tuple["SteadyFrames", Mask]:
        """Return the interval with further steps.

        Returns
        -------
        interval : SteadyFrames
            The remaining frames.
        remaining : boolean array, shape (frames,)
            Whether a frame remains.
        """
        at = np.array(sorted(steps))
        apart = np.searchsorted(at, self.times) + (len(at) + 1) * self.part
        still = np.all(
            np.abs(self.times - at[:, None] - self.period / 2) > 1.6 * self.period, axis=0
        )
        still &= np.array(
            [np.sum(still & (apart == number)) >= MIN_PART for number in apart], dtype=bool
        )
        return self._replace(part=apart).only(still), still

    def only(self, frames: Mask) -> "SteadyFrames":
        """Return the interval of some frames, (frames,)."""
        _, part = np.unique(self.part[frames], return_inverse=True)
        return self._replace(
            times=self.times[frames], logarithms=self.logarithms[frames], part=part
        )

    def pulled(self, series: Array, axes: Array) -> tuple[list[float], float]:
        """Find another level of a series beside a wave.

        Parameters
        ----------
        series : array, shape (frames,)
        axes : array, shape (rates, 2, frames)
            Waves without a trend, orthonormal at each rate.

        Returns
        -------
        times : list of float
            Times of the frames before both ends of the best level, or before the one within, s.
        gain : float
            Twice the ln of the ratio of likelihoods, of normal residuals of unknown variance, over
            the best wave alone.
        """
        count = len(series)
        begins, ends = np.triu_indices(count + 1, MIN_PART)
        numbers = np.arange(count)[:, None]
        levels = ((numbers >= begins) & (numbers < ends)).astype(float)
        best, gain = self._beside_wave(series, axes, levels)
        edges = [edge for edge in (begins[best], ends[best]) if 0 < edge < count]
        return [float(self.times[edge - 1]) for edge in edges], gain

    def leaking(self, series: Array, axes: Array) -> tuple[float, float]:
        """Return the time from which a series falls or rises, as of a leak, and the gain.

        Parameters and gain are those of `pulled`.
        """
        begins, ramps = self.ramps()
        best, gain = self._beside_wave(series, axes, ramps)
        return float(begins[best]), gain

    def ramps(self) -> tuple[Array, Array]:
        """Return times (n,), s, and the seconds since each of them at every frame, (frames, n)."""
        begins = self.times[MIN_PART:-1]
        return begins, np.maximum(self.times[:, None] - begins, 0.0)

    def _beside_wave(self, series: Array, axes: Array, shapes: Array) -> tuple[int, float]:
        """Return the number of the shape, of (frames, n), that explains a series best.

        Also by how much it does so beside the best wave, the gain of `pulled`.
        """
        shapes = self.without_trend(shapes)
        amplitude = axes @ series
        waves = axes @ shapes  # (rates, 2, shapes)
        size = np.sum(shapes**2, axis=0) - (waves**2).sum(axis=1)
        along = shapes.T @ series - (amplitude[..., None] * waves).sum(axis=1)
        explained = np.where(size > 1e-3, along**2 / np.maximum(size, 1e-3), 0.0)
        beside = series @ series - (amplitude**2).sum(axis=1)
        remaining = beside[:, None] - explained
        best = int(np.argmin(remaining.min(axis=0)))
        ratio = beside.min() / max(remaining.min(), 1e-12)
        return best, (len(series) - self.trend().shape[1]) * float(np.log(ratio))

    def trend(self) -> Array:
        """Return an orthonormal basis of 1, t, t², ln(1 + t), of a leak, and of steps.

        ln(1 + t) is for creep.
        """
        at = (self.times - self.times[0]) / max(np.ptp(self.times), self.period)
        leak = [np.maximum(self.times - self.leak_s, 0.0)] if self.leak_s < np.inf else []
        steps = [self.part > number for number in range(self.part.max(initial=0))]
        return np.linalg.qr(
            np.column_stack([np.ones_like(at), at, at**2, np.log1p(10 * at), *leak, *steps])
        )[0]

    def without_trend(self, series: Array) -> Array:
        """Return series (…, frames, n) without their projection on the trend."""
        trend = self.trend()
        return series - trend @ (trend.T @ series)


def changes_without_water(interval: SteadyFrames, frame: Observation, change: Array) -> Array:
    """Return the changes of ln y since the recognised frame, without the water's pressure.

    The result has shape (frames, readings). Outliers of each part between steps are drawn in. The
    water presses in common and along both sides of the panel. Its effect is estimated from lines
    without a load; it is 0 if all lines are loaded.

    Parameters
    ----------
    interval : SteadyFrames
    frame : Observation
        The recognised frame.
    change : array, shape (rows, columns)
        ln r/r0 under its loads, 0 beside them.
    """
    changes = interval.logarithms - np.log(frame.measured.ravel())
    for number in range(interval.part.max(initial=-1) + 1):
        own = interval.part == number
        changes[own] = settled(changes[own])
    loaded = change != 0
    response = frame.baseline.response
    free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
    pressure = (
        response.pressure(change / response.gains + response.logarithm(frame.water)) - frame.water
    )
    patterns = motion_patterns(frame.panel.shape) * frame.change(pressure)[1]
    by_cell = frame.slope(change) / frame.measured.ravel()[:, None]
    slopes = by_cell @ patterns.reshape(len(patterns), -1).T
    water = np.linalg.pinv(slopes[free]) @ changes[:, free].T
    return changes - (slopes @ water).T


def settled(series: Array) -> Array:
    """Return a series (frames, …) clipped at four robust standard deviations from its level.

    The level is the running median of LEVEL_FRAMES, which a pull moves.
    """
    half = LEVEL_FRAMES // 2
    around = np.pad(series, ((half, half), *((0, 0) for _ in series.shape[1:])), mode="edge")
    level = np.median(sliding_window_view(around, LEVEL_FRAMES, axis=0), axis=-1)
    most = 4 * MAD_TO_SIGMA * np.median(np.abs(series - level), axis=0)
    return np.clip(series, level - most, level + most)
