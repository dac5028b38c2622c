"""Wire, held against badcrossbar (SoftwareX 12, 100617), contacts, touching lines, memory."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise
from scipy.optimize import minimize

from lampest import (
    Estimates,
    Faults,
    InputError,
    LoadedColumnsReadout,
    Recording,
    Rod,
    Scene,
    Squared,
    Status,
)
from lampest.cost.terms import Gradient, LogRatio, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.approximate import TruncatedMethod
from lampest.estimate.sequence import reconstruct
from lampest.panel.difference_network import wire_responses
from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.readouts.channel_memory import with_memory, without_memory
from lampest.panel.readouts.converter import sigma_code
from lampest.panel.readouts.wiring import (
    ContactPrior,
    Contacts,
    Lines,
    Wiring,
)
from lampest.recording.readings import Readings, Sidedness, equal_rows
from lampest.recording.simulation.measure import true_contacts
from lampest.recording.simulation.simulation import Cells, Simulation, simulate
from lampest.solvers.posed import Bounds
from tests.estimates import log_errors, rms, scores

LSM = (Misfit(weighting="noise"),)
THREAD = Lines(2.0, 4.0, "right", "top")
READOUTS = {
    "two_point": TwoPointReadout(adc_bits=14),
    "loaded": LoadedColumnsReadout(
        adc_bits=12, noise_lsb=1, load_ohm=3000.0, drive_ohm=100.0, driven="columns"
    ),
}
TOUCHING = Faults(joined_rows=((1, 3),), joined_columns=((0, 4, 5),))
each_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
PRIOR = Contacts(ContactPrior(60.0, 20.0), ContactPrior(150.0, 50.0))
MEMORY_FRACTION = 0.029  # seen in a real 16 × 16 skin
ROUNDING = 1e-12  # relative
NO_WIRE = 1e-10  # relative: a wire of 1e-9 ohm changes the order of sums; measured 1.4e-11
MAX_ERROR = 0.002  # median of |log r| with what the scene specifies; measured at most 0.0007
MIN_GAIN = 25  # of the median error of a scene that is silent; measured at least 75
RMS_ERROR = 0.3  # of the scores of 63 cells; three standard errors, 3/√(2n), are 0.27
RMS_ERROR_OF_CONTACTS = 0.25  # of 11 lines in 15 panels, which share cells; measured 0.13
# of error bars that hold; measured 0.83 and 1.05
MAX_RMS = 2.0
MAX_MEDIAN_SCORE = 1.5
# of cells on lines that touch no other, relative
MAX_BAR = 0.03
MAX_BAR_WITH_WIRE = 0.3
MOSTLY_WIRE = 15  # reading over cell at the far end of the wire; measured 22
MAX_ITERATIONS = 200  # where straight steps took many hundreds; measured 47
NARROWER = 0.04  # error of a change over that of a cell, which has its contacts'; measured 0.012
MOVED = 0.3  # prior standard deviations; measured at least 1.2
INFORMED = 0.7  # posterior over prior deviation of a contact; measured 0.41
DRAWS = 400
MAX_SPREAD_ERROR = 5 / np.sqrt(2 * DRAWS)  # five standard errors, for the largest of 60 readings
MEAN_SPREAD_ERROR = 0.02  # four standard errors of the mean over 60 readings
UNKNOWN_VOLTAGE = 10  # its deviation over the noise; measured 147
CONVERTERS = {
    "two_point": TwoPointReadout(adc_bits=12),
    "rows": LoadedColumnsReadout(adc_bits=12, noise_lsb=1, load_ohm=3000.0, drive_ohm=100.0),
    "columns down": LoadedColumnsReadout(
        adc_bits=12, noise_lsb=1, load_ohm=3000.0, driven="columns", polarity="down"
    ),
}
each_converter = pytest.mark.parametrize("readout", CONVERTERS.values(), ids=CONVERTERS)


def simulated(scene: Scene, seed: int = 3, **options: Any) -> Recording:
    rod = Rod(centre_mm=(30.0, 30.0), diameter_mm=35.0, mass_g=200.0)
    return simulate(Simulation(1, seed, scene, frames=2, loads=(rod,), **options))


def forgetting(recording: Recording, key: str) -> Recording:
    """The same recording with a scene that is silent on that."""
    return replace(recording, scene=replace(recording.scene, **{key: None}))


def solved(recording: Recording, formulation: Any = "reduced", terms: Any = LSM) -> Estimates:
    return reconstruct(recording, Estimator(terms, formulation))


@each_readout
def test_specified_wire_gives_the_cells(readout: Readout) -> None:
    recording = simulated(Scene(Panel(9, 7), readout, lines=THREAD, systematic="none"))
    estimate = solved(recording)
    ignored = solved(forgetting(recording, "lines"))
    assert np.median(np.abs(log_errors(estimate))) < MAX_ERROR
    assert np.median(np.abs(log_errors(ignored))) > MIN_GAIN * np.median(
        np.abs(log_errors(estimate))
    )
    assert abs(rms(scores(estimate)) - 1) < RMS_ERROR


@pytest.mark.long
@each_readout
@pytest.mark.parametrize("formulation", ["auto", TruncatedMethod(steps=8), "linearised"], ids=str)
def test_other_formulations_model_wire(readout: Readout, formulation: Any) -> None:
    recording = simulated(Scene(Panel(9, 7), readout, lines=THREAD))
    bare = simulated(Scene(Panel(9, 7), readout))
    error, bare_error = (
        np.median(np.abs(log_errors(solved(measured, formulation))))
        for measured in (recording, bare)
    )
    assert error < 1.5 * bare_error + MAX_ERROR / 2


def test_matrix_free_steps_reach_the_same_optimum() -> None:
    """Beyond 256 cells the curvature is a product; the truth is a start for neither."""
    recording = simulated(Scene(Panel(18, 16), READOUTS["two_point"], lines=Lines(1.0, 1.0)))
    estimate = solved(recording)
    assert all(step.solution.solved for step in estimate.steps)
    assert np.median(np.abs(log_errors(estimate))) < MAX_ERROR


def test_lines_without_resistance_need_no_wiring() -> None:
    assert Scene(Panel(3, 4), lines=Lines()).wiring is None
    assert Scene(Panel(3, 4), lines=Lines(0.0, 1e-9)).wiring is not None


@each_readout
def test_small_wire_resistance_changes_readings_little(readout: Readout) -> None:
    """No large conductance stands in the equations: a billionth of an ohm costs no digits."""
    cells = np.random.default_rng(1).uniform(100, 9000, size=(6, 8))
    bare, wired = (
        readout.exact_reading(cells, wiring) for wiring in (None, Wiring(Lines(1e-9, 0.0)))
    )
    assert_allclose(wired, bare, rtol=NO_WIRE)


@each_readout
@pytest.mark.parametrize("lines", [None, Lines(1.0, 2.0, "right", "top")])
def test_responses_to_wire_are_the_derivatives_of_readings(
    readout: Readout, lines: Lines | None
) -> None:
    cells = np.random.default_rng(2).uniform(300, 9000, size=(5, 3))
    step = 1e-4
    network = readout.network(cells, readout.ties(cells), None if lines is None else Wiring(lines))
    known = lines or Lines()
    names = ("row_ohm_per_cell", "column_ohm_per_cell")
    for response, name in zip(wire_responses(network, known), names, strict=True):
        lengthened: dict[str, Any] = {name: getattr(known, name) + step}
        longer = readout.exact_reading(cells, Wiring(replace(known, **lengthened)))
        assert_allclose(
            (longer - network.reading()) / step,
            response,
            rtol=1e-4,
            atol=1e-6 * np.abs(response).max(),
        )


def test_a_reading_bounds_the_cell_with_its_wire() -> None:
    """The wire is most of the reading of a small cell at the far end, so r ≥ R_m would be wrong."""
    cells = np.full((5, 6), 3000.0)
    cells[0, 0] = 5.0
    wiring = Wiring(Lines(10.0, 10.0, "right", "bottom"))
    readout = TwoPointReadout()
    reading = readout.exact_reading(cells, wiring)
    assert reading[0, 0] > MOSTLY_WIRE * cells[0, 0]
    bounds = Bounds(upper="none")
    assert np.all(bounds.limits(readout, reading, None, wiring)[0] <= cells)
    assert np.any(bounds.limits(readout, reading, None)[0] > cells)


@pytest.mark.long
@each_readout
@pytest.mark.parametrize("lines", [None, Lines(1.0, 0.5)], ids=["bare", "wire"])
def test_joined_lines_leave_the_other_cells_exact(readout: Readout, lines: Lines | None) -> None:
    """A single cell on a joined crossing has infinite error bars, and their sum is right."""
    recording = simulated(
        Scene(Panel(7, 8), readout, faults=TOUCHING, lines=lines, systematic="none")
    )
    solution = solved(recording)
    assert all(step.solution.solved for step in solution.steps)
    rows = [0, 2, 4, 5, 6]
    columns = [1, 2, 3, 6, 7]
    sound = np.ix_([0, 1], rows, columns)
    assert np.median(np.abs(log_errors(solution)[sound])) < MAX_ERROR
    # With wire, touching lines change the readings a little, and their uncertainty is in the bars
    # of all other cells.
    bars = solution.cell_resistance_errors / solution.cell_resistance
    assert np.all(bars[sound] < (MAX_BAR if lines is None else MAX_BAR_WITH_WIRE))
    touching = np.ones(recording.scene.panel.shape, dtype=bool)
    touching[np.ix_(rows, columns)] = False
    assert np.all(bars[:, touching] > 1) and np.all(
        np.isinf(solution.cell_resistance_upper[:, touching])
    )
    # With wire the paths through the cells differ, and readings show more than their sum.
    if lines is None:
        cells = (solution.cell_resistance, recording.truth_cell_resistance[solution.frame])
        combined, truth = ((1 / ohm[:, [1, 3]][:, :, columns]).sum(axis=1) for ohm in cells)
        assert_allclose(combined, truth, rtol=MAX_BAR)
    ignored = solved(forgetting(recording, "faults"))
    assert np.median(np.abs(log_errors(ignored)[sound])) > MIN_GAIN * np.median(
        np.abs(log_errors(solution)[sound])
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "term", [LogRatio(weight=10.0), RelativeChange(weight=10.0)], ids=["log_ratio", "relative"]
)
def test_shares_determined_only_by_a_penalty_reach_their_optimum(term: Term) -> None:
    """Hundreds of straight steps left the curved valley of cells that are parallel."""
    recording = simulated(
        Scene(Panel(8, 6), READOUTS["two_point"], faults=Faults(joined_rows=((2, 3),)))
    )
    estimate = solved(recording, terms=(*LSM, term))
    assert all(step.solution.status is Status.OPTIMUM for step in estimate.steps)
    assert estimate.steps[0].solution.iterations < MAX_ITERATIONS


@each_readout
def test_touching_lines_have_equal_readings_and_others_do_not(readout: Readout) -> None:
    for seed in range(5):
        touching = simulated(Scene(Panel(7, 8), readout, faults=TOUCHING), seed).readings()
        assert (equal_rows(touching), equal_rows(turned(touching))) == (((1, 3),), ((0, 4, 5),))
        apart = simulated(Scene(Panel(7, 8), readout), seed).readings()
        assert (equal_rows(apart), equal_rows(turned(apart))) == ((), ())


def turned(readings: Readings) -> Readings:
    """Return readings whose rows are the columns."""
    return readings.each(lambda part: part.swapaxes(-1, -2))


def contacted(
    readout: Readout, seed: int, spread: float = 0.2, frames: int = 1, shape: Any = (5, 6)
) -> Recording:
    scene = Scene(Panel(*shape), readout, contacts=PRIOR, systematic="none")
    return simulate(Simulation(1, seed, scene, Cells(spread=spread), frames=frames))


@each_readout
def test_contacts_hardly_affect_the_change_of_cells(readout: Readout) -> None:
    estimate = solved(contacted(readout, 5))
    bars = estimate.cell_resistance_errors / estimate.cell_resistance
    assert np.median(estimate.relative_change_errors / 100) < NARROWER * np.median(bars)


@each_readout
def test_plain_least_squares_leaves_contacts_as_uncertain_as_before(readout: Readout) -> None:
    estimate = solved(contacted(readout, 5))
    assert np.all(estimate.contacts.deviation((5, 6)) > 0.9 * PRIOR.deviation((5, 6)))


@pytest.mark.slow
@each_readout
def test_cells_and_contacts_end_at_the_joint_optimum(readout: Readout) -> None:
    """A quasi-Newton method minimises the whole cost of a baseline, with all unknowns at once."""
    recording = contacted(readout, 2, spread=0.02, shape=(4, 5))
    terms = (*LSM, Gradient(weight=1e-3))
    solution = solved(recording, terms=terms)
    scene = recording.scene
    readings = recording.readings()[recording.role == 0].mean()
    mean = PRIOR.mean((4, 5))
    deviation = PRIOR.deviation((4, 5))

    def cost(place: Array) -> float:
        cells = np.exp(place[:20]).reshape(4, 5)
        ohm = np.maximum(place[20:] * deviation + mean, 0.0)
        wiring = replace(scene, contacts=Contacts.of(ohm, deviation, 4)).wiring
        read = readout.network(cells, readout.ties(readings.value), wiring).reading()
        steps = np.gradient(cells)
        misfit = np.sum(((read - readings.value) / readings.sigma) ** 2)
        return float(
            misfit + 1e-3 * sum(np.sum(step**2) for step in steps) + np.sum(place[20:] ** 2)
        )

    estimate = np.r_[
        np.log(solution.baseline_resistance).ravel(),
        (solution.contacts.mean((4, 5)) - mean) / deviation,
    ]
    least = cost(estimate)
    # Contacts are not negative.
    within = [(None, None)] * 20 + [(low, None) for low in -mean / deviation]
    better = minimize(
        cost,
        estimate + 0.01,
        method="L-BFGS-B",
        bounds=within,
        options={"ftol": 1e-12, "gtol": 1e-3},
    )
    assert least <= better.fun * (1 + 1e-5)
    assert np.abs(estimate[20:]).max() > MOVED  # equal cells do tell of contacts
    # The posterior is narrower than the prior there, and its size right: over draws in the next
    # test.
    assert np.all(solution.contacts.deviation((4, 5)) <= deviation * (1 + ROUNDING))


@pytest.mark.slow
@each_readout
def test_errors_of_estimated_contacts_match_their_deviations(readout: Readout) -> None:
    deviations = []
    narrower = []
    for seed in range(15):
        recording = contacted(readout, seed, spread=0.0)
        estimate = solved(recording, terms=(*LSM, Gradient(weight=1e-2)))
        truth = true_contacts(recording.scene, seed).mean((5, 6))
        deviations.append(
            (estimate.contacts.mean((5, 6)) - truth) / estimate.contacts.deviation((5, 6))
        )
        narrower.append(estimate.contacts.deviation((5, 6)) / PRIOR.deviation((5, 6)))
    assert np.median(narrower) < INFORMED
    assert abs(rms(deviations) - 1) < RMS_ERROR_OF_CONTACTS


@pytest.mark.parametrize(
    "terms",
    [(LogRatio(weight=10.0, loss=Squared()),), (LogRatio(weight="auto"),)],
    ids=["squared", "auto"],
)
def test_methods_with_a_baseline_model_contacts(terms: tuple[Term, ...]) -> None:
    """The joint first pair estimates them; later frames go on with them."""
    recording = contacted(READOUTS["two_point"], 6, frames=3)
    estimate = solved(recording, terms=(*LSM, *terms))
    assert all(step.solution.solved for step in estimate.steps)
    assert estimate.contacts is not None and estimate.cell_resistance_errors is not None
    assert rms(scores(estimate)) < MAX_RMS


def test_known_contacts_are_not_estimated() -> None:
    scene = Scene(
        Panel(5, 6),
        READOUTS["two_point"],
        contacts=Contacts(ContactPrior((10.0, 20.0, 30.0, 40.0, 50.0))),
    )
    estimate = solved(simulate(Simulation(1, 1, scene, frames=1)))
    assert_allclose(estimate.contacts.mean((5, 6))[:5], [10, 20, 30, 40, 50])
    assert np.median(np.abs(scores(estimate))) < MAX_MEDIAN_SCORE


def volts(readout: Readout, shape: tuple[int, ...]) -> Array:
    return np.asarray(np.random.default_rng(4).uniform(0.2, 0.8, size=shape) * readout.supply_volt)


@promise("howto/devices: lampest inverts the equation exactly")
@each_converter
def test_the_converter_memory_is_corrected_exactly_with_its_noise(readout: Readout) -> None:
    volt = volts(readout, (3, 5, 4))
    recorded = readout.recorded_from_volt(with_memory(readout, MEMORY_FRACTION, volt))
    freed, sigma = without_memory(readout, MEMORY_FRACTION, recorded, readout.sigma(recorded))
    assert_allclose(freed, readout.recorded_from_volt(volt), rtol=ROUNDING)
    rng = np.random.default_rng(8)
    size = sigma_code(readout) * readout.lsb_volt
    draws = []
    for _ in range(DRAWS):
        noisy = readout.recorded_from_volt(
            with_memory(readout, MEMORY_FRACTION, volt) + size * rng.normal(size=volt.shape)
        )
        draws.append(without_memory(readout, MEMORY_FRACTION, noisy, readout.sigma(noisy))[0])
    assert_allclose(np.std(draws, axis=0), sigma, rtol=MAX_SPREAD_ERROR)
    assert np.mean(np.std(draws, axis=0) / sigma) == pytest.approx(1, abs=MEAN_SPREAD_ERROR)


def test_a_missing_channel_leaves_the_remembered_voltage_unknown() -> None:
    readout = CONVERTERS["rows"]
    volt = volts(readout, (4, 4))
    recorded = with_memory(readout, MEMORY_FRACTION, volt)
    recorded[1, 2] = np.nan
    freed, sigma = without_memory(readout, MEMORY_FRACTION, recorded, readout.sigma(recorded))
    known = np.isfinite(freed)
    assert np.argwhere(~known).tolist() == [[1, 2]]
    errors = np.abs(freed - volt)
    assert 0 < errors[1, 3] < 3 * sigma[1, 3] and sigma[1, 3] > UNKNOWN_VOLTAGE * sigma[0, 0]
    unaffected = known & (np.arange(16).reshape(4, 4) != 7)
    assert np.all(errors[unaffected] < ROUNDING)


def test_a_rail_stays_a_bound() -> None:
    readout = CONVERTERS["rows"]
    scene = Scene(Panel(3, 4), readout, converter_memory=MEMORY_FRACTION)
    volt = volts(readout, (3, 4))
    volt[1, 1], volt[2, 2] = readout.volt_from_code(np.array([0, 2**12 - 1]))
    side = Readings.of(scene, volt).side
    assert (side[1, 1], side[2, 2]) == (Sidedness.AT_MOST, Sidedness.AT_LEAST) and np.count_nonzero(
        side
    ) == 2


def test_impossible_memories_are_refused() -> None:
    unknown = Scene(Panel(3, 3), converter_memory=0.1)
    with pytest.raises(InputError, match="needs a readout in the scene"):
        Readings.of(unknown, np.full((3, 3), 500.0))
    with pytest.raises(ValueError, match="needs a readout in the scene"):
        Simulation(1, 1, unknown)


with warnings.catch_warnings():  # it warns that it cannot draw where cairo is missing
    import badcrossbar


def log_normal_cells(rows: int, columns: int) -> Array:
    return np.asarray(
        3000 * np.exp(np.random.default_rng(rows * columns).normal(size=(rows, columns)))
    )


def network_of(cells: Array, lines: Lines, ties: Array) -> SolvedNetwork:
    network = TwoPointReadout().network(cells, ties, Wiring(lines))
    assert isinstance(network, SolvedNetwork)
    return network


def badcrossbar_of(cells: Array, row_ohm: float, column_ohm: float) -> Any:
    """With one volt at one row after the other."""
    return badcrossbar.compute(
        np.eye(len(cells)), cells, r_i_word_line=row_ohm, r_i_bit_line=column_ohm
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1), (5, 8), (9, 4), (16, 16)])
@pytest.mark.parametrize("ohm", [(1.0, 1.0), (0.3, 20.0), (50.0, 0.02), (0.0, 3.0), (3.0, 0.0)])
def test_currents_and_voltages_equal_those_of_badcrossbar(
    shape: tuple[int, int], ohm: tuple[float, float]
) -> None:
    rows, columns = shape
    cells = log_normal_cells(rows, columns)
    reference = badcrossbar_of(log_normal_cells(rows, columns), *ohm)
    ties = np.full(rows + columns, 1e-3)
    network = network_of(cells, Lines(*ohm), ties)
    # The impedances know of grounded terminals as well: Z⁻¹ − diag(t) are the currents into them.
    admittance = np.linalg.inv(network.potentials()) - np.diag(ties)
    assert_allclose(
        -admittance[rows:, :rows].T,
        np.reshape(reference.currents.output, (rows, columns)),
        rtol=1e-10,
    )
    through = network.potential_differences.T @ np.linalg.inv(network.potentials())[:, :rows]
    reference_through = np.reshape(reference.currents.device, (rows, columns, rows))
    assert_allclose(
        through.reshape(rows, columns, rows) / cells[..., None],
        reference_through,
        rtol=1e-10,
        atol=1e-17,
    )
