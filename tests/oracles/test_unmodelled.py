"""Every effect that a simulation keeps from the estimator does what it says, and is absent by default."""

from dataclasses import replace

import numpy as np
import pytest

from lampest import UNLOADED, Array, Panel, Recording, Rod, Scene, Simulation, Unmodelled, simulate
from lampest.panel.readouts import GroundedReadout, TwoPointReadout

FINE = TwoPointReadout(adc_bits=24, readings=1, noise_lsb=0.0)
LSB = 5 / 2**24
ROD = Rod(kind="rod", centre_mm=(45, 45), diameter_mm=30, mass_g=300)


def recorded(readout: TwoPointReadout | GroundedReadout = FINE, seed: int = 5, **effects: float) -> Recording:
    """Six unloaded and six loaded frames of a 10 × 10 panel."""
    scene = Scene(Panel(10, 10), readout)
    return simulate(
        Simulation(1, seed, scene, baseline_frames=6, frames=6, loads=(ROD,), unmodelled=Unmodelled(**effects))
    )


def volt(recording: Recording) -> Array:
    """What the converter saw, written out for the divider across the reference."""
    return 5 * 1000 / (1000 + recording.recorded)


def test_absent_effects_change_nothing() -> None:
    assert np.array_equal(recorded().recorded, recorded(supply_ripple_hz=50.0).recorded)


def test_noise_factor_multiplies_the_scatter() -> None:
    coarse = TwoPointReadout(adc_bits=16, readings=1, noise_lsb=5.0)
    clean = volt(recorded(replace(coarse, noise_lsb=0.0)))
    once, thrice = ((volt(recorded(coarse, noise_factor=factor)) - clean).std() for factor in (1.0, 3.0))
    assert once == pytest.approx(5 * 5 / 2**16, rel=0.1)
    assert thrice == pytest.approx(3 * once, rel=0.1)


def test_ripple_is_a_sine_of_its_amplitude_and_frequency_over_the_scan() -> None:
    wave = (volt(recorded(supply_ripple_lsb=500, supply_ripple_hz=10)) - volt(recorded())).reshape(12, 100) / LSB
    spectrum = np.abs(np.fft.rfft(wave, axis=1)) / 50
    assert np.all(np.argmax(spectrum, axis=1) == 10)  # a frame takes a second: ten periods in it, one in each row
    assert spectrum[:, 10] == pytest.approx(500, rel=0.01)
    assert not np.allclose(wave[0], wave[1], atol=50)  # another phase in each frame


def test_ripple_follows_the_order_of_the_scan() -> None:
    by_columns = GroundedReadout(driven="columns", adc_bits=24, readings=1, noise_lsb=0.0)
    wave = recorded(by_columns, supply_ripple_lsb=500, supply_ripple_hz=1).recorded - recorded(by_columns).recorded
    assert np.abs(np.diff(wave[0], axis=0)).max() < 0.2 * np.abs(np.diff(wave[0], axis=1)).max()


def test_gain_is_one_factor_a_frame() -> None:
    ratio = volt(recorded(gain_spread=0.01)) / volt(recorded())
    assert np.ptp(ratio, axis=(1, 2)).max() < 1e-5
    assert 0.004 < ratio[:, 0, 0].std() < 0.02


def test_inl_is_a_curve_of_the_voltage_alone_and_as_large_as_told() -> None:
    rough, straight = volt(recorded(inl_lsb=2e4)), volt(recorded())
    order = np.argsort(straight, axis=None)
    error = (rough - straight).ravel()[order] / LSB
    assert 0.1 * 2e4 < np.abs(error).max() <= 1.001 * 2e4
    steps = np.diff(straight.ravel()[order])
    assert np.all(np.abs(np.diff(error)) <= 2e4 * 15 * steps + 2)  # smooth: at most 4π and some, over the range


def test_wire_is_that_of_a_scene_that_tells_it() -> None:
    from lampest.panel.readouts.wiring import Lines

    told = simulate(
        Simulation(1, 5, Scene(Panel(10, 10), FINE, lines=Lines(0.5, 0.5)), baseline_frames=6, frames=6, loads=(ROD,))
    )
    assert np.allclose(recorded(wire_ohm_per_cell=0.5).recorded, told.recorded, rtol=1e-9)
    assert recorded(wire_ohm_per_cell=0.5).scene.lines is None


def test_reading_errors_are_the_same_in_all_frames() -> None:
    ratio = recorded(reading_error=0.1).recorded / recorded().recorded
    assert np.ptp(ratio, axis=0).max() < 1e-3
    assert np.log(ratio[0]).std() == pytest.approx(0.1, rel=0.3)


def test_films_answer_less_and_each_otherwise() -> None:
    def answer(recording: Recording) -> Array:
        truth = recording.truth_cell_resistance
        return np.log(truth[-1] / truth[0])

    plain = answer(recorded())
    touched = np.abs(plain) > 0.01
    assert answer(recorded(response_loss=0.2))[touched] == pytest.approx(0.8 * plain[touched])
    spread = np.log(answer(recorded(response_spread=0.2))[touched] / plain[touched])
    assert 0.05 < spread.std() < 0.4
    assert np.all(answer(recorded(response_spread=0.2))[~touched] == pytest.approx(plain[~touched], abs=0.01))


def test_a_travelling_load_is_elsewhere_when_later_lines_are_read() -> None:
    """Each row of a frame is that of an unmoved load at the place where the load is when the row is read."""
    frame, row, speed = 8, 6, 3.0
    time = (frame - 6) + (row + 0.5) / 10 - 0.5
    assert abs(speed * time) < 10  # not yet turned
    scene = Scene(Panel(10, 10), FINE)
    there = replace(ROD, centre_mm=(45 + speed * time, 45))
    still = simulate(Simulation(1, 5, scene, baseline_frames=6, frames=6, loads=(there,)))
    moving = recorded(load_speed_mm_s=speed)
    assert moving.recorded[frame, row] == pytest.approx(still.recorded[frame, row], rel=1e-9)
    assert not np.allclose(moving.recorded[frame, 2], still.recorded[frame, 2], rtol=1e-4)
    assert np.array_equal(moving.recorded[moving.role == UNLOADED], recorded().recorded[moving.role == UNLOADED])


@pytest.mark.parametrize("effect", ["supply_ripple_lsb", "gain_spread", "inl_lsb"])
def test_effects_of_a_converter_need_one(effect: str) -> None:
    with pytest.raises(ValueError, match=f"{effect} need a readout"):
        Simulation(1, 5, Scene(Panel(4, 4)), unmodelled=Unmodelled(**{effect: 1.0}))


def test_a_leak_joins_every_line_with_the_next_from_its_time_on() -> None:
    plain, wet = recorded(), recorded(leak_ohm=5e3, begins_s=8.0)
    assert np.array_equal(wet.recorded[:8], plain.recorded[:8])
    truth, matrix = wet.truth_cell_resistance, np.zeros((20, 20))
    matrix[:10, 10:] = -1 / truth[9]
    matrix[[*range(9), *range(10, 19)], [*range(1, 10), *range(11, 20)]] = -1 / 5e3
    matrix += matrix.T
    inverse = np.linalg.pinv(matrix - np.diag(matrix.sum(axis=1)))
    own = np.diag(inverse)
    expected = own[:10, None] + own[None, 10:] - 2 * inverse[:10, 10:]
    np.testing.assert_allclose(wet.recorded[9], expected, rtol=1e-4)


def test_a_contact_adds_to_one_row_from_its_time_on() -> None:
    more = recorded(contact_ohm=200.0, begins_s=8.0).recorded - recorded().recorded
    assert not more[:8].any()
    (row,) = np.flatnonzero(more[8:].any(axis=(0, 2)))
    assert more[8:, row] == pytest.approx(200, rel=1e-3)


def test_a_stage_saturates_and_all_cells_drift_alike() -> None:
    assert volt(recorded(saturation=0.6)).max() == pytest.approx(3.0, abs=1e-5)
    truth = [one.truth_cell_resistance for one in (recorded(), recorded(common_drift_per_minute=0.6))]
    drift = np.log(truth[1] / truth[0])
    assert drift == pytest.approx(np.broadcast_to(0.01 * np.arange(12)[:, None, None], drift.shape))
