"""Programs with own unknowns, constraints and costs end in a right answer or in a sentence."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose
from random_program import RandomProgram, drawn

import lampest
from lampest import OwnProgram
from lampest.formulation.ipopt import Interface
from lampest.panel.readouts.tolerances import simulated

IPOPT_TOLERANCE = 1e-12  # of the default settings
SAME_COST = 1e-6  # relative, and of kilo-ohm or millisiemens
VERIFIED = "local optimum verified"
NOISE = lampest.Misfit(weighting="noise")
SMOOTH: list[lampest.Term] = [NOISE, lampest.LogGradient(weight=1.0)]
READOUT = lampest.TwoPointReadout(noise_lsb=0.7, readings=20)


def recording_of(
    shape: tuple[int, int], frames: int = 2, seed: int = 1, spread: float = 0.4
) -> lampest.Recording:
    """An unloaded frame and further ones with other cells, with noise."""
    scene = lampest.Scene(lampest.Panel(*shape), READOUT, 140.0)
    rng = np.random.default_rng(seed)
    cells = 3000 * np.exp(spread * rng.standard_normal((frames, *shape)))
    exact = simulated(scene.circuit, cells, scene, np.zeros(shape[0]), np.zeros(shape[1])) + 140.0
    readings = exact + scene.circuit.sigma(exact) * rng.standard_normal(exact.shape)
    return lampest.Recording.from_array(readings, unit="ohm", baseline=1, scene=scene)


def program_of(
    shape: tuple[int, int] = (3, 3), terms: list[lampest.Term] = SMOOTH, **options: Any
) -> OwnProgram:
    return lampest.program(recording_of(shape), terms, **options)


def cells_of(program: OwnProgram) -> casadi.SX:
    """Cells in kilo-ohm, (cells, 1)."""
    return casadi.vec(program.cells().T) / 1000


# Programs without a free direction


@pytest.mark.parametrize("terms", [[lampest.Misfit()], [NOISE]])
@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (2, 1), (4, 1)])
def test_a_panel_of_one_line_is_what_was_measured(
    shape: tuple[int, int], terms: list[lampest.Term]
) -> None:
    """Each reading is its own cell, with the readings' noise."""
    program = program_of(shape, terms)
    solved = program.solve()
    data = program.evaluations[0].data
    assert solved.status == VERIFIED
    assert_allclose(solved.cell_resistance, data.measured, rtol=1e-6)
    if terms == [NOISE]:
        assert_allclose(solved.cell_resistance_errors, data.sigma, rtol=1e-3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (3, 2)])
@pytest.mark.parametrize("formulation", ["nodal", "per_pixel"])
def test_a_program_of_fixed_cells_is_verified_without_errors(
    shape: tuple[int, int], formulation: str
) -> None:
    bounds = lampest.Bounds("none", "none")
    program = program_of(shape, formulation=formulation, bounds=bounds)
    solved = program.subject_to("fixed", cells_of(program), 3.0).solve()
    assert solved.status == VERIFIED
    assert_allclose(solved.cell_resistance, 3000.0, rtol=1e-9)
    assert_allclose(solved.cell_resistance_errors, 0.0)


def test_more_equations_than_unknowns_have_a_sentence() -> None:
    program = program_of()
    program = program.subject_to("fixed", cells_of(program), 3.0)
    twice = program.subject_to("again", cells_of(program)[0], 3.0).solve()
    assert twice.status == "the program has more equations than unknowns"
    assert twice.iterations == 0 and np.isnan(twice.cell_resistance).all()


def test_an_equation_that_repeats_another_changes_nothing() -> None:
    program = program_of()
    once = program.subject_to("fixed", cells_of(program)[0], 3.0)
    twice = once.subject_to("again", cells_of(program)[0], 3.0).solve()
    assert twice.status == VERIFIED
    assert_allclose(twice.cell_resistance, once.solve().cell_resistance, rtol=1e-6)
    assert_allclose(twice.cell_resistance_errors, once.solve().cell_resistance_errors, rtol=1e-4)


# Frames without readings


def without_readings(frames: int = 3) -> lampest.Recording:
    recording = recording_of((3, 3), frames)
    resistance = recording.resistance.copy()
    resistance[-1] = np.nan
    return lampest.Recording.from_array(resistance, unit="ohm", baseline=1, scene=recording.scene)


@pytest.mark.parametrize("penalty", [lampest.CellResistance(1e-3), lampest.LogGradient(1.0)])
def test_a_frame_without_readings_has_no_estimate(penalty: lampest.Term) -> None:
    recording = without_readings()
    solved = lampest.program(recording, [NOISE, penalty], frames=[2]).solve()
    estimate = lampest.reconstruct(recording, [NOISE, penalty])
    assert solved.status == estimate.status[-1]
    assert solved.status.startswith("too few of the frame's readings are values")
    for values in (solved.cell_resistance, solved.cell_resistance_errors):
        assert np.isnan(values).all()
    assert np.isnan(estimate.cell_resistance[-1]).all()


def test_a_frame_without_readings_is_determined_by_one_that_an_own_cost_ties_it_to() -> None:
    program = lampest.program(without_readings(), SMOOTH, frames=[1, 2])
    walk = 100 * (casadi.log(program.cells(1)) - casadi.log(program.cells(0)))
    solved = program.with_cost(casadi.sumsqr(walk)).solve()
    assert solved.status == VERIFIED
    errors = solved.cell_resistance_errors / solved.cell_resistance
    assert_allclose(errors[1], np.sqrt(errors[0] ** 2 + 0.01**2), rtol=0.05)


def test_terms_that_compare_need_readings_of_the_unloaded_panel() -> None:
    resistance = recording_of((3, 3)).resistance.copy()
    resistance[0] = np.nan
    scene = recording_of((3, 3)).scene
    recording = lampest.Recording.from_array(resistance, unit="ohm", baseline=1, scene=scene)
    solved = lampest.program(recording, [NOISE, lampest.LogRatio(weight=1.0)]).solve()
    assert solved.status.startswith("too few of the unloaded panel's readings are values")


# Optima that are none


def unbounded(program: OwnProgram, cost: Callable[[casadi.SX], Any], **about: Any) -> str:
    program, unknown = program.with_unknown("own", **about)
    return program.with_cost(cost(unknown)).solve().status


def test_a_cost_that_falls_without_limit_is_no_optimum() -> None:
    limitless = "the cost falls without limit along an unknown that no bound and no data hold"
    assert unbounded(program_of(), lambda own: own) == limitless
    saddle = "the optimality conditions hold, but at a saddle: the cost falls from there"
    assert unbounded(program_of(), lambda own: -(own**3)) == saddle
    assert unbounded(program_of(), lambda own: -(own**2)) == saddle
    weak = unbounded(program_of(), lambda own: casadi.exp(-own))
    assert weak.startswith("an optimum, but some cells are determined so weakly")


def test_a_cost_that_a_bound_ends_is_an_optimum() -> None:
    program, own = program_of().with_unknown("own", lower=2.0, mean=3.0)
    solved = program.with_cost(own).solve()
    assert solved.status == VERIFIED
    assert solved["own"][0] == pytest.approx(2.0) and solved.errors("own")[0] == 0.0


def test_entries_of_an_unknown_have_priors_of_their_own() -> None:
    program, own = program_of().with_unknown(
        "own", size=3, mean=[1.0, 2.0, 3.0], sd=[0.5, 1.0, np.inf], lower=[0.0, 2.5, 2.0]
    )
    solved = program.with_cost((own[2] - 4.0) ** 2 / 0.25).solve()
    assert solved.status == VERIFIED
    assert_allclose(solved["own"], [1.0, 2.5, 4.0], rtol=1e-6)
    assert_allclose(solved.errors("own"), [0.5, 0.0, 0.5], rtol=1e-6)


def test_no_array_of_an_unsolved_program_is_a_number() -> None:
    program = program_of()
    solved = program.subject_to("impossible", cells_of(program), -3.0, -2.0).solve()
    assert solved.status == "the solver found no point that satisfies the constraints"
    arrays = [*solved.multipliers.values(), *solved.bound_multipliers.values()]
    arrays += [solved.hessian.data, solved.covariance(), solved.sensitivity(to="measured")]
    assert all(np.isnan(array).all() for array in arrays)


def test_an_unused_unknown_leaves_the_error_bars_of_the_cells() -> None:
    program = program_of()
    free = program.solve()
    solved = program.with_unknown("unused", lower=-1.0, upper=1.0)[0].solve()
    assert solved.status.startswith("an optimum, but a plateau")
    assert_allclose(solved.cell_resistance_errors, free.cell_resistance_errors, rtol=1e-5)
    assert np.isinf(solved.errors("unused")).all()


# Wrong parts


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda program: program.subject_to("own", cells_of(program), 3.0, 2.0), "needs lower <="),
        (lambda program: program.subject_to("own", cells_of(program), np.nan), "needs lower <="),
        (lambda program: program.subject_to("own", cells_of(program), 0, np.nan), "needs lower <="),
        (lambda program: program.subject_to("own", cells_of(program), np.inf), "needs lower <="),
        (lambda program: program.subject_to("own", cells_of(program), "1"), "array of real numb"),
        (lambda program: program.subject_to("own", cells_of(program), [1, 2]), "needs 1 or 9"),
        (
            lambda program: program.subject_to("own", casadi.SX.sym("foreign") * cells_of(program)),
            "constraint own depends on foreign, which is no symbol of this program",
        ),
        (
            lambda program: program.with_cost(casadi.SX.sym("foreign")),
            "an own cost depends on foreign",
        ),
        (lambda program: program.with_reading(lambda y: y + casadi.SX.sym("z")), "depends on z"),
        (lambda program: program.with_unknown("own", size=0), "needs a size of 1 or more"),
        (lambda program: program.with_unknown("own", size=1.5), "needs a size of 1 or more"),
        (lambda program: program.with_unknown("own", start=np.nan), "a finite mean"),
        (
            lambda program: program.with_unknown("own", start=2.0, upper=1.0),
            "a start within",
        ),
        (lambda program: program.with_unknown("own", mean=np.inf, sd=1.0), "a finite mean"),
        (lambda program: program.with_unknown(3), "the name of an unknown is a text"),
        (lambda program: program.with_unknown("own", sd="wide"), "sd of unknown own: 'wide'"),
        (lambda program: program.with_unknown("own", size=2, mean=[1, 2, 3]), "needs 1 or 2"),
        (lambda program: program.with_unknown("own", size=2, sd=[1, 0]), "sd > 0"),
        (lambda program: program.with_unknown("own", lower=None), "lower of unknown own: None"),
        (lambda program: program.with_cost("1"), "an expression of the program's symbols"),
        (lambda program: program.with_cost(casadi.MX.sym("x")), "an expression of the program's"),
        (lambda program: program.with_reading(3), "needs a function of y, not 3"),
        (lambda program: program.subject_to("own", [program.cells()[0]]), "an expression of the"),
        (lambda program: program.subject_to("own", cells_of(program) <= 3), "a comparison is writ"),
        (lambda program: program.subject_to("own", cells_of(program), None, 3), "lower limit of"),
        (lambda program: program.subject_to(3, cells_of(program)), "name of a constraint is a t"),
        (lambda program: program.subject_to("measured", cells_of(program)), "a given number meas"),
        (lambda program: program.subject_to("lower", cells_of(program)), "a given number lower"),
        (lambda program: program.cells(1), "0 to 0, not 1"),
        (lambda program: program.cells(0.5), "0 to 0, not 0.5"),
        (lambda program: program.solve(start={}), "start must be a solution of a program"),
        (lambda program: program.solve().value(None), "an expression of the program's symbols"),
        (lambda program: program.solve().covariance(None), "an expression of the program's"),
        (lambda program: program.solve().sensitivity(to=None), "no sensitivity to None"),
        (lambda program: program.subject_to("own", program.cells()), "3 × 3, not a column"),
        (lambda program: program.subject_to("balance", program.cells()[0, 0]), "number balance al"),
        (lambda program: program.subject_to("own", casadi.SX(3)), "by the unknowns conductance"),
        (lambda program: program.with_reading(lambda y: y[:3]), "3 × 1; it must be 9 × 1"),
        (lambda program: program.with_cost(program.reading), "9 × 1; it must be 1 × 1"),
        (lambda program: program.with_unknown("conductance"), "an unknown conductance already"),
        (lambda program: program.solve()["own"], "no own unknown own; it has none"),
    ],
)
def test_a_wrong_part_is_refused_with_a_sentence(
    wrong: Callable[[OwnProgram], Any], message: str
) -> None:
    with pytest.raises(lampest.InputError, match=message):
        wrong(program_of())


@pytest.mark.parametrize("frames", [[], 1, ["one"], [1.0], [[0]], [9], [-1]])
def test_wrong_frames_are_refused(frames: Any) -> None:
    with pytest.raises(lampest.InputError, match="frames"):
        program_of(frames=frames)


def test_a_program_needs_node_voltages() -> None:
    with pytest.raises(lampest.InputError, match="formulation must be one of nodal, per_pixel"):
        program_of(formulation="reduced")


def test_a_recording_without_measured_frames_is_refused() -> None:
    recording = recording_of((2, 2), frames=1)
    with pytest.raises(lampest.InputError, match="no measured frame"):
        lampest.program(recording, SMOOTH)


def test_a_cost_without_a_value_has_a_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    program = program_of()
    solved = program.with_cost(casadi.log(program.cells()[0, 0] - 1e5)).solve()
    assert solved.status == "the solver broke down numerically"
    assert np.isnan(solved.cell_resistance).all() and solved.iterations == 0


def test_a_time_limit_ends_a_program() -> None:
    solved = program_of(solver=lampest.Settings(time_limit_s=1e-6)).solve()
    assert solved.status == "the time limit was reached before an optimum"


# Random programs, and SciPy as the judge


def faults_of(made: RandomProgram, seed: int) -> list[str]:
    """Statements about a random program that its solution makes and the judge refutes."""
    solved = made.program.solve()
    faults = []
    assert repr(made.program) and repr(solved)
    covariance = solved.covariance()
    sensitivity = solved.sensitivity(to="measured")
    assert covariance.shape == sensitivity.shape == (made.cells, made.cells)
    rng = np.random.default_rng(seed)
    if not solved.solved:
        assert np.isnan(covariance).all() and np.isnan(solved.cell_resistance).all()
        if made.solvable:
            faults.append("no solution where there is one")
        elif made.solvable is None:
            starts = (np.log(2000) + 0.5 * rng.standard_normal(made.size) for _ in range(3))
            if any(np.isfinite(made.minimised(start)[1]) for start in starts):
                faults.append("no solution where SciPy finds one")
        return faults
    x = made.point_of(solved)
    cost, _ = made.cost(x)
    # What IPOPT's barriers leave open, one of its tolerance at each bound
    gap = 2 * len(x) * IPOPT_TOLERANCE * solved.instance.cost_scale
    limit = SAME_COST * (1 + abs(cost)) + gap
    if made.solvable is False:
        faults.append("a solution where there is none")
    if abs(cost - solved.objective) > limit or made.violation(x) > SAME_COST:
        faults.append("another cost, or a violated constraint")
    if not all(np.isinf(solved.errors(name)).all() for name in made.unused):
        faults.append("an unused unknown with error bars")
    for spread in (0.0, 1e-3, 0.1):
        _, lower = made.minimised(x + spread * rng.standard_normal(len(x)))
        if lower < cost - limit:
            faults.append(f"no local optimum: SciPy goes on from {cost} to {lower}")
    return faults


@pytest.mark.parametrize(
    ("first", "count", "largest"),
    [
        (0, 20, 3),
        pytest.param(0, 100, 3, marks=pytest.mark.slow),
        pytest.param(100, 400, 4, marks=pytest.mark.soak),
        pytest.param(1000, 80, 9, marks=pytest.mark.soak),
        pytest.param(2000, 20, 16, marks=pytest.mark.soak),
    ],
)
def test_a_random_own_program_is_what_an_independent_judge_says(
    first: int, count: int, largest: int
) -> None:
    """`PROGRAMS_SEED=5000 python -m pytest -k random_own_program ...` draws others."""
    first += int(os.environ.get("PROGRAMS_SEED", "0"))
    wrong = {seed: faults_of(drawn(seed, largest), seed) for seed in range(first, first + count)}
    assert not {seed: faults for seed, faults in wrong.items() if faults}


@pytest.mark.parametrize(("seed", "largest"), [(340, 4), (1071, 9)])
def test_own_programs_that_were_wrong_are_right(seed: int, largest: int) -> None:
    """A bound that holds a cell by no more than rounding; shorts of which no reading depends."""
    assert not faults_of(drawn(seed, largest), seed)


# Multipliers, covariance, sensitivities


def with_given(program: OwnProgram, name: str, place: int, step: float) -> OwnProgram:
    """The program with another number of what was given, in its first frame."""
    evaluation, *others = program.evaluations
    data = evaluation.data
    changed = getattr(data.given, name).copy()
    changed.ravel()[place] += step
    moved = replace(data, given=replace(data.given, **{name: changed}))
    return replace(program, evaluations=(replace(evaluation, data=moved), *others))


def difference(changed: Callable[[float], Any], step: float) -> Any:
    """Derivative by two central differences, of the fourth order."""
    wide, narrow = ((changed(half) - changed(-half)) / (2 * half) for half in (step, step / 2))
    return (4 * narrow - wide) / 3


def limited(extra: float = 0.0) -> OwnProgram:
    program = program_of((3, 4))
    total = casadi.sum1(casadi.vec(1000 / program.cells()))
    return program.subject_to("total", total, 0.0, 3.0 + extra)


@pytest.mark.exact
@pytest.mark.parametrize("terms", [SMOOTH, [NOISE, lampest.LogGradient(1.0, lampest.Huber(0.1))]])
@pytest.mark.parametrize("name", ["measured", "sigma"])
def test_sensitivities_to_what_was_given_equal_differences(
    name: str, terms: list[lampest.Term]
) -> None:
    program = program_of((3, 4), terms)
    sensitivity = program.solve().sensitivity(of="cell_resistance", to=name)
    size = getattr(program.evaluations[0].data.given, name).ravel()
    for place in (0, 5):

        def cells(step: float, place: int = place) -> Any:
            return with_given(program, name, place, step).solve().cell_resistance.ravel()

        expected = difference(cells, 0.1 * size[place] if name == "sigma" else 0.3)
        largest = np.abs(sensitivity[:, place]).max()
        assert_allclose(sensitivity[:, place], expected, atol=1e-6 * largest)


def test_sensitivity_to_a_limit_equals_differences_and_its_multiplier_is_the_price() -> None:
    solved = limited().solve()
    sensitivity = solved.sensitivity(of="cell_resistance", to="total")[:, 0]
    expected = difference(lambda step: limited(step).solve().cell_resistance.ravel(), 1e-3)
    assert_allclose(sensitivity, expected, atol=1e-6 * np.abs(expected).max())
    price = difference(lambda step: np.array(limited(step).solve().objective), 1e-3)
    assert solved.multipliers["total"][0] == pytest.approx(-price, rel=1e-6)


def test_sensitivity_to_a_bound_that_holds_and_its_multiplier_equal_differences() -> None:
    """The upper bound of g = 1/r is 1/low: dφ/dlow = Σ λ/low²."""
    recording = recording_of((3, 3))
    low = 3000.0

    def solved(step: float) -> lampest.OwnSolution:
        bounds = lampest.Bounds(lower=low + step)
        return lampest.program(recording, SMOOTH, bounds=bounds).solve()

    expected = difference(lambda step: solved(step).cell_resistance.ravel(), 1.0)
    sensitivity = solved(0.0).sensitivity(to="lower").sum(axis=1)
    assert np.any(np.isclose(solved(0.0).cell_resistance, low))
    assert_allclose(sensitivity, expected, atol=1e-6 * np.abs(expected).max())
    price = difference(lambda step: np.array(solved(step).objective), 1.0)
    multipliers = solved(0.0).bound_multipliers["conductance"]
    assert multipliers.shape == (9,)
    assert multipliers.max() > 0
    assert (multipliers / low**2).sum() == pytest.approx(price, rel=1e-6)


@pytest.mark.slow
def test_the_covariance_is_that_of_estimates_from_drawn_readings() -> None:
    """Linear theory of 400 samples: 3.5 standard errors of a variance are a quarter of it."""
    count = 400
    recording = recording_of((2, 3))
    program = lampest.program(recording, [NOISE])
    program, offset = program.with_unknown("offset", sd=1.0)
    program = program.with_reading(lambda y: y + offset)
    first = program.solve()
    sigma = program.evaluations[0].data.sigma
    rng = np.random.default_rng(5)
    drawn_cells = []
    for _ in range(count):
        # The prior's mean is a reading of the offset, too.
        own = replace(program.symbols.own["offset"], start=0.0)
        prior = float(rng.standard_normal())
        symbols = replace(program.symbols, own={"offset": own})
        shifted = replace(program, symbols=symbols).with_cost(
            casadi.sumsqr(offset - prior) - casadi.sumsqr(offset)
        )
        evaluation = shifted.evaluations[0]
        data = evaluation.data
        noisy = data.given.measured + sigma * rng.standard_normal(sigma.shape)
        moved = replace(data, given=replace(data.given, measured=noisy))
        sample = replace(shifted, evaluations=(replace(evaluation, data=moved),))
        solved = sample.solve()
        drawn_cells.append([*solved.cell_resistance.ravel(), *solved["offset"]])
    scatter = np.cov(np.transpose(drawn_cells))
    assert_allclose(np.sqrt(np.diag(scatter)[:-1]), np.sqrt(np.diag(first.covariance())), rtol=0.13)
    assert np.sqrt(scatter[-1, -1]) == pytest.approx(first.errors("offset")[0], rel=0.13)


def test_names_have_shapes_and_units() -> None:
    solved = limited().solve()
    cells = solved.cell_resistance.ravel()
    relative = solved.covariance("log_cell_resistance")
    assert_allclose(solved.covariance("cell_resistance"), relative * np.outer(cells, cells))
    assert_allclose(solved.covariance("conductance"), relative / np.outer(cells, cells))
    assert_allclose(solved.value("conductance").ravel(), 1 / cells, rtol=1e-9)
    assert_allclose(np.sqrt(np.diag(solved.covariance())), solved.cell_resistance_errors.ravel())
    assert solved.multipliers["balance"].shape == (1, 22)
    assert solved.hessian.shape == (34, 34)
    assert solved.places["conductance"] == slice(0, 12)
    assert len(solved.history["inf_du"]) == solved.iterations + 1
    assert solved.sensitivity(of="reading", to="measured").shape == (12, 12)
    total = casadi.sum1(1 / solved.instance.program.quantities["cell_resistance"])
    assert solved.covariance(total)[0, 0] == pytest.approx(0.0, abs=1e-16)
    with pytest.raises(lampest.InputError, match="no unknown other; it has conductance"):
        solved.covariance("other")
    with pytest.raises(lampest.InputError, match="no sensitivity to noise; there is one to measur"):
        solved.sensitivity(to="noise")


# Starts, options, weights


def test_a_start_at_the_solution_ends_at_once_and_keeps_it() -> None:
    program = limited()
    solved = program.solve()
    again = program.solve(start=solved)
    assert again.status == VERIFIED and again.iterations <= 2 < solved.iterations
    assert_allclose(again.cell_resistance, solved.cell_resistance, rtol=1e-8)
    free = program_of((3, 4)).solve()
    assert_allclose(program.solve(start=free).cell_resistance, solved.cell_resistance, rtol=1e-8)


def test_a_start_of_another_panel_or_without_numbers_is_refused() -> None:
    program = program_of()
    broken = program.with_cost(casadi.log(program.cells()[0, 0] - 1e5)).solve()
    if not np.isfinite(broken.result.unknown).all():
        with pytest.raises(lampest.InputError, match="a solution with numbers"):
            program.solve(start=broken)
    with pytest.raises(lampest.InputError, match="of as many frames and cells"):
        program_of((2, 2)).solve(start=program_of().solve())


def warm_iterations(
    recording: lampest.Recording, monkeypatch: pytest.MonkeyPatch
) -> tuple[np.ndarray, np.ndarray]:
    """IPOPT's iterations of warm calls, of frames with all readings and of those that lack some."""
    iterations = list[int]()
    minimise = Interface.minimise

    def counting(interface: Interface, *arguments: Any) -> Any:
        result = minimise(interface, *arguments)
        iterations.extend([result.iterations] * (len(arguments) == 2))
        return result

    monkeypatch.setattr(Interface, "minimise", counting)
    terms = [NOISE, lampest.LogGradient(weight=10.0)]
    estimate = lampest.reconstruct(recording, terms, formulation="nodal", error_bars=False)
    assert set(estimate.status) == {VERIFIED}
    lacks = estimate.missing_readings[1:] > 0
    return np.array(iterations)[~lacks], np.array(iterations)[lacks]


@pytest.mark.slow
def test_warm_later_frames_at_10_by_10_take_three_iterations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A frame that lacks a reading, or has one again, takes up to 4."""
    load = lampest.datasets.load
    steady, lacking = warm_iterations(load("rod"), monkeypatch)
    assert len(steady) == 18 and len(lacking) == 2 and max(*steady, *lacking) <= 3
    arriving, lacking = warm_iterations(load("lamprey_35mm"), monkeypatch)
    assert np.median(arriving) <= 2 and max(arriving) <= 3 and max(lacking) <= 4


def test_options_of_ipopt_take_the_place_of_lampests() -> None:
    one = lampest.Settings(ipopt={"max_iter": 1})
    solved = program_of(solver=one).solve()
    assert solved.status.startswith("the iteration limit") and solved.iterations == 1
    absent = lampest.Settings(ipopt={"linear_solver": "ma57"})
    assert program_of(solver=absent).solve().status.startswith("the solver or its linear solver")


def test_the_log_of_ipopt_is_shown_on_request(capfd: pytest.CaptureFixture[str]) -> None:
    program_of().solve()
    assert "inf_pr" not in capfd.readouterr().out
    program_of(solver=lampest.Settings(ipopt={"print_level": 5})).solve()
    assert "inf_pr" in capfd.readouterr().out


def test_a_coarse_tolerance_of_ipopt_is_not_that_of_the_fine_solve() -> None:
    coarse = program_of(solver=lampest.Settings(ipopt={"tol": 1e-2})).solve()
    usual = program_of().solve()
    assert coarse.status == VERIFIED
    assert_allclose(coarse.cell_resistance, usual.cell_resistance, rtol=1e-7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_itr": 1}, "IPOPT has no option max_itr"),
        ({"max_iter": -3}, r"IPOPT does not take max_iter: -3. .* 0 <= \(3000\)"),
        ({"linear_solver": "ma1"}, "does not take linear_solver: 'ma1'. .* mumps"),
        ({"max_iter": "many"}, "does not take max_iter: 'many'"),
    ],
)
def test_options_that_ipopt_does_not_have_are_refused(options: Any, message: str) -> None:
    with pytest.raises(lampest.InputError, match=message):
        lampest.Settings(ipopt=options)


def test_automatic_weights_are_those_of_reconstruct() -> None:
    recording = recording_of((4, 4), frames=3)
    terms = [NOISE, lampest.LogGradient()]
    estimate = lampest.reconstruct(recording, terms)
    solved = lampest.program(recording, terms).solve()
    assert_allclose(solved.cell_resistance[0], estimate.cell_resistance[0], rtol=1e-6)


def test_tables_name_the_parts_with_their_sizes() -> None:
    program = limited()
    table = repr(program)
    assert len(table) < 1000 and len(repr(program.solve())) < 1000
    for line in (
        "nodal program of 1 frame of 3 × 4 cells",
        "misfit 12 residuals squared",
        "conductance 12 unknowns within the bounds of the cells",
        "balance 22 rows = 0",
        "total 1 row 0 to 3",
    ):
        assert line in " ".join(table.split())


# Constraints in run files


@dataclass(frozen=True)
class LimitedTotal(lampest.ProgramPart):
    """Sum of all conductances in millisiemens, at most `most`."""

    most: float
    kind: Literal["limited_total"] = "limited_total"

    def add_to(self, program: Any) -> Any:
        total = casadi.sum1(casadi.vec(1000 / program.cells()))
        return program.subject_to(self.kind, total, 0.0, self.most)


def test_constraints_of_an_estimator_hold_in_every_frame_and_shrink_error_bars() -> None:
    recording = recording_of((3, 3), frames=4, spread=0.1)
    tied = lampest.EqualCells(cells=[[0, 0], [0, 1], [1, 0]])
    known = lampest.KnownCells(cells=[[2, 2]], ohm=3000.0)
    parts = [tied, known, LimitedTotal(most=2.9)]
    free = lampest.reconstruct(recording, SMOOTH, formulation="nodal")
    bound = lampest.reconstruct(recording, SMOOTH, constraints=parts)
    assert set(bound.status) == {VERIFIED}
    cells, errors = bound.cell_resistance, bound.cell_resistance_errors
    assert_allclose(cells[:, 0, 1], cells[:, 0, 0], rtol=1e-8)
    assert_allclose(cells[:, 2, 2], 3000.0, rtol=1e-8)
    assert np.all((1000 / cells).sum(axis=(1, 2)) <= 2.9 + 1e-8)
    assert errors is not None and free.cell_resistance_errors is not None
    assert np.all(errors[:, 0, 0] < free.cell_resistance_errors[:, 0, 0])
    assert_allclose(errors[:, 2, 2], 0.0, atol=1e-9)
    program = lampest.program(recording, SMOOTH)
    alone = program.subject_to("tied", cells_of(program)[[1, 3]] - cells_of(program)[0])
    alone = alone.subject_to("known", cells_of(program)[8], 3.0)
    alone = alone.subject_to("total", casadi.sum1(1 / cells_of(program)), 0.0, 2.9)
    assert_allclose(cells[0], alone.solve().cell_resistance[0], rtol=1e-7)


def test_constraints_stand_in_a_run_file_and_are_swept(tmp_path: Path) -> None:
    recording_of((3, 3), frames=3).save(tmp_path / "mine.h5")
    (tmp_path / "run.yaml").write_text(
        """
schema: 1
recordings: [mine.h5]
check: none
estimators:
  tied:
    terms: {misfit: {weighting: noise}, log_gradient: {weight: 1}}
    constraints: {known_cells: {cells: [[0, 0]], ohm: 3000}}
sweep: {estimators.tied.constraints.known_cells.ohm: [2900, 3100]}
"""
    )
    cases = lampest.read_run(tmp_path / "run.yaml").cases
    assert [case.estimator.constraints[0].ohm for case in cases] == [2900.0, 3100.0]
    assert len({case.case_id for case in cases}) == 2
    (tmp_path / "run.yaml").write_text(
        (tmp_path / "run.yaml").read_text().replace("known_cells: {", "known_cell: {")
    )
    with pytest.raises(lampest.InputError, match=r"run.yaml:\d+:\d+: .*known_cell"):
        lampest.read_run(tmp_path / "run.yaml")


@pytest.mark.parametrize(
    ("parts", "options", "message"),
    [
        ([lampest.EqualCells(cells=[[0, 0], [0, 9]])], {}, r"there is no cell \[0, 9\]"),
        ([lampest.EqualCells(cells=[[0, 0], [0, 0]])], {}, "a cell is named twice"),
        (
            [lampest.KnownCells(cells=[[0, 0]], ohm=1.0)],
            {"formulation": "reduced"},
            "constraints need formulation: nodal, per_pixel or auto",
        ),
    ],
)
def test_constraints_that_cannot_hold_are_refused(
    parts: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(lampest.InputError, match=message):
        lampest.reconstruct(recording_of((3, 3)), SMOOTH, constraints=parts, **options)
