"""Do two results files say the same? One row for each recording × estimator, read with h5py alone.

Run it with: python -m tests.studies.equal BEFORE.h5 AFTER.h5 [--cells 1e-12]
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np

CELLS = ("cell_resistance", "baseline_resistance")
BARS = "cell_resistance_errors"
FLAGS = (
    "status",
    "open_cell",
    "at_lower_bound",
    "saturated",
    "solved",
    "frame",
    "@baseline_status",
    "@joint_start",
)
# How long it took says nothing of the result, and a residual at the tolerance is the rounding of
# another sum.
IGNORED = ("solve_time", "error_bar_time", "kkt_residual")

# Dataset → max |a − b| / max(|a|, |b|) of both files; ∞ for other texts and one of one file.
Row = dict[str, float]


def relative_difference(first: Any, second: Any) -> float:
    """max |a − b| / max(|a|, |b|) over all values.

    Equal values, NaN with NaN too, differ by 0, a lone NaN by ∞.
    """
    a = np.asarray(first, float)
    b = np.asarray(second, float)
    if a.shape != b.shape:
        return float("inf")
    equal_entries = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))
    size = np.where(np.isfinite(a) & np.isfinite(b), size, np.inf)
    return float(np.max(size, where=~equal_entries, initial=0.0))


def datasets(group: h5py.Group) -> dict[str, Any]:
    """All datasets below a group by their path, and the group's status of the baseline."""
    values: dict[str, Any] = {}
    group.visititems(
        lambda path, item: (
            values.update({path: item[()]}) if isinstance(item, h5py.Dataset) else None
        )
    )
    attributes = {
        key: group.attrs[key] for key in ("baseline_status", "joint_start") if key in group.attrs
    }
    return values | {f"@{key}": np.asarray(value) for key, value in attributes.items()}


def row(first: dict[str, Any], second: dict[str, Any]) -> Row:
    """How far each dataset of one group differs between the files."""
    differences = dict.fromkeys(sorted((first.keys() | second.keys()) - {*IGNORED}), float("inf"))
    for key in differences.keys() & first.keys() & second.keys():
        if first[key].dtype.kind in "fiub" and key not in FLAGS:
            differences[key] = relative_difference(first[key], second[key])
        elif np.array_equal(first[key], second[key]):
            differences[key] = 0.0
    return differences


def agrees(differences: Row, cells: float) -> bool:
    """Whether cells lie within the tolerance (relative) and statuses and flags are equal."""
    decisive = [key for key in differences if key in (*CELLS, *FLAGS)]
    return all(differences[key] <= (cells if key in CELLS else 0.0) for key in decisive)


def compare(before: Path, after: Path) -> tuple[dict[str, Row], list[str]]:
    """Rows for each recording × estimator and each recording's readings, and lone groups.

    Lone groups are those that one of them lacks.
    """
    with h5py.File(before) as first, h5py.File(after) as second:
        first_groups, second_groups = (
            {
                f"{recording}/{child}": group[child]
                for recording, group in file["entry"].items()
                for child in group
            }
            for file in (first, second)
        )
        shared = sorted(first_groups.keys() & second_groups.keys())
        return {
            name: row(datasets(first_groups[name]), datasets(second_groups[name]))
            for name in shared
        }, sorted(first_groups.keys() ^ second_groups)


def equal(before: Path, after: Path, cells: float) -> bool:
    """Whether both files hold the same cases.

    Cells are the same within the tolerance, statuses and flags the same.
    """
    rows, lone = compare(before, after)
    return (
        bool(rows) and not lone and all(agrees(differences, cells) for differences in rows.values())
    )


def weights_and_rest(differences: Row) -> tuple[float, tuple[float, str]]:
    """The largest difference of a weight, and that of all other datasets with its name.

    The former is NaN without any.
    """
    weights = [value for key, value in differences.items() if key.startswith("weight/")]
    remaining = [
        key
        for key in differences
        if key not in (*CELLS, BARS, *FLAGS) and not key.startswith("weight/")
    ]
    return max(weights, default=float("nan")), max(
        ((differences[key], key) for key in remaining), default=(0.0, "")
    )


def show(rows: dict[str, Row], lone: list[str], cells: float) -> None:
    """Print the table, and below it the groups of one file only.

    Readings appear where they differ.
    """
    width = max(map(len, rows), default=9)
    largest = 0.0
    print(f"{'':{width}}  {'cells':>9}  {'baseline':>9}  {'bars':>9}  {'weights':>9}  flags")
    for name, differences in rows.items():
        weight, (most, where) = weights_and_rest(differences)
        if name.endswith("/recording") and agrees(differences, cells) and not most:
            continue
        values = [*(differences.get(key, float("nan")) for key in (*CELLS, BARS)), weight]
        largest = max(largest, *(differences.get(key, 0.0) for key in CELLS))
        figures = "  ".join("        -" if np.isnan(value) else f"{value:9.1e}" for value in values)
        unequal = ", ".join(key for key in FLAGS if differences.get(key)) or "equal"
        print(
            f"{name:{width}}  {figures}  {unequal}"
            + (f"; rest {most:.1e} in {where}" if most else "")
        )
    for name in lone:
        print(f"in one file only: {name}")
    print(f"largest difference of a cell {largest:.1e}, allowed {cells:.1e}")


def main() -> int:
    """0 where both files agree, 1 where they do not."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument(
        "--cells", type=float, default=1e-12, help="allowed relative difference of a cell"
    )
    arguments = parser.parse_args()
    show(*compare(arguments.before, arguments.after), arguments.cells)
    return 0 if equal(arguments.before, arguments.after, arguments.cells) else 1


if __name__ == "__main__":
    sys.exit(main())
