"""The base class of effects that a scene may name, and the evidence of their searches."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lampest.inference.circuits.model_check import ModelCheck, Question
from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides, CircuitEffects
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED
from lampest.recording.recording import MEASURED, UNLOADED, Recording


class PreparedRecording(Protocol):
    """Interface of a prepared recording for a search; properties are computed when first read."""

    @property
    def noise(self) -> NoiseEstimate:
        """The noise, with readings of all frames."""

    @property
    def question(self) -> Question:
        """Frames that the circuit has to explain."""

    @property
    def effects(self) -> CircuitEffects:
        """Effects beside the circuit, of all kinds."""

    @property
    def check(self) -> ModelCheck:
        """The check of the circuit."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """Finished estimates of a single network's recording, on which advice is based.

    Attributes
    ----------
    recording : Recording
        Without outliers.
    prepared : PreparedRecording
    """

    recording: Recording
    prepared: PreparedRecording

    @property
    def noise(self) -> NoiseEstimate:
        """The noise, with readings of all frames."""
        return self.prepared.noise

    @property
    def scene(self) -> Scene:
        """The scene of the recording."""
        return self.recording.scene

    @property
    def unloaded(self) -> NDArray[np.bool_]:
        """Whether a frame is unloaded, boolean (frames,)."""
        return np.asarray(self.recording.role == UNLOADED)

    @property
    def measured(self) -> NDArray[np.intp]:
        """Numbers of the measured frames."""
        return np.flatnonzero(self.recording.role == MEASURED)

    def names_none(self, *keys: str) -> bool:
        """Return whether the scene names none of these keys."""
        return all(specified(self.scene, key) is None for key in keys)


@dataclass(frozen=True)
class Unnamed:
    """An effect that a recording shows and its scene does not name.

    Attributes
    ----------
    sentence : str
        What shows it.
    addition : mapping
        Entries of the scene that name it.
    """

    sentence: str
    addition: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, sentence: str, key: str) -> "Unnamed":
        """Return the effect of a dotted key, which the recording is to determine."""
        addition: Any = ESTIMATED
        for part in reversed(key.split(".")):
            addition = {part: addition}
        return cls(sentence, addition)


class SceneEffect(ABC):
    """An effect that a scene may name.

    Attributes
    ----------
    if_unexplained : str
        The supposed effect in words, where readings have a misfit that nothing explains; '' for an
        effect that leaves none.
    if_unexplained_key : str
        The key that states it then.
    """

    if_unexplained: ClassVar[str] = ""
    if_unexplained_key: ClassVar[str] = ""

    def resolve(
        self, noise: NoiseEstimate, recording: Recording, besides: Besides
    ) -> NoiseEstimate:
        """Return the noise with the effect as the recording determines it.

        By default the noise is unchanged: the effect is determined before readings are taken, or
        with the noise of the frames.

        Parameters
        ----------
        noise : NoiseEstimate
            Noise with the effects that are resolved before.
        recording : Recording
            Without outliers; its scene names the effect.
        besides : callable
            Returns the effects beside the circuit.
        """
        return noise

    @abstractmethod
    def unnamed(self, evidence: Gathered) -> Iterator[Unnamed]:
        """Generate the evidence of the effect in a recording whose scene does not name it."""
