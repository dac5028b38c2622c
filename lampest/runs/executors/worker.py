"""What a local Dask worker loads when it starts."""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the process that collects the results; Dask calls this by its name."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
