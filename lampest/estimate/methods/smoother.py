"""`formulation: smoother`: all frames of a recording estimated together, in both directions."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf, isfinite
from time import monotonic, perf_counter
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.cost.losses import Squared
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit, Term
from lampest.estimate.methods.graduated import Walk, smoothed
from lampest.estimate.methods.joint import NO_DUAL, Joint, JointData, error_bars
from lampest.estimate.methods.method import Method
from lampest.estimate.methods.optimal import OptimalMethod
from lampest.estimate.state import S, SequenceState, Step
from lampest.files.errors import InputError
from lampest.files.interrupts import delayed_interrupt
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.track import Track
from lampest.recording.readings import Readings
from lampest.solvers.bound_multipliers import bounds_matter
from lampest.solvers.multistart import BROKEN
from lampest.solvers.solution import OPEN_FRACTION, VERIFIED, Solution, Solver, Status, blank

STILL = 1e-3  # of a standard deviation: what one more step may move a cell by
MOST_PARTS = 5  # of the unloaded frames: a wrong reading among three is told apart, and more cost time


@dataclass(frozen=True, eq=False)
class Window:
    """The last frames of a sequence. readings : of each, (rows, columns). cells : as they were estimated, ohm."""

    readings: tuple[Readings, ...] = ()
    cells: tuple[Array, ...] = ()


@dataclass(frozen=True)
class SmootherMethod(Method):
    """Φ = misfits + changes of cells between frames + errors common to all readings, over all frames and the baseline.

    Most cells stand still, some never do, and any may jump; a step that all cells
    have in common is free. Frames as they come are estimated together with those before, back to `lag`.

    walk : the least that a still cell is taken to walk from frame to frame, over the noise of a frame that is estimated
    alone, in the median; frames may tell that it is more.
    jump : so many walks a jump costs at most. lag : of how many frames before.
    Raises ValueError where a number is out of range.

    >>> lampest.SmootherMethod().kind
    'smoother'
    """

    optimum: ClassVar[bool] = True
    together: ClassVar[bool] = True
    kind: Literal["smoother"] = "smoother"
    walk: float = 0.1
    jump: float = 3.0
    lag: int = 8

    def __post_init__(self) -> None:
        for name in ("walk", "jump"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"{name} must be positive and finite")
        if self.lag < 1:
            raise ValueError("lag must be at least 1")

    def check(self, terms: tuple[Term, ...]) -> None:
        """Raise InputError unless the misfit is alone, in units of its noise, and one wrong reading harms one frame."""
        [first, *others] = terms
        fits = isinstance(first, Misfit) and first.weighting == "noise" and first.weight == 1
        if others or not fits or first.loss.squared or first.loss.enters == "dual":
            raise InputError(
                "formulation: smoother has one term, misfit: {weighting: noise, loss: {kind: student, corner: 4}}, of "
                "weight 1; its loss may be huber, but not squared: a wrong reading would pull at all frames"
            )

    def compares(self, terms: tuple[Term, ...]) -> bool:
        """Always: the unloaded panel is the first frame."""
        return True

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """A frame alone, from which all of them begin."""
        return OptimalMethod("reduced").solution(solver, data, previous, None)

    def sequence(
        self, state: S, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[S, list[Step]]:
        """All frames together; those of which too little was read are left out."""
        enough = readings.enough(state.scene) & state.resting.enough(state.scene)
        read = [readings[frame] for frame in np.flatnonzero(enough)]
        state, found = self._together(state, _groups(state, resting), read, [], on_frame)
        status = Status.UNREAD if state.resting.enough(state.scene) else Status.UNRESTED
        solved = iter(found)
        return state, [next(solved) if one else state.unsolved(status) for one in enough]

    def push(self, state: S, readings: Readings) -> tuple[S, Step]:
        """One frame, together with those before it."""
        window = state.prepared or Window()
        read, cells = (*window.readings, readings)[-1 - self.lag :], window.cells[-self.lag :]
        after, steps = self._together(state, [state.resting], read, cells, lambda: None)
        if not steps[-1].solution.solved:
            return state, steps[-1]
        return replace(after, prepared=Window(tuple(read), tuple(step.cell_resistance for step in steps))), steps[-1]

    def _together(
        self,
        state: S,
        resting: Sequence[Readings],
        readings: Sequence[Readings],
        cells: Sequence[Array],
        on_frame: Callable[[], None],
    ) -> tuple[S, list[Step]]:
        """The state with the baseline that the frames agree on, and their steps. cells : of the first, from before."""
        if not readings or state.baseline is None or not state.baseline.solution.solved:
            return state, [state.unsolved(Status.BREAKDOWN) for _ in readings]
        begin = perf_counter()
        data, start = _begun(state, resting, readings, cells, on_frame)
        costs = [state.estimator.cost(state.scene, 1, one.partial) for one in data]
        # What a scene does not name is no unknown: usual errors of a circuit are too many for a few frames to tell.
        told = state.scene if state.scene.told_systematic else replace(state.scene, systematic="none")
        frames = JointData.alone(costs, data, Shared.of(told), start)
        with delayed_interrupt(), suppress(*BROKEN), np.errstate(all="ignore"):
            settings = state.estimator.solver
            until = monotonic() + len(data) * (settings.time_limit_s or inf)
            joint, rounds = smoothed(frames, start, Walk(self.walk, self.jump), settings, until)
            fault = Status.TIME if monotonic() > until else Status.UNVERIFIED
            solutions = _checked(joint, rounds, fault)[len(resting) - 1 :]
            steps = [Step(solution, (perf_counter() - begin) / len(data), (1.0,)) for solution in solutions]
            if state.track is not None and steps[0].solution.solved:
                state, steps = _barred(state, state.track, joint, steps)
            baseline = steps[0] if steps[0].solution.solved else state.baseline
            return replace(state, baseline=baseline, previous=steps[-1].estimate(0)), steps[1:]
        return state, [state.unsolved(Status.BREAKDOWN) for _ in readings]


def _groups(state: SequenceState, resting: Readings) -> list[Readings]:
    """Means of the unloaded frames, in up to so many parts that one wrong reading is seen; or of all there is."""
    numbers = np.flatnonzero(resting.enough(state.scene))
    parts = np.array_split(numbers, min(len(numbers), MOST_PARTS)) if len(numbers) else []
    return [resting[part].mean() for part in parts] or [state.resting]


def _begun(
    state: SequenceState,
    resting: Sequence[Readings],
    readings: Sequence[Readings],
    cells: Sequence[Array],
    on_frame: Callable[[], None],
) -> tuple[list[Data], Array]:
    """The data of all frames, the unloaded ones first, and log r (frames, cells) of each alone, by least squares.

    A loss that forgives wrong readings may forgive those of a cell that jumped, which begins where it was.
    """
    assert state.baseline is not None
    terms = tuple(replace(term, loss=Squared()) for term in state.estimator.terms)
    alone, reduced = replace(state, estimator=state.estimator.with_terms(terms)), OptimalMethod("reduced")
    data = [state.estimator.data(one.alone(), state.background) for one in (*resting, *readings)]
    found = [state.baseline.cell_resistance, *cells] if len(resting) == 1 else []
    for number, one in enumerate(data[len(found) :], len(found)):
        before = found[-1] if found else state.baseline.cell_resistance
        step = reduced.solve(alone, one, before[None])
        found.append(before if step.estimate(0) is None else step.cell_resistance)
        if number >= len(resting):
            on_frame()
    return data, np.log(np.stack(found)).reshape(len(data), -1)


def _checked(joint: Joint, rounds: int, fault: Status) -> list[Solution]:
    """Every frame where the joint cost's optimality conditions hold for it; NaN and the fault elsewhere."""
    step, _ = joint.chain.solve(-np.where(joint.pressed, 0.0, joint.gradient), -joint.shift_gradient)
    faint = np.any(np.abs(step) > STILL * np.sqrt(joint.chain.variance), axis=1)
    solutions = []
    for at, residual, weak, slope in zip(joint.at, joint.kkt_residual, faint, 2 * joint.gradient, strict=True):
        cells, data = at.cell_resistance, at.data
        if not residual <= VERIFIED:
            failed = blank(cells.shape, 1, fault)
            solutions.append(replace(failed, kkt_residual=float(residual), iterations=rounds))
            continue
        low, high = cells <= data.lower / OPEN_FRACTION, cells >= data.upper * OPEN_FRACTION
        held = bounds_matter(at, slope.reshape(cells.shape), NO_DUAL)
        status = Status.FAINT if weak else Status.HELD if held else Status.OPTIMUM
        outcome = (at.costs, at.objective, float(residual), low, high, status, rounds)
        solutions.append(Solution(cells, at.reading, *outcome))
    return solutions


def _barred(state: S, track: Track, joint: Joint, steps: list[Step]) -> tuple[S, list[Step]]:
    """The state with the baseline's error bars, and the steps, of which it is the first, with theirs."""
    begin = perf_counter()
    beyond = None if track.shared is None else track.shared.beyond(joint.frames.errors)
    baseline, bars = error_bars(joint, len(joint.position) - len(steps) + 1, beyond, track.noise)
    seconds = (perf_counter() - begin) / len(steps)
    barred = [
        replace(step, bars=one, bars_seconds=seconds) if step.solution.solved else step
        for step, one in zip(steps[1:], bars, strict=True)
    ]
    return replace(state, track=replace(track, baseline=baseline)), [steps[0], *barred]
