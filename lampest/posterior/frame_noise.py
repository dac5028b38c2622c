"""Random errors that all readings of a frame, or of one of its scanned lines, share, as columns V.

The error of a frame's readings is noise + V·z with standard normal z, independent for each frame.
Each effect of `EFFECTS` with sizes of a frame has columns of V.
"""

from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from scipy import linalg

from lampest.files.applications import loaded
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.sizes import EFFECTS


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
    jitter : float
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
    effect_errors: Array | None = None
    _: KW_ONLY
    motion: Array = field(default_factory=lambda: np.zeros(0))
    jitter: float = 0.0
    resting: Array | None = None
    memory: float = 0.0

    def columns(self, measured: Array, *, baseline: bool) -> Array:
        """Return V, (frames · cells, n), for readings (frames, rows, columns).

        `baseline` states whether the first frame is the mean of the unloaded ones, whose random
        errors are smaller.
        """
        parts = []
        for number, frame in enumerate(measured):
            resting = baseline and number == 0
            columns = self._of_frame(frame, np.sqrt(max(self.unloaded, 1)) if resting else 1.0)
            if self.effect_errors is not None:
                fractions = self.effect_errors[0 if resting else 1] * frame
                columns = np.column_stack([columns, fractions.reshape(len(fractions), -1).T])
            parts.append(columns)
        return np.asarray(linalg.block_diag(*parts))

    def _of_frame(self, measured: Array, averaging: float) -> Array:
        """Return V, (cells, n), for one frame's readings (rows, columns).

        The mean of frames has random errors smaller by the factor `averaging`.
        """
        circuit = self.scene.circuit
        volt = circuit.volt_from_recorded(circuit.to_recorded(measured, self.scene))
        # Changes of voltages stay within half of the distance to the ends of the converter's range.
        lower, upper = circuit.range_volt
        most = 0.5 * np.minimum(volt - lower, upper - volt)
        parts = list[Array]()
        for listed in EFFECTS:
            sizes = [getattr(self, name) for name in listed.of_frames]
            some = any(np.any(size) for size in sizes if size is not None)
            if not sizes or (parts and not some):
                continue
            effect = loaded(listed.path)()
            changes = effect.columns(circuit, volt if effect.in_volt else measured, *sizes)
            if effect.in_volt:
                changes = np.clip(changes, -most, most)
                above, below = (
                    circuit.from_recorded(circuit.recorded_from_volt(volt + side), self.scene)
                    for side in (changes, -changes)
                )
                changes = (above - below) / 2
            columns = changes.reshape(len(changes), measured.size).T
            parts.append(columns / averaging if effect.averages else columns)
        return np.column_stack(parts)
