"""What a process may take: one thread for its arrays, and memory, with the sentence where something needs more."""

import ctypes
import os
import re
from contextlib import suppress
from pathlib import Path

import psutil

from lampest.files.errors import InputError

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # small matrices
ALLOWED = "LAMPEST_MEMORY"  # the environment variable by which a user says how much may be taken, such as 8GB
SHARE = 0.9  # of what is free: the rest is for what was not counted
UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
LEFT_BYTES = 2**17  # free ones at the end of what all blocks share; more go back: the C library's own default
LARGE_BYTES = 2**20
GROUP = Path("/sys/fs/cgroup")


def check_memory(needed: float, what: str) -> None:
    """Raise InputError where `what` needs more bytes than there are, with both numbers.

    what : such as 'the lines of a panel of 1 × 60001 cells'.
    """
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
        return float(size[1]) * UNITS[size[2].upper()]
    return SHARE * min(float(psutil.virtual_memory().available), _left_in_container(), _left_of_addresses())


def large_arrays_apart() -> None:
    """Let every array of more than LARGE_BYTES have pages of its own from here on, which go back when it goes.

    Otherwise the C library takes arrays of the size that was freed last from what all blocks share. Between the holes
    of others that grows now and then: by 4 MB in a hundred parts of a long recording. Nothing happens without glibc.
    """
    with suppress(OSError, AttributeError, TypeError):  # TypeError: Windows
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        ctypes.CDLL(None).mallopt(M_TRIM_THRESHOLD, LEFT_BYTES)  # it rose with the arrays that were freed so far


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
        most, taken = ((GROUP / name).read_text().strip() for name in ("memory.max", "memory.current"))
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
