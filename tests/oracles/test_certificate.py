"""What "verified" means: no cell would move, whatever the scale of its reading, and the point is a minimum.

Readings of extreme panels come from an elimination in 40 digits that shares no code with the package.
"""

import dataclasses
from collections.abc import Callable

import mpmath
import numpy as np
import pytest

from lampest import Absolute, Array, Bounds, Estimator, Panel, Readings, Recording, Scene, Squared, Stream
from lampest.cost.cost import Cost
from lampest.cost.given import Background, Given
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Gradient, LogRatio, Misfit, Term
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import GroundedReadout, LoadedColumnsReadout, Readout
from lampest.solvers.certificate import Definiteness, certificate
from lampest.solvers.hessian import Hessian
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.smoothing import Smoothing
from lampest.solvers.solution import Outcome, Settings, Status, check

ROWS, COLUMNS = 6, 7
ODD = np.add.outer(np.arange(ROWS), np.arange(COLUMNS)) % 2 == 1
APART = np.add.outer(np.arange(ROWS) < 3, np.arange(COLUMNS) < 3) == 1
NOTHING = Smoothing(1.0, np.zeros(0))


def usual() -> Array:
    return np.asarray(3000 * np.exp(0.2 * np.random.default_rng(3).standard_normal((ROWS, COLUMNS))))


def changed(where: object, factor: float) -> Array:
    cells = usual()
    cells[where] *= factor
    return cells


def decades(count: float) -> Array:
    return np.asarray(usual() * 10 ** np.random.default_rng(4).uniform(-count / 2, count / 2, (ROWS, COLUMNS)))


EXTREMES: dict[str, Callable[[], Array]] = {
    "open cell": lambda: changed((2, 3), 1e6),
    "open row": lambda: changed(2, 1e5),
    "open column": lambda: changed((slice(None), 4), 1e5),
    "shorted cell": lambda: changed((2, 3), 1e-7),
    "shorted row": lambda: changed(2, 1e-6),
    "shorted column": lambda: changed((slice(None), 4), 1e-6),
    "open and shorted": lambda: np.asarray(changed(2, 1e5) * np.where(np.arange(COLUMNS) == 4, 1e-5, 1.0)),
    "clusters 10³": lambda: np.asarray(usual() * np.where(APART, 1e3, 1.0)),
    "clusters 10⁶": lambda: np.asarray(usual() * np.where(APART, 1e6, 1.0)),
    "clusters 10⁹": lambda: np.asarray(usual() * np.where(APART, 1e9, 1.0)),
    "checkerboard 10³": lambda: np.asarray(usual() * np.where(ODD, 1e3, 1.0)),
    "checkerboard 10⁵": lambda: np.asarray(usual() * np.where(ODD, 1e5, 1.0)),
    "two decades": lambda: decades(2),
    "five decades": lambda: decades(5),
    "nine decades": lambda: decades(9),
    "a ramp of six decades": lambda: np.asarray(usual() * np.logspace(-3, 3, ROWS)[:, None]),
}


def readings_of(cells: Array) -> Array:
    """R_jk, by solving for the potentials of every pair of lines in 40 digits."""
    rows, columns = cells.shape
    with mpmath.workdps(40):
        system = mpmath.zeros(rows + columns)
        for row in range(rows):
            for column in range(columns):
                conductance, line = 1 / mpmath.mpf(float(cells[row, column])), rows + column
                system[row, row] += conductance
                system[line, line] += conductance
                system[row, line] -= conductance
                system[line, row] -= conductance
        inverse = mpmath.inverse(system[:-1, :-1])
        last = rows + columns - 1

        def entry(one: int, other: int) -> mpmath.mpf:
            return mpmath.mpf(0) if last in (one, other) else inverse[one, other]

        return np.array(
            [
                [
                    float(entry(row, row) + entry(rows + column, rows + column) - 2 * entry(row, rows + column))
                    for column in range(columns)
                ]
                for row in range(rows)
            ]
        )


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
@pytest.mark.parametrize("name", EXTREMES)
def test_every_reading_of_an_extreme_is_met(name: str, formulation: str) -> None:
    """Plain least squares of exact readings; the optimum has no misfit, and no large reading hides a small one."""
    cells = EXTREMES[name]()
    measured = readings_of(cells)
    estimator = Estimator((Misfit(),), formulation=formulation, bounds=Bounds(upper="none"))
    scene = Scene(Panel(ROWS, COLUMNS))
    stream = Stream.begin(estimator, scene, 1.0, Readings.of(scene, measured))
    solution = stream.baseline.solution
    assert solution.status is Status.OPTIMUM
    assert np.abs(readings_of(solution.cell_resistance[0]) / measured - 1).max() < 1e-6
    assert np.abs(solution.cell_resistance[0] / cells - 1).max() < 1e-4


def evaluation(
    terms: tuple[Term, ...], cells: Array, measured: Array, sigma: Array | None = None, previous: Array | None = None
) -> Evaluation:
    scene = Scene(Panel(*measured.shape))
    readings = Readings.of(scene, measured, sigma)
    given = Given.of(readings.alone(), Background(scene, previous=previous))
    wide = (measured[None] * 1e-6, measured[None] * 1e6)
    return Evaluation.at(Cost(scene.panel, terms, 1), Data(given, *wide, noise_known=sigma is not None), cells[None])


def by_differences(at: Evaluation, step: float = 1e-4) -> Array:
    """∇²φ in u = log r from gradients on either side."""
    cells, size = at.cell_resistance, at.cell_resistance.size
    matrix = np.empty((size, size))
    for number in range(size):
        aside = np.zeros(size)
        aside[number] = step
        sides = [
            Evaluation.at(at.cost, at.data, cells * np.exp(sign * aside).reshape(cells.shape)).log_gradient(np.zeros(0))
            for sign in (1, -1)
        ]
        matrix[:, number] = (sides[0] - sides[1]).ravel() / (2 * step)
    return matrix


def test_step_is_newtons() -> None:
    """−H⁻¹ g with H by differences of gradients, and the decrement."""
    cells = usual()
    at = evaluation((Misfit(), Gradient(weight=1e-4)), cells * 1.02, readings_of(cells))
    gradient = at.log_gradient(np.zeros(0)).ravel()
    step = -np.linalg.solve(by_differences(at), gradient)
    found = certificate(Hessian(at, NOTHING))
    assert found.definiteness is Definiteness.POSITIVE
    np.testing.assert_allclose(found.step, step, rtol=1e-5, atol=1e-7)
    assert found.decrement == pytest.approx(np.sqrt(-gradient @ step), rel=1e-5)


def test_deviations_bound_every_step() -> None:
    """|s_c| over its posterior deviation, from the inverse of J ᵀJ/σ², is never above what the decrement says."""
    cells, sigma = usual(), 0.5
    measured = readings_of(cells)
    at = evaluation((Misfit(),), cells * 1.001, measured, np.full(measured.shape, sigma))
    found = certificate(Hessian(at, NOTHING))
    sensitivity = at.networks[0].sensitivity()
    deviation = np.sqrt(np.diag(np.linalg.inv(sensitivity.T @ sensitivity / sigma**2)))
    share = np.abs(found.step) / deviation
    assert share.max() <= found.deviations * 1.01
    assert found.deviations <= np.sqrt(cells.size) * share.max() * 10


def test_a_small_cell_is_not_hidden() -> None:
    """Everything is met but one shorted cell, which is off by a tenth: first-order conditions hold and nobody signs."""
    cells = changed((2, 3), 1e-6)
    measured, off = readings_of(cells), cells.copy()
    off[2, 3] *= 1.1
    at = evaluation((Misfit(),), off, measured)
    assert at.kkt_residual(np.zeros(0)) < 1e-6
    assert not certificate(Hessian(at, NOTHING)).settled
    found = check(at, Outcome(off[None], np.zeros(0), Status.OPTIMUM, 1))
    assert found.status is Status.FAINT and found.solved


def between_two_minima() -> Evaluation:
    """One cell whose reading says 1000 ohm and whose previous frame said 1 ohm; between the two minima the cost is
    stationary, and largest: φ = (r − 1000)² + 2 (100 log r)².
    """

    def slope(logarithm: float) -> float:
        return 2 * (np.exp(logarithm) - 1000) * np.exp(logarithm) + 4e4 * logarithm

    rising, falling = np.log(30.0), np.log(400.0)
    assert slope(rising) > 0 > slope(falling)
    for _ in range(200):
        middle = (rising + falling) / 2
        rising, falling = (middle, falling) if slope(middle) > 0 else (rising, middle)
    terms = (Misfit(), LogRatio(weight=2.0, loss=Squared()))
    return evaluation(terms, np.array([[np.exp(rising)]]), np.array([[1000.0]]), previous=np.array([[1.0]]))


def test_a_stationary_point_that_is_no_minimum_is_named() -> None:
    here = between_two_minima()
    found = check(here, Outcome(here.cell_resistance, np.zeros(0), Status.OPTIMUM, 1))
    assert found.status is Status.SADDLE and not found.solved and np.isnan(found.cell_resistance).all()


def test_cells_that_nothing_speaks_of_are_a_plateau() -> None:
    """One row of cells, each its own circuit, of which one is not seen."""
    scene, cells = Scene(Panel(1, 3)), np.array([[1000.0, 2000.0, 3000.0]])
    readings = Readings(cells, None, np.zeros((1, 3)), np.array([[1.0, 0.0, 1.0]]))
    data = Data(Given.of(readings.alone(), Background(scene)), cells[None] * 1e-6, cells[None] * 1e6)
    at = Evaluation.at(Cost(scene.panel, (Misfit(),), 1, partial=True), data, cells[None])
    found = check(at, Outcome(at.cell_resistance, np.zeros(0), Status.OPTIMUM, 1))
    assert found.status is Status.FLAT and found.solved


@pytest.mark.parametrize("noise", [None, 0.05])
def test_what_the_noise_hides_needs_no_further_step(noise: float | None) -> None:
    """Cells three millionths off are verified where the noise is ten thousand times as large, and only there."""
    cells = usual()
    measured = readings_of(cells)
    sigma = None if noise is None else noise * measured
    at = evaluation((Misfit(),), cells * (1 + 3e-6), measured, sigma)
    found = certificate(Hessian(at, NOTHING))
    assert found.settled is (noise is not None)


def test_an_absolute_loss_is_certified_with_its_duals() -> None:
    cells = usual()
    measured = readings_of(cells)
    start = evaluation((Misfit(), Gradient(weight=1e-2, loss=Absolute())), cells, measured)
    outcome = ProjectedNewton(start.cost, Settings()).solve(start.data, start)
    assert check(start, outcome).status is Status.OPTIMUM


@pytest.mark.slow
@pytest.mark.parametrize("readout", [GroundedReadout(sense="all", drive_ohm=50), LoadedColumnsReadout(load_ohm=10000)])
@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_a_step_that_the_noise_alone_makes_short_is_not_taken(readout: Readout, seed: int) -> None:
    readout = dataclasses.replace(readout, adc_bits=32, noise_lsb=1.0)
    scene = Scene(Panel(4, 5), readout)
    cells = 10 ** np.random.default_rng(seed).uniform(1, 10, (4, 5))
    reading = np.asarray(readout.to_recorded(readout.exact_reading(cells), scene))
    both = Recording(
        scene, np.stack([reading] * 2), np.arange(2.0), np.array([0, 1], np.uint8), 1e-3 * np.stack([reading] * 2)
    )
    estimator = Estimator((Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False)
    found = reconstruct(both, estimator)
    assert [step.solution.status for step in (found.baseline, *found.steps)] == [Status.OPTIMUM] * 2
    again = np.asarray(readout.to_recorded(readout.exact_reading(found.steps[0].estimate(0)), scene))
    np.testing.assert_allclose(again, reading, rtol=1e-5)


@pytest.mark.parametrize("where", [(16, 10), 16], ids=["cell", "row"])
def test_without_noise_a_large_panel_is_verified_by_every_reading(where: object) -> None:
    """Readings of shorts are nothing beside the others; they were off by 3·10⁻⁶, and in a row by a thousandth."""
    cells = 5000 * 10 ** np.random.default_rng([32, 5]).uniform(-0.15, 0.15, (32, 32))
    cells[where] *= 1e-9
    scene = Scene(Panel(32, 32))
    recorded = scene.circuit.exact_reading(cells)
    stream = Stream.begin(Estimator((Misfit(),), formulation="reduced"), scene, 1.0, Readings.of(scene, recorded))
    found = stream.baseline.solution
    assert found.solved
    assert found.status is not Status.OPTIMUM or np.abs(found.reading[0] / recorded - 1).max() <= 1e-6
