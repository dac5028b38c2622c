"""Where a nodal frame goes, and what each linear solver that IPOPT can be given makes of the same solves.

Run it with: OMP_NUM_THREADS=1 python -m tests.studies.nodal --side 10
Solves are later frames of a rod on a square panel, 12 bits, noise known, each begun at the estimate before; times are
those of the processor, of each solve the least of several turns, then the median. The wheels bring MUMPS and SPRAL;
HSL's ma27 and ma57 and Pardiso are the user's own to install, and are named as missing where they are not. ma77, ma86
and ma97 are not asked for: where they are missing, the loader of HSL ends the process.
--programs asks CasADi's other solvers of nonlinear programs for the same frames, from the estimate of the frame before.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from time import process_time
from typing import Any
from unittest import mock

import casadi
import numpy as np

import lampest
from lampest.cost.problem import Data, Evaluation
from lampest.recording.readings import Readings
from lampest.solvers.ipopt import ipopt
from lampest.solvers.ipopt.ipopt import Ipopt
from lampest.solvers.ipopt.program import Program
from lampest.solvers.multistart import evaluated
from lampest.solvers.solution import Outcome, Status, check

FRAMES = 9
METHODS = {
    "LSM": (),
    "LSR-CR": (lampest.CellResistance(weight=1e-7),),
    "LSR-dCR": (lampest.RelativeChange(weight=1e-2),),
    "LSR-gCR": (lampest.Gradient(weight=1e-6),),
    "LSR-gdCR": (lampest.GradientOfRelativeChange(weight=1e-2),),
}


def simulated(side: int) -> lampest.Recording:
    """A rod on a square panel, read with 12 bits: every frame has its own noise."""
    readout = lampest.TwoPointReadout(adc_bits=12, reference_ohm=400.0, readings=4, noise_lsb=1.0)
    rod = lampest.Rod(centre_mm=(5.0 * side, 5.0 * side), diameter_mm=40.0, mass_g=500.0)
    scene = lampest.Scene(lampest.Panel(side, side), readout)
    return lampest.simulate(
        lampest.Simulation(1, 5, scene, frames=FRAMES, loads=(rod,), baseline_frames=2, frame_period_s=0.2)
    )


def begun(recording: lampest.Recording, estimator: lampest.Estimator) -> lampest.Stream:
    """Before the first frame."""
    resting = Readings.of(recording.scene, recording.recorded[recording.role == 0]).mean()
    return lampest.Stream.begin(estimator, recording.scene, 0.2, resting)


TURNS, LONGEST_S = 5, 20.0
ORDERS = {"approximate minimum degree": 0, "METIS": 5, "what MUMPS takes": 7}
LINEAR_SOLVERS: dict[str, dict[str, Any]] = {
    **{f"mumps, {name}": {"linear_solver": "mumps", "mumps_pivot_order": order} for name, order in ORDERS.items()},
    **{name: {"linear_solver": name} for name in ("spral", "ma27", "ma57", "pardiso")},
}
Solve = tuple[Ipopt, Data, Evaluation]
QUIET = {"print_time": False, "print_header": False, "print_iteration": False, "print_status": False}
QP: dict[str, dict[str, Any]] = {
    "qrqp": {"print_iter": False, "print_header": False, "error_on_fail": False},
    "osqp": {"osqp": {"verbose": False}, "error_on_fail": False},
    "qpoases": {"printLevel": "none", "error_on_fail": False, "sparse": True},
    "highs": {"highs": {"output_flag": False}, "error_on_fail": False},
    "ipqp": {"print_iter": False, "print_header": False, "error_on_fail": False},
    "proxqp": {"error_on_fail": False},
    "daqp": {"error_on_fail": False},
}
PROGRAMS: dict[str, tuple[str, dict[str, Any]]] = {
    "fatrop": ("fatrop", {"print_time": False, "structure_detection": "none", "fatrop": {"print_level": 0}}),
    **{
        f"sqpmethod, {name}": ("sqpmethod", QUIET | {"qpsol": name, "qpsol_options": options, "max_iter": 30})
        for name, options in QP.items()
    },
    "feasiblesqpmethod": ("feasiblesqpmethod", {"print_time": False, "qpsol": "qrqp", "max_iter": 30}),
    "bonmin": ("bonmin", {"print_time": False, "bonmin": {"print_level": 0}}),
}


@contextmanager
def recorded_solves() -> Iterator[list[Solve]]:
    """What IPOPT is asked for meanwhile."""
    asked: list[Solve] = []
    original = Ipopt.solve

    def noted(self: Ipopt, data: Data, start: Evaluation) -> Outcome:
        asked.append((self, data, start))
        return original(self, data, start)

    with mock.patch.object(Ipopt, "solve", noted):
        yield asked


def later_solves(side: int, method: str, formulation: Any) -> list[Solve]:
    """Of every frame but the first."""
    recording = simulated(side)
    terms = (lampest.Misfit(weighting="noise"), *METHODS[method])
    stream = begun(recording, lampest.Estimator(terms, formulation=formulation, error_bars=False))
    frames = recording.recorded[recording.role == 1]
    stream, _ = stream.push(Readings.of(recording.scene, frames[0]))
    with recorded_solves() as asked:
        for frame in frames[1:]:
            stream, _ = stream.push(Readings.of(recording.scene, frame))
    return asked


def least(turn: Callable[[], Any]) -> float:
    """Milliseconds of the processor, of the shortest of several turns."""
    spent = []
    for _ in range(TURNS):
        begin = process_time()
        turn()
        spent.append(process_time() - begin)
    return 1e3 * min(spent)


def evaluations(solver: Ipopt) -> float:
    """Milliseconds that the last solve spent in the cost, the balance and their derivatives."""
    stats = solver._built.solver.stats()
    return 1e3 * sum(seconds for name, seconds in stats.items() if name.startswith("t_proc_nlp_"))


def parts(side: int, method: str, formulation: Any) -> str:
    """One line: iterations and milliseconds of the median frame."""
    rows = []
    for solver, data, start in later_solves(side, method, formulation):
        outcome = solver.solve(data, start)
        whole, evaluated = least(lambda: solver.solve(data, start)), evaluations(solver)  # noqa: B023 - called at once
        checked = least(lambda: check(start, outcome))  # noqa: B023 - called at once
        rows.append((outcome.iterations, whole, evaluated, checked, check(start, outcome).status is Status.OPTIMUM))
    iterations, whole, evaluated, checked, _ = np.median(rows, axis=0)
    verified = np.mean([row[-1] for row in rows])
    return (
        f"{formulation:10s} {method:9s} iterations {iterations:4.1f}   IPOPT {whole:8.2f} ms, "
        f"evaluations {evaluated:6.2f} ms, check {checked:5.2f} ms   verified without polishing {verified:.0%}"
    )


def compared(side: int, method: str) -> Iterator[str]:
    """A line for each linear solver."""
    solves = later_solves(side, method, "nodal")
    for name, options in LINEAR_SOLVERS.items():
        with mock.patch.dict(ipopt.OPTIONS, options):
            ipopt._built.cache_clear()
            solvers = [Ipopt(one.cost, one.readout, one.formulation, one.settings) for one, _, _ in solves]
            again = [(solver, data, start) for solver, (_, data, start) in zip(solvers, solves, strict=True)]
            outcomes = [solver.solve(data, start) for solver, data, start in again]
            if any(outcome.status is Status.UNAVAILABLE for outcome in outcomes):
                yield f"{name:34s} missing"
                continue
            spent = np.median([least(lambda a=one: a[0].solve(a[1], a[2])) for one in again])
            solved = np.mean([check(start, end).solved for (_, _, start), end in zip(again, outcomes, strict=True)])
            turns = np.mean([outcome.iterations for outcome in outcomes])
            yield f"{name:34s} {spent:9.2f} ms, iterations {turns:4.1f}, solved {solved:.0%}"
    ipopt._built.cache_clear()


class Noted:
    """A solver that notes what it is called with."""

    def __init__(self, solver: Any) -> None:
        self.solver, self.given = solver, {}

    def __call__(self, **given: Any) -> Any:
        self.given = given
        return self.solver(**given)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.solver, name)


def programs(side: int, method: str) -> Iterator[str]:
    """A line for each of CasADi's solvers, IPOPT first; every frame is begun at the estimate of the one before."""
    solves = later_solves(side, method, "nodal")
    asked, built = [], solves[0][0]._built
    noted = Noted(built.solver)
    with mock.patch.object(ipopt, "_built", lambda *given: replace(built, solver=noted)):
        for (solver, _, before), (_, data, _) in pairwise(solves):
            one = Ipopt(solver.cost, solver.readout, solver.formulation, solver.settings)
            one.solve(data, evaluated(one.cost, data, before.cell_resistance))
            asked.append(noted.given)
    program = Program.build(solver.cost.unweighted, solver.readout, solver.formulation)
    least_cost = [float(built.solver(**given)["f"]) for given in asked]
    yield program_line("ipopt", built.solver, asked, least_cost)
    for name, (plugin, options) in PROGRAMS.items():
        needed = [plugin] if "qpsol" not in options else [plugin, options["qpsol"]]
        try:
            found = casadi.nlpsol("program", plugin, program.nlp, options | {"error_on_fail": False})
            yield program_line(name, found, asked, least_cost)
        except (RuntimeError, NotImplementedError) as error:
            yield f"{name:28s} not to be had: {' '.join(needed)}: {str(error).splitlines()[-1][:100]}"


def program_line(name: str, solver: Any, asked: list[dict[str, Any]], least_cost: list[float]) -> str:
    """Milliseconds of the median frame, how many reach IPOPT's cost, and the largest violation among these."""
    spent, reached, broken = [], 0, []
    for given, least in zip(asked, least_cost, strict=True):
        begin = process_time()
        found = solver(**given)
        spent.append(process_time() - begin)
        away = float(np.abs(np.asarray(found["g"])).max())
        if float(found["f"]) <= least * (1 + 1e-6) and away < 1e-6:
            reached += 1
            broken.append(away)
        if sum(spent) > LONGEST_S:
            break
    told = f"{reached} of {len(spent)} reach the optimum, balance {max(broken, default=np.nan):.0e}"
    return f"{name:28s} {1e3 * float(np.median(spent)):9.2f} ms, {told}"


def main(side: int, formulations: list[str], method: str, others: bool) -> None:
    """Print where frames go, and the linear solvers; or the other solvers alone."""
    if others:
        for line in programs(side, method):
            print(line, flush=True)
        return
    print(f"{side} x {side}, later frames")
    for formulation in formulations:
        for name in METHODS:
            print(parts(side, name, formulation), flush=True)
    print(f"linear solvers of IPOPT, nodal {method}")
    for line in compared(side, method):
        print(line, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=10)
    parser.add_argument("--formulations", nargs="*", default=["nodal", "per_pixel"])
    parser.add_argument("--method", choices=METHODS, default="LSR-gCR")
    parser.add_argument("--programs", action="store_true")
    chosen = parser.parse_args()
    main(chosen.side, chosen.formulations, chosen.method, chosen.programs)
