"""Solver that gives the nonlinear program with node voltages to IPOPT.

It begins at the same starts as every other solver, and takes no other answer: initial voltages are those of the start's
cells, multipliers those with which IPOPT ended the frame before.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.formulation.circuit import Circuit
from lampest.formulation.ipopt import Interface, Limits, Multipliers, ProgramResult
from lampest.formulation.patterns import Excitation
from lampest.formulation.program import Program, unit_of
from lampest.panel.compiled import guarded
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Wiring
from lampest.solvers.solution import Outcome, Settings, Solver, Status

STATUS = {
    "Solve_Succeeded": Status.OPTIMUM,
    "Solved_To_Acceptable_Level": Status.OPTIMUM,
    "Search_Direction_Becomes_Too_Small": Status.OPTIMUM,
    "Maximum_Iterations_Exceeded": Status.ITERATIONS,
    "Maximum_WallTime_Exceeded": Status.TIME,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Invalid_Option": Status.UNAVAILABLE,
}
# The unit of the objective is the cost of a cell at readings of zero; that of an optimum is decades smaller.
ACCURACY = 1e-4
SPLIT_START = 0.01  # distance of p, q from their bound 0 at the start, in split units: IPOPT's default of bound_push
MIN_VOLTAGE = 1e-3  # smallest unit of a voltage, relative to the largest voltage of its kind
MIN_SPLIT_UNIT = 1e-12  # unit of split residuals that are all zero, in their own unit


@dataclass(frozen=True)
class Ipopt(Solver):
    """Solver of one cost, circuit and choice of patterns on one panel shape; the program is built once and cached.

    Attributes
    ----------
    cost : Cost
    settings : Settings
    readout : Readout
    wiring : Wiring or None
    patterns : Excitation
    multipliers : Multipliers or None
        Those of the frame before.
    """

    readout: Readout
    wiring: Wiring | None
    patterns: Excitation
    multipliers: Multipliers | None = None

    @property
    def name(self) -> str:
        """The solver in words."""
        return f"IPOPT, {self.patterns.kind}"

    def prepare(self) -> None:
        """Build the program before the first solve."""
        _ = self._interface

    def continued(self, carried: object) -> "Ipopt":
        """Return the solver that begins with the multipliers of the frame before."""
        return replace(self, multipliers=carried if isinstance(carried, Multipliers) else None)

    def cold(self) -> "Ipopt":
        """Return the solver that begins without multipliers, with a barrier parameter of IPOPT's own choice."""
        return replace(self, multipliers=None)

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. A failed solve does not raise; the outcome's status states the failure."""
        if data.overdue:
            return Outcome(start.cell_resistance, np.zeros_like(self.cost.slope), Status.TIME, 0)
        program = self._interface.program
        split, split_scale = self._split(data, start)
        # Unit of resistances: the geometric mean of equal cells with these readings.
        scale = float(np.exp(np.mean(np.log(data.uniform_start))))
        # Unit of the cost: the mean cost of a cell at readings of zero, which does not depend on the start.
        cost_scale = float(start.cell_costs) or start.cost_scale
        units = {"scale": scale, "cost_scale": cost_scale, "split_scale": split_scale}
        voltages = self._voltages(data, start, scale)
        size = {
            name: np.maximum(np.abs(values), MIN_VOLTAGE * np.abs(values).max()) for name, values in voltages.items()
        }
        of_voltages = {unit_of(name): values for name, values in size.items()}
        parameter = program.parameter.stacked(
            {**data.flat, **of_voltages, "tie": data.ties * scale, "weights": self.cost.weights, **units}
        )
        # Smaller cells than `Readout.nearly_shorted` do not change any reading.
        least = np.minimum(np.maximum(data.lower, data.readout.nearly_shorted(data.measured)), data.upper)
        low, high = scale / data.upper, scale / least
        lower = program.unknown.stacked({"conductance": low, "split": 0.0}, default=-np.inf)
        upper = program.unknown.stacked({"conductance": high}, default=np.inf)
        conductance = scale / start.cell_resistance
        scaled = {name: values / size[name] for name, values in voltages.items()}
        begin = program.unknown.stacked({"conductance": conductance, **scaled, "split": split})
        result, iterations = self._minimise(begin, parameter, (lower, upper), scale, cost_scale)
        ended = program.unknown.named(result.unknown)["conductance"].reshape(data.measured.shape)
        pull = program.unknown.named(result.of_bounds)["conductance"].reshape(data.measured.shape)
        with np.errstate(divide="ignore"):
            cells = scale / on_bounds(ended, pull, low, high)
        weights = np.maximum(self.cost.slope * split_scale / cost_scale, np.finfo(float).tiny)
        dual = program.equation.named(result.of_equations)["split"] / weights
        status = STATUS.get(result.status, Status.BREAKDOWN)
        carried = Multipliers(result.of_bounds, result.of_equations, scale, cost_scale)
        ended_well = status is Status.OPTIMUM
        return Outcome(cells, dual, status, iterations, carried=carried if ended_well else None, convex=result.convex)

    def _minimise(
        self, begin: Array, parameter: Array, bounds: tuple[Array, Array], scale: float, cost_scale: float
    ) -> tuple[ProgramResult, int]:
        """Return IPOPT's result, and its iterations: warm where there are multipliers, and cold if that fails."""
        interface = self._interface
        iterations = 0
        if self.multipliers is not None and len(self.multipliers.of_bounds) == len(begin):
            warm = self.multipliers.in_units(interface.program, scale, cost_scale)
            result = interface.minimise(begin, parameter, bounds, warm)
            if STATUS.get(result.status) is Status.OPTIMUM:
                return result, result.iterations
            iterations = result.iterations
        result = interface.minimise(begin, parameter, bounds)
        return result, iterations + result.iterations

    def _voltages(self, data: Data, start: Evaluation, scale: float) -> dict[str, Array]:
        """Return the voltages of the start's cells by name, all frames one after the other, in `scale`."""
        frames = zip(start.cell_resistance, data.ties, strict=True)
        values = [
            self.patterns.voltages(self._circuit, self.readout, self._circuit.voltages(cells, tie))
            for cells, tie in frames
        ]
        return {name: np.concatenate([frame[name] for frame in values]) / scale for name in values[0]}

    def _split(self, data: Data, start: Evaluation) -> tuple[Array, float]:
        """Return p and q of the split residuals at the start, in their unit, and the unit.

        The unit is the largest residual of the start and of the apparent resistances, because a start at the baseline
        may leave none.
        """
        functions = self.cost.functions
        residual, apparent = (at.call(functions.split) for at in (start, start.elsewhere(data.apparent_resistance)))
        unit = max(float(np.abs([residual, apparent]).max(initial=0)), MIN_SPLIT_UNIT)
        blocks = np.split(residual / unit, np.cumsum(functions.split_blocks, dtype=int)[:-1])
        parts = [np.maximum(side, 0) + SPLIT_START for block in blocks for side in (block, -block)]
        return np.concatenate([np.zeros(0), *parts]), unit

    @property
    def _circuit(self) -> Circuit:
        return _circuit(self.cost.panel.shape, self.wiring)

    @property
    def _interface(self) -> Interface:
        return _interface(self.cost.unweighted, self.readout, self.wiring, self.patterns, self.settings)


def on_bounds(conductance: Array, multiplier: Array, low: Array, high: Array) -> Array:
    """Return the conductances, put on a bound where its multiplier exceeds the distance to it; all (…, cells)."""
    lowered = np.where(-multiplier > conductance - low, low, conductance)
    return np.where(multiplier > high - conductance, high, lowered)


@lru_cache(maxsize=32)
def _circuit(shape: tuple[int, int], wiring: Wiring | None) -> Circuit:
    return Circuit.of(shape, wiring)


@guarded
@lru_cache(maxsize=32)
def _interface(
    cost: Cost, readout: Readout, wiring: Wiring | None, patterns: Excitation, settings: Settings
) -> Interface:
    program = Program.build(cost, readout, _circuit(cost.panel.shape, wiring), patterns)
    seconds = np.inf if settings.time_limit_s is None else settings.time_limit_s
    interface = Interface(program, Limits(ACCURACY * settings.tolerance, settings.max_iterations, seconds))
    interface.prepare()
    return interface
