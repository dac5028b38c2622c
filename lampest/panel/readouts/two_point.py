"""Two-point readout: one row and one column are selected, all other lines float.

A divider measures the resistance.
"""

from dataclasses import dataclass, fields
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.panel.law import TWO_POINT, Law
from lampest.panel.lines import Groups, check_apart, check_groups
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, EachModule, Modules
from lampest.panel.readouts.divider import Divider
from lampest.panel.readouts.floating import (
    convex_start,
    grounding,
    two_point_resistance,
    uniform_factor,
)
from lampest.panel.readouts.inequalities import FreeTest
from lampest.panel.readouts.readout import Readout, Surroundings
from lampest.panel.readouts.wiring import Wiring

# Keys of two_point that dividers in parallel do not share.
OWN = ("kind", "measured_across")


@dataclass(frozen=True, kw_only=True)
class TwoPointReadout(Divider):
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
        See `Converter`.

    >>> lampest.TwoPointReadout(adc_bits=12).unit
    'ohm'
    """

    homogeneous: ClassVar[bool] = True
    unique: ClassVar[bool] = True
    kind: Literal["two_point"] = "two_point"
    reference_ohm: float = 1000.0
    measured_across: Literal["reference", "sensor"] = "reference"
    input_ohm: float | None = None
    groups: Groups | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.groups is None:
            return
        check_apart(self.groups)
        if self.measured_across == "sensor":
            raise ValueError(
                "groups have a resistor each at their columns: measured_across must be reference"
            )

    def check(self, scene: Surroundings) -> None:
        """Raise ValueError as `Readout.check`, or if groups do not list every column once."""
        super().check(scene)
        check_groups(self.groups, "columns", scene.panel.shape[1])

    def in_scene(self, scene: Surroundings) -> Readout:
        """Return the circuit that gives the readings.

        With several groups of columns these are dividers in parallel, which share the driven row.
        """
        if self.groups is None or len(self.groups) < 2:
            return self
        from lampest.panel.readouts.parallel import ParallelDividers  # for groups alone

        numbers = {
            field.name: getattr(self, field.name) for field in fields(self) if field.name not in OWN
        }
        rows, columns = scene.series_lines
        return ParallelDividers(**numbers, row_ohm=tuple(rows), column_ohm=tuple(columns))

    def description(self) -> str:
        converter = "" if self.input_ohm is None else f", converter input {self.input_ohm:g} ohm"
        converter += "" if self.groups is None else f", {len(self.groups)} columns read in parallel"
        return (
            f"two-point, {self.supply_volt:g} V, reference {self.reference_ohm:g} ohm, "
            f"measured across the {self.measured_across}{converter}, {self.converter_description()}"
        )

    def ties(self, measured: Array, parts: NDArray[np.intp] | None = None) -> Array:
        return grounding(measured, parts)

    @property
    def law(self) -> Law:
        return TWO_POINT

    def network(self, cell_resistance: Array, ties: Array, wiring: Wiring | None = None) -> Network:
        if wiring is not None:
            return super().network(cell_resistance, ties, wiring)
        return SolvedNetwork.tied(cell_resistance, ties, TWO_POINT)

    def exact_reading(self, cell_resistance: Array, wiring: Wiring | None = None) -> Array:
        """Return R = f(r); without wiring with at least ten correct digits for any contrast."""
        if wiring is not None:
            return super().exact_reading(cell_resistance, wiring)
        return two_point_resistance(cell_resistance)

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the test of R_jk ≤ R_jq + R_pq + R_pk; see `four_point_excess`."""
        law = "R_jk <= R_jq + R_pq + R_pk of any two rows and columns"
        single = four_point_excess(measured, sigma)
        return (FreeTest(law, single.max(axis=(1, 2)), measured[0].size ** 2, single),)

    def largest_possible(self, measured: Array) -> Array:
        """Return min_pq (R_jq + R_pq + R_pk); see `Readout.largest_possible`."""
        largest = np.empty(measured.shape)
        for row in range(measured.shape[-2]):
            between = (measured[..., [row], :] + measured).min(axis=-1)  # to each row p
            largest[..., row, :] = (between[..., None] + measured).min(axis=-2)
        return largest

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return R + R_series plus the additional resistance of both channels.

        Shape (frames, rows, columns), in ohm.
        """
        total = self.to_recorded(self.exact_reading(cell_resistance, scene.wiring), scene)
        return np.asarray(total + (row_ohm[:, None] + column_ohm[None, :]))

    def shared_errors(
        self, cells: Array, measured: Array, scene: Surroundings, reference: float, channel: float
    ) -> Array:
        """Return −(R + R_series)·reference, then `channel` for each line.

        See `Readout.shared_errors`.
        """
        rows, columns = measured.shape[-2:]
        lines = np.zeros((rows + columns if channel else 0, *measured.shape))
        if channel:
            np.einsum("j...jk->j...k", lines[:rows])[...] = channel
            np.einsum("k...jk->k...j", lines[rows:])[...] = channel
        return np.concatenate([-((measured + scene.series_ohm) * reference)[None], lines])


def four_point_excess(resistance: Array, sigma: Array) -> Array:
    """Return max_pq (R_jk − R_jq − R_pq − R_pk)/σ for every reading, (frames, rows, columns).

    Effective resistance is a metric (Klein & Randić, J. Math. Chem. 12, 1993): no path from row j
    over column q and row p to column k is shorter than R_jk. σ is that of all four readings
    together. The shortest path over any q from row j to row p is computed first, then the shortest
    over any p: (rows² · columns) sums. The result is −∞ for readings with infinite σ.

    Parameters
    ----------
    resistance : array, shape (frames, rows, columns)
        Readings R in ohm.
    sigma : array, same shape
        Standard deviations; infinite for readings that are excluded.
    """
    value = np.where(np.isfinite(sigma), resistance, np.inf)
    variance = np.where(np.isfinite(sigma), sigma, 0.0) ** 2
    excess = np.full(value.shape, -np.inf)
    for row in range(value.shape[1]):
        # Row to row p: min_q (R_jq + R_pq), and its variance
        over = value[:, [row]] + value
        middle = over.argmin(axis=2)[..., None]
        between = np.take_along_axis(over, middle, axis=2)
        spread = np.take_along_axis(variance[:, [row]] + variance, middle, axis=2)
        # Row to column k: min_p (min_q (R_jq + R_pq) + R_pk), and the variance of all four readings
        way = between + value
        last = way.argmin(axis=1)[:, None]
        noise = variance[:, row] + np.take_along_axis(spread + variance, last, axis=1)[:, 0]
        way = np.take_along_axis(way, last, axis=1)[:, 0]
        counted = np.isfinite(value[:, row]) & np.isfinite(way) & (noise > 0)
        excess[:, row][counted] = (value[:, row][counted] - way[counted]) / np.sqrt(noise[counted])
    return excess


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
        return JoinedNetwork.of_modules(cell_resistance, self.layout, [modules])

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
