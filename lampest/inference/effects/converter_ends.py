"""Ends of the converter and of the stage before it, from channels that stand there.

Where a stage before the converter saturates, significantly more channels end at one voltage than
near it. The readings there are bounds, as at a rail. An open cell reads the potential in which its
load ends: where several channels of the unloaded panel stand at one lowest code, this code stands
for that potential. Where no cell is open, the most probable voltage of code 0 is the one with which
most cells stand still between the unloaded panel and a loaded frame.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.files.levels import NOISE_REACH, OUTLIER_THRESHOLD, SIGNIFICANCE
from lampest.inference.circuits.alternatives import Alternative, with_converter
from lampest.inference.circuits.explanation import ComparedFrames, Explanation
from lampest.inference.effects.effect import (
    Determined,
    SceneEffect,
    Unnamed,
    estimated_entry,
    names_none,
)
from lampest.inference.noise import NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts.converter import MAX_VOLT, Characteristic, mean_sigma
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED
from lampest.posterior.interval import binomial_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# In widths within which voltages count as equal: least range of the channels; within a smaller one
# all are alike.
MIN_EXTENT = 10.0
MIN_CROWD = 2.0  # channels within the width at a limit, over those within the next one
COMPARED_FRAMES = 8  # frames, about, in which the voltages of lines are compared
ZERO = "readout.converter.zero_volt"
PASSES = "readout.passes_volt"
# Voltage of code 0 by still cells, as shares of the supply: where the search begins, and its prior
# standard deviation. Of the latter: the secant's step, and the largest posterior one.
ZERO_STARTS = (0.0, 0.04, -0.02)
ZERO_PRIOR = 0.05
ZERO_SECANT = 1e-3
MAX_ZERO_SD = 0.3
MAX_ZERO_STEPS = 12
MIN_OPEN = 6  # channels at the lowest code
TOGETHER = 1.0  # steps within which they stand


@dataclass(frozen=True)
class Saturated:
    """A voltage at which channels end.

    Attributes
    ----------
    volt : float
        Limit of the stage, V.
    loaded, unloaded : int
        Number of channels at the limit under load, and on the unloaded panel.
    highest : bool
        Whether the limit is the largest voltage that the stage passes, else the smallest.
    """

    volt: float
    loaded: int
    unloaded: int
    highest: bool

    @property
    def sentence(self) -> str:
        """The finding in words."""
        channels = (
            f"{self.loaded} loaded channels end"
            if self.loaded
            else f"{self.unloaded} unloaded channels stand"
        )
        also = (
            f", {self.unloaded} of the unloaded panel too" if self.loaded and self.unloaded else ""
        )
        return (
            f"{channels} at the same {self.volt:.3g} volt{also}, and what lies beyond is lost: "
            "does a stage before the converter saturate there? "
            "Then name it: readout: {passes_volt: estimated}"
        )


def saturated(recording: Recording) -> Saturated | None:
    """Return the voltage at which several channels end.

    The result is None where there is none, or where the scene states one. Channels that moved under
    load are tested by their largest or smallest voltage over the measured frames, all channels by
    their unloaded voltage. A limit within noise of the converter's own end is that end.
    """
    scene = recording.scene
    unloaded = recording.role == UNLOADED
    measured = recording.role == MEASURED
    readout = scene.readout
    if (
        readout is None
        or readout.passes_volt not in (None, ESTIMATED)
        or scene.panel.modules is not None
        or not unloaded.any()
    ):
        return None
    width = NOISE_REACH * mean_sigma(readout)
    volts = scene.circuit.volt_from_recorded(recording.recorded)
    plain = Readings.of(scene, recording.recorded, recording.sigma).plain
    plain &= _differ(volts, float(np.mean(width)))
    for sign in (1.0, -1.0):
        volt = np.where(plain, sign * volts, np.nan)
        resting = np.fmax.reduce(volt[unloaded], axis=0)  # NaN where no reading is a value
        most = np.fmax.reduce(volt[measured], axis=0) if measured.any() else resting
        moved = np.nan_to_num(most - resting, nan=0.0) > OUTLIER_THRESHOLD * width
        for channels, counted in ((most, moved), (resting, np.isfinite(resting))):
            at_end = _channels_at_end(channels, counted, width)
            end = float(np.nanmax(channels, initial=-np.inf))
            # A stage passes nothing beyond its limit, but for an outlier, and cells that are alike
            # end alike under equal loads, too.
            if (
                at_end is None
                or np.sum(sign * volts - end > float(np.mean(width))) > 1
                or (counted is moved and _alike(scene, sign * resting, sign * end, width, at_end))
            ):
                continue
            near_end = np.broadcast_to(at_end, volt.shape) & (end - volt <= 2 * width)
            level = float(np.median(volt[near_end]))
            rail = max(sign * limit for limit in readout.range_volt)
            if rail - level < float(np.mean(width)):
                continue
            at_rest = int((np.abs(resting - level) <= width).sum())
            return Saturated(sign * level, int((at_end & moved).sum()), at_rest, sign > 0)
    return None


def _channels_at_end(volt: Array, counted: Mask, width: Array) -> Mask | None:
    """Return the channels at the largest voltage; None unless significantly more are than near it.

    Parameters
    ----------
    volt : array, shape (rows, columns)
        Voltages of the channels; NaN where there is none.
    counted : boolean array, shape (rows, columns)
        Channels that are tested.
    width : array
        Width within which voltages count as equal, V.
    """
    end = float(np.nanmax(volt, initial=-np.inf))
    extent = end - float(np.nanmin(volt, initial=end))
    below = np.where(counted, end - volt, np.inf)
    at_end = below <= width
    lines = min(int(at_end.any(axis=axis).sum()) for axis in (0, 1))
    count, with_next, near_end = (
        int((below <= reach * width).sum()) for reach in (1.0, 2.0, MIN_EXTENT)
    )
    # Binomial test: if the other channels within MIN_EXTENT were evenly spread, each would lie
    # within the first width with probability 1/MIN_EXTENT.
    chance = binomial_tail(count - 1, near_end - 1, 1 / MIN_EXTENT)
    # Small readings of dissimilar cells crowd near zero without a limit: in the next width, too.
    crowded = count >= MIN_CROWD * (with_next - count)
    wide = extent > MIN_EXTENT * float(np.mean(width))
    return at_end if wide and crowded and lines > 1 and chance < SIGNIFICANCE else None


def _alike(scene: Scene, resting: Array, end: float, width: Array, chosen: Mask) -> bool:
    """Return whether channels differ at rest by no more than two widths are worth at an end.

    Equal loads change ln r alike, and a reading near the end of its range hardly depends on it.

    Parameters
    ----------
    scene : Scene
    resting : array, shape (rows, columns)
        Voltages at rest.
    end : float
        Voltage under load.
    width : array
        Width within which voltages count as equal, V.
    chosen : boolean array, shape (rows, columns)
        The channels.
    """
    circuit = scene.circuit
    reach = 2 * float(np.mean(width))
    ends = [np.full(resting.shape, end + step) for step in (-reach, 0.0, reach)]
    with np.errstate(all="ignore"):
        recorded = circuit.recorded_from_volt(np.stack([resting, *ends]))
        apparent = circuit.apparent_resistance(circuit.from_recorded(recorded, scene))
        logarithm = np.log(apparent[:, chosen])
    at_end = np.abs(np.diff(logarithm[1:], axis=0)).max(axis=1)
    return bool(np.ptp(logarithm[0]) <= np.fmin.reduce(at_end))


def with_saturated_stage(recording: Recording) -> Recording:
    """Return the recording with a number for `passes_volt: estimated`.

    If frames show no saturated stage, the scene states None instead.
    """
    recording, _ = with_converter_ends(recording)
    readout = recording.scene.readout
    if readout is None or readout.passes_volt != ESTIMATED:
        return recording
    stage = saturated(recording)
    passes = None
    if stage is not None:
        least, most = readout.range_volt
        bounds = (least, stage.volt) if stage.highest else (stage.volt, most)
        passes = passed_range(bounds, readout.range_volt)
    return replace(
        recording, scene=replace(recording.scene, readout=replace(readout, passes_volt=passes))
    )


def passed_range(
    bounds: tuple[float, float], converted: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the part of a range of voltages that is within a converter's; None if it is empty.

    A stage is found from readings with noise, so that its limit may lie beyond the converter's.

    Returns
    -------
    (lowest, highest) : tuple of float, or None
        In volts.
    """
    low = max(bounds[0], converted[0])
    high = min(bounds[1], converted[1])
    return (low, high) if low < high else None


def _differ(volt: Array, width: float) -> Mask:
    """Return the channels whose row and column differ from every earlier line of their side.

    Shape (rows, columns). Lines that touch read equal voltages, which would be mistaken for a
    limit.

    Parameters
    ----------
    volt : array, shape (frames, rows, columns)
    width : float
        Width within which voltages count as equal, V.
    """
    differing = []
    volt = volt[:: max(len(volt) // COMPARED_FRAMES, 1)]
    for axis in (1, 2):
        lines = np.moveaxis(volt, axis, 0).reshape(volt.shape[axis], -1)
        with np.errstate(invalid="ignore"):
            differs = [
                np.any(np.abs(lines[:number] - line) > 2 * width, axis=1).all()
                for number, line in enumerate(lines)
            ]
        differing.append(np.array(differs))
    return np.asarray(differing[0][:, None] & differing[1])


def with_converter_ends(
    recording: Recording,
) -> tuple[Recording, tuple[float, float] | None]:
    """Replace `zero_volt: estimated` by a number.

    Returns
    -------
    recording : Recording
        With the estimate, or with the end of a scene without the key.
    zero : (float, float) or None
        The estimate and its standard deviation in volts; None where frames show none.
    """
    readout = recording.scene.readout
    converter = None if readout is None else readout.converter
    if readout is None or not isinstance(converter, Characteristic):
        return recording, None
    if converter.zero_volt != ESTIMATED:
        return recording, None
    zero = _zero_of_open_cells(recording) or _zero_of_still_cells(recording)
    ends = replace(converter, zero_volt=readout.zero_volt)
    return _recoded(recording, ends if zero is None else _with_zero(readout, zero[0])), zero


def _recoded(recording: Recording, ends: Characteristic) -> Recording:
    """Return the recording of the same codes with another converter."""
    given = Alternative(recording.scene, recording.recorded, recording.sigma)
    other = with_converter(given, "", {}, converter=ends)
    return replace(recording, recorded=other.recorded, scene=other.scene)


def _zero_of_open_cells(recording: Recording) -> tuple[float, float] | None:
    """Return the voltage of code 0 and its standard deviation; None where no cell is open."""
    readout = recording.scene.readout
    unloaded = recording.role == UNLOADED
    if readout is None or not unloaded.any() or readout.code_sign < 0:
        return None
    ends = nominal_terminations(readout)
    if ends.sign < 0 or getattr(readout, "measured_across", "reference") == "sensor":
        return None
    volt = readout.volt_from_recorded(recording.recorded[unloaded])
    codes = readout.steps_from_volt(volt)
    channels = codes.mean(axis=0)
    channels = channels[np.isfinite(channels)]
    if np.nanmin(recording.recorded) == np.nanmax(recording.recorded):
        return None  # nothing shows that these cells are open
    lowest = channels[channels <= channels.min(initial=np.inf) + TOGETHER]
    if len(lowest) < MIN_OPEN or lowest.mean() < 0.5:  # those at the rail are bounds
        return None
    spread = max(float(lowest.std()), 0.1) / np.sqrt(len(lowest))
    return (
        ends.recorded_reference - readout.lsb_volt * float(lowest.mean()),
        readout.lsb_volt * spread,
    )


def _with_zero(readout: Any, zero: float) -> Characteristic:
    """Return the converter of a readout whose code 0 stands for a voltage."""
    ends: Characteristic = readout.converter
    # An offset moves both ends
    full = readout.full_scale_volt + zero if ends.full_volt is None else ends.full_volt
    return replace(ends, zero_volt=zero, full_volt=full)


def _zero_of_still_cells(recording: Recording) -> tuple[float, float] | None:
    """Return the most probable voltage of code 0 and its standard deviation, by two frames.

    An error e of it is in all readings, so that ln r of still cells differ by a e between the
    unloaded panel and a loaded frame. Steps of Gauss-Newton remove it. The result is None where
    these frames do not determine it within ZERO_PRIOR, or cells do not explain them.
    """
    scene = recording.scene
    readout: Any = scene.readout
    if scene.panel.modules is not None or not (recording.role == UNLOADED).any():
        return None
    known = _recoded(recording, replace(readout.converter, zero_volt=readout.zero_volt))
    frames = ComparedFrames.of(known, np.zeros(known.recorded.shape, dtype=bool))

    def alternative_of(zero: float) -> Alternative:
        return with_converter(frames.specified, "zero", {}, converter=_with_zero(readout, zero))

    prior = ZERO_PRIOR * readout.full_scale_volt
    results = []
    for start in ZERO_STARTS:
        zero = start * readout.full_scale_volt
        for _ in range(MAX_ZERO_STEPS):
            explanation = Explanation.of(alternative_of(zero), frames, patient=True)
            if explanation is None or explanation.pair is None:
                break
            shifted = frames.readings(alternative_of(zero + ZERO_SECANT * prior))
            resting, loaded = (
                fit.response((moved.value - fit.measured.value)[None])
                for fit, moved in zip(explanation.fits, shifted, strict=True)
            )
            evidence = explanation.pair.explained((loaded - resting) / ZERO_SECANT)
            # The error of a voltage that is taken too high is positive
            step = -prior * evidence.size[1]
            sd = prior * evidence.sd[1]
            if not np.isfinite(step):
                break
            if abs(step) <= sd / 10 and all(fit.within_noise for fit in explanation.fits):
                results.append((explanation.score, zero, float(sd)))
                break
            zero = zero + float(np.clip(step, -prior, prior))
    _, zero, sd = min(results, default=(0.0, 0.0, np.inf))
    return (zero, sd) if sd < MAX_ZERO_SD * prior else None


class ConverterEnds(SceneEffect):
    """Ends of the converter, and of a stage before it that saturates.

    The keys are `readout.passes_volt` and `readout.converter.zero_volt`. Both ends are determined
    before any reading is taken.
    """

    def freed(self, recording: Recording) -> tuple[Recording, Mapping[str, Determined]]:
        """Return the recording with the ends of the converter and of the stage before it."""
        requested = recording.scene
        estimates = dict[str, Determined]()
        recording, zero = with_converter_ends(recording)
        if specified(requested, ZERO) == ESTIMATED:
            estimates[ZERO] = zero or (
                "no cells of the unloaded panel are open above the converter's end, and no load "
                "shows it by cells that stand still: press some cells"
            )
        recording = with_saturated_stage(recording)
        if specified(requested, PASSES) == ESTIMATED:
            estimates[PASSES] = specified(recording.scene, PASSES) or (
                "channels of its frames end at no common voltage: load more cells"
            )
        return recording, estimates

    def allowed(self, scene: Scene, key: str, number: float) -> float:
        """Return the end nearest to a determined one that a scene may state."""
        number = super().allowed(scene, key, number)
        if key != ZERO or scene.readout is None:
            return number
        # A zero farther off would leave less than half of the range, or a range beyond MAX_VOLT.
        full_scale = scene.readout.full_scale_volt
        most = min(full_scale / 2, MAX_VOLT - full_scale)
        return min(max(number, -most), most)

    def stated(self, scene: Scene, keys: Sequence[str], noise: NoiseEstimate) -> Scene:
        """Return the scene with the ends, which are those of its readout without a number."""
        readout: Any = scene.readout
        if PASSES in keys:
            passes = noise.estimated.get(PASSES)
            bounds = None if passes is None else passed_range(passes, readout.range_volt)
            readout = replace(readout, passes_volt=bounds)
        if ZERO in keys:
            readout = replace(readout, converter=_with_zero(readout, noise.number(ZERO) or 0.0))
        return replace(scene, readout=readout)

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield advice on a stage before the converter that saturates."""
        stage = saturated(prepared.cleaned.recording) if names_none(prepared, PASSES) else None
        if stage is not None:
            sentence = stage.sentence
            yield Unnamed(lambda _: sentence, estimated_entry(PASSES))
