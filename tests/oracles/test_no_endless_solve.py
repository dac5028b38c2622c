"""Frames of 256 cells whose model or weight is far off end soon, with an estimate or a sentence."""

import numpy as np
import pytest

from lampest import GroundedReadout, LoadedColumnsReadout, Panel, Readout, Stream, TwoPointReadout, VirtualGroundReadout
from lampest.cost.losses import Huber, Student
from lampest.cost.terms import Misfit, Term, term_types
from lampest.estimate.estimator import Estimator
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.solution import Solution, Status

SIDE = 16
CONVERTER = {"adc_bits": 12, "readings": 1, "noise_lsb": 0.5, "supply_volt": 5.0}
CIRCUITS: dict[str, Readout] = {
    "two_point": TwoPointReadout(reference_ohm=3000.0, **CONVERTER),
    "loaded": LoadedColumnsReadout(drive_ohm=1000.0, load_ohm=1e4, **CONVERTER),
    "grounded": GroundedReadout(drive_ohm=70.0, sense_ohm=70.0, load_ohm=1000.0, **CONVERTER),
    "virtual": VirtualGroundReadout(drive_ohm=70.0, sense_ohm=70.0, feedback_ohm=3000.0, **CONVERTER),
}


def skin(kind: str, seed: int) -> tuple[Scene, np.ndarray]:
    """A foam skin, nearly open where nothing presses, with contacts, memory and joined rows that its scene omits."""
    random = np.random.default_rng(seed)
    row, column = np.indices((SIDE, SIDE))
    pressed = np.exp(-((row - 6) ** 2 + (column - 9) ** 2) / 8)
    cells = 3e6 * np.exp(0.8 * random.standard_normal((SIDE, SIDE))) / (1 + 1500 * pressed)
    readout = CIRCUITS[kind]
    reading = readout.exact_reading(cells + random.uniform(0, 200, SIDE))
    reading = reading + 0.03 * np.roll(reading, 1, axis=1)
    reading[3] = reading[4] = (reading[3] + reading[4]) / 2
    return Scene(Panel(SIDE, SIDE), readout), reading * (1 + 0.05 * random.standard_normal(reading.shape))


def ended(kind: str, terms: tuple[Term, ...]) -> Solution:
    """How the frame ended."""
    scene, reading = skin(kind, 3)
    readings = Readings.of(scene, reading, 2e-3 * np.abs(reading) + 1e-4 * np.abs(reading).max())
    baseline = Stream.begin(Estimator(terms, error_bars=False), scene, 1.0, readings).baseline
    return baseline.solution


@pytest.mark.parametrize("weight", [0.0, 1e-3])
@pytest.mark.parametrize("kind", CIRCUITS)
def test_a_frame_is_solved_at_any_weight(kind: str, weight: float) -> None:
    solution = ended(kind, (Misfit(weighting="noise"), term_types()["log_gradient"](weight=weight)))
    assert solution.solved or solution.status is Status.STALLED
    assert solution.iterations < 200


def test_readings_beyond_the_corner_of_a_loss_still_lead_to_the_minimum() -> None:
    misfit = Misfit(weighting="noise", loss=Student(corner=4.0))
    solution = ended("loaded", (misfit, term_types()["log_gradient"](weight=1e-3)))
    assert solution.solved and solution.iterations < 150


@pytest.mark.slow
def test_a_frame_whose_cost_has_stopped_falling_ends_with_a_sentence() -> None:
    """A corner a million times below the differences: second derivatives see none of them."""
    penalty = term_types()["gradient"](weight=1e-2, loss=Huber(corner=0.3))
    solution = ended("loaded", (Misfit(weighting="noise"), penalty))
    assert solution.solved or solution.status in (Status.STALLED, Status.ROUNDED)
    assert solution.iterations < 300
