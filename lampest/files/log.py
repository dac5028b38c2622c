"""Libraries' words: they stand in a log for whoever asks for one, and a user reads a sentence about the panel."""

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lampest.files.errors import InputError

LOG = "LAMPEST_LOG"
BEYOND = (
    "what is left of the panel, or what its numbers say, is beyond what can be computed here; {kind}, of which the "
    "file that LAMPEST_LOG names will hold all"
)
FOREIGN = (ArithmeticError, LookupError, ValueError, TypeError, AttributeError, AssertionError, MemoryError)


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
    """What a user is told of an exception: its own words where they are ours, else a sentence, and a line in the log.

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
