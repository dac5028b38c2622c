"""Tables drawn from a grammar of layouts and damages: each import is right, missing or refused.

`TABLES_SEED=7 python -m pytest tests/fuzz/test_tables.py` draws others.
"""

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from lampest import import_file
from lampest.apps.foreign.line_reader import LineReader, TextFrame
from tests.fuzz import tables

SEED = int(os.environ.get("TABLES_SEED", "1"))
FEW = 25  # in `make test`
MANY = 200
MIN_TAKEN = 0.8  # of the tables are imported, whole or in parts
EXACT = 1e-6  # of codes


EACH_COUNT = pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.slow)])


@EACH_COUNT
def test_no_table_of_the_grammar_is_imported_wrong(tmp_path: Path, count: int) -> None:
    outcomes: Counter[str] = Counter()
    wrong = []
    for number in range(count):
        drawn = tables.table(np.random.default_rng([SEED, number]))
        outcome = tables.outcome(drawn, tmp_path)
        outcomes[outcome.partition(":")[0]] += 1
        if outcome.startswith("wrong"):
            wrong.append(f"{number}: {drawn.name}: {outcome}")
    assert not wrong, f"TABLES_SEED={SEED}: {wrong}"
    assert outcomes["right"] + outcomes["missing"] >= MIN_TAKEN * count, outcomes


@EACH_COUNT
def test_lines_that_come_one_by_one_give_the_same_frames(count: int) -> None:
    """A live reader returns frames of the truth alone, before the last line has come."""
    for number in range(count // 5):
        drawn = tables.table(np.random.default_rng([SEED, 1000 + number]))
        reader = LineReader(drawn.codes.shape[1:])
        early: list[TextFrame] = []
        for line in drawn.text.split("\n")[:-1]:
            early += reader.feed(line)
        frames = [*early, *reader.close()]
        assert len(frames) - 2 <= len(early), drawn.name
        assert 2 * len(frames) > len(drawn.codes) and reader.sentences, drawn.name
        for frame in frames:
            distance = np.abs(frame.values - drawn.codes)
            nearest = np.nanmax(distance, axis=(1, 2), initial=0.0).min()
            assert nearest < EXACT, f"TABLES_SEED={SEED}, {number}: {drawn.name}"


@pytest.mark.parametrize("layout", tables.LAYOUTS)
def test_a_file_and_a_port_give_the_same_frames(tmp_path: Path, layout: str) -> None:
    """A board that printed cells by their numbers from 0 was shown with all of them shifted."""
    for number in range(3):
        drawn = tables.whole_table(np.random.default_rng([SEED, 3000 + number]), layout)
        (tmp_path / "m.log").write_text(drawn.text)
        shape = drawn.codes.shape[1:]
        recording, _ = import_file(tmp_path / "m.log", *shape, unit="ohm", period=0.04)
        reader = LineReader(shape)
        frames = [frame for line in drawn.text.splitlines() for frame in reader.feed(line)]
        live = [frame.values for frame in (*frames, *reader.close())]
        np.testing.assert_array_equal(recording.recorded, drawn.codes)
        np.testing.assert_array_equal(live, drawn.codes)


@pytest.mark.parametrize("form", ["{c},{v}", "{r},{q},{v}"])
@pytest.mark.parametrize("first", [0, 1])
def test_a_number_that_is_cut_to_0_does_not_shift_the_cells(
    tmp_path: Path, form: str, first: int
) -> None:
    """A port is opened within a line, such as within 10 of `10,523`."""
    codes = tables.codes(np.random.default_rng(11), 6, 6)
    lines = [
        form.format(c=6 * row + column + first, r=row + first, q=column + first, v=code)
        for (_, row, column), code in np.ndenumerate(codes)
    ]
    lines = [form.format(c=0, r=0, q=first, v=599), *lines[-8:], *lines]
    drawn = tables.Table(form, "\n".join([*lines, ""]), codes)
    assert tables.outcome(drawn, tmp_path) == "right"
    reader = LineReader(codes.shape[1:])
    live = [frame.values for line in lines for frame in reader.feed(line)]
    np.testing.assert_array_equal(live[-len(codes) + 1 :], codes[1:])


def test_a_damaged_name_of_a_cell_ends_no_reader() -> None:
    """A single line without a number ended a recording once its cells were known."""
    codes = tables.codes(np.random.default_rng(12), 4, 4)
    lines = [f"{row},{column},{code}" for (_, row, column), code in np.ndenumerate(codes)]
    lines[100] = "\a" + lines[100][1:]
    reader = LineReader(codes.shape[1:])
    live = np.array([frame.values for line in lines for frame in reader.feed(line)])
    assert 1 <= np.isnan(live).sum() < codes[0].size
    np.testing.assert_array_equal(np.where(np.isnan(live), codes, live), codes)


def test_a_reader_says_why_lines_are_not_understood() -> None:
    reader = LineReader((3, 4), source="/dev/ttyUSB0")
    for number in range(40):
        assert reader.feed(f"voltage {number}: 3.3") == ()
    assert not reader.sentences
    assert reader.refusal.startswith("/dev/ttyUSB0")


@pytest.mark.parametrize("first", [1, 4])
def test_numbered_rows_say_where_a_frame_begins(tmp_path: Path, first: int) -> None:
    """Frames were rows 3 to 5 of one scan and 0 to 2 of the next."""
    codes = tables.codes(np.random.default_rng(3))
    lines = [
        f"R{row}: {' '.join(map(str, line))}" for frame in codes for row, line in enumerate(frame)
    ]
    path = tmp_path / "m.log"
    path.write_text("\n".join([*lines[first:], ""]))
    rows, columns = codes.shape[1:]
    recording, notes = import_file(path, rows=rows, columns=columns, unit="ohm")
    np.testing.assert_array_equal(recording.recorded, codes[1 + first // rows :])
    assert any("the first frame (line 1) is cut and left out" in note for note in notes)


@pytest.mark.parametrize("form", ["{t};{r};{c};{v}", "{n},{c},{r},{v}", "{c},{r},{v},{n}"])
@pytest.mark.parametrize("columns", [3, 4])
def test_values_without_a_header_have_their_places_by_the_numbers_of_rows_and_columns(
    tmp_path: Path, form: str, columns: int
) -> None:
    """Lines of four fields of a panel with four columns were taken as its rows."""
    codes = tables.codes(np.random.default_rng(4), 5, 6)[:, :, :columns]
    lines = [
        form.format(t=1000 + 37 * frame, n=(frame + 250) % 256, r=row, c=column, v=code)
        for (frame, row, column), code in np.ndenumerate(codes)
    ]
    lines[40] = "?" + lines[40][1:]
    drawn = tables.Table(form, "\n".join([*lines[7:], ""]), codes)
    assert tables.outcome(drawn, tmp_path) == "missing"


@pytest.mark.parametrize("end", ["", "\n"])
def test_a_number_that_is_cut_at_the_end_of_a_file_is_left_out(tmp_path: Path, end: str) -> None:
    """Without the end of its line, and with one that the terminal wrote."""
    codes = 400 + np.arange(30 * 12).reshape(30, 3, 4)
    text = "\n".join(
        f"{number},{','.join(map(str, codes[number].ravel()))}" for number in range(30)
    )
    path = tmp_path / "m.csv"
    path.write_text(text[:-1] + end)
    recording, notes = import_file(path, rows=3, columns=4, unit="ohm")
    np.testing.assert_array_equal(recording.recorded, codes[:-1])
    assert any("line 30, the last one, which is cut off" in note for note in notes)


def test_a_number_at_which_a_row_in_brackets_was_broken_is_missing(tmp_path: Path) -> None:
    """The part `1],` behind the break was no number, and 41 for 411 was a reading."""
    codes = 400 + np.arange(12 * 12).reshape(12, 3, 4)
    lines = [
        f"{' [' if row else '[['}{', '.join(map(str, values))}{']]' if row == 2 else '],'}"
        for frame in codes
        for row, values in enumerate(frame)
    ]
    path = tmp_path / "m.log"
    path.write_text("\n".join([*lines[:9], lines[9][:-3], lines[9][-3:], *lines[10:], ""]))
    recording, _ = import_file(path, rows=3, columns=4, unit="ohm")
    expected = codes.astype(float)
    expected[3, 0, 3] = np.nan
    np.testing.assert_array_equal(recording.recorded, expected)


def test_a_row_with_a_damaged_name_has_a_place_of_its_own(tmp_path: Path) -> None:
    """R0 of one frame, R1 whose name is damaged, and R1 and R2 of the next one were a frame."""
    codes = tables.codes(np.random.default_rng(5), 3, 3)
    lines = [f"R{row}: {' '.join(map(str, frame[row]))}" for frame in codes for row in range(3)]
    lines = [*lines[:13], "RZ" + lines[13][2:], *lines[16:], ""]
    drawn = tables.Table("damaged name", "\n".join(lines), codes)
    assert tables.outcome(drawn, tmp_path) == "missing"


def test_a_time_at_which_a_line_was_broken_is_no_reading(tmp_path: Path) -> None:
    """Of `>r1c2:1735725600040:511`, broken within its time, 173 was a reading."""
    codes = tables.codes(np.random.default_rng(6))
    lines = [
        f">r{row}c{column}:{1735725600000 + 40 * frame}:{code}"
        for (frame, row, column), code in np.ndenumerate(codes)
    ]
    lines[40:41] = [lines[40][:9], lines[40][9:]]
    drawn = tables.Table("Teleplot", "\n".join([*lines, ""]), codes)
    assert tables.outcome(drawn, tmp_path) == "missing"


def test_lines_that_come_later_may_be_narrower_than_the_header() -> None:
    """Two joined lines widened the header, and the reader of a port ended with a traceback."""
    codes = tables.codes(np.random.default_rng(7), 3, 4)
    names = ",".join(f"r{row}c{column}" for row, column in np.ndindex(codes.shape[1:]))
    lines = [
        f"frame,{names}",
        *(f"{n},{','.join(map(str, f.ravel()))}" for n, f in enumerate(codes)),
    ]
    lines[3:5] = [lines[3] + lines[4]]
    reader = LineReader(codes.shape[1:])
    frames = [frame for line in lines for frame in reader.feed(line)]
    assert len([*frames, *reader.close()]) >= len(codes) - 2


def test_a_damaged_name_of_an_object_is_no_column(tmp_path: Path) -> None:
    """The key `fraxe` of one line made a column, and took the place of another one."""
    codes = tables.codes(np.random.default_rng(8), 5, 5)
    lines = [
        f'{{"frame": {number}, "row": {row}, "data": {values.tolist()}}}'
        for number, frame in enumerate(codes)
        for row, values in enumerate(frame)
    ]
    lines[40] = lines[40].replace("frame", "fraxe")
    drawn = tables.Table("damaged key", "\n".join([*lines, ""]), codes)
    assert tables.outcome(drawn, tmp_path) == "missing"
