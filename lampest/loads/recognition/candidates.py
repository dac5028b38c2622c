"""What a frame may show: nothing, the same pressure everywhere, or one of the shapes that recognition can fit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lampest.loads.shapes import shape_types
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate, Prior
from lampest.panel.panel import Array, Panel


@dataclass(frozen=True, eq=False, kw_only=True)
class Uniform(Candidate):
    """p = φ on all cells, which is also what a drift of the whole panel looks like; none at all without a parameter."""

    numbers: Mapping[str, Prior]

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """That of the pressure in kPa, on any panel."""
        return self.numbers

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """p = φ."""
        slopes = np.ones((len(parameters), *panel.shape))
        return np.tensordot(parameters, slopes, 1), slopes

    def start(self, disc: Disc) -> Array:
        """No pressure, wherever the disc."""
        return np.zeros(len(self.numbers))


NOTHING = Uniform(label="nothing", numbers={})
FLAT = Uniform(label="flat load", numbers={"flat": Prior(0, 5)})
UNIFORM: tuple[Candidate, ...] = (NOTHING, FLAT)
LOADS: tuple[Candidate, ...] = tuple(shape.candidate for shape in shape_types() if shape.candidate is not None)
CANDIDATES = UNIFORM + LOADS
UNKNOWN = "unlike any"
KINDS = (*(candidate.label for candidate in CANDIDATES), UNKNOWN)
