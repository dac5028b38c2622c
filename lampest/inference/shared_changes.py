"""Changes of the log cells by errors that all frames share, with skirts of loads and channels.

Errors z ~ N(0, 1) that the unloaded panel b and a frame f share change the estimated log cells by a
z, with

    a = K_f U_f − K_b U_b,

where U is the response of the readings to the errors (`lampest.panel.effects`), and K the
inverse of the readings' Jacobian. Over the still cells d = a z + noise. The slope of a wide load
moves cells like a shared error: each evidence is summed over the size of such a skirt, and over
the spread of the channels where it is unknown.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.files.levels import MIN_EVIDENCE_GAIN, NOISE_REACH, UNUSUAL
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CellsFit, data_of_cells, fitted
from lampest.inference.evidence import (
    MIN_STILL_SHARE,
    Changes,
    away_from_changed,
    mostly_still,
    places_of,
    smooth_covariance,
)
from lampest.inference.number import Number, summed_out
from lampest.panel.effects import (
    CHANNELS,
    READINGS,
    REFERENCE,
    SharedEffect,
    estimated_errors,
    recorded_share,
    sized_effects,
)
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import Readings

# Tried spreads of the channels over the usual one. Their logarithms are N(0, ln² 3), because parts
# differ from the usual one by a factor of three.
CHANNEL_FACTORS = 2.0 ** np.arange(-3, 4)
LOG_SD_OF_FACTORS = float(np.log(3))
LOG_PRIOR_OF_FACTORS = -np.square(np.log(CHANNEL_FACTORS) / LOG_SD_OF_FACTORS) / 2
# Those that are tried beside each size of the readings' own errors.
FEW_FACTORS = slice(1, None, 2)
# Of the probability: with less, loads cover the panel under most combinations.
MIN_SHARE_EXPLAINED = 0.5
# Of the probability: combinations of skirt and spread with less add nothing.
NEGLIGIBLE = 1e-3
# Of log r: the second order of a larger error moves cells by more than one per cent.
LINEAR_LIMIT = 0.15
# Tried sizes of a load's skirt, of log r. Always the largest would hide errors where no load has a
# skirt.
SKIRTS = ASSUMED.skirt * np.array([0.0, 0.03, 0.1, 0.3, 1.0])
# Of log r: only loads move cells by more, errors within the limit do not.
LOADED_CHANGE = NOISE_REACH * LINEAR_LIMIT


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
    errors : tuple of SharedEffect
        The estimated errors without each reading's own.
    counts : dict
        Field of `Systematic` → number of columns of an estimated error.
    """

    change: Array
    noise: Array
    hidden: Array
    own: Array
    reach: float
    errors: tuple[SharedEffect, ...]
    counts: dict[str, int]

    @property
    def has_channels(self) -> bool:
        """Whether the spread of the channels is estimated."""
        return CHANNELS in self.counts

    def scales(self, factor: float, columns: int) -> Array:
        """Return the factor on channels, and 1 for other errors, (columns,)."""
        scales = np.ones(columns)
        first = 0
        for setting, count in self.counts.items():
            if setting == CHANNELS:
                scales[first : first + count] = factor
            first += count
        return scales

    def without(self, setting: str) -> "SharedChanges":
        """Return the changes without an estimated error."""
        kept = np.repeat([key != setting for key in self.counts], [*self.counts.values()])
        errors = tuple(error for error in self.errors if error.setting != setting)
        counts = {key: count for key, count in self.counts.items() if key != setting}
        return replace(self, hidden=self.hidden[:, kept], errors=errors, counts=counts)

    def with_channels(self, factor: float) -> "SharedChanges":
        """Return the changes with a spread of the channels that is larger by a factor."""
        hidden = self.hidden * self.scales(factor, self.hidden.shape[1])
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


@dataclass(frozen=True, eq=False)
class SharedFrames:
    """The unloaded panel and a loaded frame, each fitted once for all errors that are tried.

    Attributes
    ----------
    scene : Scene
        Panel and readout; its errors are those of the calls.
    resting : Readings
        Mean of the unloaded frames, (rows, columns).
    loaded : Readings or None
        A loaded frame, (rows, columns).
    noise : FrameNoise or None
        Errors that the readings of a frame share.
    resting_cells, loaded_cells : array, shape (rows, columns), or None
        Cells in ohm, where several panels give the readings.
    """

    scene: Scene
    resting: Readings
    loaded: Readings | None
    noise: FrameNoise | None = None
    resting_cells: Array | None = None
    loaded_cells: Array | None = None

    @cached_property
    def fit(self) -> CellsFit | None:
        """The fit of the unloaded panel."""
        return fitted(self.scene, self.resting, self.resting_cells, patient=True)

    @cached_property
    def fit_of_load(self) -> CellsFit | None:
        """The fit of the loaded frame; None where it fails, or noise does not explain the rest."""
        if self.loaded is None or self.fit is None or not self.fit.within_noise:
            return None
        near = self.loaded_cells
        start = self.fit.cells if near is None else near
        first = fitted(self.scene, self.loaded, start)
        return first or fitted(self.scene, self.loaded, near, patient=True)

    @cached_property
    def steadied(self) -> CellsFit | None:
        """The fit of the loaded frame with still cells at their unloaded values.

        A common factor on all cells remains, and the readings are those of the model. A cell is
        still unless it clearly moved. The linearisation of frames and unloaded panel then agrees
        for still cells, whatever the noise.
        """
        if self.fit is None or self.fit_of_load is None:
            return None
        fit = self.fit_of_load
        change = np.log(fit.cells / self.fit.cells)
        middle = np.median(change)
        deviation = np.sqrt(2 * np.diag(fit.covariance)).reshape(change.shape)
        moved = np.abs(change - middle) > UNUSUAL * deviation
        data = data_of_cells(self.scene, fit.readings)
        cells = np.where(moved, fit.cells, self.fit.cells * np.exp(middle))
        readings = replace(fit.readings, value=data.network(0, cells).reading())
        return CellsFit.at(self.scene, data, readings, cells)


def shared_changes(scene: Scene, frames: SharedFrames, sizes: Systematic) -> SharedChanges | None:
    """Return the changes from the unloaded panel to a frame; None where a fit fails.

    Parameters
    ----------
    scene : Scene
        Calls errors `estimated`.
    frames : SharedFrames
    sizes : Systematic
        Standard deviations of the errors.
    """
    resting = frames.fit
    fit = frames.fit_of_load
    steadied = frames.steadied
    if resting is None or fit is None or steadied is None:
        return None
    further = [
        error
        for error in sized_effects(sizes)
        if error.setting != READINGS and sizes.size(error.setting)
    ]
    requested = {*estimated_errors(scene)} - {REFERENCE}
    estimated = tuple(error for error in further if error.setting in requested)
    fixed = [error for error in further if error not in estimated]
    # Each reading's own error is a column of the gain.
    own_at_rest, own_under_load = (
        each.gain * recorded_share(each.readings.value, scene).ravel()
        for each in (resting, steadied)
    )
    of_fixed, *of_estimated = (
        steadied.response_to(errors, sizes) - resting.response_to(errors, sizes)
        for errors in (fixed, *([error] for error in estimated))
    )
    size = resting.cells.size
    # The unloaded panel and the frame have errors of their own; creep, and a common change of all
    # cells.
    covariance = (
        _with_frame_noise(resting.covariance, resting, frames.noise, baseline=True)
        + _with_frame_noise(fit.covariance, steadied, frames.noise, baseline=False)
        + ASSUMED.creep**2 * np.eye(size)
        + ASSUMED.common_change**2
    )
    counts = {
        error.setting: part.shape[1] for error, part in zip(estimated, of_estimated, strict=True)
    }
    return SharedChanges(
        np.log(fit.cells / resting.cells).ravel(),
        covariance + of_fixed @ of_fixed.T,
        np.hstack([np.zeros((size, 0)), *of_estimated]),
        own_under_load - own_at_rest,
        float(np.median(np.linalg.norm(own_at_rest, axis=1))),
        estimated,
        counts,
    )


def _with_frame_noise(
    covariance: Array, fit: CellsFit, noise: FrameNoise | None, *, baseline: bool
) -> Array:
    """Return the covariance of the log cells with the errors that the readings of a frame share."""
    if noise is None:
        return covariance
    responses = fit.gain @ noise.columns(fit.readings.value[None], baseline=baseline)
    return covariance + responses @ responses.T


def _slope_of_load(change: Array, shape: tuple[int, ...]) -> Array:
    """Return the covariance (cells, cells) of changes on the slope around a load.

    The load's core are the cells that changed by more than half of the largest change D. Around it
    changes are smooth and of size D exp(−distance²/(2 ℓ²)).

    Parameters
    ----------
    change : array, shape (cells,)
        d.
    shape : tuple of int
        Rows and columns.
    """
    size = np.abs(change - np.median(change))
    core = np.argwhere(size.reshape(shape) > size.max() / 2)
    places = places_of(shape)
    square = ((places[:, None] - core) ** 2).sum(axis=-1).min(axis=1)
    deviation = size.max() * np.exp(-square / (2 * ASSUMED.slope_cells**2))
    smooth = smooth_covariance(places, ASSUMED.skirt_cells)
    return np.asarray(deviation[:, None] * smooth * deviation)


def _still(changes: Changes, begun: Mask | None = None) -> tuple[float, Mask]:
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


def error_costs(
    scene: Scene, moves: SharedChanges, errors: Array, factors: Array, cells: float
) -> Array:
    """Return −2 ln evidence of errors by the changes to a loaded frame, (factors, errors).

    The evidence is averaged over SKIRTS, which are equally probable: skirts of loads are no errors
    of the readings. Each search begins with the still cells of the error before, because these
    change little.

    Parameters
    ----------
    scene : Scene
    moves : SharedChanges
    errors : array, shape (errors,)
        Sizes of each reading's own error.
    factors : array, shape (factors,)
        Spreads of the channels over the usual one.
    cells : float
        Distance over which changes in a skirt are correlated.
    """
    loads = smooth_covariance(places_of(scene.panel.shape), cells)
    by_readings = moves.own @ moves.own.T
    costs = np.zeros((len(SKIRTS), len(factors), len(errors)))
    for skirt, of_skirt in zip(SKIRTS, costs, strict=True):
        starts: list[Mask | None] = [None] * len(factors)
        for column, size in enumerate(errors):
            noise = moves.noise + skirt**2 * loads + size**2 * by_readings
            for number, factor in enumerate(factors):
                hidden = moves.with_channels(factor).hidden
                changes = Changes(moves.change, noise, hidden)
                of_skirt[number, column], starts[number] = _still(changes, starts[number])
    # −2 ln Σ_skirt p(d | e, skirt)
    return summed_out(costs, axis=0)


def gain_of(scene: Scene, frames: SharedFrames, sizes: Systematic, setting: str) -> float:
    """Return the decrease of −2 ln evidence by an error, relative to the misfit of still cells.

    Moved cells are selected with the error and without it. The slope around a load explains any
    error, so that loads have sharp edges here, and a gain below MIN_EVIDENCE_GAIN counts as 0. So
    does one where most cells move with the error.

    Parameters
    ----------
    scene : Scene
        Calls the error `estimated`.
    frames : SharedFrames
    sizes : Systematic
        Standard deviations of the errors.
    setting : str
        Field of `Systematic` of the error.
    """
    moves = shared_changes(scene, frames, sizes)
    if moves is None or setting not in moves.counts:
        return 0.0
    size = sizes.size(READINGS)
    changes = moves.changes(size)
    score, still = _still(changes)
    if not mostly_still(~still):
        return 0.0
    without, _ = _still(moves.without(setting).changes(size))
    excess = max(changes.part(still).misfit / still.sum(), 1.0)
    gain = float((without - score) / excess)
    return gain if gain > MIN_EVIDENCE_GAIN else 0.0


def joint_posterior(
    scene: Scene, moves: SharedChanges, size: float, spread: Number
) -> tuple[Array, Array] | None:
    """Return the posterior of errors z, summed over spreads of the channels.

    The errors are in units of their priors. The slope around a load is none of the errors. The
    result is None where a load leaves no still cells.

    Parameters
    ----------
    scene : Scene
    moves : SharedChanges
    size : float
        Standard deviation e of each reading's own error.
    spread : Number
        Spread of the channels over the usual one.

    Returns
    -------
    second, covariance : array, shape (columns, columns)
        E[z zᵀ], and the covariance of z.
    """
    sloped = replace(moves, noise=moves.noise + _slope_of_load(moves.change, scene.panel.shape))
    start = None
    means = list[Array]()
    seconds = list[Array]()
    weights = list[float]()
    for factor, odds in zip(spread.values, spread.odds, strict=True):
        if odds < NEGLIGIBLE:
            continue
        changes = sloped.with_channels(factor).changes(size)
        start = _still(changes, start)[1]
        # Neighbours of moved cells are left out, because a load has a skirt.
        distant = away_from_changed(start, scene.panel.shape)
        if distant.mean() < MIN_STILL_SHARE:
            continue
        mean, covariance = changes.posterior(distant)
        scale = moves.scales(factor, len(mean))
        means.append(scale * mean)
        seconds.append(scale[:, None] * (covariance + np.outer(mean, mean)) * scale)
        weights.append(odds)
    if not sum(weights) > MIN_SHARE_EXPLAINED:
        return None
    mean = np.average(means, axis=0, weights=weights)
    second = np.average(seconds, axis=0, weights=weights)
    return second, second - np.outer(mean, mean)
