"""State of the process: memory limit, BLAS threads, terminating signals, log of warnings.

The warnings are those of libraries.
"""

import logging
import os
import re
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ContextDecorator, ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lampest.files.errors import InputError

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

# Small matrices are fastest with one thread.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
ALLOWED = "LAMPEST_MEMORY"  # environment variable with the user's memory limit, such as 8GB
# Signals that the process ignores (nohup) stay ignored, except the first two, which are sent on
# purpose.
WANTED = (signal.SIGINT, signal.SIGTERM)
ENDING = (*WANTED, signal.SIGHUP, signal.SIGQUIT)
# Libraries that cannot map a segment or reserve a buffer raise KeyError or ImportError, wait for
# ever, or end the process. Below 600 MiB some command did (tests/attack/test_memory.py).
ADDRESS_SPACE = 660 * 2**20  # bytes of addresses that a command needs, mostly of its libraries
# s, and ten times a frame's limit: no library call took longer (tests/units/test_time_limit.py)
HUNG_SECONDS = 120.0
RETRY_SECONDS = 0.01  # a destructor has ended by then
# Whether a parent process replaces this one if it is killed.
EXPENDABLE = ContextVar("expendable", default=False)
FOREIGN = (
    ArithmeticError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    AssertionError,
    MemoryError,
)


class OneBlasThread(ContextDecorator):
    """Context with one BLAS thread, which several threads of the process may enter and leave.

    The matrices of a panel are small: several BLAS threads take 3 to 15 times as long on a busy
    machine. The number of threads is a state of the process, so that the whole process shares one
    such context. A process that forks waits for the lock, so that the child inherits it released.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entered = 0
        self._limit = ExitStack()
        released = self._lock.release
        os.register_at_fork(
            before=self._lock.acquire, after_in_parent=released, after_in_child=released
        )

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


def check_address_space() -> None:
    """Raise InputError if the limit of addresses (ulimit -v) is too small for the libraries.

    Under a limit that suffices, the libraries reserve their buffers at once, before data take the
    addresses.
    """
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return
    if limit < ADDRESS_SPACE:
        raise InputError(
            f"not enough memory: {in_bytes(ADDRESS_SPACE)} of addresses are needed, "
            f"and the limit is {in_bytes(limit)} (ulimit -v)"
        )
    # Each copy of OpenBLAS reserves its buffer now, and keeps it: without a buffer it asks for one
    # without end.
    import casadi
    import numpy as np
    from scipy.linalg import lu_factor

    regular = np.eye(2)
    np.linalg.inv(regular)
    lu_factor(regular)
    casadi.solve(regular, regular, "lapacklu")


def check_memory(needed: float, label: str) -> None:
    """Raise InputError if `label` needs more bytes than are available.

    An example of such a label is 'the lines of a panel'.
    """
    limit = memory_limit()
    if needed > limit:
        raise InputError(
            f"{label}: {in_bytes(needed)} of memory are needed, and there are {in_bytes(limit)}; "
            f"{ALLOWED} allows more"
        )


def memory_limit() -> float:
    """Return the available memory in bytes.

    The user's limit comes first; without one, the available memory is 90 % of the memory that
    machine, container and ulimit leave free.

    Raises InputError if the user's limit is no size.
    """
    setting = os.environ.get(ALLOWED)
    if setting:
        size = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", setting.strip(), re.IGNORECASE)
        if size is None or not float(size[1]):
            raise InputError(f"{ALLOWED}: {setting!r} is no size such as 8GB")
        return float(size[1]) * 1024.0 ** " KMGT".index(size[2].upper() or " ")
    import psutil  # not for commands that read results alone

    free = [float(psutil.virtual_memory().available)]
    with suppress(OSError, ValueError):  # without Linux' control groups, or where the most is 'max'
        limit = float(Path("/sys/fs/cgroup", "memory.max").read_text())
        used = float(Path("/sys/fs/cgroup", "memory.current").read_text())
        free.append(limit - used)
    addresses = resource.getrlimit(resource.RLIMIT_AS)[0]
    if addresses != resource.RLIM_INFINITY:
        free.append(float(addresses - psutil.Process().memory_info().vms))
    return 0.9 * min(free)  # a tenth is for buffers that estimates do not include


def in_bytes(size: float) -> str:
    """Return a size in words: '26.8 GiB'."""
    for unit in ("bytes", "KiB", "MiB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:.1f} GiB"


@contextmanager
def ended_where_hung(limit_s: float | None) -> Iterator[None]:
    """End an expendable process by SIGALRM if the block takes too long.

    The block may take HUNG_SECONDS and ten times the limit in s. SIGALRM ends calls of libraries
    that never return to Python, so that no Python signal handler runs.
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
    """Delay Ctrl-C and similar signals until the end of the block.

    CasADi would report them as failed evaluations.
    """
    signals: list[int] = []
    with handled(signals.append):
        yield
    if signals:
        signal.raise_signal(signals[0])


@contextmanager
def ending_signals(
    worth_finishing: Callable[[], bool] = lambda: False,
) -> Iterator[Callable[[], str]]:
    """Yield a function that returns the name of the signal that requested the end.

    The name is such as SIGTERM, or ''. KeyboardInterrupt is raised at once if nothing is worth
    finishing, and at a second signal. Signals within a second are one request, because a closing
    terminal sends several: a second KeyboardInterrupt would meet the clean-up after the first one.
    One inside a destructor, where Python prints and loses it, is raised again.
    """
    requests = []

    def note(number: int) -> None:
        requests.append((signal.Signals(number).name, time.monotonic()))
        again = requests[-1][1] - requests[0][1] > 1
        if again or (len(requests) == 1 and not worth_finishing()):
            raise KeyboardInterrupt

    def repeat(lost: Any) -> None:
        if lost.exc_type is not KeyboardInterrupt or not requests:
            usual(lost)
            return
        number = signal.Signals[requests[0][0]]
        requests.clear()
        thread = threading.main_thread().ident
        threading.Timer(RETRY_SECONDS, signal.pthread_kill, (thread, number)).start()

    usual = sys.unraisablehook
    sys.unraisablehook = repeat
    try:
        with handled(note):
            yield lambda: requests[0][0] if requests else ""
    finally:
        sys.unraisablehook = usual


def interrupted(error: BaseException | None) -> bool:
    """Return whether an error was caused by Ctrl-C.

    Compiled code may convert Ctrl-C into another error.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def deaf() -> AbstractContextManager[None]:
    """Return a context that ignores all terminating signals, for the closing of a file."""
    return handled(lambda number: None)


@contextmanager
def handled(handler: Callable[[int], object]) -> Iterator[None]:
    """Pass every terminating signal within the block to a handler.

    Outside the main thread the block runs without the handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {
        number: signal.signal(number, lambda received, frame: handler(received))
        for number in ENDING
        if number in WANTED or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


@contextmanager
def libraries_to_the_log() -> Iterator[None]:
    """Write warnings within the block to the file in LAMPEST_LOG.

    Errors that `logged_reason` shortens are written to it, too.
    """
    path = os.environ.get("LAMPEST_LOG")
    handler = logging.FileHandler(Path(path), delay=True) if path else logging.NullHandler()
    loggers = [logging.getLogger(name) for name in ("lampest", "py.warnings")]
    logging.captureWarnings(capture=True)
    for logger in loggers:
        logger.addHandler(handler)
        logger.propagate = False
    try:
        yield
    finally:
        logging.captureWarnings(capture=False)
        for logger in loggers:
            logger.removeHandler(handler)
            logger.propagate = True
        handler.close()


def logged_reason(error: BaseException, of: str) -> str:
    """Return the message of an exception that lampest raised, or a sentence on any other one.

    The log gets an entry on any other exception, with the computation `of`.
    """
    trace = error.__traceback__
    raised = ""
    while trace is not None:
        raised = str(trace.tb_frame.f_globals.get("__name__"))
        trace = trace.tb_next
    ours = type(error) is ValueError and raised.startswith("lampest.")
    if ours or isinstance(error, InputError) or not isinstance(error, FOREIGN):
        return " ".join(str(error).split())
    logging.getLogger("lampest").error("%s", of, exc_info=error)
    return (
        "cannot compute this panel: its values exceed the numerical range "
        f"({type(error).__name__}; details: LAMPEST_LOG)"
    )
