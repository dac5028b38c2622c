"""Evidence of two frames, the unloaded panel and a loaded one, under effects beside the circuit.

Each effect adds one parameter θ ~ N(0, prior²) to the readings. Between the unloaded panel b and a
frame f the log cells that no load touches change by

    d = a θ + noise,   a = K_f U_f − K_b U_b,

where U is the response of the readings to a unit of θ, and K the inverse of their Jacobian. The
evidence is computed with a and without (`lampest.inference.evidence`). Effects in the network
itself are estimated together with the cells and d, by Gauss-Newton steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from lampest.inference.assumptions import ASSUMED
from lampest.inference.cells_fit import FIT, CellsFit
from lampest.inference.evidence import (
    PARAMETER_COST,
    Changes,
    away_from_changed,
    places_of,
    scores_with_errors,
    touching,
    usual_starts,
)
from lampest.inference.number import mean_cost
from lampest.panel.effects import (
    CHANNELS,
    REFERENCE,
    SERIES,
    sized_effects,
    systematic_of,
    usual_size,
)
from lampest.panel.effects.line_effect import LineEffect
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts.tolerances import channel_errors
from lampest.panel.trust_region import backtracked
from lampest.recording.readings import Readings

SETTLED_STEP = 0.1  # step of θ in standard deviations below which the iteration ends
SECANT_STEP = 1e-3  # of the prior's standard deviation
MAX_LENGTHS = 5  # tried lengths of a step of θ


class Evidence(NamedTuple):
    """Evidence of a pair of frames under given effects.

    Attributes
    ----------
    score : float
        −2 ln evidence up to a constant.
    moved : boolean array, shape (cells,)
        The moved cells with the largest evidence.
    size, sd : array, shape (1 + effects,)
        Posterior mean and standard deviation of the common change, then of the addition to every
        effect's present size, in units of the priors; NaN where no cell stands still.
    """

    score: float
    moved: Mask
    size: Array
    sd: Array


def responses(fit: CellsFit, effects: Sequence[LineEffect]) -> Array:
    """Return the response K U of the log cells to a unit of each θ, by secants.

    Shape (cells, effects).
    """
    # An effect of the size of the secant's step; constant ones and those since the unloaded frames
    # respond alike.
    small = [replace(effect, since=False, size=SECANT_STEP * effect.prior) for effect in effects]
    by_effect = {effect: fit.more(effect) / SECANT_STEP for effect in dict.fromkeys(small)}
    return fit.response(np.stack([by_effect[effect] for effect in small]))


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The unloaded panel and a frame.

    Attributes
    ----------
    frames : tuple of two CellsFit
        The unloaded panel, then the frame.
    known_channels : array, shape (cells, lines), or None
        `channels` of a similar pair, to be used for this one; None: they are computed.
    start : boolean array, shape (cells,), or None
        Moved cells of a similar pair, at which the selection of moved cells begins; None: it begins
        at the usual starts.
    """

    frames: tuple[CellsFit, CellsFit]
    known_channels: Array | None = None
    start: Mask | None = None

    @cached_property
    def channels(self) -> Array:
        """Change a of the log cells by one ohm more in each line's channel, (cells, lines)."""
        if self.known_channels is not None:
            return self.known_channels
        responses = []
        for fit in self.frames:
            circuit, value = fit.scene.circuit, fit.readings.value
            errors = channel_errors(circuit, fit.cells, value, fit.scene, 1.0)
            responses.append(fit.response(errors))
        return responses[1] - responses[0]

    @property
    def channel_spread(self) -> float:
        """Standard deviation of the channels, ohm: that of the scene, or of usual multiplexers."""
        sizes = systematic_of(self.frames[1].scene)
        return (sizes and sizes.size(CHANNELS)) or usual_size(CHANNELS)

    @property
    def scale_error(self) -> float | None:
        """Median error of the changes d of moved cells by the numbers that no frame shows.

        Each number is taken at the ends of its tolerance. The value is None where the scene has no
        such numbers, or no cell moves.
        """
        scene = self.frames[0].scene
        sizes = systematic_of(scene)
        if sizes is None or not self.moved.any():
            return None
        errors = [each for each in sized_effects(sizes) if each.setting in (REFERENCE, SERIES)]
        resting, loaded = (fit.response_to(errors, sizes) for fit in self.frames)
        # columns are of one standard deviation: that of the reference's uniform distribution is its
        # half width over √3
        ends = [np.sqrt(3) if each.setting == REFERENCE else 1.0 for each in errors]
        error = np.abs((loaded - resting) * ends).sum(axis=1)
        return float(np.median(error[self.moved.ravel()]))

    @property
    def fits_noise(self) -> bool:
        """Whether noise alone may give the misfit of both frames."""
        return all(fit.within_noise for fit in self.frames)

    @property
    def effects(self) -> tuple[LineEffect, ...]:
        """Effects in the network of the frame.

        Constant effects are also in the network of the unloaded panel.
        """
        return self.frames[1].effects

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of the panel."""
        return self.frames[1].cells.shape

    @cached_property
    def change(self) -> Array:
        """Change d = ln(r_f/r_b) of the log cells from the unloaded panel to the frame.

        Shape (cells,).
        """
        resting, frame = self.frames
        return np.log(frame.cells / resting.cells).ravel()

    @cached_property
    def covariance(self) -> Array:
        """Covariance Σ of d where no load is, (cells, cells).

        Effects and a common change are not included.
        """
        # Σ = P_b + P_f + creep² 1 + spread² channels channelsᵀ
        noise = sum(frame.covariance for frame in self.frames) + ASSUMED.creep**2 * np.eye(
            len(self.change)
        )
        return noise + self.channel_spread**2 * self.channels @ self.channels.T

    @cached_property
    def _volume(self) -> float:
        """ln |Σ|."""
        return float(np.linalg.slogdet(self.covariance)[1])

    def columns(self, effects: Sequence[LineEffect]) -> Array:
        """Return a = K_f U_f − K_b U_b of each θ in units of its prior, (cells, effects).

        An effect since the unloaded frames changes only the frame: K_b U_b is 0.
        """
        if not effects:
            return np.zeros((len(self.change), 0))
        resting, loaded = (responses(frame, effects) for frame in self.frames)
        return loaded - np.array([not effect.since for effect in effects]) * resting

    def with_columns(self, columns: Array) -> Changes:
        """Return the changes d with a common change of all cells, then effects, as errors.

        The effects are of one prior deviation each.

        Parameters
        ----------
        columns : array, shape (cells, n)
            a of each effect in units of its prior.
        """
        common = np.full(len(self.change), ASSUMED.common_change)
        return Changes(self.change, self.covariance, np.column_stack([common, columns]))

    @property
    def deviations(self) -> Array:
        """Standard deviations of the effects' sizes by the errors that the scene has.

        Evidence allows for creep and for channels that the scene does not name, so that K weighs
        the changes d by more than their covariance C. The error of K d = K (A θ + noise) has the
        covariance (1 − K A)(1 − K A)ᵀ + K C Kᵀ. Sizes that the scene states have 0.

        Shape (effects,), in units of the priors.
        """
        sizes = systematic_of(self.frames[1].scene)
        spread = 0.0 if sizes is None else sizes.size(CHANNELS)
        noise = sum(frame.covariance for frame in self.frames)
        noise = noise + spread**2 * self.channels @ self.channels.T
        still = ~self.evidence.moved
        chosen = away_from_changed(still, self.shape) if still.any() else ~still
        part = self.with_columns(self.columns(self.effects)).part(chosen)
        root = np.linalg.cholesky(noise[np.ix_(chosen, chosen)])
        unit = np.eye(part.columns.shape[1])
        errors = part.errors
        by_part = np.hstack([unit - errors.mean(part.columns), errors.mean(root)])
        stated = [effect.known for effect in self.effects]
        return np.where(stated, 0.0, np.linalg.norm(by_part, axis=1)[1:])

    @property
    def cost_of_effects(self) -> float:
        """−2 ln prior of the effects in the network."""
        costs = (
            PARAMETER_COST + (effect.size / effect.prior) ** 2
            for effect in self.effects
            if effect.size
        )
        return sum(costs)

    @property
    def _prior(self) -> float:
        """−2 ln prior of the effects in the network, less ln |Σ|."""
        return self.cost_of_effects - self._volume

    def explained(self, columns: Array) -> Evidence:
        """Return the evidence with a common change of all cells and with further effects.

        See `with_columns`.
        """
        changes = self.with_columns(columns)
        starts = usual_starts(self.change) if self.start is None else [self.start]
        score, moved = changes.selected(starts)
        mean = np.full(1 + columns.shape[1], np.nan)
        sd = mean
        if not moved.all():
            mean, covariance = changes.posterior(away_from_changed(~moved, self.shape))
            sd = np.sqrt(np.diag(covariance))
        return Evidence(score + self._prior, moved, mean, sd)

    @cached_property
    def changes(self) -> Changes:
        """The changes d with a common change of all cells alone."""
        return self.with_columns(self.columns(()))

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence without further effects."""
        return self.explained(self.columns(()))

    @cached_property
    def _scores(self) -> tuple[float, float]:
        """−2 ln evidence of single moved cells or a field within an outline, and of one of all."""
        changes, moved = self.changes, self.evidence.moved
        outlines = [*changes.outlines(self.place, moved), np.ones_like(moved)]
        # The outline of a load that covers the panel is that of all cells.
        distinct, numbers = np.unique(outlines, axis=0, return_inverse=True)
        costs = np.array([changes.cost_of_field(self.place, outlined) for outlined in distinct])
        *within, everywhere = costs[numbers.ravel()] + self._prior
        return mean_cost(np.array([self.evidence.score, *within])), float(everywhere)

    @property
    def place(self) -> Numbers:
        """Row and column of each cell, (cells, 2)."""
        return places_of(self.shape)

    @property
    def moved(self) -> Mask:
        """The moved cells with the largest evidence, boolean (rows, columns)."""
        return self.evidence.moved.reshape(self.shape)

    def scores_with(self, effects: Sequence[LineEffect], candidates: Array) -> Array:
        """Return −2 ln evidence with further sizes of effects and one candidate, for each, (n,).

        The result approximates the score of `explained`: cells are only added to the moved ones,
        never removed.

        Parameters
        ----------
        effects : sequence of Effect
        candidates : array, shape (cells, n)
            a of each candidate.
        """
        precision, volume = self.with_columns(self.columns(effects)).inverse_and_volume
        return scores_with_errors(self.change, precision, candidates) - volume + self._prior

    @property
    def density(self) -> float:
        """−2 ln density of the frame's readings given the unloaded ones.

        A constant common to all circuits is left out. The densities of circuits are comparable
        because the Jacobian of the readings is included: a circuit whose readings hardly depend on
        the cells gains nothing by it.
        """
        # p(y) = p(d) |∂d/∂y|: −2 ln p(y) has ln |Jᵀ J| = ln |normal| and ln |Σ| more than the
        # quadratic form of d
        return self.evidence.score - self.frames[1].log_volume + self._volume

    @cached_property
    def density_of_loads(self) -> float:
        """`density` where the moved cells may be single ones, or a smooth field."""
        return mean_cost(np.array(self._scores)) - self.frames[1].log_volume + self._volume

    @property
    def is_field(self) -> bool:
        """Whether all cells rather changed than some."""
        return self._scores[1] < self._scores[0]

    @property
    def has_load(self) -> bool:
        """Whether any cell changed."""
        return self.is_field or bool(self.moved.any())

    @property
    def misfits(self) -> float:
        """The misfit χ² of both frames, and PARAMETER_COST of each bound.

        Thus no circuit gains by bounds.
        """
        return sum(frame.chi_square for frame in self.frames) + self.cost_of_bounds

    @property
    def cost_of_bounds(self) -> float:
        """PARAMETER_COST of each bound of both frames."""
        return sum(PARAMETER_COST * int(frame.readings.bounds.sum()) for frame in self.frames)

    @cached_property
    def _misfit(self) -> tuple[float, int]:
        """χ² of the changes of the still cells, and the number of these cells."""
        still = ~self.evidence.moved
        return self.changes.part(still).misfit, int(still.sum())

    @property
    def beyond_noise(self) -> float:
        """The score less the misfit of the still cells as far as noise is expected to have it."""
        return self._scores[0] - min(self._misfit)

    def beyond_noise_of(self, cells: Mask) -> float:
        """Return −2 ln evidence of these cells alone, beyond that of noise."""
        changes = self.changes.part(cells)
        score, moved = changes.selected(usual_starts(changes.change))
        place = self.place[cells]
        outlines = changes.outlines(place, moved)
        fields = [changes.cost_of_field(place, outlined) for outlined in outlines]
        score = mean_cost(np.array([score, *fields]))
        score += self._prior + self._volume - float(np.linalg.slogdet(changes.noise)[1])
        return score - min(changes.part(~moved).misfit, int((~moved).sum()))

    def gain_apart(self, better: "FittedPair") -> float:
        """Return the gain of another explanation in −2 ln evidence, apart from its moved cells.

        Only cells that touch none of its moved cells count, because the tail of a load looks like
        another circuit or an effect. The gain is 0 with fewer than two such cells.
        """
        distant = ~touching(better.moved[None]).ravel()
        if distant.sum() < 2:
            return 0.0
        return self.beyond_noise_of(distant) - better.beyond_noise_of(distant)

    @property
    def excess(self) -> float:
        """Misfit of the still cells over that of noise alone, at least 1.

        The value is 1 where changes are rather a field, which has its own scatter.
        """
        if self.is_field:
            return 1.0
        misfit, still = self._misfit
        return max(misfit / max(still, 1), 1.0)

    def _stepped(
        self, effects: Sequence[LineEffect], step: Array, length: float
    ) -> "FittedPair | None":
        """Return the pair after a step of the effects' sizes, times a length.

        The result is None where no cells explain the readings then. Sizes of effects that cannot be
        negative, such as leaks, are clipped at 0.

        Parameters
        ----------
        effects : sequence of Effect
        step : array, shape (effects,)
            In units of the priors.
        length : float
        """
        stepped = []
        for effect, change in zip(effects, step * length, strict=True):
            size = effect.size + effect.prior * float(change)
            stepped.append(replace(effect, size=max(size, 0.0) if effect.positive else size))
        return self.with_effects(tuple(stepped))

    def with_effects(self, effects: tuple[LineEffect, ...]) -> "FittedPair | None":
        """Return the pair with effects in place of its own; None where no cells fit."""
        constant = tuple(effect for effect in effects if not effect.since)
        resting, loaded = self.frames
        if constant:
            refitted = resting.refitted(resting.measured, constant)
            if refitted is None:
                return None
            resting = refitted
        begun = loaded if loaded.within_noise else resting
        loaded_fit = begun.refitted(loaded.measured, effects)
        return (
            None
            if loaded_fit is None
            else replace(self, frames=(resting, loaded_fit), known_channels=self.channels)
        )

    def settled(
        self, effects: Sequence[LineEffect], to_beat: float = np.inf, *, constant: bool = True
    ) -> "FittedPair | None":
        """Return the pair with the most probable sizes of these effects; None where no cells fit.

        Parameters
        ----------
        effects : sequence of Effect
            Effects of the pair, then further ones of size 0.
        to_beat : float
            Score above which a pair does not count. The result is None where the sizes move away
            from a lower one, by linear theory at each of them.
        constant : bool
            Whether the sizes of effects that the unloaded frames have, too, may change.
        """
        pair = self
        for _ in range(FIT.evaluations):
            evidence = pair.explained(pair.columns(effects))
            # The next selection of moved cells begins at these.
            pair = replace(pair, start=evidence.moved)
            free = [(constant or effect.since) and not effect.known for effect in effects]
            step = np.where(free, evidence.size[1:], 0.0)
            sd = evidence.sd[1:]
            if not np.isfinite(step).all() or evidence.score > to_beat:
                return None
            # Gauss-Newton step of θ, of at most one prior deviation; halved until cells explain
            # both frames.
            short = step / max(1.0, float(np.abs(step).max()))
            stepped = backtracked(partial(pair._stepped, effects, short), MAX_LENGTHS)
            if stepped is None:
                return None
            pair = stepped
            # An effect that cannot be negative, and has no size, does not move below 0.
            least = [
                -effect.size / effect.prior if effect.positive else -np.inf for effect in effects
            ]
            effects = pair.effects
            moved = np.abs(np.maximum(step, least))
            if np.all(moved < SETTLED_STEP * np.maximum(sd, SETTLED_STEP)):
                break
        return replace(pair, start=self.start)

    def frame_like(self, readings: Readings, near: CellsFit) -> CellsFit | None:
        """Return the fit of another frame with these effects; None where no cells explain it.

        The sizes of effects since the unloaded frames are estimated anew, and are 0 where the frame
        is no more probable with them.

        Parameters
        ----------
        readings : Readings
            (rows, columns).
        near : CellsFit
            Fit of the frame before.
        """
        fit = near.refitted(readings, without_late(near.effects))
        if fit is None or not any(effect.since for effect in near.effects):
            return fit
        begun = near.refitted(readings, near.effects)
        if begun is None:
            return None
        pair = replace(self, known_channels=self.channels)
        settled = replace(pair, frames=(self.frames[0], begun)).settled(
            near.effects, constant=False
        )
        without = replace(pair, frames=(self.frames[0], fit))
        if settled is None or without.evidence.score <= settled.evidence.score:
            return fit
        return settled.frames[1]


def without_late(effects: Sequence[LineEffect]) -> tuple[LineEffect, ...]:
    """Return the effects, with those since the unloaded frames set to 0."""
    return tuple(replace(effect, size=0.0) if effect.since else effect for effect in effects)
