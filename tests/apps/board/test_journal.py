"""Files whose writer was killed: read as far as they are whole."""

import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from unclosed import unclosed_recording

from lampest import InputError, Panel, Recording, Scene, TwoPointReadout
from lampest.apps.board.journal import repair
from lampest.files.checksums import is_left_open
from lampest.recording.acquisition import EVENTS, Rows
from lampest.recording.stored import StoredRecording, joined

SCENE = Scene(Panel(3, 4), TwoPointReadout(noise_lsb=0.7), series_resistance_ohm=140.0)
FRAMES = 12
PLACES = (
    "two_point/resistance",
    "two_point/time",
    "two_point/role",
    "raw/sums",
    "acquisition/host_time",
)
PLACES += (
    "acquisition/device_ms",
    "acquisition/sequence",
    "acquisition/lost",
    "acquisition/session",
)


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    return unclosed_recording(tmp_path / "killed.h5", SCENE, FRAMES, unloaded=3)


def flip(path: Path, place: str, row: int) -> None:
    """Turn a low bit of a row of a dataset."""
    with h5py.File(path.with_name("growing.h5")) as file:
        dataset = file[f"entry/{place}"]
        begin = dataset.id.get_chunk_info(0).byte_offset + row * dataset[0].nbytes
    damaged = bytearray(path.read_bytes())
    damaged[begin] ^= 1
    path.write_bytes(damaged)


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_check_names_a_damaged_frame_and_repair_drops_it(
    killed: Path, place: str, lampest: Callable[..., Any]
) -> None:
    meant = Recording.load(killed)
    flip(killed, place, 5)
    for reader in (Recording.load, StoredRecording.of):
        with pytest.raises(
            InputError, match=r"killed.h5: 1 of 12 frames .* frame 5; .*check --repair"
        ):
            reader(killed)
    completed = lampest("check", "--repair", killed)
    assert (completed.code, completed.err) == (0, "")
    assert completed.out == f"11 frames: {killed}; 1 damaged frame is dropped and counts as lost\n"
    recording = Recording.load(killed)
    remaining = np.delete(np.arange(FRAMES), 5)
    np.testing.assert_array_equal(recording.recorded, meant.recorded[remaining])
    np.testing.assert_array_equal(recording.raw_sums, np.asarray(meant.raw_sums)[remaining])
    np.testing.assert_array_equal(recording.time, meant.time[remaining])
    np.testing.assert_array_equal(recording.acquisition.sequence, remaining)
    np.testing.assert_array_equal(recording.acquisition.lost, (remaining == 6).astype(int))
    assert recording.acquisition.event_label == ("touch", "leave")
    assert sorted(file.name for file in killed.parent.iterdir()) == ["growing.h5", "killed.h5"]


def test_estimates_of_a_board_are_stored_and_checked_like_sums(tmp_path: Path) -> None:
    killed = unclosed_recording(tmp_path / "killed.h5", SCENE, FRAMES, unloaded=3, estimates=True)
    number = np.where(np.arange(FRAMES) % 2, np.arange(FRAMES), np.nan)
    expected = np.broadcast_to(number[:, None, None], (FRAMES, 3, 4))
    np.testing.assert_array_equal(Recording.load(killed).board_log_change, expected)
    flip(killed, "board/log_change", 5)
    with pytest.raises(InputError, match=r"killed.h5: 1 of 12 frames .* frame 5"):
        Recording.load(killed)
    assert repair(killed) == (FRAMES - 1, 1)
    recording = Recording.load(killed)
    remaining = np.delete(np.arange(FRAMES), 5)
    np.testing.assert_array_equal(recording.board_log_change, expected[remaining])
    assert joined((recording,), remaining > 7).board_log_change.shape == (4, 3, 4)
    with pytest.raises(
        InputError, match="/entry/board/log_change has another shape than the frames"
    ):
        replace(recording, board_log_change=expected)


@pytest.mark.long
@pytest.mark.parametrize("damaged", [None, 5])
def test_a_journal_without_a_salt_is_readable(killed: Path, damaged: int | None) -> None:
    """Older versions computed checksums of a row's columns without a salt and the row's number."""
    meant = Recording.load(killed).recorded
    with h5py.File(killed.with_name("growing.h5"), "r+") as file:
        for rows in (Rows.of_frames(SCENE.circuit), EVENTS):
            sums = file[f"entry/{rows.checksum[0]}"]
            del sums.attrs["salt"]
            columns = [file[f"entry/{path}"] for path, *_ in rows.datasets]
            for row in range(len(sums)):
                sums[row] = zlib.crc32(
                    b"".join(column[row : row + 1].tobytes() for column in columns)
                )
        if damaged is not None:
            file["entry/raw/sums"][damaged] = file["entry/raw/sums"][damaged] ^ np.uint16(1)
    old = killed.with_name("growing.h5")
    if damaged is not None:
        with pytest.raises(InputError, match=r"1 of 12 frames .* frame 5"):
            Recording.load(old)
    remaining = range(FRAMES) if damaged is None else np.delete(np.arange(FRAMES), damaged)
    assert damaged is not None or np.array_equal(Recording.load(old).recorded, meant)
    assert repair(old) == (len(remaining), FRAMES - len(remaining))
    np.testing.assert_array_equal(Recording.load(old).recorded, meant[list(remaining)])


def test_a_damaged_event_is_dropped(killed: Path) -> None:
    flip(killed, "acquisition/event_label", 0)
    with pytest.raises(InputError, match=r"killed.h5: an event is damaged; .*check --repair"):
        Recording.load(killed)
    assert repair(killed) == (FRAMES, 0)
    acquisition = Recording.load(killed).acquisition
    assert (
        acquisition is not None
        and acquisition.event_label == ("leave",)
        and acquisition.event_time.tolist() == [0.5]
    )


def test_the_shortest_dataset_limits_the_number_of_events(killed: Path) -> None:
    """A writer that was killed between two datasets left one longer than the other."""
    for name, flags in (("time", [1, 0]), ("label", [1, 0]), ("crc32", [1])):
        with (
            h5py.File(killed.with_name("growing.h5")) as file,
            h5py.File(killed.with_name("c.h5"), "w") as copy,
        ):
            file.copy("entry", copy)
            copy[f"entry/acquisition/event_{name}"].resize(1, axis=0)
            assert EVENTS.undamaged(copy).tolist() == flags


def test_a_fully_damaged_journal_is_refused_and_left_unchanged(killed: Path) -> None:
    for row in range(FRAMES):
        flip(killed, "raw/sums", row)
    original = killed.read_bytes()
    with pytest.raises(InputError, match="every frame is damaged"):
        repair(killed)
    assert killed.read_bytes() == original


def test_an_unclosed_file_is_read_unchanged_and_a_truncated_one_refused(killed: Path) -> None:
    content = killed.read_bytes()
    assert is_left_open(killed) and len(Recording.load(killed).time) == FRAMES
    assert killed.read_bytes() == content
    for length in (20, 47, 48, 300, len(content.rstrip(b"\0")) // 2):  # zeros are reserved room
        killed.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"killed\.h5"):
            Recording.load(killed)


def test_damage_of_an_unclosed_file_gives_one_sentence(killed: Path) -> None:
    """HDF5 alone waits for the right checksum without end."""
    content = killed.read_bytes()
    expected = Recording.load(killed).recorded
    refused = 0
    with h5py.File(killed.with_name("growing.h5")) as file:
        header = h5py.h5o.get_info(file["entry/two_point/resistance"].id).addr
    for place in (9, 12, header + 6, *np.random.default_rng(1).integers(0, header + 200, 60)):
        damaged = bytearray(content)
        damaged[place] ^= 16
        killed.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(Recording.load(killed).recorded, expected)
        except InputError as error:
            assert str(error).startswith(str(killed))
            refused += 1
    assert refused > 10, "some of the flipped bits do damage"
