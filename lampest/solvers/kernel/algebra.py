"""Products, factors and inverses of small matrices in machine code, by BLAS and LAPACK where they pay."""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code

LOWER, TRANSPOSED, PLAIN = ord("L"), ord("T"), ord("N")


@machine_code
def product_into(addresses: Any, one: Any, turned: bool, other: Any, other_turned: bool, result: Any) -> None:
    """result = A·B, of either its transpose where it is `turned`."""
    add_product(addresses, 1.0, one, turned, other, other_turned, 0.0, result)


@machine_code
def add_product(
    addresses: Any, share: float, one: Any, turned: bool, other: Any, other_turned: bool, left: float, result: Any
) -> None:
    """result = share·A·B + left·result; all may be parts of matrices. BLAS reads rows as columns."""
    rows, columns = result.shape
    inner = one.shape[0] if turned else one.shape[1]
    words, factors = np.empty(8, dtype=np.int32), np.empty(2)
    words[0] = TRANSPOSED if other_turned else PLAIN
    words[1] = TRANSPOSED if turned else PLAIN
    words[2], words[3], words[4] = columns, rows, inner
    words[5], words[6], words[7] = other.strides[0] // 8, one.strides[0] // 8, result.strides[0] // 8
    factors[0], factors[1] = share, left
    start, unit = words.ctypes.data, factors.ctypes.data
    call(
        addresses[7],
        (start, start + 4, start + 8, start + 12, start + 16, unit, other.ctypes.data, start + 20,
         one.ctypes.data, start + 24, unit + 8, result.ctypes.data, start + 28),
    )  # fmt: skip
    factors[0] = words[0]


@machine_code
def add_matrix(matrix: Any, more: Any, turned: bool) -> None:
    """matrix += A, or Aᵀ."""
    for one in range(len(matrix)):
        for other in range(len(matrix)):
            matrix[one, other] += more[other, one] if turned else more[one, other]


@machine_code
def cholesky_factored(addresses: Any, matrix: Any) -> bool:
    """The upper triangle of a matrix to that of its Cholesky factor, in place; whether it is positive definite."""
    words = np.empty(3, dtype=np.int32)
    words[0], words[1], words[2] = LOWER, len(matrix), 0
    start = words.ctypes.data
    if len(matrix) > 0:
        call(addresses[5], (start, start + 4, matrix.ctypes.data, start + 4, start + 8))
    return bool(words[2] == 0)


@machine_code
def cholesky_divided(addresses: Any, factor: Any, right: Any) -> None:
    """right ← (the matrix of a factor)⁻¹·right."""
    words = np.empty(4, dtype=np.int32)
    words[0], words[1], words[2], words[3] = LOWER, len(factor), 1, 0
    start = words.ctypes.data
    if len(factor) > 0:
        call(
            addresses[6],
            (start, start + 4, start + 8, factor.ctypes.data, start + 4, right.ctypes.data, start + 4, start + 12),
        )
    if words[3] != 0:
        right[0] = np.nan


@machine_code
def dot_of(one: Any, other: Any) -> float:
    total = 0.0
    for number in range(len(one)):
        total += one[number] * other[number]
    return total


@machine_code
def band_factored(addresses: Any, base: Any) -> bool:
    """A banded matrix, (size, band + 1) downwards from its diagonal, to its Cholesky factor; whether it is definite."""
    words = np.empty(5, dtype=np.int32)
    words[0], words[1], words[2], words[3], words[4] = LOWER, len(base), base.shape[1] - 1, base.shape[1], 0
    start = words.ctypes.data
    call(addresses[9], (start, start + 4, start + 8, base.ctypes.data, start + 12, start + 16))
    return bool(words[4] == 0)


@machine_code
def symmetric_divided(addresses: Any, matrix: Any, right: Any) -> bool:
    """right ← A⁻¹·right, symmetric both; A is overwritten. Whether A has an inverse."""
    words, pivots = np.empty(2, dtype=np.int32), np.empty(len(matrix), dtype=np.int32)
    words[0], words[1] = len(matrix), 0
    start = words.ctypes.data
    call(
        addresses[11],
        (start, start, matrix.ctypes.data, start, pivots.ctypes.data, right.ctypes.data, start, start + 4),
    )
    return bool(words[1] == 0 and pivots[0] > 0)
