"""`formulation: smoother`: all frames of a recording together, in both directions, by graduated non-convexity.

The estimate u with its covariance P has the least of the free energy

    F(u, z, c, P) = misfits + |z|² + Σ c²/τ² + walk(E x²) + tr A P − log det P,

A the misfits' Hessian, E x² = x² + var x by P of the steps x between frames. For given P and E x² a Newton step of
`Joint`, for given u the inverse of its matrix and new stiffnesses. At the end the stiffness is kept, and u, z, c are
where Φ is least.
Sources: Opper & Archambeau, Neural Comput. 21, 2009 (F); Blake & Zisserman, Visual Reconstruction, 1987 (q drawn down);
Geman & McClure, Bull. Int. Stat. Inst. 52, 1987, and Black & Rangarajan, Int. J. Comput. Vision 19, 1996 (κ); Candès,
Wakin & Boyd, J. Fourier Anal. Appl. 14, 2008 (sums in a logarithm).
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf, isfinite
from time import monotonic, perf_counter
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.cost.losses import Squared
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit, Term
from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.changed_cells import touching
from lampest.estimate.methods.joint import Joint, JointData, error_bars
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.state import NO_DUAL, S, SequenceState, Step
from lampest.files.errors import InputError
from lampest.files.levels import NOISE_REACH
from lampest.files.process import delayed_interrupt
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.dense import positive_inverse
from lampest.posterior.linear import IGNORANCE
from lampest.posterior.track import Track
from lampest.recording.readings import Readings
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.multistart import BROKEN
from lampest.solvers.solution import OPEN_FRACTION, VERIFIED, Settings, Solution, Solver, Status, blank

MAX_LAST_CHANGE = 1e-3  # of a standard deviation: largest change of a cell by one more step
MAX_UNLOADED_PARTS = 5  # of the unloaded frames: enough to identify a wrong reading; more cost time
MAX_ROUNDS = 40  # 15 to 40 were needed on simulated lampreys
MAX_ROUND_CHANGE = 0.3  # of a standard deviation, by which a round may still move a cell
# From one walk to the next; slowly where the ties make a step's variance, which then must follow.
FAST_DECREASE, SLOW_DECREASE = 0.6, 0.8
# Of q²: the median of squared steps of still cells from where on that is so, and where ties have followed the walk.
TIED, FOLLOWED = 0.5, 1.5


@dataclass(frozen=True)
class SmootherMethod(Method):
    """Φ = misfits + changes of cells between frames + errors common to all readings, over all frames and the baseline.

    Most cells stand still, some never do, and any may jump; a step that all cells have in common is free. Frames as
    they come are estimated together with those before, back to `lag`.

    Raises ValueError where a number is out of range.

    Attributes
    ----------
    walk : float
        The least that a still cell is taken to walk from frame to frame, over the noise of a frame that is estimated
        alone, in the median; frames may show that it is more.
    jump : float
        So many walks a jump costs at most.
    lag : int
        Of how many frames before.

    >>> lampest.SmootherMethod().kind
    'smoother'
    """

    optimum: ClassVar[bool] = True
    needs_all_frames: ClassVar[bool] = True
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
                "weight 1; its loss may be huber or a smooth one of your own, but not squared, with which one wrong "
                "reading pulls at all frames, nor absolute, which is not smooth"
            )

    def compares(self, terms: tuple[Term, ...]) -> bool:
        """Return True: the unloaded panel is the first frame."""
        return True

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """Return a frame alone, from which all of them begin."""
        return OptimalMethod("reduced").solution(solver, data, previous, None)

    def sequence(
        self, state: S, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[S, list[Step]]:
        """Solve all frames together; those of which too little was read are left out."""
        rested = state.resting.enough(state.scene)
        enough = readings.enough(state.scene) & rested
        read = [readings[frame] for frame in np.flatnonzero(enough)]
        # Means of the unloaded frames, in up to so many parts that one wrong reading is seen; or of all there is.
        numbers = np.flatnonzero(resting.enough(state.scene))
        parts = np.array_split(numbers, min(len(numbers), MAX_UNLOADED_PARTS)) if len(numbers) else []
        groups = [resting[part].mean() for part in parts] or [state.resting]
        state, steps = self._together(state, groups, read, [], on_frame)
        missing, solved = state.unsolved(Status.UNREAD if rested else Status.UNRESTED), iter(steps)
        return state, [next(solved) if read_enough else missing for read_enough in enough]

    def push(self, state: S, readings: Readings) -> tuple[S, Step]:
        """One frame, together with those before it."""
        before, estimates = state.prepared or ((), ())  # readings of the last frames, and their cells
        read, cells = (*before, readings)[-1 - self.lag :], estimates[-self.lag :]
        after, steps = self._together(state, [state.resting], read, cells, lambda: None)
        if not steps[-1].solution.solved:
            return state, steps[-1]
        return replace(after, prepared=(read, tuple(step.cell_resistance for step in steps))), steps[-1]

    def _together(
        self,
        state: S,
        resting: Sequence[Readings],
        readings: Sequence[Readings],
        cells: Sequence[Array],
        on_frame: Callable[[], None],
    ) -> tuple[S, list[Step]]:
        """Return the state with the baseline that the frames agree on, and their steps.

        cells : estimates of the first frames, from earlier solves.
        """
        if not readings or state.baseline is None or not state.baseline.solution.solved:
            return state, [state.unsolved(Status.BREAKDOWN) for _ in readings]
        begin = perf_counter()
        data, start = _begun(state, resting, readings, cells, on_frame)
        with delayed_interrupt(), suppress(*BROKEN), np.errstate(all="ignore"):
            until = monotonic() + len(data) * (state.estimator.solver.time_limit_s or inf)
            joint, rounds = self._joint(state, data, start, len(resting), until)
            fault = Status.TIME if monotonic() > until else Status.UNVERIFIED
            solutions = _checked(joint, rounds, fault)[len(resting) - 1 :]
            steps = [Step(solution, (perf_counter() - begin) / len(data), (1.0,)) for solution in solutions]
            if state.track is not None and steps[0].solution.solved:
                state, steps = _barred(state, state.track, joint, steps)
            baseline = steps[0] if steps[0].solution.solved else state.baseline
            return replace(state, baseline=baseline, previous=steps[-1].estimate(0)), steps[1:]
        return state, [state.unsolved(Status.BREAKDOWN) for _ in readings]

    def least_cost(self, state: SequenceState, readings: Sequence[Readings]) -> Joint:
        """Φ of frames alone, unloaded or not, where it is least. Raises as `smoothed`, and where a baseline failed."""
        if not state.rested:
            raise np.linalg.LinAlgError("the unloaded panel has no estimate")
        return self._joint(state, *_begun(state, (), readings, (), lambda: None))[0]

    def _joint(
        self, state: SequenceState, data: Sequence[Data], start: Array, resting: int = 0, until: float = inf
    ) -> tuple[Joint, int]:
        """Return `smoothed` for the data of all frames, of which `resting` are means of unloaded ones."""
        costs = [state.estimator.cost(state.scene, 1, partial=frame.partial) for frame in data]
        # Errors that a scene does not name are no unknowns: usual errors of a circuit are too many for a few frames to
        # tell.
        scene = state.scene if state.scene.specified_systematic else replace(state.scene, systematic="none")
        frames = JointData.alone(costs, data, Shared.of(scene), start, state.frame_noise, resting)
        return smoothed(frames, start, Walk(self.walk, self.jump), state.estimator.solver, until)


def _begun(
    state: SequenceState,
    resting: Sequence[Readings],
    readings: Sequence[Readings],
    cells: Sequence[Array],
    on_frame: Callable[[], None],
) -> tuple[list[Data], Array]:
    """Return the data of all frames, and log r of each alone by least squares, (frames, cells).

    Unloaded frames come first.
    """
    assert state.baseline is not None
    terms = tuple(replace(term, loss=Squared()) for term in state.estimator.terms)
    alone, reduced = replace(state, estimator=state.estimator.with_terms(terms)), OptimalMethod("reduced")
    data = [state.estimator.data(frame.alone(), state.background) for frame in (*resting, *readings)]
    estimates = [state.baseline.cell_resistance, *cells] if len(resting) == 1 else []
    for number, frame in enumerate(data[len(estimates) :], len(estimates)):
        before = estimates[-1] if estimates else state.baseline.cell_resistance
        step = reduced.solve(alone, frame, before[None])
        estimates.append(before if step.estimate(0) is None else step.cell_resistance)
        if number >= len(resting):
            on_frame()
    return data, np.log(np.stack(estimates)).reshape(len(data), -1)


def _checked(joint: Joint, rounds: int, fault: Status) -> list[Solution]:
    """Return every frame for which the joint optimality conditions hold; NaN and the fault for the others."""
    faint = np.any(np.abs(joint.newton()[0]) > MAX_LAST_CHANGE * np.sqrt(joint.chain.variance), axis=1)
    solutions, slopes = [], 2 * joint.gradient[:, : joint.cells]
    for at, residual, weak, slope in zip(joint.at, joint.kkt_residual, faint, slopes, strict=True):
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
    """Return the state with the baseline's error bars, and the steps, of which it is the first, with theirs."""
    begin = perf_counter()
    beyond = None if track.shared is None else track.shared.beyond(joint.frames.errors)
    baseline, bars = error_bars(joint, len(joint.position) - len(steps) + 1, beyond)
    seconds = (perf_counter() - begin) / len(steps)
    pairs = zip(steps[1:], bars, strict=True)
    barred = [replace(step, bars=own, bars_seconds=seconds) if step.solution.solved else step for step, own in pairs]
    return replace(state, track=replace(track, baseline=baseline)), [steps[0], *barred]


@dataclass(frozen=True)
class Walk:
    """Cost of steps x between the frames.

        n k Σ_i log(1 + a_i) + Σ x²/s²,   a_i the mean over the n steps of cell i of κ² S/(κ² + S),   S = K x²/q²

    s is the assumed deviation of a jump. K averages with the steps before and after. The cost of a step grows like
    x²/q² at first, and hardly beyond κ²: a jump costs the same however far it leads. The cost of a cell grows like the
    logarithm of that: of one whose steps are all a little larger than noise each is taken for a step. k is such that a
    cell whose steps are as large as the walk is tied by 1/q². The walk begins at several times the noise and is drawn
    down as far as still cells allow, so that small jumps are seen after large ones.

    Attributes
    ----------
    deviation : float
        q, of log r.
    most : float
        κ, so many q a jump costs at most.
    """

    deviation: float
    most: float

    def cost(self, squares: Array) -> float:
        """Return the cost of the expected squares of all steps, (frames − 1, cells)."""
        jumps = len(squares) * self._scale * np.sum(np.log1p(self.unrest(squares)))
        return float(jumps + np.sum(squares) / ASSUMED.jump**2)

    def stiffness(self, squares: Array) -> Array:
        """∂cost/∂squares, (frames − 1, cells): the λ of Σ λ x² that has the cost's slope here, and nowhere less."""
        slope = averaged(1 / (1 + self._size(squares) / self.most**2) ** 2) / self.deviation**2
        return np.asarray(self._scale * slope / (1 + self.unrest(squares)) + ASSUMED.jump**-2)

    def unrest(self, squares: Array) -> Array:
        """Return a, (cells)."""
        size = self._size(squares)
        return np.asarray(np.mean(self.most**2 * size / (self.most**2 + size), axis=0))

    def drawn_down(self, squares: Array, stiffness: Array, least: float) -> tuple["Walk", bool]:
        """Return the next walk, never below `least`, and whether it may go on.

        It goes on while still cells do not step further than it.

        Still is the half of the cells with the least unrest. stiffness : that the squares were found with. A cell's
        likeliest walk is where λ E x² is 1 in the mean.
        """
        unrest = self.unrest(squares)
        still = unrest <= np.median(unrest)
        if self.deviation <= least or np.mean((stiffness * squares)[:, still]) > 1:
            return self, False
        size = np.median(squares[:, still]) / self.deviation**2
        factor = 1.0 if size > FOLLOWED else SLOW_DECREASE if size > TIED else FAST_DECREASE
        return replace(self, deviation=max(self.deviation * factor, least)), True

    def near_loads(self, squares: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(frames − 1, cells) of a panel of a shape: where a cell, or one that it touches, jumps."""
        jumps = (self._size(squares) > self.most**2).reshape(-1, *shape)
        return touching(jumps).reshape(squares.shape)

    @property
    def _scale(self) -> float:
        """k."""
        return (1 + self.most**2 / (1 + self.most**2)) * (1 + self.most**-2) ** 2

    def _size(self, squares: Array) -> Array:
        """S."""
        return averaged(squares) / self.deviation**2


def averaged(steps: Array) -> Array:
    """K x: a quarter of the step before, a half of the step, a quarter of that after; at either end it is repeated."""
    around = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(around[:-2] / 4 + around[1:-1] / 2 + around[2:] / 4)


def smoothed(frames: JointData, alone: Array, walk: Walk, settings: Settings, until: float = inf) -> tuple[Joint, int]:
    """(where Φ is least, rounds).

    Raises numpy.linalg.LinAlgError where arithmetic breaks down.

    Parameters
    ----------
    alone : array
        log r of every frame alone, (frames, cells).
    walk : Walk
        Its deviation is the least, over the noise of frames alone.
    until : float
        s on the clock of `time.monotonic`, when rounds end.
    """
    # The median with the frames before and after, so that a wrong reading begins as no jump.
    lasting = np.median(np.stack([alone[:-2], alone[1:-1], alone[2:]]), axis=0)
    start = np.pad(np.concatenate([alone[:1], lasting, alone[-1:]]), ((0, 0), (0, frames.drawn.shape[2])))
    start = np.clip(start, *frames.bounds)
    joint = Joint(frames, start, np.zeros(len(start) - 1), np.zeros((len(start) - 1, alone.shape[1])))
    own = np.pad(np.full(alone.shape[1], IGNORANCE), (0, frames.drawn.shape[2]), constant_values=1.0)
    inverses = [positive_inverse(rows.T @ rows + np.diag(own)) for rows in joint.sensitivities]
    variance = np.minimum([np.diag(inverse)[: alone.shape[1]] for inverse in inverses], ASSUMED.jump**2)
    noise = float(np.sqrt(np.median(variance)))
    walk, least = replace(walk, deviation=NOISE_REACH * noise), walk.deviation * noise
    frames = frames.sharing(joint.at)
    shift = np.zeros(frames.shared.shape[2] + len(start) - 1)
    joint = Joint(frames, start, shift, walk.stiffness(joint.steps**2 + variance[1:] + variance[:-1]))
    rounds, moving, taken = 0, True, walk.deviation
    while rounds < MAX_ROUNDS and moving and monotonic() < until:
        before, joint = joint, joint.stepped()
        moved = np.abs(joint.log_cells - before.log_cells).max(initial=0.0, where=~joint.pressed[:, : joint.cells])
        squares = joint.expected_squares()
        walk, on = walk.drawn_down(squares, joint.stiffness, least)
        # Readings of a wider walk follow the noise, which would seem a reference's.
        if not on or walk.deviation < taken / 2:
            joint, taken = replace(joint, frames=joint.frames.sharing(joint.at)), walk.deviation
        joint, rounds = replace(joint, stiffness=walk.stiffness(squares)), rounds + 1
        moving = on or moved > MAX_ROUND_CHANGE * noise
    near = walk.near_loads(joint.expected_squares(), frames.data[0].measured.shape[-2:])
    joint = joint.agreeing(np.where(near, ASSUMED.jump**-2, joint.stiffness)).stepped()
    for _ in range(settings.max_iterations):
        if joint.kkt_residual.max() <= settings.tolerance or monotonic() > until:
            break
        before, joint = joint, joint.stepped()
        if joint is before:
            break
    return joint, rounds
