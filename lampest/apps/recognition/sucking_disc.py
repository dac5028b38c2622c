"""The disc of suction with its rim that explains the cells about a place under suction.

The risen cells give the place and the size with which the search begins. Cells that the disc does
not cover are free, so that a body next to a mouth does not pull at its rim.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, expm1, log, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import softmax

from lampest.apps.recognition import mouth_model
from lampest.apps.recognition.hypotheses import EVIDENCE_SHARE
from lampest.apps.recognition.mouth_model import SUCTION
from lampest.apps.recognition.observation import MostProbable, Observation, Whitening
from lampest.apps.recognition.suction import Suction, under
from lampest.files.levels import SIGNIFICANT
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.response import (
    CURVE_KPA,
    CURVE_RATIO,
    TYPICAL_RESPONSE_SD,
    PublishedResponse,
    Response,
)
from lampest.recording.shapes.disc import Disc

# A change of ln P below `settled` changes nothing that is reported.
SEARCH = LevenbergMarquardt(evaluations=12, settled=0.03)
COARSE = LevenbergMarquardt(evaluations=6, settled=0.3)
# Assumed error of a place that readings cannot reduce, mm: patches are glued by hand.
PLACE_MM = 0.5
# Alternative exponents of the published curve under suction, beside 1: ln f is known at one point
# only, through which a straight line or a threshold pass, too.
EXPONENTS = (1 / 3, 2.0)
# Of a film's response from cell to cell, over the usual deviation: films are glued and bent.
UNEVENNESS = 2.5


@dataclass(frozen=True, kw_only=True)
class BentSuction(PublishedResponse):
    """Published curve with a power law for suction through the one published point.

    ln f = 2.02·(p/−10)^exponent. A straight line of r through that point corresponds to exponents
    of ½ at −5 kPa and ⅓ at −30 kPa, a threshold of 2 kPa to one of about 2.
    """

    exponent: float

    def logarithm(self, pressure: ArrayLike) -> Array:
        """Return ln f(p) for pressures in kPa, any shape."""
        pressure = np.asarray(pressure, dtype=float)
        # ln f = ln 7.54·(p/−10)^exponent for suction
        share = np.minimum(pressure, 0.0) / CURVE_KPA[0]
        rise = np.log(CURVE_RATIO[0]) * share**self.exponent
        return np.asarray(super().logarithm(np.maximum(pressure, 0.0)) + rise)


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscPoint(SumOfSquares):
    """−ln P of a frame about a disc: squares of the readings' errors and of (φ − mean)/sd.

    Attributes
    ----------
    parameters : array, shape (parameters,)
        φ, the parameters of `mouth_model`.
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
    response : Response
        Curve of the film.
    """

    frame: Observation
    place: Suction
    patch_mm: float
    response: Response

    @cached_property
    def point(self) -> DiscPoint:
        """−ln P about the most probable φ that the search reaches."""
        return self._searched(self._coarse.parameters, self.errors, SEARCH)

    @cached_property
    def _coarse(self) -> DiscPoint:
        """The same with errors about the start of the search."""
        start = self._effect(mouth_model.start_of(self.place.disc(self.frame.panel)))
        return self._searched(start.parameters, self._errors_about(start), COARSE)

    @cached_property
    def errors(self) -> Whitening:
        """Errors of the readings about the disc of the coarse search."""
        return self._errors_about(self._coarse)

    def _searched(
        self, start: Array, whitening: Whitening, search: LevenbergMarquardt
    ) -> DiscPoint:
        """Return −ln P about the most probable φ that a search reaches with these errors."""
        panel = self.frame.panel
        mean, sd = mouth_model.mean_and_sd(panel)
        steps = np.array([prior.step for prior in mouth_model.priors(panel).values()])
        return replace(search, longest=steps).minimum(
            lambda parameters: self.at(parameters, whitening),
            start,
            (mean - SIGNIFICANT * sd, mean + SIGNIFICANT * sd),
        )[1]

    @property
    def disc(self) -> Disc:
        """The disc, without its unevenness."""
        return mouth_model.disc_of(self.point.parameters)

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

        Value and deviation are those of all curves of the film, by the law of total covariance. A
        disc that explains the frame poorly is as much less sure. The suction is log-normal.
        """
        _, sd = mouth_model.mean_and_sd(self.frame.panel)
        # with the precision of the prior, eigenvalues of sd H sd are at least 1
        sizes, axes = np.linalg.eigh(self.point.normal * np.outer(sd, sd))
        covariance = (axes / np.maximum(sizes, 1.0)) @ axes.T * np.outer(sd, sd)
        points = self._along_curves
        excess = max(1.0, self.goodness)
        shares = softmax([-EVIDENCE_SHARE / excess * point.cost for point in points])
        of_curves = np.array([point.parameters for point in points])
        mean = shares @ of_curves
        between = (shares[:, None] * (of_curves - mean)).T @ (of_curves - mean)
        blind = mouth_model.blind(mean)
        blind[:2] = PLACE_MM
        covariance = excess * covariance + between + np.diag(blind**2)
        disc, slopes = mouth_model.disc_with_slopes(mean)
        report = {
            name: (getattr(disc, name), float(np.sqrt(slope @ covariance @ slope)))
            for name, slope in zip(("x_mm", "y_mm", "diameter_mm"), slopes, strict=False)
        }
        # ln s ~ N(m, v): E s = e^(m + v/2), var s = (E s)² (e^v − 1)
        variance = covariance[SUCTION, SUCTION]
        if isinstance(self.response, PublishedResponse):
            variance += TYPICAL_RESPONSE_SD**2
        suction = exp(mean[SUCTION] + variance / 2)
        return report | {"suction_kpa": (-suction, suction * sqrt(expm1(variance)))}

    @property
    def _along_curves(self) -> list[DiscPoint]:
        """−ln P about the most probable φ, and about those with alternative curves of the film.

        With an exponent a the same rise of cells is that by the suction s_a, ln s_a = ln s₁₀ +
        (ln s − ln s₁₀)/a, where s₁₀ is the one published point.
        """
        if not isinstance(self.response, PublishedResponse):
            return [self.point]
        points = [self.point]
        for exponent in EXPONENTS:
            bent = BentSuction(
                exponent=exponent, gain=self.response.gain, gain_sd=self.response.gain_sd
            )
            start = self.point.parameters.copy()
            start[SUCTION] += (start[SUCTION] - log(-CURVE_KPA[0])) * (1 / exponent - 1)
            curved = replace(self, response=bent)
            points.append(curved._searched(start, self.errors, COARSE))
        return points

    @cached_property
    def cells(self) -> MostProbable:
        """Most probable ln r/r0 of all cells, beside the disc by the film's deviations."""
        change = self._whole(self.point)
        return self.frame.cells(change, self._film(self.point), mean=change)

    def at(self, parameters: Array, whitening: Whitening) -> DiscPoint:
        """Return −ln P about φ, with the exact circuit."""
        point = self._effect(parameters)
        network = self.frame.baseline.network(self._whole(point))
        slope = self.frame.sensitivity(network)
        both = whitening @ np.column_stack([slope @ point.slopes.T, self.frame.deviation(network)])
        mean, sd = mouth_model.mean_and_sd(self.frame.panel)
        return replace(
            point,
            residual=np.concatenate([both[:, -1], (parameters - mean) / sd]),
            jacobian=np.vstack([-both[:, :-1], np.diag(1 / sd)]),
        )

    def _effect(self, parameters: Array) -> DiscPoint:
        """Return the effect of φ on the cells."""
        pressure, by_parameter = mouth_model.pressure(self.frame.panel, self.patch_mm, parameters)
        change, response = self.frame.change(pressure, self.response)
        slopes = by_parameter.reshape(len(parameters), response.size) * response.ravel()
        none = np.zeros(0)
        return DiscPoint(none, none, parameters=parameters, own=change, slopes=slopes)

    def _whole(self, point: DiscPoint) -> Array:
        """Return ln r/r0 of the disc, and of free cells that it does not cover, (rows, columns)."""
        covered = under(self.frame.panel, mouth_model.disc_of(point.parameters))
        return np.where(covered, point.own, self.frame.free_map)

    def _film(self, point: DiscPoint) -> Array:
        """Return the covariance of ln r about `_whole`, (cells, cells).

        Its causes are deviations of the film, edges that are not where they are modelled, and free
        cells.
        """
        frame = self.frame
        covered = under(frame.panel, mouth_model.disc_of(point.parameters))
        free = np.where(covered, 0.0, np.hypot(frame.free_map, frame.free_sd)).ravel()
        # |∂x/∂mm| by a shift across an edge, a secant because tangents jump at corners of the
        # response
        pressure, by_parameter = mouth_model.pressure(frame.panel, self.patch_mm, point.parameters)
        shift = np.hypot(*by_parameter[:2])
        sizes = (
            mouth_model.pressure(frame.panel, by * self.patch_mm, point.parameters)[0]
            for by in (0.9, 1.1)
        )
        upper, lower, small, large = (
            frame.change(end, self.response)[0]
            for end in (pressure + shift, pressure - shift, *sizes)
        )
        explained = np.stack([point.own, np.abs(upper - lower) / 2, (large - small) / (1.1 - 0.9)])
        uneven, shared = frame.baseline.film_parts(explained)
        return self.scatter**2 * uneven + shared + np.diag(free**2)

    def _errors_about(self, point: DiscPoint) -> Whitening:
        """Return the errors of the readings about a disc."""
        return Whitening.about(self.frame, self._whole(point), self._film(point))
