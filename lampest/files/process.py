"""What concerns the process as a whole: memory it may take, signals that end it, and the log of libraries' warnings."""

import logging
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

import psutil

from lampest.files.errors import InputError

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # small matrices
ALLOWED = "LAMPEST_MEMORY"  # the environment variable by which a user says how much may be taken, such as 8GB
PREFIXES = " KMGT"  # each 1,024 times the one before
SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
# What nohup has set to be ignored stays ignored; whoever sends the first two by hand means it.
WANTED = (signal.SIGINT, signal.SIGTERM)
ENDING = (*WANTED, *(signal.Signals[name] for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name)))
HUNG_SECONDS = 120.0  # and ten times a limit: what a library does between two looks at the clock ends within this
EXPENDABLE = ContextVar("expendable", default=False)  # whether somebody waits for this process who replaces it
LOG = "LAMPEST_LOG"
BEYOND = (
    "what is left of the panel, or what its numbers say, is beyond what can be computed here; {kind}, of which the "
    "file that LAMPEST_LOG names will hold all"
)
FOREIGN = (ArithmeticError, LookupError, ValueError, TypeError, AttributeError, AssertionError, MemoryError)


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
    said = os.environ.get(ALLOWED)
    if said:
        size = SIZE.fullmatch(said.strip())
        if size is None or not float(size[1]):
            raise InputError(f"{ALLOWED}: {said!r} is no size such as 8GB")
        return float(size[1]) * 1024.0 ** PREFIXES.index(size[2].upper() or " ")
    # The rest is for what was not counted.
    return 0.9 * min(float(psutil.virtual_memory().available), _left_in_container(), _left_of_addresses())


def in_bytes(size: float) -> str:
    """'26.8 GiB'."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:.1f} GiB"


def _left_in_container() -> float:
    """What Linux' control group still grants; endless where there is none."""
    with suppress(OSError, ValueError):
        most, taken = (Path("/sys/fs/cgroup", name).read_text() for name in ("memory.max", "memory.current"))
        return float(most) - float(taken)  # 'max' is no number
    return float("inf")


def _left_of_addresses() -> float:
    """What `ulimit -v` still grants; endless where it grants all, or on a system without it."""
    with suppress(ImportError, OSError):
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            return float(most - psutil.Process().memory_info().vms)
    return float("inf")


@contextmanager
def ended_where_hung(limit_s: float | None) -> Iterator[None]:
    """In an expendable process SIGALRM ends what takes longer than HUNG_SECONDS and ten times its limit in s.

    For calls of libraries that look at no clock, or too rarely: no handler of Python's runs before they return.
    """
    if limit_s is None or not EXPENDABLE.get() or not hasattr(signal, "setitimer"):
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
    if isinstance(error, InputError) or not isinstance(error, FOREIGN) or _is_ours(error):
        return " ".join(str(error).split())
    logging.getLogger("lampest").error("%s", of, exc_info=error)
    return BEYOND.format(kind=type(error).__name__)


def _is_ours(error: BaseException) -> bool:
    """Whether it is a ValueError that a module of this package raised, not a library below it."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    raised = "" if trace is None else str(trace.tb_frame.f_globals.get("__name__"))
    return type(error) is ValueError and raised.startswith("lampest.")
