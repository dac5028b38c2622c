"""Numbers of the electronics that known resistors determine, and their keys in a scene.

The numbers are resistances of channels and reference resistors, the memory of the converter, wires
and a diode's drop. For each of them the module has plausible values, the estimate as a sentence,
and the scene with the estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from lampest.apps.calibration.calibration import DIGITS, FRACTION_DIGITS
from lampest.files.levels import SIGNIFICANT
from lampest.panel.effects.converter_memory import KeptShare
from lampest.panel.effects.wire import WirePerCell
from lampest.panel.lines import LineNumber, SeriesPerLine, Side
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

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
