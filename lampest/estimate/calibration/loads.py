"""Calibration of the film with known loads.

It gives a common response curve and each cell's gain, with a hierarchical prior.

    ln(r/r0)_li = −κ_i Σ_k e^{ψ_k} a_lik + noise,
    ln κ_i ~ N(0, spread²),    ψ_{k+1} − ψ_k ~ N(0, STEP_SD²)

for cell i under load l. a_lik is the decrease of the base curve within the k-th interval of
pressures, and e^ψ_k the steepness there relative to the base, so that the curve decreases for any
ψ. The noise has three parts: that of the estimate, that of the load's position, and
scatter·|ln(r/r0)| from load to load. Spread and scatter maximise the evidence. A cell that no load
has touched has the common curve and the spread.
Source of calibration by one load that is moved: arXiv 2404.15131.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.cost.terms import Misfit
from lampest.estimate.calibration import MIN_SAMPLE, Calibration, common_scene
from lampest.estimate.calibration.known_loads import KnownLoad, KnownLoads
from lampest.estimate.estimates import log_change
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError, first_and_more
from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANT, UNUSUAL
from lampest.loads.pressure import water_pressure
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, Response, TableResponse
from lampest.recording.recording import Recording

# Scatter from load to load, relative: that of films is a tenth, with hysteresis a quarter.
MAX_SCATTER = 0.6
ALIKE = 0.02  # least scatter of ln of a response: the best repeatability of films
# Ln of the ratio to the first guess: beyond two standard deviations of its prior, units may be
# wrong.
UNLIKE = 2.0
UNITS = "is mass_g in gram, force_newton in newton, and diameter_mm the diameter in mm?"
# of a load's response: change within its frames, and response of cells beside its foot
CHANGED = 0.25
BESIDE = 0.5
# Ends of the intervals, kPa: thirds of octaves. Within an interval the curve has the form of the
# base.
ENDS = np.unique(np.outer((-1, 0, 1), 0.5 * 2.0 ** (np.arange(19) / 3)))
# Assumed standard deviation of ψ from one interval to the next; that of the level of ψ is 1. The
# published curve has a corner at 2.5 kPa, beyond which its slope is twelve times smaller, and other
# films have none.
STEP_SD = 0.6
# initial spread and scatter, relative, and their limits
START = (0.2, 0.05)
RANGE = (1e-3, 2.0)
LONGEST_STEP = 3.0  # of ln κ and ψ in a step of least squares: units of g for kg are ln 1000 = 7
ROUNDS = 4  # alternations of least squares and evidence
# points of the table in an octave, and the one next to 0 kPa
PER_OCTAVE = 3
MIN_KPA = 0.25
UNLOADED_OHM = 1000.0  # first resistance of the table; only ratios count


@dataclass(frozen=True, eq=False)
class Loaded:
    """Responses of all cells to all loads; n of them are known and felt a load.

    Attributes
    ----------
    change, sd : array, shape (loads, cells)
        ln(r/r0) and its standard deviation; NaN where unknown.
    pressure, pressure_sd : array, shape (loads, cells)
        Pressure of the load and its standard deviation by the load's position, kPa.
    water : array, shape (cells,)
        Pressure of the water, kPa.
    base : Response
        Base curve; the estimate is a multiple of it in each interval.
    """

    change: Array
    sd: Array
    pressure: Array
    pressure_sd: Array
    water: Array
    base: Response = PUBLISHED

    @cached_property
    def felt(self) -> tuple[NDArray[np.intp], ...]:
        """Numbers of the load and of the cell of each response, (n,)."""
        touched = (self.pressure != 0) | (self.pressure_sd > 0)
        return np.nonzero(touched & np.isfinite(self.change) & np.isfinite(self.sd))

    @cached_property
    def falls(self) -> tuple[Array, Array]:
        """a, (loads, cells, pieces), and its standard deviation by the load's position."""
        on_film = (
            self.pressure
            + self.water
            + np.array([0.0, 1.0, -1.0])[:, None, None] * self.pressure_sd
        )
        middle, upper, lower = _falls(on_film, self.base) - _falls(self.water, self.base)
        return middle, (upper - lower) / 2

    def expected(self, fitted: "FittedResponse") -> tuple[Array, Array]:
        """Return x, the expected ln(r/r0), and the variance, (n,) each.

        The variance is that by the estimate and the load's position.
        """
        response, position = (fitted.parts(part).sum(axis=-1)[self.felt] for part in self.falls)
        return response, self.sd[self.felt] ** 2 + position**2

    def weight(self, fitted: "FittedResponse") -> Array:
        """Return 1/σ of every response, (n,), with σ² = sd² + position² + scatter² x²."""
        response, known = self.expected(fitted)
        return np.asarray(1 / np.sqrt(known + fitted.scatter**2 * response**2))

    def rows(self, fitted: "FittedResponse", weight: Array) -> tuple[Array, Array]:
        """Return the residuals of a fit times the weight, and their Jacobian.

        They are (n,) and (n, cells + pieces).
        """
        parts = weight[:, None] * fitted.parts(self.falls[0])[self.felt]
        response = parts.sum(axis=1)
        by_gain = np.where(
            self.felt[1][:, None] == np.arange(len(fitted.gains)), response[:, None], 0.0
        )
        return response - weight * self.change[self.felt], np.hstack([by_gain, parts])


def _falls(pressure: Array, base: Response) -> Array:
    """Return −ln f_base(p) split into intervals, (..., pieces).

    It has the sign of the pressure (...) kPa.
    """
    fallen = -base.logarithm(pressure)[..., None]
    ends = np.concatenate([[-np.inf], -base.logarithm(ENDS), [np.inf]])
    return np.asarray(np.clip(fallen, ends[:-1], ends[1:]) - np.clip(0.0, ends[:-1], ends[1:]))


@dataclass(frozen=True, eq=False)
class FittedResponse:
    """Fitted curve and gains.

    Attributes
    ----------
    state : array, shape (cells + pieces,)
        ln κ and ψ.
    covariance : array, shape (cells + pieces, cells + pieces)
    spread, scatter : float
        Relative standard deviations of the gains, and of a cell's response from load to load.
    touched : boolean array, shape (cells,)
        Cells that felt a load.
    """

    state: Array
    covariance: Array
    spread: float
    scatter: float
    touched: NDArray[np.bool_]

    @property
    def gains(self) -> Array:
        """ln κ, (cells,)."""
        return self.state[: len(self.touched)]

    @property
    def pieces(self) -> Array:
        """ψ, (pieces,)."""
        return self.state[len(self.touched) :]

    @property
    def _mean(self) -> Array:
        """Weights (cells + pieces,) of the mean of ln κ over touched cells.

        The mean belongs to the curve.
        """
        return np.concatenate([self.touched / self.touched.sum(), np.zeros(len(self.pieces))])

    def parts(self, falls: Array) -> Array:
        """Return the summands −κ_i e^{ψ_k} a_ik of ln(r/r0), (..., cells, pieces).

        They are its slopes by ψ, too.
        """
        return np.asarray(-falls * np.exp(self.gains[:, None] + self.pieces))

    def gain(self) -> tuple[Array, Array]:
        """Return κ over its mean and its relative standard deviation, (cells,) each.

        Scatter is included in the deviation.
        """
        centred = np.eye(len(self.gains), len(self.state)) - self._mean
        # var(ln κ_i − mean ln κ) = (e_i − m)ᵀ P (e_i − m)
        variance = np.einsum("ij,jk,ik->i", centred, self.covariance, centred)
        return np.exp(centred @ self.state), np.sqrt(variance + self.scatter**2)

    def curve(self, pressure: Array, base: Response = PUBLISHED) -> tuple[Array, Array]:
        """Return ln f and its relative standard deviation at nonzero pressures (n,) kPa."""
        parts = _falls(pressure, base) * np.exp(self.pieces)
        total = parts.sum(axis=1)
        # ∂ln|ln f|/∂(ln κ, ψ): the share of each interval, and the mean gain
        slopes = (
            np.hstack([np.zeros((len(pressure), len(self.gains))), parts / total[:, None]])
            + self._mean
        )
        sd = np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes))
        return -total * np.exp(float(self._mean @ self.state)), sd


def fit_loads(loaded: Loaded) -> FittedResponse:
    """Return the least-squares fit with the spread and scatter that maximise the evidence.

    It is found by alternation.
    """
    cells = loaded.change.shape[1]
    touched = np.isin(np.arange(cells), loaded.felt[1])
    fitted = FittedResponse(np.zeros(cells + len(ENDS) + 1), np.zeros((0, 0)), *START, touched)
    for _ in range(ROUNDS):
        fitted = with_evidence(loaded, with_least_squares(loaded, fitted))
    return with_least_squares(loaded, fitted)


def with_least_squares(loaded: Loaded, fitted: FittedResponse) -> FittedResponse:
    """Return the least-squares fit with the spread, scatter and weights of the previous fit."""
    cells = len(fitted.gains)
    pieces = len(fitted.pieces)
    weight = loaded.weight(fitted)
    # rows of the prior: ln κ/spread, (ψ_{k+1} − ψ_k)/STEP_SD, and ψ of the interval next to 0 kPa
    # with σ = 1
    level = (np.arange(pieces) == np.searchsorted(ENDS, 0.0) + 1)[None]
    walk = np.vstack([np.diff(np.eye(pieces), axis=0) / STEP_SD, level])
    prior = scipy.linalg.block_diag(np.eye(cells) / fitted.spread, walk)

    def model(state: Array) -> SumOfSquares:
        residual, slopes = loaded.rows(replace(fitted, state=state), weight)
        return SumOfSquares(np.concatenate([residual, prior @ state]), np.vstack([slopes, prior]))

    state, squares = LevenbergMarquardt(
        evaluations=100, settled=1e-9, longest=LONGEST_STEP
    ).minimum(model, fitted.state)
    return replace(fitted, state=state, covariance=np.linalg.inv(squares.normal))


def with_evidence(loaded: Loaded, fitted: FittedResponse) -> FittedResponse:
    """Return the fit with the spread and scatter that maximise the evidence.

    They are found by the Nelder-Mead method. The residuals of each cell, without its own gain, are
    N(0, V + spread² x xᵀ) with a diagonal V.
    """
    response, known = loaded.expected(fitted)
    cell = loaded.felt[1]
    residual = loaded.change[loaded.felt] - response + response * fitted.gains[cell]

    def cost(logarithms: Array) -> float:
        spread, scatter = np.exp(np.clip(logarithms, *np.log(RANGE)))
        variance = known + scatter**2 * response**2
        # −2 ln N of each cell by Woodbury: Σ e²/V − (Σ x e/V)²/(spread⁻² + Σ x²/V) + Σ ln V + ln(1
        # + spread² Σ x²/V)
        most, shared = (
            np.bincount(cell, response * part / variance, len(fitted.gains))
            for part in (response, residual)
        )
        volume = np.log(variance).sum() + np.log1p(spread**2 * most).sum()
        # A single cell does not determine the spread; the last summand keeps it finite.
        return float(
            (residual**2 / variance).sum()
            - (shared**2 / (1 / spread**2 + most)).sum()
            + volume
            + spread
        )

    minimum = scipy.optimize.minimize(
        cost, np.log([fitted.spread, fitted.scatter]), method="Nelder-Mead"
    )
    spread, scatter = np.exp(np.clip(minimum.x, *np.log(RANGE))).tolist()
    return replace(fitted, spread=spread, scatter=scatter)


def deviations_from_others(loaded: Loaded, fitted: FittedResponse) -> Array:
    """Return ln of each load's response over its prediction from all other loads, (loads,).

    NaN where undetermined. It is the median over the load's cells, without those at the edge of the
    foot, whose response depends on the position. The fit without a load is one Newton step from the
    fit with all loads, δ = C Jᵀ (I − J C Jᵀ)⁻¹ f, with the Jacobian J and the residuals f of this
    load, and the covariance C of the state.
    """
    deviations = np.full(len(loaded.change), np.nan)
    load, cell = loaded.felt
    residual, slopes = loaded.rows(fitted, loaded.weight(fitted))
    for number, change in enumerate(loaded.change):
        of_load = load == number
        gain = fitted.covariance @ slopes[of_load].T
        step = gain @ np.linalg.solve(
            np.eye(of_load.sum()) - slopes[of_load] @ gain, residual[of_load]
        )
        expected = (
            replace(fitted, state=fitted.state + step).parts(loaded.falls[0][number]).sum(axis=1)
        )
        elsewhere = np.isin(np.arange(len(change)), cell[~of_load])
        cells = elsewhere & (loaded.pressure[number] != 0) & (change * expected > 0)
        if cells.any():
            place = loaded.pressure_sd[number] / np.where(
                cells, np.abs(loaded.pressure[number]), 1.0
            )
            cells &= place <= np.median(place[cells])
            deviations[number] = float(np.median(np.log(change[cells] / expected[cells])))
    return deviations


def response_of(
    fitted: FittedResponse, base: Response, shape: tuple[int, int], tolerance: float
) -> TableResponse:
    """Return the fit as a table with points densest about 0 kPa, and gains (rows, columns).

    Parameters
    ----------
    fitted : FittedResponse
    base : Response
    shape : (int, int)
        Rows and columns.
    tolerance : float
        Largest relative error that all loads share, uniformly distributed: its standard deviation
        is tolerance/√3.
    """
    # Points from MIN_KPA on in equal ratios, on both sides of 0 kPa; a range below MIN_KPA has its
    # end alone.
    falling, rising = (
        np.geomspace(
            min(MIN_KPA, most), most, 1 + max(0, int(np.ceil(PER_OCTAVE * np.log2(most / MIN_KPA))))
        )
        if most > 0
        else np.zeros(0)
        for most in (-base.told_kpa[0], base.told_kpa[1])
    )
    pressure = np.concatenate([-falling[::-1], rising])
    zero = len(falling)
    logarithm, sd = fitted.curve(pressure, base)
    sd = np.insert(sd, zero, np.interp(0.0, pressure, sd))
    gain, gain_sd = (
        tuple(_significant(row, 4) for row in part.reshape(shape)) for part in fitted.gain()
    )
    return TableResponse(
        pressure_kpa=_significant(np.insert(pressure, zero, 0.0)),
        resistance_ohm=_significant(UNLOADED_OHM * np.exp(np.insert(logarithm, zero, 0.0))),
        sd=_significant(np.hypot(sd, tolerance / np.sqrt(3)), 3),
        gain=gain,
        gain_sd=gain_sd,
    )


def _significant(values: Array, digits: int = 6) -> tuple[float, ...]:
    return tuple(float(f"{value:.{digits}g}") for value in values)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadCalibration(Calibration):
    """Result of a calibration with known loads.

    Attributes
    ----------
    fitted : FittedResponse
        The curve and gains from which the scene's response was made.
    """

    fitted: FittedResponse


def calibrate_loads(
    recordings: Sequence[Recording], known: KnownLoads, tolerance: float
) -> LoadCalibration:
    """Estimate the curve and gains that explain known loads best.

    Raises InputError where loads and recordings are inconsistent, or no film has such a response.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one scene, unloaded frames included.
    known : KnownLoads
    tolerance : float
        Largest relative error that all loads share.
    """
    scene = common_scene(recordings)
    loads = known.loads
    place = _places([recording.name for recording in recordings], loads)
    change, sd, within = _all_responses(recordings, loads, place)
    pressure, pressure_sd = known.pressures(scene.panel)
    felt = pressure != 0
    simultaneous = _together(loads, place)
    _check_feet(felt, simultaneous)
    base = scene.response or PUBLISHED
    water = water_pressure(scene.panel, scene.water)
    flat = [values.reshape(len(loads), -1) for values in (change, sd, pressure, pressure_sd)]
    loaded = Loaded(flat[0], flat[1], flat[2], flat[3], water.ravel(), base)
    fitted = _explaining_fit(loaded)
    try:
        with np.errstate(over="ignore"):
            response = response_of(fitted, base, scene.panel.shape, tolerance)
    except ValueError as error:
        raise InputError(f"the loads make a curve that no film has: {UNITS}") from error
    concerned = {
        "{} answers otherwise than the others let expect: is its weight right?": _odd_loads(
            loaded, fitted
        ),
        "readings change within the frames of {}: were they put on or taken off then?": within
        > CHANGED,
        "cells beside the foot of {} answer as those under it: are places, frames and diameter_mm "
        "right?": (_beside(change, felt, pressure_sd, simultaneous) > BESIDE),
    }
    doubts = [_unlike_first_guess(fitted, pressure, base)]
    doubts += [_doubt(sentence, odd) for sentence, odd in concerned.items()]
    summary, *remarks = _result_in_words(fitted, len(loads))
    return LoadCalibration(
        scene=replace(scene, response=response),
        summary=summary,
        remarks=(summary, *remarks),
        warnings=tuple(filter(None, doubts)),
        fitted=fitted,
    )


def _all_responses(
    recordings: Sequence[Recording], loads: Sequence[KnownLoad], place: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Return the responses to all loads, as `_responses` does.

    `place` is the recording of each load, (loads,).
    """
    change, sd = np.empty((2, len(loads), *recordings[0].scene.panel.shape))
    within = np.empty(len(loads))
    for index in np.unique(place):
        own = np.flatnonzero(place == index)
        change[own], sd[own], within[own] = _responses(
            recordings[index], [loads[number] for number in own.tolist()]
        )
    return change, sd, within


def _check_feet(felt: NDArray[np.bool_], simultaneous: NDArray[np.bool_]) -> None:
    """Raise InputError unless every load lies on a cell.

    Raise it also if two lie on the same cell at the same time.

    Parameters
    ----------
    felt : boolean array, shape (loads, rows, columns)
        Whether a load lies on a cell.
    simultaneous : boolean array, shape (loads, loads)
    """
    for number in np.flatnonzero(~felt.any(axis=(1, 2))):
        raise InputError(f"load {number + 1}: its foot misses the film of every cell")
    common = np.any(felt[:, None] & felt, axis=(2, 3))
    for first, second in 1 + np.argwhere(np.triu(simultaneous & common, 1)):
        raise InputError(
            f"loads {first} and {second} lie on the same cells in the same frames: give one line"
        )


def _explaining_fit(loaded: Loaded) -> FittedResponse:
    """Return the fit of curve and gains.

    Raises InputError if the loads do not explain the cells.
    """
    fitted = fit_loads(loaded)
    if not fitted.touched.any():
        raise InputError(
            "no cell under a load has an estimate with error bars: is the readout's noise in the "
            "scene?"
        )
    if fitted.scatter > MAX_SCATTER:
        raise InputError(
            f"the loads do not explain the cells: answers scatter by {100 * fitted.scatter:.0f} % "
            "about any common "
            "curve; are frames, places (x along columns, y along rows) and weights right?"
        )
    return fitted


def _doubt(sentence: str, odd: NDArray[np.bool_]) -> str:
    """Return the sentence on the loads that are odd, (loads,); '' without any."""
    if not odd.any():
        return ""
    numbers = (np.flatnonzero(odd) + 1).tolist()
    return sentence.format(f"load{'s' if len(numbers) > 1 else ''} {first_and_more(numbers)}")


def _together(loads: Sequence[KnownLoad], place: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether two loads lie on the panel at the same time, (loads, loads).

    `place` are their recordings.
    """
    begin, end = np.array([load.frames for load in loads]).T
    overlap = np.maximum(begin[:, None], begin) <= np.minimum(end[:, None], end)
    return np.asarray((place[:, None] == place) & overlap)


def _result_in_words(fitted: FittedResponse, loads: int) -> Iterator[str]:
    """Yield the summary of a fit to a number of loads, and remarks on its numbers."""
    touched = fitted.touched.sum()
    blank = (~fitted.touched).sum()
    yield (
        f"response from {loads} loads on {touched} of {fitted.touched.size} cells: gains spread by "
        f"{100 * fitted.spread:.1f} %, a cell answers alike within {100 * fitted.scatter:.1f} %"
    )
    yield (
        "response.sd: relative standard deviation of ln(r/r0), of all cells alike; "
        "response.gain_sd: of each cell"
    )
    if blank:
        yield f"{blank} cells felt no load: they have the common curve and the spread"


def _odd_loads(loaded: Loaded, fitted: FittedResponse) -> NDArray[np.bool_]:
    """Return whether each load's response deviates far more than usual, (loads,).

    The deviation is that from the fit to all others.
    """
    deviation = deviations_from_others(loaded, fitted)
    if len(deviation) < MIN_SAMPLE or np.isnan(deviation).all():
        return np.zeros(len(deviation), dtype=bool)
    deviation -= np.nanmedian(deviation)
    usual = MAD_TO_SIGMA * float(np.nanmedian(np.abs(deviation)))
    return np.asarray(np.nan_to_num(np.abs(deviation)) > UNUSUAL * max(usual, ALIKE))


def _unlike_first_guess(fitted: FittedResponse, pressure: Array, base: Response) -> str:
    """Return a warning of a response far from the first guess, or of loads beyond its range.

    It is '' where neither holds.
    """
    middle = np.array([float(np.median(np.abs(pressure[pressure != 0])))])
    most = max(map(abs, base.told_kpa))
    if middle[0] > most:
        return (
            f"half of the loads press with more than {most:.3g} kPa, beyond what the first "
            f"guess knows: {UNITS}"
        )
    ratio = fitted.curve(middle, base)[0][0] / float(base.logarithm(middle)[0])
    if abs(np.log(ratio)) <= UNLIKE:
        return ""
    times = f"{ratio:.2g} times as much" if ratio > 1 else f"{1 / ratio:.2g} times less"
    return f"at {middle[0]:.3g} kPa the film answers {times} than the first guess: {UNITS}"


def _beside(
    change: Array, felt: NDArray[np.bool_], pressure_sd: Array, simultaneous: NDArray[np.bool_]
) -> Array:
    """Return the largest response beside each foot over the median under it, (loads,).

    The ratio is 0 without cells.

    Parameters
    ----------
    change : array, shape (loads, rows, columns)
        ln(r/r0).
    felt : boolean array, same shape
        Cells under the load.
    pressure_sd : array, same shape
        Standard deviation of the pressure by the position, kPa.
    together : boolean array, shape (loads, loads)
        Whether two loads lie on the panel at the same time.
    """
    ratio = np.zeros(len(change))
    for number, same in enumerate(simultaneous):
        free = (~felt[same] & (pressure_sd[same] == 0)).all(axis=0)
        under = np.nanmedian(np.abs(change[number][felt[number]]))
        if free.any() and under > 0:
            ratio[number] = float(np.nanmax(np.abs(change[number][free]))) / under
    return ratio


def _places(names: Sequence[str], loads: Sequence[KnownLoad]) -> NDArray[np.intp]:
    """Return the index of each load's recording, (loads,).

    Raises InputError where it is ambiguous or unknown.
    """
    places = []
    for number, load in enumerate(loads):
        name = load.recording.removesuffix(".h5")
        if not name and len(names) > 1:
            raise InputError(
                f"load {number + 1}: with {len(names)} recordings it must name its own"
            )
        if name and names.count(name) != 1:
            raise InputError(
                f"load {number + 1}: there is no recording {name} among {', '.join(names)}"
            )
        places.append(names.index(name) if name else 0)
    return np.array(places, dtype=np.intp)


def _responses(recording: Recording, loads: Sequence[KnownLoad]) -> Iterator[Array]:
    """Return the mean response to each load, its standard deviation, and its relative change.

    The change is that within the frames. The first two are ln(r/r0), (loads, rows, columns), the
    last is (loads,).
    """
    for load in loads:
        if load.frames[1] >= len(recording.role):
            raise InputError(
                f"{recording.name}: there is no frame {load.frames[1]}, its frames are 0 to "
                f"{len(recording.role) - 1}"
            )
    estimates = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    known = log_change(estimates)
    if known is None:
        raise InputError(
            f"{recording.name}: its estimates have no error bars, without which loads calibrate "
            "nothing; the "
            "scene must name the readout, and the panel have at most 600 cells"
        )
    logarithm, sd = known
    parts = []
    if estimates.film is not None and estimates.film.film.creep_per_decade:
        logarithm, open_sd = estimates.film.at_once(logarithm, estimates.time)
        sd = np.hypot(sd, open_sd)
    for load in loads:
        inside = (estimates.frame >= load.frames[0]) & (estimates.frame <= load.frames[1])
        if inside.sum() < load.frames[1] - load.frames[0] + 1:
            raise InputError(
                f"{recording.name}: frames {load.frames[0]} to {load.frames[1]} hold unloaded ones"
            )
        solved = inside & np.isfinite(logarithm).all(axis=(1, 2))
        if not solved.any():
            raise InputError(
                f"{recording.name}: no frame from {load.frames[0]} to {load.frames[1]} was solved"
            )
        # The error bars contain errors that frames share, so the mean has the error of a single
        # frame.
        mean = logarithm[solved].mean(axis=0)
        row, column = divmod(int(np.argmax(np.abs(mean))), mean.shape[1])
        moved = float(np.ptp(logarithm[solved, row, column]))
        noticed = moved > SIGNIFICANT * float(np.median(sd[solved, row, column]))
        within = moved / abs(float(mean[row, column])) if noticed else 0.0
        parts.append((mean, np.sqrt((sd[solved] ** 2).mean(axis=0)), within))
    return map(np.array, zip(*parts, strict=True))
