"""Files as people have them: each gives the frames that are in it, and the sentences say how it was understood."""

import datetime
import io
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import openpyxl
import pytest

from lampest import InputError, LoadedColumnsReadout, Panel, Recording, Scene, TwoPointReadout, import_file

ROWS, COLUMNS = 3, 5
FRAMES = np.random.default_rng(7).uniform(250, 600, (4, ROWS, COLUMNS)).round(3)
CODES = np.random.default_rng(7).integers(200, 900, (4, ROWS, COLUMNS))
DIVIDER = Scene(Panel(ROWS, COLUMNS), TwoPointReadout(), 140.0)
LOADED = Scene(Panel(ROWS, COLUMNS), LoadedColumnsReadout(load_ohm=10_000.0, supply_volt=3.3, adc_bits=12, readings=1))
VOLT_OF_CODES = (CODES + 0.5) * 3.3 / 4096  # the middle of what a converter calls by each code


def lines(values: np.ndarray, sign: str = ",", decimal: str = ".") -> list[str]:
    return [sign.join(str(value).replace(".", decimal) for value in line) for line in values]


def wide(values: np.ndarray, sign: str = ",", decimal: str = ".") -> list[str]:
    return lines(values.reshape(len(values), -1), sign, decimal)


def names(pattern: str, first: int = 0, sign: str = ",") -> str:
    return sign.join(
        pattern.format(r=row + first, c=column + first) for row in range(ROWS) for column in range(COLUMNS)
    )


def imported(path: Path, content: str | bytes, **how: Any) -> tuple[Recording, tuple[str, ...]]:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return import_file(path, **({"rows": ROWS, "columns": COLUMNS} | how))


def said(notes: Sequence[str], words: str) -> bool:
    return any(words in note for note in notes)


# What a terminal shows of a board.


def test_the_arduino_monitor_one_frame_a_line(tmp_path: Path) -> None:
    log = "12:34:55.100 -> ,511,600\r\n12:34:55.200 -> Panel 3x5 v1.2 ready\r\n"
    log += "".join(f"12:34:5{6 + number}.789 -> {line},\r\n" for number, line in enumerate(wide(CODES)))
    recording, notes = imported(tmp_path / "monitor.log", log, rows=None, columns=None, scene=LOADED)
    np.testing.assert_allclose(recording.recorded, VOLT_OF_CODES)
    np.testing.assert_allclose(recording.time, [0, 1, 2, 3])
    assert recording.start_time is None and said(notes, "it began at 12:34:56.789, the date is not in the file")
    assert said(notes, "left out: lines 1, 2 (the first: '511 600')") and said(notes, "unit code, guessed")


def test_a_monitor_cut_at_its_end(tmp_path: Path) -> None:
    log = "\n".join([*wide(CODES[:3]), ",".join(map(str, CODES[3].ravel()[:6]))])
    recording, notes = imported(tmp_path / "m.txt", log, scene=LOADED)
    np.testing.assert_allclose(recording.recorded[:3], VOLT_OF_CODES[:3])
    np.testing.assert_array_equal(np.isnan(recording.recorded[3].ravel()), np.arange(15) >= 5)  # the sixth may be cut
    assert said(notes, "10 readings missing, in 1 of 4 frames: NaN") and said(notes, "the last number of line 4 is cut")
    recording, notes = imported(tmp_path / "m.txt", log + "\n", scene=LOADED)
    np.testing.assert_array_equal(np.isnan(recording.recorded[3].ravel()), np.arange(15) >= 6)
    assert not said(notes, "is cut off")


@pytest.mark.parametrize(("step", "unit", "seconds"), [(500, "ms", 0.5), (40_000, "us", 0.04)])
def test_a_counter_without_a_name_that_begins_again(tmp_path: Path, step: int, unit: str, seconds: float) -> None:
    begin = 2**32 - 2 * step
    log = "\n".join(f"{(begin + step * number) % 2**32},{line}" for number, line in enumerate(wide(CODES)))
    recording, notes = imported(tmp_path / "millis.log", log + "\n", scene=LOADED)
    np.testing.assert_allclose(recording.recorded, VOLT_OF_CODES)
    np.testing.assert_allclose(np.diff(recording.time), seconds, rtol=1e-6)
    assert said(notes, f"first field in {unit}; the counter began again once")


def test_empty_columns_beside_the_cells(tmp_path: Path) -> None:
    names = "X_Value\t" + "\t".join(["Channel", *(f"Channel_{n}" for n in range(1, 15))]) + "\tComment"
    body = [f"{number * 0.5:.6f}\t{line}\t" for number, line in enumerate(wide(CODES, "\t"))]
    text = "\r\n".join(["LabVIEW Measurement\t", "Channels\t15", "***End_of_Header***\t", names, *body])
    recording, notes = imported(tmp_path / "m.lvm", text + "\r\n", scene=LOADED)
    np.testing.assert_allclose(recording.recorded, VOLT_OF_CODES)
    np.testing.assert_allclose(recording.time, [0, 0.5, 1, 1.5])
    assert said(notes, "empty columns left out: Comment")


BLOCKS = {
    "blank lines": "boot...\n" + "\n\n".join("\n".join(lines(frame, "\t")) for frame in CODES),
    "windows lines": "\r\n\r\n".join("\r\n".join(lines(frame, ", ")) + ",\r\n" for frame in CODES),
    "marks": "\n---\n".join("\n".join(lines(frame, " ")) for frame in CODES) + "\n---\n",
    "titles": "\n".join(f"Frame {number}:\n" + "\n".join(lines(frame, ";")) for number, frame in enumerate(CODES)),
    "numbers": "\n".join(f"{number}\n" + "\n".join(lines(frame, " ")) for number, frame in enumerate(CODES)),
    "nothing": "\n".join("\n".join(lines(frame)) for frame in CODES),
    "every line alone": "\n\n".join("\n\n".join(lines(frame)) for frame in CODES),
    "python lists": "\n".join(f"[{line}]" for frame in CODES for line in lines(frame, ", ")),
    "titles of a chip": "ets Jun  8 2016 00:22:57\n\nentry 0x400805f0\n"
    + "\n\n".join("\n".join(lines(frame, " ")) for frame in CODES),
    "frame and row": "frame,row,c0,c1,c2,c3,c4\n"
    + "\n".join(f"{n},{row},{line}" for n, frame in enumerate(CODES) for row, line in enumerate(lines(frame))),
    "row names": "\n".join(
        "\n".join(f"R{number}: {line}" for number, line in enumerate(lines(frame, " "))) for frame in CODES
    ),
}


@pytest.mark.parametrize("text", BLOCKS.values(), ids=BLOCKS)
def test_a_line_for_every_row(tmp_path: Path, text: str) -> None:
    recording, notes = imported(tmp_path / "m.log", text, scene=LOADED)
    np.testing.assert_allclose(recording.recorded, VOLT_OF_CODES)
    assert said(notes, "one row a line, 3 lines a frame")


@pytest.mark.parametrize(
    ("title", "times"),
    [
        ("Frame {n}, t = {ms} ms", [0, 0.25, 0.5, 0.75]),
        ("time: 2025-01-31 12:00:0{n}Z", [0, 1, 2, 3]),
        ("millis={ms}", [0, 0.25, 0.5, 0.75]),
    ],
)
def test_titles_of_blocks_give_the_times(tmp_path: Path, title: str, times: list[float]) -> None:
    blocks = [title.format(n=n, ms=250 * n) + "\n" + "\n".join(lines(frame)) for n, frame in enumerate(CODES)]
    recording, _ = imported(tmp_path / "m.log", "\n".join(blocks), scene=LOADED)
    np.testing.assert_allclose(recording.time, times)
    assert recording.start_time == ("2025-01-31T12:00:00Z" if "2025" in title else None)


def test_blocks_that_are_cut_leave_missing_readings(tmp_path: Path) -> None:
    blocks = ["\n".join(lines(frame)) for frame in CODES]
    blocks[0] = "\n".join(lines(CODES[0])[1:])  # the terminal was opened between two rows
    blocks[2] = "\n".join(lines(CODES[2])[:2])  # a row was lost: nobody knows which
    blocks[3] = "\n".join(lines(CODES[3])[:2])  # the terminal was closed
    recording, notes = imported(tmp_path / "m.log", "\n\n".join(blocks), scene=LOADED)
    np.testing.assert_allclose(recording.recorded[0], VOLT_OF_CODES[1])
    assert np.all(np.isnan(recording.recorded[1]))
    np.testing.assert_allclose(recording.recorded[2, :2], VOLT_OF_CODES[3, :2])
    assert np.all(np.isnan(recording.recorded[2, 2]))
    assert said(notes, "the first block (line 1) is cut and left out") and said(notes, "has 2 of 3 lines")
    longer = "\n\n".join("\n".join(lines(frame) + lines(frame)[:1]) for frame in CODES)
    with pytest.raises(InputError, match=r"m\.log:1: a block of 4 lines, where the panel has 3 rows"):
        imported(tmp_path / "m.log", longer, scene=LOADED)


def debugged(separator: str, debug: str) -> str:
    """Ten frames with a line of a sketch's own within the third and the seventh."""
    frames = [lines(CODES[number % len(CODES)]) for number in range(10)]
    for number in (2, 6):
        frames[number].insert(1, debug)
    return "\n".join(
        separator.format(n=number, ms=100 * number) + "\n".join(frame) for number, frame in enumerate(frames)
    )


@pytest.mark.parametrize(
    "debug", ["DEBUG: free heap 23456 bytes", "wifi: rssi -61", "# note", "42 overruns 7 8 9 1 2 3"]
)
@pytest.mark.parametrize("separator", ["Frame {n} t={ms} ms\n", "t = {ms} ms\n", "\n", ""])
def test_a_line_of_the_sketch_shifts_no_frame(tmp_path: Path, separator: str, debug: str) -> None:
    recording, notes = imported(tmp_path / "m.log", debugged(separator, debug), scene=LOADED)
    np.testing.assert_allclose(recording.recorded, VOLT_OF_CODES[np.arange(10) % len(CODES)])
    if "ms" in separator:
        np.testing.assert_allclose(recording.time, 0.1 * np.arange(10))
    if "DEBUG" in debug and "Frame" in separator:
        assert said(notes, "skipped between rows: line 11, line 28"), notes


def test_a_lost_row_leaves_one_frame_missing_and_the_others_in_place(tmp_path: Path) -> None:
    text = debugged("Frame {n} t={ms} ms\n", "DEBUG: 1").splitlines()
    del text[text.index("Frame 4 t=400 ms") + 2]
    recording, notes = imported(tmp_path / "m.log", "\n".join(text), scene=LOADED)
    np.testing.assert_allclose(
        np.delete(recording.recorded, 4, 0), VOLT_OF_CODES[np.delete(np.arange(10), 4) % len(CODES)]
    )
    assert np.isnan(recording.recorded[4]).all() and recording.time == pytest.approx(0.1 * np.arange(10))
    assert said(notes, "has 2 of 3 lines and is missing")


# Headers.


@pytest.mark.parametrize(
    ("pattern", "first"),
    [
        ("r{r}c{c}", 0), ("R{r}C{c}", 1), ("row {r} col {c}", 0), ("c{c}_r{r}", 0), ("Z{r}S{c}", 1),
        ("cell_{r}_{c}", 1), ("[{r}][{c}]", 0), ("x{c}y{r}", 0), ("Row{r} / Column{c}", 1),
        ("adc r{r} c{c}", 0), ("R{r}C{c} [ohm]", 1),
    ],
)  # fmt: skip
def test_cells_by_their_names_in_any_order(tmp_path: Path, pattern: str, first: int) -> None:
    order = np.random.default_rng(3).permutation(ROWS * COLUMNS)
    header = np.array(names(pattern, first).split(","))[order]
    table = "\n".join([",".join(header), *lines(FRAMES.reshape(4, -1)[:, order])])
    recording, notes = imported(tmp_path / "m.csv", table, unit="ohm")
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    assert said(notes, f"cells by their names, which count from {first}")


def test_names_beyond_the_panel_or_twice(tmp_path: Path) -> None:
    table = "\n".join([names("r{c}c{r}"), *wide(FRAMES)])
    with pytest.raises(InputError, match=r"'r3c0' is beyond the panel of 3 × 5 cells, .*; with `transpose` it would"):
        imported(tmp_path / "m.csv", table)
    recording, _ = imported(tmp_path / "m.csv", table, transpose=True)
    assert recording.resistance.shape == FRAMES.shape
    with pytest.raises(InputError, match=r"'r0c1' and 'r0c1' are the same cell"):
        imported(tmp_path / "m.csv", table.replace("r0c0", "r0c1"), transpose=True)


def test_a_cell_without_a_column_is_missing(tmp_path: Path) -> None:
    table = "\n".join([names("r{r}c{c}").removesuffix(",r2c4"), *lines(FRAMES.reshape(4, -1)[:, :14])])
    recording, notes = imported(tmp_path / "m.csv", table)
    assert np.all(np.isnan(recording.resistance[:, 2, 4])) and not np.any(np.isnan(recording.resistance[:, :2]))
    assert said(notes, "1 cells have no column")


def test_a_table_of_a_data_frame(tmp_path: Path) -> None:
    table = "\n".join([",".join(["frame", *map(str, range(15))]), *(f"{n},{x}" for n, x in enumerate(wide(FRAMES)))])
    recording, notes = imported(tmp_path / "m.csv", table)
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    np.testing.assert_array_equal(recording.time, np.arange(4))
    assert said(notes, "left out: frame")


@pytest.mark.parametrize("first", [0, 1])
def test_rows_and_columns_by_their_names(tmp_path: Path, first: int) -> None:
    header = "," + ",".join(f"c{column + first}" for column in range(COLUMNS)[::-1])
    blocks = [
        "\n".join([header, *(f"r{row + first},{lines(frame[:, ::-1])[row]}" for row in (1, 2, 0))]) for frame in FRAMES
    ]
    recording, notes = imported(tmp_path / "m.csv", "\n\n".join(blocks))
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    assert said(notes, f"rows by their names, columns by their names from {first}")
    turned = "\n\n".join(blocks).replace("r", "?").replace("c", "r").replace("?", "c")
    with pytest.raises(InputError, match="`transpose` swaps"):
        imported(tmp_path / "m.csv", turned)


def test_the_encodings_and_commas_of_spreadsheets_are_read(tmp_path: Path) -> None:
    head = "Zeit [ms];" + names("Z{r}S{c} [kΩ]", 1, ";") + ";"
    body = [f"{250 * n};{line};" for n, line in enumerate(wide(FRAMES / 1000, ";", ","))]
    text = "\r\n".join(["% exported on Monday", head, *body, ";" * 17, ""])
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le"):
        recording, notes = imported(tmp_path / "m.csv", text.encode(encoding))
        np.testing.assert_allclose(recording.resistance, FRAMES, rtol=1e-12)
        np.testing.assert_allclose(recording.time, [0, 0.25, 0.5, 0.75])
        assert said(notes, "unit kohm, as the header says") and said(notes, "decimal commas")


@pytest.mark.parametrize(
    ("written", "number"),
    [
        ("1.234,5", 1234.5),
        ('"1,234.5"', 1234.5),
        ("1234,5", 1234.5),
        ("1.2345e3", 1234.5),
        ("12.345.678,5", 12345678.5),
    ],
)
def test_signs_between_thousands_are_read(tmp_path: Path, written: str, number: float) -> None:
    comma = written.endswith(",5")
    others = wide(FRAMES, ";", "," if comma else ".")
    recording, _ = imported(
        tmp_path / "m.csv", "\n".join([*others, others[0].replace(others[0].split(";")[0], written, 1)])
    )
    assert recording.resistance[4, 0, 0] == number
    np.testing.assert_array_equal(recording.resistance[:4], FRAMES)


# Single values.

LONG = [(frame, row, column, FRAMES[frame, row, column]) for frame, row, column in np.ndindex(FRAMES.shape)]


@pytest.mark.parametrize(
    ("header", "line", "times"),
    [
        ("millis,row,col,R [ohm]", "{ms},{r},{c},{v}", [0, 0.1, 0.2, 0.3]),
        ("value,column,row,time", "{v},{c1},{r1},{s}", [0, 0.1, 0.2, 0.3]),
        ("timestamp;Zeile;Spalte;Widerstand", "2025-01-31 12:00:00,{f};R{r};C{c};{v}", [0, 0.1, 0.2, 0.3]),
        ("scan\trow\tcolumn\tresistance_ohm", "{f}\t{r1}\t{c1}\t{v}", [0, 1, 2, 3]),
        ("time,row,column,value", "{each},{r},{c},{v}", [0, 1.5, 3.0, 4.5]),
        ("time,r,c,v", "{s},{r},{c},{v}", [0, 0.1, 0.2, 0.3]),
        ("time,cell,value", "{s},r{r}c{c},{v}", [0, 0.1, 0.2, 0.3]),
        ("time,index,value", "{s},{index},{v}", [0, 0.1, 0.2, 0.3]),
    ],
)
def test_single_values_are_read_by_their_header(tmp_path: Path, header: str, line: str, times: list[float]) -> None:
    text = [header]
    for number, (f, r, c, v) in enumerate(LONG):
        fields = {"f": f, "ms": 100 * f, "s": f / 10, "each": number / 10, "r": r, "c": c, "r1": r + 1, "c1": c + 1}
        fields["index"] = 5 * r + c + 1
        text.append(line.format(v=v, **fields))
    recording, _ = imported(tmp_path / "m.csv", "\n".join(text))
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    np.testing.assert_allclose(recording.time, times)
    del text[1 + 2 * 15 + 7]
    recording, _ = imported(tmp_path / "m.csv", "\n".join(text))
    expected = FRAMES.copy()
    expected[2, 1, 2] = np.nan
    np.testing.assert_array_equal(recording.resistance, expected)
    with pytest.raises(InputError, match="the reading of row 1, column 2 is missing"):
        imported(tmp_path / "m.csv", "\n".join(text), missing="refuse")


# Times.


def timed(tmp_path: Path, name: str, stamps: Sequence[object], **how: Any) -> tuple[Recording, tuple[str, ...]]:
    table = "\n".join(f'"{stamp}";{line}' for stamp, line in zip(stamps, wide(FRAMES, ";"), strict=True))
    return imported(tmp_path / "m.csv", f"{name};{names('r{r}c{c}', 0, ';')}\n{table}", **how)


@pytest.mark.parametrize(
    ("name", "stamps", "times", "start"),
    [
        ("t", (0, 0.5, 1.25, 2), (0, 0.5, 1.25, 2), None),
        ("time [ms]", (500, 750, 1000, 1500), (0.5, 0.75, 1, 1.5), None),
        ("micros", (0, 10, 20, 40), (0, 1e-5, 2e-5, 4e-5), None),
        ("millis", (4294967000, 4294967250, 204, 454), (4294967, 4294967.25, 4294967.5, 4294967.75), None),
        ("t_min", (0, 1, 2, 3), (0, 60, 120, 180), None),
        ("timestamp", [1738324800 + n / 2 for n in range(4)], (0, 0.5, 1, 1.5), "2025-01-31T12:00:00Z"),
        ("time", [1738324800250 + 500 * n for n in range(4)], (0, 0.5, 1, 1.5), "2025-01-31T12:00:00.250000Z"),
        ("date", [f"2025-01-31T12:00:0{n}.5" for n in range(4)], (0, 1, 2, 3), "2025-01-31T12:00:00.5"),
        ("time", [f"2025-01-31 12:00:0{n}+01:00" for n in range(4)], (0, 1, 2, 3), "2025-01-31T12:00:00+01:00"),
        ("time", ["2025-01-31T23:59:59Z", *(f"2025-02-01T00:00:0{n}Z" for n in range(3))], (0, 1, 2, 3),
         "2025-01-31T23:59:59Z"),
        ("Zeit", [f"31.01.2025 9:00:0{n},250" for n in range(4)], (0, 1, 2, 3), "2025-01-31T09:00:00.250"),
        ("time", [f"1/31/2025 12:00:0{n}" for n in range(4)], (0, 1, 2, 3), "2025-01-31T12:00:00"),
        ("time", [f"1/31/2025 {n}:00:00 PM" for n in (12, 1, 2, 3)], (0, 3600, 7200, 10800), "2025-01-31T12:00:00"),
        ("Uhrzeit", ("23:59:59.5", "0:00:00.5", "0:00:01.5", "0:00:02.5"), (0, 1, 2, 3), None),
    ],
)  # fmt: skip
def test_times_are_read_in_the_units_of_their_column(
    tmp_path: Path, name: str, stamps: Sequence[object], times: Sequence[float], start: str | None
) -> None:
    recording, notes = timed(tmp_path, name, stamps)
    np.testing.assert_allclose(recording.time, times, atol=1e-9)
    assert recording.start_time == start and said(notes, f"time: column '{name}' in ")
    recording.save(tmp_path / "m.h5")
    assert Recording.load(tmp_path / "m.h5").start_time == start
    recording, notes = timed(tmp_path, name, stamps, period=0.1)
    np.testing.assert_allclose(recording.time, [0, 0.1, 0.2, 0.3])
    assert recording.start_time is None and said(notes, "those of the file are not used")


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        ((0, 2, 1, 3), r"m\.csv:4:1: times must be finite and grow; `period` sets them"),
        ((0, 1, 1, 3), r"m\.csv:4:1: times must be finite and grow"),
        ((0, "", 1, 3), r"m\.csv:3:1: times must be finite and grow"),
        (("1/2/2025", "2/2/2025", "3/2/2025", "4/2/2025"), "may be day/month/year or month/day/year"),
        (("2025-01-01", "soon", "2025-01-03", "2025-01-04"), r"m\.csv:3:1: 'soon' is no time"),
        (("2025-02-29", "2025-03-01", "2025-03-02", "2025-03-03"), "is no time"),
    ],
)
def test_a_time_that_is_none_is_refused_at_its_place(tmp_path: Path, stamps: Sequence[object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        timed(tmp_path, "time", stamps)
    assert timed(tmp_path, "time", stamps, period=1.0)[0].time[-1] == 3


def test_date_and_time_of_day_in_two_columns(tmp_path: Path) -> None:
    table = [f"31.01.2025;12:00:0{n};{line}" for n, line in enumerate(wide(FRAMES, ";", ","))]
    recording, _ = imported(tmp_path / "m.csv", "\n".join([f"Datum;Uhrzeit;{names('r{r}c{c}', 0, ';')}", *table]))
    np.testing.assert_array_equal(recording.time, [0, 1, 2, 3])
    assert recording.start_time == "2025-01-31T12:00:00"


@pytest.mark.parametrize(
    ("stamps", "asked", "seconds", "words"),
    [
        ((0, 103, 207, 310), None, 0.31, "ms (guessed: whole numbers that grow by 103; --time-unit says otherwise)"),
        ((5, 50_005, 100_006, 150_009), None, 0.150009, "us (guessed: whole numbers that grow by 50001;"),
        ((1.2e9, 1.2e9 + 5e4, 1.2e9 + 1e5, 1.2e9 + 1.5e5), None, 1200.15, "us (guessed"),
        ((0, 1, 2, 3), None, 3, "s (assumed; --time-unit says otherwise)"),
        ((0, 103.5, 207, 310), None, 310, "s (assumed"),
        ((0, 103, 207, 310), "s", 310, "s (as specified)"),
        ((0, 1, 2, 3), "ms", 0.003, "ms (as specified)"),
    ],
)
def test_the_unit_of_times_is_guessed_and_always_said(
    tmp_path: Path, stamps: Sequence[float], asked: str | None, seconds: float, words: str
) -> None:
    recording, notes = timed(tmp_path, "time", stamps, time_unit=asked)
    assert recording.time[-1] == pytest.approx(seconds) and said(notes, f"time: column 'time' in {words}")


def test_a_time_unit_needs_times_that_are_numbers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no times that could be in ms; `period` sets them"):
        imported(tmp_path / "m.csv", "\n".join(wide(FRAMES)), time_unit="ms")
    with pytest.raises(InputError, match="is no number, so that it has no time unit ms"):
        timed(tmp_path, "time", ("2025-01-01", "2025-01-02", "2025-01-03", "2025-01-04"), time_unit="ms")


@pytest.mark.parametrize("stamp", ["1034510448", "3034510448", "7", "", "4x"])
def test_a_line_with_a_cut_stamp_is_named_and_stops_nothing(tmp_path: Path, stamp: str) -> None:
    stamps = [str(10_345 + 103 * number) for number in range(20)]
    lines = [f"{time},{line}" for time, line in zip(stamps, wide(np.tile(FRAMES, (5, 1, 1))), strict=True)]
    lines[7] = stamp + lines[7][5:30]
    recording, notes = imported(tmp_path / "m.csv", "\n".join(lines) + "\n")
    np.testing.assert_allclose(np.diff(recording.time), 0.103)
    assert said(notes, "m.csv:8:1 is missing or does not grow, and is interpolated")
    assert said(notes, "in 1 of 20 frames: NaN in the recording")


def test_left_out_lines_are_numbered(tmp_path: Path) -> None:
    lines = [line for frame in wide(FRAMES) for line in (frame, "DEBUG heap ok")] * 5
    _, notes = imported(tmp_path / "m.csv", "\n".join(lines) + "\n")
    numbers = ", ".join(map(str, range(2, 22, 2)))
    assert said(notes, f"left out: lines {numbers} and 10 more (the first: 'DEBUG heap ok')")


# Units.

MEANS = np.random.default_rng(2).integers(4000, 18000, (4, ROWS, COLUMNS)) / 20  # of 20 codes
VOLTS = (MEANS + 0.5) * 5 / 1024


@pytest.mark.parametrize(
    ("values", "scene", "unit"),
    [
        (FRAMES, None, "ohm"),
        (FRAMES.round(), None, "ohm"),
        (FRAMES / 1000, None, "kohm"),
        (FRAMES, DIVIDER, "ohm"),
        (FRAMES / 1000, DIVIDER, "kohm"),
        (FRAMES * 20, DIVIDER, "ohm"),
        (FRAMES / 100, DIVIDER, "kohm"),
        (FRAMES * 500, DIVIDER, "ohm"),
        (CODES, DIVIDER, ("ohm", "code")),
        (CODES + 1000, DIVIDER, ("ohm", "mV")),
        (MEANS, DIVIDER, "code"),
        (MEANS.round(1), DIVIDER, ("ohm", "code")),
        (VOLTS, DIVIDER, "volt"),
        (1000 * VOLTS, DIVIDER, "mV"),
        ((1000 * VOLTS).round(2), DIVIDER, "mV"),
        (1000 * (5 / VOLTS - 1), DIVIDER, "ohm"),
        ((1000 * (5 / VOLTS - 1)).round(2), DIVIDER, "ohm"),
        (CODES, LOADED, "code"),
        (VOLT_OF_CODES, LOADED, "volt"),
        (1000 * VOLT_OF_CODES, LOADED, "mV"),
        (CODES % 4, LOADED, ("volt", "code")),
        (CODES + 9000, LOADED, ()),
    ],
)
def test_the_unit_is_guessed_from_the_values(
    tmp_path: Path, values: np.ndarray, scene: Scene | None, unit: str | tuple[str, ...]
) -> None:
    np.save(tmp_path / "m.npy", values)
    if isinstance(unit, str):
        guessed, notes = import_file(tmp_path / "m.npy", ROWS, COLUMNS, scene)
        told, _ = import_file(tmp_path / "m.npy", ROWS, COLUMNS, scene, unit)
        np.testing.assert_array_equal(guessed.recorded, told.recorded)
        assert said(notes, f"unit {unit}, guessed: values from ") or said(notes, f"unit {unit}, assumed: values from ")
        return
    with pytest.raises(InputError) as caught:
        import_file(tmp_path / "m.npy", ROWS, COLUMNS, scene)
    assert not unit or f"may be {' or '.join(unit)}; say which with `unit={unit[0]!r}` or" in str(caught.value)
    assert unit or "fit none of volt, mV, code" in str(caught.value)


def test_volt_and_ohm_that_both_fit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="may be ohm or kohm; say which with `unit='ohm'` or `unit='kohm'`"):
        imported(tmp_path / "m.csv", "\n".join(wide((FRAMES / 100).round(3))))
    with pytest.raises(InputError, match="may be kohm or volt"):
        imported(tmp_path / "m.csv", "\n".join(wide(VOLTS.round(2))), scene=DIVIDER)
    told, notes = imported(tmp_path / "m.csv", "\n".join(wide(VOLTS.round(2))), scene=DIVIDER, unit="volt")
    np.testing.assert_allclose(told.recorded, 1000 * (5 / VOLTS - 1), rtol=0.1)
    assert said(notes, "unit volt, as specified")


@pytest.mark.parametrize(
    ("header", "factor", "unit"),
    [
        ("R{r}C{c} [kOhm]", 1e3, "kohm"), ("R{r}C{c} (Ω)", 1, "ohm"), ("R{r}C{c} [mV]", None, "mV"),
        ("adc_{r}_{c}", None, "code"),
        ("R{r}C{c} [V]", None, "volt"), ("R{r}C{c} in kOhm", 1e3, "kohm"), ("R{r}C{c}/kΩ", 1e3, "kohm"),
    ],
)  # fmt: skip
def test_the_unit_is_taken_from_the_header(tmp_path: Path, header: str, factor: float | None, unit: str) -> None:
    text = "\n".join([names(header), *wide(CODES / 400 if unit == "volt" else CODES)])
    recording, notes = imported(tmp_path / "m.csv", text, scene=None if factor else LOADED)
    if factor:
        np.testing.assert_allclose(recording.resistance, CODES * factor)
    assert said(notes, f"unit {unit}, as the header says")
    if not factor:
        with pytest.raises(InputError, match=f"{unit} values need a scene with a readout"):
            imported(tmp_path / "m.csv", text)


def test_units_of_headers_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unit 'MΩ' is none of ohm, kohm, volt, mV and code; `unit` overrides"):
        imported(tmp_path / "m.csv", "\n".join([names("r{r}c{c} [MΩ]"), *wide(FRAMES)]))
    mixed = names("r{r}c{c} [ohm]").replace("r2c4 [ohm]", "r2c4 [kohm]")
    with pytest.raises(InputError, match="name both ohm and kohm"):
        imported(tmp_path / "m.csv", "\n".join([mixed, *wide(FRAMES)]))
    assert imported(tmp_path / "m.csv", "\n".join([mixed, *wide(FRAMES)]), unit="ohm")[0].resistance[0, 0, 0] > 250
    with pytest.raises(InputError, match="the scene's readout gives volt; say unit volt, mV or code"):
        imported(tmp_path / "m.csv", "\n".join([names("r{r}c{c} [ohm]"), *wide(FRAMES)]), scene=LOADED)


# Missing readings.


@pytest.mark.parametrize("word", ["ovf", "", "NaN", "-", "----", "null", "OL", "#N/A", "n/a", "-inf", "1.#QNAN"])
@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_words_for_missing_readings_become_nan(tmp_path: Path, word: str, sign: str) -> None:
    text = [line.split(sign) for line in wide(FRAMES, sign)]
    text[1][13] = word
    text[2][0] = word
    content = "\n".join(sign.join(line) for line in text)
    expected = FRAMES.copy()
    expected[1, 2, 3] = expected[2, 0, 0] = np.nan
    recording, notes = imported(tmp_path / "m.csv", content, baseline_frames=2)
    np.testing.assert_array_equal(recording.resistance, expected)
    assert said(notes, "2 readings missing, in 2 of 4 frames: NaN in the recording")
    recording.save(tmp_path / "m.h5")
    np.testing.assert_array_equal(Recording.load(tmp_path / "m.h5").resistance, expected)
    kept, notes = imported(tmp_path / "m.csv", content, baseline_frames=2, missing="skip-frame")
    np.testing.assert_array_equal(kept.resistance, FRAMES[[0, 3]])
    np.testing.assert_array_equal(kept.time, [0, 3])
    np.testing.assert_array_equal(kept.role, [0, 1])
    assert said(notes, "these frames are left out") and said(notes, "2 frames of 3 × 5 cells, the first 1 unloaded")
    with pytest.raises(InputError, match=r"m\.csv:2:14: the reading of row 2, column 3 is missing"):
        imported(tmp_path / "m.csv", content, missing="refuse")


def test_infinity_is_a_bound_in_ohm_and_missing_in_codes(tmp_path: Path) -> None:
    ohm = "\n".join(wide(FRAMES)).replace(str(FRAMES[1, 0, 0]), "inf")
    recording, notes = imported(tmp_path / "m.csv", ohm, scene=DIVIDER)
    assert recording.resistance[1, 0, 0] == np.inf and said(notes, "1 reading at or beyond a rail")
    assert recording.readings().side[1, 0, 0] == 1
    codes = [line.split(",") for line in wide(CODES)]
    codes[1][0] = "inf"
    recording, notes = imported(tmp_path / "m.csv", "\n".join(map(",".join, codes)), scene=LOADED)
    assert np.isnan(recording.recorded[1, 0, 0]) and said(notes, "1 reading missing")


def test_nothing_is_left(tmp_path: Path) -> None:
    nothing = "\n".join(wide(np.full((2, ROWS, COLUMNS), np.nan)))
    with pytest.raises(InputError, match="all readings are missing"):
        imported(tmp_path / "m.csv", nothing)
    holes = FRAMES.copy()
    holes[:, 0, 0] = np.nan
    with pytest.raises(InputError, match="no frame would be left; `missing='mark'` keeps them"):
        imported(tmp_path / "m.csv", "\n".join(wide(holes)), missing="skip-frame")
    with pytest.raises(InputError, match="'drop' is unknown; there are mark, skip-frame, refuse"):
        imported(tmp_path / "m.csv", "\n".join(wide(FRAMES)), missing="drop")


# Excel.

T0 = datetime.datetime(2025, 1, 31, 12, 0, 0)


def book(path: Path, **sheets: Sequence[Sequence[Any]]) -> Path:
    made = openpyxl.Workbook()
    made.remove(made.active)
    for name, rows in sheets.items():
        sheet = made.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    made.save(path)
    return path


def sheet_of(frames: np.ndarray) -> list[list[Any]]:
    head = [["Panel of Monday"], [], ["Time", *names("R{r}C{c} [kOhm]", 1).split(",")]]
    return head + [
        [T0 + datetime.timedelta(seconds=n / 2), *(float(x) / 1000 for x in frame.ravel())]
        for n, frame in enumerate(frames)
    ]


def test_excel_sheets_are_read(tmp_path: Path) -> None:
    rows = sheet_of(FRAMES)
    rows[4][15] = "#DIV/0!"
    rows[5][1] = None
    expected = FRAMES.copy()
    expected[1, 2, 4] = expected[2, 0, 0] = np.nan
    recording, notes = import_file(book(tmp_path / "m.xlsx", Notes=[["hello"]], Data=rows), ROWS, COLUMNS)
    np.testing.assert_allclose(recording.resistance, expected)
    np.testing.assert_array_equal(recording.time, [0, 0.5, 1, 1.5])
    assert recording.start_time == "2025-01-31T12:00:00" and said(notes, "sheet Data") and said(notes, "row 3 taken as")
    rows[6][7] = "abc"
    with pytest.raises(InputError, match=r"m\.xlsx: Data!H7: 'abc' is no number"):
        import_file(book(tmp_path / "m.xlsx", Data=rows), ROWS, COLUMNS)
    column = [[1.0]] * 1500 + [[1.0, 2.0, 3.0]]  # is not read to its end
    with pytest.raises(InputError, match=r"1 fields; 3 × 5 cells need"):
        import_file(book(tmp_path / "m.xlsx", Data=column), ROWS, COLUMNS)
    two = book(tmp_path / "m.xlsx", A=sheet_of(FRAMES), B=sheet_of(2 * FRAMES))
    with pytest.raises(InputError, match="the sheets A, B would all fit; say which with `variable`"):
        import_file(two, ROWS, COLUMNS)
    np.testing.assert_allclose(import_file(two, ROWS, COLUMNS, variable="B")[0].resistance, 2 * FRAMES)
    with pytest.raises(InputError, match="no sheet 'C'; there are A, B"):
        import_file(two, ROWS, COLUMNS, variable="C")
    blocks = [[float(x) for x in row] for frame in FRAMES for row in [*frame, []]]
    np.testing.assert_array_equal(import_file(book(tmp_path / "m.xlsx", A=blocks), ROWS, COLUMNS)[0].resistance, FRAMES)


def test_excel_that_claims_the_whole_sheet(tmp_path: Path) -> None:
    made = openpyxl.Workbook()
    made.active["A1"], made.active["XFD1048576"] = 1, 2
    made.save(tmp_path / "m.xlsx")
    with pytest.raises(InputError, match="16384 fields"):
        import_file(tmp_path / "m.xlsx", ROWS, COLUMNS)


# Archives of arrays, MATLAB 7.3.


def test_arrays_of_an_npz_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    np.savez_compressed(path, R_kohm=FRAMES / 1000, time_ms=np.arange(4) * 250, note=np.array("text"), gain=np.ones(3))
    recording, notes = import_file(path, ROWS, COLUMNS)
    np.testing.assert_allclose(recording.resistance, FRAMES)
    np.testing.assert_allclose(recording.time, [0, 0.25, 0.5, 0.75])
    assert said(notes, "array R_kohm read as (frames, rows, columns)") and said(notes, "time: array time_ms in ms")
    np.savez(path, a=FRAMES, b=2 * FRAMES)
    with pytest.raises(InputError, match="a, b would all fit; say which with `variable`"):
        import_file(path, ROWS, COLUMNS)
    np.testing.assert_array_equal(import_file(path, ROWS, COLUMNS, variable="b")[0].resistance, 2 * FRAMES)


def test_arrays_with_frames_last_are_read(tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", FRAMES.transpose(1, 2, 0))
    recording, notes = import_file(tmp_path / "m.npy", ROWS, COLUMNS)
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    assert said(notes, "read as (rows, columns, frames)")
    np.save(tmp_path / "m.npy", np.arange(8.0).reshape(2, 2, 2) + 100)
    _, notes = import_file(tmp_path / "m.npy", 2, 2)
    assert said(notes, "read as (frames, rows, columns) ((rows, columns, frames) would fit, too)")
    frames = FRAMES.copy()
    frames[3, 2, 1] = -1
    np.save(tmp_path / "m.npy", frames.transpose(1, 2, 0))
    with pytest.raises(InputError, match=r"m\.npy\[2, 1, 3\]: -1 must be a positive resistance"):
        import_file(tmp_path / "m.npy", ROWS, COLUMNS)


def matlab(path: Path, **arrays: np.ndarray) -> Path:
    """As MATLAB writes with -v7.3: HDF5 after 512 bytes of its own, axes in reverse."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values.T)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("note", data=np.array([[65], [66]], dtype="u2"))
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM"
    path.write_bytes(header + path.read_bytes()[len(header) :])
    return path


@pytest.mark.parametrize("frames_last", [False, True])
def test_matlab_files_of_version_7_3_are_read(tmp_path: Path, frames_last: bool) -> None:
    values = FRAMES.transpose(1, 2, 0) if frames_last else FRAMES
    path = matlab(tmp_path / "m.mat", R=values, t=np.arange(4.0)[None] / 2)
    recording, _ = import_file(path, ROWS, COLUMNS)
    np.testing.assert_array_equal(recording.resistance, FRAMES)
    np.testing.assert_array_equal(recording.time, [0, 0.5, 1, 1.5])


# Files that claim too much.


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(6):
            archive.writestr(f"{number}.npy", bytes(100_000_000))


def boastful(path: Path) -> None:
    stream = io.BytesIO()
    np.save(stream, FRAMES)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("R.npy", stream.getvalue().replace(b"(4, 3, 5), ", b"(400000000000, 3, 5), "))


def pickled(path: Path) -> None:
    np.savez(path, R=np.array([{}], dtype=object))


def claims(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("R", (10**9, 3, 5), "f8", chunks=(1000, 3, 5), compression="gzip", fillvalue=1)


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("m.npz", bomb, "unpacks to 600000000 bytes, more than 500000000 are not imported"),
        ("m.xlsx", bomb, "unpacks to 600000000 bytes"),
        ("m.npz", boastful, "claims more data than the memory holds"),
        ("m.npz", pickled, "the numeric arrays are: none"),
        ("m.npz", lambda path: path.write_bytes(b"PK\x03\x04 no zip"), "no readable .npz file"),
        ("m.xlsx", lambda path: path.write_bytes(b""), "no readable .xlsx file"),
        ("m.xlsx", boastful, "no readable .xlsx file"),
        ("m.xls", lambda path: path.write_bytes(b"\xd0\xcf"), "save it as .xlsx"),
        ("m.mat", claims, "claims"),
        ("m.csv", lambda path: path.write_bytes(b"1,2\n" + b"9" * 900_000), "fields"),
        ("m.csv", lambda path: path.write_bytes(b"\xff\xfe1"), "holds no values"),
    ],
)
def test_a_file_without_a_table_is_refused(
    tmp_path: Path, name: str, make: Callable[[Path], object], message: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(InputError) as caught:
        import_file(tmp_path / name, ROWS, COLUMNS)
    assert str(tmp_path / name) in str(caught.value) and message in str(caught.value)


# Tables at random.

WORDS = (
    "ovf", "nan", "inf", "-", "OL", "", "x3", "time", "t [ms]", "r0c0", "R1C1", "row", "col", "value",
    "frame", "cell", "R [kOhm]", "12:34:56.789", "2025-01-31T12:00:00", "24.12.2025", "1,5", "1.234,5", "1e5",
    "-3", "0", "1", "2", "512", "0.3", "#", "% c", "Frame 3", "t=5", "c1", "r2", "MΩ", "[V]", '"a"', '"',
    "1_0", "0x1", "9" * 30, "1e999", "--", "a b", "\t", ";", "->", "[12:00:00] 5", "date", "2025-13-45",
    "(0, 3)", "k", "timestamp", "1700000000", "1e300", "4294967295", "[1, 2]", "\u2028", "\x1b",
)  # fmt: skip


def random_table(rng: np.random.Generator) -> bytes:
    """Some lines of numbers, or of anything, of mostly one length."""
    sign, end = rng.choice([",", ";", "\t", " ", ", "]), rng.choice(["\n", "\r\n", "\r"])
    width, plain = int(rng.choice([1, 3, 3, 4, 6, 6, 7, 7, 12])), rng.random() < 0.6
    rows = []
    for _ in range(int(rng.integers(9))):
        count = width if rng.random() < 0.85 else int(rng.integers(10))
        fields = [
            f"{rng.uniform(200, 900):.{rng.integers(4)}f}" if plain else str(rng.choice(WORDS)) for _ in range(count)
        ]
        rows.append(sign.join(str(rng.choice(WORDS)) if rng.random() < 0.06 else field for field in fields))
        rows += [str(rng.choice(WORDS))] * int(rng.random() < 0.1)
    return end.join(rows).encode(str(rng.choice(["utf-8", "utf-16", "utf-8-sig"])))


@pytest.mark.parametrize("scene", [None, "divider", "loaded"])
def test_any_table_is_taken_or_refused_with_one_sentence(tmp_path: Path, scene: str | None) -> None:
    known = {None: None, "divider": Scene(Panel(2, 3), TwoPointReadout()), "loaded": Scene(Panel(2, 3), LOADED.readout)}
    taken = 0
    for seed in range(250):
        rng = np.random.default_rng([seed, len(scene or "")])
        (tmp_path / "m.csv").write_bytes(random_table(rng))
        try:
            missing = str(rng.choice(["mark", "skip-frame", "refuse"]))
            recording, notes = import_file(tmp_path / "m.csv", 2, 3, known[scene], missing=missing)
        except InputError as error:
            assert str(error).isprintable() and len(str(error)) < 1000
            continue
        taken += 1
        recording.readings()
        assert recording.recorded.shape[1:] == (2, 3) and np.all(np.diff(recording.time) > 0)
        assert all(note.isprintable() for note in notes)
    assert taken > 5


# The command.


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return lampest_command(folder, "import", *arguments)


def lampest_command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = "from lampest.cli import main; main()"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_the_command_ends_with_a_map(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("panel: {rows: 3, columns: 5, pitch_mm: 8}\n")
    frames = np.full((2, ROWS, COLUMNS), 500.0)
    frames[:, 0, 4], frames[1, 2, 0] = 251, np.nan
    (tmp_path / "m.csv").write_text("\n".join(wide(frames)))
    ended = command(tmp_path, "m.csv", "--scene", "scene.yaml", "--out", "m.h5", "--period", "0.5", "--baseline", "1")
    assert (ended.returncode, ended.stderr) == (0, "")
    said_lines = ended.stdout.splitlines()
    assert said_lines[-6:] == [
        "mean reading in ohm:",
        "column    0    1    2    3    4",
        " row 0  500  500  500  500  251",
        " row 1  500  500  500  500  500",
        " row 2  500  500  500  500  500",
        "m.h5",
    ]
    assert said(said_lines, "series resistance 0 ohm and pitch 8 mm, by the scene")
    assert said(said_lines, "time: a frame every 0.5 s, as specified")
    recording = Recording.load(tmp_path / "m.h5")
    assert recording.scene.panel == Panel(3, 5, 8.0) and recording.time[1] == 0.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "how large is the panel? Say --rows and --columns, or give a --scene"),
        (["--rows", "3"], "how large is the panel?"),
        (["--rows", "5", "--columns", "3", "--scene", "scene.yaml"], "the scene's panel has 3 × 5 cells, not 5 × 3"),
        (["--columns", "4", "--scene", "scene.yaml"], "the scene's panel has 3 × 5 cells, not 3 × 4"),
        (["--scene", "scene.yaml", "--unit", "farad"], "the unit 'farad' is unknown"),
        (["--scene", "scene.yaml", "--unit", "code"], "code values need a scene with a readout"),
        (["--scene", "scene.yaml", "--period", "0"], "--period must be positive and finite"),
        (["--scene", "scene.yaml", "--missing", "drop"], "'drop' is unknown"),
        (["--scene", "scene.yaml", "--variable", "R"], "m.csv: holds nothing by name; --variable is for .mat, .npz"),
    ],
)
def test_the_command_refuses_with_one_sentence(
    tmp_path: Path,
    lampest: Callable[..., SimpleNamespace],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.yaml").write_text("panel: {rows: 3, columns: 5}\n")
    (tmp_path / "m.csv").write_text("\n".join(wide(FRAMES)))
    ended = lampest("import", "m.csv", "--out", "m.h5", *arguments)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert message in ended.err and not (tmp_path / "m.h5").exists()


def test_the_page_says_what_the_command_says(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "import.md").read_text(encoding="utf-8")
    typed = re.split(r"^\$ ", page.partition("```console\n")[2].partition("```")[0], flags=re.MULTILINE)[1:]
    answers = {}
    for part in typed:
        line, _, answer = part.partition("\n")
        answers[line] = answer
        if line.startswith("cat "):
            (tmp_path / line.split()[1]).write_text(answer, encoding="utf-8")
    (call,) = (line for line in answers if line.startswith("lampest import "))
    ended = command(tmp_path, *call.split()[2:])
    assert (ended.returncode, ended.stderr, ended.stdout) == (0, "", answers[call])


def test_info_says_when_a_recording_began(tmp_path: Path) -> None:
    recording, _ = timed(tmp_path, "time", [f"2025-01-31 12:00:0{n}+01:00" for n in range(4)])
    recording.save(tmp_path / "m.h5")
    ended = lampest_command(tmp_path, "info", "m.h5")
    assert "start      2025-01-31T12:00:00+01:00 at 0 s" in ended.stdout.splitlines()
