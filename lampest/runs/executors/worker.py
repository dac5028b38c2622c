"""What a local Dask worker loads when it starts."""

import signal
from typing import Any

from lampest.files.interrupts import ENDING


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C and a closed terminal to the process that collects the results; Dask calls this by its name."""
    for number in ENDING:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)
