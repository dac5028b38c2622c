"""Matched filters of round loads: on the cells at rest, and on steps of the readings.

Steps are loads that arrive, change or leave. A change of the logarithms of the readings is compared
with the change that a disc at each place would cause. Errors of an unloaded panel are whitened
first, so that drift and changes of all cells are no steps.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array, vstack

from lampest.apps.recognition.most_probable import Whitening
from lampest.apps.recognition.mouth_model import EVEN, pressure_at_places
from lampest.apps.recognition.observation import Observation
from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH, OUTLIER_THRESHOLD, SIGNIFICANT
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.response import RESPONSE_SD
from lampest.recording.shapes.disc import Disc

# Standard deviations of a template's score. Of 720 bare panels with films uneven by 12 to 25 %,
# some with correlated neighbours or with faulty cells, the largest score was 6.3.
MAX_UNEVENNESS = 8.0
# Reach of a load about its place in pitches: half of the widest mouth, and a cell.
NEAR_PITCHES = 3.0


class Template(NamedTuple):
    """A disc that is compared with unloaded cells, and with steps, at all places.

    Attributes
    ----------
    outer_mm, inner_mm : float
        Diameters; `inner_mm` is 0 for a full disc.
    inside : float
        Effect of the inside on ln r: 0 for none, 1 for the opposite of the rim's.
    faint : bool
        Whether the template is also used to detect that something stands out of a panel at rest.
    """

    outer_mm: float
    inner_mm: float = 0.0
    inside: float = 0.0
    faint: bool = False


TEMPLATES = (
    # rods
    Template(40.0, faint=True),
    Template(25.0, faint=True),
    # rings
    Template(22.0, 11.0, faint=True),
    Template(42.0, 32.0),
    Template(32.0, 21.0),
    # mouths in which the suction changes cells as much as the rim does
    Template(45.0, 32.0, 1.0),
    Template(34.0, 22.0, 1.0),
    Template(24.0, 12.0, 1.0),
)


class DiscSearch(NamedTuple):
    """A matched filter of round templates, centred on every cell and between every four cells.

    Attributes
    ----------
    panel : Panel
    changes : sparse array, shape (cells, discs)
        ln r/r0 under each template at all places, template by template, of unit length.
    faint : boolean array, shape (discs,)
        Whether each disc's template is used for detection in noise.
    places : array, shape (faint discs, 2)
        Centres of the faint discs, mm.
    """

    panel: Panel
    changes: csc_array
    faint: Mask
    places: Array

    @classmethod
    @lru_cache(maxsize=16)
    def over(
        cls, panel: Panel, patch_mm: float, templates: tuple[Template, ...] = TEMPLATES
    ) -> "DiscSearch":
        """Return the search with all templates at all places of a panel."""
        x, y = panel.places_mm[:, panel.present]
        # Complex places: regular panels have few distinct displacements, computed once each.
        places = x + 1j * y
        steps, step = np.unique(np.round(places - places[:, None], 6), return_inverse=True)
        shifts = (0.0, panel.pitch_mm / 2)
        patterns = []
        for template, shift in product(templates, shifts):
            size = (template.outer_mm, template.inner_mm)
            shifted = Disc(shift, shift, *size, template.inside, -1.0, 0.0, 0.0)
            displacements = np.stack([steps.real, steps.imag])
            (pattern,) = pressure_at_places(displacements, patch_mm, np.array([*shifted, *EVEN]))
            patterns.append(csr_array(pattern[step.reshape(len(places), -1)]))
        changes = vstack(patterns)
        changes.data /= np.repeat(np.sqrt(changes.power(2).sum(axis=1)), np.diff(changes.indptr))
        cells = np.flatnonzero(panel.present)[changes.indices]
        shape = panel.crossings, changes.shape[0]
        centres = np.vstack([np.column_stack([x + shift, y + shift]) for shift in shifts])
        faint = [template.faint for template in templates]
        return cls(
            panel,
            csc_array((changes.data, cells, changes.indptr), shape),
            np.repeat(faint, len(centres)),
            np.tile(centres, (sum(faint), 1)),
        )

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
        sd = max(MAD_TO_SIGMA * np.median(np.abs(deviation[intact])), RESPONSE_SD)
        drawn_in = np.clip(deviation.ravel(), -SIGNIFICANT * sd, SIGNIFICANT * sd)
        return bool(np.max(drawn_in @ self.changes) > MAX_UNEVENNESS * sd)


@dataclass(frozen=True, eq=False)
class StepTest:
    """Matched filter for steps, |t_kᵀ W δ| > OUTLIER_THRESHOLD·v_k of a change δ of ln y.

    W whitens the errors of an unloaded panel; changes that all cells share have a large variance
    and do not count.

    Attributes
    ----------
    templates : sparse array, shape (cells, discs)
        ln r/r0 under discs; t_k = W S · template has unit length, with S = d ln y/d ln r.
    filter : array, shape (cells, cells)
        (W S)ᵀ W.
    places : integer array, shape (discs,)
        Number of the place of each disc.
    near : boolean array, shape (places, places)
        Whether two places are within NEAR_PITCHES.
    whitening : array, shape (cells, cells)
        W.
    loud : array, shape (discs,)
        v_k², the mean square score in frames without a load, which includes unspecified ripple and
        noise.
    """

    templates: csc_array
    filter: Array
    places: NDArray[np.intp]
    near: NDArray[np.bool_]
    whitening: Array
    loud: Array

    @classmethod
    def of(cls, frame: Observation, search: DiscSearch, unloaded: Array) -> "StepTest":
        """Return the test about a panel at rest.

        Parameters
        ----------
        frame : Observation
            Unloaded readings with the noise of one frame.
        search : DiscSearch
        unloaded : array, shape (frames, cells)
            ln y of the unloaded frames.
        """
        value = frame.measured.ravel()
        cells = frame.measured.size
        slope = frame.slope() / value[:, None]
        errors = frame.baseline.model_errors
        # C = noise + drift S Sᵀ + common changes of all cells and of all readings; W = L⁻¹ of C = L
        # Lᵀ
        settled = errors.settled**2 * slope @ slope.T
        swaying = errors.swaying * np.column_stack([slope.sum(axis=1), np.ones(cells)])
        columns = np.hstack([swaying, frame.common(frame.measured) / value[:, None]])
        noise = np.diag((frame.sigma.ravel() / value) ** 2)
        whitening = Whitening.of(noise + settled + columns @ columns.T).matrix
        response = whitening @ slope
        templates = search.matched(response)
        matched = response.T @ whitening
        places, place = np.unique(search.places, axis=0, return_inverse=True)
        x, y = places.T / frame.panel.pitch_mm
        near = np.hypot(x[:, None] - x, y[:, None] - y) < NEAR_PITCHES
        scores = (templates.T @ (matched @ unloaded.T)).T
        spreads = [np.mean((first - second) ** 2) / 2 for first, second in combinations(scores, 2)]
        # robust: an outlier frame is part of many pairs
        usual = np.quantile(spreads or [1.0], 0.25, method="lower")
        loud = np.full(len(place), max(usual, 1.0))
        return cls(templates, matched, place, near, whitening, loud)

    def scores(self, change: Array) -> Array:
        """Return |t_kᵀ W δ|, (discs,), of a change δ of ln y, (cells,)."""
        return np.asarray(np.abs(self.templates.T @ (self.filter @ change)))

    def sizes(self, change: Array) -> Array:
        """Return the largest score of a change within NEAR_PITCHES of each disc, (discs,)."""
        largest = np.zeros(len(self.near))
        np.maximum.at(largest, self.places, self.scores(change))
        return np.asarray(np.where(self.near, largest, 0.0).max(axis=1)[self.places])

    def after(self, scores: Array, share: Array | float) -> "StepTest":
        """Return the test after the scores, (discs,), of a frame without a load.

        v_k² is a running mean; a score counts up to NOISE_REACH v_k, so that a change which is just
        no step does not hide the next one. `share` is the weight of the frame, of each disc or all.
        """
        square = np.minimum(scores**2, NOISE_REACH**2 * np.maximum(self.loud, 1.0))
        return replace(self, loud=self.loud + share * (square - self.loud))

    def least(self) -> Array:
        """Return the thresholds of the scores, OUTLIER_THRESHOLD·v_k, (discs,)."""
        return np.asarray(
            OUTLIER_THRESHOLD * np.sqrt(np.maximum(self.loud, max(1.0, self.loud.mean())))
        )
