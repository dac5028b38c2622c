"""The cost of all frames together, its linear surroundings, and error bars from the inverse of its Hessian.

    Φ(u, w, z, c) = Σ_t misfit(f(u_t) + V_t w_t + U_t z, y_t) + |w|² + |z|² + Σ_t c_t²/τ² + ε |u − a|²
                    + Σ_t,i λ_ti (u_{t+1,i} − u_{t,i} − c_t)²

over u_t = log r of the unloaded panel (t = 0) and of every frame, the errors that readings of one frame share (w, in
standard deviations: gain, ripple), the errors that all readings share (z: reference, channels, contacts) and the steps
c_t that all cells of a frame have in common. λ is the walk's; a, with hardly any weight, is where cells stay that no
reading sees.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.state import NO_DUAL
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.certainty import Certainty
from lampest.posterior.chain import Chain
from lampest.posterior.dense import positive_inverse
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.posterior.track import Bars, Change

ROUNDING = 1e-11  # of Φ, a sum of some thousand parts
# Share of the frames' information on z that is believed: cells that move a little and are taken for still pull at it,
# too.
BELIEVED = 0.5
HELD_PRECISION = 1e8  # precision of z that is held, in standard deviations before anything is read


@dataclass(frozen=True, eq=False)
class JointData:
    """Data of all frames.

    Attributes
    ----------
    cost, data : tuple of Cost or tuple of Data
        Of every frame alone, the unloaded panel first.
    errors : Shared or None
        Shared by all readings, or None.
    anchor : array
        A (frames, cells).
    drawn : array
        V (frames, readings, n).
    shared : array
        U (frames, readings, n).
    """

    cost: tuple[Cost, ...]
    data: tuple[Data, ...]
    errors: Shared | None
    anchor: Array
    drawn: Array
    shared: Array

    @classmethod
    def alone(
        cls,
        cost: Sequence[Cost],
        data: Sequence[Data],
        errors: Shared | None,
        anchor: Array,
        noise: FrameNoise | None = None,
        resting: int = 0,
    ) -> "JointData":
        """Return the data before anything that all readings share is known.

        noise : shared by the readings of a frame, or None. The first `resting` frames are means of the unloaded ones.
        """
        count, size = len(data), data[0].measured.size
        drawn = np.zeros((count, size, 0))
        if noise is not None:
            drawn = np.stack([noise.columns(frame.measured, baseline=False) for frame in data])
            drawn[:resting] *= np.sqrt(resting / noise.unloaded)
        return cls(tuple(cost), tuple(data), errors, anchor, drawn, np.zeros((count, size, 0)))

    def sharing(self, at: Sequence[Evaluation]) -> "JointData":
        """Return the data with U at modelled readings.

        At measured ones a reference that shrinks the noise would seem to fit.
        """
        return replace(self, shared=_shared(at, self.errors))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of u and w, (frames, cells + n)."""
        limits = zip(*(data.log_bounds for data in self.data), strict=True)
        lower, upper = (np.stack(limit).reshape(len(self.data), -1) for limit in limits)
        more = ((0, 0), (0, self.drawn.shape[2]))
        return np.pad(lower, more, constant_values=-np.inf), np.pad(upper, more, constant_values=np.inf)


@dataclass(frozen=True, eq=False)
class Joint:
    """Φ at a point.

    Attributes
    ----------
    position : array
        (u, w) (frames, cells + n).
    shift : array
        (z, c).
    stiffness : array
        λ (frames − 1, cells).
    held : tuple or None
        ẑ with its precision, where z has been found; Φ holds it there. None: it is free.
    """

    frames: JointData
    position: Array
    shift: Array
    stiffness: Array
    held: tuple[Array, Array] | None = None

    @cached_property
    def at(self) -> tuple[Evaluation, ...]:
        """Misfit of every frame, without shared errors of its readings."""
        frames, evaluations = self.frames, []
        offsets = frames.shared @ self.shift[: self._sharing] + np.einsum("tri,ti->tr", frames.drawn, self.chance)
        for cost, data, position, offset in zip(frames.cost, frames.data, self.log_cells, offsets, strict=True):
            measured = data.measured - offset.reshape(data.measured.shape)
            shifted = replace(data, given=replace(data.given, measured=measured))
            evaluations.append(Evaluation.at(cost, shifted, np.exp(position).reshape(measured.shape)))
        return tuple(evaluations)

    @property
    def cells(self) -> int:
        """The number of cells."""
        return int(self.frames.anchor.shape[1])

    @property
    def log_cells(self) -> Array:
        """u (frames, cells)."""
        return self.position[:, : self.cells]

    @property
    def chance(self) -> Array:
        """w (frames, n)."""
        return self.position[:, self.cells :]

    @property
    def _sharing(self) -> int:
        return int(self.frames.shared.shape[2])

    @property
    def steps(self) -> Array:
        """u_{t+1} − u_t − c_t, (frames − 1, cells)."""
        return np.asarray(np.diff(self.log_cells, axis=0) - self._common[:, None])

    @cached_property
    def value(self) -> float:
        """Φ."""
        stray = np.sum(self._shifted**2 * self.certainty) + IGNORANCE * np.sum(self._strayed**2)
        priors = stray + np.sum(self.chance**2) + np.sum(self.stiffness * self.steps**2)
        return sum(at.objective for at in self.at) + float(priors)

    @property
    def _shifted(self) -> Array:
        """(z, c) less ẑ."""
        return self.shift if self.held is None else np.append(self.shift[: self._sharing] - self.held[0], self._common)

    @property
    def _common(self) -> Array:
        """c."""
        return self.shift[self._sharing :]

    @property
    def _strayed(self) -> Array:
        return np.asarray(self.log_cells - self.frames.anchor)

    @property
    def certainty(self) -> Array:
        """1/variance of z and c before anything is read."""
        known = 1.0 if self.held is None else HELD_PRECISION
        return np.concatenate([np.full(self._sharing, known), np.full(len(self.stiffness), ASSUMED.common_step**-2)])

    @property
    def ties(self) -> Array:
        """Σ λ of each cell in each frame, (frames, cells)."""
        tied = np.pad(self.stiffness, ((1, 1), (0, 0)))
        return np.asarray(tied[1:] + tied[:-1])

    @cached_property
    def gradient(self) -> Array:
        """½ ∂Φ/∂(u, w), (frames, cells + n)."""
        pulls = np.pad(self.stiffness * self.steps, ((1, 1), (0, 0)))
        misfit = np.stack([at.log_gradient(NO_DUAL).ravel() / 2 for at in self.at])
        cells = misfit + pulls[:-1] - pulls[1:] + IGNORANCE * self._strayed
        chance = np.einsum("tri,tr->ti", self.frames.drawn, self._through) + self.chance
        return np.concatenate([cells, chance], axis=1)

    @cached_property
    def _through(self) -> Array:
        """½ ∂misfit/∂f, (frames, readings)."""
        return np.stack([at.partials(NO_DUAL)[1].ravel() / 2 for at in self.at])

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """(frames, cells) where a cell presses against a bound."""
        lower, upper = self.frames.bounds
        return ((self.position <= lower) & (self.gradient > 0)) | ((self.position >= upper) & (self.gradient < 0))

    @property
    def kkt_residual(self) -> Array:
        """(frames) of `Evaluation.projected_gradient`, with the whole gradient."""
        pairs = zip(self.at, 2 * self.gradient[:, : self.cells], strict=True)
        return np.array([at.projected_gradient(slope.reshape(at.cell_resistance.shape)) for at, slope in pairs])

    @cached_property
    def models(self) -> tuple[LinearModel, ...]:
        """Every frame's misfit as a linear model."""
        return tuple(LinearModel(at, NO_DUAL) for at in self.at)

    @cached_property
    def sensitivities(self) -> list[Array]:
        """√ω ∂x/∂(u, w) of every frame's data, (rows, cells + n)."""
        slopes = [model.at.networks[0].sensitivity() for model in self.models]
        return self._weighted([np.concatenate(pair, axis=1) for pair in zip(slopes, self.frames.drawn, strict=True)])

    def _weighted(self, columns: Iterable[Array]) -> list[Array]:
        """√ω ∂x of every frame's changes of readings (readings, n), (rows, n)."""
        parts = zip(self.models, self._sizes, columns, strict=True)
        return [np.asarray(model.through @ own) * size[:, None] for model, size, own in parts]

    @cached_property
    def _sizes(self) -> list[Array]:
        """√ω, ω a loss's curvature; where it has none, the weight of a squared loss with its slope there."""
        loss, x = self.frames.cost[0].terms[0].loss, [model.residual for model in self.models]
        every = np.concatenate(x)
        curvature = loss.curvature(every)
        size = np.sqrt(np.where(curvature > 0, curvature, loss.stiffness(every)))
        return np.split(size, np.cumsum([len(rows) for rows in x])[:-1])

    @cached_property
    def chain(self) -> Chain:
        """Half of the second derivatives of Φ without those of the readings; cells at a bound stay."""
        free, count, sharing, cells = ~self.pressed, len(self.position), self._sharing, self.cells
        prior = np.pad(self.ties + IGNORANCE, ((0, 0), (0, self.frames.drawn.shape[2])), constant_values=1.0)
        own = np.stack([rows.T @ rows for rows in self.sensitivities])
        own *= free[:, :, None] & free[:, None, :]
        across = np.arange(own.shape[1])
        own[:, across, across] = np.where(free, own[:, across, across] + prior, 1.0)
        border, corner = np.zeros((*self.position.shape, len(self.shift))), np.diag(self.certainty)
        border[:, :, :sharing], corner[:sharing, :sharing] = self._bordered(self.frames.shared)
        corner[:sharing, :sharing] += np.diag(self.certainty[:sharing])
        step = np.arange(count - 1)
        border[step, :cells, sharing + step] = self.stiffness
        border[step + 1, :cells, sharing + step] = -self.stiffness
        corner[sharing + step, sharing + step] += self.stiffness.sum(axis=1)
        tie = np.zeros((count - 1, own.shape[1]))
        tie[:, :cells] = self.stiffness * (free[1:] & free[:-1])[:, :cells]
        return Chain(own, tie, border * free[:, :, None], corner)

    def _bordered(self, columns: Array) -> tuple[Array, Array]:
        """Return the covariances of errors of readings with (u, w) and with z.

        The errors are (frames, readings, m), those of (u, w) (frames, cells + n, m).
        """
        moved = self._weighted(columns)
        border, corner = (
            np.stack([rows.T @ own for rows, own in zip(unknowns, moved, strict=True)])
            for unknowns in (self.sensitivities, self._weighted(self.frames.shared))
        )
        return border, corner.sum(axis=0)

    def answer(self, columns: Array) -> Array:
        """Return the effect on u (frames, cells, n) of errors of readings (frames, readings, n) beyond Φ."""
        right, corner = self._bordered(columns)
        steps = np.zeros((len(self.stiffness), columns.shape[2]))
        return self.chain.solve(right * ~self.pressed[:, :, None], np.concatenate([corner, steps]))[0][:, : self.cells]

    @property
    def shared(self) -> tuple[Array, Array]:
        """(z, how precisely the frames determine it): (n), and (n, n) without its prior."""
        learned = self.chain.learned(self._sharing) if self.held is None else self.held[1] - np.eye(self._sharing)
        return self.shift[: self._sharing], learned

    def expected_squares(self) -> Array:
        """Return E x² of the steps, (frames − 1, cells)."""
        less = np.zeros((len(self.stiffness), len(self.shift)))
        less[:, self._sharing :] = np.eye(len(self.stiffness))
        return np.asarray(self.steps**2 + self.chain.step_variance(less)[:, : self.cells])

    def newton(self) -> tuple[Array, Array]:
        """Return the Newton step of (u, w) (frames, cells + n), and of z and c."""
        shared = np.einsum("tri,tr->i", self.frames.shared, self._through)
        slope = np.concatenate([shared, -np.sum(self.stiffness * self.steps, axis=1)]) + self._shifted * self.certainty
        cells, shift = self.chain.solve(-np.where(self.pressed, 0.0, self.gradient)[..., None], -slope[:, None])
        return cells[..., 0], shift[:, 0]

    def agreeing(self, others: Array) -> "Joint":
        """Return the problem with less belief in what cells near loads say of z, as far as all others contradict it.

        They move by little with the load, and are taken for still. Where they agree, |ẑ − ẑ'|² is tr(C' − C) in the
        mean (Hausman, Econometrica 46, 1978), ẑ' and C' without them. Where it is ρ times that, the share of what they
        say that is believed is (ρ exp(1 − ρ))^(n/2), n = (tr D)²/tr D², D = C' − C: Chernoff's bound of P(χ²_n > n ρ).
        others : λ where these cells are free.
        """
        count, alone = self._sharing, replace(self, stiffness=others)
        covariance, without = (first.chain.border_covariance[:count, :count] for first in (self, alone))
        shift, shift_alone = (self.shift[:count] + first.newton()[1][:count] for first in (self, alone))
        expected, apart = float(np.trace(without - covariance)), float(np.sum((shift_alone - shift) ** 2))
        if apart <= expected:
            return self
        precision, less = (positive_inverse(first) for first in (covariance, without))
        ratio, between = apart / expected, without - covariance
        share = (ratio * np.exp(1 - ratio)) ** (expected**2 / np.sum(between**2) / 2)
        believed, pull = (
            share * first + (1 - share) * second
            for first, second in ((precision, less), (precision @ shift, less @ shift_alone))
        )
        return replace(self, held=(np.linalg.solve(believed, pull), believed))

    @property
    def uncertain(self) -> Chain:
        """The chain from which error bars follow: with the believed share of the frames' information on z and c."""
        free = replace(self, held=None)
        chain = free.chain.doubting(BELIEVED, free.certainty)
        return chain if self.held is None else chain.with_border(np.eye(self._sharing) + BELIEVED * self.shared[1])

    def stepped(self) -> "Joint":
        """Return the point after a Newton step, halved until Φ is no larger; this one where no halving helps."""
        step, shift = self.newton()
        size = 1.0
        while size > np.sqrt(np.finfo(float).eps):
            position = np.clip(self.position + size * np.where(self.pressed, 0.0, step), *self.frames.bounds)
            trial = replace(self, position=position, shift=self.shift + size * shift)
            if trial.value <= self.value + ROUNDING * abs(self.value):
                return trial
            size /= 2
        return self


@dataclass(frozen=True, eq=False)
class TiedModel(LinearModel):
    """A frame's misfit whose cells are tied to other frames; slope : ∂Φ/∂u of all of it, (cells)."""

    slope: Array

    @cached_property
    def gradient(self) -> Array:
        """∂Φ/∂u."""
        return self.slope


def _certainty(joint: Joint, chain: Chain, frame: int) -> Certainty:
    """Return the certainty of one frame. Its readings alone are the resolution.

    Ties compare frames and draw no cell.
    """
    cells = slice(joint.cells)
    model = TiedModel(joint.at[frame], NO_DUAL, 2 * joint.gradient[frame, cells])
    whole, rows = chain.covariance(frame), joint.sensitivities[frame][:, cells]
    covariance, free, tie = whole[cells, cells], model.free, joint.ties[frame]

    def released(cells: NDArray[np.intp]) -> Array:
        """Variance of cells that stand at a bound, if each alone were free; ties count as known."""
        across = rows[:, free].T @ rows[:, cells]
        alone = np.sum(rows[:, cells] ** 2, axis=0) + tie[cells]
        taken = np.einsum("fi,fg,gi->i", across, covariance[np.ix_(free, free)], across, optimize=True)
        return np.asarray(1 / np.maximum(alone - taken, IGNORANCE))

    followed = np.einsum("ij,ri,rj->i", covariance, rows, rows, optimize=True)
    shares, variance = (followed[free], np.ones(len(free))), np.diag(covariance)
    across = whole[cells, joint.cells :]
    together = np.sum(across @ np.linalg.inv(whole[joint.cells :, joint.cells :]) * across, axis=1)
    shared = np.minimum(chain.shared_variance(frame)[cells] + together, variance)
    return Certainty.of(model, (variance[free], shared[free]), shares, released)


def error_bars(joint: Joint, resting: int, beyond: Shared | None = None) -> tuple[Certainty, tuple[Bars, ...]]:
    """Return the baseline's, which is the last of `resting` frames, and those of the frames after it.

    beyond : errors that all readings share and Φ does not contain; or None.
    """
    answer = joint.answer(_shared(joint.at, beyond))
    chain = joint.uncertain
    numbers = range(resting - 1, len(joint.position))
    certainties = (_certainty(joint, chain, t).widened(answer[t]).of_frame(0) for t in numbers)
    baseline, *certainty = (certainty_.by_conductance() for certainty_ in certainties)
    together = chain.since(resting - 1)[1:, : joint.cells] + np.sum(answer[resting:] * answer[resting - 1], axis=2)
    together = together.reshape(-1, *baseline.deviation.shape)
    pairs = zip(certainty, together, strict=True)
    return baseline, tuple(Bars(frame, Change.between(frame, baseline, shared)) for frame, shared in pairs)


def _shared(at: Sequence[Evaluation], errors: Shared | None) -> Array:
    """(frames, readings, n) of errors that all readings share; without a column where there is none."""
    if errors is None:
        return np.zeros((len(at), at[0].reading.size, 0))
    return np.stack([errors.columns(evaluation.networks[0], evaluation.reading[0]) for evaluation in at])
