"""Calibration of the circuit or of the film from recordings of known resistors or loads."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

# Written decimals: of an ohm, finer than contacts repeat; of a fraction, a hundredth of a code.
DIGITS = 3
FRACTION_DIGITS = 5
MIN_SAMPLE = 5  # frames or loads; with fewer, a wild one cannot be identified


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """A scene whose numbers were estimated from recordings.

    Attributes
    ----------
    scene : Scene
        The scene with the estimated numbers.
    summary : str
        All numbers with their standard deviations, in one line.
    remarks : tuple of str
        Sentences that are written above the scene as comments.
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


def common_scene(
    recordings: Sequence[Recording], relevant: Callable[[Scene], Scene] = lambda scene: scene
) -> Scene:
    """Return the scene of the first recording.

    Raises InputError where the `relevant` part of another differs.
    """
    first, *further = recordings
    for recording in further:
        if relevant(recording.scene) != relevant(first.scene):
            raise InputError(f"{recording.name}: its scene is another than that of {first.name}")
    return first.scene
