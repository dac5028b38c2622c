"""Streams of a panel of modules.

Every module has a stream of its own, and their steps are joined to one step of the image. Where the
scene requests terms across the seams (`coupled`), the image is one problem whose network is block
diagonal over the modules.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from lampest.estimate.batch import push_streams, solve_baselines
from lampest.estimate.estimator import Estimator
from lampest.estimate.state import Step, held_by_all
from lampest.estimate.stream import CarriedOver, Stream
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.noise import MAX_NAMED, NoiseEstimate, named_modules
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Mask, Modules, Panel
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
    parts = network_readings(scene, resting)
    networks = {
        number: (estimator, own, parts[number])
        for number, own in network_scenes(scene, estimator).items()
    }
    return begin_networks(scene, networks, period)


@ONE_BLAS_THREAD
def begin_networks(
    scene: Scene,
    networks: Mapping[int, Network],
    period: float,
    noise: NoiseEstimate | None = None,
) -> Stream:
    """Return the stream of a scene of modules from those of its networks.

    Parameters
    ----------
    scene : Scene
    networks : mapping of int to (Estimator, Scene, Readings)
        Estimator, scene, and unloaded readings of each network that `network_scenes` has.
    period : float
        Time between frames, s.
    noise : NoiseEstimate, optional
        Noise that was estimated from frames.

    Raises InputError as `Stream.begin`.
    """
    layout = scene.panel.layout
    if layout.coupled:
        [(estimator, own, resting)] = networks.values()
        return CoupledStream.begin(replace(estimator, error_bars=False), own, period, resting)
    noises = (None,) * layout.count if noise is None else noise.of_modules
    streams = {
        number: Stream.unrested(estimator, own, period, resting, noises[number])
        for number, (estimator, own, resting) in networks.items()
    }
    modules = solve_baselines(streams)
    first = next(iter(modules.values()))
    nothing = np.zeros_like(first.resting.side)
    dead = replace(first, resting=replace(first.resting, side=nothing, seen=nothing))
    image = Readings.of_parts(
        layout, [modules.get(number, dead).resting for number in range(layout.count)]
    )
    return ModulesStream(first.estimator, scene, period, image, modules=modules).rested_whole()


def network_scenes(scene: Scene, estimator: Estimator) -> dict[int, Scene]:
    """Return the scenes of the networks that are estimated on their own, without dead modules.

    Raises InputError as `_coupled_scene`.
    """
    if scene.panel.layout.coupled:
        return {0: _coupled_scene(scene, estimator)}
    modules = enumerate(scene.of_modules)
    return {number: module for number, module in modules if number not in scene.dead_modules}


def network_readings(scene: Scene, readings: Readings) -> list[Readings]:
    """Return the readings of each network that is estimated on its own, dead modules included."""
    layout = scene.panel.layout
    if layout.coupled:
        return [readings]
    return [readings.of_module(layout, number) for number in range(layout.count)]


def _coupled_scene(scene: Scene, estimator: Estimator) -> Scene:
    """Return the scene of the whole image.

    The scene has a block diagonal network, and places that include the seams.

    Raises InputError where a module is wired or has no two-point readout, and where error bars are
    requested.
    """
    layout = scene.panel.layout
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


def _places(cells: Mask) -> tuple[tuple[int, int], ...]:
    """Return row and column of the marked cells, (rows, columns)."""
    return tuple((row, column) for row, column in np.argwhere(cells).tolist())


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

    @property
    def takes_blocks(self) -> bool:
        """Whether frames may be solved in blocks: a joined network has no axis of frames."""
        return False

    def push(self, readings: Readings) -> tuple[Stream, Step]:
        """Push a frame, as `Stream.push`."""
        stream, step = super().push(readings)
        cells, reading = (
            np.where(self._unread(readings), np.nan, values)
            for values in (step.solution.cell_resistance, step.solution.reading)
        )
        masked = replace(step.solution, cell_resistance=cells, reading=reading)
        return stream, replace(step, solution=masked)

    def _unread(self, readings: Readings) -> Mask:
        """Return the cells of modules without any value, (rows, columns)."""
        assert isinstance(self.scene.readout, ModulesReadout)
        layout = self.scene.readout.layout
        parts = layout.split(readings.plain)
        read = parts.any(axis=(-2, -1), keepdims=True)
        return ~layout.joined(np.broadcast_to(read, parts.shape))


@dataclass(frozen=True, eq=False)
class ModulesStream(Stream):
    """Stream of a panel of independent modules.

    Attributes
    ----------
    modules : mapping of int to Stream
        Streams of the modules by number, without dead ones.

    All other attributes are those of the whole image.
    """

    joined = True
    modules: Mapping[int, Stream] = field(default_factory=dict)

    def restarted(self, first: Stream) -> "ModulesStream":
        """Return the stream with the solvers' caches of `first`, as `Stream.restarted`."""
        assert isinstance(first, ModulesStream)
        modules = {
            number: module.restarted(first.modules[number])
            for number, module in self.modules.items()
        }
        return replace(self, prepared=first.prepared, modules=modules)

    @property
    def carried(self) -> dict[str, Array]:
        """Memory of each module, with its number before the names."""
        return {
            MODULE.format(number) + name: values
            for number, module in self.modules.items()
            for name, values in module.carried.items()
        }

    def carrying(self, arrays: CarriedOver) -> "ModulesStream":
        """Return the stream with the memory of each module, as `Stream.carrying`."""
        modules = dict[int, Stream]()
        for number, module in self.modules.items():
            prefix = MODULE.format(number)
            own = {
                name.removeprefix(prefix): values
                for name, values in arrays.items()
                if name.startswith(prefix)
            }
            modules[number] = module.carrying(own)
        return replace(self, modules=modules, first=False)

    @ONE_BLAS_THREAD
    def tared(self, resting: Readings) -> "ModulesStream":
        """Return the stream of every module tared, as `Stream.tared`."""
        unrested = {
            number: module.without_baseline(resting.of_module(self._layout, number))
            for number, module in self.modules.items()
        }
        modules = solve_baselines(unrested)
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
        modules = {number: module for number, (module, _) in pushed.items()}
        steps = {number: step for number, (_, step) in pushed.items()}
        after = replace(self, modules=modules, prepared=inverses, first=False)
        return after if self.rested else after.rested_whole(), image_step(layout, steps)

    def sequence(
        self, resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> tuple[Stream, list[Step]]:
        """Solve a sequence, as `Stream.sequence`, one module after the other."""
        layout = self._layout
        modules = dict[int, Stream]()
        solved = dict[int, list[Step]]()
        for number, module in self.modules.items():
            modules[number], solved[number] = module.sequence(
                resting.of_module(layout, number),
                readings.of_module(layout, number),
                lambda: None,
            )
        stream = replace(self, modules=modules, first=False).rested_whole()
        steps = []
        for own_steps in zip(*solved.values(), strict=True):
            on_frame()
            steps.append(image_step(layout, dict(zip(solved, own_steps, strict=True))))
        return stream, steps

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
        steps = {
            number: module.baseline
            for number, module in self.modules.items()
            if module.baseline is not None
        }
        if not steps:
            return self
        tracks = {number: module.track for number, module in self.modules.items()}
        baseline = _joined_certainty(self._layout, tracks, "baseline")
        track = None if baseline is None else Track(baseline=baseline)
        return replace(self, baseline=image_step(self._layout, steps), track=track)

    @property
    def _layout(self) -> Modules:
        return self.scene.panel.layout


def _joined(
    layout: Modules, parts: Mapping[int, Any], name: str, missing: float, last: slice = slice(None)
) -> Any:
    """Return the attribute `name` of all modules as one map of the image, or None.

    Parameters
    ----------
    layout : Modules
    parts : mapping of int to object
        A part of each module, whose attribute is a map (…, rows, columns) or None.
    name : str
    missing : float
        Value of modules without a map.
    last : slice
        Slice of the first axis of each map.
    """
    every = {number: getattr(part, name, None) for number, part in parts.items()}
    maps = {number: values[last] for number, values in every.items() if values is not None}
    if not maps:
        return None
    blank = np.full_like(next(iter(maps.values())), missing)
    present = [maps.get(number, blank) for number in range(layout.count)]
    return layout.joined(np.stack(present, axis=-3))


def _joined_certainty(layout: Modules, parts: Mapping[int, Any], name: str) -> Certainty | None:
    """Return the joined error bars `name` of all modules; None where no module has any.

    Modules without error bars have infinite ones.
    """
    own = {number: getattr(part, name, None) for number, part in parts.items()}
    unknown = {"deviation": np.inf, "below": np.inf, "above": np.inf}
    maps = [
        _joined(layout, own, part.name, unknown.get(part.name, 0.0)) for part in fields(Certainty)
    ]
    return None if maps[0] is None else Certainty(*maps)


def image_step(layout: Modules, steps: Mapping[int, Step]) -> Step:
    """Return the steps of the modules joined to one step of the image.

    Costs and times are summed; the KKT residual, iterations and starts are the largest; the status
    is the weakest. `steps` are those of each module by number, without dead ones.
    """
    present = list(steps.values())
    solved = [step for step in present if step.solution.solved]
    counted = solved or present[:1]
    first = present[0].solution
    status = max(
        (step.solution.status for step in solved), key=WEAKEST_LAST.index, default=first.status
    )
    solutions = {number: step.solution for number, step in steps.items()}
    missing = {"cell_resistance": np.nan, "reading": np.nan, "open_cell": False, "at_lower": False}
    parts = {
        name: _joined(layout, solutions, name, fill, slice(-1, None))
        for name, fill in missing.items()
    }
    for name in ("kkt_residual", "iterations", "starts"):
        parts[name] = max(getattr(step.solution, name) for step in counted)
    costs = np.sum([step.solution.costs for step in counted], axis=0)
    objective = float(sum(step.solution.objective for step in counted))
    bars = {number: step.bars for number, step in steps.items()}
    frame, change = (_joined_certainty(layout, bars, name) for name in ("frame", "change"))
    reading = _joined(layout, bars, "reading", np.nan)
    # The status, and why modules have no estimate
    sentences = [status.value]
    if solved:
        reasons = {
            number: steps[number].status if number in steps else "dead"
            for number in range(layout.count)
            if number not in steps or not steps[number].solution.solved
        }
        sentences += named_modules(layout, reasons, MAX_NAMED)
    return Step(
        replace(first, costs=costs, objective=objective, status=status, **parts),
        sum(step.seconds for step in present),
        tuple(np.mean([step.weights for step in counted], axis=0).tolist()),
        None if frame is None else Bars(frame, change, reading, held_by_all(present)),
        sum(step.bars_seconds for step in present),
        sentence="; ".join(sentences),
        weight_sigma=counted[0].weight_sigma,
    ).bare()
