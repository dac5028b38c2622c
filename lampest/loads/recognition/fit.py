"""Fit of one candidate, or of a field of any form, to one frame, and its evidence by Laplace's approximation.

In a field each cell has one of four states, from quiet to strongly changed, with a Potts prior on neighbours.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from lampest.files.levels import MAX_MEAN_SQUARE, SIGNIFICANT
from lampest.loads.recognition.candidates import FIELD
from lampest.loads.recognition.observation import (
    Explained,
    MostProbable,
    Observation,
    Whitening,
    outliers,
)
from lampest.loads.shapes.disc import POINTS
from lampest.loads.shapes.shape import Candidate
from lampest.panel.least_squares import LevenbergMarquardt
from lampest.panel.panel import Array, Panel

# Search with one linearised circuit; a change of ln P below `settled` changes nothing that is reported.
SEARCH = LevenbergMarquardt(evaluations=30, settled=0.3)
MAX_ROUNDS = 4  # linearisations of the circuit in a fit; also fits with errors about the previous one
MIN_MEASURED_WIDTH = 0.3  # of the prior's width: wider axes of the posterior are measured, see `Fitting._widths`
MAX_LOG_RATIO = 20.0  # difference of ln P to the best candidate beyond which candidates do not count


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
    by_parameter : array, shape (parameters, cells)
        Derivatives of ln r/r0 by φ.
    residual : array, shape (cells,)
        Residual of the readings, in their unit.
    chi2 : float
        χ² of the readings.
    cost : float
        ½ (χ² + Σ ((φ − mean)/sd)²).
    volume : float
        ½ ln det of the errors' covariance.
    evidence : float
        ln of the frame's probability under the candidate, up to a constant common to all candidates.
    scatter : float
        Relative deviation of the film.
    """

    candidate: Candidate
    parameters: Array
    covariance: Array
    change: Array
    by_parameter: Array
    residual: Array
    chi2: float
    cost: float
    volume: float
    evidence: float
    scatter: float = 0.0

    @property
    def score(self) -> float:
        """−ln posterior at its maximum, up to a constant; it compares candidates with different error covariances."""
        return self.cost + self.volume

    @property
    def loads(self) -> list[tuple[Candidate, Array]]:
        """Every single load of the candidate with its own φ."""
        return self.candidate.loads(self.parameters)


@dataclass(frozen=True, eq=False)
class CellLikelihood:
    """−ln P of a frame as a quadratic function of x = ln r/r0, ½ xᵀΛx − bᵀx + constant.

    The circuit is linearised at x₀: with the whitened residual e and Jacobian A there, Λ = AᵀA and b = Aᵀ(e + A x₀).

    Attributes
    ----------
    normal, pull : array, shapes (cells, cells) and (cells,)
        Λ and b.
    constant : float
    residual : array, shape (cells,)
        Residual of the readings at x₀, in their unit.
    exact : float
        ½ eᵀe, the value at x₀.
    """

    normal: Array
    pull: Array
    constant: float
    residual: Array
    exact: float

    @classmethod
    def about(cls, frame: Observation, whitening: Whitening, change: Array) -> "CellLikelihood":
        """Return the likelihood of a frame linearised about x₀ = `change`, (rows, columns)."""
        network = frame.baseline.network(change)
        residual = frame.target - network.reading().ravel()
        both = whitening @ np.column_stack([network.sensitivity(), residual])
        slope, error = both[:, :-1], both[:, -1]
        linear = error + slope @ change.ravel()
        square = float(linear @ linear) / 2
        return cls(slope.T @ slope, slope.T @ linear, square, residual, float(error @ error) / 2)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The cost about φ, with its gradient and Gauss-Newton matrix.

    Attributes
    ----------
    parameters : array, shape (parameters,)
        φ.
    change : array, shape (rows, columns)
        ln r/r0.
    by_parameter : array, shape (parameters, cells)
        Its derivatives by φ.
    misfit, cost : float
        −ln P of the readings, and the same with the priors.
    gradient, normal : array, shapes (parameters,) and (parameters, parameters)
    """

    parameters: Array
    change: Array
    by_parameter: Array
    misfit: float
    cost: float
    gradient: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Fitting:
    """The problem of fitting one candidate to one frame."""

    panel: Panel
    patch_mm: float
    candidate: Candidate
    frame: Observation

    def at(self, parameters: Array, likelihood: CellLikelihood) -> Linearisation:
        """Return the cost about φ."""
        pressure, by_parameter = self.pressure(parameters)
        change, response = self.frame.change(pressure)
        slopes = by_parameter.reshape(len(parameters), response.size) * response.ravel()
        mean, sd, _ = self._prior
        apart = (parameters - mean) / sd
        # x is 0 outside the load: only touched cells enter ½ xᵀΛx − bᵀx. Gradient X(Λx − b) + (φ − mean)/sd², matrix
        # XΛXᵀ + 1/sd², with X = ∂x/∂φ (parameters, cells).
        touched = np.flatnonzero(change)
        changed, own = change.ravel()[touched], slopes[:, touched]
        normal = likelihood.normal[np.ix_(touched, touched)]
        pulled, pull = normal @ changed, likelihood.pull[touched]
        misfit = likelihood.constant + float(changed @ (pulled / 2 - pull))
        cost = misfit + float(apart @ apart) / 2
        curvature = own @ normal @ own.T
        curvature[np.diag_indices(len(sd))] += 1 / sd**2
        return Linearisation(parameters, change, slopes, misfit, cost, own @ (pulled - pull) + apart / sd, curvature)

    def about(self, parameters: Array, whitening: Whitening) -> CellLikelihood:
        """Return the likelihood with the circuit linearised at φ."""
        return CellLikelihood.about(self.frame, whitening, self.frame.change(self.pressure(parameters)[0])[0])

    def descended(
        self,
        start: Array,
        likelihood: CellLikelihood,
        steps: int = SEARCH.evaluations,
        most: float = np.inf,
        held: int | None = None,
    ) -> Linearisation:
        """Return the model at the most probable φ that the Levenberg-Marquardt method reaches.

        Parameters
        ----------
        start : array, shape (parameters,)
        likelihood : CellLikelihood
        steps : int
            Most evaluations.
        most : float
            Cost above which the search ends early.
        held : int, optional
            Number of a parameter that is fixed.
        """
        mean, sd, longest = self._prior
        low, high = mean - SIGNIFICANT * sd, mean + SIGNIFICANT * sd
        if held is not None:
            low[held] = high[held] = start[held]
        loop = replace(SEARCH, evaluations=steps, longest=longest)
        return loop.minimum(
            lambda parameters: self.at(parameters, likelihood),
            start,
            (low, high),
            lambda point, count: count > 4 and point.cost > most,
        ).at

    def best(self, start: Array, whitening: Whitening, most: float = np.inf, *, quick: bool = False) -> Fit:
        """Return the fit at the most probable φ.

        Parameters
        ----------
        start : array, shape (parameters,)
        whitening : Whitening
            Errors of the readings.
        most : float
            Cost above which the search ends early.
        quick : bool
            Whether the posterior's widths are taken from the Gauss-Newton matrix alone.
        """
        point, likelihood = self.settled(start, whitening, most)
        return self.fit_at(point, likelihood, whitening, quick=quick or point.cost > most)

    def settled(
        self, start: Array, whitening: Whitening, most: float = np.inf, held: int | None = None
    ) -> tuple[Linearisation, CellLikelihood]:
        """Return the most probable φ with its exact cost, and the likelihood about it.

        The circuit is linearised again at the end of each search, until the exact cost agrees with the linearised one.
        The parameters are those of `descended`.
        """
        likelihood, parameters, best = self.about(start, whitening), start, None
        for _ in range(MAX_ROUNDS):
            point = self.descended(parameters, likelihood, most=most, held=held)
            likelihood = CellLikelihood.about(self.frame, whitening, point.change)
            parameters, exact = point.parameters, point.cost - point.misfit + likelihood.exact
            if best is None or exact < best[0].cost:
                best = replace(point, cost=exact), likelihood
            if abs(exact - point.cost) < SEARCH.settled or min(exact, point.cost) > most:
                break
        assert best is not None
        return best

    def stays(self, parameters: Array, whitening: Whitening) -> Fit:
        """Return the fit at given φ, without a search."""
        likelihood = self.about(parameters, whitening)
        return self.fit_at(self.at(parameters, likelihood), likelihood, whitening, quick=True)

    def fit_at(self, point: Linearisation, likelihood: CellLikelihood, whitening: Whitening, *, quick: bool) -> Fit:
        """Return the fit at a point, with the likelihood that was linearised there and its evidence."""
        widths, spread = self._widths(point, likelihood, quick=quick)
        covariance = spread @ spread.T + np.diag(self.candidate.blind(point.parameters) ** 2)
        # Laplace: ln P(R) = −cost + Σ ln(posterior width/prior width) − ½ ln det C + constant
        evidence = float(np.log(widths).sum() - point.cost) - whitening.volume
        known = point.parameters, covariance, point.change, point.by_parameter, likelihood.residual
        likely = 2 * likelihood.exact, point.cost, whitening.volume, evidence
        return Fit(self.candidate, *known, *likely, whitening.scatter)

    @cached_property
    def centred(self) -> NDArray[np.bool_]:
        """Whether each of φ is a coordinate of a centre, boolean (parameters,)."""
        return np.array([name.split(".")[-1] in ("x", "y") for name in self.candidate.priors(self.panel)], dtype=bool)

    @cached_property
    def _prior(self) -> Array:
        """Mean, standard deviation and longest step of φ, (3, parameters)."""
        return np.array([prior[:3] for prior in self.candidate.priors(self.panel).values()]).reshape(-1, 3).T

    def pressure(self, parameters: Array, larger: float = 1.0) -> tuple[Array, Array]:
        return self.candidate.pressure(self.panel, self.patch_mm * larger, parameters)

    def explained(self, fit: Fit) -> Explained:
        """Return the explained change with its sensitivities, by secants: tangents jump at the response's corners."""
        if not self.centred.any():
            zeros = np.zeros_like(fit.change)
            return Explained(fit.change, np.hypot(*np.gradient(fit.change, self.panel.pitch_mm)), zeros)
        pressure, by_parameter = self.pressure(fit.parameters)
        # |∇p| (kPa/mm): the change of pressure by a shift of 1 mm across an edge
        shift = np.sqrt((by_parameter[self.centred] ** 2).sum(axis=0))
        small, large = (self.pressure(fit.parameters, by)[0] for by in (0.9, 1.1))
        more, less, small, large = (
            self.frame.change(end)[0] for end in (pressure + shift, pressure - shift, small, large)
        )
        return Explained(fit.change, np.abs(more - less) / 2, (large - small) / (1.1 - 0.9))

    def _widths(self, point: Linearisation, likelihood: CellLikelihood, *, quick: bool) -> tuple[Array, Array]:
        """Return the posterior's widths along its axes over those of the prior, and a root of its covariance.

        Where a rim runs between patches, derivatives are 0, and the Gauss-Newton matrix gives the width of the prior.
        Such an axis has the width of the parabola through the cost one Gauss-Newton width away, averaged over both
        sides.
        """
        sd = self._prior[1]
        stiffness, axes = np.linalg.eigh(point.normal * np.outer(sd, sd))
        widths, axes = 1 / np.sqrt(np.maximum(stiffness, 1.0)), sd[:, None] * axes
        for axis in np.flatnonzero(widths > (np.inf if quick else MIN_MEASURED_WIDTH)):
            step = widths[axis] * axes[:, axis]
            rises = [self.at(point.parameters + sign * step, likelihood).cost - point.cost for sign in (1, -1)]
            widths[axis] *= np.mean(1 / np.sqrt(np.maximum(1.0, 2 * np.array(rises))))
        return widths, axes * widths


def along_diameter(fitting: Fitting, fit: Fit, whitening: Whitening) -> Fit:
    """Return the fit with the posterior covariance by a profile along ln d, where that is wider.

    No reading depends on a rim between patches: the cost is flat there and steep beside it, and the curvature at the
    best φ̂ underestimates the width. δ = ln d is stepped, and all other parameters are fitted for each δ:

        P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̂)(φ(δ) − φ̂)ᵀ).

    Parameters
    ----------
    fitting : Fitting
        The problem of the fit's candidate.
    fit : Fit
        A fit without a diameter is returned unchanged.
    whitening : Whitening
        Errors with which it was fitted.
    """
    names = list(fit.candidate.priors(fitting.panel))
    if "diameter" not in names:
        return fit
    place = names.index("diameter")
    others = np.ix_(*2 * [np.arange(len(names)) != place])
    # Profile: step ln d in both directions until P(δ) is negligible, all other parameters fitted.
    points = [fitting.settled(fit.parameters, whitening, held=place)[0]]
    apart = fitting.patch_mm / POINTS / float(np.exp(fit.parameters[place]))  # as points of a patch are
    for step in (1, -1) * np.array(max(apart, fit.covariance[place, place] ** 0.5 / 2)):
        point = points[0]
        while point.cost < points[0].cost + MAX_LOG_RATIO / 2:
            begin = point.parameters + step * np.eye(len(names))[place]
            point = fitting.settled(begin, whitening, points[0].cost + MAX_LOG_RATIO / 2, place)[0]
            points.append(point)
    # Prior precision of a centre that is uniform within a pitch: beyond, it would touch other patches.
    centred = np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2)
    precisions = [(point.normal + centred)[others] for point in points]
    # P(δ) ∝ e^(−cost) |H|^(−½), with H of all parameters but ln d; then C = Σ P (H⁻¹ + (φ − φ̂)(φ − φ̂)ᵀ)
    share = softmax(
        [-point.cost - np.linalg.slogdet(own)[1] / 2 for point, own in zip(points, precisions, strict=True)]
    )
    away = np.array([point.parameters for point in points]) - fit.parameters
    covariance = (share[:, None] * away).T @ away + np.diag(fit.candidate.blind(fit.parameters) ** 2)
    covariance[others] += np.tensordot(share, np.linalg.inv(precisions), 1)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


# Assumed standard deviations of ln r/r0 in the four states: no load, half a kPa, a few kPa, tens of kPa.
SD = np.array([0.005, 0.08, 0.4, 1.6])


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """Return the most probable field with its evidence, and the frame without outliers.

    x = ln r/r0 is Gaussian with the σ of each cell's state, correlated between neighbours. The evidence integrates over
    x about its maximum. The states are those of a map of the cells, or of a first field, and have a Potts prior.
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
    """Return the most probable field with the states of ln r/r0 = `start` (rows, columns), which is also the start."""
    panel, none = frame.baseline.scene.panel, np.zeros(0)
    of_cells = states(panel, start)
    most_probable = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change, whitening = most_probable.state.reshape(start.shape), most_probable.whitening
    errors, left = whitening @ most_probable.apart, frame.residual(change)
    misfit = Whitening(np.linalg.cholesky(frame.covariance(frame.slope(change)))) @ left
    cost = float(errors @ errors) / 2
    # ln P(R | states) = −½ eᵀ (A P Aᵀ + C)⁻¹ e − ½ ln det (A P Aᵀ + C), and ln P(states) of the Potts field
    likely = float(misfit @ misfit), cost, whitening.volume, -cost - whitening.volume - paid(panel, of_cells)
    return Fit(FIELD, none, none.reshape(0, 0), change, none.reshape(0, change.size), left, *likely), most_probable


def prior(frame: Observation, sd: Array) -> Array:
    """Return the prior covariance of ln r/r0 of cells with these standard deviations, correlated between neighbours."""
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.asarray(np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near))


def states(panel: Panel, change: Array) -> NDArray[np.intp]:
    """Return the state of each cell, 0 to 3 for quiet to strongly changed, by its own and its neighbours' changes."""
    square, (first, second, _) = change.ravel() ** 2, panel.neighbours
    cell, neighbour = np.concatenate([first, second]), np.concatenate([second, first])
    beside = np.bincount(cell, square[neighbour], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    beside += np.maximum(4 - sides, 0) * square  # a cell at the border stands for its missing neighbours
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * beside), limits)).reshape(change.shape)


def paid(panel: Panel, of_cells: NDArray[np.intp]) -> float:
    """Return −ln P of the states: 1 for each pair of unlike neighbours (an assumption), and a normalising constant."""
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
