"""Base class of shapes, which give the pressure at a point to simulations."""

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lampest.files.typed import Configuration, check_positive_fields, check_range
from lampest.panel.panel import Array, Panel

# Along either edge of a patch: the error of a footprint's edge is at most a sixteenth of the patch.
POINTS = 8


@dataclass(frozen=True, kw_only=True)
class Shape(Configuration):
    """A load somewhere on the panel, of any footprint.

    A subclass adds its numbers and `kind`, and implements `reach_mm` and `pressure_at`, which
    suffice. `positive` names the numbers that must be positive.

    Attributes
    ----------
    centre_mm : (float, float)
        x and y of the centre; cells lie at their places, of a full rectangle at x = k·pitch and
        y = j·pitch.
    tilt : float
        Relative change of the contact pressure from the centre to its reach, 0 to 1; the mean is
        unchanged where the contact is symmetric about the centre.
    tilt_direction_deg : float
        Direction of the highest pressure; 0 towards higher columns, 90 towards higher rows.

    >>> issubclass(lampest.Rod, lampest.Shape)
    True
    """

    positive: ClassVar[tuple[str, ...]] = ()
    centre_mm: tuple[float, float]
    tilt: float = 0.0
    tilt_direction_deg: float = 0.0

    def __post_init__(self) -> None:
        check_positive_fields(self, *self.positive)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float | tuple) and not np.isfinite(value).all():
                raise ValueError(f"{field.name} must be finite")
        check_range("tilt", self.tilt, 0, 1)
        # Inconsistent numbers are refused at construction, and not where the shape is used.
        if not np.isfinite(self.pressure_at(np.zeros(1), np.zeros(1))).all():
            raise ValueError("the contact pressure must be finite")

    @property
    @abstractmethod
    def reach_mm(self) -> float:
        """Largest distance of the footprint from the centre, mm."""

    @abstractmethod
    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pressure at points x, y in mm from the centre.

        Returns
        -------
        contact, suction : array, shape of `x`
            Contact pressure ≥ 0 without tilt, and suction ≤ 0, kPa.
        """

    def mean_pressure(self, panel: Panel, patch_mm: float) -> tuple[Array, Array]:
        """Return the mean pressure over square patches with the edge `patch_mm`.

        Returns
        -------
        contact, suction : array, shape (rows, columns)
            Mean contact pressure, tilt included, and mean suction, kPa.
        """
        offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
        across, down = np.where(panel.present, panel.places_mm, 0.0)[:, :, None, :, None]
        blocks = (panel.rows, POINTS, panel.columns, POINTS)
        # points of all patches, (rows, POINTS, columns, POINTS) mm from the centre
        x = np.broadcast_to(across + offset - self.centre_mm[0], blocks)
        y = np.broadcast_to(down + offset[:, None, None] - self.centre_mm[1], blocks)
        contact, suction = self.pressure_at(x, y)
        direction = np.radians(self.tilt_direction_deg)
        tilting = 1 + self.tilt * (x * np.cos(direction) + y * np.sin(direction)) / self.reach_mm
        contact, suction = (
            panel.present * part.mean(axis=(1, 3)) for part in (contact * tilting, suction)
        )
        return contact, suction
