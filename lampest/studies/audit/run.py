"""The measurement: every effect on fresh recordings, and how often the error bars of each estimator hold the truth."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.estimates import Estimates
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.runs.executors import local
from lampest.studies.audit.settings import AuditFile, AuditTask

LOADED_KPA = 0.5  # a cell counts as loaded from here on: below, a film's answer is smaller than its creep
SOUND = ("", "yes")


@dataclass(frozen=True)
class Audited:
    """One recording with one estimator.

    Parameters
    ----------
    effect, seed, estimator : which. failed : why there is nothing to count; ''.
    cells, cells_held : cells of all measured frames that have an interval, and of these the true ones within it.
    change, change_held : the same of changes against the baseline. pressure, pressure_held : of loaded cells.
    chi_square : of the repeated unloaded frames about their mean, per degree of freedom, with the scene's noise.
    width : median standard deviation of log r. told : the sentence that the results carry; ''.
    """

    effect: str
    seed: int
    estimator: str
    failed: str = ""
    cells: int = 0
    cells_held: int = 0
    change: int = 0
    change_held: int = 0
    pressure: int = 0
    pressure_held: int = 0
    chi_square: float = float("nan")
    width: float = float("nan")
    told: str = ""


def run_audit(audit: AuditFile, on_step: Callable[[int, int], None] = lambda done, total: None) -> tuple[Audited, ...]:
    """Measure everything, in the order of effects and seeds. on_step is told how many of how many recordings are done.

    Raises InputError where the executor cannot run here.
    """
    tasks = audit.tasks
    executor = audit.executor or local(None, len(tasks))
    executor.ready()
    found: dict[tuple[str, int], tuple[Audited, ...]] = {}
    for task, result in executor.results(audited, tasks):
        lost = Audited(task.effect, task.seed, "", " ".join(str(result).split()))
        found[task.effect, task.seed] = result if isinstance(result, tuple) else (lost,)
        on_step(len(found), len(tasks))
    return tuple(one for task in tasks for one in found[task.effect, task.seed])


def audited(task: AuditTask) -> tuple[Audited, ...]:
    """All estimators on one recording."""
    try:
        recording = task.recording()
    except (InputError, ValueError) as error:
        return tuple(Audited(task.effect, task.seed, name, str(error)) for name in task.audit.estimators)
    counted = []
    for name, estimator in task.audit.methods().items():
        try:
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
    cells = within(found.cell_resistance_lower, truth[found.frame], found.cell_resistance_upper)
    changes = within(found.relative_change_lower, change, found.relative_change_upper)
    pressures = within(found.pressure_lower, load, found.pressure_upper, np.abs(load) > LOADED_KPA)
    errors = found.cell_resistance_errors
    width = float("nan") if errors is None else float(np.nanmedian(errors / found.cell_resistance))
    failed = "" if cells[0] else "no error bars"
    scatter = repeats_chi_square(recording)
    return Audited(task.effect, task.seed, name, failed, *cells, *changes, *pressures, scatter, width, told(found))


def within(
    lower: Array | None, truth: Array, upper: Array | None, counted: NDArray[np.bool_] | None = None
) -> tuple[int, int]:
    """(how many of the counted have an interval, how many of those hold the truth)."""
    if lower is None or upper is None:
        return 0, 0
    there = ~np.isnan(lower) & ~np.isnan(upper)
    there &= True if counted is None else counted
    return int(there.sum()), int((there & (lower <= truth) & (truth <= upper)).sum())


def told(found: Estimates) -> str:
    """What the results say against themselves; ''."""
    check = found.model_check
    said = (found.noise.sentence, "" if check.mark in SOUND else check.sentence)
    return "; ".join(part for part in said if part)


def repeats_chi_square(recording: Recording) -> float:
    """χ² of the unloaded frames about their mean, per degree of freedom, with the noise that the scene tells."""
    resting = Readings.of(recording.scene, recording.recorded, recording.sigma)[recording.role == UNLOADED]
    if resting.sigma is None:
        return float("nan")
    plain = resting.plain.all(axis=0)
    about = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain]
    return float((about**2).sum() / ((len(about) - 1) * max(int(plain.sum()), 1)))
