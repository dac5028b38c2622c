"""Directions in which the active constraints of an own program leave its unknowns."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from lampest.formulation.instance import Instance, ProgramResult, on_bounds
from lampest.panel.panel import Array, Mask

SLOPE_ROUNDING = 1e-10  # of the unit of costs: a slope that may be the rounding of its parts
# Factor on the multiplier that the curvature alone would make; a larger one holds its unknown at
# a bound.
CLEAR = 10.0


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions in which the active constraints leave the unknowns.

    Attributes
    ----------
    held : boolean array, shape (unknowns,)
        Unknowns that a bound holds.
    follows : boolean array, shape (unknowns,)
        Voltages, which follow the other unknowns by the balance of currents.
    active : boolean array, shape (constraints,)
        Equations, and inequalities at a limit.
    leading : array, shape (unknowns, m)
        A column for each unknown that neither is held nor follows, with the voltages that follow.
    rows : array, shape (active constraints beside the balance, m)
        Jacobian of the other active constraints by the leading unknowns.
    basis : array, shape (unknowns, n)
        Z.
    """

    held: Mask
    follows: Mask
    active: Mask
    leading: Array
    rows: Array
    basis: Array

    @classmethod
    def of(
        cls,
        instance: Instance,
        result: ProgramResult,
        equations: Array,
        jacobian: scipy.sparse.csc_array,
        hessian: scipy.sparse.csc_array,
    ) -> "Directions":
        """Return the directions along the active constraints at a result.

        Unknowns at a bound stay, voltages follow the cells by the balance of currents, and the
        other active constraints leave the null space of their rows.

        Parameters
        ----------
        instance : Instance
        result : ProgramResult
        equations : array, shape (constraints,)
            Values of the constraints.
        jacobian : sparse array, shape (constraints, unknowns)
        hessian : sparse array, shape (unknowns, unknowns)
            ∇²L.
        """
        program = instance.program
        x = result.unknown
        names = np.repeat([*program.unknown.sizes], [*program.unknown.sizes.values()])
        follows = np.isin(names, [*program.network.voltages])
        balance = program.equation.sizes["balance"]
        by_voltage = scipy.sparse.linalg.splu(jacobian[:balance, follows])
        leads = np.flatnonzero(~follows)
        leading = np.zeros((len(x), len(leads)))
        leading[leads, np.arange(len(leads))] = 1.0
        leading[follows] = -by_voltage.solve(jacobian[:balance, leads].toarray())
        # A multiplier that a move off the bound by its distance would make holds nothing.
        curvature = np.zeros(len(x))
        curvature[leads] = np.sum(leading * (hessian @ leading), axis=0)
        multipliers = result.of_bounds / np.maximum(CLEAR * np.abs(curvature), SLOPE_ROUNDING)
        held = _held(x, multipliers, instance.lower, instance.upper)
        # The smaller one of p and q is at its bound, because their sum costs.
        place = int(np.argmax(names == "split"))
        for part in program.lowered:
            for side in part.split[:1]:
                first = place + np.arange(side.shape[0])
                second = first + side.shape[0]
                held[np.where(x[first] < x[second], first, second)] = True
                place += 2 * side.shape[0]
        leading = leading[:, ~held[leads]]
        active = _held(equations, result.of_equations, *instance.equations)
        rows = jacobian[balance + np.flatnonzero(active[balance:])] @ leading
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        basis = leading
        if len(rows):
            basis = leading @ scipy.linalg.null_space(rows / np.where(size > 0, size, 1.0))
        return cls(held, follows, active, leading, rows, basis)


def _held(value: Array, multiplier: Array, low: Array, high: Array) -> Mask:
    """Return which values a limit holds, see `on_bounds`; equal limits hold always."""
    at_limit = on_bounds(value, multiplier, low, high)
    return np.asarray((low == high) | (at_limit == low) | (at_limit == high))
