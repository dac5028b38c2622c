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

from lampest.estimate.cells_fit import CREEP, LEVEL, PRICE, TOGETHER, CellsFit, fitted, mostly_still, selected
from lampest.estimate.rivals import MOVED
from lampest.panel.leaks import leak_effect, neighbours
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.panel.systematic import usual
from lampest.recording.readings import Readings

# −2 log probability by which another circuit, or an effect beside it, must beat the scene's: e^18 to one. The best of
# eight kinds, with any resistance in series, beat a right one by 32, 25 and 19 in three of some 430 recordings, else by
# 15 or less.
MARGIN = 36.0
MOST_ASKED = 3  # rivals or effects: those that linear theory finds best
LEAK_OHM, CONTACT_OHM = 10e3, 100.0  # priors: water between lines, a contact that loosens
CHANNEL_OHM = 3.0  # standard deviation of a multiplexer's channels (CD74HC4067, data sheet: any two differ by 10 ohm)
STEPS, SETTLED = 8, 0.1  # of θ, by the network itself, and the standard deviations at which they end
MOST_BOUNDS = 0.02  # of the readings: cells behind bounds have no linear theory
SURE = 5.0  # standard deviations: a common change that is said


@dataclass(frozen=True, eq=False)
class Better:
    """What explains readings better than the scene's circuit: another one, or an effect beside it.

    name : '' where nothing does. count, plain : cells that have moved from the unloaded panel to frames (in words),
    with it and as specified. fits_noise : whether cells give the readings of both within their noise.
    """

    name: str = ""
    frames: str = ""
    count: int = 0
    plain: int = 0
    fits_noise: bool = True

    @property
    def reason(self) -> str:
        """Why it is named."""
        counts = f"{self.count} cells have moved then, and {self.plain} as specified"
        return f"between the unloaded panel and {self.frames} {counts}"


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
        circuit, (rows, columns) = scene.circuit, network.conductance.shape
        if self.kind == "leak":
            return leak_effect(circuit, network, self.lines, size)
        more = size * np.isin(np.arange(rows + columns), self.lines)
        simulated = circuit.simulated(network.cell_resistance, scene, more[:rows], more[rows:])
        return np.asarray(circuit.from_recorded(simulated, scene) - network.reading())

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
    pairs = neighbours(*shape)
    for since in (True, False):
        yield Nuisance("leak", pairs, since)
        yield from (Nuisance("leak", (line,), since) for line in pairs)
        yield from (Nuisance("contact", (line,), since) for line in range(sum(shape)))


@dataclass(frozen=True, eq=False)
class Evidence:
    """score : −2 log evidence up to a constant. moved : (cells). size, sd : the last θ in units of its prior."""

    score: float
    moved: NDArray[np.bool_]
    size: float = np.nan
    sd: float = np.nan


@dataclass(frozen=True, eq=False)
class FittedPair:
    """The unloaded panel and a frame. given : their readings. fits : of what the nuisance, if any, leaves of them.

    channels : (cells, lines) a of each line's channel, of one standard deviation.
    """

    scene: Scene
    given: tuple[Readings, ...]
    fits: tuple[CellsFit, ...]
    channels: Array
    nuisance: Nuisance | None = None

    @classmethod
    def of(cls, scene: Scene, *fits: CellsFit) -> "FittedPair":
        """With channels that differ as specified, or as those of one multiplexer do."""
        bare = cls(scene, tuple(fit.readings for fit in fits), fits, np.zeros((fits[0].cells.size, 0)))
        sizes = usual(scene)
        spread = (CHANNEL_OHM if sizes is None else sizes.channel_spread_ohm or CHANNEL_OHM) / CONTACT_OHM
        contacts = (Nuisance("contact", (line,), since=False) for line in range(sum(scene.panel.shape)))
        return replace(bare, channels=spread * np.stack([bare.column(one) for one in contacts], axis=1))

    @cached_property
    def change(self) -> Array:
        """d (cells)."""
        return np.asarray(np.log(self.fits[1].cells / self.fits[0].cells).ravel())

    @cached_property
    def _covariance(self) -> Array:
        """Of d where no load is, (cells, cells)."""
        noise = sum(np.linalg.inv(fit.normal) for fit in self.fits) + CREEP**2 * np.eye(len(self.change))
        return np.asarray(noise + self.channels @ self.channels.T)

    @cached_property
    def _precision(self) -> Array:
        return np.linalg.inv(self._covariance)

    @cached_property
    def _networks(self) -> tuple[Network, ...]:
        circuit, wiring = self.scene.circuit, self.scene.wiring
        return tuple(circuit.network(fit.cells, circuit.ties(fit.readings.value), wiring) for fit in self.fits)

    def explained(self, nuisance: Nuisance | None = None, briefly: bool = False) -> Evidence:
        """With a factor that all cells share, and with a further effect or without; briefly : cells are only added."""
        own = np.full((len(self.change), 1), TOGETHER)
        if nuisance is not None:
            own = np.column_stack([own, self.column(nuisance)])
        weighted = self._precision @ own
        inner = np.eye(own.shape[1]) + own.T @ weighted
        precision = self._precision - weighted @ np.linalg.solve(inner, weighted.T)
        lost, moved = selected(precision @ self.change, precision, briefly)
        score = float(self.change @ precision @ self.change) + lost + float(np.linalg.slogdet(inner)[1])
        if self.nuisance is not None:
            score += PRICE + (self.nuisance.size / self.nuisance.prior) ** 2
        if briefly or moved.all():
            return Evidence(score, moved)
        still = ~moved
        within = np.linalg.solve(self._covariance[np.ix_(still, still)], own[still])
        left = np.linalg.inv(np.eye(own.shape[1]) + own[still].T @ within)
        theta = left @ within.T @ self.change[still]
        return Evidence(score, moved, float(theta[-1]), float(np.sqrt(left[-1, -1])))

    def column(self, nuisance: Nuisance) -> Array:
        """a (cells) of θ in units of its prior, by secants."""
        parts = []
        for fit, network in zip(self.fits, self._networks, strict=True):
            assert fit.readings.sigma is not None
            read = nuisance.effect(self.scene, network, 1e-3 * nuisance.prior) / fit.readings.sigma
            parts.append(np.linalg.solve(fit.normal, fit.jacobian.T @ (1e3 * read.ravel())))
        return np.asarray(parts[1] if nuisance.since else parts[1] - parts[0])

    def without(self, nuisance: Nuisance) -> "FittedPair | None":
        """The pair once an effect is taken off the readings; None where no cells give the rest."""
        found = []
        for number, (fit, network, given) in enumerate(zip(self.fits, self._networks, self.given, strict=True)):
            one: CellsFit | None = fit
            if number or not nuisance.since:
                left = given.value - nuisance.effect(self.scene, network, nuisance.size)
                one = fitted(self.scene, replace(given, value=left), fit.cells)
            if one is None:
                return None
            found.append(one)
        after = replace(self, fits=tuple(found), nuisance=nuisance)
        return after if np.all(np.isfinite(after.change)) else None


def besides_the_circuit(scene: Scene, resting: CellsFit, frames: Sequence[tuple[str, CellsFit]]) -> tuple[Better, str]:
    """(the likeliest effect, how all cells changed together or '') by fits of the unloaded panel and of named frames.

    Effects are tried by linear theory, the best ones by the network.
    """
    found, together, most = Better(), "", MARGIN
    for name, frame in frames:
        if max(float(fit.readings.bounds.mean()) for fit in (resting, frame)) > MOST_BOUNDS:
            continue
        pair = FittedPair.of(scene, resting, frame)
        plain = pair.explained()
        together, count = _together(plain) or together, int(plain.moved.sum())
        effects = list(nuisances(frame.cells.shape))
        scores = np.array([pair.explained(one, briefly=True).score for one in effects])
        for number in np.argsort(scores)[:MOST_ASKED]:
            refined = _refined(pair, effects[number])
            if refined is None or refined.nuisance is None:
                continue
            after = refined.explained()
            moved = int(after.moved.sum())
            if mostly_still(after.moved) and moved < count and plain.score - after.score > most:
                most = plain.score - after.score
                fits_noise = min(fit.tail for fit in refined.fits) >= LEVEL
                found = Better(refined.nuisance.named(scene.panel.rows), name, moved, count, fits_noise)
    return found, "" if found.name else together


def _together(plain: Evidence) -> str:
    """How all cells that no load touches changed, in words; '' where that may be chance, or a load's rim."""
    change, sd = TOGETHER * plain.size, TOGETHER * plain.sd
    if not mostly_still(plain.moved) or not abs(change) > max(MOVED, SURE * sd):
        return ""
    return (
        f"cells that nobody touched changed together by {100 * change:+.2g} +- {100 * sd:.1g} %: creep, temperature or "
        "the supply"
    )


def _refined(pair: FittedPair, nuisance: Nuisance) -> FittedPair | None:
    """The pair without the effect, of the likeliest size by the network; None where no cells give the rest."""
    for _ in range(STEPS):
        found = pair.explained(nuisance)
        sizes = nuisance.size + found.size * nuisance.prior * 0.5 ** np.arange(5)
        least = 0.0 if nuisance.kind == "leak" else -np.inf
        trials = (pair.without(replace(nuisance, size=max(float(size), least))) for size in sizes[np.isfinite(sizes)])
        after = next((one for one in trials if one is not None), None)
        if after is None or after.nuisance is None:
            return None
        pair, nuisance = after, after.nuisance
        if abs(found.size) < SETTLED * max(found.sd, SETTLED):
            break
    return pair if nuisance.size else None
