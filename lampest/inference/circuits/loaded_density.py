"""Density of a loaded frame's readings given the unloaded ones, about the most probable cells.

Fits of noisy readings follow their noise, and linear theory about such cells fails where noise
changes them by tens of percent: effects, whose columns then resemble the noise, explain it. Given
the unloaded readings and the film, the unloaded log cells are N(m, P) (`AtRest`). The loaded ones
are u ~ N(m, C) with

    C = P + creep² 1 + common² 1 1ᵀ + S,

where S is the covariance of single changed cells, or of a smooth field within an outline
(`lampest.inference.evidence`). With the readings linearised at the most probable u,

    −2 ln p(y) = eᵀ V⁻¹ e + ln |V|,   e = (y − f(u) + J (u − m))/σ,   V = 1 + (J C Jᵀ + A Aᵀ)/σ²,

where A is the change of the readings by channels of one standard deviation, less what the same
channels change by way of m. Channels that are alike, A = 0, are equally probable.
"""

from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import data_of_cells
from lampest.inference.evidence import (
    EVERY_SIZE,
    MIDDLE_SIZES,
    MOVED_COST,
    OUTLINE_COST,
    Field,
    outline,
    select_changed,
)
from lampest.inference.number import mean_cost
from lampest.inference.pair import FittedPair
from lampest.inference.unloaded_cells import AtRest, most_probable_cells
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.tolerances import channel_errors
from lampest.panel.scene import Scene
from lampest.posterior.linear import inverse_and_volume, misfit_and_volume

MAX_ROUNDS = 3  # of linearisations, each with the changes that are likeliest then


@dataclass(frozen=True, eq=False)
class LoadedDensity:
    """Density of the loaded readings of a pair, in units of their noise.

    Attributes
    ----------
    pair : FittedPair
    """

    pair: FittedPair

    @cached_property
    def cost(self) -> float:
        """−2 ln density where the changes are single cells, or a field of these or of all cells.

        Raises one of BROKEN where arithmetic fails.
        """
        # Linear theory may see no change where a reading hardly depends on its cell: cells are
        # taken away from all, too.
        moved = self.pair.evidence.moved
        everywhere = np.ones_like(moved)
        cells, changed = min(map(self._with_cells, (moved, everywhere)), key=itemgetter(0))
        outlines = self.pair.changes.outlines(self.pair.place, changed)
        some = mean_cost(np.array([cells, *map(self._cost_of_field, outlines)]))
        return mean_cost(np.array([some, self._cost_of_field(everywhere)]))

    def _with_cells(self, changed: Mask) -> tuple[float, Mask]:
        """Return the least −2 ln density of single changed cells, beginning at these, and them.

        Cells are added and removed by the readings, linearised at the most probable cells of the
        set before.
        """
        cost, best = np.inf, changed
        for _ in range(MAX_ROUNDS):
            single = np.diag(changed.astype(float))
            near = self._linearised(single, self._at_rest.cells)
            further = MOVED_COST * int(changed.sum()) + near.cost(near.through(single))
            if not further < cost:
                break
            cost, best = further, changed
            changed = near.selected(changed)
        return cost, best

    @cached_property
    def _at_rest(self) -> AtRest:
        """The unloaded cells."""
        return AtRest.of(self.pair.frames[0])

    @cached_property
    def _by_channels_at_rest(self) -> Array:
        """Change of m by channels of one standard deviation, (cells, lines)."""
        at_rest = self._at_rest
        return at_rest.response(self._by_channels(self.pair.frames[0].scene, at_rest.cells))

    def _by_channels(self, scene: Scene, cells: Array) -> Array:
        """Return the change of the readings of log cells by channels of one standard deviation.

        Shape (readings, lines).
        """
        ohm = np.exp(cells)
        readings = scene.circuit.exact_reading(ohm, scene.wiring)
        spread = self.pair.channel_spread
        errors = channel_errors(scene.circuit, ohm, readings, scene, spread)
        return errors.reshape(len(errors), -1).T

    @cached_property
    def _unchanged(self) -> Array:
        """C of cells that no load touches, (cells, cells)."""
        creep = ASSUMED.creep**2 * np.eye(self.pair.change.size)
        return self._at_rest.covariance + creep + ASSUMED.common_change**2

    def _cost_of_field(self, changed: Mask) -> float:
        """Return −2 ln density where the changes are a smooth field within an outline."""
        inside = np.eye(len(changed))[:, changed]
        field = Field.of(self.pair.place[changed]).through(inside)
        cells, sizes = self._at_rest.cells, MIDDLE_SIZES
        for _ in range(MAX_ROUNDS):
            taken = sizes
            near = self._linearised(field.covariance(taken), cells)
            covariances = map(field.through(near.jacobian).covariance, EVERY_SIZE)
            costs = np.array([*map(near.cost, covariances)])
            cost, sizes = mean_cost(costs), EVERY_SIZE[int(costs.argmin())]
            if sizes == taken:
                break
            cells = near.cells
        return cost + OUTLINE_COST * outline(self.pair.place, changed)

    def _linearised(self, change: Array, start: Array) -> "_LinearReadings":
        """Return the readings at the most probable cells where changes have this covariance.

        Parameters
        ----------
        change : array, shape (cells, cells)
            S.
        start : array, shape (rows, columns)
            Log cells at which the search begins.
        """
        frame = self.pair.frames[1]
        readings = frame.measured
        plain = readings.plain.ravel()
        mean = self._at_rest.cells
        precision = inverse_and_volume(self._unchanged + change)[0]
        cells, given, jacobian = most_probable_cells(
            data_of_cells(frame.scene, readings),
            readings.value,
            np.where(readings.plain, readings.known_sigma, np.inf),
            (precision, mean),
            start,
            frame.with_effects,
        )
        missed = (readings.value - given).ravel() + jacobian @ (cells - mean).ravel()
        channels = self._by_channels(frame.scene, cells) - jacobian @ self._by_channels_at_rest
        weight = 1 / readings.known_sigma.ravel()[plain, None]
        jacobian = weight * jacobian[plain]
        channels = weight * channels[plain]
        alike = np.eye(len(weight)) + jacobian @ self._unchanged @ jacobian.T
        unchanged = (alike, alike + channels @ channels.T)
        return _LinearReadings(cells, jacobian, weight[:, 0] * missed[plain], unchanged)


class _LinearReadings(NamedTuple):
    """Readings of a loaded frame in units of their noise, linearised at its log cells.

    Attributes
    ----------
    cells : array, shape (rows, columns)
        u.
    jacobian : array, shape (readings, cells)
        J/σ.
    errors : array, shape (readings,)
        e.
    unchanged : tuple of array
        V without changes, with channels that are alike and with differing ones.
    """

    cells: Array
    jacobian: Array
    errors: Array
    unchanged: tuple[Array, Array]

    def through(self, changes: Array) -> Array:
        """Return the covariance of the readings by changes with a covariance S."""
        return np.asarray(self.jacobian @ changes @ self.jacobian.T)

    def cost(self, changes: Array) -> float:
        """Return −2 ln density where changes give the readings this covariance."""
        return mean_cost(self.costs(changes))

    def costs(self, changes: Array) -> Array:
        """Return −2 ln density with each V beside a covariance of the readings by changes, (2,)."""
        known = (sum(misfit_and_volume(each + changes, self.errors)) for each in self.unchanged)
        return np.array(list(known))

    def selected(self, changed: Mask) -> Mask:
        """Return the changed cells with the largest evidence, beginning at these."""
        costs = self.costs(self.through(np.diag(changed.astype(float))))
        precision = inverse_and_volume(self.unchanged[int(costs.argmin())])[0]
        weighted = self.jacobian.T @ precision
        return select_changed(weighted @ self.errors, weighted @ self.jacobian, [changed])[1]
