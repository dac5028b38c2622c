"""What recorded values say to an estimator: numbers, bounds, or nothing. All values, of a file or not, come in here."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.memory import without_memory
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

VALUE, AT_LEAST, AT_MOST = 0.0, 1.0, -1.0
NEAR_ZERO = 3.0  # σ: a resistance that is no larger says only that it is small
IMPOSSIBLE = 4.0  # σ below the series resistance: once in 30,000 readings by chance


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of the network alone, any leading shape + (rows, columns), in the readout's unit (ohm or volt).

    value : positive; where nothing is seen the frame's geometric mean stands in. sigma : the same unit, or None.
    side : 0 a value, 1 the truth is at least this, -1 at most. seen : 1, or 0 where a reading says nothing.
    """

    value: Array
    sigma: Array | None
    side: Array
    seen: Array

    @classmethod
    def of(cls, scene: Scene, recorded: Array, sigma: Array | None = None, dataset: str | None = None) -> "Readings":
        """The network's readings of recorded values, and what each of them says; one frame (rows, columns) or many.

        A code at a rail of the converter, and a resistance that is zero within three σ, are bounds; what the scene's
        faults make blind says nothing.

        Parameters
        ----------
        scene : what was measured, and how.
        recorded : what the readout's equation gives: ohm of two-point readouts, series resistance included; else volt.
        sigma : same shape or (rows, columns), same unit, or None: then the readout's.
        dataset : what to call the values in an error; by default their row and column are named.

        Raises InputError where shapes disagree, a value is not positive and finite, or below the series resistance by
        more than four σ (by anything where σ is unknown).
        """
        _check(scene, recorded, sigma, dataset)
        circuit, sigma = scene.circuit, _noise(scene, recorded, sigma)
        if scene.converter_memory is not None:
            if scene.readout is None or sigma is None:
                raise InputError("converter_memory needs a readout in the scene, of whose voltages it is a fraction")
            recorded, sigma = without_memory(circuit, scene.converter_memory, recorded, sigma)
        within, side = _within_rails(scene, recorded)
        network, seen = circuit.from_recorded(within, scene), np.ones(recorded.shape)
        side = side * circuit.direction
        if scene.faults is not None:
            seen[..., scene.faults.blind(scene.panel)] = 0.0
        if circuit.unit == "ohm":
            least = network if sigma is None else network + IMPOSSIBLE * sigma
            why = f", not above the scene's series resistance of {scene.series_text}"
            _refuse((least <= 0) & (seen > 0), recorded, dataset, circuit.unit, why)
        if sigma is not None and circuit.unit == "ohm":
            small = (network <= NEAR_ZERO * _least_noise(scene, sigma)) & (seen > 0) & (side != AT_LEAST)
            side = np.where(small, AT_MOST, side)
            network = np.where(small, np.maximum(network, 0) + NEAR_ZERO * sigma, network)
        return cls(_filled(network, seen), sigma, side, seen)

    def __getitem__(self, frames: Any) -> "Readings":
        """The readings of some frames."""
        sigma = None if self.sigma is None else self.sigma[frames]
        return Readings(self.value[frames], sigma, self.side[frames], self.seen[frames])

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
        count = len(self.value)
        sigma = None if self.sigma is None else np.sqrt(np.sum(self.sigma**2, axis=0)) / count
        strongest = np.take_along_axis(self.side, np.abs(self.side).argmax(axis=0)[None], axis=0)[0]
        return Readings(self.value.mean(axis=0), sigma, strongest, self.seen.min(axis=0))

    def together(self, *others: "Readings") -> "Readings":
        """Frames (rows, columns) as (frames, rows, columns); σ is unknown where one of theirs is."""
        frames = (self, *others)
        known = [frame.sigma for frame in frames if frame.sigma is not None]
        return Readings(
            np.stack([frame.value for frame in frames]),
            np.stack(known) if len(known) == len(frames) else None,
            np.stack([frame.side for frame in frames]),
            np.stack([frame.seen for frame in frames]),
        )

    def alone(self) -> "Readings":
        """One frame (rows, columns) as (1, rows, columns)."""
        return self[None]


def strongest_frame(value: Array, resting: Array, frames: NDArray[np.intp], within: float = 0.0) -> int:
    """argmax of mean |log y/y₀| over those of the frames: where readings differ most from the unloaded ones.

    value (frames, rows, columns) and resting (rows, columns) of the network. The last that comes within a share of the
    largest, because a load settles after it has set in.
    """
    change = np.abs(np.log(value[frames] / resting)).mean(axis=(1, 2))
    return int(frames[np.flatnonzero(change >= (1 - within) * change.max())[-1]])


def check_all_positive(values: Array, dataset: str | None, unit: str) -> None:
    """Raise InputError with the place of the first value that is not positive and finite."""
    _refuse(~(np.isfinite(values) & (values > 0)), values, dataset, unit, "; it must be positive and finite")


def check_recorded(scene: Scene, recorded: Array, dataset: str | None) -> None:
    """Raise InputError with the place of the first value that the scene's readout cannot have given."""
    circuit = scene.circuit
    if circuit.unit == "ohm":
        check_all_positive(recorded, dataset, circuit.unit)
    outside = ~((recorded >= 0) & (recorded <= circuit.supply_volt))
    if circuit.unit == "volt":
        why = f"; it must lie between 0 and the supply of {circuit.supply_volt:g} volt"
        _refuse(outside, recorded, dataset, circuit.unit, why)


def _refuse(bad: NDArray[np.bool_], values: Array, dataset: str | None, unit: str, why: str) -> None:
    """Raise InputError with the first bad value, `why` after it; without a dataset's name by its row and column."""
    if np.any(bad):
        index = tuple(int(part) for part in np.argwhere(bad)[0])
        named = f"the reading at row {index[-2]}, column {index[-1]}" if dataset is None else f"{dataset}{list(index)}"
        raise InputError(f"{named} is {values[index]:.6g} {unit}{why}")


def _check(scene: Scene, recorded: Array, sigma: Array | None, dataset: str | None) -> None:
    shape = scene.panel.shape
    if recorded.shape[-2:] != shape:
        size = " × ".join(str(length) for length in recorded.shape)
        raise InputError(f"the readings are {size}, but the scene's panel is {shape[0]} × {shape[1]}")
    check_recorded(scene, recorded, dataset)
    if sigma is not None:
        if sigma.shape not in (recorded.shape, shape):
            raise InputError("sigma has another shape than the readings")
        check_all_positive(sigma, "sigma", scene.circuit.unit)


def _noise(scene: Scene, recorded: Array, sigma: Array | None) -> Array | None:
    """σ of every reading of the network: from the one that is given, else the readout's, else None."""
    if sigma is not None:
        return scene.circuit.sigma_of_reading(recorded, np.broadcast_to(sigma, recorded.shape))
    if scene.readout is None:
        return None
    return scene.readout.sigma_of_reading(recorded, scene.readout.sigma(recorded))


def _within_rails(scene: Scene, recorded: Array) -> tuple[Array, Array]:
    """Values put within the converter's rails, and the side on which those beyond them bound the truth."""
    side = np.zeros(recorded.shape)
    if scene.readout is None:
        return recorded, side
    least, largest = scene.readout.rails()
    side[recorded < least], side[recorded > largest] = AT_MOST, AT_LEAST
    return np.clip(recorded, least, largest), side


def _least_noise(scene: Scene, sigma: Array) -> Array:
    """The noise where nothing but the series resistance is read; that of a large resistance says no such thing."""
    if scene.readout is None:
        return sigma
    return np.minimum(sigma, scene.readout.sigma(np.broadcast_to(scene.series_ohm, scene.panel.shape)))


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
