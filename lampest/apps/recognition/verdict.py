"""Comparison of the fits of one frame.

The posterior is P(fit | frame) ∝ e^(evidence·EVIDENCE_SHARE)·P(fit). The prior is equal for all
kinds, except that further loads, and loads in one place, are improbable. Whether a load sucks is
not decided by fits, but by its cells (`lampest.apps.recognition.suction`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, hypot, log

import numpy as np
from scipy.special import expit, softmax

from lampest.apps.recognition.candidates import FIELD, UNIFORM
from lampest.apps.recognition.fit import Fit
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.suction import UNRISEN, Suction, inner_cells, rise_odds
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array
from lampest.recording.shapes.disc import Disc

# χ² of a reading beyond which a fit is refuted by its own misfit: films that keep a part of a load,
# and shapes that are not quite theirs, have less (tests/apps/recognition/test_detector.py).
MAX_MISFIT = 10.0
# Assumed −ln P: of one in twenty, for every further load, a rim that moves without its suction, and
# a mouth that does not breathe; and of the impossible, two loads in one place.
RARE_LOG_ODDS = log(20)
IMPOSSIBLE = 60.0
OVERLAP = 0.25  # share of the smaller diameter by which two loads may overlap: soft rims touch
# Exponent of evidence ratios, because films and loads deviate from their models in more ways than
# the errors include. Fitted by log-likelihood to scenes made without this package's simulation
# (docs/studies/mouth_scenes.py).
EVIDENCE_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on a frame.

    Attributes
    ----------
    fits : tuple of Fit
        Fits of UNIFORM first, and nothing else where the frame does not stand out.
    shares : tuple of float
        Posterior probability of each fit.
    goodness : float
        χ² per reading of the best fit.
    frame : Observation
        The frame without its outliers.
    cells : Observation
        The frame without readings that no cells explain. What contradicts a shape may be cells
        beside it.
    suctions : tuple of Suction
        Places under suction.
    """

    fits: tuple[Fit, ...]
    shares: tuple[float, ...]
    goodness: float
    frame: Observation
    cells: Observation
    suctions: tuple[Suction, ...] = ()

    @classmethod
    def of(
        cls, fits: Sequence[Fit], frame: Observation, suctions: Sequence[Suction] = ()
    ) -> "Verdict":
        """Return the verdict on the fits of a frame.

        Where no candidate explains the frame, differences of evidence are divided by χ² per reading
        of the best fit. No load is no verdict where its χ² refutes it and another fit explains the
        frame: the prior of a field of many changed cells may outweigh any misfit.
        """
        before = np.array([prior_cost(fit) for fit in fits])
        evidence = np.array([fit.evidence for fit in fits])
        refuted = np.array([fit.chi2 > MAX_MISFIT * frame.measured.size for fit in fits])
        if not refuted.all():
            unloaded = np.array([fit.candidate in UNIFORM for fit in fits])
            evidence = np.where(unloaded & refuted, -np.inf, evidence)
        goodness = fits[int(np.argmax(evidence - before))].chi2 / frame.measured.size
        counts = (EVIDENCE_SHARE if len(fits) > len(UNIFORM) else 1.0) / max(1.0, goodness)
        shares = softmax(counts * evidence - before)
        return cls(tuple(fits), tuple(map(float, shares)), goodness, frame, frame, tuple(suctions))

    @property
    def best(self) -> Fit:
        """The most probable fit."""
        return self.fits[int(np.argmax(self.shares))]

    @property
    def changed(self) -> Array:
        """ln r/r0 of the cells that have clearly changed, and 0 of the others, (rows, columns).

        A shape that agrees with these cells determines their change, because the prior of free
        cells shrinks large changes.
        """
        cells = self.frame.free_map
        shaped = self.best.change
        agreed = np.where(
            cells * shaped > 0, np.maximum(np.abs(cells), np.abs(shaped)), np.abs(cells)
        )
        return np.where(
            np.abs(cells) > NOISE_REACH * self.frame.free_sd, np.sign(cells) * agreed, 0.0
        )

    @property
    def loads(self) -> tuple[Fit, ...]:
        """Fits of loads with a shape, the best first; none where the frame does not stand out."""
        shaped = (fit for fit in self.fits if fit.candidate not in (*UNIFORM, FIELD))
        return tuple(sorted(shaped, key=lambda fit: -fit.evidence))

    @property
    def nothing(self) -> float:
        """Probability that there is no load, or an equal pressure on all cells."""
        pairs = zip(self.fits, self.shares, strict=True)
        return sum(share for fit, share in pairs if fit.candidate in UNIFORM)

    def sucks_at(self, disc: Disc | None) -> float:
        """Return the probability that a load at a disc's place sucks; None: any load.

        Its cells decide, unless fallen cells hide others; then the fitted shapes do. A load without
        a cell that would show its suction has 1/2.
        """

        def near(x_mm: float, y_mm: float) -> bool:
            return disc is None or hypot(x_mm - disc.x_mm, y_mm - disc.y_mm) < disc.diameter_mm / 2

        risen = [place.probability for place in self.suctions if near(place.x_mm, place.y_mm)]
        if risen:
            return max(risen)
        if self.suctions or not self.by_shapes:
            if disc is None:
                return UNRISEN
            inner = inner_cells(self.frame.panel, (disc.x_mm, disc.y_mm), disc.diameter_mm)
            return float(expit(min(rise_odds(self.cells, inner), 0.0)))
        total = 0.0
        for fit, share in zip(self.fits, self.shares, strict=True):
            discs = [part.disc(values) for part, values in fit.loads if part.sucks]
            total += share * any(
                sucking is not None and near(sucking.x_mm, sucking.y_mm) for sucking in discs
            )
        return total / max(1 - self.nothing, 1e-9)

    @property
    def by_shapes(self) -> bool:
        """Whether the fitted shapes decide whether something sucks, because cells are hidden."""
        return not self.suctions and any(part.sucks for fit in self.fits for part, _ in fit.loads)


def prior_cost(fit: Fit) -> float:
    """Return −ln prior of a fit, up to a constant.

    Further loads, and overlapping loads, are improbable.
    """
    overlapping = sum(_overlapping(*pair) for pair in combinations(fit.discs, 2))
    return RARE_LOG_ODDS * (len(fit.loads) - 1) + IMPOSSIBLE * overlapping


def _overlapping(first: Disc, second: Disc) -> float:
    """Return 1 if two discs are in one place, 0 if they do not overlap, smoothly between."""
    common = (first.diameter_mm + second.diameter_mm) / 2 - hypot(
        first.x_mm - second.x_mm, first.y_mm - second.y_mm
    )
    share = max(common, 0.0) / min(first.diameter_mm, second.diameter_mm)
    return 1 - exp(-((share / OVERLAP) ** 2))
