"""Detection of pumps, with which a mouth restores decaying suction.

The method is Bayesian online change-point detection. The relative suction u of an attachment decays
by its leak and drifts with the film,

    u ← u − λ Δt + q √Δt N(0, 1) + J,   sample = u + σ N(0, 1).

Three hypotheses on the jumps J are compared: those of a quiet cup, rare and of either sign; of a
disturbed cup, frequent and of either sign; and the pumps of a mouth, upwards and at intervals of 20
to 200 s (Shi et al., PLoS ONE 16, e0247884, 2021). A pump restores the suction of the last one, and
a push does not: from the second on its jump is to that level. The probabilities are summed over the
unknown leak λ, noise σ and drift q. Source: Adams & MacKay, arXiv 0710.3742, 2007;
docs/theory/recognition.md.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr

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
# Assumed: u after a pump is that after the last one, with this standard deviation; and mean and
# standard deviation of the level of the first pump, over u at its recognition.
RESTORED_SD = 0.12
# Difference of ln P to the most probable course beyond which courses do not count.
MAX_LOG_RATIO = 20.0
FIRST_LEVEL = (0.1, 0.15)
# Larger changes of u are pulls, or another load: their samples do not count.
MAX_CHANGE = 1.5
# The same as KINDS, along the first axis of GRID.
OF_KINDS = Jumps(*np.array(KINDS).T[..., None, None, None, None])
# λ, 1/s: between pumps a tenth is lost in 200 s, or half in 20 s
LEAKS = np.array([0.0, 0.001, 0.003, 0.01, 0.03])
# σ of a sample: from quiet readings to breathing that is aliased
NOISES = np.geomspace(0.003, 0.2, 6)
DRIFTS = np.array([0.0005, 0.003, 0.015])  # q, 1/√s: creep, temperature, aliased breathing
HYPOTHESES = 8  # times of the last jump that are kept for each combination
# Assumed share of mouths whose pumps are invisible, for which their absence is no evidence.
HIDDEN_SHARE = 0.2
# Assumed share of cups whose suction is restored as pumps do, for which pumps are no evidence.
RESTORED_SHARE = 0.05
# Least duration of the frames whose median is one sample, without outliers and most of the breath.
BLOCK_S = 3.0
# Numbers of kinds, leaks, noises, drifts and hypotheses.
GRID = (len(KINDS), len(LEAKS), len(NOISES), len(DRIFTS), HYPOTHESES)
# Lower limit of ln odds, so that a mouth that rested for hours is recognised soon after it begins
# to pump.
MIN_LOG_ODDS = -5.0


class Moments(NamedTuple):
    """Suction under every hypothesis, arrays (kinds, leaks, noises, drifts, hypotheses) each.

    Attributes
    ----------
    mean, variance : array
        Mean and variance of u.
    age_s : array
        Time since its last jump, s.
    level, level_variance : array
        Mean and variance of u after its last jump.
    """

    mean: Array
    variance: Array
    age_s: Array
    level: Array
    level_variance: Array


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
        Number of the attachment's moves when the weights were computed; −1 if they hold no more.
    logarithm : array, shape (kinds, leaks, noises, drifts, hypotheses)
        ln of the joint probability.
    moments : Moments
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
    moments: Moments
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
        level, level_sd = FIRST_LEVEL
        moments = Moments(*(np.full(GRID, value) for value in (0.0, 1.0, 0.0, level, level_sd**2)))
        prior = np.broadcast_to(np.log(OF_KINDS.share), GRID)
        track = cls(weights, reference, time, moves, prior, moments)
        if before is None:
            return track
        logarithm = logsumexp(before.logarithm, axis=-1, keepdims=True)
        return replace(
            track,
            logarithm=np.broadcast_to(logarithm, GRID),
            observed_s=before.observed_s,
            pumps=before.pumps,
        )

    def after(self, logarithms: Array, time: float) -> "Pumping":
        """Return the state after one more sample at a time in s.

        The sample is the median of ln y (frames, readings); one beyond MAX_CHANGE is left out.
        """
        sample = float(self.weights @ (np.median(logarithms, axis=0) - self.reference))
        seconds = time - self.since_s
        since = replace(self, since_s=time)
        if abs(sample) > MAX_CHANGE:
            return since
        since = replace(since, observed_s=self.observed_s + seconds)
        return since._predicted(seconds)._updated(sample)._counted(time, seconds)

    def _predicted(self, seconds: float) -> "Pumping":
        """Return the state after an interval in s, with one more hypothesis: a jump within it.

        u decays by λ Δt, and its variance grows by q² Δt. A jump has the probability 1 − e^(−rate
        Δt).
        """
        mean, variance, age_s, level, level_variance = self.moments
        rate = np.where(age_s < OF_KINDS.interval_s, KINDS[0].rate_hz / 2, OF_KINDS.rate_hz)
        mean = mean - LEAKS[:, None, None, None] * seconds
        variance = variance + DRIFTS[:, None] ** 2 * seconds
        jumps = self.logarithm + np.log(-np.expm1(-rate * seconds))
        # A pump raises the suction. The hypothesis of a jump merges all leaks and all earlier
        # hypotheses by their mean and variance.
        higher = ndtr((level - mean) / np.sqrt(level_variance + variance + RESTORED_SD**2))
        jumps[-1] += np.log(np.maximum(higher[-1], np.exp(-MAX_LOG_RATIO)))
        total = logsumexp(jumps, axis=(1, 4), keepdims=True)
        share = np.exp(jumps - total)

        def merged(means: Array, variances: Array) -> tuple[Array, Array]:
            middle = (share * means).sum(axis=(1, 4), keepdims=True)
            spread = (share * (variances + (means - middle) ** 2)).sum(axis=(1, 4), keepdims=True)
            return middle, spread

        middle, spread = merged(mean, variance)
        restored, restored_spread = merged(level, level_variance)
        after = middle + OF_KINDS.jump
        after_spread = spread + OF_KINDS.jump_sd**2
        after[-1] = restored[-1]
        after_spread[-1] = restored_spread[-1] + RESTORED_SD**2
        jumped = Moments(after, after_spread, np.zeros_like(total), restored, restored_spread)
        stays = Moments(mean, variance, age_s + seconds, level, level_variance)
        logarithm = _with_hypothesis(total - np.log(len(LEAKS)), self.logarithm - rate * seconds)
        moments = Moments(*map(_with_hypothesis, jumped, stays))
        return replace(self, logarithm=logarithm, moments=moments)

    def _updated(self, sample: float) -> "Pumping":
        """Return the state with a sample s ~ N(mean, variance + σ²), and the best hypotheses.

        Mean and variance are updated by a Kalman step.
        """
        wide: Array = self.moments.variance + NOISES[:, None, None] ** 2
        misfit = (sample - self.moments.mean) ** 2 / wide + np.log(wide)
        logarithm: Array = self.logarithm - 0.5 * misfit
        best = np.argsort(-logarithm, axis=-1)[..., :HYPOTHESES]
        logarithm, wide, mean, variance, age_s, level, level_variance = (
            np.take_along_axis(values, best, axis=-1) for values in (logarithm, wide, *self.moments)
        )
        mean = mean + variance / wide * (sample - mean)
        variance = variance * (1 - variance / wide)
        pumped = age_s == 0
        level = np.where(pumped, mean, level)
        level_variance = np.where(pumped, variance, level_variance)
        moments = Moments(mean, variance, age_s, level, level_variance)
        known = replace(self, logarithm=logarithm - logsumexp(logarithm), moments=moments)
        # No combination is much less probable than the best: noise, drift and leak may change, and
        # a mouth that rested may pump again.
        least = known.logarithm.max(axis=(1, 2, 3, 4), keepdims=True) - MAX_LOG_RATIO
        limited = np.maximum(known.logarithm, least)
        limited[-1] += max(0.0, MIN_LOG_ODDS - known._kinds)
        return replace(known, logarithm=limited)

    def _counted(self, time: float, seconds: float) -> "Pumping":
        """Return the state with one more pump where there probably was one.

        A pump counts where a mouth more probably pumped in the last two samples than not.
        """
        count, first, last = self.pumps
        mouth = self.logarithm[-1]
        share = np.exp(logsumexp(mouth[self.moments.age_s[-1] <= seconds]) - logsumexp(mouth))
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
        """ln odds that the load is a mouth.

        HIDDEN_SHARE of all mouths show no pumps, and RESTORED_SHARE of all cups seem to pump.
        """
        mouth, cup = (
            np.logaddexp(np.log(1 - pumping), np.log(pumping) + self._kinds)
            for pumping in (1 - HIDDEN_SHARE, RESTORED_SHARE)
        )
        return float(mouth - cup)


def _with_hypothesis(new: Array, values: Array) -> Array:
    """Return values along the hypotheses with one more before them, (..., 1 + hypotheses)."""
    return np.concatenate([np.broadcast_to(new, (*GRID[:-1], 1)), values], axis=-1)
