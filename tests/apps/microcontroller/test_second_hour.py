"""The second hour of a board: garbled frames, metal objects, a film that drifts."""

import ctypes
import re
from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from apps.board.estimated import CIRCUITS, pressed_cells, scene_of, solved_case, sums_of

import lampest
from lampest.apps.microcontroller.constants import (
    MISSING,
    Budget,
    CircuitLines,
    Constants,
    check_scene,
)
from lampest.apps.microcontroller.drift import frames_to_follow
from lampest.apps.microcontroller.header import header
from lampest.apps.microcontroller.host import HOST, compiled
from lampest.apps.microcontroller.library import library_version

NOISY = lampest.Misfit(weighting="noise")
SMOOTH = lampest.LogGradient(weight=1.0)
BUDGET = Budget(2, 8, 0.05)
FINE, UNDER_LOAD, OTHER_VERSION = 0, 3, 5
OBJECTS, GARBLED = 60, 100
FRAMES_LATER = 5
MAX_DEVIATION = 0.5  # standard deviations of a cell
FRAMES_OF_DRIFT = 2000
LN_DRIFT = -0.22  # of ln r, over these frames: 20 % of the resistance
MAX_LEFT = 0.03  # of ln r: what the baseline lags behind such a drift
PRESS = 0.5  # of ln r
MAX_MISSING = 5
MAX_MOVED = 0.1  # of ln r, median of the gaps; measured at most 0.05, and 0.2 to 0.5 when it failed
ROUNDED = 1e-5  # of a reading


@cache
def solved(circuit, rows=6, columns=5, **keys):
    """Return (sums of the measured frames, case, compiled library); compiling takes a second."""
    sums, case = solved_case(scene_of(circuit, rows, columns, **keys), [NOISY, SMOOTH])
    with compiled(Constants.of(case)) as host:
        return sums, case, host


def panel(circuit, rows=6, columns=5):
    """Return (scene, constants, compiled library)."""
    _, case, host = solved(circuit, rows, columns)
    return case.scene, Constants.of(case), host


def with_object(rng, cells):
    """Return cells of which one to four are bridged by metal of 1 to 100 ohm."""
    bridged = cells.copy()
    count = rng.integers(1, 5)
    places = rng.choice(cells.size, count, replace=False)
    if rng.random() < 0.5:  # neighbours
        row, column = (rng.integers(size - 1) for size in cells.shape)
        places = np.ravel_multi_index(
            ([row, row, row + 1, row + 1], [column, column + 1, column, column + 1]), cells.shape
        )[:count]
    bridged.ravel()[places] = np.exp(rng.uniform(0, np.log(100), count))
    return bridged


def garbled(rng, sums, top):
    """Return a frame as a loose cable, a lost bit or a shifted message leave it."""
    anything = rng.integers(0, top + 1, sums.shape)
    ends = np.where(rng.random(sums.shape) < 0.5, 0, top)
    damaged = rng.random(sums.shape) < 0.3
    return rng.permutation(
        np.array(
            [
                anything,
                np.where(damaged, ends, sums),
                np.where(damaged, anything, sums),
                np.roll(sums.ravel(), rng.integers(1, sums.size)).reshape(sums.shape),
                sums // 4,
                np.clip(rng.integers(top + 1) + rng.integers(-200, 200, sums.shape), 0, top),
            ]
        )
    )[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("circuit", "shape"),
    [
        ("grounded_one", (6, 5)),
        *(
            pytest.param(circuit, shape, marks=pytest.mark.slow)
            for circuit in CIRCUITS
            for shape in ((6, 5), (10, 10), (7, 12))
            if (circuit, shape) != ("grounded_one", (6, 5))
        ),
    ],
)
def test_objects_and_garbled_frames_are_forgotten_five_frames_later(circuit, shape):
    scene, constants, host = panel(circuit, *shape)
    sigma = solved(circuit, *shape)[1].sigma_own
    with np.errstate(invalid="ignore"):
        own = np.nanmedian(np.where(sigma > 0, sigma, np.nan), axis=0)
    rng = np.random.default_rng(84)
    cells = pressed_cells(scene, seed=3)
    for trial in range(OBJECTS + GARBLED):
        later = cells[rng.integers(len(cells))]
        if trial < OBJECTS:
            bridged = with_object(rng, rng.permutation(np.array([cells[0], later]))[0])
            disturbed = sums_of(scene, np.array([bridged] * rng.integers(1, 4)), trial)
        else:
            first = sums_of(scene, later[None], trial)[0]
            disturbed = garbled(rng, first, constants.top_sum)[None]
        good = sums_of(scene, np.array([later] * FRAMES_LATER), trial)
        start = sums_of(scene, cells[:1], trial + 1)
        estimates = host.frames(np.concatenate([start, disturbed, good]), BUDGET)
        optimum = host.frames(good[[-1] * 2], Budget(30, 100, 1e-3)).log_change[-1]
        deviation = np.sqrt(np.mean(((estimates.log_change[-1] - optimum) / own) ** 2))
        assert deviation < MAX_DEVIATION, trial
        assert (estimates.products <= BUDGET.steps * (BUDGET.products + 4)).all()


def drifting(resting, frames, change=LN_DRIFT):
    """Return cells (frames, rows, columns) that drift evenly, each by its own share of `change`."""
    shares = np.random.default_rng(5).uniform(0.5, 1.0, resting.shape)
    return resting * np.exp(np.linspace(0, 1, frames)[:, None, None] * change * shares)


@pytest.mark.slow
def test_the_baseline_follows_a_drift_under_presses_that_come_and_go():
    scene, _, host = panel("grounded_one")
    cells = drifting(pressed_cells(scene)[0], FRAMES_OF_DRIFT)
    pressed = np.arange(FRAMES_OF_DRIFT) % 100 >= 60
    cells[pressed, 2:4, 2:4] *= np.exp(-PRESS)
    sums = sums_of(scene, cells)
    host.begin(BUDGET)
    moved = []
    for frame in sums:
        change, _ = host.frame(frame)
        moved.append(host.follow())
        final = change
    assert not np.any(np.array(moved)[pressed])
    assert np.mean(np.array(moved)[~pressed]) > 0.9
    expected = np.zeros(scene.panel.shape)
    expected[2:4, 2:4] = -PRESS  # the last frame is under a press
    assert np.abs(final - expected).max() < 2 * MAX_LEFT


@pytest.mark.slow
def test_unloaded_frames_of_a_drift_are_taken_up_by_the_baseline():
    scene, _, host = panel("grounded_one")
    sums = sums_of(scene, drifting(pressed_cells(scene)[0], FRAMES_OF_DRIFT)[::10])
    host.begin(BUDGET)
    for frame in np.repeat(sums, 10, axis=0):
        assert host.baseline(frame)[0] == FINE
    change, _ = host.frame(sums[-1])
    assert np.abs(change).max() < MAX_LEFT


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_a_step_that_is_no_load_is_taken_up_and_a_long_press_is_not(factor):
    """The film warms up at once; then a press lasts for 10 minutes at 10 frames a second."""
    scene, constants, host = panel("grounded_one")
    resting = factor * pressed_cells(scene)[0]
    pressed = resting.copy()
    pressed[1:3, 1:3] *= np.exp(-PRESS)
    still, press = sums_of(scene, np.array([resting, pressed]))
    host.begin(BUDGET)
    for _ in range(int(4 * constants.follow)):
        host.frame(still)
        host.follow()
    assert np.abs(host.frame(still)[0]).max() < MAX_LEFT
    for _ in range(6000):
        host.frame(press)
        assert not host.follow()
    assert host.baseline(press)[0] == UNDER_LOAD
    np.testing.assert_allclose(host.frame(press)[0][1:3, 1:3], -PRESS, atol=MAX_LEFT)


def test_a_frame_that_has_not_settled_moves_no_baseline():
    scene, constants, host = panel("grounded_one")
    sums = sums_of(scene, pressed_cells(scene)[:1])
    host.begin(BUDGET)
    assert not host.follow()
    host.frame(garbled(np.random.default_rng(2), sums[0], constants.top_sum))
    assert not host.follow()
    host.frame(np.full(scene.panel.shape, MISSING))
    assert not host.follow()


@pytest.mark.slow
def test_the_export_chooses_a_shorter_time_constant_for_a_film_that_moves():
    scene = scene_of("grounded_one")
    frames = 60
    resting = pressed_cells(scene)[0]
    constants = []
    for change in (0.0, 0.1):
        cells = np.concatenate([[resting] * 3, drifting(resting, frames, change)])
        _, case = solved_case(scene, [NOISY, SMOOTH], sums=sums_of(scene, cells))
        constants.append(frames_to_follow(case, 0.2))
    still, moving = constants
    assert moving < still


@pytest.mark.slow
@pytest.mark.parametrize(
    ("adc_bits", "readings"),
    [
        (12, 20),
        pytest.param(16, 1, marks=pytest.mark.slow),
        pytest.param(24, 4, marks=pytest.mark.slow),
    ],
)
def test_any_converter_whose_sums_fit_32_bits_is_estimated(adc_bits, readings):
    sums, case, host = solved("two_point", adc_bits=adc_bits, readings=readings)
    constants = Constants.of(case)
    assert constants.top_sum == readings * (2**adc_bits - 1)
    np.testing.assert_array_equal(constants.sums_of(case), sums)
    estimates = host.frames(sums, Budget(8, 60, 0.01))
    optimum = np.log(case.cell_resistance / case.baseline_resistance)
    assert np.abs(estimates.log_change - optimum).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("circuit", "adc_bits", "readings"),
    [
        ("two_point", 24, 4),
        pytest.param("two_point", 16, 1, marks=pytest.mark.slow),
        pytest.param("two_point", 30, 1, marks=pytest.mark.slow),
        pytest.param("pull_ups", 24, 4, marks=pytest.mark.slow),
    ],
)
def test_missing_readings_leave_the_other_cells_where_they_were(circuit, adc_bits, readings):
    sums, case, host = solved(circuit, adc_bits=adc_bits, readings=readings)
    optimum = np.log(case.cell_resistance[-1] / case.baseline_resistance)
    rng = np.random.default_rng(11)
    moved = []
    host.begin(Budget(8, 60, 0.01))
    for _ in range(GARBLED):
        host.frame(sums[-2])
        gap = sums[-1].copy()
        missing = rng.choice(gap.size, rng.integers(1, MAX_MISSING + 1), replace=False)
        gap.ravel()[missing] = MISSING
        change, status = host.frame(gap)
        assert (status[0], status[5]) == (FINE, len(missing))
        moved.append(np.abs(change - optimum)[gap != MISSING].max())
    assert np.median(moved) < MAX_MOVED


@pytest.mark.slow
def test_noise_below_single_precision_counts_as_its_rounding():
    sums, case, host = solved("two_point", adc_bits=24, readings=4)
    assert np.median(case.sigma_own) < ROUNDED / 10
    host.frames(sums, Budget(8, 60, 0.01))
    assert ROUNDED < host.deviation(2, 2, 60) < 10 * ROUNDED


def test_sums_beyond_32_bits_are_refused():
    scene = scene_of("two_point", adc_bits=31, readings=3, noise_lsb=0.0)
    with pytest.raises(lampest.InputError, match="sums of 3 readings of 31 bits exceed 32 bits"):
        check_scene(scene)


@pytest.mark.parametrize("circuit", [name for name in CIRCUITS if "two_point" not in name])
def test_a_circuit_with_something_that_the_library_lacks_is_refused(circuit):
    """The check compares readings, not keys: potentials of idle lines, for example, change them."""
    readout = scene_of(circuit).circuit
    assert len(CircuitLines.of(readout, (6, 5)).tie) == 11

    class Shifted(type(readout)):
        def exact_reading(self, *arguments, **keys):
            return super().exact_reading(*arguments, **keys) + 0.01

    shifted = Shifted(**{field.name: getattr(readout, field.name) for field in fields(readout)})
    with pytest.raises(lampest.InputError, match="the C library has no such circuit"):
        CircuitLines.of(shifted, (6, 5))


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"idle_volt": 1.0}, "the C library has no idle_volt"),
        ({"load_volt": 2.5}, "the C library has no load_volt"),
        (
            {"driven_groups": ((0, 1, 2), (3, 4, 5)), "idle_ohm": np.inf},
            "the C library has no driven_groups",
        ),
        ({"offset_volt": 0.01}, "the C library has no offset_volt"),
        (
            {"converter": lampest.Characteristic(curve=((0.0, 0.0), (2.0, 1000.0), (5.0, 4096.0)))},
            "a straight, rising line only",
        ),
    ],
)
def test_potentials_driven_groups_and_curved_converters_are_refused(keys, sentence):
    with pytest.raises(lampest.InputError, match=sentence):
        check_scene(scene_of("pull_downs", **keys))


@pytest.mark.parametrize("held", [{}, {"idle_load_ohm": 30.0}, {"idle_load_ohm": np.inf}])
def test_resistors_that_stay_and_idle_lines_that_end_are_in_the_constants(held):
    stays = {"drive_ohm": 95.0, "idle_ohm": 1e4, "idle_stays": True, "load_ohm": 4700.0}
    readout = lampest.DrivenReadout(**stays | held)
    cells = np.geomspace(300.0, 3e4, 30).reshape(6, 5)
    lines = CircuitLines.of(readout, (6, 5))
    np.testing.assert_allclose(lines.readings(cells, "rows"), readout.exact_reading(cells), 1e-9)
    switched = CircuitLines.of(
        lampest.DrivenReadout(**stays | held | {"idle_stays": False}), (6, 5)
    )
    assert not np.allclose(switched.readings(cells, "rows"), lines.readings(cells, "rows"), 1e-3)


def test_unwired_channels_of_multiplexers_in_parallel_are_refused():
    readout = lampest.LoadedColumnsReadout(groups=((0, 1, None), (None, 2, 3)), drive_ohm=70.0)
    with pytest.raises(lampest.InputError, match="no multiplexers in parallel"):
        CircuitLines.of(readout, (6, 4))


@pytest.mark.slow
def test_constants_of_another_version_are_refused(tmp_path):
    _, constants, host = panel("grounded_one")
    text = header(constants, "panel", ())
    assert f".version = {library_version()}," in text
    assert host.begin(BUDGET) == FINE
    outdated = re.sub(r"\.version = \d+", ".version = 101", text)
    (tmp_path / "panel_constants.h").write_text(outdated)
    (tmp_path / "host.c").write_text(HOST)
    from apps.board.test_estimate import built

    library = ctypes.CDLL(str(built(tmp_path, "host.c")))
    assert library.host_begin(2, 8, 0) == OTHER_VERSION
