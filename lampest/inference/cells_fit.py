"""Least-squares fit of the cells to one frame under a given circuit.

A frame has as many cells as readings, so a misfit remains only where cells would have to be
negative. Over the cone g ≥ 0 the misfit is χ² with one degree of freedom for each cell at the
boundary of the cone, and smaller where the truth lies inside (chi-bar-squared; Shapiro, Biometrika
72, 1985).
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.files.errors import BROKEN
from lampest.files.levels import SIGNIFICANCE
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.posterior.interval import chi_square_tail
from lampest.posterior.linear import UNKNOWN_SD, inverse_and_volume
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings
from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.posed import Bounds, cost_of_solve, data_of_solve
from lampest.solvers.solution import Settings

if TYPE_CHECKING:
    from lampest.panel.effects import SharedEffect
    from lampest.panel.effects.line_effect import LineEffect

EXACT_CHI_SQUARE = 1e-2  # χ² so small that it changes no verdict
# χ² of a circuit that only competes: the minimum is lower, but a fifth of the evidence that makes a
# doubt decides nothing.
SMALL_CHI_SQUARE = 3.0
FIT = LevenbergMarquardt(
    evaluations=16, settled=EXACT_CHI_SQUARE / 2, share=0.1, damping=0.0, longest=1.5
)
# Fits with cells at the boundary r = 0 or r = ∞ take 2 to 30 further iterations.
LONG_FIT = replace(FIT, evaluations=40, share=0.0)
# Fits of alternatives on panels of more than MAX_CELLS take some 20 iterations of the solver of the
# estimates, where circuits that cannot explain the readings take hundreds.
BRIEF = Settings(max_iterations=25)
# Factor on the lower bound that estimates have: a short behind a drive resistor of a kilo-ohm is
# smaller than that.
MIN_CELL_FACTOR = 1e-3
# χ² for each reading that noise never reaches: on panels of more than MAX_CELLS a circuit is given
# up above it. Without it checks take four times as long.
MAX_CHI_SQUARE = 10.0
# Factor by which further iterations lower χ² of a fit at most, where they reach noise.
MAX_LOWERED = 4.0
CELL_PRECISION = UNKNOWN_SD**-2  # prior precision of log r of a cell that no reading determines
# Median standard deviation of the log cells beyond which linear theory does not hold: 8 bits and
# one reading on 12 x 8 cells leave 1.4, and distinguishable circuits at most 0.2
# (docs/studies/model_check.py).
MAX_CELL_SD = 0.5


LEAST_SQUARES = (Misfit(weighting="noise"),)
POSITIVE = Bounds("none", "none")


def data_of_cells(scene: Scene, readings: Readings) -> Data:
    """Return the data of plain least squares over r > 0 for a frame's readings (rows, columns)."""
    return data_of_solve(LEAST_SQUARES, POSITIVE, readings.alone(), Background(scene))


def _data_of_fit(scene: Scene, readings: Readings) -> Data:
    """Return the data of cells with wider lower bounds; known cells stay as they are."""
    data = data_of_cells(scene, readings)
    lower = np.where(data.lower < data.upper, MIN_CELL_FACTOR * data.lower, data.lower)
    return replace(data, lower=lower)


@dataclass(frozen=True, eq=False, kw_only=True)
class CellsFit(SumOfSquares):
    """Fit of the cells to one frame, as a sum of squares over log r.

    Panels of more than MAX_CELLS have a fit without a Jacobian.

    Attributes
    ----------
    scene : Scene
    measured : Readings
        (rows, columns).
    readings : Readings
        The measured readings less the contribution of effects.
    network : Network
        Network of the cells, without effects.
    effects : tuple of Effect
    ridge : float
        Prior precision of each log r.
    """

    scene: Scene
    measured: Readings
    readings: Readings
    network: Network
    effects: "tuple[LineEffect, ...]" = ()
    ridge: float = CELL_PRECISION

    @classmethod
    def at(
        cls,
        scene: Scene,
        data: Data,
        measured: Readings,
        cells: Array,
        effects: "Sequence[LineEffect]" = (),
    ) -> "CellsFit":
        """Return the fit of given cells, (rows, columns) ohm, to readings of a frame."""
        unaffected = data.network(0, cells)
        network, added = affected(scene, unaffected, effects)
        readings = replace(measured, value=measured.value - added)
        sigma = measured.known_sigma
        # (f(r) − y)/σ; 0 where nothing was read, or a bound is satisfied
        missed = (network.reading() - readings.value) / sigma
        counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
        jacobian: Array = np.zeros((missed.size, 0))
        if missed.size <= MAX_CELLS:
            weight = np.where(counted, 1 / sigma, 0.0)
            of_effects = sum(each.added_sensitivity(scene, unaffected) for each in effects)
            derivative = network.sensitivity() + of_effects
            jacobian = derivative * weight.reshape(-1, 1) * (data.lower < data.upper).ravel()
        residual = np.where(counted, missed, 0.0).ravel()
        return cls(
            residual=residual,
            jacobian=jacobian,
            scene=scene,
            measured=measured,
            readings=readings,
            network=unaffected,
            effects=tuple(effects),
        )

    def with_effects(self, network: Network) -> tuple[Network, Array | float]:
        """Return a network with the effects in it, and what they add to its readings."""
        return affected(self.scene, network, self.effects)

    def refitted(self, measured: Readings, effects: "tuple[LineEffect, ...]") -> "CellsFit | None":
        """Return the fit to other readings or effects, from these cells on.

        The result is None where no fit is found.
        """
        return fitted(self.scene, measured, self.cells, patient=True, effects=effects)

    @property
    def cells(self) -> Array:
        """Cell resistances, (rows, columns) ohm."""
        return self.network.cell_resistance

    @property
    def chi_square(self) -> float:
        """χ² = Σ ((f(r) − y)/σ)²."""
        return 2 * self.cost

    @cached_property
    def degrees(self) -> float:
        """Degrees of freedom of χ²: the readings less those that the cells follow; at least 1."""
        # Σ s²/(1 + s²) over the singular values s of J/σ
        followed = np.linalg.eigvalsh(self.normal) - self.ridge
        return max(
            float(np.sum(self.readings.seen)) - float(np.sum(followed / (1 + followed))), 1.0
        )

    @property
    def tail(self) -> float:
        """P(χ²_degrees ≥ chi_square), the tail probability of the misfit under noise alone."""
        return float(chi_square_tail(self.chi_square, self.degrees))

    @property
    def within_noise(self) -> bool:
        """Whether noise alone may give the misfit, `tail` ≥ SIGNIFICANCE."""
        # χ² of at least one degree of freedom exceeds 1 in a third of all cases.
        return self.chi_square <= 1 or self._may_be_noise(self.chi_square)

    def hopeless(self, variance_factor: float = 1.0) -> bool:
        """Return whether no minimum that further iterations reach from these cells is within noise.

        Variances of the readings may be larger by a factor at most: χ² of any cells is lower by
        this factor at most.
        """
        chi_square = self.chi_square / variance_factor
        if not self.jacobian.size:
            return chi_square > MAX_CHI_SQUARE * self.residual.size
        return not self._may_be_noise(chi_square / MAX_LOWERED)

    def _may_be_noise(self, chi_square: float) -> bool:
        """Return whether P(χ²_degrees ≥ chi_square) ≥ SIGNIFICANCE.

        The tail grows with the degrees of freedom. These cost all eigenvalues, and are computed
        where the fewest do not decide.
        """
        if chi_square_tail(chi_square, 1.0) >= SIGNIFICANCE:
            return True
        return bool(chi_square_tail(chi_square, self.degrees) >= SIGNIFICANCE)

    @cached_property
    def _inverse_and_volume(self) -> tuple[Array, float]:
        """Inverse of the normal matrix, and the logarithm of the inverse's determinant."""
        try:
            return inverse_and_volume(self.normal)
        except np.linalg.LinAlgError:  # positive definite, but not in double precision
            return np.linalg.inv(self.normal), -float(np.linalg.slogdet(self.normal)[1])

    @property
    def covariance(self) -> Array:
        """Covariance of the log cells, (cells, cells)."""
        return self._inverse_and_volume[0]

    @property
    def log_volume(self) -> float:
        """ln of the determinant of the covariance."""
        return self._inverse_and_volume[1]

    @cached_property
    def gain(self) -> Array:
        """K (cells, readings): derivative of the fitted log cells with respect to the readings."""
        # K = (J̃ᵀ J̃ + ridge)⁻¹ J̃ᵀ/σ, with J̃ = ∂y/∂log r / σ
        return self.covariance @ (self.jacobian.T / self.readings.known_sigma.ravel())

    def response(self, errors: Array) -> Array:
        """Return K U, the change of the log cells (cells, n) by errors U of the readings.

        The errors U are (n, rows, columns).
        """
        return self.gain @ errors.reshape(len(errors), self.cells.size).T

    def response_to(self, errors: "Iterable[SharedEffect]", sizes: Systematic) -> Array:
        """Return K U of errors that frames share, of one standard deviation each, (cells, n)."""
        from lampest.panel.effects import error_columns  # for scenes that name any

        columns = error_columns(errors, self.network, self.readings.value, self.scene, sizes)
        return self.response(columns)

    @cached_property
    def offset(self) -> Array:
        """Change of readings by all effects together, (rows, columns), in the readout's unit."""
        from lampest.panel.effects.line_effect import effect_on_readings

        return effect_on_readings(self.effects, self.scene, self.network)

    def more(self, effect: "LineEffect") -> Array:
        """Return the further change of the readings by an additional effect, (rows, columns)."""
        from lampest.panel.effects.line_effect import effect_on_readings

        return effect_on_readings((*self.effects, effect), self.scene, self.network) - self.offset

    @property
    def amplification(self) -> Array:
        """Factor of the readings' noise once the effects are taken off, (rows, columns).

        The factor is the standard deviation of the readings that the cells would give without
        effects, in units of σ.
        """
        dry = self.network.sensitivity() / self.readings.known_sigma.reshape(-1, 1)
        # diag(J₀ P J₀ᵀ), with J₀ the Jacobian over σ without effects and P the covariance of the
        # log cells
        variance = np.sum((dry @ self.covariance) * dry, axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 1.0))).reshape(self.cells.shape)


def affected(
    scene: Scene, network: Network, effects: "Sequence[LineEffect]"
) -> tuple[Network, Array | float]:
    """Return the network with effects in it, and what they add to its readings."""
    if not effects:
        return network, 0.0
    from lampest.panel.effects.line_effect import with_effects

    return with_effects(effects, scene, network)


def well_determined(fits: Sequence[CellsFit]) -> bool:
    """Return whether linear theory holds: the median standard deviation of log cells is small."""
    deviations = [np.sqrt(np.diag(fit.covariance)) for fit in fits]
    return not np.median(deviations) > MAX_CELL_SD


def fitted(
    scene: Scene,
    readings: Readings,
    near: Array | None = None,
    *,
    patient: bool = False,
    effects: "Sequence[LineEffect]" = (),
) -> CellsFit | None:
    """Return argmin Σ ((f(r) − y)/σ)² of one frame over r > 0.

    The result is None where the solver or arithmetic fails.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        y and σ, (rows, columns).
    near : array, shape (rows, columns), optional
        Cells in ohm to begin at; by default the readout's start.
    patient : bool
        Whether every start is tried, and any misfit accepted. Otherwise a fit beyond noise is given
        up.
    effects : sequence of Effect
        Effects in the network in addition to its circuit. With effects the fit that the first loop
        reaches is returned.
    """
    with suppress(*BROKEN), np.errstate(all="ignore"):
        data = _data_of_fit(scene, readings)
        start = data.start()[0] if near is None else near
        fit = _levenberg_marquardt_fit(scene, data, readings, start, effects)
        if fit.chi_square <= EXACT_CHI_SQUARE or effects:
            return fit
        if not patient and fit.chi_square <= SMALL_CHI_SQUARE:
            return fit
        if not patient and fit.hopeless():
            return None
        # Elsewhere cells stand at the boundary r = 0 or r = ∞, which takes more iterations.
        if fit.jacobian.size:
            fit = _levenberg_marquardt_fit(scene, data, readings, fit.cells, loop=LONG_FIT)
            if fit.within_noise:
                return fit
            if not patient:
                return None
        # A minimum that noise does not give may not be the lowest: other starts are tried.
        from lampest.solvers.projected_newton import ProjectedNewton

        cost = cost_of_solve(LEAST_SQUARES, scene, partial=data.partial)
        if patient:
            solver = ProjectedNewton(cost, Settings())
            solution = best_solution(solver, data, None if near is None else near[None])
        else:
            solver = ProjectedNewton(cost, BRIEF)
            solution = solved_from(solver, evaluated(cost, data, fit.cells[None]))
        if solution.solved:
            other = CellsFit.at(scene, data, readings, solution.cell_resistance[0])
            return min(fit, other, key=lambda each: each.cost)
        # From the cells of a neighbour, a minimum that noise does not give counts as well.
        return fit if patient and near is not None else None
    return None


def local_fit(scene: Scene, readings: Readings) -> CellsFit:
    """Return the fit to a frame that the readout's start leads to, whatever its misfit.

    Panels of more than MAX_CELLS have the start itself, without a Jacobian.

    Raises one of BROKEN where arithmetic fails.
    """
    data = _data_of_fit(scene, readings)
    return _levenberg_marquardt_fit(scene, data, readings, data.start()[0])


def _levenberg_marquardt_fit(
    scene: Scene,
    data: Data,
    readings: Readings,
    start: Array,
    effects: "Sequence[LineEffect]" = (),
    loop: LevenbergMarquardt = FIT,
) -> CellsFit:
    """Return the fit that the Levenberg-Marquardt method reaches from a start.

    On panels of more than MAX_CELLS it is not iterated, and the fit is that of the start.

    Parameters
    ----------
    scene : Scene
    data : Data
        Its bounds hold for the cells.
    readings : Readings
        (rows, columns).
    start : array, shape (rows, columns)
        Cells in ohm.
    effects : sequence of Effect
    loop : LevenbergMarquardt
    """

    def model(position: Array) -> CellsFit:
        cells = np.exp(position).reshape(start.shape)
        return CellsFit.at(scene, data, readings, cells, effects)

    def is_exact(fit: CellsFit, evaluations: int) -> bool:
        return fit.chi_square <= EXACT_CHI_SQUARE

    if start.size > MAX_CELLS:
        loop = replace(loop, evaluations=1)
    bounds = (data.log_bounds[0].ravel(), data.log_bounds[1].ravel())
    return loop.minimum(model, np.log(start).ravel(), bounds, is_exact)[1]
