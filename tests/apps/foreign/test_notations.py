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
    "rows and columns as words": lambda frame: [
        f"Row {row}, Col {column}: {code}" for (row, column), code in np.ndenumerate(frame)
    ],
    "a cell in a sentence": lambda frame: [
        f"Value at ({row}, {column}) = {code}" for (row, column), code in np.ndenumerate(frame)
    ],
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


@pytest.mark.parametrize("word", ["open", "OVL", "n.a.", "sat", "<10", "0x1F"])
def test_a_word_in_place_of_readings_is_missing_or_refused(tmp_path: Path, word: str) -> None:
    """Rows with several unknown words were taken as titles, and a port marked others missing."""
    frames = codes(np.random.default_rng(11), 5, 6)
    without = np.random.default_rng(12).random(frames.shape) < 0.2
    texts = np.where(without, word, frames.astype(str))
    lines = [line for frame in texts for line in (*(",".join(row) for row in frame), "")]
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    reader = LineReader(frames.shape[1:])
    live = [frame.values for line in lines for frame in reader.feed(line)] + [
        frame.values for frame in reader.close()
    ]
    if word in ("open", "OVL", "n.a."):
        recording, _ = import_file(tmp_path / "log.txt", *frames.shape[1:], unit="ohm", period=1.0)
        expected = np.where(without, np.nan, frames)
        np.testing.assert_array_equal(recording.recorded, expected)
        np.testing.assert_array_equal(live, expected)
        return
    with pytest.raises(InputError, match=f"'{word}' is no number"):
        import_file(tmp_path / "log.txt", *frames.shape[1:], unit="ohm", period=1.0)
    assert not live
    assert f"'{word}' is no number" in reader.refusal


def test_lines_without_a_number_are_refused_with_the_first(tmp_path: Path) -> None:
    """Hexadecimal numbers, and numbers with units: `holds a header but no values` is untrue."""
    for line in ("0x1F,0x20", "12k 13k"):
        (tmp_path / "log.txt").write_text(f"{line}\n" * 8)
        with pytest.raises(InputError, match=r"txt:1: '.*', as all lines, is no readings"):
            import_file(tmp_path / "log.txt", 2, 2, unit="ohm")


def test_what_a_board_sends_at_another_rate_first_is_left_out(tmp_path: Path) -> None:
    """An ESP8266 starts at 74,880 baud; a short log then had too many bytes that are no text."""
    frames = codes(np.random.default_rng(13))
    start = np.random.default_rng(14).integers(128, 255, 60, np.uint8).tobytes()
    text = "".join(f"{joined(frame)}\n" for frame in frames)
    (tmp_path / "log.txt").write_bytes(start + b"\r\n" + text.encode())
    recording, _ = import_file(tmp_path / "log.txt", *frames.shape[1:], unit="ohm", period=0.1)
    np.testing.assert_array_equal(recording.recorded, frames)


def test_cells_that_may_count_from_0_or_from_1_are_refused(tmp_path: Path) -> None:
    """A masked panel, of which the corners have no cells."""
    frames = codes(np.random.default_rng(15), 4, 4).reshape(-1, 16)[:, 1:-1]
    lines = [f"{cell},{code}" for frame in frames for cell, code in enumerate(frame, 1)]
    (tmp_path / "log.csv").write_text("\n".join(["sensor,value", *lines, ""]))
    with pytest.raises(InputError, match=r"csv:2: cells may count from 0 or from 1: no line"):
        import_file(tmp_path / "log.csv", 4, 4, unit="ohm")


def test_fields_are_understood_on_lines_that_name_all_rows() -> None:
    """Of `0;1;2;512` the first lines alone had the time as row, and the reading as frame."""
    frames = codes(np.random.default_rng(16), 12, 12)
    lines = [
        f"{40 * frame};{row + 1};{column + 1};{code}"
        for (frame, row, column), code in np.ndenumerate(frames)
    ]
    reader = LineReader(frames.shape[1:])
    live = [frame.values for line in lines for frame in reader.feed(line)]
    np.testing.assert_array_equal(live, frames[: len(live)])
    assert len(live) >= len(frames) - 1
