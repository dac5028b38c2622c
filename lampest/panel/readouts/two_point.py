"""Two-point readout: one row and one column are selected, all other lines float.

A divider with a reference resistor measures the resistance.
"""

from dataclasses import dataclass, fields
from math import inf
from typing import Literal

import numpy as np

from lampest.panel.circuit import Ends, Terminations, scanned
from lampest.panel.lines import Groups, PerLine, per_line
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Modules, Numbers
from lampest.panel.readouts.converter import converter_in_words, mean_sigma, relative_step
from lampest.panel.readouts.floating import convex_start, grounding, uniform_factor
from lampest.panel.readouts.readout import Readout, Surroundings
from lampest.panel.readouts.starts import SHORT_SHARE
from lampest.panel.readouts.wiring import Wiring

SIGNAL_NAME = "two-point resistance, divider equation"


def divider_in_words(readout: "TwoPointReadout | ParallelDividers") -> str:
    """Return the circuit of dividers and its numbers with their units, in words."""
    converter = "" if readout.input_ohm is None else f", converter input {readout.input_ohm:g} ohm"
    if readout.groups is not None:
        converter += f", {len(readout.groups)} columns read in parallel"
    return (
        f"two-point, {readout.supply_volt:g} V, reference {readout.reference_ohm:g} ohm, "
        f"measured across the {readout.measured_across}{converter}, {converter_in_words(readout)}"
    )


def divider_resistance(readout: "TwoPointReadout | ParallelDividers", volt: Array) -> Array:
    """Return R of voltages V at the converter: 0 or infinite at the rails.

    R = (Vcc − V)/V·Rref across the reference, R = V/(Vcc − V)·Rref across the sensor.
    """
    volt = np.asarray(volt, dtype=float)
    ends = readout.supply_volt - volt, volt
    upper, lower = ends if readout.measured_across == "reference" else ends[::-1]
    with np.errstate(divide="ignore"):
        return upper / lower * readout.reference_ohm


def divider_volt(readout: "TwoPointReadout | ParallelDividers", recorded: Array) -> Array:
    """Return V across the reference, or across the sensor; any shape.

    V = Vcc·Rref/(R + Rref) across the reference, V = Vcc·R/(R + Rref) across the sensor.
    """
    with np.errstate(divide="ignore"):
        ratio = np.asarray(recorded, dtype=float) / readout.reference_ohm
        return readout.supply_volt / (
            1 + (ratio if readout.measured_across == "reference" else 1 / ratio)
        )


def divider_sigma(readout: "TwoPointReadout | ParallelDividers", recorded: Array) -> Array:
    """Return σ_R = (R + Rref)²/Rref · σ_V/Vcc (delta method); any shape, ohm.

    R includes the series resistance.
    """
    total = np.asarray(recorded, dtype=float) + readout.reference_ohm
    sigma = mean_sigma(readout) * relative_step(readout, divider_volt(readout, recorded))
    return total**2 * (sigma / (readout.reference_ohm * readout.supply_volt))


def divider_recorded(
    readout: "TwoPointReadout | ParallelDividers", reading: Array, scene: Surroundings
) -> Array:
    """Return R + R_series as recorded, (…, rows, columns) ohm.

    The converter's input resistance distorts the value.
    """
    total = reading + scene.series_ohm
    if readout.input_ohm is None:
        return total
    if readout.measured_across == "sensor":
        with np.errstate(divide="ignore"):
            return 1 / (1 / total + 1 / readout.input_ohm)
    return total * (1 + readout.reference_ohm / readout.input_ohm)


def divider_reading(
    readout: "TwoPointReadout | ParallelDividers", recorded: Array, scene: Surroundings
) -> Array:
    """Return the resistance R of the panel alone, (…, rows, columns) ohm."""
    return _without_input(readout, recorded) - scene.series_ohm


def divider_reading_sigma(
    readout: "TwoPointReadout | ParallelDividers", recorded: Array, sigma: Array
) -> Array:
    """Return σ of the readings: σ of the recorded values times ∂R/∂(recorded)."""
    if readout.input_ohm is None:
        return sigma
    slope = _without_input(readout, recorded) / recorded
    return sigma * slope ** (2 if readout.measured_across == "sensor" else 1)


def _without_input(readout: "TwoPointReadout | ParallelDividers", recorded: Array) -> Array:
    """Return the resistance of lines and panel without the converter's input resistance.

    Across the sensor, a recorded value above the input resistance becomes nearly open.
    """
    if readout.input_ohm is None:
        return recorded
    if readout.measured_across == "sensor":
        return 1 / np.maximum(1 / recorded - 1 / readout.input_ohm, SHORT_SHARE / readout.input_ohm)
    return recorded / (1 + readout.reference_ohm / readout.input_ohm)


def divider_ends(
    readout: "TwoPointReadout | ParallelDividers", rows: Array, columns: Array
) -> Terminations:
    """Return the ends: the supply at the driven row, the reference at the columns read.

    All other lines float. The lines have channels, (rows,) and (columns,) ohm.
    """
    # The converter's input is parallel to the reference resistor
    siemens = 1 / readout.reference_ohm + 1 / (readout.input_ohm or inf)
    reference = np.full(len(columns), 1 / siemens)
    return Terminations(
        "rows",
        scanned(Ends.of(rows, readout.supply_volt), Ends.floating(len(rows))),
        scanned(Ends.of(reference + columns), Ends.floating(len(columns)), readout.groups),
        gain=reference / (reference + columns),
        as_resistance=True,
    )


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

    unit = "ohm"
    signal_name = SIGNAL_NAME
    of_driven = ()
    of_sensed = ("reference_ohm",)
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
        numbers = {key.name: getattr(self, key.name) for key in fields(self)}
        rows, columns = scene.series_lines
        return ParallelDividers(**numbers, row_ohm=tuple(rows), column_ohm=tuple(columns))

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of dividers; see `divider_ends`."""
        return divider_ends(self, np.zeros(driven), np.zeros(sensed))

    description = divider_in_words
    recorded_from_volt = divider_resistance
    volt_from_recorded = divider_volt
    sigma = divider_sigma
    to_recorded = divider_recorded
    from_recorded = divider_reading
    sigma_of_reading = divider_reading_sigma


@dataclass(frozen=True, kw_only=True)
class ParallelDividers(Readout):
    """Circuit of a two-point readout with several groups of columns in its scene.

    A reading is the resistance R = (Vcc/V − 1)·Rref that the divider equation gives, less the
    channels. The equation is that of circuits with driven lines, in ohm. As the columns of
    an address share the driven row's channel and its neighbours' cells, R may be larger or smaller
    than the cell.

    Attributes
    ----------
    row_ohm, column_ohm : tuple of float
        Resistance of the channels in ohm.
    reference_ohm, measured_across, input_ohm, groups, supply_volt, adc_bits, readings, noise_lsb
        See `TwoPointReadout`.
    """

    unit = "ohm"
    signal_name = SIGNAL_NAME
    of_driven = ("row_ohm",)
    of_sensed = ("reference_ohm", "column_ohm")
    may_be_zero = ("row_ohm", "column_ohm")
    channels = ("row_ohm", "column_ohm")
    kind: Literal["two_point"] = "two_point"
    reference_ohm: float
    measured_across: Literal["reference", "sensor"]
    input_ohm: float | None = None
    groups: Groups | None = None
    row_ohm: PerLine
    column_ohm: PerLine

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of dividers behind the channels of their lines; see `divider_ends`."""
        row = per_line("series_resistance_ohm.rows", self.row_ohm, driven)
        column = per_line("series_resistance_ohm.columns", self.column_ohm, sensed)
        return divider_ends(self, row, column)

    description = divider_in_words
    recorded_from_volt = divider_resistance
    volt_from_recorded = divider_volt
    sigma = divider_sigma
    to_recorded = divider_recorded
    from_recorded = divider_reading
    sigma_of_reading = divider_reading_sigma


@dataclass(frozen=True, kw_only=True)
class ModulesReadout(Readout):
    """Two-point readings R_jk of each module alone, as readings of the whole image.

    Attributes
    ----------
    layout : Modules
        Arrangement of the modules.
    """

    unit = "ohm"
    kind: Literal["two_point"] = "two_point"
    layout: Modules

    def description(self) -> str:
        return f"two-point resistances of {self.layout.count} modules"

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of two-point resistances."""
        return TwoPointReadout().terminations(driven, sensed)

    def ties(self, measured: Array, parts: Numbers | None = None) -> Array:
        return grounding(self.layout.split(measured))

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        from lampest.panel.joined_network import JoinedNetwork  # for modules alone

        modules = SolvedNetwork.floating(1 / self.layout.split(cell_resistance), ties)
        return JoinedNetwork.of(cell_resistance, [modules], self.layout)

    def uniform_start(self, measured: Array) -> Array:
        """Return the uniform start of each module; see `uniform_factor`."""
        return measured / uniform_factor(self.layout.each.rows, self.layout.each.columns)

    def start(
        self, measured: Array, limits: tuple[Array, Array], near: Array | None = None
    ) -> Array:
        """Return cells that reproduce attainable readings, module by module; see `convex_start`."""
        nears = [None] * self.layout.count if near is None else self.layout.split(near)
        lower, upper = map(self.layout.split, limits)
        modules = zip(
            self.layout.split(measured), zip(lower, upper, strict=True), nears, strict=True
        )
        return self.layout.joined(np.stack([convex_start(*module) for module in modules]))
