"""What cells that nobody touched tell of errors that all frames share: under a wrong circuit they seem to move.

Errors z that baseline and frames share move the estimated log change of a cell by a = K_f U_f − K_b U_b times z, with U
as of `lampest.panel.hidden` and K the inverse of the readings' derivative. Over the cells that stand still,

    d = a z + noise,   z ~ N(0, 1),   of which each reading's own error ~ N(0, e²).

That gives what is left possible of z, and e where it is larger than zero beyond chance, by its marginal likelihood.
Which cells stand still is found on the way: a cell that moved has any change of the order of 1 instead, and cells that
touch it are not asked in the end. Errors so large that no cells explain the unloaded panel, or that cells answer to
them along a curve, have their size from `lampest.estimate.noise.alike`, and still cells then narrow nothing.
"""

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lampest.estimate.model_check.cells_fit import MOST_CELLS, fitted
from lampest.estimate.noise.alike import Alike
from lampest.estimate.noise.moves import Moves, moves_of
from lampest.panel.hidden import Possible
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Systematic
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import Readings

SIZES = tuple(float(size) for size in np.geomspace(5e-4, 0.2, 12))  # of a reading's own error that are tried
FINE = np.geomspace(SIZES[0] / 2, SIZES[-1], 30)  # the same, once cells are chosen
UNEXPLAINED = 1e-4  # P(χ²), as in the check of the circuit
GAIN = 15.0  # −2 log likelihood that an error of its own must gain: a cell that moved a little gains 8 to 12
MOVED = 2.8  # −2 log of the odds that a cell moved: one in five, and then by about 1 in the logarithm
FEWEST = 0.3  # of the cells must stand still: else a load covers the panel and nothing is told
SEEN = 6.6  # the same, of cells once chosen: χ² with one degree of freedom, once in a hundred
HINT = 0.5  # the same, from which on bars allow for what may be chance: where nothing is, one in four is so large
LARGER = 4.0  # the same, of a larger one, once something of the kind is there: two standard deviations
AGAIN = 3  # times that cells are chosen by the size that they tell
STRAIGHT = 0.15  # of log r: so large an error moves cells by more than one per cent beside the straight line
ROUNDS = 15  # of choosing cells; the choice is settled after a handful


Chosen = NDArray[np.bool_]


def unseen(
    scene: Scene, sizes: Systematic | None, resting: Readings, frames: Readings, noise: FrameNoise | None
) -> Possible | None:
    """What the still cells leave possible; None where nothing is possible, or nobody can be asked.

    resting (rows, columns), frames (frames, rows, columns) : with σ as it is to be taken.
    """
    if sizes is None or resting.sigma is None or resting.value.size > MOST_CELLS or not len(frames.value):
        return None
    fit = fitted(scene, resting, patient=True)
    if fit is None or fit.tail < UNEXPLAINED:
        return Possible(with_reading_error(sizes, Alike.of(scene, resting).size), None)
    moves = moves_of(scene, sizes, resting, frames, noise)
    if moves is None:
        return None
    size, still = own_error(moves, resting.value.shape)
    apart = apart_from_moved(still, resting.value.shape)
    sure = size > 0
    size = size or hinted_error(moves, apart)
    if sure:
        alike, straight = Alike.of(scene, resting), STRAIGHT / moves.reach
        if size > straight or alike.contradicts(size) > LARGER:
            return Possible(with_reading_error(sizes, max(alike.size, min(size, straight))), None)
    told = with_reading_error(sizes, size)
    if still.mean() < FEWEST:
        return Possible(told, None, sure)
    return Possible(told, possible(moves, told.reading_error or 0.0, apart), sure)


def with_reading_error(sizes: Systematic, size: float) -> Systematic:
    """The sizes with an error of each reading that is at least so large: what was seen holds what was told."""
    return replace(sizes, reading_error=max(sizes.reading_error or 0.0, size) or None)


def own_error(moves: Moves, shape: tuple[int, ...]) -> tuple[float, Chosen]:
    """(e, which cells stand still): 0 unless it gains with cells chosen anew for each size, and with those of the last.

    Chosen anew, a large error alone would explain cells that moved; one beyond the straight line is asked for by the
    largest on it.
    """
    tried = (0.0, *(size for size in SIZES if size * moves.reach <= STRAIGHT))
    costs = {size: still_cells(moves.change, moves.covariance(size)) for size in tried}
    size = min(costs, key=lambda size: costs[size][0])
    if costs[size][0] <= costs[0.0][0] - GAIN:
        for _ in range(AGAIN):
            _, still = still_cells(moves.change, moves.covariance(min(size, STRAIGHT / moves.reach)))
            size, gained = size_of(moves, apart_from_moved(still, shape))
        if gained > SEEN:
            return size, still
    return 0.0, costs[0.0][1]


def hinted_error(moves: Moves, still: Chosen) -> float:
    """e where the still cells make one likelier than none, though that may be chance; else 0."""
    size, gained = size_of(moves, still)
    return size if gained > HINT and size * moves.reach <= STRAIGHT else 0.0


def size_of(moves: Moves, still: Chosen) -> tuple[float, float]:
    """(√E[e²] of readings' own errors by the marginal likelihood of the still cells, −2 log of what it gains).

    The root of the mean square is larger than the likeliest where the size is uncertain.
    """
    part, change = np.ix_(still, still), moves.change[still]

    def cost(size: float) -> float:
        covariance = moves.covariance(size)[part]
        return float(change @ np.linalg.solve(covariance, change) + np.linalg.slogdet(covariance)[1])

    costs = np.array([cost(size) for size in FINE])
    odds = np.exp(-(costs - costs.min()) / 2)
    return float(np.sqrt(odds @ np.square(FINE) / odds.sum())), cost(0.0) - float(costs.min())


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


def apart_from_moved(still: Chosen, shape: tuple[int, ...]) -> Chosen:
    """The still cells of all frames, flat, without those that touch one that moved: a load does not end at a cell."""
    moved = np.pad(~still.reshape(-1, *shape), ((0, 0), (1, 1), (1, 1)))
    touched = sliding_window_view(moved, (3, 3), axis=(1, 2)).any(axis=(-2, -1))
    apart = still & ~touched.ravel()
    return apart if apart.mean() >= FEWEST else still


def said_of_readings(size: float, known: float) -> str:
    """What still cells say of errors of single readings, beyond what the scene knows of them; ''."""
    if size <= known:
        return ""
    return (
        f"cells that nobody touched seem to move as if each reading were off by {100 * size:.2g} %, the same in all "
        "frames, which error bars allow for"
    )
