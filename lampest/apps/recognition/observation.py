"""Unloaded panel and likelihood of a frame: the model of readings under a pressure on the cells.

    R = f(r0·e^x) + E δ + noise,   x = κ·(ln F(p + p_w) − ln F(p_w))

f is the circuit, F the film's response, κ the cells' gains, p_w the water's pressure, and δ the
errors common to all frames with the effect E on the readings. All errors are Gaussian.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import log10
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, cholesky

from lampest.apps.recognition.model_errors import ModelErrors, RecognitionScene
from lampest.apps.recognition.most_probable import (
    MAX_STEP,
    MostProbable,
    Whitening,
    most_probable,
    outliers,
)
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.network import Network
from lampest.panel.panel import Array, Numbers, Panel
from lampest.panel.response import PUBLISHED, Response

# Edge of a cell's film over the pitch, as on the panel of the paper: 6 mm at 10 mm.
PATCH_SHARE = 0.6


def patch_of(panel: Panel, patch_mm: float | None = None) -> float:
    """Return the edge of a cell's film in mm, by default PATCH_SHARE of the pitch.

    The pitch is the upper limit.
    """
    return min(PATCH_SHARE * panel.pitch_mm if patch_mm is None else patch_mm, panel.pitch_mm)


# Of ln r: the largest change by a load. Beyond, a cell is open or shorted to all readings, and the
# network soon becomes singular.
MAX_LOG_CHANGE = 12.0
# Factor on σ, or on the reading, that gives the σ of a reading that does not count.
DROPPED_FACTOR = 1e3
# Of a film's response from cell to cell, over the usual deviation: films are glued and bent.
UNEVENNESS = 2.5
# Assumed fastest rise of a water level, kPa/s: 5 mm in a second.
LEVEL_RATE = 0.05
# Time constant, s, with which means follow the frames, and with which a residue fades.
FOLLOWS_S = 20.0


def nothing_shared(readings: Array) -> Array:
    """Return no columns for errors that the readings of a frame share, (cells, 0)."""
    return np.zeros((readings.size, 0))


def counting(sigma: Array, measured: Array) -> Array:
    """Return σ of any shape, ohm, made large where the reading must not count.

    Where σ is not finite and positive, it is made so large that the reading does not count.
    """
    return np.where(np.isfinite(sigma) & (sigma > 0), sigma, DROPPED_FACTOR * measured)


def leaking_network(
    scene: RecognitionScene, cells: Array, leaks: Sequence[LineEffect] = ()
) -> Network:
    """Return the solved network of cells (rows, columns) ohm, with leaks between lines."""
    circuit = scene.circuit
    network = circuit.network(cells, circuit.ties(cells), scene.wiring)
    for leak in leaks:
        network = leak.changed(network)
    return network


@dataclass(frozen=True, eq=False)
class Baseline:
    """Gaussian posterior of ln r0 and of the offsets δ, given the unloaded readings.

    Attributes
    ----------
    logarithm : array, shape (rows, columns)
        Mean of ln r0.
    offsets : array, shape (offsets,)
        Mean of δ, see `ModelErrors.offsets`, in standard deviations.
    covariance : array, shape (cells + offsets, cells + offsets)
        Joint covariance of both.
    model_errors : ModelErrors
    scene : RecognitionScene
        Circuit and panel.
    response : Response
        Response of the film; the published one where the scene names none.
    leaks : tuple of LineEffect
        Leaks between lines, which are parts of the circuit.
    """

    logarithm: Array
    offsets: Array
    covariance: Array
    model_errors: ModelErrors
    scene: RecognitionScene
    response: Response
    leaks: tuple[LineEffect, ...] = ()

    @classmethod
    def of(
        cls,
        measured: Array,
        sigma: Array,
        scene: RecognitionScene,
        model_errors: ModelErrors,
        common: Array | float = 0.0,
        leaks: tuple[LineEffect, ...] = (),
    ) -> "Baseline":
        """Return argmin ‖(R0 − f(r0) − E δ)/σ‖² + ‖(ln r0 − mean)/spread‖² + ‖δ‖².

        Outliers are left out. E belongs to f(r0), as in `Observation.offsets`: with E of R0, an
        unchanged frame would differ from the baseline by the squares of its errors.

        Parameters
        ----------
        measured, sigma : array, shape (rows, columns)
            Unloaded readings R0 and their standard deviations, in the readout's unit.
        scene : RecognitionScene
        model_errors : ModelErrors
        common : array, shape (cells, n), optional
            Root of the covariance of random errors that the readings share.
        leaks : tuple of LineEffect
        """
        circuit = scene.circuit
        cells, offsets = model_errors.offsets(measured, scene).shape
        mean = np.zeros(cells + offsets)
        prior = np.eye(cells + offsets)
        mean[:cells] = np.log(np.median(circuit.uniform_start(measured)))
        # Their mean is open: σ = 3.
        prior[:cells, :cells] = 9.0 + model_errors.cell_spread**2 * np.eye(cells)
        # Crossings that do not conduct have nearly no conductance: the readings that an open line
        # would then have lie within the σ of readings that do not count.
        opened = np.flatnonzero(scene.open_cells)
        mean[opened] += np.log(DROPPED_FACTOR)
        prior[opened] = prior[:, opened] = 0.0
        shared = np.inner(common, common)
        noise = sigma.ravel() ** 2

        def model(state: Array) -> tuple[Array, Array, Array]:
            resistance = np.exp(state[:cells].reshape(measured.shape))
            network = leaking_network(scene, resistance, leaks)
            spread = model_errors.offsets(network.reading(), scene)
            residual = measured.ravel() - network.reading().ravel() - spread @ state[cells:]
            slope = model_errors.gain(state[cells:], scene)[:, None] * network.sensitivity()
            return residual, np.hstack([slope, spread]), np.diag(noise) + shared

        # A first fit identifies outliers; the second one, without them, is solved to convergence.
        coarse = most_probable(model, mean, mean, prior, MAX_STEP / 10)
        noise[outliers(coarse.whitening, coarse.apart)] *= DROPPED_FACTOR**2
        fine = most_probable(model, coarse.state, mean, prior, 1e-6)
        logarithm = fine.state[:cells].reshape(measured.shape)
        shifts = fine.state[cells:]
        response = scene.response or PUBLISHED
        return cls(logarithm, shifts, fine.covariance, model_errors, scene, response, leaks)

    def network(self, change: Array | float = 0.0) -> Network:
        """Return the solved network of cells r0·e^change."""
        return leaking_network(self.scene, np.exp(self.logarithm + change), self.leaks)

    @cached_property
    def near(self) -> Array:
        """exp(−½ (distance/near_pitches)²) between all cells, (cells, cells).

        The value is 0 for crossings without a cell.
        """
        places = self.scene.panel.places_mm.reshape(2, -1) / self.scene.panel.pitch_mm
        square = ((places[:, :, None] - places[:, None]) ** 2).sum(axis=0)
        np.fill_diagonal(square, 0.0)
        return np.asarray(np.nan_to_num(np.exp(-square / (2 * self.model_errors.near_pitches**2))))

    def film_parts(self, explained: Array) -> tuple[Array, Array]:
        """Return the parts of the covariance of ln r by deviations of the film, (cells, cells).

        They are U and S of the covariance s² U + S, where s is the film's relative deviation. The
        sum s² (x K xᵀ + diag w²) + b bᵀ has the explained change x, the correlation K of cells
        (common, near and own parts), the effect w of misplaced edges, and the errors b that all
        cells share, by bending and by the patches' sizes.

        Parameters
        ----------
        explained : array, shape (3, rows, columns)
            The change ln r/r0 that a load explains, and its derivatives by a shift of the load,
            1/mm, and by ln of the patches' edge.
        """
        errors = self.model_errors
        change, edges, patches = (part.ravel() for part in explained)
        similar = (
            errors.common
            + errors.near * self.near
            + (1 - errors.common - errors.near) * np.eye(len(self.near))
        )
        shared = np.stack([errors.bent * change, errors.patch * patches])
        uneven = similar * np.outer(change, change) + np.diag((errors.edge_mm * edges) ** 2)
        return uneven, shared.T @ shared


class CommonChange(NamedTuple):
    """Change of all cells by one cause.

    Attributes
    ----------
    unit : array, shape (cells,)
        ln r/r0 of each cell over that of the median cell.
    uneven : array, shape (cells, cells)
        Covariance of ln r/r0 by films that respond differently.
    mean : array, shape (rows, columns)
        ln r/r0 by the level of the water; 0 where an equal change leaves less scatter.
    """

    unit: Array
    uneven: Array
    mean: Array


@dataclass(frozen=True, eq=False)
class Observation:
    """A frame's readings and the baseline with which they are compared.

    Attributes
    ----------
    measured, sigma : array, shape (rows, columns)
        Readings and their standard deviations in the readout's unit.
    baseline : Baseline
    water : array, shape (rows, columns)
        Pressure of the water, kPa, equal in the unloaded frames.
    seconds : float
        Time since the baseline.
    common : callable
        Returns a root (cells, n) of the covariance of random errors that the frame's readings
        share, by default none: gain, ripple along scanned lines, motion of the water. It is of the
        readings that a network predicts: two such roots, of a loaded and of the unloaded panel,
        would explain any load as a difference of errors.
    """

    measured: Array
    sigma: Array
    baseline: Baseline
    water: Array
    seconds: float = 0.0
    common: Callable[[Array], Array] = field(default=nothing_shared, kw_only=True)

    @property
    def panel(self) -> Panel:
        """The panel of the baseline's scene."""
        return self.baseline.scene.panel

    def residual(self, change: Array | float = 0.0) -> Array:
        """Return R − f(r0·e^change) − E δ, (cells,)."""
        return self.deviation(self.baseline.network(change))

    def deviation(self, network: Network) -> Array:
        """Return R − f − E δ, (cells,), of a solved network with the readings f."""
        expected = network.reading().ravel() + self.offsets(network) @ self.baseline.offsets
        return self.measured.ravel() - expected

    def offsets(self, network: Network) -> Array:
        """Return E (cells, offsets), the effect of every offset's standard deviation.

        E belongs to the readings that a network predicts. With E of the measured readings, an error
        of the reference would explain any change of a frame: E δ of the frame and of the unloaded
        panel differ by a multiple of the change itself.
        """
        return self.baseline.model_errors.offsets(network.reading(), self.baseline.scene)

    def slope(self, change: Array | float = 0.0) -> Array:
        """Return ∂(f + E δ)/∂ln r at ln r/r0 = `change`, (cells, cells)."""
        return self.sensitivity(self.baseline.network(change))

    def sensitivity(self, network: Network) -> Array:
        """Return the derivative of f + E δ by ln r, (cells, cells), of a solved network."""
        return self._gain[:, None] * network.sensitivity()

    def change(self, pressure: Array) -> tuple[Array, Array]:
        """Return the change of cells under pressures (rows, columns) kPa.

        Returns
        -------
        change : array, shape (rows, columns)
            x = ln r/r0, |x| at most MAX_LOG_CHANGE.
        slope : array, shape (rows, columns)
            dx/dp in 1/kPa.
        """
        response = self.baseline.response
        # kPa, for a central difference: F has corners
        step = 1e-3
        # x = κ (ln F(p + p_w) − ln F(p_w)) at p and p ± step
        near = pressure + self.water + np.array([0.0, step, -step])[:, None, None]
        change, up, down = response.gains * (
            response.logarithm(near) - response.logarithm(self.water)
        )
        within = np.abs(change) < MAX_LOG_CHANGE
        slope = (up - down) / (2 * step) * within
        return np.clip(change, -MAX_LOG_CHANGE, MAX_LOG_CHANGE), slope

    @cached_property
    def _gain(self) -> Array:
        """Derivative of f + E δ by f, (cells,)."""
        baseline = self.baseline
        return baseline.model_errors.gain(baseline.offsets, baseline.scene)

    @cached_property
    def _resting_root(self) -> Array:
        """Root of C + T, (cells + offsets, cells + offsets).

        This is the baseline's covariance and the drift, of each cell and of all in common.
        """
        covariance = self.baseline.covariance.copy()
        cells = self.measured.size
        common = self.baseline.model_errors.common_drift * log10(1 + self.seconds / 60)
        covariance[:cells, :cells] += self.drift_sd**2 * np.eye(cells) + common**2
        return np.asarray(cholesky(covariance, lower=True))

    def covariance(self, network: Network, cells: Array | float = 0.0) -> Array:
        """Return the covariance of the readings about those of a network, (cells, cells).

        The sum σ² + V Vᵀ + H C Hᵀ + J T Jᵀ with H = (J, E) has the noise, errors shared within the
        frame, the baseline's covariance C, and the drift T of cells.

        Parameters
        ----------
        network : Network
            Solved network, with the slope J.
        cells : array, shape (cells, cells), or 0
            Further covariance of ln r, added to T.
        """
        # H = (J, E); H (C + T) Hᵀ with T on the block of the cells
        slope = self.sensitivity(network)
        both = np.hstack([slope, self.offsets(network)])
        # the root is triangular, and a product with the own transpose symmetric: half of each
        spread = blas.dtrmm(1.0, self._resting_root.T, both.T).T
        shared = self.common(network.reading())
        total: Array = spread @ spread.T + shared @ shared.T
        if np.ndim(cells):
            total += slope @ cells @ slope.T
        return total + np.diag(self.sigma.ravel() ** 2)

    def whitening(self, change: Array | float = 0.0, cells: Array | float = 0.0) -> Whitening:
        """Return the errors about ln r/r0 = `change`, with a further covariance of ln r.

        `cells` is this covariance, (cells, cells).
        """
        return Whitening.of(self.covariance(self.baseline.network(change), cells))

    def cells(self, start: Array, prior: Array, mean: Array | float = 0.0) -> MostProbable:
        """Return the most probable ln r/r0 of all cells with the prior N(`mean`, `prior`).

        `prior` is a covariance, or the variances of independent cells. The search begins at
        `start`; it and `mean` have the shape (rows, columns).
        """

        def model(change: Array) -> tuple[Array, Array, Array]:
            network = self.baseline.network(change.reshape(self.measured.shape))
            slope = self.sensitivity(network)
            return self.deviation(network), slope, self.covariance(network)

        means = np.broadcast_to(mean, start.shape).ravel()
        return most_probable(model, start.ravel(), means, prior, MAX_STEP / 10)

    @cached_property
    def free(self) -> MostProbable:
        """Most probable ln r/r0 of independent cells with the prior N(0, 1).

        Any load may have changed them.
        """
        return self.cells(np.zeros(self.measured.shape), np.ones(self.measured.size))

    @property
    def free_map(self) -> Array:
        """The state of `free`, (rows, columns)."""
        return self.free.state.reshape(self.measured.shape)

    @cached_property
    def free_sd(self) -> Array:
        """The standard deviations of `free`, (rows, columns)."""
        return np.sqrt(np.diag(self.free.covariance)).reshape(self.measured.shape)

    @property
    def drift_sd(self) -> float:
        """Standard deviation of each cell's drift since the unloaded frames."""
        return self.baseline.model_errors.resting_sd(self.seconds)

    @cached_property
    def mean_sd(self) -> Array:
        """Standard deviation of `free` cells, averaged over their change, (rows, columns).

        Beside large pull-ups a pressed cell changes readings less, so its own standard deviation is
        that of a pressed cell. With sd(0) of cells at rest, the signed root of the likelihood ratio
        between a change x and rest is the integral of 1/sd, here |x| (1/sd(0) + 1/sd(x))/2.
        """
        rest = self.baseline.network()
        slope = self.sensitivity(rest)
        whitening = Whitening.of(slope @ slope.T + self.covariance(rest))
        # the posterior's diagonal with the prior I: 1 − diag Jᵀ (J Jᵀ + C)⁻¹ J
        variance = 1 - ((whitening @ slope) ** 2).sum(axis=0)
        at_rest = np.sqrt(np.maximum(variance, np.finfo(float).eps)).reshape(self.measured.shape)
        return np.asarray(2 / (1 / at_rest + 1 / self.free_sd))

    @cached_property
    def common_change(self) -> CommonChange:
        """The change that all cells share.

        In air that is a drift, which is equal in all of them. Under water it is a level, the
        pressure that most cells show, to which films respond differently. It has risen by no more
        than LEVEL_RATE allows, beyond which a load is on most of the cells.
        """
        cells = self.measured.size
        still = np.zeros(self.measured.shape)
        if not self.water.any():
            return CommonChange(np.ones(cells), np.zeros((cells, cells)), still)
        response = self.baseline.response
        at_rest = response.logarithm(self.water)
        pressures = response.pressure(at_rest + self.free_map / response.gains) - self.water
        level = float(np.median(pressures[self.panel.present]))
        change, _ = self.change(np.full(still.shape, level))
        most = LEVEL_RATE * (self.seconds + FOLLOWS_S)
        mean, _ = self.change(np.full(still.shape, np.clip(level, -most, most)))
        # a level, which depth makes unequal, or an equal drift: by the scatter that it leaves
        scatters = [
            np.median(np.abs(left - np.median(left)))
            for left in (self.free_map - mean, self.free_map)
        ]
        unit = change.ravel() / max(np.abs(np.median(change)), np.finfo(float).tiny)
        film, _ = self.baseline.film_parts(np.stack([change, still, still]))
        uneven = (UNEVENNESS * self.baseline.model_errors.response) ** 2 * film
        return CommonChange(unit, uneven, mean if scatters[0] < scatters[1] else still)

    @property
    def level_reading(self) -> Array:
        """Change of ln f, (cells,), by the level of the water."""
        baseline = self.baseline
        at_level = baseline.network(self.common_change.mean).reading()
        return np.log(at_level / baseline.network().reading()).ravel()

    def without(self, dropped: Numbers) -> "Observation":
        """Return the observation without the readings of these numbers.

        Their σ is so large that they do not count.
        """
        sigma = self.sigma.copy()
        sigma.flat[dropped] *= DROPPED_FACTOR
        return replace(self, sigma=sigma)
