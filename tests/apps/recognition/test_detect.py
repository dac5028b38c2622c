"""Outputs and limits of `lampest detect`.

The outputs are sentences, events, --json, detections.h5 and the timeline.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from laws.recognised import answered, every_frame

from lampest import (
    Block,
    InputError,
    LoadedColumnsReadout,
    LogRatio,
    Misfit,
    OralDisc,
    Panel,
    Recording,
    Results,
    Rod,
    Scene,
    Systematic,
    read_results,
    reconstruct,
    write_results,
)
from lampest.apps.recognition.detect.answer import (
    CANNOT_SAY,
    LAMPREY,
    PRESSES,
    SUCKS,
)
from lampest.apps.recognition.detect.detection import (
    Known,
    detect_recording,
    detect_results,
    known_of,
    known_of_case,
)
from lampest.inference.prepared import Prepared
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.scan_order import by_columns
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.shapes import AnyShape
from lampest.recording.simulation.simulation import Cells, Course, Simulation, Unmodelled, simulate
from lampest.runs.filling import _arrays_of, frame_noise_of
from lampest.runs.starter import write_starter

PANEL = Panel(8, 10, 10.0)
MOUTH = OralDisc(centre_mm=(48, 36), diameter_mm=33, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=85)
TANK = Scene(PANEL, TwoPointReadout(noise_lsb=0.7), 140.0)
MAT = Scene(
    Panel(12, 12, 10.0),
    LoadedColumnsReadout(load_ohm=35e3, polarity="down", noise_lsb=1, readings=4),
    purpose="mat",
)
MAT_CELLS = Cells(resistance_ohm=30e3, spread=0.2, patch_mm=6)
ELL = (
    Block(centre_mm=(25, 40), length_mm=60, width_mm=20, angle_deg=90, mass_g=800),
    Block(centre_mm=(45, 60), length_mm=30, width_mm=20, mass_g=400),
)


def recorded(
    seed: int = 2,
    scene: Scene = TANK,
    frames: int = 6,
    loads: tuple[AnyShape, ...] = (MOUTH,),
    **options: Any,
) -> Recording:
    """A mouth on a panel, three unloaded frames before."""
    return simulate(Simulation(1, seed, scene, frames=frames, loads=loads, **options))


@pytest.mark.slow
def test_pumps_identify_a_mouth_without_visible_breath() -> None:
    """At one frame a second.

    A cup that leaks as fast, without pumps, stays something that sucks.
    """
    pumping = Course(
        start_s=3,
        approach_s=0.5,
        attachment_s=1,
        pump_s=50,
        pump_loss=0.3,
        release_at_s=290,
        pull_off=0.5,
    )
    leaking = replace(pumping, pump_s=300.0, pump_loss=0.5)
    pumped, leaked = (
        answered(
            recorded(
                seed=5,
                scene=Scene(Panel(6, 6), TwoPointReadout(noise_lsb=0.7), 140.0),
                frames=300,
                loads=(replace(MOUTH, centre_mm=(26, 24)),),
                course=course,
                frame_period_s=1.0,
                baseline_frames=5,
            )
        )
        for course in (pumping, leaking)
    )
    assert (pumped.answer, leaked.answer, len(pumped.attachments)) == (LAMPREY, SUCKS, 1)
    assert "pumping up its suction" in pumped.sentence and "breathing" not in pumped.sentence
    assert "whether suction is pumped up again shows within minutes" in leaked.sentence


@pytest.mark.parametrize("readout", [TwoPointReadout(), LoadedColumnsReadout(load_ohm=1000.0)])
def test_frame_noise_survives_its_arrays(readout: Any) -> None:
    """A pattern has a number for each channel of a line; of another shape it is refused."""
    scene = Scene(Panel(2, 3), readout)
    channels = 2 if by_columns(scene.circuit) else 3
    noise = FrameNoise(
        scene,
        4,
        0.01,
        np.arange(2.0 * channels).reshape(channels, 2),
        np.ones((channels, 1)),
        motion=np.array([0.02, 0.01, 0.0]),
    )
    arrays = _arrays_of(noise)
    np.testing.assert_equal(vars(frame_noise_of(arrays, scene)), vars(noise))
    assert frame_noise_of({}, scene) is None and _arrays_of(None) == {}
    for wrong in (
        {"unloaded": np.ones(2)},
        {"together": np.ones(channels)},
        {"apart": np.ones((4, 1))},
        {"motion": np.ones(2)},
    ):
        with pytest.raises(ValueError, match="must"):
            frame_noise_of(arrays | wrong, scene)


@pytest.mark.slow
def test_detect_of_a_mat_reports_two_contacts_with_place_and_area() -> None:
    """An L and a disc; then a mouth."""
    disc = Rod(centre_mm=(90, 90), diameter_mm=30, mass_g=600)
    two, mouth = (
        answered(recorded(scene=MAT, cells=MAT_CELLS, frame_period_s=0.25, loads=loads))
        for loads in ((*ELL, disc), (MOUTH,))
    )
    assert two.answer == mouth.answer == PRESSES and len(two.attachments) == 2
    ell, disc = sorted(two.attachments, key=lambda load: load.x_mm[0])
    assert disc.place == pytest.approx((90, 90), abs=3) and 7 <= disc.cells <= 13
    assert ell.place == pytest.approx((32, 47), abs=8) and 14 <= ell.cells <= 30
    assert two.sentence.startswith("2 contacts: since ") and two.sentence.count(" cells, ") == 2
    words = mouth.sentence + " ".join(mouth.notes)
    assert not any(word in words for word in ("suck", "lamprey", "breath"))


@pytest.mark.slow
def test_a_short_press_is_a_contact_of_a_mat_and_mentioned_otherwise() -> None:
    period_s = 0.05
    course = Course(start_s=0.4, release_at_s=0.7)
    mat, unspecified = (
        answered(
            recorded(
                scene=replace(MAT, panel=Panel(7, 7, 10.0), purpose=purpose),
                frames=24,
                loads=(Rod(centre_mm=(30, 30), diameter_mm=25, mass_g=500),),
                cells=MAT_CELLS,
                course=course,
                frame_period_s=period_s,
            )
        )
        for purpose in ("mat", None)
    )
    (press,) = mat.attachments
    touched_s = 3 * period_s + course.start_s
    released_s = 3 * period_s + 0.7
    assert (press.since_s, press.until_s) == pytest.approx((touched_s, released_s), abs=0.11)
    assert press.place == pytest.approx((30, 30), abs=4)
    assert (
        not unspecified.attachments
        and "something touched the panel from 0.6 s to 0.9 s" in unspecified.sentence
    )


def test_cells_of_lower_conductance_are_neither_a_contact_nor_explained() -> None:
    scene = replace(MAT, panel=Panel(7, 7, 10.0))
    loaded = recorded(
        scene=scene,
        loads=(Rod(centre_mm=(30, 30), diameter_mm=25, mass_g=30),),
        cells=MAT_CELLS,
        frame_period_s=0.25,
    )
    order = np.r_[3:9, 3, 0:3, 0:3]  # the load first, as if it were the unloaded panel
    recorded_again = loaded.recorded[order]
    time = 0.25 * np.arange(len(order))
    turned = Recording(scene, recorded_again, time, (np.arange(len(order)) >= 7).astype(np.uint8))
    answer = answered(turned)
    assert not answer.attachments
    assert answer.answer == CANNOT_SAY


@pytest.mark.slow
def test_a_recording_and_its_results_give_detection_the_same(tmp_path: Path) -> None:
    """Results hold the mean of the unloaded frames, and readings without their own errors."""
    scene = Scene(Panel(4, 5, 10.0), TwoPointReadout(noise_lsb=0.7), 140.0)
    load = Rod(centre_mm=(20, 15), diameter_mm=20, mass_g=500)
    recording = recorded(scene=scene, loads=(load,), unmodelled=Unmodelled(reading_error=0.1))
    named = replace(scene, gain="estimated", systematic=Systematic(reading_error=0.1))
    recording = replace(recording, scene=named)
    estimate = reconstruct(
        recording, [Misfit(weighting="noise"), LogRatio(weight=1.0)], error_bars=False
    )
    assert estimate.noise.log_factor is not None and estimate.noise.sigma_factor == 1
    write_results(tmp_path / "results.h5", [estimate.result("changes")])
    known = known_of(estimate.prepared)
    again, frames = known_of_case(read_results(tmp_path / "results.h5").cases[0])
    assert isinstance(known, Known)
    assert (known.explained(), known.begin) == (again.explained(), again.begin)
    assert known.unloaded.shape == again.unloaded.shape
    np.testing.assert_allclose(known.resting, again.resting)
    np.testing.assert_allclose(known.sigma, again.sigma)
    for expected, of_results in zip(every_frame(recording, known), frames, strict=True):
        for part, part_again in zip(expected, of_results, strict=True):
            np.testing.assert_allclose(part, part_again)


@pytest.mark.slow
def test_a_mouth_on_a_panel_with_pull_ups_sucks_in_the_recording_and_in_its_results(
    tmp_path: Path,
) -> None:
    write_starter(tmp_path / "mine", "pull_ups", 10, 10)
    recording = Recording.load(tmp_path / "mine" / "example.h5")
    estimate = reconstruct(
        recording, [Misfit(weighting="noise"), LogRatio(weight=1.0)], error_bars=False
    )
    (of_results,) = detect_results(Results((estimate.result("changes"),)))
    assert of_results.answer == SUCKS
    assert of_results.sentence == detect_recording(tmp_path / "mine" / "example.h5").sentence


@pytest.mark.slow
def test_a_single_frame_shows_no_change(tmp_path: Path) -> None:
    recorded(frames=1).save(tmp_path / "one.h5")
    answer = detect_recording(tmp_path / "one.h5")
    assert answer.answer == CANNOT_SAY and "one frame" in answer.why
    scene = Scene(PANEL)
    values = np.full((3, 8, 10), 500.0)
    for frames, shows_noise in ((2, False), (3, True)):
        recording = Recording(
            scene,
            values[:frames],
            np.arange(float(frames)),
            (np.arange(frames) > 0).astype(np.uint8),
        )
        known_or_answer = known_of(Prepared(recording))
        if shows_noise:
            assert isinstance(known_or_answer, Known)
        else:
            assert known_or_answer.why == "the noise is unknown, and too few frames show it"


def test_detect_refuses_files_other_than_recordings_and_results(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(InputError, match=r"other\.h5"):
        detect_recording(tmp_path / "other.h5")


def test_detection_without_a_check_says_so_and_computes_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(Panel(5, 5, 10.0), TwoPointReadout())
    load = Rod(centre_mm=(20.0, 20.0), diameter_mm=20, mass_g=500)
    recording = simulate(Simulation(1, 3, scene, frames=3, loads=(load,)))
    recording.save(tmp_path / "rod.h5")

    def refused(prepared: Prepared) -> None:
        raise AssertionError("checked")

    monkeypatch.setattr(Prepared, "check", property(refused))
    answer = detect_recording(tmp_path / "rod.h5", check=False)
    assert any("the circuit was not checked" in line for line in answer.warnings)
    with pytest.raises(AssertionError, match="checked"):
        detect_recording(tmp_path / "rod.h5")
