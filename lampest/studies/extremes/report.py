"""The atlas' figures: by cell of the atlas as CSV, every solve as HDF5, and the promise in sentences."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lampest.report.compare import Table
from lampest.solvers.solution import VERIFIED
from lampest.studies.extremes.figure import plot_extremes
from lampest.studies.extremes.run import REFUSED, Solve, grouped, run_atlas
from lampest.studies.extremes.scenes import CASES, AtlasFile
from lampest.studies.study import Reported, Study, read_settings, write_rows, write_sequence

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


COLUMNS = (
    ("case", "1", "name of the scene", "sample.case"),
    ("rows", "1", "row lines", "sample.rows"),
    ("columns", "1", "column lines", "sample.columns"),
    ("decades", "1", "decades between the least and the largest cell", "sample.decades"),
    ("noise", "1", "relative standard deviation of a reading", "sample.noise"),
    ("seed", "1", "seed of cells and noise", "sample.seed"),
    ("method", "1", "method"),
    ("formulation", "1", "formulation"),
    ("part", "1", "baseline, frame, or the pair of both"),
    ("verified", "1", "1: an estimate that nothing speaks against"),
    ("solved", "1", "1: there is an estimate"),
    ("doubtful", "1", "1: an estimate that the audit does not confirm"),
    ("status", "1", "how the solve ended"),
    ("iterations", "1", "iterations of the solver"),
    ("kkt_residual", "1", "KKT residual of the accepted estimate", "residual"),
    ("audited_residual", "1", "the same by differences of the exact forward map", "audited"),
    ("excess", "1", "cost of the estimate over that of the truth, scaled"),
    ("forward_digits", "1", "LRE of the forward map, 50 digits"),
    ("model_digits", "1", "LRE of the estimate's two-point resistance"),
    ("estimate_digits", "1", "LRE against the convex solution"),
)


def report_atlas(found: Sequence[Solve], settings: AtlasFile, folder: Path) -> Reported:
    """Write extremes.csv, a row for every cell of the atlas, extremes.h5 with every solve, and the figure."""
    path, axis = folder / "extremes.h5", ("solve", "solve, in the order of the atlas")
    plain = [replace(one, sample=replace(one.sample, case=one.sample.case.translate(PLAIN))) for one in found]
    files = (
        write_rows(folder / "extremes.csv", AtlasRow, atlas_rows(found)),
        write_sequence(path, "extremes/1", "solves", "verified", axis, plain, COLUMNS, verified_below=VERIFIED),
        plot_extremes(found, folder / "extremes.png"),
    )
    return Reported([("", atlas_table(found))], files, atlas_remarks(found))


STUDY: Study[AtlasFile, Sequence[Solve]] = Study(
    "scenes", "extremes.yaml", read_settings(AtlasFile), run_atlas, report_atlas
)
