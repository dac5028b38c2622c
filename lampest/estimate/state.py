"""State of a sequence between frames, the solve of a frame, and its witness.

The witness is a second solve of the frame by IPOPT on the nodal program, from another start. It
sees the data of the frame and nothing of the first solve: neither its cells nor its carried state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.weights import Objective
from lampest.files.errors import brief
from lampest.files.levels import Witness
from lampest.files.typed import ReadOnlyArrays
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.linear import LinearModel
from lampest.posterior.track import Bars, Track
from lampest.recording.readings import Readings
from lampest.solvers.multistart import evaluated, scattered, solved_from
from lampest.solvers.solution import Settings, Solution, Status, blank

if TYPE_CHECKING:
    from lampest.inference.circuits.alike import PanelChoice
    from lampest.posterior.frame_noise import FrameNoise
    from lampest.posterior.sparse_prior import Held

SAME_COST = 1e-6  # relative difference of costs below which two optima are one


@dataclass(frozen=True)
class Verification:
    """Comparison of an estimate with that of the witness.

    Attributes
    ----------
    witness : Witness
    difference : float
        Largest difference of ln r between both; NaN where the witness has no optimum.
    decrease : float
        Decrease of the cost relative to the first solve; 0 unless the witness is lower.
    """

    witness: Witness
    difference: float = float("nan")
    decrease: float = 0.0


def testimony(cost: Cost, data: Data, previous: Array | None, settings: Settings) -> Solution:
    """Return the solution of IPOPT on the nodal program, from another start.

    The start differs from that of the first solve.

    Parameters
    ----------
    cost : Cost
    data : Data
    previous : array, shape (frames, rows, columns), or None
        Start of the first solve, ohm; None where it began at equal cells.
    settings : Settings
    """
    from lampest.solvers.by_ipopt import Ipopt

    solver = Ipopt(cost, settings, data.readout, data.wiring, "nodal")
    with np.errstate(all="ignore"):
        start = another_start(cost, data, previous)
        return replace(solved_from(solver, start), solver=solver.name)


def another_start(cost: Cost, data: Data, previous: Array | None) -> Evaluation:
    """Return a start that the first solve did not have.

    The start has equal cells, or scattered ones after a start at equal cells. Where two panels read
    alike, the equal cells lie on the branch of the first start.
    """
    if previous is None:
        return evaluated(cost, data, next(scattered(data)))
    equal = evaluated(cost, data, data.uniform_start)
    if np.array_equal(equal.branch, evaluated(cost, data, previous).branch):
        return equal
    return evaluated(cost, data, np.median(previous, axis=(-2, -1), keepdims=True))


def compared(solution: Solution, witness: Solution) -> Verification:
    """Return the comparison of a solution with that of the witness."""
    if not witness.optimum:
        return Verification(Witness.FAILED)
    if not solution.optimum:
        return Verification(Witness.LOWER)
    difference = float(np.abs(np.log(solution.cell_resistance / witness.cell_resistance)).max())
    negligible = 0.0 if witness.at is None else SAME_COST * witness.at.cost_scale
    scale = max(abs(solution.objective), negligible)
    change = (witness.objective - solution.objective) / scale
    if abs(change) <= SAME_COST:
        return Verification(Witness.SAME, difference)
    return Verification(
        Witness.HIGHER if change > 0 else Witness.LOWER, difference, max(-change, 0.0)
    )


@dataclass(frozen=True, eq=False)
class Step:
    """One solve of a sequence, of one frame, or of the baseline and the first frame jointly.

    Attributes
    ----------
    solution : Solution
        Its last frame is the estimate; the first of two is the baseline.
    seconds : float
        Wall time of the solve, s.
    weights : tuple of float
        Weights of the terms.
    bars : Bars or None
        Error bars of the estimate.
    bars_seconds : float
        Wall time of the error bars, s.
    sentence : str
        Status of an image of modules; else ''.
    weight_sigma : tuple of float
        Standard deviations of ln λ, see `Objective`.
    verification : Verification or None
        Comparison with a second solve by IPOPT; None where none was requested.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> step = estimate.steps[0]
    >>> step.cell_resistance.shape, step.status
    ((2, 3), 'local optimum verified')
    """

    solution: Solution
    seconds: float
    weights: tuple[float, ...]
    bars: Bars | None = None
    bars_seconds: float = 0.0
    sentence: str = ""
    weight_sigma: tuple[float, ...] = ()
    verification: "Verification | None" = None

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    @property
    def cell_resistance(self) -> Array:
        """Cells of the frame, (rows, columns) ohm; NaN where the solve failed."""
        cells: Array = self.solution.cell_resistance[-1]
        return cells

    @property
    def status(self) -> str:
        """Outcome of the solve, in a sentence."""
        return self.sentence or self.solution.status.value

    def estimate(self, frame: int) -> Array | None:
        """Return the cells (rows, columns) ohm of a frame, or None if the solve failed."""
        return self.solution.cell_resistance[frame] if self.solution.solved else None

    def bare(self) -> "Step":
        """Return the step without the parts from which error bars are computed.

        The omitted parts take much memory.
        """
        return replace(self, solution=replace(self.solution, at=None, dual=None, carried=None))

    def surroundings(self) -> LinearModel | None:
        """Return the linear model at a verified optimum, for error bars, or None."""
        at = self.solution.at
        dual = self.solution.dual
        if not self.solution.optimum or at is None or dual is None:
            return None
        return LinearModel(at, dual, weight_sigma=self.weight_sigma)


def held_by_all(steps: Sequence[Step]) -> "Held | None":
    """Return what absolute losses hold in all of these steps; None where none is known."""
    held = [step.bars.held for step in steps if step.bars is not None and step.bars.held]
    return held[0].together(held) if held else None


@dataclass(frozen=True, eq=False)
class SequenceState(ReadOnlyArrays):
    """State of a sequence of frames.

    Attributes
    ----------
    estimator : Objective
        Terms, bounds and settings.
    scene : Scene
    period : float
        Time between frames, s.
    resting : Readings
        The unloaded readings (rows, columns).
    baseline : Step or None
        Solve of the baseline; None before it is solved.
    previous : array, shape (rows, columns), or None
        Last estimate, ohm.
    prepared : object
        Data that the method keeps between frames, or None.
    track : Track or None
        Data of earlier frames for error bars; None where none are computed.
    first : bool
        Whether no measured frame was solved yet.
    frame_noise : FrameNoise or None
        Random errors that the readings of a frame share.
    panels : PanelChoice or None
        Panels of two of the frames, where several give their readings.
    """

    estimator: Objective
    scene: Scene
    period: float
    resting: Readings
    baseline: Step | None = None
    previous: Array | None = None
    prepared: Any = None
    track: Track | None = None
    first: bool = True
    frame_noise: "FrameNoise | None" = None
    panels: "PanelChoice | None" = None

    @property
    def background(self) -> Background:
        """The background of a frame without knowledge of earlier frames."""
        return Background(self.scene)

    @property
    def baseline_resistance(self) -> Array:
        """Cells of the baseline, (rows, columns) ohm; NaN where it is not solved."""
        cells = None if self.baseline is None else self.baseline.estimate(0)
        return np.full(self.scene.panel.shape, np.nan) if cells is None else cells

    @property
    def rested(self) -> bool:
        """Whether the baseline is solved."""
        return self.baseline is not None and self.baseline.solution.solved

    def without_comparisons(self) -> Self:
        """Return the state without the terms that compare with an earlier frame."""
        return replace(self, estimator=self.estimator.with_terms(self.estimator.absolute_terms))

    def unsolved(self, status: Status) -> Step:
        """Return the step of a frame that was not solved, with this status."""
        terms = self.estimator.terms
        weights = tuple(
            float("nan") if term.weight == "auto" else float(term.weight) for term in terms
        )
        return Step(blank((1, *self.scene.panel.shape), len(terms), status), 0.0, weights)


AnyState = TypeVar("AnyState", bound=SequenceState)
