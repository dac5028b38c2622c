"""Streams: frames that are solved one by one as they arrive."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.estimator import Estimator
from lampest.estimate.state import SequenceState, Step
from lampest.files.errors import InputError, brief, in_words
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.noise import NoiseEstimate
from lampest.panel.effects import Shared
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.covariance import DenseMemory, Memory
from lampest.posterior.track import Track
from lampest.recording.readings import Readings, mean_change
from lampest.solvers.solution import Status

# Ratio to the change at which weights were last chosen: a load that settles does not trigger
# another choice.
MIN_INCREASE = 1.1
# Of a network: with more, inverse Hessians of a block cost more than they save
# (docs/studies/speed.md).
MAX_BLOCK_CELLS = 400
# Memory of a stream between two parts of a long recording, see `Stream.carried`.
CarriedOver = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Stream(SequenceState):
    """State of a sequence of frames.

    Pushing a frame returns the next stream and the solve of the frame. Files and boards are
    estimated by streams, too, so that the cells of a recording with the same frames are the same.

    >>> import numpy as np
    >>> import lampest
    >>> panel = lampest.Panel(3, 4)
    >>> scene = lampest.Scene(panel, lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    >>> frames = np.full((3, 3, 4), 640.0)  # ohm as the divider gives it; measured when they come
    >>> frames[2, 1, 2] = 560.0
    >>> resting = lampest.Readings.of(scene, frames[:2]).mean()  # of the unloaded panel
    >>> estimator = lampest.Estimator((lampest.Misfit(),), formulation="reduced")
    >>> stream = lampest.Stream.begin(estimator, scene, 0.1, resting)
    >>> stream.baseline_resistance.round()[1]
    array([1000., 1000., 1000., 1000.])
    >>> for frame in frames[2:]:
    ...     stream, step = stream.push(lampest.Readings.of(scene, frame))
    ...     print(step.status, step.cell_resistance.round()[1])
    local optimum verified [1033. 1033.  700. 1033.]

    Attributes
    ----------
    estimator : Estimator
        Terms, and the method.
    weights : tuple of float, or None
        Weights of the terms that the data chose; None before the choice.
    weight_sigma : tuple of float
        Standard deviations of ln λ.
    weighed_at : float
        Change from rest of the frame that chose them.
    keeps_weights : bool
        Whether the present weights are kept even if a frame would choose others.
    joined : bool
        Whether frames are those of several networks, each with a stream of its own.

    All other attributes are those of `SequenceState`.
    """

    estimator: Estimator
    weights: tuple[float, ...] | None = None
    weight_sigma: tuple[float, ...] = ()
    weighed_at: float = 0.0
    keeps_weights: bool = False
    joined: ClassVar[bool] = False

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    @classmethod
    @ONE_BLAS_THREAD
    def begin(
        cls,
        estimator: Estimator,
        scene: Scene,
        period: float,
        resting: Readings,
        noise: NoiseEstimate | None = None,
    ) -> Self:
        """Return the stream before the first frame; an absolute method solves its baseline now.

        Parameters
        ----------
        estimator : Estimator
        scene : Scene
        period : float
            Time between frames, s.
        resting : Readings
            Mean of the unloaded frames, (rows, columns).
        noise : NoiseEstimate, optional
            Noise that was estimated from frames.

        Raises InputError as `unrested`.
        """
        return cls.unrested(estimator, scene, period, resting, noise).with_rest()

    @classmethod
    def unrested(
        cls,
        estimator: Estimator,
        scene: Scene,
        period: float,
        resting: Readings,
        noise: NoiseEstimate | None = None,
    ) -> Self:
        """Return the stream before its baseline is solved; the parameters are those of `begin`.

        Raises InputError where the noise is needed and unknown, bounds leave no room, the
        formulation does not support the scene's readout, or the readings are no frame of the panel.
        """
        estimator.check(scene)
        _check_frame(resting, scene)
        estimator = estimator.in_scene(scene, resting)
        hidden, frame, panels = (
            (None, None, None)
            if noise is None
            else (noise.possible_errors, noise.frame, noise.panels)
        )
        track = None
        if estimator.has_error_bars(resting):
            track = Track(Shared.of(scene, hidden), noise=frame)
        return cls(estimator, scene, period, resting, track=track, frame_noise=frame, panels=panels)

    @ONE_BLAS_THREAD
    def tared(self, resting: Readings) -> Self:
        """Return the stream with another baseline.

        The weights stay, all other memory of earlier frames is dropped.

        Parameters
        ----------
        resting : Readings
            Mean of frames in which nothing touched the panel, (rows, columns).

        Raises InputError as `begin`.
        """
        return self.without_baseline(resting).with_rest()

    def without_baseline(self, resting: Readings) -> Self:
        """Return the stream with these unloaded readings, before its baseline is solved."""
        _check_frame(resting, self.scene)
        track = None if self.track is None else Track(self.track.shared, noise=self.track.noise)
        return replace(
            self, resting=resting, track=track, baseline=None, previous=None, prepared=None
        )

    def with_rest(self) -> Self:
        """Return the stream with its baseline, unless solved together with the first frame."""
        if not self.resting.enough(self.scene):
            return replace(self, baseline=self.unsolved(Status.UNRESTED))
        return self if self.estimator.joint_start else self.estimator.method.begin(self)

    def restarted(self, first: "Stream") -> Self:
        """Return the stream with the solver's caches of `first`.

        Results thus do not depend on earlier frames.
        """
        return replace(self, prepared=first.prepared)

    @property
    def carried(self) -> dict[str, Array]:
        """Memory that the frames of the next part of a long recording need, by name.

        The arrays can be written to a file: the last estimate, its deviation and the memory of
        error bars; of a panel those of each module, with its number before the names. The initial
        stream, with scene, estimator and baseline, is not included.
        """
        arrays = {"previous": self.previous}
        if self.track is not None:
            arrays |= {"deviation": self.track.deviation, "answers": self.track.answers}
            if self.track.memory is not None:
                arrays |= vars(self.track.memory)
        return {
            name: np.atleast_1d(np.asarray(value, float))
            for name, value in arrays.items()
            if value is not None
        }

    def carrying(self, arrays: CarriedOver) -> Self:
        """Return the stream after the frames whose memory is given, from the one before them."""
        track = self.track
        if track is not None:
            memory: Memory | None = None
            if "blocks" in arrays:
                memory = DenseMemory(arrays["blocks"])
            elif "samples" in arrays:
                from lampest.posterior.sampled import SampledMemory

                memory = SampledMemory(arrays["samples"], int(arrays["frames"][0]))
            track = replace(
                track,
                deviation=arrays.get("deviation"),
                memory=memory,
                answers=arrays.get("answers"),
            )
        return replace(self, previous=arrays.get("previous"), track=track, first=False)

    @ONE_BLAS_THREAD
    def push(self, readings: Readings) -> tuple["Stream", Step]:
        """Solve one frame's readings (rows, columns).

        A frame that fails, or that has too few readings (`Readings.enough`), leaves the stream
        unchanged. Open weights are chosen again by a frame whose change from rest exceeds the
        largest one before by MIN_INCREASE. A frame that a method compares with an unloaded panel
        that was not solved has the status `UNCOMPARED`. Raises InputError as `begin`.

        Returns
        -------
        stream : Stream
            The stream after the frame.
        step : Step
            Solution of the frame.
        """
        _check_frame(readings, self.scene)
        method = self.estimator.method
        if not readings.enough(self.scene):
            return self, self.unsolved(Status.UNREAD)
        if (self.estimator.relative or method.needs_all_frames) and not self.resting.enough(
            self.scene
        ):
            return self, self.unsolved(Status.UNRESTED)
        chooses = self.chooses_weights and self.choosing(readings)
        estimator = self.estimator if chooses else self.weighted
        stream, step = method.push(replace(self, estimator=estimator), readings)
        stream = replace(stream, estimator=self.estimator)
        if chooses and step.solution.solved:
            stream = replace(
                stream,
                weights=step.weights,
                weight_sigma=step.weight_sigma,
                weighed_at=self.change(readings),
            )
        return stream, self._as_compared(step)

    def _as_compared(self, step: Step) -> Step:
        """Return the step; an optimum that a failed baseline leaves uncompared says so."""
        failed = self.baseline is not None and not self.rested
        joint = len(step.solution.cell_resistance) == 2
        if not (failed and self.estimator.relative and step.solution.optimum) or joint:
            return step
        return replace(step, solution=replace(step.solution, status=Status.UNCOMPARED))

    def verified(self, readings: Readings, after: "Stream", step: Step) -> tuple["Stream", Step]:
        """Compare the step of a solved frame with a second solve, see `Method.verified`.

        Steps of several networks have none, and are unchanged.
        """
        if self.joined:
            return after, step
        after, step = self.estimator.method.verified(self, readings, after, step)
        return after, self._as_compared(step)

    @property
    def weighted(self) -> Estimator:
        """The estimator with the weights that the data chose, if there are any."""
        if self.weights is None or not self.chooses_weights:
            return self.estimator
        return self.estimator.with_weights(self.weights, self.weight_sigma)

    def weights_due(self, readings: Readings) -> bool:
        """Return whether a frame differs so much from rest that it should choose weights anew."""
        return self.chooses_weights and self.change(readings) > MIN_INCREASE * self.weighed_at

    def choosing(self, readings: Readings) -> bool:
        """Return whether a frame with enough readings chooses open weights.

        The first one does, or one that is due.
        """
        return self.weights is None or (self.weights_due(readings) and not self.keeps_weights)

    @property
    def forgets(self) -> bool:
        """Whether estimates depend on no earlier frame, beyond the start of their search."""
        return self.rested and not self.estimator.uses_previous and not self.chooses_weights

    @property
    def takes_blocks(self) -> bool:
        """Whether several of the next frames may be solved over a leading axis.

        Their estimates depend on no other measured frame, and cells are the only unknowns. Networks
        of one frame are solved together instead.
        """
        estimator = self.estimator
        many = self.joined or self.scene.panel.crossings > MAX_BLOCK_CELLS
        if many or self.first or not self.forgets or estimator.automatic or estimator.relative:
            return False
        return estimator.problem(self.scene, 1, self.period).cells_alone

    @property
    def chooses_weights(self) -> bool:
        """Whether the data of the strongest frame choose the weights."""
        return self.estimator.automatic and self.estimator.auto_weight.per == "recording"

    def change(self, readings: Readings) -> float:
        """Return the mean change of a frame's readings from rest, see `mean_change`."""
        return float(mean_change(readings.plain_values, self.resting.value))

    def sequence(
        self, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple["Stream", list[Step]]:
        """Solve all measured frames of a recording, see `Method.sequence`.

        Returns
        -------
        stream : Stream
            The stream after the last frame.
        steps : list of Step
            One step a frame.
        """
        return self.estimator.method.sequence(self, resting, readings, on_frame)

    def data_and_start(self, readings: Readings) -> tuple[Data, Array | None]:
        """Return the data of a frame's solve and its start, see `Method.data_and_start`."""
        return self.estimator.method.data_and_start(self, readings)


def _check_frame(readings: Readings, scene: Scene) -> None:
    """Raise InputError unless these are the readings of one frame."""
    if not isinstance(readings, Readings):
        raise InputError(f"a stream takes Readings.of(scene, values), not {in_words(readings)}")
    if readings.value.shape != scene.panel.shape:
        held, requested = (
            " × ".join(map(str, shape)) for shape in (readings.value.shape, scene.panel.shape)
        )
        raise InputError(
            f"a stream takes one frame of {requested} readings, not {held}; "
            "of several, take one or their mean()"
        )
