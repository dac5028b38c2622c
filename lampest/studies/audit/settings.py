"""The YAML file of an audit: a simulation, estimators, and the effects that neither is told."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import AnyMethod, MethodName
from lampest.files.document import read_document, validated
from lampest.recording.recording import Recording
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.recording.simulation.unmodelled import Unmodelled, random_stream
from lampest.runs.executors import AnyExecutor
from lampest.runs.terms import FORBID, Terms, terms_of

MOST_SEEDS = 10_000


def usual_effects() -> dict[str, Unmodelled]:
    """What electronics, films and animals do that nobody tells, each at two strengths; first of all nothing."""
    return {
        "as told": Unmodelled(),
        "noise 2": Unmodelled(noise_factor=2),
        "ripple 0.5 LSB": Unmodelled(supply_ripple_lsb=0.5),
        "ripple 2 LSB": Unmodelled(supply_ripple_lsb=2),
        "outliers 1e-4": Unmodelled(outlier_probability=1e-4),
        "outliers 1e-3": Unmodelled(outlier_probability=1e-3),
        "outliers 1e-2": Unmodelled(outlier_probability=1e-2),
        "gain 0.2 %": Unmodelled(gain_spread=0.002),
        "gain 0.5 %": Unmodelled(gain_spread=0.005),
        "moves 5 mm/s": Unmodelled(load_speed_mm_s=5),
        "moves 30 mm/s": Unmodelled(load_speed_mm_s=30),
        "series 5 ohm": Unmodelled(series_resistance_ohm=5),
        "series 20 ohm": Unmodelled(series_resistance_ohm=20),
        "INL 2 LSB": Unmodelled(inl_lsb=2),
        "wire 0.5 ohm": Unmodelled(wire_ohm_per_cell=0.5),
        "static 1 %": Unmodelled(reading_error=0.01),
        "static 10 %": Unmodelled(reading_error=0.1),
        "film bent": Unmodelled(response_loss=0.2),
        "film uneven": Unmodelled(response_spread=0.2),
    }


@dataclass(frozen=True)
class AuditedTerms:
    """An estimator of an audit: its terms, as in a run's file."""

    __pydantic_config__: ClassVar[Any] = FORBID
    terms: Terms  # type: ignore[valid-type]


@dataclass(frozen=True)
class AuditFile:
    """What is held against what.

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

    __pydantic_config__: ClassVar[Any] = FORBID
    schema: Literal[1]
    simulation: Simulation
    estimators: dict[str, AuditedTerms]
    seeds: int = 20
    formulation: MethodName | AnyMethod = "reduced"
    effects: dict[str, Unmodelled] = field(default_factory=usual_effects)
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators or not self.effects:
            raise ValueError("estimators and effects must hold at least one")
        if not 1 <= self.seeds <= MOST_SEEDS:
            raise ValueError(f"seeds must lie between 1 and {MOST_SEEDS}")
        if self.simulation.baseline_frames < 2:
            raise ValueError("simulation.baseline_frames must be at least 2: repeats tell the scatter")
        for effect in self.effects.values():
            replace(self.simulation, unmodelled=effect)

    @property
    def tasks(self) -> tuple["AuditTask", ...]:
        """Every effect with every seed."""
        seeds = range(self.simulation.seed, self.simulation.seed + self.seeds)
        return tuple(AuditTask(self, effect, seed) for effect in self.effects for seed in seeds)

    def methods(self) -> dict[str, Estimator]:
        """The estimators."""
        return {
            name: Estimator(terms_of(entry.terms), self.formulation, error_bars=True)
            for name, entry in self.estimators.items()
        }


@dataclass(frozen=True)
class AuditTask:
    """One recording that all estimators are given."""

    audit: AuditFile
    effect: str
    seed: int

    def recording(self) -> Recording:
        """Simulated anew. Raises ValueError where the effect leaves no readings."""
        told, place = self.audit.simulation, random_stream(self.seed, "audit")
        reach = told.scene.panel.pitch_mm / 2
        loads = []
        for load in told.loads:
            along, down = place.uniform(-reach, reach, 2)
            loads.append(replace(load, centre_mm=(load.centre_mm[0] + float(along), load.centre_mm[1] + float(down))))
        effect = self.audit.effects[self.effect]
        return simulate(
            replace(told, seed=self.seed, loads=tuple(loads), unmodelled=effect), f"{self.effect}_{self.seed}"
        )


def read_audit(path: Path, settings: tuple[str, ...] = ()) -> AuditFile:
    """An audit's file. Raises InputError with line and column."""
    return cast(AuditFile, validated(read_document(path, settings), AuditFile))
