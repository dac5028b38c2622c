"""Frames of many streams at once.

Frames that permit it are solved in batches over a leading axis, all others one by one.
"""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from math import sqrt
from time import perf_counter

import numpy as np

from lampest.cost.problem import NO_DUAL, Evaluation
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.method import OptimalMethod
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.estimate.weights import converter_and_faults, strongest, with_chosen_weights
from lampest.files.errors import BROKEN
from lampest.panel.panel import Numbers
from lampest.recording.readings import Readings
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.projected_lbfgs import NAME, InverseHessians, serves, solve
from lampest.solvers.solution import VERIFIED, Outcome, Status, solution_at

MAX_BLOCK_FRAMES = 40  # frames that are solved together: 50 MB of inverse Hessians at 20 × 20
# Mean of squared differences of two frames over σ²; with noise alone it is 2.
MAX_NOISE_SQUARES = 4.0
# Every stream after its frame with the frame's step, by number; inverse Hessians for the next frame
Pushed = tuple[dict[int, tuple[Stream, Step]], InverseHessians]


def push_streams(
    streams: Mapping[int, Stream], readings: Readings, inverses: InverseHessians
) -> Pushed:
    """Push a frame to each stream, together where a batch can.

    Parameters
    ----------
    streams : mapping of int to Stream
    readings : Readings
        One frame of each number, (numbers, rows, columns).
    inverses : InverseHessians
        Inverse Hessians by number, from solves of earlier frames.

    Returns
    -------
    pushed : mapping of int to (Stream, Step)
        Every stream after its frame, and the frame's step.
    inverses : InverseHessians
        Inverse Hessians for the next frame.
    """
    # Weights first; then batches; whatever a batch does not solve is pushed alone.
    streams = _weighed(streams, {number: readings[number] for number in streams})
    solved, inverses = _solved_together(streams, readings, inverses)
    pushed = {
        number: solved.get(number) or stream.push(readings[number])
        for number, stream in streams.items()
    }
    return pushed, inverses


def _weighed(streams: Mapping[int, Stream], frames: Mapping[int, Readings]) -> dict[int, Stream]:
    """Return the streams with weights; streams of one group choose them together.

    A group has one estimator, converter and faults. If the frame of any of its streams is due to
    choose weights, the streams with the largest change from rest choose them for all.
    """
    weighed = dict(streams)
    groups = dict[Hashable, dict[int, Stream]]()
    for number, stream in streams.items():
        comparable = stream.rested or not stream.estimator.relative
        if stream.chooses_weights and comparable and frames[number].enough(stream.scene):
            kind = id(stream.estimator), stream.rested, converter_and_faults(stream.scene)
            groups.setdefault(kind, {})[number] = stream
    for group in groups.values():
        if not any(stream.choosing(frames[number]) for number, stream in group.items()):
            continue
        changes = [stream.change(frames[number]) for number, stream in group.items()]
        numbers = [list(group)[place] for place in strongest(changes)]
        deciding = group[numbers[0]]
        (data, start), *further = (
            group[number].data_and_start(frames[number]) for number in numbers
        )
        objective = with_chosen_weights(
            deciding.estimator,
            deciding.scene,
            data.limited(deciding.estimator.solver.time_limit_s),
            start,
            [data for data, _ in further],
        )
        weights = tuple(float(term.weight) for term in objective.terms)
        for number, stream in group.items():
            weighed[number] = replace(
                stream,
                weights=weights,
                weight_sigma=objective.weight_sigma,
                weighed_at=max(changes),
            )
    return weighed


def push_block(stream: Stream, readings: Readings) -> Iterator[tuple[Stream, Step]]:
    """Generate the stream after each of its next frames, with the frame's step.

    Up to MAX_BLOCK_FRAMES frames that are independent of each other are solved over a leading axis.
    Leaders are solved from the last estimate on, and all others from the estimate and the inverse
    Hessian of the leader whose readings are nearest. Frames that jump between a few loads are then
    close to their starts. Frames that the batch does not solve are pushed alone.

    Parameters
    ----------
    stream : Stream
        One that takes blocks.
    readings : Readings
        The next frames, (frames, rows, columns).
    """
    readings = readings[:MAX_BLOCK_FRAMES]
    count = len(readings.value)
    inverses = InverseHessians.nothing(count)
    leaders, nearest = leading_frames(readings)
    leading = dict.fromkeys(range(count) if len(leaders) == 1 else sorted(leaders), stream)
    solved, inverses = _solved_together(leading, readings, inverses)
    following = {
        number: solved.get(leader, (stream,))[0]
        for number, leader in enumerate(nearest)
        if number not in leading
    }
    inverses = inverses.some(np.array(nearest))
    solved |= _solved_together(following, readings, inverses)[0]
    for number in range(count):
        stream, step = solved.get(number) or stream.push(readings[number])
        yield stream, step


def leading_frames(readings: Readings) -> tuple[list[int], list[int]]:
    """Choose the frames that lead, and a leader for every frame.

    The first frame leads. Every further leader is the frame that differs most from those before it,
    until √n of n frames lead, or no frame differs by more than noise. Source: Gonzalez, Theor.
    Comput. Sci. 38, 293, 1985 (farthest-first traversal).

    Parameters
    ----------
    readings : Readings
        Frames, (frames, rows, columns).

    Returns
    -------
    leaders : list of int
        Numbers of the leading frames.
    nearest : list of int
        Number of the nearest leader of every frame.
    """
    count = len(readings.value)
    sigma = 1.0 if readings.sigma is None else readings.sigma
    scaled = (readings.value / sigma).reshape(count, -1)
    noise = 0.0 if readings.sigma is None else MAX_NOISE_SQUARES
    leaders = [0]
    squares = [np.mean((scaled - scaled[0]) ** 2, axis=1)]
    while len(leaders) < sqrt(count):
        least = np.min(squares, axis=0)
        if least.max() <= noise:
            break
        leaders.append(int(np.argmax(least)))
        squares.append(np.mean((scaled - scaled[leaders[-1]]) ** 2, axis=1))
    return leaders, [leaders[place] for place in np.argmin(squares, axis=0)]


def solve_baselines(streams: Mapping[int, Stream]) -> dict[int, Stream]:
    """Return every stream with its solved baseline.

    The streams of one group choose the weights of the baselines together.
    """
    unweighed = {number: replace(stream, weights=None) for number, stream in streams.items()}
    weighed = _weighed(unweighed, {number: stream.resting for number, stream in streams.items()})
    rested = dict[int, Stream]()
    for number, stream in streams.items():
        solved = replace(stream, estimator=weighed[number].weighted).with_rest()
        rested[number] = replace(solved, estimator=stream.estimator)
    return rested


def _solved_together(
    streams: Mapping[int, Stream], readings: Readings, inverses: InverseHessians
) -> Pushed:
    """Return the streams after their frame and the frame's step by number.

    Only streams that batches can solve are included. Streams with the same cost are one batch.
    """
    groups = dict[Hashable, list[int]]()
    for number, stream in streams.items():
        frame = readings[number]
        if _in_batches(stream, frame):
            kind = _unweighted(stream.estimator), stream.scene.faults, frame.partial
            groups.setdefault(kind, []).append(number)
    solved = dict[int, tuple[Stream, Step]]()
    for group in groups.values():
        numbers = np.array(group)
        batch = [streams[number] for number in group]
        with np.errstate(all="ignore"), suppress(*BROKEN):
            part, own = _solved_batch(batch, readings[numbers], inverses.some(numbers), numbers)
            solved |= part
            inverses = inverses.replaced(numbers, own)
    return solved, inverses


def _in_batches(stream: Stream, readings: Readings) -> bool:
    """Return whether a batch can solve a stream's frame.

    A batch continues from an earlier estimate and has the reduced formulation, unwired two-point
    readouts, the solver's default limits and known weights.
    """
    estimator = stream.estimator
    method = estimator.method
    settings = estimator.solver
    return (
        stream.rested
        and not stream.first
        and isinstance(method, OptimalMethod)
        and method.kind in ("reduced", "auto")
        and stream.scene.circuit.two_point
        and stream.scene.wiring is None
        and settings.time_limit_s is None
        and settings.starts is None
        and not estimator.weighs_previous
        and (not estimator.automatic or stream.chooses_weights)
        and (not readings.partial or (stream.track is None and bool(readings.enough(stream.scene))))
    )


@lru_cache(maxsize=256)
def _unweighted(estimator: Estimator) -> Estimator:
    """Return the estimator with all weights 1."""
    return estimator.with_weights([1.0] * len(estimator.terms))


def _solved_batch(
    streams: Sequence[Stream], frames: Readings, inverses: InverseHessians, numbers: Numbers
) -> Pushed:
    """Return the streams of one batch after their frame, and the frame's step, by number.

    Only verified minima are returned. The streams have one shape and one kind of cost.
    """
    begin = perf_counter()
    estimator = _unweighted(streams[0].estimator)
    background = streams[0].background
    previous = np.stack([stream.previous for stream in streams if stream.previous is not None])
    if estimator.relative:
        resting = np.stack([stream.baseline_resistance for stream in streams])
        background = replace(background, previous=previous, baseline=resting)
    data = estimator.data(frames, background)
    cost = estimator.cost(streams[0].scene, 1, partial=data.partial)
    if not serves(cost):
        return {}, inverses
    data = data.of_panels()
    weights = np.array(
        [[float(term.weight) for term in stream.weighted.terms] for stream in streams]
    )
    start = Evaluation.at(cost, data, np.clip(previous[:, None], data.lower, data.upper), weights)
    ended = solve(start, inverses, estimator.solver)
    seconds = (perf_counter() - begin) / len(numbers)
    verified = ended.solved & (ended.points.residual <= VERIFIED)
    after = {}
    for row in np.flatnonzero(verified).tolist():
        stream = streams[row]
        at = ended.points.at.some(row)
        cells = at.cell_resistance
        gradient = ended.points.gradient[row].reshape(cells.shape)
        status = Status.HELD if bounds_matter(at, gradient, NO_DUAL) else Status.OPTIMUM
        iterations = int(ended.iterations[row])
        outcome = Outcome(cells, NO_DUAL, status, iterations, carried=stream.prepared)
        solution = solution_at(at, float(ended.points.residual[row]), outcome, status)
        step = Step(
            replace(solution, solver=NAME),
            seconds,
            tuple(weights[row].tolist()),
            weight_sigma=stream.weighted.weight_sigma,
        )
        after[int(numbers[row])] = stream.estimator.method.after(stream, step, frames[row])
    return after, ended.inverses
