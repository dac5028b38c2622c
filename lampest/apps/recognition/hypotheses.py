"""Hypotheses on a load that sucks: what it is, and what makes it oscillate, with their priors.

What sucks is a mouth or a cup, as likely beforehand. A mouth breathes. What pushes or tugs a load
makes it oscillate at one rate, too:

- *breath*: the suction swings, and with it the rim that bears it;
- *a pushed rim*: only the rim's pressure swings, as where a body beside the load beats;
- *a tugged load*: its place or its tilt swings, as on a hose or in a current;
- *cells beside it*: something beats on them too faintly to be seen as a load of its own.

Water that moves presses on the whole panel. It is no hypothesis: lines without a load show it, and
it is taken off the readings first (`lampest.apps.recognition.steady_frames`).

Sources: rates of ventilation at rest, and up to 2.9 Hz where oxygen is short (Claridge & Potter, J.
Exp. Biol. 63, 1975); suction at rest and pumps (Shi et al., PLoS ONE 16, e0247884, 2021). Of cups,
hoses and bodies there are no recordings: the odds against their movements are assumptions, and
docs/studies/mouths.md shows how often they are wrong in simulated ones.
"""

from math import log
from typing import NamedTuple

RATES_HZ = (0.5, 2.5)  # of breathing at rest
# A: the mean amplitude of simulated mouths is 5.4 % of their suction. That of loads
# that do not breathe is an assumption: cups jitter and leak, but at no single rate.
BREATHING_SD = 0.045
# Relative standard deviation of the rate within seconds, assumed: no breath is a pure sine.
WANDER = 0.06
TREMBLE_SD = 0.002
# Smallest depth of a mouth's breath, assumed: what may breathe as deep is not surely a cup.
MIN_DEPTH = 0.03
# −ln of the shares of mouths that never show their breath, because it is faint or at half the frame
# rate, and of windows in which a mouth pauses: one in ten each, assumed.
SILENT_LOG_ODDS = log(10)
# Share of windows in which a suction that does not breathe begins to leak, and how fast, 1/s:
# assumed. The bend of such a suction resembles a slow breath.
LEAK_SHARE = 0.05
LEAK_SD = 0.3
# −ln of a share of one in twenty, assumed: of steps that are noise.
RARE_LOG_ODDS = log(20)
# Exponent of evidence ratios, because films and loads deviate from their models in more ways than
# the errors include. Fitted by log-likelihood to scenes made without this package's simulation
# (docs/studies/mouth_scenes.py).
EVIDENCE_SHARE = 0.5


class Cause(NamedTuple):
    """A cause of an oscillation of a load that sucks.

    Attributes
    ----------
    pattern : str
        Its field of `lampest.apps.recognition.swings.Patterns`.
    largest : float
        Largest amplitude, in units of the pattern.
    odds, odds_adjoined : float
        Prior odds of breath against it, and the same where a body or another load adjoins the load
        and may move it.
    """

    pattern: str
    largest: float
    odds: float
    odds_adjoined: float


# Above 15 % the unevenness of a film would explain the swings of a shaken cup.
BREATH = Cause("own", 0.15, 1.0, 1.0)
# What sucks and breathes always does, while rims and places swing at one rate only where something
# pushes them. A rim swings by all of its pressure, a place ten times as far as usual, and the
# resistance of a cell beside by 5 %.
RIM = Cause("rim", 1.0, 10.0, 0.1)
MOVES = Cause("moves", 10.0, 10.0, 0.1)
BESIDE = Cause("beside", 0.05, 30.0, 0.1)
# of breath, against all other causes together
PRIOR_ODDS = 1 / sum(1 / cause.odds for cause in (RIM, MOVES, BESIDE))
