"""Statements of the pages about readings: bounds, dependence on cells, growth of the noise."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

import lampest
from lampest import Array, LoadedColumnsReadout, Panel, Scene, TwoPointReadout, two_point_resistance
from tests.estimates import recording_of

SHAPES = [(1, 5), (4, 4), (3, 7), (10, 10)]
CELLS = 3000.0  # usual resistance, ohm


def random_cells(shape: tuple[int, int], seed: int = 1, spread: float = 1.0) -> Array:
    """Cells (rows, columns), ohm."""
    return CELLS * np.exp(spread * np.random.default_rng(seed).standard_normal(shape))


def relative_slopes(cells: Array) -> Array:
    """∂ ln R/∂ ln r of two-point readings, (readings, cells)."""
    readout = TwoPointReadout()
    network = readout.network(cells, readout.ties(cells), None)
    return np.asarray(network.sensitivity() / network.reading().reshape(-1, 1))


@promise("theory/circuit: A reading never falls when a cell's resistance rises (Rayleigh).")
@pytest.mark.parametrize("shape", SHAPES)
def test_no_two_point_reading_falls_when_a_cell_rises(shape: tuple[int, int]) -> None:
    """Whether by little, by a factor of a thousand, or to an open cell."""
    cells = random_cells(shape)
    readings = two_point_resistance(cells)
    for cell in range(cells.size):
        for factor in (1 + 1e-6, 1e3, np.inf if min(shape) > 1 else 1e9):
            risen = cells.copy()
            risen.flat[cell] *= factor
            assert np.all(two_point_resistance(risen) >= readings * (1 - 1e-12))


@promise("theory/circuit: A reading is never larger than its own cell: R ≤ r.")
@pytest.mark.parametrize("shape", SHAPES)
def test_a_two_point_reading_is_at_most_its_own_cell(shape: tuple[int, int]) -> None:
    for spread in (0.0, 1.0, 4.0):
        cells = random_cells(shape, spread=spread)
        readings = two_point_resistance(cells)
        assert np.all(readings <= cells * (1 + 1e-12))
        # ∂R/∂r, which the page bounds by 0 and 1
        by_ohm = relative_slopes(cells) * readings.reshape(-1, 1) / cells.ravel()
        assert by_ohm.min() >= -1e-9 and by_ohm.max() <= 1 + 1e-9


def test_every_two_point_reading_depends_on_every_cell() -> None:
    assert relative_slopes(random_cells((4, 6), spread=0.3)).min() > 1e-4


@promise("README: Crosstalk amplifies noise by up to (M + N − 1)/2 on a uniform panel")
@pytest.mark.parametrize("shape", SHAPES[1:])
def test_errors_of_a_uniform_panel_grow_by_at_most_half_the_number_of_lines(
    shape: tuple[int, int],
) -> None:
    """Errors without a common part of a row or column grow by (M + N − 1)/2, others by less."""
    inverse = np.linalg.inv(relative_slopes(np.full(shape, CELLS)))
    gains = np.linalg.svd(inverse, compute_uv=False)
    rows, columns = shape
    assert_allclose(gains[: (rows - 1) * (columns - 1)], (rows + columns - 1) / 2, rtol=1e-9)
    independent = np.linalg.norm(inverse, axis=1)
    assert shape != (10, 10) or np.allclose(independent, 8.6, atol=0.05)


def test_an_open_cell_would_change_no_reading_by_more_than_its_noise_if_it_were_larger() -> None:
    rng = np.random.default_rng(14)
    readout = TwoPointReadout(adc_bits=10, noise_lsb=0.7)
    cells = random_cells((5, 7), seed=3, spread=0.3)
    cells[1, 2] = cells[3, 4] = 1e9
    exact = two_point_resistance(cells)
    recorded = exact + readout.sigma(exact) * rng.standard_normal(exact.shape)
    estimate = lampest.reconstruct(
        recording_of(Scene(Panel(5, 7), readout), recorded[None]), [lampest.Misfit()]
    )
    estimated = estimate.cell_resistance[0]
    opened = estimate.open_cell[0].astype(bool)
    assert opened[3, 4] and not opened[cells < 1e9].any()
    larger = np.where(opened, np.inf, estimated)
    change = np.abs(two_point_resistance(larger) - two_point_resistance(estimated))
    assert np.all(change <= readout.sigma(exact))


def test_the_misfit_alone_has_no_bias_and_a_penalty_has() -> None:
    rng = np.random.default_rng(5)
    readout = TwoPointReadout(adc_bits=16, noise_lsb=1.0)
    cells = random_cells((4, 4), spread=0.5)
    exact = two_point_resistance(np.repeat(cells[None], 60, axis=0))
    recorded = exact + readout.sigma(exact) * rng.standard_normal(exact.shape)
    recording = recording_of(Scene(Panel(4, 4), readout, outliers="keep"), recorded)
    scores = {}
    for name, terms in {
        "plain": [lampest.Misfit(weighting="noise")],
        "smooth": [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=3e4)],
    }.items():
        estimate = lampest.reconstruct(recording, terms, formulation="reduced", error_bars=False)
        errors = np.log(estimate.cell_resistance / cells)
        scores[name] = errors.mean(axis=0) / (errors.std(axis=0) / np.sqrt(len(errors)))
    assert np.sqrt(np.mean(scores["plain"] ** 2)) < 2
    assert np.sqrt(np.mean(scores["smooth"] ** 2)) > 10


@promise(
    "README: A pull-up of 20 kΩ that the scene calls 35 kΩ makes every cell too large by about "
    "1.75, and no warning appears."
)
@pytest.mark.slow
def test_a_wrong_pull_up_scales_cells_without_a_warning_and_leaves_changes() -> None:
    """20 kilo-ohm that the scene calls 35, as in the README: cells are 1.75 times too large."""
    readout = LoadedColumnsReadout(
        supply_volt=5.0, load_ohm=20e3, drive_ohm=30.0, polarity="down", adc_bits=12, noise_lsb=1.0
    )
    cells = np.repeat(10 * random_cells((5, 6), spread=0.15)[None], 8, axis=0)
    cells[5:, 1:3, 3:5] *= 0.5
    exact = readout.exact_reading(cells)
    scene = Scene(Panel(5, 6), readout)
    recorded = readout.to_recorded(exact, scene)
    recorded += readout.sigma(recorded) * np.random.default_rng(2).standard_normal(exact.shape)
    wrong = replace(scene, readout=replace(readout, load_ohm=35e3))
    terms = [lampest.Misfit(weighting="noise")]
    right, scaled = (
        lampest.reconstruct(recording_of(each, recorded, 5), terms, formulation="reduced")
        for each in (scene, wrong)
    )
    factor = scaled.cell_resistance / right.cell_resistance
    assert np.median(factor) == pytest.approx(1.75, abs=0.05)
    assert scaled.checks == right.checks
    assert scaled.model_check.mark == right.model_check.mark == "yes"
    difference = scaled.relative_change - right.relative_change
    assert np.median(np.abs(difference)) < 1 and np.abs(right.relative_change).max() > 40
