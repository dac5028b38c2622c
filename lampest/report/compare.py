"""Tables over recordings and estimators: time, data error, cell error, and what a publication gives beside them."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.whole import write_whole
from lampest.panel.panel import Array
from lampest.report.strongest import counted
from lampest.runs.results import CaseResult, PublishedFigures, Results, StepFigures, read_results

Steps = Literal["all", "initial", "following"]
Chosen = NDArray[np.bool_]
T = TypeVar("T")
SOUND = ("", "yes")  # marks of a circuit that explains the readings, or that an older file leaves open
LEAST = 1e-3  # percent or ms: less is rounding
MOST_BLOCKS = 6  # recordings that are shown one by one; more are summed up
STEPS = {"all": "", "initial": " first", "following": " later"}
SOLVED_NOTE = (
    "solved: frames that converged to a local minimum, verified outside the solver; of several starts the lowest one "
    "(lampest info has their number). Approximate formulations count as solved when they end"
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


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (n − 1; None for one value), median and 95th percentile of some values."""

    mean: float
    sd: float | None
    median: float
    percentile_95: float


@dataclass(frozen=True)
class Row:
    """One case over some of its steps; a failed frame counts in `frames` and nowhere else.

    Parameters
    ----------
    source, recording, estimator : results file, recording's stem, estimator's name. label : as tables show the name.
    steps : 'all'; or 'initial' and 'following' where the first frame was solved together with the baseline.
    frames, solved : number of frames, and how many of them were solved.
    solve_time : of the solved frames, in s.
    data_error : |model − measured|/measured over all readings that are values, of the solved frames, in percent.
    cell_error : |cell resistance − truth|/truth over all cells and solved frames, in percent; None without a truth.
    open_cells : cells that cannot be told from open ones, summed over the solved frames.
    worst_kkt_residual : the largest violation of the optimality conditions.
    missing_readings, bound_readings : of all frames, solved or not: missing; at a rail, zero or below.
    published : what a publication says of the same steps.
    model_mark, model_sentence : whether the scene's circuit explains the recording, as `CaseResult` has them.
    noise_sentence : what contradicts the noise that the scene specifies, likewise.
    """

    source: str
    recording: str
    estimator: str
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
    published: StepFigures | None
    model_mark: str = ""
    model_sentence: str = ""
    noise_sentence: str = ""
    label: str = ""


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
    return [
        replace(row, label=results.label(case).replace("lambda", "λ"))
        for case in results.cases
        for row in _rows(case, results.published.get(case.estimator), source)
    ]


def _rows(case: CaseResult, published: PublishedFigures | None, source: str) -> list[Row]:
    first: Chosen = np.arange(len(case.time)) == 0
    if not case.joint_start:
        return [_row(case, "all", first | ~first, published, source)]
    parts: list[tuple[Steps, Chosen]] = [("initial", first), ("following", ~first)]
    return [_row(case, steps, chosen, published, source) for steps, chosen in parts if np.any(chosen)]


def _row(case: CaseResult, steps: Steps, chosen: Chosen, published: PublishedFigures | None, source: str) -> Row:
    good = chosen & case.solved
    residual = spread(case.kkt_residual[good])
    return Row(
        source,
        case.recording,
        case.estimator,
        steps,
        frames=int(np.sum(chosen)),
        solved=int(np.sum(good)),
        solve_time=spread(case.solve_time[good]),
        data_error=spread(data_error(case)[good]),
        cell_error=None if case.truth is None else spread(relative_error(case.cell_resistance[good], case.truth[good])),
        open_cells=int(np.sum(case.open_cell[good] != 0)),
        worst_kkt_residual=None if residual is None else float(np.nanmax(case.kkt_residual[good])),
        missing_readings=_total(case.missing_readings, chosen),
        bound_readings=_total(case.bound_readings, chosen),
        published=_figures(published, steps),
        model_mark=case.model_mark,
        model_sentence=case.model_sentence,
        noise_sentence=case.noise_sentence,
    )


def _total(counts: NDArray[np.int64] | None, chosen: Chosen) -> int:
    return 0 if counts is None else int(counts[chosen].sum())


def _figures(published: PublishedFigures | None, steps: Steps) -> StepFigures | None:
    """The figures of these steps; those of all and of following steps replace each other where one is missing."""
    if published is None:
        return None
    if steps == "initial":
        return published.initial
    return (published.all or published.following) if steps == "all" else (published.following or published.all)


@dataclass(frozen=True)
class Table:
    """Headers with units and rows of text, ready to be drawn; title : the line above it."""

    headers: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    title: str = ""


def model_notes(rows: Sequence[Row]) -> list[str]:
    """Sentences for every recording of which the circuit, or its noise, is in doubt; each once."""
    notes = (f"{row.recording}: {row.model_sentence}" for row in rows if row.model_mark not in SOUND)
    noise = (f"{row.recording}: {row.noise_sentence}" for row in rows if row.noise_sentence)
    return list(dict.fromkeys((*notes, *noise)))


def csv_text(rows: Sequence[Row]) -> str:
    """All figures of the rows as CSV with units in the headers, full precision, empty where there is none."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([header for header, _ in CSV_COLUMNS])
    writer.writerows([figure(row) for _, figure in CSV_COLUMNS] for row in rows)
    return stream.getvalue()


def write_csv(path: str | Path, rows: Sequence[Row]) -> None:
    """Write the rows as CSV, whole or not at all. Raises InputError where the place cannot be written."""
    write_whole(Path(path), csv_text(rows))


def screen_blocks(rows: Sequence[Row], each: bool = False, published: bool = False) -> list[Table]:
    """A table for each recording; of more than six recordings one that sums them up, unless `each` is asked for.

    published : with the figures that a run's file quotes.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.source, row.recording), []).append(row)
    if len(groups) > MOST_BLOCKS and not each:
        return [_summary(rows, len(groups))]
    several = len({source for source, _ in groups}) > 1
    columns = COLUMNS + PUBLISHED * published
    return [_table(_title(group, several), group, columns) for group in groups.values()]


def legend(rows: Sequence[Row], blocks: Sequence[Table]) -> list[str]:
    """What the headers of the blocks mean, a sentence each."""
    headers = {header for block in blocks for header in block.headers}
    notes = [SOLVED_NOTE] if rows else []
    notes += [note for header, note in ERROR_NOTES.items() if any(each.startswith(header) for each in headers)]
    notes += [LATER_NOTE] if any(row.steps != "all" for row in rows) else []
    return notes + ([PUBLISHED_NOTE] if any("published" in header for header in headers) else [])


def _title(group: Sequence[Row], several: bool) -> str:
    """'lamprey_35mm: 21 frames, 12 readings missing'."""
    own = [row for row in group if row.estimator == group[0].estimator]
    counts = [
        (sum(row.frames for row in own), "frame", ""),
        (sum(row.missing_readings for row in own), "reading", " missing"),
        (sum(row.bound_readings for row in own), "reading", " at a bound"),
    ]
    parts = [f"{counted(count, noun)}{more}" for count, noun, more in counts if count or not more]
    words = ", ".join(parts)
    return f"{own[0].source + ': ' if several else ''}{own[0].recording}: {words}"


def _table(title: str, things: Sequence[T], columns: Sequence[tuple[str, Callable[[T], str]]]) -> Table:
    """A row for each of the things; a column in which none has anything is left out."""
    texts = {header: [text(thing) for thing in things] for header, text in columns}
    filled = {header: column for header, column in texts.items() if any(column)}
    return Table(tuple(filled), tuple(zip(*filled.values(), strict=True)), title)


def _summary(rows: Sequence[Row], recordings: int) -> Table:
    """One row for each estimator, over all recordings: medians, and the range of the cells' median error."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.estimator, row.steps), []).append(row)
    title = (
        f"{recordings} recordings, medians over them (--each shows every one, --csv FILE and --report PAGE hold all)"
    )
    return _table(title, list(groups.values()), OVER_ALL)


def _format(value: float, digits: int) -> str:
    """A format with so many significant digits of `value`, without an exponent wherever that is short."""
    if not 1e-4 <= abs(value) < 1e5:
        return f"{{:.{digits - 1}e}}" if value else "{:g}"
    return f"{{:.{max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))}f}}"


def _plus_minus(values: Spread | None, factor: float = 1.0) -> str:
    if values is None:
        return ""
    if 0 < factor * values.mean < LEAST:
        return f"< {LEAST:g}"
    form = _format(factor * values.mean, 2)
    sd = "" if values.sd is None else f" ± {form.format(factor * values.sd)}"
    return form.format(factor * values.mean) + sd


def _joined(values: Sequence[float], between: str = "") -> str:
    return between.join(_format(value, 3).format(value) for value in values)


def _median_and_worst(values: Spread | None) -> str:
    return "" if values is None else _joined((values.median, values.percentile_95), " / ")


def _published(figures: StepFigures | None, mean: str, sd: str) -> str:
    if figures is None or getattr(figures, mean) is None:
        return ""
    deviation = getattr(figures, sd)
    return f"{getattr(figures, mean):g}" + ("" if deviation is None else f" ± {deviation:g}")


def _median(values: Sequence[float], factor: float = 1.0) -> str:
    return _joined([factor * float(np.median(values))]) if values else ""


def _range(values: Sequence[float]) -> str:
    return _joined([min(values), max(values)], " … ") if values else ""


COLUMNS: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("estimator", lambda row: row.label),
    ("solved", lambda row: f"{row.solved}/{row.frames}{STEPS[row.steps]}"),
    ("time [ms]", lambda row: _plus_minus(row.solve_time, 1000)),
    ("data error [%]", lambda row: _plus_minus(row.data_error)),
    ("cell error [%]", lambda row: _median_and_worst(row.cell_error)),
)
PUBLISHED: tuple[tuple[str, Callable[[Row], str]], ...] = (
    ("published time [s]", lambda row: _published(row.published, "time_s", "time_sd_s")),
    ("published error [%]", lambda row: _published(row.published, "error_percent", "error_sd_percent")),
)
OVER_ALL: tuple[tuple[str, Callable[[Sequence[Row]], str]], ...] = (
    ("estimator", lambda group: group[0].label),
    (
        "solved",
        lambda group: f"{sum(row.solved for row in group)}/{sum(row.frames for row in group)}{STEPS[group[0].steps]}",
    ),
    ("time [ms]", lambda group: _median([row.solve_time.mean for row in group if row.solve_time], 1000)),
    ("data error [%], mean", lambda group: _median([row.data_error.mean for row in group if row.data_error])),
    ("cell error [%], median", lambda group: _median([row.cell_error.median for row in group if row.cell_error])),
    ("least … most of them", lambda group: _range([row.cell_error.median for row in group if row.cell_error])),
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
    ("open cells", lambda row: row.open_cells),
    ("worst KKT residual", lambda row: row.worst_kkt_residual),
    ("published time [s]", lambda row: row.published and row.published.time_s),
    ("published time sd [s]", lambda row: row.published and row.published.time_sd_s),
    ("published data error [%]", lambda row: row.published and row.published.error_percent),
    ("published data error sd [%]", lambda row: row.published and row.published.error_sd_percent),
    ("missing readings", lambda row: row.missing_readings),
    ("bound readings", lambda row: row.bound_readings),
    ("model", lambda row: row.model_mark),
    ("model check", lambda row: row.model_sentence),
    ("noise check", lambda row: row.noise_sentence),
)
