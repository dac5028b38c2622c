"""Key presses while something else goes on; nothing where the input is no terminal."""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def pressed_keys() -> Iterator[Callable[[], str]]:
    """A function that gives the keys pressed since it was last called, '' for none; the terminal is restored after."""
    try:
        import termios
        import tty

        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        if os.tcgetpgrp(descriptor) != os.getpgrp():
            raise OSError("in the background, where touching the terminal would stop the process")
    except (ImportError, OSError, ValueError, AttributeError):
        # No POSIX terminal: then nothing can be marked.
        yield lambda: ""
        return
    except termios.error:
        yield lambda: ""
        return
    try:
        tty.setcbreak(descriptor)
        yield (
            lambda: (
                os.read(descriptor, 64).decode("ascii", "ignore") if select.select([descriptor], [], [], 0)[0] else ""
            )
        )
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
