"""The cost of all frames together, its linear surroundings, and error bars from the inverse of its Hessian.

    Φ(u, z, c) = Σ_t misfit(f(u_t) + U_t z, y_t) + |z|² + Σ_t c_t²/τ² + ε |u − a|²
                 + Σ_t,i λ_ti (u_{t+1,i} − u_{t,i} − c_t)²

over u_t = log r of the unloaded panel (t = 0) and of every frame, what all readings share (z, in standard deviations:
reference, channels, contacts) and the steps c_t that all cells of a frame have in common. λ is the walk's; a, with
hardly any weight, is where cells stay that no reading sees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.state import NO_DUAL
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.certainty import Certainty
from lampest.posterior.chain import Chain
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.posterior.track import Bars, Change

COMMON = 0.1  # τ, of log r: temperature and supply move all cells by some percent from frame to frame, not by more
ROUNDING = 1e-11  # of Φ, a sum of some thousand parts
# Share of what frames say of z that is believed: cells that move a little and are taken for still pull at it, too.
BELIEVED = 0.1


@dataclass(frozen=True, eq=False)
class JointData:
    """cost, data : of every frame alone, the unloaded panel first. errors : what all readings share, or None.

    shared : U (frames, readings, n), what that does to readings. anchor : a (frames, cells).
    """

    cost: tuple[Cost, ...]
    data: tuple[Data, ...]
    errors: Shared | None
    anchor: Array
    shared: Array

    @classmethod
    def alone(cls, cost: Sequence[Cost], data: Sequence[Data], errors: Shared | None, anchor: Array) -> "JointData":
        """Before anything that is shared is known."""
        return cls(tuple(cost), tuple(data), errors, anchor, np.zeros((len(data), data[0].measured.size, 0)))

    def sharing(self, at: Sequence[Evaluation]) -> "JointData":
        """With U at modelled readings: at measured ones a reference that shrinks the noise would seem to fit."""
        return replace(self, shared=_shared(at, self.errors))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Of u, (frames, cells)."""
        lower, upper = zip(*(data.log_bounds for data in self.data), strict=True)
        return np.stack(lower).reshape(len(self.data), -1), np.stack(upper).reshape(len(self.data), -1)


@dataclass(frozen=True, eq=False)
class Joint:
    """Φ at a point. position : u (frames, cells). shift : (z, c) in one. stiffness : λ (frames − 1, cells)."""

    frames: JointData
    position: Array
    shift: Array
    stiffness: Array

    @cached_property
    def at(self) -> tuple[Evaluation, ...]:
        """Every frame's misfit; what is shared is taken off its readings."""
        frames, found = self.frames, []
        offsets = frames.shared @ self.shift[: self._sharing]
        for cost, data, position, offset in zip(frames.cost, frames.data, self.position, offsets, strict=True):
            measured = data.measured - offset.reshape(data.measured.shape)
            shifted = replace(data, given=replace(data.given, measured=measured))
            found.append(Evaluation.at(cost, shifted, np.exp(position).reshape(measured.shape)))
        return tuple(found)

    @property
    def _sharing(self) -> int:
        return int(self.frames.shared.shape[2])

    @property
    def steps(self) -> Array:
        """u_{t+1} − u_t − c_t, (frames − 1, cells)."""
        return np.asarray(np.diff(self.position, axis=0) - self.shift[self._sharing :, None])

    @cached_property
    def value(self) -> float:
        """Φ."""
        misfit = sum(at.objective for at in self.at)
        stray = misfit + float(np.sum(self.shift**2 * self.certainty) + IGNORANCE * np.sum(self._strayed**2))
        return stray + float(np.sum(self.stiffness * self.steps**2))

    @property
    def _strayed(self) -> Array:
        return np.asarray(self.position - self.frames.anchor)

    @property
    def certainty(self) -> Array:
        """1/variance of z and c before anything is read."""
        return np.concatenate([np.ones(self._sharing), np.full(len(self.stiffness), COMMON**-2)])

    @property
    def ties(self) -> Array:
        """Σ λ of each cell in each frame, (frames, cells)."""
        tied = np.pad(self.stiffness, ((1, 1), (0, 0)))
        return np.asarray(tied[1:] + tied[:-1])

    @cached_property
    def gradient(self) -> Array:
        """½ ∂Φ/∂u, (frames, cells)."""
        pulls = np.pad(self.stiffness * self.steps, ((1, 1), (0, 0)))
        misfit = np.stack([at.log_gradient(NO_DUAL).ravel() / 2 for at in self.at])
        return misfit + pulls[:-1] - pulls[1:] + IGNORANCE * self._strayed

    @cached_property
    def pressed(self) -> NDArray[np.bool_]:
        """(frames, cells) where a cell presses against a bound."""
        lower, upper = self.frames.bounds
        return ((self.position <= lower) & (self.gradient > 0)) | ((self.position >= upper) & (self.gradient < 0))

    @property
    def kkt_residual(self) -> Array:
        """(frames) of `Evaluation.projected_gradient`, with the whole gradient."""
        pairs = zip(self.at, 2 * self.gradient, strict=True)
        return np.array([at.projected_gradient(slope.reshape(at.cell_resistance.shape)) for at, slope in pairs])

    @cached_property
    def models(self) -> tuple[LinearModel, ...]:
        """Every frame's misfit as a linear model."""
        return tuple(LinearModel(at, NO_DUAL) for at in self.at)

    @cached_property
    def sensitivities(self) -> list[Array]:
        """√ω ∂x/∂u of every frame's data, (rows, cells)."""
        pairs = zip(self.models, self._sizes, strict=True)
        return [np.asarray(model.through @ model.at.networks[0].sensitivity()) * size[:, None] for model, size in pairs]

    @cached_property
    def _sizes(self) -> list[Array]:
        """√ω, ω a loss's curvature; where it has none, the weight of a squared loss with its slope there."""
        sizes = []
        for model in self.models:
            loss, x = model.at.cost.terms[0].loss, model.residual
            curvature = loss.curvature(x)
            flat = (curvature <= 0) & (x != 0)
            curvature[flat] = loss.steady_pull(x[flat]) / np.abs(x[flat])
            sizes.append(np.sqrt(curvature))
        return sizes

    @cached_property
    def chain(self) -> Chain:
        """Half of Φ's second derivatives, without those of the readings; cells at a bound stay."""
        free, count, sharing = ~self.pressed, len(self.position), self._sharing
        own = np.stack([rows.T @ rows for rows in self.sensitivities])
        own *= free[:, :, None] & free[:, None, :]
        across = np.arange(own.shape[1])
        own[:, across, across] = np.where(free, own[:, across, across] + self.ties + IGNORANCE, 1.0)
        border, corner = np.zeros((*self.position.shape, len(self.shift))), np.diag(self.certainty)
        border[:, :, :sharing], corner[:sharing, :sharing] = self._bordered(self.frames.shared)
        corner[:sharing, :sharing] += np.eye(sharing)
        step = np.arange(count - 1)
        border[step, :, sharing + step] = self.stiffness
        border[step + 1, :, sharing + step] = -self.stiffness
        corner[sharing + step, sharing + step] += self.stiffness.sum(axis=1)
        return Chain(own, self.stiffness * (free[1:] & free[:-1]), border * free[:, :, None], corner)

    def _bordered(self, columns: Array) -> tuple[Array, Array]:
        """What errors of readings (frames, readings, n) have in common with u, (frames, cells, n), and with z."""
        parts = zip(self.models, self._sizes, self.sensitivities, self.frames.shared, columns, strict=True)
        border, corner = [], []
        for model, size, rows, known, own in parts:
            moved = np.asarray(model.through @ own) * size[:, None]
            border.append(rows.T @ moved)
            corner.append((np.asarray(model.through @ known) * size[:, None]).T @ moved)
        return np.stack(border), np.sum(corner, axis=0)

    def answer(self, columns: Array) -> Array:
        """What errors of readings (frames, readings, n) that Φ knows nothing of do to u, (frames, cells, n)."""
        right, corner = self._bordered(columns)
        steps = np.zeros((len(self.stiffness), columns.shape[2]))
        return self.chain.solve(right * ~self.pressed[:, :, None], np.concatenate([corner, steps]))[0]

    def expected_squares(self) -> Array:
        """E x² of the steps, (frames − 1, cells)."""
        less = np.zeros((len(self.stiffness), len(self.shift)))
        less[:, self._sharing :] = np.eye(len(self.stiffness))
        return np.asarray(self.steps**2 + self.chain.step_variance(less))

    def newton(self) -> tuple[Array, Array]:
        """The Newton step of the cells (frames, cells), and of z and c."""
        through = np.stack([at.partials(NO_DUAL)[1].ravel() / 2 for at in self.at])
        shared = np.einsum("tri,tr->i", self.frames.shared, through)
        slope = np.concatenate([shared, -np.sum(self.stiffness * self.steps, axis=1)]) + self.shift * self.certainty
        cells, shift = self.chain.solve(-np.where(self.pressed, 0.0, self.gradient)[..., None], -slope[:, None])
        return cells[..., 0], shift[:, 0]

    def stepped(self) -> "Joint":
        """After a Newton step, halved until Φ is no larger; as it is where no halving helps."""
        step, shift = self.newton()
        size = 1.0
        while size > np.sqrt(np.finfo(float).eps):
            there = np.clip(self.position + size * np.where(self.pressed, 0.0, step), *self.frames.bounds)
            trial = replace(self, position=there, shift=self.shift + size * shift)
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
    """Of one frame alone: its readings make up the resolution, and ties compare frames but draw no cell anywhere."""
    model = TiedModel(joint.at[frame], NO_DUAL, 2 * joint.gradient[frame])
    covariance, rows, free, tie = chain.covariance(frame), joint.sensitivities[frame], model.free, joint.ties[frame]

    def released(cells: NDArray[np.intp]) -> Array:
        """Variance of cells that stand at a bound, if each alone were free; what ties it counts as known."""
        across = rows[:, free].T @ rows[:, cells]
        alone = np.sum(rows[:, cells] ** 2, axis=0) + tie[cells]
        taken = np.einsum("fi,fg,gi->i", across, covariance[np.ix_(free, free)], across, optimize=True)
        return np.asarray(1 / np.maximum(alone - taken, IGNORANCE))

    followed = np.einsum("ij,ri,rj->i", covariance, rows, rows, optimize=True)
    shares, shared = (followed[free], np.ones(len(free))), chain.shared_variance(frame)[free]
    return Certainty.of(model, (np.diag(covariance)[free], shared), shares, released)


def error_bars(
    joint: Joint, resting: int, beyond: Shared | None = None, noise: FrameNoise | None = None
) -> tuple[Certainty, tuple[Bars, ...]]:
    """The baseline's, which is the last of `resting` frames, and those of the frames after it.

    beyond, noise : what all readings share, and those of a frame, of which Φ knows nothing; or None.
    """
    count, cells = joint.position.shape
    drawn: Array = np.zeros((count, cells, 0))
    if noise is not None:  # the first frames are means of some of the unloaded ones
        readings = np.concatenate([at.reading for at in joint.at])
        drawn = noise.columns(readings, baseline=False).reshape(count, cells, -1)
        drawn[:resting] *= np.sqrt(resting / noise.unloaded)
    answer = joint.answer(np.concatenate([drawn, _shared(joint.at, beyond)], axis=2))
    chain, own = joint.chain.doubting(BELIEVED, joint.certainty), 0 if beyond is None else beyond.own(cells)
    found = (_certainty(joint, chain, t).widened(answer[t], own).of_frame(0) for t in range(resting - 1, count))
    baseline, *certainty = (one.by_conductance() for one in found)
    together = chain.since(resting - 1)[1:] + np.sum(answer[resting:] * answer[resting - 1], axis=2)
    together = together.reshape(-1, *baseline.deviation.shape)
    pairs = zip(certainty, together, strict=True)
    return baseline, tuple(Bars(frame, Change.between(frame, baseline, shared)) for frame, shared in pairs)


def _shared(at: Sequence[Evaluation], errors: Shared | None) -> Array:
    """(frames, readings, n) of what all readings share; without a column where there is no such error."""
    if errors is None:
        return np.zeros((len(at), at[0].reading.size, 0))
    return np.stack([errors.columns(one.networks[0], one.reading[0]) for one in at])
