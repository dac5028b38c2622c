"""Coverage of error bars under effects that no scene states, on fresh recordings, by estimator.

Run it with: python -m docs.studies.audit [CONFIG] [--out DIR] [--set PATH=VALUE]
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import nan
from typing import Any, Literal, NamedTuple

import numpy as np

from docs.studies import script
from lampest.apps.studies import study
from lampest.apps.studies.common import StudyMethod
from lampest.apps.studies.study import column
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import AnyMethod, MethodName
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.files.levels import MAD_TO_SIGMA, TWO_SIDED
from lampest.files.typed import Configuration, check_range
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.measure import Unmodelled, random_stream
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.report.compare import Columns, grouped
from lampest.runs.executors import AnyExecutor, Processes, each_of

# percent of 95 % intervals that shall cover the truth
LEAST = 90.0
MOST = 98.0
NEVER_BELOW = 80.0
LATE_S = 8.0  # when effects come that come during a recording


def usual_effects() -> dict[str, Unmodelled]:
    """Effects of electronics, films and animals that no scene states, most at two strengths.

    The first entry has no effect.
    """
    return {
        "as specified": Unmodelled(),
        "noise 2": Unmodelled(noise_factor=2),
        **{f"ripple {lsb:g} LSB": Unmodelled(supply_ripple_lsb=lsb) for lsb in (0.5, 2)},
        **{
            f"outliers 1e-{digit}": Unmodelled(outlier_probability=10.0**-digit)
            for digit in (4, 3, 2)
        },
        **{f"gain {percent:g} %": Unmodelled(gain_spread=percent / 100) for percent in (0.2, 0.5)},
        **{f"moves {speed} mm/s": Unmodelled(load_speed_mm_s=speed) for speed in (5, 30)},
        **{f"series {ohm} ohm": Unmodelled(series_resistance_ohm=ohm) for ohm in (5, 20)},
        "INL 2 LSB": Unmodelled(inl_lsb=2),
        "wire 0.5 ohm": Unmodelled(wire_ohm_per_cell=0.5),
        **{f"static {percent} %": Unmodelled(reading_error=percent / 100) for percent in (1, 10)},
        "film bent": Unmodelled(response_loss=0.2),
        "film uneven": Unmodelled(response_spread=0.2),
        "reference 5 %": Unmodelled(reference_tolerance=0.05),
        "leak 10 kohm": Unmodelled(leak_ohm=10e3),
        **{
            f"leak {kohm} kohm, late": Unmodelled(leak_ohm=kohm * 1e3, begins_s=LATE_S)
            for kohm in (10, 50)
        },
        "contact 200 ohm, late": Unmodelled(contact_ohm=200, begins_s=LATE_S),
        "all creep 2 %": Unmodelled(common_drift_per_minute=0.12),
        "saturation 0.6": Unmodelled(saturation=0.6),
    }


@dataclass(frozen=True)
class AuditFile(Configuration):
    """What is audited. Raises ValueError where a number is out of range.

    simulation : as in a simulation's file; the seeds are `seed` and those that follow it. Loads are
        put up to half a pitch beside their places, drawn for every seed.
    estimators : methods by name. seeds : how many recordings of each effect. formulation : of all
        estimators.
    effects : name → what is unmodelled, on top of nothing. executor : all cores by default.
    """

    schema: Literal[1]
    simulation: Simulation
    estimators: dict[str, StudyMethod]
    seeds: int = 20
    formulation: MethodName | AnyMethod = "reduced"
    effects: dict[str, Unmodelled] = field(default_factory=usual_effects)
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators or not self.effects:
            raise ValueError("estimators and effects must hold at least one")
        check_range("seeds", self.seeds, 1, 10_000)
        if self.simulation.baseline_frames < 2:
            raise ValueError(
                "simulation.baseline_frames must be at least 2: repeats tell the scatter"
            )
        for effect in self.effects.values():
            replace(self.simulation, unmodelled=effect)


class AuditTask(NamedTuple):
    """One recording that all estimators are given."""

    audit: AuditFile
    effect: str
    seed: int

    def recording(self) -> Recording:
        """Simulated anew. Raises ValueError where the effect leaves no readings."""
        stated = self.audit.simulation
        place = random_stream(self.seed, "audit")
        reach = stated.scene.panel.pitch_mm / 2
        loads = []
        for load in stated.loads:
            x_mm, y_mm = np.add(load.centre_mm, place.uniform(-reach, reach, 2)).tolist()
            loads.append(replace(load, centre_mm=(x_mm, y_mm)))
        effect = self.audit.effects[self.effect]
        simulation = replace(stated, seed=self.seed, loads=tuple(loads), unmodelled=effect)
        return simulate(simulation, f"{self.effect}_{self.seed}")


@dataclass(frozen=True)
class Audited:
    """One recording with one estimator: how many intervals there are, and of how many (`_covered`)
    the truth lies in
    them."""

    effect: str = column("1", "what the scene does not name")
    seed: int = column("1", "seed of the recording")
    estimator: str = column("1", "name of the estimator")
    failed: str = column("1", "why there is nothing to count, or empty", "")
    cells: int = column("1", "intervals of cells", 0)
    cells_covered: int = column("1", "intervals of cells that cover the truth", 0)
    change: int = column("1", "intervals of changes", 0)
    change_covered: int = column("1", "intervals of changes that cover the truth", 0)
    pressure: int = column("1", "intervals of the pressure of loaded cells", 0)
    pressure_covered: int = column("1", "intervals of pressure that cover the truth", 0)
    alone: int = column("1", "cells with an own part of their standard deviation", 0)
    alone_covered: int = column(
        "1", "cells whose error beside the median of their frame lies within 1.96 of that part", 0
    )
    chi_square: float = column("1", "chi square of unloaded repeats per degree of freedom", nan)
    width: float = column("1", "median standard deviation of the logarithm of a cell", nan)
    sentence: str = column("1", "what the results warn of, or empty", "")
    own: float = column(
        "1", "median standard deviation of the logarithm of a cell, its own part", nan
    )
    common: float = column("1", "the same, the part that cells share", nan)
    ratio: float = column(
        "1", "own part over the robust actual error beside the median of the frame", nan
    )


def run_audit(audit: AuditFile, on_step: study.OnStep) -> tuple[Audited, ...]:
    """Measure everything, in the order of effects and seeds."""
    seeds = range(audit.simulation.seed, audit.simulation.seed + audit.seeds)
    tasks = [AuditTask(audit, effect, seed) for effect in audit.effects for seed in seeds]
    executor = audit.executor or Processes()
    results = each_of(
        audited, tasks, on_step, executor, lambda task, error: (_failed(task, "", error),)
    )
    return tuple(chain.from_iterable(results))


def _failed(task: AuditTask, estimator: str, error: object) -> Audited:
    return Audited(task.effect, task.seed, estimator, " ".join(str(error).split()))


def audited(task: AuditTask) -> tuple[Audited, ...]:
    """All estimators on one recording."""
    estimators = task.audit.estimators
    try:
        recording = task.recording()
    except (InputError, ValueError) as error:
        return tuple(_failed(task, name, error) for name in estimators)
    return tuple(_counted(task, name, method, recording) for name, method in estimators.items())


def _counted(task: AuditTask, name: str, method: StudyMethod, recording: Recording) -> Audited:
    try:
        results = reconstruct(
            recording,
            Estimator(method.parts, task.audit.formulation, bounds=method.bounds, error_bars=True),
        )
    except InputError as error:
        return _failed(task, name, error)
    assert recording.truth_cell_resistance is not None and recording.truth_pressure is not None
    resting = np.exp(
        np.log(recording.truth_cell_resistance[recording.role == UNLOADED]).mean(axis=0)
    )
    truth = recording.truth_cell_resistance[results.frame]
    load = recording.truth_pressure[results.frame] - recording.truth_pressure[0]
    # A cell counts as loaded from 0.5 kPa on: below, a film's answer is smaller than its creep.
    intervals = {
        "cells": _covered(results.cell_resistance_lower, truth, results.cell_resistance_upper),
        "change": _covered(
            results.relative_change_lower,
            100 * (truth / resting - 1),
            results.relative_change_upper,
        ),
        "pressure": _covered(
            results.pressure_lower, load, results.pressure_upper, np.abs(load) > 0.5
        ),
    }
    counts: dict[str, Any] = {name: number for name, (number, _) in intervals.items()}
    counts |= {f"{name}_covered": inside for name, (_, inside) in intervals.items()}
    if results.cell_resistance_errors is not None:
        counts["width"] = float(
            np.nanmedian(results.cell_resistance_errors / results.cell_resistance)
        )
    for part, sigma in (("own", results.sigma_own), ("common", results.sigma_common)):
        counts[part] = nan if sigma is None else float(np.nanmedian(sigma))
    counts |= _own_part(results, truth) | {"chi_square": repeats_chi_square(recording)}
    failed = "" if counts["cells"] else "no error bars"
    return Audited(
        task.effect, task.seed, name, failed, sentence="; ".join(results.checks), **counts
    )


def _own_part(results: Estimates, truth: Array) -> dict[str, Any]:
    """Cells within 1.96 σ_own of their frame's median error, and σ_own over the robust error."""
    own = results.sigma_own
    if own is None:
        return {}
    error = np.log(results.cell_resistance / truth)
    error = np.abs(error - np.nanmedian(error, axis=(1, 2), keepdims=True))
    finite = np.isfinite(own) & np.isfinite(error)
    size = MAD_TO_SIGMA * float(np.median(error[finite])) if finite.any() else nan
    inside = int((error[finite] <= TWO_SIDED * own[finite]).sum())
    return {
        "alone": int(finite.sum()),
        "alone_covered": inside,
        "ratio": float(np.median(own[finite])) / size,
    }


def _covered(
    lower: Array | None, truth: Array, upper: Array | None, counted: Any = True
) -> tuple[int, int]:
    """(how many of the counted have an interval, how many of those cover the truth)."""
    if lower is None or upper is None:
        return 0, 0
    with_interval = ~np.isnan(lower) & ~np.isnan(upper) & counted
    return int(with_interval.sum()), int(
        (with_interval & (lower <= truth) & (truth <= upper)).sum()
    )


def repeats_chi_square(recording: Recording) -> float:
    """χ² of the unloaded frames about their mean, per degree of freedom, with the scene's noise."""
    resting = Readings.of(recording.scene, recording.recorded, recording.sigma)[
        recording.role == UNLOADED
    ]
    if resting.sigma is None:
        return nan
    plain = resting.plain.all(axis=0)
    about = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain]
    return float((about**2).sum() / ((len(about) - 1) * max(int(plain.sum()), 1)))


def _usual_sentence(own: Sequence[Audited]) -> str:
    """The most frequent one that results carry, whatever its numbers."""
    kinds = grouped(
        own, lambda record: "".join(letter for letter in record.sentence if not letter.isdigit())
    )
    messages = [similar for kind, similar in kinds.items() if kind]
    return max(messages, key=len)[0].sentence if messages else ""


def _share(own: Sequence[Audited], what: str) -> float:
    """Percent of all intervals that cover the truth; NaN where there is none."""
    counted = sum(getattr(record, what) for record in own)
    return (
        100 * sum(getattr(record, f"{what}_covered") for record in own) / counted
        if counted
        else nan
    )


def _spread(own: Sequence[Audited], what: str) -> float:
    """Standard error of that percentage, from the recordings', percent; NaN of fewer than two."""
    shares = [
        100 * getattr(record, f"{what}_covered") / getattr(record, what)
        for record in own
        if getattr(record, what)
    ]
    return float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else nan


def _verdict(shares: Sequence[float]) -> str:
    """Whether recordings without a sentence keep the promise: 90 to 98 percent, and never below 80.

    Without such recordings it is 'reported'. Intervals of pressure may be wider: beyond what the
    response states they reach as far as it goes.
    """
    known = [share for share in shares if not np.isnan(share)]
    if not known:
        return "reported"
    if min(known) < LEAST:
        return "uncovered" if min(known) < NEVER_BELOW else "short"
    return "wide" if np.fmax(shares[0], shares[1]) > MOST else "covered"


def _row(own: Sequence[Audited]) -> study.Row:
    """Coverages in percent, `silent_` those of recordings without a sentence.

    Failed ones count nowhere.
    """
    good = [record for record in own if not record.failed]
    silent = [record for record in good if not record.sentence]
    coverage: dict[str, float] = {}
    for what in ("cells", "change"):
        coverage |= {what: _share(good, what), f"{what}_sd": _spread(good, what)}
    coverage["pressure"] = _share(good, "pressure")
    coverage |= {f"silent_{what}": _share(silent, what) for what in ("cells", "change", "pressure")}
    medians = {
        what: float(np.median([getattr(record, what) for record in good])) if good else nan
        for what in ("chi_square", "width", "own", "common", "ratio")
    }
    return study.Row(
        effect=own[0].effect,
        estimator=own[0].estimator,
        recordings=len(own),
        failed=len(own) - len(good),
        solved=len(good),
        **coverage,
        **medians,
        alone=_share(good, "alone"),
        reported=len(good) - len(silent),
        verdict=_verdict([coverage[f"silent_{what}"] for what in ("cells", "change", "pressure")])
        if good
        else "failed",
        sentence=_usual_sentence(good),
    )


audit_rows = study.rows_by(lambda record: (record.effect, record.estimator), _row)
SCREEN: Columns = {
    "effect": "{effect}",
    "estimator": "{estimator}",
    "cells [%]": "{cells:.1f} ± {cells_sd:.1f}",
    "change [%]": "{change:.1f} ± {change_sd:.1f}",
    "press. [%]": "{pressure:.1f}",
    "own [%]": "{alone:.1f}",
    "ratio": "{ratio:.2f}",
    "reported": "{reported}/{solved}",
    "verdict": "{verdict}",
}


def audit_remarks(results: Sequence[Audited]) -> list[str]:
    """Return the meaning of the columns, the broken promises, and the sentences of the results."""
    rows = audit_rows(results)
    broken = [
        f"{row.effect} × {row.estimator}"
        for row in rows
        if row.verdict in ("short", "uncovered", "failed")
    ]
    cached = f"{len(rows) - len(broken)} of {len(rows)} rows keep the promise"
    lines = [
        "cells, change, press.: how many 95 % intervals cover the truth, ± their standard "
        "deviation over recordings;",
        "press. of loaded cells. own: cells whose error beside their frame's median lies within "
        "the own part; ratio:",
        "own part over that error. reported: results that carry a sentence.",
        f"promise, of results without a sentence: {LEAST:g} to {MOST:g} % (covered; more is wide), "
        "never below "
        f"{NEVER_BELOW:g} % (uncovered).",
        cached + (f"; not: {', '.join(broken)}" if broken else ""),
    ]
    message = {row.effect: row.sentence for row in rows if row.sentence}
    lines += [f"{effect}: {sentence}" for effect, sentence in message.items()]
    failures = Counter(
        f"{record.effect} × {record.estimator}: {record.failed}"
        for record in results
        if record.failed
    )
    return lines + [f"{count} × {failure}" for failure, count in failures.items()]


STUDY: study.Study[AuditFile, Sequence[Audited]] = study.Study(
    "audit",
    "recordings",
    "audit.yaml",
    study.read_settings(AuditFile),
    run_audit,
    rows=audit_rows,
    sheets=lambda results: [("", audit_rows(results), SCREEN)],
    form="audit/1",
    records=lambda results: [study.RecordGroup("recordings", results, "cells_covered")],
    remarks=audit_remarks,
)


if __name__ == "__main__":
    script.main(lambda options: STUDY, script.parser_of(__doc__))
