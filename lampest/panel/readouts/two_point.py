"""Two-point readout: one row and one column are selected, all other lines float.

A divider with a reference resistor measures the resistance.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.panel.circuit import Ends, Terminations, scanned
from lampest.panel.lines import Groups, PerLine, parallel, per_line
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, EachModule, Modules
from lampest.panel.readouts.converter import converter_in_words, mean_sigma, relative_step
from lampest.panel.readouts.floating import convex_start, grounding, uniform_factor
from lampest.panel.readouts.readout import Readout, Surroundings
from lampest.panel.readouts.starts import SHORT_SHARE
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, kw_only=True)
class TwoPointReadout(Readout):
    """Two-point readout R_jk = Z_jj + Z_kk − 2 Z_jk, all other lines floating.

    A divider with a reference resistor measures R. The recorded value is that of the divider
    equation, as if the converter took no current, and includes the scene's series resistance. With
    several groups of columns, the columns of an address load the driven row together; see
    `ParallelDividers`. Raises ValueError if a number is out of range. Source: paper, equation (1)
    (across the sensor) and section V.B (across the reference).

    Attributes
    ----------
    supply_volt : float
        Supply of the divider and reference of the converter in volt.
    reference_ohm : float
        Reference resistor in ohm.
    measured_across : 'reference' or 'sensor'
        'reference': R = (Vcc − V)/V · Rref; 'sensor': R = V/(Vcc − V) · Rref.
    input_ohm : float or None
        Input resistance of the converter, parallel to the measured resistor; None: negligible.
    groups : tuple of tuple of int, or None
        Columns behind one multiplexer each, in the order of its addresses, with a reference
        resistor each. At every address one column of each group is read. None: one multiplexer has
        all columns.
    adc_bits, readings, noise_lsb
        See `Readout`.

    >>> lampest.TwoPointReadout(adc_bits=12).unit
    'ohm'
    """

    unit: ClassVar[str] = "ohm"
    signal: ClassVar[str] = "resistance"
    signal_name: ClassVar[str] = "two-point resistance, divider equation"
    of_driven: ClassVar[tuple[str, ...]] = ()
    of_sensed: ClassVar[tuple[str, ...]] = ("reference_ohm",)
    kind: Literal["two_point"] = "two_point"
    reference_ohm: float = 1000.0
    measured_across: Literal["reference", "sensor"] = "reference"
    input_ohm: float | None = None
    groups: Groups | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.groups is not None and self.measured_across == "sensor":
            raise ValueError(
                "groups have a resistor each at their columns: measured_across must be reference"
            )

    def in_scene(self, scene: Surroundings) -> Readout:
        """Return the circuit that gives the readings.

        With several groups of columns these are dividers in parallel, which share the driven row.
        """
        if self.groups is None or len(self.groups) < 2:
            return self
        numbers: dict[str, Any] = {key.name: getattr(self, key.name) for key in fields(self)}
        rows, columns = scene.series_lines
        return ParallelDividers(**numbers, row_ohm=tuple(rows), column_ohm=tuple(columns))

    def description(self) -> str:
        converter = "" if self.input_ohm is None else f", converter input {self.input_ohm:g} ohm"
        converter += "" if self.groups is None else f", {len(self.groups)} columns read in parallel"
        return (
            f"two-point, {self.supply_volt:g} V, reference {self.reference_ohm:g} ohm, "
            f"measured across the {self.measured_across}{converter}, {converter_in_words(self)}"
        )

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends: the supply at the driven row, the reference at the columns read.

        All other lines float.
        """
        supply = Ends.of(np.zeros(driven), self.supply_volt)
        reference = Ends.of(parallel(np.full(sensed, self.reference_ohm), self.input_ohm))
        return Terminations(
            "rows",
            scanned(supply, Ends.floating(driven)),
            scanned(reference, Ends.floating(sensed), self.groups),
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
        sigma = mean_sigma(self) * relative_step(self, self.volt_from_recorded(recorded))
        return np.asarray(total**2 * (sigma / (self.reference_ohm * self.supply_volt)))


@dataclass(frozen=True, kw_only=True)
class ParallelDividers(TwoPointReadout):
    """Circuit of a two-point readout with several groups of columns in its scene.

    A reading is the resistance R = (Vcc/V − 1)·Rref that the divider equation gives, less the
    channels. The equation is that of circuits with driven lines, in ohm. As the columns of
    an address share the driven row's channel and its neighbours' cells, R may be larger or smaller
    than the cell.

    Attributes
    ----------
    row_ohm, column_ohm : PerLine
        Resistance of the channels in ohm.
    reference_ohm, input_ohm, groups, supply_volt, adc_bits, readings, noise_lsb
        See `TwoPointReadout`.
    """

    of_driven: ClassVar[tuple[str, ...]] = ("row_ohm",)
    of_sensed: ClassVar[tuple[str, ...]] = ("reference_ohm", "column_ohm")
    may_be_zero: ClassVar[tuple[str, ...]] = ("row_ohm", "column_ohm")
    channels: ClassVar[tuple[str, str]] = ("row_ohm", "column_ohm")
    row_ohm: PerLine = 0.0
    column_ohm: PerLine = 0.0

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of a two-point readout, behind the channels of their lines."""
        ends = super().terminations(driven, sensed)
        row = per_line("series_resistance_ohm.rows", self.row_ohm, driven)
        column = per_line("series_resistance_ohm.columns", self.column_ohm, sensed)
        reference = ends.sensing.ohm.diagonal()
        return replace(
            ends,
            driving=ends.driving.behind(row),
            sensing=ends.sensing.behind(column),
            gain=reference / (reference + column),
        )


@dataclass(frozen=True, kw_only=True)
class ModulesReadout(TwoPointReadout):
    """Two-point readings R_jk of each module alone, as readings of the whole image.

    Attributes
    ----------
    layout : Modules
        Arrangement of the modules.
    """

    layout: Modules = Modules(1, 1, EachModule(1, 1))

    def ties(self, measured: Array, parts: NDArray[np.intp] | None = None) -> Array:
        return grounding(self.layout.split(measured))

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        from lampest.panel.joined_network import JoinedNetwork  # for modules alone

        modules = SolvedNetwork.floating(1 / self.layout.split(cell_resistance), ties)
        return JoinedNetwork.of(cell_resistance, [modules], self.layout)

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of each module; see `TwoPointReadout.uniform_start`."""
        return np.asarray(
            measured / uniform_factor(self.layout.each.rows, self.layout.each.columns)
        )

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce attainable readings, module by module; see `convex_start`."""
        nears = [None] * self.layout.count if near is None else self.layout.split(near)
        modules = zip(self.layout.split(measured), self.layout.split(upper), nears, strict=True)
        return np.asarray(
            self.layout.joined(np.stack([convex_start(*module) for module in modules]))
        )
