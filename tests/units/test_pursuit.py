"""Panels between small and large: one call without matrices finds what Newton's method finds, and says when not."""

from collections.abc import Iterator
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.cost.problem import Evaluation
from lampest.estimate.estimator import Bounds, Estimator
from lampest.recording.readings import Readings
from lampest.solvers.certificate import certificate
from lampest.solvers.kernel import following, pursuing
from lampest.solvers.kernel.following import Workbench, from_previous
from lampest.solvers.kernel.pursuing import KeptPreconditioner
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.solution import STRICT, Settings
from tests.units.test_kernel import READOUTS, TERMS, assert_same, begun, both, frames


@pytest.fixture(autouse=True)
def larger() -> Iterator[None]:
    """Panels of any size are as those that are too large for a factor."""
    with patch.multiple(following, DENSE_UNKNOWNS=0, FACTORED_UNKNOWNS=0):
        yield


@pytest.mark.slow
@pytest.mark.parametrize("readout", READOUTS)
@pytest.mark.parametrize("terms", ["LSM", "LSR-CR", "LSR-gdCR", "huber"])
def test_every_readout(readout: str, terms: str) -> None:
    scene, recorded = frames(READOUTS[readout])
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    for frame in recorded[2:]:
        readings = Readings.of(scene, frame)
        assert_same(*both(stream, readings))
        stream, _ = stream.push(readings)
        assert isinstance(stream.prepared, KeptPreconditioner)


@pytest.mark.slow
@pytest.mark.parametrize("terms", [name for name in TERMS if name != "huber"])
def test_holes_and_faults(terms: str) -> None:
    """Readings that say nothing, a bound at a rail, and an open cell that is held."""
    scene, recorded = frames(READOUTS["two_point"], faults=lampest.Faults(open=((1, 1),)))
    recorded[:, 3, 4] = np.nan
    recorded[:, 0, 2] = np.inf
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    assert_same(*both(stream, Readings.of(scene, recorded[2])))


@pytest.mark.slow
@pytest.mark.parametrize("terms", ["LSM", "LSR-CR", "LSR-dCR", "log"])
def test_cells_pressed_against_bounds(terms: str) -> None:
    scene, recorded = frames(READOUTS["two_point"], 6)
    estimator = Estimator(TERMS[terms], "reduced", bounds=Bounds(lower=850.0, upper=1250.0), error_bars=False)
    stream, held = begun(scene, recorded, estimator), 0
    for frame in recorded[2:]:
        readings = Readings.of(scene, frame)
        newton, found = both(stream, readings)
        assert_same(newton, found)
        held += int(np.sum((found.cell_resistance <= 850.0 * 1.001) | (found.cell_resistance >= 1250.0 * 0.999)))
        stream, _ = stream.push(readings)
    assert held > 20


@pytest.mark.slow
@pytest.mark.parametrize("readout", READOUTS)
@pytest.mark.parametrize("terms", ["LSM", "LSR-gdCR", "huber"])
@pytest.mark.parametrize("straight", [0, -1])
def test_products_are_those_with_second_derivatives(readout: str, terms: str, straight: int) -> None:
    """H·s in u = log r, and with ∂φ/∂u added to its diagonal in relative 1/r; Gauss and Newton's never bends down."""
    from lampest.solvers.kernel.applied import preconditioned
    from lampest.solvers.kernel.lined import made_preconditioner
    from lampest.solvers.kernel.points import blank_point, priced
    from lampest.solvers.kernel.products import bent_along, modelled

    scene, recorded = frames(READOUTS[readout])
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    data, previous = stream.given(Readings.of(scene, recorded[2]))
    assert previous is not None
    cost = stream.estimator.problem(scene, 1, 0.2).cost
    at = Evaluation.at(cost, data, previous)
    curvature = Curvature(at, Smoothing.start(at))
    bench = Workbench(cost, data)
    bench.point(previous)
    arena, point = bench.arena, blank_point(11, 30)
    point[0][1] = previous.ravel()
    priced(arena.addresses, arena.where, arena.memory, data.ties, point)
    for whole in (True, False):
        given = (arena.addresses, arena.where, arena.memory, arena.entries, point, straight, whole)
        model, links = modelled(*given)
        matrix = np.empty((30, 30))
        for cell, unit in enumerate(np.eye(30)):
            bent_along(arena.addresses, 5, model, links, point, whole, unit, matrix[cell])
        assert_allclose(matrix, matrix.T, rtol=1e-7, atol=1e-9 * np.abs(matrix).max())
        if whole:
            expected = curvature.matrix - straight * np.diag(curvature.gradient)
            assert_allclose(matrix, expected, rtol=1e-6, atol=1e-9 * np.abs(matrix).max())
        else:
            assert np.linalg.eigvalsh(matrix)[0] > -1e-9 * np.abs(matrix).max()
        found = made_preconditioner(arena.addresses, 5, model, links, point, arena.band, data.ties[0])
        inverse = np.stack([preconditioned(arena.addresses, 5, *found[:3], unit) for unit in np.eye(30)])
        assert found[3] and np.linalg.eigvalsh((inverse + inverse.T) / 2)[0] > 0
        assert_allclose(inverse, inverse.T, rtol=1e-6, atol=1e-9 * np.abs(inverse).max())


@pytest.mark.parametrize("terms", TERMS)
def test_what_is_certified_is_a_settled_minimum(terms: str) -> None:
    """By a factor of second derivatives at the very place."""
    scene, recorded = frames(READOUTS["two_point"], 6)
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    for frame in recorded[2:]:
        readings = Readings.of(scene, frame)
        data, _ = stream.given(readings)
        stream, step = stream.push(readings)
        at = Evaluation.at(stream.estimator.problem(scene, 1, 0.2).cost, data, step.cell_resistance[None])
        curvature = Curvature(at, Smoothing.start(at))
        assert certificate(curvature, curvature.gradient).settled


def test_newton_goes_on_where_it_falls_short() -> None:
    """Terms that tie cells further apart than it knows, and an end of patience."""
    scene, recorded = frames(READOUTS["two_point"])
    estimator = Estimator(TERMS["LSR-gCR"], "reduced", error_bars=False)
    stream = begun(scene, recorded, estimator)
    readings = Readings.of(scene, recorded[2])
    right = stream.push(readings)[1].solution.cell_resistance
    data, previous = stream.given(readings)
    solver = estimator.problem(scene, 1, 0.2)
    assert previous is not None and from_previous(solver, data, previous) is not None
    with patch.object(pursuing, "WIDEST", 0):
        assert from_previous(solver, data, previous) is None
        assert_allclose(stream.push(readings)[1].solution.cell_resistance, right, rtol=1e-6)
    assert from_previous(replace(solver, settings=Settings(max_iterations=1)), data, previous * 9) is None
    assert from_previous(solver, data.limited(0.0), previous) is None


def test_cells_that_come_off_arrive() -> None:
    """Straight in conductance they take few steps to their bound."""
    scene, recorded = frames(READOUTS["two_point"])
    stream = begun(scene, recorded, Estimator(TERMS["LSM"], "reduced", error_bars=False))
    opened = 1000 * np.ones((5, 6))
    opened[1, 1] = opened[2, 4] = 1e9
    readout = READOUTS["two_point"]
    values = readout.to_recorded(readout.exact_reading(opened), scene)
    noise = readout.sigma(values) * np.random.default_rng(5).standard_normal((5, 6))
    newton, found = both(stream, Readings.of(scene, values + noise))
    assert newton.status is found.status and found.status in STRICT
    assert found.objective <= newton.objective * (1 + 1e-9)
    assert min(found.cell_resistance[0, 1, 1], found.cell_resistance[0, 2, 4]) > 1e5 and found.iterations <= 8


@pytest.mark.parametrize("terms", ["LSR-CR", "LSR-gdCR"])
def test_a_hard_frame_is_begun_elsewhere_without_factors(terms: str) -> None:
    """Every start, and two beside a soft direction; they end in the one minimum there is."""
    scene, recorded = frames(READOUTS["two_point"])
    with patch.object(following, "DENSE_UNKNOWNS", 256):
        stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
        readings, ended = Readings.of(scene, recorded[2]), []
        assert stream.previous is not None
        easy = stream.push(readings)[1].solution
        far = replace(stream, previous=stream.previous * np.geomspace(0.02, 50, 30).reshape(5, 6), prepared=None)
        with patch.object(following, "pursued", lambda *given: ended.append(pursuing.pursued(*given)) or ended[-1]):
            hard = far.push(readings)[1].solution
    assert easy.starts <= 3 and len(ended) == hard.starts >= 5 and all(ended)
    if terms == "LSR-CR":  # the other compares with a frame that was changed
        assert_allclose(hard.cell_resistance, easy.cell_resistance, rtol=1e-6)


@pytest.mark.parametrize("readout", ["two_point", "loaded"])
@pytest.mark.parametrize("terms", ["LSR-CR", "LSR-gCR", "LSR-gdCR"])
def test_the_softest_direction_is_that_of_second_derivatives(readout: str, terms: str) -> None:
    """Without a matrix: whether there is one, and which, at shares of the second least that let both come out."""
    from lampest.solvers.kernel.softness import softest_vector

    scene, recorded = frames(READOUTS[readout], 6)
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    for frame in recorded[2:]:
        data, _ = stream.given(Readings.of(scene, frame))
        stream, step = stream.push(Readings.of(scene, frame))
        kept = stream.prepared
        assert isinstance(kept, KeptPreconditioner)
        at = Evaluation.at(stream.estimator.problem(scene, 1, 0.2).cost, data, step.cell_resistance[None])
        values, vectors = np.linalg.eigh(Curvature(at, Smoothing.start(at)).matrix)
        bench, position = Workbench(at.cost, data), at.position.ravel()
        assert values[0] < 0.8 * values[1]
        for share in (0.97 * values[0] / values[1], 1.03 * values[0] / values[1]):
            found, along = softest_vector(*bench.given, position, *kept.parts[:3], share)
            assert found == (share * values[1] > values[0])
            assert abs(along @ vectors[:, 0]) > 0.99


def test_a_preconditioner_is_kept_from_frame_to_frame() -> None:
    """As long as cells stand near where it was made; it makes no digit of what is found."""
    scene, recorded = frames(READOUTS["two_point"], 6)
    stream = begun(scene, recorded, Estimator(TERMS["log"], "reduced", error_bars=False))
    stream, _ = stream.push(Readings.of(scene, recorded[2]))
    kept, readings = stream.prepared, Readings.of(scene, recorded[3])
    again, step = stream.push(readings)
    assert again.prepared is kept and isinstance(kept, KeptPreconditioner)
    alone, fresh = replace(stream, prepared=None).push(readings)
    assert isinstance(alone.prepared, KeptPreconditioner) and alone.prepared is not kept
    assert_allclose(step.cell_resistance, fresh.cell_resistance, rtol=1e-6)
    values = np.random.default_rng(1).standard_normal(30)
    assert values @ kept.solve(values) > 0
    assert stream.previous is not None
    far, _ = replace(stream, previous=stream.previous * 2).push(readings)
    assert far.prepared is not kept
