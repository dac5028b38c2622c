"""The unloaded panel with its uncertainty, and what a film remembers of loads: what every frame is compared with."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.film import Creep
from lampest.loads.recognition.settings import ModelErrors
from lampest.loads.response import PUBLISHED
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import Response
from lampest.panel.scene import Scene

STEPS, SETTLED = 12, 1e-6  # of Gauss and Newton, at most; the change of ln r0 that ends them
ROUGHLY = 3  # steps after which the cells are near enough to see outliers
ALONE, FAR_OFF = 4.5, 10.0  # standard deviations of an outlier, and its σ over its reading afterwards
CIRCUIT = TwoPointReadout()  # discs are fitted to two-point resistances
COMMON, NEAR_PITCHES = (0.2, 0.2), 1.5  # parts of the variance, and how far neighbours are alike: assumptions
SCALE_SD = 3.0  # of the mean of ln r0: a wide prior
# Of a film's memory, assumptions. OWN: relative, of each cell's; films answer with a scatter of a tenth to a quarter.
OWN = 0.3
FAINT = 2e-3  # of ln r/r0, that of a cell at rest apart from drift: less is not worth a new baseline
MOST = 3.0  # of ln r/r0 in a fit: beyond are open cells and dead shorts
TAKEN, KEPT = 3.0, 600.0  # s in which P follows an answer that grows, and fades to one that is less


@dataclass(frozen=True, eq=False)
class Baseline:
    """ln r0 and the readings' offsets, Gaussian after the unloaded readings.

    logarithm : (rows, columns) mean of ln r0. offsets : those of `ModelErrors.offsets`, in standard deviations.
    covariance : of both together, (cells + offsets)².
    series_ohm : what was taken off the readings, to be broadcast to them. model_errors : the errors that are assumed.
    response : of the scene.
    """

    logarithm: Array
    offsets: Array
    covariance: Array
    series_ohm: Array
    model_errors: ModelErrors
    response: Response = PUBLISHED

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

        measured, sigma : (rows, columns) ohm. An outlier does not count.
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
                inverse = cho_solve(factor, np.eye(cells))
                outlier = np.abs(inverse @ innovation) > ALONE * np.sqrt(np.diag(inverse))  # as in `frame.outliers`
                noise = np.where(outlier, (FAR_OFF * measured.ravel()) ** 2, noise)
                factor = cho_factor(slope @ across + np.diag(noise) + shared)
            move = mean + across @ cho_solve(factor, innovation) - state
            state = state + move * min(1.0, 1.0 / np.abs(move[:cells]).max(initial=1e-300))
            if step > ROUGHLY and np.abs(move).max() < SETTLED:
                break
        covariance = prior - across @ cho_solve(factor, across.T)
        logarithm, response = state[:cells].reshape(rows, columns), scene.response or PUBLISHED
        return cls(logarithm, state[cells:], covariance, series_ohm, model_errors, response)


def network_of(logarithm: Array) -> Network:
    """The network of cells ln r (rows, columns)."""
    cells = np.exp(logarithm)
    return CIRCUIT.network(cells, CIRCUIT.ties(cells))


@dataclass(frozen=True, eq=False)
class Remembered:
    """After a load a cell shows ln r/r0 = −c S − k P: what is left of it, and looks like a weaker load.

    S = Σ_j s_j is the creep of what it has answered (see `lampest.loads.film`); P is its largest recent answer, which
    some films keep a part of, for minutes. c and k are known to a common error each, and each cell's memory to one of
    its own.

    creep : of (rows, columns), with a strength of 1. held : P (rows, columns).
    seconds : since the baseline, of the last frame. before : (2, rows, columns) S and P when the baseline was taken; 0
    where nothing had been there.
    """

    creep: Creep
    held: Array
    seconds: float = 0.0
    before: Array | float = 0.0

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> "Remembered":
        """Before the first frame."""
        return cls(Creep.at_rest(np.ones(shape)), np.zeros(shape))

    def after(self, change: Array, seconds: float) -> "Remembered":
        """Once a load has changed ln r by so much, (rows, columns), until so many seconds after the baseline."""
        answer, lasted = -np.clip(change, -MOST, MOST), max(seconds - self.seconds, 0.0)
        kept = np.exp(-lasted / np.where(np.abs(answer) > np.abs(self.held), TAKEN, KEPT))
        held = answer + (self.held - answer) * kept
        return replace(self, creep=self.creep.after(answer, lasted), held=held, seconds=seconds)

    def against(self, then: "Remembered", seconds: float) -> "Remembered":
        """The same against a baseline that was taken so many seconds after this one, when the film was as `then`."""
        return replace(self, seconds=self.seconds - seconds, before=then.patterns(seconds))

    def patterns(self, seconds: float) -> Array:
        """S and P, (2, rows, columns), at a time since the baseline, if nothing comes until then."""
        nothing, lasts = np.zeros(self.held.shape), max(seconds - self.seconds, 0.0)
        return np.stack([self.creep.answer(nothing, lasts), self.held * np.exp(-lasts / KEPT)])

    def rest(self, baseline: Baseline, seconds: float) -> Baseline:
        """The panel at rest so many seconds after the baseline; the baseline itself while nothing is remembered."""
        errors, shape = baseline.model_errors, baseline.logarithm.shape
        patterns = (self.patterns(seconds) - self.before).reshape(2, -1)
        common = np.array([errors.creep_sd, errors.remanence_sd])
        size = np.hypot([errors.creep, 0.0], common)
        if np.abs(size @ np.abs(patterns)).max() < FAINT:
            return baseline
        covariance, cells = baseline.covariance.copy(), patterns.shape[1]
        spread = common[:, None] * patterns
        own = OWN * size[:, None] * patterns
        covariance[:cells, :cells] += spread.T @ spread + np.diag((own**2).sum(axis=0))
        remembered = errors.creep * patterns[0].reshape(shape)
        return replace(baseline, logarithm=baseline.logarithm - remembered, covariance=covariance)
