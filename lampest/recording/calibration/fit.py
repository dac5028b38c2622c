"""The numbers of a circuit from readings of known resistors: weighted least squares, and how well it explains them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from lampest.panel.panel import Array
from lampest.recording.calibration.circuit import STEP, Circuit
from lampest.recording.calibration.repeats import within_rails
from lampest.recording.calibration.trial import Trial

# Of the cost, at which each round ends. Tolerances are weighed where the round before ended, which need not be exact;
# the last round is off by less than a hundredth of σ.
ROUNDS = (1e-2, 1e-6)
MOST_STEPS = 25  # good calibrations end after some 5 from the scene's numbers, 10 from those ten times too large
NONLINEAR_LSB = 0.5  # σ of a converter's own error; ATmega2560: integral non-linearity 0.5 LSB, its data sheet
UNTOLD = 1e-9  # of the largest singular value: directions that no reading tells anything of


@dataclass(frozen=True, eq=False)
class Problem:
    """Residuals of all readings of all trials. tolerance : fraction by which resistors may be off, evenly."""

    circuit: Circuit
    trials: tuple[Trial, ...]
    tolerance: float

    @cached_property
    def measured(self) -> Array:
        """(readings) V at the converter, within its rails."""
        return np.concatenate([self._clipped(trial.readings.volt[trial.used]) for trial in self.trials])

    @cached_property
    def sigma(self) -> Array:
        """(readings) V, of noise and quantisation."""
        return np.concatenate([trial.readings.sigma_volt[trial.used] for trial in self.trials])

    def _clipped(self, volt: Array) -> Array:
        """Beyond what noise leaves of the converter's range a reading is a bound: any more is as good."""
        readout = self.circuit.readout
        margin = (2 + 3 * float(np.max(readout.assumed_noise))) * readout.lsb_volt
        return np.clip(volt, margin, readout.supply_volt - margin)

    def expected(self, unknowns: Array, resistor: tuple[float, int] | None = None, reference: float = 0.0) -> Array:
        """(readings) V, with one resistor larger by a factor exp(STEP), or the reference by 1 + reference."""
        found = []
        for trial in self.trials:
            cells = trial.cells
            if resistor in trial.resistors:
                cells = cells.copy()
                cells[trial.resistors[resistor]] *= np.exp(STEP)
            found.append(self._clipped(self.circuit.volt(unknowns, cells, reference)[trial.used]))
        return np.concatenate(found)

    def tolerances(self, unknowns: Array) -> Array:
        """(readings, sources) V: what each resistor, and the reference, does where it is off by its σ."""
        sigma, at = self.tolerance / np.sqrt(3), self.expected(unknowns)
        names = dict.fromkeys(name for trial in self.trials for name in trial.resistors)
        columns = [(self.expected(unknowns, name) - at) / STEP for name in names]
        columns.append((self.expected(unknowns, reference=STEP) - at) / STEP)
        return np.asarray(sigma * np.stack(columns, axis=1))

    def covariance(self, unknowns: Array, own_lsb: float = 0.0) -> Array:
        """(readings, readings) V² of what the circuit's numbers do not explain."""
        off = self.tolerances(unknowns)
        own = own_lsb * self.circuit.readout.lsb_volt
        return np.asarray(np.diag(self.sigma**2 + own**2) + off @ off.T)

    def within(self, unknowns: Array) -> NDArray[np.bool_]:
        """(readings) that are values: neither they nor what is expected of them lies at a rail."""
        readout = self.circuit.readout
        inside = [within_rails(readout, volt) for volt in (self.measured, self.expected(unknowns))]
        return np.asarray(inside[0] | inside[1])


@dataclass(frozen=True, eq=False)
class CircuitFit:
    """The unknowns and their covariance, as `Circuit` has them.

    chi_square, freedom : what is left, in units of its variance, converter's own error included; 1 each on average.
    rest : (readings) V left over; sigma : what of that is no surprise. readings : how many are values.
    """

    problem: Problem
    unknowns: Array
    covariance: Array
    chi_square: float
    freedom: int
    rest: Array
    sigma: Array
    readings: int


def fit(problem: Problem) -> CircuitFit:
    """argmin (y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² with C of noise and tolerances; covariance (JᵀJ)⁻¹ at the minimum."""
    circuit = problem.circuit
    unknowns, commons = circuit.start, len(circuit.numbers)
    for precision in ROUNDS:
        root = np.linalg.cholesky(problem.covariance(unknowns))

        def whitened(at: Array, root: Array = root) -> Array:
            rest = solve_triangular(root, problem.measured - problem.expected(at), lower=True)
            return np.concatenate([rest, at[commons:]])

        found = least_squares(whitened, unknowns, bounds=(circuit.least, np.inf), ftol=precision, max_nfev=MOST_STEPS)
        unknowns = found.x
    rest, whole = problem.measured - problem.expected(unknowns), problem.covariance(unknowns, NONLINEAR_LSB)
    left = solve_triangular(np.linalg.cholesky(whole), rest, lower=True)
    values = int(problem.within(unknowns).sum())
    chi_square = float(left @ left + unknowns[commons:] @ unknowns[commons:])
    return CircuitFit(
        problem, unknowns, _inverse(found.jac), chi_square, values - commons, rest, np.sqrt(np.diag(whole)), values
    )


def _inverse(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹, without end along what J does not see."""
    _, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    inverse = right / np.maximum(singular, UNTOLD * singular[0])[:, None]
    return np.asarray(inverse.T @ inverse)
