"""Choice of weights (`weight: auto`) by the least risk or by the evidence.

Risk: the weight minimises the expected squared error of log r, with the reference estimate
(`lampest.posterior.reference`) as the truth and its error scale as the noise. The cost is linearised at the reference
estimate, and the weight minimises `Spectrum.risk`; several penalties are optimised in turn. Evidence: on panels of
more than `MAX_CELLS` cells, and on request, the weights are the fixed point of the evidence, with the noise that the
residuals show.
"""

from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.estimate.objective import Objective
from lampest.estimate.state import NO_DUAL
from lampest.files.errors import InputError
from lampest.files.levels import MAD_TO_SIGMA
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.covariance import DenseErrors, SampledErrors
from lampest.posterior.linear import LinearModel, rank
from lampest.posterior.reference import MAX_CELLS, Reference, references
from lampest.posterior.spectrum import Spectrum, best_weight, first_weights, next_weights, settled_weights
from lampest.solvers.multistart import BROKEN, best_solution, convex, evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

MAX_SOLVES, SETTLED = 16, 0.2  # largest number of solves; change of ln λ that changes no reported figure
MAX_SWEEPS = 6  # over several penalties: each converges within a few
MIN_FREEDOM = 0.05  # degrees of freedom of a residual: with fewer, the scale of the residuals is not determined
AnyObjective = TypeVar("AnyObjective", bound=Objective)
Weights = tuple[list[float], tuple[float, ...]]  # of the terms, and the standard deviations of log λ


def with_chosen_weights(
    estimator: AnyObjective, scene: Scene, data: Data, near: Array | None, further: Sequence[Data] = ()
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
        Data of further solves that the weights are to suit as well. Only those count that are partial, with bounds or
        gaps, if and only if `data` is.

    Raises InputError where the evidence is requested and the noise unknown.
    """
    cost = estimator.cost(scene, len(data.measured), partial=data.partial)
    similar = tuple(solve for solve in further if solve.partial == data.partial)
    search = WeightSearch(cost, (data, *similar), estimator.solver)
    first = convex(data, near) if near is None else near
    small = data.measured[0].size <= MAX_CELLS and data.measured.size <= MAX_DENSE
    rule = estimator.auto_weight.rule or ("risk" if small else "evidence")
    if estimator.auto_weight.rule == "evidence" and not data.noise_known:
        raise InputError("auto_weight.rule: evidence needs the noise: a readout in the scene or sigma in the recording")
    with np.errstate(all="ignore"):
        return estimator.with_weights(*(search.by_evidence(first) if rule == "evidence" else search.by_risk(first)))


def strongest(changes: Sequence[float]) -> list[int]:
    """Return the numbers of the networks that decide the weight of all, in descending order of their change from rest.

    The weight of a single network scatters with its noise, and hardly matters where nothing touches it.
    """
    return sorted(range(len(changes)), key=lambda number: -changes[number])[: 1 + MAX_NEIGHBOURS]


def converter_and_faults(scene: Scene) -> Hashable:
    """Return a key that is equal for networks with the same faults and converter, which share one weight."""
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
        return replace(self.cost, terms=tuple(replace(term, weight=float(weight)) for term, weight in terms))

    @cached_property
    def references(self) -> list[Reference]:
        """The reference estimates of the solves, with σ as specified. Raises one of `BROKEN` where there are none."""
        return references(self.solves, self.cost, believed=True)[1]

    def models(self, weights: Sequence[float]) -> list[LinearModel]:
        """Return the cost with these weights, linearised at the reference estimate of each solve."""
        cost, pairs = self.weighted(weights), zip(self.solves, self.references, strict=True)
        return [
            LinearModel(evaluated(cost, data, reference.cells), NO_DUAL, deviation=reference.deviation)
            for data, reference in pairs
        ]

    def spectra(self, number: int, weights: Sequence[float]) -> list[Spectrum]:
        """Return the spectrum of each solve over all weights of one penalty, given those of the others.

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

        Where no reference can be fitted, the weights are those of `suggested`. The standard deviation of ln λ is
        1/√(Fisher information of ln λ).

        Parameters
        ----------
        first : array, shape (frames, rows, columns)
            Cells in ohm.
        """
        weights, sigma, several = self.suggested(first), [np.nan] * len(self.cost.terms), len(self.open_terms) > 1
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
        """Return the weights at the fixed point of the evidence, from those of least risk where these are defined.

        The standard deviation of ln λ is √(2/γ), with γ the degrees of freedom that the data determine. If the
        residuals exceed the noise (`residual_scale`), or if that is unknown, their scale multiplies σ. Solves for the
        cells alternate with updates of σ and λ; the step of a weight is halved whenever its direction reverses.

        Parameters
        ----------
        first : array, shape (frames, rows, columns)
            Cells in ohm to start from.
        """
        data, near, scale = self.solves[0], first, 1.0
        large = data.measured.size > MAX_CELLS
        weights = self.suggested(first) if large else self.by_risk(first)[0]
        errors_of, updated = (SampledErrors, next_weights) if large else (DenseErrors, settled_weights)
        step, share, sigma = np.zeros(len(weights)), np.ones(len(weights)), [np.nan] * len(weights)
        with suppress(*BROKEN):
            for _ in range(MAX_SOLVES):
                solution = best_solution(ProjectedNewton(self.weighted(weights), self.settings), data, near)
                if solution.at is None or solution.dual is None:
                    break
                near, model = solution.cell_resistance, LinearModel(solution.at, solution.dual)
                factor = residual_scale(errors_of(replace(model, deviation=scale * data.deviation)))
                before, scale = scale, max(1.0 if data.noise_known else 0.0, scale * factor)
                model = replace(model, deviation=scale * data.deviation)
                errors = errors_of(model)
                for number in self.open_terms:
                    sigma[number] = np.sqrt(2 / max(errors.determined(number), 1.0))
                previous, step = step, np.log(updated(model, self.open_terms)) - np.log(weights)
                share = np.where(step * previous < 0, share / 2, share)
                weights = [float(weight) for weight in np.exp(np.log(weights) + share * step)]
                if np.abs([*step, np.log(scale / before)]).max() < SETTLED:
                    break
        return weights, tuple(sigma)


def residual_scale(errors: DenseErrors) -> float:
    """Return the robust standard deviation of the residuals x in units of their noise τ.

    It is 1.4826 · median |x|/τ / √(1 − γ/n), with γ the degrees of freedom of the cells that n data determine; 1
    where 1 − γ/n is below MIN_FREEDOM.
    """
    model = errors.model
    counted = model.data_curvature > 0
    penalties = np.unique(model.penalty_term)
    # γ: the unknowns that no penalty restricts, and those that the data determine against each penalty
    bound = min(rank(model.at.cost.unweighted), len(model.free))
    determined = len(model.free) - bound + sum(errors.determined(int(number)) for number in penalties)
    freedom = 1 - determined / max(int(counted.sum()), 1)
    if freedom < MIN_FREEDOM:
        return 1.0
    sizes = np.abs(model.residual[counted]) / model.noise[counted]
    return MAD_TO_SIGMA * float(np.median(sizes)) / float(np.sqrt(freedom))
