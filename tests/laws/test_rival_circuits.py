"""Laws of the search for rival circuits: its shortcuts do not change the verdict."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from lampest import DrivenReadout, GroundedReadout, LoadedColumnsReadout, Panel, Scene
from lampest.inference import explanation
from lampest.inference.cells_fit import LEAST_SQUARES, CellsFit, data_of_cells, fitted
from lampest.inference.compared_frames import broken_law
from lampest.inference.prepared import Prepared
from lampest.inference.rivals import Rival
from lampest.panel.readouts.readout import Readout
from lampest.recording.readings import Readings
from lampest.solvers.multistart import best_solution
from lampest.solvers.posed import cost_of_solve
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

pytestmark = pytest.mark.long  # fits of rivals: seconds each

CIRCUITS = (
    lampest.TwoPointReadout(),
    LoadedColumnsReadout(load_ohm=3300.0, drive_ohm=100.0),
    LoadedColumnsReadout(load_ohm=3300.0, drive_ohm=100.0, polarity="down", driven="columns"),
    GroundedReadout(load_ohm=1000.0, drive_ohm=70.0),
    GroundedReadout(load_ohm=1000.0, drive_ohm=70.0, sense_ohm=70.0, sense="one"),
    lampest.VirtualGroundReadout(drive_ohm=70.0, sense_ohm=70.0, feedback_ohm=150.0),
    DrivenReadout(load_ohm=1000.0, drive_ohm=50.0, idle_ohm=50.0, idle_load_ohm=0.0),
    DrivenReadout(load_ohm=1000.0, drive_ohm=50.0, groups=((0, 1), (2, 3, 4)), sense_ohm=20.0),
)


def panel_cells(rows: int, columns: int) -> np.ndarray:
    """Cells of a film that scatters, in ohm."""
    return 3000 * np.exp(0.3 * np.random.default_rng(5).standard_normal((rows, columns)))


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: str(circuit.kind))
def test_a_resistance_in_series_only_narrows_the_laws_of_a_circuit(circuit: Readout) -> None:
    scene = Scene(Panel(4, 5), circuit).with_series(0.0)
    recorded = circuit.to_recorded(circuit.exact_reading(panel_cells(4, 5)), scene)[None]
    rival = Rival(scene, recorded, None)
    previous: list[np.ndarray] = []
    for ohm in (0.0, 5.0, 20.0, 60.0):
        tried = rival.with_series(ohm)
        readings = tried.readings
        tests = tried.scene.circuit.free_tests(readings.value, readings.known_sigma)
        # the law of idle lines at ground comes first, and only with resistances that are large
        # enough
        excess = [test.excess for test in reversed(tests)]
        assert len(excess) >= max(len(previous), 1)
        assert all(np.all(now >= then) for now, then in zip(excess, previous, strict=False))
        previous = excess


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: str(circuit.kind))
def test_the_effect_of_channels_is_that_of_one_simulation_for_each(circuit: Readout) -> None:
    scene = Scene(Panel(4, 5), circuit)
    cells = panel_cells(4, 5)
    one_by_one = Readout.channel_errors(circuit, cells, scene, 1.0)
    several = circuit.channel_errors(cells, scene, 1.0)
    np.testing.assert_allclose(several, one_by_one, atol=1e-9 * np.abs(one_by_one).max())


@pytest.fixture(scope="module")
def pressed() -> lampest.Recording:
    """A rod on 5 x 5 two-point cells."""
    scene = Scene(Panel(5, 5, 10.0), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    load = lampest.Rod(centre_mm=(20.0, 20.0), diameter_mm=25, mass_g=900)
    return lampest.simulate(lampest.Simulation(1, 3, scene, frames=3, loads=(load,)))


def test_rivals_whose_laws_the_readings_break_are_not_fitted(
    monkeypatch: pytest.MonkeyPatch, pressed: lampest.Recording
) -> None:
    question = Prepared(pressed).question
    tried: list[Rival] = []
    fits_of = explanation.fits_of

    def counted(rival: Rival, *further: object, **named: object) -> object:
        tried.append(rival)
        return fits_of(rival, *further, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(explanation, "fits_of", counted)
    assert question.explanation is not None
    explanation.better_rival(question, question.explanation)
    assert len(tried) > 3
    assert not any(broken_law(rival, question) for rival in tried if rival.kind)


def test_fits_of_rivals_begin_at_the_cells_of_a_neighbour(
    monkeypatch: pytest.MonkeyPatch, pressed: lampest.Recording
) -> None:
    question = Prepared(pressed).question
    cold = list[Scene]()
    fits = list[bool]()
    fitted = explanation.fitted

    def noted(scene: Scene, frame: Readings, near: object = None, **named: object) -> object:
        fits.append(near is None)
        if near is None:
            cold.append(scene)
        return fitted(scene, frame, near, **named)  # type: ignore[arg-type]

    assert question.explanation is not None
    monkeypatch.setattr(explanation, "fitted", noted)
    explanation.better_rival(question, question.explanation)
    assert len(fits) > 10
    assert not [scene.readout for scene in cold if not scene.circuit.several_panels]


def test_of_rivals_that_differ_in_names_of_lines_one_is_searched_in_series(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    circuit = LoadedColumnsReadout(load_ohm=1000.0, drive_ohm=1000.0)
    scene = Scene(Panel(6, 6, 10.0), circuit)
    load = lampest.Rod(centre_mm=(20.0, 20.0), diameter_mm=25, mass_g=900)
    recording = lampest.simulate(lampest.Simulation(1, 3, scene, frames=3, loads=(load,)))
    swapped = replace(recording, scene=replace(scene, readout=replace(circuit, driven="columns")))
    question = Prepared(swapped).question
    searched: list[Rival] = []
    with_series = explanation.with_series

    def noted(candidate: explanation.Explanation, frames: object) -> object:
        searched.append(candidate.rival)
        return with_series(candidate, frames)  # type: ignore[arg-type]

    monkeypatch.setattr(explanation, "with_series", noted)
    best = explanation.better_rival(question, question.explanation)
    assert best.name == "readout.driven: rows (rows and columns swapped)"
    assert best.name in {rival.kind for rival in searched}
    assert not [rival.kind for rival in searched if rival.order is not None]


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: str(circuit.kind))
def test_a_fit_to_readings_that_no_cells_give_ends_at_the_minimum_of_the_solver(
    circuit: Readout,
) -> None:
    scene = Scene(Panel(4, 5), circuit).with_series(0.0)
    cells = panel_cells(4, 5)
    recorded = circuit.to_recorded(circuit.exact_reading(cells), scene)[None]
    # no cells give these beside the other readings of most circuits
    factor = np.ones((4, 5))
    factor[1, 2] = factor[0, 4] = 5.0
    factor[3, 1] = 0.2
    frame = Rival(scene, factor * recorded, None).readings[0]
    fit = fitted(scene, frame, cells, patient=True)
    assert fit is not None
    data = replace(data_of_cells(scene, frame), lower=np.full((1, 4, 5), 1e-3))
    solver = ProjectedNewton(cost_of_solve(LEAST_SQUARES, scene, partial=data.partial), Settings())
    solution = best_solution(solver, data, cells[None])
    assert solution.solved
    least = CellsFit.at(scene, data, frame, solution.cell_resistance[0])
    assert fit.chi_square <= 1.01 * least.chi_square + 0.1
