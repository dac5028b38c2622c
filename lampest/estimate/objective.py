"""Objectives: what a solve minimises, whatever the method."""

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Literal, Self

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Term
from lampest.files.typed import Configuration
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.posed import Bounds, cost_of_solve, data_of_solve
from lampest.solvers.solution import Settings

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
