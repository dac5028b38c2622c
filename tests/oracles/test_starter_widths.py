"""Error bars of the scenes of `lampest init`: as wide as the errors of the parts that they name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lampest
from lampest import Scene
from lampest.audit.widths import NOISE, Width, simulated_widths, widths_of
from lampest.files.document import read_document, validated
from lampest.inference.prepared import Prepared
from lampest.recording.simulation import Simulation, simulate
from lampest.report.info import describe
from lampest.runs.starter import SIMULATION, write_starter

DRAWS = 8
SIDE = 6


def starter(folder: Path, circuit: str) -> Simulation:
    """Return the simulation of a starter."""
    write_starter(folder, circuit, SIDE, SIDE)
    simulation: Simulation = validated(read_document(folder / SIMULATION), Simulation)
    return simulation


def with_series(scene: Scene, ohm: float) -> Scene:
    """Return the scene with more ohm in series with the driven lines."""
    if scene.series_resistance_ohm:
        return replace(scene, series_resistance_ohm=scene.series_resistance_ohm + ohm)
    return replace(scene, readout=replace(scene.readout, drive_ohm=scene.readout.drive_ohm + ohm))


@pytest.mark.slow
@pytest.mark.parametrize("circuit", ["grounded", "two_mux", "amplifiers"])
def test_error_bars_of_a_starter_are_as_wide_as_the_errors_of_its_parts(
    tmp_path: Path, circuit: str
) -> None:
    """z = error/σ of drawn parts has an rms of about one; `DRAWS` draws scatter by a quarter."""
    simulation = starter(tmp_path, circuit)
    sizes = simulation.scene.systematic
    rng = np.random.default_rng(5)
    squares = []
    for seed in range(DRAWS):
        ohm = float(sizes.series_tolerance_ohm * rng.standard_normal())
        parts = replace(
            simulation.unmodelled, reference_tolerance=sizes.reference_tolerance, inl_lsb=0.5
        )
        actual = replace(
            simulation,
            seed=seed,
            frames=2,
            scene=with_series(simulation.scene, ohm),
            unmodelled=parts,
        )
        recording = replace(simulate(actual, "drawn"), scene=simulation.scene)
        done = lampest.reconstruct(recording, [lampest.Misfit(weighting="noise")])
        error = done.cell_resistance - recording.truth_cell_resistance[recording.role == 1]
        squares.append(np.median((error / done.cell_resistance_errors) ** 2))
    # the median of z² of a normal z is 0.455
    rms = np.sqrt(np.mean(squares))
    assert 0.5 < rms < 1.7


def test_the_shares_are_those_of_the_errors_alone(tmp_path: Path) -> None:
    """Without an error the variance is smaller by its share; all shares make the whole."""
    recording = simulate(starter(tmp_path, "grounded"), "starter")
    scene = recording.scene
    whole = simulated_widths(recording)
    assert [width.what for width in whole] == ["cells", "changes"]
    for width in whole:
        assert sum(width.shares.values()) == pytest.approx(1)
    without = replace(
        recording,
        scene=replace(scene, systematic=replace(scene.systematic, series_tolerance_ohm=None)),
    )
    for width, smaller in zip(whole, simulated_widths(without), strict=True):
        assert "series_tolerance_ohm" not in smaller.shares
        remaining_share = 1 - width.shares["series_tolerance_ohm"]
        assert (smaller.deviation / width.deviation) ** 2 == pytest.approx(
            remaining_share, abs=0.05
        )
    by_fit = widths_of(Prepared(recording))
    for width, fitted in zip(whole, by_fit, strict=True):
        assert fitted.deviation == pytest.approx(width.deviation, rel=0.3)


@pytest.mark.slow
def test_lines_of_a_starter_and_info_state_the_shares(tmp_path: Path) -> None:
    write_starter(tmp_path, "two_mux", SIDE, SIDE)
    scene = (tmp_path / "scene.yaml").read_text()
    for key in ("reference_tolerance", "series_tolerance_ohm", "inl_lsb", "wire_ohm_per_cell"):
        (line,) = (line for line in scene.splitlines() if line.startswith(f"  {key}: "))
        assert " %: " in line and "cells" in line and "changes" in line
    width = Width("cells", 0.034, {NOISE: 0.1, "reference_tolerance": 0.896, "inl_lsb": 0.004})
    assert width.sentence == "cells 3.4 %: reference_tolerance 90 %, noise 10 %"
    shown = "\n".join(describe(tmp_path / "example.h5"))
    assert "\nwidth      cells " in shown and "\n           changes " in shown
