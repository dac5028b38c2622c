"""Response curves with another suction than the published one, in which loads are recognised."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lampest.panel.panel import Array
from lampest.panel.response import CURVE_KPA, CURVE_RATIO, PublishedResponse


@dataclass(frozen=True, kw_only=True)
class BentSuction(PublishedResponse):
    """Published curve with a power law for suction through the one published point.

    ln f = 2.02·(p/−10)^exponent. A straight line of r through that point corresponds to exponents
    of ½ at −5 kPa and ⅓ at −30 kPa, a threshold of 2 kPa to one of about 2.
    """

    exponent: float

    def logarithm(self, pressure: ArrayLike) -> Array:
        """Return ln f(p) for pressures in kPa, any shape."""
        pressure = np.asarray(pressure, dtype=float)
        # ln f = ln 7.54·(p/−10)^exponent for suction
        share = np.minimum(pressure, 0.0) / CURVE_KPA[0]
        rise = np.log(CURVE_RATIO[0]) * share**self.exponent
        return np.asarray(super().logarithm(np.maximum(pressure, 0.0)) + rise)
