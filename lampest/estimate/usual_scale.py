"""Priors of scales that no reading of a circuit shows.

A factor on all cells of a column changes no reading of inputs without a resistor. Penalties would
choose the factor by chance, and cells would drift to their bounds. Two weak priors choose it. The
panel has usual cells, within a decade; and most cells do not change, so that the unloaded panel
gives each column of a frame its scale. Readings outweigh both in all that they show.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.cost.losses import Huber
from lampest.cost.terms import LogRatio, State, Term
from lampest.estimate.estimator import Estimator
from lampest.panel.readouts.starts import USUAL_OHM
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

DECADES = 1.0  # standard deviation of the panel's mean log10 r: usual films have 100 ohm to 1 Mohm
RESTING_PERCENT = 50.0  # standard deviation of 100 ln r/r0 of a cell that rests
CORNER_PERCENT = 10.0  # of 100 ln r/r0: cells that change by more pull no harder


@dataclass(frozen=True)
class UsualScale(Term):
    """ln(r/USUAL_OHM)/(DECADES·ln 10·√n) of n cells.

    The mean of log10 r has the standard deviation DECADES.
    """

    convex_in_log: ClassVar[bool] = True
    unit: ClassVar[str] = "standard deviations"
    kind: Literal["usual_scale"] = "usual_scale"
    weight: float = 1.0

    def residual(self, state: State) -> Any:
        """Return the logarithmic distance from usual cells, (cells, 1)."""
        deviation = DECADES * np.log(10) * np.sqrt(state.panel.crossings)
        return np.log(state.cell_resistance / USUAL_OHM) / deviation


def with_usual_scale(estimator: Estimator, scene: Scene, readings: Readings) -> Estimator:
    """Return the estimator with the priors, for a scene whose circuit has unseen scales.

    Methods that end at no optimum keep the scale of their start, and have none. Terms that compare
    frames take the place of the second prior.

    Parameters
    ----------
    estimator : Estimator
    scene : Scene
        That of one network.
    readings : Readings
        (…, rows, columns); their noise is the unit of a plain misfit.
    """
    single = estimator.method.optimum and not estimator.method.needs_all_frames
    known = any(isinstance(term, UsualScale) for term in estimator.terms)
    if not single or known or readings.sigma is None:
        return estimator
    by_noise = any(getattr(term, "weighting", "plain") == "noise" for term in estimator.terms)
    sigma = readings.sigma[np.isfinite(readings.sigma)]
    square = 1.0 if by_noise else float(np.mean(sigma**2))
    priors: tuple[Term, ...] = (UsualScale(weight=square),)
    if not estimator.relative:
        resting = LogRatio(weight=square / RESTING_PERCENT**2, loss=Huber(corner=CORNER_PERCENT))
        priors = (resting, *priors)
    chosen = estimator.weight_sigma
    return replace(
        estimator,
        terms=(*estimator.terms, *priors),
        weight_sigma=chosen and (*chosen, *[np.nan] * len(priors)),
    )
