"""Modules of a panel: estimated alone, coupled over the seams, or many at once."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from promises import promise

import lampest
from lampest import InputError, LogGradient, Recording
from lampest.cost.terms import Misfit, RelativeChange, Term
from lampest.estimate import batch
from lampest.estimate.estimator import Estimator
from lampest.estimate.modules import begin_stream
from lampest.files.document import parse_document, to_yaml, validated
from lampest.panel.panel import EachModule, Modules
from lampest.panel.readouts.floating import two_point_resistance
from lampest.panel.scene import Scene
from lampest.posterior.sampled import SampledMemory
from lampest.recording.simulation import Simulation, simulate

SCENE = """
panel: {modules: {rows: 2, columns: 3, each: {rows: 3, columns: 4, pitch_mm: 10}, seam_mm: 3}}
readout: {kind: two_point, reference_ohm: 1000, adc_bits: 12, readings: 20, noise_lsb: 0.7}
series_resistance_ohm: 140
"""
FAULTS = (
    "faults: {dead_modules: [[1, 2]], open: [[4, 5]]}\nmodules: [{at: [0, 1], "
    "series_resistance_ohm: 150}]\n"
)
LAYOUT = Modules(2, 3, EachModule(3, 4), 3.0)
COUPLED = Modules(2, 2, EachModule(3, 4), 4.0, coupled=True)
CONVERGED = 1e-6  # relative, of cells and costs at the end of a solve
ROUNDING = 1e-9  # relative, of a cost
CLEARLY_ABOVE = 1.001  # cost over the least one: a thousand times what solves leave
READOUT = lampest.TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)


def scene_of(text: str) -> Scene:
    """A scene from YAML."""
    scene: Scene = validated(parse_document(text, "scene.yaml"), Scene)
    return scene


def simulated(scene: Scene, frames: int = 3) -> Recording:
    """A rod over the seams."""
    rod = lampest.Rod(centre_mm=(40, 30), diameter_mm=40, mass_g=700)
    return simulate(Simulation(schema=1, seed=5, scene=scene, frames=frames, loads=(rod,)))


def test_a_scene_survives_its_text_and_counts_seams() -> None:
    scene = scene_of(SCENE + FAULTS)
    assert scene_of(to_yaml(scene)) == scene
    x, y = scene.panel.centres_mm()
    assert x[4] - x[3] == 13 and x[3] - x[2] == 10 and y[3] - y[2] == 13
    assert scene.of_modules[1].series_resistance_ohm == 150
    assert scene.of_modules[4].faults == lampest.Faults(open=((1, 1),))
    assert scene.blind[3:, 8:].all() and scene.blind.sum() == 12


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ("faults: {dead_modules: [[2, 0]]}", "there is no module [2, 0]"),
        ("faults: {dead_rows: [1]}", "every module has lines of its own"),
        ("modules: [{at: [0, 5]}]", "there is no module [0, 5]"),
        ("modules: [{at: [0, 1]}, {at: [0, 1]}]", "named twice"),
        ("modules: [{at: [0, 1], faults: {dead_rows: [3]}}]", "there is no row 3"),
        ("modules: [{at: [0, 1], readout: {kind: grounded}}]", "another kind"),
        (
            "faults: {dead_modules: [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]}",
            "nothing is left",
        ),
    ],
)
def test_impossible_modules_give_one_sentence(keys: str, sentence: str) -> None:
    with pytest.raises(InputError, match=r"scene\.yaml") as error:
        scene_of(SCENE + keys)
    assert sentence in str(error.value)


@promise("howto/modules: Every module is estimated as if it stood alone")
@pytest.mark.slow
@pytest.mark.parametrize(
    "penalty", [None, lampest.Gradient(weight=1e-7), lampest.RelativeChange(weight=1e-3)]
)
def test_every_module_is_estimated_as_if_it_stood_alone(penalty: lampest.Term | None) -> None:
    recording = simulated(scene_of(SCENE + FAULTS))
    terms = [lampest.Misfit(), *([] if penalty is None else [penalty])]
    image = lampest.reconstruct(recording, terms, formulation="reduced")
    assert np.isnan(image.cell_resistance[:, 3:, 8:]).all()
    assert all("module [1, 2]: dead" in status for status in image.status)
    assert "module [1, 2]: dead, as the scene says" in image.checks
    total = np.zeros(3)
    for number in range(5):
        cells = (..., *LAYOUT.cells(number))
        alone = Recording(
            recording.scene.of_modules[number],
            recording.recorded[cells],
            recording.time,
            recording.role,
        )
        estimate = lampest.reconstruct(alone, terms, formulation="reduced")
        total += [step.solution.objective for step in estimate.steps]
        np.testing.assert_allclose(
            image.cell_resistance[cells], estimate.cell_resistance, rtol=CONVERGED
        )
        np.testing.assert_allclose(
            image.baseline_resistance[cells], estimate.baseline_resistance, rtol=CONVERGED
        )
        np.testing.assert_allclose(
            image.cell_resistance_errors[cells],
            estimate.cell_resistance_errors,
            rtol=100 * CONVERGED,
        )
    np.testing.assert_allclose(
        [step.solution.objective for step in image.steps], total, rtol=CONVERGED
    )


def test_modules_of_a_single_line_have_the_shared_errors() -> None:
    """Bars were 0.02 % where the reference may be 6 % off."""
    text = (
        "systematic: typical\npanel: {modules: {rows: 2, columns: 2, each: {rows: 1, columns: "
        "6}}}\n"
    )
    text += SCENE[SCENE.index("readout") :]
    estimate = lampest.reconstruct(
        simulated(scene_of(text), 4), [lampest.Misfit()], formulation="reduced"
    )
    assert estimate.at_lower_bound.all()
    assert (estimate.cell_resistance_errors > 0.06 / np.sqrt(3) * estimate.cell_resistance).all()


def test_a_stream_of_modules_is_the_same_however_often_it_is_pushed() -> None:
    """A frame that was tried leaves nothing behind: inverse Hessians belong to the next stream."""
    modules = "modules: {rows: 1, columns: 3, each: {rows: 2, columns: 3}}"
    recording = simulated(scene_of(f"panel: {{{modules}}}\n{SCENE[SCENE.index('readout') :]}"))
    estimator = Estimator((Misfit(), LogGradient(weight=0.1)), "reduced", error_bars=False)
    readings = recording.readings()
    stream = begin_stream(estimator, recording.scene, 0.1, readings[recording.role == 0].mean())
    first, second, third = recording.measured_frames()
    for frame in (first, second):
        stream, _ = stream.push(readings[frame])
    inverses = [panel.inverse for panel in stream.prepared.panels if panel is not None]
    copies = [inverse.copy() for inverse in inverses]
    shorted = replace(readings[third], value=0.3 * readings[third].value)
    cells = []
    for frame in (readings[third], shorted, readings[third]):
        _, step = stream.push(frame)
        cells.append(step.cell_resistance)
    assert inverses and np.array_equal(cells[0], cells[2])
    assert all(map(np.array_equal, inverses, copies))


@pytest.mark.parametrize(
    "panel", ["modules: {rows: 1, columns: 3, each: {rows: 2, columns: 3}}", "rows: 3, columns: 4"]
)
def test_a_sequence_resumes_from_its_saved_arrays(panel: str) -> None:
    """The arrays pass through samples, too; a dead module has none."""
    dead = "faults: {dead_modules: [[0, 1]]}\n" if "modules" in panel else ""
    recording = simulated(scene_of(f"panel: {{{panel}}}\n{SCENE[SCENE.index('readout') :]}{dead}"))
    estimator = Estimator((Misfit(), RelativeChange(weight=1e-3)), "reduced")
    readings = recording.readings()
    initial = stream = begin_stream(
        estimator, recording.scene, 0.1, readings[recording.role == 0].mean()
    )
    first, second, third = recording.measured_frames()
    for frame in (first, second):
        stream, _ = stream.push(readings[frame])
    carried = stream.carried
    restarted = stream.restarted(initial)
    restored = initial.carrying(carried)
    shapes = [
        {name: values.shape for name, values in of.items()} for of in (carried, restored.carried)
    ]
    assert not restored.first and shapes[0] == shapes[1]
    assert all(
        part.prepared is None
        for part in (restarted.modules.values() if restarted.joined else (restarted,))
    )
    (_, expected), (_, step) = (each.push(readings[third]) for each in (restarted, restored))
    assert_allclose(step.cell_resistance, expected.cell_resistance, rtol=1e-12)
    assert_allclose(step.bars.change.deviation, expected.bars.change.deviation, rtol=1e-10)
    part = stream.modules[0] if stream.joined else stream
    pairs = np.random.default_rng(1).standard_normal((2, 2, 4, 5))
    track = replace(part.track, memory=SampledMemory(pairs[0], 3), answers=pairs[1])
    tracked = replace(part, track=track)
    whole = replace(stream, modules={**stream.modules, 0: tracked}) if stream.joined else tracked
    again = stream.carrying(whole.carried)
    track = (again.modules[0] if stream.joined else again).track
    assert isinstance(track.memory, SampledMemory) and track.memory.frames == 3
    assert_allclose([track.memory.samples, track.answers], pairs)


def rod_on_four_modules() -> Recording:
    """A rod where four modules meet."""
    rod = lampest.Rod(centre_mm=(36, 24), diameter_mm=45, mass_g=900)
    scene = Scene(lampest.Panel(modules=COUPLED), READOUT, 140.0)
    return simulate(Simulation(schema=1, seed=2, scene=scene, frames=3, loads=(rod,)))


def coupled(recording: Recording, *terms: lampest.Term) -> lampest.Estimates:
    return lampest.reconstruct(
        recording, [lampest.Misfit(), *terms], formulation="reduced", error_bars=False
    )


def apart(recording: Recording, *terms: lampest.Term) -> lampest.Estimates:
    layout = replace(recording.scene.panel.modules or COUPLED, coupled=False)
    scene = replace(recording.scene, panel=lampest.Panel(modules=layout))
    return coupled(replace(recording, scene=scene), *terms)


def cost(recording: Recording, cells: NDArray[np.float64], frame: int, weight: float) -> float:
    """Σ (R − R_m)² + λ Σ (ln r_b/r_a)²/d², written down anew."""
    layout = COUPLED
    panel = recording.scene.panel
    measured = layout.split(recording.recorded[frame] - 140.0)
    misfit = sum(
        np.sum((two_point_resistance(c) - m) ** 2)
        for c, m in zip(layout.split(cells), measured, strict=True)
    )
    x, y = (line / panel.pitch_mm for line in panel.centres_mm())
    logarithm = np.log(cells)
    steps = (
        np.diff(logarithm, axis=0) / np.diff(y)[:, None],
        np.diff(logarithm, axis=1) / np.diff(x),
    )
    return float(misfit + weight * sum(np.sum(step**2) for step in steps))


def test_a_penalty_without_neighbours_couples_no_modules() -> None:
    recording = rod_on_four_modules()
    penalty = lampest.CellResistance(weight=1e-7)
    estimate = coupled(recording, penalty)
    separate = apart(recording, penalty)
    assert all(status == "local optimum verified" for status in estimate.status)
    np.testing.assert_allclose(
        estimate.cell_resistance, separate.cell_resistance, rtol=10 * CONVERGED
    )
    np.testing.assert_allclose(
        estimate.baseline_resistance, separate.baseline_resistance, rtol=10 * CONVERGED
    )


def test_differences_over_seams_are_weighted_by_their_distance() -> None:
    recording = rod_on_four_modules()
    weight = 3e4
    estimate, uncoupled = (
        solve(recording, lampest.LogGradient(weight=weight)) for solve in (coupled, apart)
    )
    assert estimate.solved.all()
    random = np.random.default_rng(1)
    for place, frame in enumerate(estimate.frame):
        cells = estimate.cell_resistance[place]
        least = cost(recording, cells, frame, weight)
        assert least == pytest.approx(estimate.steps[place].solution.objective, rel=ROUNDING)
        neighbours = (cells * np.exp(1e-3 * random.standard_normal(cells.shape)) for _ in range(20))
        assert all(cost(recording, neighbour, frame, weight) > least for neighbour in neighbours)
        assert (
            cost(recording, uncoupled.cell_resistance[place], frame, weight) > CLEARLY_ABOVE * least
        )


def test_a_coupled_module_without_readings_stays_unknown() -> None:
    recording = rod_on_four_modules()
    cells = (..., *COUPLED.cells(2))
    recorded = recording.recorded.copy()
    recorded[cells] = np.nan
    estimate = coupled(
        replace(recording, recorded=recorded, raw_sums=None), lampest.LogGradient(weight=1e-3)
    )
    unknown = np.isnan(estimate.cell_resistance)
    assert unknown[cells].all() and unknown.sum() == unknown[cells].size


@pytest.mark.long
@pytest.mark.parametrize(
    ("term", "lines", "formulation", "together"),
    [
        (lampest.LogGradient(weight=1e-3), None, "reduced", True),
        (lampest.TotalVariation(weight=1e-3), None, "reduced", False),
        (lampest.LogGradient(weight=1e-3), lampest.Lines(1.0, 1.0), "reduced", False),
        (lampest.LogGradient(weight=1e-3), None, "nodal", False),
    ],
)
def test_modules_with_absolute_losses_or_wire_or_by_ipopt_are_solved_one_after_the_other(
    term: Term,
    lines: lampest.Lines | None,
    formulation: str,
    together: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solved = list[object]()
    solve = batch.solve
    monkeypatch.setattr(batch, "solve", lambda *given: solved.append(given) or solve(*given))
    recording = rod_on_four_modules()
    layout = replace(COUPLED, coupled=False)
    scene = replace(recording.scene, panel=lampest.Panel(modules=layout), lines=lines)
    estimate = lampest.reconstruct(
        replace(recording, scene=scene),
        [lampest.Misfit(weighting="noise"), term],
        formulation=formulation,
        error_bars=False,
    )
    assert estimate.solved.all() and bool(solved) == together


def test_coupled_modules_have_no_error_bars_and_no_wire() -> None:
    recording = rod_on_four_modules()
    with pytest.raises(InputError, match="have none"):
        lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient()], error_bars=True)
    wired = replace(recording.scene, lines=lampest.Lines(row_ohm_per_cell=1.0))
    with pytest.raises(InputError, match="is wired"):
        coupled(replace(recording, scene=wired), lampest.Gradient(weight=1e-6))
