"""Receivers of OSC that are absent, slow, refuse or do not exist."""

import dataclasses
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest

from lampest import InputError, Panel
from lampest.apps.live.handover import Newest
from lampest.apps.live.message import UNKNOWN, Message, Picture, View
from lampest.apps.live.publish import MAX_DATAGRAM, OscPublish, publishing
from lampest.apps.recognition.detect.answer import Detected

SMALL_PANEL = 3, 4
LARGE_PANEL = 72, 72  # three maps exceed a datagram
ENORMOUS_PANEL = 120, 120  # one map does
MAX_SECONDS = 5.0  # for fifty frames: sending waits for no answer


def frame(shape: tuple[int, int], number: int = 1) -> Message:
    """A solved frame with as large numbers as there are."""
    values = np.full(shape, 1e7)
    is_open = np.zeros(shape, dtype=bool)
    picture = Picture(
        number,
        0.1,
        0.0,
        values,
        values,
        is_open,
        UNKNOWN,
        "",
        0.1,
        0,
        values,
        values,
        verdict="pressing",
    )
    message = Message.of(View("", "", "", Panel(*shape), picture=picture))
    assert message is not None
    return message


@contextmanager
def receiver() -> Iterator[socket.socket]:
    """A receiver that need not listen."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**20)
        place.bind(("127.0.0.1", 0))
        place.settimeout(5)
        yield place


def addresses_of(place: socket.socket, count: int) -> list[list[str]]:
    """The messages' addresses of the datagrams that came."""
    from pythonosc.osc_bundle import OscBundle

    bundles = [OscBundle(place.recv(MAX_DATAGRAM)) for _ in range(count)]
    return [[message.address for message in bundle] for bundle in bundles]


@pytest.mark.parametrize(
    "where",
    [
        "osc://a..b",
        f"osc://{'x' * 300}",
        "osc://127.0.0.1:0",
        "osc:///a*b",
        "osc:///ä",
        "osc:///a b",
        "osc:///#",
    ],
)
def test_an_impossible_receiver_gives_one_sentence(where: str) -> None:
    osc = OscPublish.at(urlsplit(where.partition(":")[2], allow_fragments=False), None)
    with pytest.raises(InputError, match=r"^--publish: osc[^\n]*$"), osc.opened(print):
        pass


@pytest.mark.parametrize("host", ["127.0.0.1", "192.0.2.1"])
def test_an_absent_or_refusing_receiver_stops_nothing(host: str) -> None:
    """Port 9 of this computer answers by ICMP, an address of documentation never."""
    sentences = list[str]()
    with OscPublish(host, 9).opened(sentences.append) as (_, send):
        begin = time.monotonic()
        for number in range(50):
            send(frame(SMALL_PANEL, number))
        assert time.monotonic() - begin < MAX_SECONDS
    assert not sentences


def test_an_unreading_receiver_stops_nothing() -> None:
    sentences = list[str]()
    shown = Newest(frame(LARGE_PANEL).view)
    with (
        receiver() as place,
        publishing([OscPublish(port=place.getsockname()[1])], shown, sentences.append),
    ):
        for number in range(100):
            shown.put(frame(LARGE_PANEL, number).view)
            time.sleep(0.002)
    assert not sentences


@pytest.mark.parametrize(("shape", "count"), [(SMALL_PANEL, 1), (LARGE_PANEL, 2)])
def test_a_large_frame_is_sent_in_several_datagrams(shape: tuple[int, int], count: int) -> None:
    sentences = list[str]()
    with (
        receiver() as place,
        OscPublish(port=place.getsockname()[1]).opened(sentences.append) as (_, send),
    ):
        send(frame(shape))
        addresses = [address for bundle in addresses_of(place, count) for address in bundle]
    expected = [
        "sequence",
        "time",
        "size",
        "change",
        "pressure",
        "cells",
        "force",
        "force_sd",
        "verdict",
        "solved",
        "status",
        "alarm",
    ]
    assert addresses == [f"/lampest/{name}" for name in expected] and not sentences


def test_a_value_too_large_for_a_datagram_is_omitted_and_named_once() -> None:
    """Maps of a panel, and the list of all that sucked during a long day."""
    sentences = list[str]()
    detected = Detected("long", "cannot say", 0.5, why="x" * 70_000)
    view = dataclasses.replace(frame(ENORMOUS_PANEL).view, detected=detected)
    message = Message.of(view)
    assert message is not None
    with (
        receiver() as place,
        OscPublish(port=place.getsockname()[1]).opened(sentences.append) as (_, send),
    ):
        for _ in range(2):
            send(message)
        for bundle in addresses_of(place, 2):
            assert "/lampest/force" in bundle and "/lampest/cells" not in bundle
    named = [sentence.split(" ")[1] for sentence in sentences]
    assert named == [
        f"/lampest/{name}" for name in ("change", "pressure", "cells", "sentence", "detection")
    ]
