"""Results and streams leave their process, and go on where they arrive: pools, caches, copies."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import Estimator, LogGradient, Misfit, Panel, Recording, Scene, TwoPointReadout

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
