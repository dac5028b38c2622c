"""Choice of the alternative circuit that explains a recording better than the scene's.

An alternative counts if its evidence is larger by MIN_EVIDENCE_GAIN. Its resistance in series, that
of its idle lines and the memory of its converter are those of largest evidence.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from lampest.files.levels import DOUBTFUL_GAIN, MIN_EVIDENCE_GAIN
from lampest.inference.cells_fit import SMALL_CHI_SQUARE, CellsFit, well_determined
from lampest.inference.circuits.alternatives import (
    Alternative,
    alternatives_of,
    changes_beyond_noise,
    in_other_scan_order,
    other_converters,
    rounded_down,
)
from lampest.inference.circuits.explanation import (
    FAR,
    ComparedFrames,
    Explanation,
    alternative_fits,
    broken_law,
)
from lampest.inference.circuits.open_ends import DOUBTFUL_SHIFT
from lampest.inference.circuits.parameters import (
    some_in_series,
    with_converter_memory,
    with_number,
    with_series,
    without_series,
)
from lampest.inference.evidence import PARAMETER_COST, mostly_still
from lampest.inference.nuisances import MAX_CANDIDATES, BetterExplanation, cell_factors
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array

# Fits end within some hundredths of their smallest χ², alternatives within SMALL_CHI_SQUARE.
SAME_COST = SMALL_CHI_SQUARE
COST_DIGITS = 6  # of a cost, behind the point: further ones are rounding
# Of a circuit under which a load lowers no resistance, in -2 ln evidence, beside one of falling
# codes: a press lowers some, and so does a cup's rim.
RISING_COST = 24.0
MAX_COUPLED = 0.3  # of the largest rise: falls that channels couple to it
MIN_RISEN = 3  # cells: fewer may be a cup's alone
# Shares beyond which moved cells show couplings that a circuit lacks: of a line's cells, and of the
# moved cells in such lines.
MIN_FILLED = 0.5
MIN_IN_FILLED = 0.5


def better_alternative(frames: ComparedFrames, specified: Explanation | None) -> BetterExplanation:
    """Return the alternative that explains the readings better than the scene's circuit.

    A better alternative explains them where the scene's circuit does not, or gains more than
    MIN_EVIDENCE_GAIN.

    Parameters
    ----------
    frames : ComparedFrames
    specified : Explanation or None
        The explanation by the scene's circuit; None where it does not explain the readings.
    """
    if specified is not None:
        pair = specified.pair
        # Linear theory does not hold where cells are determined badly: no alternative is tried.
        if pair is None or not well_determined(specified.fits):
            return BetterExplanation()
        if pair.beyond_noise < MIN_EVIDENCE_GAIN:
            return BetterExplanation()
    likely = _without_twins(_likely_alternatives(frames, specified))
    candidates = [with_number(explanation, frames) for explanation in likely]
    assumed = [] if specified is None else [specified]
    candidates += [with_series(explanation, frames) for explanation in (*candidates, *assumed)]
    candidates += [with_converter_memory(explanation, frames) for explanation in assumed]
    for explanation in assumed:
        for alternative in in_other_scan_order(explanation.alternative):
            remembering = with_converter_memory(
                replace(explanation, alternative=alternative), frames
            )
            candidates += [remembering] if remembering.alternative is not alternative else []
    linear = attrgetter("linear_evidence")
    best = _best_candidate(candidates, frames, linear, at_fault=specified is None)
    if best is not None and specified is not None and best.pair is not None:
        # Linear theory costs little, and most candidates gain nothing by it.
        excess = best.pair.excess
        if any(_may_decide(specified, candidate, excess) for candidate in candidates):
            limit = specified.linear_evidence - DOUBTFUL_GAIN * excess
            likely = [candidate for candidate in candidates if candidate.linear_evidence < limit]
            best = _best_candidate(likely, frames, attrgetter("evidence"), at_fault=False) or best
    return BetterExplanation() if best is None else _compared(specified, best, frames)


def _likely_alternatives(
    frames: ComparedFrames, specified: Explanation | None
) -> list[Explanation]:
    """Return the MAX_CANDIDATES best explanations by alternatives, better ones than the scene's.

    Of each number that alternatives have to estimate there is one more.
    """
    # Circuits that only exchange the names of lines have the evidence of the scene's.
    limit = np.inf if specified is None else specified.linear_evidence - SAME_COST
    explanations = _by_alternatives(frames, specified, limit)
    better = [explanation for explanation in explanations if explanation.linear_evidence < limit]
    # Circuits that differ in words alone keep the order in which they are tried.
    better = sorted(better, key=lambda each: round(each.linear_evidence, COST_DIGITS))
    best = [each for each in better if not each.alternative.number][:MAX_CANDIDATES]
    # Of each number that is to be estimated the tried value with the largest evidence.
    numbers = {each.alternative.number: each for each in reversed(better)}
    best += [explanation for number, explanation in numbers.items() if number]
    return [explanation.final for explanation in best]


def _by_alternatives(
    frames: ComparedFrames, specified: Explanation | None, limit: float
) -> list[Explanation]:
    """Return the explanations by alternatives; with the resistance in series that some need.

    Values of an open number are tried from the weakest hold on, while they are no worse than the
    best by more than FAR: the evidence has one maximum, but for ripples below FAR. Alternatives
    whose inequalities the readings break are not fitted. A resistance in series only makes these
    inequalities narrower, so that they are tested without one.

    Parameters
    ----------
    frames : ComparedFrames
    specified : Explanation or None
    limit : float
        −2 ln evidence from which on explanations do not count.
    """
    change = changes_beyond_noise(frames.specified.scene, frames.specified.readings, frames.role)
    mostly_increases = bool(change.max(initial=0.0) > -change.min(initial=0.0))
    explanations = list[Explanation]()
    failed = list[tuple[Alternative, tuple[CellsFit, ...]]]()
    for alternative in (
        *alternatives_of(frames.specified, reversed_too=mostly_increases),
        *other_converters(frames.specified, reversed_too=mostly_increases),
    ):
        # Readings that the scene's circuit cannot give may be wrong ones, which some circuit gives
        # with a number that is to be estimated.
        if specified is None and alternative.number:
            continue
        least = np.inf
        for tried in alternative.with_tried_numbers:
            if broken_law(without_series(tried), frames):
                continue
            lawful = tried.ohm == 0 or not broken_law(tried, frames)
            fits = alternative_fits(tried, frames, specified=specified) if lawful else ()
            explanation = Explanation.by(fits, tried, frames, specified=specified)
            if explanation is None:
                failed.append((tried, fits))
                continue
            explanations.append(explanation)
            if explanation.linear_evidence > least + FAR:
                break
            least = min(least, explanation.linear_evidence)
    # A search for a resistance in series costs several fits: last, so that it ends where it cannot
    # reach the best ones.
    for alternative, fits in failed:
        # The last of MAX_CANDIDATES explanations is to be beaten.
        costs = sorted(explanation.linear_evidence for explanation in explanations)
        to_beat = min(limit, *costs[MAX_CANDIDATES - 1 : MAX_CANDIDATES], np.inf)
        found = some_in_series(alternative, frames, to_beat, fits=fits, specified=specified)
        explanations += [found] if found else []
    if specified is None:
        down = rounded_down(frames.specified)
        further = (
            some_in_series(frames.specified, frames),
            None if down is None else Explanation.of(down, frames),
        )
        explanations += [found for found in further if found]
    return explanations


def _without_twins(candidates: Sequence[Explanation]) -> list[Explanation]:
    """Return the explanations without those that are another one with other names of lines.

    Readings in another order are so to circuits in which rows and columns change places. Of the
    two, `_best_candidate` prefers the one that keeps the file's order.
    """
    kept = [
        candidate.linear_evidence for candidate in candidates if candidate.alternative.order is None
    ]
    return [
        candidate
        for candidate in candidates
        if candidate.alternative.order is None
        or not np.isclose(candidate.linear_evidence, kept, rtol=0.0, atol=SAME_COST).any()
    ]


def _best_candidate(
    candidates: Sequence[Explanation],
    frames: ComparedFrames,
    evidence: Callable[[Explanation], float],
    *,
    at_fault: bool,
) -> Explanation | None:
    """Return the candidate with the largest evidence, less the costs of its parameters.

    Candidates do not count whose inequalities the readings break, or that do not differ from the
    scene's circuit. Where the scene's circuit is at fault, most cells have to stand still, the best
    candidate has to say more than that each reading has its cell (`_says_no_more`), and loads
    have to lower some resistance.

    Parameters
    ----------
    candidates : sequence of Explanation
    frames : ComparedFrames
    evidence : callable
        Returns −2 ln evidence of a candidate.
    at_fault : bool
        Whether the scene's circuit does not explain the readings.
    """
    specified_memory = frames.specified.scene.converter_memory
    valid = []
    for candidate in candidates:
        shown = not at_fault or candidate.pair is None or mostly_still(candidate.pair.moved)
        if shown and candidate.alternative.name and not broken_law(candidate.alternative, frames):
            valid.append(candidate)

    reversible = any(
        getattr(candidate.alternative.scene.readout, "code_sign", 1.0) < 0 for candidate in valid
    )

    def cost(candidate: Explanation) -> float:
        # Among alternatives each number that is estimated is one more parameter.
        alternative = candidate.alternative
        has_series = alternative.in_series is not None
        has_memory = alternative.scene.converter_memory != specified_memory
        parameters = has_series + has_memory + bool(alternative.number)
        rises = RISING_COST * (reversible and _only_rises(candidate))
        return evidence(candidate) + PARAMETER_COST * parameters + rises

    # of circuits that differ in the names of lines alone, the one that keeps the file's order
    least = min(map(cost, valid), default=0.0)
    tied = [candidate for candidate in valid if cost(candidate) <= least + SAME_COST]
    best = min(
        tied,
        key=lambda tie: (tie.alternative.order is not None, round(cost(tie), COST_DIGITS)),
        default=None,
    )
    if best is None or not at_fault:
        return best
    apart = [cost(candidate) for candidate in valid if _reads_cells_apart(candidate)]
    gain = min(apart, default=np.inf) - cost(best)
    if _only_rises(best) or (gain < MIN_EVIDENCE_GAIN and _says_no_more(best)):
        return None
    return best


def _reads_cells_apart(candidate: Explanation) -> bool:
    """Return whether each line has an amplifier, so that any readings have cells."""
    readout = candidate.alternative.scene.readout
    return readout is not None and nominal_terminations(readout).amplified


def _says_no_more(candidate: Explanation) -> bool:
    """Return whether moved cells fill whole lines, as those of a wrong circuit do.

    A press moves all readings of its lines, and a circuit without these couplings takes each for a
    cell that moved. Without a loaded frame nothing is known of the couplings.
    """
    if candidate.pair is None:
        return _reads_cells_apart(candidate)
    moved = candidate.pair.moved
    columns = moved.mean(axis=0) > MIN_FILLED
    rows = moved.mean(axis=1) > MIN_FILLED
    in_filled = moved & (columns | rows[:, None])
    return bool(in_filled.sum() > MIN_IN_FILLED * moved.sum())


def _only_rises(candidate: Explanation) -> bool:
    """Return whether moved cells have larger resistances under load, but for small couplings."""
    if candidate.pair is None or candidate.pair.moved.sum() < MIN_RISEN:
        return False
    return rises_only(candidate.pair.change[candidate.pair.moved.ravel()])


def rises_only(change: Array) -> bool:
    """Return whether log resistances only rise: the largest fall is a share of the largest rise."""
    return bool(-change.min(initial=0.0) < MAX_COUPLED * change.max(initial=0.0))


def _compared(
    specified: Explanation | None, best: Explanation, frames: ComparedFrames
) -> BetterExplanation:
    """Return the best candidate as better, as nearly as good, or as neither.

    A better one has evidence in other frames, too, where there are loaded ones.
    """
    if specified is None or best.pair is None:
        return BetterExplanation(
            best.alternative.name, evidence=best.evidence, addition=best.alternative.addition
        )
    if specified.pair is None:
        return BetterExplanation()
    # Both numbers of the scene's circuit need cells that touch no moved ones.
    other_circuit = _is_other_circuit(specified, best)
    gain = (specified.linear_evidence - best.linear_evidence) / best.pair.excess
    if _may_decide(specified, best, best.pair.excess):
        gain = _gain(specified, best)
    if not (gain > DOUBTFUL_GAIN and best.pair.has_load):
        return BetterExplanation(alone=gain <= (0.0 if other_circuit else PARAMETER_COST))
    name = best.alternative.name
    factors = cell_factors(specified.pair, best.pair)
    apart = other_circuit or specified.pair.gain_apart(best.pair) > DOUBTFUL_GAIN
    if not gain > MIN_EVIDENCE_GAIN or not apart or not _confirmed(specified, best, frames):
        moves_cells = abs(np.log(np.median(factors))) > DOUBTFUL_SHIFT
        doubtful = other_circuit or (moves_cells and not _remembers(specified, best))
        nearly = name if doubtful else ""
        return BetterExplanation("", frames.loaded, factors=factors, nearly=nearly, alone=False)
    return BetterExplanation(
        name, frames.loaded, best.evidence, factors, addition=best.alternative.addition
    )


def _is_other_circuit(specified: Explanation, candidate: Explanation) -> bool:
    """Return whether a candidate is another circuit, and not the scene's with other numbers."""
    return bool(candidate.alternative.kind) and not _remembers(specified, candidate)


def _remembers(specified: Explanation, candidate: Explanation) -> bool:
    """Return whether a candidate's converter has another memory than the scene's."""
    memories = (each.alternative.scene.converter_memory for each in (specified, candidate))
    return len(set(memories)) > 1


def _may_decide(specified: Explanation, candidate: Explanation, excess: float) -> bool:
    """Return whether a candidate's gain by linear theory, over the excess, may decide.

    A candidate is a doubt from DOUBTFUL_GAIN on. A memory follows the edge of a load: alone, it is
    none below MIN_EVIDENCE_GAIN.
    """
    least = MIN_EVIDENCE_GAIN if _remembers(specified, candidate) else DOUBTFUL_GAIN
    return specified.linear_evidence - candidate.linear_evidence > excess * least


def _gain(specified: Explanation, best: Explanation) -> float:
    """Return the decrease of −2 ln evidence by another explanation of the same frames.

    The decrease is relative to the misfit of still cells, which errors that the scene does not name
    increase. No field describes every load: where single cells alone are likelier under the scene's
    circuit, their evidence counts against the gain.
    """
    assert best.pair is not None
    by_cells = min(specified.score - best.score, 0.0)
    gain = specified.evidence - best.evidence + by_cells
    return (gain - PARAMETER_COST * bool(best.alternative.number)) / best.pair.excess


def _confirmed(specified: Explanation, best: Explanation, frames: ComparedFrames) -> bool:
    """Return whether frames that were not compared have evidence for the best candidate, too.

    The result is True where there are none, or no load on them.
    """
    others = frames.others
    if others is None:
        return True
    found = [
        Explanation.of(explanation.alternative, others, explanation)
        for explanation in (specified, best)
    ]
    first, second = (None if each is None else each.final for each in found)
    if first is not None and first.pair is not None and not first.pair.has_load:
        return True
    if second is None or second.pair is None:
        return False
    return first is None or _gain(first, second) > MIN_EVIDENCE_GAIN
