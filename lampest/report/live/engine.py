"""Frames in, pictures out: the baseline from the first frames, then always the newest frame, in one solving thread."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Step, Stream
from lampest.files.errors import InputError
from lampest.loads.response import pressure_from_ratio
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import plain
from lampest.report.live.newest import Newest
from lampest.report.live.view import POINTS, Picture, Point, View


@dataclass(frozen=True, eq=False)
class Reading:
    """One frame as it arrives.

    resistance, sigma : (rows, columns) ohm, series resistance taken off; σ may be None.
    time : s, on the recording's axis. arrived : s since 1970-01-01 UTC. lost : frames missing before this one.
    """

    resistance: Array
    sigma: Array | None
    time: float
    arrived: float
    lost: int = 0


@dataclass(frozen=True)
class Source:
    """Where frames come from: the panel, s between frames, and the sentence that holds while they come."""

    panel: Panel
    period: float
    state: str


class Engine:
    """Takes frames from one thread, solves the newest in another, and keeps what is to be shown in `shown`.

    One thread solves, because a CasADi solver must not be shared between threads.
    """

    def __init__(self, name: str, method: str, estimator: Estimator, baseline: int) -> None:
        self.shown = Newest(View(name, method, "starting"))
        self._estimator = estimator
        self._baseline = baseline
        self._unloaded: list[Reading] = []
        self._arrivals: Newest[Reading | None] = Newest(None)
        self._pool = ThreadPoolExecutor(1, "lampest-solver")
        self._solving: Future[None] | None = None

    def __enter__(self) -> "Engine":
        return self

    def __exit__(self, *error: object) -> None:
        self._arrivals.close()
        self._pool.shutdown()

    def finish(self) -> None:
        """Solve the frame that waits; no other may come. Raises what stopped the solver."""
        self._arrivals.close()
        self._pool.shutdown()
        if self._solving is not None:
            self._solving.result()

    def say(self, sentence: str) -> None:
        """Show a state of the port or the recording."""
        self.shown.change(lambda view: replace(view, state=sentence))

    def begin(self, source: Source, resting: Array, resting_sigma: Array | None) -> None:
        """Start solving against a baseline (rows, columns) ohm, series resistance taken off.

        Raises InputError where a reading of it does not exceed the series resistance.
        """
        if not above_series(resting):
            row, column = np.argwhere(~(resting > 0))[0]
            raise InputError(
                f"the unloaded panel reads {resting[row, column]:.4g} ohm at row {row}, column {column} once the "
                f"scene's series resistance is taken off; check series_resistance_ohm and measured_across"
            )
        self.shown.change(lambda view: replace(view, panel=source.panel, state=source.state))
        self._solving = self._pool.submit(self._solve, source, resting, resting_sigma)

    def take(self, source: Source, reading: Reading) -> None:
        """A frame has come. Never waits for the solver; raises what stopped it."""
        if self._solving is not None and self._solving.done():
            self._solving.result()
        self.shown.change(lambda view: replace(view, frames=view.frames + 1, lost=view.lost + reading.lost))
        if self._solving is not None:
            self._arrivals.put(reading)
            if self.shown.thing.state != source.state:
                self.say(source.state)
            return
        self._unloaded.append(reading)
        self.say(f"baseline: {len(self._unloaded)} of {self._baseline} unloaded frames; keep the panel free")
        if len(self._unloaded) == self._baseline:
            self.begin(source, *mean_reading(self._unloaded))

    def _solve(self, source: Source, resting: Array, resting_sigma: Array | None) -> None:
        """Solve the newest frame again and again until nothing more will come."""
        # Nobody sees error bars here, but terms may need them.
        estimator = replace(self._estimator, error_bars=self._estimator.weighs_previous)
        stream = Stream.begin(estimator, Scene(source.panel), source.period, plain(resting, resting_sigma))
        seen = 0
        while (news := self._arrivals.after(seen)) is not None:
            assert news.thing is not None
            skipped, seen = news.number - seen - 1, news.number
            stream, picture = solved(stream, news.thing, len(self._unloaded) + seen, skipped)
            self.shown.change(partial(with_picture, picture=picture))


def mean_reading(readings: list[Reading]) -> tuple[Array, Array | None]:
    """Mean resistance and its σ, (rows, columns) ohm; None where a σ is unknown."""
    resistance = np.mean([reading.resistance for reading in readings], axis=0)
    known = [reading.sigma for reading in readings if reading.sigma is not None]
    sigma = np.sqrt(np.sum(np.square(known), axis=0)) / len(readings) if len(known) == len(readings) else None
    return resistance, sigma


def above_series(resistance: Array) -> bool:
    """Whether every reading leaves something once the series resistance is taken off."""
    return bool(np.all(np.isfinite(resistance) & (resistance > 0)))


def solved(stream: Stream, reading: Reading, number: int, skipped: int) -> tuple[Stream, Picture]:
    """Solve one frame; where that cannot be, the picture holds NaN and says why, and the stream stays as it was."""
    measured = 100 * (reading.resistance / stream.resting.resistance - 1)
    nothing = np.full(stream.panel.shape, np.nan)
    picture = Picture(
        number,
        reading.time,
        reading.arrived,
        measured,
        nothing,
        np.zeros(stream.panel.shape, dtype=bool),
        float("nan"),
        "a reading does not exceed the series resistance",
        0.0,
        skipped,
    )
    if not above_series(reading.resistance):
        return stream, picture
    try:
        stream, step = stream.push(plain(reading.resistance, reading.sigma))
    except InputError as error:
        return stream, replace(picture, status=str(error))
    return stream, with_step(picture, stream, step)


def with_step(picture: Picture, stream: Stream, step: Step) -> Picture:
    """The picture with what the solver found."""
    solution, baseline = step.solution, stream.baseline_resistance
    picture = replace(picture, status=solution.status.value, seconds=step.seconds)
    if not solution.solved:
        return picture
    if np.isnan(baseline).any():
        assert stream.baseline is not None
        return replace(picture, status=f"no baseline: {stream.baseline.solution.status.value}")
    ratio = solution.cell_resistance[-1] / baseline
    return replace(
        picture,
        relative_change=100 * (ratio - 1),
        open_cell=solution.open_cell[-1],
        total=total_pressure(ratio, stream.panel.pitch_mm),
    )


def total_pressure(ratio: Array, pitch_mm: float) -> float:
    """F = Σ p(r/r0)·pitch², newton: kPa · mm² = mN; suction counts as negative."""
    return float(np.sum(pressure_from_ratio(ratio)) * pitch_mm**2 * 1e-3)


def with_picture(view: View, picture: Picture) -> View:
    """The view with a new picture, its total added to the history."""
    point = Point(picture.number, picture.time, picture.total)
    return replace(
        view, picture=picture, skipped=view.skipped + picture.skipped, history=(*view.history, point)[-POINTS:]
    )
