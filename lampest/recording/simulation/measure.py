"""What the electronics make of a network: two-point resistance → divider, multiplexers, converter → readings."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lampest.panel.divider import (
    code_from_voltage,
    lsb_volt,
    resistance_from_sums,
    voltage_from_resistance,
)
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, TwoPointReadout
from lampest.recording.simulation.unmodelled import Unmodelled, stream

AT_ONCE = 64
MOST_RAW = np.iinfo(np.uint16).max


def measured(scene: Scene, network: Array, unmodelled: Unmodelled, seed: int) -> tuple[Array, NDArray[np.int64] | None]:
    """(R, Σ code): what the divider equation gives, and the sums of the ADC's codes, both (frames, rows, columns).

    R comes from the mean code with the nominal reference; the codes from the true one. Without a readout R is exact and
    there are no sums. `network` is the cells' two-point resistance in ohm.
    Raises ValueError where the spread of the channels leaves a reading without positive resistance.
    """
    total = network + scene.series_resistance_ohm + channel_error(scene, unmodelled, seed)
    if not np.all(total > 0):
        raise ValueError("unmodelled.channel_spread_ohm makes a resistance negative; give a series resistance above it")
    if scene.readout is None:
        return total, None
    sums = sums_of_codes(scene.readout, total, unmodelled, seed)
    return resistance_from_sums(scene.readout, sums, scene.readout.readings), sums


def channel_error(scene: Scene, unmodelled: Unmodelled, seed: int) -> Array:
    """δ + δ_j + δ_k: what is in series beyond what the scene tells, channels included; (rows, columns) ohm."""
    rows, columns = scene.panel.shape
    channel = unmodelled.channel_spread_ohm * stream(seed, "channels").standard_normal(rows + columns)
    return np.asarray(unmodelled.series_resistance_ohm + channel[:rows, None] + channel[None, rows:])


def sums_of_codes(readout: TwoPointReadout, total: Array, unmodelled: Unmodelled, seed: int) -> NDArray[np.int64]:
    """Σ over the readings of code(V + noise), (frames, rows, columns) ohm → 1; outliers are random codes."""
    off = unmodelled.reference_tolerance * stream(seed, "reference").uniform(-1, 1)
    actual = dataclasses.replace(readout, reference_ohm=readout.reference_ohm * (1 + off))
    noise, outliers = stream(seed, "noise"), stream(seed, "outliers")
    sigma = readout.noise_lsb * lsb_volt(readout)
    sums = np.empty(total.shape, dtype=np.int64)
    for frame, volt in enumerate(voltage_from_resistance(actual, total)):
        sums[frame] = 0
        for first in range(0, readout.readings, AT_ONCE):
            shape = (min(AT_ONCE, readout.readings - first), *volt.shape)
            codes = code_from_voltage(actual, volt + sigma * noise.standard_normal(shape))
            if unmodelled.outlier_probability > 0:
                hit = outliers.random(shape) < unmodelled.outlier_probability
                codes = np.where(hit, outliers.integers(0, 2**readout.adc_bits, shape), codes)
            sums[frame] += codes.sum(axis=0)
    return sums


def raw_sums(readout: TwoPointReadout | None, sums: NDArray[np.int64] | None) -> NDArray[np.uint16] | None:
    """The sums as a recording holds them; None where readings · (2^bits − 1) does not fit into 16 bits."""
    if readout is None or sums is None or readout.readings * (2**readout.adc_bits - 1) > MOST_RAW:
        return None
    return sums.astype(np.uint16)
