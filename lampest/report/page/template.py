"""A page from its template: whatever comes from a file is escaped, what is not given is an error."""

from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined

SHARED = "lampest.report.page"


def filled(package: str, **values: Any) -> str:
    """`page.html` of a package as HTML; it may take `parts.html`, the look and the tables of all pages."""

    def source(name: str) -> str:
        home = SHARED if name == "parts.html" else package
        return files(home).joinpath(name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(source), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html").render(**values)
