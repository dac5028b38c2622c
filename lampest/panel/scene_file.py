"""Scenes as YAML files: read, with the entries that a file leaves to the defaults, and written."""

import warnings
from dataclasses import fields, replace
from pathlib import Path

from lampest.files.document import read_document
from lampest.files.typed import members_of, typed
from lampest.panel.readouts import AnyReadout
from lampest.panel.readouts.converter import range_assumed
from lampest.panel.scene import CHOSEN_RANGE, Scene, validated_scene

# Frames tell them: the check of the circuit names the other one where it fits better.
CHECKED_DEFAULTS = {"polarity"}


@typed
def read_scene(path: str | Path, assigned: tuple[str, ...] = ()) -> Scene:
    """Return the scene of a YAML file, which is the whole file or its entry `scene`.

    `assigned` overrides entries by texts PATH=VALUE, such as readout.noise_lsb=1.2. Raises
    InputError with line and column.

    >>> from pathlib import Path
    >>> _ = Path("scene.yaml").write_text("panel: {rows: 2, columns: 3}")
    >>> lampest.read_scene("scene.yaml").panel.shape
    (2, 3)
    """
    document = read_document(Path(path), assigned)
    if isinstance(document.content, dict) and "scene" in document.content:
        document = replace(
            document, content=document.content["scene"], marks=document.marks["scene"]
        )
    scene = validated_scene(document)
    stated = {"panel": {*document.content["panel"]}}
    if scene.panel.modules is not None:  # rows, columns and pitch follow from the modules
        stated["panel"] |= {"rows", "columns", *document.content["panel"]["modules"]["each"]}
    if scene.readout is not None:  # a named converter states its bits
        completed = scene.readout.completed(document.content["readout"])
        stated["readout"] = {"kind", *CHECKED_DEFAULTS, *completed}
    left_open = [
        f"{name}.{entry.name}"
        for name, specified in stated.items()
        for part in [getattr(scene, name)]
        for entry in fields(part)
        if entry.name not in specified and getattr(part, entry.name)
    ]
    if scene.readout is not None and range_assumed(scene.readout):
        left_open.append(CHOSEN_RANGE)
    return replace(scene, assumed=scene.assumed or tuple(left_open))


def scene_text(scene: Scene) -> str:
    """Return the scene as YAML.

    Warns if the kind of its readout belongs to no installed package.
    """
    if scene.readout is not None and type(scene.readout) not in members_of(AnyReadout):
        kind = getattr(scene.readout, "kind", type(scene.readout).__name__)
        warnings.warn(
            f"readout.kind {kind} is not among the readouts of lampest or of an installed package: "
            "this file can be read again once it is (docs/howto/adding.md)",
            stacklevel=2,
        )
    return scene.yaml
