"""What a recording's frames told of noise that the readings of one frame share, as arrays that results keep."""

from collections.abc import Mapping

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise

NUMBERS, PATTERNS = ("gain", "unloaded"), ("together", "apart")
NAMES = (*NUMBERS, *PATTERNS)


def arrays_of(noise: FrameNoise | None) -> dict[str, Array]:
    """Its numbers, and patterns in volt where there are such; nothing of None."""
    found = {} if noise is None else {name: np.array(getattr(noise, name), dtype=float, order="C") for name in NAMES}
    return {name: value for name, value in found.items() if value.size}


def frame_noise_of(arrays: Mapping[str, Array], scene: Scene) -> FrameNoise | None:
    """The reverse. Raises ValueError where that is no such noise of the scene's panel."""
    if scene.readout is None or not arrays:
        return None
    rows, columns = scene.panel.shape
    channels = rows if scene.circuit.by_columns else columns
    numbers = [np.asarray(arrays.get(name, np.nan)) for name in NUMBERS]
    roots = [np.asarray(arrays.get(name, np.zeros((channels, 0)))) for name in PATTERNS]
    if any(array.dtype.kind not in "iuf" or not np.isfinite(array).all() for array in (*numbers, *roots)):
        raise ValueError("frame_gain and what belongs to it must be finite numbers")
    if any(number.shape for number in numbers) or numbers[0] < 0 or numbers[1] < 1:
        raise ValueError("frame_gain must not be negative, frame_unloaded at least 1")
    if any(root.ndim != 2 or len(root) != channels for root in roots):
        raise ValueError(f"frame_together and frame_apart must have {channels} rows, one for each channel of a line")
    return FrameNoise(scene, int(numbers[1]), float(numbers[0]), *(root.astype(float) for root in roots))
