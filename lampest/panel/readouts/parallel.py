"""Dividers in parallel: several multiplexers of columns share the driven row.

Each multiplexer has its own reference resistor.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

from lampest.panel.circuit import Terminations
from lampest.panel.lines import Groups, PerLine, per_line, with_channels
from lampest.panel.panel import Array
from lampest.panel.readouts.divider import Divider
from lampest.panel.readouts.readout import Surroundings


@dataclass(frozen=True, kw_only=True)
class ParallelDividers(Divider):
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
    reference_ohm: float = 1000.0
    input_ohm: float | None = None
    groups: Groups = field()  # needed, although other dividers have none
    row_ohm: PerLine = 0.0
    column_ohm: PerLine = 0.0

    def description(self) -> str:
        return (
            f"two-point, {len(self.groups)} columns read in parallel, "
            f"{self.converter_description()}"
        )

    def terminations(self, driven: int, sensed: int) -> Terminations:
        """Return the ends of `Divider`, behind the channels of their lines."""
        ends = super().terminations(driven, sensed)
        column = per_line("series_resistance_ohm.columns", self.column_ohm, sensed)
        reference = ends.sensing.ohm.diagonal()
        return replace(
            ends,
            driving=ends.driving.behind(
                per_line("series_resistance_ohm.rows", self.row_ohm, driven)
            ),
            sensing=ends.sensing.behind(column),
            gain=reference / (reference + column),
        )

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
        more = row_ohm[:, None] + column_ohm
        return self.to_recorded(actual.exact_reading(cell_resistance, scene.wiring) + more, scene)

    def shared_errors(
        self, cells: Array, measured: Array, scene: Surroundings, reference: float, channel: float
    ) -> Array:
        """Return −(R + R_series)·reference, then secants of each channel.

        See `Readout.shared_errors`.
        """
        errors = super().shared_errors(cells, measured, scene, 0.0, channel)
        errors[0] = -(measured + scene.series_ohm) * reference
        return errors
