"""Creep: a change of all cells alike since the unloaded frames, which no load makes."""

from collections.abc import Iterator

import numpy as np

from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import fitted
from lampest.inference.effects.effect import Gathered, SceneEffect, Unnamed
from lampest.inference.evidence import mostly_still
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides
from lampest.inference.pair import FittedPair
from lampest.panel.sizes import ESTIMATED
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
        if readings.sigma is None or not unloaded.any() or not len(measured):
            return noise.undetermined(
                "creep", "record unloaded frames, and frames whose load leaves cells free"
            )
        if scene.panel.crossings > MAX_CELLS:
            return noise.undetermined("creep", f"the panel has more than {MAX_CELLS} cells")
        resting = readings[unloaded].mean()
        base = fitted(scene, resting, patient=True)
        last = fitted(scene, readings[int(measured[-1])], patient=True)
        if base is None or last is None:
            return noise.undetermined(
                "creep", "no cells explain the unloaded panel and the last frame"
            )
        evidence = FittedPair((base, last)).evidence
        if not mostly_still(evidence.moved) or not np.isfinite(evidence.size[0]):
            return noise.undetermined(
                "creep", "the load touches most cells: record a frame with less load at the end"
            )
        return noise.determined(
            "creep",
            (
                ASSUMED.common_change * float(evidence.size[0]),
                ASSUMED.common_change * float(evidence.sd[0]),
            ),
        )

    def unnamed(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Yield a common change of all cells."""
        common_change = evidence.prepared.effects.common_change
        if common_change and evidence.names_none("creep", "temperature", "film"):
            yield Unnamed.of(common_change, "creep")
