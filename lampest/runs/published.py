"""What a publication says of an estimator, kept beside the results to be compared with them."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from math import isfinite
from typing import Any, ClassVar


@dataclass(frozen=True)
class StepFigures:
    """Published figures of some steps: mean and standard deviation of solve time (s) and of data error (percent).

    Raises ValueError where a figure is negative or not finite.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    time_s: float | None = None
    time_sd_s: float | None = None
    error_percent: float | None = None
    error_sd_percent: float | None = None

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, and finite")


@dataclass(frozen=True)
class PublishedFigures:
    """An estimator's figures in a publication: over all steps, or apart where the first is solved with the baseline."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    all: StepFigures | None = None
    initial: StepFigures | None = None
    following: StepFigures | None = None


def published_text(published: Mapping[str, PublishedFigures]) -> str:
    """Figures by estimator as JSON."""
    return json.dumps({name: asdict(figures) for name, figures in published.items()}, allow_nan=False)


def published_from(text: str) -> dict[str, PublishedFigures]:
    """Figures by estimator from JSON. Raises ValueError where it is something else."""
    try:
        return {
            str(name): PublishedFigures(
                **{step: StepFigures(**values) for step, values in figures.items() if values is not None}
            )
            for name, figures in json.loads(text).items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        names = ", ".join(item.name for item in fields(PublishedFigures))
        raise ValueError(f"is not figures by estimator and {names}") from error
