"""What published solvers made of random mats, as rows and as a table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lampest.report.compare import Table
from lampest.studies.bench.mats import MatSolve
from lampest.studies.bench.report import short
from lampest.studies.bench.run import Bench


@dataclass(frozen=True)
class MatRow:
    """One solver on all mats of a side with the same noise; see `MatSolve`.

    ms : median. inverses : ms in dense inverses of the mat's lines. reading_error : worst. cell_error : median of the
    mats' medians. worst_cell_error, negative : of all mats; errors in percent.
    """

    side: int
    noise_percent: float
    solver: str
    ms: float
    inverses: float
    iterations: float
    evaluations: float | None
    reading_error: float
    cell_error: float
    worst_cell_error: float
    negative: int
    converged: int
    count: int


def mat_rows(bench: Bench) -> list[MatRow]:
    """By side, noise and solver."""
    keys = dict.fromkeys((solve.side, solve.noise_percent, solve.solver) for solve in bench.mats)
    return [_mat_row([one for one in bench.mats if (one.side, one.noise_percent, one.solver) == key]) for key in keys]


def _mat_row(solves: Sequence[MatSolve]) -> MatRow:
    first = solves[0]

    def median(value: Callable[[MatSolve], float]) -> float:
        return float(np.median([value(solve) for solve in solves]))

    return MatRow(
        first.side,
        first.noise_percent,
        first.solver,
        ms=1e3 * median(lambda solve: solve.seconds),
        inverses=median(lambda solve: solve.seconds / solve.inverse_s),
        iterations=median(lambda solve: solve.iterations),
        evaluations=None if first.evaluations is None else median(lambda solve: float(solve.evaluations or 0)),
        reading_error=max(solve.reading_error for solve in solves),
        cell_error=median(lambda solve: solve.cell_error),
        worst_cell_error=max(solve.worst_cell_error for solve in solves),
        negative=sum(solve.negative for solve in solves),
        converged=sum(solve.converged for solve in solves),
        count=len(solves),
    )


def mats_table(bench: Bench) -> Table:
    """Published solvers on random mats."""
    headers = ("mat", "noise", "solver", "ms", "networks", "misfit %", "cell %", "worst %", "g < 0", "ended")
    cells = tuple(
        (
            f"{row.side} × {row.side}",
            f"{row.noise_percent:g} %",
            row.solver,
            short(row.ms),
            "" if row.evaluations is None else short(row.evaluations),
            _percent(row.reading_error),
            _percent(row.cell_error),
            _percent(row.worst_cell_error),
            str(row.negative),
            f"{row.converged}/{row.count}",
        )
        for row in mat_rows(bench)
    )
    return Table(headers, cells)


def _percent(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "none"
