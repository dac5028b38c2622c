"""What counts against a fit before anything is measured: further loads, suction that no cell shows, loads in one place.

Between patches a rim can be made to cancel suction, and one load can stand within another: then they fit any outline on
the panel, and of such outlines there are many more than candidates.
"""

from itertools import combinations
from math import exp, hypot, log

import numpy as np

from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.several import Several
from lampest.loads.response import gains_of, log_ratio_from_pressure
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Response

RARER = log(20)  # ln of how much rarer every further load is; an assumption
# What is no candidate is fitted by such loads with up to e⁶⁰ times the evidence of any other: the cost of never being
# sure of them. Where they fit as well as a hollow load does, they are named all the same.
HIDDEN = 60.0
IN_EACH_OTHER = 20.0  # of two loads in one place; an assumption
# ln r/r0 that a panel shows clearly, a suction of 1 kPa; and the part of what a cell under suction alone would
# show. Mouths of 24 to 45 mm at a pitch of 10 mm show more than 0.7 in some cell, and nine in ten more than 0.9.
SHOWN, SHARE = 0.2, 0.35
OVERLAP = 0.3  # of the smaller one's diameter: less may be the error of both edges


def prior_cost(panel: Panel, fit: Fit, response: Response | None = None) -> float:
    """−ln P of a fit before the measurement, up to what all share. response : the scene's own; None: the published."""
    return RARER * further(fit.candidate) + outline_cost(panel, fit, response)


def further(candidate: Candidate) -> int:
    """How many loads it has beside the first."""
    return len(candidate.parts) - 1 if isinstance(candidate, Several) else 0


def outline_cost(panel: Panel, fit: Fit, response: Response | None = None) -> float:
    """By how much ln P falls of suction that raises no cell, and of loads that stand in each other; 0 for all others.

    By HIDDEN and IN_EACH_OTHER, and by nothing where a cell clearly rises, or loads stand clear.
    """
    if not isinstance(fit.candidate, Several):
        disc = fit.candidate.disc(fit.parameters) if fit.candidate.sucks else None
        return _hidden(_rise(panel, fit.change, None), disc, response) if fit.candidate.sucks else 0.0
    parts = fit.candidate.parts
    discs = [part.disc(own) for part, own in zip(parts, fit.candidate.split(fit.parameters), strict=True)]
    cost = sum(_overlapping(*pair) for pair in combinations([disc for disc in discs if disc is not None], 2))
    for part, disc in zip(parts, discs, strict=True):
        cost += _hidden(_rise(panel, fit.change, disc), disc, response) if part.sucks else 0.0
    return cost


def _rise(panel: Panel, change: Array, disc: Disc | None) -> float:
    """The most that ln r rises on all the panel, or under a disc; no less than 0."""
    if disc is None:
        return max(float(change.max()), 0.0)
    across, down = panel.centres_mm()
    near = np.hypot(across - disc.x_mm, down[:, None] - disc.y_mm) < (disc.diameter_mm + panel.pitch_mm) / 2
    return float(change[near].max(initial=0.0))


def _hidden(rise: float, disc: Disc | None, response: Response | None) -> float:
    """HIDDEN where suction raises no cell, or none by much of what it would where nothing else is."""
    missing = exp(-((rise / SHOWN) ** 2))
    if disc is not None:
        full = float(np.mean(gains_of(response) * log_ratio_from_pressure(disc.suction_kpa, response)))
        missing = max(missing, exp(-((rise / max(full, 1e-9) / SHARE) ** 2)))
    return HIDDEN * missing


def _overlapping(one: Disc, other: Disc) -> float:
    """IN_EACH_OTHER where two discs are in one place, 0 where they stand clear."""
    apart = hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm)
    common = (one.diameter_mm + other.diameter_mm) / 2 - apart
    share = max(common, 0.0) / min(one.diameter_mm, other.diameter_mm)
    return IN_EACH_OTHER * (1 - exp(-((share / OVERLAP) ** 2)))
