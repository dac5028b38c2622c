"""The shapes that simulation knows, and how recognition fits the round ones."""

from dataclasses import dataclass
from math import cos, hypot, log, radians, sin, sqrt
from typing import ClassVar, Literal

import numpy as np

from lampest.loads.shapes.disc import Disc, annular_pressure, annulus_mm2, contact_of_weight
from lampest.loads.shapes.round import (
    DIAMETER,
    MADE,
    RIM_WIDTH_MM,
    SOFT_EDGE_MM,
    SUCKING,
    SUCTION,
    TILT,
    WIDTH,
    RoundCandidate,
    RoundShape,
)
from lampest.loads.shapes.shape import Prior, Shape, Template
from lampest.panel.panel import Array

MOST_ELONGATED, MOST_LOBES = 10.0, 100  # of a mouth: beyond, a file has a slip of the pen


@dataclass(frozen=True, kw_only=True)
class Rod(RoundShape):
    """p = m·g/(π d²/4) under the flat end of an upright rod.

    Parameters
    ----------
    diameter_mm, mass_g : of the rod.

    Example: {kind: rod, centre_mm: [45, 45], diameter_mm: 40, mass_g: 680}

    >>> lampest.Rod(centre_mm=(10, 10), diameter_mm=20, mass_g=100).diameter_mm
    20.0
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="rod",
        templates=(Template(40.0, faint=True), Template(25.0, faint=True)),
        # Assumptions: 95 % of rods are 9 to 67 mm wide and press with 1 to 60 kPa.
        numbers={"diameter": Prior(log(25), 0.5, step=0.2), "rim": Prior(log(8), 1.0)} | TILT,
        uneven=MADE,
    )
    positive: ClassVar[tuple[str, ...]] = ("diameter_mm", "mass_g")
    kind: Literal["rod"] = "rod"
    diameter_mm: float
    mass_g: float

    def disc(self) -> Disc:
        """A full one."""
        weight = contact_of_weight(self.mass_g, annulus_mm2(0, self.diameter_mm))
        return self.pressing(0.0, self.diameter_mm, weight)


@dataclass(frozen=True, kw_only=True)
class Ring(RoundShape):
    """p = m·g/(π (d² − d_i²)/4) under a weighted ring.

    Parameters
    ----------
    inner_diameter_mm, outer_diameter_mm, mass_g : of the ring.

    Example: {kind: ring, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35, mass_g: 850}

    >>> lampest.Ring(centre_mm=(45, 45), inner_diameter_mm=27, outer_diameter_mm=35, mass_g=850).mass_g
    850.0
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="ring",
        templates=(Template(22.0, 11.0, faint=True), Template(42.0, 32.0), Template(32.0, 21.0)),
        # An assumption: 95 % of rings press with 4 to 220 kPa.
        numbers={"diameter": DIAMETER, "width": WIDTH, "rim": Prior(log(30), 1.0)} | TILT,
        uneven=MADE,
    )
    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm", "mass_g")
    kind: Literal["ring"] = "ring"
    inner_diameter_mm: float
    outer_diameter_mm: float
    mass_g: float

    def disc(self) -> Disc:
        """One that does not suck."""
        area = annulus_mm2(self.inner_diameter_mm, self.outer_diameter_mm)
        return self.pressing(self.inner_diameter_mm, self.outer_diameter_mm, contact_of_weight(self.mass_g, area))


@dataclass(frozen=True, kw_only=True)
class SuctionCup(RoundShape):
    """p < 0 inside d_i, against the surroundings, and p_rim = −p·d_i²/(d² − d_i²) under the rim that bears it.

    Of one frame a cup cannot be told from a mouth: recognition fits both as an oral disc.

    Parameters
    ----------
    inner_diameter_mm, outer_diameter_mm : of the rim.
    pressure_kpa : suction against the surroundings, negative.

    Example: {kind: suction_cup, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35, pressure_kpa: -10}

    >>> cup = lampest.SuctionCup(centre_mm=(45, 45), inner_diameter_mm=27, outer_diameter_mm=35, pressure_kpa=-10)
    >>> cup.pressure_kpa
    -10.0
    """

    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm")
    kind: Literal["suction_cup"] = "suction_cup"
    inner_diameter_mm: float
    outer_diameter_mm: float
    pressure_kpa: float

    def disc(self) -> Disc:
        """One whose rim bears the suction."""
        return self.sucking(self.inner_diameter_mm, self.outer_diameter_mm, self.pressure_kpa)


@dataclass(frozen=True, kw_only=True)
class OralDisc(RoundShape):
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

    >>> lampest.OralDisc(centre_mm=(44, 46), diameter_mm=35, rim_width_mm=6, pressure_kpa=-12).kind
    'oral_disc'
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="lamprey or cup",
        sucks=True,
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
        return self.sucking(inner, self.diameter_mm, self.pressure_kpa, self.rim_kpa, self.extra_rim_kpa)


@dataclass(frozen=True, kw_only=True)
class Block(Shape):
    """p = m·g/(a·b) under a rectangular foot; simulated only.

    Parameters
    ----------
    length_mm, width_mm, mass_g : edges a and b of the foot, and its load.
    angle_deg : direction of the length; 0 along the rows, towards higher columns, 90 towards higher rows.

    Example: {kind: block, centre_mm: [45, 45], length_mm: 50, width_mm: 20, mass_g: 500, angle_deg: 30}

    >>> lampest.Block(centre_mm=(45, 45), length_mm=50, width_mm=20, mass_g=500).width_mm
    20.0
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
        angle = radians(self.angle_deg)
        along, across = x * cos(angle) + y * sin(angle), y * cos(angle) - x * sin(angle)
        under = (np.abs(along) < self.length_mm / 2) & (np.abs(across) < self.width_mm / 2)
        return under * contact_of_weight(self.mass_g, self.length_mm * self.width_mm), np.zeros_like(x)
