"""Loads on a panel of modules: one over a seam is one event, with its place and diameter in the whole image."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lampest import Course, Faults, OralDisc, Panel, Rod, Scene, Simulation, TwoPointReadout, simulate
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.image import ImageWatch, Window
from lampest.loads.recognition.observation import ModelErrors
from lampest.panel.panel import EachModule, Modules
from lampest.report.detect.detection import detect_recording

READOUT = TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)
SCENE = Scene(Panel(modules=Modules(2, 3, EachModule(6, 7), 4.0)), READOUT, 140.0)


@pytest.mark.slow
def test_loads_over_seams_are_one_event_each(tmp_path: Path) -> None:
    """Columns of modules begin at 0, 74 and 148 mm, rows at 0 and 64."""
    scene = replace(SCENE, faults=Faults(dead_modules=((1, 2),)))
    mouth = OralDisc(centre_mm=(40, 62), diameter_mm=38, rim_width_mm=6, pressure_kpa=-10, rim_kpa=20)
    rod = Rod(centre_mm=(180, 25), diameter_mm=30, mass_g=500)
    taken = simulate(Simulation(schema=1, seed=4, scene=scene, frames=14, frame_period_s=0.25, loads=(mouth, rod)))
    taken.save(tmp_path / "mat.h5")
    found = detect_recording(tmp_path / "mat.h5")
    assert found.answer == "sucks" and len(found.attachments) == 2, found.why
    over, pressed = sorted(found.attachments, key=lambda one: one.place)
    assert over.distance((40, 62)) < 3 and over.sucks > 0.9 and abs(over.size - 38) < 6
    assert pressed.distance((180, 25)) < 5 and pressed.sucks < 0.1
    assert found.change is not None and found.change.shape == scene.panel.shape


@pytest.mark.slow
def test_a_bare_panel_of_modules_shows_nothing(tmp_path: Path) -> None:
    simulate(Simulation(schema=1, seed=5, scene=SCENE, frames=60, frame_period_s=0.25)).save(tmp_path / "mat.h5")
    found = detect_recording(tmp_path / "mat.h5")
    assert found.answer == "nothing" and not found.attachments


def test_a_window_is_the_network_of_its_modules() -> None:
    """By differences: cells of other modules change nothing, and lines are each module's own."""
    own = Window.about(SCENE, np.array([140.0, 60.0]))
    assert (own.cells[1].start, own.x_mm, own.y_mm, own.numbers) == (7, 74.0, 0.0, (1, 2, 4, 5))
    cells = np.exp(np.random.default_rng(1).uniform(6, 7, own.scene.panel.shape))
    circuit = own.scene.circuit
    slopes = circuit.network(cells, circuit.ties(cells), None).sensitivity(np.array([3, 100]))
    for column, cell in enumerate((3, 100)):
        moved = cells.copy()
        moved.flat[cell] *= np.exp(1e-5)
        ends = [circuit.network(one, circuit.ties(one), None).reading() for one in (cells, moved)]
        np.testing.assert_allclose(slopes[:, column], ((ends[1] - ends[0]) / 1e-5).ravel(), rtol=1e-3, atol=1e-3)
    offsets = ModelErrors().offsets(cells, own.scene) != 0
    lines = offsets[:, : 4 * 13].reshape(*cells.shape, -1)
    assert lines.sum(axis=2).max() == 2 and (lines[0, 0] & lines[0, 8]).sum() == 0 == (lines[0, 0] & lines[7, 0]).sum()
    assert (lines[0, 0] & lines[0, 6]).sum() == 1 == (lines[0, 0] & lines[5, 0]).sum()


def test_a_load_that_two_windows_see_is_that_of_the_window_around_it_and_loads_stand_in_order_of_time() -> None:
    windows = [Window.about(SCENE, np.array(place)) for place in ([69.0, 57.0], [143.0, 57.0])]
    for nearest, window in enumerate(windows):
        place = float(window.middle[0])
        loads = [
            Attachment(0.9, 1.0, (place + seen - own.x_mm, 0.5), (float(own.middle[1]), 0.5), (40.0, 1.0))
            for seen, own in enumerate(windows)
        ]
        first = replace(loads[nearest], since_s=0.0, x_mm=(place - 60.0 - window.x_mm, 0.5))
        seen_by = [(load, first) if number == nearest else (load,) for number, load in enumerate(loads)]
        every = merged(windows, *seen_by)
        assert [(load.since_s, load.x_mm[0]) for load in every] == [(0.0, place - 60.0), (1.0, place + nearest)]


def test_one_load_hides_none_that_stands_apart_from_it_or_in_the_same_window() -> None:
    windows = [Window.about(SCENE, np.array(place)) for place in ([69.0, 57.0], [143.0, 57.0])]
    blot = Attachment(0.0, 1.0, (40.0, 5.0), (62.0, 5.0), area_mm2=(2000.0, 400.0))  # of no shape: without a diameter
    mouth, rod = (Attachment(0.9, 1.0, (x, 0.5), (62.0, 0.5), (30.0, 1.0)) for x in (150.0, 175.0))
    again = replace(mouth, x_mm=(150.0 - windows[1].x_mm, 0.5))
    assert [load.x_mm[0] for load in merged(windows, (blot, mouth), (again,))] == [150, 40]
    assert len(merged(windows, (mouth, rod), ())) == 2


def merged(windows: list[Window], *loads: tuple[Attachment, ...]) -> tuple[Attachment, ...]:
    """The loads of several windows, each once."""
    watches: Any = [SimpleNamespace(attachments=own) for own in loads]
    opened = tuple((window, watch, 0.0) for window, watch in zip(windows, watches, strict=True))
    return ImageWatch(None, (), opened)._merged()


def test_a_window_covers_the_modules_that_a_load_may_reach() -> None:
    """Cells of 10 × 10 modules are at 0 to 90, 104 to 194 … mm."""
    layout = Modules(4, 4, EachModule(10, 10), 4.0)
    scene = replace(SCENE, panel=Panel(modules=layout))
    for place, numbers in (
        ((45, 45), (0,)),
        ((80, 45), (0, 1)),
        ((45, 97), (0, 4)),
        ((97, 97), (0, 1, 4, 5)),
        ((150, 150), (5,)),
        ((-5, 400), (12,)),
    ):
        assert Window.about(scene, np.array(place, dtype=float)).numbers == numbers


@pytest.mark.slow
def test_recognition_looks_where_something_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 36 modules one carries a rod: one window opens, a bounded number of looks is taken, all at this module."""
    looks = list[tuple[int, ...]]()
    verdict = Detector.verdict

    def counted(self: Detector, *given: Any) -> Any:
        looks.append(self.panel.shape)
        return verdict(self, *given)

    monkeypatch.setattr(Detector, "verdict", counted)
    scene = replace(SCENE, panel=Panel(modules=Modules(6, 6, EachModule(10, 10), 4.0)))
    rod = Rod(centre_mm=(150, 255), diameter_mm=30, mass_g=500)
    course = Course(start_s=1.0)
    made = Simulation(schema=1, seed=6, scene=scene, frames=20, frame_period_s=0.25, loads=(rod,), course=course)
    simulate(made).save(tmp_path / "mat.h5")
    progress = list[tuple[int, int]]()
    answer = detect_recording(tmp_path / "mat.h5", on_frame=lambda *counts: progress.append(counts))
    assert progress == [*((done, 23) for done in range(20)), (23, 23)]
    assert len(answer.attachments) == 1 and answer.attachments[0].distance((150, 255)) < 5
    assert set(looks) == {(10, 10)} and len(looks) <= 5


@pytest.mark.slow
def test_a_window_closes_when_it_has_been_calm_and_the_modules_go_on(tmp_path: Path) -> None:
    """Two visits at one place, two minutes apart, each counted once; no window is open in the end."""
    rod = Rod(centre_mm=(30, 30), diameter_mm=30, mass_g=500)
    course = Course(start_s=1.0, release_at_s=6.0)
    made = Simulation(schema=1, seed=7, scene=SCENE, frames=110, frame_period_s=1.0, loads=(rod,), course=course)
    recording = simulate(made)
    values = recording.recorded.copy()
    values[-20:-5] = values[5:20]
    replace(recording, recorded=values).save(tmp_path / "mat.h5")
    found = list[ImageWatch]()
    ended = ImageWatch.ended

    def noted(self: ImageWatch) -> ImageWatch:
        found.append(self)
        return ended(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ImageWatch, "ended", noted)
        answer = detect_recording(tmp_path / "mat.h5")
    assert len(answer.attachments) == 2, answer.attachments
    assert all(load.distance((30, 30)) < 6 for load in answer.attachments)
    assert [len(watch.opened) for watch in found] == [1]
