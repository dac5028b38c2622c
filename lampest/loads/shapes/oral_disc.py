"""The mouth of a lamprey."""

from dataclasses import dataclass
from math import cos, log, radians, sin, sqrt
from typing import ClassVar, Literal

import numpy as np

from lampest.loads.shapes.disc import Disc, annular_pressure
from lampest.loads.shapes.round import (
    DIAMETER,
    RIM_WIDTH_MM,
    SOFT_EDGE_MM,
    SUCKING,
    SUCTION,
    TILT,
    RoundCandidate,
    sucking_disc,
)
from lampest.loads.shapes.shape import Prior, Shape
from lampest.panel.panel import Array

MOST_ELONGATED, MOST_LOBES = 10.0, 100  # nothing of that form is a mouth; beyond, a file has a slip of the pen


@dataclass(frozen=True, kw_only=True)
class OralDisc(Shape):
    """Suction p in a lamprey's mouth and a soft rim that presses.

    Recognition lets it be long and uneven, and press harder than its suction needs.

    Parameters
    ----------
    diameter_mm, rim_width_mm : of the mouth over the rim, and of the rim. Of an elongated one the geometric mean of
        both axes; the area is that of the circle.
    pressure_kpa : suction against the surroundings, negative.
    rim_kpa : mean contact pressure under the rim; None: what bears the suction, p_rim·A_rim = −p·A_inside, and
        `extra_rim_kpa`.
    extra_rim_kpa : by which the rim presses harder than its suction needs.
    elongation : long axis over the short one. elongation_deg : direction of the long axis; 0 towards higher columns.
    unevenness : relative amplitude of the rim's pressure along the rim, 0 to 1; its mean stays. lobes : so many times
        around it presses hardest. unevenness_deg : direction of one of these, before the mouth was elongated.

    Source: suction is uniform over the mouth, -0.6 to -26 kPa at rest: Shi et al., PLoS ONE 16, e0247884, 2021.
    Example: {kind: oral_disc, centre_mm: [45, 45], diameter_mm: 35, rim_width_mm: 6, pressure_kpa: -12, rim_kpa: 90}
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="lamprey",
        sucks=True,
        target=True,
        hollow=True,
        templates=SUCKING,
        # Assumptions: 95 % of rims are 3 to 10 mm wide and press with 0.02 to 110 kPa more than their suction needs:
        # nearly nothing under a soft mouth, 80 kPa where bending under rim and teeth is taken in.
        numbers={
            "diameter": DIAMETER,
            "width": Prior(log(RIM_WIDTH_MM), 0.3),
            "suction": SUCTION,
            "push": Prior(log(1.5), 2.2),
        }
        | TILT,
        edge_mm=SOFT_EDGE_MM,
    )
    positive: ClassVar[tuple[str, ...]] = ("diameter_mm",)
    kind: Literal["oral_disc"] = "oral_disc"
    diameter_mm: float
    rim_width_mm: float
    pressure_kpa: float
    rim_kpa: float | None = None
    extra_rim_kpa: float = 0.0
    elongation: float = 1.0
    elongation_deg: float = 0.0
    unevenness: float = 0.0
    lobes: int = 2
    unevenness_deg: float = 0.0

    @property
    def reach_mm(self) -> float:
        """Half of its long axis over the rim."""
        return self.diameter_mm * sqrt(self.elongation) / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Suction inside, and the pressure of the rim: those of a round mouth, elongated."""
        round_one = self.disc()
        turn, stretch = radians(self.elongation_deg), sqrt(self.elongation)
        along, across = (x * cos(turn) + y * sin(turn)) / stretch, (y * cos(turn) - x * sin(turn)) * stretch
        contact, suction = annular_pressure(round_one, along, across)
        around = np.arctan2(across, along) + turn - radians(self.unevenness_deg)
        return contact * (1 + self.unevenness * np.cos(self.lobes * around)), suction

    def disc(self) -> Disc:
        """The round one of the same area whose rim presses evenly, as hard in the mean."""
        if not 0 < 2 * self.rim_width_mm < self.diameter_mm:
            raise ValueError("rim_width_mm must be positive and below half the diameter")
        if (
            not 1 <= self.elongation <= MOST_ELONGATED
            or not 0 <= self.unevenness <= 1
            or not 1 <= self.lobes <= MOST_LOBES
        ):
            raise ValueError(
                "elongation must lie between 1 and 10, lobes between 1 and 100, unevenness between 0 and 1"
            )
        if self.extra_rim_kpa < 0 or (self.extra_rim_kpa and self.rim_kpa is not None):
            raise ValueError("extra_rim_kpa must be zero or positive, and stands where rim_kpa does not")
        inner = self.diameter_mm - 2 * self.rim_width_mm
        return sucking_disc(self, inner, self.diameter_mm, self.pressure_kpa, self.rim_kpa, self.extra_rim_kpa)
