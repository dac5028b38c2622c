"""Profile intervals: paths of all cells while a cell without a reading is moved to either end of its interval.

Without a penalty, `stand_in` replaces the missing reading, and the frame is solved again with both ends of its spread.
With a penalty, the valley of data and penalties is followed by continuation, δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c: a Gauss–Newton
step in which cell c moves by a given step, A = Jᵀ Ω J + Zᵀ Ω Z. The path ends where φ has risen by 1.96² s² C.
Sources: Venzon & Moolgavkar, Applied Statistics 37, 1988 (profile intervals); Allgower & Georg, Introduction to
Numerical Continuation Methods, 2003, chapter 2.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import TWO_SIDED
from lampest.panel.panel import Array
from lampest.posterior.covariance import DenseErrors, SampledErrors, errors_of
from lampest.posterior.linear import LinearModel
from lampest.recording.readings import Readings, stand_in_spread

MAX_MISSING = 3  # missing readings with a profile; each costs about two solves, others are approximated by tangents
STEPS = 3  # along the length of the tangent: the path then ends within a tenth of an optimum with the cell held
MAX_STEP = 0.5  # largest step of the cell's log r
MAX_TANGENTS = 3.0  # length of the path in lengths of the tangent: a penalty in ohm rises slowly towards a short
MAX_STEPS = 20  # which reach a factor of 20,000: the tangent of an undetermined cell has no end


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
    errors, size = errors_of(model, None), readings.value.size
    straight, below, above = np.zeros((3, size))
    for place in np.flatnonzero(missing)[:MAX_MISSING]:
        cell = int(place) + model.at.cell_resistance.size - size
        if moved is not None:
            changes = _stood_in(errors, readings, int(place), moved)
        elif cell in model.free and not isinstance(errors, SampledErrors):
            changes = tangent(errors, cell), profile_end(errors, cell, -1), profile_end(errors, cell, 1)
        else:
            continue
        along, low, high = (change.ravel()[-size:] for change in changes)
        straight += along**2
        # Ends of failed solves are NaN, which fmax ignores.
        below += np.fmax(np.fmax(-low, -high), 0.0) ** 2
        above += np.fmax(np.fmax(low, high), 0.0) ** 2
    further = (np.maximum(end - straight, 0.0).reshape(readings.value.shape) for end in (below, above))
    return next(further), next(further)


def tangent(errors: DenseErrors, cell: int) -> Array:
    """Return the change of log r of all cells, in linear approximation, if a free cell moves to its upper end."""
    place = int(np.searchsorted(errors.model.free, cell))
    # A⁻¹ e_c/(A⁻¹)_cc·1.96·σ_c
    column, change = errors.inverse[:, place], np.zeros(errors.model.at.cell_resistance.size)
    change[errors.model.free] = column / column[place] * (TWO_SIDED * np.sqrt(errors.variance[place]))
    return change


def profile_end(errors: DenseErrors, cell: int, side: int) -> Array:
    """Return the change of log r of all cells at a free cell's lower (side −1) or upper (1) end, (cells,)."""
    begin, far = errors.model.at, tangent(errors, cell)[cell]
    place = int(np.searchsorted(errors.model.free, cell))
    # Rise of φ at the end: 1.96² s² C = 1.96² S_cc/(A⁻¹)_cc
    most = TWO_SIDED**2 * errors.variance[place] / errors.inverse[place, place]
    step, risen, before, position = side * min(far / STEPS, MAX_STEP), 0.0, 0.0, begin.position
    for _ in range(round(min(MAX_TANGENTS * far / abs(step), MAX_STEPS))):
        model = errors.model
        if cell not in model.free:  # a bound holds it
            break
        place = int(np.searchsorted(model.free, cell))
        # δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c with λ such that δ_c = step
        newton, column = -errors.inverse @ model.gradient[model.free] / 2, errors.inverse[:, place]
        force = float((step - newton[place]) / column[place])
        change = np.zeros(position.size)
        change[model.free] = newton + force * column
        change *= min(1.0, 2 * MAX_STEP / float(np.abs(change).max()))
        position = np.clip(position + change.reshape(position.shape), *begin.data.log_bounds)
        # Rise of φ along the path by the trapezoidal rule, with the force λ = ½ dφ/du_c.
        risen, before = risen + step * (before + force), force
        if risen >= most:
            break
        errors = DenseErrors(replace(model, at=begin.elsewhere(np.exp(position))))
    return np.asarray((position - begin.position).ravel())


def _stood_in(
    errors: DenseErrors, readings: Readings, place: int, moved: Callable[[Readings], Array]
) -> tuple[Array, Array, Array]:
    """Return tangent and ends by solving again with a reading's substitute (number) at both ends of its spread."""
    model, unit = errors.model, np.zeros(readings.value.shape)
    unit.flat[place] = TWO_SIDED * stand_in_spread(readings.value, readings.plain).flat[place]
    rows = np.asarray(model.through @ (readings.value * unit).reshape(-1, 1))
    along = np.zeros(model.at.cell_resistance.size)
    along[model.free] = errors.answer(rows)[:, 0]
    low, high = (moved(replace(readings, value=readings.value * np.exp(side * unit))) for side in (-1, 1))
    return along, low, high
