"""The unloaded panel with its uncertainty: what every frame is compared with."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.recognition.settings import ModelErrors
from lampest.loads.response import PUBLISHED
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.response import Response
from lampest.panel.scene import Scene

STEPS, SETTLED = 12, 1e-6  # of Gauss and Newton, at most; the change of ln r0 that ends them
ROUGHLY = 3  # steps after which the cells are near enough to see outliers
ALONE, FAR_OFF = 4.5, 10.0  # standard deviations of an outlier, and its σ over its reading afterwards
COMMON, NEAR_PITCHES = (0.2, 0.2), 1.5  # parts of the variance, and how far neighbours are alike: assumptions
SCALE_SD = 3.0  # of the mean of ln r0: a wide prior


@dataclass(frozen=True, eq=False)
class Baseline:
    """ln r0 and the readings' offsets, Gaussian after the unloaded readings.

    logarithm : (rows, columns) mean of ln r0. offsets : those of `ModelErrors.offsets`, in standard deviations.
    covariance : of both together, (cells + offsets)².
    model_errors : the errors that are assumed. scene : circuit, panel and the film's response.
    """

    logarithm: Array
    offsets: Array
    covariance: Array
    model_errors: ModelErrors
    scene: Scene

    @property
    def response(self) -> Response:
        """Of the scene's film; the published one where it names none."""
        return self.scene.response or PUBLISHED

    def network(self, change: Array | float = 0.0) -> Network:
        """The solved network of cells r0·e^change."""
        cells = np.exp(self.logarithm + change)
        circuit = self.scene.circuit
        return circuit.network(cells, circuit.ties(cells), self.scene.wiring)

    @cached_property
    def alike(self) -> Array:
        """Correlation of the cells' departures from the response curve, (cells, cells).

        Parts of it are common to all cells (a bent film), shared by neighbours (a rim that presses harder on one side),
        and each cell's own.
        """
        common, near = COMMON
        return np.asarray(common + near * self.near + (1 - common - near) * np.eye(len(self.near)))

    @cached_property
    def near(self) -> Array:
        """exp(−½ (distance/NEAR_PITCHES)²) between all cells, (cells, cells)."""
        places = np.argwhere(np.ones(self.logarithm.shape, dtype=bool))
        square = ((places[:, None] - places) ** 2).sum(axis=2)
        return np.asarray(np.exp(-square / (2 * NEAR_PITCHES**2)))

    @classmethod
    def of(
        cls, measured: Array, sigma: Array, scene: Scene, model_errors: ModelErrors, common: Array | None = None
    ) -> "Baseline":
        """argmin ‖(R0 − f(r0) − E δ)/σ‖² + ‖(ln r0 − mean)/spread‖² + ‖δ‖², by Gauss-Newton steps.

        measured, sigma : (rows, columns) in the readout's unit. An outlier does not count. scene : what they were taken
        in. common : (cells, n), a root of the covariance of what they share by chance; None: nothing.
        """
        rows, columns = measured.shape
        circuit = scene.circuit
        spread = model_errors.offsets(measured, scene)
        cells, offsets = spread.shape
        prior = np.zeros((cells + offsets,) * 2)
        prior[:cells, :cells] = SCALE_SD**2 + np.eye(cells) * model_errors.cell_spread**2
        prior[cells:, cells:] = np.eye(offsets)
        mean = np.zeros(cells + offsets)
        mean[:cells] = np.log(np.median(circuit.uniform_start(measured)))
        noise, state = sigma.ravel() ** 2, mean
        shared = 0.0 if common is None else common @ common.T
        for step in range(STEPS):
            here = np.exp(state[:cells].reshape(rows, columns))
            network = circuit.network(here, circuit.ties(here), scene.wiring)
            slope = np.hstack([network.sensitivity(), spread])
            residual = measured.ravel() - network.reading().ravel() - spread @ state[cells:]
            across = prior @ slope.T
            innovation = residual + slope @ (state - mean)
            factor = cho_factor(slope @ across + np.diag(noise) + shared)
            if step == ROUGHLY:
                inverse = cho_solve(factor, np.eye(cells))
                outlier = np.abs(inverse @ innovation) > ALONE * np.sqrt(np.diag(inverse))  # as in `frame.outliers`
                noise = np.where(outlier, (FAR_OFF * measured.ravel()) ** 2, noise)
                factor = cho_factor(slope @ across + np.diag(noise) + shared)
            move = mean + across @ cho_solve(factor, innovation) - state
            state = state + move * min(1.0, 1.0 / np.abs(move[:cells]).max(initial=1e-300))
            if step > ROUGHLY and np.abs(move).max() < SETTLED:
                break
        covariance = prior - across @ cho_solve(factor, across.T)
        return cls(state[:cells].reshape(rows, columns), state[cells:], covariance, model_errors, scene)
