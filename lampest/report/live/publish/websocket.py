"""WebSocket: a server that sends each message as a line of JSON to all listeners."""

import math
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from threading import Thread
from typing import Any, ClassVar

from lampest.files.errors import InputError, extra
from lampest.report.live.handover import FAREWELL_SECONDS, Newest
from lampest.report.live.publish.publish import Publish, Say, Send, waited
from lampest.report.live.server import MAX_STREAMS, TURN_SECONDS, Access, ip_named

LOCAL_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")


@dataclass(frozen=True)
class WebsocketPublish(Publish):
    """`websocket://ADDRESS:PORT`: pages of this computer and programs may listen; from elsewhere a token is needed.

    port : 0 is any that is free. token : as `lampest live --token` has it.
    """

    kind: ClassVar[str] = "websocket"
    port: int = 8138

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Open the stream, as `Publish.opened`."""
        with extra("streams"):
            from websockets.exceptions import ConnectionClosed
            from websockets.sync.server import serve
        host = ip_named(self.host)
        if host is None:
            raise InputError(f"--publish: websocket: '{self.host}' is no address such as 127.0.0.1 or 0.0.0.0")
        newest, access = Newest(""), Access.of(self.token, self.port, local=host.is_loopback)
        listeners = dict[Any, float]()  # send time of the oldest message that each has not taken; else infinite

        def cut_off(before: float) -> None:
            for connection in [listener for listener, sent in tuple(listeners.items()) if sent <= before]:
                with suppress(OSError):
                    connection.socket.shutdown(socket.SHUT_RDWR)

        def admitted(connection: Any, request: Any) -> Any:
            if access.token and not access.shown_by(request.path, request.headers.get("Authorization", "")):
                return connection.respond(HTTPStatus.FORBIDDEN, "the token is missing or wrong\n")
            cut_off(time.monotonic() - TURN_SECONDS)
            full = len(listeners) >= MAX_STREAMS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many listen\n") if full else None

        def listening(connection: Any) -> None:
            seen, listeners[connection] = 0, math.inf
            with suppress(ConnectionClosed, OSError):
                while (news := newest.after(seen)) is not None:
                    (seen, text), listeners[connection] = news, time.monotonic()
                    connection.send(text)
                    listeners[connection] = math.inf
            del listeners[connection]

        settings: dict[str, Any] = {
            "open_timeout": FAREWELL_SECONDS,
            "close_timeout": FAREWELL_SECONDS,
            "compression": None,
        }
        settings |= {"max_size": 1024, "origins": [None, LOCAL_PAGES] if host.is_loopback else None}
        settings |= {"family": socket.AF_INET6 if host.version == 6 else socket.AF_INET, "process_request": admitted}
        try:
            server = serve(listening, str(host), self.port, **settings)
        except OSError as error:
            sentence = error.strerror or error
            raise InputError(f"--publish: websocket: cannot listen at {host}:{self.port} ({sentence})") from error
        thread = Thread(target=server.serve_forever, name="lampest-websocket", daemon=True)
        thread.start()
        where = f"{f'[{host}]' if host.version == 6 else host}:{server.socket.getsockname()[1]}"
        try:
            yield f"ws://{where}/{access.query}", lambda message: newest.put(message.text())
        finally:
            newest.close()
            waited(lambda: not listeners, FAREWELL_SECONDS)
            cut_off(time.monotonic())
            server.shutdown()
            thread.join()
