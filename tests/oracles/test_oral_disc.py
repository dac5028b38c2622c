"""Eight numbers instead of cells: the disc that made the readings comes back, and the cells with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lampest.cost.terms import Gradient, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.loads.shapes import OralDisc
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene, Systematic, Water
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.report.detect.detection import detect_recording
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import local
from lampest.runs.results import read_results
from lampest.solvers.solution import Status

pytestmark = pytest.mark.slow

DISC = Estimator((Misfit(),), "oral_disc")
ELECTRONICS = Systematic(reference_tolerance=0.01, channel_spread_ohm=3.0)


def lamprey(
    seed: int,
    diameter_mm: float,
    shape: tuple[int, int] = (9, 11),
    systematic: Systematic | None = ELECTRONICS,
    **more: float,
) -> Recording:
    """Three frames of an attached mouth, somewhere on a panel under water, with what the scene says may be off."""
    rng = np.random.default_rng(seed)
    place = (float(rng.uniform(30, 70)), float(rng.uniform(25, 55)))
    scene = Scene(
        Panel(*shape),
        TwoPointReadout(),
        series_resistance_ohm=140.0,
        water=Water(50.0),
        systematic=systematic,
    )
    load = OralDisc(
        kind="oral_disc", centre_mm=place, diameter_mm=diameter_mm, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=80
    )
    off = Unmodelled(channel_spread_ohm=3.0, reference_tolerance=0.01, **more)
    return simulate(Simulation(1, seed, scene, frames=3, loads=(load,), unmodelled=off))


@pytest.mark.parametrize("diameter_mm", [25.0, 34.0, 43.0])
def test_the_disc_and_its_cells_come_back(diameter_mm: float) -> None:
    errors, cells = [], []
    for seed in (1, 2):
        recording = lamprey(seed, diameter_mm)
        found = reconstruct(recording, DISC)
        truth = recording.truth_cell_resistance
        assert truth is not None
        for step in found.steps:
            assert step.solution.status is Status.FITTED and step.disc is not None
            errors.append(abs(step.disc.disc.diameter_mm - diameter_mm))
            assert 0 < step.disc.disc_errors.diameter_mm < 5
        cells.append(np.abs(np.log(found.cell_resistance / truth[recording.measured_frames()])))
    assert np.median(errors) < 1
    assert max(errors) < 3
    assert np.median(np.concatenate(cells)) < 0.05


@pytest.mark.parametrize("systematic", [None, Systematic(reading_error=0.05)], ids=["learned", "told"])
def test_readings_that_stay_off_are_allowed_for(systematic: Systematic | None) -> None:
    """Each reading off by 5 %, the same in all frames, which still cells tell where the scene does not."""
    recording = lamprey(2, 34.0, systematic=systematic, reading_error=0.05)
    found, truth = reconstruct(recording, DISC), recording.truth_cell_resistance
    assert truth is not None
    away = np.abs(np.log(found.cell_resistance / truth[recording.measured_frames()]))
    assert away.mean() < 0.25
    assert all(step.disc and abs(step.disc.disc.diameter_mm - 34) < 2 for step in found.steps)


def test_cells_depart_from_the_disc_as_readings_say() -> None:
    """A film that answers a fifth less, by an eighth more or less in each cell: the disc alone is off by that."""
    recording = lamprey(2, 34.0, response_loss=0.2, response_spread=0.12)
    truth = recording.truth_cell_resistance
    assert truth is not None
    loaded, resting = truth[recording.measured_frames()][-1], truth[0]
    step = reconstruct(recording, DISC).steps[-1]
    assert step.disc is not None
    change = np.log(loaded / resting)
    of_disc, of_cells = step.disc.fit.change - change, np.log(step.disc.cell_resistance / loaded)

    def rms(error: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
        return float(np.sqrt(np.mean(error[where] ** 2)))

    rim = change < -0.5  # readings determine these; a cell that is sucked open they do not
    assert rms(of_cells, rim) < 0.25 * rms(of_disc, rim)
    assert rms(of_cells, np.abs(change) > 0.5) < rms(of_disc, np.abs(change) > 0.5)


def test_strong_suction_leaves_no_smaller_disc_possible(tmp_path: Path) -> None:
    """Cells that suction opens change the readings by little more, but by much where they would close again."""
    scene = Scene(Panel(10, 10), TwoPointReadout(), series_resistance_ohm=140.0)
    load = OralDisc(centre_mm=(45.2, 51.3), diameter_mm=32.2, rim_width_mm=4.5, pressure_kpa=-20, rim_kpa=60)
    off = Unmodelled(channel_spread_ohm=3.0, reference_tolerance=0.01, response_spread=0.25, response_loss=0.3)
    times = {"frames": 12, "baseline_frames": 5, "frame_period_s": 0.25, "course": Course(start_s=2.0)}
    simulate(Simulation(1, 1, scene, loads=(load,), unmodelled=off, **times)).save(tmp_path / "mouth.h5")
    (found,) = detect_recording(tmp_path / "mouth.h5").attachments
    assert found.diameter_mm is not None
    assert found.diameter_mm[1] < 3 and abs(found.diameter_mm[0] - 32.2) < 2 * found.diameter_mm[1]


def test_it_needs_the_noise_and_nothing_to_penalise() -> None:
    recording = lamprey(3, 30.0)
    silent = replace(recording, scene=replace(recording.scene, readout=None), raw_sums=None, raw_readings=None)
    with pytest.raises(InputError):
        reconstruct(replace(silent, sigma=None), DISC)
    with pytest.raises(ValueError, match="misfit alone"):
        Estimator((Misfit(), Gradient()), "oral_disc")


def test_its_numbers_are_in_the_results(tmp_path: Path) -> None:
    lamprey(4, 30.0).save(tmp_path / "mouth.h5")
    text = "schema: 1\nrecordings: [mouth.h5]\nestimators: {disc: {terms: {misfit: {}}, formulation: oral_disc}}\n"
    (tmp_path / "run.yaml").write_text(text)
    run_batch(read_run(tmp_path / "run.yaml"), tmp_path / "out", local(1, 1))
    (case,) = read_results(tmp_path / "out" / "results.h5").cases
    assert case.solved.all() and case.cell_resistance_errors is None
    assert np.all(np.abs(case.disc["diameter_mm"] - 30) < 3)
    assert set(case.disc) >= {"x_mm", "y_mm", "suction_kpa", "rim_kpa", "diameter_mm_errors"}
    assert np.isnan(case.kkt_residual).all()
