"""What a circuit is asked to explain: an unloaded panel and one frame, the same readings of every circuit."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.rivals import Rival
from lampest.panel.panel import Array
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings

LARGEST_NOISE = 0.05  # of a resistance: beyond, what a divider makes of Gaussian volts is no longer nearly Gaussian
LARGEST_SHIFT = 0.1  # σ of a mean by which the same curvature may shift it
ALIKE = 0.01  # tail of χ² of the difference of two frames, above which they are taken for the same


@dataclass(frozen=True, eq=False)
class Question:
    """What a circuit is asked to explain.

    told : the circuit as the scene has it. resting : the numbers of the unloaded frames. standing : those of the
    measured ones to explain beside them, alike but for their noise; none. widening : factor on every σ, where repeats
    scatter by more than it. named : (frames) the numbers by which sentences name them.
    """

    told: Rival
    resting: NDArray[np.intp]
    standing: NDArray[np.intp]
    widening: float = 1.0
    named: NDArray[np.intp] | None = None

    @property
    def loaded(self) -> str:
        """'frame 3', or 'frames 3 to 9'."""
        ends = self.standing[[0, -1]]
        first, last = ends if self.named is None else self.named[ends]
        return f"frame {first}" if first == last else f"frames {first} to {last}"

    def readings(self, rival: Rival) -> tuple[Readings, ...]:
        """The mean of the unloaded frames, and of the standing ones.

        Raises InputError where values are none of the circuit.
        """
        read, count = self._read(rival), len(self.resting)
        assert read.sigma is not None
        read = replace(read, sigma=self.widening * read.sigma, seen=read.seen * self._usable)
        resting = read[:count].mean()
        return (resting,) if len(self.standing) == 0 else (resting, read[count:].mean())

    def _read(self, rival: Rival) -> Readings:
        """The frames that are asked for, as a circuit reads them."""
        sigma = rival.sigma if rival.sigma is None or rival.sigma.ndim == 2 else rival.sigma[self._chosen]
        return Readings.of(rival.scene, rival.recorded[self._chosen], sigma)

    @cached_property
    def _usable(self) -> Array:
        """Readings that are asked for of every circuit alike; see `nearly_gaussian`."""
        return nearly_gaussian(self.told, max(len(self.resting), len(self.standing)))[self._chosen]

    @property
    def _chosen(self) -> NDArray[np.intp]:
        return np.concatenate([self.resting, self.standing])


def nearly_gaussian(told: Rival, frames: int) -> Array:
    """1 where a recorded value's noise is nearly Gaussian, else 0: (all frames, rows, columns).

    frames : whose mean is to be taken. Volts are as Gaussian as the converter's noise; what a divider's equation makes
    of them is while noise is small.
    """
    sigma = Readings.of(told.scene, told.recorded, told.sigma).sigma
    if told.scene.circuit.unit != "ohm" or sigma is None:
        return np.ones(told.recorded.shape)
    most = min(LARGEST_NOISE, LARGEST_SHIFT / np.sqrt(frames))
    return np.where(sigma <= most * told.recorded, 1.0, 0.0)


def standing_frames(readings: Readings, frame: int, others: NDArray[np.intp], noise: float) -> NDArray[np.intp]:
    """Those of the other frames that differ from one frame by no more than their noise; that one among them.

    Their mean says the same with less noise. readings : (frames, rows, columns). noise : factor on every σ.
    """
    assert readings.sigma is not None
    plain = readings.plain & readings.plain[frame]
    spread = noise * np.hypot(readings.sigma, readings.sigma[frame])
    square = np.where(plain, (readings.value - readings.value[frame]) / spread, 0.0) ** 2
    degrees = plain.sum(axis=(1, 2))
    alike = chi_square_tail(square.sum(axis=(1, 2)), np.maximum(degrees, 1)) >= ALIKE
    kept: NDArray[np.intp] = others[alike[others] | (others == frame)]
    return kept
