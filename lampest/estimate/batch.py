"""Frames of many streams at once: in batches over a leading axis where possible, all others one by one."""

import os
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from multiprocessing import parent_process
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.method import OptimalMethod
from lampest.estimate.objective import Objective
from lampest.estimate.state import NO_DUAL, Step
from lampest.estimate.stream import Stream
from lampest.estimate.weights import converter_and_faults, strongest, with_chosen_weights
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.recording.readings import Readings
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.multistart import BROKEN, SAME_MINIMUM, several_minima
from lampest.solvers.projected_lbfgs import BatchOutcome, InverseHessians, serves, solve
from lampest.solvers.solution import VERIFIED, Outcome, Solution, Status, solution_at

MIN_PANELS_PER_THREAD = 20  # with fewer panels in a thread, threads cost more than they save
MAX_BLOCK_FRAMES = 40  # frames that are solved together: 50 MB of inverse Hessians at 20 × 20
MAX_BLOCK_CELLS = 400  # of a network: with more, inverse Hessians cost more than they save (docs/studies/speed.md)
W = TypeVar("W")


def push_streams(
    streams: Sequence[Stream | None], readings: Readings, inverses: InverseHessians
) -> list[tuple[Stream | None, Step | None]]:
    """Return every stream after its frame, and the frame's step; None stays None.

    Parameters
    ----------
    streams : sequence of Stream or None
    readings : Readings
        One frame of each stream, (streams, rows, columns).
    inverses : InverseHessians
        Inverse Hessians of the streams by number, from solves of earlier frames; they are updated in place.
    """
    # Weights first; then batches; whatever a batch does not solve is pushed alone.
    streams = _weighed(streams, readings)
    solved = _solved_together(streams, readings, inverses, StreamBatch.push)
    alone = {n: stream.push(readings[n]) for n, stream in enumerate(streams) if stream is not None and n not in solved}
    return [(solved | alone).get(number, (None, None)) for number in range(len(streams))]


def _weighed(streams: Sequence[Stream | None], readings: Readings) -> list[Stream | None]:
    """Return the streams with weights; streams of one group choose them together.

    A group has one estimator, converter and faults. If the frame of any of its streams is due to choose weights, the
    streams with the largest change from rest choose them for all.
    """
    weighed, groups = list(streams), dict[Hashable, dict[int, Stream]]()
    for number, stream in enumerate(streams):
        if stream is None or not stream.chooses_weights or not (stream.rested or not stream.estimator.relative):
            continue
        if readings[number].enough(stream.scene):
            kind = id(stream.estimator), stream.rested, converter_and_faults(stream.scene)
            groups.setdefault(kind, {})[number] = stream
    for group in groups.values():
        if any(stream.choosing(readings[number]) for number, stream in group.items()):
            changes = [stream.change(readings[number]) for number, stream in group.items()]
            numbers = [list(group)[place] for place in strongest(changes)]
            stream, pairs = group[numbers[0]], [group[number].given(readings[number]) for number in numbers]
            first, further = pairs[0][0].limited(stream.estimator.solver.time_limit_s), [data for data, _ in pairs[1:]]
            objective = with_chosen_weights(stream.estimator, stream.scene, first, pairs[0][1], further)
            weights = tuple(float(term.weight) for term in objective.terms)
            for number, stream in group.items():
                sigma = objective.weight_sigma
                weighed[number] = replace(stream, weights=weights, weight_sigma=sigma, weighed_at=max(changes))
    return weighed


def push_block(stream: Stream, readings: Readings) -> Iterator[tuple[Stream, Step]]:
    """Generate the stream after each of its next frames, with the frame's step.

    Up to MAX_BLOCK_FRAMES frames that are independent of each other are solved over a leading axis, all from the last
    estimate on. Frames that the batch does not solve are pushed alone. Where no block is possible, a single frame is
    pushed.

    Parameters
    ----------
    stream : Stream
    readings : Readings
        The next frames, (frames, rows, columns).
    """
    size, count, solved = readings.value[0].size, 1, dict[int, tuple[Stream, Step]]()
    if size <= MAX_BLOCK_CELLS and not stream.first and stream.is_independent:
        count = min(len(readings.value), MAX_BLOCK_FRAMES)
    if count > 1:
        inverses = InverseHessians.nothing(count, size)
        solved = _solved_together([stream] * count, readings[:count], inverses, StreamBatch.push)
    for number in range(count):
        stream, step = solved.get(number) or stream.push(readings[number])
        yield stream, step


def solve_baselines(streams: Sequence[Stream | None]) -> list[Stream | None]:
    """Return every stream with its baseline, solved in batches where possible; None stays None."""
    first = next(stream for stream in streams if stream is not None)
    resting = [first.resting if stream is None else stream.resting for stream in streams]
    inverses = InverseHessians.nothing(len(streams), first.resting.value.size)
    together = resting[0].together(*resting[1:])
    weighed = _weighed([stream and replace(stream, weights=None) for stream in streams], together)
    solved = _solved_together(weighed, together, inverses, StreamBatch.steps)
    return [stream and stream.with_rest(solved.get(number)) for number, stream in enumerate(streams)]


def _solved_together(
    streams: Sequence[Stream | None],
    readings: Readings,
    inverses: InverseHessians,
    solve: Callable[["StreamBatch", InverseHessians], Sequence[W | None]],
) -> dict[int, W]:
    """Return the results of `solve` by number, of the streams that batches can solve; batches run in threads."""

    def solved(block: StreamBatch) -> dict[int, W]:
        with np.errstate(all="ignore"), suppress(*BROKEN):
            pairs = zip(block.numbers.tolist(), solve(block, inverses), strict=True)
            return {number: solution for number, solution in pairs if solution is not None}
        return {}

    blocks = list(_batches(streams, readings))
    if len(blocks) < 2:
        return solved(blocks[0]) if blocks else {}
    with ThreadPoolExecutor(len(blocks)) as pool:
        return {number: solution for part in pool.map(solved, blocks) for number, solution in part.items()}


def _batches(streams: Sequence[Stream | None], readings: Readings) -> "Iterator[StreamBatch]":
    """Generate batches of the streams that can be solved together, those with the same cost and the same state."""
    groups: dict[tuple[object, ...], dict[int, Stream]] = {}
    cores = 1 if parent_process() else len(os.sched_getaffinity(0))  # of several processes each has one
    partial = ((readings.side != 0) | (readings.seen < 1)).any(axis=(1, 2)).tolist()
    for number, stream in enumerate(streams):
        if stream is not None and _in_batches(stream, readings, number, partial=partial[number]):
            estimator = _unweighted(stream.estimator, rested=stream.rested)
            kind = id(estimator), stream.scene.faults, stream.first, stream.rested, partial[number]
            groups.setdefault(kind, {})[number] = stream
    for group in groups.values():
        # Frames of one stream stay in one thread, however many cores there are.
        distinct = len(set(map(id, group.values())))
        blocks = max(1, min(cores, distinct // MIN_PANELS_PER_THREAD))
        for place, numbers in enumerate(np.array_split(list(group), blocks)):
            with suppress(*BROKEN), np.errstate(all="ignore"):
                together = StreamBatch.of(
                    numbers, [group[number] for number in numbers.tolist()], readings[numbers], place
                )
                if together is not None:
                    yield together


def _in_batches(stream: Stream, readings: Readings, number: int, *, partial: bool) -> bool:
    """Return whether a batch can solve a stream's frame, or its missing baseline.

    A batch has the reduced formulation, unwired two-point readouts, the solver's default limits and known weights.
    """
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
        weighed = stream.weights is not None or all(term.weight != "auto" for term in estimator.absolute_terms)
        return weighed and stream.baseline is None and not estimator.joint_start
    return not estimator.automatic or estimator.auto_weight.per == "recording"


@lru_cache(maxsize=256)
def _unweighted(estimator: Estimator, *, rested: bool) -> Estimator:
    """Return the estimator with all weights 1, before the baseline with its absolute terms only.

    Equal estimators share one object, so that streams can be grouped by identity.
    """
    terms = estimator.terms if rested else estimator.absolute_terms
    unit = replace(estimator, terms=tuple(replace(term, weight=1.0) for term in terms))
    return unit if unit == estimator else _unweighted(unit, rested=True)


@dataclass(frozen=True, eq=False)
class StreamBatch:
    """Streams whose frames are solved together.

    Attributes
    ----------
    numbers : array
        Numbers of the streams among all.
    streams : sequence of Stream
        Streams of one shape and one kind of cost.
    frames : Readings
        One frame of each stream, (streams, rows, columns).
    cost : Cost
        The common cost, with all weights 1.
    data : Data
        Data of the streams' frames, over a leading axis.
    weighted : sequence of Objective
        The objective of each stream's frame, or of its missing baseline, with known weights.
    """

    numbers: NDArray[np.intp]
    streams: Sequence[Stream]
    frames: Readings
    cost: Cost
    data: Data
    weighted: Sequence[Objective]

    @classmethod
    def of(
        cls, numbers: NDArray[np.intp], streams: Sequence[Stream], frames: Readings, place: int
    ) -> "StreamBatch | None":
        """Return the batch of some streams; None where batches do not support the cost.

        Parameters
        ----------
        numbers : integer array, shape (streams,)
        streams : sequence of Stream
        frames : Readings
            One frame of each stream, (streams, rows, columns).
        place : int
            Number of the batch, as in `Data`.
        """
        first = streams[0]
        estimator = _unweighted(first.estimator, rested=first.rested)
        behind = Background(first.scene, first.period)
        if estimator.relative:
            resting = np.stack([stream.baseline_resistance for stream in streams])
            behind = replace(behind, previous=_previous(streams), baseline=resting)
        data = estimator.data(frames, behind)
        cost = estimator.cost(first.scene, 1, partial=data.partial)
        if not serves(cost, data):
            return None
        weighted: list[Objective] = [stream.weighted for stream in streams]
        if not first.rested:
            weighted = [objective.with_terms(objective.absolute_terms) for objective in weighted]
        return cls(numbers, streams, frames, cost, data.of_panels(place), weighted)

    def push(self, inverses: InverseHessians) -> list[tuple[Stream, Step] | None]:
        """Return every stream after its frame, and the frame's step; None where no minimum was verified."""
        pairs = enumerate(zip(self.streams, self.steps(inverses), strict=True))
        return [
            None if step is None else stream.estimator.method.after(stream, step, self.frames[number])
            for number, (stream, step) in pairs
        ]

    def steps(self, inverses: InverseHessians) -> list[Step | None]:
        """Return the step of every panel at the lowest minimum over its starts; None where none is verified."""
        begin, minima = perf_counter(), list[BatchOutcome]()
        for start in self._starts(inverses, minima):
            minima.append(solve(self._at(start, self._weights), inverses, self.numbers, self.weighted[0].solver))
        solutions = self._solutions(reduce(_lower, minima), len(minima))
        seconds = (perf_counter() - begin) / len(self.numbers)
        return [
            None if solution is None else Step(solution, seconds, tuple(weights), weight_sigma=objective.weight_sigma)
            for solution, weights, objective in zip(solutions, self._weights.tolist(), self.weighted, strict=True)
        ]

    @cached_property
    def _weights(self) -> Array:
        """Weights of the terms, (streams, terms)."""
        return np.array([[float(term.weight) for term in objective.terms] for objective in self.weighted])

    def _starts(self, inverses: InverseHessians, minima: Sequence[BatchOutcome]) -> Iterator[Array]:
        """Generate starts as `lampest.solvers.multistart.starts`; `minima` are the outcomes of those before."""
        several = several_minima(self.cost, self.data)
        if self.streams[0].rested:
            yield _previous(self.streams)[:, None]
            if not (self.streams[0].first and several):
                return
        yield self.data.uniform_start
        if several:
            reads = [float(term.reads_measurement) for term in self.cost.terms]
            data_alone = self._at(minima[0].points.at.cell_resistance, self._weights * reads)
            yield solve(data_alone, inverses, self.numbers, self.weighted[0].solver).points.at.cell_resistance

    def _at(self, cells: Array, weights: Array) -> Evaluation:
        """Return the costs at cells (streams, 1, rows, columns) ohm, within their bounds."""
        return Evaluation.at(self.cost, self.data, np.clip(cells, self.data.lower, self.data.upper), weights)

    def _solutions(self, ended: BatchOutcome, starts: int) -> list[Solution | None]:
        """Return the checked solutions of all panels, None where one is not verified; a stream's solver cache stays."""
        points, data = ended.points, self.data
        # a panel is `held` if bounds that matter keep a cell
        held = np.asarray((~points.free & (data.lower < data.upper).reshape(points.free.shape)).any(axis=1))
        solutions: list[Solution | None] = [None] * len(self.numbers)
        for number in np.flatnonzero(ended.solved & (points.residual <= VERIFIED)).tolist():
            at, kept = points.at.some(number), self.streams[number].prepared
            gradient = points.gradient[number].reshape(at.cell_resistance.shape)
            status = Status.HELD if held[number] and bounds_matter(at, gradient, NO_DUAL) else Status.OPTIMUM
            iterations = int(ended.iterations[number])
            outcome = Outcome(at.cell_resistance, NO_DUAL, status, iterations, preconditioner=kept)
            solutions[number] = replace(solution_at(at, float(points.residual[number]), outcome, status), starts=starts)
        return solutions


def _previous(streams: Sequence[Stream]) -> Array:
    """Return the last estimates of the streams, or their baselines, (streams, rows, columns) ohm."""
    pairs = ((stream.previous, stream.baseline_resistance) for stream in streams)
    return np.stack([resting if previous is None else previous for previous, resting in pairs])


def _lower(first: BatchOutcome, second: BatchOutcome) -> BatchOutcome:
    """Return the lower minimum of each panel; the first where both are equal."""
    better = second.solved & (
        ~first.solved | (second.points.at.objectives < first.points.at.objectives * (1 - SAME_MINIMUM))
    )
    return first.where(~better, second)
