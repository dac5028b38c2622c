"""Programs with own unknowns, constraints and costs.

Every one ends in a right answer or in a sentence.
"""

from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest import OwnProgram

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
    exact = scene.circuit.simulated(cells, scene, np.zeros(shape[0]), np.zeros(shape[1])) + 140.0
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
        (lambda program: program.subject_to("own", cells_of(program), [1, 2]), "has 9 rows"),
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
