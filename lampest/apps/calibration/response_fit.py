"""Fit of a film's response: a common curve and each cell's gain, with a hierarchical prior.

    ln(r/r0)_li = −κ_i Σ_k e^{ψ_k} a_lik + noise,
    ln κ_i ~ N(0, spread²),    ψ_{k+1} − ψ_k ~ N(0, STEP_SD²)

for cell i under load l. a_lik is the decrease of the base curve within the k-th interval of
pressures, and e^ψ_k the steepness there relative to the base, so that the curve decreases for any
ψ. The noise has three parts: that of the estimate, that of the load's position, and
scatter·|ln(r/r0)| from load to load. Spread and scatter maximise the evidence. A cell that no load
has touched has the common curve and the spread.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.response import PUBLISHED, Response, TableResponse

# Ends of the intervals, kPa: thirds of octaves. Within an interval the curve has the form of the
# base.
ENDS = np.unique(np.outer((-1, 0, 1), 0.5 * 2.0 ** (np.arange(19) / 3)))
# Assumed standard deviation of ψ from one interval to the next; that of the level of ψ is 1. The
# published curve has a corner at 2.5 kPa, beyond which its slope is twelve times smaller, and other
# films have none.
STEP_SD = 0.6
# initial spread and scatter, relative, and their limits
START = (0.2, 0.05)
RANGE = (1e-3, 2.0)
STATIONARY = 1e-9  # of the gradient of −2 ln evidence by ln spread and ln scatter
LONGEST_STEP = 3.0  # of ln κ and ψ in a step of least squares: units of g for kg are ln 1000 = 7
ROUNDS = 4  # alternations of least squares and evidence
# points of the table in an octave, and the one next to 0 kPa
PER_OCTAVE = 3
MIN_KPA = 0.25
UNLOADED_OHM = 1000.0  # first resistance of the table; only ratios count


@dataclass(frozen=True, eq=False)
class Loaded:
    """Responses of all cells to all loads; n of them are known and felt a load.

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

    @cached_property
    def felt(self) -> tuple[Numbers, ...]:
        """Indices of the load and of the cell of each response, (n,) each.

        A response counts if a load may touch the cell, and its change is known.
        """
        touched = (self.pressure != 0) | (self.pressure_sd > 0)
        return np.nonzero(touched & np.isfinite(self.change) & np.isfinite(self.sd))

    @cached_property
    def falls(self) -> tuple[Array, Array]:
        """Falls a of ln r by the first guess, split into intervals.

        Returns
        -------
        falls, falls_sd : arrays, shape (loads, cells, pieces)
            The value, and its standard deviation by the load's position.
        """
        on_film = (
            self.pressure
            + self.water
            + np.array([0.0, 1.0, -1.0])[:, None, None] * self.pressure_sd
        )
        middle, upper, lower = _falls(on_film, self.base) - _falls(self.water, self.base)
        return middle, (upper - lower) / 2

    def expected(self, fitted: "FittedResponse") -> tuple[Array, Array]:
        """Return the expected responses of a fit.

        Returns
        -------
        response : array, shape (n,)
            x, the expected ln(r/r0).
        variance : array, shape (n,)
            Variance by the estimate of the change and by the load's position.
        """
        response, position = (fitted.parts(part).sum(axis=-1)[self.felt] for part in self.falls)
        return response, self.sd[self.felt] ** 2 + position**2

    def weight(self, fitted: "FittedResponse") -> Array:
        """Return 1/σ of every response, (n,), with σ² = sd² + position² + scatter² x²."""
        response, variance = self.expected(fitted)
        return 1 / np.sqrt(variance + fitted.scatter**2 * response**2)

    def rows(self, fitted: "FittedResponse", weight: Array) -> tuple[Array, Array]:
        """Return the weighted least-squares problem of a fit.

        Returns
        -------
        residuals : array, shape (n,)
            Times the weight.
        jacobian : array, shape (n, cells + pieces)
            Times the weight.
        """
        parts = weight[:, None] * fitted.parts(self.falls[0])[self.felt]
        response = parts.sum(axis=1)
        by_gain = np.where(
            self.felt[1][:, None] == np.arange(len(fitted.gains)), response[:, None], 0.0
        )
        return response - weight * self.change[self.felt], np.hstack([by_gain, parts])


def _falls(pressure: Array, base: Response) -> Array:
    """Return −ln f_base(p) split into intervals, (..., pieces).

    Every piece has the sign of its pressure p (...) kPa.
    """
    fallen = -base.logarithm(pressure)[..., None]
    ends = np.concatenate([[-np.inf], -base.logarithm(ENDS), [np.inf]])
    return np.asarray(np.clip(fallen, ends[:-1], ends[1:]) - np.clip(0.0, ends[:-1], ends[1:]))


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """Fitted curve and gains.

    Attributes
    ----------
    state : array, shape (cells + pieces,)
        ln κ and ψ.
    covariance : array, shape (cells + pieces, cells + pieces)
    spread, scatter : float
        Relative standard deviations of the gains, and of a cell's response from load to load.
    touched : boolean array, shape (cells,)
        Cells that felt a load.
    """

    state: Array
    covariance: Array
    spread: float
    scatter: float
    touched: Mask

    @property
    def gains(self) -> Array:
        """ln κ, (cells,)."""
        return self.state[: len(self.touched)]

    @property
    def pieces(self) -> Array:
        """ψ, (pieces,)."""
        return self.state[len(self.touched) :]

    @property
    def _mean(self) -> Array:
        """Weights (cells + pieces,) of the mean of ln κ over touched cells.

        The mean belongs to the curve.
        """
        return np.concatenate([self.touched / self.touched.sum(), np.zeros(len(self.pieces))])

    def parts(self, falls: Array) -> Array:
        """Return the summands −κ_i e^{ψ_k} a_ik of ln(r/r0), (..., cells, pieces).

        Each summand is also its own derivative with respect to ψ_k.
        """
        return -falls * np.exp(self.gains[:, None] + self.pieces)

    def gain(self) -> tuple[Array, Array]:
        """Gains of the cells over their mean.

        Returns
        -------
        gain : array, shape (cells,)
            κ over its mean.
        relative_sd : array, shape (cells,)
            Relative standard deviation, with the scatter.
        """
        centred = np.eye(len(self.gains), len(self.state)) - self._mean
        # var(ln κ_i − mean ln κ) = (e_i − m)ᵀ P (e_i − m)
        variance = np.einsum("ij,jk,ik->i", centred, self.covariance, centred)
        return np.exp(centred @ self.state), np.sqrt(variance + self.scatter**2)

    def curve(self, pressure: Array, base: Response = PUBLISHED) -> tuple[Array, Array]:
        """Return the fitted curve at nonzero pressures (n,) kPa.

        Returns
        -------
        logarithm : array, shape (n,)
            ln f.
        relative_sd : array, shape (n,)
            Relative standard deviation of ln f.
        """
        parts = _falls(pressure, base) * np.exp(self.pieces)
        total = parts.sum(axis=1)
        # ∂ln|ln f|/∂(ln κ, ψ): the share of each interval, and the mean gain
        slopes = (
            np.hstack([np.zeros((len(pressure), len(self.gains))), parts / total[:, None]])
            + self._mean
        )
        sd = np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes))
        return -total * np.exp(float(self._mean @ self.state)), sd


def fit_loads(loaded: Loaded) -> FittedResponse:
    """Return the least-squares fit with the spread and scatter that maximise the evidence.

    The fit alternates between the state and these two.
    """
    cells = loaded.change.shape[1]
    touched = np.isin(np.arange(cells), loaded.felt[1])
    fitted = FittedResponse(np.zeros(cells + len(ENDS) + 1), np.zeros((0, 0)), *START, touched)
    for _ in range(ROUNDS):
        fitted = with_evidence(loaded, with_least_squares(loaded, fitted))
    return with_least_squares(loaded, fitted)


def with_least_squares(loaded: Loaded, fitted: FittedResponse) -> FittedResponse:
    """Return the least-squares fit with the spread, scatter and weights of the previous fit."""
    cells = len(fitted.gains)
    pieces = len(fitted.pieces)
    weight = loaded.weight(fitted)
    # rows of the prior: ln κ/spread, (ψ_{k+1} − ψ_k)/STEP_SD, and ψ of the interval next to 0 kPa
    # with σ = 1
    level = (np.arange(pieces) == np.searchsorted(ENDS, 0.0) + 1)[None]
    walk = np.vstack([np.diff(np.eye(pieces), axis=0) / STEP_SD, level])
    prior = scipy.linalg.block_diag(np.eye(cells) / fitted.spread, walk)

    def model(state: Array) -> SumOfSquares:
        residual, slopes = loaded.rows(replace(fitted, state=state), weight)
        return SumOfSquares(np.concatenate([residual, prior @ state]), np.vstack([slopes, prior]))

    state, squares = LevenbergMarquardt(
        evaluations=100, settled=1e-9, longest=LONGEST_STEP
    ).minimum(model, fitted.state)
    return replace(fitted, state=state, covariance=np.linalg.inv(squares.normal))


def with_evidence(loaded: Loaded, fitted: FittedResponse) -> FittedResponse:
    """Return the fit with the spread and scatter that maximise the evidence.

    The residuals e of each cell, without its own gain, are N(0, V + spread² x xᵀ) with a diagonal V
    and the responses x. The cell's gain beside its mean is N(m, w) given them. The search ends
    where the gradient is zero within rounding; values of the cost tell no two places apart there.
    """
    response, constant_variance = loaded.expected(fitted)
    cell = loaded.felt[1]
    residual = loaded.change[loaded.felt] - response + response * fitted.gains[cell]

    def cost_and_gradient(logarithms: Array) -> tuple[float, Array]:
        spread, scatter = np.exp(logarithms)
        uneven = scatter**2 * response**2
        variance = constant_variance + uneven
        # Σ x²/V and Σ x e/V of each cell
        precision = np.bincount(cell, response * response / variance, len(fitted.gains))
        pull = np.bincount(cell, response * residual / variance, len(fitted.gains))
        w = 1 / (1 / spread**2 + precision)
        m = w * pull
        # −2 ln N of each cell by Woodbury: Σ e²/V − m Σ x e/V + Σ ln V + ln(1 + spread² Σ x²/V).
        # A single cell does not determine the spread; the last summand keeps it finite.
        volume = np.log(variance).sum() + np.log1p(spread**2 * precision).sum()
        cost = float((residual**2 / variance).sum() - m @ pull + volume + spread)
        # Fisher's identity: the expected derivative of −2 ln of the joint density of e and gains
        squares = (residual - response * m[cell]) ** 2 + response**2 * w[cell]
        by_spread = 2 * (1 - (m**2 + w) / spread**2).sum() + spread
        by_scatter = 2 * (uneven / variance * (1 - squares / variance)).sum()
        return cost, np.array([by_spread, by_scatter])

    minimum = scipy.optimize.minimize(
        cost_and_gradient,
        np.log([fitted.spread, fitted.scatter]),
        jac=True,
        method="L-BFGS-B",
        bounds=[tuple(np.log(RANGE))] * 2,
        options={"ftol": 0.0, "gtol": STATIONARY},
    )
    spread, scatter = np.exp(minimum.x).tolist()
    return replace(fitted, spread=spread, scatter=scatter)


def deviations_from_others(loaded: Loaded, fitted: FittedResponse) -> Array:
    """Return ln of each load's response over its prediction from all other loads, (loads,).

    The deviation of a load is the median over its cells, without those at the edge of the foot,
    whose response depends on the position; NaN where undetermined. The fit without a load is one
    Newton step from the fit with all loads, δ = C Jᵀ (I − J C Jᵀ)⁻¹ f, with the Jacobian J and the
    residuals f of this load, and the covariance C of the state.
    """
    deviations = np.full(len(loaded.change), np.nan)
    load, cell = loaded.felt
    residual, slopes = loaded.rows(fitted, loaded.weight(fitted))
    for number, change in enumerate(loaded.change):
        of_load = load == number
        gain = fitted.covariance @ slopes[of_load].T
        step = gain @ np.linalg.solve(
            np.eye(of_load.sum()) - slopes[of_load] @ gain, residual[of_load]
        )
        expected = (
            replace(fitted, state=fitted.state + step).parts(loaded.falls[0][number]).sum(axis=1)
        )
        elsewhere = np.isin(np.arange(len(change)), cell[~of_load])
        cells = elsewhere & (loaded.pressure[number] != 0) & (change * expected > 0)
        if cells.any():
            place = loaded.pressure_sd[number] / np.where(
                cells, np.abs(loaded.pressure[number]), 1.0
            )
            cells &= place <= np.median(place[cells])
            deviations[number] = float(np.median(np.log(change[cells] / expected[cells])))
    return deviations


def response_of(
    fitted: FittedResponse, base: Response, shape: tuple[int, int], tolerance: float
) -> TableResponse:
    """Return the fit as a table with points densest about 0 kPa, and gains (rows, columns).

    Parameters
    ----------
    fitted : FittedResponse
    base : Response
    shape : (int, int)
        Rows and columns.
    tolerance : float
        Largest relative error that all loads share, uniformly distributed: its standard deviation
        is tolerance/√3.
    """
    falling = _table_points(-base.told_kpa[0])
    rising = _table_points(base.told_kpa[1])
    pressure = np.concatenate([-falling[::-1], rising])
    zero = len(falling)
    logarithm, sd = fitted.curve(pressure, base)
    sd = np.insert(sd, zero, np.interp(0.0, pressure, sd))
    gain, gain_sd = (
        tuple(_significant(row, 4) for row in part.reshape(shape)) for part in fitted.gain()
    )
    return TableResponse(
        pressure_kpa=_significant(np.insert(pressure, zero, 0.0)),
        resistance_ohm=_significant(UNLOADED_OHM * np.exp(np.insert(logarithm, zero, 0.0))),
        sd=_significant(np.hypot(sd, tolerance / np.sqrt(3)), 3),
        gain=gain,
        gain_sd=gain_sd,
    )


def _table_points(most: float) -> Array:
    """Return pressures from MIN_KPA to the largest one in equal ratios, kPa.

    A range below MIN_KPA has its end alone; without a range there is none.
    """
    if most <= 0:
        return np.zeros(0)
    intervals = max(0, int(np.ceil(PER_OCTAVE * np.log2(most / MIN_KPA))))
    return np.geomspace(min(MIN_KPA, most), most, 1 + intervals)


def _significant(values: Array, digits: int = 6) -> tuple[float, ...]:
    """Return values rounded to significant digits."""
    return tuple(float(f"{value:.{digits}g}") for value in values)
