"""What a look computes: nothing twice, and nothing that cannot change its verdict."""

from typing import Any

import pytest
from laws.recognised import answered

from lampest import Course, Panel, Rod, Scene, Simulation, TwoPointReadout, simulate
from lampest.apps.recognition.observation import Baseline
from lampest.recording.recording import Recording
from lampest.recording.shapes.shape import Shape

PANEL = Panel(9, 11)
ROD = Rod(centre_mm=(20, 30), diameter_mm=28, mass_g=300)


def touched(*loads: Shape, frames: int = 24) -> Recording:
    """A recording whose loads come after a second."""
    scene = Scene(PANEL, TwoPointReadout(), 140.0)
    course = Course(start_s=1.0)
    return simulate(
        Simulation(1, 5, scene, frames=frames, frame_period_s=0.25, loads=loads, course=course)
    )


def test_the_panel_before_a_load_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = list[Baseline]()
    of = Baseline.of.__func__  # type: ignore[attr-defined]

    def counted(cls: type[Baseline], *given: Any) -> Baseline:
        fitted.append(of(cls, *given))
        return fitted[-1]

    monkeypatch.setattr(Baseline, "of", classmethod(counted))
    assert len(answered(touched(ROD)).attachments) == 1
    assert len(fitted) == 2, "before the first frame, and under the load"
