"""Readings that are missing, at a rail or beyond the bounds."""

import csv
import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from promises import promise

import lampest
from lampest import Faults, Panel, Simulation, simulate
from tests.estimates import recording_of

Command = Callable[..., SimpleNamespace]
TOO_FEW_READINGS = "too few of the frame's readings are values: the others are missing, or bounds"
MAX_ERROR_PERCENT = 2  # mean error of cells
MIN_COVERAGE_PERCENT = 80  # of 95 % intervals: cells of one panel share errors
MAX_CHANGE_PERCENT = 5.0  # of cells that do not change, by their noise
SCENE = lampest.Scene(lampest.Panel(4, 5), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
RUN = """schema: 1
recordings: [{}]
formulation: reduced
estimators:
  LSM: {{terms: {{misfit: {{}}}}}}
  LSR-gCR: {{terms: {{misfit: {{}}, gradient: {{weight: 1.0e-3}}}}}}
"""
OPTIMUM_AT_BOUNDS = "an optimum, but only within the bounds"
VERIFIED = "local optimum verified"
PLAIN = lampest.Scene(lampest.Panel(6, 6))
LOADED = lampest.Scene(lampest.Panel(6, 6), lampest.TwoPointReadout(adc_bits=14, noise_lsb=2.0))


def healthy(seed: int) -> np.ndarray:
    """(7, 4, 5) ohm as the divider gives it: two unloaded frames, five with a pressed cell."""
    cells = np.full((7, 4, 5), 2000.0)
    cells[2:, 1, 2] = 700.0
    exact = lampest.two_point_resistance(cells) + 140.0
    return exact + np.random.default_rng(seed).normal(0.0, 0.3, exact.shape)


def recorded(path: Path, values: np.ndarray) -> Path:
    recording_of(SCENE, values, 2, name=path.stem).save(path)
    return path


@pytest.mark.slow
@promise("howto/readings: **Recordings that cannot be read** fail their own cases only")
def test_a_batch_skips_only_the_truncated_file(tmp_path: Path, lampest: Command) -> None:
    values = healthy(2)
    values[2, 0, 1] = np.nan
    values[2, 2, 2] = np.inf  # which the other readings do not allow
    values[3, 3] = np.nan
    values[4] = np.nan
    values[5, 3] = np.inf
    recorded(tmp_path / "holes.h5", values)
    cut = recorded(tmp_path / "cut.h5", healthy(3))
    cut.write_bytes(cut.read_bytes()[:3000])
    (tmp_path / "run.yaml").write_text(RUN.format("cut.h5, holes.h5"))
    completed = lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "out", "--jobs", "1")
    assert completed.code == 3 and "2 cases solved" in completed.out and "2 failed" in completed.out
    assert (
        "cut × LSM" in completed.err
        and "not a readable HDF5 file" in completed.err
        and "Traceback" not in completed.err
    )
    with h5py.File(tmp_path / "out" / "results.h5") as file:
        assert set(file["entry"]) == {"holes"}
        status = [text.decode() for text in file["entry/holes/LSM/status"]]
        assert [text == TOO_FEW_READINGS for text in status] == [False, False, True, False, False]
        cells = file["entry/holes/LSM/cell_resistance"][()]
        assert np.isnan(cells[2]).all() and np.isfinite(cells[[0, 1, 3, 4]]).all()
        given = file["entry/holes/recording"]
        assert given["missing_readings"][()].tolist() == [2, 5, 20, 0, 0] and given[
            "bound_readings"
        ][()].tolist() == [0, 0, 0, 5, 0]
        assert np.isnan(given["resistance"][1, 3]).all() and np.all(
            given["reading_side"][3, 3] == 1
        )


@pytest.mark.slow
def test_errors_and_coverage_count_intact_cells(tmp_path: Path, lampest: Command) -> None:
    """A report compares two estimators on a panel."""
    places = tuple(
        (*place, 10.0 * place[1], 10.0 * place[0]) for place in np.ndindex(6, 6) if place != (0, 0)
    )
    broken = Faults(open=((1, 1),), shorted=((2, 3),), dead_rows=(5,))
    scene = dataclasses.replace(LOADED, panel=Panel(6, 6, cells=places), faults=broken)
    simulate(Simulation(1, 3, scene, frames=4)).save(tmp_path / "broken.h5")
    (tmp_path / "run.yaml").write_text(
        RUN.format("broken.h5").replace("misfit: {}", "misfit: {weighting: noise}")
    )
    assert lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "out").code == 0
    results, report, table = (
        tmp_path / name for name in ("out/results.h5", "page.html", "table.csv")
    )
    assert lampest("compare", results, "--report", report, "--csv", table).code == 0
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 2 and all(
        float(row["cell error mean [%]"]) < MAX_ERROR_PERCENT for row in rows
    )
    text = re.sub("<[^>]+>", " ", report.read_text(encoding="utf-8"))
    assert "has the smallest error of the cells" in text
    assert (
        float(re.findall(r"truth within its interval \[%\]\s+([\d.]+)", text)[0])
        > MIN_COVERAGE_PERCENT
    )


def test_info_names_a_row_without_readings(tmp_path: Path, lampest: Command) -> None:
    values = healthy(4)
    values[:, 2] = np.nan
    output = lampest("info", recorded(tmp_path / "row.h5", values)).out
    assert "35 readings missing (25 %), in 7 of 7 frames; row 2 has none" in output


@pytest.mark.parametrize(
    "terms", [(lampest.Misfit(),), (lampest.Misfit(), lampest.RelativeChange(weight=10.0))]
)
def test_the_first_readable_frame_replaces_missing_unloaded_frames(
    terms: tuple[object, ...],
) -> None:
    values = healthy(5)
    values[:3] = np.nan
    estimate = lampest.reconstruct(
        recording_of(SCENE, values, 2), terms=list(terms), formulation="reduced"
    )
    assert estimate.status[0] == TOO_FEW_READINGS and all(estimate.solved[1:])
    assert np.nanmax(np.abs(estimate.relative_change)) < MAX_CHANGE_PERCENT


def cells() -> np.ndarray:
    return np.asarray(2000 * np.exp(0.2 * np.random.default_rng(3).standard_normal((6, 6))))


def exactly(
    scene: lampest.Scene, *frames: np.ndarray, sigma: float | None = None
) -> lampest.Recording:
    """Exact readings, the first of them unloaded; sigma : of themselves."""
    exact = lampest.two_point_resistance(np.stack(frames))
    return recording_of(
        scene, exact, 1, sigma=None if sigma is None else sigma * exact, name="exact"
    )


def solved(
    recording: lampest.Recording, formulation: str, weight: float | None = None, **bounds: object
) -> list[str]:
    terms = [lampest.Misfit(), *([] if weight is None else [lampest.Gradient(weight=weight)])]
    estimate = lampest.reconstruct(
        recording, terms, formulation=formulation, bounds=lampest.Bounds(**bounds)
    )
    return list(estimate.status)


@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
def test_the_status_names_a_bound_that_cells_exceed(formulation: str) -> None:
    """Without noise a millionth counts, above and below."""
    unloaded = cells()
    loaded = cells()
    loaded[1, 2] = 9000.0
    loaded[3, 3] = 300.0
    recording = exactly(PLAIN, unloaded, loaded, loaded)
    assert all(
        status.startswith(OPTIMUM_AT_BOUNDS)
        for status in solved(recording, formulation, upper=8990.0)
    )
    assert all(
        status.startswith(OPTIMUM_AT_BOUNDS)
        for status in solved(recording, formulation, lower=301.0)
    )
    assert solved(recording, formulation, upper=9100.0, lower=299.0) == [VERIFIED] * 2


def test_the_status_ignores_a_bound_exceeded_within_the_noise() -> None:
    """A cell beyond the resolution of the converter takes less than σ from its reading."""
    unloaded = cells()
    open_cell = cells()
    open_cell[2, 3] *= 1e6
    estimate = lampest.reconstruct(
        exactly(LOADED, unloaded, open_cell), [lampest.Misfit()], formulation="reduced"
    )
    assert estimate.status[0] == VERIFIED and estimate.result().open_cell.sum() == 1
    apart = 2000 * 10 ** np.random.default_rng(0).uniform(-3, 3, (6, 6))
    noisy = exactly(PLAIN, unloaded, apart, sigma=0.01)
    assert solved(noisy, "reduced")[0].startswith(OPTIMUM_AT_BOUNDS)
    assert solved(noisy, "reduced", upper="none") == [VERIFIED]
