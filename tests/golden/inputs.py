"""Rows of inputs: foreign files, and the ranges of all public configurations.

The files are of every layout, unit and clock.
"""

import re
import tempfile
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import openpyxl
from golden.circuits import CONTACTS, FILM, MODULES, PER_LINE, RESPONSES, SHAPES, Rows, scenes
from golden.estimates import COURSE
from scipy.io import savemat

import lampest as lp
from lampest.apps.foreign import lines as foreign_lines
from lampest.apps.studies import bench, extreme_scenes, tradeoff
from lampest.files.errors import InputError
from lampest.report.info import understood_lines
from lampest.runs import executors

# Foreign files

VALUES = np.random.default_rng(7).uniform(250, 600, (4, 2, 3)).round(1)
SEVERAL = np.random.default_rng(3).integers(300, 800, (4, 2, 3)).astype(float)


def frames_text(
    line: Callable[[int, int, int], str] | None = None, title: str = "", comma: str = ","
) -> str:
    """The values as a line a row of the panel, or as a line a value.

    A line a value is by a function of frame, row and column.
    """
    texts = []
    for number, frame in enumerate(VALUES):
        texts += [title.format(number, 1.5 * number)] if title else []
        for row, values in enumerate(frame):
            if line is None:
                texts.append(comma.join(map(str, values)))
            else:
                texts += [f"{line(number, row, column)}{values[column]}" for column in range(3)]
    return "\n".join(texts) + "\n"


def timed_lines(*times: object, name: str = "time") -> str:
    return f"{name},a,b,c,d,e,f\n" + "".join(
        f"{time},{','.join(map(str, VALUES[k % 4].ravel()))}\n" for k, time in enumerate(times)
    )


def named_rows(name: str, first: int = 0, header: str = "") -> str:
    """Lines that begin with the name of a row of the panel."""
    lines = (
        f"{name.format(row + first)},{','.join(map(str, frame[row]))}"
        for frame in VALUES
        for row in range(2)
    )
    return "\n".join([*filter(None, [header]), *lines]) + "\n"


TEXTS: dict[str, str] = {
    "rows by names": named_rows("R{}", 1),
    "rows labelled": named_rows("ROW{}=").replace("=,", "="),
    "rows by numbers": named_rows("{}", header="row,c3,c1,c2"),
    "no such row": named_rows("R{}", 4),
    "columns as rows": named_rows("col {}"),
    "rows by columns' names": named_rows("{}", header="row,r1,r2,r3"),
    "titled blocks": frames_text(title="Frame {0}, t = {1} s"),
    "plain titles": frames_text(title="Frame"),
    "columns from two": (
        "ch2,ch3,ch4,ch5,ch6,ch7\n300,301,302,303,304,305\n400,401,402,403,404,405\n"
    ),
    "counted columns": timed_lines(5, 6).replace("time,a,b,c,d,e,f", "frame,0,1,2,3,4,5"),
    "two titles": frames_text(title="Frame {0}, t = {1} s\nlast scan t = 7 s"),
    "blocks by numbers": frames_text(title="{0}"),
    "stamped titles": frames_text(title="2025-01-31 12:00:0{0}"),
    "another first title": frames_text(title="Frame {0}, t = {1} s").replace("Frame 0,", "Start:"),
    "titles and blank lines": "\n"
    + frames_text(title="\nframe {0}\n\n").replace("frame 2", "#\nframe 2"),
    "braces": frames_text(title="{{").replace("\n", "},\n"),
    "cut block": frames_text(title="next").replace("next", "", 1).lstrip("\n").split("\n", 1)[1],
    "lost row": re.sub(r"(.*next\n.*\n).*\n", r"\1", frames_text(title="next"), count=1),
    "noise between": frames_text(title="frame {0}").replace("frame 2", "overrun!\nframe 2"),
    "long block": "a\n" + frames_text(title="b") + "1,2,3\n" * 3,
    "single values": frames_text(lambda f, j, k: f"{j + 1},{k + 1},"),
    "four numbers": re.sub(
        r"(.*) (.*)\n", r"\1\n", frames_text(lambda f, j, k: f"{j} {k} {300 + f + j} {f} ")
    ),
    "values in time": "t [ms],row,col,R\n" + frames_text(lambda f, j, k: f"{100 * f},{j},{k},"),
    "every value's time": "t,r,c,ohm\n"
    + frames_text(lambda f, j, k: f"{f + j / 9 + k / 99:.4f},{j},{k},"),
    "cells by name": "cell,frame,kohm\n" + frames_text(lambda f, j, k: f"R{j}C{k},{f},"),
    "cells by number": "sensor,frame,value\n"
    + frames_text(lambda f, j, k: f"{3 * j + k + 1},{f},"),
    "twice": "row,column,value\n" + frames_text(lambda f, j, k: f"{j},{k},"),
    "no index": "row,column,value\n0,0.5,3\n",
    "beyond": "row,column,value\n0,3,400\n1,4,300\n",
    "columns by number": "ch0,ch1,ch2,ch3,ch4,ch5\n"
    + frames_text().replace("\n", ",", 1).replace("\n", ",", 0),
    "other columns": "note,r0c0,r0c1,r1c0,T,humidity\nx,300,310,320,20,40\ny,301,311,321,21,41\n",
    "same names": "r0c0,r0c0,r0c1\n1,2,3\n",
    "beyond names": "r0c0,r2c1,r1c0\n1,2,3\n",
    "too many fields": "1,2,3,4,5\n1,2,3,4,5\n",
    "to transpose": "300,310\n320,330\n340,350\n",
    "empty end": timed_lines(1, 2, name="x").replace("\n", ",,\n").replace("f,", "f,note"),
    "empty column": "a,,b,c\n1,,400,300\n2,,410,310\n",
    "longer line": "300,310,320\n330,340,350\n1,2,3,4\n300,310,320\n",
    "word": "300,310,320\n330,huh,350\n",
    "words": "300,OL,#N/A\n330,ovf,-\n300,310,320\n330,1e9,350\n",
    "no values": "# nothing\n\n",
    "header alone": "a,b,c\n",
    "cut end": frames_text()[:-3],
    "cut line": frames_text().rstrip("\n").rsplit(",", 1)[0],
    "cut begin": frames_text()[8:],
    "header again": "a,b,c\n" + frames_text() + "a,b,c\n1,2,3\n4,5,6\n",
    "quotes": '"300,1";"310,2";"320,3"\n"330";"340";"350"\n',
    "open quote": '"300,310,320\n330,340,350\n',
    "tabs": frames_text(comma="\t"),
    "thousands": '"1,300.5";"310";"320"\n"330";"340";"2,350"\n',
    "terminal": "".join(
        f"12:34:5{k}.25 -> {line}\n" for k, line in enumerate(frames_text().split("\n")[:-1])
    ),
    "counter": "".join(
        f"{k},{','.join(map(str, frame.ravel()))}\n" for k, frame in enumerate(VALUES)
    ),
}
TIMES: dict[str, tuple[str, dict[str, Any]]] = {
    "s": (timed_lines(0.5, 1.0, 2.5), {}),
    "min": (timed_lines(1, 2, 4, name="t (min)"), {}),
    "tens": (timed_lines(10, 30, 50), {}),
    "thousands": (timed_lines(1e4, 3e4, 5e4), {}),
    "millis around": (timed_lines(4294967000, 4294967200, 104, 304, name="millis"), {}),
    "micros around": (timed_lines(4294900000, 32704, 132704, name="micros"), {}),
    "ms since 1970": (timed_lines(*(1738324800000 + 250 * k for k in range(3))), {}),
    "s since 1970": (timed_lines(*(1738324800 + n / 2 for n in range(3))), {}),
    "local": (timed_lines("2025-01-31T12:00:00.5", "2025-01-31T12:00:02.5"), {}),
    "unit of none": (timed_lines("2025-01-01", "2025-01-02"), {"time_unit": "ms"}),
    "unit without times": (frames_text(), {"time_unit": "ms"}),
    "soon": (timed_lines("2025-01-01", "soon"), {}),
    "ns since 1970": (timed_lines(*(1738324800000000000 + 250000000 * k for k in range(3))), {}),
    "midnight": (timed_lines("23:59:58", "23:59:59.5", "00:00:01", "0:00:03"), {}),
    "noon": (timed_lines("11:59:58 AM", "12:00:01 PM", "1:00:01 pm"), {}),
    "dates": (timed_lines("31.01.2025 12:00:00", "31.01.2025 12:00:02", "1.02.2025 00:00"), {}),
    "american": (timed_lines("1/31/2025 12:00", "1/31/2025 12:01", "2/1/2025 12:00"), {}),
    "either": (timed_lines("1/2/2025 12:00", "1/3/2025 12:00"), {}),
    "zone": (timed_lines("2025-01-31T12:00:00Z", "2025-01-31T14:00:01+01:00"), {}),
    "two columns": (
        timed_lines("2025-01-31,12:00:00.5", "2025-01-31,12:00:01.5", name="date,time"),
        {},
    ),
    "one cut": (timed_lines(*range(7), 3, *range(8, 14)), {}),
    "cut stamp": (timed_lines(*range(9), "", 10), {}),
    "cut word": (timed_lines(*range(9), "4x", *range(10, 14)), {}),
    "back": (timed_lines(3, 2, 1), {}),
    "no time": (timed_lines("huh", "2025", "x"), {}),
    "given": (
        timed_lines(100, 350, 720),
        {"time_unit": "us"},
    ),
    "given for dates": (timed_lines("12:00:00", "12:00:01"), {"time_unit": "ms"}),
    "period": (timed_lines(3, 2, 1), {"period": 0.25}),
    "refused": (
        timed_lines(1, 2) + "3,1,2,,4,5,6\n",
        {
            "missing": "refuse",
        },
    ),
    "skipped": (
        timed_lines(1, 2, 3) + "4,1,2,,4,5,6\n",
        {"missing": "skip-frame", "baseline_frames": 2},
    ),
    "layout": (frames_text(lambda f, j, k: f"{k},{f},{j},"), {"layout": "column,frame,row,value"}),
    "short layout": (
        frames_text(lambda f, j, k: f"{k},{f},{j},"),
        {"layout": "column,frame,value"},
    ),
    "transposed": ("300,310\n320,330\n340,350\n", {"transpose": True}),
}
HEADERS = (
    "R [kOhm]",
    "U [V]",
    "adc",
    "volt",
    "mV",
    "pressure [kPa]",
    "Time;R (Ohm)",
    "r0c0 (mV)",
    "x_ohm",
    "R [Mohm]",
)


def imported(name: str, content: str | bytes, **options: Any) -> Any:
    """Return the content of a file as read, or the reason of a refusal."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_anew(path, **options)


def read_anew(path: Path, **options: Any) -> Any:
    try:
        recording, notes = lp.import_file(path, *(() if "scene" in options else (2, 3)), **options)
    except InputError as error:
        return str(error).replace(f"{path.parent}/", "")
    lines = [line.replace(f"{path.parent}/", "") for line in understood_lines(recording, notes)]
    return [recording.recorded, recording.time, recording.role, recording.start_time, lines]


def brief(result: Any) -> Any:
    """Some readings of an import with the unit's sentence."""
    return (
        result
        if isinstance(result, str)
        else [result[0][0], [line for line in result[4] if "unit" in line]]
    )


def units_row() -> dict[str, Any]:
    """Codes of a converter in every unit, with few and many digits, and the imported unit."""
    known = SEVERAL.reshape(-1, 2, 3)
    rows = {}
    for name, readout in {
        "ohm": lp.TwoPointReadout(readings=2),
        "sensor": lp.TwoPointReadout(measured_across="sensor", readings=1),
        "volt": lp.LoadedColumnsReadout(readings=1),
        "fine": lp.TwoPointReadout(adc_bits=12, readings=64),
    }.items():
        scene = lp.Scene(lp.Panel(2, 3), readout)
        volt = readout.volt_from_code(known * 2.0 ** (readout.adc_bits - 10))
        forms = {
            "code": known,
            "volt": volt,
            "mV": 1e3 * volt,
            "less": 1e-3 * volt,
            "floating": volt * 1.0123,
        }
        if readout.unit == "ohm":
            ohm = readout.recorded_from_volt(volt)
            forms |= {
                "ohm": ohm,
                "kohm": ohm / 1e3,
                "Mohm": ohm / 1e9,
                "negative": -ohm,
                "few": ohm[:1],
            }
        for unit, values in forms.items():
            for digits in (0, 3, 7):
                text = "\n".join(
                    ",".join(f"{x:.{digits}f}" for x in frame.ravel()) for frame in values
                )
                rows[f"{unit} {name} {digits}"] = brief(imported("m.csv", text, scene=scene))
            for word in ("kohm", "volt", "mV", "code", "V"):
                rows[f"{unit} {name} as {word}"] = brief(
                    imported("m.csv", text, scene=scene, unit=word)
                )
    for header in HEADERS:
        text = ",".join([header, *"bcdef"]) + "\n" + "3,4,5,6,7,8\n" * 2
        rows[header] = [
            imported("m.csv", text),
            imported("m.csv", text, scene=lp.Scene(lp.Panel(2, 3), readout)),
        ]
    return rows | {
        size: imported("m.csv", f"{size}," * 5 + size)
        for size in ("0.3", "3", "30", "nan", "0", "inf")
    }


def arrays_row() -> dict[str, Any]:
    """Arrays of NumPy and MATLAB in every order of axes, and sheets."""
    flat = VALUES.reshape(4, 6)
    stacked = VALUES.transpose(1, 2, 0)
    times = np.arange(4) / 4
    holds: dict[str, dict[str, Any]] = {
        "frames": {"R": VALUES},
        "flat": {"R": flat},
        "stacked": {"R": stacked},
        "one": {"R": VALUES[0]},
        "times": {"R": VALUES, "t": times, "n": np.arange(3)},
        "two": {"a": VALUES, "b": VALUES},
        "none": {
            "x": np.arange(5.0),
        },
        "turned": {"R": VALUES.swapaxes(1, 2)},
        "texts": {"R": VALUES.astype("f4"), "who": np.array(["me"])},
        "bytes": {"R": VALUES.astype("u2"), "z": 1j * VALUES},
    }
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arrays in holds.items():
            path = Path(folder) / name
            np.savez(path.with_suffix(".npz"), **arrays)
            savemat(path.with_suffix(".mat"), arrays, do_compression=name != "flat")
            np.save(path.with_suffix(".npy"), arrays.get("R", times))
            for suffix in (".npz", ".mat", ".npy"):
                rows[name + suffix] = read_anew(path.with_suffix(suffix))
        rows["b"] = read_anew(Path(folder) / "two.npz", variable="b")
        rows["c"] = read_anew(Path(folder) / "two.mat", variable="c")
        rows["by rows"] = read_anew(Path(folder) / "turned.npz", transpose=True)
        book = openpyxl.Workbook()
        book.active.append(["made by me"])
        for title, lines in {
            "panel": flat,
            "log": [["x", 3.5], [None, 4]],
            "again": flat[:, ::-1],
        }.items():
            sheet = book.create_sheet(title)
            for line in lines:
                sheet.append(
                    [value if isinstance(value, str | None) else float(value) for value in line]
                )
        book.save(Path(folder) / "m.xlsx")
        rows |= {
            f"sheet {word}": read_anew(Path(folder) / "m.xlsx", variable=word)
            for word in ("panel", "log", None)
        }
        for cells in ((0, 1, 2, 3), (0, 1, 3, 5)):
            listed = tuple((n // 3, n % 3, 9.0 * n, 0.0) for n in cells)
            np.savetxt(Path(folder) / "l.csv", flat[:, :4], delimiter=",")
            rows[f"listed {cells}"] = read_anew(
                Path(folder) / "l.csv", scene=lp.Scene(lp.Panel(2, 3, cells=listed))
            )
    text = frames_text()
    with patch.object(foreign_lines, "MAX_FIELDS", 5):
        rows |= {
            f"many lines by {end!r}": imported("m.csv", text.replace("\n", end))
            for end in ("\n", "\r", "\r\n")
        }
    for name, content in {
        "utf-16": text.encode("utf-16"),
        "latin": "300,é".encode("latin1"),
        "zero": b"1,\0",
    }.items():
        rows[name] = imported("m.csv", content)
    return rows


def python_row() -> dict[str, Any]:
    """Arrays in Python in every unit, and why others are none."""
    rows: dict[str, Any] = {}
    scenes_of = {"none": None, "ohm": lp.TwoPointReadout(), "volt": lp.LoadedColumnsReadout()}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.yaml").write_text(
            "panel: {rows: 2, columns: 3}\nreadout: {kind: two_point}\n"
        )
        for (name, readout), (unit, scale), (way, options) in product(
            scenes_of.items(), SCALES.items(), HOW.items()
        ):
            scene = readout and lp.Scene(lp.Panel(2, 3), readout)
            known = {"values": scale * VALUES.round(), "unit": unit, "scene": scene} | options
            known["scene"] = (
                Path(folder) / "scene.yaml" if known["scene"] == "file" else known["scene"]
            )
            try:
                result = lp.Recording.from_array(**known)
                rows[f"{name} {unit} {way}"] = [
                    result.recorded[0],
                    result.time,
                    result.role,
                    result.scene.panel.rows,
                ]
            except InputError as error:
                rows[f"{name} {unit} {way}"] = str(error)
    return rows


SCALES = {"ohm": 1.0, "kohm": 1e-3, "volt": 5e-3, "mV": 5.0, "code": 1.0, "V": 1.0}
HOW: dict[str, dict[str, Any]] = {
    "alone": {},
    "two unloaded": {"baseline": 2},
    "five unloaded": {"baseline": 5},
    "times": {"time": [0, 1, 2, 4]},
    "two times": {"time": [0, 1]},
    "one frame": {"values": VALUES[0]},
    "one row": {"values": VALUES[:, :1]},
    "a word": {"values": "m.csv"},
    "a list": {"values": VALUES.tolist()},
    "scene of a file": {"scene": "file"},
}

# Ranges

DECADES = 10.0 ** np.arange(-12, 14)
PROBES = (*-DECADES[::-1], 0.0, *DECADES, np.nan, np.inf)


def configurations() -> dict[str, Any]:
    """One of every public configuration with numbers, by name."""
    public = {name: getattr(lp, name) for name in lp.__all__}
    known: dict[str, Any] = {}
    for name, kind in public.items():
        if hasattr(kind, "__pydantic_config__"):
            try:
                known[name] = kind()
            except (TypeError, ValueError):  # what has no default stands below
                continue
    examples = (
        lp.Huber(corner=3.0),
        lp.Student(corner=3.0),
        lp.Panel(3, 4),
        *SHAPES.values(),
        *RESPONSES.values(),
        FILM,
        lp.Temperature(-0.003, 20.0, 8.0),
        lp.Water(9.0),
        COURSE,
        CONTACTS,
        PER_LINE,
        MODULES.modules,
        lp.Simulation(1, 2, scenes()["noisy"]),
        lp.Scene(lp.Panel(2, 3)),
        executors.Processes(),
        executors.Dask(),
        bench.BenchFile(1, (3,)),
        extreme_scenes.Grid((3,)),
        tradeoff.TradeoffFile(1, ("a.h5",)),
    )
    return known | {type(example).__name__: example for example in examples}


def ranges_row(owner: Any) -> dict[str, Any]:
    """Which powers of ten each number of a configuration may be, and why not others."""
    rows = {}
    for field in fields(owner):
        if field.name == "own":  # keys of installed packages
            continue
        if field.init:
            signs = ""
            reasons = list[str]()
            for value in PROBES:
                number = int(value) if np.isfinite(value) and value == round(value) else value
                given = getattr(owner, field.name)
                try:
                    replace(
                        owner,
                        **{
                            field.name: (number, *given[1:]) if isinstance(given, tuple) else number
                        },
                    )
                    signs += "+"
                except (TypeError, ValueError, InputError, OverflowError) as error:
                    signs += "-"
                    reasons.append(re.sub(r"[^ ]*\d[^ ]*", "#", str(error)).split("\n")[0])
            rows[field.name] = [signs, list(dict.fromkeys(reasons))]
    return rows


def of_inputs() -> Rows:
    return (
        {f"text {name}": partial(imported, "m.csv", text) for name, text in TEXTS.items()}
        | {
            f"time {name}": partial(imported, "m.csv", text, **options)
            for name, (text, options) in TIMES.items()
        }
        | {f"range {name}": partial(ranges_row, owner) for name, owner in configurations().items()}
        | {"units": units_row, "arrays in Python": python_row, "arrays and sheets": arrays_row}
    )
