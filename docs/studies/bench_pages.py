"""The tables of a benchmark, written into the pages that show them.

A table stands between <!-- bench: NAME --> and <!-- /bench -->.

Run it with: python -m docs.studies.bench_pages results/bench
NAME is that of a section of bench.md or commands.md: solvers, methods, remarks or commands.
"""

import argparse
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs" / "studies").glob("*.md")))
MARKED = re.compile(r"<!-- bench: (\w+) -->\n.*?<!-- /bench -->\n", re.DOTALL)
SECTION = re.compile(r"^## (\w+).*?\n\n(.*?)(?=^## |\Z)", re.DOTALL | re.MULTILINE)


def sections(text: str) -> dict[str, str]:
    """The tables of a study's page by their names."""
    return {name: table.strip() + "\n" for name, table in SECTION.findall(text)}


def with_tables(text: str, tables: dict[str, str]) -> str:
    """A page with its tables replaced; one that was not measured stays as it is."""

    def table(results: re.Match[str]) -> str:
        name = results[1]
        return (
            f"<!-- bench: {name} -->\n\n{tables[name]}\n<!-- /bench -->\n"
            if name in tables
            else results[0]
        )

    return MARKED.sub(table, text)


def main(folder: Path) -> None:
    """Replace the tables of every page, and say of which."""
    tables = sections("\n".join(path.read_text(encoding="utf-8") for path in folder.glob("*.md")))
    for path in PAGES:
        before = path.read_text(encoding="utf-8")
        after = with_tables(before, tables)
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(path.relative_to(ROOT), ", ".join(MARKED.findall(before)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    main(parser.parse_args().folder)
