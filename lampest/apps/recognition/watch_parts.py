"""Parts of a watch: its constants, intervals without a step, recognitions and holds of loads."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lampest.apps.recognition.breathing import WINDOW_S
from lampest.apps.recognition.detector import Detector, Verdict
from lampest.apps.recognition.leaks import Leaks
from lampest.apps.recognition.model_errors import ModelErrors, RecognitionScene
from lampest.apps.recognition.observation import (
    FOLLOWS_S,
    Baseline,
    Observation,
    nothing_shared,
    patch_of,
)
from lampest.apps.recognition.suction import MIN_RISE
from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH
from lampest.panel.conditions import motion_patterns, water_pressure
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise

MIN_FRAMES = 3  # that a recognition needs
REMEMBERED_S = 60.0  # between levels without a load that are remembered: they follow within 20 s
DEVIATION_ROUNDS = 12  # of weighted least squares, which approach least absolute deviations
# Resistances of an open line over those at rest, and the share of its readings that have them:
# mouths raise up to five cells of a row of ten.
OPEN_RATIO = 2.0
OPEN_SHARE = 0.8
# Of the square of a load's change, which a later recognition of it shows in the same place. A slide
# gives less, and a rim that begins to suck.
KEPT_SHARE = 0.8

# Times in s, and readings ln y, (cells,).
Frames = tuple[tuple[float, Array], ...]


@dataclass(frozen=True, eq=False)
class WatchSetup:
    """Constants of a watch.

    Attributes
    ----------
    scene : RecognitionScene
    detector : Detector
    water : array, shape (rows, columns)
        Pressure of the water, kPa.
    errors : ModelErrors
    noise : FrameNoise or None
        Random errors that a frame's readings share; its motion of the water does not count.
    motion : array, shape (3,) or (0,)
        Motion of the water, see `FrameNoise`; none in still water.
    explained : callable
        Returns whether the circuit explains the readings, by default that it does. Few loads need
        to know.
    """

    scene: RecognitionScene
    detector: Detector
    water: Array
    errors: ModelErrors
    noise: FrameNoise | None = None
    explained: Callable[[], bool] = lambda: True
    motion: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls,
        scene: Scene,
        errors: ModelErrors,
        patch_mm: float | None = None,
        noise: FrameNoise | None = None,
    ) -> "WatchSetup":
        """Return the constants of a scene.

        Parameters
        ----------
        scene : Scene
        errors : ModelErrors
        patch_mm : float or None
            Edge of a cell's film; None where it is not specified.
        noise : FrameNoise or None
            Random errors that the readings of a frame share.
        """
        detector = Detector(patch_of(scene.panel, patch_mm), any_form=scene.purpose == "mat")
        motion = np.zeros(0) if noise is None else noise.motion
        water = water_pressure(scene.panel, scene.water)
        return cls(scene, detector, water, errors, noise, motion=motion)

    def frame(
        self, measured: Array, sigma: Array, baseline: Baseline, seconds: float = 0.0
    ) -> Observation:
        """Return the observation of a mean of frames, with the σ of one frame.

        The σ is that of one frame because films err equally in all.
        """
        return Observation(measured, sigma, baseline, self.water, seconds, common=self._common)

    def baseline(self, measured: Array, sigma: Array, frames: float, leaks: Leaks = ()) -> Baseline:
        """Return the baseline from the mean of `frames` unloaded frames; σ is that of one frame.

        With leaks the readings are those that the panel would have with them.
        """
        scale = frames**-0.5
        common = scale * self._electronic(measured)
        return Baseline.of(measured, scale * sigma, self.scene, self.moved_errors, common, leaks)

    @property
    def moved_errors(self) -> ModelErrors:
        """The errors in water that moves by `motion`."""
        return self.errors.in_motion(self.motion)

    def without_motion(self, change: Array) -> tuple["WatchSetup", Array]:
        """Return the constants for a frame, and its change of ln y without the water's motion.

        The motion is the sum of `motion_patterns` with the least absolute deviations, which the
        readings of a load hardly move. What remains of it is as large as their median deviation.

        Parameters
        ----------
        change : array, shape (cells,)
            Change of ln y since the unloaded frames.
        """
        if not self.motion.size:
            return self, change
        patterns = motion_patterns(self.scene.panel.shape).reshape(len(self.motion), -1).T
        weights = np.ones(len(change))
        for _ in range(DEVIATION_ROUNDS):
            amplitudes, *_ = np.linalg.lstsq(weights[:, None] * patterns, weights * change)
            remaining = change - patterns @ amplitudes
            usual = np.median(np.abs(remaining))
            weights = 1 / np.sqrt(np.maximum(np.abs(remaining), max(usual / 10, 1e-9)))
        errors = self.errors.in_motion(np.maximum(np.abs(amplitudes), self.motion))
        motion = np.full(len(self.motion), MAD_TO_SIGMA * usual)
        return replace(self, errors=errors, motion=motion), remaining

    def _common(self, readings: Array) -> Array:
        """Return a root (cells, n) of the covariance of errors that a frame's readings share."""
        count = len(self.motion)
        moved = self.motion[:, None, None] * motion_patterns(readings.shape)[:count] * readings
        return np.hstack([self._electronic(readings), moved.reshape(count, readings.size).T])

    def _electronic(self, readings: Array) -> Array:
        """Return the part of `_common` that does not come from the water."""
        if self.noise is None:
            return nothing_shared(readings)
        electronic = replace(self.noise, motion=np.zeros(0))
        return electronic.columns(readings[None], baseline=False)


@dataclass(frozen=True, eq=False)
class UnloadedPanel:
    """The panel without a load, with which frames are compared.

    Attributes
    ----------
    setup : WatchSetup
    rest : Level
        The unloaded readings.
    sigma : array, shape (rows, columns)
        Standard deviations of those of one frame.
    leaks : tuple of LineEffect
    """

    setup: WatchSetup
    rest: "Level"
    sigma: Array
    leaks: Leaks

    @cached_property
    def baseline(self) -> Baseline:
        """The cells and the offsets, computed once as long as a load is present."""
        measured = np.exp(self.rest.mean).reshape(self.sigma.shape)
        return self.setup.baseline(measured, self.sigma, self.rest.frames, self.leaks)


@dataclass(frozen=True, eq=False)
class Level:
    """Mean readings of an interval without a step.

    Attributes
    ----------
    mean : array, shape (cells,)
        ln y.
    frames : float
        Number of frames in the mean.
    since_s, until_s : float
        Times of its first and of its last frame, s.
    lag : array, shape (cells,), or 0
        By how much readings that drift exceed the mean that follows them, after some time.
    """

    mean: Array
    frames: float
    since_s: float
    until_s: float
    lag: Array | float = 0.0

    @property
    def expected(self) -> Array:
        """The readings that a further frame will have, ln y, (cells,)."""
        return self.mean + self._behind

    @property
    def _behind(self) -> Array | float:
        """The present lag, which grows with the age of the frames in the mean."""
        return self.lag * min((self.until_s - self.since_s) / (2 * FOLLOWS_S), 1.0)

    def after(self, logarithm: Array, time: float) -> "Level":
        """Return the level after readings ln y, (cells,), at a time in s.

        The mean, and the lag of the mean, have the time constant FOLLOWS_S; see Holt, Forecasting
        seasonals and trends by exponentially weighted moving averages, 1957.
        """
        share = min((time - self.until_s) / FOLLOWS_S, 1.0)
        follows = max(1 / (self.frames + 1), share)
        ahead = logarithm - self.mean
        lag = self.lag + share * (ahead - self._behind)
        return Level(self.mean + follows * ahead, 1 / follows, self.since_s, time, lag)


def remembered(past: tuple[Level, ...], rest: Level) -> tuple[Level, ...]:
    """Return the levels without a load to be remembered: the oldest of each octave of ages.

    Parameters
    ----------
    past : tuple of Level
        Those remembered before, the oldest first.
    rest : Level
        The present one. Ages count from REMEMBERED_S on.
    """
    if past and rest.until_s - past[-1].until_s < REMEMBERED_S:
        return past
    kept = dict[int, Level]()
    for level in (*past, rest):
        octave = int(np.log2(1 + (rest.until_s - level.until_s) / REMEMBERED_S))
        kept.setdefault(octave, level)
    return tuple(kept.values())


@dataclass(frozen=True, eq=False)
class Look:
    """The last recognition of a load.

    Attributes
    ----------
    verdict : Verdict
    size : array, shape (discs,)
        Scores of the load.
    time_s : float
        Time of the recognition, or at which the load left.
    reached : array, shape (rows, columns)
        Largest |ln r/r0| that every cell may have had since the load arrived; 0 of free cells.
    over : bool
        Whether the load has left.
    """

    verdict: Verdict
    size: Array
    time_s: float
    reached: Array
    over: bool = False

    @classmethod
    def after(cls, former: "Look | None", verdict: Verdict, size: Array, time: float) -> "Look":
        """Return the recognition at a time in s that follows a former one of the same loads."""
        changed = np.abs(verdict.frame.free_map)
        noise = NOISE_REACH * verdict.frame.free_sd
        touched = (changed > noise) | (verdict.change != 0)
        reached = np.where(touched, changed + noise, 0.0)
        if former is not None and not former.over:
            reached = np.maximum(former.reached, reached)
        return cls(verdict, size, time, reached)

    def fading(self, time: float) -> float:
        """Return the factor by which the residue of a load that left has faded."""
        return 1 / (1 + max(time - self.time_s, 0.0) / FOLLOWS_S)


def latest(window: Frames) -> Frames:
    """Return the last frames: those within WINDOW_S, and at least MIN_FRAMES."""
    return window[-max(sum(at > window[-1][0] - WINDOW_S for at, _ in window), MIN_FRAMES) :]


def without_open_lines(measured: Array, sigma: Array, at_rest: Array) -> tuple[Array, list[str]]:
    """Return σ, infinite for the readings of open lines, and the lines, such as 'row 3'.

    Suction raises the cells of a mouth. Only an open line raises nearly all resistances of a row or
    a column.

    Parameters
    ----------
    measured, sigma : array, shape (rows, columns)
        Resistances, ohm, and their standard deviations; one without a finite σ does not count.
    at_rest : array, shape (rows, columns)
        Resistances without a load, ohm.
    """
    counts = np.isfinite(sigma)
    raised = np.where(counts, measured, 0.0) / at_rest > OPEN_RATIO
    remaining = sigma.copy()
    lines = list[str]()
    for axis, name in enumerate(("row", "column")):
        read = np.maximum(counts.sum(axis=1 - axis), 1)
        opened = np.flatnonzero(raised.sum(axis=1 - axis) > OPEN_SHARE * read)
        np.moveaxis(remaining, axis, 0)[opened] = np.inf
        lines += [f"{name} {number}" for number in opened]
    return remaining, lines


class Hold(NamedTuple):
    """Change of the cells of one load.

    Attributes
    ----------
    change, sd : array, shape (rows, columns)
        ln r/r0 and its standard deviation; the change is 0 beside the load.
    """

    change: Array
    sd: Array

    @property
    def _clear(self) -> Mask:
        """Cells that have clearly changed, boolean (rows, columns)."""
        return np.abs(self.change) > NOISE_REACH * self.sd

    @property
    def risen(self) -> Mask:
        """Cells that clearly rose as under suction, boolean (rows, columns)."""
        return self._clear & (self.change > MIN_RISE)

    def followed_by(self, later: "Hold") -> "Hold":
        """Return the hold of the load when it was weakest in its place.

        Where a later recognition shows what the load changed before, that stays, whatever else has
        changed beside it. Cells that the later one does not show say nothing.
        """
        size = np.abs(self.change)
        counts = self._clear & (size > later.sd)
        shown = np.clip(later.change * np.sign(self.change), 0.0, size)
        kept = np.sum((shown * size)[counts]) >= KEPT_SHARE * np.sum(size[counts] ** 2)
        return self if kept and np.any(self._clear) else later

    def has_left(
        self, change: Array, sd: Array, reached: Array, residue: float, read: Mask
    ) -> bool:
        """Return whether the cells show no more of the load than the film's residue.

        With the change h of the load, and the residue ρR of the largest change R of each cell, it
        has left if

            Σ |h| x sgn h ≤ Σ |h| min(NOISE_REACH ρR, (|h| + ρR)/2):

        the readings are nearer to the residue than to the load. Cells whose standard deviation is
        larger than h say nothing. If the readings of all cells are lost, the load has not left.

        Parameters
        ----------
        change, sd : array, shape (rows, columns)
            x = ln r/r0 and its standard deviation.
        reached : array, shape (rows, columns)
            R, the largest |ln r/r0| since the load arrived.
        residue : float
            ρ, the standard deviation of the residue over R.
        read : boolean array, shape (rows, columns)
            Cells whose readings are not lost.
        """
        size = np.abs(self.change)
        residues = residue * np.maximum(reached, size)
        counts = self._clear & (size > sd)
        if np.any(self._clear) and not np.any(self._clear & read):
            return False
        most = np.minimum(NOISE_REACH * residues, (size + residues) / 2)
        return bool(np.sum((change * self.change)[counts]) <= np.sum((size * most)[counts]))
