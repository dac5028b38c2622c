"""Tables over recordings and estimators: time, data error, cell error, and what a publication gives beside them."""

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.whole import write_whole
from lampest.panel.panel import Array
from lampest.report.words import counted, digits
from lampest.runs.results import CaseResult, PublishedFigures, Results, StepFigures, read_results

Steps = Literal["all", "initial", "following"]
T = TypeVar("T")
LEAST = 1e-3  # percent or ms: less is rounding
STEPS = {"all": "", "initial": " first", "following": " later"}
NOTES = {  # what a header that begins so means
    "solved": "solved: frames that converged to a local minimum, verified outside the solver; of several starts the "
    "lowest one (lampest info has their number). Approximate formulations count as solved when they end",
    "data error [%]": "data error: |model − measured| / measured, mean ± standard deviation over all readings",
    "cell error [%]": "cell error: |estimate − truth| / truth of the cells, median / 95th percentile",
    "± own": "± own / all: standard deviations, medians over the cells: of each cell's own error / of what all cells "
    "share",
    "first": "first, later: the first frame, solved jointly with the baseline as the paper does, and the frames "
    "after it",
    "published": "published: of another recording, on another computer, as the run's file quotes it; figures of this "
    "recording are not expected to equal it",
}


@dataclass(frozen=True)
class Table:
    """Headers with units and rows of text, ready to be drawn.

    title : the line above it. best : (row, column) of the cells that a page sets off.
    """

    headers: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    title: str = ""
    best: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (n − 1; None for one value), median and 95th percentile of some values."""

    mean: float
    sd: float | None
    median: float
    percentile_95: float

    @property
    def median_and_worst(self) -> str:
        """'5.10 / 16.7'."""
        return f"{digits(self.median)} / {digits(self.percentile_95)}"


@dataclass(frozen=True, eq=False)
class Row:
    """One case over some of its steps; a failed frame counts in `frames` and nowhere else.

    source, label : results file, and the estimator's name as tables show it. steps : 'all'; or 'initial' and
    'following' where the first frame was solved together with the baseline. solve_time : s. data_error :
    |model − measured|/measured over readings that are values, percent. cell_error : |cell resistance − truth|/truth,
    percent; None without a truth. open_cells : that cannot be told from open ones, over all frames.
    missing_readings, bound_readings : of all frames, solved or not: missing; at a rail, zero or below.
    published : what a publication says of the same steps.
    """

    source: str
    label: str
    case: CaseResult
    steps: Steps
    frames: int
    solved: int
    solve_time: Spread | None
    data_error: Spread | None
    cell_error: Spread | None
    open_cells: int
    worst_kkt_residual: float | None
    missing_readings: int
    bound_readings: int
    published: StepFigures

    @property
    def recording(self) -> str:
        """The recording's stem."""
        return self.case.recording

    @property
    def estimator(self) -> str:
        """The estimator's name."""
        return self.case.estimator


def spread(values: Array) -> Spread | None:
    """Mean, standard deviation, median and 95th percentile of the finite values, any shape; None if there is none."""
    values = values[np.isfinite(values)]
    if values.size == 0:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        sd = float(np.std(values, ddof=1)) if values.size > 1 else None
        return Spread(float(np.mean(values)), sd, float(np.median(values)), float(np.percentile(values, 95)))


def relative_error(values: Array, reference: Array) -> Array:
    """100·|values − reference|/reference, any shape, in percent."""
    with np.errstate(over="ignore", invalid="ignore"):
        return 100 * np.abs(values - reference) / reference


def data_error(case: CaseResult) -> Array:
    """100·|model − measured|/measured, (frames, rows, columns) percent; NaN where a reading is no value."""
    return np.where(case.valued, relative_error(case.reading_model, case.measured), np.nan)


def compare_files(paths: Sequence[str | Path], frames: range | None = None) -> list[Row]:
    """The rows of several results files, file by file; frames : as `read_results` takes them.

    Raises InputError where one cannot be read.
    """
    return [row for path in paths for row in compare(read_results(path, frames=frames), str(path))]


def compare(results: Results, source: str = "") -> list[Row]:
    """The rows of one results file: one for each case, two where its first frame was solved with the baseline."""
    rows = []
    for case in results.cases:
        label, published = results.label(case).replace("lambda", "λ"), results.published.get(case.estimator)
        first = np.arange(len(case.time)) == 0
        parts: dict[Steps, NDArray[np.bool_]] = {"initial": first, "following": ~first}
        if not case.joint_start:
            parts = {"all": first | ~first}
        rows += [
            _row(source, label, case, steps, chosen, _figures(published, steps))
            for steps, chosen in parts.items()
            if np.any(chosen) or steps == "all"
        ]
    return rows


def _row(
    source: str, label: str, case: CaseResult, steps: Steps, chosen: NDArray[np.bool_], published: StepFigures
) -> Row:
    good = chosen & case.solved
    residual = case.kkt_residual[good]
    return Row(
        source,
        label,
        case,
        steps,
        frames=int(np.sum(chosen)),
        solved=int(np.sum(good)),
        solve_time=spread(case.solve_time[good]),
        data_error=spread(data_error(case)[good]),
        cell_error=None if case.truth is None else spread(relative_error(case.cell_resistance[good], case.truth[good])),
        open_cells=int(np.sum(case.open_cell[good] != 0)),
        worst_kkt_residual=float(np.nanmax(residual)) if np.isfinite(residual).any() else None,
        missing_readings=0 if case.missing_readings is None else int(case.missing_readings[chosen].sum()),
        bound_readings=0 if case.bound_readings is None else int(case.bound_readings[chosen].sum()),
        published=published,
    )


def _figures(published: PublishedFigures | None, steps: Steps) -> StepFigures:
    """The figures of these steps; those of all and of following steps replace each other where one is missing."""
    known = published or PublishedFigures()
    later = (known.all, known.following) if steps == "all" else (known.following, known.all)
    return next(filter(None, (known.initial,) if steps == "initial" else later), StepFigures())


def model_notes(rows: Sequence[Row]) -> list[str]:
    """What speaks against each recording and its estimates, a line each; each once."""
    notes = (f"warning: {row.recording}: {line}" for row in rows for line in row.case.warnings.split("\n") if line)
    return list(dict.fromkeys(notes))


def csv_text(rows: Sequence[Row]) -> str:
    """All figures of the rows as CSV with units in the headers, full precision, empty where there is none."""
    headers: list[object] = [header for header, _ in CSV_COLUMNS]
    return comma_separated([headers, *([figure(row) for _, figure in CSV_COLUMNS] for row in rows)])


def comma_separated(rows: Iterable[Iterable[object]]) -> str:
    """Rows of values as CSV, nothing for None."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def write_csv(path: str | Path, rows: Sequence[Row]) -> None:
    """Write the rows as CSV, whole or not at all. Raises InputError where the place cannot be written."""
    write_whole(Path(path), csv_text(rows))


def screen_blocks(rows: Sequence[Row], each: bool = False, published: bool = False) -> list[Table]:
    """A table for each recording; of more than six recordings one that sums them up, unless `each` is asked for.

    published : with the figures that a run's file quotes.
    """
    groups = _grouped(rows, lambda row: (row.source, row.recording))
    if len(groups) > 6 and not each:
        more = "--each shows every one, --csv FILE and --report PAGE hold all"
        title = f"{len(groups)} recordings, medians over them ({more})"
        return [_table(title, _grouped(rows, lambda row: (row.estimator, row.steps)), OVER_ALL)]
    several = len({row.source for row in rows}) > 1
    columns = COLUMNS + PUBLISHED * published
    return [_table(_title(group, several), group, columns) for group in groups]


def _grouped(rows: Sequence[Row], key: Callable[[Row], tuple[str, str]]) -> list[list[Row]]:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return list(groups.values())


def legend(rows: Sequence[Row], blocks: Sequence[Table]) -> list[str]:
    """What the headers of the blocks mean, a sentence each."""
    headers = [header for block in blocks for header in block.headers]
    headers += ["first"] * any(row.steps != "all" for row in rows)
    return [note for start, note in NOTES.items() if any(header.startswith(start) for header in headers)]


def _title(group: Sequence[Row], several: bool) -> str:
    """'lamprey_35mm: 21 frames, 12 readings missing'."""
    own = [row for row in group if row.estimator == group[0].estimator]
    missing, bounds = (sum(getattr(row, name) for row in own) for name in ("missing_readings", "bound_readings"))
    parts = [counted(sum(row.frames for row in own), "frame")]
    parts += [f"{counted(missing, 'reading')} missing"] if missing else []
    parts += [f"{counted(bounds, 'reading')} at a bound"] if bounds else []
    return f"{own[0].source + ': ' if several else ''}{own[0].recording}: {', '.join(parts)}"


def _table(title: str, things: Sequence[T], columns: Sequence[tuple[str, Callable[[T], str]]]) -> Table:
    """A row for each of the things; a column in which none has anything is left out."""
    texts = {header: [text(thing) for thing in things] for header, text in columns}
    filled = {header: column for header, column in texts.items() if any(column)}
    return Table(tuple(filled), tuple(zip(*filled.values(), strict=True)), title)


def _plus_minus(values: Spread | None, factor: float = 1.0) -> str:
    if values is None:
        return ""
    mean = factor * values.mean
    if 0 < mean < LEAST:
        return f"< {LEAST:g}"
    return digits(mean, 2) + ("" if values.sd is None else f" ± {digits(factor * values.sd, 2, like=mean)}")


def _published(mean: float | None, sd: float | None) -> str:
    return "" if mean is None else f"{mean:g}" + ("" if sd is None else f" ± {sd:g}")


def _solved(group: Sequence[Row]) -> str:
    return f"{sum(row.solved for row in group)}/{sum(row.frames for row in group)}{STEPS[group[0].steps]}"


def _median(spreads: Sequence[Spread | None], name: str, factor: float = 1.0) -> str:
    values = [factor * getattr(one, name) for one in spreads if one]
    return digits(float(np.median(values))) if values else ""


def _range(spreads: Sequence[Spread | None]) -> str:
    values = [one.median for one in spreads if one]
    return f"{digits(min(values))} … {digits(max(values))}" if values else ""


def _median_of(part: Array | None) -> float | None:
    """Median of the finite ones, percent; None without any."""
    known = np.zeros(0) if part is None else part[np.isfinite(part)]
    return 100 * float(np.median(known)) if len(known) else None


def _parts(case: CaseResult) -> str:
    """'0.8 / 3.1'; nothing without error bars."""
    parts = [_median_of(part) for part in (case.sigma_own, case.sigma_common)]
    return " / ".join(digits(part) for part in parts if part is not None)


COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("estimator", lambda row: row.label),
    ("solved", lambda row: _solved([row])),
    ("time [ms]", lambda row: _plus_minus(row.solve_time, 1000)),
    ("data error [%]", lambda row: _plus_minus(row.data_error)),
    ("cell error [%]", lambda row: row.cell_error.median_and_worst if row.cell_error else ""),
    ("± own / all [%]", lambda row: _parts(row.case)),
)
PUBLISHED: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("published time [s]", lambda row: _published(row.published.time_s, row.published.time_sd_s)),
    ("published error [%]", lambda row: _published(row.published.error_percent, row.published.error_sd_percent)),
)
OVER_ALL: tuple[tuple[str, Callable[[Sequence[Row]], str]], ...] = (
    ("estimator", lambda group: group[0].label),
    ("solved", _solved),
    ("time [ms]", lambda group: _median([row.solve_time for row in group], "mean", 1000)),
    ("data error [%], mean", lambda group: _median([row.data_error for row in group], "mean")),
    ("cell error [%], median", lambda group: _median([row.cell_error for row in group], "median")),
    ("least … most of them", lambda group: _range([row.cell_error for row in group])),
)
CSV_COLUMNS: tuple[tuple[str, Callable[[Row], object]], ...] = (
    ("results", lambda row: row.source),
    ("recording", lambda row: row.recording),
    ("estimator", lambda row: row.estimator),
    ("steps", lambda row: row.steps),
    ("frames", lambda row: row.frames),
    ("frames solved", lambda row: row.solved),
    ("solve time mean [s]", lambda row: row.solve_time and row.solve_time.mean),
    ("solve time sd [s]", lambda row: row.solve_time and row.solve_time.sd),
    ("data error mean [%]", lambda row: row.data_error and row.data_error.mean),
    ("data error sd [%]", lambda row: row.data_error and row.data_error.sd),
    ("cell error median [%]", lambda row: row.cell_error and row.cell_error.median),
    ("cell error mean [%]", lambda row: row.cell_error and row.cell_error.mean),
    ("cell error 95th percentile [%]", lambda row: row.cell_error and row.cell_error.percentile_95),
    ("own standard deviation median [%]", lambda row: _median_of(row.case.sigma_own)),
    ("common standard deviation median [%]", lambda row: _median_of(row.case.sigma_common)),
    ("open cells", lambda row: row.open_cells),
    ("worst KKT residual", lambda row: row.worst_kkt_residual),
    ("published time [s]", lambda row: row.published.time_s),
    ("published time sd [s]", lambda row: row.published.time_sd_s),
    ("published data error [%]", lambda row: row.published.error_percent),
    ("published data error sd [%]", lambda row: row.published.error_sd_percent),
    ("missing readings", lambda row: row.missing_readings),
    ("bound readings", lambda row: row.bound_readings),
    ("model", lambda row: row.case.model_mark),
    ("model check", lambda row: row.case.model_sentence),
    ("noise check", lambda row: row.case.noise_sentence),
)
