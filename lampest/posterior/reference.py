"""Reference estimate: joint estimate of cells and of the readings' error scale.

The scale s is the ratio of the readings' errors to their noise σ, common to all readings. It
contains errors of the model, of the circuit and of the electronics. A few large steps of log r,
such as the edge of a load, cost little under heavy tails, so they are not mistaken for errors of
all readings. The model of one frame is

    y_i = f_i(u) + s σ_i e_i,    (u_b − u_a)/d_ab = τ z_ab

with e and z of Student's t with ν degrees of freedom, over the readings i and the neighbouring
cells a, b of a panel, u = log r. Where terms compare a frame with a known baseline u₀, u_a − u₀_a =
τ z_a replaces the steps between neighbours.

The posterior of u is approximated by a normal distribution N(û, S) and τ by its most probable value
(variational expectation–maximisation; û by Gauss–Newton steps within the bounds). The result is a
bound of the marginal likelihood, −2 log p(y | s). The bounds of a grid of s give the posterior of
log s. The estimate of s is its median.

The expected precisions of e and z are w = (ν + 1)/(ν + E x²/s²) and v = (ν + 1)/(ν + E z²/τ²). The
readings determine γ = rank − tr(S Dᵀ V D) steps. Between neighbours τ² has a scaled inverse χ²
prior of one degree of freedom, τ² = (Σ v z² + prior)/(γ + 1). Against a baseline cells may change
by much less than the readings show, and the likelihood of τ² has its maximum at 0. There τ² has the
uniform shrinkage prior: B = σ₀²/(σ₀² + τ²) is uniform between 0 and 1. Its mode in ln τ² fulfils
τ² = (Σ v z² + 2 B τ²)/(γ + 2 (1 − B)).

Sources: Lange, Little & Taylor, J. Amer. Statist. Assoc. 84, 1989 (Student's t as a mixture of
normal distributions); Tipping & Lawrence, Neurocomputing 69, 2005 (its variational bound); MacKay,
Neural Computation 4, 1992 (updates of τ); Daniels, Canadian J. Statistics 27, 1999 (shrinkage).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import blas, block_diag

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.files.levels import MAD_TO_SIGMA, OUTLIER_THRESHOLD
from lampest.panel.network import Network
from lampest.panel.panel import Array, Mask, Numbers
from lampest.posterior.interval import LEVEL
from lampest.posterior.linear import inverse_and_volume

# Ratio of neighbouring s of the grid: a factor of √2 in σ changes no weight by more than its
# uncertainty.
SCALE_RATIO = 2.0
MAX_SCALES = 14
# First s where the noise is unknown, of the reading: no sensor is read to more digits.
MIN_RELATIVE_NOISE = 1e-4
# Decrease of −2 log p that another s than that of the known noise must reach: odds of e³ to one
MIN_GAIN = 6.0
# Excess of −2 log p over its minimum at which the search ends: odds of one to e³, about a twentieth
MAX_EXCESS = 6.0
MAX_CELLS = 400  # of a panel: beyond, the matrices of the model take seconds
MIN_FREEDOM_SHARE = 1e-3  # of the readings: degrees of freedom where cells follow all of them
STEP_SHARES = (1.0, 0.3, 0.1, 0.03)  # of a Gauss–Newton step, the first that lowers the cost
MIN_WEIGHT = 1e-12  # of a reading: the least one stands for an error of some 10⁶ s
# ν of Student's t: the smallest integer for which the variance is finite. With squared losses
# instead, four cells of five times the resistance on a 10 × 10 panel look like errors four times
# the noise (docs/theory/posterior.md).
DEGREES_OF_FREEDOM = 3.0
# Prior of τ² between neighbours, with the weight of one step. It covers draws of a prior whose
# steps are smaller than the noise (docs/studies/calibration.md).
PRIOR_VARIANCE = 0.015
# First τ² of the iteration, and the least one of steps that count as far beyond the others
FIRST_VARIANCE = 0.1
MAX_STEPS = 8  # of Gauss and Newton for one s
MAX_ROUNDS = 4  # updates of the weights for one linearisation
MAX_STEP = 1.4  # largest change of log r of a cell in one step
# Changes of −2 log p, of log r and of log τ² below which iterations end
SETTLED_BOUND = 0.5
SETTLED_STEP = 0.02
SETTLED_VARIANCE = 0.03
RIDGE = 1e-9  # regularisation of the Hessian, relative to its mean diagonal entry


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference estimate of one solve.

    Attributes
    ----------
    cells : array, shape (frames, rows, columns)
        Estimated cell resistance, ohm.
    deviation : array, same shape
        Standard deviation of each reading due to noise and model error, in the readings' unit;
        larger for outliers.
    covariance : array, shape (frames · cells, frames · cells)
        Covariance S of log r; zero for cells that are absent or faulty.
    """

    cells: Array
    deviation: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class ReferenceFit:
    """Fit of the reference model to one frame for one s.

    Readings and steps are in units of σ and of 1 per pitch.

    Attributes
    ----------
    data : Data
    frame : int
        Number of the frame in `data`.
    cells : array of int
        Numbers of the cells that are present and not known to be faulty.
    steps : array, shape (steps, cells)
        D, matrix of the differences between neighbours over their distance, or of the single cells.
    origin : array, shape (steps,)
        Offset of the steps: zero, or log r of the baseline.
    position : array, shape (crossings,)
        u = log r.
    reading_weights, step_weights : array, shapes (crossings,), (steps,)
        Expected precisions w of e in units of 1/s², and v of z in units of 1/τ².
    variance : float
        τ².
    covariance : array, shape (cells, cells)
        Covariance S of log r.
    change : array, shape (cells,)
        Gauss–Newton step û − u.
    bound : float
        −2 log p(y | s).
    residual_variance : float
        Weighted sum of squared residuals over the remaining degrees of freedom.
    """

    data: Data
    frame: int
    cells: Numbers
    steps: Array
    origin: Array
    position: Array
    reading_weights: Array
    step_weights: Array
    variance: float = FIRST_VARIANCE
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
            steps = np.eye(len(cells))
            origin = np.log(data.given.previous.ravel()[cells])
        else:
            # Steps between neighbours: (u_b − u_a)/d_ab
            first, second, distance = panel.neighbours
            inside = np.isin(first, cells) & np.isin(second, cells)
            unit = np.eye(panel.crossings)[:, cells]
            steps = (unit[second[inside]] - unit[first[inside]]) / distance[inside, None]
            origin = np.zeros(len(steps))
        if not len(steps):
            raise np.linalg.LinAlgError("no cells are neighbours")
        upper = data.upper[frame]
        # Known cells are free in the start: the steps from one that keeps them may end higher.
        start = data.readout.start(data.measured[frame], (np.zeros(upper.shape), upper))
        position = np.log(np.clip(start, data.lower[frame], data.upper[frame])).ravel()
        # Steps far beyond the usual ones count little from the first expectation on: it would take
        # a single cell of many times the resistance for an error of its reading.
        squares = (steps @ position[cells] - origin) ** 2
        usual = max(np.median(squares) * MAD_TO_SIGMA**2, FIRST_VARIANCE)
        far = squares > OUTLIER_THRESHOLD**2 * usual
        return cls(
            data,
            frame,
            cells,
            steps,
            origin,
            position,
            np.ones(panel.crossings),
            np.where(far, _precisions(squares, usual), 1.0),
        )

    @cached_property
    def network(self) -> Network:
        """The solved network at u."""
        return self.data.network(
            self.frame, np.exp(self.position).reshape(self.data.measured[self.frame].shape)
        )

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations σ of the readings, flat; the readings if the noise is unknown."""
        sigma = self.data.deviation if self.data.noise_known else np.abs(self.data.measured)
        return np.asarray(sigma[self.frame].ravel())

    @cached_property
    def residual(self) -> Array:
        """Residuals (f(u) − y)/σ, flat."""
        missed: Array = self.network.reading() - self.data.measured[self.frame]
        return missed.ravel() / self.sigma

    @cached_property
    def values(self) -> Mask:
        """Whether a reading is a value, flat."""
        return np.asarray(self.data.plain[self.frame].ravel())

    @cached_property
    def counted(self) -> Mask:
        """Whether a reading counts, flat: values, and one-sided readings that are violated."""
        if not self.data.partial:
            return self.values
        side = np.ravel(self.data.given.side[self.frame])
        seen = np.ravel(self.data.given.seen[self.frame])
        return np.where(side != 0, side * self.residual < 0, seen > 0)

    @property
    def _log_bounds(self) -> list[Array]:
        """Lower and upper bounds of log r, flat."""
        return [bound[self.frame].ravel() for bound in self.data.log_bounds]

    @property
    def step(self) -> Array:
        """Steps of log r less their offset, (steps,)."""
        return self.steps @ self.position[self.cells] - self.origin

    def settled(self, square: float) -> "ReferenceFit":
        """Return the fit after expectation and Gauss–Newton steps at s² = `square`.

        The steps continue until the bound has converged.
        """
        fit = self
        previous = np.inf
        for _ in range(MAX_STEPS):
            fit = fit.expected(square)
            if abs(fit.bound - previous) < SETTLED_BOUND:
                break
            previous = fit.bound
            place = fit.position
            fit = fit.moved(square)
            if np.abs(fit.position - place).max() < SETTLED_STEP:
                break
        return fit

    def expected(self, square: float) -> "ReferenceFit":
        """Return the fit with the next step, after expectation–maximisation about u.

        The expectation–maximisation updates the weights and τ².
        """
        rows = np.flatnonzero(self.counted)
        jacobian = (self.network.sensitivity() / self.sigma[:, None])[np.ix_(rows, self.cells)]
        residual = self.residual[rows]
        # σ₀² = n/tr(JᵀWJ/s²): the harmonic mean of the variances with which the readings alone
        # determine single cells
        precision = float(np.sum(self.reading_weights[rows, None] * jacobian**2))
        prior_scale = len(self.cells) * square / precision
        fit = self
        for number in range(MAX_ROUNDS):
            previous = fit.variance
            fit = fit._reweighted(rows, jacobian, residual, square, prior_scale)
            if number and abs(np.log(fit.variance / previous)) < SETTLED_VARIANCE:
                break
        return fit

    @property
    def _rank(self) -> int:
        """Rank of D."""
        return min(len(self.steps), len(self.cells) - (not self.origin.any()))

    def _reweighted(
        self, rows: Numbers, jacobian: Array, residual: Array, square: float, prior_scale: float
    ) -> "ReferenceFit":
        """Return the fit with the distribution of log r for its weights, and the weights of that.

        `rows` are the readings that count, `jacobian` and `residual` J and x at u in units of σ,
        `square` and `prior_scale` s² and σ₀². The module describes weights and τ².
        """
        value = self.values[rows]
        # S⁻¹ = Jᵀ diag(w/s²) J + Dᵀ diag(v/τ²) D, upper triangle
        weights = self.reading_weights[rows]
        readings = weights / square
        steps = self.step_weights / self.variance
        stacked = np.vstack([jacobian, self.steps]) * np.sqrt(np.append(readings, steps))[:, None]
        matrix = blas.dsyrk(1.0, stacked.T)
        matrix[np.diag_indices(len(matrix))] += RIDGE * np.trace(matrix) / len(matrix)
        covariance, log_volume = inverse_and_volume(matrix)
        slope = jacobian.T @ (readings * residual) + self.steps.T @ (steps * self.step)
        change = self._within_bounds(matrix, slope)
        # Residuals and steps at û, and their variances diag(J S Jᵀ) and diag(D S Dᵀ).
        residual = residual + jacobian @ change
        step = self.step + self.steps @ change
        residual_variances = np.sum((jacobian @ covariance) * jacobian, axis=1)
        step_variances = np.sum((self.steps @ covariance) * self.steps, axis=1)
        # Σ w x²/(n − tr(S Jᵀ W J)) of the n values
        count = int(value.sum())
        followed = np.sum((readings * residual_variances)[value])
        freedom = max(count - followed, MIN_FREEDOM_SHARE * len(rows))
        squares = np.sum((weights * residual**2)[value])
        # γ = rank − tr(S Dᵀ V D), the number of steps that the readings determine
        determined = max(self._rank - np.sum(steps * step_variances), 0.0)
        step_sum = np.sum(self.step_weights * step**2)
        if self.origin.any():
            share = prior_scale / (prior_scale + self.variance)
            variance = (step_sum + 2 * share * self.variance) / (determined + 2 * (1 - share))
        else:
            variance = (step_sum + PRIOR_VARIANCE) / (determined + 1)
        # −2 log p(y | s) ≤ n log s² + rank·log τ² − log det S + the tails, up to a constant
        reading_squares = residual**2 + residual_variances
        step_squares = step**2 + step_variances
        bound = count * np.log(square) + self._rank * np.log(variance) - log_volume
        bound += _tails(reading_squares[value], square) + _tails(step_squares, variance)
        reading_weights = np.zeros(len(self.position))
        reading_weights[rows] = _precisions(reading_squares, square)
        return replace(
            self,
            reading_weights=reading_weights,
            step_weights=_precisions(step_squares, variance),
            variance=variance,
            covariance=covariance,
            change=change,
            bound=float(bound),
            residual_variance=float(squares / freedom),
        )

    def _within_bounds(self, matrix: Array, slope: Array) -> Array:
        """Return the Gauss–Newton step of the cells, with cells at active bounds held.

        `matrix` is the upper triangle of the Hessian.
        """
        lower, upper = (bound[self.cells] for bound in self._log_bounds)
        place = self.position[self.cells]
        # Active set: fixed cells, and cells that the gradient presses against a bound; Newton step
        # of the others.
        pressed = np.where(slope > 0, place <= lower, (slope < 0) & (place >= upper))
        held = (upper <= lower) | pressed
        free = np.flatnonzero(~held)
        change = np.zeros(len(slope))
        symmetric = np.triu(matrix) + np.triu(matrix, 1).T
        change[free] = -np.linalg.solve(symmetric[np.ix_(free, free)], slope[free])
        return change

    def moved(self, square: float) -> "ReferenceFit":
        """Return the fit after the largest tried share of the step that does not raise the cost.

        The fit itself is returned if every share raises the cost.
        """
        lower, upper = self._log_bounds
        change = np.zeros(len(self.position))
        change[self.cells] = np.clip(self.change, -MAX_STEP, MAX_STEP)
        # Backtracking on −2 log of the heavy-tailed densities.
        for share in STEP_SHARES:
            trial = replace(self, position=np.clip(self.position + share * change, lower, upper))
            if trial.cost(square) <= self.cost(square):
                return trial
        return self

    def cost(self, square: float) -> float:
        """Return −2 log of the joint density at u, up to a constant; infinite if not finite."""
        of_readings = _tails(self.residual[self.counted] ** 2, square)
        cost = of_readings + _tails(self.step**2, self.variance)
        return cost if np.isfinite(cost) else np.inf

    def errors(self, scale: float) -> Array:
        """Return s √(E e²) of the values, from their weights w = (ν + 1)/(ν + E e²)."""
        nu = DEGREES_OF_FREEDOM
        weights = np.maximum(self.reading_weights[self.values], MIN_WEIGHT)
        return scale * np.sqrt(np.maximum((nu + 1) / weights - nu, 0.0))

    def reference(self, scale: float) -> tuple[Array, Array, Array]:
        """Return the estimate, the readings' standard deviations s σ/√w, and S.

        The first two have the shape (rows, columns), S is over all crossings.
        """
        weights = np.where(self.reading_weights > 0, self.reading_weights, 1.0)
        covariance = np.zeros((len(self.position),) * 2)
        covariance[np.ix_(self.cells, self.cells)] = self.covariance
        shape = self.data.measured[self.frame].shape
        deviation = (scale * self.sigma / np.sqrt(weights)).reshape(shape)
        return np.exp(self.position).reshape(shape), deviation, covariance


def _precisions(squares: Array, variance: float) -> Array:
    """Return the expected precisions (ν + 1)/(ν + x²/s²) for squares x² and the `variance` s²."""
    return (DEGREES_OF_FREEDOM + 1) / (DEGREES_OF_FREEDOM + squares / variance)


def _tails(squares: Array, variance: float) -> float:
    """Return −2 log of Student's density, without constants and log s², for squared residuals.

    `variance` is s².
    """
    return float(
        (DEGREES_OF_FREEDOM + 1) * np.sum(np.log1p(squares / (DEGREES_OF_FREEDOM * variance)))
    )


@dataclass(frozen=True, eq=False)
class ErrorScale:
    """Scale s of the readings' errors relative to their noise.

    If the noise is unknown, the scale is relative to the readings.

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
        """Return the difference of −2 log p between the grid point at `scale` and the best one.

        The grid point is the one nearest to `scale`.
        """
        nearest = int(np.argmin(np.abs(np.log(np.array(self.scales) / scale))))
        return self.bounds[nearest] - min(self.bounds)


def references(
    solves: Sequence[Data], cost: Cost, *, believed: bool = False
) -> tuple[ErrorScale, list[Reference]]:
    """Fit the reference model to the data of several solves, with one s for all.

    Parameters
    ----------
    solves : sequence of Data
        Data of one network each, with the same readout.
    cost : Cost
        Cost on the panel. Only its panel, its faulty cells and whether its terms compare frames are
        used.
    believed : bool
        Whether a known noise is taken as exact, s = 1.

    Returns
    -------
    scale : ErrorScale
    references : list of Reference
        One for every solve.

    Raises numpy.linalg.LinAlgError if a network cannot be solved.
    """
    fits = [
        ReferenceFit.of(data, cost, frame) for data in solves for frame in range(len(data.measured))
    ]
    noise_known = solves[0].noise_known
    first = 1.0 if noise_known else MIN_RELATIVE_NOISE
    tried = _fits_by_scale(fits, first, 1 if noise_known and believed else MAX_SCALES)
    scales = list(tried)
    bounds = np.array([sum(fit.bound for fit in fits) for fits in tried.values()])
    # Posterior of log s on the grid, p ∝ exp(−bound/2), and its median
    share = np.cumsum(np.exp((bounds.min() - bounds) / 2))
    best = scales[int(np.searchsorted(share, share[-1] / 2))]
    if noise_known and bounds[0] - bounds.min() < MIN_GAIN:
        best = 1.0  # the specified noise holds unless the readings clearly contradict it
    errors = np.concatenate([fit.errors(best) for fit in tried[best]])
    tail = float(np.quantile(errors, LEVEL)) if len(errors) else 0.0
    frames = iter([fit.reference(best) for fit in tried[best]])
    estimates = []
    for data in solves:
        cells, deviation, covariance = zip(*(next(frames) for _ in data.measured), strict=True)
        joined = Reference(np.stack(cells), np.stack(deviation), block_diag(*covariance))
        estimates.append(joined)
    return ErrorScale(best, tail, len(errors), tuple(scales), tuple(bounds.tolist())), estimates


def _fits_by_scale(
    fits: list[ReferenceFit], first: float, max_scales: int
) -> dict[float, list[ReferenceFit]]:
    """Return the settled fits of all frames for each s of the grid, ascending from the first.

    The grid ends where −2 log p has risen by MAX_EXCESS and no residuals are larger than s.
    """
    scale = first
    lowest = np.inf
    tried = dict[float, list[ReferenceFit]]()
    for _ in range(max_scales):
        # Each fit begins at the previous one.
        fits = [fit.settled(scale**2) for fit in fits]
        tried[scale] = fits
        bound = sum(fit.bound for fit in fits)
        lowest = min(lowest, bound)
        excess = np.sqrt(max(fit.residual_variance for fit in fits)) / scale
        if bound > lowest + MAX_EXCESS and excess <= 1:
            break
        # If the residuals are far larger than s, half of the grid points up to their size are
        # skipped.
        points = int(np.log(max(excess, 1.0)) / np.log(SCALE_RATIO))
        scale *= SCALE_RATIO ** (1 + points // 2)
    return tried
