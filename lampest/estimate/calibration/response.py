"""Estimation of a common response curve and of each cell's gain from known loads, with a hierarchical prior.

    ln(r/r0)_li = −κ_i Σ_k e^{ψ_k} a_lik + noise,    ln κ_i ~ N(0, spread²),    ψ_{k+1} − ψ_k ~ N(0, STEP_SD²)

for cell i under load l. a_lik is the decrease of the base curve within the k-th interval of pressures, and e^ψ_k the
steepness there relative to the base, so that the curve decreases for any ψ. The noise has three parts: that of the
estimate, that of the load's position, and scatter·|ln(r/r0)| from load to load. Spread and scatter maximise the
evidence. A cell that no load has touched has the common curve and the spread.
Source of calibration by one load that is moved: arXiv 2404.15131.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, Response, Table, TableResponse

# Ends of the intervals, kPa: thirds of octaves. Within an interval the curve has the form of the base.
ENDS = np.unique(np.outer((-1, 0, 1), 0.5 * 2.0 ** (np.arange(19) / 3)))
# Assumed standard deviation of ψ from one interval to the next; that of the level of ψ is 1. The published curve has a
# corner at 2.5 kPa, beyond which its slope is twelve times smaller, and other films have none.
STEP_SD = 0.6
MIN_SD = 1e-3  # least standard deviation of ln(r/r0)
START, RANGE = (0.2, 0.05), (1e-3, 2.0)  # initial spread and scatter, relative, and their limits
ROUNDS = 4  # alternations of least squares and evidence
PER_OCTAVE, MIN_KPA = 3, 0.25  # points of the table in an octave, and the one next to 0 kPa
UNLOADED_OHM = 1000.0  # first resistance of the table; only ratios count


@dataclass(frozen=True, eq=False)
class Loaded:
    """Responses of all cells to all loads.

    Attributes
    ----------
    change, sd : array, shape (loads, cells)
        ln(r/r0) and its standard deviation; NaN where unknown.
    pressure, pressure_sd : array, shape (loads, cells)
        Pressure of the load and its standard deviation by the load's position, kPa.
    water : array, shape (cells,)
        Pressure of the water, kPa.
    base : Response
        Base curve; the estimate is a multiple of it in each interval.
    """

    change: Array
    sd: Array
    pressure: Array
    pressure_sd: Array
    water: Array
    base: Response = PUBLISHED

    def falls(self, aside: float = 0.0) -> Array:
        """Return a, (loads, cells, pieces), of pressures shifted by `aside` standard deviations."""
        on_film = self.pressure + self.water + aside * self.pressure_sd
        return _falls(on_film, self.base) - _falls(self.water, self.base)


def _falls(pressure: Array, base: Response) -> Array:
    """Return −ln f_base(p) split into intervals, (..., pieces), with the sign of the pressure (...) kPa."""
    fallen = -base.logarithm(pressure)[..., None]
    ends = np.concatenate([[-np.inf], -base.logarithm(ENDS), [np.inf]])
    return np.asarray(np.clip(fallen, ends[:-1], ends[1:]) - np.clip(0.0, ends[:-1], ends[1:]))


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """Fitted curve and gains.

    Attributes
    ----------
    gains, pieces : array, shapes (cells,) and (pieces,)
        ln κ and ψ.
    covariance : array, shape (cells + pieces, cells + pieces)
    spread, scatter : float
        Relative standard deviations of the gains, and of a cell's response from load to load.
    touched : boolean array, shape (cells,)
        Cells that felt a load.
    """

    gains: Array
    pieces: Array
    covariance: Array
    spread: float
    scatter: float
    touched: NDArray[np.bool_]

    @property
    def _mean(self) -> Array:
        """Weights (cells + pieces,) of the mean of ln κ over touched cells; the mean belongs to the curve."""
        return np.concatenate([self.touched / max(self.touched.sum(), 1), np.zeros(len(self.pieces))])

    @property
    def state(self) -> Array:
        """(ln κ, ψ), (cells + pieces,)."""
        return np.concatenate([self.gains, self.pieces])

    def at(self, state: Array) -> "FittedResponse":
        """Return the fit with another state (ln κ, ψ)."""
        return replace(self, gains=state[: len(self.gains)], pieces=state[len(self.gains) :])

    def answers(self, falls: Array) -> Array:
        """Return ln(r/r0) = −κ_i Σ_k e^{ψ_k} a_ik, (..., cells), of a (..., cells, pieces)."""
        return np.asarray(-(falls * np.exp(self.gains[:, None] + self.pieces)).sum(axis=-1))

    def gain(self) -> tuple[Array, Array]:
        """Return κ over its mean and its relative standard deviation, scatter included, (cells,) each."""
        cells = len(self.gains)
        centred = np.eye(cells, cells + len(self.pieces)) - self._mean
        # var(ln κ_i − mean ln κ) = (e_i − m)ᵀ P (e_i − m)
        own = np.einsum("ij,jk,ik->i", centred, self.covariance, centred)
        return np.exp(centred @ self.state), np.sqrt(own + self.scatter**2)

    def curve(self, pressure: Array, base: Response = PUBLISHED) -> tuple[Array, Array]:
        """Return ln f and its relative standard deviation at nonzero pressures (n,) kPa."""
        parts = _falls(pressure, base) * np.exp(self.pieces)
        total = parts.sum(axis=1)
        # ∂ln|ln f|/∂(ln κ, ψ): the share of each interval, and the mean gain
        slopes = np.hstack([np.zeros((len(pressure), len(self.gains))), parts / total[:, None]]) + self._mean
        sd = np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes))
        return -total * np.exp(float(self._mean[: len(self.gains)] @ self.gains)), sd


def fit_loads(loaded: Loaded) -> FittedResponse:
    """Return the least-squares fit with the spread and scatter that maximise the evidence, by alternation."""
    answers = _Answers.of(loaded)
    touched = np.bincount(answers.cell, minlength=loaded.change.shape[1]) > 0
    fitted = FittedResponse(np.zeros(len(touched)), np.zeros(len(ENDS) + 1), np.zeros((0, 0)), *START, touched)
    for _ in range(ROUNDS):
        fitted = answers.with_evidence(answers.with_least_squares(fitted))
    return answers.with_least_squares(fitted)


def deviations_from_others(loaded: Loaded, fitted: FittedResponse) -> Array:
    """Return ln of each load's response over its prediction from all other loads, (loads,); NaN where undetermined.

    It is the median over the load's cells, without those at the edge of the foot, whose response depends on the
    position. The fit without a load is one Newton step from the fit with all loads, δ = C Jᵀ (I − J C Jᵀ)⁻¹ f, with the
    Jacobian J and the residuals f of this load, and the covariance C of the state.
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
    """Responses of the cells that felt a load, as a list of n pairs.

    Attributes
    ----------
    change, sd : array, shape (n,)
        ln(r/r0) and its standard deviation.
    load, cell : integer array, shape (n,)
        Numbers of the load and of the cell.
    falls, open_falls : array, shape (n, pieces)
        a, and its standard deviation by the load's position.
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
        """Return the summands −κ_i e^{ψ_k} a_k of x, (n, pieces), which are also ∂x/∂ψ."""
        return np.asarray(-falls * np.exp(fitted.gains[self.cell, None] + fitted.pieces))

    def _expected(self, fitted: FittedResponse) -> tuple[Array, Array]:
        """Return x, the expected ln(r/r0), and the variance by the estimate and the load's position, (n,) each."""
        place = self._parts(fitted, self.open_falls).sum(axis=1)
        return self._parts(fitted, self.falls).sum(axis=1), self.sd**2 + place**2

    def weight(self, fitted: FittedResponse) -> Array:
        """Return 1/σ of every response, (n,), with σ² = sd² + position² + scatter² x²."""
        answer, known = self._expected(fitted)
        return np.asarray(1 / np.sqrt(known + fitted.scatter**2 * answer**2))

    def rows(self, fitted: FittedResponse, weight: Array) -> tuple[Array, Array]:
        """Return the residuals of a fit times the weight, (n,), and their Jacobian, (n, cells + pieces)."""
        parts = weight[:, None] * self._parts(fitted, self.falls)
        answer = parts.sum(axis=1)
        own = np.where(self.cell[:, None] == np.arange(len(fitted.gains)), answer[:, None], 0.0)
        return answer - weight * self.change, np.hstack([own, parts])

    def with_least_squares(self, fitted: FittedResponse) -> FittedResponse:
        """Return the least-squares fit with the spread, scatter and weights of the previous fit."""
        cells, pieces, weight = len(fitted.gains), len(fitted.pieces), self.weight(fitted)
        # rows of the prior: ln κ/spread, (ψ_{k+1} − ψ_k)/STEP_SD, and ψ of the interval next to 0 kPa with σ = 1
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
        """Return the fit with the spread and scatter that maximise the evidence, by the Nelder-Mead method.

        The residuals of each cell, without its own gain, are N(0, V + spread² x xᵀ) with a diagonal V.
        """
        answer, known = self._expected(fitted)
        residual = self.change - answer + answer * fitted.gains[self.cell]
        cells = len(fitted.gains)

        def cost(logarithms: Array) -> float:
            spread, scatter = np.exp(np.clip(logarithms, *np.log(RANGE)))
            variance = known + scatter**2 * answer**2
            # −2 ln N of each cell by Woodbury: Σ e²/V − (Σ x e/V)²/(spread⁻² + Σ x²/V) + Σ ln V + ln(1 + spread² Σ
            # x²/V)
            most = np.bincount(self.cell, answer**2 / variance, cells)
            shared = np.bincount(self.cell, answer * residual / variance, cells)
            volume = np.log(variance).sum() + np.log1p(spread**2 * most).sum()
            # A single cell does not determine the spread; the last summand keeps it finite.
            return float((residual**2 / variance).sum() - (shared**2 / (1 / spread**2 + most)).sum() + volume + spread)

        minimum = scipy.optimize.minimize(cost, np.log([fitted.spread, fitted.scatter]), method="Nelder-Mead")
        spread, scatter = np.exp(np.clip(minimum.x, *np.log(RANGE)))
        return replace(fitted, spread=float(spread), scatter=float(scatter))


def response_of(fitted: FittedResponse, base: Response, shape: tuple[int, int], tolerance: float) -> TableResponse:
    """Return the fit as a table with points that are densest about 0 kPa, and gains (rows, columns).

    Parameters
    ----------
    fitted : FittedResponse
    base : Response
    shape : (int, int)
        Rows and columns.
    tolerance : float
        Largest relative error that all loads share, uniformly distributed: its standard deviation is tolerance/√3.
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
    """Return pressures from MIN_KPA to `most` in equal ratios; `most` alone below MIN_KPA, nothing up to 0."""
    if most <= MIN_KPA:
        return np.array([most] if most > 0 else [])
    return np.geomspace(MIN_KPA, most, 1 + int(np.ceil(PER_OCTAVE * np.log2(most / MIN_KPA))))


def _significant(values: Array, digits: int = 6) -> tuple[float, ...]:
    return tuple(float(f"{value:.{digits}g}") for value in values)


def _table(values: Array, shape: tuple[int, int]) -> Table:
    return tuple(_significant(row, 4) for row in values.reshape(shape))
