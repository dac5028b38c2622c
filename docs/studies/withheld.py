"""Cross-validation: withheld readings are predicted from all others, over a range of weights.

Run it with: python -m docs.studies.withheld RUN [--share 0.1] [--draws 5] [--seed 0] [--out DIR]
[--set PATH=VALUE] For recordings of unknown truth. Source: Stone, J. R. Statist. Soc. B 36,
1974.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docs.studies import script
from docs.studies.cases import Cases, of_cases
from lampest.apps.studies import study
from lampest.cost.given import Background
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.inference.readings.outliers import impossible_readings
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording
from lampest.report.compare import Columns
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.multistart import best_solution
from lampest.solvers.projected_newton import ProjectedNewton

# Of the estimator's weights, the heaviest first: each solve begins at the last.
FACTORS = (100.0, 10.0, 1.0, 0.1)
MAX_FRAMES = 10  # evenly spaced ones: neighbouring frames show the same load


class Withheld(NamedTuple):
    """One frame, one draw, one weight.

    error, interpolated : rms over the withheld readings, in LSB or percent.

    readings : how many were withheld. factor : of the estimator's weights; weights : these, of the
        penalties.
    hidden : median of a cell's resistance over what its own reading shows, of the readings that
        were used.
    """

    recording: str
    estimator: str
    unit: str
    frame: int
    factor: float
    weights: tuple[float, ...]
    solved: bool
    readings: int
    error: float
    interpolated: float
    hidden: float


def visible(scene: Scene, recorded: Array) -> Array:
    """Recorded readings on the scale of their noise: codes within the rails.

    Without a readout, percent.
    """
    if scene.readout is None:
        return np.asarray(100 * np.log(recorded))
    within = np.clip(recorded, *scene.readout.rails())
    return np.asarray(scene.readout.volt_from_recorded(within) / scene.readout.lsb_volt)


def interpolated(panel: Panel, values: Array, known: NDArray[np.bool_]) -> Array:
    """Each unknown value the mean of its neighbours, by their distance; (rows, columns)."""
    first, second, distance = panel.neighbours
    stiffness = np.zeros((panel.crossings, panel.crossings))
    stiffness[first, second] = stiffness[second, first] = -1 / distance**2
    stiffness[np.diag_indices(panel.crossings)] = -stiffness.sum(axis=1)
    given = np.flatnonzero(known)
    sought = np.flatnonzero(~known & panel.present)
    filled = values.ravel().copy()
    towards = stiffness[np.ix_(sought, given)] @ filled[given]
    filled[sought] = -np.linalg.solve(stiffness[np.ix_(sought, sought)], towards)
    return filled.reshape(panel.shape)


def predictions(
    recording: Recording, case: Case, share: float, draws: int, seed: int
) -> Iterator[Withheld]:
    """Every draw and weight of evenly spaced frames.

    share : of a frame's readings that are values, at least one.

    Readings that no cells allow are neither predicted nor used.
    """
    scene = recording.scene
    readings = recording.readings()
    rng = np.random.default_rng(seed)
    estimator = first_stream(
        recording, Prepared(recording).noise.readings, case.estimator
    ).estimator
    unit = "percent" if scene.readout is None else "LSB"
    impossible = impossible_readings(scene.circuit, readings)
    frames = recording.measured_frames()
    frames = frames[readings.enough(scene)[frames]]
    for frame in frames[np.unique(np.linspace(0, len(frames) - 1, MAX_FRAMES).round().astype(int))]:
        plain = readings[frame].plain & scene.panel.present & ~impossible[frame]
        recorded = recording.recorded[frame]
        sigma = (
            None
            if recording.sigma is None
            else np.broadcast_to(recording.sigma, recording.recorded.shape)[frame]
        )
        shown = visible(scene, np.where(np.isnan(recorded), 1.0, recorded))
        for _ in range(draws):
            held = np.zeros(plain.shape, dtype=bool)
            held.flat[
                rng.choice(np.flatnonzero(plain), max(1, round(share * plain.sum())), replace=False)
            ] = True
            remaining = Readings.of(
                scene, np.where(held | impossible[frame], np.nan, recorded), sigma
            )
            used = remaining.plain & scene.panel.present
            apparent = scene.circuit.apparent_resistance(remaining.value)
            without = interpolated(scene.panel, shown, (remaining.seen > 0) & scene.panel.present)
            for factor, weights, cells in _estimates(estimator, scene, remaining):
                model = scene.circuit.to_recorded(
                    scene.circuit.exact_reading(cells, scene.wiring), scene
                )
                missed = ((record - shown)[held] for record in (visible(scene, model), without))
                error, ignorant = (float(np.sqrt(np.mean(record**2))) for record in missed)
                solved = bool(np.isfinite(cells).all())
                hidden = float(np.median((cells / apparent)[used]))
                about = (
                    recording.name,
                    case.name,
                    unit,
                    int(frame),
                    factor,
                    weights,
                    solved,
                    int(held.sum()),
                )
                yield Withheld(*about, error, ignorant, hidden)


def _estimates(
    estimator: Estimator, scene: Scene, readings: Readings
) -> Iterator[tuple[float, tuple[float, ...], Array]]:
    """(factor, weights of the penalties, cells (rows, columns) ohm) at every factor.

    NaN where a solve failed.
    """
    data = estimator.data(readings.alone(), Background(scene))
    near = None
    for factor in FACTORS:
        weights = [
            float(term.weight) * (1.0 if term.reads_measurement else factor)
            for term in estimator.terms
        ]
        cost = estimator.with_weights(weights).cost(scene, 1, partial=data.partial)
        results = best_solution(ProjectedNewton(cost, estimator.solver), data, near)
        near = results.cell_resistance if results.solved else near
        of_penalties = zip(weights, estimator.terms, strict=True)
        cells = results.cell_resistance[0] if results.solved else np.full(scene.panel.shape, np.nan)
        yield (
            factor,
            tuple(weight for weight, term in of_penalties if not term.reads_measurement),
            cells,
        )


def withheld_study(
    share: float, draws: int = 5, seed: int = 0
) -> study.Study[Run, Cases[Withheld]]:
    """The study that withholds a share of each frame's readings.

    Raises InputError unless 0 < share < 1.
    """
    if not 0 < share < 1:
        raise InputError("--share must lie between 0 and 1, such as 0.1")

    def predicted(case: Case) -> list[Withheld] | str:
        recording = Recording.load(case.path)
        if case.estimator.relative:
            return "it compares with an earlier frame"
        if not case.estimator.penalised:
            return "without a penalty, it leaves a cell open whose reading is withheld"
        if recording.scene.panel.modules is not None:
            return "its panel is one of modules"
        return (
            list(predictions(recording, case, share, draws, seed))
            or "too little was read of every frame"
        )

    return study.Study(
        "withheld",
        "cases",
        "insole.yaml",
        read_run,
        lambda run, on_step: of_cases(predicted, run, on_step, "predict"),
        rows=lambda cases: withheld_rows(cases.measured),
        sheets=lambda cases: [("", withheld_rows(cases.measured), SCREEN)],
        left_out=lambda results: results.left_out,
    )


def _row(records: Sequence[Withheld]) -> study.Row:
    """Return medians over frames and draws of a case at one weight."""
    solved = [
        (record.error, record.error / record.interpolated, record.hidden)
        for record in records
        if record.solved
    ]
    error, ratio, hidden = np.median(solved or [(np.nan,) * 3], axis=0).tolist()
    return study.Row(
        recording=records[0].recording,
        estimator=records[0].estimator,
        weight=" ".join(f"{weight:.3g}" for weight in records[0].weights),
        in_use=int(records[0].factor == 1),
        frames=len({record.frame for record in records}),
        withheld=sum(record.readings for record in records),
        solved=len(solved) / len(records),
        median_rms=error,
        unit=records[0].unit,
        over_interpolation=ratio,
        cell_over_reading=hidden,
    )


withheld_rows = study.rows_by(
    lambda record: (record.recording, record.estimator, record.factor), _row
)
SCREEN: Columns = {
    "recording": "{recording}",
    "estimator": "{estimator}",
    "weight": "{weight}",
    "in use": lambda row: "*" * row.in_use,
    "frames": "{frames}",
    "withheld": "{withheld}",
    "solved": "{solved:.0%}",
    "missed by": "{median_rms:.1f} {unit}",
    "over interpolation": "{over_interpolation:.2f}",
    "cell over reading": "{cell_over_reading:.1f}",
}


if __name__ == "__main__":
    parser = script.parser_of(__doc__)
    parser.add_argument(
        "--share", type=float, default=0.1, help="share of the readings of a frame to withhold"
    )
    parser.add_argument("--draws", type=int, default=5, help="random draws of withheld readings")
    parser.add_argument("--seed", type=int, default=0, help="random seed of the draws")
    script.main(lambda options: withheld_study(options.share, options.draws, options.seed), parser)
