"""A finding in a recording, and the entries of a scene that follow from findings."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from lampest.files.document import in_one_line, parse_document, plain_content, to_yaml
from lampest.files.errors import InputError
from lampest.files.typed import members_of
from lampest.panel.readouts import AnyReadout
from lampest.panel.scene import Scene, validated_scene

PASTE = "write into the scene, in place of its entries of these names:"


@dataclass(frozen=True)
class Finding:
    """Something that a recording shows, with its evidence and the entries of a scene that say so.

    Attributes
    ----------
    room : str
        Row of the table of health or of advice: 'lines', 'cells', 'noise', 'readings', 'frames',
        'times', 'order', 'circuit', 'effects'.
    what : str
        The finding, such as 'row 3 is dead'.
    evidence : str
        The observation that shows it.
    addition : mapping
        Entries to merge into the scene; empty where no entry helps.
    remedy : str
        An action where no entry helps, such as an option of a command; ''.
    """

    room: str
    what: str
    evidence: str
    addition: Mapping[str, Any] = field(default_factory=dict)
    remedy: str = ""

    @property
    def line(self) -> str:
        """The entries as one line of YAML."""
        return in_one_line(self.addition)

    @property
    def text(self) -> str:
        """The finding in one line, ASCII."""
        text = self.what
        if self.evidence:
            text += f": {self.evidence}"
        if self.remedy:
            text += f"; {self.remedy}"
        return text


def with_addition(scene: Scene, addition: Mapping[str, Any]) -> Scene:
    """Return the scene with further entries.

    Raises InputError where the scene cannot have them.
    """
    content = merged(_fitting(plain_content(scene), addition), addition)
    made = validated_scene(parse_document(to_yaml(content), "the scene"))
    return replace(made, assumed=scene.assumed)


def with_lines(
    scene: Scene, findings: Iterable[Finding]
) -> tuple[Scene, tuple[str, ...], tuple[str, ...]]:
    """Return the scene with the lines of findings.

    Returns
    -------
    scene : Scene
        The scene with all lines that fit it.
    accepted : tuple of str
        Lines that the scene took.
    refused : tuple of str
        Sentences on the other lines.
    """
    accepted = list[str]()
    refused = list[str]()
    additions = {finding.line: finding.addition for finding in findings if finding.addition}
    for line, addition in additions.items():
        try:
            changed = with_addition(scene, addition)
        except InputError as error:
            refused.append(f"{line}: {str(error).partition(': ')[2]}")
            continue
        if not same_values(scene, changed):
            refused.append(
                f"{line}: recorded values, in {scene.circuit.unit}, would mean something else; "
                "import the readings again with this line in the scene"
            )
            continue
        scene = changed
        accepted.append(line)
    return scene, tuple(accepted), tuple(refused)


def advised_entries(scene: Scene, findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the entries of a scene that findings change, whole, as lines of YAML.

    A sentence precedes them.
    """
    advised = scene
    for finding in findings:
        with suppress(InputError):
            advised = with_addition(advised, finding.addition)
    before = plain_content(scene)
    after = plain_content(advised)
    changed = {key: _filled(value) for key, value in after.items() if before.get(key) != value}
    if not changed:
        return ()
    again = "" if same_values(scene, advised) else "import the readings again with this scene; "
    return (f"{again}{PASTE}", *(in_one_line({key: value}) for key, value in changed.items()))


def _filled(content: Any) -> Any:
    """Return a mapping without its empty lists, which a scene need not state."""
    if not isinstance(content, Mapping):
        return content
    return {key: value for key, value in content.items() if value not in ([], ())}


def sentences_and_entries(advice: str) -> tuple[list[str], list[str]]:
    """Split the lines of advice into its sentences and the entries of a scene that follow."""
    lines = advice.split("\n") if advice else []
    first = next((at for at, line in enumerate(lines, 1) if line.endswith(PASTE)), len(lines))
    return lines[:first], lines[first:]


def same_values(scene: Scene, changed: Scene) -> bool:
    """Return whether recorded values stand for the same voltages and codes in two scenes."""
    first = scene.circuit
    second = changed.circuit
    if first.unit != second.unit or (scene.readout is None) != (changed.readout is None):
        return False
    if first.characteristic != second.characteristic:
        return False
    least, most = first.range_volt
    volt = np.linspace(least, most, 7)[1:-1]
    return np.allclose(second.volt_from_recorded(first.recorded_from_volt(volt)), volt)


def _fitting(content: dict[str, Any], addition: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scene's content without entries of the readout that an addition replaces.

    The addition replaces entries that a readout of another kind does not have, and lists of lines.
    """
    readout = content.get("readout")
    further = addition.get("readout", {})
    keys_by_kind = {
        member.kind: {entry.name for entry in fields(member)} for member in members_of(AnyReadout)
    }
    if readout is None or not isinstance(further, Mapping):
        return content
    keys = keys_by_kind.get(further.get("kind", ""), set(readout))
    lists = {key for key, value in further.items() if isinstance(value, list)}
    kept = {key: value for key, value in readout.items() if key in keys - lists}
    return content | {"readout": kept}


def merged(content: Any, addition: Any) -> Any:
    """Return content with an addition.

    Mappings are joined, lists extended by new items, other values replaced.
    """
    if isinstance(content, Mapping) and isinstance(addition, Mapping):
        return dict(content) | {
            key: merged(content.get(key), value) for key, value in addition.items()
        }
    if isinstance(content, list) and isinstance(addition, list):
        return [*content, *(item for item in addition if item not in content)]
    return addition
