"""Loads that come and go at awkward times.

A load is there in unloaded frames, before them, at the same time as another load, or in the last
frame alone.
"""

import dataclasses
import pickle

import numpy as np
import pytest
from laws.recognised import answered, every_frame, known_before
from promises import promise

from lampest import (
    LoadedColumnsReadout,
    OralDisc,
    Panel,
    Readout,
    Recording,
    Ring,
    Rod,
    Scene,
    Shape,
    Simulation,
    Unmodelled,
    simulate,
)
from lampest.apps.live.run import scan_of
from lampest.apps.live.watcher import Unloaded, Watched
from lampest.apps.recognition.detect.answer import CANNOT_SAY, NOTHING, PRESSES, SUCKS
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.observation import leaking_network
from lampest.panel.effects.line_effect import effect_on_readings
from lampest.panel.effects.line_leak import LineLeak, neighbours
from lampest.panel.readouts import TwoPointReadout
from lampest.recording.simulation.measure import measured

TWO_POINT = TwoPointReadout(noise_lsb=0.7)
ROD = Rod(centre_mm=(26, 24), diameter_mm=30, mass_g=500)
MOUTH = OralDisc(centre_mm=(26, 24), diameter_mm=33, rim_width_mm=5.5, pressure_kpa=-10)
UNLOADED = 5
MEMORY_SHARE = 0.12  # of a load's change, which the film keeps after the load has left
Course = tuple[Shape, int, int]  # a load, the first frame with it and the first without it


def recording_with(
    *courses: Course,
    frames: int = 20,
    readout: Readout = TWO_POINT,
    side: int = 6,
    memory_share: float = MEMORY_SHARE,
    leak: tuple[LineLeak, int] | None = None,
) -> Recording:
    """A frame a second, the first five unloaded; of a load that leaves a film keeps a part.

    A leak begins with a frame.
    """
    scene = Scene(Panel(side, side), readout, 140.0 if readout is TWO_POINT else 0.0)
    resting = simulate(Simulation(1, 5, scene, frames=1)).truth_cell_resistance
    logarithm = np.zeros((frames, side, side))
    for load, begin, end in courses:
        loaded = simulate(Simulation(1, 5, scene, frames=1, loads=(load,))).truth_cell_resistance
        change = np.log(loaded[-1] / loaded[0])
        logarithm[max(begin, 0) : end] += change
        logarithm[end:] += memory_share * change
    cells = resting[0] * np.exp(logarithm)
    recorded, _ = measured(scene, cells, Unmodelled(), 5)
    if leak is not None:
        leaking, begin = leak
        for frame in range(begin, frames):
            network = leaking_network(scene, cells[frame])
            recorded[frame] += effect_on_readings((leaking,), scene, network)
    role = (np.arange(frames) >= UNLOADED).astype(np.uint8)
    return Recording(scene, recorded, np.arange(float(frames)), role, name="watched")


@pytest.mark.slow
@pytest.mark.parametrize("first", [2, 3])
def test_touched_unloaded_frames_are_rejected(first: int) -> None:
    answer = answered(recording_with((ROD, first, 12)))
    assert answer.answer == CANNOT_SAY and "while its unloaded frames were taken" in answer.why


def test_a_change_as_small_as_film_settling_is_not_a_touch() -> None:
    """The change is a fiftieth of that of a rod."""
    recording = recording_with((ROD, 8, 20))
    touched = recording_with((ROD, 2, 20))
    recorded = recording.recorded.copy()
    recorded[2:5] *= (touched.recorded[3] / recorded[0]) ** 0.02
    assert answered(dataclasses.replace(recording, recorded=recorded)).answer == PRESSES


@pytest.mark.parametrize(("frames", "steps"), [(1, False), (2, True)])
def test_a_change_of_a_single_frame_is_no_step(frames: int, steps: bool) -> None:
    """The readings of a rod in some frames, without the search for outliers."""
    recording = recording_with((ROD, 9, 9 + frames), memory_share=0.0)
    known = known_before(recording_with())
    watch = known.watch()
    begins = set[float]()
    for frame in range(UNLOADED, len(recording.time)):
        watch = watch.followed(recording.readings().value[frame], known.sigma, float(frame))
        begins.add(watch.level.since_s)
    assert (len(begins) > 1) == steps


def test_readings_of_an_open_line_are_left_out_with_a_note() -> None:
    """The note is on two-point readings; circuits in volt show an open line otherwise."""
    recording = recording_with()
    recorded = recording.recorded.copy()
    recorded[9:, 2] *= 10
    answer = answered(dataclasses.replace(recording, recorded=recorded))
    assert answer.answer == NOTHING
    assert "row 2 is open in frames from 9.0 s on; these are left out" in answer.notes
    usual = known_before(recording_with(readout=LoadedColumnsReadout(noise_lsb=0.7)))
    watch = usual.watch()
    for frame in range(4):
        value = np.exp(watch.rest.mean).reshape(6, 6)
        value[2] *= 0.1
        watch = watch.followed(value, usual.sigma, 5.0 + frame)
    assert not watch.faults


@pytest.mark.slow
def test_a_departed_load_is_not_claimed_where_the_circuit_does_not_explain_the_readings() -> None:
    recording = recording_with((ROD, 0, 10))
    known = known_before(recording)
    claimed, silent = (
        replaced.answer(every_frame(recording, replaced))
        for replaced in (known, dataclasses.replace(known, explained=lambda: False))
    )
    assert "in its unloaded frames, and left" in claimed.why
    assert "in its unloaded frames, and left" not in silent.why


@pytest.mark.slow
def test_a_load_present_from_the_first_frame_is_not_an_arrival_when_it_leaves() -> None:
    """The change of the cells then is like that of suction."""
    answer = answered(recording_with((ROD, 0, 10)))
    assert answer.answer == CANNOT_SAY and answer.why.endswith(
        "in its unloaded frames, and left at 10.0 s"
    )
    second = answered(recording_with((ROD, 0, 10), (MOUTH, 14, 20)))
    assert second.answer == SUCKS and len(second.attachments) == 1


@pytest.mark.parametrize(
    "load",
    [
        OralDisc(centre_mm=(44, 46), diameter_mm=35, rim_width_mm=6, pressure_kpa=-12),
        Rod(centre_mm=(44, 46), diameter_mm=40, mass_g=1500),
        Ring(centre_mm=(44, 46), inner_diameter_mm=27, outer_diameter_mm=35, mass_g=850),
    ],
)
def test_a_load_in_all_unloaded_frames_is_not_called_nothing(load: Shape) -> None:
    answer = answered(recording_with((load, -1, 9), frames=8, side=10))
    assert (
        answer.answer == CANNOT_SAY and "may lie on the panel in the unloaded frames" in answer.why
    )


def test_cells_of_an_uneven_film_are_not_taken_for_a_load_in_the_unloaded_frames() -> None:
    search = Detector(6.0).search(Panel(10, 10))
    high = np.zeros((10, 10))
    high[3:7, 3:7] = 2.0
    assert search.lies_on(-high) and not search.lies_on(high)  # a load lowers its cells
    for seed in range(60):  # uneven by 12 to 25 %, with a faulty cell
        rng = np.random.default_rng(seed)
        bare = rng.uniform(0.12, 0.25) * rng.standard_normal((10, 10))
        bare[3, 4] -= 3.0
        assert not search.lies_on(8 + bare)


def test_an_outlier_in_an_unloaded_frame_does_not_prevent_detection() -> None:
    recording = recording_with((ROD, 7, 14), frames=14)
    recorded = recording.recorded.copy()
    recorded[2, 1, 1] *= 3
    recording = dataclasses.replace(recording, recorded=recorded)
    assert np.max(known_before(recording).watch().test.least()) < 10
    assert answered(recording).answer == PRESSES


def unloaded(recording: Recording) -> Unloaded:
    """Return the unloaded frames in the form in which live passes them on."""
    return Unloaded(recording.scene, tuple(scan_of(recording, frame) for frame in range(UNLOADED)))


def test_a_load_in_the_last_frames_is_recognised() -> None:
    answer = answered(recording_with((MOUTH, 18, 20)))
    assert answer.answer == SUCKS and answer.attachments[0].since_s == 18.0
    live = Watched("watched").after(news := unloaded(recording := recording_with((MOUTH, 17, 20))))
    for frame in range(len(news.scans), 20):
        live = live.after(scan_of(recording, frame))
    assert live.detected.answer == CANNOT_SAY and "touched the panel at 17.0 s" in live.detected.why


@pytest.mark.slow
def test_live_and_detect_end_the_same_attachments_at_the_same_frames() -> None:
    """A pulled mouth that leaves, a rod, and a mouth that stays."""
    pulling = dataclasses.replace(MOUTH, pressure_kpa=-40)
    courses = (MOUTH, 8, 13), (pulling, 13, 16), (MOUTH, 16, 21), (ROD, 25, 30), (MOUTH, 34, 40)
    recording = recording_with(*courses, frames=40)
    live = Watched("watched").after(unloaded(recording))
    for frame in range(UNLOADED, 40):
        live = live.after(scan_of(recording, frame))
    ends, detected = (
        [(attachment.since_s, attachment.until_s) for attachment in answer.attachments]
        for answer in (live.detected, answered(recording))
    )
    assert ends == detected == [(8.0, 21.0), (25.0, 30.0), (34.0, None)]


@pytest.mark.slow
def test_a_poorly_visible_load_arrives_and_leaves() -> None:
    """Pull-ups of 35 kohm: readings change little.

    The step of a release is less than that of the touch.
    """
    readout = LoadedColumnsReadout(
        polarity="down", load_ohm=35000, drive_ohm=30, supply_volt=5, noise_lsb=0.7
    )
    weak = Rod(centre_mm=(26, 24), diameter_mm=22, mass_g=25)
    answer = answered(recording_with((weak, 8, 14), readout=readout))
    assert [attachment.until_s for attachment in answer.attachments] == [14.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "second_load",
    [OralDisc(centre_mm=(68, 66), diameter_mm=30, rim_width_mm=5, pressure_kpa=-7), ROD],
)
def test_the_leaving_one_of_two_loads_is_reported_without_its_memory(second_load: Shape) -> None:
    mouth = OralDisc(centre_mm=(25, 68), diameter_mm=34, rim_width_mm=5.5, pressure_kpa=-10)
    answer = answered(recording_with((mouth, 8, 30), (second_load, 16, 50), frames=50, side=10))
    assert [attachment.until_s for attachment in answer.attachments] == [30.0, None]
    moved = dataclasses.replace(mouth, centre_mm=(68, 24))  # it jumps there
    answer = answered(recording_with((mouth, 8, 20), (moved, 20, 40), frames=40, side=10))
    assert [attachment.until_s for attachment in answer.attachments] == [20.0, None]
    assert (
        all(attachment.sucks > 0.9 for attachment in answer.attachments)
        and answer.attachments[1].distance((68, 24)) < 3
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pressure_kpa", "factor", "diameter_mm", "memory_share"), [(-6, 8, 33, 0.0), (-5, 6, 40, 0.05)]
)
def test_a_pull_ends_no_visit_and_leaves_no_phantom(
    pressure_kpa: float, factor: float, diameter_mm: float, memory_share: float
) -> None:
    """A pull of six seconds; the mouth leaves, and comes back."""
    mouth = dataclasses.replace(MOUTH, pressure_kpa=pressure_kpa, diameter_mm=diameter_mm)
    pulling = dataclasses.replace(mouth, pressure_kpa=factor * pressure_kpa)
    courses = (mouth, 8, 16), (pulling, 16, 22), (mouth, 22, 34), (mouth, 44, 50)
    answer = answered(recording_with(*courses, frames=60, memory_share=memory_share))
    visits = [(attachment.since_s, attachment.until_s) for attachment in answer.attachments]
    assert visits == [(8.0, 34.0), (44.0, 50.0)]


@pytest.mark.slow
@promise("apps/recognition/detect: A warning names it, and the visit ends when the animal leaves.")
@pytest.mark.parametrize("lines", [(3,), (16,), neighbours(10, 10)])
def test_a_leak_that_begins_under_a_mouth_is_named_and_the_visit_ends(
    lines: tuple[int, ...],
) -> None:
    """Between two rows, two columns, or all neighbouring lines; the mouth comes back."""
    leak = LineLeak(lines, size=1 / (3e3 if len(lines) == 1 else 5e3))
    courses = (MOUTH, 8, 22), (MOUTH, 28, 34)
    answer = answered(recording_with(*courses, frames=38, side=10, leak=(leak, 14)))
    visits = [(load.since_s, load.until_s, load.sucks > 0.9) for load in answer.attachments]
    assert visits == [(8.0, 22.0, True), (28.0, 34.0, True)]
    (warning,) = answer.warnings
    kilohms, where = warning.split(" kohm ")
    assert kilohms.startswith("from 14.0 s on the readings show a leak of ")
    assert float(kilohms.split()[-1]) == pytest.approx(1e-3 / leak.size, rel=0.1)
    assert where.startswith(leak.sentence(10).split(" kohm ")[1])


def test_a_leak_of_a_bare_panel_is_no_load() -> None:
    leak = LineLeak((3,), size=1 / 3e3)
    answer = answered(recording_with(frames=16, leak=(leak, 9)))
    assert answer.answer == NOTHING and "between row 3 and the next one" in answer.warnings[0]


def test_a_leak_is_named_once_readings_have_stayed() -> None:
    """The blades of a plant along a row come and go sooner."""
    leak = LineLeak((3,), size=1 / 3e3)
    first, later = (answered(recording_with(frames=n, leak=(leak, 9))) for n in (12, 16))
    assert not first.warnings and "between row 3" in later.warnings[0]


@pytest.mark.slow
def test_each_long_visit_is_detected_once_in_constant_memory() -> None:
    """At a frame a second, while the temperature sways readings by 3 % in two hours."""
    visits = ((MOUTH, 600, 2400), (ROD, 3000, 4000), (MOUTH, 4600, 5400))
    recording = recording_with(*visits, frames=6000, memory_share=0.0)
    sway = 1 + 0.03 * np.sin(2 * np.pi * recording.time / 7200)[:, None, None]
    recording = dataclasses.replace(recording, recorded=recording.recorded * sway)
    first = {name: getattr(recording, name)[:105] for name in ("recorded", "time", "role")}
    known = known_before(dataclasses.replace(recording, **first))
    watch = known.watch()
    sizes = list[int]()
    for value, sigma, time in every_frame(recording, known):
        watch = watch.push(value, sigma, time)
        sizes += [len(pickle.dumps(watch.window))] if time % 500 == 0 else []
    reported = [
        (attachment.since_s, attachment.until_s, attachment.sucks > 0.5)
        for attachment in watch.attachments
    ]
    assert len(reported) == 3 and [sucks for *_, sucks in reported] == [True, False, True]
    for (since, until, _), (_, begin, end) in zip(reported, visits, strict=True):
        assert until is not None and abs(since - begin) <= 2 and abs(until - end) <= 2
    during_visits = [size for size in sizes if size > len(pickle.dumps(None))]
    assert len(during_visits) > 2 and max(during_visits) <= 1.5 * min(during_visits)


@pytest.mark.slow
def test_live_takes_a_new_zero_if_the_first_was_touched() -> None:
    recording = recording_with((ROD, 3, 8))
    live = Watched("watched").after(unloaded(recording))
    assert live.detected.answer == CANNOT_SAY and "unloaded frames" in live.detected.why
    live = live.after(UNLOADED)
    for frame in range(10, 20):
        live = live.after(scan_of(recording, frame))
    assert live.detected.answer == NOTHING


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "diameter_mm", "pressure_kpa", "rod"),
    [
        ((51, 45), 42, -1.9, Rod(centre_mm=(85, 48), diameter_mm=26, mass_g=1185)),
        ((35, 64), 39, -2.2, Rod(centre_mm=(51, 90), diameter_mm=37, mass_g=2080)),
        ((48, 58), 38, -2.0, Rod(centre_mm=(28, 85), diameter_mm=28, mass_g=829)),
    ],
)
def test_a_mouth_stays_where_a_heavier_load_beside_it_leaves(
    place: tuple[float, float], diameter_mm: float, pressure_kpa: float, rod: Rod
) -> None:
    """The rod stands on a part of its rim, and leaves more in the film than the mouth changes."""
    mouth = OralDisc(
        centre_mm=place,
        diameter_mm=diameter_mm,
        rim_width_mm=5,
        pressure_kpa=pressure_kpa,
        unevenness=0.25,
    )
    courses = (mouth, 8, 40), (rod, 16, 30)
    answer = answered(recording_with(*courses, frames=50, side=10))
    visits = [(load.since_s, load.until_s) for load in answer.attachments if load.sucks > 0.5]
    assert visits == [(8.0, 40.0)]
    assert all(load.until_s == 30.0 for load in answer.attachments if load.sucks <= 0.5)
