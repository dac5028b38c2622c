"""Wire, lines that touch: told, the cells are found; not told, they are not. And how each shows in the data."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, Estimates, InputError, Panel, Recording, Rod, Squared, Status, TruncatedMethod, read_run
from lampest.cost.terms import LogRatio, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Bounds, Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import LoadedColumnsReadout, Readout, TwoPointReadout
from lampest.panel.readouts.wiring import Lines, Wiring, wire_responses
from lampest.panel.scene import Faults, Scene
from lampest.recording.readings import touching_columns, touching_rows
from lampest.recording.simulation import Cells, Simulation, simulate
from tests.netlist import impedance_of

LSM = (Misfit(weighting="noise"),)
THREAD = Lines(2.0, 4.0, "right", "top")
READOUTS = {
    "two_point": TwoPointReadout(adc_bits=14),
    "loaded": LoadedColumnsReadout(adc_bits=12, noise_lsb=1, load_ohm=3000.0, drive_ohm=100.0, driven="columns"),
}
TOUCHING = Faults(joined_rows=((1, 3),), joined_columns=((0, 4, 5),))
each_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)


def simulated(scene: Scene, seed: int = 3, **more: Any) -> Recording:
    rod = Rod(centre_mm=(30.0, 30.0), diameter_mm=35.0, mass_g=200.0)
    return simulate(Simulation(1, seed, scene, frames=2, loads=(rod,), **more))


def forgetting(recording: Recording, **keys: Any) -> Recording:
    """The same recording with a scene that is silent on that."""
    return replace(recording, scene=replace(recording.scene, **dict.fromkeys(keys)))


def solved(recording: Recording, formulation: Any = "reduced", terms: Any = LSM) -> Estimates:
    return reconstruct(recording, Estimator(terms, formulation))


def error(done: Estimates) -> Array:
    truth = done.recording.truth_cell_resistance
    return np.asarray(np.log(done.cell_resistance / truth[done.frame]))


def bars(done: Estimates) -> Array:
    return done.cell_resistance_errors / done.cell_resistance


@each_readout
def test_simulates_what_the_netlist_says(readout: Readout) -> None:
    """Without noise and with many bits a recording is the netlist's reading."""
    exact = replace(readout, adc_bits=32, noise_lsb=0.0, readings=1)
    scene = Scene(Panel(6, 5), exact, faults=Faults(joined_rows=((1, 2),)), lines=THREAD)
    recording = simulated(scene)
    for cells, recorded in zip(recording.truth_cell_resistance, recording.recorded, strict=True):
        impedance = impedance_of(cells, scene, exact.ties(cells))
        own = np.diag(impedance)
        read = exact.reading(np.tile(own[:6, None], 5), np.tile(own[6:], (6, 1)), impedance[:6, 6:])
        assert_allclose(recorded, exact.to_recorded(read, scene), rtol=1e-6)


@each_readout
def test_told_of_wire_the_cells_are_found(readout: Readout) -> None:
    recording = simulated(Scene(Panel(9, 7), readout, lines=THREAD, systematic="none"))
    told, ignored = solved(recording), solved(forgetting(recording, lines=None))
    assert np.median(np.abs(error(told))) < 0.004
    assert np.median(np.abs(error(ignored))) > 5 * np.median(np.abs(error(told)))
    assert 0.7 < np.sqrt(np.mean(np.square(error(told) / bars(told)))) < 1.3


@each_readout
def test_wire_that_is_not_told_shows_in_the_place_of_the_cells(readout: Readout) -> None:
    """As many readings as cells: the misfit is silent. Equal cells that seem to grow with their wire are not."""
    scene = Scene(Panel(9, 7), readout, lines=THREAD)
    recording = simulated(scene, cells=Cells(spread=0.003))
    ignored, told = solved(forgetting(recording, lines=None)), solved(recording)
    path = Wiring(THREAD).path_ohm((9, 7)).ravel()
    seeming, true = (np.corrcoef(done.baseline_resistance.ravel(), path)[0, 1] for done in (ignored, told))
    assert seeming > 0.8 and abs(true) < 0.3


@each_readout
@pytest.mark.parametrize("formulation", ["auto", TruncatedMethod(steps=8), "linearised"], ids=str)
def test_other_formulations_know_wire(readout: Readout, formulation: Any) -> None:
    """As well as without wire: what they leave out is theirs."""
    recording = simulated(Scene(Panel(9, 7), readout, lines=THREAD))
    bare = simulated(Scene(Panel(9, 7), readout))
    off, off_bare = (np.median(np.abs(error(solved(one, formulation)))) for one in (recording, bare))
    assert off < 1.5 * off_bare + 0.001


@each_readout
def test_a_weight_is_chosen_for_a_wired_panel(readout: Readout) -> None:
    recording = simulated(Scene(Panel(9, 7), readout, lines=THREAD))
    done = solved(recording, terms=(*LSM, LogRatio(weight="auto", loss=Squared())))
    assert np.median(np.abs(error(done))) < 0.004


def test_matrix_free_steps_reach_the_same_optimum() -> None:
    """Beyond 256 cells the curvature is a product; the truth is a start for neither."""
    recording = simulated(Scene(Panel(18, 16), READOUTS["two_point"], lines=Lines(1.0, 1.0)))
    done = solved(recording)
    assert all(step.solution.solved for step in done.steps)
    assert np.median(np.abs(error(done))) < 0.02


@pytest.mark.parametrize("formulation", ["nodal", "per_pixel"])
@pytest.mark.parametrize("keys", [{"lines": Lines(1.0, 1.0)}, {"faults": TOUCHING}], ids=["lines", "joined"])
def test_node_voltages_as_unknowns_say_that_they_know_no_wire(keys: Any, formulation: str, tmp_path: Path) -> None:
    simulated(Scene(Panel(6, 6), READOUTS["two_point"], **keys)).save(tmp_path / "panel.h5")
    (tmp_path / "run.yaml").write_text(
        f"schema: 1\nrecordings: [panel.h5]\nformulation: {formulation}\n"
        "estimators: {LSM: {terms: {misfit: {}}}}\n"
    )
    with pytest.raises(InputError, match=f"formulation: {formulation} knows neither lines, contacts nor faults"):
        read_run(tmp_path / "run.yaml")


def test_lines_without_resistance_are_no_wiring() -> None:
    assert Scene(Panel(3, 4), lines=Lines()).wiring is None
    assert Scene(Panel(3, 4), lines=Lines(0.0, 1e-9)).wiring is not None


@each_readout
def test_little_wire_does_little(readout: Readout) -> None:
    """No large conductance stands in the equations: a billionth of an ohm costs no digits."""
    cells = np.random.default_rng(1).uniform(100, 9000, size=(6, 8))
    bare, wired = (readout.exact_reading(cells, wiring) for wiring in (None, Wiring(Lines(1e-9, 0.0))))
    assert_allclose(wired, bare, rtol=1e-10)


@each_readout
@pytest.mark.parametrize("lines", [None, Lines(1.0, 2.0, "right", "top")])
def test_responses_to_wire_are_the_derivatives_of_readings(readout: Readout, lines: Lines | None) -> None:
    cells, step = np.random.default_rng(2).uniform(300, 9000, size=(5, 3)), 1e-4
    network = readout.network(cells, readout.ties(cells), None if lines is None else Wiring(lines))
    known, names = lines or Lines(), ("row_ohm_per_cell", "column_ohm_per_cell")
    for response, name in zip(wire_responses(network, known), names, strict=True):
        more: dict[str, Any] = {name: getattr(known, name) + step}
        longer = readout.exact_reading(cells, Wiring(replace(known, **more)))
        assert_allclose((longer - network.reading()) / step, response, rtol=1e-4, atol=1e-6 * np.abs(response).max())


def test_a_reading_bounds_the_cell_with_its_wire() -> None:
    """Of a small cell at the far end the wire is most of the reading: r ≥ R_m would forbid the truth."""
    cells = np.full((5, 6), 3000.0)
    cells[0, 0] = 5.0
    wiring, readout = Wiring(Lines(10.0, 10.0, "right", "bottom")), TwoPointReadout()
    reading = readout.exact_reading(cells, wiring)
    assert reading[0, 0] > 15 * cells[0, 0]
    bounds = Bounds(upper="none")
    assert np.all(bounds.limits(readout, reading, None, wiring)[0] <= cells)
    assert np.any(bounds.limits(readout, reading, None)[0] > cells)


@each_readout
@pytest.mark.parametrize("lines", [None, Lines(1.0, 0.5)], ids=["bare", "wire"])
def test_joined_lines_leave_the_rest_exact(readout: Readout, lines: Lines | None) -> None:
    """Of cells on one crossing the sum of conductances is right; each alone has bars without end, and says so."""
    recording = simulated(Scene(Panel(7, 8), readout, faults=TOUCHING, lines=lines, systematic="none"))
    done = solved(recording)
    assert all(step.solution.solved for step in done.steps)
    rows, columns = ([0, 2, 4, 5, 6], [1, 2, 3, 6, 7])
    sound = np.ix_([0, 1], rows, columns)
    assert np.median(np.abs(error(done)[sound])) < 0.01
    # With wire what touches is seen a little, and what nobody knows of it is in the bars of all others.
    assert np.all(bars(done)[sound] < (0.03 if lines is None else 0.3))
    touching = np.ones(recording.scene.panel.shape, dtype=bool)
    touching[np.ix_(rows, columns)] = False
    assert np.all(bars(done)[:, touching] > 1) and np.all(np.isinf(done.cell_resistance_upper[:, touching]))
    if lines is None:  # with wire the cells' ways are not alike, and their sum is not all that is seen
        truth = 1 / recording.truth_cell_resistance[done.frame]
        found = 1 / done.cell_resistance
        assert_allclose(
            found[:, [1, 3]][:, :, columns].sum(axis=1), truth[:, [1, 3]][:, :, columns].sum(axis=1), rtol=0.03
        )
    ignored = solved(replace(recording, scene=replace(recording.scene, faults=None)))
    assert np.median(np.abs(error(ignored)[sound])) > 5 * np.median(np.abs(error(done)[sound]))


@pytest.mark.parametrize("term", [LogRatio(weight=10.0), RelativeChange(weight=10.0)], ids=["log_ratio", "relative"])
def test_shares_that_only_a_penalty_tells_are_followed_to_their_optimum(term: Term) -> None:
    """The valley of cells that are parallel is curved: a straight step leaves it, and hundreds of them did not end."""
    recording = simulated(Scene(Panel(8, 6), READOUTS["two_point"], faults=Faults(joined_rows=((2, 3),))))
    done = solved(recording, terms=(*LSM, term))
    assert all(step.solution.status is Status.OPTIMUM for step in done.steps)
    assert done.steps[0].solution.iterations < 200


@each_readout
def test_lines_that_touch_are_read_alike_and_no_others(readout: Readout) -> None:
    for seed in range(5):
        touching = simulated(Scene(Panel(7, 8), readout, faults=TOUCHING), seed).readings()
        assert (touching_rows(touching), touching_columns(touching)) == (((1, 3),), ((0, 4, 5),))
        apart = simulated(Scene(Panel(7, 8), readout), seed).readings()
        assert (touching_rows(apart), touching_columns(apart)) == ((), ())


def test_equal_rows_are_no_rows_that_touch() -> None:
    """Where all rows read alike within the noise nothing is told."""
    noisy = TwoPointReadout(readings=1, noise_lsb=4)
    readings = simulate(Simulation(1, 2, Scene(Panel(6, 6), noisy), Cells(spread=0.0), frames=1)).readings()
    assert touching_rows(readings) == () and touching_columns(readings) == ()


@pytest.mark.parametrize(
    ("faults", "sentence"),
    [
        (Faults(joined_rows=((1,),)), "joined_rows lists groups of two or more"),
        (Faults(joined_rows=((1, 2), (2, 3))), "each row once"),
        (Faults(joined_columns=((1, 9),)), "there is no column 9"),
        (Faults(joined_rows=((1, 2),), dead_rows=(2,)), "cannot be dead and joined"),
    ],
)
def test_impossible_joins_are_refused(faults: Faults, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Scene(Panel(5, 5), faults=faults)
