"""Does the reduced solver ever end worse than anything else? Random problems against independent optima.

    OMP_NUM_THREADS=1 python -m tests.studies.random_problems --problems 1000 --seed 1 [--first N] [--processes 2]
        [--most-cells 64] [--judge-s 0.7]

Of every problem (see tests/random_problem.py) the cost of the reduced solver's estimate is compared with the least
that SciPy finds on a second statement of the equations, from the estimate and from several starts (its trust region,
and L-BFGS-B on large panels), that IPOPT finds with node voltages as unknowns (up to 64 unknown cells, from two
starts), and that the reduced solver finds from random starts. `--judge-s` bounds what these others may take of the
processor: who is not begun by then is left out, and the table says how often anybody was heard. `--most-cells` leaves
out larger panels. All costs are those of the second statement. Ends with 1 where an estimate costs more than the
least known by 10⁻⁶ of it (and 10⁻¹² of the cost of readings of zero), where a problem has no estimate and no sentence
says that its arithmetic is at its end, or where a solve takes more than ten times the evaluations that are usual
among panels of its size.
"""

import argparse
import os
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from time import process_time
from typing import Any
from unittest import mock

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.files.errors import InputError
from lampest.solvers.ipopt import FORMULATIONS, Ipopt
from lampest.solvers.multistart import BROKEN, convex, evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Status
from tests.least_cost import Array
from tests.random_problem import RandomProblem

WORSE = 1e-6  # of the least cost known
ROUNDING = 1e-12  # of the cost of readings of zero: misfits of exact readings are rounding
NODAL_CELLS, SEVERAL_CELLS = 64, 100  # beyond, building a nodal program takes seconds, and so does a trust region
REGION_CELLS = 150  # a step of the trust region takes a second beyond
TWICE_S = 3.0  # of the processor: what took longer is not solved again for the sake of its time
UNSOLVED = (Status.UNREAD, Status.UNRESTED)  # nothing was asked of the solver
NAMED = (Status.ROUNDED.name, Status.DRIFT.name)  # the sentence tells why there can be no estimate
SLOW = 10.0  # times the median of its size
CLASSES = (9, 25, 64, 144, 256, 576)  # cells up to which panels are of one size


@dataclass(frozen=True)
class Finding:
    """Of one problem. ours : the cost of the estimate, infinite without one. others : name → the least it found.

    evaluations, seconds : of the reduced solve, CPU time. blank : the cost of readings of zero.
    """

    number: int
    about: str
    cells: int
    status: str
    ours: float
    others: dict[str, float]
    blank: float
    evaluations: int
    seconds: float

    @property
    def asked(self) -> bool:
        """Whether there was anything to solve."""
        return self.status not in [status.name for status in UNSOLVED] and not self.status.startswith("input")

    @property
    def least(self) -> float:
        """What anything else found."""
        return min(self.others.values(), default=float("inf"))

    @property
    def verdict(self) -> str:
        """Unsolved, worse, better, or equal."""
        if not np.isfinite(self.ours):
            return "unsolved"
        small = ROUNDING * self.blank
        if self.ours > self.least * (1 + WORSE) + small:
            return "worse"
        return "better" if self.least > self.ours * (1 + WORSE) + small else "equal"


def examine(seed: int, number: int, judge_s: float = np.inf) -> Finding:
    """Solve one problem in every way that is begun within `judge_s` seconds of the processor after the first."""
    warnings.simplefilter("ignore")
    problem = RandomProblem.drawn(seed, number)
    shape = problem.cells.shape[1:]
    try:
        step, evaluations, seconds = counted(problem)
        if seconds < TWICE_S:  # what is compiled at the first solve is not charged
            step, evaluations, seconds = counted(problem)
    except InputError as refused:
        return Finding(number, problem.about, int(np.prod(shape)), f"input: {refused}", np.inf, {}, 0.0, 0, 0.0)
    solution, oracle = step.solution, problem.oracle
    ours = oracle.value(np.log(solution.cell_resistance).ravel()) if solution.solved else np.inf
    others: dict[str, float] = {}
    if solution.status not in UNSOLVED:
        end = process_time() + judge_s
        found = solution.cell_resistance if solution.solved else None
        with np.errstate(all="ignore"):
            for name, place in ends(problem, np.random.default_rng([seed, number, 1]), found):
                value = oracle.value(place) if np.all(np.isfinite(place)) else np.inf
                others[name] = min(others.get(name, np.inf), value if np.isfinite(value) else np.inf)
                if process_time() > end:
                    break
    cells = int(np.prod(shape)) * len(problem.data.measured)
    status = solution.status.name
    return Finding(number, problem.about, cells, status, ours, others, oracle.blank(), evaluations, seconds)


def counted(problem: RandomProblem) -> tuple[Any, int, float]:
    """(step, evaluations of the cost, CPU seconds) of the problem's solve."""
    calls, at = [0], Evaluation.at.__func__  # type: ignore[attr-defined]

    def counting(cls: type[Evaluation], *given: Any) -> Evaluation:
        calls[0] += 1
        return at(cls, *given)

    _ = problem.asked
    with mock.patch.object(Evaluation, "at", classmethod(counting)):
        begin = process_time()
        step = problem.solved()
        return step, calls[0], process_time() - begin


def ends(problem: RandomProblem, random: np.random.Generator, found: Array | None) -> Iterator[tuple[str, Array]]:
    """(solver, u) where other solvers end, from the estimate and several starts each, within the bounds."""
    data, oracle = problem.data, problem.oracle
    low, high = (np.log(bound).ravel() for bound in (data.lower, data.upper))
    truth = problem.cells[:2] if len(data.measured) == 2 else problem.cells[problem.pushed][None]
    size = truth.size
    starts = [np.log(truth).ravel(), np.log(data.uniform_start).ravel()]
    scattered = [np.log(data.apparent_resistance).ravel() + random.uniform(0, 3, size) for _ in range(2)]
    own = [] if found is None else [np.log(found).ravel()]
    for start in [*own, *starts, *scattered[: 1 if size <= SEVERAL_CELLS else 0]]:
        try:
            if size <= REGION_CELLS:
                yield "trust region", oracle.minimised(start, 100 if size <= SEVERAL_CELLS else 20)
            else:
                yield "L-BFGS-B", oracle.descended(start)
        except (ValueError, ArithmeticError):
            continue
    estimator = problem.estimator if problem.asked is not None else problem.alone
    cost = estimator.cost(problem.scene, len(data.measured), partial=data.partial)
    ours = ProjectedNewton(cost, estimator.solver)
    solvers: list[tuple[str, Any, list[Array]]] = [("random starts", ours, scattered)]
    if size <= NODAL_CELLS and problem.scene.wiring is None:
        nodal = Ipopt(cost, problem.scene.circuit, FORMULATIONS["nodal"], estimator.solver)
        solvers.append(("nodal", nodal, [starts[0], np.log(convex(data, None)).ravel()]))
    for name, solver, places in solvers:
        for place in places:
            try:
                cells = np.exp(np.clip(place, low, high)).reshape(data.measured.shape)
                outcome = solver.solve(data, evaluated(cost, data, cells))
            except BROKEN:
                continue
            yield name, np.clip(np.log(outcome.cell_resistance).ravel(), low, high)


def slow(findings: list[Finding]) -> list[tuple[Finding, float]]:
    """(finding, how many times the median evaluations of its size it took), where that is too many."""
    found = []
    for own in by_size(findings).values():
        usual = float(np.median([one.evaluations for one in own]))
        found += [(one, one.evaluations / usual) for one in own if one.evaluations > SLOW * usual]
    return found


def by_size(findings: list[Finding]) -> dict[int, list[Finding]]:
    """Findings by the largest panel of their class; of a joint pair both panels count."""
    classes: dict[int, list[Finding]] = {}
    for one in findings:
        classes.setdefault(next((size for size in CLASSES if one.cells <= size), 2 * CLASSES[-1]), []).append(one)
    return dict(sorted(classes.items()))


def report(findings: list[Finding]) -> bool:
    """Print the table; whether the claim holds."""
    asked = [one for one in findings if one.asked]
    print(f"{len(findings)} problems, {len(findings) - len(asked)} of them not asked (too little read, or refused)")
    print("unknowns  problems  equal  better  worse  unsolved  evaluations median/most  CPU s median/most")
    for size, own in by_size(asked).items():
        verdicts = Counter(one.verdict for one in own)
        counts, seconds = [one.evaluations for one in own], [one.seconds for one in own]
        words = [f"{verdicts[name]:6d}" for name in ("equal", "better", "worse", "unsolved")]
        times = f"{np.median(counts):.0f} / {max(counts)}, {np.median(seconds):.3f} / {max(seconds):.2f}"
        print(f"{size:8d}  {len(own):8d}  {'  '.join(words)}  {times}")
    heard = [one for one in asked if one.others]
    print(
        f"compared with others: {len(heard)} of {len(asked)};",
        dict(Counter(name for one in heard for name in one.others)),
    )
    print("statuses:", dict(Counter(one.status for one in findings)))
    bad = [one for one in asked if one.verdict in ("worse", "unsolved")]
    for one in bad:
        share = (one.ours - one.least) / max(one.least, 1e-300)
        best = min(one.others, key=lambda name: one.others[name], default="")
        print(f"{one.verdict}: {one.number} {one.status} {share:.1e} {best} {one.about}")
    for one, times in slow(asked):
        print(f"slow: {one.number} {times:.0f} × {one.evaluations} evaluations {one.seconds:.1f} s {one.about}")
    return not any(one.verdict == "worse" or one.status not in NAMED for one in bad) and not slow(asked)


def main() -> int:
    """0 where the claim holds, 1 where it does not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--most-cells", type=int, default=24 * 24, help="of a panel; larger ones are left out")
    parser.add_argument(
        "--judge-s", type=float, default=np.inf, help="processor seconds of all other solvers a problem"
    )
    arguments = parser.parse_args()
    drawn, findings = range(arguments.first, arguments.first + arguments.problems), []
    cells = {number: RandomProblem.drawn(arguments.seed, number).cells[0].size for number in drawn}
    numbers = [number for number in drawn if cells[number] <= arguments.most_cells]
    with ProcessPoolExecutor(arguments.processes) as pool:
        asked = {pool.submit(examine, arguments.seed, number, arguments.judge_s): number for number in numbers}
        for future in as_completed(asked):
            one = future.result()
            findings.append(one)
            word = one.verdict if one.asked else "not asked"
            print(
                f"{len(findings)}/{len(asked)} {one.number} {word} {one.status} {one.about}",
                file=sys.stderr,
                flush=True,
            )
    return 0 if report(sorted(findings, key=lambda one: one.number)) else 1


if __name__ == "__main__":
    sys.exit(main())
