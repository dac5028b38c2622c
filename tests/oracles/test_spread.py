"""How large a load may be, against a random walk through its posterior."""

import numpy as np
import pytest
from laws.recognised import PATCH_MM, frame_under, verdict_on

from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fitting, along_diameter
from lampest.loads.recognition.observation import Whitening
from lampest.loads.shapes import Rod
from lampest.panel.panel import Array, Panel

PANEL = Panel(6, 6)
STEPS, SCALES = 10000, (0.1, 0.4, 1.0)


def walked(fitting: Fitting, start: Array, root: Array) -> Array:
    """ln d along a random walk through e^−cost, (samples)."""
    rng, found = np.random.default_rng(5), []
    here, cost = start, fitting.cost(start)
    for _ in range(STEPS):
        step = here + root @ rng.standard_normal(len(here)) * rng.choice(SCALES)
        there = fitting.cost(step)
        if np.log(rng.random()) < cost - there:
            here, cost = step, there
        found.append(here[2])
    return np.array(found[STEPS // 5 :])


@pytest.mark.slow
def test_a_diameter_that_patches_hardly_see_is_as_wide_as_its_posterior() -> None:
    frame = frame_under(Rod(centre_mm=(20.0, 20.0), diameter_mm=10.0, mass_g=60), PANEL)
    verdict = Detector(PANEL, PATCH_MM).verdict(frame)
    rod = next(fit for fit in verdict.loads if fit.candidate is Rod.candidate)
    fitting = Fitting(PANEL, PATCH_MM, rod.candidate, frame, Whitening.of(frame, rod.explained, rod.scatter))
    local = fitting.best(rod.parameters)
    wide = along_diameter(fitting, local)
    samples = walked(fitting, rod.parameters, np.linalg.cholesky(wide.covariance) / len(wide.parameters) ** 0.5)
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
