"""One candidate, or a field of any form, fitted to one frame, and how likely the frame is under it.

In a field cells are quiet or changed, and neighbours alike: a Potts field.
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

# With one linearised circuit; a step that changes ln P by less than `settled` changes nothing that is reported.
SEARCH = LevenbergMarquardt(evaluations=30, settled=0.3)
MAX_ROUNDS = 4  # linearisations of the circuit in a fit, and fits with the errors about the one before, at most
MIN_MEASURED_WIDTH = 0.3  # of the prior's width: wider axes of the posterior are measured, see `Fitting._widths`
MAX_LOG_RATIO = 20.0  # of ln P: candidates so far below the best do not count


@dataclass(frozen=True, eq=False)
class Fit:
    """The most probable parameters φ of a candidate.

    Attributes
    ----------
    parameters, covariance : array
        (parameters) and its square.
    change : array, shape (rows, columns)
        ln r/r0.
    by_parameter : array
        (parameters, cells) its slopes.
    residual : array, shape (cells)
        Ohm.
    chi2 : float
        Of the readings.
    cost : float
        Half of it plus half the priors'.
    volume : float
        ½ ln det of the errors' covariance.
    evidence : float
        ln of the frame's probability under the candidate, up to a common term of all candidates.
    scatter : float
        The film's relative deviation.
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
        """−ln of the posterior at its most probable point, which compares candidates with errors of their own."""
        return self.cost + self.volume

    @property
    def loads(self) -> list[tuple[Candidate, Array]]:
        """Each of its loads with its own φ."""
        return self.candidate.loads(self.parameters)


@dataclass(frozen=True, eq=False)
class CellLikelihood:
    """−ln P of a frame as a square of x = ln r/r0, the circuit linearised at one x₀: ½ xᵀΛx − bᵀx + constant.

    With whitened residual e and slope A at x₀, Λ = AᵀA and b = Aᵀ(e + A x₀).

    Attributes
    ----------
    residual : array, shape (cells)
        Ohm, at x₀.
    exact : float
        ½ eᵀe, its value there.
    """

    normal: Array
    pull: Array
    constant: float
    residual: Array
    exact: float

    @classmethod
    def about(cls, frame: Observation, whitening: Whitening, change: Array) -> "CellLikelihood":
        """x₀ : (rows, columns)."""
        network = frame.baseline.network(change)
        residual = frame.target - network.reading().ravel()
        both = whitening @ np.column_stack([network.sensitivity(), residual])
        slope, error = both[:, :-1], both[:, -1]
        linear = error + slope @ change.ravel()
        square = float(linear @ linear) / 2
        return cls(slope.T @ slope, slope.T @ linear, square, residual, float(error @ error) / 2)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The model about φ: cost is that of readings and priors, with its slope and curvature of Gauss and Newton.

    Attributes
    ----------
    change : array, shape (rows, columns)
        ln r/r0.
    by_parameter : array
        (parameters, cells).
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
    """A candidate on a panel with patches, before a frame."""

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
        """Return the model at the most probable φ that Levenberg and Marquardt's steps reach.

        Parameters
        ----------
        most : float
            A cost above which they end early.
        held : int or None
            The number of a parameter that stays.
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
        most : float
            Cost above which the search ends early.
        quick : bool
            Whether widths are those of the curvature.
        """
        point, likelihood = self.settled(start, whitening, most)
        return self.fit_at(point, likelihood, whitening, quick=quick or point.cost > most)

    def settled(
        self, start: Array, whitening: Whitening, most: float = np.inf, held: int | None = None
    ) -> tuple[Linearisation, CellLikelihood]:
        """Return (the most probable φ with its exact cost, the likelihood about it).

        The circuit is linearised anew where the last search ended, until that changes nothing. most, held : as above.
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
        """Return the fit at φ as it is."""
        likelihood = self.about(parameters, whitening)
        return self.fit_at(self.at(parameters, likelihood), likelihood, whitening, quick=True)

    def fit_at(self, point: Linearisation, likelihood: CellLikelihood, whitening: Whitening, *, quick: bool) -> Fit:
        """Return the fit with a likelihood that was linearised there."""
        widths, spread = self._widths(point, likelihood, quick=quick)
        covariance = spread @ spread.T + np.diag(self.candidate.blind(point.parameters) ** 2)
        evidence = float(np.log(widths).sum() - point.cost) - whitening.volume
        known = point.parameters, covariance, point.change, point.by_parameter, likelihood.residual
        likely = 2 * likelihood.exact, point.cost, whitening.volume, evidence
        return Fit(self.candidate, *known, *likely, whitening.scatter)

    @cached_property
    def centred(self) -> NDArray[np.bool_]:
        """Coordinates of a centre among φ, boolean (parameters)."""
        return np.array([name.split(".")[-1] in ("x", "y") for name in self.candidate.priors(self.panel)], dtype=bool)

    @cached_property
    def _prior(self) -> Array:
        """Mean, standard deviation and longest step of φ, (3, parameters)."""
        return np.array([prior[:3] for prior in self.candidate.priors(self.panel).values()]).reshape(-1, 3).T

    def pressure(self, parameters: Array, larger: float = 1.0) -> tuple[Array, Array]:
        return self.candidate.pressure(self.panel, self.patch_mm * larger, parameters)

    def explained(self, fit: Fit) -> Explained:
        """Return the explanation by secants as long as such errors: tangents jump at the response's corners."""
        if not self.centred.any():
            zeros = np.zeros_like(fit.change)
            return Explained(fit.change, np.hypot(*np.gradient(fit.change, self.panel.pitch_mm)), zeros)
        pressure, by_parameter = self.pressure(fit.parameters)
        shift = np.sqrt((by_parameter[self.centred] ** 2).sum(axis=0))
        small, large = (self.pressure(fit.parameters, by)[0] for by in (0.9, 1.1))
        more, less, small, large = (
            self.frame.change(end)[0] for end in (pressure + shift, pressure - shift, small, large)
        )
        return Explained(fit.change, np.abs(more - less) / 2, (large - small) / (1.1 - 0.9))

    def _widths(self, point: Linearisation, likelihood: CellLikelihood, *, quick: bool) -> tuple[Array, Array]:
        """Return standard deviations along the posterior's axes over those of the prior, and a root of its covariance.

        Where a rim runs between patches, slopes are 0 and would give the width of the prior. There the cost one such
        width away on either side gives the width, of a parabola through that point.
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
    """Return the fit with the covariance of the posterior along ln d, where that is wider.

    A fit without a diameter stays as it is.

    Between patches no reading sees a rim: the cost is flat there and steep beside it, and its curvature at the best φ
    promises too much. With δ = ln d stepped through, all other numbers fitted anew,

        P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̂)(φ(δ) − φ̂)ᵀ)

    about the most probable φ̂. fitting : that of its candidate, with the errors that the fit was weighed by.
    """
    names = list(fit.candidate.priors(fitting.panel))
    if "diameter" not in names:
        return fit
    place = names.index("diameter")
    others = np.ix_(*2 * [np.arange(len(names)) != place])
    points = [fitting.settled(fit.parameters, whitening, held=place)[0]]
    apart = fitting.patch_mm / POINTS / float(np.exp(fit.parameters[place]))  # as points of a patch are
    for step in (1, -1) * np.array(max(apart, fit.covariance[place, place] ** 0.5 / 2)):
        point = points[0]
        while point.cost < points[0].cost + MAX_LOG_RATIO / 2:
            begin = point.parameters + step * np.eye(len(names))[place]
            point = fitting.settled(begin, whitening, points[0].cost + MAX_LOG_RATIO / 2, place)[0]
            points.append(point)
    # A centre a pitch further on would have touched other patches.
    centred = np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2)
    precisions = [(point.normal + centred)[others] for point in points]
    share = softmax(
        [-point.cost - np.linalg.slogdet(own)[1] / 2 for point, own in zip(points, precisions, strict=True)]
    )
    away = np.array([point.parameters for point in points]) - fit.parameters
    covariance = (share[:, None] * away).T @ away + np.diag(fit.candidate.blind(fit.parameters) ** 2)
    covariance[others] += np.tensordot(share, np.linalg.inv(precisions), 1)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


SD = np.array([0.005, 0.08, 0.4, 1.6])  # of ln r/r0 where nothing is, at half a kPa, a few kPa, tens; assumptions


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """Return (the most probable field with its evidence, the frame without the outliers that it shows).

    x = ln r/r0 is Gaussian, each cell's σ that of one of four states, neighbours alike. Cells are marginalised about
    the most probable x; the states are those of a map of the cells or of the field itself, and paid for as a Potts
    field pays.
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
    """Return the most probable field with the states that ln r/r0 (rows, columns) shows, from there."""
    panel, none = frame.baseline.scene.panel, np.zeros(0)
    of_cells = states(panel, start)
    most_probable = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change, whitening = most_probable.state.reshape(start.shape), most_probable.whitening
    errors, left = whitening @ most_probable.apart, frame.residual(change)
    misfit = Whitening(np.linalg.cholesky(frame.covariance(frame.slope(change)))) @ left
    cost = float(errors @ errors) / 2
    likely = float(misfit @ misfit), cost, whitening.volume, -cost - whitening.volume - paid(panel, of_cells)
    return Fit(FIELD, none, none.reshape(0, 0), change, none.reshape(0, change.size), left, *likely), most_probable


def prior(frame: Observation, sd: Array) -> Array:
    """Return the covariance of ln r/r0 of cells with these standard deviations, (cells, cells).

    Neighbours are partly alike.
    """
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.asarray(np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near))


def states(panel: Panel, change: Array) -> NDArray[np.intp]:
    """0 to 3 for quiet to strongly changed cells: by their own change and that of their neighbours."""
    square, (first, second, _) = change.ravel() ** 2, panel.neighbours
    cell, neighbour = np.concatenate([first, second]), np.concatenate([second, first])
    beside = np.bincount(cell, square[neighbour], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    beside += np.maximum(4 - sides, 0) * square  # a cell at the border stands for its missing neighbours
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * beside), limits)).reshape(change.shape)


def paid(panel: Panel, of_cells: NDArray[np.intp]) -> float:
    """−ln P of the states: 1 for a pair of unlike neighbours, an assumption, and the normalising constant."""
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
