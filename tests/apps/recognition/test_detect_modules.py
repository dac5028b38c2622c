"""Recognition on panels of modules, and of mouths that the package did not make.

Sizes of loads are compared with a random walk.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laws.recognised import answered

from docs.studies.attachments import CURVES, SLIDES_S, SLIDING, TOUCH_S, UNLOADED, recording, seen
from lampest import (
    Array,
    Course,
    Faults,
    OralDisc,
    Panel,
    Rod,
    Scene,
    Simulation,
    TwoPointReadout,
    simulate,
)
from lampest.apps.recognition.detect.answer import CUP, LAMPREY, SUCKS
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.image import Window
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.observation import Observation
from lampest.panel.panel import EachModule, Modules
from lampest.panel.response import ratio_from_pressure

READOUT = TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)
SCENE = Scene(Panel(modules=Modules(2, 3, EachModule(6, 7), 4.0)), READOUT, 140.0)


@pytest.mark.slow
def test_each_load_over_a_seam_is_one_event(tmp_path: Path) -> None:
    """Columns of modules begin at 0, 74 and 148 mm, rows at 0 and 64."""
    scene = replace(SCENE, faults=Faults(dead_modules=((1, 2),)))
    mouth = OralDisc(
        centre_mm=(40, 62), diameter_mm=38, rim_width_mm=6, pressure_kpa=-10, rim_kpa=20
    )
    rod = Rod(centre_mm=(180, 25), diameter_mm=30, mass_g=500)
    taken = simulate(
        Simulation(
            schema=1, seed=4, scene=scene, frames=14, frame_period_s=0.25, loads=(mouth, rod)
        )
    )
    taken.save(tmp_path / "mat.h5")
    answer = detect_recording(tmp_path / "mat.h5")
    assert answer.answer == "sucks" and len(answer.attachments) == 2, answer.why
    over, pressed = sorted(answer.attachments, key=lambda attachment: attachment.place)
    assert over.distance((40, 62)) < 3 and over.sucks > 0.9 and abs(over.size - 38) < 6
    assert pressed.distance((180, 25)) < 5 and pressed.sucks < 0.1
    assert answer.change is not None and answer.change.shape == scene.panel.shape


@pytest.mark.slow
def test_a_bare_panel_of_modules_shows_nothing(tmp_path: Path) -> None:
    simulate(Simulation(schema=1, seed=5, scene=SCENE, frames=60, frame_period_s=0.25)).save(
        tmp_path / "mat.h5"
    )
    answer = detect_recording(tmp_path / "mat.h5")
    assert answer.answer == "nothing" and not answer.attachments


def test_a_window_equals_the_network_of_its_modules() -> None:
    """Differences show it: cells of other modules change nothing, and no module shares a line."""
    own = Window.about(SCENE, np.array([140.0, 60.0]))
    assert (own.cells[1].start, own.x_mm, own.y_mm, own.numbers) == (7, 74.0, 0.0, (1, 2, 4, 5))
    cells = np.exp(np.random.default_rng(1).uniform(6, 7, own.scene.panel.shape))
    circuit = own.scene.circuit
    assert (
        circuit.unit == "ohm"
        and np.all(circuit.series_ohm == 140)
        and circuit.series_ohm.shape == (12, 14)
    )
    apart = [
        SCENE.of_modules[0].circuit.uniform_start(part) for part in (cells[:6, 7:], cells[6:, :7])
    ]
    np.testing.assert_array_equal(circuit.uniform_start(cells)[:6, 7:], apart[0])
    np.testing.assert_array_equal(circuit.uniform_start(cells)[6:, :7], apart[1])
    slopes = circuit.network(cells, circuit.ties(cells), None).sensitivity()[:, [3, 100]]
    for column, cell in enumerate((3, 100)):
        moved = cells.copy()
        moved.flat[cell] *= np.exp(1e-5)
        ends = [
            circuit.network(resistances, circuit.ties(resistances), None).reading()
            for resistances in (cells, moved)
        ]
        np.testing.assert_allclose(
            slopes[:, column], ((ends[1] - ends[0]) / 1e-5).ravel(), rtol=1e-3, atol=1e-3
        )
    offsets = ModelErrors().offsets(cells, own.scene) != 0
    lines = offsets[:, : 4 * 13].reshape(*cells.shape, -1)
    assert (
        lines.sum(axis=2).max() == 2
        and (lines[0, 0] & lines[0, 8]).sum() == 0 == (lines[0, 0] & lines[7, 0]).sum()
    )
    assert (lines[0, 0] & lines[0, 6]).sum() == 1 == (lines[0, 0] & lines[5, 0]).sum()


@pytest.mark.slow
def test_recognition_examines_only_changed_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 36 modules one carries a rod; recognition examines it alone, at most five times."""
    examined = list[tuple[int, ...]]()
    verdict = Detector.verdict

    def counted(self: Detector, frame: Observation, *given: Any) -> Any:
        examined.append(frame.panel.shape)
        return verdict(self, frame, *given)

    monkeypatch.setattr(Detector, "verdict", counted)
    scene = replace(SCENE, panel=Panel(modules=Modules(6, 6, EachModule(10, 10), 4.0)))
    rod = Rod(centre_mm=(150, 255), diameter_mm=30, mass_g=500)
    course = Course(start_s=1.0)
    simulation = Simulation(
        schema=1, seed=6, scene=scene, frames=20, frame_period_s=0.25, loads=(rod,), course=course
    )
    simulate(simulation).save(tmp_path / "mat.h5")
    progress = list[tuple[int, int]]()
    answer = detect_recording(tmp_path / "mat.h5", on_frame=lambda *counts: progress.append(counts))
    assert progress == [*((done, 23) for done in range(20)), (23, 23)]
    assert len(answer.attachments) == 1 and answer.attachments[0].distance((150, 255)) < 5
    assert set(examined) == {(10, 10)} and len(examined) <= 5


@pytest.mark.slow
def test_breath_is_judged_in_uninterrupted_windows() -> None:
    """A deep breath is no row of steps, and a shaken cup does not breathe.

    A breath of 14 % of the suction changes the readings by more than half of the load. An outlier
    in two frames of three is no step either. The first 8 s of another mouth leave a breath of 6 %
    at 0.7 Hz open: frames after a full window are judged before the next is full. The first seconds
    of a shaken cup look like breath.
    """
    assert seen("uneven mouth", 4.0, 501003).lamprey < 10
    assert seen("mouth partly off", 4.0, 501001).lamprey < 8
    assert answered(recording("mouth", 4.0, 501005)[0]).answer == LAMPREY
    assert np.isnan(seen("shaken cup", 4.0, 812005).lamprey)


@pytest.mark.slow
def test_cups_in_waves_hardly_breathe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waves of 0.2 kPa at 0.7 Hz change all cells.

    Under a load they do by other parts than those that readings share.
    """
    breathes = []

    def in_waves(pressure: Array) -> Array:
        wave = 0.2 * np.sin(2 * np.pi * 0.7 * 0.25 * np.arange(len(pressure)))
        return ratio_from_pressure(pressure + wave[:, None, None])

    monkeypatch.setitem(CURVES, "published", in_waves)
    for seed in range(777000, 777004):
        answer = answered(recording("cup", 4.0, seed)[0])
        assert answer.answer in (CUP, SUCKS)
        assert answer.chosen is not None
        breathes.append(answer.chosen.breathes)
    assert np.median(breathes) < 0.3 and max(breathes) < 0.75


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_a_mouth_that_slides_is_one_attachment(seed: int) -> None:
    """The film keeps a residue also where the mouth was before it slid (seed 4)."""
    slid, mouth, _, _ = recording(SLIDING, 4.0, seed, attached_s=20.0)
    answer = answered(slid)
    (attachment,) = answer.attachments
    begin = slid.time[UNLOADED] + TOUCH_S
    assert answer.answer == LAMPREY and "pumping" not in answer.sentence
    assert (
        attachment.moved_s
        and begin + SLIDES_S[0] < attachment.moved_s[-1] < begin + SLIDES_S[1] + 0.5
    )
    assert abs(attachment.place[0] - mouth.centres_mm[0][0]) == pytest.approx(
        15, abs=3 * attachment.x_mm[1]
    )
    assert attachment.x_mm[1] < 1


@pytest.mark.slow
@pytest.mark.parametrize("curve", ["straight", "delayed"])
def test_error_bars_of_suction_and_breath_contain_unmeasured_films(curve: str) -> None:
    watched = [seen("mouth", 4.0, seed, attached_s=9.0, curve=curve) for seed in range(9000, 9004)]
    suction = np.array(
        [(answer.suction - answer.true_suction) / answer.suction_sd for answer in watched]
    )
    depth = np.array([(answer.seen_depth - answer.depth) / answer.depth_sd for answer in watched])
    assert np.abs(suction).max() < 2.3 and np.abs(depth).max() < 2.3
