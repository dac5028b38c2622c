"""Notations of lines that sketches and tools print: a file and a port give the same frames."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from lampest import Array, InputError, LoadedColumnsReadout, Panel, Scene, import_file
from lampest.apps.foreign.line_reader import LineReader
from tests.fuzz.tables import codes

Lines = Callable[[Array], Iterable[str]]


def joined(values: Array, sign: str = ",") -> str:
    return sign.join(map(str, np.ravel(values)))


# One frame → its lines.
NOTATIONS: dict[str, Lines] = {
    "rows by semicolons": lambda frame: [";".join(joined(row) for row in frame) + ";"],
    "rows by bars": lambda frame: ["".join(joined(row, " ") + "|" for row in frame)],
    "a matrix of MATLAB": lambda frame: [f"[{'; '.join(joined(row, ' ') for row in frame)}]"],
    "a nested list in quotes": lambda frame: [f'0.5,"{frame.tolist()}"'],
    "rows of an object of JSON": lambda frame: [
        "{",
        '"mat": {',
        *(f'"row{number}": [{joined(row)}],' for number, row in enumerate(frame)),
        "}",
        "}",
        "END",
    ],
    "marks of begin and end": lambda frame: [f"*{joined(frame)}#"],
    "a checksum": lambda frame: [f"$MAT,{joined(frame)}*5A"],
    "a topic": lambda frame: [f"mat/left {json.dumps({'v': frame.ravel().tolist()})}"],
}


@pytest.mark.parametrize("notation", NOTATIONS)
def test_a_file_and_a_port_give_the_frames(tmp_path: Path, notation: str) -> None:
    frames = codes(np.random.default_rng(4))
    lines = [line for frame in frames for line in NOTATIONS[notation](frame)]
    scene = Scene(Panel(*frames.shape[1:]), LoadedColumnsReadout())
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    recording, _ = import_file(tmp_path / "log.txt", scene=scene, unit="code", period=0.1)
    np.testing.assert_allclose(scene.circuit.code_from_volt(recording.recorded), frames, rtol=1e-9)
    reader = LineReader(frames.shape[1:])
    live = [frame.values for line in lines for frame in reader.feed(line)]
    live += [frame.values for frame in reader.close()]
    np.testing.assert_array_equal(live, frames)


def test_a_greeting_with_separators_is_no_frame() -> None:
    frames = codes(np.random.default_rng(5))
    reader = LineReader(frames.shape[1:])
    lines = ["CFG,10,10,5000", *(f"F,{40 * at},{joined(frame)}" for at, frame in enumerate(frames))]
    live = [frame for line in lines for frame in reader.feed(line)]
    np.testing.assert_array_equal([frame.values for frame in live], frames[: len(live)])
    assert [frame.seconds for frame in live[:2]] == [0.0, pytest.approx(0.04)]


def test_messages_of_two_topics_are_two_panels(tmp_path: Path) -> None:
    frames = codes(np.random.default_rng(6))
    lines = [
        f"mat/{'left' if at % 2 else 'right'} {json.dumps({'v': frame.ravel().tolist()})}"
        for at, frame in enumerate(frames)
    ]
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="topic"):
        import_file(tmp_path / "log.txt", *frames.shape[1:], unit="ohm", period=0.1)
    reader = LineReader(frames.shape[1:])
    assert not any(reader.feed(line) for line in lines)
    assert "several boards" in reader.refusal


def test_readings_that_are_words_are_refused_by_a_port_as_in_a_file() -> None:
    frames = codes(np.random.default_rng(7))
    reader = LineReader(frames.shape[1:])
    live = [frame for frame in frames for frame in reader.feed(f"{joined(frame)}!")]
    assert not live
    assert "is no number" in reader.refusal


@pytest.mark.parametrize("shape", [(8, 6), (5, 3), (5, 4), (4, 8)])
def test_numbers_of_frame_and_row_are_none_of_the_readings(
    tmp_path: Path, shape: tuple[int, int]
) -> None:
    """Also where a line then has as many fields as the panel has rows."""
    frames = np.random.default_rng(9).integers(300, 800, (20, *shape))
    lines = [
        f"{(250 + at) % 256}\t{number}\t{joined(row, chr(9))}"
        for at, frame in enumerate(frames)
        for number, row in enumerate(frame)
    ]
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    recording, _ = import_file(tmp_path / "log.txt", *shape, unit="ohm", period=0.1)
    np.testing.assert_array_equal(recording.recorded, frames)


def test_a_line_lost_before_the_layout_is_known_shifts_no_frame() -> None:
    """Rows without names that follow each other fast, with a pause between frames."""
    frames = codes(np.random.default_rng(8))
    lines = [
        f"{100 * at + number},{joined(row)}"
        for at, frame in enumerate(frames)
        for number, row in enumerate(frame)
    ]
    del lines[3 * len(frames[0]) + 1]
    reader = LineReader(frames.shape[1:])
    live = [frame for line in lines for frame in reader.feed(line)] + [*reader.close()]
    whole = [frame.values for frame in live if not np.isnan(frame.values).any()]
    np.testing.assert_array_equal(whole, np.delete(frames, 3, axis=0))


def test_a_number_that_a_port_broke_is_missing() -> None:
    frames = codes(np.random.default_rng(10))
    lines = [joined(frame) for frame in frames]
    lines[-3:-2] = [lines[-3][:-1], lines[-3][-1]]
    reader = LineReader(frames.shape[1:])
    live = np.array([frame.values for line in lines for frame in reader.feed(line)])
    assert np.isnan(live[-3, -1, -1])
    np.testing.assert_array_equal(np.where(np.isnan(live), frames, live), frames)
