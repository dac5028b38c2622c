"""Tools of the tests: mutations and disturbed readings."""

import ast
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.conftest import surplus
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


def test_fast_variants_of_a_test_are_spread_over_those_that_are_not_slow() -> None:
    def variant(number: int, *, slow: bool) -> Any:
        mark = "slow" if slow else None
        return SimpleNamespace(
            path=Path("test_a.py"),
            name=f"test_a[{number}]",
            originalname="test_a",
            number=number,
            get_closest_marker=lambda name: mark if name == mark else None,
        )

    variants = [variant(number, slow=number in (0, 5)) for number in range(6)]
    for count, kept in ((1, {1}), (2, {1, 4}), (4, {1, 2, 3, 4}), (9, {1, 2, 3, 4})):
        beyond = {item.number for item in surplus(variants, count)}
        assert {1, 2, 3, 4} - beyond == kept and not beyond & {0, 5}
