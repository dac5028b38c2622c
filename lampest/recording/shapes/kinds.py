"""Shapes of simulation, and the model of round shapes that recognition fits."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import cos, exp, hypot, inf, log, radians, sin, sqrt
from typing import ClassVar, Literal

import numpy as np

from lampest.files.typed import check_range
from lampest.panel.panel import Array, Panel
from lampest.panel.response import VACUUM_KPA
from lampest.recording.shapes.disc import (
    EVEN,
    Disc,
    Unevenness,
    annulus_mm2,
    bearing_kpa,
    contact_of_weight,
    pressure_at_places,
)
from lampest.recording.shapes.shape import Candidate, Prior, Shape, Template, centre_priors

# Ln mm: 95 % of diameters are between 15 and 60 mm (an assumption).
DIAMETER = Prior(log(30), 0.35, step=0.2)
TILT = Prior(0, 0.25, step=0.3, sway=0.1)
COMPLEX_STEP = 2.0**-104  # of derivatives, which have full precision, because nothing is subtracted
CLOSED = 0.05  # rounding of d_i/d at 0, so that it stays positive for any width of the rim


@dataclass(frozen=True, eq=False, kw_only=True)
class RoundCandidate(Candidate):
    """A disc with the parameters φ: x, y and tilts directly, all other numbers by their logarithms.

    Attributes
    ----------
    numbers : mapping of str to Prior
        Priors of the numbers beside the centre, in the order of φ: `diameter`; `width` of the rim,
        absent for a full disc; `suction` inside the rim, absent for none; and one of `rim`, the
        pressure under it, and `push`, its excess over p_bear. Tilts along x and y follow; 95 % are
        below a half (an assumption).
    uneven : tuple of float
        Standard deviations of the numbers of `Unevenness`, the last of φ. Assumption: manufactured
        objects are round within 8 %, and press evenly within ±16 % along the rim.
    edge_mm : float
        Common error of the places of both edges. Assumption: films are cut to a millimetre, and
        rims are rounded.
    """

    numbers: Mapping[str, Prior]
    uneven: tuple[float, ...] = (0.02, 0.02, 0.08, 0.08)
    edge_mm: float = 0.7

    @cached_property
    def _own(self) -> Mapping[str, Prior]:
        """Priors of all numbers but the centre, in the order of φ."""
        uneven = zip(Unevenness._fields, self.uneven, strict=True)
        tilts = {"tilt_x": TILT, "tilt_y": TILT}
        return {**self.numbers, **tilts, **{name: Prior(0, sd, step=0.1) for name, sd in uneven}}

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        return {**centre_priors(panel), **self._own}

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Return the pressure of an elongated, uneven disc; see `Candidate.pressure`.

        Returns
        -------
        pressure : array, shape (rows, columns)
            Mean pressure on the patches, kPa.
        slopes : array, shape (parameters, rows, columns)
            Derivatives of the pressure by φ, kPa.
        """
        disc, by_parameter = self.disc_with_slopes(parameters)
        form = slice(-len(EVEN), None)
        pressure, by_number = pressure_at_places(
            panel.places_mm, patch_mm, disc, Unevenness(*parameters[form])
        )
        slopes = np.tensordot(by_parameter, by_number[: len(disc)], (0, 0))
        slopes[form] = by_number[len(disc) :]
        return pressure, slopes

    def disc(self, parameters: Array) -> Disc:
        return Disc(*self._numbers(parameters).tolist())

    def disc_with_slopes(self, parameters: Array) -> tuple[Disc, Array]:
        """Return the disc of φ, and its derivatives by complex steps, Im f(φ + ih)/h.

        Returns
        -------
        disc : Disc
        slopes : array, shape (8, parameters)
            Derivatives of the disc's numbers by φ.

        Source: Squire, Trapp, SIAM Review 40, 110 (1998).
        """
        numbers = self._numbers(parameters[:, None] + 1j * COMPLEX_STEP * np.eye(len(parameters)))
        return Disc(*numbers[:, 0].real.tolist()), numbers.imag / COMPLEX_STEP

    def _numbers(self, parameters: Array) -> Array:
        """Return the numbers of the disc, (8, …), of φ (parameters, …), real or complex."""
        at = dict(zip(("x", "y", *self._own), parameters, strict=True))
        diameter = np.exp(at["diameter"])
        share = suction = np.zeros_like(diameter)
        if "width" in at:  # d_i/d = 1 − 2w/d, smoothly limited to positive values
            hollow = 1 - 2 * np.exp(at["width"]) / diameter
            share = (hollow + np.sqrt(hollow**2 + CLOSED**2)) / 2
        if "suction" in at:
            suction = -np.exp(at["suction"])
        # p_bear = −s d_i²/(d² − d_i²)
        bearing = -suction * share**2 / (1 - share**2)
        rim = np.exp(at["rim"]) if "rim" in at else bearing + np.exp(at["push"])
        return np.stack(
            [at["x"], at["y"], diameter, share * diameter, suction, rim, at["tilt_x"], at["tilt_y"]]
        )

    def start(self, disc: Disc) -> Array:
        """Return φ of a disc.

        Numbers that the disc lacks are small, and a full disc has the same force.
        """
        hollow = "width" in self.numbers
        width = exp(self.numbers["width"].mean) if hollow else 0.0
        bearing = 0.0
        mean = disc.rim_kpa
        if disc.inner_mm:
            hole = (disc.inner_mm / disc.diameter_mm) ** 2
            mean = disc.rim_kpa * (1 - hole) + disc.suction_kpa * hole
            width = (disc.diameter_mm - disc.inner_mm) / 2
            bearing = bearing_kpa(disc.suction_kpa, disc.inner_mm, disc.diameter_mm)
        values = {
            "diameter": log(disc.diameter_mm),
            "width": log(max(min(width, 0.4 * disc.diameter_mm), 0.5)),
            "suction": log(max(-disc.suction_kpa, 1.0)),
            "rim": log(max(disc.rim_kpa if hollow else mean, 0.1)),
            "push": log(max(disc.rim_kpa - bearing, 0.5)),
        }
        numbers = (values[name] for name in self.numbers)
        return np.array([disc.x_mm, disc.y_mm, *numbers, disc.tilt_x, disc.tilt_y, *EVEN])

    def blind(self, parameters: Array) -> Array:
        """Return the deviations that readings cannot reduce: edge_mm/d of ln d, 0 of all others."""
        place = ("x", "y", *self._own).index("diameter")
        return np.asarray(np.eye(len(parameters))[place] * (self.edge_mm / exp(parameters[place])))

    def report(self, parameters: Array) -> dict[str, tuple[float, Array]]:
        disc, slopes = self.disc_with_slopes(parameters)
        names = ("x_mm", "y_mm", "diameter_mm", *(("suction_kpa",) if self.sucks else ()))
        return {name: (getattr(disc, name), slopes[Disc._fields.index(name)]) for name in names}


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

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="rod",
        templates=(Template(40.0, faint=True), Template(25.0, faint=True)),
        # Assumptions: 95 % of rods are 9 to 67 mm wide and press with 1 to 60 kPa.
        numbers={"diameter": Prior(log(25), 0.5, step=0.2), "rim": Prior(log(8), 1.0)},
    )
    positive: ClassVar[tuple[str, ...]] = ("diameter_mm", "mass_g")
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

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="ring",
        templates=(Template(22.0, 11.0, faint=True), Template(42.0, 32.0), Template(32.0, 21.0)),
        # Assumptions: 95 % of rings are 2.3 to 13 mm wide, and press with 4 to 220 kPa.
        numbers={"diameter": DIAMETER, "width": Prior(log(5.5), 0.45), "rim": Prior(log(30), 1.0)},
    )
    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm", "mass_g")
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

    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm")
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

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="lamprey or cup",
        sucks=True,
        # Templates in which the suction changes cells as much as the rim does.
        templates=(Template(45.0, 32.0, 1.0), Template(34.0, 22.0, 1.0), Template(24.0, 12.0, 1.0)),
        # Assumptions: 95 % of rims are 3 to 10 mm wide (mouths have 4 to 7 mm, the paper's suction
        # cup 4). They press with 0.02 to 110 kPa more than their suction requires: nearly nothing
        # under a soft mouth, 80 kPa if bending under rim and teeth is included. 95 % of suctions
        # are 1.8 to 35 kPa. 95 % of mouths have axes within a ratio of 1.22 and press evenly within
        # ±34 % along the rim. A soft rim has more lobes than are fitted.
        numbers={
            "diameter": DIAMETER,
            "width": Prior(log(5.5), 0.3),
            "suction": Prior(log(8), 0.75),
            "push": Prior(log(1.5), 2.2, step=2.0),
        },
        uneven=(0.05, 0.05, 0.17, 0.17),
        edge_mm=1.1,
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

    positive: ClassVar[tuple[str, ...]] = ("length_mm", "width_mm", "mass_g")
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
