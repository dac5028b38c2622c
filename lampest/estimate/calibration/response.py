"""A common curve and each cell's gain from known loads: nonlinear least squares with a hierarchical prior.

    ln(r/r0)_li = −κ_i Σ_k e^{ψ_k} a_lik + noise,    ln κ_i ~ N(0, spread²),    ψ_{k+1} − ψ_k ~ N(0, WALK²)

Of cell i under load l; a is how much of the base curve's fall lies in the k-th piece of pressures. e^ψ is how much
steeper than the base the film is there: the curve falls strictly, whatever ψ. Noise: that of the estimate, the place of
the load, and scatter·|ln(r/r0)| from load to load. Spread and scatter are those of the largest evidence; of a cell that
no load has touched the curve and the spread remain.
Regularised calibration by one load that is moved about: arXiv 2404.15131.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, Response, Table, TableResponse

# Ends of pieces, kPa: thirds of octaves. Within one the base curve's form is taken as it is.
ENDS = np.unique(np.outer((-1, 0, 1), 0.5 * 2.0 ** (np.arange(19) / 3)))
# An assumption, of the logarithm: how much steeper than the base a film is from a piece to the next; as a whole σ is 1.
# The published curve has a corner at 2.5 kPa at which it becomes twelve times as flat, and other films have none.
STEP_SD = 0.6
MIN_SD = 1e-3  # of ln(r/r0): no answer counts as better known
START, RANGE = (0.2, 0.05), (1e-3, 2.0)  # spread and scatter, relative: where their search begins, and where they lie
ROUNDS = 4  # of least squares and evidence, one after the other
PER_OCTAVE, MIN_KPA = 3, 0.25  # points of the table, and the one next to 0 kPa
UNLOADED_OHM = 1000.0  # of the table: only ratios to it count


@dataclass(frozen=True, eq=False)
class Loaded:
    """Answers of all cells to all loads.

    Attributes
    ----------
    change, sd : arrays, shape (loads, cells)
        ln(r/r0) and its standard deviation; NaN where nothing is known.
    pressure, pressure_sd : arrays, shape (loads, cells)
        kPa of the load.
    water : array, shape (cells)
        kPa.
    base : Response
        Curve of which the estimate is a multiple, piece by piece.
    """

    change: Array
    sd: Array
    pressure: Array
    pressure_sd: Array
    water: Array
    base: Response = PUBLISHED

    def falls(self, aside: float = 0.0) -> Array:
        """Return a, (loads, cells, pieces), of pressures that are off by so many standard deviations."""
        on_film = self.pressure + self.water + aside * self.pressure_sd
        return _falls(on_film, self.base) - _falls(self.water, self.base)


def _falls(pressure: Array, base: Response) -> Array:
    """−ln f_base(p) by pieces, (..., pieces); signed as the pressure."""
    fallen = -base.logarithm(pressure)[..., None]
    ends = np.concatenate([[-np.inf], -base.logarithm(ENDS), [np.inf]])
    return np.asarray(np.clip(fallen, ends[:-1], ends[1:]) - np.clip(0.0, ends[:-1], ends[1:]))


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """ln κ (cells), ψ (pieces), the covariance of both, spread and scatter; touched : (cells) that felt a load."""

    gains: Array
    pieces: Array
    covariance: Array
    spread: float
    scatter: float
    touched: NDArray[np.bool_]

    @property
    def _mean(self) -> Array:
        """(cells + pieces): the mean of ln κ over touched cells, which belongs to the curve."""
        return np.concatenate([self.touched / max(self.touched.sum(), 1), np.zeros(len(self.pieces))])

    @property
    def state(self) -> Array:
        """ln κ and ψ, (cells + pieces)."""
        return np.concatenate([self.gains, self.pieces])

    def at(self, state: Array) -> "FittedResponse":
        """Return the fit with other ln κ and ψ."""
        return replace(self, gains=state[: len(self.gains)], pieces=state[len(self.gains) :])

    def answers(self, falls: Array) -> Array:
        """Return ln(r/r0) of loads, (..., cells), of their a."""
        return np.asarray(-(falls * np.exp(self.gains[:, None] + self.pieces)).sum(axis=-1))

    def gain(self) -> tuple[Array, Array]:
        """κ and its relative standard deviation, from load to load included; (cells)."""
        cells = len(self.gains)
        centred = np.eye(cells, cells + len(self.pieces)) - self._mean
        own = np.einsum("ij,jk,ik->i", centred, self.covariance, centred)
        return np.exp(centred @ self.state), np.sqrt(own + self.scatter**2)

    def curve(self, pressure: Array, base: Response = PUBLISHED) -> tuple[Array, Array]:
        """ln f and its relative standard deviation at pressures (n) kPa but 0."""
        parts = _falls(pressure, base) * np.exp(self.pieces)
        total = parts.sum(axis=1)
        slopes = np.hstack([np.zeros((len(pressure), len(self.gains))), parts / total[:, None]]) + self._mean
        sd = np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes))
        return -total * np.exp(float(self._mean[: len(self.gains)] @ self.gains)), sd


def fit_loads(loaded: Loaded) -> FittedResponse:
    """Return the least squares at the spread and scatter of the largest evidence."""
    answers = _Answers.of(loaded)
    touched = np.bincount(answers.cell, minlength=loaded.change.shape[1]) > 0
    fitted = FittedResponse(np.zeros(len(touched)), np.zeros(len(ENDS) + 1), np.zeros((0, 0)), *START, touched)
    for _ in range(ROUNDS):
        fitted = answers.with_evidence(answers.with_least_squares(fitted))
    return answers.with_least_squares(fitted)


def deviations_from_others(loaded: Loaded, fitted: FittedResponse) -> Array:
    """Return (loads) ln of each load's answer over the expectation of a fit to all others; NaN without such.

    The median over its cells. Cells at the edge of the foot answer as the foot's place lets them, and do not count. The
    fit to all others is one Newton step from that to all, δ = C Jᵀ (I − J C Jᵀ)⁻¹ f, with J and f of the load alone.
    """
    deviations, falls, answers = np.full(len(loaded.change), np.nan), loaded.falls(), _Answers.of(loaded)
    residual, slopes = answers.rows(fitted, answers.weight(fitted))
    for number, change in enumerate(loaded.change):
        own = answers.load == number
        gain = fitted.covariance @ slopes[own].T
        step = gain @ np.linalg.solve(np.eye(own.sum()) - slopes[own] @ gain, residual[own])
        expected = fitted.at(fitted.state + step).answers(falls[number])
        elsewhere = np.bincount(answers.cell[~own], minlength=len(change)) > 0
        cells = elsewhere & (loaded.pressure[number] != 0) & (change * expected > 0)
        if cells.any():
            place = loaded.pressure_sd[number] / np.where(cells, np.abs(loaded.pressure[number]), 1.0)
            cells &= place <= np.median(place[cells])
            deviations[number] = float(np.median(np.log(change[cells] / expected[cells])))
    return deviations


@dataclass(frozen=True, eq=False)
class _Answers:
    """Answers of cells that felt a load.

    Attributes
    ----------
    change, sd : array, shape (n)
        ln(r/r0) and its standard deviation.
    load, cell : array of int, shape (n)
    falls, open_falls : array, shape (n, pieces)
        a of the load, and its standard deviation by the place.
    """

    change: Array
    sd: Array
    load: NDArray[np.intp]
    cell: NDArray[np.intp]
    falls: Array
    open_falls: Array

    @classmethod
    def of(cls, loaded: Loaded) -> "_Answers":
        felt = np.isfinite(loaded.change) & np.isfinite(loaded.sd) & ((loaded.pressure != 0) | (loaded.pressure_sd > 0))
        load, cell = np.nonzero(felt)
        place = (loaded.falls(1.0) - loaded.falls(-1.0))[felt] / 2
        return cls(loaded.change[felt], np.maximum(loaded.sd[felt], MIN_SD), load, cell, loaded.falls()[felt], place)

    def _parts(self, fitted: FittedResponse, falls: Array) -> Array:
        """Summands of x by pieces, (n, pieces): also the slopes of x by ψ."""
        return np.asarray(-falls * np.exp(fitted.gains[self.cell, None] + fitted.pieces))

    def _expected(self, fitted: FittedResponse) -> tuple[Array, Array]:
        """(n) x, of whose square the scatter is a multiple, and the variance of the estimate and the load's place."""
        place = self._parts(fitted, self.open_falls).sum(axis=1)
        return self._parts(fitted, self.falls).sum(axis=1), self.sd**2 + place**2

    def weight(self, fitted: FittedResponse) -> Array:
        """Return 1/σ of every answer at a fit, from load to load included, (n)."""
        answer, known = self._expected(fitted)
        return np.asarray(1 / np.sqrt(known + fitted.scatter**2 * answer**2))

    def rows(self, fitted: FittedResponse, weight: Array) -> tuple[Array, Array]:
        """Return the residuals of a fit in units of 1/weight, (n), and their slopes (n, cells + pieces)."""
        parts = weight[:, None] * self._parts(fitted, self.falls)
        answer = parts.sum(axis=1)
        own = np.where(self.cell[:, None] == np.arange(len(fitted.gains)), answer[:, None], 0.0)
        return answer - weight * self.change, np.hstack([own, parts])

    def with_least_squares(self, fitted: FittedResponse) -> FittedResponse:
        """Return the least squares at the spread, scatter and weights of the previous fit."""
        cells, pieces, weight = len(fitted.gains), len(fitted.pieces), self.weight(fitted)
        level = (np.arange(pieces) == np.searchsorted(ENDS, 0.0) + 1)[None]
        prior = np.zeros((cells + pieces, cells + pieces))
        prior[:cells, :cells] = np.eye(cells) / fitted.spread
        prior[cells:, cells:] = np.vstack([np.diff(np.eye(pieces), axis=0) / STEP_SD, level])

        def model(state: Array) -> SumOfSquares:
            residual, slopes = self.rows(fitted.at(state), weight)
            return SumOfSquares(np.concatenate([residual, prior @ state]), np.vstack([slopes, prior]))

        minimum = LevenbergMarquardt(evaluations=100, settled=1e-9).minimum(model, fitted.state)
        return replace(fitted.at(minimum.position), covariance=np.linalg.inv(minimum.at.normal))

    def with_evidence(self, fitted: FittedResponse) -> FittedResponse:
        """Return spread and scatter of the largest evidence, by cells: residuals are N(0, V + spread² x xᵀ)."""
        answer, known = self._expected(fitted)
        residual = self.change - answer + answer * fitted.gains[self.cell]
        cells = len(fitted.gains)

        def cost(logarithms: Array) -> float:
            spread, scatter = np.exp(np.clip(logarithms, *np.log(RANGE)))
            variance = known + scatter**2 * answer**2
            most = np.bincount(self.cell, answer**2 / variance, cells)
            shared = np.bincount(self.cell, answer * residual / variance, cells)
            volume = np.log(variance).sum() + np.log1p(spread**2 * most).sum()
            # One cell leaves the spread open; the last summand keeps it finite.
            return float((residual**2 / variance).sum() - (shared**2 / (1 / spread**2 + most)).sum() + volume + spread)

        minimum = scipy.optimize.minimize(cost, np.log([fitted.spread, fitted.scatter]), method="Nelder-Mead")
        spread, scatter = np.exp(np.clip(minimum.x, *np.log(RANGE)))
        return replace(fitted, spread=float(spread), scatter=float(scatter))


def response_of(fitted: FittedResponse, base: Response, shape: tuple[int, int], tolerance: float) -> TableResponse:
    """Return points densest about 0 kPa, and gains (rows, columns).

    tolerance : by which all loads may be off alike, σ = 1/√3 of it.
    """
    low, high = base.told_kpa
    pressure = np.concatenate([-_rising(-low)[::-1], [0.0], _rising(high)])
    logarithm, sd = np.zeros(len(pressure)), np.zeros(len(pressure))
    loaded = pressure != 0
    logarithm[loaded], sd[loaded] = fitted.curve(pressure[loaded], base)
    sd[~loaded] = np.interp(0.0, pressure[loaded], sd[loaded])
    gain, gain_sd = fitted.gain()
    return TableResponse(
        pressure_kpa=_significant(pressure),
        resistance_ohm=_significant(UNLOADED_OHM * np.exp(logarithm)),
        sd=_significant(np.hypot(sd, tolerance / np.sqrt(3)), 3),
        gain=_table(gain, shape),
        gain_sd=_table(gain_sd, shape),
    )


def _rising(most: float) -> Array:
    """Return pressures from MIN_KPA to the most, in equal steps of the logarithm; none where the most is not above."""
    if most <= MIN_KPA:
        return np.array([most] if most > 0 else [])
    return np.geomspace(MIN_KPA, most, 1 + int(np.ceil(PER_OCTAVE * np.log2(most / MIN_KPA))))


def _significant(values: Array, digits: int = 6) -> tuple[float, ...]:
    return tuple(float(f"{value:.{digits}g}") for value in values)


def _table(values: Array, shape: tuple[int, int]) -> Table:
    return tuple(_significant(row, 4) for row in values.reshape(shape))
