"""Simulation-based calibration: error bars of cells that are drawn from the prior of a penalty.

Run it with: python -m docs.studies.simulated_calibration [--draws 100] [--seed 0]; prints the table
of the page.

A penalty λ Σ x² beside a misfit in units of the noise is a normal prior of the cells, x ~ N(0,
1/λ). Cells are drawn from it, read with noise, and estimated with this λ or with `weight: auto`. If
the bars are right, the posterior probability of values below the truth, Φ((u − û)/σ), is uniform,
and every interval holds the truth as often as it says. The prior of an absolute loss is Laplace's.
Sources: Talts et al., arXiv 1804.06788, 2018 (calibration); Säilynoja, Bürkner & Vehtari,
Statistics and Computing 32, 2022 (simultaneous bands of the empirical distribution).
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binom, norm

import lampest
from lampest import two_point_resistance
from lampest.cost.given import Background
from lampest.panel.panel import Array
from lampest.posterior.linear import LinearModel
from lampest.recording.readings import Readings
from lampest.solvers.multistart import evaluated

SIDE = 6
MEAN_OHM = 3000.0
SCENE = lampest.Scene(lampest.Panel(SIDE, SIDE))
MISFIT = lampest.Misfit(weighting="noise")
PRIORS: dict[str, lampest.Term] = {
    "log_gradient": lampest.LogGradient(),
    "gradient": lampest.Gradient(),
    "log_ratio": lampest.LogRatio(loss=lampest.Squared()),
    "log_ratio, absolute": lampest.LogRatio(),
}
BASELINE_NOISE = 1e-6  # σ/R of the unloaded frame, which is as good as exact
# σ/R; sd of a step
SETTINGS = {"low noise": (0.002, 0.3), "medium noise": (0.02, 0.15), "high noise": (0.06, 0.06)}
LEVELS = (0.5, 0.8, 0.95)
# One cell of each draw: cells of the same draw are not independent.
CELLS = (0, SIDE * SIDE // 2 + 2)
# of a band
POINTS = 20
BAND_DRAWS = 2000


def prior_root(penalty: lampest.Term) -> Array:
    """A root of the covariance of u = ln(r/3 kΩ) for λ = 1.

    Of `gradient`, u stands for r/3 kΩ − 1.
    """
    if penalty.needs_previous:
        return np.eye(SIDE * SIDE) / 100  # the residuals are 100 u
    estimator = lampest.Estimator((MISFIT, replace(penalty, weight=1.0)), "reduced")
    cells = np.full((1, SIDE, SIDE), MEAN_OHM)
    readings = two_point_resistance(cells)
    data = estimator.data(Readings.of(SCENE, readings, 0.01 * readings), Background(SCENE))
    model = LinearModel(
        evaluated(estimator.cost(SCENE, 1, partial=False), data, cells), np.zeros(0)
    )
    values, vectors = np.linalg.eigh((model.penalty_jacobian.T @ model.penalty_jacobian).toarray())
    known = values > 1e-9 * values.max()
    return np.asarray(vectors[:, known] / np.sqrt(values[known]))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Standard scores z = (u − û)/σ of all cells (draws, cells), and the chosen weights.

    The chosen weights are over the true one (draws).
    """

    scores: Array
    weights: Array

    @property
    def coverage(self) -> tuple[float, ...]:
        """The share of cells within their intervals of each of LEVELS."""
        return tuple(
            float(np.mean(np.abs(self.scores) < norm.ppf(0.5 + level / 2))) for level in LEVELS
        )

    @property
    def uniformity(self) -> tuple[float, ...]:
        """The probability of a distribution this far from uniform, for each of CELLS."""
        return tuple(uniform_tail(norm.cdf(self.scores[:, cell])) for cell in CELLS)


def calibration(
    penalty: lampest.Term, noise: float, step: float, chosen: bool, draws: int, seed: int
) -> Calibration:
    """Estimate draws from the prior of a penalty.

    Parameters
    ----------
    penalty : Term
    noise : float
        σ of the readings over the readings.
    step : float
        Standard deviation of ln r from a cell to the next.
    chosen : bool
        Whether the data choose the weight.
    draws, seed : int
    """
    in_ohm = isinstance(penalty, lampest.Gradient)
    against_baseline = penalty.needs_previous
    absolute = isinstance(penalty.loss, lampest.Absolute)
    weight = 1 / (step * (MEAN_OHM if in_ohm else 100.0 if against_baseline else 1.0)) ** 2
    root = prior_root(penalty) / np.sqrt(weight)
    if absolute:  # λ |x| is −2 log of Laplace's density with the variance 8/λ²
        weight = np.sqrt(8 * weight)
    rng = np.random.default_rng(seed)
    scores = []
    weights = []
    for _ in range(draws):
        drawn = (
            rng.laplace(0, 2**-0.5, root.shape[1])
            if absolute
            else rng.standard_normal(root.shape[1])
        )
        u = (root @ drawn).reshape(1, SIDE, SIDE)
        cells = MEAN_OHM * (np.maximum(1 + u, 0.1) if in_ohm else np.exp(u))
        exact = two_point_resistance(cells)
        readings = exact * (1 + noise * rng.standard_normal(exact.shape))
        sigma = noise * exact
        role = np.ones(1, dtype=np.uint8)
        if against_baseline:
            resting = two_point_resistance(np.full_like(cells, MEAN_OHM))
            readings = np.concatenate([resting, readings])
            sigma = np.concatenate([BASELINE_NOISE * resting, sigma])
            role = np.array([0, 1], dtype=np.uint8)
        recording = lampest.Recording(
            SCENE, readings, np.arange(float(len(role))), role, sigma=sigma
        )
        terms = (MISFIT, replace(penalty, weight="auto" if chosen else weight))
        results = lampest.reconstruct(recording, terms, bounds=lampest.Bounds("none", "none"))
        deviation = np.asarray(results.cell_resistance_errors) / results.cell_resistance
        scores.append((np.log(cells / results.cell_resistance) / deviation).ravel())
        weights.append(results.steps[0].weights[1] / weight)
    return Calibration(np.array(scores), np.array(weights))


def uniform_tail(values: Array) -> float:
    """Return the probability that uniform values deviate from uniformity as clearly as these."""
    simulated = np.random.default_rng(0).uniform(size=(BAND_DRAWS, len(values)))
    return float(np.mean(_least_tail(simulated) <= _least_tail(values[None])[0]))


def _least_tail(values: Array) -> Array:
    """The least pointwise probability of the empirical distribution over an even grid.

    The distribution is (samples, n).
    """
    places = np.arange(1, POINTS) / POINTS
    count = values.shape[1]
    below = np.sum(values[:, :, None] <= places, axis=1)
    return np.minimum(binom.cdf(below, count, places), binom.sf(below - 1, count, places)).min(
        axis=1
    )


def table(draws: int, seed: int) -> Iterator[str]:
    """The lines of the page's table."""
    yield (
        "| prior | noise; sd of a step | weight | 50 % | 80 % | 95 % | rms z | uniform, p | λ "
        "over the true one |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for name, penalty in PRIORS.items():
        for noise, step in SETTINGS.values():
            for chosen in (False, True):
                results = calibration(penalty, noise, step, chosen, draws, seed)
                quantiles = " / ".join(
                    f"{value:.2g}" for value in np.quantile(results.weights, (0.1, 0.5, 0.9))
                )
                figures = (
                    f"`{name}`",
                    f"{100 * noise:g} %; {100 * step:g} %",
                    "chosen" if chosen else "known",
                    *(f"{100 * share:.1f}" for share in results.coverage),
                    f"{np.sqrt(np.mean(results.scores**2)):.2f}",
                    ", ".join(f"{tail:.2f}" for tail in results.uniformity),
                    quantiles if chosen else "",
                )
                yield f"| {' | '.join(figures)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for line in table(given.draws, given.seed):
        print(line, flush=True)
