"""Ripple along a scan: interference that the lines of a frame share, or that a line has alone."""

from typing import Any

import numpy as np

from lampest.panel.effects.sized_effect import SizedEffect
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.scan_order import by_columns, in_panel_order


class Ripple(SizedEffect):
    """A wave on the voltages of a scan; the size is its standard deviation in steps.

    It has no prior: the scatter of the unloaded frames shows its size.
    """

    unit = "LSB"
    limits = (0.0, 2.0**32)
    stream = "ripple"

    def sentence(self, size: float, deviation: float) -> str:
        return f"the lines of a scan vary together by {size:.2g} +- {deviation:.1g} LSB"

    def columns(self, circuit: Readout, values: Array, *sizes: Any) -> Array:
        """Return the patterns of ripple common to all lines, then those of each line alone.

        The sizes are roots of covariances in volt, (channels of a scanned line, n).
        """
        common_ripple, line_ripple = sizes
        lines, channels = values.shape[::-1] if by_columns(circuit) else values.shape
        common = np.repeat(common_ripple.T[:, None, :], lines, axis=1)
        by_line = np.einsum("kl,cn->knlc", np.eye(lines), line_ripple)
        flat = np.concatenate(
            [patterns.reshape(-1, lines * channels) for patterns in (common, by_line)]
        )
        return in_panel_order(circuit, flat, (len(flat), *values.shape))

    def disturbed(
        self,
        readout: Readout,
        volt: Array,
        random: np.random.Generator,
        period_s: float,
        *sizes: Any,
    ) -> Array:
        """Return V plus a sine of a drawn phase, whose amplitude is in steps.

        Without a frequency one period is as long as the scan of a line.
        """
        amplitude, hertz = sizes
        channels = volt[0].size
        periods = volt.shape[2 if by_columns(readout) else 1] if hertz is None else hertz * period_s
        time = (np.arange(channels) + 0.5) / channels * periods
        phase = random.uniform(0, 2 * np.pi, len(volt))
        wave = in_panel_order(readout, np.sin(2 * np.pi * time + phase[:, None]), volt.shape)
        return np.asarray(volt + amplitude * readout.lsb_volt * wave)
