"""How much work an estimate may cost: the rungs of the ladder between no reconstruction and a verified optimum.

Each names what is computed; documents may write the bare word (`effort: region`) or options with it.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, get_args, get_type_hints

from lampest.files.tagged import ByKind


@dataclass(frozen=True)
class TwoPoint:
    """r = R_m: no reconstruction. Costs nothing."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["two_point"] = "two_point"


@dataclass(frozen=True)
class Scaled:
    """r = R_m·MN/(M + N − 1): right for equal cells. Costs nothing."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["scaled"] = "scaled"


@dataclass(frozen=True)
class Linearised:
    """log r = log r_b − H_b⁻¹ ∇φ(r_b): one Newton step from the baseline, whose factor serves the whole recording."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["linearised"] = "linearised"


@dataclass(frozen=True)
class Truncated:
    """The first `steps` Newton steps of the reduced formulation from the previous frame.

    Raises ValueError unless there is at least one.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["truncated"] = "truncated"
    steps: int = 2

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps must be at least 1")


@dataclass(frozen=True)
class Region:
    """Only cells that changed are unknown, all others keep their baseline value.

    The region is the rectangle round the readings that stand out from the baseline's by more than `significance` times
    their noise; it grows until what is left outside is noise. Raises ValueError unless significance is positive.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["region"] = "region"
    significance: float = 6.0

    def __post_init__(self) -> None:
        if not 0 < self.significance < float("inf"):
            raise ValueError("significance must be positive and finite")


@dataclass(frozen=True)
class Converged:
    """A verified optimum, in the estimator's formulation or in the one that the word names."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["converged", "reduced", "nodal", "per_pixel"] = "converged"


AnyEffort = Annotated[TwoPoint | Scaled | Linearised | Truncated | Region | Converged, ByKind()]
Word = Literal["two_point", "scaled", "linearised", "truncated", "region", "converged", "reduced", "nodal", "per_pixel"]


def named(effort: AnyEffort | Word) -> AnyEffort:
    """The effort that a bare word stands for; an effort as it is."""
    if not isinstance(effort, str):
        return effort
    members = get_args(get_args(AnyEffort)[0])
    chosen: AnyEffort = next(
        member(kind=effort) for member in members if effort in get_args(get_type_hints(member)["kind"])
    )
    return chosen
