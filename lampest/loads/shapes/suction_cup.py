"""A suction cup, pumped or pressed on by hand."""

from dataclasses import dataclass
from math import log
from typing import ClassVar, Literal

import numpy as np

from lampest.loads.shapes.disc import Disc, annular_pressure
from lampest.loads.shapes.round import DIAMETER, MADE, SUCKING, SUCTION, TILT, WIDTH, RoundCandidate, sucking_disc
from lampest.loads.shapes.shape import Prior, Shape
from lampest.panel.panel import Array

PUSHED_KPA = 40.0  # by which a hand pushes a cup at most beyond what its suction needs; an assumption


def pushed_by_hand(cup: RoundCandidate, parameters: Array) -> tuple[float, Array]:
    """ln 40 kPa − ln push, and its slopes by φ."""
    push = cup.names.index("push")
    return float(log(PUSHED_KPA) - parameters[push]), -np.eye(len(parameters))[push]


@dataclass(frozen=True, kw_only=True)
class SuctionCup(Shape):
    """p < 0 inside d_i, against the surroundings, and p_rim = −p·d_i²/(d² − d_i²) under the rim that bears it.

    Recognition lets a hand push it by up to 40 kPa more.

    Parameters
    ----------
    inner_diameter_mm, outer_diameter_mm : of the rim.
    pressure_kpa : suction against the surroundings, negative.

    Example: {kind: suction_cup, centre_mm: [45, 45], inner_diameter_mm: 27, outer_diameter_mm: 35, pressure_kpa: -10}
    """

    candidate: ClassVar[RoundCandidate] = RoundCandidate(
        label="cup",
        sucks=True,
        hollow=True,
        follows=True,
        templates=SUCKING,
        # An assumption: most cups bear themselves, 95 % are pushed by less than 18 kPa.
        numbers={"diameter": DIAMETER, "width": WIDTH, "suction": SUCTION, "push": Prior(log(0.5), 1.8)} | TILT,
        uneven=MADE,
        bound=pushed_by_hand,
    )
    positive: ClassVar[tuple[str, ...]] = ("inner_diameter_mm", "outer_diameter_mm")
    kind: Literal["suction_cup"] = "suction_cup"
    inner_diameter_mm: float
    outer_diameter_mm: float
    pressure_kpa: float

    @property
    def reach_mm(self) -> float:
        """Its outer radius."""
        return self.outer_diameter_mm / 2

    def pressure_at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Suction inside, and the pressure of the rim."""
        return annular_pressure(self.disc(), x, y)

    def disc(self) -> Disc:
        """One whose rim bears the suction."""
        return sucking_disc(self, self.inner_diameter_mm, self.outer_diameter_mm, self.pressure_kpa)
