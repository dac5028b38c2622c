"""What is broken leaves the model; what only bounds a reading is used as a bound."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, Bounds, Estimator, Faults, Panel, Recording, Scene, TwoPointReadout, two_point_resistance
from lampest.cost.terms import CellResistance, Gradient, GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.estimate.sequence import reconstruct
from lampest.recording.readings import AT_LEAST, AT_MOST

SHAPE = (6, 7)
SIGMA = 0.01
LSM = (Misfit(),)


def cells(seed: int = 0) -> Array:
    """Three frames of some thousand ohm, the last with a pressed patch."""
    generator = np.random.default_rng(seed)
    frames = np.repeat(3000 * np.exp(0.2 * generator.standard_normal((1, *SHAPE))), 3, axis=0)
    frames[2, 2:4, 3:5] *= 0.2
    return frames


def recording(truth: Array, faults: Faults | None = None, readout: TwoPointReadout | None = None) -> Recording:
    """Exact readings with a small σ, one unloaded frame."""
    scene = Scene(Panel(*SHAPE), readout, 0.0, faults)
    role = np.array([0, *([1] * (len(truth) - 1))], dtype=np.uint8)
    resistance = two_point_resistance(truth)
    sigma = np.full(resistance.shape, SIGMA)
    finite = np.where(np.isfinite(resistance) & (resistance > 0), resistance, 1.0)
    return Recording(scene, finite, np.arange(len(truth), dtype=float), role, sigma)


FAULTS = {
    "open cell": (Faults(open=((1, 2),)), lambda truth: truth[:, 1, 2].fill(np.inf)),
    "shorted cell": (Faults(shorted=((4, 5),)), lambda truth: truth[:, 4, 5].fill(0.0)),
    "dead row": (Faults(dead_rows=(3,)), lambda truth: truth[:, 3].fill(np.inf)),
    "dead column": (Faults(dead_columns=(0,)), lambda truth: truth[:, :, 0].fill(np.inf)),
}


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
@pytest.mark.parametrize("name", FAULTS)
def test_known_fault_leaves_the_rest_exact(name: str, formulation: str) -> None:
    faults, breaks = FAULTS[name]
    truth = cells()
    breaks(truth)
    found = reconstruct(recording(truth, faults), Estimator(LSM, formulation=formulation))
    sound = ~(faults.open_cells(Panel(*SHAPE)) | faults.shorted_cells(Panel(*SHAPE)))
    # The two lines of a short are one node: what joins another line to either of them is only seen in parallel.
    if faults.shorted:
        ((row, column),) = faults.shorted
        sound[row], sound[:, column] = False, False
    assert all(step.solution.solved for step in found.steps)
    assert_allclose(found.cell_resistance[:, sound], truth[1:][:, sound], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "terms",
    [
        (Misfit(), CellResistance(weight=1e-3)),
        (Misfit(), Gradient(weight=1e-3)),
        (Misfit(), RelativeChange(weight=10)),
        (Misfit(), GradientOfRelativeChange(weight=10)),
    ],
    ids=lambda terms: terms[1].kind,
)
def test_penalties_do_not_see_broken_cells(terms: tuple[Term, ...]) -> None:
    """An open cell of 10⁹ times the others would drown every penalty that reads it."""
    truth = cells()
    truth[:, 1, 2] = np.inf
    found = reconstruct(recording(truth, Faults(open=((1, 2),))), Estimator(terms, formulation="reduced"))
    assert all(step.solution.solved for step in found.steps)
    assert all(step.solution.objective < 1e9 for step in found.steps)
    others = np.ones(SHAPE, dtype=bool)
    others[1, 2] = False
    assert np.all(found.cell_resistance[:, others] < 1e5)


@pytest.mark.slow
def test_unknown_open_cell_is_flagged() -> None:
    truth = cells()
    truth[:, 1, 2] = np.inf
    found = reconstruct(recording(truth), Estimator(LSM, formulation="reduced"))
    flags = np.stack([step.solution.open_cell[-1] for step in found.steps])
    assert np.all(flags[:, 1, 2])
    assert flags.sum() == len(flags)


@pytest.mark.slow
def test_unknown_short_is_flagged() -> None:
    """A reading of zero within its noise is a bound, and the cell behind it ends at the least that bounds allow."""
    truth = cells()
    truth[:, 4, 5] = 1e-3
    found = reconstruct(recording(truth), Estimator((Misfit(), CellResistance(weight=1e-9)), formulation="reduced"))
    for step in found.steps:
        assert step.solution.solved
        assert step.solution.cell_resistance[-1][4, 5] < 10 * SIGMA


@pytest.mark.slow
def test_saturated_codes_are_bounds() -> None:
    """One row far above what 4 bits can tell: its readings bound it from below and do not pull it down to the rail."""
    readout = TwoPointReadout(adc_bits=4, noise_lsb=0.0, readings=1, reference_ohm=100.0)
    truth = np.full((2, *SHAPE), 500.0)
    truth[:, 0] = 1e5
    made = recording(truth, readout=readout)
    least, largest = readout.rails()
    made = replace(made, recorded=np.where(made.resistance > largest, 10 * largest, made.resistance))
    readings = made.readings()
    beyond = made.resistance > largest
    assert np.array_equal(beyond, truth == 1e5)
    assert np.all(readings.side[beyond] == AT_LEAST)
    assert np.all(readings.value[beyond] == largest)
    low = replace(made, recorded=np.full_like(made.resistance, least / 2))
    assert np.all(low.readings().side == AT_MOST)
    found = reconstruct(made, Estimator(LSM, bounds=Bounds(upper="none"), formulation="reduced"))
    model = found.steps[0].solution.reading[-1]
    assert found.steps[0].solution.solved
    assert np.all(model[beyond[1]] >= largest * (1 - 1e-6))


@pytest.mark.parametrize(
    ("faults", "sentence"),
    [
        (Faults(open=((6, 0),)), "there is no cell"),
        (Faults(dead_rows=(9,)), "there is no row 9"),
        (Faults(open=((1, 1),), shorted=((1, 1),)), "open and shorted"),
        (Faults(dead_rows=tuple(range(6))), "nothing is left"),
    ],
)
def test_impossible_faults_are_refused(faults: Faults, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Scene(Panel(*SHAPE), None, 0.0, faults)


def test_readings_below_the_series_resistance_are_bounds() -> None:
    """However far below: they say that the cells are small, not how small."""
    made = recording(cells())
    wrong = replace(made, scene=replace(made.scene, series_resistance_ohm=float(made.resistance.max()) * 2))
    readings = wrong.readings()
    assert np.all(readings.side == AT_MOST) and np.all(readings.seen == 1)
    assert np.all((readings.value > 0) & (readings.value < made.resistance))
