"""What a look computes: nothing twice, and nothing that cannot change its verdict."""

from typing import Any

import numpy as np
import pytest
from laws.recognised import PATCH_MM, answered, frame_under

from lampest import Course, OralDisc, Panel, Ring, Rod, Scene, Simulation, TwoPointReadout, simulate
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.fit import Effect, Fit, Fitting
from lampest.apps.recognition.observation import Baseline
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.recording.shapes.shape import Shape

PANEL = Panel(9, 11)
ROD = Rod(centre_mm=(20, 30), diameter_mm=28, mass_g=300)
OTHER_ROD = Rod(centre_mm=(80, 50), diameter_mm=28, mass_g=300)
RING = Ring(centre_mm=(50, 40), outer_diameter_mm=44, inner_diameter_mm=32, mass_g=800)
MOUTH = OralDisc(centre_mm=(55, 42), diameter_mm=38, rim_width_mm=6, pressure_kpa=-8, rim_kpa=20)


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


def test_a_shape_that_leaves_changed_cells_to_others_is_not_refined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refined = list[str]()
    best = Fitting.best

    def noted(self: Fitting, *given: Any, **options: Any) -> Fit:
        refined.append(self.candidate.label)
        return best(self, *given, **options)

    monkeypatch.setattr(Fitting, "best", noted)
    assert len(answered(touched(ROD, OTHER_ROD, frames=12)).attachments) == 2
    assert refined.count("rod and rod") and not refined.count("rod")


def test_a_look_at_a_ring_begins_where_the_one_before_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    computed = list[Array]()
    effect = Fitting.effect

    def counted(self: Fitting, parameters: Array) -> Effect:
        computed.append(parameters)
        return effect(self, parameters)

    monkeypatch.setattr(Fitting, "effect", counted)
    frame = frame_under(RING, PANEL)
    detector = Detector(PATCH_MM)
    cold = detector.verdict(frame)
    effects_of_cold = len(computed)
    warm = detector.verdict(frame, cold.fits)
    assert warm.best.candidate is cold.best.candidate
    assert warm.best.evidence > cold.best.evidence - 1
    assert len(computed) - effects_of_cold < effects_of_cold


@pytest.mark.parametrize(("away", "is_lost"), [(0.0, False), (0.3, True)])
def test_a_mouth_begins_at_its_former_fit_where_its_own_start_is_lost(
    away: float, is_lost: bool
) -> None:
    frame = frame_under(MOUTH, PANEL)
    detector = Detector(PATCH_MM)
    former = detector.verdict(frame).best
    diameter = np.arange(len(former.parameters)) == 2
    fitting = detector.fitting(former.candidate, frame)
    effect = fitting.effect(former.parameters + away * diameter)
    start = fitting.fit_at(effect, fitting.about(effect, fitting.errors(former, 0.1)))
    begin = detector._less_lost(frame, start, [former], 0.1)
    assert (begin is start) is not is_lost


def test_no_fit_is_worse_than_its_start() -> None:
    frame = frame_under(MOUTH, PANEL)
    detector = Detector(PATCH_MM)
    known = detector.verdict(frame).best
    fitting = detector.fitting(known.candidate, frame)
    rng = np.random.default_rng(2)
    for scatter in (0.05, 0.25):
        whitening = fitting.errors(known, scatter)
        start = fitting.effect(known.parameters + 0.1 * rng.standard_normal(len(known.parameters)))
        begin = fitting.fit_at(start, fitting.about(start, whitening))
        assert fitting.best(start, whitening).cost <= begin.cost
