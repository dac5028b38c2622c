"""How large a load may be, against a random walk through its posterior."""

import numpy as np
import pytest
from laws.recognised import PATCH_MM, frame_under, verdict_on

from lampest import Array, Panel, Rod
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fitting, along_diameter
from lampest.loads.recognition.observation import Whitening

PANEL = Panel(6, 6)
STEPS, SCALES = 40000, (0.1, 0.4, 1.0)


def walked(fitting: Fitting, whitening: Whitening, start: Array, root: Array) -> Array:
    """ln d along a random walk through e^−cost, (samples)."""
    rng, found, mean, sd = np.random.default_rng(5), [], fitting.candidate.mean(PANEL), fitting.candidate.sd(PANEL)

    def cost_at(parameters: Array) -> float:
        return float(fitting.about(parameters, whitening).exact + np.sum(((parameters - mean) / sd) ** 2) / 2)

    here, cost = start, cost_at(start)
    for _ in range(STEPS):
        step = here + root @ rng.standard_normal(len(here)) * rng.choice(SCALES)
        there = cost_at(step)
        if np.log(rng.random()) < cost - there:
            here, cost = step, there
        found.append(here[2])
    return np.array(found[STEPS // 5 :])


@pytest.mark.slow
def test_a_diameter_that_patches_hardly_see_is_as_wide_as_its_posterior() -> None:
    frame, detector = frame_under(Rod(centre_mm=(20.0, 20.0), diameter_mm=10.0, mass_g=60), PANEL), Detector(PANEL, 6.0)
    rod = next(fit for fit in detector.verdict(frame).loads if fit.candidate is Rod.candidate)
    fitting = Fitting(PANEL, PATCH_MM, rod.candidate, frame)
    whitening = Whitening.of(frame, detector.explained(frame, rod), rod.scatter)
    local = fitting.best(rod.parameters, whitening)
    wide = along_diameter(fitting, local, whitening)
    root = np.linalg.cholesky(wide.covariance) / len(wide.parameters) ** 0.5
    samples = walked(fitting, whitening, rod.parameters, root)
    own = np.sqrt(wide.covariance[2, 2] - rod.candidate.blind(wide.parameters)[2] ** 2)
    assert own == pytest.approx(np.sqrt(np.mean((samples - wide.parameters[2]) ** 2)), rel=0.35)
    assert own > 2 * local.covariance[2, 2] ** 0.5, "curvature alone would have done"


@pytest.mark.parametrize(
    ("diameter_mm", "centre_mm"), [(10.0, (20.0, 30.0)), (12.0, (25.0, 20.0)), (17.5, (25.0, 25.0))]
)
def test_small_rods_are_as_large_as_they_are_said_to_be(diameter_mm: float, centre_mm: tuple[float, float]) -> None:
    best = verdict_on(Rod(centre_mm=centre_mm, diameter_mm=diameter_mm, mass_g=60), panel=PANEL).best
    value, slopes = best.candidate.report(best.parameters)["diameter_mm"]
    error = np.sqrt(slopes @ best.covariance @ slopes)
    assert error < 9.0
    assert abs(value - diameter_mm) < 2 * error
