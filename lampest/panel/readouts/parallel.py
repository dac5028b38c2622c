"""Dividers in parallel: several multiplexers of columns share the driven row.

Each multiplexer has its own reference resistor.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.divider import Divider
from lampest.panel.readouts.driven_readout import DrivenReadout
from lampest.panel.readouts.lines import Groups, PerLine, parallel, per_line, with_channels
from lampest.panel.readouts.readout import Address, FreeTest, Surroundings
from lampest.panel.readouts.wiring import Wiring


@dataclass(frozen=True, kw_only=True)
class ParallelDividers(Divider):
    """Circuit of a two-point readout with several groups of columns in its scene.

    A reading is the resistance R = (Vcc/V − 1)·Rref that the divider equation gives, less the
    channels. The equation is that of `DrivenReadout` with floating lines, in ohm. As the columns of
    an address share the driven row's channel and its neighbours' cells, R may be larger or smaller
    than the cell.

    Attributes
    ----------
    columns : tuple of tuple of int
        Groups of columns.
    row_ohm, column_ohm : PerLine
        Resistance of the channels in ohm.
    reference_ohm, input_ohm, supply_volt, adc_bits, readings, noise_lsb
        See `TwoPointReadout`.
    """

    columns: Groups
    reference_ohm: float = 1000.0
    input_ohm: float | None = None
    row_ohm: PerLine = 0.0
    column_ohm: PerLine = 0.0

    def description(self) -> str:
        return (
            f"two-point, {len(self.columns)} columns read in parallel, "
            f"{self.converter_description()}"
        )

    def _total(self, volt: Any) -> Any:
        """Return the resistance (Vcc/V − 1)·Rref of the whole loop, ohm.

        V is the voltage at the converter.
        """
        return (self.supply_volt / volt - 1) * float(
            parallel(np.array(self.reference_ohm), self.input_ohm)
        )

    def _volt(self, reading: Array) -> Array:
        """Return the voltage of a reading R (…, rows, columns) ohm."""
        reference = float(parallel(np.array(self.reference_ohm), self.input_ohm))
        return np.asarray(
            self.supply_volt * reference / (reading + self._channels(reading.shape) + reference)
        )

    def _channels(self, shape: tuple[int, ...]) -> Array:
        """Return the channels of every reading, (rows, columns) ohm."""
        row = per_line("series_resistance_ohm.rows", self.row_ohm, shape[-2])
        return np.asarray(
            row[:, None] + per_line("series_resistance_ohm.columns", self.column_ohm, shape[-1])
        )

    def _of_reading(self, reading: Array, sigma: Array) -> tuple[Array, Array]:
        """Return voltages and their σ of readings and their σ, (…, rows, columns) each."""
        volt = self._volt(reading)
        slope = volt**2 / (
            self.supply_volt * float(parallel(np.array(self.reference_ohm), self.input_ohm))
        )
        return volt, np.where(np.isfinite(sigma), sigma * slope, np.inf)

    def addresses(self, measured: Array) -> tuple[Address, ...]:
        return driven_of(self).addresses(self._volt(measured))

    def ties(self, measured: Array) -> Array:
        return driven_of(self).ties(self._volt(measured))

    def ties_of_parts(self, measured: Array, parts: NDArray[np.intp] | None) -> Array:
        return driven_of(self).ties_of_parts(self._volt(measured), parts)

    def reading(self, row: Any, column: Any, mutual: Any) -> Any:
        """Return R = (Vcc/V − 1)·Rref less the channels, V of `DrivenCircuit.reading`."""
        return self._total(driven_of(self).reading(row, column, mutual)) - self._channels(
            mutual.shape
        )

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        """Return the solved network for ties (addresses, lines)."""
        networks = [
            self.solved_network(cell_resistance, of_address, wiring)
            for of_address in np.atleast_2d(ties)
        ]
        return JoinedNetwork.addressed(
            networks, [address.read for address in self.addresses(cell_resistance)]
        )

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return R of cells (rows, columns) or (frames, rows, columns) ohm."""
        with np.errstate(divide="ignore"):
            total = self._total(driven_of(self).exact_reading(cell_resistance, wiring))
        return np.asarray(total - self._channels(cell_resistance.shape))

    def uniform_start(self, measured: Array) -> Array:
        return driven_of(self).uniform_start(self._volt(measured))

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce the readings; see `DrivenCircuit.start`."""
        return driven_of(self).start(self._volt(measured), upper, near)

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """Return the lower bounds of `DrivenCircuit.least_cells`, (…, rows, columns) ohm."""
        if sigma is None:
            return driven_of(self).least_cells(self._volt(measured), None)
        return driven_of(self).least_cells(*self._of_reading(measured, sigma))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        return driven_of(self).free_tests(*self._of_reading(measured, sigma))

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return R + R_series with additional resistance of the channels.

        Shape (frames, rows, columns), in ohm.
        """
        actual = replace(
            self,
            row_ohm=with_channels("series_resistance_ohm.rows", self.row_ohm, row_ohm),
            column_ohm=with_channels("series_resistance_ohm.columns", self.column_ohm, column_ohm),
        )
        total = actual.exact_reading(cell_resistance, scene.wiring) + actual._channels(
            cell_resistance.shape
        )
        return self.to_recorded(total - scene.series_ohm, scene)

    def shared_errors(
        self, cells: Array, measured: Array, scene: Surroundings, reference: float, channel: float
    ) -> Array:
        """Return −(R + R_series)·reference, then secants of each channel.

        See `Readout.shared_errors`.
        """
        errors = super().shared_errors(cells, measured, scene, 0.0, channel)
        errors[0] = -(measured + scene.series_ohm) * reference
        return errors


@lru_cache(maxsize=64)
def driven_of(circuit: ParallelDividers) -> DrivenReadout:
    """Return the same circuit with readings in volt."""
    return DrivenReadout(
        drive_ohm=circuit.row_ohm,
        idle_ohm=inf,
        load_ohm=circuit.reference_ohm,
        sense_ohm=circuit.column_ohm,
        groups=circuit.columns,
        input_ohm=circuit.input_ohm,
        supply_volt=circuit.supply_volt,
        adc_bits=circuit.adc_bits,
    )
