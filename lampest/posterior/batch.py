"""Error bars of many panels at once, over a leading axis: those of `DenseErrors` where every cell is free, all readings
are values, and one squared penalty at most stands beside squared data. Letters are those of `DenseErrors`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.cost.problem import Part, residuals
from lampest.panel.panel import Array
from lampest.posterior.certainty import Certainty, alike
from lampest.posterior.dense import positive_inverse, rank
from lampest.posterior.linear import IGNORANCE, NEAR_BOUND
from lampest.posterior.track import Bars, Track
from lampest.solvers.panel_batch import Mask, Points


@dataclass(frozen=True, eq=False)
class BatchErrors:
    """points : the panels' estimates. tracks : what their error bars need of earlier frames."""

    points: Points
    tracks: Sequence[Track]

    @staticmethod
    def inside(points: Points) -> Mask:
        """(panels) of which these are the errors: of a cost of this kind, with no cell at a bound."""
        cost, (lower, upper) = points.batch.cost, points.batch.log_bounds
        pattern, every = residuals(cost).data.by_model.pattern, np.arange(cost.panel.crossings)
        kind = all(term.loss.squared and not term.needs_previous for term in cost.terms)
        kind = kind and sum(not term.reads_measurement for term in cost.terms) <= 1 and not points.batch.data.partial
        if not (kind and all(np.array_equal(numbers, every) for numbers in pattern)):
            return np.zeros(len(points.position), dtype=bool)
        low = (points.position - lower <= NEAR_BOUND) & (points.gradient > 0)
        high = (upper - points.position <= NEAR_BOUND) & (points.gradient < 0)
        return np.asarray(~(low | high | (lower >= upper)).any(axis=1))

    def bars(self) -> list[tuple[Track, Bars]]:
        """As `Track.advanced`, of every panel. Raises numpy.linalg.LinAlgError where a cost is flat."""
        own, found = self._certainty, list[tuple[Track, Bars]]()
        for number, (track, answer) in enumerate(zip(self.tracks, self._answers, strict=True)):
            frame = alone = own.of_frame(number)
            if track.shared is not None:
                answer = track.shared.related(answer)
                frame = alone.widened(answer)
            found.append(track.after(frame, alone.deviation, answer))
        return found

    @cached_property
    def _answers(self) -> list[Array]:
        """What shared errors do to log r of every panel, (cells, n) each, as if hidden ones were independent."""
        found: list[Array] = [np.zeros((self.points.position.shape[1], 0))] * len(self.tracks)
        groups: dict[object, list[int]] = {}
        for number, track in enumerate(self.tracks):
            if track.shared is not None:
                groups.setdefault((track.shared.scene, track.shared.systematic), []).append(number)
        for numbers in groups.values():
            some, shared = self.points.some(np.array(numbers)), self.tracks[numbers[0]].shared
            assert shared is not None
            answers = self._gain[numbers] @ shared.unrelated(some.network, some.batch.data.measured)
            for number, answer in zip(numbers, answers, strict=True):
                found[number] = answer
        return found

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
                columns = track.noise.columns(self.points.batch.data.measured[number][None], False)
                answer = self._gain[number] @ columns
                drawn[number], shared[number] = (answer**2).sum(axis=1, keepdims=True), alike(answer)[:, None]
        variance = variance + drawn
        data, cells = self.points.batch.data, self.points.network.cell_resistance
        return Certainty.inside(cells, data, (variance, np.minimum(shared, variance)), shares)

    @cached_property
    def _weight(self) -> Array:
        """Ω (∂x/∂y)² of the data, (panels, cells)."""
        part = residuals(self.points.batch.cost).data
        return np.asarray(self.points.batch.weights[:, part.term] * self.points.called(part.by_model) ** 2)

    @cached_property
    def _noise(self) -> Array:
        """σ² (panels, cells, 1), without each reading's own error."""
        data = self.points.batch.data
        pairs = zip(self.tracks, data.sigma[:, None], data.measured[:, None], strict=True)
        noise = [track.noise_alone(sigma, measured) for track, sigma, measured in pairs]
        return np.reshape(noise, (*self.points.position.shape, 1)) ** 2

    @cached_property
    def _scale(self) -> Array:
        """s² (panels, 1, 1)."""
        noise = self._noise[..., 0]
        if self._penalty is not None:
            pairs = zip(self.tracks, self.points.batch.data.measured[:, None], strict=True)
            off = [0 * frame if one.shared is None else one.shared.own_error(frame) for one, frame in pairs]
            noise = noise + np.reshape(off, noise.shape) ** 2
        return np.asarray(np.mean(self._weight * noise, axis=1)[:, None, None])

    @cached_property
    def _sensitivity(self) -> Array:
        """J (panels, cells, cells)."""
        return self.points.network.sensitivity()

    @property
    def _penalty(self) -> Part | None:
        part = residuals(self.points.batch.cost).penalties
        return part if len(part.term) else None

    @cached_property
    def _penalty_rows(self) -> Array:
        """√Ω Z (panels, rows, cells)."""
        part, points = residuals(self.points.batch.cost).penalties, self.points
        row, column = part.by_cells.pattern
        found = np.zeros((len(points.position), len(part.term), points.position.shape[1]))
        weight = np.sqrt(points.batch.weights[:, part.term])
        found[:, row, column] = points.called(part.by_cells) * np.exp(points.position)[:, column] * weight[:, row]
        return found

    @property
    def _of_penalties(self) -> Array:
        """The part of the variance that a penalty makes, (panels, cells, 1); see `DenseErrors.widening`."""
        part, rows = self._penalty, self._penalty_rows
        if part is None:
            return np.zeros((*self.points.position.shape, 1))
        pulls = rows @ self._inverse
        weight = self.points.batch.weights[:, part.term]
        squares = weight * self.points.called(part.value) ** 2 / self._scale[..., 0]
        known = min(rank(self.points.batch.cost.unweighted), rows.shape[2])
        determined = known - np.einsum("pij,pij->p", rows, pulls)
        widened = np.maximum(squares.sum(axis=1) / np.maximum(determined, 1.0), 1.0)
        size = self._scale * np.maximum(widened[:, None], squares)[..., None]
        return np.asarray((pulls**2).swapaxes(-1, -2) @ size)

    @cached_property
    def _inverse(self) -> Array:
        """A⁻¹ (panels, cells, cells)."""
        rows = self._sensitivity * np.sqrt(self._weight)[..., None]
        matrix = rows.swapaxes(-1, -2) @ rows
        if self._penalty is not None:
            matrix += self._penalty_rows.swapaxes(-1, -2) @ self._penalty_rows
        np.einsum("...ii->...i", matrix)[...] += IGNORANCE * self._scale[..., 0]
        return np.stack([positive_inverse(one) for one in matrix])

    @cached_property
    def _gain(self) -> Array:
        """K of errors of the readings, (panels, cells, cells)."""
        return np.asarray(self._inverse @ (self._sensitivity.swapaxes(-1, -2) * self._weight[:, None]))
