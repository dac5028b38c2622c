"""Effects beside the circuit: leaks of wet lines, loose contacts, common creep of the film.

Each effect adds one parameter θ ~ N(0, prior²) to the readings. Between the unloaded panel b and a
frame f the log cells that no load touches change by

    d = a θ + noise,   a = K_f U_f − K_b U_b,

where U is the response of the readings to a unit of θ, and K the inverse of their Jacobian. The
evidence is computed with a and without (`lampest.estimate.changed_cells`). The best effects then
enter the network itself; the cells, d and θ are estimated again by Gauss-Newton steps. An effect is
named if the evidence gains by MIN_EVIDENCE_GAIN.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.assumptions import ASSUMED
from lampest.estimate.cells_fit import FIT, CellsFit
from lampest.estimate.changed_cells import (
    PARAMETER_COST,
    Changes,
    away_from_changed,
    mostly_still,
    scores_with_errors,
    touching,
    usual_starts,
)
from lampest.files.levels import SIGNIFICANCE, SIGNIFICANT
from lampest.panel.effects import EFFECTS, Effect, LooseContact
from lampest.panel.panel import Array
from lampest.panel.systematic import REFERENCE, SERIES, error_columns, systematic_of
from lampest.recording.readings import Readings
from lampest.recording.recording import MIN_CHANGE

# In −2 ln evidence, of another circuit, an effect or an error of the model. 430 recordings with the
# right circuit gain 32 at most, and nearly all less than 15; of 500 others two gain more
# (docs/theory/model_check.md). By an error of the model mouths at their limits gain 23 where
# nothing is wrong, and 76 where readings are off by 7 % each.
MIN_EVIDENCE_GAIN = 36.0
# Rivals or effects that are solved exactly, the best ones of linear theory; effects at a time.
MAX_CANDIDATES = 3
SETTLED_STEP = 0.1  # step of θ in standard deviations below which the iteration ends
# Fewer moved cells that an effect must bring: a converter's nonlinearity moves one.
MIN_SPARED_CELLS = 2
TAKEN_OFF = "taken off the readings"
SECANT_STEP = 1e-3  # of the prior's standard deviation
MIN_REMAINING = 0.1  # of a reading: the lower limit of a corrected reading


@dataclass(frozen=True, eq=False)
class BetterExplanation:
    """A better explanation of the readings than the scene's circuit.

    It is another circuit, or an effect beside it.

    Attributes
    ----------
    name : str
        The circuit or the effects in words; '' where nothing explains the readings better.
    frames : str
        The loaded frames in words.
    count, count_as_specified : int
        Moved cells between the unloaded panel and these frames: under the better explanation, and
        under the scene's circuit.
    fits_noise : bool
        Whether cells explain the readings of the unloaded panel and of the frames within their
        noise.
    nearly : str
        A circuit in words that explains the readings better, but not significantly; ''.
    """

    name: str = ""
    frames: str = ""
    count: int = 0
    count_as_specified: int = 0
    fits_noise: bool = True
    nearly: str = ""

    @property
    def reason(self) -> str:
        """The reason why it is named, in words."""
        counts = f"{self.count} cells have moved then, and {self.count_as_specified} as specified"
        if self.count >= self.count_as_specified:
            counts = f"the misfit is smaller, with {self.count} moved cells"
        return f"between the unloaded panel and {self.frames} {counts}"


def candidates(shape: tuple[int, ...], kinds: Sequence[type[Effect]] = EFFECTS) -> list[Effect]:
    """Return all effects that are tried on a panel.

    Those since the unloaded frames come first, then the constant ones.
    """
    rows, columns = shape
    return [
        kind(lines, since)
        for since in (True, False)
        for kind in kinds
        for lines in kind.places(rows, columns)
    ]


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
        Posterior mean and standard deviation of the common change, then of the addition to every
        effect's present size, in units of the priors; NaN where no cell stands still.
    """

    score: float
    moved: NDArray[np.bool_]
    size: Array
    sd: Array


def responses(fit: CellsFit, effects: Sequence[Effect]) -> Array:
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
    channels : array, shape (cells, lines)
        Change a of the log cells by one ohm more in each line's channel.
    """

    frames: tuple[CellsFit, CellsFit]
    channels: Array

    @classmethod
    def of(cls, resting: CellsFit, frame: CellsFit) -> "FittedPair":
        """Return the pair of both fits."""
        responses = [
            fit.response(
                fit.scene.circuit.shared_errors(fit.cells, fit.readings.value, fit.scene, 0.0, 1.0)[
                    1:
                ]
            )
            for fit in (resting, frame)
        ]
        return cls((resting, frame), responses[1] - responses[0])

    @property
    def scale_error(self) -> float | None:
        """Median error of the changes d of moved cells by the numbers that no frame shows.

        The numbers are at their tolerances' ends. None where the scene has no such numbers, or no
        cell moves.
        """
        scene = self.frames[0].scene
        if (sizes := systematic_of(scene)) is None or not self.moved.any():
            return None
        resting, loaded = (
            fit.response(
                error_columns((REFERENCE, SERIES), fit.network, fit.readings.value, scene, sizes)
            )
            for fit in self.frames
        )
        # columns are of one standard deviation: that of the reference's uniform distribution is its
        # half width over √3
        ends = np.array([np.sqrt(3), *[1.0] * (loaded.shape[1] - 1)])
        return float(np.median(np.abs((loaded - resting) * ends).sum(axis=1)[self.moved.ravel()]))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects in the network of the frame.

        Those that are constant are in that of the unloaded panel, too.
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
        return np.asarray(np.log(frame.cells / resting.cells).ravel())

    @cached_property
    def covariance(self) -> Array:
        """Covariance Σ of d where no load is, (cells, cells).

        It is without effects and without a common change.
        """
        # Σ = P_b + P_f + creep² 1 + spread² channels channelsᵀ; the spread is the scene's, or else
        # one multiplexer's
        sizes = systematic_of(self.frames[1].scene)
        spread = float((sizes and sizes.channel_spread_ohm) or ASSUMED.channel_ohm)
        noise = sum(frame.covariance for frame in self.frames) + ASSUMED.creep**2 * np.eye(
            len(self.change)
        )
        return np.asarray(noise + spread**2 * self.channels @ self.channels.T)

    @cached_property
    def _volume(self) -> float:
        """ln |Σ|."""
        return float(np.linalg.slogdet(self.covariance)[1])

    def columns(self, effects: Sequence[Effect]) -> Array:
        """Return a = K_f U_f − K_b U_b of each θ in units of its prior, (cells, effects).

        An effect since the unloaded frames changes only the frame: K_b U_b is 0.
        """
        if not effects:
            return np.zeros((len(self.change), 0))
        resting, loaded = (responses(frame, effects) for frame in self.frames)
        return np.asarray(loaded - np.array([not effect.since for effect in effects]) * resting)

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
    def _prior(self) -> float:
        """−2 ln prior of the effects in the network, less ln |Σ|."""
        costs = (
            PARAMETER_COST + (effect.size / effect.prior) ** 2
            for effect in self.effects
            if effect.size
        )
        return sum(costs) - self._volume

    def explained(self, columns: Array) -> Evidence:
        """Return the evidence with a common change of all cells and with further effects.

        See `with_columns`.
        """
        changes = self.with_columns(columns)
        score, moved = changes.selected(usual_starts(self.change))
        mean = sd = np.full(1 + columns.shape[1], np.nan)
        if not moved.all():
            mean, covariance = changes.posterior(away_from_changed(~moved, self.shape))
            sd = np.sqrt(np.diag(covariance))
        return Evidence(score + self._prior, moved, mean, sd)

    @cached_property
    def evidence(self) -> Evidence:
        """The evidence without further effects."""
        return self.explained(self.columns(()))

    @property
    def moved(self) -> NDArray[np.bool_]:
        """The moved cells with the largest evidence, boolean (rows, columns)."""
        return self.evidence.moved.reshape(self.shape)

    def scores_with(self, effects: Sequence[Effect], candidates: Array) -> Array:
        """Return −2 ln evidence with each candidate alone beside further sizes of effects, (n,).

        It approximates the score of `explained`: cells are only added to the moved ones, never
        removed.

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

        It holds up to a constant common to all circuits. The densities of circuits are comparable
        because the Jacobian of the readings is included: a circuit whose readings hardly depend on
        the cells gains nothing by it.
        """
        # p(y) = p(d) |∂d/∂y|: −2 ln p(y) has ln |Jᵀ J| = ln |normal| and ln |Σ| more than the
        # quadratic form of d
        return (
            self.evidence.score + float(np.linalg.slogdet(self.frames[1].normal)[1]) + self._volume
        )

    @cached_property
    def _misfit(self) -> tuple[float, int]:
        """χ² of the changes of the still cells, and the number of these cells."""
        still = ~self.evidence.moved
        return self.with_columns(self.columns(())).part(still).misfit, int(still.sum())

    @property
    def beyond_noise(self) -> float:
        """The score less the misfit of the still cells as far as noise is expected to have it."""
        return self.evidence.score - min(self._misfit)

    def beyond_noise_of(self, cells: NDArray[np.bool_]) -> float:
        """Return −2 ln evidence of these cells alone, beyond that of noise."""
        changes = self.with_columns(self.columns(())).part(cells)
        score, moved = changes.selected(usual_starts(changes.change))
        score += self._prior + self._volume - float(np.linalg.slogdet(changes.noise)[1])
        return score - min(changes.part(~moved).misfit, int((~moved).sum()))

    def gain_apart(self, better: "FittedPair") -> float:
        """Return the gain of another explanation in −2 ln evidence.

        It is computed by cells that touch none of its moved cells. The skirt of a load looks like
        another circuit or an effect, so its cells do not count; 0 without two others.
        """
        distant = ~touching(better.moved[None]).ravel()
        return (
            self.beyond_noise_of(distant) - better.beyond_noise_of(distant)
            if distant.sum() > 1
            else 0.0
        )

    @property
    def excess(self) -> float:
        """Misfit of the still cells over that of noise alone, at least 1."""
        misfit, still = self._misfit
        return max(misfit / max(still, 1), 1.0)

    def _stepped(self, effects: Sequence[Effect], step: Array) -> "FittedPair | None":
        """Return the pair after a step of the effects' sizes.

        None where no cells explain the readings then. Sizes of effects that cannot be negative,
        such as leaks, are clipped at 0.

        Parameters
        ----------
        effects : sequence of Effect
        step : array, shape (effects,)
            In units of the priors.
        """
        stepped = tuple(
            replace(
                effect,
                size=max(
                    effect.size + effect.prior * float(more), 0.0 if effect.positive else -np.inf
                ),
            )
            for effect, more in zip(effects, step, strict=True)
        )
        constant = tuple(effect for effect in stepped if not effect.since)
        resting, frame = self.frames
        early = resting.refitted(resting.measured, constant) if constant else resting
        late = frame.refitted(frame.measured, stepped)
        return None if early is None or late is None else replace(self, frames=(early, late))

    def settled(self, effects: Sequence[Effect], *, constant: bool = True) -> "FittedPair | None":
        """Return the pair with the most probable sizes of these effects; None where no cells fit.

        Parameters
        ----------
        effects : sequence of Effect
            Effects of the pair, then further ones of size 0.
        constant : bool
            Whether the sizes of effects that the unloaded frames have, too, may change.
        """
        pair = self
        for _ in range(FIT.evaluations):
            evidence = pair.explained(pair.columns(effects))
            free = np.array([constant or effect.since for effect in effects])
            step = np.where(free, evidence.size[1:], 0.0)
            sd = evidence.sd[1:]
            if not np.isfinite(step).all():
                return None
            # Gauss-Newton step of θ, of at most one prior deviation; halved until cells explain
            # both frames.
            short = step / max(1.0, float(np.abs(step).max()))
            after = next(
                filter(None, (pair._stepped(effects, short * 0.5**half) for half in range(5))), None
            )
            if after is None:
                return None
            pair = after
            effects = after.effects
            if np.all(np.abs(step) < SETTLED_STEP * np.maximum(sd, SETTLED_STEP)):
                break
        return pair

    def frame_like(self, readings: Readings, near: CellsFit) -> CellsFit | None:
        """Return the fit of another frame with these effects; None where no cells explain it.

        The sizes of effects since the unloaded frames are estimated anew. They are 0 where the
        frame is no more probable with them.

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
        settled = replace(self, frames=(self.frames[0], begun)).settled(
            near.effects, constant=False
        )
        without = replace(self, frames=(self.frames[0], fit))
        if settled is None or without.evidence.score <= settled.evidence.score:
            return fit
        return settled.frames[1]


def without_late(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects, with those since the unloaded frames set to 0."""
    return tuple(replace(effect, size=0.0) if effect.since else effect for effect in effects)


@dataclass(frozen=True, eq=False)
class CircuitEffects(BetterExplanation):
    """Effects beside the circuit that a recording shows.

    Attributes
    ----------
    common_change : str
        The common change of all untouched cells in words; '' where it is not significant.
    pair : FittedPair or None
        The pair with the unambiguous effects alone, those that no other effect explains about as
        well.
    loaded_at_rest : bool
        Whether a load may lie on the unloaded panel.
    """

    common_change: str = ""
    pair: FittedPair | None = None
    loaded_at_rest: bool = False

    @property
    def corrections(self) -> str:
        """Effects that are taken off the readings, in words."""
        names = (
            []
            if self.pair is None
            else [effect.sentence(self.pair.shape[0]) for effect in self.pair.effects]
        )
        return f"{' and '.join(names)}: {TAKEN_OFF}"


def find_effects(
    pairs: Sequence[tuple[str, FittedPair]], kinds: Sequence[type[Effect]] = EFFECTS
) -> CircuitEffects:
    """Return the effects with the largest gain of evidence.

    Parameters
    ----------
    pairs : sequence of (str, FittedPair)
        Name of the frame, and its pair with the unloaded panel.
    kinds : sequence of type
        Kinds of effects that are searched for.
    """
    besides = CircuitEffects()
    common = ""
    most = 0.0
    for name, pair in pairs:
        common = _together(pair) or common
        grown, certain = _grown(pair, kinds)
        gain = pair.evidence.score - grown.evidence.score
        # An effect counts if most cells stand still with it, and neither a load's edge nor one
        # wrong reading explains as much: an outlier in the frame in which a load arrives is hard to
        # detect in time.
        if not (gain > most and mostly_still(grown.moved)):
            continue
        off_by_one = pair.scores_with((), LooseContact.prior * pair.frames[1].gain).min()
        if off_by_one < grown.evidence.score + MIN_EVIDENCE_GAIN or pair.gain_apart(grown) <= 0:
            continue
        most = gain
        fits_noise = min(fit.tail for fit in grown.frames) >= SIGNIFICANCE
        names = " and ".join(effect.sentence(pair.shape[0]) for effect in grown.effects)
        counts = (int(grown.moved.sum()), int(pair.moved.sum()))
        taken_off = bool(certain.effects) and fits_noise
        besides = CircuitEffects(
            names, name, *counts, fits_noise, pair=certain if taken_off else None
        )
    return besides if besides.name else replace(besides, common_change=common)


def _grown(pair: FittedPair, kinds: Sequence[type[Effect]]) -> tuple[FittedPair, FittedPair]:
    """Add effects to a pair one by one, while each gains evidence and spares moved cells.

    Each has to gain MIN_EVIDENCE_GAIN and to spare MIN_SPARED_CELLS moved cells.

    Returns
    -------
    FittedPair
        With all effects.
    FittedPair
        With the unambiguous effects: those added before the first one that another candidate
        explains about as well, within half of MIN_EVIDENCE_GAIN.
    """
    certain = pair
    doubtful = False
    for _ in range(MAX_CANDIDATES):
        tried = sorted(_tried(pair, kinds), key=lambda candidate: candidate.evidence.score)
        if not tried or pair.evidence.score - tried[0].evidence.score <= MIN_EVIDENCE_GAIN:
            break
        if tried[0].moved.sum() > pair.moved.sum() - MIN_SPARED_CELLS:
            break
        doubtful |= (
            len(tried) > 1
            and tried[1].evidence.score - tried[0].evidence.score < MIN_EVIDENCE_GAIN / 2
        )
        pair = tried[0]
        certain = certain if doubtful else pair
    return pair, certain


def _tried(pair: FittedPair, kinds: Sequence[type[Effect]]) -> Iterator[FittedPair]:
    """Generate the pairs with one more effect.

    They are those of the MAX_CANDIDATES best effects of linear theory.
    """
    effects = candidates(pair.shape, kinds)
    scores = pair.scores_with(pair.effects, pair.columns(effects))
    for number in np.argsort(scores)[:MAX_CANDIDATES]:
        if scores[number] > pair.evidence.score - PARAMETER_COST:
            return
        settled = pair.settled((*pair.effects, effects[number]))
        if settled is not None:
            yield settled


def _together(pair: FittedPair) -> str:
    """Describe how all cells that no load touches changed.

    '' where that may be chance, or a load's rim.
    """
    change, sd = (
        float(ASSUMED.common_change * part[0]) for part in (pair.evidence.size, pair.evidence.sd)
    )
    if not mostly_still(pair.moved) or not abs(change) > max(MIN_CHANGE, SIGNIFICANT * sd):
        return ""
    return (
        f"cells that nobody touched changed together by {100 * change:+.2g} +- {100 * sd:.1g} %: "
        "creep, temperature or "
        "the supply"
    )


def without_effects_of(
    pair: FittedPair, readings: Readings, unloaded: NDArray[np.bool_]
) -> Readings:
    """Return the readings corrected for the pair's effects.

    Effects since the unloaded frames come, grow and go: their sizes are estimated anew in every
    measured frame. A frame that no cells explain takes the correction of the frame before. A leak
    reduces the differences between readings, so σ grows by `CellsFit.amplification`.

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
    value = readings.value.copy()
    sigma = readings.known_sigma.copy()
    resting = pair.frames[0]
    fit = replace(resting, effects=without_late(pair.effects))
    frames = np.flatnonzero(~unloaded)
    for numbers in (unloaded, *frames):
        if numbers is not unloaded:
            fit = pair.frame_like(readings[numbers], fit) or fit
        value[numbers] -= fit.offset
        sigma[numbers] *= fit.amplification
    return replace(readings, value=np.maximum(value, MIN_REMAINING * readings.value), sigma=sigma)


def remaining_errors(pair: FittedPair) -> Array:
    """Return the change of the readings by one posterior standard deviation of each effect.

    It is a fraction of the readings.

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
            left[number, place] = (
                pair.frames[number].more(more) / pair.frames[number].measured.value
            )
    return left
