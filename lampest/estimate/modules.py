"""A panel of modules frame by frame: every module by a stream of its own, their steps as one step of the image.

Where the scene asks for terms that go over the seams, the image is one problem whose network falls into modules.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.batch import push_streams, solve_baselines
from lampest.estimate.estimator import Estimator
from lampest.estimate.noise import MAX_NAMED, NoiseEstimate
from lampest.estimate.state import SequenceState, Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.panel.conditions import Faults
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.blocks import ModulesReadout
from lampest.panel.scene import Scene
from lampest.posterior.certainty import Certainty
from lampest.posterior.track import Bars, Change, Track
from lampest.recording.readings import Readings
from lampest.solvers.projected_lbfgs import InverseHessians
from lampest.solvers.solution import OPTIMA, Status

WORST = (*OPTIMA, Status.APPROXIMATE)  # of all that count as estimates, the last is the weakest
C = TypeVar("C", Certainty, Change)
Own = Callable[[Scene, int | None], tuple[Estimator, Readings]]  # of a network: its module's number, or None


@ONE_BLAS_THREAD
def begin_stream(
    estimator: Estimator,
    scene: Scene,
    period: float,
    resting: Readings,
    noise: NoiseEstimate | None = None,
    own: Own | None = None,
) -> Stream:
    """Return the stream of a scene, of modules or not; see `Stream.begin`.

    own : returns the estimator and the resting readings of each network; None: those of the whole.
    Raises InputError as `Stream.begin`, and as `_coupled_scene`.
    """
    layout = scene.panel.modules

    def of_network(scene: Scene, number: int | None) -> tuple[Estimator, Readings]:
        if own is not None:
            return own(scene, number)
        return estimator, resting if layout is None or number is None else resting.of_module(layout, number)

    if layout is None:
        alone, unloaded = of_network(scene, None)
        return Stream.begin(alone, scene, period, unloaded, noise)
    if layout.coupled:
        image = _coupled_scene(scene, estimator)
        alone, unloaded = of_network(image, None)
        return CoupledStream.begin(replace(alone, error_bars=False), image, period, unloaded)
    streams: list[Stream | None] = []
    for number, seen in enumerate((None,) * layout.count if noise is None else noise.of_modules):
        module, dead = scene.of_modules[number], number in scene.dead_modules
        alone, unloaded = (estimator, resting) if dead else of_network(module, number)
        streams.append(None if dead else Stream.unrested(alone, module, period, unloaded, seen))
    modules = solve_baselines(streams)
    first = next(stream for stream in modules if stream is not None)
    blank = replace(first.resting, side=np.zeros_like(first.resting.side), seen=np.zeros_like(first.resting.seen))
    whole = Readings.of_parts(layout, [blank if stream is None else stream.resting for stream in modules])
    return ModulesStream(first.estimator, scene, period, whole, modules=tuple(modules)).rested_whole()


def _coupled_scene(scene: Scene, estimator: Estimator) -> Scene:
    """Return the image as one panel whose network falls into modules; neighbours over a seam are so much farther apart.

    Raises InputError where a module is wired, or has no two-point readout, and where error bars are asked for.
    """
    layout = scene.panel.modules
    assert layout is not None
    if estimator.error_bars is True or estimator.weighs_previous:
        raise InputError("error_bars: estimates with terms over the seams of modules (panel.modules.coupled) have none")
    for number, own in enumerate(scene.of_modules):
        if not isinstance(own.circuit, TwoPointReadout) or own.wiring is not None:
            where = list(layout.place(number))
            raise InputError(f"panel.modules.coupled: module {where} is wired, or its readout is not two_point")
    places, (x, y) = None, scene.panel.places_mm
    if layout.seam_mm:
        places = tuple((j, k, float(x[j, k]), float(y[j, k])) for j, k in np.ndindex(scene.panel.shape))
    known = scene.open_cells, scene.shorted_cells & ~scene.open_cells  # a dead module is both
    broken = [tuple((int(j), int(k)) for j, k in np.argwhere(cells)) for cells in known]
    faults = Faults(open=broken[0], shorted=broken[1]) if any(broken) else None
    return Scene(Panel(*scene.panel.shape, scene.panel.pitch_mm, places), ModulesReadout(layout=layout), faults=faults)


@dataclass(frozen=True, eq=False)
class CoupledStream(Stream):
    """Stream of a coupled image. A module of which nothing was read is NaN, whatever terms say of it."""

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline is not solved, and of modules that were not read."""
        return np.where(self._unread(self.resting), np.nan, super().baseline_resistance)

    @property
    def is_independent(self) -> bool:
        """False: a batch has no network that falls into modules."""
        return False

    def push(self, readings: Readings) -> tuple[Stream, Step]:
        """Push a frame, as `Stream.push`."""
        stream, step = super().push(readings)
        unread, solution = self._unread(readings), step.solution
        if not (unread.any() and solution.solved):
            return stream, step
        cells, reading = (np.where(unread, np.nan, part) for part in (solution.cell_resistance, solution.reading))
        return stream, replace(step, solution=replace(solution, cell_resistance=cells, reading=reading))

    def _unread(self, readings: Readings) -> NDArray[np.bool_]:
        """(rows, columns) of modules without any value."""
        assert isinstance(self.scene.readout, ModulesReadout)
        layout = self.scene.readout.layout
        parts = layout.split(readings.plain)
        unread = np.logical_not(parts.any(axis=(-2, -1), keepdims=True))
        return np.asarray(layout.joined(np.broadcast_to(unread, parts.shape)))


@dataclass(frozen=True, eq=False)
class ModulesStream(Stream):
    """modules : the stream of each, by its number; None of a dead one. All else is of the whole image."""

    modules: tuple[Stream | None, ...] = ()

    @ONE_BLAS_THREAD
    def tared(self, resting: Readings) -> "ModulesStream":
        """Return the stream of every module tared, as `Stream.tared`."""
        every = enumerate(self.modules)
        modules = solve_baselines(
            [module and module.without_baseline(resting.of_module(self._layout, number)) for number, module in every]
        )
        return replace(self, resting=resting, modules=tuple(modules), track=None, baseline=None).rested_whole()

    @ONE_BLAS_THREAD
    def push(self, readings: Readings) -> tuple["ModulesStream", Step]:
        """Push a frame, as `Stream.push`; modules with too few readings stay as they were, and are NaN in the image."""
        layout = self._layout
        inverses = self.prepared or InverseHessians.nothing(layout.count, layout.each.rows * layout.each.columns)
        modules, steps = zip(*push_streams(self.modules, readings.each(layout.split), inverses), strict=True)
        after = replace(self, modules=modules, prepared=inverses, first=False)
        return after if self.rested else after.rested_whole(), image_step(layout, steps)

    def sequence(
        self, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[Stream, list[Step]]:
        """Solve a sequence, as `Stream.sequence`.

        Methods that need all frames together take one module after the other.
        """
        if not self.estimator.method.needs_all_frames:
            return super().sequence(resting, readings, on_frame)
        layout, frames = self._layout, len(readings.value)
        modules, columns = list[Stream | None](), list[Sequence[Step | None]]()
        for number, module in enumerate(self.modules):
            inside = resting.of_module(layout, number), readings.of_module(layout, number)
            after, solved = (None, [None] * frames) if module is None else module.sequence(*inside, lambda: None)
            modules.append(after)
            columns.append(solved)
        for _ in range(frames):
            on_frame()
        whole = replace(self, modules=tuple(modules), first=False).rested_whole()
        return whole, [image_step(layout, steps) for steps in zip(*columns, strict=True)]

    @property
    def is_independent(self) -> bool:
        """False: modules are the batch."""
        return False

    def weights_due(self, readings: Readings) -> bool:
        """Modules choose their weights themselves."""
        return False

    @property
    def baseline_resistance(self) -> Array:
        """(rows, columns) ohm; NaN where the baseline of a module is not solved, or the module is dead."""
        parts = [None if stream is None else stream.baseline_resistance for stream in self.modules]
        return np.asarray(_joined_maps(self._layout, parts, np.nan))

    def restarted(self, first: Stream) -> "ModulesStream":
        """Return the stream of every module restarted, as `Stream.restarted`."""
        assert isinstance(first, ModulesStream)
        pairs = zip(self.modules, first.modules, strict=True)
        modules = tuple(module and start and module.restarted(start) for module, start in pairs)
        return replace(self, modules=modules, prepared=None)

    @property
    def parts(self) -> tuple[SequenceState | None, ...]:
        """See `SequenceState.parts`."""
        return self.modules

    def with_parts(self, parts: tuple[SequenceState | None, ...]) -> "ModulesStream":
        """Return the stream with other modules."""
        modules = tuple(part for part in parts if part is None or isinstance(part, Stream))
        return replace(self, modules=modules, first=False)

    def rested_whole(self) -> "ModulesStream":
        """Return the stream with the baselines of the modules as one, once all that can be are solved."""
        steps = [None if stream is None else stream.baseline for stream in self.modules]
        if all(step is None for step in steps):
            return self
        known = [None if step is None or step.track is None else step.track.baseline for step in self.modules]
        baseline = _joined(self._layout, Certainty, known)
        track = None if baseline is None else Track(baseline=baseline)
        return replace(self, baseline=image_step(self._layout, steps), track=track)

    @property
    def _layout(self) -> Modules:
        layout = self.scene.panel.modules
        assert layout is not None
        return layout


def _joined_maps(layout: Modules, parts: Sequence[NDArray[Any] | None], missing: float) -> Any:
    """Return maps (…, rows, columns) of all modules as one map of the image; None where no module has any.

    missing : stands for the maps of the other modules.
    """
    first = next((part for part in parts if part is not None), None)
    if first is None:
        return None
    blank = np.full(first.shape, missing, dtype=first.dtype)
    return np.asarray(layout.joined(np.stack([blank if part is None else part for part in parts], axis=-3)))


def _joined(layout: Modules, kind: type[C], parts: Sequence[C | None]) -> C | None:
    """Join the parts of all modules, with nothing known of those without error bars; None where none has any."""
    if all(part is None for part in parts):
        return None
    unknown = ("deviation", "below", "above")
    names = [field.name for field in fields(kind)]
    maps = {name: [None if part is None else getattr(part, name) for part in parts] for name in names}
    return kind(**{n: _joined_maps(layout, values, np.inf if n in unknown else 0.0) for n, values in maps.items()})


def image_step(layout: Modules, steps: Sequence[Step | None]) -> Step:
    """Return the modules' steps as one of the image; costs are summed, and the KKT residual is the largest of all."""
    present = [step for step in steps if step is not None]
    solved = [step for step in present if step.solution.solved]
    counted, first = solved or present[:1], present[0].solution
    status = max((step.solution.status for step in solved), key=WORST.index, default=first.status)
    missing = {"cell_resistance": np.nan, "reading": np.nan, "open_cell": False, "at_lower": False}
    parts: dict[str, Any] = {"at": None, "dual": None, "preconditioner": None}
    parts |= {
        name: _joined_maps(layout, [None if s is None else getattr(s.solution, name)[-1:] for s in steps], nothing)
        for name, nothing in missing.items()
    }
    for name in ("kkt_residual", "iterations", "starts"):
        parts[name] = max(getattr(step.solution, name) for step in counted)
    costs = np.sum([step.solution.costs for step in counted], axis=0)
    objective = float(sum(step.solution.objective for step in counted))
    solution = replace(first, costs=costs, objective=objective, status=status, **parts)
    bars = [None if step is None else step.bars for step in steps]
    frame = _joined(layout, Certainty, [None if bar is None else bar.frame for bar in bars])
    change = _joined(layout, Change, [None if bar is None else bar.change for bar in bars])
    reading = _joined_maps(layout, [None if bar is None else bar.reading for bar in bars], np.nan)
    return Step(
        solution,
        sum(step.seconds for step in present),
        tuple(float(np.mean(weights)) for weights in zip(*(step.weights for step in counted), strict=True)),
        None if frame is None else Bars(frame, change, reading),
        sum(step.bars_seconds for step in present),
        sentence=_sentence(layout, steps, status),
        weight_sigma=counted[0].weight_sigma,
    )


def _sentence(layout: Modules, steps: Sequence[Step | None], status: Status) -> str:
    """Return the weakest of the modules' statuses, and why some have no estimate."""
    why: dict[str, list[int]] = {}
    for number, step in enumerate(steps):
        if step is None or not step.solution.solved:
            why.setdefault("dead" if step is None else step.status, []).append(number)
    if sum(map(len, why.values())) == len(steps):
        return status.value
    messages = [status.value]
    for reason, numbers in why.items():
        named = ", ".join(str(list(layout.place(number))) for number in numbers[:MAX_NAMED])
        more = f" and {len(numbers) - MAX_NAMED} more" if len(numbers) > MAX_NAMED else ""
        messages.append(f"module{'s' if len(numbers) > 1 else ''} {named}{more}: {reason}")
    return "; ".join(messages)
