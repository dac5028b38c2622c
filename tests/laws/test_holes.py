"""Laws of every method and every kind of readout when readings are missing."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from lampest import Estimator, InputError, Panel, Recording, Scene, Student
from lampest.cost.terms import CellResistance, Misfit
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import reconstruct
from lampest.files.typed import members_by_kind
from lampest.panel.readouts import AnyReadout, TwoPointReadout
from tests.estimates import recording_of
from tests.netlist import two_point_resistances

SHAPE = (4, 5)
FORMULATIONS = [name for name in MethodName.__args__ if name != "auto"]
ROBUST = (Misfit(weighting="noise", loss=Student(corner=4.0)),)  # what the smoother takes
HOLES = [(1, 2), (3, 0)]
CONVERGED = 1e-6  # relative, of cells at two ends of a search; measured 3e-8
SLOW_FORMULATIONS = ("per_pixel", "nodal", "reduced", "smoother")  # seconds of readouts in volt
CASES = [
    pytest.param(
        kind(),
        name,
        marks=pytest.mark.slow if kind().unit == "volt" and name in SLOW_FORMULATIONS else (),
    )
    for kind in members_by_kind(AnyReadout).values()
    for name in FORMULATIONS
]
TWO_POINT = Scene(Panel(*SHAPE), TwoPointReadout())


def recording(scene: Scene, holes: list[tuple[int, int]] = HOLES, seed: int = 1) -> Recording:
    """Return four frames of unlike cells through the readout, of which measured ones have holes."""
    rng = np.random.default_rng(seed)
    cells = 2000.0 * np.exp(0.3 * rng.standard_normal(SHAPE)) * np.ones((4, 1, 1))
    cells[2:, 1:3, 1:3] *= 0.4
    exact = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    recorded = exact + scene.circuit.sigma(exact) * rng.standard_normal(exact.shape)
    for row, column in holes:
        recorded[2:, row, column] = np.nan
    return recording_of(scene, recorded, 2, truth_cell_resistance=cells)


def test_the_optimum_with_a_penalty_uses_only_the_present_readings() -> None:
    """Against scipy's least squares over those readings alone, with a network of its own."""
    noisy = recording(TWO_POINT)
    weight = 1e-4
    estimate = reconstruct(noisy, Estimator((Misfit(), CellResistance(weight=weight)), "reduced"))
    measured = estimate.measured[0].ravel()
    observed = np.isfinite(measured)

    def residual(log_cells: np.ndarray) -> np.ndarray:
        model = two_point_resistances(np.exp(log_cells).reshape(SHAPE)).ravel()
        return np.concatenate([(model - measured)[observed], np.sqrt(weight) * np.exp(log_cells)])

    best = least_squares(
        residual,
        np.log(estimate.cell_resistance[0].ravel()) + 0.1,
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-12,
    )
    assert_allclose(estimate.cell_resistance[0].ravel(), np.exp(best.x), rtol=CONVERGED)


@pytest.mark.parametrize(
    ("readout", "formulation"), CASES, ids=lambda value: getattr(value, "kind", value)
)
def test_single_holes_leave_every_frame_an_estimate(
    readout: object, formulation: MethodName
) -> None:
    scene = Scene(Panel(*SHAPE), readout)
    try:
        terms = ROBUST if formulation == "smoother" else (Misfit(),)
        estimate = reconstruct(recording(scene), Estimator(terms, formulation))
    except InputError as error:
        assert "knows readout.kind: two_point only" in str(error)
        return
    assert estimate.solved.all() and np.isfinite(estimate.cell_resistance).all()
    assert_array_equal(estimate.missing_readings, [2, 2])
    assert_array_equal(np.isnan(estimate.measured[0]), np.isnan(estimate.recording.recorded[2]))
