"""Streams of a panel of modules.

Every module has a stream of its own, and their steps are joined to one step of the image. Where the
scene requests terms across the seams (`coupled`), the image is one problem whose network is block
diagonal over the modules.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.batch import push_streams, solve_baselines
from lampest.estimate.estimator import Estimator
from lampest.estimate.state import Step, held_by_all
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.noise import MAX_NAMED, NoiseEstimate, named_modules
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Modules, Panel
from lampest.panel.readouts.two_point import ModulesReadout
from lampest.panel.scene import Scene
from lampest.posterior.certainty import Certainty
from lampest.posterior.track import Bars, Track
from lampest.recording.readings import Readings
from lampest.solvers.projected_lbfgs import InverseHessians
from lampest.solvers.solution import OPTIMA, Status

# Statuses that count as estimates; the last is the weakest.
WEAKEST_LAST = (*OPTIMA, Status.APPROXIMATE)
Network = tuple[Estimator, Scene, Readings]
MODULE = "module_{:04d}_"  # before the names of a module's arrays


def begin_stream(estimator: Estimator, scene: Scene, period: float, resting: Readings) -> Stream:
    """Return the stream of a scene with or without modules.

    The parameters are those of `Stream.begin`.

    Raises InputError as `Stream.begin`, and as `network_scenes`.
    """
    if scene.panel.modules is None:
        return Stream.begin(estimator, scene, period, resting)
    pairs = zip(network_scenes(scene, estimator), network_readings(scene, resting), strict=True)
    return begin_networks(
        scene, [None if own is None else (estimator, own, part) for own, part in pairs], period
    )


@ONE_BLAS_THREAD
def begin_networks(
    scene: Scene,
    networks: Sequence[Network | None],
    period: float,
    noise: NoiseEstimate | None = None,
) -> Stream:
    """Return the stream of a scene of modules from those of its networks.

    Parameters
    ----------
    scene : Scene
    networks : sequence of (Estimator, Scene, Readings) or None
        Estimator, scene as in `network_scenes`, and unloaded readings of each network; None for a
        dead module.
    period : float
        Time between frames, s.
    noise : NoiseEstimate, optional
        Noise that was estimated from frames.

    Raises InputError as `Stream.begin`.
    """
    layout = scene.panel.modules
    assert layout is not None
    if layout.coupled:
        [(estimator, own, resting)] = filter(None, networks)
        return CoupledStream.begin(replace(estimator, error_bars=False), own, period, resting)
    noises = (None,) * layout.count if noise is None else noise.of_modules
    streams = list[Stream | None]()
    for network, own_noise in zip(networks, noises, strict=True):
        if network is None:
            streams.append(None)
            continue
        estimator, own, resting = network
        streams.append(Stream.unrested(estimator, own, period, resting, own_noise))
    modules = solve_baselines(streams)
    first = next(stream for stream in modules if stream is not None)
    blank = replace(
        first.resting,
        side=np.zeros_like(first.resting.side),
        seen=np.zeros_like(first.resting.seen),
    )
    image = Readings.of_parts(
        layout, [blank if stream is None else stream.resting for stream in modules]
    )
    return ModulesStream(
        first.estimator, scene, period, image, modules=tuple(modules)
    ).rested_whole()


def network_scenes(scene: Scene, estimator: Estimator) -> list[Scene | None]:
    """Return the scenes of the networks that are estimated on their own, None for a dead module.

    Raises InputError as `_coupled_scene`.
    """
    layout = scene.panel.modules
    assert layout is not None
    if layout.coupled:
        return [_coupled_scene(scene, estimator)]
    return [
        None if number in scene.dead_modules else module
        for number, module in enumerate(scene.of_modules)
    ]


def network_readings(scene: Scene, readings: Readings) -> list[Readings]:
    """Return the readings of each network that is estimated on its own, dead modules included."""
    layout = scene.panel.modules
    assert layout is not None
    if layout.coupled:
        return [readings]
    return [readings.of_module(layout, number) for number in range(layout.count)]


def _coupled_scene(scene: Scene, estimator: Estimator) -> Scene:
    """Return the scene of the whole image.

    The scene has a block diagonal network, and places that include the seams.

    Raises InputError where a module is wired or has no two-point readout, and where error bars are
    requested.
    """
    layout = scene.panel.modules
    assert layout is not None
    if estimator.error_bars is True or estimator.weighs_previous:
        raise InputError(
            "error_bars: estimates with terms over the seams of modules "
            "(panel.modules.coupled) have none"
        )
    for number, module in enumerate(scene.of_modules):
        if not module.circuit.two_point or module.wiring is not None:
            where = list(layout.place(number))
            raise InputError(
                f"panel.modules.coupled: module {where} is wired, or its readout is not two_point"
            )
    places = None
    x, y = scene.panel.places_mm
    if layout.seam_mm:
        places = tuple(
            (j, k, float(x[j, k]), float(y[j, k])) for j, k in np.ndindex(scene.panel.shape)
        )
    open_cells = _places(scene.open_cells)
    shorted_cells = _places(scene.shorted_cells & ~scene.open_cells)  # a dead module is both
    faults = None
    if open_cells or shorted_cells:
        faults = Faults(open=open_cells, shorted=shorted_cells)
    return Scene(
        Panel(*scene.panel.shape, scene.panel.pitch_mm, places),
        ModulesReadout(layout=layout),
        faults=faults,
    )


def _places(cells: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """Return row and column of the marked cells, (rows, columns)."""
    return tuple((int(row), int(column)) for row, column in np.argwhere(cells))


@dataclass(frozen=True, eq=False)
class CoupledStream(Stream):
    """Stream of a coupled image.

    Modules without a value are NaN, although terms across seams determine them.
    """

    @property
    def baseline_resistance(self) -> Array:
        """Cells of the baseline, (rows, columns) ohm.

        Without a solved baseline, and in modules without a value, the value is NaN.
        """
        return np.where(self._unread(self.resting), np.nan, super().baseline_resistance)

    def push(self, readings: Readings) -> tuple[Stream, Step]:
        """Push a frame, as `Stream.push`."""
        stream, step = super().push(readings)
        unread = self._unread(readings)
        solution = step.solution
        if not (unread.any() and solution.solved):
            return stream, step
        masked = replace(
            solution,
            cell_resistance=np.where(unread, np.nan, solution.cell_resistance),
            reading=np.where(unread, np.nan, solution.reading),
        )
        return stream, replace(step, solution=masked)

    def _unread(self, readings: Readings) -> NDArray[np.bool_]:
        """Return the cells of modules without any value, (rows, columns)."""
        assert isinstance(self.scene.readout, ModulesReadout)
        layout = self.scene.readout.layout
        parts = layout.split(readings.plain)
        unread = np.logical_not(parts.any(axis=(-2, -1), keepdims=True))
        return np.asarray(layout.joined(np.broadcast_to(unread, parts.shape)))


@dataclass(frozen=True, eq=False)
class ModulesStream(Stream):
    """Stream of a panel of independent modules.

    Attributes
    ----------
    modules : tuple of Stream or None
        Streams of the modules by number, None for a dead one.

    All other attributes are those of the whole image.
    """

    joined: ClassVar[bool] = True
    modules: tuple[Stream | None, ...] = ()

    def restarted(self, first: Stream) -> "ModulesStream":
        """Return the stream with the solvers' caches of `first`, as `Stream.restarted`."""
        assert isinstance(first, ModulesStream)
        modules = tuple(
            None if module is None or start is None else module.restarted(start)
            for module, start in zip(self.modules, first.modules, strict=True)
        )
        return replace(self, prepared=first.prepared, modules=modules)

    @property
    def carried(self) -> dict[str, Array]:
        """Memory of each module, with its number before the names."""
        return {
            MODULE.format(number) + name: values
            for number, module in enumerate(self.modules)
            if module is not None
            for name, values in module.carried.items()
        }

    def carrying(self, arrays: Mapping[str, Array]) -> "ModulesStream":
        """Return the stream with the memory of each module, as `Stream.carrying`."""
        modules = list[Stream | None]()
        for number, module in enumerate(self.modules):
            prefix = MODULE.format(number)
            own = {
                name.removeprefix(prefix): values
                for name, values in arrays.items()
                if name.startswith(prefix)
            }
            modules.append(None if module is None else module.carrying(own))
        return replace(self, modules=tuple(modules), first=False)

    @property
    def is_independent(self) -> bool:
        """Whether frames may be solved in blocks; modules are solved together instead."""
        return False

    def verified(self, readings: Readings, after: Stream, step: Step) -> tuple[Stream, Step]:
        """Return the stream and the step unchanged: the steps of modules have no second solve."""
        return after, step

    @ONE_BLAS_THREAD
    def tared(self, resting: Readings) -> "ModulesStream":
        """Return the stream of every module tared, as `Stream.tared`."""
        unrested = [
            None
            if module is None
            else module.without_baseline(resting.of_module(self._layout, number))
            for number, module in enumerate(self.modules)
        ]
        modules = tuple(solve_baselines(unrested))
        image = replace(self, resting=resting, modules=modules, track=None, baseline=None)
        return image.rested_whole()

    @ONE_BLAS_THREAD
    def push(self, readings: Readings) -> tuple["ModulesStream", Step]:
        """Push a frame, as `Stream.push`.

        Modules with too few readings are unchanged, and NaN in the image.
        """
        layout = self._layout
        inverses = self.prepared or InverseHessians.nothing(layout.count)
        pushed, inverses = push_streams(self.modules, readings.each(layout.split), inverses)
        modules, steps = zip(*pushed, strict=True)
        after = replace(self, modules=modules, prepared=inverses, first=False)
        return after if self.rested else after.rested_whole(), image_step(layout, steps)

    def sequence(
        self, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[Stream, list[Step]]:
        """Solve a sequence, as `Stream.sequence`, one module after the other."""
        layout = self._layout
        frames = len(readings.value)
        modules = list[Stream | None]()
        columns = list[Sequence[Step | None]]()
        for number, module in enumerate(self.modules):
            if module is None:
                modules.append(None)
                columns.append([None] * frames)
                continue
            own_resting = resting.of_module(layout, number)
            own_readings = readings.of_module(layout, number)
            after, solved = module.sequence(own_resting, own_readings, lambda: None)
            modules.append(after)
            columns.append(solved)
        for _ in range(frames):
            on_frame()
        stream = replace(self, modules=tuple(modules), first=False).rested_whole()
        return stream, [image_step(layout, steps) for steps in zip(*columns, strict=True)]

    @property
    def baseline_resistance(self) -> Array:
        """Cells of the baseline, (rows, columns) ohm.

        Dead modules and those without a solved baseline are NaN.
        """
        return np.asarray(_joined(self._layout, self.modules, "baseline_resistance", np.nan))

    def rested_whole(self) -> "ModulesStream":
        """Return the stream with the joined baselines of the modules.

        If no module has a baseline, the stream is unchanged.
        """
        steps = [None if module is None else module.baseline for module in self.modules]
        if not any(steps):
            return self
        tracks = [None if module is None else module.track for module in self.modules]
        baseline = _joined_certainty(
            self._layout, [None if track is None else track.baseline for track in tracks]
        )
        track = None if baseline is None else Track(baseline=baseline)
        return replace(self, baseline=image_step(self._layout, steps), track=track)

    @property
    def _layout(self) -> Modules:
        layout = self.scene.panel.modules
        assert layout is not None
        return layout


def _joined(
    layout: Modules, parts: Sequence[Any], name: str, missing: float, last: slice = slice(None)
) -> Any:
    """Return the attribute `name` of all modules as one map of the image, or None.

    Parameters
    ----------
    layout : Modules
    parts : sequence of object or None
        A part of each module, whose attribute is a map (…, rows, columns) or None.
    name : str
    missing : float
        Value of modules without a map.
    last : slice
        Slice of the first axis of each map.
    """
    maps = [getattr(part, name, None) for part in parts]
    present = [values[last] for values in maps if values is not None]
    if not present:
        return None
    blank = np.full(present[0].shape, missing, dtype=present[0].dtype)
    return np.asarray(
        layout.joined(np.stack([blank if part is None else part[last] for part in maps], axis=-3))
    )


def _joined_certainty(layout: Modules, parts: Sequence[Certainty | None]) -> Certainty | None:
    """Return the joined error bars of all modules; None where no module has any.

    Modules without error bars have infinite ones.
    """
    unknown = {"deviation": np.inf, "below": np.inf, "above": np.inf}
    maps = [
        _joined(layout, parts, field.name, unknown.get(field.name, 0.0))
        for field in fields(Certainty)
    ]
    return None if all(part is None for part in parts) else Certainty(*maps)


def image_step(layout: Modules, steps: Sequence[Step | None]) -> Step:
    """Return the steps of the modules joined to one step of the image.

    Costs and times are summed; the KKT residual, iterations and starts are the largest; the status
    is the weakest.

    Parameters
    ----------
    layout : Modules
    steps : sequence of Step or None
        Step of each module, None for a dead one.
    """
    present = [step for step in steps if step is not None]
    solved = [step for step in present if step.solution.solved]
    counted = solved or present[:1]
    first = present[0].solution
    status = max(
        (step.solution.status for step in solved), key=WEAKEST_LAST.index, default=first.status
    )
    missing = {"cell_resistance": np.nan, "reading": np.nan, "open_cell": False, "at_lower": False}
    solutions, bars = (
        [getattr(step, name, None) for step in steps] for name in ("solution", "bars")
    )
    parts: dict[str, Any] = {"at": None, "dual": None, "carried": None}
    parts |= {
        name: _joined(layout, solutions, name, fill, slice(-1, None))
        for name, fill in missing.items()
    }
    for name in ("kkt_residual", "iterations", "starts"):
        parts[name] = max(getattr(step.solution, name) for step in counted)
    costs = np.sum([step.solution.costs for step in counted], axis=0)
    objective = float(sum(step.solution.objective for step in counted))
    solution = replace(first, costs=costs, objective=objective, status=status, **parts)
    frame = _joined_certainty(layout, [getattr(bar, "frame", None) for bar in bars])
    change = _joined_certainty(layout, [getattr(bar, "change", None) for bar in bars])
    reading = _joined(layout, bars, "reading", np.nan)
    return Step(
        solution,
        sum(step.seconds for step in present),
        tuple(
            float(np.mean(weights))
            for weights in zip(*(step.weights for step in counted), strict=True)
        ),
        None if frame is None else Bars(frame, change, reading, held_by_all(present)),
        sum(step.bars_seconds for step in present),
        sentence=_sentence(layout, steps, status),
        weight_sigma=counted[0].weight_sigma,
    )


def _sentence(layout: Modules, steps: Sequence[Step | None], status: Status) -> str:
    """Return the weakest status of the modules, in words.

    The reasons why modules have no estimate are returned, too, in words.
    """
    unsolved = {n: step for n, step in enumerate(steps) if step is None or not step.solution.solved}
    if len(unsolved) == len(steps):
        return status.value
    reasons = {number: "dead" if step is None else step.status for number, step in unsolved.items()}
    return "; ".join([status.value, *named_modules(layout, reasons, MAX_NAMED)])
