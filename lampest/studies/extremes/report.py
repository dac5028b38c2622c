"""The atlas' figures: by cell of the atlas as CSV, every solve as HDF5, and the promise in sentences."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.solvers.solution import VERIFIED
from lampest.studies.extremes.run import REFUSED, Solve
from lampest.studies.extremes.scenes import CASES
from lampest.studies.extremes.settings import GRID
from lampest.studies.study import samples_file, write_rows

MILD_DECADES, MILD_NOISE = 6.0, 0.01
NAN = float("nan")
PLAIN = str.maketrans({"⁶": "^6", "×": "x", "Ω": "ohm"})  # HDF5 text is ASCII


@dataclass(frozen=True)
class AtlasRow:
    """One cell of the atlas: all solves of a case with a contrast, size, noise, method and formulation.

    Parameters
    ----------
    solves, verified : how many, and how many ended with an estimate of which the audit says nothing bad.
    named : ended with a sentence instead. doubtful : estimates that the audit does not confirm. crashed : neither.
    worse : estimates that cost more than the truth does.
    forward_digits, model_digits, estimate_digits : the least of `Solve`'s. median_digits : median of the last.
    residual, audited : the largest of the estimates. iterations, most_iterations : median and largest.
    statuses : how often each sentence.
    """

    case: str
    decades: float
    rows: int
    columns: int
    noise: float
    method: str
    formulation: str
    solves: int
    verified: int
    named: int
    doubtful: int
    crashed: int
    worse: int
    forward_digits: float
    model_digits: float
    estimate_digits: float
    median_digits: float
    residual: float
    audited: float
    iterations: float
    most_iterations: int
    statuses: str


def place(solve: Solve) -> tuple[Any, ...]:
    """The cell of the atlas that a solve belongs to."""
    own = solve.sample
    return own.case, own.decades, own.rows, own.columns, own.noise, solve.method, solve.formulation


def atlas_rows(solves: Sequence[Solve]) -> list[AtlasRow]:
    """All cells of the atlas, in its order."""
    return [AtlasRow(*cell, **_figures(own)) for cell, own in grouped(solves, place).items()]


def grouped(solves: Iterable[Solve], key: Callable[[Solve], Any]) -> dict[Any, list[Solve]]:
    """Solves by what the key says of them, in the order in which that first appears."""
    found: dict[Any, list[Solve]] = {}
    for solve in solves:
        found.setdefault(key(solve), []).append(solve)
    return found


def _figures(own: Sequence[Solve]) -> dict[str, Any]:
    estimates = [solve for solve in own if solve.solved]
    counted = Counter(solve.status for solve in own)
    return {
        "solves": len(own),
        "verified": sum(solve.verified for solve in own),
        "named": sum(not solve.solved and not solve.crashed for solve in own),
        "doubtful": sum(solve.doubtful for solve in own),
        "crashed": sum(solve.crashed for solve in own),
        "worse": sum(solve.excess > VERIFIED for solve in estimates),
        "forward_digits": _of(np.min, [solve.forward_digits for solve in own]),
        "model_digits": _of(np.min, [solve.model_digits for solve in estimates]),
        "estimate_digits": _of(np.min, [solve.estimate_digits for solve in estimates]),
        "median_digits": _of(np.median, [solve.estimate_digits for solve in estimates]),
        "residual": _of(np.max, [solve.residual for solve in estimates]),
        "audited": _of(np.max, [solve.audited for solve in estimates]),
        "iterations": float(np.median([solve.iterations for solve in own])),
        "most_iterations": max(solve.iterations for solve in own),
        "statuses": "; ".join(f"{count} × {status}" for status, count in counted.most_common()),
    }


def _of(reduce: Callable[[Any], Any], values: Sequence[float]) -> float:
    """The reduction of all numbers; NaN where there is none."""
    known = [value for value in values if np.isfinite(value)]
    return float(reduce(known)) if known else NAN


def atlas_table(solves: Sequence[Solve]) -> Table:
    """A line for every number of decades of the random panels and for every other case, all methods together."""
    headers = (
        "case",
        "decades",
        "verified",
        "named",
        "doubtful",
        "crashed",
        "worse than truth",
        "digits: forward",
        "model",
        "estimate (median)",
        "worst KKT",
        "audited",
        "iterations (most)",
    )
    cells = []
    for (case, decades), own in grouped(solves, lambda solve: (solve.sample.case, solve.sample.decades)).items():
        figures = _figures(own)
        cells.append(
            (
                case,
                f"{decades:g}" if CASES[case].contrasted else "",
                f"{figures['verified']}/{figures['solves']}",
                *(f"{figures[name] or ''}" for name in ("named", "doubtful", "crashed", "worse")),
                *(_digits(figures[name]) for name in ("forward_digits", "model_digits")),
                _digits(figures["estimate_digits"])
                and f"{_digits(figures['estimate_digits'])} ({_digits(figures['median_digits'])})",
                *("" if np.isnan(figures[name]) else f"{figures[name]:.0e}" for name in ("residual", "audited")),
                f"{figures['iterations']:.0f} ({figures['most_iterations']})",
            )
        )
    return Table(headers, tuple(cells))


def _digits(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.1f}"


def mild(solve: Solve) -> bool:
    """Whether a verified optimum is promised: noise up to 1 %, and a contrast up to 10⁶ or a single fault."""
    case = CASES[solve.sample.case]
    contrast = case.contrasted and solve.sample.decades <= MILD_DECADES
    return (contrast or case.single_fault) and solve.sample.noise <= MILD_NOISE


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """The promise in numbers, and how the others ended."""
    told = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    lines = [f"{told} of {len(solves)} solves end with a verified optimum or a sentence ({_share(told, len(solves))})"]
    for title, chosen in (
        ("all", list(solves)),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in grouped(tame, lambda solve: solve.sample.case).items()),
    ):
        good = sum(solve.verified for solve in chosen)
        lines.append(f"{title}: {good} of {len(chosen)} verified ({_share(good, len(chosen))})")
    ended = Counter(_kind(solve.status) for solve in solves if not solve.solved)
    lines += [f"{count} × {status}" for status, count in ended.most_common()]
    return lines


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "none tried"


def _kind(status: str) -> str:
    """A refusal without the numbers of its scene."""
    return status.split(":")[0] + ": the input" if status.startswith(REFUSED) else status


def write_atlas(folder: Path, solves: Sequence[Solve]) -> tuple[Path, Path]:
    """Write extremes.csv, a row for every cell of the atlas, and extremes.h5 with every solve; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    table, samples = folder / "extremes.csv", folder / "extremes.h5"
    write_rows(table, AtlasRow, atlas_rows(solves))
    _write_samples(samples, solves)
    return table, samples


def _write_samples(path: Path, solves: Sequence[Solve]) -> None:
    """/entry/solves: one entry for each solve, in the order of the atlas."""
    columns: tuple[tuple[str, str, str, Callable[[Solve], Any]], ...] = (
        ("case", "1", "name of the scene", lambda solve: solve.sample.case.translate(PLAIN)),
        ("rows", "1", "row lines", lambda solve: solve.sample.rows),
        ("columns", "1", "column lines", lambda solve: solve.sample.columns),
        ("decades", "1", "decades between the least and the largest cell", lambda solve: solve.sample.decades),
        ("noise", "1", "relative standard deviation of a reading", lambda solve: solve.sample.noise),
        ("seed", "1", "seed of cells and noise", lambda solve: solve.sample.seed),
        ("method", "1", "method", lambda solve: solve.method),
        ("formulation", "1", "formulation", lambda solve: solve.formulation),
        ("part", "1", "baseline, frame, or the pair of both", lambda solve: solve.part),
        ("verified", "1", "1: an estimate that nothing speaks against", lambda solve: int(solve.verified)),
        ("solved", "1", "1: there is an estimate", lambda solve: int(solve.solved)),
        ("doubtful", "1", "1: an estimate that the audit does not confirm", lambda solve: int(solve.doubtful)),
        ("status", "1", "how the solve ended", lambda solve: solve.status),
        ("iterations", "1", "iterations of the solver", lambda solve: solve.iterations),
        ("kkt_residual", "1", "KKT residual of the accepted estimate", lambda solve: solve.residual),
        ("audited_residual", "1", "the same by differences of the exact forward map", lambda solve: solve.audited),
        ("excess", "1", "cost of the estimate over that of the truth, scaled", lambda solve: solve.excess),
        ("forward_digits", "1", "LRE of the forward map, 50 digits", lambda solve: solve.forward_digits),
        ("model_digits", "1", "LRE of the estimate's two-point resistance", lambda solve: solve.model_digits),
        ("estimate_digits", "1", "LRE against the convex solution", lambda solve: solve.estimate_digits),
    )
    with samples_file(path, "extremes/1", default="solves", verified_below=VERIFIED) as entry:
        group = entry.create_group("solves")
        hdf5.set_attributes(group, NX_class="NXdata", signal="verified", axes=["solve"])
        hdf5.write_scale(group, "solve", np.arange(len(solves)), "1", "solve, in the order of the atlas")
        for name, units, long_name, value in columns:
            values = [value(solve) for solve in solves]
            text = isinstance(values[0], str)
            hdf5.write_dataset(group, name, hdf5.ascii_array(values) if text else values, units, long_name, ("solve",))


def random_cells(solves: Sequence[Solve]) -> list[Solve]:
    """The solves of random panels."""
    return [solve for solve in solves if solve.sample.case == GRID]


def structured(solves: Sequence[Solve]) -> list[Solve]:
    """The solves of all other cases."""
    return [solve for solve in solves if solve.sample.case != GRID]
