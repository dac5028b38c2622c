"""WebSocket: a server that sends each message as a line of JSON to whoever is connected."""

import asyncio
import ipaddress
import re
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from threading import Thread
from typing import Any, ClassVar, Self, TypeVar
from urllib.parse import SplitResult

from lampest.files.errors import InputError
from lampest.files.extras import extra
from lampest.report.live.access import Access
from lampest.report.live.publish.publish import Publish, Say, Send
from lampest.report.live.server import MOST_STREAMS

T = TypeVar("T")
Listeners = dict[Any, asyncio.Queue[str]]  # connection → what it has not got yet
PORT = 8138
CLOSE_SECONDS = 1.0
MOST_BYTES_IN = 1024  # nobody has anything to say
LOCAL_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")


@dataclass(frozen=True)
class WebsocketPublish(Publish):
    """`websocket://ADDRESS:PORT`: pages of this computer and programs may listen; from elsewhere a token is needed.

    token : as `lampest live --token` has it.
    """

    kind: ClassVar[str] = "websocket"
    host: str = "127.0.0.1"
    port: int = PORT
    token: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """127.0.0.1:8138 by default; port 0 is any that is free. Raises InputError where the host is no address."""
        host = "127.0.0.1" if where.hostname in (None, "localhost") else str(where.hostname)
        try:
            ipaddress.ip_address(host)
        except ValueError as error:
            raise InputError(f"--publish: websocket: '{host}' is no address such as 127.0.0.1 or 0.0.0.0") from error
        return cls(host, cls.port if where.port is None else where.port, token)

    @contextmanager
    def opened(self, say: Say) -> Iterator[tuple[str, Send]]:
        """Listening. Raises InputError where it cannot."""
        loop = asyncio.new_event_loop()
        thread = Thread(target=loop.run_forever, name="lampest-websocket", daemon=True)
        thread.start()
        listeners: Listeners = {}
        try:
            server, where = _done(self._listening(listeners), loop)
            try:
                yield where, lambda message: _offer(loop, listeners, message.text())
            finally:
                _done(_closed(server, listeners), loop)
        finally:
            loop.call_soon_threadsafe(loop.stop)
            thread.join()
            loop.close()

    async def _listening(self, listeners: Listeners) -> tuple[Any, str]:
        """The server and its address. Raises InputError as `opened`."""
        with extra("streams"):
            from websockets.asyncio.server import serve
        local = ipaddress.ip_address(self.host).is_loopback
        access = Access.of(self.token, local, self.port)

        def admitted(connection: Any, request: Any) -> Any:
            shown = access.shown_by(request.path, request.headers.get("Authorization", ""))
            if access.token and not shown:
                return connection.respond(HTTPStatus.FORBIDDEN, "the token is missing or wrong\n")
            full = len(listeners) >= MOST_STREAMS
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many listen\n") if full else None

        try:
            server = await serve(
                lambda connection: _told(connection, listeners),
                self.host,
                self.port,
                origins=[None, LOCAL_PAGES] if local else None,
                process_request=admitted,
                compression=None,
                max_size=MOST_BYTES_IN,
                close_timeout=CLOSE_SECONDS,
            )
        except OSError as error:
            said = error.strerror or error
            raise InputError(f"--publish: websocket: cannot listen at {self.host}:{self.port} ({said})") from error
        host = f"[{self.host}]" if ":" in self.host else self.host
        token = f"?token={access.token}" if access.token else ""
        return server, f"ws://{host}:{server.sockets[0].getsockname()[1]}/{token}"


def _done(work: Coroutine[Any, Any, T], loop: asyncio.AbstractEventLoop) -> T:
    """What the work gives, done in the loop's thread."""
    return asyncio.run_coroutine_threadsafe(work, loop).result()


def _offer(loop: asyncio.AbstractEventLoop, listeners: Listeners, text: str) -> None:
    """From any thread: the text takes the place of one that a listener has not got yet."""

    def put() -> None:
        for waiting in listeners.values():
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(text)

    loop.call_soon_threadsafe(put)


async def _told(connection: Any, listeners: Listeners) -> None:
    """One listener: the newest text, as soon as it has taken the one before."""
    from websockets.exceptions import ConnectionClosed

    waiting: asyncio.Queue[str] = asyncio.Queue(1)

    async def sending() -> None:
        with suppress(ConnectionClosed):
            while True:
                await connection.send(await waiting.get())

    listeners[connection] = waiting
    sender = asyncio.create_task(sending())
    try:
        await connection.wait_closed()
    finally:
        listeners.pop(connection)
        sender.cancel()


async def _closed(server: Any, listeners: Listeners) -> None:
    """Say goodbye once whoever listens has the last text, or is too slow for it."""
    with suppress(TimeoutError):
        async with asyncio.timeout(CLOSE_SECONDS):
            while not all(waiting.empty() for waiting in listeners.values()):
                await asyncio.sleep(0.01)
    server.close()
    try:
        async with asyncio.timeout(2 * CLOSE_SECONDS):
            await server.wait_closed()
    except TimeoutError:
        for connection in tuple(listeners):  # they do not read, and what they were sent keeps them open
            connection.transport.abort()
        await server.wait_closed()
