"""What is said where a library is missing: the package that brings it, by the name that pip knows."""

import ast
import itertools
import re
import sys
import tomllib
from pathlib import Path

import pytest

from lampest.files.errors import PACKAGES, InputError, extra

HOUSE = Path(__file__).parents[2]
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())["project"]
EXTRAS = {"dask": "cluster", "hdmf": "export"}  # come with what an extra names


def imported() -> set[str]:
    """The first names of all modules that lampest imports and Python does not bring."""
    names = set()
    for path in (HOUSE / "lampest").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module)
    return {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"lampest"}


@pytest.mark.slow
def test_every_library_that_may_be_missing_is_named_as_pip_knows_it() -> None:
    requirements = [*PROJECT["dependencies"], *itertools.chain(*PROJECT["optional-dependencies"].values())]
    known = {match[0].lower() for text in requirements if (match := re.match(r"[\w.-]+", text))} | EXTRAS.keys()
    assert len(imported()) > 20
    assert not {module for module in imported() if PACKAGES.get(module, module) not in known}


def test_a_missing_pyserial_is_pyserial() -> None:
    with pytest.raises(InputError, match=r"^serial is not installed; pip install 'pyserial' brings it$"), extra():
        raise ModuleNotFoundError("No module named 'serial'", name="serial")
