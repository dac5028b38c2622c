"""Responses from known loads against the film that was put in: curve, gains, their bars, forces of fresh touches."""

from dataclasses import replace

import numpy as np
import pytest
from known_loads import Bench, forces, moved_over, touches

from lampest import Array, Estimator, InputError, Misfit, Panel, Scene
from lampest.estimate.calibration.known_loads import KnownLoad, KnownLoads
from lampest.estimate.calibration.loads import LoadCalibration, calibrate_loads
from lampest.estimate.calibration.response import Loaded, deviations_from_others, fit_loads, response_of
from lampest.estimate.sequence import reconstruct
from lampest.loads.film import Creep, FilmKnown
from lampest.loads.pressure import pressure_of
from lampest.panel.response import PUBLISHED, Film, PowerResponse
from lampest.recording.simulation.measure import random_stream

OTHER = PowerResponse(exponent=0.8, scale_kpa=2.0)


def calibrated(bench: Bench, kpa: list[float], step: float) -> LoadCalibration:
    groups, known = moved_over(bench, kpa, 30.0, step)
    return calibrate_loads([bench.recorded(groups, "loads")], KnownLoads(schema=1, loads=tuple(known)), 0.01)


def true_gains(bench: Bench) -> Array:
    return np.asarray(np.exp(bench.spread * random_stream(bench.seed, "response").standard_normal(bench.panel.shape)))


def force_errors(bench: Bench, scene: Scene, count: int) -> Array:
    """|F/F_true − 1| of two or three touches in each of so many frames that no calibration has seen."""
    rng = np.random.default_rng(bench.seed + 1000)
    fresh = [touches(rng, bench.panel, int(rng.integers(2, 4))) for _ in range(count)]
    scene = replace(scene, response=scene.response or PUBLISHED)
    recording = bench.recorded(fresh, "fresh", scene)
    pressure, truth = reconstruct(recording, Estimator((Misfit(),), "reduced")).pressure, recording.truth_pressure
    errors = []
    for number, loads in enumerate(fresh):
        first, _ = bench.frames_of(number)
        there = forces(truth[first], loads, bench.panel)
        errors.append(forces(pressure[first - 4], loads, bench.panel) / there - 1)
    return np.abs(np.concatenate(errors))


def test_one_load_moved_over_the_panel_makes_forces_right() -> None:
    """The film has the published form; 64 places of one rod tell what each cell makes of it, and 5 kPa is all."""
    bench = Bench(1, spread=0.25, repeat=0.02)
    found = calibrated(bench, [5.0], 10.0)
    naive, ours = (force_errors(bench, scene, 8) for scene in (replace(bench.scene, response=PUBLISHED), found.scene))
    assert np.mean(ours) < 0.10
    assert np.mean(ours) < (1 - 0.269) * np.mean(naive)


@pytest.mark.slow
def test_several_pressures_tell_another_film() -> None:
    bench = Bench(2, response=OTHER, repeat=0.02)
    found = calibrated(bench, [1.0, 3.0, 9.0, 20.0], 17.5)
    response = found.scene.response
    gains = true_gains(bench)
    shift = np.exp(np.log(gains).mean())  # what all gains share belongs to the curve
    for kpa in (1.0, 3.0, 9.0, 20.0):
        assert response.logarithm(kpa) == pytest.approx(shift * OTHER.logarithm(kpa), rel=0.08)
    off = np.log(response.gains * shift / gains) / np.array(response.gain_sd)
    assert np.mean(np.abs(off) < 1.96) > 0.85
    assert found.fitted.spread == pytest.approx(0.2, abs=0.06)
    naive, ours = (force_errors(bench, scene, 8) for scene in (replace(bench.scene, response=PUBLISHED), found.scene))
    assert np.mean(ours) < 0.10 < 0.4 < np.mean(naive)


def test_bars_of_gains_and_curve_hold_the_truth() -> None:
    """The fit alone, with data that are as it supposes: 40 films of 60 cells under 4 pressures each."""
    rng, gains, curves = np.random.default_rng(3), [], []
    pressure = np.repeat([[1.0], [4.0], [12.0], [30.0]], 60, axis=1)
    for _ in range(40):
        own = np.exp(0.2 * rng.standard_normal(60))
        scatter = np.exp(0.05 * rng.standard_normal(pressure.shape))
        change = own * scatter * OTHER.logarithm(pressure)
        change += 0.01 * rng.standard_normal(pressure.shape)
        found = fit_loads(Loaded(change, np.full(pressure.shape, 0.01), pressure, 0 * pressure, np.zeros(60)))
        gain, sd = found.gain()
        shift = np.log(own).mean()
        gains.append(np.abs(np.log(gain / own) + shift) < 1.96 * sd)
        curve, curve_sd = found.curve(pressure[:, 0])
        truth = np.exp(shift) * OTHER.logarithm(pressure[:, 0])
        curves.append(np.abs(np.log(curve / truth)) < 1.96 * curve_sd)
    assert np.mean(gains) > 0.9
    assert np.mean(curves) > 0.9


def test_one_pressure_leaves_larger_pressures_of_another_film_open() -> None:
    """Feet of 5 kPa with their edges calibrate; pressures of 1 to 16 kPa are covered, 10 films."""
    rng, inside, kpa = np.random.default_rng(4), [], np.array([1.5, 3.0, 8.0, 12.0, 16.0])
    pressure = np.tile([5.0, 5.0, 4.0, 3.0, 2.0, 1.0, 5.0, 5.0], (16, 2))
    for number in range(10):
        film = PowerResponse(exponent=0.5 + 0.06 * number, scale_kpa=float(np.exp(rng.uniform(-1, 1))))
        change = np.exp(0.03 * rng.standard_normal(pressure.shape)) * film.logarithm(pressure)
        fitted = fit_loads(Loaded(change, np.full(pressure.shape, 0.01), pressure, 0 * pressure, np.zeros(16)))
        response = replace(response_of(fitted, PUBLISHED, (4, 4), 0.0), gain=None, gain_sd=((fitted.scatter,) * 5,))
        ratio = np.exp(film.logarithm(kpa))[None, None]
        found = pressure_of(ratio, 0.999 * ratio, 1.001 * ratio, Scene(Panel(1, 5), response=response))
        inside.append((found.lower <= kpa) & (kpa <= found.upper))
    assert np.mean(inside) >= 0.9


def test_creep_is_taken_off_before_loads_calibrate() -> None:
    """ln(r/r0) at once, of two loads that lie for 3 and 100 s on cells that creep by 8 and 10 % a decade."""
    strength, frames = np.array([[0.08, 0.1]]), []
    load, film = np.r_[np.zeros(2), np.ones(3), np.zeros(5), np.ones(100)][:, None, None], Creep.at_rest(strength)
    for now in load:
        frames.append(film.answer(now, 1.0))
        film = film.after(now, 1.0)
    known = FilmKnown.specified(Film(creep_per_decade=0.08, deviation=0.25))
    frames[4][0, 1] = np.nan
    found, sd = known.at_once(np.array(frames), np.arange(110.0))
    np.testing.assert_allclose(found[:, :, 0], load[:, :, 0], atol=1e-12)
    assert np.isnan(found[4, 0, 1]) and np.all(np.abs(found - load)[20:, 0, 1] < 1.3 * sd[20:, 0, 1])


def test_cells_under_the_edge_of_a_foot_do_not_make_a_load_odd() -> None:
    """One load of 24 stands aside: cells at its edge feel half as much, which its place leaves open."""
    pressure = np.tile([5.0, 5.0, 2.0, 2.0], (24, 1))
    place = np.where(pressure == 2.0, 1.0, 0.0)
    felt = pressure.copy()
    felt[7, 2:] = 1.0
    change = np.exp(0.02 * np.random.default_rng(5).standard_normal(felt.shape)) * PUBLISHED.logarithm(felt)
    away = deviations_from_others(Loaded(change, np.full(felt.shape, 0.01), pressure, place, np.zeros(4)))
    assert np.abs(away - np.median(away)).max() < 0.1


def test_cells_without_load_have_the_common_curve_and_the_spread() -> None:
    bench = Bench(4, panel=Panel(6, 6), repeat=0.02)
    groups, known = moved_over(bench, [5.0], 30.0, 10.0)
    left = [number for number, load in enumerate(known) if load.x_mm is not None and load.x_mm < 15]
    some = [replace(known[number], frames=bench.frames_of(at)) for at, number in enumerate(left)]
    recording = bench.recorded([groups[number] for number in left], "left")
    found = calibrate_loads([recording], KnownLoads(schema=1, loads=tuple(some)), 0.01)
    response = found.scene.response
    untouched = ~found.fitted.touched.reshape(6, 6)
    assert untouched[:, -1].all() and not untouched[:, 0].any()
    np.testing.assert_allclose(response.gains[untouched], response.gains[untouched][0], rtol=1e-3)
    sd = np.array(response.gain_sd)
    assert sd[untouched].min() > 2 * np.median(sd[:, 0]) and sd[untouched].min() >= 0.99 * found.fitted.spread


def test_pressures_over_the_whole_panel_suction_too() -> None:
    """As in a bag that is pumped out or blown up; the cells' gains follow from four loads."""
    bench = Bench(5, panel=Panel(4, 4), repeat=0.0)
    kpa = [-6.0, 2.0, 6.0, 12.0]
    loads = tuple(KnownLoad(frames=(n, n), pressure_kpa=one) for n, one in enumerate(kpa))
    gains = true_gains(bench).ravel()
    change = gains * PUBLISHED.logarithm(np.array(kpa)[:, None])
    pressure = np.stack([load.pressure(bench.panel, 6.0).ravel() for load in loads])
    found = fit_loads(Loaded(change, np.full(change.shape, 0.003), pressure, 0 * pressure, np.zeros(16)))
    shift = np.exp(np.log(gains).mean())
    np.testing.assert_allclose(found.gain()[0], gains / shift, rtol=0.01)
    np.testing.assert_allclose(found.curve(np.array(kpa))[0], shift * PUBLISHED.logarithm(kpa), rtol=0.01)


@pytest.mark.slow
def test_wrong_lists_of_loads_are_refused_or_named() -> None:
    """Units, a radius, frames that are late, lines that lie on each other, and one weight that is doubled."""
    bench = Bench(5, Panel(5, 5), repeat=0.03, frames=3)
    groups, known = moved_over(bench, [5.0], 25.0, 10.0)
    recording = bench.recorded(groups, "units")
    last = len(recording.role) - 1

    def said(loads: list[KnownLoad]) -> str:
        return "; ".join(calibrate_loads([recording], KnownLoads(schema=1, loads=tuple(loads)), 0.0).warnings)

    assert said(known) == ""
    assert "is mass_g in gram" in said([replace(one, mass_g=None, force_newton=one.mass_g) for one in known])
    assert "diameter_mm right?" in said([replace(one, diameter_mm=12.5) for one in known])
    late = [replace(one, frames=(one.frames[0] + 1, min(one.frames[1] + 1, last))) for one in known]
    assert "readings change within the frames of load" in said(late)
    doubled = replace(known[7], mass_g=2 * (known[7].mass_g or 0.0))
    assert said([*known[:7], doubled, *known[8:]]).startswith("load 8 answers otherwise than the others")
    with pytest.raises(InputError, match="a curve that no film has"):
        said([replace(one, mass_g=(one.mass_g or 0.0) / 1000) for one in known])
    with pytest.raises(InputError, match="loads 4 and 26 lie on the same cells in the same frames"):
        said([*known, known[3]])


def test_loads_at_other_places_are_no_calibration() -> None:
    bench = Bench(6, panel=Panel(6, 6))
    groups, known = moved_over(bench, [5.0], 20.0, 25.0)
    swapped = tuple(replace(load, x_mm=50 - load.x_mm) for load in known if load.x_mm is not None)
    with pytest.raises(InputError, match="the loads do not explain the cells"):
        calibrate_loads([bench.recorded(groups, "loads")], KnownLoads(schema=1, loads=swapped), 0.01)
