"""Cells of a driven circuit by alternation of potentials and cells, a start for solvers.

The cells determine the potentials u_p of all driven lines p while i is driven and j is read. Given
these potentials, Σ_p g_pj (u_p − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line. The
alternation converges in about six rounds, and in up to 40 for large Rd. Where idle lines have
potentials of their own, it moves away from the cells, and ends as soon as a round changes more than
the one before. Conductances stay within MIN_RATIO and MAX_RATIO of those of the closed form.
"""

import numpy as np

from lampest.panel.difference_network import excitations
from lampest.panel.equation import Equation
from lampest.panel.kirchhoff import laplacian
from lampest.panel.lines import of_side
from lampest.panel.panel import Array

# Rounds, change of log g at convergence, and range of conductances about those of the closed form,
# beyond which a reading no longer depends on its cell (tests/oracles).
MAX_ROUNDS = 40
CONVERGED = 1e-3
MIN_RATIO = 0.02
MAX_RATIO = 1e3


def alternated_cells(
    equation: Equation, ties: Array, measured: Array, uniform: Array, near: Array | None
) -> Array:
    """Return the cells, (rows, columns) ohm, by alternation of potentials and cells.

    Parameters
    ----------
    equation : Equation
        Numbers of the circuit on a panel.
    ties : array, shape (lines,) or (addresses, lines)
        Ties of the panel's lines to ground, siemens.
    measured : array, shape (rows, columns)
        Voltages at the converter, volt.
    uniform : array, same shape
        Cells of the closed form, ohm.
    near : array, same shape, or None
        Cells at which the alternation begins; None: at those of the closed form.
    """
    load = equation.sensing.own.ohm
    volt = _turned(equation, measured / equation.gain)
    ideal = _turned(equation, 1 / uniform)
    least = MIN_RATIO * ideal
    most = MAX_RATIO * ideal
    conductance = ideal if near is None else np.clip(_turned(equation, 1 / near), least, most)
    change = np.inf
    for _ in range(MAX_ROUNDS):
        potentials = _driven_potentials(equation, ties, conductance, volt)
        previous = conductance
        previous_change = change
        # One linear system for each sensed line j: rows i (driven while j is read), unknowns
        # g_pj.
        matrices = potentials - volt.T[:, :, None]
        solved = np.linalg.solve(matrices, (volt / load).T[:, :, None])
        conductance = np.clip(solved[:, :, 0].T, least, most)
        change = float(np.abs(np.log(conductance / previous)).max())
        if change < CONVERGED or change > previous_change:
            break
    return _turned(equation, 1 / conductance)


def _turned(equation: Equation, values: Array) -> Array:
    """Return values (rows, columns) as (driven, sensed), or the reverse."""
    return values if equation.terminations.driven == "rows" else values.T


def _driven_potentials(equation: Equation, ties: Array, conductance: Array, volt: Array) -> Array:
    """Return the potentials of driven lines p while j is read and i is driven.

    Shape (sensed j, driven i, driven p), volt.

    Parameters
    ----------
    equation, ties
        As those of `alternated_cells`.
    conductance, volt : array, shape (driven, sensed)
        Siemens, and voltages of the sensed lines.
    """
    source = equation.source
    count = len(conductance)
    if equation.together is None and np.isinf(equation.driving.base.ohm).all():
        # No current through floating lines, u_p Σ_j g_pj = Σ_j g_pj v_ij; Σ_j v_ij/Rs_j through
        # the driven one
        potentials = (volt @ conductance.T) / conductance.sum(axis=1)
        # The driven line is above every sensed one: a lower limit against noise.
        current = (volt / equation.sensing.own.ohm).sum(axis=1)
        driven = equation.driven_volt(current, equation.driving.own.ohm)
        np.fill_diagonal(potentials, np.maximum(driven, volt.max(axis=1) * (1 + 1e-6)))
        return np.asarray(potentials[None])
    by_load = _turned(equation, equation.load_terms[1])
    result = np.empty((volt.shape[1], count, count))
    for of_address, read in zip(np.atleast_2d(ties), equation.read_at, strict=True):
        sides = np.split(of_address, [read.shape[0]])
        in_order = np.concatenate(of_side(equation.terminations.driven, *sides))
        entries, excited = excitations(laplacian(conductance), in_order)
        mutual = entries[:count, count:]
        own = np.diag(entries)
        solved = own[:count, None], own[None, count:], mutual
        terms = equation.determinant(*(_turned(equation, entry) for entry in solved))
        _, of_load, determinant = (_turned(equation, term) for term in terms)
        # Excitations of both lines, (driven i, sensed j), and the potentials of driven lines
        # that follow from them
        excitation_driven = source * of_load / determinant
        excitation_sensed = -source * by_load * mutual / determinant
        lines = excitation_driven.T[:, :, None] * excited[None, :count, :count]
        lines = lines + excitation_sensed.T[:, :, None] * excited[count:, None, :count]
        chosen = _turned(equation, read)[0] > 0
        result[chosen] = lines[chosen]
    return result
