"""Certainty of an estimate: standard deviation, 95 % interval, resolution, share of the data."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from lampest.files.levels import TWO_SIDED
from lampest.files.typed import ReadOnlyArrays
from lampest.panel.panel import Array, Numbers
from lampest.posterior.interval import one_sided
from lampest.posterior.linear import LinearModel


@dataclass(frozen=True, eq=False)
class Certainty(ReadOnlyArrays):
    """Certainty of log r, or of a change of it.

    All arrays have one shape, such as (frames, rows, columns).

    Attributes
    ----------
    deviation : array
        Standard deviation; infinite for an open cell.
    below, above : array
        Extent of the 95 % interval below and above the estimate; `above` is infinite for an open
        cell.
    resolution, data_share : array
        Diagonal and row sums of the averaging kernel; 0 for cells at an active bound.
    common : array
        Part of the standard deviation that all cells of a frame share.
    """

    deviation: Array
    below: Array
    above: Array
    resolution: Array
    data_share: Array
    common: Array

    @property
    def own(self) -> Array:
        """Each cell's own part of the standard deviation, √(deviation² − common²)."""
        return np.sqrt(np.maximum(self.deviation**2 - self.common**2, 0.0))

    @classmethod
    def of(
        cls,
        model: LinearModel,
        variances: tuple[Array, Array],
        shares: tuple[Array, Array],
        released: Callable[[Numbers], Array],
    ) -> "Certainty":
        """Return the certainty of an estimate.

        Intervals are two-sided for free cells, and one-sided at active bounds. Two-sided intervals
        end at most the noise of the reading below the lower bound, and are open above if they reach
        the upper bound.

        Parameters
        ----------
        model : LinearModel
        variances : tuple of array, shape (free,)
            Variance of log r, and its part that moves all cells of a frame alike.
        shares : tuple of array, shape (free,)
            Diagonal and row sums of the averaging kernel.
        released : callable
            Variance of log r of cells (numbers) at a bound, each released alone.
        """
        at = model.at
        lower, upper = model.at.data.log_bounds
        maps = np.zeros((4, at.cell_resistance.size))
        maps[:, model.free] = *variances, *shares
        variance, shared, resolution, data_share = maps.reshape(4, *at.cell_resistance.shape)
        deviation = np.sqrt(variance)
        noise = TWO_SIDED * np.minimum(at.data.sigma / at.data.measured, 0.5)
        reach = TWO_SIDED * deviation
        above = np.where((at.position + reach >= upper) & (lower < upper), np.inf, reach)
        below = np.minimum(reach, at.position - lower + noise)
        pressed = np.flatnonzero(model.at_lower | model.at_upper)
        if len(pressed):
            # −log density of log r at the bound has the slope |∂φ/∂u|/(2 s²).
            slope = np.abs(model.gradient[pressed]) / (2 * model.scale)
            low = model.at_lower[pressed]
            size, quantile = one_sided(slope, released(pressed))
            deviation.flat[pressed] = np.where(low, size, np.inf)
            above.flat[pressed] = np.where(low, quantile, np.inf)
            below.flat[pressed] = np.where(low, noise.flat[pressed], quantile)
        return cls(deviation, below, above, resolution, data_share, np.sqrt(shared))

    def less(
        self, baseline: "Certainty", shared: Array, common: Array | None = None
    ) -> "Certainty":
        """Return the certainty of the change from a baseline.

        Deviations a, b and the ends of intervals are combined by √(a² + b² − 2·shared).

        Parameters
        ----------
        baseline : Certainty
        shared : array
            Covariance of the two errors.
        common : array or None
            Covariance of their common parts; None if it is not known: then the whole deviation
            counts as each cell's own.
        """

        def joined(of_frame: Array, of_baseline: Array, shared: Array) -> Array:
            with np.errstate(invalid="ignore"):
                return np.sqrt(np.maximum(of_frame**2 + of_baseline**2 - 2 * shared, 0))

        ends = TWO_SIDED**2 * shared
        of_common: Array = np.zeros(self.common.shape)
        if common is not None:
            of_common = joined(self.common, baseline.common, common)
        return replace(
            self,
            deviation=joined(self.deviation, baseline.deviation, shared),
            # The lower end of the difference combines the frame's lower with the baseline's upper
            # end.
            below=joined(self.below, baseline.above, ends),
            above=joined(self.above, baseline.below, ends),
            common=of_common,
        )

    def reaching_farther(self, below: Array, above: Array) -> "Certainty":
        """Return intervals with `below` and `above` added in quadrature.

        `below` and `above` are squares of extents in log r.
        """
        return replace(
            self, below=np.sqrt(self.below**2 + below), above=np.sqrt(self.above**2 + above)
        )

    def widened(self, answer: Array) -> "Certainty":
        """Return the certainty with further independent errors of unit variance.

        `answer` is their effect on log r, (frames · cells, n). The part that moves all cells of a
        frame alike is added to `common`.
        """
        shape = self.deviation.shape
        answers = answer.reshape(*shape[:-2], shape[-2] * shape[-1], -1)
        variance = (answers**2).sum(axis=-1).reshape(shape)
        reach = TWO_SIDED**2 * variance
        return replace(
            self.reaching_farther(reach, reach),
            deviation=np.sqrt(self.deviation**2 + variance),
            common=np.sqrt(self.common**2 + common_variance(answers).reshape(shape)),
        )

    def reaching(self, cells: Numbers, below: Array, above: Array) -> "Certainty":
        """Return the certainty with the intervals of `cells` at least `below` and `above`."""
        lower = self.below.copy()
        upper = self.above.copy()
        lower.flat[cells] = np.maximum(lower.flat[cells], below)
        upper.flat[cells] = np.maximum(upper.flat[cells], above)
        return replace(self, below=lower, above=upper)

    def by_conductance(self) -> "Certainty":
        """Return the certainty with `above` at least −log(1 − above).

        The interval has this extent if the conductance falls linearly.
        """
        with np.errstate(divide="ignore"):
            linear = -np.log(np.maximum(1 - self.above, 0.0))
        return replace(self, above=np.maximum(self.above, linear))

    def of_frame(self, frame: int) -> "Certainty":
        """Return the certainty of one frame, (rows, columns)."""
        return Certainty(*(getattr(self, field.name)[frame] for field in fields(self)))


def common_variance(answer: Array) -> Array:
    """Return the variance Σ max(a² − (a − ā)², 0) due to the common part of errors, (…, cells).

    `answer` is the effect a of each of n independent errors on log r, (…, cells, n). The common
    part ā is the median of a over the cells; a − ā is each cell's own part.
    """
    individual = answer - np.median(answer, axis=-2, keepdims=True)
    return np.asarray(np.maximum(answer**2 - individual**2, 0.0).sum(axis=-1))
