"""All candidates before one frame: which are how probable, and what one may call it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, logsumexp

from lampest.loads.recognition.candidates import UNIFORM
from lampest.loads.recognition.field import FIELD
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.prior import prior_cost
from lampest.loads.recognition.several import AND
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Response

SURE, SURE_OF_TARGET = 0.99, 0.999  # an alarm that is false costs more than one that says "or"
OR = " or "
AS_GOOD = 3.0  # of the logarithm of the posterior
# By how much differences of evidence count: films and loads differ from their models in more ways than errors say.
# Fitted by log-likelihood to P(lamprey) of scenes made without this package's simulation; see docs/studies/mouths.md.
COUNTS = 0.5


@dataclass(frozen=True, eq=False)
class Verdict:
    """What a frame shows.

    fits : those of UNIFORM first; of these alone where nothing stood out. shares : (fits) how probable each is.
    probabilities : by kind, in the order of the candidates that were asked for, then 'unlike any'; several loads count
    as their first. Both sum up to 1. goodness : χ² per reading of the best fit.
    label : its name, or several joined by 'or', the likeliest first. evidence : ln of the frame's probability under the
    best fit and of that beforehand, up to what all fits to the same frame share. as_good : labels of targets that do as
    well as the best.
    """

    fits: tuple[Fit, ...]
    shares: tuple[float, ...]
    probabilities: tuple[float, ...]
    goodness: float
    label: str
    evidence: float
    as_good: tuple[str, ...] = ()

    @cached_property
    def by_label(self) -> Mapping[str, float]:
        """How probable each label is."""
        found: dict[str, float] = {}
        for fit, share in zip(self.fits, self.shares, strict=True):
            found[fit.candidate.label] = found.get(fit.candidate.label, 0.0) + share
        return found

    def with_odds(
        self, by_label: Mapping[str, float], candidates: Sequence[Candidate], alone: bool = False
    ) -> "Verdict":
        """The same frame where labels are as probable as that; candidates : all that were asked for.

        Labels that none of its fits has count for its probabilities and in its label, too. alone : whether no frame
        bears it out; a target is then named with what is likeliest beside it.
        """
        own, kinds = self.by_label, [candidate.label for candidate in (*candidates, FIELD)]
        shares = tuple(
            by_label.get(fit.candidate.label, 0.0) * share / max(own[fit.candidate.label], 1e-300)
            for fit, share in zip(self.fits, self.shares, strict=True)
        )
        probabilities = [0.0] * len(kinds)
        for label, share in by_label.items():
            probabilities[kinds.index(label.split(AND)[0])] += share
        targets = {candidate.label for candidate in candidates if candidate.target}
        order = sorted(by_label, key=lambda label: (-by_label[label], -own.get(label, 0.0)))
        named = _named(by_label, order, SURE if targets.isdisjoint(order[0].split(AND)) else SURE_OF_TARGET)
        named += [label for label in self.as_good if label not in named]
        if alone and targets.issuperset(part for label in named for part in label.split(AND)):
            named += [label for label in order if targets.isdisjoint(label.split(AND))][:1]
        return replace(self, shares=shares, probabilities=tuple(probabilities), label=OR.join(named))

    @property
    def best(self) -> Fit:
        """The most probable one."""
        return self.fits[int(np.argmax(self.shares))]

    @property
    def loads(self) -> tuple[Fit, ...]:
        """Those that are loads of some shape, the best first; none where nothing stood out."""
        shaped = (fit for fit in self.fits if fit.candidate not in (*UNIFORM, FIELD))
        return tuple(sorted(shaped, key=lambda fit: -fit.evidence))


def judged(
    panel: Panel,
    candidates: Sequence[Candidate],
    fits: tuple[Fit, ...],
    readings: int,
    response: Response | None = None,
) -> Verdict:
    """P(fit) ∝ e^(evidence·COUNTS)·P(fit beforehand): all kinds are alike, but `prior_cost` makes some fits rarer.

    The label names those that share 99 % of the probability. A target that explains the readings as well as the
    likeliest load does is always named: its having more parameters alone is no reason to be sure that there is
    none. Where the likeliest is hollow, that is so of a target whose suction no cell shows, too: a rim may hide it.

    Where no candidate fits, differences of evidence count less, by χ² per reading of the best one. Candidates that were
    not fitted, because nothing stands out, have no probability. What frames of one load say together: `over_time`.
    """
    within = np.array([bounded(panel, fit) for fit in fits])
    before = np.array([prior_cost(panel, fit, response) for fit in fits])
    evidence = np.array([fit.evidence for fit in fits]) + within
    goodness = fits[int(np.argmax(evidence - before))].chi2 / readings
    counts = (COUNTS if len(fits) > len(UNIFORM) else 1.0) / max(1.0, goodness)
    tempered = counts * evidence - before
    shares = np.exp(tempered - logsumexp(tempered))
    best = fits[int(np.argmax(shares))].candidate
    as_good: tuple[str, ...] = ()
    if best not in (*UNIFORM, FIELD):
        score = counts * (np.array([fit.score for fit in fits]) - within) + (0.0 if best.hollow else before)
        as_good = _as_good(fits, score, int(np.argmax(shares)))
    one = Verdict(fits, tuple(map(float, shares)), (), goodness, "", float(max(evidence - before)), as_good)
    return one.with_odds(one.by_label, candidates)


def _as_good(fits: Sequence[Fit], score: Array, best: int) -> tuple[str, ...]:
    """The targets whose score is at most AS_GOOD above that of the best."""
    return tuple(
        fit.candidate.label
        for fit, high in zip(fits, score, strict=True)
        if fit.candidate.target and high < score[best] + AS_GOOD
    )


def _named(by_label: Mapping[str, float], order: list[str], enough: float) -> list[str]:
    """The first labels of an order that share `enough` of the probability."""
    needed = int(np.searchsorted(np.cumsum([by_label[label] for label in order]), enough)) + 1
    return order[:needed]


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
