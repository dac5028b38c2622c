"""Comparison of fits by their evidence, P(fit | frame) ∝ e^(evidence·EVIDENCE_SHARE)·P(fit).

The prior is equal for all kinds, except that further loads, suction that raises no cell, and loads in one place are
improbable. Otherwise rims that cancel suction between patches would fit any outline.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, hypot, log

import numpy as np
from scipy.special import softmax

from lampest.loads.recognition.candidates import FIELD, UNIFORM, under
from lampest.loads.recognition.fit import MAX_LOG_RATIO, Fit
from lampest.loads.recognition.observation import Observation
from lampest.loads.shapes.disc import Disc
from lampest.panel.panel import Panel
from lampest.panel.response import PUBLISHED

# Assumed −ln P: of one in twenty, for every further load, a rim that moves without its suction, and a mouth that does
# not breathe; and of the impossible, hidden suction and two loads in one place. Such combinations fit loads that are no
# candidates with up to e⁶⁰ times their evidence.
RARE_LOG_ODDS, IMPOSSIBLE = log(20), 60.0
# ln r/r0 that a panel shows clearly, a suction of 1 kPa; and the share of the change that a cell under suction alone
# would have. Mouths of 24 to 45 mm at a pitch of 10 mm have more than 0.7 in some cell, and nine in ten more than 0.9.
# Of 60 mouths pressed with 30 to 80 kPa more, 47 are recognised with a share of 0.35, 52 with 0.25; with 0.2 or less
# two mouths 70 mm apart are taken for one. Hands, rocks, fins, fish, rods and rings raise no cell by more than 0.1.
MIN_RISE, MIN_RISE_SHARE = 0.2, 0.25
# Exponent of evidence ratios, because films and loads deviate from their models in more ways than the errors include.
# Fitted by log-likelihood to scenes made without this package's simulation; see docs/studies/mouths.md.
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
    evidence : float
        Largest evidence plus ln prior of a fit, up to a constant common to all fits of the frame.
    """

    fits: tuple[Fit, ...]
    shares: tuple[float, ...]
    goodness: float
    evidence: float

    @classmethod
    def of(cls, panel: Panel, fits: Sequence[Fit], frame: Observation) -> "Verdict":
        """Return the verdict on the fits of a frame.

        Where no candidate explains the frame, differences of evidence are divided by χ² per reading of the best fit.
        """
        before = np.array([prior_cost(panel, fit, frame) for fit in fits])
        evidence = np.array([fit.evidence for fit in fits])
        goodness = fits[int(np.argmax(evidence - before))].chi2 / frame.measured.size
        counts = (EVIDENCE_SHARE if len(fits) > len(UNIFORM) else 1.0) / max(1.0, goodness)
        shares = softmax(counts * evidence - before)
        return cls(tuple(fits), tuple(map(float, shares)), goodness, float(max(evidence - before)))

    @property
    def best(self) -> Fit:
        """The most probable fit."""
        return self.fits[int(np.argmax(self.shares))]

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
        """Return the probability that a load at a disc's place sucks, given that there is a load; None: anywhere."""
        pairs = zip(self.fits, self.shares, strict=True)
        return sum(share for fit, share in pairs if _sucks(fit, disc)) / max(1 - self.nothing, 1e-9)


def prior_cost(panel: Panel, fit: Fit, frame: Observation | None = None) -> float:
    """Return −ln prior of a fit, up to a constant: further loads, hidden suction, and overlapping loads are improbable.

    Parameters
    ----------
    panel : Panel
    fit : Fit
    frame : Observation, optional
        Frame whose map of cells has to show the suction, too.
    """
    response = PUBLISHED if frame is None else frame.baseline.response
    loads = [(part, part.disc(own)) for part, own in fit.loads]
    cost = sum(_overlapping(*pair) for pair in combinations([disc for _, disc in loads if disc is not None], 2))
    for part, disc in loads:
        if part.sucks:
            under_disc = np.ones(panel.shape, dtype=bool) if disc is None or len(loads) == 1 else under(panel, disc)
            full = 0.0 if disc is None else float(np.mean(response.gains * response.logarithm(disc.suction_kpa)))
            maps = [fit.change] if frame is None else [fit.change, frame.highest]
            rise = min(float(pressure[under_disc].max(initial=0.0)) for pressure in maps)
            cost += _hidden(rise, full)
    return RARE_LOG_ODDS * (len(loads) - 1) + IMPOSSIBLE * cost


def rises(frame: Observation) -> bool:
    """Return whether some cell may rise enough for suction to be possible; otherwise no suction is searched."""
    return IMPOSSIBLE * _hidden(float(frame.highest.max()), 0.0) < 2 * MAX_LOG_RATIO


def _hidden(rise: float, full: float) -> float:
    """Return 1 if no cell rises under suction that would raise a cell by `full`, 0 if one does; both in ln r/r0."""
    return exp(-((rise / max(MIN_RISE, MIN_RISE_SHARE * full)) ** 2))


def _overlapping(first: Disc, second: Disc) -> float:
    """Return 1 if two discs are in one place, 0 if they do not overlap, smoothly between."""
    apart = hypot(first.x_mm - second.x_mm, first.y_mm - second.y_mm)
    common = (first.diameter_mm + second.diameter_mm) / 2 - apart
    share = max(common, 0.0) / min(first.diameter_mm, second.diameter_mm)
    return 1 - exp(-((share / MIN_RISE_SHARE) ** 2))


def _sucks(fit: Fit, disc: Disc | None) -> bool:
    """Return whether one of the fit's loads sucks, with its centre within the disc."""
    discs = [part.disc(own) for part, own in fit.loads if part.sucks]
    if disc is None:
        return bool(discs)
    apart = [hypot(place.x_mm - disc.x_mm, place.y_mm - disc.y_mm) for place in discs if place is not None]
    return min(apart, default=disc.diameter_mm) < disc.diameter_mm / 2
