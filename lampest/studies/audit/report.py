"""An audit's figures: by effect and estimator as a table and CSV, every recording as HDF5."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.studies.audit.run import Audited
from lampest.studies.study import samples_file, write_rows

LEAST, MOST, NEVER_BELOW = 90.0, 98.0, 80.0  # percent of 95 % intervals that shall hold the truth
NAN = float("nan")


@dataclass(frozen=True)
class AuditRow:
    """One effect with one estimator, all seeds together.

    Parameters
    ----------
    recordings, failed : how many, and of how many there is nothing to count.
    cells, change, pressure : percent of intervals that hold the truth; cells_sd, change_sd : by how much that would
        differ among repetitions of the audit, from how much it differs among recordings.
    silent_cells, silent_change, silent_pressure : the same percentage, of recordings whose results carry no sentence;
    NaN where all do.
    chi_square : of the unloaded repeats per degree of freedom, median. width : standard deviation of log r, median.
    told : recordings whose results carry a sentence. verdict : 'held', 'told', 'wide', 'short' or 'LIES'.
    sentence : the most frequent one.
    """

    effect: str
    estimator: str
    recordings: int
    failed: int
    cells: float
    cells_sd: float
    change: float
    change_sd: float
    pressure: float
    silent_cells: float
    silent_change: float
    silent_pressure: float
    chi_square: float
    width: float
    told: int
    verdict: str
    sentence: str


def audit_rows(found: Sequence[Audited]) -> list[AuditRow]:
    """Effects in their order, the estimators of each together."""
    groups: dict[tuple[str, str], list[Audited]] = {}
    for one in found:
        groups.setdefault((one.effect, one.estimator), []).append(one)
    return [_row(effect, estimator, own) for (effect, estimator), own in groups.items()]


def _row(effect: str, estimator: str, own: Sequence[Audited]) -> AuditRow:
    good = [one for one in own if not one.failed]
    silent = [one for one in good if not one.told]
    silent_shares = _share(silent, "cells"), _share(silent, "change"), _share(silent, "pressure")
    said = Counter(_kind(one.told) for one in good if one.told)
    return AuditRow(
        effect,
        estimator,
        len(own),
        len(own) - len(good),
        _share(good, "cells"),
        _spread(good, "cells"),
        _share(good, "change"),
        _spread(good, "change"),
        _share(good, "pressure"),
        *silent_shares,
        float(np.median([one.chi_square for one in good])) if good else NAN,
        float(np.median([one.width for one in good])) if good else NAN,
        len(good) - len(silent),
        _verdict(silent_shares),
        next((one.told for one in good if one.told and _kind(one.told) == said.most_common(1)[0][0]), ""),
    )


def _share(own: Sequence[Audited], what: str) -> float:
    """Percent of all intervals that hold the truth; NaN where there is none."""
    counted = sum(getattr(one, what) for one in own)
    return 100 * sum(getattr(one, f"{what}_held") for one in own) / counted if counted else NAN


def _spread(own: Sequence[Audited], what: str) -> float:
    """Standard deviation of that percentage, from the recordings', percent; NaN of fewer than two."""
    shares = [100 * getattr(one, f"{what}_held") / getattr(one, what) for one in own if getattr(one, what)]
    return float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else NAN


def _verdict(shares: tuple[float, float, float]) -> str:
    """What recordings without a sentence make of the promise: 90 to 98 percent, and never below 80.

    Pressures may have wider intervals: beyond what the response tells they reach as far as it goes.
    """
    told = [share for share in shares if not np.isnan(share)]
    if not told:
        return "told"
    if min(told) < NEVER_BELOW:
        return "LIES"
    if min(told) < LEAST:
        return "short"
    return "wide" if np.fmax(*shares[:2]) > MOST else "held"


def _kind(sentence: str) -> str:
    """A sentence without its numbers."""
    return "".join(letter for letter in sentence if not letter.isdigit())


def audit_table(found: Sequence[Audited]) -> Table:
    """Percent of 95 % intervals that hold the truth, effect by effect."""
    headers = ("effect", "estimator", "cells [%]", "change [%]", "press. [%]", "chi2", "told", "verdict")
    rows = [
        (
            row.effect,
            row.estimator,
            _percent(row.cells, row.cells_sd),
            _percent(row.change, row.change_sd),
            _percent(row.pressure),
            "" if np.isnan(row.chi_square) else f"{row.chi_square:.3g}",
            f"{row.told}/{row.recordings - row.failed}",
            row.verdict,
        )
        for row in audit_rows(found)
    ]
    return Table(headers, tuple(rows))


def _percent(share: float, spread: float = NAN) -> str:
    if np.isnan(share):
        return ""
    return f"{share:.1f}" if np.isnan(spread) else f"{share:.1f} ± {spread:.1f}"


def audit_remarks(found: Sequence[Audited]) -> list[str]:
    """What the columns mean, what the promise is and where it is broken, and the sentences that results carry."""
    rows = audit_rows(found)
    broken = [f"{row.effect} × {row.estimator}" for row in rows if row.verdict in ("short", "LIES")]
    kept = f"{len(rows) - len(broken)} of {len(rows)} rows keep the promise"
    lines = [
        "cells, change, press.: how many 95 % intervals hold the truth, ± their standard deviation over recordings;",
        "press. of loaded cells. chi2: of unloaded repeats per reading. told: results that carry a sentence.",
        f"promise, of results without a sentence: {LEAST:g} to {MOST:g} % (held; more is wide), never below "
        f"{NEVER_BELOW:g} % (LIES).",
        kept + (f"; not: {', '.join(broken)}" if broken else ""),
    ]
    said = {row.effect: row.sentence for row in rows if row.sentence}
    lines += [f"{effect}: {sentence}" for effect, sentence in said.items()]
    failures = Counter(f"{one.effect} × {one.estimator}: {one.failed}" for one in found if one.failed)
    return lines + [f"{count} × {failure}" for failure, count in failures.items()]


def write_audit(folder: Path, found: Sequence[Audited]) -> tuple[Path, Path]:
    """Write audit.csv, a row for every effect and estimator, and audit.h5 with every recording; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    table, samples = folder / "audit.csv", folder / "audit.h5"
    write_rows(table, AuditRow, audit_rows(found))
    _write_samples(samples, found)
    return table, samples


def _write_samples(path: Path, found: Sequence[Audited]) -> None:
    """/entry/recordings: one entry for each recording and estimator."""
    columns: tuple[tuple[str, str, Callable[[Audited], Any]], ...] = (
        ("effect", "what the estimator is not told", lambda one: one.effect),
        ("seed", "seed of the recording", lambda one: one.seed),
        ("estimator", "name of the estimator", lambda one: one.estimator),
        ("failed", "why there is nothing to count, or empty", lambda one: one.failed),
        ("cells", "intervals of cells", lambda one: one.cells),
        ("cells_held", "intervals of cells that hold the truth", lambda one: one.cells_held),
        ("change", "intervals of changes", lambda one: one.change),
        ("change_held", "intervals of changes that hold the truth", lambda one: one.change_held),
        ("pressure", "intervals of the pressure of loaded cells", lambda one: one.pressure),
        ("pressure_held", "intervals of pressure that hold the truth", lambda one: one.pressure_held),
        ("chi_square", "chi square of unloaded repeats per degree of freedom", lambda one: one.chi_square),
        ("width", "median standard deviation of the logarithm of a cell", lambda one: one.width),
        ("told", "sentence that the results carry, or empty", lambda one: one.told),
    )
    with samples_file(path, "audit/1", default="recordings") as entry:
        group = entry.create_group("recordings")
        hdf5.set_attributes(group, NX_class="NXdata", signal="cells_held", axes=["case"])
        hdf5.write_scale(group, "case", np.arange(len(found)), "1", "recording with an estimator, in order")
        for name, long_name, value in columns:
            values = [value(one) for one in found]
            text = isinstance(values[0], str)
            hdf5.write_dataset(group, name, hdf5.ascii_array(values) if text else values, "1", long_name, ("case",))
