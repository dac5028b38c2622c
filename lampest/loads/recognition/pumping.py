"""Detection of pumps, with which a mouth restores decaying suction.

They are detected by Bayesian online change-point detection. The relative suction u of an attachment
decays by its leak and drifts with the film,

    u ← u − λ Δt + q √Δt N(0, 1) + J,   sample = u + σ N(0, 1).

Three hypotheses on the jumps J are compared: those of a quiet cup, rare and of either sign; of a
disturbed cup, frequent and of either sign; and the pumps of a mouth, upwards and at intervals of 20
to 200 s (Shi et al., PLoS ONE 16, e0247884, 2021). The probabilities are summed over the unknown
leak λ, noise σ and drift q.
Source: Adams & MacKay, arXiv 0710.3742, 2007; docs/theory/recognition.md.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from lampest.loads.recognition.fit import MAX_LOG_RATIO
from lampest.panel.panel import Array


class Jumps(NamedTuple):
    """A hypothesis on the jumps of suction.

    Attributes
    ----------
    share : float
        Prior probability.
    rate_hz : float
        Jumps per second.
    jump, jump_sd : float
        Mean and standard deviation of the size of a jump.
    interval_s : float
        Time within which a jump is rarely followed by another.
    """

    share: float
    rate_hz: float
    jump: float
    jump_sd: float
    interval_s: float = 0.0


# A quiet cup, a disturbed cup, and a mouth. The rate of pumps is that of the geometric mean of 20
# and 200 s, and their shortest interval half of the shortest published one. The other numbers are
# assumptions: a single jump must not decide, and only pumps are both frequent and upwards.
KINDS = (
    Jumps(0.45, 1 / 200, 0.0, 0.6),
    Jumps(0.05, 1 / 30, 0.0, 0.6),
    Jumps(0.5, 1 / 63, 0.4, 0.3, interval_s=10.0),
)
# The same, along the first axis of GRID.
OF_KINDS = Jumps(*np.array(KINDS).T[..., None, None, None, None])
# λ, 1/s: between pumps a tenth is lost in 200 s, or half in 20 s
LEAKS = np.array([0.0, 0.001, 0.003, 0.01, 0.03])
# σ of a sample: from quiet readings to breathing that is aliased
NOISES = np.geomspace(0.003, 0.2, 6)
DRIFTS = np.array([0.0005, 0.003, 0.015])  # q, 1/√s: creep, temperature, aliased breathing
HYPOTHESES = 8  # times of the last jump that are kept for each combination
# Assumed share of mouths whose pumps are invisible, for which their absence is no evidence.
HIDDEN_SHARE = 0.2
# Least duration of the frames whose median is one sample, without outliers and most of the breath.
BLOCK_S = 3.0
# Lower limit of ln odds, so that a mouth that rested for hours is recognised soon after it begins
# to pump.
MIN_LOG_ODDS = -5.0


@dataclass(frozen=True, eq=False)
class Pumping:
    """State of the change-point detection of one attachment's suction.

    Attributes
    ----------
    weights : array, shape (readings,)
        Weights with which changes of ln y sum to the relative change of suction.
    reference : array, shape (readings,)
        ln y at u = 0.
    since_s : float
        Time of the last sample, s.
    moves : int
        Number of the attachment's moves when the weights were computed.
    logarithm : array, shape (kinds, leaks, noises, drifts, hypotheses)
        ln of the joint probability.
    mean, variance : array, same shape
        Mean and variance of u given a hypothesis.
    age_s : array, same shape
        Time since its last jump, s.
    observed_s : float
        Time over which samples were taken, s.
    pumps : tuple of (int, float, float)
        Number of pumps, and the times of the first and of the last one, s.
    """

    weights: Array
    reference: Array
    since_s: float
    moves: int
    logarithm: Array
    mean: Array
    variance: Array
    age_s: Array
    observed_s: float = 0.0
    pumps: tuple[int, float, float] = (0, np.inf, -np.inf)

    @classmethod
    def begin(
        cls,
        weights: Array,
        reference: Array,
        time: float,
        moves: int,
        before: "Pumping | None" = None,
    ) -> "Pumping":
        """Return the state before the first sample.

        `before` is that of the same attachment in its previous place.
        """
        kinds = np.broadcast_to(np.log(OF_KINDS.share), GRID)
        known = (
            kinds
            if before is None
            else np.broadcast_to(logsumexp(before.logarithm, axis=-1, keepdims=True), GRID)
        )
        track = cls(
            weights, reference, time, moves, known, np.zeros(GRID), np.ones(GRID), np.zeros(GRID)
        )
        return (
            track
            if before is None
            else replace(track, observed_s=before.observed_s, pumps=before.pumps)
        )

    def after(self, logarithms: Array, time: float) -> "Pumping":
        """Return the state after one more sample at a time in s.

        The sample is the median of ln y (frames, readings).
        """
        sample = float(self.weights @ (np.median(logarithms, axis=0) - self.reference))
        seconds = time - self.since_s
        leak = LEAKS[:, None, None, None]
        noise = NOISES[:, None, None]
        drift = DRIFTS[:, None]
        rate = np.where(self.age_s < OF_KINDS.interval_s, KINDS[0].rate_hz / 2, OF_KINDS.rate_hz)
        # Prediction: u decays by λ Δt, its variance grows by q² Δt; a jump occurs with probability
        # 1 − e^(−rate Δt).
        mean = self.mean - leak * seconds
        variance = self.variance + drift**2 * seconds
        jumps = self.logarithm + np.log(-np.expm1(-rate * seconds))
        stays = self.logarithm - rate * seconds
        # The new hypothesis of a jump merges all leaks and all earlier hypotheses by their mean and
        # variance.
        total = logsumexp(jumps, axis=(1, 4), keepdims=True)
        share = np.exp(jumps - total)
        middle = (share * mean).sum(axis=(1, 4), keepdims=True)
        spread = (share * (variance + (mean - middle) ** 2)).sum(axis=(1, 4), keepdims=True)
        start = (
            total - np.log(len(LEAKS)),
            middle + OF_KINDS.jump,
            spread + OF_KINDS.jump_sd**2,
            np.zeros_like(total),
        )
        logarithm, mean, variance, age = (
            np.concatenate([np.broadcast_to(new, (*GRID[:-1], 1)), old], axis=-1)
            for new, old in zip(start, (stays, mean, variance, self.age_s + seconds), strict=True)
        )
        # Update by the sample s ~ N(mean, variance + σ²): probability, then the Kalman step of mean
        # and variance.
        wide = variance + noise**2
        logarithm = logarithm - 0.5 * ((sample - mean) ** 2 / wide + np.log(wide))
        best = np.argsort(-logarithm, axis=-1)[..., :HYPOTHESES]
        logarithm, mean, variance, age, wide = (
            np.take_along_axis(values, best, axis=-1)
            for values in (logarithm, mean, variance, age, wide)
        )
        updated = replace(
            self,
            since_s=time,
            logarithm=logarithm - logsumexp(logarithm),
            mean=mean + variance / wide * (sample - mean),
            variance=variance * (1 - variance / wide),
            age_s=age,
        )
        # Noise, drift and leak may change, so no combination becomes much less probable than the
        # best.
        least = updated.logarithm.max(axis=(1, 2, 3, 4), keepdims=True) - MAX_LOG_RATIO
        logarithm = np.maximum(updated.logarithm, least)
        logarithm[-1] += max(0.0, MIN_LOG_ODDS - updated._kinds)
        return replace(updated, logarithm=logarithm, observed_s=self.observed_s + seconds)._counted(
            time, seconds
        )

    def _counted(self, time: float, seconds: float) -> "Pumping":
        """Return the state with one more pump where there probably was one.

        It is counted where a mouth more probably pumped in the last two samples than not.
        """
        count, first, last = self.pumps
        mouth = self.logarithm[-1]
        share = np.exp(logsumexp(mouth[self.age_s[-1] <= seconds]) - logsumexp(mouth))
        if share <= 0.5 or time - last < KINDS[-1].interval_s:
            return self
        return replace(self, pumps=(count + 1, min(first, time), time))

    @property
    def interval_s(self) -> float | None:
        """Mean time between pumps, s; None with less than two."""
        count, first, last = self.pumps
        return (last - first) / (count - 1) if count > 1 else None

    @property
    def _kinds(self) -> float:
        """ln odds of pumps against both other kinds."""
        kinds = logsumexp(self.logarithm, axis=(1, 2, 3, 4))
        return float(kinds[-1] - logsumexp(kinds[:-1]))

    @property
    def odds(self) -> float:
        """ln odds that the load is a mouth, if HIDDEN_SHARE of all mouths show no pumps."""
        return float(np.logaddexp(np.log(HIDDEN_SHARE), np.log(1 - HIDDEN_SHARE) + self._kinds))


GRID = (len(KINDS), len(LEAKS), len(NOISES), len(DRIFTS), HYPOTHESES)
