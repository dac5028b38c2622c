"""Arrays, sheets and archives, files that no reader takes, and scenes beside a file."""

import datetime
import io
import json
import os
import pickle
import re
import struct
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import openpyxl
import pandas
import pytest
import scipy.io
from contracts.imports import (
    COLUMNS,
    DIVIDER,
    FRAMES,
    ROWS,
    check_refused,
    check_taken,
    foreign_file,
    imported,
    lines,
    names,
)

from lampest import (
    InputError,
    Panel,
    Recording,
    Scene,
    SeriesPerLine,
    VirtualGroundReadout,
    import_file,
    read_scene,
)
from tests.small_files import run_command

T0 = datetime.datetime(2025, 1, 31, 12, 0, 0)
TEN_SECONDS = datetime.timedelta(seconds=10)
TENS = 10 * np.arange(4)
VOLTS = 5.0 * 1000.0 / (FRAMES + 1000.0)  # across the reference: R = (Vcc − V)/V·Rref
FRAMES_LAST = FRAMES.transpose(1, 2, 0)
GARBAGE = np.random.default_rng(3).bytes(4000)


def array(values: Any, *notes: str, **options: Any) -> SimpleNamespace:
    """A .npy file."""
    return foreign_file(lambda path: np.save(path, values), *notes, name="m.npy", **options)


def matrices(
    *notes: str, packed: bool = False, arrays: dict[str, Any], **options: Any
) -> SimpleNamespace:
    """A .mat file of level 5."""
    return foreign_file(
        lambda path: scipy.io.savemat(path, arrays, do_compression=packed),
        *notes,
        name="m.mat",
        **options,
    )


def archive(
    save: Callable[..., None], *notes: str, arrays: dict[str, Any], **options: Any
) -> SimpleNamespace:
    """An .npz file."""
    return foreign_file(lambda path: save(path, **arrays), *notes, name="m.npz", **options)


def matlab(path: Path, **arrays: np.ndarray) -> None:
    """Write a file as MATLAB does with -v7.3: HDF5 after 512 bytes of its own, axes in reverse."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values.T)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("note", data=np.array([[65], [66]], dtype="u2"))
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM"
    path.write_bytes(header + path.read_bytes()[len(header) :])


def tree(*notes: str, arrays: dict[str, Any], **options: Any) -> SimpleNamespace:
    """An HDF5 file of another program: arrays by their paths; behind @, an attribute."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                of, _, attribute = name.partition("@")
                if attribute:
                    (file[of] if of else file).attrs[attribute] = values
                else:
                    file[name] = values

    return foreign_file(write, *notes, name="m.h5", **options)


def book(
    sheets: dict[str, Sequence[Sequence[Any]]], *notes: str, **options: Any
) -> SimpleNamespace:
    """An .xlsx file."""
    workbook = openpyxl.Workbook()
    workbook.remove(workbook.active)
    for name, rows in sheets.items():
        sheet = workbook.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    return foreign_file(workbook.save, *notes, name="m.xlsx", **options)


def sheet_of(
    frames: np.ndarray, changes: dict[tuple[int, int], Any] | None = None
) -> list[list[Any]]:
    rows: list[list[Any]] = [
        ["Panel of Monday"],
        [],
        ["Time", *names("R{r}C{c} [kOhm]", 1).split(",")],
    ]
    for n, frame in enumerate(frames):
        rows.append(
            [T0 + datetime.timedelta(seconds=n / 2), *(float(x) / 1000 for x in frame.ravel())]
        )
    for (row, column), value in (changes or {}).items():
        rows[row][column] = value
    return rows


def amplifiers(**volts: float) -> Scene:
    return Scene(
        Panel(ROWS, COLUMNS), VirtualGroundReadout(sense_ohm=70.0, feedback_ohm=4000.0, **volts)
    )


OWN_VOLTAGES = amplifiers(drive_volt=0.5, converter_volt=2.5)


def mostly(volt: float) -> np.ndarray:
    volts = np.full((2, ROWS, COLUMNS), volt)
    volts[0, 0] = 1.0
    return volts


CUBE = np.arange(8.0).reshape(2, 2, 2) + 100
AMBIGUOUS = "read as (frames, rows, columns) ((rows, columns, frames) would fit, too)"
HOLES = FRAMES.copy()
HOLES[1, 2, 4] = HOLES[2, 0, 0] = np.nan
GAPS = {(4, 15): "#DIV/0!", (5, 1): None}
HALVES: dict[str, Any] = {"times": np.arange(4) / 2, "start": "2025-01-31T12:00:00"}
CLOCK = [
    [T0.date(), datetime.time(12, 0, n), *map(float, frame.ravel())]
    for n, frame in enumerate(FRAMES)
]
DATED = [["Date", "Time", *names("R{r}C{c}", 1).split(",")], *CLOCK]
MEAN = [
    [row[1], *row[2:]] for row in [DATED[0], *(["", n, *row[2:]] for n, row in enumerate(CLOCK))]
]
TWO_SHEETS = {"A": sheet_of(FRAMES), "B": sheet_of(2 * FRAMES)}
FILES = {
    "frames, rows, columns": array(FRAMES, "read as (frames"),
    "frames, columns, rows": array(FRAMES.transpose(0, 2, 1), "read as (frames", transpose=True),
    "one transposed frame": array(FRAMES[0].T, expected=FRAMES[:1], transpose=True),
    "frames last": array(FRAMES_LAST, "read as (rows, columns, frames)"),
    "frames first or last": array(CUBE, AMBIGUOUS, expected=CUBE, rows=2, columns=2, unit="ohm"),
    "lines with resistances of their own": array(
        FRAMES,
        f"series resistance rows from 70 to {69 + ROWS} ohm, columns 71 ohm",
        scene=Scene(
            Panel(ROWS, COLUMNS),
            None,
            SeriesPerLine(tuple(70.0 + line for line in range(ROWS)), 71.0),
        ),
        unit="ohm",
    ),
    "an archive": archive(
        np.savez_compressed,
        "array R_kohm read as (frames, rows, columns)",
        "time: array time_ms in ms",
        arrays={
            "R_kohm": FRAMES / 1000,
            "time_ms": np.arange(4) * 250,
            "note": np.array("text"),
            "gain": np.ones(3),
        },
        times=np.arange(4) / 4,
    ),
    "a chosen array": archive(np.savez, arrays={"a": 2 * FRAMES, "b": FRAMES}, variable="b"),
    "open cells, which an unloaded film has": array(
        mostly(0.0), scene=amplifiers(), unit="volt", expected=mostly(0.0)
    ),
    "half floats": array(FRAMES.astype("f2"), "unit ohm", expected=FRAMES.astype("f2")),
    "times of NumPy": archive(
        np.savez,
        "time: array time in s since 1970",
        arrays={"R": FRAMES, "time": np.datetime64(T0, "ms") + np.arange(4) * 500},
        times=np.arange(4) / 2,
        start="2025-01-31T12:00:00Z",
    ),
    "a packed matrix beside what is none": matrices(
        "array R read as (rows, columns, frames)",
        arrays={
            "note": "text",
            "fs": 1.0,
            "s": {"a": FRAMES_LAST},
            "z": FRAMES_LAST * 1j,
            "i": np.arange(3),
            "R": FRAMES_LAST,
        },
        packed=True,
    ),
    "a sheet": book(
        {"Notes": [["hello"]], "Data": sheet_of(FRAMES, GAPS)},
        "sheet Data",
        "row 3 taken as",
        expected=HOLES,
        **HALVES,
    ),
    "dates beside times of day": book(
        {"A": DATED}, times=np.arange(4), start="2025-01-31T12:00:00"
    ),
    "durations": book(
        {"A": [MEAN[0], *([n * TEN_SECONDS, *row[2:]] for n, row in enumerate(CLOCK))]}, times=TENS
    ),
    "a chosen sheet": book(TWO_SHEETS, variable="B", expected=2 * FRAMES, **HALVES),
    "blocks in a sheet": book(
        {"A": [[float(x) for x in row] for frame in FRAMES for row in [*frame, []]]}
    ),
}


def records(value: Any, *notes: str, name: str = "m.json", **options: Any) -> SimpleNamespace:
    """A JSON file, or one with a value a line."""
    text = json.dumps(value) if name.endswith(".json") else "\n".join(map(json.dumps, value))
    return foreign_file(text, *notes, name=name, **options)


def listed(values: np.ndarray) -> Any:
    """Lists of JSON, null where a reading is missing."""
    return json.loads(json.dumps(values.tolist()).replace("NaN", "null"))


def table_of(
    path: Path, frames: np.ndarray = FRAMES, write: str = "to_parquet", **columns: Any
) -> None:
    named = dict(zip(names("r{r}c{c}").split(","), frames.reshape(len(frames), -1).T, strict=True))
    getattr(pandas.DataFrame(columns | named), write)(path)


def lists_of(path: Path) -> None:
    pandas.DataFrame(
        {"t": np.arange(4) / 2, "frame": [list(frame.ravel()) for frame in FRAMES]}
    ).to_parquet(path)


def folder(write: Callable[[Path, np.ndarray], object], suffix: str) -> Callable[[Path], None]:
    """Write a file for each frame, of which the numbers have one and two digits."""

    def write_all(path: Path) -> None:
        path.mkdir()
        (path / ".hidden").write_text("no frame")
        for number, frame in enumerate(np.concatenate([FRAMES, FRAMES, FRAMES])):
            write(path / f"frame{number}{suffix}", frame)

    return write_all


def shown(path: Path) -> None:
    folder(csv_of, ".csv")(path)
    (path / "Thumbs.db").write_bytes(GARBAGE)


def in_two_encodings(path: Path) -> None:
    folder(csv_of, ".csv")(path)
    reencoded = path / "frame7.csv"
    reencoded.write_bytes(reencoded.read_text().encode("utf-16"))


def each_with_a_cut_block(path: Path) -> None:
    path.mkdir()
    for number in range(25):
        whole = "\n".join(lines(FRAMES[0]))
        (path / f"frame{number}.csv").write_text("\n" * number + f"{whole}\n\n{whole[:20]}")


def csv_of(path: Path, frame: np.ndarray) -> None:
    path.write_text("\n".join(lines(frame)))


TRIPLED = np.concatenate([FRAMES, FRAMES, FRAMES])
DATED_RECORDS = [
    {"time": f"2025-01-31T12:00:0{n}Z", "grid": listed(frame)} for n, frame in enumerate(FRAMES)
]
TIMED = [
    {"t": n / 2, "seq": 7 + n, "data": listed(frame.ravel())} for n, frame in enumerate(FRAMES)
]
LONG_RECORDS = [
    {"frame": f, "row": r, "col": c, "ohm": FRAMES[f, r, c]} for f, r, c in np.ndindex(FRAMES.shape)
]
NAMED_RECORDS = [
    {"ms": 250 * n} | dict(zip(names("r{r}c{c}").split(","), listed(frame.ravel()), strict=True))
    for n, frame in enumerate(FRAMES)
]
BLOCKS = np.concatenate(
    [FRAMES, np.zeros_like(FRAMES)]
)  # as many frames again that were not written
STEP_NS = 2.0**26  # doubles hold its multiples exactly, also since 1970
SINCE_1970_NS = STEP_NS * (25_609_000_000 + np.arange(4))
START = "2024-06-17T02:21:38.176000Z"
WITH_TIMES = np.column_stack([SINCE_1970_NS, FRAMES.reshape(4, -1)])
FIELDS = np.zeros(4, dtype=[("time", "f8"), ("values", "f8", (ROWS, COLUMNS))])
FIELDS["time"] = np.arange(4) / 4
FIELDS["values"] = FRAMES
FILES |= {
    "HDF5: counted frames": tree(
        "array mat/pressure read as (frames, rows, columns)",
        "4 frames behind the 4 of mat/frame_count left out",
        "array mat/ts in s",
        arrays={
            "ts": np.arange(8.0) * 9 + 1,
            "mat/pressure": BLOCKS,
            "mat/ts": np.append(np.arange(4) / 20, np.zeros(4)),
            "mat/frame_count": np.array([4], dtype="u4"),
            "label": "left",
        },
        times=np.arange(4) / 20,
    ),
    "HDF5: frames counted by an attribute": tree(
        "4 frames behind the 4 of R.n_frames left out", arrays={"R": BLOCKS, "R@n_frames": 4}
    ),
    "HDF5: blocks that are not full": tree(
        "4 frames of zeros at the end, without a time, left out",
        arrays={"R": BLOCKS, "t": np.append(1 + np.arange(4.0), np.zeros(4))},
        times=np.arange(4.0) + 1,
    ),
    "HDF5: the time in the first column": tree(
        "array R read as (frames, 1 + rows·columns), the time first",
        "time: ns since 1970",
        arrays={"R": WITH_TIMES},
        times=np.arange(4) * STEP_NS * 1e-9,
        start=START,
    ),
    "HDF5: fields of one dataset": tree(
        "array log.values read as (frames, rows, columns)",
        arrays={"log": FIELDS},
        times=np.arange(4) / 4,
    ),
    "JSON: frames": records(listed(HOLES), "read as (frames, rows, columns)", expected=HOLES),
    "JSON: a name beside times": records(
        {"unit": "ohm", "t": [0, 1, 2, 3], "R": listed(FRAMES)}, "array R read as"
    ),
    "JSON: records": records(
        TIMED, "array data read as (frames, rows·columns)", times=np.arange(4) / 2
    ),
    "JSON: records below a name": records(
        {"device": "mat", "frames": DATED_RECORDS},
        "array grid",
        times=np.arange(4),
        start="2025-01-31T12:00:00Z",
    ),
    "JSON: a record a value": records(
        LONG_RECORDS, "60 records", "one value a line as frame, row, column, value"
    ),
    "JSON: a record a frame": records(NAMED_RECORDS, "column 'ms' in ms", times=np.arange(4) / 4),
    "JSON lines: frames": records(listed(FRAMES), "read as (frames", name="m.jsonl"),
    "JSON lines under the name of one value": foreign_file(
        "\n".join(map(json.dumps, TIMED)), name="m.json", times=np.arange(4) / 2
    ),
    "JSON lines: times by another name": records(
        [{"ts": 50 * n, "matrix": listed(frame)} for n, frame in enumerate(FRAMES)],
        "array ts in ms",
        name="m.jsonl",
        times=np.arange(4) / 20,
    ),
    "JSON lines that are cut": foreign_file(
        "\n".join(map(json.dumps, listed(FRAMES)))[:-9],
        "left out: line 4, the last one, which is cut off",
        name="m.jsonl",
        expected=FRAMES[:3],
    ),
    "JSON lines of a table that are cut": foreign_file(
        "\n".join(map(json.dumps, NAMED_RECORDS))[:-9],
        "left out: line 4, the last one, which is cut off",
        name="m.json",
        expected=FRAMES[:3],
        times=np.arange(3) / 4,
    ),
    "Parquet": foreign_file(table_of, "cells by their names", name="m.parquet"),
    "Parquet with dates": foreign_file(
        lambda path: table_of(
            path, time=pandas.to_datetime([f"2025-01-31T12:00:0{n}" for n in range(4)])
        ),
        name="m.parquet",
        times=np.arange(4),
        start="2025-01-31T12:00:00",
    ),
    "Parquet of lists": foreign_file(
        lists_of, "array frame read as", name="m.parquet", times=np.arange(4) / 2
    ),
    "Feather": foreign_file(lambda path: table_of(path, write="to_feather"), name="m.feather"),
    "a folder of tables": foreign_file(
        folder(csv_of, ".csv"), "12 frames of 12 files", name="m", expected=TRIPLED
    ),
    "a folder that a desktop has shown": foreign_file(
        shown, "12 frames of 12 files", name="m", expected=TRIPLED
    ),
    "a folder in two encodings": foreign_file(
        in_two_encodings,
        "frame7.csv: fields separated by comma, UTF-16",
        name="m",
        expected=TRIPLED,
    ),
    "a folder of arrays": foreign_file(
        folder(np.save, ".npy"), "from frame0.npy to frame11.npy", name="m", expected=TRIPLED
    ),
}
for axes, values in (("last", FRAMES_LAST), ("first", FRAMES)):
    FILES[f"MATLAB 7.3 with frames {axes}"] = foreign_file(
        lambda path, values=values: matlab(path, R=values, t=np.arange(4.0)[None] / 2),
        name="m.mat",
        times=np.arange(4) / 2,
    )


def with_value(values: np.ndarray, value: float, *place: int) -> np.ndarray:
    changed = values.copy()
    changed[place] = value
    return changed


def sparse(path: Path) -> None:
    with path.open("wb") as handle:
        handle.truncate(600_000_000)


def boastful(path: Path) -> None:
    stream = io.BytesIO()
    np.save(stream, FRAMES)
    claims = stream.getvalue().replace(b"(4, 3, 5), ", b"(400000000000, 3, 5), ")
    if path.suffix == ".npy":
        path.write_bytes(claims)
        return
    with zipfile.ZipFile(path, "w") as parts:
        parts.writestr("R.npy", claims)


def bomb(path: Path) -> None:
    """Six parts that claim 100,000,000 bytes each; nothing is unpacked to find out."""
    size = 12_345
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as parts:
        for number in range(6):
            parts.writestr(f"{number}.npy", bytes(size))
    claimed = path.read_bytes().replace(struct.pack("<I", size), struct.pack("<I", 100_000_000))
    path.write_bytes(claimed)


def claims(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "R", (10**9, 3, 5), "f8", chunks=(1000, 3, 5), compression="gzip", fillvalue=1
        )


def whole_sheet(path: Path) -> None:
    workbook = openpyxl.Workbook()
    workbook.active["A1"] = 1
    workbook.active["XFD1048576"] = 2
    workbook.save(path)


def truncated(path: Path) -> None:
    np.save(path, FRAMES)
    os.truncate(path, 500)


BEYOND_CONVERTER = np.full((1, ROWS, COLUMNS), 500)
BEYOND_CONVERTER[0, 1, 2] = 1024
AT_RAIL = ("25 of 30 readings stand at the rail", "is readout.converter_volt, 2.5 V")


def mixed(path: Path) -> None:
    folder(csv_of, ".csv")(path)
    (path / "notes.txt").write_text("hello")


def spoiled(path: Path) -> None:
    folder(csv_of, ".csv")(path)
    (path / "frame7.csv").write_text("1,2\n")


def pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps(FRAMES))


REFUSED = [
    *(
        foreign_file(pickled, "a pickle runs code when it is opened", name=f"m{end}")
        for end in (".pkl", ".pickle", ".p")
    ),
    *(
        foreign_file(pickled, "a pickle, which runs code when it is opened", name=name)
        for name in ("m.dat", "m.csv")
    ),
    foreign_file(
        b"\x81\x82\x83",
        "no text table (",
        ".parquet; `layout` names a layout of your own",
        name="m.dat",
    ),
    foreign_file(b"\x89HDF\r\n", "no text table, but HDF5; save the array as .npy", name="m.dat"),
    foreign_file(b"PK", "unpack it first", name="m.zip"),
    records([[1, 2], [3]], "m.json[1]: 1 values, where others have 2"),
    records(
        {"R": [["a", 2], ["b", 3]]},
        "m.json: R: its lists differ in length, or hold what is no number",
    ),
    records({"R": [1, 2]}, "no array fits 3 × 5 cells; the numeric arrays are: R (2)"),
    foreign_file('{"R": [1, 2}', "no readable .json file", name="m.json"),
    foreign_file("[1, 2]\n[1, 2\n[3]", "m.jsonl:2: no JSON", name="m.jsonl"),
    foreign_file("[" * 100_000, "no readable .json file", name="m.json"),
    foreign_file(GARBAGE, "no readable .parquet file", name="m.parquet"),
    foreign_file(mixed, "a folder of frames holds files of one kind, not .csv, .txt", name="m"),
    foreign_file(spoiled, "frame7.csv:1: 2 fields; 3 × 5 cells need", name="m"),
    foreign_file(GARBAGE, "no text table", name="m.csv"),
    foreign_file(b"1,2\n\xff\xfe,3", ":2: no text table", name="m.csv"),
    foreign_file(b"1" * 2_000_000, ":1: longer than", name="m.csv"),
    foreign_file(b"1,2\n" + b"9" * 900_000, "fields", name="m.csv"),
    foreign_file(b"\xff\xfe1", "holds no values", name="m.csv"),
    foreign_file(sparse, "more than 500000000 are not imported", name="m.csv"),
    foreign_file(Path.mkdir, "no file in this folder", name="m.csv"),
    foreign_file(lambda path: None, "No such file", name="m.csv"),
    foreign_file(
        b"1," * 14 + b"1",
        "holds nothing by name",
        "`variable` is for .h5, .hdf, .hdf5, .mat, .npz",
        variable="R",
        name="m.csv",
    ),
    *(
        foreign_file(GARBAGE, f"no readable .{kind} file", name=f"m.{kind}")
        for kind in ("npy", "mat")
    ),
    *(
        foreign_file(b"", f"no readable .{kind} file", name=f"m.{kind}")
        for kind in ("npy", "mat", "xlsx")
    ),
    *(
        foreign_file(boastful, f"no readable .{kind} file", name=f"m.{kind}")
        for kind in ("npy", "xlsx")
    ),
    foreign_file(truncated, "no readable .npy file", name="m.npy"),
    foreign_file(
        lambda path: np.save(path, np.array([{}], dtype=object), allow_pickle=True),
        "pickled objects",
        name="m.npy",
    ),
    foreign_file(boastful, "values, more than 62500000 are not imported", name="m.npz"),
    foreign_file(b"PK\x03\x04 no zip", "no readable .npz file", name="m.npz"),
    *(
        foreign_file(bomb, "unpacks to 600000000 bytes, more than 500000000", name=f"m.{kind}")
        for kind in ("npz", "xlsx")
    ),
    foreign_file(b"MATLAB 7.3 MAT-file".ljust(600), "save it with the option -v7", name="m.mat"),
    foreign_file(claims, "claims", name="m.mat"),
    foreign_file(b"\xd0\xcf", "save it as .xlsx", name="m.xls"),
    tree("is lampest's own file, which needs no import", arrays={"@lampest_format": "recording/3"}),
    tree(
        "left, right would all fit; say which with `variable`",
        arrays={"left": FRAMES, "right": FRAMES},
    ),
    tree(
        "no array fits 3 × 5 cells; the numeric arrays are: R (4 × 16)",
        arrays={"R": np.ones((4, 16))},
    ),
    foreign_file(b"", "m.h5: not a readable HDF5 file: it is empty", name="m.h5"),
    book({"A": [*MEAN, ["Monday", *MEAN[1][1:]]]}, "A!A6: 'Monday' is no time"),
    foreign_file(whole_sheet, "Sheet!1048576: 1 field; 3 × 5 cells need", name="m.xlsx"),
    array(FRAMES.astype(complex), "no plain array of real numbers"),
    array(FRAMES.transpose(0, 2, 1), "with `transpose` it would"),
    array(FRAMES[:, :2], "is 4 × 2 × 5, which fits 3 × 5 cells in no way"),
    array(
        with_value(FRAMES, -1, 3, 2, 1).transpose(1, 2, 0),
        "m.npy[2, 1, 3]: -1 must be a positive resistance",
    ),
    array(
        BEYOND_CONVERTER, "m.npy[0, 1, 2]: 1024 is no code of a 10-bit", scene=DIVIDER, unit="code"
    ),
    array(FRAMES, "volt values need a scene with a readout", unit="volt"),
    array(FRAMES, "`layout` is for tables", layout="row,column,value"),
    array(
        FRAMES,
        "the scene's panel has 3 × 5 cells, not 5 × 3",
        scene=DIVIDER,
        rows=5,
        columns=3,
        absent="m.npy",
    ),
    array(
        FRAMES,
        "the unit 'V' is unknown; there are ohm, kohm, volt, mV, code; write volt",
        unit="V",
        absent="m.npy",
    ),
    array(FRAMES, "; did you mean ohm?", unit="ohn", absent="m.npy"),
    array(FRAMES, "5 baseline frames asked for, but the file holds 4 frames", baseline_frames=5),
    array(FRAMES, "a panel needs at least one row", rows=0, columns=3, absent="m.npy"),
    foreign_file(
        lines(with_value(VOLTS, 5.5, 2, 1, 3)),
        "m.csv:3:9: ",
        "lies outside 0 to 5 V",
        scene=DIVIDER,
        unit="volt",
    ),
    array(
        OWN_VOLTAGES.circuit.exact_reading(np.full((2, ROWS, COLUMNS), 2000.0)),
        "fit none of volt, mV, code in this scene, whose converter ends at 0.5 V",
        scene=amplifiers(supply_volt=0.5),
    ),
    array(mostly(2.5), *AT_RAIL, scene=OWN_VOLTAGES, unit="volt"),
    book({"Data": sheet_of(FRAMES, {(6, 7): "abc"})}, "m.xlsx: Data!H7: 'abc' is no number"),
    book({"Data": [[1.0]] * 15 + [[1.0, 2.0, 3.0]] * 3}, "Data!16: 3 fields, where row 1 has 1"),
    book(TWO_SHEETS, "no sheet 'C'; there are A, B", variable="C"),
    book(TWO_SHEETS, "the sheets A, B would all fit; say which with `variable`"),
    matrices("no numeric array 'c'; there are R", arrays={"R": FRAMES_LAST}, variable="c"),
]


@pytest.mark.parametrize("file", FILES.values(), ids=FILES)
def test_an_array_or_a_sheet_is_imported_with_its_frames_times_and_notes(
    file: SimpleNamespace, tmp_path: Path
) -> None:
    check_taken(file, tmp_path)


@pytest.mark.parametrize("file", REFUSED, ids=lambda file: f"{file.name}: {file.notes[0]}")
def test_a_fault_in_a_file_gives_one_sentence(file: SimpleNamespace, tmp_path: Path) -> None:
    check_refused(file, tmp_path)


# Scenes beside a file.


def test_a_folder_has_at_most_20_notes_on_single_files_and_the_number_of_the_others(
    tmp_path: Path,
) -> None:
    each_with_a_cut_block(tmp_path / "m")
    _, notes = import_file(tmp_path / "m", rows=ROWS, columns=COLUMNS, unit="ohm")
    single = [note for note in notes if note.startswith("frame")]
    assert len(single) == 20
    assert "frame2.csv: " in single[4] and "line 7, the last one, which is cut off" in single[4]
    assert "30 more notes on single files" in notes


def test_a_scene_file_describes_the_panel_of_an_import(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    for text, scene in (
        (
            "panel: {rows: 3, columns: 5}\nseries_resistance_ohm: 140\n",
            Scene(Panel(3, 5), None, 140.0),
        ),
        ("seed: 1\nscene:\n  panel: {rows: 3, columns: 5}\n", Scene(Panel(3, 5))),
    ):
        path.write_text(text, encoding="utf-8")
        assert read_scene(path) == scene
    path.write_text(
        "panel: {rows: 3, columns: 5}\nreadout: {kind: two_point, adc_bits: 12, readings: 5}\n"
    )
    text = "pitch_mm: 10, supply_volt: 5, reference_ohm: 1000, measured_across: reference"
    assert read_scene(path).assumed_text == text
    path.write_text("seed: 1\nscene:\n  panel: {rows: 3, colums: 5}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"scene\.yaml:3:"):
        read_scene(path)


def test_the_import_sets_entries_of_a_scene(tmp_path: Path, lampest: Callable[..., Any]) -> None:
    scene = tmp_path / "scene.yaml"
    out = tmp_path / "m.h5"
    scene.write_text("panel: {rows: 3, columns: 5}\nseries_resistance_ohm: 140\n", encoding="utf-8")
    np.save(tmp_path / "m.npy", FRAMES)
    words = ("import", tmp_path / "m.npy", "--unit", "ohm", "--out", out)
    assigned = ("--scene", scene, "--set", "series_resistance_ohm=70", "--set", "panel.pitch_mm=4")
    completed = lampest(*words, *assigned, "--period", "0.5", "--baseline", "1")
    assert completed.code == 0, completed.err
    assert "series resistance 70 ohm and pitch 4 mm, by the scene" in completed.out
    recording = Recording.load(out)
    assert recording.scene == Scene(Panel(3, 5, 4.0), None, 70.0)
    assert (recording.time[1], recording.role.tolist()) == (0.5, [0, 1, 1, 1])
    out.unlink()
    wrong = lampest(*words, "--scene", scene, "--set", "panel.pitsch_mm=4")
    assert (wrong.code, out.exists()) == (2, False) and "pitsch_mm" in wrong.err
    nowhere = lampest(*words, "--rows", 3, "--columns", 5, "--set", "panel.pitch_mm=4")
    assert (nowhere.code, out.exists()) == (2, False) and "--scene" in nowhere.err


# The command.


@pytest.mark.slow
def test_the_page_shows_the_output_of_the_command(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/apps/foreign/import.md").read_text(encoding="utf-8")
    typed = re.split(
        r"^\$ ", page.partition("```console\n")[2].partition("```")[0], flags=re.MULTILINE
    )[1:]
    answers = {line: answer for line, _, answer in (part.partition("\n") for part in typed)}
    for line, answer in answers.items():
        if line.startswith("cat "):
            (tmp_path / line.split()[1]).write_text(answer, encoding="utf-8")
    (call,) = (line for line in answers if line.startswith("lampest import "))
    completed = run_command(*call.split()[1:], cwd=tmp_path)
    assert (completed.returncode, completed.stderr, completed.stdout) == (0, "", answers[call])


def test_info_prints_the_start_of_a_recording(
    tmp_path: Path, lampest: Callable[..., SimpleNamespace]
) -> None:
    recording = Recording.from_array(FRAMES)
    replace(recording, start_time="2025-01-31T12:00:00+01:00").save(tmp_path / "m.h5")
    assert (
        "start      2025-01-31T12:00:00+01:00 at 0 s"
        in lampest("info", tmp_path / "m.h5").out.splitlines()
    )


def test_an_imported_signalling_nan_becomes_quiet(tmp_path: Path) -> None:
    """NumPy warns of it in later arithmetic."""
    values = FRAMES.copy()
    values.view(np.uint64)[1, 0, 0] = 0x7FF0000000000001
    recording, _ = imported(tmp_path, array(values))
    assert recording.recorded.view(np.uint64)[1, 0, 0] == np.array(np.nan).view(np.uint64)
