"""Objectives, and the choice of their weights (`weight: auto`) by the least risk or the evidence.

An objective is what a solve minimises, whatever the method.

Risk: the weight minimises the expected squared error of log r, with the reference estimate
(`lampest.posterior.reference`) as the truth and its error scale as the noise. The cost is
linearised at the reference estimate, and the weight minimises `Spectrum.risk`; several penalties
are optimised in turn. Evidence: on panels of more than `MAX_CELLS` cells, and on request, the
weights have the largest evidence, jointly with a factor on the noise.
"""

from collections.abc import Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, Self, TypeVar

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import NO_DUAL, Data
from lampest.cost.terms import Term
from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import MAD_TO_SIGMA
from lampest.files.typed import Configuration
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import LinearModel
from lampest.posterior.reference import MAX_CELLS, Reference, references
from lampest.posterior.spectrum import (
    Spectrum,
    best_weight,
    first_weights,
    next_weights,
    settled_weights,
)
from lampest.recording.readings import Readings
from lampest.recording.recording import MAX_NEIGHBOURS
from lampest.solvers.multistart import best_solution, evaluated
from lampest.solvers.posed import Bounds, cost_of_solve, data_of_solve
from lampest.solvers.solution import Settings

# solves for one factor on σ; change of ln λ that changes no reported figure
MAX_SOLVES = 8
SETTLED = 0.2
MIN_SHARE = 0.25  # of a step of ln λ that a secant shortens
# ratio of successive factors on σ, and their largest number beyond the first
SCALE_RATIO = 1.5
MAX_SCALES = 8
MAX_SWEEPS = 6  # over several penalties: each converges within a few
# Degrees of freedom of known noise per reading. On ten arrays of 500 to 1,140 cells that differ at
# random by 30 %, more noise gains up to 0.09 per reading with a penalty of differences; where
# static errors of five times the noise ruin the estimate, it gains 0.6 to 12
# (docs/studies/weights.md).
NOISE_BELIEF = 0.1
MIN_FREEDOM = 0.05  # degrees of freedom of a residual: fewer do not determine its scale
AnyObjective = TypeVar("AnyObjective", bound="Objective")
# Weights of the terms, and standard deviations of log λ.
Weights = tuple[list[float], tuple[float, ...]]
Rule = Literal["risk", "evidence"]  # function of a weight that its choice minimises


@dataclass(frozen=True)
class AutoWeight(Configuration):
    """Settings of `weight: auto`.

    Attributes
    ----------
    rule : Rule or None
        'risk' minimises the expected error of log r, with the reference estimate as the truth.
        'evidence' takes the most probable weight. By default risk, and evidence for panels with
        more than 400 cells.
    per : 'recording' or 'frame'
        'recording' chooses one weight from the strongest frame; 'frame' chooses one for every
        frame.

    >>> lampest.AutoWeight().per
    'recording'
    """

    rule: Rule | None = None
    per: Literal["recording", "frame"] = "recording"


@dataclass(frozen=True)
class Objective:
    """Terms with bounds, settings, and the choice of their weights.

    Attributes
    ----------
    terms : tuple of Term
    solver : Settings
    bounds : Bounds
    auto_weight : AutoWeight
        Choice of the weights that the terms leave open.
    weight_sigma : tuple of float
        Standard deviations of ln λ of chosen weights.
    """

    terms: tuple[Term, ...]
    _: KW_ONLY
    solver: Settings = Settings()
    bounds: Bounds = Bounds()
    auto_weight: AutoWeight = AutoWeight()
    weight_sigma: tuple[float, ...] = ()

    def with_terms(self, terms: tuple[Term, ...]) -> "Objective":
        """Return the objective with other terms.

        Terms that stay keep the deviation of their weight.
        """
        sigma = dict(zip(self.terms, self.weight_sigma, strict=False))
        return Objective(
            terms,
            solver=self.solver,
            bounds=self.bounds,
            auto_weight=self.auto_weight,
            weight_sigma=tuple(sigma.get(term, np.nan) for term in terms) if sigma else (),
        )

    @property
    def automatic(self) -> bool:
        """Whether a weight is still to be chosen."""
        return any(term.weight == "auto" for term in self.terms)

    def with_weights(self, weights: Iterable[float], sigma: tuple[float, ...] = ()) -> Self:
        """Return the objective with these weights of the terms, in their order.

        `sigma` becomes its `weight_sigma`.
        """
        terms = zip(self.terms, weights, strict=True)
        return replace(
            self,
            terms=tuple(replace(term, weight=float(weight)) for term, weight in terms),
            weight_sigma=sigma,
        )

    @property
    def relative(self) -> bool:
        """Whether a term depends on the previous frame."""
        return any(term.needs_previous for term in self.terms)

    @property
    def penalised(self) -> bool:
        """Whether a penalty term determines cells that have no reading."""
        return not all(term.reads_measurement for term in self.terms)

    @property
    def weighs_previous(self) -> bool:
        """Whether a term depends on the uncertainty of the previous frame."""
        return any(term.weighs_previous for term in self.terms)

    @property
    def absolute_terms(self) -> tuple[Term, ...]:
        """The terms that need no previous frame."""
        return tuple(term for term in self.terms if not term.needs_previous)

    def data(self, readings: Readings, background: Background) -> Data:
        """Return the data of one solve, see `lampest.solvers.posed.data_of_solve`."""
        return data_of_solve(self.terms, self.bounds, readings, background)

    def cost(self, scene: Scene, frames: int, *, partial: bool = False) -> Cost:
        """Return the terms over one or two frames, see `lampest.solvers.posed.cost_of_solve`."""
        return cost_of_solve(self.terms, scene, frames, partial=partial)


def with_chosen_weights(
    estimator: AnyObjective,
    scene: Scene,
    data: Data,
    near: Array | None,
    further: Sequence[Data] = (),
) -> AnyObjective:
    """Return the objective with its open weights chosen from the data.

    Parameters
    ----------
    estimator : Objective
    scene : Scene
    data : Data
        Data of the deciding solve.
    near : array, shape (frames, rows, columns), optional
        Cells in ohm to start from where the reference model cannot be fitted.
    further : sequence of Data
        Data of further solves that the weights are to suit as well. Only those count that are
        partial, with bounds or gaps, if and only if `data` is.

    Raises InputError where the evidence is requested and the noise unknown.
    """
    cost = estimator.cost(scene, len(data.measured), partial=data.partial)
    similar = tuple(solve for solve in further if solve.partial == data.partial)
    search = WeightSearch(cost, (data, *similar), estimator.solver)
    first = data.start(near) if near is None else near
    small = data.measured[0].size <= MAX_CELLS and data.measured.size <= MAX_DENSE
    rule = estimator.auto_weight.rule or ("risk" if small else "evidence")
    if estimator.auto_weight.rule == "evidence" and not data.noise_known:
        raise InputError(
            "auto_weight.rule: evidence needs the noise: "
            "a readout in the scene or sigma in the recording"
        )
    choose = search.by_evidence if rule == "evidence" else search.by_risk
    with np.errstate(all="ignore"):
        return estimator.with_weights(*choose(first))


def strongest(changes: Sequence[float]) -> list[int]:
    """Return the numbers of the networks that decide the weight of all.

    The order is that of descending change from rest. The weight of a single network scatters with
    its noise, and hardly matters where nothing touches it.
    """
    return sorted(range(len(changes)), key=lambda number: -changes[number])[: 1 + MAX_NEIGHBOURS]


def converter_and_faults(scene: Scene) -> Hashable:
    """Return a key that is equal for networks with the same faults and converter.

    Networks of equal key share one weight.
    """
    circuit = scene.circuit
    return scene.faults, circuit.unit, circuit.adc_bits, circuit.readings, circuit.assumed_noise


@dataclass(frozen=True)
class WeightSearch:
    """The search for weights that a cost leaves open.

    Attributes
    ----------
    cost : Cost
        Each weight is a number or 'auto'.
    solves : tuple of Data
        The deciding solve, then further ones that the weights are to suit as well.
    settings : Settings
        Settings of the solver.
    """

    cost: Cost
    solves: tuple[Data, ...]
    settings: Settings

    @property
    def begun(self) -> list[float]:
        """The initial weights: the specified ones, and 1 for the open ones."""
        return [1.0 if term.weight == "auto" else float(term.weight) for term in self.cost.terms]

    @property
    def open_terms(self) -> list[int]:
        """The numbers of the terms whose weights are open."""
        return [number for number, term in enumerate(self.cost.terms) if term.weight == "auto"]

    def weighted(self, weights: Sequence[float]) -> Cost:
        """Return the cost with numbers for all weights."""
        terms = zip(self.cost.terms, weights, strict=True)
        return replace(
            self.cost, terms=tuple(replace(term, weight=float(weight)) for term, weight in terms)
        )

    @cached_property
    def references(self) -> list[Reference]:
        """Reference estimates of the solves, with σ as specified.

        Raises one of `BROKEN` where there are none.
        """
        return references(self.solves, self.cost, believed=True)[1]

    def models(self, weights: Sequence[float]) -> list[LinearModel]:
        """Return the cost with these weights, linearised at each solve's reference estimate."""
        cost = self.weighted(weights)
        pairs = zip(self.solves, self.references, strict=True)
        return [
            LinearModel(
                evaluated(cost, data, reference.cells), NO_DUAL, deviation=reference.deviation
            )
            for data, reference in pairs
        ]

    def spectra(self, number: int, weights: Sequence[float]) -> list[Spectrum]:
        """Return the spectrum of each solve over all weights of one penalty.

        The weights of the other penalties are given.

        Parameters
        ----------
        number : int
            Number of the penalty's term.
        weights : sequence of float
        """
        pairs = zip(self.models(weights), self.references, strict=True)
        return [Spectrum.of(model, number, reference.covariance) for model, reference in pairs]

    def by_risk(self, first: Array) -> Weights:
        """Return the weights with the least risk, found by coordinate descent over the open terms.

        Where no reference can be fitted, the weights are those of `suggested`. The standard
        deviation of ln λ is 1/√(Fisher information of ln λ).

        Parameters
        ----------
        first : array, shape (frames, rows, columns)
            Cells in ohm.
        """
        weights = self.suggested(first)
        sigma = [np.nan] * len(self.cost.terms)
        several = len(self.open_terms) > 1
        with suppress(*BROKEN):
            if several:
                weights = first_weights(self.models(self.begun)[0], self.begun, self.open_terms)
            for _ in range(MAX_SWEEPS if several else 1):
                previous = list(weights)
                for number in self.open_terms:
                    spectra = self.spectra(number, weights)
                    weights[number] = best_weight(spectra)
                    information = sum(spectrum.information(weights[number]) for spectrum in spectra)
                    sigma[number] = information**-0.5 if information > 0 else np.nan
                changes = np.log(np.array(weights) / np.array(previous))
                if np.nanmax(np.abs(changes), initial=0.0) < SETTLED:
                    break
        return weights, tuple(sigma)

    def suggested(self, first: Array) -> list[float]:
        """Return initial weights from the residuals at cells (frames, rows, columns) ohm."""
        at = evaluated(self.weighted(self.begun), self.solves[0], first)
        return first_weights(LinearModel(at, NO_DUAL), self.begun, self.open_terms)

    def by_evidence(self, first: Array) -> Weights:
        """Return the weights of the largest evidence, jointly with a factor s on σ.

        Uneven cells with little noise and even cells with much of it may both be local maxima. The
        weights λ(s) of a grid of factors are therefore settled, and −2 ln posterior of s is the
        integral of its derivative by ln s² (`EvidencePoint.slope`). Known noise has the prior s⁻² ~
        χ²_ν/ν with ν = NOISE_BELIEF·n, and s is at least 1. The standard deviation of ln λ is
        √(2/γ), with γ the degrees of freedom that the data determine.

        Parameters
        ----------
        first : array, shape (frames, rows, columns)
            Cells in ohm to start from.
        """
        data = self.solves[0]
        large = data.measured.size > MAX_CELLS
        weights = self.suggested(first) if large else self.by_risk(first)[0]
        sigma = [np.nan] * len(weights)
        with suppress(*BROKEN):
            begun = self._solved(weights, first, 1.0)
            least = 1.0 if data.noise_known else begun.residual_scale * SCALE_RATIO**-MAX_SCALES
            # from the first factor of the grid above the residuals down to the least one
            excess = max(begun.residual_scale / least, 1.0)
            steps = int(np.ceil(np.log(excess) / np.log(SCALE_RATIO)))
            points = [self._settled(begun, least * SCALE_RATIO**steps)]
            while points[-1].slope < 0 and len(points) < MAX_SCALES:
                points.append(self._settled(points[-1], points[-1].scale * SCALE_RATIO))
            for _ in range(steps):
                points.insert(0, self._settled(points[0], points[0].scale / SCALE_RATIO))
            best = most_evident(points)
            nearest = min(points, key=lambda point: abs(np.log(point.scale / best)))
            chosen = nearest if best == nearest.scale else self._settled(nearest, best)
            weights = chosen.weights
            for number in self.open_terms:
                sigma[number] = np.sqrt(2 / max(chosen.errors.determined(number), 1.0))
        return weights, tuple(sigma)

    def _settled(self, near: "EvidencePoint", scale: float) -> "EvidencePoint":
        """Return the weights settled for a factor on σ, from those of a near factor."""
        # λ is proportional to s² where the estimate stays
        ratio = (scale / near.scale) ** 2
        weights = [
            weight * ratio if n in self.open_terms else weight
            for n, weight in enumerate(near.weights)
        ]
        moved: Array = np.zeros(len(weights))
        previous = moved
        low, high = moved - np.inf, moved + np.inf
        for _ in range(MAX_SOLVES):
            near = self._solved(weights, near.cells, scale)
            place = np.log(weights)
            step, ascent = self._steps(near, place)
            if len(self.open_terms) == 1:  # the maximum of one weight lies where the ascent points
                low = np.where(ascent > 0, place, low)
                high = np.where(ascent < 0, place, high)
            # Secant of the step over ln λ: a step that reverses is shortened, because estimate and
            # weights would swing.
            share = moved / (previous - step)
            share = np.where(share > 0, np.clip(share, MIN_SHARE, 1.0), 1.0)
            previous = step
            # What the linear model says far away may contradict the estimates that were there.
            middle = np.where(np.isfinite(low + high), (low + high) / 2, place + ascent)
            target = place + share * step
            moved = np.where((low < target) & (target < high), target, middle) - place
            if np.abs(moved).max() < SETTLED:
                break
            weights = [float(weight) for weight in np.exp(place + moved)]
        return near

    def _steps(self, point: "EvidencePoint", place: Array) -> tuple[Array, Array]:
        """Return two steps of ln λ from a point, (terms,) each.

        The first leads to the fixed point of the linear model, in which the estimate follows the
        weights. The second is that of the fixed point at the estimate itself: the evidence grows
        along it.
        """
        from lampest.posterior.sampled import SampledErrors  # for the evidence alone

        model = point.errors.model
        if isinstance(point.errors, SampledErrors):
            step = np.log(next_weights(point.errors, self.open_terms)) - place
            return step, step
        settled = np.log(settled_weights(model, self.open_terms)) - place
        return settled, np.log(settled_weights(model, self.open_terms, rounds=1)) - place

    def _solved(self, weights: list[float], near: Array, scale: float) -> "EvidencePoint":
        """Return the estimate with these weights. Raises ArithmeticError where there is none."""
        from lampest.solvers.projected_newton import ProjectedNewton  # for several open weights

        data = self.solves[0]
        solution = best_solution(ProjectedNewton(self.weighted(weights), self.settings), data, near)
        if solution.at is None or solution.dual is None:
            raise ArithmeticError(solution.status)
        model = LinearModel(solution.at, solution.dual, deviation=scale * data.deviation)
        errors = DenseErrors(model)
        if data.measured.size > MAX_CELLS:
            from lampest.posterior.sampled import SampledErrors

            errors = SampledErrors(model)
        return EvidencePoint(scale, weights, solution.cell_resistance, errors)


@dataclass(frozen=True, eq=False)
class EvidencePoint:
    """Estimate with the weights that suit a factor on σ.

    Attributes
    ----------
    scale : float
        Factor s on σ.
    weights : list of float
        Weights λ of the terms.
    cells : array, shape (frames, rows, columns)
        Ohm.
    errors : DenseErrors
        Errors of the estimate.
    """

    scale: float
    weights: list[float]
    cells: Array
    errors: DenseErrors

    @cached_property
    def residuals(self) -> tuple[int, float, float]:
        """Size of the residuals of the data.

        Returns
        -------
        count : int
            Number n of data.
        freedom : float
            Degrees of freedom n − γ.
        squares : float
            Σ x²/τ² from the median of |x|/τ.
        """
        model = self.errors.model
        counted = model.data_curvature > 0
        count = int(counted.sum())
        penalties = np.unique(model.penalty_term)
        # γ: the unknowns that no penalty restricts, and those that the data determine against each
        # penalty
        by_penalties = sum(self.errors.determined(int(number)) for number in penalties)
        determined = len(model.free) - model.penalty_rank + by_penalties
        size = float(np.median(np.abs(model.residual[counted]) / model.noise[counted]))
        return count, max(count - determined, 0.0), count * (MAD_TO_SIGMA * size) ** 2

    @property
    def slope(self) -> float:
        """Derivative of −2 ln posterior by ln s², n − γ − Σ x²/τ² + ν (1 − 1/s²)."""
        count, freedom, squares = self.residuals
        belief = NOISE_BELIEF * count if self.errors.model.at.data.noise_known else 0.0
        return freedom - squares + belief * (1 - self.scale**-2)

    @property
    def residual_scale(self) -> float:
        """Standard deviation of the residuals over σ, √(Σ x²/τ² / (n − γ)).

        n − γ is at least MIN_FREEDOM n.
        """
        count, freedom, squares = self.residuals
        return self.scale * float(np.sqrt(squares / max(freedom, MIN_FREEDOM * count)))


def most_evident(points: Sequence[EvidencePoint]) -> float:
    """Return the factor s of the largest evidence, given points of ascending s."""
    # −2 ln evidence less that of the first point, and the factor
    level = 0.0
    best = (0.0, points[0].scale)
    for below, above in pairwise(points):
        length = 2 * np.log(above.scale / below.scale)
        if below.slope < 0 <= above.slope:
            share = below.slope / (below.slope - above.slope)
            way = share * length / 2
            best = min(best, (level + below.slope * way, below.scale * np.exp(way)))
        level += (below.slope + above.slope) * length / 2
    return min(best, (level, points[-1].scale))[1]
