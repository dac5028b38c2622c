"""Cells that errors which all frames share press against a bound: how far they, and cells beside them, may be off.

A bound that noise alone makes active holds a cell, and an error z that all readings share moves the free cells only.
Where U z is what pressed the cell there, z drawn otherwise leaves it free. So a cell c at a bound is asked alone,

    t_c ~ N(−slope·v, v + |a|²)  cut off at t_c ≥ 0,    v its variance among the free cells, a what z does to it,

and where |a| is larger than slope·v, it moves together with the free cells when z does. An open cell's t is its
conductance, in units of a typical cell's: of that readings are linear where log r is far from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.posterior.dense import DenseErrors, positive_inverse
from lampest.posterior.interval import one_sided
from lampest.posterior.linear import IGNORANCE


@dataclass(frozen=True, eq=False)
class Pressed:
    """cells : the numbers of those at a bound. below, above : how far in log r their intervals reach into the inside.

    answer : (free, n) what z does to log r of the free cells.
    """

    cells: NDArray[np.intp]
    below: Array
    above: Array
    answer: Array

    @classmethod
    def of(cls, errors: DenseErrors, rows: Array, last: Array, baseline: Array) -> "Pressed":
        """With z's columns in the data (rows, n), and in earlier estimates (cells, n).

        Raises numpy.linalg.LinAlgError where the cost is flat.
        """
        model = errors.model
        free, cells = model.free, np.flatnonzero(model.at_lower | model.at_upper)
        typical = np.exp(np.log(model.at.cell_resistance).ravel()[free].mean()) if len(free) else 1.0
        stretch = np.where(model.at_upper, np.maximum(model.at.cell_resistance.ravel() / typical, 1.0), 1.0)
        stacked, moved = _stacked(errors, rows, last, baseline)
        stacked = stacked * stretch
        own, others = stacked[:, cells], stacked[:, free]
        across = errors.inverse @ (others.T @ own)
        left = np.maximum(np.sum(own**2, axis=0) - np.sum((others.T @ own) * across, axis=0), IGNORANCE * model.scale)
        variance = model.scale / left
        slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
        answer = ((own - others @ across).T @ moved) / left[:, None]
        released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
        together = np.concatenate([free, cells[released]])
        matrix = stacked[:, together].T @ stacked[:, together]
        matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
        joint = positive_inverse(matrix) @ (stacked[:, together].T @ moved)
        answer[released] = joint[len(free) :]
        wide = variance + np.sum(answer**2, axis=1)
        reach = one_sided(slope * variance / wide, wide)[1]
        below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
        return cls(cells, below, np.where(model.at_upper[cells], np.inf, reach), joint[: len(free)])


def _stacked(errors: DenseErrors, rows: Array, last: Array, baseline: Array) -> tuple[Array, Array]:
    """(√Ω [J; Z] (rows, cells), √Ω of what z moves of them (rows, n)): data above penalties."""
    model = errors.model
    data, penalties = np.sqrt(model.data_curvature)[:, None], np.sqrt(model.penalty_curvature)[:, None]
    through = errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties
    known = (model.previous_jacobian, last), (model.baseline_jacobian, baseline)
    carried = sum((rows_known @ moved for rows_known, moved in known if rows_known.nnz), np.zeros((1, rows.shape[1])))
    return np.vstack(through), np.vstack([rows * data, -carried * penalties])
