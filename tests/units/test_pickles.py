"""Results and streams leave their process, and go on where they arrive: pools, caches, copies."""

import contextlib
import copy
import inspect
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import (
    Estimator,
    InputError,
    LogGradient,
    Misfit,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
)

WAYS = {
    "pickle": lambda result: pickle.loads(pickle.dumps(result)),
    "copy.deepcopy": copy.deepcopy,
}
TERMS = (Misfit(), LogGradient(weight=0.3))


def small_recording(frames: int = 4) -> Recording:
    rng = np.random.default_rng(5)
    cells = 3000 * np.exp(0.3 * rng.standard_normal((frames, 3, 4)))
    read = np.stack([lampest.two_point_resistance(frame) for frame in cells])
    scene = Scene(Panel(3, 4), TwoPointReadout())
    return Recording.from_array(read, baseline=1, scene=scene)


NEEDS_ARGUMENTS: dict[str, Callable[[], Any]] = {
    "Panel": lambda: Panel(3, 4),
    "Recording": small_recording,
    "Scene": lambda: Scene(Panel(3, 4), TwoPointReadout()),
    "Estimator": lambda: Estimator(TERMS, "reduced"),
    "Readings": lambda: small_recording().readings(),
    "Estimates": lambda: lampest.reconstruct(small_recording(), TERMS, formulation="reduced"),
    "Step": lambda: lampest.reconstruct(small_recording(), TERMS, formulation="reduced").steps[0],
    "OwnProgram": lambda: lampest.program(small_recording(), [Misfit()]),
    "OwnSolution": lambda: lampest.program(small_recording(), [Misfit()]).solve(),
}


READ_ONLY = {
    "Recording",
    "Readings",
    "Reconstruction",
    "CaseResult",
    "Step",
    "Solution",
    "Bars",
    "Certainty",
    "OwnSolution",
    "ProgramResult",
}


def test_every_public_object_is_pickled() -> None:
    """A walk over the public names: classes, functions, objects without arguments, and results."""
    pickled = 0
    for name in lampest.__all__:
        public = getattr(lampest, name)
        objects = [] if inspect.ismodule(public) else [public]
        if inspect.isclass(public) and not inspect.isabstract(public):
            make = NEEDS_ARGUMENTS.get(name, public)
            with contextlib.suppress(TypeError, ValueError, InputError):
                objects.append(make())
        if hasattr(public, "__origin__") or getattr(public, "__module__", "") == "typing":
            continue
        for value in objects:
            arrived = pickle.loads(pickle.dumps(value))
            assert type(arrived) is type(value), name
            pickled += 1
    assert pickled > len(lampest.__all__) // 2


def test_an_own_solution_arrives_with_its_numbers() -> None:
    solution = lampest.program(small_recording(), TERMS).solve()
    arrived = pickle.loads(pickle.dumps(solution))
    assert arrived.status == solution.status
    np.testing.assert_array_equal(arrived.cell_resistance, solution.cell_resistance)
    np.testing.assert_array_equal(arrived.cell_resistance_errors, solution.cell_resistance_errors)


def test_arrays_of_a_recording_are_read_only() -> None:
    values = np.full((2, 3, 4), 500.0)
    recording = Recording.from_array(values)
    for array in (recording.recorded, recording.time, recording.role):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    values[0] = 1.0  # the caller's own array stays the caller's


def held_arrays(value: Any, name: str, walked: dict[int, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays that a public object or its error bars hold; others are the caller's copies."""
    if id(value) in walked:
        return
    walked[id(value)] = value
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, tuple | list | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from held_arrays(item, name, walked)
    elif type(value).__name__ in READ_ONLY:
        for attribute in filter(lambda text: text[0] != "_", dir(value)):
            with contextlib.suppress(InputError, AttributeError):
                held = getattr(value, attribute)
                if held is getattr(value, attribute):
                    yield from held_arrays(held, f"{name}.{attribute}", walked)


@pytest.mark.slow
@pytest.mark.parametrize("way", [lambda held: held, *WAYS.values()], ids=["made", *WAYS])
def test_arrays_of_public_objects_are_read_only(way: Callable[[Any], Any]) -> None:
    estimate = lampest.reconstruct(small_recording(), TERMS, formulation="reduced")
    objects = {name: make() for name, make in NEEDS_ARGUMENTS.items() if name in READ_ONLY}
    objects |= {"Reconstruction": estimate, "CaseResult": estimate.result("LSM")}
    arrays = [pair for name, made in objects.items() for pair in held_arrays(way(made), name, {})]
    assert len(arrays) > 40
    assert not [name for name, array in arrays if array.flags.writeable]


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
def test_a_result_arrives_with_its_numbers(way: Callable[[Any], Any], formulation: str) -> None:
    estimate = lampest.reconstruct(small_recording(), TERMS, formulation=formulation)
    arrived = way(estimate)
    np.testing.assert_array_equal(arrived.cell_resistance, estimate.cell_resistance)
    assert repr(arrived) == repr(estimate)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
def test_a_stream_goes_on_where_it_arrives(way: Callable[[Any], Any], formulation: str) -> None:
    """The next frame of the copy and of the original are equal to the last bit."""
    recording = small_recording()
    readings = recording.readings()
    estimator = Estimator(TERMS, formulation)
    stream = lampest.Stream.begin(estimator, recording.scene, 1.0, readings[0])
    stream, _ = stream.push(readings[1])
    arrived = way(stream)
    _, expected = stream.push(readings[2])
    _, step = arrived.push(readings[2])
    np.testing.assert_array_equal(step.solution.cell_resistance, expected.solution.cell_resistance)
