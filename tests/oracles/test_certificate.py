"""The meaning of "verified": no cell would move, and the point is a minimum."""

from dataclasses import replace

import numpy as np
import pytest
from promises import promise
from scipy.linalg import lapack
from scipy.optimize import brentq

from lampest import (
    GroundedReadout,
    LoadedColumnsReadout,
    LogRatio,
    Misfit,
    Outcome,
    Readings,
    Recording,
    Scene,
    Squared,
    Stream,
    Term,
    VirtualGroundReadout,
)
from lampest.cost.cost import Cost
from lampest.cost.given import Background, Given
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import Readout
from lampest.solvers.certificate import certificate, clear_of_rounding
from lampest.solvers.check import check
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.iterate import Iterate
from lampest.solvers.posed import Bounds
from lampest.solvers.projected_newton import ProjectedNewton, certified_step
from lampest.solvers.solution import Settings, Solution, Status
from tests.least_cost import Circuit
from tests.netlist import in_digits

DOWN, ALONG = np.indices((6, 7))
CLUSTER_MASK = (DOWN < 3) | (ALONG < 3)
NO_SMOOTHING = Smoothing(1.0, np.zeros(0))
USUAL_CELLS = 3000 * np.exp(0.2 * np.random.default_rng(3).standard_normal(DOWN.shape))
COLUMN = (slice(None), 4)
FINE_CONVERTER = {"adc_bits": 32, "supply_volt": 5.0}  # so that no reading is at a rail
OHM = {"drive_ohm": 50.0, "sense_ohm": 20.0}
MAX_MISFIT = 1e-6  # relative, of readings at a verified optimum; measured 4.6e-7
MAX_CELL_ERROR = 1e-5  # relative, of cells that such readings determine; measured 5e-7
MAX_KKT = 1e-6  # of a verified optimum
CLEARLY_LOWER = 0.99  # cost over that of the start
# Each readout in volt, and the same circuit in its second statement, which inverts: down to 10⁻⁶
# ohm.
KINDS: dict[str, tuple[Readout, Circuit]] = {
    "loaded": (
        LoadedColumnsReadout(drive_ohm=50.0, load_ohm=1000.0, **FINE_CONVERTER),
        Circuit("loaded", (), 50, 0, 1000, 5),
    ),
    "grounded": (
        GroundedReadout(load_ohm=1000.0, **OHM, **FINE_CONVERTER),
        Circuit("grounded", (), 50, 20, 1000, 5),
    ),
    "one load": (
        GroundedReadout(load_ohm=1000.0, sense="one", **OHM, **FINE_CONVERTER),
        Circuit("grounded_one", (), 50, 20, 1000, 5),
    ),
    "virtual ground": (
        VirtualGroundReadout(feedback_ohm=10.0, **OHM, **FINE_CONVERTER),
        Circuit("virtual", (), 50, 20, 10, 5),
    ),
}
SHORTS: dict[str, object] = {
    "cell": (2, 3),
    "two cells": ([0, 3], [1, 4]),
    "row": 2,
    "column": COLUMN,
}


def changed(place: object, factor: float | Array) -> Array:
    cells = USUAL_CELLS.copy()
    cells[place] *= factor
    return cells


def decades(count: float) -> Array:
    return USUAL_CELLS * 10 ** np.random.default_rng(4).uniform(
        -count / 2, count / 2, USUAL_CELLS.shape
    )


EXTREME_PANELS: dict[str, Array] = {
    "open cell": changed((2, 3), 1e6),
    "open row": changed(2, 1e5),
    "open column": changed(COLUMN, 1e5),
    "shorted cell": changed((2, 3), 1e-7),
    "shorted row": changed(2, 1e-6),
    "shorted column": changed(COLUMN, 1e-6),
    "open and shorted": changed(2, 1e5) * np.where(ALONG == 4, 1e-5, 1.0),
    **{f"clusters {contrast:.0e}": changed(CLUSTER_MASK, contrast) for contrast in (1e3, 1e6, 1e9)},
    **{
        f"checkerboard {contrast:.0e}": changed((DOWN + ALONG) % 2 == 1, contrast)
        for contrast in (1e3, 1e5)
    },
    **{f"{count} decades": decades(count) for count in (2, 5, 9)},
    "a ramp of six decades": USUAL_CELLS * np.logspace(-3, 3, len(USUAL_CELLS))[:, None],
}
BEYOND_IPOPT = (
    "shorted cell",
    "shorted row",
    "shorted column",
    "clusters 1e+09",
    "checkerboard 1e+05",
    "9 decades",
)


def solution_of(
    scene: Scene, recorded: Array, formulation: str, bounds: Bounds | None = None
) -> Solution:
    """Return the solution of one frame by least squares, by default without an upper bound."""
    estimator = Estimator(
        (Misfit(),), formulation=formulation, bounds=bounds or Bounds(upper="none")
    )
    return Stream.begin(estimator, scene, 1.0, Readings.of(scene, recorded)).baseline.solution


@promise(
    "theory/inverse_problem: Sixteen extreme panels without noise return to 10⁻⁶ in every reading"
)
@pytest.mark.exact
@pytest.mark.parametrize("formulation", ["reduced", "nodal", "auto"])
@pytest.mark.parametrize("name", EXTREME_PANELS)
def test_estimates_of_extreme_panels_meet_every_reading(name: str, formulation: str) -> None:
    """No large reading hides a small one."""
    cells = EXTREME_PANELS[name]
    measured = in_digits(cells)
    solution = solution_of(Scene(Panel(*cells.shape)), measured, formulation)
    if (
        formulation == "nodal"
        and name in BEYOND_IPOPT
        and solution.status in (Status.FAINT, Status.FLAT)
    ):
        # The digits of node voltages end where readings span six decades, and the status says so.
        return
    assert solution.status is Status.OPTIMUM
    assert np.abs(in_digits(solution.cell_resistance[0]) / measured - 1).max() < MAX_MISFIT
    assert np.abs(solution.cell_resistance[0] / cells - 1).max() < MAX_CELL_ERROR


@pytest.mark.long
@pytest.mark.parametrize("formulation", ["reduced", "nodal", "auto"])
@pytest.mark.parametrize("ohm", [1.0, 3e-3, 3e-4, 1e-6])
@pytest.mark.parametrize("short", SHORTS)
@pytest.mark.parametrize("kind", KINDS)
def test_verified_estimates_meet_the_readings_of_shorts(
    kind: str, short: str, ohm: float, formulation: str
) -> None:
    cells = USUAL_CELLS.copy()
    readout, circuit = KINDS[kind]
    place = SHORTS[short]
    cells[place] = ohm * np.exp(0.2 * np.random.default_rng(4).standard_normal(cells[place].shape))
    volt, _ = circuit.reading(cells)
    solution = solution_of(Scene(Panel(*cells.shape), readout), volt, formulation)
    misfit = np.abs(circuit.reading(solution.cell_resistance[0])[0] / volt - 1).max()
    if formulation == "nodal" and ohm < 1 and solution.status is not Status.OPTIMUM:
        # The digits of node voltages end six decades below the other cells, and the status says so.
        return
    assert solution.solved and (solution.status is not Status.OPTIMUM or misfit < MAX_MISFIT)
    if ohm == 3e-4 and "cell" in short:
        assert solution.optimum and misfit < MAX_MISFIT and not solution.at_lower.any()


def evaluation(
    terms: tuple[Term, ...],
    cells: Array,
    measured: Array,
    sigma: Array | None = None,
    previous: Array | None = None,
) -> Evaluation:
    scene = Scene(Panel(*measured.shape))
    readings = Readings.of(scene, measured, sigma)
    given = Given.of(readings.alone(), Background(scene, previous=previous))
    wide = (measured[None] * 1e-6, measured[None] * 1e6)
    return Evaluation.at(
        Cost(scene.panel, terms, 1), Data(given, *wide, noise_known=sigma is not None), cells[None]
    )


def verified(point: Evaluation) -> Solution:
    """The solution of a solver that ended at a point and calls it the optimum."""
    return check(point, Outcome(point.cell_resistance, np.zeros(0), Status.OPTIMUM, 1))


@promise("README: It verifies every estimate")
@pytest.mark.parametrize("relative_error", [1e-1, 1e-3, 1e-4])
@pytest.mark.parametrize("number", range(16))
def test_wrong_small_cells_are_never_verified(number: int, relative_error: float) -> None:
    """Cells of clusters, checkerboards, blocks and stripes are up to nine decades apart."""
    random = np.random.default_rng([8, number])
    shape = rows, columns = random.integers(3, 8, 2)
    down, along = np.indices(shape)
    cut = down < random.integers(1, rows), along < random.integers(1, columns)
    patterns = (cut[0] != cut[1], (down + along) % 2 == 1, cut[0] & cut[1], down % 2 == 1)
    usual = 3000 * np.exp(random.choice([0.05, 0.3]) * random.standard_normal(shape))
    cells = np.where(patterns[number % 4], 10 ** random.uniform(3, 9), 1.0) * usual
    scatter = relative_error * np.random.default_rng(number).standard_normal(cells.shape)
    places = np.where(cells < 10 * cells.min(), cells * np.exp(scatter), cells)
    point = evaluation((Misfit(),), places, Scene(Panel(*cells.shape)).circuit.exact_reading(cells))
    assert verified(point).status is not Status.OPTIMUM


@pytest.mark.parametrize("noise_known", [True, False])
def test_plain_least_squares_steps_to_cells_that_reproduce_the_readings(
    noise_known: bool,
) -> None:
    """Each step squares the error, and none needs a factor of ∇²φ."""
    scatter = np.exp(0.05 * np.random.default_rng(8).standard_normal(USUAL_CELLS.shape))
    measured = in_digits(USUAL_CELLS * scatter)
    start = evaluation((Misfit(),), USUAL_CELLS, measured, 1e-3 * measured if noise_known else None)
    point = Iterate.of(start, NO_SMOOTHING)
    errors = []
    for _ in range(3):
        following = certified_step(point)
        assert following is not None and following.newest_preconditioner is None
        point = following
        ratio = point.at.cell_resistance[0] / (USUAL_CELLS * scatter)
        errors.append(float(np.abs(np.log(ratio)).max()))
    assert errors[0] < 0.05 and errors[1] < 1e-3 and errors[2] < 1e-7
    far = evaluation((Misfit(),), 3 * USUAL_CELLS, measured, 1e-3 * measured)
    assert certified_step(Iterate.of(far, NO_SMOOTHING)) is None  # beyond MAX_DISTANCE


def test_a_factor_may_succeed_on_rounding() -> None:
    """Data of neighbours' differences alone leave a curvature of 10⁻¹³ without a small pivot."""
    count = 40
    random = np.random.default_rng(2)
    vectors = np.linalg.qr(random.standard_normal((count, count)))[0]
    for least, clear in ((1e-13, False), (1e-6, True)):
        matrix = vectors @ np.diag(np.r_[least, np.linspace(0.5, 1.5, count - 1)]) @ vectors.T
        size = np.sqrt(np.diag(matrix))
        unit = matrix / size[:, None] / size
        triangle, failed = lapack.dpotrf(unit)
        norm = float(np.abs(unit).sum(axis=0).max())
        assert not failed and clear_of_rounding(triangle, norm) is clear


def test_a_single_wrong_small_cell_is_not_verified() -> None:
    """One shorted cell is off by a tenth, although first-order conditions hold."""
    cells = changed((2, 3), 1e-6)
    perturbed = cells.copy()
    perturbed[2, 3] *= 1.1
    point = evaluation((Misfit(),), perturbed, in_digits(cells))
    assert point.kkt_residual(np.zeros(0)) < MAX_KKT
    assert not certificate(Hessian(point, NO_SMOOTHING)).settled
    assert verified(point).status is Status.FAINT and verified(point).solved


def test_the_certificate_names_a_saddle() -> None:
    """φ = (r − 1000)² + 2 (100 log r)² has a maximum between its two minima."""

    def slope(logarithm: float) -> float:
        return 2 * (np.exp(logarithm) - 1000) * np.exp(logarithm) + 4e4 * logarithm

    cells = np.array([[np.exp(brentq(slope, np.log(30.0), np.log(400.0), xtol=1e-15, rtol=1e-15))]])
    terms = (Misfit(), LogRatio(weight=2.0, loss=Squared()))
    solution = verified(evaluation(terms, cells, np.array([[1000.0]]), previous=np.array([[1.0]])))
    assert (
        solution.status is Status.SADDLE
        and not solution.solved
        and np.isnan(solution.cell_resistance).all()
    )


def test_undetermined_cells_are_called_a_plateau() -> None:
    """One row of cells, each its own circuit, of which one is not seen."""
    scene = Scene(Panel(1, 3))
    cells = np.array([[1000.0, 2000.0, 3000.0]])
    readings = Readings(cells, None, np.zeros((1, 3)), np.array([[1.0, 0.0, 1.0]]))
    data = Data(
        Given.of(readings.alone(), Background(scene)), cells[None] * 1e-6, cells[None] * 1e6
    )
    solution = verified(
        Evaluation.at(Cost(scene.panel, (Misfit(),), 1, partial=True), data, cells[None])
    )
    assert solution.status is Status.FLAT and solution.solved


@pytest.mark.parametrize("noise", [None, 0.05])
def test_a_decrease_below_the_noise_needs_no_further_step(noise: float | None) -> None:
    """Cells three millionths off are verified only where the noise is 10,000 times as large."""
    measured = in_digits(USUAL_CELLS)
    sigma = None if noise is None else noise * measured
    point = evaluation((Misfit(),), USUAL_CELLS * (1 + 3e-6), measured, sigma)
    assert certificate(Hessian(point, NO_SMOOTHING)).settled is (noise is not None)


@pytest.mark.parametrize(("share", "optimum"), [(1e-3, False), (0.3, False), (1.5, True)])
def test_cells_without_change_are_an_optimum_where_the_penalty_outweighs_the_gradient(
    share: float, optimum: bool
) -> None:
    """The readings of two loaded cells are missed by 60 percent."""
    unloaded = USUAL_CELLS * (
        1 + 1e-14 * np.random.default_rng(5).standard_normal(USUAL_CELLS.shape)
    )
    measured = in_digits(changed(([2, 3], [3, 3]), 0.3))
    zeros = np.zeros(USUAL_CELLS.size)

    def point(weight: float) -> Evaluation:
        terms = (Misfit(weighting="noise"), LogRatio(weight=weight))
        return evaluation(terms, unloaded, measured, 1e-2 * measured, previous=USUAL_CELLS)

    largest = float(np.abs(point(1.0).log_gradient(zeros)).max())
    start = point(share * largest / 100)  # the residual is 100 ln(r / r before)
    assert start.kkt_residual(zeros) > 100 * MAX_KKT
    assert (
        check(start, Outcome(start.cell_resistance, zeros, Status.ITERATIONS, 1)).solved is optimum
    )
    outcome = ProjectedNewton(start.cost, Settings()).solve(start.data, start)
    solution = check(start, outcome)
    assert (
        not solution.solved or (solution.objective < CLEARLY_LOWER * start.objective) is not optimum
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "readout", [GroundedReadout(sense="all", drive_ohm=50), LoadedColumnsReadout(load_ohm=10000)]
)
@pytest.mark.parametrize("seed", [0, 1, 3, 5])
def test_a_step_shortened_by_the_noise_alone_is_not_accepted(readout: Readout, seed: int) -> None:
    readout = replace(readout, adc_bits=32, noise_lsb=1.0)
    scene = Scene(Panel(4, 5), readout)
    cells = 10 ** np.random.default_rng(seed).uniform(1, 10, (4, 5))
    reading = np.asarray(readout.to_recorded(readout.exact_reading(cells), scene))
    frames = np.stack([reading] * 2)
    recording = Recording(scene, frames, np.arange(2.0), np.array([0, 1], np.uint8), 1e-3 * frames)
    estimator = Estimator(
        (Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False
    )
    estimates = reconstruct(recording, estimator)
    assert [step.solution.status for step in (estimates.baseline, *estimates.steps)] == [
        Status.OPTIMUM
    ] * 2
    reproduced = np.asarray(
        readout.to_recorded(readout.exact_reading(estimates.steps[0].estimate(0)), scene)
    )
    np.testing.assert_allclose(reproduced, reading, rtol=MAX_MISFIT)
