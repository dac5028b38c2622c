"""`formulation: smoother`: all frames of a recording together.

A variational method with graduated non-convexity estimates u = log r. The estimate with its
covariance P minimises the free energy

    F(u, z, c, P) = misfits + |z|² + Σ c²/τ² + walk(E x²) + tr A P − log det P,

where A is the Hessian of the misfits, x are the steps of cells between frames, and E x² = x² + var
x under P. Two updates alternate: a Newton step of `Joint` in u, z, c for given stiffnesses λ =
∂walk/∂E x², and P as the inverse of the Newton matrix, which gives new E x² and λ. The walk's scale
q decreases from round to round. Finally λ is fixed, and u, z, c minimise Φ of
`lampest.estimate.methods.joint`. Sources: Opper & Archambeau, Neural Comput. 21, 2009 (F); Blake &
Zisserman, Visual Reconstruction, 1987 (decreasing q); Geman & McClure, Bull. Int. Stat. Inst. 52,
1987, and Black & Rangarajan, Int. J. Comput. Vision 19, 1996 (κ); Candès, Wakin & Boyd, J. Fourier
Anal. Appl. 14, 2008 (sums in a logarithm).
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from time import monotonic, perf_counter
from typing import Any, Literal

import numpy as np

from lampest.cost.losses import Squared
from lampest.cost.problem import NO_DUAL, Data
from lampest.cost.terms import Misfit, Term
from lampest.estimate.methods.joint import Joint, error_bars
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.state import AnyState, SequenceState, Step
from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import NOISE_REACH
from lampest.files.process import delayed_interrupt
from lampest.files.typed import check_positive_fields
from lampest.inference.assumptions import ASSUMED
from lampest.inference.evidence import touching
from lampest.panel.effects import Shared
from lampest.panel.panel import Array, Mask
from lampest.recording.readings import Readings
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.solution import (
    VERIFIED,
    Outcome,
    Settings,
    Solution,
    Solver,
    Status,
    failure,
    solution_at,
)

MAX_LAST_CHANGE = 1e-3  # of a standard deviation: largest change of a cell by a further Newton step
MAX_UNLOADED_PARTS = 5  # of the unloaded frames: enough to identify a wrong reading; more cost time
MAX_ROUNDS = 40  # 15 to 40 were needed on simulated lampreys
# Change of a cell in a round, in standard deviations, below which rounds may end.
MAX_ROUND_CHANGE = 0.3
# Factors on q from round to round. The slow one applies where the variance of steps depends on λ,
# and must follow it.
FAST_DECREASE = 0.6
SLOW_DECREASE = 0.8
# Median E x² of still cells over q²: above TIED the decrease is slow; above FOLLOWED λ has not
# followed q, which waits.
TIED = 0.5
FOLLOWED = 1.5


@dataclass(frozen=True)
class SmootherMethod(Method):
    """Φ = misfits + changes of cells between frames + errors common to all readings.

    The sums are over all frames and the baseline. Most cells stand still, some always move, and any
    cell may jump; a step that all cells have in common costs little. In a stream each frame is
    estimated together with the `lag` frames before it.

    Raises ValueError where a number is out of range.

    Attributes
    ----------
    walk : float
        Least standard deviation of a still cell's steps, as a fraction of the median noise of
        frames that are estimated alone; the frames may show a larger one.
    jump : float
        Steps of more walks than this cost no more.
    lag : int
        Number of earlier frames in a stream.

    >>> lampest.SmootherMethod().kind
    'smoother'
    """

    optimum = True
    needs_all_frames = True
    kind: Literal["smoother"] = "smoother"
    walk: float = 0.1
    jump: float = 3.0
    lag: int = 8

    def __post_init__(self) -> None:
        check_positive_fields(self, "walk", "jump")
        if self.lag < 1:
            raise ValueError("lag must be at least 1")

    def check(self, terms: tuple[Term, ...]) -> None:
        """Raise InputError unless the misfit is the only term.

        The misfit has to be in units of its noise and with a robust smooth loss.
        """
        [first, *further] = terms
        fits = isinstance(first, Misfit) and first.weighting == "noise" and first.weight == 1
        if further or not fits or first.loss.squared or first.loss.enters == "dual":
            raise InputError(
                "formulation: smoother has one term, misfit: "
                "{weighting: noise, loss: {kind: student, corner: 4}}, of weight 1; "
                "its loss may be huber or a smooth one of your own, but not squared, with "
                "which one wrong reading pulls at all frames, nor absolute, which is not smooth"
            )

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the estimate of a frame alone, as a start."""
        return OptimalMethod("reduced").solution(solver, data, previous, None)

    def sequence(
        self, state: AnyState, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[AnyState, list[Step]]:
        """Solve all frames together, as `Method.sequence`.

        Frames with too few readings are left out.
        """
        rested = state.resting.enough(state.scene)
        usable = readings.enough(state.scene) & rested
        read = [readings[frame] for frame in np.flatnonzero(usable)]
        # The unloaded frames enter as means of a few parts, so that a wrong reading in one part can
        # be identified.
        numbers = np.flatnonzero(resting.enough(state.scene))
        parts = np.array_split(numbers, min(len(numbers), MAX_UNLOADED_PARTS) or 1)
        groups = [state.resting]
        if len(numbers):
            groups = [resting[part].mean().beside(len(parts)) for part in parts]
        state, steps = self._together(state, groups, read, [], on_frame)
        missing = state.unsolved(Status.UNREAD if rested else Status.UNRESTED)
        solved = iter(steps)
        return state, [next(solved) if read_enough else missing for read_enough in usable]

    def push(self, state: AnyState, readings: Readings) -> tuple[AnyState, Step]:
        """Solve one frame together with the `lag` frames before it, as `Method.push`."""
        # Readings of the last frames, and their cells.
        earlier, estimates = state.prepared or ((), ())
        read = (*earlier, readings)[-1 - self.lag :]
        cells = estimates[-self.lag :]
        after, steps = self._together(state, [state.resting], read, cells, lambda: None)
        if not steps[-1].solution.solved:
            return state, steps[-1]
        cells = tuple(step.cell_resistance for step in steps)
        return replace(after, prepared=(read, cells)), steps[-1]

    def _together(
        self,
        state: AnyState,
        resting: Sequence[Readings],
        readings: Sequence[Readings],
        cells: Sequence[Array],
        on_frame: Callable[[], None],
    ) -> tuple[AnyState, list[Step]]:
        """Return the state with the joint estimate of the baseline, and the steps of the frames.

        Parameters
        ----------
        state : SequenceState
            State with a baseline.
        resting : sequence of Readings
            Means of unloaded frames, (rows, columns) each.
        readings : sequence of Readings
            The measured frames, (rows, columns) each.
        cells : sequence of array
            Estimates of the first measured frames from earlier solves, (rows, columns) ohm.
        on_frame : callable
            Called after every frame that is solved alone.
        """
        broken = [state.unsolved(Status.BREAKDOWN)] * len(readings)
        if not readings or not state.rested:
            return state, broken
        begin = perf_counter()
        data, start = _begun(state, resting, readings, cells, on_frame)
        with delayed_interrupt(), suppress(*BROKEN), np.errstate(all="ignore"):
            until = monotonic() + len(data) * (state.estimator.solver.time_limit_s or inf)
            joint, rounds = self._joint(state, data, start, len(resting), until)
            fault = Status.TIME if monotonic() > until else Status.UNVERIFIED
            solutions = _checked(joint, rounds, fault)[len(resting) - 1 :]
            seconds = (perf_counter() - begin) / len(data)
            track = state.track
            baseline, *steps = (Step(solution, seconds, (1.0,)).bare() for solution in solutions)
            if track is not None and baseline.solution.solved:
                begin = perf_counter()
                shared = track.shared and track.shared.beyond(joint.errors)
                certainty, bars = error_bars(joint, len(resting), shared)
                seconds = (perf_counter() - begin) / len(solutions)
                track = replace(track, baseline=certainty)
                pairs = zip(steps, bars, strict=True)
                steps = [
                    replace(s, bars=bar, bars_seconds=seconds) if s.solution.solved else s
                    for s, bar in pairs
                ]
            state = replace(
                state,
                baseline=baseline if baseline.solution.solved else state.baseline,
                previous=steps[-1].estimate(0),
                track=track,
            )
            return state, steps
        return state, broken

    def least_cost(self, state: SequenceState, readings: Sequence[Readings]) -> Joint:
        """Return Φ at its minimum over some frames, which may include unloaded ones.

        Raises numpy.linalg.LinAlgError as `smoothed`, and where the baseline failed.
        """
        if not state.rested:
            raise np.linalg.LinAlgError("the unloaded panel has no estimate")
        return self._joint(state, *_begun(state, (), readings, (), lambda: None))[0]

    def _joint(
        self,
        state: SequenceState,
        data: Sequence[Data],
        start: Array,
        resting: int = 0,
        until: float = inf,
    ) -> tuple[Joint, int]:
        """Return `smoothed` for the data of all frames.

        The first `resting` of them are means of unloaded ones.
        """
        costs = [state.estimator.cost(state.scene, 1, partial=frame.partial) for frame in data]
        begun = Joint.of(costs, data, Shared.of(state.scene), start, state.frame_noise, resting)
        return smoothed(begun, Walk(self.walk, self.jump), state.estimator.solver, until)


def _begun(
    state: SequenceState,
    resting: Sequence[Readings],
    readings: Sequence[Readings],
    cells: Sequence[Array],
    on_frame: Callable[[], None],
) -> tuple[list[Data], Array]:
    """Return the data of all frames, unloaded first, and log r of each frame alone.

    The latter is by least squares, (frames, cells).

    Parameters
    ----------
    state : SequenceState
    resting, readings : sequence of Readings
        Unloaded and measured frames, (rows, columns) each.
    cells : sequence of array
        Known estimates of the first measured frames, (rows, columns) ohm.
    on_frame : callable
        Called after every measured frame.
    """
    assert state.baseline is not None
    terms = tuple(replace(term, loss=Squared()) for term in state.estimator.terms)
    absolute = replace(state, estimator=state.estimator.with_terms(terms))
    reduced = OptimalMethod("reduced")
    data = [
        state.estimator.data(frame.alone(), state.background) for frame in (*resting, *readings)
    ]
    estimates = [state.baseline.cell_resistance, *cells] if len(resting) == 1 else []
    for number, frame in enumerate(data[len(estimates) :], len(estimates)):
        before = estimates[-1] if estimates else state.baseline.cell_resistance
        step = reduced.solve(absolute, frame, before[None])
        estimates.append(before if step.estimate(0) is None else step.cell_resistance)
        if number >= len(resting):
            on_frame()
    return data, np.log(estimates).reshape(len(data), -1)


def _checked(joint: Joint, rounds: int, fault: Status) -> list[Solution]:
    """Return the solution of every frame.

    Where the optimality conditions do not hold, the solution is NaN with the status `fault`.
    """
    faint = np.any(
        np.abs(joint.newton()[0]) > MAX_LAST_CHANGE * np.sqrt(joint.chain.variance), axis=1
    )
    solutions = []
    slopes = 2 * joint.gradient[:, : joint.cells]
    for at, residual, weak, slope in zip(
        joint.at, joint.kkt_residual.tolist(), faint, slopes, strict=True
    ):
        outcome = Outcome(at.cell_resistance, NO_DUAL, fault, rounds)
        if not residual <= VERIFIED:
            solutions.append(failure(at.cost, at.data, fault, residual, outcome))
            continue
        status = Status.OPTIMUM
        if weak:
            status = Status.FAINT
        elif bounds_matter(at, slope.reshape(at.cell_resistance.shape), NO_DUAL):
            status = Status.HELD
        solutions.append(solution_at(at, residual, outcome, status))
    return solutions


@dataclass(frozen=True)
class Walk:
    """Cost of the steps x of log r between frames.

        n k Σ_i log(1 + a_i) + Σ x²/s²,
        a_i = mean over the n steps of cell i of κ² S/(κ² + S),   S = K x²/q²

    s is the standard deviation of a jump, and K averages over successive steps. The cost of a
    single step grows like x²/q² and saturates at κ² (Geman and McClure), so that a jump costs the
    same at any size. The cost of a cell grows like the logarithm of its unrest a, so that a cell
    which always moves is hardly tied. The factor k makes the stiffness of a cell with steps of size
    q equal to 1/q². q begins at several times the noise and decreases as far as the still cells
    permit, so that small jumps are found after large ones.

    Attributes
    ----------
    deviation : float
        q, in log r.
    most : float
        κ, in units of q.
    """

    deviation: float
    most: float

    def stiffness(self, squares: Array) -> Array:
        """Return λ = ∂cost/∂(E x²), (frames − 1, cells).

        The cost is concave in E x², so that Σ λ E x² is its tangent and an upper bound up to a
        constant.
        """
        # d/dS κ² S/(κ² + S) = 1/(1 + S/κ²)², then the chain rule through K and log(1 + a)
        slope = averaged(1 / (1 + self._size(squares) / self.most**2) ** 2) / self.deviation**2
        scale = (1 + self.most**2 / (1 + self.most**2)) * (1 + self.most**-2) ** 2  # k
        return scale * slope / (1 + self.unrest(squares)) + ASSUMED.jump**-2

    def unrest(self, squares: Array) -> Array:
        """Return a, the unrest of every cell, (cells,)."""
        size = self._size(squares)
        return np.asarray(np.mean(self.most**2 * size / (self.most**2 + size), axis=0))

    def drawn_down(self, squares: Array, stiffness: Array, least: float) -> tuple["Walk", bool]:
        """Decrease q once.

        Still cells are the half with the least unrest. For the most probable λ of a Gaussian walk
        the mean of λ E x² is 1; where it exceeds 1 over the still cells, q is small enough.

        Parameters
        ----------
        squares : array, shape (frames − 1, cells)
            E x².
        stiffness : array, shape (frames − 1, cells)
            λ with which E x² was computed.
        least : float
            Lower limit of q.

        Returns
        -------
        walk : Walk
            The walk with the next q.
        decreases : bool
            Whether rounds go on.
        """
        unrest = self.unrest(squares)
        calmer = unrest <= np.median(unrest)
        if self.deviation <= least or np.mean((stiffness * squares)[:, calmer]) > 1:
            return self, False
        size = np.median(squares[:, calmer]) / self.deviation**2
        factor = FAST_DECREASE
        if size > FOLLOWED:
            factor = 1.0
        elif size > TIED:
            factor = SLOW_DECREASE
        return replace(self, deviation=max(self.deviation * factor, least)), True

    def near_loads(self, squares: Array, shape: tuple[int, ...]) -> Mask:
        """Return the steps in which a cell or one of its neighbours jumps, S > κ².

        Shape (frames − 1, cells).

        Parameters
        ----------
        squares : array, shape (frames − 1, cells)
            E x².
        shape : tuple of int
            Rows and columns.
        """
        jumps = (self._size(squares) > self.most**2).reshape(-1, *shape)
        return touching(jumps).reshape(squares.shape)

    def _size(self, squares: Array) -> Array:
        """Return S = K E x²/q², (frames − 1, cells)."""
        return averaged(squares) / self.deviation**2


def averaged(steps: Array) -> Array:
    """Return K x with (K x)_t = x_{t−1}/4 + x_t/2 + x_{t+1}/4.

    The first and the last step are repeated at the ends.
    """
    around = np.concatenate([steps[:1], steps, steps[-1:]])
    return around[:-2] / 4 + around[1:-1] / 2 + around[2:] / 4


def smoothed(joint: Joint, walk: Walk, settings: Settings, until: float = inf) -> tuple[Joint, int]:
    """Minimise Φ.

    Raises numpy.linalg.LinAlgError where arithmetic breaks down.

    Parameters
    ----------
    joint : Joint
        Φ without ties.
    walk : Walk
        Its deviation is the least q as a fraction of the noise of frames alone.
    settings : Settings
        Tolerance and iterations of the final minimisation.
    until : float
        End of the rounds, in s of `time.monotonic`.

    Returns
    -------
    joint : Joint
        Φ at its minimum.
    rounds : int
        Number of rounds.
    """
    # Noise of frames alone, from diag (J̃ᵀ J̃ + prior)⁻¹: the walk begins at thrice its median.
    cells = slice(joint.cells)
    rows = joint.sensitivities
    inverses = np.linalg.inv(rows.swapaxes(1, 2) @ rows + np.diag(joint.prior))
    variance = np.minimum(np.einsum("tii->ti", inverses)[:, cells], ASSUMED.jump**2)
    noise = float(np.sqrt(np.median(variance)))
    least = walk.deviation * noise
    walk = replace(walk, deviation=NOISE_REACH * noise)
    joint = replace(joint, stiffness=walk.stiffness(joint.steps**2 + variance[1:] + variance[:-1]))
    # Rounds: Newton step, E x² under P, smaller q, new λ.
    rounds = 0
    moving = True
    while rounds < MAX_ROUNDS and moving and monotonic() < until:
        previous = joint
        joint = joint.stepped()
        moved = np.abs(joint.log_cells - previous.log_cells).max(
            initial=0.0, where=~joint.pressed[:, cells]
        )
        squares = joint.expected_squares()
        walk, decreases = walk.drawn_down(squares, joint.stiffness, least)
        # U is evaluated again with the last q: with a large one the model's readings follow noise.
        if not decreases:
            joint = joint.sharing()
        joint = replace(joint, stiffness=walk.stiffness(squares))
        rounds = rounds + 1
        moving = decreases or moved > MAX_ROUND_CHANGE * noise
    # Fixed λ: hold z as far as cells away from loads agree, then minimise Φ to the tolerance.
    near = walk.near_loads(joint.expected_squares(), joint.data[0].measured.shape[-2:])
    joint = joint.agreeing(np.where(near, ASSUMED.jump**-2, joint.stiffness)).stepped()
    for _ in range(settings.max_iterations):
        if joint.kkt_residual.max() <= settings.tolerance or monotonic() > until:
            break
        previous = joint
        joint = joint.stepped()
        if joint is previous:
            break
    return joint, rounds
