"""The density of loaded readings, against the joint distribution of both frames."""

import numpy as np
import pytest

from lampest import LoadedColumnsReadout, Panel, Readings, Scene
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import fitted
from lampest.inference.circuits.loaded_density import LoadedDensity
from lampest.inference.evidence import Field, FieldSizes
from lampest.inference.pair import FittedPair
from lampest.inference.unloaded_cells import film_scatter
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import channel_errors

SIDE = 5
COUNT = SIDE**2
PLACE = np.argwhere(np.ones((SIDE, SIDE), dtype=bool))


def pair_of_frames(noise: float) -> FittedPair:
    """Return the pair of an unloaded panel and of a frame in which one cell falls by a half."""
    readout = LoadedColumnsReadout(load_ohm=1000.0, drive_ohm=50.0, adc_bits=12, readings=1)
    scene = Scene(Panel(SIDE, SIDE), readout)
    rng = np.random.default_rng(8)
    cells = 3000 * np.exp(0.1 * rng.standard_normal((SIDE, SIDE)))
    loaded = cells.copy()
    loaded[2, 3] *= 0.5
    fits = []
    for of_frame in (cells, loaded):
        exact = readout.exact_reading(of_frame)
        sigma = np.full_like(exact, noise)
        reading = exact + noise * rng.standard_normal(exact.shape)
        fit = fitted(scene, Readings.of(scene, reading, sigma), patient=True)
        assert fit is not None
        fits.append(fit)
    return FittedPair((fits[0], fits[1]))


def cost(readings: Array, covariance: Array) -> float:
    """Return −2 ln N(y; 0, covariance), less the logarithm of 2π."""
    return float(
        readings @ np.linalg.solve(covariance, readings) + np.linalg.slogdet(covariance)[1]
    )


def trend() -> Array:
    """Return the polynomials of the place up to the second degree, (cells, 6)."""
    down, across = np.indices((SIDE, SIDE)).reshape(2, -1) / (SIDE - 1) - 0.5
    return np.stack([down**0, down, across, down**2, down * across, across**2], axis=1)


def joint_cost(pair: FittedPair, changed: Array) -> float:
    """Return −2 ln p(y_b, y_f)/p(y_b) of linear readings, with channels alike or different."""
    resting, loaded = pair.frames
    scatter = film_scatter(resting.scene, resting.readings, resting, 0.0)
    film = 1e4 * trend() @ trend().T + scatter**2 * np.eye(COUNT)
    late = changed + ASSUMED.creep**2 * np.eye(COUNT) + ASSUMED.common_change**2
    cells = np.block([[film, film], [film, film + late]])
    zero = np.zeros((COUNT, COUNT))
    slope = np.block([[resting.jacobian, zero], [zero, loaded.jacobian]])
    position = np.log(np.concatenate([fit.cells.ravel() for fit in pair.frames]) / 3000)
    channels = np.concatenate(
        [
            channel_errors(
                fit.scene.circuit,
                fit.cells,
                fit.readings.value,
                fit.scene,
                pair.channel_spread,
            ).reshape(2 * SIDE, COUNT)
            / fit.readings.known_sigma.ravel()
            for fit in pair.frames
        ],
        axis=1,
    ).T
    alike = slope @ cells @ slope.T + np.eye(2 * COUNT)
    costs = []
    for covariance in (alike, alike + channels @ channels.T):
        both = cost(slope @ position, covariance)
        costs.append(both - cost((slope @ position)[:COUNT], alike[:COUNT, :COUNT]))
    return -2 * float(np.logaddexp(-costs[0] / 2, -costs[1] / 2) - np.log(2))


@pytest.mark.parametrize("changed", ["one cell", "a field"])
def test_the_density_is_that_of_the_joint_distribution(changed: str) -> None:
    """Channels change what the unloaded readings say of the cells, too."""
    pair = pair_of_frames(2e-4)
    covariance = np.zeros((COUNT, COUNT))
    covariance[13, 13] = 1.0
    if changed == "a field":
        field = Field.of(PLACE)
        covariance = field.covariance(FieldSizes(deviation=0, cells=1, own=1))
    density = LoadedDensity(pair)
    near = density._linearised(covariance, density._at_rest.cells)
    computed = near.cost(near.through(covariance))
    assert computed == pytest.approx(joint_cost(pair, covariance), abs=1.0)


def test_changed_cells_are_selected_about_the_most_probable_ones() -> None:
    density = LoadedDensity(pair_of_frames(2e-3))
    changed = np.zeros(COUNT, dtype=bool)
    changed[13] = True
    cost, _ = density._with_cells(changed)
    for begin in (np.zeros_like(changed), ~changed):
        found, cells = density._with_cells(begin)
        assert found == pytest.approx(cost, abs=0.1)
        assert np.array_equal(cells, changed)


def test_a_field_has_its_deviation_distance_and_share() -> None:
    field = Field.of(PLACE)
    last = 9.0 * (0.9 + 0.1 * np.eye(COUNT))
    assert np.allclose(field.covariance(FieldSizes(2, 3, 2)), last)
    square = ((PLACE[:, None] - PLACE) ** 2).sum(axis=-1)
    first = 0.09 * ((1 - 1e-4) * np.exp(-square / 2) + 1e-4 * np.eye(COUNT))
    assert np.allclose(field.covariance(FieldSizes(0, 0, 0)), first)
