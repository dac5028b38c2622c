"""What frames of one load say together: a verdict that the frames before it temper.

With q_t(l) the probability of label l in frame t, and g(x) = −MOST·(1 − e^(x/MOST)) ≤ 0, which is x where x is small,

    ln P(l) = Σ_t AGE^age g(ln q_t(l)) / Σ_t AGE^age + const.

A mean and no sum, because errors of film and baseline are the same in all frames of a load, and would be taken for
evidence. g keeps a fit that ended in a wrong minimum from outvoting all other frames. Frames in which nothing stands
out begin anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from lampest.loads.recognition.candidates import UNIFORM
from lampest.loads.recognition.verdict import Verdict
from lampest.loads.shapes.shape import Candidate

# Assumptions: the most that ln P falls in one frame, and how fast frames age.
MOST, AGE = 12.0, 0.4


@dataclass(frozen=True, eq=False)
class OverTime:
    """odds : label → Σ AGE^age g(ln q). frames : Σ AGE^age, how many frames count."""

    odds: Mapping[str, float] = field(default_factory=dict)
    frames: float = 0.0

    def after(self, verdict: Verdict, candidates: Sequence[Candidate]) -> tuple["OverTime", Verdict]:
        """(after one more frame, its verdict in the light of those before); candidates : all that were asked for."""
        if len(verdict.fits) <= len(UNIFORM):
            return OverTime(), verdict
        shown = verdict.by_label
        labels = dict.fromkeys((*shown, *self.odds))
        odds = {
            label: AGE * self.odds.get(label, -MOST * self.frames) + tempered(shown.get(label, 0.0)) for label in labels
        }
        together = OverTime(odds, AGE * self.frames + 1)
        return together, verdict.with_odds(together.probabilities(), candidates)

    def probabilities(self) -> dict[str, float]:
        """P of every label."""
        likely = np.array(list(self.odds.values())) / self.frames
        shares = np.exp(likely - logsumexp(likely))
        return dict(zip(self.odds, map(float, shares), strict=True))


def tempered(share: float) -> float:
    """g(ln q)."""
    return -MOST * float(1 - share ** (1 / MOST))
