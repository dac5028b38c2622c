"""Cells of which no reading of their own tells are known within a factor: to so much all cells answer along curves.

Without a penalty a missing reading is what its row and its column let expect (see `StandIn`); with one, the penalty
tells of its cell, and in ohm as much upwards as downwards. So the frame is solved again at both ends of what is likely
for each of them, and intervals reach as far as cells go where that is farther than their tangents tell.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lampest.cost.problem import Data
from lampest.estimate.step import Step
from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors
from lampest.posterior.interval import TWO_SIDED
from lampest.posterior.sampled import SampledErrors
from lampest.posterior.track import errors_of
from lampest.recording.readings import Readings
from lampest.recording.stand_in import StandIn

if TYPE_CHECKING:
    from lampest.estimate.stream import Stream

MOST = 8  # missing readings of a frame, of which each costs two to four solves; tangents serve for others
SHORT, LONGEST = 0.8, 3.0  # of the rise of φ at an end: below that one goes on; times as far, at most


@dataclass(frozen=True, eq=False)
class Departure:
    """straight : (rows, columns) how far log r goes by the tangent. ends : where it does go, at the lower and upper."""

    straight: Array
    ends: tuple[Array, Array]

    def reach(self, sign: int) -> Array:
        """The square of how far either end leads downwards (−1) or upwards (1)."""
        return np.maximum(np.fmax(sign * self.ends[0], sign * self.ends[1]), 0.0) ** 2


def far_off(stream: "Stream", readings: Readings, solved: Step) -> tuple[Array, Array]:
    """What to add to the squares of how far intervals of log r reach down and up, (rows, columns) each.

    As far as up to eight missing readings take cells, where that is farther than tangents tell.
    readings : (rows, columns) what `solved` was solved from, at the last of its frames.
    """
    nothing = np.zeros(readings.value.shape)
    model = solved.surroundings()
    places = np.argwhere(readings.missing(stream.scene))[:MOST]
    if model is None or not len(places):
        return nothing, nothing
    fixed = replace(stream, estimator=stream.estimator.with_weights(solved.weights))
    frame = HoledFrame(fixed, readings, solved, errors_of(model, None))
    departures = list(frame.of_cells(places) if stream.estimator.penalised else frame.of_stand_ins(places))
    straight = sum((gone.straight**2 for gone in departures), nothing)
    below, above = (sum((gone.reach(sign) for gone in departures), nothing) for sign in (-1, 1))
    return np.maximum(below - straight, 0.0), np.maximum(above - straight, 0.0)


@dataclass(frozen=True, eq=False)
class HoledFrame:
    """A solved frame whose readings are missing in part; errors : of its estimate."""

    stream: "Stream"
    readings: Readings
    solved: Step
    errors: DenseErrors | SampledErrors

    def of_stand_ins(self, places: NDArray[np.intp]) -> Iterator[Departure]:
        """What stands in for readings, at the ends of its spread."""
        spread = StandIn.of(self.readings.value, self.readings.plain).spread
        for row, column in places:
            unit = np.zeros(self.readings.value.shape)
            unit[row, column] = TWO_SIDED * spread[row, column]
            rows = self.errors.model.through @ (self.readings.value * unit).reshape(-1, 1)
            nothing = np.zeros((unit.size, 1))
            straight = self._whole(self.errors.answer(np.asarray(rows), nothing, nothing)[:, 0])
            down, up = (
                self._gone(replace(self.readings, value=self.readings.value * np.exp(side * unit)))[0]
                for side in (-1, 1)
            )
            yield Departure(straight, (down, up))

    def of_cells(self, places: NDArray[np.intp]) -> Iterator[Departure]:
        """Cells that were not read, at the ends of their intervals; those that press against a bound are none of them.

        An interval ends where φ has risen by 1.96² s² C, as it would have where the tangent ends if φ were a parabola.
        """
        model = self.errors.model
        cells = places @ (self.readings.value.shape[1], 1) + self._before
        for cell in cells[np.isin(cells, model.free)]:
            place = int(np.searchsorted(model.free, cell))
            column = self.errors.inverse_column(place)
            variance = self.errors.variance[place]
            rise = TWO_SIDED**2 * variance / column[place]
            ends = [self._end(cell, side * TWO_SIDED * np.sqrt(variance), rise) for side in (-1, 1)]
            yield Departure(self._whole(column / column[place] * TWO_SIDED * np.sqrt(variance)), (ends[0], ends[1]))

    def _end(self, cell: int, far: float, rise: float) -> Array:
        """Where log r goes with a cell (number) that goes so far, or farther until φ has risen."""
        ended, risen = self._gone(self.readings, self._holding(cell, far))
        if risen < SHORT * rise:
            farther = far * min(np.sqrt(rise / max(risen, 0.1 * rise)), LONGEST)
            beyond, _ = self._gone(self.readings, self._holding(cell, farther))
            return np.where(np.isnan(beyond), ended, beyond)
        return ended

    def _holding(self, cell: int, far: float) -> Callable[[Data], Data]:
        """Data that leave a cell (number) no choice but to be so far, in log r, from where it was found."""

        def held(data: Data) -> Data:
            lower, upper = data.lower.copy(), data.upper.copy()
            found = self.solved.solution.cell_resistance.ravel()[cell]
            there = np.clip(found * np.exp(far), lower.flat[cell], upper.flat[cell])
            lower.flat[cell] = upper.flat[cell] = there
            return replace(data, lower=lower, upper=upper)

        return held

    def _gone(self, readings: Readings, held: Callable[[Data], Data] = lambda data: data) -> tuple[Array, float]:
        """(where log r goes, (rows, columns), rise of φ) with other readings or data; NaN where no solve ends."""
        data, _ = self.stream.given(readings)
        ended = self.stream.solve(replace(held(data), hasty=True), self.solved.solution.cell_resistance)
        gone = np.asarray(np.log(ended.cell_resistance / self.solved.cell_resistance))
        return gone, float(ended.solution.objective - self.solved.solution.objective)

    @property
    def _before(self) -> int:
        """How many cells stand before those of the last frame."""
        return self.solved.solution.cell_resistance.size - self.readings.value.size

    def _whole(self, change: Array) -> Array:
        """The last frame's part (rows, columns) of a change of the free cells."""
        whole = np.zeros(self.solved.solution.cell_resistance.size)
        whole[self.errors.model.free] = change
        return whole[self._before :].reshape(self.readings.value.shape)
