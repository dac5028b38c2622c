"""What a frame may show: nothing, the same pressure everywhere, one of the shapes, or several of them at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from lampest.loads.shapes import shape_types
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate, Prior
from lampest.panel.panel import Array, Panel

AND = " and "


@dataclass(frozen=True, eq=False, kw_only=True)
class Several(Candidate):
    """p = Σ p_i(φ_i) of its parts, φ in their order; those that suck come first. Use `of`."""

    parts: tuple[Candidate, ...]

    @classmethod
    def of(cls, parts: tuple[Candidate, ...]) -> "Several":
        """Called by the names of all."""
        return cls(label=AND.join(part.label for part in parts), sucks=all(part.sucks for part in parts), parts=parts)

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Those of every part, its number before their names."""
        return {
            f"{number}.{name}": p for number, part in enumerate(self.parts) for name, p in part.priors(panel).items()
        }

    def loads(self, parameters: Array) -> list[tuple[Candidate, Array]]:
        """Every part with its own φ."""
        return list(zip(self.parts, np.split(parameters, self._ends), strict=True))

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """The sum, and the slopes of each by its own numbers."""
        each = [part.pressure(panel, patch_mm, own) for part, own in self.loads(parameters)]
        return np.sum([pressure for pressure, _ in each], axis=0), np.concatenate([slopes for _, slopes in each])

    def start(self, disc: Disc) -> Array:
        """All of them there."""
        return np.concatenate([part.start(disc) for part in self.parts])

    def like(self, other: Candidate, parameters: Array) -> Array | None:
        """That of every part where there are as many."""
        loads = other.loads(parameters)
        if len(loads) != len(self.parts):
            return None
        begin = [part.like(one, own) for part, (one, own) in zip(self.parts, loads, strict=True)]
        found = [one for one in begin if one is not None]
        return np.concatenate(found) if len(found) == len(begin) else None

    def blind(self, parameters: Array) -> Array:
        """Those of the parts."""
        return np.concatenate([part.blind(own) for part, own in self.loads(parameters)])

    @cached_property
    def _ends(self) -> list[int]:
        """Where the numbers of each part end but of the last; the same on every panel."""
        return list(accumulate(len(part.priors(Panel(2, 2))) for part in self.parts))[:-1]


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
FIELD = Uniform(label="unlike any", numbers={})  # changes of any form, see `lampest.loads.recognition.field`
KINDS = (*(candidate.label for candidate in CANDIDATES), FIELD.label)
