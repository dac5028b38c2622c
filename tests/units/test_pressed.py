"""What is said of any load from the cells' pressures; and movements that are told once."""

import csv
from pathlib import Path

import numpy as np
import pytest
from support import invented_case

from lampest.report.compare import figures_of
from lampest.report.detect.pressed import pressed, pressed_of, pressed_table, write_pressed
from lampest.runs.case import CaseResult
from lampest.runs.results import Results

SHAPE = (3, 10, 10)


def pressing(estimator: str = "LSM", **maps: np.ndarray) -> CaseResult:
    """An estimate in which 1 kPa presses clearly; all errors are own ones unless `maps` has common ones."""
    known = {"pressure_common": np.zeros(SHAPE), "pressing": (maps["pressure"] > 1).astype(np.uint8)}
    return invented_case(estimator, shape=SHAPE, **known | maps)


def maps() -> tuple[np.ndarray, np.ndarray]:
    """kPa: nothing, then a block of 2 × 3 cells at rows 4 and 5, columns 6 to 8, then one cell in the corner."""
    pressure, errors = np.full(SHAPE, 0.1), np.full(SHAPE, 0.2)
    pressure[1, 4:6, 6:9] = 10.0, 12.0, 10.0
    pressure[2, 0, 0] = 8.0
    return pressure, errors


def test_centre_area_peak_and_force_of_any_load() -> None:
    pressure, errors = maps()
    found = pressed_of(pressing(pressure=pressure, pressure_own=errors))
    assert found is not None and np.isnan(found.values[0]).all()
    x, y, area, peak, force = found.values[1]
    assert (x, y, area, peak) == pytest.approx((70, 45, 600, 12))
    assert force == pytest.approx(64 * 100 * 1e-3)  # kPa · mm² = mN
    assert found.errors[1, -1] == pytest.approx(np.sqrt(6) * 0.2 * 0.1)
    assert found.errors[1, 2] == pytest.approx(100 * np.sqrt(6 / 12))
    assert found.values[2, :2] == pytest.approx((0, 0))
    assert np.all(found.errors[2, :2] == pytest.approx(10 / np.sqrt(12)))  # a spot in a corner is somewhere in its cell


def test_forces_of_noisy_maps_scatter_as_they_say() -> None:
    pressure, errors = maps()
    rng = np.random.default_rng(4)
    forces = []
    for _ in range(200):
        noisy = pressure + errors * rng.standard_normal(SHAPE) * (pressure > 1)
        one = pressed_of(pressing(pressure=noisy, pressure_own=errors))
        assert one is not None
        forces.append(one.values[1, -1])
    assert np.std(forces) == pytest.approx(one.errors[1, -1], rel=0.2)


def test_common_errors_of_pressures_add_up_in_the_force() -> None:
    """A film whose curve is known to 30 %: so is the force, and the centre is not moved."""
    pressure, errors = maps()
    plain, common = (
        pressed_of(pressing(pressure=pressure, pressure_own=errors, pressure_common=share * pressure))
        for share in (0.0, 0.3)
    )
    assert plain is not None and common is not None
    assert common.errors[1, -1] == pytest.approx(np.hypot(plain.errors[1, -1], 0.3 * 6.4))
    np.testing.assert_allclose(common.errors[1, :3], plain.errors[1, :3])


def test_every_frame_is_written_and_the_strongest_shown(tmp_path: Path) -> None:
    pressure, errors = maps()
    saturated = (pressure > 11).astype(np.uint8)
    cases = (
        pressing(pressure=pressure, pressure_own=errors, saturated=saturated),
        invented_case("bare", shape=SHAPE),
    )
    found = pressed(Results(cases))
    assert [one.case.estimator for one in found] == ["LSM"]
    lines = list(csv.DictReader(write_pressed(tmp_path / "pressed.csv", found).read_text("utf-8").splitlines()))
    assert lines[0]["force [N]"] == "" and float(lines[1]["force [N]"]) == pytest.approx(6.4)
    assert [line["saturated cells"] for line in lines] == ["0", "2", "0"]
    (row,) = pressed_table(found).cells
    assert row[:4] == ("mouth", "LSM", "6", "6") and "≥\N{NO-BREAK SPACE}6.400 ± 0.049" in row and row[-1] == "2"


def test_tables_give_both_parts_of_pressures_where_something_presses() -> None:
    pressure, errors = maps()
    sigma = np.full(SHAPE, 0.01)
    case = pressing(
        pressure=pressure, pressure_own=errors, pressure_common=0.3 * pressure, sigma_own=sigma, sigma_common=2 * sigma
    )
    figures = figures_of(case, np.ones(SHAPE[0], bool))
    assert figures["own standard deviation of pressed cells median [kPa]"] == pytest.approx(0.2)
    assert figures["common standard deviation of pressed cells median [kPa]"] == pytest.approx(3.0)
    assert case.error_words.endswith("of pressures: own 0.2 kPa, common 3 kPa")
