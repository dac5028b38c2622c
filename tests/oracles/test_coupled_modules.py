"""Terms over the seams of modules, where a scene asks for them: one problem, whose network falls into blocks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import lampest
from lampest import InputError, Recording, Scene, Simulation, simulate, two_point_resistance
from lampest.panel.panel import EachModule, Modules

LAYOUT = Modules(2, 2, EachModule(3, 4), 4.0, coupled=True)
READOUT = lampest.TwoPointReadout(reference_ohm=1000, adc_bits=12, readings=20, noise_lsb=0.7)
DEAD = lampest.Faults(dead_modules=((1, 1),))


def taken(layout: Modules = LAYOUT, faults: lampest.Faults | None = None) -> Recording:
    """A rod where four modules meet."""
    rod = lampest.Rod(centre_mm=(36, 24), diameter_mm=45, mass_g=900)
    scene = Scene(lampest.Panel(modules=layout), READOUT, 140.0, faults=faults)
    return simulate(Simulation(schema=1, seed=2, scene=scene, frames=3, loads=(rod,)))


def solved(recording: Recording, *terms: lampest.Term) -> lampest.Estimates:
    return lampest.reconstruct(recording, [lampest.Misfit(), *terms], formulation="reduced", error_bars=False)


def apart(recording: Recording, *terms: lampest.Term) -> lampest.Estimates:
    layout = replace(recording.scene.panel.modules or LAYOUT, coupled=False)
    scene = replace(recording.scene, panel=lampest.Panel(modules=layout))
    return solved(replace(recording, scene=scene), *terms)


def cost(recording: Recording, cells: NDArray[np.float64], frame: int, weight: float) -> float:
    """Σ (R − R_m)² + λ Σ (ln r_b/r_a)²/d², written down anew."""
    layout, panel = LAYOUT, recording.scene.panel
    measured = layout.split(recording.recorded[frame] - 140.0)
    found = sum(np.sum((two_point_resistance(c) - m) ** 2) for c, m in zip(layout.split(cells), measured, strict=True))
    x, y = (line / panel.pitch_mm for line in panel.centres_mm())
    logarithm = np.log(cells)
    steps = (np.diff(logarithm, axis=0) / np.diff(y)[:, None], np.diff(logarithm, axis=1) / np.diff(x))
    return float(found + weight * sum(np.sum(step**2) for step in steps))


def test_what_couples_no_cells_is_as_without_coupling() -> None:
    recording = taken()
    penalty = lampest.CellResistance(weight=1e-7)
    one, other = solved(recording, penalty), apart(recording, penalty)
    assert all(status == "optimum verified" for status in one.status)
    np.testing.assert_allclose(one.cell_resistance, other.cell_resistance, rtol=1e-5)
    np.testing.assert_allclose(one.baseline_resistance, other.baseline_resistance, rtol=1e-5)


def test_differences_over_seams_count_by_their_distance() -> None:
    recording, weight = taken(), 3e4
    found, without = (one(recording, lampest.LogGradient(weight=weight)) for one in (solved, apart))
    assert found.solved.all()
    random = np.random.default_rng(1)
    for place, frame in enumerate(found.frame):
        cells = found.cell_resistance[place]
        least = cost(recording, cells, frame, weight)
        assert least == pytest.approx(found.steps[place].solution.objective, rel=1e-9)
        beside = (cells * np.exp(1e-3 * random.standard_normal(cells.shape)) for _ in range(20))
        assert all(cost(recording, one, frame, weight) > least for one in beside)
        assert cost(recording, without.cell_resistance[place], frame, weight) > 1.001 * least


@pytest.mark.parametrize("penalty", [lampest.Gradient(weight=1e-6), lampest.TotalVariation(weight=0.1)])
def test_modules_that_were_not_read_are_missing_and_others_stay(penalty: lampest.Term) -> None:
    recording = taken(replace(LAYOUT, seam_mm=0.0), DEAD)
    gone = recording.recorded.copy()
    gone[4, :3, :4] = np.nan
    found = solved(replace(recording, recorded=gone), penalty)
    assert found.solved.all()
    assert np.isnan(found.cell_resistance[:, 3:, 4:]).all() and np.isnan(found.baseline_resistance[3:, 4:]).all()
    parts = np.isnan(found.cell_resistance)
    assert parts[1, :3, :4].all() and not parts[1, 3:, :4].any() and not parts[[0, 2], :3].any()


def test_coupled_modules_have_no_error_bars_and_no_wire() -> None:
    recording = taken()
    with pytest.raises(InputError, match="have none"):
        lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient()], error_bars=True)
    wired = replace(recording.scene, lines=lampest.Lines(row_ohm_per_cell=1.0))
    with pytest.raises(InputError, match="is wired"):
        solved(replace(recording, scene=wired), lampest.Gradient(weight=1e-6))
