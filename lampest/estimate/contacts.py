"""Estimation of contact resistances by variable projection.

Contacts are estimated together with the unloaded panel or the joint first pair.

    minimise φ(u, c) + s² Σ ((c − mean)/sd)²   over u = log r and the contacts c

For given contacts the cells are solved as usual. A Gauss-Newton step in c then includes the
response of the cells. With E = ∂x/∂c, the Jacobian J, the curvature Ω of the data term and the gain
K of the cells

    S = Eᵀ Ω (E − J K E) + s²/sd²,   step = −S⁻¹ (½ ∂φ/∂c + s² (c − mean)/sd²),   cov c = s² S⁻¹.

S is the Schur complement of the cells; it is computed as a sum of squares to avoid cancellation.
Later frames take c as known, with cov c as an error that all readings share. Plain least squares
fits any contacts, so that they stay at their prior there. Source: Golub & Pereyra, SIAM J. Numer.
Anal. 10, 1973.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.estimate.state import AnyState, SequenceState, Step
from lampest.panel.difference_network import contact_responses
from lampest.panel.least_squares import LevenbergMarquardt
from lampest.panel.panel import Array
from lampest.panel.readouts.wiring import Contacts
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.posterior.track import errors_of
from lampest.recording.readings import Readings

# Two or three steps suffice, because readings are nearly linear in contacts. `settled` is the
# accuracy of the cells.
FIT = LevenbergMarquardt(evaluations=20, settled=1e-6, damping=0.0)


@dataclass(frozen=True, eq=False)
class SolvedContacts:
    """The cells solved for given contacts, as a sum of squares over the contacts.

    The sum has the normal matrix S/s².

    Attributes
    ----------
    step : Step
        Solution of the cells.
    ohm : array, shape (lines,)
        The contacts c, ohm.
    scale : float
        s².
    mean, precision : array, shape (lines,)
        Mean and 1/sd² of the prior, ohm and 1/ohm².
    """

    step: Step
    ohm: Array
    scale: float
    mean: Array
    precision: Array

    @property
    def cost(self) -> float:
        """½ (φ/s² + Σ ((c − mean)/sd)²); infinite where the cells have no optimum."""
        if self.step.surroundings() is None:
            return np.inf
        deviation = self.ohm - self.mean
        prior = (self.precision * deviation) @ deviation
        return float(self.step.solution.objective / self.scale + prior) / 2

    @cached_property
    def _model(self) -> LinearModel:
        """Linear model at the cells of the step, a verified optimum."""
        model = self.step.surroundings()
        assert model is not None
        return model

    @cached_property
    def _response(self) -> Array:
        """E, the derivative of the readings by the contacts, (readings, lines)."""
        return contact_responses(self._model.at.networks)

    @cached_property
    def gradient(self) -> Array:
        """Gradient of the cost with respect to the contacts, (lines,)."""
        by_readings = self._model.at.partials(np.clip(self._model.dual, -1, 1))[1]
        slope = self._response.T @ by_readings.ravel()
        return slope / (2 * self.scale) + self.precision * (self.ohm - self.mean)

    @cached_property
    def normal(self) -> Array:
        """S/s²."""
        model = self._model
        rows = model.through @ self._response
        errors = errors_of(model, None)
        # F = −∂u/∂c: the response of the free cells to contacts; `remaining` is E − J F
        response = errors.answer(rows)
        of_all_cells = model.over_all(response)
        remaining = rows - errors.forward(of_all_cells)
        penalised = model.penalty_jacobian @ of_all_cells
        # S = (E − J F)ᵀ Ω (E − J F) + ε s² FᵀF + (L F)ᵀ Λ (L F), equal to Eᵀ Ω (E − J F) but
        # without cancellation
        schur = (
            remaining.T @ (model.data_curvature[:, None] * remaining)
            + IGNORANCE * model.scale * response.T @ response
            + penalised.T @ (model.penalty_curvature[:, None] * penalised)
        )
        return np.asarray(schur / self.scale + np.diag(self.precision))


def with_contacts(
    state: AnyState,
    readings: Readings,
    solved: Step,
    solve: Callable[[SequenceState, Readings, Array], Step],
) -> tuple[AnyState, Step]:
    """Estimate the contacts of a state.

    Nothing is estimated where the scene names no contacts, or where the estimate has no error bars:
    these determine how well the contacts are known.

    Parameters
    ----------
    state : SequenceState
    readings : Readings
        Readings from which `solved` was solved.
    solved : Step
        Solution with the contacts at the prior's mean.
    solve : callable
        Solves the readings for another state, from given cells on.
    """
    prior = state.scene.contact_prior
    shape = state.scene.panel.shape
    model = solved.surroundings()
    if prior is None or state.track is None or model is None:
        return state, solved
    mean = prior.mean(shape)
    deviation = prior.deviation(shape)
    uncertain = deviation > 0
    seconds = [solved.seconds]
    # Contacts without a deviation stay where bounds hold them.
    precision = np.where(uncertain, deviation, 1.0) ** -2.0

    def solved_with(ohm: Array) -> SolvedContacts:
        step = solved
        if not np.array_equal(ohm, mean):
            contacts = Contacts.of(ohm, deviation, shape[0])
            trial = replace(state, scene=replace(state.scene, contacts=contacts))
            step = solve(trial, readings, solved.solution.cell_resistance)
            seconds.append(step.seconds)
        return SolvedContacts(step, ohm, model.scale, mean, precision)

    bounds = (np.where(uncertain, 0.0, mean), np.where(uncertain, np.inf, mean))
    _, fit = FIT.minimum(solved_with, mean, bounds)
    block = np.ix_(uncertain, uncertain)
    covariance = np.zeros(fit.normal.shape)
    covariance[block] = np.linalg.inv(fit.normal[block])
    contacts = Contacts.of(fit.ohm, np.sqrt(np.diag(covariance)), shape[0])
    scene = replace(state.scene, contacts=contacts)
    # All readings share the errors of the contacts.
    squares, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(squares, 0.0))
    shared = state.track.shared
    if shared is not None:
        shared = replace(shared, scene=scene, contact_root=root)
    state = replace(state, scene=scene, track=replace(state.track, shared=shared))
    return state, replace(fit.step, seconds=sum(seconds))
