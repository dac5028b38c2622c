"""Comparison tables of recordings and estimators.

Tables compare solve times, data errors, cell errors, and published figures.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

import numpy as np

from lampest.files.errors import counted
from lampest.files.levels import Witness
from lampest.files.whole import write_whole
from lampest.panel.panel import Array, Mask
from lampest.report.words import digits, no_formula, text_of
from lampest.runs.case import data_frame
from lampest.runs.results import (
    CaseResult,
    PublishedFigures,
    Reader,
    Results,
    StepFigures,
    read_results,
)

if TYPE_CHECKING:
    from lampest.runs.case import DataFrame

Steps = Literal["all", "initial", "following"]
# Header → template over the values of an item, or its text.
Columns = Mapping[str, str | Callable[[Any], str]]
# Header of the CSV file → figure of a case over some of its steps, None where there is none.
Row = Mapping[str, Any]
Rows = Sequence[Row]
FIELD = re.compile("{([^:}]+):?([^}]*)}")  # name and format of a value in a template
ASIDE = ("label", "warnings", "chosen weights")  # entries of a row that are not in the table
MIN_DIFFERENCE = 1e-3  # percent or ms: less is rounding
MAX_SHOWN = 6  # recordings, estimators of them, and contacts that are shown in full
STEPS = {"all": "", "initial": " first", "following": " later"}
NOTES = {  # explanations of headers that begin with the key
    "verified by IPOPT": "verified by IPOPT: "
    "frames solved again on the nodal program from another start "
    "(the strongest of a recording by default, `verify`): "
    "largest difference of ln r between both estimates",
    "solved": "solved: frames at a verified local optimum, the best of all starts; "
    "approximate formulations: all frames with an estimate",
    "data error [%]": "data error: "
    "|model − measured| / measured, mean ± standard deviation over all readings",
    "cell error [%]": "cell error: "
    "|estimate − truth| / truth of the cells, median / 95th percentile",
    "own / common": "own / common sd: "
    "median standard deviations of each cell's own error / of the error common to all",
    "pressure sd": "pressure sd: the same of the pressures of pressed cells, own / common",
    "first": "first, later: "
    "the first frame, estimated jointly with the baseline as in the paper; the frames after it",
    "published": "published: of another recording and computer, as the run's file quotes it",
}


@dataclass(frozen=True)
class Table:
    """Table of texts.

    Attributes
    ----------
    headers : tuple of str
        Column headers with units.
    cells : tuple of tuple of str
        Rows.
    title : str
        Line above the table.
    best : frozenset of (row, column)
        Cells that a page highlights.
    """

    headers: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    title: str = ""
    best: frozenset[tuple[int, int]] = frozenset()


def screen_table(items: Iterable[Any], columns: Columns, title: str = "") -> Table:
    """Return a table with a row for each item, without empty columns."""
    items = list(items)

    def text(of: str | Callable[[Any], str], item: Any) -> str:
        if callable(of):
            return of(item)
        values = item if isinstance(item, Mapping) else vars(item)
        return FIELD.sub(lambda part: text_of(values[part[1]], part[2]), of).strip(" ±/")

    texts = {header: [text(of, item) for item in items] for header, of in columns.items()}
    filled = {header: column for header, column in texts.items() if any(column)}
    return Table(tuple(filled), tuple(zip(*filled.values(), strict=True)), title)


STATISTICS: dict[str, Callable[[Array], float | None]] = {
    "mean": lambda values: float(np.mean(values)),
    "sd": lambda values: float(np.std(values, ddof=1)) if values.size > 1 else None,
    "median": lambda values: float(np.median(values)),
    "95th percentile": lambda values: float(np.percentile(values, 95)),
    "smallest": lambda values: float(np.min(values)),
    "largest": lambda values: float(np.max(values)),
}


def statistics(values: Array | None, header: str, *names: str) -> dict[str, float | None]:
    """Map headers such as 'time {} [s]' to statistics of the finite values.

    A statistic without values is None.
    """
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    with np.errstate(over="ignore", invalid="ignore"):
        return {
            header.format(name): STATISTICS[name](known) if known.size else None for name in names
        }


def relative_error(values: Array, reference: Array) -> Array:
    """Return 100·|values − reference|/reference, any shape, in percent."""
    with np.errstate(over="ignore", invalid="ignore"):
        return 100 * np.abs(values - reference) / reference


def data_error(case: CaseResult) -> Array:
    """Return 100·|model − measured|/measured, (frames, rows, columns) percent.

    The error of a reading that is no value is NaN.
    """
    return np.where(case.valued, relative_error(case.reading_model, case.measured), np.nan)


def weighted_residual(case: CaseResult) -> Array:
    """Return (model − measured)/σ, (frames, rows, columns).

    The residual of a reading that is no value or has no σ is NaN.
    """
    sigma = np.nan if case.sigma is None else case.sigma
    return np.where(case.valued, (case.reading_model - case.measured) / sigma, np.nan)


def compare_files(paths: Sequence[str | Path], read: Reader = read_results) -> list[Row]:
    """Return the rows of several results files, each read by a function of its path.

    Raises InputError for an unreadable file.
    """
    return [row for path in paths for row in compare(read(path), str(path))]


def compare(results: Results, source: str = "") -> list[Row]:
    """Return the rows of one results file.

    A case has one row, with `steps` equal to 'all'. A case whose first frame was solved jointly
    with the baseline has two, 'initial' and 'following'. Failed frames count in `frames` only.
    """
    rows: list[Row] = []
    for case in results.cases:
        published = results.published.get(case.estimator, PublishedFigures())
        later = np.arange(len(case.time)) > 0
        # Figures of all steps and those of the following steps substitute each other.
        parts: dict[Steps, tuple[Mask, StepFigures | None]] = {
            "initial": (~later, published.initial),
            "following": (later, published.following or published.all),
        }
        if not case.joint_start:
            parts = {"all": (later | True, published.all or published.following)}
        texts = {
            "model": case.model_mark,
            "model check": case.model_sentence,
            "noise check": case.noise_sentence,
            "label": case.unswept_name
            if case.swept
            else results.label(case).replace("lambda", "λ"),
            "warnings": case.warnings,
            "chosen weights": case.chosen_weights,
        }
        for steps, (chosen, figures) in parts.items():
            if np.any(chosen) or steps == "all":
                quoted = figures or StepFigures()
                named = {
                    "results": source,
                    "recording": case.recording,
                    "estimator": case.estimator,
                    "steps": steps,
                    "swept": case.swept,
                }
                of_publication = {
                    "published time [s]": quoted.time_s,
                    "published time sd [s]": quoted.time_sd_s,
                    "published data error [%]": quoted.error_percent,
                    "published data error sd [%]": quoted.error_sd_percent,
                }
                rows.append(named | figures_of(case, chosen) | of_publication | texts)
    return rows


def figures_of(case: CaseResult, chosen: Mask) -> dict[str, Any]:
    """Map headers to figures of the solved frames among the chosen ones.

    Headers are also mapped to counts of their missing readings.
    """
    good = chosen & case.solved
    errors = (
        None if case.truth is None else relative_error(case.cell_resistance[good], case.truth[good])
    )
    individual, common = (
        None if part is None else 100 * part[good] for part in (case.sigma_own, case.sigma_common)
    )
    own_kpa, common_kpa = case.pressed_errors(good) or (None, None)
    solvers = Counter(filter(None, compress(case.solver or (), good)))
    return {
        "frames": int(np.sum(chosen)),
        "frames solved": int(np.sum(good)),
        # The solver of the solved frames, or each of several with its share of them.
        "solver": ", ".join(
            name if len(solvers) == 1 else f"{name} ({100 * count / solvers.total():.0f} %)"
            for name, count in solvers.items()
        ),
        **statistics(case.iterations[good].astype(float), "iterations {}", "median"),
        "verified by IPOPT": _verified_text(case, chosen),
        **statistics(case.solve_time[good], "solve time {} [s]", "mean", "sd"),
        **statistics(data_error(case)[good], "data error {} [%]", "mean", "sd"),
        **statistics(errors, "cell error {} [%]", "median", "mean", "95th percentile"),
        **statistics(individual, "own standard deviation {} [%]", "median"),
        **statistics(common, "common standard deviation {} [%]", "median"),
        **statistics(own_kpa, "own standard deviation of pressed cells {} [kPa]", "median"),
        **statistics(common_kpa, "common standard deviation of pressed cells {} [kPa]", "median"),
        "open cells": int(np.sum(case.open_cell[good] != 0)),
        **statistics(case.kkt_residual[good], "worst KKT residual", "largest"),
        **{
            f"{kind} readings": 0 if count is None else int(count[chosen].sum())
            for kind, count in (("missing", case.missing_readings), ("bound", case.bound_readings))
        },
    }


def _verified_text(case: CaseResult, chosen: Mask) -> str:
    """Return the outcome of the second solves by IPOPT in words.

    '' where no frame was solved again. An agreeing frame has the largest difference of ln r.
    """
    if case.verified is None or case.verified_difference is None or case.verified_decrease is None:
        return ""
    same, lower, higher, failed = (
        chosen & (case.verified == end)
        for end in (Witness.SAME, Witness.LOWER, Witness.HIGHER, Witness.FAILED)
    )
    texts = [f"{case.verified_difference[same].max():.1g}"] if same.any() else []
    if lower.any():
        decrease = 100 * case.verified_decrease[lower].max()
        cost = f"IPOPT found a cost {decrease:.2g} % lower: kept"
        texts.append(cost if decrease else "IPOPT alone solved it: kept")
    texts += ["IPOPT ended higher"] if higher.any() else []
    texts += ["IPOPT reached no optimum"] if failed.any() else []
    return ", ".join(texts)


def model_notes(rows: Rows) -> list[str]:
    """Return lines on the weights that the data chose, and the warnings of each recording.

    Equal lines are returned once.
    """
    notes = [
        f"{row['recording']}, {row['estimator']}: {row['chosen weights']}"
        for row in rows
        if row["chosen weights"]
    ]
    notes += [
        f"warning: {row['recording']}: {line}"
        for row in rows
        for line in row["warnings"].split("\n")
        if line
    ]
    return list(dict.fromkeys(notes))


def comma_separated(rows: Iterable[Iterable[object]]) -> str:
    """Return rows of values as CSV; see `write_rows`."""
    stream = io.StringIO()
    write_rows(stream, rows)
    return stream.getvalue()


def write_rows(stream: TextIO, rows: Iterable[Iterable[object]]) -> None:
    """Write rows of values as CSV, empty for None; see `no_formula`."""
    csv.writer(stream, lineterminator="\n").writerows(map(no_formula, row) for row in rows)


def write_csv(path: str | Path, rows: Rows) -> None:
    """Write all figures of the rows as CSV with units in the headers.

    Figures have full precision; missing figures are empty.

    Raises InputError where the place cannot be written.
    """
    lines = table_lines(rows)
    write_whole(Path(path), comma_separated([*lines[:1], *(line.values() for line in lines)]))


def table_lines(rows: Rows) -> list[dict[str, Any]]:
    """Return the rows as one table, header → figure, with a column for each swept key."""
    keys = swept_keys(rows)
    lines = []
    for row in rows:
        line: dict[str, Any] = {}
        for header in row:
            if header == "swept":
                line |= {key: row["swept"].get(key) for key in keys}
            elif header not in ASIDE:
                line[header] = row[header]
        lines.append(line)
    return lines


def swept_keys(rows: Iterable[Row]) -> tuple[str, ...]:
    """Return the keys that sweeps varied, each once."""
    return tuple(dict.fromkeys(key for row in rows for key in row["swept"]))


def comparison(*paths: str | Path) -> "DataFrame":
    """Return the table of `lampest compare` as a pandas.DataFrame.

    Each swept key has a column of its own.

    Raises InputError where a results file cannot be read, or pandas is not installed.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.save("results.h5", "LSM")
    >>> table = lampest.comparison("results.h5")
    >>> table[["recording", "estimator", "frames solved"]].values.tolist()
    [['mine', 'LSM', 2]]
    """
    return data_frame(table_lines(compare_files(paths)))


def screen_blocks(rows: Rows, *, published: bool = False) -> list[Table]:
    """Return a table for each recording, or one with medians over more than six recordings.

    `published` states whether the figures quoted in the run file are included.
    """
    groups = grouped(rows, itemgetter("results", "recording")).values()
    many = len(groups) > MAX_SHOWN
    first, *others = (OVER_ALL if many else {**COLUMNS, **(PUBLISHED if published else {})}).items()
    # Columns of swept keys follow the estimator's.
    swept = ((key.replace(".", " "), partial(_swept_text, key)) for key in swept_keys(rows))
    columns = dict([first, *swept, *others])
    if many:
        title = (
            f"{len(groups)} recordings, medians over them (--csv FILE and --report PAGE hold all)"
        )
        return [
            screen_table(grouped(rows, itemgetter("estimator", "steps")).values(), columns, title)
        ]
    several = len({row["results"] for row in rows}) > 1
    return [screen_table(group, columns, _title(group, several=several)) for group in groups]


def _swept_text(key: str, rows: Row | Rows) -> str:
    """Return the value that a sweep gave a key in a row or in a group of rows, as text.

    Returns '' for a key that was not swept.
    """
    row = rows if isinstance(rows, Mapping) else rows[0]
    value = row["swept"].get(key, "")
    return f"{value:g}" if isinstance(value, float) else str(value)


def grouped(items: Iterable[Any], key: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Group items by a key, in order of first appearance."""
    groups: dict[Any, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def legend(rows: Rows, blocks: Sequence[Table]) -> list[str]:
    """Return a sentence for each header of the tables that needs an explanation."""
    headers = [header for block in blocks for header in block.headers]
    headers += ["first"] * any(row["steps"] != "all" for row in rows)
    return [
        note for start, note in NOTES.items() if any(header.startswith(start) for header in headers)
    ]


def _title(group: Rows, *, several: bool) -> str:
    """Return a title such as 'lamprey_35mm: 21 frames, 12 readings missing'."""
    first = group[0]
    first_rows = [row for row in group if row["estimator"] == first["estimator"]]
    frames, missing, bounds = (
        sum(row[name] for row in first_rows)
        for name in ("frames", "missing readings", "bound readings")
    )
    parts = [counted(frames, "frame")]
    parts += [f"{counted(missing, 'reading')} missing"] if missing else []
    parts += [f"{counted(bounds, 'reading')} at a bound"] if bounds else []
    return f"{first['results'] + ': ' if several else ''}{first['recording']}: {', '.join(parts)}"


def _data_error_text(row: Row) -> str:
    """Return mean and standard deviation of the data error such as '2.3 ± 1.4'; '' without any."""
    mean = row["data error mean [%]"]
    sd = row["data error sd [%]"]
    if mean is None:
        return ""
    if 0 < mean < MIN_DIFFERENCE:
        return f"< {MIN_DIFFERENCE:g}"
    return digits(mean, 2) + ("" if sd is None else f" ± {digits(sd, 2, like=mean)}")


def _solved(group: Rows) -> str:
    solved, frames = (sum(row[header] for row in group) for header in ("frames solved", "frames"))
    return f"{solved}/{frames}{STEPS[group[0]['steps']]}"


def _over(group: Rows, header: str, *functions: Callable[[Any], float], factor: float = 1.0) -> str:
    """Return statistics of a group's figures, such as '2.1 … 3.5'.

    '' if there are no figures.
    """
    known = [factor * row[header] for row in group if row[header] is not None]
    return " … ".join(digits(float(function(known))) for function in functions if known)


COLUMNS: Columns = {
    "estimator": "{label}",
    "solved": lambda row: _solved([row]),
    "solver, iterations": "{solver}, {iterations median:.0f}",
    "time [ms]": lambda row: _over([row], "solve time mean [s]", np.mean, factor=1000),
    "verified by IPOPT": "{verified by IPOPT}",
    "data error [%]": _data_error_text,
    "cell error [%]": "{cell error median [%]:digits} / {cell error 95th percentile [%]:digits}",
    "own / common sd [%]": "{own standard deviation median [%]:digits} / "
    "{common standard deviation median [%]:digits}",
    "pressure sd [kPa]": "{own standard deviation of pressed cells median [kPa]:digits} / "
    "{common standard deviation of pressed cells median [kPa]:digits}",
}
PUBLISHED: Columns = {
    "published time [s]": "{published time [s]:g} ± {published time sd [s]:g}",
    "published error [%]": "{published data error [%]:g} ± {published data error sd [%]:g}",
}
OVER_ALL: Columns = {
    "estimator": lambda group: group[0]["label"],
    "solved": _solved,
    "time [ms]": lambda group: _over(group, "solve time mean [s]", np.median, factor=1000),
    "data error [%], mean": lambda group: _over(group, "data error mean [%]", np.median),
    "cell error [%], median": lambda group: _over(group, "cell error median [%]", np.median),
    "smallest … largest": lambda group: _over(group, "cell error median [%]", min, max),
}
