"""Motion within a scan: loads that move while the readings of a frame are taken.

The readings are taken one after the other. A reading is taken at its own delay from the middle of
the frame, and the load has moved by then. The load displaces all readings of a frame along one
known direction: the steps between frames, times each reading's delay, times the share of the time
between frames that a scan takes. The readings are interpolated to the middle of the scan. Cells
that no load touches determine the share: a wrong one makes them move.

The displacement has errors, too, where a load moves unevenly between two frames. The still cells
then seem stillest at less than the scan's share, as the slope of a regression is attenuated by
errors of its variable (Fuller, Measurement Error Models, 1987, section 1.1).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import CellsFit, fitted
from lampest.estimate.changed_cells import mostly_still, usual_starts
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.estimate.fitted_pair import FittedPair
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings

SHARES = np.linspace(0, 1, 6)  # of the time between frames that a scan takes
# Error of a value interpolated between two frames, over √(τ(1 − τ)) times the second difference of
# the frames: 0.7 for a change at once, 0.2 to 0.4 for one that takes a frame or longer.
INTERPOLATION_ERROR = 0.5


class Share(NamedTuple):
    """Share of the time between frames that a scan takes.

    Attributes
    ----------
    mean, deviation : float
        Share at which still cells are stillest, and its standard deviation as that of the scan.
    reach : float
        Mean of the share without attenuation: the interpolation is wrong over that time.
    gain : float
        Decrease of −2 ln evidence from no share to the best one.
    """

    mean: float
    deviation: float
    reach: float
    gain: float = 0.0


# Of a scan of which nothing is known: it may take the whole time, and readings stay as they are.
UNKNOWN_SHARE = Share(mean=0.0, deviation=1.0, reach=0.0)


def _steps(readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps of each reading from the previous and to the next measured frame.

    Their shape is (2, frames, …). The first and the last frame have one neighbour, and its step
    twice; frames that are not measured have 0.
    """
    steps = np.zeros((2, *readings.value.shape))
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    return steps


def _delays(scene: Scene, readings: Readings) -> Array:
    """Return τ of each reading, shape (1, …).

    It is the delay from the middle of its frame, in periods, if a scan takes the whole period.
    """
    channels = readings.value[0].size
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


class Displacement(NamedTuple):
    """Displacement of each reading by motion, if a scan takes the whole period.

    Attributes
    ----------
    value : array
        Displacement, in the shape and unit of the readings.
    doubt : array
        Its standard deviation beside noise.
    weight : array
        Share of the neighbouring frame in a reading less its displacement.
    """

    value: Array
    doubt: Array
    weight: Array

    @property
    def smooth(self) -> Array:
        """Doubt of a motion without jumps: √(|τ|/(1 − |τ|)) times the doubt."""
        return np.asarray(self.doubt * np.sqrt(self.weight / (1 - self.weight)))


def displacement(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Displacement:
    """Return the displacement of each reading by motion, if a scan takes the whole period.

    A reading that was taken late is displaced by τ times the step from the previous frame, an early
    one by τ times the step to the next frame: a reading less its displacement is between two
    measured ones. The doubt is √(|τ|(1 − |τ|)) times the difference of both steps beyond its noise,
    times INTERPOLATION_ERROR, and √2 times that of the nearest frame where a frame has one
    neighbour. Readings that are no values, or whose neighbours in time are none, are not displaced;
    their doubt is the larger step.
    """
    steps = _steps(readings, measured)
    delay = _delays(scene, readings)
    previous, following = steps * delay
    displaced = np.where(delay > 0, previous, following)
    between = np.sqrt(np.abs(delay) * (1 - np.abs(delay)))
    noise = np.zeros(1) if readings.sigma is None else readings.sigma
    # The difference of both steps is that of three frames, with the weights 1, −2 and 1.
    beyond_noise = np.maximum((steps[1] - steps[0]) ** 2 - 6 * noise**2, 0.0)
    doubt = INTERPOLATION_ERROR * between * np.sqrt(beyond_noise)
    if len(measured) > 2:
        doubt[measured[[0, -1]]] = np.sqrt(2) * doubt[measured[[1, -2]]]
    plain = readings.plain[measured]
    around = np.concatenate([plain[:1], plain, plain[-1:]])
    interpolated = np.zeros(displaced.shape, dtype=bool)
    if len(measured) > 2:
        interpolated[measured] = around[:-2] & plain & around[2:]
    larger_step = np.maximum(np.abs(previous), np.abs(following))
    return Displacement(
        np.where(interpolated, displaced, 0.0),
        np.where(interpolated, doubt, larger_step),
        np.where(interpolated, np.abs(delay), 0.0),
    )


def share_of_motion(
    scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]
) -> Share | None:
    """Return the share of the time between frames that a scan takes.

    None where it is unknown. A load that moves displaces all readings of a frame along one known
    direction, by share · displacement. Cells that no load touches seem to move by K times as much,
    K the inverse of the Jacobian. The evidence of the changes since rest is compared over SHARES,
    all equally probable before, for the frames with the largest motion. The reach is the share
    over the reliability of the displacements, 1 − Σ errors²/Σ displacements², at most the whole
    time.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return None
    if scene.panel.crossings > MAX_CELLS:
        return None
    moved = displacement(scene, readings, measured)
    size = np.sqrt(np.mean((moved.value / readings.known_sigma) ** 2, axis=(1, 2)))
    base = fitted(scene, resting, patient=True)
    costs = np.zeros(len(SHARES))
    counted = 0
    near = None
    # Sums of squares in σ².
    displacements = errors = 0.0
    for frame in inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]:
        fit = fitted(scene, readings[frame], near, patient=True)
        if base is None or fit is None:
            return None
        near = fit.cells
        of_frame = Displacement(*(part[frame] for part in moved))
        cost, still = _costs((base, fit), of_frame)
        if still:
            costs += cost
            counted += 1
            noise = readings.known_sigma[frame]
            displacements += float(np.sum((of_frame.value / noise) ** 2))
            errors += float(np.sum((of_frame.smooth / noise) ** 2))
    if not counted:
        return None
    odds = np.exp(-(costs - costs.min()) / 2)
    odds /= odds.sum()
    mean = float(odds @ SHARES)
    # A share between two of those compared is known to a uniform distribution at best.
    variance = max(float(odds @ SHARES**2) - mean**2, 0.0) + (SHARES[1] - SHARES[0]) ** 2 / 12
    # Below the smallest share any share may be the whole time.
    reliable = max(displacements - errors, SHARES[1] * displacements)
    unattenuated = np.minimum(SHARES * displacements, SHARES[-1] * reliable)
    reach = float(odds @ unattenuated) / reliable if reliable else mean
    # The share of the scan is anywhere between both.
    variance += (reach - mean) ** 2 / 3
    return Share(mean, float(np.sqrt(variance)), reach, float(costs[0] - costs.min()))


def _costs(fits: tuple[CellsFit, CellsFit], displaced: Displacement) -> tuple[Array, bool]:
    """Return −2 ln evidence over SHARES, (shares,), and whether most cells are still.

    A reading y less its displacement, z = (1 − w) y + w yₙ, is a mean with the neighbouring frame.
    Its variance is σ²((1 − w)² + w²), and p(y) = (1 − w) p(z): without both, every mean of frames
    would seem to be motion. Cells count as still without the doubt of the interpolation: with it,
    everything may be still.

    Parameters
    ----------
    fits : tuple of two CellsFit
        The unloaded panel and a frame.
    displaced : Displacement
        That of the frame, (rows, columns).
    """
    frame = fits[1]
    changes = FittedPair(fits).with_columns(np.zeros((displaced.value.size, 0)))
    moved = frame.response(displaced.value[None])[:, 0]
    weight = displaced.weight.ravel()
    noise = frame.readings.known_sigma.ravel()
    # The evidence takes motion as smooth: a wider doubt would favour small shares.
    smooth = displaced.smooth.ravel()
    costs = []
    exact = []
    starts = usual_starts(changes.change)
    for share in SHARES:
        # variance of the mean with the neighbouring frame, over that of the reading
        remaining = (1 - share * weight) ** 2 + (share * weight) ** 2
        averaged = frame.gain * (noise * np.sqrt(1 - remaining))
        doubt = share * frame.gain * smooth
        exact.append(replace(changes, change=changes.change - share * moved))
        doubted = replace(exact[-1], noise=changes.noise - averaged @ averaged.T + doubt @ doubt.T)
        cost, cells_moved = doubted.selected(starts)
        # A share moves few cells beyond those of the share before it.
        starts = [cells_moved, np.zeros_like(cells_moved)]
        # Moved cells are free, and take as many readings out of the density.
        counted = 1 - np.mean(cells_moved)
        costs.append(cost - 2 * counted * np.sum(np.log(1 - share * weight)))
    best = exact[int(np.argmin(costs))]
    return np.array(costs), mostly_still(best.selected(starts)[1])
