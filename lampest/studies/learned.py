"""What withheld readings say of the electronics: the converter's offset and curve, resistance in series, noise.

Each is chosen so that withheld readings are predicted best: least squares over all of them by Gauss and Newton, with
standard errors that take readings of a frame for dependent. Source: White, Econometrica 48, 1980 (sandwich); Liang &
Zeger, Biometrika 73, 1986 (clusters).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.estimate.estimator import Estimator
from lampest.estimate.noise import noise_seen
from lampest.estimate.outliers import pair_scale
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording
from lampest.runs.config import Case, Run, read_run
from lampest.solvers.multistart import BROKEN
from lampest.studies import study
from lampest.studies.withheld import Draw, draws_of, predicted_cells, unpredictable, visible

STEPS = (8.0, 8.0, 0.01)  # LSB, LSB and of the reference: differences for derivatives, far above a solve's tolerance
ROUNDS = 3  # of Gauss and Newton


@dataclass(frozen=True)
class Learned:
    """One quantity of one case. value, error : in `unit`; error NaN where nothing shows it. before, after : rms of the
    prediction of withheld readings in LSB, with the scene's electronics and with what was learned."""

    recording: str
    quantity: str
    value: float
    error: float
    unit: str
    frames: int
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class Electronics:
    """What the scene does not say. offset, curve : LSB, code' = code + offset + curve·4x(1 − x), x the code over full
    scale. series : resistance beyond the scene's, of the reference resistor."""

    offset: float = 0.0
    curve: float = 0.0
    series: float = 0.0

    def of_scene(self, scene: Scene) -> Scene:
        """The scene with its resistance in series."""
        assert isinstance(scene.readout, TwoPointReadout)
        more = self.series * scene.readout.reference_ohm
        return replace(scene, series_resistance_ohm=scene.series_ohm.max() + more) if more else scene

    def corrected(self, readout: Readout, recorded: Array) -> Array:
        """Recorded values as a converter without offset and curve would have them; bounds and missing ones stay."""
        code = readout.volt_from_recorded(recorded) / readout.lsb_volt
        share = code / 2**readout.adc_bits
        volt = (code + self.offset + 4 * self.curve * share * (1 - share)) * readout.lsb_volt
        usual = np.isfinite(recorded) & (recorded > 0)
        return np.where(usual, readout.recorded_from_volt(np.where(usual, volt, readout.lsb_volt)), recorded)

    def slope(self, readout: Readout, code: Array) -> Array:
        """d code'/d code."""
        return np.asarray(1 + 4 * self.curve * (1 - 2 * code / 2**readout.adc_bits) / 2**readout.adc_bits)


@dataclass(frozen=True, eq=False)
class Prediction:
    """A recording's draws, to be predicted with any electronics."""

    recording: Recording
    estimator: Estimator
    draws: Sequence[Draw]

    @classmethod
    def of(cls, recording: Recording, case: Case, share: float, draws: int, seed: int) -> "Prediction":
        """With the weights that the case chooses."""
        estimator = first_stream(recording, noise_seen(recording).readings, case.estimator).estimator
        return cls(recording, estimator, tuple(draws_of(recording, share, draws, seed)))

    def missed(self, electronics: Electronics) -> list[Array]:
        """By how many LSB of the recorded codes each draw's withheld readings are missed."""
        readout, found = self.recording.scene.readout, list[Array]()
        assert readout is not None
        scene = electronics.of_scene(self.recording.scene)
        for draw in self.draws:
            recorded = electronics.corrected(readout, self.recording.recorded[draw.frame])
            readings = Readings.of(scene, np.where(draw.blank, np.nan, recorded), draw.sigma)
            cells = predicted_cells(self.estimator, scene, readings)
            model = scene.circuit.to_recorded(scene.circuit.exact_reading(cells, scene.wiring), scene)
            shown = visible(scene, recorded[draw.held])
            found.append((visible(scene, model[draw.held]) - shown) / electronics.slope(readout, shown))
        return found

    @cached_property
    def best(self) -> tuple[Array, Array, float, float]:
        """(values, standard errors, rms before, rms after) of offset, curve and series, which is not negative."""
        values, free = np.zeros(3), np.ones(3, dtype=bool)
        errors = np.full(3, np.nan)
        missed = first = self.missed(Electronics())
        for _ in range(ROUNDS):
            columns = [self.missed(Electronics(*(values + step))) for step in np.diag(STEPS)]
            slopes = [
                np.stack([(one - here) / step for one, step in zip(moved, STEPS, strict=True)], axis=1)
                for here, *moved in zip(missed, *columns, strict=True)
            ]
            step, now = _step(slopes, missed, [draw.frame for draw in self.draws], free)
            errors = np.where(np.isnan(now), errors, now)
            if values[2] + step[2] < 0:
                free, values[2] = np.array([True, True, False]), 0.0
                step, _ = _step(slopes, missed, [draw.frame for draw in self.draws], free)
            trial = self.missed(Electronics(*(values + step)))
            if not _rms(trial) < _rms(missed):
                break
            values, missed = values + step, trial
        return values, errors, _rms(first), _rms(missed)


def _step(slopes: list[Array], missed: list[Array], frames: list[int], free: Array) -> tuple[Array, Array]:
    """(Gauss and Newton's step, standard errors) of e + A·p = 0, with frames as clusters."""
    matrix, errors = np.concatenate(slopes)[:, free], np.concatenate(missed)
    inverse = np.linalg.pinv(matrix.T @ matrix)
    step, deviation = np.zeros(len(free)), np.full(len(free), np.nan)
    step[free] = -inverse @ (matrix.T @ errors)
    left = [own + slope[:, free] @ step[free] for own, slope in zip(missed, slopes, strict=True)]
    scores = {frame: np.zeros(int(free.sum())) for frame in frames}
    for frame, slope, own in zip(frames, slopes, left, strict=True):
        scores[frame] = scores[frame] + slope[:, free].T @ own
    if (count := len(scores)) > int(free.sum()):
        spread = sum(np.outer(score, score) for score in scores.values()) * count / (count - int(free.sum()))
        deviation[free] = np.sqrt(np.diag(inverse @ spread @ inverse))
    return step, deviation


def _rms(missed: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(missed)) ** 2)))


def _noise(recording: Recording) -> tuple[float, float]:
    """(LSB, its standard error): the scatter between successive frames, which motion only makes larger."""
    scene, readings = recording.scene, recording.readings()
    codes = np.where(readings.plain, visible(scene, np.where(readings.plain, recording.recorded, 1.0)), np.nan)
    ones = np.ones(codes[:2].shape)
    pairs = [pair_scale(codes[number : number + 2], ones) for number in range(len(codes) - 1)]
    known = np.array([one for one in pairs if np.isfinite(one)])
    if not len(known):
        return float("nan"), float("nan")
    quiet = np.sort(known)[: max(1, len(known) // 4)]
    return float(np.median(quiet)), float(1.25 * quiet.std(ddof=1) / np.sqrt(len(quiet))) if len(quiet) > 1 else np.nan


def learned_of(recording: Recording, case: Case, share: float, draws: int, seed: int) -> list[Learned] | str:
    """Every quantity of a case, or why nothing can be learned."""
    if not isinstance(recording.scene.readout, TwoPointReadout):
        return "only of a two-point readout with a converter"
    if (reason := unpredictable(case.estimator, recording.scene)) is not None:
        return reason
    prediction = Prediction.of(recording, case, share, draws, seed)
    if not prediction.draws:
        return "too little was read of every frame"
    try:
        values, errors, before, after = prediction.best
    except BROKEN:
        return "arithmetic broke down over its readings"
    frames = len({draw.frame for draw in prediction.draws})
    names = ("converter's offset", "LSB"), ("converter's curve, at half scale", "LSB"), ("series", "of the reference")
    rows = [
        Learned(case.recording, name, float(value), float(error), unit, frames, before, after)
        for (name, unit), value, error in zip(names, values, errors, strict=True)
    ]
    noise, error = _noise(recording)
    return [
        *rows,
        Learned(case.recording, "noise, at most", noise, error, "LSB", len(recording.recorded), before, after),
    ]


COLUMNS = ("recording", "quantity", "value", "error", "unit", "frames", "before", "after")
SCREEN = {
    "recording": lambda row: row.recording,
    "quantity": lambda row: row.quantity,
    "learned": lambda row: study.text_of(row.value),
    "± sd": lambda row: study.text_of(row.error, ".2g"),
    "unit": lambda row: row.unit,
    "frames": lambda row: study.text_of(row.frames, "d"),
    "missed by [LSB]": lambda row: f"{study.text_of(row.before, '.1f')} → {study.text_of(row.after, '.1f')}",
}
RATIOS = "resistances are ratios to the reference resistor: no reading shows its value"


def learned_study(share: float, draws: int = 5, seed: int = 0) -> study.Study[Run, study.Cases[Learned]]:
    """The study that learns electronics from a share of each frame's readings, withheld."""

    def found(case: Case) -> list[Learned] | str:
        return learned_of(Recording.load(case.path), case, share, draws, seed)

    return study.Study(
        "learned",
        "cases",
        "insole.yaml",
        read_run,
        lambda run, on_step: study.of_cases(found, run, on_step, "learn from"),
        COLUMNS,
        lambda found: found.found,
        lambda found: [("", study.screen_table(found.found, SCREEN))],
        remarks=lambda found: [RATIOS],
        left_out=lambda found: found.left_out,
    )
