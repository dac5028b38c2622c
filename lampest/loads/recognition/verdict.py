"""All candidates before one frame: which are how probable, and what one may call it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, logsumexp

from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.loads import (
    CUP,
    FLAT,
    HARDER,
    LAMPREY,
    NOTHING,
    PUSHED,
    ROUND,
    bearing_slope,
    log_bearing,
)
from lampest.panel.panel import Array, Panel

KINDS = tuple(candidate.label for candidate in (NOTHING, FLAT, *ROUND))
SURE, SURE_OF_LAMPREY = 0.99, 0.999  # an alarm that is false costs more than one that says "or"
OR = " or "
AS_GOOD = 3.0  # of the logarithm of the posterior
UNLIKE = 3.0  # χ² per reading of the best candidate, beyond which the frame looks like none of them
UNKNOWN = "unlike any"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a frame shows.

    fits : of every candidate in the order of KINDS. probabilities : (kinds), their sum is 1.
    goodness : χ² per reading of the best one. label : its name, or several joined by 'or', the likeliest first.
    """

    fits: tuple[Fit, ...]
    probabilities: tuple[float, ...]
    goodness: float
    label: str

    @property
    def best(self) -> Fit:
        """The most probable one."""
        return self.fits[int(np.argmax(self.probabilities))]

    @property
    def round(self) -> tuple[Fit, ...]:
        """Those with a round footprint, the most probable first; none where nothing stood out."""
        order = np.argsort(-np.array(self.probabilities[2:]))
        return tuple(self.fits[2 + place] for place in order) if len(self.fits) > 2 else ()


def judged(panel: Panel, fits: tuple[Fit, ...], readings: int) -> Verdict:
    """P(kind) ∝ evidence: all kinds are alike beforehand. The label names those that share 99 % of the probability.

    A lamprey that explains the readings as well as the likeliest load does is always named: its having more parameters
    alone is no reason to be sure that there is none.

    Where no candidate fits, differences of evidence count less, by χ² per reading of the best one. Kinds that were not
    fitted, because nothing stands out, have no probability. Frames are not multiplied with each other: the errors of
    the baseline and of the response are the same in all of them, and would be taken for evidence.
    """
    within = np.array([bounded(panel, fit) for fit in fits])
    evidence = np.array([fit.evidence for fit in fits]) + within
    goodness = fits[int(np.argmax(evidence))].chi2 / readings
    tempered = evidence / max(1.0, goodness)
    probabilities = np.zeros(len(KINDS))
    probabilities[: len(fits)] = np.exp(tempered - logsumexp(tempered))
    order = np.argsort(-probabilities)
    enough = SURE_OF_LAMPREY if KINDS[order[0]] == LAMPREY.label else SURE
    needed = int(np.searchsorted(np.cumsum(probabilities[order]), enough)) + 1
    named = [KINDS[place] for place in order[:needed]]
    cost = (np.array([fit.cost for fit in fits]) - within) / max(1.0, goodness)
    touched = KINDS[order[0]] not in (NOTHING.label, FLAT.label)
    if touched and LAMPREY.label not in named and cost[-1] < cost[order[0]] + AS_GOOD:
        named.append(LAMPREY.label)
    label = OR.join(named)
    return Verdict(fits, tuple(map(float, probabilities)), goodness, UNKNOWN if goodness > UNLIKE else label)


def bounded(panel: Panel, fit: Fit) -> float:
    """ln of what the readings leave of a candidate within its bounds, over what the priors do; both Gaussian.

    The bounds: push < 40 kPa of a cup, p > 1.25·p_bear of a lamprey.
    """
    if fit.candidate is CUP:
        margin = cup_margin
    elif fit.candidate is LAMPREY:
        margin = lamprey_margin
    else:
        return 0.0
    mean, sd = fit.candidate.mean(panel), fit.candidate.sd(panel)
    before, after = (
        (distance, slope @ covariance @ slope)
        for (distance, slope), covariance in (
            (margin(mean), np.diag(sd**2)),
            (margin(fit.parameters), fit.covariance),
        )
    )
    ratio = [log_ndtr(distance / np.sqrt(variance)) for distance, variance in (after, before)]
    return float(ratio[0] - ratio[1])


def cup_margin(parameters: Array) -> tuple[float, Array]:
    """ln 40 kPa − ln push, and its slopes by φ."""
    place = CUP.names.index("push")
    return float(np.log(PUSHED) - parameters[place]), -np.eye(len(parameters))[place]


def lamprey_margin(parameters: Array) -> tuple[float, Array]:
    """ln p − ln(1.25·p_bear), and its slopes by φ."""
    place = {name: number for number, name in enumerate(LAMPREY.names)}
    disc, slopes = LAMPREY.disc(parameters)
    share = disc.inner_mm / disc.diameter_mm
    margin = parameters[place["rim"]] - log_bearing(disc.suction_kpa, share) - np.log(HARDER)
    slope = -bearing_slope(share) * (slopes[3] - share * slopes[2]) / disc.diameter_mm
    slope[place["rim"]] += 1.0
    slope[place["suction"]] -= 1.0
    return float(margin), slope
