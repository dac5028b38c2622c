"""State that a frame leaves for the next one, and the step that a method makes of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from lampest.cost.given import Background
from lampest.estimate.objective import Objective
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.dense import DenseMemory
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SampledMemory
from lampest.posterior.track import Bars, Track
from lampest.recording.readings import Readings
from lampest.solvers.solution import Solution, Status, blank

NO_DUAL = np.zeros(0)  # of a cost without absolute losses
UNKNOWN_SD = 10.0  # standard deviation of log r0 where nothing is known of it


@dataclass(frozen=True, eq=False)
class Step:
    """One solve of a sequence: the last of its frames is the frame's estimate, the first of two the baseline's.

    Attributes
    ----------
    weights : tuple of float
        Of the terms.
    weight_sigma : tuple of float
        As `Objective` has it.
    bars : Bars or None
        The estimate's error bars, or None; they took `bars_seconds`.
    sentence : str
        The status of an image of modules; else ''.

    >>> step = found.steps[0]
    >>> step.cell_resistance.shape, step.status
    ((2, 3), 'optimum verified')
    """

    solution: Solution
    seconds: float
    weights: tuple[float, ...]
    bars: Bars | None = None
    bars_seconds: float = 0.0
    sentence: str = ""
    weight_sigma: tuple[float, ...] = ()

    @property
    def cell_resistance(self) -> Array:
        """The frame's cells, (rows, columns) ohm; NaN where the solve failed."""
        cells: Array = self.solution.cell_resistance[-1]
        return cells

    @property
    def status(self) -> str:
        """End of the solve, a sentence."""
        return self.sentence or self.solution.status.value

    def estimate(self, frame: int) -> Array | None:
        """Return the cells (rows, columns) ohm of one of its frames; None where the solve failed."""
        return self.solution.cell_resistance[frame] if self.solution.solved else None

    def bare(self) -> "Step":
        """Return the step without the parts that error bars follow from: compiled functions, and much memory."""
        return replace(self, solution=replace(self.solution, at=None, dual=None, preconditioner=None))

    def surroundings(self) -> LinearModel | None:
        """Return what error bars follow from: a verified optimum; None of anything else."""
        at, dual = self.solution.at, self.solution.dual
        if not self.solution.optimum or at is None or dual is None:
            return None
        return LinearModel(at, dual, weight_sigma=self.weight_sigma)


@dataclass(frozen=True, eq=False)
class SequenceState:
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
        How the baseline was solved; None for a relative method until a frame was.
    previous : array, shape (rows, columns), or None
        Last estimate, ohm.
    previous_deviation : array or None
        Of its logarithm; None where it has no error bars.
    prepared : object
        What the method keeps between frames, or None.
    track : Track or None
        What error bars need of earlier frames; None where there are to be none.
    keeps_weights : bool
        Whether frames take the weights that there are, though others would be chosen.
    first : bool
        Whether no frame but the baseline was solved yet.
    reading_error : float
        Of the logarithm of each reading, the same in all frames.
    frame_noise : FrameNoise or None
        What readings of a frame share by chance, or None.
    """

    estimator: Objective
    scene: Scene
    period: float
    resting: Readings
    baseline: Step | None = None
    previous: Array | None = None
    previous_deviation: Array | None = None
    prepared: Any = None
    track: Track | None = None
    keeps_weights: bool = False
    first: bool = True
    reading_error: float = 0.0
    frame_noise: FrameNoise | None = None

    @property
    def background(self) -> Background:
        """The surroundings of a frame of which nothing earlier is known."""
        return Background(self.scene, self.period)

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved."""
        cells = None if self.baseline is None else self.baseline.estimate(0)
        return np.full(self.scene.panel.shape, np.nan) if cells is None else cells

    @property
    def rested(self) -> bool:
        """Whether the baseline is solved."""
        return self.baseline is not None and self.baseline.solution.solved

    def with_baseline(self, baseline: Step) -> Self:
        """Return the state after a solved baseline."""
        return replace(self, baseline=baseline, previous=baseline.estimate(0))

    def without_comparisons(self) -> Self:
        """Return the state without the terms that compare with an earlier frame."""
        return replace(self, estimator=self.estimator.with_terms(self.estimator.absolute_terms))

    @property
    def parts(self) -> "tuple[SequenceState | None, ...]":
        """State of each module of a panel, None of a dead one; () of a single network."""
        return ()

    def with_parts(self, parts: "tuple[SequenceState | None, ...]") -> Self:
        """Return the state with others in their place."""
        return self

    def unsolved(self, status: Status) -> Step:
        """Return a step that was not even tried."""
        terms = self.estimator.terms
        weights = tuple(float("nan") if term.weight == "auto" else float(term.weight) for term in terms)
        return Step(blank((1, *self.scene.panel.shape), len(terms), status), 0.0, weights)


S = TypeVar("S", bound=SequenceState)


@dataclass(frozen=True, eq=False)
class CarriedOver:
    """Arrays by name of a state after some frames, as they are written between two parts of a long recording.

    The beginning of a state is no part of it.
    """

    arrays: Mapping[str, Array]

    @classmethod
    def of(cls, state: SequenceState) -> "CarriedOver":
        """Return the last estimate, its deviation and the memory of error bars, of each module where there are any."""
        arrays: dict[str, Any] = {}
        for number, part in enumerate(state.parts):
            carried = {} if part is None else cls.of(part).arrays
            arrays |= {_of_module(number) + name: values for name, values in carried.items()}
        if not state.parts:
            arrays = {"previous": state.previous, "previous_deviation": state.previous_deviation}
            if (track := state.track) is not None:
                arrays["deviation"] = track.deviation
                for name in ("answers", "beyond"):
                    arrays |= {f"{name}_{number}": values for number, values in enumerate(getattr(track, name) or ())}
                if (memory := track.memory) is not None:
                    kind = "dense" if isinstance(memory, DenseMemory) else "sampled"
                    arrays |= {f"{kind}_{name}": value for name, value in vars(memory).items()}
        known = {name: value for name, value in arrays.items() if value is not None}
        return cls({name: np.atleast_1d(np.asarray(value, float)) for name, value in known.items()})

    def onto(self, begun: S) -> S:
        """Return the state after those frames.

        begun : the state with its baseline, as its method prepares it.
        """
        if begun.parts:
            parts = enumerate(begun.parts)
            return begun.with_parts(
                tuple(part and CarriedOver(self._under(_of_module(number))).onto(part) for number, part in parts)
            )
        track = begun.track and replace(
            begun.track,
            deviation=self.arrays.get("deviation"),
            memory=self._memory(),
            answers=self._pair("answers"),
            beyond=self._pair("beyond"),
        )
        previous, deviation = self.arrays.get("previous"), self.arrays.get("previous_deviation")
        return replace(begun, previous=previous, previous_deviation=deviation, track=track, first=False)

    def _under(self, prefix: str) -> dict[str, Array]:
        return {name[len(prefix) :]: values for name, values in self.arrays.items() if name.startswith(prefix)}

    def _pair(self, name: str) -> tuple[Array, Array] | None:
        return (self.arrays[f"{name}_0"], self.arrays[f"{name}_1"]) if f"{name}_0" in self.arrays else None

    def _memory(self) -> DenseMemory | SampledMemory | None:
        if dense := self._under("dense_"):
            return DenseMemory(**dense)
        sampled = self._under("sampled_")
        return SampledMemory(sampled["last"], sampled["baseline"], int(sampled["frames"][0])) if sampled else None


def _of_module(number: int) -> str:
    """Return the prefix of the names of a module's arrays."""
    return f"module_{number:04d}_"
