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
    """Interval of log r, any shape: standard deviation, and how far the 95 % interval reaches down and up."""

    deviation: Array
    below: Array
    above: Array

    def reaching_farther(self, below: Array, above: Array) -> Self:
        """Return the intervals that reach farther, by squares that are added to theirs."""
        return replace(self, below=np.sqrt(self.below**2 + below), above=np.sqrt(self.above**2 + above))


@dataclass(frozen=True, eq=False)
class Certainty(LogInterval):
    """Certainty of log r, all (frames, rows, columns); deviation and above are infinite for an open cell.

    Attributes
    ----------
    resolution, data_share : array
        Diagonal and row sums of the averaging kernel, 0 where a bound decides.
    common : array
        The part of the deviation that cells share.
    """

    resolution: Array
    data_share: Array
    common: Array

    @property
    def own(self) -> Array:
        """√(deviation² − common²): each cell's own part."""
        return own_part(self.deviation, self.common)

    @classmethod
    def inside(cls, cells: Array, data: Data, variances: tuple[Array, Array], shares: tuple[Array, Array]) -> Self:
        """Two-sided, of cells away from their bounds; below a lower bound as far as its reading's noise. Any shape.

        Parameters
        ----------
        variances : tuple
            Of log r, and the part of it that one chance moves together in a frame.
        shares : tuple
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
        """Return the certainty: as `inside` for free cells, one-sided at active bounds.

        Parameters
        ----------
        variances, shares : tuple
            Of the free cells.
        released : callable
            Variance of cells (numbers) that stand at a bound, if each alone were free.
        """
        at, whole = model.at, np.zeros((4, model.at.cell_resistance.size))
        whole[:, model.free] = *variances, *shares
        certainty = cls.inside(at.cell_resistance, at.data, (whole[0], whole[1]), (whole[2], whole[3]))
        pressed = np.flatnonzero(model.at_lower | model.at_upper)
        if len(pressed):
            slope, low = np.abs(model.gradient[pressed]) / (2 * model.scale), model.at_lower[pressed]
            deviation, reach = one_sided(slope, released(pressed))
            noise = TWO_SIDED * np.minimum(at.data.sigma / at.data.measured, 0.5).ravel()[pressed]
            certainty.deviation.flat[pressed] = np.where(low, deviation, np.inf)
            certainty.above.flat[pressed] = np.where(low, reach, np.inf)
            certainty.below.flat[pressed] = np.where(low, noise, reach)
        return certainty

    def widened(self, answer: Array) -> "Certainty":
        """Return the certainty with independent errors of variance 1 on top.

        answer : their effect on log r, (frames · cells, n); the part that moves all cells of a frame alike is common.
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
        """Return the certainty with intervals of single cells (numbers) that reach at least so far."""
        lower, upper = self.below.copy(), self.above.copy()
        lower.flat[cells] = np.maximum(lower.flat[cells], below)
        upper.flat[cells] = np.maximum(upper.flat[cells], above)
        return replace(self, below=lower, above=upper)

    def by_conductance(self) -> "Certainty":
        """Return intervals as far upwards as conductances may fall: r/(1 − x) for exp(−x) of r downwards, x < 1."""
        with np.errstate(divide="ignore"):
            return replace(self, above=np.maximum(self.above, -np.log(np.maximum(1 - self.above, 0.0))))

    def of_frame(self, frame: int) -> "Certainty":
        """Return that of one frame, (rows, columns)."""
        return Certainty(*(getattr(self, field.name)[frame] for field in fields(self)))


def common_variance(answer: Array) -> Array:
    """Return the variance (…, cells) by which independent errors move all cells alike: Σ a² − (a − ā)², at least 0.

    answer : a (…, cells, n), what each does to log r. ā is the median of the cells; a − ā is each cell's own.
    """
    ordered = np.sort(answer.swapaxes(-1, -2), axis=-1)  # np.median takes six times as long
    count = ordered.shape[-1]
    apart = answer - (ordered[..., None, :, (count - 1) // 2] + ordered[..., None, :, count // 2]) / 2
    return np.asarray(np.maximum(answer**2 - apart**2, 0.0).sum(axis=-1))


def own_part(deviation: Array, common: Array) -> Array:
    """√(deviation² − common²), infinite where a cell may be open; any shape."""
    return np.asarray(np.sqrt(np.maximum(deviation**2 - common**2, 0.0)))
