"""Verdict on one frame: whether there is a load, and where it sucks.

The posterior of no load against one of any form is P ∝ e^(evidence·EVIDENCE_SHARE). Whether a load
sucks is decided by its cells (`lampest.apps.recognition.suction`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist

import numpy as np
from scipy.special import expit, logsumexp

from lampest.apps.recognition.field import CellsUnderPrior
from lampest.apps.recognition.hypotheses import EVIDENCE_SHARE
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.sucking_disc import SuckingDisc
from lampest.apps.recognition.suction import MIN_RISE, inner_cells, rise_odds
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array

# χ² of a reading beyond which an explanation is refuted by its own misfit: films that keep a part
# of a load have less (tests/apps/recognition/test_detector.py).
MAX_MISFIT = 10.0
MIN_RELIEVED = 3  # cells that rise where a load left: one or two are even by chance
# Of the unevenness of cells under a load, which is left where it has gone: films keep an eighth.
MAX_REMAINING = 0.25


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on a frame.

    Attributes
    ----------
    frame : Observation
        The frame without readings that no cells explain.
    change : array, shape (rows, columns)
        Most probable ln r/r0: of the discs, or of cells under a load of any form; 0 without a load.
    nothing : float
        Probability that there is no load, or an equal pressure on all cells.
    clear : float
        ln evidence of a load over that of none.
    discs : tuple of SuckingDisc
        Loads that suck.
    """

    frame: Observation
    change: Array
    nothing: float
    clear: float = 0.0
    discs: tuple[SuckingDisc, ...] = ()

    @classmethod
    def of(
        cls,
        frame: Observation,
        field: CellsUnderPrior,
        without: Sequence[CellsUnderPrior],
        discs: Sequence[SuckingDisc] = (),
    ) -> "Verdict":
        """Return the verdict by the evidence of a field, and of the explanations without a load.

        Where the field does not explain the frame either, differences of evidence are divided by
        its χ² per reading. No load is no verdict where its χ² refutes it, and not that of the
        field: the prior of a field of many changed cells may outweigh any misfit.
        """
        most = MAX_MISFIT * frame.measured.size
        possible = [
            unloaded.evidence for unloaded in without if unloaded.chi2 <= most or field.chi2 > most
        ]
        clear = field.evidence - max(unloaded.evidence for unloaded in without)
        counts = EVIDENCE_SHARE / max(1.0, field.chi2 / frame.measured.size)
        odds = logsumexp(counts * np.array([*possible, -np.inf])) - counts * field.evidence
        change = np.sum([disc.point.own for disc in discs], axis=0) if discs else field.change
        return cls(frame, change, float(expit(odds)), clear, tuple(discs))

    @property
    def changed(self) -> Array:
        """ln r/r0 of the cells that have clearly changed, and 0 of the others, (rows, columns).

        A change that agrees with these cells determines theirs, because the prior of free cells
        shrinks large changes.
        """
        cells = self.frame.free_map
        size = np.abs(cells)
        sign = np.sign(cells)
        clear = size > NOISE_REACH * self.frame.free_sd
        return np.where(clear, sign * np.maximum(size, sign * self.change), 0.0)

    def sucks_at(self, centre: tuple[float, float], diameter_mm: float) -> float:
        """Return the probability that a round load sucks, with its centre in mm.

        Its cells decide. A load without a cell that would show its suction has 1/2.
        """
        near = [
            sucking.place.probability
            for sucking in self.discs
            if dist(sucking.place.centre, centre) < diameter_mm / 2
        ]
        if near:
            return max(near)
        inner = inner_cells(self.frame.panel, centre, diameter_mm)
        return float(expit(min(rise_odds(self.frame, inner), 0.0)))


def relieved_by_departure(verdict: Verdict) -> bool:
    """Return whether the first change of a panel is a load that left.

    Cells that a load leaves rise: half of those that changed, and at least MIN_RELIEVED. Before,
    their deviations from the median of all are as uneven as loads make them; afterwards they have
    less than MAX_REMAINING of the former sum of squares.

    Parameters
    ----------
    verdict : Verdict
        Recognition of the first change.
    """
    frame = verdict.frame
    intact = frame.panel.present & ~frame.baseline.scene.broken
    least = np.maximum(MIN_RISE, NOISE_REACH * frame.free_sd)
    changed = intact & (np.abs(frame.free_map) > least)
    risen = changed & (frame.free_map > 0)
    if risen.sum() < max(MIN_RELIEVED, changed.sum() / 2):
        return False
    before = frame.baseline.logarithm - np.median(frame.baseline.logarithm[intact])
    after = before + frame.free_map
    return bool(np.sum(after[changed] ** 2) < MAX_REMAINING * np.sum(before[changed] ** 2))
