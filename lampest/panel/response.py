"""A piezoresistive film: its response to pressure, hysteresis, creep and bending, in numbers.

The response is ln(r/r0) = κ·ln f(p): f of the film, strictly falling, 1 at 0 kPa; κ of the cell. Operators of
hysteresis and creep, and their sources, are in `lampest.loads.film`.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, isfinite
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from lampest.files.typed import ByKind, Configuration, check_ranges
from lampest.panel.panel import Array

Table = tuple[tuple[float, ...], ...]
# Lines between two points of a table: they miss the cubic by 1/1000 of the interval's fall, and invert exactly.
TABLE_PARTS = 16
# Figure 1-e, kPa and r/r0: straight lines from 0 to 28 kPa, exponentials elsewhere.
CURVE = np.array([[-10.0, 7.54], [0.0, 1.0], [2.5, 0.52], [28.0, 0.112], [40.0, 0.06], [235.0, 0.02]])
CURVE_KPA, CURVE_RATIO = CURVE.T


@dataclass(frozen=True, kw_only=True)
class Response(Configuration):
    """Settings of single cells that all kinds have.

    gain : (rows, columns) κ of each cell. gain_sd : their relative standard deviations; None: cells scatter as
        `systematic.response_sd` says, or as usual.

    Raises ValueError where a gain is not positive, a deviation negative, or rows are of different lengths.
    """

    gain: Table | None = None
    gain_sd: Table | None = None

    def __post_init__(self) -> None:
        for name, table in self._tables().items():
            if not table or len({len(row) for row in table}) > 1:
                raise ValueError(f"{name} needs one number for each column in each row")
            open_end = name == "gain"
            if not all(
                isfinite(number) and number >= 0 and (number or not open_end) for row in table for number in row
            ):
                raise ValueError(f"{name} must be {'positive' if open_end else 'zero or positive'}, and finite")

    def _tables(self) -> dict[str, Table]:
        return {name: table for name in ("gain", "gain_sd") if (table := getattr(self, name)) is not None}

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError unless tables of cells are as large as the panel."""
        for name, table in self._tables().items():
            if (len(table), len(table[0])) != shape:
                raise ValueError(f"response.{name} must have {shape[0]} rows of {shape[1]} numbers, as the panel")

    def of_cells(self, cells: tuple[slice, slice]) -> Self:
        """Return the same of some cells of the panel."""
        some = {name: tuple(row[cells[1]] for row in table[cells[0]]) for name, table in self._tables().items()}
        return replace(self, **some)

    @property
    def gains(self) -> Array:
        """κ, to be broadcast to (rows, columns)."""
        return np.array(1.0 if self.gain is None else self.gain)

    @abstractmethod
    def logarithm(self, pressure: ArrayLike) -> Array:
        """ln f(p), any shape, kPa → 1; 0 at 0."""

    @abstractmethod
    def pressure(self, logarithm: ArrayLike) -> Array:
        """p where ln f(p) is so much, any shape, 1 → kPa; ±∞ gives ∓∞, NaN stays."""

    def curve_sd(self, pressure: ArrayLike) -> Array:
        """Return the relative standard deviation of ln f(p), for all cells alike; any shape. Zero: exact."""
        return np.zeros(np.shape(pressure))

    @property
    @abstractmethod
    def told_kpa(self) -> tuple[float, float]:
        """The pressures between which it is defined."""


@dataclass(frozen=True, kw_only=True)
class TableResponse(Response):
    """ln f by points: a monotone cubic (PCHIP) through ln r at them, straight on beyond the first and the last.

    pressure_kpa : rising, from 0 or below to above 0. resistance_ohm : falling, of one cell or any other unit: only
        what it is over that at 0 kPa counts.
    sd : of each point, relative standard deviation of ln(r/r0), for all cells alike; None: the curve is exact.

    Example: {kind: table, pressure_kpa: [0, 1, 5, 20], resistance_ohm: [30000, 9000, 2500, 800]}

    Raises ValueError where points do not rise, fall or agree in number.

    >>> lampest.TableResponse(pressure_kpa=(0.0, 5.0), resistance_ohm=(3000.0, 900.0)).told_kpa
    (0.0, 5.0)
    """

    kind: Literal["table"] = "table"
    pressure_kpa: tuple[float, ...]
    resistance_ohm: tuple[float, ...]
    sd: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        pressure, ohm = np.array(self.pressure_kpa), np.array(self.resistance_ohm)
        if len(pressure) < 2 or len(pressure) != len(ohm):
            raise ValueError("a table needs two or more points, as many of resistance_ohm as of pressure_kpa")
        if not (np.all(np.isfinite(pressure)) and np.all(np.diff(pressure) > 0) and pressure[0] <= 0 < pressure[-1]):
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
        """kPa and ln f, TABLE_PARTS for each interval."""
        from scipy.interpolate import PchipInterpolator  # 0.1 s, and few scenes have a table

        pressure = np.array(self.pressure_kpa)
        cubic = PchipInterpolator(pressure, np.log(self.resistance_ohm))
        steps = np.linspace(pressure[:-1], pressure[1:], TABLE_PARTS, endpoint=False, axis=1)
        at = np.append(steps.ravel(), pressure[-1])
        return at, cubic(at) - cubic(0.0)


@dataclass(frozen=True, kw_only=True)
class PowerResponse(Response):
    """ln f = −n ln(1 + p/p1): the conductance grows with a power of the pressure. Straight on for suction.

    exponent : n; 1 where the conductance is linear in the force. scale_kpa : p1. sd : relative standard deviation of
        ln f, for all cells alike. from_kpa, to_kpa : between which pressures it was fitted.

    Example: {kind: power, exponent: 0.8, scale_kpa: 1.5}

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
        """−n ln(1 + p/p1); −n p/p1 for suction."""
        share = np.asarray(pressure, dtype=float) / self.scale_kpa
        return np.asarray(-self.exponent * (np.log1p(np.maximum(share, 0.0)) + np.minimum(share, 0.0)))

    def pressure(self, logarithm: ArrayLike) -> Array:
        """p1 (e^{−x/n} − 1) of x = ln f; −p1 x/n for suction."""
        fallen = -np.asarray(logarithm, dtype=float) / self.exponent
        with np.errstate(over="ignore"):
            return np.asarray(self.scale_kpa * (np.expm1(np.maximum(fallen, 0.0)) + np.minimum(fallen, 0.0)))

    def curve_sd(self, pressure: ArrayLike) -> Array:
        return np.full(np.shape(pressure), self.sd)

    @property
    def told_kpa(self) -> tuple[float, float]:
        return self.from_kpa, self.to_kpa


@dataclass(frozen=True, kw_only=True)
class PublishedResponse(Response):
    """The paper's curve of flat cells, inverted exactly.

    r/r0 against p in kPa (suction is negative):

        p ≤ 0         exp(−0.202·p)                     through 7.54 at −10
        0 … 2.5       1 − 0.192·p
        2.5 … 28      0.52 − 0.016·(p − 2.5)
        28 … 40       falls exponentially from 0.112 to 0.06
        40 …          falls exponentially through 0.02 at 235

    Beyond −10 and 235 kPa nothing is published; the last pieces are continued. Bent cells answer less: at 40 kPa by −69
    to −82 % instead of −94 % (figure 2-d). Source: paper, section II.A and figure 1-e.

    Example: {kind: published}

    >>> np.exp(lampest.PublishedResponse().logarithm(2.5)).round(6)
    np.float64(0.52)
    """

    kind: Literal["published"] = "published"

    def logarithm(self, pressure: ArrayLike) -> Array:
        level = _straight_on(pressure, CURVE_KPA, CURVE_LEVEL)
        linear = np.clip(level, CURVE_RATIO[3], 1.0)
        return np.asarray(np.log(linear) + (level - linear))

    def pressure(self, logarithm: ArrayLike) -> Array:
        return _straight_on(-_level(logarithm), -CURVE_LEVEL, CURVE_KPA)

    @property
    def told_kpa(self) -> tuple[float, float]:
        """Lowest published pressure, and 40 kPa, above which 1 % of the resistance is 1.8 kPa and not 0.2."""
        return float(CURVE_KPA[0]), float(CURVE_KPA[-2])


def _level(logarithm: ArrayLike) -> Array:
    """Return the level in which the published curve is straight between points: f where that is linear, else ln f."""
    logarithm = np.asarray(logarithm, dtype=float)
    linear = np.clip(logarithm, np.log(CURVE_RATIO[3]), 0.0)
    return np.asarray(np.exp(linear) + (logarithm - linear))


CURVE_LEVEL = _level(np.log(CURVE_RATIO))


@dataclass(frozen=True, kw_only=True)
class BentSuction(PublishedResponse):
    """The published curve, whose suction follows a power through its one published point: ln f = 2.02·(p/−10)^exponent.

    A straight line of r through that point has exponents of ½ at −5 kPa and ⅓ at −30 kPa, a threshold of 2 kPa about 2.
    """

    exponent: float

    def logarithm(self, pressure: ArrayLike) -> Array:
        """ln f(p), any shape, kPa → 1."""
        pressure = np.asarray(pressure, dtype=float)
        share = np.minimum(pressure, 0.0) / CURVE_KPA[0]
        rise = np.log(CURVE_RATIO[0]) * share**self.exponent
        return np.asarray(super().logarithm(np.maximum(pressure, 0.0)) + rise)


AnyResponse = Annotated[TableResponse | PowerResponse | PublishedResponse, ByKind()]


def _straight_on(x: ArrayLike, at: Array, values: Array, parts: int = 1) -> Array:
    """Interpolate linearly; beyond the table by the mean slope of its last `parts` lines. NaN stays."""
    x = np.asarray(x, dtype=float)
    inside = np.interp(x, at, values)
    first = (values[parts] - values[0]) / (at[parts] - at[0])
    last = (values[-1] - values[-1 - parts]) / (at[-1] - at[-1 - parts])
    return np.asarray(inside + first * np.minimum(x - at[0], 0.0) + last * np.maximum(x - at[-1], 0.0))


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


# Bent single cells: curvature in 1/m, unloaded resistance in ohm, and ΔR/R0 at 40 kPa (paper, figure 2-a and -d).
BENT = np.array([[0.0, 3050.0, -0.94], [20.0, 1030.0, -0.82], [30.3, 560.0, -0.69], [58.8, 350.0, -0.81]])
CURVATURES, BENT_OHM, BENT_CHANGE = BENT.T


class Strength(NamedTuple):
    """Knowledge of a number of the film: its mean and its standard deviation for a cell."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Film(Configuration):
    """Behaviour of a film beside its response curve. Numbers are those of all cells together.

    hysteresis : the largest gap between loading and unloading of a full cycle, as the response curve reads both in
        kPa, over the cycle's largest pressure. 'auto': not known, 0.17 ± 0.1.
    creep_per_decade : by which fraction of itself ln(r/r0) grows for each decade of time under a load that stays, and
        by which it fades afterwards. 'auto': not known; estimated from the recording where a load was taken off, and
        0.04 ± 0.04 where none was.
    most : largest value of the two.
    usual : of the two where a scene leaves them open. 10 to 25 % of full scale are published for velostat; data sheets
        of kindred films (Interlink FSR 400, Tekscan FlexiForce) promise less than 5 % for each decade, of a film alone.
    deviation : relative standard deviation of the two, for all cells alike: how well they are known.
    cell_spread : relative standard deviation of the two from cell to cell.
    curvature_per_m : of the bent panel, the same in all frames; 0: flat.

    >>> lampest.Film(hysteresis=0.1).hysteresis
    0.1
    """

    most: ClassVar[dict[str, float]] = {"hysteresis": 0.6, "creep_per_decade": 0.5}
    usual: ClassVar[dict[str, Strength]] = {"hysteresis": Strength(0.17, 0.1), "creep_per_decade": Strength(0.04, 0.04)}
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
        """Whether what a cell shows depends on the past."""
        return bool(self.hysteresis or self.creep_per_decade)

    @property
    def hysteresis_strength(self) -> Strength:
        """Hysteresis as specified, or what is usual where it is open."""
        return self._strength("hysteresis")

    @property
    def creep_strength(self) -> Strength:
        """The same, a fraction for each decade."""
        return self._strength("creep_per_decade")

    def _strength(self, name: str) -> Strength:
        value = getattr(self, name)
        mean, sd = self.usual[name] if value == "auto" else (value, value * self.deviation)
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
        """Relative standard deviation: the three published cells lie so far from a line over the curvature."""
        return 0.15 if self.curvature_per_m else 0.0
