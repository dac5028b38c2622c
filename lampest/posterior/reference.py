"""Reference estimate: joint estimate of cells and of the readings' error scale, both with heavy-tailed priors.

    y_i = f_i(u) + s σ_i e_i,    (u_b − u_a)/d_ab = τ z_ab,    e, z of Student's t with ν degrees of freedom

over the readings i and the neighbouring cells a, b of a panel, u = log r. Where terms compare a frame with a known
baseline u₀, u_a − u₀_a = τ z_a replaces the steps between neighbours. The scale s is the ratio of the readings' errors
to their noise σ. It contains errors of the model, of the circuit and of the electronics. A few large steps of log r,
such as the edge of a load, cost little under heavy tails, so they are not mistaken for errors of all readings.

For every s of a grid, the posterior of u is approximated by a normal distribution N(û, S) and τ by its most probable
value (variational expectation–maximisation; û by Gauss–Newton steps within the bounds). The resulting bound of the
marginal likelihood, −2 log p(y | s), gives the posterior of log s. The estimate of s is its median.
Sources: Lange, Little & Taylor, J. Amer. Statist. Assoc. 84, 1989 (Student's t as a mixture of normal distributions);
Tipping & Lawrence, Neurocomputing 69, 2005 (its variational bound); MacKay, Neural Computation 4, 1992 (updates of τ).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, block_diag

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.panel.panel import Array
from lampest.posterior.dense import inverse_and_volume
from lampest.posterior.interval import LEVEL

MAX_CELLS = 400  # of a panel: beyond, the matrices of the model take seconds


@dataclass(frozen=True)
class ReferenceModel:
    """Parameters of the model and of its fit.

    Attributes
    ----------
    degrees_of_freedom : float
        ν of Student's t: the smallest integer for which the variance is finite. With squared losses instead, four cells
        of five times the resistance on a 10 × 10 panel look like errors four times the noise
        (docs/theory/posterior.md).
    prior_variance : float
        Prior of τ², with the weight of one step. It covers draws of a prior whose steps are smaller than the noise
        (docs/studies/calibration.md).
    scale_ratio : float
        Ratio of neighbouring s of the grid. A factor of √2 in σ changes no weight by more than its uncertainty.
    max_scales : int
        Maximum number of s on the grid.
    min_relative_noise : float
        First s where the noise is unknown, as a fraction of the reading: no sensor is read to more digits.
    min_gain : float
        Decrease of −2 log p that another s than that of the known noise must reach: odds of e³ to one.
    max_excess : float
        Excess of −2 log p over its minimum at which the search ends: odds of one to e³, about a twentieth.
    max_steps, max_rounds : int
        Maximum number of Gauss–Newton steps for one s, and of updates of the weights for one linearisation.
    max_step : float
        Largest change of log r of a cell in one step.
    settled_bound, settled_step, settled_variance : float
        Changes of −2 log p, of log r and of log τ² below which iterations end.
    ridge : float
        Regularisation of the Hessian, relative to its mean diagonal entry.
    """

    degrees_of_freedom: float = 3.0
    prior_variance: float = 0.015
    scale_ratio: float = 2.0
    max_scales: int = 14
    min_relative_noise: float = 1e-4
    min_gain: float = 6.0
    max_excess: float = 6.0
    max_steps: int = 8
    max_rounds: int = 4
    max_step: float = 1.4
    settled_bound: float = 0.5
    settled_step: float = 0.02
    settled_variance: float = 0.03
    ridge: float = 1e-9


MODEL = ReferenceModel()


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference estimate of one solve.

    Attributes
    ----------
    cells : array, shape (frames, rows, columns)
        Estimated cell resistance, ohm.
    deviation : array, same shape
        a reading is an outlier.
        Standard deviation of each reading due to noise and model error, in the readings' unit; larger for outliers.
        a reading is an outlier.
    covariance : array, shape (frames · cells, frames · cells)
        Covariance S of log r; zero for cells that are absent or faulty.
    """

    cells: Array
    deviation: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ErrorScale:
    """Scale s of the readings' errors relative to their noise, or to the readings where the noise is unknown.

    Attributes
    ----------
    best : float
        Median of the posterior, on the grid.
    tail : float
        95 % quantile of the expected size of the readings' errors.
    readings : int
        Number of two-sided readings.
    scales, bounds : tuple of float
        Grid of s, ascending, and −2 log p(y | s) on it, up to a constant.
    """

    best: float
    tail: float
    readings: int
    scales: tuple[float, ...]
    bounds: tuple[float, ...]

    def gain(self, scale: float) -> float:
        """Return the difference of −2 log p between the grid point nearest to `scale` and the best one."""
        nearest = int(np.argmin(np.abs(np.log(np.array(self.scales) / scale))))
        return self.bounds[nearest] - min(self.bounds)


def references(solves: Sequence[Data], cost: Cost, *, believed: bool = False) -> tuple[ErrorScale, list[Reference]]:
    """Fit the reference model to the data of several solves, with one s for all.

    Parameters
    ----------
    solves : sequence of Data
        Data of one network each, with the same readout.
    cost : Cost
        Cost on the panel. Only its panel, its faulty cells and whether its terms compare frames are used.
    believed : bool
        Whether a known noise is taken as exact, s = 1.

    Returns
    -------
    scale : ErrorScale
    references : list of Reference
        One for every solve.

    Raises numpy.linalg.LinAlgError if a network cannot be solved.
    """
    frames = [ReferenceFit.of(data, cost, frame) for data in solves for frame in range(len(data.measured))]
    known = solves[0].noise_known
    tried = _search(frames, 1.0 if known else MODEL.min_relative_noise, 1 if known and believed else MODEL.max_scales)
    scales = sorted(tried)
    bounds = np.array([_bound(tried[scale]) for scale in scales])
    # Posterior of log s on the grid, p ∝ exp(−bound/2), and its median
    share = np.cumsum(np.exp((bounds.min() - bounds) / 2))
    best = scales[int(np.searchsorted(share, share[-1] / 2))]
    if known and bounds[scales.index(1.0)] - bounds.min() < MODEL.min_gain:
        best = 1.0  # the specified noise holds unless the readings clearly contradict it
    errors = np.concatenate([fit.errors(best) for fit in tried[best]])
    tail = float(np.quantile(errors, LEVEL)) if len(errors) else 0.0
    fits, estimates = iter(tried[best]), []
    for data in solves:
        own = [next(fits) for _ in data.measured]
        cells = np.stack([np.exp(fit.position).reshape(fit.shape) for fit in own])
        deviation = np.stack([fit.deviation(best).reshape(fit.shape) for fit in own])
        estimates.append(Reference(cells, deviation, block_diag(*(fit.covariance for fit in own))))
    return ErrorScale(best, tail, len(errors), tuple(scales), tuple(bounds.tolist())), estimates


def _bound(fits: Sequence["ReferenceFit"]) -> float:
    """Return −2 log p(y | s) of all frames."""
    return sum(fit.bound for fit in fits)


def _search(frames: Sequence["ReferenceFit"], first: float, count: int) -> dict[float, list["ReferenceFit"]]:
    """Return the fits by s, for at most `count` values of s from `first` on.

    Neighbouring s have the ratio `scale_ratio`. Each fit begins at the previous one. The search ends once the bound
    exceeds its minimum by `max_excess` and the residuals are no larger than s.
    """
    tried, fits, scale, lowest = dict[float, list[ReferenceFit]](), list(frames), first, np.inf
    for _ in range(count):
        fits = [fit.settled(scale**2) for fit in fits]
        tried[scale] = fits
        lowest = min(lowest, _bound(fits))
        excess = np.sqrt(max(fit.residual_variance for fit in fits)) / scale
        if _bound(fits) > lowest + MODEL.max_excess and excess <= 1:
            break
        # If the residuals are far larger than s, half of the grid points up to their size are skipped.
        skipped = int(np.log(max(excess, 1.0)) / np.log(MODEL.scale_ratio)) // 2
        scale *= MODEL.scale_ratio ** (1 + skipped)
    return tried


@dataclass(frozen=True, eq=False)
class ReferenceFit:
    """Fit of the reference model to one frame for one s. Readings and steps are in units of σ and of 1 per pitch.

    Attributes
    ----------
    data : Data
    frame : int
        Number of the frame in `data`.
    shape : tuple of int
        Rows and columns.
    cells : array of int
        Numbers of the cells that are present and not known to be faulty.
    steps : array, shape (steps, crossings)
        Matrix of the differences between neighbours over their distance, or of the single cells.
    origin : array, shape (steps,)
        Offset of the steps: zero, or log r of the baseline.
    position, reading : array, shape (crossings,)
        u = log r, and f(u).
    jacobian : array, shape (crossings, crossings)
        ∂f/∂u over σ.
    reading_weights, step_weights : array, shapes (crossings,), (steps,)
        Expected precisions of e in units of 1/s², and of z in units of 1/τ².
    variance : float
        τ².
    covariance : array, shape (crossings, crossings)
        Covariance S of log r; zero for other cells than `cells`.
    change : array, shape (crossings,)
        Gauss–Newton step of log r.
    bound : float
        −2 log p(y | s).
    residual_variance : float
        Weighted sum of squared residuals over the remaining degrees of freedom.
    """

    data: Data
    frame: int
    shape: tuple[int, int]
    cells: NDArray[np.intp]
    steps: Array
    origin: Array
    position: Array
    reading: Array
    jacobian: Array
    reading_weights: Array
    step_weights: Array
    variance: float = 0.1
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    change: Array = field(default_factory=lambda: np.zeros(0))
    bound: float = np.inf
    residual_variance: float = np.inf

    @classmethod
    def of(cls, data: Data, cost: Cost, frame: int) -> "ReferenceFit":
        """Return the fit before the first step, at the readout's start.

        Raises numpy.linalg.LinAlgError if no two cells are neighbours.
        """
        panel = cost.panel
        cells = np.setdiff1d(np.flatnonzero(np.ravel(panel.present)), cost.faulty)
        if cost.needs_previous and data.given.previous is not None:
            steps, origin = np.eye(panel.crossings)[cells], np.log(data.given.previous.ravel()[cells])
        else:
            # Steps between neighbours: (u_b − u_a)/d_ab
            first, second, distance = panel.neighbours
            inside = np.flatnonzero(np.isin(first, cells) & np.isin(second, cells))
            steps, pairs = np.zeros((len(inside), panel.crossings)), np.arange(len(inside))
            steps[pairs, second[inside]], steps[pairs, first[inside]] = 1 / distance[inside], -1 / distance[inside]
            origin = np.zeros(len(inside))
        if not len(steps):
            raise np.linalg.LinAlgError("no cells are neighbours")
        start = data.readout.start(data.measured[frame], data.upper[frame], None)
        nothing, ones = np.zeros(0), np.ones(panel.crossings)
        fit = cls(data, frame, panel.shape, cells, steps, origin, nothing, nothing, nothing, ones, np.ones(len(steps)))
        return fit.at(np.log(np.clip(start, data.lower[frame], data.upper[frame])).ravel())

    def at(self, position: Array) -> "ReferenceFit":
        """Return the fit linearised at u, (crossings,)."""
        network = self.data.network(self.frame, np.exp(position).reshape(self.shape))
        jacobian = np.asarray(network.sensitivity()) / self.sigma[:, None]
        return replace(self, position=position, reading=network.reading().ravel(), jacobian=jacobian)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations σ of the readings, flat; the readings themselves if the noise is unknown."""
        known = self.data.deviation if self.data.noise_known else np.abs(self.data.measured)
        return np.asarray(known[self.frame]).ravel()

    @property
    def prior_variance(self) -> float:
        """Prior of τ² with the weight of one step.

        It is negligible in comparison with a baseline: cells often keep their baseline, but panels rarely have equal
        cells.
        """
        return np.finfo(float).tiny if self.origin.any() else MODEL.prior_variance

    @property
    def step(self) -> Array:
        """Steps of log r less their offset, (steps,)."""
        return np.asarray(self.steps @ self.position - self.origin)

    def residual(self, reading: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the residuals (f − y)/σ of readings f, flat, and two masks of the same shape.

        The first mask contains all readings that count: values, and one-sided readings that are violated. The second
        one contains the values only.
        """
        residual = (reading - self.data.measured[self.frame].ravel()) / self.sigma
        if not self.data.partial:
            every = np.ones(len(residual), dtype=bool)
            return residual, every, every
        side, seen = (np.asarray(given[self.frame]).ravel() for given in (self.data.given.side, self.data.given.seen))
        counted = np.where(side != 0, side * residual < 0, seen > 0)
        return residual, counted, counted & (side == 0)

    def settled(self, square: float) -> "ReferenceFit":
        """Return the fit after expectation and Gauss–Newton steps at s² = `square`, until the bound has converged."""
        fit, previous = self, np.inf
        for _ in range(MODEL.max_steps):
            fit = fit.expected(square)
            if abs(fit.bound - previous) < MODEL.settled_bound:
                break
            previous, moved = fit.bound, fit.moved(square)
            if moved is None:
                break
            still = float(np.abs(moved.position - fit.position).max()) < MODEL.settled_step
            fit = moved
            if still:
                break
        return fit

    def expected(self, square: float) -> "ReferenceFit":
        """Return the fit with weights and τ² updated at the present linearisation, and the resulting step."""
        # Weights and τ² by expectation–maximisation about one linearisation.
        linear = LinearisedFrame.of(self)
        weights = self.reading_weights[linear.rows], self.step_weights
        variance = self.variance
        # Alternate: posterior N(û, S) for given weights and τ²; τ² and weights from that posterior.
        for number in range(MODEL.max_rounds):
            posterior, previous = linear.posterior(self, square, *weights, variance), variance
            residual_variance = posterior.residual_variance(weights[0])
            variance = posterior.step_variance(weights[1], variance, self.prior_variance)
            weights = posterior.weights(square, variance)
            if number and abs(np.log(variance / previous)) < MODEL.settled_variance:
                break
        # Scatter the results over all crossings.
        every, whole = np.zeros(len(self.position)), np.zeros(len(self.position))
        every[linear.rows], whole[self.cells] = weights[0], posterior.change
        of_cells = np.zeros((len(whole), len(whole)))
        of_cells[np.ix_(self.cells, self.cells)] = posterior.covariance
        return replace(
            self,
            reading_weights=every,
            step_weights=weights[1],
            variance=variance,
            covariance=of_cells,
            change=whole,
            bound=posterior.bound(square, variance),
            residual_variance=residual_variance,
        )

    def step_within_bounds(self, matrix: Array, covariance: Array, slope: Array) -> Array:
        """Return the Gauss–Newton step of the cells, with cells at active bounds held.

        Parameters
        ----------
        matrix : array, shape (cells, cells)
            Hessian, upper triangle.
        covariance : array, shape (cells, cells)
            Its inverse.
        slope : array, shape (cells,)
            Gradient.
        """
        lower, upper = (np.ravel(bound[self.frame])[self.cells] for bound in self.data.log_bounds)
        place = self.position[self.cells]
        # Active set: fixed cells, and cells that the gradient presses against a bound; Newton step of the others.
        held = (upper <= lower) | ((place <= lower) & (slope > 0)) | ((place >= upper) & (slope < 0))
        if not held.any():
            return np.asarray(-covariance @ slope)
        free, change = np.flatnonzero(~held), np.zeros(len(slope))
        whole = np.triu(matrix) + np.triu(matrix, 1).T
        change[free] = -np.linalg.solve(whole[np.ix_(free, free)], slope[free])
        return change

    def moved(self, square: float) -> "ReferenceFit | None":
        """Return the fit after the largest tried share of the step that does not raise the cost; None if none."""
        lower, upper = (np.ravel(bound[self.frame]) for bound in self.data.log_bounds)
        # Backtracking on −2 log of the heavy-tailed densities.
        cost, change = self._cost(square), np.clip(self.change, -MODEL.max_step, MODEL.max_step)
        for share in (1.0, 0.3, 0.1, 0.03):
            trial = self.at(np.clip(self.position + share * change, lower, upper))
            if trial._cost(square) <= cost:
                return trial
        return None

    def _cost(self, square: float) -> float:
        """Return −2 log of the joint density at the present position, up to a constant; infinite if not finite."""
        residual, counted, _ = self.residual(self.reading)
        cost = _tails(residual[counted] ** 2, square) + _tails(self.step**2, self.variance)
        return cost if np.isfinite(cost) else np.inf

    def errors(self, scale: float) -> Array:
        """Return s √(E e²) of the two-sided readings, from their weights w = (ν + 1)/(ν + E e²)."""
        weights = self.reading_weights[self.residual(self.reading)[2]]
        return np.asarray(
            scale
            * np.sqrt(
                np.maximum((MODEL.degrees_of_freedom + 1) / np.maximum(weights, 1e-12) - MODEL.degrees_of_freedom, 0.0)
            )
        )

    def deviation(self, scale: float) -> Array:
        """Return the standard deviation s σ/√w of every reading, flat, in the readings' unit."""
        weights = np.where(self.reading_weights > 0, self.reading_weights, 1.0)
        return np.asarray(scale * self.sigma / np.sqrt(weights))


@dataclass(frozen=True, eq=False)
class LinearisedFrame:
    """Readings and steps of a frame, linearised in log r of its cells.

    Attributes
    ----------
    rows : array of int
        Numbers of the readings that count.
    value : boolean array, shape (readings,)
        Which of these are values.
    jacobian, residual : array, shapes (readings, cells), (readings,)
        ∂f/∂u over σ, and residuals (f − y)/σ.
    steps, step : array, shapes (steps, cells), (steps,)
        Matrix of the steps, and their present values.
    rank : int
        Rank of `steps`.
    """

    rows: NDArray[np.intp]
    value: NDArray[np.bool_]
    jacobian: Array
    residual: Array
    steps: Array
    step: Array
    rank: int

    @classmethod
    def of(cls, fit: ReferenceFit) -> "LinearisedFrame":
        """Return the linearisation at the position of a fit."""
        residual, counted, values = fit.residual(fit.reading)
        rows, steps = np.flatnonzero(counted), fit.steps[:, fit.cells]
        rank = min(len(steps), len(fit.cells) - (not fit.origin.any()))
        jacobian = fit.jacobian[np.ix_(rows, fit.cells)]
        return cls(rows, values[rows], jacobian, residual[rows], steps, fit.step, rank)

    def posterior(
        self, fit: ReferenceFit, square: float, of_readings: Array, of_steps: Array, variance: float
    ) -> "Posterior":
        """Return the normal approximation N(û, S) of the posterior.

        Parameters
        ----------
        fit : ReferenceFit
            Source of the bounds.
        square : float
            s².
        of_readings, of_steps : array, shapes (readings,), (steps,)
            Weights of readings and of steps.
        variance : float
            τ².
        """
        readings, steps = of_readings / square, of_steps / variance
        # S⁻¹ = Jᵀ diag(w/s²) J + Dᵀ diag(v/τ²) D with the weights w, v and the matrix D of the steps (upper triangle)
        matrix = blas.dsyrk(1.0, (self.jacobian * np.sqrt(readings)[:, None]).T)
        matrix = blas.dsyrk(1.0, (self.steps * np.sqrt(steps)[:, None]).T, 1.0, matrix, overwrite_c=True)
        matrix[np.diag_indices(len(matrix))] += MODEL.ridge * np.trace(matrix) / len(matrix)
        slope = self.jacobian.T @ (readings * self.residual) + self.steps.T @ (steps * self.step)
        covariance, log_volume = inverse_and_volume(matrix)
        change = fit.step_within_bounds(matrix, covariance, slope)
        # Residuals and steps at û, and their variances diag(J S Jᵀ) and diag(D S Dᵀ).
        missed = self.residual + self.jacobian @ change
        stepped = self.step + self.steps @ change
        spread = (np.sum((rows @ covariance) * rows, axis=1) for rows in (self.jacobian, self.steps))
        return Posterior(self, readings, steps, change, covariance, log_volume, missed, stepped, *spread)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Normal approximation N(û, S) of the posterior of log r, with the residuals and steps under it.

    Attributes
    ----------
    linear : LinearisedFrame
    readings, steps : array, shapes (readings,), (steps,)
        Precisions of the readings and of the steps.
    change : array, shape (cells,)
        û less the position.
    covariance : array, shape (cells, cells)
        S.
    log_volume : float
        log det S.
    missed, stepped : array, shapes (readings,), (steps,)
        Residuals and steps at û.
    missed_variance, stepped_variance : array, shapes (readings,), (steps,)
        Their variances under S.
    """

    linear: LinearisedFrame
    readings: Array
    steps: Array
    change: Array
    covariance: Array
    log_volume: float
    missed: Array
    stepped: Array
    missed_variance: Array
    stepped_variance: Array

    @property
    def _squares(self) -> tuple[Array, Array]:
        """Expected squares of the residuals, (readings,), and of the steps, (steps,)."""
        return self.missed**2 + self.missed_variance, self.stepped**2 + self.stepped_variance

    def residual_variance(self, weights: Array) -> float:
        """Return the weighted sum of squared residuals over the remaining degrees of freedom."""
        value = self.linear.value
        # Degrees of freedom: number of readings − tr(S Jᵀ W J)
        used = float(np.sum((self.readings * self.missed_variance)[value]))
        free = max(int(value.sum()) - used, 1e-3 * len(self.linear.rows))
        return float(np.sum((weights * self.missed**2)[value])) / free

    def step_variance(self, weights: Array, variance: float, prior_variance: float) -> float:
        """Return the most probable τ² for given weights of the steps and the previous τ² `variance`."""
        # τ² = (Σ v z² + prior)/(γ + 1), γ = rank − tr(S Dᵀ V D) the number of steps that the readings determine
        determined = self.linear.rank - float(np.sum(weights / variance * self.stepped_variance))
        return (float(np.sum(weights * self.stepped**2)) + prior_variance) / (max(determined, 0.0) + 1)

    def weights(self, square: float, variance: float) -> tuple[Array, Array]:
        """Return the expected precisions w = (ν + 1)/(ν + x²/s²) of readings and steps, in units of 1/s² and 1/τ²."""
        of_missed, of_stepped = self._squares
        return (MODEL.degrees_of_freedom + 1) / (MODEL.degrees_of_freedom + of_missed / square), (
            MODEL.degrees_of_freedom + 1
        ) / (MODEL.degrees_of_freedom + of_stepped / variance)

    def bound(self, square: float, variance: float) -> float:
        """Return the bound of −2 log p(y | s), up to a constant."""
        of_missed, of_stepped = self._squares
        value, rank = self.linear.value, self.linear.rank
        # n log s² + rank·log τ² − log det S
        volumes = int(value.sum()) * np.log(square) + rank * np.log(variance) - self.log_volume
        return float(volumes + _tails(of_missed[value], square) + _tails(of_stepped, variance))


def _tails(squares: Array, variance: float) -> float:
    """Return −2 log of Student's density for squared residuals and s² = `variance`, without constants and log s²."""
    return float((MODEL.degrees_of_freedom + 1) * np.sum(np.log1p(squares / (MODEL.degrees_of_freedom * variance))))
