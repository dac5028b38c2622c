"""What a piezoresistive film does beside its response curve: hysteresis, creep, bending, in numbers.

Operators and their sources are in `lampest.loads.film`.
"""

from dataclasses import dataclass
from math import hypot
from typing import Literal, NamedTuple

import numpy as np

from lampest.files.typed import Configuration, check_ranges

MOST_HYSTERESIS, MOST_CREEP = 0.6, 0.5
# Where a scene leaves it open: 10 to 25 % of full scale are published for velostat; data sheets of kindred films
# (Interlink FSR 400, Tekscan FlexiForce) promise less than 5 % for each decade, of a film alone. Mean and deviation.
OPEN_HYSTERESIS, OPEN_CREEP = (0.17, 0.1), (0.04, 0.04)

# Bent single cells: curvature in 1/m, unloaded resistance in ohm, and ΔR/R0 at 40 kPa (paper, figure 2-a and -d).
CURVATURES = np.array([0.0, 20.0, 30.3, 58.8])
BENT_OHM = np.array([3050.0, 1030.0, 560.0, 350.0])
BENT_CHANGE = np.array([-0.94, -0.82, -0.69, -0.81])


class Strength(NamedTuple):
    """What is known of a number of the film: its mean and its standard deviation for a cell."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Film(Configuration):
    """What a film does beside its response curve. Numbers are those of all cells together.

    hysteresis : the largest gap between loading and unloading of a full cycle, as the response curve reads both in
        kPa, over the cycle's largest pressure. 'auto': not known, 0.17 ± 0.1.
    creep_per_decade : by which fraction of itself ln(r/r0) grows for each decade of time under a load that stays, and
        by which it fades afterwards. 'auto': not known; estimated from the recording where a load was taken off, and
        0.04 ± 0.04 where none was.
    deviation : relative standard deviation of the two, for all cells alike: how well they are known.
    cell_spread : relative standard deviation of the two from cell to cell.
    curvature_per_m : of the bent panel, the same in all frames; 0: flat.

    >>> lampest.Film(hysteresis=0.1).hysteresis
    0.1
    """

    hysteresis: float | Literal["auto"] = 0.0
    creep_per_decade: float | Literal["auto"] = 0.0
    deviation: float = 0.0
    cell_spread: float = 0.0
    curvature_per_m: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (("hysteresis", MOST_HYSTERESIS), ("creep_per_decade", MOST_CREEP)):
            if getattr(self, name) != "auto":
                check_ranges(self, 0, most, name)
        check_ranges(self, 0, 1, "deviation", "cell_spread")
        check_ranges(self, 0, CURVATURES[-1], "curvature_per_m")

    @property
    def remembers(self) -> bool:
        """Whether what a cell shows depends on the past."""
        return bool(self.hysteresis or self.creep_per_decade)

    @property
    def hysteresis_strength(self) -> Strength:
        """As specified, or what is usual where it is open."""
        return self._strength(self.hysteresis, OPEN_HYSTERESIS)

    @property
    def creep_strength(self) -> Strength:
        """The same, a fraction for each decade."""
        return self._strength(self.creep_per_decade, OPEN_CREEP)

    def _strength(self, value: float | Literal["auto"], usual: tuple[float, float]) -> Strength:
        mean, sd = usual if value == "auto" else (value, value * self.deviation)
        return Strength(mean, hypot(sd, mean * self.cell_spread))

    @property
    def lowering(self) -> float:
        """r0 of a bent cell over that of a flat one: between the published curvatures ln r0 is straight."""
        return float(np.exp(np.interp(self.curvature_per_m, CURVATURES, np.log(BENT_OHM / BENT_OHM[0]))))

    @property
    def answer(self) -> float:
        """ln(r/r0) of a bent cell over that of a flat one at the same pressure; taken to be alike at all pressures."""
        answers = np.log1p(BENT_CHANGE)
        return float(np.interp(self.curvature_per_m, CURVATURES, answers / answers[0]))

    @property
    def answer_sd(self) -> float:
        """Its relative standard deviation: the three published cells lie so far from a line over the curvature."""
        return 0.15 if self.curvature_per_m else 0.0
