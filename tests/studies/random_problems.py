"""Does the reduced solver ever end worse than anything else? Random problems against independent optima.

    OMP_NUM_THREADS=1 python -m tests.studies.random_problems --problems 1000 --seed 1 [--first N] [--processes 2]
        [--most-cells 64] [--judge-s 0.7]

Of every problem (see tests/random_problem.py) the cost of the reduced solver's estimate is compared with the least
that SciPy finds on a second statement of the equations, from the estimate and from several starts (its trust region,
and L-BFGS-B on large panels), that IPOPT finds with node voltages as unknowns (up to 64 unknown cells, from two
starts), and that the reduced solver finds from random starts. `--judge-s` bounds their time on the
processor; solvers that have not begun by then are left out, and the table counts the comparisons. `--most-cells` leaves
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
from dataclasses import dataclass, field
from itertools import pairwise
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
TWICE_S = 3.0  # of the processor: a longer solve is not repeated for the sake of its time
UNSOLVED = (Status.UNREAD, Status.UNRESTED)  # nothing to solve
NAMED = (Status.ROUNDED.name, Status.DRIFT.name)  # the sentence says why there can be no estimate
SLOW = 10.0  # times the median of its size
CLASSES = (9, 25, 64, 144, 256, 576, 1152)  # cells up to which panels are of one size


@dataclass(frozen=True)
class Finding:
    """Estimate of one problem beside other solvers.

    Attributes
    ----------
    cost : float
        Cost of the estimate, infinite without one.
    costs : dict
        Other solver → the least cost that it finds.
    evaluations, seconds : of the reduced solve, CPU time.
    blank : cost of readings of zero.
    """

    number: int
    about: str
    cells: int
    status: str
    cost: float = np.inf
    costs: dict[str, float] = field(default_factory=dict)
    blank: float = 0.0
    evaluations: int = 0
    seconds: float = 0.0

    @property
    def asked(self) -> bool:
        """Whether there was anything to solve."""
        return self.status not in [status.name for status in UNSOLVED] and not self.status.startswith("input")

    @property
    def least(self) -> float:
        """The least cost of the other solvers."""
        return min(self.costs.values(), default=float("inf"))

    @property
    def verdict(self) -> str:
        """Unsolved, worse, better, or equal."""
        small = ROUNDING * self.blank
        if not np.isfinite(self.cost):
            return "unsolved"
        if self.cost > self.least * (1 + WORSE) + small:
            return "worse"
        return "better" if self.least > self.cost * (1 + WORSE) + small else "equal"


def examine(seed: int, number: int, judge_s: float = np.inf) -> Finding:
    """Solve one problem in every way that begins within `judge_s` seconds of the processor after the first."""
    warnings.simplefilter("ignore")
    problem = RandomProblem.drawn(seed, number)
    cells = problem.cells[0].size
    try:
        step, evaluations, seconds = counted(problem)
        if seconds < TWICE_S:  # the compilation at the first solve is not charged
            step, evaluations, seconds = counted(problem)
    except InputError as refused:
        return Finding(number, problem.about, cells, f"input: {refused}")
    solution, oracle, costs = step.solution, problem.oracle, dict[str, float]()
    cost = oracle.value(np.log(solution.cell_resistance).ravel()) if solution.solved else np.inf
    if solution.status not in UNSOLVED:
        end = process_time() + judge_s
        estimate = solution.cell_resistance if solution.solved else None
        with np.errstate(all="ignore"):
            for name, place in ends(problem, np.random.default_rng([seed, number, 1]), estimate):
                value = oracle.value(place) if np.all(np.isfinite(place)) else np.inf
                costs[name] = min(costs.get(name, np.inf), value if np.isfinite(value) else np.inf)
                if process_time() > end:
                    break
    cells, status = cells * len(problem.data.measured), solution.status.name
    return Finding(number, problem.about, cells, status, cost, costs, oracle.blank(), evaluations, seconds)


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


def report(findings: list[Finding]) -> bool:
    """Print the table; whether the claim holds."""
    asked, slow = [finding for finding in findings if finding.asked], list[tuple[Finding, float]]()
    print(f"{len(findings)} problems, {len(findings) - len(asked)} of them not asked (too little read, or refused)")
    print("unknowns  problems  equal  better  worse  unsolved  evaluations median/most  CPU s median/most")
    for first, last in pairwise((0, *CLASSES)):
        own = [finding for finding in asked if first < finding.cells <= last]
        if not own:
            continue
        counts, seconds = [finding.evaluations for finding in own], [finding.seconds for finding in own]
        verdicts, usual = Counter(finding.verdict for finding in own), float(np.median(counts))
        words = [f"{verdicts[name]:6d}" for name in ("equal", "better", "worse", "unsolved")]
        times = f"{usual:.0f} / {max(counts)}, {np.median(seconds):.3f} / {max(seconds):.2f}"
        print(f"{last:8d}  {len(own):8d}  {'  '.join(words)}  {times}")
        ratios = [(finding, finding.evaluations / usual) for finding in own]
        slow += [(finding, ratio) for finding, ratio in ratios if ratio > SLOW]
    solvers = Counter(name for finding in asked for name in finding.costs)
    print(f"compared: {sum(bool(finding.costs) for finding in asked)} of {len(asked)};", dict(solvers))
    print("statuses:", dict(Counter(finding.status for finding in findings)))
    bad = [finding for finding in asked if finding.verdict in ("worse", "unsolved")]
    for finding in bad:
        share = (finding.cost - finding.least) / max(finding.least, 1e-300)
        print(f"{finding.verdict}: {finding.number} {finding.status} {share:.1e} {finding.costs} {finding.about}")
    for finding, ratio in slow:
        print(f"slow: {finding.number} {ratio:.0f} × {finding.evaluations} {finding.seconds:.1f} s {finding.about}")
    return not slow and all(finding.verdict != "worse" and finding.status in NAMED for finding in bad)


def main() -> int:
    """Return 0 where the claim holds, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--most-cells", type=int, default=24 * 24, help="of a panel; larger ones are left out")
    parser.add_argument("--judge-s", type=float, default=np.inf, help="processor seconds of other solvers a problem")
    arguments = parser.parse_args()
    drawn, findings = range(arguments.first, arguments.first + arguments.problems), []
    cells = {number: RandomProblem.drawn(arguments.seed, number).cells[0].size for number in drawn}
    numbers = [number for number in drawn if cells[number] <= arguments.most_cells]
    with ProcessPoolExecutor(arguments.processes) as pool:
        futures = [pool.submit(examine, arguments.seed, number, arguments.judge_s) for number in numbers]
        for count, future in enumerate(as_completed(futures), 1):
            findings.append(future.result())
            word = findings[-1].verdict if findings[-1].asked else "not asked"
            words = (f"{count}/{len(futures)}", findings[-1].number, word, findings[-1].status, findings[-1].about)
            print(*words, file=sys.stderr, flush=True)
    return 0 if report(sorted(findings, key=lambda finding: finding.number)) else 1


if __name__ == "__main__":
    sys.exit(main())
