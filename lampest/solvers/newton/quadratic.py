"""A convex piece, gᵀs + ½ sᵀBs + Σ ρ(x + A s) over l ≤ s ≤ h, and its minimum from inside.

ρ(x) = |x|, or, within a corner κ, x²/2κ and beyond it |x| − κ/2: the largest z x − κz²/2 of all |z| ≤ 1. With these z
and x + A s − κz = p − n it is Newton's method on g + B s + Aᵀz − v + w = 0 and
p·(1 − z) = n·(1 + z) = (s − l)·v = (h − s)·w = μ for ever smaller μ.
Source: Nocedal & Wright, Numerical Optimization, 2006, section 16.6 (Mehrotra's predictor and corrector).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import lapack

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array

MOST_STEPS = 60
BOUNDARY = 0.995  # of the way to where a factor becomes zero
SMALL = 1e-14  # of how far the first point is from the minimum, the last one
BLOCK = 64  # columns that LAPACK takes at once: a third of the time that one by one takes
IDLE = 4  # steps that bring it no nearer: rounding has won
STIFF = 1e4  # of what else holds a cell: a row that is stiffer is kept apart


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """gradient : g and squares : B, of the cells. residual : x, slopes : A and corner : κ, of the rows, times their
    weight. low, high : l < h, of the cells.
    """

    gradient: Array
    squares: Array
    residual: Array
    slopes: Array
    corner: Array
    low: Array
    high: Array

    def value(self, step: Array) -> float:
        """What the piece is at a step."""
        smooth = self.gradient @ step + 0.5 * step @ (self.squares @ step)
        residual = self.residual + self.slopes @ step
        slope = np.clip(residual, -self.corner, self.corner) / np.where(self.corner > 0, self.corner, 1.0)
        dual = np.where(self.corner > 0, slope, np.sign(residual))
        return float(smooth + np.sum(dual * residual - self.corner * dual**2 / 2))

    def least(self) -> tuple[Array, Array]:
        """(s, z) of the minimum, as near as double precision lets it be."""
        state = best = _Central.begun(self)
        last, idle = SMALL * state.short, 0
        for _ in range(MOST_STEPS):
            found = state.moved() if best.short > last and idle < IDLE else None
            if found is None:
                break
            idle = 0 if found.short < best.short else idle + 1
            state, best = found, found if not idle else best
        return best.step, best.dual


@dataclass(frozen=True, eq=False)
class _Central:
    """step : s. dual : z. over, under : p, n > 0. pull, push : v, w > 0, what the bounds exert."""

    piece: ConvexPiece
    step: Array
    dual: Array
    over: Array
    under: Array
    pull: Array
    push: Array

    @classmethod
    def begun(cls, piece: ConvexPiece) -> "_Central":
        """In the middle of everything, with equal products."""
        room = piece.high - piece.low
        step = np.clip(np.zeros_like(room), piece.low + 0.1 * room, piece.high - 0.1 * room)
        residual = piece.residual + piece.slopes @ step
        mean = float(np.abs(residual).mean() + np.abs(piece.gradient * room).mean()) or 1.0
        over, under = np.maximum(residual, 0) + mean, np.maximum(-residual, 0) + mean
        pull, push = mean / (step - piece.low), mean / (piece.high - step)
        return cls(piece, step, np.zeros(len(residual)), over, under, pull, push)

    @property
    def products(self) -> tuple[Array, Array, Array, Array]:
        """What shall all be μ."""
        below, above = self.step - self.piece.low, self.piece.high - self.step
        return self.over * (1 - self.dual), self.under * (1 + self.dual), below * self.pull, above * self.push

    @cached_property
    def mean(self) -> float:
        """μ."""
        return float(np.concatenate(self.products).mean())

    @cached_property
    def missed(self) -> Array:
        """x + A s − κz − p + n."""
        away = self.piece.residual + self.piece.slopes @ self.step - self.piece.corner * self.dual
        return np.asarray(away - self.over + self.under)

    @cached_property
    def left(self) -> Array:
        """g + B s + Aᵀz − v + w."""
        pulled = self.piece.gradient + self.piece.squares @ self.step + self.piece.slopes.T @ self.dual
        return np.asarray(pulled - self.pull + self.push)

    @cached_property
    def short(self) -> float:
        """By how much the piece may still be above its minimum."""
        room = self.piece.high - self.piece.low
        return float(sum(one.sum() for one in self.products) + np.abs(self.missed).sum() + np.abs(self.left) @ room)

    def moved(self) -> "_Central | None":
        """After one step; None where rounding has won."""
        zero = tuple(np.zeros_like(one) for one in self.products)
        try:
            ahead = self._towards(0.0, zero)
            short = self._along(ahead, self._length(ahead))
            centre = self.mean * (max(short.mean, 0.0) / self.mean) ** 3
            change = self._towards(centre, self._second(ahead))
        except (linalg.LinAlgError, ValueError):
            return None
        found = self._along(change, BOUNDARY * self._length(change))
        inside = all(np.all(one > 0) for one in found.products)
        return found if inside and np.isfinite(found.mean) else None

    def _second(self, ahead: tuple[Array, ...]) -> tuple[Array, ...]:
        """Products of changes, which the first derivatives leave out."""
        step, dual, over, under, pull, push = ahead
        return -over * dual, under * dual, step * pull, -step * push

    @cached_property
    def _soft(self) -> Array:
        """How far a row gives way per unit of its dual."""
        return np.asarray(self.piece.corner + self.over / (1 - self.dual) + self.under / (1 + self.dual))

    @cached_property
    def _stiff(self) -> NDArray[np.bool_]:
        """(rows) whose part in the sum B + D + Aᵀ diag(1/soft) A would cost all others their digits."""
        stiffness = np.einsum("ij,ij->i", self.piece.slopes, self.piece.slopes) / self._soft
        return np.asarray(stiffness > STIFF * float(np.median(np.diag(self._held))))

    @cached_property
    def _held(self) -> Array:
        """B + D, D what the bounds hold cells with."""
        held = self.pull / (self.step - self.piece.low) + self.push / (self.piece.high - self.step)
        return np.asarray(self.piece.squares + np.diag(held))

    @cached_property
    def _solve(self) -> Linear:
        """The inverse of [[B + D + Aᵀ diag(1/soft) A of all other rows, Aᵀ], [A, −soft]] of the stiff rows."""
        slopes, soft, stiff = self.piece.slopes, self._soft, self._stiff
        matrix = self._held + slopes[~stiff].T @ (slopes[~stiff] / soft[~stiff, None])
        whole = np.block([[matrix, slopes[stiff].T], [slopes[stiff], -np.diag(soft[stiff])]])
        size = np.sqrt(np.abs(np.diag(whole)))
        factors, pivots, failed = lapack.dsytrf(whole / size[:, None] / size, lower=1, lwork=BLOCK * len(size))
        if failed:
            raise linalg.LinAlgError("singular")
        return lambda right: np.asarray(lapack.dsytrs(factors, pivots, right / size, lower=1)[0] / size)

    def _towards(self, mean: float, second: tuple[Array, ...]) -> tuple[Array, ...]:
        """Changes of (s, z, p, n, v, w) towards products μ."""
        slopes, soft, stiff = self.piece.slopes, self._soft, self._stiff
        below, above = self.step - self.piece.low, self.piece.high - self.step
        goal = [mean - own - more for own, more in zip(self.products, second, strict=True)]
        over, under = goal[0] / (1 - self.dual), goal[1] / (1 + self.dual)
        pull, push = goal[2] / below, goal[3] / above
        missed = self.missed - over + under
        forces = self.left + slopes[~stiff].T @ (missed / soft)[~stiff] - pull + push
        found = -self._solve(np.concatenate([forces, missed[stiff]]))
        step = found[: len(forces)]
        dual = (missed + slopes @ step) / soft
        dual[stiff] = found[len(forces) :]
        over, under = over + self.over / (1 - self.dual) * dual, under - self.under / (1 + self.dual) * dual
        return step, dual, over, under, pull - self.pull / below * step, push + self.push / above * step

    def _length(self, change: tuple[Array, ...]) -> float:
        """How far along a change all factors stay positive, at most one."""
        step, dual, over, under, pull, push = change
        pairs = (
            (self.step - self.piece.low, step), (self.piece.high - self.step, -step), (1 - self.dual, -dual),
            (1 + self.dual, dual), (self.over, over), (self.under, under), (self.pull, pull), (self.push, push),
        )  # fmt: skip
        falls = (float((-room[way < 0] / way[way < 0]).min(initial=1.0)) for room, way in pairs)
        return min(falls)

    def _along(self, change: tuple[Array, ...], length: float) -> "_Central":
        own = (self.step, self.dual, self.over, self.under, self.pull, self.push)
        return _Central(self.piece, *(here + length * way for here, way in zip(own, change, strict=True)))
