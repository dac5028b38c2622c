"""Error bars of many panels over a leading axis.

They are those of `DenseErrors` where every cell is free, all readings are values, and at most one squared penalty
stands beside squared data. Letters are those of `DenseErrors`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.problem import Part, residuals
from lampest.panel.panel import Array
from lampest.posterior.certainty import Certainty, common_variance
from lampest.posterior.dense import positive_inverse, rank
from lampest.posterior.linear import IGNORANCE, NEAR_BOUND
from lampest.posterior.track import Bars, Track
from lampest.solvers.hessian import Hessian


@dataclass(frozen=True, eq=False)
class BatchErrors:
    """Error bars of panels.

    Attributes
    ----------
    points : Hessian
        Derivatives at the estimates, over a leading axis of panels.
    tracks : sequence of Track
        State that error bars carry from earlier frames.
    weight_sigma : array, shape (panels, terms)
        Standard deviation of log λ; NaN where the data did not choose λ.
    """

    points: Hessian
    tracks: Sequence[Track]
    weight_sigma: Array

    @staticmethod
    def inside(points: Hessian) -> NDArray[np.bool_]:
        """(panels) of which these are the errors: of a cost of this kind, with no cell at a bound."""
        cost, data = points.at.cost, points.at.data
        lower, upper = (bound.reshape(points.position.shape) for bound in data.log_bounds)
        pattern, every = residuals(cost).data.by_model.pattern, np.arange(cost.panel.crossings)
        kind = all(term.loss.squared and not term.needs_previous for term in cost.terms)
        kind = kind and sum(not term.reads_measurement for term in cost.terms) <= 1 and not data.partial
        if not (kind and all(np.array_equal(numbers, every) for numbers in pattern)):
            return np.zeros(len(points.position), dtype=bool)
        low = (points.position - lower <= NEAR_BOUND) & (points.gradient > 0)
        high = (upper - points.position <= NEAR_BOUND) & (points.gradient < 0)
        return np.asarray(~(low | high | (lower >= upper)).any(axis=1))

    def bars(self) -> list[tuple[Track, Bars]]:
        """As `Track.advanced`, of every panel. Raises numpy.linalg.LinAlgError where a cost is flat."""
        own, barred = self._certainty, list[tuple[Track, Bars]]()
        for number, (track, answer) in enumerate(zip(self.tracks, self._answers, strict=True)):
            frame = alone = own.of_frame(number).of_frame(0)
            if track.shared is not None:
                answer = track.shared.related(answer)
                frame = alone.widened(answer)
            after, bars = track.after(frame, alone.deviation, answer)
            barred.append((after, replace(bars, reading=self._reading_deviation[number])))
        return barred

    @cached_property
    def _reading_deviation(self) -> Array:
        """As `DenseErrors.reading_deviation`, (panels, rows, columns)."""
        variance = self._scale * ((self._sensitivity @ self._inverse) * self._sensitivity).sum(axis=2, keepdims=True)
        return np.asarray(np.sqrt(variance).reshape(self.points.at.reading.shape)[:, 0])

    @cached_property
    def _answers(self) -> list[Array]:
        """What shared errors do to log r of every panel, (cells, n) each, as if hidden ones were independent."""
        answered: list[Array] = [np.zeros((self.points.position.shape[1], 0))] * len(self.tracks)
        groups: dict[object, list[int]] = {}
        for number, track in enumerate(self.tracks):
            if track.shared is not None:
                groups.setdefault((track.shared.scene, track.shared.systematic), []).append(number)
        for numbers in groups.values():
            some, shared = self.points.some(np.array(numbers)), self.tracks[numbers[0]].shared
            assert shared is not None
            answers = self._gain[numbers] @ shared.unrelated(some.at.networks[0], some.at.data.measured[:, 0])
            for number, answer in zip(numbers, answers, strict=True):
                answered[number] = answer
        return answered

    @cached_property
    def _certainty(self) -> Certainty:
        """Without errors that all frames share, (panels, rows, columns)."""
        resolution = np.einsum("pij,pji->pi", self._gain, self._sensitivity)
        shares = resolution, self._gain @ self._sensitivity.sum(axis=2)[..., None]
        unseen = (self._inverse**2).sum(axis=2, keepdims=True) * (IGNORANCE * self._scale**2)
        variance = self._gain**2 @ self._noise + unseen + self._of_penalties
        drawn, shared = np.zeros((2, *variance.shape))
        for number, track in enumerate(self.tracks):
            if track.noise is not None:
                columns = track.noise.columns(self.points.at.data.measured[number], baseline=False)
                answer = self._gain[number] @ columns
                drawn[number], shared[number] = (answer**2).sum(axis=1, keepdims=True), common_variance(answer)[:, None]
        variance = variance + drawn
        at = self.points.at
        return Certainty.inside(at.cell_resistance, at.data, (variance, np.minimum(shared, variance)), shares)

    @cached_property
    def _weight(self) -> Array:
        """Ω (∂x/∂y)² of the data, (panels, cells)."""
        part = residuals(self.points.at.cost).data
        return np.asarray(self.points.at.weights[:, part.term] * self.points.at.of_terms(part.by_model) ** 2)

    @cached_property
    def _noise(self) -> Array:
        """σ² (panels, cells, 1), without each reading's own error."""
        data = self.points.at.data
        pairs = zip(self.tracks, data.sigma, data.measured, strict=True)
        noise = [track.noise_alone(sigma, measured) for track, sigma, measured in pairs]
        return np.reshape(noise, (*self.points.position.shape, 1)) ** 2

    @cached_property
    def _scale(self) -> Array:
        """s² (panels, 1, 1)."""
        noise = self._noise[..., 0]
        if self._penalty is not None:
            pairs = zip(self.tracks, self.points.at.data.measured, strict=True)
            off = [0 * frame if track.shared is None else track.shared.own_error(frame) for track, frame in pairs]
            noise = noise + np.reshape(off, noise.shape) ** 2
        return np.asarray(np.mean(self._weight * noise, axis=1)[:, None, None])

    @cached_property
    def _sensitivity(self) -> Array:
        """J (panels, cells, cells)."""
        return self.points.at.networks[0].sensitivity()

    @property
    def _penalty(self) -> Part | None:
        part = residuals(self.points.at.cost).penalties
        return part if len(part.term) else None

    @cached_property
    def _penalty_rows(self) -> list[sparse.csr_array]:
        """√Ω Z (rows, cells) of every panel; no rows without a penalty."""
        part, points = residuals(self.points.at.cost).penalties, self.points
        (row, column), cells = part.by_cells.pattern, self.points.position.shape[1]
        values = points.at.of_terms(part.by_cells) * np.exp(points.position)[:, column]
        values *= np.sqrt(points.at.weights[:, part.term])[:, row]
        pattern = sparse.csr_array((np.arange(len(row)), (row, column)), (len(part.term), cells))
        return [
            sparse.csr_array((entries[pattern.data], pattern.indices, pattern.indptr), pattern.shape)
            for entries in values
        ]

    @property
    def _of_penalties(self) -> Array:
        """The part of the variance that a penalty makes, (panels, cells, 1); see `DenseErrors.widening`."""
        variance = np.zeros((*self.points.position.shape, 1))
        part = self._penalty
        if part is None:
            return variance
        weight, residual = self.points.at.weights[:, part.term], self.points.at.of_terms(part.value)
        squares = weight * residual**2 / self._scale[..., 0]
        chosen = np.nan_to_num(self.weight_sigma[:, part.term]) * np.sqrt(weight) * residual
        known = min(rank(self.points.at.cost.unweighted), variance.shape[1])
        for number, rows in enumerate(self._penalty_rows):
            pulls = rows @ self._inverse[number]
            determined = known - float(rows.multiply(pulls).sum())
            widened = max(float(squares[number].sum()) / max(determined, 1.0), 1.0)
            size = self._scale[number, 0] * np.maximum(widened, squares[number])
            variance[number, :, 0] = size @ pulls**2 + (chosen[number] @ pulls) ** 2
        return variance

    @cached_property
    def _inverse(self) -> Array:
        """A⁻¹ (panels, cells, cells)."""
        rows = self._sensitivity * np.sqrt(self._weight)[..., None]
        matrix = rows.swapaxes(-1, -2) @ rows
        if self._penalty is not None:
            matrix += np.stack([(penalty.T @ penalty).toarray() for penalty in self._penalty_rows])
        np.einsum("...ii->...i", matrix)[...] += IGNORANCE * self._scale[..., 0]
        return np.stack([positive_inverse(panel) for panel in matrix])

    @cached_property
    def _gain(self) -> Array:
        """K of errors of the readings, (panels, cells, cells)."""
        return np.asarray(self._inverse @ (self._sensitivity.swapaxes(-1, -2) * self._weight[:, None]))
