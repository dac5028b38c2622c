"""How large a load may be: the posterior of its diameter, along which all its other numbers are fitted anew.

A rim between patches is seen by none of them, so that the cost of φ is flat there, steep beside it, and has a minimum
wherever a patch comes under the rim: curvature at the best one promises too much. With δ = ln d stepped through

    P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̂)(φ(δ) − φ̂)ᵀ)

about the most probable φ̂: its mean would be nearer where patches see little, and further off where they see much.

|H| is averaged over neighbours: it jumps with every corner of a patch that an edge comes to.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from lampest.loads.recognition.fit import HELD, Fit, Fitting
from lampest.panel.panel import Array

NAME = "diameter"
STEP, MOST = 0.03, 24  # of ln d: 0.9 mm at 30 mm; steps to either side
TRIES = 6  # evaluations of the model at each
BARRIER = 10.0  # of the cost: what lies twice in a row so much above the least is not gone through
LIKELY = 5.0  # ln of a probability ratio: points below the best by more are far tails, no part of an interval
NEIGHBOURS = np.array([1, 2, 3, 2, 1]) / 9  # their weights; an assumption


class AtDiameter(NamedTuple):
    """φ where ln d = `place`, the cost of readings and priors, ½ ln |H| and H⁻¹."""

    parameters: Array
    place: float
    cost: float
    volume: float
    covariance: Array


def along_diameter(fitting: Fitting, fit: Fit) -> Fit:
    """The fit with C where that is wider than its own; itself for a candidate that has no diameter.

    fitting : that of its candidate, with the errors that the fit was weighed by.
    """
    names = list(fit.candidate.priors(fitting.panel))
    if NAME not in names:
        return fit
    place = names.index(NAME)
    points = [_point(fitting, fit.parameters, place, fit.parameters[place])]
    for direction in (STEP, -STEP):
        points += _outwards(fitting, points[0], place, direction)
    points.sort(key=lambda point: point.place)
    volume = np.convolve(np.pad([point.volume for point in points], 2, mode="edge"), NEIGHBOURS, "valid")
    logarithm = -np.array([point.cost for point in points]) - volume
    share = softmax(np.where(logarithm > logarithm.max() - LIKELY, logarithm, -np.inf))
    apart = np.array([point.parameters for point in points]) - fit.parameters
    within = np.tensordot(share, np.array([point.covariance for point in points]), 1)
    covariance = (share[:, None] * apart).T @ apart + within + np.diag(fit.candidate.blind(fit.parameters) ** 2)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


def _outwards(fitting: Fitting, first: AtDiameter, place: int, step: float) -> Iterator[AtDiameter]:
    """Point by point, each from the one before, until twice in a row nothing likely is left."""
    best, here, unlikely = first.cost, first, 0
    for count in range(1, MOST + 1):
        here = _point(fitting, here.parameters, place, first.place + count * step)
        yield here
        best = min(best, here.cost)
        unlikely = unlikely + 1 if here.cost > best + BARRIER else 0
        if unlikely == 2:
            break


def _point(fitting: Fitting, start: Array, place: int, held: float) -> AtDiameter:
    """The most probable φ with ln d held there; a centre a pitch further on would have touched other patches."""
    begin = start.copy()
    begin[place] = held
    here, _ = replace(fitting, held=(place, held)).descended(begin, TRIES)
    mean, sd = fitting.candidate.mean(fitting.panel)[place], fitting.candidate.sd(fitting.panel)[place]
    precision = here.slopes.T @ here.slopes + np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2)
    cost = here.cost + ((held - mean) / sd) ** 2 / 2
    covariance = np.linalg.inv(precision) + np.diag(_within(len(begin), place))
    return AtDiameter(here.parameters, held, cost, float(np.linalg.slogdet(precision)[1] / 2), covariance)


def _within(count: int, place: int) -> Array:
    """The variance of ln d within a step."""
    return np.asarray((np.arange(count) == place) * (STEP**2 / 12 - HELD**2))
