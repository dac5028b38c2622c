"""A board that estimates, from its pins to the commands record, info and live."""

import dataclasses
import itertools
from pathlib import Path

import h5py
import numpy as np
import pytest
import serial
from apps.board.bench import bench, lampest, portable_bench, scene, scene_file
from apps.board.estimated import pressed_cells, recording_of, solved_case, sums_of
from apps.microcontroller.wrong_circuits import corners
from support import live_pictures

from lampest import Estimator, LogGradient, LogRatio, Misfit, Recording, Squared, reconstruct
from lampest.apps.board.own_estimate import difference_sentence
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening
from lampest.apps.live.run import from_recording, recorded_from_board
from lampest.apps.microcontroller.constants import Constants
from lampest.apps.microcontroller.header import header
from lampest.apps.microcontroller.host import compiled
from lampest.apps.microcontroller.sketch import export_sketch
from lampest.report.words import digits

SHAPE = (6, 5)
UNLOADED_FRAMES = 4
FRAMES = 12
SCENE = scene(*SHAPE)
CELLS = pressed_cells(SCENE, FRAMES, UNLOADED_FRAMES, ohm=3000.0)
CHANGE = np.log(CELLS / CELLS[0])
MIN_LOG_CHANGE = -1.5  # of pressed cells
MAX_ERROR = 0.03  # of log r by the board, with its noise; twice that where cells change in a scan
MAX_DIFFERENCE_PERCENT = 2  # between the estimates of board and computer
# the same in standard deviations of a cell
MAX_MEDIAN_SIGMA = 0.2
MAX_SIGMA = 3.0
pytestmark = pytest.mark.slow
KEYBOARD = "lampest_estimate/examples/keyboard/keyboard.ino"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory):
    """The exported folder of an estimator, its budget, and its case."""
    folder = tmp_path_factory.mktemp("exported")
    # The cells at rest were others then, so that the board needs a baseline of its own.
    cells = CELLS[1:9] * np.exp(0.1 * np.random.default_rng(8).standard_normal(SHAPE))
    estimate = reconstruct(
        recording_of(SCENE, sums_of(SCENE, cells), 3), [Misfit(weighting="noise"), LogGradient()]
    )
    estimate.save(folder / "results.h5", name="smooth")
    return (
        folder / "mat",
        export_sketch(folder / "results.h5", folder / "mat").budget,
        estimate.result("smooth"),
    )


@pytest.fixture(scope="module")
def recorded(exported, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the board with its estimates."""
    folder = tmp_path_factory.mktemp("recorded")
    with portable_bench(folder, exported[0], CELLS) as board:
        summary = record(
            Listening((board.port,), scene=SCENE, baseline=UNLOADED_FRAMES),
            folder / "r.h5",
            frames=FRAMES,
        )
    assert summary.lost == 0
    return folder / "r.h5"


def test_the_recording_holds_sums_and_the_estimates_of_the_library(
    exported, recorded: Path
) -> None:
    """The board takes its baseline from the unloaded frames."""
    _, budget, case = exported
    recording = Recording.load(recorded)
    with h5py.File(recorded) as file:
        dataset = file["entry/board/log_change"]
        assert (
            dataset.attrs["units"] == b"1" and b"ln(r / r unloaded)" in dataset.attrs["long_name"]
        )
        assert file["entry/board"].attrs["signal"] == b"log_change"
    assert np.isnan(recording.board_log_change[:UNLOADED_FRAMES]).all()
    with compiled(Constants.of(case)) as host:
        assert host.begin(budget) == 0
        for sums in recording.raw_sums[:UNLOADED_FRAMES]:
            host.baseline(sums)
        expected = [host.frame(sums)[0] for sums in recording.raw_sums[UNLOADED_FRAMES:]]
    np.testing.assert_array_equal(recording.board_log_change[UNLOADED_FRAMES:], expected)
    np.testing.assert_allclose(
        recording.board_log_change[UNLOADED_FRAMES:], CHANGE[UNLOADED_FRAMES:], atol=MAX_ERROR
    )


def test_info_compares_both_estimates_in_sigma_and_percent(recorded: Path) -> None:
    output, _ = lampest("info", recorded)
    (line,) = [line for line in output.splitlines() if line.startswith("board ")]
    assert (
        "estimated 8 of 8 measured frames" in line and "(misfit + log_gradient, 8 frames)" in line
    )
    median, largest = (
        float(line.split(word)[0].split(" σ")[-2].split()[-1])
        for word in ("in the median", "at most")
    )
    assert 0 < median < MAX_MEDIAN_SIGMA and median < largest < MAX_SIGMA
    assert line.count(" %)") == 2 and line.endswith("σ is a cell's own error")


def test_info_does_not_compare_without_unloaded_frames(recorded: Path, tmp_path: Path) -> None:
    recording = Recording.load(recorded, slice(UNLOADED_FRAMES, FRAMES))
    recording.save(tmp_path / "loaded.h5")
    output, _ = lampest("info", tmp_path / "loaded.h5")
    assert (
        "estimated 8 of 8 measured frames; they are compared where unloaded frames precede them"
        in output
    )


def test_live_shows_the_map_of_the_board_next_to_its_own(exported, tmp_path: Path) -> None:
    with portable_bench(tmp_path, exported[0], CELLS) as board:
        source = Listening((board.port,), SCENE, UNLOADED_FRAMES)
        method = Estimator((Misfit(weighting="noise"), LogGradient()), "reduced")
        shown = live_pictures(
            method,
            UNLOADED_FRAMES,
            lambda engine: recorded_from_board(engine, source, tmp_path / "r.h5", FRAMES),
        )
    assert len(shown) == FRAMES - UNLOADED_FRAMES
    for picture, change in zip(shown, CHANGE[UNLOADED_FRAMES:], strict=True):
        np.testing.assert_allclose(
            picture.board_change, 100 * np.expm1(change), atol=100 * MAX_ERROR
        )
        np.testing.assert_allclose(
            picture.board_change, picture.relative_change, atol=MAX_DIFFERENCE_PERCENT
        )
    recording = Recording.load(tmp_path / "r.h5")
    replayed = live_pictures(
        method, UNLOADED_FRAMES, lambda engine: from_recording(engine, recording, 1e6, None)
    )
    np.testing.assert_allclose(
        [picture.board_change for picture in replayed], [view.board_change for view in shown]
    )


def test_a_baseline_under_load_is_named_and_the_old_one_stays(exported, tmp_path: Path) -> None:
    cells = np.array([CELLS[0] * np.where(np.indices(SHAPE).sum(axis=0) == 4, 0.1, 1.0)])
    with portable_bench(tmp_path, exported[0], cells) as board:
        words = (
            "--port",
            board.port,
            "--scene",
            scene_file(tmp_path, *SHAPE),
            "--out",
            tmp_path / "r.h5",
        )
        _, warned = lampest("record", *words, "--count", 5, "--baseline", 2)
    reason = "something lies on the panel while it takes its baseline"
    assert f"the board did not estimate 2 of the 5 frames: {reason}" in warned
    recording = Recording.load(tmp_path / "r.h5")
    assert (
        np.isfinite(recording.board_log_change[2:]).all()
        and np.isnan(recording.board_log_change[:2]).all()
    )
    assert recording.board_log_change[2:].min() < MIN_LOG_CHANGE


def test_damaged_estimates_never_spoil_a_frame(exported, tmp_path: Path) -> None:
    """A damaged message is lost as a whole."""
    cells = np.repeat(CELLS[-1:], 60, axis=0) * np.exp(0.05 * np.arange(60))[:, None, None]
    cells[:UNLOADED_FRAMES] = CELLS[0]
    with portable_bench(tmp_path, exported[0], cells, "--flip", 1e-3, "--seed", 3) as board:
        summary = record(
            Listening((board.port,), scene=SCENE, baseline=UNLOADED_FRAMES),
            tmp_path / "r.h5",
            frames=50,
        )
        assert board.stop()["flipped"] > 5
    recording = Recording.load(tmp_path / "r.h5")
    known = np.isfinite(recording.board_log_change).all(axis=(1, 2))
    measured = recording.role == 1
    assert summary.frames == 50 and 0 < np.sum(measured & ~known) < 20
    change = np.log(cells[np.round(recording.time).astype(int)] / CELLS[0])
    np.testing.assert_allclose(recording.board_log_change[known], change[known], atol=2 * MAX_ERROR)
    assert np.isfinite(recording.recorded).all()


def test_boards_without_an_estimate_record_as_usual(exported, tmp_path: Path) -> None:
    """The Mega does not know the command."""
    (tmp_path / "mega").mkdir()
    with bench(tmp_path / "mega", CELLS[:1]) as board:
        record(Listening((board.port,), scene=SCENE, baseline=1), tmp_path / "mega.h5", frames=2)
    small = scene(6, 4)
    with portable_bench(tmp_path, exported[0], CELLS[:1, :, :4]) as board:
        record(Listening((board.port,), scene=small, baseline=1), tmp_path / "small.h5", frames=2)
    for name in ("mega", "small"):
        assert Recording.load(tmp_path / f"{name}.h5").board_log_change is None
        with h5py.File(tmp_path / f"{name}.h5") as file:
            assert "board" not in file["entry"]


def chords(rng: np.random.Generator, count: int) -> list[set[tuple[int, int]]]:
    """Return chords of three and four keys, corners of rectangles."""
    drawn = (corners(rng, SHAPE) for _ in range(count))
    return [{keys[at] for at in rng.permutation(4)[: rng.integers(3, 5)]} for keys in drawn]


def test_the_keyboard_prints_presses_and_releases_with_strengths_and_no_ghosts(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(2)
    resting = 30_000.0 * np.exp(0.1 * rng.standard_normal(SHAPE))
    played = chords(rng, 6)
    states = [resting]
    for chord in played:
        pressed = resting.copy()
        for key in chord:
            pressed[key] = rng.uniform(1500, 4000)
        states += [resting, pressed]
    terms = [Misfit(weighting="noise"), LogRatio(loss=Squared(), weight=1e-4)]
    training = sums_of(SCENE, np.array([resting] * 3), 0)
    _, case = solved_case(SCENE, terms, sums=training, unloaded=2, error_bars=False)
    text = header(Constants.of(case), "panel", ())
    readings = f"#define PANEL_READINGS {SCENE.circuit.readings}\n\nstatic const"
    (tmp_path / "panel_constants.h").write_text(text.replace("static const", readings, 1))
    events: list[list[str]] = []
    with (
        portable_bench(
            tmp_path, tmp_path, np.array([*states, resting]), period=0.5, sketch=KEYBOARD
        ) as board,
        serial.Serial(board.port, timeout=20) as port,
    ):
        expected_count = 2 * sum(map(len, played))
        while len(events) < expected_count and (line := port.readline()):
            events.append(line.decode().split())
    heard = [
        (word, list(group)) for word, group in itertools.groupby(events, key=lambda event: event[0])
    ]
    assert [
        (word, {(int(row), int(column)) for _, row, column, _ in group}) for word, group in heard
    ] == [(word, chord) for chord in played for word in ("press", "release")]
    for (_, presses), cells in zip(heard[::2], states[2::2], strict=True):
        for _, row, column, strength in presses:
            assert float(strength) == pytest.approx(
                np.log(resting / cells)[int(row), int(column)], abs=5 * MAX_ERROR
            )
    assert all(strength == "0.00" for _, group in heard[1::2] for *_, strength in group)


def test_the_largest_difference_names_its_frame_and_its_percent_without_error_bars(
    exported,
) -> None:
    case = exported[2]
    own = np.log(case.cell_resistance / case.baseline_resistance)
    altered = own.copy()
    altered[3, 2, 1] -= np.log(1.5)
    numbers = 10 * np.arange(len(own))
    bare = dataclasses.replace(case, sigma_own=None, sigma_common=None)
    assert "by 0 % in the median, 50 % at most, in frame 30" in difference_sentence(
        bare, altered, numbers
    )
    largest = np.log(1.5) / case.sigma_own[3, 2, 1]
    assert f"{digits(largest, 2)} σ (50 %) at most, in frame 30; σ is" in difference_sentence(
        case, altered, numbers
    )
    assert (
        difference_sentence(case, np.full_like(own, np.nan), numbers)
        == "no cell has both estimates"
    )
