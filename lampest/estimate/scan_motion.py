"""Motion within a scan: loads that move while the readings of a frame are taken.

The readings are taken one after the other. A reading is taken at its own delay from the middle of
the frame, and the load has moved by then. The change within the delay is estimated from the steps
between frames, times the share of the time between frames that a scan takes. Frames that no cells
explain otherwise determine this share.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import fitted
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.files.levels import SIGNIFICANCE
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

SHARES = np.linspace(0, 1, 6)  # of the time between frames that a scan takes


def steps_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps of each reading from the previous and to the next measured frame.

    They are given times τ, shape (2, frames, …). τ is the delay of a reading from the middle of its
    frame, in periods, if a scan takes the whole period. The first and the last frame have one
    neighbour; frames that are not measured have 0. The mean of both steps is the change between the
    middle of a frame and a reading's own time. It is zero for a load that is present in a single
    frame, and the larger step is not.
    """
    steps = np.zeros((2, *readings.value.shape))
    channels = readings.value[0].size
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return steps * in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def share_of_motion(
    scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]
) -> tuple[float, float] | None:
    """Return the share of the time between frames that a scan takes.

    It is returned with its standard deviation; None where unknown. No cells explain the readings of
    a frame that was scanned while a load moved. The frames with the largest motion are fitted with
    σ² + (share · step · τ)², and their likelihood is compared over SHARES, all equally probable
    before. Of d degrees of freedom, readings that no cells follow,

        −2 ln p(share) = χ² + d · mean ln(1 + (share · step · τ/σ)²).

    Loads that no frame shows to move, or whose frames cells explain whatever the share, tell
    nothing of it.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return None
    steps = np.abs(steps_within_scan(scene, readings, measured)).max(axis=0)
    size = np.sqrt(np.mean((steps / readings.sigma) ** 2, axis=(1, 2)))
    moving = inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]
    base = fitted(scene, resting, patient=True)
    if base is None or base.tail < SIGNIFICANCE:
        return None
    costs = np.zeros(len(SHARES))
    broken = 0
    for frame in moving:
        near = None
        for number, share in enumerate(SHARES):
            widened = np.hypot(readings.known_sigma[frame], share * steps[frame])
            fit = fitted(scene, replace(readings[frame], sigma=widened), near, patient=True)
            if fit is None:
                return None
            near = fit.cells
            spread = float(np.mean(np.log(widened / readings.known_sigma[frame])))
            costs[number] += fit.chi_square + 2 * fit.degrees * spread
            broken += number == 0 and fit.tail < SIGNIFICANCE
    if not broken:
        return None
    odds = np.exp(-(costs - costs.min()) / 2)
    odds /= odds.sum()
    mean = float(odds @ SHARES)
    return mean, float(np.sqrt(max(float(odds @ SHARES**2) - mean**2, 0.0)))
