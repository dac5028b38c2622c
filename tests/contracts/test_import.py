"""Tables of text as people have them: frames, times and sentences, or a refusal with its place."""

import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contracts import imports
from contracts.imports import (
    CODES,
    COLUMNS,
    DIVIDER,
    FRAMES,
    LOADED,
    ROWS,
    VOLT_OF_CODES,
    foreign_file,
    lines,
    names,
)
from promises import promise

from lampest import LoadedColumnsReadout, TwoPointReadout

WIDE = FRAMES.reshape(4, -1)
FOUR = np.arange(4)
TABLES: dict[str, SimpleNamespace] = {}
REFUSED: dict[str, SimpleNamespace] = {}


def accept(name: str, content: Any, *notes: str, **options: Any) -> None:
    TABLES[name] = foreign_file(content, *notes, **options)


def codes(name: str, content: Any, *notes: str, **options: Any) -> None:
    """Codes of a board with loaded columns."""
    accept(name, content, *notes, **({"scene": LOADED, "expected": VOLT_OF_CODES} | options))


def refuse(name: str, content: Any, *notes: str, **options: Any) -> None:
    REFUSED[name] = foreign_file(content, *notes, **options)


def with_nan(values: np.ndarray, *places: tuple[Any, ...]) -> np.ndarray:
    holes = values.astype(float)
    for place in places:
        holes[place] = np.nan
    return holes


def blocks(sign: str, between: str, frames: np.ndarray = CODES) -> str:
    """A line for each row, and something between frames."""
    return between.join("\n".join(lines(frame, sign)) for frame in frames)


# What a terminal shows of a board.

ARDUINO = "12:34:55.100 -> ,511,600\r\n12:34:55.200 -> Panel 3x5 v1.2 ready\r\n"
ARDUINO += "".join(
    f"12:34:5{6 + number}.789 -> {line},\r\n" for number, line in enumerate(lines(CODES))
)
MONITOR = (
    "it began at 12:34:56.789, the date is not in the file",
    "lines 1, 2 (the first: '511 600')",
    "code, guessed",
)
codes("the Arduino's monitor", ARDUINO, *MONITOR, times=FOUR, rows=None, columns=None)

NAMES_OF_CELLS = names("r{r}c{c}").split(",")
NUMBERED = [
    (number, row, line)
    for number, frame in enumerate(CODES)
    for row, line in enumerate(lines(frame))
]
BLOCKS = {
    "numbers": "\n".join(
        f"{number}\n" + "\n".join(lines(frame, " ")) for number, frame in enumerate(CODES)
    ),
    "every line alone": "\n\n".join("\n\n".join(lines(frame)) for frame in CODES),
    "python lists": "\n".join(f"[{line}]" for frame in CODES for line in lines(frame, ", ")),
    "titles of a chip": "ets Jun  8 2016 00:22:57\n\nentry 0x400805f0\n" + blocks(" ", "\n\n"),
}
for name, text in BLOCKS.items():
    codes(name, text, "one row a line, 3 lines a frame")
for title, times, start in (
    ("Frame {n}, t = {ms} ms", FOUR / 4, None),
    ("time: 2025-01-31 12:00:0{n}Z", FOUR, "2025-01-31T12:00:00Z"),
    ("millis={ms}", FOUR / 4, None),
):
    titled = [
        title.format(n=n, ms=250 * n) + "\n" + "\n".join(lines(frame))
        for n, frame in enumerate(CODES)
    ]
    codes(title, titled, times=times, start=start)
LONG = blocks(",", "\n\n", np.concatenate([CODES, CODES[:, :1]], axis=1))
refuse("long blocks", LONG, "m.csv:1: a block of 4 lines, where the panel has 3 rows", scene=LOADED)

MEANS = CODES + CODES % 20 / 20
STEPS = "as such they lie on the converter's steps"
accept("means of codes", lines(MEANS), STEPS, expected=1024e3 / MEANS - 1000, scene=DIVIDER)
EIGHT = replace(LOADED, readout=replace(LOADED.readout, readings=8))
OF_EIGHT = CODES + CODES % 8 / 8 + 2000
WAYS = {
    "cut digits": [
        [f"{int(100 * value) / 100:.2f}" for value in np.ravel(frame)] for frame in OF_EIGHT
    ],
    "three digits": [[f"{value:.3f}" for value in np.ravel(frame)] for frame in OF_EIGHT],
}
for name, written in WAYS.items():
    rounded = np.array(written, dtype=float).reshape(CODES.shape) * 3.3 / 4096
    accept(
        f"means of eight codes by {name}",
        map(",".join, written),
        "unit code, guessed",
        expected=rounded,
        scene=EIGHT,
    )
    two_point = replace(DIVIDER, readout=TwoPointReadout(supply_volt=3.3, adc_bits=12, readings=8))
    resistances = two_point.readout.recorded_from_volt(rounded)
    accept(
        f"means of a divider by {name}",
        map(",".join, written),
        "unit code, guessed: ",
        expected=resistances,
        scene=two_point,
    )
    ways = (
        "may be mV or code (codes would be whole numbers, by the scene); say which with `unit='mV'`"
    )
    refuse(
        f"means of eight codes by {name} where readings is 1",
        map(",".join, written),
        ways,
        scene=LOADED,
    )
FILTERED = CODES * 0.937 + 0.013
refuse("filtered codes of a divider", lines(FILTERED), "may be ohm or", "mV or code", scene=DIVIDER)
MILLIVOLTS = np.round(CODES * 5000 / 1024)
FIVE_VOLT = replace(
    LOADED,
    readout=LoadedColumnsReadout(load_ohm=10_000.0, supply_volt=5.0, adc_bits=10, readings=1),
)
for name, written in (("rounded", MILLIVOLTS), ("cut", CODES * 5000 // 1023)):
    accept(
        f"{name} millivolts",
        lines(written),
        "unit mV, guessed",
        expected=written / 1000,
        scene=FIVE_VOLT,
    )
accept(
    "whole numbers",
    lines(CODES),
    "whole numbers, within 0 to 4095",
    "whole mV would look alike",
    scene=LOADED,
    expected=VOLT_OF_CODES,
)
WHOLE = "may be ohm or code, the whole numbers of a converter, which need a scene; say which with"
refuse("whole numbers without a scene", lines(CODES), WHOLE)
refuse("resistances of either size", lines(FRAMES / 10), "may be ohm or kohm; say which with")
accept(
    "small kiloohms",
    lines(FRAMES / 1000),
    "kohm, guessed: values from 0.2",
    "too small for ohm",
    expected=FRAMES,
)
PRESSED = CODES * (CODES > 500)
refuse(
    "pressures without a scene",
    lines(PRESSED),
    "of them are 0, as in pressures or codes; a resistance of 0 is a short",
)
for unit in ("%", "N", "kPa", "mmHg", "a.u.", "g", "µS", "1/kOhm", "MOhm", "degC"):
    for header in (f"r{{r}}c{{c}} [{unit}]", f"R{{r}}C{{c}} ({unit})"):
        refuse(
            f"{header} as unit",
            [names(header), *lines(WIDE)],
            f"says '{unit}'" if unit in ("N", "kPa", "mmHg", "g") else f"unit '{unit}'",
        )
        accept(
            f"{header} overridden",
            [names(header), *lines(WIDE)],
            "unit ohm, as specified",
            unit="ohm",
        )
for header in ("pressure_r{r}c{c}", "r{r}c{c}_kpa", "Force R{r}C{c}"):
    refuse(header, [names(header), *lines(WIDE)], "readings must be ohm, kohm, volt, mV or code")
for beside in ("Average Pressure (mmHg)", "peak [kPa]"):
    pressures = [
        f"time,{beside},{names('r{r}c{c}')}",
        *(f"{n},7,{line}" for n, line in enumerate(lines(WIDE))),
    ]
    refuse(f"{beside} beside the cells", pressures, "readings must be ohm, kohm, volt, mV or code")
refuse("a title of pressures", ["Pressure (mmHg)", *lines(WIDE)], "the header says 'mmHg'")
for stated in (
    "Peak: 118 mmHg",
    "Mean pressure (mmHg),12.3",
    "Peak,118,mmHg",
    "# all below 200 mmHg",
):
    refuse(
        f"whole pressures with {stated}",
        [stated, *lines(CODES)],
        "the header says 'mmHg'",
        scene=LOADED,
    )
    refuse(
        f"whole pressures before {stated}",
        [*lines(CODES), stated],
        "the header says 'mmHg'",
        scene=LOADED,
    )
    codes(
        f"codes, as specified, with {stated}", [stated, *lines(CODES)], "as specified", unit="code"
    )
accept(
    "temperatures beside resistances",
    [f"{names('r{r}c{c} [ohm]')},T [degC]", *(f"{line},21" for line in lines(WIDE))],
)
RAILS = "no other unit is within the converter's rails"
accept(
    "resistances far above the reference",
    lines(1000 * FRAMES),
    RAILS,
    expected=1000 * FRAMES,
    scene=DIVIDER,
)

TEN = VOLT_OF_CODES[np.arange(10) % 4]


def debugged(separator: str, debug: str) -> list[str]:
    """Ten frames with a line of a sketch's own within the third and the seventh."""
    frames = [lines(CODES[number % 4]) for number in range(10)]
    for number in (2, 6):
        frames[number].insert(1, debug)
    titles = (separator.format(n=number, ms=100 * number) for number in range(10))
    return "\n".join(
        title + "\n".join(frame) for title, frame in zip(titles, frames, strict=True)
    ).split("\n")


FREE_HEAP = "DEBUG: free heap 23456 bytes"
for separator, debug in itertools.product(
    ("Frame {n} t={ms} ms\n", "t = {ms} ms\n", "\n", ""),
    (FREE_HEAP, "wifi: rssi -61", "# note", "42 overruns 7 8 9 1 2 3"),
):
    skipped = ["skipped between rows: line 11, line 28"] * (
        "Frame" in separator and debug == FREE_HEAP
    )
    times = 0.1 * np.arange(10) if "ms" in separator else None
    name = f"{debug} between rows after {separator!r}"
    codes(name, debugged(separator, debug), *skipped, expected=TEN, times=times)
LOST_DEBUG = debugged("Frame {n} t={ms} ms\n", "DEBUG: 1")
del LOST_DEBUG[LOST_DEBUG.index("Frame 4 t=400 ms") + 2]
SENTENCE = "has 2 of 3 lines and is missing"
codes(
    "a row that was lost",
    LOST_DEBUG,
    SENTENCE,
    expected=with_nan(TEN, (4,)),
    times=0.1 * np.arange(10),
)

# Fields beside the readings.

TABS = [
    "\t\t".join([str(600 + n), str(row), *line.split(",")]) + "\t\t" for n, row, line in NUMBERED
]
codes("two tabs between fields", TABS, "empty columns left out", "field 1 frame, field 2 row")
for between in ("\n", "\n\n"):
    before_each = blocks("\t", between).replace("\n", "\n\t").replace("\n\t\n", "\n\n")
    codes(
        f"a tab before each value, {between!r} between frames",
        "\t" + before_each,
        "a separator before the first value of every line",
    )
ALIGNED = [
    "\t".join(f"{value}\t" if int(value) < 500 else value for value in line.split(","))
    for line in lines(CODES)
]
codes("columns aligned by tabs", ALIGNED, "separated by one or more tabs", "one frame a line")
for sign in ("\t", ",", " ", "   ", ";"):
    plain = [sign.join([str(600 + n), str(row), *line.split(",")]) for n, row, line in NUMBERED]
    codes(
        f"frame and row before the values: {sign!r}",
        plain,
        "no header: field 1 frame, field 2 row",
        absent="transpose",
    )
LOST_ROWS = [line for number, line in enumerate(plain) if number not in (1, 2, 3)]
codes(
    "lost rows beside frame and row",
    LOST_ROWS,
    "the first frame (line 1) is cut and left out",
    expected=with_nan(VOLT_OF_CODES[1:], (0, 0)),
)
for first, second, times, noted in (
    ("HH,MM,SS", "12,59,{s}", FOUR, "HH, MM, SS are one time"),
    ("hour,minute,second,ms", "23,59,5{s},250", FOUR, "hour, minute, second, ms are one time"),
    ("Hour,Min,Sec", "7,5,1{s}.5", FOUR, "are one time"),
    (
        "year,month,day,hour,minute,second",
        "2025,1,31,12,0,{s}",
        FOUR,
        "year, month, day are one date",
    ),
):
    clocked = [f"{second.format(s=n)},{line}" for n, line in enumerate(lines(CODES))]
    start = "2025-01-31T12:00:00.000000" if "year" in first else None
    head = ",".join([first, *NAMES_OF_CELLS])
    codes(f"columns {first}", [head, *clocked], noted, times=times, start=start)
for lead, noted, times in (
    ("12,59,{s}", "hour, minute, second are one time", FOUR),
    ("{n},12,59,{s}", "no header: field 1 frame", FOUR),
    ("7,{ms}", "field 1 left out", FOUR / 4),
    ("DATA,{ms}", "field 1 left out", FOUR / 4),
    ("{n},{ms}", "field 1 frame, field 2 time", FOUR / 4),
):
    led = [
        f"{lead.format(s=n, n=n + 100, ms=250 * n)},{line}" for n, line in enumerate(lines(CODES))
    ]
    codes(f"{lead} before a frame", led, noted, "one frame a line, cells row by row", times=times)
    marked = [f"{line},255" for line in led]
    codes(
        f"{lead} before a frame, and a mark", marked, "left out: beside the readings", times=times
    )
for end in ("255", "END", "*", "-1"):
    ended = [f"{line},{end}" for line in lines(CODES)]
    codes(
        f"{end} at the end of a frame",
        ended,
        "field 16 left out: beside the readings",
        "one frame a line",
    )
    rows_ended = [f"{line},{end}" for frame in CODES for line in lines(frame)]
    codes(
        f"{end} at the end of a row",
        rows_ended,
        "field 6 left out",
        "one row a line, 3 lines a frame",
    )
RISING = np.arange(60).reshape(4, 3, 5) / 10 + 50
accept(
    "readings that rise from field to field and from line to line",
    lines(RISING),
    expected=RISING,
    unit="ohm",
)
# matsense (PyPI) writes the values, the frame's number and the microseconds since 1970.
FLOATS = [f"{line.replace(',', '.0,')}.0" for line in lines(CODES)]
MATSENSE = [f"{line},{7 + n},{1738324800000000 + 40_000 * n}" for n, line in enumerate(FLOATS)]
START = "2025-01-31T12:00:00Z"
codes(
    "a recording of matsense",
    MATSENSE,
    "field 16 frame, field 17 time",
    times=FOUR / 25,
    start=START,
)
TIMED_ROWS = [f"{line},{0.5 * n:.1f}" for n, row, line in NUMBERED]
codes(
    "a time at the end of each row",
    TIMED_ROWS,
    "no header: field 6 time",
    "one row a line",
    times=FOUR / 2,
)
NUMBERS = [str(value) for value in CODES.ravel()]
codes(
    "one number a line, of which some lack",
    NUMBERS[:-4],
    "the last frame (line 46) is cut and left out",
    expected=VOLT_OF_CODES[:3],
)
TITLED = [
    text
    for n, frame in enumerate(CODES)
    for text in (f"Frame {n}: t = {250 * n} ms", *map(str, frame.ravel()))
]
codes("one number a line below titles", TITLED, "one number a line", times=FOUR / 4)
refuse(
    "too few numbers",
    NUMBERS[:7],
    ":1: 1 field; 3 × 5 cells need 15",
    "`layout` says what each field is",
    scene=LOADED,
)

WORDS_BEFORE = "Frame,Timestamp,Average,Range Max"
for first in (0, 1):
    counted = ",".join(str(number + first) for number in range(15))
    measured = [
        f"{n},2024-09-26T15:15:0{n}.01-05:00,104.2,260,{line}"
        for n, line in enumerate(lines(CODES))
    ]
    start = "2024-09-26T15:15:00.01-05:00"
    sentence = f"cells by their numbers from {first}"
    codes(
        f"words and numbers from {first}",
        [f"{WORDS_BEFORE},{counted}", *measured],
        sentence,
        times=FOUR,
        start=start,
    )
for title in (
    " Frame Index: {n}, Measurement Time(sec): 0.{ms}",
    "Time [ms]: {ms}, n: {n}",
    "# Elapsed (us) = {ms}000",
    "Frame {n} time: {ms} msec",
    "Sample {n} at time=0.{ms} sec",
):
    titled = [
        title.format(n=n, ms=250 * n + 100) + "\n" + "\n".join(lines(CODES[n])) for n in range(4)
    ]
    if "0." in title:
        titled = [
            text.replace(f"0.{250 * n + 100}", f"{0.1 + n / 4:.3f}", 1)
            for n, text in enumerate(titled)
        ]
    codes(f"blocks below {title}", titled, "before each block", times=0.1 + FOUR / 4)
for title in (
    "Measurement Time(sec),0.{ms},,,",
    "Frame {n} @ {ms} ms",
    "Measurement Time(sec): 0,{ms}",
):
    sign = ";" if "0,{ms}" in title else ","
    titled = [
        title.format(n=n, ms=200 * n + 100) + "\n" + "\n".join(lines(CODES[n], sign))
        for n in range(4)
    ]
    codes(f"blocks below {title}", titled, "before each block", times=0.1 + FOUR / 5)
CLOCKED = [f"Time: 12:00:0{n}.5\n" + "\n".join(lines(CODES[n])) for n in range(4)]
codes("blocks below times of day", CLOCKED, "time of day", times=FOUR)

# Bytes that are no text.

LOG = [list(line) for line in lines(np.tile(CODES, (5, 1, 1)))]
FIVE = np.tile(VOLT_OF_CODES, (5, 1, 1))
for bad in (b"\xff", b"\x80", b"\0", b"\xc3"):
    content = bytearray("\n".join("".join(line) for line in LOG).encode())
    place = content.index(b"\n", 200) + 2  # the second digit of a line
    content[place : place + 1] = bad
    number = content[:place].count(b"\n")
    gap = f"bytes that are no text: their fields in line {number + 1} are missing"
    codes(f"{bad!r} in a serial log", bytes(content), gap, expected=with_nan(FIVE, (number, 0, 0)))
    comma = content.index(b",", place)
    content[place : place + 1] = b"5"
    content[comma : comma + 1] = bad
    codes(
        f"{bad!r} in place of a comma",
        bytes(content),
        gap,
        expected=with_nan(FIVE, (number, 0, [0, 1])),
    )
MUTED = "Zeit (s);" + ";".join(f"Fühler {n}" for n in range(15))
WINDOWS = "\n".join(
    [MUTED, *(f"0,{n};" + line for n, line in enumerate(lines(CODES, ";")))]
).encode("cp1252")
codes("words of Windows-1252", WINDOWS, "Windows-1252", "column 'Zeit (s)' in s", times=FOUR / 10)

# Columns that a layout skips.

SKIPPED_COLUMNS = ",".join(["-", *["-", "-"], *NAMES_OF_CELLS])
NUMBERS_BEFORE = [f"a,{n},7,{line}" for n, line in enumerate(lines(CODES))]
codes(
    "skipped columns",
    NUMBERS_BEFORE,
    "fields 1, 2, 3 left out, as `layout` says",
    layout=SKIPPED_COLUMNS,
    absent="left out: -",
)
ROW_LAYOUT = [f"x,{line},{n}" for n, row, line in NUMBERED]
codes("skipped columns beside rows", ROW_LAYOUT, "one row a line", layout="-,c0,c1,c2,c3,c4,-")

# Clocks: the header, the field of each frame, its times in s, and the date and time at 0 s.

NOON = "2025-01-31T12:00:00"
for header, fields, times, start in (
    ("t (min)", (1, 2, 4), (60, 120, 240), None),
    ("time", (10, 30, 50), (0.01, 0.03, 0.05), None),
    ("time", (10_000, 30_000, 50_000), (0.01, 0.03, 0.05), None),
    ("millis", (4294967000, 4294967200, 104), (4294967, 4294967.2, 4294967.4), None),
    ("micros", (4294900000, 32704, 132704), (4294.9, 4295, 4295.1), None),
    ("time", [1738324800 + n / 2 for n in range(3)], (0, 0.5, 1), f"{NOON}Z"),
    ("time", [1738324800000 + 250 * n for n in range(3)], (0, 0.25, 0.5), f"{NOON}Z"),
    ("time", ("23:59:58", "23:59:59.5", "0:00:03"), (0, 1.5, 5), None),
    ("time", ("11:59:58 AM", "12:00:01 PM", "1:00:01 pm"), (0, 3, 3603), None),
    (
        "time",
        ("31.01.2025 12:00:00", "31.01.2025 12:00:02", "1.02.2025 00:00"),
        (0, 2, 43200),
        NOON,
    ),
    ("time", ("1/31/2025 12:00", "1/31/2025 12:01", "2/1/2025 12:00"), (0, 60, 86400), NOON),
    ("time", (f"{NOON}Z", "2025-01-31T14:00:01+01:00"), (0, 3601), f"{NOON}Z"),
    ("date,time", ("2025-01-31,12:00:00.5", "2025-01-31,12:00:01.5"), (0, 1), f"{NOON}.5"),
    ("time", (*range(9), "4x", *range(10, 14)), range(14), None),
):
    text = [f"{header},{','.join('a' * 15)}"]
    text += [f"{field},{line}" for field, line in zip(fields, lines(WIDE) * 4, strict=False)]
    expected = FRAMES[np.arange(len(fields)) % 4]
    accept(f"{header} of {fields[0]}", text, expected=expected, times=times, start=start)
for fields, sentence, options in (
    (("1/2/2025 12:00", "1/3/2025 12:00"), "may be day/month/year or month/day/year", {}),
    (("2025-01-01", "soon"), "3:1: 'soon' is no time", {}),
    ((3, 2, 1), "3:1: times must be finite and grow; `period` sets them instead", {}),
    (("12:00:00", "12:00:01"), "is no number, so that it has no time unit ms", {"time_unit": "ms"}),
):
    text = [f"time,{','.join('a' * 15)}"]
    text += [f"{field},{line}" for field, line in zip(fields, lines(WIDE), strict=False)]
    refuse(f"a time of {fields[0]}", text, sentence, **options)
MICROSECONDS = [f"{100 * n},{line}" for n, line in enumerate(lines(WIDE))]
accept("times in µs", MICROSECONDS, "in us (as specified)", times=FOUR / 1e4, time_unit="us")
refuse("no time", lines(WIDE), "holds no times that could be in ms", time_unit="ms")
NAMED_ROWS = ["row,r0,r1,r2,r3,r4", *(f"{row},{line}" for _, row, line in NUMBERED)]
refuse("columns called as rows", NAMED_ROWS, "the header's 'r0' names a row; `transpose` swaps")
refuse("cells called alike", [names("r0c{c}"), *lines(WIDE)], "'r0c0' and 'r0c0' are the same cell")
refuse("an open quotation mark", ['"300,310', *lines(WIDE)], "a quotation mark that is not closed")
refuse("a short layout", lines(WIDE), "15 columns, but `layout` names 3", layout="column,frame,ohm")
OPEN = np.maximum(2 * CODES - 1350, 0)
codes("codes of open cells", [*lines(OPEN), ""], "most are 0", expected=OPEN * 3.3 / 4096)
STAMPS = [f"2025-01-31 12:00:0{n};{line}" for n, line in enumerate(lines(FRAMES, ";"))]
accept("stamps without a header", STAMPS, times=FOUR, start=NOON)
codes("volts", [names("r{r}c{c} V"), *lines(VOLT_OF_CODES.reshape(4, -1))])
OWN_TIMES = [
    f"{0.5 * f + r / 9 + c / 99},{r},{c},{FRAMES[f, r, c]}" for f, r, c in np.ndindex(4, 3, 5)
]
accept("a time for every value", ["t,r,c,ohm", *OWN_TIMES], times=FOUR / 2)

# Headers.

NAMED = names("r{r}c{c}").split(",")
ORDER = np.random.default_rng(3).permutation(ROWS * COLUMNS)
for pattern, first in (
    ("r{r}c{c}", 0),
    ("R{r}C{c}", 1),
    ("row {r} col {c}", 0),
    ("c{c}_r{r}", 0),
    ("Z{r}S{c}", 1),
    ("cell_{r}_{c}", 1),
    ("[{r}][{c}]", 0),
    ("x{c}y{r}", 0),
    ("Row{r} / Column{c}", 1),
    ("adc r{r} c{c}", 0),
    ("R{r}C{c} [ohm]", 1),
):
    header = ",".join(np.array(names(pattern, first).split(","))[ORDER])
    sentence = f"cells by their names, which count from {first}"
    accept(f"cells called {pattern}", [header, *lines(WIDE[:, ORDER])], sentence, unit="ohm")
TURNED = [names("r{c}c{r}"), *lines(FRAMES)]
FEWER_CELLS = [names("r{r}c{c}").removesuffix(",r2c4"), *lines(WIDE[:, :14])]
PANDAS = [
    ",".join(["frame", *map(str, range(15))]),
    *(f"{n},{line}" for n, line in enumerate(lines(FRAMES))),
]
accept("names of a transposed panel", TURNED, transpose=True)
accept(
    "a cell without a column",
    FEWER_CELLS,
    "1 cell without a column, missing",
    expected=with_nan(FRAMES, (slice(None), 2, 4)),
)
accept("a data frame", PANDAS, "left out: frame", times=FOUR)
UNITS_BELOW = [
    ",".join(np.array(NAMED)[ORDER]),
    ",".join(["kOhm"] * 15),
    *lines(WIDE[:, ORDER] / 1000),
]
accept(
    "units below the names", UNITS_BELOW, "line 2 taken as header, with the names of the line above"
)
UNNAMED = [",".join(map(str, range(15))), *lines(WIDE)]
accept(
    "a data frame without its index",
    UNNAMED,
    "line 1 taken as header",
    "cells by their numbers from 0, row by row",
)
accept(
    "readings that count",
    lines(np.arange(60).reshape(4, 15)),
    expected=np.arange(60).reshape(CODES.shape),
    unit="ohm",
)
for title in ("Resistance (kOhm)", "# all values in kΩ", "Unit: kOhm"):
    accept(
        title,
        [title, "# 10 ohm in series", *lines(WIDE)],
        "unit kohm, as the header says",
        expected=1000 * FRAMES,
    )
CLOCKS = [
    "time,millis," + ",".join(NAMED),
    *(f"12:00:0{n},{7 * n},{line}" for n, line in enumerate(lines(WIDE))),
]
accept("two clocks, of which the first counts", CLOCKS, "column 'time'", times=FOUR)
TWO_DIGITS = [",".join(np.array(names("R{r}{c}", 1).split(","))[ORDER]), *lines(WIDE[:, ORDER])]
accept(
    "cells of two digits",
    TWO_DIGITS,
    "by their numbers from 11, a digit for the row and one for the column",
)
accept(
    "unknown names",
    [names("{c}.{r}V"), *lines(WIDE)],
    "row by row; '0.0V' and the other names tell no cells",
    unit="ohm",
)
for first in (0, 1):
    header = "," + ",".join(f"c{column + first}" for column in range(COLUMNS)[::-1])
    text = "\n\n".join(
        "\n".join([header, *(f"r{row + first},{lines(frame[:, ::-1])[row]}" for row in (1, 2, 0))])
        for frame in FRAMES
    )
    accept(
        f"named rows and columns from {first}",
        f"{text}\n",
        f"rows by their names, columns by their names from {first}",
    )
    turned = text.replace("r", "?").replace("c", "r").replace("?", "c")
    refuse(f"named rows and columns from {first}, transposed", turned, "`transpose` swaps")

for first, name in enumerate(("ch0", "ch1")):
    header = ",".join(f"ch{first + number}" for number in range(15))
    sentence = f"cells by their numbers from {first}, row by row"
    accept(f"columns from {name}", [header, *lines(WIDE)], sentence)

for header, pattern, ohm in (
    ("cell,frame,kohm", "R{r}C{c}", 1000),
    ("sensor,frame,value", "{n}", 1),
):
    text = [header]
    for f, r, c in np.ndindex(FRAMES.shape):
        cell = pattern.format(r=r, c=c, n=COLUMNS * r + c + 1)
        text.append(f"{cell},{f},{FRAMES[f, r, c]}")
    accept(header, text, "one value a line as cell, frame, value", expected=ohm * FRAMES)
SHUFFLED = ["row,c3,c1,c2,c5,c4"]
SHUFFLED += [
    f"{row},{line}" for frame in FRAMES for row, line in enumerate(lines(frame[:, [2, 0, 1, 4, 3]]))
]
accept("rows by numbers", SHUFFLED, "a new frame begins where a row comes again")

SPREADSHEET = ["% exported on Monday", "Zeit [ms];" + names("Z{r}S{c} [kΩ]", 1, ";") + ";"]
SPREADSHEET += [f"{250 * n};{line};" for n, line in enumerate(lines(FRAMES / 1000, ";", ","))]
for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le"):
    text = "\r\n".join([*SPREADSHEET, ";" * 17, ""]).encode(encoding)
    sentences = ("unit kohm, as the header says", "decimal commas")
    accept(f"a spreadsheet in {encoding}", text, *sentences, times=FOUR / 4)
EXPORTED = "\ufeff# exported\r\n\r\n" + "\r\n".join(lines(FRAMES, ";", ","))
accept("decimal commas without a header", EXPORTED, "decimal commas")
for written, number in (
    ("1.234,5", 1234.5),
    ('"1,234.5"', 1234.5),
    ("1234,5", 1234.5),
    ("1.2345e3", 1234.5),
    ("12.345.678,5", 12345678.5),
):
    separated = lines(FRAMES, ";", "," if written.endswith(",5") else ".")
    expected = np.concatenate([FRAMES, FRAMES[:1]])
    expected[4, 0, 0] = number
    text = [*separated, separated[0].replace(separated[0].split(";")[0], written, 1)]
    accept(f"thousands as {written}", text, expected=expected)

# Single values.


def long_table(frames: np.ndarray, first: int = 0, swap: bool = False) -> np.ndarray:
    """A line of row, column, value and frame for each value."""
    frame, *places = np.indices(frames.shape).reshape(3, -1)
    row, column = (place + first for place in (places[::-1] if swap else places))
    return np.column_stack([row, column, frames.ravel(), frame])


for first, swap in itertools.product((0, 1), (False, True)):
    shuffled = np.random.default_rng(1).permutation(long_table(FRAMES, first, swap=swap))
    accept(
        f"values from {first}, {swap}",
        lines(shuffled),
        f"indices count from {first}",
        transpose=swap,
    )
    single = ["Resistance [ohm],Col,ROW", *lines(long_table(FRAMES[:1], first)[:, 2::-1])]
    accept(f"values of a frame from {first}", single, expected=FRAMES[:1])
REPEATED_TABLE = lines(np.delete(long_table(FRAMES)[:, :3], 22, axis=0))
SENTENCE = "a new frame begins where a cell comes again"
# The cells behind a lost one may be of the next frame.
BEHIND_THE_LOST = (1, [1, 1, 1, 2, 2, 2, 2, 2], [2, 3, 4, 0, 1, 2, 3, 4])
accept(
    "single values without frames",
    REPEATED_TABLE,
    SENTENCE,
    "has 7 of 15 lines",
    expected=with_nan(FRAMES, BEHIND_THE_LOST),
)
SPARE = np.column_stack([WIDE[:, :7], np.zeros(4), WIDE[:, 7:]])
OWN_ORDER = lines(long_table(FRAMES)[:, [3, 2, 0, 1]])
SENTENCE = "one value a line as frame, value, row, column"
accept("values in a layout of one's own", OWN_ORDER, SENTENCE, layout="frame, ohm, row, column")
accept(
    "frames in a layout of one's own", lines(SPARE), layout=",".join([*NAMED[:7], "-", *NAMED[7:]])
)
for header, line, times in (
    ("millis,row,col,R [ohm]", "{ms},{r},{c},{v}", FOUR / 10),
    ("timestamp;Zeile;Spalte;Widerstand", "2025-01-31 12:00:00,{f};R{r};C{c};{v}", FOUR / 10),
    ("scan\trow\tcolumn\tresistance_ohm", "{f}\t{r1}\t{c1}\t{v}", FOUR),
    ("time,r,c,v", "{s},{r},{c},{v}", FOUR / 10),
):
    text = [header]
    for f, r, c in np.ndindex(FRAMES.shape):
        fields = {"f": f, "ms": 100 * f, "s": f / 10, "r": r, "c": c, "r1": r + 1, "c1": c + 1}
        text.append(line.format(v=FRAMES[f, r, c], **fields))
    start = "2025-01-31T12:00:00.0" if "2025" in line else None
    accept(header, text[:], times=times, start=start)
    del text[1 + 2 * 15 + 7]
    accept(f"{header} without one", text, expected=with_nan(FRAMES, (2, 1, 2)), start=start)
    refuse(
        f"{header} without one", text, "the reading of row 1, column 2 is missing", missing="refuse"
    )

accept(
    "one number a line",
    map(str, CODES.ravel()),
    "one number",
    absent="fields separated",
    expected=CODES,
    unit="ohm",
)

# Panels whose lines have as many fields as single values, and tables that fit after a turn.

SMALL = FRAMES[:, :2, :3]
accept(
    "three columns",
    "\n\n".join("\n".join(lines(frame)) for frame in SMALL),
    expected=SMALL,
    rows=2,
    columns=3,
)
WIDER = lines(np.full((14, 7), 0.5))
refuse(
    "a table of the panel's columns",
    WIDER,
    "7 fields; 7 × 5 cells need",
    "with `transpose` it would",
    rows=7,
)

# Lines of a sketch.

SKETCH = [*[line for frame in lines(FRAMES) for line in (frame, "DEBUG heap ok")] * 5, ""]
SENTENCE = (
    f"left out: lines {', '.join(map(str, range(2, 22, 2)))} and 10 more (the first: 'DEBUG "
    "heap ok')"
)
accept("lines of a sketch between frames", SKETCH, SENTENCE, expected=np.tile(FRAMES, (5, 1, 1)))

# Missing readings.

WORDS = ("ovf", "", "NaN", "-", "----", "null", "OL", "#N/A", "n/a", "-inf", "1.#QNAN")
for word, sign in zip(WORDS, itertools.cycle((",", ";", "\t"))):
    rows = [line.split(sign) for line in lines(FRAMES, sign)]
    rows[1][13] = rows[2][0] = word
    text = [sign.join(fields) for fields in rows]
    name = f"{word!r} between {sign!r}"
    marked = "2 readings missing, in 2 of 4 frames: NaN in the recording"
    accept(name, text, marked, expected=with_nan(FRAMES, (1, 2, 3), (2, 0, 0)), baseline_frames=2)
    how = {
        "expected": FRAMES[[0, 3]],
        "times": [0, 3],
        "role": [0, 1],
        "baseline_frames": 2,
        "missing": "skip-frame",
    }
    sentences = ("these frames are left out", "2 frames of 3 × 5 cells, the first 1 unloaded")
    accept(f"{name} without the frames", text, *sentences, **how)
    refuse(name, text, "m.csv:2:14: the reading of row 2, column 3 is missing", missing="refuse")
INFINITE = FRAMES.copy()
INFINITE[1, 0, 0] = np.inf
accept(
    "infinity in ohm",
    lines(INFINITE),
    "1 reading at or beyond a rail",
    expected=INFINITE,
    scene=DIVIDER,
    unit="ohm",
)
OPEN_CELL = [lines(CODES)[0], "inf," + ",".join(map(str, CODES[1].ravel()[1:])), *lines(CODES[2:])]
codes(
    "infinity in codes", OPEN_CELL, "1 reading missing", expected=with_nan(VOLT_OF_CODES, (1, 0, 0))
)


def lines_with(line: int, field: int, text: str) -> str:
    rows = [list(map(str, frame)) for frame in WIDE]
    rows[line][field] = text
    return "\n".join(map(",".join, [*rows, []]))


REFUSED |= {
    name: foreign_file(text, message, missing="refuse")
    for name, text, message in (
        (
            "two fields",
            "1,2\n3,4\n",
            ":1: 2 fields; 3 × 5 cells need 15, 16 with the time, or 3 or 4 for row, column",
        ),
        ("a number with _", lines_with(1, 3, "1_000"), ":2:4: '1_000' is no number"),
        (
            "a negative reading",
            lines_with(3, 14, "-2"),
            ":4:15: -2 must be a positive resistance in ohm",
        ),
        ("two of 15 cells", "0,0,5\n0,1,6\n", "row 0, column 2 is missing"),
        ("a row beyond", "0,0,5\n3,0,6\n", ":2:1: row 3 is beyond the panel's 0 to 2"),
        ("a negative row", "-1,0,5\n", ":1:1: row -1 is beyond"),
        (
            "one of 15 cells",
            "frame,row,column,value\n4,0,0,5\n",
            "the reading of row 0, column 1 is missing",
        ),
        (
            "equal times",
            ",".join(["1"] * 16) + "\n" + ",".join(["1"] * 16),
            ":2:1: times must be finite and grow",
        ),
    )
}
NEGATIVE = long_table(FRAMES, 1, swap=True)
NEGATIVE[7, 2] = -1
refuse(
    "a negative transposed value",
    lines(NEGATIVE),
    "m.csv:8:3: -1 must be a positive",
    transpose=True,
)
refuse("nothing but gaps", lines(np.full((2, 15), np.nan)), "all readings are missing")
GAPPY = lines(with_nan(FRAMES, (slice(None), 0, 0)))
SENTENCE = "no frame would be left; `missing='mark'` keeps them"
refuse("no frame without a gap", GAPPY, SENTENCE, missing="skip-frame")
SENTENCE = "'drop' is unknown; there are mark, skip-frame, refuse"
refuse("another word for missing", lines(FRAMES), SENTENCE, missing="drop", absent="m.csv")


@promise("README: reads tables, serial logs, Excel")
@pytest.mark.parametrize("file", TABLES.values(), ids=TABLES)
def test_a_table_is_imported_with_its_frames_times_and_notes(
    file: SimpleNamespace, tmp_path: Path
) -> None:
    imports.check_taken(file, tmp_path)


@pytest.mark.parametrize(
    "name",
    (
        "a spreadsheet in utf-8",
        "timestamp;Zeile;Spalte;Widerstand",
        "infinity in codes",
        "a recording of matsense",
    ),
)
def test_an_imported_table_survives_its_file(name: str, tmp_path: Path) -> None:
    """Roles, times with a start, gaps, and a scene with a readout."""
    imports.check_saved(TABLES[name], tmp_path)


@pytest.mark.parametrize("file", REFUSED.values(), ids=REFUSED)
def test_an_unreadable_table_is_refused_with_the_place_of_its_fault(
    file: SimpleNamespace, tmp_path: Path
) -> None:
    imports.check_refused(file, tmp_path)
