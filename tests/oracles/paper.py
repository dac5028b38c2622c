"""The paper's equations written down a second time, in plain numpy and with loops; shares no code with the package."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forward:
    """R = f(r) and ∂R_i/∂r_l (cells, cells) of a panel; equations (2)-(10)."""

    resistance: Array
    jacobian: Array


def forward(cells: Array) -> Forward:
    """Currents into the lines of every pixel's pair, the last column grounded, one linear system."""
    rows, columns = cells.shape
    conductance_matrix = np.zeros((rows + columns, rows + columns))
    incidence = np.zeros((rows + columns, rows * columns))
    for row in range(rows):
        for column in range(columns):
            line = rows + column
            conductance = 1 / cells[row, column]
            conductance_matrix[row, row] += conductance
            conductance_matrix[line, line] += conductance
            conductance_matrix[row, line] -= conductance
            conductance_matrix[line, row] -= conductance
            incidence[row, row * columns + column] = 1
            incidence[line, row * columns + column] = -1
    potentials = np.linalg.solve(conductance_matrix[:-1, :-1], incidence[:-1])
    drops = incidence[:-1].T @ potentials
    return Forward(np.diag(drops).reshape(rows, columns), (drops / cells.ravel()) ** 2)


def nabla(values: Array) -> tuple[Array, Array]:
    """MATLAB's gradient with unit spacing, down the rows and along the columns; nothing where there is one line."""
    down = np.gradient(values, axis=0) if values.shape[0] > 1 else np.zeros_like(values)
    along = np.gradient(values, axis=1) if values.shape[1] > 1 else np.zeros_like(values)
    return down, along


def penalty(method: str, cells: Array, before: Array | None) -> Array:
    """What λ multiplies the squares of; equations (13), (15), (19) and (21)."""
    if method == "misfit":
        return np.zeros(0)
    if method == "cell_resistance":
        return cells.ravel()
    if method == "gradient":
        return np.concatenate([part.ravel() for part in nabla(cells)])
    change = (cells - before) / before * 100
    if method == "relative_change":
        return change.ravel()
    assert method == "gradient_of_relative_change"
    return np.concatenate([part.ravel() for part in nabla(change)])


def differential(function: Callable[[Array], Array], shape: tuple[int, ...]) -> Array:
    """The matrix of a linear function, column by column."""
    units = np.eye(int(np.prod(shape))).reshape(-1, *shape)
    return np.array([function(unit) for unit in units]).T


def misfits(cells: Array, measured: Array, method: str, weight: float, before: Array | None) -> Array:
    """All residuals whose sum of squares is the objective of one frame."""
    data = (forward(cells).resistance - measured).ravel()
    return np.concatenate([data, np.sqrt(weight) * penalty(method, cells, before)])


def misfits_jacobian(cells: Array, method: str, weight: float, before: Array | None) -> Array:
    """∂misfits/∂r."""
    linear = differential(lambda unit: penalty(method, unit, before) - penalty(method, 0 * unit, before), cells.shape)
    return np.vstack([forward(cells).jacobian, np.sqrt(weight) * linear.reshape(-1, cells.size)])


def pair_misfits(cells: Array, measured: Array, method: str, weight: float) -> Array:
    """The same for the joint first pair; equations (15) and (21). cells, measured: (2, rows, columns)."""
    data = [(forward(frame).resistance - reading).ravel() for frame, reading in zip(cells, measured, strict=True)]
    return np.concatenate([*data, np.sqrt(weight) * penalty(method, cells[1], cells[0])])


def pair_jacobian(cells: Array, method: str, weight: float) -> Array:
    """∂pair_misfits/∂(r0, r1); the change is 100·(r1/r0 − 1), so ∂/∂r1 = 100/r0 and ∂/∂r0 = −100·r1/r0²."""
    first, second = cells
    size = first.size
    linear = differential(lambda unit: penalty(method, unit, first) - penalty(method, 0 * unit, first), first.shape)
    through_second = np.sqrt(weight) * linear
    through_first = -through_second * (second / first).ravel()
    blank = np.zeros((size, size))
    return np.block(
        [[forward(first).jacobian, blank], [blank, forward(second).jacobian], [through_first, through_second]]
    )


def minimise(
    residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], start: Array, lower: Array, upper: Array
) -> Array:
    """The paper's solver: trust region reflective, here SciPy's."""
    shape = start.shape
    span = upper - lower
    solution = least_squares(
        lambda x: residuals(x.reshape(shape)),
        np.clip(start, lower + 1e-6 * span, upper - 1e-6 * span).ravel(),
        lambda x: jacobian(x.reshape(shape)),
        (lower.ravel(), upper.ravel()),
        x_scale=start.ravel(),
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-12,
        max_nfev=500,
    )
    return np.asarray(solution.x).reshape(shape)
