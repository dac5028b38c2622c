"""What frames of one load say together: a verdict that the frames before it temper.

With q_t(l) the probability of label l in frame t

    ln P(l) = Σ_t AGE^age max(ln q_t(l), −MOST) / Σ_t AGE^age + const.

A mean and no sum, because errors of film and baseline are the same in all frames of a load, and would be taken for
evidence. MOST keeps a fit that ended in a wrong minimum from outvoting all other frames. All begins anew in
frames in which nothing stands out, and where what only touched begins to suck, as mouths and cups do; a first frame
alone is no alarm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from lampest.loads.recognition.candidates import UNIFORM
from lampest.loads.recognition.field import FIELD
from lampest.loads.recognition.verdict import Verdict
from lampest.loads.shapes.shape import Candidate

# Assumptions: the most that ln P falls in one frame, and how fast frames age.
MOST, AGE = 10.0, 0.4


@dataclass(frozen=True, eq=False)
class OverTime:
    """odds : label → Σ AGE^age max(ln q, −MOST). frames : Σ AGE^age, how many frames count.

    touches : whether the last one alone showed a load of some shape that does not suck.
    """

    odds: Mapping[str, float] = field(default_factory=dict)
    frames: float = 0.0
    touches: bool = False

    def after(self, verdict: Verdict, candidates: Sequence[Candidate]) -> tuple["OverTime", Verdict]:
        """(after one more frame, its verdict in the light of those before); candidates : all that were asked for."""
        if len(verdict.fits) <= len(UNIFORM):
            return OverTime(), verdict
        shown, best = verdict.by_label, verdict.best.candidate
        before = OverTime() if self.touches and best.sucks else self
        labels = dict.fromkeys((*shown, *before.odds))
        odds = {
            label: AGE * before.odds.get(label, -MOST * before.frames) + limited(shown.get(label, 0.0))
            for label in labels
        }
        together = OverTime(odds, AGE * before.frames + 1, not best.sucks and best is not FIELD)
        return together, verdict.with_odds(together.probabilities(), candidates, alone=together.frames == 1)

    def probabilities(self) -> dict[str, float]:
        """P of every label."""
        likely = np.array(list(self.odds.values())) / self.frames
        shares = np.exp(likely - logsumexp(likely))
        return dict(zip(self.odds, map(float, shares), strict=True))


def limited(share: float) -> float:
    """max(ln q, −MOST)."""
    return float(np.log(max(share, np.exp(-MOST))))
