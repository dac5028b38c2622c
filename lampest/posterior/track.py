"""Error bars along a sequence of frames: of every frame, and of its change from the baseline."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.files.levels import TWO_SIDED
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.certainty import Certainty, LogInterval, common_variance, own_part
from lampest.posterior.covariance import DenseErrors, Memory, SampledErrors, active_bounds, errors_of
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import LinearModel

MIN_NOISE_SHARE = 1e-4  # least noise relative to the deviation that includes own errors: rounding of the difference


@dataclass(frozen=True, eq=False)
class Change(LogInterval):
    """Certainty of log r − log r_baseline.

    Attributes
    ----------
    common : array or None
        Part of the standard deviation that all cells share; None if it is not known.
    """

    common: Array | None = None

    @property
    def own(self) -> Array:
        """Each cell's own part of the standard deviation; all of it if the common part is not known."""
        return self.deviation if self.common is None else own_part(self.deviation, self.common)

    @classmethod
    def between(cls, frame: Certainty, baseline: Certainty, shared: Array, common: Array | None = None) -> "Change":
        """Return the certainty of the difference of two estimates, √(a² + b² − 2·shared) of deviations and of ends.

        Parameters
        ----------
        frame, baseline : Certainty
            Certainty of log r, (rows, columns).
        shared : array, shape (rows, columns)
            Covariance of the two errors.
        common : array, shape (rows, columns), or None
            Covariance of their common parts; None if it is not known.
        """

        def joined(of_frame: Array, of_baseline: Array, shared: Array) -> Array:
            with np.errstate(invalid="ignore"):
                size: Array = np.sqrt(np.maximum(of_frame**2 + of_baseline**2 - 2 * shared, 0))
            return size

        # The lower end of the difference combines the frame's lower with the baseline's upper end.
        ends = TWO_SIDED**2 * shared
        return cls(
            joined(frame.deviation, baseline.deviation, shared),
            joined(frame.below, baseline.above, ends),
            joined(frame.above, baseline.below, ends),
            None if common is None else joined(frame.common, baseline.common, common),
        )


@dataclass(frozen=True, eq=False)
class Bars:
    """Error bars of one frame, all arrays (rows, columns).

    Attributes
    ----------
    frame : Certainty
        Certainty of log r.
    change : Change or None
        Certainty of the change from the baseline; None if that of the baseline is not known.
    reading : array or None
        Standard deviation of the modelled readings, without noise; None if not computed.
    """

    frame: Certainty
    change: Change | None
    reading: Array | None = None

    def reaching_farther(self, below: Array, above: Array) -> "Bars":
        """Return bars with extended intervals; see `LogInterval.reaching_farther`."""
        change = self.change and self.change.reaching_farther(below, above)
        return replace(self, frame=self.frame.reaching_farther(below, above), change=change)


@dataclass(frozen=True, eq=False)
class Track:
    """State of the error bars along a sequence: the errors of earlier frames that those of later ones depend on.

    Attributes
    ----------
    shared : Shared or None
        Systematic errors that the readings of all frames share.
    baseline : Certainty or None
        Certainty of the baseline.
    deviation : array, shape (rows, columns), or None
        Standard deviation of log r of the last frame without shared errors.
    memory : Memory or None
        Errors of the last frame and of the baseline.
    answers : tuple of array, shape (cells, n), or None
        Effect of shared errors on log r of the last frame, and on that of the baseline.
    noise : FrameNoise or None
        Random errors that the readings of one frame share.
    beyond : tuple of array or None
        Squares of the additional extents of intervals, below and above, due to readings that the baseline lacks.
    """

    shared: Shared | None = None
    baseline: Certainty | None = None
    deviation: Array | None = None
    memory: Memory | None = None
    answers: tuple[Array, Array] | None = None
    noise: FrameNoise | None = None
    beyond: tuple[Array, Array] | None = None

    def resting(self, model: LinearModel, *, remembered: bool) -> "Track":
        """Return the track after a baseline that is solved alone.

        `remembered` states whether later frames compare with it. Raises numpy.linalg.LinAlgError if the cost is flat.
        """
        errors = self._errors(model, None, baseline=True)
        answer, certainty = self._answered(errors)
        memory, deviation = errors.memory().resting() if remembered else None, errors.certainty.deviation[0]
        return Track(self.shared, certainty.of_frame(0), deviation, memory, (answer, answer), self.noise)

    def advanced(self, model: LinearModel) -> tuple["Track", Bars]:
        """Return the track and the bars after a frame, or after baseline and first frame that are solved together.

        Raises numpy.linalg.LinAlgError if the cost is flat.
        """
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
        """Return the track and the bars after a frame.

        Parameters
        ----------
        frame : Certainty
            Certainty of log r with shared errors, (rows, columns).
        deviation : array, shape (rows, columns)
            Standard deviation of log r without shared errors.
        answer : array, shape (cells, n)
            Effect of the shared errors on log r.
        memory : Memory or None
            Errors of the frame and of the baseline, if later frames need them.
        """
        resting = answer if self.answers is None else self.answers[1]
        track = replace(self, deviation=deviation, memory=memory, answers=(answer, resting))
        if self.baseline is None:
            return track, Bars(frame, None)
        shape = frame.deviation.shape
        # Common parts: cov(a, b) = (var a + var b − var(a − b))/2. Whole errors: Σ a·b plus the covariance in memory.
        common = (common_variance(answer) + common_variance(resting) - common_variance(answer - resting)) / 2
        together = np.sum(answer * resting, axis=1) + (0.0 if memory is None else memory.shared())
        change = Change.between(frame, self.baseline, together.reshape(shape), common.reshape(shape))
        return track, Bars(frame, change)

    def noise_alone(self, deviation: Array, measured: Array) -> Array:
        """Return the readings' standard deviations without each reading's own systematic error, if they include it."""
        if self.shared is None or not self.shared.in_sigma:
            return deviation
        # σ² without the systematic part, which enters through the shared errors
        noise = deviation**2 - self.shared.own_error(measured) ** 2
        return np.asarray(np.sqrt(np.maximum(noise, (MIN_NOISE_SHARE * deviation) ** 2)))

    def _errors(self, model: LinearModel, memory: Memory | None, *, baseline: bool) -> DenseErrors:
        """Return the errors of an estimate, with V and with each reading's own systematic error.

        `baseline` states whether the first frame is the mean of the unloaded ones.
        """
        terms, measured, drawn = model.at.cost.terms, model.at.data.measured, None
        if self.shared is not None:
            model = replace(model, deviation=self.noise_alone(model.at.data.deviation, measured))
            # Own errors matter for s² unless there is no penalty, or the penalties compare frames that share them.
            if not all(term.reads_measurement or term.needs_previous for term in terms):
                model = replace(model, own_error=self.shared.own_error(measured))
        if self.noise is not None:
            drawn = np.asarray(model.through @ self.noise.columns(measured, baseline=baseline))
        return errors_of(model, memory, drawn)

    def _answered(self, errors: DenseErrors) -> tuple[Array, Certainty]:
        """Return the effect of shared errors on log r, (frames · cells, n), and the certainty including them."""
        model, own = errors.model, errors.certainty
        cells = model.at.cell_resistance
        if self.shared is None:
            return np.zeros((cells.size, 0)), own
        # U of every frame, and its effect on log r; cells at bounds are treated one by one.
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
        read = model.at_lower & (model.at.data.lower.ravel() == measured)  # r ≥ R: the bound has its reading's error
        answer[read] = columns[read] / measured[read, None]
        return answer, own.widened(answer)
