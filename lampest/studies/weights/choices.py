"""Where the rules stand on the true curves: what `weight: auto` may take, and references that are only reported.

Sources: Morozov, Soviet Math. Dokl. 7, 1966 (discrepancy principle); Hansen & O'Leary, SIAM J. Sci. Comput. 14, 1993
(L-curve).
"""

from dataclasses import dataclass
from typing import get_args

import numpy as np

from lampest.estimate.weights import rule_in_use
from lampest.posterior.spectrum import Rule
from lampest.solvers.multistart import convex
from lampest.studies.weights.curves import CurvePoint, Curves, WeightSubject, trace

STANDING = 0.05  # of the greatest speed along the L-curve; slower, its curvature means nothing


@dataclass(frozen=True)
class Choice:
    """One rule's weight; None where it has none.

    solves : that it took, the estimate for its choice included; None for a rule that needs the whole curve.
    error : true root-mean-square log error there, excess : over the best in hindsight; None without a truth.
    in_use : whether the estimator goes by it.
    """

    rule: str
    weight: float | None
    solves: int | None
    error: float | None
    excess: float | None
    in_use: bool


@dataclass(frozen=True, eq=False)
class Tuned:
    """One case: its curves and every rule's choice on them."""

    subject: WeightSubject
    curves: Curves
    choices: tuple[Choice, ...]


@np.errstate(all="ignore")
def tune(subject: WeightSubject) -> Tuned:
    """Every rule's choice for a subject, and the true curves round them.

    Raises InputError where the estimator's rule needs the noise and it is unknown.
    """
    first = convex(subject.data, None)
    rules = [rule for rule in get_args(Rule) if subject.noisy or rule == "press"]
    tried = {rule: subject.search.tried(subject.penalty, rule, first) for rule in rules}
    in_use = rule_in_use(subject.estimator, subject.noisy) if subject.given is None else "given"
    marks = [path[-1] for path in tried.values()] + ([subject.given] if subject.given else [])
    curves = trace(subject, marks, first)
    weights: dict[str, tuple[float | None, int | None]] = {rule: (path[-1], len(path)) for rule, path in tried.items()}
    weights["Morozov"] = (morozov(curves) if subject.noisy else None, None)
    weights["L-curve"] = (l_curve(curves.on_grid()), None)
    if subject.given:
        weights["given"] = (subject.given, 1)
    curves = curves.extended(weight for weight, _ in weights.values() if weight is not None).finer()
    best = curves.best()
    if best is not None:
        weights["best"] = (best.weight, None)
    choices = (_choice(curves, rule, *chosen, rule == in_use) for rule, chosen in weights.items())
    return Tuned(subject, curves, tuple(choices))


def _choice(curves: Curves, rule: str, weight: float | None, solves: int | None, in_use: bool) -> Choice:
    best = curves.best()
    point = None if weight is None else curves.at(weight)
    if best is None or point is None or not np.isfinite(point.error):
        return Choice(rule, weight, solves, None, None, in_use)
    return Choice(rule, weight, solves, point.error, point.error / best.error, in_use)


def morozov(curves: Curves) -> float | None:
    """The largest λ at which data are missed by no more than their noise, ρ/s² = number of data; None if there is none.

    Interpolated between the points, log ρ over log λ.
    """
    data = curves.subject.count
    points = curves.on_grid()
    for before, after in zip(reversed(points[:-1]), reversed(points[1:]), strict=True):
        if before.misfit <= data < after.misfit:
            share = np.log(data / before.misfit) / np.log(after.misfit / before.misfit)
            return float(before.weight * (after.weight / before.weight) ** share)
    return None


def l_curve(points: tuple[CurvePoint, ...]) -> float | None:
    """λ of the greatest curvature of log η over log ρ, κ = (x′y″ − x″y′)/(x′² + y′²)^(3/2); None where κ ≤ 0."""
    if len(points) < 5 or min(min(point.misfit, point.penalty) for point in points) <= 0:
        return None
    weight, across, up = np.log([(point.weight, point.misfit, point.penalty) for point in points]).T
    right, rise = np.gradient(across, weight), np.gradient(up, weight)
    speed = np.hypot(right, rise)
    moving = speed > STANDING * speed.max()
    curvature = right * np.gradient(rise, weight) - rise * np.gradient(right, weight)
    curvature = np.where(moving, curvature / np.maximum(speed, 1e-300) ** 3, 0.0)[1:-1]
    return float(points[1 + int(np.argmax(curvature))].weight) if curvature.max() > 0 else None
