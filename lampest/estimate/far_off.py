"""Cells of which no reading of their own tells are known within a factor: to so much all cells answer along curves.

Without a penalty a missing reading is what its row and its column let expect (see `StandIn`), and the frame is solved
again at both ends of what is likely for each of them. With one the penalty tells of its cell, and where others go with
it is followed (see `Along`). Intervals reach as far as cells go where that is farther than their tangents tell.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.step import Step
from lampest.panel.panel import Array
from lampest.posterior.along import Along
from lampest.posterior.dense import DenseErrors
from lampest.posterior.interval import TWO_SIDED
from lampest.posterior.sampled import SampledErrors
from lampest.posterior.track import errors_of
from lampest.recording.readings import Readings, StandIn

if TYPE_CHECKING:
    from lampest.estimate.stream import Stream

MOST = 3  # missing readings of a frame, of which each costs two solves or as much; tangents serve for others


@dataclass(frozen=True, eq=False)
class Departure:
    """straight : (rows, columns) how far log r goes by the tangent. ends : where it does go, at the lower and upper."""

    straight: Array
    ends: tuple[Array, Array]

    def reach(self, sign: int) -> Array:
        """The square of how far either end leads downwards (−1) or upwards (1); no end does that no solve reached."""
        return np.fmax(np.fmax(sign * self.ends[0], sign * self.ends[1]), 0.0) ** 2


def far_off(stream: "Stream", readings: Readings, solved: Step) -> tuple[Array, Array]:
    """What to add to the squares of how far intervals of log r reach down and up, (rows, columns) each.

    As far as up to three missing readings take cells, where that is farther than tangents tell.
    readings : (rows, columns) what `solved` was solved from, at the last of its frames.
    """
    nothing = np.zeros(readings.value.shape)
    model = solved.surroundings()
    places = np.argwhere(readings.missing(stream.scene))[:MOST]
    if model is None or not len(places):
        return nothing, nothing
    frame = HoledFrame(stream, readings, solved, errors_of(model, None))
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
            straight = np.zeros(self.solved.solution.cell_resistance.size)
            straight[self.errors.model.free] = self.errors.answer(np.asarray(rows), nothing, nothing)[:, 0]
            down, up = (
                self._gone(replace(self.readings, value=self.readings.value * np.exp(side * unit))) for side in (-1, 1)
            )
            yield Departure(self._last(straight), (down, up))

    def of_cells(self, places: NDArray[np.intp]) -> Iterator[Departure]:
        """Cells that were not read, at the ends of their intervals; none that press against a bound."""
        if not isinstance(self.errors, DenseErrors):
            return
        cells = places @ (self.readings.value.shape[1], 1) + self._before
        for cell in cells[np.isin(cells, self.errors.model.free)]:
            along = Along(self.errors, int(cell))
            yield Departure(self._last(along.tangent), (self._last(along.end(-1)), self._last(along.end(1))))

    def _gone(self, readings: Readings) -> Array:
        """Where log r goes, (rows, columns), with other readings; NaN where no solve ends."""
        data, _ = self.stream.given(readings)
        ended = self.stream.solve(replace(data, hasty=True), self.solved.solution.cell_resistance)
        return np.asarray(np.log(ended.cell_resistance / self.solved.cell_resistance))

    @property
    def _before(self) -> int:
        """How many cells stand before those of the last frame."""
        return self.solved.solution.cell_resistance.size - self.readings.value.size

    def _last(self, change: Array) -> Array:
        """The last frame's part (rows, columns) of a change of all cells."""
        return change[self._before :].reshape(self.readings.value.shape)
