"""What cells that nobody touched tell of errors that all frames share: under a wrong circuit they seem to move.

Errors z that baseline and frames share move the estimated log change of a cell by a = K_f U_f − K_b U_b times z, with U
as of `lampest.panel.hidden` and K the inverse of the readings' derivative. Over the cells that stand still,

    d = a z + noise,   z ~ N(0, 1),   of which each reading's own error ~ N(0, e²).

That gives what is left possible of z, and e by maximum likelihood where it is larger than zero beyond chance. Which
cells stand still is found on the way: a cell that moved has any change of the order of 1 instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.cells_fit import MOST_CELLS, CellsFit, fitted
from lampest.panel.hidden import Possible, hidden_columns
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import Readings

SIZES = tuple(float(size) for size in np.geomspace(5e-4, 0.2, 12))  # of a reading's own error that are tried
COARSE = (0.003, 0.01, 0.02, 0.04, 0.08, 0.15)  # of an error without which no cells give the readings
HIDDEN = 2.5  # cells take up most of an error: of 3 and of 10 % they left unexplained what 1 and 4 % would explain
UNEXPLAINED = 1e-4  # P(χ²), as in the check of the circuit
MEDIAN = 0.4549  # of χ² with one degree of freedom
GAIN = 15.0  # −2 log likelihood that an error of its own must gain: a cell that moved a little gains 8 to 12
MOVED = 2.8  # −2 log of the odds that a cell moved: one in five, and then by about 1 in the logarithm
FEWEST = 0.3  # of the cells must stand still: else a load covers the panel and nothing is told
ROUNDS = 15  # of choosing cells; the choice is settled after a handful
CREEP = 3e-3  # of log r, by which films move on their own, as in the check of the circuit
TOGETHER = 0.05  # of log r, by which all cells may change with temperature


Chosen = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Moves:
    """Of the cells of all frames asked: change (n), covariance (n, n) of its noise, a (n, k), and own (n, cells)."""

    change: Array
    noise: Array
    a: Array
    own: Array

    def covariance(self, size: float) -> Array:
        """Of changes of still cells, if each reading errs by so much on its own."""
        return np.asarray(self.noise + self.a @ self.a.T + size**2 * self.own @ self.own.T)

    def with_column(self, column: Array) -> "Moves":
        """With one more error that the frames do not share with the baseline, (n, 1), behind the others."""
        return replace(self, a=np.hstack([self.a, column]))


def unseen(
    scene: Scene, sizes: Systematic | None, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Possible | None:
    """What the still cells leave possible; None where nothing is possible, or nobody can be asked.

    resting (rows, columns), frames (frames, rows, columns) : with σ as it is to be taken.
    """
    if sizes is None or resting.sigma is None or resting.value.size > MOST_CELLS or not len(frames.value):
        return None
    unexplained = size_that_explains(scene, resting)
    if unexplained:
        told = replace(sizes, reading_error=float(np.hypot(sizes.reading_error or 0.0, unexplained)))
        return Possible(told, None)
    moves = moves_of(scene, sizes, resting, frames, noise)
    if moves is None:
        return None
    costs = {size: still_cells(moves.change, moves.covariance(size)) for size in (0.0, *SIZES)}
    best = min(costs, key=lambda size: costs[size][0])
    if costs[best][0] > costs[0.0][0] - GAIN:
        best = 0.0
    still = costs[best][1]
    size = spread_of(moves, still) if best else 0.0
    told = replace(sizes, reading_error=float(np.hypot(sizes.reading_error or 0.0, size)) or None)
    if still.mean() < FEWEST:
        return Possible(told, None)
    return Possible(told, possible(moves, told.reading_error or 0.0, still))


def size_that_explains(scene: Scene, resting: Readings) -> float:
    """HIDDEN times the least error of single readings with which cells explain the unloaded panel; 0 without any."""
    assert resting.sigma is not None
    for size in (0.0, *COARSE):
        fit = fitted(scene, replace(resting, sigma=np.hypot(resting.sigma, size * resting.value)), patient=not size)
        if fit is not None and fit.tail >= UNEXPLAINED:
            return HIDDEN * size
    return HIDDEN * COARSE[-1]


def spread_of(moves: Moves, still: Chosen) -> float:
    """The size of readings' own errors with which the median change of still cells is as likely as not.

    The likelihood says whether there is such an error. Of its size it says too much: where a reading's error is large
    the answer of cells is no longer linear, and few cells that moved far decide.
    """
    change = moves.change[still] - np.median(moves.change[still])
    own = (moves.own[still] ** 2).sum(axis=1)
    rest = np.diag(moves.covariance(0.0))[still] - TOGETHER**2
    sizes = np.geomspace(SIZES[0] / 2, 2 * SIZES[-1], 200)
    middle = np.array([np.median(change**2 / (rest + size**2 * own)) for size in sizes])
    return float(sizes[np.argmin(np.abs(middle - MEDIAN))])


def possible(moves: Moves, size: float, still: Chosen) -> Array:
    """A root (n, n) of E[z zᵀ], given the still cells: what is left open of z, and where it seems to be.

    Estimates are not moved by what z seems to be; their bars reach as far.
    """
    columns = np.hstack([moves.a, size * moves.own]) if size else moves.a
    part = columns[still]
    weight = np.linalg.solve(moves.covariance(size)[np.ix_(still, still)], part)
    mean = weight.T @ moves.change[still]
    second = np.eye(columns.shape[1]) - part.T @ weight + np.outer(mean, mean)
    values, vectors = np.linalg.eigh((second + second.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def still_cells(change: Array, covariance: Array) -> tuple[float, Chosen]:
    """(−2 log likelihood, which stand still): each cell where it is likelier, given those that stand still.

    A cell that moved has a change of variance 1, and costs MOVED. It begins with the half that changed least, and ends
    where nothing is better than before.
    """
    middle = np.median(change)
    away = np.abs(change - middle)
    still = away <= np.median(away)
    best: tuple[float, Chosen] = (np.inf, still)
    for _ in range(ROUNDS):
        cost = likelihood(change, covariance, still)
        if cost >= best[0]:
            break
        best = cost, still
        within = np.linalg.inv(covariance[np.ix_(still, still)])
        pull = within @ change[still]
        across = covariance[:, still]
        miss, variance = change - across @ pull, np.diag(covariance) - np.einsum("ij,ij->i", across @ within, across)
        miss[still], variance[still] = pull / np.diag(within), 1 / np.diag(within)
        variance = np.maximum(variance, 1e-300)
        still = miss**2 / variance + np.log(variance) < MOVED + change**2
        if not still.any():
            break
    return best


def likelihood(change: Array, covariance: Array, still: Chosen) -> float:
    """−2 log of the density of all changes, of which some stand still."""
    part = covariance[np.ix_(still, still)]
    chi_square = change[still] @ np.linalg.solve(part, change[still])
    moved = change[~still]
    return float(chi_square + np.linalg.slogdet(part)[1] + (moved**2).sum() + MOVED * len(moved))


def moves_of(
    scene: Scene, sizes: Systematic, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Moves | None:
    """The changes of all cells between the unloaded panel and the frames; None where a fit fails."""
    base = asked(scene, resting, None, sizes, noise, resting=True)
    if base is None:
        return None
    fits = [asked(scene, frame, base.fit.cells, sizes, noise, resting=False) for frame in each(frames)]
    others = [one for one in fits if one is not None]
    if len(others) < len(fits):
        return None
    return moves_between(base, others)


def moves_between(base: "Asked", others: "Sequence[Asked]") -> Moves:
    """The changes of all cells from the unloaded panel to the frames."""
    cells = base.fit.cells.size
    change = np.concatenate([np.log(one.fit.cells / base.fit.cells).ravel() for one in others])
    covariance = np.tile(base.error, (len(others), len(others)))
    for number, one in enumerate(others):
        part = slice(number * cells, (number + 1) * cells)
        covariance[part, part] += one.error + CREEP**2 * np.eye(cells) + TOGETHER**2
    told = np.vstack([one.told - base.told for one in others])
    return Moves(
        change,
        covariance + told @ told.T,
        np.vstack([one.hidden - base.hidden for one in others]),
        np.vstack([one.own - base.own for one in others]),
    )


@dataclass(frozen=True, eq=False)
class Asked:
    """One frame's fit, gain (cells, readings), covariance of its error, and what shared errors do to its log cells."""

    fit: CellsFit
    gain: Array
    error: Array
    hidden: Array
    own: Array
    told: Array

    def answer(self, columns: Array) -> Array:
        """(cells, n): what errors of the readings (n, rows, columns) do to log cells."""
        return np.asarray(self.gain @ columns.reshape(len(columns), self.gain.shape[1]).T)


def asked(
    scene: Scene, readings: Readings, near: Array | None, sizes: Systematic, noise: FrameNoise | None, resting: bool
) -> Asked | None:
    """One frame; None where it is not fitted. near : cells to begin at. resting : whether it is the unloaded mean."""
    fit = fitted(scene, readings, near, patient=near is None) or fitted(scene, readings, patient=True)
    if fit is None or fit.sensitivity is None:
        return None
    assert readings.sigma is not None
    error = np.linalg.inv(fit.information)
    gain = error @ (fit.sensitivity.T / readings.sigma.ravel())
    if noise is not None:
        drawn = gain @ noise.columns(readings.value[None], resting)
        error = error + drawn @ drawn.T
    here = fit.cells, readings.value
    channels = (sizes.reference_tolerance / np.sqrt(3), sizes.channel_spread_ohm)
    nothing = np.zeros((len(error), 0))
    blank = Asked(fit, gain, error, nothing, nothing, nothing)
    return replace(
        blank,
        hidden=blank.answer(hidden_columns(*here, scene, replace(sizes, reading_error=None))),
        own=blank.answer(hidden_columns(*here, scene, Systematic(reading_error=1.0))),
        told=blank.answer(scene.circuit.shared_errors(*here, scene, *channels)),
    )


def said_of_readings(size: float, known: float) -> str:
    """What still cells say of errors of single readings, beyond what the scene knows of them; ''."""
    if size <= known:
        return ""
    return (
        f"cells that nobody touched seem to move as if each reading were off by {100 * size:.2g} %, the same in all "
        "frames, which error bars allow for"
    )


def each(frames: Readings) -> list[Readings]:
    """One after the other, (rows, columns) each."""
    return [frames[number] for number in range(len(frames.value))]
