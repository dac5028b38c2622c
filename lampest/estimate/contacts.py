"""Contact resistances that are estimated beside the cells, once, with the unloaded panel (or the joint first pair).

The least of φ(u, c) + s² Σ ((c − mean)/sd)² over log r = u and contacts c, by variable projection: for given contacts
the cells are solved as ever; a Gauss-Newton step in c then knows that they would follow. With E = ∂x/∂c and the gain K

    S = Eᵀ Ω (E − J K E) + s²/sd²,   step = −S⁻¹ (½ ∂φ/∂c + s² (c − mean)/sd²),   cov c = s² S⁻¹,

written as the squares of what is left of E, of what the penalties then charge, and of the prior, none of which cancels:
∂φ/∂u = 0 where the cells are solved (envelope theorem), S is the Schur complement of the cells. Frames that follow take
c as known but for cov c, an error that all readings share (`lampest.panel.systematic`). Plain least squares fits any
contacts, so they stay at their prior there. Source: Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lampest.estimate.step import Step
from lampest.panel.panel import Array
from lampest.panel.readouts.wired import contact_responses
from lampest.panel.readouts.wiring import Contacts
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.posterior.track import errors_of
from lampest.recording.readings import Readings

if TYPE_CHECKING:
    from lampest.estimate.stream import Stream

MOST_ROUNDS, MOST_HALVINGS = 10, 5  # a step or two suffice: readings are nearly linear in contacts
SETTLED = 1e-3  # of a contact's standard deviation
ROUNDING = 1e-9  # of what is minimised: cells are solved no better


@dataclass(frozen=True, eq=False)
class ContactStep:
    """move : (lines) ohm, from here to where the cost is least. covariance : (lines, lines) ohm². scale : s²."""

    move: Array
    covariance: Array
    scale: float

    @classmethod
    def of(cls, model: LinearModel, ohm: Array, mean: Array, deviation: Array) -> "ContactStep":
        """At cells that are solved for contacts `ohm`; all (lines) ohm. Contacts without a deviation stay."""
        at = model.at
        response = contact_responses(at.networks)
        rows = model.through @ response
        follow = errors_of(model, None).answer(rows, *np.zeros((2, at.cell_resistance[0].size, len(ohm))))
        left = rows - model.through @ _forward(model, follow)
        charged = model.penalty_jacobian[:, model.free] @ follow
        sought = deviation > 0
        precision = model.scale / np.where(sought, deviation, 1.0) ** 2
        slope = response.T @ at.partials(np.clip(model.dual, -1, 1))[1].ravel() / 2 + precision * (ohm - mean)
        schur = left.T @ (model.data_curvature[:, None] * left) + np.diag(precision)
        schur += charged.T @ (model.penalty_curvature[:, None] * charged) + IGNORANCE * model.scale * follow.T @ follow
        inverse = np.zeros(schur.shape)
        inverse[np.ix_(sought, sought)] = np.linalg.inv(schur[np.ix_(sought, sought)])
        return cls(-inverse @ slope, model.scale * inverse, model.scale)


def _forward(model: LinearModel, follow: Array) -> Array:
    """J·p (frames · cells, n) of steps p (free cells, n)."""
    shape, count = model.at.cell_resistance.shape, follow.shape[1]
    whole = np.zeros((count, model.at.cell_resistance.size))
    whole[:, model.free] = follow.T
    steps = whole.reshape(count, *shape)
    networks = enumerate(model.at.networks)
    forward = [np.stack([network.forward(step) for step in steps[:, frame]]) for frame, network in networks]
    return np.stack(forward, axis=1).reshape(count, -1).T


def with_contacts(stream: "Stream", readings: Readings, solved: Step) -> tuple["Stream", Step]:
    """The stream that knows its contacts, and the step that was solved for them.

    readings : what `solved` was solved from. As they are where the scene names no contacts, or the estimate gets no
    error bars, which are what tells how well they are known.
    """
    prior, shape = stream.scene.contacts, stream.scene.panel.shape
    if prior is None or stream.track is None:
        return stream, solved
    mean, deviation = prior.mean(shape), prior.deviation(shape)
    ohm, found, covariance = mean, solved, np.diag(deviation**2)

    def excess(trial: Step, there: Array, scale: float) -> float:
        """φ/s² with the prior's part."""
        far = (there - mean) / np.where(deviation > 0, deviation, 1.0)
        return trial.solution.objective / scale + float(far @ far)

    for _ in range(MOST_ROUNDS):
        model = found.surroundings()
        if model is None:
            return stream, solved
        step = ContactStep.of(model, ohm, mean, deviation)
        covariance = step.covariance
        if np.all(np.abs(step.move) <= SETTLED * deviation):
            break
        for halving in range(MOST_HALVINGS):
            there = np.maximum(ohm + step.move * 0.5**halving, 0.0)
            trial = _solved(stream, readings, Contacts.of(there, deviation, shape[0]), found)
            before = excess(found, ohm, step.scale)
            if trial.solution.solved and excess(trial, there, step.scale) <= before + ROUNDING * (1 + before):
                break
        else:
            break
        ohm, found = there, replace(trial, seconds=found.seconds + trial.seconds)
    told = Contacts.of(ohm, np.sqrt(np.diag(covariance)), shape[0])
    scene = replace(stream.scene, contacts=told)
    vectors, squares = np.linalg.eigh(covariance)[::-1]
    root = vectors * np.sqrt(np.maximum(squares, 0.0))
    shared = stream.track.shared and replace(stream.track.shared, scene=scene, contact_root=root)
    return replace(stream, scene=scene, track=replace(stream.track, shared=shared)), found


def _solved(stream: "Stream", readings: Readings, contacts: Contacts, near: Step) -> Step:
    """The cells for other contacts, begun at those that are known."""
    trying = replace(stream, scene=replace(stream.scene, contacts=contacts))
    data, _ = trying.given(readings)
    return trying.solve(data, near.solution.cell_resistance)
