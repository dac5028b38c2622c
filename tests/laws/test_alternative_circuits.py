"""Laws of the search for alternative circuits: its shortcuts do not change the verdict."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

import lampest
from lampest import DrivenReadout, GroundedReadout, LoadedColumnsReadout, Panel, Scene
from lampest.inference import cells_fit
from lampest.inference.cells_fit import LEAST_SQUARES, CellsFit, data_of_cells, fitted
from lampest.inference.circuits import better_alternative, explanation, parameters
from lampest.inference.circuits.alternatives import Alternative, alternatives_of
from lampest.inference.circuits.explanation import Explanation, broken_law
from lampest.inference.prepared import Prepared
from lampest.inference.readings.free_tests import free_tests
from lampest.panel.effects.loose_contact import LooseContact
from lampest.panel.readouts.readout import Readout
from lampest.panel.readouts.starts import UNIFORM_KNOTS, several_panels, uniform_readings
from lampest.panel.readouts.tolerances import channel_errors, simulated
from lampest.recording.readings import Readings
from lampest.solvers.multistart import best_solution
from lampest.solvers.posed import cost_of_solve
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings

pytestmark = pytest.mark.long  # fits of alternatives: seconds each

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


# Factors on the readings of a panel of 4 x 5 cells
FAR = np.ones((4, 5))
FAR[1, 2] = FAR[0, 4] = 5.0
FAR[3, 1] = 0.2
NEAR = 1 + 1e-4 * np.sin(np.arange(20.0)).reshape(4, 5)


def panel_cells(rows: int, columns: int) -> np.ndarray:
    """Cells of a film that scatters, in ohm."""
    return 3000 * np.exp(0.3 * np.random.default_rng(5).standard_normal((rows, columns)))


@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: str(circuit.kind))
def test_a_resistance_in_series_only_narrows_the_laws_of_a_circuit(circuit: Readout) -> None:
    scene = Scene(Panel(4, 5), circuit).with_series(0.0)
    recorded = circuit.to_recorded(circuit.exact_reading(panel_cells(4, 5)), scene)[None]
    alternative = Alternative(scene, recorded, None)
    previous: list[np.ndarray] = []
    for ohm in (0.0, 5.0, 20.0, 60.0):
        tried = alternative.with_series(ohm)
        readings = tried.readings
        tests = free_tests(tried.scene.circuit, readings.value, readings.known_sigma)
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
    unchanged = circuit.exact_reading(cells)
    one_by_one = [
        circuit.from_recorded(simulated(circuit, cells, scene, *np.split(line, [4])), scene)
        - unchanged
        for line in np.eye(9)
    ]
    several = channel_errors(circuit, cells, unchanged, scene, 1.0)
    np.testing.assert_allclose(several, one_by_one, atol=1e-9 * np.abs(several).max())


@pytest.fixture(scope="module")
def pressed() -> lampest.Recording:
    """A rod on 5 x 5 two-point cells."""
    scene = Scene(Panel(5, 5, 10.0), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    load = lampest.Rod(centre_mm=(20.0, 20.0), diameter_mm=25, mass_g=900)
    return lampest.simulate(lampest.Simulation(1, 3, scene, frames=3, loads=(load,)))


@pytest.fixture
def alternative_fits(monkeypatch: pytest.MonkeyPatch) -> list[Alternative]:
    """Return the list of alternatives that are fitted from now on."""
    fitted_alternatives: list[Alternative] = []
    fits_of = explanation.fits_of

    def counted(alternative: Alternative, *further: object, **named: object) -> object:
        fitted_alternatives.append(alternative)
        return fits_of(alternative, *further, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(explanation, "fits_of", counted)
    return fitted_alternatives


def test_alternatives_whose_laws_the_readings_break_are_not_fitted(
    pressed: lampest.Recording, alternative_fits: list[Alternative]
) -> None:
    question = Prepared(pressed).question
    assert question.explanation is not None
    alternative_fits.clear()
    better_alternative.better_alternative(question, question.explanation)
    assert len(alternative_fits) > 3
    assert not any(
        broken_law(alternative, question) for alternative in alternative_fits if alternative.kind
    )


@pytest.mark.parametrize("idle_ohm", [inf, 20e3, 3e3, 1.5e3, 500.0])
def test_values_of_an_open_number_that_are_not_tried_have_less_evidence(idle_ohm: float) -> None:
    circuit = DrivenReadout(load_ohm=1000.0, drive_ohm=30.0, idle_ohm=idle_ohm, idle_load_ohm=inf)
    scene = Scene(Panel(6, 6, 10.0), circuit)
    load = lampest.Rod(centre_mm=(20.0, 20.0), diameter_mm=25, mass_g=900)
    recording = lampest.simulate(lampest.Simulation(1, 3, scene, frames=3, loads=(load,)))
    assumed = replace(scene, readout=LoadedColumnsReadout(load_ohm=1000.0, drive_ohm=30.0))
    question = Prepared(replace(recording, scene=assumed)).question
    open_numbers = [each for each in alternatives_of(question.specified) if each.number]
    assert len(open_numbers) == 3
    for alternative in open_numbers:
        found = [Explanation.of(each, question) for each in alternative.with_tried_numbers]
        costs = [inf if each is None else each.linear_evidence for each in found]
        beyond = np.less(np.minimum.accumulate(costs) + explanation.FAR, costs)
        tried = int(np.argmax(beyond)) + 1 if beyond.any() else len(costs)
        assert min(costs[tried:], default=inf) >= min(costs[:tried])


def test_fits_of_alternatives_begin_at_the_cells_of_a_neighbour(
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
    better_alternative.better_alternative(question, question.explanation)
    assert len(fits) > 10
    assert not [
        scene.readout for scene in cold if not several_panels(scene.circuit, *scene.panel.shape)
    ]


@pytest.mark.slow
def test_of_alternatives_that_differ_in_names_of_lines_one_is_searched_in_series(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    circuit = LoadedColumnsReadout(load_ohm=1000.0, drive_ohm=1000.0)
    scene = Scene(Panel(6, 6, 10.0), circuit)
    load = lampest.Rod(centre_mm=(20.0, 20.0), diameter_mm=25, mass_g=900)
    recording = lampest.simulate(lampest.Simulation(1, 3, scene, frames=3, loads=(load,)))
    swapped = replace(recording, scene=replace(scene, readout=replace(circuit, driven="columns")))
    question = Prepared(swapped).question
    searched: list[Alternative] = []
    with_series = better_alternative.with_series

    def noted(candidate: explanation.Explanation, frames: object) -> object:
        searched.append(candidate.alternative)
        return with_series(candidate, frames)  # type: ignore[arg-type]

    monkeypatch.setattr(better_alternative, "with_series", noted)
    best = better_alternative.better_alternative(question, question.explanation)
    assert best.name == "readout.driven: rows (rows and columns swapped)"
    assert best.name in {alternative.kind for alternative in searched}
    assert not [alternative.kind for alternative in searched if alternative.order is not None]


@pytest.mark.slow
@pytest.mark.parametrize("circuit", CIRCUITS, ids=lambda circuit: str(circuit.kind))
def test_a_fit_to_readings_that_no_cells_give_ends_at_the_minimum_of_the_solver(
    circuit: Readout,
) -> None:
    scene = Scene(Panel(4, 5), circuit).with_series(0.0)
    cells = panel_cells(4, 5)
    recorded = circuit.to_recorded(circuit.exact_reading(cells), scene)[None]
    # no cells give these beside the other readings of most circuits
    frame = Alternative(scene, FAR * recorded, None).readings[0]
    fit = fitted(scene, frame, cells, patient=True)
    assert fit is not None
    data = replace(data_of_cells(scene, frame), lower=np.full((1, 4, 5), 1e-3))
    solver = ProjectedNewton(cost_of_solve(LEAST_SQUARES, scene, partial=data.partial), Settings())
    solution = best_solution(solver, data, cells[None])
    assert solution.solved
    least = CellsFit.at(scene, data, frame, solution.cell_resistance[0])
    assert fit.chi_square <= 1.01 * least.chi_square + 0.1


def test_a_search_for_a_resistance_in_series_ends_where_none_can_win(
    pressed: lampest.Recording, alternative_fits: list[Alternative]
) -> None:
    question = Prepared(pressed).question
    alternative = next(
        alternative
        for alternative in alternatives_of(question.specified)
        if "virtual" in alternative.name
    )
    best = parameters.some_in_series(alternative, question)
    assert best is not None
    every_resistance = len(alternative_fits)
    alternative_fits.clear()
    assert (
        parameters.some_in_series(alternative, question, to_beat=best.linear_evidence) is not None
    )
    assert len(alternative_fits) == every_resistance
    alternative_fits.clear()
    parameters.some_in_series(alternative, question, to_beat=best.linear_evidence - 1000)
    assert len(alternative_fits) == 1 < every_resistance


def test_of_the_right_circuit_the_next_resistances_are_fitted_and_no_memory(
    alternative_fits: list[Alternative],
) -> None:
    question = Prepared(lampest.datasets.load("lamprey_35mm")).question
    specified = question.explanation
    assert specified is not None
    alternative_fits.clear()
    assert parameters.with_converter_memory(specified, question) is specified
    assert not alternative_fits
    assert parameters.with_series(specified, question) is specified
    assert len(alternative_fits) <= 2


@pytest.mark.parametrize("circuit", CIRCUITS[:4], ids=lambda circuit: str(circuit.kind))
def test_fits_of_alternatives_never_need_the_solver(
    monkeypatch: pytest.MonkeyPatch, circuit: Readout
) -> None:
    scene = Scene(Panel(4, 5), circuit).with_series(0.0)
    cells = panel_cells(4, 5)
    recorded = circuit.to_recorded(circuit.exact_reading(cells), scene)[None]
    # no cells give the first of these readings; noise gives a part of the second ones
    far, near = (Alternative(scene, factor * recorded, None).readings[0] for factor in (FAR, NEAR))
    monkeypatch.setattr(cells_fit, "solved_from", None)
    assert fitted(scene, far, cells) is None
    fit = fitted(scene, near, cells)
    assert fit is not None and fit.within_noise


def test_sizes_of_an_effect_that_cannot_win_are_not_fitted(
    monkeypatch: pytest.MonkeyPatch, pressed: lampest.Recording
) -> None:
    specified = Prepared(pressed).question.explanation
    assert specified is not None and specified.pair is not None
    pair = specified.pair
    refits: list[object] = []
    monkeypatch.setattr(CellsFit, "refitted", lambda fit, *given: refits.append(given))
    assert pair.settled((LooseContact((1,)),), to_beat=pair.evidence.score - 1000) is None
    assert not refits
    pair.settled((LooseContact((1,)),))
    assert refits


@pytest.mark.parametrize("idle_volt", ["follows", 0.0])
def test_readings_of_uniform_panels_are_interpolated_between_a_few(
    monkeypatch: pytest.MonkeyPatch, idle_volt: float
) -> None:
    circuit = DrivenReadout(load_ohm=1000.0, drive_ohm=30.0, idle_ohm=5.0, idle_volt=idle_volt)
    solved: list[np.ndarray] = []
    exact_reading = DrivenReadout.exact_reading

    def counted(self: DrivenReadout, cells: np.ndarray, *further: object) -> np.ndarray:
        if cells.ndim == 2:
            solved.append(cells)
        return exact_reading(self, cells, *further)  # type: ignore[arg-type]

    monkeypatch.setattr(DrivenReadout, "exact_reading", counted)
    uniform_readings.cache_clear()
    levels, readings = uniform_readings(circuit, 3, 4)
    assert len(solved) == UNIFORM_KNOTS < len(levels)
    exact = np.stack([exact_reading(circuit, np.full((3, 4), level)) for level in levels])
    np.testing.assert_allclose(readings, exact, rtol=2e-3, atol=3e-4)
