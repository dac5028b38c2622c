"""Frames as they come: each solved after the last, with the baseline where the method asks for that."""

from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.contacts import with_contacts
from lampest.estimate.estimator import Estimator
from lampest.estimate.far_off import far_off
from lampest.estimate.noise.seen import NoiseSeen
from lampest.estimate.step import Step
from lampest.estimate.weights import with_chosen_weights
from lampest.files.errors import InputError, in_words
from lampest.files.interrupts import delayed_interrupt, ended_where_hung
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.systematic import Shared
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.track import Track
from lampest.recording.readings import Readings, mean_change
from lampest.solvers.solution import Status, blank
from lampest.solvers.starts import BROKEN

UNKNOWN = 10.0  # standard deviation of log r0 where nothing is known of it
STRONGER = 1.1  # times the change at which weights were chosen before: a load that settles does not choose them again


@dataclass(frozen=True, eq=False)
class Stream:
    """Where a sequence of frames stands. Pushing a frame gives the next stream and how the frame was solved.

    The cells are those of a recording with the same frames: files and boards come in by this door, too.

    >>> import numpy as np
    >>> import lampest
    >>> scene = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    >>> frames = np.full((3, 3, 4), 640.0)  # ohm as the divider gives it; each is measured when it comes
    >>> frames[2, 1, 2] = 560.0
    >>> resting = lampest.Readings.of(scene, frames[:2]).mean()  # of the unloaded panel
    >>> estimator = lampest.Estimator((lampest.Misfit(),), formulation="reduced")
    >>> stream = lampest.Stream.begin(estimator, scene, 0.1, resting)
    >>> stream.baseline_resistance.round()[1]
    array([1000., 1000., 1000., 1000.])
    >>> for frame in frames[2:]:
    ...     stream, step = stream.push(lampest.Readings.of(scene, frame))
    ...     print(step.status, step.cell_resistance.round()[1])
    optimum verified [1033. 1033.  700. 1033.]

    Parameters
    ----------
    estimator, scene : the method, and what is measured how. period : s between frames.
    resting : the unloaded readings (rows, columns).
    baseline : how the baseline was solved; None for a relative method until a frame was.
    previous : (rows, columns) ohm, the last estimate, or None. previous_deviation : of its logarithm; None where it
    has no error bars.
    prepared : what the method keeps between frames, or None.
    track : what error bars need of earlier frames; None where there are to be none.
    weights, weighed_at : those that the data chose for the terms, and how far that frame was from rest; None, 0 before.
    hasty : whether frames take the weights that there are, and the minimum nearest to the frame before, without search
    for lower ones; what that leaves open is told by `due` and `Solution.unsearched`.
    reading_error : of the logarithm of each reading, the same in all frames, as the frames or else the scene told.
    frame_noise : what readings of a frame share by chance, as the frames told, or None.
    """

    estimator: Estimator
    scene: Scene
    period: float
    resting: Readings
    baseline: Step | None = None
    previous: Array | None = None
    previous_deviation: Array | None = None
    prepared: Any = None
    track: Track | None = None
    weights: tuple[float, ...] | None = None
    weighed_at: float = 0.0
    hasty: bool = False
    reading_error: float = 0.0
    frame_noise: FrameNoise | None = None

    @classmethod
    def begin(
        cls, estimator: Estimator, scene: Scene, period: float, resting: Readings, noise: NoiseSeen | None = None
    ) -> "Stream":
        """Before the first frame; an absolute method solves its baseline now. noise : what frames told of it.

        Raises InputError where the noise is needed and unknown, bounds leave no room, the formulation cannot serve the
        scene's readout, or the readings are no frame of the panel.
        """
        estimator.check(scene)
        _check_frame(resting, scene)
        track = None
        if estimator.barred(resting):
            track = (
                Track(Shared.of(scene))
                if noise is None
                else Track(Shared.of(scene, None, noise.hidden), noise=noise.frame)
            )
        sizes = scene.told_systematic if noise is None or noise.hidden is None else noise.hidden.sizes
        own = 0.0 if sizes is None else sizes.reading_error or 0.0
        shared = None if noise is None else noise.frame
        begun = cls(estimator, scene, period, resting, track=track, reading_error=own, frame_noise=shared)
        return begun._rested()

    def tared(self, resting: Readings) -> "Stream":
        """The stream against another unloaded panel from here on; frames before are forgotten, but for their weights.

        resting : the mean of frames in which nothing touched the panel. Raises InputError as `begin`.
        """
        _check_frame(resting, self.scene)
        track = None if self.track is None else Track(self.track.shared, noise=self.track.noise)
        return replace(
            self, resting=resting, track=track, baseline=None, previous=None, previous_deviation=None, prepared=None
        )._rested()

    def _rested(self) -> "Stream":
        """With its baseline, where that is solved alone."""
        if not self.resting.enough(self.scene):
            return replace(self, baseline=self.unsolved(Status.UNRESTED))
        return self if self.estimator.joint_start else self.estimator.method.begin(self)

    def push(self, readings: Readings) -> tuple["Stream", Step]:
        """Solve one frame's readings (rows, columns); a failed one leaves the stream as it was.

        So does one of which too little was read (see `Readings.enough`). Raises InputError as `begin`.
        """
        _check_frame(readings, self.scene)
        if not readings.enough(self.scene):
            return self, self.unsolved(Status.UNREAD)
        if self.estimator.method.compares(self.estimator.terms) and not self.resting.enough(self.scene):
            return self, self.unsolved(Status.UNRESTED)
        return self._pushed_with_weights(readings) if self._chooses else self.estimator.method.push(self, readings)

    def _pushed_with_weights(self, readings: Readings) -> tuple["Stream", Step]:
        """As `push`, weights chosen anew by frames that differ from rest by a tenth more than any before them.

        A recording's weight comes from its strongest frame; of a stream nobody knows yet which that will be.
        """
        if self.weights is not None and (self.hasty or not self.due(readings)):
            stream = replace(self, estimator=self.estimator.with_weights(self.weights))
            stream, step = self.estimator.method.push(stream, readings)
            return replace(stream, estimator=self.estimator), step
        stream, step = self.estimator.method.push(self, readings)
        if not step.solution.solved:
            return stream, step
        return replace(stream, weights=step.weights, weighed_at=self._change(readings)), step

    def due(self, readings: Readings) -> bool:
        """Whether weights that the data of the strongest frame choose are to be chosen anew by a frame."""
        return self._chooses and self._change(readings) > STRONGER * self.weighed_at

    @property
    def _chooses(self) -> bool:
        return self.estimator.automatic and self.estimator.auto_weight.per == "recording"

    def _change(self, readings: Readings) -> float:
        """How far a frame is from rest."""
        return mean_change(readings.plain_values, self.resting.value)

    def unsolved(self, status: Status) -> Step:
        """A step that was not even tried; for methods."""
        terms = self.estimator.terms
        weights = tuple(float("nan") if term.weight == "auto" else float(term.weight) for term in terms)
        return Step(blank((1, *self.scene.panel.shape), len(terms), status), 0.0, weights)

    def after_baseline(self) -> "Stream":
        """The stream after a baseline that is solved alone; for methods."""
        alone = self.without_comparisons() if self.estimator.weighs_previous else self
        baseline = alone.solve(*alone.given(self.resting))
        settled, baseline = with_contacts(alone, self.resting, baseline)
        stream = replace(self, scene=settled.scene, track=settled.track)
        with suppress(*BROKEN):
            model = baseline.surroundings()
            if stream.track is not None and model is not None:
                track = stream.track.resting(model, remembered=self.estimator.relative)
                if track.baseline is not None and self.resting.partial:
                    track = replace(track, baseline=track.baseline.bent(*far_off(alone, self.resting, baseline)))
                stream = replace(stream, track=track, previous_deviation=track.deviation)
        return stream.with_baseline(baseline)

    def after_frame(self, readings: Readings) -> tuple["Stream", Step]:
        """The stream after a frame's readings (rows, columns), and how they were solved; for methods."""
        data, start = self.given(readings)
        step, stream = self.solve(data, start), self
        if len(data.measured) == 2:
            stream, step = with_contacts(self, readings, step)
        found = step.estimate(-1)
        track, step = stream._barred(step, readings)
        prepared = self.estimator.method.kept(step.solution, self.prepared)
        step = step.bare()
        return replace(
            stream,
            baseline=step if len(data.measured) == 2 else self.baseline,
            previous=self.previous if found is None else found,
            previous_deviation=self.previous_deviation if found is None else _deviation(track, step),
            prepared=prepared,
            track=track,
        ), step

    def with_baseline(self, baseline: Step) -> "Stream":
        """The stream that goes on from a solved baseline."""
        return replace(self, baseline=baseline, previous=baseline.estimate(0))

    @property
    def background(self) -> Background:
        """What stands behind a frame of which nothing earlier is known."""
        return Background(self.scene, self.period)

    def _barred(self, step: Step, readings: Readings) -> tuple[Track | None, Step]:
        """The step that was solved from readings with error bars, where they are wanted and can be had."""
        if self.track is None or (model := step.surroundings()) is None:
            return self.track, step
        begin = perf_counter()
        with suppress(*BROKEN):
            track, bars = self.track.advanced(model)
            if readings.partial:
                below, above = far_off(self, readings, step)
                if track.bend is not None:
                    below, above = np.maximum(below, track.bend[0]), np.maximum(above, track.bend[1])
                elif len(step.solution.cell_resistance) == 2 and self.resting.missing(self.scene).any():
                    track = replace(track, bend=(below, above))
                bars = bars.bent(below, above)
            return track, replace(step, bars=bars, bars_seconds=perf_counter() - begin)
        return self.track, step

    def given(self, readings: Readings) -> tuple[Data, Array | None]:
        """What the solve of a frame is given, with the baseline where both are solved jointly, and where it may start.

        The joint pair: paper, equations (15) and (21).
        """
        if self.estimator.joint_start and (self.baseline is None or not self.baseline.solution.solved):
            return self.estimator.data(self.resting.together(readings), self.background), None
        known = resting = None
        if self.estimator.relative:
            guess = self.estimator.method.guess(self.scene.circuit, readings.value)
            known = guess if self.previous is None else self.previous
            resting = None if self.baseline is None else self.baseline.estimate(0)
        behind = replace(self.background, previous=known, baseline=resting, previous_deviation=self._known_deviation())
        data = self.estimator.data(readings.alone(), behind)
        if self.estimator.weighs_previous and known is not None:
            step = data.readout.common_step(data.measured[0], data.network(0, known).reading(), data.plain[0])
            data = self.estimator.data(readings.alone(), replace(behind, previous=known * step))
        return data, None if self.previous is None else self.previous[None]

    def _known_deviation(self) -> Array | None:
        """Of log r0, for terms that read it; an open cell, and one without error bars, is not known at all."""
        if not self.estimator.weighs_previous:
            return None
        if self.previous is None or self.previous_deviation is None:
            return np.full(self.scene.panel.shape, UNKNOWN)
        return np.fmin(self.previous_deviation, UNKNOWN)

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved."""
        found = None if self.baseline is None else self.baseline.estimate(0)
        return np.full(self.scene.panel.shape, np.nan) if found is None else found

    def solve(self, data: Data, previous: Array | None) -> Step:
        """One solve, with the weights that are left to the data; for methods."""
        with nullcontext() if self.estimator.method.delays and not self.estimator.automatic else delayed_interrupt():
            begin = perf_counter()
            estimator = self.estimator
            limit, data = estimator.solver.time_limit_s, replace(data, hasty=True) if self.hasty else data
            if estimator.automatic:
                noisy = self.resting.sigma is not None
                estimator = with_chosen_weights(estimator, self.scene, data.limited(limit), previous, noisy)
            choice = perf_counter() - begin
            solver = estimator.problem(self.scene, len(data.measured), self.period, data.partial)
            estimator.method.prepare(solver, data, previous)
            begin = perf_counter()
            with ended_where_hung(limit):
                solution = estimator.method.solution(solver, data.limited(limit), previous, self.prepared)
            weights = tuple(float(weight) for weight in solver.cost.weights)
            return Step(solution, choice + perf_counter() - begin, weights)

    def without_comparisons(self) -> "Stream":
        """The stream without the terms that compare with an earlier frame."""
        return replace(self, estimator=replace(self.estimator, terms=self.estimator.absolute_terms))


def _check_frame(readings: Readings, scene: Scene) -> None:
    """Raise InputError unless these are the readings of one frame."""
    if not isinstance(readings, Readings):
        raise InputError(f"a stream takes Readings.of(scene, values), not {in_words(readings)}")
    if readings.value.shape != scene.panel.shape:
        held, wanted = (" × ".join(map(str, shape)) for shape in (readings.value.shape, scene.panel.shape))
        raise InputError(
            f"a stream takes one frame of {wanted} readings, not {held}; of several, take one or their mean()"
        )


def _deviation(track: Track | None, step: Step) -> Array | None:
    return None if track is None or step.bars is None else track.deviation
