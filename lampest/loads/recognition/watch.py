"""Frame after frame of one panel: what is attached, since when, and whether it sucks and breathes.

Readings that do not step belong together. What stands there between two steps is recognised once it has lasted for a
second, and again after 2, 4, 8 … seconds, from the median of the latest frames against the panel before the load came.
A load that is there goes only by a step back to that, up to what film and drift leave; its pattern may fade or grow as
slowly as it likes. While nothing is there, the panel at rest follows the readings.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from lampest.loads.recognition.attachment import Attachment, attachment_of, continued_by
from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.breathing import LEAST_S, WINDOW_S, Breath, Patterns, breath
from lampest.loads.recognition.candidates import LOADS
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Observation, counting
from lampest.loads.recognition.search import cell_map
from lampest.loads.recognition.settings import ModelErrors
from lampest.loads.recognition.steps import StepTest
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

FOLLOWS_S = 20.0  # in which the mean of frames follows them
# Of what stands there, as patterns see it: a change beyond it is another load, or one that left.
CHANGED = 0.5
# Of a load's ln r/r0, the most that a film keeps of it: 12 %, and 5 % for each decade, as `ModelErrors` have it.
FILM_KEEPS = 0.25
FIRST_S, FRAMES = 1.0, 3  # after which something is recognised first, and at least
AGAIN_S = 1.0  # after which breathing is judged again while the window fills
# Standard deviations of what may move with time: the supply, relative; mm, tilts; suction and rim, relative.
SUPPLY = 0.01
MOVES = {"x": 1.0, "y": 1.0, "tilt_x": 0.1, "tilt_y": 0.1}
BREATHES = 0.1


class SharedNoise(Protocol):
    """What the readings of a frame share by chance."""

    def columns(self, measured: Array, baseline: bool) -> Array:
        """V (frames · cells, n) of (frames, rows, columns): a root of their covariance."""


@dataclass(frozen=True, eq=False)
class Panelled:
    """What stays while a panel is watched: scene, edge of the film in mm, water in kPa, errors, what frames share."""

    scene: Scene
    patch_mm: float
    water: Array
    errors: ModelErrors
    noise: SharedNoise | None = None
    loads: tuple[Candidate, ...] = LOADS

    def frame(self, measured: Array, sigma: Array, baseline: Baseline, seconds: float, scale: float) -> Observation:
        """A mean of frames; scale : its errors over those of one."""
        common = None if self.noise is None else scale * self.noise.columns(measured[None], False)
        return Observation(measured, scale * sigma, baseline, self.water, seconds, common=common)

    def baseline(self, measured: Array, sigma: Array, scale: float) -> Baseline:
        """The panel at rest; scale : as above."""
        common = None if self.noise is None else scale * self.noise.columns(measured[None], False)
        return Baseline.of(measured, scale * sigma, self.scene, self.errors, common)


@dataclass(frozen=True, eq=False)
class Watch:
    """Where a sequence of frames stands. Readings are logarithms, (cells).

    test : of steps. rest, rested : the panel before a load, and how many frames that is a mean of. rest_s : its last.
    mean, begun : of the frames since the last step, and when that was. recent : the last two. window : (s, ℓ) since the
    step, of WINDOW_S or FRAMES if that is more. present : whether something is there. size : (discs) what patterns see
    of it, or of the last one. known : whether it was recognised; next_s : when it will be again. verdict : as what.
    """

    panelled: Panelled
    test: StepTest
    sigma: Array
    rest: Array
    rested: float
    rest_s: float
    mean: Array
    begun: float
    recent: tuple[Array, ...]
    window: tuple[tuple[float, Array], ...] = ()
    present: bool = False
    size: Array | float = 0.0
    left: Array | float = 0.0
    left_s: float = 0.0
    known: bool = False
    next_s: float = np.inf
    breath_s: float = np.inf
    detector: Detector | None = None
    seen: Observation | None = None
    change: Array | None = None
    attachments: tuple[Attachment, ...] = ()

    @classmethod
    def begin(cls, panelled: Panelled, measured: Array, sigma: Array, unloaded: Array, time: float) -> "Watch":
        """Against unloaded readings (rows, columns).

        measured : their mean. sigma : of one frame. unloaded : (frames, rows, columns) those that are values, NaN else.
        time : s, of the last one.
        """
        frames, sigma = max(len(unloaded), 1), counting(sigma, measured)
        baseline = panelled.baseline(measured, sigma, frames**-0.5)
        frame = panelled.frame(measured, sigma, baseline, 0.0, 1.0)
        search = Detector.of(panelled.scene.panel, panelled.patch_mm, frame, panelled.loads).starts.search
        rest = np.log(measured.ravel())
        test = StepTest.of(frame, search).primed(np.nan_to_num(np.log(unloaded.reshape(len(unloaded), -1)) - rest))
        return cls(panelled, test, sigma, rest, frames, time, rest, time, (rest, rest))

    def push(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """After a frame; a reading without a finite σ does not count. All (rows, columns)."""
        counts = np.isfinite(sigma).ravel()
        logarithm = np.where(counts, np.log(np.where(counts, measured.ravel(), 1.0)), self.mean)
        shown = np.median([*self.recent, logarithm], axis=0)
        here = replace(
            self, recent=(self.recent[-1], logarithm), sigma=counting(sigma, np.exp(self.rest).reshape(sigma.shape))
        )
        return here._stepped(shown, logarithm, time)._looked(time)

    @property
    def stands_out(self) -> float:
        """By how many standard deviations the last frames differ from the panel at rest."""
        return float(np.max(self.test.scores(np.median([*self.recent, self.mean], axis=0) - self.rest)))

    def _stepped(self, shown: Array, logarithm: Array, time: float) -> "Watch":
        """With a frame among those since the last step, or the first after one."""
        before = self.window[-1][0] if self.window else self.begun
        scores = self.test.scores(shown - self.mean)
        allowed = CHANGED * self.size if self.present else self._kept(time)
        if np.all(scores < self.test.least() + allowed):
            follows = max(1 / (len(self.window) + 1), min((time - before) / FOLLOWS_S, 1.0))
            lately = sum(one[0] > time - WINDOW_S for one in self.window)
            window = (*self.window[-max(lately, FRAMES - 1) :], (time, logarithm))
            here = replace(self, mean=self.mean + follows * (shown - self.mean), window=window)
            if self.present:
                return here
            rested = max(1 / follows, self.rested)
            return replace(here, rest=here.mean, rest_s=time, rested=rested, test=self.test.heard(scores))
        size, detector = self.test.sizes(shown - self.rest), self.detector if self.present else None
        fresh = replace(
            self, mean=shown, begun=before, window=((time, logarithm),), known=False, present=True, size=size
        )
        return replace(fresh, next_s=before + FIRST_S, breath_s=before + LEAST_S, detector=detector)

    def _kept(self, time: float) -> Array | float:
        """(discs) what the film may show of the last load."""
        return CHANGED * self.left / (1 + max(time - self.left_s, 0.0) / FOLLOWS_S)

    def _looked(self, time: float) -> "Watch":
        """With what stands there, where it is time to look."""
        if not self.present:
            return self
        if not self.known and self._at_rest(time):
            return self._gone(self.begun)
        here = self
        if time >= self.next_s and len(self.window) >= FRAMES:
            here = here._recognised(time)
        return here._breathed(time) if here.present and here.known and time >= here.breath_s else here

    def _at_rest(self, time: float) -> bool:
        """Whether the readings are back to where they were before the load, up to what film and drift leave."""
        drift = 3 * self.panelled.errors.resting_sd(time - self.rest_s) * self.test.drift
        scores, least = self.test.scores(self.mean - self.rest), self.test.least() + drift
        if np.all(scores < least):
            return True
        if self.change is None or not np.all(scores < least + CHANGED * self.left):
            return False
        left, before = cell_map(self._frame(self.mean, time)).ravel(), self.change.ravel()
        return bool(left @ before < FILM_KEEPS * (before @ before))

    def _frame(self, logarithm: Array, time: float) -> Observation:
        """Readings against the panel before the load, as sure as one frame: films err alike in all of them."""
        panelled, shape = self.panelled, self.panelled.scene.panel.shape
        rest = panelled.baseline(np.exp(self.rest).reshape(shape), self.sigma, max(self.rested, 1.0) ** -0.5)
        return panelled.frame(np.exp(logarithm).reshape(shape), self.sigma, rest, time - self.rest_s, 1.0)

    def _gone(self, time: float) -> "Watch":
        """Once nothing is there any more; the panel at rest is what it is now, unless nothing had been recognised."""
        closed = tuple(replace(one, until_s=time) if one.here else one for one in self.attachments)
        here = replace(
            self, present=False, known=False, attachments=closed, next_s=np.inf, breath_s=np.inf, detector=None
        )
        if self.detector is None:
            return replace(here, mean=self.rest, window=())
        return replace(here, rest=self.mean, rest_s=time, rested=float(len(self.window)), left_s=time)

    def _recognised(self, time: float) -> "Watch":
        """With what stands there, by the frames of the window."""
        panelled, frame = self.panelled, self._frame(np.median([one for _, one in self.window], axis=0), time)
        if self.detector is None:
            detector = Detector.of(panelled.scene.panel, panelled.patch_mm, frame, panelled.loads)
        else:
            detector = replace(self.detector, starts=self.detector.starts.against(frame))
        detector, verdict = detector.push(frame)
        again = time + max(time - self.begun, FIRST_S)
        if verdict.nothing > 0.5:
            return replace(self, next_s=again) if self.known else replace(self, detector=detector)._gone(self.begun)
        found = [attachment_of(frame, verdict, number, self.begun) for number in range(verdict.count)]
        here = replace(self, detector=detector, seen=frame, known=True, next_s=again, change=verdict.best.change)
        here = replace(
            here, left=self.test.sizes(self.mean - self.rest), left_s=time, size=self.test.sizes(self.mean - self.rest)
        )
        return replace(here, attachments=continued_by(self.attachments, found, self.begun))

    def _breathed(self, time: float) -> "Watch":
        """With what the window shows of breathing; judged anew until it is full, and then window after window."""
        lasted = time - self.window[0][0]
        full = lasted > WINDOW_S - 1.5 * lasted / max(len(self.window) - 1, 1)
        attachments = list(self.attachments)
        for place, found in self._breaths():
            number = min(
                (number for number, one in enumerate(attachments) if one.here),
                key=lambda number: attachments[number].distance(place),
                default=None,
            )
            if number is not None:
                attachments[number] = attachments[number].breathed(found, full, lasted)
        return replace(self, attachments=tuple(attachments), breath_s=time + (WINDOW_S if full else AGAIN_S))

    def _breaths(self) -> list[tuple[tuple[float, float], Breath]]:
        """(centre, breath) of every load that sucks, from the frames of the window."""
        assert self.detector is not None and self.detector.previous is not None and self.seen is not None
        best, model, white = self.detector.previous.best, self.seen.measured.ravel(), self.test.whitening
        slopes = dict(zip(best.candidate.priors(self.panelled.scene.panel), best.slopes.T / model, strict=True))
        times, logarithms = np.array([time for time, _ in self.window]), np.array([one for _, one in self.window])
        changes = logarithms - np.log(model)
        water, supply = self._water(changes, best), SUPPLY * white.sum(axis=1)
        discs, own, rims, moves = [], [], [], []
        for number, (part, parameters) in enumerate(best.loads):
            disc, before = part.disc(parameters), f"{number}." if len(best.loads) > 1 else ""
            if disc is not None and before + "suction" in slopes and before + "push" in slopes:
                discs.append(disc)
                rims.append(BREATHES * white @ slopes[before + "push"])
                own.append(BREATHES * white @ slopes[before + "suction"] + rims[-1])
                moves.append([sd * white @ slopes[before + name] for name, sd in MOVES.items()])
        found = []
        for number, disc in enumerate(discs):
            others = [
                column for other in range(len(discs)) if other != number for column in (own[other], *moves[other])
            ]
            beside = np.array([supply, *others]).T
            patterns = Patterns(own[number], BREATHES, rims[number], np.array(moves[number]).T, beside)
            heard = breath(times, changes @ white.T, patterns, water / abs(disc.suction_kpa))
            found += [] if heard is None else [((disc.x_mm, disc.y_mm), heard)]
        return found

    def _water(self, changes: Array, best: Fit) -> Array:
        """(frames) kPa by which the water's pressure has changed, from lines without a load; 0 where there is none."""
        assert self.seen is not None
        pressure, _ = best.candidate.pressure(self.panelled.scene.panel, self.panelled.patch_mm, best.parameters)
        loaded = pressure != 0
        free = ~(loaded.any(axis=0) | loaded.any(axis=1)[:, None]).ravel()
        slope = self.seen.slope(best.change) @ self.seen.change(pressure)[1].ravel() / self.seen.measured.ravel()
        return np.asarray(changes[:, free] @ slope[free] / max(float(slope[free] @ slope[free]), 1e-300))
