"""The atlas' figures: by cell of the atlas as CSV, every solve as HDF5, and the promise in sentences."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.solvers.solution import VERIFIED
from lampest.studies import study
from lampest.studies.extremes.figure import extremes_figure
from lampest.studies.extremes.run import COLUMNS, REFUSED, Solve, run_atlas
from lampest.studies.extremes.scenes import CASES, AtlasFile

MILD_DECADES, MILD_NOISE = 6.0, 0.01  # up to which every solve shall end verified
PLAIN = str.maketrans({"⁶": "^6", "×": "x", "Ω": "ohm"})  # HDF5 text is ASCII


def atlas_rows(solves: Sequence[Solve]) -> list[study.Row]:
    """A row for each cell of the atlas, in its order: a case with a contrast, size, noise, method and formulation."""

    def cell(solve: Solve) -> tuple[Any, ...]:
        own = solve.sample
        return own.case, own.decades, own.rows, own.columns, own.noise, solve.method, solve.formulation

    return study.rows_of(study.grouped(solves, cell).values(), FIGURES)


def _count(what: str) -> Callable[[Sequence[Solve]], int]:
    return lambda own: sum(getattr(solve, what) for solve in own)


def _of(reduce: Callable[[Any], Any], what: str, estimates: bool = True) -> Callable[[Sequence[Solve]], float]:
    """The reduction of all numbers, by default of estimates; NaN where there is none."""

    def reduced(own: Sequence[Solve]) -> float:
        values = [getattr(solve, what) for solve in own if solve.solved or not estimates]
        known = [value for value in values if np.isfinite(value)]
        return float(reduce(known)) if known else float("nan")

    return reduced


def _statuses(own: Sequence[Solve]) -> str:
    counted = Counter(solve.status for solve in own)
    return "; ".join(f"{count} × {status}" for status, count in counted.most_common())


FIGURES: study.Figures = {
    "case": lambda own: own[0].sample.case,
    "decades": lambda own: own[0].sample.decades,
    "rows": lambda own: own[0].sample.rows,
    "columns": lambda own: own[0].sample.columns,
    "noise": lambda own: own[0].sample.noise,
    "method": lambda own: own[0].method,
    "formulation": lambda own: own[0].formulation,
    "solves": len,
    "verified": _count("verified"),  # an estimate of which the audit says nothing bad
    "named": lambda own: sum(not solve.solved and not solve.crashed for solve in own),  # a sentence instead
    "doubtful": _count("doubtful"),  # estimates that the audit does not confirm
    "crashed": _count("crashed"),  # neither
    "worse": lambda own: sum(solve.solved and solve.excess > VERIFIED for solve in own),  # cost more than the truth
    "forward_digits": _of(np.min, "forward_digits", False),
    "model_digits": _of(np.min, "model_digits"),
    "estimate_digits": _of(np.min, "estimate_digits"),
    "median_digits": _of(np.median, "estimate_digits"),
    "residual": _of(np.max, "residual"),
    "audited": _of(np.max, "audited"),
    "iterations": lambda own: float(np.median([solve.iterations for solve in own])),
    "most_iterations": lambda own: max(solve.iterations for solve in own),
    "statuses": _statuses,
}


def _estimate_digits(row: study.Row) -> str:
    least = study.text_of(row.estimate_digits, ".1f")
    return least and f"{least} ({study.text_of(row.median_digits, '.1f')})"


SCREEN: dict[str, Callable[[study.Row], str]] = {
    "case": lambda row: row.case,
    "decades": lambda row: f"{row.decades:g}" if CASES[row.case].contrasted else "",
    "verified": lambda row: f"{row.verified}/{row.solves}",
    "named": lambda row: f"{row.named or ''}",
    "doubtful": lambda row: f"{row.doubtful or ''}",
    "crashed": lambda row: f"{row.crashed or ''}",
    "worse than truth": lambda row: f"{row.worse or ''}",
    "digits: forward": lambda row: study.text_of(row.forward_digits, ".1f"),
    "model": lambda row: study.text_of(row.model_digits, ".1f"),
    "estimate (median)": _estimate_digits,
    "worst KKT": lambda row: study.text_of(row.residual, ".0e"),
    "audited": lambda row: study.text_of(row.audited, ".0e"),
    "iterations (most)": lambda row: f"{row.iterations:.0f} ({row.most_iterations})",
}


def atlas_table(solves: Sequence[Solve]) -> Table:
    """A line for every number of decades of the random panels and for every other case, all methods together."""
    groups = study.grouped(solves, lambda solve: (solve.sample.case, solve.sample.decades))
    return study.screen_table(study.rows_of(groups.values(), FIGURES), SCREEN)


def mild(solve: Solve) -> bool:
    """Whether a verified optimum is promised: noise up to 1 %, and a contrast up to 10⁶ or a single fault."""
    case = CASES[solve.sample.case]
    contrast = case.contrasted and solve.sample.decades <= MILD_DECADES
    return (contrast or case.single_fault) and solve.sample.noise <= MILD_NOISE


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """The promise in numbers, and how the others ended."""
    named = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    lines = [
        f"{named} of {len(solves)} solves end with a verified optimum or a sentence ({_share(named, len(solves))})"
    ]
    for title, chosen in (
        ("all", list(solves)),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in study.grouped(tame, lambda solve: solve.sample.case).items()),
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


def _write_solves(entry: Any, found: Sequence[Solve]) -> None:
    """/entry/solves: every solve, in the order of the atlas."""
    axis = ("solve", "solve, in the order of the atlas")
    plain = [replace(one, sample=replace(one.sample, case=one.sample.case.translate(PLAIN))) for one in found]
    hdf5.set_attributes(entry, verified_below=VERIFIED)
    study.write_sequence(entry, "solves", "verified", axis, plain, COLUMNS)


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    FIGURES,
    atlas_rows,
    lambda found: [("", atlas_table(found))],
    "extremes/1",
    _write_solves,
    lambda found: {"extremes": extremes_figure(found)},
    remarks=atlas_remarks,
)
