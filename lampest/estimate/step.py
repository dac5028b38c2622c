"""How one frame was solved."""

from dataclasses import dataclass, replace

from lampest.loads.recognition.oral_disc import OralDiscFit
from lampest.panel.panel import Array
from lampest.posterior.linear import LinearModel
from lampest.posterior.track import Bars
from lampest.solvers.solution import Solution


@dataclass(frozen=True, eq=False)
class Step:
    """One solve of a sequence: the last of its frames is the frame's estimate, the first of two the baseline's.

    weights : of the terms. bars : the estimate's error bars, or None; they took `bars_seconds`.
    disc : what the cells follow from, where that is a disc.
    """

    solution: Solution
    seconds: float
    weights: tuple[float, ...]
    bars: Bars | None = None
    bars_seconds: float = 0.0
    disc: OralDiscFit | None = None

    @property
    def cell_resistance(self) -> Array:
        """The frame's cells, (rows, columns) ohm; NaN where the solve failed."""
        cells: Array = self.solution.cell_resistance[-1]
        return cells

    @property
    def status(self) -> str:
        """How the solve ended, a sentence."""
        return self.solution.status.value

    def estimate(self, frame: int) -> Array | None:
        """The cells (rows, columns) ohm of one of its frames; None where the solve failed."""
        return self.solution.cell_resistance[frame] if self.solution.solved else None

    def bare(self) -> "Step":
        """Without what error bars follow from: it holds compiled functions, and much memory."""
        return replace(self, solution=replace(self.solution, at=None, dual=None, kept=None))

    def surroundings(self) -> LinearModel | None:
        """What error bars follow from: a verified optimum; None of anything else."""
        solution = self.solution
        if not solution.optimum or solution.at is None or solution.dual is None:
            return None
        return LinearModel(solution.at, solution.dual)
