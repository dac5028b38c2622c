"""Only what changed is unknown."""

from dataclasses import dataclass
from typing import Literal

from lampest.cost.problem import Evaluation
from lampest.estimate.methods.anchored import Anchor, AnchoredMethod
from lampest.solvers.region.region import RegionSolver
from lampest.solvers.solution import Settings


@dataclass(frozen=True)
class RegionMethod(AnchoredMethod):
    """Only cells that changed are unknown, all others keep their baseline value.

    The region is the rectangle round the readings that stand out from the baseline's by more than `significance` times
    their noise; it grows until what is left outside is noise. Raises ValueError unless significance is positive.
    """

    kind: Literal["region"] = "region"
    significance: float = 6.0

    def __post_init__(self) -> None:
        if not 0 < self.significance < float("inf"):
            raise ValueError("significance must be positive and finite")

    def anchor(self, baseline: Evaluation, settings: Settings) -> Anchor:
        """The baseline's network."""
        return RegionSolver(baseline, self.significance, settings)
