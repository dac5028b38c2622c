"""Gain of a frame and ripple along a scan: errors that the readings of a frame share.

The sizes of both are determined with the noise of the frames (`lampest.inference.noise`).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lampest.files.levels import SIGNIFICANCE
from lampest.inference.effects.effect import Gathered, SceneEffect, Unnamed
from lampest.inference.variance_components import unloaded_scatter
from lampest.panel.effects.gain import Gain
from lampest.panel.effects.ripple import Ripple
from lampest.panel.sizes import ESTIMATED


class GainAndRipple(SceneEffect):
    """Errors that the readings of a frame share: `gain`, `ripple`."""

    def unnamed(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Yield advice on gain and ripple, from the scatter of the unloaded frames."""
        scene = evidence.scene
        readings = evidence.noise.readings
        unloaded = evidence.unloaded
        unknown = scene.readout is None or readings.sigma is None or unloaded.sum() < 2
        if unknown or scene.readout is None or not evidence.names_none("gain", "ripple"):
            return
        if readings.mostly_rounding:
            return  # single codes that change from frame to frame have no Gaussian scatter
        estimated = replace(scene, gain=ESTIMATED, ripple=ESTIMATED)
        estimating = replace(evidence.recording, scene=estimated)
        unscaled = replace(readings, sigma=readings.known_sigma / evidence.noise.sigma_factor)
        parts = unloaded_scatter(estimating, unscaled[unloaded])
        if parts is None:
            return
        if parts.gain_tail < SIGNIFICANCE:
            yield Unnamed.of(Gain().sentence(parts.gain, parts.gain_sd), "gain")
        roots = np.hstack([parts.common_ripple, parts.line_ripple])
        if parts.ripple_tail < SIGNIFICANCE or parts.line_ripple.size:
            noise_lsb = np.mean(scene.readout.sigma_code())
            size = float(np.sqrt((roots**2).sum() / len(roots)) * noise_lsb)
            yield Unnamed.of(Ripple().sentence(size, 0.0), "ripple")
