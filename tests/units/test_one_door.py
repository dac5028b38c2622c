"""Cells of a file, of live replay, of a board's frames and of the user's own loop are equal."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from support import live_pictures

from lampest import (
    UNLOADED,
    Estimator,
    InputError,
    OralDisc,
    Panel,
    Recording,
    Stream,
    TwoPointReadout,
    datasets,
)
from lampest.apps.board.protocol import Frame, Hello
from lampest.apps.board.sample import Sample
from lampest.apps.live.engine import Engine
from lampest.apps.live.run import from_recording, take_sample
from lampest.apps.recognition.detect.detection import known_of
from lampest.cost.terms import Arrival, LogGradient, Misfit, RelativeChange
from lampest.estimate.sequence import reconstruct
from lampest.inference import prepared as preparation
from lampest.inference import warnings
from lampest.inference.prepared import Prepared
from lampest.inference.readings import judge
from lampest.panel.conditions import Water
from lampest.panel.faults import Faults
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.recording.readings import Readings
from lampest.recording.simulation.measure import Unmodelled, measured, raw_sums
from lampest.recording.simulation.simulation import Simulation, simulate

SHAPE = (8, 9)
SOUND_SCENE = Scene(Panel(*SHAPE), TwoPointReadout(), 140.0)
MOUTH = OralDisc(
    kind="oral_disc",
    centre_mm=(42, 33),
    diameter_mm=32,
    rim_width_mm=5.5,
    pressure_kpa=-10,
    rim_kpa=80,
)
LSM = Estimator((Misfit(),), "reduced")
RELATIVE = Estimator((Misfit(), RelativeChange(weight=10.0)), "reduced")
ARRIVAL = Estimator((Misfit(weighting="noise"), Arrival()), "reduced")
STEPS = {
    "outliers_of_one_frame": judge,
    "estimate_noise": preparation,
    "resolved": preparation,
    "warnings_of": warnings,
}


@dataclass(frozen=True)
class Case:
    """A scene, cells that are broken in truth, and how it is estimated.

    least : share of readings that are none.
    """

    scene: Scene
    broken: Faults = Faults()
    estimator: Estimator = LSM
    least: float = 0.0


CASES = {
    "nothing": Case(SOUND_SCENE),
    "dead row": Case(
        replace(SOUND_SCENE, faults=Faults(dead_rows=(2,))), Faults(dead_rows=(2,)), least=1 / 8
    ),
    "dead column": Case(
        replace(SOUND_SCENE, faults=Faults(dead_columns=(4,))),
        Faults(dead_columns=(4,)),
        RELATIVE,
        1 / 9,
    ),
    "open cell": Case(replace(SOUND_SCENE, faults=Faults(open=((3, 4),))), Faults(open=((3, 4),))),
    "shorted cell": Case(
        replace(SOUND_SCENE, faults=Faults(shorted=((5, 1),))),
        Faults(shorted=((5, 1),)),
        least=1 / 72,
    ),
    "reading of zero": Case(SOUND_SCENE, Faults(shorted=((5, 1),)), least=1 / 72),
    "readings at a rail": Case(
        replace(SOUND_SCENE, readout=TwoPointReadout(reference_ohm=0.375)), least=0.1
    ),
    "systematic errors": Case(
        replace(SOUND_SCENE, systematic=Systematic(0.02, 3.0)), estimator=ARRIVAL
    ),
    "water": Case(
        replace(SOUND_SCENE, water=Water(400.0), systematic=Systematic(0.01, 3.0)),
        estimator=ARRIVAL,
    ),
}


def recording_of(case: Case) -> Recording:
    """Three unloaded frames and three of a mouth, through the scene's electronics."""
    still = simulate(Simulation(1, 5, replace(case.scene, faults=None), frames=3, loads=(MOUTH,)))
    cells = still.truth_cell_resistance.copy()
    cells[:, case.broken.open_cells(case.scene.panel)] = np.inf
    cells[:, case.broken.shorted_cells(case.scene.panel)] = 0.0
    resistance, sums = measured(case.scene, cells, Unmodelled(), seed=7)
    raw = {
        "raw_sums": raw_sums(case.scene.readout, sums),
        "raw_readings": case.scene.readout.readings,
    }
    return Recording(case.scene, resistance, still.time, still.role, **raw)


def samples_of(recording: Recording) -> list[Sample]:
    """The same frames as a board sends them."""
    readout = recording.scene.readout
    rows, columns = recording.scene.panel.shape
    times = {"period_us": 1_000_000, "shortest_period_us": 1000, "settle_us": 2}
    circuit = {"supply_millivolt": 5000, "reference_milliohm": round(readout.reference_ohm * 1000)}
    converter = {"adc_bits": readout.adc_bits, "measured_across": readout.measured_across}
    further = times | circuit | converter
    hello = Hello(
        rows, columns, readout.readings, *(16, 16, 64), firmware=(1, 0), running=True, **further
    )
    frames = (
        Frame(readout.readings, at, 1000 * at, 0, sums)
        for at, sums in enumerate(recording.raw_sums)
    )
    return [
        Sample(frame, hello, recording.scene, float(frame.sequence), 0.0, 0, 0) for frame in frames
    ]


@pytest.mark.slow
@pytest.mark.exact
@pytest.mark.parametrize("name", CASES)
def test_every_entry_point_gives_the_same_cells(name: str) -> None:
    case = CASES[name]
    recording = recording_of(case)
    readings = recording.readings()
    assert np.mean((readings.side != 0) | (readings.seen == 0)) >= case.least
    estimate = reconstruct(recording, case.estimator)
    assert np.all(np.isfinite(estimate.cell_resistance))

    def board(engine: Engine) -> None:
        for sample in samples_of(recording):
            take_sample(engine, sample)

    # A recording's frames are solved in blocks, others one by one: both to the solver's tolerance.
    # A user's program has bare arrays and a scene.
    scene = recording.scene
    cells = []
    unloaded = Readings.of(scene, recording.resistance[recording.role == UNLOADED])
    stream = Stream.begin(case.estimator, scene, 1.0, unloaded.mean())
    for resistance in recording.resistance[recording.role != UNLOADED]:
        stream, step = stream.push(Readings.of(scene, resistance))
        cells.append(step.solution.cell_resistance[-1])
    assert_allclose(cells, estimate.cell_resistance, rtol=1e-7)
    assert_allclose(stream.baseline_resistance, estimate.baseline_resistance, rtol=1e-9)
    replayed = live_pictures(
        case.estimator, 3, lambda engine: from_recording(engine, recording, 1e9, None)
    )
    boarded = live_pictures(case.estimator, 3, board)
    for pictures in (replayed, boarded):
        assert [picture.status for picture in pictures] == [
            step.solution.status.value for step in estimate.steps
        ]
        ratio = np.array([1 + picture.relative_change / 100 for picture in pictures])
        assert_allclose(ratio, estimate.cell_resistance / estimate.baseline_resistance, rtol=1e-7)
        flags = [picture.open_cell for picture in pictures]
        assert_array_equal(flags, [step.solution.open_cell[-1] for step in estimate.steps])
    assert_array_equal(
        [picture.force for picture in boarded], [picture.force for picture in replayed]
    )


def test_errors_name_inconsistent_inputs() -> None:
    good = np.full((2, *SHAPE), 700.0)
    role = np.ones(2, dtype=np.uint8)
    for given, sentence in (
        ((good[0].T,), r"^the readings are 9 × 8, but the scene's panel is 8 × 9$"),
        ((good, np.ones(2)), r"^sigma has another shape than the readings$"),
        ((good, np.zeros(SHAPE)), r"^sigma\[0, 0\] is 0 ohm; it must be positive$"),
    ):
        with pytest.raises(InputError, match=sentence):
            Readings.of(SOUND_SCENE, *given)
    with pytest.raises(InputError, match="recording must be a Recording"):
        Prepared.of("mine.h5")
    with pytest.raises(
        InputError, match=r"^mine: /entry/two_point/sigma\[0, 0\] is -1 ohm; it must be positive$"
    ):
        Recording(SOUND_SCENE, good, np.arange(2.0), role, np.full(SHAPE, -1.0), name="mine")


@pytest.mark.slow
def test_estimates_detection_and_warnings_share_one_preparation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken = list[str]()
    for name, module in STEPS.items():
        step = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *given, at=name, step=step: taken.append(at) or step(*given)
        )
    prepared = Prepared(datasets.load("lamprey_35mm"))
    for terms in ((Misfit(),), (Misfit(), LogGradient(weight=1.0))):
        estimates = reconstruct(prepared, Estimator(terms, "reduced"))
        assert estimates.checks == prepared.warnings and estimates.noise is prepared.noise
        assert estimates.circuit_check is prepared.check
    known_of(prepared)
    assert sorted(taken) == sorted(STEPS)
