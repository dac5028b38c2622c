"""Films that remember and zeros that are taken anew, as a user meets them: files, commands, results, sentences."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lampest import UNLOADED, Recording, read_results, read_simulations

Command = Callable[..., SimpleNamespace]
SCENE = """\
schema: 1
seed: 4
scene:
  panel: {rows: 5, columns: 5, pitch_mm: 10}
  readout: {kind: two_point, adc_bits: 12}
  series_resistance_ohm: 140
  film: {hysteresis: 0.2, creep_per_decade: auto, cell_spread: 0.1}
  response: {kind: published}
film: {hysteresis: 0.2, creep_per_decade: 0.06}
baseline_frames: 4
frames: 60
loads:
  - {kind: rod, centre_mm: [20, 20], diameter_mm: 30, mass_g: 900}
course: {start_s: 15, approach_s: 2, release_at_s: 35, release_s: 1}
unmodelled: {drift_per_minute: 0.01}
output: pressed.h5
"""
RUN = """\
schema: 1
recordings: [pressed.h5]
estimators:
  LSM: {terms: {misfit: {}}, tare: {frames: 8}}
formulation: reduced
"""


@pytest.fixture
def recording(tmp_path: Path, lampest: Command) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE, encoding="utf-8")
    assert lampest("simulate", tmp_path / "scene.yaml").code == 0
    return tmp_path / "pressed.h5"


def test_a_run_reads_the_film_and_says_what_it_took_it_for(recording: Path, lampest: Command) -> None:
    config, out = recording.parent / "run.yaml", recording.parent / "out"
    config.write_text(RUN, encoding="utf-8")
    assert lampest("run", config, "--out", out, "--jobs", "1").code == 0
    (case,) = read_results(out / "results.h5").cases
    truth = Recording.load(recording).truth_pressure
    assert truth is not None and case.pressure is not None and case.tared is not None
    error = np.abs(case.pressure - truth[case.frame])
    assert np.percentile(error, 95) < 0.08 * truth.max()
    assert error[45:].max() < 0.3
    at = np.flatnonzero([bool(why) for why in case.tared])
    assert len(at) and not np.any((at > 15) & (at < 36))
    assert case.tared[at[0]].startswith("nothing touched the panel for 8 frames (7 s)")
    told = lampest("info", out / "results.h5")
    assert "film       creep " in told.out and "from the recording" in told.out
    assert "film       hysteresis 0.2, creep_per_decade auto" in lampest("info", recording).out


def test_tare_makes_other_frames_the_unloaded_ones_and_changes_nothing_else(recording: Path, lampest: Command) -> None:
    out = recording.parent / "zeroed.h5"
    ended = lampest("tare", recording, "--frames", "55:60", "--out", out)
    assert (ended.code, ended.out, ended.err) == (0, f"unloaded: frames 55 to 59: {out}\n", "")
    before, after = Recording.load(recording), Recording.load(out)
    np.testing.assert_array_equal(np.flatnonzero(after.role == UNLOADED), np.arange(55, 60))
    for name in ("recorded", "time", "truth_pressure", "raw_sums"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert after.scene == before.scene and after.simulation == before.simulation


def test_tare_says_where_something_came_or_went(recording: Path, lampest: Command) -> None:
    ended = lampest("tare", recording, "--frames", "10:30", "--out", recording.parent / "zeroed.h5")
    assert ended.code == 0 and "did a load come or go?" in ended.err


@pytest.mark.parametrize(
    ("frames", "words"), [("5", "FIRST:END"), ("60:70", "frames 0 to 63"), ("7:7", "some must be named"), (":", "none")]
)
def test_frames_that_cannot_be_are_one_sentence(recording: Path, lampest: Command, frames: str, words: str) -> None:
    out = recording.parent / "zeroed.h5"
    ended = lampest("tare", recording, "--frames", frames, "--out", out)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert words in ended.err and not out.exists()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("  film: {hysteresis: 0.2, creep: 0.06}", "film.creep: no such key"),
        ("  film: {hysteresis: 0.9}", "hysteresis must lie between 0 and 0.6"),
        ("  film: {creep_per_decade: often}", "creep_per_decade"),
    ],
)
def test_films_that_cannot_be_are_one_sentence_with_its_place(
    tmp_path: Path, lampest: Command, line: str, words: str
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(
        SCENE.replace("  film: {hysteresis: 0.2, creep_per_decade: auto, cell_spread: 0.1}", line), encoding="utf-8"
    )
    ended = lampest("simulate", path)
    assert (ended.code, ended.out) == (2, "") and ended.err.startswith(f"lampest: {path}:7:")
    assert words in ended.err and not (tmp_path / "pressed.h5").exists()


def test_shipped_configurations_are_read() -> None:

    ((name, simulation),) = read_simulations(Path(__file__).parents[2] / "configs" / "film.yaml")
    assert name.endswith("lamprey_film.h5") and simulation.film is not None
