"""Inequalities that readings of a circuit satisfy whatever its cells are, as tests of readings."""

from dataclasses import dataclass

import numpy as np

from lampest.panel.circuit import CircuitOfLines, nominal_terminations
from lampest.panel.equation import Equation, equation_of
from lampest.panel.lines import lines_text
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class FreeTest:
    """Inequality that readings of a circuit satisfy for any cells, tested on frames.

    Attributes
    ----------
    law : str
        The inequality in words.
    excess : array, shape (frames,)
        Largest violation in each frame, in standard deviations.
    count : int
        Number of inequalities of a frame.
    single : array, shape (frames, rows, columns), or None
        Violation by each reading in standard deviations, if the inequality bounds one reading.
    """

    law: str
    excess: Array
    count: int
    single: Array | None = None


def free_tests(circuit: CircuitOfLines, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
    """Return tests of inequalities that a circuit's readings satisfy for any cells.

    Of two-point readings the test is R_jk ≤ R_jq + R_pq + R_pk, see `four_point_excess`. Of others
    v_ij ≤ U − Rd_i Σ_k v_ik/Rs_k and Σ_i v_ij ≤ U, where the sum over k is over simultaneous loads.
    The first one: no sensed line has a higher potential than the driven one, which is below the
    source by the loads' current through its Rd. The second one, for idle lines at ground through no
    more than Rd: if all driven lines were at the source, no sensed line would be above it
    (superposition, Z·t ≤ 1).

    `measured` and `sigma` are (frames, rows, columns); sigma is infinite for readings that are no
    values.
    """
    equation = equation_of(circuit, *measured.shape[-2:])
    if equation.terminations.two_point:
        law = "R_jk <= R_jq + R_pq + R_pk of any two rows and columns"
        single = four_point_excess(measured, sigma)
        return (FreeTest(law, single.max(axis=(1, 2)), measured[0].size ** 2, single),)
    if equation.potentials is not None:
        return _tests_of_potentials(equation, measured, sigma)
    load = equation.load
    read = equation.volt(measured), equation.volt_sigma(measured, sigma)
    volt, noise = np.where(np.isfinite(sigma), read, 0.0) / equation.gain
    # U ≥ v_ij + Rd_i Σ_k v_ik/Rs_k + V_d, with the propagated noise of both terms
    simultaneous = equation.together is None or len(equation.ties) > 1
    by_loads = simultaneous and not equation.terminations.at_far_end
    drop = (equation.drive if by_loads else 0.0) / load
    lost = equation.lost(equation.sum_together(volt / load))
    below = volt + equation.sum_together(volt * drop) + lost
    spread = np.hypot(noise, np.sqrt(equation.sum_together((noise * drop) ** 2)))
    drive = lines_text(tuple(equation.driving.own.ohm.tolist()))
    law = f"no sensed line stands above the driven one behind its {drive}"
    tests = [(law, below, np.where(noise > 0, spread, 0.0))]
    if equation.grounded:
        driven = -2 if equation.terminations.driven == "rows" else -1
        law = "readings of a sensed line add up to no more than the supply"
        tests = [(law, volt.sum(axis=driven), np.sqrt((noise**2).sum(axis=driven))), *tests]
    results = []
    for law, value, spread in tests:
        known = np.where(spread > 0, spread, 1.0)
        excess = np.where(spread > 0, (value - equation.source) / known, -np.inf)
        results.append(FreeTest(law, excess.reshape(len(value), -1).max(axis=1), value[0].size))
    return tuple(results)


def _tests_of_potentials(equation: Equation, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
    """Return the test that no line is beyond the potentials in which lines end."""
    terms = equation.potentials
    assert terms is not None
    most = max(equation.source, float(terms.ends.max()), float(terms.load_volt.max()))
    volt = terms.load_volt + (measured - terms.level) / equation.gain
    known = np.isfinite(sigma) & (sigma > 0)
    spread = np.where(known, sigma, 1.0) / equation.gain
    excess = np.where(known, np.maximum(volt - most, -volt) / spread, -np.inf)
    law = "no sensed line stands beyond the potentials in which lines end"
    return (FreeTest(law, excess.reshape(len(excess), -1).max(axis=1), excess[0].size),)


def four_point_excess(resistance: Array, sigma: Array) -> Array:
    """Return max_pq (R_jk − R_jq − R_pq − R_pk)/σ for every reading, (frames, rows, columns).

    Effective resistance is a metric (Klein & Randić, J. Math. Chem. 12, 1993): no path from row j
    over column q and row p to column k is shorter than R_jk. σ is that of all four readings
    together. The shortest path over any q from row j to row p is computed first, then the shortest
    over any p: (rows² · columns) sums. The result is −∞ for readings with infinite σ.

    Parameters
    ----------
    resistance : array, shape (frames, rows, columns)
        Readings R in ohm.
    sigma : array, same shape
        Standard deviations; infinite for readings that are excluded.
    """
    value = np.where(np.isfinite(sigma), resistance, np.inf)
    variance = np.where(np.isfinite(sigma), sigma, 0.0) ** 2
    excess = np.full(value.shape, -np.inf)
    for row in range(value.shape[1]):
        # Row to row p: min_q (R_jq + R_pq), and its variance
        over = value[:, [row]] + value
        middle = over.argmin(axis=2)[..., None]
        between = np.take_along_axis(over, middle, axis=2)
        spread = np.take_along_axis(variance[:, [row]] + variance, middle, axis=2)
        # Row to column k: min_p (min_q (R_jq + R_pq) + R_pk), and the variance of all four readings
        way = between + value
        last = way.argmin(axis=1)[:, None]
        noise = variance[:, row] + np.take_along_axis(spread + variance, last, axis=1)[:, 0]
        way = np.take_along_axis(way, last, axis=1)[:, 0]
        counted = np.isfinite(value[:, row]) & np.isfinite(way) & (noise > 0)
        excess[:, row][counted] = (value[:, row][counted] - way[counted]) / np.sqrt(noise[counted])
    return excess


def largest_possible(circuit: CircuitOfLines, measured: Array) -> Array:
    """Return the largest value of each reading that the others allow, (…, rows, columns).

    Of two-point readings it is min_pq (R_jq + R_pq + R_pk). Infinite readings in `measured` allow
    anything. The result is infinite where no law limits a reading.
    """
    largest = np.full(measured.shape, np.inf)
    if nominal_terminations(circuit).two_point:
        for row in range(measured.shape[-2]):
            between = (measured[..., [row], :] + measured).min(axis=-1)  # to each row p
            largest[..., row, :] = (between[..., None] + measured).min(axis=-2)
    return largest


def largest_series_ohm(circuit: CircuitOfLines, measured: Array, sigma: Array) -> float:
    """Return the largest possible resistance in series with the panel, ohm.

    `measured` and `sigma` are those of `free_tests`, computed for a circuit without resistance in
    series.
    """
    equation = equation_of(circuit, *measured.shape[-2:])
    if equation.terminations.as_resistance:
        return float(measured[np.isfinite(sigma)].min(initial=np.inf))
    # min_i (U − V_d − max_j v_ij)/Σ_j v_ij/Rs_j; the sum is over simultaneous loads
    if not equation.plain:
        return 0.0
    volt = np.where(np.isfinite(sigma), measured, 0.0) / equation.gain
    current = equation.sum_together(volt / equation.load)
    if equation.together is None:
        axis = -1 if equation.terminations.driven == "rows" else -2
        volt = volt.max(axis=axis, keepdims=True)
    # Voltage across Rd and the current through it: Rd ≤ (U − V_d − v)/I
    drop = equation.driven_volt(current, 0.0) - volt
    flows = current > 0
    return float(np.min(np.where(flows, drop / np.where(flows, current, 1.0), np.inf)))
