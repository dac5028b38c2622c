"""Parts of pages that are made of the package itself, so that they cannot differ from it.

A page that holds `<!-- generated: WORD -->` gets there: commands, names, keys or columns.
"""

import re
from collections.abc import Callable

import typer
from keys import keys_page
from names import names_page
from sphinx.application import Sphinx
from typer.cli import get_docs_for_click

from lampest.cli.program import app as commands
from lampest.runs.case import all_columns
from lampest.solvers.solution import ADVICE

MARKED = re.compile(r"<!-- generated: (\w+) -->\n")
EXAMPLE = re.compile(r"^Example: (.+)$", re.MULTILINE)


def commands_page() -> str:
    """Return every command with its arguments and options, by typer's own generator.

    The page shows the current commands, not those of the last release.
    """
    command = typer.main.get_command(commands)
    command.commands = {name: each for name, each in command.commands.items() if not each.hidden}  # type: ignore[attr-defined]
    text = get_docs_for_click(
        obj=command, ctx=typer.Context(command, info_name="lampest"), name="lampest"
    )
    _, _, chapters = text.partition("\n## ")
    chapters = EXAMPLE.sub(r"**Example**:\n\n```console\n$ \1\n```", chapters)
    return "## " + re.sub(r"(`[^`\n]*`)|<", lambda match: match[1] or r"\<", chapters)


def columns_table() -> str:
    """Every dataset of an estimate, in the file's order."""
    rows = [
        f"| `{column.path}` | {', '.join(column.axes)} | {column.units} | {column.long_name} |"
        for column in all_columns()
    ]
    return "\n".join(("| dataset | over | unit | what it is |", "|---|---|---|---|", *rows)) + "\n"


def status_table() -> str:
    """Return every status of a solve with its advice."""
    rows = [f"| {status.value} | {advice} |" for status, advice in ADVICE.items()]
    return "\n".join(("| status | what you can do |", "|---|---|", *rows)) + "\n"


PARTS: dict[str, Callable[[], str]] = {
    "commands": commands_page,
    "names": names_page,
    "keys": keys_page,
    "columns": columns_table,
    "status": status_table,
}


def fill(app: Sphinx, page: str, source: list[str]) -> None:
    """Put the parts into a page that is read."""
    source[0] = MARKED.sub(lambda match: PARTS[match[1]]() + "\n", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to pages being read."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
