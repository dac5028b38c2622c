"""Breathing of an attachment: the odds of all windows together.

The odds that the rim alone oscillates are combined likewise. Each window has a `Breath`. Windows of
one load share the form of its rim, the film and the amplitude of a steady swing, so that their ln
odds w are correlated by ρ, and N of them have the ln odds

    Σ w / (1 + (N − 1) ρ).

Of incomplete windows, two in a row have to agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, inf

import numpy as np
from scipy.special import expit, logit

from lampest.apps.recognition.breath import Breath, Pair
from lampest.apps.recognition.hypotheses import MIN_DEPTH, PRIOR_ODDS, SILENT_LOG_ODDS

# duration over which a rhythm is steady, and the least that determines one
WINDOW_S = 8.0
MIN_WINDOW_S = 3.5
# correlation ρ of the ln odds of two windows of one load, and number of windows that count: each
# window takes from the earlier ones the inverse of it
SHARED = 0.5
REMEMBERED = 4.0
ONE_SIDED = 1.645  # standard deviations of an upper limit with 95 %
MAX_LOG_ODDS = 10.0  # upper limit of accumulated ln odds of breathing
PRIOR_SUCTION = PRIOR_ODDS / (1 + PRIOR_ODDS)
CERTAIN = 0.99  # of breath: a mouth that was as certain stays one while it does not oscillate


@dataclass(frozen=True)
class Breathing:
    """Breath of an attachment, from all windows.

    Attributes
    ----------
    odds, previous_odds : float
        ln odds of an oscillation at a breathing rate, with and without the last window.
    causes, previous_causes : float
        ln odds that the suction oscillates, without the prior odds, with and without the last
        window.
    windows : float
        Number N of windows in the previous odds.
    suction : float
        Probability that the suction oscillates, by all windows; 1 before the first one.
    last : float
        The same by the last window alone; its prior probability before the first one, and where
        nothing oscillated.
    hertz, depth : (float, float) or None
        Rate in Hz and relative amplitude, each with its standard deviation, from the last window
        that determines them.
    max_depth : float
        Largest depth that the last full window allows, with 95 %; infinite before one.
    clearest : float
        Probability after the last full window, with a tenth of the odds where that one excludes a
        breath of MIN_DEPTH.
    full_s, judged_s : float
        Times of the last frame of the last full window, and of the last window, s.
    """

    odds: float = 0.0
    previous_odds: float = 0.0
    causes: float = 0.0
    previous_causes: float = 0.0
    windows: float = 0.0
    suction: float = 1.0
    last: float = PRIOR_SUCTION
    hertz: Pair | None = None
    depth: Pair | None = None
    max_depth: float = inf
    clearest: float = 0.0
    full_s: float = -inf
    judged_s: float = -inf

    @property
    def probability(self) -> float:
        """Probability that suction oscillates at a breathing rate; 1/2 before any observation.

        Where it exceeded CERTAIN, windows with other oscillations do not lower it.
        """
        now = self.suction * float(expit(self.odds))
        return max(now, self.clearest) if self.clearest > CERTAIN else now

    def parted(self, steps: Sequence[float]) -> "Breathing":
        """Return the breath after steps at times in s.

        A step ends a window that determined a rhythm. The swings after a pull are others: the next
        window has them alone, and they do not replace the odds of this one.
        """
        if self.odds == self.previous_odds or not any(step > self.judged_s for step in steps):
            return self
        return self._caused(self.last)._closed(self.judged_s)

    def _caused(self, suction: float) -> "Breathing":
        """Return the breath if suction oscillates in the last window with this probability."""
        window = logit(suction) - np.log(PRIOR_ODDS)
        causes = self._together(self.previous_causes, window, -MAX_LOG_ODDS)
        return replace(self, suction=float(expit(causes + np.log(PRIOR_ODDS))), causes=causes)

    def _closed(self, time: float) -> "Breathing":
        """Return the breath whose last window, which ends at a time in s, is complete."""
        return replace(
            self,
            previous_odds=self.odds,
            previous_causes=self.causes,
            windows=self._counted,
            full_s=time,
        )

    @property
    def _counted(self) -> float:
        """Number of windows with the last one."""
        return 1 + (1 - 1 / REMEMBERED) * self.windows

    def _together(self, previous: float, window: float, least: float) -> float:
        """Return the ln odds of the earlier windows and of one more, at least a value."""
        total = previous * (1 + (max(self.windows, 1.0) - 1) * SHARED)
        total = (1 - 1 / REMEMBERED) * total + window
        return float(np.clip(total / (1 + (self._counted - 1) * SHARED), least, MAX_LOG_ODDS))

    def after(self, breath: Breath | None, time: float, *, full: bool) -> "Breathing":
        """Return the breath after a window that ends at a time in s.

        The odds of a full window are kept. Assumptions: one mouth in ten never shows its breath,
        because it is faint or at half the frame rate, and a mouth pauses in one window of ten.
        Of incomplete windows, two successive ones have to agree that the suction oscillates: with
        the last one alone, two of 75 shaken cups were taken for lampreys for a second.
        One that speaks against the window before shows nothing: a few
        seconds before a release would take a mouth's breath for a movement.
        """
        judged = replace(self, judged_s=time, full_s=time if full else self.full_s)
        if breath is None:
            return judged
        weighed = judged._with_window(breath, full=full)
        if not full:
            return weighed
        depth, depth_sd = breath.depth
        max_depth = depth + ONE_SIDED * depth_sd
        against = SILENT_LOG_ODDS if max_depth < MIN_DEPTH else 0.0  # or the mouth pauses
        clearest = float(expit(logit(weighed.probability) - against))
        return replace(weighed, max_depth=max_depth, clearest=clearest)._closed(time)

    def _with_window(self, breath: Breath, *, full: bool) -> "Breathing":
        """Return the breath with that of one more window."""
        # w = ln(0.1 + 0.9 B), B the odds of the window
        window = np.logaddexp(-SILENT_LOG_ODDS, np.log1p(-exp(-SILENT_LOG_ODDS)) + breath.odds)
        odds = self._together(self.previous_odds, float(window), -SILENT_LOG_ODDS)
        # Where nothing oscillates, a window shows no cause.
        suction = breath.suction if breath.odds > 0 else PRIOR_SUCTION
        against_last = suction < PRIOR_SUCTION < self.last
        agreed = PRIOR_SUCTION if against_last else min(suction, self.last)
        agreed = suction if full else agreed
        breathing = replace(self._caused(agreed), odds=odds, last=suction)
        follows_full_window = self.previous_odds != 0 and not full
        if self.hertz is not None and (breath.odds <= 0 or follows_full_window):
            return breathing
        return replace(breathing, hertz=breath.hertz, depth=breath.depth)
