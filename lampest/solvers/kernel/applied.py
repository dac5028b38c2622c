"""The preconditioner of conjugate gradients applied, in machine code."""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code
from lampest.solvers.kernel.algebra import LOWER


@machine_code
def precondition_into(addresses: Any, rows: int, found: Any, moving: Any, values: Any, result: Any) -> None:
    """result ← P⁻¹·values over the moving cells, of what `made_preconditioner` found: B⁻¹(x − V·inner·Vᵀ B⁻¹x)."""
    base, seen, inner, _ = found
    cells, lines = len(values), len(inner) // 2
    result[:] = values
    _base_divided(addresses, base, result)
    if lines > 0:
        columns = lines - rows
        sums, back = np.zeros(2 * lines), np.zeros(2 * lines)
        for cell in range(cells):
            j, k = cell // columns, rows + cell % columns
            for part in range(2):
                share = seen[part, cell] * result[cell]
                sums[part * lines + j] += share
                sums[part * lines + k] += share
        for line in range(2 * lines):
            for other in range(2 * lines):
                back[other] += inner[line, other] * sums[line]
        for cell in range(cells):
            j, k = cell // columns, rows + cell % columns
            pulled = seen[0, cell] * (back[j] + back[k]) + seen[1, cell] * (back[lines + j] + back[lines + k])
            result[cell] = values[cell] - pulled
        _base_divided(addresses, base, result)
    for cell in range(cells):
        result[cell] = result[cell] if moving[cell] else 0.0


@machine_code
def _base_divided(addresses: Any, base: Any, values: Any) -> None:
    """values ← B⁻¹·values of what `made_preconditioner` found."""
    cells, band = len(values), base.shape[1] - 1
    if band == 0:
        for cell in range(cells):
            values[cell] *= base[cell, 0]
        return
    words = np.empty(6, dtype=np.int32)
    words[0], words[1], words[2], words[3], words[4], words[5] = LOWER, cells, band, 1, band + 1, 0
    start = words.ctypes.data
    call(
        addresses[10],
        (start, start + 4, start + 8, start + 12, base.ctypes.data, start + 16, values.ctypes.data, start + 4,
         start + 20),
    )  # fmt: skip
    if words[5] != 0:
        values[0] = np.nan


@machine_code
def preconditioned(addresses: Any, rows: int, base: Any, seen: Any, inner: Any, values: Any) -> Any:
    """(cells) what a preconditioner that `pursue` left makes of values (cells)."""
    result, moving = np.empty(len(values)), np.ones(len(values), dtype=np.int64)
    precondition_into(addresses, rows, (base, seen, inner, True), moving, values, result)
    return result
