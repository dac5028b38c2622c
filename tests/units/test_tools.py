"""Tools of the tests: mutations, disturbed readings, and the comparison of two results files."""

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from studies.equal import compare, equal, relative_difference, weights_and_rest
from support import METHODS, invented_case

from lampest import write_results
from tests.mutation.__main__ import GOLDEN, guards_of
from tests.mutation.operators import Mutant, mutants_of
from tests.rounding import disturbed

SOURCE = """LIMIT = 2.5
class Panel:
    def area(self, length: Literal[4], width=3):
        message = f"{length + 7} µm", zip([], strict=True)
        both = [-length * width, max(length, width)]
        return sorted(both) if length < LIMIT and not width is None else True
"""
BASE = "/entry/mouth/LSM"


def mutants(folder: Path) -> list[Mutant]:
    (folder / "panel.py").write_text(SOURCE)
    return mutants_of(folder, folder / "panel.py")


def test_a_module_has_a_mutant_of_every_operator_in_every_computed_expression(
    tmp_path: Path,
) -> None:
    all_mutants = mutants(tmp_path)
    changes = {(mutant.operator, mutant.before, mutant.after) for mutant in all_mutants}
    assert ("constant", "2.5", "25.0") in changes and ("constant", "3", "30") in changes
    assert ("sign", "-length", "(length)") in changes and (
        "arithmetic",
        "-length * width",
        "(-length / width)",
    ) in changes
    assert ("extreme", "max(length, width)", "(min(length, width))") in changes
    assert ("comparison", "length < LIMIT", "(length >= LIMIT)") in changes
    assert {mutant.operator for mutant in all_mutants} >= {"sorting", "logic", "negation", "truth"}
    assert not any("7" in mutant.before or mutant.before == "4" for mutant in all_mutants)
    for mutant in all_mutants:
        ast.parse(mutant.apply_to(SOURCE.encode()))
    assert {mutant.function for mutant in all_mutants} == {"", "Panel.area"}


def test_a_mutant_meets_the_golden_rows_of_its_function_and_then_short_tests(
    tmp_path: Path,
) -> None:
    area = next(mutant for mutant in mutants(tmp_path) if mutant.function)
    tests = {
        f"{GOLDEN}row]": {"seconds": 9.0, "functions": ["panel.py:Panel.area"]},
        "tests/a.py::long": {"seconds": 2.0, "functions": ["panel.py:Panel.area"]},
        "tests/a.py::short": {"seconds": 1.0, "functions": ["panel.py:Panel.area"]},
        "tests/b.py::medium": {"seconds": 1.5, "functions": ["panel.py:Panel.area", "panel.py:g"]},
        "tests/c.py::of_something_else": {"seconds": 0.1, "functions": ["panel.py:g"]},
    }
    rows, other_tests = guards_of(area, tests)
    assert rows == [f"{GOLDEN}row]"] and other_tests == [
        "tests/a.py::short",
        "tests/b.py::medium",
        "tests/a.py::long",
    ]


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Twice the same results."""
    files = tmp_path / "before.h5", tmp_path / "after.h5"
    for file in files:
        cases = [invented_case(name, shape=(3, 4, 5), failed=(1,)) for name in METHODS[:2]]
        write_results(file, cases)
    return files


def set_to(value: object, place: object = (0, 1, 2)) -> Callable[[h5py.Dataset], None]:
    """A change of one entry; a function is called with the entry."""

    def change(dataset: h5py.Dataset) -> None:
        dataset[place] = value(dataset[place]) if callable(value) else value

    return change


def scaled(factor: float) -> Callable[[h5py.Dataset], None]:
    return set_to(lambda entry: factor * entry)


def gone(dataset: h5py.Dataset) -> None:
    del dataset.file[dataset.name]


@pytest.mark.parametrize(
    ("path", "change", "alike"),
    [
        ("cell_resistance", scaled(1 + 1e-11), False),
        ("cell_resistance", scaled(1 + 1e-13), True),
        ("cell_resistance", set_to(np.nan), False),
        ("cell_resistance", gone, False),
        ("baseline_resistance", gone, False),
        ("open_cell", set_to(lambda flag: 1 - flag), False),
        ("at_lower_bound", set_to(lambda flag: 1 - flag), False),
        ("status", set_to(b"another", 2), False),
        ("status", gone, False),
        ("solved", lambda dataset: dataset.write_direct(np.zeros(3, np.uint8)), False),
        ("solve_time", lambda dataset: dataset.write_direct(np.ones(3)), True),
        ("cost/misfit", gone, True),
    ],
)
def test_a_difference_of_cells_or_statuses_counts(
    pair: tuple[Path, Path], path: str, change: Callable[[h5py.Dataset], None], alike: bool
) -> None:
    assert equal(*pair, 0.0)
    with h5py.File(pair[1], "a") as file:
        change(file[f"{BASE}/{path}"])
    assert equal(*pair, 1e-12) is equal(*reversed(pair), 1e-12) is alike


@pytest.mark.slow
def test_rows_show_differences_and_the_exit_code_shows_equality(pair: tuple[Path, Path]) -> None:
    def code(*words: object) -> int:
        program = [sys.executable, "-m", "tests.studies.equal", *map(str, words)]
        return subprocess.run(
            program, cwd=Path(__file__).parents[2], capture_output=True
        ).returncode

    assert code(*pair) == 0
    with h5py.File(pair[1], "a") as file:
        scaled(1.001)(file[f"{BASE}/cell_resistance"])
    assert (code(*pair), code(*pair, "--cells", "1e-2")) == (1, 0)
    with h5py.File(pair[1], "a") as file:
        file[f"{BASE}/cell_resistance"][2, 3, 4] *= 1.5
        file[f"{BASE}/weight/misfit"][0] *= 2
        file[f"{BASE}/two_point_model"][0, 0, 0] *= 4
        del file["/entry/mouth/LSR-CR"]
    rows, lone = compare(*pair)
    row = rows["mouth/LSM"]
    assert lone == ["mouth/LSR-CR"] and row["cell_resistance"] == pytest.approx(1 / 3)
    assert weights_and_rest(row) == (0.5, (0.75, "two_point_model"))


def test_the_relative_difference_of_odd_values_is_defined() -> None:
    odd = np.array([0.0, np.nan, np.inf, -1.0])
    assert relative_difference(odd, odd) == 0
    assert relative_difference(odd, -odd) == np.inf
    assert relative_difference([0.0], [1e-300]) == 1
    assert relative_difference([1.0], [1.0, 2.0]) == np.inf
    assert relative_difference([1.0, np.nan], [1.0, 2.0]) == np.inf


def test_readings_are_disturbed_once_and_equal_ones_equally() -> None:
    readings = np.random.default_rng(1).lognormal(0.0, 9.0, 1000)
    changed = disturbed(readings)
    relative = changed / readings - 1
    assert np.std(relative) > 1e-14 and np.abs(relative).max() < 1.2e-13
    assert abs(np.mean(relative)) < 1e-14
    np.testing.assert_array_equal(disturbed(changed), changed)
    np.testing.assert_array_equal(disturbed(readings[::-1]), changed[::-1])
    special = np.array([0.0, -np.inf, np.inf, np.nan])
    np.testing.assert_array_equal(disturbed(special), special)
