"""How large a load may be: the posterior of its diameter, along which all its other numbers are fitted anew.

A rim between patches is seen by none of them, so that the cost of φ is flat there, steep beside it, and has a minimum
wherever a patch comes under the rim: curvature at the best one promises too much. With δ = ln d stepped through

    P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   φ̄ = Σ P φ(δ),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̄)(φ(δ) − φ̄)ᵀ).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from lampest.loads.recognition.fit import HELD, Fit, Fitting
from lampest.panel.panel import Array

NAME = "diameter"
STEP, MOST = 0.03, 24  # of ln d: 0.9 mm at 30 mm; steps to either side
TRIES = 6  # evaluations of the model at each
BARRIER = 10.0  # of the cost: what lies twice in a row so much above the least is not gone through
LIKELY = 5.0  # ln of a probability ratio: points below the best by more are far tails, no part of an interval
Point = tuple[Array, float, Array]  # φ, ln of its probability, covariance


def along_diameter(fitting: Fitting, fit: Fit) -> Fit:
    """The fit with φ̄ and C, where that is wider than its own; itself for a candidate that has no diameter.

    fitting : that of its candidate, with the errors that the fit was weighed by.
    """
    names = list(fit.candidate.priors(fitting.panel))
    if NAME not in names:
        return fit
    place = names.index(NAME)
    points = [_point(fitting, fit.parameters, place, fit.parameters[place])]
    for direction in (STEP, -STEP):
        points += _outwards(fitting, points[0], place, direction)
    least = max(point[1] for point in points) - LIKELY
    parameters, logarithm, within = zip(*(point for point in points if point[1] > least), strict=True)
    share = softmax(logarithm)
    mean = share @ parameters
    apart = parameters - mean
    covariance = (share[:, None] * apart).T @ apart + np.tensordot(share, within, 1)
    covariance += np.diag(fit.candidate.blind(mean) ** 2)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, mean=mean, covariance=covariance) if wider else fit


def _outwards(fitting: Fitting, first: Point, place: int, step: float) -> Iterator[Point]:
    """Point by point, each from the one before, until twice in a row nothing likely is left."""
    best, numbers, unlikely = first[1], first[0], 0
    for count in range(1, MOST + 1):
        point = _point(fitting, numbers, place, first[0][place] + count * step)
        yield point
        best, numbers = max(best, point[1]), point[0]
        unlikely = unlikely + 1 if point[1] < best - BARRIER else 0
        if unlikely == 2:
            break


def _point(fitting: Fitting, start: Array, place: int, held: float) -> Point:
    """The most probable φ with ln d held there; a centre a pitch further on would have touched other patches."""
    begin = start.copy()
    begin[place] = held
    here, _ = replace(fitting, held=(place, held)).descended(begin, TRIES)
    mean, sd = fitting.candidate.mean(fitting.panel)[place], fitting.candidate.sd(fitting.panel)[place]
    precision = here.slopes.T @ here.slopes + np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2)
    logarithm = -here.cost - ((held - mean) / sd) ** 2 / 2 - np.linalg.slogdet(precision)[1] / 2
    return here.parameters, float(logarithm), np.linalg.inv(precision) + np.diag(_within(len(begin), place))


def _within(count: int, place: int) -> Array:
    """The variance of ln d within a step."""
    return np.asarray((np.arange(count) == place) * (STEP**2 / 12 - HELD**2))
