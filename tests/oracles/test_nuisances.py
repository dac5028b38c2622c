"""Leaks, contacts and saturation are taken off the frames that have them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from laws.recognised import every_frame, known_before

import lampest
from docs.studies.audit import AuditFile, AuditTask
from lampest import Block, Cells, Course, Recording, Scene, Simulation, TwoPointReadout, simulate
from lampest.apps.recognition.detect.detection import Known, known_of
from lampest.apps.studies.study import read_settings
from lampest.audit.advice import unnamed_effects
from lampest.files.levels import UNUSUAL
from lampest.inference.prepared import Prepared
from lampest.panel.panel import EachModule, Modules
from tests.estimates import recording_of
from tests.netlist import two_point_resistances

ROWS = 9
COLUMNS = 10
UNLOADED = 5
FRAMES = 6
MAX_OPEN = 0.01  # error that a corrected effect leaves in a reading, relative
CLEAR = 10  # σ of an effect that is not corrected
CORRECTED = 1e-3  # relative; an uncorrected leak moves readings by more than ten times that
ESTIMATED = {"leaks": "estimated", "contacts": "estimated"}


def panel(
    seed: int,
    leak_ohm: float = np.inf,
    leak_from: int = 0,
    contact: tuple[int, float, int] = (0, 0.0, 0),
    saturated: float = 1.0,
    **keys: str,
) -> Recording:
    """A hand on some cells.

    contact : of a row, so many ohm more, from a frame on. saturated : share of full scale.

    keys : of the scene.
    """
    rng = np.random.default_rng(seed)
    row, column = np.indices((ROWS, COLUMNS))
    across, down = rng.uniform(3, 6, 2)
    frames = UNLOADED + FRAMES
    cells = np.repeat(3000 * np.exp(0.15 * rng.standard_normal((1, ROWS, COLUMNS))), frames, axis=0)
    cells[UNLOADED:] *= np.exp(-2 * np.exp(-((row - down) ** 2 + (column - across) ** 2) / 3))
    leaks = np.where(np.arange(frames) >= leak_from, leak_ohm, np.inf)
    ohm = np.stack([two_point_resistances(*frame) for frame in zip(cells, leaks, strict=True)])
    ohm[contact[2] :, contact[0]] += contact[1]
    code = np.minimum(1023 * 1000 / (1140 + ohm), saturated * 1023)
    noisy = np.round(code + 0.7 * rng.standard_normal((20, *code.shape)))
    volt = np.minimum(noisy, np.round(saturated * 1023)).mean(axis=0) * 5 / 1023
    scene = Scene(
        lampest.Panel(ROWS, COLUMNS), TwoPointReadout(readings=20, noise_lsb=0.7), 140.0, **keys
    )
    return recording_of(scene, (5 - volt) / volt * 1000, UNLOADED)


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_an_outlier_during_a_load_is_not_taken_for_a_contact(seed: int) -> None:
    """In the only loaded frame one reading is off by 25 ohm."""
    recording = panel(seed)
    recorded = recording.recorded[: UNLOADED + 1].copy()
    recorded[-1, 0, 9] = 0.7 * recorded[:-1, 0, 9].mean() + 0.3 * recording.recorded[-1, 0, 9] + 25
    alone = {"time": recording.time[: len(recorded)], "role": recording.role[: len(recorded)]}
    assert Prepared(replace(recording, recorded=recorded, **alone)).effects.name == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        {"leak_ohm": 10e3, "leak_from": UNLOADED + 3},
        {"leak_ohm": 2e3},
        {"contact": (3, 200.0, UNLOADED + 3)},
        {"contact": (3, 200.0, UNLOADED + 3), "leak_ohm": 10e3, "leak_from": UNLOADED + 3},
    ],
)
def test_leaks_and_contacts_are_corrected_in_their_frames(effect: dict) -> None:
    """Both recordings have the same noise; the uncertainty of the sizes is a fraction of it."""
    dirty = Prepared(panel(1, **effect, **ESTIMATED)).noise
    clean = panel(1).readings()
    assert dirty.estimated and all(size > deviation for size, deviation in dirty.estimated.values())
    unnamed = Prepared(panel(1, **effect))
    assert unnamed.noise.corrected_effects is None
    advised = {line for finding in unnamed_effects(unnamed) for line in finding.line.split(", ")}
    assert advised & {"leaks: estimated", "contacts: estimated"}
    assert clean.sigma is not None
    assert 0 < np.abs(dirty.frame.effect_errors[1]).max() < MAX_OPEN
    open_ohm = np.hypot(
        dirty.readings.sigma, np.linalg.norm(dirty.frame.effect_errors[1], axis=0) * clean.value
    )
    errors = np.abs((dirty.readings.value - clean.value) / open_ohm)
    assert (
        np.quantile(errors, 0.95, axis=(1, 2)).max() < UNUSUAL
    )  # of the sizes in 22 frames the largest
    assert np.abs((panel(1, **effect).readings().value - clean.value) / open_ohm)[-1].max() > CLEAR
    assert bool(np.any(dirty.frame.effect_errors[0])) == (
        "leak_from" not in effect and "contact" not in effect
    )


@pytest.mark.slow
def test_detect_uses_frames_without_the_leak() -> None:
    recording = panel(1, leak_ohm=10e3, leak_from=UNLOADED + 3, **ESTIMATED)
    frames = [value for value, _, _ in every_frame(recording, known_before(recording))]
    assert np.allclose(frames, Prepared(recording).noise.readings.value[UNLOADED:], rtol=CORRECTED)
    assert not np.allclose(frames, recording.readings().value[UNLOADED:], rtol=10 * CORRECTED)


@pytest.mark.slow
def test_estimates_of_modules_are_corrected_and_their_detection_is_not() -> None:
    leaking = panel(1, leak_ohm=10e3, leak_from=UNLOADED + 3, **ESTIMATED)
    sound = panel(2, **ESTIMATED)
    layout = Modules(1, 2, EachModule(ROWS, COLUMNS), 4.0)
    recording = replace(
        leaking,
        scene=replace(leaking.scene, panel=lampest.Panel(modules=layout)),
        recorded=np.concatenate([leaking.recorded, sound.recorded], axis=2),
    )
    prepared = Prepared(recording)
    change = np.abs(prepared.noise.readings.value / recording.readings().value - 1)
    assert change[..., :COLUMNS].max() > 0.03 and not change[..., COLUMNS:].any()
    known = known_of(prepared)
    assert isinstance(known, Known)
    values = [value for value, _, _ in every_frame(recording, known)]
    np.testing.assert_array_equal(values, recording.readings().value[UNLOADED:])


@pytest.mark.slow
def test_an_ambiguous_contact_is_named_but_not_corrected() -> None:
    recording = panel(8, contact=(3, 200.0, 0), **ESTIMATED)
    prepared = Prepared(recording).effects
    assert (
        prepared.name
        and prepared.pair is None
        and Prepared(recording).noise.corrected_effects is None
    )


@pytest.mark.slow
def test_the_size_of_a_leak_is_estimated_and_a_converter_curve_is_not_taken_for_an_effect() -> None:
    line = Prepared(panel(2, leak_ohm=5e3, leak_from=UNLOADED)).check.better
    leak_kohm = float(line.split("a leak of ")[1].split(" kohm")[0])
    assert abs(leak_kohm - 5) < 1
    audit = read_settings(AuditFile)(Path(__file__).parents[2] / "configs" / "audit.yaml")
    assert Prepared(AuditTask(audit, "INL 2 LSB", 403).recording()).effects.name == ""


def test_the_edge_of_a_large_load_is_not_taken_for_a_contact() -> None:
    """The load covers whole columns, presses the last one little, and breathes."""
    block = Block(centre_mm=(17.5, 45.0), length_mm=35.0, width_mm=90.0, mass_g=4000.0)
    course = Course(
        start_s=-0.08,
        approach_s=0.06,
        attachment_s=0.9316,
        breathing_hz=0.80338,
        breathing_depth=0.1,
    )
    scene = Scene(lampest.Panel(9, 7), TwoPointReadout(readings=20, noise_lsb=0.7), 140.0)
    times = {"frames": 18, "frame_period_s": 0.1, "course": course}
    recording = simulate(
        Simulation(1, 9125, scene, Cells(spread=0.085013), loads=(block,), **times)
    )
    assert Prepared(recording).effects.name == ""
