"""Gain of a frame and ripple along a scan: errors that the readings of a frame share.

The unloaded frames determine the sizes of both, with the noise of the frames
(`lampest.inference.noise`).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from lampest.files.applications import loaded
from lampest.files.levels import SIGNIFICANCE
from lampest.inference.effects.effect import SceneEffect, Unnamed, names_none
from lampest.inference.noise import MIN_REQUESTED_FRAMES, NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.inference.variance_components import NO_RIPPLE, Scatter, unloaded_scatter
from lampest.panel.readouts.converter import mean_sigma
from lampest.panel.readouts.scan_order import by_columns
from lampest.panel.scene import Scene
from lampest.panel.sizes import ESTIMATED, SIZED, plain_size
from lampest.recording.recording import UNLOADED, Recording

# Of the assumed σ: unloaded frames that scatter less are equal but for rounding.
MIN_SCATTER = 1e-6
NO_SCATTER = "record two or more unloaded frames that differ by their noise"


class GainAndRipple(SceneEffect):
    """Errors that the readings of a frame share: `gain`, `ripple`."""

    def in_frames(
        self, noise: NoiseEstimate, recording: Recording, scatter: Scatter | None
    ) -> NoiseEstimate:
        """Return the noise of the frames with the sizes of the scene, or of the unloaded frames."""
        scene = recording.scene
        gain, ripple = (plain_size(size) or 0.0 for size in (scene.gain, scene.ripple))
        if scene.readout is not None and (gain or ripple):
            # a ripple that all lines share, independent from channel to channel
            channels = scene.panel.shape[0 if by_columns(scene.circuit) else 1]
            common = ripple * scene.circuit.lsb_volt * np.eye(channels) if ripple else NO_RIPPLE
            frame = replace(noise.of_frames(recording), gain=gain, common_ripple=common)
            noise = replace(noise, frame=frame)
        if scatter is None or scatter.own < MIN_SCATTER:
            for key in requested_keys(recording.scene):
                noise = noise.undetermined(key, NO_SCATTER)
            return noise
        return _with_estimated(noise, recording, scatter)

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield advice on gain and ripple, from the scatter of the unloaded frames."""
        recording = prepared.cleaned.recording
        scene = recording.scene
        readings = prepared.noise.readings
        unloaded = recording.role == UNLOADED
        unknown = scene.readout is None or readings.sigma is None or unloaded.sum() < 2
        if unknown or scene.readout is None or not names_none(prepared, "gain", "ripple"):
            return
        if readings.mostly_rounding:
            return  # single codes that change from frame to frame have no Gaussian scatter
        keys: dict[str, Any] = {key: ESTIMATED for key in ("gain", "ripple") if key in SIZED}
        estimated = replace(scene, **keys)
        estimating = replace(recording, scene=estimated)
        unscaled = replace(readings, sigma=readings.known_sigma / prepared.noise.sigma_factor)
        parts = unloaded_scatter(estimating, unscaled[unloaded])
        if parts is None:
            return
        significant = {
            "gain": parts.gain_tail < SIGNIFICANCE,
            "ripple": parts.ripple_tail < SIGNIFICANCE or parts.line_ripple.size > 0,
        }
        for key in keys:
            if significant[key]:
                yield Unnamed.of(loaded(SIZED[key])().sentence, key)


def requested_keys(scene: Scene) -> list[str]:
    """Return which of the keys `gain` and `ripple` a scene calls `estimated`."""
    return [key for key in ("gain", "ripple") if getattr(scene, key) == ESTIMATED]


def _with_estimated(noise: NoiseEstimate, recording: Recording, parts: Scatter) -> NoiseEstimate:
    """Return the noise with the gain and the ripple that the scene calls `estimated`.

    The unloaded frames determine both.
    """
    scene = recording.scene
    unloaded = int((recording.role == UNLOADED).sum())
    requested = requested_keys(scene)
    if not requested or scene.readout is None:
        return noise
    if unloaded < MIN_REQUESTED_FRAMES:
        for key in requested:
            noise = noise.undetermined(key, "record two or more unloaded frames")
        return noise
    deviations = {"gain": parts.gain_sd, "ripple": parts.ripple_sd}
    for key in [key for key in requested if not deviations[key]]:
        noise = noise.undetermined(key, "the panel has too few lines to tell it from noise")
        requested.remove(key)
    volt = float(np.mean(mean_sigma(scene.readout)))
    frame = noise.of_frames(recording)
    if "gain" in requested:
        frame = replace(frame, gain=float(np.hypot(parts.gain, parts.gain_sd)))  # √E[s²]
        noise = noise.determined("gain", (parts.gain, parts.gain_sd))
    if "ripple" in requested:
        frame = replace(
            frame, common_ripple=parts.common_ripple * volt, line_ripple=parts.line_ripple * volt
        )
        noise = replace(noise, frame=frame)
        _, common_lsb, line_lsb = noise.shared_sizes
        common_sd = parts.ripple_sd * volt / scene.circuit.lsb_volt
        # relative deviation of a standard deviation with as many degrees of freedom
        line_sd = line_lsb * (1 / np.sqrt(2 * (unloaded - 1)))
        size = float(np.hypot(common_lsb, line_lsb))
        noise = noise.determined("ripple", (size, float(np.hypot(common_sd, line_sd))))
    return replace(noise, frame=frame)
