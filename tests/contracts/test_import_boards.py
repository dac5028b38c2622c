"""Lines as boards, logs and other tools print them."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contracts.imports import (
    CODES,
    COLUMNS,
    FRAMES,
    LOADED,
    ROWS,
    VOLT_OF_CODES,
    check_refused,
    check_taken,
    foreign_file,
    lines,
)

from lampest import (
    Characteristic,
    InputError,
    LoadedColumnsReadout,
    Panel,
    Scene,
    import_file,
    read_scene,
)

MODULES = "{modules: {rows: 100, columns: 100, each: {rows: 100, columns: 100}}}"
FOUR = range(4)
SECONDS = np.arange(4)
FILES: dict[str, SimpleNamespace] = {}


def codes(title: str, content: Any, *notes: str, **options: Any) -> None:
    FILES[title] = foreign_file(
        content, *notes, **({"scene": LOADED, "expected": VOLT_OF_CODES, "name": "m.log"} | options)
    )


FLAT = lines(CODES)
CELLS = [[f"r{r}c{c}" for r, c in np.ndindex(ROWS, COLUMNS)]] * 4
TELEPLOT = [
    f">r{r}c{c}:{1735725600000 + 40 * n}:{CODES[n, r, c]}" for n, r, c in np.ndindex(CODES.shape)
]
codes("Teleplot", [*TELEPLOT, ""], times=SECONDS / 25, start="2025-01-01T10:00:00Z")
ROWS_OF = ["\n".join(lines(frame, "\t")) for frame in CODES]
ESP = [
    "I (312) cpu_start: Starting scheduler.",
    *(f"I ({400 + 40 * n}) mat: {FLAT[n]}" for n in FOUR),
]
codes("ESP-IDF's log", [*ESP, ""], "the terminal's, s", times=0.4 + SECONDS / 25)
COLOURED = [f"\x1b[0;32mI ({400 + 40 * n}) mat: {FLAT[n]}\x1b[0m" for n in FOUR]
codes("ESP-IDF's log in colours", [*COLOURED, ""], times=0.4 + SECONDS / 25)
ZEPHYR = [f"[00:00:0{n}.500,125] <inf> mat: {FLAT[n]}" for n in FOUR]
codes("Zephyr's log", [*ZEPHYR, ""], times=SECONDS)
ROS = [f"1735725600,{125000000 + 62500000 * n},mat_link,{FLAT[n]}" for n in FOUR]
codes(
    "stamps of ROS in two columns",
    [*ROS, ""],
    "are one time",
    times=SECONDS / 16,
    start="2025-01-01T10:00:00.125000Z",
)
LISTED = [f'{40 * n},"[{FLAT[n]}]"' for n in FOUR]
codes("a list within a cell", [*LISTED, ""], times=SECONDS / 25)
NESTED = [{"t": 40 * n, "data": {"matrix": CODES[n].tolist()}} for n in FOUR]
codes("JSON two levels deep", json.dumps(NESTED), name="m.json", times=SECONDS / 25)
PACKETS = {"device": "mat", "packets": [{"seq": n, "frames": [NESTED[n]]} for n in FOUR]}
codes("packets of frames", json.dumps(PACKETS), name="m.json", times=SECONDS / 25)
codes("JSON in a log", [*map(json.dumps, NESTED), ""], times=SECONDS / 25)
LOST = FLAT[1].split(",")
del LOST[7]
GAP = VOLT_OF_CODES.copy()
GAP[1] = np.nan
codes("a lost field", [FLAT[0], ",".join(LOST), *FLAT[2:], ""], "have not 15 fields", expected=GAP)
LONG = VOLT_OF_CODES.repeat(5, axis=0)
LONG_LINES = [line for line in FLAT for _ in range(5)]
TWENTY = np.arange(20)
WRAPPED = [f"{(248 + n) % 256},{line}" for n, line in enumerate(LONG_LINES)]
codes(
    "one frame a line with a number that wraps", [*WRAPPED, ""], expected=LONG, times=248.0 + TWENTY
)
RESET = [f"{40 * n + (1000 if n < 11 else -140)},{line}" for n, line in enumerate(LONG_LINES)]
codes(
    "a board that resets",
    [*RESET, ""],
    "it begins again at",
    "m.log:12:1, and goes on by its usual step",
    expected=LONG,
    times=1 + TWENTY / 25,
)
LATE = [f"{40 * n + (1000 if n < 19 else 40)},{line}" for n, line in enumerate(LONG_LINES)]
codes(
    "a last time that falls",
    [*LATE[:-1], f"300,{LONG_LINES[-1]}", ""],
    "m.log:20:1 is missing or does not grow",
    expected=LONG,
    times=1 + TWENTY / 25,
)
HEADED = [
    "secs,nsecs," + ",".join(CELLS[0]),
    *(f"{1735725600 + n // 2},{n % 2 * 500_000_000},{FLAT[n]}" for n in FOUR),
]
codes(
    "seconds and nanoseconds by name",
    [*HEADED, ""],
    "secs, nsecs are one time",
    times=SECONDS / 2,
    start="2025-01-01T10:00:00Z",
)
CLEARED = ["\x1b[2J\x1b[H" + rows for rows in ROWS_OF]
codes("a screen that is cleared before each frame", [*CLEARED, ""])
codes("marks of begin and end", [*(f"<{line}>" for line in FLAT), ""])
BARE = [line for frame in CODES for line in lines(frame)]
codes("rows without any mark", [*BARE, ""], "nothing says where a frame begins")
codes(
    "lines that are skipped",
    [*BARE[2:], ""],
    "the first 1 line skipped",
    skip_lines=1,
    expected=VOLT_OF_CODES[1:],
)
MERGED = ["frame,row,c0,c1,c2,c3,c4"] + [
    f"{n if row == 0 else ''},{row},{line}"
    for n in FOUR
    for row, line in enumerate(lines(CODES[n]))
]
codes("merged frame numbers", [*MERGED, ""], name="m.csv")
AUTUMN = [
    "2025-10-26 02:59:58",
    "2025-10-26 02:59:59",
    "2025-10-26 02:00:00",
    "2025-10-26 02:00:01",
]
CHANGED = [
    "time," + ",".join(CELLS[0]),
    *(f"{t},{v}" for t, v in zip(AUTUMN, FLAT, strict=True)),
    "",
]
codes(
    "clocks that are changed",
    CHANGED,
    "clocks were changed",
    times=SECONDS,
    start="2025-10-26T02:59:58",
)
DAYS = ["time," + ",".join(CELLS[0]), *(f"{45658.5 + n / 86400:.9f},{FLAT[n]}" for n in FOUR), ""]
codes("Excel's serial days", DAYS, "Excel's days", start="2025-01-01T12:00:00Z")


@pytest.mark.parametrize("file", FILES.values(), ids=FILES)
def test_lines_of_boards_and_tools_are_understood(file: SimpleNamespace, tmp_path: Path) -> None:
    check_taken(file, tmp_path)


def test_two_boards_in_one_file_are_named(tmp_path: Path) -> None:
    both = [{"id": n % 2, "t": 20 * n, "data": CODES[n // 2].tolist()} for n in range(8)]
    for name in ("m.json", "m.jsonl", "m.log"):
        text = json.dumps(both) if name == "m.json" else "\n".join([*map(json.dumps, both), ""])
        file = foreign_file(text, "takes the values 0, 1 in turn", name=name, scene=LOADED)
        check_refused(file, tmp_path)


def test_one_line_of_packets_in_a_text_file_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "m.log"
    path.write_text(json.dumps(PACKETS) + "\n")
    with pytest.raises(InputError, match="no values"):
        import_file(path, ROWS, COLUMNS, scene=LOADED, unit="code")


def test_a_field_that_nobody_uses_is_named(tmp_path: Path) -> None:
    trials = ["trial," + ",".join(CELLS[0]), *(f"{n // 2},{FLAT[n]}" for n in FOUR), ""]
    (tmp_path / "m.csv").write_text("\n".join(trials))
    _, notes = import_file(tmp_path / "m.csv", scene=LOADED)
    assert any("'trial' is not used and takes 2 values (0, 1)" in note for note in notes)


def test_signed_codes_are_what_they_are(tmp_path: Path) -> None:
    readout = LoadedColumnsReadout(
        load_ohm=10_000.0,
        supply_volt=4.096,
        adc_bits=16,
        readings=1,
        converter=Characteristic(signed=True),
    )
    values = np.round(FRAMES * 20).astype(int)
    values[:, 0] = -4
    (tmp_path / "m.csv").write_text("\n".join([*lines(values), ""]))
    scene = Scene(Panel(ROWS, COLUMNS), readout)
    recorded = import_file(tmp_path / "m.csv", scene=scene)[0].recorded
    np.testing.assert_allclose(recorded, values * 4.096 / 2**15)


@pytest.mark.parametrize("panel", ["{rows: 100000000, columns: 3}", MODULES])
def test_a_panel_of_more_than_a_million_cells_is_refused_at_once(
    tmp_path: Path, panel: str
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"panel: {panel}\n")
    with pytest.raises(InputError, match=r"more than 1000000, the most that are accepted; lampest"):
        read_scene(path)
