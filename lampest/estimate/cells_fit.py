"""The least misfit of one frame under a circuit when its cells may be anything positive.

No estimator takes part: penalties and bounds leave a misfit of their own. A frame has as many cells as readings, so
that a misfit remains only where cells would have to be negative. Over the cone g ≥ 0 it is χ² with as many degrees of
freedom as cells stand at the cone, and smaller where the truth lies inside (Shapiro, Biometrika 72, 1985:
chi-bar-squared). A cell that readings hardly see counts as one of these: degrees = Σ (1 − s²/(1 + s²)) over the
singular values s of J/σ.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Bounds, Estimator
from lampest.panel.least_squares import LevenbergMarquardt
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.solvers.multistart import BROKEN, best_solution, convex, evaluated, solved_from
from lampest.solvers.solution import Settings

LEVEL = 1e-4  # P(χ²) below which cells do not explain a frame: of each of a handful of tests
EXACT = 1e-2  # χ² that changes no verdict
FIT = LevenbergMarquardt(evaluations=16, settled=EXACT / 2, share=0.1, damping=0.0, longest=1.5)
# Cells at the edge of r > 0 take some 20 iterations, a circuit that cannot explain its readings hundreds.
BRIEF = Settings(max_iterations=25)
EDGE = 1e-3  # of the least cell of estimates: a short behind a drive resistor of a kilo-ohm is smaller
HOPELESS = 10.0  # χ² for each reading that noise at the edge of r > 0 never leaves
MOST_CELLS = 400  # where matrices over the cells take tens of milliseconds; beyond, every reading counts as a degree
SPREAD = 0.01  # 1/variance of log r: a cell that no reading sees may be anything within e^±10


@cache
def cells_alone() -> Estimator:
    """Plain least squares over r > 0; made when it is asked for, because installed methods are looked for then."""
    return Estimator((Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False)


@dataclass(frozen=True, eq=False)
class CellsFit:
    """readings : of one frame (rows, columns). cells : ohm. residual : (y − y_measured)/σ, 0 where not used.

    sensitivity : J/σ (readings, cells) in log r; None on panels of more than MOST_CELLS.
    """

    readings: Readings
    cells: Array
    residual: Array
    sensitivity: Array | None

    @classmethod
    def of(cls, scene: Scene, readings: Readings, near: Array | None, patient: bool) -> "CellsFit | None":
        """argmin Σ ((f(r) − y)/σ)² over r > 0; None where it is not reached.

        near : cells (rows, columns) ohm to begin at; None: the readout's start. patient : every start is tried, else a
        few iterations must do.
        """
        alone = cells_alone()
        data = alone.data(readings.alone(), Background(scene))
        data = replace(data, lower=EDGE * data.lower)
        found = cls.near(data, readings, convex(data, None)[0] if near is None else near)
        if found.chi_square <= EXACT:
            return found
        if not patient and found.chi_square > HOPELESS * readings.value.size:
            return None
        solver = (alone if patient else replace(alone, solver=BRIEF)).problem(scene, 1, float("inf"), data.partial)
        solution = (
            best_solution(solver, data, None)
            if patient
            else solved_from(solver, evaluated(solver.cost, data, found.cells[None]))
        )
        return cls.at(data, readings, solution.at.networks[0]) if solution.solved and solution.at is not None else None

    @classmethod
    def near(cls, data: Data, readings: Readings, start: Array) -> "CellsFit":
        """The least squares that the loop reaches from cells; on panels too large for it, the start itself."""
        bounds = (data.log_bounds[0].ravel(), data.log_bounds[1].ravel())
        position = np.clip(np.log(start).ravel(), *bounds)

        def model(position: Array) -> CellsFit:
            return cls.at(data, readings, data.network(0, np.exp(position).reshape(start.shape)))

        if start.size > MOST_CELLS:
            return model(position)
        return FIT.minimum(model, position, bounds, ended=lambda fit, _: fit.chi_square <= EXACT).at

    @classmethod
    def at(cls, data: Data, readings: Readings, network: Network) -> "CellsFit":
        """What a solved network leaves of the readings."""
        residual, weight = residual_of(network, readings)
        sensitivity = None
        if readings.value.size <= MOST_CELLS:
            sensitivity = network.sensitivity() * weight.reshape(-1, 1) * (data.lower < data.upper).ravel()
        return cls(readings, network.cell_resistance, residual, sensitivity)

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return float(np.sum(self.residual**2))

    @property
    def cost(self) -> float:
        """½ Σ residual²."""
        return self.chi_square / 2

    @property
    def gradient(self) -> Array:
        """Of the cost by log r, (cells)."""
        assert self.sensitivity is not None
        return np.asarray(self.sensitivity.T @ self.residual.ravel())

    @cached_property
    def normal(self) -> Array:
        """JᵀJ/σ² (cells, cells) of log r, and the little that is known without readings."""
        assert self.sensitivity is not None
        normal: Array = self.sensitivity.T @ self.sensitivity
        normal[np.diag_indices(len(normal))] += SPREAD
        return normal

    @cached_property
    def degrees(self) -> float:
        """Readings less what the cells can follow; at least 1."""
        readings = float(np.sum(self.readings.seen))
        if self.sensitivity is None:
            return readings
        seen = np.linalg.eigvalsh(self.normal) - SPREAD
        return max(readings - float(np.sum(seen / (1 + seen))), 1.0)

    @property
    def tail(self) -> float:
        """P(χ² of so many degrees is as large)."""
        return float(chi_square_tail(self.chi_square, self.degrees))

    def worst_line(self) -> str:
        """'row 3 holds 62 % of it': the line with most of the misfit."""
        squares = self.residual**2
        rows, columns = squares.sum(axis=1), squares.sum(axis=0)
        name, lines = ("row", rows) if rows.max() >= columns.max() else ("column", columns)
        return f"{name} {int(np.argmax(lines))} holds {100 * lines.max() / squares.sum():.0f} % of it"


def residual_of(network: Network, readings: Readings) -> tuple[Array, Array]:
    """((y − y_measured)/σ, 1/σ), both (rows, columns): 0 where nothing was read, or a bound holds."""
    assert readings.sigma is not None
    missed = (network.reading() - readings.value) / readings.sigma
    counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
    return np.where(counted, missed, 0.0), np.where(counted, 1 / readings.sigma, 0.0)


def fitted(scene: Scene, readings: Readings, near: Array | None = None, patient: bool = False) -> CellsFit | None:
    """The fit of one frame; None where arithmetic breaks down too."""
    try:
        with np.errstate(all="ignore"):
            return CellsFit.of(scene, readings, near, patient)
    except BROKEN:
        return None
