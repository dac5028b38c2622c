"""Effects that no circuit names, each one more parameter θ of the readings: named by its evidence, and estimated.

Between the unloaded panel and a frame the log cells change by d = a θ + noise where no load is, θ ~ N(0, prior²), with
a = K_f U_f − K_b U_b: U is the effect of a unit of θ on the readings, K the inverse of their Jacobian. The cells that
must have moved are counted with a in the model and without. The best effects are then put into the network itself, and
the cells and d found anew (Gauss and Newton). Wet lines leak, contacts loosen, films creep together.
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
MAX_CANDIDATES = 3  # rivals or effects: those that linear theory finds best; effects beside each other
SETTLED_STEP = 0.1  # standard deviations of θ at which its steps end, each within its prior's deviation
MAX_BOUND_SHARE = 0.02  # of the readings: cells behind bounds have no linear theory
MIN_SPARED_CELLS = 2  # cells that need not have moved with an effect: a converter's curve moves one
TAKEN_OFF = "taken off the readings, which error bars allow for"
SECANT_STEP = 1e-3  # of a prior
MIN_REMAINING = 0.1  # of a reading, whatever is taken off, however fast it changes


@dataclass(frozen=True, eq=False)
class BetterExplanation:
    """A better explanation of the readings than the scene's circuit: another one, or an effect beside it.

    Attributes
    ----------
    name : str
        '' where nothing does.
    count, count_as_specified : int
        Cells that have moved from the unloaded panel to frames (in words), with it and as specified.
    fits_noise : bool
        Whether cells give the readings of both within their noise.
    """

    name: str = ""
    frames: str = ""
    count: int = 0
    count_as_specified: int = 0
    fits_noise: bool = True

    @property
    def reason(self) -> str:
        """Reason why it is named."""
        counts = f"{self.count} cells have moved then, and {self.count_as_specified} as specified"
        if self.count >= self.count_as_specified:
            counts = f"the misfit is smaller, with {self.count} moved cells"
        return f"between the unloaded panel and {self.frames} {counts}"


def candidates(shape: tuple[int, ...]) -> list[Effect]:
    """Return all effects that are tried on a panel, constant or since the unloaded frames."""
    rows, columns = shape
    return [kind(lines, since) for since in (True, False) for kind in EFFECTS for lines in kind.places(rows, columns)]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of a pair with effects.

    Attributes
    ----------
    score : float
        −2 log evidence up to a constant.
    moved : array of bool, shape (cells,)
    size, sd : array, shape (1 + effects,)
        Of a common change, then of every effect beyond its present size, in units of the priors; NaN where no cell
        stands still.
    """

    score: float
    moved: NDArray[np.bool_]
    size: Array
    sd: Array


@dataclass(frozen=True, eq=False)
class FittedFrame:
    """Cells that explain a frame whose network has effects.

    Attributes
    ----------
    scene : Scene
    readings : Readings
        Of the frame, as measured.
    fit : CellsFit
        With the effects in the network.
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
        """Return the frame with other readings or effects, begun at its cells; None where no cells explain them."""
        fit = fitted(self.scene, given, self.fit.cells, patient=True, effects=effects)
        return None if fit is None else FittedFrame(self.scene, given, fit, effects)

    @cached_property
    def network(self) -> Network:
        """The network of its cells, without effects."""
        circuit = self.scene.circuit
        return circuit.network(self.fit.cells, circuit.ties(self.fit.readings.value), self.scene.wiring)

    @cached_property
    def channels(self) -> Array:
        """Effect of an ohm more in each line's channel on the log cells, (cells, lines)."""
        cells, measured = self.fit.cells, self.fit.readings.value
        errors = self.scene.circuit.shared_errors(cells, measured, self.scene, 0.0, 1.0)[1:]
        return self.fit.response(errors)

    @cached_property
    def offset(self) -> Array:
        """Sum of the effects on the readings, (rows, columns)."""
        return effect_on_readings(self.effects, self.scene, self.network)

    def more(self, effect: Effect) -> Array:
        """Return the change of the readings by one effect more, (rows, columns)."""
        return effect_on_readings((*self.effects, effect), self.scene, self.network) - self.offset

    @property
    def may_fit(self) -> bool:
        """Whether effects can leave no more than noise: by linear theory, of as many as are ever taken.

        Of the residual, the part that no cells follow is explained by one effect alone, and by MAX_CANDIDATES of them
        no more than so many times as much as by the best one.
        """
        if self.fit.tail >= SIGNIFICANCE:
            return True
        sigma = self.fit.readings.sigma
        assert sigma is not None
        small = [_small(effect) for effect in candidates(self.fit.cells.shape)]
        columns = np.stack([(self.more(effect) / sigma).ravel() for effect in dict.fromkeys(small)], axis=1)
        columns -= self.fit.jacobian @ np.linalg.solve(self.fit.normal, self.fit.jacobian.T @ columns)
        explained = (columns.T @ self.fit.residual) ** 2 / np.maximum(np.sum(columns**2, axis=0), 1e-300)
        return bool(MAX_CANDIDATES * explained.max() >= self.fit.chi_square - self.fit.degrees)

    def answers(self, effects: Sequence[Effect]) -> Array:
        """Return the effect of a unit of each θ on the log cells, (cells, effects), by secants."""
        small = [_small(effect) for effect in effects]
        each = {effect: self.more(effect) / SECANT_STEP for effect in dict.fromkeys(small)}
        return self.fit.response(np.stack([each[effect] for effect in small]))

    @property
    def amplification(self) -> Array:
        """The factor by which the readings' noise grows once the effects are taken off, (rows, columns)."""
        if all(effect.changed(self.network) is self.network for effect in self.effects):
            return np.ones(self.fit.cells.shape)
        assert self.fit.readings.sigma is not None
        dry = self.network.sensitivity() / self.fit.readings.sigma.reshape(-1, 1)
        variance = np.sum((dry @ self.fit.covariance) * dry, axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 1.0))).reshape(self.fit.cells.shape)


def _small(effect: Effect) -> Effect:
    """Return the effect of which a secant is taken."""
    return replace(effect, since=False, size=SECANT_STEP * effect.prior)


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The unloaded panel and a frame.

    Attributes
    ----------
    frames : tuple of two FittedFrame
    channels : array, shape (cells, lines)
        a of each line's channel, of one standard deviation.
    effects : tuple of Effect
        Of both frames.
    """

    frames: tuple[FittedFrame, FittedFrame]
    channels: Array
    effects: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, resting: FittedFrame, frame: FittedFrame) -> "FittedPair":
        """Return the pair with channels that differ as specified, or as those of one multiplexer do."""
        sizes = systematic_of(frame.scene)
        spread = (sizes and sizes.channel_spread_ohm) or ASSUMED.channel_ohm
        return cls((resting, frame), spread * (frame.channels - resting.channels))

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns of the panel."""
        return self.frames[1].fit.cells.shape

    @cached_property
    def change(self) -> Array:
        """d (cells)."""
        resting, frame = self.frames
        return np.asarray(np.log(frame.fit.cells / resting.fit.cells).ravel())

    @cached_property
    def _covariance(self) -> Array:
        """Covariance of d where no load is, (cells, cells)."""
        noise = sum(frame.fit.covariance for frame in self.frames) + ASSUMED.creep**2 * np.eye(len(self.change))
        return np.asarray(noise + self.channels @ self.channels.T)

    @cached_property
    def _precision(self) -> Array:
        return np.linalg.inv(self._covariance)

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Return a of each θ in units of its prior, (cells, effects)."""
        if not effects:
            return np.zeros((len(self.change), 0))
        resting, loaded = (frame.answers(effects) for frame in self.frames)
        return np.asarray(loaded - np.array([not effect.since for effect in effects]) * resting)

    @cached_property
    def _prior_score(self) -> float:
        """−2 log of the prior of the effects in the network."""
        return sum(PARAMETER_COST + (effect.size / effect.prior) ** 2 for effect in self.effects if effect.size)

    def _with_columns(self, columns: Array) -> tuple[Array, Array, float]:
        """Return a factor common to all cells with the columns, the precision of the change with both, and its log det.

        The last is the addition of both.
        """
        own = np.column_stack([np.full(len(self.change), ASSUMED.common_change), columns])
        weighted = self._precision @ own
        inner = np.eye(own.shape[1]) + own.T @ weighted
        precision = self._precision - weighted @ np.linalg.solve(inner, weighted.T)
        return own, precision, float(np.linalg.slogdet(inner)[1])

    def explained(self, columns: Array) -> Evidence:
        """Return the evidence with a factor that all cells share, and with effects' columns (cells, n)."""
        own, precision, added = self._with_columns(columns)
        lost, moved = select_changed(precision @ self.change, precision, usual_starts(self.change))
        score = float(self.change @ precision @ self.change) + lost + added + self._prior_score
        nothing = np.full(own.shape[1], np.nan)
        if moved.all():
            return Evidence(score, moved, nothing, nothing)
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
        """−2 log density of the frame's readings given the unloaded ones, up to a constant of all circuits.

        A circuit gains nothing by being blind: the Jacobian of its readings belongs to it.
        """
        seen, spread = np.linalg.slogdet(self.frames[1].fit.normal)[1], np.linalg.slogdet(self._covariance)[1]
        return self.without_effects.score + float(seen + spread)

    def scores_with(self, columns: Array, candidates: Array) -> Array:
        """Return −2 log evidence of `explained` with each of the candidates (cells, n) beside the columns.

        Moved cells are only added.
        """
        _, precision, added = self._with_columns(columns)
        return scores_with_errors(self.change, precision, candidates) + added + self._prior_score

    def off_by_one(self, score: float) -> bool:
        """Whether a single reading that is off explains to that score: an outlier as a load comes is hardly seen."""
        return bool(np.any(self.scores_with(self.columns(()), LooseContact.prior * self.frames[1].fit.gain) < score))

    def _stepped(self, step: Array) -> "FittedPair | None":
        """Return the pair a step (effects) in units of the priors further; None where no cells give the readings then.

        No leak is below zero.
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
        """Return the pair with the likeliest sizes of its effects, and the evidence; None without such cells.

        constant : whether those that are there in the unloaded frames are to change, too.
        """
        pair = self
        for _ in range(FIT.evaluations):
            evidence = pair.explained(pair.columns(pair.effects))
            free = np.array([constant or effect.since for effect in pair.effects])
            step, sd = np.where(free, evidence.size[1:], 0.0), evidence.sd[1:]
            if not np.isfinite(step).all():
                return None
            short = step / max(1.0, float(np.abs(step).max()))
            after = next(filter(None, (pair._stepped(short * 0.5**half) for half in range(5))), None)
            if after is None:
                return None
            pair = after
            if np.all(np.abs(step) < SETTLED_STEP * np.maximum(sd, SETTLED_STEP)):
                break
        return pair, replace(pair.without_effects, sd=evidence.sd)

    def _without_late(self) -> tuple[Effect, ...]:
        """Return the effects, those since the unloaded frames of no size."""
        return tuple(replace(effect, size=0.0) if effect.since else effect for effect in self.effects)

    def at_rest(self) -> "FittedPair":
        """Return the unloaded panel twice, before effects come that it has not."""
        return replace(self, frames=(self.frames[0],) * 2, effects=self._without_late())

    def of_frame(self, readings: Readings, *, late: bool) -> "FittedPair | None":
        """Return the pair with another frame, readings (rows, columns).

        late : whether effects since the unloaded frames have another size there.

        They have none where the frame is no likelier with them.
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
    """Effects beside the circuit.

    Attributes
    ----------
    best : BetterExplanation
        All effects that are named.
    common_change : str
        How all cells changed, in words; ''.
    pair : FittedPair or None
        With those effects alone that no others explain as well.
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
    """Return the effects of the frame that shows them best, of pairs of the unloaded panel and a named frame."""
    besides, together, most = CircuitEffects(), "", 0.0
    for name, pair in pairs:
        if not all(frame.readings.bounds.mean() <= MAX_BOUND_SHARE and frame.may_fit for frame in pair.frames):
            continue
        plain = pair.without_effects
        together = _together(plain) or together
        whole, after, certain = _grown(pair, plain)
        moved = after.moved.reshape(pair.shape)
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
    """Return the pair with one effect after the other that beats those before by MIN_EVIDENCE_GAIN, and its evidence.

    The third item is the pair with the effects before the first that another one explains about as well.
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
    """Return the pair with one effect more, each of the likeliest."""
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
    """Whether a load's edge may be taken for a better contact: most cells of a line next to it have moved."""
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
    """Return the readings (frames, rows, columns) of the same cells without the pair's effects, frame after frame.

    Those since the unloaded frames are estimated anew in every measured one: they come, grow and go. A frame of which
    no cells give the readings is taken as the one before. σ grows as leaks reduce the readings' differences.
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
    """Return one standard deviation of each effect as fractions of readings, (2, effects, rows, columns)."""
    sd = pair.explained(pair.columns(pair.effects)).sd[1:]
    left = np.zeros((2, len(sd), *pair.shape))
    for place, (effect, deviation) in enumerate(zip(pair.effects, np.nan_to_num(sd), strict=True)):
        more = replace(effect, size=float(deviation) * effect.prior)
        for number in (1,) if effect.since else (0, 1):
            left[number, place] = pair.frames[number].more(more) / pair.frames[number].readings.value
    return left
