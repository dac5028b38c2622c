"""Hysteresis: loading follows the response curve, unloading lags behind it, and a load that is gone leaves nothing.

    p_e = w_0 p + Σ w_i z_i,   z_i held between p and b_i p

A generalised Prandtl-Ishlinskii operator: plays z_i whose two branches are the lines p and b_i p, b_i > 1. It is
causal, independent of rate, odd (suction is as pressure), homogeneous (half the load makes half the loop) and forgets
all where the load crosses zero. Its inverse is exact: p_e is strictly monotone and piecewise linear in p, w_0 > 0. The
weights are such that from a peak P the film unloads along the hyperbola p_e/P = s²t/(1 + (s² − 1)t), t = p/P, with
s = (1 + η)/(1 − η); its largest gap from the line is η, at t = 1/(1 + s).

Sources: Al Janaideh, Rakheja, Su, IEEE/ASME Trans. Mechatron. 16, 734 (2011), the operator and its inverse; Kuhnen,
Eur. J. Control 9, 407 (2003); for tactile films Sánchez-Durán et al., Sensors 15, 26170 (2015), who compare it with
others.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array

# Where the hyperbola is cut into lines: ln(s t/(1 − t)), 0 at the largest gap. The lines miss it by 0.4 % of the peak.
CUTS = np.linspace(-2.6, 2.6, 11)


@dataclass(frozen=True, eq=False)
class Plays:
    """weight : (1 + plays, ...) of p and of the plays. reach : (plays, ...) b_i. held : (plays, ...) z_i, kPa."""

    weight: Array
    reach: Array
    held: Array

    @classmethod
    def at_rest(cls, hysteresis: Array) -> "Plays":
        """Of cells with their largest gap each, any shape, before the first load."""
        steep = (1 + hysteresis) / (1 - hysteresis)
        cut = CUTS.reshape(-1, *[1] * np.ndim(hysteresis))
        below, above = 1 / (1 + steep * np.exp(-cut)), 1 / (1 + np.exp(-cut) / steep)
        nothing, whole = np.zeros((1, *np.shape(hysteresis))), np.ones((1, *np.shape(hysteresis)))
        slopes = np.diff(above, axis=0, prepend=nothing, append=whole) / np.diff(
            below, axis=0, prepend=nothing, append=whole
        )
        weight = np.concatenate([slopes[-1:], -np.diff(slopes, axis=0) * below])
        return cls(weight, 1 / below, np.zeros_like(below))

    def after(self, pressure: Array) -> "Plays":
        """The plays once the pressure (...) kPa has come, monotonously."""
        return replace(self, held=self._moved(pressure))

    @property
    def answered(self) -> Array:
        """Σ w_i z_i, (...) kPa: p_e but for w_0 p."""
        return np.asarray((self.weight[1:] * self.held).sum(axis=0))

    def effective(self, pressure: Array) -> Array:
        """p_e (...) kPa were the pressure the next."""
        return self._sum(pressure, self._moved(pressure))

    def pressure(self, effective: Array) -> Array:
        """p (...) kPa of the next p_e: the inverse of `effective`. NaN stays."""
        corners = np.sort(np.concatenate([self.held, self.held / self.reach, np.zeros_like(self.held[:1])]), axis=0)
        each = replace(self, weight=self.weight[:, None], reach=self.reach[:, None], held=self.held[:, None])
        reached = each.effective(corners)
        last = len(corners) - 1
        below = np.clip((reached <= effective).sum(axis=0) - 1, 0, last - 1)
        start, end = (np.take_along_axis(corners, below[None] + step, axis=0)[0] for step in (0, 1))
        low, high = (np.take_along_axis(reached, below[None] + step, axis=0)[0] for step in (0, 1))
        slope = np.where(high > low, (end - start) / np.where(high > low, high - low, 1.0), 1.0)
        inside = start + (effective - low) * slope
        # Beyond all corners every play rests on the line p itself.
        under, over = corners[0] + effective - reached[0], corners[-1] + effective - reached[-1]
        return np.asarray(np.where(effective < reached[0], under, np.where(effective > reached[-1], over, inside)))

    def _moved(self, pressure: Array) -> Array:
        far = self.reach * pressure
        return np.asarray(np.clip(self.held, np.minimum(pressure, far), np.maximum(pressure, far)))

    def _sum(self, pressure: Array, held: Array) -> Array:
        return np.asarray(self.weight[0] * pressure + (self.weight[1:] * held).sum(axis=0))
