"""All candidates before one frame: which are how probable, and what one may call it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, logsumexp

from lampest.loads.recognition.candidates import UNIFORM
from lampest.loads.recognition.fit import Fit
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Panel

SURE, SURE_OF_TARGET = 0.99, 0.999  # an alarm that is false costs more than one that says "or"
OR = " or "
AS_GOOD = 3.0  # of the logarithm of the posterior
UNLIKE = 3.0  # χ² per reading of the best candidate, beyond which the frame looks like none of them
UNKNOWN = "unlike any"


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a frame shows.

    fits : of every candidate in their order, those of UNIFORM first; of these alone where nothing stood out.
    probabilities : (candidates), their sum is 1. goodness : χ² per reading of the best one.
    label : its name, or several joined by 'or', the likeliest first.
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
    def loads(self) -> tuple[Fit, ...]:
        """Those that are loads of some shape, the most probable first; none where nothing stood out."""
        shaped = self.fits[len(UNIFORM) :]
        order = np.argsort(-np.array(self.probabilities[len(UNIFORM) :]))
        return tuple(shaped[number] for number in order) if shaped else ()


def judged(panel: Panel, candidates: Sequence[Candidate], fits: tuple[Fit, ...], readings: int) -> Verdict:
    """P(candidate) ∝ evidence: all are alike beforehand. The label names those that share 99 % of the probability.

    A target that explains the readings as well as the likeliest load does is always named: its having more parameters
    alone is no reason to be sure that there is none.

    Where no candidate fits, differences of evidence count less, by χ² per reading of the best one. Candidates that were
    not fitted, because nothing stands out, have no probability. Frames are not multiplied with each other: the errors
    of the baseline and of the response are the same in all of them, and would be taken for evidence.
    """
    within = np.array([bounded(panel, fit) for fit in fits])
    evidence = np.array([fit.evidence for fit in fits]) + within
    goodness = fits[int(np.argmax(evidence))].chi2 / readings
    tempered = evidence / max(1.0, goodness)
    probabilities = np.zeros(len(candidates))
    probabilities[: len(fits)] = np.exp(tempered - logsumexp(tempered))
    order = np.argsort(-probabilities)
    best = candidates[order[0]]
    enough = SURE_OF_TARGET if best.target else SURE
    needed = int(np.searchsorted(np.cumsum(probabilities[order]), enough)) + 1
    named = [candidates[number].label for number in order[:needed]]
    if best not in UNIFORM:
        cost = (np.array([fit.cost for fit in fits]) - within) / max(1.0, goodness)
        as_good = [fit.candidate for fit, high in zip(fits, cost, strict=True) if high < cost[order[0]] + AS_GOOD]
        named += [target.label for target in as_good if target.target and target.label not in named]
    label = UNKNOWN if goodness > UNLIKE else OR.join(named)
    return Verdict(fits, tuple(map(float, probabilities)), goodness, label)


def bounded(panel: Panel, fit: Fit) -> float:
    """ln of what the readings leave of a candidate within its bound, over what the priors do; both Gaussian."""
    mean, sd = fit.candidate.mean(panel), fit.candidate.sd(panel)
    ratio = [
        log_ndtr(margin[0] / np.sqrt(margin[1] @ covariance @ margin[1]))
        for margin, covariance in (
            (fit.candidate.margin(fit.parameters), fit.covariance),
            (fit.candidate.margin(mean), np.diag(sd**2)),
        )
        if margin is not None
    ]
    return float(ratio[0] - ratio[1]) if ratio else 0.0
