"""Estimation of shared errors from the apparent motion of cells without a load.

Errors z ~ N(0, 1) that the unloaded panel b and a frame f share change the estimated log cells by a
z, with

    a = K_f U_f − K_b U_b,

where U is the response of the readings to the errors (`lampest.panel.effects`), and K the
inverse of the readings' Jacobian. Beside loads, d = a z + noise. Each reading has an error of its
own, N(0, e²). The posterior of e combines the evidence of the changes, averaged over loads
(`lampest.inference.shared_changes`), and the likelihood of the unloaded panel. Given e, both
determine the posterior of z. Of errors that are too large for linear theory only e is estimated.

Errors that frames share stay out of σ, so that weights and estimates see the noise alone. Where the
evidence of an error against none exceeds SHOWN_GAIN, its posterior mean corrects the readings of
all frames, or the channels of the scene. What remains widens error bars, and so do the other
errors.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lampest.files.errors import BROKEN
from lampest.files.levels import DOUBTFUL_GAIN, MIN_EVIDENCE_GAIN
from lampest.inference.cells_fit import fitted
from lampest.inference.effects.effect import SceneEffect, Unnamed
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides
from lampest.inference.number import SHOWN_GAIN, Number, summed_out
from lampest.inference.prepared import Prepared
from lampest.inference.shared_changes import (
    CHANNEL_FACTORS,
    FEW_FACTORS,
    LINEAR_LIMIT,
    LOG_PRIOR_OF_FACTORS,
    LOG_SD_OF_FACTORS,
    SharedChanges,
    SharedFrames,
    error_costs,
    gain_of,
    joint_posterior,
    shared_changes,
)
from lampest.inference.unloaded_cells import READING_ERRORS, at_rest, film_scatter, unloaded_costs
from lampest.panel.effects import (
    CHANNELS,
    READINGS,
    Possible,
    SharedEffect,
    estimated_errors,
    shared_effect_of,
    shared_effects,
    systematic_of,
)
from lampest.panel.panel import Array, Numbers
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED, Systematic
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.gaussian import lower_root
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# None is as probable as all other errors together, whose prior is uniform in ln e, that of a
# scale.
PRIOR_ODDS = np.where(READING_ERRORS > 0, 0.5 / np.count_nonzero(READING_ERRORS), 0.5)
# Standard deviation of an error over that of its prior: with more, frames tell nothing of it.
MAX_UNTOLD = 0.9
# Numbers of the tried values: those at which cells between rest and a load are selected, and those
# that show whether a finer scan is worth its time. Neighbours differ by a factor of 2.6. Below the
# most probable error −2 ln p falls with e², so that the smaller neighbour of one that counts keeps
# a quarter of its gain, and that is more than COARSE_GAIN.
EVERY_SECOND = np.arange(0, len(READING_ERRORS), 2)
COARSE = np.append(0, np.arange(1, len(READING_ERRORS), 4))
COARSE_GAIN = 3.0
LARGEST_FOUND = 0.9 * READING_ERRORS[-1]


USUAL_SPREAD = np.ones(1)  # of channels, over itself
# Of the unloaded readings that are values: with fewer, films look uneven (tests/golden/checks.py).
MIN_SHARE_READ = 0.9


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
    significant : tuple of str
        Fields of `Systematic` of the errors that readings or the circuit are corrected for.
    gains : dict
        Field of `Systematic` → decrease of −2 ln evidence by each estimated error beside the
        others; common errors have theirs where advice asks (`gain_of`).
    posterior : tuple of array, or None
        Mean and covariance of z of the errors of `possible.settings`, by the changes.
    """

    possible: Possible
    sizes: dict[str, tuple[float, float]]
    undetermined: str = ""
    significant: tuple[str, ...] = ()
    gains: dict[str, float] = field(default_factory=dict)
    posterior: tuple[Array, Array] | None = None


def shared_frames(noise: NoiseEstimate, recording: Recording) -> SharedFrames:
    """Return the mean of the unloaded frames, and the strongest of the loaded ones.

    One frame is enough: frames that are nearly equal count once, or the edges of a load that stands
    would look like an error that all frames share.

    Parameters
    ----------
    noise : NoiseEstimate
        Readings of all frames, and what it says of their cells. Loaded frames without a reading do
        not count.
    recording : Recording
    """
    readings = noise.readings
    resting = readings[recording.role == UNLOADED].mean()
    measured = np.flatnonzero(recording.role == MEASURED)
    measured = measured[(readings.seen[measured] > 0).any(axis=(1, 2))]
    loaded = None
    if len(measured):
        loaded = readings[strongest_frame(readings.plain_values, resting.value, measured)]
    loaded_cells = None if noise.panels is None else noise.panels.loaded
    return SharedFrames(
        recording.scene, resting, loaded, noise.frame, noise.resting_cells, loaded_cells
    )


def shared_errors(scene: Scene, frames: SharedFrames, needed: str = "") -> SharedErrors:
    """Return the errors that a scene calls `estimated`, from the unloaded panel and a loaded frame.

    Advice asks for the evidence of errors that a scene does not name, and for their sizes, with a
    scene that does. Where the gain of the field `needed` is known, no joint posterior is computed.
    """
    prior = systematic_of(scene) or Systematic()
    resting = frames.resting
    possible = Possible(prior)
    reason = ""
    if resting.sigma is None:
        reason = "the noise of the readings is unknown: name the readout's noise_lsb"
    elif resting.value.size > MAX_CELLS:
        reason = f"the panel has more than {MAX_CELLS} cells: estimate them on a part of it"
    if reason:
        return SharedErrors(possible, {}, reason)
    moves = shared_changes(scene, frames, prior)
    own = SharedErrors(possible, {})
    if READINGS in estimated_errors(scene):
        if moves is not None and moves.has_channels:
            error = _error_beside_channels(scene, frames, moves)
        else:
            costs = unloaded_costs(scene, resting, frames.fit, READING_ERRORS)[0]
            costs = costs + _costs_of_errors(moves, EVERY_SECOND)[0]
            error = Number.by_costs(READING_ERRORS, costs, PRIOR_ODDS)
        # √E[e²] exceeds the most probable e where e is uncertain
        possible = Possible(replace(prior, reading_error=float(np.sqrt(error.mean_square))))
        own = SharedErrors(
            possible,
            {READINGS: (error.mean, error.deviation)},
            significant=(READINGS,) if error.evidence > SHOWN_GAIN else (),
            # The largest tried error is no finding: it stands for cells that are unlike.
            gains={READINGS: error.evidence if error.mean < LARGEST_FOUND else 0.0},
        )
    if moves is None:
        reason = "no cells explain the unloaded frames or the loaded ones"
        if frames.loaded is None:
            reason = "no frame is loaded: press a few cells"
        return _undetermined(own, reason, scene)
    size = own.possible.sizes.size(READINGS)
    if size * moves.reach > LINEAR_LIMIT:
        return _undetermined(own, "errors of the readings are too large", scene)
    spread = Number(np.ones(1), np.ones(1), 0.0)
    if moves.has_channels:
        spread, gain = _channel_spread(scene, frames, moves, size)
        own = replace(own, gains=own.gains | {CHANNELS: gain})
    if needed in own.gains:
        return own
    return _with_common_errors(own, moves, prior, scene, spread)


def _known_at_rest(
    errors: SharedErrors, scene: Scene, resting: Readings, cells: Array | None
) -> Possible:
    """Return the errors as changes and the unloaded panel know them, with the scatter of its films.

    Parameters
    ----------
    errors : SharedErrors
    scene : Scene
    resting : Readings
        Mean of the unloaded frames, (rows, columns).
    cells : array, shape (rows, columns), or None
        Those of the unloaded panel where several panels give its readings, ohm.
    """
    possible = errors.possible
    sizes = possible.sizes
    size = sizes.size(READINGS)
    few = resting.value.size <= MAX_DENSE
    if resting.sigma is None or not few or not (size or errors.significant):
        return possible
    with suppress(*BROKEN):
        small = resting.value.size <= MAX_CELLS
        fit = fitted(scene, resting, cells, patient=True) if small else None
        scatter = film_scatter(scene, resting, fit, size, sizes.size(CHANNELS))
        if size:
            possible = replace(possible, film_scatter=scatter)
        if errors.significant:
            scattered = replace(possible, film_scatter=scatter)
            known = at_rest(scattered, errors.posterior, scene, resting, fit)
            return _corrected(possible, known, scene, errors.significant)
    return possible


def _corrected(
    possible: Possible,
    known: tuple[tuple[str, ...], Array, Array],
    scene: Scene,
    significant: tuple[str, ...],
) -> Possible:
    """Return the errors with their posterior, about corrections by the mean of significant ones.

    Parameters
    ----------
    possible : Possible
    known : tuple
        The posterior of `at_rest`.
    scene : Scene
    significant : tuple of str
        Fields of `Systematic`. An error that the scene's circuit cannot have is not corrected.
    """
    settings, mean, covariance = known
    log_factor = None
    in_circuit = dict[str, Array]()
    for setting in significant:
        place = np.equal(settings, setting)
        correction = possible.sizes.size(setting) * mean[place]
        if setting == READINGS:
            log_factor = correction.reshape(scene.panel.network.shape)
        else:
            try:
                shared_effect_of(setting).with_errors(scene, correction)
            except ValueError:
                continue
            in_circuit[setting] = correction
        mean[place] = 0.0
    return replace(
        possible,
        settings=tuple(dict.fromkeys(settings)),
        root=lower_root(covariance + np.outer(mean, mean)),
        log_factor=log_factor,
        in_circuit=in_circuit,
    )


def _error_beside_channels(scene: Scene, frames: SharedFrames, moves: SharedChanges) -> Number:
    """Return the posterior of e, summed over a few spreads of the channels."""
    every = np.arange(len(READING_ERRORS))
    usual = (systematic_of(scene) or Systematic()).size(CHANNELS)
    spreads = CHANNEL_FACTORS[FEW_FACTORS] * usual
    tried = READING_ERRORS[COARSE]
    coarse = unloaded_costs(scene, frames.resting, frames.fit, tried, spreads)
    unloaded = np.array([np.interp(every, COARSE, of_spread) for of_spread in coarse])
    costs = unloaded - 2 * LOG_PRIOR_OF_FACTORS[FEW_FACTORS, None]
    beside = _costs_of_errors(moves, COARSE, CHANNEL_FACTORS[FEW_FACTORS])
    return Number.by_costs(READING_ERRORS, summed_out(costs + beside, axis=0), PRIOR_ODDS)


def _channel_spread(
    scene: Scene, frames: SharedFrames, moves: SharedChanges, size: float
) -> tuple[Number, float]:
    """Return the posterior of the spread of the channels over the usual one, and its evidence.

    The unloaded panel tells it, because channels change all cells of a line, and so do the changes
    of still cells. The first value, no spread, has no probability where a spread is estimated.

    Parameters
    ----------
    scene : Scene
    frames : SharedFrames
    moves : SharedChanges
    size : float
        Standard deviation of each reading's own error.

    Returns
    -------
    spread : Number
    float
        Gain over no spread. 0 where the largest tried spread explains as much: other errors move
        still cells then, or the unloaded cells are unlike; and where the changes of still cells
        contradict a spread.
    """
    factors = np.append(0.0, CHANNEL_FACTORS)
    error = np.array([size])
    spreads = factors * (systematic_of(scene) or Systematic()).size(CHANNELS)
    unloaded = unloaded_costs(scene, frames.resting, frames.fit, error, spreads)[:, 0]
    changes = error_costs(moves, error, factors)[:, 0]
    prior = np.append(0.0, np.exp(LOG_PRIOR_OF_FACTORS))
    spread = Number.by_costs(factors, unloaded + changes, prior)
    likelihood = spread.odds[1:] / prior[1:]
    largest = likelihood[-1] > np.exp(-COARSE_GAIN / 2) * likelihood.max()
    contradicted = changes[spread.odds.argmax()] - changes[0] > COARSE_GAIN
    return spread, 0.0 if largest or contradicted else spread.evidence


def _undetermined(errors: SharedErrors, reason: str, scene: Scene) -> SharedErrors:
    """Return the errors with the reason why the common ones keep their prior.

    The reason is '' where the scene calls no common error `estimated`.
    """
    common_requested = bool(set(estimated_errors(scene)) - {READINGS})
    return replace(errors, undetermined=reason if common_requested else "")


def _with_common_errors(
    errors: SharedErrors,
    moves: SharedChanges,
    prior: Systematic,
    scene: Scene,
    spread: Number,
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
    spread : Number
        Spread of the channels over the usual one.
    """
    size = errors.possible.sizes.size(READINGS)
    if moves.has_channels:
        usual = prior.size(CHANNELS)
        channels = replace(
            errors.possible.sizes, channel_spread_ohm=usual * float(np.sqrt(spread.mean_square))
        )
        errors = replace(errors, possible=replace(errors.possible, sizes=channels))
        # determined where it is known better than its prior
        if spread.log_deviation < MAX_UNTOLD * LOG_SD_OF_FACTORS:
            determined = {CHANNELS: (usual * spread.mean, usual * spread.deviation)}
            errors = replace(errors, sizes=errors.sizes | determined)
    mean, covariance = joint_posterior(moves, size, spread)
    determined = _determined_sizes(moves, mean, covariance, prior)
    settings = [error.setting for error in moves.errors]
    # The columns of the posterior behind those of common errors are the readings' own errors.
    if size:
        settings.append(READINGS)
    if moves.has_channels:
        # The posterior has the errors in the unit of the spread that readers of the scene take.
        unit = 1 / moves.scales(float(np.sqrt(spread.mean_square)), len(mean))
        mean, covariance = unit * mean, unit[:, None] * covariance * unit
    root = lower_root(covariance + np.outer(mean, mean))
    possible = replace(errors.possible, settings=tuple(settings), root=root)
    shown = tuple(setting for setting in moves.counts if _is_shown(setting, errors, moves))
    return replace(
        errors,
        possible=possible,
        sizes=errors.sizes | determined,
        significant=(*errors.significant, *shown),
        posterior=(mean, covariance),
    )


def _is_shown(setting: str, errors: SharedErrors, moves: SharedChanges) -> bool:
    """Return whether the evidence of a common error against none exceeds SHOWN_GAIN."""
    gain = errors.gains.get(setting)
    if gain is None:
        gain = gain_of(moves, errors.possible.sizes, setting)
    return gain > SHOWN_GAIN


def _determined_sizes(
    moves: SharedChanges, mean: Array, covariance: Array, prior: Systematic
) -> dict[str, tuple[float, float]]:
    """Return the size and standard deviation of each error that the recording tells more of.

    These are the root mean square and the deviation of the error; channels have their spread.
    Errors with a deviation of more than MAX_UNTOLD that of their prior are left out.

    Parameters
    ----------
    moves : SharedChanges
    mean, covariance : array, shapes (columns,) and (columns, columns)
        Those of `joint_posterior`.
    prior : Systematic
        Standard deviations of the errors, in which z is measured.
    """
    sizes = dict[str, tuple[float, float]]()
    first = 0
    for error in moves.errors:
        chosen = slice(first, first + moves.counts[error.setting])
        first = chosen.stop
        variances = np.diag(covariance)[chosen]
        if not variances.size or error.setting == CHANNELS:
            continue
        variance = float(variances.mean())
        unit = prior.size(error.setting)
        if variance < MAX_UNTOLD**2:
            square = variance + float(np.mean(mean[chosen] ** 2))
            sizes[error.setting] = unit * float(np.sqrt(square)), unit * float(np.sqrt(variance))
    return sizes


def _costs_of_errors(
    moves: SharedChanges | None,
    numbers: Numbers,
    factors: Array = USUAL_SPREAD,
) -> Array:
    """Return −2 ln evidence of READING_ERRORS by the changes, (factors, errors).

    Beyond LINEAR_LIMIT the last value holds.

    Parameters
    ----------
    moves : SharedChanges or None
        None: the evidence is 0.
    numbers : integer array
        Numbers of the errors that are computed; the others are interpolated.
    factors : array, shape (factors,)
        Spreads of the channels over the usual one.
    """
    if moves is None:
        return np.zeros((len(factors), len(READING_ERRORS)))
    tried = numbers[READING_ERRORS[numbers] * moves.reach <= LINEAR_LIMIT]
    costs = error_costs(moves, READING_ERRORS[tried], factors)
    every = np.arange(len(READING_ERRORS))
    return np.array([np.interp(every, tried, of_factor) for of_factor in costs])


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
        unloaded = recording.role == UNLOADED
        sizes = systematic_of(scene)
        if requested and not unloaded.any():
            for name in requested:
                noise = noise.undetermined(
                    f"systematic.{name}", "record five or more unloaded frames"
                )
            return noise
        if requested:
            frames = shared_frames(noise, recording)
            errors, resting = shared_errors(scene, frames), frames.resting
        elif sizes is None or not sizes.size(READINGS):
            return noise
        else:
            errors = SharedErrors(Possible(sizes), {}, significant=(READINGS,))
            # without unloaded frames, loads count as scatter of the cells
            resting = readings[unloaded if unloaded.any() else slice(None)].mean()
        possible = _known_at_rest(errors, scene, resting, noise.resting_cells)
        noise = noise.with_errors(possible, scene)
        for name in requested:
            if name in errors.sizes:
                noise = noise.determined(f"systematic.{name}", errors.sizes[name])
            else:
                reason = errors.undetermined or shared_effect_of(name).if_undetermined
                noise = noise.undetermined(f"systematic.{name}", reason)
        return noise

    def stated(self, scene: Scene, keys: Sequence[str], noise: NoiseEstimate) -> Scene:
        """Return the scene with the sizes of the posterior, or of the prior where there is none."""
        systematic = scene.systematic
        assert isinstance(systematic, Systematic)
        sizes = noise.possible_errors.sizes if noise.possible_errors else systematic_of(scene)
        if noise.possible_errors is not None:
            scene = noise.possible_errors.corrected(scene)
        stated = dict[str, Any]()
        for key in keys:
            name = key.removeprefix("systematic.")
            size = None if sizes is None else sizes.entry(name)
            stated[name] = None if size is None else self.allowed(scene, key, size)
        return replace(scene, systematic=systematic.with_entries(stated))

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield advice on errors one after the other, by their evidence beside those before.

        Channels make cells rougher, too, as errors of each reading do: the one that gains more
        comes first, and the other counts if it gains beside it.
        """
        recording = prepared.cleaned.recording
        noise = prepared.noise
        scene = recording.scene
        if noise.readings.sigma is None or not np.any(recording.role == UNLOADED):
            return
        if noise.panels is not None and not noise.panels.clear:
            return  # another one of the panels that read alike may be meant
        # without the error of the model: the same misses would count for it and for errors of the
        # readings
        noise = noise.with_sigma(noise.readings.sigma / noise.model_factor)
        frames = shared_frames(noise, recording)
        few = frames.resting.plain[scene.requested].mean() < MIN_SHARE_READ
        while frames.resting.value.size <= MAX_CELLS and not few:
            gains = {
                error.setting: _gain_beside(estimating(scene, error.setting), frames, error)
                for error in shared_effects()
                if error.is_advised and specified(scene, f"systematic.{error.setting}") is None
            }
            setting = max(gains, key=lambda name: gains[name], default="")
            if not gains.get(setting, 0.0) > DOUBTFUL_GAIN:
                return
            scene = estimating(scene, setting)
            key = f"systematic.{setting}"
            yield Unnamed.of(shared_effect_of(setting).sentence, key)


def estimating(scene: Scene, setting: str) -> Scene:
    """Return the scene with an error that it calls `estimated`."""
    sizes = scene.systematic if isinstance(scene.systematic, Systematic) else Systematic()
    return replace(scene, systematic=sizes.with_entries({setting: ESTIMATED}))


def _gain_beside(scene: Scene, frames: SharedFrames, error: SharedEffect) -> float:
    """Return the decrease of −2 ln evidence by an error beside the others of a scene.

    Errors of each reading are tried coarsely first: most recordings show none.
    """
    fit = frames.fit
    # Near a fold of the readings noise moves cells by more, and linear theory does not hold.
    if fit and not np.median(np.sqrt(np.diag(fit.covariance))) < LINEAR_LIMIT:
        return 0.0
    if error.setting == READINGS and estimated_errors(scene) == (error.setting,):
        prior = systematic_of(scene) or Systematic()
        moves = shared_changes(scene, frames, prior)
        tried = READING_ERRORS[COARSE]
        coarse = unloaded_costs(scene, frames.resting, frames.fit, tried)[0]
        coarse = coarse + _costs_of_errors(moves, COARSE)[0, COARSE]
        if coarse[0] - coarse.min() < COARSE_GAIN:
            return 0.0
    errors = shared_errors(scene, frames, error.setting)
    if error.setting in errors.gains:
        return errors.gains[error.setting]
    if error.setting not in errors.sizes:
        return 0.0
    sizes = errors.possible.sizes
    moves = shared_changes(scene, frames, sizes)
    gain = 0.0 if moves is None else gain_of(moves, sizes, error.setting)
    return gain if gain > MIN_EVIDENCE_GAIN else 0.0
