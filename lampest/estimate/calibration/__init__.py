"""Calibration: numbers of the circuit or of the film, estimated from recordings of known resistors or loads."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

# Written digits: of an ohm, below what any contact repeats to; of a fraction, a hundredth of a code.
DIGITS, FRACTION_DIGITS = 3, 5
MIN_SAMPLE = 5  # frames or loads from which on a wild one can be told: fewer show no usual one


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """A scene whose numbers were estimated from recordings.

    Attributes
    ----------
    scene : Scene
        With the estimated numbers.
    summary : str
        All numbers with their standard deviations, in one line.
    remarks : tuple of str
        Sentences that stand above the scene as comments.
    warnings : tuple of str
        Doubts, a sentence each.
    """

    scene: Scene
    summary: str
    remarks: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the scene as YAML, with the remarks as comments."""
        return "".join(f"# {remark}\n" for remark in self.remarks) + to_yaml(self.scene)


def common_scene(recordings: Sequence[Recording], relevant: Callable[[Scene], Scene] = lambda scene: scene) -> Scene:
    """Return the scene of all recordings. Raises InputError where the `relevant` part of one differs."""
    first, *others = recordings
    for recording in others:
        if relevant(recording.scene) != relevant(first.scene):
            raise InputError(f"{recording.name}: its scene is another than that of {first.name}")
    return first.scene
