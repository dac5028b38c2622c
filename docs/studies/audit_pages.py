"""The CSV file of an audit → the table of docs/studies/audit.md.

The table stands between <!-- audit --> and <!-- /audit -->.

Run it with: python -m docs.studies.audit_pages results/audit
"""

import argparse
import csv
import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "audit.md"
MARKED = re.compile(r"<!-- audit -->\n.*?<!-- /audit -->\n", re.DOTALL)
SHARES = ("cells", "change", "pressure")


def rows_of(folder: Path) -> dict[str, dict[str, dict[str, str]]]:
    """effect → estimator → columns of audit.csv."""
    results: dict[str, dict[str, dict[str, str]]] = {}
    with (folder / "audit.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            results.setdefault(row["effect"], {})[row["estimator"]] = row
    return results


def table(run: dict[str, dict[str, dict[str, str]]]) -> str:
    """Return percent of intervals of cells / changes / pressures that cover the truth.

    The columns are the estimators, and the reports.
    """
    names = list(next(iter(run.values())))
    lines = [["not specified", *names, "reported"]]
    lines.append(["---"] * len(lines[0]))
    for effect, own in run.items():
        first = next(iter(own.values()))
        covered = [shares(own[name]) for name in names]
        lines.append([effect, *covered, f"{first['reported']} of {first['recordings']}"])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def shares(row: dict[str, str]) -> str:
    """Return '97/95/100'."""
    return "/".join(f"{float(row[name]):.0f}" for name in SHARES)


def with_table(text: str, new: str) -> str:
    """A page with its table replaced."""
    return MARKED.sub(lambda _: f"<!-- audit -->\n\n{new}\n<!-- /audit -->\n", text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    results = table(rows_of(parser.parse_args().folder))
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), results), encoding="utf-8")
