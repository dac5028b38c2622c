"""Effects that no circuit names, each one more parameter of the readings with a prior, tested by its evidence.

Between the unloaded panel and a frame the log cells change by d = a θ + noise where no load is, θ ~ N(0, prior²), with
a = K_f U_f − K_b U_b: U is what a unit of θ does to the readings, K the inverse of their Jacobian. The cells that must
have moved are counted with a in the model and without. The best effect is then taken off the readings by the network
itself, and d found anew. Wet lines leak, contacts loosen, films creep together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import (
    CREEP,
    LEVEL,
    MARGIN,
    MOST_ASKED,
    PRICE,
    TOGETHER,
    CellsFit,
    fitted,
    mostly_still,
    selected,
)
from lampest.panel.leaks import leak_effect, neighbours
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.systematic import usual
from lampest.recording.readings import Readings

LEAK_OHM, CONTACT_OHM = 10e3, 100.0  # priors: water between lines, a contact that loosens
CHANNEL_OHM = 3.0  # standard deviation of a multiplexer's channels (CD74HC4067, data sheet: any two differ by 10 ohm)
STEPS, SETTLED = 8, 0.1  # of θ, by the network itself, and the standard deviations at which they end
MOST_BOUNDS = 0.02  # of the readings: cells behind bounds have no linear theory
NOTICED, SURE = 0.01, 5.0  # of log r, and standard deviations: a common change that is said


@dataclass(frozen=True)
class Nuisance:
    """One effect. kind : of it. lines : numbers of the lines, rows first; of a leak (pairs) between neighbours.

    since : whether it came after the unloaded frames. size : θ, siemens of a leak, ohm of a contact.
    """

    kind: Literal["leak", "contact"]
    lines: tuple[int, ...]
    since: bool
    size: float = 0.0

    @property
    def prior(self) -> float:
        """Standard deviation of θ."""
        return 1 / LEAK_OHM if self.kind == "leak" else CONTACT_OHM

    def effect(self, scene: Scene, network: Network, size: float) -> Array:
        """What θ = size does to the readings of cells, (rows, columns)."""
        rows, columns = network.conductance.shape
        circuit = scene.circuit
        if self.kind == "contact":
            more = size * np.isin(np.arange(rows + columns), self.lines)
            simulated = circuit.simulated(network.cell_resistance, scene, more[:rows], more[rows:])
            return np.asarray(circuit.from_recorded(simulated, scene) - network.reading())
        return leak_effect(circuit, network, self.lines, size)

    def column(self, scene: Scene, network: Network) -> Array:
        """U of θ in units of its prior, (readings): a secant."""
        step = 1e-3 * self.prior
        return self.effect(scene, network, step).ravel() * (self.prior / step)

    def named(self, rows: int) -> str:
        """In words, with its size."""
        since = ", since the unloaded frames" if self.since else ""
        first = f"row {self.lines[0]}" if self.lines[0] < rows else f"column {self.lines[0] - rows}"
        if self.kind == "contact":
            more = "more" if self.size > 0 else "less"
            return f"{float(f'{abs(self.size):.2g}'):g} ohm {more} at the contact of {first}{since}"
        where = f"{first} and the next one" if len(self.lines) == 1 else "neighbouring lines"
        return f"a leak of {1e-3 / self.size:.2g} kohm between {where}{since}"


def nuisances(shape: tuple[int, int]) -> Iterator[Nuisance]:
    """All that are tried on a panel."""
    rows, columns = shape
    pairs = neighbours(rows, columns)
    for since in (True, False):
        yield Nuisance("leak", pairs, since)
        yield from (Nuisance("leak", (line,), since) for line in pairs)
        yield from (Nuisance("contact", (line,), since) for line in range(rows + columns))


@dataclass(frozen=True, eq=False)
class Evidence:
    """score : −2 log evidence up to a constant. moved : (cells). size, sd : θ in units of its prior.

    fits_noise : whether cells give the readings of both within their noise.
    """

    score: float
    moved: NDArray[np.bool_]
    size: float
    sd: float
    fits_noise: bool

    @property
    def count(self) -> int:
        """How many cells have moved."""
        return int(self.moved.sum())


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The unloaded panel and a frame. given : their readings. fits : of these, or of what an effect leaves of them.

    channels : (cells, lines) a of each line's channel, of one standard deviation.
    """

    scene: Scene
    given: tuple[Readings, Readings]
    fits: tuple[CellsFit, CellsFit]
    channels: Array

    @classmethod
    def of(cls, scene: Scene, resting: CellsFit, frame: CellsFit) -> "FittedPair":
        """With channels that differ as specified, or as those of one multiplexer do."""
        bare = cls(scene, (resting.readings, frame.readings), (resting, frame), np.zeros((frame.cells.size, 0)))
        sizes = usual(scene)
        spread = (CHANNEL_OHM if sizes is None else sizes.channel_spread_ohm or CHANNEL_OHM) / CONTACT_OHM
        lines = range(sum(frame.cells.shape))
        columns = [spread * bare.column(Nuisance("contact", (line,), since=False)) for line in lines]
        return replace(bare, channels=np.stack(columns, axis=1))

    @cached_property
    def change(self) -> Array:
        """d (cells)."""
        return np.asarray(np.log(self.fits[1].cells / self.fits[0].cells).ravel())

    @cached_property
    def covariance(self) -> Array:
        """Of d where no load is, (cells, cells)."""
        noise = sum(np.linalg.inv(fit.normal) for fit in self.fits) + CREEP**2 * np.eye(len(self.change))
        return np.asarray(noise + self.channels @ self.channels.T)

    @cached_property
    def precision(self) -> Array:
        """Its inverse."""
        return np.linalg.inv(self.covariance)

    @cached_property
    def networks(self) -> tuple[Network, ...]:
        """Of both fits."""
        circuit, wiring = self.scene.circuit, self.scene.wiring
        return tuple(circuit.network(fit.cells, circuit.ties(fit.readings.value), wiring) for fit in self.fits)

    def explained(self, nuisance: Nuisance | None = None, briefly: bool = False) -> Evidence:
        """With a factor that all cells share, and with an effect or without; briefly : cells are only added."""
        own = np.full((len(self.change), 1), TOGETHER)
        if nuisance is not None:
            own = np.column_stack([own, self.column(nuisance)])
        weighted = self.precision @ own
        inner = np.eye(own.shape[1]) + own.T @ weighted
        precision = self.precision - weighted @ np.linalg.solve(inner, weighted.T)
        lost, moved = selected(precision @ self.change, precision, briefly)
        score = float(self.change @ precision @ self.change) + lost + float(np.linalg.slogdet(inner)[1])
        if briefly or moved.all():
            return Evidence(score, moved, np.nan, np.nan, False)
        still = ~moved
        within = np.linalg.solve(self.covariance[np.ix_(still, still)], own[still])
        left = np.linalg.inv(np.eye(own.shape[1]) + own[still].T @ within)
        theta = left @ within.T @ self.change[still]
        fits_noise = min(fit.tail for fit in self.fits) >= LEVEL
        return Evidence(score, moved, float(theta[-1]), float(np.sqrt(left[-1, -1])), fits_noise)

    def column(self, nuisance: Nuisance) -> Array:
        """a (cells) of an effect, where it is."""
        parts = []
        for fit, network in zip(self.fits, self.networks, strict=True):
            assert fit.readings.sigma is not None
            read = nuisance.column(self.scene, network) / fit.readings.sigma.ravel()
            parts.append(np.linalg.solve(fit.normal, fit.jacobian.T @ read))
        return np.asarray(parts[1] if nuisance.since else parts[1] - parts[0])

    def without(self, nuisance: Nuisance) -> "FittedPair | None":
        """The pair once an effect is taken off the readings; None where no cells give the rest."""
        found = []
        for number, (fit, network, given) in enumerate(zip(self.fits, self.networks, self.given, strict=True)):
            taken = given.value
            if number or not nuisance.since:
                taken = taken - nuisance.effect(self.scene, network, nuisance.size)
            one = fit if taken is given.value else fitted(self.scene, replace(given, value=taken), fit.cells)
            found.append(one)
        resting, frame = found
        return None if resting is None or frame is None else replace(self, fits=(resting, frame))


@dataclass(frozen=True)
class Besides:
    """What is there beside the circuit. name : of the effect, or ''. count, plain : cells that have moved with it, and
    without. fits_noise : see `Evidence`. frames : in words. together : how all cells changed, in words, or ''.
    """

    name: str = ""
    count: int = 0
    plain: int = 0
    fits_noise: bool = False
    frames: str = ""
    together: str = ""

    @property
    def reason(self) -> str:
        """Why it is named."""
        return (
            f"between the unloaded panel and {self.frames} {self.count} cells have moved then, and {self.plain} as "
            "specified"
        )


def besides_the_circuit(scene: Scene, resting: CellsFit, frames: Sequence[tuple[str, CellsFit]]) -> Besides:
    """What the fits of the unloaded panel and of frames, each with its name, show; the likeliest effect of all.

    Effects are tried by linear theory, the best ones by the network.
    """
    found, together, most = Besides(), "", MARGIN
    for name, frame in frames:
        if max(float(fit.readings.bounds.mean()) for fit in (resting, frame)) > MOST_BOUNDS:
            continue
        pair = FittedPair.of(scene, resting, frame)
        plain = pair.explained()
        together = _together(plain) or together
        effects = list(nuisances(frame.cells.shape))
        scores = np.array([pair.explained(one, briefly=True).score for one in effects])
        for number in np.argsort(scores)[:MOST_ASKED]:
            refined = _refined(pair, effects[number])
            if refined is None:
                continue
            nuisance, after = refined
            if not mostly_still(after.moved) or after.count >= plain.count:
                continue
            if plain.score - after.score > most:
                most = plain.score - after.score
                words = nuisance.named(scene.panel.rows)
                found = Besides(words, after.count, plain.count, after.fits_noise, name)
    return replace(found, together="" if found.name else together)


def _together(plain: Evidence) -> str:
    """How all cells that no load touches changed, in words; '' where that may be chance, or a load's rim."""
    change, sd = TOGETHER * plain.size, TOGETHER * plain.sd
    if not mostly_still(plain.moved) or not abs(change) > max(NOTICED, SURE * sd):
        return ""
    return (
        f"cells that nobody touched changed together by {100 * change:+.2g} +- {100 * sd:.1g} %: creep, temperature or "
        "the supply"
    )


def _refined(pair: FittedPair, nuisance: Nuisance) -> tuple[Nuisance, Evidence] | None:
    """The effect with its size, by the network; None where no cells give the rest."""
    for _ in range(STEPS):
        found = pair.explained(nuisance)
        if np.isnan(found.size):
            return None
        tried = _stepped(pair, nuisance, found.size * nuisance.prior)
        if tried is None:
            return None
        pair, nuisance = tried
        if abs(found.size) < SETTLED * max(found.sd, SETTLED):
            break
    if nuisance.size == 0:
        return None
    found = pair.explained()
    return nuisance, replace(found, score=found.score + PRICE + (nuisance.size / nuisance.prior) ** 2)


def _stepped(pair: FittedPair, nuisance: Nuisance, step: float) -> tuple[FittedPair, Nuisance] | None:
    """The pair and its effect a step of θ further, halved until cells give the rest; None where they never do."""
    for part in step * 0.5 ** np.arange(5):
        size = nuisance.size + float(part)
        there = replace(nuisance, size=max(size, 0.0) if nuisance.kind == "leak" else size)
        after = pair.without(there)
        if after is not None and np.all(np.isfinite(after.change)):
            return after, there
    return None
