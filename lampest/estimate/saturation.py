"""Detection of a stage before the converter that saturates.

Significantly more channels end at one voltage than near it. The readings there are bounds, as at a
rail.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.converter_zero import with_converter_ends
from lampest.files.levels import NOISE_REACH, OUTLIER_THRESHOLD, SIGNIFICANCE
from lampest.panel.panel import Array
from lampest.panel.sizes import ESTIMATED
from lampest.posterior.interval import binomial_tail
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, UNLOADED, Recording

# In widths within which voltages count as equal: least range of the channels; within a smaller one
# all are alike.
MIN_EXTENT = 10.0
COMPARED_FRAMES = 8  # frames, about, in which the voltages of lines are compared


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
            "does a stage before the converter saturate there? Then name it: readout: "
            "{passes_volt: estimated}"
        )


def saturated(recording: Recording) -> Saturated | None:
    """Return the voltage at which several channels end.

    None where there is none, or where the scene states one. Channels that moved under load are
    tested by their largest or smallest voltage over the measured frames, all channels by their
    unloaded voltage.
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
    width = NOISE_REACH * readout.sigma_volt()
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
            if at_end is not None:
                end = float(np.nanmax(channels, initial=-np.inf))
                near_end = np.broadcast_to(at_end, volt.shape) & (end - volt <= 2 * width)
                level = float(np.median(volt[near_end]))
                at_rest = int((np.abs(resting - level) <= width).sum())
                return Saturated(sign * level, int((at_end & moved).sum()), at_rest, sign > 0)
    return None


def _channels_at_end(
    volt: Array, counted: NDArray[np.bool_], width: Array
) -> NDArray[np.bool_] | None:
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
    near_end = int((below <= MIN_EXTENT * width).sum())
    # Binomial test: if the other channels within MIN_EXTENT were evenly spread, each would lie
    # within the first width with probability 1/MIN_EXTENT.
    chance = binomial_tail(int(at_end.sum()) - 1, near_end - 1, 1 / MIN_EXTENT)
    if extent > MIN_EXTENT * float(np.mean(width)) and lines > 1 and chance < SIGNIFICANCE:
        return at_end
    return None


def with_saturated_stage(recording: Recording) -> Recording:
    """Return the recording with a number for `passes_volt: estimated`.

    None in its place where its frames show none.
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
    """Return the part of a range of voltages that is within a converter's, V; None if it is empty.

    A stage is found from readings with noise, so that its limit may lie beyond the converter's.
    """
    low = max(bounds[0], converted[0])
    high = min(bounds[1], converted[1])
    return (low, high) if low < high else None


def _differ(volt: Array, width: float) -> NDArray[np.bool_]:
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
