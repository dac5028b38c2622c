"""Frames of many streams at once: what a batch can solve goes into one, and every other stream solves by itself."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import OptimalMethod
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.posterior.linear import LinearModel
from lampest.recording.readings import Readings
from lampest.solvers.batch import Ended, Kept, PanelBatch, solve
from lampest.solvers.bound_multipliers import bounds_matter
from lampest.solvers.multistart import BROKEN, SAME, convex, several_minima
from lampest.solvers.solution import OPEN_FRACTION, VERIFIED, Solution, Status

Pushed = tuple[Stream | None, Step | None]
NO_DUAL = np.zeros(0)


def pushed_together(streams: Sequence[Stream | None], readings: Sequence[Readings], kept: Kept) -> list[Pushed]:
    """Every stream after its frame, and how that was solved; None stays None.

    kept : what solves of earlier frames left, of every stream by its number; renewed in place.
    """
    pushed: list[Pushed] = [(None, None)] * len(streams)
    groups: dict[tuple[object, ...], list[int]] = {}
    for number, (stream, frame) in enumerate(zip(streams, readings, strict=True)):
        if stream is not None and (estimator := _in_batches(stream, frame)) is not None:
            terms = tuple(type(term) for term in estimator.terms)
            faults, first = stream.scene.faults, stream.first
            groups.setdefault((terms, estimator.solver, estimator.bounds, faults, first, frame.partial), []).append(
                number
            )
    for numbers in groups.values():
        some, frames = [streams[number] for number in numbers], [readings[number] for number in numbers]
        with suppress(*BROKEN), np.errstate(all="ignore"):
            together = Together.of([one for one in some if one is not None], frames)
            if together is not None:
                for number, one in zip(numbers, together.pushed(kept, np.array(numbers)), strict=True):
                    pushed[number] = one
    for number, (stream, frame) in enumerate(zip(streams, readings, strict=True)):
        if stream is not None and pushed[number][1] is None:
            pushed[number] = stream.push(frame)
    return pushed


def _in_batches(stream: Stream, frame: Readings) -> Estimator | None:
    """The estimator with numbers for weights where a batch may solve the frame; else None."""
    estimator, method = stream.estimator, stream.estimator.method
    if not isinstance(method, OptimalMethod) or method.kind not in ("reduced", "auto") or estimator.weighs_previous:
        return None
    if not isinstance(stream.scene.circuit, TwoPointReadout) or stream.scene.wiring is not None:
        return None
    if estimator.solver.time_limit_s is not None or estimator.solver.starts is not None or not stream.rested:
        return None
    if frame.partial and (stream.track is not None or not bool(frame.enough(stream.scene))):
        return None
    if estimator.automatic:
        if stream.weights is None or estimator.auto_weight.per == "frame" or stream.due(frame):
            return None
        return estimator.with_weights(stream.weights)
    return estimator


@dataclass(frozen=True, eq=False)
class Together:
    """streams : of one shape of panel and one kind of cost. batch : their frames."""

    streams: Sequence[Stream]
    batch: PanelBatch

    @classmethod
    def of(cls, streams: Sequence[Stream], frames: Sequence[Readings]) -> "Together | None":
        """None where batches cannot serve the cost."""
        first, (one, *others) = streams[0], frames
        estimator, readings = first.estimator, one.together(*others)
        behind = Background(first.scene, first.period)
        if estimator.relative:
            known = [stream.previous for stream in streams]
            resting = np.stack([stream.baseline_resistance for stream in streams])
            before = [base if one is None else one for one, base in zip(known, resting, strict=True)]
            behind = replace(behind, previous=np.stack(before), baseline=resting)
        data = estimator.data(readings, behind)
        cost = estimator.cost(first.scene, 1, data.partial)
        if not PanelBatch.serves(cost, data):
            return None
        weights = [
            [term.weight for term in stream.estimator.terms] if stream.weights is None else stream.weights
            for stream in streams
        ]
        return cls(streams, PanelBatch(cost.unweighted, np.array(weights, dtype=float), data))

    def pushed(self, kept: Kept, numbers: NDArray[np.intp]) -> list[Pushed]:
        """Every stream after its frame; (None, None) where the batch found no verified minimum."""
        begin = perf_counter()
        settings, ended, starts = self.streams[0].estimator.solver, None, self._starts()
        for start in starts:
            found = solve(self.batch, start, kept, numbers, settings)
            ended = found if ended is None else _lower(ended, found)
        assert ended is not None
        solutions = self._solutions(ended, len(starts))
        seconds = (perf_counter() - begin) / len(numbers)
        return [self._after(number, solution, seconds) for number, solution in enumerate(solutions)]

    def _starts(self) -> list[Array]:
        """As `lampest.solvers.multistart.starts`: one of a frame that follows another, else three."""
        previous = [stream.previous for stream in self.streams]
        near = [
            stream.baseline_resistance if one is None else one
            for stream, one in zip(self.streams, previous, strict=True)
        ]
        first = [np.stack(near)]
        if not self.streams[0].first or not several_minima(self.batch.cost, self.batch.data):
            return first
        return [*first, self.batch.data.uniform_start, convex(self.batch.data, None)]

    def _solutions(self, ended: Ended, starts: int) -> list[Solution | None]:
        """The checked solutions of all panels; None where one is not verified."""
        points, data = ended.points, self.batch.data
        cells, reading = points.network.cell_resistance, points.reading
        at_lower = np.asarray(cells <= data.lower / OPEN_FRACTION)
        open_cell = np.asarray(cells >= data.upper * OPEN_FRACTION)
        verified: NDArray[np.bool_] = ended.solved & (points.residual <= VERIFIED)
        lower, upper = self.batch.log_bounds
        held = np.asarray((~points.free & (lower < upper)).any(axis=1))
        found: list[Solution | None] = []
        for number in range(len(cells)):
            if not verified[number]:
                found.append(None)
                continue
            one = slice(number, number + 1)
            solution = Solution(
                cells[one],
                reading[one],
                points.costs[number],
                float(points.objective[number]),
                float(points.residual[number]),
                at_lower[one],
                open_cell[one],
                Status.OPTIMUM,
                int(ended.iterations[number]),
                starts=starts,
            )
            if held[number] or self.streams[number].track is not None:
                at = self._evaluation(ended, number)
                gradient = points.gradient[number].reshape(cells[one].shape)
                status = Status.HELD if held[number] and bounds_matter(at, gradient, NO_DUAL) else Status.OPTIMUM
                solution = replace(solution, at=at, dual=NO_DUAL, status=status)
            found.append(solution)
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

    def _after(self, number: int, solution: Solution | None, seconds: float) -> Pushed:
        """A stream after its frame, with error bars where it has them."""
        if solution is None:
            return None, None
        stream, weights = self.streams[number], tuple(float(weight) for weight in self.batch.weights[number])
        step, track, deviation = Step(solution, seconds, weights), stream.track, None
        if track is not None and solution.at is not None:
            begin = perf_counter()
            with suppress(*BROKEN):
                track, bars = track.advanced(LinearModel(solution.at, NO_DUAL))
                step, deviation = replace(step, bars=bars, bars_seconds=perf_counter() - begin), track.deviation
        found = solution.cell_resistance[0]
        after = replace(stream, previous=found, previous_deviation=deviation, track=track, first=False)
        return after, step.bare()


def _lower(one: Ended, other: Ended) -> Ended:
    """Of each panel the lower minimum of two; the first where they are one."""
    better = other.solved & (~one.solved | (other.points.objective < one.points.objective * (1 - SAME)))
    return one.where(~better, other)
