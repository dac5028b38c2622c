"""Calibration of the film with known loads.

Recordings under known loads are reconstructed; each load gives the mean ln(r/r0) of every cell.
`lampest.apps.calibration.response_fit` determines from them the common response curve and each
cell's gain. Loads and recordings that do not fit together are refused or doubted, in words.
Source of calibration by one load that is moved: arXiv 2404.15131.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.apps.calibration.calibration import MIN_SAMPLE, Calibration, common_scene
from lampest.apps.calibration.known_loads import KnownLoad, KnownLoads
from lampest.apps.calibration.response_fit import (
    FittedResponse,
    Loaded,
    deviations_from_others,
    fit_loads,
    response_of,
)
from lampest.cost.terms import Misfit
from lampest.estimate.estimates import log_change
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError, first_and_more
from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANT, UNUSUAL
from lampest.panel.conditions import water_pressure
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.response import PUBLISHED, Response
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
# Sentences on loads.
ODD = "{} answers otherwise than the others let expect: is its weight right?"
CHANGING = "readings change within the frames of {}: were they put on or taken off then?"
ANSWERS_BESIDE = (
    "cells beside the foot of {} answer as those under it: "
    "are places, frames and diameter_mm right?"
)


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
    # Whether two loads lie on the panel at the same time, (loads, loads)
    begin, end = np.array([load.frames for load in loads]).T
    overlap = np.maximum(begin[:, None], begin) <= np.minimum(end[:, None], end)
    simultaneous = (place[:, None] == place) & overlap
    # Every load lies on a cell, and no two on the same one at the same time.
    for number in np.flatnonzero(~felt.any(axis=(1, 2))):
        raise InputError(f"load {number + 1}: its foot misses the film of every cell")
    common = np.any(felt[:, None] & felt, axis=(2, 3))
    for first, second in 1 + np.argwhere(np.triu(simultaneous & common, 1)):
        raise InputError(
            f"loads {first} and {second} lie on the same cells in the same frames: give one line"
        )
    base = scene.response or PUBLISHED
    water = water_pressure(scene.panel, scene.water)
    flat = np.stack([change, sd, pressure, pressure_sd]).reshape(4, len(loads), -1)
    loaded = Loaded(flat[0], flat[1], flat[2], flat[3], water.ravel(), base)
    fitted = _explaining_fit(loaded)
    try:
        with np.errstate(over="ignore"):
            response = response_of(fitted, base, scene.panel.shape, tolerance)
    except ValueError as error:
        raise InputError(f"the loads make a curve that no film has: {UNITS}") from error
    doubts = (
        _unlike_first_guess(fitted, pressure, base),
        _doubt(ODD, _odd_loads(loaded, fitted)),
        _doubt(CHANGING, within > CHANGED),
        _doubt(ANSWERS_BESIDE, _beside(change, felt, pressure_sd, simultaneous) > BESIDE),
    )
    summary, *remarks = _result_in_words(fitted, len(loads))
    return LoadCalibration(
        scene=replace(scene, response=response),
        summary=summary,
        remarks=(summary, *remarks),
        warnings=tuple(filter(None, doubts)),
        fitted=fitted,
    )


def _all_responses(
    recordings: Sequence[Recording], loads: Sequence[KnownLoad], place: Numbers
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


def _explaining_fit(loaded: Loaded) -> FittedResponse:
    """Return the fit of curve and gains.

    Raises InputError if the loads do not explain the cells.
    """
    fitted = fit_loads(loaded)
    if not fitted.touched.any():
        raise InputError(
            "no cell under a load has an estimate with error bars: "
            "is the readout's noise in the scene?"
        )
    if fitted.scatter > MAX_SCATTER:
        raise InputError(
            "the loads do not explain the cells: "
            f"answers scatter by {100 * fitted.scatter:.0f} % about any common curve; "
            "are frames, places (x along columns, y along rows) and weights right?"
        )
    return fitted


def _doubt(sentence: str, odd: Mask) -> str:
    """Return the sentence on the loads that are odd, (loads,); '' without any."""
    if not odd.any():
        return ""
    numbers = (np.flatnonzero(odd) + 1).tolist()
    return sentence.format(f"load{'s' if len(numbers) > 1 else ''} {first_and_more(numbers)}")


def _result_in_words(fitted: FittedResponse, loads: int) -> Iterator[str]:
    """Yield the summary of a fit to a number of loads, and remarks on its numbers."""
    touched = fitted.touched.sum()
    blank = (~fitted.touched).sum()
    yield (
        f"response from {loads} loads on {touched} of {fitted.touched.size} cells: gains spread "
        f"by {100 * fitted.spread:.1f} %, a cell answers alike within {100 * fitted.scatter:.1f} %"
    )
    yield (
        "response.sd: relative standard deviation of ln(r/r0), of all cells alike; "
        "response.gain_sd: of each cell"
    )
    if blank:
        yield f"{blank} cells felt no load: they have the common curve and the spread"


def _odd_loads(loaded: Loaded, fitted: FittedResponse) -> Mask:
    """Return whether each load's response deviates far more than usual, (loads,).

    The deviation is that from the fit to all others.
    """
    deviation = deviations_from_others(loaded, fitted)
    if len(deviation) < MIN_SAMPLE or np.isnan(deviation).all():
        return np.zeros(len(deviation), dtype=bool)
    deviation -= np.nanmedian(deviation)
    usual = MAD_TO_SIGMA * float(np.nanmedian(np.abs(deviation)))
    return np.nan_to_num(np.abs(deviation)) > UNUSUAL * max(usual, ALIKE)


def _unlike_first_guess(fitted: FittedResponse, pressure: Array, base: Response) -> str:
    """Return a warning of a response far from the first guess, or of loads beyond its range.

    The warning is '' where neither holds.
    """
    middle = np.array([float(np.median(np.abs(pressure[pressure != 0])))])
    most = max(map(abs, base.told_kpa))
    if middle[0] > most:
        return (
            f"half of the loads press with more than {most:.3g} kPa, "
            f"beyond what the first guess knows: {UNITS}"
        )
    ratio = fitted.curve(middle, base)[0][0] / float(base.logarithm(middle)[0])
    if abs(np.log(ratio)) <= UNLIKE:
        return ""
    times = f"{ratio:.2g} times as much" if ratio > 1 else f"{1 / ratio:.2g} times less"
    return f"at {middle[0]:.3g} kPa the film answers {times} than the first guess: {UNITS}"


def _beside(change: Array, felt: Mask, pressure_sd: Array, simultaneous: Mask) -> Array:
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
    simultaneous : boolean array, shape (loads, loads)
        Whether two loads lie on the panel at the same time.
    """
    ratio = np.zeros(len(change))
    for number, same in enumerate(simultaneous):
        free = (~felt[same] & (pressure_sd[same] == 0)).all(axis=0)
        under = np.nanmedian(np.abs(change[number][felt[number]]))
        if free.any() and under > 0:
            ratio[number] = float(np.nanmax(np.abs(change[number][free]))) / under
    return ratio


def _places(names: Sequence[str], loads: Sequence[KnownLoad]) -> Numbers:
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
                f"{recording.name}: there is no frame {load.frames[1]}, "
                f"its frames are 0 to {len(recording.role) - 1}"
            )
    estimates = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    change_and_deviation = log_change(estimates)
    if change_and_deviation is None:
        raise InputError(
            f"{recording.name}: its estimates have no error bars, without which loads calibrate "
            "nothing; the scene must name the readout, and the panel have at most 600 cells"
        )
    logarithm, sd = change_and_deviation
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
