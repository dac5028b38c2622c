"""Codes of the converter: steps, ends, curves, names, and versions of files."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import h5py
import numpy as np
import pytest
from promises import promise

import lampest
from lampest import (
    Characteristic,
    GroundedReadout,
    InputError,
    LoadedColumnsReadout,
    Panel,
    Recording,
    Scene,
    Simulation,
    TwoPointReadout,
    VirtualGroundReadout,
)
from lampest.audit.advice import Audit
from lampest.files.levels import TWO_SIDED
from lampest.inference.noise import NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import resolved_scene
from lampest.panel.readouts.converter import KNOWN_CONVERTERS, Known
from lampest.panel.scene import read_scene, scene_text

BITS = 10
STEP = 5 / 2**BITS
DEAD_ZONE = Characteristic(zero_volt=0.14, full_volt=3.12)
FALLING = Characteristic(zero_volt=2.5, full_volt=-2.5)
CURVE = Characteristic(curve=((0.1, 0.0), (1.0, 300.0), (3.2, 1024.0)))


def readout(**keys: object) -> GroundedReadout:
    return GroundedReadout(
        supply_volt=5.0, adc_bits=BITS, readings=1, noise_lsb=0.5, load_ohm=1000.0, **keys
    )


def test_transitions_are_those_of_the_data_sheet() -> None:
    """The first one is half a step above zero, the last one 1.5 steps below full scale."""
    converter = readout()
    below_and_above = np.array([0.499, 0.501, 2**BITS - 1.501, 2**BITS - 1.499]) * STEP
    assert converter.code_from_volt(below_and_above).tolist() == [0, 1, 2**BITS - 2, 2**BITS - 1]
    assert converter.volt_from_code(np.array([0.0, 512.0])).tolist() == [0.0, 2.5]


@promise("howto/error_bars: A mean of frames keeps the rounding of a converter without noise")
@pytest.mark.parametrize("noise_lsb", [0.02, None])
def test_a_mean_of_frames_keeps_the_rounding_that_noise_does_not_dither(
    noise_lsb: float | None,
) -> None:
    """As independent errors of six frames, 54 % of the cells are within their intervals."""
    within = []
    for seed in range(3):
        board = TwoPointReadout(adc_bits=8, readings=4, noise_lsb=0.02)
        quiet = Simulation(1, seed, Scene(Panel(8, 8), board), baseline_frames=6, frames=1)
        recording = lampest.simulate(quiet)
        scene = replace(recording.scene, readout=replace(board, noise_lsb=noise_lsb))
        estimate = lampest.reconstruct(replace(recording, scene=scene), [lampest.Misfit()])
        assert recording.truth_cell_resistance is not None
        difference = estimate.baseline_resistance - recording.truth_cell_resistance[0]
        within.append(np.abs(difference) < TWO_SIDED * estimate.baseline_resistance_errors)
    assert np.mean(within) > 0.92


def test_means_of_parts_have_the_constant_part_of_sigma_once() -> None:
    board = TwoPointReadout(adc_bits=8, readings=4, noise_lsb=0.1)
    readings = lampest.simulate(
        Simulation(1, 1, Scene(Panel(4, 4), board), baseline_frames=6, frames=1)
    ).readings()[:6]
    parts = [readings[part].mean().beside(2) for part in (slice(3), slice(3, 6))]
    of_both = np.hypot(*(part.known_sigma for part in parts)) / 2
    np.testing.assert_allclose(of_both, readings.mean().known_sigma, rtol=0.01)


@promise("howto/readouts: Code c stands for c steps")
def test_codes_of_a_rounding_converter_leave_cells_unbiased() -> None:
    rng = np.random.default_rng(3)
    cells = 3000 * np.exp(0.3 * rng.standard_normal((1, 8, 8)))
    circuit = readout()
    scene = Scene(Panel(8, 8), circuit)
    volt = circuit.exact_reading(cells)
    codes = np.rint(volt / STEP + 0.5 * rng.standard_normal((400, 8, 8))).mean(0, keepdims=True)
    recording = Recording.from_array(codes, unit="code", scene=scene, baseline=0)
    estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    assert abs(np.median(estimate.cell_resistance / cells - 1)) < 1e-3  # half a step: 4e-3


@pytest.mark.parametrize("characteristic", [DEAD_ZONE, FALLING, CURVE])
def test_voltages_return_from_their_codes(characteristic: Characteristic) -> None:
    converter = readout(converter=characteristic)
    codes = np.arange(1, 2**BITS - 1)
    assert np.array_equal(converter.code_from_volt(converter.volt_from_code(codes)), codes)
    least, most = converter.rails()
    inside = np.sort(converter.volt_from_code(np.array([1.0, 2**BITS - 2.0])))
    assert least < inside[0] < inside[1] < most


def test_signed_codes_run_from_below_zero() -> None:
    """An ADS1115 at ±4.096 V has 16 bits and 0.125 mV a step."""
    signed = Characteristic(signed=True, full_volt=4.096)
    converter = GroundedReadout(supply_volt=3.3, adc_bits=16, readings=1, converter=signed)
    assert converter.codes == (-(2**15), 2**15 - 1)
    assert converter.lsb_volt == pytest.approx(125e-6)
    assert converter.range_volt == (-4.096, 4.096)
    assert converter.volt_from_code(np.array([-4.0, 8.0])) == pytest.approx([-5e-4, 1e-3])
    assert converter.code_from_volt(np.array([-9.0, -5e-4, 9.0])).tolist() == [
        -(2**15),
        -4,
        2**15 - 1,
    ]


def test_codes_of_a_dead_zone_are_bounds() -> None:
    scene = Scene(Panel(2, 2), readout(converter=DEAD_ZONE))
    codes = np.array([[[0.0, 100.0], [300.0, 1023.0]]])
    recording = Recording.from_array(codes, unit="code", scene=scene, baseline=0)
    readings = lampest.recording.readings.Readings.of(scene, recording.recorded)
    assert np.array_equal(readings.side != 0, [[[True, False], [False, True]]])


def test_noise_follows_the_steps_of_a_curve() -> None:
    converter = readout(converter=CURVE)
    fine, coarse = converter.sigma(np.array([0.5, 2.0]))
    assert coarse / fine == pytest.approx((2.2 / 724) / (0.9 / 300))


def test_known_converters_have_names() -> None:
    assert readout(converter="esp32").volt_from_code(np.array(0.0)) == pytest.approx(0.14)
    assert readout(converter="avr").range_volt == (0.0, 5.0)
    inverting = readout(converter="inverting amplifier")
    assert inverting.volt_from_code(np.array([0.0, 512.0])) == pytest.approx([5.0, 2.5])
    assert inverting.code_sign < 0


def test_all_names_of_converters_have_numbers() -> None:
    assert set(KNOWN_CONVERTERS) == set(get_args(Known))


# Volt a step, by the tables of the data sheets: TI SBAS444E 7-1 and SBAS457F, SBAS473E 7.3.3
STEPS_OF_CHIPS = [
    ("ADS1115", None, 62.5e-6),
    ("ADS1115", 6.144, 187.5e-6),
    ("ADS1118", 0.256, 7.8125e-6),
    ("ADS1015", 4.096, 2e-3),
    ("ADS1015", None, 1e-3),
    ("MCP3208", None, 3.3 / 4096),
    ("MCP3008", 2.5, 2.5 / 1024),
    ("RP2040", None, 3.3 / 4096),
]


@promise("howto/readouts: A name states bits, sign, range and noise by the chip's data sheet")
@pytest.mark.parametrize(("name", "full_volt", "step"), STEPS_OF_CHIPS)
def test_a_name_states_the_steps_of_a_chip(
    name: Known, full_volt: float | None, step: float
) -> None:
    named = Characteristic(name=name, full_volt=full_volt) if full_volt else name
    board = GroundedReadout(supply_volt=3.3, converter=named)
    assert board.lsb_volt == pytest.approx(step)
    assert board.volt_from_code(np.array(100.0)) == pytest.approx(100 * step)
    lowest = -(2 ** (board.adc_bits - 1)) if name.startswith("ADS") else 0
    assert board.codes == (lowest, lowest + 2**board.adc_bits - 1)


def test_the_noise_of_a_chip_is_assumed_until_frames_show_it() -> None:
    board = GroundedReadout(supply_volt=3.3, converter="ADS1115")
    assert board.assumed_noise == 1.0 and board.noise_lsb != board.assumed_noise
    assert GroundedReadout(converter="MCP3008").assumed_noise == GroundedReadout().assumed_noise
    assert replace(board, noise_lsb=0.3).assumed_noise == 0.3


NAMED_SCENE = """\
panel: {{rows: 4, columns: 4}}
readout:
  kind: grounded
  supply_volt: 3.3
  load_ohm: 10000
  converter: {converter}
"""


def test_a_scene_with_a_name_gives_the_cells_of_its_codes(tmp_path: Path) -> None:
    """Codes of 125 µV each, which are the steps of an ADS1115 at ±4.096 V."""
    path = tmp_path / "scene.yaml"
    path.write_text(NAMED_SCENE.format(converter="{name: ADS1115, full_volt: 4.096}"))
    scene = read_scene(path)
    written = tmp_path / "written.yaml"
    written.write_text(scene_text(scene))
    assert read_scene(written) == scene
    cells = np.geomspace(2000.0, 20_000.0, 16).reshape(4, 4)
    codes = np.rint(scene.circuit.exact_reading(cells) / 125e-6)
    frames = np.repeat([codes], 8, axis=0)
    recording = Recording.from_array(frames, unit="code", scene=scene, baseline=0)
    found = lampest.reconstruct(recording, [lampest.Misfit()])
    np.testing.assert_allclose(found.cell_resistance[-1], cells, rtol=2e-3)


def test_lists_stand_beside_a_name(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    groups = "  groups: [[0, 1], [2, null, 3]]\n  noise_lsb: [1, 2, 1, 2]\n"
    text = NAMED_SCENE.format(converter="ADS1015") + groups
    path.write_text(text.replace("grounded", "loaded_columns"))
    scene = read_scene(path)
    assert scene.circuit.adc_bits == 12
    assert lampest.Scene(Panel(4, 4), scene.readout).circuit == scene.circuit


@promise("howto/readouts: Without `full_volt` it is the chip's range after power-up")
def test_a_range_that_is_not_stated_is_told(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(NAMED_SCENE.format(converter="ADS1115"))
    assert "converter.full_volt: 2.048" in read_scene(path).assumed_text
    assert "adc_bits" not in read_scene(path).assumed_text
    path.write_text(NAMED_SCENE.format(converter="{name: ADS1115, full_volt: 4.096}"))
    assert "full_volt" not in read_scene(path).assumed_text


def test_readings_at_the_end_of_a_chips_range_name_it() -> None:
    """Rows of 3.3 V saturate the ±2.048 V of an ADS1115 after power-up."""
    scene = Scene(Panel(4, 4), GroundedReadout(supply_volt=3.3, converter="ADS1115"))
    codes = np.full((2, 4, 4), 2.0**15 - 1)
    with pytest.raises(InputError, match=r"is readout\.converter, 2\.048 V"):
        Recording.from_array(codes, unit="code", scene=scene, baseline=0)


def test_first_recordings_keep_the_middle_of_their_codes(tmp_path: Path) -> None:
    """Files without an offset of codes hold code c as c + ½ steps, and rails at whole steps."""
    codes = np.array([[[0.5, 100.5], [300.5, 1022.5]]])
    path = tmp_path / "old.h5"
    Recording.from_array(codes * STEP, unit="volt", scene=Scene(Panel(2, 2), readout())).save(path)
    with h5py.File(path, "a") as file:
        assert file.attrs["lampest_format"] == np.bytes_("recording/1")
        del file.attrs["code_offset_steps"]
    circuit = Recording.load(path).scene.circuit
    assert circuit.code_from_volt(codes * STEP).tolist() == [[[0, 100], [300, 1022]]]
    assert circuit.rails() == pytest.approx((STEP, 1023 * STEP))
    Recording.load(path).save(tmp_path / "new.h5")
    assert Recording.load(tmp_path / "new.h5").scene.circuit == circuit


@pytest.mark.slow
def test_the_zero_of_a_converter_follows_from_open_cells() -> None:
    """Codes of open cells stand 3.4 steps above 0, where the loads end."""
    offset = 3.4
    rng = np.random.default_rng(6)
    circuit = readout(converter=Characteristic(zero_volt="estimated"))
    resting = np.full((6, 6), 1e9)
    loaded = resting.copy()
    loaded[2:4, 2:4] = 2000.0
    volt = np.stack([circuit.exact_reading(cells) for cells in [resting] * 5 + [loaded] * 3])
    codes = np.rint(volt / STEP + offset + 0.5 * rng.standard_normal(volt.shape))
    scene = Scene(Panel(6, 6), circuit)
    recording = Recording.from_array(codes, unit="code", scene=scene, baseline=5)
    noise = Prepared(recording).noise
    zero, deviation = noise.estimated["readout.converter.zero_volt"]
    assert zero == pytest.approx(-offset * STEP, abs=4 * deviation + 0.1 * STEP)
    numbers = resolved_scene(scene, noise)
    assert numbers.readout is not None and numbers.readout.zero_volt == pytest.approx(zero)
    estimate = lampest.reconstruct(recording, [lampest.Misfit(weighting="noise")])
    assert estimate.cell_resistance[-1, 2:4, 2:4] == pytest.approx(2000.0, rel=0.02)


ESP32 = {"supply_volt": 3.3, "adc_bits": 12, "readings": 1}


def panels() -> tuple[lampest.Array, lampest.Array]:
    """Cells of an unloaded and of a pressed panel."""
    resting = 5000 * np.exp(0.2 * np.random.default_rng(1).standard_normal((6, 6)))
    pressed = resting.copy()
    pressed[1:3, 2:4] = 1500.0
    return resting, pressed


def audit(built: lampest.Readout, stated: lampest.Readout, frames: int = 6) -> Audit:
    """Audit of a press, recorded by one circuit and described as another one."""
    rng = np.random.default_rng(1)
    resting, pressed = panels()
    exact = np.repeat([built.exact_reading(cells) for cells in (resting, pressed)], frames, axis=0)
    volt = built.to_recorded(exact, Scene(Panel(6, 6), built))
    codes = built.code_from_volt(volt + 0.5 * built.lsb_volt * rng.standard_normal(volt.shape))
    scene = Scene(Panel(6, 6), stated)
    recording = Recording.from_array(codes * 1.0, unit="code", scene=scene, baseline=frames)
    return Audit(Prepared(recording))


@pytest.mark.slow
@pytest.mark.parametrize(
    "stated", [LoadedColumnsReadout(load_ohm=5e3, **ESP32), GroundedReadout(**ESP32)]
)
def test_a_dead_zone_and_a_full_scale_of_their_own_are_named(stated: lampest.Readout) -> None:
    audited = audit(replace(stated, converter=DEAD_ZONE), stated)
    assert audited.verdict.mark == "no"
    [finding] = [finding for finding in audited.advice if finding.room == "circuit"]
    assert finding.line == "readout: {converter: esp32}"
    assert audit(stated, stated).prepared.check.mark == "yes"


@pytest.mark.slow
def test_a_dead_zone_below_which_most_readings_are_zero_is_asked_for() -> None:
    stated = GroundedReadout(load_ohm=150.0, **ESP32)
    question = "does the converter read nothing below some voltage"
    hidden = audit(replace(stated, converter=DEAD_ZONE), stated).verdict
    assert hidden.mark == "doubtful" and question in hidden.sentence
    assert question not in audit(stated, stated).verdict.sentence


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "bits"), [(50.0, 12), (0.0, 10)])
def test_codes_that_fall_behind_an_inverting_amplifier_are_named(drive: float, bits: int) -> None:
    """Where no drive resistance couples cells, any codes have cells: these differ too much."""
    stated = VirtualGroundReadout(feedback_ohm=1e3, drive_ohm=drive, adc_bits=bits, readings=1)
    falling = Characteristic(zero_volt=stated.full_scale_volt, full_volt=0.0)
    audited = audit(replace(stated, converter=falling), stated)
    assert audited.verdict.mark == "no"
    assert "converter: inverting amplifier" in audited.verdict.sentence
    assert "inverting" not in audit(stated, stated).verdict.sentence


@pytest.mark.slow
def test_a_converters_input_to_ground_beside_pull_ups_is_named() -> None:
    stated = LoadedColumnsReadout(polarity="down", load_ohm=35e3, drive_ohm=25.0, **ESP32)
    audited = audit(replace(stated, input_ohm=1e5), stated)
    assert audited.verdict.mark == "no"
    assert [finding.line for finding in audited.advice] == ["readout: {input_ohm: 100000}"]
    assert audit(stated, stated).verdict.mark == "yes"


def test_amplifiers_without_a_channel_show_cells_apart() -> None:
    """The gain Rf/Rc is 1e9 then, and no reading is that of an open cell."""
    circuit = VirtualGroundReadout(sense_ohm=0.0, drive_ohm=20.0)
    cells = np.array([[2e3, 8e3], [3e4, 4e3]])
    apparent = circuit.apparent_resistance(circuit.exact_reading(cells))
    assert np.abs(apparent / cells - 1).max() < 0.05


@pytest.mark.slow
def test_the_voltage_of_code_0_is_estimated_by_cells_that_stand_still() -> None:
    stated = GroundedReadout(load_ohm=3300.0, **ESP32)
    sought = replace(stated, converter=Characteristic(zero_volt="estimated", full_volt=3.12))
    noise = audit(replace(stated, converter=DEAD_ZONE), sought).prepared.noise
    zero, sd = noise.estimated["readout.converter.zero_volt"]
    assert abs(zero - DEAD_ZONE.zero_volt) < 3 * sd < 3e-3


@pytest.mark.slow
def test_a_voltage_of_code_0_that_no_load_shows_is_a_doubt() -> None:
    """Without crosstalk every cell follows its reading, whatever code 0 stands for."""
    stated = VirtualGroundReadout(feedback_ohm=1e3, drive_ohm=0.0, **ESP32)
    sought = replace(stated, converter=Characteristic(zero_volt="estimated", full_volt=3.3))
    verdict = audit(stated, sought).verdict
    assert verdict.mark == "doubtful"
    assert "readout.converter.zero_volt is estimated" in verdict.sentence


@pytest.mark.parametrize("readings", [1, 20])
@pytest.mark.parametrize("noise", [0.11, 0.18])
def test_noise_below_the_step_is_right_where_few_codes_change(noise: float, readings: int) -> None:
    """What averaging cannot remove is the same in all frames, and scatters in none."""
    found = measured_noise(noise, readings, true_noise=noise)
    assert found.sigma_factor == 1 and not found.sentence
    quieter = measured_noise(0.6, readings, true_noise=noise)
    assert noise_of(quieter.sentence) == pytest.approx(noise, rel=0.4)


def measured_noise(noise: float, readings: int, true_noise: float) -> NoiseEstimate:
    """Return the noise of 24 unloaded frames, of a scene that specifies `noise` LSB."""
    circuit = lampest.TwoPointReadout(
        supply_volt=5.0, adc_bits=8, readings=readings, noise_lsb=true_noise, reference_ohm=1000.0
    )
    scene = Scene(Panel(6, 7), circuit)
    simulated = lampest.simulate(lampest.Simulation(1, 3, scene, baseline_frames=24, frames=1))
    stated = replace(scene, readout=replace(circuit, noise_lsb=noise))
    return Prepared(replace(simulated, scene=stated)).noise


def noise_of(sentence: str) -> float:
    """Return the measured noise of a sentence, in LSB."""
    return float(sentence.split("noise ")[1].split(" LSB")[0])
