"""Errors of each reading that are the same in all frames."""

import numpy as np

from lampest.panel.effects import SharedEffect, recorded_share
from lampest.panel.network import Network
from lampest.panel.panel import Array, Shape
from lampest.panel.scene import Scene


class ReadingError(SharedEffect):
    """A factor on each recorded value; `size` is the standard deviation of its logarithm."""

    setting = "reading_error"
    name = "each reading"
    limits = (0.0, 10.0)
    if_undetermined = "no frame shows it; `lampest calibrate` measures it"

    def sentence(self, size: float, deviation: float) -> str:
        return (
            f"each reading seems off by {100 * size:.2g} +- {100 * deviation:.1g} %, "
            "the same in all frames: cells are rougher than those of films"
        )

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return a column for each reading."""
        # Column c has the error of reading c alone: an identity over the cells times
        # size·∂y/∂log(recorded).
        shares = (size * recorded_share(measured, scene)).reshape(*measured.shape[:-2], -1)
        columns = np.zeros((shares.shape[-1], *shares.shape))
        np.einsum("c...c->...c", columns)[...] = shares
        return columns.reshape(-1, *measured.shape)

    def drawn(self, shape: Shape, size: float, random: np.random.Generator) -> Array:
        """Return drawn factors on recorded values of a panel's shape."""
        return np.exp(size * random.standard_normal(shape))


READING_ERROR = ReadingError()
