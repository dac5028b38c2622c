"""Candidates of recognition, and starts of their fits.

The candidates are no load, an equal pressure on all cells, and one or several shapes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array, vstack

from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANT
from lampest.panel.panel import Array, Panel
from lampest.panel.response import RESPONSE_SD
from lampest.recording.shapes import shape_types
from lampest.recording.shapes.disc import Disc, pressure_at_places
from lampest.recording.shapes.shape import Candidate, Prior, Template

AND = " and "
# Standard deviations of a template's score. Of 720 bare panels with films uneven by 12 to 25 %,
# some with correlated neighbours or with faulty cells, the largest score was 6.3.
MAX_UNEVENNESS = 8.0
# initial pressures inside, and under the rim
FULL_KPA = (0.0, 8.0)
HOLLOW_KPA = (-6.0, 30.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Several(Candidate):
    """Several loads at once, p = Σ p_i(φ_i); parts that suck come first. Created by `of`."""

    parts: tuple[Candidate, ...]

    @classmethod
    @lru_cache(maxsize=128)
    def of(cls, parts: tuple[Candidate, ...]) -> "Several":
        """Return the candidate of several parts, with their joined labels.

        The same parts give the same candidate.
        """
        return cls(
            label=AND.join(part.label for part in parts),
            sucks=all(part.sucks for part in parts),
            parts=parts,
        )

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Return the priors of all parts, with names such as `0.x`."""
        numbered = enumerate(part.priors(panel).items() for part in self.parts)
        return {f"{number}.{name}": prior for number, priors in numbered for name, prior in priors}

    def loads(self, parameters: Array) -> list[tuple[Candidate, Array]]:
        return [(part, parameters[share]) for part, share in self._own]

    @cached_property
    def _own(self) -> list[tuple[Candidate, slice]]:
        """Every part with the slice of its φ.

        The numbers of parameters do not depend on the panel.
        """
        ends = [0, *accumulate(len(part.priors(Panel(2, 2))) for part in self.parts)]
        return [(part, slice(*pair)) for part, pair in zip(self.parts, pairwise(ends), strict=True)]

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        """Return the sum of the parts' pressures.

        Returns
        -------
        pressure : array, shape (rows, columns)
            In kPa.
        slopes : array, shape (parameters, rows, columns)
            Derivatives by all φ.
        """
        parts = [part.pressure(panel, patch_mm, values) for part, values in self.loads(parameters)]
        total = np.sum([pressure for pressure, _ in parts], axis=0)
        return total, np.concatenate([slopes for _, slopes in parts])

    def start(self, disc: Disc) -> Array:
        return np.concatenate([part.start(disc) for part in self.parts])

    def blind(self, parameters: Array) -> Array:
        return np.concatenate([part.blind(values) for part, values in self.loads(parameters)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Uniform(Candidate):
    """An equal pressure φ on all cells, which resembles a drift of the whole panel.

    A uniform pressure without numbers is no load.
    """

    numbers: tuple[str, ...] = ()

    def priors(self, panel: Panel) -> Mapping[str, Prior]:
        """Return the prior of the pressure, N(0, 5 kPa) on any panel (an assumption)."""
        return {name: Prior(0, 5) for name in self.numbers}

    def pressure(self, panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
        slopes = np.ones((len(parameters), *panel.shape))
        return np.tensordot(parameters, slopes, 1), slopes

    def start(self, disc: Disc) -> Array:
        return np.zeros(len(self.numbers))


UNIFORM = (Uniform(label="nothing"), Uniform(label="flat load", numbers=("flat",)))
LOADS: tuple[Candidate, ...] = tuple(
    shape.candidate for shape in shape_types() if shape.candidate is not None
)
# Changes of any form, see `lampest.apps.recognition.fit.field_fit`.
FIELD = Uniform(label="unlike any")


def under(panel: Panel, disc: Disc) -> NDArray[np.bool_]:
    """Return the cells whose centre is within a disc enlarged by half a pitch, (rows, columns)."""
    across, down = panel.places_mm
    return np.asarray(
        np.hypot(across - disc.x_mm, down - disc.y_mm) < (disc.diameter_mm + panel.pitch_mm) / 2
    )


@dataclass(frozen=True, eq=False)
class DiscSearch:
    """A matched filter of round templates, centred on every cell and between every four cells.

    Attributes
    ----------
    panel : Panel
    templates : tuple of Template
    discs : tuple of Disc
        Starts of fits, one for each template and place, template by template.
    changes : sparse array, shape (cells, discs)
        ln r/r0 under each template, normalised to unit length.
    """

    panel: Panel
    templates: tuple[Template, ...]
    discs: tuple[Disc, ...]
    changes: csc_array

    @classmethod
    @lru_cache(maxsize=16)
    def over(cls, panel: Panel, patch_mm: float, templates: tuple[Template, ...]) -> "DiscSearch":
        """Return the search with all templates at all places of a panel."""
        discs = []
        patterns = []
        x, y = panel.places_mm[:, panel.present]
        # Complex places: regular panels have few distinct displacements, computed once each.
        places = x + 1j * y
        steps, step = np.unique(np.round(places - places[:, None], 6), return_inverse=True)
        for template in templates:
            size = (template.outer_mm, template.inner_mm)
            pressures = HOLLOW_KPA if template.inner_mm else FULL_KPA
            for shift in (0.0, panel.pitch_mm / 2):
                shifted = Disc(shift, shift, *size, template.inside, -1.0, 0.0, 0.0)
                pattern, _ = pressure_at_places(
                    np.stack([steps.real, steps.imag]), patch_mm, shifted
                )
                patterns.append(csr_array(pattern[step.reshape(len(places), -1)]))
                discs += [
                    Disc(*at, *size, *pressures, 0.0, 0.0)
                    for at in zip(x + shift, y + shift, strict=True)
                ]
        changes = vstack(patterns)
        changes.data /= np.repeat(np.sqrt(changes.power(2).sum(axis=1)), np.diff(changes.indptr))
        cells = np.flatnonzero(panel.present)[changes.indices]
        shape = panel.crossings, len(discs)
        return cls(
            panel, templates, tuple(discs), csc_array((changes.data, cells, changes.indptr), shape)
        )

    @cached_property
    def faint(self) -> NDArray[np.bool_]:
        """Whether each disc's template is used for detection in noise, (discs,)."""
        return np.repeat(
            [template.faint for template in self.templates], len(self.discs) // len(self.templates)
        )

    @cached_property
    def places(self) -> Array:
        """Centres of the faint discs, (faint discs, 2) mm."""
        return np.array([disc[:2] for disc in self.discs])[self.faint]

    def matched(self, response: Array) -> csc_array:
        """Return the faint templates t, (cells, faint discs), scaled to |B t| = 1.

        Parameters
        ----------
        response : array, shape (n, cells)
            B, the derivative of the whitened readings by ln r.
        """
        templates = self.changes[:, self.faint]
        square = templates.multiply((response.T @ response) @ templates).sum(axis=0)
        return csc_array(templates @ diags_array(1 / np.sqrt(np.maximum(square, 1e-300))))

    def lies_on(self, logarithm: Array) -> bool:
        """Return whether unloaded cells are uneven in the shape of a load.

        The criterion is tᵀδ > MAX_UNEVENNESS σ for a template t. δ is ln r less its median, and σ
        its robust standard deviation, at least that of an even film. Templates are negative where a
        load decreases ln r, so that only a positive tᵀδ counts. δ is clipped at SIGNIFICANT σ, so
        that a faulty cell is not taken for a load.

        Parameters
        ----------
        logarithm : array, shape (rows, columns)
            ln r; NaN for cells that are known to be broken.
        """
        intact = self.panel.present & ~np.isnan(logarithm)
        deviation = np.where(intact, logarithm - np.median(logarithm[intact]), 0.0)
        sd = max(MAD_TO_SIGMA * float(np.median(np.abs(deviation[intact]))), RESPONSE_SD)
        drawn_in = np.clip(deviation.ravel(), -SIGNIFICANT * sd, SIGNIFICANT * sd)
        return bool(np.max(drawn_in @ self.changes) > MAX_UNEVENNESS * sd)

    def starts(self, slope: Array, error: Array) -> dict[Template, Disc]:
        """Return the disc with the largest gain of ln P, (tᵀb)²/tᵀΛt, for each template.

        Templates decrease ln r/r0, so that only a positive tᵀb counts.

        Parameters
        ----------
        slope, error : array, shapes (readings, cells) and (readings,)
            A and e of `CellLikelihood`: Λ = AᵀA and b = Aᵀe.
        """
        patterns = self.changes.T
        pulled = patterns @ (slope.T @ error)
        size = patterns.multiply(patterns @ (slope.T @ slope)).sum(axis=1)
        gain = pulled * np.abs(pulled) / np.maximum(size, 1e-300)
        best = np.argmax(gain.reshape(len(self.templates), -1), axis=1)
        size = len(self.discs) // len(self.templates)
        return {
            template: self.discs[at * size + int(best[at])]
            for at, template in enumerate(self.templates)
        }
