"""Creep: a change of all cells alike since the unloaded frames, which no load makes."""

from collections.abc import Iterator

import numpy as np

from lampest.files.levels import SIGNIFICANT
from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import fitted
from lampest.inference.effects.effect import SceneEffect, Unnamed, names_none
from lampest.inference.evidence import MIN_STILL_SHARE, mostly_still, touching
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides
from lampest.inference.pair import FittedPair
from lampest.inference.prepared import Prepared
from lampest.panel.effects.creep import FilmCreep
from lampest.panel.sizes import ESTIMATED
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.recording import MEASURED, UNLOADED, Recording


class CommonCreep(SceneEffect):
    """A common change of all cells: `creep`."""

    def resolve(
        self, noise: NoiseEstimate, recording: Recording, besides: Besides
    ) -> NoiseEstimate:
        """Determine the change of all cells alike since the unloaded frames.

        The cells that no load touches determine it.
        """
        scene = recording.scene
        readings = noise.readings
        if scene.creep != ESTIMATED:
            return noise
        unloaded = recording.role == UNLOADED
        measured = np.flatnonzero(recording.role == MEASURED)
        measured = measured[(readings.seen[measured] > 0).any(axis=(1, 2))]
        if readings.sigma is None or not unloaded.any() or not len(measured):
            return noise.undetermined(
                "creep", "record unloaded frames, and frames whose load leaves cells free"
            )
        if scene.panel.crossings > MAX_CELLS:
            return noise.undetermined("creep", f"the panel has more than {MAX_CELLS} cells")
        resting = readings[unloaded].mean()
        near = noise.resting_cells
        base = fitted(scene, resting, near, patient=True)
        last = fitted(scene, readings[int(measured[-1])], near, patient=True)
        if base is None or last is None:
            return noise.undetermined(
                "creep", "no cells explain the unloaded panel and the last frame"
            )
        pair = FittedPair((base, last))
        change, deviation = common_change(pair, noise.frame)
        if not mostly_still(pair.evidence.moved) or not np.isfinite(change):
            return noise.undetermined(
                "creep", "the load touches most cells: record a frame with less load at the end"
            )
        return noise.determined("creep", (change, deviation))

    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Yield a common change of all cells that errors of the frames do not explain."""
        named = not names_none(prepared, "creep", "temperature", "film")
        if named or not prepared.effects.common_change:
            return
        panels = prepared.panels
        if panels is not None and not panels.clear:
            return  # another one of the panels that read alike may be meant
        explanation = prepared.question.explanation
        if explanation is not None and explanation.pair is not None:
            pair = explanation.pair
            # The tail of a load changes the cells beside it alike.
            if touching(pair.moved[None]).mean() > 1 - MIN_STILL_SHARE:
                return
            change, deviation = common_change(pair, prepared.noise.frame)
            if abs(change) < SIGNIFICANT * deviation:
                return
        yield Unnamed.of(FilmCreep().sentence, "creep")


def common_change(pair: FittedPair, noise: FrameNoise | None) -> tuple[float, float]:
    """Return the change of ln r of all cells that no load touches, and its standard deviation.

    Errors that the readings of a frame share, such as its gain, change all cells, too, and so does
    the second order of noise, by up to half the variance of ln r.

    Parameters
    ----------
    pair : FittedPair
    noise : FrameNoise or None
        These errors.
    """
    change, deviation = (
        float(ASSUMED.common_change * part[0]) for part in (pair.evidence.size, pair.evidence.sd)
    )
    still = ~pair.evidence.moved
    resting, loaded = (np.diag(frame.covariance)[still] for frame in pair.frames)
    if still.any():
        deviation = float(np.hypot(deviation, np.median(loaded - resting) / 2))
    if noise is None:
        return change, deviation
    for frame, baseline in zip(pair.frames, (True, False), strict=True):
        columns = noise.columns(frame.readings.value[None], baseline=baseline)
        by_error = (frame.gain @ columns)[still].mean(axis=0)
        deviation = float(np.hypot(deviation, np.linalg.norm(by_error)))
    return change, deviation
