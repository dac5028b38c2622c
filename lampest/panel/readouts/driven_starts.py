"""Starts of solves on driven circuits: cells by closed forms, uniform panels, exact readings."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.alternation import Alternation
from lampest.panel.readouts.branches import (
    LEVELS,
    MAX_CELLS,
    MAX_MISFIT,
    MIN_FOLD,
    every_panel,
    misfit,
    panels_alike,
    uniform_panels,
)
from lampest.panel.readouts.driven_network import DrivenNetwork
from lampest.panel.readouts.equation import Equation, equation_of
from lampest.panel.readouts.floating import convex_start, uniform_factor
from lampest.panel.readouts.lines import (
    as_tuple,
)
from lampest.panel.readouts.readout import (
    MIN_LOAD_SHARE,
    SHORT_SHARE,
    USUAL_OHM,
)
from lampest.panel.readouts.unseen import Scale, unseen_scales

LARGEST_OHM = 1e8  # of such cells: insulation beside usual ones
UNIFORM_LEVELS = 140  # of uniform panels, from 10 ohm to 100 Mohm: 12 % from one to the next
UNIFORM_KNOTS = 48  # of these levels that networks are solved for; the others are interpolated
OPEN_SHARE = 1e-9  # share of the supply below which a reading shows an open cell


class DrivenStarts(DrivenNetwork):
    """Base of circuits with driven and sensed lines: cells at which solves begin."""

    def _reference(self, equation: Equation) -> Array:
        """Return the resistor Rs that scales a reading, (rows, columns) ohm.

        Where no resistor sets the scale of cells, the usual resistance of cells takes its place.
        """
        return np.where(np.isfinite(equation.load), equation.load, USUAL_OHM)

    def apparent_resistance(self, measured: Array) -> Array:
        """Return the resistance of a single divider with this reading.

        For a reading V the resistance is Rs·((Vcc − V_d)·c/V − 1) − Rd.
        """
        equation = self._equation(measured.shape)
        if self._by_uniform_panels(equation, measured):
            return self._of_uniform_panels(measured)
        load = self._reference(equation)
        drive = equation.drive
        volt = np.maximum(measured, OPEN_SHARE * self.driving_volt) / equation.gain
        # (Vcc − V_d)/I with the current I = V/(c·Rs): the sum of cell, load and drive
        total = load * (self.driving_volt - self._lost(volt / load)) / volt
        return np.asarray(np.maximum(total - load - drive, MIN_LOAD_SHARE * total))

    def uniform_start(self, measured: Array) -> Array:
        """Return r_ij = Rs_j·(1 − Σ_k v_kj)/v_ij, (…, rows, columns) ohm, for idle lines at ground.

        The formula is exact for Rd = Rp = 0, where no sensed line depends on another one or on its
        load. Where idle lines float, or are at ground through more than a cell has, the start is
        the apparent resistance.
        """
        equation = self._equation(measured.shape)
        if self._by_uniform_panels(equation, measured):
            return self._of_uniform_panels(measured)
        if equation.floating:
            return np.asarray(
                self.apparent_resistance(measured) / uniform_factor(*measured.shape[-2:])
            )
        if not equation.grounded:
            apparent = self.apparent_resistance(measured)
            if np.mean(equation.states.idle) > np.median(apparent):
                return apparent
        load = self._reference(equation)
        driven = -3 - self._along_sensed
        # Voltages over the supply, with a lower limit for open cells.
        share = measured / (self.driving_volt * equation.gain)
        share = np.maximum(share, OPEN_SHARE * share.max(axis=(-2, -1), keepdims=True))
        remainder = 1 - share.sum(axis=driven, keepdims=True)
        # A negative remainder is noise, or the substitute of a dead line. Then the load counts as
        # one more cell.
        return np.asarray(
            load
            * np.where(remainder > MIN_LOAD_SHARE, remainder, 1 / (1 + share.shape[driven]))
            / share
        )

    def unseen_scales(self, rows: int, columns: int) -> tuple[Scale, ...]:
        equation = equation_of(self, rows, columns)
        # A load, or nothing that conducts elsewhere, shows the scale
        if np.isfinite(equation.load).all() or equation.floating:
            return ()
        return unseen_scales(self, rows, columns)

    def resolution(self, measured: Array, sigma: Array) -> Array:
        """Return the resolution limit, see `Readout.resolution`.

        Without a scale it is that of any cell: no reading says more. Where no closed form gives a
        cell by its reading, it is the largest limit of uniform panels: a press moves the readings
        of other cells beyond those of any uniform panel.
        """
        rows, columns = measured.shape[-2:]
        if self.unseen_scales(rows, columns):
            return np.full(measured.shape, LARGEST_OHM)
        if self._by_uniform_panels(self._equation(measured.shape), measured):
            return np.asarray(uniform_responses(self, rows, columns) / sigma)
        return super().resolution(measured, sigma)

    def nearly_shorted(self, measured: Array) -> Array:
        """Return cells that count as shorts, (…, rows, columns) ohm.

        A share of the uniform start bounds them, too, because with idle lines at ground the
        apparent resistance is many times too large. So is the nearest uniform panel where a reading
        lies beyond those of all.
        """
        start = self.uniform_start(measured)
        if self._by_uniform_panels(self._equation(measured.shape), measured):
            return SHORT_SHARE * np.minimum(start, USUAL_OHM)
        return np.asarray(np.minimum(super().nearly_shorted(measured), SHORT_SHARE * start))

    def _by_uniform_panels(self, equation: Equation, measured: Array) -> bool:
        """Return whether no closed form gives a cell by its reading, but a uniform panel does."""
        if equation.plain and np.isfinite(equation.load).all():
            return False
        return not self.unseen_scales(*measured.shape[-2:])

    def _of_uniform_panels(self, measured: Array) -> Array:
        """Return the uniform panels that come nearest to each reading, (…, rows, columns) ohm."""
        rows, columns = measured.shape[-2:]
        levels, readings = uniform_readings(self, rows, columns)
        flat = measured.reshape(-1, rows, columns)
        distance = np.abs(readings[None] - flat[:, None])
        return np.asarray(levels[np.argmin(distance, axis=1)]).reshape(measured.shape)

    def start(self, measured: Array, upper: Array, near: Array | None = None) -> Array:
        """Return cells that reproduce the readings, (rows, columns) ohm.

        The search alternates between potentials and cells (`Alternation`). Where this moves away or
        several panels give the same readings, Newton's method starts from uniform panels. Without
        loads the equations of floating lines determine ratios of cells alone, and the start is the
        uniform one.
        """
        equation = self._equation(measured.shape)
        if equation.floating:
            return convex_start(self.apparent_resistance(measured), upper, near)
        positive = np.maximum(measured, OPEN_SHARE * measured.max())
        if near is not None:
            firsts = [near]
        elif self.unseen_scales(*measured.shape):
            firsts = [self.uniform_start(measured)]
        else:
            firsts = uniform_panels(log_medians(self, *measured.shape), positive)
        if len(firsts) == 1 and equation.plain and np.isfinite(equation.states.load).all():
            alternation = Alternation(
                equation,
                self._ties(measured, None),
                self.driven,
                self.driving_volt,
                self._driven_volt,
            )
            alternated = alternation.cells(measured, self.uniform_start(measured), near)
            cells = np.minimum(alternated, upper)
            if misfit(self.network(cells, self.ties(measured)), positive) < MAX_MISFIT:
                return np.asarray(cells)
            firsts.append(cells)
        panels = self._panels_from(positive, firsts, upper)
        return panels[0][1] if panels else np.minimum(self.uniform_start(measured), upper)

    def several_panels(self, rows: int, columns: int) -> bool:
        """Return whether readings rise and fall with the conductance of the cells.

        They do where idle lines hold the driven one harder than its driver does. The readings of
        uniform panels show it.
        """
        if max(as_tuple(self.drive_ohm)) == 0 or self.unseen_scales(rows, columns):
            return False
        medians = log_medians(self, rows, columns)
        return bool(medians.max() - medians[0] > MIN_FOLD)

    def every_panel(
        self, measured: Array, tolerance: float, firsts: Sequence[Array] = ()
    ) -> list[Array]:
        few = measured.size <= MAX_CELLS
        if not (few and self.several_panels(*measured.shape)):
            return []
        return every_panel(
            lambda cells: self.network(cells, self.ties(measured)),
            measured,
            [*firsts, *uniform_panels(log_medians(self, *measured.shape), measured)],
            tolerance,
            0 if self.driven == "rows" else 1,
        )

    def panels_alike(self, measured: Array) -> list[tuple[float, Array]]:
        if self._equation(measured.shape).floating or self.unseen_scales(*measured.shape):
            return []
        positive = np.maximum(measured, OPEN_SHARE * measured.max())
        firsts = uniform_panels(log_medians(self, *measured.shape), positive)
        if len(firsts) == 1:
            return []
        return self._panels_from(positive, firsts, np.full(measured.shape, np.inf))

    def _panels_from(
        self, measured: Array, firsts: Sequence[Array], upper: Array
    ) -> list[tuple[float, Array]]:
        """Return the panels that give the readings, as `panels_alike`, from the first ones."""
        return panels_alike(
            lambda cells: self.network(cells, self.ties(measured)), measured, firsts, upper
        )


@lru_cache(maxsize=128)
def log_medians(circuit: DrivenNetwork, rows: int, columns: int) -> Array:
    """Return the logarithms of the median readings of uniform panels of LEVELS, (levels,).

    The check of a circuit asks for some ten circuits, the same for each recording of a panel.
    """
    panels = (np.full((rows, columns), level) for level in LEVELS)
    return np.array([np.log(np.median(circuit.exact_reading(cells))) for cells in panels])


@lru_cache(maxsize=32)
def uniform_readings(circuit: DrivenNetwork, rows: int, columns: int) -> tuple[Array, Array]:
    """Return uniform panels and their readings.

    Returns
    -------
    levels : array, shape (levels,)
        Resistances of the panels in ohm.
    readings : array, shape (levels, rows, columns)
    """
    knots = np.geomspace(LEVELS[0], LEVELS[-1], UNIFORM_KNOTS)
    panels = np.broadcast_to(knots[:, None, None], (len(knots), rows, columns))
    solved = circuit.exact_reading(panels)
    # Cubic polynomials in the logarithm through the four knots about each level
    place = np.linspace(0, UNIFORM_KNOTS - 1, UNIFORM_LEVELS)
    first = np.clip(place.astype(int) - 1, 0, UNIFORM_KNOTS - 4)
    readings = np.zeros((UNIFORM_LEVELS, rows, columns))
    for knot in range(4):
        others = [other for other in range(4) if other != knot]
        weight = np.prod([(place - first - other) / (knot - other) for other in others], axis=0)
        readings += weight[:, None, None] * solved[first + knot]
    return np.geomspace(LEVELS[0], LEVELS[-1], UNIFORM_LEVELS), readings


@lru_cache(maxsize=32)
def uniform_responses(circuit: DrivenNetwork, rows: int, columns: int) -> Array:
    """Return the largest |∂y/∂g|, (rows, columns), of each cell of uniform panels of LEVELS.

    The unit is volt·ohm. Divided by the noise, the response is the largest resistance that differs
    from an open cell.
    """
    responses = []
    for level in LEVELS:
        cells = np.full((rows, columns), level)
        network = circuit.network(cells, circuit.ties(cells))
        responses.append(np.abs(network.own_response()) * level)
    return np.asarray(np.max(responses, axis=0))
