"""What a fit says of one number: its mean over the lines, what single lines add, uncertainties."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.readouts.lines import LineNumber, Side
from lampest.recording.calibration.circuit import LineUnknowns
from lampest.recording.calibration.fit import CircuitFit

MOST_SIGMA_OF_LINES = 5.0  # by which one of 32 lines is off by chance once in 50,000 calibrations
ROUNDING_OHM = 1e-3  # as scenes are written


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
