"""Estimates of a recording's frames, as arrays."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.cost.terms import term_kind
from lampest.estimate.estimator import Estimator
from lampest.estimate.state import Step, held_by_all
from lampest.files.applications import applications
from lampest.files.levels import TWO_SIDED
from lampest.files.typed import ReadOnlyArrays
from lampest.inference.noise import NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.converter import rails_reached
from lampest.panel.readouts.wiring import Contacts
from lampest.posterior.certainty import Certainty
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording
from lampest.solvers.bounds import MILLIONTH
from lampest.solvers.solution import Status

if TYPE_CHECKING:
    from lampest.inference.circuits.model_check import ModelCheck

OVERRULED_MISFIT = 5.0  # times the noise: a penalty that the data choose leaves readings within it
MIN_SHOWN = 0.5  # of a cell's change: below, penalties decide more of the cell than readings do
AT_RAILS = {  # in place of the solver's own sentence where readings are at or beyond a rail
    Status.HELD: "an optimum, but readings at or beyond {} keep cells at their bounds and are "
    "missed",
    Status.FLAT: "an optimum, but readings at or beyond {} leave some cells undetermined",
    Status.FAINT: "an optimum, but readings at or beyond {} determine some cells so weakly that "
    "they may still move",
    Status.UNREAD: "too few of the frame's readings are values: the others are missing, or at or "
    "beyond {}",
}


class Barred(property):
    """A property (frames, rows, columns) of estimates with error bars.

    None for estimates without.
    """

    def __init__(self, part: str, about: str) -> None:
        super().__init__(
            lambda estimates: (getattr(estimates, part) or {}).get(self._name), doc=about
        )

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    if TYPE_CHECKING:

        def __get__(self, estimates: Any, owner: type | None = None) -> Array | None:  # type: ignore[override]
            """Return the error bar of the estimates."""


def frame_misfit(
    model: Array, measured: Array, sigma: Array, resolution: Array | None
) -> dict[str, Array]:
    """Return the misfit χ² = Σ ((model − measured)/σ)² of every frame with its significance.

    Parameters
    ----------
    model, measured, sigma : array, shape (frames, rows, columns)
        In the readout's unit; sigma is infinite where there is no value.
    resolution : array, shape (frames, rows, columns), or None
        Diagonal of the averaging kernel A.

    Returns
    -------
    dict of array, shape (frames,)
        NaN where a frame failed. chi_square; degrees_of_freedom = readings − tr A and tail = P(χ² ≥
        chi_square), both NaN without `resolution`; worst_row and worst_column, the lines with the
        largest parts of χ², the first of equal ones; worst_row_share and worst_column_share, these
        parts. Deviations below a millionth of σ are rounding, and count as zero.
    """
    deviation = (model - measured) / sigma
    squares = np.where(np.abs(deviation) < MILLIONTH, 0.0, deviation**2)
    squares[np.isinf(sigma) & np.isfinite(model).any(axis=(1, 2), keepdims=True)] = 0.0
    chi_square = squares.sum(axis=(1, 2))
    readings = np.isfinite(sigma).sum(axis=(1, 2))
    # degrees of freedom: readings − tr A, at least 1
    followed = np.nan if resolution is None else np.nansum(resolution, axis=(1, 2))
    degrees = np.where(np.isnan(chi_square), np.nan, np.maximum(readings - followed, 1.0))
    figures = {
        "chi_square": chi_square,
        "degrees_of_freedom": degrees,
        "tail": chi_square_tail(chi_square, degrees),
    }
    for name, lines in (("row", squares.sum(axis=2)), ("column", squares.sum(axis=1))):
        worst = np.where(np.isnan(chi_square), np.nan, np.argmax(lines, axis=1))
        share = lines.max(axis=1) / np.where(chi_square > 0, chi_square, 1.0)
        figures |= {f"worst_{name}": worst, f"worst_{name}_share": share}
    return figures


@dataclass(frozen=True, eq=False, repr=False)
class Estimates(ReadOnlyArrays):
    """Cell resistances of a recording's measured frames, with error bars, changes and pressures.

    Values of cells are (frames, rows, columns) over the measured frames, NaN where a frame failed.
    Properties that need error bars are None where there are none: the noise is unknown, the panel
    is large, or the method ends at no optimum. If a single frame has no error bars, its values are
    infinite.

    Parameters
    ----------
    recording : Recording
    estimator : Estimator
        Weights that were chosen for the whole recording are numbers.
    frame : integer array, shape (frames,)
        Indices of the measured frames in the recording.
    readings, resting : Readings
        Readings of the frames (frames, rows, columns), and of the unloaded panel (rows, columns):
        values, bounds, or missing.
    baseline_resistance : array, shape (rows, columns)
        Cells of the unloaded panel, ohm.
    baseline : Step
        Solve of the baseline.
    baseline_bars : Certainty or None
        Error bars of the baseline.
    steps : tuple of Step
        Solve of every frame; with `joint_start` the first step includes the baseline.
    joint_start : bool
        Whether the first frame was solved together with the baseline.
    prepared : Prepared
        Preparation of the recording; for a part of a long recording that of the frames which
        represent it.
    contacts : Contacts or None
        Estimated contacts of the lines; None where the scene names none.
    automatic : bool
        Whether the data chose a weight.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> isinstance(estimate, lampest.Estimates), estimate.cell_resistance.shape
    (True, (2, 2, 3))
    """

    recording: Recording
    estimator: Estimator
    frame: Numbers
    readings: Readings
    resting: Readings
    baseline_resistance: Array
    baseline: Step
    baseline_bars: Certainty | None
    steps: tuple[Step, ...]
    joint_start: bool
    prepared: Prepared
    contacts: Contacts | None = None
    automatic: bool = False

    def __repr__(self) -> str:
        solved = int(self.solved.sum())
        status = self.status[0]
        return (
            f"{type(self).__name__}({self.recording.name}: "
            f"{self.method}, {solved} of {len(self.steps)} frames solved, the first: {status})"
        )

    @property
    def method(self) -> str:
        """The terms and the formulation in words: `misfit + gradient, nodal`."""
        return f"{' + '.join(map(term_kind, self.estimator.terms))}, {self.estimator.method.kind}"

    @property
    def measured(self) -> Array:
        """Readings in the readout's unit, less the series resistance, (frames, rows, columns).

        Missing readings are NaN.
        """
        return self.readings.shown

    @property
    def measured_baseline(self) -> Array:
        """Mean of the unloaded readings in the same unit, (rows, columns).

        A recording without unloaded frames has its first readable frame instead.
        """
        return self.resting.shown

    @property
    def sigma(self) -> Array | None:
        """Standard deviation of `measured`, infinite for bounds and missing readings.

        An unknown one is None.
        """
        return self.readings.sigma_of_values

    @property
    def sigma_baseline(self) -> Array | None:
        """Standard deviation of `measured_baseline`; None where unknown."""
        return self.resting.sigma_of_values

    @property
    def missing_readings(self) -> Numbers:
        """Number of missing readings, (frames,), without those the scene's faults make blind."""
        return np.asarray(self.readings.missing(self.recording.scene).sum(axis=(1, 2)))

    @property
    def bound_readings(self) -> Numbers:
        """Number of readings at a rail of the converter, zero, or below the series resistance.

        Shape (frames,).
        """
        return np.asarray(self.readings.bounds.sum(axis=(1, 2)))

    @property
    def time(self) -> Array:
        """Time of every frame, (frames,) s."""
        return self.recording.time[self.frame]

    @property
    def status(self) -> tuple[str, ...]:
        """Outcome of each solve in a sentence, (frames,).

        Rails of the converter that leave cells open are named.
        """
        readout = self.recording.scene.readout
        if readout is None or self.recording.scene.panel.modules is not None:
            return tuple(step.status for step in self.steps)
        messages = []
        for step, recorded in zip(self.steps, self.recording.recorded[self.frame], strict=True):
            at_rails = AT_RAILS.get(step.solution.status, "")
            rails = at_rails and rails_reached(readout, recorded)
            messages.append(at_rails.format(rails) if rails else step.status)
        return tuple(messages)

    @property
    def solved(self) -> Mask:
        """Whether each frame was solved, (frames,)."""
        return np.array([step.solution.solved for step in self.steps])

    @property
    def solve_time(self) -> Array:
        """Wall times of the solves, (frames,) s."""
        return np.array([step.seconds for step in self.steps])

    @property
    def reading_model(self) -> Array:
        """Readings of the estimated cells, (frames, rows, columns) in the readout's unit."""
        return np.stack([step.solution.reading[-1] for step in self.steps])

    @property
    def cell_resistance(self) -> Array:
        """r, (frames, rows, columns) ohm; NaN at a crossing without a cell."""
        cells = np.stack([step.cell_resistance for step in self.steps])
        return np.where(self.recording.scene.panel.present, cells, np.nan)

    @property
    def relative_change(self) -> Array:
        """100·(r/r_baseline − 1), (frames, rows, columns) percent."""
        return 100 * (self.cell_resistance / self.baseline_resistance - 1)

    @property
    def open_cell(self) -> Mask:
        """Whether a cell cannot be distinguished from an open one, (frames, rows, columns)."""
        return (
            np.stack([step.solution.open_cell[-1] for step in self.steps])
            & self.recording.scene.panel.present
        )

    @property
    def at_lower_bound(self) -> Mask:
        """Whether a cell is at its lower bound, (frames, rows, columns)."""
        return np.stack([step.solution.at_lower[-1] for step in self.steps])

    cell_resistance_errors = Barred(
        "_bars", "Standard deviation of r, ohm; infinite where a cell may be open."
    )
    cell_resistance_lower = Barred("_bars", "Lower end of the 95 % interval of r, ohm.")
    cell_resistance_upper = Barred(
        "_bars", "Upper end of the 95 % interval of r, ohm; infinite where it may be open."
    )
    relative_change_errors = Barred("_bars", "Standard deviation of the relative change, percent.")
    relative_change_lower = Barred(
        "_bars", "Lower end of the 95 % interval of the relative change, percent."
    )
    relative_change_upper = Barred(
        "_bars", "Upper end of the 95 % interval of the relative change, percent."
    )
    resolution = Barred(
        "_bars", "Diagonal of the averaging kernel: 1 where readings decide a cell, 0 elsewhere."
    )
    data_share = Barred(
        "_bars", "Row sums of the averaging kernel: share of an estimate that comes from the data."
    )
    sigma_own = Barred("_bars", "Standard deviation of log r: of each cell's own error.")
    sigma_common = Barred(
        "_bars", "Standard deviation of log r: of what all cells share, or those of a line."
    )
    pressure = Barred(
        "_pressed",
        "Pressure of the load, kPa, suction negative; of films with a response in the scene.",
    )
    pressure_errors = Barred("_pressed", "Standard deviation of the pressure, kPa.")
    pressure_own = Barred(
        "_pressed", "Standard deviation of the pressure, kPa: of each cell's own error."
    )
    pressure_common = Barred(
        "_pressed", "Standard deviation of the pressure, kPa: of what cells share."
    )
    pressure_lower = Barred("_pressed", "Lower end of the 95 % interval of the pressure, kPa.")
    pressure_upper = Barred("_pressed", "Upper end of the 95 % interval of the pressure, kPa.")
    saturated = Barred("_pressed", "Whether the response does not determine the pressure.")
    pressing = Barred(
        "_pressed", "Whether a load presses, beyond errors and the film's residue of earlier loads."
    )

    @property
    def reading_sigma(self) -> Array | None:
        """Posterior predictive standard deviation of every reading, (frames, rows, columns).

        The unit is that of the readout. The errors of the cells, the noise and the model's error
        are included; missing readings have a value, too. None without error bars; NaN in a frame
        without.
        """
        deviation = [getattr(step.bars, "reading", None) for step in self.steps]
        noise = self.readings.sigma
        scene = self.prepared.recording.scene
        if self._bars is None or noise is None or all(frame is None for frame in deviation):
            return None
        of_cells = np.stack(
            [np.full(scene.panel.shape, np.nan) if frame is None else frame for frame in deviation]
        )
        if scene.readout is not None:
            # σ² = σ² of the cells' errors + noise², with the noise of bounds and missing readings
            # at the model's reading
            at_model = self.noise.sigma_factor * scene.readout.sigma(
                scene.circuit.to_recorded(self.reading_model, scene)
            )
            noise = np.where(self.readings.plain, noise, at_model)
        return np.asarray(np.hypot(of_cells, noise))

    @property
    def error_bar_time(self) -> Array | None:
        """Wall time of every frame's error bars, (frames,) s; None without error bars."""
        return None if self._bars is None else np.array([step.bars_seconds for step in self.steps])

    @property
    def baseline_resistance_errors(self) -> Array | None:
        """Standard deviation of the baseline's cells, (rows, columns) ohm."""
        if self._bars is None or self.baseline_bars is None:
            return None
        return self.baseline_resistance * self.baseline_bars.deviation

    @property
    def tared(self) -> tuple[str, ...] | None:
        """Reason for a new zero of pressures after each frame, (frames,).

        The reason is '' for a frame without a new zero. None without `Estimator.tare`.
        """
        return None if self._load is None or self.estimator.tare is None else self._load.tared

    @property
    def circuit_check(self) -> "ModelCheck":
        """The check whether the scene's circuit explains the recording's readings."""
        check = self.prepared.check
        number = self.prepared.recording.number
        if not self._is_part or number is None:
            return check
        message = (
            f"; of a long recording {len(number)} frames between {number[0]} "
            f"and {number[-1]} were asked"
        )
        return replace(check, sentence=check.sentence + message)

    @property
    def noise(self) -> NoiseEstimate:
        """Noise of the recording's readings, with the model's error where readings show one."""
        return self.prepared.noise

    @cached_property
    def checks(self) -> tuple[str, ...]:
        """Doubts about the estimates, one line each.

        Doubts concern failed frames, weights, roles and units, circuit, and noise.
        """
        return (*self._own_doubts, *self.prepared.warnings)

    @property
    def checks_without_circuit(self) -> tuple[str, ...]:
        """The doubts that need no check of the circuit, one line each."""
        return (*self._own_doubts, *self.prepared.warnings_without_check)

    @property
    def _own_doubts(self) -> tuple[str, ...]:
        """Doubts about these estimates alone: failed frames, penalties that overrule or hide."""
        return tuple(filter(None, (self._unsolved, self._overruled, self._smoothed)))

    @property
    def _unsolved(self) -> str:
        """Number of unsolved frames with the reason of the first, in words, or ''."""
        solved = self.solved
        if solved.all():
            return ""
        failed = np.sum(~solved)
        count = f"{failed} of {len(solved)} frames are not" if solved.any() else "no frame is"
        return f"{count} solved: {self.status[int(np.argmin(solved))]}"

    @property
    def _is_part(self) -> bool:
        """Whether these are estimates of a part of a long recording."""
        return self.prepared.resolved is not self.recording

    @property
    def _overruled(self) -> str:
        """Misfit in words where chosen weights make it large against the noise, else ''."""
        if self.sigma is None or not self.automatic:
            return ""
        per_reading = self.misfit["chi_square"] / np.isfinite(self.sigma).sum(axis=(1, 2))
        solved = per_reading[np.isfinite(per_reading)]
        factor = np.sqrt(np.median(solved)) if len(solved) else 0.0
        if factor < OVERRULED_MISFIT:
            return ""
        terms = " and ".join(
            term_kind(term) for term in self.estimator.terms if not term.reads_measurement
        )
        return (
            f"with the weight that was chosen for {terms} readings are missed by {factor:.2g} "
            "times their noise in the median frame: give a smaller weight, or leave the term out"
        )

    @property
    def _smoothed(self) -> str:
        """Share of single cells' changes that chosen penalties leave, in words where it is small.

        The share is the median of `resolution`; under absolute losses that of `Held`.
        """
        held = held_by_all(self.steps)
        advice = "average more readings of every cell"
        if held is not None and held.share < MIN_SHOWN:
            return (
                "weak loads are held at rest: a change of log r of a single cell below "
                f"{held.threshold:.2g} does not show; {advice}"
            )
        holds = any(term.loss.enters == "dual" for term in self.estimator.terms)
        if holds or not self.automatic or self.resolution is None:
            return ""
        known = self.resolution[np.isfinite(self.resolution)]
        share = np.median(known) if known.size else 1.0
        if share >= MIN_SHOWN:
            return ""
        return (
            "weak loads are smoothed: a change of log r of a single cell is estimated at "
            f"{share:.0%} of its size in the median, a wider load at more; {advice}"
        )

    @cached_property
    def film(self) -> Any:
        """Strengths of the film's memory, a `FilmKnown` of the application 'film'.

        None stands for a scene without a film, or no error bars. Strengths that
        the scene leaves open are estimated from the frames after a load was taken off.
        """
        film = self.recording.scene.film
        change_and_deviation = log_change(self)
        if film is None or change_and_deviation is None:
            return None
        known = applications().required("film", "memory of a film", "film")
        return known(film).estimated(*change_and_deviation, self.time)

    @property
    def misfit(self) -> dict[str, Array]:
        """Misfit of every frame, see `frame_misfit`; empty where the noise is unknown."""
        if self.sigma is None:
            return {}
        return frame_misfit(self.reading_model, self.measured, self.sigma, self.resolution)

    @cached_property
    def _bars(self) -> dict[str, Array] | None:
        """Error bars by name, (frames, rows, columns) each, as the properties have them.

        None unless an estimate and the baseline have them. In a part of a longer recording the
        estimates with error bars may stand in other parts. σ_r = r·σ(log r), and the interval
        reaches from r·exp(−below) to r·exp(above). `ratio_lower` and `ratio_upper` are the interval
        of r/r0. In a frame without error bars they are infinite, and shares are 0.
        """
        if self.baseline_bars is None or not (
            self._is_part or any(step.bars for step in self.steps)
        ):
            return None
        cells = self.cell_resistance
        ratio = cells / self.baseline_resistance

        def frames(name: str, part: str = "frame", unbarred: float = np.inf) -> Array:
            unknown = np.full(cells.shape[1:], unbarred)
            maps = [getattr(getattr(step.bars, part, None), name, unknown) for step in self.steps]
            return np.where(np.isnan(cells), np.nan, np.stack(maps))

        with np.errstate(over="ignore"):  # the interval of an undetermined cell is infinite
            lower = ratio * np.exp(-frames("below", "change"))
            upper = ratio * np.exp(frames("above", "change"))
            return {
                "cell_resistance_errors": cells * frames("deviation"),
                "cell_resistance_lower": cells * np.exp(-frames("below")),
                "cell_resistance_upper": cells * np.exp(frames("above")),
                "relative_change_errors": 100 * ratio * frames("deviation", "change"),
                "relative_change_lower": 100 * (lower - 1),
                "relative_change_upper": 100 * (upper - 1),
                "ratio_lower": lower,
                "ratio_upper": upper,
                "resolution": frames("resolution", unbarred=0.0),
                "data_share": frames("data_share", unbarred=0.0),
                "sigma_own": frames("own"),
                "sigma_common": frames("common"),
                "change_own": frames("own", "change"),
            }

    @property
    def _pressed(self) -> dict[str, Any] | None:
        """Pressures in kPa with their errors and verdicts, (frames, rows, columns), by name.

        None where the scene names no response, and without error bars.
        """
        load = None if self.recording.scene.response is None else self._load
        if load is None:
            return None
        errors = {
            f"pressure_{part}": getattr(load, part)
            for part in ("errors", "own", "common", "lower", "upper")
        }
        verdicts = {name: getattr(load, name).astype(bool) for name in ("saturated", "pressing")}
        return {"pressure": load.pressure} | errors | verdicts

    @cached_property
    def _load(self) -> Any:
        """Pressures with errors, a `Pressure` of the application 'film'.

        None stands for a missing application, or no error bars: the uncertainty of r/r0 is then
        unknown.
        """
        pressure_of = applications().provided("film", "pressures")
        if self._bars is None or pressure_of is None:
            return None
        return pressure_of(
            self.cell_resistance / self.baseline_resistance,
            self._bars["ratio_lower"],
            self._bars["ratio_upper"],
            self.recording.scene,
            self.time,
            self.film,
            self.estimator.tare,
            self._bars["change_own"],
        )


def log_change(estimates: Estimates) -> tuple[Array, Array] | None:
    """Return ln(r/r0) without the common change by temperature and creep; None without errors.

    Returns
    -------
    change, deviation : array, shape (frames, rows, columns)
        ln(r/r0) and its standard deviation.
    """
    if estimates._bars is None:
        return None
    with np.errstate(divide="ignore"):
        # standard deviation from the 95 % interval of ln(r/r0): width/(2 · 1.96)
        width = np.log(estimates._bars["ratio_upper"]) - np.log(estimates._bars["ratio_lower"])
    change = np.log(estimates.cell_resistance / estimates.baseline_resistance)
    return change - estimates.recording.scene.common_change[0], width / (2 * TWO_SIDED)
