"""Numbers of a scene as unknowns of a program, against circuits with other numbers."""

from dataclasses import replace
from math import inf
from typing import Any

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.inference.assumptions import ASSUMED
from lampest.inference.prepared import Prepared
from lampest.inference.shared_changes import SharedFrames, shared_changes
from lampest.panel.effects import systematic_of
from lampest.panel.readouts.tolerances import simulated

QUIET: dict[str, Any] = {"noise_lsb": 0.7, "readings": 20}
NOISE = lampest.Misfit(weighting="noise")
FREE = lampest.Bounds("none", "none")


def scene_with(scene: lampest.Scene, key: str, value: Any) -> lampest.Scene:
    part, _, name = key.rpartition(".")
    if not part:
        return replace(scene, **{name: value})
    inner = replace(getattr(scene, part), **{name: value})
    return replace(scene, **{part: inner})


def recorded(true: lampest.Scene, scene: lampest.Scene, cells: Any) -> lampest.Array:
    """Readings of a true circuit, without noise, as the converter of another scene takes them."""
    rows, columns = scene.panel.shape
    values = simulated(true.circuit, cells, true, np.zeros(rows), np.zeros(columns))
    return scene.circuit.recorded_from_volt(true.circuit.volt_from_recorded(values))


def solved_with_known_cells(
    scene: lampest.Scene,
    values: lampest.Array,
    cells: lampest.Array,
    priors: dict[str, float],
    formulation: str = "nodal",
) -> lampest.OwnSolution:
    recording = lampest.Recording.from_array(
        values, unit=scene.circuit.unit, baseline=0, scene=scene
    )
    program = lampest.program(
        recording,
        [NOISE],
        frames=range(len(values)),
        formulation=formulation,
        numbers=priors,
        bounds=FREE,
    )
    for frame, known in enumerate(cells):
        column = known.T.ravel() / 1000
        expression = casadi.vec(program.cells(frame)) / 1000 - column
        program = program.subject_to(f"known {frame}", expression)
    return program.solve()


TWO_POINT = lampest.TwoPointReadout(**QUIET)
VIRTUAL = lampest.VirtualGroundReadout(feedback_ohm=500.0, sense_ohm=70.0, **QUIET)
LOADED = lampest.LoadedColumnsReadout(drive_ohm=100.0, load_ohm=4000.0, **QUIET)
PULLED = lampest.DrivenReadout(
    drive_ohm=70.0, load_ohm=1000.0, idle_ohm=3300.0, idle_load_ohm=inf, **QUIET
)
STAYING = replace(PULLED, idle_stays=True)
LIFTED = replace(PULLED, idle_volt=2.0, idle_load_ohm=None)
GROUPS = replace(PULLED, groups=((0, 2), (1, 3)), driven="rows")
BY_LINE = tuple(np.linspace(60.0, 80.0, 3))
NUMBERS = {
    "series": (TWO_POINT, {"series_resistance_ohm": 165.0}),
    "reference": (TWO_POINT, {"readout.reference_ohm": 1030.0}),
    "two numbers": (
        TWO_POINT,
        {"readout.reference_ohm": 1030.0, "series_resistance_ohm": 130.0},
    ),
    "feedback": (VIRTUAL, {"readout.feedback_ohm": 530.0}),
    "channels of sensed lines": (VIRTUAL, {"readout.sense_ohm": 85.0}),
    "all of a virtual ground": (
        VIRTUAL,
        {"readout.sense_ohm": 80.0, "readout.feedback_ohm": 480.0, "readout.drive_ohm": 61.0},
    ),
    "load": (LOADED, {"readout.load_ohm": 4200.0}),
    "idle": (PULLED, {"readout.idle_ohm": 3000.0}),
    "idle that stays": (STAYING, {"readout.idle_ohm": 3000.0}),
    "drive beside a potential": (LIFTED, {"readout.drive_ohm": 90.0}),
    "loads of groups": (GROUPS, {"readout.load_ohm": 1050.0}),
    "each line": (replace(VIRTUAL, drive_ohm=(70.0, 70.0, 70.0)), {"readout.drive_ohm": BY_LINE}),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_known_cells_show_a_number_exactly(name: str) -> None:
    """Readings without noise: what is left is the pull of the prior, and rounding."""
    readout, numbers = NUMBERS[name]
    series = 140.0 if readout is TWO_POINT else 0.0
    scene = lampest.Scene(lampest.Panel(3, 4), readout, series)
    true = scene
    for key, value in numbers.items():
        true = scene_with(true, key, value)
    cells = 4000 * np.exp(0.4 * np.random.default_rng(3).standard_normal((1, 3, 4)))
    cells = np.repeat(cells, 2, axis=0)
    values = recorded(true, scene, cells)
    priors = dict.fromkeys(numbers, 1e6)
    solved = solved_with_known_cells(scene, values, cells, priors)
    assert solved.status == "local optimum verified"
    for key, value in numbers.items():
        assert_allclose(solved[key], value, rtol=2e-6)
    if name in ("load", "each line", "two numbers"):
        by_pixel = solved_with_known_cells(scene, values, cells, priors, "per_pixel")
        for key, value in numbers.items():
            assert_allclose(by_pixel[key], value, rtol=2e-6)


ROWS, COLUMNS, LOAD = 6, 6, np.zeros((6, 6), dtype=bool)
LOAD[1:3, 2:4] = True
UNLOADED, FRAMES = 3, 5
EXCESS = 3.0  # ohm: linear theory is off by its square
PRIOR = 35.0  # ohm, that of series_tolerance_ohm: estimated


def errors_of_series(
    readout: lampest.Readout, series: float, key: str
) -> tuple[lampest.Recording, float]:
    """A recording whose resistance in series is EXCESS more than the scene's, and that of it."""
    rng = np.random.default_rng(1)
    scene = lampest.Scene(lampest.Panel(ROWS, COLUMNS), readout, series)
    scene = replace(scene, systematic=lampest.Systematic(series_tolerance_ohm="estimated"))
    specified = scene.specified_in_series
    unloaded = 4000 * np.exp(0.2 * rng.standard_normal(LOAD.shape))
    loaded = np.where(LOAD, unloaded / 4, unloaded)
    cells = np.stack([unloaded] * UNLOADED + [loaded] * (FRAMES - UNLOADED))
    values = recorded(scene.with_series(specified + EXCESS), scene, cells)
    values = values + scene.circuit.sigma(values) * rng.standard_normal(values.shape)
    recording = lampest.Recording.from_array(
        values, unit=scene.circuit.unit, baseline=UNLOADED, scene=scene
    )
    return recording, specified


@pytest.mark.long
@pytest.mark.parametrize(
    ("readout", "series", "key"),
    [
        (replace(TWO_POINT, readings=1000), 140.0, "series_resistance_ohm"),
        (replace(LOADED, readings=1000), 0.0, "readout.drive_ohm"),
    ],
)
def test_a_series_resistance_is_that_of_the_still_cells(
    readout: lampest.Readout, series: float, key: str
) -> None:
    """The still cells' creep and common change, the prior and the frames are the same for both."""
    recording, specified = errors_of_series(readout, series, key)
    plain = replace(recording, scene=replace(recording.scene, systematic=None))
    program = lampest.program(
        plain, [NOISE], frames=range(UNLOADED + 1), numbers={key: PRIOR}, bounds=FREE
    )
    log = [casadi.log(casadi.vec(program.cells(frame).T)) for frame in range(UNLOADED + 1)]
    for frame in range(1, UNLOADED):
        program = program.subject_to(f"unloaded {frame}", log[frame] - log[0])
    still = np.flatnonzero(~LOAD.ravel()).tolist()
    program, common = program.with_unknown("common", sd=ASSUMED.common_change)
    changes = (log[UNLOADED] - log[0])[still]
    program = program.with_cost(casadi.sumsqr((changes - common) / ASSUMED.creep))
    solved = program.solve()
    assert solved.status == "local optimum verified"
    error, deviation = solved[key][0] - specified, solved.errors(key)[0]
    assert abs(error - EXCESS) < 3 * deviation
    assert deviation < PRIOR / 2

    scene = recording.scene
    noise = Prepared(recording).noise
    resting, loaded = noise.readings[:UNLOADED].mean(), noise.readings[UNLOADED]
    sizes = systematic_of(scene)
    assert sizes is not None
    moves = shared_changes(scene, SharedFrames(scene, resting, loaded, noise.frame), sizes)
    assert moves is not None
    mean, covariance = moves.changes(0.0).posterior(~LOAD.ravel())
    assert PRIOR * mean[0] == pytest.approx(error, abs=0.15 * deviation)
    assert PRIOR * covariance[0, 0] ** 0.5 == pytest.approx(deviation, rel=0.1)


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        (["readout.load_ohm"], "numbers must map keys of the scene to standard deviations"),
        ({"readout.load": 3.0}, "the scene has no number 'readout.load'"),
        ({"readout.kind": 3.0}, "the scene has no number 'readout.kind'"),
        ({"readout.load_ohm": -3.0}, "a positive number, not"),
        ({"readout.load_ohm": "wide"}, "a positive number, not"),
        ({"readout.noise_lsb": 0.1}, "no reading depends on readout.noise_lsb"),
        ({"readout.drive_volt": 0.1}, "the scene has no number 'readout.drive_volt'"),
        ({"series_resistance_ohm": 10.0}, "series_resistance_ohm"),
    ],
)
def test_what_is_no_resistance_of_the_circuit_is_refused(priors: Any, message: str) -> None:
    recording, _ = errors_of_series(LOADED, 0.0, "readout.drive_ohm")
    with pytest.raises(lampest.InputError, match=message):
        lampest.program(recording, [NOISE], numbers=priors)


def test_a_line_that_is_held_is_not_passed_to_a_resistance() -> None:
    held = lampest.DrivenReadout(load_ohm=1000.0, idle_ohm=0.0, drive_ohm=20.0, **QUIET)
    recording, _ = errors_of_series(held, 0.0, "readout.drive_ohm")
    with pytest.raises(lampest.InputError, match="cannot pass from a resistance to none"):
        lampest.program(recording, [NOISE], numbers={"readout.idle_ohm": 1.0})


def test_wire_and_groups_of_dividers_are_refused() -> None:
    wired = replace(lampest.datasets.load("rod").scene, lines=lampest.Lines(1.0, 1.0))
    recording = replace(lampest.datasets.load("rod"), scene=wired)
    with pytest.raises(lampest.InputError, match="wire, contacts and touching lines"):
        lampest.program(recording, [NOISE], numbers={"series_resistance_ohm": 30.0})


def test_lower_bounds_of_the_scene_do_not_hold_beside_an_unknown_number() -> None:
    """A reading bounds its cell from below by numbers that are in question."""
    scene = lampest.Scene(lampest.Panel(1, 1), TWO_POINT, 140.0)
    recording = lampest.Recording.from_array(
        np.full((2, 1, 1), 1140.0), unit="ohm", baseline=1, scene=scene
    )
    program = lampest.program(recording, [NOISE], numbers={"series_resistance_ohm": 30.0})
    cell = program.cells()[0, 0] / 1000
    solved = program.subject_to("known", cell, 0.97).solve()
    assert solved["series_resistance_ohm"][0] == pytest.approx(170.0, abs=0.1)
