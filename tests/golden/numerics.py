"""Rows of costs, solvers and error bars."""

import re
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache, partial
from itertools import product
from typing import Any, Literal, get_args, get_origin, get_type_hints
from unittest.mock import patch

import casadi
import numpy as np
from casadi import DM, Function
from golden.circuits import LISTED, PANEL, Rows, cells_of
from golden.content import OfKind

import lampest as lp
from lampest.cost import losses, problem
from lampest.cost.cost import Cost
from lampest.cost.given import Background, Given
from lampest.estimate.estimator import Estimator
from lampest.estimate.weights import EvidencePoint
from lampest.files.errors import InputError
from lampest.files.typed import members_of
from lampest.formulation.circuit import Circuit, ConductanceSymbols
from lampest.formulation.instance import ProgramResult, on_bounds
from lampest.formulation.ipopt import Interface
from lampest.formulation.patterns import EXCITATIONS, FrameNetwork
from lampest.formulation.program import Program
from lampest.panel import least_squares
from lampest.panel.equation import equation_of
from lampest.panel.trust_region import steihaug
from lampest.posterior import certainty, covariance, interval, linear, spectrum
from lampest.posterior.chain import Chain
from lampest.posterior.covariance import DenseMemory, active_bounds
from lampest.posterior.linear import LinearModel
from lampest.posterior.reference import references
from lampest.posterior.sampled import SampledErrors, SampledMemory
from lampest.posterior.track import beyond_bounds, beyond_tangents
from lampest.recording.readings import Readings, Sidedness
from lampest.solvers import bounds, by_ipopt, multistart, preconditioners
from lampest.solvers.certificate import certificate
from lampest.solvers.check import check
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.projected_lbfgs import InverseHessians
from lampest.solvers.projected_lbfgs import solve as solve_panels
from lampest.solvers.projected_newton import Iterate, ProjectedNewton, descent_step, levenberg_step
from lampest.solvers.solution import Outcome, Settings, Status

# Costs

LOSSES = tuple(
    loss(**{field.name: 40.0 for field in fields(loss) if field.default is MISSING})
    for loss in members_of(losses.AnyLoss)
)


def example(frames: int) -> tuple[problem.Data, lp.Array]:
    """Data of the panel, some of them bounds or missing, and cells near those that made them."""
    rng = np.random.default_rng(0)
    truth = cells_of((frames, *PANEL.shape))
    measured = lp.two_point_resistance(truth) * np.exp(0.05 * rng.standard_normal(truth.shape))
    sigma = 10.0 * np.exp(0.3 * rng.standard_normal(truth.shape))
    side = np.zeros(truth.shape)
    observed = np.ones(truth.shape)
    side[:, 0, 0], side[:, 3, 4], observed[:, 1, 2] = 1.0, -1.0, 0.0
    known = {name: cells_of(PANEL.shape, seed) for name, seed in (("previous", 3), ("baseline", 4))}
    known["previous_deviation"] = 0.1 * np.exp(0.3 * rng.standard_normal(PANEL.shape))
    given = Given(
        measured=measured, sigma=sigma, side=side, seen=observed, **(known if frames == 1 else {})
    )
    return problem.Data(given, measured / 10, measured * 1e3), truth * np.exp(
        0.2 * rng.standard_normal(truth.shape)
    )


def term_row(term: type[lp.Term], words: dict[str, str], loss: lp.Loss) -> list[Any]:
    rows = []
    for frames, panel in ((1, PANEL), (2, PANEL), (1, LISTED))[: 3 if loss.squared else 1]:
        cost = Cost(
            panel,
            (lp.Misfit(), term(weight=0.7, loss=loss, **words)),
            frames,
            () if panel is PANEL else (0,),
            partial=True,
        )
        data, cells = example(frames)
        at = problem.Evaluation.at(cost, data, cells)
        dual = np.tanh(at.nonsmooth / 50)
        smoothing = Smoothing(50.0, dual)
        hessian = Hessian(at, smoothing)
        step = np.random.default_rng(5).standard_normal(cells.size)
        rows.append(
            {
                "costs": at.costs,
                "scale": at.cost_scale,
                "gradient": at.log_gradient(dual),
                "gap": at.dual_gap(dual),
                "nonsmooth": at.nonsmooth,
                "kkt": at.kkt_residual(dual),
                "product": hessian.product(step),
                "normal": hessian.gauss_newton_product(step),
                "diagonal": hessian.diagonal,
                "matrix": hessian.matrix,
                "smooth": smoothing.objective(at),
                "terms": hessian.terms,
                "penalties": hessian.penalty_matrix,
            }
        )
    return rows


def loss_row(loss: lp.Loss) -> dict[str, Any]:
    x = np.array([-90.0, -41, -39, -3, 0, 0.5, 20, 45, 300])
    values = (
        loss.curvature,
        loss.stiffness,
        loss.steady_pull,
        lambda far: float(DM(loss.cost(DM(far)))),
    )
    evidence = losses.PenaltyEvidence(x, 500.0, 7.0, lambda: 2.5)
    return {
        "cost": float(DM(loss.cost(DM(x)))),
        "curvature": loss.curvature(x),
        "stiffness": loss.stiffness(x),
        "data": loss.data_curvature(x, np.full(9, 3.0)),
        "penalty": loss.penalty_curvature(x, 2.0, 3.0),
        "pull": loss.steady_pull(x),
        "size": loss.size(evidence),
        "determined": loss.determined(evidence),
        "far": [[value(np.array([far])) for far in (-1e8, -1e4, 1e8)] for value in values],
    }


def program_row(formulation: str, loss: lp.Loss) -> dict[str, Any]:
    """A nonlinear program at some point: its objective, constraints and derivatives."""
    cost = Cost(PANEL, (lp.Misfit(), lp.LogGradient(weight=0.7, loss=loss)), 1)
    program = Program.build(cost, lp.TwoPointReadout(), None, formulation)
    rng = np.random.default_rng(2)
    x, p = (
        np.exp(0.3 * rng.standard_normal(symbol.shape[0]))
        for symbol in (program.nlp["x"], program.nlp["p"])
    )
    multipliers = rng.standard_normal(program.nlp["g"].shape[0])
    values = Function(
        "values", [program.nlp["x"], program.nlp["p"]], [program.nlp["f"], program.nlp["g"]]
    )(x, p)
    hessian = program.hessian()(x, p, 1.3, multipliers)
    return {"values": [np.asarray(value) for value in values], "hessian": np.asarray(DM(hessian))}


FORMS: dict[str, Any] = {
    "steps": lambda state, r: casadi.vec(state.grid(r)[1:, :] - state.grid(r)[:-1, :]),
    "slices": lambda state, r: r[:, 1:] - r[:, :-1],
    "none": lambda state, r: r[0:0],
    "matrix": lambda state, r: state.grid(r),
    "constant": lambda state, r: DM.ones(20),
    "measured": lambda state, r: state.measured,
    "change": lambda state, r: r / state.previous,
    "gradient": lambda state, r: DM.eye(40) @ state.gradient(r),
}


@dataclass(frozen=True)
class Own(lp.Term):
    """A user's own penalty; `form` : how its residual is written."""

    unit = "ohm"
    form: str = "steps"

    def residual(self, state: lp.State) -> Any:
        return FORMS[self.form](state, state.cell_resistance)


def own_terms_row() -> dict[str, Any]:
    """Costs of a user's own terms, or why they are refused; a panel of one cell has no pairs."""
    rows: dict[str, Any] = {}
    data, cells = example(1)
    for form, (name, panel) in product(
        FORMS, {"whole": PANEL, "listed": LISTED, "one": lp.Panel(1, 1)}.items()
    ):
        try:
            cost = Cost(panel, (lp.Misfit(), Own(form=form)), partial=True)
            assert cost.functions
            rows[f"{form} {name}"] = (
                problem.Evaluation.at(cost, data, cells).costs if panel is PANEL else None
            )
        except InputError as error:
            rows[f"{form} {name}"] = re.sub(r"(raises \w+ )\(.*\):", r"\1…:", str(error))
    return rows


def formulation_row(name: str) -> list[Any]:
    """Unknown voltages of a solved network by name, without and with wire."""
    form = EXCITATIONS[name]
    rows = list[Any]()
    for readout in (
        lp.TwoPointReadout(),
        lp.GroundedReadout(),
        lp.LoadedColumnsReadout(driven="columns"),
    ):
        for shape in ((4, 5), (5, 3), (1, 4)):
            cells = cells_of((5, 5))[: shape[0], : shape[1]]
            tie = readout.ties(readout.exact_reading(cells))
            for wiring in (
                None,
                lp.Scene(lp.Panel(*shape), readout, lines=lp.Lines(20.0, 0.0)).wiring,
            ):
                circuit = Circuit.of(shape, wiring)
                sizes = {"g": cells.size, "t": sum(shape), "s": 1}
                symbols = (casadi.SX.sym(letter, size) for letter, size in sizes.items())
                reading = equation_of(readout, *shape).reading
                begun = FrameNetwork(circuit, readout, ConductanceSymbols(*symbols, reading))
                rows.append(form(begun).values(circuit.voltages(cells, tie)))
    return rows


def of_cost() -> Rows:
    variants = [
        (kind, term, words) for kind, term in lp.term_types().items() for words in options(term)
    ]
    return (
        {f"loss {loss.kind}": partial(loss_row, loss) for loss in LOSSES}
        | {f"formulation {name}": partial(formulation_row, name) for name in EXCITATIONS}
        | {"own terms": own_terms_row}
        | {
            " ".join([kind, *words.values(), loss.kind]): partial(term_row, term, words, loss)
            for kind, term, words in variants
            for loss in LOSSES
        }
        | {
            f"program {name} {loss.kind}": partial(
                program_row,
                name,
                loss,
            )
            for name in EXCITATIONS
            for loss in LOSSES
        }
    )


def options(term: type[lp.Term]) -> list[dict[str, str]]:
    """Every combination of a term's choices of words, such as misfit's weighting."""
    hints = {
        name: get_args(hint)
        for name, hint in get_type_hints(term).items()
        if get_origin(hint) is Literal
    }
    choices = {name: words for name, words in hints.items() if name != "kind"}
    return [dict(zip(choices, words, strict=True)) for words in product(*choices.values())]


# Solvers and error bars

COSTS: dict[str, tuple[lp.Term, ...]] = {
    "plain": (lp.Misfit(),),
    "penalty": (lp.Misfit(weighting="noise"), lp.LogGradient(weight=2.0)),
    "ohm": (lp.Misfit(), lp.Gradient(weight=1e-3), lp.CellResistance(weight=1e-4)),
    "absolute": (lp.Misfit(), lp.TotalVariation(weight=3.0)),
    "huber": (lp.Misfit(), lp.Gradient(weight=0.01, loss=lp.Huber(corner=150.0))),
    "student": (lp.Misfit(loss=lp.Student(corner=30.0)), lp.LogGradient(weight=2.0)),
    "change": (
        lp.Misfit(),
        lp.RelativeChange(weight=10.0),
        lp.LogRatio(weight=10.0, loss=lp.Student(corner=0.1)),
    ),
}
TINY = {
    "whole": lp.Scene(PANEL, lp.TwoPointReadout(noise_lsb=0.7)),
    "driven": lp.Scene(PANEL, lp.LoadedColumnsReadout(noise_lsb=1.0, drive_ohm=100.0)),
    "wired": lp.Scene(PANEL, lp.TwoPointReadout(noise_lsb=0.7), lines=lp.Lines(20.0, 5.0)),
}


MAX_ITERATIONS = 30  # of one start: twice what is needed


@cache
def point(
    cost: str, circuit: str = "whole", frames: int = 1, decades: float = 0.0
) -> problem.Evaluation:
    """The cost near the cells that made noisy readings, some of them bounds."""
    scene = TINY[circuit]
    terms = COSTS[cost]
    rng = np.random.default_rng(11)
    cells = cells_of((frames, *PANEL.shape)) * 10 ** (decades * rng.uniform(-0.5, 0.5, PANEL.shape))
    recorded = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    recorded = recorded * (1 + 0.004 * rng.standard_normal(cells.shape))
    if cost == "penalty":
        recorded[:, 1, 3] = np.nan
    readings = Readings.of(scene, recorded)
    estimator = Estimator(terms, "reduced")
    known = (
        {"previous": cells_of(PANEL.shape, 3), "baseline": cells_of(PANEL.shape, 4)}
        if frames == 1
        else {}
    )
    data = estimator.data(readings, Background(scene, **known))
    return multistart.evaluated(
        estimator.cost(scene, frames, partial=data.partial),
        data,
        cells * np.exp(0.1 * rng.standard_normal(cells.shape)),
    )


def solver_row(cost: str, circuit: str, solver: str) -> dict[str, Any]:
    """The minimum from a start that is far away."""
    begin = point(cost, circuit)
    kinds = {"newton": ProjectedNewton(begin.cost, Settings())}
    known = begin.cost, Settings(), TINY[circuit].circuit, TINY[circuit].wiring
    kinds |= {name: by_ipopt.Ipopt(*known, name) for name in EXCITATIONS}
    solution = multistart.best_solution(kinds[solver], begin.data, None)
    return {
        "cells": solution.cell_resistance,
        "reading": solution.reading,
        "costs": solution.costs,
        "dual": solution.dual,
        "status": solution.status,
        "lower": solution.at_lower,
        "open": solution.open_cell,
    }


def begun_row(cost: str, circuit: str, form: str) -> list[Any]:
    """The problem given to IPOPT, and the solutions from some of its results."""
    at = point(cost, circuit)
    scene = TINY[circuit]
    given = dict[str, Any]()
    rng = np.random.default_rng(4)

    def minimise(interface: Interface, instance: Any, warm: Any = None) -> ProgramResult:
        given.update(
            start=instance.start,
            parameter=instance.parameter,
            lower=instance.lower,
            upper=instance.upper,
            units=[instance.scale, instance.cost_scale, instance.split_scale],
        )
        pull = rng.standard_normal(len(instance.start))
        pull[:3] = 1e3, -1e3, 0.0
        equations = rng.standard_normal(interface.program.equation.column.shape[0])
        ended = instance.start * np.exp(0.1 * rng.standard_normal(len(instance.start)))
        return ProgramResult(ended, pull, equations, "Search_Direction_Becomes_Too_Small", 7)

    with patch.object(Interface, "minimise", minimise), patch.object(by_ipopt, "MAX_FINE", 0):
        solver = by_ipopt.Ipopt(at.cost, Settings(), scene.circuit, scene.wiring, form)
        outcome = solver.solve(at.data, at)
    return [given, outcome.cell_resistance, outcome.dual, outcome.status, outcome.iterations]


def limits_row() -> list[lp.Array]:
    """Cells on a bound, near it, within, and between equal bounds, moved by multipliers."""
    low = np.array([1.0, 1, 1, 1, 2, 2, 0, 1])
    high = np.array([5.0, 5, 5, 5, 8, 8, 50, 1])
    at = np.array([1.0, 1 + 1e-8, 5, 4.9, 3, 7.5, 1e-3, 1])
    pull = np.array([-2.0, 3, 4, -5, 6, -7, 8, 9])
    return [on_bounds(at, size * pull, low, high) for size in (-1, 1, 40)]


def certificate_row(cost: str, circuit: str, decades: float) -> dict[str, Any]:
    at = point(cost, circuit, decades=decades)
    smoothing = Smoothing.start(at)
    hessian = Hessian(at, smoothing)
    proof = certificate(hessian)
    free = bounds.free_cells(at, hessian.gradient)
    factors = [
        preconditioners.preconditioner(hessian, free),
        *([preconditioners.TwoLevel.of(hessian)] if circuit == "whole" else []),
    ]
    moved = ProjectedNewton(at.cost, Settings()).solve(at.data, at)
    return {
        "kind": proof.definiteness,
        "step": proof.step,
        "decrement": proof.decrement,
        "deviations": proof.deviations,
        "settled": proof.settled,
        "converged": proof.converged(at.cost_scale),
        "free": free,
        "smoothing": smoothing.width,
        "preconditioned": [
            factor.over(free, at.cell_resistance)(hessian.gradient[free]) for factor in factors
        ],
        "certain": check(at, moved).kkt_residual < 1e-7,
        "matter": bounds.bounds_matter(
            at, hessian.gradient.reshape(at.position.shape), np.zeros(len(at.nonsmooth))
        ),
        "minima": multistart.several_minima(at.cost, at.data),
        "starts": list(multistart.starts(at.cost, at.data, at.cell_resistance)),
        "scattered": next(multistart.scattered(at.data)),
    }


def steps_row() -> dict[str, Any]:
    """One step of each kind from points near and far, at several dampings."""
    rows: dict[str, Any] = {}
    for cost, circuit, decades in (
        ("plain", "whole", 0.0),
        ("plain", "whole", 4.0),
        ("plain", "driven", 4.0),
        ("student", "whole", 0.0),
        ("penalty", "whole", 6.0),
        ("absolute", "driven", 4.0),
        ("ohm", "whole", 6.0),
    ):
        begin = Iterate.of((at := point(cost, circuit, decades=decades)), Smoothing.start(at))
        trials = [
            levenberg_step(replace(begin, damping=damping)) for damping in (1e-15, 1e-3, 10.0)
        ]
        trials += [descent_step(replace(begin, gauss_newton=patience)) for patience in (0, 3)]
        rows[f"{cost} {circuit} {decades}"] = [
            trial
            and [
                trial.at.cell_resistance,
                trial.objective,
                trial.damping,
                trial.gauss_newton,
                trial.convex,
                trial.expected,
            ]
            for trial in trials
        ]
    return rows


def batch_row() -> dict[str, Any]:
    """Panels that are solved together, some of them at bounds, after few steps and at the end."""
    rows = dict[str, Any]()
    numbers = np.array([0, 1, 3, 4, 6])
    scene = TINY["whole"]
    cells = cells_of((5, *PANEL.shape), 5, 0.3)
    for cost, steps in (
        ("plain", 6),
        ("penalty", 2),
        ("penalty", 99),
        ("student", 6),
        ("student", 99),
    ):
        rng = np.random.default_rng(6)
        recorded = lp.two_point_resistance(cells) * (1 + 0.01 * rng.standard_normal(cells.shape))
        estimator = Estimator(COSTS[cost], "reduced", bounds=lp.Bounds(lower=1000.0, upper=5000.0))
        data = estimator.data(Readings.of(scene, recorded), Background(scene)).of_panels()
        begin = np.clip(cells * np.exp(0.3 * rng.standard_normal(cells.shape)), 1000.0, 5000.0)[
            [0, 1, 2, 4, 4], None
        ]
        weights = rng.uniform(0.5, 2, (5, len(COSTS[cost])))
        inverses = InverseHessians.nothing(7)
        for lower in (1000.0, 1500.0):  # of the same frame; then some cells are held that were free
            data = replace(data, lower=np.maximum(data.lower, lower))
            start = problem.Evaluation.at(
                estimator.cost(scene, 1), data, np.maximum(begin, lower), weights
            )
            end = solve_panels(start, inverses.some(numbers), Settings(max_iterations=steps))
            inverses = inverses.replaced(numbers, end.inverses)
            panels = inverses.panels
            begin = end.points.at.cell_resistance
            if cost == "student":  # steps over a cost that is not convex lead far apart
                fell = end.points.at.objectives <= start.objectives
                settled = steps > MAX_ITERATIONS
                rows[f"{cost} {steps} {lower}"] = [
                    fell,
                    *([end.solved, end.points.position] if settled else []),
                ]
                continue
            rows[f"{cost} {steps} {lower}"] = [
                end.points.position,
                end.solved,
                inverses.positive,
                np.array([panel is None or panel.worn for panel in panels]),
                np.array([0 if panel is None else panel.free.sum() for panel in panels]),
                inverses.some(numbers).distance(end.points.position),
                np.array([0 if p is None else np.linalg.norm(p.inverse) for p in panels]),
            ]
    return rows


def verdicts_row() -> dict[str, Any]:
    """Verdicts of a check on outcomes of every status."""
    plain = point("plain")
    blind = point("penalty")
    heavy = Cost(PANEL, (lp.Misfit(), lp.Gradient(weight=1e12)))
    starts = {
        "plain": plain,
        "absolute": point("absolute"),
        "blind": problem.Evaluation.at(
            Cost(PANEL, (lp.Misfit(),), partial=True), blind.data, blind.cell_resistance
        ),
        "heavy": problem.Evaluation.at(heavy, plain.data, plain.cell_resistance),
        "even": problem.Evaluation.at(
            heavy, plain.data, np.full(plain.cell_resistance.shape, 2950.0)
        ),
    }
    rows = {}
    for name, start in starts.items():
        end = ProjectedNewton(start.cost, Settings(max_iterations=40)).solve(start.data, start)
        known = (
            start.cell_resistance,
            end.cell_resistance,
            0.7 * start.cell_resistance,
            np.nan * end.cell_resistance,
        )
        for (number, cells), status in product(
            enumerate(known), (Status.OPTIMUM, Status.STALLED, Status.TIME)
        ):
            rows[f"{name} {number} {status.name}"] = check(
                start, Outcome(cells, end.dual, status, 1)
            ).status
    return rows


def search_row() -> dict[str, Any]:
    """Steps within a radius, and the loop of Levenberg and Marquardt."""
    matrix = np.diag(np.r_[-1.0, np.linspace(0.5, 9, 7)])
    slope = np.linspace(1, 2, 8)
    solved = [
        steihaug(lambda p: matrix @ p, lambda p: p / 2, slope, 1e-3, radius)
        for radius in (0.5, 30.0, np.inf)
    ]
    times = np.linspace(0, 2, 9)

    def decay(x: lp.Array) -> least_squares.SumOfSquares:
        falling = np.exp(-x[1] * times)
        return least_squares.SumOfSquares(
            x[0] * falling - 2 * np.exp(-1.5 * times) - 0.1 * times,
            np.stack([falling, -x[0] * times * falling], 1),
            1e-3,
        )

    def valley(x: lp.Array) -> least_squares.SumOfSquares:
        tried.append(x)
        residual = (
            np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]) if x[0] < 1.6 else np.full(2, np.nan)
        )
        return least_squares.SumOfSquares(
            residual, np.array([[-20 * x[0], 10.0, 0.0], [-1.0, 0.0, 0.0]]), 1e-9
        )

    loop = least_squares.LevenbergMarquardt(60, 1e-16, longest=0.5)
    position, squares = loop.minimum(decay, np.array([1.0, 0.5]), (0.0, 1.4))
    limited = replace(loop, evaluations=7, longest=np.array([0.1, 0.4, 1.0]))
    far = np.array([-1.2, 1, 7.0])
    tried = []
    limited.minimum(valley, far)
    ends = [
        search.minimum(valley, far)[0]
        for search in (loop, replace(loop, damping=0.0), replace(loop, longest=9.0))
    ]
    _, stopped = loop.minimum(valley, far, ended=lambda at, count: at.cost < 1 or count > 30)
    return {
        "steps": solved,
        "position": position,
        "cost": squares.cost,
        "few": tried[:7],
        "tried": len(tried),
        "ends": ends,
        "ended": stopped.cost,
    }


def of_solvers() -> Rows:
    places = [
        ("plain", "whole", 0.0),
        ("plain", "whole", 4.0),
        ("plain", "driven", 0.0),
        ("absolute", "wired", 0.0),
    ]
    places += [(cost, "whole", 0.0) for cost in COSTS if cost != "plain"]
    solves = [(cost, circuit, "newton") for cost in COSTS for circuit in TINY]
    begun = [
        ("plain", "driven", "nodal"),
        ("absolute", "whole", "nodal"),
        ("huber", "whole", "per_pixel"),
    ]
    begun += [("penalty", "whole", "per_pixel"), ("change", "driven", "nodal")]
    solves += [(cost, "whole", "nodal") for cost in COSTS] + [
        ("ohm", "driven", "nodal"),
        ("huber", "whole", "per_pixel"),
    ]
    return (
        {"solve " + " ".join(case): partial(solver_row, *case) for case in solves}
        | {"point " + " ".join(map(str, case)): partial(certificate_row, *case) for case in places}
        | {"begun " + " ".join(case): partial(begun_row, *case) for case in begun}
        | {
            "searches": search_row,
            "limits": limits_row,
            "verdicts": verdicts_row,
            "panels together": batch_row,
            "steps": steps_row,
        }
    )


def model_row(cost: str, circuit: str, sampled: bool) -> dict[str, Any]:
    """Errors of an estimate with all their parts."""
    at = point(cost, circuit)
    rng = np.random.default_rng(3)
    size = at.cell_resistance.size
    terms = at.cost.terms
    model = LinearModel(at, np.tanh(at.nonsmooth), weight_sigma=(np.nan, *[0.7] * (len(terms) - 1)))
    root = 0.3 * rng.standard_normal((2 * size, 2 * size))
    drawn = np.asarray(model.through @ rng.standard_normal((size, 2)))
    earlier = root @ root.T
    columns = rng.standard_normal((3, len(model.noise), 2))
    if sampled:
        memory: Any = SampledMemory(0.1 * rng.standard_normal((2, 20, size)))
        errors: covariance.DenseErrors = SampledErrors(
            model, memory, drawn, samples=20, accuracy=1e-12, fine_accuracy=1e-12
        )
    else:
        memory = DenseMemory(earlier.reshape(2, size, 2, size).swapaxes(1, 2))
        errors = covariance.DenseErrors(model, memory, drawn)
    known = rng.standard_normal((2, size, 2))
    later = errors.memory()
    return {
        "variance": errors.variance,
        "certainty": errors.certainty,
        "widening": errors.widening,
        "share": errors.data_share,
        "resolution": errors.resolution,
        "reading": errors.reading_deviation(),
        "shared": errors.shared_variance,
        "answer": errors.answer(columns[0], known),
        "gained": errors.gained(columns[1]),
        "curvature": model.penalty_curvature,
        "memory": [later.shared(), later.variance(), later.resting().shared()],
        "scale": model.scale,
        "free": model.free,
        "determined": [errors.determined(int(term)) for term in np.unique(model.penalty_term)],
        "noise": model.noise,
        "conductance": errors.certainty.by_conductance(),
        "weights": OfKind(
            "sampled", spectrum.next_weights(SampledErrors(model), range(1, len(terms)))
        ),
        "active": [] if sampled else active_bounds(errors, columns[2], known),
    }


def weights_row(cost: str) -> dict[str, Any]:
    at = point(cost)
    terms = range(1, len(at.cost.terms))
    data = [at.data, point(cost).data]
    scale, fits = references(data, at.cost)
    model = LinearModel(at, np.tanh(at.nonsmooth), deviation=fits[0].deviation)
    spectra = [spectrum.Spectrum.of(model, number, fits[0].covariance) for number in terms]
    return {
        "scale": scale,
        "gains": [scale.gain(each) for each in (0.5, 1.0, 3.0)],
        "reference": fits[0],
        "first": spectrum.first_weights(model, [1.0] * (1 + len(terms)), terms),
        "settled": spectrum.settled_weights(model, terms),
        "best": OfKind("sampled", [spectrum.best_weight([each]) for each in spectra]),
        "risk": [
            (each.risk(0.1), each.risk(10.0), each.information(1.0), each.extent)
            for each in spectra
        ],
        "residual scale": EvidencePoint(
            1.0, [], model.at.cell_resistance, covariance.DenseErrors(model)
        ).residual_scale,
    }


def pair_row() -> Any:
    """Errors of a frame and its baseline, solved together, as matrices and as samples."""
    model = LinearModel(
        point("change", frames=2), np.zeros(len(point("change", frames=2).nonsmooth))
    )
    memories = (
        covariance.DenseErrors(model).memory(),
        SampledErrors(model, samples=20, accuracy=1e-12).memory(),
    )
    return [[each.shared(), each.variance(), each.resting().shared()] for each in memories]


def certainty_row() -> Any:
    """Intervals that further errors and bounds extend."""
    wide = certainty.Certainty(*np.full((6, 1, 2, 3), 0.3))
    apart = np.array([[0.4, 0.3], [0.4, -0.3], [0.1, 0.2]] * 2)
    reaching = wide.reaching(np.array([1, 5]), np.array([0.5, 0.05]), np.array([0.02, 0.4]))
    return (
        reaching,
        wide.widened(apart),
        wide.less(reaching, np.full(6, 0.01).reshape(1, 2, 3)),
        wide.by_conductance(),
    )


def bounded_row() -> Any:
    """The reference estimate of data whose bounds hold some cells."""
    data = point("ohm").data
    return references([replace(data, lower=np.maximum(data.lower, 1200.0))], point("ohm").cost)


def chain_row() -> dict[str, Any]:
    rng = np.random.default_rng(6)
    root = rng.standard_normal((3, 4, 6))
    own = np.einsum("tij,tkj->tik", root, root) + 6 * np.eye(4)
    border = rng.standard_normal((3, 4, 2))
    corner = 30 * np.eye(2)
    chain = Chain(own, np.abs(rng.standard_normal((2, 4))), border, corner)
    doubting = chain.doubting(0.4, np.ones(2)).with_border(np.diag([2.0, 5.0]))
    return {
        "learned": chain.learned(1),
        "solved": chain.solve(border, corner),
        "blocks": chain.blocks,
        "shared": [each.shared_variance(1) for each in (chain, doubting)],
        "variance": doubting.variance,
        "steps": chain.step_variance(np.ones((2, 2))),
        "covariance": chain.covariance(2),
        "since": chain.since(0),
    }


def profile_row(known: bool, cost: str = "penalty") -> Any:
    """Cells without a reading, with a penalty or without; or solved again by a readout's start."""
    at = point(cost)
    model = LinearModel(at, np.zeros(len(at.nonsmooth)))
    missing = np.zeros(PANEL.shape, dtype=bool)
    missing[1, 3], missing[0, 0] = True, cost != "penalty"
    readings = Readings(
        at.data.measured[0], at.data.sigma[0], np.zeros(PANEL.shape), (~missing).astype(float)
    )
    return beyond_tangents(
        model,
        readings,
        missing,
        (lambda moved: np.log(moved.value / readings.value)) if known else None,
    )


def bounds_row() -> Any:
    """Cells that fall together from the bounds of their readings; another bound holds its cell."""
    begin = point("penalty", "driven")
    side = np.zeros(begin.data.measured.shape)
    side[0, 0, :2] = Sidedness.AT_LEAST
    side[0, 1, 0] = Sidedness.AT_MOST
    data = replace(begin.data, given=replace(begin.data.given, side=side))
    solver = ProjectedNewton(begin.cost, Settings())
    solution = multistart.best_solution(solver, data, begin.cell_resistance)
    return beyond_bounds(LinearModel(solution.at, solution.dual), np.full(PANEL.shape, 0.7))


def of_posterior() -> Rows:
    slopes = np.array([0.0, 0.3, 5.0, 49.0, 51.0, 1e4])
    wide = np.array([1.3, 0.2, 5.0, 1.0, 1.0, 3.0])
    cases = [(cost, "whole", sampled) for cost in list(COSTS)[1:] for sampled in (False, True)]
    return (
        {
            "errors " + " ".join(map(str, case)): partial(model_row, *case)
            for case in [*cases, ("penalty", "driven", False)]
        }
        | {
            f"weights {cost}": partial(weights_row, cost)
            for cost in list(COSTS)[1:]
            if cost != "huber"
        }
        | {"bounds": bounds_row}
        | {f"profile {known}": partial(profile_row, known) for known in (False, True)}
        | {
            f"profile {cost}": partial(profile_row, False, cost)
            for cost in ("plain", "absolute", "change")
        }
        | {
            "chain": chain_row,
            "reference at bounds": bounded_row,
            "pair": pair_row,
            "certainty": certainty_row,
            "intervals": lambda: (
                interval.one_sided(slopes, wide),
                interval.chi_square_tail(slopes, wide),
                interval.binomial_tail(3, 20, 0.1),
                interval.student_two_sided(4.0),
                interval.largest_of(np.array([0.0, 2.0, 4.0]), 20),
                interval.largest_normal(20, 0.01),
                linear.positive_inverse(np.diag([2.0, 4.0])),
                linear.inverse_and_volume(np.array([[2.0, 0.5], [0.5, 1.0]])),
                linear.swept(np.array([[2.0, 1.0, 3.0], [1.0, 4.0, 5.0]]), 0),
                certainty.common_variance(np.arange(6.0).reshape(3, 2)),
                certainty.Certainty(
                    np.array([3.0, 5.0]), *np.zeros((4, 2)), np.array([1.0, 5.0])
                ).own,
            ),
        }
    )
