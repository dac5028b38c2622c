"""What a circuit is asked to explain: an unloaded panel and one frame, the same readings of every circuit."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.rivals import Rival
from lampest.panel.panel import Array
from lampest.recording.readings import Readings

LARGEST_NOISE = 0.05  # of a resistance: beyond, what a divider makes of Gaussian volts is no longer nearly Gaussian
LARGEST_SHIFT = 0.1  # σ of a mean by which the same curvature may shift it


@dataclass(frozen=True, eq=False)
class Question:
    """What a circuit is asked to explain.

    told : the circuit as the scene has it. resting : the numbers of the unloaded frames. frame : that of the one to
    explain beside them, or None. widening : factor on every σ, where repeats scatter by more than it.
    """

    told: Rival
    resting: NDArray[np.intp]
    frame: int | None
    widening: float = 1.0

    def readings(self, rival: Rival) -> tuple[Readings, ...]:
        """The mean of the unloaded frames, and the frame. Raises InputError where values are none of the circuit."""
        read, count = self._read(rival), len(self.resting)
        assert read.sigma is not None
        read = replace(read, sigma=self.widening * read.sigma, seen=read.seen * self._usable)
        return (read[:count].mean(),) if self.frame is None else (read[:count].mean(), read[count])

    def _read(self, rival: Rival) -> Readings:
        """The frames that are asked for, as a circuit reads them."""
        sigma = rival.sigma if rival.sigma is None or rival.sigma.ndim == 2 else rival.sigma[self._chosen]
        return Readings.of(rival.scene, rival.recorded[self._chosen], sigma)

    @cached_property
    def _usable(self) -> Array:
        """Readings that are asked for of every circuit alike; see `nearly_gaussian`."""
        return nearly_gaussian(self.told, len(self.resting))[self._chosen]

    @property
    def _chosen(self) -> NDArray[np.intp]:
        return np.append(self.resting, [] if self.frame is None else self.frame).astype(int)


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
