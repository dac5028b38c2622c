"""Error bars of frames that were estimated together: from the inverse of the joint cost's second derivatives.

What frames tell of that which all readings share rests on cells that stand still. Cells that move a little and are
taken for still pull at it, so that only a share of it is believed.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.smoothing.joint import NO_DUAL, Joint
from lampest.panel.panel import Array
from lampest.panel.systematic import Shared
from lampest.posterior.certainty import Certainty
from lampest.posterior.chain import Chain
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.posterior.track import Bars, Change

# Squared errors of channels and reference were 0.6 to 1.8 times what the joint cost says on simulated lampreys, and up
# to nine times in the direction that matters to a mouth whose inside is nearly open. Of 22 recordings of mouths (seeds
# 31001 to 41050 of tests.studies.limit) a quarter left 44 % of the changed cells of one held, a tenth two thirds; the
# median bar is 2 % wider.
BELIEVED = 0.1


@dataclass(frozen=True, eq=False)
class TiedModel(LinearModel):
    """A frame's misfit whose cells are tied to other frames; slope : ∂Φ/∂u of all of it, (cells)."""

    slope: Array

    @cached_property
    def gradient(self) -> Array:
        """∂Φ/∂u."""
        return self.slope


@dataclass(frozen=True, eq=False)
class TiedErrors:
    """One frame's errors. covariance : (cells, cells) of log r. rows : √ω ∂x/∂u of its data. tie : (cells), Σ λ."""

    model: TiedModel
    covariance: Array
    rows: Array
    tie: Array

    @property
    def variance(self) -> Array:
        """Of log r of the free cells."""
        return np.asarray(np.diag(self.covariance)[self.model.free])

    @property
    def resolution(self) -> Array:
        """The diagonal of the averaging kernel, as far as the frame's readings make it up."""
        followed = np.einsum("ij,ri,rj->i", self.covariance, self.rows, self.rows, optimize=True)
        return np.asarray(followed[self.model.free])

    @property
    def data_share(self) -> Array:
        """The row sums of the averaging kernel: ties compare frames, and draw no cell anywhere."""
        return np.ones(len(self.model.free))

    def released(self, cells: NDArray[np.intp]) -> Array:
        """Variance of cells that stand at a bound, if each alone were free; what ties it counts as known."""
        free = self.model.free
        across = self.rows[:, free].T @ self.rows[:, cells]
        alone = np.sum(self.rows[:, cells] ** 2, axis=0) + self.tie[cells]
        taken = np.einsum("fi,fg,gi->i", across, self.covariance[np.ix_(free, free)], across, optimize=True)
        return np.asarray(1 / np.maximum(alone - taken, IGNORANCE))


def error_bars(
    joint: Joint, resting: int, beyond: Shared | None = None, noise: FrameNoise | None = None
) -> tuple[Certainty, tuple[Bars, ...]]:
    """The baseline's, which is the last of `resting` frames, and those of the frames after it.

    beyond, noise : what all readings share, and those of a frame, of which Φ knows nothing; or None.
    """
    frames, chain = range(resting - 1, len(joint.position)), joint.chain.doubting(BELIEVED, joint.certainty)
    answer = joint.answer(np.concatenate([_of_all(joint, beyond), _of_frames(joint, resting, noise)], axis=2))
    squares = np.sum(answer**2, axis=2).reshape(-1, *joint.at[0].cell_resistance.shape)
    found = (Certainty.of(_errors(joint, chain, frame)).widened(squares[frame]).of_frame(0) for frame in frames)
    baseline, *certainty = (one.by_conductance() for one in found)
    together = chain.since(resting - 1)[1:] + np.sum(answer[resting:] * answer[resting - 1], axis=2)
    changes = [
        Change.between(frame, baseline, shared.reshape(baseline.deviation.shape))
        for frame, shared in zip(certainty, together, strict=True)
    ]
    return baseline, tuple(Bars(*pair) for pair in zip(certainty, changes, strict=True))


def _of_all(joint: Joint, errors: Shared | None) -> Array:
    """(frames, readings, n) of what all readings share; without a column where there is no such error."""
    if errors is None:
        return np.zeros((len(joint.at), joint.position.shape[1], 0))
    return np.stack([errors.columns(at.cell_resistance, at.reading, at.networks) for at in joint.at])


def _of_frames(joint: Joint, resting: int, noise: FrameNoise | None) -> Array:
    """(frames, readings, n) of what the readings of each share; the first are means of some of the unloaded frames."""
    if noise is None:
        return np.zeros((len(joint.at), joint.position.shape[1], 0))
    columns = noise.columns(np.concatenate([at.reading for at in joint.at]), baseline=False)
    columns = columns.reshape(len(joint.at), joint.position.shape[1], -1)
    columns[:resting] *= np.sqrt(resting / noise.unloaded)
    return columns


def _errors(joint: Joint, chain: Chain, frame: int) -> TiedErrors:
    tied = np.pad(joint.stiffness, ((1, 1), (0, 0)))
    model = TiedModel(joint.at[frame], NO_DUAL, 2 * joint.gradient[frame])
    return TiedErrors(model, chain.covariance(frame), joint.sensitivities[frame], tied[frame] + tied[frame + 1])
