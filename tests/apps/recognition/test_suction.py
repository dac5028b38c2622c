"""Suction by the cells that have risen, over the recognitions of a visit."""

from types import SimpleNamespace

import numpy as np
import pytest
from laws.recognised import PANEL

from lampest import OralDisc, Recording, Rod, Scene, Shape, TwoPointReadout
from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.suction import suctions
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import WatchSetup
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Simulation, simulate

SCENE = Scene(PANEL, TwoPointReadout(noise_lsb=0.7), 140.0)
BENT = Unmodelled(response_loss=0.2, response_spread=0.15)
TWO_HOURS_S = 7200.0


def drawn(seed: int) -> tuple[OralDisc, Rod]:
    """A mouth at 1.2 to 5 kPa with a narrow rim, and a rod that stands beside it."""
    rng = np.random.default_rng(seed)
    diameter = rng.uniform(30, 44)
    place = rng.uniform(20, 70, 2)
    mouth = OralDisc(
        centre_mm=tuple(place),
        diameter_mm=diameter,
        pressure_kpa=-np.exp(rng.uniform(np.log(1.2), np.log(5))),
        rim_width_mm=rng.uniform(3.5, 5.5),
        unevenness=0.25,
        elongation=1.15,
    )
    turn = rng.uniform(0, 2 * np.pi)
    wide = rng.uniform(20, 40)
    away = (diameter + wide) / 2 + 3
    beside = np.clip(place + away * np.array([np.cos(turn), np.sin(turn)]), 5, 85)
    mass = float(np.exp(rng.uniform(np.log(100), np.log(3000))))
    return mouth, Rod(centre_mm=tuple(beside), diameter_mm=wide, mass_g=mass)


def recorded(*loads: Shape, seed: int) -> Recording:
    return simulate(Simulation(1, seed, SCENE, frames=12, loads=loads, unmodelled=BENT))


def visited(*states: tuple[tuple[Shape, ...], float], seed: int) -> list[Watch]:
    """Watches at the end of states of a panel: the loads on it, and the time of its first frame."""
    first = recorded(seed=seed).readings()
    setup = WatchSetup(SCENE, Detector(6.0), np.zeros(PANEL.shape), ModelErrors())
    resting = first[[0, 1, 2]].mean()
    watch = Watch.begin(setup, resting.value, first.sigma[0], first.value[:3], 0.0)
    watches = []
    for loads, begin in states:
        readings = recorded(*loads, seed=seed).readings()
        for number in range(3, len(readings.value)):
            watch = watch.push(readings.value[number], readings.sigma[number], begin + number)
        watches.append(watch)
    return watches


def nearest(watch: Watch, load: OralDisc) -> Attachment:
    return min(watch.attachments, key=lambda attachment: attachment.distance(load.centre_mm))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [110, 112, 122, 127, 128, 129])
def test_a_visit_of_two_hours_stays_a_visit_where_a_second_load_arrives_beside_it(
    seed: int,
) -> None:
    """Cells have drifted by then: only some around the suction have clearly fallen."""
    mouth, rod = drawn(seed)
    states = [((mouth,), 0.0), ((mouth,), TWO_HOURS_S), ((mouth, rod), TWO_HOURS_S + 20)]
    for watch in visited(*states, seed=seed):
        visit = nearest(watch, mouth)
        assert visit.present and visit.since_s < 10 and visit.sucks > 0.9
    assert sum(attachment.sucks > 0.5 for attachment in watch.attachments) == 1


@pytest.mark.parametrize("read", [True, False])
def test_cells_on_both_sides_of_a_dead_line_are_under_one_suction(read: bool) -> None:
    """Cells of the line between them are known to be unmoved, or nothing is known of them."""
    change = np.zeros(PANEL.shape)
    sd = np.full(PANEL.shape, 0.01)
    change[2:7, 2:7] = -0.5
    change[3:6, 3:6] = 0.8
    change[4] = 0.0 if read else -0.1
    sd[4] = 0.01 if read else 0.99
    scene = SimpleNamespace(broken=np.zeros(PANEL.shape, dtype=bool))
    baseline = SimpleNamespace(logarithm=np.zeros(PANEL.shape), scene=scene)
    frame = SimpleNamespace(panel=PANEL, free_map=change, free_sd=sd, baseline=baseline)
    places = suctions(frame)
    if read:
        assert all(place.cells.sum() == 3 for place in places)
    else:
        (place,) = places
        assert place.cells.sum() == 9 and place.probability > 0.8
        assert place.centre == pytest.approx((40.0, 40.0))
