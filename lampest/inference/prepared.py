"""Preparation of a recording: readings, noise, effects, check of the circuit and warnings.

Every quantity is determined once.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lampest.files.errors import BROKEN, InputError, in_words
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.noise import NoiseEstimate, estimate_noise, noise_of_modules
from lampest.inference.readings.garbled import garbled_sentence
from lampest.inference.readings.judge import Cleaned
from lampest.inference.resolve import (
    OF_NOISE,
    Freed,
    effects_of_frames,
    freed,
    keys_in_sigma,
    resolved,
    resolved_scene,
)
from lampest.panel.effects import own_errors
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts.converter import states_noise
from lampest.panel.readouts.starts import several_panels
from lampest.panel.scene import specified
from lampest.panel.sizes import ESTIMATED, LINE_EFFECTS
from lampest.recording.recording import Recording

if TYPE_CHECKING:
    from lampest.inference.circuits.alike import PanelChoice
    from lampest.inference.circuits.model_check import ModelCheck, Question
    from lampest.inference.nuisances import CircuitEffects
    from lampest.panel.effects.line_effect import LineEffect


# Of parts in two dividers, with resistors of 5 % (series E24, IEC 60063): √2 · 5 %, rounded up.
LARGEST_READING_ERROR = 0.08


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording with all quantities that its estimates share.

    Each property is computed once, when first needed. Properties raise InputError where the
    readings contradict the scene, as `Readings.of` does.

    Attributes
    ----------
    recording : Recording
    whole_recording : NoiseEstimate or None
        For a part of a longer recording: noise, effects and motion of the whole; else None.
    """

    recording: Recording
    whole_recording: NoiseEstimate | None = None

    @classmethod
    def of(cls, recording: "Recording | Prepared") -> "Prepared":
        """Return the preparation of a recording; a preparation is returned unchanged.

        Raises InputError for other objects.
        """
        if isinstance(recording, Prepared):
            return recording
        if isinstance(recording, Recording):
            return cls(recording)
        raise InputError(
            "recording must be a Recording, "
            f"such as Recording.load('mine.h5'), not {in_words(recording)}"
        )

    @property
    def layout(self) -> Modules | None:
        """The layout of a panel of modules; None for a single network."""
        return self.recording.scene.panel.modules

    @cached_property
    def modules(self) -> "tuple[Prepared | None, ...]":
        """The preparation of each module, None for a dead one; () for a single network."""
        if self.layout is None:
            return ()
        dead = self.recording.scene.dead_modules
        parts = enumerate(self.recording.modules)
        wholes: tuple[NoiseEstimate | None, ...] = (None,) * self.layout.count
        if self.whole_recording is not None:
            wholes = self.whole_recording.of_modules
        return tuple(
            None if number in dead else Prepared(part, wholes[number]) for number, part in parts
        )

    @cached_property
    def _freed(self) -> Freed:
        """The recording of a single network without effects that act before readings are taken."""
        return freed(self.recording)

    @cached_property
    def cleaned(self) -> Cleaned:
        """The readings of a single network without impossible ones."""
        return Cleaned.of(self._freed.recording)

    @cached_property
    def frame_noise(self) -> NoiseEstimate:
        """Noise of the frames, estimated from unloaded frames and from neighbours in time."""
        if self.layout is not None:
            every = [None if module is None else module.frame_noise for module in self.modules]
            return noise_of_modules(self.recording, self.layout, every)
        recording = self.cleaned.recording
        effects = effects_of_frames(recording.scene)
        noise = estimate_noise(recording, self.cleaned.outliers, self.cleaned.readings, effects)
        noise = self._freed.noted(noise, self.cleaned.recording)
        places = [f"row {row}, column {column}" for row, column in np.argwhere(self.cleaned.frozen)]
        if places:
            noise = noise.with_warnings(
                f"one value in all frames at {' and at '.join(places)}, "
                "while noise changes the other readings: left out"
            )
        return noise.with_warnings(garbled_sentence(self.cleaned.garbled), *self.cleaned.sentences)

    @cached_property
    @ONE_BLAS_THREAD
    def question(self) -> "Question":
        """Frames of a single network that its circuit has to explain.

        Raises the errors of `BROKEN`.
        """
        from lampest.inference.circuits.model_check import Question  # for a check alone
        from lampest.panel.effects.line_effect import stated_effects

        question = Question.of(self.cleaned.recording, self.cleaned.left_out)
        return replace(question, with_effects=stated_effects(self.recording.scene))

    @cached_property
    def _question_with_effects(self) -> "Question":
        """The question with all effects at lines that the scene names and the readings show."""
        scene = self.recording.scene
        named = (specified(scene, effect.key) for effect in LINE_EFFECTS)
        found = self.noise.corrected_effects if ESTIMATED in named else None
        if found is None or found.pair is None:
            return self.question
        return replace(self.question, with_effects=found.pair.effects)

    @cached_property
    def effects(self) -> "CircuitEffects":
        """Effects beside the circuit of a single network, of all kinds that it does not name."""
        from lampest.panel.effects.line_effect import line_effects

        question = self._question_with_effects
        shown = {type(effect) for effect in question.with_effects}
        return self.effects_of([kind for kind in line_effects() if kind not in shown], question)

    @ONE_BLAS_THREAD
    def effects_of(
        self, kinds: "Sequence[type[LineEffect]]", question: "Question | None" = None
    ) -> "CircuitEffects":
        """Return the effects beside the circuit of a single network, of some kinds."""
        from lampest.inference.nuisances import CircuitEffects

        with suppress(*BROKEN), np.errstate(all="ignore"):
            if self.cleaned.readings.sigma is not None:
                return (question or self.question).effects(kinds)
        return CircuitEffects()

    @cached_property
    def check(self) -> "ModelCheck":
        """Check of the circuit, whose sentence names the numbers that no frame can determine."""
        check = self._check
        if not check.explains:
            return check
        from lampest.inference.unobservable import unobservable_numbers  # for its sentence alone

        scale_error = None
        with suppress(*BROKEN), np.errstate(all="ignore"):
            if self.layout is None and self.cleaned.readings.sigma is not None:
                explanation = self.question.explanation
                if explanation is not None and explanation.pair is not None:
                    scale_error = explanation.pair.scale_error
        unobservable = unobservable_numbers(self.recording.scene, scale_error)
        if not unobservable:
            return check
        return replace(check, sentence=f"{check.sentence}; {unobservable}")

    @cached_property
    @ONE_BLAS_THREAD
    def _check(self) -> "ModelCheck":
        """The check without the numbers that no frame can determine."""
        from lampest.inference.circuits.model_check import ModelCheck, check_of_modules

        if self.layout is not None:
            living = {
                number: module for number, module in enumerate(self.modules) if module is not None
            }
            return check_of_modules(
                self.recording, self.layout, lambda number: living[number]._check
            )
        if self.cleaned.readings.sigma is None:
            return ModelCheck(
                None, "the circuit was not checked: the noise of the readings is unknown"
            )
        with suppress(*BROKEN), np.errstate(all="ignore"):
            check = self._question_with_effects.check(self.effects, self._contradicting_scatter)
            if check.explains is False and not check.better:
                check = self._with_named_errors(check)
            count = int(self.cleaned.left_out.sum())
            if not count:
                return check
            outliers = "outliers" if count > 1 else "outlier"
            sentence = f"{check.sentence}, without {count} {outliers} of one frame"
            return replace(check, sentence=sentence)
        return ModelCheck(
            None, "the circuit was not checked: arithmetic broke down over its readings"
        )

    @property
    def _contradicting_scatter(self) -> float:
        """Scatter of the unloaded frames over what the scene specifies.

        The value is 1 where nothing contradicts the scene. What it calls `estimated` cannot be
        contradicted, and effects that readings of a frame share leave the scatter of each reading.
        """
        scene = self.recording.scene
        noise = self.frame_noise
        if OF_NOISE in noise.estimated:
            return 1.0
        of_recording = self.recording.sigma is not None or scene.readout is None
        if not of_recording and not states_noise(scene.circuit):
            return 1.0
        return noise.sigma_factor if effects_of_frames(scene) else self.question.widening

    def _with_named_errors(self, check: "ModelCheck") -> "ModelCheck":
        """Return the check of a circuit with the errors that the scene names beside noise.

        The circuit is doubtful where the recording determines their size, because such errors may
        also hide a wrong circuit. Errors of readings beyond LARGEST_READING_ERROR are those of
        another one.
        """
        size, _ = self.noise.estimated.get("systematic.reading_error", (0.0, 0.0))
        if self._named_errors is None or size > LARGEST_READING_ERROR:
            return check
        if self.question.hopeless_with(self._named_errors):
            return check
        question = replace(self._question_with_effects, named_errors=self._named_errors)
        if question.fault:
            return check
        from lampest.inference.circuits.model_check import EXPLAINED
        from lampest.inference.estimated import estimated_lines

        keys = keys_in_sigma(self.recording.scene)
        sizes = {key: size for key, size in self.noise.estimated.items() if key in keys}
        explained = replace(check, explains=True, sentence=EXPLAINED, doubts=())
        doubts = list(check.doubts)
        if sizes:
            doubts.append(f"only with errors of this size: {'; '.join(estimated_lines(sizes))}")
        return explained.with_doubts(*doubts)

    @cached_property
    def _named_errors(self) -> Array | None:
        """σ of readings by errors that the scene names beside noise, (frames, rows, columns).

        None where the scene names none.
        """
        widened = self.noise.readings.sigma
        of_noise = self.frame_noise.readings.sigma
        if widened is None or of_noise is None:
            return None
        # without the error of the model, which any wrong circuit has
        squares = np.maximum((widened / self.noise.model_factor) ** 2 - of_noise**2, 0.0)
        size = self.noise.reading_error
        squares += own_errors(self.frame_noise.readings.value, self.recording.scene, size) ** 2
        return np.sqrt(squares) if (squares > 0).any() else None

    @cached_property
    @ONE_BLAS_THREAD
    def noise(self) -> NoiseEstimate:
        """Noise of the frames and errors that all frames share; σ of its readings includes both."""
        if self.layout is not None:
            every = [None if module is None else module.noise for module in self.modules]
            return noise_of_modules(self.recording, self.layout, every)
        noise = replace(self.frame_noise, panels=self.panels)
        return resolved(noise, self.cleaned.recording, self.whole_recording, self.effects_of)

    @cached_property
    @ONE_BLAS_THREAD
    def panels(self) -> "PanelChoice | None":
        """Cells of a single network, where several panels read alike; None elsewhere.

        A part of a longer recording has those of the whole.
        """
        if self.whole_recording is not None:
            return self.whole_recording.panels
        with suppress(*BROKEN), np.errstate(all="ignore"):
            scene = self.recording.scene
            if several_panels(scene.circuit, *scene.panel.shape):
                return self.question.panels
        return None

    @cached_property
    def resolved(self) -> Recording:
        """Recording with numbers where its scene says `estimated`, as far as it has them."""
        return replace(self.recording, scene=resolved_scene(self.recording.scene, self.noise))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Contradictions of the scene and pitfalls, one line each."""
        from lampest.inference.warnings import warnings_of

        return warnings_of(self.recording, self.noise, self.check)

    @cached_property
    def warnings_without_check(self) -> tuple[str, ...]:
        """The warnings that need no check of the circuit, one line each."""
        from lampest.inference.warnings import warnings_of

        return warnings_of(self.recording, self.noise, None)
