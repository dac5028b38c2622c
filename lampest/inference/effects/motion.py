"""Motion within a scan: loads that move while the readings of a frame are taken.

The readings are taken one after the other. A reading is taken at its own delay from the middle of
the frame, and the load has moved by then. The load displaces all readings of a frame along one
known direction: the steps between frames, times each reading's delay, times the share of the time
between frames that a scan takes. The readings are interpolated to the middle of the scan. Cells
that no load touches determine the share: a wrong one makes them move. So do errors that a reading
has in all frames, because a load changes their effect on the cells: the share is sought jointly
with their size where that is unknown. Errors that the readings of a frame share, such as a ripple
that the scene names, are part of the covariance.

A load that trembles faster than frames are taken displaces each reading along the change that the
load makes, by a random share of relative size q: σ grows by q times that change, and all readings
of a frame share the load's deviation at the middle of the scan. Still cells tell q, jointly with
the share.

The displacement has errors, too, where a load moves unevenly between two frames. The still cells
then seem stillest at less than the scan's share, as the slope of a regression is attenuated by
errors of its variable (Fuller, Measurement Error Models, 1987, section 1.1).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import MIN_EVIDENCE_GAIN, NOISE_REACH
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CellsFit, fitted, well_determined
from lampest.inference.effects.effect import Gathered, SceneEffect, Unnamed, estimated_entry
from lampest.inference.evidence import MOVED_COST, Changes, mostly_still, usual_starts
from lampest.inference.noise import NoiseEstimate, Share
from lampest.inference.nuisances import Besides
from lampest.inference.number import Number, summed_out
from lampest.inference.pair import FittedPair
from lampest.inference.variance_components import NO_RIPPLE
from lampest.panel.effects import estimated_errors, own_errors
from lampest.panel.effects.motion import SHARES, TREMBLING_ODDS, TREMBLINGS, LoadMotion
from lampest.panel.effects.reading_error import READING_ERROR
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.gaussian import Information
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings
from lampest.recording.recording import MAX_NEIGHBOURS, MEASURED, UNLOADED, Recording

# Sizes of each reading's own error that are tried beside a share, all equally probable.
READING_ERRORS = (0.0, 1e-3, 3e-3, 1e-2, 3e-2)
# Of a gain of interest: what a motion has alone where only both a share and a trembling reach it.
PROMISING = 0.25
# Probability of a steady load below which trembling is shown: that of NOISE_REACH in a normal
# distribution.
STEADY_ODDS = 0.0027
LOADED_SHARE = 0.15  # of the largest change: a cell that changes by more is under the load
# Error of a value interpolated between two frames, over √(τ(1 − τ)) times the second difference of
# the frames: 0.7 for a change at once, 0.2 to 0.4 for one that takes a frame or longer.
INTERPOLATION_ERROR = 0.5


# Of a scan of which nothing is known: it may take the whole time, and readings stay as they are.
UNKNOWN_SHARE = Share(mean=0.0, deviation=1.0, reach=0.0)


def _steps(readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps of each reading from the previous and to the next measured frame.

    Their shape is (2, frames, …). The first and the last frame have one neighbour, and its step
    twice; frames that are not measured have 0.
    """
    steps = np.zeros((2, *readings.value.shape))
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    return steps


class Displacement(NamedTuple):
    """Displacement of each reading by motion, if a scan takes the whole period.

    Attributes
    ----------
    value : array
        Displacement, in the shape and unit of the readings.
    doubt : array
        Its standard deviation beside noise.
    weight : array
        Share of the neighbouring frame in a reading less its displacement.
    """

    value: Array
    doubt: Array
    weight: Array

    @property
    def smooth(self) -> Array:
        """Doubt of a motion without jumps: √(|τ|/(1 − |τ|)) times the doubt."""
        return np.asarray(self.doubt * np.sqrt(self.weight / (1 - self.weight)))


def displacement(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Displacement:
    """Return the displacement of each reading by motion, if a scan takes the whole period.

    A reading that was taken late is displaced by τ times the step from the previous frame, an early
    one by τ times the step to the next frame: a reading less its displacement is between two
    measured ones. The doubt is √(|τ|(1 − |τ|)) times the difference of both steps beyond its noise,
    times INTERPOLATION_ERROR, and √2 times that of the nearest frame where a frame has one
    neighbour. Readings that are no values, or whose neighbours in time are none, are not displaced;
    their doubt is the larger step.
    """
    steps = _steps(readings, measured)
    # Delay of each reading from the middle of its frame, in periods
    channels = readings.value[0].size
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    delay = in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))
    previous, following = steps * delay
    displaced = np.where(delay > 0, previous, following)
    between = np.sqrt(np.abs(delay) * (1 - np.abs(delay)))
    noise = np.zeros(1) if readings.sigma is None else readings.sigma
    # The difference of both steps is that of three frames, with the weights 1, −2 and 1.
    beyond_noise = np.maximum((steps[1] - steps[0]) ** 2 - 6 * noise**2, 0.0)
    doubt = INTERPOLATION_ERROR * between * np.sqrt(beyond_noise)
    if len(measured) > 2:
        doubt[measured[[0, -1]]] = np.sqrt(2) * doubt[measured[[1, -2]]]
    plain = readings.plain[measured]
    around = np.concatenate([plain[:1], plain, plain[-1:]])
    interpolated = np.zeros(displaced.shape, dtype=bool)
    if len(measured) > 2:
        interpolated[measured] = around[:-2] & plain & around[2:]
    larger_step = np.maximum(np.abs(previous), np.abs(following))
    return Displacement(
        np.where(interpolated, displaced, 0.0),
        np.where(interpolated, doubt, larger_step),
        np.where(interpolated, np.abs(delay), 0.0),
    )


def share_of_motion(
    recording: Recording,
    readings: Readings,
    errors_tried: Sequence[float],
    shares: Array = SHARES,
    *,
    least_gain: float = 0.0,
    frame_noise: FrameNoise | None = None,
    resting_cells: Array | None = None,
) -> Share | None:
    """Return the share of the time between frames that a scan takes, and the load's trembling.

    The result is None where it is unknown. A load that moves displaces all readings of a frame
    along one known direction, by share · displacement. Cells that no load touches seem to move by K
    times as much, K the inverse of the Jacobian. The evidence of the changes since rest is compared
    over `shares`, all equally probable before, for the frames with the largest motion, and summed
    over TREMBLINGS and sizes of each reading's own error. The reach is the share over the
    reliability of the displacements, 1 − Σ errors²/Σ displacements², at most the whole time.

    Parameters
    ----------
    recording : Recording
        With unloaded frames.
    readings : Readings
        All frames.
    errors_tried : sequence of float
        Sizes of each reading's own error, the same in all frames: READING_ERRORS where it is
        unknown, (0.0,) where the readings have none beside their σ.
    shares : array
        Shares that are tried; one alone is known.
    least_gain : float
        Gain in −2 ln evidence that is of interest. The result is None where no share without a
        trembling, and no trembling without a share, gains PROMISING of it.
    frame_noise : FrameNoise or None
        Errors that the readings of a frame share, such as a ripple: they, too, move all cells.
    """
    moving = _moving_frames(recording, readings, frame_noise, resting_cells)
    first = errors_tried[0]
    alone = [(first, share, 0.0) for share in shares.tolist()]
    alone += [(first, 0.0, trembling) for trembling in TREMBLINGS[1:].tolist()]
    if least_gain and _gain_of(moving, alone) < PROMISING * least_gain:
        return None
    # Those without trembling first: the search for moved cells begins with them.
    tried = [
        (size, share, trembling)
        for trembling, size, share in product(TREMBLINGS.tolist(), errors_tried, shares.tolist())
    ]
    frames = [frame.explained_by(tried) for frame in moving]
    compared = [frame for frame in frames if frame.is_mostly_still]
    # A load on most cells, such as a hand, is like one that trembles: it is no reason for advice.
    if not compared and not least_gain:
        compared = [frame for frame in frames if frame.trembles]
    if not compared:
        return None
    costs = np.array(
        [_joint_cost([frame.explained[key] for frame in compared]) for key in tried]
    ).reshape(len(TREMBLINGS), len(errors_tried), len(shares))
    costs = np.moveaxis(costs, 0, 2)
    trembling, still = 0.0, 1.0
    if all(frame.shows_trembling for frame in compared):
        by_trembling = Number.by_costs(TREMBLINGS, costs, TREMBLING_ODDS, axis=2)
        trembling = float(np.sqrt(by_trembling.mean_square))
        still = float(by_trembling.odds[0])
        costs -= 2 * np.log(TREMBLING_ODDS)
    else:
        costs = costs[:, :, :1]
    none = float(summed_out(costs[:, 0, 0], axis=0))
    gain = none - float(summed_out(costs, axis=0).min())
    if len(shares) == 1:
        known = float(shares[0])
        return Share(known, 0.0, known, gain, trembling, still)
    number = Number.by_costs(shares, costs, axis=1)
    steady = Number.by_costs(shares, costs[:, :, :1], axis=1)
    # Below the smallest share any share may be the whole time.
    displacements = sum(frame.displacements for frame in compared)
    errors = sum(frame.errors for frame in compared)
    reliable = max(displacements - errors, shares[1] * displacements)
    unattenuated = np.minimum(shares * displacements, shares[-1] * reliable)
    # A share that trembling hides remains possible.
    reach = number.mean
    if reliable:
        reach = max(float(of.odds @ unattenuated) / reliable for of in (number, steady))
    # The share of the scan is anywhere between both.
    deviation = float(np.hypot(number.deviation, (reach - number.mean) / np.sqrt(3)))
    return Share(number.mean, deviation, reach, gain, trembling, still)


def _moving_frames(
    recording: Recording,
    readings: Readings,
    frame_noise: FrameNoise | None,
    resting_cells: Array | None,
) -> "list[_Moving]":
    """Return the frames with the largest motion whose cells are determined well.

    The list is empty where a frame has no fit, and on panels of more than MAX_CELLS. The arguments
    are those of `share_of_motion`.
    """
    scene = recording.scene
    resting = readings[recording.role == UNLOADED].mean()
    measured = np.flatnonzero(recording.role == MEASURED)
    inner = measured[1:-1]
    known = readings.sigma is not None and resting.sigma is not None
    if not len(inner) or not known or scene.panel.crossings > MAX_CELLS:
        return []
    moved = displacement(scene, readings, measured)
    size = np.sqrt(np.mean((moved.value / readings.known_sigma) ** 2, axis=(1, 2)))
    base = fitted(scene, resting, resting_cells, patient=True)
    moving = list[_Moving]()
    near = resting_cells
    for number in inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]:
        fit = fitted(scene, readings[number], near, patient=True)
        if base is None or fit is None:
            return []
        near = fit.cells
        if well_determined((base, fit)):
            displaced = Displacement(*(part[number] for part in moved))
            moving.append(_Moving((base, fit), displaced, frame_noise))
    return moving


def _mostly_still(moving: "Sequence[_Moving]", tried: "Sequence[Motion]") -> "list[_Frame]":
    """Return the frames with each motion that leave most cells still."""
    frames = (frame.explained_by(tried) for frame in moving)
    return [frame for frame in frames if frame.is_mostly_still]


def _gain_of(moving: "Sequence[_Moving]", tried: "Sequence[Motion]") -> float:
    """Return the gain of the best motion over the first one in −2 ln evidence; 0 without frames."""
    compared = _mostly_still(moving, tried)
    if not compared:
        return 0.0
    costs = [_joint_cost([frame.explained[key] for frame in compared]) for key in tried]
    return costs[0] - min(costs)


class _Explained(NamedTuple):
    """Changes of a frame with a size of each reading's own error, a share and a trembling.

    Attributes
    ----------
    cost : float
        −2 ln evidence of the frame alone.
    change : array, shape (cells,)
        d.
    noise : array, shape (cells, cells)
        Covariance of d that no other frame shares, with the freedom of moved cells.
    shared : array, shape (cells, n)
        Columns of the errors that all frames share: of each reading, and of the unloaded panel.
    beside : float
        −2 ln of the prior of the moved cells, and of the Jacobian of the interpolation.
    """

    cost: float
    change: Array
    noise: Array
    shared: Array
    beside: float


# Size of each reading's own error, share, and trembling.
Motion = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame with each size of errors, share and trembling.

    Attributes
    ----------
    explained : mapping of (float, float, float) to _Explained
        By size of errors, share and trembling.
    is_mostly_still : bool
        Whether most cells are still under the likeliest of them without trembling.
    trembles : bool
        Whether they are still and without a load with trembling alone.
    shows_trembling : bool
        Whether most cells are still and without a load. Otherwise trembling explains any motion.
    displacements, errors : float
        Σ of squared displacements and of their squared doubts, in σ².
    """

    explained: Mapping[Motion, _Explained]
    is_mostly_still: bool
    trembles: bool
    shows_trembling: bool
    displacements: float
    errors: float


@dataclass(frozen=True, eq=False)
class _Moving:
    """A frame of a load that moves.

    Attributes
    ----------
    fits : tuple of two CellsFit
        Those of the unloaded panel and of the frame.
    displaced : Displacement
        That of the frame, (rows, columns).
    frame_noise : FrameNoise or None
        Errors that the readings of a frame share.
    """

    fits: tuple[CellsFit, CellsFit]
    displaced: Displacement
    frame_noise: FrameNoise | None

    @cached_property
    def _changes(self) -> Changes:
        """The changes since rest without motion."""
        pair = FittedPair(self.fits)
        changes = pair.with_columns(pair.columns(()))
        if self.frame_noise is None:
            return changes
        by_error = (
            fit.gain @ self.frame_noise.columns(fit.readings.value[None], baseline=baseline)
            for fit, baseline in zip(self.fits, (True, False), strict=True)
        )
        covariance = sum((part @ part.T for part in by_error), changes.noise)
        return replace(changes, noise=covariance)

    @cached_property
    def _of_readings(self) -> Array:
        """A = K_f U_f − K_b U_b of errors of one, the same in both frames, (cells, readings)."""
        resting, frame = (
            fit.gain * own_errors(fit.readings.value, fit.scene, 1.0).ravel() for fit in self.fits
        )
        return np.asarray(frame - resting)

    @cached_property
    def _square_of_readings(self) -> Array:
        """A Aᵀ of these errors, (cells, cells)."""
        return np.asarray(self._of_readings @ self._of_readings.T)

    @cached_property
    def _by_motion(self) -> Array:
        """Change of the log cells by the displacement, (cells,)."""
        return self.fits[1].response(self.displaced.value[None])[:, 0]

    def _changes_by(self, motion: Motion, *, doubted: bool) -> Changes:
        """Return the changes with a motion, whose interpolation is `doubted` or exact."""
        size, share, trembling = motion
        resting, frame = self.fits
        noise = frame.readings.known_sigma.ravel()
        weight = self.displaced.weight.ravel()
        by_load = (frame.readings.value - resting.readings.value).ravel()
        # A reading's variance beyond its noise: of the mean with the neighbouring frame, of the
        # trembling load, and of the interpolation.
        remaining = (1 - share * weight) ** 2 + (share * weight) ** 2
        variance = (trembling * by_load) ** 2 - noise**2 * (1 - remaining)
        if doubted:
            # The evidence takes motion as smooth: a wider doubt would favour small shares.
            variance += (share * self.displaced.smooth.ravel()) ** 2
        covariance = self._changes.noise
        if variance.any():
            covariance = covariance + (frame.gain * variance) @ frame.gain.T
        if size:
            covariance = covariance + size**2 * self._square_of_readings
        return replace(
            self._changes,
            change=self._changes.change - share * self._by_motion,
            noise=covariance,
        )

    def _still_and_free(self, motion: Motion) -> tuple[bool, bool]:
        """Return whether most cells are still under a motion, and whether they have no load.

        A load that trembles may move any cell that changed as loaded ones do.
        """
        exact = self._changes_by(motion, doubted=False)
        moved = exact.selected(usual_starts(exact.change))[1]
        change = np.abs(exact.change - np.median(exact.change))
        loaded = change > LOADED_SHARE * change.max()
        return mostly_still(moved), mostly_still(moved | loaded)

    def explained_by(self, tried: Sequence[Motion]) -> _Frame:
        """Return the frame with each motion, of which some have no trembling.

        A reading y less its displacement, z = (1 − w) y + w yₙ, is a mean with the neighbouring
        frame. Its variance is σ²((1 − w)² + w²), and p(y) = (1 − w) p(z): without both, every mean
        of frames would seem to be motion. Cells count as still without the doubt of the
        interpolation: with it, everything may be still.

        Parameters
        ----------
        tried : sequence of (float, float, float)
            Relative standard deviation of each reading's own error, share, and trembling.
        """
        resting, frame = self.fits
        weight = self.displaced.weight.ravel()
        unloaded = resting.covariance + ASSUMED.creep**2 * np.eye(len(weight))
        of_unloaded = np.linalg.cholesky(unloaded)
        explained = {}
        starts = usual_starts(self._changes.change)
        for key in tried:
            size, share, _ = key
            changes = self._changes_by(key, doubted=True)
            cost, moved = changes.selected(starts)
            # Further searches begin at the moved cells of the numbers before.
            starts = [moved]
            # Moved cells are free, and take as many readings out of the density.
            jacobian = -2 * (1 - np.mean(moved)) * np.sum(np.log(1 - share * weight))
            shared = of_unloaded
            covariance = changes.covariance + np.diag(1.0 * moved) - unloaded
            if size:
                shared = np.column_stack([size * self._of_readings, of_unloaded])
                covariance -= size**2 * self._square_of_readings
            explained[key] = _Explained(
                cost + jacobian,
                changes.change,
                covariance,
                shared,
                MOVED_COST * int(moved.sum()) + jacobian,
            )

        steady = [key for key in tried if not key[2]]
        still, free = self._still_and_free(min(steady, key=lambda key: explained[key].cost))
        trembles = False
        if not still:
            # Where a load trembles, cells stand still under no steady motion.
            likeliest = min(tried, key=lambda key: explained[key].cost)
            trembles = free = self._still_and_free(likeliest)[1]
        noise = frame.readings.known_sigma
        return _Frame(
            explained,
            still,
            trembles,
            free,
            float(np.sum((self.displaced.value / noise) ** 2)),
            float(np.sum((self.displaced.smooth / noise) ** 2)),
        )


def _joint_cost(frames: Sequence[_Explained]) -> float:
    """Return −2 ln evidence of frames that share errors z ~ N(0, 1), d_f = B_f z + noise_f."""
    first, *others = (Information.of(frame.shared, frame.noise, frame.change) for frame in frames)
    joint = sum(others, first)
    return joint.evidence_cost + sum(frame.beside for frame in frames)


def interpolated(noise: NoiseEstimate, recording: Recording, share: Share) -> NoiseEstimate:
    """Return the noise with readings that are interpolated to the middle of their scan.

    Their σ contains the errors of the interpolation and of the load's trembling.

    Parameters
    ----------
    noise : NoiseEstimate
    recording : Recording
    share : Share
        Share of the time between frames that a scan takes, and the load's trembling.
    """
    readings = noise.readings
    measured = np.flatnonzero(recording.role == MEASURED)
    unloaded = recording.role == UNLOADED
    displaced, doubt, weight = displacement(recording.scene, readings, measured)
    noise_variance = readings.known_sigma**2
    # A reading less its displacement is a mean of two frames, whose noise is independent.
    own = noise_variance * ((1 - share.mean * weight) ** 2 + (share.mean * weight) ** 2)
    moved = np.maximum(displaced**2 - 2 * noise_variance * weight**2, 0.0)
    variance = own + (share.reach * doubt) ** 2 + share.deviation**2 * moved
    frame = noise.frame
    if share.trembling and unloaded.any():
        resting = readings[unloaded].mean().value
        by_load = np.zeros(readings.value.shape)
        by_load[measured] = readings.value[measured] - resting
        variance += share.trembling**2 * np.maximum(by_load**2 - noise_variance, 0.0)
        frame = frame or FrameNoise(recording.scene, int(unloaded.sum()), 0.0, NO_RIPPLE, NO_RIPPLE)
        frame = replace(frame, trembling=share.trembling, resting=resting)
    readings = replace(
        readings, value=readings.value - share.mean * displaced, sigma=np.sqrt(variance)
    )
    return replace(noise, readings=readings, motion=share, frame=frame)


class ScanMotion(SceneEffect):
    """Loads that move while a frame is scanned: `motion`."""

    if_unexplained = "loads may move while a frame is scanned"
    if_unexplained_key = "motion"

    def resolve(
        self, noise: NoiseEstimate, recording: Recording, besides: Besides
    ) -> NoiseEstimate:
        """Interpolate the readings to the middle of their scan."""
        scene = recording.scene
        readings = noise.readings
        measured = np.flatnonzero(recording.role == MEASURED)
        share = scene.motion
        if readings.sigma is None or share is None or len(measured) < 2:
            if share == ESTIMATED:
                noise = noise.undetermined(
                    "motion", "record five unloaded frames, and several of a load that moves"
                )
            return noise
        known = None if share == ESTIMATED else float(share)
        if known == 0:
            return noise
        unloaded = recording.role == UNLOADED
        unknown_errors = READING_ERROR.setting in estimated_errors(scene)
        size = None
        if unloaded.any():
            size = share_of_motion(
                recording,
                readings,
                READING_ERRORS if unknown_errors else (0.0,),
                SHARES if known is None else np.array([known]),
                frame_noise=noise.frame,
                resting_cells=noise.resting_cells,
            )
        if known is not None:
            return interpolated(noise, recording, size or Share(known, 0.0, known))
        if size is None:
            return interpolated(noise, recording, UNKNOWN_SHARE).undetermined(
                "motion",
                "no frame has still cells beside a load that moves. "
                "Error bars allow for any share of the time between frames; give the share, "
                "or record five unloaded frames and a load that leaves most cells free",
            )
        return interpolated(noise, recording, size).determined(
            "motion", (size.mean, size.deviation)
        )

    def as_the_whole(
        self, noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate
    ) -> NoiseEstimate:
        """Interpolate the readings with the share of the whole recording."""
        if whole.motion is None or noise.readings.sigma is None:
            return noise
        return interpolated(noise, recording, whole.motion)

    def unnamed(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Yield advice on loads that move while a frame is scanned."""
        readings = evidence.noise.readings
        unloaded = evidence.unloaded
        if readings.sigma is None or not unloaded.any() or not evidence.names_none("motion"):
            return
        named = isinstance(specified(evidence.scene, "systematic.reading_error"), float)
        compared = (evidence.recording, readings)
        known: dict[str, Any] = {
            "frame_noise": evidence.noise.frame,
            "resting_cells": evidence.noise.resting_cells,
        }
        share = share_of_motion(*compared, (0.0,), least_gain=MIN_EVIDENCE_GAIN, **known)
        # Errors of readings explain some of what seems to be motion: they are tried where some is.
        if share is not None and share.gain > MIN_EVIDENCE_GAIN and not named:
            share = share_of_motion(*compared, READING_ERRORS, **known)
        if share is None or not share.gain > MIN_EVIDENCE_GAIN:
            return
        yield Unnamed(_in_words, estimated_entry("motion"))


def _in_words(noise: NoiseEstimate) -> str:
    """Return the motion of a recording that determines it, in words; '' elsewhere."""
    share = noise.motion
    if share is None or "motion" not in noise.estimated:
        return ""
    if share.steady < STEADY_ODDS and share.mean < NOISE_REACH * share.deviation:
        return LoadMotion().trembling_sentence(share.trembling)
    return LoadMotion().sentence(share.mean, share.deviation)
