"""Weights chosen by the data against definitions, the cost stated anew, and hindsight."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import lampest
from docs.studies import real
from docs.studies.simulated_calibration import PRIORS, SETTINGS, calibration, uniform_tail
from docs.studies.weight_curves import WeightSubject, bound_evidence, solve_at
from docs.studies.withheld import predictions
from lampest import (
    Array,
    Bounds,
    Misfit,
    Panel,
    Readings,
    Recording,
    Scene,
    read_run,
    two_point_resistance,
)
from lampest.cost.given import Background
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import (
    CellResistance,
    Gradient,
    LogGradient,
    LogRatio,
    Term,
    TotalVariation,
)
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.estimate.stream import Stream
from lampest.estimate.weights import AutoWeight, EvidencePoint, WeightSearch, with_chosen_weights
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.trust_region import SubproblemStep
from lampest.posterior import sampled
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import LinearModel
from lampest.posterior.spectrum import Spectrum, best_weight, settled_weights
from lampest.recording.recording import baseline_readings, deciding_frames
from lampest.runs.config import Case
from lampest.solvers.multistart import best_solution
from lampest.solvers.solution import Settings
from tests.estimates import recording_of, rms
from tests.least_cost import LeastCost, Penalty

ABSOLUTE = "log_ratio, absolute"
SHAPE = (8, 7)
AUTO = "auto"
COARSE = TwoPointReadout(adc_bits=12, readings=1, noise_lsb=1.0, reference_ohm=500.0)
RUN = """schema: 1
recordings: [mine.h5]
estimators:
  smooth: {terms: {misfit: {weighting: noise}, log_gradient: {weight: 30.0}}, formulation: reduced}
"""
NOISE = 0.02
ROUNDING = 1e-10  # relative
SCALE_ERROR = 0.17  # of a noise by 56 readings; measured 0.12 too small
SETTLED = 0.2  # relative: a weight is settled when it moves by less; measured 0.08
SIGMA_ERROR = 0.03  # relative, of the deviation of log λ; limit: three times the value measured
MAX_WEIGHT_SIGMA = 0.5  # of log λ; measured at most 0.26
MAX_SIGMA_OF_OPEN_CELLS = 0.7  # the same where most cells are open; measured at most 0.61
MAX_LOG_RATIO = 2.5  # of two rules' weights; measured 2.2
NEARLY_AS_GOOD = 1.4  # of the least error by any of four weights; measured 1.1
MINIMUM = 1e-4  # of log λ, at the least risk
UNLIKELY = 0.01
UNIFORM = 1e-3  # tail probability; measured at least 0.077
HALF = 0.5  # of the error of interpolation; measured 0.12
SEVERAL_SIGMA = 2  # that the noise hides of a reading; measured 4.5
MIN_COVERAGE = 0.8  # of thirty 95 % intervals: less four standard deviations
DIFFERENCE_ERROR = 1e-5  # relative, of derivatives by differences
MANY = 20  # cells at a bound; measured 14


def cells_of(seed: int, shape: tuple[int, int] = SHAPE) -> Array:
    rng = np.random.default_rng(seed)
    cells = 3050 * np.exp(0.2 * rng.standard_normal(shape))
    row, column = rng.integers(1, 4, 2)
    cells[row : row + 3, column : column + 3] *= 0.15
    return cells


def measured_data(
    estimator: Estimator, cells: Array, noise: float, seed: int, specified: float | None = None
) -> Data:
    exact = two_point_resistance(cells)
    measured = exact * (1 + noise * np.random.default_rng(seed).standard_normal(exact.shape))
    scene = Scene(Panel(*cells.shape))
    return estimator.data(
        Readings.of(scene, measured[None], (specified or noise) * exact[None]), Background(scene)
    )


@pytest.mark.parametrize(("number", "factor"), [(1, 1e-3), (1, 1.0), (1, 30.0), (2, 1.0)])
def test_the_risk_at_the_truth_is_the_mean_squared_error(number: int, factor: float) -> None:
    """The risk of the linear estimate is a sum over the noise, to which the point's errors add."""
    estimator = Estimator(
        (Misfit(), Gradient(weight=1e-5), CellResistance(weight=1e-7)), formulation="reduced"
    )
    data = measured_data(estimator, cells_of(1), 0.003, 2)
    solution = best_solution(estimator.problem(Scene(Panel(*SHAPE)), 1, 1.0), data, None)
    model = LinearModel(solution.at, solution.dual)
    weights = np.where(np.arange(3) == number, factor, 1.0) * model.at.weights
    jacobian = DenseErrors(model).jacobian
    rows = model.penalty_jacobian.toarray()[:, model.free]
    size = weights[model.penalty_term]
    pull = rows.T @ (weights[model.penalty_term] * model.penalty)
    inverse = np.linalg.inv(
        jacobian.T @ jacobian + (rows.T * size) @ rows + 1e-4 * model.scale * np.eye(len(pull))
    )
    variance = np.sum((inverse @ jacobian.T * model.noise) ** 2)
    exact = Spectrum.of(model, number).risk(weights[number])
    assert_allclose(exact, np.sum((inverse @ pull) ** 2) + variance, rtol=ROUNDING)
    own = model.penalty_term == number
    lost = weights[number] * inverse @ rows[own].T @ rows[own]
    covariance = np.diag(np.linspace(1.0, 2.0, model.at.cell_resistance.size))
    doubted = Spectrum.of(model, number, covariance).risk(weights[number])
    assert_allclose(
        doubted - exact,
        np.trace(lost @ covariance[np.ix_(model.free, model.free)] @ lost.T),
        rtol=1e-6,
    )


@pytest.mark.parametrize("most_cells", [1000, 10], ids=["matrices", "samples"])
def test_the_evidence_chooses_its_fixed_point_with_an_uncertainty(
    most_cells: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lampest.estimate.weights.MAX_CELLS", most_cells)
    auto = AutoWeight(rule="evidence" if most_cells > 56 else None)
    estimator = Estimator((Misfit(), Gradient(weight=AUTO)), "reduced", auto_weight=auto)
    scene = Scene(Panel(*SHAPE))
    data = measured_data(
        estimator, np.linspace(2800, 3300, 56).reshape(SHAPE), 0.01, 2, specified=0.007
    )
    chosen = with_chosen_weights(estimator, scene, data, None)
    solution = best_solution(chosen.problem(scene, 1, 1.0), data, None)
    errors = DenseErrors(LinearModel(solution.at, solution.dual))
    scale = EvidencePoint(1.0, [], solution.cell_resistance, errors).residual_scale
    assert abs(scale - 0.01 / 0.007) < SCALE_ERROR
    model = LinearModel(solution.at, solution.dual, deviation=scale * data.deviation)
    assert float(chosen.terms[1].weight) == pytest.approx(
        settled_weights(model, [1])[1], rel=SETTLED
    )
    assert np.isnan(chosen.weight_sigma[0])
    assert chosen.weight_sigma[1] == pytest.approx(
        np.sqrt(2 / DenseErrors(model).determined(1)), rel=SIGMA_ERROR
    )


@pytest.mark.slow
@pytest.mark.parametrize("frame", [0, 10, 17])
def test_evidence_and_risk_choose_similar_weights_on_a_real_sensor(frame: int) -> None:
    """Open cells differ from their neighbours by megohms."""
    recording = Recording.load("data/insole_standing.h5", slice(frame, frame + 3))
    weights = []
    for rule in ("risk", "evidence"):
        auto = AutoWeight(rule=rule)
        estimator = Estimator(
            (Misfit(weighting="noise"), Gradient(weight=AUTO)), auto_weight=auto, error_bars=False
        )
        step = reconstruct(recording, estimator).steps[0]
        assert 0 < step.weight_sigma[1] < MAX_SIGMA_OF_OPEN_CELLS
        weights.append(step.weights[1])
    assert abs(np.log(weights[1] / weights[0])) < MAX_LOG_RATIO


@pytest.mark.slow
@pytest.mark.parametrize("static", [0.0, 5.0], ids=["uneven cells", "static errors"])
def test_a_large_panel_distinguishes_uneven_cells_from_static_errors(static: float) -> None:
    """Cells differ at random by 30 %, and readings err by five times their noise."""
    rng = np.random.default_rng(3)
    shape = (24, 20)
    readout = TwoPointReadout(adc_bits=10, noise_lsb=2.0, readings=1, reference_ohm=300.0)
    cells = 3000 * np.exp(0.3 * rng.standard_normal(shape))
    cells[6:12, 5:11] *= 0.3
    codes = readout.volt_from_recorded(two_point_resistance(cells)) / readout.lsb_volt
    codes = np.round(
        codes + 2.0 * static * rng.standard_normal(shape) + 2.0 * rng.standard_normal((2, *shape))
    )
    recorded = readout.recorded_from_volt(codes * readout.lsb_volt)
    recording = Recording(
        Scene(Panel(*shape), readout), recorded, np.arange(2.0), np.array([0, 1], dtype=np.uint8)
    )

    def error(weight: float | str) -> float:
        terms = [Misfit(weighting="noise"), LogGradient(weight=weight)]
        return rms(
            np.log(
                lampest.reconstruct(recording, terms, error_bars=False).cell_resistance[0] / cells
            )
        )

    assert error(AUTO) < NEARLY_AS_GOOD * min(error(weight) for weight in (0.1, 3.0, 30.0, 300.0))


def test_the_risk_of_several_solves_and_penalties_is_least_at_the_chosen_weights() -> None:
    estimator = Estimator((Misfit(), Gradient(weight=AUTO), CellResistance(weight=AUTO)), "reduced")
    data = [measured_data(estimator, cells_of(seed), 0.01, 2) for seed in (1, 2)]
    search = WeightSearch(
        estimator.cost(Scene(Panel(*SHAPE)), 1, partial=False), tuple(data), Settings()
    )
    assert search.begun == [1.0, 1.0, 1.0] and search.open_terms == [1, 2]
    weights, sigma = search.by_risk(data[0].uniform_start)
    for number in (1, 2):
        spectra = search.spectra(number, weights)
        assert np.log(best_weight(spectra) / weights[number]) == pytest.approx(0, abs=MINIMUM)
        information = sum(spectrum.information(weights[number]) for spectrum in spectra)
        assert sigma[number] == pytest.approx(information**-0.5, rel=MINIMUM)


def test_a_warning_names_a_chosen_weight_that_prevents_the_fit() -> None:
    """A weight of log r is a thousand times too large."""
    truth = np.where(np.indices((2, 6, 6))[2] < 3, 2000.0, 4000.0)
    values = lampest.two_point_resistance(truth)
    scene = lampest.Scene(lampest.Panel(6, 6), lampest.TwoPointReadout(readings=20, noise_lsb=0.7))
    recording = lampest.Recording.from_array(values, baseline=1, scene=scene)
    misfit = lampest.Misfit(weighting="noise")
    estimate = lampest.reconstruct(
        recording, [misfit, lampest.LogGradient(weight=1e6)], formulation="reduced"
    )
    assert estimate.solved.all() and not any(
        "readings are missed" in line for line in estimate.checks
    )
    warned = replace(estimate, automatic=True).checks[0]
    assert warned.startswith(
        "with the weight that was chosen for log_gradient readings are missed by"
    )
    chosen = lampest.reconstruct(recording, [misfit, lampest.LogGradient()], formulation="reduced")
    assert chosen.automatic and not any("readings are missed" in line for line in chosen.checks)


@pytest.mark.slow
def test_uniform_values_lie_within_their_bands_and_others_do_not() -> None:
    rng = np.random.default_rng(1)
    tails = [uniform_tail(rng.uniform(size=50)) for _ in range(60)]
    # Of 60 tails 5 % and half, with three standard deviations
    assert np.mean(np.array(tails) < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 60)
    assert np.median(tails) > 0.5 - 3 * 0.5 / np.sqrt(60)
    assert uniform_tail(rng.uniform(size=100) ** 2) < UNLIKELY, "biased"
    assert uniform_tail(0.5 + 0.4 * (rng.uniform(size=100) - 0.5)) < UNLIKELY, (
        "bars that are too wide"
    )
    assert uniform_tail(np.round(rng.uniform(size=100))) < UNLIKELY, "bars that are too narrow"


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [False, True], ids=["known", "chosen"])
@pytest.mark.parametrize("level", SETTINGS)
@pytest.mark.parametrize("name", [name for name in PRIORS if name != ABSOLUTE])
def test_intervals_contain_draws_of_the_prior_at_their_stated_rate(
    name: str, level: str, chosen: bool
) -> None:
    """2,880 cells are drawn, half as many where the weight is chosen; 40 draws have 40 weights."""
    drawn = calibration(PRIORS[name], *SETTINGS[level], chosen, 40 if chosen else 80, 7)
    coverage_50, coverage_80, coverage_95 = drawn.coverage
    if chosen:
        # The cells of a draw share its weight, which widens what the coverage varies by.
        assert 0.42 < coverage_50 < 0.62 and 0.72 < coverage_80 < 0.93 and coverage_95 > 0.88
        low, high = np.quantile(drawn.weights, (0.1, 0.9))
        assert low < 2 and high > 0.5, "80 % of the weights reach within a factor of two of 1"
    else:
        assert (
            abs(coverage_50 - 0.5) < 0.05
            and abs(coverage_80 - 0.8) < 0.04
            and abs(coverage_95 - 0.95) < 0.02
        ), "five standard deviations of 2,880 cells, of which neighbours agree"
        assert np.allclose(drawn.weights, 1)
    assert min(drawn.uniformity) > UNIFORM


@pytest.mark.slow
@pytest.mark.parametrize("level", SETTINGS)
def test_intervals_contain_draws_of_laplace_under_an_absolute_loss_with_a_chosen_weight(
    level: str,
) -> None:
    """At medium noise 92 % hold, less three standard deviations of 1,440 cells."""
    drawn = calibration(PRIORS[ABSOLUTE], *SETTINGS[level], True, 40, 7)
    assert 0.895 < drawn.coverage[2] < 0.98


def test_bars_of_changes_that_noise_hides_are_as_wide_as_the_changes() -> None:
    """The weight of least risk is 10 times that of the prior, and holds all changes at 0."""
    drawn = calibration(PRIORS[ABSOLUTE], 0.06, 0.06, True, 3, 11)
    assert np.median(drawn.weights) > 2
    assert np.sqrt(np.mean(drawn.scores**2)) < 1.4


def going_over(folder: Path) -> lampest.Recording:
    """Smooth loads that go over a panel."""
    panel = Panel(7, 7, 8.0)
    rng = np.random.default_rng(4)
    x, y = panel.places_mm
    at = np.linspace(10, 40, 6)
    cells = np.stack(
        [2000 * np.exp(-2.5 * np.exp(-((x - centre) ** 2 + (y - 24) ** 2) / 400)) for centre in at]
    )
    codes = COARSE.volt_from_recorded(COARSE.exact_reading(cells)) / COARSE.lsb_volt
    codes = np.round(codes + rng.standard_normal(codes.shape))
    recording = recording_of(
        Scene(panel, COARSE), COARSE.recorded_from_volt(codes * COARSE.lsb_volt)
    )
    recording.save(folder / "mine.h5")
    (folder / "run.yaml").write_text(RUN)
    return replace(recording, name="mine")


def test_withheld_readings_are_predicted_better_than_by_interpolation(tmp_path: Path) -> None:
    recording = going_over(tmp_path)
    (case,) = read_run(tmp_path / "run.yaml").cases
    predicted = [
        prediction
        for prediction in predictions(recording, case, 0.1, 1, 0)
        if prediction.factor == 1
    ]
    assert len(predicted) == 6 and all(
        prediction.solved and prediction.readings == 5 for prediction in predicted
    )
    shares = [prediction.error / prediction.interpolated for prediction in predicted]
    assert np.median(shares) < HALF
    assert np.median([prediction.hidden for prediction in predicted]) > SEVERAL_SIGMA


@pytest.mark.slow
def test_the_table_of_real_recordings_has_a_row_for_every_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimators = {name: real.ESTIMATORS[name] for name in ("`log_gradient`", "`cell_resistance`")}
    monkeypatch.setattr(real, "ESTIMATORS", estimators)
    study = real.Withheld.of(going_over(tmp_path), 0.1, 3)
    rows = {row.method: row for row in real.rows(study)}
    assert list(rows) == [*real.OTHERS, *estimators] and all(
        row.solved == 1 for row in rows.values()
    )
    assert np.isnan(study.recording.recorded[study.held]).all() and study.held.sum() == 6 * 5
    assert rows["interpolation"].ratio == 1
    chosen = rows["`log_gradient`"]
    assert chosen.ratio < HALF and chosen.covered > MIN_COVERAGE
    assert chosen.weight_sigma < 2 * MAX_WEIGHT_SIGMA
    assert all(
        rows[name].ratio < 1
        for name in ("fixed point (Medrano-Sánchez)", "truncated inversion, best rank")
    )
    assert chosen.ratio < min(row.ratio for row in rows.values() if row is not chosen)


def bump() -> Recording:
    """Two unloaded frames and one with a bump, with relative noise."""
    rng = np.random.default_rng(5)
    cells = 3000 * np.exp(0.1 * rng.standard_normal((3, 4, 5)))
    cells[2, 1:3, 1:4] *= 0.3
    exact = two_point_resistance(cells)
    measured = exact * np.exp(NOISE * rng.standard_normal(exact.shape))
    return recording_of(
        Scene(Panel(4, 5)), measured, 2, sigma=NOISE * exact, truth_cell_resistance=cells
    )


def subject(penalty: Term, held: Recording, bounds: Bounds | None = None) -> WeightSubject:
    """One penalty beside the misfit."""
    estimator = Estimator((Misfit(), penalty), "reduced", bounds=bounds or Bounds())
    return WeightSubject.of(Case(Path("bump.h5"), "", "bump", "one", estimator, "", ""), held)


def test_the_evidence_at_each_estimate_is_that_of_laplace() -> None:
    """−2 log ∫ exp(−cost/2s²) du over a Gaussian prior of rank m − 1, but for a constant."""
    recording = bump()
    problem = subject(Gradient(weight="auto"), recording, Bounds("none", "none"))
    scale = float(np.mean(recording.sigma[2] ** 2))

    def laplace(weight: float) -> tuple[float, float]:
        point = solve_at(problem, weight, None)
        stated = LeastCost.of(problem.data, Penalty("misfit", 1.0), Penalty("gradient", weight))
        residuals, jacobian = stated.as_squares(np.log(point.cells[0]).ravel(), 0.0)
        curvature = jacobian.T @ jacobian / scale + 1e-4 * np.eye(jacobian.shape[1])
        volume = np.linalg.slogdet(curvature)[1] - (jacobian.shape[1] - 1) * np.log(weight / scale)
        return point.evidence, residuals @ residuals / scale + volume

    first = laplace(1e-6)
    second = laplace(1e-4)
    assert abs(first[1] - second[1]) > 1
    assert_allclose(first[0] - second[0], first[1] - second[1], atol=DIFFERENCE_ERROR)


def test_a_held_cell_contributes_the_integral_of_its_density() -> None:
    """The cost's slope and Gauss-Newton curvature by differences, the integral by quadrature."""
    recording = bump()
    subject_of_bump = subject(CellResistance(weight="auto"), recording)
    point = solve_at(subject_of_bump, 0.3, None)
    at = Evaluation.at(subject_of_bump.with_weight(0.3), subject_of_bump.data, point.cells)
    model = LinearModel(at, np.zeros(0))
    bound = np.flatnonzero(model.at_lower | model.at_upper)
    assert 0 < len(bound) < MANY
    step = 1e-5

    def residuals(cell: int, change: float) -> np.ndarray:
        cells = point.cells.copy()
        cells.flat[cell] *= np.exp(change)
        data = two_point_resistance(cells) - subject_of_bump.data.measured
        return np.concatenate([data.ravel(), np.sqrt(0.3) * cells.ravel()])

    expected = 0.0
    for cell in bound:
        above = residuals(int(cell), step)
        below = residuals(int(cell), -step)
        curvature = float(np.sum(((above - below) / (2 * step)) ** 2)) / model.scale
        slope = abs(float(np.sum(above**2) - np.sum(below**2)) / (2 * step)) / model.scale
        reach = 60 / max(slope, np.sqrt(curvature))
        density, _ = quad(
            lambda t, g=slope, a=curvature: np.exp(-(g * t + a * t * t) / 2), 0, reach, epsabs=0
        )
        expected += np.log(2 * np.pi) - 2 * np.log(density)
    assert_allclose(bound_evidence(model), expected, rtol=DIFFERENCE_ERROR)


def test_several_deciding_frames_share_one_solved_baseline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(5)
    scene = Scene(Panel(3, 4))
    cells = np.full((7, 3, 4), 1000.0)
    cells[2:, 1, 1:3] /= 3
    exact = np.array([two_point_resistance(frame) for frame in cells])
    measured = exact * (1 + 1e-3 * rng.normal(size=cells.shape))
    recording = recording_of(scene, measured, 2, sigma=1e-3 * exact)
    estimator = Estimator([Misfit(weighting="noise"), LogRatio(weight="auto")])
    begun = list[Stream]()
    begin = Stream.with_rest
    monkeypatch.setattr(Stream, "with_rest", lambda stream: begun.append(stream) or begin(stream))
    reconstruct(recording, estimator)
    read = recording.readings()
    assert len(deciding_frames(recording, read, baseline_readings(recording, read))) > 1
    # One is for the choice of the weight, and one with the chosen weight for the frames.
    assert len(begun) == 2


@pytest.mark.slow
def test_the_evidence_of_a_large_panel_draws_the_errors_of_each_estimate_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    draws = list[SubproblemStep]()
    estimates = list[EvidencePoint]()
    solve, settle = sampled.steihaug, WeightSearch._solved

    def counted(*arguments: Any) -> SubproblemStep:
        draws.append(solve(*arguments))
        return draws[-1]

    def noted(*arguments: Any) -> EvidencePoint:
        estimates.append(settle(*arguments))
        return estimates[-1]

    monkeypatch.setattr(sampled, "steihaug", counted)
    monkeypatch.setattr(WeightSearch, "_solved", noted)
    cells = cells_of(1, (21, 20))
    estimator = Estimator([Misfit(weighting="noise"), TotalVariation(weight=AUTO)])
    data = measured_data(estimator, cells, 1e-3, 1)
    with_chosen_weights(estimator, Scene(Panel(*cells.shape)), data, None)
    assert len(estimates) > 1
    assert len(draws) == sampled.SampledErrors.probes * len(estimates)
