"""True curves over the weight of a penalty, and the choice of every rule on them.

At each weight the frame is solved; the point has misfit, penalty, evidence, expected error, and the
true error where the truth is known.

Sources: Morozov, Soviet Math. Dokl. 7, 1966 (discrepancy principle); Hansen & O'Leary, SIAM J. Sci.
Comput. 14, 1993 (L-curve).
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import get_args

import numpy as np
from scipy.special import erfcx

from lampest.apps.studies.study import column
from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import deciding_data
from lampest.estimate.weights import Rule, WeightSearch, with_chosen_weights
from lampest.files.errors import BROKEN, InputError
from lampest.panel.panel import Array
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import LinearModel, rank
from lampest.posterior.spectrum import Spectrum
from lampest.recording.recording import Recording, baseline_readings, deciding_frames
from lampest.runs.config import Case
from lampest.solvers.multistart import best_solution, evaluated


@dataclass(frozen=True, eq=False)
class WeightSubject:
    """A frame of a recording with an estimator that has one penalty.

    Attributes
    ----------
    case : Case
    recording : Recording
    frame : int
        Index into the recording.
    search : WeightSearch
        Cost and data of the solves; the first one has the frame, as the last of its frames.
    """

    case: Case
    recording: Recording
    frame: int
    search: WeightSearch

    @classmethod
    def of(cls, case: Case, recording: Recording) -> "WeightSubject | None":
        """Return the deciding frame of a recording, with the baseline if terms need it.

        The result is None without usable frames.
        """
        readings = recording.readings()
        scene = recording.scene
        estimator = case.estimator
        resting = baseline_readings(recording, readings)
        frames = deciding_frames(recording, readings, resting)
        if not len(frames):
            return None
        solves = tuple(
            deciding_data(estimator, scene, resting, *(readings[number] for number in frames))
        )
        cost = estimator.cost(scene, len(solves[0].measured), partial=solves[0].partial)
        return cls(case, recording, int(frames[0]), WeightSearch(cost, solves, estimator.solver))

    @property
    def data(self) -> Data:
        """Data of the solve."""
        return self.search.solves[0]

    @cached_property
    def penalty(self) -> int:
        """Index of the penalty among the terms."""
        return next(
            number
            for number, term in enumerate(self.search.cost.terms)
            if not term.reads_measurement
        )

    @cached_property
    def spectra(self) -> list[Spectrum]:
        """Spectra at the reference estimates; empty without a reference."""
        with suppress(*BROKEN):
            return self.search.spectra(self.penalty, self.search.begun)
        return []

    def with_weight(self, weight: float) -> Cost:
        """Return the cost with a weight of the penalty."""
        terms = self.search.cost.terms
        return self.search.weighted(
            [float(term.weight) if term.reads_measurement else weight for term in terms]
        )

    @property
    def count(self) -> int:
        """Number of readings that are values."""
        return int(np.sum(self.data.plain))

    @property
    def units(self) -> dict[str, str]:
        """Units of squared misfit and penalty, and of λ, their ratio, in ASCII."""
        terms = self.search.cost.terms
        data_term = terms[1 - self.penalty]
        term = terms[self.penalty]
        units = (
            "1" if getattr(data_term, "weighting", "plain") == "noise" else data_term.unit,
            term.unit,
        )
        misfit, penalty = map(_squared, units)
        ratio = "1" if misfit == penalty else f"{misfit}/{penalty}"
        return {
            "misfit": "1" if self.data.noise_known else misfit,
            "penalty": penalty,
            "weight": ratio,
        }


@dataclass(frozen=True, eq=False)
class CurvePoint:
    """Figures at a weight λ, NaN if not solved or unknown.

    Evidence requires σ, risk a reference estimate.

    Attributes
    ----------
    misfit : float
        ρ/s², equal to the number of data for residuals of one standard deviation; ρ if σ is
        unknown.
    cells : array, shape (frames, rows, columns) or None
        Ohm.
    """

    weight: float = column("1", "weight of the penalty")
    solved: int = column("1", "1: solved, 0: failed", 0)
    misfit: float = column(
        "1", "sum of squared misfits, over the noise's mean square where that is known", np.nan
    )
    penalty: float = column("1", "sum of squared penalties", np.nan)
    evidence: float = column("1", "-2 log of the Laplace evidence, up to a constant", np.nan)
    risk: float = column(
        "1", "expected sum of squared errors of log resistance, the reference as the truth", np.nan
    )
    error: float = column(
        "1", "true root-mean-square error of log resistance over the frame", np.nan
    )
    open_cells: float = column("1", "cells of the frame at their upper bound", np.nan)
    bound_cells: float = column("1", "cells at a bound, of all frames of the solve", np.nan)
    cells: Array | None = None


def solve_at(subject: WeightSubject, weight: float, start: Array | None) -> CurvePoint:
    """Return the figures of the solve with a weight.

    Parameters
    ----------
    subject : WeightSubject
    weight : float
        λ.
    start : array, shape (frames, rows, columns), or None
        Estimate at a weight near by, ohm; None: the solve begins at all starts.
    """
    scene = subject.recording.scene
    settings = subject.search.settings
    noisy = subject.data.noise_known
    solver = named_method("reduced").solver(subject.with_weight(weight), scene, settings, 1.0)
    solution = best_solution(solver, subject.data, start)
    if solution.at is None or solution.dual is None:
        return CurvePoint(weight)
    model = LinearModel(solution.at, solution.dual)
    evidence = error = np.nan
    with suppress(*BROKEN):  # where bounds decide every cell, the evidence is unknown
        evidence = free_evidence(model, weight) + bound_evidence(model) if noisy else np.nan
    if subject.recording.truth_cell_resistance is not None:
        truth = subject.recording.truth_cell_resistance[subject.frame]
        errors = np.log(solution.cell_resistance[-1] / truth)[~scene.broken]
        error = float(np.sqrt(np.nanmean(errors**2)))
    return CurvePoint(
        weight,
        1,
        float(model.data_curvature @ model.residual**2) / (model.scale if noisy else 1.0),
        float(model.penalty @ model.penalty),
        evidence,
        sum(spectrum.risk(weight) for spectrum in subject.spectra) if subject.spectra else np.nan,
        error,
        float(solution.open_cell[-1].sum()),
        float(np.sum(model.at_lower | model.at_upper)),
        solution.cell_resistance,
    )


def free_evidence(model: LinearModel, weight: float) -> float:
    """Return the part of −2 ln evidence by free cells at the estimate for λ, up to a constant.

    (ρ + λη)/s² + log det((A + λ ZᵀZ)/s²) − rank·log(λ/s²), A the curvature of the data.
    """
    spectrum = Spectrum.of(model)
    scale = model.scale
    fit = (float(model.data_curvature @ model.residual**2) + weight * spectrum.penalty) / scale
    # log det((A + λ ZᵀZ)/s²) = log det(A/s²) + Σ log(1 + λ κ)
    volume = spectrum.volume + float(np.sum(np.log1p(weight * spectrum.stiffness)))
    return (
        fit
        + volume
        - min(rank(model.at.cost.unweighted), len(model.free)) * float(np.log(weight / scale))
    )


def bound_evidence(model: LinearModel) -> float:
    """Return the part of −2 ln evidence by cells at a bound.

    The sum over these cells is Σ (ln 2π − 2 ln ∫₀^∞ exp(−(g t + a t²)/2) dt), where t is the
    distance of a cell from its bound, and g and a are slope and curvature of cost/s². The free
    cells are integrated over a Gaussian. With both parts, evidences with different active sets are
    comparable.
    """
    bound = np.flatnonzero(model.at_lower | model.at_upper)
    weighted = DenseErrors(model).sensitivity[:, bound] ** 2 * model.data_curvature[:, None]
    penalties = model.penalty_jacobian[:, bound].power(2)
    # a = Σ ω (∂x/∂u)²/s² over data and penalties, g = |∂φ/∂u|/s²
    curvature = (weighted.sum(axis=0) + penalties.T @ model.penalty_curvature) / model.scale
    slope = np.abs(model.gradient[bound]) / model.scale
    curvature = np.maximum(curvature, 1e-12 * slope**2)  # for a → 0 the integral is 2/g
    # ∫₀^∞ exp(−(g t + a t²)/2) dt = √(π/(2a)) erfcx(g/√(8a))
    width = np.sqrt(np.pi / (2 * curvature)) * erfcx(slope / np.sqrt(8 * curvature))
    return float(np.sum(np.log(2 * np.pi) - 2 * np.log(width)))


@dataclass(frozen=True, eq=False)
class Choice:
    """Choice of a rule."""

    rule: str = column("1", "rule")
    in_use: bool = column("1", "1: a run uses it")
    weight: float | None = column("1", "the rule's weight, NaN where it has none")
    error: float | None = column("1", "true root-mean-square error of log resistance", None)
    excess: float | None = column("1", "error over that of the best weight in hindsight", None)


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves of a subject over the weight, and the choice of every rule.

    The curves are in the order of the weights.
    """

    subject: WeightSubject
    points: tuple[CurvePoint, ...]
    choices: tuple[Choice, ...] = ()

    def values(self, name: str) -> Array:
        """Return a figure at all points."""
        return np.array([getattr(point, name) for point in self.points], dtype=float)

    def at(self, weight: float) -> CurvePoint:
        """Return the point at a weight of the curves."""
        return next(point for point in self.points if point.weight == weight)

    def extended(self, weights: Iterable[float]) -> "Curves":
        """Return the curves with further weights, solved in this order.

        Every solve starts at its nearest neighbour.
        """
        points = {point.weight: point for point in self.points}
        for weight in weights:
            solved = [point for point in points.values() if point.solved]
            near = min(solved, key=lambda point: abs(np.log(point.weight / weight)), default=None)
            if weight not in points:
                points[weight] = solve_at(
                    self.subject, weight, None if near is None else near.cells
                )
        return replace(self, points=tuple(points[weight] for weight in sorted(points)))

    def best(self) -> CurvePoint | None:
        """Return the point of least true error."""
        compared = [point for point in self.points if np.isfinite(point.error)]
        return min(compared, key=lambda point: point.error, default=None)

    def finer(self) -> "Curves":
        """Return the curves with half the spacing in log λ around the least true error."""
        best = self.best()
        if best is None:
            return self
        index = self.points.index(best)
        near = self.values("weight")[max(index - 1, 0) :][:3]
        return self.extended(np.sqrt(near[1:] * near[:-1]).tolist())


def trace(subject: WeightSubject, marks: list[float]) -> Curves:
    """Return curves over 33 weights, equally spaced in log λ, solved from the first mark outwards.

    The range has the weights for which the penalty matters, at most four decades beyond the marks.

    Parameters
    ----------
    subject : WeightSubject
    marks : list of float
        Chosen weights.
    """
    low = min(marks) / 1e4
    high = max(marks) * 1e4
    with suppress(*BROKEN):  # without free cells the extent is unknown
        first = evaluated(subject.with_weight(marks[0]), subject.data, subject.data.start())
        least, largest = np.exp(Spectrum.of(LinearModel(first, NO_DUAL)).extent)
        low = max(least, low)
        high = min(largest, high)
    weights = np.geomspace(min(low, *marks), max(high, *marks), 33).tolist()
    return Curves(subject, ()).extended(
        sorted(weights, key=lambda weight: abs(np.log(weight / marks[0])))
    )


@np.errstate(all="ignore")
def tune(subject: WeightSubject) -> Curves:
    """Return the true curves of a subject with the choice of every rule.

    Raises InputError if the rule of the estimator requires an unknown noise.
    """
    rule = subject.case.estimator.auto_weight.rule or "risk"
    noisy = subject.data.noise_known
    if rule == "evidence" and not noisy:
        raise InputError(
            "auto_weight.rule: evidence needs the noise: "
            "a readout in the scene or sigma in the recording"
        )
    initial = subject.search.cost.terms[subject.penalty].weight
    specified = {} if initial == "auto" else {"given": float(initial)}
    chosen = {
        name: _weight_of(subject, name) for name in get_args(Rule) if noisy or name != "evidence"
    }
    curves = trace(subject, [*chosen.values(), *specified.values()])
    solved = [point for point in curves.points if point.solved]
    weights: dict[str, float | None] = {
        **chosen,
        "Morozov": morozov(solved, subject.count) if noisy else None,
        "L-curve": l_curve(solved),
        **specified,
    }
    curves = curves.extended(weight for weight in weights.values() if weight is not None)
    curves = curves.finer().finer()
    best = curves.best()
    if best is not None:
        weights["best"] = best.weight
    in_use = next(iter(specified), rule)
    choices = []
    for name, weight in weights.items():
        choice = Choice(name, name == in_use, weight)
        if best is not None and weight is not None:
            error = curves.at(weight).error
            if np.isfinite(error):
                choice = Choice(name, name == in_use, weight, error, error / best.error)
        choices.append(choice)
    return replace(curves, choices=tuple(choices))


def _squared(unit: str) -> str:
    """Return the square of a unit in ASCII."""
    if unit == "1":
        return "1"
    return f"({unit})^2" if " " in unit else f"{unit}^2"


def _weight_of(subject: WeightSubject, rule: Rule) -> float:
    """Return the weight of the penalty by a rule."""
    estimator = subject.case.estimator
    terms = tuple(
        term if term.reads_measurement else replace(term, weight="auto") for term in estimator.terms
    )
    estimator = replace(
        estimator, terms=terms, auto_weight=replace(estimator.auto_weight, rule=rule)
    )
    further = subject.search.solves[1:]
    estimator = with_chosen_weights(estimator, subject.recording.scene, subject.data, None, further)
    return float(estimator.terms[subject.penalty].weight)


def morozov(points: Sequence[CurvePoint], data: int) -> float | None:
    """Return the λ at which the residuals equal the noise, or None (discrepancy principle).

    There ρ/s² = number of data. log ρ is interpolated linearly over log λ between the points.
    """
    for before, after in zip(points[-2::-1], points[:0:-1], strict=True):
        if before.misfit <= data < after.misfit:
            share = np.log(data / before.misfit) / np.log(after.misfit / before.misfit)
            return float(before.weight * (after.weight / before.weight) ** share)
    return None


def l_curve(points: Sequence[CurvePoint]) -> float | None:
    """Return λ at the greatest curvature κ of log η over log ρ; None if κ ≤ 0.

    Here κ = (x′y″ − x″y′)/(x′² + y′²)^(3/2).
    """
    if len(points) < 5 or min(min(point.misfit, point.penalty) for point in points) <= 0:
        return None
    weight, across, up = np.log([(point.weight, point.misfit, point.penalty) for point in points]).T
    right = np.gradient(across, weight)
    rise = np.gradient(up, weight)
    speed = np.hypot(right, rise)
    # Where the curve hardly moves, its curvature is meaningless.
    moving = speed > 0.05 * speed.max()
    curvature = right * np.gradient(rise, weight) - rise * np.gradient(right, weight)
    curvature = np.where(moving, curvature / np.maximum(speed, 1e-300) ** 3, 0.0)[1:-1]
    return float(points[1 + int(np.argmax(curvature))].weight) if curvature.max() > 0 else None
