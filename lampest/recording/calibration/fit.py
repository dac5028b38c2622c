"""Weighted least squares through a circuit's equations: which numbers of the electronics explain known resistors."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
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
class Circuit:
    """The unknowns: for every number a common value, then for every line by how many spreads it is off.

    A channel's resistance is TYPICAL_OHM·q + spread·e, a resistor's R·exp(q) + spread·e with R of the scene. e is as
    likely as a standard normal number, so that lines which nothing measures are taken for the mean of the others.
    """

    scene: Scene
    numbers: tuple[LineNumber, ...]

    @classmethod
    def of(cls, scene: Scene) -> "Circuit":
        """All numbers that resistors tell: the readout's, and those of what else the scene names."""
        memory = () if scene.converter_memory is None else (MEMORY,)
        return cls(scene, scene.circuit.line_numbers() + memory + (WIRE if scene.lines is not None else ()))

    @property
    def readout(self) -> Readout:
        """The scene's."""
        return self.scene.circuit

    @cached_property
    def lines(self) -> dict[tuple[int, Side], slice]:
        """(number, side) → where in the unknowns the lines of that side stand."""
        found: dict[tuple[int, Side], slice] = {}
        first = len(self.numbers)
        for index, number in enumerate(self.numbers):
            for side in number.sides:
                found[index, side] = slice(first, first + self._lengths[side])
                first += self._lengths[side]
        return found

    @cached_property
    def start(self) -> Array:
        """(unknowns) the scene's numbers, channels at least typical ones; all lines alike."""
        found = np.zeros(max(part.stop for part in self.lines.values()))
        for index, number in enumerate(self.numbers):
            if number.channel:
                found[index] = max(self.specified(number) / TYPICAL_OHM, len(number.sides))
            elif number in TYPICAL:
                found[index] = max(self.specified(number) / TYPICAL[number], 1.0)
        return found

    @property
    def least(self) -> Array:
        """(unknowns) below which none can be: channels, memories and wires are not negative."""
        signed = [not (number.channel or number in TYPICAL) for number in self.numbers]
        return np.where(np.append(signed, [True] * (len(self.start) - len(signed))), -np.inf, 0.0)

    def specified(self, number: LineNumber) -> float:
        """What the scene says of a number, the mean where it lists one for each line."""
        if number.in_scene and number.channel:
            return float(np.mean(self.scene.series_ohm))
        return float(np.mean(np.asarray(attrgetter(number.name)(self.scene if number.in_scene else self.readout))))

    def common(self, unknowns: Array, number: int) -> tuple[float, float]:
        """(c, ∂c/∂q) of a number, in its unit."""
        one, at = self.numbers[number], float(unknowns[number])
        if one.channel or one in TYPICAL:
            scale = TYPICAL_OHM if one.channel else TYPICAL[one]
            return scale * at, scale
        value = self.specified(one) * float(np.exp(at))
        return value, value

    def spread(self, unknowns: Array, number: int) -> float:
        """σ of lines, ohm: of channels a third of worst less typical, of resistors from their tolerance."""
        if self.numbers[number].channel:
            return (WORST_OHM - TYPICAL_OHM) / 3
        return RESISTOR_TOLERANCE / 3**0.5 * self.common(unknowns, number)[0]

    def volt(self, unknowns: Array, cells: Array, reference_off: float = 0.0) -> Array:
        """(rows, columns) at the converter, for cells in ohm and a reference resistor that is off by a fraction."""
        channels: dict[Side, Array] = {side: np.zeros(length) for side, length in self._lengths.items()}
        fields, of_scene = dict[str, Any](), dict[str, float]()
        for index, number in enumerate(self.numbers):
            common, spread = self.common(unknowns, index)[0], self.spread(unknowns, index)
            off = {side: spread * unknowns[part] for (at, side), part in self.lines.items() if at == index}
            if number in TYPICAL:
                of_scene[number.name] = min(common, 0.9) if number == MEMORY else common
            elif number.in_scene:
                for side, ohm in off.items():
                    channels[side] = common / len(number.sides) + ohm
            else:
                each = common + sum(off.values())
                # ln(1 + exp R) is R from some ohm on, never below zero, and always has a slope.
                volts = self.readout.lsb_volt, self.readout.supply_volt
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
    def _lengths(self) -> dict[Side, int]:
        rows, columns = self.scene.panel.shape
        return {"rows": rows, "columns": columns}


def with_numbers(part: Any, numbers: dict[str, Any]) -> Any:
    """A readout, or a part of one, with other numbers by their names; dotted names are those of its parts."""
    for name, value in numbers.items():
        first, _, rest = name.partition(".")
        part = replace(part, **{first: with_numbers(getattr(part, first), {rest: value}) if rest else value})
    return part


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

    def _clipped(self, volt: Array) -> Array:
        """Beyond what noise leaves of the converter's range a reading is a bound: any more is as good."""
        return np.clip(volt, *usable_range(self.circuit.readout))

    def expected(self, unknowns: Array, resistor: tuple[float, int] | None = None, reference: float = 0.0) -> Array:
        """(readings) V, with one resistor larger by a factor exp(STEP), or the reference by 1 + reference."""
        found = []
        for trial in self.trials:
            cells = trial.cells.copy()
            if resistor in trial.resistors:
                cells[trial.resistors[resistor]] *= np.exp(STEP)
            found.append(self._clipped(self.circuit.volt(unknowns, cells, reference)[trial.used]))
        return np.concatenate(found)

    def covariance(self, unknowns: Array, own_lsb: float = 0.0) -> Array:
        """(readings, readings) V² of noise, quantisation, the converter's own error, resistors and the reference."""
        at, names = self.expected(unknowns), dict.fromkeys(name for trial in self.trials for name in trial.resistors)
        moved = [*(self.expected(unknowns, name) for name in names), self.expected(unknowns, reference=STEP)]
        off = self.tolerance / np.sqrt(3) / STEP * (np.stack(moved, axis=1) - at[:, None])
        sigma = np.concatenate([trial.readings.sigma_volt[trial.used] for trial in self.trials])
        own = own_lsb * self.circuit.readout.lsb_volt
        return np.asarray(np.diag(sigma**2 + own**2) + off @ off.T)

    def within(self, unknowns: Array) -> NDArray[np.bool_]:
        """(readings) that are values: neither they nor what is expected of them lies at a rail."""
        readout = self.circuit.readout
        inside = [within_rails(readout, volt) for volt in (self.measured, self.expected(unknowns))]
        return np.asarray(inside[0] | inside[1])

    def places(self) -> Iterator[tuple[str, int, int]]:
        """(readings) recording, row and column of each."""
        for trial in self.trials:
            yield from ((trial.name, int(row), int(column)) for row, column in np.argwhere(trial.used))


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
    for settled in (1.0, 1e-4):  # of ½ χ²: the last one is off by a hundredth of σ
        root = np.linalg.cholesky(problem.covariance(unknowns))
        squares = partial(_squares, problem, root)
        # Good calibrations end after some 5 evaluations from the scene's numbers, 10 from those ten times too large.
        found = LevenbergMarquardt(25, settled).minimum(squares, unknowns, (circuit.least, np.inf))
        unknowns = found.position
    # The converter's own error: ATmega2560, integral non-linearity 0.5 LSB, its data sheet.
    rest, whole = problem.measured - problem.expected(unknowns), problem.covariance(unknowns, 0.5)
    left = solve_triangular(np.linalg.cholesky(whole), rest, lower=True)
    values, commons = int(problem.within(unknowns).sum()), len(circuit.numbers)
    chi_square = float(left @ left + unknowns[commons:] @ unknowns[commons:])
    sigma = np.sqrt(np.diag(whole))
    covariance = _inverse(found.at.jacobian)
    return CircuitFit(problem, unknowns, covariance, chi_square, values - commons, rest, sigma, values)


def _squares(problem: Problem, root: Array, unknowns: Array) -> SumOfSquares:
    """(y − V(θ))ᵀ C⁻¹ (y − V(θ)) + Σ e² about θ, slopes by forward differences; root : Cholesky factor of C."""

    def residual(at: Array) -> Array:
        left = solve_triangular(root, problem.measured - problem.expected(at), lower=True)
        return np.concatenate([left, at[len(problem.circuit.numbers) :]])

    here, steps = residual(unknowns), STEP * np.maximum(1.0, np.abs(unknowns))
    slopes = [(residual(unknowns + step) - here) / step.sum() for step in np.diag(steps)]
    return SumOfSquares(here, np.stack(slopes, axis=1))


def _inverse(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹, nearly without end along what J does not see."""
    _, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    inverse = right / np.maximum(singular, np.sqrt(np.finfo(float).eps) * singular[0])[:, None]
    return np.asarray(inverse.T @ inverse)
