"""The published response of a cell to pressure, and f(p) = r/r0 of any response."""

import numpy as np
from numpy.typing import ArrayLike

from lampest.panel.panel import Array
from lampest.panel.response import PublishedResponse, Response

VACUUM_KPA = -101.325  # of an empty space against the standard atmosphere
# An assumption: standard deviation of ln(r/r0) of a cell at a pressure, as a fraction of ln f(p). The curve is the mean
# over two cells, without published scatter (section II.A). A data sheet of a kindred film (Interlink FSR 400) gives 6 %
# from part to part, a hysteresis of 10 % and a drift of 5 % for each decade of time.
RESPONSE_SD = 0.1
PUBLISHED = PublishedResponse()


def ratio_from_pressure(pressure: ArrayLike, response: Response = PUBLISHED) -> Array:
    """r/r0 = f(p) of a cell of gain 1, any shape, kPa → 1; strictly falling."""
    return np.exp(response.logarithm(pressure))


def relative_change_from_pressure(pressure: ArrayLike) -> Array:
    """ΔR/R0 = f(p) − 1 of the published curve, any shape, kPa → 1."""
    return ratio_from_pressure(pressure) - 1.0
