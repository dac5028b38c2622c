"""Motion within a scan: loads that move while the readings of a frame are taken.

The readings are taken one after the other. A reading is taken at its own delay from the middle of
the frame, and the load has moved by then. The load displaces all readings of a frame along one
known direction: the steps between frames, times each reading's delay, times the share of the time
between frames that a scan takes. The readings are interpolated to the middle of the scan. Cells
that no load touches determine the share: a wrong one makes them move. So do errors that a reading
has in all frames, because a load changes their effect on the cells: the share is sought jointly
with their size where that is unknown. Errors that the readings of a frame share, such as a ripple
that the scene names, are part of the covariance.

A load that jitters faster than frames are taken displaces each reading along the change that the
load makes, by a random share of relative size q: σ grows by q times that change, and all readings
of a frame share the load's deviation at the middle of the scan. Still cells tell q, jointly with
the share.

Share, q² and the variance of each reading's own error are θ. With the changes d of still cells in
all frames, r = d − share · m and the covariance V(θ) of r, the derivatives of −ln evidence are

    gradient = −mᵀ V⁻¹ r [of the share] + ½ tr(V⁻¹ V_i) − ½ rᵀ V⁻¹ V_i V⁻¹ r,
    normal   = mᵀ V⁻¹ m [of the share] + ½ tr(V⁻¹ V_i V⁻¹ V_k),   V_i = ∂V/∂θ_i,

of which the second are expected ones (Fisher scoring; Harville, JASA 72, 1977). Gauss–Newton steps
begin without motion, and with half of the largest one.

The displacement has errors, too, where a load moves unevenly between two frames. The still cells
then seem stillest at less than the scan's share, as the slope of a regression is attenuated by
errors of its variable (Fuller, Measurement Error Models, 1987, section 1.1).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from lampest.files.levels import MIN_EVIDENCE_GAIN, NOISE_REACH
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CellsFit, fitted, well_determined
from lampest.inference.effects.effect import SceneEffect, Unnamed, estimated_entry, names_none
from lampest.inference.evidence import MOVED_COST, Changes, mostly_still, usual_starts
from lampest.inference.noise import NoiseEstimate, Share
from lampest.inference.nuisances import Besides
from lampest.inference.number import is_significant
from lampest.inference.pair import FittedPair
from lampest.inference.prepared import Prepared
from lampest.panel.effects import READINGS, estimated_errors, own_errors
from lampest.panel.effects.motion import JITTERS, LoadMotion
from lampest.panel.least_squares import LevenbergMarquardt
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.scan_order import in_panel_order
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import inverse_and_volume
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings
from lampest.recording.recording import MAX_NEIGHBOURS, MEASURED, UNLOADED, Recording
from lampest.solvers.hessian import block_diagonal

# Largest variance of each reading's own error beside a motion: larger ones explain any load.
MAX_OWN_VARIANCE = 0.03**2
# Steps of share, jitter² and own error²; a tenth of −ln evidence moves no share by half of its
# standard deviation.
SCORING = LevenbergMarquardt(evaluations=12, settled=0.1, damping=0.0)
# Least reliability of displacements: below it a share may be the whole time.
MIN_RELIABILITY = 0.2
POINTS = 201  # of a posterior over the shares
# Probability of a steady load below which jitter is shown: that of NOISE_REACH in a normal
# distribution.
STEADY_ODDS = 0.0027
LOADED_SHARE = 0.15  # of the largest change: a cell that changes by more is under the load
# Error of a value interpolated between two frames, over √(τ(1 − τ)) times the second difference of
# the frames: 0.7 for a change at once, 0.2 to 0.4 for one that takes a frame or longer.
INTERPOLATION_ERROR = 0.5


# Of a scan of which nothing is known: it may take the whole time, and readings stay as they are.
UNKNOWN_SHARE = Share(mean=0.0, deviation=1.0, reach=0.0)


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
        return self.doubt * np.sqrt(self.weight / (1 - self.weight))


def displacement(scene: Scene, readings: Readings, measured: Numbers) -> Displacement:
    """Return the displacement of each reading by motion, if a scan takes the whole period.

    A reading that was taken late is displaced by τ times the step from the previous frame, an early
    one by τ times the step to the next frame: a reading less its displacement is between two
    measured ones. The doubt is √(|τ|(1 − |τ|)) times the difference of both steps beyond its noise,
    times INTERPOLATION_ERROR, and √2 times that of the nearest frame where a frame has one
    neighbour. Readings that are no values, or whose neighbours in time are none, are not displaced;
    their doubt is the larger step.
    """
    # Steps of each reading from the previous and to the next measured frame, (2, frames, …). The
    # first and the last frame have one neighbour, and its step twice.
    steps = np.zeros((2, *readings.value.shape))
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
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
    known: float | None = None,
    *,
    unknown_errors: bool = False,
    may_jitter: bool = True,
    frame_noise: FrameNoise | None = None,
    resting_cells: Array | None = None,
) -> Share | None:
    """Return the share of the time between frames that a scan takes, and the load's jitter.

    The result is None where it is unknown. A load that moves displaces all readings of a frame
    along one known direction, by share · displacement. Cells that no load touches seem to move by K
    times as much, K the inverse of the Jacobian. Share, jitter and the readings' own errors have
    the largest evidence of the changes since rest, in the frames with the largest motion.

    Parameters
    ----------
    recording : Recording
        With unloaded frames.
    readings : Readings
        All frames.
    known : float or None
        The share, where it is known.
    unknown_errors : bool
        Whether each reading has an error of its own of unknown size, the same in all frames.
    may_jitter : bool
        Whether the load may jitter.
    frame_noise : FrameNoise or None
        Errors that the readings of a frame share, such as a ripple: they, too, move all cells.
    """
    shares = (0.0, 1.0) if known is None else (known, known)
    moving = moving_frames(recording, readings, frame_noise, resting_cells)
    if not moving:
        return None
    search = MotionSearch(moving, MAX_OWN_VARIANCE if unknown_errors else 0.0)
    steady = search.likeliest(shares)
    compared = [frame for frame in moving if frame.still_and_free(steady.position)[0]]
    shows_jitter = may_jitter and all(
        frame.still_and_free(steady.position)[1] for frame in compared
    )
    if not compared and may_jitter:
        # Where a load jitters, cells stand still under no steady motion.
        jitter = search.likeliest(shares, JITTERS)
        compared = [frame for frame in moving if frame.still_and_free(jitter.position)[1]]
    if not compared:
        return None
    if len(compared) < len(moving):
        search = replace(search, moving=compared)
        steady = search.likeliest(shares)
    likely = [steady]
    if shows_jitter:
        likely.append(search.likeliest(shares, JITTERS))
    return _share(search, likely, known)


def _share(
    search: "MotionSearch", likely: "Sequence[MotionEvidence]", known: float | None
) -> Share:
    """Return the share by the likeliest motion without jitter, then with one if it may be.

    The reach is the share over the reliability of the displacements,
    1 − Σ errors²/Σ displacements², at most the whole time. A share that jitter hides remains
    possible.
    """
    log_odds = np.array([motion.log_evidence for motion in likely])
    odds = np.exp(log_odds - log_odds.max())
    odds /= odds.sum()
    means, deviations = np.array(
        [motion.share if known is None else (known, 0.0) for motion in likely]
    ).T
    mean = float(odds @ means)
    spread = float(np.sqrt(odds @ (deviations**2 + (means - mean) ** 2)))
    errors, displacements = np.sum([frame.errors_and_displacements for frame in search.moving], 0)
    reliability = max(1 - errors / displacements, MIN_RELIABILITY) if displacements else 1.0
    reach = max(mean, min(float(means.max()) / reliability, 1.0)) if known is None else known
    # The share of the scan is anywhere between both.
    deviation = float(np.hypot(spread, (reach - mean) / np.sqrt(3)))
    if known is None and not is_significant(mean, spread, 1.0):
        mean, deviation = 0.0, float(np.hypot(mean, deviation))
    return Share(
        mean,
        deviation,
        reach,
        2 * (search.likeliest((0.0, 0.0)).cost - likely[0].cost),
        float(np.sqrt(odds @ [motion.position[1] for motion in likely])),
        float(odds[0]),
    )


class MotionEvidence(NamedTuple):
    """Evidence of frames about a motion, as a linearised sum of squares.

    Attributes
    ----------
    position : array, shape (3,)
        Share, jitter², and variance of each reading's own error.
    cost : float
        −ln evidence.
    gradient, normal : array, shapes (3,) and (3, 3)
        Its first derivatives, and the expected second ones.
    """

    position: Array
    cost: float
    gradient: Array
    normal: Array

    @property
    def share(self) -> tuple[float, float]:
        """Posterior mean and standard deviation of the share, normal within the limits."""
        share = float(self.position[0])
        centre = share - float(self.gradient[0] / self.normal[0, 0])
        deviation = float(np.sqrt(1 / self.normal[0, 0]))
        below, above = np.clip([centre - 6 * deviation, centre + 6 * deviation], 0.0, 1.0)
        tried = np.linspace(below, above, POINTS)
        cost = ((tried - centre) / deviation) ** 2
        odds = np.exp((cost.min() - cost) / 2)
        mean = float(odds @ tried / odds.sum())
        return mean, float(np.sqrt(odds @ (tried - mean) ** 2 / odds.sum()))

    @property
    def log_evidence(self) -> float:
        """Logarithm of the evidence, with a prior of the jitter uniform in its logarithm."""
        squared = float(self.position[1])
        if not squared:
            return -self.cost
        deviation = 0.5 / (squared * np.sqrt(self.normal[1, 1]))
        width = min(np.sqrt(2 * np.pi) * deviation / np.log(JITTERS[1] / JITTERS[0]), 1.0)
        return float(np.log(width)) - self.cost


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """Search for the motion of largest evidence.

    Attributes
    ----------
    moving : sequence of MovingFrame
        Frames, which share the errors of the unloaded panel and of the readings.
    own : float
        Largest variance of each reading's own error.
    """

    moving: "Sequence[MovingFrame]"
    own: float

    def likeliest(
        self, shares: tuple[float, float], jitters: tuple[float, float] = (0.0, 0.0)
    ) -> MotionEvidence:
        """Return the motion of largest evidence between limits of the share and of jitter.

        The search begins without motion and with half of the largest one, without errors of
        readings and with the largest ones: more cells seem to have moved without either, and may
        hide it.
        """
        low = np.array([shares[0], jitters[0] ** 2, 0.0])
        high = np.array([shares[1], jitters[1] ** 2, self.own])
        ends = product(dict.fromkeys((shares[0], sum(shares) / 2)), dict.fromkeys((0.0, self.own)))
        starts = list[list[Mask]]()

        def model(position: Array) -> MotionEvidence:
            changes = [frame.changes_by(position) for frame in self.moving]
            both = zip(changes, starts, strict=True)
            moved = [of_frame.selected(start)[1] for of_frame, start in both]
            # Further searches begin at the moved cells of the motion before.
            starts[:] = [[of_frame] for of_frame in moved]
            return self.evidence(position, changes, moved)

        found = list[MotionEvidence]()
        for share, own in ends:
            starts[:] = [usual_starts(frame.changes.change) for frame in self.moving]
            begin = np.array([share, low[1], own])
            found.append(SCORING.minimum(model, begin, (low, high))[1])
        return min(found, key=lambda motion: motion.cost)

    def evidence(
        self, position: Array, changes: Sequence[Changes], moved: Sequence[Mask]
    ) -> MotionEvidence:
        """Return the evidence of changes, whose moved cells are free."""
        share, _, own = position
        weights = np.stack([frame.displaced.weight.ravel() for frame in self.moving])
        still = np.array([[1 - np.mean(cells)] for cells in moved])
        gains = [frame.fits[1].gain for frame in self.moving]
        by_share = np.concatenate([frame.by_motion for frame in self.moving])
        by_error = np.concatenate([frame.by_error for frame in self.moving])
        if not self.own:
            by_error = by_error[:, :0]
        # Errors of the unloaded panel and of the readings are those of all frames.
        unloaded = self.moving[0].unloaded
        apart = [
            of_frame.covariance + np.diag(1.0 * cells) - unloaded - own * frame.square_of_errors
            for frame, of_frame, cells in zip(self.moving, changes, moved, strict=True)
        ]
        covariance = block_diagonal(apart) + np.kron(np.ones((len(moved), len(moved))), unloaded)
        covariance += own * by_error @ by_error.T
        precision, volume = inverse_and_volume(covariance)
        residual = np.concatenate([of_frame.change for of_frame in changes])
        pull = precision @ residual
        # Moved cells are free, and take as many readings out of the density.
        jacobian = -2 * np.sum(still * np.log(1 - share * weights))
        count = sum(int(cells.sum()) for cells in moved)
        cost = float(residual @ pull - volume + MOVED_COST * count + jacobian) / 2
        # V_share and V_jitter are K diag(variances) Kᵀ, V_own is A Aᵀ; K has a block a frame.
        variances = np.concatenate([frame.slopes(share) for frame in self.moving], axis=1)
        of_readings = _by_blocks(gains, _by_blocks(gains, precision).T)
        of_errors = by_error.T @ (precision @ by_error)
        across = _by_blocks(gains, precision @ by_error)
        gradient = np.append(
            variances @ (np.diag(of_readings) - _by_blocks(gains, pull) ** 2),
            np.trace(of_errors) - np.sum((by_error.T @ pull) ** 2),
        )
        gradient[0] += 2 * np.sum(still * weights / (1 - share * weights)) - 2 * by_share @ pull
        normal = np.zeros((3, 3))
        normal[:2, :2] = variances @ of_readings**2 @ variances.T
        normal[2, :2] = normal[:2, 2] = variances @ np.sum(across**2, axis=1)
        normal[2, 2] = np.sum(of_errors**2) if self.own else 1.0
        normal[0, 0] += 2 * by_share @ precision @ by_share
        return MotionEvidence(position, cost, gradient / 2, normal / 2)


def _by_blocks(blocks: Sequence[Array], matrix: Array) -> Array:
    """Return Kᵀ A for a block-diagonal K, without its zeros."""
    ends = np.cumsum([len(block) for block in blocks])[:-1]
    parts = zip(blocks, np.split(matrix, ends), strict=True)
    return np.concatenate([block.T @ part for block, part in parts])


def moving_frames(
    recording: Recording,
    readings: Readings,
    frame_noise: FrameNoise | None,
    resting_cells: Array | None,
) -> "list[MovingFrame]":
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
    moving = list[MovingFrame]()
    near = resting_cells
    for number in inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]:
        fit = fitted(scene, readings[number], near, patient=True)
        if base is None or fit is None:
            return []
        near = fit.cells
        if well_determined((base, fit)):
            displaced = Displacement(*(part[number] for part in moved))
            moving.append(MovingFrame((base, fit), displaced, frame_noise))
    return moving


@dataclass(frozen=True, eq=False)
class MovingFrame:
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
    def changes(self) -> Changes:
        """The changes since rest without motion."""
        changes = FittedPair(self.fits).changes
        if self.frame_noise is None:
            return changes
        by_error = (
            fit.gain @ self.frame_noise.columns(fit.readings.value[None], baseline=baseline)
            for fit, baseline in zip(self.fits, (True, False), strict=True)
        )
        covariance = sum((part @ part.T for part in by_error), changes.noise)
        return replace(changes, noise=covariance)

    @cached_property
    def unloaded(self) -> Array:
        """Covariance of the changes by errors of the unloaded panel, (cells, cells)."""
        resting = self.fits[0].covariance
        return resting + ASSUMED.creep**2 * np.eye(len(resting))

    @cached_property
    def by_error(self) -> Array:
        """A = K_f U_f − K_b U_b of errors of one, the same in both frames, (cells, readings)."""
        resting, frame = (
            fit.gain * own_errors(fit.readings.value, fit.scene, 1.0).ravel() for fit in self.fits
        )
        return frame - resting

    @cached_property
    def square_of_errors(self) -> Array:
        """A Aᵀ of these errors, (cells, cells)."""
        return self.by_error @ self.by_error.T

    @cached_property
    def by_motion(self) -> Array:
        """Change of the log cells by the displacement, (cells,)."""
        return self.fits[1].response(self.displaced.value[None])[:, 0]

    @cached_property
    def _variances(self) -> Array:
        """Variances of the noise, of the doubt, and of the load's change by one, (3, readings)."""
        resting, frame = self.fits
        by_load = frame.readings.value - resting.readings.value
        noise = frame.readings.known_sigma
        return np.stack([noise, self.displaced.smooth, by_load]).reshape(3, -1) ** 2

    @property
    def errors_and_displacements(self) -> tuple[float, float]:
        """Σ of squared doubts and of squared displacements, in σ²."""
        noise, doubt, _ = self._variances
        return float(np.sum(doubt / noise)), float(
            np.sum(self.displaced.value.ravel() ** 2 / noise)
        )

    def slopes(self, share: float) -> Array:
        """Return ∂(variance of each reading)/∂(share, jitter²), (2, readings)."""
        noise, doubt, load = self._variances
        weight = self.displaced.weight.ravel()
        return np.stack([2 * noise * weight * (2 * share * weight - 1) + 2 * share * doubt, load])

    def changes_by(self, motion: Array, *, doubted: bool = True) -> Changes:
        """Return the changes with a motion, whose interpolation is `doubted` or exact.

        A reading y less its displacement, z = (1 − w) y + w yₙ, is a mean with the neighbouring
        frame. Its variance is σ²((1 − w)² + w²), and p(y) = (1 − w) p(z): without both, every mean
        of frames would seem to be motion.

        Parameters
        ----------
        motion : array, shape (3,)
            Share, jitter², and variance of each reading's own error.
        """
        share, jitter, own = motion
        weight = share * self.displaced.weight.ravel()
        noise, doubt, load = self._variances
        variance = jitter * load - 2 * noise * weight * (1 - weight)
        if doubted:
            # The evidence takes motion as smooth: a wider doubt would favour small shares.
            variance = variance + share**2 * doubt
        covariance = self.changes.noise
        gain = self.fits[1].gain
        if variance.any():
            covariance = covariance + (gain * variance) @ gain.T
        if own:
            covariance = covariance + own * self.square_of_errors
        change = self.changes.change - share * self.by_motion
        return replace(self.changes, change=change, noise=covariance)

    def still_and_free(self, motion: Array) -> tuple[bool, bool]:
        """Return whether most cells are still under a motion, and whether they have no load.

        A load that jitters may move any cell that changed as loaded ones do. Cells count as still
        without the doubt of the interpolation: with it, everything may be still.
        """
        exact = self.changes_by(motion, doubted=False)
        moved = exact.selected(usual_starts(exact.change))[1]
        change = np.abs(exact.change - np.median(exact.change))
        loaded = change > LOADED_SHARE * change.max()
        return mostly_still(moved), mostly_still(moved | loaded)


def interpolated(noise: NoiseEstimate, recording: Recording, share: Share) -> NoiseEstimate:
    """Return the noise with readings that are interpolated to the middle of their scan.

    Their σ contains the errors of the interpolation and of the load's jitter.

    Parameters
    ----------
    noise : NoiseEstimate
    recording : Recording
    share : Share
        Share of the time between frames that a scan takes, and the load's jitter.
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
    if share.jitter and unloaded.any():
        resting = readings[unloaded].mean().value
        by_load = np.zeros(readings.value.shape)
        by_load[measured] = readings.value[measured] - resting
        variance += share.jitter**2 * np.maximum(by_load**2 - noise_variance, 0.0)
        frame = replace(noise.of_frames(recording), jitter=share.jitter, resting=resting)
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
        unknown_errors = READINGS in estimated_errors(scene)
        size = None
        if unloaded.any():
            size = share_of_motion(
                recording,
                readings,
                known,
                unknown_errors=unknown_errors,
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

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield advice on loads that move while a frame is scanned."""
        recording = prepared.cleaned.recording
        noise = prepared.noise
        readings = noise.readings
        unloaded = recording.role == UNLOADED
        if readings.sigma is None or not unloaded.any() or not names_none(prepared, "motion"):
            return
        named = isinstance(specified(recording.scene, "systematic.reading_error"), float)
        search = partial(
            share_of_motion,
            recording,
            readings,
            # A load on most cells, such as a hand, is like one that jitters.
            may_jitter=False,
            frame_noise=noise.frame,
            resting_cells=noise.resting_cells,
        )
        share = search()
        # Errors of readings explain some of what seems to be motion: they are tried where some is.
        if share is not None and share.gain > MIN_EVIDENCE_GAIN and not named:
            share = search(unknown_errors=True)
        if share is None or not share.gain > MIN_EVIDENCE_GAIN:
            return
        yield Unnamed(_in_words, estimated_entry("motion"))


def _in_words(noise: NoiseEstimate) -> str:
    """Return the motion of a recording that determines it, in words; '' elsewhere."""
    share = noise.motion
    if share is None or "motion" not in noise.estimated:
        return ""
    # a jitter, and no share of the scan
    if share.steady < STEADY_ODDS and share.mean < NOISE_REACH * share.deviation:
        return LoadMotion().jitter_sentence(share.mean, share.deviation, share.jitter)
    return LoadMotion().sentence(share.mean, share.deviation)
