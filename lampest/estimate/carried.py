"""What later frames need of earlier ones, as arrays: what is written between two parts of a long recording."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lampest.estimate.stream import Stream
from lampest.panel.panel import Array
from lampest.posterior.dense import DenseMemory
from lampest.posterior.sampled import SampledMemory
from lampest.posterior.track import Track

MEMORIES = {"dense": DenseMemory, "sampled": SampledMemory}


@dataclass(frozen=True, eq=False)
class CarriedOver:
    """Name → array, of a stream after some frames; what a stream has at its beginning is no part of it."""

    arrays: Mapping[str, Array]

    @classmethod
    def of(cls, stream: Stream) -> "CarriedOver":
        """The last estimate, its deviation, and what error bars look back at."""
        found = {"previous": stream.previous, "previous_deviation": stream.previous_deviation}
        if stream.track is not None:
            found |= _of_track(stream.track)
        return cls(
            {name: np.atleast_1d(np.asarray(value, float)) for name, value in found.items() if value is not None}
        )

    def onto(self, begun: Stream) -> Stream:
        """The stream after those frames; begun : with its baseline, and with what its method prepares at first."""
        track = begun.track
        if track is not None:
            track = replace(
                track,
                deviation=self.arrays.get("deviation"),
                memory=self._memory(),
                answers=self._pair("answer", "answer_of_baseline"),
                bend=self._pair("bend_below", "bend_above"),
            )
        previous, deviation = self.arrays.get("previous"), self.arrays.get("previous_deviation")
        return replace(begun, previous=previous, previous_deviation=deviation, track=track)

    def _pair(self, first: str, second: str) -> tuple[Array, Array] | None:
        return (self.arrays[first], self.arrays[second]) if first in self.arrays else None

    def _memory(self) -> DenseMemory | SampledMemory | None:
        if "dense_last" in self.arrays:
            return DenseMemory(*(self.arrays[f"dense_{name}"] for name in ("last", "with_baseline", "baseline")))
        if "sampled_last" in self.arrays:
            last, baseline, drawn = (self.arrays[f"sampled_{name}"] for name in ("last", "baseline", "drawn"))
            return SampledMemory(last, baseline, int(drawn[0]))
        return None


def _of_track(track: Track) -> dict[str, Array | None]:
    answer, of_baseline = track.answers or (None, None)
    below, above = track.bend or (None, None)
    found: dict[str, Array | None] = {
        "deviation": track.deviation,
        "answer": answer,
        "answer_of_baseline": of_baseline,
        "bend_below": below,
        "bend_above": above,
    }
    for kind, memory in MEMORIES.items():
        if isinstance(track.memory, memory):
            found |= {f"{kind}_{name}": np.asarray(value, float) for name, value in vars(track.memory).items()}
    return found
