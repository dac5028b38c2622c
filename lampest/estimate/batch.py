"""Frames of many streams at once: what a batch can solve goes into one, and every other stream solves by itself."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import OptimalMethod
from lampest.estimate.state import NO_DUAL, Step
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.posterior.linear import LinearModel
from lampest.recording.readings import Readings
from lampest.solvers.batch import Ended, Kept, solve
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.multistart import BROKEN, SAME, several_minima
from lampest.solvers.panel_batch import PanelBatch
from lampest.solvers.solution import OPEN_FRACTION, VERIFIED, Settings, Solution, Status

FEWEST = 20  # panels of a thread: with fewer, threads cost more than they save
Pushed = tuple[Stream | None, Step | None]
W = TypeVar("W")


def pushed_together(streams: Sequence[Stream | None], readings: Readings, kept: Kept) -> list[Pushed]:
    """Every stream after its frame, and how that was solved; None stays None.

    readings : (streams, rows, columns), of each one's frame. kept : what solves of earlier frames left, of every stream
    by its number; renewed in place.
    """
    pushed: list[Pushed] = [(None, None)] * len(streams)
    for together, found in _at_once(lambda block: block.pushed(kept), _batches(streams, readings)):
        for number, one in zip(together.numbers.tolist(), found, strict=True):
            pushed[number] = one
    for number, stream in enumerate(streams):
        if stream is not None and pushed[number][1] is None:
            pushed[number] = stream.push(readings[number])
    return pushed


def rested_together(streams: Sequence[Stream | None]) -> list[Stream | None]:
    """Every stream with its baseline; None stays None."""
    there = [stream for stream in streams if stream is not None]
    kept = Kept.nothing(len(streams), there[0].resting.value.size)
    steps: list[Step | None] = [None] * len(streams)
    resting = [there[0].resting if stream is None else stream.resting for stream in streams]
    for together, found in _at_once(
        lambda block: block.steps(kept), _batches(streams, resting[0].together(*resting[1:]))
    ):
        for number, one in zip(together.numbers.tolist(), found, strict=True):
            steps[number] = one
    return [stream and stream.with_rest(step) for stream, step in zip(streams, steps, strict=True)]


def _batches(streams: Sequence[Stream | None], readings: Readings) -> "Iterator[Together]":
    """Streams that can be solved together, those of one kind of cost and one history in one batch."""
    groups: dict[tuple[object, ...], dict[int, Stream]] = {}
    partial = ((readings.side != 0) | (readings.seen < 1)).any(axis=(1, 2)).tolist()
    for number, stream in enumerate(streams):
        if stream is not None and _in_batches(stream, readings, number, partial[number]):
            estimator = _unweighted(stream.estimator, stream.rested)
            kind = id(estimator), stream.scene.faults, stream.first, stream.rested, partial[number]
            groups.setdefault(kind, {})[number] = stream
    for group in groups.values():
        blocks = max(1, min(len(os.sched_getaffinity(0)), len(group) // FEWEST))
        for place, numbers in enumerate(np.array_split(list(group), blocks)):
            with suppress(*BROKEN), np.errstate(all="ignore"):
                found = Together.of(numbers, [group[number] for number in numbers.tolist()], readings[numbers], place)
                if found is not None:
                    yield found


def _at_once(
    work: "Callable[[Together], list[W]]", blocks: "Iterable[Together]"
) -> "Iterator[tuple[Together, list[W]]]":
    """(block, what was found of each of its streams), blocks in threads beside each other; nothing where one fails."""

    def safely(block: Together) -> list[W]:
        with np.errstate(all="ignore"), suppress(*BROKEN):
            return work(block)
        return []

    known = list(blocks)
    if len(known) < 2:
        found = [safely(block) for block in known]
    else:
        with ThreadPoolExecutor(len(known)) as pool:
            found = list(pool.map(safely, known))
    yield from ((block, one) for block, one in zip(known, found, strict=True) if one)


def _in_batches(stream: Stream, readings: Readings, number: int, partial: bool) -> bool:
    """Whether a batch may minimise a stream's frame, or the baseline that it lacks: weights are numbers."""
    estimator, method = stream.estimator, stream.estimator.method
    if not isinstance(method, OptimalMethod) or method.kind not in ("reduced", "auto") or estimator.weighs_previous:
        return False
    if not isinstance(stream.scene.circuit, TwoPointReadout) or stream.scene.wiring is not None:
        return False
    if estimator.solver.time_limit_s is not None or estimator.solver.starts is not None:
        return False
    if partial and (stream.track is not None or not bool(readings[number].enough(stream.scene))):
        return False
    if not stream.rested:
        alone = stream.baseline is None and not estimator.joint_start
        return alone and all(term.weight != "auto" for term in estimator.absolute_terms)
    if not estimator.automatic:
        return True
    return not (stream.weights is None or estimator.auto_weight.per == "frame" or stream.due(readings[number]))


@lru_cache(maxsize=256)
def _unweighted(estimator: Estimator, rested: bool) -> Estimator:
    """With weights of one; before the baseline, the terms that it has. The same object for equal ones."""
    terms = estimator.terms if rested else estimator.absolute_terms
    unit = replace(estimator, terms=tuple(replace(term, weight=1.0) for term in terms))
    return unit if unit == estimator else _unweighted(unit, True)


@dataclass(frozen=True, eq=False)
class Together:
    """numbers : of the streams among all, which are of one shape and one kind of cost. batch : their frames."""

    numbers: NDArray[np.intp]
    streams: Sequence[Stream]
    batch: PanelBatch
    settings: Settings

    @classmethod
    def of(
        cls, numbers: NDArray[np.intp], streams: Sequence[Stream], frames: Readings, place: int
    ) -> "Together | None":
        """frames : (streams, rows, columns). place : as `PanelBatch`. None where batches cannot serve the cost."""
        first = streams[0]
        estimator = _unweighted(first.estimator, first.rested)
        behind = Background(first.scene, first.period)
        if estimator.relative:
            resting = np.stack([stream.baseline_resistance for stream in streams])
            known = (stream.previous for stream in streams)
            before = [base if one is None else one for one, base in zip(known, resting, strict=True)]
            behind = replace(behind, previous=np.stack(before), baseline=resting)
        data = estimator.data(frames, behind)
        cost = estimator.cost(first.scene, 1, data.partial)
        if not PanelBatch.serves(cost, data):
            return None
        weights = np.array([_weights(stream) for stream in streams], dtype=float)
        return cls(numbers, streams, PanelBatch(cost, weights, data, place), estimator.solver)

    def pushed(self, kept: Kept) -> list[Pushed]:
        """Every stream after its frame; (None, None) where the batch found no verified minimum."""
        return [self._after(number, step) for number, step in enumerate(self.steps(kept))]

    def steps(self, kept: Kept) -> list[Step | None]:
        """How every frame was solved, without error bars; None as above."""
        begin, found = perf_counter(), list[Ended]()
        for start in self._starts(kept, found):
            found.append(solve(self.batch, start, kept, self.numbers, self.settings))
        solutions = self._solutions(reduce(_lower, found), len(found))
        seconds = (perf_counter() - begin) / len(self.numbers)
        pairs = zip(solutions, self.batch.weights.tolist(), strict=True)
        return [None if found is None else Step(found, seconds, tuple(weights)) for found, weights in pairs]

    def _starts(self, kept: Kept, found: Sequence[Ended]) -> Iterator[Array]:
        """As `lampest.solvers.multistart.starts`: one of a frame that follows another, else up to three.

        found : where those before ended.
        """
        cost, uniform = self.batch.cost, self.batch.data.uniform_start
        rested = self.streams[0].rested
        if rested:
            pairs = ((stream.previous, stream.baseline_resistance) for stream in self.streams)
            yield np.stack([resting if previous is None else previous for previous, resting in pairs])
        if rested and not (self.streams[0].first and several_minima(cost, self.batch.data)):
            return
        yield uniform
        if several_minima(cost, self.batch.data):
            reads = [float(term.reads_measurement) for term in cost.terms]
            data_alone = replace(self.batch, weights=self.batch.weights * reads)
            near = found[0].points.network.cell_resistance
            yield solve(data_alone, near, kept, self.numbers, self.settings).points.network.cell_resistance

    def _solutions(self, ended: Ended, starts: int) -> list[Solution | None]:
        """The checked solutions of all panels; None where one is not verified."""
        points, data = ended.points, self.batch.data
        cells, reading = points.network.cell_resistance, points.reading
        at_lower, open_cell = cells <= data.lower / OPEN_FRACTION, cells >= data.upper * OPEN_FRACTION
        verified = ended.solved & (points.residual <= VERIFIED)
        lower, upper = self.batch.log_bounds
        held = np.asarray((~points.free & (lower < upper)).any(axis=1))
        found: list[Solution | None] = [None] * len(cells)
        objective, residual, iterations = (
            values.tolist() for values in (points.objective, points.residual, ended.iterations)
        )
        costs = points.costs
        for number in np.flatnonzero(verified).tolist():
            one = slice(number, number + 1)
            solution = Solution(
                cells[one],
                reading[one],
                costs[number],
                objective[number],
                residual[number],
                at_lower[one],
                open_cell[one],
                Status.OPTIMUM,
                iterations[number],
                starts=starts,
            )
            if held[number] or self.streams[number].track is not None:
                at = self._evaluation(ended, number)
                gradient = points.gradient[number].reshape(cells[one].shape)
                status = Status.HELD if held[number] and bounds_matter(at, gradient, NO_DUAL) else Status.OPTIMUM
                solution = replace(solution, at=at, dual=NO_DUAL, status=status)
            found[number] = solution
        return found

    def _evaluation(self, ended: Ended, number: int) -> Evaluation:
        """Of one panel, with the network that was solved."""
        one = ended.points.some(np.array([number]))
        network = one.network
        alone = replace(
            network,
            cell_resistance=network.cell_resistance[0],
            conductance=network.conductance[0],
            _impedance=network._impedance[0],
        )
        pairs = zip(self.batch.cost.terms, self.batch.weights[number], strict=True)
        terms = tuple(replace(term, weight=float(weight)) for term, weight in pairs)
        cost = replace(self.batch.cost, terms=terms)
        return Evaluation(cost, one.batch.data, network.cell_resistance, ended.points.reading[number][None], (alone,))

    def _after(self, number: int, step: Step | None) -> Pushed:
        """A stream after its frame, with error bars where it has them."""
        if step is None:
            return None, None
        stream, solution, deviation = self.streams[number], step.solution, None
        track = stream.track
        if track is not None and solution.at is not None:
            begin = perf_counter()
            with suppress(*BROKEN):
                track, bars = track.advanced(LinearModel(solution.at, NO_DUAL))
                step, deviation = replace(step, bars=bars, bars_seconds=perf_counter() - begin), track.deviation
        found = solution.cell_resistance[0]
        after = replace(stream, previous=found, previous_deviation=deviation, track=track, first=False)
        return after, step if solution.at is None else step.bare()


def _weights(stream: Stream) -> tuple[float, ...]:
    """Of the terms that a batch minimises."""
    estimator = stream.estimator
    if stream.rested and estimator.automatic and stream.weights is not None:
        return stream.weights
    return tuple(float(term.weight) for term in (estimator.terms if stream.rested else estimator.absolute_terms))


def _lower(one: Ended, other: Ended) -> Ended:
    """Of each panel the lower minimum of two; the first where they are one."""
    better = other.solved & (~one.solved | (other.points.objective < one.points.objective * (1 - SAME)))
    return one.where(~better, other)
