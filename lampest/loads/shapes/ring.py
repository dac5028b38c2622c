"""A weighted ring."""

from dataclasses import dataclass
from math import log
from typing import ClassVar, Literal

from lampest.loads.shapes.disc import Disc, annular_pressure, annulus_mm2, contact_of_weight
from lampest.loads.shapes.round import DIAMETER, MADE, TILT, WIDTH, RoundCandidate, disc_of
from lampest.loads.shapes.shape import Prior, Shape, Template
from lampest.panel.panel import Array

HOLE = 0.25  # d_i/d below which what presses is a rod; an assumption


def hollow(ring: RoundCandidate, parameters: Array) -> tuple[float, Array]:
    """d_i/d − HOLE, and its slopes by φ."""
    disc, slopes = ring.disc_with_slopes(parameters)
    share = disc.inner_mm / disc.diameter_mm
    return share - HOLE, (slopes[3] - share * slopes[2]) / disc.diameter_mm


@dataclass(frozen=True, kw_only=True)
class Ring(Shape):
    """p = m·g/(π (d² − d_i²)/4) under a weighted ring.

    Recognition asks for a hole of a quarter of its diameter: what has less is a rod.

    Parameters
    ----------
    inner_diameter_mm, outer_diameter_mm, mass_g : of the ring.

    Example: {kind: ring, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35, mass_g: 850}
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="ring",
        hollow=True,
        follows=True,
        templates=(Template(22.0, 11.0, faint=True), Template(42.0, 32.0), Template(32.0, 21.0)),
        # An assumption: 95 % of rings press with 4 to 220 kPa.
        numbers={"diameter": DIAMETER, "width": WIDTH, "rim": Prior(log(30), 1.0)} | TILT,
        uneven=MADE,
        bound=hollow,
    )
    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm", "mass_g")
    kind: Literal["ring"] = "ring"
    inner_diameter_mm: float
    outer_diameter_mm: float
    mass_g: float

    @property
    def reach_mm(self) -> float:
        """Its outer radius."""
        return self.outer_diameter_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The same pressure everywhere under it, and no suction."""
        return annular_pressure(self.disc(), x, y)

    def disc(self) -> Disc:
        """One that does not suck."""
        area = annulus_mm2(self.inner_diameter_mm, self.outer_diameter_mm)
        return disc_of(self, self.inner_diameter_mm, self.outer_diameter_mm, contact_of_weight(self.mass_g, area))
