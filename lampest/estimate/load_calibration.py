"""The film's response from recordings of known loads, or one sentence why not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.cost.terms import Misfit
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.loads.calibration import Fitted, Loaded, fit_loads, response_of
from lampest.loads.known_loads import KnownLoad, KnownLoads
from lampest.loads.pressure import NORMAL_95, water_pressure
from lampest.loads.response import PUBLISHED
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

FILM_SHARE = 0.6  # of the pitch: the edge of a cell's film where nobody says
MOST_SCATTER = 0.6  # from load to load, in ln r: films scatter by a tenth, hysteresis makes it a quarter


@dataclass(frozen=True, eq=False)
class LoadCalibration:
    """scene : with the response found. fitted : what it was made from. loads : how many took part."""

    scene: Scene
    fitted: Fitted
    loads: int

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
    of_each = _by_recording(recordings, known)
    parts = [_answers(recording, [known.loads[number] for number in numbers]) for recording, numbers in of_each]
    order = [number for _, numbers in of_each for number in numbers]
    change, sd = (np.concatenate([part[index] for part in parts]) for index in (0, 1))
    pressure, pressure_sd = _told([known.loads[number] for number in order], known, scene)
    for number, felt in zip(order, pressure, strict=True):
        if not felt.any():
            raise InputError(f"load {number + 1}: its foot misses the film of every cell")
    water = water_pressure(scene.panel, scene.water)
    base = scene.response or PUBLISHED
    flat = [values.reshape(len(order), -1) for values in (change, sd, pressure, pressure_sd)]
    fitted = fit_loads(Loaded(flat[0], flat[1], flat[2], flat[3], water.ravel(), base))
    if not fitted.touched.any():
        raise InputError("no cell under a load has an estimate with error bars: is the readout's noise in the scene?")
    if fitted.scatter > MOST_SCATTER:
        raise InputError(
            f"the loads do not explain the cells: answers scatter by {100 * fitted.scatter:.0f} % about any common "
            "curve; are frames, places (x along columns, y along rows) and weights right?"
        )
    response = response_of(fitted, base, scene.panel.shape, tolerance)
    return LoadCalibration(replace(scene, response=response), fitted, len(order))


def _by_recording(recordings: Sequence[Recording], known: KnownLoads) -> list[tuple[Recording, list[int]]]:
    """Each recording with the numbers of its loads; those without loads left out."""
    names = [recording.name for recording in recordings]
    found: dict[int, list[int]] = {}
    for number, load in enumerate(known.loads):
        name = load.recording.removesuffix(".h5")
        if not name and len(names) > 1:
            raise InputError(f"load {number + 1}: with {len(names)} recordings it must name its own")
        if name and names.count(name) != 1:
            raise InputError(f"load {number + 1}: there is no recording {name} among {', '.join(names)}")
        found.setdefault(names.index(name) if name else 0, []).append(number)
    return [(recordings[index], numbers) for index, numbers in sorted(found.items())]


def _answers(recording: Recording, loads: Sequence[KnownLoad]) -> tuple[Array, Array]:
    """ln(r/r0) (loads, rows, columns), mean over each load's frames, and its standard deviation."""
    for load in loads:
        if load.frames[1] >= len(recording.role):
            raise InputError(
                f"{recording.name}: there is no frame {load.frames[1]}, its frames are 0 to {len(recording.role) - 1}"
            )
    found = reconstruct(recording, Estimator((Misfit(),), "reduced"))
    logarithm, sd = _logarithms(found)
    parts = []
    for load in loads:
        inside = (found.frame >= load.frames[0]) & (found.frame <= load.frames[1])
        if inside.sum() < load.frames[1] - load.frames[0] + 1:
            raise InputError(f"{recording.name}: frames {load.frames[0]} to {load.frames[1]} hold unloaded ones")
        solved = inside & np.isfinite(logarithm).all(axis=(1, 2))
        if not solved.any():
            raise InputError(f"{recording.name}: no frame from {load.frames[0]} to {load.frames[1]} was solved")
        # What frames share is in the error bars: their mean is no better than one of them.
        parts.append((logarithm[solved].mean(axis=0), np.sqrt((sd[solved] ** 2).mean(axis=0))))
    change, error = (np.stack([part[index] for part in parts]) for index in (0, 1))
    return change, error


def _logarithms(found: Estimates) -> tuple[Array, Array]:
    """ln(r/r0) without what warmth does, and its standard deviation; (frames, rows, columns)."""
    lower, upper = found.relative_change_lower, found.relative_change_upper
    if lower is None or upper is None:
        raise InputError(
            f"{found.recording.name}: its estimates have no error bars, without which loads calibrate nothing; the "
            "scene must name the readout, and the panel have at most 600 cells"
        )
    warmth = found.recording.scene.temperature
    with np.errstate(divide="ignore"):
        width = np.log1p(upper / 100) - np.log1p(lower / 100)
    ratio = np.log(found.cell_resistance / found.baseline_resistance)
    return ratio - (0.0 if warmth is None else warmth.logarithm), width / (2 * NORMAL_95)


def _told(loads: Sequence[KnownLoad], known: KnownLoads, scene: Scene) -> tuple[Array, Array]:
    """(loads, rows, columns) kPa of the loads, and by how much their places leave it open."""
    panel, away = scene.panel, known.place_mm
    patch = FILM_SHARE * panel.pitch_mm if known.patch_mm is None else known.patch_mm
    pressure = np.stack([load.pressure(panel, patch) for load in loads])
    if not away:
        return pressure, np.zeros_like(pressure)
    across, down = (
        np.stack([load.pressure(panel, patch, *step) - load.pressure(panel, patch, *back) for load in loads]) / 2
        for step, back in (((away, 0.0), (-away, 0.0)), ((0.0, away), (0.0, -away)))
    )
    return pressure, np.hypot(across, down)
