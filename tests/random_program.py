"""Random own programs, and an independent judge of their optima.

The judge computes readings by `tests/least_cost.py`, and minimises with SciPy's SLSQP. It shares no
formula with lampest.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi
import numpy as np
from scipy.optimize import Bounds, minimize

import lampest
from lampest.panel.readouts.tolerances import simulated
from tests.least_cost import TWO_POINT, edges

Array = lampest.Array
LIMITLESS = 1e20
Function = Callable[[Array], tuple[Array, Array]]  # x → values (rows,), Jacobian (rows, unknowns)


@dataclass
class RandomProgram:
    """An own program, and the same one in terms of x = (ln r, own unknowns) for the judge.

    Attributes
    ----------
    program : OwnProgram
    costs : list of Function
        Residuals of which the squares are summed.
    linear : array, shape (unknowns,)
        Further cost, linear in x.
    constraints : list of (Function, lower, upper)
    own : dict of str to range
        Places of the own unknowns in x.
    limits : list of (float, float)
        Bounds of x.
    solvable : bool or None
        Whether there is an optimum by construction; None: the judge says.
    """

    program: lampest.OwnProgram
    cells: int
    costs: list[Function] = field(default_factory=list)
    linear: dict[int, float] = field(default_factory=dict)
    constraints: list[tuple[Function, float, float]] = field(default_factory=list)
    own: dict[str, range] = field(default_factory=dict)
    limits: list[tuple[float, float]] = field(default_factory=list)
    solvable: bool | None = True
    unused: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)

    @property
    def size(self) -> int:
        """Number of unknowns of the judge."""
        return len(self.limits)

    def cost(self, x: Array) -> tuple[float, Array]:
        """φ and its gradient."""
        total, slope = 0.0, np.zeros(len(x))
        for residuals in self.costs:
            values, jacobian = residuals(x)
            total += values @ values
            slope += 2 * jacobian.T @ values
        for place, factor in self.linear.items():
            total += factor * x[place]
            slope[place] += factor
        return total, slope

    def violation(self, x: Array) -> float:
        """Largest violation of a constraint."""
        worst = 0.0
        for function, low, high in self.constraints:
            values, _ = function(x)
            worst = max(worst, float(np.maximum(low - values, values - high).max()))
        return worst

    def minimised(self, start: Array) -> tuple[Array, float]:
        """Point and cost that SLSQP reaches; infinite where it is not feasible."""
        scale = max(abs(self.cost(start)[0]), 1.0)
        rows: list[dict[str, Any]] = []
        for function, low, high in self.constraints:
            if low == high:
                rows.append(_row("eq", function, low, 1.0))
            else:
                rows += [_row("ineq", function, low, 1.0)] if low > -np.inf else []
                rows += [_row("ineq", function, high, -1.0)] if high < np.inf else []
        low, high = np.transpose(self.limits)
        with np.errstate(all="ignore"):
            ended = minimize(
                lambda x: (self.cost(x)[0] / scale, self.cost(x)[1] / scale),
                np.clip(start, low, high),
                jac=True,
                bounds=Bounds(low, high),
                constraints=rows,
                method="SLSQP",
                options={"maxiter": 200, "ftol": 1e-14},
            )
        x = np.clip(ended.x, low, high)
        if not np.all(np.isfinite(x)) or self.violation(x) > 1e-7:
            return x, np.inf
        return x, self.cost(x)[0]

    def point_of(self, solved: lampest.OwnSolution) -> Array:
        """The judge's x at a solution."""
        own = [solved[name] for name in self.own]
        return np.concatenate([np.log(solved.cell_resistance).ravel(), *own])


def _row(kind: str, function: Function, limit: float, sign: float) -> dict[str, Any]:
    return {
        "type": kind,
        "fun": lambda x: sign * (function(x)[0] - limit),
        "jac": lambda x: sign * function(x)[1],
    }


def drawn(seed: int, largest: int = 4) -> RandomProgram:
    """A random own program of a panel of up to `largest` × `largest` cells."""
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, largest + 1)), int(rng.integers(1, largest + 1)))
    recording = _recording(rng, shape)
    weight = float(10 ** rng.uniform(-2, 1)) if rng.random() < 0.7 else None
    noisy = rng.random() < 0.8
    terms: list[lampest.Term] = [lampest.Misfit(weighting="noise" if noisy else "plain")]
    if weight is not None:
        terms.append(lampest.LogGradient(weight=weight if noisy else 1e3 * weight))
    bounds = lampest.Bounds("none", "none") if rng.random() < 0.5 else lampest.Bounds()
    formulation = "nodal" if rng.random() < 0.8 else "per_pixel"
    program = lampest.program(recording, terms, bounds=bounds, formulation=formulation)
    data = program.evaluations[0].data
    cells = shape[0] * shape[1]
    made = RandomProgram(program, cells)
    low, high = (np.log(limit).ravel() for limit in (data.lower, data.upper))
    made.limits = list(zip(low, high, strict=True))
    sigma = data.sigma.ravel() if noisy else np.ones(cells)
    made.costs.append(_misfit(shape, data.measured.ravel(), sigma))
    if weight is not None:
        made.costs.append(_log_gradient(shape, float(terms[1].weight)))
    for _ in range(int(rng.integers(0, 4))):
        draw = PARTS[int(rng.integers(len(PARTS)))]
        made = draw(made, rng, recording)
        made.words.append(draw.__name__)
    return made


def _recording(rng: Any, shape: tuple[int, int]) -> lampest.Recording:
    readout = lampest.TwoPointReadout(noise_lsb=0.7, readings=20)
    scene = lampest.Scene(lampest.Panel(*shape), readout)
    spread = rng.choice([0.0, 0.3, 1.0])
    cells = 2000 * np.exp(spread * rng.standard_normal((2, *shape)))
    exact = simulated(scene.circuit, cells, scene, np.zeros(shape[0]), np.zeros(shape[1]))
    readings = exact + scene.circuit.sigma(exact) * rng.standard_normal(exact.shape)
    return lampest.Recording.from_array(readings, unit="ohm", baseline=1, scene=scene)


def _misfit(shape: tuple[int, int], measured: Array, sigma: Array) -> Function:
    """(R_eff − R_m)/σ."""
    cells = shape[0] * shape[1]

    def residuals(x: Array) -> tuple[Array, Array]:
        reading, response = TWO_POINT.reading(np.exp(x[:cells]).reshape(shape))
        jacobian = np.zeros((cells, len(x)))
        jacobian[:, :cells] = response / sigma[:, None]
        return (reading.ravel() - measured) / sigma, jacobian

    return residuals


def _log_gradient(shape: tuple[int, int], weight: float) -> Function:
    matrix = np.sqrt(weight) * edges(*shape)

    def residuals(x: Array) -> tuple[Array, Array]:
        wide = np.zeros((len(matrix), len(x)))
        wide[:, : matrix.shape[1]] = matrix
        return wide @ x, wide

    return residuals


def _of_cells(places: Array, function: Callable[[Array], tuple[Array, Array]]) -> Function:
    """Function of r in kilo-ohm at some places, as one of x."""

    def values(x: Array) -> tuple[Array, Array]:
        resistance = np.exp(x[places]) / 1000
        result, slopes = function(resistance)
        jacobian = np.zeros((len(result), len(x)))
        jacobian[:, places] = slopes * resistance
        return result, jacobian

    return values


def _chosen(made: RandomProgram, rng: Any, most: int) -> Array:
    count = int(rng.integers(1, min(most, made.cells) + 1))
    return rng.choice(made.cells, count, replace=False)


def _name(made: RandomProgram) -> str:
    return f"part_{len(made.words)}"


def _symbols(made: RandomProgram) -> casadi.SX:
    """r in kilo-ohm, row by row."""
    return casadi.vec(made.program.cells().T) / 1000


def _constrained(
    made: RandomProgram, expression: Any, function: Function, low: float, high: float
) -> RandomProgram:
    upper = None if low == high else high
    made.program = made.program.subject_to(_name(made), expression, low, upper)
    made.constraints.append((function, low, high))
    return made


def fixed_cells(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    places = np.arange(made.cells) if rng.random() < 0.3 else _chosen(made, rng, 3)
    value = float(rng.uniform(1.0, 4.0))
    made.solvable = None if made.solvable else made.solvable
    chosen = _symbols(made)[places.tolist()]
    return _constrained(
        made, chosen, _of_cells(places, lambda r: (r, np.eye(len(r)))), value, value
    )


def equal_cells(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    places = _chosen(made, rng, 4)
    if len(places) < 2:
        return made
    matrix = np.hstack([-np.ones((len(places) - 1, 1)), np.eye(len(places) - 1)])
    made.solvable = None if made.solvable else made.solvable
    return _constrained(
        made,
        casadi.DM(matrix) @ _symbols(made)[places.tolist()],
        _of_cells(places, lambda r: (matrix @ r, matrix)),
        0.0,
        0.0,
    )


def limited_sum(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """Sum of the conductances in mS between two limits; some cannot be fulfilled."""
    places = np.arange(made.cells)
    usual = made.cells / 2.0
    low, high = (-np.inf, usual * rng.uniform(0.7, 1.3))
    if rng.random() < 0.4:
        low, high = usual * rng.uniform(0.8, 1.0), usual * rng.uniform(1.0, 1.2)
    made.solvable = None if made.solvable else made.solvable
    return _constrained(
        made,
        casadi.sum1(1 / _symbols(made)),
        _of_cells(places, lambda r: (np.array([np.sum(1 / r)]), -(r**-2)[None])),
        low,
        high,
    )


def impossible(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """No cell is negative."""
    places = _chosen(made, rng, 2)
    made.solvable = False
    chosen = _symbols(made)[places.tolist()]
    function = _of_cells(places, lambda r: (r, np.eye(len(r))))
    return _constrained(made, chosen, function, -3.0, -2.0)


def _with_unknown(made: RandomProgram, name: str, low: float, high: float, **about: Any) -> Any:
    size = about.get("size", 1)
    made.program, symbol = made.program.with_unknown(name, lower=low, upper=high, **about)
    made.own[name] = range(made.size, made.size + size)
    made.limits += [(low, high)] * size
    return symbol


def _prior(places: range, mean: float, sd: float) -> Function:
    def residuals(x: Array) -> tuple[Array, Array]:
        jacobian = np.zeros((len(places), len(x)))
        jacobian[np.arange(len(places)), list(places)] = 1 / sd
        return (x[list(places)] - mean) / sd, jacobian

    return residuals


def series(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """An offset of all readings, with a prior."""
    if len(made.costs[0](np.zeros(made.size) + 7)[0]) != made.cells or "series" in made.own:
        return made
    mean, sd = float(rng.uniform(-5, 5)), float(10 ** rng.uniform(-1, 1))
    symbol = _with_unknown(made, "series", -np.inf, np.inf, mean=mean, sd=sd)
    place = made.own["series"][0]
    made.program = made.program.with_reading(lambda y: y + symbol)
    made.costs.append(_prior(made.own["series"], mean, sd))
    misfit = made.costs[0]
    at_zero = misfit(np.full(made.size, 7.0))[0]
    data = made.program.evaluations[0].data
    noisy = made.program.symbols.cost.terms[0].weighting == "noise"
    sigma = data.sigma.ravel() if noisy else np.ones(len(at_zero))

    def shifted(x: Array) -> tuple[Array, Array]:
        values, jacobian = misfit(x)
        jacobian = jacobian.copy()
        jacobian[:, place] += 1 / sigma
        return values + x[place] / sigma, jacobian

    made.costs[0] = shifted
    return made


def tied_unknown(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """An unknown that is the sum of some cells in kilo-ohm, with a prior."""
    places = _chosen(made, rng, 3)
    name = f"sum_{len(made.own)}"
    mean, sd = float(rng.uniform(2, 8)), float(rng.uniform(0.5, 2.0))
    symbol = _with_unknown(made, name, -np.inf, np.inf, mean=mean, sd=sd)
    made.costs.append(_prior(made.own[name], mean, sd))
    place = made.own[name][0]
    total = _of_cells(places, lambda r: (np.array([r.sum()]), np.ones((1, len(r)))))

    def difference(x: Array) -> tuple[Array, Array]:
        values, jacobian = total(x)
        jacobian[0, place] -= 1
        return values - x[place], jacobian

    expression = casadi.sum1(_symbols(made)[places.tolist()]) - symbol
    return _constrained(made, expression, difference, 0.0, 0.0)


def unused_unknown(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    name = f"unused_{len(made.own)}"
    low, high = (-np.inf, np.inf) if rng.random() < 0.5 else (-1.0, 2.0)
    _with_unknown(made, name, low, high, size=int(rng.integers(1, 3)))
    made.unused.append(name)
    return made


def unused_with_prior(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    name = f"prior_{len(made.own)}"
    mean, sd = float(rng.normal()), float(10 ** rng.uniform(-2, 2))
    low = -np.inf if rng.random() < 0.5 else mean + sd * float(rng.uniform(0.1, 1.0))
    _with_unknown(made, name, low, np.inf, mean=mean, sd=sd)
    made.costs.append(_prior(made.own[name], mean, sd))
    return made


def unbounded(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """A cost that falls without limit, or until a bound."""
    name = f"falls_{len(made.own)}"
    low = -np.inf if rng.random() < 0.6 else float(rng.uniform(-2, 0))
    symbol = _with_unknown(made, name, low, np.inf)
    factor = float(10 ** rng.uniform(-1, 2))
    made.program = made.program.with_cost(factor * symbol)
    made.linear[made.own[name][0]] = factor
    if low == -np.inf:
        made.solvable = False
    return made


def quadratic_cost(made: RandomProgram, rng: Any, recording: Any) -> RandomProgram:
    """(r − a)² in kilo-ohm over some cells."""
    places = _chosen(made, rng, 3)
    target, weight = float(rng.uniform(1, 4)), float(10 ** rng.uniform(0, 2))
    chosen = _symbols(made)[places.tolist()]
    made.program = made.program.with_cost(casadi.sumsqr(weight * (chosen - target)))
    made.costs.append(_of_cells(places, lambda r: (weight * (r - target), weight * np.eye(len(r)))))
    return made


PARTS = (
    fixed_cells,
    equal_cells,
    limited_sum,
    impossible,
    series,
    tied_unknown,
    unused_unknown,
    unused_with_prior,
    unbounded,
    quadratic_cost,
)
