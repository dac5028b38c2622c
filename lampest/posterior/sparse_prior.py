"""Posterior of residuals under absolute losses, by expectation propagation.

The weight of least risk holds residuals at 0. It is not that of their prior, and the curvature of
the cost says nothing at its kink. The prior is therefore a scale mixture of normal distributions,

    x_i ~ N(0, v_i),   v_i ~ Gamma(shape κ, mean V),   0 < κ ≤ 1

κ = 1 is Laplace's prior, that of the absolute loss. Smaller κ have more residuals near 0 and longer
tails: most cells stand still and few move far. κ has a uniform prior, and V that of a uniform
shrinkage σ₀²/(σ₀² + V), σ₀² the variance by which the readings know a residual. The data show both
in every frame.

Each residual has a site N(m_i, s²/ω_i) in place of its prior. The cavity N(μ, c) is the posterior
of x_i without its own site. The site is that with which the posterior has the mean and the variance
of cavity times prior, which are sums over v on a grid:

    p(v) N(μ; 0, c + v),   mean μ v/(c + v),   variance c v/(c + v)

Sources: Minka, Expectation Propagation for Approximate Bayesian Inference, UAI 2001; Griffin &
Brown, Bayesian Analysis 5, 2010 (the prior); Daniels, Canadian J. Statistics 27, 1999 (uniform
shrinkage).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.special import gammainc

from lampest.panel.panel import Array
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import LinearModel, Sites, inverse_root
from lampest.solvers.hessian import square_of_rows

SHAPES = 0.5 ** np.arange(6)  # κ, each half of the one before
SCALES = 30  # of V, in equal steps of ln V
VARIANCES = 60  # of v, in equal steps of ln v
# Share of σ₀² below which a variance is 0; multiple of the largest square of a residual that a
# variance reaches.
NEGLIGIBLE = 1e-4
REACH = 100.0
MAX_ROUNDS = 30
SHARE = 0.7  # of a round's change of the sites, from where whole changes grow: they swing
SETTLED = 0.01  # relative change of the variances of residuals at which the rounds end


@dataclass(frozen=True, eq=False)
class SparsePrior:
    """Scale mixtures of normal distributions on a grid of variances.

    Attributes
    ----------
    variances : array, shape (variances,)
        v.
    shares : array, shape (priors, variances)
        p(v) of every pair of κ and V.
    log_odds : array, shape (priors,)
        Log prior of the pairs, but for a constant.
    """

    variances: Array
    shares: Array
    log_odds: Array

    @classmethod
    def of(cls, known: float, largest: float) -> "SparsePrior":
        """Return the mixtures.

        Parameters
        ----------
        known : float
            Variance σ₀² by which the readings know a residual.
        largest : float
            Largest square of a residual.
        """
        reach = REACH * (known + largest)
        variances = np.geomspace(NEGLIGIBLE * known, reach, VARIANCES)
        middles = np.sqrt(variances[1:] * variances[:-1])
        shape, scale = np.meshgrid(
            SHAPES, np.geomspace(NEGLIGIBLE * known, reach, SCALES), indexing="ij"
        )
        shape, scale = shape.reshape(-1, 1), scale.reshape(-1, 1)
        below = gammainc(shape, middles * shape / scale)
        shares = np.diff(below, axis=1, prepend=0.0, append=1.0)
        # Uniform densities of κ and of the shrinkage b, over steps of ln κ and ln V: κ b (1 − b)
        shrinkage = known / (known + scale)
        odds = shape * shrinkage * (1 - shrinkage)
        return cls(variances, shares, np.log(odds).ravel())

    def moments(self, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Return mean and variance of cavity times prior, (rows,) each.

        Parameters
        ----------
        mean, variance : array, shape (rows,)
            μ and c of the cavities.
        """
        total = variance[:, None] + self.variances
        log_density = -0.5 * (mean[:, None] ** 2 / total + np.log(total))
        density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        # posterior of κ and V, and the mean p(v) under it
        marginal = np.maximum(density @ self.shares.T, np.finfo(float).tiny)
        evidence = self.log_odds + np.log(marginal).sum(axis=0)
        odds = np.exp(evidence - evidence.max())
        density *= odds @ self.shares / odds.sum()
        density /= density.sum(axis=1, keepdims=True)
        means = mean[:, None] * self.variances / total
        whole = np.sum(density * means, axis=1)
        spread = variance[:, None] * self.variances / total + (means - whole[:, None]) ** 2
        return whole, np.sum(density * spread, axis=1)


@dataclass(frozen=True)
class Held:
    """Part of the changes that absolute losses with chosen weights hold at rest.

    With all other residuals as they are, the readings have a residual at x̂ + d, where d is the pull
    λ z/2 of the loss over their curvature, z the dual. A cell whose pulls are all together stronger
    than its change stays at rest: below t = Σ λ |∂x/∂u|/2 over the curvature.

    Attributes
    ----------
    threshold : float
        Median of t over the cells, of log r.
    estimated, seen : float
        Sums of x̂ (x̂ + d) and of (x̂ + d)², weighed by the curvature of the readings.
    """

    threshold: float
    estimated: float
    seen: float

    @classmethod
    def by(cls, model: LinearModel, sensitivity: Array) -> "Held":
        """Return what is held in the last frame of a model.

        Parameters
        ----------
        model : LinearModel
        sensitivity : array, shape (data rows, frames · cells)
            ∂x/∂u of the data.
        """
        chosen = model.chosen_absolute & ~model.unread_rows
        last = slice(-model.cells[-1].size, None)
        rows = sparse.csr_array(abs(model.penalty_jacobian))[chosen][:, last]
        curvature = np.sum(model.data_curvature[:, None] * sensitivity[:, last] ** 2, axis=0)
        pulls = rows.T @ model.at.weights[model.penalty_term[chosen]] / 2
        read = (pulls > 0) & (curvature > 0)
        threshold = np.median(pulls[read] / curvature[read]) if read.any() else 0.0
        # Curvature of the data along one cell of a residual: the mean over its cells
        along = (rows > 0) @ curvature
        known = along > 0
        residual = (model.penalty[chosen] / rows.max(axis=1).toarray().ravel())[known]
        pull = (model.half_slopes[chosen] * rows.sum(axis=1))[known] / along[known]
        seen = residual + pull
        weighed = along[known] * seen
        return cls(float(threshold), float(residual @ weighed), float(seen @ weighed))

    @classmethod
    def together(cls, parts: Sequence["Held"]) -> "Held":
        """Return the same of several frames or modules."""
        threshold = float(np.median([part.threshold for part in parts]))
        sums = np.sum([(part.estimated, part.seen) for part in parts], axis=0)
        return cls(threshold, *map(float, sums))

    @property
    def share(self) -> float:
        """Share of changes that is estimated; 1 where nothing changes."""
        return self.estimated / self.seen if self.seen > 0 else 1.0


def with_sites(errors: DenseErrors) -> DenseErrors:
    """Return errors with sites for the absolute losses whose weights the data chose.

    Raises numpy.linalg.LinAlgError if the cost is flat.
    """
    model = errors.model
    jacobian = sparse.csr_array(model.penalty_jacobian)[:, model.free]
    chosen = model.chosen_absolute & (np.diff(jacobian.indptr) > 0)
    if not chosen.any():
        return errors
    rows = jacobian[chosen]
    residual = model.penalty[chosen]
    term = model.penalty_term[chosen]
    inherited = _inherited_variance(errors, chosen)
    # Everything but the sites: precision, and half the slope of the cost over s²
    curvature = np.where(chosen, 0.0, model.penalty_curvature) / model.scale
    size = np.sqrt(model.data_curvature / model.scale)
    data = errors.jacobian * size[:, None]
    precision = data.T @ data + square_of_rows(jacobian, curvature)
    precision[np.diag_indices(len(precision))] += model.ignorance
    slope = -(rows.T @ model.half_slopes[chosen]) / model.scale
    weight = model.penalty_curvature[chosen] / model.scale
    shift = np.zeros(len(weight))
    priors = dict[int, SparsePrior]()
    share = 1.0
    last = np.inf
    for _ in range(MAX_ROUNDS):
        # Covariance W Wᵀ of the cells, and B W (B W)ᵀ of the residuals
        root = inverse_root(precision + square_of_rows(rows, weight))
        spread = rows @ root
        mean = residual - spread @ (root.T @ (slope + rows.T @ (weight * residual - shift)))
        variance = np.sum(spread**2, axis=1)
        # The cavity, and the errors of what the residual compares with
        cavity = 1 / np.maximum(1 / variance - weight, NEGLIGIBLE / variance)
        middle = cavity * (mean / variance - shift)
        cavity = cavity + inherited
        sites = np.stack([weight, shift])
        for number in np.unique(term):
            own = term == number
            if number not in priors:
                known = 1 / np.mean(1 / cavity[own])
                priors[number] = SparsePrior.of(known, float(np.max(residual[own] ** 2)))
            centre, spread = priors[number].moments(middle[own], cavity[own])
            # Cavity times prior is wider than the cavity where both rest and motion are possible.
            narrowing = np.maximum(1 / spread - 1 / cavity[own], NEGLIGIBLE / cavity[own])
            total = narrowing + 1 / cavity[own]
            sites[:, own] = narrowing, centre * total - middle[own] / cavity[own]
        change = sites - [weight, shift]
        size = float(np.linalg.norm(change[0] * variance))
        if size > last:
            share = SHARE
        last = size
        weight, shift = weight + share * change[0], shift + share * change[1]
        if np.max(np.abs(share * change[0]) * variance) < SETTLED:
            break
    found = Sites(chosen, weight * model.scale, shift / weight)
    return replace(errors, model=replace(model, sites=found))


def _inherited_variance(errors: DenseErrors, chosen: Array) -> Array:
    """Return the variance of residuals due to the errors of the previous frame and baseline."""
    variance = np.zeros(int(chosen.sum()))
    if errors.before is None:
        return variance
    known = [sparse.csr_array(jacobian)[chosen] for jacobian in errors.model.known_jacobians]
    for row, first in enumerate(known):
        for column, second in enumerate(known):
            blocks = errors.before.blocks[row, column]
            variance += np.sum((first @ blocks) * second.toarray(), axis=1)
    return variance
