"""A converter that remembers: its definition channel by channel, its inverse, and what it does to estimates."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, Estimator, InputError, Misfit, Panel, Recording, Scene, Simulation, simulate
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import LoadedColumnsReadout, Readout, TwoPointReadout
from lampest.panel.readouts.readout import with_memory, without_memory
from lampest.recording.readings import AT_LEAST, AT_MOST, Readings

FRACTION = 0.029  # seen in a real 16 × 16 skin
READOUTS = {
    "two_point": TwoPointReadout(adc_bits=12),
    "rows": LoadedColumnsReadout(adc_bits=12, noise_lsb=1, load_ohm=3000.0, drive_ohm=100.0),
    "columns down": LoadedColumnsReadout(adc_bits=12, noise_lsb=1, load_ohm=3000.0, driven="columns", polarity="down"),
}
each_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)


def held(volt: Array, by_columns: bool, rounds: int = 3) -> Array:
    """What a capacitor holds after each channel of a frame that is scanned over and over, one after the other."""
    scan = volt.T if by_columns else volt
    kept, result = 0.0, np.empty_like(scan)
    for _ in range(rounds):
        for place, value in np.ndenumerate(scan):
            kept += (1 - FRACTION) * (value - kept)
            result[place] = kept
    return result.T if by_columns else result


def volts(readout: Readout, shape: tuple[int, ...]) -> Array:
    return np.asarray(np.random.default_rng(4).uniform(0.2, 0.8, size=shape) * readout.supply_volt)


@each_readout
def test_remembers_channel_by_channel(readout: Readout) -> None:
    volt = volts(readout, (5, 4))
    expected = held(volt, getattr(readout, "driven", "rows") == "columns")
    assert_allclose(with_memory(readout, FRACTION, volt), expected, rtol=1e-12)
    assert_allclose(with_memory(readout, FRACTION, volt[None])[0], expected, rtol=1e-12)


@each_readout
def test_is_taken_off_exactly_and_its_noise_is_told(readout: Readout) -> None:
    volt = volts(readout, (3, 5, 4))
    recorded = readout.recorded_from_volt(with_memory(readout, FRACTION, volt))
    freed, sigma = without_memory(readout, FRACTION, recorded, readout.sigma(recorded))
    assert_allclose(freed, readout.recorded_from_volt(volt), rtol=1e-11)
    rng, size = np.random.default_rng(8), readout.sigma_code() * readout.lsb_volt
    draws = []
    for _ in range(400):
        noisy = readout.recorded_from_volt(with_memory(readout, FRACTION, volt) + size * rng.normal(size=volt.shape))
        draws.append(without_memory(readout, FRACTION, noisy, readout.sigma(noisy))[0])
    assert_allclose(np.std(draws, axis=0), sigma, rtol=0.2)
    assert np.mean(np.std(draws, axis=0) / sigma) == pytest.approx(1, abs=0.02)


def test_after_a_channel_that_says_nothing_any_voltage_may_be_remembered() -> None:
    readout = READOUTS["rows"]
    volt = volts(readout, (4, 4))
    recorded = with_memory(readout, FRACTION, volt)
    recorded[1, 2] = np.nan
    freed, sigma = without_memory(readout, FRACTION, recorded, readout.sigma(recorded))
    known = np.isfinite(freed)
    assert np.argwhere(~known).tolist() == [[1, 2]]
    off = np.abs(freed - volt)
    assert 0 < off[1, 3] < 3 * sigma[1, 3] and sigma[1, 3] > 10 * sigma[0, 0]
    others = known & (np.arange(16).reshape(4, 4) != 7)
    assert np.all(off[others] < 1e-12)


def test_a_rail_stays_a_bound() -> None:
    readout = READOUTS["rows"]
    scene = Scene(Panel(3, 4), readout, converter_memory=FRACTION)
    volt = volts(readout, (3, 4))
    volt[1, 1], volt[2, 2] = readout.volt_from_code(np.array([0, 2**12 - 1]))
    side = Readings.of(scene, volt).side
    assert (side[1, 1], side[2, 2]) == (AT_MOST, AT_LEAST) and np.count_nonzero(side) == 2


def error(recording: Recording) -> tuple[Array, Array]:
    """(error of log r, the same in error bars)."""
    done = reconstruct(recording, Estimator((Misfit(weighting="noise"),), "reduced"))
    off = np.log(done.cell_resistance / recording.truth_cell_resistance[done.frame])
    return off, off / (done.cell_resistance_errors / done.cell_resistance)


@each_readout
def test_told_of_it_the_cells_are_found(readout: Readout) -> None:
    scene = Scene(Panel(8, 6), readout, systematic="none", converter_memory=FRACTION)
    recording = simulate(Simulation(1, 5, scene, frames=3))
    told, in_bars = error(recording)
    ignored, _ = error(replace(recording, scene=replace(scene, converter_memory=None)))
    assert np.median(np.abs(ignored)) > 3 * np.median(np.abs(told))
    assert 0.75 < np.sqrt(np.mean(in_bars**2)) < 1.3


def test_a_line_that_reads_nothing_shows_the_fraction() -> None:
    """Zero volt of their own: what the channels of an unconnected sensed line read is left of the one before."""
    readout = READOUTS["rows"]
    volt = volts(readout, (40, 6))
    volt[:, 3] = 0.0
    recorded = with_memory(readout, FRACTION, volt)
    assert np.sum(recorded[:, 3] * recorded[:, 2]) / np.sum(recorded[:, 2] ** 2) == pytest.approx(FRACTION, rel=1e-9)


def test_impossible_memories_are_refused() -> None:
    with pytest.raises(ValueError, match="must be zero or positive, and below 1"):
        Scene(Panel(3, 3), converter_memory=1.0)
    unknown = Scene(Panel(3, 3), converter_memory=0.1)
    with pytest.raises(InputError, match="needs a readout in the scene"):
        Readings.of(unknown, np.full((3, 3), 500.0))
    with pytest.raises(ValueError, match="needs a readout in the scene"):
        Simulation(1, 1, unknown)
