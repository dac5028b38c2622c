"""What presses on the panel or sucks at it: rod, ring, suction cup, oral disc."""

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite, pi
from typing import Annotated, Any, ClassVar, Literal

from lampest.files.tagged import ByKind
from lampest.loads.pressure import GRAVITY, VACUUM_KPA


@dataclass(frozen=True)
class Zone:
    """A ring of a load's footprint: inner and outer diameter in mm, contact pressure ≥ 0 and suction ≤ 0 in kPa."""

    inner_mm: float
    outer_mm: float
    contact_kpa: float = 0.0
    suction_kpa: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Load(ABC):
    """A round footprint somewhere on the panel.

    Parameters
    ----------
    centre_mm : (x, y) of the centre; column k lies at x = k·pitch, row j at y = j·pitch.
    tilt : relative change of the contact pressure from the centre to the edge, 0 to 1; its mean stays.
    tilt_direction_deg : where the contact is strongest; 0 towards higher columns, 90 towards higher rows.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    centre_mm: tuple[float, float]
    tilt: float = 0.0
    tilt_direction_deg: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            for part in value if isinstance(value, tuple) else (value,):
                if isinstance(part, float | int) and not isfinite(part):
                    raise ValueError(f"{field.name} must be finite")
                if isinstance(part, float | int) and part <= 0 and field.name.endswith(("diameter_mm", "mass_g")):
                    raise ValueError(f"{field.name} must be positive")
        if not 0 <= self.tilt <= 1:
            raise ValueError("tilt must lie between 0 and 1")
        for zone in self.zones():
            if not VACUUM_KPA < zone.suction_kpa <= 0:
                raise ValueError("pressure_kpa is a suction: it must be negative, and above -101 kPa, an empty space")
            if not 0 <= zone.contact_kpa < float("inf"):
                raise ValueError("the contact pressure must be zero or positive, and finite")

    @abstractmethod
    def zones(self) -> tuple[Zone, ...]:
        """The footprint from the inside out. Raises ValueError where diameters or pressures make no sense."""


@dataclass(frozen=True, kw_only=True)
class Rod(Load):
    """p = m·g/(π d²/4) under the flat end of an upright rod."""

    kind: Literal["rod"]
    diameter_mm: float
    mass_g: float

    def zones(self) -> tuple[Zone, ...]:
        """One full circle."""
        weight = pressure_of_weight(self.mass_g, annulus_mm2(0, self.diameter_mm))
        return (Zone(0, self.diameter_mm, contact_kpa=weight),)


@dataclass(frozen=True, kw_only=True)
class Ring(Load):
    """p = m·g/(π (d² − d_i²)/4) under a weighted ring."""

    kind: Literal["ring"]
    inner_diameter_mm: float
    outer_diameter_mm: float
    mass_g: float

    def zones(self) -> tuple[Zone, ...]:
        """One ring."""
        area = annulus_mm2(self.inner_diameter_mm, self.outer_diameter_mm)
        weight = pressure_of_weight(self.mass_g, area)
        return (Zone(self.inner_diameter_mm, self.outer_diameter_mm, contact_kpa=weight),)


@dataclass(frozen=True, kw_only=True)
class SuctionCup(Load):
    """p < 0 inside d_i, against the surroundings, and p_rim = −p·d_i²/(d² − d_i²) under the rim that bears it."""

    kind: Literal["suction_cup"]
    inner_diameter_mm: float
    outer_diameter_mm: float
    pressure_kpa: float

    def zones(self) -> tuple[Zone, ...]:
        """The inside and the rim."""
        return sucking(self.inner_diameter_mm, self.outer_diameter_mm, self.pressure_kpa, None)


@dataclass(frozen=True, kw_only=True)
class OralDisc(Load):
    """Suction p in a lamprey's mouth and a soft rim that presses.

    Parameters
    ----------
    diameter_mm, rim_width_mm : of the mouth over the rim, and of the rim.
    pressure_kpa : suction against the surroundings, negative.
    rim_kpa : contact pressure under the rim; None: what bears the suction, as under a suction cup.

    Source: suction is uniform over the mouth, -0.6 to -26 kPa at rest: Shi et al., PLoS ONE 16, e0247884, 2021.
    """

    kind: Literal["oral_disc"]
    diameter_mm: float
    rim_width_mm: float
    pressure_kpa: float
    rim_kpa: float | None = None

    def zones(self) -> tuple[Zone, ...]:
        """The inside and the rim."""
        if not 0 < 2 * self.rim_width_mm < self.diameter_mm:
            raise ValueError("rim_width_mm must be positive and below half the diameter")
        return sucking(self.diameter_mm - 2 * self.rim_width_mm, self.diameter_mm, self.pressure_kpa, self.rim_kpa)


AnyLoad = Annotated[Rod | Ring | SuctionCup | OralDisc, ByKind()]


def annulus_mm2(inner_mm: float, outer_mm: float) -> float:
    """π (d² − d_i²)/4 in mm². Raises ValueError where it is empty."""
    if not 0 <= inner_mm < outer_mm:
        raise ValueError("the inner diameter must be smaller than the outer one")
    return pi * (outer_mm * outer_mm - inner_mm * inner_mm) / 4


def pressure_of_weight(mass_g: float, area_mm2: float) -> float:
    """m·g/A in kPa (mN/mm²)."""
    if area_mm2 == 0:  # of a diameter too small for its square
        return float("inf")
    return mass_g * GRAVITY / area_mm2 if area_mm2 < float("inf") else 0.0


def sucking(inner_mm: float, outer_mm: float, pressure_kpa: float, rim_kpa: float | None) -> tuple[Zone, ...]:
    """A sucking inside and its rim, which bears the suction's force unless its pressure is given."""
    rim_area = annulus_mm2(inner_mm, outer_mm)
    if not pressure_kpa < 0:
        raise ValueError("pressure_kpa is a suction: it must be negative")
    rim = -pressure_kpa * annulus_mm2(0, inner_mm) / rim_area if rim_kpa is None else rim_kpa
    return (Zone(0, inner_mm, suction_kpa=pressure_kpa), Zone(inner_mm, outer_mm, contact_kpa=rim))
