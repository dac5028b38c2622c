"""One call of machine code finds what Newton's method finds, says when it does not, and is the same as plain Python."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.cost.problem import Evaluation
from lampest.cost.terms import Term
from lampest.estimate.estimator import Bounds, Estimator
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.recording.readings import Readings
from lampest.solvers import search
from lampest.solvers.certificate import certificate
from lampest.solvers.kernel import following
from lampest.solvers.kernel.following import KeptFactor, Workbench, from_previous, serves
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.solution import STRICT, Settings, Solution, Status

MISFIT = lampest.Misfit(weighting="noise")
TERMS: dict[str, tuple[Term, ...]] = {
    "LSM": (MISFIT,),
    "LSR-CR": (MISFIT, lampest.CellResistance(weight=1e-6)),
    "LSR-dCR": (MISFIT, lampest.RelativeChange(weight=1e-2)),
    "LSR-gCR": (MISFIT, lampest.Gradient(weight=1e-5)),
    "LSR-gdCR": (MISFIT, lampest.GradientOfRelativeChange(weight=1e-2)),
    "huber": (lampest.Misfit(weighting="noise", loss=lampest.Huber(corner=2.0)), lampest.Gradient(weight=1e-5)),
    "log": (MISFIT, lampest.LogRatio(weight=1.0, loss=lampest.Squared())),
}
READOUTS: dict[str, Readout] = {
    "two_point": lampest.TwoPointReadout(adc_bits=12, reference_ohm=400.0),
    "loaded": lampest.LoadedColumnsReadout(adc_bits=14, load_ohm=700.0, drive_ohm=30.0),
    "diode": lampest.LoadedColumnsReadout(adc_bits=14, load_ohm=700.0, driven="columns", diode=lampest.Diode()),
    "virtual_ground": lampest.VirtualGroundReadout(adc_bits=14, feedback_ohm=300.0),
    "grounded": lampest.GroundedReadout(adc_bits=14),
}


def frames(readout: Readout, count: int = 4, **scene: object) -> tuple[lampest.Scene, Array]:
    """A small panel of which cells drift from frame to frame, with noise; (frames, rows, columns) as recorded."""
    rng = np.random.default_rng(3)
    scenery = lampest.Scene(lampest.Panel(5, 6), readout, **scene)
    cells = 1000 * np.exp(0.3 * rng.standard_normal((1, 5, 6)) + 0.02 * rng.standard_normal((count, 5, 6)))
    recorded = readout.to_recorded(readout.exact_reading(cells), scenery)
    return scenery, recorded + readout.sigma(recorded) * rng.standard_normal(cells.shape)


def begun(scene: lampest.Scene, recorded: Array, estimator: Estimator) -> Stream:
    """A stream after the first frame."""
    resting = Readings.of(scene, recorded[:1]).mean()
    return Stream.begin(estimator, scene, 0.2, resting).push(Readings.of(scene, recorded[1]))[0]


@contextmanager
def noted() -> Iterator[list[Solution | None]]:
    """What machine code made of the frames meanwhile."""
    answers: list[Solution | None] = []

    def asked(*given: object) -> Solution | None:
        answers.append(from_previous(*given))
        return answers[-1]

    with patch.object(search, "from_previous", asked):
        yield answers


def both(stream: Stream, readings: Readings) -> tuple[Solution, Solution]:
    """A frame by Newton's method alone, and by machine code alone."""
    with patch.object(following, "serves", lambda *given: False):
        newton = stream.push(readings)[1].solution
    with noted() as answers:
        found = stream.push(readings)[1].solution
    assert answers and answers[-1] is not None, "the frame fell back"
    return newton, found


def assert_same(newton: Solution, found: Solution) -> None:
    assert newton.status is found.status and found.status in STRICT
    assert found.objective <= newton.objective + 1e-6 * max(newton.objective, 1e-4)
    assert_allclose(found.cell_resistance, newton.cell_resistance, rtol=2e-6)
    assert_allclose(found.reading, newton.reading, rtol=1e-6)
    np.testing.assert_array_equal(found.at_lower, newton.at_lower)
    np.testing.assert_array_equal(found.open_cell, newton.open_cell)


@pytest.mark.parametrize("readout", READOUTS)
@pytest.mark.parametrize("terms", ["LSM", "LSR-CR", "LSR-gdCR", "huber"])
def test_every_readout(readout: str, terms: str) -> None:
    scene, recorded = frames(READOUTS[readout])
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    for frame in recorded[2:]:
        readings = Readings.of(scene, frame)
        assert_same(*both(stream, readings))
        stream, _ = stream.push(readings)


@pytest.mark.parametrize("terms", [name for name in TERMS if name != "huber"])
def test_holes_and_faults(terms: str) -> None:
    """Readings that say nothing, a bound at a rail, and an open cell that is held."""
    scene, recorded = frames(READOUTS["two_point"], faults=lampest.Faults(open=((1, 1),)))
    recorded[:, 3, 4] = np.nan
    recorded[:, 0, 2] = np.inf
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    assert_same(*both(stream, Readings.of(scene, recorded[2])))


@pytest.mark.parametrize("terms", ["LSM", "LSR-CR", "LSR-dCR", "log"])
def test_cells_pressed_against_bounds(terms: str) -> None:
    """Many cells would leave the bounds, not the same ones in every frame."""
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


@pytest.mark.parametrize("terms", TERMS)
def test_what_is_certified_is_a_settled_minimum(terms: str) -> None:
    """By second derivatives taken anew at the very place; without, a factor was kept from frame to frame."""
    scene, recorded = frames(READOUTS["two_point"], 6)
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    for frame in recorded[2:]:
        readings = Readings.of(scene, frame)
        data, _ = stream.given(readings)
        stream, step = stream.push(readings)
        solver = stream.estimator.problem(scene, 1, 0.2)
        at = Evaluation.at(solver.cost, data, step.cell_resistance[None])
        curvature = Curvature(at, Smoothing.start(at))
        assert certificate(curvature, curvature.gradient).settled
    assert isinstance(stream.prepared, KeptFactor)


@pytest.mark.parametrize("readout", READOUTS)
def test_a_point_is_priced_alike(readout: str) -> None:
    """Readings, costs and gradient from machine code are those of the network and the cost."""
    scene, recorded = frames(READOUTS[readout])
    stream = begun(scene, recorded, Estimator(TERMS["LSR-gdCR"], "reduced", error_bars=False))
    data, previous = stream.given(Readings.of(scene, recorded[2]))
    assert previous is not None
    cost = stream.estimator.problem(scene, 1, 0.2).cost
    expected, found = Evaluation.at(cost, data, previous), Workbench(cost, data).point(previous)
    assert_allclose(found.reading, expected.reading, rtol=1e-11)
    assert_allclose(found.costs, expected.costs, rtol=1e-9)
    gradient = expected.log_gradient(np.zeros(0))
    assert_allclose(found.log_gradient(np.zeros(0)), gradient, rtol=1e-8, atol=1e-10 * np.abs(gradient).max())
    assert found.cost_scale == pytest.approx(expected.cost_scale, rel=1e-10)


def test_what_it_does_not_know_it_leaves() -> None:
    scene, recorded = frames(READOUTS["two_point"])
    rough = (lampest.Misfit(weighting="noise", loss=lampest.Absolute()), lampest.Gradient(weight=1e-5))
    wired = replace(scene, lines=lampest.Lines(row_ohm_per_cell=1.0, column_ohm_per_cell=1.0))
    for other, terms in ((scene, rough), (wired, TERMS["LSR-CR"])):
        estimator = Estimator(terms, "reduced", error_bars=False)
        stream = begun(other, recorded, estimator)
        data, previous = stream.given(Readings.of(other, recorded[2]))
        solver = estimator.problem(other, 1, 0.2)
        assert isinstance(solver, Newton) and previous is not None
        assert not serves(solver.cost, data) and from_previous(solver, data, previous) is None
        assert stream.push(Readings.of(other, recorded[2]))[1].solution.status is Status.OPTIMUM


def test_newton_goes_on_where_it_falls_short() -> None:
    """The frame is solved all the same."""
    scene, recorded = frames(READOUTS["two_point"])
    estimator = Estimator(TERMS["LSR-CR"], "reduced", error_bars=False)
    stream = begun(scene, recorded, estimator)
    readings = Readings.of(scene, recorded[2])
    assert stream.previous is not None
    far = replace(stream, previous=stream.previous * np.geomspace(0.02, 50, 30).reshape(5, 6), prepared=None)
    right = stream.push(readings)[1].solution.cell_resistance
    with noted() as answers, patch.object(following, "descended", lambda *given: None):
        found = far.push(readings)[1].solution
    assert answers == [None]
    assert found.status is Status.OPTIMUM
    assert_allclose(found.cell_resistance, right, rtol=1e-6)
    few = replace(stream, estimator=replace(estimator, solver=Settings(max_iterations=1)), prepared=None)
    assert few.push(readings)[1].solution.status in (Status.OPTIMUM, Status.ITERATIONS)


def test_a_hard_frame_is_begun_elsewhere_by_machine_code_too() -> None:
    """From cells that are far off more than four factors are made; all starts end in the one minimum that there is."""
    scene, recorded = frames(READOUTS["two_point"])
    stream = begun(scene, recorded, Estimator(TERMS["LSR-CR"], "reduced", error_bars=False))
    readings = Readings.of(scene, recorded[2])
    assert stream.previous is not None
    easy = stream.push(readings)[1].solution
    far = replace(stream, previous=stream.previous * np.geomspace(0.02, 50, 30).reshape(5, 6), prepared=None)
    ended: list[object] = []
    original = following.descended
    with patch.object(following, "descended", lambda *given: ended.append(original(*given)) or ended[-1]):
        hard = far.push(readings)[1].solution
    assert hard.starts == len(ended) >= 5 and all(ended) and easy.starts == 1
    assert_allclose(hard.cell_resistance, easy.cell_resistance, rtol=1e-6)


def test_cells_that_come_off_arrive_at_once() -> None:
    """A step that is straight in conductance takes 4 factors to their bound; in log r it took 20."""
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


def test_it_is_compiled_once() -> None:
    """Arrays that may only be read, and noise that nobody knows, ask for no other machine code."""
    from lampest.solvers.kernel.descent import descend
    from lampest.solvers.kernel.points import appraised

    scene, recorded = frames(READOUTS["two_point"])
    sigma = np.broadcast_to(np.full((5, 6), 0.5), (5, 6))
    for given in (Readings.of(scene, recorded[2], sigma), replace(Readings.of(scene, recorded[2]), sigma=None)):
        stream = begun(
            scene, recorded, Estimator((lampest.Misfit(),), "reduced", bounds=Bounds(upper=1e6), error_bars=False)
        )
        assert stream.push(given)[1].solution.status is Status.OPTIMUM
    assert len(descend.signatures) == len(appraised.signatures) == 1


def test_a_wrong_factor_spoils_nothing() -> None:
    """One that makes far too long or short steps, or none, costs steps, no digit and no verdict."""
    scene, recorded = frames(READOUTS["two_point"])
    stream = begun(scene, recorded, Estimator(TERMS["LSR-CR"], "reduced", error_bars=False))
    stream, _ = stream.push(Readings.of(scene, recorded[2]))
    readings, kept = Readings.of(scene, recorded[3]), stream.prepared
    assert isinstance(kept, KeptFactor)
    right = stream.push(readings)[1].solution
    assert kept.triangle is not None
    for factor in (1e-3, 1e3, np.nan, 0.0):
        wrong = replace(kept, triangle=kept.triangle * factor)
        found = replace(stream, prepared=wrong).push(readings)[1].solution
        assert found.status is Status.OPTIMUM
        assert_allclose(found.cell_resistance, right.cell_resistance, rtol=1e-6)


SCRIPT = """
import numpy as np
from lampest.solvers.kernel import following
from units.test_kernel import READOUTS, TERMS, Estimator, Readings, begun, both, frames
found = []
cases = [(256, "two_point", "LSR-gdCR"), (256, "diode", "LSM"), (256, "grounded", "huber")]
for most, readout, terms in cases + [(0, "diode", "LSR-gdCR"), (0, "two_point", "LSM")]:
    following.DENSE_UNKNOWNS = following.FACTORED_UNKNOWNS = most
    scene, recorded = frames(READOUTS[readout])
    stream = begun(scene, recorded, Estimator(TERMS[terms], "reduced", error_bars=False))
    found.append(both(stream, Readings.of(scene, recorded[2]))[1].cell_resistance)
np.save("found.npy", np.stack(found))
"""


def printed(folder: Path, **environment: str) -> Array:
    """What another process finds under other variables."""
    folder.mkdir()
    house = Path(__file__).parents[2]
    paths = os.pathsep.join([str(house), str(house / "tests")])
    given = os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"} | environment
    subprocess.run([sys.executable, "-c", SCRIPT], cwd=folder, env=given, check=True)
    found: Array = np.load(folder / "found.npy")
    return found


@pytest.mark.slow
def test_plain_python_gives_the_same_numbers(tmp_path: Path) -> None:
    assert_allclose(printed(tmp_path / "plain", NUMBA_DISABLE_JIT="1"), printed(tmp_path / "machine"), rtol=1e-9)
