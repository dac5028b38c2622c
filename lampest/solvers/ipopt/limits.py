"""Bounds of the conductances, and what an interior-point method has to know of them to go on from a start."""

from dataclasses import dataclass

import numpy as np

from lampest.panel.panel import Array

PUSH = 1e-9  # of a bound, at least of 1: how far IPOPT keeps off it; shows in no digit that a cell is known to


@dataclass(frozen=True, eq=False)
class Limits:
    """low, high : (cells) least and largest conductances, flat, in units that make them of order one."""

    low: Array
    high: Array

    def multipliers(self, conductance: Array, pull: Array, barrier: float) -> Array:
        """z_high − z_low of every cell, where pull is what pulls it up, −∂φ/∂g with voltages that follow.

        A cell on its bound has the multiplier that holds the pull, and none where it pulls inwards; all others have
        barrier/room towards either side.
        """
        below, above = conductance - self.low, self.high - conductance
        on_low, on_high = below <= PUSH * np.maximum(self.low, 1), above <= PUSH * np.maximum(self.high, 1)
        inside = barrier / np.where(on_high, 1, above) - barrier / np.where(on_low, 1, below)
        return np.where(on_low, np.minimum(pull, 0), np.where(on_high, np.maximum(pull, 0), inside))

    def settled(self, conductance: Array, multiplier: Array) -> Array:
        """Conductances with those put on a bound that press against it harder than they are away from it.

        The barrier keeps them off by as much as its height over their multiplier, which a large resistance would show.
        """
        lowered = np.where(-multiplier > conductance - self.low, self.low, conductance)
        return np.where(multiplier > self.high - conductance, self.high, lowered)
