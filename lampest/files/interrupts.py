"""Signals that end a program: Ctrl-C and its kin, and how they wait for their turn."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# What nohup has set to be ignored stays ignored; whoever sends the first two by hand means it.
WANTED = (signal.SIGINT, signal.SIGTERM)
ENDING = (*WANTED, *(signal.Signals[name] for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name)))

SAME_WISH_SECONDS = 1.0
# What a library does between two looks at the clock, machine code that is made anew included, ends within this.
HUNG_SECONDS, HUNG_LIMITS = 120.0, 10.0
EXPENDABLE = ContextVar("expendable", default=False)  # whether somebody waits for this process who replaces it


@contextmanager
def ended_where_hung(limit_s: float | None) -> Iterator[None]:
    """In an expendable process SIGALRM ends what takes longer than HUNG_SECONDS and HUNG_LIMITS times its limit in s.

    For calls of libraries that look at no clock, or too rarely: no handler of Python's runs before they return.
    """
    if limit_s is None or not EXPENDABLE.get() or not hasattr(signal, "setitimer"):
        yield
        return
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, HUNG_SECONDS + HUNG_LIMITS * limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def delayed_interrupt() -> Iterator[None]:
    """Keep Ctrl-C and its kin until the end of a solve: CasADi would take it for a failed evaluation."""
    seen: list[int] = []
    with handled(lambda number: seen.append(number)):
        yield
    if seen:
        signal.raise_signal(seen[0])


@contextmanager
def ending_signals(worth_finishing: Callable[[], bool] = lambda: False) -> Iterator[Callable[[], str]]:
    """A function that names the signal that asked for the end, such as SIGTERM, or ''.

    Where nothing is worth finishing, and at a second signal, KeyboardInterrupt is raised at once. What comes within a
    second is the same wish: a terminal that closes says so more than once.
    """
    asked: list[str] = []
    first = time.monotonic()

    def ask(number: int) -> None:
        nonlocal first
        # Noted first: an exception raised inside a destructor is lost, the note is not.
        asked.append(signal.Signals(number).name)
        first = time.monotonic() if len(asked) == 1 else first
        if not worth_finishing() or time.monotonic() - first > SAME_WISH_SECONDS:
            raise KeyboardInterrupt

    with handled(ask):
        yield lambda: asked[0] if asked else ""


def interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is what an error came from: machine code that is called while it comes makes another one of it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


@contextmanager
def deaf() -> Iterator[None]:
    """Nothing that can be caught ends the program meanwhile: for the short while in which a file is closed."""
    with handled(lambda number: None):
        yield


@contextmanager
def handled(handler: Callable[[int], object]) -> Iterator[None]:
    """Every signal that ends a program goes to the handler instead; nothing changes outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [number for number in ENDING if number in WANTED or signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, lambda seen, frame: handler(seen)) for number in numbers}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
