"""Bounds of cells that readings of circuits give.

All are functions of the numbers of a circuit's equation, `lampest.panel.equation.Equation`.
"""

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.panel.circuit import nominal_terminations
from lampest.panel.equation import Equation, equation_of
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.starts import by_uniform_panels, nearly_shorted, uniform_responses
from lampest.panel.readouts.unseen import unseen_scales

LARGEST_OHM = 1e8  # of cells whose scale no reading shows: insulation beside usual ones


def least_cells(circuit: Readout, measured: Array, sigma: Array | None) -> Array:
    """Return lower bounds of the cells, (…, rows, columns) ohm, for readings and their σ.

    Parallel paths lower a two-point resistance, r ≥ R; paper, equation (12). σ is None if it is
    unknown.
    """
    equation = equation_of(circuit, *measured.shape[-2:])
    if equation.terminations.two_point:
        return measured.copy()
    least = nearly_shorted(circuit, measured)
    bound = _least_by_currents(equation, measured, sigma)
    return least if bound is None else np.maximum(bound, least)


def _least_by_currents(equation: Equation, measured: Array, sigma: Array | None) -> Array | None:
    """Return the lower bounds r_ij ≥ u_i/I_i − Rs_j of the cells, where idle lines float.

    Shape (…, rows, columns), ohm. I_i = Σ_j V_ij/Rs_j is the current of the driven line, increased
    by its noise, and u_i = U − Rd_i I_i − V_d its potential. The bound holds because I_i is at
    least the current through each cell and its load alone. Where other lines conduct to ground,
    cells can increase and decrease a reading, r > 0 alone holds, and the result is None. So it is
    where a reading is not the voltage of a load.
    """
    if equation.terminations.at_far_end:
        return None
    table = equation.terminations.sensing
    loaded_or_floating = (table.ohm == equation.sensing.own.ohm) | np.isinf(table.ohm)
    idle_float = np.isinf(equation.driving.base.ohm).all() and loaded_or_floating.all()
    if not (equation.plain and idle_float and np.isfinite(equation.load).all()):
        return None
    volt = equation.volt(measured)
    by_volt = 1 / (equation.gain * equation.load)
    # Upper bound of the current, and with it a lower bound of the potential
    current = equation.sum_together(volt * by_volt)
    if sigma is not None:
        of_volt = equation.volt_sigma(measured, sigma)
        noise = np.where(np.isfinite(of_volt), of_volt, volt) * by_volt
        current = current + NOISE_REACH * np.sqrt(equation.sum_together(noise**2))
    driven = np.maximum(equation.driven_volt(current, equation.drive), 0)
    return driven / current - equation.load


def resolution(circuit: Readout, measured: Array, sigma: Array) -> Array:
    """Return the resolution limit r_max = |∂y_c/∂g_c|/σ at the uniform start.

    Shape (…, rows, columns), in ohm. An open cell in place of a cell of r_max changes its reading
    by the noise σ: r_max = R²/σ of two-point readings. r_max is at least twice the start. Without a
    scale it is that of any cell: no reading says more. Where no closed form gives a cell by its
    reading, it is the largest limit of uniform panels: a press moves the readings of other cells
    beyond those of any uniform panel.
    """
    shape = measured.shape[-2:]
    if unseen_scales(circuit, *shape):
        return np.full(measured.shape, LARGEST_OHM)
    if by_uniform_panels(circuit, measured):
        return uniform_responses(circuit, *shape) / sigma
    start = circuit.uniform_start(measured)
    if nominal_terminations(circuit).two_point:
        return np.maximum(measured**2 / sigma, 2 * start)
    if measured.ndim > 2:
        return np.stack(
            [resolution(circuit, *frame) for frame in zip(measured, sigma, strict=True)]
        )
    response = circuit.network(start, circuit.ties(measured)).own_response()
    # |∂y_c/∂g_c|/σ = |J_cc|/(g σ) = |J_cc|·r/σ
    return np.maximum(np.abs(response) * start / sigma, 2 * start)
