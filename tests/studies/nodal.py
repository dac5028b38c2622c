"""Where a nodal frame goes, and what each linear solver that IPOPT can be given makes of the same solves.

Run it with: OMP_NUM_THREADS=1 python -m tests.studies.nodal --side 10
Solves are later frames of a rod on a square panel, 12 bits, noise known, each begun at the estimate before; times are
those of the processor, of each solve the least of several turns, then the median. The wheels bring MUMPS and SPRAL;
HSL's ma27 and ma57 and Pardiso are the user's own to install, and are named as missing where they are not. ma77, ma86
and ma97 are not asked for: where they are missing, the loader of HSL ends the process.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import process_time
from typing import Any
from unittest import mock

import numpy as np

import lampest
from lampest.cost.problem import Data, Evaluation
from lampest.recording.readings import Readings
from lampest.solvers.ipopt import ipopt
from lampest.solvers.ipopt.ipopt import Ipopt
from lampest.solvers.solution import Outcome, Status, check
from tests.studies.speed import METHODS, begun, simulated

TURNS = 5
ORDERS = {"approximate minimum degree": 0, "METIS": 5, "what MUMPS takes": 7}
LINEAR_SOLVERS: dict[str, dict[str, Any]] = {
    **{f"mumps, {name}": {"linear_solver": "mumps", "mumps_pivot_order": order} for name, order in ORDERS.items()},
    **{name: {"linear_solver": name} for name in ("spral", "ma27", "ma57", "pardiso")},
}
Solve = tuple[Ipopt, Data, Evaluation]


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


def main(side: int, formulations: list[str], method: str) -> None:
    """Print where frames go, and the linear solvers."""
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
    chosen = parser.parse_args()
    main(chosen.side, chosen.formulations, chosen.method)
