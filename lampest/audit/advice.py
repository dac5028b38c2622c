"""Advice: what a recording suggests beyond its scene.

Each suggestion comes with its evidence and the line of the scene that says so. Advice is made of
what the estimates of a recording have determined, and of the health of the panel. No estimate uses
it.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

from lampest.audit.effects import effects_to_try, unnamed_effects
from lampest.audit.finding import Finding, with_line
from lampest.audit.health import Health
from lampest.audit.verdict import verdict
from lampest.files.errors import InputError
from lampest.inference.model_check import ModelCheck
from lampest.inference.prepared import Prepared

# 'readout.kind: grounded', 'drive_ohm near 1100', 'readout.groups: [[0, 1], [2, 3]]'
ENTRY = re.compile(r"([a-z_.]+)(?:: | near )(\[\[.*?\]\]|[^,()]+)")
OF_SCENE = ("series_resistance_ohm", "converter_memory")  # keys that are no part of the readout


@dataclass(frozen=True, eq=False)
class Audit:
    """Audit of a recording: its verdict, health and advice.

    Attributes
    ----------
    prepared : Prepared
        Preparation of the recording, which its estimates have used.
    """

    prepared: Prepared

    @cached_property
    def health(self) -> Health:
        """Health of the panel and of the recording."""
        return Health.of(self.prepared.recording)

    @cached_property
    def verdict(self) -> ModelCheck:
        """The check of the circuit with all doubts."""
        return verdict(self.prepared.check, self.prepared, self.health)

    @cached_property
    def advice(self) -> tuple[Finding, ...]:
        """The findings that a user can act on: health, circuit, effects."""
        acted = (finding for finding in self.health.findings if finding.line or finding.remedy)
        return (*acted, *self._circuit(), *self._noise(), *self._effects())

    def _effects(self) -> tuple[Finding, ...]:
        """Return the unnamed effects.

        Under a wrong circuit effects mean nothing. Where no circuit explains the readings, the
        first effect counts with which the scene's does.
        """
        check = self.prepared.check
        found = unnamed_effects(self.prepared) if check.explains is not None else ()
        if check.explains or check.by_effect:
            return found
        if check.better:
            return ()
        recording = self.prepared.recording
        for finding in (*found, *effects_to_try(recording.scene)):
            with suppress(InputError):
                named = replace(recording, scene=with_line(recording.scene, finding.line))
                if Prepared(named).check.explains:
                    return (finding,)
        return ()

    def _circuit(self) -> Iterator[Finding]:
        """Yield the circuit that explains the readings better."""
        check = self.prepared.check
        if check.better and not check.by_effect:
            yield Finding("circuit", "another circuit", check.sentence, entry_line(check.better))

    def _noise(self) -> Iterator[Finding]:
        """Yield the finding that noise is another one than the scene specifies."""
        scene = self.prepared.recording.scene
        noise = self.prepared.frame_noise
        if scene.readout is None:
            return
        if scene.readout.noise_specified and noise.sigma_factor != 1:
            evidence = (
                f"readings at rest scatter {noise.factor:.3g} +- {noise.factor_error:.1g} "
                "times as specified"
            )
            yield Finding(
                "noise", "the noise is another one", evidence, "readout: {noise_lsb: estimated}"
            )


def entry_line(name: str) -> str:
    """Return the line of a scene for a circuit in words.

    An example is 'readout.sense: one, drive_ohm near 50'.
    """
    content: dict[str, object] = {}
    for key, value in ENTRY.findall(name):
        path = key.split(".") if "." in key or key in OF_SCENE else ["readout", key]
        part = content
        for step in path[:-1]:
            part = part.setdefault(step, {})  # type: ignore[assignment]
        part[path[-1]] = float(value) if re.fullmatch(r"[\d.e+]+", value.strip()) else value.strip()
    return flow(content)


def flow(content: object) -> str:
    """Return a mapping as one line of YAML, such as 'readout: {kind: grounded, sense: one}'."""
    if not isinstance(content, dict):
        return f"{content:g}" if isinstance(content, float) else str(content)
    texts = (
        f"{key}: {{{flow(value)}}}" if isinstance(value, dict) else f"{key}: {flow(value)}"
        for key, value in content.items()
    )
    return ", ".join(texts)
