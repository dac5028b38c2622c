"""The program of node voltages, solved by IPOPT alone."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from netlist import impedance_of
from numpy.testing import assert_allclose
from promises import promise

import lampest
from lampest.cost.problem import NO_DUAL
from lampest.estimate.state import Verification, compared
from lampest.files.levels import Witness
from lampest.formulation.circuit import Circuit
from lampest.formulation.instance import Instance, Multipliers, ProgramResult
from lampest.formulation.ipopt import Interface
from lampest.panel.readouts.tolerances import simulated
from lampest.runs.case import COLUMNS
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.projected_newton import ProjectedNewton

NOISE = lampest.Misfit(weighting="noise")
CONVERGED = 2e-6  # of log r: the certificate holds where the next step moves no cell by 1e-6
MAX_DIFFERENCE = 1e-6  # relative, of costs and sums at a verified optimum
ROUNDING = 1e-9  # relative
METHODS: dict[str, list[lampest.Term]] = {
    "LSM": [lampest.Misfit()],
    "LSR-CR": [lampest.Misfit(), lampest.CellResistance(weight=1e-3)],
    "LSR-dCR": [lampest.Misfit(), lampest.RelativeChange(weight=10.0)],
    "LSR-gCR": [lampest.Misfit(), lampest.Gradient(weight=1e-3)],
    "LSR-gdCR": [lampest.Misfit(), lampest.GradientOfRelativeChange(weight=10.0)],
    "smooth": [NOISE, lampest.LogGradient(weight=20.0)],
    "huber": [NOISE, lampest.LogGradient(weight=20.0, loss=lampest.Huber(corner=0.3))],
    "student": [NOISE, lampest.LogRatio(weight=3.0, loss=lampest.Student(corner=0.3))],
    "variation": [NOISE, lampest.TotalVariation(weight=0.01)],
}
READOUTS: dict[str, lampest.Readout] = {
    "two_point": lampest.TwoPointReadout(noise_lsb=0.7, readings=20),
    "loaded": lampest.LoadedColumnsReadout(noise_lsb=1.0, drive_ohm=100.0),
    "grounded": lampest.GroundedReadout(noise_lsb=1.0),
    "amplifiers": lampest.VirtualGroundReadout(noise_lsb=1.0, feedback_ohm=300.0),
}
WIRES: dict[str, dict[str, Any]] = {
    "bare": {},
    "wire": {"lines": lampest.Lines(20.0, 5.0)},
    "rows of wire": {"lines": lampest.Lines(20.0, 0.0, rows_enter="right", columns_leave="top")},
    "touching": {"faults": lampest.Faults(joined_rows=((1, 2),))},
    "contacts": {"contacts": lampest.Contacts(rows=lampest.ContactPrior(50.0, 0.0))},
}


def recording_of(
    readout: lampest.Readout, shape: tuple[int, int] = (4, 5), **wires: Any
) -> lampest.Recording:
    """An unloaded frame and two with other cells, with noise; one reading is missing."""
    rng = np.random.default_rng(sum(shape))
    scene = lampest.Scene(lampest.Panel(*shape), readout, **wires)
    cells = 3000 * np.exp(0.5 * rng.standard_normal((3, *shape)))
    cells[0] = 3000.0
    exact = simulated(scene.circuit, cells, scene, np.zeros(shape[0]), np.zeros(shape[1]))
    recorded = exact + scene.circuit.sigma(exact) * rng.standard_normal(exact.shape)
    recorded[1, 1, 1] = np.nan
    return lampest.Recording.from_array(recorded, unit=readout.unit, baseline=1, scene=scene)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Iterations of every call of IPOPT; the solver without voltages is not to be called at all."""
    iterations = list[int]()
    minimise = Interface.minimise

    def counting(interface: Interface, *arguments: Any) -> ProgramResult:
        result = minimise(interface, *arguments)
        iterations.append(result.iterations)
        return result

    def never(solver: ProjectedNewton, *arguments: Any) -> Any:
        raise AssertionError("projected Newton was called where IPOPT was asked for")

    monkeypatch.setattr(Interface, "minimise", counting)
    monkeypatch.setattr(ProjectedNewton, "solve", never)
    return iterations


@promise("README: and IPOPT solves it")
@pytest.mark.parametrize("formulation", ["nodal", "per_pixel"])
@pytest.mark.parametrize("method", METHODS)
def test_ipopt_alone_solves_every_frame_in_its_own_iterations(
    method: str, formulation: Any, counted: list[int]
) -> None:
    estimate = lampest.reconstruct(
        recording_of(READOUTS["two_point"]),
        METHODS[method],
        formulation=formulation,
        error_bars=False,
    )
    assert len(counted) >= 3 and min(counted) > 0
    for step in estimate.steps:
        assert step.solution.optimum, step.status
        assert 0 < step.solution.iterations in counted or step.solution.iterations == sum(
            counted[-2:]
        )
        assert step.solution.solver == f"IPOPT {formulation}"


@pytest.mark.parametrize("formulation", ["nodal", "per_pixel"])
@pytest.mark.parametrize("method", METHODS)
def test_a_solver_that_returns_its_start_is_not_verified(
    method: str, formulation: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start_of(
        interface: Interface, instance: Instance, warm: Multipliers | None = None, **how: bool
    ) -> ProgramResult:
        zeros = np.zeros_like(instance.start), np.zeros_like(instance.equations[0])
        return ProgramResult(instance.start, *zeros, "Solve_Succeeded", 0)

    monkeypatch.setattr(Interface, "minimise", start_of)
    estimate = lampest.reconstruct(
        recording_of(READOUTS["two_point"]),
        METHODS[method],
        formulation=formulation,
        error_bars=False,
    )
    assert not any(step.solution.solved for step in estimate.steps)


@pytest.mark.long
@promise("README: has a faster way to the same optimum")
@pytest.mark.parametrize("wires", WIRES)
@pytest.mark.parametrize("readout", READOUTS)
@pytest.mark.parametrize("shape", [(4, 5), (6, 3)])
def test_optima_of_every_circuit_equal_those_of_the_reduced_solver(
    shape: tuple[int, int], readout: str, wires: str
) -> None:
    recording = recording_of(READOUTS[readout], shape, **WIRES[wires])
    cells = {}
    for formulation in ("reduced", "nodal", "per_pixel"):
        estimate = lampest.reconstruct(
            recording, METHODS["smooth"], formulation=formulation, error_bars=False
        )
        assert set(estimate.status) == {"local optimum verified"}
        cells[formulation] = np.log(estimate.cell_resistance)
    assert_allclose(cells["nodal"], cells["reduced"], atol=CONVERGED)
    assert_allclose(cells["per_pixel"], cells["reduced"], atol=CONVERGED)


@pytest.mark.parametrize("joint", [True, False])
def test_a_pair_of_frames_has_the_optimum_of_the_reduced_solver(joint: bool) -> None:
    recording = recording_of(READOUTS["two_point"])
    costs = []
    for kind in ("reduced", "nodal"):
        method = lampest.OptimalMethod(kind=kind, joint=joint)
        estimate = lampest.reconstruct(
            recording, METHODS["LSR-dCR"], formulation=method, error_bars=False
        )
        costs.append(estimate.steps[0].solution.objective)
    assert costs[1] <= costs[0] * (1 + ROUNDING)


@pytest.mark.parametrize("wires", WIRES)
def test_node_voltages_equal_those_of_a_netlist(wires: str) -> None:
    scene = recording_of(READOUTS["grounded"], **WIRES[wires]).scene
    cells = 3000 * np.exp(np.random.default_rng(5).standard_normal((4, 5)))
    ties = scene.circuit.ties(scene.circuit.exact_reading(cells, scene.wiring))
    circuit = Circuit.of((4, 5), scene.wiring)
    assert_allclose(
        circuit.voltages(cells, ties)[circuit.points],
        impedance_of(cells, scene, ties),
        rtol=1e-9,
    )


# A second witness


def column(estimate: Any, name: str) -> Any:
    """Values of one column of the results file; `result` checks the circuit for another one."""
    return next(column for column in COLUMNS if column.name == name).filled(estimate)


@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_the_strongest_frame_is_solved_again_from_another_start(formulation: Any) -> None:
    recording = recording_of(READOUTS["two_point"])
    options: dict[str, Any] = {"formulation": formulation, "error_bars": False}
    estimate = lampest.reconstruct(
        recording, METHODS["smooth"], verify=lampest.Verify("strongest"), **options
    )
    verified, difference = (column(estimate, name) for name in ("verified", "verified_difference"))
    assert sorted(verified) == [Witness.NONE, Witness.SAME]
    assert difference[verified == Witness.SAME] < MAX_DIFFERENCE
    assert np.isnan(difference[verified == Witness.NONE]).all()
    all_verified = lampest.reconstruct(
        recording, METHODS["smooth"], verify=lampest.Verify("all"), **options
    )
    assert list(column(all_verified, "verified")) == [Witness.SAME] * 2
    unverified = lampest.reconstruct(recording, METHODS["smooth"], **options)
    assert column(unverified, "verified") is None


def test_a_lower_optimum_of_the_witness_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first solver is made to end at a worse point that passes for an optimum."""
    recording = recording_of(READOUTS["two_point"])
    terms = METHODS["smooth"]
    right = lampest.reconstruct(recording, terms, formulation="reduced", error_bars=False)
    usual = ProjectedNewton.solve

    def worse(solver: ProjectedNewton, data: Any, start: Any) -> lampest.Outcome:
        outcome = usual(solver, data, start)
        return replace(
            outcome, cell_resistance=1.2 * outcome.cell_resistance, at=None, certificate=None
        )

    def trusted(start: Any, outcome: lampest.Outcome) -> lampest.Solution:
        solution = lampest.approximation(start.cost, start.data, outcome)
        return replace(solution, status=lampest.Status.OPTIMUM, dual=NO_DUAL)

    monkeypatch.setattr(ProjectedNewton, "solve", worse)
    monkeypatch.setattr("lampest.solvers.multistart.check", trusted)
    estimate = lampest.reconstruct(
        recording, terms, formulation="reduced", error_bars=False, verify=lampest.Verify("all")
    )
    assert list(column(estimate, "verified")) == [Witness.LOWER] * 2
    assert np.all(column(estimate, "verified_decrease") > 0)
    assert_allclose(estimate.cell_resistance, right.cell_resistance, rtol=1e-6)


def test_the_witness_compares_objectives() -> None:
    estimate = lampest.reconstruct(
        recording_of(READOUTS["two_point"]), METHODS["smooth"], formulation="reduced"
    )
    solution = estimate.steps[0].solution
    factor = {"lower": 0.9, "same": 1 + 1e-9, "higher": 1.1}
    verdicts = {
        name: compared(solution, replace(solution, objective=solution.objective * f))
        for name, f in factor.items()
    }
    assert verdicts["lower"].witness is Witness.LOWER and verdicts[
        "lower"
    ].decrease == pytest.approx(0.1)
    assert verdicts["same"] == Verification(Witness.SAME, 0.0)
    assert verdicts["higher"].witness is Witness.HIGHER
    failed = replace(solution, status=lampest.Status.ITERATIONS)
    assert compared(solution, failed).witness is Witness.FAILED
    assert compared(failed, solution).witness is Witness.LOWER


@pytest.mark.parametrize("share", [0.0, 1.5, -1.0])
def test_a_share_of_frames_lies_between_0_and_1(share: float) -> None:
    with pytest.raises(ValueError, match="share between 0 and 1"):
        lampest.Verify(share)


# Own unknowns and constraints


def own_program(**options: Any) -> tuple[lampest.OwnProgram, lampest.Reconstruction]:
    recording = recording_of(READOUTS["two_point"])
    estimate = lampest.reconstruct(recording, METHODS["smooth"], formulation="reduced")
    return lampest.program(recording, METHODS["smooth"], **options), estimate


@pytest.mark.parametrize("formulation", ["nodal", "per_pixel"])
def test_a_program_without_own_parts_reproduces_the_estimate_and_its_error_bars(
    formulation: str,
) -> None:
    program, estimate = own_program(formulation=formulation)
    solved = program.solve()
    assert solved.status == "local optimum verified" and solved.iterations > 0
    assert_allclose(solved.cell_resistance[0], estimate.cell_resistance[0], rtol=1e-6)
    # cov(ln r) = (½∇²φ)⁻¹ over the cells that no bound holds, from the closed form without voltages
    evaluation = program.evaluations[0].elsewhere(solved.cell_resistance)
    hessian = Hessian(evaluation, Smoothing.start(evaluation))
    assert hessian.free.all()
    deviations = np.sqrt(np.linalg.inv(hessian.matrix / 2).diagonal()).reshape(4, 5)
    assert_allclose(
        solved.cell_resistance_errors[0] / solved.cell_resistance[0],
        deviations,
        rtol=10 * MAX_DIFFERENCE,
    )


@promise("howto/adding/constraint: A check outside of IPOPT distinguishes a minimum from a saddle")
def test_an_end_at_a_saddle_is_no_optimum() -> None:
    """The own cost (x² − 1)² has a maximum at 0, where IPOPT begins and stays."""
    program, _ = own_program()
    program, bend = program.with_unknown("bend", start=0.0)
    at_saddle = program.with_cost((bend**2 - 1) ** 2).solve()
    assert at_saddle.status.startswith("the optimality conditions hold, but at a saddle")
    assert np.isnan(at_saddle.cell_resistance).all() and np.isnan(at_saddle["bend"]).all()
    program, bend = own_program()[0].with_unknown("bend", start=0.5)
    solved = program.with_cost((bend**2 - 1) ** 2).solve()
    # φ'' = 8 at x = 1: the standard deviation is (½ φ'')^−½
    assert solved.status == "local optimum verified"
    assert solved["bend"][0] == pytest.approx(1.0) and solved.errors("bend")[0] == pytest.approx(
        0.5
    )


@pytest.mark.slow
def test_ctrl_c_while_ipopt_solves_ends_a_program() -> None:
    text = """
import signal
import sys
import numpy as np
import lampest

def interrupt(number, frame):
    names = [frame.f_code.co_name, frame.f_back.f_code.co_name, frame.f_back.f_back.f_code.co_name]
    if names == ["call", "__call__", "minimise"]:  # CasADi runs IPOPT
        raise KeyboardInterrupt

scene = lampest.Scene(lampest.Panel(16, 16), lampest.TwoPointReadout(noise_lsb=0.7))
cells = 1000 * np.exp(np.random.default_rng(1).standard_normal((1, 16, 16)))
recording = lampest.Recording(scene, cells, np.zeros(1), np.ones(1, dtype=np.uint8))
program = lampest.program(recording, [lampest.Misfit(), lampest.LogGradient(weight=1.0)])
signal.signal(signal.SIGALRM, interrupt)
signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
try:
    program.solve()
except KeyboardInterrupt:
    print("interrupted")
"""
    completed = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=100
    )
    assert completed.stdout == "interrupted\n", completed.stderr


def test_barriers_do_not_lead_away_from_a_start_that_nearly_explains_the_readings() -> None:
    """With the limit of MAX_BARRIER for each cell instead of all together, 181 iterations."""
    readout = lampest.LoadedColumnsReadout(load_ohm=35_000.0, drive_ohm=30.0, noise_lsb=1.0)
    scene = lampest.Scene(lampest.Panel(6, 6), readout)
    cells = 3000 * np.exp(0.1 * np.random.default_rng(3).standard_normal((1, 6, 6)))
    recorded = readout.to_recorded(readout.exact_reading(cells), scene).repeat(2, axis=0)
    role = np.array([lampest.UNLOADED, lampest.MEASURED], dtype=np.uint8)
    recording = lampest.Recording(scene, recorded, np.arange(2.0), role)
    estimate = lampest.reconstruct(recording, [NOISE], formulation="nodal", error_bars=False)
    assert estimate.steps[0].solution.optimum
    assert estimate.steps[0].solution.iterations < 40
