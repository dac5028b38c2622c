"""Check of the scene's circuit: whether it explains the readings.

It also tells which other circuit explains them better. One frame: are there positive cells that
explain the readings within their noise, and do the readings satisfy the circuit's inequalities? Two
frames: the evidence of a circuit decreases with the number of cells that must have moved between
the unloaded panel and a loaded frame. A rival is named if its evidence is larger by
MIN_EVIDENCE_GAIN.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.estimate.cells_fit import CellsFit, fitted
from lampest.estimate.changed_cells import PARAMETER_COST, mostly_still
from lampest.estimate.deciding import MAX_NEIGHBOURS, baseline_readings
from lampest.estimate.nuisances import (
    MAX_CANDIDATES,
    MIN_EVIDENCE_GAIN,
    BetterExplanation,
    CircuitEffects,
    FittedPair,
    find_effects,
)
from lampest.estimate.rivals import Rival, changes_beyond_noise, rivals_of, standing_frames
from lampest.estimate.variance_components import noted_excess
from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import MAD_TO_SIGMA, SIGNIFICANCE, SIGNIFICANT
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.observation import patch_of
from lampest.panel.effects import EFFECTS, Effect
from lampest.panel.panel import Array, Modules
from lampest.panel.readouts.branches import branch
from lampest.posterior.interval import largest_of
from lampest.recording.readings import Readings, mean_change, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

EXPLAINED = "the circuit explains its readings"
# Deviation of ln of a module's median reading at rest from the other modules: none of 1,640
# simulated modules whose cells scatter by 0.2 exceeds it, and a reference that is off by 20 % does.
MIN_AWAY = 0.15
# −2 ln evidence by which another circuit may beat the scene's without a doubt: of 430 recordings
# with the right circuit nearly all gain less (docs/theory/model_check.md).
DOUBTFUL_GAIN = 15.0
# Share of missing readings or bounds: with a fifth, moved cells can no longer be identified.
MAX_MISSING = 0.1
# Of the largest resistance in series that readings allow: all of it would short the panel.
MAX_SERIES_SHARE = 0.98
# Median standard deviation of the log cells beyond which linear theory does not hold: 8 bits and
# one reading on 12 x 8 cells leave 1.4, and distinguishable circuits at most 0.2
# (docs/studies/model_check.py).
MAX_CELL_SD = 0.5
SERIES_POINTS = 5  # resistances in series that are tried, before a search about the best one
# Fractions of the channel before that a converter may keep.
MEMORIES = (0.01, 0.02, 0.04, 0.08, 0.16)
MEMORY_ACCURACY = 0.03  # of the search about the best one, as a share of it
SERIES_ACCURACY = 0.05  # of that search, as a share of their distance


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
    doubts : tuple of str
        Reasons why a circuit that explains the readings is not certain.

    >>> lampest.ModelCheck(True, "the circuit explains its readings").mark
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

    @property
    def mark(self) -> str:
        """The verdict: 'yes', 'no', or 'doubtful'.

        It is 'doubtful' where the circuit was not checked or something speaks against it.
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
class Question:
    """Frames that a circuit has to explain.

    Attributes
    ----------
    specified : Rival
        The scene's circuit, with a saturated stage where the readings show one; outliers are
        missing.
    role : array, shape (frames,)
    resting, standing : integer array
        Numbers of the unloaded frames, and of measured frames that are equal within their noise.
    widening : float
        Factor on every σ.
    named : integer array, shape (frames,)
        Numbers of all frames as sentences state them.
    """

    specified: Rival
    role: NDArray[np.uint8]
    resting: NDArray[np.intp]
    standing: NDArray[np.intp]
    widening: float
    named: NDArray[np.intp]

    @classmethod
    def of(cls, recording: Recording, outliers: NDArray[np.bool_]) -> "Question":
        """Return the frames of a recording whose noise is known.

        Without an unloaded frame the first is used.
        """
        role = recording.role
        specified = Rival(
            recording.scene, np.where(outliers, np.nan, recording.recorded), recording.sigma
        )
        readings = specified.readings()
        named = np.arange(len(role)) if recording.number is None else recording.number
        resting = np.flatnonzero(role == UNLOADED) if np.any(role == UNLOADED) else np.array([0])
        standing = np.setdiff1d(np.flatnonzero(role == MEASURED), resting)
        # The most strongly loaded frame, averaged with those that are equal to it within their
        # noise.
        used = replace(readings, seen=readings.seen * specified.nearly_gaussian(1))
        noise = noise_factor(used[resting])
        if len(standing):
            frame = strongest_frame(readings.plain_values, readings[resting].mean().value, standing)
            standing = standing_frames(used, frame, standing, noise)
        return cls(specified, role, resting, standing, noise, named)

    @property
    def loaded(self) -> str:
        """The loaded frames in words: 'frame 3', or 'frames 3 to 9'."""
        first, last = self.named[self.standing[[0, -1]]]
        return f"frame {first}" if first == last else f"frames {first} to {last}"

    def readings(self, rival: Rival) -> tuple[Readings, ...]:
        """Return the mean of the unloaded frames, and of the standing ones.

        Raises InputError as `Rival.readings`.
        """
        chosen = np.concatenate([self.resting, self.standing])
        count = len(self.resting)
        read = rival.readings(chosen)
        usable = rival.ordered(self._usable[chosen])
        read = replace(read, sigma=self.widening * read.known_sigma, seen=read.seen * usable)
        resting = read[:count].mean()
        return (resting,) if len(self.standing) == 0 else (resting, read[count:].mean())

    @cached_property
    def _usable(self) -> Array:
        """Weights, 1 or 0, of the readings that every circuit has to explain.

        Shape (frames, rows, columns).
        """
        return self.specified.nearly_gaussian(max(len(self.resting), len(self.standing)))

    @cached_property
    def _shares(self) -> tuple[float, float]:
        """Shares of bounds and of missing readings in the frames to explain."""
        scene = self.specified.scene
        compared = self.specified.readings(np.concatenate([self.resting, self.standing]))
        read = (compared.seen > 0)[:, scene.requested].sum()
        bounded = (compared.bounds & scene.requested).sum() / max(read, 1)
        return float(bounded), float(compared.missing(scene).mean())

    @cached_property
    def explanation(self) -> "Explanation | None":
        """Cells that explain these frames.

        None without a fit, or with more than MAX_MISSING bounds.
        """
        return (
            Explanation.of(self.specified, self, patient=True)
            if self._shares[0] <= MAX_MISSING
            else None
        )

    @cached_property
    def fault(self) -> str:
        """The reason why the circuit cannot have made the readings, in words.

        It is '' where there is none.
        """
        unexplained = "" if self.explanation is None else _unexplained(self.explanation, self)
        return unexplained or broken_law(self.specified, self) or self.below

    @cached_property
    def below(self) -> str:
        """The reading that lies significantly below its series resistance, in words.

        It is '' where there is none.
        """
        scene = self.specified.scene
        readings = self.specified.readings()
        if scene.circuit.unit != "ohm" or readings.sigma is None:
            return ""
        left = scene.circuit.from_recorded(self.specified.recorded, scene)
        excess = np.where((readings.seen > 0) & np.isfinite(left), -left / readings.sigma, -np.inf)
        if largest_of(excess.max(), excess.size) >= SIGNIFICANCE:
            return ""
        frame, row, column = place = np.unravel_index(np.argmax(excess), excess.shape)
        return (
            f"the reading of row {row}, column {column} in frame {self.named[frame]} lies "
            f"{-left[place]:.3g} ohm "
            f"below its series resistance, {excess[place]:.3g} times its noise"
        )

    def check(self, besides: CircuitEffects) -> ModelCheck:
        """Return the check of the circuit against its rivals and against these effects."""
        bounded, missing = self._shares
        noise = self.widening
        fault = self.fault
        explanation = self.explanation
        few_bounds = bounded <= MAX_MISSING
        # No fit and no contradiction: too many bounds, or the solver failed.
        if explanation is None and not fault:
            if not few_bounds:
                lawful = (
                    f"no readings break a law of the circuit; {100 * bounded:.0f} % of them "
                    "are bounds"
                )
                return ModelCheck(explains=True, sentence=lawful).with_doubts(
                    "no cells were fitted"
                )
            return ModelCheck(
                None, "the circuit was not checked: no fit of its cells was found", noise=noise
            )
        # Rivals and effects compete by evidence if enough readings are values.
        best = BetterExplanation()
        complete = missing <= MAX_MISSING and (few_bounds or bool(self.below))
        if complete:
            best = better_rival(self, None if fault else explanation)
            if (
                besides.name
                and (besides.fits_noise or not fault)
                and (not best.name or besides.count < best.count)
            ):
                best = besides
        # Verdict in words: the fault, the best alternative, or neither; then the noise.
        if not complete:
            sentence = (
                f"{fault or EXPLAINED}; other circuits were not tried, too many readings "
                "are missing or bounds"
            )
        elif fault:
            others = (
                f"{best.name} does" if best.name else "no other circuit that was tried gives them"
            )
            sentence = f"{fault}; {others}"
        else:
            sentence = (
                f"{best.name} explains the readings better: {best.reason}"
                if best.name
                else EXPLAINED
            )
        named_best = bool(best.name) and best is besides
        explains = not fault and not best.name
        check = ModelCheck(
            explains,
            sentence,
            best.name,
            noise,
            besides.common_change,
            named_best,
            besides.loaded_at_rest,
        )
        scatter = (
            f"the unloaded frames scatter by {noise:.2g} times the specified noise"
            if noise > 1
            else ""
        )
        nearly = (
            f"{best.nearly} explains them about as well, or better"
            if explains and best.nearly
            else ""
        )
        return check.with_doubts(scatter, nearly)

    def effects(self, kinds: Sequence[type[Effect]] = EFFECTS) -> CircuitEffects:
        """Return the effects beside the circuit.

        They are from the frames that changed most and from the last frame.
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
            latest = frame.refitted(question.readings(self.specified)[1], ())
            pairs += [] if latest is None else [(question.loaded, FittedPair.of(resting, latest))]
        search = Detector(patch_of(scene.panel)).search(scene.panel)
        intact = np.where(scene.broken, np.nan, np.log(resting.cells))
        loaded = resting.tail >= SIGNIFICANCE and search.lies_on(intact)
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
    explains = [check.explains for check in checks.values()]
    verdict = False if False in explains else True if True in explains else None
    agreeing = {number: check for number, check in checks.items() if check.explains is verdict}
    sentence = "; ".join(
        f"module {list(layout.place(number))}: {check.sentence}"
        for number, check in agreeing.items()
    )
    if len(checks) < layout.count:
        sentence += f"; {len(checks)} of {layout.count} modules were checked, those that move most"
    better = next((check.better for check in agreeing.values() if check.better), "")
    loaded = any(check.loaded_at_rest for check in checks.values())
    doubts = tuple(dict.fromkeys(doubt for check in agreeing.values() for doubt in check.doubts))
    noise = max(check.noise for check in checks.values())
    return ModelCheck(verdict, sentence, better, noise, loaded_at_rest=loaded, doubts=doubts)


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
    for place, number in enumerate(np.flatnonzero(read).tolist() if len(levels) > 2 else ()):
        # ln level less the median of the remaining ones, against 5 robust standard deviations of
        # these and MIN_AWAY
        remaining = np.delete(levels, place)
        deviation = levels[place] - np.median(remaining)
        if abs(deviation) > max(
            MIN_AWAY,
            SIGNIFICANT * MAD_TO_SIGMA * float(np.median(np.abs(remaining - np.median(remaining)))),
        ):
            factors[number] = float(np.exp(deviation))
    return factors


def noise_factor(resting: Readings) -> float:
    """Return √(χ²/degrees) of unloaded frames (frames, rows, columns) about their mean.

    See `noted_excess`.
    """
    plain = np.all(resting.plain, axis=0)
    if resting.sigma is None:
        return 1.0
    squares = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain] ** 2
    return noted_excess(float(squares.sum()), (len(resting.value) - 1) * int(plain.sum()))


def _unexplained(explanation: "Explanation", question: Question) -> str:
    """Return the significant misfit of the explanation in words; '' where there is none."""
    worst = int(np.argmin([fit.tail for fit in explanation.fits]))
    fit = explanation.fits[worst]
    place = question.loaded if worst else "the unloaded panel"
    if fit.tail >= SIGNIFICANCE:
        return ""
    squares = fit.residual.reshape(fit.cells.shape) ** 2
    rows = squares.sum(axis=1)
    columns = squares.sum(axis=0)
    name, lines = ("row", rows) if rows.max() >= columns.max() else ("column", columns)
    return (
        f"no cells give the readings of {place}: chi square is {fit.chi_square:.3g} where some "
        f"{fit.degrees:.3g} "
        f"would be noise, {name} {np.argmax(lines)} holds {100 * lines.max() / squares.sum():.0f} "
        "% of it"
    )


def broken_law(rival: Rival, question: Question) -> str:
    """Return the circuit's inequality that the readings violate significantly, in words.

    It is '' where there is none.
    """
    readings = rival.readings()
    sigma = replace(
        readings, seen=readings.seen * question.specified.nearly_gaussian(1)
    ).sigma_of_values
    assert sigma is not None
    for test in rival.scene.circuit.free_tests(readings.value, question.widening * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < SIGNIFICANCE:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            return (
                f"readings of frame {question.named[frame]} break a law of the circuit by "
                f"{beyond}: {test.law}"
            )
    return ""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Cells that explain the readings under a circuit.

    Attributes
    ----------
    rival : Rival
        The circuit.
    fits : tuple of CellsFit
        Fits of the unloaded panel and, if there is one, of the loaded frame.
    pair : FittedPair or None
        The pair of both; None without a loaded frame, or on a panel of more than MAX_CELLS.
    """

    rival: Rival
    fits: tuple[CellsFit, ...]
    pair: FittedPair | None

    @classmethod
    def of(
        cls,
        rival: Rival,
        question: Question,
        near: "Explanation | None" = None,
        *,
        patient: bool = False,
    ) -> "Explanation | None":
        """Return a circuit's explanation of the frames; None where no fit is found.

        Parameters
        ----------
        rival : Rival
        question : Question
        near : Explanation or None
            Explanation by a similar circuit, at whose cells the fits begin.
        patient : bool
            Whether the fit is searched for from every start and accepted with any misfit. Otherwise
            the circuit is given up at the first frame that it does not explain.
        """
        fits: list[CellsFit] = []
        with suppress(InputError, *BROKEN):
            for number, readings in enumerate(question.readings(rival)):
                start = None if near is None else near.fits[number].cells
                fit = fitted(rival.scene, readings, start, patient=patient)
                # of two panels that read alike the one that continues the unloaded panel is meant
                if fit is not None and fits and branch(fit.network) != branch(fits[0].network):
                    fit = fitted(rival.scene, readings, fits[0].cells, patient=patient)
                if fit is None or (not patient and fit.tail < SIGNIFICANCE):
                    return None
                fits.append(fit)
            pair = FittedPair.of(*fits) if len(fits) == 2 and fits[0].jacobian.size else None
            explanation = cls(rival, tuple(fits), pair)
            return explanation if np.isfinite(explanation.score) else None
        return None

    @cached_property
    def _costs(self) -> float:
        """Misfit χ² of each frame, and PARAMETER_COST of each bound.

        Thus no circuit gains by bounds.
        """
        return sum(
            fit.chi_square + PARAMETER_COST * int(fit.readings.bounds.sum()) for fit in self.fits
        )

    @cached_property
    def score(self) -> float:
        """−2 ln density of the loaded frame, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.density + self._costs

    @cached_property
    def beyond_noise(self) -> float:
        """−2 ln evidence of the changes beyond that of noise alone, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.beyond_noise + self._costs


def better_rival(question: Question, specified: Explanation | None) -> BetterExplanation:
    """Return the rival that explains the readings better than the scene's circuit.

    It explains them where the scene's circuit does not, or better by MIN_EVIDENCE_GAIN. Rivals
    under which most cells have moved do not count, because the still cells cannot be identified
    then.

    Parameters
    ----------
    question : Question
    specified : Explanation or None
        The explanation by the scene's circuit; None where it does not explain the readings.
    """
    if specified is not None:
        pair = specified.pair
        if pair is None or pair.beyond_noise < MIN_EVIDENCE_GAIN:
            return BetterExplanation()
        if np.median([np.sqrt(np.diag(fit.covariance)) for fit in specified.fits]) > MAX_CELL_SD:
            return BetterExplanation()
    change = changes_beyond_noise(
        question.specified.scene, question.specified.readings(), question.role
    )
    rivals = rivals_of(
        question.specified, reversed_too=bool(change.max(initial=0.0) > -change.min(initial=0.0))
    )
    explanations = [
        Explanation.of(rival, question) or some_in_series(rival, question) for rival in rivals
    ]
    explanations += [some_in_series(question.specified, question)] if specified is None else []
    threshold = np.inf if specified is None else specified.score
    likely = sorted(
        (known for known in explanations if known and known.score < threshold),
        key=attrgetter("score"),
    )
    likely = likely[:MAX_CANDIDATES]
    assumed = [] if specified is None else [specified]
    tried = [*likely, *(with_series(known, question) for known in (*likely, *assumed))]
    tried += [with_converter_memory(known, question) for known in assumed]
    quiet = (known for known in tried if known.pair is None or mostly_still(known.pair.moved))
    lawful = (known for known in quiet if not broken_law(known.rival, question))

    # Among rivals a resistance in series is one more parameter.
    def cost(known: Explanation) -> float:
        numbers = (known.rival.in_series is not None) + (
            known.rival.scene.converter_memory != memory
        )
        return known.beyond_noise + PARAMETER_COST * numbers

    memory = question.specified.scene.converter_memory
    best = min((known for known in lawful if known.rival.name), key=cost, default=None)
    if best is None:
        return BetterExplanation()
    if specified is None or best.pair is None:
        return BetterExplanation(best.rival.name)
    gain = (specified.beyond_noise - best.beyond_noise) / best.pair.excess
    if specified.pair is None or gain <= DOUBTFUL_GAIN or not best.pair.moved.any():
        return BetterExplanation()
    if gain <= MIN_EVIDENCE_GAIN or specified.pair.gain_apart(best.pair) <= PARAMETER_COST:
        # A resistance in series follows hidden errors of the circuit, a memory the edge of a load:
        # alone, neither is a doubt.
        doubtful = best.rival.kind and best.rival.scene.converter_memory == memory
        return BetterExplanation(
            nearly=best.rival.name if gain <= MIN_EVIDENCE_GAIN and doubtful else ""
        )
    moved, as_specified = (int(known.moved.sum()) for known in (best.pair, specified.pair))
    return BetterExplanation(best.rival.name, question.loaded, moved, as_specified)


def some_in_series(rival: Rival, question: Question) -> Explanation | None:
    """Return a circuit's explanation with the best one of SERIES_POINTS resistances in series.

    None without any.
    """
    most = most_in_series(rival, question)
    points = np.linspace(0.0, most, SERIES_POINTS) if most else ()
    tried = (replace(rival.with_series(ohm), at_limit=ohm in (0.0, most)) for ohm in points)
    explanations = (Explanation.of(candidate, question) for candidate in tried)
    return min(filter(None, explanations), key=attrgetter("score"), default=None)


def with_series(given: Explanation, question: Question) -> Explanation:
    """Return a circuit's explanation with the most probable or the given resistance in series."""
    coarse = given if given.rival.in_series is not None else some_in_series(given.rival, question)
    best = min(filter(None, (given, coarse)), key=attrgetter("score"))
    spacing = most_in_series(given.rival, question) / (SERIES_POINTS - 1)
    if not spacing:
        return best

    def score(ohm: float) -> float:
        nonlocal best
        explanation = Explanation.of(
            replace(given.rival.with_series(ohm), at_limit=False), question, best
        )
        if explanation is None:
            return np.inf
        best = min(best, explanation, key=attrgetter("score"))
        return explanation.score

    ends = max(best.rival.ohm - spacing, 0.0), best.rival.ohm + spacing
    accuracy = SERIES_ACCURACY * spacing
    scipy.optimize.minimize_scalar(
        score, bounds=ends, method="bounded", options={"xatol": accuracy}
    )
    most = (SERIES_POINTS - 1) * spacing
    at_limit = not 2 * accuracy < best.rival.ohm < most - 2 * accuracy
    return (
        replace(best, rival=replace(best.rival, at_limit=at_limit))
        if best.rival.in_series is not None
        else best
    )


def with_converter_memory(given: Explanation, question: Question) -> Explanation:
    """Return a circuit's explanation with the most probable or the given converter memory.

    A scene that states a memory keeps it.
    """
    if given.rival.scene.converter_memory is not None or given.rival.scene.readout is None:
        return given
    best = given

    def score(fraction: float) -> float:
        nonlocal best
        explanation = Explanation.of(given.rival.with_memory(float(fraction)), question, best)
        if explanation is None:
            return np.inf
        best = min(best, explanation, key=attrgetter("score"))
        return explanation.score

    coarse = min(MEMORIES, key=score)
    if best is given:
        return given
    ends = coarse / 2, 2 * coarse
    scipy.optimize.minimize_scalar(
        score, bounds=ends, method="bounded", options={"xatol": MEMORY_ACCURACY * coarse}
    )
    fraction = best.rival.scene.known_memory or 0.0
    return best if MEMORIES[0] / 2 * 1.1 < fraction < MEMORIES[-1] * 1.9 else given


def most_in_series(rival: Rival, question: Question) -> float:
    """Return the largest resistance in series that the readings allow, ohm.

    It is 0 where none is possible or known.
    """
    if not rival.scene.circuit.series_name or len(question.standing) == 0:
        return 0.0
    without = rival.with_series(0.0)
    try:
        read = question.readings(without)
    except (InputError, *BROKEN):
        return 0.0
    known = [(frame.value, sigma) for frame in read if (sigma := frame.sigma_of_values) is not None]
    most = min(
        without.scene.circuit.most_in_series(value[None], sigma[None]) for value, sigma in known
    )
    return MAX_SERIES_SHARE * most if np.isfinite(most) and most > 0 else 0.0
