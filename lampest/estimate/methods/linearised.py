"""One Newton step from the baseline."""

from dataclasses import dataclass
from typing import Literal

from lampest.cost.problem import Evaluation
from lampest.estimate.methods.anchored import Anchor, AnchoredMethod
from lampest.solvers.linearised import LinearisedSolver
from lampest.solvers.solution import Settings


@dataclass(frozen=True)
class LinearisedMethod(AnchoredMethod):
    """log r = log r_b − H_b⁻¹ ∇φ(r_b): one Newton step from the baseline, whose factor serves the whole recording."""

    kind: Literal["linearised"] = "linearised"

    def anchor(self, baseline: Evaluation, settings: Settings) -> Anchor:
        """The baseline's factor."""
        return LinearisedSolver(baseline)
