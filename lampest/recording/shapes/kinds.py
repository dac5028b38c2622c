"""Shapes of simulation."""

from abc import abstractmethod
from dataclasses import dataclass
from math import cos, hypot, inf, radians, sin, sqrt
from typing import Literal

import numpy as np

from lampest.files.typed import check_range
from lampest.panel.panel import Array
from lampest.panel.response import VACUUM_KPA
from lampest.recording.shapes.disc import Disc, annulus_mm2, bearing_kpa, contact_of_weight
from lampest.recording.shapes.shape import Shape


@dataclass(frozen=True, kw_only=True)
class RoundShape(Shape):
    """A shape whose pressure is that of a disc."""

    @abstractmethod
    def disc(self) -> Disc:
        """Return the disc. Raises ValueError where the shape's numbers are inconsistent."""

    @property
    def reach_mm(self) -> float:
        return self.disc().diameter_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        return self.disc().pressure_at(x, y)

    def pressing(
        self, inner_mm: float, outer_mm: float, rim_kpa: float, suction_kpa: float | None = None
    ) -> Disc:
        """Return the disc with these numbers.

        Raises ValueError where a pressure is out of range.
        """
        if suction_kpa is not None and not VACUUM_KPA < suction_kpa < 0:
            raise ValueError(
                "pressure_kpa is a suction: it must be negative, and above -101 kPa, an empty space"
            )
        if not 0 <= rim_kpa < inf:
            raise ValueError("the contact pressure must be zero or positive, and finite")
        direction = radians(self.tilt_direction_deg)
        tilt = (self.tilt * cos(direction), self.tilt * sin(direction))
        return Disc(*self.centre_mm, outer_mm, inner_mm, suction_kpa or 0.0, rim_kpa, *tilt)


@dataclass(frozen=True, kw_only=True)
class Rod(RoundShape):
    """p = m·g/(π d²/4) under the flat end of an upright rod.

    Example: {kind: rod, centre_mm: [45, 45], diameter_mm: 40, mass_g: 680}

    >>> lampest.Rod(centre_mm=(10, 10), diameter_mm=20, mass_g=100).diameter_mm
    20.0
    """

    positive = ("diameter_mm", "mass_g")
    kind: Literal["rod"] = "rod"
    diameter_mm: float
    mass_g: float

    def disc(self) -> Disc:
        return self.pressing(
            0.0, self.diameter_mm, contact_of_weight(self.mass_g, annulus_mm2(0, self.diameter_mm))
        )


@dataclass(frozen=True, kw_only=True)
class Ring(RoundShape):
    """p = m·g/(π (d² − d_i²)/4) under a weighted ring.

    Example: {kind: ring, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35, mass_g:
    850}

    >>> diameters = {"inner_diameter_mm": 27, "outer_diameter_mm": 35}
    >>> lampest.Ring(centre_mm=(45, 45), **diameters, mass_g=850).mass_g
    850.0
    """

    positive = ("inner_diameter_mm", "outer_diameter_mm", "mass_g")
    kind: Literal["ring"] = "ring"
    inner_diameter_mm: float
    outer_diameter_mm: float
    mass_g: float

    def disc(self) -> Disc:
        area = annulus_mm2(self.inner_diameter_mm, self.outer_diameter_mm)
        return self.pressing(
            self.inner_diameter_mm, self.outer_diameter_mm, contact_of_weight(self.mass_g, area)
        )


@dataclass(frozen=True, kw_only=True)
class SuctionCup(RoundShape):
    """p = pressure_kpa < 0 inside d_i, against the surroundings.

    The rim bears the suction with the pressure p_rim = −p·d_i²/(d² − d_i²). A single frame does not
    distinguish a cup from a mouth: recognition fits both as an oral disc.

    Example: {kind: suction_cup, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35,
    pressure_kpa: -10}

    >>> diameters = {"inner_diameter_mm": 27, "outer_diameter_mm": 35}
    >>> lampest.SuctionCup(centre_mm=(9, 9), **diameters, pressure_kpa=-10).tilt
    0.0
    """

    positive = ("inner_diameter_mm", "outer_diameter_mm")
    kind: Literal["suction_cup"] = "suction_cup"
    inner_diameter_mm: float
    outer_diameter_mm: float
    pressure_kpa: float

    def disc(self) -> Disc:
        inner = self.inner_diameter_mm
        outer = self.outer_diameter_mm
        return self.pressing(
            inner, outer, bearing_kpa(self.pressure_kpa, inner, outer), self.pressure_kpa
        )


@dataclass(frozen=True, kw_only=True)
class OralDisc(RoundShape):
    """Suction p in a lamprey's mouth, with a soft rim that presses.

    A mouth in recognition may be elongated and uneven, and press harder than its suction requires.

    Attributes
    ----------
    diameter_mm : float
        Outer diameter of the rim; for an elongated mouth the geometric mean of both axes.
    rim_width_mm : float
    pressure_kpa : float
        Suction against the surroundings, negative.
    rim_kpa : float or None
        Mean contact pressure under the rim; None: the pressure that bears the suction,
        p_rim·A_rim = −p·A_inside, and `extra_rim_kpa`.
    extra_rim_kpa : float
        Excess of the rim's pressure over that which bears the suction.
    elongation, elongation_deg : float
        Long axis over the short one, and direction of the long axis; 0 towards higher columns.
    unevenness : float
        Relative amplitude of the rim's pressure along the rim, 0 to 1; the mean is unchanged.
    lobes : int
        Number of maxima along the rim.
    unevenness_deg : float
        Direction of one maximum, before the elongation.

    Source: suction is uniform over the mouth, -0.6 to -26 kPa at rest: Shi et al., PLoS ONE 16,
    e0247884, 2021.
    Example: {kind: oral_disc, centre_mm: [45, 45], diameter_mm: 35, rim_width_mm: 6, pressure_kpa:
    -12, rim_kpa: 90}

    >>> lampest.OralDisc(centre_mm=(44, 46), diameter_mm=35, rim_width_mm=6, pressure_kpa=-12).kind
    'oral_disc'
    """

    positive = ("diameter_mm",)
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
        return self.diameter_mm * sqrt(self.elongation) / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pressure of the rim and the suction inside of the elongated mouth at points.

        Points are mapped to the round mouth of equal area, and the rim's pressure is multiplied by
        its unevenness.

        Returns
        -------
        contact, suction : array, shape of `x`
            Contact pressure of the rim, and suction inside, kPa.
        """
        round_one = self.disc()
        turn = radians(self.elongation_deg)
        stretch = sqrt(self.elongation)
        along = (x * cos(turn) + y * sin(turn)) / stretch
        across = (y * cos(turn) - x * sin(turn)) * stretch
        contact, suction = round_one.pressure_at(along, across)
        around = np.arctan2(across, along) + turn - radians(self.unevenness_deg)
        return contact * (1 + self.unevenness * np.cos(self.lobes * around)), suction

    def disc(self) -> Disc:
        """Return the round disc of equal area and equal mean pressure, without unevenness."""
        if not 0 < 2 * self.rim_width_mm < self.diameter_mm:
            raise ValueError("rim_width_mm must be positive and below half the diameter")
        check_range("elongation", self.elongation, 1, 10)
        check_range("unevenness", self.unevenness, 0, 1)
        check_range("lobes", self.lobes, 1, 100)
        if self.extra_rim_kpa < 0 or (self.extra_rim_kpa and self.rim_kpa is not None):
            raise ValueError(
                "extra_rim_kpa must be zero or positive, and stands where rim_kpa does not"
            )
        inner = self.diameter_mm - 2 * self.rim_width_mm
        bearing = bearing_kpa(self.pressure_kpa, inner, self.diameter_mm) + self.extra_rim_kpa
        rim = bearing if self.rim_kpa is None else self.rim_kpa
        return self.pressing(inner, self.diameter_mm, rim, self.pressure_kpa)


@dataclass(frozen=True, kw_only=True)
class Block(Shape):
    """p = m·g/(a·b) under a rectangular foot; simulated only.

    Attributes
    ----------
    length_mm, width_mm : float
        a and b.
    mass_g : float
        m.
    angle_deg : float
        Direction of the length a; 0 along the rows, towards higher columns, 90 towards higher rows.

    Example: {kind: block, centre_mm: [45, 45], length_mm: 50, width_mm: 20, mass_g: 500, angle_deg:
    30}

    >>> lampest.Block(centre_mm=(45, 45), length_mm=50, width_mm=20, mass_g=500).width_mm
    20.0
    """

    positive = ("length_mm", "width_mm", "mass_g")
    kind: Literal["block"] = "block"
    length_mm: float
    width_mm: float
    mass_g: float
    angle_deg: float = 0.0

    @property
    def reach_mm(self) -> float:
        return hypot(self.length_mm, self.width_mm) / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the pressure at points x, y in mm from the centre; see `Shape.pressure_at`.

        Returns
        -------
        contact, suction : array, shape of `x`
            Contact pressure of the mass under the block, and zeros, kPa.
        """
        angle = radians(self.angle_deg)
        along = x * cos(angle) + y * sin(angle)
        across = y * cos(angle) - x * sin(angle)
        under = (np.abs(along) < self.length_mm / 2) & (np.abs(across) < self.width_mm / 2)
        return under * contact_of_weight(
            self.mass_g, self.length_mm * self.width_mm
        ), np.zeros_like(x)
