"""Fit of one candidate, or of a field of any form, to one frame.

The evidence is Laplace's approximation. In a field each cell has one of four states, from quiet to
strongly changed, with a Potts prior on neighbours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky

from lampest.apps.recognition.candidates import FIELD, under
from lampest.apps.recognition.observation import MostProbable, Observation, Whitening, outliers
from lampest.files.levels import MAX_MEAN_SQUARE, SIGNIFICANT
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array, Panel
from lampest.recording.shapes.disc import Disc
from lampest.recording.shapes.shape import Candidate, Prior

# Search with one linearised circuit; a change of ln P below `settled` changes nothing that is
# reported.
SEARCH = LevenbergMarquardt(evaluations=30, settled=0.3)
# Linearisations of the circuit in a fit; also fits with errors about the previous one.
MAX_ROUNDS = 4
# Difference of ln P to the best candidate beyond which candidates do not count.
MAX_LOG_RATIO = 20.0


@dataclass(frozen=True, eq=False)
class Fit:
    """The most probable parameters φ of a candidate.

    Attributes
    ----------
    candidate : Candidate
    parameters, covariance : array, shapes (parameters,) and (parameters, parameters)
        φ and its posterior covariance.
    change : array, shape (rows, columns)
        ln r/r0.
    residual : array, shape (cells,)
        Residual of the readings, in their unit.
    chi2 : float
        χ² of the readings.
    cost : float
        ½ (χ² + Σ ((φ − mean)/sd)²).
    volume : float
        ½ ln det of the errors' covariance.
    evidence : float
        ln of the frame's probability under the candidate, up to a constant common to all
        candidates.
    scatter : float
        Relative deviation of the film.
    of_curves : array, shape (parameters, parameters), or None
        Part of `covariance` by alternative curves of the film; None for none.
    """

    candidate: Candidate
    parameters: Array
    covariance: Array
    change: Array
    residual: Array
    chi2: float
    cost: float
    volume: float
    evidence: float
    scatter: float = 0.0
    of_curves: Array | None = None

    @property
    def score(self) -> float:
        """−ln posterior at its maximum, up to a constant.

        Scores compare candidates with different error covariances.
        """
        return self.cost + self.volume

    @property
    def loads(self) -> list[tuple[Candidate, Array]]:
        """Every single load of the candidate with its own φ."""
        return self.candidate.loads(self.parameters)

    @property
    def discs(self) -> list[Disc]:
        """Discs of all round loads."""
        discs = (part.disc(parameters) for part, parameters in self.loads)
        return [disc for disc in discs if disc is not None]


class CellLikelihood(NamedTuple):
    """−ln P of a frame, ½ |e − A x|² + constant in x = ln r/r0, by the circuit linearised at x₀.

    Attributes
    ----------
    whitening : Whitening
        Errors of the readings.
    slope, error : array, shapes (readings, cells) and (readings,)
        A, and e = e₀ + A x₀ with the residual e₀ at x₀, whitened.
    residual : array, shape (readings,)
        Residual of the readings at x₀, in their unit.
    """

    whitening: Whitening
    slope: Array
    error: Array
    residual: Array

    @classmethod
    def about(cls, frame: Observation, whitening: Whitening, change: Array) -> "CellLikelihood":
        """Return the likelihood of a frame linearised about x₀ = `change`, (rows, columns)."""
        network = frame.baseline.network(change)
        residual = frame.deviation(network)
        both = whitening @ np.column_stack([frame.sensitivity(network), residual])
        return cls(whitening, both[:, :-1], both[:, -1] + both[:, :-1] @ change.ravel(), residual)


class Effect(NamedTuple):
    """Effect of a candidate with the parameters φ on the cells.

    Attributes
    ----------
    parameters : array, shape (parameters,)
        φ.
    change : array, shape (rows, columns)
        ln r/r0.
    slopes : array, shape (parameters, cells)
        Its derivatives by φ.
    """

    parameters: Array
    change: Array
    slopes: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class FitPoint(SumOfSquares):
    """−ln P of a frame about φ.

    Attributes
    ----------
    effect : Effect
        The effect of φ on the cells.
    """

    effect: Effect


@dataclass(frozen=True, eq=False)
class Fitting:
    """The problem of fitting one candidate to one frame."""

    candidate: Candidate
    frame: Observation
    patch_mm: float

    def at(self, effect: Effect, likelihood: CellLikelihood) -> FitPoint:
        """Return −ln P about φ.

        The squares are those of the readings' errors e − A x(φ) and of (φ − mean)/sd.
        """
        mean, sd, _ = self._prior
        touched = np.flatnonzero(effect.change)  # x is 0 outside the load
        by_cell = likelihood.slope[:, touched]
        errors = likelihood.error - by_cell @ effect.change.ravel()[touched]
        from_mean = (effect.parameters - mean) / sd
        return FitPoint(
            residual=np.concatenate([errors, from_mean]),
            jacobian=np.vstack([-by_cell @ effect.slopes[:, touched].T, np.diag(1 / sd)]),
            effect=effect,
        )

    def effect(self, parameters: Array) -> Effect:
        """Return the effect of the candidate with φ on the cells."""
        pressure, by_parameter = self.pressure(parameters)
        change, response = self.frame.change(pressure)
        slopes = by_parameter.reshape(len(parameters), response.size) * response.ravel()
        return Effect(parameters, change, slopes)

    def about(self, effect: Effect, whitening: Whitening) -> CellLikelihood:
        """Return the likelihood with the circuit linearised at φ."""
        return CellLikelihood.about(self.frame, whitening, effect.change)

    def descended(
        self,
        start: Effect,
        likelihood: CellLikelihood,
        steps: int = SEARCH.evaluations,
        most: float = np.inf,
        held: int | None = None,
    ) -> FitPoint:
        """Return −ln P about the most probable φ that the Levenberg-Marquardt method reaches.

        The circuit is linearised once.

        Parameters
        ----------
        start : Effect
        likelihood : CellLikelihood
        steps : int
            Most evaluations.
        most : float
            Cost above which the search ends early.
        held : int, optional
            Number of a parameter that is fixed.
        """
        mean, sd, longest = self._prior
        low = mean - SIGNIFICANT * sd
        high = mean + SIGNIFICANT * sd
        if held is not None:
            low[held] = high[held] = start.parameters[held]

        def model(parameters: Array) -> FitPoint:
            begins = np.array_equal(parameters, start.parameters)
            return self.at(start if begins else self.effect(parameters), likelihood)

        loop = replace(SEARCH, evaluations=steps, longest=longest)
        return loop.minimum(
            model,
            start.parameters,
            (low, high),
            lambda point, count: count > 4 and point.cost > most,
        )[1]

    def best(
        self, start: Effect, whitening: Whitening, most: float = np.inf, held: int | None = None
    ) -> Fit:
        """Return the fit at the most probable φ.

        The circuit is linearised again at the end of each search, until the exact cost agrees with
        the linearised one. The result is never worse than the start. `most` and `held` are those of
        `descended`.
        """
        position = start
        likelihood = self.about(start, whitening)
        fits = [self.fit_at(start, likelihood)]
        for _ in range(MAX_ROUNDS):
            point = self.descended(position, likelihood, most=most, held=held)
            position = point.effect
            likelihood = self.about(position, whitening)
            fits.append(self.fit_at(position, likelihood))
            exact = fits[-1].cost
            linear = point.cost
            if abs(exact - linear) < SEARCH.settled or min(exact, linear) > most:
                break
        return min(fits, key=lambda fit: fit.cost)

    def reachable(self, effect: Effect, likelihood: CellLikelihood) -> float:
        """Return an evidence that no fit that begins at φ is expected to exceed.

        It is the evidence at φ and twice the gain ½ gᵀ H⁻¹ g of a Gauss-Newton step, with the
        gradient g, which would be the whole gain if the cost were quadratic. Where φ does not
        explain the readings, or the gain is large, φ may be in another valley than the best fit.
        The result is then infinite.
        """
        point = self.at(effect, likelihood)
        gain = float(point.gradient @ np.linalg.solve(point.normal, point.gradient)) / 2
        if gain > MAX_LOG_RATIO or 2 * point.cost > self.frame.measured.size:
            return np.inf
        return self.fit_at(effect, likelihood).evidence + 2 * gain + SEARCH.settled

    def fit_at(self, effect: Effect, likelihood: CellLikelihood) -> Fit:
        """Return the fit at given φ with its evidence.

        The likelihood must have been linearised there or nearby.
        """
        squares = self.at(effect, likelihood)
        parameters = effect.parameters
        whitening = likelihood.whitening
        sd = self._prior[1]
        covariance, width = inverse_beside_prior(squares.normal, sd)
        covariance += np.diag(self.candidate.blind(parameters) ** 2)
        errors = whitening @ likelihood.residual
        return Fit(
            candidate=self.candidate,
            parameters=parameters,
            covariance=covariance,
            change=effect.change,
            residual=likelihood.residual,
            chi2=float(errors @ errors),
            cost=squares.cost,
            volume=whitening.volume,
            # Laplace: ln P(R) = −cost − ½ ln det (H sd sdᵀ) − ½ ln det C + constant, with the
            # Gauss-Newton matrix H
            evidence=-width - squares.cost - whitening.volume,
            scatter=whitening.scatter,
        )

    @cached_property
    def _priors(self) -> Mapping[str, Prior]:
        return self.candidate.priors(self.frame.panel)

    @cached_property
    def centred(self) -> NDArray[np.bool_]:
        """Whether each of φ is a coordinate of a centre, boolean (parameters,)."""
        return np.array([name.split(".")[-1] in ("x", "y") for name in self._priors], dtype=bool)

    @cached_property
    def _prior(self) -> Array:
        """Mean, standard deviation and longest step of φ, (3, parameters)."""
        return np.array([prior[:3] for prior in self._priors.values()]).reshape(-1, 3).T

    def pressure(self, parameters: Array, larger: float = 1.0) -> tuple[Array, Array]:
        """Return the candidate's pressure on patches enlarged by a factor.

        Returns
        -------
        pressure : array, shape (rows, columns)
            In kPa.
        slopes : array, shape (parameters, rows, columns)
            Derivatives by φ.
        """
        return self.candidate.pressure(self.frame.panel, self.patch_mm * larger, parameters)

    def explained(self, fit: Fit) -> Array:
        """Return the explained change with its sensitivities, (3, rows, columns).

        The order is that of `Baseline.film_parts`. Sensitivities are secants, because tangents jump
        at the response's corners.
        """
        if not self.centred.any():
            slope = np.hypot(*np.gradient(fit.change, self.frame.panel.pitch_mm))
            return np.stack([fit.change, slope, np.zeros_like(slope)])
        pressure, by_parameter = self.pressure(fit.parameters)
        # |∇p| (kPa/mm): the change of pressure by a shift of 1 mm across an edge
        shift = np.sqrt((by_parameter[self.centred] ** 2).sum(axis=0))
        sizes = (self.pressure(fit.parameters, by)[0] for by in (0.9, 1.1))
        upper, lower, small, large = (
            self.frame.change(end)[0] for end in (pressure + shift, pressure - shift, *sizes)
        )
        return np.stack([fit.change, np.abs(upper - lower) / 2, (large - small) / (1.1 - 0.9)])

    def errors(self, fit: Fit, scatter: float) -> Whitening:
        """Return the errors about the change that a fit explains.

        `scatter` is the relative deviation of the film.
        """
        return self.errors_by_scatter(fit, (scatter,))[0]

    def errors_by_scatter(self, fit: Fit, scatters: Sequence[float]) -> list[Whitening]:
        """Return the errors about the change that a fit explains, for each deviation of the film.

        With the parts s² U + S of the film's covariance, that of the readings is C + s² J U Jᵀ. C
        and J U Jᵀ are computed once.
        """
        network = self.frame.baseline.network(fit.change)
        uneven, fixed = self._film_parts(fit)
        steady = self.frame.covariance(network, fixed)
        slope = self.frame.sensitivity(network)
        by_film = slope @ uneven @ slope.T
        return [
            Whitening(cholesky(steady + scatter**2 * by_film, lower=True), scatter)
            for scatter in scatters
        ]

    def film(self, fit: Fit, scatter: float) -> Array:
        """Return the covariance of ln r about the change that a fit explains, (cells, cells).

        Its causes are the deviations of the film, and the loose cells of the frame that the fit's
        loads do not cover.
        """
        uneven, fixed = self._film_parts(fit)
        return scatter**2 * uneven + fixed

    def _film_parts(self, fit: Fit) -> tuple[Array, Array]:
        """Return the parts U and S of the covariance s² U + S in `film`, (cells, cells) each."""
        covered = np.any([under(self.frame.panel, disc) for disc in fit.discs], axis=0)
        loose = np.where(covered, 0.0, self.frame.loose).ravel()
        uneven, shared = self.frame.baseline.film_parts(self.explained(fit))
        return uneven, shared + np.diag(loose**2)


def inverse_beside_prior(normal: Array, sd: Array) -> tuple[Array, float]:
    """Return the inverse of a Gauss-Newton matrix H, which contains the prior's precision 1/sd².

    The eigenvalues of sd H sd are at least 1, also where the readings determine φ beyond double
    precision.

    Returns
    -------
    inverse : array, shape (parameters, parameters)
        H⁻¹.
    width : float
        ½ ln det (H sd sdᵀ).
    """
    sizes, axes = np.linalg.eigh(normal * np.outer(sd, sd))
    sizes = np.maximum(sizes, 1.0)
    return (axes / sizes) @ axes.T * np.outer(sd, sd), float(np.log(sizes).sum()) / 2


# Assumed standard deviations of ln r/r0 in the four states: no load, half a kPa, a few kPa, tens of
# kPa.
SD = np.array([0.005, 0.08, 0.4, 1.6])


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """Return the most probable field with its evidence.

    x = ln r/r0 is Gaussian with the σ of each cell's state, correlated between neighbours. The
    evidence integrates over x about its maximum. The states are those of a map of the cells, or of
    a first field, and have a Potts prior.

    Returns
    -------
    fit : Fit
    calm : Observation
        The frame without outliers.
    """
    fit, most_probable = _of_two_maps(frame)
    if fit.chi2 < MAX_MEAN_SQUARE * frame.measured.size:
        return fit, frame
    calm = frame.without(outliers(most_probable.whitening, most_probable.apart))
    return max((fit, frame), (_of_two_maps(calm)[0], calm), key=lambda pair: pair[0].evidence)


def _of_two_maps(frame: Observation) -> tuple[Fit, MostProbable]:
    first = _with_states(frame, frame.map)
    return max(first, _with_states(frame, first[0].change), key=lambda pair: pair[0].evidence)


def _with_states(frame: Observation, start: Array) -> tuple[Fit, MostProbable]:
    """Return the most probable field with the states of ln r/r0 = `start` (rows, columns).

    `start` is also the start.
    """
    of_cells = states(frame.panel, start)
    most_probable = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change = most_probable.state.reshape(start.shape)
    whitening = most_probable.whitening
    errors = whitening @ most_probable.apart
    residual = frame.residual(change)
    misfit = Whitening.about(frame, change) @ residual
    cost = float(errors @ errors) / 2
    fit = Fit(
        candidate=FIELD,
        parameters=np.zeros(0),
        covariance=np.zeros((0, 0)),
        change=change,
        residual=residual,
        chi2=float(misfit @ misfit),
        cost=cost,
        volume=whitening.volume,
        # ln P(R | states) = −½ eᵀ (A P Aᵀ + C)⁻¹ e − ½ ln det (A P Aᵀ + C), and ln P(states) of
        # the Potts field
        evidence=-cost - whitening.volume - potts_cost(frame.panel, of_cells),
    )
    return fit, most_probable


def prior(frame: Observation, sd: Array) -> Array:
    """Return the prior covariance of ln r/r0 of cells with these standard deviations.

    Neighbours are correlated.
    """
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.asarray(
        np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near)
    )


def states(panel: Panel, change: Array) -> NDArray[np.intp]:
    """Return the state of each cell, 0 to 3 for quiet to strongly changed.

    The changes of the cell and of its neighbours determine the state.
    """
    square = change.ravel() ** 2
    first, second, _ = panel.neighbours
    cell = np.concatenate([first, second])
    neighbour = np.concatenate([second, first])
    near = np.bincount(cell, square[neighbour], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    # a cell at the border stands for its missing neighbours
    near += np.maximum(4 - sides, 0) * square
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * near), limits)).reshape(change.shape)


def potts_cost(panel: Panel, of_cells: NDArray[np.intp]) -> float:
    """Return −ln P of the states in the Potts field.

    Each pair of unlike neighbours costs 1 (an assumption); a constant normalises the probability.
    """
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
