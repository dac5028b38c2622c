"""Linear model about an estimate with Gaussian noise and Gaussian penalties, in u = log r.

Residuals are x ≈ x̂ + Z·p with curvature ω, p a change of u, and the cost is Σ ω x². Residuals of
data have the noise τ; all others are penalties. With s² = mean ω τ² over the data, cost/s² is
−2·log probability.
"""

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse
from scipy.linalg import blas, lapack

from lampest.cost.cost import Cost
from lampest.cost.losses import Loss
from lampest.cost.problem import Evaluation, Residuals, residuals
from lampest.panel.compiled import with_entries
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import MAX_DENSE
from lampest.solvers.hessian import by_log

NEAR_BOUND = 1e-3  # of log r: distance from a bound within which a cell is at it
# Percent: an absolute residual below it is 0. Solvers end at 1e-7 and less, noise moves cells by
# 0.01 and more (tests/oracles/test_certainty.py).
PINNED = 1e-4
UNKNOWN_SD = 10.0  # standard deviation of log r0 where nothing is known of it
IGNORANCE = 1e-4  # prior precision of log r, which regularises cells without data and penalties


@dataclass(frozen=True, eq=False)
class Sites:
    """Normal distributions N(m, s²/ω) in place of the prior of residuals with absolute losses.

    Attributes
    ----------
    rows : boolean array, shape (penalty rows,)
        Whether a residual has a site.
    curvature, centre : array, shape (sites,)
        ω and m.
    """

    rows: Mask
    curvature: Array
    centre: Array


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model about an estimate.

    Attributes
    ----------
    at : Evaluation
        Evaluation at the estimate. All vectors below are flat, over (frames · cells) or over rows
        of residuals.
    dual : array
        Duals of its absolute losses.
    deviation : array or None
        Standard deviation of the readings, shape of `Data.measured`; None for σ of the data.
    weight_sigma : tuple of float
        For every term, the standard deviation of log λ if the data chose its weight, otherwise NaN;
        () if no weight was chosen.
    sites : Sites or None
        Distributions in place of the prior of absolute losses whose weights the data chose; see
        `lampest.posterior.sparse_prior`.
    """

    at: Evaluation
    dual: Array
    _: KW_ONLY
    deviation: Array | None = None
    weight_sigma: tuple[float, ...] = ()
    sites: Sites | None = None

    @property
    def cells(self) -> Array:
        """Cells at the estimate, (frames, rows, columns) ohm."""
        return self.at.cell_resistance

    @cached_property
    def gradient(self) -> Array:
        """Gradient ∂φ/∂u, (cells,)."""
        return self.at.log_gradient(self.dual).ravel()

    @cached_property
    def at_lower(self) -> Mask:
        """Whether a cell is held at its lower bound by the gradient, boolean (cells,)."""
        return (self._rooms[0] <= NEAR_BOUND) & (self.gradient > 0) & ~self.fixed

    @cached_property
    def at_upper(self) -> Mask:
        """Whether a cell is held at its upper bound by the gradient, boolean (cells,)."""
        return (self._rooms[1] <= NEAR_BOUND) & (self.gradient < 0) & ~self.fixed

    @cached_property
    def fixed(self) -> Mask:
        """Whether the bounds of a cell coincide, boolean (cells,)."""
        return (self.at.data.lower >= self.at.data.upper).ravel()

    @cached_property
    def free(self) -> Numbers:
        """Numbers of the cells that no bound holds."""
        return np.flatnonzero(~(self.at_lower | self.at_upper | self.fixed))

    def over_all(self, values: Array) -> Array:
        """Return values (free, …) of the free cells over all cells, (cells, …), zero elsewhere."""
        full = np.zeros((self.cells.size, *values.shape[1:]))
        full[self.free] = values
        return full

    @cached_property
    def _rooms(self) -> tuple[Array, Array]:
        """Distances of log r from the lower and the upper bound, (cells,)."""
        lower, upper = self.at.data.log_bounds
        return (self.at.position - lower).ravel(), (upper - self.at.position).ravel()

    @cached_property
    def ignorance(self) -> Array:
        """Prior precision ε of log r, (free,); 12/ln²(upper/lower) for cells that were not read."""
        # Variance of a uniform distribution over the bounds: ln²(upper/lower)/12
        within = 12 / np.maximum(np.sum(self._rooms, axis=0)[self.free], NEAR_BOUND) ** 2
        return np.where(self.unread, np.maximum(within, IGNORANCE), IGNORANCE)

    @cached_property
    def unread(self) -> Mask:
        """Whether a cell's own reading is missing, boolean (free,)."""
        if not self.at.data.partial:
            return np.zeros(len(self.free), dtype=bool)
        seen = np.broadcast_to(self.at.data.given.seen, self.cells.shape).ravel()
        return np.asarray(seen[self.free] == 0)

    @cached_property
    def unread_rows(self) -> Mask:
        """Whether a penalty involves a free cell without a reading, boolean (penalty rows,)."""
        return np.asarray(abs(self.penalty_jacobian)[:, self.free[self.unread]].sum(axis=1) > 0)

    @property
    def _residuals(self) -> Residuals:
        return residuals(self.at.cost)

    @cached_property
    def through(self) -> sparse.csc_array:
        """Derivative ∂x/∂y of the data by the readings, sparse (data rows, cells)."""
        return self._residuals.data.jacobian("reading", self.at)

    @property
    def penalty_rank(self) -> int:
        """Rank of the Jacobian of all penalties over the free cells, as that of `rank`."""
        return min(rank(self.at.cost.unweighted), len(self.free))

    @cached_property
    def noise(self) -> Array:
        """Standard deviations τ of the data, (data rows,)."""
        noise = self.at.data.deviation if self.deviation is None else self.deviation
        return np.asarray(np.sqrt(self.through.power(2) @ noise.ravel() ** 2))

    @cached_property
    def data_curvature(self) -> Array:
        """Curvature ω of the data, (data rows,); zero for rows of missing or one-sided readings."""
        side = self.at.data.given.side
        curvature = self.at.weights[self._residuals.data.term] * (self.noise > 0)
        if side is not None and np.any(side):
            curvature = curvature * ~(abs(self.through) @ np.abs(side.ravel()) > 0)
        for _, loss, rows in curved_rows(self.at.cost, self._residuals.data.term):
            curvature[rows] *= loss.data_curvature(self.residual[rows], self.noise[rows])
        return curvature

    @cached_property
    def residual(self) -> Array:
        """Residuals x̂ of the data, (data rows,)."""
        return self._residuals.data.values(self.at)

    @cached_property
    def scale(self) -> float:
        """Scale s² = mean ω τ² over the data with curvature."""
        curved = self.data_curvature > 0
        if not curved.any():
            return 1.0
        return float(np.mean(self.data_curvature[curved] * self.noise[curved] ** 2))

    @cached_property
    def penalty(self) -> Array:
        """Residuals x̂ of the penalties, (penalty rows,)."""
        return self._residuals.penalties.values(self.at)

    @cached_property
    def absolute(self) -> Mask:
        """Whether a penalty row has an absolute loss, (penalty rows,)."""
        enters = np.array([term.loss.enters == "dual" for term in self.at.cost.terms])
        return enters[self.penalty_term]

    @cached_property
    def plateaus(self) -> sparse.csc_array:
        """Orthonormal changes of log r that keep residuals of absolute losses at 0, sparse.

        The shape is (cells, plateaus). Cells whose residual is 0 against a reference belong to no
        plateau. Cells whose differences are 0 form one plateau. The number of plateaus is that of
        the degrees of freedom of such an estimate (Zou, Hastie & Tibshirani, Ann. Stat. 35, 2007;
        Tibshirani & Taylor, Ann. Stat. 40, 2012).
        """
        from scipy.sparse.csgraph import connected_components  # for absolute losses

        cells = self.cells.size
        pinned = self.absolute & (np.abs(self.penalty) < PINNED)
        rows = sparse.csr_array(self.penalty_jacobian)[pinned]
        counts = np.diff(rows.indptr)
        alone = rows.indices[np.repeat(counts == 1, counts)]
        pairs = rows.indices[np.repeat(counts == 2, counts)].reshape(-1, 2).T
        linked = sparse.coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(cells, cells))
        count, label = connected_components(linked, directed=False)
        moving = np.setdiff1d(np.arange(count), label[alone])
        entry = np.bincount(label)[label] ** -0.5
        basis = sparse.csc_array((entry, (np.arange(cells), label)), shape=(cells, count))
        return sparse.csc_array(basis[:, moving])

    @property
    def chosen_absolute(self) -> Mask:
        """Whether a penalty row has an absolute loss whose weight the data chose, (rows,)."""
        chosen = np.flatnonzero(np.isfinite(self.weight_sigma))
        return self.absolute & np.isin(self.penalty_term, chosen) & (len(self.dual) > 0)

    @property
    def half_slopes(self) -> Array:
        """Half the slopes λ z/2 of absolute losses, z the duals; 0 elsewhere, (penalty rows,)."""
        slopes = np.zeros(len(self.penalty_term))
        dual_term = self.at.cost.functions.nonsmooth_terms
        for number in np.unique(self.penalty_term[self.absolute]):
            dual = self.dual[dual_term == number]
            slopes[self.penalty_term == number] = self.at.weights[number] * dual / 2
        return slopes

    @cached_property
    def penalty_term(self) -> Numbers:
        """Number of the term of every penalty row."""
        return self._residuals.penalties.term

    @cached_property
    def penalty_curvature(self) -> Array:
        """Curvature ω of the penalties and of sites, (penalty rows,)."""
        curvature = self.penalty_curvature_for(self.at.weights)
        if self.sites is not None:
            curvature[self.sites.rows] = self.sites.curvature
        return curvature

    def penalty_curvature_for(self, weights: Array) -> Array:
        """Return the curvature ω of the penalties for given weights (terms,), (penalty rows,)."""
        curvature = weights[self.penalty_term]
        for number, loss, rows in curved_rows(self.at.cost, self.penalty_term):
            curvature[rows] *= loss.penalty_curvature(
                self.penalty[rows], weights[number], self.scale
            )
        return curvature

    @cached_property
    def pulls(self) -> sparse.csc_array:
        """Independent errors of half the gradient due to penalties, (W, Zᵀ H), sparse (cells, n).

        W = σ λ Zᵀ ½ρ'(x̂) has a column for each weight that the data chose, for one standard
        deviation σ of log λ. Without it, intervals are too narrow where the noise is as large as
        the prior (docs/studies/calibration.md). H is half the slope ∂φ/∂x of
        each row beyond ω x̂; see `Loss.steady_pull`. Sites have the column Zᵀ (λ z/2 − ω (x̂ − m)):
        it moves the estimate to the mean of the posterior with them.
        """
        terms = self.at.cost.terms
        weights = self.at.weights
        residual = self.penalty
        beyond = np.zeros(len(residual))
        columns = [sparse.csc_array((len(residual), 0))]
        for number, loss, rows in curved_rows(self.at.cost, self.penalty_term):
            beyond[rows] = weights[number] * loss.steady_pull(residual[rows])
        with_site = np.zeros(len(residual), dtype=bool)
        if self.sites is not None:
            with_site = self.sites.rows
            pull = np.where(with_site, self.half_slopes, 0.0)
            pull[with_site] -= self.sites.curvature * (residual[with_site] - self.sites.centre)
            columns.append(sparse.csc_array(pull[:, None]))
        for number, sigma in enumerate(self.weight_sigma):
            rows = (self.penalty_term == number) & ~with_site
            if np.isfinite(sigma) and rows.any():
                slope = weights[number] * terms[number].loss.stiffness(residual) * residual
                columns.append(sparse.csc_array(np.where(rows, sigma * slope, 0.0)[:, None]))
        if beyond.any():
            columns.append(sparse.diags_array(beyond))
        return sparse.csc_array(self.penalty_jacobian.T @ sparse.hstack(columns))

    @cached_property
    def penalty_jacobian(self) -> sparse.csc_array:
        """Z, the derivative ∂x/∂u of the penalties, sparse (penalty rows, cells)."""
        jacobian = self._residuals.penalties.jacobian("cell_resistance", self.at)
        return by_log(jacobian, self.cells)

    @cached_property
    def known_jacobians(self) -> tuple[sparse.csc_array, ...]:
        """Z₀, derivatives ∂x/∂u₀ of the penalties, sparse (penalty rows, cells), for two u₀.

        The cells u₀ are log r of the previous frame (0) and of the baseline (1).
        """
        inputs = self.at.data.given
        jacobians = list[sparse.csc_array]()
        for name, cells in (("previous", inputs.previous), ("baseline", inputs.baseline)):
            jacobian = self._residuals.penalties.jacobian(name, self.at)
            known = cells is not None and jacobian.nnz
            jacobians.append(by_log(jacobian, cells) if known else jacobian)
        return tuple(jacobians)

    def carried(self, changes: Array) -> Array:
        """Return Z₀ a, (penalty rows, …), for changes a of the previous frame and baseline.

        a are changes of log r, (2, cells, …).
        """
        by_previous, by_baseline = self.known_jacobians
        return np.asarray(by_previous @ changes[0] + by_baseline @ changes[1])


def positive_inverse(matrix: Array) -> Array:
    """Return A⁻¹ from the upper triangle of A.

    Raises numpy.linalg.LinAlgError if A is not positive definite.
    """
    return inverse_and_volume(matrix)[0]


def inverse_and_volume(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a matrix A from its upper triangle, and its volume.

    Raises as `positive_inverse`.

    Returns
    -------
    inverse : array, shape of A
        A⁻¹.
    log_volume : float
        log det A⁻¹.
    """
    if not matrix.size:
        return matrix, 0.0
    # LAPACK has the columns in memory: it takes the transposed of a matrix without turning it.
    factor = _sound(*lapack.dpotrf(matrix.T, lower=True))
    inverse = _sound(*lapack.dpotri(factor, lower=True))
    inverse = inverse + inverse.T  # its upper triangle is zero
    np.einsum("ii->i", inverse)[...] /= 2
    return inverse, -2 * float(np.sum(np.log(np.diag(factor))))


def inverse_root(matrix: Array) -> Array:
    """Return W with A⁻¹ = W Wᵀ from the upper triangle of A. Raises as `positive_inverse`."""
    return _sound(*lapack.dtrtri(_sound(*lapack.dpotrf(matrix))))


def whitened(root: Array, values: Array) -> Array:
    """Return L⁻¹ X of a lower triangular L, (n, n), and X, (n, m).

    Raises numpy.linalg.LinAlgError if L is singular.
    """
    if not root.size:
        return values
    return np.asarray(_sound(*lapack.dtrtrs(root, values, lower=True)))


def misfit_and_volume(covariance: Array, deviation: Array) -> tuple[float, float]:
    """Return the misfit dᵀ C⁻¹ d of deviations d of covariance C, and ln det C.

    Raises as `positive_inverse`.
    """
    if not deviation.size:
        return 0.0, 0.0
    factor, failed = lapack.dpotrf(covariance.T, lower=True, clean=False)
    diagonal = _sound(factor.diagonal(), failed)
    # Entries beside the diagonal that are not finite reach the whitened deviations.
    white = _sound(*lapack.dtrtrs(factor, deviation, lower=True))
    return float(white @ white), 2 * float(np.log(diagonal).sum())


def _sound(result: Array, failed: int) -> Array:
    """Return the result of a routine of LAPACK.

    Raises numpy.linalg.LinAlgError if it failed, or the result is not finite.
    """
    if failed or not np.isfinite(result).all():
        raise np.linalg.LinAlgError("the cost is flat round the estimate")
    return result


def swept(table: Array, place: int) -> Array:
    """Return a table T, (n, m) with m ≥ n, swept by its diagonal entry t_pp.

    A table of rows in memory is overwritten.

        T ← T − t_·p t_p·/t_pp,   row and column p over |t_pp|,   t_pp ← −1/t_pp

    Source: Goodnight, The American Statistician 33, 1979 (the sweep operator).
    """
    pivot = table[place, place]
    row = table[place].copy()
    column = table[:, place].copy()
    # dger adds in place, in a fifth of the time of np.outer.
    table = blas.dger(-1 / pivot, row, column, a=table.T, overwrite_a=True).T
    table[place] = row / abs(pivot)
    table[:, place] = column / abs(pivot)
    table[place, place] = -1 / pivot
    return table


def curved_rows(cost: Cost, term: Numbers) -> Iterator[tuple[int, Loss, Mask]]:
    """Yield (number, loss, boolean rows) of every term whose loss is not squared.

    The curvature ω of such rows is not the weight alone. `term` contains the number of the term of
    every row.
    """
    for number, part in enumerate(cost.terms):
        rows = term == number
        if not part.loss.squared and rows.any():
            yield number, part.loss, rows


@lru_cache(maxsize=64)
def rank(cost: Cost) -> int:
    """Return the rank of the Jacobian of all penalties at random cells, without regard to bounds.

    Penalties of large panels nearly have full rank, which is returned for them.
    """
    function = residuals(cost).penalties.functions["cell_resistance"]
    count, cells = function.structure.shape
    if cells > MAX_DENSE:
        return int(min(count, cells))
    anywhere = np.random.default_rng(0)
    values = function(*(anywhere.uniform(0.5, 2.0, size) for size in function.sizes))
    jacobian = with_entries(function.structure, values)
    return int(np.linalg.matrix_rank((jacobian.T @ jacobian).toarray(), hermitian=True))
