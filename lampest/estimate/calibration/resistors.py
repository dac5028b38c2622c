"""Calibration of the electronics with known resistors, by weighted least squares.

    minimise (y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e²,    covariance of θ: (JᵀJ)⁻¹ at the minimum

y are measured voltages and V(θ) those of the circuit. θ contains, for each number of the circuit,
its common value q and the offsets e of its lines in units of their spread. C is the covariance of
noise, quantisation, and the tolerances of the resistors and of the reference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import scipy
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from lampest.estimate.calibration import DIGITS, FRACTION_DIGITS, Calibration, common_scene
from lampest.estimate.calibration.trials import BELIEF, Trial, usable_range, within_rails
from lampest.files.errors import InputError
from lampest.files.levels import SIGNIFICANT
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.readouts.converter import MIN_REPEATS
from lampest.panel.readouts.lines import MAX_OHM, LineNumber, SeriesPerLine, Side
from lampest.panel.readouts.readout import with_memory
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import SHORT_OHM

# channel of a CD74HC4067 at 5 V, by its data sheet
BEST_OHM = 40.0
TYPICAL_OHM = 70.0
WORST_OHM = 160.0
RESISTOR_TOLERANCE = 0.05  # of ordinary resistors, uniformly distributed
# Numbers that are estimated where the scene names them.
MEMORY = LineNumber("converter_memory", (), in_scene=True, unit="1")
WIRE = tuple(
    LineNumber(f"lines.{line}_ohm_per_cell", (), in_scene=True) for line in ("row", "column")
)
# Name in words, typical value, and the largest σ of a number that counts as determined, if 0.3 of
# its value is less. A real board had a memory of 2.9 % of the channel before, and conductive thread
# an ohm from cell to cell.
EXPECTED = {
    "converter_memory": ("converter memory", 0.03, 0.01),
    "lines.row_ohm_per_cell": ("wire of rows", 1.0, 0.5),
    "lines.column_ohm_per_cell": ("wire of columns", 1.0, 0.5),
    "diode.drop_volt": ("diode drop", None, 0.2),
}
STEP = 1e-5  # of an unknown, or of ln of a resistor, for forward differences
PLAUSIBLE_RANGE = {
    True: "channels of a CD74HC4067 have 40 to 160 ohm",
    False: "resistors of 5 % differ by less",
}


class LineOffsets(NamedTuple):
    """Offsets of the lines of one side from their mean with standard deviations, ohm.

    NaN where not measured.
    """

    side: Side
    off_ohm: Array
    sigma_ohm: Array


@dataclass(frozen=True, eq=False)
class CircuitNumber:
    """An estimated number of the electronics, in its unit.

    Attributes
    ----------
    number : LineNumber
    value, sigma : float
        Mean over the measured lines, of the sum of both channels where a reading has two, and its
        standard deviation.
    lines : tuple of LineOffsets
        Offsets of single lines; empty where one number holds for all.
    """

    number: LineNumber
    value: float
    sigma: float
    lines: tuple[LineOffsets, ...]

    @property
    def differ(self) -> bool:
        """Whether lines differ significantly."""
        return any(
            bool(np.any(np.abs(lines.off_ohm) > SIGNIFICANT * lines.sigma_ohm))
            for lines in self.lines
        )

    @property
    def label(self) -> str:
        """The number in words, such as 'drive resistance 70.700 ± 0.300 ohm'."""
        usual = f"{self.number.name.removesuffix('_ohm').removesuffix('_resistance')} resistance"
        name, *_ = EXPECTED.get(self.number.name, (usual,))
        return f"{name} {self.value:.3f} ± {self.sigma:.3f} {self.number.unit}"

    def remarks(self, readings: int) -> list[str]:
        """Return sentences with the value, its uncertainty and lines' offsets where they differ.

        Parameters
        ----------
        readings : int
            Number of readings from which it was estimated.
        """
        digits, unit = (
            (FRACTION_DIGITS, "") if self.number == MEMORY else (DIGITS, f" {self.number.unit}")
        )
        value = f"{self.value:.{digits}f} +- {self.sigma:.{digits}f}{unit}"
        remarks = [
            f"{self.number.name}: {value} (one standard deviation), from {readings} readings"
        ]
        for side, offset, sigma in self.lines if self.differ else ():
            pairs = zip(offset, sigma, strict=True)
            texts = (
                "not measured" if np.isnan(ohm) else f"{ohm:+.2f} +- {sd:.2f}" for ohm, sd in pairs
            )
            remarks.append(f"{side} differ from the mean by {', '.join(texts)} ohm")
        if self.differ and len(self.lines) > 1:
            remarks.append(
                "rows and columns share their common part evenly, because only their sums are read"
            )
        return remarks


@dataclass(frozen=True, eq=False, kw_only=True)
class ResistorCalibration(Calibration):
    """Result of a calibration with known resistors.

    Attributes
    ----------
    numbers : tuple of CircuitNumber
        The estimated numbers of the electronics.
    readings : int
        Number of readings that are values.
    """

    numbers: tuple[CircuitNumber, ...]
    readings: int


def calibrate_resistors(
    recordings: Sequence[Recording],
    known: Sequence[Array | float] = (0.0,),
    tolerance: float = 0.01,
) -> ResistorCalibration:
    """Estimate the circuit's numbers from known resistors in place of the cells.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one panel and readout; the frames of each are repeats.
    known : sequence of array or float
        Known resistors of each recording, ohm: (rows, columns), or one number for all cells; 0
        where row and column lines are shorted together; inf or NaN where there is no resistor.
    tolerance : float
        Largest relative error of the known resistors and of the reference, uniformly distributed.

    Raises
    ------
    InputError
        If the scene's readout has no such numbers, if the readings do not determine them, or if
        these resistors do not explain the readings.
    """
    scene = common_scene(recordings)
    name = recordings[0].name
    if not scene.circuit.line_numbers():
        raise InputError(
            f"{name}: known resistors tell nothing of this readout ({scene.circuit.description()})"
        )
    trials = tuple(
        Trial.of(recording, ohm) for recording, ohm in zip(recordings, known, strict=True)
    )
    fit = _fit(Problem(scene, trials, tolerance))
    _check_fit(fit)
    numbers = tuple(map(partial(_estimated, fit), fit.problem.unknowns))
    noise = noise_of(trials)
    remarks = [remark for number in numbers for remark in number.remarks(fit.readings)]
    if noise is not None:
        remarks.append(
            f"noise_lsb: of one reading, from {sum(trial.repeats.sum() for trial in trials):g} "
            "repeats"
        )
    remarks.append(
        f"resistors taken as within {100 * tolerance:g} %; the residual is "
        f"{fit.chi_square / max(fit.freedom, 1):.2g} times what noise and tolerances explain"
    )
    differ = any(number.differ for number in numbers)
    return ResistorCalibration(
        scene=_with_estimates(scene, numbers, noise),
        summary=f"{', '.join(number.label for number in numbers)} from {fit.readings} readings",
        remarks=tuple(remarks),
        warnings=(
            "the lines differ by more than their noise; comments in the scene state by how much",
        )
        * differ,
        numbers=numbers,
        readings=fit.readings,
    )


def noise_of(trials: Sequence[Trial]) -> float | tuple[float, ...] | None:
    """Return the noise of one reading from repeats, LSB.

    It is a tuple for the driven lines where they differ. Lines with fewer than MIN_REPEATS repeats
    have the mean; None where all lines have fewer.
    """
    counts = np.array([trial.repeats for trial in trials])
    variances = np.average([trial.noise_lsb**2 for trial in trials], axis=0, weights=counts + 1e-9)
    repeats = counts.sum(axis=0)
    repeated = repeats >= MIN_REPEATS
    if not repeated.any():
        return None
    mean = float(np.average(variances[repeated], weights=repeats[repeated]))
    quantisation = 1 / 12  # LSB²: variances below it are equal in effect
    deviation = np.abs(np.log((variances[repeated] + quantisation) / (mean + quantisation)))
    # ln of a variance from n repeats has the standard deviation √(2/n)
    if np.all(deviation < SIGNIFICANT * np.sqrt(2 / repeats[repeated])):
        return round(float(np.sqrt(mean)), DIGITS)
    return tuple(
        round(float(variance) ** 0.5, DIGITS) for variance in np.where(repeated, variances, mean)
    )


@dataclass(frozen=True, eq=False)
class Unknown:
    """A number of the electronics within θ.

    The value of a line is scale·q + spread·e. The prior of e is N(0, 1), so that lines without a
    measurement have the mean of the others.

    Attributes
    ----------
    number : LineNumber
    index : int
        Index of q in θ.
    lines : dict
        Slice of e in θ for each side.
    specified : float
        The scene's value; the mean where it lists one for each line.
    """

    number: LineNumber
    index: int
    lines: dict[Side, slice]
    specified: float

    @property
    def scale(self) -> float:
        """Value that corresponds to q = 1, in the number's unit."""
        _, typical, _ = EXPECTED.get(
            self.number.name, ("", TYPICAL_OHM if self.number.channel else None, 0.0)
        )
        return typical or self.specified

    @property
    def start(self) -> float:
        """q of the scene's value; for channels at least the typical one."""
        return max(
            self.specified / self.scale, len(self.number.sides) if self.number.channel else 1.0
        )

    def values(self, unknowns: Array) -> tuple[float, list[Array]]:
        """Return the common value and the offsets of the lines of each side.

        The value is in the number's unit; the offsets, spread·e, are in ohm. The spread of channels
        is a third of the difference between worst and typical ones; that of resistors is the
        standard deviation of RESISTOR_TOLERANCE.
        """
        common = self.scale * float(unknowns[self.index])
        spread = (
            (WORST_OHM - TYPICAL_OHM) / 3
            if self.number.channel
            else RESISTOR_TOLERANCE / 3**0.5 * common
        )
        return common, [spread * unknowns[part] for part in self.lines.values()]


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: residuals of all readings of all trials as functions of θ.

    Attributes
    ----------
    scene : Scene
    trials : tuple of Trial
    tolerance : float
        Largest relative error of the resistors, uniformly distributed.
    """

    scene: Scene
    trials: tuple[Trial, ...]
    tolerance: float

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Numbers that resistors determine.

        They are those of the readout, and memory and wires that the scene names.
        """
        scene = self.scene
        unknowns = list[Unknown]()
        memory = () if scene.known_memory is None else (MEMORY,)
        numbers = scene.circuit.line_numbers() + memory + (WIRE if scene.lines is not None else ())
        lengths = dict(zip(("rows", "columns"), scene.panel.shape, strict=True))
        first = len(numbers)
        for index, number in enumerate(numbers):
            lines = dict[Side, slice]()
            for side in number.sides:
                lines[side] = slice(first, first + lengths[side])
                first += lengths[side]
            of: Any = scene if number.in_scene else scene.circuit
            value = (
                scene.series_ohm
                if number.in_scene and number.channel
                else attrgetter(number.name)(of)
            )
            unknowns.append(Unknown(number, index, lines, float(np.mean(value))))
        return tuple(unknowns)

    @cached_property
    def start(self) -> Array:
        """θ of the scene's numbers."""
        lines = sum(
            part.stop - part.start for unknown in self.unknowns for part in unknown.lines.values()
        )
        return np.array([unknown.start for unknown in self.unknowns] + [0.0] * lines)

    def volt(self, unknowns: Array, cells: Array, reference_off: float = 0.0) -> Array:
        """Return the voltages at the converter, (rows, columns) V.

        Parameters
        ----------
        unknowns : array
            θ.
        cells : array, shape (rows, columns)
            Resistors in place of the cells, ohm.
        reference_off : float
            Relative error of the reference resistor.
        """
        channels: list[Array] = [np.zeros(lines) for lines in self.scene.panel.shape]
        known = dict[str, Any]()
        volts = (self.scene.circuit.lsb_volt, self.scene.circuit.full_scale_volt)
        for unknown in self.unknowns:
            common, offsets = unknown.values(unknowns)
            if unknown.number.in_scene and offsets:
                channels = [common / len(offsets) + ohm for ohm in offsets]
            else:
                # ln(1 + exp R) equals R from a few ohm on, is positive, and has a nonzero
                # derivative everywhere.
                numbers = np.logaddexp(0, common + offsets[0]) if offsets else np.array(common)
                limits = {
                    "1": (0.0, 0.9),
                    "volt": volts,
                    "ohm": (SHORT_OHM if offsets else 0.0, MAX_OHM),
                }
                limited = np.clip(numbers, *limits[unknown.number.unit]).tolist()
                known[scene_key(unknown.number)] = tuple(limited) if offsets else limited
        # Contacts and faults belong to the panel, which is unplugged.
        panel = self.scene.panel
        converter = self.scene.readout
        memory = self.scene.known_memory
        scene: Scene = with_numbers(
            Scene(panel, converter, lines=self.scene.lines, converter_memory=memory), known
        )
        readout = scene.circuit
        volt = readout.off_by(reference_off).volt_from_recorded(
            readout.simulated(cells, scene, *channels)
        )
        return with_memory(readout, scene.known_memory, volt) if scene.known_memory else volt

    @cached_property
    def measured(self) -> Array:
        """Measured voltages clipped to the usable range of the converter, (readings,) V.

        Measured and expected values are clipped alike, so that a reading at a rail is a one-sided
        constraint.
        """
        volt = np.concatenate([trial.volt[trial.used] for trial in self.trials])
        return np.asarray(np.clip(volt, *usable_range(self.scene.circuit)))

    def expected(
        self, unknowns: Array, resistor: tuple[float, int] | None = None, reference: float = 0.0
    ) -> Array:
        """Return the expected voltages clipped to the usable range, (readings,) V.

        Parameters
        ----------
        unknowns : array
            θ.
        resistor : (float, int), optional
            Resistor that is multiplied by exp(STEP), see `Trial.resistors`.
        reference : float
            Relative error of the reference.
        """
        volts = []
        for trial in self.trials:
            cells = trial.cells.copy()
            if resistor in trial.resistors:
                cells[trial.resistors[resistor]] *= np.exp(STEP)
            volts.append(self.volt(unknowns, cells, reference)[trial.used])
        return np.asarray(np.clip(np.concatenate(volts), *usable_range(self.scene.circuit)))

    def covariance(self, unknowns: Array, own_lsb: float = 0.0) -> Array:
        """Return the covariance C of the readings, (readings, readings) V².

        It includes noise, quantisation, the tolerances of resistors and of the reference, and
        `own_lsb`, the converter's own error in LSB.
        """
        at = self.expected(unknowns)
        names = dict.fromkeys(name for trial in self.trials for name in trial.resistors)
        moved = [
            *(self.expected(unknowns, name) for name in names),
            self.expected(unknowns, reference=STEP),
        ]
        # ∂V/∂ln R by forward differences, times tolerance/√3, the standard deviation of a uniform
        # error
        tolerances = self.tolerance / np.sqrt(3) / STEP * (np.stack(moved, axis=1) - at[:, None])
        sigma = np.concatenate([trial.sigma_volt[trial.used] for trial in self.trials])
        noise = own_lsb * self.scene.circuit.lsb_volt
        return np.asarray(np.diag(sigma**2 + noise**2) + tolerances @ tolerances.T)

    def squares(self, root: Array, unknowns: Array) -> SumOfSquares:
        """Return (y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² about θ.

        The Cholesky factor `root` of C is given.
        """

        def residual(at: Array) -> Array:
            weighted = solve_triangular(root, self.measured - self.expected(at), lower=True)
            return np.concatenate([weighted, at[len(self.unknowns) :]])

        return SumOfSquares(residual(unknowns), forward_differences(residual, unknowns))


def forward_differences(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the Jacobian (values, unknowns) by forward differences."""
    slopes = scipy.optimize.approx_fprime(at, function, STEP * np.maximum(1.0, np.abs(at)))
    return np.asarray(slopes).reshape(-1, len(at))


def scene_key(number: LineNumber) -> str:
    """Return the key of a number in a scene, dotted for the readout's."""
    return number.name if number.in_scene else f"readout.{number.name}"


def with_numbers(part: Any, values: dict[str, Any]) -> Any:
    """Return a record with other values by field name; 'a.b' is the field b of its part a."""
    for name, value in values.items():
        first, _, inner = name.partition(".")
        part = replace(
            part, **{first: with_numbers(getattr(part, first), {inner: value}) if inner else value}
        )
    return part


class CircuitFit(NamedTuple):
    """The unknowns at the minimum and their covariance.

    Attributes
    ----------
    problem : Problem
    unknowns, covariance : array
        θ and (JᵀJ)⁻¹.
    chi_square, freedom : float, int
        χ² of the residual, with the converter's own error in C, and its degrees of freedom.
    residual, sigma : array, shape (readings,)
        y − V(θ) and its standard deviation, V.
    readings : int
        Number of readings that are values.
    """

    problem: Problem
    unknowns: Array
    covariance: Array
    chi_square: float
    freedom: int
    residual: Array
    sigma: Array
    readings: int


def _fit(problem: Problem) -> CircuitFit:
    """Return the least-squares fit.

    C is evaluated at the start, then once more near the minimum.
    """
    unknowns = problem.start
    commons = len(problem.unknowns)
    least = np.where(np.arange(len(unknowns)) < commons, 0.0, -np.inf)
    # Change of ½ χ²: the second one leaves an error of a hundredth of σ.
    for settled in (1.0, 1e-4):
        root = np.linalg.cholesky(problem.covariance(unknowns))
        # Good calibrations take some 5 evaluations from the scene's numbers, and 10 from numbers
        # ten times too large.
        method = LevenbergMarquardt(25, settled)
        unknowns, squares = method.minimum(
            partial(problem.squares, root), unknowns, (least, np.inf)
        )
    # The converter's own error: integral nonlinearity of 0.5 LSB, by the data sheet of the
    # ATmega2560.
    residual = problem.measured - problem.expected(unknowns)
    spread = problem.covariance(unknowns, 0.5)
    weighted = solve_triangular(np.linalg.cholesky(spread), residual, lower=True)
    # A reading counts as a value unless both the measurement and its expectation lie at a rail.
    inside = [
        within_rails(problem.scene.circuit, volt)
        for volt in (problem.measured, problem.expected(unknowns))
    ]
    values = int(np.sum(inside[0] | inside[1]))
    chi_square = float(weighted @ weighted + unknowns[commons:] @ unknowns[commons:])
    # (JᵀJ)⁻¹ = V S⁻² Vᵀ of J = U S Vᵀ, with a very large variance in the null space of J.
    _, singular, right = np.linalg.svd(squares.jacobian, full_matrices=False)
    inverse = right / np.maximum(singular, np.sqrt(np.finfo(float).eps) * singular[0])[:, None]
    sigma = np.sqrt(np.diag(spread))
    return CircuitFit(
        problem,
        unknowns,
        inverse.T @ inverse,
        chi_square,
        values - commons,
        residual,
        sigma,
        values,
    )


def _estimated(fit: CircuitFit, unknown: Unknown) -> CircuitNumber:
    """Return a number with its uncertainty by linear propagation from θ.

    Raises InputError as `_check_number`.
    """
    trials = fit.problem.trials
    measured = {
        side: np.any([trial.connected(side) for trial in trials], axis=0) for side in unknown.lines
    }

    def values(unknowns: Array) -> Array:
        """Return the mean over measured lines, then the lines' offsets from it."""
        common, offsets = unknown.values(unknowns)
        means = [
            offset[known].mean() for offset, known in zip(offsets, measured.values(), strict=True)
        ]
        return np.concatenate([[common + sum(means)], *map(np.subtract, offsets, means)])

    at = values(fit.unknowns)
    slopes = forward_differences(values, fit.unknowns)
    # σ² = diag(S P Sᵀ), with S the derivatives of the values and P the covariance of θ
    sigma = np.sqrt(np.maximum(np.einsum("li,ij,lj->l", slopes, fit.covariance, slopes), 0.0))
    ends = np.cumsum([1, *(len(lines) for lines in measured.values())])[:-1]
    parts = zip(measured.items(), np.split(at, ends)[1:], np.split(sigma, ends)[1:], strict=True)
    offsets = tuple(
        LineOffsets(side, np.where(known, offset, np.nan), np.where(known, sd, np.nan))
        for (side, known), offset, sd in parts
    )
    number = CircuitNumber(unknown.number, float(at[0]), float(sigma[0]), offsets)
    _check_number(f"{trials[0].name}: no calibration: ", number, unknown.specified)
    return number


def _check_fit(fit: CircuitFit) -> None:
    """Raise InputError where no such circuit explains the readings with the known resistors."""
    trials = fit.problem.trials
    readout = fit.problem.scene.circuit

    def spoken(volt: float) -> str:
        return f"{float(readout.recorded_from_volt(np.array(volt))):.4g} {readout.unit}"

    for trial in trials:
        unused = ~trial.used & np.isfinite(trial.volt)
        missed = np.where(
            unused, np.abs(trial.volt - fit.problem.volt(fit.unknowns, trial.cells)), 0.0
        )
        if missed.max() > 0.1 * readout.full_scale_volt:  # hum, and a memory of 3 %, stay below
            row, column = (int(part) for part in np.unravel_index(missed.argmax(), missed.shape))
            raise InputError(
                f"{trial.name}: no calibration: row {row}, column {column} reads "
                f"{spoken(trial.volt[row, column])}, "
                f"but no known resistor leads there; was the panel unplugged?"
            )
    if fit.freedom < 0 or not fit.readings:
        many = (
            "nothing was read across a known resistor"
            if not fit.readings
            else f"only {fit.readings} readings"
        )
        raise InputError(
            f"{trials[0].name}: no calibration: {many}; join lines by more known resistors"
        )
    # σ itself is estimated from a finite number of repeats, so χ²/freedom follows Fisher's F
    # distribution.
    freedom = max(fit.freedom, 1)
    repeated = sum(BELIEF + trial.repeats.sum() for trial in trials)
    # Of good calibrations may be refused.
    if fdtrc(freedom, repeated, fit.chi_square / freedom) < 1e-7:
        deviation = np.abs(fit.residual) / fit.sigma
        index = int(deviation.argmax())
        places = [(trial.name, *place) for trial in trials for place in np.argwhere(trial.used)]
        name, row, column = places[index]
        measured = fit.problem.measured[index]
        raise InputError(
            f"{name}: no calibration: row {row}, column {column} reads {spoken(measured)}, but "
            "behind the "
            "circuit that fits best the known resistors give "
            f"{spoken(measured - fit.residual[index])}; noise and "
            f"tolerances explain {100 * np.mean(deviation < 3):.0f} % of the readings"
        )


def _check_number(where: str, estimate: CircuitNumber, specified: float) -> None:
    """Raise InputError where readings do not determine a number, or its value is implausible.

    Parameters
    ----------
    where : str
        Beginning of the message.
    estimate : CircuitNumber
    specified : float
        The scene's value.
    """
    number = estimate.number
    channels = len(estimate.lines)
    *_, expected = EXPECTED.get(number.name, (WORST_OHM - TYPICAL_OHM if number.channel else 0.0,))
    if estimate.sigma > max(expected, 0.3 * estimate.value):
        raise InputError(
            f"{where}the readings do not tell {number.name} ({estimate.value:.4g} ± "
            f"{estimate.sigma:.2g} "
            f"{number.unit}); known resistors of different values, on more lines, do"
        )
    # Equal cells are equivalent to a larger series resistance, so the value is limited to that of
    # the worst channels, or to their excess over typical ones above the specified value.
    most = max(channels * WORST_OHM, specified + channels * (WORST_OHM - TYPICAL_OHM))
    if number.in_scene and number.channel and estimate.value - SIGNIFICANT * estimate.sigma > most:
        raise InputError(
            f"{where}a {number.name} of {estimate.value:.4g} ohm is more than the {most:g} ohm "
            f"that {channels} "
            "channels have at worst; were the known resistors in place of the panel, and are "
            "their values right?"
        )
    most = max(
        WORST_OHM - BEST_OHM if number.channel else 0.0, 4 * RESISTOR_TOLERANCE * estimate.value
    )
    for side, offset, sigma in estimate.lines:
        high = int(np.nanargmax(offset))
        low = int(np.nanargmin(offset))
        difference = float(offset[high] - offset[low])
        if difference - SIGNIFICANT * np.hypot(sigma[high], sigma[low]) > most:
            raise InputError(
                f"{where}{number.name} of {side} {high} and {low} would differ by {difference:.4g} "
                "ohm, and at most "
                f"{most:.4g} ohm is likely ({PLAUSIBLE_RANGE[number.channel]})"
            )


def _with_estimates(
    scene: Scene, numbers: Sequence[CircuitNumber], noise: float | tuple[float, ...] | None
) -> Scene:
    """Return the scene with the estimated numbers, rounded to a milliohm.

    A number is a list where lines differ.
    """
    if noise is not None:
        scene = with_numbers(scene, {"readout.noise_lsb": noise})
    for estimate in numbers:
        number = estimate.number
        digits = FRACTION_DIGITS if estimate.number in (MEMORY, *WIRE) else DIGITS
        # Lines have their share of the sum where a reading has two channels, and the mean where not
        # measured. Values are clipped at 0, because noise may make a small one negative.
        value: Any = round(max(estimate.value, 0.0), digits)
        if estimate.differ:
            share = estimate.value / len(estimate.lines)
            sides = [
                np.maximum(share + np.nan_to_num(offset), 0.0).tolist()
                for _, offset, _ in estimate.lines
            ]
            lines = [tuple(round(ohm, digits) for ohm in side) for side in sides]
            value = SeriesPerLine(*lines) if number.in_scene else lines[0]
        scene = with_numbers(scene, {scene_key(number): value})
    return scene
