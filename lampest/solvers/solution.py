"""Result of a solve: status, outcome of the solver, and checked solution."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, ClassVar

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.files.document import INLINE
from lampest.files.errors import brief
from lampest.files.typed import (
    Extensible,
    ReadOnlyArrays,
    Validated,
    check_positive_fields,
    check_ranges,
    typed,
)
from lampest.panel.panel import Array, Mask
from lampest.solvers.bounds import MILLIONTH
from lampest.solvers.certificate import MIN_COST_SHARE, Certificate, Definiteness
from lampest.solvers.preconditioners import Preconditioner

# KKT residual, relative to the cost's scale, up to which an optimum counts as verified.
VERIFIED = MILLIONTH
# A cell within 1 % of a bound counts as being at it.
OPEN_FRACTION = 0.99
MAX_STARTS = 1000
SAME_MINIMUM = 1e-9  # relative difference of cost below which two minima are the same


class Status(Enum):
    """Status of a solve, as a sentence; only the first seven statuses come with an estimate.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.steps[0].solution.status.value
    'local optimum verified'
    """

    OPTIMUM = "local optimum verified"
    HELD = (
        "an optimum, but only within the bounds: "
        "cells that these hold leave readings off by more than their noise "
        "(by a millionth where that is unknown)"
    )
    MISSED = "an optimum, but it misses more than a tenth of the readings by ten times their noise"
    UNCOMPARED = (
        "an optimum, but compared with no unloaded panel: the solve of that was not verified"
    )
    FLAT = "an optimum, but a plateau: the data and penalties leave some cells undetermined"
    FAINT = "an optimum, but some cells are determined so weakly that they may still move"
    APPROXIMATE = "approximate, as the formulation asks; not an optimum"
    SADDLE = "the optimality conditions hold, but at a saddle: the cost falls from there"
    UNVERIFIED = "the solver reported an optimum, but the optimality conditions do not hold"
    WORSE = "the solver stopped at a point that costs more than its start"
    UNREAD = "too few of the frame's readings are values: the others are missing, or bounds"
    UNRESTED = (
        "too few of the unloaded panel's readings are values, and the method compares with them"
    )
    BROKEN_OFF = "the run was broken off before this frame"
    ROUNDED = (
        "not converged: "
        "one term outweighs the others by more than the sixteen digits of double precision"
    )
    STALLED = (
        "not converged: the cost has stopped falling; "
        "the data and penalties determine some cells too weakly"
    )
    ITERATIONS = "the iteration limit was reached before an optimum"
    TIME = "the time limit was reached before an optimum"
    INFEASIBLE = "the solver found no point that satisfies the constraints"
    OVERDETERMINED = "the program has more equations than unknowns"
    UNBOUNDED = "the cost falls without limit along an unknown that no bound and no data hold"
    BREAKDOWN = "the solver broke down numerically"
    UNAVAILABLE = "the solver or its linear solver is not available"


UNSETTLED = {Definiteness.POSITIVE: Status.FAINT, Definiteness.UNDETERMINED: Status.FLAT}
ADVICE = {
    Status.OPTIMUM: "Nothing to do.",
    Status.HELD: "Look at the cells at their bounds: "
    "a reading may be wrong, or `bounds` too narrow.",
    Status.MISSED: "Check the scene and the weights: "
    "the loss of the misfit ignores readings that are far off, "
    "and these are too many to be outliers.",
    Status.UNCOMPARED: "Take `formulation: reduced`, or raise `solver: max_iterations`: "
    "without the unloaded panel, terms that compare frames begin at the frame before.",
    Status.FLAT: "Add a penalty, or a weight to the one there is; "
    "do not interpret the undetermined cells.",
    Status.FAINT: "Add a penalty, lower `solver: tolerance`, "
    "or read the error bars before these cells.",
    Status.APPROXIMATE: "Take a formulation that ends at an optimum where a frame matters.",
    Status.SADDLE: "Begin at more places: `solver: {starts: 10}`.",
    Status.UNVERIFIED: "Take `formulation: reduced`; if that ends so too, report the frame.",
    Status.WORSE: "Take `formulation: reduced`; if that ends so too, report the frame.",
    Status.UNREAD: "Measure the frame again; `lampest info` counts what is missing.",
    Status.UNRESTED: "Choose other unloaded frames with `lampest tare`.",
    Status.BROKEN_OFF: "Run the same command again: it solves unfinished cases anew.",
    Status.ROUNDED: "Lower the weight of the heaviest term.",
    Status.STALLED: "Raise the weight of a penalty, or the corner of its loss; "
    "check that the readout fits the data.",
    Status.ITERATIONS: "Raise `solver: max_iterations`, or add a penalty.",
    Status.TIME: "Raise `solver: time_limit_s`.",
    Status.INFEASIBLE: "Check `bounds`: they may leave no room.",
    Status.OVERDETERMINED: "Take out constraints that repeat others.",
    Status.UNBOUNDED: "Give the unknown a prior or bounds.",
    Status.BREAKDOWN: "Check the weights and the scene's unit; report the frame if both are right.",
    Status.UNAVAILABLE: "Install IPOPT's linear solver, or take `formulation: reduced`.",
}  # remedy for each status, one sentence
STRICT = (Status.OPTIMUM, Status.HELD, Status.MISSED)  # certified strict minima
OPTIMA = (*STRICT, Status.UNCOMPARED, Status.FLAT, Status.FAINT)


@dataclass(frozen=True)
class IpoptOptions(Extensible):
    """Options of IPOPT by its own names, such as `max_iter` or `linear_solver`.

    They take the place of lampest's in cold and warm solves. The solve that goes on to the digits
    of double precision keeps its own tolerance, start and pivots. `Settings` checks them.

    >>> lampest.Settings(ipopt={"max_iter": 100}).ipopt.own
    (('max_iter', 100),)
    """

    own: tuple[tuple[str, int | float | str], ...] = field(default=(), metadata={INLINE: True})

    @classmethod
    def completed(cls, content: Any) -> Any:
        """Return arguments, or the content of a file, with IPOPT's options in `own`."""
        if not isinstance(content, dict) or content.keys() == {"own"}:
            return content
        from lampest.formulation.ipopt import is_option

        own = {key: value for key, value in content.items() if is_option(key)}
        unknown = {key: value for key, value in content.items() if key not in own}
        return {**unknown, "own": tuple(own.items())}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Return the schema that takes a mapping in Python, too. Called by pydantic."""

        def made(content: Any) -> Any:
            return cls(own=tuple(content.items())) if isinstance(content, dict) else content

        json, python = (
            {
                "type": "function-before",
                "function": {"type": "no-info", "function": function},
                "schema": handler(source),
            }
            for function in (cls.completed, made)
        )
        return {"type": "json-or-python", "json_schema": json, "python_schema": python}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        """Return the JSON schema of any option. Called by pydantic."""
        values = {"type": ["integer", "number", "string"]}
        return {"type": "object", "additionalProperties": values}


@dataclass(frozen=True)
class Settings(Validated):
    """Settings of a solver.

    Attributes
    ----------
    tolerance : float
        Limit of the solver's scaled optimality error.
    max_iterations : int
        Maximum number of iterations of one solve.
    time_limit_s : float or None
        Time limit of one frame in s, over all starts together. A frame that is not solved by then
        holds NaN, and its status states the cause. None for no limit: then no result depends on the
        speed of the computer.
    starts : int or None
        Number of starts of every frame, of which the lowest minimum is taken. None: one where the
        cost has a single minimum; else up to 3, or up to 40 with losses that are not convex. With
        convex losses, a frame that follows another keeps the first strict minimum.
    ipopt : IpoptOptions or None
        Options of IPOPT, by its own names; a mapping in Python, too.

    Raises ValueError for a number out of range, an option that IPOPT does not have, or a value that
    IPOPT does not take.

    >>> lampest.Settings(max_iterations=50).max_iterations
    50
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    tolerance: float = 1e-8
    max_iterations: int = 300
    time_limit_s: float | None = None
    starts: int | None = None
    ipopt: IpoptOptions | None = None

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise ValueError("tolerance must lie between 0 and 1")
        check_ranges(self, 1, 1_000_000, "max_iterations")
        check_positive_fields(self, "time_limit_s")
        check_ranges(self, 1, MAX_STARTS, "starts")
        if self.ipopt is not None:
            from lampest.formulation.ipopt import check_options

            check_options(dict(self.ipopt.own))


@dataclass(frozen=True, eq=False)
class Outcome(ReadOnlyArrays):
    """Result of a solver before any check.

    Attributes
    ----------
    cell_resistance : array, shape (frames, rows, columns)
        Cells in ohm.
    dual : array
        Duals z of the absolute losses, |z| ≤ 1.
    status : Status
    iterations : int
    certificate : Certificate or None
        Certificate of these cells.
    carried : object
        What the solver of the next frame can begin with: a Preconditioner, an end of IPOPT, or
        None.
    convex : bool
        Whether no direction of negative curvature was met.
    at : Evaluation or None
        Evaluation at these cells or near them.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> import numpy as np
    >>> cells, dual = estimate.cell_resistance, np.zeros(0)
    >>> lampest.Outcome(cells, dual, lampest.Status.APPROXIMATE, iterations=1).iterations
    1
    """

    cell_resistance: Array
    dual: Array
    status: Status
    iterations: int
    certificate: Certificate | None = None
    carried: object = None
    convex: bool = False
    at: Evaluation | None = None

    @property
    def preconditioner(self) -> Preconditioner | None:
        """The preconditioner, if that is carried."""
        return self.carried if isinstance(self.carried, Preconditioner) else None


@dataclass(frozen=True, eq=False)
class Solution(ReadOnlyArrays):
    """Checked estimate of one solve.

    Arrays are NaN unless the estimate is an optimum, or an approximation that was requested.

    Attributes
    ----------
    cell_resistance, reading : array, shape (frames, rows, columns)
        Cells in ohm, and the modelled readings in the readout's unit.
    costs : array, shape (terms,)
        Weighted cost of each term.
    objective : float
        Cost φ.
    kkt_residual : float
        See `Evaluation.kkt_residual`.
    at_lower, open_cell : boolean array, shape (frames, rows, columns)
        Whether a cell is at its lower bound, or at its upper bound.
    status : Status
    iterations : int
        Iterations of the solve from the start that gave this solution.
    at : Evaluation or None
        Evaluation at the cells; None where nothing was solved.
    dual : array or None
    carried : object
    convex : bool
        See `Outcome`.
    starts : int
        Number of starts that were tried.
    solver : str
        Name of the solver.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.steps[0].solution.solved
    True
    """

    cell_resistance: Array
    reading: Array
    costs: Array
    objective: float
    kkt_residual: float
    at_lower: Mask
    open_cell: Mask
    status: Status
    iterations: int
    at: Evaluation | None = None
    dual: Array | None = None
    carried: object = None
    convex: bool = False
    starts: int = 1
    solver: str = ""

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    @property
    def solved(self) -> bool:
        """Whether there is an estimate."""
        return self.optimum or self.status is Status.APPROXIMATE

    @property
    def strict(self) -> bool:
        """Whether the estimate is verified as a strict minimum within the bounds."""
        return self.status in STRICT

    @property
    def optimum(self) -> bool:
        """Whether the estimate is an optimum over the cells, to double precision."""
        return self.status in OPTIMA


@dataclass(frozen=True)
class Solver(ABC):
    """Solver of one cost.

    Attributes
    ----------
    cost : Cost
        Cost that is minimised.
    settings : Settings
        Tolerance and limits of a solve.
    cells_alone : bool
        Whether cells are the only unknowns: potentials are eliminated, and a solve holds its start.

    >>> sorted(name for name in vars(lampest.Solver) if not name.startswith("_"))
    ['cells_alone', 'cold', 'continued', 'name', 'prepare', 'solve']
    """

    cells_alone: ClassVar[bool] = True

    cost: Cost
    settings: Settings

    @property
    def name(self) -> str:
        """The solver in words, for tables; by default the name of its class."""
        return type(self).__name__

    def prepare(self) -> None:
        """Compile the cost, so that the time of the first solve excludes it."""
        _ = self.cost.functions

    def continued(self, carried: object) -> "Solver":
        """Return the solver that begins with the data `carried` by the previous frame's solution.

        Returns the solver itself if it has no use for these data.
        """
        return self

    def cold(self) -> "Solver":
        """Return the solver for a start far from any optimum; by default the same.

        Lower minima are found along the central path of the bounds' barrier than by steps straight
        down.
        """
        return self

    @abstractmethod
    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise the cost from a start; a failed solve does not raise."""


def lower_of(best: Solution | None, solution: Solution) -> Solution:
    """Return the solution of lower cost, or `best` if the costs are equal or nothing is solved."""
    if best is None or (solution.solved and not best.solved):
        return solution
    # near 0 relative differences say nothing: several panels may give the readings exactly
    rounding = 0.0 if best.at is None else MIN_COST_SHARE * best.at.cost_scale
    lower = solution.objective < best.objective * (1 - SAME_MINIMUM) - rounding
    return solution if solution.solved and lower else best


@typed
def approximation(cost: Cost, data: Data, outcome: Outcome) -> Solution:
    """Return the solution, with cost and KKT residual, of a method that does not end at an optimum.

    >>> import inspect
    >>> list(inspect.signature(lampest.approximation).parameters)
    ['cost', 'data', 'outcome']
    """
    if not np.all(np.isfinite(outcome.cell_resistance)):
        return failure(cost, data, Status.BREAKDOWN, float("nan"), outcome)
    at = Evaluation.at(cost, data, np.clip(outcome.cell_resistance, data.lower, data.upper))
    return solution_at(at, at.kkt_residual(outcome.dual), outcome, Status.APPROXIMATE)


def solution_at(at: Evaluation, residual: float, outcome: Outcome, status: Status) -> Solution:
    """Return the solution at an evaluation, with its KKT residual, for a checked outcome."""
    cells = at.cell_resistance
    data = at.data
    return Solution(
        cells,
        at.reading,
        at.costs,
        at.objective,
        kkt_residual=residual,
        at_lower=cells <= data.lower / OPEN_FRACTION,
        open_cell=cells >= data.upper * OPEN_FRACTION,
        status=status,
        iterations=outcome.iterations,
        at=at,
        dual=outcome.dual,
        carried=outcome.carried,
        convex=outcome.convex,
    )


def failure(cost: Cost, data: Data, status: Status, residual: float, outcome: Outcome) -> Solution:
    """Return a solution of NaN with a status, a KKT residual, and the iterations of an outcome."""
    no_solution = blank(data.measured.shape, len(cost.terms), status)
    return replace(no_solution, kkt_residual=residual, iterations=outcome.iterations)


def blank(shape: tuple[int, ...], terms: int, status: Status) -> Solution:
    """Return a solution of NaN, (frames, rows, columns), with the status of a failed solve."""
    unknown = np.full(shape, np.nan)
    flags = np.zeros(shape, dtype=bool)
    return Solution(
        cell_resistance=unknown,
        reading=unknown,
        costs=np.full(terms, np.nan),
        objective=float("nan"),
        kkt_residual=float("nan"),
        at_lower=flags,
        open_cell=flags,
        status=status,
        iterations=0,
    )
