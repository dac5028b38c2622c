"""What files say beside numbers: places in mm, flags in words, when it began, who was measured."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import invented_case

from lampest import Experiment, InputError, MeasuredSubject, Recording, read_results, read_scene, write_results

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
TOLD = """
panel: {rows: 10, columns: 10, pitch_mm: 10}
subject: {id: L7, species: Petromyzon marinus, length_mm: 420, mass_g: 150}
experiment: {title: attachment, water_temperature_celsius: 12.5}
"""


def test_places_are_in_mm_and_flags_in_words(tmp_path: Path) -> None:
    Recording.load(LAMPREY).save(tmp_path / "recording.h5")
    write_results(tmp_path / "results.h5", [invented_case("LSM", "mouth", (2, 3, 4))])
    with h5py.File(tmp_path / "recording.h5") as file:
        group = file["entry/two_point"]
        np.testing.assert_array_equal(group["x"], 10.0 * np.arange(10))
        assert group["x"].attrs["units"] == b"mm" and group["x"].dims[0][0] == group["column"]
        assert list(group["role"].attrs["flag_values"]) == [0, 1]
        assert group["role"].attrs["flag_meanings"] == b"unloaded measured"
    with h5py.File(tmp_path / "results.h5") as file:
        for group in (file["entry/mouth/LSM"], file["entry/mouth/recording"]):
            np.testing.assert_array_equal(group["y"], 10.0 * np.arange(3))
        cells = file["entry/mouth/LSM"]
        assert cells["open_cell"].attrs["flag_meanings"] == b"conducts cannot_be_told_from_open"
        assert cells["cell_resistance"].attrs["coordinates"] == b"y x"


def test_every_name_in_a_results_file_is_one_for_octave(tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", [invented_case("LSM", "mouth")])
    with h5py.File(tmp_path / "r.h5") as file:
        ours: list[str] = []
        file.visit(ours.append)
    assert len(ours) > 20 and all(part.isidentifier() for name in ours for part in name.split("/"))


def test_when_it_began_goes_from_recording_to_results(tmp_path: Path) -> None:
    case, same = (invented_case(name, "mouth", start_time="2026-05-04T09:30:00+02:00") for name in ("LSM", "LSR-CR"))
    write_results(tmp_path / "r.h5", [case, same])
    assert [case.start_time for case in read_results(tmp_path / "r.h5").cases] == ["2026-05-04T09:30:00+02:00"] * 2
    with pytest.raises(InputError, match="start_time differs"):
        other = invented_case("LSR-CR", "mouth", start_time="2026-05-05T09:30:00+02:00")
        write_results(tmp_path / "r.h5", [case, other])


def test_who_was_measured_is_in_the_scene_and_in_files(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(TOLD)
    scene = read_scene(tmp_path / "scene.yaml")
    assert scene.subject == MeasuredSubject("L7", "Petromyzon marinus", 420.0, 150.0)
    assert scene.experiment == Experiment("attachment", water_temperature_celsius=12.5)
    lamprey = Recording.load(LAMPREY)
    dataclasses.replace(lamprey, scene=dataclasses.replace(lamprey.scene, subject=scene.subject)).save(
        tmp_path / "r.h5"
    )
    assert Recording.load(tmp_path / "r.h5").scene.subject == scene.subject


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ("subject: {length_mm: 0}", "length_mm must be positive and finite"),
        ("subject: {weight: 3}", "weight"),
        ("experiment: {water_temperature_celsius: 290}", "must lie between -5 and 100"),
    ],
)
def test_wrong_words_about_who_are_one_sentence(tmp_path: Path, wrong: str, sentence: str) -> None:
    (tmp_path / "scene.yaml").write_text(f"panel: {{rows: 3, columns: 3, pitch_mm: 10}}\n{wrong}\n")
    with pytest.raises(InputError, match=sentence):
        read_scene(tmp_path / "scene.yaml")


def test_a_board_s_recording_says_when_it_began(tmp_path: Path) -> None:
    lamprey = Recording.load(LAMPREY)
    lamprey.save(tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        group, time = file["entry"].create_group("acquisition"), lamprey.time
        group["host_time"] = 1_777_879_800.0 + time
        for name, kind in (
            ("device_ms", "u4"),
            ("sequence", "u4"),
            ("missed", "u2"),
            ("lost", "u4"),
            ("session", "u2"),
        ):
            group[name] = np.zeros(len(time), kind)
    assert Recording.load(tmp_path / "r.h5").start_time == "2026-05-04T07:30:00.000+00:00"
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file["entry/acquisition/host_time"][0] = np.inf
    assert Recording.load(tmp_path / "r.h5").start_time is None
