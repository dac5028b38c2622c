"""The arrival cost: where it beats one weight for all cells, and what error bars it leaves."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, Estimates, Faults, InputError, OralDisc, Panel, Rod, Scene, Squared, two_point_resistance
from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Arrival, LogRatio, Misfit, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import ratio_from_pressure
from lampest.posterior.dense import DenseErrors, DenseMemory
from lampest.posterior.linear import LinearModel
from lampest.recording.recording import Recording
from lampest.solvers.ipopt.formulations import FORMULATIONS

pytestmark = pytest.mark.slow

PANEL, NOISE, WEIGHTS = Panel(10, 10), 0.01, 10.0 ** np.arange(-2.5, -0.9, 0.5)
ROD = Rod(kind="rod", centre_mm=(48, 43), diameter_mm=35, mass_g=500)
DISC = OralDisc(kind="oral_disc", centre_mm=(48, 43), diameter_mm=40, rim_width_mm=7, pressure_kpa=-5)


def recorded(cells: Array, seed: int, noise: float = NOISE) -> Recording:
    """Ten frames a second of such cells, the first two of them unloaded."""
    rng, time = np.random.default_rng(seed), np.arange(len(cells)) / 10
    exact = two_point_resistance(cells)
    measured = exact * np.exp(noise * rng.standard_normal(exact.shape))
    role, panel = (np.arange(len(cells)) >= 2).astype(np.uint8), Panel(*cells.shape[1:])
    return Recording(Scene(panel), measured, time, role, sigma=noise * exact, truth_cell_resistance=cells)


@cache
def scene(kind: str, seed: int, frames: int = 18) -> Recording:
    """The whole panel pressed in rhythm; a disc that breathes; a rod that stands; a disc that attaches at frame 5."""
    rng, count = np.random.default_rng(seed), np.arange(frames + 2) - 2
    breathing = 1 + 0.3 * np.sin(2 * np.pi * 0.1 * count)
    if kind == "panel":
        pattern = 2 + np.sin(np.add.outer(0.2 * np.arange(10), 0.15 * np.arange(10)) + rng.uniform(0, 6))
    else:
        pattern = np.sum((ROD if kind == "rod" else DISC).mean_pressure(PANEL, 10.0), axis=0)
    course = {"panel": breathing, "disc": breathing, "rod": np.ones(frames + 2), "attachment": count >= 5}[kind]
    pressure = ((count >= 0) * course)[:, None, None] * pattern
    cells = 3050 * np.exp(0.2 * rng.standard_normal(PANEL.shape)) * ratio_from_pressure(pressure)
    return recorded(cells, seed + 1000)


def estimated(recording: Recording, *terms: Term, formulation: MethodName = "reduced", **options: Any) -> Estimates:
    return reconstruct(recording, Estimator((Misfit(weighting="noise"), *terms), formulation, **options))


def deviation(found: Estimates) -> Array:
    """Of log r, all frames, as the bars have it."""
    assert all(step.bars is not None for step in found.steps)
    return np.stack([step.bars.frame.deviation for step in found.steps if step.bars is not None])


def errors(found: Estimates) -> Array:
    """log r − log truth, (frames, rows, columns)."""
    truth = found.recording.truth_cell_resistance
    return np.asarray(np.log(found.cell_resistance / truth[found.frame]))


def size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def error(recording: Recording, *terms: Term) -> float:
    return size(errors(estimated(recording, *terms)))


@pytest.mark.parametrize(("kind", "margin"), [("panel", 0.9), ("disc", 0.9), ("rod", 0.95), ("attachment", 0.85)])
def test_beats_the_best_single_weight(kind: str, margin: float) -> None:
    """Nothing chosen, against the logarithmic change from the previous frame with its best weight in hindsight."""
    ours, theirs = [], []
    for seed in range(2):
        recording = scene(kind, seed)
        ours.append(error(recording, Arrival()))
        squared = LogRatio(loss=Squared(), reference="previous")
        theirs.append(min(error(recording, replace(squared, weight=float(weight))) for weight in WEIGHTS))
    assert size(np.array(ours)) < margin * size(np.array(theirs))


def test_sudden_load_is_not_smeared() -> None:
    """The frame in which a disc attaches is hardly worse than without any memory; three frames later it is better."""
    pairs = []
    for seed in range(4):
        recording = scene("attachment", seed)
        pairs.append([np.square(errors(estimated(recording, *terms))).mean(axis=(1, 2)) for terms in ([Arrival()], [])])
    ours, alone = np.sqrt(np.mean(pairs, axis=0))
    assert ours[5] < 1.4 * alone[5]
    assert ours[8] < 0.9 * alone[8]
    assert np.all(ours[1:5] < 0.8 * alone[1:5])


def walk(seed: int, percent: float, frames: int = 12) -> Recording:
    """Cells that walk at random."""
    rng, panel = np.random.default_rng(seed), (6, 6)
    steps = percent / 100 * rng.standard_normal((frames, *panel))
    logarithm = 0.3 * rng.standard_normal(panel) + np.concatenate([np.zeros((2, *panel)), np.cumsum(steps, axis=0)])
    return recorded(3050 * np.exp(logarithm), seed + 1000)


@pytest.mark.parametrize(
    ("percent", "ratio", "coverage"), [(2.0, (0.93, 1.07), (0.93, 0.97)), (0.0, (0.75, 1.0), (0.95, 1.0))]
)
def test_error_bars_say_what_errors_are(
    percent: float, ratio: tuple[float, float], coverage: tuple[float, float]
) -> None:
    """Where cells walk as the term says; where they rest, bars allow for a walk that is not there."""
    spread, inside = [], []
    for seed in range(20):
        found = estimated(walk(seed, percent), Arrival())
        away = errors(found) / deviation(found)
        spread.append(size(away))
        inside.append(np.mean(np.abs(away) < 1.96))
    assert ratio[0] < size(np.array(spread)) < ratio[1]
    assert coverage[0] < np.mean(inside) < coverage[1]


def test_covariance_counts_the_previous_frame_once() -> None:
    """Joseph's form (I − KH)(S₀ + q²)(I − KH)ᵀ + K R Kᵀ for the gain K that reads the diagonal of S₀."""
    rng, shape, cells = np.random.default_rng(1), (3, 4), 12
    previous = 3000 * np.exp(0.2 * rng.standard_normal(shape))
    root, walk_percent = 0.03 * rng.standard_normal((cells, cells)), 4.0
    before = root @ root.T
    measured, spread = two_point_resistance(previous)[None], np.sqrt(np.diag(before)).reshape(shape)
    given = Given(measured=measured, sigma=0.01 * measured, previous=previous, previous_deviation=spread)
    data = Data(given, measured / 9, measured * 1e3)
    cost = Cost(Panel(*shape), (Misfit(weighting="noise"), Arrival(walk_percent=walk_percent)))
    model = LinearModel(Evaluation.at(cost, data, previous[None]), np.zeros(0))
    errors_ = DenseErrors(model, DenseMemory(before, before, before))
    walk_ = (walk_percent / 100) ** 2
    sensitivity = errors_.jacobian  # of residuals in units of the noise, so that R = 1
    precision = np.diag(1 / (np.diag(before) + walk_))
    gain = np.linalg.solve(sensitivity.T @ sensitivity + precision, sensitivity.T)
    rest = np.eye(cells) - gain @ sensitivity
    expected = rest @ (before + walk_ * np.eye(cells)) @ rest.T + gain @ gain.T
    assert_allclose(errors_.covariance, expected, atol=1e-4 * np.max(expected))
    assert_allclose(errors_.variance, np.diag(expected), rtol=1e-3)


def test_term_reads_the_error_bars_of_the_frame_before() -> None:
    found = estimated(scene("rod", 1, 3), Arrival(walk_percent=3.0, loss=Squared()))
    for frame in (1, 2):
        before, now = (found.steps[number].solution for number in (frame - 1, frame))
        step = common_step(found.measured[frame], before.reading[-1])
        change = np.log(now.cell_resistance[-1] / (step * before.cell_resistance[-1]))
        expected = np.sum(change**2 / (np.minimum(deviation(found)[frame - 1], 10.0) ** 2 + 0.03**2))
        assert found.steps[frame].solution.costs[1] == pytest.approx(expected, rel=1e-10)


def common_step(measured: Array, expected: Array) -> float:
    return TwoPointReadout().common_step(measured, expected, np.ones(measured.shape, dtype=bool))


def test_common_step_is_that_of_most_readings() -> None:
    rng = np.random.default_rng(2)
    expected = 500 * np.exp(0.2 * rng.standard_normal((10, 10)))
    measured = 0.93 * expected * np.exp(0.003 * rng.standard_normal((10, 10)))
    measured[2:5] *= np.exp(-rng.uniform(0.02, 0.3, (3, 10)))
    assert common_step(measured, expected) == pytest.approx(0.93, abs=0.002)
    assert common_step(2 * expected[:1, :1], expected[:1, :1]) == pytest.approx(2.0)
    assert common_step(expected[:0], expected[:0]) == 1.0


def test_samples_agree_with_matrices_along_a_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frame's noise is new: the same samples again and again would not average out."""
    dense = estimated(walk(0, 2.0), Arrival())
    monkeypatch.setattr("lampest.posterior.track.MAX_DENSE", 1)
    sampled = estimated(walk(0, 2.0), Arrival())
    assert size(deviation(sampled)[-1]) == pytest.approx(size(deviation(dense)[-1]), rel=0.06)
    assert_allclose(sampled.cell_resistance, dense.cell_resistance, rtol=0.05)


def test_formulations_agree_on_an_arrival() -> None:
    first, *others = (estimated(walk(3, 2.0, 3), Arrival(), formulation=name) for name in ("reduced", *FORMULATIONS))
    for other in others:
        assert_allclose(other.cell_resistance, first.cell_resistance, rtol=1e-3)
        assert_allclose(deviation(other), deviation(first), rtol=1e-2)


@pytest.mark.parametrize("faults", [Faults(open=((1, 2),)), Faults(dead_rows=(3,))], ids=["open cell", "dead row"])
def test_what_is_broken_is_left_out(faults: Faults) -> None:
    panel, recording = Panel(6, 6), walk(4, 2.0, 5)
    sound = ~faults.open_cells(panel)
    exact = two_point_resistance(np.where(sound, recording.truth_cell_resistance, np.inf))
    measured = np.where(np.isfinite(exact), exact, 1.0)
    broken = replace(recording, scene=Scene(panel, faults=faults), recorded=measured, sigma=0.003 * measured)
    found = estimated(broken, Arrival())
    assert all(step.solution.solved and step.bars is not None for step in found.steps)
    truth = recording.truth_cell_resistance[found.frame]
    assert size(np.log(found.cell_resistance[:, sound] / truth[:, sound])) < 0.02


def test_bars_know_what_huber_holds_back() -> None:
    """Cells that breathe faster than they are expected to walk lag behind: their bars must say so."""
    inside = []
    for seed in range(6):
        found = estimated(scene("disc", seed), Arrival())
        truth = found.recording.truth_cell_resistance
        loaded = np.abs(np.log(truth[found.frame] / truth[0])) > 0.05
        inside.append(np.mean((np.abs(errors(found)) < 1.96 * deviation(found))[loaded]))
    assert np.mean(inside) > 0.8


def test_an_arrival_needs_the_noise() -> None:
    recording = replace(scene("rod", 0, 3), sigma=None)
    for misfit in (Misfit(), Misfit(weighting="noise")):
        with pytest.raises(InputError, match="needs"):
            reconstruct(recording, Estimator((misfit, Arrival()), "reduced"))


@pytest.mark.parametrize("options", [{"error_bars": False}, {"formulation": "scaled"}])
def test_an_arrival_needs_error_bars(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="arrival weighs frames by their error bars"):
        Estimator((Misfit(weighting="noise"), Arrival()), **options)


def test_an_arrival_needs_readings() -> None:
    with pytest.raises(ValueError, match="arrival needs the term misfit"):
        Estimator((Arrival(),))


@pytest.mark.parametrize("percent", [0.0, -1.0, float("nan"), float("inf")])
def test_walk_must_be_positive_and_finite(percent: float) -> None:
    with pytest.raises(ValueError, match="walk_percent must be"):
        Arrival(walk_percent=percent)
