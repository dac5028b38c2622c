"""Readings that repeat: cells that are stuck, frames that are stored twice, lines read twice.

Noise tells them from readings that were taken: it changes these from frame to frame.
"""

from collections.abc import Sequence

import numpy as np

from lampest.files.levels import FALSE_ALARM_RATE, NOISE_REACH, SIGNIFICANCE
from lampest.inference.readings.outliers import MAX_SHARE
from lampest.panel.panel import Mask, Numbers
from lampest.panel.readouts.converter import states_noise
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_median, chi_square_tail
from lampest.recording.readings import Readings, line_differences
from lampest.recording.recording import Recording

# Of pairs or triples of frames, the quietest: loads that come and go disturb the remaining ones.
QUIET_SHARE = 0.25
# Share of readings that repeat in the next frame: 0.56 where noise is half a step. With
# FALSE_ALARM_RATE 3 of 19,000 simulated recordings without a frozen reading show one, and from a
# step of noise and 12 frames on all frozen ones are noticed.
MAX_REPEATED = 0.5


def frozen_readings(recording: Recording) -> Mask:
    """Flag readings that have one value in all frames although noise changes the other readings.

    Such a reading does not answer to loads, and moves the cells of its row and column. Let p be the
    share of the other readings that repeat in the next frame, in the quarter of the frames in which
    most do. A measured reading repeats in all pairs of frames with the probability p^pairs, if p is
    at most MAX_REPEATED. With less noise the probability depends on the place within a step of the
    converter, and none is flagged. Readings at a rail are bounds.

    Returns
    -------
    boolean array, shape (rows, columns)
    """
    value = recording.readings().plain_values
    finite = np.isfinite(value)
    smallest = np.where(finite, value, np.inf).min(axis=0)
    largest = np.where(finite, value, -np.inf).max(axis=0)
    constant = smallest == largest
    pairs = finite[1:] & finite[:-1]
    compared = pairs & ~constant
    count = compared.sum(axis=(1, 2))
    repeated = ((value[1:] == value[:-1]) & compared).sum(axis=(1, 2))
    many_constant = constant.sum() > max(1.0, MAX_SHARE * constant.size)
    if not constant.any() or not count.any() or many_constant:
        return np.zeros(constant.shape, dtype=bool)
    shares = np.sort(np.maximum(repeated, 1)[count > 0] / count[count > 0])
    quiet_frames = max(1, round(QUIET_SHARE * len(shares)))
    share = float(shares[-quiet_frames:].mean())
    chance = constant.size * share ** pairs.sum(axis=0)
    return np.asarray(constant & (share <= MAX_REPEATED) & (chance < FALSE_ALARM_RATE))


def repeated_frames(recording: Recording) -> Numbers:
    """Return the frames that equal the one before in every reading.

    Frames count as repeated only where noise changes some readings in nearly all others. Frames
    without a value are no copies.
    """
    value = recording.recorded[:, recording.scene.requested]
    compared = np.isfinite(value[1:]) & np.isfinite(value[:-1])
    same = (value[1:] == value[:-1]) & compared
    counts = compared.sum(axis=1)
    if len(value) < 3 or not counts.any():
        return np.zeros(0, dtype=np.intp)
    shares = same.sum(axis=1) / np.maximum(counts, 1)
    copies = (shares == 1) & (counts > 0)
    shares_of_others = shares[~copies & (counts > 0)]
    if not copies.any() or not len(shares_of_others):
        return np.zeros(0, dtype=np.intp)
    # probability that noise repeats all readings of a frame by chance, if the largest share of the
    # others is usual, or that of the specified noise where a load changes the others
    share = max(float(shares_of_others.max()), _specified_share(recording.scene))
    chance = len(copies) * share ** int(np.median(counts))
    return np.flatnonzero(copies) + 1 if chance < SIGNIFICANCE else np.zeros(0, dtype=np.intp)


def _specified_share(scene: Scene) -> float:
    """Return the share of readings that specified noise repeats in the next frame; 0 without any.

    Two codes with noise of s steps differ with the probability 2 s/√π where s is small, at places
    that are uniform within a step. A mean of n codes is repeated where all of them are.
    """
    readout = scene.readout
    if readout is None or not states_noise(readout):
        return 0.0
    steps = readout.readings * float(np.min(readout.assumed_noise))
    return float(np.exp(-2 * steps / np.sqrt(np.pi)))


def repeat_each_other(readings: Readings, unloaded: Mask, groups: Sequence[Sequence[int]]) -> bool:
    """Return whether rows whose readings are equal are not so by chance.

    Loads in the middle of a uniform film make lines equal, and films do not. The difference of two
    lines of n cells has a mean, in which floating lines differ most, and a remainder with n − 1
    degrees of freedom. Where neighbours that differ have variances f and g of these in the units of
    noise, and the film's mean square difference is at most e, two lines are equal by chance with
    p = P(χ²₁ < n e/f) P(χ²ₙ₋₁ < n e/g). Of k groups among m lines all are with (m² p/2)^k. Of each
    group one line counts.

    Parameters
    ----------
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)
    groups : sequence
        Rows that are equal in every frame.
    """
    copies = [line for group in groups for line in group[1:]]
    at_rest = readings[unloaded]
    lines, cells = at_rest.value.shape[1:]
    others = np.setdiff1d(np.arange(lines), copies)
    if not copies or len(others) < 2:
        return False
    unlike, count = line_differences(readings)
    observed = max(unlike[group[0], line] for group in groups for line in group[1:]) - 1
    equal = max(float(observed), 0.0) + NOISE_REACH * np.sqrt(2 / max(int(count.max()), 1))
    resting = at_rest.mean()
    noise = np.hypot(resting.known_sigma[others[1:]], resting.known_sigma[others[:-1]])
    film = np.diff(resting.value[others], axis=0) / (noise * np.sqrt(len(at_rest.value)))
    common = film.mean(axis=1, keepdims=True)
    parts = ((cells * common**2, 1), (np.sum((film - common) ** 2, axis=1), cells - 1))
    chance = 1.0
    for squares, degrees in parts:
        usual = float(np.median(squares)) / chi_square_median(degrees)
        chance *= 1 - float(chi_square_tail(cells * equal / usual, degrees))
    return bool((lines**2 / 2 * chance) ** len(groups) < SIGNIFICANCE)
