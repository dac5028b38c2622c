"""Interface of protocols that publish live frames, and the threads that feed them."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from threading import Thread
from typing import ClassVar, Self
from urllib.parse import SplitResult, unquote

from lampest.report.live.handover import Newest
from lampest.report.live.message import Message, View

Send = Callable[[Message], None]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Publish(ABC):
    """A protocol with its address `KIND://USER:PASSWORD@HOST:PORT/PATH`; token : required of listeners.

    Subclasses have their own defaults for missing parts of the address.
    """

    kind: ClassVar[str]
    host: str = "127.0.0.1"
    port: int = 0
    path: str = "lampest"
    user: str | None = None
    password: str | None = None
    token: str | None = None

    @classmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """Return the protocol with the parts of an address. Raises InputError for an invalid one."""
        user, password = (None if part is None else unquote(part) for part in (where.username, where.password))
        port = cls.port if where.port is None else where.port
        return cls(where.hostname or cls.host, port, where.path.strip("/") or cls.path, user, password, token)

    @property
    def where(self) -> str:
        """Address as text."""
        return f"{self.kind}://{self.host}:{self.port}/{self.path}"

    @abstractmethod
    def opened(self, say: Say) -> AbstractContextManager[tuple[str, Send]]:
        """Yield the public address and a function that sends a message.

        Sending never waits for listeners: slow ones miss messages. say : receives sentences about the connection.
        Raises InputError for a missing library and an unreachable peer.
        """


def waited(done: Callable[[], bool], seconds: float) -> bool:
    """Wait until a condition holds, at most for some seconds; return whether it holds."""
    until = time.monotonic() + seconds
    while not done() and time.monotonic() < until:
        time.sleep(0.01)
    return done()


@contextmanager
def publishing(ways: Sequence[Publish], shown: Newest[View], say: Say) -> Iterator[tuple[str, ...]]:
    """Send new pictures, answers and alarms by each protocol, in a thread of its own, until the series ends.

    Yields the public addresses. say : receives a sentence at the first failure of a protocol. Raises InputError if one
    cannot be opened.
    """
    with ExitStack() as opened:
        outlets = [opened.enter_context(way.opened(say)) for way in ways]
        threads = [Thread(target=_forward, args=(shown, send, where, say), daemon=True) for where, send in outlets]
        for thread in threads:
            thread.start()
        try:
            yield tuple(where for where, _ in outlets)
        finally:
            shown.close()
            for thread in threads:
                thread.join()


def _forward(shown: Newest[View], send: Send, where: str, say: Say) -> None:
    """Send the newest picture, skipping older ones; report a failure once until sending works again."""
    seen, sent, failed = 0, (0, "", ""), False
    while (news := shown.after(seen)) is not None:
        seen, message = news.number, Message.of(news.item)
        if message is None or message.signature == sent:
            continue
        sent = message.signature
        try:
            send(message)
            failed = False
        except OSError as error:
            if not failed:
                say(f"{where}: frames do not get through ({error.strerror or error}); it is tried again with each")
            failed = True
