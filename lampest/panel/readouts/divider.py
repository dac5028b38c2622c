"""Readings of a divider with a reference resistor, as resistances.

The base class has the equation and the keys that all such circuits share.
"""

from math import inf
from typing import ClassVar, Literal

import numpy as np

from lampest.panel.circuit import Ends, Terminations, scanned
from lampest.panel.lines import Groups, LineNumber, check_resistors, parallel
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout, Surroundings
from lampest.panel.readouts.starts import SHORT_SHARE


class Divider(Readout):
    """Base of readouts whose recorded value is the resistance of the divider equation.

    The value is as if the converter took no current, and includes the scene's series resistance.
    Kinds are dataclasses that declare the keys of `TwoPointReadout` in the files' order. Raises
    ValueError if a number is out of range. Source: paper, equation (1) (across the sensor) and
    section V.B (across the reference).
    """

    unit: ClassVar[str] = "ohm"
    signal: ClassVar[str] = "resistance"
    signal_name: ClassVar[str] = "two-point resistance, divider equation"
    in_series: ClassVar[bool] = True
    of_sensed: ClassVar[tuple[str, ...]] = ("reference_ohm",)
    series_name: ClassVar[str] = "series_resistance_ohm"
    reference_ohm: float = 1000.0
    measured_across: Literal["reference", "sensor"] = "reference"
    input_ohm: float | None = None
    groups: Groups | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_resistors("reference_ohm", self.reference_ohm)
        if self.input_ohm is not None:
            check_resistors("input_ohm", self.input_ohm, most=inf)

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends: the supply at the driven row, the reference at the columns read.

        All other lines float.
        """
        floating = Ends.floating(driven), Ends.floating(sensed)
        supply = Ends.of(np.zeros(driven), self.supply_volt)
        reference = parallel(np.full(sensed, self.reference_ohm), self.input_ohm)
        return Terminations(
            "rows",
            scanned(supply, floating[0]),
            scanned(Ends.of(reference), floating[1], self.groups),
            gain=np.ones(sensed),
            as_resistance=True,
        )

    def from_recorded(self, recorded: Array, scene: Surroundings) -> Array:
        return np.asarray(self._between_lines(recorded) - scene.series_ohm)

    def to_recorded(self, reading: Array, scene: Surroundings) -> Array:
        """Return R + R_series as recorded, (…, rows, columns) ohm.

        The converter's input resistance distorts the value.
        """
        total = np.asarray(reading + scene.series_ohm)
        if self.input_ohm is None:
            return total
        if self.measured_across == "sensor":
            with np.errstate(divide="ignore"):
                return np.asarray(1 / (1 / total + 1 / self.input_ohm))
        return np.asarray(total * (1 + self.reference_ohm / self.input_ohm))

    def _between_lines(self, recorded: Array) -> Array:
        """Return the resistance of lines and panel without the converter's input resistance.

        Across the sensor, a recorded value above the input resistance becomes nearly open.
        """
        if self.input_ohm is None:
            return recorded
        if self.measured_across == "sensor":
            return np.asarray(
                1 / np.maximum(1 / recorded - 1 / self.input_ohm, SHORT_SHARE / self.input_ohm)
            )
        return np.asarray(recorded / (1 + self.reference_ohm / self.input_ohm))

    def sigma_of_reading(self, recorded: Array, sigma: Array) -> Array:
        """Return σ of the readings: σ of the recorded values times ∂R/∂(recorded)."""
        if self.input_ohm is None:
            return sigma
        slope = self._between_lines(recorded) / recorded
        return np.asarray(sigma * slope ** (2 if self.measured_across == "sensor" else 1))

    def line_numbers(self) -> tuple[LineNumber, ...]:
        return (
            LineNumber("series_resistance_ohm", ("rows", "columns"), channel=True, in_scene=True),
        )

    def recorded_from_volt(self, volt: Array) -> Array:
        """Return R of voltages V at the converter: 0 or infinite at the rails.

        R = (Vcc − V)/V·Rref across the reference, R = V/(Vcc − V)·Rref across the sensor.
        """
        volt = np.asarray(volt, dtype=float)
        ends = self.supply_volt - volt, volt
        upper, lower = ends if self.measured_across == "reference" else ends[::-1]
        with np.errstate(divide="ignore"):
            return np.asarray(upper / lower * self.reference_ohm)

    def volt_from_recorded(self, recorded: Array) -> Array:
        """Return V across the reference, or across the sensor; any shape.

        V = Vcc·Rref/(R + Rref) across the reference, V = Vcc·R/(R + Rref) across the sensor.
        """
        with np.errstate(divide="ignore"):
            ratio = np.asarray(recorded, dtype=float) / self.reference_ohm
            return np.asarray(
                self.supply_volt
                / (1 + (ratio if self.measured_across == "reference" else 1 / ratio))
            )

    def sigma(self, recorded: Array) -> Array:
        """Return σ_R = (R + Rref)²/Rref · σ_V/Vcc (delta method); any shape, ohm.

        R includes the series resistance.
        """
        total = np.asarray(recorded, dtype=float) + self.reference_ohm
        sigma = self.sigma_volt() * self.relative_step(self.volt_from_recorded(recorded))
        return np.asarray(total**2 * (sigma / (self.reference_ohm * self.supply_volt)))
