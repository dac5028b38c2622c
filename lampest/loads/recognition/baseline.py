"""The unloaded panel with its uncertainty: what every frame is compared with."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.recognition.model_errors import ModelErrors
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import Response
from lampest.panel.scene import Scene

STEPS = 12
SETTLED = 1e-6
ROUGHLY = 3  # steps after which the cells are near enough to see which reading stands alone
ALONE, FAR_OFF = 4.5, 10.0
CIRCUIT = TwoPointReadout()  # discs are fitted to two-point resistances
COMMON, NEAR_PITCHES = (0.2, 0.2), 1.5  # parts of the variance, and how far neighbours are alike: assumptions
SCALE_SD = 3.0  # of the mean of ln r0: a prior that says next to nothing


@dataclass(frozen=True, eq=False)
class Baseline:
    """ln r0 and the readings' offsets, Gaussian after the unloaded readings.

    logarithm : (rows, columns) mean of ln r0. offsets : those of `ModelErrors.offsets`, in standard deviations.
    covariance : of both together, (cells + offsets)².
    series_ohm : what was taken off the readings, to be broadcast to them. model_errors : the errors that are assumed.
    response : the scene's own; None: the published one.
    """

    logarithm: Array
    offsets: Array
    covariance: Array
    series_ohm: Array
    model_errors: ModelErrors
    response: Response | None = None

    @cached_property
    def alike(self) -> Array:
        """Correlation of the cells' departures from the response curve, (cells, cells).

        A film that is bent answers less everywhere, a rim presses harder on one side: parts of it are common to all
        cells, shared by neighbours, and each cell's own.
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

        measured, sigma : (rows, columns) ohm. A reading that stands alone against all others does not count.
        scene : what they were taken in. common : (cells, n) ohm, a root of the covariance of what they share by chance;
        None: nothing. Raises ValueError unless its readout is a two-point one.
        """
        if not isinstance(scene.circuit, TwoPointReadout):
            raise ValueError("recognition knows readout.kind: two_point only")
        if scene.wiring is not None:
            raise ValueError("recognition knows neither lines, contacts nor faults.joined_rows and joined_columns")
        series_ohm = scene.series_ohm
        rows, columns = measured.shape
        spread = model_errors.offsets(measured + series_ohm)
        cells, offsets = spread.shape
        prior = np.zeros((cells + offsets,) * 2)
        prior[:cells, :cells] = SCALE_SD**2 + np.eye(cells) * model_errors.cell_spread**2
        prior[cells:, cells:] = np.eye(offsets)
        mean = np.zeros(cells + offsets)
        mean[:cells] = np.log(np.median(CIRCUIT.uniform_start(measured)))
        noise, state = sigma.ravel() ** 2, mean
        shared = 0.0 if common is None else common @ common.T
        for step in range(STEPS):
            network = network_of(state[:cells].reshape(rows, columns))
            slope = np.hstack([network.sensitivity(), spread])
            residual = measured.ravel() - network.reading().ravel() - spread @ state[cells:]
            across = prior @ slope.T
            innovation = residual + slope @ (state - mean)
            factor = cho_factor(slope @ across + np.diag(noise) + shared)
            if step == ROUGHLY:
                noise = np.where(_alone(factor, innovation), (FAR_OFF * measured.ravel()) ** 2, noise)
                factor = cho_factor(slope @ across + np.diag(noise) + shared)
            move = mean + across @ cho_solve(factor, innovation) - state
            state = state + move * min(1.0, 1.0 / np.abs(move[:cells]).max(initial=1e-300))
            if step > ROUGHLY and np.abs(move).max() < SETTLED:
                break
        covariance = prior - across @ cho_solve(factor, across.T)
        return cls(
            state[:cells].reshape(rows, columns), state[cells:], covariance, series_ohm, model_errors, scene.response
        )


def _alone(factor: tuple[Array, bool], innovation: Array) -> NDArray[np.bool_]:
    """Whether a reading is far from what all others and the spread of cells let expect; see `frame.outliers`."""
    inverse = cho_solve(factor, np.eye(len(innovation)))
    alone: NDArray[np.bool_] = np.abs(inverse @ innovation) > ALONE * np.sqrt(np.diag(inverse))
    return alone


def network_of(logarithm: Array) -> Network:
    """The network of cells ln r (rows, columns)."""
    cells = np.exp(logarithm)
    return CIRCUIT.network(cells, CIRCUIT.ties(cells))
