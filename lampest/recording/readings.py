"""What a recording's readings say to an estimator: values, bounds, or nothing."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.divider import rails, sigma_resistance
from lampest.panel.panel import Array
from lampest.panel.scene import TwoPointReadout
from lampest.recording.recording import Recording

VALUE, AT_LEAST, AT_MOST = 0.0, 1.0, -1.0
NEAR_ZERO = 3.0
IMPOSSIBLE = 4.0


@dataclass(frozen=True, eq=False)
class Readings:
    """Two-point resistances of the network alone, any leading shape + (rows, columns).

    resistance : ohm, positive; where nothing is seen the frame's geometric mean stands in. sigma : ohm, or None.
    side : 0 a value, 1 the truth is at least this, -1 at most. seen : 1, or 0 where a reading says nothing.
    """

    resistance: Array
    sigma: Array | None
    side: Array
    seen: Array

    @classmethod
    def of(cls, recording: Recording) -> "Readings":
        """A recording's readings, series resistance taken off.

        A code at a rail of the converter, and a reading that is zero within three σ, are bounds. Raises InputError
        where a reading is below the series resistance by more than four σ (by anything where σ is unknown).
        """
        scene, sigma = recording.scene, recording.sigma_or_none()
        total, side = recording.resistance.copy(), np.zeros(recording.resistance.shape)
        if scene.readout is not None:
            least, largest = rails(scene.readout)
            side[total < least], side[total > largest] = AT_MOST, AT_LEAST
            total = np.clip(total, least, largest)
        network = total - scene.series_resistance_ohm
        seen = np.ones(network.shape)
        if scene.faults is not None:
            seen[:, scene.faults.blind(scene.panel)] = 0.0
        if sigma is None:
            recording.check_above_series(np.where(seen > 0, network, 1.0))
        else:
            recording.check_above_series(np.where(seen > 0, network + IMPOSSIBLE * sigma, 1.0))
            # The noise where nothing but the series resistance is read; that of a large resistance says no such thing.
            noise = sigma if scene.readout is None else _at_most(sigma, scene.readout, scene.series_resistance_ohm)
            small = (network <= NEAR_ZERO * noise) & (seen > 0) & (side != AT_LEAST)
            side[small] = AT_MOST
            network = np.where(small, np.maximum(network, 0) + NEAR_ZERO * sigma, network)
        return cls(_filled(network, seen), sigma, side, seen)

    def __getitem__(self, frames: Any) -> "Readings":
        """The readings of some frames."""
        sigma = None if self.sigma is None else self.sigma[frames]
        return Readings(self.resistance[frames], sigma, self.side[frames], self.seen[frames])

    @property
    def partial(self) -> bool:
        """Whether any reading is not a plain value."""
        return bool(np.any(self.side) or not np.all(self.seen))

    @property
    def sigma_of_values(self) -> Array | None:
        """σ, infinite where a reading is a bound or says nothing."""
        return None if self.sigma is None else np.where((self.side == 0) & (self.seen > 0), self.sigma, np.inf)

    def mean(self) -> "Readings":
        """The mean over frames; a bound or a blank stays one where any frame has it."""
        count = len(self.resistance)
        sigma = None if self.sigma is None else np.sqrt(np.sum(self.sigma**2, axis=0)) / count
        strongest = np.take_along_axis(self.side, np.abs(self.side).argmax(axis=0)[None], axis=0)[0]
        return Readings(self.resistance.mean(axis=0), sigma, strongest, self.seen.min(axis=0))

    def together(self, other: "Readings") -> "Readings":
        """Two frames (rows, columns) as (2, rows, columns)."""
        pairs = ((self.resistance, other.resistance), (self.side, other.side), (self.seen, other.seen))
        resistance, side, seen = (np.stack(pair) for pair in pairs)
        sigma = None if self.sigma is None or other.sigma is None else np.stack([self.sigma, other.sigma])
        return Readings(resistance, sigma, side, seen)

    def alone(self) -> "Readings":
        """One frame (rows, columns) as (1, rows, columns)."""
        return self[None]


def strongest_frame(resistance: Array, resting: Array, frames: NDArray[np.intp], within: float = 0.0) -> int:
    """argmax of mean |log R/R₀| over those of the frames: where readings differ most from the unloaded ones.

    resistance (frames, rows, columns) and resting (rows, columns) ohm, series resistance taken off. The last that comes
    within a share of the largest, because a load settles after it has set in.
    """
    change = np.abs(np.log(resistance[frames] / resting)).mean(axis=(1, 2))
    return int(frames[np.flatnonzero(change >= (1 - within) * change.max())[-1]])


def plain(resistance: Array, sigma: Array | None) -> Readings:
    """Readings that are all values."""
    return Readings(resistance, sigma, np.zeros(resistance.shape), np.ones(resistance.shape))


def _at_most(sigma: Array, readout: TwoPointReadout, series_ohm: float) -> Array:
    return np.minimum(sigma, sigma_resistance(readout, np.array(series_ohm)))


def _filled(network: Array, seen: Array) -> Array:
    """Each frame with its geometric mean where nothing is seen. Raises InputError where a frame shows nothing."""
    if np.all(seen):
        return network
    logarithm = np.log(np.where(seen > 0, network, 1.0))
    count = seen.sum(axis=(-2, -1), keepdims=True)
    if not np.all(count):
        raise InputError("a frame has no reading that says anything")
    mean = np.exp((logarithm * seen).sum(axis=(-2, -1), keepdims=True) / count)
    return np.where(seen > 0, network, mean)
