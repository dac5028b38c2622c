"""Tables over recordings and estimators: time, data error, cell error, and what a publication gives beside them."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lampest.files.whole import write_whole
from lampest.panel.panel import Array
from lampest.runs.results import CaseResult, PublishedFigures, Results, StepFigures, read_results

Steps = Literal["all", "initial", "following"]
Chosen = NDArray[np.bool_]
SOUND = ("", "yes")  # marks of a circuit that nothing speaks against, or of which an older file says nothing


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
    source, recording, estimator : results file, recording's stem, estimator's name.
    steps : 'all'; or 'initial' and 'following' where the first frame was solved together with the baseline.
    frames, solved : number of frames, and how many of them were solved.
    solve_time : of the solved frames, in s.
    data_error : |model − measured|/measured over all readings that are values, of the solved frames, in percent.
    cell_error : |cell resistance − truth|/truth over all cells and solved frames, in percent; None without a truth.
    open_cells : cells that cannot be told from open ones, summed over the solved frames.
    worst_kkt_residual : the largest violation of the optimality conditions.
    missing_readings, bound_readings : of all frames, solved or not: say nothing; are at a rail, zero or below.
    published : what a publication says of the same steps.
    model_mark, model_sentence : whether the scene's circuit explains the recording, as `CaseResult` has them.
    noise_sentence : what speaks against the noise that the scene tells, likewise.
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
    return [row for case in results.cases for row in _rows(case, results.published.get(case.estimator), source)]


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
    """The figures of these steps; where all and following steps are not told apart, one stands for the other."""
    if published is None:
        return None
    if steps == "initial":
        return published.initial
    return (published.all or published.following) if steps == "all" else (published.following or published.all)


@dataclass(frozen=True)
class Table:
    """Headers with units and rows of text, ready to be drawn."""

    headers: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]


def model_notes(rows: Sequence[Row]) -> list[str]:
    """Sentences for every recording of which the circuit, or its noise, is in doubt; each once."""
    notes = (f"{row.recording}: {row.model_sentence}" for row in rows if row.model_mark not in SOUND)
    noise = (f"{row.recording}: {row.noise_sentence}" for row in rows if row.noise_sentence)
    return list(dict.fromkeys((*notes, *noise)))


def csv_text(rows: Sequence[Row]) -> str:
    """All figures of the rows as CSV with units in the headers, full precision, empty where there is none."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ["results", "recording", "estimator", "steps", "frames", "frames solved"]
        + ["solve time mean [s]", "solve time sd [s]", "data error mean [%]", "data error sd [%]"]
        + ["cell error median [%]", "cell error mean [%]", "cell error 95th percentile [%]"]
        + ["open cells", "worst KKT residual"]
        + [f"published {name}" for name in ("time [s]", "time sd [s]", "data error [%]", "data error sd [%]")]
        + ["missing readings", "bound readings", "model", "model check", "noise check"]
    )
    for row in rows:
        time, data, cell, figures = row.solve_time, row.data_error, row.cell_error, row.published
        writer.writerow(
            [row.source, row.recording, row.estimator, row.steps, row.frames, row.solved]
            + ([time.mean, time.sd] if time else [None, None])
            + ([data.mean, data.sd] if data else [None, None])
            + ([cell.median, cell.mean, cell.percentile_95] if cell else [None, None, None])
            + [row.open_cells, row.worst_kkt_residual]
            + (
                [figures.time_s, figures.time_sd_s, figures.error_percent, figures.error_sd_percent]
                if figures
                else [None] * 4
            )
            + [row.missing_readings, row.bound_readings, row.model_mark, row.model_sentence]
            + [row.noise_sentence]
        )
    return stream.getvalue()


def write_csv(path: str | Path, rows: Sequence[Row]) -> None:
    """Write the rows as CSV, whole or not at all. Raises InputError where the place cannot be written."""
    write_whole(Path(path), csv_text(rows))
