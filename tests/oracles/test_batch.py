"""Many panels at once against the solver for one: the same minima, each verified; what is none is handed back."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Estimator, LogGradient, Panel, Readings, Rod, Scene, Settings, Stream, Systematic, TwoPointReadout
from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.cost.terms import CellResistance, Gradient, Misfit, RelativeChange, Term
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import first_stream, reconstruct
from lampest.panel.network import inverse_of
from lampest.panel.readouts.floating import grounding
from lampest.panel.readouts.star_mesh import two_point_resistance
from lampest.panel.systematic import Possible, Shared
from lampest.posterior.batch import BatchErrors
from lampest.posterior.certainty import Certainty
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import LinearModel
from lampest.posterior.track import Track
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.solvers.multistart import best_solution
from lampest.solvers.projected_lbfgs import BatchOutcome, InverseHessians, serves, solve
from lampest.solvers.projected_newton import ProjectedNewton

SCENE = Scene(Panel(4, 5), TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7))
PANELS = 6


def frames(noise: float, seed: int = 1) -> Readings:
    """One frame of each of six panels, of cells that differ by a factor of ten."""
    random = np.random.default_rng(seed)
    cells = 3000 * np.exp(random.uniform(-1.2, 1.2, (PANELS, 4, 5)))
    exact = np.stack([two_point_resistance(one) for one in cells])
    return Readings.of(SCENE, exact * np.exp(noise * random.standard_normal(exact.shape)))


def batch_of(terms: tuple[Term, ...], readings: Readings) -> Evaluation:
    """The panels' problems at equal cells, with which they are compared."""
    estimator = Estimator(terms, "reduced")
    rest = np.full(readings.value.shape, 3000.0)
    data = estimator.data(readings, Background(SCENE, 1.0, rest, None, rest))
    cost = estimator.cost(SCENE, 1, partial=data.partial)
    data = data.of_panels(0)
    cells = np.clip(np.full(data.measured.shape, 3000.0), data.lower, data.upper)
    return Evaluation.at(cost, data, cells, np.tile(cost.weights, (len(rest), 1)))


def solved(batch: Evaluation) -> BatchOutcome:
    """From equal cells."""
    return solve(batch, InverseHessians.nothing(PANELS, 20), np.arange(PANELS), Settings())


@pytest.mark.parametrize(
    "terms",
    [
        (Misfit(),),
        (Misfit(), CellResistance(weight=1e-4)),
        (Misfit(weighting="noise"), Gradient(weight=1e-7)),
        (Misfit(), RelativeChange(weight=0.1)),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 1e-3, 2e-2])
def test_each_panel_ends_where_the_solver_for_one_ends(terms: tuple[Term, ...], noise: float) -> None:
    batch = batch_of(terms, frames(noise))
    assert serves(batch.cost, batch.data)
    kept = InverseHessians.nothing(PANELS, 20)
    found = solve(batch, kept, np.arange(PANELS), Settings())
    assert found.solved.sum() >= PANELS - 2
    for number in np.flatnonzero(found.solved):
        one = batch.data.some(int(number))
        alone = best_solution(ProjectedNewton(batch.cost, Settings()), one, np.full(one.measured.shape, 3000.0))
        assert alone.strict
        scale = float(np.sum((one.measured / 1e3) ** 2))
        assert abs(found.points.at.objectives[number] - alone.objective) <= 1e-6 * alone.objective + 1e-6 * scale
        assert_allclose(found.points.at.cell_resistance[number], alone.cell_resistance, rtol=1e-5)
    again = solve(found.points.at, kept, np.arange(PANELS), Settings())
    assert again.solved[found.solved].all() and again.iterations[found.solved].max() == 0


def test_networks_solved_together_are_those_solved_alone() -> None:
    random = np.random.default_rng(3)
    for shape in ((5, 4, 7), (5, 7, 4), (5, 1, 3)):
        conductance = np.exp(random.uniform(-9, 0, shape))
        ties = grounding(1 / conductance)
        together = inverse_of(conductance, ties)
        for one, tie, alone in zip(conductance, ties, together, strict=True):
            assert_allclose(alone, inverse_of(one, tie), rtol=1e-10)
    conductance[2, 0, 1] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        inverse_of(conductance, ties)


def test_a_panel_that_readings_leave_open_is_handed_back_and_costs_no_other() -> None:
    readings = frames(1e-3)
    readings.seen[2, 1] = 0.0
    batch = batch_of((Misfit(),), Readings(readings.value, readings.sigma, readings.side, readings.seen))
    batch.data.given.seen[2, :, 1] = 0.0
    found = solved(batch)
    assert not found.solved[2] and found.solved.sum() >= PANELS - 2


@pytest.mark.parametrize("penalty", [(), (CellResistance(weight=1e-4),), (Gradient(weight=1e-7),)])
def test_error_bars_made_together_are_those_made_one_by_one(penalty: tuple[Term, ...]) -> None:
    batch = batch_of((Misfit(), *penalty), frames(1e-3))
    found = solved(batch)
    hidden, several = Systematic(series_ohm=20, inl_lsb=0.5, wire_ohm_per_cell=0.2, reading_error=0.01), np.eye(27)
    shared = [
        None,
        Shared.of(SCENE),
        Shared.of(SCENE, hidden=Possible(hidden, None)),
        Shared.of(SCENE, hidden=Possible(hidden, several + np.tri(27) / 9)),
        Shared(Systematic(reference_tolerance=0.01, channel_spread_ohm=3), SCENE),
        Shared.of(SCENE),
    ]
    noise = FrameNoise(SCENE, 4, 1e-3, np.full((5, 1), 1e-3), np.full((5, 2), 1e-3))
    tracks = [Track(one, noise=noise if number % 2 else None) for number, one in enumerate(shared)]
    tracks[5] = replace(tracks[1], baseline=Certainty(*np.full((6, 4, 5), 0.01)))
    inside = np.flatnonzero(BatchErrors.inside(found.points))
    assert len(inside) >= PANELS - 1
    sigma = np.array([np.nan, *(0.3 for _ in penalty)])
    sigmas = np.tile(sigma, (len(inside), 1))
    some = BatchErrors(found.points.some(inside), [tracks[number] for number in inside], sigmas)
    for number, (track, bars) in zip(inside, some.bars(), strict=True):
        at = Evaluation.at(batch.cost, batch.data.some(int(number)), found.points.at.cell_resistance[number])
        before, alone = tracks[number].advanced(LinearModel(at, np.zeros(0), weight_sigma=tuple(sigma)))
        for name, expected in vars(alone.frame).items():
            assert_allclose(getattr(bars.frame, name), expected, rtol=1e-8, atol=1e-12)
        assert_allclose(bars.reading, alone.reading, rtol=1e-8)
        assert (bars.change is None) == (alone.change is None) == (number != 5)
        if bars.change is not None and alone.change is not None:
            assert_allclose(bars.change.deviation, alone.change.deviation, rtol=1e-8)
        assert_allclose(track.answers[0], before.answers[0], rtol=1e-8, atol=1e-12)
        assert_allclose(track.deviation, before.deviation, rtol=1e-8)


def test_a_cell_at_a_bound_gets_its_bars_alone() -> None:
    batch = batch_of((Misfit(),), frames(0.1))
    ended = solved(batch)
    cells, data = ended.points.at.cell_resistance, batch.data
    at_bound = ((cells <= data.lower) | (cells >= data.upper)).any(axis=(1, 2, 3))
    assert at_bound.any() and not BatchErrors.inside(ended.points)[at_bound].any()


def test_inputs_that_nobody_gives_stand_as_absent_for_every_panel() -> None:
    estimator, readings = Estimator((Misfit(),), "reduced"), frames(0.0)
    data = estimator.data(readings, Background(SCENE, 1.0, None, None, None))
    named = data.of_panels(0).flat
    sources, given = dict(data.given.sources()), dict(data.given.named())
    missing = sources.keys() - given.keys()
    assert missing
    for name in missing:
        assert named[name].size and np.all(named[name] == sources[name].absent), name


@pytest.mark.parametrize("terms", [(Misfit(),), (Misfit(weighting="noise"), LogGradient(weight=0.1))])
def test_frames_that_are_solved_in_blocks_are_those_that_are_solved_one_by_one(
    terms: tuple[Term, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    rod = Rod(centre_mm=(55, 55), diameter_mm=30, mass_g=500)
    scene = Scene(Panel(8, 8), TwoPointReadout(adc_bits=12, noise_lsb=0.7), 140.0)
    recording = simulate(Simulation(1, 4, scene, frames=9, frame_period_s=0.25, loads=(rod,)))
    recorded = recording.recorded.copy()
    measured = recording.measured_frames()
    recorded[measured[3], 2, 3] = np.nan  # such a frame is solved alone, among the others
    recorded[measured[5]] = np.nan
    prepared = Prepared(replace(recording, recorded=recorded, raw_sums=None))
    pushed, push = list[Stream](), Stream.push
    monkeypatch.setattr(Stream, "push", lambda stream, readings: pushed.append(stream) or push(stream, readings))
    found = reconstruct(prepared, Estimator(terms, "reduced"))
    assert len(pushed) == 3  # the first frame, and those that are not read whole
    stream = first_stream(prepared.recording, prepared.noise.readings, found.estimator, prepared.noise)
    for frame, together in zip(measured, found.steps, strict=True):
        stream, step = stream.push(prepared.noise.readings[int(frame)])
        assert together.status == step.status
        # Where a reading is missing, a solve ends within a hundredth of its cell's standard deviation.
        tolerance = 1e-3 if frame == measured[3] else 1e-7
        assert_allclose(together.cell_resistance, step.cell_resistance, rtol=tolerance)
        if step.bars is None:
            assert together.bars is None and frame == measured[5]
            continue
        for name, expected in vars(step.bars.frame).items():
            assert_allclose(getattr(together.bars.frame, name), expected, rtol=10 * tolerance, atol=1e-9)
        assert_allclose(together.bars.change.deviation, step.bars.change.deviation, rtol=10 * tolerance)
        assert_allclose(together.bars.reading, step.bars.reading, rtol=10 * tolerance)
