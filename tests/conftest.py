"""The set-up of all tests: one thread, `support` for import, a folder on the disk, the command."""

import gc
import os
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lampest.files.process import ONE_THREAD

# Before numpy is imported, libraries get one thread, as the commands give them: the same sums, and
# faster.
os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
# What Python compiles is kept, whatever the environment says: processes of tests start a second or
# two sooner.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
TESTS = Path(__file__).parent
sys.path.insert(0, str(TESTS))


FAST_VARIANTS = 1  # variants of a test that `make test` runs where there are many
THINNED = ("apps", "oracles", "units")  # laws and contracts keep all of theirs
UNTHINNED = "test_table.py"  # the golden table keeps all of its rows with `--variants`, too


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options with which `make quick` thins tests, and disturbs rounding in all of them."""
    parser.addoption(
        "--variants", type=int, help="run this many variants of every test, spread over them"
    )
    parser.addoption(
        "--disturbed", action="store_true", help="change every reading by a relative 1e-13"
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without garbage collection, which then leaves out all that was loaded and collected.

    Twelve thousand tests and their libraries are a million objects that live to the end.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark all variants of a test but FAST_VARIANTS as slow in the rooms that are thinned.

    Leave `soak` out unless requested, and `exact` where readings are disturbed.
    """
    if "soak" not in config.getoption("-m"):
        config.hook.pytest_deselected(
            items=[item for item in items if item.get_closest_marker("soak")]
        )
        items[:] = [item for item in items if not item.get_closest_marker("soak")]
    if config.getoption("disturbed"):
        config.hook.pytest_deselected(
            items=[item for item in items if item.get_closest_marker("exact")]
        )
        items[:] = [item for item in items if not item.get_closest_marker("exact")]
    chosen = config.getoption("--variants")
    thinned = [
        item
        for item in items
        if item.path.name != UNTHINNED
        and (chosen or item.path.relative_to(TESTS).parts[0] in THINNED)
    ]
    for item in surplus(thinned, chosen or FAST_VARIANTS):
        item.add_marker(pytest.mark.slow)


def surplus(items: list[pytest.Item], count: int) -> list[pytest.Item]:
    """Return the variants of every test beyond a count, which is spread over those not slow."""
    variants: dict[tuple[Path, str], list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("slow") is None:
            key = (item.path, getattr(item, "originalname", item.name))
            variants.setdefault(key, []).append(item)
    beyond = []
    for several in variants.values():
        last = len(several) - 1
        chosen = {round(number * last / max(count - 1, 1)) for number in range(count)}
        if len(several) > count:
            beyond += [item for number, item in enumerate(several) if number not in chosen]
    return beyond


@pytest.fixture(autouse=True, scope="session")
def rounding(request: pytest.FixtureRequest) -> Iterator[None]:
    """Change every reading by a relative 1e-13 for all tests, where the option says so."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        if request.config.getoption("disturbed"):
            from rounding import disturb_readings

            disturb_readings(monkeypatch)
        yield


@pytest.fixture
def disk(tmp_path: Path) -> SimpleNamespace:
    """Return a folder with small.h5 and run.yaml, and functions that write more of them."""
    from small_files import on_disk

    return on_disk(tmp_path)


@pytest.fixture
def lampest() -> Callable[..., Any]:
    """The command within this process: exit code, standard output, standard error."""
    from attack.attack import called

    return called


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Return a function that installs a package of one module, `addon`.

    The package names an object in each given group of entry points.
    """

    def install(module: str, **named: str) -> None:
        about = tmp_path / "site" / "addon-1.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: addon\nVersion: 1\n")
        points = (f"[lampest.{group}]\nextra = {name}\n" for group, name in named.items())
        (about / "entry_points.txt").write_text("\n".join(points))
        (tmp_path / "site" / "addon.py").write_text(module)
        monkeypatch.syspath_prepend(tmp_path / "site")
        forget()

    def forget() -> None:
        modules = [module for name, module in sys.modules.items() if name.startswith("lampest.")]
        for member in [member for module in modules for member in vars(module).values()]:
            if hasattr(member, "cache_clear"):
                member.cache_clear()

    yield install
    sys.modules.pop("addon", None)
    forget()
