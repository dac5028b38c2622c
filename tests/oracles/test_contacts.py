"""Contacts beside the cells: the joint optimum against a general minimiser, posteriors against draws."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from lampest import Array, Cells, Estimates, Estimator, Panel, Recording, Scene, Simulation, Squared, read_run, simulate
from lampest.cost.terms import Gradient, LogRatio, Misfit, Term
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import LoadedColumnsReadout, Readout, TwoPointReadout
from lampest.panel.readouts.wiring import ContactPrior, Contacts
from lampest.recording.simulation.measure import true_contacts
from lampest.runs.batch import run_batch
from lampest.runs.executors import Serial
from lampest.runs.results import read_results
from tests.netlist import impedance_of

READOUTS = {
    "two_point": TwoPointReadout(adc_bits=14),
    "loaded": LoadedColumnsReadout(adc_bits=12, noise_lsb=1, load_ohm=3000.0, drive_ohm=100.0),
}
each_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
LSM = (Misfit(weighting="noise"),)
PRIOR = Contacts(ContactPrior(60.0, 20.0), ContactPrior(150.0, 50.0))


def recorded(readout: Readout, seed: int, spread: float = 0.2, frames: int = 1, shape: Any = (5, 6)) -> Recording:
    scene = Scene(Panel(*shape), readout, contacts=PRIOR, systematic="none")
    return simulate(Simulation(1, seed, scene, Cells(spread=spread), frames=frames))


def solved(recording: Recording, terms: tuple[Term, ...] = LSM) -> Estimates:
    return reconstruct(recording, Estimator(terms, "reduced"))


def in_bars(done: Estimates) -> Array:
    """Errors of log r in their standard deviations."""
    truth, errors = done.recording.truth_cell_resistance, done.cell_resistance_errors
    return np.asarray(np.log(done.cell_resistance / truth[done.frame]) / (errors / done.cell_resistance))


@each_readout
def test_contacts_are_resistors_at_the_terminals(readout: Readout) -> None:
    """With ties beyond the contacts: a netlist in which every terminal has one more resistor."""
    rng = np.random.default_rng(4)
    cells, ohm = rng.uniform(300, 4000, size=(4, 5)), rng.uniform(10, 300, size=9)
    scene = Scene(Panel(4, 5), readout, contacts=Contacts.of(ohm, np.zeros(9), 4))
    ties = np.full(9, 1e-3)
    bare = impedance_of(cells, Scene(Panel(4, 5), readout), np.zeros(9) + 1e-9)
    inner = np.linalg.inv(bare) - np.diag(np.zeros(9) + 1e-9)
    whole = np.block([[np.diag(1 / ohm + ties), -np.diag(1 / ohm)], [-np.diag(1 / ohm), inner + np.diag(1 / ohm)]])
    expected = np.linalg.inv(whole)[:9, :9]
    assert_allclose(readout.network(cells, ties, scene.wiring).potentials(), expected, rtol=1e-6)


@pytest.mark.slow
@each_readout
def test_plain_least_squares_learns_nothing_of_contacts_and_its_bars_say_so(readout: Readout) -> None:
    """As many readings as cells: the prior stays. Over draws the errors are as large as the bars."""
    scores = []
    for seed in range(12):
        done = solved(recorded(readout, seed))
        assert_allclose(done.contacts.mean((5, 6)), PRIOR.mean((5, 6)), rtol=1e-3)
        assert_allclose(done.contacts.deviation((5, 6)), PRIOR.deviation((5, 6)), rtol=1e-2)
        scores.append(in_bars(done))
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25


@pytest.mark.slow
@each_readout
def test_forgotten_contacts_are_far_outside_the_bars(readout: Readout) -> None:
    recording = recorded(readout, 3)
    ignored = solved(replace(recording, scene=replace(recording.scene, contacts=None)))
    assert np.sqrt(np.mean(in_bars(ignored) ** 2)) > 5 * np.sqrt(np.mean(in_bars(solved(recording)) ** 2))


@each_readout
def test_the_change_of_cells_hardly_knows_of_contacts(readout: Readout) -> None:
    """They are the same in both frames: bars of changes are far narrower than those of cells."""
    done = solved(recorded(readout, 5))
    assert np.median(done.relative_change_errors / 100) < 0.3 * np.median(
        done.cell_resistance_errors / done.cell_resistance
    )


@pytest.mark.slow
@each_readout
def test_cells_and_contacts_end_at_the_joint_optimum(readout: Readout) -> None:
    """The whole cost of a baseline, with everything unknown at once, in the hands of a quasi-Newton method."""
    recording = recorded(readout, 2, spread=0.02, shape=(4, 5))
    terms = (*LSM, Gradient(weight=1e-3))
    done, scene = solved(recording, terms), recording.scene
    readings = recording.readings()[recording.role == 0].mean()
    mean, deviation = PRIOR.mean((4, 5)), PRIOR.deviation((4, 5))

    def cost(place: Array) -> float:
        cells, ohm = np.exp(place[:20]).reshape(4, 5), place[20:] * deviation + mean
        wiring = replace(scene, contacts=Contacts.of(ohm, deviation, 4)).wiring
        read = readout.network(cells, readout.ties(readings.value), wiring).reading()
        steps = np.gradient(cells)
        misfit = np.sum(((read - readings.value) / readings.sigma) ** 2)
        return float(misfit + 1e-3 * sum(np.sum(step**2) for step in steps) + np.sum(place[20:] ** 2))

    found = np.concatenate([np.log(done.baseline_resistance).ravel(), (done.contacts.mean((4, 5)) - mean) / deviation])
    least = cost(found)
    better = minimize(cost, found + 0.01, method="BFGS", options={"gtol": 1e-3})
    assert least <= better.fun * (1 + 1e-5) + 1e-6
    assert np.abs(found[20:]).max() > 0.3  # equal cells do tell of contacts
    # The posterior is narrower than the prior there, and its size right: over draws in the next test.
    assert np.all(done.contacts.deviation((4, 5)) <= deviation * (1 + 1e-9))


@pytest.mark.slow
@each_readout
def test_estimates_of_contacts_are_as_far_off_as_they_say(readout: Readout) -> None:
    """Cells of equal resistance and a penalty that knows it."""
    far, narrower = [], []
    for seed in range(15):
        recording = recorded(readout, seed, spread=0.0)
        done = solved(recording, (*LSM, Gradient(weight=1e-2)))
        truth = true_contacts(recording.scene, seed).mean((5, 6))
        far.append((done.contacts.mean((5, 6)) - truth) / done.contacts.deviation((5, 6)))
        narrower.append(done.contacts.deviation((5, 6)) / PRIOR.deviation((5, 6)))
    assert np.median(narrower) < 0.7
    assert 0.75 < np.sqrt(np.mean(np.square(far))) < 1.25


@pytest.mark.parametrize(
    "terms", [(LogRatio(weight=10.0, loss=Squared()),), (LogRatio(weight="auto"),)], ids=["squared", "auto"]
)
def test_methods_that_look_back_know_contacts(terms: tuple[Term, ...]) -> None:
    """The joint first pair estimates them; later frames go on with them."""
    recording = recorded(READOUTS["two_point"], 6, frames=3)
    done = solved(recording, (*LSM, *terms))
    assert all(step.solution.solved for step in done.steps)
    assert done.contacts is not None and done.cell_resistance_errors is not None
    assert np.sqrt(np.mean(in_bars(done) ** 2)) < 2


def test_results_hold_contacts_with_their_errors(tmp_path: Path) -> None:
    recorded(READOUTS["loaded"], 1).save(tmp_path / "panel.h5")
    (tmp_path / "run.yaml").write_text(
        "schema: 1\nrecordings: [panel.h5]\nformulation: reduced\n"
        "estimators: {LSM: {terms: {misfit: {weighting: noise}}}}\n"
    )
    run_batch(read_run(tmp_path / "run.yaml"), tmp_path / "out", Serial())
    (case,) = read_results(tmp_path / "out" / "results.h5").cases
    assert len(case.contacts) == 2 * (5 + 6)
    assert_allclose(case.contacts["row_4"], 60.0, rtol=1e-3)
    assert_allclose(case.contacts["column_5_errors"], 50.0, rtol=1e-2)


def test_known_contacts_are_not_estimated() -> None:
    scene = Scene(Panel(5, 6), READOUTS["two_point"], contacts=Contacts(ContactPrior((10.0, 20.0, 30.0, 40.0, 50.0))))
    done = solved(simulate(Simulation(1, 1, scene, frames=1)))
    assert_allclose(done.contacts.mean((5, 6))[:5], [10, 20, 30, 40, 50])
    assert np.median(np.abs(in_bars(done))) < 1.5


def test_a_list_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"contacts\.rows\.mean_ohm lists 2 numbers, but there are 3 such lines"):
        Scene(Panel(3, 4), contacts=Contacts(ContactPrior((1.0, 2.0))))
