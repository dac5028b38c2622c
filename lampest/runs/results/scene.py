"""A recording's scene in a results file: as YAML text, and three of its numbers as attributes."""

from collections.abc import Callable, Iterable

import h5py

from lampest.files import hdf5
from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError
from lampest.panel.panel import Panel
from lampest.panel.scene import Scene, SeriesPerLine, Water, scene_text

ATTRIBUTES: dict[str, Callable[[Scene], float | None]] = {
    "pitch_mm": lambda scene: scene.panel.pitch_mm,
    "series_resistance_ohm": lambda scene: _one_series(scene),
    "top_row_depth_mm": lambda scene: None if scene.water is None else scene.water.top_row_depth_mm,
}


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
