"""Atlas of extreme scenes: how each solve ended.

Solves are verified by 50-digit arithmetic and a second test of optimality, which share no code with
the solvers.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, product
from math import nan
from operator import attrgetter
from typing import Literal

import numpy as np

from lampest.apps.studies import study
from lampest.apps.studies.certified import (
    correct_digits,
    exact_cost,
    exact_residual,
    exact_scale,
    fifty_digit_library,
    fifty_digits,
)
from lampest.apps.studies.common import StudyMethod, paper_methods
from lampest.apps.studies.extreme_scenes import CASES, GRID, AtlasSample, Grid, recording_of
from lampest.apps.studies.study import OnStep, column
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream, frame_period
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.typed import Configuration
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import exact_two_point_resistance, two_point_resistance
from lampest.recording.recording import Recording
from lampest.report.compare import Columns, grouped
from lampest.runs.executors import AnyExecutor, Processes, each_of
from lampest.solvers.solution import VERIFIED, Settings

# Cells of a panel below which the nodal formulation solves a case, too.
MAX_SPECIAL_CELLS = 100


@dataclass(frozen=True)
class AtlasFile(Configuration):
    """Settings of the atlas.

    Attributes
    ----------
    grid
        Panels of random cells.
    structured
        Sizes, contrasts and noise of all other cases.
    nodal
        Sizes, decades and noise of the scenes that the nodal formulation solves, too.
    estimators
        Methods by name; by default the five of the paper.
    solver
        Tolerance and iterations.
    audit_cells
        Largest panel on which optimality is tested by differences of the exact forward map.
    executor
        Where the scenes are solved; by default on all cores.
    """

    schema: Literal[1]
    grid: Grid
    structured: Grid
    nodal: Grid = Grid(())
    estimators: dict[str, StudyMethod] = field(default_factory=paper_methods)
    solver: Settings = Settings()
    audit_cells: int = 64
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        terms = chain.from_iterable(method.parts for method in self.estimators.values())
        if not all(term.loss.squared for term in terms):
            raise ValueError("only squared losses can be tested by differences of the cost")
        if not self.samples:
            raise ValueError("grid and structured hold no scene")

    @property
    def samples(self) -> list[AtlasSample]:
        """Every scene in the order of the atlas."""
        structured = chain.from_iterable(
            self.structured.samples(name) for name in CASES if name != GRID
        )
        return [*self.grid.samples(GRID), *structured]

    def formulations(self, sample: AtlasSample) -> tuple[Literal["reduced", "nodal"], ...]:
        """Return the formulations in which every method solves a scene."""
        part = self.nodal
        is_small = sample.rows * sample.columns < MAX_SPECIAL_CELLS
        has_shape = sample.shape in part.shapes or (bool(CASES[sample.case].shapes) and is_small)
        has_noise = 100 * sample.noise in part.noise
        has_decades = sample.decades in (*part.decades, 0.0)
        if has_shape and has_noise and has_decades and sample.seed < part.seeds:
            return ("reduced", "nodal")
        return ("reduced",)


CRASHED = "crashed: "
REFUSED = "refused: "


@dataclass(frozen=True)
class Solve(AtlasSample):
    """A solve of the atlas; digits are log relative errors (NIST StRD)."""

    method: str = column("1", "method")
    formulation: str = column("1", "formulation")
    part: str = column("1", "baseline, frame, or the pair of both")
    solved: bool = column("1", "1: there is an estimate")
    status: str = column("1", "how the solve ended")
    iterations: int = column("1", "iterations of the solver", 0)
    residual: float = column("1", "KKT residual of the accepted estimate", nan)
    audited: float = column(
        "1", "the same by differences of the exact forward map; NaN on large panels", nan
    )
    excess: float = column(
        "1", "cost of the estimate over that of the truth within the bounds, scaled", nan
    )
    forward_digits: float = column("1", "LRE of the forward map, 50 digits", nan)
    model_digits: float = column("1", "LRE of the estimate's two-point resistance", nan)

    @property
    def doubtful(self) -> bool:
        """Whether the second test of optimality does not confirm an estimate."""
        return self.solved and self.audited > 10 * VERIFIED  # of a residual by differences

    @property
    def verified(self) -> bool:
        """Whether there is an estimate without objections."""
        return self.solved and not self.doubtful

    @property
    def crashed(self) -> bool:
        """Whether there is neither an estimate nor a reason."""
        return self.status.startswith(CRASHED)


def run_atlas(atlas: AtlasFile, on_step: OnStep = lambda done, total: None) -> tuple[Solve, ...]:
    """Solve all scenes in the order of the atlas.

    `on_step` receives the numbers of finished and of all scenes. Raises InputError if mpmath is not
    installed.
    """
    fifty_digit_library()
    solves = each_of(
        partial(solves_of, atlas),
        atlas.samples,
        on_step,
        atlas.executor or Processes(),
        lambda sample, error: (_failed(sample, "", "", "", error),),
    )
    return tuple(chain.from_iterable(solves))


def _failed(
    sample: AtlasSample, method: str, formulation: str, part: str, error: BaseException
) -> Solve:
    """Return a solve that ended with an exception."""
    status = f"{CRASHED}{type(error).__name__}: {error}"
    if isinstance(error, InputError):
        status = f"{REFUSED}{error}"
    return Solve(
        **vars(sample),
        method=method,
        formulation=formulation,
        part=part,
        solved=False,
        status=status,
    )


def solves_of(atlas: AtlasFile, sample: AtlasSample) -> tuple[Solve, ...]:
    """Return all solves of a scene."""
    recording, cells = recording_of(sample)
    forward = min(
        correct_digits(two_point_resistance(frame), fifty_digits(frame)) for frame in cells
    )
    weight = CASES[sample.case].weight
    solves = list[Solve]()
    for formulation, (name, method) in product(
        atlas.formulations(sample), atlas.estimators.items()
    ):
        try:
            estimator = method.estimator(formulation, atlas.solver)
            if weight is not None:
                estimator = estimator.with_weights(
                    [
                        float(term.weight) if term.reads_measurement else weight
                        for term in estimator.terms
                    ]
                )
            solves += [*judged(sample, name, estimator, recording, cells, atlas.audit_cells)]
        except Exception as error:  # whatever it is, the atlas shows it
            solves.append(_failed(sample, name, formulation, "frame", error))
    return tuple(replace(solve, forward_digits=forward) for solve in solves)


def judged(
    sample: AtlasSample,
    name: str,
    estimator: Estimator,
    recording: Recording,
    truth: Array,
    audit_cells: int,
) -> Iterator[Solve]:
    """Yield the solves of baseline and frame, or of the pair, judged by the cells of the scene.

    Parameters
    ----------
    sample, name, estimator, recording
        The scene, and the method with its name.
    truth : array, shape (2, rows, columns)
        Ohm.
    audit_cells : int
        Largest panel with a second test of optimality.
    """
    readings = recording.readings()
    stream = first_stream(recording, readings, estimator)
    data, _ = stream.data_and_start(readings[1])
    _, step = stream.push(readings[1])
    joint = len(data.measured) == 2
    parts = [("pair" if joint else "frame", truth[1 - joint :], estimator, data, step.solution)]
    if stream.baseline is not None:
        absolute = replace(estimator, terms=estimator.absolute_terms)
        blank = Stream(absolute, recording.scene, frame_period(recording), readings[0])
        unloaded, _ = blank.data_and_start(blank.resting)
        parts.insert(0, ("baseline", truth[:1], absolute, unloaded, stream.baseline.solution))
    for part, cells, solved_by, data, solution in parts:
        figures = study.named_values(solution, "solved", "iterations")
        if solution.solved:
            cost = solved_by.cost(recording.scene, len(data.measured), partial=data.partial)
            estimate = solution.cell_resistance
            objective = exact_cost(cost, data, estimate)
            best = exact_cost(cost, data, np.clip(cells, data.lower, data.upper))
            is_small = estimate[0].size <= audit_cells
            figures |= {
                "audited": exact_residual(cost, data, estimate) if is_small else nan,
                "excess": (objective - best) / exact_scale(cost, data, estimate),
                "model_digits": correct_digits(
                    solution.reading, exact_two_point_resistance(estimate)
                ),
            }
        yield Solve(
            **vars(sample),
            method=name,
            formulation=solved_by.method.kind,
            part=part,
            status=solution.status.value,
            residual=solution.kkt_residual,
            **figures,
        )


def _row(group: Sequence[Solve]) -> study.Row:
    """Summarise solves; digits are the least, residuals the largest.

    Solves are counted as verified (confirmed estimates), named (failures with a reason), doubtful
    (estimates that the audit does not confirm), crashed (failures without a reason), and worse
    (estimates that cost more than the truth).
    """
    solved = [solve for solve in group if solve.solved]
    statuses = Counter(solve.status for solve in group).most_common()
    iterations = [solve.iterations for solve in group]

    def extreme(of: np.ufunc, name: str, solves: Sequence[Solve]) -> float:
        return float(of.reduce([getattr(solve, name) for solve in solves], initial=nan))

    return study.Row(
        **study.named_values(
            group[0], "case", "decades", "rows", "columns", "noise", "method", "formulation"
        ),
        solves=len(group),
        verified=sum(solve.verified for solve in group),
        named=sum(not solve.solved and not solve.crashed for solve in group),
        doubtful=sum(solve.doubtful for solve in group),
        crashed=sum(solve.crashed for solve in group),
        worse=sum(solve.excess > VERIFIED for solve in solved),
        forward_digits=extreme(np.fmin, "forward_digits", group),
        model_digits=extreme(np.fmin, "model_digits", solved),
        residual=extreme(np.fmax, "residual", solved),
        audited=extreme(np.fmax, "audited", solved),
        iterations=float(np.median(iterations)),
        most_iterations=max(iterations),
        statuses="; ".join(f"{count} × {status}" for status, count in statuses),
    )


atlas_rows = study.rows_by(  # for each cell of the atlas
    attrgetter("case", "decades", "shape", "noise", "method", "formulation"), _row
)
# All methods, sizes and noises together.
case_rows = study.rows_by(attrgetter("case", "decades"), _row)
SCREEN: Columns = {
    "case": "{case}",
    "decades": lambda row: f"{row.decades:g}" if CASES[row.case].contrasted else "",
    "verified": "{verified}/{solves}",
    "named": lambda row: f"{row.named or ''}",
    "doubtful": lambda row: f"{row.doubtful or ''}",
    "crashed": lambda row: f"{row.crashed or ''}",
    "worse than truth": lambda row: f"{row.worse or ''}",
    "digits: forward": "{forward_digits:.1f}",
    "model": "{model_digits:.1f}",
    "worst KKT": "{residual:.0e}",
    "audited": "{audited:.0e}",
    "iterations (most)": "{iterations:.0f} ({most_iterations})",
}


def mild(solve: Solve) -> bool:
    """Return whether a verified optimum is promised.

    The promise holds for noise up to 1 %, and a contrast up to 10⁶ or a single fault.
    """
    case = CASES[solve.case]
    return ((case.contrasted and solve.decades <= 6) or case.single_fault) and solve.noise <= 0.01


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """Return the share of verified optima, and the counts of other endings."""
    named = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    lines = [_share(named, len(solves), "solves end with a verified optimum or a sentence")]
    for title, chosen in (
        ("all", solves),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in grouped(tame, lambda solve: solve.case).items()),
    ):
        lines.append(
            f"{title}: {_share(sum(solve.verified for solve in chosen), len(chosen), 'verified')}"
        )
    # A refusal without the numbers of its scene.
    ended = Counter(
        solve.status.split(":")[0] if solve.status.startswith(REFUSED) else solve.status
        for solve in solves
        if not solve.solved
    )
    return lines + [f"{count} × {status}" for status, count in ended.most_common()]


def _share(part: int, whole: int, noun: str) -> str:
    return f"{part} of {whole} {noun} ({f'{100 * part / whole:.2f} %' if whole else 'none tried'})"


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    rows=atlas_rows,
    sheets=lambda solves: [("", case_rows(solves), SCREEN)],
    form="extremes/2",
    records=lambda solves: [
        study.RecordGroup("solves", solves, "solved", attributes={"verified_below": VERIFIED})
    ],
    remarks=atlas_remarks,
)
