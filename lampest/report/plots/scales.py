"""Colour scales of maps: which values they tell apart, and what the bar beside them says."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, LogNorm, Normalize

from lampest.panel.panel import Array

SIGNED, PRESSING = "RdBu_r", "RdBu"  # what presses is blue: it lowers resistance and raises pressure
STEPS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
LIMITS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
Extend = Literal["both", "min", "max", "neither"]


@dataclass(frozen=True, eq=False)
class Scale:
    """Colours of a set of maps.

    label : what they mean, with its unit. extend : which ends values go beyond. ticks : of the bar, None for usual
    ones. proportional : whether the bands of the bar are as wide as the values they stand for.
    """

    norm: Normalize
    colours: Colormap
    label: str
    extend: Extend = "neither"
    ticks: tuple[float, ...] | None = None
    proportional: bool = False


def positive_scale(values: Sequence[Array], label: str) -> Scale:
    """A logarithmic scale of round numbers that holds nearly all of the positive values."""
    numbers = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in values] or [np.array([1.0])])
    low, high = np.percentile(numbers, [1, 99]) if numbers.size else (1.0, 10.0)
    first = max((tick for tick in STEPS if tick <= low), default=STEPS[0])
    last = min((tick for tick in STEPS if tick >= high and tick > first), default=STEPS[-1])
    ends = (bool(np.any(numbers < first)), bool(np.any([np.any(part > last) for part in values])))
    ticks = tuple(tick for tick in STEPS if first <= tick <= last)
    return Scale(LogNorm(first, last), colormaps["viridis"], label, _extend(*ends), ticks)


def signed_scale(values: Sequence[Array], label: str, least: float, most: float = np.inf) -> Scale:
    """A scale symmetric about zero that holds 98 % of the values, ±least at least and ±most at most."""
    numbers = np.abs(np.concatenate([part[np.isfinite(part)] for part in values] or [np.zeros(1)]))
    reach = min(max(least, float(np.percentile(numbers, 98)) if numbers.size else 0.0), most)
    power = 10.0 ** np.floor(np.log10(reach))
    limit = float(next(step for step in (1, 2, 3, 5, 10) if step * power >= reach * (1 - 1e-9)) * power)
    return Scale(Normalize(-limit, limit), colormaps[SIGNED], label, _beyond(values, limit))


def share_scale(label: str) -> Scale:
    """From 0 to 1."""
    return Scale(Normalize(0, 1), colormaps["YlGnBu"], label)


def banded_scale(values: Sequence[Array], label: str) -> Scale:
    """Bands of a tenth of the limit, the middle one from −1/10 to +1/10 so that noise about zero stays white.

    The limit is the smallest round number that holds 98 % of all values, 100 at most; arrows stand for the rest.
    """
    numbers = np.abs(np.concatenate([part[np.isfinite(part)] for part in values] or [np.zeros(1)]))
    reach = np.percentile(numbers, 98) if numbers.size else 0.0
    limit = next((limit for limit in LIMITS if limit >= reach), LIMITS[-1])
    tenths = np.arange(1, 11) * limit / 10
    bands = colormaps[SIGNED](np.linspace(0.04, 0.96, 19))
    colours = ListedColormap(bands).with_extremes(under=colormaps[SIGNED](0.0), over=colormaps[SIGNED](1.0))
    norm = BoundaryNorm(np.concatenate([-tenths[::-1], tenths]), len(bands))
    ticks = tuple(np.linspace(-limit, limit, 11).tolist())
    return Scale(norm, colours, f"{label} (ends at ±{limit:g} %)", _beyond(values, limit), ticks, proportional=True)


def stepped_scale(steps: Sequence[float], label: str, ticks: Sequence[float], colours: str = SIGNED) -> Scale:
    """Bands between ±steps, white within the first; the same whatever is shown."""
    bounds = np.concatenate([np.negative(steps)[::-1], steps])
    norm = BoundaryNorm(bounds, colormaps[colours].N, extend="both")
    return Scale(norm, colormaps[colours], label, "both", tuple(ticks))


def _beyond(values: Sequence[Array], limit: float) -> Extend:
    return _extend(*(bool(np.any([np.any(sign * part > limit) for part in values])) for sign in (-1, 1)))


def _extend(below: bool, above: bool) -> Extend:
    return ("both" if above else "min") if below else ("max" if above else "neither")
