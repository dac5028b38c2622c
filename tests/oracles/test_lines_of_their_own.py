"""What differs from line to line, what the converter draws, what a diode drops: against netlists solved here."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from lampest import Array, Diode, Estimator, InputError, Misfit, Panel, Recording, Simulation, read_run, simulate
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import GroundedReadout, LoadedColumnsReadout, Readout, TwoPointReadout, VirtualGroundReadout
from lampest.panel.scene import Scene, SeriesPerLine, Systematic
from lampest.solvers.solution import Settings
from tests.oracles.netlist import Node, Resistor, potentials

SHAPE = (4, 5)
ROW_OHM, COLUMN_OHM = (70.0, 75.0, 81.0, 66.0), (60.0, 68.0, 72.0, 64.0, 77.0)
PER_LINE = SeriesPerLine(ROW_OHM, COLUMN_OHM)
LSM = (Misfit(weighting="noise"),)
FINE = Settings(tolerance=1e-10)  # a cell of 25 kohm beside such of 0.4 is hardly seen, and the cost is flat along it
LOADED = LoadedColumnsReadout(load_ohm=4700.0, drive_ohm=120.0, adc_bits=12)
LED = Diode(drop_volt=1.8, at_ampere=2e-3, slope_volt=0.09)


def cells_of(seed: int = 3, shape: tuple[int, int] = SHAPE) -> Array:
    return np.asarray(2500 * np.exp(0.7 * np.random.default_rng(seed).normal(size=shape)))


def panel(cells: Array) -> list[Resistor]:
    return [(("r", row), ("c", column), ohm) for (row, column), ohm in np.ndenumerate(cells)]


def divider(cells: Array, readout: TwoPointReadout, row: int, column: int) -> float:
    """Volt at the converter: supply, reference, row's channel, panel, column's channel and ground in a row."""
    network = panel(cells)
    network += [("row end", ("r", row), ROW_OHM[row]), (("c", column), "column end", COLUMN_OHM[column])]
    rin, across_sensor = readout.input_ohm, readout.measured_across == "sensor"
    tap: Node = "row end" if across_sensor else "column end"
    ends = ("supply", "row end") if across_sensor else ("column end", "ground")
    network.append((*ends, readout.reference_ohm))
    network.append(("column end", "ground", 0.0) if across_sensor else ("supply", "row end", 0.0))
    if rin is not None:
        network.append((tap, "ground", rin))
    return potentials(network, {"supply": readout.supply_volt, "ground": 0.0})[tap]


@pytest.mark.parametrize("input_ohm", [None, 30e3])
@pytest.mark.parametrize("across", ["reference", "sensor"])
def test_two_point_takes_off_what_each_line_has_in_series(across: Any, input_ohm: float | None) -> None:
    readout = TwoPointReadout(measured_across=across, input_ohm=input_ohm, adc_bits=16, noise_lsb=1)
    cells, scene = cells_of(), Scene(Panel(*SHAPE), readout, PER_LINE)
    volt = np.array([[divider(cells, readout, *at) for at in [(j, k) for k in range(5)]] for j in range(4)])
    ratio = (5 - volt) / volt if across == "reference" else volt / (5 - volt)
    recorded = ratio * readout.reference_ohm  # what anybody's divider equation gives
    assert_allclose(readout.recorded_from_volt(volt), recorded, rtol=1e-12)
    assert_allclose(readout.from_recorded(recorded, scene), readout.exact_reading(cells), rtol=1e-9)
    assert_allclose(readout.to_recorded(readout.exact_reading(cells), scene), recorded, rtol=1e-9)
    frames = np.stack([recorded] * 2)
    recording = Recording(scene, frames, np.arange(2.0), np.array([0, 1], dtype=np.uint8))
    assert_allclose(reconstruct(recording, Estimator(LSM, "reduced")).cell_resistance[0], cells, rtol=1e-5)
    # σ is that of the converter: what one σ of volt does to the network's resistance.
    step = 1e-3 * readout.sigma_volt()
    ends = [readout.from_recorded(readout.recorded_from_volt(volt + sign * step), scene) for sign in (1, -1)]
    assert_allclose(recording.readings().sigma[0], np.abs(ends[0] - ends[1]) / 2e-3, rtol=1e-5)


def through_diode(cells: Array, readout: LoadedColumnsReadout, driven: int) -> Array:
    """Volt at the loads while a row is driven: the current at which diode and network share the supply."""
    saturation = readout.diode.at_ampere / np.expm1(readout.diode.drop_volt / readout.diode.slope_volt)

    def loads(volt: float) -> dict[Node, float]:
        network = [*panel(cells), ("source", ("r", driven), 120.0)]
        for column in range(cells.shape[1]):
            network += [(("c", column), "ground", 4700.0)]
            if readout.input_ohm is not None:
                network += [(("c", column), "ground", readout.input_ohm)]
        return potentials(network, {"source": volt, "ground": 0.0})

    def excess(volt: float) -> float:
        current = (volt - loads(volt)[("r", driven)]) / 120.0
        return volt + readout.diode.slope_volt * np.log1p(current / saturation) - readout.supply_volt

    behind = float(brentq(excess, 0.0, readout.supply_volt, xtol=1e-15, rtol=1e-14))
    found = loads(behind)
    return np.array([found[("c", column)] for column in range(cells.shape[1])])


@pytest.mark.parametrize("polarity", ["up", "down"])
@pytest.mark.parametrize("driven", ["rows", "columns"])
@pytest.mark.parametrize("diode", [Diode(), LED], ids=["silicon", "led"])
def test_a_diode_and_the_converter_are_in_the_model(diode: Diode, driven: Any, polarity: Any) -> None:
    readout = replace(LOADED, diode=diode, driven=driven, polarity=polarity, input_ohm=100e3)
    cells = cells_of()
    volt = np.stack([through_diode(cells, readout, row) for row in range(len(cells))])
    recorded = volt if polarity == "up" else 5 - volt
    recorded, truth = (recorded, cells) if driven == "rows" else (recorded.T, cells.T)
    scene = Scene(Panel(*truth.shape), readout)
    assert_allclose(readout.to_recorded(readout.exact_reading(truth), scene), recorded, rtol=1e-10)
    rng = np.random.default_rng(2)
    noisy = recorded + readout.sigma(recorded) * rng.normal(size=(3, *truth.shape))
    role = np.array([0, 0, 1], dtype=np.uint8)
    for frames, close in ((np.stack([recorded] * 3), truth), (noisy, None)):
        recording = Recording(scene, frames, np.arange(3.0), role)
        one, other = (reconstruct(recording, Estimator(LSM, name, FINE)) for name in ("reduced", "nodal"))
        assert all(step.solution.solved for step in (*one.steps, *other.steps))
        assert_allclose(one.cell_resistance, other.cell_resistance, rtol=1e-6)
        if close is not None:
            assert_allclose(one.cell_resistance[0], close, rtol=1e-4)


def test_a_diode_that_drops_next_to_nothing_is_none() -> None:
    cells = cells_of()
    ideal = replace(LOADED, diode=Diode(drop_volt=0.01, at_ampere=10.0, slope_volt=0.5))
    assert_allclose(ideal.exact_reading(cells), LOADED.exact_reading(cells), rtol=1e-5)


NOISY = (0.6, 3.0, 1.2, 5.0)
KINDS: tuple[Readout, ...] = (
    TwoPointReadout(adc_bits=12),
    LOADED,
    GroundedReadout(adc_bits=12),
    GroundedReadout(adc_bits=12, sense="one"),
    VirtualGroundReadout(adc_bits=12, sense_ohm=40.0, feedback_ohm=400.0),
)


@pytest.mark.parametrize("readout", KINDS, ids=lambda one: one.kind)
@pytest.mark.parametrize("driven", ["rows", "columns"])
def test_noise_is_that_of_the_driven_line(readout: Any, driven: str) -> None:
    """Codes that are simulated scatter as σ says, line by line; of many readings each."""
    if isinstance(readout, TwoPointReadout) and driven == "columns":
        return
    turned = readout if isinstance(readout, TwoPointReadout) else replace(readout, driven=driven)
    noisy = replace(turned, noise_lsb=NOISY, readings=4)
    shape = (4, 5) if driven == "rows" else (5, 4)
    recording = simulate(Simulation(1, 5, Scene(Panel(*shape), noisy), frames=600))
    scatter = (recording.raw_sums / 4).std(axis=0).mean(axis=1 if driven == "rows" else 0)
    expected = [np.sqrt((noise**2 + 1 / 12) / 4) for noise in NOISY]
    assert_allclose(scatter, expected, rtol=0.05)
    along = noisy.sigma(recording.recorded) / noisy.sigma(recording.recorded)[:, :1, :1]
    if not isinstance(readout, TwoPointReadout):
        lines = along[0, :, 0] if driven == "rows" else along[0, 0]
        assert_allclose(lines, np.divide(expected, expected[0]), rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("readout", KINDS, ids=lambda one: one.kind)
def test_shared_errors_move_the_estimate_as_the_bars_say(readout: Any) -> None:
    """All channels and the reference drawn anew for every panel: errors in units of the error bars."""
    cells, rng, scores = cells_of(), np.random.default_rng(8), []
    quiet = replace(readout, adc_bits=16, noise_lsb=0.5)
    told = Scene(Panel(*SHAPE), quiet, systematic=Systematic(0.02, 4.0))
    if isinstance(readout, TwoPointReadout):
        told = replace(told, series_resistance_ohm=140.0)
    for _ in range(40):
        actual = quiet.off_by(0.02 * rng.uniform(-1, 1))
        channels = 4.0 * rng.normal(size=sum(SHAPE))
        volt = actual.volt_from_recorded(actual.simulated(cells[None], told, channels[:4], channels[4:]))
        frames = np.concatenate([quiet.recorded_from_volt(volt)] * 2)
        recording = Recording(told, frames, np.arange(2.0), np.array([0, 1], dtype=np.uint8))
        done = reconstruct(recording, Estimator(LSM, "reduced"))
        bars = done.steps[0].bars
        scores.append(np.log(done.cell_resistance[0] / cells) / bars.frame.deviation)
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.2


def test_series_per_line_is_one_number_where_all_are_alike() -> None:
    plain, listed = (Scene(Panel(3, 4), TwoPointReadout(), one) for one in (140.0, SeriesPerLine((80.0,) * 3, 60.0)))
    assert_allclose(np.broadcast_to(plain.series_ohm, (3, 4)), listed.series_ohm)
    with pytest.raises(ValueError, match=r"series_resistance_ohm.rows lists 2 numbers, but there are 3 such lines"):
        Scene(Panel(3, 4), TwoPointReadout(), SeriesPerLine((80.0,) * 2, 60.0))


def test_a_formulation_that_cannot_serve_a_readout_is_refused_before_anything(tmp_path: Path) -> None:
    scene = Scene(Panel(*SHAPE), LOADED)
    simulate(Simulation(1, 5, scene, frames=2)).save(tmp_path / "volt.h5")
    (tmp_path / "run.yaml").write_text(
        "schema: 1\nrecordings: [volt.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\nformulation: per_pixel\n"
    )
    with pytest.raises(InputError, match=r"run.yaml: LSM × volt: formulation: .* knows readout.kind: two_point only"):
        read_run(tmp_path / "run.yaml")


@dataclass(frozen=True, kw_only=True)
class StrangerReadout(GroundedReadout):
    """A kind that no union names."""

    kind: Literal["stranger"] = "stranger"


def test_a_file_with_a_readout_that_nobody_knows_says_so_when_it_is_written_and_when_it_is_read(tmp_path: Path) -> None:
    recording = simulate(Simulation(1, 5, Scene(Panel(*SHAPE), LOADED), frames=2))
    odd = replace(recording, scene=replace(recording.scene, readout=StrangerReadout()))
    with pytest.warns(UserWarning, match="stranger is not among the readouts"):
        odd.save(tmp_path / "odd.h5")
    with pytest.raises(
        InputError, match="readout: there is no kind stranger in lampest or an installed package; there"
    ):
        Recording.load(tmp_path / "odd.h5")
