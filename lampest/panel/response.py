"""Parameters of a piezoresistive film: response to pressure, hysteresis, creep and bending.

The response is ln(r/r0) = κ·ln f(p) with a strictly decreasing curve f of the film, f(0) = 1, and a
gain κ of each cell. The operators of hysteresis and creep, with their sources, are in
`lampest.apps.film.memory`.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from lampest.files.typed import ByKind, Configuration, check_ranges
from lampest.panel.panel import Array

Table = tuple[tuple[float, ...], ...]
# Straight lines per interval of a table: within 1/1000 of the interval's fall from the cubic, and
# exactly invertible.
TABLE_PARTS = 16
# Figure 1-e, kPa and r/r0: straight lines from 0 to 28 kPa, exponentials elsewhere.
CURVE = np.array(
    [[-10.0, 7.54], [0.0, 1.0], [2.5, 0.52], [28.0, 0.112], [40.0, 0.06], [235.0, 0.02]]
)
CURVE_KPA, CURVE_RATIO = CURVE.T


@dataclass(frozen=True, kw_only=True)
class Response(Configuration):
    """Base of response curves, with the gains of single cells.

    Attributes
    ----------
    gain : table (rows, columns), or None
        κ of each cell; None: 1.
    gain_sd : table (rows, columns), or None
        Relative standard deviation of κ; None: that of `systematic.response_sd`, or the usual one.

    Raises ValueError if a gain is not positive, a deviation is negative, or rows have different
    lengths.
    """

    gain: Table | None = None
    gain_sd: Table | None = None

    def __post_init__(self) -> None:
        for name, table in self._tables().items():
            if not table or len({len(row) for row in table}) > 1:
                raise ValueError(f"{name} needs one number for each column in each row")
            numbers = np.array(table)
            positive = name == "gain"
            within = np.all(numbers > 0) if positive else np.all(numbers >= 0)
            if not (within and np.all(np.isfinite(numbers))):
                raise ValueError(
                    f"{name} must be {'positive' if positive else 'zero or positive'}, and finite"
                )

    def _tables(self) -> dict[str, Table]:
        """Return the tables of cells that are specified, by name."""
        tables = ("gain", self.gain), ("gain_sd", self.gain_sd)
        return {name: table for name, table in tables if table is not None}

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError unless tables of cells have the panel's shape (rows, columns)."""
        for name, table in self._tables().items():
            if (len(table), len(table[0])) != shape:
                raise ValueError(
                    f"response.{name} must have {shape[0]} rows of {shape[1]} numbers, as the panel"
                )

    def of_cells(self, cells: tuple[slice, slice]) -> Self:
        """Return the response with the gains of a part of the panel.

        The part is given by slices of rows and columns.
        """
        some = {
            name: tuple(row[cells[1]] for row in table[cells[0]])
            for name, table in self._tables().items()
        }
        return replace(self, **some)

    @property
    def gains(self) -> Array:
        """Gains κ, to be broadcast to (rows, columns)."""
        return np.array(1.0 if self.gain is None else self.gain)

    @abstractmethod
    def logarithm(self, pressure: ArrayLike) -> Array:
        """Return ln f(p) for pressures in kPa, any shape; 0 at 0 kPa."""

    @abstractmethod
    def pressure(self, logarithm: ArrayLike) -> Array:
        """Return the pressure p in kPa for ln f(p), any shape; ±∞ gives ∓∞, NaN gives NaN."""

    def curve_sd(self, pressure: ArrayLike) -> Array:
        """Return the relative standard deviation of ln f(p) that all cells share, any shape.

        The result is 0 for an exact curve.
        """
        return np.zeros(np.shape(pressure))

    @property
    @abstractmethod
    def told_kpa(self) -> tuple[float, float]:
        """Lowest and highest pressure in kPa for which the curve is specified, in this order."""


@dataclass(frozen=True, kw_only=True)
class TableResponse(Response):
    """Response by points: a monotone cubic (PCHIP) through ln r.

    Beyond the first and last point the curve is linear.

    Attributes
    ----------
    pressure_kpa : tuple of float
        Pressures in kPa, increasing, from 0 or below to above 0.
    resistance_ohm : tuple of float
        Resistances at these pressures, decreasing. Only their ratio to the one at 0 kPa matters, so
        any unit serves.
    sd : tuple of float, or None
        Relative standard deviation of ln(r/r0) at each point that all cells share; None: the curve
        is exact.

    Example: {kind: table, pressure_kpa: [0, 1, 5, 20], resistance_ohm: [30000, 9000, 2500, 800]}

    Raises ValueError if the points are not monotone, or if their numbers differ.

    >>> lampest.TableResponse(pressure_kpa=(0.0, 5.0), resistance_ohm=(3000.0, 900.0)).told_kpa
    (0.0, 5.0)
    """

    kind: Literal["table"] = "table"
    pressure_kpa: tuple[float, ...]
    resistance_ohm: tuple[float, ...]
    sd: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        pressure = np.array(self.pressure_kpa)
        ohm = np.array(self.resistance_ohm)
        if len(pressure) < 2 or len(pressure) != len(ohm):
            raise ValueError(
                "a table needs two or more points, as many of resistance_ohm as of pressure_kpa"
            )
        if not (
            np.all(np.isfinite(pressure))
            and np.all(np.diff(pressure) > 0)
            and pressure[0] <= 0 < pressure[-1]
        ):
            raise ValueError("pressure_kpa must rise from 0 or below to above 0")
        if not (np.all(np.isfinite(ohm)) and np.all(ohm > 0) and np.all(np.diff(np.log(ohm)) < 0)):
            raise ValueError("resistance_ohm must be positive, and fall where pressure_kpa rises")
        if not np.all(np.diff(self._points[1]) < 0):
            raise ValueError("points of pressure_kpa or resistance_ohm lie too close to each other")
        if self.sd is not None and not (
            len(self.sd) == len(pressure) and all(0 <= deviation < np.inf for deviation in self.sd)
        ):
            raise ValueError("sd needs one number for each point, zero or positive")

    def logarithm(self, pressure: ArrayLike) -> Array:
        at, logarithm = self._points
        return _straight_on(pressure, at, logarithm, TABLE_PARTS)

    def pressure(self, logarithm: ArrayLike) -> Array:
        at, fallen = self._points
        return _straight_on(-np.asarray(logarithm, dtype=float), -fallen, at, TABLE_PARTS)

    def curve_sd(self, pressure: ArrayLike) -> Array:
        sd = self.sd or np.zeros(len(self.pressure_kpa))
        return np.asarray(np.interp(np.asarray(pressure, dtype=float), self.pressure_kpa, sd))

    @property
    def told_kpa(self) -> tuple[float, float]:
        return self.pressure_kpa[0], self.pressure_kpa[-1]

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        """Points (kPa, ln f) of the piecewise linear curve, TABLE_PARTS for each interval."""
        # The import takes 0.1 s, and few scenes have a table.
        from scipy.interpolate import PchipInterpolator

        pressure = np.array(self.pressure_kpa)
        # ln f on TABLE_PARTS points per interval, zero at 0 kPa
        cubic = PchipInterpolator(pressure, np.log(self.resistance_ohm))
        steps = np.linspace(pressure[:-1], pressure[1:], TABLE_PARTS, endpoint=False, axis=1)
        at = np.append(steps.ravel(), pressure[-1])
        return at, cubic(at) - cubic(0.0)


@dataclass(frozen=True, kw_only=True)
class PowerResponse(Response):
    """Response with a power law of the conductance, ln f = −n ln(1 + p/p1), linear for suction.

    Attributes
    ----------
    exponent : float
        n; 1 if the conductance is linear in the force.
    scale_kpa : float
        p1 in kPa.
    sd : float
        Relative standard deviation of ln f that all cells share.
    from_kpa, to_kpa : float
        Range of pressures in kPa to which the curve was fitted.

    Example: {kind: power, exponent: 0.8, scale_kpa: 1.5}

    >>> import numpy as np
    >>> lampest.PowerResponse(exponent=1.0, scale_kpa=1.0).pressure(np.log(0.5)).round(6)
    np.float64(1.0)
    """

    kind: Literal["power"] = "power"
    exponent: float
    scale_kpa: float
    sd: float = 0.0
    from_kpa: float = 0.0
    to_kpa: float = 40.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, 0.01, 100, "exponent")
        check_ranges(self, 1e-3, 1e6, "scale_kpa")
        if not (0 <= self.sd < float("inf")):
            raise ValueError("sd must be zero or positive, and finite")
        if not -1e6 < self.from_kpa <= 0 < self.to_kpa < 1e6:
            raise ValueError("from_kpa must be zero or negative, to_kpa positive")

    def logarithm(self, pressure: ArrayLike) -> Array:
        """Return ln f(p) = −n ln(1 + p/p1), and −n p/p1 for suction."""
        share = np.asarray(pressure, dtype=float) / self.scale_kpa
        return -self.exponent * (np.log1p(np.maximum(share, 0.0)) + np.minimum(share, 0.0))

    def pressure(self, logarithm: ArrayLike) -> Array:
        """Return p = p1 (e^{−x/n} − 1) for x = ln f, and −p1 x/n for suction."""
        fallen = -np.asarray(logarithm, dtype=float) / self.exponent
        with np.errstate(over="ignore"):
            return self.scale_kpa * (np.expm1(np.maximum(fallen, 0.0)) + np.minimum(fallen, 0.0))

    def curve_sd(self, pressure: ArrayLike) -> Array:
        return np.full(np.shape(pressure), self.sd)

    @property
    def told_kpa(self) -> tuple[float, float]:
        return self.from_kpa, self.to_kpa


@dataclass(frozen=True, kw_only=True)
class PublishedResponse(Response):
    """Response curve of the paper for flat cells, with its exact inverse.

    r/r0 against p in kPa (suction is negative):

        p ≤ 0         exp(−0.202·p)                     through 7.54 at −10
        0 … 2.5       1 − 0.192·p
        2.5 … 28      0.52 − 0.016·(p − 2.5)
        28 … 40       falls exponentially from 0.112 to 0.06
        40 …          falls exponentially through 0.02 at 235

    Beyond −10 and 235 kPa nothing is published; the last pieces are continued. Bent cells respond
    less: at 40 kPa by −69 to −82 % instead of −94 % (figure 2-d). Source: paper, section II.A and
    figure 1-e.

    Example: {kind: published}

    >>> import numpy as np
    >>> np.exp(lampest.PublishedResponse().logarithm(2.5)).round(6)
    np.float64(0.52)
    """

    kind: Literal["published"] = "published"

    def logarithm(self, pressure: ArrayLike) -> Array:
        level = _straight_on(pressure, CURVE_KPA, CURVE_LEVEL)
        # Inverse of `_level`: ln(f) in the linear part 0.112 ≤ f ≤ 1, shifted by the level's excess
        # beyond it
        linear = np.clip(level, CURVE_RATIO[3], 1.0)
        return np.log(linear) + (level - linear)

    def pressure(self, logarithm: ArrayLike) -> Array:
        return _straight_on(-_level(logarithm), -CURVE_LEVEL, CURVE_KPA)

    @property
    def told_kpa(self) -> tuple[float, float]:
        """Lowest published pressure, and 40 kPa.

        Above, 1 % of the resistance is 1.8 kPa instead of 0.2 kPa.
        """
        return float(CURVE_KPA[0]), float(CURVE_KPA[-2])


def _level(logarithm: ArrayLike) -> Array:
    """Return a function of ln f in which the published curve is piecewise linear.

    Depending on the pressure the function is f, or ln f plus a constant.
    """
    logarithm = np.asarray(logarithm, dtype=float)
    linear = np.clip(logarithm, np.log(CURVE_RATIO[3]), 0.0)
    return np.asarray(np.exp(linear) + (logarithm - linear))


CURVE_LEVEL = _level(np.log(CURVE_RATIO))


AnyResponse = Annotated[TableResponse | PowerResponse | PublishedResponse, ByKind()]


def _straight_on(x: ArrayLike, at: Array, values: Array, parts: int = 1) -> Array:
    """Return linear interpolation; beyond the table with the mean slope of outer `parts` lines.

    The lines are those of the table. NaN gives NaN.
    """
    x = np.asarray(x, dtype=float)
    inside = np.interp(x, at, values)
    first = (values[parts] - values[0]) / (at[parts] - at[0])
    last = (values[-1] - values[-1 - parts]) / (at[-1] - at[-1 - parts])
    return np.asarray(
        inside + first * np.minimum(x - at[0], 0.0) + last * np.maximum(x - at[-1], 0.0)
    )


VACUUM_KPA = -101.325  # vacuum relative to the standard atmosphere
# Assumed standard deviation of a cell's ln(r/r0) at a pressure, as a fraction of ln f(p). The curve
# is the mean over two cells, without published scatter (section II.A). The data sheet of a similar
# film (Interlink FSR 400) gives 6 % from part to part, a hysteresis of 10 % and a drift of 5 % per
# decade of time.
RESPONSE_SD = 0.1
# The same where a scene says `systematic: typical`: bent, glued or old film responds differently.
TYPICAL_RESPONSE_SD = 0.25
PUBLISHED = PublishedResponse()


def ratio_from_pressure(pressure: ArrayLike, response: Response = PUBLISHED) -> Array:
    """Return r/r0 = f(p) of a cell with gain 1 for pressures in kPa, any shape.

    The ratio is strictly decreasing in the pressure.
    """
    return np.exp(response.logarithm(pressure))


# Bent single cells: curvature in 1/m, unloaded resistance in ohm, and ΔR/R0 at 40 kPa (paper,
# figure 2-a and -d).
BENT = np.array(
    [[0.0, 3050.0, -0.94], [20.0, 1030.0, -0.82], [30.3, 560.0, -0.69], [58.8, 350.0, -0.81]]
)
CURVATURES, BENT_OHM, BENT_CHANGE = BENT.T


class Strength(NamedTuple):
    """Mean and standard deviation, for a single cell, of a parameter of the film."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Film(Configuration):
    """Hysteresis, creep and bending of a film. Numbers are means over all cells.

    Attributes
    ----------
    hysteresis : float or 'auto'
        Largest difference between the pressures that the response curve gives for loading and for
        unloading in a full cycle, over the largest pressure of the cycle. 'auto': unknown, 0.17 ±
        0.1.
    creep_per_decade : float or 'auto'
        Relative growth of ln(r/r0) for each decade of time under a constant load, and relative
        decay afterwards. 'auto': unknown; estimated from recordings in which a load was removed,
        otherwise 0.04 ± 0.04.
    most : dict
        Largest allowed values of hysteresis and creep.
    usual : dict
        Hysteresis and creep for 'auto'. For velostat a hysteresis of 10 to 25 % of full scale is
        published; data sheets of similar films (Interlink FSR 400, Tekscan FlexiForce) state a
        creep below 5 % per decade, of the film alone.
    deviation : float
        Relative standard deviation of hysteresis and creep that all cells share.
    cell_spread : float
        Relative standard deviation of hysteresis and creep from cell to cell.
    curvature_per_m : float
        Curvature of the bent panel in 1/m, the same in all frames; 0 for a flat panel.

    >>> lampest.Film(hysteresis=0.1).hysteresis
    0.1
    """

    most: ClassVar[dict[str, float]] = {"hysteresis": 0.6, "creep_per_decade": 0.5}
    usual: ClassVar[dict[str, Strength]] = {
        "hysteresis": Strength(0.17, 0.1),
        "creep_per_decade": Strength(0.04, 0.04),
    }
    hysteresis: float | Literal["auto"] = 0.0
    creep_per_decade: float | Literal["auto"] = 0.0
    deviation: float = 0.0
    cell_spread: float = 0.0
    curvature_per_m: float = 0.0

    def __post_init__(self) -> None:
        for name, most in self.most.items():
            if getattr(self, name) != "auto":
                check_ranges(self, 0, most, name)
        check_ranges(self, 0, 1, "deviation", "cell_spread")
        check_ranges(self, 0, CURVATURES[-1], "curvature_per_m")

    @property
    def remembers(self) -> bool:
        """Whether a cell's resistance depends on earlier loads."""
        return bool(self.hysteresis or self.creep_per_decade)

    def strength(self, name: Literal["hysteresis", "creep_per_decade"]) -> Strength:
        """Return hysteresis or creep as specified, or the usual one for 'auto'.

        The standard deviation includes the spread from cell to cell.
        """
        value = getattr(self, name)
        mean, sd = self.usual[name] if value == "auto" else (value, value * self.deviation)
        return Strength(mean, hypot(sd, mean * self.cell_spread))

    @property
    def lowering(self) -> float:
        """Ratio of r0 of a bent cell to that of a flat one.

        ln r0 is interpolated linearly in the curvature.
        """
        return float(
            np.exp(np.interp(self.curvature_per_m, CURVATURES, np.log(BENT_OHM / BENT_OHM[0])))
        )

    @property
    def answer(self) -> float:
        """Ratio of ln(r/r0) of a bent cell to that of a flat one at equal pressure.

        The model assumes the same ratio for all pressures.
        """
        answers = np.log1p(BENT_CHANGE)
        return float(np.interp(self.curvature_per_m, CURVATURES, answers / answers[0]))

    @property
    def answer_sd(self) -> float:
        """Relative standard deviation of `answer`.

        The published cells scatter by as much about a line in the curvature.
        """
        return 0.15 if self.curvature_per_m else 0.0
