"""Estimation of errors that all frames share, from the apparent motion of cells that nobody touched.

Errors z ~ N(0, 1) that the unloaded panel b and a frame f share change the estimated log cells by a z, with

    a = K_f U_f − K_b U_b,

where U is the response of the readings to the errors (`lampest.panel.systematic`), and K the inverse of the readings'
Jacobian. Over the still cells d = a z + noise. Each reading has an error of its own, N(0, e²). The posterior of e
combines the evidence of the changes, with moved cells selected for each e (`lampest.estimate.changed_cells`), and the
likelihood of the unloaded panel. Given e, the still cells determine the posterior of z. Of errors that are too large
for linear theory only e is estimated.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.cells_fit import FIT, CellsFit, cells_alone, fitted
from lampest.estimate.changed_cells import MIN_STILL_SHARE, Changes, Chosen, away_from_changed
from lampest.files.levels import NOISE_REACH, SIGNIFICANCE, UNUSUAL
from lampest.panel.least_squares import SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.panel.systematic import HIDDEN_ERRORS, KNOWN_ERRORS, READING_ERROR, Possible, error_columns, recorded_share
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings

READING_ERRORS = np.geomspace(2.5e-4, 0.2, 30)  # tried values of e, with a prior that is uniform in ln e
# Weight of the evidence of cells adjacent to moved ones: a skirt of lightly pressed cells gains 40 by an error e.
BESIDE_SHARE = 0.1
# Gains in −2 ln evidence from which an error is named, and from which error bars include it. In 60 recordings without
# an error those of mouths and rods gain 2.0 at most, and nearly all of them nothing; an error of 0.2 % gains 2 to 60.
MIN_ERROR_GAIN, MIN_HINT_GAIN = 6.6, 2.2
LINEAR_LIMIT = 0.15  # of log r: the second order of a larger error moves cells by more than one per cent
LOADED_CHANGE = NOISE_REACH * LINEAR_LIMIT  # of log r: only loads move cells by more, errors within the limit do not


def possible_errors(
    scene: Scene, sizes: Systematic, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Possible | None:
    """Return the shared errors that the still cells leave possible; None where the cells do not determine them.

    Parameters
    ----------
    scene : Scene
    sizes : Systematic
        Prior standard deviations of the errors.
    resting, frames : Readings
        Mean of the unloaded frames (rows, columns), and loaded frames (frames, rows, columns), with their final σ.
    noise : FrameNoise or None
        Errors that the readings of a frame share.
    """

    def at_least(size: float) -> Systematic:
        return replace(sizes, reading_error=max(sizes.reading_error or 0.0, size) or None)

    if resting.sigma is None or resting.value.size > MAX_CELLS:
        return None
    fit = fitted(scene, resting, patient=True)
    # No cells explain the unloaded panel: e is estimated from its likelihood alone.
    if fit is None or fit.tail < SIGNIFICANCE:
        return Possible(at_least(_mean_square(_unloaded_costs(scene, resting))), None)
    moves, shape = shared_changes(scene, fit, frames, sizes, noise), resting.value.shape
    if moves is None:
        return None
    # Evidence of e. The prior of smooth loads keeps a load's skirt from being taken for an error of the readings.
    smoothed = replace(moves, noise=moves.noise + _smooth_loads(shape, len(frames.value)))
    costs, still = _error_costs(smoothed)
    likeliest, distant = float(READING_ERRORS[np.argmin(costs[1:])]), away_from_changed(still, shape)
    gain_apart = smoothed.changes(0.0).cost_of(distant) - smoothed.changes(likeliest).cost_of(distant)
    gain = gain_apart + BESIDE_SHARE * (float(costs[0] - costs.min()) - gain_apart)
    # Posterior mean square of e, from the changes and the unloaded panel together.
    size = _mean_square(costs[1:] + _unloaded_costs(scene, resting)) if gain > MIN_HINT_GAIN else 0.0
    assumed, certain = at_least(size), gain > MIN_ERROR_GAIN
    if size * moves.reach > LINEAR_LIMIT or still.mean() < MIN_STILL_SHARE:
        return Possible(assumed, None, certain)
    # Neighbours of moved cells are left out, because a load has a skirt.
    changes = moves.changes(assumed.reading_error or 0.0)
    mean, covariance = changes.posterior(away_from_changed(_still(changes)[1], shape))
    second = covariance + np.outer(mean, mean)
    values, vectors = np.linalg.eigh((second + second.T) / 2)
    # Lower triangular root of E[z zᵀ]: the columns behind those of common errors are the readings' own errors.
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T
    return Possible(assumed, root, certain)


@dataclass(frozen=True, eq=False)
class SharedChanges:
    """Changes of the log cells from the unloaded panel to the frames, n = frames · cells, by the size e of errors.

    Attributes
    ----------
    change : array, shape (n,)
        d, frame by frame.
    noise : array, shape (n, n)
        Covariance of d over still cells, without hidden errors.
    hidden, own : array, shapes (n, k) and (n, cells)
        Response of d to hidden errors, and to each reading's own error of size 1.
    reach : float
        Median standard deviation of log r of the unloaded cells if e = 1.
    """

    change: Array
    noise: Array
    hidden: Array
    own: Array
    reach: float

    def changes(self, size: float) -> Changes:
        """Return the changes with hidden errors and each reading's own error; `size` is e."""
        return Changes(self.change, self.noise, np.hstack([self.hidden, size * self.own]) if size else self.hidden)


def shared_changes(
    scene: Scene, resting: CellsFit, frames: Readings, sizes: Systematic, noise: FrameNoise | None
) -> SharedChanges | None:
    """Return the changes from the unloaded panel to the frames; None where the fit of a frame fails.

    Parameters
    ----------
    scene : Scene
    resting : CellsFit
        Fit of the unloaded panel.
    frames : Readings
        (frames, rows, columns).
    sizes : Systematic
        Standard deviations of the errors.
    noise : FrameNoise or None
        Errors that the readings of a frame share.
    """
    unit = replace(sizes, reading_error=1.0)

    def linearised(fit: CellsFit, error: Array, *, baseline: bool) -> list[Array]:
        """Return the covariance of the log cells, and their response K U to hidden, own and known errors."""
        if noise is not None:
            drawn = fit.gain @ noise.columns(fit.readings.value[None], baseline=baseline)
            error = error + drawn @ drawn.T
        groups = (HIDDEN_ERRORS, (READING_ERROR,), KNOWN_ERRORS)
        columns = (error_columns(errors, fit.network, fit.readings.value, scene, unit) for errors in groups)
        return [error, *map(fit.response, columns)]

    base = linearised(resting, resting.covariance, baseline=True)
    size, count, change, parts = resting.cells.size, len(frames.value), [], []
    # All changes share the error of the unloaded panel; every frame adds its own error, creep and a common change.
    covariance = np.tile(base[0], (count, count))
    for number in range(count):
        frame = frames[number]
        fit = fitted(scene, frame, resting.cells) or fitted(scene, frame, patient=True)
        if fit is None:
            return None
        error, *columns = linearised(_steadied(scene, fit, resting.cells), fit.covariance, baseline=False)
        change.append(np.log(fit.cells / resting.cells).ravel())
        parts.append([of_frame - at_rest for of_frame, at_rest in zip(columns, base[1:], strict=True)])
        part = slice(number * size, (number + 1) * size)
        covariance[part, part] += error + ASSUMED.creep**2 * np.eye(size) + ASSUMED.common_change**2
    hidden, by_reading, known = map(np.vstack, zip(*parts, strict=True))
    reach = float(np.median(np.linalg.norm(base[2], axis=1)))
    return SharedChanges(np.concatenate(change), covariance + known @ known.T, hidden, by_reading, reach)


def _still(changes: Changes, begun: Chosen | None = None) -> tuple[float, Chosen]:
    """Return −2 ln evidence, and the still cells.

    Parameters
    ----------
    changes : Changes
    begun : boolean array, shape (n,), optional
        Still cells that the search begins with; by default the half that changed least. Other starts are not tried,
        because a shared error may explain a smooth load as well as moved cells do.
    """
    deviation = np.abs(changes.change - np.median(changes.change))
    begun = deviation <= np.median(deviation) if begun is None else begun
    score, moved = changes.selected([~begun], np.abs(changes.change) >= LOADED_CHANGE)
    return score, ~moved


def _smooth_loads(shape: tuple[int, ...], frames: int) -> Array:
    """Return the covariance (n, n) of changes in a load's skirt: s² exp(−distance²/(2 ℓ²)) within each frame."""
    row, column = (index.ravel() for index in np.indices(shape))
    square = (row[:, None] - row) ** 2 + (column[:, None] - column) ** 2
    return np.kron(np.eye(frames), ASSUMED.skirt**2 * np.exp(-square / (2 * ASSUMED.skirt_cells**2)))


def _error_costs(moves: SharedChanges) -> tuple[Array, Chosen]:
    """Return −2 ln evidence of e = 0 and of READING_ERRORS, (1 + errors,), and the still cells of the most probable e.

    Every second error is computed, and the others are interpolated; each search begins with the still cells of the
    error before, because these change little. Beyond LINEAR_LIMIT the last value holds.
    """
    sizes = [0.0, *(size for size in READING_ERRORS[2::2] if size * moves.reach <= LINEAR_LIMIT)]
    costs, selections, start = list[float](), list[Chosen](), None
    for size in sizes:
        cost, start = _still(moves.changes(size), start)
        costs.append(cost)
        selections.append(start)
    between = np.interp(np.log(READING_ERRORS), np.log(sizes[1:]), costs[1:])
    return np.concatenate([costs[:1], between]), selections[int(np.argmin(costs))]


def _mean_square(costs: Array) -> float:
    """Return √E[e²] from −2 ln likelihoods of READING_ERRORS; it exceeds the most probable e where e is uncertain."""
    odds = np.exp(-(costs - costs.min()) / 2)
    return float(np.sqrt(odds @ np.square(READING_ERRORS) / odds.sum()))


def _steadied(scene: Scene, fit: CellsFit, near: Array) -> CellsFit:
    """Return the fit with the cells that did not clearly move set to the unloaded ones, and their model readings.

    The linearisation of frames and unloaded panel then agrees for still cells, whatever the noise.

    Parameters
    ----------
    scene : Scene
    fit : CellsFit
    near : array, shape (rows, columns)
        Unloaded cells, ohm; a common factor on all cells remains.
    """
    change = np.log(fit.cells / near)
    middle = np.median(change)
    moved = np.abs(change - middle) > UNUSUAL * np.sqrt(2 * np.diag(fit.covariance)).reshape(change.shape)
    data = cells_alone().data(fit.readings.alone(), Background(scene))
    cells = np.where(moved, fit.cells, near * np.exp(middle))
    return CellsFit.at(scene, data, replace(fit.readings, value=data.network(0, cells).reading()), cells)


def _unloaded_costs(scene: Scene, resting: Readings) -> Array:
    """Return −2 ln likelihood of READING_ERRORS, up to a constant, if the unloaded cells are log r ~ N(μ, s²).

    The readings are linearised at the most probable log cells u, with t = y − f(u) + J u. Let τ² = σ² + (e y')², where
    y' is the derivative of a reading with respect to the logarithm of its recorded value, and A = J/τ, A Aᵀ = QΛQᵀ:

        −2 log p(y | e, s) = Σ a²/v − (Σ a b/v)²/Σ(b²/v) + Σ log v + log Σ(b²/v) + Σ log τ²,   v = 1 + s²λ,

    with a = Qᵀ t/τ and b = Qᵀ A 1. The likelihood is averaged over the scatters s of `ASSUMED`. u is first the point of
    the largest error, then that of the most probable one of a few errors. Where the cells are not alike, e is
    overestimated rather than underestimated. Raises the errors of `BROKEN`.
    """
    data, plain = cells_alone().data(resting.alone(), Background(scene)), resting.plain.ravel()
    share, scatters = np.abs(recorded_share(resting.value, scene)), np.square(ASSUMED.scatters)[:, None]
    cells, costs = np.log(data.uniform_start[0]), np.zeros((1, len(ASSUMED.scatters)))
    for errors, before in ((READING_ERRORS[1::4], READING_ERRORS[-1:]), (READING_ERRORS, READING_ERRORS[1::4])):
        row, column = np.unravel_index(np.argmin(costs), costs.shape)
        deviation = np.where(resting.plain, np.hypot(resting.known_sigma, before[row] * share), np.inf)
        cells, jacobian = _most_probable(data, resting.value, deviation, ASSUMED.scatters[column], cells)
        missed = resting.value - data.network(0, np.exp(cells)).reading()
        target = missed.ravel() + jacobian @ cells.ravel()
        costs = np.empty((len(errors), len(ASSUMED.scatters)))
        for number, error in enumerate(errors):
            tau = np.hypot(resting.known_sigma, error * share).ravel()[plain]
            scaled = jacobian[plain] / tau[:, None]
            values, turned = np.linalg.eigh(scaled @ scaled.T)
            projected, ones = turned.T @ (target[plain] / tau), turned.T @ scaled.sum(axis=1)
            # v = 1 + s²λ, (scatters, readings); `mean` is Σ b²/v, the precision of μ, which is integrated out
            grown = 1 + scatters * np.maximum(values, 0.0)
            mean = (ones**2 / grown).sum(axis=1)
            squares = (projected**2 / grown).sum(axis=1) - (projected * ones / grown).sum(axis=1) ** 2 / mean
            costs[number] = squares + np.log(grown).sum(axis=1) + np.log(mean) + 2 * np.log(tau).sum()
    # −2 ln Σ_s p(y | e, s): all scatters are equally probable
    marginal = -2 * np.logaddexp.reduce(-costs / 2, axis=1)
    return np.asarray(marginal - marginal.min())


def _most_probable(data: Data, value: Array, deviation: Array, spread: float, start: Array) -> tuple[Array, Array]:
    """Return the most probable log cells u and the Jacobian J of the readings there.

    They minimise Σ ((f(u) − y)/τ)² + Σ (u − mean u)²/s².

    Parameters
    ----------
    data : Data
    value, deviation : array, shape (rows, columns)
        y and τ; τ is infinite where there is no reading.
    spread : float
        s.
    start : array, shape (rows, columns)
        Log cells.

    Returns
    -------
    array, shape (rows, columns)
    array, shape (readings, cells)
    """
    count = value.size
    # (1 − 1 1ᵀ/n)/s: residuals of the prior, whose mean μ is free
    unlike = (np.eye(count) - 1 / count) / spread
    free = data.lower[0] < data.upper[0]
    lower, upper = (
        np.where(free, far, bound[0]).ravel() for far, bound in zip((-np.inf, np.inf), data.log_bounds, strict=True)
    )

    def model(cells: Array) -> SumOfSquares:
        network = data.network(0, np.exp(cells).reshape(value.shape))
        missed = ((network.reading() - value) / deviation).ravel()
        jacobian = network.sensitivity() / deviation.reshape(-1, 1) * free.ravel()
        return SumOfSquares(np.concatenate([missed, unlike @ cells]), np.vstack([jacobian, unlike]))

    position, _ = replace(FIT, evaluations=25, share=0.0).minimum(model, start.ravel(), (lower, upper))
    cells = position.reshape(value.shape)
    return cells, data.network(0, np.exp(cells)).sensitivity() * free.ravel()
