"""The converter's smooth deviation from a straight line, its integral nonlinearity."""

import numpy as np

from lampest.panel.effects import SharedEffect
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout
from lampest.panel.scene import Scene

# Sines of which a converter's curve consists; the mean square of their sum is the specified one.
SINES = 4


class ConverterCurve(SharedEffect):
    """A converter's curve, in least significant bits."""

    setting = "inl_lsb"
    name = "curve"
    limits = (0.0, 2.0**32)
    # rms; data sheets of microcontrollers' converters promise 1 to 2 at most, that of an ATmega2560
    # 0.5.
    prior: float = 0.5
    stream = "inl"
    is_typical = True
    is_advised = False

    def columns(self, network: Network, measured: Array, scene: Scene, size: float) -> Array:
        """Return sines of ½, 1, 1½ and 2 periods over the converter's range; none without one."""
        if scene.readout is None:
            return np.zeros((0, *measured.shape))
        circuit = scene.circuit
        volt = circuit.volt_from_recorded(circuit.to_recorded(measured, scene))
        height = size * circuit.lsb_volt * np.sqrt(2 / SINES)
        least, most = circuit.range_volt
        # √(2/SINES)·size·LSB·sin(π k V/V_full), k = 1, …, SINES: the mean square of the sum over
        # the range is size²·LSB²
        waves = height * np.sin(
            np.pi * np.multiply.outer(np.arange(SINES) + 1, (volt - least) / (most - least))
        )
        above = circuit.from_recorded(circuit.recorded_from_volt(volt + 0.5 * waves), scene)
        below = circuit.from_recorded(circuit.recorded_from_volt(volt - 0.5 * waves), scene)
        return above - below

    def disturbed(
        self,
        readout: Readout,
        volt: Array,
        random: np.random.Generator,
        period_s: float,
        *sizes: float,
    ) -> Array:
        """Return simulated voltages with a drawn curve, (frames, rows, columns)."""
        (inl_lsb,) = sizes
        weights = random.standard_normal(SINES)

        def curve(at: Array) -> Array:
            """Return the drawn curve at shares of the converter's range."""
            waves = (
                weight * np.sin(np.pi * number * at) for number, weight in enumerate(weights, 1)
            )
            return sum(waves, np.zeros_like(at))

        largest = np.abs(curve(np.linspace(0, 1, 1001))).max()
        deviation = curve(volt / readout.full_scale_volt) / largest
        return np.asarray(volt + inl_lsb * readout.lsb_volt * deviation)
