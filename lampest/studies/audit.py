"""Where error bars cover the truth: effects that no scene states, on fresh recordings, by estimator."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import AnyMethod, MethodName
from lampest.estimate.outliers import TO_SIGMA
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_range
from lampest.loads.pressure import NORMAL_95
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.measure import Unmodelled, random_stream
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.runs.executors import AnyExecutor
from lampest.studies import study
from lampest.studies.methods import StudyMethod

LEAST, MOST, NEVER_BELOW = 90.0, 98.0, 80.0  # percent of 95 % intervals that shall cover the truth
LATE_S = 8.0  # when effects come that come during a recording


def usual_effects() -> dict[str, Unmodelled]:
    """What electronics, films and animals do that no scene states, most at two strengths; first of all nothing."""
    return {
        "as specified": Unmodelled(),
        "noise 2": Unmodelled(noise_factor=2),
        **{f"ripple {lsb:g} LSB": Unmodelled(supply_ripple_lsb=lsb) for lsb in (0.5, 2)},
        **{f"outliers 1e-{digit}": Unmodelled(outlier_probability=10.0**-digit) for digit in (4, 3, 2)},
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
        **{f"leak {kohm} kohm, late": Unmodelled(leak_ohm=kohm * 1e3, begins_s=LATE_S) for kohm in (10, 50)},
        "contact 200 ohm, late": Unmodelled(contact_ohm=200, begins_s=LATE_S),
        "all creep 2 %": Unmodelled(common_drift_per_minute=0.12),
        "saturation 0.6": Unmodelled(saturation=0.6),
    }


@dataclass(frozen=True)
class AuditFile(Configuration):
    """What is audited.

    Parameters
    ----------
    simulation : as in a simulation's file; the seeds are `seed` and those that follow it. Loads are put up to half a
        pitch beside their places, drawn for every seed.
    seeds : how many recordings of each effect.
    estimators : methods by name. formulation : of all of them.
    effects : name → what is unmodelled, on top of nothing; the usual ones by default.
    executor : where the recordings are solved; all cores by default.

    Raises ValueError where a number is out of range.
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
            raise ValueError("simulation.baseline_frames must be at least 2: repeats tell the scatter")
        for effect in self.effects.values():
            replace(self.simulation, unmodelled=effect)


@dataclass(frozen=True)
class AuditTask:
    """One recording that all estimators are given."""

    audit: AuditFile
    effect: str
    seed: int

    def recording(self) -> Recording:
        """Simulated anew. Raises ValueError where the effect leaves no readings."""
        stated, place = self.audit.simulation, random_stream(self.seed, "audit")
        reach = stated.scene.panel.pitch_mm / 2
        loads = []
        for load in stated.loads:
            along, down = place.uniform(-reach, reach, 2)
            loads.append(replace(load, centre_mm=(load.centre_mm[0] + float(along), load.centre_mm[1] + float(down))))
        effect = self.audit.effects[self.effect]
        simulation = replace(stated, seed=self.seed, loads=tuple(loads), unmodelled=effect)
        return simulate(simulation, f"{self.effect}_{self.seed}")


@dataclass(frozen=True)
class Audited:
    """One recording with one estimator; `COLUMNS` say what each field is.

    cells, change, pressure : how many have an interval, and of how many (`_covered`) the truth lies in it.
    """

    effect: str
    seed: int
    estimator: str
    failed: str = ""
    cells: int = 0
    cells_covered: int = 0
    change: int = 0
    change_covered: int = 0
    pressure: int = 0
    pressure_covered: int = 0
    alone: int = 0
    alone_covered: int = 0
    chi_square: float = nan
    width: float = nan
    sentence: str = ""
    own: float = nan
    common: float = nan
    ratio: float = nan


COLUMNS = (
    ("effect", "1", "what the scene does not name"),
    ("seed", "1", "seed of the recording"),
    ("estimator", "1", "name of the estimator"),
    ("failed", "1", "why there is nothing to count, or empty"),
    ("cells", "1", "intervals of cells"),
    ("cells_covered", "1", "intervals of cells that cover the truth"),
    ("change", "1", "intervals of changes"),
    ("change_covered", "1", "intervals of changes that cover the truth"),
    ("pressure", "1", "intervals of the pressure of loaded cells"),
    ("pressure_covered", "1", "intervals of pressure that cover the truth"),
    ("alone", "1", "cells with an own part of their standard deviation"),
    ("alone_covered", "1", "cells whose error beside the median of their frame lies within 1.96 of it"),
    ("chi_square", "1", "chi square of unloaded repeats per degree of freedom"),
    ("width", "1", "median standard deviation of the logarithm of a cell"),
    ("sentence", "1", "what the results warn of, or empty"),
    ("own", "1", "median standard deviation of the logarithm of a cell, its own part"),
    ("common", "1", "the same, the part that cells share"),
    ("ratio", "1", "own part over the robust actual error beside the median of the frame"),
)


def run_audit(audit: AuditFile, on_step: study.OnStep) -> tuple[Audited, ...]:
    """Measure everything, in the order of effects and seeds."""
    seeds = range(audit.simulation.seed, audit.simulation.seed + audit.seeds)
    tasks = [AuditTask(audit, effect, seed) for effect in audit.effects for seed in seeds]

    def lost(task: AuditTask, error: object) -> Audited:
        return Audited(task.effect, task.seed, "", " ".join(str(error).split()))

    return study.of_tasks(audited, tasks, audit.executor, lost, on_step)


def audited(task: AuditTask) -> tuple[Audited, ...]:
    """All estimators on one recording."""
    audit = task.audit
    try:
        recording = task.recording()
    except (InputError, ValueError) as error:
        return tuple(Audited(task.effect, task.seed, name, str(error)) for name in audit.estimators)
    counted = []
    for name, method in audit.estimators.items():
        try:
            estimator = Estimator(method.parts, audit.formulation, error_bars=True)
            counted.append(_counted(task, name, recording, reconstruct(recording, estimator)))
        except InputError as error:
            counted.append(Audited(task.effect, task.seed, name, str(error)))
    return tuple(counted)


def _counted(task: AuditTask, name: str, recording: Recording, found: Estimates) -> Audited:
    truth, pressure = recording.truth_cell_resistance, recording.truth_pressure
    assert truth is not None and pressure is not None
    resting = np.exp(np.log(truth[recording.role == UNLOADED]).mean(axis=0))
    change = 100 * (truth[found.frame] / resting - 1)
    load = pressure[found.frame] - pressure[0]
    cells = covered_truths(found.cell_resistance_lower, truth[found.frame], found.cell_resistance_upper)
    changes = covered_truths(found.relative_change_lower, change, found.relative_change_upper)
    # A cell counts as loaded from 0.5 kPa on: below, a film's answer is smaller than its creep.
    pressures = covered_truths(found.pressure_lower, load, found.pressure_upper, np.abs(load) > 0.5)
    errors = found.cell_resistance_errors
    width = nan if errors is None else float(np.nanmedian(errors / found.cell_resistance))
    parts = [nan if part is None else float(np.nanmedian(part)) for part in (found.sigma_own, found.sigma_common)]
    failed = "" if cells[0] else "no error bars"
    counted, covered, ratio = _beside_median(found, truth[found.frame])
    said, scatter = "; ".join(found.checks), repeats_chi_square(recording)
    counts, (own, common) = (*cells, *changes, *pressures), parts
    return Audited(
        *(task.effect, task.seed, name, failed),
        *counts,
        alone=counted,
        alone_covered=covered,
        chi_square=scatter,
        width=width,
        sentence=said,
        own=own,
        common=common,
        ratio=ratio,
    )


def _beside_median(found: Estimates, truth: Array) -> tuple[int, int, float]:
    """(cells, how many lie within 1.96 σ_own of the median error of their frame, σ_own over the robust error)."""
    own = found.sigma_own
    if own is None:
        return 0, 0, nan
    error = np.log(found.cell_resistance / truth)
    error = np.abs(error - np.nanmedian(error, axis=(1, 2), keepdims=True))
    there = np.isfinite(own) & np.isfinite(error)
    size = TO_SIGMA * float(np.median(error[there])) if there.any() else nan
    return int(there.sum()), int((error[there] <= NORMAL_95 * own[there]).sum()), float(np.median(own[there])) / size


def covered_truths(
    lower: Array | None, truth: Array, upper: Array | None, counted: NDArray[np.bool_] | None = None
) -> tuple[int, int]:
    """(how many of the counted have an interval, how many of those cover the truth)."""
    if lower is None or upper is None:
        return 0, 0
    there = ~np.isnan(lower) & ~np.isnan(upper)
    there &= True if counted is None else counted
    return int(there.sum()), int((there & (lower <= truth) & (truth <= upper)).sum())


def repeats_chi_square(recording: Recording) -> float:
    """χ² of the unloaded frames about their mean, per degree of freedom, with the scene's noise."""
    resting = Readings.of(recording.scene, recording.recorded, recording.sigma)[recording.role == UNLOADED]
    if resting.sigma is None:
        return nan
    plain = resting.plain.all(axis=0)
    about = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain]
    return float((about**2).sum() / ((len(about) - 1) * max(int(plain.sum()), 1)))


def audit_rows(found: Sequence[Audited]) -> list[study.Row]:
    """Effects in their order, the estimators of each together, all seeds of both in one row."""
    return study.rows_of(study.grouped(found, lambda one: (one.effect, one.estimator)).values(), FIGURES)


def _good(own: Sequence[Audited]) -> list[Audited]:
    return [one for one in own if not one.failed]


def _silent(own: Sequence[Audited]) -> list[Audited]:
    return [one for one in _good(own) if not one.sentence]


def _usual_sentence(own: Sequence[Audited]) -> str:
    """The most frequent one that results carry, whatever its numbers."""
    kinds = study.grouped(own, lambda one: "".join(letter for letter in one.sentence if not letter.isdigit()))
    said = [alike for kind, alike in kinds.items() if kind]
    return max(said, key=len)[0].sentence if said else ""


def _share(own: Sequence[Audited], what: str) -> float:
    """Percent of all intervals that cover the truth; NaN where there is none."""
    counted = sum(getattr(one, what) for one in own)
    return 100 * sum(getattr(one, f"{what}_covered") for one in own) / counted if counted else nan


def _spread(own: Sequence[Audited], what: str) -> float:
    """Standard error of that percentage, from the recordings', percent; NaN of fewer than two."""
    shares = [100 * getattr(one, f"{what}_covered") / getattr(one, what) for one in own if getattr(one, what)]
    return float(np.std(shares, ddof=1) / np.sqrt(len(shares))) if len(shares) > 1 else nan


def _median(own: Sequence[Audited], what: str) -> float:
    return float(np.median([getattr(one, what) for one in own])) if own else nan


def _verdict(own: Sequence[Audited]) -> str:
    """Whether recordings without a sentence keep the promise: 90 to 98 percent, and never below 80.

    Intervals of pressure may be wider: beyond what the response states they reach as far as it goes.
    """
    shares = [_share(_silent(own), what) for what in ("cells", "change", "pressure")]
    known = [share for share in shares if not np.isnan(share)]
    if not known:
        return "reported"
    if min(known) < LEAST:
        return "uncovered" if min(known) < NEVER_BELOW else "short"
    return "wide" if np.fmax(shares[0], shares[1]) > MOST else "covered"


FIGURES: study.Figures = {
    "effect": lambda own: own[0].effect,
    "estimator": lambda own: own[0].estimator,
    "recordings": len,
    "failed": lambda own: len(own) - len(_good(own)),  # of how many there is nothing to count
    "cells": lambda own: _share(_good(own), "cells"),  # percent of intervals that cover the truth
    "cells_sd": lambda own: _spread(_good(own), "cells"),
    "change": lambda own: _share(_good(own), "change"),
    "change_sd": lambda own: _spread(_good(own), "change"),
    "pressure": lambda own: _share(_good(own), "pressure"),
    "silent_cells": lambda own: _share(_silent(own), "cells"),  # of recordings whose results carry no sentence
    "silent_change": lambda own: _share(_silent(own), "change"),
    "silent_pressure": lambda own: _share(_silent(own), "pressure"),
    "chi_square": lambda own: _median(_good(own), "chi_square"),
    "width": lambda own: _median(_good(own), "width"),
    "own": lambda own: _median(_good(own), "own"),  # parts of the width: each cell's, and what cells share
    "common": lambda own: _median(_good(own), "common"),
    "alone": lambda own: _share(_good(own), "alone"),  # percent of cells within their own part
    "ratio": lambda own: _median(_good(own), "ratio"),  # own part over the actual error
    "reported": lambda own: len(_good(own)) - len(_silent(own)),  # how many carry a sentence
    "verdict": _verdict,
    "sentence": lambda own: _usual_sentence(_good(own)),
}


def _with_spread(share: float, spread: float) -> str:
    return " ± ".join(filter(None, (study.text_of(share, ".1f"), study.text_of(spread, ".1f"))))


SCREEN: dict[str, Callable[[study.Row], str]] = {
    "effect": lambda row: row.effect,
    "estimator": lambda row: row.estimator,
    "cells [%]": lambda row: _with_spread(row.cells, row.cells_sd),
    "change [%]": lambda row: _with_spread(row.change, row.change_sd),
    "press. [%]": lambda row: study.text_of(row.pressure, ".1f"),
    "own [%]": lambda row: study.text_of(row.alone, ".1f"),
    "ratio": lambda row: study.text_of(row.ratio, ".2f"),
    "reported": lambda row: f"{row.reported}/{row.recordings - row.failed}",
    "verdict": lambda row: row.verdict,
}


def audit_remarks(found: Sequence[Audited]) -> list[str]:
    """What the columns mean, where the promise is broken, and the sentences that results carry."""
    rows = audit_rows(found)
    broken = [f"{row.effect} × {row.estimator}" for row in rows if row.verdict in ("short", "uncovered")]
    kept = f"{len(rows) - len(broken)} of {len(rows)} rows keep the promise"
    lines = [
        "cells, change, press.: how many 95 % intervals cover the truth, ± their standard deviation over recordings;",
        "press. of loaded cells. own: cells whose error beside their frame's median lies within the own part; ratio:",
        "own part over that error. reported: results that carry a sentence.",
        f"promise, of results without a sentence: {LEAST:g} to {MOST:g} % (covered; more is wide), never below "
        f"{NEVER_BELOW:g} % (uncovered).",
        kept + (f"; not: {', '.join(broken)}" if broken else ""),
    ]
    said = {row.effect: row.sentence for row in rows if row.sentence}
    lines += [f"{effect}: {sentence}" for effect, sentence in said.items()]
    failures = Counter(f"{one.effect} × {one.estimator}: {one.failed}" for one in found if one.failed)
    return lines + [f"{count} × {failure}" for failure, count in failures.items()]


def _write_recordings(entry: Any, found: Sequence[Audited]) -> None:
    axis = ("case", "recording with an estimator, in order")
    study.write_sequence(entry, "recordings", "cells_covered", axis, found, COLUMNS)


STUDY: study.Study[AuditFile, Sequence[Audited]] = study.Study(
    "audit",
    "recordings",
    "audit.yaml",
    study.read_settings(AuditFile),
    run_audit,
    FIGURES,
    audit_rows,
    lambda found: [("", study.screen_table(audit_rows(found), SCREEN))],
    "audit/1",
    _write_recordings,
    remarks=audit_remarks,
)
