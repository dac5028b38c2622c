"""Pressure on films that remember: what was put in comes out, within its interval, with what is open estimated."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lampest import Array, Estimates, Estimator, Misfit, Panel, Recording, Rod, Scene, Systematic, TwoPointReadout
from lampest.estimate.sequence import reconstruct
from lampest.files.hdf5 import existing_file, read_attribute
from lampest.loads.film import Creep, FilmKnown
from lampest.loads.pressure import Pressure, pressure_of
from lampest.panel.response import OPEN_CREEP, Film, PublishedResponse, TableResponse
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.runs.filling import named_result
from lampest.runs.results import read_results, write_results

EXACT = Systematic(response_sd=0.0)
TRUE = Film(hysteresis=0.24, creep_per_decade=0.05)
COURSE = Course(approach_s=10, release_at_s=30, release_s=10)


def made(truth: Film, told: Film | None, seed: int = 3, course: Course = COURSE, mass_g: float = 2400) -> Recording:
    """A rod on 6 × 6 cells that is put on and taken off, 60 frames."""
    rod = Rod(kind="rod", centre_mm=(25, 25), diameter_mm=40, mass_g=mass_g)
    scene = Scene(
        Panel(6, 6), TwoPointReadout(adc_bits=12), 140.0, systematic=EXACT, film=told, response=PublishedResponse()
    )
    return simulate(Simulation(1, seed, scene, frames=60, loads=(rod,), course=course, film=truth))


def of_truth(recording: Recording, known: FilmKnown | None = None) -> tuple[Pressure, Array]:
    """Pressures that the true cells tell, and the true ones."""
    cells, pressure = recording.truth_cell_resistance, recording.truth_pressure
    ratio = (cells / cells[0])[3:]
    return pressure_of(ratio, ratio, ratio, recording.scene, recording.time[3:], known), pressure[3:]


def test_told_film_is_taken_off() -> None:
    """A quarter of full scale remains where the scene is silent, a fiftieth where it tells; frames see moments only."""
    for told, worst in ((TRUE, 0.02), (None, np.inf)):
        found, truth = of_truth(made(TRUE, told))
        error = np.abs(found.pressure - truth).max() / truth.max()
        assert error < worst and (told is not None or error > 0.24)
        after = np.abs(found.pressure - truth)[45:].max()
        assert after < 0.05 if told else after > 0.15


@pytest.mark.parametrize("told", [TRUE, replace(TRUE, deviation=0.2, cell_spread=0.2)])
def test_memory_is_causal(told: Film) -> None:
    """Frames that come later change nothing."""
    recording = made(TRUE, told)
    found, _ = of_truth(recording)
    cells = recording.truth_cell_resistance
    ratio = (cells / cells[0])[3:33]
    part = pressure_of(ratio, ratio, ratio, recording.scene, recording.time[3:33])
    np.testing.assert_array_equal(part.pressure, found.pressure[:30])


@pytest.mark.slow
def test_intervals_hold_films_that_differ() -> None:
    """Films and cells drawn as the scene says what is known of them: 95 % intervals, 12 films."""
    told = Film(0.2, 0.05, deviation=0.25, cell_spread=0.2)
    inside = []
    for seed in range(12):
        found, truth = of_truth(made(told, told, seed))
        pressed = truth.max(axis=0) > 1
        inside.append(((found.lower - 0.05 <= truth) & (truth <= found.upper + 0.05))[10:40, pressed].mean())
    assert 0.88 < np.mean(inside) < 0.995


def test_failed_frames_leave_a_gap_and_no_more() -> None:
    recording = made(TRUE, TRUE)
    cells = recording.truth_cell_resistance
    ratio = (cells / cells[0])[3:]
    ratio[20:23] = np.nan
    found = pressure_of(ratio, ratio, ratio, recording.scene, recording.time[3:])
    assert np.isnan(found.pressure[20:23]).all()
    assert np.abs(found.pressure - recording.truth_pressure[3:])[23:].max() < 0.5


def test_bent_film_is_read_as_it_answers() -> None:
    bent = Film(curvature_per_m=20)
    found, truth = of_truth(made(bent, bent))
    np.testing.assert_allclose(found.pressure, truth, atol=1e-6)
    assert found.errors.max() > 0.1 * truth.max()
    silent, _ = of_truth(made(bent, None))
    assert np.abs(silent.pressure - truth).max() > 0.2 * truth.max()


@cache
def estimated(creep: float, release: bool = True) -> Estimates:
    told = Film(hysteresis=0.24, creep_per_decade="auto", cell_spread=0.1)
    course = COURSE if release else replace(COURSE, release_at_s=None)
    recording = made(Film(0.24, creep, cell_spread=0.1), told, course=course)
    return reconstruct(recording, Estimator((Misfit(),), "reduced"))


@pytest.mark.slow
@pytest.mark.parametrize("creep", [0.0, 0.02, 0.08])
def test_open_creep_is_found_where_a_load_was_taken_off(creep: float) -> None:
    film = estimated(creep).film
    assert film.creep.sd < 0.02
    assert film.creep.mean == pytest.approx(creep, abs=max(3 * film.creep.sd, 0.005))
    assert film.hysteresis == (0.24, pytest.approx(0.024))


@pytest.mark.slow
def test_open_creep_stays_open_where_nothing_was_released() -> None:
    film = estimated(0.05, release=False).film
    assert film.creep.mean == pytest.approx(OPEN_CREEP[0], rel=0.5)
    assert film.creep.sd == pytest.approx(OPEN_CREEP[1], rel=0.5) and "assumed" in film.sentence


@pytest.mark.slow
def test_pressure_within_a_twelfth_of_full_scale_at_a_hysteresis_of_24_percent() -> None:
    found = estimated(0.08)
    truth = found.recording.truth_pressure[found.frame]
    assert np.percentile(np.abs(found.pressure - truth), 99) < 0.08 * truth.max()


@pytest.mark.slow
def test_results_say_what_the_film_was_taken_for(tmp_path: Path) -> None:
    path = tmp_path / "results.h5"
    write_results(path, [named_result(estimated(0.08), "LSM")])
    (case,) = read_results(path).cases
    assert case.film_sentence.startswith("creep ") and "from the recording" in case.film_sentence
    with existing_file(path) as file:
        assert read_attribute(file, f"/entry/{case.recording}/LSM", "film") == case.film_sentence


@pytest.mark.parametrize("film", [Film(), Film(creep_per_decade=1e-4)])
def test_a_film_without_memory_leaves_bars_as_wide_as_none(film: Film) -> None:
    """A calibrated curve is known where it was loaded: its bars do not depend on whether the scene names a film."""
    curve = TableResponse(
        pressure_kpa=(-10, 0, 5, 40), resistance_ohm=(5000, 1000, 400, 100), sd=(0.9, 0.4, 0.02, 0.02)
    )
    gains = tuple((0.9, 1.1, 1.0, 1.2) for _ in range(4))
    known = tuple((0.01,) * 4 for _ in range(4))
    scene = Scene(Panel(4, 4), response=replace(curve, gain=gains, gain_sd=known))
    ratio = np.full((1, 4, 4), 0.4)
    plain, with_film = (
        pressure_of(ratio, 0.99 * ratio, 1.01 * ratio, replace(scene, film=one)) for one in (None, film)
    )
    np.testing.assert_allclose(with_film.upper - with_film.lower, plain.upper - plain.lower, rtol=0.01)
    np.testing.assert_allclose(with_film.errors, plain.errors, rtol=0.01)


@pytest.mark.parametrize(("creep", "residue"), [(0.0, 0.04), (0.05, 0.0), (0.05, 0.04)])
def test_what_stays_and_does_not_fade_is_no_creep(creep: float, residue: float) -> None:
    """A minute under loads and a minute after them, in ln(r/r0)."""
    rng = np.random.default_rng(1)
    load, film, frames = rng.uniform(0.5, 2, (4, 4)), Creep.at_rest(np.full((4, 4), creep)), []
    for frame in range(120):
        now = load * (frame < 60)
        frames.append(film.answer(now, 1.0) + residue * load * (frame >= 60) + 0.01 * rng.standard_normal((4, 4)))
        film = film.after(now, 1.0)
    told = FilmKnown.specified(Film(creep_per_decade="auto"))
    known = told.estimated(-np.array(frames), np.full((120, 4, 4), 0.01), np.arange(120.0))
    assert known.creep.mean == pytest.approx(creep, abs=0.01) and "estimated from the recording" in known.sentence
    assert known.residue == pytest.approx(residue, abs=0.01)


def test_what_no_film_does_is_not_taken_for_creep() -> None:
    """Half of a load stays."""
    frames = np.full((60, 3, 3), -1.0)
    frames[30:] = -0.5
    frames += 0.01 * np.random.default_rng(1).standard_normal(frames.shape)
    told = FilmKnown.specified(Film(hysteresis="auto", creep_per_decade="auto"))
    known = told.estimated(frames, np.full(frames.shape, 0.01), np.arange(60.0))
    assert known.creep == (0.0, 0.0) and known.residue == pytest.approx(0.5)
    assert known.sentence.startswith("hysteresis 17 +- 10 %, assumed; creep not estimated")


def test_bars_after_a_release_know_what_the_film_may_keep() -> None:
    """Two per cent of the largest answer are left; at that answer itself bars are as wide as without a film."""
    ratio = np.full((2, 4, 4), 0.3)
    ratio[1] = 0.3**0.02
    plain, kept = (
        pressure_of(ratio, 0.999 * ratio, 1.001 * ratio, Scene(Panel(4, 4), systematic="none", film=film))
        for film in (None, Film(creep_per_decade=1e-4))
    )
    assert plain.lower[1].min() > 0 > kept.lower[1].max()
    np.testing.assert_allclose((kept.upper - kept.lower)[0], (plain.upper - plain.lower)[0], rtol=0.02)


def test_bars_of_a_load_that_stays_do_not_take_errors_of_its_cells_for_a_smaller_load() -> None:
    """Loops grow with the load: a cell that answers otherwise does so from the beginning, and is on no other branch."""
    time, ratio = np.arange(12.0), np.exp(np.minimum(np.arange(12.0), 6)[:, None, None] * np.full((3, 3), -0.2))
    noisy = ratio * np.exp(1e-4 * np.random.default_rng(2).standard_normal(ratio.shape))
    plain, held = (
        pressure_of(noisy, noisy, noisy, Scene(Panel(3, 3), systematic=Systematic(response_sd=0.05), film=film), time)
        for film in (None, Film(hysteresis=0.3))
    )
    np.testing.assert_allclose(held.own[8:], plain.own[8:], rtol=0.05)


@pytest.mark.parametrize("stays", [0.0, 0.02])
def test_nothing_presses_once_only_what_the_film_keeps_is_left(stays: float) -> None:
    """A load for ten frames, then what stays of it, with errors of a thousandth; a small load later presses."""
    ratio = np.full((30, 3, 3), 0.3)
    ratio[:3], ratio[10:25], ratio[25:] = 1.0, 0.3**stays, 0.3 ** (0.02 + 0.2)
    scene = Scene(Panel(3, 3), film=Film(creep_per_decade="auto"))
    found = pressure_of(ratio, 0.998 * ratio, 1.002 * ratio, scene, np.arange(30.0))
    assert found.pressing[3:10].all() and not found.pressing[12:25].any() and found.pressing[25:].all()


def test_drift_of_a_film_presses_nowhere_and_is_in_its_bars() -> None:
    """A cell that nobody touches conducts more by 1 % a minute; changes are known to a thousandth."""
    time = np.arange(0.0, 300.0, 20.0)
    ratio = np.exp(-0.01 * time / 60)[:, None, None] * np.ones((2, 2))
    found, without = (
        pressure_of(ratio, 0.998 * ratio, 1.002 * ratio, Scene(Panel(2, 2), film=film), time)
        for film in (Film(creep_per_decade="auto"), None)
    )
    assert not found.pressing.any() and without.pressing[5:].all()
    assert found.lower.max() < 0 < found.upper.min()
