"""Weighted least squares through a circuit's equations: which numbers of the electronics explain known resistors."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.memory import with_memory
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.lines import MOST_OHM, LineNumber, Side
from lampest.panel.scene import Scene
from lampest.recording.calibration.repeats import Trial, usable_range, within_rails
from lampest.recording.simulation.measure import SHORT_OHM

BEST_OHM, TYPICAL_OHM, WORST_OHM = 40.0, 70.0, 160.0  # a channel of a CD74HC4067 at 5 V: its data sheet
RESISTOR_TOLERANCE = 0.05  # of ordinary resistors, evenly
# Numbers to find where the scene names them, and what they are like: 2.9 % of the channel before were seen of a real
# board, and an ohm from cell to cell of conductive thread.
MEMORY = LineNumber("converter_memory", (), in_scene=True, unit="1")
WIRE = tuple(LineNumber(f"lines.{line}_ohm_per_cell", (), in_scene=True) for line in ("row", "column"))
TYPICAL = {MEMORY: 0.03} | dict.fromkeys(WIRE, 1.0)
STEP = 1e-5  # of an unknown, or of the logarithm of a resistor, for differences


@dataclass(frozen=True, eq=False)
class Unknown:
    """A number of the electronics: a common value at `index` of the unknowns, and for lines by how many spreads each is
    off, at `lines`.

    A channel's resistance is TYPICAL_OHM·q + spread·e, a resistor's R·exp(q) + spread·e with R of the scene. e is as
    likely as a standard normal number, so that lines which nothing measures are taken for the mean of the others.
    specified : what the scene says, the mean where it lists one for each line.
    """

    number: LineNumber
    index: int
    lines: dict[Side, slice]
    specified: float

    @property
    def scale(self) -> float | None:
        """Of a value that is so many times q, and not negative; None: of one that is an exponential."""
        return TYPICAL_OHM if self.number.channel else TYPICAL.get(self.number)

    @property
    def start(self) -> float:
        """q of the scene's value, channels at least typical ones."""
        least = len(self.number.sides) if self.number.channel else 1.0
        return 0.0 if self.scale is None else max(self.specified / self.scale, least)

    def common(self, unknowns: Array) -> tuple[float, float]:
        """(c, ∂c/∂q) in the number's unit."""
        at = float(unknowns[self.index])
        if self.scale is not None:
            return self.scale * at, self.scale
        value = self.specified * float(np.exp(at))
        return value, value

    def spread(self, unknowns: Array) -> float:
        """σ of lines, ohm: of channels a third of worst less typical, of resistors from their tolerance."""
        if self.number.channel:
            return (WORST_OHM - TYPICAL_OHM) / 3
        return RESISTOR_TOLERANCE / 3**0.5 * self.common(unknowns)[0]


@dataclass(frozen=True, eq=False)
class Problem:
    """Residuals of all readings of all trials, about the unknowns of the scene's circuit; of the scene itself only what
    is no unknown counts. tolerance : fraction by which resistors may be off, evenly.
    """

    scene: Scene
    trials: tuple[Trial, ...]
    tolerance: float

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """All that resistors tell: the readout's numbers, and those of what else the scene names."""
        scene, found = self.scene, list[Unknown]()
        memory = () if scene.converter_memory is None else (MEMORY,)
        numbers = scene.circuit.line_numbers() + memory + (WIRE if scene.lines is not None else ())
        lengths, first = dict(zip(("rows", "columns"), scene.panel.shape, strict=True)), len(numbers)
        for index, number in enumerate(numbers):
            lines = dict[Side, slice]()
            for side in number.sides:
                lines[side] = slice(first, first + lengths[side])
                first += lengths[side]
            of: Any = scene if number.in_scene else scene.circuit
            value = scene.series_ohm if number.in_scene and number.channel else attrgetter(number.name)(of)
            found.append(Unknown(number, index, lines, float(np.mean(value))))
        return tuple(found)

    @cached_property
    def start(self) -> Array:
        lines = sum(part.stop - part.start for one in self.unknowns for part in one.lines.values())
        return np.array([one.start for one in self.unknowns] + [0.0] * lines)

    @property
    def least(self) -> Array:
        least = np.full(len(self.start), -np.inf)
        least[[one.index for one in self.unknowns if one.scale is not None]] = 0.0
        return least

    @property
    def readout(self) -> Readout:
        return self.scene.circuit

    def volt(self, unknowns: Array, cells: Array, reference_off: float = 0.0) -> Array:
        """(rows, columns) at the converter, for cells in ohm and a reference resistor that is off by a fraction."""
        rows, columns = self.scene.panel.shape
        channels: dict[Side, Array] = {"rows": np.zeros(rows), "columns": np.zeros(columns)}
        fields, of_scene = dict[str, Any](), dict[str, float]()
        for one in self.unknowns:
            number, common, spread = one.number, one.common(unknowns)[0], one.spread(unknowns)
            off = {side: spread * unknowns[part] for side, part in one.lines.items()}
            if number in TYPICAL:
                of_scene[number.name] = min(common, 0.9) if number == MEMORY else common
            elif number.in_scene:
                channels |= {side: common / len(off) + ohm for side, ohm in off.items()}
            else:
                each = common + sum(off.values())
                # ln(1 + exp R) is R from some ohm on, never below zero, and always has a slope.
                volts = self.readout.lsb_volt, self.readout.full_scale_volt
                limits = volts if number.unit == "volt" else (SHORT_OHM, MOST_OHM)
                each = np.clip(np.logaddexp(0, each) if off else each, *limits)
                fields[number.name] = tuple(each.tolist()) if off else float(each)
        circuit: Any = with_numbers(self.readout, fields)
        # Contacts and faults are the panel's, which is unplugged.
        bare = Scene(self.scene.panel, circuit, lines=self.scene.lines, converter_memory=self.scene.converter_memory)
        scene: Scene = with_numbers(bare, of_scene)
        recorded = circuit.simulated(cells, scene, channels["rows"], channels["columns"])
        volt = np.asarray(circuit.off_by(reference_off).volt_from_recorded(recorded))
        return with_memory(circuit, scene.converter_memory, volt) if scene.converter_memory else volt

    @cached_property
    def measured(self) -> Array:
        """(readings) V at the converter, within its rails: beyond, a reading is a bound, and any more is as good."""
        volt = np.concatenate([trial.volt[trial.used] for trial in self.trials])
        return np.asarray(np.clip(volt, *usable_range(self.readout)))

    def expected(self, unknowns: Array, resistor: tuple[float, int] | None = None, reference: float = 0.0) -> Array:
        """(readings) V, with one resistor larger by a factor exp(STEP), or the reference by 1 + reference."""
        found = []
        for trial in self.trials:
            cells = trial.cells.copy()
            if resistor in trial.resistors:
                cells[trial.resistors[resistor]] *= np.exp(STEP)
            found.append(self.volt(unknowns, cells, reference)[trial.used])
        return np.asarray(np.clip(np.concatenate(found), *usable_range(self.readout)))

    def covariance(self, unknowns: Array, own_lsb: float = 0.0) -> Array:
        """(readings, readings) V² of noise, quantisation, the converter's own error, resistors and the reference."""
        at, names = self.expected(unknowns), dict.fromkeys(name for trial in self.trials for name in trial.resistors)
        moved = [*(self.expected(unknowns, name) for name in names), self.expected(unknowns, reference=STEP)]
        off = self.tolerance / np.sqrt(3) / STEP * (np.stack(moved, axis=1) - at[:, None])
        sigma = np.concatenate([trial.sigma_volt[trial.used] for trial in self.trials])
        own = own_lsb * self.readout.lsb_volt
        return np.asarray(np.diag(sigma**2 + own**2) + off @ off.T)

    def squares(self, root: Array, unknowns: Array) -> SumOfSquares:
        """(y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² about θ, slopes by forward differences; root : Cholesky factor of C."""

        def residual(at: Array) -> Array:
            left = solve_triangular(root, self.measured - self.expected(at), lower=True)
            return np.concatenate([left, at[len(self.unknowns) :]])

        here, steps = residual(unknowns), STEP * np.maximum(1.0, np.abs(unknowns))
        slopes = [(residual(unknowns + step) - here) / step.sum() for step in np.diag(steps)]
        return SumOfSquares(here, np.stack(slopes, axis=1))


def with_numbers(part: Any, values: dict[str, Any]) -> Any:
    """A record with numbers of other values; 'a.b' is b of its part a."""
    for name, value in values.items():
        first, _, rest = name.partition(".")
        part = replace(part, **{first: with_numbers(getattr(part, first), {rest: value}) if rest else value})
    return part


@dataclass(frozen=True, eq=False)
class CircuitFit:
    """The unknowns and their covariance.

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
    unknowns = problem.start
    for settled in (1.0, 1e-4):  # of ½ χ²: the last one is off by a hundredth of σ
        root = np.linalg.cholesky(problem.covariance(unknowns))
        # Good calibrations end after some 5 evaluations from the scene's numbers, 10 from those ten times too large.
        least_squares = LevenbergMarquardt(25, settled)
        found = least_squares.minimum(partial(problem.squares, root), unknowns, (problem.least, np.inf))
        unknowns = found.position
    # The converter's own error: ATmega2560, integral non-linearity 0.5 LSB, its data sheet.
    rest, whole = problem.measured - problem.expected(unknowns), problem.covariance(unknowns, 0.5)
    left = solve_triangular(np.linalg.cholesky(whole), rest, lower=True)
    # Values are readings of which neither they nor what is expected of them lies at a rail.
    inside = [within_rails(problem.readout, volt) for volt in (problem.measured, problem.expected(unknowns))]
    values, commons = int(np.sum(inside[0] | inside[1])), len(problem.unknowns)
    chi_square = float(left @ left + unknowns[commons:] @ unknowns[commons:])
    # (JᵀJ)⁻¹, nearly without end along what J does not see.
    _, singular, right = np.linalg.svd(found.at.jacobian, full_matrices=False)
    inverse = right / np.maximum(singular, np.sqrt(np.finfo(float).eps) * singular[0])[:, None]
    sigma = np.sqrt(np.diag(whole))
    return CircuitFit(problem, unknowns, inverse.T @ inverse, chi_square, values - commons, rest, sigma, values)
