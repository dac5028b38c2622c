"""Loads on a panel at rest: in its unloaded frames, or before any frame."""

import numpy as np

from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.circuits.explanation import noise_factor
from lampest.inference.variance_components import NO_RIPPLE
from lampest.panel.panel import Array, Panel
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.recording import UNLOADED, Recording

# Relative standard deviation of a frame's gain that is no sign of a load
# (tests/oracles/test_noise.py).
MAX_GAIN = 0.1


def lies_on(panel: Panel, logarithm: Array) -> bool:
    """Return whether unloaded cells, ln r (rows, columns), are uneven in the shape of a load."""
    from lampest.apps.recognition.disc_search import DiscSearch
    from lampest.apps.recognition.observation import patch_of

    return DiscSearch.over(panel, patch_of(panel)).lies_on(logarithm)


@ONE_BLAS_THREAD
def touched(recording: Recording) -> bool:
    """Return whether a load came or left in the unloaded frames.

    The result is False where they scatter as specified. Their gain may vary by MAX_GAIN, as with
    the supply, and water may move them.
    """
    if recording.scene.panel.modules is not None:
        return any(touched(module) for module in recording.modules)
    unloaded = recording.readings()[recording.role == UNLOADED]
    scene = recording.scene
    few = len(unloaded.value) < 2
    if scene.readout is None or few or noise_factor(unloaded) == 1:
        return False
    # for the few recordings whose unloaded frames scatter more
    from lampest.apps.recognition.model_errors import ModelErrors
    from lampest.apps.recognition.watch import MAX_CELLS, Watch
    from lampest.apps.recognition.watch_parts import WatchSetup

    if scene.panel.crossings > MAX_CELLS:
        return False
    supply = FrameNoise(
        scene, len(unloaded.value), MAX_GAIN, NO_RIPPLE, NO_RIPPLE, motion=np.zeros(3)
    )
    setup = WatchSetup.of(scene, ModelErrors().of_scene(scene, 0.0), noise=supply)
    sigma = np.min(np.where(unloaded.plain, unloaded.known_sigma, np.inf), axis=0)
    values = unloaded.plain_values
    return Watch.begin(setup, unloaded.mean().value, sigma, values, 0.0).touched(values)
