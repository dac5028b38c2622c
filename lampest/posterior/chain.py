"""Block tridiagonal system with a border: frames tied to their neighbours, and shared unknowns.

H has the blocks A_t (cells, cells) of the frames, with the ties already on their diagonals; the
diagonal blocks −Λ_t between the frames t and t + 1; B between frames and border; and C of the
border. Gaussian elimination in both directions solves the system. With S_1 = A_1, S_{t+1} = A_{t+1}
− Λ_t S_t⁻¹ Λ_t and K_t = S_t⁻¹ Λ_t, the diagonal blocks of the inverse are P_t = S_t⁻¹ + K_t
P_{t+1} K_tᵀ.
Source: Rauch, Tung & Striebel, AIAA Journal 3, 1965, in the form of Meurant, SIAM J. Matrix Anal.
Appl. 13, 1992.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.panel.panel import Array
from lampest.posterior.linear import positive_inverse


@dataclass(frozen=True, eq=False)
class Chain:
    """Block tridiagonal matrix with a border.

    All methods raise numpy.linalg.LinAlgError if H is not positive definite.

    Attributes
    ----------
    own : array, shape (frames, cells, cells)
        Blocks A_t.
    tie : array, shape (frames − 1, cells)
        Diagonals of Λ_t.
    border : array, shape (frames, cells, n)
        B.
    corner : array, shape (n, n)
        C.
    """

    own: Array
    tie: Array
    border: Array
    corner: Array

    @cached_property
    def _inverses(self) -> list[Array]:
        """S_t⁻¹ of every frame, (cells, cells)."""
        inverses = [positive_inverse(self.own[0])]
        for block, tie in zip(self.own[1:], self.tie, strict=True):
            inverses.append(positive_inverse(block - tie[:, None] * inverses[-1] * tie))
        return inverses

    @cached_property
    def _gains(self) -> list[Array]:
        """K_t of every frame but the last, (cells, cells)."""
        return [inverse * tie for inverse, tie in zip(self._inverses[:-1], self.tie, strict=True)]

    def _solved(self, right: Array) -> Array:
        """Return H⁻¹ x of columns (frames, cells, n) for a fixed border."""
        # Forward elimination: y_{t+1} = x_{t+1} + K_tᵀ y_t
        ahead = [right[0]]
        for gain, column in zip(self._gains, right[1:], strict=True):
            ahead.append(column + gain.T @ ahead[-1])
        # Back substitution: z_t = S_t⁻¹ y_t + K_t z_{t+1}
        solved = [self._inverses[-1] @ ahead[-1]]
        for frame in range(len(right) - 2, -1, -1):
            solved.append(self._inverses[frame] @ ahead[frame] + self._gains[frame] @ solved[-1])
        return np.stack(solved[::-1])

    @cached_property
    def _follow(self) -> Array:
        """Response E = H⁻¹ B of the frames alone to the border, (frames, cells, n)."""
        return self._solved(self.border)

    @cached_property
    def _border_precision(self) -> Array:
        """Schur complement C − Bᵀ H⁻¹ B of the border, (n, n)."""
        return np.asarray(
            self.corner - np.einsum("tci,tcj->ij", self.border, self._follow, optimize=True)
        )

    @cached_property
    def border_covariance(self) -> Array:
        """Block of the border in H⁻¹, (n, n)."""
        return positive_inverse(self._border_precision)

    def learned(self, count: int) -> Array:
        """Return the precision that the frames give the border's first unknowns, (count, count).

        The prior variance of these unknowns is one, and their prior precision is subtracted.
        """
        return positive_inverse(self.border_covariance[:count, :count]) - np.eye(count)

    def doubting(self, share: float, prior: Array) -> "Chain":
        """Return the chain with only a share of the frames' information on the border.

        `prior` is the prior precision of the border, (n,).
        """
        learned = self._border_precision - np.diag(prior)
        return replace(self, corner=self.corner - (1 - share) * learned)

    def with_border(self, precision: Array) -> "Chain":
        """Return the chain whose border's first k unknowns have a given precision, (k, k).

        The precision is that after all other border unknowns are eliminated.
        """
        corner = self.corner.copy()
        count = len(precision)
        corner[:count, :count] += precision - positive_inverse(
            self.border_covariance[:count, :count]
        )
        return replace(self, corner=corner)

    def solve(self, right: Array, border: Array) -> tuple[Array, Array]:
        """Return H⁻¹ x.

        Parameters
        ----------
        right : array, shape (frames, cells, m)
            Part of x for the frames.
        border : array, shape (n, m)
            Part of x for the border.

        Returns
        -------
        of_frames : array, shape (frames, cells, m)
        of_border : array, shape (n, m)
        """
        unbordered = self._solved(right)
        moved = self.border_covariance @ (
            border - np.einsum("tci,tcm->im", self.border, unbordered, optimize=True)
        )
        return unbordered - self._follow @ moved, moved

    @cached_property
    def blocks(self) -> list[Array]:
        """Diagonal blocks P_t of H⁻¹ of the frames for a known border, (cells, cells) each."""
        blocks = [self._inverses[-1]]
        for inverse, gain in zip(self._inverses[-2::-1], self._gains[::-1], strict=True):
            blocks.append(inverse + gain @ blocks[-1] @ gain.T)
        return blocks[::-1]

    @cached_property
    def _root(self) -> Array:
        """E times a square root of the border's covariance, (frames, cells, n)."""
        return self._follow @ np.linalg.cholesky(self.border_covariance)

    def shared_variance(self, frame: int) -> Array:
        """Return the border's part of one frame's diagonal of H⁻¹, (cells,)."""
        return np.asarray(np.sum(self._root[frame] ** 2, axis=1))

    @cached_property
    def variance(self) -> Array:
        """Diagonal of H⁻¹ over the frames, (frames, cells)."""
        return np.asarray(
            np.stack([np.diag(block) for block in self.blocks]) + np.sum(self._root**2, axis=2)
        )

    def step_variance(self, shift: Array) -> Array:
        """Return the variance of x_{t+1} − x_t − shift_t·border, (frames − 1, cells).

        `shift` has shape (frames − 1, n).
        """
        # Covariance of neighbouring frames: diag(K_t P_{t+1})
        between = [
            np.einsum("ij,ji->i", gain, block)
            for gain, block in zip(self._gains, self.blocks[1:], strict=True)
        ]
        variances = np.stack([np.diag(block) for block in self.blocks])
        steps = variances[1:] + variances[:-1] - 2 * np.asarray(between).reshape(self.tie.shape)
        moved = np.diff(self._follow, axis=0) + shift[:, None, :]
        return np.asarray(
            steps + np.einsum("tci,ij,tcj->tc", moved, self.border_covariance, moved, optimize=True)
        )

    def covariance(self, frame: int) -> Array:
        """Return one frame's diagonal block of H⁻¹, (cells, cells)."""
        return np.asarray(self.blocks[frame] + self._root[frame] @ self._root[frame].T)

    def since(self, first: int) -> Array:
        """Return the covariance of a frame with itself and all later ones, cell by cell.

        The shape is (frames − first, cells).
        """
        across = np.eye(self.own.shape[1])
        covariances = [np.diag(self.blocks[first])]
        for gain, block in zip(self._gains[first:], self.blocks[first + 1 :], strict=True):
            # cov(x_first, x_t) = K_first ⋯ K_{t−1} P_t
            across = across @ gain
            covariances.append(np.einsum("ij,ji->i", across, block))
        return np.asarray(
            np.stack(covariances) + np.sum(self._root[first:] * self._root[first], axis=2)
        )
