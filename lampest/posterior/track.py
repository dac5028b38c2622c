"""Error bars along a sequence: of every frame, of its change, and around missing readings.

Intervals of cells around one whose reading is missing are profiles: the paths of all cells while
that one is moved to either end of its interval. Without a penalty, `stand_in` replaces the missing
reading, and the frame is solved again with both ends of its spread. With a penalty, the valley of
data and penalties is followed by continuation, δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c: a Gauss–Newton step in
which cell c moves by a given step, A = Jᵀ Ω J + Zᵀ Ω Z. The path ends where φ has risen by 1.96² s²
C.
Sources: Venzon & Moolgavkar, Applied Statistics 37, 1988 (profile intervals); Allgower & Georg,
Introduction to Numerical Continuation Methods, 2003, chapter 2.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.files.levels import TWO_SIDED
from lampest.files.typed import ReadOnlyArrays
from lampest.panel.effects import Shared
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.certainty import Certainty, common_variance
from lampest.posterior.covariance import (
    DenseErrors,
    DenseMemory,
    Memory,
    active_bounds,
    answer_to_scatter,
)
from lampest.posterior.linear import LinearModel
from lampest.recording.readings import Readings, stand_in_spread

if TYPE_CHECKING:
    from lampest.posterior.frame_noise import FrameNoise
    from lampest.posterior.sparse_prior import Held

# Missing readings with a profile; each costs about two solves, others are approximated by tangents.
MAX_MISSING = 3
# Along the length of the tangent: the path then ends within a tenth of an optimum with the cell
# held.
STEPS = 3
MAX_STEP = 0.5  # largest step of the cell's log r
# Length of the path in lengths of the tangent: a penalty in ohm rises slowly towards a short.
MAX_TANGENTS = 3.0
MAX_STEPS = 20  # which reach a factor of 20,000: the tangent of an undetermined cell has no end


@dataclass(frozen=True, eq=False)
class Bars(ReadOnlyArrays):
    """Error bars of one frame, all arrays (rows, columns).

    Attributes
    ----------
    frame : Certainty
        Certainty of log r.
    change : Certainty or None
        Certainty of the change from the baseline; None if that of the baseline is not known.
    reading : array or None
        Standard deviation of the modelled readings, without noise; None if not computed.
    held : Held or None
        What absolute losses with chosen weights hold of changes; None without, or on large panels.
    """

    frame: Certainty
    change: Certainty | None
    reading: Array | None = None
    held: "Held | None" = None

    def reaching_farther(self, below: Array, above: Array) -> "Bars":
        """Return bars with extended intervals; see `Certainty.reaching_farther`."""
        frame = self.frame.reaching_farther(below, above)
        change = self.change and self.change.reaching_farther(below, above)
        return replace(self, frame=frame, change=change)


@dataclass(frozen=True, eq=False)
class Track(ReadOnlyArrays):
    """State of the error bars along a sequence: errors on which those of later frames depend.

    Attributes
    ----------
    shared : Shared or None
        Systematic errors that the readings of all frames share.
    baseline : Certainty or None
        Certainty of the baseline.
    deviation : array, shape (rows, columns), or None
        Standard deviation of log r of the last frame without shared errors; None where it has no
        error bars.
    memory : Memory or None
        Errors of the last frame and of the baseline.
    answers : array, shape (2, cells, n), or None
        Effect of shared errors on log r of the last frame (0), and on that of the baseline (1).
    noise : FrameNoise or None
        Random errors that the readings of one frame share.
    """

    shared: Shared | None = None
    baseline: Certainty | None = None
    deviation: Array | None = None
    memory: Memory | None = None
    answers: Array | None = None
    noise: "FrameNoise | None" = None

    def resting(self, model: LinearModel, *, remembered: bool) -> "Track":
        """Return the track after a baseline that is solved alone.

        `remembered` states whether later frames compare with it. Raises numpy.linalg.LinAlgError if
        the cost is flat.
        """
        errors = self._errors(model, baseline=True)
        answer, certainty = self._answered(errors)
        return replace(
            self,
            baseline=certainty.of_frame(0),
            deviation=errors.certainty.deviation[0],
            memory=errors.memory().resting() if remembered else None,
            answers=np.stack([answer, answer]),
        )

    def advanced(self, model: LinearModel) -> tuple["Track", Bars, LinearModel]:
        """Return the track after a frame, or after a baseline and a first frame solved together.

        Raises numpy.linalg.LinAlgError if the cost is flat.

        Returns
        -------
        track : Track
        bars : Bars
            Error bars of the frame.
        model : LinearModel
            The model with sites for absolute losses whose weights the data chose.
        """
        shape = model.cells[0].shape
        joint = len(model.cells) == 2
        errors = self._errors(model, baseline=joint)
        answers, certainty = self._answered(errors)
        answer = answers[-np.prod(shape) :]
        frame = certainty.of_frame(-1)
        baseline = self.baseline
        resting = answer if self.answers is None else self.answers[1]
        if joint:
            baseline = certainty.of_frame(0)
            resting = answers[: len(answer)]
        memory = None
        if any(term.needs_previous for term in model.at.cost.terms):
            memory = errors.memory()
        change = None
        if baseline is not None:
            # Common parts: cov(a, b) = (var a + var b − var(a − b))/2. Whole errors: Σ a·b plus
            # that in memory
            common = (
                common_variance(answer)
                + common_variance(resting)
                - common_variance(answer - resting)
            ) / 2
            covariance = np.sum(answer * resting, axis=1)
            if memory is not None:
                covariance = covariance + memory.shared()
            change = frame.less(baseline, covariance.reshape(shape), common.reshape(shape))
        track = replace(
            self,
            baseline=baseline,
            deviation=errors.certainty.deviation[-1],
            memory=memory,
            answers=np.stack([answer, resting]),
        )
        held = None
        if errors.exact and model.chosen_absolute.any():
            from lampest.posterior.sparse_prior import Held

            held = Held.by(errors.model, errors.sensitivity)
        bars = Bars(frame, change, errors.reading_deviation()[-1], held)
        return track, bars, errors.model

    def _errors(self, model: LinearModel, *, baseline: bool) -> DenseErrors:
        """Return the errors of an estimate, with V.

        `baseline` states whether the first frame is the mean of the unloaded ones.
        """
        drawn = None
        if self.noise is not None:
            columns = self.noise.columns(model.at.data.measured, baseline=baseline)
            drawn = model.through @ columns
        return errors_of(model, self.memory, drawn)

    def _answered(self, errors: DenseErrors) -> tuple[Array, Certainty]:
        """Return the effect of shared errors on log r, and the certainty including them.

        The effect has shape (frames · cells, n).
        """
        model = errors.model
        bars = errors.certainty
        cells = model.cells
        measured = model.at.data.measured
        if self.shared is None:
            return np.zeros((cells.size, 0)), bars
        # U of every frame, and its effect on log r; cells at bounds are treated one by one.
        pairs = zip(model.at.networks, measured, strict=True)
        columns = np.concatenate([self.shared.columns(*pair) for pair in pairs])
        own = columns.shape[1]
        scatter = 0.0 if self.shared.possible is None else self.shared.possible.film_scatter
        if scatter:
            # one more error for each cell of a frame, which no reading has
            columns = np.pad(columns, ((0, 0), (0, cells[0].size)))
        previous = self.answers
        if previous is None:
            previous = np.zeros((2, cells[0].size, columns.shape[1]))
        answer = np.zeros((cells.size, columns.shape[1]))
        rows = model.through @ columns
        if errors.exact and (model.at_lower | model.at_upper).any():
            answer[model.free], held, below, above = active_bounds(errors, rows, previous)
            bars = bars.reaching(held, below, above)
        else:
            answer[model.free] = errors.answer(rows, previous)
        if scatter and errors.exact:
            answer[model.free, own:] += answer_to_scatter(errors, scatter)
        # r ≥ R: the bound has its reading's error
        read = model.at_lower & (model.at.data.lower == measured).ravel()
        answer[read] = columns[read] / measured.ravel()[read, None]
        return answer, bars.widened(answer)


def beyond_tangents(
    model: LinearModel,
    readings: Readings,
    missing: Mask,
    moved: Callable[[Readings], Array] | None,
) -> tuple[Array, Array]:
    """Return the increase of the squared extents of intervals below and above by profiles.

    Parameters
    ----------
    model : LinearModel
        Linear model about the estimate, with the sites of its error bars.
    readings : Readings
        Readings of the frame, (rows, columns).
    missing : boolean array, shape (rows, columns)
        Whether a reading is missing.
    moved : callable or None
        Readings → change of log r (rows, columns), NaN if the solve fails. None if a penalty
        determines the cells.

    Returns
    -------
    below, above : array, shape (rows, columns)
        Increase of the squared extent of log r.
    """
    errors = errors_of(model, None)
    size = readings.value.size
    straight, below, above = np.zeros((3, size))
    for place in np.flatnonzero(missing)[:MAX_MISSING]:
        cell = int(place) + model.cells.size - size
        if moved is not None:
            # Tangent, and the frame solved again with the substitute at both ends of its spread
            spread = stand_in_spread(readings.value, readings.plain).flat[place]
            unit = np.zeros(readings.value.shape)
            unit.flat[place] = TWO_SIDED * spread
            rows = model.through @ (readings.value * unit).reshape(-1, 1)
            low, high = (
                moved(replace(readings, value=readings.value * np.exp(side * unit)))
                for side in (-1, 1)
            )
            changes = (model.over_all(errors.answer(rows)[:, 0]), low, high)
        elif cell in model.free and errors.exact:
            low, high = (profile_end(errors, cell, side) for side in (-1, 1))
            changes = (tangent(errors, cell), low, high)
        else:
            continue
        along, low, high = (change.ravel()[-size:] for change in changes)
        straight += along**2
        # Ends of failed solves are NaN, which fmax ignores.
        below += np.fmax(np.fmax(-low, -high), 0.0) ** 2
        above += np.fmax(np.fmax(low, high), 0.0) ** 2
    further = np.maximum([below - straight, above - straight], 0.0)
    further_below, further_above = further.reshape(2, *readings.value.shape)
    return further_below, further_above


def beyond_bounds(model: LinearModel, below: Array) -> tuple[Array, Array]:
    """Return the increase of the squared extents of intervals by cells whose reading is a bound.

    A reading at a rail bounds its cell on one side: it conducts at least so much. Readings of its
    lines depend on this conductance, an exponential of log r, of which the tangent shows little.
    All such cells move together to the lower ends of their intervals. The others follow by
    Gauss–Newton steps, δ = −A⁻¹ (∇φ/2 + H δ_s), with H = Jᵀ Ω J + Zᵀ Ω Z and δ_s the step of the
    moved cells.

    Parameters
    ----------
    model : LinearModel
        Linear model about the estimate, with the sites of its error bars.
    below : array, shape (rows, columns)
        Extents of the intervals of log r below the estimate.

    Returns
    -------
    below, above : array, shape (rows, columns)
        Increase of the squared extent of log r; 0 for the moved cells.
    """
    begin = model.at
    errors = errors_of(model, None)
    before = model.cells.size - below.size  # cells of a baseline in the same solve
    own = np.diag(begin.networks[-1].sensitivity())
    # Cells that may fall: the reading is at least its value and rises, or is at most and falls.
    falling = np.flatnonzero(np.ravel(begin.data.given.side[-1]) * own < 0)
    moved = np.intersect1d(before + falling, model.free)
    others = np.setdiff1d(model.free, moved)
    straight: Array = np.zeros(model.cells.size)
    change: Array = straight
    if len(moved) and len(others) and errors.exact:
        fall = np.zeros(model.cells.size)
        fall[moved] = -np.minimum(below.ravel()[moved - before], MAX_STEPS * MAX_STEP)
        straight = _followed(errors, others, fall)
        steps = int(np.ceil(-fall.min() / MAX_STEP))
        for _ in range(steps):
            step = _followed(errors, others, fall / steps)
            if np.abs(step).max() > 2 * MAX_STEP:
                break  # the readings hardly determine the others: they would run to their bounds
            change = change + step
            position = begin.position + change.reshape(begin.position.shape)
            position = np.clip(position, *begin.data.log_bounds)
            errors = DenseErrors(replace(model, at=begin.elsewhere(np.exp(position))))
        straight[moved] = change[moved]
    farther = np.maximum(change**2 - straight**2, 0.0)
    ends = np.stack([np.where(change < 0, farther, 0.0), np.where(change > 0, farther, 0.0)])
    of_below, of_above = ends[:, before:].reshape(2, *below.shape)
    return of_below, of_above


def _followed(errors: DenseErrors, others: Numbers, fall: Array) -> Array:
    """Return the change of log r of all cells, (cells,), if free cells (numbers) follow a fall."""
    model = errors.model
    # A bound may hold some of them on the path.
    follow = np.isin(model.free, others)
    penalised = model.penalty_curvature * (model.penalty_jacobian @ fall)
    pull = errors.weighed(errors.forward(fall[:, None]))[:, 0]
    pull += model.penalty_jacobian.T @ penalised + model.gradient / 2
    factor = cho_factor(errors.normal[np.ix_(follow, follow)], check_finite=False)
    change = fall.copy()
    change[model.free[follow]] -= cho_solve(factor, pull[model.free[follow]], check_finite=False)
    return change


def errors_of(model: LinearModel, memory: Memory | None, drawn: Array | None = None) -> DenseErrors:
    """Return the errors of an estimate, as matrices or, of large panels, from samples.

    Parameters
    ----------
    model : LinearModel
    memory : Memory or None
        Errors of the previous frame and of the baseline.
    drawn : array, shape (data rows, n), or None
        V, random errors that the readings of a frame share.
    """
    dense = memory is None or isinstance(memory, DenseMemory)
    if dense and model.cells.size <= MAX_DENSE:
        errors = DenseErrors(model, memory, drawn)
        if model.sites is not None or not model.chosen_absolute.any():
            return errors
        from lampest.posterior.sparse_prior import with_sites

        return with_sites(errors)
    from lampest.posterior.sampled import SampledErrors

    return SampledErrors(model, None if dense else memory, drawn)


def tangent(errors: DenseErrors, cell: int) -> Array:
    """Return the change of log r of all cells if a free cell moves to its upper end, linearised."""
    place = int(np.searchsorted(errors.model.free, cell))
    # A⁻¹ e_c/(A⁻¹)_cc·1.96·σ_c
    column = errors.inverse[:, place]
    return errors.model.over_all(
        column / column[place] * (TWO_SIDED * np.sqrt(errors.variance[place]))
    )


def profile_end(errors: DenseErrors, cell: int, side: int) -> Array:
    """Return the change of log r of all cells at a free cell's end, (cells,).

    The end is the lower (side −1) or upper (1) one.
    """
    begin = errors.model.at
    far = tangent(errors, cell)[cell]
    place = int(np.searchsorted(errors.model.free, cell))
    # Rise of φ at the end: 1.96² s² C = 1.96² S_cc/(A⁻¹)_cc
    most = TWO_SIDED**2 * errors.variance[place] / errors.inverse[place, place]
    step = side * min(far / STEPS, MAX_STEP)
    rise = 0.0
    previous_force = 0.0
    position = begin.position
    for _ in range(round(min(MAX_TANGENTS * far / abs(step), MAX_STEPS))):
        model = errors.model
        if cell not in model.free:  # a bound holds it
            break
        place = int(np.searchsorted(model.free, cell))
        # δ = −A⁻¹ ∇φ/2 + λ A⁻¹ e_c with λ such that δ_c = step
        right = np.stack([-model.gradient[model.free] / 2, np.zeros(len(model.free))], axis=1)
        right[place, 1] = 1.0
        factor = cho_factor(errors.normal, check_finite=False)
        newton, column = cho_solve(factor, right, check_finite=False).T
        force = (step - newton[place]) / column[place]
        change = model.over_all(newton + force * column)
        change *= min(1.0, 2 * MAX_STEP / np.abs(change).max())
        position = np.clip(position + change.reshape(position.shape), *begin.data.log_bounds)
        # Rise of φ along the path by the trapezoidal rule, with the force λ = ½ dφ/du_c.
        rise = rise + step * (previous_force + force)
        previous_force = force
        if rise >= most:
            break
        errors = DenseErrors(replace(model, at=begin.elsewhere(np.exp(position))))
    return (position - begin.position).ravel()
