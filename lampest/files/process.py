"""What concerns the process as a whole: memory it may take, signals that end it, and the log of libraries' warnings."""

import logging
import os
import re
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ContextDecorator, ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from lampest.files.errors import InputError

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # small matrices
ALLOWED = "LAMPEST_MEMORY"  # the environment variable by which a user says how much may be taken, such as 8GB
SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
# What nohup has set to be ignored stays ignored; whoever sends the first two by hand means it.
WANTED = (signal.SIGINT, signal.SIGTERM)
ENDING = (*WANTED, signal.SIGHUP, signal.SIGQUIT)
HUNG_SECONDS = 120.0  # and ten times a limit: what a library does between two looks at the clock ends within this
EXPENDABLE = ContextVar("expendable", default=False)  # whether somebody waits for this process who replaces it
LOG = "LAMPEST_LOG"
BEYOND = (
    "what is left of the panel, or what its numbers say, is beyond what can be computed here; {kind}, of which the "
    "file that LAMPEST_LOG names will hold all"
)
FOREIGN = (ArithmeticError, LookupError, ValueError, TypeError, AttributeError, AssertionError, MemoryError)


class OneBlasThread(ContextDecorator):
    """A context in which BLAS has one thread, also where several threads of this process enter and leave it.

    The matrices of a panel are small: several threads of BLAS take 3 to 15 times as long over them on a busy machine.
    The number of threads is a state of the process, so that there is one such context for all of it.
    """

    def __init__(self) -> None:
        self._lock, self._entered, self._limit = threading.Lock(), 0, ExitStack()

    @cached_property
    def _libraries(self) -> "ThreadpoolController":
        from threadpoolctl import ThreadpoolController  # not needed by `lampest --help`

        return ThreadpoolController()

    def __enter__(self) -> None:
        with self._lock:
            if not self._entered:
                self._limit.enter_context(self._libraries.limit(limits=1, user_api="blas"))
            self._entered += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._entered -= 1
            if not self._entered:
                self._limit.close()


ONE_BLAS_THREAD = OneBlasThread()


def check_memory(needed: float, what: str) -> None:
    """Raise InputError where `what`, such as 'the lines of a panel', needs more bytes than there are."""
    if needed > (there := memory_limit()):
        raise InputError(
            f"{what}: {in_bytes(needed)} of memory are needed, and there are {in_bytes(there)}; {ALLOWED} allows more"
        )


def memory_limit() -> float:
    """Bytes that may be taken: what the user says, else most of what the machine, a container and `ulimit -v` leave.

    Raises InputError where what the user says is no size.
    """
    if said := os.environ.get(ALLOWED):
        size = SIZE.fullmatch(said.strip())
        if size is None or not float(size[1]):
            raise InputError(f"{ALLOWED}: {said!r} is no size such as 8GB")
        return float(size[1]) * 1024.0 ** " KMGT".index(size[2].upper() or " ")
    left = [float(psutil.virtual_memory().available)]
    with suppress(OSError, ValueError):  # without Linux' control groups, or where the most is 'max'
        most, taken = (float(Path("/sys/fs/cgroup", name).read_text()) for name in ("memory.max", "memory.current"))
        left.append(most - taken)
    addresses = resource.getrlimit(resource.RLIMIT_AS)[0]
    if addresses != resource.RLIM_INFINITY:
        left.append(float(addresses - psutil.Process().memory_info().vms))
    return 0.9 * min(left)  # the rest is for what was not counted


def in_bytes(size: float) -> str:
    """'26.8 GiB'."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:.1f} GiB"


@contextmanager
def ended_where_hung(limit_s: float | None) -> Iterator[None]:
    """In an expendable process SIGALRM ends what takes longer than HUNG_SECONDS and ten times its limit in s.

    For calls of libraries that look at no clock, or too rarely: no handler of Python's runs before they return.
    """
    if limit_s is None or not EXPENDABLE.get():
        yield
        return
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, HUNG_SECONDS + 10 * limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


@contextmanager
def delayed_interrupt() -> Iterator[None]:
    """Keep Ctrl-C and its kin until the end of a solve: CasADi would take it for a failed evaluation."""
    seen: list[int] = []
    with handled(seen.append):
        yield
    if seen:
        signal.raise_signal(seen[0])


@contextmanager
def ending_signals(worth_finishing: Callable[[], bool] = lambda: False) -> Iterator[Callable[[], str]]:
    """A function that names the signal that asked for the end, such as SIGTERM, or ''.

    Where nothing is worth finishing, and at a second signal, KeyboardInterrupt is raised at once. What comes within a
    second is the same wish: a terminal that closes says so more than once.
    """
    asked: list[tuple[str, float]] = []

    def ask(number: int) -> None:
        # Noted first: an exception raised inside a destructor is lost, the note is not.
        asked.append((signal.Signals(number).name, time.monotonic()))
        if not worth_finishing() or asked[-1][1] - asked[0][1] > 1:
            raise KeyboardInterrupt

    with handled(ask):
        yield lambda: asked[0][0] if asked else ""


def interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is what an error came from: machine code that is called while it comes makes another one of it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def deaf() -> AbstractContextManager[None]:
    """Nothing that can be caught ends the program meanwhile: for the short while in which a file is closed."""
    return handled(lambda number: None)


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


@contextmanager
def libraries_to_the_log() -> Iterator[None]:
    """Warnings, and what `told_reason` keeps back, go to the file that LAMPEST_LOG names; without it nowhere."""
    path = os.environ.get(LOG)
    handler = logging.FileHandler(Path(path), delay=True) if path else logging.NullHandler()
    loggers = [logging.getLogger(name) for name in ("lampest", "py.warnings")]
    logging.captureWarnings(True)
    for logger in loggers:
        logger.addHandler(handler)
        logger.propagate = False
    try:
        yield
    finally:
        logging.captureWarnings(False)
        for logger in loggers:
            logger.removeHandler(handler)
            logger.propagate = True
        handler.close()


def told_reason(error: BaseException, of: str) -> str:
    """What a user reads of an exception: its own words where they are ours, else a sentence, and a line in the log.

    of : what was computed, for the log.
    """
    trace, raised = error.__traceback__, ""
    while trace is not None:
        raised = str(trace.tb_frame.f_globals.get("__name__"))
        trace = trace.tb_next
    ours = type(error) is ValueError and raised.startswith("lampest.")
    if ours or isinstance(error, InputError) or not isinstance(error, FOREIGN):
        return " ".join(str(error).split())
    logging.getLogger("lampest").error("%s", of, exc_info=error)
    return BEYOND.format(kind=type(error).__name__)
