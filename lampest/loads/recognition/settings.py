"""What a user may tell the recognition beside the results."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from lampest.loads.recognition.model_errors import ModelErrors
from lampest.panel.panel import Panel
from lampest.panel.scene import Water

LEAST, MOST = 1e-9, 1e6  # mm or percent
PATCH_SHARE = 0.6  # edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm


@dataclass(frozen=True)
class RecognitionSettings:
    """Assumptions about the panel and the errors.

    Parameters
    ----------
    patch_mm : edge of a cell's film in mm; None: 6/10 of the pitch.
    top_row_depth_mm : depth of row 0 below the water's surface in mm, row by row deeper; None: what the results
        say, or in air.
    noise_percent : standard deviation of every reading in percent, where the results do not hold it; None: refuse.
    model_errors : the errors beside the readings' noise.
    zero_after : frames in a row without a load from which the unloaded panel is taken anew; 0: never.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    patch_mm: float | None = None
    top_row_depth_mm: float | None = None
    noise_percent: float | None = None
    model_errors: ModelErrors = field(default_factory=ModelErrors)
    zero_after: int = 20

    def __post_init__(self) -> None:
        if self.zero_after != 0 and self.zero_after < 5:
            raise ValueError("zero_after must be 0, or at least 5 frames")
        for name in ("patch_mm", "noise_percent"):
            value = getattr(self, name)
            if value is not None and not LEAST <= value <= MOST:
                raise ValueError(f"{name} must be positive and finite, between {LEAST:g} and {MOST:g}")
        if self.top_row_depth_mm is not None:
            Water(self.top_row_depth_mm)

    def patch_of(self, panel: Panel) -> float:
        """Edge of the film in mm. Never more than the pitch."""
        return min(self.patch_mm or PATCH_SHARE * panel.pitch_mm, panel.pitch_mm)
