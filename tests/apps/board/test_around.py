"""Surroundings of the board: missing packages, ports, keys, and costs of its firmware."""

import os
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from apps.board.bench import FIRMWARE, bench, built, random_cells, scene

from lampest import InputError, Recording
from lampest.apps.board import port
from lampest.apps.board.port import pressed_keys
from lampest.apps.board.protocol import BAUD, message
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening
from lampest.apps.board.source import opened_source

README = (FIRMWARE / "README.md").read_text()
OTHER_COMPILER = 0.05  # of a size, relative
CLOCK_ERROR = 2e-2  # of a mean period over 40 frames
# half of the last digit of the table, and relative
ROUNDED_MS = 0.051
ROUNDED_RATE = 0.01
ROWS_OF_TABLE = [
    (int(rows), int(columns), int(readings), float(period_ms), float(rate))
    for rows, columns, readings, period_ms, rate in re.findall(
        r"^\| (\d+) × (\d+) \| (\d+) \| ([\d.]+) \| ([\d.]+) \|", README, re.MULTILINE
    )
]


def test_one_sentence_names_missing_packages(tmp_path: Path) -> None:
    words = ["make", "-s", "-C", str(FIRMWARE), "ARDUINO=/nowhere", f"BUILD={tmp_path / 'build'}"]
    completed = subprocess.run(words, capture_output=True, text=True)
    assert completed.returncode
    first = completed.stderr.splitlines()[0]
    assert first.startswith(
        "firmware: compilers for the board are missing; install them with: apt-get install gcc-avr"
    )
    packages = subprocess.run(
        ["make", "-s", "-C", str(FIRMWARE), "packages"], capture_output=True, text=True
    ).stdout
    assert first.endswith(packages.strip())


def test_a_board_of_another_version_is_named() -> None:
    with opened_source("loop://", BAUD) as line:
        board = port.Board(line, "loop://")
        line.write(message(bytes([9, 1, 0, 0])))
        with pytest.raises(InputError, match="speaks version 9 of the protocol"):
            board.messages()


def test_ports_that_look_like_an_arduino_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    modem = SimpleNamespace(device="/dev/ttyS0", description="modem", vid=None)
    mega = SimpleNamespace(device="/dev/ttyACM0", description="Arduino Mega 2560", vid=0x2341)
    usb_serial = SimpleNamespace(device="/dev/ttyUSB0", description="USB serial", vid=0x1A86)
    for present, url in (
        ([modem, mega], mega.device),
        ([modem], None),
        ([modem, mega, usb_serial], None),
    ):
        monkeypatch.setattr(port.list_ports, "comports", lambda present=present: present)
        assert port.ports()[-1].device == modem.device
        if url:
            assert port.only_port() == url
        else:
            with pytest.raises(InputError, match="name one"):
                port.only_port()


def test_keys_are_read_one_by_one_and_the_terminal_is_restored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without a terminal no key is pressed."""
    import termios

    master, slave = os.openpty()
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
    with os.fdopen(slave) as terminal, Path(os.devnull).open() as null_device:
        monkeypatch.setattr("sys.stdin", terminal)
        original = termios.tcgetattr(slave)
        with pressed_keys() as keys:
            assert keys() == ""
            os.write(master, b"ab")
            assert keys() == "ab"
        assert termios.tcgetattr(slave) == original
        for no_terminal in (null_device, None):
            monkeypatch.setattr("sys.stdin", no_terminal)
            with pressed_keys() as keys:
                assert keys() == ""
    os.close(master)


@pytest.mark.slow
def test_flash_and_memory_match_the_readme() -> None:
    assert len(ROWS_OF_TABLE) >= 8
    built()
    words = ["make", "-s", "-C", str(FIRMWARE), "size"]
    output = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    flash, memory = (int(number) for number in re.findall(r"(\d+) of", output))
    stated = [int(number) for number in re.findall(r"(\d+) of (?:253952|8192)", README)]
    # Another version of the compiler may differ a little; larger differences must be noticed.
    assert stated == pytest.approx([flash, memory], rel=OTHER_COMPILER)
    assert memory < 8192 / 2, "half of the memory stays for the stack"


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "columns", "readings", "period_ms", "rate"), ROWS_OF_TABLE)
def test_a_board_keeps_the_shortest_period_of_the_table(
    tmp_path: Path, rows: int, columns: int, readings: int, period_ms: float, rate: float
) -> None:
    """The board accepts the shortest period of the table, misses no tick and loses no frame."""
    frames = 40
    with bench(
        tmp_path, random_cells(np.random.default_rng(1), 1, rows, columns), "--no-reset-on-open"
    ) as board:
        with opened_source(board.port, BAUD) as line:
            asked = port.Board(line, board.port)
            asked.hello()
            shortest = asked.start(rows, columns, readings, None).shortest_period_us
            asked.stop()
        known = scene(rows, columns, readings)
        summary = record(
            Listening((board.port,), scene=known, period=shortest / 1e6),
            tmp_path / "r.h5",
            frames=frames,
        )
        figures = board.stop()
    recording = Recording.load(tmp_path / "r.h5")
    assert summary.lost == 0 and not recording.acquisition.missed.any()
    np.testing.assert_allclose(np.diff(recording.time).mean(), shortest / 1e6, rtol=CLOCK_ERROR)
    assert figures["longest_scan_us"] < shortest
    assert shortest / 1000 == pytest.approx(period_ms, abs=ROUNDED_MS)
    assert rate == pytest.approx(1e6 / shortest, rel=ROUNDED_RATE)
