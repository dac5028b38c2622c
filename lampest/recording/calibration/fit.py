"""Weighted least squares through a circuit's equations: its numbers, how well they are known, whether they can be."""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.stats import f as fisher

from lampest.files.errors import InputError
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import LineNumber, Side
from lampest.recording.calibration.circuit import MEMORY, STEP, TYPICAL_OHM, WIRE, Circuit, LineUnknowns
from lampest.recording.calibration.repeats import Trial, within_rails

SETTLED = (1.0, 1e-4)  # of ½ χ² in each round: the last one is off by a hundredth of σ
MOST_STEPS = 25  # good calibrations end after some 5 from the scene's numbers, 10 from those ten times too large
DIFFERENCE = 2.0**-26  # of an unknown, or of 1: half of the digits
NONLINEAR_LSB = 0.5  # σ of a converter's own error; ATmega2560: integral non-linearity 0.5 LSB, its data sheet
UNDETERMINED = 1e-9  # of the largest singular value: directions that no reading tells anything of
MOST_SIGMA_OF_LINES = 5.0  # by which one of 32 lines is off by chance once in 50,000 calibrations
ROUNDING_OHM = 1e-3  # as scenes are written
BY_CHANCE = 1e-7  # of good calibrations that may be refused for what is left over
# A channel of a CD74HC4067 at 5 V; typical and worst are its data sheet's.
BEST_OHM, WORST_OHM = 40.0, 160.0
MOST_OF_RESISTORS = 0.1  # by which a load may differ from the others: twice the 5 % of ordinary resistors
LIKELY = {True: "channels of a CD74HC4067 have 40 to 160 ohm", False: "resistors of 5 % differ by less"}
OPEN_SHARE = 0.1  # of the supply: a converter that remembers 3 % of the channel before, and hum, stay below
SURE = 4.0  # σ that a number must be beyond
# σ of a number that the readings tell: of a channel less than channels differ by, of a resistor a part of itself.
MOST_SIGMA_SHARE = 0.3
ENOUGH = {MEMORY.name: 0.01} | {wire.name: 0.5 for wire in WIRE} | {"diode.drop_volt": 0.2}


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
    """argmin (y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² with C of noise and tolerances; covariance (JᵀJ)⁻¹ at the minimum.

    C depends on θ: a first round ends where its tolerances are known well enough.
    """
    circuit, unknowns = problem.circuit, problem.circuit.start
    for settled in SETTLED:
        root = np.linalg.cholesky(problem.covariance(unknowns))
        found = LevenbergMarquardt(MOST_STEPS, settled).minimum(
            partial(_squares, problem, root), unknowns, (circuit.least, np.inf)
        )
        unknowns = found.position
    rest, whole = problem.measured - problem.expected(unknowns), problem.covariance(unknowns, NONLINEAR_LSB)
    left = solve_triangular(np.linalg.cholesky(whole), rest, lower=True)
    values, commons = int(problem.within(unknowns).sum()), len(circuit.numbers)
    chi_square = float(left @ left + unknowns[commons:] @ unknowns[commons:])
    covariance = _inverse(found.at.jacobian)
    return CircuitFit(
        problem, unknowns, covariance, chi_square, values - commons, rest, np.sqrt(np.diag(whole)), values
    )


def _squares(problem: Problem, root: Array, unknowns: Array) -> SumOfSquares:
    """(y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² about θ, slopes by forward differences; root : Cholesky factor of C."""

    def residual(at: Array) -> Array:
        left = solve_triangular(root, problem.measured - problem.expected(at), lower=True)
        return np.concatenate([left, at[len(problem.circuit.numbers) :]])

    here, steps = residual(unknowns), DIFFERENCE * np.maximum(1.0, np.abs(unknowns))
    slopes = [(residual(unknowns + step) - here) / step.sum() for step in np.diag(steps)]
    return SumOfSquares(here, np.stack(slopes, axis=1))


def _inverse(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹, without end along what J does not see."""
    _, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    inverse = right / np.maximum(singular, UNDETERMINED * singular[0])[:, None]
    return np.asarray(inverse.T @ inverse)


@dataclass(frozen=True, eq=False)
class LineOffsets:
    """Lines of one side: by how much each differs from their mean, and σ of that, ohm; NaN where not measured."""

    side: Side
    off_ohm: Array
    sigma_ohm: Array


@dataclass(frozen=True, eq=False)
class Found:
    """A number of the electronics, in its unit.

    value, sigma : mean over the lines that were measured (of two channels' sum where a reading has two), and its
    standard deviation. lines : what single lines add to it; none where it is one for all.
    """

    number: LineNumber
    value: float
    sigma: float
    lines: tuple[LineOffsets, ...]

    @property
    def differ(self) -> bool:
        """Whether lines differ by more than chance."""
        return any(
            bool(np.any(np.abs(lines.off_ohm) > MOST_SIGMA_OF_LINES * lines.sigma_ohm + ROUNDING_OHM))
            for lines in self.lines
        )

    def on(self, lines: LineOffsets) -> Array:
        """(lines) ohm of every line of a side, its share of the sum where readings have two; the mean where unknown."""
        return np.asarray(self.value / len(self.lines) + np.nan_to_num(lines.off_ohm))


def found_number(fit: CircuitFit, index: int) -> Found:
    """The number of that index, with its covariance to first order in the unknowns."""
    circuit = fit.problem.circuit
    value, sides = circuit.common(fit.unknowns, index)[0], []
    slope = np.zeros(circuit.size)
    slope[index] = circuit.common(fit.unknowns, index)[1]
    for part in circuit.parts:
        if part.number == index:
            off, slopes = _of_lines(fit, part)
            measured = _measured(fit, part.side)
            value, slope = value + float(off[measured].mean()), slope + slopes[measured].mean(axis=0)
            sides.append(_lines(fit, part.side, off, slopes, measured))
    return Found(circuit.numbers[index], value, float(np.sqrt(slope @ fit.covariance @ slope)), tuple(sides))


def _of_lines(fit: CircuitFit, part: LineUnknowns) -> tuple[Array, Array]:
    """What lines add to their common number, (lines) ohm, and its slopes (lines, unknowns)."""
    circuit, count = fit.problem.circuit, part.lines.stop - part.lines.start
    spread, own = circuit.spread(fit.unknowns, part.number), fit.unknowns[part.lines]
    slopes = np.zeros((count, circuit.size))
    slopes[np.arange(count), np.arange(part.lines.start, part.lines.stop)] = spread
    if not circuit.numbers[part.number].channel:
        common, slope = circuit.common(fit.unknowns, part.number)
        slopes[:, part.number] = spread * own * slope / common
    return spread * own, slopes


def _lines(fit: CircuitFit, side: Side, off: Array, slopes: Array, measured: NDArray[np.bool_]) -> LineOffsets:
    centred = slopes - slopes[measured].mean(axis=0)
    sigma = np.sqrt(np.maximum(np.einsum("li,ij,lj->l", centred, fit.covariance, centred), 0.0))
    nothing = np.where(measured, 0.0, np.nan)
    return LineOffsets(side, off - off[measured].mean() + nothing, sigma + nothing)


def _measured(fit: CircuitFit, side: Side) -> NDArray[np.bool_]:
    """(lines) of a side that a reading with a resistor tells something of."""
    return np.asarray(np.any([trial.led(side) for trial in fit.problem.trials], axis=0))


def check_fit(fit: CircuitFit) -> None:
    """Raise InputError where the readings are not those of the known resistors behind any such circuit.

    χ² over its freedom follows Fisher's distribution, because σ itself is known from as many repeats only.
    """
    problem = fit.problem
    for trial in problem.trials:
        _check_open_lines(fit, trial)
    if fit.freedom < 0 or not fit.readings:
        many = "nothing was read across a known resistor" if not fit.readings else f"only {fit.readings} readings"
        raise InputError(f"{problem.trials[0].name}: no calibration: {many}; join lines by more known resistors")
    repeats = sum(trial.readings.freedom for trial in problem.trials)
    chance = fisher.sf(fit.chi_square / max(fit.freedom, 1), max(fit.freedom, 1), repeats)
    if chance < BY_CHANCE:
        raise InputError(_worst(fit))


def _check_open_lines(fit: CircuitFit, trial: Trial) -> None:
    """Raise InputError where something is read on lines that no known resistor leads to."""
    circuit, reads = fit.problem.circuit, trial.readings.volt
    gives = circuit.volt(fit.unknowns, trial.cells)
    off = np.where(trial.used | ~np.isfinite(reads), 0.0, np.abs(reads - gives)) / circuit.readout.supply_volt
    if off.max() > OPEN_SHARE:
        row, column = (int(part) for part in np.unravel_index(off.argmax(), off.shape))
        read = float(circuit.readout.recorded_from_volt(reads[row, column]))
        raise InputError(
            f"{trial.name}: no calibration: row {row}, column {column} reads {read:.4g} {circuit.readout.unit}, but no "
            f"known resistor leads there; was the panel unplugged?"
        )


def _worst(fit: CircuitFit) -> str:
    """The reading that is farthest from what any such circuit gives."""
    off = np.abs(fit.rest) / fit.sigma
    index = int(off.argmax())
    expected = fit.problem.measured - fit.rest
    circuit = fit.problem.circuit.readout
    reads, gives = (
        float(circuit.recorded_from_volt(np.array(volt[index]))) for volt in (fit.problem.measured, expected)
    )
    places = [(trial.name, row, column) for trial in fit.problem.trials for row, column in np.argwhere(trial.used)]
    name, row, column = places[index]
    return (
        f"{name}: no calibration: row {row}, column {column} reads {reads:.4g} {circuit.unit}, but behind the "
        f"circuit that fits best the known resistors give {gives:.4g} {circuit.unit}; noise and tolerances explain "
        f"{100 * np.mean(off < 3):.0f} % of the readings"
    )


def check_number(fit: CircuitFit, found: Found) -> None:
    """Raise InputError where the readings do not tell a number, or it is none that such electronics have."""
    name, where = found.number.name, f"{fit.problem.trials[0].name}: no calibration: "
    enough = ENOUGH.get(found.number.name, WORST_OHM - TYPICAL_OHM if found.number.channel else 0.0)
    if found.sigma > max(enough, MOST_SIGMA_SHARE * found.value):
        raise InputError(
            f"{where}the readings do not tell {name} ({found.value:.4g} ± {found.sigma:.2g} {found.number.unit}); "
            f"known resistors of different values, on more lines, do"
        )
    if found.number.in_scene and found.number.channel:
        _check_channels(fit, found, where)
    for lines in found.lines:
        _check_spread(found, lines, where)


def _check_spread(found: Found, lines: LineOffsets, where: str) -> None:
    """Raise InputError where two lines of a side differ by more than two channels, or two resistors, do."""
    most = max(WORST_OHM - BEST_OHM if found.number.channel else 0.0, 2 * MOST_OF_RESISTORS * found.value)
    high, low = int(np.nanargmax(lines.off_ohm)), int(np.nanargmin(lines.off_ohm))
    apart = float(lines.off_ohm[high] - lines.off_ohm[low])
    if apart - SURE * np.hypot(lines.sigma_ohm[high], lines.sigma_ohm[low]) > most:
        raise InputError(
            f"{where}{found.number.name} of {lines.side} {high} and {low} would differ by {apart:.4g} ohm, and at most "
            f"{most:.4g} ohm is likely ({LIKELY[found.number.channel]})"
        )


def _check_channels(fit: CircuitFit, found: Found, where: str) -> None:
    """Raise InputError where channels alone have more than the worst ones do, or than the scene's and as far above.

    A recording of equal cells looks like one of a larger series resistance in all else.
    """
    channels, specified = len(found.lines), fit.problem.circuit.specified(found.number)
    most = max(channels * WORST_OHM, specified + channels * (WORST_OHM - TYPICAL_OHM))
    if found.value - SURE * found.sigma > most:
        raise InputError(
            f"{where}a {found.number.name} of {found.value:.4g} ohm is more than the {most:g} ohm that {channels} "
            f"channels have at worst; were the known resistors in place of the panel, and are their values right?"
        )
