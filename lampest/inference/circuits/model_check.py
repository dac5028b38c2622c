"""Check of the scene's circuit: whether it explains the readings.

One frame: are there positive cells that explain the readings within their noise, and do the
readings satisfy the circuit's inequalities? Two frames: does another circuit, or an effect beside
the circuit, explain them with a larger evidence (`lampest.inference.circuits.better_alternative`)?
The verdict is a sentence. Panels of modules have one from the modules whose readings change most.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from lampest.files.applications import applications
from lampest.files.levels import DOUBTFUL_GAIN, MAD_TO_SIGMA, MIN_EVIDENCE_GAIN, SIGNIFICANT
from lampest.inference.cells_fit import well_determined
from lampest.inference.circuits.better_alternative import better_alternative
from lampest.inference.circuits.explanation import (
    ComparedFrames,
    Explanation,
    below_series,
    broken_law,
)
from lampest.inference.circuits.open_ends import undetermined_ends
from lampest.inference.nuisances import BetterExplanation, CircuitEffects, find_effects
from lampest.inference.pair import FittedPair
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.panel import Array, Modules
from lampest.recording.readings import mean_change
from lampest.recording.recording import (
    MAX_NEIGHBOURS,
    MEASURED,
    UNLOADED,
    Recording,
    baseline_readings,
)

EXPLAINED = "the circuit can give these readings"
NO_LIKELIER = "no other known one is likelier"
# Deviation of ln of a module's median reading at rest from the other modules: none of 1,640
# simulated modules whose cells scatter by 0.2 exceeds it, and a reference that is off by 20 % does.
MIN_AWAY = 0.15
MIN_COMPARED_MODULES = 3  # of two that differ, either may be the wrong one
# Share of missing readings or bounds: with a fifth, moved cells can no longer be identified.
MAX_MISSING = 0.1


@dataclass(frozen=True)
class ModelCheck:
    """Result of the check.

    Attributes
    ----------
    explains : bool or None
        Whether the specified circuit explains the readings and no other explains them better; None:
        not checked, because the noise is unknown or no fit was found.
    sentence : str
        The result in words, ASCII.
    better : str
        The circuit or the effects that explain the readings better, in the words of a scene; ''.
    noise : float
        Factor of the unloaded frames' scatter over the specified noise; 1 where it is not
        significant.
    common_change : str
        The common change of all cells in words; '' where it is not significant.
    by_effect : bool
        Whether `better` names effects beside the circuit.
    loaded_at_rest : bool
        Whether a load may lie on the unloaded panel.
    addition : mapping
        Entries of a scene that state `better`; empty where none do.
    doubts : tuple of str
        Reasons why a circuit that explains the readings is not certain.
    compared : bool
        Whether the other known circuits were compared, and none is likelier.

    >>> lampest.ModelCheck(True, "the circuit can give these readings").mark
    'yes'
    """

    explains: bool | None
    sentence: str
    better: str = ""
    noise: float = 1.0
    common_change: str = ""
    by_effect: bool = False
    loaded_at_rest: bool = False
    doubts: tuple[str, ...] = ()
    addition: Mapping[str, Any] = field(default_factory=dict)
    compared: bool = False

    @property
    def mark(self) -> str:
        """The verdict: 'yes', 'no', or 'doubtful'.

        A circuit is 'doubtful' where it was not checked, or where something speaks against it.
        """
        if self.explains is False:
            return "no"
        return "doubtful" if self.explains is None or self.doubts else "yes"

    def with_doubts(self, *doubts: str) -> "ModelCheck":
        """Return the check with further doubts, which its sentence states.

        Empty and known ones are ignored.
        """
        further = tuple(doubt for doubt in doubts if doubt and doubt not in self.doubts)
        return replace(
            self, doubts=(*self.doubts, *further), sentence="; ".join((self.sentence, *further))
        )


@dataclass(frozen=True, eq=False)
class Question(ComparedFrames):
    """Whether the scene's circuit, or another explanation, agrees with these frames.

    Attributes
    ----------
    with_effects : tuple of LineEffect
        Effects beside the circuit that the scene names, with their sizes.
    """

    with_effects: tuple[LineEffect, ...] = ()

    @cached_property
    def _shares(self) -> tuple[float, float]:
        """Shares of bounds and of missing readings in the frames to explain."""
        scene = self.specified.scene
        compared = self.specified.readings[np.concatenate([self.resting, self.standing])]
        read = (compared.seen > 0)[:, scene.requested].sum()
        bounded = (compared.bounds & scene.requested).sum() / max(read, 1)
        return float(bounded), float(compared.missing(scene).mean())

    @cached_property
    def explanation(self) -> "Explanation | None":
        """Cells that explain these frames.

        The value is None without a fit, or with more than MAX_MISSING bounds.
        """
        explanation = None
        if self._few_bounds:
            explanation = Explanation.of(self.specified, self, patient=True)
        if explanation is None or not self.with_effects:
            return explanation
        return explanation.with_effects(self.with_effects)

    @cached_property
    def fault(self) -> str:
        """The reason why the circuit cannot have made the readings, in words.

        The text is '' where no reason is known. A law that readings break comes first: it needs no
        search, of which rounding may decide whether it ends at a minimum. A significant misfit
        follows. Readings with effects beside the circuit keep no such law.
        """
        fault = "" if self.with_effects else broken_law(self.specified, self)
        if fault or self.explanation is None:
            return fault
        fits = self.explanation.fits
        if all(fit.within_noise for fit in fits):
            return ""
        worst = int(np.argmin([fit.tail for fit in fits]))
        fit = fits[worst]
        place = self.loaded if worst else "the unloaded panel"
        squares = fit.residual.reshape(fit.cells.shape) ** 2
        rows = squares.sum(axis=1)
        columns = squares.sum(axis=0)
        name, lines = ("row", rows) if rows.max() >= columns.max() else ("column", columns)
        return (
            f"no cells give the readings of {place}: "
            f"chi square is {fit.chi_square:.3g} where some {fit.degrees:.3g} would be noise, "
            f"{name} {np.argmax(lines)} holds {100 * lines.max() / squares.sum():.0f} % of it"
        )

    def hopeless_with(self, errors: Array) -> bool:
        """Return whether no cells explain the frames with errors beside noise.

        Parameters
        ----------
        errors : array, shape (frames, rows, columns)
            Standard deviations, see `named_errors`.
        """
        if self.explanation is None:
            return False
        wider = replace(self, named_errors=errors).readings(self.specified)
        return any(
            fit.hopeless(float(np.max((readings.known_sigma / fit.measured.known_sigma) ** 2)))
            for fit, readings in zip(self.explanation.fits, wider, strict=False)
        )

    @property
    def _few_bounds(self) -> bool:
        """Whether few readings are bounds."""
        return self._shares[0] <= MAX_MISSING

    @property
    def _complete(self) -> bool:
        """Whether enough readings are values, so that circuits and effects can be compared."""
        missing = self._shares[1]
        return missing <= MAX_MISSING and (
            self._few_bounds or bool(below_series(self.specified, self))
        )

    def check(self, besides: CircuitEffects, scatter: float) -> ModelCheck:
        """Return the check of the circuit against its alternatives and against these effects.

        Parameters
        ----------
        besides : CircuitEffects
        scatter : float
            Factor of the unloaded frames' scatter over what the scene specifies; above 1 a doubt.
        """
        if self.explanation is None and not self.fault:
            # too many bounds, or the solver failed
            if self._few_bounds:
                return ModelCheck(
                    None,
                    "the circuit was not checked: no fit of its cells was found",
                    noise=self.widening,
                )
            lawful = (
                "no readings break a law of the circuit; "
                f"{100 * self._shares[0]:.0f} % of them are bounds"
            )
            return ModelCheck(explains=True, sentence=lawful).with_doubts("no cells were fitted")
        best = self._better(besides) if self._complete else BetterExplanation()
        explains = not self.fault and not best.name
        open_doubts, remarks = list[str](), list[str]()
        if explains and self.explanation is not None:
            open_doubts, remarks = undetermined_ends(self.explanation, self)
        alone = best.alone and not (best.nearly or open_doubts)
        compared = explains and alone and not self._uncompared
        check = ModelCheck(
            explains,
            "; ".join((self._verdict(best, alone=alone), *remarks)),
            best.name,
            self.widening,
            besides.common_change,
            bool(best.name) and best is besides,
            besides.loaded_at_rest,
            addition=best.addition,
            compared=compared,
        )
        doubts = []
        if scatter > 1:
            doubts.append(f"the unloaded frames scatter by {scatter:.2g} times the specified noise")
        if explains and best.nearly:
            doubts.append(f"{best.nearly} gives them about as well, or better; then {best.reason}")
        return check.with_doubts(*doubts, *open_doubts)

    def _better(self, besides: CircuitEffects) -> BetterExplanation:
        """Return the better explanation by evidence: another circuit, or these effects.

        The circuit that the scene states is kept where another one is about as likely.
        """
        best = better_alternative(self, None if self.fault else self.explanation)
        if not besides.name or (self.fault and not besides.fits_noise):
            return best
        if not best.name or self.explanation is None:
            return besides
        explained = self.explanation.with_effects(besides.effects)
        return besides if explained.evidence < best.evidence + DOUBTFUL_GAIN else best

    def _verdict(self, best: BetterExplanation, *, alone: bool) -> str:
        """Return the verdict in words: the fault, the best alternative, or neither.

        Parameters
        ----------
        best : BetterExplanation
        alone : bool
            Whether no other known circuit is likelier, or about as likely.
        """
        if self.fault:
            if not self._complete:
                return f"{self.fault}; other circuits were not compared: {self._uncompared}"
            alternative = "no other circuit that was tried gives them"
            if best.name:
                alternative = f"{best.name} does"
            return f"{self.fault}; {alternative}"
        if best.name:
            return f"{best.name} explains the readings better: {best.reason}"
        if self._uncompared:
            return f"{EXPLAINED}; other circuits were not compared: {self._uncompared}"
        return f"{EXPLAINED}, and {NO_LIKELIER}" if alone else EXPLAINED

    @cached_property
    def _uncompared(self) -> str:
        """The reason why other circuits were not compared, in words; '' where they were."""
        if not self._complete:
            return "too many readings are missing or bounds"
        if self.fault or self.explanation is None:
            return ""
        if not len(self.standing):
            return "no frame is loaded"
        pair = self.explanation.pair
        if pair is None:
            return "the panel is too large"
        if pair.beyond_noise < MIN_EVIDENCE_GAIN:  # none can gain as much
            return "loads change too little beside the noise; press more cells"
        if not well_determined(self.explanation.fits):
            return "cells are not determined well enough"
        return ""

    def effects(self, kinds: Sequence[type[LineEffect]]) -> CircuitEffects:
        """Return the effects beside the circuit, of some kinds.

        The evidence is taken from the frames that changed most and from the last frame.
        """
        scene = self.specified.scene
        explanation = self.explanation
        last = np.flatnonzero(self.role == MEASURED)[-1:]
        if (
            explanation is None
            or explanation.pair is None
            or scene.readout is None
            or UNLOADED not in self.role
        ):
            return CircuitEffects()
        resting, frame = explanation.pair.frames
        pairs = [(self.loaded, explanation.pair)]
        if last[0] not in self.standing:
            question = replace(self, standing=last)
            latest = frame.refitted(question.readings(self.specified)[1], frame.effects)
            pairs += [] if latest is None else [(question.loaded, FittedPair((resting, latest)))]
        lies_on = applications().provided("recognition", "a load on unloaded cells")
        intact = np.where(scene.broken, np.nan, np.log(resting.cells))
        loaded = lies_on is not None and resting.within_noise and lies_on(scene.panel, intact)
        return replace(find_effects(pairs, kinds), loaded_at_rest=loaded)


def check_of_modules(
    recording: Recording, layout: Modules, of_module: Callable[[int], ModelCheck]
) -> ModelCheck:
    """Return the joint check of the modules whose readings change most.

    Parameters
    ----------
    recording : Recording
    layout : Modules
    of_module : callable
        Returns the check of one module, given its number.
    """
    readings = recording.readings()
    # modules with the largest change of their readings, without dead and differing ones
    change = mean_change(
        *map(layout.split, (readings.plain_values, baseline_readings(recording, readings).value))
    )
    moved = change[recording.role == MEASURED].max(axis=0, initial=0.0)
    unfit = {*recording.scene.dead_modules, *module_factors(recording, layout)}
    living = [number for number in np.argsort(moved)[::-1].tolist() if number not in unfit]
    checks = {number: of_module(number) for number in sorted(living[: 1 + MAX_NEIGHBOURS])}
    if not checks:
        return ModelCheck(
            None, "the circuit was not checked: no module is like the others and reads values"
        )
    verdicts = [check.explains for check in checks.values()]
    # False if any circuit is contradicted, else True if any is confirmed
    verdict = next((either for either in (False, True) if either in verdicts), None)
    agreeing = {number: check for number, check in checks.items() if check.explains is verdict}
    sentence = "; ".join(
        f"module {list(layout.place(number))}: {check.sentence}"
        for number, check in agreeing.items()
    )
    if len(checks) < layout.count:
        sentence += f"; {len(checks)} of {layout.count} modules were checked, those that move most"
    better = next((check for check in agreeing.values() if check.better), None)
    loaded = any(check.loaded_at_rest for check in checks.values())
    doubts = tuple(dict.fromkeys(doubt for check in agreeing.values() for doubt in check.doubts))
    noise = max(check.noise for check in checks.values())
    return ModelCheck(
        verdict,
        sentence,
        "" if better is None else better.better,
        noise,
        by_effect=better is not None and better.by_effect,
        loaded_at_rest=loaded,
        doubts=doubts,
        addition={} if better is None else better.addition,
        compared=all(check.compared for check in agreeing.values()),
    )


def module_factors(recording: Recording, layout: Modules) -> dict[int, float]:
    """Return the factors by which unloaded readings of single modules differ from the others'.

    Returns
    -------
    dict
        Number of the module to its factor, NaN where no reading is a value. Modules that do not
        differ are left out.
    """
    readings = (
        recording.readings()[recording.role == UNLOADED]
        if UNLOADED in recording.role
        else recording.readings()
    )
    values = np.moveaxis(np.log(layout.split(readings.plain_values)), 1, 0).reshape(
        layout.count, -1
    )
    read = np.isfinite(values).any(axis=1)
    factors = dict.fromkeys(np.flatnonzero(~read).tolist(), np.nan)
    levels = np.nanmedian(values[read], axis=1)
    if len(levels) < MIN_COMPARED_MODULES:
        return factors
    for place, number in enumerate(np.flatnonzero(read).tolist()):
        # ln level less the median of the remaining ones, against their robust standard deviation
        # and MIN_AWAY
        remaining = np.delete(levels, place)
        middle = np.median(remaining)
        deviation = levels[place] - middle
        scatter = float(np.median(np.abs(remaining - middle)))
        if abs(deviation) > max(MIN_AWAY, SIGNIFICANT * MAD_TO_SIGMA * scatter):
            factors[number] = float(np.exp(deviation))
    return factors
