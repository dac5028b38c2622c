"""Libraries that are not installed: whatever needs one says how it is installed, all else works."""

from pathlib import Path

import numpy as np
import pytest
from attack.attack import Outcomes, Rng, attack, command, drawn, small_folder, unless
from openpyxl import Workbook

# Command → the library without which it is refused; other commands are tried without it, too.
NEEDING_COMMANDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("serial", ("record", "--list")),
    ("matplotlib", ("plot", "results.h5")),
    ("jinja2", ("compare", "results.h5", "--report", "page.html")),
    ("openpyxl", ("import", "sheet.xlsx", "--rows", "3", "--columns", "4", "--out", "made.h5")),
    ("pyarrow", ("export", "results.h5", "--to", "parquet")),
    ("pynwb", ("export", "results.h5", "--to", "nwb", "--start", "2026-05-04T09:30:00Z")),
    ("zarr", ("export", "results.h5", "--to", "zarr")),
    ("distributed", ("run", "run.yaml", "--set", "executor={kind: dask}", "--out", "out")),
    ("mpmath", ("study", "extremes", "--out", "atlas")),
)
INDEPENDENT_COMMANDS = (
    ("info", "small.h5"),
    ("check", "small.h5"),
    ("tare", "small.h5", "--frames", "0:1", "--out", "tared.h5"),
    ("import", "table.csv", "--rows", "3", "--columns", "4", "--out", "imported.h5"),
    ("run", "run.yaml", "--jobs", "1", "--out", "results"),
)


pytestmark = pytest.mark.slow


@attack(2, len(NEEDING_COMMANDS))
def test_commands_name_a_missing_library_and_work_without_unneeded_ones(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    work_folder = small_folder(folder / "work")
    book = Workbook()
    for values in np.random.default_rng(1).uniform(500, 5000, (6, 4)).round(2).tolist():
        book.active.append(values)
    book.save(work_folder / "sheet.xlsx")
    for _, (library, arguments) in drawn(rng, NEEDING_COMMANDS, count):
        completed = command(*arguments, folder=work_folder, without=library)
        yield completed.refused(library, "is not installed; pip install")
    missing = ",".join(library for library, _ in NEEDING_COMMANDS)
    for arguments in INDEPENDENT_COMMANDS[: count - 1]:
        completed = command(*arguments, folder=work_folder, without=missing)
        yield unless(
            completed.code == 0, completed.described(f"{' '.join(arguments)} without {missing}")
        )
