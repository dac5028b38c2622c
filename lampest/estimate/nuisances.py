"""Effects beside the circuit: leaks of wet lines, loose contacts, common creep of the film.

Each effect adds one parameter θ ~ N(0, prior²) to the readings. Between the unloaded panel b and a frame f the log
cells that no load touches change by

    d = a θ + noise,   a = K_f U_f − K_b U_b,

where U is the response of the readings to a unit of θ, and K the inverse of their Jacobian. The evidence is computed
with a and without (`lampest.estimate.changed_cells`). The best effects then enter the network itself; the cells, d and
θ are estimated again by Gauss-Newton steps. An effect is named if the evidence gains by MIN_EVIDENCE_GAIN.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.cells_fit import FIT, CellsFit, fitted
from lampest.estimate.changed_cells import (
    PARAMETER_COST,
    away_from_changed,
    mostly_still,
    scores_with_errors,
    select_changed,
    usual_starts,
)
from lampest.files.levels import SIGNIFICANCE, SIGNIFICANT
from lampest.panel.effects import EFFECTS, Effect, LooseContact, effect_on_readings
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.systematic import systematic_of
from lampest.recording.readings import Readings
from lampest.recording.recording import MIN_CHANGE

# In −2 ln evidence, of another circuit, an effect or an error of the model. 430 recordings with the right circuit gain
# 32 at most, and nearly all less than 15: no false alarm (docs/theory/model_check.md). By an error of the model mouths
# at their limits gain 23 where nothing is wrong, and 76 where readings are off by 7 % each.
MIN_EVIDENCE_GAIN = 36.0
MAX_CANDIDATES = 3  # rivals or effects that are solved exactly, the best ones of linear theory; effects at a time
SETTLED_STEP = 0.1  # step of θ in standard deviations below which the iteration ends
MAX_BOUND_SHARE = 0.02  # of the readings: linear theory does not hold for cells behind bounds
MIN_SPARED_CELLS = 2  # fewer moved cells that an effect must bring: a converter's nonlinearity moves one
TAKEN_OFF = "taken off the readings, which error bars allow for"
SECANT_STEP = 1e-3  # of the prior's standard deviation
MIN_REMAINING = 0.1  # of a reading: the lower limit of a corrected reading


@dataclass(frozen=True, eq=False)
class BetterExplanation:
    """A better explanation of the readings than the scene's circuit: another circuit, or an effect beside it.

    Attributes
    ----------
    name : str
        The circuit or the effects in words; '' where nothing explains the readings better.
    frames : str
        The loaded frames in words.
    count, count_as_specified : int
        Moved cells between the unloaded panel and these frames: under the better explanation, and under the scene's
        circuit.
    fits_noise : bool
        Whether cells explain the readings of the unloaded panel and of the frames within their noise.
    """

    name: str = ""
    frames: str = ""
    count: int = 0
    count_as_specified: int = 0
    fits_noise: bool = True

    @property
    def reason(self) -> str:
        """The reason why it is named, in words."""
        counts = f"{self.count} cells have moved then, and {self.count_as_specified} as specified"
        if self.count >= self.count_as_specified:
            counts = f"the misfit is smaller, with {self.count} moved cells"
        return f"between the unloaded panel and {self.frames} {counts}"


def candidates(shape: tuple[int, ...]) -> list[Effect]:
    """Return all effects that are tried on a panel: those since the unloaded frames, then the constant ones."""
    rows, columns = shape
    return [kind(lines, since) for since in (True, False) for kind in EFFECTS for lines in kind.places(rows, columns)]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of a pair of frames under given effects.

    Attributes
    ----------
    score : float
        −2 ln evidence up to a constant.
    moved : boolean array, shape (cells,)
        The moved cells with the largest evidence.
    size, sd : array, shape (1 + effects,)
        Posterior mean and standard deviation of the common change, then of the addition to every effect's present
        size, in units of the priors; NaN where no cell stands still.
    """

    score: float
    moved: NDArray[np.bool_]
    size: Array
    sd: Array


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """A frame with the cells that explain it under a network with effects.

    Attributes
    ----------
    scene : Scene
    readings : Readings
        Measured readings of the frame, (rows, columns).
    fit : CellsFit
        Fit of the cells, with the effects in the network.
    effects : tuple of Effect
    """

    scene: Scene
    readings: Readings
    fit: CellsFit
    effects: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, scene: Scene, fit: CellsFit) -> "FittedFrame":
        """Return the frame of a fit without effects."""
        return cls(scene, fit.readings, fit)

    def refitted(self, given: Readings, effects: tuple[Effect, ...]) -> "FittedFrame | None":
        """Return the frame fitted to other readings or effects, from its cells on; None where no fit is found."""
        fit = fitted(self.scene, given, self.fit.cells, patient=True, effects=effects)
        return None if fit is None else FittedFrame(self.scene, given, fit, effects)

    @cached_property
    def network(self) -> Network:
        """The network of the cells, without effects."""
        circuit = self.scene.circuit
        return circuit.network(self.fit.cells, circuit.ties(self.fit.readings.value), self.scene.wiring)

    @cached_property
    def channels(self) -> Array:
        """Response K U of the log cells to one ohm more in each line's channel, (cells, lines)."""
        cells, measured = self.fit.cells, self.fit.readings.value
        errors = self.scene.circuit.shared_errors(cells, measured, self.scene, 0.0, 1.0)[1:]
        return self.fit.response(errors)

    @cached_property
    def offset(self) -> Array:
        """Change of the readings by all effects together, (rows, columns), in the readout's unit."""
        return effect_on_readings(self.effects, self.scene, self.network)

    def more(self, effect: Effect) -> Array:
        """Return the further change of the readings by an additional effect, (rows, columns)."""
        return effect_on_readings((*self.effects, effect), self.scene, self.network) - self.offset

    @property
    def may_fit(self) -> bool:
        """Whether MAX_CANDIDATES effects can reduce the misfit to noise, by linear theory.

        A single effect with the response u reduces χ² by (uᵀ e)²/uᵀ u, where e is the residual and u is projected on
        the complement of the range of the Jacobian. Several effects are assumed to reduce it by no more than their
        number times the largest single reduction.
        """
        if self.fit.tail >= SIGNIFICANCE:
            return True
        sigma = self.fit.readings.sigma
        assert sigma is not None
        small = [_small(effect) for effect in candidates(self.fit.cells.shape)]
        columns = np.stack([(self.more(effect) / sigma).ravel() for effect in dict.fromkeys(small)], axis=1)
        # u ← (1 − J (Jᵀ J)⁻¹ Jᵀ) u: the part of each response that no change of the cells can produce
        columns -= self.fit.jacobian @ np.linalg.solve(self.fit.normal, self.fit.jacobian.T @ columns)
        # reduction of χ² by each effect alone: (uᵀ e)²/uᵀ u
        explained = (columns.T @ self.fit.residual) ** 2 / np.maximum(np.sum(columns**2, axis=0), 1e-300)
        return bool(MAX_CANDIDATES * explained.max() >= self.fit.chi_square - self.fit.degrees)

    def answers(self, effects: Sequence[Effect]) -> Array:
        """Return the response K U of the log cells to a unit of each θ, (cells, effects), by secants."""
        small = [_small(effect) for effect in effects]
        each = {effect: self.more(effect) / SECANT_STEP for effect in dict.fromkeys(small)}
        return self.fit.response(np.stack([each[effect] for effect in small]))

    @property
    def amplification(self) -> Array:
        """Factor of the readings' noise once the effects are taken off, (rows, columns).

        It is the standard deviation of the readings that the cells would give without effects, in units of σ.
        """
        if all(effect.changed(self.network) is self.network for effect in self.effects):
            return np.ones(self.fit.cells.shape)
        assert self.fit.readings.sigma is not None
        dry = self.network.sensitivity() / self.fit.readings.sigma.reshape(-1, 1)
        # diag(J₀ P J₀ᵀ), with J₀ the Jacobian over σ without effects and P the covariance of the log cells
        variance = np.sum((dry @ self.fit.covariance) * dry, axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 1.0))).reshape(self.fit.cells.shape)


def _small(effect: Effect) -> Effect:
    """Return the effect with the size of a secant's step, as a constant one."""
    return replace(effect, since=False, size=SECANT_STEP * effect.prior)


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The unloaded panel and a frame.

    Attributes
    ----------
    frames : tuple of two FittedFrame
        The unloaded panel, then the frame.
    channels : array, shape (cells, lines)
        Change a of the log cells by one standard deviation of each line's channel resistance.
    effects : tuple of Effect
        Effects in the networks of both frames.
    """

    frames: tuple[FittedFrame, FittedFrame]
    channels: Array
    effects: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, resting: FittedFrame, frame: FittedFrame) -> "FittedPair":
        """Return the pair; the spread of the channels is the scene's, or else that of one multiplexer."""
        sizes = systematic_of(frame.scene)
        spread = (sizes and sizes.channel_spread_ohm) or ASSUMED.channel_ohm
        return cls((resting, frame), spread * (frame.channels - resting.channels))

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of the panel."""
        return self.frames[1].fit.cells.shape

    @cached_property
    def change(self) -> Array:
        """d = ln(r_f/r_b), the change of the log cells from the unloaded panel to the frame, (cells,)."""
        resting, frame = self.frames
        return np.asarray(np.log(frame.fit.cells / resting.fit.cells).ravel())

    @cached_property
    def _covariance(self) -> Array:
        """Σ, the covariance of d where no load is, without effects and without a common change, (cells, cells)."""
        # Σ = P_b + P_f + creep² 1 + channels channelsᵀ
        noise = sum(frame.fit.covariance for frame in self.frames) + ASSUMED.creep**2 * np.eye(len(self.change))
        return np.asarray(noise + self.channels @ self.channels.T)

    @cached_property
    def _precision(self) -> Array:
        return np.linalg.inv(self._covariance)

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Return a = K_f U_f − K_b U_b of each θ in units of its prior, (cells, effects).

        An effect since the unloaded frames changes only the frame: K_b U_b is 0.
        """
        if not effects:
            return np.zeros((len(self.change), 0))
        resting, loaded = (frame.answers(effects) for frame in self.frames)
        return np.asarray(loaded - np.array([not effect.since for effect in effects]) * resting)

    @cached_property
    def _prior_score(self) -> float:
        """−2 ln prior of the effects in the network, up to a constant."""
        return sum(PARAMETER_COST + (effect.size / effect.prior) ** 2 for effect in self.effects if effect.size)

    def _with_columns(self, columns: Array) -> tuple[Array, Array, float]:
        """Return the statistics of d ~ N(0, Σ + A Aᵀ), where A holds a common change of all cells and the columns.

        Parameters
        ----------
        columns : array, shape (cells, n)
            a of each effect in units of its prior.

        Returns
        -------
        array, shape (cells, 1 + n)
            A.
        array, shape (cells, cells)
            (Σ + A Aᵀ)⁻¹.
        float
            ln |Σ + A Aᵀ| − ln |Σ|.
        """
        own = np.column_stack([np.full(len(self.change), ASSUMED.common_change), columns])
        # Woodbury: (Σ + A Aᵀ)⁻¹ = P − P A (1 + Aᵀ P A)⁻¹ Aᵀ P, and |Σ + A Aᵀ| = |Σ| |1 + Aᵀ P A|, with P = Σ⁻¹
        weighted = self._precision @ own
        inner = np.eye(own.shape[1]) + own.T @ weighted
        precision = self._precision - weighted @ np.linalg.solve(inner, weighted.T)
        return own, precision, float(np.linalg.slogdet(inner)[1])

    def explained(self, columns: Array) -> Evidence:
        """Return the evidence with a common change of all cells and with effects.

        Parameters
        ----------
        columns : array, shape (cells, n)
            a of each effect in units of its prior.
        """
        own, precision, added = self._with_columns(columns)
        lost, moved = select_changed(precision @ self.change, precision, usual_starts(self.change))
        score = float(self.change @ precision @ self.change) + lost + added + self._prior_score
        nothing = np.full(own.shape[1], np.nan)
        if moved.all():
            return Evidence(score, moved, nothing, nothing)
        # Posterior of θ ~ N(0, 1) given the still cells s: covariance (1 + A_sᵀ Σ_ss⁻¹ A_s)⁻¹ =: V, mean V A_sᵀ Σ_ss⁻¹
        # d_s.
        still = away_from_changed(~moved, self.shape)
        within = np.linalg.solve(self._covariance[np.ix_(still, still)], own[still])
        left = np.linalg.inv(np.eye(own.shape[1]) + own[still].T @ within)
        return Evidence(score, moved, left @ within.T @ self.change[still], np.sqrt(np.diag(left)))

    @cached_property
    def without_effects(self) -> Evidence:
        """The evidence without further effects."""
        return self.explained(self.columns(()))

    @property
    def density(self) -> float:
        """−2 ln density of the frame's readings given the unloaded ones, up to a constant common to all circuits.

        The densities of circuits are comparable because the Jacobian of the readings is included: a circuit whose
        readings hardly depend on the cells gains nothing by it.
        """
        # p(y) = p(d) |∂d/∂y|: −2 ln p(y) has ln |Jᵀ J| = ln |normal| and ln |Σ| more than the quadratic form of d
        seen, spread = np.linalg.slogdet(self.frames[1].fit.normal)[1], np.linalg.slogdet(self._covariance)[1]
        return self.without_effects.score + float(seen + spread)

    def scores_with(self, columns: Array, candidates: Array) -> Array:
        """Return −2 ln evidence with each candidate alone beside the columns, (n,).

        It approximates the score of `explained`: cells are only added to the moved ones, never removed.

        Parameters
        ----------
        columns : array, shape (cells, k)
            a of the effects that the pair has.
        candidates : array, shape (cells, n)
            a of each candidate.
        """
        _, precision, added = self._with_columns(columns)
        return scores_with_errors(self.change, precision, candidates) + added + self._prior_score

    def off_by_one(self, score: float) -> bool:
        """Return whether the error of a single reading reaches a lower score than `score`.

        An outlier in the frame in which a load arrives is hard to detect in time.
        """
        return bool(np.any(self.scores_with(self.columns(()), LooseContact.prior * self.frames[1].fit.gain) < score))

    def _stepped(self, step: Array) -> "FittedPair | None":
        """Return the pair after a step of the effects' sizes; None where no cells explain the readings then.

        Sizes of effects that cannot be negative, such as leaks, are clipped at 0.

        Parameters
        ----------
        step : array, shape (effects,)
            In units of the priors.
        """
        sizes = (effect.size + effect.prior * float(more) for effect, more in zip(self.effects, step, strict=True))
        effects = tuple(
            replace(effect, size=max(size, 0.0) if effect.positive else size)
            for effect, size in zip(self.effects, sizes, strict=True)
        )
        constant, (resting, frame) = tuple(effect for effect in effects if not effect.since), self.frames
        early = resting.refitted(resting.readings, constant) if constant else resting
        late = frame.refitted(frame.readings, effects)
        if early is None or late is None:
            return None
        after = replace(self, frames=(early, late), effects=effects)
        return after if np.all(np.isfinite(after.change)) else None

    def settled(self, *, constant: bool = True) -> "tuple[FittedPair, Evidence] | None":
        """Return the pair with the most probable sizes of its effects, and the evidence; None where no cells fit.

        Parameters
        ----------
        constant : bool
            Whether the sizes of effects that the unloaded frames have, too, may change.
        """
        pair = self
        for _ in range(FIT.evaluations):
            evidence = pair.explained(pair.columns(pair.effects))
            free = np.array([constant or effect.since for effect in pair.effects])
            step, sd = np.where(free, evidence.size[1:], 0.0), evidence.sd[1:]
            if not np.isfinite(step).all():
                return None
            # Gauss-Newton step of θ, of at most one prior deviation; halved until cells explain both frames.
            short = step / max(1.0, float(np.abs(step).max()))
            after = next(filter(None, (pair._stepped(short * 0.5**half) for half in range(5))), None)
            if after is None:
                return None
            pair = after
            if np.all(np.abs(step) < SETTLED_STEP * np.maximum(sd, SETTLED_STEP)):
                break
        return pair, replace(pair.without_effects, sd=evidence.sd)

    def _without_late(self) -> tuple[Effect, ...]:
        """Return the effects, with those since the unloaded frames set to 0."""
        return tuple(replace(effect, size=0.0) if effect.since else effect for effect in self.effects)

    def at_rest(self) -> "FittedPair":
        """Return the pair with the unloaded panel as both frames, without the effects that came later."""
        return replace(self, frames=(self.frames[0],) * 2, effects=self._without_late())

    def of_frame(self, readings: Readings, *, late: bool) -> "FittedPair | None":
        """Return the pair with another frame in place of the loaded one; None where no cells explain it.

        Parameters
        ----------
        readings : Readings
            (rows, columns).
        late : bool
            Whether the sizes of effects since the unloaded frames are estimated anew in this frame. They are set to 0
            where the frame is no more probable with them.
        """
        pairs = []
        for effects in (self.effects, self._without_late()) if late else (self.effects,):
            frame = self.frames[1].refitted(readings, effects)
            if frame is None:
                return None
            pairs.append(replace(self, frames=(self.frames[0], frame), effects=effects))
        if not late:
            return pairs[0]
        settled, without = pairs[0].settled(constant=False), pairs[1].without_effects
        return pairs[1] if settled is None or without.score <= settled[1].score else settled[0]


@dataclass(frozen=True, eq=False)
class CircuitEffects:
    """Effects beside the circuit that a recording shows.

    Attributes
    ----------
    best : BetterExplanation
        All effects that are named.
    common_change : str
        The common change of all untouched cells in words; '' where it is not significant.
    pair : FittedPair or None
        The pair with the unambiguous effects alone, those that no other effect explains about as well.
    loaded_at_rest : bool
        Whether a load may lie on the unloaded panel.
    """

    best: BetterExplanation = field(default_factory=BetterExplanation)
    common_change: str = ""
    pair: FittedPair | None = None
    loaded_at_rest: bool = False

    @property
    def corrections(self) -> str:
        """Effects that are taken off the readings, in words."""
        names = [] if self.pair is None else [effect.sentence(self.pair.shape[0]) for effect in self.pair.effects]
        return f"{' and '.join(names)}: {TAKEN_OFF}"


def find_effects(pairs: Sequence[tuple[str, FittedPair]]) -> CircuitEffects:
    """Return the effects with the largest gain of evidence.

    Parameters
    ----------
    pairs : sequence of (str, FittedPair)
        Name of the frame, and its pair with the unloaded panel.
    """
    besides, together, most = CircuitEffects(), "", 0.0
    for name, pair in pairs:
        if not all(frame.readings.bounds.mean() <= MAX_BOUND_SHARE and frame.may_fit for frame in pair.frames):
            continue
        plain = pair.without_effects
        together = _together(plain) or together
        whole, after, certain = _grown(pair, plain)
        moved = after.moved.reshape(pair.shape)
        # An effect counts if most cells stand still with it, and neither a load's edge nor one wrong reading explains
        # as much.
        if not (plain.score - after.score > most and mostly_still(moved)):
            continue
        if any(_beside_a_load(effect, moved) for effect in whole.effects) or pair.off_by_one(
            after.score + MIN_EVIDENCE_GAIN
        ):
            continue
        most, fits_noise = plain.score - after.score, min(effect.fit.tail for effect in whole.frames) >= SIGNIFICANCE
        names = " and ".join(effect.sentence(pair.shape[0]) for effect in whole.effects)
        better = BetterExplanation(names, name, int(after.moved.sum()), int(plain.moved.sum()), fits_noise)
        besides = CircuitEffects(better, "", certain if certain.effects and fits_noise else None)
    return besides if besides.best.name else replace(besides, common_change=together)


def _grown(pair: FittedPair, evidence: Evidence) -> tuple[FittedPair, Evidence, FittedPair]:
    """Add effects to a pair one by one, while each gains MIN_EVIDENCE_GAIN and spares MIN_SPARED_CELLS moved cells.

    Returns
    -------
    FittedPair, Evidence
        With all effects.
    FittedPair
        With the unambiguous effects: those added before the first one that another candidate explains about as well,
        within half of MIN_EVIDENCE_GAIN.
    """
    certain, doubtful = pair, False
    for _ in range(MAX_CANDIDATES):
        tried = sorted(_tried(pair, evidence), key=lambda candidate: candidate[1].score)
        if not tried or evidence.score - tried[0][1].score <= MIN_EVIDENCE_GAIN:
            break
        if tried[0][1].moved.sum() > evidence.moved.sum() - MIN_SPARED_CELLS:
            break
        doubtful |= len(tried) > 1 and tried[1][1].score - tried[0][1].score < MIN_EVIDENCE_GAIN / 2
        pair, evidence = tried[0]
        certain = certain if doubtful else pair
    return pair, evidence, certain


def _tried(pair: FittedPair, plain: Evidence) -> Iterator[tuple[FittedPair, Evidence]]:
    """Generate the pairs with one more effect and their evidence, for the MAX_CANDIDATES best ones of linear theory."""
    effects = candidates(pair.shape)
    columns = pair.columns((*pair.effects, *effects))
    before, columns = np.split(columns, [len(pair.effects)], axis=1)
    scores = pair.scores_with(before, columns)
    for number in np.argsort(scores)[:MAX_CANDIDATES]:
        if scores[number] > plain.score - PARAMETER_COST:
            return
        settled = replace(pair, effects=(*pair.effects, replace(effects[number], size=0.0))).settled()
        if settled is not None:
            yield settled


def _beside_a_load(effect: Effect, moved: NDArray[np.bool_]) -> bool:
    """Return whether the edge of a load may look like this better contact: most cells of an adjacent line moved."""
    if not isinstance(effect, LooseContact) or effect.size > 0:
        return False
    line, rows = effect.lines[0], len(moved)
    side, at = (moved, line) if line < rows else (moved.T, line - rows)
    return any(2 * side[next_one].sum() > side.shape[1] for next_one in (at - 1, at + 1) if 0 <= next_one < len(side))


def _together(plain: Evidence) -> str:
    """Describe how all cells that no load touches changed; '' where that may be chance, or a load's rim."""
    change, sd = (float(ASSUMED.common_change * part[0]) for part in (plain.size, plain.sd))
    if not mostly_still(plain.moved) or not abs(change) > max(MIN_CHANGE, SIGNIFICANT * sd):
        return ""
    return (
        f"cells that nobody touched changed together by {100 * change:+.2g} +- {100 * sd:.1g} %: creep, temperature or "
        "the supply"
    )


def without_effects_of(pair: FittedPair, readings: Readings, unloaded: NDArray[np.bool_]) -> Readings:
    """Return the readings corrected for the pair's effects.

    Effects since the unloaded frames come, grow and go: their sizes are estimated anew in every measured frame. A
    frame that no cells explain takes the correction of the frame before. A leak reduces the differences between
    readings, so σ grows by `FittedFrame.amplification`.

    Parameters
    ----------
    pair : FittedPair
    readings : Readings
        (frames, rows, columns).
    unloaded : boolean array, shape (frames,)

    Returns
    -------
    Readings
        (frames, rows, columns).
    """
    assert readings.sigma is not None
    value, sigma = readings.value.copy(), readings.sigma.copy()
    late, pair_of_frame, number = any(effect.since for effect in pair.effects), pair.at_rest(), 0
    for frame in (*np.flatnonzero(unloaded)[:1], *np.flatnonzero(~unloaded)):
        if not unloaded[frame]:
            pair_of_frame, number = pair_of_frame.of_frame(readings[frame], late=late) or pair_of_frame, 1
        frames = frame if number else unloaded
        value[frames] -= pair_of_frame.frames[number].offset
        sigma[frames] *= pair_of_frame.frames[number].amplification
    return replace(readings, value=np.maximum(value, MIN_REMAINING * readings.value), sigma=sigma)


def remaining_errors(pair: FittedPair) -> Array:
    """Return the change of the readings by one posterior standard deviation of each effect, as a fraction of them.

    Returns
    -------
    array, shape (2, effects, rows, columns)
        Of the unloaded panel, then of the frame.
    """
    sd = pair.explained(pair.columns(pair.effects)).sd[1:]
    left = np.zeros((2, len(sd), *pair.shape))
    for place, (effect, deviation) in enumerate(zip(pair.effects, np.nan_to_num(sd), strict=True)):
        more = replace(effect, size=float(deviation) * effect.prior)
        for number in (1,) if effect.since else (0, 1):
            left[number, place] = pair.frames[number].more(more) / pair.frames[number].readings.value
    return left
