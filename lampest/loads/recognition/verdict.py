"""The comparison of evidence: which candidates are how probable, in one frame and over those of a load.

P(fit) ∝ e^(evidence·COUNTS)·P(fit beforehand). All kinds are alike beforehand, but for further loads, for suction that
raises no cell, and for loads in one place: between patches a rim can be made to cancel suction, and one load can stand
within another; then they fit any outline, and of such outlines there are many more than candidates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from math import exp, hypot, log

import numpy as np
from scipy.special import log_ndtr, softmax

from lampest.loads.recognition.candidates import AND, UNIFORM, Several, loads_of
from lampest.loads.recognition.field import FIELD
from lampest.loads.recognition.fit import Fit
from lampest.loads.response import PUBLISHED
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Response

# Costs are of ln P. RARER: of every further load; IN_EACH_OTHER: of two in one place; assumptions.
RARER, IN_EACH_OTHER = log(20), 20.0
# What is no candidate is fitted by hidden suction with up to e⁶⁰ times the evidence of any other. Where such a fit is
# as good as a hollow load's, it is named all the same.
HIDDEN = 60.0
# ln r/r0 that a panel shows clearly, a suction of 1 kPa; and the part of what a cell under suction alone would
# show. Mouths of 24 to 45 mm at a pitch of 10 mm show more than 0.7 in some cell, and nine in ten more than 0.9.
SHOWN, SHARE = 0.2, 0.35
OVERLAP = 0.3  # of the smaller one's diameter: less may be the error of both edges
SURE, SURE_OF_TARGET = 0.99, 0.999  # P that a label shares; a false alarm costs more than an "or"
OR = " or "
AS_GOOD = 3.0  # of ln P
# By how much differences of evidence count: films and loads differ from their models in more ways than errors say.
# Fitted by log-likelihood to P(lamprey) of scenes made without this package's simulation; see docs/studies/mouths.md.
COUNTS = 0.5
MOST, AGE = 10.0, 0.4  # the most that ln P falls in one frame, and the weight of each frame over the next; assumptions


def prior_cost(panel: Panel, fit: Fit, response: Response = PUBLISHED) -> float:
    """−ln P of a fit before the measurement, up to what all share; response : the scene's own."""
    return RARER * further(fit.candidate) + outline_cost(panel, fit, response)


def further(candidate: Candidate) -> int:
    """How many loads it has beside the first."""
    return len(candidate.parts) - 1 if isinstance(candidate, Several) else 0


def outline_cost(panel: Panel, fit: Fit, response: Response = PUBLISHED) -> float:
    """By how much ln P falls of suction that raises no cell, and of loads that stand in each other."""
    loads = [(part, part.disc(own)) for part, own in loads_of(fit.candidate, fit.parameters)]
    cost = sum(_overlapping(*pair) for pair in combinations([disc for _, disc in loads if disc is not None], 2))
    for part, disc in loads:
        if part.sucks:
            cost += HIDDEN * _hidden(panel, fit.change, disc, response, whole=len(loads) == 1)
    return cost


def _hidden(panel: Panel, change: Array, disc: Disc | None, response: Response, whole: bool) -> float:
    """1 where suction raises no cell, or none by much of what it would alone; 0 where it clearly does.

    whole : whether cells anywhere count, and not only those under the disc.
    """
    under = np.ones(change.shape, dtype=bool)
    if disc is not None and not whole:
        across, down = panel.centres_mm()
        under = np.hypot(across - disc.x_mm, down[:, None] - disc.y_mm) < (disc.diameter_mm + panel.pitch_mm) / 2
    rise = float(change[under].max(initial=0.0))
    missing = exp(-((rise / SHOWN) ** 2))
    if disc is not None:
        full = float(np.mean(response.gains * response.logarithm(disc.suction_kpa)))
        missing = max(missing, exp(-((rise / max(full, 1e-9) / SHARE) ** 2)))
    return missing


def _overlapping(one: Disc, other: Disc) -> float:
    """IN_EACH_OTHER where two discs are in one place, 0 where they stand clear."""
    apart = hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm)
    common = (one.diameter_mm + other.diameter_mm) / 2 - apart
    share = max(common, 0.0) / min(one.diameter_mm, other.diameter_mm)
    return IN_EACH_OTHER * (1 - exp(-((share / OVERLAP) ** 2)))


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
        enough = SURE if targets.isdisjoint(order[0].split(AND)) else SURE_OF_TARGET
        named = order[: int(np.searchsorted(np.cumsum([by_label[label] for label in order]), enough)) + 1]
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
    response: Response = PUBLISHED,
) -> Verdict:
    """The verdict on one frame.

    The label names those that share 99 % of the probability. A target that explains the readings as well as the
    likeliest load does is always named, whatever its parameters cost; where the likeliest is hollow, so is a target
    whose suction no cell shows: a rim may hide it. Where no candidate fits, differences of evidence count less, by
    χ² per reading of the best one. Candidates that were not fitted, because nothing stands out, have no probability.
    """
    within = np.array([bounded(panel, fit) for fit in fits])
    before = np.array([prior_cost(panel, fit, response) for fit in fits])
    evidence = np.array([fit.evidence for fit in fits]) + within
    goodness = fits[int(np.argmax(evidence - before))].chi2 / readings
    counts = (COUNTS if len(fits) > len(UNIFORM) else 1.0) / max(1.0, goodness)
    shares = softmax(counts * evidence - before)
    best = fits[int(np.argmax(shares))].candidate
    as_good: tuple[str, ...] = ()
    if best not in (*UNIFORM, FIELD):
        score = counts * (np.array([fit.score for fit in fits]) - within) + (0.0 if best.hollow else before)
        enough = score[int(np.argmax(shares))] + AS_GOOD
        as_good = tuple(
            fit.candidate.label for fit, high in zip(fits, score, strict=True) if fit.candidate.target and high < enough
        )
    one = Verdict(fits, tuple(map(float, shares)), (), goodness, "", float(max(evidence - before)), as_good)
    return one.with_odds(one.by_label, candidates)


def bounded(panel: Panel, fit: Fit) -> float:
    """ln of what the readings leave of a candidate within its bound, over what the priors do; both Gaussian."""
    mean, sd = fit.candidate.mean(panel), fit.candidate.sd(panel)
    total = 0.0
    for sign, at, covariance in ((1, fit.parameters, fit.covariance), (-1, mean, np.diag(sd**2))):
        margin = fit.candidate.margin(at)
        if margin is not None:
            total += sign * float(log_ndtr(margin[0] / np.sqrt(margin[1] @ covariance @ margin[1])))
    return total


@dataclass(frozen=True, eq=False)
class OverTime:
    """The evidence of all frames of one load. With q_t(l) the probability of label l in frame t

        ln P(l) = Σ_t AGE^age max(ln q_t(l), −MOST) / Σ_t AGE^age + const.

    A mean and no sum, because errors of film and baseline are the same in all frames of a load. MOST keeps a fit that
    ended in a wrong minimum from outvoting all other frames. All begins anew in frames in which nothing stands out, and
    where what only touched begins to suck; a first frame alone is no alarm.

    odds : label → Σ AGE^age max(ln q, −MOST). frames : Σ AGE^age, how many frames count.
    touches : whether the last one alone showed a load of some shape that does not suck.
    """

    odds: Mapping[str, float] = field(default_factory=dict)
    frames: float = 0.0
    touches: bool = False

    def after(self, verdict: Verdict, candidates: Sequence[Candidate]) -> tuple["OverTime", Verdict]:
        """(after one more frame, its verdict in the light of those before); candidates : all that were asked for."""
        if len(verdict.fits) <= len(UNIFORM):
            return OverTime(), verdict
        best, before = verdict.best.candidate, self
        if self.touches and best.sucks:
            before = OverTime()
        latest = {label: log(max(share, exp(-MOST))) for label, share in verdict.by_label.items()}
        odds = {
            label: AGE * before.odds.get(label, -MOST * before.frames) + latest.get(label, -MOST)
            for label in dict.fromkeys((*latest, *before.odds))
        }
        together = OverTime(odds, AGE * before.frames + 1, not best.sucks and best is not FIELD)
        shares = map(float, softmax(np.array(list(odds.values())) / together.frames))
        return together, verdict.with_odds(dict(zip(odds, shares, strict=True)), candidates, together.frames == 1)
