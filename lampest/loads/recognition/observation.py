"""The unloaded panel, and the likelihood of one frame: how readings follow from a pressure on the cells.

    R = f(r0·e^x) + E δ + noise,   x = κ·(ln F(p + p_w) − ln F(p_w))

f is the circuit, F the film's response, κ the cells' gains, δ the errors common to all frames. All errors are Gaussian.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot, log10
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, lapack

from lampest.files.levels import NOISE_REACH, SIGNIFICANT
from lampest.panel.network import Network
from lampest.panel.panel import Array, Panel
from lampest.panel.response import PUBLISHED, RESPONSE_SD, Response
from lampest.panel.scene import Scene, Systematic

PATCH_SHARE = 0.6  # edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm


def patch_of(panel: Panel, patch_mm: float | None = None) -> float:
    """Edge of the film in mm, 6/10 of the pitch where nobody says; never more than the pitch."""
    return min(PATCH_SHARE * panel.pitch_mm if patch_mm is None else patch_mm, panel.pitch_mm)


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of quantities that are not measured.

    Parameters
    ----------
    response : of ln(r/r0) at a pressure, as a fraction of ln f(p): cells answer differently.
    common, near : parts of that variance that all cells share, and neighbours within `near_pitches`.
    bent : of the same, alike in all cells: bent film answers less, by half where it is bent sharply.
    edge_mm : of the place of a patch's edge, at a relative deviation of 1: patches are glued by hand, rims are soft.
    patch : of the patches' edge, relative, alike in all cells: a round one is as a square one of 0.89 its width.
    cell_spread : of the logarithm of the unloaded cells about their mean; only a prior where data are too noisy.
    drift, common_drift : of ln r at rest for each decade of minutes, of each cell and of all alike (temperature).
    settled : of ln r at rest, apart from drift.
    channel_ohm : of the on-resistance of a multiplexer's channel about its mean, one for each line.
    reference : relative error of the reference resistor: 1 % at most, uniform.
    reading_error : of the logarithm of a factor on each reading, the same in all frames.
    swaying : of ln r and of ln y that all cells and all readings may share: temperature, waves, supply.
    residue : of what a film keeps of a load that left, relative to its ln r/r0.
    mapped, coarse : of ln r/r0 of cells while a load is looked for, on a map of them, and at rest in coarse fits.

    Source: CD74HC4067 (about 10 ohm between any two channels), ordinary 1 % resistors, films that creep by a few
    percent for each decade of time; the others are assumptions.
    """

    response: float = RESPONSE_SD
    common: float = 0.2
    near: float = 0.2
    near_pitches: float = 1.5
    bent: float = 0.15
    edge_mm: float = 3.0
    patch: float = 0.13
    cell_spread: float = 0.4
    drift: float = 0.01
    common_drift: float = 0.02
    settled: float = 0.002
    channel_ohm: float = 3.0
    reference: float = 0.006
    reading_error: float = 0.0
    swaying: float = 0.1
    residue: float = 0.12
    mapped: float = 0.5
    coarse: float = 0.2

    def of_scene(self, scene: Scene, reading_error: float) -> "ModelErrors":
        """Return the errors that a scene specifies, with one of each reading as estimated from the frames."""
        errors = replace(self, reading_error=reading_error)
        if scene.systematic is None:
            return errors
        named = scene.specified_systematic or Systematic()
        reference = named.reference_tolerance / np.sqrt(3)  # of a uniform distribution of that half width
        return replace(errors, channel_ohm=named.channel_spread_ohm, reference=reference)

    def resting_sd(self, seconds: float) -> float:
        """Return standard deviation of ln r of a cell at rest by itself, `seconds` after the baseline."""
        return hypot(self.drift * log10(1 + seconds / 60), self.settled)

    def resting_covariance(self, seconds: float, cells: int) -> Array:
        """Return the covariance of ln r of all cells at rest, (cells, cells): their own part and the common one."""
        common = self.common_drift * log10(1 + seconds / 60)
        return self.resting_sd(seconds) ** 2 * np.eye(cells) + common**2

    def offsets(self, measured: Array, scene: Scene) -> Array:
        """Return E·sd (cells, offsets).

        The effect of one standard deviation of every offset on the readings, in their unit.

        Offsets are those of rows and columns of every module (of two-point resistances), of the reference, and where
        there are such errors, of each reading. measured : (rows, columns), without the resistance in series.
        """
        layout, (rows, columns) = scene.panel.modules, measured.shape
        row, column = np.indices(measured.shape)
        if layout is not None:
            row, column = row + rows * (column // layout.each.columns), column + columns * (row // layout.each.rows)
        in_ohm = scene.circuit.unit == "ohm"
        total = (measured + scene.series_ohm if in_ohm else measured).reshape(-1, 1)
        lines = [line.reshape(-1, 1) == np.unique(line) for line in (row, column)] if in_ohm else []
        own = [np.diag(self.reading_error * total[:, 0])] if self.reading_error else []
        return np.hstack([*(self.channel_ohm * line for line in lines), self.reference * total, *own])


# Of ln r: the longest Gauss-Newton step; and the most a load may change, beyond which a cell is open or shorted to all
# readings, and a network soon has no inverse.
MAX_STEP, MAX_LOG_CHANGE = 1.5, 12.0
OUTLIER_SHARE = 0.03  # part of the readings that may be outliers
DROPPED_FACTOR = 1e3  # so many times its σ, or its reading, is the σ of one that does not count


def counting(sigma: Array, measured: Array) -> Array:
    """σ, so large that a reading does not count where it is no value (no finite, positive σ); any shape, ohm."""
    return np.where(np.isfinite(sigma) & (sigma > 0), sigma, DROPPED_FACTOR * measured)


class MostProbable(NamedTuple):
    """x that minimises ‖y − f(x)‖² in C + ‖x − mean‖² in P, with f linearised where the last step began.

    Attributes
    ----------
    state : array
        x (n).
    prior : array
        P.
    across : array
        P Aᵀ (n, readings).
    whitening : Whitening
        Of A P Aᵀ + C.
    apart : array
        y − f(mean) (readings).
    """

    state: Array
    prior: Array
    across: Array
    whitening: "Whitening"
    apart: Array

    @property
    def covariance(self) -> Array:
        """Covariance of x after the readings, (n, n)."""
        return np.asarray(self.prior - self.across @ cho_solve((self.whitening.root, True), self.across.T))


def most_probable(
    model: Callable[[Array], tuple[Array, Array, Array]], start: Array, mean: Array, prior: Array, settled: float
) -> MostProbable:
    """Return the most probable point by Gauss-Newton steps in the space of the readings, twelve at most.

    model : x → (y − f(x), A = ∂f/∂x, C).
    """
    state = start
    for _ in range(12):
        residual, slope, noise = model(state)
        across = prior @ slope.T
        root = cholesky(slope @ across + noise, lower=True)
        apart = residual + slope @ (state - mean)
        step = np.clip(mean + across @ cho_solve((root, True), apart) - state, -MAX_STEP, MAX_STEP)
        state = state + step
        if np.abs(step).max() < settled:
            break
    return MostProbable(state, prior, across, Whitening(root), apart)


@dataclass(frozen=True, eq=False)
class Baseline:
    """ln r0 and the readings' offsets, Gaussian after the unloaded readings.

    Attributes
    ----------
    logarithm : array, shape (rows, columns)
        Mean of ln r0.
    offsets : array
        Those of `ModelErrors.offsets`, in standard deviations.
    covariance : array
        Of both together, (cells + offsets)².
    scene : Scene
        Circuit, panel and response.
    """

    logarithm: Array
    offsets: Array
    covariance: Array
    model_errors: ModelErrors
    scene: Scene

    @classmethod
    def of(
        cls, measured: Array, sigma: Array, scene: Scene, model_errors: ModelErrors, common: Array | None = None
    ) -> "Baseline":
        """argmin ‖(R0 − f(r0) − E δ)/σ‖² + ‖(ln r0 − mean)/spread‖² + ‖δ‖², outliers left out.

        Parameters
        ----------
        measured, sigma : array, shape (rows, columns)
            In the readout's unit.
        common : array, shape (cells, n) or None
            A root of the covariance of what they share by chance; None: nothing.
        """
        circuit, spread = scene.circuit, model_errors.offsets(measured, scene)
        cells, offsets = spread.shape
        mean, prior = np.zeros(cells + offsets), np.eye(cells + offsets)
        mean[:cells] = np.log(np.median(circuit.uniform_start(measured)))
        prior[:cells, :cells] = 9.0 + model_errors.cell_spread**2 * np.eye(cells)  # their mean is open: σ = 3
        absent = np.flatnonzero(~scene.panel.present)
        mean[absent] += MAX_LOG_CHANGE
        prior[absent] = prior[:, absent] = 0.0
        shared, noise = 0.0 if common is None else common @ common.T, sigma.ravel() ** 2

        def model(state: Array) -> tuple[Array, Array, Array]:
            resistance = np.exp(state[:cells].reshape(measured.shape))
            network = circuit.network(resistance, circuit.ties(resistance), scene.wiring)
            residual = measured.ravel() - network.reading().ravel() - spread @ state[cells:]
            return residual, np.hstack([network.sensitivity(), spread]), np.diag(noise) + shared

        coarse = most_probable(model, mean, mean, prior, MAX_STEP / 10)
        noise[outliers(coarse.whitening, coarse.apart)] *= DROPPED_FACTOR**2
        fine = most_probable(model, coarse.state, mean, prior, 1e-6)
        logarithm, shifts = fine.state[:cells].reshape(measured.shape), fine.state[cells:]
        return cls(logarithm, shifts, fine.covariance, model_errors, scene)

    @property
    def response(self) -> Response:
        """Response of the scene's film; the published one where it names none."""
        return self.scene.response or PUBLISHED

    def network(self, change: Array | float = 0.0) -> Network:
        """Return the solved network of cells r0·e^change."""
        cells, circuit = np.exp(self.logarithm + change), self.scene.circuit
        return circuit.network(cells, circuit.ties(cells), self.scene.wiring)

    @cached_property
    def near(self) -> Array:
        """exp(−½ (distance/near_pitches)²) between all cells, (cells, cells); a crossing without one is near none."""
        places = self.scene.panel.places_mm.reshape(2, -1) / self.scene.panel.pitch_mm
        square = ((places[:, :, None] - places[:, None]) ** 2).sum(axis=0)
        np.fill_diagonal(square, 0.0)
        return np.asarray(np.nan_to_num(np.exp(-square / (2 * self.model_errors.near_pitches**2))))

    def film(self, explained: "Explained", scatter: float) -> Array:
        """s² (x K xᵀ + w²) + b b ᵀ, (cells, cells) of ln r: how a film with a relative deviation of s departs from x.

        K is the correlation of cells: shared, near and own; b is common to all, by a bent film and by the patches'
        sizes.
        """
        errors, (change, edges, patches) = self.model_errors, (part.ravel() for part in explained)
        similar = errors.common + errors.near * self.near + (1 - errors.common - errors.near) * np.eye(len(self.near))
        shared = np.stack([errors.bent * change, errors.patch * patches])
        uneven = similar * np.outer(change, change) + np.diag((errors.edge_mm * edges) ** 2)
        return np.asarray(scatter**2 * uneven + shared.T @ shared)


@dataclass(frozen=True, eq=False)
class Observation:
    """A frame's readings and the baseline that they are compared with.

    Attributes
    ----------
    measured, sigma : array, shape (rows, columns)
        Ohm.
    water : array, shape (rows, columns)
        KPa, that of the unloaded frames too.
    seconds : float
        Since the baseline.
    common : array, shape (cells, n) or None
        Ohm, a root of the covariance of what the frame's readings share by chance, its gain and patterns along scanned
        lines; None: nothing.
    """

    measured: Array
    sigma: Array
    baseline: Baseline
    water: Array
    seconds: float
    common: Array | None = field(default=None, kw_only=True)

    def residual(self, change: Array | float = 0.0) -> Array:
        """R − f(r0·e^change) − E δ, (cells)."""
        return np.asarray(self.target - self.baseline.network(change).reading().ravel())

    def slope(self, change: Array) -> Array:
        """∂f/∂ln r at ln r/r0 = `change`, (cells, cells)."""
        return self.baseline.network(change).sensitivity()

    def change(self, pressure: Array) -> tuple[Array, Array]:
        """x of pressures and its slope, (rows, columns), 1 and 1/kPa; MAX_LOG_CHANGE at most."""
        response, step = self.baseline.response, 1e-3  # kPa: the slope is a difference, F has corners
        near = pressure + self.water + np.array([0.0, step, -step])[:, None, None]
        change, up, down = response.gains * (response.logarithm(near) - self._immersed)
        return np.clip(change, -MAX_LOG_CHANGE, MAX_LOG_CHANGE), (up - down) / (2 * step) * (
            np.abs(change) < MAX_LOG_CHANGE
        )

    @cached_property
    def _immersed(self) -> Array:
        """ln F(p_w), (rows, columns)."""
        return self.baseline.response.logarithm(self.water)

    def covariance(self, slope: Array, cells: Array | float = 0.0) -> Array:
        """σ² + V Vᵀ + H C Hᵀ + J T Jᵀ, (cells, cells) ohm², at the slope J (cells, cells).

        Of each reading, of all in a frame, of the baseline, and of cells at rest; cells : added to T, of ln r.
        """
        both, errors = np.hstack([slope, self.offsets]), self.baseline.covariance.copy()
        errors[: len(slope), : len(slope)] += self.baseline.model_errors.resting_covariance(self.seconds, len(slope))
        errors[: len(slope), : len(slope)] += cells
        total = both @ errors @ both.T
        if self.common is not None:
            total += self.common @ self.common.T
        return np.asarray(total + np.diag(self.sigma.ravel() ** 2))

    def cells(self, start: Array, prior: Array) -> MostProbable:
        """Return the most probable ln r/r0 of all cells, Gaussian with mean zero and this covariance, from a start."""

        def model(change: Array) -> tuple[Array, Array, Array]:
            network = self.baseline.network(change.reshape(self.measured.shape))
            slope = network.sensitivity()
            return self.target - network.reading().ravel(), slope, self.covariance(slope)

        return most_probable(model, start.ravel(), np.zeros(start.size), prior, MAX_STEP / 10)

    @cached_property
    def _mapped(self) -> MostProbable:
        nothing = np.zeros(self.measured.shape)
        return self.cells(nothing, self.baseline.model_errors.mapped**2 * np.eye(nothing.size))

    @property
    def map(self) -> Array:
        """ln r/r0 of every cell, (rows, columns): of independent cells with that standard deviation."""
        return self._mapped.state.reshape(self.measured.shape)

    @cached_property
    def highest(self) -> Array:
        """Map of ln r/r0 plus NOISE_REACH standard deviations, (rows, columns): the readings exclude more."""
        return self.map + NOISE_REACH * np.sqrt(np.diag(self._mapped.covariance)).reshape(self.measured.shape)

    @cached_property
    def target(self) -> Array:
        """The readings without the most probable offsets, (cells) ohm."""
        return np.asarray(self.measured.ravel() - self.offsets @ self.baseline.offsets)

    @cached_property
    def offsets(self) -> Array:
        """E (cells, offsets) ohm: the effect of every offset's standard deviation on the readings."""
        return self.baseline.model_errors.offsets(self.measured, self.baseline.scene)

    def without(self, dropped: NDArray[np.intp]) -> "Observation":
        """Return the observation with some readings' σ so large that they no longer count."""
        sigma = self.sigma.copy()
        sigma.flat[dropped] *= DROPPED_FACTOR
        return replace(self, sigma=sigma)


class Explained(NamedTuple):
    """The change that a load explains, (rows, columns) ln r/r0.

    edges, patches : by how much a shift of the load by 1 mm changes that, and patches that are larger by their edge.
    """

    change: Array
    edges: Array
    patches: Array


@dataclass(frozen=True, eq=False)
class Whitening:
    """The root of a covariance, lower triangular, with the relative deviation of the film that it was made for."""

    root: Array
    scatter: float = 0.0

    @classmethod
    def of(cls, frame: Observation, explained: Explained, scatter: float) -> "Whitening":
        """Return the errors about the change that a load explains; scatter : relative deviation of the cells."""
        slope = frame.slope(explained.change)
        return cls(cholesky(frame.covariance(slope, frame.baseline.film(explained, scatter)), lower=True), scatter)

    @classmethod
    def at_rest(cls, frame: Observation) -> "Whitening":
        """For a panel that nothing touches."""
        slope = frame.slope(np.zeros(frame.measured.shape))
        return cls(cholesky(frame.covariance(slope), lower=True))

    @classmethod
    def coarse(cls, frame: Observation, change: Array) -> "Whitening":
        """About ln r/r0 (rows, columns) that every cell may depart from alike."""
        slope, sd = frame.slope(change), frame.baseline.model_errors.coarse
        return cls(cholesky(frame.covariance(slope, sd**2 * np.eye(len(slope))), lower=True))

    @cached_property
    def volume(self) -> float:
        """½ ln det C."""
        return float(np.log(np.diag(self.root)).sum())

    def __matmul__(self, vectors: Array) -> Array:
        """L⁻¹·v: errors of unit variance."""
        return np.asarray(lapack.dtrtrs(self.root, vectors, lower=1)[0])


def outliers(whitening: Whitening, residual: Array) -> NDArray[np.intp]:
    """Return the numbers of the readings that lie far from the prediction of all others; residual (cells) ohm.

    z_i = (C⁻¹e)_i/√(C⁻¹)_ii is the error of i as predicted from the rest, over its standard deviation. The worst one
    is taken out before the next is looked for.
    """
    inverse = whitening @ np.eye(len(residual))
    precision = inverse.T @ inverse
    pull, left = precision @ residual, np.ones(len(residual), dtype=bool)
    for _ in range(max(1, int(OUTLIER_SHARE * len(residual)))):
        score = np.where(left, np.abs(pull) / np.sqrt(np.where(left, np.diag(precision), 1.0)), 0.0)
        worst = int(np.argmax(score))
        if score[worst] <= SIGNIFICANT:
            break
        left[worst] = False
        column = precision[:, worst] / precision[worst, worst]
        pull = pull - column * pull[worst]
        precision = precision - np.outer(column, precision[worst])
    return np.flatnonzero(~left)
