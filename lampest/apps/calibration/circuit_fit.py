"""Weighted least squares for the numbers of the electronics, and their keys in a scene.

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

from lampest.apps.calibration.calibration import DIGITS, FRACTION_DIGITS
from lampest.apps.calibration.trials import Trial, usable_range, within_rails
from lampest.files.levels import SIGNIFICANT
from lampest.panel.effects import E24_TOLERANCE
from lampest.panel.effects.channels import TYPICAL_OHM, WORST_OHM
from lampest.panel.effects.converter_curve import ConverterCurve
from lampest.panel.effects.converter_memory import KeptShare
from lampest.panel.effects.wire import WirePerCell
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.lines import MAX_OHM, LineNumber, SeriesPerLine, Side
from lampest.panel.panel import Array
from lampest.panel.readouts.channel_memory import with_memory
from lampest.panel.readouts.tolerances import line_numbers, off_by, simulated
from lampest.panel.scene import Scene
from lampest.recording.simulation.measure import SHORT_OHM

MAX_KEPT_FRACTION = 0.9  # of a converter; with 1, nothing of a new reading would be seen
MAX_EVALUATIONS = 25  # good calibrations take 5, and 10 from numbers ten times too large
STEP = 1e-5  # of an unknown, or of ln of a resistor, for forward differences


# Numbers that are estimated where the scene names them.
MEMORY = LineNumber("converter_memory", (), in_scene=True, unit="1")
WIRE = tuple(
    LineNumber(f"lines.{line}_ohm_per_cell", (), in_scene=True) for line in ("row", "column")
)
# Name in words, typical value, and the largest σ of a number that counts as determined, if 0.3 of
# its value is less.
EXPECTED = {
    "converter_memory": ("converter memory", KeptShare.prior, 0.01),
    "lines.row_ohm_per_cell": ("wire of rows", WirePerCell.prior, 0.5),
    "lines.column_ohm_per_cell": ("wire of columns", WirePerCell.prior, 0.5),
    "diode.drop_volt": ("diode drop", None, 0.2),
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


def scene_key(number: LineNumber) -> str:
    """Return the key of a number in a scene, dotted for the readout's."""
    return number.name if number.in_scene else f"readout.{number.name}"


def with_numbers(part: Any, values: dict[str, Any]) -> Any:
    """Return a record with other values by field name; 'a.b' is the field b of its part a.

    Each record is made once, with all of its values.
    """
    own: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        first, _, further = name.partition(".")
        if further:
            inner.setdefault(first, {})[further] = value
        else:
            own[first] = value
    for first, further_values in inner.items():
        own[first] = with_numbers(own.get(first, getattr(part, first)), further_values)
    return replace(part, **own)


def with_estimates(
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
        default = TYPICAL_OHM if self.number.channel else None
        _, typical, _ = EXPECTED.get(self.number.name, ("", default, 0.0))
        return typical or self.specified

    @property
    def start(self) -> float:
        """q of the scene's value; for channels at least the typical one."""
        least = len(self.number.sides) if self.number.channel else 1.0
        return max(self.specified / self.scale, least)

    def values(self, unknowns: Array) -> tuple[float, list[Array]]:
        """Return the common value and the offsets of the lines of each side.

        The spread of channels is a third of the difference between worst and typical ones; that of
        resistors is the standard deviation of E24_TOLERANCE.

        Returns
        -------
        common : float
            In the number's unit.
        offsets : list of arrays, shape (lines,) each
            spread·e in ohm, one array a side.
        """
        common = self.scale * float(unknowns[self.index])
        spread = E24_TOLERANCE / 3**0.5 * common
        if self.number.channel:
            spread = (WORST_OHM - TYPICAL_OHM) / 3
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

        The numbers are those of the readout, and memory and wires where the scene names them.
        """
        scene = self.scene
        unknowns = list[Unknown]()
        memory = () if scene.known_memory is None else (MEMORY,)
        numbers = line_numbers(scene.circuit) + memory + (WIRE if scene.lines is not None else ())
        lengths = dict(zip(("rows", "columns"), scene.panel.shape, strict=True))
        first = len(numbers)
        for index, number in enumerate(numbers):
            lines = dict[Side, slice]()
            for side in number.sides:
                lines[side] = slice(first, first + lengths[side])
                first += lengths[side]
            if number.in_scene and number.channel:
                value = scene.series_ohm
            else:
                value = attrgetter(number.name)(scene if number.in_scene else scene.circuit)
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
        values = dict[str, Any]()
        for unknown in self.unknowns:
            common, offsets = unknown.values(unknowns)
            if unknown.number.in_scene and offsets:
                channels = [common / len(offsets) + ohm for ohm in offsets]
            else:
                # ln(1 + exp R) equals R from a few ohm on, is positive, and has a nonzero
                # derivative everywhere.
                numbers = np.logaddexp(0, common + offsets[0]) if offsets else np.array(common)
                limited = np.clip(numbers, *self._limits(unknown)).tolist()
                values[scene_key(unknown.number)] = tuple(limited) if offsets else limited
        scene: Scene = with_numbers(self._unplugged, values)
        readout = scene.circuit
        volt = off_by(readout, reference_off).volt_from_recorded(
            simulated(readout, cells, scene, *channels)
        )
        return with_memory(readout, scene.known_memory, volt) if scene.known_memory else volt

    @cached_property
    def _unplugged(self) -> Scene:
        """The scene without contacts and faults, which belong to the unplugged panel."""
        return Scene(
            self.scene.panel,
            self.scene.readout,
            lines=self.scene.lines,
            converter_memory=self.scene.known_memory,
        )

    def _limits(self, unknown: Unknown) -> tuple[float, float]:
        """Return the range of a number in its unit, beyond which the circuit has no meaning."""
        if unknown.number.unit == "1":
            return 0.0, MAX_KEPT_FRACTION
        if unknown.number.unit == "volt":
            return self.scene.circuit.lsb_volt, self.scene.circuit.full_scale_volt
        return SHORT_OHM if unknown.lines else 0.0, MAX_OHM

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

        The sources of variance are noise, quantisation, the tolerances of resistors and of the
        reference, and `own_lsb`, the converter's own error in LSB.
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


def fit_circuit(problem: Problem) -> CircuitFit:
    """Return the least-squares fit.

    C is evaluated at the start, then once more near the minimum.
    """
    unknowns = problem.start
    commons = len(problem.unknowns)
    lower = np.where(np.arange(len(unknowns)) < commons, 0.0, -np.inf)
    # Change of ½ χ²: the second one leaves an error of a hundredth of σ.
    for settled in (1.0, 1e-4):
        root = np.linalg.cholesky(problem.covariance(unknowns))
        method = LevenbergMarquardt(MAX_EVALUATIONS, settled)
        unknowns, squares = method.minimum(
            partial(problem.squares, root), unknowns, (lower, np.inf)
        )
    residual = problem.measured - problem.expected(unknowns)
    covariance = problem.covariance(unknowns, ConverterCurve.prior)
    weighted = solve_triangular(np.linalg.cholesky(covariance), residual, lower=True)
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
    sigma = np.sqrt(np.diag(covariance))
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


def estimated_number(fit: CircuitFit, unknown: Unknown) -> CircuitNumber:
    """Return a number with its uncertainty by linear propagation from θ."""
    trials = fit.problem.trials
    measured = {
        side: np.any([trial.connected(side) for trial in trials], axis=0) for side in unknown.lines
    }

    def values(unknowns: Array) -> Array:
        """Return the mean over measured lines, then the lines' offsets from it."""
        common, offsets = unknown.values(unknowns)
        means = [
            offset[lines].mean() for offset, lines in zip(offsets, measured.values(), strict=True)
        ]
        return np.concatenate([[common + sum(means)], *map(np.subtract, offsets, means)])

    at = values(fit.unknowns)
    slopes = forward_differences(values, fit.unknowns)
    # σ² = diag(S P Sᵀ), with S the derivatives of the values and P the covariance of θ
    sigma = np.sqrt(np.maximum(np.einsum("li,ij,lj->l", slopes, fit.covariance, slopes), 0.0))
    ends = np.cumsum([1, *(len(lines) for lines in measured.values())])[:-1]
    parts = zip(measured.items(), np.split(at, ends)[1:], np.split(sigma, ends)[1:], strict=True)
    offsets = tuple(
        LineOffsets(side, np.where(lines, offset, np.nan), np.where(lines, sd, np.nan))
        for (side, lines), offset, sd in parts
    )
    return CircuitNumber(unknown.number, float(at[0]), float(sigma[0]), offsets)
