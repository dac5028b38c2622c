"""What a results file says beside its columns: the scene, noise that the readings of a frame share, published figures.

The scene stands there as YAML text, and three of its numbers as attributes.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from math import isfinite
from typing import Any, ClassVar

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene, SeriesPerLine, Water, scene_text
from lampest.posterior.frame_noise import FrameNoise

ATTRIBUTES: dict[str, Callable[[Scene], float | None]] = {
    "pitch_mm": lambda scene: scene.panel.pitch_mm,
    "series_resistance_ohm": lambda scene: _one_series(scene),
    "top_row_depth_mm": lambda scene: None if scene.water is None else scene.water.top_row_depth_mm,
}
NUMBERS, PATTERNS = ("gain", "unloaded"), ("together", "apart")
NAMES = (*NUMBERS, *PATTERNS)


def write_scene(group: h5py.Group, scene: Scene) -> None:
    """Write the scene and its attributes into a recording's group."""
    numbers = {name: number(scene) for name, number in ATTRIBUTES.items()}
    hdf5.set_attributes(group, **{name: float(number) for name, number in numbers.items() if number is not None})
    hdf5.write_dataset(group, "scene", hdf5.ascii_array(scene_text(scene)), "1", "what was measured, YAML")


def stored_scene(file: h5py.File, base: str, measured: str) -> Scene:
    """The scene of a recording's group. Raises InputError where it is damaged or impossible.

    measured : the dataset of the readings, whose shape says the panel's where a file has no scene.
    """
    if not hdf5.has(file, f"{base}/scene"):
        return _from_attributes(file, base, hdf5.read_array(file, measured, 3).shape[1:])
    document = parse_document(hdf5.read_text(file, f"{base}/scene"), f"{file.filename}:{base}/scene")
    scene: Scene = validated(document, Scene)
    return scene


def _from_attributes(file: h5py.File, base: str, shape: tuple[int, int]) -> Scene:
    """What files without a scene say of it."""
    pitch, series = (hdf5.read_number(file, base, name) for name in ("pitch_mm", "series_resistance_ohm"))
    water = "top_row_depth_mm" in hdf5.attribute_names(file, base)
    depth = hdf5.read_number(file, base, "top_row_depth_mm") if water else None
    try:
        panel = Panel(*shape, pitch)
        return Scene(panel, series_resistance_ohm=series, water=None if depth is None else Water(depth))
    except ValueError as error:
        raise InputError(f"{file.filename}: {base}: {error}") from error


def fullest(scenes: Iterable[Scene]) -> Scene:
    """The first that says more than a file without a scene does; else the first."""
    candidates = tuple(scenes)
    return next((scene for scene in candidates if scene != _in_attributes(scene)), candidates[0])


def _in_attributes(scene: Scene) -> Scene:
    """What is left of a scene in a file without it."""
    return Scene(scene.panel, series_resistance_ohm=_one_series(scene) or 0.0, water=scene.water)


def _one_series(scene: Scene) -> float | None:
    """The series resistance where one number says it."""
    series = scene.series_resistance_ohm
    return None if isinstance(series, SeriesPerLine) else series


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


@dataclass(frozen=True)
class StepFigures(Validated):
    """Published figures of some steps: mean and standard deviation of solve time (s) and of data error (percent).

    Raises ValueError where a figure is negative or not finite.

    >>> lampest.StepFigures(error_percent=1.33).error_percent
    1.33
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    time_s: float | None = None
    time_sd_s: float | None = None
    error_percent: float | None = None
    error_sd_percent: float | None = None

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, and finite")


@dataclass(frozen=True)
class PublishedFigures(Validated):
    """An estimator's figures in a publication: over all steps, or apart where the first is solved with the baseline.

    >>> lampest.PublishedFigures(all=lampest.StepFigures(time_s=16.45)).all.time_s
    16.45
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    all: StepFigures | None = None
    initial: StepFigures | None = None
    following: StepFigures | None = None


def published_text(published: Mapping[str, PublishedFigures]) -> str:
    """Figures by estimator as JSON."""
    return json.dumps({name: asdict(figures) for name, figures in published.items()}, allow_nan=False)


def published_from(text: str) -> dict[str, PublishedFigures]:
    """Figures by estimator from JSON. Raises ValueError where it is something else."""
    try:
        return {
            str(name): PublishedFigures(
                **{step: StepFigures(**values) for step, values in figures.items() if values is not None}
            )
            for name, figures in json.loads(text).items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        names = ", ".join(item.name for item in fields(PublishedFigures))
        raise ValueError(f"is not figures by estimator and {names}") from error
