"""WebSocket: a server that sends each message as a line of JSON to all listeners."""

import ipaddress
import math
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from threading import Thread
from typing import Any, ClassVar, Self
from urllib.parse import SplitResult

from lampest.files.errors import InputError, extra
from lampest.report.live.handover import Newest
from lampest.report.live.publish.publish import Publish, Say, Send
from lampest.report.live.server import MOST_STREAMS, Access

CLOSE_SECONDS = 1.0  # for a listener to introduce itself, and to take the last message
STALLED_SECONDS = 40.0  # for a listener to take any other, before its place is given away
LOCAL_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")


@dataclass(frozen=True)
class WebsocketPublish(Publish):
    """`websocket://ADDRESS:PORT`: pages of this computer and programs may listen; from elsewhere a token is needed.

    port : 0 is any that is free. token : as `lampest live --token` has it.
    """

    kind: ClassVar[str] = "websocket"
    host: str = "127.0.0.1"
    port: int = 8138
    token: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        host = "127.0.0.1" if where.hostname in (None, "localhost") else str(where.hostname)
        try:
            ipaddress.ip_address(host)
        except ValueError as error:
            raise InputError(f"--publish: websocket: '{host}' is no address such as 127.0.0.1 or 0.0.0.0") from error
        return cls(host, cls.port if where.port is None else where.port, token)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        newest, listeners = Newest(""), dict[Any, float]()
        access = Access.of(self.token, ipaddress.ip_address(self.host).is_loopback, self.port)
        server = self._server(newest, listeners, access)
        thread = Thread(target=server.serve_forever, name="lampest-websocket", daemon=True)
        thread.start()
        host, token = f"[{self.host}]" if ":" in self.host else self.host, access.token and f"?token={access.token}"
        try:
            yield f"ws://{host}:{server.socket.getsockname()[1]}/{token}", lambda message: newest.put(message.text())
        finally:
            newest.close()
            until = time.monotonic() + CLOSE_SECONDS
            while listeners and time.monotonic() < until:
                time.sleep(0.01)
            _cut_off(listeners, until)
            server.shutdown()
            thread.join()

    def _server(self, newest: Newest[str], listeners: dict[Any, float], access: Access) -> Any:
        """A thread for each listener, which sends it what is newest. Raises InputError where it cannot listen.

        listeners : connection → when the message that it has not yet taken was sent; infinite where there is none.
        """
        with extra("streams"):
            from websockets.exceptions import ConnectionClosed
            from websockets.sync.server import serve

        def admitted(connection: Any, request: Any) -> Any:
            if access.token and not access.shown_by(request.path, request.headers.get("Authorization", "")):
                return connection.respond(HTTPStatus.FORBIDDEN, "the token is missing or wrong\n")
            _cut_off(listeners, time.monotonic() - STALLED_SECONDS)
            full = len(listeners) >= MOST_STREAMS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many listen\n") if full else None

        def listening(connection: Any) -> None:
            seen, listeners[connection] = 0, math.inf
            with suppress(ConnectionClosed, OSError):
                while (news := newest.after(seen)) is not None:
                    (seen, text), listeners[connection] = news, time.monotonic()
                    connection.send(text)
                    listeners[connection] = math.inf
            del listeners[connection]

        settings: dict[str, Any] = {"open_timeout": CLOSE_SECONDS, "close_timeout": CLOSE_SECONDS, "compression": None}
        settings |= {"family": socket.AF_INET6} if ":" in self.host else {}
        settings |= {"max_size": 1024}  # bytes: no listener has anything to say
        settings |= {"origins": [None, LOCAL_PAGES]} if ipaddress.ip_address(self.host).is_loopback else {}
        try:
            return serve(listening, self.host, self.port, process_request=admitted, **settings)
        except OSError as error:
            said = error.strerror or error
            raise InputError(f"--publish: websocket: cannot listen at {self.host}:{self.port} ({said})") from error


def _cut_off(listeners: dict[Any, float], before: float) -> None:
    """Those that have not taken what was sent before that time, s of the monotonic clock."""
    for connection, sent in tuple(listeners.items()):
        with suppress(OSError):
            if sent <= before:
                connection.socket.shutdown(socket.SHUT_RDWR)
