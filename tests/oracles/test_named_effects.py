"""An effect is a key of the scene: absent it is not modelled and costs nothing."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from promises import promise

import lampest
from docs.studies.effects import LOADS, Load, Row, figures
from docs.studies.effects import recording as channels_recording
from docs.studies.motion import Motion
from docs.studies.motion import recording as moving_load
from lampest import (
    LogGradient,
    LogRatio,
    Misfit,
    Panel,
    Recording,
    Scene,
    Systematic,
    TwoPointReadout,
)
from lampest.audit import advice
from lampest.inference import warnings as objections
from lampest.inference.circuits import model_check
from lampest.inference.effects import (
    converter_ends,
    converter_memory,
    creep,
    gain_and_ripple,
    leaks_and_contacts,
    motion,
    static_errors,
)
from lampest.inference.effects.effect import Unnamed
from lampest.inference.prepared import Prepared
from lampest.posterior import track
from tests.estimates import recording_of

ROWS = 12
COLUMNS = 8
UNLOADED = 5
FRAMES = 6
MAX_ERROR = 0.01  # median error of cells, relative; an edge that is taken for errors costs more
WIDER = 1.01  # median error bar with a further effect in the scene over that without
ABSENT = 0.002  # reading error that a recording without one leaves possible
STATIC = Systematic(reading_error="estimated")
WEIGHTED = Misfit(weighting="noise")


def standing_load(seed: int, **keys: object) -> Recording:
    """Return a recording of a load with sharp edges that sways by 2 % on a mat with an outline."""
    rng = np.random.default_rng(seed)
    row, column = np.indices((ROWS, COLUMNS))
    present = ((row - 5.5) / 6.6) ** 2 + ((column - 3.5) / 4.4) ** 2 < 1
    cells = np.repeat(
        4000 * np.exp(0.1 * rng.standard_normal((1, ROWS, COLUMNS))), UNLOADED + FRAMES, axis=0
    )
    pressed = 1.4 * ((abs(row - 3) < 2) & (abs(column - 3) < 2)) + 1.1 * (
        (abs(row - 8) < 2) & (abs(column - 4) < 2)
    )
    sway = 1 + 0.02 * np.sin(1.1 * np.arange(FRAMES) + 0.4)
    cells[UNLOADED:] *= np.exp(-pressed * sway[:, None, None])
    exact = lampest.two_point_resistance(np.where(present, cells, 1e12)) + 140
    lsb = 5 / 4096
    codes = np.round(5000 / (1000 + exact) / lsb + rng.standard_normal((8, *exact.shape))).mean(
        axis=0
    )
    listed = tuple((int(j), int(k), 10.0 * k, 10.0 * j) for j, k in np.argwhere(present))
    readout = TwoPointReadout(adc_bits=12, readings=8, noise_lsb=1)
    scene = Scene(Panel(ROWS, COLUMNS, 10.0, listed), readout, 140.0, **keys)
    recorded = 1000 * (5 - codes * lsb) / (codes * lsb)
    return recording_of(
        scene, recorded, UNLOADED, truth_cell_resistance=np.where(present, cells, np.nan)
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "keys", [{}, {"systematic": STATIC}, {"systematic": STATIC, "motion": "estimated"}]
)
@pytest.mark.parametrize("penalty", [LogGradient(), LogRatio()])
def test_edges_of_a_standing_load_are_not_taken_for_reading_errors(
    keys: dict, penalty: lampest.Term
) -> None:
    recording = standing_load(1, **keys)
    estimate = lampest.reconstruct(recording, [WEIGHTED, penalty])
    error = np.abs(estimate.cell_resistance / recording.truth_cell_resistance[estimate.frame] - 1)
    assert np.nanmedian(error) < MAX_ERROR and np.nanquantile(error, 0.95) < 2.5 * MAX_ERROR


@promise("README: An effect that the scene does not name is not modelled.")
def test_an_effect_without_an_entry_in_the_scene_is_not_estimated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Estimates depend on no advice, and wait for none."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("was not asked for")

    for module, names in (
        (leaks_and_contacts, ("without_effects",)),
        (static_errors, ("shared_errors",)),
        (motion, ("share_of_motion",)),
        (creep, ("fitted",)),
        (converter_memory, ("estimated_memory",)),
        (converter_ends, ("saturated",)),
        (gain_and_ripple, ("unloaded_scatter",)),
        (objections, ("warnings_of",)),
        (advice, ("unnamed_effects",)),
        (model_check.Question, ("of", "check", "effects")),
    ):
        for name in names:
            monkeypatch.setattr(module, name, refuse)
    estimate = lampest.reconstruct(standing_load(2))
    assert estimate.solved.all() and estimate.recording.scene.estimated is None
    with pytest.raises(AssertionError, match="was not asked for"):
        assert estimate.advice


@pytest.mark.slow
def test_an_absent_effect_changes_no_reading_and_a_specified_one_is_modelled() -> None:
    plain = standing_load(3)
    noise = Prepared(plain).noise
    np.testing.assert_array_equal(noise.readings.value, plain.readings().value)
    np.testing.assert_array_equal(noise.readings.sigma, plain.readings().sigma)
    for keys in (
        {"systematic": Systematic(reading_error=0.01)},
        {"gain": 0.01},
        {"ripple": 2.0},
        {"motion": 1.0},
    ):
        wider = lampest.reconstruct(replace(plain, scene=replace(plain.scene, **keys)))
        narrow = lampest.reconstruct(plain)
        assert np.nanmedian(wider.cell_resistance_errors / narrow.cell_resistance_errors) > WIDER


@pytest.mark.slow
def test_results_hold_the_number_with_its_deviation(tmp_path: Path) -> None:
    estimate = lampest.reconstruct(standing_load(4, systematic=STATIC, gain="estimated"))
    estimate.save(tmp_path / "results.h5")
    scene = lampest.read_results(tmp_path / "results.h5").cases[0].scene
    size, deviation = scene.estimated["systematic.reading_error"]
    assert 0 < size < ABSENT and deviation > 0
    assert scene.estimated["gain"][0] == pytest.approx(scene.gain)
    assert scene.systematic.reading_error == estimate.noise.reading_error
    assert not estimate.checks
    (line,) = re.findall(
        r"systematic.reading_error: [\d.e-]+ ± [\d.e-]+ \(relative\)", estimate.fit_report()
    )
    assert f"    {line}" in estimate.fit_report().partition("[[Estimated]]")[2]


@pytest.mark.slow
def test_still_cells_show_the_share_of_a_scan_and_readings_are_interpolated_to_its_middle() -> None:
    """A rock creeps by a tenth of a pitch a frame, and each reading has its own time."""
    unnamed, estimated = (
        moving_load(901, "rock", Motion(speed=0.1, scan=0.6), keys)
        for keys in ({}, {"motion": "estimated"})
    )
    share, deviation = Prepared(estimated).noise.estimated["motion"]
    assert abs(share - 0.6) < 3 * deviation and deviation < 0.2
    before, after = (figures(recording, advised=False) for recording in (unnamed, estimated))
    assert after[0] < 0.6 * before[0]
    assert before[4] < 85 and 92 <= after[4] <= 99


@pytest.mark.long
@pytest.mark.parametrize("depth", [0.0, 0.1])
def test_a_scan_without_time_has_no_share(depth: float) -> None:
    """The same holds where averaged frames of a standing load are quieter."""
    swaying = moving_load(901, "rock", Motion(depth=depth, scan=0.0), {"motion": "estimated"})
    share, deviation = Prepared(swaying).noise.estimated["motion"]
    assert share < 2 * deviation
    unnamed = Prepared(replace(swaying, scene=replace(swaying.scene, motion=None)))
    assert not [effect for effect in advice.unnamed_effects(unnamed) if "motion" in effect.line]


@pytest.mark.long
@pytest.mark.parametrize(("seed", "kind"), [(0, "rod"), (2, "rock")])
def test_errors_of_readings_are_not_taken_for_motion(seed: int, kind: str) -> None:
    """A load sways between frames, and each reading is off by a factor of its own."""
    swaying = moving_load(seed, kind, Motion(depth=0.1, scan=0.0), {"motion": "estimated"})
    factors = np.exp(0.01 * np.random.default_rng(99 + seed).standard_normal((8, 8)))
    scene = replace(swaying.scene, systematic=Systematic(reading_error="estimated"))
    noise = Prepared(replace(swaying, recorded=swaying.recorded * factors, scene=scene)).noise
    share, deviation = noise.estimated["motion"]
    assert share < 2 * deviation
    size, deviation = noise.estimated["systematic.reading_error"]
    assert abs(size - np.std(np.log(factors))) < 2 * deviation < 0.007


def test_bars_allow_for_any_share_where_no_cell_is_still() -> None:
    moving = moving_load(903, "hand", Motion(speed=0.3), {"motion": "estimated"})
    assert "motion" not in Prepared(moving).noise.estimated
    assert figures(moving, advised=False)[4] > 85


def with_errors(size: float, **keys: Any) -> Recording:
    """A rod stands, and each reading is off by a factor of its own in all frames."""
    scene = Scene(Panel(5, 5), TwoPointReadout(readings=20, noise_lsb=0.7), 140.0, **keys)
    rod = lampest.Rod(centre_mm=(25, 25), diameter_mm=20, mass_g=1500)
    of_rod = lampest.Simulation(
        1,
        40,
        scene,
        lampest.Cells(3000.0, 0.1),
        baseline_frames=5,
        frames=4,
        loads=(rod,),
        unmodelled=lampest.Unmodelled(reading_error=size),
    )
    return lampest.simulate(of_rod, "rod")


@pytest.mark.slow
def test_a_circuit_that_fails_is_advised_the_error_with_which_it_explains() -> None:
    audit = advice.Audit(Prepared(with_errors(0.05)))
    assert audit.verdict.mark == "no"
    (finding,) = audit.advice
    assert finding.line == "systematic: {reading_error: estimated}"
    named = with_errors(0.05, systematic=Systematic(reading_error="estimated"))
    verdict = advice.Audit(Prepared(named)).verdict
    assert verdict.mark == "doubtful" and "only with errors of this size" in verdict.sentence


@pytest.mark.slow
def test_an_error_that_the_scene_states_is_no_doubt_of_its_circuit() -> None:
    stated = Prepared(with_errors(0.05, systematic=Systematic(reading_error=0.05)))
    assert "only with errors" not in advice.Audit(stated).verdict.sentence
    assert stated.check.explains


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "load", "row", "line"),
    [
        (100, LOADS["mouth"], Row(channel_ohm=10.0), "systematic: {channel_spread_ohm: estimated}"),
        # a hand that covers most cells
        (
            4001,
            Load(("hand",), swaying=0.05),
            Row(channel_ohm=10.0),
            "systematic: {channel_spread_ohm: estimated}",
        ),
        (4003, LOADS["still"], Row(ripple_lsb=1.0), "ripple: estimated"),
        (4003, LOADS["still"], Row(gain=0.01), "gain: estimated"),
    ],
)
def test_one_effect_is_advised_and_no_other(seed: int, load: Load, row: Row, line: str) -> None:
    """Channels are no errors of each reading, ripple is no noise, and a gain no creep."""
    prepared = Prepared(channels_recording(seed, load, row, {}))
    assert [finding.line for finding in advice.unnamed_effects(prepared)] == [line]


@pytest.mark.slow
@pytest.mark.parametrize("load", ["still", "small"])
def test_a_ripple_that_the_scene_names_is_no_motion(load: str) -> None:
    """Still cells seemed to move with the load, in a scan that took 0 ± 0.6 of the time."""
    rippled = channels_recording(100, LOADS[load], Row(ripple_lsb=10.0), {"ripple": "estimated"})
    assert not advice.unnamed_effects(Prepared(rippled))


class Fake:
    """A prepared recording whose scene names some effects."""

    layout = None
    noise = None
    cleaned = SimpleNamespace(readings=SimpleNamespace(sigma=1.0), recording=None)

    def __init__(self, *names: str) -> None:
        self.names = tuple(sorted(names))


def test_an_effect_that_gains_only_alone_is_not_advised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Named, motion leaves nothing, and errors of readings leave motion; a gain is beside both."""
    motion_found, error, gain_found = (
        Unnamed(lambda _, name=name: name, {name: "estimated"})
        for name in ("motion", "error", "gain")
    )
    shown = {
        (): (gain_found, error, motion_found),
        ("gain",): (error, motion_found),
        ("error",): (gain_found, motion_found),
        ("motion",): (gain_found,),
        ("error", "gain"): (motion_found,),
    }

    monkeypatch.setattr(advice, "searched", lambda fake: shown.get(fake.names, ()))
    monkeypatch.setattr(
        advice,
        "named",
        lambda fake, *unnamed: Fake(
            *fake.names, *(name for one in unnamed for name in one.addition)
        ),
    )
    assert [finding.what for finding in advice.unnamed_effects(Fake())] == ["gain", "motion"]


def test_effects_that_a_scene_cannot_name_leave_advice_as_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without entries the search beside such an effect would begin anew with the same scene."""
    found = (Unnamed(lambda _: "own"), Unnamed(lambda _: "gain", {"gain": 0.01}))

    monkeypatch.setattr(advice, "searched", lambda prepared: found)
    monkeypatch.setattr(advice, "named", lambda prepared, *unnamed: prepared)
    assert [finding.what for finding in advice.unnamed_effects(Fake())] == ["own", "gain"]


@pytest.mark.slow
def test_errors_beyond_those_of_parts_are_another_circuit() -> None:
    """A verdict of "no" comes with advice, here with what to check."""
    (finding,) = advice.Audit(Prepared(with_errors(0.2))).advice
    assert finding.remedy and not finding.addition
    named = with_errors(0.2, systematic=Systematic(reading_error="estimated"))
    assert Prepared(named).check.explains is False


@pytest.mark.slow
def test_a_load_that_moves_by_a_pitch_a_frame_is_advised_to_be_named() -> None:
    audit = advice.Audit(Prepared(moving_load(41, "mouth", Motion(speed=1.0), {})))
    assert audit.verdict.mark == "no"
    assert [finding.line for finding in audit.advice] == ["motion: estimated"]


def test_bars_hold_scatter_of_films_that_errors_of_readings_hide() -> None:
    """By the chosen weight alone, which expects smoother films, 50 % of the cells were within."""
    load = LOADS["small"]
    row = Row(static=0.05)
    made = channels_recording(103, load, row, {"systematic": Systematic(reading_error=0.05)})
    assert figures(made, advised=False).own > 75
    possible = Prepared(made).noise.possible_errors
    assert possible is not None and 0.05 < possible.film_scatter < 0.2


@pytest.mark.slow
def test_penalties_that_compare_frames_expect_nothing_of_films() -> None:
    load = LOADS["small"]
    scene_keys = {"systematic": Systematic(reading_error=0.02)}
    made = channels_recording(103, load, Row(static=0.02), scene_keys)
    terms = [WEIGHTED, LogRatio(weight=1e4)]
    hidden = lampest.reconstruct(made, terms).cell_resistance_errors
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(track, "answer_to_scatter", lambda *_: 0.0)
        plain = lampest.reconstruct(made, terms).cell_resistance_errors
    assert hidden is not None and plain is not None
    np.testing.assert_allclose(hidden, plain, rtol=1e-9)
