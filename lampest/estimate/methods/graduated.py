"""All frames estimated together by graduated non-convexity: what walks, what jumps, the cells that follow.

The estimate u with its covariance P has the least of the free energy

    F(u, z, c, P) = misfits + |z|² + Σ c²/τ² + walk(E x²) + tr A P − log det P,

A the misfits' Hessian, E x² = x² + var x by P of the steps x between frames. For given P and E x² a Newton step of
`Joint`, for given u the inverse of its matrix and new stiffnesses. The walk

    walk = n k Σ_i log(1 + a_i) + Σ x²/LEAP²,   a_i the mean over the n steps of cell i of κ² S/(κ² + S)

has S = K x²/q², the square of a step in units of the walk q, averaged with the steps before and after by K. What a step
costs grows like x²/q² at first, and hardly beyond κ²: a jump costs the same however far it leads, and hardly pulls;
where a cell jumps now it may do so just before and after. What a cell costs grows like the logarithm of that: of one
whose steps are all a little larger than noise each is taken for a step. k is such that a cell whose steps are as large
as the walk is tied by 1/q². The walk begins at several times the noise and is drawn down as far as still cells allow,
so that small jumps are seen after large ones. At the end the stiffness is kept and u, z, c are led to where Φ is least.
Sources: Opper & Archambeau, Neural Comput. 21, 2009 (F); Blake & Zisserman, Visual Reconstruction, 1987 (q drawn down);
Geman & McClure, Bull. Int. Stat. Inst. 52, 1987, and Black & Rangarajan, Int. J. Comput. Vision 19, 1996 (κ); Candès,
Wakin & Boyd, J. Fourier Anal. Appl. 14, 2008 (sums in a logarithm).
"""

import math
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np

from lampest.estimate.methods.joint import Joint, JointData
from lampest.panel.panel import Array
from lampest.posterior.dense import positive_inverse
from lampest.posterior.linear import IGNORANCE
from lampest.solvers.solution import Settings

WIDE = 3.0  # q at the start over the noise: as large jumps as three deviations
MOST_ROUNDS, MOST_LAST, MOST_HALVINGS = 40, 30, 25  # 15 to 40, and 3 to 15, were needed on simulated lampreys
SETTLED = 0.3  # of a standard deviation, by which a round may still move a cell
FROZEN = 12  # rounds after which U stays, so that Φ is one function
UNKNOWN = 1.0  # variance of log r that no reading tells
LEAP = 1.0  # of log r: how far jumps lead; what no reading tells strays no farther
FAST, SLOW = 0.6, 0.8  # from one walk to the next; slowly where the ties make a step's variance, which then must follow
TIED = 0.5  # of q²: the median of squared steps of still cells from where on that is so
FOLLOWED = 1.5  # the same, where ties have followed the walk


@dataclass(frozen=True)
class Walk:
    """deviation : q, of log r from frame to frame. most : κ, so many q a jump costs at most."""

    deviation: float
    most: float

    def cost(self, squares: Array) -> float:
        """Of the expected squares of all steps, (frames − 1, cells)."""
        jumps = len(squares) * self._scale * np.sum(np.log1p(self.unrest(squares)))
        return float(jumps + np.sum(squares) / LEAP**2)

    def stiffness(self, squares: Array) -> Array:
        """∂cost/∂squares, (frames − 1, cells): the λ of Σ λ x² that has the cost's slope here, and nowhere less."""
        slope = averaged(1 / (1 + self._size(squares) / self.most**2) ** 2) / self.deviation**2
        return np.asarray(self._scale * slope / (1 + self.unrest(squares)) + LEAP**-2)

    def unrest(self, squares: Array) -> Array:
        """a, (cells)."""
        size = self._size(squares)
        return np.asarray(np.mean(self.most**2 * size / (self.most**2 + size), axis=0))

    def drawn_down(self, squares: Array, stiffness: Array, least: float) -> tuple["Walk", float]:
        """(the next walk, how far it may go on), never beyond `least`: until still cells step further than it says.

        Still is the half of the cells with the least unrest. stiffness : that the squares were found with. A cell's
        likeliest walk is where λ E x² is 1 in the mean.
        """
        unrest = self.unrest(squares)
        still = unrest <= np.median(unrest)
        if np.mean((stiffness * squares)[:, still]) > 1:
            least = self.deviation
        size = np.median(squares[:, still]) / self.deviation**2
        factor = 1.0 if size > FOLLOWED else SLOW if size > TIED else FAST
        return replace(self, deviation=max(self.deviation * factor, least)), least

    @property
    def _scale(self) -> float:
        """k."""
        return (1 + self.most**2 / (1 + self.most**2)) * (1 + self.most**-2) ** 2

    def _size(self, squares: Array) -> Array:
        """S."""
        return averaged(squares) / self.deviation**2


def averaged(steps: Array) -> Array:
    """K x: a quarter of the step before, a half of the step, a quarter of that after; at either end it is repeated."""
    around = np.concatenate([steps[:1], steps, steps[-1:]])
    return np.asarray(around[:-2] / 4 + around[1:-1] / 2 + around[2:] / 4)


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
