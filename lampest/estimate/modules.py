"""A panel of modules frame by frame: every module by a stream of its own, their steps as one step of the image."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.batch import pushed_together, rested_together
from lampest.estimate.coupled import CoupledStream, coupled_scene, without_bars
from lampest.estimate.estimator import Estimator
from lampest.estimate.noise import MOST_NAMED, NoiseSeen
from lampest.estimate.state import SequenceState, Step
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array, Modules
from lampest.panel.scene import Scene
from lampest.posterior.certainty import Certainty
from lampest.posterior.track import Bars, Change, Track
from lampest.recording.readings import Readings
from lampest.solvers.batch import Kept
from lampest.solvers.solution import OPTIMA, Status

WORST = (*OPTIMA, Status.APPROXIMATE, Status.FITTED)  # of what counts as an estimate, the last is the weakest
C = TypeVar("C", Certainty, Change)


def begin_stream(
    estimator: Estimator, scene: Scene, period: float, resting: Readings, noise: NoiseSeen | None = None
) -> Stream:
    """The stream of a scene, of modules or not; see `Stream.begin`."""
    layout = scene.panel.modules
    if layout is None:
        return Stream.begin(estimator, scene, period, resting, noise)
    if layout.coupled:
        return CoupledStream.begin(without_bars(estimator), coupled_scene(scene), period, resting)

    def unrested(number: int, noise: NoiseSeen | None) -> Stream:
        return Stream.unrested(estimator, scene.of_modules[number], period, resting.of_module(layout, number), noise)

    return ModulesStream.begun(scene, noise, unrested)


@dataclass(frozen=True, eq=False)
class ModulesStream(Stream):
    """modules : the stream of each, by its number; None of a dead one. All else is of the whole image."""

    modules: tuple[Stream | None, ...] = ()

    @classmethod
    def begun(
        cls, scene: Scene, noise: NoiseSeen | None, unrested: Callable[[int, NoiseSeen | None], Stream]
    ) -> "ModulesStream":
        """Before the first frame. unrested : number and noise of a living module → its stream before its baseline."""
        layout = scene.panel.modules
        assert layout is not None
        noises = (None,) * layout.count if noise is None else noise.of_modules
        modules = rested_together(
            [None if n in scene.dead_modules else unrested(n, noise) for n, noise in enumerate(noises)]
        )
        first = next(stream for stream in modules if stream is not None)
        blank = replace(first.resting, side=np.zeros_like(first.resting.side), seen=np.zeros_like(first.resting.seen))
        resting = Readings.of_parts(layout, [blank if stream is None else stream.resting for stream in modules])
        return cls(first.estimator, scene, first.period, resting, modules=tuple(modules))._rested()

    def tared(self, resting: Readings) -> "ModulesStream":
        """As `Stream.tared`, of every module."""
        modules = [
            stream and stream.tared(resting.of_module(self._layout, number))
            for number, stream in enumerate(self.modules)
        ]
        return replace(self, resting=resting, modules=tuple(modules), track=None, baseline=None)._rested()

    def push(self, readings: Readings) -> tuple["ModulesStream", Step]:
        """As `Stream.push`: modules of which too little was read stay as they were, and are NaN in the image."""
        layout = self._layout
        kept = self.prepared or Kept.nothing(layout.count, layout.each.rows * layout.each.columns)
        found = pushed_together(self.modules, readings.of_every_module(layout), kept)
        modules, steps = tuple(stream for stream, _ in found), [step for _, step in found]
        after = replace(self, modules=modules, prepared=kept, first=False)
        return after if self.rested else after._rested(), image_step(layout, steps)

    def sequence(
        self, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[Stream, list[Step]]:
        """As `Stream.sequence`; methods that need all frames together take those of one module after the other."""
        if not self.estimator.method.together:
            return super().sequence(resting, readings, on_frame)
        layout, frames = self._layout, len(readings.value)
        modules, columns = list[Stream | None](), list[list[Step | None]]()
        for number, one in enumerate(self.modules):
            every: tuple[Stream | None, list[Step | None]] = None, [None] * frames
            if one is not None:
                inside = resting.of_module(layout, number), readings.of_module(layout, number)
                after, solved = one.sequence(*inside, lambda: None)
                every = after, list(solved)
            modules.append(every[0])
            columns.append(every[1])
        for _ in range(frames):
            on_frame()
        whole = replace(self, modules=tuple(modules), first=False)._rested()
        return whole, [image_step(layout, steps) for steps in zip(*columns, strict=True)]

    def due(self, readings: Readings) -> bool:
        """Modules choose their weights themselves."""
        return False

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline of a module is not solved, or the module is dead."""
        return self._maps(lambda stream: stream.baseline_resistance)

    def restarted(self, first: Stream) -> "ModulesStream":
        """As `Stream.restarted`, of every module."""
        assert isinstance(first, ModulesStream)
        pairs = zip(self.modules, first.modules, strict=True)
        return replace(
            self, modules=tuple(one and other and one.restarted(other) for one, other in pairs), prepared=None
        )

    @property
    def parts(self) -> tuple[SequenceState | None, ...]:
        """See `SequenceState.parts`."""
        return self.modules

    def with_parts(self, parts: tuple[SequenceState | None, ...]) -> "ModulesStream":
        """The stream with other modules."""
        return replace(
            self, modules=tuple(part for part in parts if part is None or isinstance(part, Stream)), first=False
        )

    @property
    def _layout(self) -> Modules:
        layout = self.scene.panel.modules
        assert layout is not None
        return layout

    def _maps(self, part: Callable[[Stream], Array], missing: float = np.nan) -> Array:
        return joined_maps(self._layout, [None if stream is None else part(stream) for stream in self.modules], missing)

    def _rested(self) -> "ModulesStream":
        """With the baselines of the modules as one, once all that can be are solved."""
        steps = [None if stream is None else stream.baseline for stream in self.modules]
        if all(step is None for step in steps):
            return self
        known = [None if one is None or one.track is None else one.track.baseline for one in self.modules]
        barred = any(one is not None for one in known)
        track = Track(baseline=_joined(self._layout, Certainty, known)) if barred else None
        return replace(self, baseline=image_step(self._layout, steps), track=track)


def joined_maps(layout: Modules, parts: Sequence[NDArray[Any] | None], missing: float) -> NDArray[Any]:
    """Maps (…, rows, columns) of all modules as one of the image, with a number for those that have none."""
    first = next(part for part in parts if part is not None)
    blank = np.full(first.shape, missing, dtype=first.dtype)
    return np.asarray(layout.joined(np.stack([blank if part is None else part for part in parts], axis=-3)))


def _joined(layout: Modules, kind: type[C], parts: Sequence[C | None]) -> C:
    """Certainty, or that of changes, of all modules' cells: nothing is known of those without error bars."""
    unknown = ("deviation", "below", "above")
    return kind(
        *(
            joined_maps(
                layout,
                [None if part is None else getattr(part, each.name) for part in parts],
                np.inf if each.name in unknown else 0.0,
            )
            for each in fields(kind)
        )
    )


def _joined_bars(layout: Modules, parts: Sequence[Bars | None]) -> Bars | None:
    """Of all modules; None where none has any."""
    if all(part is None for part in parts):
        return None
    changes = [None if part is None else part.change for part in parts]
    change = None if all(one is None for one in changes) else _joined(layout, Change, changes)
    return Bars(_joined(layout, Certainty, [None if part is None else part.frame for part in parts]), change)


def image_step(layout: Modules, steps: Sequence[Step | None]) -> Step:
    """The modules' steps as one of the image; costs are summed, and the KKT residual is the largest of all."""
    there = [step for step in steps if step is not None]
    solved = [step for step in there if step.solution.solved]
    counted, first = solved or there[:1], there[0].solution
    status = max((step.solution.status for step in solved), key=WORST.index, default=first.status)

    def maps(name: str, missing: float) -> NDArray[Any]:
        return joined_maps(layout, [None if s is None else getattr(s.solution, name)[-1:] for s in steps], missing)

    def largest(name: str) -> Any:
        return max(getattr(step.solution, name) for step in counted)

    solution = replace(
        first,
        cell_resistance=maps("cell_resistance", np.nan),
        reading=maps("reading", np.nan),
        open_cell=maps("open_cell", False),
        at_lower=maps("at_lower", False),
        costs=np.sum([step.solution.costs for step in counted], axis=0),
        objective=float(sum(step.solution.objective for step in counted)),
        kkt_residual=largest("kkt_residual"),
        iterations=largest("iterations"),
        starts=largest("starts"),
        status=status,
        at=None,
        dual=None,
        kept=None,
    )
    return Step(
        solution,
        sum(step.seconds for step in there),
        tuple(float(np.mean(weights)) for weights in zip(*(step.weights for step in counted), strict=True)),
        _joined_bars(layout, [None if step is None else step.bars for step in steps]),
        sum(step.bars_seconds for step in there),
        sentence=_sentence(layout, steps, status),
    )


def _sentence(layout: Modules, steps: Sequence[Step | None], status: Status) -> str:
    """The weakest of the modules' statuses, and why some have no estimate."""
    why: dict[str, list[int]] = {}
    for number, step in enumerate(steps):
        if step is None or not step.solution.solved:
            why.setdefault("dead" if step is None else step.status, []).append(number)
    if all(step is None or not step.solution.solved for step in steps):
        return status.value
    said = [status.value]
    for reason, numbers in why.items():
        named = ", ".join(str(list(layout.place(number))) for number in numbers[:MOST_NAMED])
        more = f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else ""
        said.append(f"module{'s' if len(numbers) > 1 else ''} {named}{more}: {reason}")
    return "; ".join(said)
