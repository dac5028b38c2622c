"""The mouth of a lamprey."""

from dataclasses import dataclass
from math import cos, log, radians, sin, sqrt
from typing import ClassVar, Literal

import numpy as np

from lampest.loads.shapes.disc import Disc, annular_pressure, bearing_slope, log_bearing
from lampest.loads.shapes.round import DIAMETER, RIM_WIDTH_MM, SUCKING, SUCTION, TILT, RoundCandidate, sucking_disc
from lampest.loads.shapes.shape import Prior, Shape
from lampest.panel.panel import Array

HARDER = 1.25  # so many times as hard as its suction needs a lamprey's rim presses at least; an assumption


def harder_than_needed(lamprey: RoundCandidate, parameters: Array) -> tuple[float, Array]:
    """ln p − ln(1.25·p_bear), and its slopes by φ."""
    disc, slopes = lamprey.disc_with_slopes(parameters)
    share = disc.inner_mm / disc.diameter_mm
    rim, suction = lamprey.names.index("rim"), lamprey.names.index("suction")
    margin = parameters[rim] - log_bearing(disc.suction_kpa, share) - log(HARDER)
    slope = -bearing_slope(share) * (slopes[3] - share * slopes[2]) / disc.diameter_mm
    slope[rim] += 1.0
    slope[suction] -= 1.0
    return float(margin), np.asarray(slope)


@dataclass(frozen=True, kw_only=True)
class OralDisc(Shape):
    """Suction p in a lamprey's mouth and a soft rim that presses.

    Recognition takes it for a lamprey where the rim presses harder than 1.25 times what bears the suction.

    Parameters
    ----------
    diameter_mm, rim_width_mm : of the mouth over the rim, and of the rim. Of an elongated one the geometric mean of both
        axes; the area is that of the circle.
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
        # Assumptions: 95 % of rims are 3 to 10 mm wide and press with 34 to 167 kPa.
        numbers={
            "diameter": DIAMETER,
            "width": Prior(log(RIM_WIDTH_MM), 0.3),
            "suction": SUCTION,
            "rim": Prior(log(75), 0.4),
        }
        | TILT,
        bound=harder_than_needed,
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
        turn, stretch = radians(self.elongation_deg), sqrt(self.elongation)
        along, across = (x * cos(turn) + y * sin(turn)) / stretch, (y * cos(turn) - x * sin(turn)) * stretch
        contact, suction = annular_pressure(self.disc(), along, across)
        around = np.arctan2(across, along) + turn - radians(self.unevenness_deg)
        return contact * (1 + self.unevenness * np.cos(self.lobes * around)), suction

    def disc(self) -> Disc:
        """The round one of the same area whose rim presses evenly, as hard in the mean."""
        if not 0 < 2 * self.rim_width_mm < self.diameter_mm:
            raise ValueError("rim_width_mm must be positive and below half the diameter")
        if self.elongation < 1 or not 0 <= self.unevenness <= 1 or self.lobes < 1:
            raise ValueError("elongation and lobes must be at least 1, and unevenness lie between 0 and 1")
        if self.extra_rim_kpa < 0 or (self.extra_rim_kpa and self.rim_kpa is not None):
            raise ValueError("extra_rim_kpa must be zero or positive, and stands where rim_kpa does not")
        inner = self.diameter_mm - 2 * self.rim_width_mm
        return sucking_disc(self, inner, self.diameter_mm, self.pressure_kpa, self.rim_kpa, self.extra_rim_kpa)
