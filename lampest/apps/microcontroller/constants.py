"""Constants of one estimator on one panel, as the C library `lampest_estimate` takes them."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.apps.microcontroller.drift import frames_to_follow
from lampest.files.document import parse_document
from lampest.files.errors import InputError
from lampest.panel.circuit import nominal_terminations
from lampest.panel.equation import equation_of
from lampest.panel.lines import Side, along, of_side, opposite
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.readouts.keys import entry
from lampest.panel.readouts.starts import resolution, unseen_scales
from lampest.panel.scene import Scene
from lampest.runs.case import CaseResult

Sums = NDArray[np.uint32]  # of codes, MISSING where there is none
MAX_LINES = 64  # of a side: LAMPEST_MAX_LINES
MIN_OHM = 1e-3  # of a cell: SMALLEST_OHM
MAX_OHM = 1e9  # of a cell: LARGEST_OHM
MISSING = 2**32 - 1  # LAMPEST_MISSING; sums are unsigned numbers of 32 bits below it
# Kind of a penalty → what it compares, and how; its reference decides between baseline and previous
# frame.
PENALTIES = {
    "log_gradient": ("LAMPEST_LOG", "LAMPEST_STEPS"),
    "gradient": ("LAMPEST_OHM", "LAMPEST_CENTRAL"),
    "cell_resistance": ("LAMPEST_OHM", "LAMPEST_VALUES"),
    "relative_change": ("LAMPEST_CHANGE", "LAMPEST_VALUES"),
    "gradient_of_relative_change": ("LAMPEST_CHANGE", "LAMPEST_CENTRAL"),
    "log_ratio": ("LAMPEST_LOG_OF_", "LAMPEST_VALUES"),
}
LOSSES = {"squared": "LAMPEST_SQUARED", "huber": "LAMPEST_HUBER", "student": "LAMPEST_STUDENT"}
MAX_RELEASE = 1e3  # Rd/Rp or Rs/Rq: single precision keeps four digits of 1 + a Z
COMPARES = ("LAMPEST_CHANGE", "LAMPEST_LOG_OF_PREVIOUS")  # with the previous frame
MIN_LOADED_LIMIT = 0.2  # ln r: a fifth below the other cells is no drift
MAX_LOADED_LIMIT = 1e6  # ln r: single precision has it, and no cell exceeds it
LOADED_DEVIATIONS = 8.0  # standard deviations of a cell


@dataclass(frozen=True)
class Budget:
    """Largest work of a frame.

    Attributes
    ----------
    steps : int
        Gauss-Newton steps.
    products : int
        Conjugate-gradient iterations of a step.
    within : float
        Deviation from the optimum at which a frame ends, in standard deviations of its cells.
    """

    steps: int = 2
    products: int = 15
    within: float = 0.05


@dataclass(frozen=True)
class Penalty:
    """One penalty as C has it: names of enumerators, corner of the loss, and weight."""

    quantity: str
    difference: str
    loss: str
    corner: float
    weight: float


@dataclass(frozen=True, eq=False)
class CircuitLines:
    """Circuit of driven lines.

    V_ij = gain_j Z_ij / ((drive_i + release_i Z_ii)(1 + load_j Z_jj) − …).

    Attributes
    ----------
    tie : array, shape (rows + columns,)
        Conductance of idle lines to ground, siemens.
    drive, release : array, shape (driven lines,)
        Rd in ohm, and 1 − Rd/Rp.
    load, gain : array, shape (sensed lines,)
        1/Rs − 1/Rq in siemens, and the supply times the share of the line's voltage at the
        converter, volt.
    """

    tie: Array
    drive: Array
    release: Array
    load: Array
    gain: Array

    @classmethod
    def of(cls, readout: Readout, shape: tuple[int, int]) -> "CircuitLines":
        """Return the circuit's numbers.

        Raises InputError for a circuit that is not of this form.
        """
        if getattr(readout, "diode", None) is not None:
            raise InputError(
                "the C library has no diodes: "
                "drive the lines without one, or estimate on a computer"
            )
        if unseen_scales(readout, *shape):
            raise InputError(
                "the C library has no prior of scales that no reading shows: "
                "give each sensed line a resistor (load_ohm), or estimate on a computer"
            )
        equation = equation_of(readout, *shape)
        if len(equation.ties) > 1:
            raise InputError("the C library has no multiplexers in parallel (readout.groups)")
        if np.isinf(equation.ties).any():
            raise InputError(
                "the C library has no lines that 0 ohm hold at ground while they are idle: "
                "give idle_ohm or idle_load_ohm of the switch"
            )
        side = equation.terminations.driven
        of_driven, of_sensed = of_side(side, np.s_[:, 0], np.s_[0])
        drive, release = (terms[of_driven] for terms in equation.drive_terms)
        load = equation.load_terms[1][of_sensed]
        gain = equation.gain[of_sensed]
        if np.any(np.abs(release) > MAX_RELEASE) or np.any(
            np.abs(load) * equation.load[of_sensed] > MAX_RELEASE
        ):
            raise InputError(
                "the C library has no lines that are held at ground while idle, "
                "and driven or loaded through a resistor: single precision loses what differs"
            )
        tie = readout.ties(np.full(shape, equation.source / 2))
        lines = cls(tie, drive, release, load, equation.source * gain)
        # Anything else that a readout states would be lost silently.
        cells = np.geomspace(1e3, 1e4, shape[0] * shape[1]).reshape(shape)
        exact = readout.exact_reading(cells)
        if not np.allclose(lines.readings(cells, side), exact, rtol=1e-6, atol=1e-9):
            raise InputError(f"the C library has no such circuit: {readout.description()}")
        return lines

    def readings(self, cells: Array, driven: Side) -> Array:
        """Return the readings of cells (rows, columns) in ohm, as the C library computes them."""
        rows, columns = cells.shape
        conductance = np.zeros((rows + columns,) * 2)
        conductance[:rows, rows:] = 1 / cells
        conductance += conductance.T
        impedance = np.linalg.inv(np.diag(conductance.sum(axis=0) + self.tie) - conductance)
        own = np.diag(impedance)
        mutual = impedance[:rows, rows:]
        sensed = opposite(driven)
        of_driven, of_sensed = of_side(driven, own[:rows], own[rows:])
        drive, release, own_driven = (
            along(driven, part) for part in (self.drive, self.release, of_driven)
        )
        load, gain, own_sensed = (along(sensed, part) for part in (self.load, self.gain, of_sensed))
        path = (drive + release * own_driven) * (1 + load * own_sensed)
        return np.asarray(gain * mutual / (path - release * load * mutual**2))


@dataclass(frozen=True, eq=False)
class Constants:
    """Content of `lampest_constants`; arrays over cells are (rows, columns).

    Attributes
    ----------
    scene : Scene
    lines : CircuitLines or None
        Driven lines; None for two-point readings.
    sigma_volt : array, shape (rows, columns)
        Standard deviation of a reading at the converter.
    plain_sigma : float
        Standard deviation of all readings in their unit where the misfit is plain, else 0.
    data_loss : str
    data_corner : float
    penalties : tuple of Penalty
    least_ohm, largest_ohm : float
    native_bounds : bool
    baseline : array
        Cells at rest in ohm; 1 kΩ where there is no cell.
    loaded_limit : float
        In ln r.
    follow : float
        Time constant of the baseline, frames.
    budget : Budget
    """

    scene: Scene
    lines: CircuitLines | None
    sigma_volt: Array
    plain_sigma: float
    data_loss: str
    data_corner: float
    penalties: tuple[Penalty, ...]
    least_ohm: float
    largest_ohm: float
    native_bounds: bool
    baseline: Array
    loaded_limit: float
    follow: float
    budget: Budget = Budget()

    @classmethod
    def of(cls, case: CaseResult) -> "Constants":
        """Return the constants of a case.

        Raises InputError for a term or circuit that C does not have, a configuration that lampest
        does not write, and numbers beyond those that the library takes.
        """
        try:
            constants = cls._of(case)
        except (TypeError, KeyError, ValueError, AttributeError, ZeroDivisionError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{case.recording} × {case.estimator}: "
                "its stored configuration is none that lampest writes"
            ) from error
        constants.check()
        return constants

    @classmethod
    def _of(cls, case: CaseResult) -> "Constants":
        """Return the constants of a case, unchecked."""
        scene = case.scene
        check_scene(scene)
        lines = None
        if scene.circuit.unit == "volt":
            lines = CircuitLines.of(scene.circuit, scene.panel.shape)
        content = parse_document(case.case_yaml, f"{case.recording} × {case.estimator}").content
        terms = content["terms"]
        (data,) = [term for term in terms if term["kind"] == "misfit"]
        plain = 0.0  # typical σ of a reading in its own unit
        if data.get("weighting", "plain") == "plain":
            assert case.sigma is not None
            plain = float(np.median(case.sigma[case.valued]))
        scale = (plain or 1.0) ** 2 * data.get("weight", 1.0)
        penalties = tuple(_penalty(term, case, scale) for term in terms if term is not data)
        loss, corner = _loss(data)
        solved = case.solved
        limit = MIN_LOADED_LIMIT
        if case.sigma_own is not None:
            noisy = LOADED_DEVIATIONS * float(np.nanmedian(case.sigma_own[solved]))
            limit = max(limit, noisy if np.isfinite(noisy) else 0.0)
        bounds = content.get("bounds", {})
        lower = bounds.get("lower", "measured")
        upper = bounds.get("upper", "resolution")
        native = lines is None and lower == "measured" and upper == "resolution"
        typical = float(np.nanmedian(case.cell_resistance[solved]))
        baseline = np.where(
            np.isfinite(case.baseline_resistance), case.baseline_resistance, typical
        )
        return cls(
            scene,
            lines,
            _sigma_volt(case),
            plain / np.sqrt(data.get("weight", 1.0)),
            loss,
            corner / (plain or 1.0),
            penalties,
            float(lower) if not isinstance(lower, str) else 1e-6 * typical,
            float(upper) if not isinstance(upper, str) else _largest(case),
            native,
            np.where(scene.panel.present, baseline, 1000.0),
            limit,
            frames_to_follow(case, limit),
        )

    def check(self) -> None:
        """Raise InputError for a number that the library does not take: NaN, or one of no panel.

        A compiler would refuse it, or the board.
        """
        losses = [(self.data_loss, self.data_corner)]
        losses += [(term.loss, term.corner) for term in self.penalties]
        # The ranges are those that `constants_are_sound` of the library allows.
        numbers = {
            "cells at rest, ohm,": (self.baseline, MIN_OHM, MAX_OHM),
            "noise, volt,": (self.sigma_volt, 1e-12, 1e6),
            "noise of plain misfits": (self.plain_sigma, 0.0, 1e12),
            "supplies, volt,": (self.scene.circuit.supply_volt, 1e-3, 1e3),
            "corners of losses": (
                [corner for loss, corner in losses if loss != "LAMPEST_SQUARED"],
                1e-12,
                1e12,
            ),
            "weights": ([term.weight for term in self.penalties], 0.0, 1e30),
            "lower bounds, ohm,": (self.least_ohm, 0.0, MAX_OHM),
            "upper bounds, ohm,": (self.largest_ohm, 0.0, 1e15),
            "limits of loaded cells, ln r,": (self.loaded_limit, 0.0, MAX_LOADED_LIMIT),
            "series resistances, ohm,": (self.scene.series_ohm, 0.0, MAX_OHM),
        }
        if self.lines is not None:
            numbers |= {
                "ties of lines, siemens,": (self.lines.tie, 0.0, 1e9),
                "drive resistances, ohm,": (self.lines.drive, 0.0, MAX_OHM),
                "releases of lines": (self.lines.release, -1e9, 1.0),
                "loads of lines, siemens,": (self.lines.load, -1e9, 1e9),
                "gains of lines, volt,": (self.lines.gain, 1e-12, 1e12),
            }
        elif isinstance(self.scene.circuit, TwoPointReadout):
            numbers["references, ohm,"] = (self.scene.circuit.reference_ohm, 1e-6, MAX_OHM)
        for name, (values, low, high) in numbers.items():
            flat = np.ravel(np.asarray(values, dtype=float))
            beyond = flat[~((flat >= low) & (flat <= high))]
            if beyond.size:
                raise InputError(
                    f"the C library takes {name} from {low:g} to {high:g}, not {beyond[0]:g}"
                )
        if self.least_ohm > self.largest_ohm:
            raise InputError(
                f"bounds: the lower one, {self.least_ohm:g} ohm, "
                f"exceeds the upper, {self.largest_ohm:g}"
            )
        low, high = self.valid_sums
        if low > high:
            raise InputError(
                "no sum of codes is a value: all are at an end of the converter's range"
            )

    def within(self, budget: Budget) -> "Constants":
        """Return the constants with another budget."""
        return replace(self, budget=budget)

    @property
    def top_sum(self) -> int:
        """Largest sum of codes."""
        readout = self.scene.circuit
        return int(readout.readings * (2**readout.adc_bits - 1))

    @property
    def valid_sums(self) -> tuple[int, int]:
        """Smallest and largest sum between the rails, in this order."""
        readout = self.scene.circuit
        ends = readout.steps_from_volt(readout.volt_from_recorded(np.array(readout.rails())))
        low, high = np.sort(ends) * readout.readings
        valid = np.clip((np.ceil(low - 1e-6), np.floor(high + 1e-6)), 0, self.top_sum)
        return int(valid[0]), int(valid[1])

    @property
    def relative(self) -> bool:
        """Whether a penalty compares with the previous frame."""
        return any(penalty.quantity in COMPARES for penalty in self.penalties)

    @property
    def pairs(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array] | None:
        """Neighbours among listed cells, numbered along the longer side; None for a full rectangle.

        Returns
        -------
        first, second : integer arrays, shape (pairs,)
            Numbers of the two cells.
        distance : array, shape (pairs,)
            As in `Panel.neighbours`.
        """
        panel = self.scene.panel
        if panel.cells is None:
            return None
        first, second, distance = panel.neighbours
        rows, columns = panel.shape
        if rows >= columns:
            return first, second, distance
        turned = [(cells % columns) * rows + cells // columns for cells in (first, second)]
        return turned[0], turned[1], distance

    @property
    def rises(self) -> bool:
        """Whether a reading of the network grows with its sum."""
        readout = self.scene.circuit
        if readout.unit == "ohm":
            rises = entry(readout, "measured_across") == "sensor"
        else:
            rises = nominal_terminations(readout).sign > 0
        return bool(rises == (readout.code_sign > 0))

    def sums_of(self, case: CaseResult) -> Sums:
        """Return the sums of codes of the frames, (frames, rows, columns).

        Missing readings are MISSING.
        """
        readout = self.scene.circuit
        with np.errstate(invalid="ignore"):
            volt = readout.volt_from_recorded(readout.to_recorded(case.measured, self.scene))
            sums = readout.steps_from_volt(volt) * readout.readings
        sums = np.clip(np.nan_to_num(np.round(sums)), 0, self.top_sum)
        if case.reading_side is not None:
            side = case.reading_side if self.rises else -case.reading_side
            sums = np.where(side > 0, self.top_sum, np.where(side < 0, 0, sums))
        return np.where(np.isfinite(case.measured), sums, MISSING).astype(np.uint32)


def check_scene(scene: Scene) -> None:
    """Raise InputError where the C library does not have an effect of the scene."""
    rows, columns = scene.panel.shape
    for is_lacking, sentence in (
        (scene.readout is None, "needs a readout in the scene, whose codes the board reads"),
        (
            scene.panel.modules is not None,
            "estimates one panel, not modules: export a recording of one of them",
        ),
        (
            max(rows, columns) > MAX_LINES,
            f"has up to {MAX_LINES} lines a side, not {rows} × {columns}",
        ),
        (scene.wiring is not None, "has no line resistance, contacts, touching lines or leaks"),
        (scene.converter_memory is not None, "has no converter memory"),
        (scene.faults is not None, "has no faults: list the panel's sound cells under panel.cells"),
    ):
        if is_lacking:
            raise InputError(f"the C library {sentence}")
    readout = scene.circuit
    characteristic = readout.characteristic
    if characteristic.curve is not None or characteristic.signed or readout.code_sign < 0:
        raise InputError(
            "the C library has converters of codes from 0 and a straight, rising line only"
        )
    keys = ("idle_volt", "load_volt", "idle_load_volt", "driven_groups", "offset_volt")
    for key in keys:
        if getattr(readout, key, None) is not None:
            raise InputError(f"the C library has no {key}")
    if readout.unit == "ohm" and not readout.two_point:
        raise InputError(f"the C library has no such circuit: {readout.description()}")
    if readout.readings * (2**readout.adc_bits - 1) >= MISSING:
        raise InputError(
            f"sums of {readout.readings} readings "
            f"of {readout.adc_bits} bits exceed 32 bits: give fewer readings"
        )


def _sigma_volt(case: CaseResult) -> Array:
    """Return σ at the converter in volt, (rows, columns): the median over the frames."""
    if case.sigma is None:
        raise InputError(
            f"{case.recording} × {case.estimator}: the noise of the readings is not known"
        )
    scene = case.scene
    readout = scene.circuit
    # d(network reading)/d(volt) by central differences of half a code
    volt = readout.volt_from_recorded(readout.to_recorded(case.measured, scene))
    half = readout.lsb_volt / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        upper, lower = (
            readout.from_recorded(readout.recorded_from_volt(volt + side), scene)
            for side in (half, -half)
        )
        sigma = case.sigma / np.abs((upper - lower) / (2 * half))
    sigma[~case.valued | ~np.isfinite(sigma)] = np.nan
    if not np.isfinite(sigma).any():
        raise InputError(f"{case.recording} × {case.estimator}: no reading is a value")
    typical = float(np.nanmedian(sigma))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of cells without a value
        each = np.nan_to_num(np.nanmedian(sigma, axis=0), nan=typical)
    return np.full_like(each, typical) if np.allclose(each, typical, rtol=1e-3) else each


def _largest(case: CaseResult) -> float:
    """Return the upper bound of all cells in ohm.

    Larger resistances are not resolved by single precision or by the noise.
    """
    readout = case.scene.circuit
    if readout.two_point or case.sigma is None:
        return MAX_OHM
    whole = case.valued.all(axis=(1, 2))
    limits = resolution(readout, case.measured[whole], case.sigma[whole])
    return float(min(MAX_OHM, np.max(limits, initial=0.0) or MAX_OHM))


def _loss(term: Mapping[str, Any]) -> tuple[str, float]:
    """Return the enumerator of a loss and its corner.

    Raises InputError for a loss that C does not have.
    """
    loss = term.get("loss", {"kind": "squared"})
    if loss["kind"] not in LOSSES:
        raise InputError(
            f"the C library has no loss {loss['kind']!r} ({term['kind']}): "
            f"it has {', '.join(LOSSES)}"
        )
    return LOSSES[loss["kind"]], float(loss.get("corner", 1.0))


def _penalty(term: Mapping[str, Any], case: CaseResult, scale: float) -> Penalty:
    """Return a penalty with its weight of the strongest frame.

    The divisor of the weight is that of the misfit.
    """
    kind = term["kind"]
    if kind not in PENALTIES:
        raise InputError(
            f"the C library has no term {kind!r}: it has misfit, {', '.join(PENALTIES)}"
        )
    loss, corner = _loss(term)
    quantity, difference = PENALTIES[kind]
    if kind == "log_ratio":
        quantity += str(term.get("reference", "baseline")).upper()
    if case.scene.panel.cells is not None and difference == "LAMPEST_CENTRAL":
        difference = "LAMPEST_STEPS"
    weights = case.weights[kind][np.isfinite(case.weights[kind])]
    if not weights.size:
        raise InputError(
            f"{case.recording} × {case.estimator}: no frame is solved, so that {kind} has no weight"
        )
    return Penalty(quantity, difference, loss, corner, float(np.median(weights)) / scale)
