"""lampest calibrate --loads as a user meets it: the shipped example, a scene that other commands take, sentences."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import lampest as public

Command = Callable[..., SimpleNamespace]
CONFIGS = Path(__file__).parents[2] / "configs"
FRESH = """\
schema: 1
seed: 11
scene:
  panel: {rows: 6, columns: 6, pitch_mm: 10}
  readout: {kind: two_point, adc_bits: 10, readings: 20, noise_lsb: 0.7}
  series_resistance_ohm: 140
frames: 2
loads:
  - {kind: rod, centre_mm: [12, 13], diameter_mm: 22, mass_g: 130}
  - {kind: rod, centre_mm: [37, 36], diameter_mm: 25, mass_g: 300}
course: {approach_s: 0}
unmodelled: {response_spread: 0.25}
output: fresh.h5
"""


@pytest.fixture
def rods(tmp_path: Path, lampest: Command) -> list[Path]:
    assert lampest("simulate", CONFIGS / "known_loads.yaml", "--out", tmp_path / "rods").code == 0
    return sorted((tmp_path / "rods").glob("rod_*.h5"))


@pytest.mark.slow
def test_the_shipped_example_makes_pressures_of_fresh_loads_better(
    rods: list[Path], tmp_path: Path, lampest: Command
) -> None:
    scene = tmp_path / "scene.yaml"
    ended = lampest("calibrate", *rods, "--loads", CONFIGS / "known_loads.csv", "--out", scene)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.startswith("response from 9 loads on 36 of 36 cells: gains spread by ")
    (tmp_path / "fresh.yaml").write_text(FRESH)
    assert lampest("simulate", tmp_path / "fresh.yaml").code == 0
    fresh, errors = public.Recording.load(tmp_path / "fresh.h5"), {}
    told = dataclasses.replace(fresh, scene=public.read_scene(scene))
    published = dataclasses.replace(fresh.scene, response=public.PublishedResponse())
    for name, recording in (("naive", dataclasses.replace(fresh, scene=published)), ("ours", told)):
        found = public.reconstruct(recording, [public.Misfit()], formulation="reduced")
        assert found.pressure is not None and recording.truth_pressure is not None
        truth = recording.truth_pressure[found.frame]
        errors[name] = np.sqrt(np.mean((found.pressure - truth)[truth > 1] ** 2))
        if name == "ours":
            assert found.pressure_lower is not None and found.pressure_upper is not None
            inside = (found.pressure_lower <= truth) & (truth <= found.pressure_upper)
            assert np.mean(inside) > 0.9
            found.save(tmp_path / "results.h5")
    assert errors["ours"] < 0.5 * errors["naive"]
    told.save(tmp_path / "told.h5")
    (line,) = [line for line in lampest("info", tmp_path / "told.h5").out.splitlines() if line.startswith("response")]
    assert "kind table" in line and "gain 0." in line and len(line) < 200
    picture = lampest("plot", tmp_path / "results.h5", "--show", "pressure", "--out", tmp_path / "plots")
    assert picture.code == 0, picture.err


def test_yaml_says_the_same_as_csv_and_without_out_the_scene_is_printed(
    rods: list[Path], tmp_path: Path, lampest: Command
) -> None:
    path, whole = tmp_path / "loads.yaml", rods[4]
    load = "frames: [4, 6], x_mm: 25, y_mm: 25, diameter_mm: 30"
    path.write_text(f"schema: 1\nloads:\n  - {{{load}, force_newton: 3.5316}}\n")
    (tmp_path / "loads.csv").write_text("first,last,x_mm,y_mm,diameter_mm,mass_g\n4,6,25,25,30,360\n\n")
    as_yaml, as_csv = (lampest("calibrate", whole, "--loads", tmp_path / f"loads.{end}") for end in ("yaml", "csv"))
    assert as_yaml.code == 0 and as_yaml.out == as_csv.out
    assert "cells felt no load" in as_yaml.out
    path.with_name("scene.yaml").write_text(as_yaml.out)
    assert public.read_scene(path.with_name("scene.yaml")).response is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rod_1,4,6,10,,30,360", "loads.csv:2: loads.0: a foot needs x_mm and y_mm"),
        ("rod_1,4,6,10,10,30,heavy", "loads.csv:2: loads.0.mass_g: Input should be a valid number"),
        ("rod_1,4,,10,10,30,360", "loads.csv:2: each load needs a frame in the columns first and last"),
        ("rod_1,4,9,10,10,30,360", "rod_1: there is no frame 9, its frames are 0 to 6"),
        ("rod_1,2,6,10,10,30,360", "rod_1: frames 2 to 6 hold unloaded ones"),
        ("rod_1,4,6,710,10,30,360", "load 1: its foot misses the film of every cell"),
        ("cup_1,4,6,10,10,30,360", "load 1: there is no recording cup_1 among rod_1"),
        ("rod_1,4,6,40,40,30,360", "the loads do not explain the cells"),
        ("", "loads: name one at least"),
    ],
)
def test_loads_that_cannot_be_are_one_sentence(
    rods: list[Path], tmp_path: Path, lampest: Command, text: str, words: str
) -> None:
    path, out = tmp_path / "loads.csv", tmp_path / "scene.yaml"
    path.write_text(f"recording,first,last,x_mm,y_mm,diameter_mm,mass_g\n{text}\n")
    ended = lampest("calibrate", rods[0], "--loads", path, "--out", out)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert words in ended.err and not out.exists()


def test_resistors_and_loads_are_two_calibrations(rods: list[Path], lampest: Command) -> None:
    ended = lampest("calibrate", rods[0], "--loads", CONFIGS / "known_loads.csv", "--known", "1000")
    assert (ended.code, ended.err) == (
        2,
        "lampest: --known, --loads and --from-recording are different calibrations: give one of them\n",
    )


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            "response: {kind: table, pressure_kpa: [0, 5], resistance_ohm: [1, 2]}",
            "resistance_ohm must be positive, and fall",
        ),
        ("response: {kind: spline}", "there is no kind spline in lampest"),
        ("response: {kind: power, exponent: 1, scale_kpa: 2, gain: [[1, 1]]}", "response.gain must have 6 rows of 6"),
    ],
)
def test_responses_that_cannot_be_are_one_sentence_with_their_place(
    tmp_path: Path, lampest: Command, line: str, words: str
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(FRESH.replace("frames: 2", f"frames: 2\n{line}"))
    ended = lampest("simulate", path)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert words in ended.err and not (tmp_path / "fresh.h5").exists()
