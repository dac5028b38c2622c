"""Libraries that are not installed: whatever needs one says how it is installed, all else works."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from attack.attack import HELD, Attack, Ended, command, small_folder

# Command → the library without which it is refused; other commands are tried without it, too.
NEEDED: tuple[tuple[str, tuple[str, ...]], ...] = (
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
SPARED = (
    ("info", "small.h5"),
    ("check", "small.h5"),
    ("tare", "small.h5", "--frames", "0:1", "--out", "tared.h5"),
    ("import", "table.csv", "--rows", "3", "--columns", "4", "--out", "imported.h5"),
    ("run", "run.yaml", "--jobs", "1", "--out", "results"),
)
IN_PYTHON = {
    "matplotlib": "lampest.ContourPlot",
    "xarray": "result.to_xarray()",
    "pandas": "result.to_dataframe()",
    "openpyxl": "lampest.import_file('sheet.xlsx', 3, 4)",
}


def _refused(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """The commands that need a library, without it."""
    made = _made(folder)
    for number in sorted(rng.permutation(len(NEEDED))[:count]):
        library, arguments = NEEDED[number]
        ended = command(*arguments, folder=made, without=library)
        yield _named(f"{' '.join(arguments)} without {library}", ended, library)


def _others(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """Commands that need none of the libraries, without any of them; a table may ask for one."""
    made = _made(folder)
    missing = ",".join(library for library, _ in NEEDED)
    for arguments in SPARED[:count]:
        ended = command(*arguments, folder=made, without=missing)
        yield HELD if ended.code == 0 else ended.said(f"{' '.join(arguments)} without {missing}")


def _python(rng: np.random.Generator, folder: Path, count: int) -> Iterator[str]:
    """The same from Python: one sentence."""
    made = _made(folder)
    for library, expression in list(IN_PYTHON.items())[:count]:
        script = (
            "import lampest, sys\n"
            "result = lampest.read_results('results.h5').cases[0]\n"
            f"try:\n    {expression}\n"
            "except lampest.InputError as error:\n    sys.exit(f'lampest: {error}')\n"
        )
        ended = command(folder=made, without=library, script=script)
        held = ended.code == 1 and "Traceback" not in ended.err
        yield _named(f"{expression} without {library}", ended, library, held)


def _named(tried: str, ended: Ended, library: str, held: bool | None = None) -> str:
    if held is None:
        fault = ended.refused(library, "is not installed; pip install")
        return f"{tried}: {fault}" if fault else HELD
    return HELD if held and f"{library}" in ended.err and "pip install" in ended.err else ended.said(tried)


def _made(folder: Path) -> Path:
    from openpyxl import Workbook

    made = small_folder(folder / "work")
    book = Workbook()
    for values in np.random.default_rng(1).uniform(500, 5000, (6, 4)).round(2).tolist():
        book.active.append(values)
    book.save(made / "sheet.xlsx")
    return made


ATTACKS = (
    Attack("libraries", "commands that need what is not installed", _refused, 2, len(NEEDED)),
    Attack("libraries", "commands that do not need what is not installed", _others, 1, len(SPARED)),
    Attack("libraries", "Python that needs what is not installed", _python, 1, len(IN_PYTHON)),
)
