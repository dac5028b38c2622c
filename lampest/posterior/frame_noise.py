"""Random errors that all readings of a frame, or of one of its scanned lines, share, as columns V.

The error of a frame's readings is noise + V·z with standard normal z, independent for each frame.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from lampest.panel.conditions import motion_patterns
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order, in_scan_order
from lampest.panel.scene import Scene


def motion_columns(measured: Array, motion: Array) -> Array:
    """Return the changes of readings (rows, columns) by motion of three sizes, (cells, 3)."""
    moved = motion[:, None, None] * motion_patterns(measured.shape) * measured
    return np.asarray(moved.reshape(len(moved), -1).T)


@dataclass(frozen=True, eq=False)
class FrameNoise:
    """Random errors that the readings of a frame share.

    Attributes
    ----------
    scene : Scene
        Scene with a readout, on whose converter the errors act.
    unloaded : int
        Number of frames of which the baseline is the mean.
    gain : float
        Relative standard deviation of a frame's gain, a common factor of its voltages.
    common_ripple, line_ripple : array, shape (channels of a scanned line, n)
        Ripple common to all lines, and of each line alone, in volt; see
        `lampest.inference.variance_components`.
    motion : array, shape (3,) or (0,)
        Relative standard deviations of the readings in the patterns of `motion_patterns`; of
        circuits that read resistances.
    trembling : float
        Relative standard deviation of the load at a time, about that at the middle of a scan.
    resting : array, shape (rows, columns), or None
        Readings of the unloaded panel, from which the load changes those of a frame.
    memory : float
        Standard deviation of the share of the channel before that a converter keeps.
    effect_errors : array, shape (2, n, rows, columns), or None
        Remaining errors of corrected effects, one standard deviation each, as fractions of the
        readings: in the unloaded panel, and in frames.
    """

    scene: Scene
    unloaded: int
    gain: float
    common_ripple: Array
    line_ripple: Array
    motion: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    trembling: float = field(default=0.0, kw_only=True)
    resting: Array | None = field(default=None, kw_only=True)
    memory: float = field(default=0.0, kw_only=True)
    effect_errors: Array | None = None

    def columns(self, measured: Array, *, baseline: bool) -> Array:
        """Return V, (frames · cells, n), for readings (frames, rows, columns).

        `baseline` states whether the first frame is the mean of the unloaded ones, whose random
        errors are smaller.
        """
        parts = []
        for number, frame in enumerate(measured):
            resting = baseline and number == 0
            columns = self._of_frame(frame) / (np.sqrt(max(self.unloaded, 1)) if resting else 1.0)
            if self.memory:
                # A channel differs by the share of what it differs from the channel before.
                volt = self._volt(frame)
                channels = in_scan_order(self.scene.circuit, volt)
                before = in_panel_order(
                    self.scene.circuit, np.roll(channels, 1, axis=-1), volt.shape
                )
                columns = np.column_stack(
                    [columns, self._by_volt(volt, self.memory * (volt - before)[None])]
                )
            if self.effect_errors is not None:
                fractions = self.effect_errors[0 if resting else 1] * frame
                columns = np.column_stack([columns, fractions.reshape(len(fractions), -1).T])
            parts.append(columns)
        return np.asarray(linalg.block_diag(*parts))

    def _of_frame(self, measured: Array) -> Array:
        """Return V, (cells, n), for one frame's readings (rows, columns).

        The columns of V are central differences of the readout.
        """
        volt = self._volt(measured)
        changes = np.concatenate([self.gain * volt[None], self._patterns(measured.shape)])
        columns = self._by_volt(volt, changes)
        if self.motion.size:
            columns = np.column_stack([columns, motion_columns(measured, self.motion)])
        if self.trembling and self.resting is not None:
            columns = np.column_stack(
                [columns, (self.trembling * (measured - self.resting)).ravel()]
            )
        return columns

    def _volt(self, measured: Array) -> Array:
        """Return the voltages of readings."""
        circuit = self.scene.circuit
        return circuit.volt_from_recorded(circuit.to_recorded(measured, self.scene))

    def _by_volt(self, volt: Array, changes: Array) -> Array:
        """Return the changes of readings (cells, n) by those of the voltages (n, rows, columns)."""
        circuit = self.scene.circuit
        # Changes stay within half of the distance to the ends of the converter's range.
        lower, upper = circuit.range_volt
        most = 0.5 * np.minimum(volt - lower, upper - volt)
        changes = np.clip(changes, -most, most)
        ends = [
            circuit.from_recorded(circuit.recorded_from_volt(volt + sign * changes), self.scene)
            for sign in (1, -1)
        ]
        return np.asarray((ends[0] - ends[1]).reshape(len(changes), -1).T / 2)

    def _patterns(self, shape: tuple[int, ...]) -> Array:
        """Return the patterns of ripple in volt, (n, rows, columns).

        Patterns that are common to all lines precede those of each line alone.
        """
        lines, channels = shape[::-1] if self.scene.circuit.by_columns else shape
        common = np.repeat(self.common_ripple.T[:, None, :], lines, axis=1)
        by_line = np.zeros((lines, self.line_ripple.shape[1], lines, channels))
        for line in range(lines):
            by_line[line, :, line] = self.line_ripple.T
        flat = np.concatenate(
            [common.reshape(-1, lines * channels), by_line.reshape(-1, lines * channels)]
        )
        return in_panel_order(self.scene.circuit, flat, (len(flat), *shape))
