"""The film's response from recordings of known loads, or one sentence why not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.cost.terms import Misfit
from lampest.estimate.estimates import log_change
from lampest.estimate.estimator import Estimator
from lampest.estimate.outliers import TO_SIGMA
from lampest.estimate.sequence import reconstruct
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.loads.calibration import Fitted, Loaded, answers_by_others, fit_loads, response_of
from lampest.loads.known_loads import KnownLoad, KnownLoads
from lampest.loads.pressure import water_pressure
from lampest.panel.panel import Array
from lampest.panel.response import PUBLISHED, Response
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

FILM_SHARE = 0.6  # of the pitch: the edge of a cell's film where nobody says
MOST_SCATTER = 0.6  # from load to load, in ln r: films scatter by a tenth, hysteresis makes it a quarter
CLEARLY, ODD = 5.0, 4.0  # standard deviations of a cell's change, and of the usual load's answer
FEWEST_JUDGED, MOST_JUDGED = 5, 60  # loads: fewer show no usual one; each costs a fit
ALIKE = 0.02  # of ln of an answer: so well films repeat at best
UNLIKE = 2.0  # of ln of the first guess's steepness, two standard deviations of its prior: units are wrong more often
MOST_NAMED = 5  # loads in one warning
UNITS = "is mass_g in gram, force_newton in newton, and diameter_mm the diameter in mm?"
CHANGED, BESIDE = 0.25, 0.5  # of a load's answer: change within its frames, and answer of cells beside its foot


@dataclass(frozen=True, eq=False)
class LoadCalibration:
    """scene : with the response found. fitted : what it was made from. loads : how many took part.

    warnings : what may be wrong with the loads, a sentence each.
    """

    scene: Scene
    fitted: Fitted
    loads: int
    warnings: tuple[str, ...] = ()

    def summary(self) -> str:
        """What was found, in one line."""
        cells = self.fitted.touched
        return (
            f"response from {self.loads} loads on {cells.sum()} of {cells.size} cells: gains spread by "
            f"{100 * self.fitted.spread:.1f} %, a cell answers alike within {100 * self.fitted.scatter:.1f} %"
        )

    def text(self) -> str:
        """The scene as YAML, with what it came from as comments."""
        remarks = [
            self.summary(),
            "response.sd: relative standard deviation of ln(r/r0), of all cells alike; response.gain_sd: of each cell",
        ]
        blank = int((~self.fitted.touched).sum())
        if blank:
            remarks.append(f"{blank} cells felt no load: they have the common curve and the spread")
        return "".join(f"# {remark}\n" for remark in remarks) + to_yaml(self.scene)


def calibrate_loads(recordings: Sequence[Recording], known: KnownLoads, tolerance: float) -> LoadCalibration:
    """The curve and gains that explain known loads best; see `lampest.loads.calibration`.

    recordings : of one scene, unloaded frames included. tolerance : by which fraction all loads together may be off.

    Raises InputError where loads and recordings do not fit each other, or no film answers so.
    """
    scene = recordings[0].scene
    for other in recordings[1:]:
        if other.scene != scene:
            raise InputError(f"{other.name}: its scene is another than that of {recordings[0].name}")
    loads = known.loads
    place = _places([recording.name for recording in recordings], loads)
    parts: dict[int, tuple[Array, Array, float]] = {}
    for index in np.unique(place):
        own = np.flatnonzero(place == index).tolist()
        parts |= dict(zip(own, _answers(recordings[index], [loads[number] for number in own]), strict=True))
    change, sd, within = (np.stack([parts[number][index] for number in range(len(loads))]) for index in (0, 1, 2))
    pressure, pressure_sd = _specified(known, scene)
    felt = pressure != 0
    for number, cells in enumerate(felt):
        if not cells.any():
            raise InputError(f"load {number + 1}: its foot misses the film of every cell")
    begin, end = np.array([load.frames for load in loads]).T
    overlap = np.maximum(begin[:, None], begin) <= np.minimum(end[:, None], end)
    together = (place[:, None] == place) & overlap
    for one, two in np.argwhere(np.triu(together, 1)):
        if np.any(felt[one] & felt[two]):
            raise InputError(f"loads {one + 1} and {two + 1} lie on the same cells in the same frames: give one line")
    base, water = scene.response or PUBLISHED, water_pressure(scene.panel, scene.water)
    flat = [values.reshape(len(loads), -1) for values in (change, sd, pressure, pressure_sd)]
    loaded = Loaded(flat[0], flat[1], flat[2], flat[3], water.ravel(), base)
    fitted = fit_loads(loaded)
    if not fitted.touched.any():
        raise InputError("no cell under a load has an estimate with error bars: is the readout's noise in the scene?")
    if fitted.scatter > MOST_SCATTER:
        raise InputError(
            f"the loads do not explain the cells: answers scatter by {100 * fitted.scatter:.0f} % about any common "
            "curve; are frames, places (x along columns, y along rows) and weights right?"
        )
    try:
        with np.errstate(over="ignore"):
            response = response_of(fitted, base, scene.panel.shape, tolerance)
    except ValueError as error:
        raise InputError(f"the loads make a curve that no film has: {UNITS}") from error
    beside = _beside(change, felt, pressure_sd, together) > BESIDE
    warnings = (
        _named("{} answers otherwise than the others let expect: is its weight right?", _odd_ones(loaded)),
        _unlike_first_guess(fitted, pressure, base),
        _named("readings change within the frames of {}: were they put on or taken off then?", within > CHANGED),
        _named(
            "cells beside the foot of {} answer as those under it: are places, frames and diameter_mm right?", beside
        ),
    )
    return LoadCalibration(replace(scene, response=response), fitted, len(loads), tuple(filter(None, warnings)))


def _odd_ones(loaded: Loaded) -> NDArray[np.bool_]:
    """(loads) which answer otherwise than all others let expect, by many times what the others do."""
    judged = FEWEST_JUDGED <= len(loaded.change) <= MOST_JUDGED
    away = answers_by_others(loaded) if judged else np.full(len(loaded.change), np.nan)
    if np.isnan(away).all():
        return np.zeros(len(away), dtype=bool)
    away -= np.nanmedian(away)
    usual = TO_SIGMA * float(np.nanmedian(np.abs(away)))
    return np.asarray(np.nan_to_num(np.abs(away)) > ODD * max(usual, ALIKE))


def _unlike_first_guess(fitted: Fitted, pressure: Array, base: Response) -> str:
    """Where the film answers many times more or less than the first guess, or loads press beyond what that knows."""
    middle, most = np.array([float(np.median(np.abs(pressure[pressure != 0])))]), max(map(abs, base.told_kpa))
    if middle[0] > most:
        return f"half of the loads press with more than {most:.3g} kPa, beyond what the first guess knows: {UNITS}"
    ratio = fitted.curve(middle, base)[0][0] / float(base.logarithm(middle)[0])
    if abs(np.log(ratio)) <= UNLIKE:
        return ""
    times = f"{ratio:.2g} times as much" if ratio > 1 else f"{1 / ratio:.2g} times less"
    return f"at {middle[0]:.3g} kPa the film answers {times} than the first guess: {UNITS}"


def _beside(change: Array, felt: NDArray[np.bool_], pressure_sd: Array, together: NDArray[np.bool_]) -> Array:
    """(loads) the largest answer of cells beside a foot over the median one under it; 0 where nothing is beside."""
    found = np.zeros(len(change))
    for number, same in enumerate(together):
        beside = (~felt[same] & (pressure_sd[same] == 0)).all(axis=0)
        under = np.nanmedian(np.abs(change[number][felt[number]]))
        if beside.any() and under > 0:
            found[number] = float(np.nanmax(np.abs(change[number][beside]))) / under
    return found


def _named(sentence: str, which: NDArray[np.bool_]) -> str:
    """The sentence with the loads that it is about; '' where it is about none."""
    numbers = (np.flatnonzero(which) + 1).tolist()
    more = f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else ""
    loads = f"load{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers[:MOST_NAMED]))}{more}"
    return sentence.format(loads) if numbers else ""


def _places(names: Sequence[str], loads: Sequence[KnownLoad]) -> NDArray[np.intp]:
    """The index of each load's recording."""
    found = []
    for number, load in enumerate(loads):
        name = load.recording.removesuffix(".h5")
        if not name and len(names) > 1:
            raise InputError(f"load {number + 1}: with {len(names)} recordings it must name its own")
        if name and names.count(name) != 1:
            raise InputError(f"load {number + 1}: there is no recording {name} among {', '.join(names)}")
        found.append(names.index(name) if name else 0)
    return np.array(found, dtype=np.intp)


def _answers(recording: Recording, loads: Sequence[KnownLoad]) -> list[tuple[Array, Array, float]]:
    """ln(r/r0) (rows, columns), mean over each load's frames, its standard deviation, and its change within them."""
    for load in loads:
        if load.frames[1] >= len(recording.role):
            raise InputError(
                f"{recording.name}: there is no frame {load.frames[1]}, its frames are 0 to {len(recording.role) - 1}"
            )
    found = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    known = log_change(found)
    if known is None:
        raise InputError(
            f"{recording.name}: its estimates have no error bars, without which loads calibrate nothing; the "
            "scene must name the readout, and the panel have at most 600 cells"
        )
    (logarithm, sd), parts = known, []
    if found.film is not None and found.film.film.creep_per_decade:
        logarithm, open_sd = found.film.at_once(logarithm, found.time)
        sd = np.hypot(sd, open_sd)
    for load in loads:
        inside = (found.frame >= load.frames[0]) & (found.frame <= load.frames[1])
        if inside.sum() < load.frames[1] - load.frames[0] + 1:
            raise InputError(f"{recording.name}: frames {load.frames[0]} to {load.frames[1]} hold unloaded ones")
        solved = inside & np.isfinite(logarithm).all(axis=(1, 2))
        if not solved.any():
            raise InputError(f"{recording.name}: no frame from {load.frames[0]} to {load.frames[1]} was solved")
        # What frames share is in the error bars: their mean is no better than one of them.
        mean = logarithm[solved].mean(axis=0)
        row, column = divmod(int(np.argmax(np.abs(mean))), mean.shape[1])
        moved = float(np.ptp(logarithm[solved, row, column]))
        noticed = moved > CLEARLY * float(np.median(sd[solved, row, column]))
        within = moved / max(abs(float(mean[row, column])), 1e-300) if noticed else 0.0
        parts.append((mean, np.sqrt((sd[solved] ** 2).mean(axis=0)), within))
    return parts


def _specified(known: KnownLoads, scene: Scene) -> tuple[Array, Array]:
    """(loads, rows, columns) kPa of the loads, and by how much their places leave it open."""
    panel, away = scene.panel, known.place_mm
    patch = FILM_SHARE * panel.pitch_mm if known.patch_mm is None else known.patch_mm
    pressure = np.stack([load.pressure(panel, patch) for load in known.loads])
    if not away:
        return pressure, np.zeros_like(pressure)
    across, down = (
        np.stack([load.pressure(panel, patch, *step) - load.pressure(panel, patch, *back) for load in known.loads]) / 2
        for step, back in (((away, 0.0), (-away, 0.0)), ((0.0, away), (0.0, -away)))
    )
    return pressure, np.hypot(across, down)
