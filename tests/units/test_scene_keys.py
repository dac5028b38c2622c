"""Keys that applications add to scenes: read, kept in files, and refused without their readers."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import lampest
from lampest.files.applications import Application, Applications, applications, loaded
from lampest.files.typed import Configuration
from lampest.panel.scene import OF_APPLICATIONS, scene_text

SCENE = "panel: {rows: 3, columns: 4, pitch_mm: 10}\nreadout: {kind: two_point}\n"


@dataclass(frozen=True)
class Keyboard(Configuration):
    """Value of the key `midi`."""

    lowest: int = 48


@pytest.fixture
def with_midi(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An application with a key of scenes is installed."""
    midi = Application(
        name="midi", about="music", scene_keys={"midi": f"{__name__}:{Keyboard.__name__}"}
    )
    installed = Applications({**applications().usable, "midi": midi}, ())
    monkeypatch.setattr("lampest.panel.scene.applications", lambda: installed)
    yield


def read(folder: Path, text: str) -> lampest.Scene:
    path = folder / "scene.yaml"
    path.write_text(text)
    return lampest.read_scene(path)


@pytest.mark.usefixtures("with_midi")
def test_a_key_of_an_application_is_kept_in_files(tmp_path: Path) -> None:
    scene = read(tmp_path, f"{SCENE}midi: {{lowest: 36}}\n")
    assert scene.own("midi") == Keyboard(36) and scene.own("film") is None
    assert scene != read(tmp_path, SCENE) and hash(scene) == hash(read(tmp_path, scene_text(scene)))
    values = 500.0 + np.arange(36.0).reshape(3, 3, 4)
    lampest.Recording.from_array(values, "ohm", baseline=1, scene=scene).save(tmp_path / "mine.h5")
    assert lampest.Recording.load(tmp_path / "mine.h5").scene == scene
    simulation = tmp_path / "simulation.yaml"
    simulation.write_text(
        "schema: 1\nseed: 1\nscene:\n  panel: {rows: 3, columns: 4}\n  midi: {lowest: 30}\n"
    )
    [(_, simulated)] = lampest.read_simulations(simulation)
    assert simulated.scene.own("midi") == Keyboard(30)


@pytest.mark.usefixtures("with_midi")
@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("midi: {lowst: 36}", ":3:8: midi.lowst: no such key; did you mean lowest?"),
        ("midi: {lowest: x}", ":3:8: midi.lowest: must be a whole number, not 'x'"),
        ("music: {lowest: 36}", ":3:1: music: no such key"),
        ("own_keys: [[midi, {lowest: 36}]]", "midi: an object of .*Keyboard is needed"),
    ],
)
def test_a_wrong_key_of_an_application_has_its_place(
    line: str, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(lampest.InputError, match=sentence):
        read(tmp_path, f"{SCENE}{line}\n")


def test_a_key_is_unknown_without_its_application(tmp_path: Path) -> None:
    with pytest.raises(lampest.InputError, match=re.escape(":3:1: midi: no such key")):
        read(tmp_path, f"{SCENE}midi: {{lowest: 36}}\n")
    with pytest.raises(lampest.InputError, match="no installed application has this key"):
        lampest.Scene(lampest.Panel(3, 4), own_keys=(("midi", Keyboard()),))


def test_keys_that_only_applications_read_are_registered_by_them() -> None:
    usable = applications().usable
    registered = {key: name for name, each in usable.items() for key in each.scene_keys}
    assert registered == OF_APPLICATIONS
    assert all(isinstance(loaded(target), type) for target in applications().scene_keys.values())
