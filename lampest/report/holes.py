"""Which readings of a recording say nothing, which are only bounds, in a sentence."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.recording.recording import Recording
from lampest.runs.case import CaseResult


@dataclass(frozen=True, eq=False)
class Holes:
    """missing, bounds : (frames, rows, columns) readings that say nothing, and those at a rail, zero or below."""

    missing: NDArray[np.bool_]
    bounds: NDArray[np.bool_]

    @classmethod
    def of_recording(cls, recording: Recording) -> "Holes":
        """Of all frames; readings that the scene's faults make blind are no holes."""
        readings = recording.readings()
        return cls(readings.missing(recording.scene), readings.bounds)

    @classmethod
    def of_case(cls, case: CaseResult) -> "Holes":
        """Of the measured frames. Results that do not say which readings are bounds have none."""
        faults = case.scene.faults
        missing = np.isnan(case.measured)
        if faults is not None:
            missing &= ~faults.blind(case.scene.panel)
        side = np.zeros(missing.shape) if case.reading_side is None else case.reading_side
        return cls(missing, side != 0)

    def sentence(self) -> str:
        """`12 readings missing (0.4 %), 30 at a rail, zero or below the series resistance (1 %), in 7 of 40 frames`.

        Lines that have none are named. Empty where every reading is a value.
        """
        kinds = (self.missing, "missing"), (self.bounds, "at a rail, zero or below the series resistance")
        counts = [(int(np.sum(kind)), words) for kind, words in kinds]
        if not any(count for count, _ in counts):
            return ""
        parts = [f"{count} {words} ({_percent(count, self.missing.size)})" for count, words in counts if count]
        parts[0] = parts[0].replace(" ", " readings " if not parts[0].startswith("1 ") else " reading ", 1)
        frames = int(np.sum((self.missing | self.bounds).any(axis=(1, 2))))
        lines = [*_blank("row", self.missing, (0, 2)), *_blank("column", self.missing, (0, 1))]
        none = f"; {' and '.join(lines)} {'has' if len(lines) == 1 else 'have'} none" if lines else ""
        return f"{', '.join(parts)}, in {frames} of {len(self.missing)} frames{none}"


def _percent(count: int, of: int) -> str:
    return f"{100 * count / of:.2g} %" if count < of else "100 %"


def _blank(name: str, missing: NDArray[np.bool_], others: tuple[int, int]) -> list[str]:
    """The lines of which every reading of every frame is missing."""
    return [f"{name} {number}" for number in np.flatnonzero(missing.all(axis=others))]
