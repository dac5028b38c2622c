"""Errors that all frames share, from cells that nobody touched: under a wrong circuit they seem to move.

Errors z that baseline and frames share move the estimated log change of a cell by a = K_f U_f − K_b U_b times z, with U
as of `lampest.panel.systematic` and K the inverse of the readings' derivative. Over the cells that stand still, d = a z
+ noise, z ~ N(0, 1). The readings' own errors are N(0, e²). The posterior of e joins the evidence of the changes, with
moved cells chosen anew for each e (`lampest.estimate.changed_cells`), and the likelihood of the unloaded panel. The
still cells then leave a covariance of z. Errors too large for linear theory have e alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.cells_fit import FIT, CellsFit, cells_alone, fitted
from lampest.estimate.changed_cells import MIN_STILL_SHARE, Chosen, away_from_changed, select_changed
from lampest.files.levels import NOISE_REACH, SIGNIFICANCE, UNUSUAL
from lampest.panel.least_squares import SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.panel.systematic import HIDDEN_ERRORS, KNOWN_ERRORS, READING_ERROR, Possible, error_columns, recorded_share
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings

READING_ERRORS = np.geomspace(2.5e-4, 0.2, 30)  # of a reading's own that are tried, with equal odds for equal ratios
# Of the evidence of cells that touch a moved one: a skirt of lightly pressed cells gains 40 by an error of readings.
BESIDE_SHARE = 0.1
# In −2 ln evidence, from which on an error is named, and from which on bars allow for it. Of 60 recordings without one
# those of mouths and rods gain 2.0 at most, nearly all of them nothing; 0.2 % gains 2 to 60.
MIN_ERROR_GAIN, MIN_HINT_GAIN = 6.6, 2.2
LINEAR_LIMIT = 0.15  # of log r: so large an error moves cells by more than one per cent beside the straight line
LOADED_CHANGE = NOISE_REACH * LINEAR_LIMIT  # of log r, by which loads move cells, and errors within the limit do not


def possible_errors(
    scene: Scene, sizes: Systematic, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Possible | None:
    """Return what the still cells leave possible of shared errors; None where cells cannot say.

    resting (rows, columns), frames (frames, rows, columns) : with σ as it is to be taken.
    """

    def at_least(size: float) -> Systematic:
        return replace(sizes, reading_error=max(sizes.reading_error or 0.0, size) or None)

    if resting.sigma is None or resting.value.size > MAX_CELLS:
        return None
    fit = fitted(scene, resting, patient=True)
    if fit is None or fit.tail < SIGNIFICANCE:
        return Possible(at_least(_mean_square(_unloaded_costs(scene, resting))), None)
    moves, shape = CellChanges.of(scene, fit, frames, sizes, noise), resting.value.shape
    if moves is None:
        return None
    smoothed = replace(moves, noise=moves.noise + _smooth_loads(shape, len(frames.value)))
    costs, still = _error_costs(smoothed)
    likeliest, apart = float(READING_ERRORS[np.argmin(costs[1:])]), away_from_changed(still, shape)
    gain_apart = smoothed.cost_of(apart, 0.0) - smoothed.cost_of(apart, likeliest)
    gain = gain_apart + BESIDE_SHARE * (float(costs[0] - costs.min()) - gain_apart)
    size, certain = 0.0, gain > MIN_ERROR_GAIN
    if gain > MIN_HINT_GAIN:
        size = _mean_square(costs[1:] + _unloaded_costs(scene, resting))
        if size * moves.reach > LINEAR_LIMIT:
            return Possible(at_least(size), None, certain)
    assumed = at_least(size)
    root = None if still.mean() < MIN_STILL_SHARE else _possible(moves, assumed.reading_error or 0.0, shape)
    return Possible(assumed, root, certain)


def _of_frame(
    scene: Scene, fit: CellsFit, near: Array | None, sizes: Systematic, noise: FrameNoise | None
) -> list[Array]:
    """Return the covariance of one frame's log cells, and their response to shared errors.

    Parameters
    ----------
    near : array or None
        Unloaded cells (rows, columns) ohm; None: the frame is the unloaded mean.

    Returns
    -------
    list of array
        Covariance (cells, cells); responses (cells, n) to hidden errors, to each reading's own of size 1, and to known
        errors.
    """
    error = fit.covariance
    at = fit if near is None else _steadied(scene, fit, near, error)
    if noise is not None:
        drawn = at.gain @ noise.columns(at.readings.value[None], baseline=near is None)
        error = error + drawn @ drawn.T
    measured, circuit = at.readings.value, scene.circuit
    network = circuit.network(at.cells, circuit.ties_of_parts(measured, scene.parts), scene.wiring)
    unit = replace(sizes, reading_error=1.0)
    groups = (HIDDEN_ERRORS, (READING_ERROR,), KNOWN_ERRORS)
    columns = (error_columns(errors, network, measured, scene, unit) for errors in groups)
    return [error, *map(at.response, columns)]


@dataclass(frozen=True, eq=False)
class CellChanges:
    """Changes of the log cells of all frames since rest.

    Attributes
    ----------
    change : array, shape (n,)
        Frame by frame.
    noise : array, shape (n, n)
        Covariance of the changes of still cells.
    a, own : array, shapes (n, k) and (n, cells)
        What hidden errors do to the changes, and each reading's own of size 1.
    reach : float
        Median standard deviation of log r of the unloaded cells under readings' own errors of 1.
    """

    change: Array
    noise: Array
    a: Array
    own: Array
    reach: float

    @classmethod
    def of(
        cls, scene: Scene, resting: CellsFit, frames: Readings, sizes: Systematic, noise: FrameNoise | None
    ) -> "CellChanges | None":
        """Return the changes of all cells from the unloaded panel to the frames; None where one is not fitted."""
        if not resting.small:
            return None
        base, size, count = _of_frame(scene, resting, None, sizes, noise), resting.cells.size, len(frames.value)
        change, parts = [], []
        for number in range(count):
            frame = frames[number]
            fit = fitted(scene, frame, resting.cells) or fitted(scene, frame, patient=True)
            if fit is None or not fit.small:
                return None
            error, *columns = _of_frame(scene, fit, resting.cells, sizes, noise)
            change.append(np.log(fit.cells / resting.cells).ravel())
            parts.append([error, *(of_frame - at_rest for of_frame, at_rest in zip(columns, base[1:], strict=True))])
        covariance = np.tile(base[0], (count, count))
        for number, (error, *_) in enumerate(parts):
            part = slice(number * size, (number + 1) * size)
            covariance[part, part] += error + ASSUMED.creep**2 * np.eye(size) + ASSUMED.common_change**2
        hidden, own, known = (np.vstack(columns) for columns in list(zip(*parts, strict=True))[1:])
        reach = float(np.median(np.linalg.norm(base[2], axis=1)))
        return cls(np.concatenate(change), covariance + known @ known.T, hidden, own, reach)

    def columns(self, size: float) -> Array:
        """Return what standard normal errors do to the changes (n, k + cells), if each reading errs by so much."""
        return np.hstack([self.a, size * self.own]) if size else self.a

    def covariance(self, size: float) -> Array:
        """Return the covariance of the changes of still cells, if each reading errs by so much on its own."""
        columns = self.columns(size)
        return np.asarray(self.noise + columns @ columns.T)

    def cost_of(self, still: Chosen, size: float) -> float:
        """Return −2 ln likelihood of the changes of still cells alone."""
        covariance, change = self.covariance(size)[np.ix_(still, still)], self.change[still]
        return float(change @ np.linalg.solve(covariance, change) + np.linalg.slogdet(covariance)[1])

    def still(self, size: float, begun: Chosen | None = None) -> tuple[float, Chosen]:
        """Return −2 ln evidence of such an error, and which cells stand still.

        begun : those that the search begins with; None: the half that changed least, for a shared error may explain
        a smooth load as well as its cells do.
        """
        away = np.abs(self.change - np.median(self.change))
        begun = away <= np.median(away) if begun is None else begun
        precision = np.linalg.inv(self.covariance(size))
        slope = precision @ self.change
        score, moved = select_changed(slope, precision, [~begun], np.abs(self.change) >= LOADED_CHANGE)
        return score + float(self.change @ slope - np.linalg.slogdet(precision)[1]), ~moved


def _smooth_loads(shape: tuple[int, ...], frames: int) -> Array:
    """(n, n) covariance of changes of log r of a load's skirt: smooth from cell to cell, free in every frame."""
    row, column = (index.ravel() for index in np.indices(shape))
    square = (row[:, None] - row) ** 2 + (column[:, None] - column) ** 2
    return np.kron(np.eye(frames), ASSUMED.skirt**2 * np.exp(-square / (2 * ASSUMED.skirt_cells**2)))


def _error_costs(moves: CellChanges) -> tuple[Array, Chosen]:
    """Return −2 ln evidence of no error and of READING_ERRORS, (1 + errors), and the still cells of the likeliest.

    Beyond the linear limit changes say nothing more. The still cells change little from size to size.
    """
    sizes = [0.0, *(size for size in READING_ERRORS[2::2] if size * moves.reach <= LINEAR_LIMIT)]
    costs, selections, start = list[float](), list[Chosen](), None
    for size in sizes:
        cost, start = moves.still(size, start)
        costs.append(cost)
        selections.append(start)
    between = np.interp(np.log(READING_ERRORS), np.log(sizes[1:]), costs[1:])
    return np.concatenate([costs[:1], between]), selections[int(np.argmin(costs))]


def _mean_square(costs: Array) -> float:
    """√E[e²] from −2 log likelihoods of READING_ERRORS: larger than the likeliest where the size is uncertain."""
    odds = np.exp(-(costs - costs.min()) / 2)
    return float(np.sqrt(odds @ np.square(READING_ERRORS) / odds.sum()))


def _possible(moves: CellChanges, size: float, shape: tuple[int, ...]) -> Array:
    """Return a root (n, n) of E[z zᵀ], given the still cells: covariance and mean of z.

    No cell stands still under a load, however smooth it is.
    """
    still = away_from_changed(moves.still(size)[1], shape)
    part = moves.columns(size)[still]
    weight = np.linalg.solve(moves.covariance(size)[np.ix_(still, still)], part)
    mean = weight.T @ moves.change[still]
    second = np.eye(len(mean)) - part.T @ weight + np.outer(mean, mean)
    values, vectors = np.linalg.eigh((second + second.T) / 2)
    # Lower triangular: the columns behind those of common errors are the readings' own errors beside them.
    return np.asarray(np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T)


def _steadied(scene: Scene, fit: CellsFit, near: Array, error: Array) -> CellsFit:
    """Return the fit with cells that did not clearly move where they were, and the readings that these would give."""
    change = np.log(fit.cells / near)
    middle = np.median(change)
    moved = np.abs(change - middle) > UNUSUAL * np.sqrt(2 * np.diag(error)).reshape(change.shape)
    data = cells_alone().data(fit.readings.alone(), Background(scene))
    network = data.network(0, np.where(moved, fit.cells, near * np.exp(middle)))
    return CellsFit.at(data, replace(fit.readings, value=network.reading()), network)


def _unloaded_costs(scene: Scene, resting: Readings) -> Array:
    """Return −2 log likelihood of READING_ERRORS, the least of them 0, where unloaded cells are log r ~ N(μ, s²).

    About the most probable u, where t = y − f(u) + J u, readings are linear in the cells. With τ² = σ² + (e y')², where
    y' is the reading's derivative by its recorded value's logarithm, and AAᵀ = QΛQᵀ of A = J/τ,

        −2 log p(y | e, s) = Σ a²/v − (Σ a b/v)²/Σ(b²/v) + Σ log v + log Σ(b²/v) + Σ log τ²,   v = 1 + s²λ,

    with a = Qᵀ t/τ and b = Qᵀ A 1. The point is that of the likeliest of a few errors first, then of all. Where cells
    are not alike, e comes out too large rather than too small. Raises the errors of arithmetic.
    """
    assert resting.sigma is not None
    data, plain = cells_alone().data(resting.alone(), Background(scene)), resting.plain.ravel()
    share, scatters = np.abs(recorded_share(resting.value, scene)), np.square(ASSUMED.scatters)[:, None]
    cells, costs = np.log(data.uniform_start[0]), np.zeros((1, len(ASSUMED.scatters)))
    for errors, before in ((READING_ERRORS[1::4], READING_ERRORS[-1:]), (READING_ERRORS, READING_ERRORS[1::4])):
        row, column = np.unravel_index(np.argmin(costs), costs.shape)
        deviation = np.where(resting.plain, np.hypot(resting.sigma, before[row] * share), np.inf)
        cells, jacobian = _most_probable(data, resting.value, deviation, ASSUMED.scatters[column], cells)
        missed = resting.value - data.network(0, np.exp(cells)).reading()
        target = missed.ravel() + jacobian @ cells.ravel()
        costs = np.empty((len(errors), len(ASSUMED.scatters)))
        for number, error in enumerate(errors):
            tau = np.hypot(resting.sigma, error * share).ravel()[plain]
            scaled = jacobian[plain] / tau[:, None]
            values, turned = np.linalg.eigh(scaled @ scaled.T)
            apart, ones = turned.T @ (target[plain] / tau), turned.T @ scaled.sum(axis=1)
            grown = 1 + scatters * np.maximum(values, 0.0)
            mean = (ones**2 / grown).sum(axis=1)
            squares = (apart**2 / grown).sum(axis=1) - (apart * ones / grown).sum(axis=1) ** 2 / mean
            costs[number] = squares + np.log(grown).sum(axis=1) + np.log(mean) + 2 * np.log(tau).sum()
    together = -2 * np.logaddexp.reduce(-costs / 2, axis=1)
    return np.asarray(together - together.min())


def _most_probable(data: Data, value: Array, deviation: Array, spread: float, start: Array) -> tuple[Array, Array]:
    """(u (rows, columns), J (readings, cells)) from readings and their τ, infinite where there is none."""
    count = value.size
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

    position = replace(FIT, evaluations=25, share=0.0).minimum(model, start.ravel(), (lower, upper)).position
    cells = position.reshape(value.shape)
    return cells, data.network(0, np.exp(cells)).sensitivity() * free.ravel()
