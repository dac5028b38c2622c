"""All frames estimated together: what walks and what jumps, and the cells that follow, in turns.

The estimate u with its covariance P has the least of the free energy

    F(u, z, c, P) = misfits + |z|² + Σ c²/τ² + walk(E x²) + tr A P − log det P,

A the misfits' second derivatives, E x² = x² + var x by P, the walk that of `lampest.estimate.smoothing.walk`: for given
P and E x² a Newton step of `Joint`, for given u the inverse of its matrix and new stiffnesses. The walk begins at
several times the noise and is drawn down as far as still cells allow, so that small jumps are seen after large ones. At
the end the stiffness is kept and u, z, c are led to where Φ is least.
Sources: Opper & Archambeau, Neural Comput. 21, 2009 (F); Blake & Zisserman, Visual Reconstruction, 1987 (q drawn down).
"""

import math
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np

from lampest.estimate.smoothing.joint import Joint, JointData
from lampest.estimate.smoothing.walk import Walk
from lampest.panel.panel import Array
from lampest.posterior.dense import positive_inverse
from lampest.posterior.linear import IGNORANCE
from lampest.solvers.solution import Settings

WIDE = 3.0  # q at the start over the noise: as large jumps as three deviations
MOST_ROUNDS, MOST_LAST, MOST_HALVINGS = 40, 30, 25  # 15 to 40, and 3 to 15, were needed on simulated lampreys
SETTLED = 0.3  # of a standard deviation, by which a round may still move a cell
FROZEN = 12  # rounds after which U stays, so that Φ is one function
UNKNOWN = 1.0  # variance of log r that no reading tells


def smoothed(
    frames: JointData, alone: Array, walk: Walk, settings: Settings, until: float = math.inf
) -> tuple[Joint, int]:
    """(where Φ is least, rounds). alone : log r of every frame alone, (frames, cells).

    walk : its deviation is the least, over the noise of frames alone. until : s on the clock of `time.monotonic`, when
    rounds end. Raises numpy.linalg.LinAlgError where arithmetic breaks down.
    """
    found = _Round.first(frames, lasting(alone), walk)
    while found.number < MOST_ROUNDS and not found.done and monotonic() < until:
        found = found.next()
    return _settled(found.joint, settings, until), found.number


def lasting(alone: Array) -> Array:
    """The median of each frame's cells and of those before and after, but for the first and the last frame.

    A wrong reading so begins as one, not as a jump there and back; what truly lasts a single frame is found all the
    same, because many readings tell it.
    """
    around = np.stack([alone[:-2], alone[1:-1], alone[2:]])
    return np.concatenate([alone[:1], np.median(around, axis=0), alone[-1:]])


@dataclass(frozen=True, eq=False)
class _Round:
    """joint : the point. walk, least : as it is drawn down, and its end. noise : of frames alone. moved : here."""

    joint: Joint
    walk: Walk
    least: float
    noise: float
    number: int = 0
    moved: float = np.inf

    @classmethod
    def first(cls, frames: JointData, start: Array, walk: Walk) -> "_Round":
        """Before the first; walk : as `smoothed` takes it."""
        start = np.clip(start, *frames.bounds)
        steps = len(start) - 1
        joint = Joint(frames, start, np.zeros(steps), np.zeros((steps, start.shape[1])))
        ignorance = IGNORANCE * np.eye(start.shape[1])
        inverses = [positive_inverse(rows.T @ rows + ignorance) for rows in joint.sensitivities]
        variance = np.minimum([np.diag(inverse) for inverse in inverses], UNKNOWN)
        noise = float(np.sqrt(np.median(variance)))
        wide = replace(walk, deviation=WIDE * noise)
        frames = frames.sharing(joint.at)
        shift = np.zeros(frames.shared.shape[2] + steps)
        stiffness = wide.stiffness(joint.steps**2 + variance[1:] + variance[:-1])
        return cls(Joint(frames, start, shift, stiffness), wide, walk.deviation * noise, noise)

    def next(self) -> "_Round":
        """After a Newton step and with the stiffness that follows from it."""
        joint = self.joint.stepped(MOST_HALVINGS)
        if self.number < FROZEN:
            joint = replace(joint, frames=joint.frames.sharing(joint.at))
        moved = np.abs(joint.position - self.joint.position).max(initial=0.0, where=~joint.pressed)
        squares = joint.expected_squares()
        walk, least = self.walk.drawn_down(squares, joint.stiffness, self.least)
        joint = replace(joint, stiffness=walk.stiffness(squares))
        return replace(self, joint=joint, walk=walk, least=least, number=self.number + 1, moved=float(moved))

    @property
    def done(self) -> bool:
        """Whether the walk is drawn down and no cell moves much."""
        return self.walk.deviation == self.least and self.moved <= SETTLED * self.noise


def _settled(joint: Joint, settings: Settings, until: float) -> Joint:
    """Where Φ is least for the stiffness that it has."""
    for _ in range(MOST_LAST):
        if joint.kkt_residual.max() <= settings.tolerance or monotonic() > until:
            break
        after = joint.stepped(MOST_HALVINGS)
        if after is joint:
            break
        joint = after
    return joint
