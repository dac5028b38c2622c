"""Errors that all readings of a frame, or of one of its scanned lines, have in common by chance, as columns V.

A frame's readings err by noise + V·z with z standard normal, drawn for each frame.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene


@dataclass(frozen=True, eq=False)
class FrameNoise:
    """Errors that the readings of a frame share by chance.

    Attributes
    ----------
    scene : Scene
        With a readout, whose converter it acts on.
    unloaded : int
        Frames that the baseline is the mean of.
    gain : float
        Standard deviation of the factor of a frame's voltages, as a fraction.
    common_ripple, line_ripple : array, shape (channels of a scanned line, n)
        Volt, see `lampest.estimate.scatter`.
    effect_errors : array or None
        (2, n, rows, columns) what effects that are taken off leave, as fractions of the readings, one standard
        deviation each: in the unloaded panel, and in frames.
    """

    scene: Scene
    unloaded: int
    gain: float
    common_ripple: Array
    line_ripple: Array
    effect_errors: Array | None = None

    def columns(self, measured: Array, *, baseline: bool) -> Array:
        """V (frames · cells, n) of readings (frames, rows, columns); baseline : the first is the unloaded mean."""
        parts = [self._of_frame(frame) for frame in measured]
        if baseline:
            parts[0] = parts[0] / np.sqrt(self.unloaded)
        if self.effect_errors is not None:
            each = [
                self.effect_errors[int(number > 0 or not baseline)] * frame for number, frame in enumerate(measured)
            ]
            parts = [
                np.column_stack([part, fraction.reshape(len(fraction), -1).T])
                for part, fraction in zip(parts, each, strict=True)
            ]
        return np.asarray(linalg.block_diag(*parts))

    def _of_frame(self, measured: Array) -> Array:
        """V (cells, n) of one frame's readings (rows, columns): differences of the readout's own equations."""
        circuit = self.scene.circuit
        volt = circuit.volt_from_recorded(circuit.to_recorded(measured, self.scene))
        changes = np.concatenate([self.gain * volt[None], self._patterns(measured.shape)])
        most = 0.5 * np.minimum(volt, circuit.full_scale_volt - volt)
        changes = np.clip(changes, -most, most)
        ends = [
            circuit.from_recorded(circuit.recorded_from_volt(volt + sign * changes), self.scene) for sign in (1, -1)
        ]
        return np.asarray((ends[0] - ends[1]).reshape(len(changes), -1).T / 2)

    def _patterns(self, shape: tuple[int, ...]) -> Array:
        """(n, rows, columns) volt: those of all lines, then those of each line."""
        lines, channels = shape[::-1] if self.scene.circuit.by_columns else shape
        common = np.repeat(self.common_ripple.T[:, None, :], lines, axis=1)
        own = np.zeros((lines, self.line_ripple.shape[1], lines, channels))
        for line in range(lines):
            own[line, :, line] = self.line_ripple.T
        flat = np.concatenate([common.reshape(-1, lines * channels), own.reshape(-1, lines * channels)])
        return in_panel_order(self.scene.circuit, flat, (len(flat), *shape))
