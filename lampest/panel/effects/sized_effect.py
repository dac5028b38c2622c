"""Effects whose size is a number of a scene or a simulation: gain, ripple, motion and others.

A `SizedEffect` is one file of this room: key, unit and limits of its size, its prior with the
source, the errors that it leaves in the readings of a frame, its simulation, its words. How a
recording determines the size is in `lampest.inference.effects`, whose room is above.
"""

from abc import ABC
from typing import Any

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout


class SizedEffect(ABC):
    """Kind of effect that has a size. Its object has no fields.

    Attributes
    ----------
    unit : str
        Unit of the size; '' for a relative one.
    limits : (float, float)
        Least and largest size that a scene may state.
    prior : float
        One standard deviation of the size where a recording shows nothing.
    in_volt : bool
        Whether columns change the voltages at the converter, or else the readings.
    averages : bool
        Whether the mean of several frames has smaller errors.
    stream : str
        Name of its random numbers in simulations.
    """

    unit: str = ""
    limits: tuple[float, float]
    prior: float
    in_volt: bool = True
    averages: bool = True
    stream: str = ""

    def sentence(self, size: float, deviation: float) -> str:
        """Return what a recording shows in words, with the size and its standard deviation."""
        raise NotImplementedError(f"{type(self).__name__} is not advised")

    def columns(self, circuit: Readout, values: Array, *sizes: Any) -> Array:
        """Return what one standard deviation of each error does to a frame, (n, rows, columns).

        Parameters
        ----------
        circuit : Readout
        values : array, shape (rows, columns)
            Voltages or readings of the frame, as `in_volt` says.
        *sizes
            Sizes of the errors, those of `lampest.posterior.frame_noise`.
        """
        raise NotImplementedError(f"{type(self).__name__} leaves no error in a frame")

    def disturbed(
        self,
        readout: Readout,
        volt: Array,
        random: np.random.Generator,
        period_s: float,
        *sizes: Any,
    ) -> Array:
        """Return simulated voltages with the effect, (frames, rows, columns).

        Parameters
        ----------
        readout : Readout
        volt : array, shape (frames, rows, columns)
            Voltages at the converter without the effect.
        random : numpy.random.Generator
        period_s : float
            Time from frame to frame.
        *sizes
            Sizes of the effect, those of `unmodelled`.
        """
        raise NotImplementedError(f"{type(self).__name__} does not act at the converter")
