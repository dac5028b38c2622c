"""One candidate fitted to one frame, how likely the frame is under it, and how large a load it may be."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from lampest.loads.recognition.candidates import loads_of
from lampest.loads.recognition.frame import NONE, SUSPICIOUS, Explained, Observation, Whitening, outliers, without
from lampest.loads.shapes.shape import Candidate
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array, Panel

STEPS = 30  # evaluations of the model in a whole fit
ENOUGH = 2e-2  # of ln P: below, a step changes nothing that is reported
FARTHEST = 5.0  # standard deviations of the prior: the bounds of a fit
TRIAL = 4  # evaluations before a fit may be given up
LOOSE = 0.3  # of the prior's width: wider axes of the posterior are measured, see `Fitting._widths`
PATCHES = (0.9, 1.1)  # times a patch's edge, for a difference
LOST = 18.0  # of ln P below `hopeless`: the evidence of such a fit hardly counts, and its widths are not measured
# The profile of ln d: its step, 0.9 mm at 30 mm; steps to either side; evaluations at each.
STEP, MOST, TRIES = 0.03, 24, 6
BARRIER = 10.0  # of ln P: two points in a row so much below the best end a profile
LIKELY = 5.0  # of ln P: points below the best by more are far tails, no part of an interval
NEIGHBOURS = np.array([1, 2, 3, 2, 1]) / 9  # weights of ½ ln |H| on the profile; an assumption


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
    scatter: float
    steps: int

    @property
    def score(self) -> float:
        """−ln of the posterior at its most probable point: what candidates with errors of their own compare by."""
        return self.cost + self.volume

    @property
    def loads(self) -> list[tuple[Candidate, Array]]:
        """Each of its loads with its own φ."""
        return loads_of(self.candidate, self.parameters)

    @property
    def change(self) -> Array:
        """ln r/r0, (rows, columns)."""
        return self.explained.change


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
        pressure, _ = self.candidate.pressure(self.panel, self.patch_mm, parameters)
        errors = self.whitening @ self.frame.missed(self.frame.change(pressure)[0], NONE)[0]
        mean, sd = self._prior
        prior = (parameters - mean) / sd
        return float(errors @ errors + prior @ prior) / 2

    def at(self, parameters: Array) -> Linearisation:
        """Errors of unit variance, of readings and priors, and their slopes by φ."""
        pressure, by_parameter = self.candidate.pressure(self.panel, self.patch_mm, parameters)
        change, response = self.frame.change(pressure)
        touched = np.flatnonzero(np.any(by_parameter != 0, axis=0))
        left, slopes = self.frame.missed(change, touched)
        of_cells = (response.ravel() * by_parameter.reshape(len(parameters), response.size))[:, touched].T
        of_readings = slopes @ of_cells
        whitened = self.whitening @ np.column_stack([left, of_readings])
        mean, sd = self._prior
        return Linearisation(
            np.concatenate([whitened[:, 0], (parameters - mean) / sd]),
            np.vstack([-whitened[:, 1:], np.diag(1 / sd)]),
            parameters=parameters,
            change=change,
            left=left,
            by_parameter=of_readings,
        )

    @cached_property
    def _prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation of φ."""
        return self.candidate.mean(self.panel), self.candidate.sd(self.panel)

    @cached_property
    def centred(self) -> NDArray[np.bool_]:
        """Which of φ are coordinates of a centre, (parameters)."""
        return np.array([name.split(".")[-1] in ("x", "y") for name in self.candidate.priors(self.panel)], dtype=bool)

    def _explained(self, here: Linearisation) -> Explained:
        """What the load does to ln r, what a shift of it by 1 mm adds, and what larger patches do.

        By secants as long as such errors are: tangents jump where pressure comes to the response's corners.
        """
        if not self.centred.any():
            return Explained(here.change, np.zeros_like(here.change), np.zeros_like(here.change))
        pressure, by_parameter = self.candidate.pressure(self.panel, self.patch_mm, here.parameters)
        shift = np.sqrt((by_parameter[self.centred] ** 2).sum(axis=0))
        sizes = [self.candidate.pressure(self.panel, self.patch_mm * by, here.parameters)[0] for by in PATCHES]
        ends = [self.frame.change(end)[0] for end in (pressure + shift, pressure - shift, *sizes)]
        patches = (ends[3] - ends[2]) / (PATCHES[1] - PATCHES[0])
        return Explained(here.change, np.abs(ends[0] - ends[1]) / 2, patches)

    def best(self, start: Array, steps: int = STEPS, hopeless: float = np.inf, rough: bool = False) -> Fit:
        """The most probable φ that `descended` finds. rough : widths are those of the curvature; see `widened`."""
        here, count = self.descended(start, steps, hopeless)
        return self._fit(here, count, rough or here.cost > hopeless - self.whitening.volume - LOST)

    def descended(
        self, start: Array, steps: int, hopeless: float = np.inf, held: int | None = None
    ) -> tuple[Linearisation, int]:
        """(the model at the most probable φ that Levenberg and Marquardt's steps reach, its evaluations).

        They end where they gain less than ENOUGH, after `steps`, and soon where the score stays above `hopeless`.
        held : the number of a parameter that stays.
        """
        mean, sd = self._prior
        low, high = mean - FARTHEST * sd, mean + FARTHEST * sd
        if held is not None:
            low[held] = high[held] = start[held]
        longest = np.array([prior.step for prior in self.candidate.priors(self.panel).values()])
        most = hopeless - self.whitening.volume
        found = LevenbergMarquardt(steps, ENOUGH, longest=longest).minimum(
            self.at, start, (low, high), lambda here, count: count > TRIAL and here.cost > most
        )
        return found.at, found.evaluations

    def widened(self, fit: Fit) -> Fit:
        """A rough fit with widths that are measured."""
        return self._fit(self.at(fit.parameters), fit.steps + 1, False)

    def _fit(self, here: Linearisation, count: int, rough: bool) -> Fit:
        """The result where steps no longer improve it; see `_widths`."""
        sd = self._prior[1]
        precision = here.normal * np.outer(sd, sd)
        stiffness, axes = np.linalg.eigh(precision)
        widths, tried = 1 / np.sqrt(np.maximum(stiffness, 1.0)), 0  # that of the priors is 1
        if not rough:
            widths, tried = self._widths(here, widths, sd[:, None] * axes)
        spread = sd[:, None] * axes * widths
        misfit = here.residual[: here.left.size]
        return Fit(
            self.candidate,
            here.parameters,
            spread @ spread.T + np.diag(self.candidate.blind(here.parameters) ** 2),
            self._explained(here),
            here.left,
            here.by_parameter,
            float(misfit @ misfit),
            here.cost,
            self.whitening.volume,
            float(np.log(widths).sum() - here.cost) - self.whitening.volume,
            self.whitening.scatter,
            count + tried,
        )

    def _widths(self, here: Linearisation, widths: Array, axes: Array) -> tuple[Array, int]:
        """Standard deviations along the axes of the posterior, in those of the prior, and evaluations.

        Where a rim runs between patches, slopes are 0 and would give the width of the prior. There the cost one such
        width away on either side gives the width, of a parabola through that point.
        """
        loose = np.flatnonzero(widths > LOOSE)
        widths = widths.copy()
        for axis in loose:
            step = widths[axis] * axes[:, axis]
            rises = [self.cost(here.parameters + sign * step) - here.cost for sign in (1, -1)]
            widths[axis] *= np.mean(1 / np.sqrt(np.maximum(1.0, 2 * np.array(rises))))
        return widths, 2 * len(loose)


def outliers_of(frame: Observation, fit: Fit) -> NDArray[np.intp]:
    """Numbers of the readings that contradict a fit to the frame; none where its χ² is not suspicious."""
    if fit.chi2 <= SUSPICIOUS * frame.measured.size:
        return NONE
    return outliers(Whitening.of(frame, fit.explained, fit.scatter), fit.residual)


def with_errors(frame: Observation, fit: Fit) -> tuple[Observation, Whitening]:
    """(the frame without a fit's outliers, its errors about what the fit explains)."""
    frame = without(frame, outliers_of(frame, fit))
    return frame, Whitening.of(frame, fit.explained, fit.scatter)


def linear_evidence(fit: Fit, whitening: Whitening, mean: Array, sd: Array) -> float:
    """ln N(e; A (mean − φ̂), C + A Σ Aᵀ): the frame's probability with the model linear about φ̂, for other errors C.

    mean, sd : of the priors of φ.
    """
    errors = whitening @ np.column_stack([fit.residual, fit.slopes * sd])
    apart = (fit.parameters - mean) / sd
    stiff = errors[:, 1:].T @ errors[:, 1:] + np.eye(len(sd))
    pull = errors[:, 1:].T @ errors[:, 0] - apart
    cost = (errors[:, 0] @ errors[:, 0] + apart @ apart - pull @ np.linalg.solve(stiff, pull)) / 2
    return float(-cost - np.linalg.slogdet(stiff)[1] / 2) - whitening.volume


class AtDiameter(NamedTuple):
    """φ at one ln d, the cost of readings and priors, ½ ln |H| and H⁻¹ of all other numbers."""

    parameters: Array
    cost: float
    volume: float
    covariance: Array


def along_diameter(fitting: Fitting, fit: Fit) -> Fit:
    """The fit with the covariance of the posterior along ln d, where that is wider; itself where there is no diameter.

    Between patches no reading sees a rim: the cost is flat there and steep beside it, and its curvature at the best φ
    promises too much. With δ = ln d stepped through, all other numbers fitted anew,

        P(δ) ∝ e^(−cost(δ)) |H(δ)|^(−½),   C = Σ P (H(δ)⁻¹ + (φ(δ) − φ̂)(φ(δ) − φ̂)ᵀ)

    about the most probable φ̂. |H| is averaged over neighbours: it jumps with every corner of a patch under an edge.
    fitting : that of its candidate, with the errors that the fit was weighed by.
    """
    names = list(fit.candidate.priors(fitting.panel))
    if "diameter" not in names:
        return fit
    place = names.index("diameter")
    points = [_point(fitting, fit.parameters, place, fit.parameters[place])]
    for direction in (STEP, -STEP):
        points += _outwards(fitting, points[0], place, direction)
    points.sort(key=lambda point: point.parameters[place])
    volume = np.convolve(np.pad([point.volume for point in points], 2, mode="edge"), NEIGHBOURS, "valid")
    logarithm = -np.array([point.cost for point in points]) - volume
    share = softmax(np.where(logarithm > logarithm.max() - LIKELY, logarithm, -np.inf))
    apart = np.array([point.parameters for point in points]) - fit.parameters
    within = np.tensordot(share, np.array([point.covariance for point in points]), 1)
    covariance = (share[:, None] * apart).T @ apart + within + np.diag(fit.candidate.blind(fit.parameters) ** 2)
    wider = covariance[place, place] > fit.covariance[place, place]
    return replace(fit, covariance=covariance) if wider else fit


def _outwards(fitting: Fitting, first: AtDiameter, place: int, step: float) -> Iterator[AtDiameter]:
    """Point by point, each from the one before, until twice in a row nothing likely is left."""
    best, here, unlikely = first.cost, first, 0
    for count in range(1, MOST + 1):
        here = _point(fitting, here.parameters, place, first.parameters[place] + count * step)
        yield here
        best = min(best, here.cost)
        unlikely = unlikely + 1 if here.cost > best + BARRIER else 0
        if unlikely == 2:
            break


def _point(fitting: Fitting, start: Array, place: int, held: float) -> AtDiameter:
    """The most probable φ with ln d held there; a centre a pitch further on would have touched other patches."""
    begin = start.copy()
    begin[place] = held
    here, _ = fitting.descended(begin, TRIES, held=place)
    others = np.ix_(*2 * [np.arange(len(begin)) != place])
    precision = (here.normal + np.diag(fitting.centred * 12 / fitting.panel.pitch_mm**2))[others]
    covariance = np.diag((np.arange(len(begin)) == place) * STEP**2 / 12)  # of ln d within a step
    covariance[others] = np.linalg.inv(precision)
    return AtDiameter(here.parameters, here.cost, float(np.linalg.slogdet(precision)[1] / 2), covariance)
