"""Listeners: who is admitted; from those that never read nothing piles up."""

import gc
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from urllib.parse import urlsplit

import numpy as np
import pytest
from paho.mqtt.client import Client
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from lampest.apps.film.pressure import Force
from lampest.apps.live import publish as publish_module
from lampest.apps.live.message import Message, Picture, View
from lampest.apps.live.publish import Send, publish_at
from lampest.panel.panel import Panel

FRAMES = 120  # of 107 kB: more than the two ends of a connection hold by themselves
PATIENCE_SECONDS = 30.0
TOKEN = "0123456789abcdef"
SMALL_BUFFER = 4096
HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")


def message(number: int = 1, shape: tuple[int, int] = (64, 64)) -> Message:
    """A solved frame."""
    cells = np.full(shape, 1000.123 + number)
    picture = Picture(
        number,
        0.0,
        0.0,
        cells,
        cells,
        np.zeros(shape, dtype=bool),
        Force(1.0, 0.1),
        "local optimum verified",
        0.0,
        0,
        cells,
        cells,
        np.zeros(shape, dtype=np.uint8),
        "pressing",
    )
    sent = Message.of(View("here", "LSM", "receiving", Panel(*shape), picture=picture))
    assert sent is not None
    return sent


def finish_in_time(work: Callable[[], object]) -> None:
    """Do something that must come to an end."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(PATIENCE_SECONDS)
    assert not thread.is_alive(), "it hangs"


def send_all(send: Send) -> None:
    """All frames, from a thread that must not hang."""

    def every() -> None:
        for number in range(1, FRAMES + 1):
            send(message(number))
            time.sleep(0.002)

    finish_in_time(every)


def small_socket() -> socket.socket:
    """Return a socket with a small buffer for unread bytes."""
    end = socket.socket()
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL_BUFFER)
    return end


@contextmanager
def sleeper(url: str) -> Iterator[socket.socket]:
    """A listener at an address that never reads."""
    port = urlsplit(url).port
    with closing(small_socket()) as asleep:
        asleep.connect(("127.0.0.1", port))
        asleep.sendall(HANDSHAKE.format(port=port).encode())
        yield asleep


def read_all(end: socket.socket) -> int:
    """How many bytes a peer gets that wakes up at last."""
    end.settimeout(2.0)
    count = 0
    with suppress(OSError):
        while piece := end.recv(1 << 20):
            count += len(piece)
    return count


@pytest.mark.slow
def test_a_stalled_websocket_delays_neither_frames_nor_clients_nor_the_end() -> None:
    received: list[int] = []
    publishing = publish_at("websocket://127.0.0.1:0").opened(print)
    url, send = publishing.__enter__()
    with sleeper(url) as asleep, connect(url, max_size=None) as awake:

        def listening() -> None:
            with suppress(ConnectionClosed):
                received.extend(json.loads(text)["sequence"] for text in awake)

        ear = threading.Thread(target=listening, daemon=True)
        ear.start()
        send_all(send)
        finish_in_time(lambda: publishing.__exit__(None, None, None))
        ear.join(PATIENCE_SECONDS)
        assert received[-1] == FRAMES and received == sorted(set(received)), (
            "who listens gets the newest frame, in order"
        )
        assert read_all(asleep) < FRAMES * len(message(1).text()) / 2, (
            "what it did not take is not kept for it"
        )


@pytest.mark.slow
def test_a_stalled_websocket_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publish_module, "MAX_STREAMS", 1)
    monkeypatch.setattr(publish_module, "TURN_SECONDS", 0.2)
    with publish_at("websocket://127.0.0.1:0").opened(print) as (url, send), sleeper(url):
        send_all(send)

        def admitted() -> None:
            while True:
                with suppress(InvalidStatus), connect(url, max_size=None):
                    return
                time.sleep(0.1)

        finish_in_time(admitted)


def test_a_stalled_broker_delays_neither_frames_nor_the_end() -> None:
    taken: list[socket.socket] = []
    with closing(small_socket()) as door:
        door.bind(("127.0.0.1", 0))
        door.listen()

        def deaf() -> None:
            end, _ = door.accept()
            end.recv(1024)
            end.sendall(bytes([0x20, 2, 0, 0]))  # CONNACK: accepted
            taken.append(end)

        threading.Thread(target=deaf, daemon=True).start()
        publishing = publish_at(f"mqtt://127.0.0.1:{door.getsockname()[1]}/panel").opened(print)
        _, send = publishing.__enter__()
        send_all(send)
        clients = [client for client in gc.get_objects() if type(client) is Client]
        sockets = [client.socket() for client in clients if client.socket() is not None]
        assert sockets and all(
            client.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) for client in sockets
        ), "sent at once"
        finish_in_time(lambda: publishing.__exit__(None, None, None))
        with closing(taken[0]):
            assert read_all(taken[0]) < FRAMES * len(message(1).text()) / 2, (
                "nothing is kept for it"
            )


def test_a_websocket_is_local_or_requires_a_token() -> None:
    for host, headers, path, status in (
        ("127.0.0.1", {"Origin": "http://evil.example"}, "", 403),
        ("127.0.0.1", {"Origin": "http://127.0.0.1:8137"}, "", 101),
        ("127.0.0.1", {}, "", 101),
        ("0.0.0.0", {}, "", 403),
        ("0.0.0.0", {}, "?token=wrong", 403),
        ("0.0.0.0", {}, f"?token={TOKEN}", 101),
        ("0.0.0.0", {"Authorization": f"Bearer {TOKEN}"}, "", 101),
    ):
        token = TOKEN if host == "0.0.0.0" else None
        with publish_at(f"websocket://{host}:0", token).opened(print) as (url, _):
            try:
                address = f"ws://127.0.0.1:{urlsplit(url).port}/{path}"
                with connect(address, additional_headers=headers) as connection:
                    answer = connection.response.status_code
            except InvalidStatus as refused:
                answer = refused.response.status_code
        assert answer == status
