"""One candidate, or a field of any form, fitted to one frame, and how likely the frame is under it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from lampest.loads.recognition.candidates import FIELD
from lampest.loads.recognition.observation import (
    FARTHEST,
    SUSPICIOUS,
    Explained,
    MostProbable,
    Observation,
    Whitening,
    outliers,
)
from lampest.loads.shapes.shape import Candidate
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array, Panel

# Evaluations of the model in a fit, and in a coarse one; of ln P, below which a step changes nothing that is reported.
STEPS, COARSE_STEPS, ENOUGH = 30, 12, 2e-2
LOOSE = 0.3  # of the prior's width: wider axes of the posterior are measured, see `Fitting._widths`
UNLIKELY = 20.0  # of ln P: what is so far below the best hardly counts
PROFILE_STEP = 0.03  # of ln d, 0.9 mm at 30 mm
SD = np.array([0.005, 0.08, 0.4, 1.6])  # of ln r/r0 where nothing is, at half a kPa, a few kPa, tens; assumptions


@dataclass(frozen=True, eq=False)
class Fit:
    """The most probable parameters φ of a candidate.

    parameters, covariance : (parameters) and its square. explained : what it does to the cells. residual : (cells) ohm.
    slopes : (cells, parameters) ohm, of the readings by φ. chi2 : of the readings. cost : half of it plus half the
    priors'. volume : ½ ln det of the errors' covariance. evidence : ln of the frame's probability under the candidate,
    up to what all candidates share. scatter : the film's relative deviation. steps : evaluations of the model.
    """

    candidate: Candidate
    parameters: Array
    covariance: Array
    explained: Explained
    residual: Array
    slopes: Array
    chi2: float
    cost: float
    volume: float
    evidence: float
    scatter: float = 0.0
    steps: int = 0

    @property
    def score(self) -> float:
        """−ln of the posterior at its most probable point: what candidates with errors of their own compare by."""
        return self.cost + self.volume

    @property
    def loads(self) -> list[tuple[Candidate, Array]]:
        """Each of its loads with its own φ."""
        return self.candidate.loads(self.parameters)

    @property
    def change(self) -> Array:
        """ln r/r0, (rows, columns)."""
        return self.explained.change

    def outliers(self, frame: Observation) -> NDArray[np.intp]:
        """Numbers of the frame's readings that contradict it; none where its χ² is not suspicious."""
        whitening = Whitening.of(frame, self.explained, self.scatter)
        errors = whitening @ self.residual
        suspicious = errors @ errors > SUSPICIOUS * len(errors)
        return outliers(whitening, self.residual) if suspicious else np.zeros(0, dtype=np.intp)

    def with_errors(self, frame: Observation) -> tuple[Observation, Whitening]:
        """(the frame without its outliers, the frame's errors about what it explains)."""
        frame = frame.without(self.outliers(frame))
        return frame, Whitening.of(frame, self.explained, self.scatter)


@dataclass(frozen=True, eq=False, kw_only=True)
class Linearisation(SumOfSquares):
    """The model about φ: residual and jacobian are errors of unit variance, of readings and priors, and slopes by φ.

    left, by_parameter : residual of the readings and slopes of these by φ, ohm.
    """

    parameters: Array
    change: Array
    left: Array
    by_parameter: Array


@dataclass(frozen=True, eq=False)
class Fitting:
    """A candidate on a panel with patches, before a frame with the whitening of its errors."""

    panel: Panel
    patch_mm: float
    candidate: Candidate
    frame: Observation
    whitening: Whitening

    def cost(self, parameters: Array) -> float:
        """Half the square of errors of unit variance, of readings and priors."""
        errors = self.whitening @ self.frame.residual(self.frame.change(self._pressure(parameters)[0])[0])
        mean, sd = self._prior
        prior = (parameters - mean) / sd
        return float(errors @ errors + prior @ prior) / 2

    def at(self, parameters: Array) -> Linearisation:
        """Errors of unit variance, of readings and priors, and their slopes by φ."""
        pressure, by_parameter = self._pressure(parameters)
        change, response = self.frame.change(pressure)
        touched = np.flatnonzero(np.any(by_parameter != 0, axis=0))
        network = self.frame.baseline.network(change)
        left = self.frame.target - network.reading().ravel()
        of_cells = (response.ravel() * by_parameter.reshape(len(parameters), response.size))[:, touched].T
        of_readings = network.sensitivity(touched) @ of_cells
        whitened = self.whitening @ np.column_stack([left, of_readings])
        mean, sd = self._prior
        residual = np.concatenate([whitened[:, 0], (parameters - mean) / sd])
        jacobian = np.vstack([-whitened[:, 1:], np.diag(1 / sd)])
        return Linearisation(
            residual, jacobian, parameters=parameters, change=change, left=left, by_parameter=of_readings
        )

    def best(self, start: Array, steps: int = STEPS, most: float = np.inf, quick: bool = False) -> Fit:
        """The most probable φ that `descended` finds. quick : its widths are those of the curvature."""
        here, count = self.descended(start, steps, most)
        widths, spread = self._widths(here, quick)
        misfit, volume = here.residual[: here.left.size], self.whitening.volume
        covariance = spread @ spread.T + np.diag(self.candidate.blind(here.parameters) ** 2)
        evidence = float(np.log(widths).sum() - here.cost) - volume
        known = here.parameters, covariance, self._explained(here), here.left, here.by_parameter
        likely = float(misfit @ misfit), here.cost, volume, evidence
        return Fit(self.candidate, *known, *likely, self.whitening.scatter, count)

    def descended(
        self, start: Array, steps: int, most: float = np.inf, held: int | None = None
    ) -> tuple[Linearisation, int]:
        """(the model at the most probable φ that Levenberg and Marquardt's steps reach, its evaluations).

        most : a cost above which they end early. held : the number of a parameter that stays.
        """
        mean, sd = self._prior
        low, high = mean - FARTHEST * sd, mean + FARTHEST * sd
        if held is not None:
            low[held] = high[held] = start[held]
        longest = np.array([prior.step for prior in self.candidate.priors(self.panel).values()])
        found = LevenbergMarquardt(steps, ENOUGH, longest=longest).minimum(
            self.at, start, (low, high), lambda here, count: count > steps // 3 and here.cost > most
        )
        return found.at, found.evaluations

    @cached_property
    def centred(self) -> NDArray[np.bool_]:
        """Which of φ are coordinates of a centre, (parameters)."""
        return np.array([name.split(".")[-1] in ("x", "y") for name in self.candidate.priors(self.panel)], dtype=bool)

    @cached_property
    def _prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation of φ."""
        return self.candidate.mean(self.panel), self.candidate.sd(self.panel)

    def _pressure(self, parameters: Array, larger: float = 1.0) -> tuple[Array, Array]:
        return self.candidate.pressure(self.panel, self.patch_mm * larger, parameters)

    def _explained(self, here: Linearisation) -> Explained:
        """By secants as long as such errors are: tangents jump where pressure comes to the response's corners."""
        if not self.centred.any():
            return Explained(here.change, np.zeros_like(here.change), np.zeros_like(here.change))
        pressure, by_parameter = self._pressure(here.parameters)
        shift = np.sqrt((by_parameter[self.centred] ** 2).sum(axis=0))
        small, large = (self._pressure(here.parameters, by)[0] for by in (0.9, 1.1))
        more, less, small, large = (
            self.frame.change(end)[0] for end in (pressure + shift, pressure - shift, small, large)
        )
        return Explained(here.change, np.abs(more - less) / 2, (large - small) / (1.1 - 0.9))

    def _widths(self, here: Linearisation, quick: bool) -> tuple[Array, Array]:
        """(standard deviations along the axes of the posterior over those of the prior, the root of its covariance).

        Where a rim runs between patches, slopes are 0 and would give the width of the prior. There the cost one such
        width away on either side gives the width, of a parabola through that point.
        """
        sd = self._prior[1]
        stiffness, axes = np.linalg.eigh(here.normal * np.outer(sd, sd))
        widths, axes = 1 / np.sqrt(np.maximum(stiffness, 1.0)), sd[:, None] * axes
        for axis in np.flatnonzero(widths > (np.inf if quick else LOOSE)):
            step = widths[axis] * axes[:, axis]
            rises = [self.cost(here.parameters + sign * step) - here.cost for sign in (1, -1)]
            widths[axis] *= np.mean(1 / np.sqrt(np.maximum(1.0, 2 * np.array(rises))))
        return widths, axes * widths


def along_diameter(fitting: Fitting, fit: Fit) -> Fit:
    """The fit with the covariance of the posterior along ln d, where that is wider; itself where there is no diameter.

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
    points = [fitting.descended(fit.parameters, STEPS, held=place)[0]]
    for step in (PROFILE_STEP, -PROFILE_STEP):
        here = points[0]
        while here.cost < points[0].cost + UNLIKELY:
            begin = here.parameters + step * np.eye(len(names))[place]
            here = fitting.descended(begin, COARSE_STEPS, held=place)[0]
            points.append(here)
    # A centre a pitch further on would have touched other patches.
    centred = np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2)
    precisions = [(point.normal + centred)[others] for point in points]
    share = softmax(
        [-point.cost - np.linalg.slogdet(own)[1] / 2 for point, own in zip(points, precisions, strict=True)]
    )
    apart = np.array([point.parameters for point in points]) - fit.parameters
    covariance = (share[:, None] * apart).T @ apart + np.diag(fit.candidate.blind(fit.parameters) ** 2)
    covariance[others] += np.tensordot(share, np.linalg.inv(precisions), 1)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """(the most probable field with its evidence, the frame without the outliers that it shows).

    x = ln r/r0 is Gaussian, each cell's σ that of one of four states, neighbours alike. Cells are marginalised about
    the most probable x; the states are those of a map of the cells or of the field itself, and paid for as a Potts
    field pays.
    """
    fit, found = _of_two_maps(frame)
    if fit.chi2 < SUSPICIOUS * frame.measured.size:
        return fit, frame
    calm = frame.without(outliers(Whitening(found.root), found.apart))
    return max((fit, frame), (_of_two_maps(calm)[0], calm), key=lambda pair: pair[0].evidence)


def _of_two_maps(frame: Observation) -> tuple[Fit, MostProbable]:
    one = _with_states(frame, frame.map)
    return max(one, _with_states(frame, one[0].change), key=lambda pair: pair[0].evidence)


def _with_states(frame: Observation, start: Array) -> tuple[Fit, MostProbable]:
    """The most probable field with the states that ln r/r0 (rows, columns) shows, from there."""
    panel, none = frame.baseline.scene.panel, np.zeros(0)
    of_cells = states(panel, start)
    found = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change, whitening = found.state.reshape(start.shape), Whitening(found.root)
    explained = Explained(change, np.hypot(*np.gradient(change, panel.pitch_mm)), np.zeros_like(change))
    errors, left = whitening @ found.apart, frame.residual(change)
    misfit = Whitening(np.linalg.cholesky(frame.covariance(frame.slope(change)))) @ left
    cost = float(errors @ errors) / 2
    likely = float(misfit @ misfit), cost, whitening.volume, -cost - whitening.volume - paid(panel, of_cells)
    return Fit(FIELD, none, none.reshape(0, 0), explained, left, none.reshape(change.size, 0), *likely), found


def prior(frame: Observation, sd: Array) -> Array:
    """The covariance of ln r/r0 of cells with these standard deviations, partly alike in neighbours, (cells, cells)."""
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.asarray(np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near))


def states(panel: Panel, change: Array) -> NDArray[np.intp]:
    """0 to 3 for quiet to strongly changed cells: by their own change and that of their neighbours."""
    square, (first, second, _) = change.ravel() ** 2, panel.neighbours
    here, there = np.concatenate([first, second]), np.concatenate([second, first])
    beside = np.bincount(here, square[there], square.size).astype(float)
    sides = np.bincount(here, minlength=square.size)
    beside += np.maximum(4 - sides, 0) * square  # a cell at the border stands for what it has not beside it
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * beside), limits)).reshape(change.shape)


def paid(panel: Panel, of_cells: NDArray[np.intp]) -> float:
    """−ln P of the states: 1 for a pair of unlike neighbours, an assumption, and what makes the sum of all P one."""
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
