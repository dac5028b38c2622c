"""The command line: parse, call, print. Libraries are imported by the command that needs them."""

import errno
import gc
import os
import sys

from lampest.cli.screen import (
    INTERRUPTED,
    WRONG_INPUT,
    as_options,
    end_of_output,
    usable_streams,
    warn,
)
from lampest.files.applications import applications
from lampest.files.errors import InputError, extra, printable
from lampest.files.process import (
    ONE_THREAD,
    ending_signals,
    interrupted,
    libraries_to_the_log,
)

NO_THREAD = "can't start new thread"  # the words of Python's RuntimeError
KEPT = "interrupted; what was finished is kept"
# New containers between two collections of garbage. With Python's 700, collections take 4 to 8 % of
# a command that imports libraries or draws.
GARBAGE_CONTAINERS = 10_000


def main() -> None:
    """Run the command.

    Input errors end with code 2 and one sentence, Ctrl-C and similar signals with 130.
    """
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    gc.set_threshold(GARBAGE_CONTAINERS)
    usable_streams()
    try:
        with ending_signals(), libraries_to_the_log(), extra():
            from lampest.cli.program import program

            for objection in applications().objections:
                warn(objection)
            try:
                program()()
            finally:
                sys.stdout.flush()
    except InputError as error:
        sentence = as_options(str(error))
    except OSError as error:
        if error.filename is not None:  # moved, removed or covered meanwhile, or no possible name
            sentence = f"{printable(str(error.filename))}: cannot be used ({error.strerror})"
        elif error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO):
            sentence = end_of_output(error)
        else:
            raise
    except MemoryError as error:
        sentence = f"not enough memory ({' '.join(str(error).split()) or 'no details'})"
    except RuntimeError as error:
        if str(error) != NO_THREAD:
            raise
        sentence = (
            "cannot start a further thread: "
            "this user's processes and threads are at their limit (ulimit -u)"
        )
    except SystemExit as end:
        if end.code == INTERRUPTED:
            warn(KEPT)
        raise
    except (KeyboardInterrupt, ImportError) as error:  # while libraries are loaded
        if not interrupted(error):
            raise
        warn(KEPT)
        sys.exit(INTERRUPTED)
    else:
        return
    warn(sentence)
    sys.exit(WRONG_INPUT)
