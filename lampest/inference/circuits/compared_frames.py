"""Frames that a circuit has to explain: the unloaded panel, and the most strongly loaded frames.

Of the frames with the strongest change, those that are equal within their noise are averaged.
Outliers and readings whose noise is not Gaussian do not count. `broken_law` tests the circuit's
inequalities on all frames.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import SIGNIFICANCE
from lampest.inference.circuits.alike import PanelChoice
from lampest.inference.circuits.alternatives import Alternative, standing_frames
from lampest.inference.readings.free_tests import free_tests
from lampest.inference.variance_components import noted_excess
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.starts import several_panels
from lampest.posterior.interval import largest_of
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording


@dataclass(frozen=True, eq=False)
class ComparedFrames:
    """Frames that a circuit has to explain.

    Attributes
    ----------
    specified : Alternative
        The scene's circuit, with a saturated stage where the readings show one; outliers are
        missing.
    role : array, shape (frames,)
    resting, standing : integer array
        Numbers of the unloaded frames, and of measured frames that are equal within their noise.
    widening : float
        Factor on every σ.
    named : integer array, shape (frames,)
        Numbers of all frames as sentences state them.
    named_errors : array, shape (frames, rows, columns), or None
        Standard deviations of the errors that the scene names beside noise: of each reading, of
        motion. The errors of n unloaded frames are √n times the error of their mean.
    """

    specified: Alternative
    role: NDArray[np.uint8]
    resting: Numbers
    standing: Numbers
    widening: float
    named: Numbers
    named_errors: Array | None = None

    @classmethod
    def of(cls, recording: Recording, outliers: Mask) -> Self:
        """Return the frames of a recording whose noise is known.

        A recording without an unloaded frame has its first frame instead.
        """
        role = recording.role
        specified = Alternative(
            recording.scene, np.where(outliers, np.nan, recording.recorded), recording.sigma
        )
        readings = specified.readings
        named = np.arange(len(role)) if recording.number is None else recording.number
        resting = np.flatnonzero(role == UNLOADED) if np.any(role == UNLOADED) else np.array([0])
        standing = np.setdiff1d(np.flatnonzero(role == MEASURED), resting)
        # The most strongly loaded frame, averaged with those that are equal to it within their
        # noise.
        used = replace(readings, seen=readings.seen * specified.nearly_gaussian(1))
        noise = noise_factor(used[resting])
        if len(standing):
            frame = strongest_frame(readings.plain_values, readings[resting].mean().value, standing)
            standing = standing_frames(used, frame, standing, noise)
        return cls(specified, role, resting, standing, noise, named)

    @cached_property
    def others(self) -> Self | None:
        """Every second unloaded frame, and the strongest loaded frame that is not compared.

        The value is None without such a frame.
        """
        loaded = np.setdiff1d(np.flatnonzero(self.role == MEASURED), self.standing)
        loaded = loaded[(self._usable[loaded] > 0).any(axis=(1, 2))]
        if not len(loaded):
            return None
        readings = self.specified.readings
        resting = self.resting[1::2] if len(self.resting) > 1 else self.resting
        unloaded = readings[resting].mean().value
        strongest = strongest_frame(readings.plain_values, unloaded, loaded)
        return replace(self, resting=resting, standing=np.array([strongest]))

    @property
    def loaded(self) -> str:
        """The loaded frames in words: 'frame 3', or 'frames 3 to 9'."""
        first, last = self.named[self.standing[[0, -1]]]
        return f"frame {first}" if first == last else f"frames {first} to {last}"

    def readings(self, alternative: Alternative) -> tuple[Readings, ...]:
        """Return the mean of the unloaded frames, and of the standing ones.

        Raises InputError as `Alternative.readings`.
        """
        chosen = np.concatenate([self.resting, self.standing])
        count = len(self.resting)
        read = alternative.readings[chosen]
        usable = alternative.ordered(self._usable[chosen])
        read = replace(read, sigma=self.widening * read.known_sigma, seen=read.seen * usable)
        means = [read[:count].mean()]
        if len(self.standing):
            means.append(read[count:].mean())
        if self.named_errors is None:
            return tuple(means)
        # Errors that frames share do not average out.
        errors = (
            self._named_error(alternative, self.resting),
            self._named_error(alternative, self.standing),
        )
        return tuple(
            replace(mean, sigma=np.hypot(mean.known_sigma, error))
            for mean, error in zip(means, errors, strict=False)
        )

    def _named_error(self, alternative: Alternative, frames: Numbers) -> Array:
        """Return the root mean square of the named errors over frames, (rows, columns)."""
        errors = np.zeros((1, 1, 1)) if self.named_errors is None else self.named_errors[frames]
        return (
            alternative.ordered(np.sqrt(np.mean(errors**2, axis=0))) if len(frames) else errors[0]
        )

    @cached_property
    def panels(self) -> PanelChoice | None:
        """Panels of the frames under the scene's circuit, where several give their readings.

        The value is None where only one panel does, and without a loaded frame.
        """
        scene = self.specified.scene
        several = several_panels(scene.circuit, *scene.panel.shape)
        if not several or scene.wiring is not None or not len(self.standing):
            return None
        resting, loaded = self.readings(self.specified)
        return PanelChoice.of(scene, resting, loaded)

    @cached_property
    def _usable(self) -> Array:
        """Weights, 1 or 0, of the readings that every circuit has to explain.

        Shape (frames, rows, columns).
        """
        return self.specified.nearly_gaussian(max(len(self.resting), len(self.standing)))


def noise_factor(resting: Readings) -> float:
    """Return √(χ²/degrees) of unloaded frames (frames, rows, columns) about their mean.

    See `noted_excess`.
    """
    plain = np.all(resting.plain, axis=0)
    if resting.sigma is None:
        return 1.0
    squares = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain] ** 2
    return noted_excess(float(squares.sum()), (len(resting.value) - 1) * int(plain.sum()))


def broken_law(alternative: Alternative, frames: ComparedFrames) -> str:
    """Return the circuit's inequality that the readings violate significantly, in words.

    The text is '' where none is violated.
    """
    readings = alternative.readings
    sigma = replace(
        readings, seen=readings.seen * frames.specified.nearly_gaussian(1)
    ).sigma_of_values
    assert sigma is not None
    for test in free_tests(alternative.scene.circuit, readings.value, frames.widening * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < SIGNIFICANCE:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            return (
                f"readings of frame {frames.named[frame]} break a law "
                f"of the circuit by {beyond}: {test.law}"
            )
    return below_series(alternative, frames)


def below_series(alternative: Alternative, frames: ComparedFrames) -> str:
    """Return a sentence on the reading that lies significantly below its series resistance.

    The sentence is '' where no reading does.
    """
    scene = alternative.scene
    readings = alternative.readings
    if scene.circuit.unit != "ohm" or readings.sigma is None:
        return ""
    remaining = scene.circuit.from_recorded(alternative.recorded, scene)
    read = (readings.seen > 0) & np.isfinite(remaining)
    excess = np.where(read, -remaining / readings.sigma, -np.inf)
    if largest_of(excess.max(), excess.size) >= SIGNIFICANCE:
        return ""
    place = np.unravel_index(np.argmax(excess), excess.shape)
    frame, row, column = place
    return (
        f"the reading of row {row}, column {column} in frame {frames.named[frame]} "
        f"lies {-remaining[place]:.3g} ohm below its series resistance, "
        f"{excess[place]:.3g} times its noise"
    )
