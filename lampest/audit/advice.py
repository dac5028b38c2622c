"""Advice on a scene from its recording.

Each suggestion comes with its evidence and the entries of the scene that say so. Advice is based on
the estimates of a recording, and on the health of the panel. No estimate uses it.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

from lampest.audit.effects import effects_to_try, named, unnamed_effects
from lampest.audit.finding import Finding, advised_entries
from lampest.audit.health import Health
from lampest.audit.verdict import verdict
from lampest.files.errors import InputError
from lampest.inference.circuits.model_check import ModelCheck
from lampest.inference.prepared import Prepared
from lampest.panel.readouts.converter import states_noise
from lampest.panel.sizes import ESTIMATED

# Where neither another circuit nor an effect explains the readings.
UNKNOWN = Finding(
    "circuit",
    "no known circuit or effect gives these readings",
    "",
    remedy="check the kind and the resistors of the readout, and the lines that the verdict names",
)


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
        acted = (finding for finding in self.health.findings if finding.addition or finding.remedy)
        effects = self._effects()
        check = self.prepared.check
        circuit = list[Finding]()
        if check.better and not check.by_effect:
            circuit.append(Finding("circuit", "another circuit", check.sentence, check.addition))
        findings = (*acted, *circuit, *self._noise(effects), *effects)
        if findings or check.explains is not False:
            return findings
        return (UNKNOWN,)

    @property
    def lines(self) -> tuple[str, ...]:
        """Advice in words, ASCII, and the entries of the scene that follow from it."""
        sentences = (finding.text for finding in self.advice)
        return (*sentences, *advised_entries(self.prepared.recording.scene, self.advice))

    def _effects(self) -> tuple[Finding, ...]:
        """Return the unnamed effects.

        Under a wrong circuit effects mean nothing. If no circuit explains the readings, the first
        effect counts with which the scene's circuit does, and those that show beside it; without
        one, all that show.
        """
        check = self.prepared.check
        if check.better and not check.by_effect:
            return ()
        found = unnamed_effects(self.prepared) if check.explains is not None else ()
        if check.explains or check.by_effect:
            return found
        for finding in (*found, *effects_to_try(self.prepared.recording.scene)):
            with suppress(InputError):
                restored = named(self.prepared, finding)
                if restored.check.explains:
                    return (finding, *unnamed_effects(restored))
        return found

    def _noise(self, effects: tuple[Finding, ...]) -> Iterator[Finding]:
        """Yield the finding that noise is another one than the scene specifies beside effects."""
        scene = self.prepared.recording.scene
        if scene.readout is None or self.prepared.frame_noise.sigma_factor == 1:
            return
        prepared = self.prepared
        for finding in effects:
            with suppress(InputError):
                prepared = named(prepared, finding)
        noise = prepared.frame_noise
        if states_noise(scene.readout) and noise.sigma_factor != 1:
            evidence = (
                "readings at rest scatter "
                f"{noise.factor:.3g} +- {noise.factor_error:.1g} times as specified"
            )
            estimated = {"readout": {"noise_lsb": ESTIMATED}}
            yield Finding("noise", "the noise is another one", evidence, estimated)
