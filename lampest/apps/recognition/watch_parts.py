"""Parts of a watch: its constants, intervals without a step, and recognitions of a load."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lampest.apps.recognition.breathing import WINDOW_S
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.leaks import Leaks
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.observation import Baseline, Observation, patch_of
from lampest.apps.recognition.recognition_scene import RecognitionScene
from lampest.apps.recognition.verdict import Verdict
from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH
from lampest.panel.conditions import motion_patterns, water_pressure
from lampest.panel.effects.water import moved_by_water
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

# Time constant, s, with which means follow the frames, and with which a residue fades.
FOLLOWS_S = 20.0
MIN_FRAMES = 3  # that a recognition needs
DEVIATION_ROUNDS = 12  # of weighted least squares, which approach least absolute deviations
# Cosine between the changes of two recognitions of one load: a rim that begins to suck, a second
# load or a move gives less, a pull more.
SAME_PATTERN = 0.8
# Times in s, and readings ln y, (cells,).
Frames = tuple[tuple[float, Array], ...]


def assumed_to_explain() -> bool:
    """Return True, the outcome for a circuit that was not checked."""
    return True


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
    common : callable or None
        Returns a root (cells, n) of the covariance of random errors that a frame's readings share,
        given the readings (rows, columns); None where there are none.
    motion : array, shape (3,) or (0,)
        Motion of the water, see `FrameNoise`; none in still water.
    explained : callable
        Returns whether the circuit explains the readings. Few loads need to know.
    """

    scene: RecognitionScene
    detector: Detector
    water: Array
    errors: ModelErrors
    common: Callable[[Array], Array] | None = None
    explained: Callable[[], bool] = assumed_to_explain
    motion: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, scene: Scene, errors: ModelErrors, patch_mm: float | None = None) -> "WatchSetup":
        """Return the constants of a scene, without errors that the readings of a frame share.

        Parameters
        ----------
        scene : Scene
        errors : ModelErrors
        patch_mm : float or None
            Edge of a cell's film; None where it is not specified.
        """
        detector = Detector(patch_of(scene.panel, patch_mm), any_form=scene.purpose == "mat")
        return cls(scene, detector, water_pressure(scene.panel, scene.water), errors)

    def frame(
        self, measured: Array, sigma: Array, baseline: Baseline, seconds: float = 0.0
    ) -> Observation:
        """Return the observation of a mean of frames, with the σ of one frame.

        The σ is that of one frame because films err equally in all.
        """
        shared = self.common is not None or self.motion.size
        common = self._common if shared else None
        return Observation(measured, sigma, baseline, self.water, seconds, common=common)

    def baseline(self, measured: Array, sigma: Array, frames: float, leaks: Leaks = ()) -> Baseline:
        """Return the baseline from the mean of `frames` unloaded frames; σ is that of one frame.

        With leaks the readings are those that the panel would have with them.
        """
        scale = frames**-0.5
        common = None if self.common is None else scale * self.common(measured)
        return Baseline.of(measured, scale * sigma, self.scene, self.moved_errors, common, leaks)

    @property
    def moved_errors(self) -> ModelErrors:
        """The errors in water that moves by `motion`."""
        return self.errors.in_motion(self.motion)

    def moved_by(self, motion: Array) -> "WatchSetup":
        """Return the constants where water moves cells by `motion`, (3,) or (0,), or more."""
        return replace(self, motion=np.maximum(self.motion, motion))

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
            amplitudes = np.linalg.lstsq(weights[:, None] * patterns, weights * change, rcond=None)[
                0
            ]
            deviations = np.abs(change - patterns @ amplitudes)
            usual = float(np.median(deviations))
            weights = 1 / np.sqrt(np.maximum(deviations, max(usual / 10, 1e-9)))
        errors = self.errors.in_motion(np.maximum(np.abs(amplitudes), self.motion))
        remaining = np.full(len(self.motion), MAD_TO_SIGMA * usual)
        return replace(self, errors=errors, motion=remaining), change - patterns @ amplitudes

    def _common(self, readings: Array) -> Array:
        """Return a root (cells, n) of the covariance of errors that a frame's readings share."""
        parts: list[Array] = [np.zeros((readings.size, 0))]
        parts += [] if self.common is None else [self.common(readings)]
        if self.motion.size:
            moved = moved_by_water(readings, self.motion)
            parts.append(moved.reshape(len(moved), -1).T)
        return np.hstack(parts)


@dataclass(frozen=True, eq=False)
class UnloadedPanel:
    """The panel without a load, with which frames are compared.

    Attributes
    ----------
    setup : WatchSetup
    mean, sigma : array, shape (rows, columns)
        Mean of the unloaded readings, and standard deviations of those of one frame.
    frames : float
        Number of frames in the mean.
    leaks : tuple of LineLeak
    """

    setup: WatchSetup
    mean: Array
    sigma: Array
    frames: float
    leaks: Leaks = ()

    @cached_property
    def baseline(self) -> Baseline:
        """The cells and the offsets, computed once as long as a load is present."""
        return self.setup.baseline(self.mean, self.sigma, self.frames, self.leaks)


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
    """

    mean: Array
    frames: float
    since_s: float
    until_s: float


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
    held : array, shape (rows, columns)
        ln r/r0 of the cells that fell, or of all if none did, when the load was weakest in its
        place.
    reached : array, shape (rows, columns)
        Largest |ln r/r0| that every cell may have had since the load arrived; 0 of free cells.
    pulled : float
        Strongest change since then over `held`, less what has faded of it: a pull has more.
    over : bool
        Whether the load has left.
    """

    verdict: Verdict
    size: Array
    time_s: float
    held: Array
    reached: Array
    pulled: float = 1.0
    over: bool = False

    @classmethod
    def after(cls, former: "Look | None", verdict: Verdict, size: Array, time: float) -> "Look":
        """Return the recognition at a time in s that follows a former one of the same loads.

        Another pattern of the change follows no former recognition. A weaker change shows the
        strength with which the load holds; a stronger one is a pull.
        """
        # Every load presses, and a pull hardly changes what is pressed. A film under suction may
        # keep more of a pull than the load caused before.
        fallen = np.minimum(verdict.changed, 0.0)
        change = fallen if np.any(fallen) else verdict.changed
        touched = (verdict.changed != 0) | (verdict.best.change != 0)
        frame = verdict.frame
        most = np.abs(frame.free_map) + NOISE_REACH * frame.free_sd
        reached = np.where(touched, most, 0.0)
        if former is None or former.over:
            return cls(verdict, size, time, change, reached)
        look = cls(verdict, size, time, change, np.maximum(former.reached, reached))
        squares = float(np.sum(former.held**2))
        along = float(np.sum(change * former.held))
        if along < SAME_PATTERN * np.sqrt(squares * np.sum(change**2)) or along <= 0:
            return look
        ratio = along / squares
        faded = 1 + (former.pulled - 1) / (1 + max(time - former.time_s, 0.0) / FOLLOWS_S)
        if ratio < 1:
            return replace(look, pulled=faded / ratio)
        return replace(look, held=former.held, pulled=max(faded, ratio))

    def most_left(self, residue: float) -> float:
        """Return the largest share of `held` that the film may show once the load has left.

        Without a pull it is NOISE_REACH standard deviations of the residue in the film. After a
        pull the film keeps more of `held`; the load has left where the readings are nearer to the
        expected residue than to `held`.

        Parameters
        ----------
        residue : float
            Standard deviation of the residue, over the ln r/r0 that left it.
        """
        return min(NOISE_REACH * residue * self.pulled, (1 + residue * self.pulled) / 2)

    def fading(self, time: float) -> Array:
        """Return the scores of the residue of a load that left, (discs,)."""
        return np.asarray(self.size / (1 + max(time - self.time_s, 0.0) / FOLLOWS_S))


def latest(window: Frames) -> Frames:
    """Return the last frames: those within WINDOW_S, and at least MIN_FRAMES."""
    return window[-max(sum(at > window[-1][0] - WINDOW_S for at, _ in window), MIN_FRAMES) :]
