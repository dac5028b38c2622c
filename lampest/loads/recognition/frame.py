"""One frame as a likelihood: what a pressure on the cells makes of the readings, weighed by all that is uncertain."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, lapack

from lampest.loads.recognition.baseline import Baseline
from lampest.loads.response import PUBLISHED
from lampest.panel.panel import Array
from lampest.panel.response import Response

STEP_KPA = 1e-3  # of the response's slope, which is a difference: f has corners
CURVE_KPA = (-300.0, 1e5)  # beyond, which fits may try on their way, curves have no finite logarithm
MOST_CHANGED = 12.0  # of ln r/r0: beyond, a cell is open or shorted to all readings, and a network soon has no inverse
ALONE, MOST_DROPPED = 5.0, 0.03  # standard deviations of an outlier; share of the readings that may be outliers
EDGE_MM = 3.0  # at a relative deviation of 1: 0.3 mm at 10 %. Patches are glued by hand, rims are soft; an assumption
# Relative, of the patches' edge, an assumption: cut by hand, and a round one is as a square one of 0.89 its width.
PATCH_SD = 0.13
SUSPICIOUS = 1.4  # χ² per reading beyond which outliers, or another position, are looked for
DROPPED = 1e3  # so many times its σ, or its reading, is the σ of one that does not count
NONE = np.zeros(0, dtype=np.intp)  # of the cells


def counting(sigma: Array, measured: Array) -> Array:
    """σ, so large that a reading does not count where it is no value (no finite, positive σ); any shape, ohm."""
    return np.where(np.isfinite(sigma) & (sigma > 0), sigma, DROPPED * measured)


def log_response(pressure: Array, response: Response = PUBLISHED) -> tuple[Array, Array]:
    """κ·ln f(p) and its slope, (rows, columns), kPa → 1 and 1/kPa."""
    near = pressure + np.array([0.0, STEP_KPA, -STEP_KPA])[:, None, None]
    here, up, down = response.gains * response.logarithm(near)
    return here, (up - down) / (2 * STEP_KPA)


@dataclass(frozen=True, eq=False)
class Observation:
    """A frame's readings and what they are compared with.

    measured, sigma : (rows, columns) ohm. baseline : the unloaded panel. water : (rows, columns) kPa, that of the
    unloaded frames too. seconds : since the baseline. common : (cells, n) ohm, a root of the covariance of what the
    frame's readings share by chance, its gain and patterns along scanned lines; None: nothing.
    """

    measured: Array
    sigma: Array
    baseline: Baseline
    water: Array
    seconds: float
    common: Array | None = field(default=None, kw_only=True)

    def missed(self, change: Array, chosen: NDArray[np.intp]) -> tuple[Array, Array]:
        """R − f(r0·e^change) − offsets (cells), and ∂f by the changes of some cells (cells, chosen)."""
        network = self.baseline.network(change)
        return self.target - network.reading().ravel(), network.sensitivity(chosen)

    def slope(self, change: Array) -> Array:
        """∂f/∂ln r at ln r/r0 = `change`, (cells, cells)."""
        return self.baseline.network(change).sensitivity()

    def change(self, pressure: Array) -> tuple[Array, Array]:
        """ln r/r0 = κ·(ln f(p + p_w) − ln f(p_w)) and its slope, (rows, columns), 1 and 1/kPa; MOST_CHANGED at most."""
        loaded, slope = log_response(np.clip(pressure + self.water, *CURVE_KPA), self.baseline.response)
        change = loaded - self._unloaded
        return np.clip(change, -MOST_CHANGED, MOST_CHANGED), slope * (np.abs(change) < MOST_CHANGED)

    def covariance(self, change: Array) -> Array:
        """σ² + V Vᵀ + H C Hᵀ + J T Jᵀ at ln r/r0 = `change`, (cells, cells) ohm².

        Of each reading, of all in a frame, of the baseline, and of cells at rest.
        """
        slope = self.slope(change)
        resting = self.baseline.model_errors.resting_covariance(self.seconds, len(slope))
        both = np.hstack([slope, self.offsets])
        total = both @ self.baseline.covariance @ both.T + slope @ resting @ slope.T
        if self.common is not None:
            total += self.common @ self.common.T
        return np.asarray(total + np.diag(self.sigma.ravel() ** 2))

    @cached_property
    def target(self) -> Array:
        """The readings without the most probable offsets, (cells) ohm."""
        return np.asarray(self.measured.ravel() - self.offsets @ self.baseline.offsets)

    @cached_property
    def offsets(self) -> Array:
        """E (cells, offsets) ohm: what every offset's standard deviation adds to the readings."""
        return self.baseline.model_errors.offsets(self.measured, self.baseline.scene)

    @cached_property
    def _unloaded(self) -> Array:
        """κ·ln f(p_w), (rows, columns)."""
        return log_response(self.water, self.baseline.response)[0]


class Explained(NamedTuple):
    """What a load explains, (rows, columns) ln r/r0.

    edges, patches : by how much a shift of the load by 1 mm changes that, and patches that are larger by their edge.
    """

    change: Array
    edges: Array
    patches: Array

    def uneven(self, alike: Array) -> Array:
        """x K xᵀ + w², (cells, cells): how cells of a film with a relative deviation of 1 answer, K = `alike`."""
        change = self.change.ravel()
        return np.asarray(alike * np.outer(change, change) + np.diag((EDGE_MM * self.edges.ravel()) ** 2))

    def shared(self, bent: float) -> Array:
        """(2, cells) ln r of one standard deviation of what all cells share: a bent film, and patches' sizes."""
        return np.stack([bent * self.change.ravel(), PATCH_SD * self.patches.ravel()])


@dataclass(frozen=True, eq=False)
class Whitening:
    """The root of a covariance, lower triangular, with the relative deviation of the film that it was made for."""

    root: Array
    scatter: float = 0.0

    @classmethod
    def of(cls, frame: Observation, explained: Explained, scatter: float) -> "Whitening":
        """For a frame about what a load explains, where cells answer with a relative deviation of `scatter`."""
        return whitenings(frame, explained, (scatter,))[0]

    @classmethod
    def at_rest(cls, frame: Observation) -> "Whitening":
        """For a frame of a panel that nothing touches."""
        return cls(cholesky(frame.covariance(np.zeros(frame.measured.shape)), lower=True))

    @cached_property
    def volume(self) -> float:
        """½ ln det C."""
        return float(np.log(np.diag(self.root)).sum())

    def __matmul__(self, vectors: Array) -> Array:
        """L⁻¹·v: errors of unit variance."""
        return np.asarray(lapack.dtrtrs(self.root, vectors, lower=1)[0])


def whitenings(frame: Observation, explained: Explained, scatters: Iterable[float]) -> list[Whitening]:
    """For a frame about what a load explains, where cells answer with a relative deviation of each `scatter`.

    Covariance S + scatter²·J (x K xᵀ + w²) Jᵀ: ln r/r0 = x scatters in proportion to itself, partly alike in
    neighbours and everywhere (K, `Baseline.alike`); w is what an edge that lies `EDGE_MM` beside its place does. S is
    that of the frame without a load, and what all cells share.
    """
    slope = frame.slope(explained.change)
    shared = slope @ explained.shared(frame.baseline.model_errors.bent).T
    base = frame.covariance(explained.change) + shared @ shared.T
    film = slope @ explained.uneven(frame.baseline.alike) @ slope.T
    return [
        Whitening(cholesky(base + scatter**2 * film, lower=True, check_finite=False), scatter) for scatter in scatters
    ]


def outliers(whitening: Whitening, residual: Array) -> NDArray[np.intp]:
    """Numbers of the readings that lie far from what all the others predict; residual (cells) ohm.

    z_i = (C⁻¹e)_i/√(C⁻¹)_ii is the error of i as predicted from the rest, over its standard deviation. The worst one
    is taken out before the next is looked for.
    """
    inverse = whitening @ np.eye(len(residual))
    precision = inverse.T @ inverse
    pull, dropped = precision @ residual, NONE
    left = np.ones(len(residual), dtype=bool)
    while len(dropped) < max(1, int(MOST_DROPPED * len(residual))):
        score = np.where(left, np.abs(pull) / np.sqrt(np.where(left, np.diag(precision), 1.0)), 0.0)
        worst = int(np.argmax(score))
        if score[worst] <= ALONE:
            break
        dropped, left[worst] = np.append(dropped, worst), False
        column = precision[:, worst] / precision[worst, worst]
        pull = pull - column * pull[worst]
        precision = precision - np.outer(column, precision[worst])
    return dropped


def without(frame: Observation, dropped: NDArray[np.intp]) -> Observation:
    """The frame with some readings' σ so large that they no longer count."""
    sigma = frame.sigma.copy().ravel()
    sigma[dropped] *= DROPPED
    return replace(frame, sigma=sigma.reshape(frame.sigma.shape))
