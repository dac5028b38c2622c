"""One set of scenes that stands beside the paper: its recordings, and what the five methods make of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.compare import Steps, compare, spread
from lampest.report.plots.contours import percent_change
from lampest.report.plots.plot import furthest
from lampest.runs.results import Results

MEASURED = "measured"
EVALUATION_S = 16.45 / 10_100  # table I: LSM's 16.45 ± 0.40 s are its limit of 10,000 evaluations and one derivative
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class LoadSeen:
    """What was measured of one load: relative change in percent, (rows, columns); felt : (lowest, highest) kPa."""

    panel: Panel
    change: Array
    felt: tuple[float, float]

    @classmethod
    def of(cls, recording: Recording) -> "LoadSeen":
        """The frame in which cells have moved furthest; of a simulated recording."""
        frame = int(recording.measured_frames()[furthest_frame(recording)])
        assert recording.truth_pressure is not None
        felt = recording.truth_pressure[frame]
        change = percent_change(recording.recorded[frame], unloaded(recording))
        return cls(recording.scene.panel, change, (float(felt.min()), float(felt.max())))


class StepsSeen(NamedTuple):
    """Of some steps: mean and standard deviation of the data error in percent, mean time in s."""

    error: float
    error_sd: float
    time: float


@dataclass(frozen=True)
class Weights:
    """λ of absolute penalties (resistances in ohm), of relative ones (changes in percent), and the start over R_m."""

    absolute: float = 1e-3
    relative: float = 10.0
    start: float = 1.0


@dataclass(frozen=True, eq=False)
class LeftBySolver:
    """What one method leaves of a recording.

    baseline : (rows, columns) ohm. cells, model, measured : (frames, rows, columns) ohm. evaluations : (frames) solves
    of the forward problem that MATLAB would have needed, derivatives included. why : (frames) what ended it.
    joint : whether the first frame was solved together with the baseline.
    """

    baseline: Array
    cells: Array
    model: Array
    measured: Array
    evaluations: NDArray[np.int64]
    why: tuple[str, ...]
    joint: bool

    @property
    def change(self) -> Array:
        """100·(r/r₀ − 1), (frames, rows, columns) percent."""
        return np.asarray(100 * (self.cells / self.baseline - 1))

    @property
    def data_error(self) -> Array:
        """100·|f(r) − R_m|/R_m, (frames, rows, columns) percent."""
        return np.asarray(100 * np.abs(self.model - self.measured) / self.measured)


@dataclass(frozen=True, eq=False)
class Side(ABC):
    """What is drawn and held against the paper.

    name, word, about : for the page, for files, a sentence. mouths : the large and the small one.
    loads : letter of figure 6 → what was seen. first : whether the first frame is shown, else the strongest one.
    """

    name: str
    word: str
    about: str
    mouths: tuple[Recording, Recording]
    loads: Mapping[str, LoadSeen]
    first: bool

    @property
    def panel(self) -> Panel:
        """Of all its recordings."""
        return self.mouths[0].scene.panel

    def shown(self, number: int) -> int:
        """Which measured frame of the large (0) or the small (1) mouth is shown."""
        return 0 if self.first else furthest_frame(self.mouths[number])

    def change(self, method: str, number: int = 0) -> Array:
        """Relative change in percent of the shown frame, (rows, columns): by a method, or as measured.

        As the paper does, what is measured keeps its series resistance.
        """
        if method != MEASURED:
            return np.asarray(self.estimated(method, number)[self.shown(number)])
        recording = self.mouths[number]
        frame = recording.recorded[recording.measured_frames()[self.shown(number)]]
        return percent_change(frame, unloaded(recording))

    @abstractmethod
    def estimated(self, method: str, number: int) -> Array:
        """Relative change in percent, (frames, rows, columns)."""

    @abstractmethod
    def steps(self, method: str, steps: Steps) -> StepsSeen:
        """Of the large mouth; NaN where there are no such steps."""


@dataclass(frozen=True, eq=False)
class OptimalSide(Side):
    """Verified optima, from a results file with a case of every method."""

    results: Results

    def estimated(self, method: str, number: int) -> Array:
        """As the results have it. Raises InputError where they lack the method."""
        for case in self.results.of(self.mouths[number].name):
            if case.estimator == method:
                return np.asarray(case.relative_change)
        raise InputError(f"{self.name}: there are no results of {method}")

    def steps(self, method: str, steps: Steps) -> StepsSeen:
        """As `lampest compare` has them."""
        for row in compare(self.results):
            if (row.recording, row.estimator, row.steps) == (self.mouths[0].name, method, steps) and row.data_error:
                time = NAN if row.solve_time is None else row.solve_time.mean
                return StepsSeen(row.data_error.mean, row.data_error.sd or NAN, time)
        return StepsSeen(NAN, NAN, NAN)


@dataclass(frozen=True, eq=False)
class SolverSide(Side):
    """What the paper's solver leaves. solve : (method, recording) → that; asked once for each."""

    solve: Callable[[str, Recording], LeftBySolver]
    methods: Sequence[str]
    mouth_method: str

    @cached_property
    def left(self) -> Mapping[tuple[str, int], LeftBySolver]:
        """Every method on the large mouth, one on the small one."""
        asked = [*((method, 0) for method in self.methods), (self.mouth_method, 1)]
        return {(method, number): self.solve(method, self.mouths[number]) for method, number in asked}

    def estimated(self, method: str, number: int) -> Array:
        """As the solver left it."""
        return self.left[method, number].change

    def steps(self, method: str, steps: Steps) -> StepsSeen:
        """Times are evaluations, at what one of them took the paper."""
        left = self.left[method, 0]
        parts = {"initial": slice(1), "following": slice(1, None)} if left.joint else {"all": slice(None)}
        if steps not in parts:
            return StepsSeen(NAN, NAN, NAN)
        error = spread(left.data_error[parts[steps]])
        time = EVALUATION_S * float(left.evaluations[parts[steps]].mean())
        return StepsSeen(NAN, NAN, time) if error is None else StepsSeen(error.mean, error.sd or NAN, time)


def unloaded(recording: Recording) -> Array:
    """The mean of the unloaded frames as recorded, (rows, columns) ohm."""
    return np.asarray(recording.recorded[recording.role == UNLOADED].mean(axis=0))


def furthest_frame(recording: Recording) -> int:
    """Of the measured frames the one whose cells have moved furthest."""
    readings = Readings.of(recording.scene, recording.recorded, recording.sigma)
    resting = readings[recording.role == UNLOADED].mean().value
    return furthest(readings.value[recording.measured_frames()], resting)
