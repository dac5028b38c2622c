"""The disc of suction with its rim that explains the cells about a place under suction.

The parameters φ of its model are x and y of the centre, the logarithms of diameter, width of the
rim, suction and push, the tilts along x and y, and the numbers of `Unevenness`. The push is the
excess of the rim's pressure over p_bear. A pressure is the mean over a patch, taken over points
with soft edges, because an elongated circle on squares has no closed form.

The risen cells give the place and the size with which the search begins. Cells that the disc does
not cover are free, so that a body next to a mouth does not pull at its rim.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, expm1, hypot, log, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from lampest.apps.recognition.most_probable import MostProbable, Whitening
from lampest.apps.recognition.observation import UNEVENNESS, Observation
from lampest.apps.recognition.suction import Suction, under
from lampest.files.levels import SIGNIFICANT
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array, Panel
from lampest.panel.response import (
    CURVE_KPA,
    TYPICAL_RESPONSE_SD,
    PublishedResponse,
)
from lampest.recording.shapes.disc import Disc, bearing_kpa

# Points along either edge of a patch, 1.2 mm apart on a patch of 6 mm. Edges of the disc are soft
# over twice this distance, as real ones are.
POINTS = 5
# Their places along and across, over the patch's edge.
ACROSS, ALONG = (np.indices((POINTS, POINTS)).reshape(2, -1) + 0.5) / POINTS - 0.5
MIN_SQUARE = 1e-6  # mm², of the distance from the centre, where the angle is undefined
# Common error of the places of both edges. Assumption: films are cut to a millimetre, and rims are
# rounded.
EDGE_MM = 1.1
STEP = 2.0**-26  # of derivatives, √ε: differences then err by rounding as by curvature
CLOSED = 0.05  # rounding of d_i/d at 0, so that it stays positive for any width of the rim
# A change of ln P below `settled` changes nothing that is reported.
SEARCH = LevenbergMarquardt(evaluations=12, settled=0.03)
COARSE = LevenbergMarquardt(evaluations=6, settled=0.3)
# Assumed error of a place that readings cannot reduce, mm: patches are glued by hand.
PLACE_MM = 0.5
# Exponents a of curves ln f ∝ suctionᵃ through the published point: the published one, nearly a
# straight line of r, and nearly a threshold of 2 kPa.
EXPONENTS = np.array([1, 1 / 3, 2])


class Unevenness(NamedTuple):
    """Relative departures of a load from a disc.

    Attributes
    ----------
    along, across : float
        Elongation: ln of the long axis over the mean diameter, along the rows, and 45° from them.
    lobe_along, lobe_across : float
        Relative amplitudes of the rim's pressure by cos 2θ and sin 2θ.
    """

    along: float = 0.0
    across: float = 0.0
    lobe_along: float = 0.0
    lobe_across: float = 0.0


EVEN = Unevenness()


class Prior(NamedTuple):
    """Gaussian prior of a parameter.

    Attributes
    ----------
    mean, sd : float
        Mean and standard deviation.
    step : float
        Longest Gauss-Newton step.
    sway : float
        Standard deviation of periodic movements of the whole load in this parameter.
    """

    mean: float
    sd: float
    step: float = 0.7
    sway: float = 0.0


# Priors of all parameters but the centre. Assumptions: 95 % of diameters are between 15 and 60 mm,
# and 95 % of rims are 3 to 10 mm wide (mouths have 4 to 7 mm, the paper's suction cup 4). They
# press with 0.02 to 110 kPa more than their suction requires: nearly nothing under a soft mouth,
# 80 kPa if bending under rim and teeth is included. 95 % of suctions are 1.8 to 35 kPa, and 95 %
# of tilts are below a half. 95 % of mouths have axes within a ratio of 1.22 and press evenly
# within ±34 % along the rim. A soft rim has more lobes than are fitted.
PRIORS = {
    "diameter": Prior(log(30), 0.35, step=0.2),
    "width": Prior(log(5.5), 0.3),
    "suction": Prior(log(8), 0.75),
    "push": Prior(log(1.5), 2.2, step=2.0),
    "tilt_x": Prior(0, 0.25, step=0.3, sway=0.1),
    "tilt_y": Prior(0, 0.25, step=0.3, sway=0.1),
    "along": Prior(0, 0.05, step=0.1),
    "across": Prior(0, 0.05, step=0.1),
    "lobe_along": Prior(0, 0.17, step=0.1),
    "lobe_across": Prior(0, 0.17, step=0.1),
}
NAMES = ("x", "y", *PRIORS)
SUCTION = NAMES.index("suction")  # place of ln of the suction in φ


def priors(panel: Panel) -> Mapping[str, Prior]:
    """Return the independent priors by the parameters' names, in the order of φ.

    Those of the centre, in mm, have the mean and variance of a uniform distribution over the panel,
    steps of half a pitch, and a sway of 1 mm.
    """
    pitch = panel.pitch_mm
    centre = {
        name: Prior((least + most) / 2, (most - least + pitch) / 12**0.5, pitch / 2, sway=1.0)
        for name, (least, most) in zip("xy", panel.extents_mm, strict=True)
    }
    return centre | PRIORS


def mean_and_sd(panel: Panel) -> tuple[Array, Array]:
    """Return the prior means and standard deviations of φ, (parameters,) each."""
    mean, sd, *_ = np.transpose([*priors(panel).values()])
    return mean, sd


def pressure(panel: Panel, patch_mm: float, parameters: Array) -> tuple[Array, Array]:
    """Return the pressure of an elongated, uneven disc.

    Returns
    -------
    pressure : array, shape (rows, columns)
        Mean pressure on the patches, kPa.
    slopes : array, shape (parameters, rows, columns)
        Derivatives of the pressure by φ, kPa, by differences.
    """
    count = len(parameters)
    steps = parameters[:, None] + STEP * np.eye(count, count + 1, 1)
    on_patches = pressure_at_places(panel.places_mm, patch_mm, numbers(steps))
    return on_patches[0], (on_patches[1:] - on_patches[0]) / STEP


def disc_of(parameters: Array) -> Disc:
    """Return the disc of φ, without its unevenness."""
    return Disc(*numbers(parameters)[: -len(EVEN)].tolist())


def numbers(parameters: Array) -> Array:
    """Return the numbers of the disc and its unevenness, (12, …), of φ (parameters, …)."""
    x, y, *logarithms, tilt_x, tilt_y = parameters[: -len(EVEN)]
    diameter, width, suction, push = np.exp(logarithms)
    # d_i/d = 1 − 2w/d, smoothly limited to positive values
    hollow = 1 - 2 * width / diameter
    share = (hollow + np.sqrt(hollow**2 + CLOSED**2)) / 2
    # p_bear = −s d_i²/(d² − d_i²)
    rim = suction * share**2 / (1 - share**2) + push
    disc = Disc(x, y, diameter, share * diameter, -suction, rim, tilt_x, tilt_y)
    return np.stack([*disc, *parameters[-len(EVEN) :]])


def start_of(disc: Disc) -> Array:
    """Return the start of a fit from a disc with a hole: φ, (parameters,)."""
    width = (disc.diameter_mm - disc.inner_mm) / 2
    bearing = bearing_kpa(disc.suction_kpa, disc.inner_mm, disc.diameter_mm)
    sizes = (
        disc.diameter_mm,
        max(min(width, 0.4 * disc.diameter_mm), 0.5),
        max(-disc.suction_kpa, 1.0),
        max(disc.rim_kpa - bearing, 0.5),
    )
    return np.array([disc.x_mm, disc.y_mm, *map(log, sizes), disc.tilt_x, disc.tilt_y, *EVEN])


def pressure_at_places(places: Array, patch_mm: float, of_load: Array) -> Array:
    """Return the mean pressure of a load on patches.

    The pressure is p = rim_kpa · (whole − hole) · (1 + tilt·(u, v)/R + lobes) + suction · hole,
    with soft indicators of disc and hole.

    Parameters
    ----------
    places : array, shape (2, …)
        x and y of the patches' centres, mm; NaN where there is none.
    patch_mm : float
        Edge of a patch.
    of_load : array, shape (12,) or (12, n)
        Numbers of `Disc` and of `Unevenness`. Those of n loads differ by steps of a derivative.

    Returns
    -------
    array, shape (1, …) or (n, …)
        kPa.
    """
    of_load = of_load.reshape(len(of_load), -1, 1, 1)
    disc = Disc(*of_load[: -len(EVEN)])
    form = Unevenness(*of_load[-len(EVEN) :])
    x_mm, y_mm, diameter, *_, along, across, _, _ = of_load[:, 0, 0, 0]
    soft = patch_mm / POINTS
    longest = 1 + abs(along) + abs(across)
    reach = diameter / 2 * longest + patch_mm / 2 + soft
    near = (np.abs(places[0] - x_mm) < reach) & (np.abs(places[1] - y_mm) < reach)
    x = places[0, near][:, None] + ALONG * patch_mm - disc.x_mm
    y = places[1, near][:, None] + ACROSS * patch_mm - disc.y_mm
    # Coordinates in which the elongated disc is round: (u, v) = ((1 − a) x − s y, (1 + a) y − s x).
    u = (1 - form.along) * x - form.across * y
    v = (1 + form.along) * y - form.across * x
    square = np.maximum(u * u + v * v, MIN_SQUARE)
    radius = np.sqrt(square)
    outer = disc.diameter_mm / 2
    hole = _inside(radius - disc.inner_mm / 2, soft) * (disc.inner_mm > 0)
    tilt = (disc.tilt_x * u + disc.tilt_y * v) / outer
    # cos 2θ and sin 2θ
    lobes = (form.lobe_along * (u * u - v * v) + form.lobe_across * 2 * u * v) / square
    rim = disc.rim_kpa * (_inside(radius - outer, soft) - hole) * (1 + tilt + lobes)
    means = np.zeros((len(u), *near.shape))
    means[:, near] = np.mean(rim + disc.suction_kpa * hole, axis=2)
    return means


def _inside(beyond: Array, soft: float) -> Array:
    """Return a soft indicator, ½ − ¾t + ¼t³ with t = beyond/soft clipped to ±1."""
    t = np.clip(beyond / soft, -1.0, 1.0)
    return np.asarray(0.5 + t * (0.25 * t * t - 0.75))


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscPoint(SumOfSquares):
    """−ln P of a frame about a disc: squares of the readings' errors and of (φ − mean)/sd.

    Attributes
    ----------
    parameters : array, shape (parameters,)
        φ, the parameters of the model.
    own : array, shape (rows, columns)
        ln r/r0 under the disc.
    slopes : array, shape (parameters, cells)
        Its derivatives by φ.
    """

    parameters: Array
    own: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class SuckingDisc:
    """The most probable disc at a place under suction.

    Attributes
    ----------
    frame : Observation
    place : Suction
    patch_mm : float
        Edge of a cell's film.
    """

    frame: Observation
    place: Suction
    patch_mm: float

    @cached_property
    def point(self) -> DiscPoint:
        """−ln P about the most probable φ that the search reaches."""
        return self._searched(self._coarse.parameters, self.errors, SEARCH)

    @cached_property
    def _coarse(self) -> DiscPoint:
        """The same with errors about the start of the search."""
        start = start_of(self.place.disc(self.frame.panel))
        return self._searched(start, self._errors_about(start), COARSE)

    @cached_property
    def errors(self) -> Whitening:
        """Errors of the readings about the disc of the coarse search."""
        return self._errors_about(self._coarse.parameters)

    def _searched(
        self, start: Array, whitening: Whitening, search: LevenbergMarquardt
    ) -> DiscPoint:
        """Return −ln P about the most probable φ that a search reaches with these errors."""
        mean, sd, steps, _ = np.transpose([*priors(self.frame.panel).values()])
        return replace(search, longest=steps).minimum(
            lambda parameters: self.at(parameters, whitening),
            start,
            (mean - SIGNIFICANT * sd, mean + SIGNIFICANT * sd),
        )[1]

    @property
    def disc(self) -> Disc:
        """The disc, without its unevenness."""
        return disc_of(self.point.parameters)

    @property
    def scatter(self) -> float:
        """Relative deviation of the film from cell to cell."""
        return UNEVENNESS * self.frame.baseline.model_errors.response

    @property
    def goodness(self) -> float:
        """χ² of a reading."""
        return 2 * self.point.cost / self.frame.measured.size

    @cached_property
    def report(self) -> dict[str, tuple[float, float]]:
        """Place, diameter and suction by their names, each with its standard deviation.

        A disc that explains the frame poorly is as much less sure. The suction is log-normal, and
        the film's curve under suction is known at one point. With an exponent a the same cells rise
        by s_a, ln s_a = ln s₁₀ + (ln s − ln s₁₀)/a. Value and deviation are those of all curves, as
        probable as the prior has s_a.
        """
        prior, sd = mean_and_sd(self.frame.panel)
        # with the precision of the prior, eigenvalues of sd H sd are at least 1
        sizes, axes = np.linalg.eigh(self.point.normal * np.outer(sd, sd))
        covariance = (axes / np.maximum(sizes, 1.0)) @ axes.T * np.outer(sd, sd)
        excess = max(1.0, self.goodness)
        variances = excess * np.diag(covariance)
        x, y, size, _, middle, *_ = self.point.parameters.tolist()
        x_sd, y_sd = np.sqrt(variances[:2] + PLACE_MM**2).tolist()
        diameter = exp(size)
        diameter_sd = hypot(diameter * sqrt(variances[2]), EDGE_MM)
        variance = variances[SUCTION]
        if isinstance(self.frame.baseline.response, PublishedResponse):
            known = log(-CURVE_KPA[0])
            of_curves = known + (middle - known) / EXPONENTS
            far = (of_curves - prior[SUCTION]) / sd[SUCTION]
            shares = softmax(-(far**2) / 2)
            middle = shares @ of_curves
            variance += shares @ (of_curves - middle) ** 2 + TYPICAL_RESPONSE_SD**2
        # ln s ~ N(m, v): E s = e^(m + v/2), var s = (E s)² (e^v − 1)
        suction = exp(middle + variance / 2)
        return {
            "x_mm": (x, x_sd),
            "y_mm": (y, y_sd),
            "diameter_mm": (diameter, diameter_sd),
            "suction_kpa": (-suction, suction * sqrt(expm1(variance))),
        }

    @cached_property
    def cells(self) -> MostProbable:
        """Most probable ln r/r0 of all cells, beside the disc by the film's deviations."""
        change, film = self._expected(self.point.parameters)
        return self.frame.cells(change, film, mean=change)

    def at(self, parameters: Array, whitening: Whitening) -> DiscPoint:
        """Return −ln P about φ, with the exact circuit."""
        frame = self.frame
        kpa, by_parameter = pressure(frame.panel, self.patch_mm, parameters)
        own, response = frame.change(kpa)
        slopes = by_parameter.reshape(len(parameters), response.size) * response.ravel()
        covered = under(frame.panel, disc_of(parameters))
        network = frame.baseline.network(np.where(covered, own, frame.free_map))
        slope = frame.sensitivity(network)
        both = whitening @ np.column_stack([slope @ slopes.T, frame.deviation(network)])
        mean, sd = mean_and_sd(frame.panel)
        return DiscPoint(
            residual=np.concatenate([both[:, -1], (parameters - mean) / sd]),
            jacobian=np.vstack([-both[:, :-1], np.diag(1 / sd)]),
            parameters=parameters,
            own=own,
            slopes=slopes,
        )

    def _expected(self, parameters: Array) -> tuple[Array, Array]:
        """Return ln r/r0 of the disc and of free cells beside it, and its covariance.

        The causes of the covariance are deviations of the film, edges that are not where they are
        modelled, and free cells. The shapes are (rows, columns) and (cells, cells).
        """
        frame = self.frame
        covered = under(frame.panel, disc_of(parameters))
        free = np.where(covered, 0.0, np.hypot(frame.free_map, frame.free_sd)).ravel()
        # |∂x/∂mm| by a shift across an edge, a secant because tangents jump at corners of the
        # response
        kpa, by_parameter = pressure(frame.panel, self.patch_mm, parameters)
        shift = np.hypot(*by_parameter[:2])
        sizes = (
            pressure_at_places(frame.panel.places_mm, by * self.patch_mm, numbers(parameters))[0]
            for by in (0.9, 1.1)
        )
        own, upper, lower, small, large = (
            frame.change(end)[0] for end in (kpa, kpa + shift, kpa - shift, *sizes)
        )
        explained = np.stack([own, np.abs(upper - lower) / 2, (large - small) / (1.1 - 0.9)])
        uneven, shared = frame.baseline.film_parts(explained)
        film = self.scatter**2 * uneven + shared + np.diag(free**2)
        return np.where(covered, own, frame.free_map), film

    def _errors_about(self, parameters: Array) -> Whitening:
        """Return the errors of the readings about a disc."""
        return self.frame.whitening(*self._expected(parameters))
