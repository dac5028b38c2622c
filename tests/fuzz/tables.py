"""A grammar of tables as boards and tools print them, with damages, and the truth beside.

The module holds no test. A layout writes frames as lines with their place, a damage changes lines;
an import is right if every frame that it returns is a true frame, or has readings missing.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from lampest import InputError, LoadedColumnsReadout, Panel, Scene, import_file

Rng = np.random.Generator
Array = np.ndarray


@dataclass(frozen=True)
class Line:
    """Line of a table.

    Attributes
    ----------
    text : str
    frame : int
        Frame of its readings; -1 for a title.
    """

    text: str
    frame: int = -1


@dataclass(frozen=True)
class Table:
    """Table with its truth.

    Attributes
    ----------
    name : str
        Layout and damage.
    text : str
    codes : array, shape (frames, rows, columns)
    """

    name: str
    text: str
    codes: Array


def codes(rng: Rng, least: int = 3, most: int = 8) -> Array:
    """Readings of a panel whose cells differ, with so many lines a side, under a moving load."""
    rows, columns = (int(rng.integers(least, most + 1)) for _ in range(2))
    frames = int(rng.integers(12, 30))
    resting = rng.integers(300, 800, (rows, columns))
    row, column = np.indices((rows, columns))
    values = np.tile(resting, (frames, 1, 1)) + rng.integers(-2, 3, (frames, rows, columns))
    for number in range(3, frames):
        distance = (row - rows * number / frames) ** 2 + (column - columns / 2) ** 2
        values[number] -= np.round(150 * np.exp(-distance / 2)).astype(int)
    return values


def _joined(values: Array, sign: str) -> str:
    return sign.join(map(str, np.ravel(values)))


# Layouts: (readings, generator) → lines, and whether their keys say where frames begin.


def frame_lines(values: Array, rng: Rng) -> Iterator[Line]:
    sign = str(rng.choice([",", ";", "\t", " "]))
    before = str(rng.choice(["number", "time", "both", "iso"]))
    for number, frame in enumerate(values):
        keys = {
            "number": f"{number + 1}{sign}",
            "time": f"{40 * number + 17}{sign}",
            "both": f"{number % 256}{sign}{40 * number + 17}{sign}",
            "iso": f"2025-03-01T12:00:{number / 25:09.6f}{sign}",
        }
        yield Line(keys[before] + _joined(frame, sign), number)


def bare_frames(values: Array, rng: Rng) -> Iterator[Line]:
    form = str(rng.choice(["{}", "[{}]", "{},"]))
    for number, frame in enumerate(values):
        yield Line(form.format(_joined(frame, ",")), number)


def frames_of_parted_rows(values: Array, rng: Rng) -> Iterator[Line]:
    sign, between = ((",", ";"), (" ", "; "), (" ", " | "))[rng.integers(3)]
    form = str(rng.choice(["{}", "[{}]"]))
    for number, frame in enumerate(values):
        yield Line(form.format(between.join(_joined(row, sign) for row in frame)), number)


def json_lines(values: Array, rng: Rng) -> Iterator[Line]:
    key = str(rng.choice(["data", "matrix", "payload"]))
    nested = bool(rng.integers(2))
    for number, frame in enumerate(values):
        listed = frame.tolist() if nested else frame.ravel().tolist()
        yield Line(f'{{"seq": {number}, "t": {40 * number}, "{key}": {listed}}}', number)


def plotter_lines(values: Array, rng: Rng) -> Iterator[Line]:
    sign = str(rng.choice([",", "\t", " "]))
    for number, frame in enumerate(values):
        cells = (f"r{r}c{c}:{frame[r, c]}" for r, c in np.ndindex(frame.shape))
        yield Line(sign.join(cells), number)


def esp_lines(values: Array, rng: Rng) -> Iterator[Line]:
    zephyr = bool(rng.integers(2))
    for number, frame in enumerate(values):
        ms = 312 + 40 * number
        prefix = f"[00:00:{ms // 1000:02d}.{ms % 1000:03d},125] <inf> mat: "
        yield Line((prefix if zephyr else f"I ({ms}) mat: ") + _joined(frame, ","), number)


def named_rows(values: Array, rng: Rng) -> Iterator[Line]:
    form = str(rng.choice(["R{}:", "row {} = ", "ROW{}=", "r{},"]))
    order = list(range(values.shape[1]))[:: int(rng.choice([1, -1]))]
    for number, frame in enumerate(values):
        for row in order:
            yield Line(form.format(row) + _joined(frame[row], ","), number)


def numbered_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """A frame's number, which may wrap, or one time for all rows of a frame, before each row."""
    sign = str(rng.choice([",", "\t", ";"]))
    key = str(rng.choice(["number", "wrap", "time"]))
    first = int(rng.integers(0, 250))
    if rng.integers(2):
        columns = (f"c{column}" for column in range(values.shape[2]))
        yield Line(sign.join(["time_ms" if key == "time" else "frame", "row", *columns]))
    for number, frame in enumerate(values):
        keys = {"number": first + number, "wrap": (250 + number) % 256, "time": 40 * number + 1000}
        for row, line in enumerate(frame):
            yield Line(sign.join([str(keys[key]), str(row), _joined(line, sign)]), number)


def unnamed_rows_in_time(values: Array, rng: Rng) -> Iterator[Line]:
    """Rows without names, with one time or number for all rows of a frame."""
    sign = str(rng.choice([",", ";"]))
    header = [str(rng.choice(["frame", "time_ms"]))]
    step = 1 if header == ["frame"] else 40
    yield Line(sign.join([*header, *(f"c{column}" for column in range(values.shape[2]))]))
    for number, frame in enumerate(values):
        for line in frame:
            yield Line(f"{step * number}{sign}{_joined(line, sign)}", number)


def blocks(values: Array, rng: Rng) -> Iterator[Line]:
    title = str(rng.choice(["", "---", "Frame {}:", "----- MATRIX -----", "t = {} ms"]))
    sign = str(rng.choice([",", "\t", " "]))
    for number, frame in enumerate(values):
        yield Line(title.format(40 * number))
        for line in frame:
            yield Line(_joined(line, sign), number)


def single_values(values: Array, rng: Rng) -> Iterator[Line]:
    key = str(rng.choice(["frame", "time", "none", "cell", "teleplot"]))
    first = int(rng.integers(0, 2))
    heads = {"frame": "frame,row,col,adc", "time": "time_ms,row,col,adc", "none": "row,col,adc"}
    if key in heads:
        yield Line(heads[key])
    for number, frame in enumerate(values):
        for r, c in np.ndindex(frame.shape):
            yield Line(
                {
                    "frame": f"{number},{r + first},{c + first},{frame[r, c]}",
                    "time": f"{40 * number},{r + first},{c + first},{frame[r, c]}",
                    "none": f"{r + first},{c + first},{frame[r, c]}",
                    "cell": f"r{r}c{c}:{frame[r, c]}",
                    "teleplot": f">r{r}c{c}:{1735725600000 + 40 * number}:{frame[r, c]}",
                }[key],
                number,
            )


def numbered_cells(values: Array, rng: Rng) -> Iterator[Line]:
    """A line for each cell with its number, from 0 or 1."""
    form = str(rng.choice(["{c},{v}", "{c}: {v}", "S{c}={v}", "Sensor {c}: {v}", "{t};{c};{v}"]))
    first = int(rng.integers(0, 2))
    for number, frame in enumerate(values):
        for cell, code in enumerate(frame.ravel().tolist()):
            yield Line(form.format(t=40 * number, c=cell + first, v=code), number)


def timed_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """Named rows, each with a time of its own."""
    rows = values.shape[1]
    for number, frame in enumerate(values):
        for row, line in enumerate(frame):
            ms = 3 * row + (3 * rows + 20) * number
            yield Line(
                f"12:00:{ms // 1000:02d}.{ms % 1000:03d} -> R{row}: {_joined(line, ' ')}", number
            )


def json_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """An object of JSON for each row."""
    key = str(rng.choice(["", "frame", "t"]))
    for number, frame in enumerate(values):
        own = {"": {}, "frame": {"frame": number}, "t": {"t": 40 * number}}[key]
        for row, line in enumerate(frame.tolist()):
            yield Line(json.dumps({**own, "row": row, "data": line}), number)


def json_cells(values: Array, rng: Rng) -> Iterator[Line]:
    key = str(rng.choice(["", "frame", "t"]))
    for number, frame in enumerate(values):
        own = {"": {}, "frame": {"frame": number}, "t": {"t": 40 * number}}[key]
        for row, column in np.ndindex(frame.shape):
            value = int(frame[row, column])
            yield Line(json.dumps({**own, "row": row, "col": column, "value": value}), number)


def prefixed_frames(values: Array, rng: Rng) -> Iterator[Line]:
    """A word and the frame's number before its readings."""
    sign = ","
    form = str(rng.choice(["$MAT,{},", "MAT:{},", "DATA,{},"]))
    for number, frame in enumerate(values):
        yield Line(form.format(number) + _joined(frame, sign), number)


def bracketed_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """Matrices as Python and NumPy print them; brackets say where a frame begins."""
    sign = str(rng.choice([", ", " "]))
    for number, frame in enumerate(values):
        for row, line in enumerate(frame):
            end = "]]" if row == len(frame) - 1 else f"]{sign.strip()}"
            yield Line(f"{' [' if row else '[['}{_joined(line, sign)}{end}", number)


def bracketed_cells(values: Array, rng: Rng) -> Iterator[Line]:
    for number, frame in enumerate(values):
        for row, column in np.ndindex(frame.shape):
            yield Line(f"[{row}][{column}] = {frame[row, column]}", number)


def words_of_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """Frame and row as words, of which the frame's number wraps."""
    wrap = int(rng.choice([16, 100, 256]))
    for number, frame in enumerate(values):
        for row, line in enumerate(frame):
            yield Line(f"F{(number + wrap - 5) % wrap} R{row} {_joined(line, ' ')}", number)


def stamped_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """A terminal's time, the same before all rows of a frame."""
    named = bool(rng.integers(2))
    for number, frame in enumerate(values):
        stamp = f"[2025-01-31 12:34:{number // 25:02d}.{40 * (number % 25):03d}] "
        for row, line in enumerate(frame):
            yield Line(stamp + named * f"R{row}: " + _joined(line, ","), number)


def paused_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """Rows with a time each, and a pause between frames."""
    rows = values.shape[1]
    for number, frame in enumerate(values):
        for row, line in enumerate(frame):
            yield Line(f"{5 + 2 * row + number * (2 * rows + 30)},{_joined(line, ',')}", number)


def frames_with_a_header(values: Array, rng: Rng) -> Iterator[Line]:
    form = str(rng.choice(["r{}c{}", "R{}C{}", "cell_{}_{}"]))
    first = int(rng.integers(2))
    key = str(rng.choice(["time_s", "frame", "timestamp"]))
    names = (form.format(row + first, at + first) for row, at in np.ndindex(values.shape[1:]))
    yield Line(",".join([key, *names]))
    for number, frame in enumerate(values):
        keys = {
            "time_s": f"{number * 0.04:.3f}",
            "frame": str(number),
            "timestamp": f"2025-01-31T12:34:{number / 25:09.6f}Z",
        }
        yield Line(f"{keys[key]},{_joined(frame, ',')}", number)


def bare_rows(values: Array, rng: Rng) -> Iterator[Line]:
    """Rows between which nothing stands."""
    sign = str(rng.choice([",", "\t"]))
    for number, frame in enumerate(values):
        for line in frame:
            yield Line(_joined(line, sign), number)


LAYOUTS: dict[str, Callable[[Array, Rng], Iterator[Line]]] = {
    layout.__name__: layout
    for layout in (
        frame_lines,
        bare_frames,
        frames_of_parted_rows,
        json_lines,
        plotter_lines,
        esp_lines,
        named_rows,
        numbered_rows,
        unnamed_rows_in_time,
        blocks,
        single_values,
        numbered_cells,
        timed_rows,
        json_rows,
        json_cells,
        prefixed_frames,
        bracketed_rows,
        bracketed_cells,
        words_of_rows,
        stamped_rows,
        paused_rows,
        frames_with_a_header,
    )
}

# Of these nothing says which row a line is.
UNNAMED = (
    "unnamed_rows_in_time",
    "blocks",
    "bracketed_rows",
    "stamped_rows",
    "paused_rows",
)

# Damages: (lines, generator) → lines.


def whole(lines: list[Line], rng: Rng) -> list[Line]:
    return lines


def begun_within(lines: list[Line], rng: Rng) -> list[Line]:
    return lines[int(rng.integers(1, len(lines) // 3)) :]


def ended_within(lines: list[Line], rng: Rng) -> list[Line]:
    return lines[: -int(rng.integers(1, len(lines) // 3))]


def lost_line(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.integers(2, len(lines) - 2))
    return [*lines[:at], *lines[at + 1 :]]


def lost_lines(lines: list[Line], rng: Rng) -> list[Line]:
    """Several lines lost across the end of a frame, fewer than a frame has."""
    ends = [at for at, (line, after) in enumerate(pairwise(lines)) if after.frame != line.frame]
    end = int(rng.choice(ends[2:-2])) + 1
    size = max(2, sum(line.frame == 3 for line in lines))
    count = int(rng.integers(1, size))
    begin = max(end - int(rng.integers(0, count + 1)), 1)
    return [*lines[:begin], *lines[begin + count :]]


def doubled_line(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.integers(2, len(lines) - 2))
    return [*lines[:at], lines[at], *lines[at:]]


def swapped_lines(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.integers(2, len(lines) - 2))
    return [*lines[:at], lines[at + 1], lines[at], *lines[at + 2 :]]


def lost_field(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.choice([at for at, line in enumerate(lines) if line.frame > 0]))
    sign = next((sign for sign in (";", "\t", ",", " ") if sign in lines[at].text), ",")
    fields = lines[at].text.split(sign)
    del fields[int(rng.integers(0, len(fields)))]
    return [*lines[:at], Line(sign.join(fields), lines[at].frame), *lines[at + 1 :]]


def lost_end(lines: list[Line], rng: Rng) -> list[Line]:
    """The end of a line is lost, so that the next one follows it directly."""
    at = int(rng.choice([at for at, line in enumerate(lines[:-1]) if line.frame > 0]))
    joined = Line(lines[at].text + lines[at + 1].text, lines[at].frame)
    return [*lines[:at], joined, *lines[at + 2 :]]


def broken_line(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.choice([at for at, line in enumerate(lines) if line.frame > 0]))
    text = lines[at].text
    cut = int(rng.integers(1, len(text)))
    parts = [Line(part, lines[at].frame) for part in (text[:cut], text[cut:])]
    return [*lines[:at], *parts, *lines[at + 1 :]]


def garbled_sign(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.choice([at for at, line in enumerate(lines) if line.frame > 0]))
    text = lines[at].text
    cut = int(rng.integers(0, len(text)))
    garbled = text[:cut] + str(rng.choice(list("x?Zq#\x07\x1b"))) + text[cut + 1 :]
    return [*lines[:at], Line(garbled, lines[at].frame), *lines[at + 1 :]]


def line_of_the_firmware(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.integers(2, len(lines) - 2))
    words = ["WiFi reconnect 192.168.1.5", "heap: 12345", "E (1234) wifi: lost", "loop 40 ms"]
    return [*lines[:at], Line(str(rng.choice(words))), *lines[at:]]


def doubled_field(lines: list[Line], rng: Rng) -> list[Line]:
    at = int(rng.choice([at for at, line in enumerate(lines) if line.frame > 0]))
    sign = next((sign for sign in (";", "\t", ",", " ") if sign in lines[at].text), ",")
    fields = lines[at].text.split(sign)
    field = int(rng.integers(0, len(fields)))
    fields.insert(field, fields[field])
    return [*lines[:at], Line(sign.join(fields), lines[at].frame), *lines[at + 1 :]]


def cut_end(lines: list[Line], rng: Rng) -> list[Line]:
    """The file ends within a line."""
    last = max(at for at, line in enumerate(lines) if line.frame >= 0)
    text = lines[last].text
    return [*lines[:last], Line(text[: int(rng.integers(1, len(text)))] + "\0", lines[last].frame)]


def reset(lines: list[Line], rng: Rng) -> list[Line]:
    """The board began again within a frame."""
    last = max(line.frame for line in lines)
    at = int(rng.choice([at for at, line in enumerate(lines) if 0 < line.frame < last]))
    head = [line for line in lines[:1] if line.frame < 0]
    start = next(number for number, line in enumerate(lines) if line.frame == lines[at].frame + 1)
    return [*lines[:at], Line("ets Jun  8 2016 rst:0x1"), *head, *lines[start:]]


def lost_and_doubled_line(lines: list[Line], rng: Rng) -> list[Line]:
    return doubled_line(lost_line(lines, rng), rng)


def row_of_means(lines: list[Line], rng: Rng) -> list[Line]:
    """A row below the table, as a spreadsheet has it."""
    last = max(at for at, line in enumerate(lines) if line.frame >= 0)
    sign = next((sign for sign in (";", "\t", ",", " ") if sign in lines[last].text), ",")
    count = lines[last].text.count(sign)
    word = str(rng.choice(["mean", "average", "Mittelwert"]))
    return [*lines, Line(sign.join([word, *["512.3"] * count]))]


DAMAGES = {
    damage.__name__: damage
    for damage in (
        whole,
        begun_within,
        ended_within,
        lost_line,
        lost_lines,
        doubled_line,
        swapped_lines,
        lost_field,
        lost_end,
        broken_line,
        garbled_sign,
        line_of_the_firmware,
        doubled_field,
        cut_end,
        reset,
        lost_and_doubled_line,
        row_of_means,
    )
}


# Of swapped rows without names, and of frames without numbers and times, nothing tells the order.
WITHOUT_KEYS = ("plotter_lines", "bare_frames", "frames_of_parted_rows")
SILENT = [(layout, "swapped_lines") for layout in (*UNNAMED, *WITHOUT_KEYS)]
# A row that is lost and one that is doubled leave the number of rows in a frame.
SILENT += [(layout, "lost_and_doubled_line") for layout in UNNAMED]


def table(rng: Rng, layouts: Sequence[str] = tuple(LAYOUTS)) -> Table:
    """Return a table of a layout with a damage, both drawn."""
    layout = str(rng.choice(layouts))
    damage = str(rng.choice([name for name in DAMAGES if (layout, name) not in SILENT]))
    values = codes(rng)
    lines = DAMAGES[damage](list(LAYOUTS[layout](values, rng)), rng)
    text = "\n".join(line.text for line in lines)
    text = text[: text.index("\0")] if "\0" in text else f"{text}\n"
    return Table(f"{layout}, {damage}", text, values)


def whole_table(rng: Rng, layout: str) -> Table:
    """Return a table of a layout without a damage."""
    values = codes(rng)
    text = "".join(f"{line.text}\n" for line in LAYOUTS[layout](values, rng))
    return Table(layout, text, values)


def outcome(drawn: Table, folder: Path) -> str:
    """Return 'right', 'missing', 'refused' or what is wrong with the import of a table."""
    path = folder / "m.log"
    path.write_text(drawn.text, encoding="utf-8", newline="")
    shape = drawn.codes.shape[1:]
    readout = LoadedColumnsReadout(load_ohm=10_000.0, supply_volt=5.0, adc_bits=10, readings=1)
    try:
        recording, notes = import_file(path, scene=Scene(Panel(*shape), readout), unit="code")
    except InputError:
        return "refused"
    imported = recording.recorded * 1024 / 5.0
    distance = np.nanmax(np.abs(imported[:, None] - drawn.codes), axis=(2, 3), initial=0.0)
    if np.any(distance.min(axis=1) > 1e-6):
        bad = int(np.argmax(distance.min(axis=1)))
        return f"wrong: frame {bad} of {len(imported)}, {notes}"
    filled = np.isfinite(imported).all(axis=(1, 2))
    order = distance.argmin(axis=1)[filled]
    if np.any(np.diff(order) < 0):
        return f"wrong: order of frames {order.tolist()}"
    whole_file = len(imported) == len(drawn.codes) and filled.all()
    return "right" if whole_file else "missing"
