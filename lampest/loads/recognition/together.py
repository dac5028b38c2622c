"""Several loads found together: kinds exchanged one by one from the most flexible ones, and their twins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.recognition.candidates import Several
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.verdict import prior_cost
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

CLEARLY = 3.0  # ln of a likelihood ratio by which another kind must be better to stand in for the most flexible one


@dataclass(frozen=True, eq=False)
class Together:
    """loads : the kinds. fit : of a candidate from φ, given up where its score stays above a third argument."""

    panel: Panel
    loads: tuple[Candidate, ...]
    fit: Callable[[Candidate, Array, float], Fit]

    def about(self, ways: Sequence[Sequence[Disc]]) -> tuple[Fit, ...]:
        """The best kinds of loads about the best of some sets of discs, all fitted together, targets first.

        And, where these are others, the most flexible kinds: so coarse a comparison may be wrong.
        """
        flexible = next((load for load in self.loads if load.target), self.loads[0])
        others = [load for load in self.loads if load is not flexible]
        parts, score = [flexible] * len(ways[0]), np.inf
        for number, way in enumerate(ways):
            fit = self._fit(parts, [flexible.start(disc) for disc in way], score)
            if fit.score < score:
                best, discs, score = fit, ways[number], fit.score
        first = best
        for place in range(len(discs)):
            for load in others:
                own = split(best)
                kinds, begin = list(several_of(best).parts), [*own]
                alike = load.like(kinds[place], own[place])
                kinds[place], begin[place] = load, load.start(discs[place]) if alike is None else alike
                other = self._fit(kinds, begin, best.score)
                if self._likely(other) > self._likely(best) + CLEARLY:
                    best = other
        return (targets_first(best), first) if best is not first else (first,)

    def _likely(self, fit: Fit) -> float:
        return fit.evidence - prior_cost(self.panel, fit)

    def _fit(self, parts: Sequence[Candidate], begin: Sequence[Array], least: float) -> Fit:
        return self.fit(Several.of(tuple(parts)), np.concatenate(begin), least)


def twins(fit: Fit, loads: Sequence[Candidate]) -> list[Fit]:
    """Starts for the same loads, of which those that suck are all of another kind; none for a single load."""
    if not isinstance(fit.candidate, Several):
        return []
    found = []
    for load in loads:
        kinds, begin = list(fit.candidate.parts), split(fit)
        for number, (part, numbers) in enumerate(zip(kinds, begin, strict=True)):
            alike = load.like(part, numbers)
            if part.sucks and part is not load and alike is not None:
                kinds[number], begin[number] = load, alike
        if tuple(kinds) != fit.candidate.parts:
            twin = replace(fit, candidate=Several.of(tuple(kinds)), parameters=np.concatenate(begin))
            found.append(targets_first(twin))
    return found


def targets_first(fit: Fit) -> Fit:
    """The fit with its parts in the order in which they are reported."""
    parts, own = several_of(fit).parts, split(fit)
    order = sorted(range(len(parts)), key=lambda number: not parts[number].target)
    several = Several.of(tuple(parts[number] for number in order))
    return replace(fit, candidate=several, parameters=np.concatenate([own[number] for number in order]))


def several_of(fit: Fit) -> Several:
    """The candidate of a fit of several loads."""
    assert isinstance(fit.candidate, Several)
    return fit.candidate


def split(fit: Fit) -> list[Array]:
    """φ of every part."""
    return several_of(fit).split(fit.parameters)


def discs_of(fit: Fit) -> list[Disc]:
    """The discs of all its loads that are like one."""
    discs = [part.disc(own) for part, own in zip(several_of(fit).parts, split(fit), strict=True)]
    return [disc for disc in discs if disc is not None]
