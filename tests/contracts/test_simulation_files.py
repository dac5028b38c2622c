"""Simulation files: what they may say, where their faults are reported, and what a command leaves on the disk."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from lampest import InputError, Recording, read_simulations

ROOT = Path(__file__).parents[2]
Command = Callable[..., SimpleNamespace]
BASE = """\
schema: 1
seed: 4
scene:
  panel: {rows: 4, columns: 3, pitch_mm: 10}
  readout: {kind: two_point}
  series_resistance_ohm: 140
frames: 2
loads:
  - {kind: oral_disc, centre_mm: [10, 10], diameter_mm: 25, rim_width_mm: 4, pressure_kpa: -10}
  - {kind: rod, centre_mm: [20, 0], diameter_mm: 10, mass_g: 50}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def made(lampest: Command, path: Path, *out: Path) -> list[Path]:
    """What `lampest simulate` says that it has written; it is there."""
    ended = lampest("simulate", path, *(("--out", *out) if out else ()))
    assert (ended.code, ended.err) == (0, "")
    files = [Path(line) for line in ended.out.splitlines()]
    assert all(file.is_file() for file in files)
    return files


def refused(ended: SimpleNamespace, words: str) -> None:
    """Exit code 2, nothing on standard output, and one line on standard error that matches the words."""
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.count("\n") == 1
    assert re.search(words, ended.err)


def test_effects_of_the_electronics_need_electronics(tmp_path: Path) -> None:
    text = BASE.replace("  readout: {kind: two_point}\n", "") + "unmodelled: {reference_tolerance: 0.01}\n"
    with pytest.raises(InputError, match="need a readout"):
        read_simulations(written(tmp_path, text))


def test_sweep_is_the_cartesian_product(tmp_path: Path) -> None:
    sweep = "sweep: {seed: [1, 2], loads.0.pressure_kpa: [-5, -10, -20]}\noutput: 'out/s{seed:03d}_{pressure_kpa}.h5'\n"
    found = read_simulations(written(tmp_path, BASE + sweep))
    assert [name for name, _ in found] == [f"out/s{seed:03d}_{kpa}.h5" for seed in (1, 2) for kpa in (-5, -10, -20)]
    assert [(simulation.seed, simulation.loads[0].pressure_kpa) for _, simulation in found] == [
        (seed, kpa) for seed in (1, 2) for kpa in (-5, -10, -20)
    ]


def test_swept_files_go_into_a_folder(tmp_path: Path, lampest: Command) -> None:
    path = written(tmp_path, BASE + "sweep: {seed: [1, 2]}\n")
    one, same = (lampest("simulate", path, "--out", target) for target in (tmp_path / "one.h5", path))
    refused(one, r"must be a folder, because .* makes 2 recordings")
    refused(same, "is an input; give the output another name")
    assert made(lampest, path, tmp_path / "many") == [tmp_path / "many" / f"scene_00{case}.h5" for case in (1, 2)]
    assert sorted(made.name for made in (tmp_path / "many").iterdir()) == ["scene_001.h5", "scene_002.h5"]


def test_one_file_goes_where_it_says(tmp_path: Path, lampest: Command) -> None:
    path = written(tmp_path, BASE + "output: made/here.h5\n")
    assert made(lampest, path) == [tmp_path / "made" / "here.h5"]
    refused(lampest("simulate", path, "--out", tmp_path), "is a folder")


def test_recording_tells_how_it_was_made(tmp_path: Path, lampest: Command) -> None:
    text = BASE.replace("diameter_mm: 25", "diameter_mm: {uniform: [20, 25]}")
    ((_, simulation),) = read_simulations(written(tmp_path, text))
    (file,) = made(lampest, written(tmp_path, text), tmp_path / "a.h5")
    told = Recording.load(file).simulation
    assert read_simulations(written(tmp_path, told)) == [("scene.h5", simulation)]
    assert 20 <= simulation.loads[0].diameter_mm <= 25


def test_further_drawn_numbers_leave_the_others_alone(tmp_path: Path) -> None:
    once = BASE.replace("diameter_mm: 25", "diameter_mm: {uniform: [20, 25]}")
    twice = once.replace("mass_g: 50", "mass_g: {uniform: [1, 50]}").replace("frames: 2", "frame_period_s: 2.0")
    ((_, first),) = read_simulations(written(tmp_path, once))
    ((_, second),) = read_simulations(written(tmp_path, twice))
    assert first.loads[0] == second.loads[0]
    assert first.loads[1] != second.loads[1]


def test_cohort_is_thirty_different_lampreys() -> None:
    cohort = read_simulations(ROOT / "configs" / "cohort.yaml")
    assert len(cohort) == 30
    assert cohort[6][0] == "../results/cohort/lamprey_07.h5"
    mouths = [simulation.loads[0] for _, simulation in cohort]
    assert all(20 <= mouth.diameter_mm <= 45 for mouth in mouths)
    assert max(mouth.diameter_mm for mouth in mouths) > 40
    assert min(mouth.diameter_mm for mouth in mouths) < 25
    assert len({mouth.centre_mm for mouth in mouths}) == 30


SIMULATED = sorted(path for path in (ROOT / "data").glob("*.h5") if not path.stem.startswith("insole"))


def test_a_real_scene_is_the_clean_one_on_another_panel() -> None:
    """The same loads, times and water; one panel for all eight, which the scene does not tell of."""
    panels = set()
    for path in SIMULATED:
        ((_, clean),) = read_simulations(ROOT / "configs" / f"{path.stem}.yaml")
        ((name, real),) = read_simulations(ROOT / "configs" / f"real_{path.stem}.yaml")
        assert name == f"../results/real/real_{path.stem}.h5"
        for part in ("loads", "course", "frames", "baseline_frames"):
            assert getattr(real, part) == getattr(clean, part)
        for part in ("panel", "readout", "water"):
            assert getattr(real.scene, part) == getattr(clean.scene, part)
        assert real.scene.systematic is None and (real.unmodelled.reading_error or 0) > 0.03
        panels.add((real.seed, real.cells, real.unmodelled))
    assert len(panels) == 1
