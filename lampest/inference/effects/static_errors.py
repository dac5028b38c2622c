"""Estimation of shared errors from the apparent motion of cells without a load.

Errors z ~ N(0, 1) that the unloaded panel b and a frame f share change the estimated log cells by a
z, with

    a = K_f U_f − K_b U_b,

where U is the response of the readings to the errors (`lampest.panel.systematic`), and K the
inverse of the readings' Jacobian. Over the still cells d = a z + noise. Each reading has an error
of its own, N(0, e²). The posterior of e combines the evidence of the changes, with moved cells
selected for each e (`lampest.inference.changed_cells`), and the likelihood of the unloaded panel.
Given e, the still cells determine the posterior of z. Of errors that are too large for linear
theory only e is estimated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import NOISE_REACH, SIGNIFICANCE, UNUSUAL
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CellsFit, data_of_cells, fitted
from lampest.inference.changed_cells import MIN_STILL_SHARE, Changes, Chosen, away_from_changed
from lampest.inference.effects.effect import Gathered, SceneEffect, Unnamed
from lampest.inference.explanation import DOUBTFUL_GAIN
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides
from lampest.inference.unloaded_cells import READING_ERRORS, unloaded_costs
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, Systematic
from lampest.panel.systematic import (
    CHANNELS,
    READING_ERROR,
    REFERENCE,
    SHARED_ERRORS,
    Possible,
    SharedError,
    error_columns,
    estimated_errors,
    systematic_of,
)
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# None is as probable as all other errors together, whose prior is uniform in ln e, that of a
# scale.
PRIOR_ODDS = np.where(READING_ERRORS > 0, 0.5 / np.count_nonzero(READING_ERRORS), 0.5)
# Tried spreads of the channels, over the usual one.
CHANNEL_FACTORS = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
# Of log r: the second order of a larger error moves cells by more than one per cent.
LINEAR_LIMIT = 0.15
# Numbers of the tried values: those at which cells between rest and a load are selected, and those
# that show whether a finer scan is worth its time. Neighbours differ by a factor of 2.6. Below the
# most probable error −2 ln p falls with e², so that the smaller neighbour of one that counts keeps
# a quarter of its gain, and that is more than COARSE_GAIN.
EVERY_SECOND = np.arange(0, len(READING_ERRORS), 2)
COARSE = np.append(0, np.arange(1, len(READING_ERRORS), 4))
COARSE_GAIN = 3.0
# Tried sizes of a load's skirt, of log r. Always the largest would hide errors where no load has a
# skirt.
SKIRTS = ASSUMED.skirt * np.array([0.0, 0.03, 0.1, 0.3, 1.0])
# Of the unloaded readings that are values: with fewer, films look uneven (tests/golden/checks.py).
MIN_SHARE_READ = 0.9
# Of log r: only loads move cells by more, errors within the limit do not.
LOADED_CHANGE = NOISE_REACH * LINEAR_LIMIT


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Errors that all frames share, as a recording determines them.

    Attributes
    ----------
    possible : Possible
        Sizes and joint posterior.
    sizes : dict
        Field of `Systematic` → (size, standard deviation) of each error that was determined.
    undetermined : str
        The reason why the other estimated errors keep their prior, in words; '' where all are
        determined.
    """

    possible: Possible
    sizes: dict[str, tuple[float, float]]
    undetermined: str = ""


def shared_errors(
    scene: Scene, resting: Readings, loaded: Readings | None, noise: FrameNoise | None
) -> SharedErrors:
    """Return the errors that a scene calls `estimated`, from the unloaded panel and a loaded frame.

    One frame is enough: frames that are nearly equal count once, or the edges of a load that stands
    would look like an error that all frames share.

    Parameters
    ----------
    scene : Scene
    resting, loaded : Readings
        Mean of the unloaded frames, and a loaded frame or None, (rows, columns) each, with their
        final σ.
    noise : FrameNoise or None
        Errors that the readings of a frame share.
    """
    prior = systematic_of(scene) or Systematic()
    possible = Possible(prior, in_sigma=READING_ERROR.size(prior))
    if resting.sigma is None:
        reason = "the noise of the readings is unknown: name the readout's noise_lsb"
        return SharedErrors(possible, {}, reason)
    if resting.value.size > MAX_CELLS:
        reason = f"the panel has more than {MAX_CELLS} cells: estimate them on a part of it"
        return SharedErrors(possible, {}, reason)
    fit, moves = _fit_and_changes(scene, resting, loaded, noise)
    if moves is not None and CHANNELS.setting in moves.counts:
        factor = _channel_factor(scene, moves)
        moves = moves.with_channels(factor)
        prior = replace(prior, channel_spread_ohm=factor * CHANNELS.size(prior))
        possible = replace(possible, sizes=prior)
    own = SharedErrors(possible, {})
    if READING_ERROR.setting in estimated_errors(scene):
        costs = unloaded_costs(scene, resting, fit, READING_ERRORS)
        odds = _odds(costs + _error_costs(scene, moves, EVERY_SECOND))
        # √E[e²] exceeds the most probable e where e is uncertain
        size = float(np.sqrt(odds @ np.square(READING_ERRORS)))
        possible = Possible(replace(prior, reading_error=size), in_sigma=_median(odds))
        own = SharedErrors(possible, {READING_ERROR.setting: _moments(odds)})
    if moves is not None:
        return _with_common_errors(own, moves, prior, scene)
    if loaded is None:
        return _undetermined(own, "no frame is loaded", scene)
    return _undetermined(own, "no cells explain the unloaded frames or the loaded ones", scene)


def significant_reading_error(
    scene: Scene, resting: Readings, loaded: Readings | None, noise: FrameNoise | None
) -> tuple[float, float] | None:
    """Return the size of each reading's own error; None where it is insignificant.

    Every fourth value of e comes first. The others are tried where one of these is more probable
    than none.

    Parameters
    ----------
    scene : Scene
        Calls the error `estimated`.
    resting, loaded, noise
        As those of `shared_errors`.

    Returns
    -------
    (size, sd) : tuple of float, or None
        Standard deviation of log(recorded), and that of the estimate.
    """
    if resting.sigma is None or resting.value.size > MAX_CELLS:
        return None
    fit, moves = _fit_and_changes(scene, resting, loaded, noise)
    coarse = unloaded_costs(scene, resting, fit, READING_ERRORS[COARSE])
    coarse = coarse + _error_costs(scene, moves, COARSE)[COARSE]
    if coarse[0] - coarse.min() < COARSE_GAIN:
        return None
    costs = unloaded_costs(scene, resting, fit, READING_ERRORS)
    odds = _odds(costs + _error_costs(scene, moves, EVERY_SECOND))
    return _moments(odds) if odds[0] < SIGNIFICANCE else None


def _fit_and_changes(
    scene: Scene, resting: Readings, loaded: Readings | None, noise: FrameNoise | None
) -> "tuple[CellsFit | None, SharedChanges | None]":
    """Return the fit of the unloaded panel, and the changes to the loaded frame; None without."""
    fit = fitted(scene, resting, patient=True)
    if fit is None or loaded is None or not fit.within_noise:
        return fit, None
    prior = systematic_of(scene) or Systematic()
    return fit, shared_changes(scene, fit, loaded, prior, noise)


def _channel_factor(scene: Scene, moves: "SharedChanges") -> float:
    """Return the factor on the usual spread of channels, √E[f²] by the evidence of the changes.

    The factors CHANNEL_FACTORS are equally probable before. Errors of each reading move still cells
    likewise: where the scene calls these `estimated`, the evidence is summed over a few of their
    sizes.
    """
    requested = READING_ERROR.setting in estimated_errors(scene)
    sizes = (
        READING_ERRORS[COARSE]
        if requested
        else [READING_ERROR.size(systematic_of(scene) or Systematic())]
    )
    lawful = [size for size in sizes if size * moves.reach <= LINEAR_LIMIT]
    start = None
    costs = np.zeros((len(CHANNEL_FACTORS), len(lawful)))
    for row, factor in zip(costs, CHANNEL_FACTORS, strict=True):
        scaled = moves.with_channels(factor)
        for number, size in enumerate(lawful):
            row[number], start = _still(scaled.changes(float(size)), start)
    marginal = np.logaddexp.reduce(-costs / 2, axis=1)
    odds = np.exp(marginal - marginal.max())
    return float(np.sqrt(odds @ np.square(CHANNEL_FACTORS) / odds.sum()))


def _undetermined(errors: SharedErrors, reason: str, scene: Scene) -> SharedErrors:
    """Return the errors with the reason why the common ones keep their prior.

    The reason is '' where the scene calls no common error `estimated`.
    """
    common_requested = bool(set(estimated_errors(scene)) - {READING_ERROR.setting})
    return replace(errors, undetermined=reason if common_requested else "")


def _with_common_errors(
    errors: SharedErrors, moves: "SharedChanges", prior: Systematic, scene: Scene
) -> SharedErrors:
    """Return the errors with the joint posterior of those common to the readings.

    Parameters
    ----------
    errors : SharedErrors
        With the size of each reading's own error.
    moves : SharedChanges
    prior : Systematic
        Standard deviations of the errors.
    scene : Scene
    """
    size = READING_ERROR.size(errors.possible.sizes)
    changes = moves.changes(size)
    # Neighbours of moved cells are left out, because a load has a skirt.
    still = away_from_changed(_still(changes)[1], scene.panel.shape)
    if still.mean() < MIN_STILL_SHARE:
        return _undetermined(errors, "a load covers the panel", scene)
    if size * moves.reach > LINEAR_LIMIT:
        return _undetermined(errors, "errors of the readings are too large", scene)
    mean, covariance = changes.posterior(still)
    second = covariance + np.outer(mean, mean)
    settings = [error.setting for error in moves.errors]
    # The columns of the root behind those of common errors are the readings' own errors.
    if size:
        settings.append(READING_ERROR.setting)
    possible = Possible(
        errors.possible.sizes, tuple(settings), _lower_root(second), errors.possible.in_sigma
    )
    sizes = errors.sizes | _posterior_sizes(moves, second, covariance, prior)
    return replace(errors, possible=possible, sizes=sizes)


@dataclass(frozen=True, eq=False)
class SharedChanges:
    """Changes of the log cells from the unloaded panel to a frame, by the size e of errors.

    Attributes
    ----------
    change : array, shape (cells,)
        d.
    noise : array, shape (cells, cells)
        Covariance of d over still cells, without the errors below.
    hidden, own : array, shapes (cells, k) and (cells, cells)
        Response of d to the estimated errors, and to each reading's own error of size 1.
    reach : float
        Median standard deviation of log r of the unloaded cells if e = 1.
    errors : tuple of SharedError
        The estimated errors without each reading's own.
    counts : dict
        Field of `Systematic` → number of columns of an estimated error.
    """

    change: Array
    noise: Array
    hidden: Array
    own: Array
    reach: float
    errors: tuple[SharedError, ...]
    counts: dict[str, int]

    def with_channels(self, factor: float) -> "SharedChanges":
        """Return the changes with a spread of the channels that is larger by a factor."""
        first = 0
        hidden = self.hidden.copy()
        for setting, count in self.counts.items():
            if setting == CHANNELS.setting:
                hidden[:, first : first + count] *= factor
            first += count
        return replace(self, hidden=hidden)

    def changes(self, size: float) -> Changes:
        """Return the changes with the estimated errors and each reading's own error.

        `size` is e.
        """
        return Changes(
            self.change,
            self.noise,
            np.hstack([self.hidden, size * self.own]) if size else self.hidden,
        )


def shared_changes(
    scene: Scene, resting: CellsFit, loaded: Readings, sizes: Systematic, noise: FrameNoise | None
) -> SharedChanges | None:
    """Return the changes from the unloaded panel to a frame; None where the fit of the frame fails.

    Parameters
    ----------
    scene : Scene
    resting : CellsFit
        Fit of the unloaded panel.
    loaded : Readings
        (rows, columns).
    sizes : Systematic
        Standard deviations of the errors.
    noise : FrameNoise or None
        Errors that the readings of a frame share.
    """
    fit = fitted(scene, loaded, resting.cells) or fitted(scene, loaded, patient=True)
    if fit is None:
        return None
    requested = estimated_errors(scene)
    further = [error for error in SHARED_ERRORS if error is not READING_ERROR and error.size(sizes)]
    estimated = tuple(
        error for error in further if error.setting in requested and error is not REFERENCE
    )
    fixed = tuple(error for error in further if error not in estimated)
    groups = ((READING_ERROR,), fixed, *((error,) for error in estimated))
    steadied = _steadied(scene, fit, resting.cells)
    unit = replace(sizes, reading_error=1.0)
    at_rest = _responses(resting, groups, unit)
    under_load = _responses(steadied, groups, unit)
    own, of_fixed, *of_estimated = (
        of_frame - of_rest for of_frame, of_rest in zip(under_load, at_rest, strict=True)
    )
    size = resting.cells.size
    # The unloaded panel and the frame have errors of their own; creep, and a common change of all
    # cells.
    covariance = (
        _with_frame_noise(resting.covariance, resting, noise, baseline=True)
        + _with_frame_noise(fit.covariance, steadied, noise, baseline=False)
        + ASSUMED.creep**2 * np.eye(size)
        + ASSUMED.common_change**2
    )
    reach = float(np.median(np.linalg.norm(at_rest[0], axis=1)))
    counts = {
        error.setting: part.shape[1] for error, part in zip(estimated, of_estimated, strict=True)
    }
    hidden = np.hstack([np.zeros((size, 0)), *of_estimated])
    change = np.log(fit.cells / resting.cells).ravel()
    return SharedChanges(
        change, covariance + of_fixed @ of_fixed.T, hidden, own, reach, estimated, counts
    )


def _responses(
    fit: CellsFit, groups: Sequence[tuple[SharedError, ...]], sizes: Systematic
) -> list[Array]:
    """Return the responses K U of the log cells to each group of errors, (cells, columns)."""
    readings = fit.readings.value
    return [
        fit.response(error_columns(errors, fit.network, readings, fit.scene, sizes))
        for errors in groups
    ]


def _with_frame_noise(
    covariance: Array, fit: CellsFit, noise: FrameNoise | None, *, baseline: bool
) -> Array:
    """Return the covariance of the log cells with the errors that the readings of a frame share."""
    if noise is None:
        return covariance
    responses = fit.gain @ noise.columns(fit.readings.value[None], baseline=baseline)
    return np.asarray(covariance + responses @ responses.T)


def _posterior_sizes(
    moves: SharedChanges, second: Array, covariance: Array, prior: Systematic
) -> dict[str, tuple[float, float]]:
    """Return the size and standard deviation of each estimated error by its field of `Systematic`.

    Parameters
    ----------
    moves : SharedChanges
    second, covariance : array, shape (columns, columns)
        E[z zᵀ] and the covariance of z, the columns of all errors one after the other.
    prior : Systematic
        Standard deviations of the errors, in which z is measured.
    """
    sizes = dict[str, tuple[float, float]]()
    first = 0
    for error in moves.errors:
        last = first + moves.counts[error.setting]
        root_mean_square = np.sqrt(np.trace(second[first:last, first:last]) / (last - first))
        deviation = np.sqrt(np.trace(covariance[first:last, first:last]) / (last - first))
        unit = error.size(prior)
        sizes[error.setting] = unit * float(root_mean_square), unit * float(deviation)
        first = last
    return sizes


def _lower_root(square: Array) -> Array:
    """Return a lower triangular root of a symmetric matrix.

    Its negative eigenvalues count as zero.
    """
    values, vectors = np.linalg.eigh((square + square.T) / 2)
    return np.asarray(np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T)


def _still(changes: Changes, begun: Chosen | None = None) -> tuple[float, Chosen]:
    """Return −2 ln evidence, and the still cells.

    Parameters
    ----------
    changes : Changes
    begun : boolean array, shape (cells,), optional
        Still cells that the search begins with; by default the half that changed least. Other
        starts are not tried, because a shared error may explain a smooth load as well as moved
        cells do.
    """
    deviation = np.abs(changes.change - np.median(changes.change))
    begun = deviation <= np.median(deviation) if begun is None else begun
    score, moved = changes.selected([~begun], np.abs(changes.change) >= LOADED_CHANGE)
    return score, ~moved


def _smooth_loads(shape: tuple[int, ...]) -> Array:
    """Return the covariance (cells, cells) of changes in the skirt of a load of unit size.

    The covariance is exp(−distance²/(2 ℓ²)).
    """
    row, column = (index.ravel() for index in np.indices(shape))
    square = (row[:, None] - row) ** 2 + (column[:, None] - column) ** 2
    return np.asarray(np.exp(-square / (2 * ASSUMED.skirt_cells**2)))


def _error_costs(scene: Scene, moves: SharedChanges | None, numbers: NDArray[np.intp]) -> Array:
    """Return −2 ln evidence of READING_ERRORS by the changes to a loaded frame, (errors,).

    The evidence is averaged over SKIRTS, which are equally probable: skirts of loads are no errors
    of the readings. Each search begins with the still cells of the error before, because these
    change little. Beyond LINEAR_LIMIT the last value holds.

    Parameters
    ----------
    scene : Scene
    moves : SharedChanges or None
        None: the evidence is 0.
    numbers : integer array
        Numbers of the errors that are computed; the others are interpolated.
    """
    if moves is None:
        return np.zeros(len(READING_ERRORS))
    loads = _smooth_loads(scene.panel.shape)
    tried = numbers[READING_ERRORS[numbers] * moves.reach <= LINEAR_LIMIT]
    costs = np.zeros((len(SKIRTS), len(tried)))
    for skirt, of_skirt in zip(SKIRTS, costs, strict=True):
        smoothed = replace(moves, noise=moves.noise + skirt**2 * loads)
        start = None
        for column, size in enumerate(READING_ERRORS[tried]):
            of_skirt[column], start = _still(smoothed.changes(size), start)
    # −2 ln Σ_skirt p(d | e, skirt)
    marginal = -2 * np.logaddexp.reduce(-costs / 2, axis=0)
    return np.asarray(np.interp(np.arange(len(READING_ERRORS)), tried, marginal))


def _odds(costs: Array) -> Array:
    """Return the posterior probabilities of READING_ERRORS from their −2 ln likelihoods."""
    odds = np.exp(-(costs - costs.min()) / 2) * PRIOR_ODDS
    return np.asarray(odds / odds.sum())


def _median(odds: Array) -> float:
    """Return the median of e by the probabilities of READING_ERRORS.

    The result is 0 where none is more probable than any.
    """
    return float(np.interp(0.5, np.cumsum(odds), READING_ERRORS))


def _moments(odds: Array) -> tuple[float, float]:
    """Return the mean and standard deviation of e by the probabilities of READING_ERRORS."""
    mean = float(odds @ READING_ERRORS)
    return mean, float(np.sqrt(max(float(odds @ np.square(READING_ERRORS)) - mean**2, 0.0)))


def _steadied(scene: Scene, fit: CellsFit, near: Array) -> CellsFit:
    """Return the fit with still cells at their unloaded values, and with their model readings.

    A cell is still unless it clearly moved. The linearisation of frames and unloaded panel then
    agrees for still cells, whatever the noise.

    Parameters
    ----------
    scene : Scene
    fit : CellsFit
    near : array, shape (rows, columns)
        Unloaded cells, ohm; a common factor on all cells remains.
    """
    change = np.log(fit.cells / near)
    middle = np.median(change)
    moved = np.abs(change - middle) > UNUSUAL * np.sqrt(2 * np.diag(fit.covariance)).reshape(
        change.shape
    )
    data = data_of_cells(scene, fit.readings)
    cells = np.where(moved, fit.cells, near * np.exp(middle))
    return CellsFit.at(
        scene, data, replace(fit.readings, value=data.network(0, cells).reading()), cells
    )


class StaticErrors(SceneEffect):
    """Errors that all frames share: the sizes of `systematic`."""

    if_unexplained = "each reading may be off, the same in all frames"
    if_unexplained_key = "systematic.reading_error"

    def resolve(
        self, noise: NoiseEstimate, recording: Recording, besides: Besides
    ) -> NoiseEstimate:
        """Determine the errors that all frames share."""
        scene = recording.scene
        readings = noise.readings
        requested = tuple(name for name in estimated_errors(scene) if name != "model_error")
        if not requested:
            sizes = systematic_of(scene)
            size = 0.0 if sizes is None else READING_ERROR.size(sizes)
            if sizes is None or not size:
                return noise
            possible = Possible(sizes, in_sigma=size)
            return replace(noise, possible_errors=possible).with_reading_error(recording)
        unloaded = np.flatnonzero(recording.role == UNLOADED)
        measured = np.flatnonzero(recording.role == MEASURED)
        if not len(unloaded):
            for name in requested:
                noise = noise.undetermined(
                    f"systematic.{name}", "record five or more unloaded frames"
                )
            return noise
        resting = readings[unloaded].mean()
        loaded = None
        if len(measured):
            loaded = readings[strongest_frame(readings.plain_values, resting.value, measured)]
        errors = shared_errors(scene, resting, loaded, noise.frame)
        noise = replace(noise, possible_errors=errors.possible).with_reading_error(recording)
        for name in requested:
            if name in errors.sizes:
                noise = noise.determined(f"systematic.{name}", errors.sizes[name])
            else:
                reason = errors.undetermined or "no frame shows it; `lampest calibrate` measures it"
                noise = noise.undetermined(f"systematic.{name}", reason)
        return noise

    def unnamed(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Yield advice on channels, or on errors of each reading that stay the same."""
        yield from (channels := tuple(self._channels(evidence)))
        if channels:  # they make cells rougher, too, while errors of each reading show no channels
            return
        scene = evidence.scene
        noise = evidence.noise
        unloaded = evidence.unloaded
        if (
            noise.readings.sigma is None
            or not unloaded.any()
            or not evidence.names_none("systematic.reading_error")
        ):
            return
        sizes = scene.systematic if isinstance(scene.systematic, Systematic) else Systematic()
        estimating = replace(scene, systematic=replace(sizes, reading_error=ESTIMATED))
        # without the error of the model: the same misses would count for it and for errors of the
        # readings
        readings = replace(noise.readings, sigma=noise.readings.sigma / noise.model_factor)
        resting = readings[unloaded].mean()
        loaded = None
        if resting.plain[scene.requested].mean() < MIN_SHARE_READ:
            return
        if len(evidence.measured):
            strongest = strongest_frame(readings.plain_values, resting.value, evidence.measured)
            loaded = readings[strongest]
        error = significant_reading_error(estimating, resting, loaded, noise.frame)
        if error is not None:
            mean, deviation = error
            yield Unnamed.of(
                f"each reading seems off by {100 * mean:.2g} +- {100 * deviation:.1g} %, "
                "the same in all frames: cells are rougher than those of films",
                "systematic.reading_error",
            )

    def _channels(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Yield advice on channels of the lines that differ."""
        explanation = evidence.prepared.question.explanation
        key = f"systematic.{CHANNELS.setting}"
        if explanation is None or explanation.pair is None or not evidence.names_none(key):
            return
        spread, gain = explanation.pair.spread_of_channels()
        if gain > DOUBTFUL_GAIN:
            yield Unnamed.of(f"channels of the lines seem to differ by {spread:.1g} ohm", key)
