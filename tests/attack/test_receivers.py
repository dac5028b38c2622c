"""Receivers of OSC that are absent, slow, refuse or do not exist."""

import dataclasses
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
from apps.live.test_stalled_listeners import message

from lampest import InputError
from lampest.apps.live.handover import Newest
from lampest.apps.live.message import Message
from lampest.apps.live.publish import MAX_DATAGRAM, OscPublish, publishing
from lampest.apps.recognition.detect.answer import Detected

SMALL_PANEL = 3, 4
LARGE_PANEL = 72, 72  # three maps exceed a datagram
ENORMOUS_PANEL = 120, 120  # one map does
MAX_SECONDS = 5.0  # for fifty frames: sending waits for no answer


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
    return [[part.address for part in bundle] for bundle in bundles]


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
            send(message(number, SMALL_PANEL))
        assert time.monotonic() - begin < MAX_SECONDS
    assert not sentences


def test_an_unreading_receiver_stops_nothing() -> None:
    sentences = list[str]()
    shown = Newest(message(0, LARGE_PANEL).view)
    with (
        receiver() as place,
        publishing([OscPublish(port=place.getsockname()[1])], shown, sentences.append),
    ):
        for number in range(100):
            shown.put(message(number, LARGE_PANEL).view)
            time.sleep(0.002)
    assert not sentences


@pytest.mark.parametrize(("shape", "count"), [(SMALL_PANEL, 1), (LARGE_PANEL, 2)])
def test_a_large_frame_is_sent_in_several_datagrams(shape: tuple[int, int], count: int) -> None:
    sentences = list[str]()
    with (
        receiver() as place,
        OscPublish(port=place.getsockname()[1]).opened(sentences.append) as (_, send),
    ):
        send(message(1, shape))
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
    view = dataclasses.replace(message(1, ENORMOUS_PANEL).view, detected=detected)
    sent = Message.of(view)
    assert sent is not None
    with (
        receiver() as place,
        OscPublish(port=place.getsockname()[1]).opened(sentences.append) as (_, send),
    ):
        for _ in range(2):
            send(sent)
        for bundle in addresses_of(place, 2):
            assert "/lampest/force" in bundle and "/lampest/cells" not in bundle
    named = [sentence.split(" ")[1] for sentence in sentences]
    assert named == [
        f"/lampest/{name}" for name in ("change", "pressure", "cells", "sentence", "detection")
    ]
