"""The CSV files of audits → the table of docs/studies/audit.md, between <!-- audit --> and <!-- /audit -->.

Run it with: python -m tests.studies.audit_pages results/audit [results/again …]
Effects and χ² are those of the first; of the others estimators are shown with `again`, where they have the effect.
"""

import argparse
import csv
import re
from collections.abc import Sequence
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "audit.md"
MARKED = re.compile(r"<!-- audit -->\n.*?<!-- /audit -->\n", re.DOTALL)
SHARES = ("cells", "change", "pressure")


def rows_of(folder: Path) -> dict[str, dict[str, dict[str, str]]]:
    """effect → estimator → columns of audit.csv."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    with (folder / "audit.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["effect"], {})[row["estimator"]] = row
    return found


def table(runs: Sequence[dict[str, dict[str, dict[str, str]]]]) -> str:
    """Percent of intervals of cells / changes / pressures that hold the truth, for each estimator; χ²; told."""
    columns = [(number, name) for number, run in enumerate(runs) for name in next(iter(run.values()))]
    heads = [f"{name}, again" if number else name for number, name in columns]
    lines = [["not told", *heads, "χ²", "told"], ["---"] * (len(heads) + 3)]
    for effect, own in runs[0].items():
        first = next(iter(own.values()))
        cells = [shares(runs[number].get(effect, {}).get(name)) for number, name in columns]
        lines.append([effect, *cells, f"{float(first['chi_square']):.3g}", f"{first['told']} of {first['recordings']}"])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def shares(row: dict[str, str] | None) -> str:
    """'97 / 95 / 100', or nothing."""
    return "" if row is None else " / ".join(f"{float(row[name]):.0f}" for name in SHARES)


def with_table(text: str, new: str) -> str:
    """A page with its table replaced."""
    return MARKED.sub(lambda _: f"<!-- audit -->\n\n{new}\n<!-- /audit -->\n", text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    found = table([rows_of(folder) for folder in parser.parse_args().folders])
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
