"""A block on a rectangular foot: no circle, and simulated only."""

from dataclasses import dataclass
from math import hypot
from typing import ClassVar, Literal

import numpy as np

from lampest.loads.shapes.disc import contact_of_weight
from lampest.loads.shapes.shape import Shape
from lampest.panel.panel import Array


@dataclass(frozen=True, kw_only=True)
class Block(Shape):
    """p = m·g/(a·b) under a rectangular foot.

    Parameters
    ----------
    length_mm, width_mm, mass_g : edges a and b of the foot, and its load.
    angle_deg : direction of the length; 0 along the rows, towards higher columns, 90 towards higher rows.

    Example: {kind: block, centre_mm: [45, 45], length_mm: 50, width_mm: 20, mass_g: 500, angle_deg: 30}
    """

    positive: ClassVar[tuple[str, ...]] = ("length_mm", "width_mm", "mass_g")
    kind: Literal["block"] = "block"
    length_mm: float
    width_mm: float
    mass_g: float
    angle_deg: float = 0.0

    @property
    def reach_mm(self) -> float:
        """Half the diagonal."""
        return hypot(self.length_mm, self.width_mm) / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The same pressure everywhere under the foot, and no suction."""
        angle = np.radians(self.angle_deg)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        under = (np.abs(along) < self.length_mm / 2) & (np.abs(across) < self.width_mm / 2)
        return under * contact_of_weight(self.mass_g, self.length_mm * self.width_mm), np.zeros_like(x)
