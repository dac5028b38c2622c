"""The base class of effects that a scene may name, and the evidence of their searches."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from lampest.inference.noise import NoiseEstimate
from lampest.inference.nuisances import Besides
from lampest.inference.prepared import Prepared
from lampest.inference.variance_components import Scatter
from lampest.panel.scene import Scene, specified
from lampest.panel.sizes import ESTIMATED, nearest_allowed
from lampest.recording.recording import Recording

Determined = tuple[float, float] | str  # a number with its standard deviation, or why there is none


def names_none(prepared: Prepared, *keys: str) -> bool:
    """Return whether the scene of a recording names none of these keys."""
    scene = prepared.recording.scene
    return all(specified(scene, key) is None for key in keys)


def estimated_entry(key: str) -> dict[str, Any]:
    """Return the entry of a scene that calls a dotted key `estimated`."""
    entry: Any = ESTIMATED
    for part in reversed(key.split(".")):
        entry = {part: entry}
    return dict(entry)


@dataclass(frozen=True)
class Unnamed:
    """An effect that a recording shows and its scene does not name.

    Attributes
    ----------
    words : callable
        Returns what shows it, given the noise of the recording whose scene names it: the number of
        advice is that of the estimate. '' where that scene does not determine it.
    addition : mapping
        Entries of the scene that name it.
    """

    words: Callable[[NoiseEstimate], str]
    addition: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, sentence: Callable[[float, float], str], key: str) -> "Unnamed":
        """Return the effect of a dotted key, which the recording is to determine.

        Parameters
        ----------
        sentence : callable
            Returns the effect in words, given its size and standard deviation.
        key : str
        """

        def words(noise: NoiseEstimate) -> str:
            return sentence(*noise.estimated[key]) if key in noise.estimated else ""

        return cls(words, estimated_entry(key))


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

    def freed(self, recording: Recording) -> tuple[Recording, Mapping[str, Determined]]:
        """Return the recording with a number in place of `estimated`, before readings are taken.

        The method is called for an `Entry` with `before_readings`.

        Returns
        -------
        recording : Recording
            With a scene that does not say `estimated`.
        estimates : mapping
            Each key that did → the number with its standard deviation, or the reason why the
            recording determines none.
        """
        return recording, {}

    def in_frames(
        self, noise: NoiseEstimate, recording: Recording, scatter: Scatter | None
    ) -> NoiseEstimate:
        """Return the noise of the frames with the effect, given their scatter if it is known.

        The method is called for an `Entry` with `of_frames`. By default the noise is unchanged.
        """
        return noise

    def noted(
        self, noise: NoiseEstimate, recording: Recording, estimates: Mapping[str, Determined]
    ) -> NoiseEstimate:
        """Return the noise of the freed recording with the estimates of `freed`."""
        for key, estimate in estimates.items():
            if isinstance(estimate, str):
                noise = noise.undetermined(key, estimate)
            else:
                noise = noise.determined(key, estimate)
        return noise

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

    def as_the_whole(
        self, noise: NoiseEstimate, recording: Recording, whole: NoiseEstimate
    ) -> NoiseEstimate:
        """Return the noise of a part of a recording, with the effect as the whole has it.

        By default it is unchanged: numbers and errors that all frames share are taken over anyway.
        """
        return noise

    def allowed(self, scene: Scene, key: str, number: float) -> float:
        """Return the number nearest to a determined one that a scene may state under the key."""
        return nearest_allowed(key, number)

    def stated(self, scene: Scene, keys: Sequence[str], noise: NoiseEstimate) -> Scene:
        """Return the scene with numbers in place of `estimated`.

        By default the keys are fields of the scene, which are None without a number.

        Parameters
        ----------
        scene : Scene
        keys : sequence of str
            Those under which the scene says `estimated`.
        noise : NoiseEstimate
            Its numbers are within the limits of their keys.
        """
        numbers: dict[str, Any] = {key: noise.number(key) for key in keys}
        return replace(scene, **numbers)

    @abstractmethod
    def unnamed(self, prepared: Prepared) -> Iterator[Unnamed]:
        """Generate the evidence of the effect in a recording whose scene does not name it.

        Its preparation is that of a single network, with `cleaned.recording` without outliers.
        """
