"""The mutation study itself: which changes it makes, and which tests it holds against them."""

import ast
from pathlib import Path

from tests.mutation.__main__ import guards_of
from tests.mutation.operators import Mutant, mutants_of

SOURCE = """LIMIT = 2.5
class Panel:
    def area(self, length: Literal[4], width=3):
        message = f"{length + 7} µm"
        return sorted([-length * width, max(length, width)]) if length < LIMIT and not width is None else True
"""


def mutants(folder: Path) -> list[Mutant]:
    (folder / "panel.py").write_text(SOURCE)
    return mutants_of(folder, folder / "panel.py")


def test_a_module_has_a_mutant_of_every_operator_in_every_expression_that_is_computed(tmp_path: Path) -> None:
    made = mutants(tmp_path)
    changes = {(mutant.operator, mutant.before, mutant.after) for mutant in made}
    assert ("constant", "2.5", "25.0") in changes and ("constant", "3", "30") in changes
    assert ("sign", "-length", "(length)") in changes and (
        "arithmetic",
        "-length * width",
        "(-length / width)",
    ) in changes
    assert ("extreme", "max(length, width)", "(min(length, width))") in changes
    assert ("comparison", "length < LIMIT", "(length >= LIMIT)") in changes
    assert {mutant.operator for mutant in made} >= {"sorting", "logic", "negation", "truth"}
    assert not any("7" in mutant.before or mutant.before == "4" for mutant in made)
    for mutant in made:
        ast.parse(mutant.apply_to(SOURCE.encode()))
    assert {mutant.function for mutant in made} == {"", "Panel.area"}


def test_a_mutant_is_held_against_the_tests_that_call_its_function_the_shortest_of_each_file_first(
    tmp_path: Path,
) -> None:
    area = next(mutant for mutant in mutants(tmp_path) if mutant.function)
    tests = {
        "tests/a.py::long": {"seconds": 2.0, "functions": ["panel.py:Panel.area"]},
        "tests/a.py::short": {"seconds": 1.0, "functions": ["panel.py:Panel.area"]},
        "tests/b.py::medium": {"seconds": 1.5, "functions": ["panel.py:Panel.area", "panel.py:g"]},
        "tests/c.py::of_something_else": {"seconds": 0.1, "functions": ["panel.py:g"]},
    }
    assert guards_of(area, tests) == ["tests/a.py::short", "tests/b.py::medium", "tests/a.py::long"]
