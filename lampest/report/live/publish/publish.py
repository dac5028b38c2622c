"""What a way to publish frames is."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import ClassVar, Self
from urllib.parse import SplitResult

from lampest.report.live.publish.message import Message

Send = Callable[[Message], None]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Publish(ABC):
    """One way, with its address.

    kind : the word that an address begins with.
    """

    kind: ClassVar[str]

    @classmethod
    @abstractmethod
    def at(cls, where: SplitResult, token: str | None) -> Self:
        """With the parts of an address, its own for those that are left away. Raises InputError where it is none."""

    @abstractmethod
    def opened(self, say: Say) -> AbstractContextManager[tuple[str, Send]]:
        """(where others find it, what sends a message); open as long as the context lasts.

        Sending never waits for whoever listens: who is slow misses messages. say : told what happens to a connection.
        Raises InputError where a library is missing or nobody is there.
        """
