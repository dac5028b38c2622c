"""Rules of the code, read from its imports.

The rules concern doors of libraries, floors of rooms, and contracts of the public face alone.

A rule is a function from a module's name and syntax tree to its objections. Texts that break the
rules test them.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

from lampest.files.applications import applications

CONTRACTS = Path(__file__).parent
HOUSE = CONTRACTS.parents[1] / "lampest"
REFERENCE = CONTRACTS.parents[1] / "docs" / "reference"
MAX_LINES = 750  # of a module, as the contributing page states

# From the ground up. A room may import from itself and from the floors below its own; rooms of one
# floor are apart.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("files",),
    ("panel",),
    ("cost",),
    ("recording", "formulation"),
    ("solvers",),
    ("posterior",),
    ("inference",),
    ("estimate",),
    ("audit",),
    ("runs",),
    ("report",),
    ("cli",),
)
# Applications stand above the core. Each may import the core and the applications that it needs.
APPLICATIONS = applications().usable
# numpy is everywhere; each other library has its doors: a room, or a module of one.
DOORS: dict[str, tuple[str, ...]] = {
    "casadi": (
        "files.process",
        "panel.compiled",
        "panel.law",
        "cost",
        "formulation",
        "estimate.own_program",
        "estimate.own_solution",
    ),
    "scipy": (
        "files.process",
        "panel.compiled",
        "panel.least_squares",
        "panel.readouts",
        "panel.response",
        "apps.recognition",
        "cost.problem",
        "apps.calibration",
        "estimate.own_directions",
        "estimate.own_solution",
        "formulation",
        "solvers",
        "posterior",
        "report.export.formats",
        "apps.studies",
    ),
    "h5py": (
        "files.hdf5",
        "files.checksums",
        "files.parts",
        "recording",
        "runs.results",
        "apps.board.journal",
    ),
    "xarray": ("runs.case", "report.export.formats"),
    "pandas": ("runs.case",),
    "mpmath": ("apps.studies.certified",),
    "pyarrow": ("apps.foreign.records", "report.export.formats"),
    "zarr": ("report.export.formats",),
    **dict.fromkeys(("pynwb", "hdmf"), ("report.export.nwb",)),
    **dict.fromkeys(("pylsl", "pythonosc", "paho", "websockets"), ("apps.live.publish",)),
    "openpyxl": ("apps.foreign", "report.export.formats"),
    "serial": ("apps.board",),
    **dict.fromkeys(("psutil", "threadpoolctl"), ("files.process",)),
    **dict.fromkeys(("pydantic", "ruamel"), ("files.document",)),
    "matplotlib": (
        "report.plots",
        "apps.page.all_frames",
        "apps.studies",
        "apps.recognition.detect.timeline",
    ),
    "jinja2": ("apps.page",),
    "rich": ("cli",),
    "typer": ("cli", "apps.board.commands", "apps.calibration.commands", "apps.studies.commands"),
    "lazy_loader": ("",),
}
ROOMS = {room for rooms in FLOORS for room in rooms} | {f"apps.{name}" for name in APPLICATIONS}
ALWAYS_PERMITTED = sys.stdlib_module_names | {"lampest", "numpy"}

NAMED_TUPLE = ("_fields", "_replace", "_asdict", "_make")  # public, whatever their names say
GENERATORS = ("Generator", "default_rng", "SeedSequence", "PCG64", "Philox")

# A recording shows itself: this one module loads the pictures, in the method that draws.
PICTURES = {("lampest.recording.recording", "lampest.report.plots")}

Rule = Callable[[str, ast.Module], Iterator[str]]
Names = Callable[[ast.Module], Iterator[str]]


def dotted(path: Path) -> str:
    """lampest/cost/__init__.py → lampest.cost, lampest/cost/cost.py → lampest.cost.cost."""
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> dict[str, ast.Module]:
    """The syntax of every module, by its dotted name."""
    return {
        dotted(path): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(HOUSE.rglob("*.py"))
    }


def floor(room: str) -> int:
    """How high a room of the core stands, 0 at the ground; applications stand above all."""
    return next((number for number, rooms in enumerate(FLOORS) if room in rooms), len(FLOORS))


def room_of(module: str) -> str:
    """The room in which a module stands; that of the package itself has no name."""
    parts = module.split(".")[1:]
    return ".".join(parts[: 2 if parts[:1] == ["apps"] else 1])


@cache
def nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """All of a module's syntax."""
    return tuple(ast.walk(tree))


def imports(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """(module, name or '') of every import anywhere in a module.

    A module's name as a text counts, too, and so does that of 'module:object'.
    """
    yield from named_modules(tree)
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (
                ("." * node.level + (node.module or ""), alias.name) for alias in node.names
            )


def named_modules(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """(module, object or '') of every text that names a module, or 'module:object'."""
    for node in nodes(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            named, _, member = node.value.partition(":")
            if named in modules().keys() - {"lampest"}:
                yield named, member


def is_private(name: str) -> bool:
    """Whether a name is for its own module alone."""
    return name.startswith("_") and not name.startswith("__") and name not in NAMED_TUPLE


def doors(module: str, tree: ast.Module) -> Iterator[str]:
    """Libraries come through their doors."""
    for name, _ in imports(tree):
        library = name.split(".")[0]
        allowed = tuple(f"lampest.{door}." for door in DOORS.get(library, ()))
        face = module == "lampest" and "" in DOORS.get(library, ())
        if library not in ALWAYS_PERMITTED and not face and not f"{module}.".startswith(allowed):
            yield f"imports {name or 'relatively'}"


def floors(module: str, tree: ast.Module) -> Iterator[str]:
    """Rooms import from themselves and from the floors below; no room imports the public face."""
    room = room_of(module)
    for name, _ in imports(tree):
        if name.split(".")[0] != "lampest" or not room:
            continue
        if name == "lampest":
            yield "imports the public face"
        elif (
            room_of(name) != room
            and floor(room_of(name)) >= floor(room)
            and (module, name) not in PICTURES
            and not permitted(room, room_of(name))
        ):
            yield f"imports {name}"


def permitted(room: str, imported: str) -> bool:
    """Whether an application says that it needs another one."""
    application, needed_one = room.removeprefix("apps."), imported.removeprefix("apps.")
    return application in APPLICATIONS and needed_one in APPLICATIONS[application].needs


def privates(module: str, tree: ast.Module) -> Iterator[str]:
    """Private names of a module are neither imported nor reached through an imported name."""
    foreign_names = set()
    for node in nodes(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lampest"):
            foreign_names |= {alias.asname or alias.name for alias in node.names}
    for name, imported in imports(tree):
        if name.startswith("lampest") and any(map(is_private, (*name.split("."), imported))):
            yield f"imports {imported or name}"
    for node in nodes(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            owner = ast.unparse(node.value)
            if owner in foreign_names or owner.startswith("lampest."):
                yield f"reaches for {owner}.{node.attr}"


def generators(module: str, tree: ast.Module) -> Iterator[str]:
    """Numbers at random come from a generator."""
    for node in nodes(tree):
        if isinstance(node, ast.Attribute) and node.attr not in GENERATORS:
            owner = ast.unparse(node.value) if isinstance(node.value, ast.Attribute) else ""
            if owner in ("np.random", "numpy.random"):
                yield f"calls {owner}.{node.attr}"
    for name, imported in imports(tree):
        if name == "random" or (name == "numpy.random" and imported not in GENERATORS):
            yield f"imports {name}"


def variables(module: str, tree: ast.Module) -> Iterator[str]:
    """No module changes its variables."""
    yield from (
        f"changes {', '.join(node.names)}" for node in nodes(tree) if isinstance(node, ast.Global)
    )


def missing(module: str, tree: ast.Module) -> Iterator[str]:
    """Imports name modules that exist, those inside functions too."""
    yield from (
        f"imports {name}, which does not exist"
        for name, _ in imports(tree)
        if name.startswith("lampest.") and name not in modules()
    )


def faces(module: str, tree: ast.Module) -> Iterator[str]:
    """A contract is tested from outside.

    A test of one imports the package alone, and patches nothing inside.
    """
    for name, imported in imports(tree):
        if name.startswith("lampest.") or f"{name}.{imported}" in modules():
            yield f"imports {name if name.startswith('lampest.') else imported} from within"
    for node in nodes(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and node.value not in modules()
        ):
            parts = node.value.split(".")
            if ".".join(parts[:2]) in modules() and parts[0] == "lampest" and len(parts) > 2:
                yield f"names {node.value}"


def classes(tree: ast.Module) -> Iterator[str]:
    """The names of a module's classes, private ones included."""
    yield from (node.name for node in tree.body if isinstance(node, ast.ClassDef))


def public_functions(tree: ast.Module) -> Iterator[str]:
    """The names of a module's functions that others may call."""
    yield from (
        node.name
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and not is_private(node.name)
    )


def namesakes(modules: dict[str, ast.Module], names: Names) -> dict[str, list[str]]:
    """Name → modules, of names that stand in several.

    Commands and the public face are called like what they call.
    """
    homes: dict[str, list[str]] = {}
    for module, tree in modules.items():
        commands = room_of(module) in ("", "cli") or module.endswith(".commands")
        for name in () if commands else names(tree):
            homes.setdefault(name, []).append(module)
    return {name: several for name, several in homes.items() if len(several) > 1}


@pytest.mark.parametrize(
    "rule",
    [doors, floors, privates, generators, variables, missing],
    ids=lambda rule: rule.__name__,
)
def test_the_package_follows_the_rule(rule: Rule) -> None:
    broken = [
        f"{module} {fault}" for module, tree in modules().items() for fault in rule(module, tree)
    ]
    assert not broken


@pytest.mark.parametrize("names", [classes, public_functions], ids=lambda names: names.__name__)
def test_public_names_are_unique_in_the_package(names: Names) -> None:
    shared = namesakes(modules(), names)
    assert not shared


def test_the_check_notices_equal_names_of_classes_and_functions() -> None:
    texts = {
        "lampest.cli.board": "def record(): pass",
        "lampest.apps.board.record": "class Row: pass\ndef record(): pass\ndef _open(): pass",
        "lampest.report.compare": "class Row: pass\nclass Table: pass\ndef _open(): pass\ndef "
        "plain(): pass",
        "lampest.apps.studies.study": "def plain(): pass",
    }
    modules = {module: ast.parse(text) for module, text in texts.items()}
    assert set(namesakes(modules, classes)) == {"Row"} and set(
        namesakes(modules, public_functions)
    ) == {"plain"}


@pytest.mark.parametrize("path", sorted(CONTRACTS.glob("*.py")), ids=lambda path: path.stem)
def test_contracts_import_only_public_names(path: Path) -> None:
    if path == Path(__file__):
        return  # its texts break every rule
    assert not list(faces(path.stem, ast.parse(path.read_text(encoding="utf-8"))))


COST = "lampest.cost.cost"
BROKEN = (
    (doors, "lampest.panel.panel", "def f():\n    from scipy.linalg import solve"),
    (doors, "lampest.solvers.by_ipopt", "import casadi"),
    (doors, COST, "from .losses import Huber"),
    (floors, COST, "import lampest.recording.shapes"),
    (floors, COST, "import lampest.apps.live.run"),
    (floors, "lampest.cli.results", "loaded('lampest.apps.live.run:live')"),
    (floors, "lampest.apps.board.port", "import lampest.apps.live.run"),
    (floors, "lampest.recording.recording", "from lampest.solvers import multistart"),
    (floors, COST, "from lampest import Misfit"),
    (floors, "lampest.files", "def f():\n    from lampest.cli import screen"),
    (floors, COST, "import_module('lampest.runs.config')"),
    (privates, COST, "from lampest.panel.network import Network, _solve as solve"),
    (privates, COST, "from lampest.panel._network import solve"),
    (privates, COST, "from lampest.panel import network\nnetwork._solve()"),
    (privates, COST, "import lampest.panel.network\nlampest.panel.network._solve()"),
    (generators, COST, "x = np.random.rand(3)"),
    (generators, COST, "from numpy.random import rand"),
    (generators, COST, "import random"),
    (faces, "test_run", "from lampest.runs import config"),
    (faces, "test_run", "def f():\n    from lampest import runs"),
    (faces, "test_run", "monkeypatch.setattr('lampest.runs.task.solve_case', f)"),
    (faces, "test_run", "files('lampest.apps.live')"),
    (missing, COST, "def f():\n    from lampest.panel.networks import Network"),
    (variables, COST, "def f():\n    global count\n    count = 1"),
)


@pytest.mark.parametrize(("rule", "module", "text"), BROKEN)
def test_the_check_notices_broken_rules(rule: Rule, module: str, text: str) -> None:
    assert list(rule(module, ast.parse(text)))


def test_every_permitted_import_is_used() -> None:
    for library, places in DOORS.items():
        for place in places:
            inside = [
                tree
                for module, tree in modules().items()
                if f"{module}.".startswith(f"lampest.{place}.")
            ]
            inside += [] if place else [modules()["lampest"]]
            used = {name.split(".")[0] for tree in inside for name, _ in imports(tree)}
            assert library in used, f"no module of {place} imports {library}"


def test_every_module_is_reached_from_the_command_or_the_public_face() -> None:
    stub = ast.parse((HOUSE / "__init__.pyi").read_text(encoding="utf-8"))
    public = {
        f"lampest.{node.module}"
        for node in ast.walk(stub)
        if isinstance(node, ast.ImportFrom) and node.level
    }
    reached = set()
    waiting = ["lampest", "lampest.cli", *public]
    waiting += [f"lampest.apps.{name}" for name in APPLICATIONS]
    while waiting:
        module = waiting.pop()
        if module in modules() and module not in reached:
            reached.add(module)
            for name, imported in imports(modules()[module]):
                parts = f"{name}.{imported}".split(".")
                waiting += [".".join(parts[:count]) for count in range(1, len(parts) + 1)]
    assert modules().keys() == reached


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_imports_form_no_cycle(room: str) -> None:
    """There is no cycle, not even for type checkers."""
    inside = [module for module in modules() if f"{module}.".startswith(f"lampest.{room}.")]
    needs = {module: set(needed(module)) & set(inside) for module in inside}
    ready: set[str] = set()
    while following := {
        module for module in needs if module not in ready and needs[module] <= ready | {module}
    }:
        ready |= following
    assert not needs.keys() - ready


def needed(module: str) -> Iterator[str]:
    """Yield the imports of a module, where a name of a package may be a module of it.

    Objects of an application are named by texts, and imported when they are requested.
    """
    later = set(named_modules(modules()[module])) if module.count(".") == 2 else set()
    for name, imported in set(imports(modules()[module])) - later:
        inner = f"{name}.{imported}"
        yield inner if inner in modules() else name


def test_the_package_has_a_core_of_thirteen_rooms_and_nine_applications() -> None:
    def folders(place: Path) -> set[str]:
        return {path.name for path in place.iterdir() if path.is_dir() and any(path.rglob("*.py"))}

    assert folders(HOUSE) - {"apps"} == {room for rooms in FLOORS for room in rooms}
    assert folders(HOUSE / "apps") == set(APPLICATIONS)
    assert {path.name for path in HOUSE.glob("*.py")} == {"__init__.py"}


def test_the_figure_of_the_packages_has_the_floors() -> None:
    figure = (REFERENCE / "packages.svg").read_text(encoding="utf-8")
    drawn = re.findall(r'font-weight="bold">(\w+)<', figure)
    assert drawn == ["apps", *(room for rooms in reversed(FLOORS) for room in rooms)]
    assert " · ".join(sorted(APPLICATIONS)) in figure


def test_the_page_states_the_additions_of_each_application() -> None:
    page = (REFERENCE / "architecture.md").read_text(encoding="utf-8")
    for name, application in APPLICATIONS.items():
        needs, commands = (
            ", ".join(f"`{word}`" for word in words) or "–"
            for words in (application.needs, application.commands)
        )
        answers = ", ".join(application.answers) or "–"
        row = f"| `{name}/` | {application.about} | {needs} | {commands} | {answers} |"
        assert page.count(row) == 1, row


@pytest.mark.parametrize("name", sorted(APPLICATIONS))
def test_an_application_imports_its_stated_needs(name: str) -> None:
    imported = {
        room_of(target).removeprefix("apps.")
        for module, tree in modules().items()
        if room_of(module) == f"apps.{name}"
        for target, _ in imports(tree)
        if target.startswith("lampest.apps.")
    }
    assert imported - {name} == {*APPLICATIONS[name].needs}


@pytest.mark.parametrize(
    ("name", "home"), [("nlpsol", "lampest.formulation.ipopt"), ("print", "lampest.cli.screen")]
)
def test_solver_and_terminal_are_called_in_one_place(name: str, home: str) -> None:
    callers = {
        module
        for module, tree in modules().items()
        for node in nodes(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in (name, f"casadi.{name}")
    }
    assert callers == {home}


def test_parts_are_as_small_as_the_contributing_page_says() -> None:
    lengths = sorted(
        node.end_lineno - node.lineno + 1
        for tree in modules().values()
        for node in nodes(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )
    assert lengths[len(lengths) * 4 // 5] <= 20, "four of five"
    assert lengths[len(lengths) * 19 // 20] <= 40, "nineteen of twenty"
    assert max(len(path.read_text().splitlines()) for path in HOUSE.rglob("*.py")) < MAX_LINES
