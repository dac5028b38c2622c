"""Why each term beyond the paper exists: a scene on which it wins."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    Arrival,
    Course,
    LogRatio,
    Recording,
    Settings,
    Term,
    TotalVariation,
    TotalVariationOfChange,
)
from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.losses import Absolute, Squared
from lampest.cost.problem import Data
from lampest.cost.terms import AnyTerm, Gradient, GradientOfRelativeChange, Misfit, RelativeChange
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.floating import two_point_resistance
from lampest.panel.response import ratio_from_pressure
from lampest.panel.scene import Scene
from lampest.posterior.covariance import DenseErrors, DenseMemory
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SampledErrors, SampledMemory
from lampest.recording.shapes import OralDisc, Rod, Shape, SuctionCup
from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.projected_newton import ProjectedNewton
from tests.estimates import log_errors, recording_of, rms

pytestmark = pytest.mark.slow

PANEL = Panel(8, 8)
ROD = Rod(kind="rod", centre_mm=(38, 33), diameter_mm=35, mass_g=500)
CUP = SuctionCup(
    kind="suction_cup",
    centre_mm=(38, 33),
    inner_diameter_mm=27,
    outer_diameter_mm=36,
    pressure_kpa=-9,
)
NOISE = 5e-3
COMPARING_TERMS = [
    TotalVariation(weight=0.05),
    LogRatio(weight=0.1, loss=Squared()),
    LogRatio(weight=1.0),
    TotalVariationOfChange(weight=0.05),
]
WIDE_PANEL = Panel(10, 10)
NOISY = 0.01
WEIGHTS = 10.0 ** np.arange(-2.5, -0.9, 0.5)
WIDE_ROD = Rod(kind="rod", centre_mm=(48, 43), diameter_mm=35, mass_g=500)
DISC = OralDisc(
    kind="oral_disc", centre_mm=(48, 43), diameter_mm=40, rim_width_mm=7, pressure_kpa=-5
)


@cache
def scene(load: Shape, frames: int, depth: float, seed: int) -> Recording:
    """Two unloaded frames, then `frames` of a load that swings by `depth`; noise of 0.5 %."""
    rng = np.random.default_rng(seed)
    course = Course(breathing_hz=1 / 9, breathing_depth=depth)
    time = np.arange(frames + 2.0) - 2
    contact, suction = load.mean_pressure(PANEL, 6.0)
    factors = (time >= 0) * np.stack(course.contact_and_suction(time))
    pressure = factors[0][:, None, None] * contact + factors[1][:, None, None] * suction
    cells = 3050 * np.exp(0.2 * rng.standard_normal(PANEL.shape)) * ratio_from_pressure(pressure)
    exact = two_point_resistance(cells)
    measured = exact * np.exp(NOISE * rng.standard_normal(exact.shape))
    return recording_of(Scene(PANEL), measured, 2, sigma=NOISE * exact, truth_cell_resistance=cells)


def estimated(recording: Recording, *terms: Term, **options: Any) -> Estimates:
    return reconstruct(
        recording, Estimator((Misfit(weighting="noise"), *terms), "reduced", **options)
    )


def error(recording: Recording, *terms: Term, bars: bool = False) -> float:
    """Root mean square of log r − log truth over all cells and frames."""
    return rms(log_errors(estimated(recording, *terms, **({} if bars else {"error_bars": False}))))


def powers(first: float, last: float, step: float = 0.5) -> Array:
    """Weights from 10**first to 10**last."""
    return 10.0 ** np.arange(first, last + step / 2, step)


def best(recorded: Recording, term: Term, weights: Array) -> float:
    """The error with the best of some weights, in hindsight."""
    return min(error(recorded, replace(term, weight=float(weight))) for weight in weights)


CHANGES = powers(-3, -0.5)
WINS: dict[
    str, tuple[tuple[Shape, int, float, int], tuple[Term, Array], list[tuple[Term, Array]], float]
] = {
    "total variation keeps edges that a gradient smears": (
        (CUP, 1, 0.0, 1),
        (TotalVariation(), powers(-2.5, -1)),
        [(Gradient(), powers(-9, -6, 1)), (Gradient(loss=Absolute()), powers(-5.5, -2.5, 1))],
        0.9,
    ),
    "the baseline is a better mean than the previous frame where the load moves": (
        (ROD, 5, 0.3, 2),
        (LogRatio(), powers(-1, 0.5)),
        [(RelativeChange(), powers(-3, 0))],
        0.9,
    ),
    "log_ratio is even in suction and pressure": (
        (CUP, 9, 0.3, 3),
        (LogRatio(loss=Squared(), reference="previous"), CHANGES),
        [(RelativeChange(), CHANGES)],
        0.95,
    ),
    "total variation of change does not pay for the cells' own pattern": (
        (CUP, 1, 0.0, 4),
        (TotalVariationOfChange(), powers(-2.5, -0.5)),
        [
            (TotalVariation(), powers(-2.5, -1)),
            (GradientOfRelativeChange(), powers(-5, -1, 1)),
            (GradientOfRelativeChange(loss=Absolute()), powers(-3.5, -0.5, 1)),
        ],
        0.95,
    ),
}


@pytest.mark.parametrize("claim", WINS)
def test_a_term_wins_on_its_scene(claim: str) -> None:
    place, own, alternatives, margin = WINS[claim]
    recorded = scene(*place)
    assert best(recorded, *own) < margin * min(
        error(recorded), *(best(recorded, *alternative) for alternative in alternatives)
    )


@pytest.mark.parametrize("term", COMPARING_TERMS, ids=lambda term: f"{term.kind}-{term.loss.kind}")
def test_known_references_leave_one_minimum(term: AnyTerm) -> None:
    """The relative change has up to three minima from starts some factor of four apart."""
    rng = np.random.default_rng(9)
    recorded = scene(CUP, 1, 0.0, 10)
    resting = recorded.truth_cell_resistance[0]
    measured = recorded.resistance[-1:]
    solver = ProjectedNewton(Cost(PANEL, (Misfit(weighting="noise"), term)), Settings())
    given = Given(measured=measured, sigma=recorded.sigma[-1:], previous=resting, baseline=resting)
    data = Data(given, measured, 100 * measured)
    starts = measured * np.exp(1.4 * rng.standard_normal((5, *PANEL.shape)) + 1.4)
    ends = [solved_from(solver, evaluated(solver.cost, data, start[None])) for start in starts]
    assert term.convex_in_log
    assert all(end.solved for end in ends)
    assert_allclose([end.objective for end in ends], ends[0].objective, rtol=1e-6)


@pytest.mark.parametrize("reads_both", [False, True])
def test_error_bars_include_the_error_of_the_baseline(reads_both: bool) -> None:
    rng = np.random.default_rng(8)
    shape = (3, 4)
    cells = 12
    known = 3000 * np.exp(
        0.2 * rng.standard_normal(shape) + 0.02 * rng.standard_normal((2, *shape))
    )
    measured = two_point_resistance(known[:1]) * np.exp(1e-3 * rng.standard_normal((1, *shape)))
    terms: tuple[Term, ...] = (Misfit(weighting="noise"), LogRatio(weight=0.05, loss=Squared()))
    terms += (LogRatio(weight=0.02, loss=Squared(), reference="previous"),) if reads_both else ()
    solver = ProjectedNewton(Cost(Panel(*shape), terms), Settings(tolerance=1e-12))
    given = Given(measured=measured, sigma=0.02 * measured, previous=known[0], baseline=known[1])
    data = Data(given, measured / 9, measured * 1e3)

    def moved(step: Array) -> Array:
        """Return log r from a previous frame and a baseline displaced by `step` in ln r."""
        previous, baseline = known * np.exp(step.reshape(2, *shape))
        shifted = replace(data, given=replace(data.given, previous=previous, baseline=baseline))
        return np.log(best_solution(solver, shifted, known[:1]).cell_resistance.ravel())

    carried = np.array([moved(step) - moved(-step) for step in 1e-3 * np.eye(2 * cells)]).T / 2e-3
    root = 0.1 * rng.standard_normal((2 * cells, 2 * cells))
    joint = root @ root.T
    memory = DenseMemory(joint.reshape(2, cells, 2, cells).swapaxes(1, 2))
    solution = best_solution(solver, data, known[:1])
    model = LinearModel(solution.at, np.zeros(0))
    dense = DenseErrors(model, memory)
    added = dense.covariance - DenseErrors(model).covariance
    expected = carried @ joint @ carried.T
    assert_allclose(added, expected, atol=0.03 * np.max(expected))
    assert_allclose(dense.variance, np.diag(dense.covariance), rtol=1e-10)
    shared = dense.memory().blocks[0, 1]
    expected = carried @ joint[:, cells:]
    assert_allclose(shared, expected, atol=0.03 * np.max(np.abs(expected)))
    samples = (root @ rng.standard_normal((2 * cells, SampledErrors.samples))).T
    sampled = SampledErrors(model, SampledMemory(samples.reshape(-1, 2, cells).swapaxes(0, 1)))
    assert_allclose(sampled.variance, dense.variance, rtol=0.6)


def recorded(cells: Array, seed: int, noise: float = NOISY) -> Recording:
    """Ten frames a second of such cells, the first two of them unloaded."""
    rng = np.random.default_rng(seed)
    exact = two_point_resistance(cells)
    measured = exact * np.exp(noise * rng.standard_normal(exact.shape))
    scene = Scene(Panel(*cells.shape[1:]))
    recording = recording_of(scene, measured, 2, sigma=noise * exact, truth_cell_resistance=cells)
    return replace(recording, time=recording.time / 10)


@cache
def arriving(kind: str, seed: int, frames: int = 18) -> Recording:
    """Return a recording of a pressed panel, a breathing or attaching disc, or a standing rod."""
    rng = np.random.default_rng(seed)
    count = np.arange(frames + 2) - 2
    breathing = 1 + 0.3 * np.sin(2 * np.pi * 0.1 * count)
    if kind == "panel":
        pattern = 2 + np.sin(
            np.add.outer(0.2 * np.arange(10), 0.15 * np.arange(10)) + rng.uniform(0, 6)
        )
    else:
        pattern = np.sum(
            (WIDE_ROD if kind == "rod" else DISC).mean_pressure(WIDE_PANEL, 10.0), axis=0
        )
    course = {
        "panel": breathing,
        "disc": breathing,
        "rod": np.ones(frames + 2),
        "attachment": count >= 5,
    }[kind]
    pressure = ((count >= 0) * course)[:, None, None] * pattern
    cells = (
        3050 * np.exp(0.2 * rng.standard_normal(WIDE_PANEL.shape)) * ratio_from_pressure(pressure)
    )
    return recorded(cells, seed + 1000)


@pytest.mark.parametrize(
    ("kind", "margin"), [("panel", 0.9), ("disc", 0.9), ("rod", 0.95), ("attachment", 0.85)]
)
def test_the_arrival_term_beats_the_best_single_weight(kind: str, margin: float) -> None:
    errors = []
    best_errors = []
    for seed in range(2):
        recording = arriving(kind, seed)
        errors.append(error(recording, Arrival(), bars=True))
        squared = LogRatio(loss=Squared(), reference="previous")
        best_errors.append(
            min(
                error(recording, replace(squared, weight=float(weight)), bars=True)
                for weight in WEIGHTS
            )
        )
    assert rms(errors) < margin * rms(best_errors)


def walk(seed: int, percent: float, frames: int = 12) -> Recording:
    """Cells that walk at random."""
    rng = np.random.default_rng(seed)
    panel = (6, 6)
    steps = percent / 100 * rng.standard_normal((frames, *panel))
    logarithm = 0.3 * rng.standard_normal(panel) + np.concatenate(
        [np.zeros((2, *panel)), np.cumsum(steps, axis=0)]
    )
    return recorded(3050 * np.exp(logarithm), seed + 1000)


@pytest.mark.parametrize(
    ("percent", "ratio", "coverage"),
    [(2.0, (0.93, 1.07), (0.93, 0.97)), (0.0, (0.75, 1.0), (0.95, 1.0))],
)
def test_error_bars_match_the_errors(
    percent: float, ratio: tuple[float, float], coverage: tuple[float, float]
) -> None:
    """Where cells rest, bars allow for a walk that is not there."""
    spread = []
    inside = []
    for seed in range(20):
        estimate = estimated(walk(seed, percent), Arrival())
        scores = log_errors(estimate) / np.stack(
            [step.bars.frame.deviation for step in estimate.steps]
        )
        spread.append(rms(scores))
        inside.append(np.mean(np.abs(scores) < 1.96))
    assert ratio[0] < rms(spread) < ratio[1]
    assert coverage[0] < np.mean(inside) < coverage[1]
