"""0x00 · COBS(body · CRC-16/CCITT-FALSE) · 0x00: how a body goes over the wire."""

import struct
from binascii import crc_hqx


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, neither reflected nor inverted."""
    return crc_hqx(data, 0xFFFF)


def stuffed(body: bytes) -> bytes:
    """COBS: the body without zeros. Source: Cheshire & Baker, IEEE/ACM Trans. Networking 7(2), 1999."""
    pieces = []
    runs = body.split(b"\0")
    for number, run in enumerate(runs):
        while len(run) >= 254:
            pieces.append(b"\xff" + run[:254])
            run = run[254:]
            if not run and number == len(runs) - 1:
                return b"".join(pieces)
        pieces.append(bytes([len(run) + 1]) + run)
    return b"".join(pieces)


def unstuffed(data: bytes) -> bytes | None:
    """The body that COBS made `data` of, or None where its codes do not end with the data."""
    pieces = []
    place = 0
    while place < len(data):
        code = data[place]
        end = place + code
        if code == 0 or end > len(data):
            return None
        pieces.append(data[place + 1 : end])
        if code < 255 and end < len(data):
            pieces.append(b"\0")
        place = end
    return b"".join(pieces)


def message(body: bytes) -> bytes:
    """A body as it goes over the wire."""
    return b"\0" + stuffed(body + struct.pack(">H", crc16(body))) + b"\0"


def stuffed_length(length: int) -> int:
    """The most bytes that a body of that length takes between its two zeros, CRC included."""
    return length + 2 + (length + 2) // 254 + 1
