"""Messages of a board, packed as its firmware does: the reverse of the package's reading."""

from lampest.apps.board import protocol
from lampest.apps.board.protocol import (
    ACROSS,
    PROTOCOL_VERSION,
    RESULT_CODES,
    WIRINGS,
    Answer,
    Estimate,
    Frame,
    Hello,
    Kind,
)


def hello_body(hello: Hello) -> bytes:
    """HELLO as the board packs it."""
    *fields, wiring, drive, _, _ = vars(hello).values()
    fields[6] = hello.firmware[0] << 8 | hello.firmware[1]
    fields[13] = ACROSS.index(hello.measured_across)
    wiring_fields = (
        b"" if wiring == "two_point" else protocol._HELLO_WIRING.pack(WIRINGS.index(wiring), drive)
    )
    return protocol._HELLO.pack(PROTOCOL_VERSION, Kind.HELLO, *fields) + wiring_fields


def frame_body(frame: Frame) -> bytes:
    numbers = (frame.readings, frame.sequence, frame.device_ms, frame.missed, frame.identity)
    fields = (*frame.sums.shape, *numbers)
    return (
        protocol._FRAME.pack(PROTOCOL_VERSION, Kind.FRAME, *fields)
        + frame.sums.astype("<u2").tobytes()
    )


def answer_body(answer: Answer) -> bytes:
    code = RESULT_CODES.index(answer.result)
    return protocol._ANSWER.pack(
        PROTOCOL_VERSION, Kind.ANSWER, answer.command, answer.tag, code, answer.value
    )


def estimate_body(estimate: Estimate) -> bytes:
    numbers = (estimate.outcome, estimate.sequence, estimate.identity)
    fields = (*estimate.log_change.shape, *numbers)
    changes = estimate.log_change.astype("<f4").tobytes()
    return protocol._ESTIMATE.pack(PROTOCOL_VERSION, Kind.ESTIMATE, *fields) + changes
