"""Do two results files say the same? One row for each recording × estimator, read with h5py alone.

Run it with: python -m tests.studies.equal BEFORE.h5 AFTER.h5 [--cells 1e-12]
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

CELLS = ("cell_resistance", "baseline_resistance")
BARS = "cell_resistance_errors"
FLAGS = ("status", "open_cell", "at_lower_bound", "saturated", "solved", "frame")
# How long it took says nothing of the result, and a residual at the tolerance is the rounding of another sum.
IGNORED = ("solve_time", "error_bar_time", "kkt_residual")


@dataclass(frozen=True)
class Row:
    """What one estimator of one recording says in both files; differences are max |a − b| / max(|a|, |b|).

    A difference is NaN where neither file holds the figure; `rest` names the dataset that differs most of all others.
    """

    name: str
    differences: dict[str, float]
    rest: tuple[str, float]
    unequal: tuple[str, ...]
    alone: tuple[str, ...]

    def agrees(self, cells: float) -> bool:
        """Whether cells lie within the tolerance (relative) and statuses and flags are equal."""
        return not self.unequal and not any(self.differences[name] > cells for name in CELLS)


def relative_difference(ours: Any, theirs: Any) -> float:
    """max |a − b| / max(|a|, |b|) over all values; equal values, NaN with NaN too, differ by 0, a lone NaN by ∞."""
    a, b = np.asarray(ours, float), np.asarray(theirs, float)
    if a.shape != b.shape:
        return float("inf")
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))
    size = np.where(np.isfinite(a) & np.isfinite(b), size, np.inf)
    return float(np.max(size, where=~same, initial=0.0))


def datasets(group: h5py.Group) -> dict[str, Any]:
    """All datasets below a group by their path, and the group's status of the baseline."""
    values: dict[str, Any] = {}
    group.visititems(lambda path, item: values.update({path: item[()]}) if isinstance(item, h5py.Dataset) else None)
    attributes = {key: group.attrs[key] for key in ("baseline_status", "joint_start") if key in group.attrs}
    return values | {f"@{key}": np.asarray(value) for key, value in attributes.items()}


def row(name: str, ours: dict[str, Any], theirs: dict[str, Any]) -> Row:
    """What one group says in both files; a cell or a flag that one of them lacks counts as unequal."""
    shared = sorted(ours.keys() & theirs.keys())
    size = {key: relative_difference(ours[key], theirs[key]) for key in shared if ours[key].dtype.kind in "fiub"}
    decisive = [key for key in sorted(ours.keys() | theirs.keys()) if key in FLAGS or key.startswith("@")]
    weights = [key for key in size if key.startswith("weight/")]
    others = [key for key in size if key not in {*CELLS, BARS, *decisive, *weights, *IGNORED}]
    worst = max(others, key=lambda key: size[key], default="")
    alone = tuple(sorted((ours.keys() ^ theirs.keys()) - {*IGNORED}))
    unequal = [key for key in decisive if key in shared and not np.array_equal(ours[key], theirs[key])]
    return Row(
        name,
        {key: size.get(key, float("nan")) for key in (*CELLS, BARS)}
        | {"weight": max((size[key] for key in weights), default=float("nan"))},
        (worst, size.get(worst, 0.0)),
        (*unequal, *(key for key in alone if key in CELLS or key in decisive)),
        alone,
    )


def compare(before: Path, after: Path) -> tuple[list[Row], list[str]]:
    """Rows for each recording × estimator and each recording's readings, and the groups that one of them lacks."""
    with h5py.File(before) as first, h5py.File(after) as second:
        names = [
            {f"{recording}/{child}" for recording, group in file["entry"].items() for child in group}
            for file in (first, second)
        ]
        rows = [
            row(name, datasets(first["entry"][name]), datasets(second["entry"][name]))
            for name in sorted(names[0] & names[1])
        ]
    return rows, sorted(names[0] ^ names[1])


def largest(rows: list[Row]) -> float:
    """The largest relative difference of any cell, the baseline's included."""
    return max((row.differences[name] for row in rows for name in CELLS if row.differences[name] >= 0), default=0.0)


def equal(before: Path, after: Path, cells: float) -> bool:
    """Whether both files hold the same cases, cells within the tolerance, statuses and flags the same."""
    rows, lone = compare(before, after)
    return bool(rows) and not lone and all(row.agrees(cells) for row in rows)


def show(rows: list[Row], lone: list[str], cells: float) -> None:
    """Print the table, and below it the groups of one file only; readings appear where they differ."""
    width = max((len(row.name) for row in rows), default=9)
    print(f"{'':{width}}  {'cells':>9}  {'baseline':>9}  {'bars':>9}  {'weights':>9}  flags")
    for row in rows:
        if row.name.endswith("/recording") and row.agrees(cells) and not row.rest[1]:
            continue
        figures = "  ".join("        -" if np.isnan(value) else f"{value:9.1e}" for value in row.differences.values())
        rest = f"; rest {row.rest[1]:.1e} in {row.rest[0]}" if row.rest[1] else ""
        print(f"{row.name:{width}}  {figures}  {', '.join(row.unequal) or 'equal'}{rest}")
    paths = Counter(path for row in rows for path in row.alone)
    for name in (*lone, *(f"{path} of {count} groups" for path, count in sorted(paths.items()))):
        print(f"in one file only: {name}")
    print(f"largest difference of a cell {largest(rows):.1e}, allowed {cells:.1e}")


def main() -> int:
    """0 where both files agree, 1 where they do not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--cells", type=float, default=1e-12, help="allowed relative difference of a cell")
    arguments = parser.parse_args()
    show(*compare(arguments.before, arguments.after), arguments.cells)
    return 0 if equal(arguments.before, arguments.after, arguments.cells) else 1


if __name__ == "__main__":
    sys.exit(main())
