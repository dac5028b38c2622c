"""A converter that remembers the channel before."""

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.scan_order import in_panel_order, in_scan_order, of_previous_channel

STEP_LSB = 1e-3  # of a voltage, for central differences


def with_memory(readout: Readout, fraction: float, volt: Array) -> Array:
    """Return the voltages V at a converter that keeps a share m of the previous channel's voltage.

        V_n = (1 − m)·U_n + m·V_(n−1)

    U are the true voltages. n counts the channels in scan order; the first channel of a frame
    follows the last one of the same frame.

    Parameters
    ----------
    readout : Readout
    fraction : float
        m.
    volt : array, shape (…, rows, columns)
        U in the panel's order.
    """
    channels = in_scan_order(readout, volt)
    # Periodic frame: the recursion is a product in the discrete Fourier transform, V(ω) = (1 −
    # m)/(1 − m e^−iω) U(ω).
    count = channels.shape[-1]
    delay = np.exp(-2j * np.pi * np.fft.rfftfreq(count))
    held = np.fft.rfft(channels) * (1 - fraction) / (1 - fraction * delay)
    return in_panel_order(readout, np.fft.irfft(held, count), volt.shape)


def without_memory(
    readout: Readout, fraction: float, recorded: Array, sigma: Array
) -> tuple[Array, Array]:
    """Return readings without the converter's memory, U_n = (V_n − m·V_(n−1))/(1 − m).

    U_n contains the noise of both voltages, √(1 + m²)/(1 − m) times that of one if they are equal.
    After a channel without a value (NaN), the remembered voltage is unknown: uniformly distributed
    over the converter's range.

    Parameters
    ----------
    readout : Readout
    fraction : float
        m.
    recorded, sigma : array, shape (…, rows, columns)
        Recorded values V and their standard deviations, in the readout's unit.

    Returns
    -------
    recorded, sigma : arrays, same shape
        Values U and their standard deviations, in the readout's unit.
    """
    least, most = readout.range_volt

    def slope(volt: Array) -> Array:
        """Return |∂recorded/∂V| by central differences.

        The differences are taken at least half an LSB away from the ends of the range.
        """
        step = STEP_LSB * readout.lsb_volt
        inside = np.clip(volt, least + readout.lsb_volt / 2, most - readout.lsb_volt / 2)
        ends = readout.recorded_from_volt(inside + step) - readout.recorded_from_volt(inside - step)
        return np.abs(ends) / (2 * step)

    # U_n = (V_n − m·V_(n−1))/(1 − m), with σ propagated to volt, through the difference, and back.
    volt = readout.volt_from_recorded(recorded)
    noise = sigma / slope(volt)
    previous = of_previous_channel(readout, volt)
    previous_noise = of_previous_channel(readout, noise)
    known = np.isfinite(previous)
    previous = np.where(known, previous, volt)
    previous_noise = np.where(known, previous_noise, (most - least) / np.sqrt(12))
    true = np.clip((volt - fraction * previous) / (1 - fraction), least, most)
    true_noise = np.hypot(noise, fraction * previous_noise) / (1 - fraction)
    return readout.recorded_from_volt(true), true_noise * slope(true)
