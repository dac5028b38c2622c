"""Real recordings: withheld readings, predicted with every penalty, rule and published method.

Run it with: python -m docs.studies.real [RECORDING ...] [--share 0.1] [--seed 3]

A share of every frame's readings is withheld. Each method estimates the cells from the others and
predicts them. The table has, for every recording, the median over frames of the rms error over that
of interpolation, the share of the withheld readings within the 95 % interval of their prediction,
and the processor time of a frame.
Sources of the other methods: Medrano-Sánchez et al., IEEE Sensors J., 2019, doi
10.1109/JSEN.2019.2918592 (fixed point); Hansen & O'Leary, SIAM J. Sci. Comput. 14, 1993 (L-curve).
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

import lampest
from docs.studies.withheld import interpolated, visible
from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.inference.readings.outliers import impossible_readings

DATA = Path(__file__).parents[2] / "data"
SHIPPED = (DATA / "insole_walking.h5", DATA / "insole_standing.h5")
NOISE = lampest.Misfit(weighting="noise")
PLAIN = lampest.Misfit()
STUDENT = lampest.Misfit(weighting="noise", loss=lampest.Student(corner=4.0))
HUBER = lampest.Huber(corner=0.3)
EVIDENCE = lampest.AutoWeight(rule="evidence")
ESTIMATORS = {  # name → terms, and how weights are chosen
    "`log_gradient`": ((NOISE, lampest.LogGradient()), None),
    "`log_gradient`, evidence": ((NOISE, lampest.LogGradient()), EVIDENCE),
    "`log_gradient`, misfit in ohm": ((PLAIN, lampest.LogGradient()), None),
    "`log_gradient`, Huber 0.3": ((NOISE, lampest.LogGradient(loss=HUBER)), None),
    "`log_gradient`, Huber 0.3, evidence": ((NOISE, lampest.LogGradient(loss=HUBER)), EVIDENCE),
    "`log_gradient`, misfit Student 4": ((STUDENT, lampest.LogGradient()), None),
    "`log_gradient`, misfit Student 4, evidence": ((STUDENT, lampest.LogGradient()), EVIDENCE),
    "`log_gradient`, Huber 0.3, misfit Student 4": (
        (STUDENT, lampest.LogGradient(loss=HUBER)),
        None,
    ),
    "`gradient`": ((NOISE, lampest.Gradient()), None),
    "`gradient`, evidence": ((NOISE, lampest.Gradient()), EVIDENCE),
    "`total_variation`": ((NOISE, lampest.TotalVariation()), None),
    "`total_variation`, evidence": ((NOISE, lampest.TotalVariation()), EVIDENCE),
    "`cell_resistance`": ((NOISE, lampest.CellResistance()), None),
}
MIN_WITHHELD = 5  # readings of a frame that is judged
# of the fixed point, as published
STEP = 0.1
MAX_STEPS = 1000
# of the linearised methods; of log r in one step
GAUSS_NEWTON_STEPS = 8
LONGEST = 1.0
# Of Tikhonov's penalty on ln r, for readings in units of their noise.
WEIGHTS = 10.0 ** np.arange(-3, 5.1, 0.5)
RANKS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9)  # of a truncated inversion, over the number of cells
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Withheld:
    """A recording, a share of whose readings is withheld.

    Attributes
    ----------
    whole, recording : Recording
        With all readings, and without the withheld ones.
    held : boolean array, shape (frames, rows, columns)
        The withheld readings.
    frames : array
        The numbers of the frames that are judged.
    """

    whole: lampest.Recording
    recording: lampest.Recording
    held: NDArray[np.bool_]
    frames: NDArray[np.intp]

    @classmethod
    def of(cls, recording: lampest.Recording, share: float, seed: int) -> "Withheld":
        """Withhold readings that are values and that some cells allow, in every frame."""
        rng = np.random.default_rng(seed)
        readings = recording.readings()
        scene = recording.scene
        usable = (
            readings.plain & scene.panel.present & ~impossible_readings(scene.circuit, readings)
        )
        held = np.zeros(usable.shape, dtype=bool)
        measured = recording.measured_frames()
        for frame in measured:
            places = np.flatnonzero(usable[frame])
            held[frame].flat[rng.choice(places, round(share * len(places)), replace=False)] = True
        remaining = replace(recording, recorded=np.where(held, np.nan, recording.recorded))
        enough = (held.sum(axis=(1, 2)) >= MIN_WITHHELD) & remaining.readings().enough(scene)
        return cls(recording, remaining, held, measured[enough[measured]])

    def shown(self, readings: Array) -> Array:
        """Readings on the scale of their noise, see `visible`."""
        scene = self.whole.scene
        return visible(scene, scene.circuit.to_recorded(readings, scene))

    def errors(self, predicted: Array) -> Array:
        """Rms error of the withheld readings of every judged frame.

        predicted : of all judged frames, as `shown`.
        """
        true = self.shown(self.whole.readings().value[self.frames])
        held = self.held[self.frames]
        return np.array(
            [
                np.sqrt(np.mean((p - t)[h] ** 2))
                for p, t, h in zip(predicted, true, held, strict=True)
            ]
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame without its withheld readings, for methods that are not lampest's.

    Attributes
    ----------
    study : Withheld
    number : int
        Of the frame in the recording.
    data : Data
        Readings in the readout's unit, with their noise.
    known : boolean array, shape (rows, columns)
        Readings that are values or bounds; a bound counts as a value.
    """

    study: Withheld
    number: int
    data: Data
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, study: Withheld, number: int) -> "Frame":
        scene = study.recording.scene
        readings = study.recording.readings()[number]
        estimator = lampest.Estimator((PLAIN,), formulation="reduced")
        return cls(
            study, number, estimator.data(readings.alone(), Background(scene)), readings.seen > 0
        )

    @property
    def present(self) -> NDArray[np.bool_]:
        return np.broadcast_to(self.study.whole.scene.panel.present, self.known.shape)

    @property
    def measured(self) -> Array:
        return np.asarray(self.data.measured[0])

    def interpolated(self, values: Array) -> Array:
        """Each unknown value the mean of its neighbours, by their distance."""
        return interpolated(self.study.whole.scene.panel, values, self.known & self.present)

    def model(self, cells: Array) -> tuple[Array, Array]:
        """(readings, their derivatives with respect to ln r of the cells that are there)."""
        network = self.data.network(0, cells)
        return np.asarray(network.reading()), np.asarray(network.sensitivity())[
            :, self.present.ravel()
        ]

    @property
    def uniform(self) -> Array:
        """ln r of equal cells that explain the mean of ln R."""
        cells = np.where(self.present, 1.0, np.clip(1e30, self.data.lower[0], self.data.upper[0]))
        ratio = np.log(self.measured / self.model(cells)[0])[self.known & self.present]
        return np.where(self.present, float(ratio.mean()), np.log(cells))

    def fitted(self, step: Callable[[Array, Array, Array], Array]) -> Array:
        """Gauss–Newton from equal cells.

        step(J, misfit, u − u₀), both over the noise, gives the change of u = ln r.
        """
        start = position = self.uniform
        lower, upper = (np.log(bound[0]) for bound in (self.data.lower, self.data.upper))
        sigma = np.asarray(self.data.deviation[0]) * np.ones(self.known.shape)
        rows = (self.known & self.present).ravel()
        for _ in range(GAUSS_NEWTON_STEPS):
            reading, jacobian = self.model(np.exp(position))
            misfit = ((self.measured - reading) / sigma).ravel()[rows]
            away = (position - start)[self.present]
            change = np.zeros(self.known.shape)
            change[self.present] = step(jacobian[rows] / sigma.ravel()[rows, None], misfit, away)
            position = np.clip(position + np.clip(change, -LONGEST, LONGEST), lower, upper)
        return np.exp(position)

    def predicted(self, cells: Array) -> Array:
        """Codes of cells (rows, columns)."""
        return self.study.shown(self.model(cells)[0])


def nearest(frame: Frame) -> Array:
    """The nearest reading in the place of a withheld one."""
    rows, columns = np.indices(frame.known.shape)
    places = np.flatnonzero(frame.known & frame.present)
    squares = (rows.ravel()[:, None] - rows.flat[places]) ** 2 + (
        columns.ravel()[:, None] - columns.flat[places]
    ) ** 2
    values = frame.study.shown(frame.measured).ravel()[places]
    return np.asarray(values[np.argmin(squares, axis=1)].reshape(frame.known.shape))


def interpolation(frame: Frame) -> Array:
    """Codes between those of the neighbours."""
    return frame.interpolated(frame.study.shown(frame.measured))


def fixed_point(frame: Frame) -> Array:
    """g ← max(g − β(G(g) − G_m), 0) from g = G_m.

    A cell without a reading is the mean of its neighbours.
    """
    requested = 1 / frame.measured
    conductance = frame.interpolated(np.where(frame.present, requested, 0.0))
    absent = 1 / frame.data.upper[0]
    for _ in range(MAX_STEPS):
        conductance = np.where(frame.present, np.maximum(conductance, absent), absent)
        misfit = 1 / np.asarray(frame.data.network(0, 1 / conductance).reading()) - requested
        conductance = frame.interpolated(
            np.where(frame.known, np.maximum(conductance - STEP * misfit, 0), conductance)
        )
    return frame.predicted(1 / np.where(frame.present, np.maximum(conductance, absent), absent))


def truncated(frame: Frame) -> Array:
    """Estimate by truncated singular values.

    The rank is the best one for the withheld readings, unknown in practice.
    """

    def step(share: float) -> Callable[[Array, Array, Array], Array]:
        def change(jacobian: Array, misfit: Array, away: Array) -> Array:
            left, values, right = np.linalg.svd(jacobian, full_matrices=False)
            used = slice(max(round(share * len(away)), 1))
            target = (left[:, used].T @ (misfit + jacobian @ away)) / values[used]
            return np.asarray(right[used].T @ target - away)

        return change

    predictions = [frame.predicted(frame.fitted(step(share))) for share in RANKS]
    true = frame.study.shown(frame.study.whole.readings().value[frame.number])
    held = frame.study.held[frame.number]
    return min(predictions, key=lambda predicted: float(np.sum((predicted - true)[held] ** 2)))


def tikhonov(frame: Frame) -> Array:
    """‖misfit/σ‖² + λ‖ln r − ln r₀‖², λ at the corner of the L-curve."""

    def step(weight: float) -> Callable[[Array, Array, Array], Array]:
        def change(jacobian: Array, misfit: Array, away: Array) -> Array:
            matrix = jacobian.T @ jacobian + weight * np.eye(len(away))
            return np.asarray(np.linalg.solve(matrix, jacobian.T @ misfit - weight * away))

        return change

    fits = [frame.fitted(step(weight)) for weight in WEIGHTS]
    rows = frame.known & frame.present
    sigma = np.asarray(frame.data.deviation[0]) * np.ones(frame.known.shape)
    misfits = [
        float(np.sum(((frame.model(r)[0] - frame.measured) / sigma)[rows] ** 2)) for r in fits
    ]
    sizes = [float(np.sum((np.log(r) - frame.uniform)[frame.present] ** 2)) for r in fits]
    across = np.log(misfits)
    up = np.log(sizes)
    right = np.gradient(across)
    rise = np.gradient(up)
    curvature = (right * np.gradient(rise) - rise * np.gradient(right)) / np.maximum(
        np.hypot(right, rise), 0.05
    ) ** 3
    return frame.predicted(fits[1 + int(np.argmax(curvature[1:-1]))])


OTHERS: dict[str, Callable[[Frame], Array]] = {
    "the nearest reading": nearest,
    "interpolation": interpolation,
    "fixed point (Medrano-Sánchez)": fixed_point,
    "truncated inversion, best rank": truncated,
    "Tikhonov, L-curve": tikhonov,
}


@dataclass(frozen=True)
class Row:
    """One method on one recording; NaN where it has none.

    error : median over frames of the rms error of withheld readings, in codes or percent; ratio :
        over interpolation's.
    covered : share of withheld readings within 1.96 standard deviations. milliseconds : of
        processor time, a frame.
    weight, weight_sigma : as chosen, and the standard deviation of its logarithm. solved : share of
        the frames.
    """

    recording: str
    method: str
    error: float
    ratio: float
    milliseconds: float
    covered: float = np.nan
    weight: float = np.nan
    weight_sigma: float = np.nan
    solved: float = 1.0


def rows(study: Withheld) -> Iterator[Row]:
    """Every method on a recording."""
    frames = [Frame.of(study, number) for number in study.frames]
    without = study.errors(np.stack([interpolation(frame) for frame in frames]))
    for name, method in OTHERS.items():
        start = process_time()
        with np.errstate(all="ignore"):
            errors = study.errors(np.stack([method(frame) for frame in frames]))
        milliseconds = 1e3 * (process_time() - start) / len(frames)
        yield Row(
            study.whole.name, name, np.median(errors), np.median(errors / without), milliseconds
        )
    for name, (terms, auto_weight) in ESTIMATORS.items():
        yield _estimated(study, without, name, terms, auto_weight)


def _estimated(
    study: Withheld,
    without: Array,
    name: str,
    terms: Sequence[lampest.Term],
    rule: lampest.AutoWeight | None,
) -> Row:
    start = process_time()
    options = {} if rule is None else {"auto_weight": rule}
    results = lampest.reconstruct(study.recording, list(terms), **options)
    milliseconds = 1e3 * (process_time() - start) / len(results.steps)
    judged = np.searchsorted(results.frame, study.frames)
    model = np.stack([results.steps[number].solution.reading[-1] for number in judged])
    solved = results.solved[judged]
    errors = np.where(solved, study.errors(study.shown(model)), np.nan)
    covered = np.nan
    sigma = results.reading_sigma
    if sigma is not None:
        true = study.whole.readings().value[study.frames]
        inside = np.abs(true - model) <= 1.96 * sigma[judged]
        covered = float(np.mean(inside[study.held[study.frames] & np.isfinite(sigma[judged])]))
    step = results.steps[int(judged[0])]
    weight, weight_sigma = (
        float(pair[1]) if len(pair) > 1 else np.nan for pair in (step.weights, step.weight_sigma)
    )
    medians = np.nanmedian(errors), np.nanmedian(errors / without)
    return Row(
        study.whole.name,
        name,
        *medians,
        milliseconds,
        covered,
        weight,
        weight_sigma,
        float(solved.mean()),
    )


def _line(row: Row) -> str:
    covered = "" if np.isnan(row.covered) else f"{100 * row.covered:.0f} %"
    weight = "" if np.isnan(row.weight) else f"{row.weight:.3g} ± {row.weight_sigma:.2f}"
    missing = "" if row.solved == 1 else f" ({100 * row.solved:.0f} % of frames)"
    return (
        f"| {row.method}{missing} | {row.error:.0f} | {row.ratio:.2f} | {covered} | {weight} | "
        f"{row.milliseconds:.3g} |"
    )


def main() -> None:
    """Print a table for every recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="*", type=Path, default=SHIPPED)
    parser.add_argument(
        "--share", type=float, default=0.1, help="of the readings of a frame that are withheld"
    )
    parser.add_argument("--seed", type=int, default=3)
    chosen = parser.parse_args()
    for path in chosen.recordings:
        study = Withheld.of(lampest.Recording.load(path), chosen.share, chosen.seed)
        count = int(study.held[study.frames].sum())
        print(f"\n{study.whole.name}: {count} withheld readings of {len(study.frames)} frames\n")
        print(
            "| method | rms error | over interpolation | within 95 % | weight, ± of ln λ | ms a "
            "frame |"
        )
        print("|---|---|---|---|---|---|")
        for row in rows(study):
            print(_line(row), flush=True)


if __name__ == "__main__":
    main()
