"""The newest of a series of things, for threads that rather skip than lag behind."""

from collections.abc import Callable
from threading import Condition
from typing import Generic, NamedTuple, TypeVar

T = TypeVar("T")


class News(NamedTuple, Generic[T]):
    """A thing and its number in the series, from 1 on: whoever saw number n before skipped number − n − 1 things."""

    number: int
    thing: T


class Newest(Generic[T]):
    """One place that holds one thing. What it holds, and whether more will come, is its only state."""

    def __init__(self, first: T) -> None:
        self._changed = Condition()
        self._news = News(0, first)
        self._closed = False

    def put(self, thing: T) -> None:
        """Let `thing` take the place."""
        self.change(lambda _: thing)

    def change(self, changed: Callable[[T], T]) -> None:
        """Let `changed(thing)` take the place; no other change comes between."""
        with self._changed:
            self._news = News(self._news.number + 1, changed(self._news.thing))
            self._changed.notify_all()

    def close(self) -> None:
        """Nothing more will come."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def thing(self) -> T:
        """What it holds now."""
        return self._news.thing

    @property
    def closed(self) -> bool:
        """Whether nothing more will come."""
        return self._closed

    def after(self, number: int, timeout: float | None = None) -> News[T] | None:
        """Wait for something newer than that number; None after so many s, or where nothing more will come."""
        with self._changed:
            self._changed.wait_for(lambda: self._news.number > number or self._closed, timeout)
            return self._news if self._news.number > number else None
