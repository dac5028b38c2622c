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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import data_of_cells
from lampest.inference.evidence import (
    MOVED_COST,
    OUTLINE_COST,
    Chosen,
    Mixtures,
    covariance_of_load,
    covariances_of_field,
    mostly_still,
    outline,
    usual_starts,
)
from lampest.inference.pair import FittedPair
from lampest.inference.unloaded_cells import AtRest, most_probable_cells
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import tolerance_errors
from lampest.panel.scene import Scene
from lampest.posterior.linear import misfit_and_volume

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
        cells = min(map(self._cost_of_cells, self._changed_sets()))
        field = self._cost_of(covariances_of_field(self.pair.place))
        return _of_either(cells, field)

    def _changed_sets(self) -> Sequence[Chosen]:
        """Return the sets of changed cells at which searches from different starts end."""
        changes = self.pair.with_columns(self.pair.columns(()))
        ends = [changes.selected([start])[1] for start in usual_starts(changes.change)]
        return list({end.tobytes(): end for end in (self.pair.evidence.moved, *ends)}.values())

    def _cost_of_cells(self, changed: Chosen) -> float:
        """Return −2 ln density where these cells changed, as single ones or as a load."""
        count = int(changed.sum())
        single = MOVED_COST * count + self._cost_of(Mixtures.one(np.diag(changed.astype(float))))
        if not (count and mostly_still(changed)):
            return single
        place = self.pair.place
        covariance = np.zeros((len(place), len(place)))
        covariance[np.ix_(changed, changed)] = covariance_of_load(place[changed])
        load = OUTLINE_COST * outline(place, changed) + self._cost_of(Mixtures.one(covariance))
        return _of_either(single, load)

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
        return np.asarray(errors[1:].reshape(len(errors) - 1, -1).T)

    @cached_property
    def _unchanged(self) -> Array:
        """C of cells that no load touches, (cells, cells)."""
        creep = ASSUMED.creep**2 * np.eye(self.pair.change.size)
        return np.asarray(self._at_rest.covariance + creep + ASSUMED.common_change**2)

    def _cost_of(self, changes: Mixtures) -> float:
        """Return −2 ln of the mean density over covariances S of the changes."""
        frame = self.pair.frames[1]
        readings = frame.measured
        data = data_of_cells(frame.scene, readings)
        plain = readings.plain.ravel()
        weight = 1 / readings.known_sigma.ravel()[plain, None]
        deviation = np.where(readings.plain, readings.known_sigma, np.inf)
        mean = near = self._at_rest.cells
        likeliest = len(changes.shares) // 2
        for _ in range(MAX_ROUNDS):
            taken = likeliest
            covariance = self._unchanged + changes.covariance(taken)
            root = np.linalg.inv(np.linalg.cholesky(covariance))
            near, given, jacobian = most_probable_cells(
                data, readings.value, deviation, (root, mean), near, frame.with_effects
            )
            missed = (readings.value - given).ravel() + jacobian @ (near - mean).ravel()
            channels = self._by_channels(frame.scene, near) - jacobian @ self._by_channels_at_rest
            jacobian = weight * jacobian[plain]
            channels = weight * channels[plain]
            errors = weight[:, 0] * missed[plain]
            alike = np.eye(len(weight)) + jacobian @ self._unchanged @ jacobian.T
            costs = np.array(
                [
                    [
                        sum(misfit_and_volume(known + change, errors))
                        for change in changes.through(jacobian)
                    ]
                    for known in (alike, alike + channels @ channels.T)
                ]
            )
            likeliest = int(costs.min(axis=0).argmin())
            if likeliest == taken:
                break
        return -2 * float(np.logaddexp.reduce(-costs / 2, axis=None) - np.log(costs.size))


def _of_either(first: float, second: float) -> float:
    """Return −2 ln density where two models are equally probable, from that of each."""
    return -2 * float(np.logaddexp(-first / 2, -second / 2) - np.log(2))
