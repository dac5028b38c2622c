"""How many digits are right: log relative errors, a forward map of 50 digits, and an estimate found in another way."""

from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from lampest.files.errors import InputError
from lampest.panel.panel import Array

MOST_DIGITS = 15.0
DIGITS = 50
MOST_STEPS, FINE = 500, 1e-13


def correct_digits(found: Array, certified: Array) -> float:
    """LRE = −log10(|found − certified|/|certified|), the least of all entries, between 0 and 15.

    Entries that are infinite or zero in both are right; NaN where anything is no number. Source: NIST StRD.
    """
    if np.any(np.isnan(found)) or np.any(np.isnan(certified)):
        return float("nan")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        error = np.where(found == certified, 0.0, np.abs(found / certified - 1))
        worst = float(np.max(np.where(np.isnan(error), np.inf, error), initial=0.0))
        return float(np.clip(-np.log10(worst), 0.0, MOST_DIGITS))


def fifty_digits(cells: Array) -> Array:
    """R = f(r) of (rows, columns) ohm by elimination in 50 digits; cells positive, infinite ones open, zeros shorts.

    Lines that nothing connects have R = inf. Raises InputError where mpmath is not installed.
    """
    mpmath = _library()
    rows = len(cells)
    resistance = np.empty(cells.shape)
    with mpmath.workdps(DIGITS):
        for members in _components(cells):
            inverse = _grounded_inverse(mpmath, cells, members)
            for row in (line for line in members if line < rows):
                for column in (line for line in members if line >= rows):
                    j, k = members.index(row), members.index(column)
                    value = inverse[j][j] + inverse[k][k] - 2 * inverse[j][k]
                    resistance[row, column - rows] = float(value)
        apart = _apart(cells)
    resistance[apart] = np.inf
    resistance[cells == 0] = 0.0
    return resistance


def _library() -> Any:
    try:
        import mpmath
    except ModuleNotFoundError as error:
        raise InputError("the atlas needs mpmath: pip install 'lampest[extremes]'") from error
    return mpmath


def _labels(cells: Array) -> list[int]:
    """The component of every line, rows first."""
    rows, columns = cells.shape
    label = list(range(rows + columns))
    for row, column in np.argwhere(np.isfinite(cells)):
        keep, gone = label[row], label[rows + column]
        label = [keep if own == gone else own for own in label]
    return label


def _components(cells: Array) -> list[list[int]]:
    label = _labels(cells)
    return [[line for line, own in enumerate(label) if own == one] for one in dict.fromkeys(label)]


def _apart(cells: Array) -> Array:
    label = np.array(_labels(cells))
    return np.asarray(label[: len(cells), None] != label[None, len(cells) :])


def _grounded_inverse(mpmath: Any, cells: Array, members: list[int]) -> list[list[Any]]:
    """(L without its first line)⁻¹ of some lines, with zeros for that line; a short stands for 10⁻²⁵ ohm."""
    rows = len(cells)
    size = len(members)
    matrix = [[mpmath.mpf(0)] * size for _ in members]
    for one, row in enumerate(members):
        for other, column in enumerate(members):
            if row < rows <= column and np.isfinite(cells[row, column - rows]):
                ohm = float(cells[row, column - rows])
                conductance = 1 / mpmath.mpf(ohm) if ohm else mpmath.mpf(10) ** 25
                for here, there in ((one, other), (other, one)):
                    matrix[here][here] += conductance
                    matrix[here][there] -= conductance
    inner = [line[1:] for line in matrix[1:]]
    for pivot, line in enumerate(inner):
        reciprocal, line[pivot] = 1 / line[pivot], mpmath.mpf(1)
        line[:] = [value * reciprocal for value in line]
        for number, own in enumerate(inner):
            if number != pivot and own[pivot]:
                factor, own[pivot] = own[pivot], mpmath.mpf(0)
                own[:] = [value - factor * part for value, part in zip(own, line, strict=True)]
    return [[mpmath.mpf(0)] * size, *([mpmath.mpf(0), *line] for line in inner)]


def convex_estimate(measured: Array) -> Array | None:
    """r = 1/g*, g* = argmin ⟨R_m, g⟩ − log det C(g): the cells (rows, columns) that reproduce readings exactly.

    None where readings cannot be reproduced by positive cells, or double precision does not get there. Damped Newton on
    a self-concordant function, so no line search; shares no code with the solvers.
    Source: Nesterov & Nemirovskii, Interior-Point Polynomial Algorithms in Convex Programming, 1994.
    """
    rows, columns = measured.shape
    incidence = np.zeros((rows + columns, rows * columns))
    for cell, (row, column) in enumerate(np.ndindex(rows, columns)):
        incidence[row, cell], incidence[rows + column, cell] = 1.0, -1.0
    incidence = incidence[1:]
    scale = float(np.exp(np.mean(np.log(measured))))
    goal = measured.ravel() / scale
    conductance = (rows + columns - 1) / (rows * columns) / goal
    for _ in range(MOST_STEPS):
        try:
            drop = incidence.T @ cho_solve(cho_factor((incidence * conductance) @ incidence.T), incidence)
            slope = goal - np.diag(drop)
            size = 1 / np.diag(drop)  # makes the diagonal of the scaled Hessian one
            step = -size * cho_solve(cho_factor(drop**2 * size[:, None] * size), size * slope)
        except LinAlgError:
            return None
        decrement = float(np.sqrt(max(-slope @ step, 0.0)))
        if np.max(np.abs(slope / goal)) < FINE or decrement < FINE:
            break
        conductance = conductance + step / (1 + decrement if decrement > 0.25 else 1)
    if np.any(conductance <= 0) or np.max(np.abs(slope / goal)) > 1e3 * FINE:
        return None
    return np.asarray(scale / conductance).reshape(rows, columns)
