"""What readings of a circuit tell of cells before a solve: starts, bounds, and unseen scales.

All are functions of a circuit whose lines end as `lampest.panel.circuit` says. Starts are closed
forms, uniform panels, or panels that give the readings exactly.

A direction in which no reading changes is a null vector of J = ∂y/∂ln r. The vector belongs to the
circuit, not to the cells: inputs without any resistor, with idle lines held at ground, read a mean
of potentials weighted by the conductances of a column, and a factor on the column changes none of
them. One search at scattered cells finds it for a circuit.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.panel.circuit import CircuitOfLines, nominal_terminations
from lampest.panel.equation import Equation, equation_of
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import branches
from lampest.panel.readouts.branches import LEVELS, MAX_CELLS, MIN_FOLD
from lampest.panel.readouts.floating import convex_start, uniform_factor
from lampest.panel.readouts.wiring import Wiring

UNIFORM_LEVELS = 140  # of uniform panels, from 10 ohm to 100 Mohm: 12 % from one to the next
UNIFORM_KNOTS = 48  # of these levels that networks are solved for; the others are interpolated
USUAL_OHM = 10_000.0  # of cells whose scale no resistor sets
MIN_LOAD_SHARE = 1e-3  # of a load: least apparent resistance, for readings at the end of the range
# Of the apparent resistance: readings of such a cell differ by a millionth from those of a short.
SHORT_SHARE = 1e-6
OPEN_SHARE = 1e-9  # share of the supply below which a reading shows an open cell
Scale = Literal["all", "rows", "columns"]
TYPICAL_OHM = 3000.0
SCATTER = 0.5  # of ln r, so that no direction is null by symmetry
MAX_LINES = 8  # of a side: a circuit without lists has the same null vectors at any size
MAX_LISTED_CELLS = 400  # of a circuit with lists
NULL = 1e-6  # singular value over the largest; of readings that are shown 0.01 and more
WITHIN = 0.9  # share of a scale's square that lies in the null space
LARGEST_OHM = 1e8  # of cells whose scale no reading shows: insulation beside usual ones


class SolvableCircuit(CircuitOfLines, Protocol):
    """Interface of a readout whose cells are searched for."""

    def ties(self, measured: Array) -> Array:
        """Return the ties of the lines, see `Readout.ties`."""

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network, see `Readout.network`."""

    def uniform_start(self, measured: Array) -> Array:
        """Return cells (…, rows, columns) ohm as if all were equal."""

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return the readings of cells (…, rows, columns) ohm."""


def _equation(circuit: CircuitOfLines, measured: Array) -> Equation:
    """Return the numbers of the equation for readings (…, rows, columns)."""
    return equation_of(circuit, *measured.shape[-2:])


def _reference(equation: Equation) -> Array:
    """Return the resistor Rs that scales a reading, (rows, columns) ohm.

    Where no resistor sets the scale of cells, the usual resistance of cells takes its place.
    """
    return np.where(np.isfinite(equation.load), equation.load, USUAL_OHM)


def apparent_resistance(circuit: SolvableCircuit, measured: Array) -> Array:
    """Return the resistance of a single divider with a reading, (…, rows, columns) ohm.

    For a reading V the resistance is Rs·((U − V_d)·c/V − 1) − Rd.
    """
    equation = _equation(circuit, measured)
    if equation.terminations.as_resistance:
        return measured
    if by_uniform_panels(circuit, measured):
        return _of_uniform_panels(circuit, measured)
    load = _reference(equation)
    volt = np.maximum(measured, OPEN_SHARE * equation.source) / equation.gain
    # (U − V_d)/I with the current I = V/(c·Rs): the sum of cell, load and drive
    total = load * (equation.source - equation.lost(volt / load)) / volt
    return np.maximum(total - load - equation.drive, MIN_LOAD_SHARE * total)


def uniform_start(circuit: SolvableCircuit, measured: Array) -> Array:
    """Return r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij, (…, rows, columns) ohm, for idle lines at ground.

    The formula is exact for Rd = Rp = 0, where no sensed line depends on another one or on its
    load. Where idle lines float, or are at ground through more than a cell has, the start is the
    apparent resistance.
    """
    equation = _equation(circuit, measured)
    if by_uniform_panels(circuit, measured):
        return _of_uniform_panels(circuit, measured)
    if equation.floating:
        return apparent_resistance(circuit, measured) / uniform_factor(*measured.shape[-2:])
    if not equation.grounded:
        apparent = apparent_resistance(circuit, measured)
        if np.mean(equation.driving.base.ohm) > np.median(apparent):
            return apparent
    driven = -2 if equation.terminations.driven == "rows" else -1
    # Voltages over the supply, with a lower limit for open cells.
    share = equation.volt(measured) / (equation.source * equation.gain)
    share = np.maximum(share, OPEN_SHARE * share.max(axis=(-2, -1), keepdims=True))
    remainder = 1 - share.sum(axis=driven, keepdims=True)
    # A negative remainder is noise, or the substitute of a dead line. Then the load counts as one
    # more cell.
    remainder = np.where(remainder > MIN_LOAD_SHARE, remainder, 1 / (1 + share.shape[driven]))
    return np.asarray(_reference(equation) * remainder / share)


def by_uniform_panels(circuit: SolvableCircuit, measured: Array) -> bool:
    """Return whether no closed form gives a cell by its reading, but a uniform panel does."""
    equation = _equation(circuit, measured)
    if equation.plain and np.isfinite(equation.load).all():
        return False
    return not unseen_scales(circuit, *measured.shape[-2:])


def _of_uniform_panels(circuit: SolvableCircuit, measured: Array) -> Array:
    """Return the uniform panels that come nearest to each reading, (…, rows, columns) ohm."""
    levels, readings = uniform_readings(circuit, *measured.shape[-2:])
    distance = np.abs(readings - measured[..., None, :, :])
    return np.asarray(levels[np.argmin(distance, axis=-3)])


def start(
    circuit: SolvableCircuit,
    measured: Array,
    limits: tuple[Array, Array],
    near: Array | None = None,
) -> Array:
    """Return cells that reproduce the readings, (rows, columns) ohm.

    Newton's method starts from the earlier estimate, from the uniform panels of the readings where
    there are several, or from the uniform start. Without loads the equations of floating lines
    determine ratios of cells alone, and the start is that of the convex function.
    """
    equation = _equation(circuit, measured)
    if equation.floating:
        return convex_start(apparent_resistance(circuit, measured), limits, near)
    upper = limits[1]
    panels = uniform_branches(circuit, measured, upper) if near is None else []
    if not panels:
        first = uniform_start(circuit, measured) if near is None else near
        if near is None and by_uniform_panels(circuit, measured):
            first = np.full(measured.shape, np.median(first))
        panels = _panels_from(circuit, measured, [first], upper)
    return panels[0][1] if panels else np.minimum(uniform_start(circuit, measured), upper)


def nearly_shorted(circuit: SolvableCircuit, measured: Array) -> Array:
    """Return cells that count as shorts, (…, rows, columns) ohm.

    A share of the uniform start bounds them, too, because with idle lines at ground the apparent
    resistance is many times too large. So is the nearest uniform panel where a reading lies beyond
    those of all.
    """
    cells = circuit.uniform_start(measured)
    if by_uniform_panels(circuit, measured):
        return SHORT_SHARE * np.minimum(cells, USUAL_OHM)
    return SHORT_SHARE * np.minimum(apparent_resistance(circuit, measured), cells)


def several_panels(circuit: SolvableCircuit, rows: int, columns: int) -> bool:
    """Return whether readings rise and fall with the conductance of the cells.

    The readings of usual cells may then be those of quite different cells, too: idle lines hold
    the driven one harder than its driver does. The readings of uniform panels show it.
    """
    # Where the driven line has no resistance, or no idle line is held, readings only rise
    if not nominal_terminations(circuit).driving.ohm.diagonal().any():
        return False
    equation = equation_of(circuit, rows, columns)
    sensing = equation.sensing
    # All sensed lines have the load of the one that is read where nothing else holds them.
    held = np.isfinite(equation.driving.base.ohm).any() or np.any(
        np.isfinite(sensing.bases.ohm) & (sensing.bases.ohm != sensing.own.ohm)
    )
    if not held or unseen_scales(circuit, rows, columns):
        return False
    medians = log_medians(circuit, rows, columns)
    return bool(medians.max() - medians[0] > MIN_FOLD)


def panels_beyond_folds(
    circuit: SolvableCircuit,
    measured: Array,
    limits: tuple[Array, Array],
    tolerance: float,
    firsts: Sequence[Array] = (),
) -> list[Array]:
    """Return panels that give readings, (rows, columns) ohm each.

    The result is empty for circuits that do not have `several_panels`.

    Parameters
    ----------
    circuit : SolvableCircuit
    measured : array, shape (rows, columns)
        Readings; those that are NaN do not count.
    limits : tuple of two arrays, shape (rows, columns)
        Smallest and largest resistances, ohm; equal where a cell is known.
    tolerance : float
        Largest root mean square of the differences to them, over the median reading.
    firsts : sequence of array, shape (rows, columns)
        Cells at which searches begin, in addition to uniform ones, ohm.
    """
    if measured.size > MAX_CELLS or not several_panels(circuit, *measured.shape):
        return []
    positive = _positive(measured)
    uniform = branches.uniform_panels(log_medians(circuit, *measured.shape), positive)
    return branches.every_panel(
        lambda cells: circuit.network(cells, circuit.ties(measured)),
        positive,
        [*firsts, *uniform],
        limits,
        tolerance,
        0 if _equation(circuit, measured).terminations.driven == "rows" else 1,
    )


def uniform_branches(
    circuit: SolvableCircuit, measured: Array, upper: Array | float = np.inf
) -> list[tuple[float, Array]]:
    """Return the panels that give readings, the most probable one first.

    A panel is ln p and cells (rows, columns) of at most `upper` ohm. The list is empty where
    uniform panels give the median reading with one resistance alone; see
    `lampest.panel.readouts.branches`.
    """
    if _equation(circuit, measured).floating or unseen_scales(circuit, *measured.shape):
        return []
    medians = log_medians(circuit, *measured.shape)
    firsts = branches.uniform_panels(medians, _positive(measured))
    return _panels_from(circuit, measured, firsts, upper) if len(firsts) > 1 else []


def _positive(measured: Array) -> Array:
    """Return readings whose logarithms are finite, those that are NaN excepted."""
    return np.maximum(measured, OPEN_SHARE * np.nanmax(measured))


def _panels_from(
    circuit: SolvableCircuit, measured: Array, firsts: Sequence[Array], upper: Array | float
) -> list[tuple[float, Array]]:
    """Return the panels that give the readings, as `uniform_branches`, from the first ones."""
    return branches.panels_alike(
        lambda cells: circuit.network(cells, circuit.ties(measured)),
        _positive(measured),
        firsts,
        upper,
    )


@lru_cache(maxsize=128)
def log_medians(circuit: SolvableCircuit, rows: int, columns: int) -> Array:
    """Return the logarithms of the median readings of uniform panels of LEVELS, (levels,).

    The check of a circuit asks for some ten circuits, the same for each recording of a panel.
    """
    shape = rows, columns
    readings = [circuit.exact_reading(np.full(shape, level)) for level in LEVELS]
    return np.asarray(np.log(np.median(readings, axis=(1, 2))))


@lru_cache(maxsize=32)
def uniform_readings(circuit: SolvableCircuit, rows: int, columns: int) -> tuple[Array, Array]:
    """Return uniform panels and their readings.

    Returns
    -------
    levels : array, shape (levels,)
        Resistances of the panels in ohm.
    readings : array, shape (levels, rows, columns)
    """
    knots = np.geomspace(LEVELS[0], LEVELS[-1], UNIFORM_KNOTS)
    panels = np.broadcast_to(knots[:, None, None], (len(knots), rows, columns))
    solved = circuit.exact_reading(panels)
    # Cubic polynomials in the logarithm through the four knots about each level
    place = np.linspace(0, UNIFORM_KNOTS - 1, UNIFORM_LEVELS)
    first = np.clip(place.astype(int) - 1, 0, UNIFORM_KNOTS - 4)
    readings = np.zeros((UNIFORM_LEVELS, rows, columns))
    for knot in range(4):
        others = [other for other in range(4) if other != knot]
        weight = np.prod([(place - first - other) / (knot - other) for other in others], axis=0)
        readings += weight[:, None, None] * solved[first + knot]
    return np.geomspace(LEVELS[0], LEVELS[-1], UNIFORM_LEVELS), readings


@lru_cache(maxsize=32)
def uniform_responses(circuit: SolvableCircuit, rows: int, columns: int) -> Array:
    """Return the largest |∂y/∂g|, (rows, columns), of each cell of uniform panels of LEVELS.

    The unit is volt·ohm. Divided by the noise, the response is the largest resistance that differs
    from an open cell.
    """
    largest = np.zeros((rows, columns))
    for level in LEVELS:
        cells = np.full(largest.shape, level)
        network = circuit.network(cells, circuit.ties(cells))
        largest = np.maximum(largest, np.abs(network.own_response()) * level)
    return largest


def unseen_scales(circuit: SolvableCircuit, rows: int, columns: int) -> tuple[Scale, ...]:
    """Return the scales that no reading shows: of all cells, of each row, of each column.

    A load, or nothing that conducts elsewhere, shows the scale.
    """
    equation = equation_of(circuit, rows, columns)
    if np.isfinite(equation.load).all() or equation.floating:
        return ()
    listed = any(isinstance(value, tuple) for value in vars(circuit).values())
    if not listed:
        return _unseen(circuit, min(rows, MAX_LINES), min(columns, MAX_LINES))
    return _unseen(circuit, rows, columns) if rows * columns <= MAX_LISTED_CELLS else ()


@lru_cache(maxsize=64)
def _unseen(circuit: SolvableCircuit, rows: int, columns: int) -> tuple[Scale, ...]:
    """Return the scales of a circuit that lie in the null space of its Jacobian at random cells.

    A scale is unseen if more than WITHIN of the square of each of its directions lies there.
    """
    scatter = SCATTER * np.random.default_rng(1).standard_normal((rows, columns))
    cells = TYPICAL_OHM * np.exp(scatter)
    # An orthonormal basis of the directions of ln r that no reading shows
    _, singular, basis = np.linalg.svd(circuit.network(cells, circuit.ties(cells)).sensitivity())
    null = basis[singular <= NULL * singular[0]]
    # Directions of each scale, (cells, directions)
    scales: dict[Scale, Array] = {
        "all": np.ones((cells.size, 1)),
        "rows": np.repeat(np.eye(rows), columns, axis=0),
        "columns": np.tile(np.eye(columns), (rows, 1)),
    }
    return tuple(
        name
        for name, along in scales.items()
        if np.all(np.sum((null @ along) ** 2, axis=0) > WITHIN * np.sum(along**2, axis=0))
    )


def unseen_sentence(scales: tuple[str, ...]) -> str:
    """Return the scales in words, with the cure; '' for none."""
    if not scales:
        return ""
    of_lines = " and ".join(name for name in scales if name != "all")
    scale = f"each of the {of_lines} has a scale of its own" if of_lines else "all cells share one"
    return (
        f"{scale} that no reading shows: no resistor sets it; only ratios of cells within them "
        "are known, and a resistor from each sensed line to ground (load_ohm) would show it"
    )


def least_cells(circuit: SolvableCircuit, measured: Array, sigma: Array | None) -> Array:
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


def resolution(circuit: SolvableCircuit, measured: Array, sigma: Array) -> Array:
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
