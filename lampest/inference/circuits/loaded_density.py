"""Density of a loaded frame's readings given the unloaded ones, about the most probable cells.

Fits of noisy readings follow their noise, and linear theory about such cells fails where noise
changes them by tens of percent: effects, whose columns then resemble the noise, explain it. Given
the unloaded readings and the film, the unloaded log cells are N(m, P) (`AtRest`). The loaded ones
are u ~ N(m, C) with

    C = P + creep² 1 + common² 1 1ᵀ + S,

where S is the covariance of single changed cells, of a load, or of a smooth field
(`lampest.inference.evidence`). With the readings linearised at the most probable u,

    −2 ln p(y) = eᵀ V⁻¹ e + ln |V|,   e = (y − f(u) + J (u − m))/σ,   V = 1 + (J C Jᵀ + A Aᵀ)/σ²,

where A is the change of the readings by channels of one standard deviation, less what the same
channels change by way of m. Channels that are alike, A = 0, are equally probable.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import data_of_cells
from lampest.inference.evidence import (
    MOVED_COST,
    OUTLINE_COST,
    Mixtures,
    covariance_of_load,
    covariances_of_field,
    mostly_still,
    outline,
    select_changed,
)
from lampest.inference.number import mean_cost
from lampest.inference.pair import FittedPair
from lampest.inference.unloaded_cells import AtRest, most_probable_cells
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.tolerances import tolerance_errors
from lampest.panel.scene import Scene
from lampest.posterior.linear import inverse_and_volume

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
        """−2 ln density where the changed cells may be single ones, loads, or a smooth field.

        Raises one of BROKEN where arithmetic fails.
        """
        # Linear theory may see no change where a reading hardly depends on its cell: cells are
        # taken away from all, too.
        moved = self.pair.evidence.moved
        cells = min(map(self._cost_of_cells, (moved, np.ones_like(moved))))
        field = self._cost_of(covariances_of_field(self.pair.place))
        return mean_cost(np.array([cells, field]))

    def _cost_of_cells(self, changed: Mask) -> float:
        """Return the least −2 ln density of changed cells, beginning at these.

        Cells are added and removed by the readings, linearised at the most probable cells of the
        set before.
        """
        cost = np.inf
        for _ in range(MAX_ROUNDS):
            near = self._linearised(np.diag(changed.astype(float)), self._at_rest.cells)
            further = self._cost_of_set(changed, near)
            if not further < cost:
                break
            cost = further
            changed = near.selected(changed)
        return cost

    def _cost_of_set(self, changed: Mask, near: "_LinearReadings") -> float:
        """Return −2 ln density where these cells changed, as single ones or as a load."""
        count = int(changed.sum())
        single = Mixtures.one(np.diag(changed.astype(float)))
        as_cells = MOVED_COST * count + mean_cost(near.costs(single))
        if not (count and mostly_still(changed)):
            return as_cells
        place = self.pair.place
        covariance = np.zeros((len(place), len(place)))
        covariance[np.ix_(changed, changed)] = covariance_of_load(place[changed])
        as_load = OUTLINE_COST * outline(place, changed) + self._cost_of(Mixtures.one(covariance))
        return mean_cost(np.array([as_cells, as_load]))

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
        errors = tolerance_errors(scene.circuit, ohm, readings, scene, 0.0, spread)
        return errors[1:].reshape(len(errors) - 1, -1).T

    @cached_property
    def _unchanged(self) -> Array:
        """C of cells that no load touches, (cells, cells)."""
        creep = ASSUMED.creep**2 * np.eye(self.pair.change.size)
        return self._at_rest.covariance + creep + ASSUMED.common_change**2

    def _cost_of(self, changes: Mixtures) -> float:
        """Return −2 ln of the mean density over covariances S of the changes."""
        mean = self._at_rest.cells
        likeliest = len(changes.shares) // 2
        for _ in range(MAX_ROUNDS):
            taken = likeliest
            near = self._linearised(changes.covariance(taken), mean)
            costs = near.costs(changes)
            likeliest = int(costs.min(axis=0).argmin())
            if likeliest == taken:
                break
            mean = near.cells
        return mean_cost(costs)

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
        root = np.linalg.inv(np.linalg.cholesky(self._unchanged + change))
        cells, given, jacobian = most_probable_cells(
            data_of_cells(frame.scene, readings),
            readings.value,
            np.where(readings.plain, readings.known_sigma, np.inf),
            (root, mean),
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

    def costs(self, changes: Mixtures) -> Array:
        """Return −2 ln density with each V and each covariance S, (2, covariances)."""
        through = replace(changes, parts=self.jacobian @ changes.parts @ self.jacobian.T)
        return np.array([through.costs(known, self.errors) for known in self.unchanged])

    def selected(self, changed: Mask) -> Mask:
        """Return the changed cells with the largest evidence, beginning at these."""
        costs = self.costs(Mixtures.one(np.diag(changed.astype(float))))[:, 0]
        precision = inverse_and_volume(self.unchanged[int(costs.argmin())])[0]
        weighted = self.jacobian.T @ precision
        return select_changed(weighted @ self.errors, weighted @ self.jacobian, [changed])[1]
