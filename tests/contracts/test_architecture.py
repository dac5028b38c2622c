"""The house, read from its imports: third-party libraries have doors, and rooms stand on floors."""

import ast
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[2] / "lampest"
ROOMS = sorted(path.relative_to(HOUSE.parent).with_suffix("") for path in HOUSE.rglob("*.py"))

# From the ground up: a room may import only from floors above its own line, and from rooms of its own package.
FLOORS = (
    "errors",
    "interrupts",
    "tagged",
    "files",
    "panel",
    "scene",
    "readout",
    "starmesh",
    "kirchhoff",
    "response",
    "pressure",
    "footprint",
    "recognition",
    "document",
    "sweep",
    "hdf5",
    "acquisition",
    "recording",
    "readings",
    "simulate",
    "terms",
    "formulations",
    "cost",
    "problem",
    "solvers",
    "search",
    "posterior",
    "blocks",
    "region",
    "efforts",
    "estimator",
    "oral_disc",
    "weights",
    "stream",
    "sequence",
    "columns",
    "case",
    "results",
    "executors",
    "config",
    "batch",
    "starts",
    "table_file",
    "matlab_file",
    "importing",
    "info",
    "acquire",
    "live",
    "compare",
    "study",
    "detect",
    "bench",
    "tradeoff",
    "extremes",
    "tune",
    "plot",
    "report",
    "cli",
)
# numpy is everywhere; each of the others has its rooms.
DOORS = {
    "casadi": {"terms", "formulations", "cost", "solvers", "posterior", "bench"},
    "scipy": {"solvers", "recognition", "detect", "posterior", "acquire", "bench", "extremes", "tune"},
    "mpmath": {"extremes"},
    "h5py": {"hdf5", "acquisition", "recording", "results", "acquire"},
    "pydantic": {"document"},
    "ruamel": {"document"},
    "serial": {"acquire"},
    "matplotlib": {"plot"},
    "jinja2": {"report"},
    "rich": {"cli"},
    "typer": {"cli"},
}


def floor(parts: tuple[str, ...]) -> str:
    """lampest/terms/misfit → terms; lampest/panel → panel; lampest/__init__ → ''."""
    return parts[1] if len(parts) > 1 and parts[1] != "__init__" else ""


def imports(room: Path) -> set[str]:
    """All modules that a room imports, anywhere in it; `from lampest import hdf5` counts as lampest.hdf5."""
    found = set()
    for node in ast.walk(ast.parse((HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{room}: relative import"
            inner = node.module == "lampest"
            found |= {f"lampest.{alias.name}" for alias in node.names} if inner else {str(node.module)}
    return found


@pytest.mark.parametrize("room", ROOMS, ids=str)
def test_libraries_come_through_their_doors(room: Path) -> None:
    for module in imports(room):
        library = module.split(".")[0]
        if library not in sys.stdlib_module_names | {"lampest", "numpy"}:
            assert floor(room.parts) in DOORS.get(library, set()), f"{room} imports {module}"


@pytest.mark.parametrize("room", [room for room in ROOMS if floor(room.parts)], ids=str)
def test_rooms_stand_on_floors(room: Path) -> None:
    own = floor(room.parts)
    for module in imports(room):
        if module.startswith("lampest."):
            other = floor(tuple(module.split(".")))
            assert other == own or FLOORS.index(other) < FLOORS.index(own), f"{room} imports {module}"


def test_every_room_has_its_floor_and_every_floor_its_room() -> None:
    assert {floor(room.parts) for room in ROOMS} - {""} == set(FLOORS)


def test_numbers_at_random_come_from_a_generator() -> None:
    for room in ROOMS:
        text = (HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and ast.unparse(node).startswith("np.random."):
                assert node.attr in ("Generator", "default_rng", "SeedSequence", "PCG64", "Philox"), room


def test_solver_is_called_in_one_place() -> None:
    callers = {
        room.parts[-1]
        for room in ROOMS
        for node in ast.walk(ast.parse((HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr == "nlpsol"
    }
    assert callers == {"ipopt"}


@pytest.mark.parametrize("room", ROOMS, ids=str)
def test_no_module_changes_its_variables(room: Path) -> None:
    tree = ast.parse((HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8"))
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Global)]
