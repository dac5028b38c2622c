"""The house, read from its imports: libraries have doors, and rooms stand on floors."""

import ast
import sys
from pathlib import Path

HOUSE = Path(__file__).parents[2] / "lampest"
ROOMS = sorted(path.relative_to(HOUSE.parent).with_suffix("") for path in HOUSE.rglob("*.py"))

# From the ground up. A room may import from itself and from the floors below its own; rooms of one floor are apart.
FLOORS = (
    {"files"},
    {"panel"},
    {"loads", "cost"},
    {"recording", "solvers"},
    {"posterior"},
    {"estimate"},
    {"runs"},
    {"report"},
    {"studies"},
    {"cli"},
)
# numpy is everywhere; each of the others has its doors: a room, or a module of one.
DOORS = {
    "casadi": ("cost", "solvers.ipopt", "posterior.residuals", "studies.bench"),
    "scipy": ("loads", "solvers", "posterior", "recording.board", "recording.foreign", "studies"),
    "mpmath": ("studies.extremes",),
    "h5py": ("files.hdf5", "recording", "runs.results"),
    "pydantic": ("files.document",),
    "ruamel": ("files.document",),
    "serial": ("recording.board",),
    "matplotlib": ("report.plots", "studies"),
    "jinja2": ("report.page",),
    "rich": ("cli",),
    "typer": ("cli",),
}


def floor(room: str) -> int:
    """How high a room of the house stands, 0 at the ground."""
    return next(number for number, rooms in enumerate(FLOORS) if room in rooms)


def imports(room: Path) -> set[str]:
    """All modules that a room imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse((HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{room}: relative import"
            found.add(str(node.module))
    return found


def test_libraries_come_through_their_doors() -> None:
    for path in ROOMS:
        place = ".".join(path.parts[1:])
        for module in imports(path):
            library = module.split(".")[0]
            if library not in sys.stdlib_module_names | {"lampest", "numpy"}:
                assert f"{place}.".startswith(tuple(f"{door}." for door in DOORS.get(library, ()))), (place, module)


def test_rooms_import_from_the_floors_below() -> None:
    for path in ROOMS:
        room = path.parts[1]
        for module in imports(path):
            parts = module.split(".")
            if parts[0] == "lampest" and room != "__init__":
                assert len(parts) > 1, f"{path} imports the public face"
                assert parts[1] == room or floor(parts[1]) < floor(room), f"{path} imports {module}"


def test_twelve_rooms_and_nothing_beside() -> None:
    folders = {path.parts[1] for path in ROOMS if len(path.parts) > 2}
    assert folders == set().union(*FLOORS) and len(folders) == 12
    assert {path.parts[1] for path in ROOMS if len(path.parts) == 2} == {"__init__"}


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


def test_no_module_changes_its_variables() -> None:
    for room in ROOMS:
        tree = ast.parse((HOUSE.parent / room).with_suffix(".py").read_text(encoding="utf-8"))
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.Global)], room
