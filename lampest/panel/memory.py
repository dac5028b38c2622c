"""Memory of a converter: its sampling capacitor keeps a part of the previous channel's charge.

    V_n = (1 − m)·U_n + m·V_(n−1)

U_n : voltage of the n-th channel in scan order. m : remembered fraction. The first channel of a
frame follows the last one of the same frame. All voltages at the converter, (…, rows, columns) in the panel's order.
"""

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts import Readout


def with_memory(readout: Readout, fraction: float, volt: Array) -> Array:
    """V of U, volt."""
    channels = in_scan_order(readout, volt)
    held, last = np.empty_like(channels), np.zeros(channels.shape[:-1])
    for number in range(channels.shape[-1]):
        last = held[..., number] = (1 - fraction) * channels[..., number] + fraction * last
    # What would have been left of the last channel had it been held before the first: the ring closes.
    fading = fraction ** np.arange(1, channels.shape[-1] + 1)
    held += fading * (last / (1 - fading[-1]))[..., None]
    return in_panel_order(readout, held, volt.shape)


def without_memory(readout: Readout, fraction: float, recorded: Array, sigma: Array) -> tuple[Array, Array]:
    """Return recorded readings without memory, and their σ: U_n = (V_n − m·V_(n−1))/(1 − m).

    recorded, sigma : of the same shape, in the readout's unit. Both voltages' noise is in U_n: (1 + m²)^½/(1 − m) times
    as much where they have the same. After a channel that says nothing (NaN), any voltage may be remembered.
    """

    def before_it(values: Array) -> Array:
        return in_panel_order(readout, np.roll(in_scan_order(readout, values), 1, axis=-1), values.shape)

    def slope(volt: Array) -> Array:
        """|∂recorded/∂V|, half a step of the converter within the supply where V is at its ends."""
        step = 1e-3 * readout.lsb_volt
        inside = np.clip(volt, readout.lsb_volt / 2, readout.full_scale_volt - readout.lsb_volt / 2)
        ends = readout.recorded_from_volt(inside + step) - readout.recorded_from_volt(inside - step)
        return np.abs(ends) / (2 * step)

    volt = readout.volt_from_recorded(recorded)
    noise = sigma / slope(volt)
    before, noise_before = before_it(volt), before_it(noise)
    unknown = ~np.isfinite(before)
    before = np.where(unknown, volt, before)
    noise_before = np.where(unknown, readout.full_scale_volt / np.sqrt(12), noise_before)
    freed = np.clip((volt - fraction * before) / (1 - fraction), 0.0, readout.full_scale_volt)
    return readout.recorded_from_volt(freed), np.hypot(noise, fraction * noise_before) / (1 - fraction) * slope(freed)


def in_scan_order(readout: Readout, values: Array) -> Array:
    """(…, rows, columns) → (…, channels)."""
    turned = values.swapaxes(-1, -2) if readout.by_columns else values
    return turned.reshape(*values.shape[:-2], -1)


def in_panel_order(readout: Readout, channels: Array, shape: tuple[int, ...]) -> Array:
    """(…, channels) → (…, rows, columns)."""
    if not readout.by_columns:
        return channels.reshape(shape)
    return channels.reshape(*shape[:-2], shape[-1], shape[-2]).swapaxes(-1, -2)
