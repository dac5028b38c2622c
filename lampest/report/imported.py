"""What an import understood, in lines that end in a map of the panel."""

from collections.abc import Sequence

import numpy as np

from lampest.recording.recording import Recording
from lampest.report.info import text_map


def understood_lines(recording: Recording, notes: Sequence[str]) -> list[str]:
    """The sentences of an import, and the mean reading of every cell over the frames that have one.

    Rows and columns that were swapped or turned show in the map.
    """
    counted = np.isfinite(recording.recorded)
    total = np.where(counted, recording.recorded, 0.0).sum(axis=0)
    mean = np.where(counted.any(axis=0), total / np.maximum(counted.sum(axis=0), 1), np.nan)
    return [*notes, f"mean reading in {recording.scene.circuit.unit}:", *text_map(mean)]
