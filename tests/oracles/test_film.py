"""The film's memory against closed forms: loops, creep, recovery, bending; and what a simulation makes of it."""

import dataclasses

import numpy as np
import pytest

from lampest import Array, InputError, Panel, Recording, Rod, Scene, SuctionCup, Unmodelled, Water
from lampest.files.document import parse_document, to_yaml, validated
from lampest.loads.film import Creep, FilmMemory, Plays
from lampest.panel.response import PUBLISHED, Film, ratio_from_pressure
from lampest.recording.simulation.simulation import Cells, Course, Simulation, simulate

WALK = np.concatenate([np.linspace(*ends, 40) for ends in ((0, 30), (30, -8), (-8, -2), (-2, 12), (12, 3), (3, 25))])


def followed(plays: Plays, pressures: Array) -> Array:
    """p_e of pressures one after the other."""
    found = []
    for pressure in pressures:
        found.append(plays.effective(np.array(pressure)))
        plays = plays.after(np.array(pressure))
    return np.array(found)


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.24, 0.5])
@pytest.mark.parametrize("peak", [30.0, -8.0])
def test_cycle_loads_along_the_line_and_unloads_along_the_hyperbola(gap: float, peak: float) -> None:
    share = np.linspace(0, 1, 101)
    found = followed(Plays.at_rest(np.array(gap)), peak * np.concatenate([share, share[::-1]])) / peak
    steep = ((1 + gap) / (1 - gap)) ** 2
    np.testing.assert_allclose(found[:101], share, atol=1e-12)
    back = found[101:][::-1]
    np.testing.assert_allclose(back, steep * share / (1 + (steep - 1) * share), atol=0.025 * gap)
    assert np.max(back - share) == pytest.approx(gap, abs=0.002)


def test_hysteresis_does_not_know_time_and_is_undone_exactly() -> None:
    plays = Plays.at_rest(np.array([0.05, 0.24, 0.5]))
    for pressure in WALK:
        here = np.full(3, pressure)
        effective = plays.effective(here)
        np.testing.assert_allclose(plays.pressure(effective), here, atol=1e-9)
        again = plays.after(here)
        np.testing.assert_array_equal(again.after(here).held, again.held)
        plays = again


def test_small_loops_lie_within_large_ones_and_close() -> None:
    """Wiping out: a smaller loop ends where it began, and leaves no trace."""
    begin, small = [*np.linspace(0, 30, 31), *np.linspace(30, 15, 31)], [*np.linspace(15, 20, 31), 15.0]
    end = np.linspace(15, 0, 31)
    plays = Plays.at_rest(np.array(0.24))
    plain, looped = followed(plays, np.array([*begin, *end])), followed(plays, np.array([*begin, *small, *end]))
    np.testing.assert_allclose(looped[-31:], plain[-31:], atol=1e-12)


def test_creep_is_logarithmic_and_fades_by_superposition() -> None:
    times = np.array([1.0, 3.0, 10.0, 100.0, 3e3, 2e4])
    grown = [Creep.at_rest(np.array(0.05)).answer(np.array(2.0), second) for second in times]
    np.testing.assert_allclose(grown, 2 * (1 + 0.05 * (np.log10(times) + 0.74)), rtol=3e-3)
    loaded = Creep.at_rest(np.array(0.05)).after(np.array(2.0), 120.0)
    left = [loaded.answer(np.array(0.0), second) for second in (3.0, 10.0, 100.0, 1000.0)]
    expected = 0.1 * np.log10((120 + np.array([3, 10, 100, 1000])) / np.array([3, 10, 100, 1000]))
    np.testing.assert_allclose(left, expected, rtol=0.1, atol=2e-3)


def test_creep_does_not_care_how_time_is_cut() -> None:
    whole, pieces = (Creep.at_rest(np.array(0.1)) for _ in range(2))
    for _ in range(7):
        pieces = pieces.after(np.array(1.5), 4.0)
    np.testing.assert_allclose(pieces.crept, whole.after(np.array(1.5), 28.0).crept, rtol=1e-9)


def test_memory_is_undone_exactly_under_water_too() -> None:
    generator, water = np.random.default_rng(3), np.array([0.0, 0.7])
    there = here = FilmMemory.at_rest(np.full(2, 0.24), np.full(2, 0.08), np.full(2, 0.7), water)
    for pressure in generator.uniform(-6, 25, (200, 1)) * np.ones(2):
        there, change = there.answered(pressure, 1.3)
        np.testing.assert_allclose(here.pressure(change, 1.3), pressure, atol=1e-8)
        here = here.observed(change, 1.3)
    np.testing.assert_allclose(here.creep.crept, there.creep.crept, atol=1e-9)


def test_what_is_no_number_leaves_the_memory_alone() -> None:
    memory = FilmMemory.at_rest(np.full(2, 0.24), np.full(2, 0.08), np.ones(2), np.zeros(2))
    memory = memory.observed(np.array([-1.0, -1.0]), 1.0)
    after = memory.observed(np.array([-1.2, np.nan]), 1.0)
    assert after.creep.crept[0, 1] == memory.creep.crept[0, 1] and after.creep.crept[0, 0] > memory.creep.crept[0, 0]
    assert np.isnan(memory.pressure(np.array([np.nan, 0.0]), 1.0)).tolist() == [True, False]


ROD = Rod(kind="rod", centre_mm=(35, 35), diameter_mm=40, mass_g=2000)
COURSE = Course(approach_s=10, release_at_s=40, release_s=10)


def recorded(film: Film | None = None, told: Film | None = None, **changes: object) -> Recording:
    """A rod that is put on slowly, lies, and is taken off slowly: 70 frames of 8 × 8 cells."""
    plain = Simulation(1, 4, Scene(Panel(8, 8), film=told), Cells(), 2, 70, 1.0, (ROD,), COURSE, film=film)
    return simulate(dataclasses.replace(plain, **changes))


def seen(recording: Recording) -> Array:
    """Pressure as the response curve alone reads it, (frames) kPa, of a cell under the rod."""
    cell = recording.truth_cell_resistance[:, 3, 3]
    return PUBLISHED.pressure(np.log(cell / cell[0]))


def test_simulated_film_has_the_hysteresis_that_it_is_told() -> None:
    recording = recorded(Film(hysteresis=0.24))
    pressure, found = recording.truth_pressure[:, 3, 3], seen(recording)
    gap = found - pressure
    np.testing.assert_allclose(gap[:42], 0, atol=1e-9)
    assert 0.2 < gap[42:].max() / pressure.max() < 0.242  # frames come where they come
    assert gap[-15:] == pytest.approx(0, abs=1e-9)


def test_simulated_film_creeps_and_remembers() -> None:
    still = Course(release_at_s=40)
    recording = recorded(Film(creep_per_decade=0.05), course=still)
    change = np.log(recording.truth_cell_resistance / recording.truth_cell_resistance[0])[:, 3, 3]
    assert change[2 + 30] / change[2 + 3] == pytest.approx(1 + 0.05, rel=0.01)  # a decade later
    after = np.arange(3, 20)
    at_once = np.log(ratio_from_pressure(recorded(course=still).truth_pressure))[20, 3, 3]
    np.testing.assert_allclose(change[42 + after], 0.05 * at_once * np.log10((40 + after) / after), rtol=0.15)


def test_absent_film_and_one_that_does_nothing_are_the_same() -> None:
    np.testing.assert_allclose(recorded(Film()).recorded, recorded().recorded, rtol=1e-12)


def test_cells_differ_by_the_spread_and_films_by_the_deviation() -> None:
    def gaps(seed: int, film: Film) -> Array:
        made = recorded(film, seed=seed)
        effective = PUBLISHED.pressure(np.log(made.truth_cell_resistance / made.truth_cell_resistance[0]))
        return (effective - made.truth_pressure)[44:52].max(axis=0)[2:6, 2:6]

    alike, spread = gaps(1, Film(hysteresis=0.2)), gaps(1, Film(hysteresis=0.2, cell_spread=0.3))
    assert 0.2 < np.std(np.log(spread / alike)) < 0.4
    films = [gaps(seed, Film(hysteresis=0.2, deviation=0.3)) / alike for seed in range(6)]
    assert np.std(np.log(np.mean(films, axis=(1, 2)))) > 0.1 > np.std(np.log(films[0]))


def test_bent_cells_are_as_published() -> None:
    """Paper, figure 2: 3.05 k, 1.03 k, 560, 350 ohm; -94, -82, -69, -81 % at 40 kPa."""
    for curvature, ohm, change in ((0, 3050, -0.94), (20, 1030, -0.82), (30.3, 560, -0.69), (58.8, 350, -0.81)):
        film = Film(curvature_per_m=curvature)
        assert 3050 * film.lowering == pytest.approx(ohm)
        memory = FilmMemory.at_rest(np.zeros(1), np.zeros(1), np.full(1, film.answer), np.zeros(1))
        assert np.expm1(memory.answered(np.array([40.0]), 1.0)[1]) == pytest.approx([change], rel=1e-6)
    bent = recorded(Film(curvature_per_m=20), cells=Cells(spread=0.0))
    assert bent.truth_cell_resistance[0] == pytest.approx(1030 * np.ones((8, 8)))


def test_memory_under_water_begins_where_the_water_left_it() -> None:
    cup = SuctionCup(
        kind="suction_cup", centre_mm=(35, 35), inner_diameter_mm=27, outer_diameter_mm=35, pressure_kpa=-8
    )
    scene = Scene(Panel(8, 8), water=Water(300.0), film=Film(0.2, 0.1))
    made = simulate(Simulation(1, 4, scene, frames=3, loads=(cup,)))
    np.testing.assert_allclose(made.truth_cell_resistance[0], made.truth_cell_resistance[2], rtol=1e-12)


def test_travelling_loads_are_remembered_where_they_were() -> None:
    travels = Unmodelled(load_speed_mm_s=2.0)
    plain, film = (recorded(film, frames=8, unmodelled=travels, course=Course()) for film in (None, Film(0.24, 0.05)))
    assert np.all(film.truth_cell_resistance[3:] < plain.truth_cell_resistance[3:] * (1 + 1e-9))


@pytest.mark.parametrize(
    "text", ["hysteresis: 0.7", "creep_per_decade: -0.1", "deviation: 2", "curvature_per_m: 60", "hysteresis: often"]
)
def test_films_that_cannot_be_are_refused(text: str) -> None:

    with pytest.raises(InputError, match=text.split(":")[0]):
        validated(parse_document(text, "film"), Film)


def test_open_numbers_cannot_be_simulated() -> None:
    with pytest.raises(ValueError, match="auto"):
        recorded(told=Film(creep_per_decade="auto"))
    assert "film" in to_yaml(recorded(Film(0.1), told=Film("auto")).scene)
