"""Protocol between board and host: conversion of bytes to messages and back, without I/O.

The same layouts and numbers are in firmware/lampest_board/protocol.h; tests compare the two.
"""

import struct
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

PROTOCOL_VERSION = 2
BAUD = 500_000
MAX_ROWS = MAX_COLUMNS = 16
MAX_CODE = 1023
MAX_BASELINE = 255  # unloaded frames of a board's own baseline
MAX_LOG_CHANGE = 28.0  # ln(1e9 ohm / 1e-3 ohm): the widest range of cells that a board estimates
MAX_READINGS = np.iinfo(np.uint16).max // MAX_CODE  # the sum of so many codes fits into 16 bits
_HELLO = struct.Struct("<BBBBBBBBHIIHHIBBB")
_HELLO_WIRING = struct.Struct("<BI")
_FRAME = struct.Struct("<BBBBBIIHH")
_ANSWER = struct.Struct("<BBBBBI")
_ESTIMATE = struct.Struct("<BBBBBIH")
_COMMAND = struct.Struct("<BBBI")
ACROSS: tuple[Literal["reference"], Literal["sensor"]] = ("reference", "sensor")
WIRINGS: tuple[Literal["two_point"], Literal["loaded_columns"]] = ("two_point", "loaded_columns")


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of data.

    The polynomial is 0x1021, the start 0xFFFF; nothing is reflected or inverted.
    """
    return crc_hqx(data, 0xFFFF)


def stuffed(body: bytes) -> bytes:
    """Return a body encoded without zeros (COBS).

    Source: Cheshire & Baker, IEEE/ACM Transactions on Networking 7(2), 1999.
    """
    pieces = []
    *runs, last = body.split(b"\0")
    for run in runs:
        pieces += [run[begin : begin + 254] for begin in range(0, len(run) + 1, 254)]
    # A full piece at the end is not followed by an empty one.
    pieces += [last[begin : begin + 254] for begin in range(0, max(len(last), 1), 254)]
    return b"".join(bytes([len(piece) + 1]) + piece for piece in pieces)


def unstuffed(data: bytes) -> bytes | None:
    """Return the body of COBS-encoded data, or None if the data are not valid."""
    pieces = []
    place = 0
    while place < len(data):
        code = data[place]
        end = place + data[place]
        if code == 0 or end > len(data):
            return None
        pieces.append(data[place + 1 : end] + (b"\0" if code < 255 and end < len(data) else b""))
        place = end
    return b"".join(pieces)


def message(body: bytes) -> bytes:
    """Return the bytes on the wire of a body, with its CRC."""
    return b"\0" + stuffed(body + struct.pack(">H", crc16(body))) + b"\0"


# Bytes of the longest message between its zeros: an estimate and its CRC, without zeros to shorten
# the pieces.
MAX_STUFFED = len(stuffed(b"\1" * (_ESTIMATE.size + 4 * MAX_ROWS * MAX_COLUMNS + 2)))


class Kind(IntEnum):
    """Kinds of messages: from the board up to 15, to the board above."""

    HELLO = 1
    FRAME = 2
    ANSWER = 3
    ESTIMATE = 4
    IDENTIFY = 16
    START = 17
    STOP = 18
    SET_ROWS = 19
    SET_COLUMNS = 20
    SET_READINGS = 21
    SET_PERIOD = 22
    SET_SETTLE = 23
    SET_BASELINE = 24


class Result(Enum):
    """Results of a command, by the sentence for the user."""

    DONE = "done"
    REFUSED_UNKNOWN = "the board does not know this command"
    REFUSED_RANGE = "the value is outside what the board can do"
    REFUSED_TOO_FAST = "the period is shorter than a scan takes"
    REFUSED_RUNNING = "the board is scanning; stop it first"
    REFUSED_VERSION = "the board speaks another version of the protocol"


RESULT_CODES = tuple(Result)


# Of firmware/lampest_estimate, `lampest_outcome`.
OUTCOMES = (
    "",
    "its constants are not sound",
    "too few readings are values",
    "something lies on the panel while it takes its baseline",
    "its arithmetic broke down",
    "its constants were written for another version of the library",
)


@dataclass(frozen=True)
class Hello:
    """Identity and settings of a board.

    A board sends them after a reset, once a second while idle, and on request. With loaded columns,
    reference_milliohm is the load of every column, and drive_milliohm the resistance in series with
    each row. `estimates` and `identity` are no part of HELLO. Boards that estimate accept
    SET_BASELINE; the identity is the number that a board drew at START, as its answer says.
    """

    rows: int
    columns: int
    readings: int
    most_rows: int
    most_columns: int
    most_readings: int
    firmware: tuple[int, int]
    period_us: int
    shortest_period_us: int
    settle_us: int
    supply_millivolt: int
    reference_milliohm: int
    adc_bits: int
    measured_across: Literal["reference", "sensor"]
    running: bool
    wiring: Literal["two_point", "loaded_columns"] = "two_point"
    drive_milliohm: int = 0
    estimates: bool = False
    identity: int = 0

    @property
    def fault(self) -> str:
        """Sentence about the first field with an impossible value, or ''."""
        limits = dict.fromkeys(("rows", "columns", "most_rows", "most_columns"), MAX_ROWS)
        limits |= dict.fromkeys(("readings", "most_readings"), MAX_READINGS)
        limits |= dict.fromkeys(
            ("period_us", "shortest_period_us", "reference_milliohm"), 2**32 - 1
        )
        limits |= {"supply_millivolt": 2**16 - 1, "adc_bits": MAX_CODE.bit_length()}
        wrong = (name for name, most in limits.items() if not 1 <= getattr(self, name) <= most)
        return next(
            (
                f"the board says that {n} is {getattr(self, n)}; 1 to {limits[n]} is possible"
                for n in wrong
            ),
            "",
        )

    @property
    def period(self) -> float:
        """Time between frames in s."""
        return self.period_us * 1e-6

    @property
    def size(self) -> tuple[int, int, int]:
        """Numbers of rows, columns and readings, in this order."""
        return self.rows, self.columns, self.readings


@dataclass(frozen=True, eq=False)
class Frame:
    """Frame of one scan.

    Attributes
    ----------
    readings : int
        Number of codes in each sum.
    sequence : int
        Number of the frame since the board was started.
    device_ms : int
        Board's clock at the start of the scan in ms.
    missed : int
        Scans that the board could not begin in time before this one.
    sums : array, shape (rows, columns)
        Sums of codes.
    log_change : array, shape (rows, columns), or None
        ln(r / r unloaded) that the board estimated, from the message before the frame.
    unestimated : str
        Why the board says that it did not estimate the frame, one of OUTCOMES, or ''.
    identity : int
        Number that the board drew at START.
    """

    readings: int
    sequence: int
    device_ms: int
    missed: int
    sums: NDArray[np.uint16]
    log_change: NDArray[np.float32] | None = None
    unestimated: str = ""
    identity: int = 0

    def with_estimate(self, estimate: "Estimate | None") -> "Frame":
        """Return the frame with the board's estimate, or why it failed.

        The frame is unchanged if that is of another frame.
        """
        if estimate is None or (
            estimate.identity,
            estimate.sequence,
            estimate.log_change.shape,
        ) != (self.identity, self.sequence, self.sums.shape):
            return self
        if estimate.outcome == 0:
            return replace(self, log_change=estimate.log_change)
        return replace(self, unestimated=OUTCOMES[estimate.outcome])


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimate of the cells by the board, sent before its frame.

    Attributes
    ----------
    outcome : int
        0, or the place in OUTCOMES of the reason why the board did not estimate the frame.
    sequence : int
        Number of the frame.
    log_change : array, shape (rows, columns)
        ln(r / r unloaded); without meaning unless the outcome is 0.
    identity : int
        Number that the board drew at START.
    """

    outcome: int
    sequence: int
    log_change: NDArray[np.float32]
    identity: int = 0


@dataclass(frozen=True)
class Answer:
    """Answer of the board to a command, identified by its tag, with the value in force."""

    command: int
    tag: int
    result: Result
    value: int


@dataclass(frozen=True)
class Foreign:
    """Undamaged message of another version of the protocol."""

    version: int


@dataclass(frozen=True)
class Garbage:
    """Bytes between two zeros that are no message."""

    length: int


Message = Hello | Frame | Estimate | Answer | Foreign | Garbage


@dataclass(frozen=True)
class Receiver:
    """State of reception: the bytes since the last zero.

    `feed` returns the next state and the complete messages.
    """

    pending: bytes = b""

    def feed(self, data: bytes) -> tuple["Receiver", tuple[Message, ...]]:
        """Return the next state and the messages that the data complete; no data raise an error.

        Returns
        -------
        receiver : Receiver
            The next state.
        messages : tuple of Message
        """
        *pieces, pending = (self.pending + data).split(b"\0")
        # One byte more than MAX_STUFFED suffices to recognise a piece that is no message.
        return Receiver(pending[: MAX_STUFFED + 1]), tuple(
            _read_piece(piece) for piece in pieces if piece
        )


def command(kind: Kind, tag: int = 0, value: int = 0) -> bytes:
    """Return the bytes of a command on the wire; tag 0 to 255, value 0 to 2³² − 1."""
    return message(_COMMAND.pack(PROTOCOL_VERSION, kind, tag, value))


def _read_piece(piece: bytes) -> Message:
    """Return the message in the bytes between two zeros."""
    content = unstuffed(piece) if len(piece) <= MAX_STUFFED else None
    # The CRC of a body followed by its CRC is zero.
    if content is None or len(content) < 4 or crc16(content) != 0:
        return Garbage(len(piece))
    body = content[:-2]
    if body[0] != PROTOCOL_VERSION:
        return Foreign(body[0])
    try:
        return READERS[body[1]](body)
    except (struct.error, LookupError, ValueError):
        return Garbage(len(piece))


def _read_hello(body: bytes) -> Hello:
    """Return the HELLO of a message's body."""
    fields = list(_HELLO.unpack(body[: _HELLO.size]))[2:]
    wiring, drive = _HELLO_WIRING.unpack(body[_HELLO.size :] or bytes(_HELLO_WIRING.size))
    fields[6] = divmod(fields[6], 256)
    fields[13] = ACROSS[fields[13]]
    fields[14] = bool(fields[14])
    fields += [WIRINGS[wiring], drive]
    return Hello(*fields)


def _read_frame(body: bytes) -> Frame:
    """Return the frame of a message's body. Raises ValueError for one that no board sends."""
    header = _FRAME.unpack_from(body)
    rows, columns, readings, sequence, device_ms, missed, identity = header[2:]
    sums = np.frombuffer(body, "<u2", offset=_FRAME.size).astype(np.uint16).reshape(rows, columns)
    # A 16-bit CRC misses some errors, so that the range of the sums is checked as well.
    possible = readings <= MAX_READINGS and sums.max() <= readings * MAX_CODE
    if not (possible and rows <= MAX_ROWS and columns <= MAX_COLUMNS and readings):
        raise ValueError("no board sends such a frame")
    return Frame(readings, sequence, device_ms, missed, sums, identity=identity)


def _read_estimate(body: bytes) -> Estimate:
    """Return the estimate of a message's body. Raises ValueError for one that no board sends."""
    _, _, rows, columns, outcome, sequence, identity = _ESTIMATE.unpack_from(body)
    log_change = (
        np.frombuffer(body, "<f4", offset=_ESTIMATE.size).astype(np.float32).reshape(rows, columns)
    )
    fits = 0 < rows <= MAX_ROWS and 0 < columns <= MAX_COLUMNS and outcome < len(OUTCOMES)
    if not (fits and np.all(np.abs(log_change) <= MAX_LOG_CHANGE)):
        raise ValueError("no board sends such an estimate")
    return Estimate(outcome, sequence, log_change, identity)


def _read_answer(body: bytes) -> Answer:
    _, _, kind, tag, result, value = _ANSWER.unpack(body)
    return Answer(kind, tag, RESULT_CODES[result], value)


READERS: dict[int, Callable[[bytes], Message]] = {
    Kind.HELLO: _read_hello,
    Kind.FRAME: _read_frame,
    Kind.ANSWER: _read_answer,
    Kind.ESTIMATE: _read_estimate,
}
