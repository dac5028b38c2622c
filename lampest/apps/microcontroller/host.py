"""The C library on this machine: compiled with its constants, and run on frames."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lampest.apps.microcontroller.constants import Budget, Constants, Sums
from lampest.apps.microcontroller.header import header
from lampest.apps.microcontroller.library import library_folder, sources
from lampest.files.errors import InputError
from lampest.panel.panel import Array

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")
# Calls the library with budgets that vary, and gives its numbers as plain arrays.
HOST = """
#include "panel_constants.h"
#include <string.h>
static lampest_constants varied;
lampest_panel host_panel = {.constants = &varied};
static float memory[PANEL_MEMORY];
int host_bytes(void) { return sizeof memory + sizeof host_panel; }
int host_begin(int steps, int products, float within) {
    varied = panel_constants;
    varied.steps = steps, varied.products = products, varied.within = within;
    return lampest_begin(&host_panel, memory);
}
static void put(lampest_status s, float *numbers) {
    const float values[] = {s.outcome, s.settled, s.steps, s.products, s.saturated, s.missing, s.dead_line, s.left};
    memcpy(numbers, values, sizeof values);
}
void host_frame(const uint32_t *sums, float *change, float *numbers) {
    put(lampest_frame(&host_panel, sums, change), numbers);
}
void host_baseline(const uint32_t *sums, float *change, float *numbers) {
    (void)change;
    put(lampest_baseline(&host_panel, sums), numbers);
}
int host_follow(void) { return lampest_follow(&host_panel); }
float host_deviation(int row, int column, int products) {
    return lampest_deviation(&host_panel, row, column, products);
}
"""  # noqa: E501


def compiler() -> str | None:
    """Return the C compiler of this machine, or None."""
    return next((path for path in map(shutil.which, COMPILERS) if path), None)


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of the library to frames.

    Attributes
    ----------
    log_change : array, shape (frames, rows, columns)
    outcome, settled, steps, products, saturated, missing, dead_line, left : array, shape (frames,)
        The fields of `lampest_status`.
    """

    log_change: Array
    outcome: Array
    settled: Array
    steps: Array
    products: Array
    saturated: Array
    missing: Array
    dead_line: Array
    left: Array


@dataclass(frozen=True, eq=False)
class Host:
    """The compiled library with the constants of one panel."""

    library: Any
    shape: tuple[int, int]

    @property
    def bytes(self) -> int:
        """Working memory in bytes, without constants."""
        return int(self.library.host_bytes())

    def begin(self, budget: Budget) -> int:
        """Start from the baseline of the constants; return the outcome."""
        return int(
            self.library.host_begin(budget.steps, budget.products, ctypes.c_float(budget.within))
        )

    def frame(self, sums: Sums) -> tuple[Array, Array]:
        """Process one frame.

        Returns
        -------
        log_change : array, shape (rows, columns)
        status : array, shape (8,)
        """
        return self._call(self.library.host_frame, sums)

    def baseline(self, sums: Sums) -> Array:
        """Add a frame to the baseline, and return its status (8,)."""
        return self._call(self.library.host_baseline, sums)[1]

    def follow(self) -> bool:
        """Let the baseline follow the last frame; return whether it moved."""
        return bool(self.library.host_follow())

    def deviation(self, row: int, column: int, products: int) -> float:
        """Return the standard deviation of ln r of a cell."""
        return float(self.library.host_deviation(row, column, products))

    def frames(self, sums: Sums, budget: Budget) -> Answers:
        """Return the answers to frames (frames, rows, columns) from the baseline on."""
        if outcome := self.begin(budget):
            raise InputError(f"the C library refuses its constants (outcome {outcome})")
        changes, statuses = zip(*map(self.frame, sums), strict=True)
        return Answers(np.array(changes), *np.array(statuses).T)

    def _call(self, function: Any, sums: Sums) -> tuple[Array, Array]:
        """Call a function of the C library with sums of codes, (rows, columns).

        Returns
        -------
        change : array, shape (rows, columns)
            ln r/r0; zeros of a function that gives none.
        status : array, shape (8,)
        """
        held = np.ascontiguousarray(sums, np.uint32)
        change = np.zeros(self.shape, np.float32)
        status = np.zeros(8, np.float32)
        function(*(array.ctypes.data_as(ctypes.c_void_p) for array in (held, change, status)))
        return change.astype(float), status.astype(float)


@contextmanager
def compiled(constants: Constants, *flags: str, program: str = "") -> Iterator[Host]:
    """Compile the library with constants, and with C text of its caller.

    Raises InputError without a compiler.
    """
    command = compiler()
    if command is None:
        raise InputError(
            "no C compiler here (cc, gcc or clang), with which the trade of budgets is measured"
        )
    with tempfile.TemporaryDirectory(prefix="lampest-") as name:
        place = Path(name)
        (place / "panel_constants.h").write_text(header(constants, "panel", ()), encoding="ascii")
        (place / "host.c").write_text(HOST + program, encoding="ascii")
        files = [f"{path}" for path in (place / "host.c", *sources()) if path.suffix == ".c"]
        build = [command, *FLAGS, *flags, f"-I{library_folder()}", *files]
        try:
            done = subprocess.run(
                [*build, "-o", f"{place}/host.so", "-lm"],
                capture_output=True,
                text=True,
                check=False,
            )
        except OSError as error:
            raise InputError(f"{command} cannot be started ({error.strerror or error})") from error
        if done.returncode:
            raise InputError(
                f"{command} does not compile the C library: {done.stderr.strip().splitlines()[:1]}"
            )
        library = ctypes.CDLL(f"{place}/host.so")
    # The folder is gone while the library is used, so that nothing remains of a process that is
    # killed then.
    library.host_deviation.restype = ctypes.c_float
    yield Host(library, constants.scene.panel.shape)
