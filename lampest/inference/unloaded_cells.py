"""Errors of the readings by the unloaded panel: its cells follow a trend, to a scatter.

Films differ from cell to cell, and their thickness changes slowly over a panel. The unloaded cells
are log r ~ N(T β, s²) with the polynomials T of the place up to the second degree. Their level is
free; the other coefficients are β ~ N(0, n w²) of n cells, with an amplitude w that is open as s
is: with free ones a circuit whose readings hardly depend on its cells would be the likelier one.
Beside errors z ~ N(0, 1) with columns U their readings have the likelihood of the errors' sizes,
and the posterior of z.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from lampest.cost.problem import Data
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import CELL_PRECISION, FIT, CellsFit, data_of_cells
from lampest.inference.shared_changes import LINEAR_LIMIT
from lampest.panel.effects import (
    READINGS,
    Possible,
    error_columns,
    own_errors,
    recorded_share,
    sized_effects,
)
from lampest.panel.least_squares import SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.tolerances import channel_errors
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.posterior.gaussian import forms_over_scales, lower_root
from lampest.posterior.linear import inverse_and_volume, whitened
from lampest.recording.readings import Readings

READING_ERRORS = np.append(0.0, np.geomspace(2e-5, 0.2, 40))  # tried sizes e
# Errors beside which the readings are linearised; others share the point of the nearest one.
LINEARISED_AT = np.append(0.0, READING_ERRORS[1::4])
MIN_OVER_NOISE = 0.3  # of an error beside which they are linearised, other than none
MAX_ROUNDS = 3  # of linearisations beside one error, each with the scatter that is likeliest then
SAME_SCATTER = 2  # steps between scatters that count as one
# Of a trend's polynomials over each other: with less, a narrow panel does not tell them apart.
MIN_OTHER_SHARE = 1e-9
# Tried scatters s of unloaded cells, and the logarithms of their prior probabilities. Steps are a
# tenth, because a hundred cells show their scatter to some percent: where crosstalk is small an
# error e would fill a gap between two of them.
SCATTERS = np.geomspace(0.01, 2.0, 56)
LOG_PRIOR = -np.square(np.log(SCATTERS / ASSUMED.scatter) / np.log(ASSUMED.scatter_factor)) / 2
# Tried amplitudes w of a trend, equally probable: root mean squares of ln r over the panel.
AMPLITUDES = np.array([0.001, 0.01, 0.1, 1.0])


def unloaded_costs(
    scene: Scene,
    resting: Readings,
    fit: CellsFit | None,
    tried: Array,
    channels_ohm: Sequence[float] | Array = (0.0,),
) -> Array:
    """Return −2 ln likelihood of errors of the readings, up to a constant, (spreads, errors).

    The constant is the same for all errors and all spreads of the channels. The likelihood is that
    of `costs_by_scatter`, averaged over the prior of SCATTERS.

    Parameters
    ----------
    scene, resting, fit, tried, channels_ohm
        As those of `costs_by_scatter`.

    Raises
    ------
    Errors of `BROKEN`.
    """
    each = costs_by_scatter(scene, resting, fit, tried, channels_ohm)
    # −2 ln Σ_s p(y | e, s) p(s)
    return np.asarray(-2 * np.logaddexp.reduce(LOG_PRIOR - each / 2, axis=-1))


def film_scatter(
    scene: Scene,
    resting: Readings,
    fit: CellsFit | None,
    error: float,
    channel_ohm: float = 0.0,
) -> float:
    """Return √E[s²] of the scatter s of unloaded cells, given the errors of their readings.

    Parameters
    ----------
    scene, resting, fit
        As those of `costs_by_scatter`.
    error : float
        Standard deviation e of each reading's own error.
    channel_ohm : float
        Standard deviation of the resistance of each line's channel.

    Raises
    ------
    Errors of `BROKEN`.
    """
    costs = costs_by_scatter(scene, resting, fit, np.array([error]), (channel_ohm,))[0, 0]
    weight = np.exp(LOG_PRIOR - (costs - costs.min()) / 2)
    return float(np.sqrt(np.sum(weight * SCATTERS**2) / np.sum(weight)))


def at_rest(
    possible: Possible,
    known: tuple[Array, Array] | None,
    scene: Scene,
    resting: Readings,
    fit: CellsFit | None,
) -> tuple[tuple[str, ...], Array, Array]:
    """Return the posterior of the errors by the unloaded panel, given what changes tell of them.

    With the prior z ~ N(m, R Rᵀ), A = U R, V = σ² + A Aᵀ + s² J Jᵀ, B = J T and
    P = V⁻¹ − V⁻¹B (BᵀV⁻¹B)⁻¹ BᵀV⁻¹,

        E[z] = m + R Aᵀ P (t − U m),   cov z = R (1 − Aᵀ P A) Rᵀ.

    Columns U are those about their mean: cells of the unloaded panel do not tell a resistance in
    series, because larger cells differ less. Raises errors of `BROKEN`.

    Parameters
    ----------
    possible : Possible
        Sizes and settings of the errors, and the scatter s of the films.
    known : tuple of array, or None
        Mean and covariance of z of the errors of `possible.settings`; None: those of the prior.
    scene : Scene
    resting : Readings
        Mean of the unloaded frames, (rows, columns).
    fit : CellsFit or None
        Fit of the unloaded panel, at whose cells the search begins.

    Returns
    -------
    settings : tuple of str
        Field of `Systematic` of each column.
    mean : array, shape (columns,)
    covariance : array, shape (columns, columns)
    """
    data = data_of_cells(scene, resting)
    sizes = possible.sizes
    near = np.log(data.uniform_start[0] if fit is None else fit.cells)
    own = own_errors(resting.value, scene, sizes.size(READINGS))
    cells, jacobian, target = _linearised(data, resting, own, possible.film_scatter, near)
    network = data.network(0, np.exp(cells))
    settings, errors = _centred_errors(scene, resting, network, sizes)
    mean, root = _prior(settings, possible, known)
    columns = errors @ root
    variance = np.diag(resting.known_sigma[resting.plain] ** 2) + columns @ columns.T
    whitening = np.linalg.cholesky(variance + possible.film_scatter**2 * jacobian @ jacobian.T)
    trend = jacobian @ _trend(data)
    given = np.column_stack([trend, columns, target - errors @ mean])
    of_trend, others = np.split(np.linalg.solve(whitening, given), [trend.shape[1]], axis=1)
    basis, _ = np.linalg.qr(of_trend)
    others = others - basis @ (basis.T @ others)
    shown = others[:, :-1].T
    mean = mean + root @ (shown @ others[:, -1])
    return settings, mean, root @ (np.eye(len(root)) - shown @ shown.T) @ root.T


def _centred_errors(
    scene: Scene, resting: Readings, network: Network, sizes: Systematic
) -> tuple[tuple[str, ...], Array]:
    """Return the setting of each error, and U of the plain readings, (readings, errors)."""
    settings = list[str]()
    columns = list[Array]()
    for error in sized_effects(sizes):
        of_error = error_columns((error,), network, resting.value, scene, sizes)[:, resting.plain]
        settings += len(of_error) * [error.setting]
        columns += [*(of_error - of_error.mean(axis=0))]
    return tuple(settings), np.array(columns).T


def _prior(
    settings: tuple[str, ...], possible: Possible, known: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """Return mean and root of the covariance of errors before the unloaded panel, as `at_rest`."""
    mean = np.zeros(len(settings))
    root = np.eye(len(settings))
    if known is not None:
        of_settings = [np.equal(settings, setting).nonzero()[0] for setting in possible.settings]
        estimated = np.concatenate(of_settings)
        mean[estimated], covariance = known
        root[np.ix_(estimated, estimated)] = lower_root(covariance)
    return mean, root


def costs_by_scatter(
    scene: Scene,
    resting: Readings,
    fit: CellsFit | None,
    tried: Array,
    channels_ohm: Sequence[float] | Array = (0.0,),
) -> Array:
    """Return −2 ln likelihood of errors and SCATTERS, (spreads, errors, scatters).

    The readings are linearised at the most probable log cells u beside the nearest of a few errors,
    and beside the scatter that is likeliest then; all spreads share it. Beside another error the
    most probable cells are others where cells differ much, and linear theory about them makes cells
    explain more readings than they can, or fewer. Where the cells are not alike, e is overestimated
    rather than underestimated. Raises errors of `BROKEN`.

    Parameters
    ----------
    scene : Scene
    resting : Readings
        Mean of the unloaded frames, (rows, columns).
    fit : CellsFit or None
        Fit of the unloaded panel: no cells have a smaller χ². None: without this limit.
    tried : array, shape (errors,)
        Values of e.
    channels_ohm : array, shape (spreads,)
        Standard deviations c of the resistance of each line's channel. A spread that moves a cell
        beyond LINEAR_LIMIT counts as the largest that does not.
    """
    data = data_of_cells(scene, resting)
    trend = _trend(data)
    share = np.abs(recorded_share(resting.value, scene))
    sigma = resting.known_sigma[resting.plain]
    least = 0.0 if fit is None else fit.chi_square
    noises = _noise_with_channels(scene, resting, fit, channels_ohm)
    points = _points(tried, share[resting.plain] / sigma)

    def costs(error: float, noise: Array, jacobian: Array, target: Array) -> Array:
        covariance = noise + np.diag((error * share[resting.plain]) ** 2)
        return _linear_costs(covariance, sigma, least, jacobian, target, trend)

    near = np.log(data.uniform_start[0] if fit is None else fit.cells)
    likeliest = int(np.abs(np.log(SCATTERS / max(float(near.std()), SCATTERS[0]))).argmin())
    linearised = []
    # The most probable cells beside an error are the start of those beside the next larger one.
    for error in points:
        for _ in range(MAX_ROUNDS):
            scatter = likeliest
            near, *linear = _linearised(data, resting, error * share, SCATTERS[scatter], near)
            of_scatters = costs(error, noises[len(noises) // 2], *linear)
            likeliest = int(np.argmin(of_scatters - 2 * LOG_PRIOR))
            if abs(likeliest - scatter) <= SAME_SCATTER:
                break
        linearised.append(linear)
    if len(noises) == len(tried) == 1:
        return of_scatters[None, None]
    nearest = np.abs(np.subtract.outer(_place(tried), _place(points))).argmin(axis=1)
    errors = [*zip(tried, nearest, strict=True)]
    return np.array(
        [[costs(error, noise, *linearised[place]) for error, place in errors] for noise in noises]
    )


def _points(tried: Array, over_noise: Array) -> Array:
    """Return the errors beside which the readings are linearised; e = 1 has sizes over the noise.

    Errors below the noise leave the most probable cells where they are without any.
    """
    if len(tried) == 1:
        return tried
    sizes = LINEARISED_AT * np.median(over_noise)
    return np.asarray(LINEARISED_AT[(sizes == 0) | (sizes > MIN_OVER_NOISE)])


def _place(errors: Array) -> Array:
    """Return ln e of errors; none is one step below the smallest tried one."""
    return np.asarray(np.log(np.maximum(errors, READING_ERRORS[1] ** 2 / READING_ERRORS[2])))


def _linearised(
    data: Data, resting: Readings, own: Array, scatter: float, near: Array
) -> tuple[Array, Array, Array]:
    """Return the most probable log cells u beside errors `own`, and J and t of the plain readings.

    The shapes are (rows, columns), (readings, cells) and (readings,), with t = y − f(u) + J u.
    """
    deviation = np.where(resting.plain, np.hypot(resting.known_sigma, own), np.inf)
    cells, given, jacobian = most_probable_cells(
        data, resting.value, deviation, _unlike(data, scatter), near
    )
    target = (resting.value - given).ravel() + jacobian @ cells.ravel()
    plain = resting.plain.ravel()
    return cells, jacobian[plain], target[plain]


def _noise_with_channels(
    scene: Scene, resting: Readings, fit: CellsFit | None, channels_ohm: Sequence[float] | Array
) -> list[Array]:
    """Return σ² + c² C Cᵀ of the plain readings for spreads c of channels; C are those of one ohm.

    C are the changes about their mean, which is a resistance in series. With a mean, negative
    channels beside larger cells, which differ less, would explain an uneven panel. Without a fit
    there are none.
    """
    noise = np.diag(resting.known_sigma[resting.plain] ** 2)
    if fit is None or not np.any(channels_ohm):
        return [noise] * len(channels_ohm)
    cells = fit.network.cell_resistance
    columns = channel_errors(scene.circuit, cells, resting.value, scene, 1.0)
    columns = (columns - columns.mean(axis=0))[:, resting.plain].T
    # Beside cells of little resistance large ones are moved most.
    moved = np.linalg.norm(fit.gain[:, resting.plain.ravel()] @ columns, axis=1).max()
    most = LINEAR_LIMIT / max(moved, np.finfo(float).tiny)
    return [noise + min(ohm, most) ** 2 * columns @ columns.T for ohm in channels_ohm]


def _linear_costs(
    covariance: Array, sigma: Array, least: float, jacobian: Array, target: Array, trend: Array
) -> Array:
    """Return −2 ln likelihood of linearised readings y for SCATTERS, (scatters,).

    Let A = L⁻¹ J, a = L⁻¹ t and B = A T, with the lower root L of the readings' covariance Σ:

        −2 log p(y | s, w) = aᵀV⁻¹a − aᵀV⁻¹B P⁻¹ BᵀV⁻¹a + log |V| + log |P| − log |W| + log |Σ|,
        V = 1 + s² A Aᵀ,   P = BᵀV⁻¹B + W,

    with the precision W of β, averaged over the amplitudes w. No likelihood exceeds that of the
    best fit, so that −2 log p is at least χ²/max(τ/σ)² + log |Σ| with τ² the diagonal of Σ.

    Parameters
    ----------
    covariance : array, shape (readings, readings)
        Σ: noise σ², errors (e y')² with the derivative y' of a reading by the logarithm of its
        recorded value, and channels.
    sigma : array, shape (readings,)
    least : float
        χ² of the best fit.
    jacobian, target, trend : arrays, shapes (readings, cells), (readings,) and (cells, k)
        J, t and T.
    """
    root = np.linalg.cholesky(covariance)
    widening = np.max(np.linalg.norm(root, axis=1) / sigma)
    white = whitened(root, np.column_stack([target, jacobian]))
    scaled = white[:, 1:]
    both = np.column_stack([white[:, 0], scaled @ trend])
    forms, volumes = forms_over_scales(scaled @ scaled.T, both, SCATTERS)
    known = np.zeros((len(AMPLITUDES), trend.shape[1]))
    known[:, 1:] = 1 / (AMPLITUDES[:, None] ** 2 * np.count_nonzero(trend[:, 0]))
    # BᵀV⁻¹B + W is the precision of β, which is integrated out.
    precision = forms[:, None, 1:, 1:] + known[:, :, None] * np.eye(trend.shape[1])
    explained = np.linalg.solve(precision, forms[:, None, 1:, :1])[..., 0]
    squares = forms[:, None, 0, 0] - np.sum(forms[:, None, 0, 1:] * explained, axis=-1)
    costs = squares + np.linalg.slogdet(precision)[1] - np.log(known[:, 1:]).sum(axis=1)
    linear = volumes - 2 * np.logaddexp.reduce(-costs / 2, axis=1)
    logarithms = 2 * np.log(np.diag(root)).sum()
    return np.asarray(np.maximum(linear, least / widening**2) + logarithms)


def _trend(data: Data) -> Array:
    """Return polynomials of the place up to the second degree, orthonormal over the panel's cells.

    The shape is (cells, k); the first is the level, and places without a cell are 0. A panel of one
    or two lines tells fewer of them apart.
    """
    free = data.lower[0] < data.upper[0]
    down, across = (
        place / max(length - 1, 1) - 0.5
        for place, length in zip(np.indices(free.shape), free.shape, strict=True)
    )
    powers = (free, down, across, down**2, down * across, across**2)
    polynomials = np.stack([np.where(free, power, 0.0).ravel() for power in powers], axis=1)
    basis, triangle = np.linalg.qr(polynomials)
    sizes = np.abs(np.diag(triangle))
    return basis[:, sizes > MIN_OTHER_SHARE * sizes[0]]


def _unlike(data: Data, scatter: float) -> tuple[Array, Array]:
    """Return the prior N(T β, s²) of log cells, whose trend is free, for `most_probable_cells`."""
    trend = _trend(data)
    free = data.lower[0] < data.upper[0]
    precision = (np.eye(free.size) - trend @ trend.T) / scatter**2
    return precision, np.where(free, 0.0, data.log_bounds[0][0])


@dataclass(frozen=True, eq=False)
class AtRest:
    """The unloaded log cells, given their readings and the film, N(m, P).

    Attributes
    ----------
    cells : array, shape (rows, columns)
        m.
    covariance : array, shape (cells, cells)
        P.
    jacobian : array, shape (readings, cells)
        J of the plain readings, over their σ²; 0 for the others.
    """

    cells: Array
    covariance: Array
    jacobian: Array

    @classmethod
    def of(cls, fit: CellsFit) -> Self:
        """Return the cells of a fit's readings.

        The film's scatter is its root mean square, see `film_scatter`.

        Raises
        ------
        Errors of `BROKEN`.
        """
        scene, resting = fit.scene, fit.measured
        data = data_of_cells(scene, resting)
        deviation = np.where(resting.plain, resting.known_sigma, np.inf)
        prior = _unlike(data, film_scatter(scene, fit.readings, fit, 0.0))
        cells, _, jacobian = most_probable_cells(
            data, resting.value, deviation, prior, np.log(fit.cells), fit.with_effects
        )
        scaled = jacobian / deviation.reshape(-1, 1)
        precision = scaled.T @ scaled + prior[0] + CELL_PRECISION * np.eye(len(scaled))
        weighted = jacobian / deviation.reshape(-1, 1) ** 2
        return cls(cells, inverse_and_volume(precision)[0], weighted)

    def response(self, errors: Array) -> Array:
        """Return the change of m (cells, n) by errors of the readings, (readings, n)."""
        return self.covariance @ (self.jacobian.T @ errors)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Readings linearised about log cells, with a prior of these; see `least_squares.Linearised`.

    Attributes
    ----------
    reading : array, shape (rows, columns)
    sensitivity : array, shape (readings, cells)
    misfit : SumOfSquares
        That of the readings, over their noise.
    away : array, shape (cells,)
        Log cells less their prior mean.
    precision : array, shape (cells, cells)
        Of the prior.
    """

    reading: Array
    sensitivity: Array
    misfit: SumOfSquares
    away: Array
    precision: Array

    @cached_property
    def cost(self) -> float:
        return self.misfit.cost + float(self.away @ self.precision @ self.away) / 2

    @cached_property
    def gradient(self) -> Array:
        return self.misfit.gradient + self.precision @ self.away

    @cached_property
    def normal(self) -> Array:
        return self.misfit.normal + self.precision


def most_probable_cells(
    data: Data,
    value: Array,
    deviation: Array,
    prior: tuple[Array, Array],
    start: Array,
    effects: Callable[[Network], tuple[Network, Array | float]] = lambda network: (network, 0.0),
) -> tuple[Array, Array, Array]:
    """Return the most probable log cells u, their readings f(u), and the Jacobian J there.

    The minimum is that of Σ ((f(u) − y)/τ)² + (u − m)ᵀ Λ (u − m).

    Parameters
    ----------
    data : Data
    value, deviation : array, shape (rows, columns)
        y and τ; τ is infinite where there is no reading.
    prior : tuple of array
        Λ, (cells, cells), and m, (rows, columns).
    start : array, shape (rows, columns)
        Log cells.
    effects : callable
        Function from a network to the one with effects, and what they add to its readings.

    Returns
    -------
    array, shape (rows, columns)
    array, shape (rows, columns)
    array, shape (readings, cells)
    """
    precision, mean = prior
    # Cells that the panel does not have stay.
    free = data.lower[0] < data.upper[0]
    lower, upper = (
        np.where(free, far, bound[0]).ravel()
        for far, bound in zip((-np.inf, np.inf), data.log_bounds, strict=True)
    )

    def model(cells: Array) -> _Linearised:
        network, added = effects(data.network(0, np.exp(cells).reshape(value.shape)))
        reading, sensitivity = network.reading() + added, network.sensitivity() * free.ravel()
        missed = ((reading - value) / deviation).ravel()
        misfit = SumOfSquares(missed, sensitivity / deviation.reshape(-1, 1))
        return _Linearised(reading, sensitivity, misfit, cells - mean.ravel(), precision)

    begin = np.where(free, start, data.log_bounds[0][0]).ravel()
    position, at = replace(FIT, evaluations=25, share=0.0).minimum(model, begin, (lower, upper))
    return position.reshape(value.shape), at.reading, at.sensitivity
