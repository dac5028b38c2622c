"""What a way to publish frames is, and how all ways get every frame."""

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
    """One way, with its address `KIND://USER:PASSWORD@HOST:PORT/PATH`; token : asked of listeners.

    A way has defaults of its own for what an address leaves away.
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
        """With the parts of an address. Raises InputError where it is none."""
        user, password = (None if part is None else unquote(part) for part in (where.username, where.password))
        port = cls.port if where.port is None else where.port
        return cls(where.hostname or cls.host, port, where.path.strip("/") or cls.path, user, password, token)

    @property
    def where(self) -> str:
        """For people."""
        return f"{self.kind}://{self.host}:{self.port}/{self.path}"

    @abstractmethod
    def opened(self, say: Say) -> AbstractContextManager[tuple[str, Send]]:
        """(where others find it, what sends a message); open as long as the context lasts.

        Sending never waits for listeners: slow ones miss messages. say : gets sentences about the connection.
        Raises InputError where a library is missing or nobody is there.
        """


def waited(done: Callable[[], bool], seconds: float) -> bool:
    """Whether something came true within so many s."""
    until = time.monotonic() + seconds
    while not done() and time.monotonic() < until:
        time.sleep(0.01)
    return done()


@contextmanager
def publishing(ways: Sequence[Publish], shown: Newest[View], say: Say) -> Iterator[tuple[str, ...]]:
    """Send every new picture, answer and alarm each way, in a thread of its own, until nothing more will come.

    Yields the ways' addresses. say : gets a sentence when a way fails first. Raises InputError where one cannot be
    opened.
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
    """Send the newest picture, those that came meanwhile are left out; a failure is said once until it works again."""
    seen, sent, failed = 0, (0, "", ""), False
    while (news := shown.after(seen)) is not None:
        seen, message = news.number, Message.of(news.thing)
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
