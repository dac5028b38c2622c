"""Recognition of a single frame: whether there is a load, and where it sucks.

Cells that have risen decide whether something sucks, and where
(`lampest.apps.recognition.suction`). Each such place gets the disc that explains its cells. Cells
of any form tell a load from none: the posterior of no load against a field is
P ∝ e^(evidence·EVIDENCE_SHARE). In a field each cell has one of four states, from quiet to strongly
changed, with a Potts prior on neighbours. The evidence integrates over the cells about the most
probable ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp

from lampest.apps.recognition.disc_search import DiscSearch
from lampest.apps.recognition.hypotheses import EVIDENCE_SHARE
from lampest.apps.recognition.most_probable import Whitening, outliers
from lampest.apps.recognition.mouth_model import SuckingDisc
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.suction import MIN_RISE, suctions
from lampest.files.levels import MAX_MEAN_SQUARE, NOISE_REACH, SIGNIFICANT
from lampest.panel.panel import Array, Numbers, Panel

# Assumed standard deviations of ln r/r0 in the four states: no load, half a kPa, a few kPa, tens of
# kPa.
SD = np.array([0.005, 0.08, 0.4, 1.6])
# Assumed standard deviation of ln r/r0 by a change that all cells share, as by 5 kPa.
UNIFORM_SD = 1.0
# χ² of a reading beyond which an explanation is refuted by its own misfit: films that keep a part
# of a load have less (tests/apps/recognition/test_detector.py).
MAX_MISFIT = 10.0
MIN_RELIEVED = 3  # cells that rise where a load left: one or two are even by chance
# Of the unevenness of cells under a load, which is left where it has gone: films keep an eighth.
MAX_REMAINING = 0.25
MAX_SUCKING = 3  # places that suck at once


@dataclass(frozen=True, eq=False)
class CellsUnderPrior:
    """The most probable change of all cells under a prior.

    Attributes
    ----------
    change : array, shape (rows, columns)
        x = ln r/r0.
    evidence : float
        ln of the frame's probability under the prior, up to a constant common to all priors.
    chi2 : float
        χ² of the readings about x.
    contradicting : integer array
        Numbers of the readings that x does not explain as the others.
    """

    change: Array
    evidence: float
    chi2: float
    contradicting: Numbers

    @classmethod
    def of(
        cls, frame: Observation, start: Array, covariance: Array, log_prior: float = 0.0
    ) -> "CellsUnderPrior":
        """Return the explanation of a frame by cells x ~ N(0, P).

        The evidence is −½ eᵀ (A P Aᵀ + C)⁻¹ e − ½ ln det (A P Aᵀ + C) + ln P(prior).

        Parameters
        ----------
        frame : Observation
        start : array, shape (rows, columns)
            Initial x.
        covariance : array, shape (cells, cells)
            P.
        log_prior : float
            ln probability of the prior itself.
        """
        most_probable = frame.cells(start, covariance)
        change = most_probable.state.reshape(start.shape)
        misfit = Whitening.of(most_probable.noise) @ frame.residual(change)
        chi2 = float(misfit @ misfit)
        contradicting = np.zeros(0, dtype=np.intp)
        if chi2 >= MAX_MEAN_SQUARE * frame.measured.size:
            contradicting = outliers(most_probable.whitening, most_probable.apart)
        evidence = log_prior - most_probable.misfit / 2 - most_probable.whitening.volume
        return cls(change, evidence, chi2, contradicting)


def without_load(frame: Observation) -> list[CellsUnderPrior]:
    """Return the explanations by no load, and by a common change of all cells."""
    level = frame.common_change
    common = UNIFORM_SD**2 * np.outer(level.unit, level.unit) + level.uneven
    start = np.zeros(frame.measured.shape)
    return [CellsUnderPrior.of(frame, start, each) for each in (np.zeros_like(common), common)]


def field_fit(frame: Observation) -> tuple[CellsUnderPrior, Observation]:
    """Return the most probable field, and the frame without outliers.

    x = ln r/r0 is Gaussian with the σ of each cell's state, correlated between neighbours. The
    states are those of free cells, or of a first field, and have a Potts prior.
    """
    field = _field(frame)
    if not field.contradicting.size:
        return field, frame
    calm = frame.without(field.contradicting)
    return max((field, frame), (_field(calm), calm), key=lambda pair: pair[0].evidence)


def _field(frame: Observation) -> CellsUnderPrior:
    """Return the more probable of two fields: with the states of free cells, and of the first."""
    fields = list[CellsUnderPrior]()
    start = frame.free_map
    for _ in range(2):
        of_cells = states(frame.panel, start)
        covariance = prior(frame, SD[of_cells].ravel())
        log_prior = -potts_cost(frame.panel, of_cells)
        fields.append(CellsUnderPrior.of(frame, start, covariance, log_prior))
        start = fields[-1].change
    return max(fields, key=attrgetter("evidence"))


def prior(frame: Observation, sd: Array) -> Array:
    """Return the prior covariance of ln r/r0 of cells with these standard deviations.

    Neighbours are correlated.
    """
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near)


def states(panel: Panel, change: Array) -> Numbers:
    """Return the state of each cell, 0 to 3 for quiet to strongly changed.

    The changes of the cell and of its neighbours determine the state.
    """
    square = change.ravel() ** 2
    pairs = np.array(panel.neighbours[:2])
    cell = pairs.ravel()
    near = np.bincount(cell, square[pairs[::-1].ravel()], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    # a cell at the border stands for its missing neighbours
    near += np.maximum(4 - sides, 0) * square
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * near), limits)).reshape(change.shape)


def potts_cost(panel: Panel, of_cells: Numbers) -> float:
    """Return −ln P of the states in the Potts field.

    Each pair of unlike neighbours costs 1 (an assumption); a constant normalises the probability.
    """
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())


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


def is_as_before(verdict: Verdict, earlier: Array) -> bool:
    """Return whether the panel rather is as it was without a load at an earlier time.

    A load that settles slowly, or is so weak that it is no step, becomes a part of the baseline,
    from which the panel differs when it leaves. The changed cells have less than MAX_REMAINING of
    their sum of squares then, if they are compared with the panel before that load. A change that
    all cells share does not count.

    Parameters
    ----------
    verdict : Verdict
    earlier : array, shape (rows, columns)
        ln r of the panel without a load at the earlier time.
    """
    frame = verdict.frame
    intact = frame.panel.present & ~frame.baseline.scene.broken
    changed = intact & (verdict.changed != 0)
    before = frame.free_map + frame.baseline.logarithm - earlier
    squares = [
        np.sum((change - np.median(change[intact & ~changed]))[changed] ** 2)
        for change in (frame.free_map, before)
    ]
    return bool(squares[1] < MAX_REMAINING * squares[0])


class Detector(NamedTuple):
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
        discs = [SuckingDisc(calm, place, self.patch_mm) for place in places]
        explaining = [disc for disc in discs if disc.goodness < MAX_MEAN_SQUARE]
        return Verdict.of(calm, field, without_load(calm), explaining)

    def calm(self, frame: Observation) -> Observation | None:
        """Return the frame without outliers if it shows no load; else None.

        To show no load, it must show one neither by χ² nor by a template. In a circuit without
        crosstalk a pressed cell changes its own reading alone, as an outlier does; but a contact
        has neighbouring cells, so that only readings without an outlying neighbour are left out.
        """
        whitening = frame.whitening()
        residual = frame.residual()
        undisturbed = frame.without(alone(frame.panel, outliers(whitening, residual)))
        errors = undisturbed.whitening() @ residual
        if errors @ errors >= MAX_MEAN_SQUARE * errors.size:
            return None
        response = whitening @ frame.slope()
        # scores (B t)ᵀ e of the templates, N(0, 1) without a load
        stands_out = self.search(frame.panel).matched(response).T @ (response.T @ errors)
        return undisturbed if stands_out.max() < SIGNIFICANT else None


def alone(panel: Panel, cells: Numbers) -> Numbers:
    """Return those of the numbered cells that have no neighbour among them."""
    first, second, _ = panel.neighbours
    both = np.isin(first, cells) & np.isin(second, cells)
    return np.setdiff1d(cells, np.concatenate([first[both], second[both]]))
