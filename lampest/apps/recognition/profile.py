"""Profile of a fit along its diameter, where the curvature at its maximum is not its width."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
from scipy.special import softmax

from lampest.apps.recognition.fit import (
    MAX_ROUNDS,
    SEARCH,
    CellLikelihood,
    Fit,
    FitPoint,
    Fitting,
    inverse_beside_prior,
)
from lampest.recording.shapes.disc import POINTS

# Difference of ln P at the end of a profile, the evaluations and the largest number of points to
# each side, and by how much a step is longer than the one before.
NEGLIGIBLE = 5.0
PROFILE_STEPS = 5
MAX_PROFILE = 6
FARTHER = 1.5


def along_diameter(fitting: Fitting, fit: Fit, likelihood: CellLikelihood) -> Fit:
    """Return the fit with the posterior covariance by a profile along ln d, where that is wider.

    A profile may lead over a ridge of the cost into a deeper valley. The fit then begins again
    there.

    No reading depends on a rim between patches: the cost is flat there and steep around it, and the
    curvature at the best φ̂ underestimates the width. δ = ln d is stepped, and all other parameters
    are fitted for each δ:

        P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̂)(φ(δ) − φ̂)ᵀ).

    Parameters
    ----------
    fitting : Fitting
        The problem of the fit's candidate.
    fit : Fit
        A fit without a diameter is returned unchanged.
    likelihood : CellLikelihood
        The circuit linearised at the fit.
    """
    names = list(fit.candidate.priors(fitting.frame.panel))
    if "diameter" not in names:
        return fit
    place = names.index("diameter")
    sd = fitting.candidate.sd(fitting.frame.panel)
    remaining = np.ix_(*2 * [np.arange(len(names)) != place])
    points = _profile(fitting, fit, likelihood, place)
    for _ in range(MAX_ROUNDS):
        lowest = min(points, key=attrgetter("cost"))
        begin = fitting.effect(fit.parameters)
        if lowest.cost > fitting.at(begin, likelihood).cost - SEARCH.settled:
            break
        fit = fitting.best(lowest.effect, likelihood.whitening)
        likelihood = CellLikelihood.about(fitting.frame, likelihood.whitening, fit.change)
        points = _profile(fitting, fit, likelihood, place)
    steps = np.gradient([point.effect.parameters[place] for point in points])
    # Prior precision of a centre that is uniform within a pitch: beyond, it would touch other
    # patches.
    centred = np.diag(fitting.centred * 12 / fitting.frame.panel.pitch_mm**2)
    inverses, widths = zip(
        *(
            inverse_beside_prior((point.normal + centred)[remaining], np.delete(sd, place))
            for point in points
        ),
        strict=True,
    )
    # P(δ) ∝ e^(−cost) |H|^(−½) dδ, with H of all parameters but ln d; then C = Σ P (H⁻¹ + (φ −
    # φ̂)(φ − φ̂)ᵀ)
    share = softmax(
        np.log(steps) - [point.cost + width for point, width in zip(points, widths, strict=True)]
    )
    offsets = np.array([point.effect.parameters for point in points]) - fit.parameters
    covariance = (share[:, None] * offsets).T @ offsets + np.diag(
        fit.candidate.blind(fit.parameters) ** 2
    )
    covariance[remaining] += np.tensordot(share, inverses, 1)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


def _profile(fitting: Fitting, fit: Fit, likelihood: CellLikelihood, place: int) -> list[FitPoint]:
    """Return the profile of a fit along the parameter number `place`, in its order.

    The parameter ln d is stepped in both directions, ever farther, until P(δ) is negligible; all
    other parameters are fitted.
    """
    best = fitting.at(fitting.effect(fit.parameters), likelihood)
    points = [best]
    direction = np.eye(len(fit.parameters))[place]
    # at least the distance of the points of a patch
    spacing = fitting.patch_mm / POINTS / float(np.exp(fit.parameters[place]))
    first_step = max(spacing, fit.covariance[place, place] ** 0.5)
    for step in (first_step, -first_step):
        point = best
        number = 0
        while point.cost < best.cost + NEGLIGIBLE and number < MAX_PROFILE:
            begin = fitting.effect(point.effect.parameters + FARTHER**number * step * direction)
            reached = fitting.descended(begin, likelihood, PROFILE_STEPS, held=place).effect
            # linearised again: open cells change readings by much where they would close
            here = fitting.about(reached, likelihood.whitening)
            point = fitting.descended(reached, here, PROFILE_STEPS, held=place)
            points.append(point)
            number += 1
    return sorted(points, key=lambda point: float(point.effect.parameters[place]))
