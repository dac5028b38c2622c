"""Error bars along a sequence: of every frame, and of its change against the baseline."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.files.levels import TWO_SIDED
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.panel.trust_region import MAX_DENSE
from lampest.posterior.certainty import Certainty, LogInterval, common_variance, own_part
from lampest.posterior.dense import DenseErrors, Memory, active_bounds
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SampledErrors, SampledMemory

MIN_NOISE_SHARE = 1e-4  # of a deviation with each reading's own error: rounding of their difference


@dataclass(frozen=True, eq=False)
class Change(LogInterval):
    """Certainty of log r − log r_baseline. common : the part of the deviation that cells share; None: not known."""

    common: Array | None = None

    @property
    def own(self) -> Array:
        """√(deviation² − common²): each cell's own part; all of it where the common one is not known."""
        return self.deviation if self.common is None else own_part(self.deviation, self.common)

    @classmethod
    def between(cls, frame: Certainty, baseline: Certainty, shared: Array, common: Array | None = None) -> "Change":
        """√(a² + b² − 2·shared), ends apart.

        Parameters
        ----------
        shared : array
            Covariance of the two errors, (rows, columns).
        common : array or None
            Covariance of what cells share of them; None: not known.
        """

        def joined(of_frame: Array, of_baseline: Array, shared: Array) -> Array:
            with np.errstate(invalid="ignore"):
                size: Array = np.sqrt(np.maximum(of_frame**2 + of_baseline**2 - 2 * shared, 0))
            return size

        ends = TWO_SIDED**2 * shared
        return cls(
            joined(frame.deviation, baseline.deviation, shared),
            joined(frame.below, baseline.above, ends),
            joined(frame.above, baseline.below, ends),
            None if common is None else joined(frame.common, baseline.common, common),
        )


@dataclass(frozen=True, eq=False)
class Bars:
    """One frame's error bars, all (rows, columns).

    Attributes
    ----------
    change : Change or None
        None where the baseline's are not known.
    reading : array or None
        Standard deviation of the readings of the estimated cells, without their noise; None: not computed.
    """

    frame: Certainty
    change: Change | None
    reading: Array | None = None

    def reaching_farther(self, below: Array, above: Array) -> "Bars":
        """Return bars that reach farther, as `Certainty.reaching_farther`."""
        change = self.change and self.change.reaching_farther(below, above)
        return replace(self, frame=self.frame.reaching_farther(below, above), change=change)


@dataclass(frozen=True, eq=False)
class Track:
    """Errors of earlier frames that error bars of later ones need; None where there are none.

    Attributes
    ----------
    shared : Shared or None
        Errors that all readings have in common.
    baseline : Certainty or None
        Of the baseline.
    deviation : array or None
        Of log r of the last frame without shared errors, (rows, columns).
    memory : Memory or None
        Of the last frame's error.
    answers : tuple or None
        What shared errors did to log r of the last frame and of the baseline, (cells, n) each.
    noise : FrameNoise or None
        What the readings of a frame have in common by chance.
    beyond : tuple or None
        Squares of how far intervals reach on top because of what the baseline left unread.
    """

    shared: Shared | None = None
    baseline: Certainty | None = None
    deviation: Array | None = None
    memory: Memory | None = None
    answers: tuple[Array, Array] | None = None
    noise: FrameNoise | None = None
    beyond: tuple[Array, Array] | None = None

    def resting(self, model: LinearModel, *, remembered: bool) -> "Track":
        """Return the track after a baseline alone; remembered : whether later frames use it.

        Raises LinAlgError if flat.
        """
        errors = self._errors(model, None, baseline=True)
        answer, certainty = self._answered(errors)
        memory, deviation = errors.memory().resting() if remembered else None, errors.certainty.deviation[0]
        return Track(self.shared, certainty.of_frame(0), deviation, memory, (answer, answer), self.noise)

    def advanced(self, model: LinearModel) -> tuple["Track", Bars]:
        """Return the track after a frame, or after the baseline and the first frame together. Raises as `resting`."""
        joint, size = len(model.at.cell_resistance) == 2, model.at.cell_resistance[0].size
        errors = self._errors(model, self.memory, baseline=joint)
        answer, certainty = self._answered(errors)
        relative = any(term.needs_previous for term in model.at.cost.terms)
        memory = errors.memory() if relative else None
        before = replace(self, baseline=certainty.of_frame(0), answers=(answer[:size],) * 2) if joint else self
        track, bars = before.after(certainty.of_frame(-1), errors.certainty.deviation[-1], answer[-size:], memory)
        return track, replace(bars, reading=errors.reading_deviation()[-1])

    def after(
        self, frame: Certainty, deviation: Array, answer: Array, memory: Memory | None = None
    ) -> tuple["Track", Bars]:
        """Return the track after a frame.

        frame, deviation : its errors with and without shared ones, `answer` in its log r.
        """
        resting = answer if self.answers is None else self.answers[1]
        track = replace(self, deviation=deviation, memory=memory, answers=(answer, resting))
        if self.baseline is None:
            return track, Bars(frame, None)
        shape = frame.deviation.shape
        common = (common_variance(answer) + common_variance(resting) - common_variance(answer - resting)) / 2
        together = np.sum(answer * resting, axis=1) + (0.0 if memory is None else memory.shared())
        change = Change.between(frame, self.baseline, together.reshape(shape), common.reshape(shape))
        return track, Bars(frame, change)

    def noise_alone(self, deviation: Array, measured: Array) -> Array:
        """Return the readings' deviation without each one's own error, where it is part of it."""
        if self.shared is None or not self.shared.in_sigma:
            return deviation
        noise = deviation**2 - self.shared.own_error(measured) ** 2
        return np.asarray(np.sqrt(np.maximum(noise, (MIN_NOISE_SHARE * deviation) ** 2)))

    def _errors(self, model: LinearModel, memory: Memory | None, *, baseline: bool) -> DenseErrors:
        """Return the errors with V and each reading's own.

        baseline : whether the first frame is the unloaded ones' mean.
        """
        terms, measured, drawn = model.at.cost.terms, model.at.data.measured, None
        if self.shared is not None:
            model = replace(model, deviation=self.noise_alone(model.at.data.deviation, measured))
            # Not where nothing is penalised, or frames that share that error are compared.
            if not all(term.reads_measurement or term.needs_previous for term in terms):
                model = replace(model, own_error=self.shared.own_error(measured))
        if self.noise is not None:
            drawn = np.asarray(model.through @ self.noise.columns(measured, baseline=baseline))
        return errors_of(model, memory, drawn)

    def _answered(self, errors: DenseErrors) -> tuple[Array, Certainty]:
        """Return the effect of shared errors on log r, (frames · cells, n), and the certainty with them."""
        model, own = errors.model, errors.certainty
        cells = model.at.cell_resistance
        if self.shared is None:
            return np.zeros((cells.size, 0)), own
        pairs = zip(model.at.networks, model.at.data.measured, strict=True)
        columns = np.concatenate([self.shared.columns(*pair) for pair in pairs])
        last, baseline = self.answers or np.zeros((2, cells[0].size, columns.shape[1]))
        answer, rows = np.zeros((cells.size, columns.shape[1])), np.asarray(model.through @ columns)
        if not isinstance(errors, SampledErrors) and (model.at_lower | model.at_upper).any():
            answer[model.free], held, below, above = active_bounds(errors, rows, last, baseline)
            own = own.reaching(held, below, above)
        else:
            answer[model.free] = errors.answer(rows, last, baseline)
        measured = model.at.data.measured.ravel()
        read = model.at_lower & (model.at.data.lower.ravel() == measured)  # r ≥ R: such a bound is off as its reading
        answer[read] = columns[read] / measured[read, None]
        return answer, own.widened(answer)


def errors_of(model: LinearModel, memory: Memory | None, drawn: Array | None = None) -> DenseErrors:
    """Return the errors of an estimate, as matrices or from samples.

    Parameters
    ----------
    memory : Memory or None
        That of the frame before, or None.
    drawn : array or None
        V.
    """
    if isinstance(memory, SampledMemory) or model.at.cell_resistance.size > MAX_DENSE:
        return SampledErrors(model, memory if isinstance(memory, SampledMemory) else None, drawn)
    return DenseErrors(model, memory, drawn)
