"""Circuits that drive the lines of one side, one after the other, and sense the other side.

This module has bounds of cells, inequalities of readings, and changes of the circuit. The equation
stands in `lampest.panel.readouts.driven_network`, the starts of solves in
`lampest.panel.readouts.driven_starts`.
"""

from dataclasses import replace
from math import inf
from typing import Any, Self

import numpy as np

from lampest.files.levels import NOISE_REACH
from lampest.files.typed import check_ranges
from lampest.panel.panel import Array
from lampest.panel.readouts.channels import errors_of_channels
from lampest.panel.readouts.converter import MAX_VOLT, MIN_VOLT
from lampest.panel.readouts.driven_starts import DrivenStarts
from lampest.panel.readouts.lines import (
    LineNumber,
    PerLine,
    as_tuple,
    lines_text,
    of_side,
    opposite,
    with_channels,
)
from lampest.panel.readouts.readout import (
    FreeTest,
    Surroundings,
)


class DrivenCircuit(DrivenStarts):
    """Base of circuits with driven and sensed lines, with the attributes of `DrivenNetwork`."""

    def least_cells(self, measured: Array, sigma: Array | None) -> Array:
        """Return the lower bounds r_ij ≥ u_i/I_i − Rs_j of the cells, where idle lines float.

        Shape (…, rows, columns), ohm. I_i = Σ_j V_ij/Rs_j is the current of the driven line,
        increased by its noise, and u_i = Vcc − Rd_i I_i − V_d its potential. The bound holds
        because I_i is at least the current through each cell and its load alone. Where other lines
        conduct to ground, cells can increase and decrease a reading, and r > 0 alone holds.
        """
        equation = self._equation(measured.shape)
        least = super().least_cells(measured, sigma)
        states = equation.states
        quiet = equation.plain and (equation.together is None or np.isinf(states.idle_load).all())
        if not (quiet and np.isinf(states.idle).all() and np.isfinite(states.load).all()):
            return least
        noise = np.zeros_like(measured)
        if sigma is not None:
            noise = np.where(np.isfinite(sigma), sigma, measured)
        by_volt = 1 / (equation.gain * equation.load)
        # Upper bound of the current, and with it a lower bound of the potential
        current = self._sum_together(measured * by_volt)
        current = current + NOISE_REACH * np.sqrt(self._sum_together((noise * by_volt) ** 2))
        bound = np.maximum(self._driven_volt(current, equation.drive), 0) / current - equation.load
        return np.asarray(np.maximum(bound, least))

    def free_tests(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the tests v_ij ≤ Vcc − Rd_i Σ_k v_ik/Rs_k and Σ_i v_ij ≤ Vcc.

        The sum over k is over simultaneous loads. The first one: no sensed line has a higher
        potential than the driven one, which is below the supply by the loads' current through its
        Rd. The second one, for idle lines at ground through no more than Rd: if all driven lines
        were at the supply, no sensed line would be above it (superposition, Z·t ≤ 1).
        """
        equation = self._equation(measured.shape)
        if equation.potentials is not None:
            return self._tests_of_potentials(measured, sigma)
        load = equation.load
        volt, noise = np.where(np.isfinite(sigma), (measured, sigma), 0.0) / equation.gain
        # Vcc ≥ v_ij + Rd_i Σ_k v_ik/Rs_k + V_d, with the propagated noise of both terms
        simultaneous = equation.together is None or len(equation.ties) > 1
        drop = (equation.drive if simultaneous else 0.0) / load
        driven = -3 - self._along_sensed
        lost = self._lost(self._sum_together(volt / load))
        below = volt + self._sum_together(volt * drop) + lost
        spread = np.hypot(noise, np.sqrt(self._sum_together((noise * drop) ** 2)))
        law = f"no sensed line stands above the driven one behind its {lines_text(self.drive_ohm)}"
        tests = [(law, below, np.where(noise > 0, spread, 0.0))]
        if equation.grounded:
            law = "readings of a sensed line add up to no more than the supply"
            tests = [(law, volt.sum(axis=driven), np.sqrt((noise**2).sum(axis=driven))), *tests]
        results = []
        for law, value, spread in tests:
            excess = np.where(
                spread > 0, (value - self.driving_volt) / np.where(spread > 0, spread, 1.0), -np.inf
            )
            results.append(FreeTest(law, excess.reshape(len(value), -1).max(axis=1), value[0].size))
        return tuple(results)

    def _tests_of_potentials(self, measured: Array, sigma: Array) -> tuple[FreeTest, ...]:
        """Return the test that no line is beyond the potentials in which lines end."""
        terms = self._equation(measured.shape).potentials
        assert terms is not None
        most = max(self.driving_volt, float(terms.ends.max()), float(terms.load_volt.max()))
        gain = self._equation(measured.shape).gain
        end = self._end_volt(terms.load_volt)
        volt = terms.load_volt + (measured - end) / gain
        known = np.isfinite(sigma) & (sigma > 0)
        spread = np.where(known, sigma, 1.0) / gain
        excess = np.where(known, np.maximum(volt - most, -volt) / spread, -np.inf)
        law = "no sensed line stands beyond the potentials in which lines end"
        return (FreeTest(law, excess.reshape(len(excess), -1).max(axis=1), excess[0].size),)

    def most_in_series(self, measured: Array, sigma: Array) -> float:
        """Return the upper bound of Rd, min_i (Vcc − V_d − max_j v_ij)/Σ_j v_ij/Rs_j, ohm.

        The sum is over simultaneous loads; with one load at a time each reading is taken alone.
        """
        equation = self._equation(measured.shape)
        if not equation.plain:
            return 0.0
        volt = np.where(np.isfinite(sigma), measured, 0.0) / equation.gain
        current = self._sum_together(volt / equation.load)
        if equation.together is None:
            volt = volt.max(axis=self._along_sensed, keepdims=True)
        # Voltage across Rd and the current through it: Rd ≤ (Vcc − V_d − v)/I
        drop = self._driven_volt(current, 0.0) - volt
        return float(
            np.min(np.where(current > 0, drop / np.where(current > 0, current, 1.0), np.inf))
        )

    def simulated(
        self, cell_resistance: Array, scene: Surroundings, row_ohm: Array, column_ohm: Array
    ) -> Array:
        """Return recorded values with the channels added to the resistances.

        Channels add to drive_ohm, and to sense_ohm unless it is zero.
        """
        actual = self.with_channels(row_ohm, column_ohm)
        return actual.to_recorded(actual.exact_reading(cell_resistance, scene.wiring), scene)

    def channel_errors(self, cells: Array, scene: Surroundings, channel: float) -> Array:
        return errors_of_channels(self, cells, scene.wiring, channel)

    def with_channels(self, row_ohm: Array, column_ohm: Array) -> Self:
        """Return the circuit with additional channel resistances, (rows,) and (columns,) ohm."""
        driven, sensed = of_side(self.driven, row_ohm, column_ohm)
        changes: dict[str, Any] = {"drive_ohm": with_channels("drive_ohm", self.drive_ohm, driven)}
        if self.sense_ohm:
            changes["sense_ohm"] = with_channels("sense_ohm", self.sense_ohm, sensed)
        return replace(self, **changes)

    def off_by(self, fraction: float) -> Self:
        """Return the circuit with every reference resistor larger by a fraction."""
        name = self.of_sensed[0]
        value: PerLine = getattr(self, name)
        larger = tuple(number * (1 + fraction) for number in as_tuple(value))
        changes: dict[str, Any] = {name: larger if isinstance(value, tuple) else larger[0]}
        return replace(self, **changes)

    def line_numbers(self) -> tuple[LineNumber, ...]:
        """Return the numbers to calibrate.

        Calibration estimates drive resistances, which include channels, reference resistors, and a
        diode's drop.
        """
        drive = LineNumber("drive_ohm", (self.driven,), channel=True)
        reference = getattr(self, self.of_sensed[0])
        resistors = (
            (LineNumber(self.of_sensed[0], (opposite(self.driven),)),)
            if max(as_tuple(reference)) < inf
            else ()
        )
        diode = () if self.diode is None else (LineNumber("diode.drop_volt", (), unit="volt"),)
        return drive, *resistors, *diode


class SourcedCircuit(DrivenCircuit):
    """Base of circuits whose source and converter may have voltages of their own.

    Attributes
    ----------
    drive_volt : float, or None
        Source of a driven line in volt; None: supply_volt.
    converter_volt : float, or None
        End of the converter's range in volt; None: supply_volt.
    """

    drive_volt: float | None = None
    converter_volt: float | None = None

    def __post_init__(self) -> None:
        check_ranges(self, MIN_VOLT, MAX_VOLT, "drive_volt", "converter_volt")
        super().__post_init__()

    @property
    def source_volt(self) -> float:
        return super().source_volt if self.drive_volt is None else self.drive_volt

    @property
    def full_scale_volt(self) -> float:
        return self.supply_volt if self.converter_volt is None else self.converter_volt
