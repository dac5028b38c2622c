"""Which readings are wrong: what the circuit can do stays, what it cannot do is missing."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from promises import promise

import lampest
from docs.studies.wrong_readings import drawn, of_load
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.inference.readings.judge import Cleaned
from lampest.recording.recording import Recording
from tests.panels import READOUTS, Plan, recorded

SEEDS = range(6)
ALONE = ("grounded, one", "grounded, all", "amplifiers")  # one cell moves one reading, nearly
TOGETHER = ("two_point", "pull_ups")  # a cell moves its row and its column
SIZES = (0.7, 2.3)  # of a tap, in ln r


class Tapped(Plan):
    """A plan without a load, whose cells change in single frames."""

    def place(self) -> tuple[int, int, int]:
        """Return a measured frame that is neither the first nor the last, a row and a column."""
        rng = np.random.default_rng([self.seed, 3])
        rows, columns = self.cells.shape
        frame = self.unloaded + int(rng.integers(1, self.measured - 1))
        return frame, int(rng.integers(rows)), int(rng.integers(columns))

    def tapped(self) -> Recording:
        """Return a recording in which one cell is pressed in one frame."""
        cells = self.loaded()
        cells[self.place()] *= np.exp(-np.random.default_rng(self.seed).uniform(*SIZES))
        return self.recording(self.volts(cells=cells))

    def with_error(self) -> Recording:
        """Return a recording in which one reading of one frame is wrong by a fifth of the range."""
        codes: NDArray[np.int64] = self.codes()
        top = 2**self.scene.circuit.adc_bits
        place = self.place()
        codes[place] += top // 5 if codes[place] < top / 2 else -top // 5
        return recorded(self.scene, codes, self.unloaded)


def plans(kind: str) -> list[Tapped]:
    return [Tapped(**vars(replace(Plan.drawn(seed, kind), load="none"))) for seed in SEEDS]


@promise("howto/readings: **A tap of one frame stays.**")
@pytest.mark.parametrize("kind", READOUTS)
def test_a_tap_of_one_frame_stays(kind: str) -> None:
    """61 of 65 were deleted, with cells seven to eight times too large."""
    for plan in plans(kind):
        cleaned = Cleaned.of(plan.tapped())
        assert (cleaned.readings.seen == 1).all()
        np.testing.assert_array_equal(cleaned.readings.value, plan.tapped().readings().value)


def test_the_summit_of_a_load_that_sways_stays() -> None:
    """Two frames of one cell were deleted, whose neighbours changed by a third of its change."""
    cleaned = Cleaned.of(drawn(156, of_load("sway")).recording())
    assert (cleaned.readings.seen == 1).all()


@promise("howto/readings: **An impossible reading is missing.**")
@pytest.mark.parametrize("kind", TOGETHER)
def test_a_reading_that_no_cell_gives_is_missing_and_named(kind: str) -> None:
    for plan in plans(kind):
        frame, row, column = plan.place()
        prepared = Prepared(plan.with_error())
        missing = np.argwhere(prepared.cleaned.readings.seen == 0).tolist()
        assert missing == [[frame, row, column]]
        named = f"row {row}, column {column} of frame {frame} by"
        assert (
            named in prepared.frame_noise.sentence and "left out" in prepared.frame_noise.sentence
        )


@promise("howto/readings: `outliers: exclude` leaves it out.")
@pytest.mark.parametrize("kind", ALONE)
def test_an_outlier_stays_with_its_name_unless_the_scene_excludes_it(kind: str) -> None:
    for plan in plans(kind)[:3]:
        frame, row, column = plan.place()
        recording = plan.with_error()
        prepared = Prepared(recording)
        if prepared.cleaned.readings.seen.all():
            assert f"row {row}, column {column} of frame {frame}" in prepared.frame_noise.sentence
        excluding = replace(recording, scene=replace(recording.scene, outliers="exclude"))
        missing = np.argwhere(Cleaned.of(excluding).readings.seen == 0).tolist()
        assert missing == [[frame, row, column]]


@pytest.mark.slow
@promise("howto/readings: `outliers: robust` keeps all readings")
def test_a_robust_scene_gives_squared_misfits_students_loss() -> None:
    readout = lampest.VirtualGroundReadout(
        drive_ohm=0, sense_ohm=0, feedback_ohm=1000.0, adc_bits=14, noise_lsb=1.0
    )
    scene = lampest.Scene(lampest.Panel(5, 5), readout, outliers="robust")
    robust = lampest.simulate(lampest.Simulation(schema=1, seed=3, scene=scene, frames=4))
    frame = len(robust.recorded) - 3
    codes = robust.recorded.copy()
    codes[frame, 2, 3] *= 1.3
    robust = replace(robust, recorded=codes)
    kept = replace(robust, scene=replace(scene, outliers=None))
    assert (Cleaned.of(robust).readings.seen == 1).all()
    assert "kept, with Student's loss" in Prepared(robust).frame_noise.sentence
    penalty = lampest.LogGradient(weight=3000.0)
    squared = lampest.Misfit(weighting="noise")
    student = lampest.Misfit(weighting="noise", loss=lampest.Student(corner=4.0))
    by_scene = lampest.reconstruct(robust, [squared, penalty])
    stated = lampest.reconstruct(kept, [student, penalty])
    np.testing.assert_array_equal(by_scene.cell_resistance, stated.cell_resistance)
    by_squares = lampest.reconstruct(kept, [squared, penalty]).cell_resistance[:, 2, 3]
    before, within, after = by_scene.cell_resistance[:3, 2, 3]
    usual = np.sqrt(before * after)
    assert abs(np.log(within / usual)) < abs(np.log(by_squares[1] / usual)) / 2
    assert "kind: student" in by_scene.result("mine").case_yaml
    with pytest.raises(InputError, match="outliers: robust needs misfit"):
        lampest.reconstruct(robust, [lampest.Misfit(), penalty])


@promise("howto/readings: **In unloaded frames no cell changes.**")
def test_an_outlier_of_an_unloaded_frame_is_left_out_of_the_mean() -> None:
    for plan in plans("grounded, all"):
        codes = plan.codes()
        codes[1, 2, 3] += 2**plan.scene.circuit.adc_bits // 8
        cleaned = Cleaned.of(recorded(plan.scene, codes, plan.unloaded))
        assert np.argwhere(cleaned.readings.seen == 0).tolist() == [[1, 2, 3]]


@pytest.mark.slow
def test_noise_that_the_scene_leaves_open_is_no_doubt() -> None:
    """Key-less scenes were doubtful: scatter of 1.4 to 5.4 times the *specified* noise."""
    for kind in READOUTS:
        plan = Tapped(**vars(replace(Plan.drawn(3, kind), load="none")))
        codes = plan.codes()
        codes = codes + np.rint(3 * np.random.default_rng(4).standard_normal(codes.shape))
        readout = replace(plan.scene.readout, noise_lsb=None)
        scene = replace(plan.scene, readout=readout)
        check = Prepared(recorded(scene, codes.astype(int), plan.unloaded)).check
        assert "specified noise" not in check.sentence


def garbled_frames(plan: Plan, count: int) -> tuple[Recording, list[int]]:
    """Return a recording with two random rows in each of some frames, and their numbers."""
    rng = np.random.default_rng([plan.seed, 5])
    codes = plan.codes()
    top = 2**plan.scene.circuit.adc_bits
    frames = np.sort(rng.choice(np.arange(1, len(codes) - 1), count, replace=False))
    for frame in frames:
        rows = rng.choice(codes.shape[1], 2, replace=False)
        codes[frame, rows] = rng.integers(0, top, (2, codes.shape[2]))
    return recorded(plan.scene, codes, plan.unloaded), frames.tolist()


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 3, 5])
def test_garbled_frames_do_not_hide_each_other(count: int) -> None:
    """Of two such frames 5 in 40 recordings were found, of five none in 100."""
    found = []
    for seed in range(24):
        plan = replace(Plan.drawn(seed), unloaded=6, measured=18, load="stands")
        plan = replace(plan, cells=np.resize(plan.cells, (16, 16)))
        plan = replace(
            plan, scene=replace(plan.scene, panel=replace(plan.scene.panel, rows=16, columns=16))
        )
        recording, frames = garbled_frames(plan, count)
        found.append([lines.frame for lines in Cleaned.of(recording).garbled] == frames)
    assert np.mean(found) > 0.9


@pytest.mark.slow
def test_a_frame_is_garbled_whose_neighbours_lost_the_same_rows() -> None:
    """Two of its four neighbours hid it: their scatter was that of random readings."""
    found = []
    for seed in range(24):
        plan = replace(Plan.drawn(seed), unloaded=6, measured=18, load="stands")
        codes = plan.codes()
        rng = np.random.default_rng([seed, 6])
        frames = [10, 12, 13]
        shape = (len(frames), 2, codes.shape[2])
        codes[frames, :2] = rng.integers(0, 2**plan.scene.circuit.adc_bits, shape)
        lines = Cleaned.of(recorded(plan.scene, codes, plan.unloaded)).garbled
        found.append([line.frame for line in lines] == frames)
    assert np.mean(found) > 0.8  # 0.17 where all frames are judged at once


def test_the_only_unloaded_frame_is_not_judged_against_loaded_ones() -> None:
    """It was called garbled where all others are loaded everywhere."""
    for seed in range(12):
        plan = replace(Plan.drawn(seed), unloaded=1, measured=8, load="none")
        tapped = Tapped(**vars(plan))
        loads = np.exp(-np.random.default_rng(seed).uniform(1, 3, (8, *plan.cells.shape)))
        cells = plan.cells * np.concatenate([np.ones((1, *plan.cells.shape)), loads])
        assert not Cleaned.of(tapped.recording(tapped.volts(cells=cells))).garbled
