"""`unknowns: oral_disc`: eight numbers of a disc are fitted to the readings, and the cells follow from them."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.files.errors import InputError
from lampest.loads.pressure import water_pressure
from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.direct import OralDiscFit, fit_oral_disc
from lampest.loads.recognition.frame import Direct, counting
from lampest.loads.recognition.model_errors import ModelErrors
from lampest.loads.recognition.settings import RecognitionSettings
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.solution import Outcome, Solution, Status, approximation


@dataclass(frozen=True, eq=False)
class OralDiscTracker:
    """Where a sequence of such fits stands.

    panel, water : (rows, columns) kPa. baseline : of the unloaded readings. period : s between frames.
    frames : how many were fitted. detector, last : prepared for the panel, and the fit before; None at first.
    """

    panel: Panel
    water: Array
    baseline: Baseline
    period: float
    frames: int = 0
    detector: Detector | None = None
    last: OralDiscFit | None = None

    @classmethod
    def of(cls, scene: Scene, period: float, resting: Readings) -> "OralDiscTracker":
        """Before the first frame. Raises InputError where the noise of the readings is unknown."""
        if resting.sigma is None:
            raise InputError("unknowns: oral_disc needs the noise: a readout in the scene or sigma in the recording")
        systematic = scene.systematic
        model_errors = ModelErrors(
            channel_ohm=0.0 if systematic is None else systematic.channel_spread_ohm,
            reference=0.0 if systematic is None else systematic.reference_tolerance / np.sqrt(3),
        )
        baseline = Baseline.of(resting.resistance, _sigma(resting), scene.series_resistance_ohm, model_errors)
        every = period if np.isfinite(period) else 0.0
        return cls(scene.panel, water_pressure(scene.panel, scene.water), baseline, every)

    def push(self, readings: Readings) -> tuple["OralDiscTracker", OralDiscFit]:
        """The fit of one frame's readings (rows, columns), begun at the last one or all over the panel."""
        seconds = (self.frames + 1) * self.period
        frame = Direct(readings.resistance, _sigma(readings), self.baseline, self.water, seconds)
        detector = self.detector or Detector.of(self.panel, RecognitionSettings().patch_of(self.panel), frame)
        fit = fit_oral_disc(detector, frame, None if self.last is None else self.last.fit)
        return replace(self, frames=self.frames + 1, detector=detector, last=fit), fit

    def resting(self, cost: Cost, data: Data) -> Solution:
        """The unloaded cells."""
        return _fitted(cost, data, np.exp(self.baseline.logarithm), 0)


def disc_solution(cost: Cost, data: Data, fit: OralDiscFit) -> Solution:
    """The cells that follow from a disc, with the cost of the terms there."""
    return _fitted(cost, data, fit.cell_resistance, fit.fit.steps)


def _fitted(cost: Cost, data: Data, cells: Array, steps: int) -> Solution:
    outcome = Outcome(cells[None], np.zeros(len(cost.slope)), Status.FITTED, steps)
    solution = approximation(cost, data, outcome)
    # Of the cells it is no optimum, and how far it is from one says nothing.
    return replace(solution, status=Status.FITTED, kkt_residual=float("nan")) if solution.solved else solution


def _sigma(readings: Readings) -> Array:
    sigma = readings.sigma_of_values
    assert sigma is not None
    return counting(sigma, readings.resistance)
