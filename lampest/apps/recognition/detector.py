"""Recognition of a single frame.

Cells that have risen decide whether something sucks, and where. Each such place gets the disc that
explains its cells. Where nothing sucks, cells of any form tell a load from none.
"""

from dataclasses import dataclass

import numpy as np

from lampest.apps.recognition.disc_search import DiscSearch
from lampest.apps.recognition.field import field_fit, without_load
from lampest.apps.recognition.observation import Observation, Whitening, alone, outliers
from lampest.apps.recognition.sucking_disc import SuckingDisc
from lampest.apps.recognition.suction import suctions
from lampest.apps.recognition.verdict import Verdict
from lampest.files.levels import MAX_MEAN_SQUARE, SIGNIFICANT
from lampest.panel.panel import Panel

MAX_SUCKING = 3  # places that suck at once


@dataclass(frozen=True, eq=False)
class Detector:
    """Recognition of loads in single frames.

    Attributes
    ----------
    patch_mm : float
        Edge of a cell's film.
    any_form : bool
        Whether the panel is a mat, on which nothing sucks.
    """

    patch_mm: float
    any_form: bool = False

    def search(self, panel: Panel) -> DiscSearch:
        """Return the matched filter of round loads."""
        return DiscSearch.over(panel, self.patch_mm)

    def verdict(self, frame: Observation) -> Verdict:
        """Return the verdict on a frame.

        Cells rise, too, where the panel drifts. No disc explains them then.
        """
        undisturbed = self.calm(frame)
        if undisturbed is not None:
            return Verdict(undisturbed, np.zeros(frame.measured.shape), nothing=1.0)
        field, calm = field_fit(frame)
        places = [] if self.any_form else suctions(calm)[:MAX_SUCKING]
        response = calm.baseline.response
        discs = [SuckingDisc(calm, place, self.patch_mm, response) for place in places]
        explaining = [disc for disc in discs if disc.goodness < MAX_MEAN_SQUARE]
        return Verdict.of(calm, field, without_load(calm), explaining)

    def calm(self, frame: Observation) -> Observation | None:
        """Return the frame without outliers if it shows no load; else None.

        To show no load, it must show one neither by χ² nor by a template. In a circuit without
        crosstalk a pressed cell changes its own reading alone, as an outlier does; but a contact
        has neighbouring cells, so that only readings without an outlying neighbour are left out.
        """
        whitening = Whitening.about(frame)
        residual = frame.residual()
        undisturbed = frame.without(alone(frame.panel, outliers(whitening, residual)))
        errors = Whitening.about(undisturbed) @ residual
        if errors @ errors >= MAX_MEAN_SQUARE * errors.size:
            return None
        response = whitening @ frame.slope()
        # scores (B t)ᵀ e of the templates, N(0, 1) without a load
        stands_out = self.search(frame.panel).matched(response).T @ (response.T @ errors)
        return undisturbed if stands_out.max() < SIGNIFICANT else None
