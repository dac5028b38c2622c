"""Effects beside the circuit: leaks of wet lines, loose contacts, common creep of the film.

All effects are tried by linear theory on a pair of frames (`lampest.inference.pair`). The
best ones then enter the network itself. An effect is named if the evidence gains by
MIN_EVIDENCE_GAIN. Readings can be corrected for the effects that were found.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lampest.files.applications import loaded
from lampest.files.errors import BROKEN
from lampest.files.levels import MIN_EVIDENCE_GAIN, SIGNIFICANT, UNUSUAL
from lampest.inference.assumptions import ASSUMED
from lampest.inference.circuits.loaded_density import LoadedDensity
from lampest.inference.evidence import PARAMETER_COST, mostly_still
from lampest.inference.pair import FittedPair, without_late
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.panel import Array, Mask
from lampest.panel.sizes import ESTIMATED, SIZED
from lampest.recording.readings import Readings
from lampest.recording.recording import MIN_CHANGE

# Alternatives or effects that are solved exactly, the best ones of linear theory; effects at a
# time.
MAX_CANDIDATES = 3
# Fewer moved cells that an effect must bring: a converter's nonlinearity moves one.
MIN_SPARED_CELLS = 2
TAKEN_OFF = "taken off the readings"
WRONG_READING = 100.0  # error of one reading, in its unit: any size that noise does not limit
MIN_REMAINING = 0.1  # of a reading: the lower limit of a corrected reading


@dataclass(frozen=True, eq=False)
class BetterExplanation:
    """Another circuit, or an effect besides the scene's, that explains the readings better.

    Attributes
    ----------
    name : str
        The circuit or the effects in words; '' where nothing explains the readings better.
    frames : str
        The loaded frames in words.
    evidence : float
        −2 ln evidence of the compared frames.
    factors : array
        Cells under the scene's circuit over those under the better explanation, unloaded and in
        these frames.
    fits_noise : bool
        Whether cells explain the readings of the unloaded panel and of the frames within their
        noise.
    nearly : str
        A circuit in words that explains the readings better, but not significantly; ''.
    alone : bool
        Whether no other known circuit is likelier.
    addition : mapping
        Entries of a scene that state the circuit or the effects; empty where none do.
    """

    name: str = ""
    frames: str = ""
    evidence: float = np.inf
    factors: Array = field(default_factory=lambda: np.ones(1))
    fits_noise: bool = True
    nearly: str = ""
    alone: bool = True
    addition: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reason(self) -> str:
        """The reason why it is named, in words."""
        low, middle, high = np.quantile(self.factors, (0.05, 0.5, 0.95))
        return (
            f"with the scene's circuit cells of the unloaded panel and of {self.frames} are wrong "
            f"by a factor of {middle:.2g} (median; {low:.2g} to {high:.2g} in nine of ten)"
        )


def cell_factors(specified: FittedPair, better: FittedPair) -> Array:
    """Return the cells of one pair of frames over those of another, where both are cells."""
    pairs = zip(specified.frames, better.frames, strict=True)
    ratios = np.concatenate([(first.cells / second.cells).ravel() for first, second in pairs])
    return np.asarray(ratios[np.isfinite(ratios) & (ratios > 0)])


def candidates(shape: tuple[int, ...], kinds: Sequence[type[LineEffect]]) -> list[LineEffect]:
    """Return the effects of some kinds that are tried on a panel.

    Effects since the unloaded frames come first, then the constant ones.
    """
    rows, columns = shape
    return [
        kind(lines, since)
        for since in (True, False)
        for kind in kinds
        if kind.may_begin or not since
        for lines in kind.places(rows, columns)
    ]


@dataclass(frozen=True, eq=False)
class CircuitEffects(BetterExplanation):
    """Effects beside the circuit that a recording shows.

    Attributes
    ----------
    common_change : str
        The common change of all untouched cells in words; '' where it is not significant.
    pair : FittedPair or None
        The pair with the unambiguous effects alone, those that no other effect explains about as
        well.
    effects : tuple of LineEffect
        All of them.
    loaded_at_rest : bool
        Whether a load may lie on the unloaded panel.
    """

    common_change: str = ""
    pair: FittedPair | None = None
    effects: tuple[LineEffect, ...] = ()
    loaded_at_rest: bool = False

    @property
    def corrections(self) -> str:
        """Effects that are taken off the readings, in words."""
        names = list[str]()
        if self.pair is not None:
            names = [effect.sentence(self.pair.shape[0]) for effect in self.pair.effects]
        return f"{' and '.join(names)}: {TAKEN_OFF}"


# Returns the effects beside the circuit, of some kinds.
Besides = Callable[[tuple[type[LineEffect], ...]], CircuitEffects]


def find_effects(
    pairs: Sequence[tuple[str, FittedPair]], kinds: Sequence[type[LineEffect]]
) -> CircuitEffects:
    """Return the effects with the largest gain of evidence.

    Parameters
    ----------
    pairs : sequence of (str, FittedPair)
        Name of the frame, and its pair with the unloaded panel.
    kinds : sequence of type
        Kinds of effects that are searched for.
    """
    besides = CircuitEffects()
    common = ""
    largest_gain = 0.0
    for name, pair in pairs:
        common = _common_change_in_words(pair) or common
        grown, certain = _with_added_effects(pair, kinds)
        gain = pair.evidence.score - grown.evidence.score
        # An effect counts if most cells stand still with it, and neither a load's edge nor one
        # wrong reading explains as much: an outlier in the frame in which a load arrives is hard to
        # detect in time.
        if not (gain > largest_gain and mostly_still(grown.moved)):
            continue
        off_by_one = pair.scores_with((), WRONG_READING * pair.frames[1].gain).min()
        if off_by_one < grown.evidence.score + MIN_EVIDENCE_GAIN or pair.gain_apart(grown) <= 0:
            continue
        if not _cost(pair) - _cost(grown) > MIN_EVIDENCE_GAIN:
            continue
        largest_gain = gain
        names = " and ".join(effect.sentence(pair.shape[0]) for effect in grown.effects)
        taken_off = bool(certain.effects) and grown.fits_noise
        besides = CircuitEffects(
            names,
            name,
            factors=cell_factors(pair, grown),
            fits_noise=grown.fits_noise,
            addition={effect.key: ESTIMATED for effect in grown.effects if effect.key},
            pair=certain if taken_off else None,
            effects=grown.effects,
        )
    if besides.name:
        return besides
    stated = next((pair for _, pair in pairs if pair.effects), None)
    return replace(besides, common_change=common, pair=stated)


def _cost(pair: FittedPair) -> float:
    """Return −2 ln density of the loaded readings about the most probable cells, with effects."""
    with suppress(*BROKEN):
        return LoadedDensity(pair).cost + pair.cost_of_effects
    return np.inf


def _with_added_effects(
    pair: FittedPair, kinds: Sequence[type[LineEffect]]
) -> tuple[FittedPair, FittedPair]:
    """Add effects to a pair one by one, while each gains evidence and spares moved cells.

    An effect has to gain MIN_EVIDENCE_GAIN and to spare MIN_SPARED_CELLS moved cells.

    Returns
    -------
    FittedPair
        With all effects.
    FittedPair
        With the unambiguous effects: those added before the first one that another candidate
        explains about as well, within half of MIN_EVIDENCE_GAIN.
    """
    certain = pair
    doubtful = False
    for _ in range(MAX_CANDIDATES):
        tried = sorted(
            _with_one_more_effect(pair, kinds), key=lambda candidate: candidate.evidence.score
        )
        if not tried:
            break
        best = tried[0]
        if pair.evidence.score - best.evidence.score <= MIN_EVIDENCE_GAIN:
            break
        if best.moved.sum() > pair.moved.sum() - MIN_SPARED_CELLS:
            break
        if len(tried) > 1:
            lead = tried[1].evidence.score - best.evidence.score
            doubtful |= lead < MIN_EVIDENCE_GAIN / 2
        pair = best
        certain = certain if doubtful else pair
    return pair, certain


def _with_one_more_effect(
    pair: FittedPair, kinds: Sequence[type[LineEffect]]
) -> Iterator[FittedPair]:
    """Generate the pairs with one more effect, the best MAX_CANDIDATES effects of linear theory.

    About cells that do not give the readings there is no linear theory. Effects of the whole panel
    are tried there with their usual size.
    """
    effects = candidates(pair.shape, kinds)
    if not pair.fits_noise:
        for effect in effects:
            usual = (*pair.effects, replace(effect, size=effect.prior))
            begun = None if effect.lines else pair.with_effects(usual)
            settled = None if begun is None else begun.settled(usual)
            if settled is not None:
                yield settled
    scores = pair.scores_with(pair.effects, pair.columns(effects))
    for number in np.argsort(scores)[:MAX_CANDIDATES]:
        if scores[number] > pair.evidence.score - PARAMETER_COST:
            return
        settled = pair.settled((*pair.effects, effects[number]), pair.evidence.score)
        if settled is not None:
            yield settled


def _common_change_in_words(pair: FittedPair) -> str:
    """Return the common change of all cells that no load touches, in words.

    The text is '' for a change that may be chance, or a load's rim, and for one that is too large
    for creep and temperature: a load that covers the panel.
    """
    change, sd = (
        float(ASSUMED.common_change * part[0]) for part in (pair.evidence.size, pair.evidence.sd)
    )
    is_change = abs(change) > max(MIN_CHANGE, SIGNIFICANT * sd)
    is_load = abs(change) > UNUSUAL * ASSUMED.common_change
    if "creep" not in SIZED or not mostly_still(pair.moved) or not is_change or is_load:
        return ""
    return str(loaded(SIZED["creep"])().sentence(change, sd))


def without_effects_of(pair: FittedPair, readings: Readings, unloaded: Mask) -> Readings:
    """Return the readings corrected for the pair's effects.

    Effects since the unloaded frames come, grow and go: their sizes are estimated anew in every
    measured frame. A frame that no cells explain takes the correction of the frame before. A leak
    reduces the differences between readings, so σ grows by `CellsFit.amplification`.

    Parameters
    ----------
    pair : FittedPair
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)

    Returns
    -------
    Readings
        (frames, rows, columns).
    """
    value = readings.value.copy()
    sigma = readings.known_sigma.copy()
    resting = pair.frames[0]
    fit = replace(resting, effects=without_late(pair.effects))
    value[unloaded] -= fit.offset
    sigma[unloaded] *= fit.amplification
    for frame in np.flatnonzero(~unloaded):
        fit = pair.frame_like(readings[frame], fit) or fit
        value[frame] -= fit.offset
        sigma[frame] *= fit.amplification
    return replace(readings, value=np.maximum(value, MIN_REMAINING * readings.value), sigma=sigma)


def remaining_errors(pair: FittedPair) -> Array:
    """Return the change of the readings by one posterior standard deviation of each effect.

    Returns
    -------
    array, shape (2, effects, rows, columns)
        Fractions of the readings of the unloaded panel, then of the frame.
    """
    deviations = pair.deviations
    errors = np.zeros((2, len(deviations), *pair.shape))
    for place, (effect, deviation) in enumerate(zip(pair.effects, deviations, strict=True)):
        addition = replace(effect, size=float(deviation) * effect.prior)
        affected_frames = (1,) if effect.since else (0, 1)
        for number in affected_frames:
            frame = pair.frames[number]
            errors[number, place] = frame.more(addition) / frame.measured.value
    return errors
