"""Swings of a load, and their effects on readings: of its suction, its rim, its place and its tilt.

Changes of suction and rim are proportional to the slopes ∂x/∂ln p of the cells on the film's
response. The slopes are uncertain, because gains differ from cell to cell and the curve under
suction has one measured point. `Patterns` holds the effect of each cause as a root of its
covariance at unit amplitude.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from lampest.apps.recognition.detector import Verdict
from lampest.apps.recognition.hypotheses import BREATH, BREATHING_SD
from lampest.apps.recognition.mouth_model import priors
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.suction import MIN_FALL
from lampest.files.levels import NOISE_REACH
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.response import CURVE_KPA, CURVE_RATIO, PublishedResponse

# Assumed relative standard deviation of the whole rim's swing against that of suction, because the
# rim may press with more than it bears; and of each cell's change by a movement, because the places
# of edges on its film are unknown.
EDGE_SD = 0.5
# Assumed: of each cell's swing with the suction, over the root mean square of all cells; and of the
# depth of breath, by a curve under suction that was not measured.
OWN_SD = 0.1
CURVE_SD = 0.27
# Suction from which an alternative curve through the published point may begin, instead of 0 kPa.
THRESHOLD_KPA = -2.0
WAVE_KPA = 0.2  # pressure of a wave, by which slopes are taken
# Distances of a body's cells to the nearest of a load, in pitches, at which it may move the rim.
# Nearer ones may be of the rim itself.
ADJOINS_PITCHES = (1.5, 3.2)


class Patterns(NamedTuple):
    """Effects of swings on whitened readings, (readings, n) each.

    Every array is a root of the effects' covariance at unit amplitude.

    Attributes
    ----------
    own : array
        Suction with its rim: the first column is the mean effect, the others are possible
        deviations of the film.
    rim : array
        The rim alone.
    moves : array
        Place and tilt of the load.
    others : array
        Further changes of any size, which are projected out.
    beside : array
        Cells that neither the load nor `others` contain, each by itself; none in `of`.
    curve : float
        Relative standard deviation of the depth by a curve under suction that was not measured.
    adjoining : array
        The part of `others` by loads and bodies that adjoin the load and may move its rim; none in
        `of`.
    """

    own: Array
    rim: Array
    moves: Array
    others: Array
    beside: Array
    adjoining: Array
    curve: float = 0.0

    @classmethod
    def of(
        cls,
        by_cell: Array,
        rise: Array,
        slopes: Array,
        spread: Array,
        moves: Array,
        others: Array,
        *,
        curve: float = 0.0,
    ) -> "Patterns":
        """Return the patterns of a load.

        Parameters
        ----------
        by_cell : array, shape (readings, cells)
            Derivatives of the whitened readings by ln r.
        rise : array, shape (cells,)
            ln r/r0, negative under the rim.
        slopes : array, shape (1 + n, cells)
            Mean of ∂(ln r/r0)/∂ln p, and n common deviations of it.
        spread : array, shape (cells,)
            Standard deviation of each cell's own slope.
        moves : array, shape (moves, cells)
            Changes of ln r/r0 by movements of usual size.
        others : array, shape (readings, m)
            Further changes.
        curve : float
        """
        mean = slopes[0]
        rim = rise < 0
        spread = np.hypot(spread, OWN_SD * np.sqrt(np.mean(mean**2)))
        suction = np.column_stack([mean, EDGE_SD * rim * mean, slopes[1:].T, np.diag(spread)])
        rigid = np.delete(suction, 1, axis=1) * rim[:, None]
        changes = np.linalg.norm(moves, axis=0)
        moving = np.column_stack(
            [moves.T, np.diag(EDGE_SD * np.hypot(changes, np.sqrt(np.mean(changes**2))))]
        )
        none = np.zeros((len(by_cell), 0))
        return cls(by_cell @ suction, by_cell @ rigid, by_cell @ moving, others, none, none, curve)

    def beside_others(self, changes: Array) -> tuple["Patterns", Array]:
        """Project patterns and changes (frames, readings) on the complement of `others`.

        Returns
        -------
        patterns : Patterns
        changes : array, shape (frames, readings)
        """
        span = np.linalg.qr(self.others)[0]
        projection = np.eye(len(span)) - span @ span.T
        return self.whitened(projection), changes @ projection

    def whitened(self, whitening: Array) -> "Patterns":
        """Return the patterns of readings that a matrix (readings, readings) combines once more."""
        roots = ("own", "rim", "moves", "others", "beside")
        return self._replace(**{name: whitening @ getattr(self, name) for name in roots})

    def weights(self, depth: float, noise: float, moving: float = 0.0) -> Array:
        """Return the weights (readings,) with which readings sum to the amplitude of suction.

        The sum has the least variance.

        Parameters
        ----------
        depth : float
            Amplitude at which the film's deviations are taken.
        noise : float
            Variance of each reading.
        moving : float
            Standard deviation of simultaneous changes of the rim alone, the place and the tilt.
        """
        mean = self.own[:, 0]
        film = np.hstack([depth * self.own[:, 1:], moving * self.rim, moving * self.moves])
        # w = C⁻¹ m/(mᵀ C⁻¹ m), with C = noise + F Fᵀ of the film's deviations and movements
        weighed = np.linalg.solve(noise * np.eye(len(mean)) + film @ film.T, mean)
        return weighed / max(float(mean @ weighed), 1e-300)

    def suction_weights(self, whitening: Array) -> Array:
        """Return the weights (readings,) for the relative change of the load's suction.

        With them changes of ln y sum to it. Changes common to all readings and those of other loads
        are excluded; those of the load's place and of its rim alone have little weight. `whitening`
        (readings, readings) whitens changes of ln y.
        """
        suction, _ = self.beside_others(np.zeros((1, len(whitening))))
        return whitening.T @ suction.weights(BREATH.largest, 1.0, EDGE_SD)


def patterns_of(verdict: Verdict, whitening: Array) -> list[Patterns]:
    """Return the patterns of every load that sucks.

    Parameters
    ----------
    verdict : Verdict
    whitening : array, shape (readings, readings)
        Whitens changes of ln y.
    """
    frame = verdict.frame
    panel = frame.panel
    # cells of other loads, and of bodies beside, which move by themselves
    changed = (verdict.change != 0) | (
        np.abs(frame.free_map) > np.maximum(MIN_FALL, NOISE_REACH * frame.free_sd)
    )
    sways = np.array([prior.sway for prior in priors(panel).values()])
    patterns = list[Patterns]()
    response = frame.baseline.response
    curve = CURVE_SD if isinstance(response, PublishedResponse) else 0.0
    at_rest = response.logarithm(frame.water)
    for disc in verdict.discs:
        cells = disc.cells
        rise = cells.state.reshape(panel.shape)
        by_cell = whitening @ (frame.slope(rise) / frame.measured.ravel()[:, None])
        slopes = _slopes(frame, rise, disc.scatter)
        own_sd = np.hypot(disc.scatter, np.sqrt(np.diag(cells.covariance)))
        spread = np.hypot(np.hypot.reduce(slopes[1:-1]), slopes[0] * own_sd)
        # ∂(ln r/r0)/∂p of all cells, 1/kPa: waves press on all alike
        pressure = response.pressure(rise / response.gains + at_rest)
        more, less = (response.logarithm(pressure + by) for by in (WAVE_KPA, -WAVE_KPA))
        by_water = response.gains * (more - less) / (2 * WAVE_KPA)
        under = (disc.point.own != 0).ravel()
        beside = changed.ravel() & ~under
        moves = (sways[:, None] * disc.point.slopes[:, under])[sways > 0]
        pattern = Patterns.of(
            by_cell=by_cell[:, under],
            rise=rise.ravel()[under],
            slopes=slopes[:, under],
            spread=spread[under],
            moves=moves,
            others=np.column_stack(
                [whitening.sum(axis=1), by_cell[:, beside], by_cell @ by_water.ravel()]
            ),
            curve=curve,
        )
        patterns.append(
            pattern._replace(
                beside=by_cell[:, ~(under | beside)],
                adjoining=by_cell[:, beside & adjoin(panel, beside, under)],
            )
        )
    return patterns


def adjoin(panel: Panel, body: Mask, load: Mask) -> bool:
    """Return whether one of a body's cells, (cells,), is within ADJOINS_PITCHES of a load's."""
    x, y = (line.ravel() / panel.pitch_mm for line in panel.places_mm)
    distance = np.hypot(x[body, None] - x[load], y[body, None] - y[load])
    nearest = np.fmin.reduce(distance, axis=1, initial=np.inf)
    least, most = ADJOINS_PITCHES
    return bool(np.any((nearest > least) & (nearest < most)))


def _slopes(frame: Observation, rise: Array, scatter: float) -> Array:
    """Return ∂x/∂ln p of cells at x = `rise`, (7, cells).

    The rows are the mean, five deviations by the gain, and one by the curve. The gain differs by
    `scatter` and by bending; its distribution is sampled at Gauss-Hermite points. The published
    curve has one point under suction: a straight line of r, and an exponential beyond a threshold,
    are each one standard deviation from their geometric mean.
    """
    response = frame.baseline.response
    water = frame.water
    points, weights = hermegauss(5)
    gains = response.gains * np.exp(
        np.hypot(scatter, frame.baseline.model_errors.bent) * points[:, None, None]
    )
    logarithm = rise / gains + response.logarithm(water)
    pressure = response.pressure(logarithm) - water
    more, lower = (
        response.logarithm(water + by * pressure) for by in (1 + BREATHING_SD, 1 - BREATHING_SD)
    )
    rise = np.maximum(logarithm, 0.1)
    delay = np.log(CURVE_RATIO[0]) / (CURVE_KPA[0] / THRESHOLD_KPA - 1)
    straight = np.log(-np.expm1(-rise) / rise)
    delayed = np.log1p(delay / rise)
    unknown = (logarithm > 0) & isinstance(response, PublishedResponse)
    middle = unknown * (delayed + straight) / 2
    curve = unknown * (delayed - straight) / 2
    slopes = (gains * (more - lower) / (2 * BREATHING_SD) * np.exp(middle)).reshape(len(points), -1)
    shares = weights / weights.sum()
    mean = shares @ slopes
    common = shares @ (slopes * curve.reshape(slopes.shape))
    return np.vstack([mean, np.sqrt(shares)[:, None] * (slopes - mean), common])
