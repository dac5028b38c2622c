"""Joint cost of all frames, its Newton step, and error bars from the inverse of its Hessian.

    Φ(u, w, z, c) = Σ_t misfit(f(u_t) + V_t w_t + U_t z, y_t) + |w|² + |z|² + Σ_t c_t²/τ²
                    + ε |u − a|² + Σ_t,i λ_ti (u_{t+1,i} − u_{t,i} − c_t)²

u_t is log r of the unloaded panel (t = 0) and of every frame, w the errors that readings of one
frame share (gain, ripple), z the errors that all readings share (reference, channels, contacts),
both in standard deviations, and c_t the step that all cells have in common. λ is the stiffness of
the walk (`lampest.estimate.methods.smoother`). The anchor a, of negligible weight ε, determines
cells that no reading determines. The Hessian is block tridiagonal in t with a border of z and c
(`lampest.posterior.chain`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.inference.assumptions import ASSUMED
from lampest.panel.effects import Shared
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import backtracked
from lampest.posterior.certainty import Certainty
from lampest.posterior.chain import Chain
from lampest.posterior.frame_noise import FrameNoise
from lampest.posterior.linear import IGNORANCE, LinearModel, positive_inverse
from lampest.posterior.track import Bars

ROUNDING = 1e-11  # relative error of Φ, a sum of some thousand terms
# Share of the frames' information on z that is used, because cells that move little and are taken
# for still bias z.
BELIEVED = 0.5
MAX_LENGTHS = 26  # tried lengths of a step, down to the square root of the rounding error
HELD_PRECISION = 1e8  # precision of fixed z, in units of its prior


@dataclass(frozen=True, eq=False)
class Joint:
    """Φ at a point.

    Attributes
    ----------
    cost, data : tuple of Cost and of Data
        Cost and data of every frame alone, the unloaded panel first.
    errors : Shared or None
        Errors that all readings share.
    anchor : array, shape (frames, cells)
        a.
    drawn : array, shape (frames, readings, n)
        V: response of the readings to w.
    shared : array, shape (frames, readings, n)
        U: response of the readings to z.
    position : array, shape (frames, cells + n)
        (u, w).
    shift : array, shape (n + frames − 1,)
        (z, c).
    stiffness : array, shape (frames − 1, cells)
        λ.
    held : (array, array) or None
        Estimate ẑ and its precision, to which Φ fixes z; None: z is free.
    """

    cost: tuple[Cost, ...]
    data: tuple[Data, ...]
    errors: Shared | None
    anchor: Array
    drawn: Array
    shared: Array
    position: Array
    shift: Array
    stiffness: Array
    held: tuple[Array, Array] | None = None

    @classmethod
    def of(
        cls,
        cost: Sequence[Cost],
        data: Sequence[Data],
        errors: Shared | None,
        alone: Array,
        noise: FrameNoise | None = None,
        resting: int = 0,
    ) -> "Joint":
        """Return Φ without ties, at the median of log r with the previous and the next frame.

        A single wrong reading therefore starts no jump.

        Parameters
        ----------
        cost : sequence of Cost
        data : sequence of Data
        errors : Shared or None
            Errors that all readings share.
        alone : array, shape (frames, cells)
            log r of every frame alone, the anchor.
        noise : FrameNoise or None
            Errors that the readings of a frame share.
        resting : int
            Number of the first frames that are means of parts of the unloaded ones.
        """
        count, size = alone.shape
        drawn = np.zeros((count, size, 0))
        if noise is not None:
            drawn = np.stack([noise.columns(frame.measured, baseline=False) for frame in data])
            # each part is a mean of unloaded/resting frames
            drawn[:resting] *= np.sqrt(resting / noise.unloaded)
        start = np.pad(alone, ((0, 0), (0, drawn.shape[2])))
        start[1:-1, :size] = np.median([alone[:-2], alone[1:-1], alone[2:]], axis=0)
        joint = cls(
            tuple(cost),
            tuple(data),
            errors,
            alone,
            drawn,
            shared=np.zeros((count, size, 0)),
            position=start,
            shift=np.zeros(count - 1),
            stiffness=np.zeros((count - 1, size)),
        )
        return replace(joint, position=np.clip(start, *joint.bounds)).sharing()

    def sharing(self) -> "Joint":
        """Return Φ with U evaluated at the model's readings.

        Evaluated at the measured readings, U would correlate with the noise, and a reference that
        reduces the noise would seem to fit.
        """
        shared = self.responses(self.errors)
        count = self._sharing
        z = self.shift[:count] if count else np.zeros(shared.shape[2])
        shift = np.append(z, self.shift[count:])
        return replace(self, shared=shared, shift=shift)

    def responses(self, errors: Shared | None) -> Array:
        """Return the response of the readings to shared errors, (frames, readings, n).

        Here n is 0 without errors.
        """
        if errors is None:
            return np.zeros((*self.anchor.shape, 0))
        return np.stack([errors.columns(at.networks[0], at.reading[0]) for at in self.at])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of u and w, (frames, cells + n) each."""
        limits = zip(*(data.log_bounds for data in self.data), strict=True)
        lower, upper = (np.reshape(limit, self.anchor.shape) for limit in limits)
        unbounded = np.full(self.drawn[:, 0].shape, np.inf)
        return np.hstack([lower, -unbounded]), np.hstack([upper, unbounded])

    @cached_property
    def at(self) -> tuple[Evaluation, ...]:
        """Misfit of every frame, with the shared errors U z + V w subtracted from its readings."""
        offsets = self.shared @ self.shift[: self._sharing] + np.einsum(
            "tri,ti->tr", self.drawn, self.chance
        )

        def evaluated(cost: Cost, data: Data, cells: Array, offset: Array) -> Evaluation:
            measured = data.measured - offset.reshape(data.measured.shape)
            shifted = replace(data, given=replace(data.given, measured=measured))
            return Evaluation.at(cost, shifted, cells.reshape(measured.shape))

        return tuple(map(evaluated, self.cost, self.data, np.exp(self.log_cells), offsets))

    @property
    def cells(self) -> int:
        """The number of cells."""
        return int(self.anchor.shape[1])

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
        """The number of shared errors z."""
        return int(self.shared.shape[2])

    @property
    def steps(self) -> Array:
        """u_{t+1} − u_t − c_t, (frames − 1, cells)."""
        return np.diff(self.log_cells, axis=0) - self.shift[self._sharing :, None]

    @cached_property
    def value(self) -> float:
        """Φ."""
        priors = (self.prior * self._strayed**2, self.certainty * self._shifted**2)
        ties = self.stiffness * self.steps**2
        return float(sum(at.objective for at in self.at) + sum(map(np.sum, (*priors, ties))))

    @property
    def prior(self) -> Array:
        """Prior precision of u and w, ε and 1, (cells + n,)."""
        return np.repeat([IGNORANCE, 1.0], [self.cells, self.drawn.shape[2]])

    @property
    def _strayed(self) -> Array:
        """(u − a, w), (frames, cells + n)."""
        return np.hstack([self.log_cells - self.anchor, self.chance])

    @property
    def _shifted(self) -> Array:
        """(z − ẑ, c)."""
        mean = 0.0 if self.held is None else self.held[0]
        return np.append(self.shift[: self._sharing] - mean, self.shift[self._sharing :])

    @property
    def certainty(self) -> Array:
        """Prior precision of z and c."""
        of_z = 1.0 if self.held is None else HELD_PRECISION
        counts = self._sharing, len(self.stiffness)
        return np.repeat([of_z, ASSUMED.common_step**-2], counts)

    @property
    def ties(self) -> Array:
        """Sum of λ of the steps before and after each frame, (frames, cells)."""
        tied = np.pad(self.stiffness, ((1, 1), (0, 0)))
        return tied[1:] + tied[:-1]

    @cached_property
    def gradient(self) -> Array:
        """½ ∂Φ/∂(u, w), (frames, cells + n)."""
        pulls = np.pad(self.stiffness * self.steps, ((1, 1), (0, 0)))
        misfit = np.stack([at.log_gradient(NO_DUAL).ravel() / 2 for at in self.at])
        # ½ ∂Φ/∂u_t = ½ ∂misfit/∂u_t + λ_{t−1} x_{t−1} − λ_t x_t + ε (u_t − a_t);  ½ ∂Φ/∂w_t = V_tᵀ
        # ½ ∂misfit/∂f + w_t
        chance = np.einsum("tri,tr->ti", self.drawn, self._through)
        gradient = np.hstack([misfit - np.diff(pulls, axis=0), chance])
        return gradient + self.prior * self._strayed

    @cached_property
    def _through(self) -> Array:
        """½ ∂misfit/∂f, (frames, readings)."""
        return np.stack([at.partials(NO_DUAL)[1].ravel() / 2 for at in self.at])

    @cached_property
    def pressed(self) -> Mask:
        """Whether an unknown is at a bound with the gradient pointing outside.

        Shape (frames, cells + n).
        """
        lower, upper = self.bounds
        return ((self.position <= lower) & (self.gradient > 0)) | (
            (self.position >= upper) & (self.gradient < 0)
        )

    @property
    def kkt_residual(self) -> Array:
        """Norm of the projected gradient of Φ in each frame, (frames,).

        See `Evaluation.projected_gradients`.
        """
        pairs = zip(self.at, 2 * self.gradient[:, : self.cells], strict=True)
        return np.array(
            [at.projected_gradients(slope.reshape(at.cell_resistance.shape)) for at, slope in pairs]
        )

    @cached_property
    def models(self) -> tuple[LinearModel, ...]:
        """Every frame's misfit as a linear model."""
        return tuple(LinearModel(at, NO_DUAL) for at in self.at)

    @cached_property
    def sensitivities(self) -> Array:
        """√ω ∂x/∂(u, w) of every frame's data residuals x, (frames, rows, cells + n)."""
        slopes = [at.networks[0].sensitivity() for at in self.at]
        return self._weighted(np.concatenate([slopes, self.drawn], axis=2))

    def _weighted(self, columns: Array) -> Array:
        """Return √ω ∂x/∂f U, (frames, rows, n), for changes U of readings (frames, readings, n)."""
        moved = [model.through @ change for model, change in zip(self.models, columns, strict=True)]
        return np.asarray(self._sizes[..., None] * moved)

    @cached_property
    def _sizes(self) -> Array:
        """√ω of every frame's residuals, (frames, rows).

        Here ω is the loss's curvature, or where that is not positive, its IRLS weight.
        """
        loss = self.cost[0].terms[0].loss
        residuals = np.stack([model.residual for model in self.models])
        curvature = loss.curvature(residuals.ravel())
        size = np.where(curvature > 0, curvature, loss.stiffness(residuals.ravel()))
        return np.sqrt(size).reshape(residuals.shape)

    @cached_property
    def chain(self) -> Chain:
        """Half of the Gauss-Newton Hessian of Φ; unknowns at a bound are fixed."""
        free = ~self.pressed
        sharing = self._sharing
        # λ of u, and none of w
        ties, stiffness = (
            np.pad(values, ((0, 0), (0, self.drawn.shape[2])))
            for values in (self.ties, self.stiffness)
        )
        # Diagonal blocks A_t = J̃ᵀ J̃ + ties + ε over the free unknowns, 1 for the fixed ones.
        rows = self.sensitivities
        blocks = rows.swapaxes(1, 2) @ rows
        blocks *= free[:, :, None] & free[:, None, :]
        diagonals = np.einsum("tii->ti", blocks)
        diagonals[...] = np.where(free, diagonals + ties + self.prior, 1.0)
        # Border: ∂²Φ/∂u∂z = J̃ᵀ Ũ and ∂²Φ/∂u∂c = ±λ; corner: prior of z and c, Ũᵀ Ũ and Σ λ.
        border = np.zeros((*self.position.shape, len(self.shift)))
        corner = np.diag(self.certainty)
        border[:, :, :sharing], informed = self._bordered(self.shared)
        corner[:sharing, :sharing] += informed
        step = np.arange(len(stiffness))
        border[step, :, sharing + step] = stiffness
        border[step + 1, :, sharing + step] = -stiffness
        corner[sharing + step, sharing + step] += stiffness.sum(axis=1)
        # Off-diagonal blocks −Λ, diagonal over the cells that are free in both frames.
        tie = stiffness * (free[1:] & free[:-1])
        return Chain(blocks, tie, border * free[:, :, None], corner)

    def _bordered(self, columns: Array) -> tuple[Array, Array]:
        """Return the parts J̃ᵀ Ẽ (frames, cells + n, m) and Σ_t Ũᵀ Ẽ (n, m) of the Hessian.

        Parameters
        ----------
        columns : array, shape (frames, readings, m)
            E: changes of the readings by further errors.
        """
        moved = self._weighted(columns)
        border = self.sensitivities.swapaxes(1, 2) @ moved
        return border, np.einsum("tri,trj->ij", self._weighted(self.shared), moved)

    def answer(self, columns: Array) -> Array:
        """Return the response of u to errors of the readings that Φ does not contain.

        Shape (frames, cells, n).

        Parameters
        ----------
        columns : array, shape (frames, readings, n)
        """
        right, corner = self._bordered(columns)
        of_border = np.pad(corner, ((0, len(self.stiffness)), (0, 0)))
        unknowns, _ = self.chain.solve(right * ~self.pressed[:, :, None], of_border)
        return unknowns[:, : self.cells]

    @property
    def shared_estimate(self) -> tuple[Array, Array]:
        """Estimate of the shared errors by the frames alone.

        Returns
        -------
        z : array, shape (n,)
        precision : array, shape (n, n)
            Without the prior of z.
        """
        z = self.shift[: self._sharing]
        if self.held is None:
            return z, self.chain.learned(self._sharing)
        return z, self.held[1] - np.eye(self._sharing)

    def expected_squares(self) -> Array:
        """Return E x² of the steps, (frames − 1, cells)."""
        shifted = np.eye(len(self.shift))[self._sharing :]  # c_t
        # E x² = x² + var(u_{t+1} − u_t − c_t)
        return self.steps**2 + self.chain.step_variance(shifted)[:, : self.cells]

    def newton(self) -> tuple[Array, Array]:
        """Return the Gauss-Newton step.

        Returns
        -------
        cells : array, shape (frames, cells + n)
            Step of (u, w).
        shift : array
            Step of (z, c).
        """
        shared = np.einsum("tri,tr->i", self.shared, self._through)
        # ½ ∂Φ/∂z = Σ_t Uᵀ ½ ∂misfit/∂f + z (or its deviation from ẑ), ½ ∂Φ/∂c_t = −Σ_i λ_ti x_ti +
        # c_t/τ²
        slope = np.append(shared, -np.sum(self.stiffness * self.steps, axis=1))
        slope += self._shifted * self.certainty
        free_gradient = np.where(self.pressed, 0.0, self.gradient)
        cells, shift = self.chain.solve(-free_gradient[..., None], -slope[:, None])
        return cells[..., 0], shift[:, 0]

    def agreeing(self, stiffness: Array) -> "Joint":
        """Return the problem with z fixed, if cells near loads contradict all other cells.

        Else return it unchanged. Cells near a load move a little with it, are taken for still, and
        so bias z. Let ẑ, C be the estimate of z with its covariance, and ẑ', C' those without cells
        near loads. If both agree, the mean of |ẑ − ẑ'|² is tr D with D = C' − C (Hausman,
        Econometrica 46, 1978). If it is ρ > 1 times that, z is fixed at an average of both, in
        which ẑ has the share (ρ exp(1 − ρ))^(n/2) with n = (tr D)²/tr D², Chernoff's bound of
        P(χ²_n > n ρ).

        Parameters
        ----------
        stiffness : array, shape (frames − 1, cells)
            λ with which the cells near loads are free.
        """
        count = self._sharing
        # ẑ and C of all cells, ẑ' and C' without those near loads
        (shift, covariance), (shift_without, covariance_without) = (
            (
                (self.shift + joint.newton()[1])[:count],
                joint.chain.border_covariance[:count, :count],
            )
            for joint in (self, replace(self, stiffness=stiffness))
        )
        difference = covariance_without - covariance
        expected = float(np.trace(difference))
        squares = float(np.sum((shift_without - shift) ** 2))
        if squares <= expected:
            return self
        ratio = squares / expected
        share = (ratio * np.exp(1 - ratio)) ** (expected**2 / np.sum(difference**2) / 2)
        # The average has the precision share · C⁻¹ + (1 − share) · C'⁻¹, and is the mean weighted
        # by these.
        precision = share * positive_inverse(covariance)
        precision_without = (1 - share) * positive_inverse(covariance_without)
        average_precision = precision + precision_without
        pull = precision @ shift + precision_without @ shift_without
        return replace(self, held=(np.linalg.solve(average_precision, pull), average_precision))

    @property
    def uncertain(self) -> Chain:
        """Chain for error bars, with the share BELIEVED of the frames' information on z and c."""
        free = replace(self, held=None)
        chain = free.chain.doubting(BELIEVED, free.certainty)
        if self.held is None:
            return chain
        return chain.with_border(np.eye(self._sharing) + BELIEVED * self.shared_estimate[1])

    def stepped(self) -> "Joint":
        """Return the point after a step, halved until Φ does not increase.

        Return this point where no step achieves that.
        """
        step, shift = self.newton()

        def lower(length: float) -> Joint | None:
            position = np.clip(
                self.position + length * np.where(self.pressed, 0.0, step), *self.bounds
            )
            trial = replace(self, position=position, shift=self.shift + length * shift)
            return trial if trial.value <= self.value + ROUNDING * abs(self.value) else None

        return backtracked(lower, MAX_LENGTHS) or self


@dataclass(frozen=True, eq=False)
class TiedModel(LinearModel):
    """Linear model of a frame whose cells are tied to other frames.

    Attributes
    ----------
    slope : array, shape (cells,)
        ∂Φ/∂u of the frame, ties included.
    """

    slope: Array

    @cached_property
    def gradient(self) -> Array:
        """∂Φ/∂u."""
        return self.slope


def _certainty(joint: Joint, chain: Chain, frame: int) -> Certainty:
    """Return the error bars of log r of one frame.

    The resolution counts the frame's own readings alone. The data share is 1, because ties compare
    frames and do not pull cells to a prior value.

    Parameters
    ----------
    joint : Joint
    chain : Chain
        Inverse Hessian from which the covariance is taken.
    frame : int
    """
    cells = slice(joint.cells)
    model = TiedModel(joint.at[frame], NO_DUAL, 2 * joint.gradient[frame, cells])
    posterior = chain.covariance(frame)
    rows = joint.sensitivities[frame][:, cells]
    covariance = posterior[cells, cells]
    free = model.free
    tie = joint.ties[frame]

    def released(cells: Numbers) -> Array:
        """Return the variance of cells at a bound if each alone were released.

        Neighbouring frames count as known.
        """
        across = rows[:, free].T @ rows[:, cells]
        precision = np.sum(rows[:, cells] ** 2, axis=0) + tie[cells]
        # Schur complement: a_ii − a_iᵀ P a_i over the free cells
        free_covariance = covariance[np.ix_(free, free)]
        by_free = np.einsum("fi,fg,gi->i", across, free_covariance, across, optimize=True)
        return np.asarray(1 / np.maximum(precision - by_free, IGNORANCE))

    # diag(P J̃ᵀ J̃), the diagonal of the averaging kernel
    followed = np.einsum("ij,ri,rj->i", covariance, rows, rows, optimize=True)
    shares = (followed[free], np.ones(len(free)))
    variance = np.diag(covariance)
    across = posterior[cells, joint.cells :]
    # variance of u that w explains: P_uw P_ww⁻¹ P_wu
    inherited = np.sum(
        across @ np.linalg.inv(posterior[joint.cells :, joint.cells :]) * across, axis=1
    )
    shared = np.minimum(chain.shared_variance(frame)[cells] + inherited, variance)
    return Certainty.of(model, (variance[free], shared[free]), shares, released)


def error_bars(
    joint: Joint, resting: int, beyond: Shared | None = None
) -> tuple[Certainty, tuple[Bars, ...]]:
    """Return the error bars of the baseline and of all frames after it.

    Parameters
    ----------
    joint : Joint
    resting : int
        Number of the first frames that are unloaded; the last of them is the baseline.
    beyond : Shared, optional
        Errors that all readings share and Φ does not contain.

    Returns
    -------
    baseline : Certainty
    frames : tuple of Bars
    """
    answer = joint.answer(joint.responses(beyond))
    chain = joint.uncertain
    numbers = range(resting - 1, len(joint.position))
    baseline, *certainty = (
        _certainty(joint, chain, t).widened(answer[t]).of_frame(0).by_conductance() for t in numbers
    )
    # cov(u_t, u_baseline) of each cell, for the variance of changes: from Φ, and from the errors
    # beyond it
    covariances = chain.since(resting - 1)[1:, : joint.cells] + np.sum(
        answer[resting:] * answer[resting - 1], axis=2
    )
    covariances = covariances.reshape(-1, *baseline.deviation.shape)
    pairs = zip(certainty, covariances, strict=True)
    return baseline, tuple(Bars(frame, frame.less(baseline, shared)) for frame, shared in pairs)
