"""What stands around the board: the sentence about missing packages, ports, keys, a board behind a network socket."""

import os
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from board.bench import FIRMWARE

from lampest import InputError
from lampest.recording.board import port
from lampest.recording.board.port import pressed_keys
from lampest.recording.board.protocol import message


def test_missing_packages_are_named_in_one_sentence(tmp_path: Path) -> None:
    words = ["make", "-s", "-C", str(FIRMWARE), "ARDUINO=/nowhere", f"BUILD={tmp_path / 'build'}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode
    first = done.stderr.splitlines()[0]
    assert first.startswith("firmware: compilers for the board are missing; install them with: apt-get install gcc-avr")
    packages = subprocess.run(["make", "-s", "-C", str(FIRMWARE), "packages"], capture_output=True, text=True).stdout
    assert first.endswith(packages.strip())


def test_a_board_of_another_version_is_named() -> None:
    with port.Board.open("loop://") as board:
        board._port.write(message(bytes([9, 1, 0, 0])))
        with pytest.raises(InputError, match="speaks version 9 of the protocol"):
            board.messages()


def test_ports_that_look_like_an_arduino_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    modem = SimpleNamespace(device="/dev/ttyS0", description="modem", vid=None)
    mega = SimpleNamespace(device="/dev/ttyACM0", description="Arduino Mega 2560", vid=0x2341)
    other = SimpleNamespace(device="/dev/ttyUSB0", description="USB serial", vid=0x1A86)
    for present, url in (([modem, mega], mega.device), ([modem], None), ([modem, mega, other], None)):
        monkeypatch.setattr(port.list_ports, "comports", lambda present=present: present)
        assert port.ports()[-1].url == modem.device
        if url:
            assert port.only_port() == url
        else:
            with pytest.raises(InputError, match="name one"):
                port.only_port()


def test_keys_are_read_one_by_one_and_the_terminal_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a terminal no key is pressed."""
    import termios

    master, slave = os.openpty()
    monkeypatch.setattr(os, "tcgetpgrp", lambda descriptor: os.getpgrp())
    with os.fdopen(slave) as terminal, Path(os.devnull).open() as nothing:
        monkeypatch.setattr("sys.stdin", terminal)
        before = termios.tcgetattr(slave)
        with pressed_keys() as keys:
            assert keys() == ""
            os.write(master, b"ab")
            assert keys() == "ab"
        assert termios.tcgetattr(slave) == before
        for no_terminal in (nothing, None):
            monkeypatch.setattr("sys.stdin", no_terminal)
            with pressed_keys() as keys:
                assert keys() == ""
    os.close(master)
