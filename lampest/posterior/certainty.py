"""Certainty of an estimate: standard deviation, 95 % interval, resolution, share of the data."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.files.levels import TWO_SIDED
from lampest.panel.panel import Array
from lampest.posterior.interval import one_sided
from lampest.posterior.linear import LinearModel


@dataclass(frozen=True, eq=False)
class LogInterval:
    """Standard deviation and 95 % interval of log r.

    Attributes
    ----------
    deviation : array, any shape
        Standard deviation.
    below, above : array, same shape
        Extent of the 95 % interval below and above the estimate.
    """

    deviation: Array
    below: Array
    above: Array

    def reaching_farther(self, below: Array, above: Array) -> Self:
        """Return intervals with `below` and `above`, squares of extents in log r, added in quadrature."""
        return replace(self, below=np.sqrt(self.below**2 + below), above=np.sqrt(self.above**2 + above))


@dataclass(frozen=True, eq=False)
class Certainty(LogInterval):
    """Certainty of log r, all arrays (frames, rows, columns); deviation and above are infinite for an open cell.

    Attributes
    ----------
    resolution, data_share : array
        Diagonal and row sums of the averaging kernel; 0 for cells at an active bound.
    common : array
        Part of the standard deviation that all cells of a frame share.
    """

    resolution: Array
    data_share: Array
    common: Array

    @property
    def own(self) -> Array:
        """Each cell's own part of the standard deviation, √(deviation² − common²)."""
        return own_part(self.deviation, self.common)

    @classmethod
    def inside(cls, cells: Array, data: Data, variances: tuple[Array, Array], shares: tuple[Array, Array]) -> Self:
        """Return the two-sided certainty of cells that no bound holds.

        Intervals end at most the noise of the reading below the lower bound. They are open above if they reach the
        upper bound.

        Parameters
        ----------
        cells : array, any shape
            Estimate in ohm.
        data : Data
        variances : tuple of array
            Variance of log r, and its part that moves all cells of a frame alike.
        shares : tuple of array
            Diagonal and row sums of the averaging kernel.
        """
        shape, (lower, upper) = cells.shape, data.log_bounds
        deviation, common = (np.sqrt(variance).reshape(shape) for variance in variances)
        position, reach = np.log(cells), TWO_SIDED * deviation
        noise = TWO_SIDED * np.minimum(data.sigma / data.measured, 0.5)
        above = np.where((position + reach >= upper) & (lower < upper), np.inf, reach)
        below = np.minimum(reach, position - lower + noise)
        resolution, data_share = (share.reshape(shape) for share in shares)
        return cls(deviation, below, above, resolution, data_share, common)

    @classmethod
    def of(
        cls,
        model: LinearModel,
        variances: tuple[Array, Array],
        shares: tuple[Array, Array],
        released: Callable[[NDArray[np.intp]], Array],
    ) -> Self:
        """Return the certainty of an estimate: two-sided for free cells, one-sided at active bounds.

        Parameters
        ----------
        model : LinearModel
        variances, shares : tuple of array, shape (free,)
            See `inside`.
        released : callable
            Variance of log r of cells (numbers) at a bound, each released alone.
        """
        at, whole = model.at, np.zeros((4, model.at.cell_resistance.size))
        whole[:, model.free] = *variances, *shares
        certainty = cls.inside(at.cell_resistance, at.data, (whole[0], whole[1]), (whole[2], whole[3]))
        pressed = np.flatnonzero(model.at_lower | model.at_upper)
        if len(pressed):
            # −log density of log r at the bound has the slope |∂φ/∂u|/(2 s²).
            slope, low = np.abs(model.gradient[pressed]) / (2 * model.scale), model.at_lower[pressed]
            deviation, reach = one_sided(slope, released(pressed))
            noise = TWO_SIDED * np.minimum(at.data.sigma / at.data.measured, 0.5).ravel()[pressed]
            certainty.deviation.flat[pressed] = np.where(low, deviation, np.inf)
            certainty.above.flat[pressed] = np.where(low, reach, np.inf)
            certainty.below.flat[pressed] = np.where(low, noise, reach)
        return certainty

    def widened(self, answer: Array) -> "Certainty":
        """Return the certainty with further independent errors of unit variance.

        `answer` is their effect on log r, (frames · cells, n). The part that moves all cells of a frame alike is added
        to `common`.
        """
        rows, columns = self.deviation.shape[-2:]
        answers = answer.reshape(*self.deviation.shape[:-2], rows * columns, -1)
        variance, common = (
            part.reshape(self.deviation.shape) for part in ((answers**2).sum(axis=-1), common_variance(answers))
        )
        wider = self.reaching_farther(TWO_SIDED**2 * variance, TWO_SIDED**2 * variance)
        deviation, common = np.sqrt(self.deviation**2 + variance), np.sqrt(self.common**2 + common)
        return replace(wider, deviation=deviation, common=common)

    def reaching(self, cells: NDArray[np.intp], below: Array, above: Array) -> "Certainty":
        """Return the certainty with intervals of single cells (numbers) extended to at least `below` and `above`."""
        lower, upper = self.below.copy(), self.above.copy()
        lower.flat[cells] = np.maximum(lower.flat[cells], below)
        upper.flat[cells] = np.maximum(upper.flat[cells], above)
        return replace(self, below=lower, above=upper)

    def by_conductance(self) -> "Certainty":
        """Return the certainty with `above` at least −log(1 − above), the extent if the conductance falls linearly."""
        with np.errstate(divide="ignore"):
            return replace(self, above=np.maximum(self.above, -np.log(np.maximum(1 - self.above, 0.0))))

    def of_frame(self, frame: int) -> "Certainty":
        """Return the certainty of one frame, (rows, columns)."""
        return Certainty(*(getattr(self, field.name)[frame] for field in fields(self)))


def common_variance(answer: Array) -> Array:
    """Return the variance due to the common part of independent errors, Σ max(a² − (a − ā)², 0), (…, cells).

    `answer` is the effect a of each of n errors on log r, (…, cells, n). The common part ā is its median over the
    cells; a − ā is each cell's own part.
    """
    ordered = np.sort(answer.swapaxes(-1, -2), axis=-1)  # np.median takes six times as long
    count = ordered.shape[-1]
    apart = answer - (ordered[..., None, :, (count - 1) // 2] + ordered[..., None, :, count // 2]) / 2
    return np.asarray(np.maximum(answer**2 - apart**2, 0.0).sum(axis=-1))


def own_part(deviation: Array, common: Array) -> Array:
    """Return √(deviation² − common²), infinite where `deviation` is; any shape."""
    return np.asarray(np.sqrt(np.maximum(deviation**2 - common**2, 0.0)))
