"""Selection of weights.

It has true curves over the weight of a penalty, the choice of every rule, table and figure.

Sources: Morozov, Soviet Math. Dokl. 7, 1966 (discrepancy principle); Hansen & O'Leary, SIAM J. Sci.
Comput. 14, 1993 (L-curve).
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from scipy.special import erfcx

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data
from lampest.cost.terms import Term, term_kind
from lampest.estimate.deciding import baseline_readings, deciding_frames
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import named_method
from lampest.estimate.objective import Rule
from lampest.estimate.sequence import deciding_data
from lampest.estimate.weights import WeightSearch, with_chosen_weights
from lampest.files.errors import BROKEN, InputError
from lampest.panel.panel import Array
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import LinearModel, rank
from lampest.posterior.spectrum import Spectrum
from lampest.recording.recording import Recording
from lampest.report.compare import Columns
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure
from lampest.report.words import text_of
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.convex import convex_cells
from lampest.solvers.multistart import best_solution, evaluated
from lampest.studies import study
from lampest.studies.study import column


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

        None without usable frames.
        """
        readings = recording.readings()
        scene = recording.scene
        estimator = case.estimator
        resting = baseline_readings(recording, readings)
        frames = deciding_frames(recording, readings, resting)
        if not len(frames):
            return None
        solves = tuple(
            deciding_data(estimator, scene, resting, readings[number]) for number in frames
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
        misfit, penalty = (
            "1" if unit == "1" else f"({unit})^2" if " " in unit else f"{unit}^2" for unit in units
        )
        ratio = "1" if misfit == penalty else f"{misfit}/{penalty}"
        return {
            "misfit": "1" if self.data.noise_known else misfit,
            "penalty": penalty,
            "weight": ratio,
        }


def why_not(estimator: Estimator, readings: int) -> str | None:
    """Return why an estimator cannot be tuned with that number of readings, or None."""
    terms: tuple[Term, ...] = estimator.terms
    misfits = sum(term.reads_measurement for term in terms)
    if misfits != 1 or len(terms) != 2:
        penalties = len(terms) - misfits
        return (
            f"it has {penalties} penalty terms, not one"
            if penalties
            else "it has no penalty to weigh"
        )
    if readings > MAX_DENSE:
        return f"one solve has {readings} readings, more than {MAX_DENSE}"
    return None


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

    It is Σ (ln 2π − 2 ln ∫₀^∞ exp(−(g t + a t²)/2) dt). t is the distance of a cell from its bound,
    and g and a are slope and curvature of cost/s². The free cells are integrated over a Gaussian.
    With both parts, evidences with different active sets are comparable.
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

        Each is solved from its nearest neighbour.
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
        known = [point for point in self.points if np.isfinite(point.error)]
        return min(known, key=lambda point: point.error, default=None)

    def finer(self) -> "Curves":
        """Return the curves with half the spacing in log λ around the least true error."""
        if (best := self.best()) is None:
            return self
        index = self.points.index(best)
        near = self.values("weight")[max(index - 1, 0) :][:3]
        return self.extended(np.sqrt(near[1:] * near[:-1]).tolist())


def trace(subject: WeightSubject, marks: list[float]) -> Curves:
    """Return curves over 33 weights, equally spaced in log λ, solved from the first mark outwards.

    They cover the weights for which the penalty matters, at most four decades beyond the marks.

    Parameters
    ----------
    subject : WeightSubject
    marks : list of float
        Chosen weights.
    """
    low = min(marks) / 1e4
    high = max(marks) * 1e4
    with suppress(*BROKEN):  # without free cells the extent is unknown
        first = evaluated(
            subject.with_weight(marks[0]), subject.data, convex_cells(subject.data, None)
        )
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
            "auto_weight.rule: evidence needs the noise: a readout in the scene or sigma in the "
            "recording"
        )
    initial = subject.search.cost.terms[subject.penalty].weight
    given = {} if initial == "auto" else {"given": float(initial)}
    chosen = {
        name: _weight_of(subject, name) for name in get_args(Rule) if noisy or name != "evidence"
    }
    curves = trace(subject, [*chosen.values(), *given.values()])
    solved = [point for point in curves.points if point.solved]
    weights: dict[str, float | None] = {
        **chosen,
        "Morozov": morozov(solved, subject.count) if noisy else None,
    }
    weights |= {"L-curve": l_curve(solved), **given}
    curves = (
        curves.extended(weight for weight in weights.values() if weight is not None).finer().finer()
    )
    best = curves.best()
    weights |= {} if best is None else {"best": best.weight}
    choices = []
    for name, weight in weights.items():
        error = np.nan if best is None or weight is None else curves.at(weight).error
        known = (error, error / best.error) if best is not None and np.isfinite(error) else ()
        choices.append(Choice(name, name == (*given, rule)[0], weight, *known))
    return replace(curves, choices=tuple(choices))


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


LOOKS: dict[str, dict[str, Any]] = {
    "risk": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "evidence": {"color": "#D55E00", "ls": "--", "marker": "s"},
    "Morozov": {"color": "#CC79A7", "ls": ":", "marker": "^"},
    "L-curve": {"color": "#E69F00", "ls": "-.", "marker": "v"},
    "given": {"color": "#7A5230", "ls": "-", "marker": "P", "name": "given in the file"},
    "best": {"color": "black", "ls": "-", "marker": "*", "name": "best in hindsight"},
}
PENALTY = "#56738C"  # the colour of its axis


def weights_figure(curves: Curves) -> Figure:
    """Draw evidence, risk, misfit, penalty and error over λ, and the L-curve.

    The choice of every rule is drawn, too. Evidence and risk are drawn above their least values.
    """
    subject = curves.subject
    count = curves.subject.count
    units = {name: _shown_unit(unit) for name, unit in subject.units.items()}
    misfit = f"misfit ρ{'/s²' if subject.data.noise_known else ''} [{units['misfit']}]"
    penalty = f"penalty η [{units['penalty']}]"
    free = subject.data.measured.size - curves.values("bound_cells")
    expected = np.sqrt(np.maximum(curves.values("risk"), 0) / np.maximum(free, 1))
    noise = (
        {"number of readings": np.full(len(free), float(count))} if subject.data.noise_known else {}
    )
    panels: list[tuple[str, str, dict[str, Array]]] = [
        ("evidence", "−2 log evidence − least [1]", {"": _above_least(curves.values("evidence"))}),
        (
            "expected error, Σ(log r̂ − log r)²",
            "risk − least [1]",
            {"": _above_least(curves.values("risk"))},
        ),
        ("misfit and penalty", misfit, {"misfit": curves.values("misfit"), **noise}),
        (
            "error of the estimate",
            "rms error of log r",
            {"true": curves.values("error"), "√(risk/cells)": expected},
        ),
    ]
    figure = new_figure(7.4)
    grid = figure.subplots(3, 2)
    grid[2, 1].remove()
    weight = (
        f"weight λ of {term_kind(subject.search.cost.terms[subject.penalty])} [{units['weight']}]"
    )
    for axes, (_, label, lines) in zip(grid.flat, panels, strict=False):
        dressed(axes, weight, label)
        _over_weight(axes, curves, lines)
    right = grid[1, 0].twinx()
    right.tick_params(labelsize=SMALL_POINT, which="both", colors=PENALTY)
    right.set_ylabel(f"{penalty} (dashed)", fontsize=TEXT_POINT, color=PENALTY)
    right.plot(curves.values("weight"), curves.values("penalty"), "--", color=PENALTY, lw=1.3)
    right.set_yscale("log")
    dressed(grid[2, 0], misfit, penalty)
    _l_curve(grid[2, 0], curves)
    for axes, (title, *_), letter in zip(grid.flat, [*panels, ("L-curve",)], "abcde", strict=False):
        axes.set_title(f"({letter}) {title}", fontsize=TEXT_POINT, loc="left")
    title = f"{subject.case.recording}, frame {subject.frame}: {subject.case.name}"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "ncols": 3}
    figure.legend(*grid[2, 0].get_legend_handles_labels(), loc="outside lower center", **look)
    return figure


def _shown_unit(unit: str) -> str:
    return unit.replace("^2", "²").replace("ohm", "Ω").replace("percent", "%").replace("/", " / ")


def _above_least(values: Array) -> Array:
    """Return values above the least one, which stands at the next larger one."""
    above = values - np.nanmin(values, initial=np.inf)
    above[above == 0] = np.min(above, where=above > 0, initial=np.inf)
    return above


def _over_weight(axes: Axes, curves: Curves, lines: dict[str, Array]) -> None:
    """Draw lines by their names over λ, with a vertical line for every choice."""
    weights = curves.values("weight")
    axes.set(xscale="log", yscale="log", xlim=(weights[0] / 1.6, weights[-1] * 1.6))
    axes.xaxis.set_major_locator(LogLocator(numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    known = {
        name: values for name, values in lines.items() if np.any(np.isfinite(values) & (values > 0))
    }
    for (name, values), colour in zip(known.items(), ("black", "0.5"), strict=False):
        axes.plot(
            weights, np.where(values > 0, values, np.nan), color=colour, lw=1.2, label=name or None
        )
    if not known:
        look: dict[str, Any] = {
            "ha": "center",
            "transform": axes.transAxes,
            "backgroundcolor": "white",
        }
        axes.text(
            0.5, 0.5, "needs the truth, or the noise of the readings", fontsize=TEXT_POINT, **look
        )
    if any(known):
        axes.legend(fontsize=SMALL_POINT, edgecolor="none", framealpha=0.9, loc="best")
    for choice in curves.choices:
        if choice.weight is not None:
            wide = 1.6 if choice.in_use else 0.9
            style = LOOKS[choice.rule]
            axes.axvline(
                choice.weight, color=style["color"], ls=style["ls"], lw=wide, alpha=0.9, zorder=1.5
            )


def _l_curve(axes: Axes, curves: Curves) -> None:
    """Draw penalty over misfit, with a mark for every choice."""
    axes.set(xscale="log", yscale="log")
    axes.plot(curves.values("misfit"), curves.values("penalty"), color="black", lw=1.3)
    for choice in curves.choices:
        point = None if choice.weight is None else curves.at(choice.weight)
        place = ([], []) if point is None else ([point.misfit], [point.penalty])
        look = LOOKS[choice.rule] | {
            "lw": 1.6 if choice.in_use else 0.9,
            "ms": 5 if choice.rule != "best" else 8,
        }
        excess = (
            ""
            if choice.excess is None or choice.rule == "best"
            else f", error × {choice.excess:.3g}"
        )
        text = "none" if choice.weight is None else f"{choice.weight:.2g}{excess}"
        name = f"{look.pop('name', choice.rule)}{' (in use)' if choice.in_use else ''}: {text}"
        axes.plot(*place, mec="white", mew=0.6, zorder=3, label=name, **look)


def tuned(case: Case) -> list[Curves] | str:
    """Tune a case with one penalty, or return why it cannot be tuned.

    Raises InputError if a rule requires an unknown noise.
    """
    recording = Recording.load(case.path)
    frames = 2 if case.estimator.relative else 1
    reason = why_not(case.estimator, frames * recording.scene.panel.crossings)
    if reason is not None:
        return reason
    subject = WeightSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    curves = tune(subject)
    return [curves] if curves.values("solved").any() else "it was solved for no weight"


def _row(subject: WeightSubject, choice: Choice) -> study.Row:
    return study.Row(
        recording=subject.case.recording,
        estimator=subject.case.name,
        frame=subject.frame,
        rule=choice.rule,
        in_use=int(choice.in_use),
        weight=choice.weight,
        weight_unit=subject.units["weight"],
        rms_log_error=choice.error,
        over_best=choice.excess,
    )


def weight_rows(cases: study.Cases[Curves]) -> list[study.Row]:
    """Return a row for every case and rule."""
    return [_row(curves.subject, choice) for curves in cases.measured for choice in curves.choices]


SCREEN: Columns = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "rule": "{rule}",
    "in use": lambda row: "*" * row.in_use,
    "λ": lambda row: text_of(row.weight, ".3g") or "none",
    "unit of λ": "{weight_unit}",
    "true error": "{rms_log_error:.4f}",
    "over the best": "{over_best:.3f}",
}


def _groups(cases: study.Cases[Curves]) -> Iterator[study.RecordGroup]:
    """Yield the groups /entry/<recording>/<estimator>, with the curves.

    Their subgroups `choices` are yielded, too.
    """
    for curves in cases.measured:
        subject = curves.subject
        path = f"{curves.subject.case.recording}/{curves.subject.case.name}"
        about = {
            "frame": subject.frame,
            "readings": subject.count,
            "noise_known": int(subject.data.noise_known),
        }
        yield study.RecordGroup(path, curves.points, "risk", "weight", subject.units, about)
        yield study.RecordGroup(f"{path}/choices", curves.choices, "weight", units=subject.units)


STUDY: study.Study[Run, study.Cases[Curves]] = study.Study(
    "tune",
    "cases",
    "tune.yaml",
    read_run,
    lambda run, on_step: study.of_cases(tuned, run, on_step, "tune"),
    rows=weight_rows,
    sheets=lambda cases: [("", weight_rows(cases), SCREEN)],
    form="tune/3",
    records=_groups,
    figures=lambda cases: {
        re.sub(
            r"[^\w.@=,+-]", "_", f"tune_{curves.subject.case.recording}_{curves.subject.case.name}"
        ): weights_figure(curves)
        for curves in cases.measured
    },
    left_out=lambda cases: cases.left_out,
)
