"""The board's C and the host's Python say the same."""

import ctypes
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from apps.board.bench import FIRMWARE, built, loaded_scene, scene
from hypothesis import given, settings
from hypothesis import strategies as st

from lampest import InputError
from lampest.apps.board import protocol
from lampest.apps.board.protocol import (
    Answer,
    Estimate,
    Frame,
    Hello,
    Kind,
    Receiver,
    Result,
    command,
    message,
)
from lampest.apps.board.stream import declared_readout, scene_of
from tests.bodies import estimate_body, frame_body, hello_body

EMIT = ctypes.CFUNCTYPE(None, ctypes.c_uint8)
BODIES = st.builds(
    # Around the longest run of COBS.
    lambda before, run, zeros: bytes(before) + b"\x05" * run + bytes(zeros),
    st.integers(0, 10),
    st.integers(240, 270),
    st.integers(0, 3),
)
WIRING = "loaded_columns"
COMMANDS = (
    (Kind.SET_ROWS, 16, Result.DONE, 16),
    (Kind.SET_ROWS, 0, Result.REFUSED_RANGE, 10),
    (Kind.SET_COLUMNS, 17, Result.REFUSED_RANGE, 10),
    (Kind.SET_COLUMNS, 258, Result.REFUSED_RANGE, 10),
    (Kind.SET_READINGS, 64, Result.DONE, 64),
    (Kind.SET_READINGS, 65, Result.REFUSED_RANGE, 20),
    (Kind.SET_PERIOD, 2_000_000, Result.DONE, 2_000_000),
    (Kind.SET_PERIOD, 100_000, Result.REFUSED_TOO_FAST, 1_000_000),
    (Kind.SET_PERIOD, 60_000_001, Result.REFUSED_RANGE, 1_000_000),
    (Kind.SET_SETTLE, 0, Result.DONE, 0),
    (Kind.SET_SETTLE, 30_001, Result.REFUSED_RANGE, 40),
    (Kind.START, 0, Result.DONE, 0),
    (Kind.STOP, 0, Result.DONE, 0),
)


class Settings(ctypes.Structure):
    """lampest_settings_t"""

    _fields_ = [
        *((name, ctypes.c_uint8) for name in ("rows", "columns", "readings", "running")),
        ("settle_us", ctypes.c_uint16),
        ("period_us", ctypes.c_uint32),
        *((name, ctypes.c_uint8) for name in ("estimates", "baseline")),
        ("identity", ctypes.c_uint16),
    ]


class Inbox(ctypes.Structure):
    """lampest_inbox_t"""

    _fields_ = [
        ("bytes", ctypes.c_uint8 * 24),
        ("length", ctypes.c_uint8),
        ("overflow", ctypes.c_uint8),
    ]


@cache
def c(wiring: str = "two_point") -> ctypes.CDLL:
    library = ctypes.CDLL(str(built(wiring) / "libprotocol.so"))
    library.lampest_start_settings.restype = Settings
    for kind, names in (
        (ctypes.c_uint8, ("receive", "command", "hello")),
        (ctypes.c_uint16, ("crc16", "slices", "frame_bytes")),
        (ctypes.c_uint32, ("slice_ticks", "shortest_period_us")),
    ):
        for name in names:
            getattr(library, f"lampest_{name}").restype = kind
    return library


def constants() -> dict[str, int]:
    """Every whole number that the two headers define under the name LAMPEST_..."""
    text = "".join(
        (FIRMWARE / "lampest_board" / name).read_text() for name in ("protocol.h", "pins.h")
    )
    definitions = re.findall(r"^#define LAMPEST_(\w+) (\d+)(?:UL)?\b", text, re.MULTILINE)
    return {name: int(value) for name, value in definitions}


def sent_by_c(body: bytes) -> bytes:
    wire = bytearray()
    room = ctypes.create_string_buffer(body, len(body) + 2)
    c().lampest_send(room, ctypes.c_uint16(len(body)), EMIT(wire.append))
    return bytes(wire)


def answered_by_c(settings: Settings, wire: bytes) -> tuple[protocol.Message, ...]:
    """Return the board's answers to these bytes, as the host reads them."""
    inbox = Inbox()
    messages = []
    for byte in wire:
        length = c().lampest_receive(ctypes.byref(inbox), ctypes.c_uint8(byte))
        if length:
            room = ctypes.create_string_buffer(40)
            size = c().lampest_command(
                ctypes.byref(settings), inbox.bytes, ctypes.c_uint8(length), room
            )
            messages += Receiver().feed(sent_by_c(room.raw[:size]))[1]
    return tuple(messages)


def test_constants_agree_in_c_and_python() -> None:
    header = constants()
    names = ("PROTOCOL_VERSION", "BAUD", "MAX_ROWS", "MAX_COLUMNS", "MAX_READINGS")
    assert [header[name.replace("MAX", "MOST")] for name in names] == [
        getattr(protocol, name) for name in names
    ]
    assert 2 ** header["ADC_BITS"] - 1 == protocol.MAX_CODE
    assert {kind.name: header[kind.name] for kind in Kind} == {
        kind.name: kind.value for kind in Kind
    }
    assert [header[result.name] for result in protocol.RESULT_CODES] == list(range(len(Result)))
    assert [header[f"ACROSS_{across.upper()}"] for across in protocol.ACROSS] == [0, 1]
    assert [header[wiring.upper()] for wiring in protocol.WIRINGS] == [0, 1]
    assert header["MOST_BASELINE"] == protocol.MAX_BASELINE
    assert "monitor_speed = " + str(protocol.BAUD) in (FIRMWARE / "platformio.ini").read_text()


@settings(deadline=None)  # the first example compiles
@given(st.binary(max_size=600) | BODIES)
def test_crc_and_framing_agree_in_c_and_python(body: bytes) -> None:
    crc = 0xFFFF
    for byte in body:
        crc = c().lampest_crc16(ctypes.c_uint16(crc), ctypes.c_uint8(byte))
    assert crc == protocol.crc16(body) and sent_by_c(body) == message(body)
    assert protocol.unstuffed(sent_by_c(body)[1:-1]) == body + protocol.crc16(body).to_bytes(
        2, "big"
    )


def test_hello_agrees_in_c_and_python() -> None:
    header = constants()
    settings = c().lampest_start_settings()
    room = ctypes.create_string_buffer(40)
    size = c().lampest_hello(ctypes.byref(settings), room)
    hello = Hello(
        *(header[f"START_{name}"] for name in ("ROWS", "COLUMNS", "READINGS")),
        *(header[f"MOST_{name}"] for name in ("ROWS", "COLUMNS", "READINGS")),
        (header["FIRMWARE_MAJOR"], header["FIRMWARE_MINOR"]),
        header["START_PERIOD_US"],
        c().lampest_shortest_period_us(ctypes.byref(settings)),
        *(
            header[name]
            for name in ("START_SETTLE_US", "SUPPLY_MILLIVOLT", "REFERENCE_MILLIOHM", "ADC_BITS")
        ),
        *("reference", False),
    )
    assert room.raw[:size] == hello_body(hello)
    assert Receiver().feed(sent_by_c(room.raw[:size]))[1] == (hello,)


@given(
    st.tuples(st.integers(1, 16), st.integers(1, 16), st.integers(1, 64)),
    st.tuples(*(st.integers(0, 2**bits - 1) for bits in (32, 32, 16, 16))),
)
def test_frames_agree_in_c_and_python(
    size: tuple[int, int, int], numbers: tuple[int, int, int, int]
) -> None:
    rows, columns, readings = size
    sequence, device_ms, missed, identity = numbers
    settings = Settings(rows, columns, readings, 1, 40, 1_000_000, 0, 0, identity)
    sums = np.arange(rows * columns, dtype=np.uint16).reshape(rows, columns)
    room = ctypes.create_string_buffer(600)
    c().lampest_frame_header(
        ctypes.byref(settings),
        ctypes.c_uint32(sequence),
        ctypes.c_uint32(device_ms),
        ctypes.c_uint16(missed),
        room,
    )
    assert room.raw[:17] + sums.tobytes() == frame_body(
        Frame(readings, sequence, device_ms, missed, sums, identity=identity)
    )
    longest = c().lampest_frame_bytes(ctypes.byref(settings))
    assert len(sent_by_c(room.raw[:17] + b"\1" * (2 * sums.size))) <= longest


@given(
    st.integers(1, 16),
    st.integers(1, 16),
    st.integers(0, 4),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**16 - 1),
)
def test_estimates_agree_in_c_and_python(
    rows: int, columns: int, outcome: int, sequence: int, identity: int
) -> None:
    settings = Settings(rows, columns, 20, 1, 40, 1_000_000, 0, 0, identity)
    change = np.linspace(-27.5, 20.25, rows * columns, dtype=np.float32).reshape(rows, columns)
    room = ctypes.create_string_buffer(11 + 4 * change.size)
    c().lampest_estimate_header(
        ctypes.byref(settings), ctypes.c_uint32(sequence), ctypes.c_uint8(outcome), room
    )
    for number, value in enumerate(change.ravel()):
        c().lampest_put_f32(ctypes.byref(room, 11 + 4 * number), ctypes.c_float(value))
    assert room.raw == estimate_body(Estimate(outcome, sequence, change, identity))
    assert len(sent_by_c(room.raw)) - 2 <= protocol.MAX_STUFFED


def test_outcomes_are_as_many_in_c_and_python() -> None:
    text = (FIRMWARE / "lampest_estimate" / "lampest_estimate.h").read_text()
    names = re.search(r"typedef enum \{([^}]*)\} lampest_outcome;", text)
    assert len(re.findall(r"^ +LAMPEST_\w+", names[1], re.MULTILINE)) == len(protocol.OUTCOMES)


def test_only_estimating_boards_accept_the_baseline_command() -> None:
    settings = c().lampest_start_settings()
    (answer,) = answered_by_c(settings, command(Kind.SET_BASELINE, 1, 5))
    assert answer == Answer(Kind.SET_BASELINE, 1, Result.REFUSED_UNKNOWN, 0)
    plain = c().lampest_shortest_period_us(ctypes.byref(settings))
    settings.estimates = 1
    for value, result, stored in (
        (5, Result.DONE, 5),
        (256, Result.REFUSED_RANGE, 5),
        (255, Result.DONE, 255),
    ):
        assert answered_by_c(settings, command(Kind.SET_BASELINE, 1, value)) == (
            Answer(Kind.SET_BASELINE, 1, result, stored),
        )
    # It scans, and then sends both messages.
    assert c().lampest_shortest_period_us(ctypes.byref(settings)) > plain + 4 * 100 * 20


@given(st.integers(1, 16), st.integers(1, 16))
def test_the_scan_visits_every_cell_once_row_by_row(rows: int, columns: int) -> None:
    row = ctypes.c_uint8(0)
    column = ctypes.c_uint8(0)
    visited = []
    while row.value < rows:
        visited.append((row.value, column.value))
        c().lampest_scan_next(
            ctypes.byref(row), ctypes.byref(column), ctypes.c_uint8(rows), ctypes.c_uint8(columns)
        )
    assert visited == list(np.ndindex(rows, columns))


@given(st.integers(1000, 60_000_000))
def test_a_period_consists_of_equal_slices_that_the_timer_can_count(period_us: int) -> None:
    slices, ticks = (
        getattr(c(), f"lampest_{name}")(ctypes.c_uint32(period_us))
        for name in ("slices", "slice_ticks")
    )
    assert 1 <= ticks <= 2**16  # of the timer
    # Half a tick of 4 us for every slice.
    assert abs(4 * ticks * slices - period_us) <= 2 * slices + 2


def test_a_board_answers_or_refuses_every_command_and_refuses_most_while_running() -> None:
    for kind, value, result, stored in COMMANDS:
        answers = answered_by_c(c().lampest_start_settings(), command(kind, 9, value))
        assert answers == (Answer(kind, 9, result, stored),)
    settings = c().lampest_start_settings()
    for body, result in (
        ([2, 99, 7, 0, 0, 0, 0], Result.REFUSED_UNKNOWN),
        ([2, Kind.START, 7], Result.REFUSED_UNKNOWN),
        ([1, Kind.START, 7, 0, 0, 0, 0], Result.REFUSED_VERSION),
    ):
        (answer,) = answered_by_c(settings, message(bytes(body)))
        assert (
            answer.result is result
            and answer.tag == (7 if len(body) == 7 else answer.tag)
            and not settings.running
        )
    answered_by_c(settings, command(Kind.START))
    for kind in (Kind.SET_ROWS, Kind.SET_PERIOD, Kind.START):
        assert answered_by_c(settings, command(kind, 1, 5))[0].result is Result.REFUSED_RUNNING
    (hello,) = answered_by_c(settings, command(Kind.IDENTIFY))
    assert isinstance(hello, Hello) and hello.running
    assert answered_by_c(settings, command(Kind.STOP, 2)) == (Answer(Kind.STOP, 2, Result.DONE, 0),)


@given(st.binary(max_size=200))
def test_garbage_never_changes_the_board_and_never_hides_the_next_command(noise: bytes) -> None:
    settings = c().lampest_start_settings()
    original = bytes(settings)
    answers = answered_by_c(settings, noise + b"\0" + command(Kind.IDENTIFY))
    assert bytes(settings) == original
    assert isinstance(answers[-1], Hello)


@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.integers(0, 2**32 - 1) | st.integers(0, 70)), max_size=30
    )
)
def test_no_order_of_commands_leads_out_of_range(orders: list[tuple[int, int]]) -> None:
    settings = c().lampest_start_settings()

    def answer(wire: bytes) -> tuple[protocol.Message, ...]:
        return answered_by_c(settings, wire)

    for kind, value in orders:
        assert (
            len(
                answer(
                    message(
                        bytes([protocol.PROTOCOL_VERSION, kind, 0]) + value.to_bytes(4, "little")
                    )
                )
            )
            == 1
        )
        assert (
            1 <= settings.rows <= 16
            and 1 <= settings.columns <= 16
            and 1 <= settings.readings <= 64
        )
        assert settings.settle_us <= 30_000 and settings.period_us <= 60_000_000
        shortest = c().lampest_shortest_period_us(ctypes.byref(settings))
        assert not settings.running or settings.period_us >= shortest - 4 * c().lampest_slices(
            settings.period_us
        )


def hello() -> Hello:
    """Return the greeting that the board of this wiring sends from its own C."""
    settings = c(WIRING).lampest_start_settings()
    room = ctypes.create_string_buffer(64)
    size = c(WIRING).lampest_hello(ctypes.byref(settings), room)
    (greeting,) = Receiver().feed(message(room.raw[:size]))[1]
    assert isinstance(greeting, Hello) and hello_body(greeting) == room.raw[:size]
    return greeting


def test_differences_between_scene_and_board_are_named() -> None:
    """A calibrated scene fits the board that it was made with."""
    for changes, sentence in (
        ({"driven": "columns"}, "readout.driven is columns, but the board says rows"),
        ({"polarity": "down"}, "readout.polarity is down, but the board says up"),
        ({"supply_volt": 3.3}, "readout.supply_volt is 3.3, but the board says 5 "),
        ({"load_ohm": 1000.0}, "readout.load_ohm is 1000, but the board says 10000"),
        (
            {"load_ohm": (10_000.0,) * 9 + (12_000.0,)},
            "readout.load_ohm is 12000, but the board says 10000",
        ),
    ):
        with pytest.raises(InputError, match=sentence):
            scene_of(hello(), loaded_scene(**changes))
    with pytest.raises(
        InputError, match=r"readout\.kind is two_point, but the board .* wired as loaded_columns"
    ):
        scene_of(hello(), scene(4, 4))
    known = loaded_scene(
        load_ohm=tuple(np.linspace(9_700, 10_300, 10)), drive_ohm=tuple(np.linspace(60, 90, 10))
    )
    assert scene_of(hello(), known) is known


def test_hello_contains_the_wiring() -> None:
    """Earlier firmware, whose HELLO has 29 bytes, has two multiplexers."""
    greeting = hello()
    assert (greeting.wiring, greeting.reference_milliohm, greeting.drive_milliohm) == (
        WIRING,
        10_000_000,
        70_000,
    )
    assert declared_readout(greeting) == loaded_scene(noise_lsb=None).readout
    old = replace(greeting, wiring="two_point", drive_milliohm=0)
    assert len(hello_body(old)) == 29 and Receiver().feed(message(hello_body(old)))[1] == (old,)
    unknown = hello_body(greeting)[:29] + bytes([9, 0, 0, 0, 0])
    assert not any(isinstance(item, Hello) for item in Receiver().feed(message(unknown))[1])


def test_platformio_builds_both_wirings() -> None:
    assert "-DLAMPEST_WIRING=LAMPEST_LOADED_COLUMNS" in (FIRMWARE / "platformio.ini").read_text()
