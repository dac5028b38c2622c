"""Profile intervals: paths of all cells while a cell without a reading is moved to either end of its interval.

Without a penalty, `stand_in` replaces the missing reading, and the frame is solved again with both ends of its spread.
With a penalty, the valley of data and penalties is followed by continuation, δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c: a Gauss–Newton
step in which cell c moves by a given step, A = Jᵀ Ω J + Zᵀ Ω Z. The path ends where φ has risen by 1.96² s² C.
Sources: Venzon & Moolgavkar, Applied Statistics 37, 1988 (profile intervals); Allgower & Georg, Introduction to
Numerical Continuation Methods, 2003, chapter 2.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import TWO_SIDED
from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SampledErrors
from lampest.posterior.track import errors_of
from lampest.recording.readings import Readings, stand_in_spread

MAX_MISSING = 3  # missing readings with a profile; each costs about two solves, others are approximated by tangents
Ends = Iterator[tuple[Array, Array, Array]]  # (tangent, lower end, upper end), each (frames · cells) of log r


@dataclass(frozen=True, eq=False)
class ProfileInterval:
    """Interval of a cell by its profile likelihood.

    Attributes
    ----------
    errors : DenseErrors
        Errors of the estimate, in which the cell is a free one.
    cell : int
        Number of the cell.
    steps : int
        Steps along the length of the tangent. With these, the path ends within a tenth of an optimum with the cell
        held.
    max_step : float
        Largest step of the cell's log r.
    max_tangents : float
        Maximum length of the path in lengths of the tangent: a penalty in ohm rises slowly towards a short.
    max_steps : int
        Maximum number of steps, which reach a factor of 20,000: the tangent of an undetermined cell has no end.
    """

    errors: DenseErrors
    cell: int
    steps: int = 3
    max_step: float = 0.5
    max_tangents: float = 3.0
    max_steps: int = 20

    @property
    def _place(self) -> int:
        """Position of the cell among the free cells."""
        return int(np.searchsorted(self.errors.model.free, self.cell))

    @property
    def tangent(self) -> Array:
        """Change of log r of all cells, in linear approximation, if the cell moves to its upper end, (cells,)."""
        # A⁻¹ e_c/(A⁻¹)_cc·1.96·σ_c
        column, change = self.errors.inverse[:, self._place], np.zeros(self.errors.model.at.cell_resistance.size)
        far = TWO_SIDED * np.sqrt(self.errors.variance[self._place])
        change[self.errors.model.free] = column / column[self._place] * far
        return change

    def end(self, side: int) -> Array:
        """Return the change of log r of all cells at the lower (side −1) or the upper (1) end, (cells,)."""
        model, place = self.errors.model, self._place
        # Rise of φ at the end: 1.96² s² C = 1.96² S_cc/(A⁻¹)_cc
        most = TWO_SIDED**2 * self.errors.variance[place] / self.errors.inverse[place, place]
        far = self.tangent[self.cell]
        step, risen, before = side * min(far / self.steps, self.max_step), 0.0, 0.0
        ended = model.at.position
        for position, force in self._path(step, round(min(self.max_tangents * far / abs(step), self.max_steps))):
            # Rise of φ along the path by the trapezoidal rule, with the force λ = ½ dφ/du_c.
            ended, risen, before = position, risen + step * (before + force), force
            if risen >= most:
                break
        return np.asarray((ended - model.at.position).ravel())

    def _path(self, step: float, most: int) -> Iterator[tuple[Array, float]]:
        """Yield (log r (frames, rows, columns), λ) after each of at most `most` steps, until a bound holds the cell."""
        errors = self.errors
        for _ in range(most):
            model = errors.model
            if self.cell not in model.free:
                return
            place = int(np.searchsorted(model.free, self.cell))
            # δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c with λ such that δ_c = step
            newton, column = -errors.inverse @ model.gradient[model.free] / 2, errors.inverse[:, place]
            force = (step - newton[place]) / column[place]
            change = np.zeros(model.at.position.size)
            change[model.free] = newton + force * column
            change *= min(1.0, 2 * self.max_step / float(np.abs(change).max()))
            position = model.at.position + change.reshape(model.at.position.shape)
            position = np.clip(position, *model.at.data.log_bounds)
            yield position, float(force)
            errors = DenseErrors(replace(model, at=model.at.elsewhere(np.exp(position))))


def beyond_tangents(
    model: LinearModel, readings: Readings, missing: NDArray[np.bool_], moved: Callable[[Readings], Array] | None
) -> tuple[Array, Array]:
    """Return the increase of the squared extents of intervals below and above by profiles, (rows, columns) each.

    Parameters
    ----------
    model : LinearModel
        Linear model about the estimate.
    readings : Readings
        Readings of the frame, (rows, columns).
    missing : boolean array, shape (rows, columns)
        Whether a reading is missing.
    moved : callable or None
        Readings → change of log r (rows, columns), NaN if the solve fails. None if a penalty determines the cells.
    """
    errors, shape = errors_of(model, None), readings.value.shape
    places = np.argwhere(missing)[:MAX_MISSING]
    first = model.at.cell_resistance.size - readings.value.size
    profiles = _profiled(errors, places @ (shape[1], 1) + first)
    if moved is not None:
        profiles = _stood_in(errors, readings, places, moved)
    straight, below, above = np.zeros((3, *shape))
    for ends in profiles:
        tangent, low, high = (change.ravel()[-readings.value.size :].reshape(shape) for change in ends)
        straight += tangent**2
        # Ends of failed solves are NaN, which fmax ignores.
        below += np.fmax(np.fmax(-low, -high), 0.0) ** 2
        above += np.fmax(np.fmax(low, high), 0.0) ** 2
    return np.maximum(below - straight, 0.0), np.maximum(above - straight, 0.0)


def _profiled(errors: DenseErrors, cells: NDArray[np.intp]) -> Ends:
    """Yield the profile ends of unread cells (numbers), except cells at a bound and those of large panels."""
    for cell in cells[np.isin(cells, errors.model.free)] if not isinstance(errors, SampledErrors) else ():
        profile = ProfileInterval(errors, int(cell))
        yield profile.tangent, profile.end(-1), profile.end(1)


def _stood_in(
    errors: DenseErrors, readings: Readings, places: NDArray[np.intp], moved: Callable[[Readings], Array]
) -> Ends:
    """Yield the ends by solving again with each missing reading's substitute at both ends of its spread."""
    spread, model = stand_in_spread(readings.value, readings.plain), errors.model
    for row, column in places:
        unit = np.zeros(readings.value.shape)
        unit[row, column] = TWO_SIDED * spread[row, column]
        rows = np.asarray(model.through @ (readings.value * unit).reshape(-1, 1))
        nothing, tangent = np.zeros((unit.size, 1)), np.zeros(model.at.cell_resistance.size)
        tangent[model.free] = errors.answer(rows, nothing, nothing)[:, 0]
        ends = [moved(replace(readings, value=readings.value * np.exp(side * unit))) for side in (-1, 1)]
        yield tangent, ends[0], ends[1]
