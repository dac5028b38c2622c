"""The wire protocol: messages arrive as sent, and damaged bytes never become a frame."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lampest import InputError
from lampest.apps.board import port, protocol
from lampest.apps.board.protocol import (
    OUTCOMES,
    Answer,
    Estimate,
    Frame,
    Garbage,
    Hello,
    Kind,
    Receiver,
    Result,
    command,
    message,
)
from tests.bodies import answer_body, estimate_body, frame_body, hello_body

HELLO = Hello(
    10, 10, 20, 16, 16, 64, (1, 0), 1_000_000, 230_100, 40, 5000, 1_000_000, 10, "reference", False
)
ANSWER = Answer(Kind.SET_ROWS, 7, Result.REFUSED_RANGE, 10)
KINDS = {
    "HELLO": 1,
    "FRAME": 2,
    "ANSWER": 3,
    "ESTIMATE": 4,
    "IDENTIFY": 16,
    "START": 17,
    "STOP": 18,
}
KINDS |= {
    "SET_ROWS": 19,
    "SET_COLUMNS": 20,
    "SET_READINGS": 21,
    "SET_PERIOD": 22,
    "SET_SETTLE": 23,
    "SET_BASELINE": 24,
}
RUN = bytes(range(1, 255)).hex()
# Examples of the encyclopedia's article on COBS.
COBS = (
    (b"\0", "0101"),
    (b"\0\0", "010101"),
    (b"\x11\x22\0\x33", "0311220233"),
    (b"\x11\0\0\0", "0211010101"),
    (bytes(range(1, 255)), "ff" + RUN),
    (bytes(range(255)), "01ff" + RUN),
    (bytes(range(1, 256)), "ff" + RUN + "02ff"),
    (bytes([*range(2, 256), 0]), "ff" + bytes(range(2, 256)).hex() + "0101"),
    (bytes([*range(3, 256), 0, 1]), "fe" + bytes(range(3, 256)).hex() + "0201"),
)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame that a board may send."""
    rows = draw(st.integers(1, 16))
    columns = draw(st.integers(1, 16))
    readings = draw(st.integers(1, 64))
    seed = draw(st.integers(0, 2**32 - 1))
    max_sum = readings * protocol.MAX_CODE if draw(st.booleans()) else 3
    sums = np.random.default_rng(seed).integers(0, max_sum + 1, (rows, columns)).astype(np.uint16)
    counts = [draw(st.integers(0, 2**bits - 1)) for bits in (32, 32, 16)]
    return Frame(readings, *counts, sums)


def same(left: protocol.Message, right: protocol.Message) -> bool:
    if isinstance(left, Frame) and isinstance(right, Frame):
        return frame_body(left) == frame_body(right)
    return left == right


def received(data: bytes) -> tuple[protocol.Message, ...]:
    return Receiver().feed(data)[1]


def test_crc_and_cobs_agree_with_their_catalogues() -> None:
    assert protocol.crc16(b"123456789") == 0x29B1
    for body, wire in COBS:
        assert (
            protocol.stuffed(body).hex() == wire and protocol.unstuffed(bytes.fromhex(wire)) == body
        )


def test_hello_and_answer_are_decoded_and_commands_are_not_messages() -> None:
    for running in (False, True):
        hello = Hello(*(16, 3, 1, 16, 16, 64, (2, 9), 4, 5, 6, 3300, 7, 12, "sensor", running))
        assert received(message(hello_body(hello))) == (hello,)
    assert received(message(answer_body(ANSWER))) == (ANSWER,)
    assert all(isinstance(item, Garbage) for item in received(command(Kind.START, 3, 2**32 - 1)))


@given(
    st.lists(frames(), min_size=1, max_size=4),
    st.binary(max_size=60),
    st.binary(max_size=60),
    st.data(),
)
@settings(max_examples=60)
def test_cuts_and_surrounding_garbage_lose_no_frame(
    sent: list[Frame], before: bytes, after: bytes, data: st.DataObject
) -> None:
    """However the line is cut into pieces, all frames arrive."""
    wire = before + b"".join(message(frame_body(frame)) for frame in sent) + b"\0" + after
    receiver = Receiver()
    arrived = list[Frame]()
    while wire:
        cut = data.draw(st.sampled_from([1, 2, 17, 300, len(wire)]))
        receiver, items = receiver.feed(wire[:cut])
        arrived += [item for item in items if isinstance(item, Frame)]
        wire = wire[cut:]
    assert len(arrived) == len(sent)
    assert all(same(actual, expected) for actual, expected in zip(arrived, sent, strict=True))


@given(frames(), st.data())
def test_up_to_three_flipped_bits_are_noticed(frame: Frame, data: st.DataObject) -> None:
    """CRC-16/CCITT has a distance of 4 at these lengths."""
    wire = bytearray(message(frame_body(frame)))
    bits = data.draw(st.sets(st.integers(8, 8 * len(wire) - 9), min_size=1, max_size=3))
    for bit in bits:
        wire[bit // 8] ^= 1 << bit % 8
    assert not any(isinstance(item, Frame) for item in received(bytes(wire)))


@given(frames(), frames(), st.data())
def test_a_truncated_frame_costs_only_itself(
    torn: Frame, whole: Frame, data: st.DataObject
) -> None:
    wire = message(frame_body(torn))
    cut = data.draw(st.integers(1, len(wire) - 1))
    messages = received(wire[:cut] + message(frame_body(whole)))
    assert same(messages[-1], whole)


@given(st.integers(0, 255).filter(lambda version: version != protocol.PROTOCOL_VERSION), frames())
def test_another_version_is_named_and_not_decoded(version: int, frame: Frame) -> None:
    assert received(message(bytes([version]) + frame_body(frame)[1:])) == (
        protocol.Foreign(version),
    )


def test_impossible_content_with_a_right_crc_is_garbage() -> None:
    frame = Frame(2, 0, 0, 0, np.full((2, 2), 2 * protocol.MAX_CODE, dtype=np.uint16))
    body = frame_body(frame)
    too_high = body[:-2] + (2 * protocol.MAX_CODE + 1).to_bytes(2, "little")
    for wrong in (
        too_high,
        body + b"\0",
        body[:-1],
        body[:2] + b"\3" + body[3:],
        body[:1] + b"\x0e" + body[2:],
    ):
        assert received(message(wrong)) == (Garbage(len(message(wrong)) - 2),)


def test_estimates_are_decoded_and_impossible_ones_are_garbage() -> None:
    """A board with a bit turned in its numbers has sent no estimate rather than a wrong one."""
    change = np.linspace(-27, 27, 256, dtype=np.float32).reshape(16, 16)
    (estimate,) = received(message(estimate_body(Estimate(3, 2**32 - 1, change))))
    assert isinstance(estimate, Estimate) and (estimate.outcome, estimate.sequence) == (
        3,
        2**32 - 1,
    )
    np.testing.assert_array_equal(estimate.log_change, change)
    body = estimate_body(estimate)
    bad = (np.nan, np.inf, -np.inf, 28.1, 1e30)
    numbers = [body[:-4] + np.float32(number).astype("<f4").tobytes() for number in bad]
    for wrong in (
        *numbers,
        body[:-1],
        body + b"\0",
        body[:2] + b"\x0f" + body[3:],
        body[:2] + bytes(2) + body[4:9],
        body[:4] + bytes([len(OUTCOMES)]) + body[5:],
    ):
        assert received(message(wrong)) == (Garbage(len(message(wrong)) - 2),)


@given(st.binary(max_size=3000))
def test_noise_gives_neither_a_frame_nor_an_error_and_fills_no_memory(noise: bytes) -> None:
    receiver, items = Receiver().feed(noise)
    assert not any(isinstance(item, Frame) for item in items)
    for _ in range(20):
        receiver, items = receiver.feed(b"\x07" * 1000)
    assert items == () and len(receiver.pending) == protocol.MAX_STUFFED + 1
    _, items = receiver.feed(
        message(frame_body(Frame(1, 0, 0, 0, np.zeros((1, 1), dtype=np.uint16))))
    )
    assert isinstance(items[0], Garbage) and isinstance(items[1], Frame)


def test_commands_are_nine_bytes_with_the_numbers_of_their_kinds() -> None:
    """Boards with this version of the protocol were flashed with these numbers."""
    assert {kind.name: kind.value for kind in Kind} == KINDS and protocol.PROTOCOL_VERSION == 2
    wire = command(Kind.SET_PERIOD, 7, 0x01020304)
    body = b"\x02\x16\x07\x04\x03\x02\x01"
    assert protocol.unstuffed(wire.strip(b"\0")) == body + protocol.crc16(body).to_bytes(2, "big")


class ObedientPort:
    """Source whose board sends `answers(kind, tag, value)` to every command."""

    def __init__(self, answers: Callable[[Kind, int, int], bytes]) -> None:
        self.answers = answers
        self.commands = list[tuple[str, int]]()
        self.data = b""

    def read(self) -> bytes:
        data = self.data
        self.data = b""
        return data

    def write(self, wire: bytes) -> None:
        body = protocol.unstuffed(wire.strip(b"\0")) or b""
        kind = Kind(body[1])
        tag = body[2]
        value = int.from_bytes(body[3:7], "little")
        self.commands.append((kind.name, value))
        self.data += self.answers(kind, tag, value)


def board_with(
    answers: Callable[[Kind, int, int], bytes],
) -> tuple[port.Board, list[tuple[str, int]]]:
    line: Any = ObedientPort(answers)
    return port.Board(line, "port"), line.commands


def test_a_refused_command_gives_a_sentence_unless_a_lost_answer_explains_it() -> None:
    for result in Result:
        board, _ = board_with(
            lambda kind, tag, value, answered=result: message(
                answer_body(Answer(kind, tag, answered, value))
            )
        )
        for kind in (Kind.START, Kind.STOP, Kind.SET_ROWS):
            if result is Result.DONE or (kind is Kind.START and result is Result.REFUSED_RUNNING):
                board.order(kind, 5)
                continue
            with pytest.raises(InputError) as caught:
                board.order(kind, 5)
            assert str(caught.value) == f"port: {kind.name} 5 refused: {result.value}"


def test_a_command_is_sent_four_times_without_losing_messages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(port, "ANSWER_SECONDS", 0.01)
    frame = Frame(1, 3, 4, 0, np.ones((1, 2), dtype=np.uint16))
    idle = replace(HELLO, readings=3)
    board, commands = board_with(lambda kind, tag, value: b"")
    with pytest.raises(port.NoBoardError, match=r"^port: the board does not answer IDENTIFY$"):
        board.identify()
    assert commands == [("IDENTIFY", 0)] * 4 and board.heard == 0
    sent = [
        message(frame_body(frame)) + b"noise\0",
        message(hello_body(HELLO)) + message(hello_body(idle)) + message(frame_body(frame)),
    ]
    board, commands = board_with(lambda kind, tag, value: sent.pop(0))
    assert board.identify() == HELLO and len(commands) == 2
    items = board.messages()
    assert [type(item) for item in items] == [Frame, Hello, Frame] and all(
        map(same, items[::2], (frame, frame))
    )


def test_a_board_is_configured_before_it_starts() -> None:
    """The default is a frame a second, or the board's shortest period if that is longer."""
    for period, shortest, chosen in (
        (None, 1_000, 1_000_000),
        (None, 2_000_000, 2_000_000),
        (1_000, 1_000, 1_000),
    ):
        greeting = replace(HELLO, rows=3, columns=4, readings=5, shortest_period_us=shortest)

        def answers(kind: Kind, tag: int, value: int, hello: Hello = greeting) -> bytes:
            body = (
                hello_body(hello)
                if kind is Kind.IDENTIFY
                else answer_body(Answer(kind, tag, Result.DONE, value))
            )
            return message(body)

        board, commands = board_with(answers)
        assert board.start(3, 4, 5, period, baseline=300) == replace(greeting, estimates=True)
        sizes = [
            ("SET_ROWS", 3),
            ("SET_COLUMNS", 4),
            ("SET_READINGS", 5),
            ("SET_BASELINE", 255),
            ("IDENTIFY", 0),
        ]
        assert commands == [
            ("STOP", 0),
            *sizes,
            ("SET_PERIOD", chosen),
            ("IDENTIFY", 0),
            ("START", 0),
        ]
        with pytest.raises(port.NoBoardError, match="restarted while it was being set"):
            board.start(3, 4, 6, period)
        with pytest.raises(InputError) as caught:
            board.start(3, 4, 5, shortest - 1)
        words = (
            f"a period of {(shortest - 1) / 1e6:g} s is too short: 3 × 4 cells with 5 readings "
            "each take"
        )
        assert str(caught.value) == f"{words} {shortest / 1e6:g} s"
