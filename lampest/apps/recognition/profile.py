"""Profile of a fit along its diameter, where the curvature at its maximum is not its width."""

from dataclasses import replace

import numpy as np
from scipy.special import softmax

from lampest.apps.recognition.fit import (
    MAX_ROUNDS,
    SEARCH,
    CellLikelihood,
    Fit,
    Fitting,
    inverse_beside_prior,
)
from lampest.panel.least_squares import SumOfSquares
from lampest.panel.panel import Array
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
        position, lowest = min(points, key=lambda point: point[1].cost)
        if lowest.cost > fitting.at(fit.parameters, likelihood).cost - SEARCH.settled:
            break
        fit = fitting.best(position, likelihood.whitening)
        likelihood = fitting.about(fit.parameters, likelihood.whitening)
        points = _profile(fitting, fit, likelihood, place)
    steps = np.gradient([position[place] for position, _ in points])
    # Prior precision of a centre that is uniform within a pitch: beyond, it would touch other
    # patches.
    centred = np.diag(fitting.centred * 12 / fitting.frame.panel.pitch_mm**2)
    inverses, widths = zip(
        *(
            inverse_beside_prior((squares.normal + centred)[remaining], np.delete(sd, place))
            for _, squares in points
        ),
        strict=True,
    )
    # P(δ) ∝ e^(−cost) |H|^(−½) dδ, with H of all parameters but ln d; then C = Σ P (H⁻¹ + (φ −
    # φ̂)(φ − φ̂)ᵀ)
    share = softmax(
        np.log(steps)
        - [squares.cost + width for (_, squares), width in zip(points, widths, strict=True)]
    )
    offsets = np.array([position for position, _ in points]) - fit.parameters
    covariance = (share[:, None] * offsets).T @ offsets + np.diag(
        fit.candidate.blind(fit.parameters) ** 2
    )
    covariance[remaining] += np.tensordot(share, inverses, 1)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


def _profile(
    fitting: Fitting, fit: Fit, likelihood: CellLikelihood, place: int
) -> list[tuple[Array, SumOfSquares]]:
    """Return the profile of a fit along the parameter number `place`, in its order.

    The parameter ln d is stepped in both directions, ever farther, until P(δ) is negligible; all
    other parameters are fitted.
    """
    best = fitting.at(fit.parameters, likelihood)
    points = [(fit.parameters, best)]
    direction = np.eye(len(fit.parameters))[place]
    # at least the distance of the points of a patch
    spacing = fitting.patch_mm / POINTS / float(np.exp(fit.parameters[place]))
    first_step = max(spacing, fit.covariance[place, place] ** 0.5)
    for step in (first_step, -first_step):
        position = fit.parameters
        squares = best
        number = 0
        while squares.cost < best.cost + NEGLIGIBLE and number < MAX_PROFILE:
            begin = position + FARTHER**number * step * direction
            position, _ = fitting.descended(begin, likelihood, PROFILE_STEPS, held=place)
            # linearised again: open cells change readings by much where they would close
            here = fitting.about(position, likelihood.whitening)
            position, squares = fitting.descended(position, here, PROFILE_STEPS, held=place)
            points.append((position, squares))
            number += 1
    return sorted(points, key=lambda point: float(point[0][place]))
