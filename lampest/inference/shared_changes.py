"""Changes of the log cells by errors that all frames share, beside loads.

Errors z ~ N(0, 1) that the unloaded panel b and a frame f share change the estimated log cells by a
z, with

    a = K_f U_f − K_b U_b,

where U is the response of the readings to the errors (`lampest.panel.effects`), and K the
inverse of the readings' Jacobian. A load adds changes of its own: d = a z + load + noise. Each
evidence and each posterior is averaged over loads (`Changes.single_loads`, `smooth_loads`), and
over the spread of the channels where it is unknown.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from lampest.files.levels import UNUSUAL
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CellsFit, data_of_cells, fitted
from lampest.inference.evidence import Changes, Load, places_of, smooth_loads
from lampest.inference.number import Number, mean_cost
from lampest.panel.effects import (
    CHANNELS,
    READINGS,
    REFERENCE,
    SharedEffect,
    estimated_errors,
    recorded_share,
    sized_effects,
)
from lampest.panel.panel import Array, Numbers
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
# Of the probability: combinations of load and spread with less add nothing.
NEGLIGIBLE = 1e-3
# Of log r: the second order of a larger error moves cells by more than one per cent.
LINEAR_LIMIT = 0.15


@dataclass(frozen=True, eq=False)
class SharedChanges:
    """Changes of the log cells from the unloaded panel to a frame, by the size e of errors.

    Attributes
    ----------
    place : integer array, shape (cells, 2)
        Row and column of each cell.
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

    place: Numbers
    change: Array
    noise: Array
    hidden: Array
    own: Array
    reach: float
    errors: tuple[SharedEffect, ...]
    counts: dict[str, int]

    @cached_property
    def smooth_loads(self) -> list[Load]:
        """Smooth loads that may have made the changes; they do not depend on the errors."""
        return smooth_loads(self.change, self.place)

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

    @property
    def centred(self) -> "SharedChanges":
        """The changes by differences of lines and of readings alone.

        What all columns of an error have in common is like a smooth load.
        """
        ends = np.cumsum([*self.counts.values()])[:-1]
        parts = np.split(self.hidden, ends, axis=1)
        hidden = [part - part.mean(axis=1, keepdims=True) for part in parts if part.size]
        own = self.own - self.own.mean(axis=1, keepdims=True)
        return replace(self, hidden=np.hstack([self.hidden[:, :0], *hidden]), own=own)

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
    # The second order of noise x ~ N(0, v) changes ln r by x²/2, of mean square 3 v²/4.
    variance = np.diag(resting.covariance) + np.diag(fit.covariance)
    # The unloaded panel and the frame have errors of their own; creep, and a common change of all
    # cells.
    covariance = (
        _with_frame_noise(resting.covariance, resting, frames.noise, baseline=True)
        + _with_frame_noise(fit.covariance, steadied, frames.noise, baseline=False)
        + np.diag(0.75 * variance**2 + ASSUMED.creep**2)
        + ASSUMED.common_change**2
    )
    counts = {
        error.setting: part.shape[1] for error, part in zip(estimated, of_estimated, strict=True)
    }
    return SharedChanges(
        places_of(scene.panel.shape),
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


def _beside_loads(
    moves: SharedChanges, size: float, factor: float
) -> Iterator[tuple[float, Callable[[], Changes]]]:
    """Yield −2 ln density and a function of the changes beside each load that may have made them.

    Beside smooth loads errors count as far as they are `SharedChanges.centred`.

    Parameters
    ----------
    moves : SharedChanges
    size : float
        Standard deviation of each reading's own error.
    factor : float
        Spread of the channels over the usual one.
    """
    beside_cells, beside_fields = (
        each.with_channels(factor).changes(size) for each in (moves, moves.centred)
    )
    for load in (*beside_cells.single_loads(moves.place), *moves.smooth_loads):
        changes = beside_fields if load.smooth else beside_cells
        costs = load.cost + changes.costs_with(load.cells, load.covariances)
        for cost, covariance in zip(costs.tolist(), load.covariances, strict=True):
            yield cost, partial(changes.with_load, load.cells, covariance)


def error_costs(moves: SharedChanges, errors: Array, factors: Array) -> Array:
    """Return −2 ln evidence of errors by the changes to a loaded frame, (factors, errors).

    The evidence is averaged over single and smooth loads, which are no errors of the readings.

    Parameters
    ----------
    moves : SharedChanges
    errors : array, shape (errors,)
        Sizes of each reading's own error.
    factors : array, shape (factors,)
        Spreads of the channels over the usual one.
    """

    def cost(size: float, factor: float) -> float:
        return mean_cost(np.array([each for each, _ in _beside_loads(moves, size, factor)]))

    return np.array([[cost(size, factor) for size in errors] for factor in factors])


def gain_of(moves: SharedChanges, sizes: Systematic, setting: str) -> float:
    """Return the decrease of −2 ln evidence by an error, averaged over loads.

    Parameters
    ----------
    moves : SharedChanges
    sizes : Systematic
        Standard deviations of the errors.
    setting : str
        Field of `Systematic` of the error.
    """
    if not moves.counts.get(setting):
        return 0.0
    size = np.array([sizes.size(READINGS)])
    usual = np.ones(1)
    without, with_error = (
        float(error_costs(each, size, usual)[0, 0]) for each in (moves.without(setting), moves)
    )
    return without - with_error


def joint_posterior(moves: SharedChanges, size: float, spread: Number) -> tuple[Array, Array]:
    """Return the posterior of errors z, averaged over loads and spreads of the channels.

    The errors are in units of their priors. What the second order of the most probable ones changes
    is noise of a second estimate.

    Parameters
    ----------
    moves : SharedChanges
    size : float
        Standard deviation e of each reading's own error.
    spread : Number
        Spread of the channels over the usual one.

    Returns
    -------
    mean : array, shape (columns,)
    covariance : array, shape (columns, columns)
    """
    linear, _ = _averaged_posterior(moves, size, spread)
    second_order = (moves.changes(size).columns @ linear) ** 2 / 2
    uncertain = replace(moves, noise=moves.noise + np.diag(second_order**2))
    return _averaged_posterior(uncertain, size, spread)


def _averaged_posterior(moves: SharedChanges, size: float, spread: Number) -> tuple[Array, Array]:
    """Return the posterior of `joint_posterior` by linear theory."""
    means = list[Array]()
    seconds = list[Array]()
    weights = list[float]()
    for factor, odds in zip(spread.values, spread.odds, strict=True):
        if odds < NEGLIGIBLE:
            continue
        costs, beside = zip(*_beside_loads(moves, size, factor), strict=True)
        odds_of_loads = np.exp((min(costs) - np.array(costs)) / 2)
        odds_of_loads *= odds / odds_of_loads.sum()
        for changes_beside, weight in zip(beside, odds_of_loads, strict=True):
            if weight < NEGLIGIBLE:
                continue
            changes = changes_beside()
            errors = changes.errors
            scale = moves.scales(factor, changes.columns.shape[1])
            mean = scale * errors.mean(changes.change)
            means.append(mean)
            seconds.append(scale[:, None] * errors.covariance * scale + np.outer(mean, mean))
            weights.append(float(weight))
    mean = np.average(means, axis=0, weights=weights)
    second = np.average(seconds, axis=0, weights=weights)
    return mean, second - np.outer(mean, mean)
