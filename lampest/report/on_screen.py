"""What `lampest compare` prints: one block a recording, a summary for many, and what its columns mean."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lampest.report.compare import SOUND, Row, Spread, Table
from lampest.runs.results import StepFigures
from lampest.solvers.solution import VERIFIED

LEAST = 1e-3  # percent or ms: less is rounding
MOST_BLOCKS = 6  # recordings that are shown one by one; more are summed up
STEPS = {"all": "", "initial": " first", "following": " later"}
SOLVED_NOTE = (
    "solved: frames whose estimate was checked outside the solver: a local optimum (no small change of the cells costs "
    "less), the lowest that its starts reached (lampest info tells how many); or what else the formulation promises"
)
LATER_NOTE = (
    "first, later: the first frame, solved jointly with the baseline as the paper does, and the frames after it"
)
ERROR_NOTES = {
    "data error [%]": "data error: |model − measured| / measured, mean ± standard deviation over all readings",
    "cell error [%]": "cell error: |estimate − truth| / truth of the cells, median / 95th percentile",
}
PUBLISHED_NOTE = (
    "published: of another recording, on another computer, as the run's file quotes it; figures of this recording are "
    "not expected to equal it"
)

Column = tuple[str, Callable[[Row], str]]


@dataclass(frozen=True)
class TitledTable:
    """A table and the line above it."""

    title: str
    table: Table


def screen_blocks(rows: Sequence[Row], each: bool = False) -> list[TitledTable]:
    """A block for each recording; of more than six recordings one that sums them up, unless `each` is asked for."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.source, row.recording), []).append(row)
    if len(groups) > MOST_BLOCKS and not each:
        return [_summary(rows, len(groups))]
    several = len({source for source, _ in groups}) > 1
    return [TitledTable(_title(group, several), _table(group, COLUMNS)) for group in groups.values()]


def legend(rows: Sequence[Row], blocks: Sequence[TitledTable]) -> list[str]:
    """What the headers of the blocks mean, a sentence each."""
    headers = {header for block in blocks for header in block.table.headers}
    notes = [SOLVED_NOTE] if rows else []
    notes += [note for header, note in ERROR_NOTES.items() if any(each.startswith(header) for each in headers)]
    notes += [LATER_NOTE] if any(row.steps != "all" for row in rows) else []
    return notes + ([PUBLISHED_NOTE] if any("published" in header for header in headers) else [])


def _title(group: Sequence[Row], several: bool) -> str:
    """'lamprey_35mm: 21 frames, 12 readings missing'."""
    own = [row for row in group if row.estimator == group[0].estimator]
    counts = [
        (sum(row.frames for row in own), "frames"),
        (sum(row.missing_readings for row in own), "readings missing"),
        (sum(row.bound_readings for row in own), "readings only bounds"),
    ]
    told = ", ".join(f"{count} {what}" for number, (count, what) in enumerate(counts) if count or not number)
    return f"{own[0].source + ': ' if several else ''}{own[0].recording}: {told}"


def _table(rows: Sequence[Row], columns: Sequence[Column]) -> Table:
    """A column in which no row has anything is left out."""
    filled = [(header, [text(row) for row in rows]) for header, text in columns]
    filled = [(header, texts) for header, texts in filled if any(texts)]
    return Table(tuple(header for header, _ in filled), tuple(zip(*(texts for _, texts in filled), strict=True)))


def _plus_minus(values: Spread | None, factor: float = 1.0) -> str:
    if values is None:
        return ""
    if 0 < factor * values.mean < LEAST:
        return f"< {LEAST:g}"
    form = _format(factor * values.mean, 2)
    sd = "" if values.sd is None else f" ± {form.format(factor * values.sd)}"
    return form.format(factor * values.mean) + sd


def _two(values: Spread | None) -> str:
    """Median / 95th percentile."""
    if values is None:
        return ""
    return " / ".join(_format(value, 3).format(value) for value in (values.median, values.percentile_95))


def _published(figures: StepFigures | None, mean: str, sd: str) -> str:
    if figures is None or getattr(figures, mean) is None:
        return ""
    deviation = getattr(figures, sd)
    return f"{getattr(figures, mean):g}" + ("" if deviation is None else f" ± {deviation:g}")


def _format(value: float, digits: int) -> str:
    """A format with so many significant digits of `value`, without an exponent wherever that is short."""
    if not 1e-4 <= abs(value) < 1e5:
        return f"{{:.{digits - 1}e}}" if value else "{:g}"
    return f"{{:.{max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))}f}}"


def _residual(residual: float | None) -> str:
    """Where it alone does not show an optimum, and a Newton step had to."""
    return "" if residual is None or residual <= VERIFIED else f"{residual:.0e}"


COLUMNS: tuple[Column, ...] = (
    ("estimator", lambda row: row.estimator),
    ("solved", lambda row: f"{row.solved}/{row.frames}{STEPS[row.steps]}"),
    ("time [ms]", lambda row: _plus_minus(row.solve_time, 1000)),
    ("data error [%]", lambda row: _plus_minus(row.data_error)),
    ("cell error [%]", lambda row: _two(row.cell_error)),
    ("open cells", lambda row: str(row.open_cells or "")),
    ("worst KKT", lambda row: _residual(row.worst_kkt_residual)),
    ("model", lambda row: "" if row.model_mark in SOUND else row.model_mark),
    ("published time [s]", lambda row: _published(row.published, "time_s", "time_sd_s")),
    ("published error [%]", lambda row: _published(row.published, "error_percent", "error_sd_percent")),
)


def _summary(rows: Sequence[Row], recordings: int) -> TitledTable:
    """One row for each estimator, over all recordings: medians, and the range of the cells' median error."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.estimator, row.steps), []).append(row)
    title = (
        f"{recordings} recordings, medians over them (--each shows every one, --csv FILE and --report PAGE hold all)"
    )
    lines = [tuple(text(group) for _, text in OVER_ALL) for group in groups.values()]
    kept = [number for number in range(len(OVER_ALL)) if any(line[number] for line in lines)]
    headers = tuple(OVER_ALL[number][0] for number in kept)
    return TitledTable(title, Table(headers, tuple(tuple(line[number] for number in kept) for line in lines)))


def _median(values: Sequence[float], factor: float = 1.0) -> str:
    if not values:
        return ""
    middle = factor * float(np.median(values))
    return _format(middle, 3).format(middle)


def _range(values: Sequence[float]) -> str:
    return " … ".join(_format(value, 3).format(value) for value in (min(values), max(values))) if values else ""


OVER_ALL: tuple[tuple[str, Callable[[Sequence[Row]], str]], ...] = (
    ("estimator", lambda group: group[0].estimator),
    (
        "solved",
        lambda group: f"{sum(row.solved for row in group)}/{sum(row.frames for row in group)}{STEPS[group[0].steps]}",
    ),
    ("time [ms]", lambda group: _median([row.solve_time.mean for row in group if row.solve_time], 1000)),
    ("data error [%], mean", lambda group: _median([row.data_error.mean for row in group if row.data_error])),
    ("cell error [%], median", lambda group: _median([row.cell_error.median for row in group if row.cell_error])),
    ("least … most of them", lambda group: _range([row.cell_error.median for row in group if row.cell_error])),
    ("open cells", lambda group: str(sum(row.open_cells for row in group) or "")),
    ("worst KKT", lambda group: _residual(max((row.worst_kkt_residual or 0.0 for row in group), default=None))),
)
