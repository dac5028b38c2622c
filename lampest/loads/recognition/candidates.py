"""Candidates for a frame: nothing, one pressure everywhere, a shape or several at once; and starts of their fits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array, vstack

from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANT
from lampest.loads.shapes import shape_types
from lampest.loads.shapes.disc import Disc, pressure_at_places
from lampest.loads.shapes.shape import Candidate, Prior, Template
from lampest.panel.panel import Array, Panel
from lampest.panel.response import RESPONSE_SD

AND = " and "
# σ: of 720 bare panels, films uneven by 12 to 25 %, some alike in neighbours or with faulty cells, the largest had 6.4.
MAX_UNEVENNESS = 8.0
FULL_KPA, HOLLOW_KPA = (0.0, 8.0), (-6.0, 30.0)  # inside and under the rim, where a fit begins


@dataclass(frozen=True, eq=False, kw_only=True)
class Several(Candidate):
    """p = Σ p_i(φ_i) of its parts, φ in their order; those that suck come first. Use `of`."""

    parts: tuple[Candidate, ...]

    @classmethod
    def of(cls, parts: tuple[Candidate, ...]) -> "Several":
        """Return the names of all as one word."""
        return cls(label=AND.join(part.label for part in parts), sucks=all(part.sucks for part in parts), parts=parts)

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Return the priors of every part, its number before their names."""
        each = enumerate(part.priors(panel).items() for part in self.parts)
        return {f"{number}.{name}": prior for number, priors in each for name, prior in priors}

    def loads(self, parameters: Array) -> list[tuple[Candidate, Array]]:
        return [(part, parameters[own]) for part, own in self._own]

    @cached_property
    def _own(self) -> list[tuple[Candidate, slice]]:
        """Slices of each part's φ; there are as many on every panel."""
        ends = [0, *accumulate(len(part.priors(Panel(2, 2))) for part in self.parts)]
        return [(part, slice(*pair)) for part, pair in zip(self.parts, pairwise(ends), strict=True)]

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Return the sum, and the slopes of each by its own numbers."""
        each = [part.pressure(panel, patch_mm, own) for part, own in self.loads(parameters)]
        return np.sum([pressure for pressure, _ in each], axis=0), np.concatenate([slopes for _, slopes in each])

    def start(self, disc: Disc) -> Array:
        return np.concatenate([part.start(disc) for part in self.parts])

    def like(self, candidate: Candidate, parameters: Array) -> Array | None:
        """Return that of every part where there are as many."""
        begin = [part.like(*load) for part, load in zip(self.parts, candidate.loads(parameters), strict=False)]
        known = [start for start in begin if start is not None]
        return np.concatenate(known) if len(known) == len(self.parts) == len(candidate.loads(parameters)) else None

    def blind(self, parameters: Array) -> Array:
        return np.concatenate([part.blind(own) for part, own in self.loads(parameters)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Uniform(Candidate):
    """p = φ on all cells, which a drift of the whole panel resembles; none at all without a number."""

    numbers: tuple[str, ...] = ()

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """5 kPa about nothing, on any panel: an assumption."""
        return {name: Prior(0, 5) for name in self.numbers}

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        slopes = np.ones((len(parameters), *panel.shape))
        return np.tensordot(parameters, slopes, 1), slopes

    def start(self, disc: Disc) -> Array:
        return np.zeros(len(self.numbers))


NOTHING, FLAT = UNIFORM = Uniform(label="nothing"), Uniform(label="flat load", numbers=("flat",))
LOADS: tuple[Candidate, ...] = tuple(shape.candidate for shape in shape_types() if shape.candidate is not None)
FIELD = Uniform(label="unlike any")  # changes of any form, see `lampest.loads.recognition.fit.field_fit`


def under(panel: Panel, disc: Disc) -> NDArray[np.bool_]:
    """(rows, columns) which cells a disc reaches: it ends at most half a pitch before their centres."""
    across, down = panel.places_mm
    return np.asarray(np.hypot(across - disc.x_mm, down - disc.y_mm) < (disc.diameter_mm + panel.pitch_mm) / 2)


@dataclass(frozen=True, eq=False)
class DiscSearch:
    """A matched filter: round templates about every cell's centre and between four of them.

    Attributes
    ----------
    discs : tuple of Disc
        (discs) starts of fits where one of them matches, one template after the other.
    changes : sparse array, shape (cells, discs)
        ln r/r0 of unit length.
    """

    panel: Panel
    templates: tuple[Template, ...]
    discs: tuple[Disc, ...]
    changes: csc_array

    @classmethod
    @lru_cache(maxsize=16)
    def over(cls, panel: Panel, patch_mm: float, templates: tuple[Template, ...]) -> "DiscSearch":
        """Return the search with all templates laid over a panel."""
        discs, patterns = [], []
        x, y = panel.places_mm[:, panel.present]
        places = x + 1j * y  # one number a place: regular panels have few distinct steps between two places
        steps, step = np.unique(np.round(places - places[:, None], 6), return_inverse=True)
        for template in templates:
            size = (template.outer_mm, template.inner_mm)
            pressures = HOLLOW_KPA if template.inner_mm else FULL_KPA
            for shift in (0.0, panel.pitch_mm / 2):
                shifted = Disc(shift, shift, *size, template.inside, -1.0, 0.0, 0.0)
                pattern, _ = pressure_at_places(np.stack([steps.real, steps.imag]), patch_mm, shifted)
                patterns.append(csr_array(pattern[step.reshape(len(places), -1)]))
                discs += [Disc(*at, *size, *pressures, 0.0, 0.0) for at in zip(x + shift, y + shift, strict=True)]
        changes = vstack(patterns)
        changes.data /= np.repeat(np.sqrt(changes.power(2).sum(axis=1)), np.diff(changes.indptr))
        cells = np.flatnonzero(panel.present)[changes.indices]
        shape = panel.crossings, len(discs)
        return cls(panel, templates, tuple(discs), csc_array((changes.data, cells, changes.indptr), shape))

    @cached_property
    def faint(self) -> NDArray[np.bool_]:
        """(discs) whether it is looked for in the errors of the readings, too."""
        return np.repeat([template.faint for template in self.templates], len(self.discs) // len(self.templates))

    @cached_property
    def places(self) -> Array:
        """(faint discs, 2) their centres, mm."""
        return np.array([disc[:2] for disc in self.discs])[self.faint]

    def matched(self, response: Array) -> csc_array:
        """Return faint templates t (cells, discs) of unit length |B t|, B (n, cells) their whitened response."""
        templates = self.changes[:, self.faint]
        square = templates.multiply((response.T @ response) @ templates).sum(axis=0)
        return csc_array(templates @ diags_array(1 / np.sqrt(np.maximum(square, 1e-300))))

    def lies_on(self, logarithm: Array) -> bool:
        """Whether unloaded cells, ln r (rows, columns), are uneven in a load's shape: tᵀδ < −MAX_UNEVENNESS σ of one t.

        δ is about the median and σ is robust, that of an even film at least. Beyond SIGNIFICANT σ cells count no
        more, so that a faulty one is no load.
        """
        apart = (logarithm - np.median(logarithm[self.panel.present])) * self.panel.present
        sd = max(MAD_TO_SIGMA * float(np.median(np.abs(apart[self.panel.present]))), RESPONSE_SD)
        drawn_in = np.clip(apart.ravel(), -SIGNIFICANT * sd, SIGNIFICANT * sd)
        return bool(np.min(drawn_in @ self.changes) < -MAX_UNEVENNESS * sd)

    def starts(self, normal: Array, pull: Array) -> dict[Template, Disc]:
        """Return where each template explains most: (tᵀb)²/tᵀΛt of ln r/r0 with Λ (cells, cells), b.

        Templates are where ln r/r0 falls, so tᵀb has their sign.
        """
        patterns = self.changes.T
        pulled, size = patterns @ pull, patterns.multiply(patterns @ normal).sum(axis=1)
        gain = pulled * np.abs(pulled) / np.maximum(size, 1e-300)
        best = np.argmax(gain.reshape(len(self.templates), -1), axis=1)
        size = len(self.discs) // len(self.templates)
        return {template: self.discs[at * size + int(best[at])] for at, template in enumerate(self.templates)}

    def beside(self, change: Array, discs: Sequence[Disc]) -> Disc | None:
        """Return where one more load may stand on a map of ln r/r0 (rows, columns), clear of those discs.

        None: nowhere.
        """
        left = np.tanh(change)
        for disc in discs:
            left[under(self.panel, disc)] = 0.0
        score = self.changes.T @ left.ravel()
        return self.discs[int(np.argmax(score))] if score.max() > 0 else None
