"""An upright rod, standing on its flat end."""

from dataclasses import dataclass
from math import log
from typing import ClassVar, Literal

from lampest.loads.shapes.disc import Disc, annular_pressure, annulus_mm2, contact_of_weight
from lampest.loads.shapes.round import MADE, TILT, RoundCandidate, disc_of
from lampest.loads.shapes.shape import Prior, Shape, Template
from lampest.panel.panel import Array


@dataclass(frozen=True, kw_only=True)
class Rod(Shape):
    """p = m·g/(π d²/4) under the flat end of an upright rod.

    Parameters
    ----------
    diameter_mm, mass_g : of the rod.

    Example: {kind: rod, centre_mm: [45, 45], diameter_mm: 40, mass_g: 680}
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

    @property
    def reach_mm(self) -> float:
        """Its radius."""
        return self.diameter_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The same pressure everywhere under it, and no suction."""
        return annular_pressure(self.disc(), x, y)

    def disc(self) -> Disc:
        """A full one."""
        weight = contact_of_weight(self.mass_g, annulus_mm2(0, self.diameter_mm))
        return disc_of(self, 0.0, self.diameter_mm, weight)
