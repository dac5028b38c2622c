"""Results and streams leave their process, and go on where they arrive: pools, caches, copies."""

import contextlib
import copy
import doctest
import enum
import functools
import inspect
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import (
    Estimator,
    LogGradient,
    Misfit,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
)
from lampest.inference.prepared import Prepared

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


PUBLIC = {name: getattr(lampest, name) for name in lampest.__all__}
CLASSES = {name: public for name, public in PUBLIC.items() if inspect.isclass(public)}
MADE = [name for name, public in CLASSES.items() if not inspect.isabstract(public)]


def made_by_examples(public: type[Any]) -> list[Any]:
    """Return the objects of a class that the examples of its docstring make."""
    made = list(public) if issubclass(public, enum.Enum) else list[Any]()
    initialise = public.__init__

    @functools.wraps(initialise)
    def recorded(self: Any, *args: Any, **kwargs: Any) -> None:
        initialise(self, *args, **kwargs)
        made.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(public, "__init__", recorded)
        names = {"lampest": lampest}
        for example in doctest.DocTestParser().get_examples(public.__doc__ or ""):
            exec(compile(example.source, public.__name__, "exec"), names)
    return [*made, *(value for value in names.values() if isinstance(value, public))]


def held_arrays(
    value: Any, name: str, walked: dict[int, Any], *, by_public: bool = True
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield (name, array) of a public object, of those that it holds, and of their attributes."""
    if id(value) in walked:
        return
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, tuple | list | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from held_arrays(item, name, walked, by_public=by_public)
    elif by_public and type(value).__module__.startswith("lampest."):
        walked[id(value)] = value
        is_public = type(value) in CLASSES.values()
        for attribute in filter(lambda text: text[0] != "_", dir(value)):
            with contextlib.suppress(Exception):  # of objects without this attribute
                held = getattr(value, attribute)
                # Other arrays are the caller's copies
                if held is getattr(value, attribute):
                    yield from held_arrays(held, f"{name}.{attribute}", walked, by_public=is_public)


@pytest.mark.parametrize("name", MADE)
def test_objects_of_public_classes_are_pickled_and_their_arrays_are_read_only(name: str) -> None:
    made = made_by_examples(CLASSES[name])
    assert made
    for way in (lambda value: value, copy.copy, *WAYS.values()):
        arrived = way(made[-1])
        assert type(arrived) is type(made[-1])
        writable = [
            label for label, array in held_arrays(arrived, name, {}) if array.flags.writeable
        ]
        assert not writable


def test_arrays_of_a_reconstruction_are_walked(monkeypatch: pytest.MonkeyPatch) -> None:
    # Other circuits take seconds, and have texts.
    monkeypatch.setattr(lampest.Reconstruction, "advice", ())
    monkeypatch.setattr(Prepared, "check", None)
    estimate = lampest.reconstruct(small_recording(), TERMS, formulation="reduced")
    labels = [label for label, _ in held_arrays(estimate, "estimate", {})]
    for held in ("estimate.relative_change_errors", ".scene.blind", ".panel.places_mm"):
        assert any(label.endswith(held) for label in labels), held


@pytest.mark.parametrize("name", [name for name in PUBLIC if name not in MADE])
def test_public_names_are_pickled(name: str) -> None:
    public = PUBLIC[name]
    if inspect.ismodule(public):
        pytest.skip("Python pickles no module")
    assert pickle.loads(pickle.dumps(public)) == public


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
    recording = small_recording()
    readings = recording.readings()
    estimator = Estimator(TERMS, formulation)
    stream = lampest.Stream.begin(estimator, recording.scene, 1.0, readings[0])
    stream, _ = stream.push(readings[1])
    arrived = way(stream)
    _, expected = stream.push(readings[2])
    _, step = arrived.push(readings[2])
    np.testing.assert_array_equal(step.solution.cell_resistance, expected.solution.cell_resistance)
