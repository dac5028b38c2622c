"""Advice: what a recording suggests beyond its scene, each with its evidence and the line of the scene that says so.

Advice is made of what the estimates of a recording have determined, and of the health of the panel. No estimate uses
it.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from lampest.audit.finding import Finding
from lampest.audit.health import Health
from lampest.audit.verdict import verdict
from lampest.estimate.model_check import ModelCheck
from lampest.estimate.prepared import Prepared
from lampest.estimate.saturation import saturated
from lampest.panel.effects import LineLeak
from lampest.recording.recording import UNLOADED

ENTRY = re.compile(r"([a-z_.]+)(?:: | near )([^,()]+)")  # 'readout.kind: grounded', 'drive_ohm near 1100'


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
        check = self.prepared.check
        effects = self._effects() if check.explains or check.by_effect else ()  # under a wrong circuit they say nothing
        return (*acted, *self._circuit(), *self._noise(), *effects)

    def _circuit(self) -> Iterator[Finding]:
        check = self.prepared.check
        if check.better and not check.by_effect:
            yield Finding("circuit", "another circuit", check.sentence, entry_line(check.better))

    def _noise(self) -> Iterator[Finding]:
        scene, noise = self.prepared.recording.scene, self.prepared.frame_noise
        if scene.readout is None:
            return
        if scene.readout.noise_specified and noise.sigma_factor != 1:
            evidence = f"readings at rest scatter {noise.factor:.3g} +- {noise.factor_error:.1g} times as specified"
            yield Finding("noise", "the noise is another one", evidence, "readout: {noise_lsb: estimated}")
        gain, together, apart = noise.shared_sizes
        if gain:
            yield Finding("effects", "the gain varies", f"that of a frame by {gain:.2g} %", "gain: estimated")
        if together or apart:
            sizes = f"lines of a scan by {together:.2g} LSB together, by {apart:.2g} LSB each"
            yield Finding("effects", "the supply or the mains ripples", sizes, "ripple: estimated")

    def _effects(self) -> Iterator[Finding]:
        prepared, noise = self.prepared, self.prepared.noise
        scene, besides = prepared.recording.scene, noise.corrected_effects
        specified = scene.specified_systematic
        if prepared.check.by_effect:
            names = set[str]()
            if besides is not None and besides.pair is not None:
                names = {"leaks" if isinstance(effect, LineLeak) else "contacts" for effect in besides.pair.effects}
            for name in sorted(names or {"leaks" if "leak" in prepared.check.better else "contacts"}):
                yield Finding("effects", prepared.check.better, prepared.check.sentence, f"{name}: estimated")
        if noise.in_motion:
            evidence = "readings differ as if a scan took the time between frames"
            yield Finding("effects", "loads move within a scan", evidence, "motion: estimated")
        if noise.reading_error > ((specified and specified.reading_error) or 0.0):
            evidence = f"still cells seem to move as if by {100 * noise.reading_error:.2g} %, the same in all frames"
            line = "systematic: {reading_error: estimated}"
            yield Finding("effects", "each reading has an error of its own", evidence, line)
        if noise.model_factor > 1:
            evidence = f"readings are missed by {noise.model_factor:.2g} times their noise"
            yield Finding("effects", "the model is not exact", evidence, "systematic: {model_error: estimated}")
        if prepared.check.common_change:
            yield Finding("effects", "all cells change together", prepared.check.common_change, "creep: estimated")
        if UNLOADED in prepared.recording.role and (stage := saturated(prepared.recording)) is not None:
            passes = (
                [0.0, round(stage.volt, 3)] if stage.highest else [round(stage.volt, 3), scene.circuit.full_scale_volt]
            )
            yield Finding("circuit", "a stage saturates", stage.sentence, f"readout: {{passes_volt: {passes}}}")


def entry_line(name: str) -> str:
    """Return the line of a scene for a circuit in words, such as 'readout.sense: one, drive_ohm near 50'."""
    content: dict[str, object] = {}
    for key, value in ENTRY.findall(name):
        path = key.split(".") if "." in key or key == "series_resistance_ohm" else ["readout", key]
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
