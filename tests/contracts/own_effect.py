"""A user's own effect in one file, as docs/howto/adding/effect.md adds one."""

from typing import Any

import numpy as np

import lampest
from lampest import Array


class Crosstalk(lampest.SharedEffect):
    """A share of the reading half a panel away, as between the halves of a double multiplexer."""

    setting = "crosstalk"
    name = "crosstalk of the rows' multiplexers"
    limits = (0.0, 0.5)
    prior = 0.02

    def columns(self, network: Any, measured: Array, scene: lampest.Scene, size: float) -> Array:
        """Return one column, the share of the row half a panel away."""
        return size * np.roll(measured, measured.shape[-2] // 2, axis=-2)[None]
