"""`weight: auto`: of one penalty by a rule (`lampest.posterior.spectrum`), else the fixed point of the evidence.

A loss that is not squared is reweighted least squares at the estimate. Several penalties, and one of a large panel,
take the fixed point. The cost is linearised at an estimate; the estimate for the weight that this gives is where it is
linearised next.
"""

from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.objective import Objective
from lampest.estimate.state import NO_DUAL
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.fixed_point import first_weights, next_weights, settled_weights
from lampest.posterior.linear import LinearModel
from lampest.posterior.spectrum import Rule, Spectrum, best_weight
from lampest.posterior.track import MOST_DENSE
from lampest.solvers.multistart import BROKEN, best_solution, convex, evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

MOST_SOLVES, SETTLED = 4, 0.2  # of an estimate; of log λ: nothing that is reported changes by less
MOST_BESIDE = 4  # solves that decide on a weight beside the strongest one
AnyObjective = TypeVar("AnyObjective", bound=Objective)


def with_chosen_weights(
    estimator: AnyObjective,
    scene: Scene,
    data: Data,
    near: Array | None,
    noisy: bool,
    others: Sequence[Data] = (),
) -> AnyObjective:
    """The objective with numbers for the weights that it leaves open, from one solve's data.

    near : an estimate to start from, (frames, rows, columns) ohm, or None. noisy : whether the data's σ is known.
    others : of further solves, which a rule's weight is to suit as well, where readings are missing as in `data`.
    Raises InputError where σ is needed and unknown.
    """
    rule = rule_in_use(estimator, noisy)
    cost = estimator.cost(scene, len(data.measured), data.partial)
    search = WeightSearch(cost, data, estimator.solver, tuple(one for one in others if one.partial == data.partial))
    penalties = [number for number, term in enumerate(estimator.terms) if not term.reads_measurement]
    first = convex(data, near) if near is None else near
    with np.errstate(all="ignore"):
        if len(penalties) == 1 and data.measured.size <= MOST_DENSE:
            weights = search.begun
            weights[penalties[0]] = search.tried(penalties[0], rule, first)[-1]
            return estimator.with_weights(weights)
        if rule == "press":
            raise InputError(
                "weight: auto of more than one penalty, or of a large panel, needs the noise: name weights or add a "
                "readout to the scene or sigma to the recording"
            )
        return estimator.with_weights(search.by_evidence(penalties, first))


def strongest(changes: Sequence[float]) -> list[int]:
    """The numbers of the networks that choose a weight for all alike: those that differ most from rest, first the most.

    A network's own weight scatters with its noise, and hardly matters where nothing touches it.
    """
    return sorted(range(len(changes)), key=lambda number: -changes[number])[: 1 + MOST_BESIDE]


def converter_and_faults(scene: Scene) -> Hashable:
    """Equal for networks that one weight suits: with the same faults, read by the same converter."""
    circuit = scene.circuit
    return scene.faults, circuit.unit, circuit.adc_bits, circuit.readings, circuit.assumed_noise


def rule_in_use(estimator: Objective, noisy: bool) -> Rule:
    """The estimator's rule, or the default one. noisy : whether the data's σ is known.

    Raises InputError where the rule needs σ and it is unknown.
    """
    rule = estimator.auto_weight.rule or ("risk" if noisy else "press")
    if rule != "press" and not noisy:
        raise InputError(f"auto_weight.rule: {rule} needs the noise: a readout in the scene or sigma in the recording")
    return rule


@dataclass(frozen=True)
class WeightSearch:
    """cost : with weights that are numbers or 'auto'. data : of one solve; others : of further ones."""

    cost: Cost
    data: Data
    settings: Settings
    others: tuple[Data, ...] = ()

    @property
    def begun(self) -> list[float]:
        """The weights that are numbers, and 1 for the open ones."""
        return [1.0 if term.weight == "auto" else float(term.weight) for term in self.cost.terms]

    def weighted(self, weights: Sequence[float]) -> Cost:
        """The cost with numbers for all weights."""
        terms = zip(self.cost.terms, weights, strict=True)
        return replace(self.cost, terms=tuple(replace(term, weight=float(weight)) for term, weight in terms))

    def tried(self, penalty: int, rule: Rule, first: Array) -> list[float]:
        """What a rule calls the best weight at a start, and then at the estimates for each weight before.

        Where nothing can be linearised, because bounds decide every cell, what the start's residuals suggest. Where
        readings are bounds, a start that takes them for values is a poor place to linearise, and absolute losses have
        duals at an estimate only: the estimate for what the start's residuals suggest comes first. The start itself
        serves where the weight found there has no estimate.
        """
        dual = any(term.loss.enters == "dual" for term in self.cost.terms)
        with suppress(*BROKEN):
            if self.data.bounded or dual:
                models = []
                for data in (self.data, *self.others):
                    weights = replace(self, data=data)._suggested((penalty,), data.uniform_start)
                    model = self._solved(weights, data.uniform_start, data)
                    models += [] if model is None else [model]
                found, solved = self._followed(penalty, rule, models)
                if dual or (found and solved):
                    return found or [self._suggested((penalty,), first)[penalty]]
        found = []
        with suppress(*BROKEN):
            starts = [first, *(convex(data, None) for data in self.others)]
            cost, pairs = self.weighted(self.begun), zip((self.data, *self.others), starts, strict=True)
            models = [LinearModel(evaluated(cost, data, start), NO_DUAL) for data, start in pairs]
            found, _ = self._followed(penalty, rule, models)
        return found or [self._suggested((penalty,), first)[penalty]]

    def _followed(self, penalty: int, rule: Rule, models: list[LinearModel]) -> tuple[list[float], bool]:
        """(best weights from model to model, whether the last one that was tried has an estimate)."""
        weights, found = self.begun, list[float]()
        while models and len(found) < MOST_SOLVES:
            best = best_weight([Spectrum.of(model) for model in models], rule)
            weights[penalty] = float(np.sqrt(best * found[-1])) if found and self.data.bounded else best
            found.append(weights[penalty])
            if len(found) == MOST_SOLVES or (len(found) > 1 and abs(np.log(found[-1] / found[-2])) < SETTLED):
                break
            again = (self._solved(weights, model.at.cell_resistance, model.at.data) for model in models)
            models = [model for model in again if model is not None]
        return found, bool(models)

    def _suggested(self, penalties: Sequence[int], first: Array) -> list[float]:
        at = evaluated(self.weighted(self.begun), self.data, first)
        return first_weights(LinearModel(at, NO_DUAL), self.begun, penalties)

    def _solved(self, weights: Sequence[float], start: Array, data: Data) -> LinearModel | None:
        """What surrounds the estimate for these weights."""
        found = best_solution(ProjectedNewton(self.weighted(weights), self.settings), data, start)
        return None if found.at is None or found.dual is None else LinearModel(found.at, found.dual)

    def by_evidence(self, penalties: Sequence[int], first: Array) -> list[float]:
        """The weights that are open where the evidence has its fixed point."""
        sought = tuple(number for number in penalties if self.cost.terms[number].weight == "auto")
        weights, near = self._suggested(sought, first), first
        with suppress(*BROKEN):
            for _ in range(MOST_SOLVES):
                model = self._solved(weights, near, self.data)
                if model is None:
                    break
                near, before = model.at.cell_resistance, weights
                large = self.data.measured.size > MOST_DENSE
                weights = (next_weights if large else settled_weights)(model, sought)
                if max(abs(np.log(weights[number] / before[number])) for number in sought) < SETTLED:
                    break
        return weights
