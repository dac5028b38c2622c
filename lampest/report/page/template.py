"""What pages are made of: tables, pictures, and a template in which whatever comes from a file is escaped."""

from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined

SHARED = "lampest.report.page"


@dataclass(frozen=True)
class Sheet:
    """A table: headers, then rows whose first cell is their name; `best` : (row, column) of cells to set off."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True)
class Illustration:
    """An image as text, what it shows in words, its caption; wide : over the whole page."""

    uri: str
    alternative: str
    caption: str
    wide: bool = False


def filled(package: str, **values: Any) -> str:
    """`page.html` of a package as HTML; it may take `parts.html`, the look and the tables of all pages."""

    def source(name: str) -> str:
        home = SHARED if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)
