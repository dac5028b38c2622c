"""Error bars of panels whose noise hides how much films scatter."""

from dataclasses import replace

import pytest

import lampest
from lampest import Cells, LoadedColumnsReadout, Panel, Recording, Rod, Scene, Simulation
from lampest.estimate import stream
from tests.estimates import in_intervals

UNEVEN = 1.0  # scatter of the films
# Share of cells in their intervals: by the chosen weight alone, and with the scatter
SMOOTHED = 0.5  # measured 0.36
HELD = 0.8  # measured 0.85


@pytest.fixture(scope="module")
def noisy() -> Recording:
    """A rod on uneven films of little resistance, read behind resistors of 1000 ohm."""
    readout = LoadedColumnsReadout(
        adc_bits=8, readings=1, noise_lsb=1.0, load_ohm=1000.0, drive_ohm=1080.0
    )
    rod = Rod(centre_mm=(40, 40), diameter_mm=30, mass_g=500)
    cells = Cells(800.0, UNEVEN)
    scene = Scene(Panel(8, 10), readout)
    return lampest.simulate(Simulation(1, 3, scene, cells, frames=1, loads=(rod,)))


def test_intervals_hold_the_scatter_that_noise_hides(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert in_intervals(lampest.reconstruct(noisy)).mean() > HELD
    monkeypatch.setattr(stream, "hidden_scatter", lambda *_: 0.0)
    assert in_intervals(lampest.reconstruct(noisy)).mean() < SMOOTHED


def test_readings_that_show_the_cells_hide_no_scatter(noisy: Recording) -> None:
    resting = lampest.Readings.of(noisy.scene, noisy.recorded[noisy.role == 0]).mean()
    assert resting.sigma is not None
    assert stream.hidden_scatter(noisy.scene, resting, None) == pytest.approx(UNEVEN, rel=0.5)
    assert noisy.truth_cell_resistance is not None
    exact = noisy.scene.circuit.exact_reading(noisy.truth_cell_resistance[0])
    seen = replace(resting, value=exact, sigma=resting.sigma / 1000)
    assert stream.hidden_scatter(noisy.scene, seen, None) == 0.0


def test_cells_that_do_not_explain_the_readings_have_no_scatter(noisy: Recording) -> None:
    resting = lampest.Readings.of(noisy.scene, noisy.recorded[noisy.role == 0]).mean()
    assert resting.sigma is not None
    contradicted = replace(resting, sigma=resting.sigma / 1000)
    assert stream.hidden_scatter(noisy.scene, contradicted, None) == 0.0


def test_stated_weights_are_priors_that_no_scatter_widens(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=100.0)]
    stated = lampest.reconstruct(noisy, terms).cell_resistance_errors
    monkeypatch.setattr(stream, "hidden_scatter", lambda *_: 0.0)
    assert stated == pytest.approx(lampest.reconstruct(noisy, terms).cell_resistance_errors)
