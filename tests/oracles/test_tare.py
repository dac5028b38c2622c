"""Zero taken anew: drift is taken off where nothing touches the panel, a load never, and results say when and why."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lampest import Estimates, Estimator, InputError, Panel, Recording, Scene, Stream, TwoPointReadout, Unmodelled
from lampest.cost.terms import Misfit, RelativeChange, Term
from lampest.estimate.sequence import reconstruct
from lampest.loads.pressure import Tare, TareWatch, pressure_of
from lampest.loads.shapes import OralDisc, Shape, SuctionCup
from lampest.panel.response import Film, PublishedResponse
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.runs.filling import named_result
from lampest.runs.results import read_results, write_results

FILM = Film(0.2, 0.05)
LAMPREY = OralDisc(kind="oral_disc", centre_mm=(25, 27), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-8, rim_kpa=50)
WEAK = replace(LAMPREY, pressure_kpa=-0.6, rim_kpa=2.0)
CUP = SuctionCup(kind="suction_cup", centre_mm=(25, 25), inner_diameter_mm=24, outer_diameter_mm=32, pressure_kpa=-1.5)
ARRIVES, LEAVES = 30, 70


def made(load: Shape, seed: int = 1, film: Film | None = FILM, drift: float = 0.01, approach: float = 1.0) -> Recording:
    """130 frames of 6 × 6 cells that drift; the load is there from ARRIVES to LEAVES."""
    course = Course(start_s=ARRIVES, approach_s=approach, release_at_s=LEAVES, release_s=1)
    scene = Scene(Panel(6, 6), TwoPointReadout(adc_bits=12), 140.0, film=film, response=PublishedResponse())
    unmodelled = Unmodelled(drift_per_minute=drift)
    return simulate(
        Simulation(1, seed, scene, frames=130, loads=(load,), course=course, film=film, unmodelled=unmodelled)
    )


@cache
def found(tare: Tare | None) -> Estimates:
    return reconstruct(made(LAMPREY), Estimator((Misfit(),), "reduced", tare=tare))


@pytest.mark.slow
def test_drift_is_taken_off_and_the_load_is_not() -> None:
    truth = found(None).recording.truth_pressure
    errors = []
    for tare in (None, Tare(10)):
        estimates = found(tare)
        errors.append(np.abs(estimates.pressure - truth[estimates.frame]))
    before, after = errors
    assert np.percentile(after[-20:], 90) < 0.4 * np.percentile(before[-20:], 90)
    loaded = slice(ARRIVES + 2, LEAVES - 1)
    assert np.percentile(after[loaded], 90) < 1.2 * np.percentile(before[loaded], 90)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("load", "approach"), [(LAMPREY, 1.0), (WEAK, 1.0), (WEAK, 20.0), (CUP, 5.0)])
@pytest.mark.parametrize("film", [None, FILM])
def test_nothing_attached_is_never_taken_for_zero(load: Shape, approach: float, seed: int, film: Film | None) -> None:
    """Of the true cells with noise of 0.7 %; a load that has reached 0.1 kPa somewhere is there."""
    recording = made(load, seed, film, approach=approach)
    cells, truth = recording.truth_cell_resistance, recording.truth_pressure
    noise = np.exp(0.007 * np.random.default_rng(seed).standard_normal(cells.shape))
    ratio = (cells * noise / cells[0])[3:]
    tared = pressure_of(ratio, ratio, ratio, recording.scene, recording.time[3:], tare=Tare(10)).tared
    at = np.flatnonzero([bool(why) for why in tared])
    pressed = np.abs(truth[3:]).max(axis=(1, 2)) > 0.1
    assert len(at) >= 1 and not any(pressed[last - 9 : last - 4].any() for last in at)
    assert not pressed[at[(at > ARRIVES + approach) & (at < LEAVES)]].any()


def test_results_say_at_which_frames_and_why(tmp_path: Path) -> None:
    estimates = found(Tare(10))
    write_results(tmp_path / "results.h5", [named_result(estimates, "LSM")])
    (case,) = read_results(tmp_path / "results.h5").cases
    assert case.tared == estimates.tared
    said = [why for why in case.tared if why]
    assert said and all(why.startswith("nothing touched the panel for 10 frames (9 s)") for why in said)
    write_results(tmp_path / "plain.h5", [named_result(found(None), "LSM")])
    (plain,) = read_results(tmp_path / "plain.h5").cases
    assert plain.tared is None


def test_watch_waits_for_frames_in_a_row_and_forgets_at_a_gap() -> None:
    rng, shape = np.random.default_rng(2), (4, 5)
    zero = 0.004 * rng.standard_normal(shape)
    watch, said = TareWatch(Tare(6)), []
    for number in range(14):
        left = zero + 0.001 * rng.standard_normal(shape) if number != 4 else np.full(shape, np.nan)
        watch, mean, why = watch.after(left, np.zeros(shape), float(number))
        said.append(bool(why))
        if mean is not None:
            np.testing.assert_allclose(mean, zero, atol=0.003)
    assert np.flatnonzero(said).tolist() == [10]


def test_cells_that_have_not_moved_need_no_zero() -> None:
    rng, watch = np.random.default_rng(3), TareWatch(Tare(6))
    for number in range(40):
        watch, mean, _ = watch.after(0.01 * rng.standard_normal((4, 4)), np.zeros((4, 4)), float(number))
        assert mean is None


@pytest.mark.parametrize("numbers", [{"frames": 4}, {"frames": 10, "drift_per_minute": -1.0}])
def test_tares_that_cannot_be_are_refused(numbers: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=list(numbers)[-1]):
        Tare(**numbers)
    with pytest.raises(InputError, match="tare must be"):
        Estimator((Misfit(),), tare=10)


@pytest.mark.parametrize("terms", [(Misfit(),), (Misfit(), RelativeChange(weight=10))], ids=["absolute", "relative"])
def test_a_tared_stream_is_one_begun_anew(terms: tuple[Term, ...]) -> None:
    recording = made(LAMPREY)
    readings, estimator = recording.readings(), Estimator(terms, "reduced")
    stream = Stream.begin(estimator, recording.scene, 1.0, readings[:3].mean())
    stream, _ = stream.push(readings[60])
    steps = []
    resting = readings[10:13].mean()
    for begun in (stream.tared(resting), Stream.begin(estimator, recording.scene, 1.0, resting)):
        _, step = begun.push(readings[20])
        steps.append(step)
    np.testing.assert_array_equal(steps[0].cell_resistance, steps[1].cell_resistance)
    np.testing.assert_array_equal(steps[0].bars.frame.deviation, steps[1].bars.frame.deviation)
    with pytest.raises(InputError, match="one frame of 6 × 6"):
        stream.tared(readings[10:13])
