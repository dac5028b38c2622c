"""What a frame may show: nothing, the same pressure everywhere, one of the shapes, or several of them at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from lampest.loads.shapes import shape_types
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate, Prior, Quantity
from lampest.panel.panel import Array, Panel

AND = " and "


@dataclass(frozen=True, eq=False, kw_only=True)
class Several(Candidate):
    """p = Σ p_i(φ_i); reported is the first of them; what sucks comes first.

    parts : the candidates, φ in their order. Use `of`.
    """

    parts: tuple[Candidate, ...]

    @classmethod
    def of(cls, parts: tuple[Candidate, ...]) -> "Several":
        """Called by the names of all."""
        return cls(
            label=AND.join(part.label for part in parts),
            sucks=all(part.sucks for part in parts),
            hollow=all(part.hollow for part in parts),
            parts=parts,
        )

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Those of every part, its number before their names."""
        return {
            f"{number}.{name}": p for number, part in enumerate(self.parts) for name, p in part.priors(panel).items()
        }

    def split(self, parameters: Array) -> list[Array]:
        """φ of every part."""
        return np.split(parameters, list(accumulate(self._lengths))[:-1])

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """The sum, and the slopes of each by its own numbers."""
        each = [
            part.pressure(panel, patch_mm, own) for part, own in zip(self.parts, self.split(parameters), strict=True)
        ]
        return np.sum([pressure for pressure, _ in each], axis=0), np.concatenate([slopes for _, slopes in each])

    def start(self, disc: Disc) -> Array:
        """All of them there."""
        return np.concatenate([part.start(disc) for part in self.parts])

    def like(self, other: Candidate, parameters: Array) -> Array | None:
        """That of every part where there are as many."""
        if not isinstance(other, Several) or len(other.parts) != len(self.parts):
            return None
        pairs = zip(self.parts, other.parts, other.split(parameters), strict=True)
        begin = [part.like(one, own) for part, one, own in pairs]
        found = [one for one in begin if one is not None]
        return np.concatenate(found) if len(found) == len(begin) else None

    def blind(self, parameters: Array) -> Array:
        """Those of the parts."""
        return np.concatenate([part.blind(own) for part, own in zip(self.parts, self.split(parameters), strict=True)])

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Those of the first."""
        return self.parts[0].quantities

    def report(self, parameters: Array) -> tuple[Array, Array]:
        """Those of the first."""
        return self.of_part(0, parameters)

    def of_part(self, number: int, parameters: Array) -> tuple[Array, Array]:
        """What one part reports, with slopes by all of φ."""
        before, own = sum(self._lengths[:number]), self._lengths[number]
        values, slopes = self.parts[number].report(parameters[before : before + own])
        padded = np.zeros((len(values), len(parameters)))
        padded[:, before : before + own] = slopes
        return values, padded

    @property
    def _lengths(self) -> list[int]:
        """How many numbers each part has; the same on every panel."""
        return [len(part.priors(Panel(2, 2))) for part in self.parts]


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


def loads_of(candidate: Candidate, parameters: Array) -> list[tuple[Candidate, Array]]:
    """Each of its loads with its own φ."""
    if isinstance(candidate, Several):
        return list(zip(candidate.parts, candidate.split(parameters), strict=True))
    return [(candidate, parameters)]


NOTHING = Uniform(label="nothing", numbers={})
FLAT = Uniform(label="flat load", numbers={"flat": Prior(0, 5)})
UNIFORM: tuple[Candidate, ...] = (NOTHING, FLAT)
LOADS: tuple[Candidate, ...] = tuple(shape.candidate for shape in shape_types() if shape.candidate is not None)
CANDIDATES = UNIFORM + LOADS
UNKNOWN = "unlike any"
KINDS = (*(candidate.label for candidate in CANDIDATES), UNKNOWN)
