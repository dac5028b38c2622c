"""A frame that takes longer than `solver.time_limit_s` ends with a status of that name, in every formulation."""

import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lampest
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.recording.readings import Readings
from lampest.solvers import projected_newton as newton_module
from lampest.solvers.solution import Settings

SCENE = lampest.Scene(lampest.Panel(4, 5), lampest.TwoPointReadout(noise_lsb=0.7))
SHORT, LONG = Settings(time_limit_s=1e-9), Settings(time_limit_s=1e9)
STUDENT = lampest.Misfit(weighting="noise", loss=lampest.Student(corner=4))
FORMULATIONS: dict[Any, tuple[Any, ...]] = {
    "reduced": (lampest.Misfit(), lampest.Gradient(weight=1e-3)),
    "nodal": (lampest.Misfit(), lampest.Gradient(weight=1e-3)),
    "per_pixel": (lampest.Misfit(), lampest.CellResistance(weight=1e-3)),
    "smoother": (STUDENT,),
}


def recorded(frames: int = 4) -> Any:
    """Ohm as the divider gives it (frames, rows, columns)."""
    rng = np.random.default_rng(5)
    cells = 1000 * np.exp(0.3 * rng.standard_normal((1, 4, 5)) + 0.05 * rng.standard_normal((frames, 4, 5)))
    readout = SCENE.readout
    assert readout is not None
    return readout.to_recorded(readout.exact_reading(cells), SCENE)


def streamed(estimator: Estimator) -> list[Any]:
    """The steps of all frames after the first, which is at rest."""
    frames = recorded()
    stream, steps = Stream.begin(estimator, SCENE, 0.2, Readings.of(SCENE, frames[:1]).mean()), []
    for frame in frames[1:]:
        stream, step = stream.push(Readings.of(SCENE, frame))
        steps.append(step)
    return steps


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_what_is_not_solved_in_time_is_no_number_and_says_so(formulation: Any) -> None:
    estimator = Estimator(FORMULATIONS[formulation], formulation, solver=SHORT, error_bars=False)
    stream = Stream.begin(estimator, SCENE, 0.2, Readings.of(SCENE, recorded()[:1]).mean())
    steps = [stream.push(Readings.of(SCENE, recorded()[1]))[1]]
    # The start of plain least squares, with which the smoother begins, is an optimum already.
    steps += [] if formulation == "smoother" or stream.baseline is None else [stream.baseline]
    for step in steps:
        assert step.status == "the time limit was reached before an optimum" and np.isnan(step.cell_resistance).all()


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_limit_that_is_not_reached_changes_nothing(formulation: Any) -> None:
    estimator = Estimator(FORMULATIONS[formulation], formulation)
    for free, limited in zip(streamed(estimator), streamed(replace(estimator, solver=LONG)), strict=True):
        np.testing.assert_array_equal(free.cell_resistance, limited.cell_resistance)
        assert free.status == limited.status == "optimum verified"


def test_a_solve_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    truly = newton_module.trust_region_step

    def slowly(*arguments: Any) -> Any:
        time.sleep(0.05)
        return truly(*arguments)

    monkeypatch.setattr(newton_module, "trust_region_step", slowly)
    estimator = Estimator(FORMULATIONS["reduced"], "reduced", solver=Settings(time_limit_s=0.08), error_bars=False)
    stream = Stream.begin(estimator, SCENE, 0.2, Readings.of(SCENE, recorded()[:1]).mean())
    assert stream.baseline is not None
    assert stream.baseline.status == "the time limit was reached before an optimum"
    assert 1 <= stream.baseline.solution.iterations <= 2


@pytest.mark.slow
def test_a_batch_says_which_frames_were_not_solved_in_time(
    disk: SimpleNamespace, lampest: Callable[..., SimpleNamespace]
) -> None:
    from lampest import read_results

    path = disk.run(disk.text + "solver: {time_limit_s: 1e-9}\n")
    assert lampest("run", path, "--out", disk.folder / "out", "--jobs", "1").code in (0, 3)
    cases = read_results(disk.folder / "out" / "results.h5").cases
    assert len(cases) == 3
    for case in cases:
        if case.estimator == "LSM":
            continue  # its start is an optimum already
        assert set(case.status) == {"the time limit was reached before an optimum"} and not case.solved.any()
