"""Frame after frame of one panel: attachments, their times, and whether they suck and breathe.

Steps are found by a matched filter on the logarithms of all readings (Page, Biometrika 41, 1954, of one). What stands
there between two steps is recognised after 1, 2, 4 … seconds, from the median of the latest frames against the panel
before the load came, and goes only by a step back to that, up to what the film remembers. A step whose readings go back
to the level before it, such as a deep breath or an outlier, was none. A bare panel at rest follows the readings.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from math import exp

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csc_array

from lampest.files.levels import NOISE_REACH, OUTLIER_THRESHOLD
from lampest.files.process import ONE_BLAS_THREAD
from lampest.loads.recognition.attachment import Attachment, attachments_of, continued_by
from lampest.loads.recognition.breathing import (
    MIN_RATE_HZ,
    MIN_WINDOW_S,
    WINDOW_S,
    Patterns,
    breaths,
    patterns_of,
    suction_weights,
)
from lampest.loads.recognition.candidates import FIELD, DiscSearch
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.evidence import IMPOSSIBLE, RARE_LOG_ODDS, Verdict
from lampest.loads.recognition.observation import Baseline, ModelErrors, Observation, counting
from lampest.loads.recognition.pumping import BLOCK_S, Pumping
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

NEAR_PITCHES = 3.0  # pitches about its place that a load may reach: half of the widest mouth, and a cell
FOLLOWS_S = 20.0  # in which the mean of frames follows them
SETTLES_S = 60.0  # of drift that is expected within the unloaded frames
MIN_CHANGE = 0.5  # of what stands there, as patterns see it: a change beyond it is another load, or one that left
UNEVENLY = "a load may lie on the panel in the unloaded frames: its cells are uneven in the shape of one"
FIRST_S, MIN_FRAMES = 1.0, 3  # after which something is recognised first, and at least; breathing is judged again


@dataclass(frozen=True, eq=False)
class Panelled:
    """Constants while a panel is watched: scene, water in kPa, errors.

    common : of (rows, columns), (cells, n) a root of the covariance of errors that readings share by chance; None:
    there are none.
    """

    scene: Scene
    detector: Detector
    water: Array
    errors: ModelErrors
    common: Callable[[Array], Array] | None = None

    def frame(self, measured: Array, sigma: Array, baseline: Baseline, seconds: float) -> Observation:
        """Return a mean of frames, as sure as one: films err alike in all of them."""
        common = None if self.common is None else self.common(measured)
        return Observation(measured, sigma, baseline, self.water, seconds, common=common)

    def baseline(self, measured: Array, sigma: Array, frames: float) -> Baseline:
        """Return the panel at rest from the mean of so many frames."""
        scale = frames**-0.5
        common = None if self.common is None else scale * self.common(measured)
        return Baseline.of(measured, scale * sigma, self.scene, self.errors, common)


@dataclass(frozen=True, eq=False)
class StepTest:
    """|t_kᵀ W δ| > OUTLIER_THRESHOLD·v_k of a change δ of ln y. A change that all cells share is free.

    Attributes
    ----------
    templates : sparse array
        (cells, discs) ln r/r0 under discs; t_k is W S of each, of unit length, S = d ln y/d ln r.
    filter : array
        (W S)ᵀ W (cells, cells).
    places : array of int
        (discs) number of the place of each.
    near : boolean array
        (places, places) which are near.
    whitening : array
        W (cells, cells).
    loud : array
        (discs) v_k², the mean square in frames without a load: ripple and noise that nobody specified count.
    """

    templates: csc_array
    filter: Array
    places: NDArray[np.intp]
    near: NDArray[np.bool_]
    whitening: Array
    loud: Array

    @classmethod
    def of(cls, frame: Observation, search: DiscSearch, unloaded: Array) -> "StepTest":
        """About a panel at rest.

        Parameters
        ----------
        frame : Observation
            Its readings with the noise of one frame.
        unloaded : array, shape (frames, cells)
            ln y.
        """
        value, cells = frame.measured.ravel(), frame.measured.size
        slope = frame.slope(np.zeros(frame.measured.shape)) / value[:, None]
        errors = frame.baseline.model_errors
        settled = errors.settled**2 * slope @ slope.T
        shared = [errors.swaying * slope.sum(axis=1, keepdims=True), errors.swaying * np.ones((cells, 1))]
        shared += [] if frame.common is None else [frame.common / value[:, None]]
        columns = np.hstack(shared)
        root = cholesky(np.diag((frame.sigma.ravel() / value) ** 2) + settled + columns @ columns.T, lower=True)
        whitening = solve_triangular(root, np.eye(cells), lower=True)
        response = whitening @ slope
        templates, matched = search.matched(response), response.T @ whitening
        places, place = np.unique(search.places, axis=0, return_inverse=True)
        x, y = places.T / frame.baseline.scene.panel.pitch_mm
        near = np.hypot(x[:, None] - x, y[:, None] - y) < NEAR_PITCHES
        scores = (templates.T @ (matched @ unloaded.T)).T
        spreads = [np.mean((first - second) ** 2) / 2 for first, second in combinations(scores, 2)]
        usual = np.quantile(spreads or [1.0], 0.25, method="lower")  # a frame with an outlier, or a touch, is in many
        loud = np.full(len(place), max(float(usual), 1.0))
        return cls(templates, matched, place, near, whitening, loud)

    def scores(self, change: Array) -> Array:
        """|t_kᵀ W δ| of a change of ln y (cells)."""
        return np.asarray(np.abs(self.templates.T @ (self.filter @ change)))

    def sizes(self, change: Array) -> Array:
        """(discs) the largest score of a change within NEAR_PITCHES of each disc."""
        largest = np.zeros(len(self.near))
        np.maximum.at(largest, self.places, self.scores(change))
        return np.asarray(np.where(self.near, largest, 0.0).max(axis=1)[self.places])

    def least(self) -> Array:
        """(discs) scores beyond which something has happened."""
        return np.asarray(OUTLIER_THRESHOLD * np.sqrt(np.maximum(self.loud, max(1.0, float(self.loud.mean())))))


@dataclass(frozen=True, eq=False)
class Watch:
    """State of the recognition after a sequence of frames. Readings are logarithms, (cells).

    Attributes
    ----------
    resting, rested, rest_s
        Readings of the panel before a load, number of frames of which they are the mean, and time of the last in s.
    mean, begun
        Readings of the frames since the last step, and when that was, s.
    recent : tuple of two arrays
        The last two frames.
    window : tuple of (s, array)
        Frames since the step, of WINDOW_S or MIN_FRAMES if that is more.
    size, left, left_s
        Scores of the present load (discs), of the last one that was recognised, and when, s.
    film_sd : array, or 0
        Standard deviation of ln r0 by the residue that earlier loads left in the film, (cells).
    seen, verdict
        The median frame of the last recognition since the load came, and its result.
    known : bool
        Whether there was a recognition since the last step.
    next_s, breath_s, sample_s : float
        Times of the next recognition, of the next judgement of breath and of the next sample of suction.
    judged_s : float
        Time of the last frame in the last full window in which breath was judged.
    uncovered_s
        Time at which a load left that had been there before the first frame.
    uneven : bool
        Whether a load may lie on the panel in the unloaded frames.
    former : Watch or None
        The load before the last step; None once another was recognised since.
    """

    panelled: Panelled
    test: StepTest
    sigma: Array
    resting: Array
    rested: float
    rest_s: float
    mean: Array
    begun: float
    recent: tuple[Array, ...]
    film_sd: Array | float = 0.0
    window: tuple[tuple[float, Array], ...] = ()
    present: bool = False
    size: Array | float = 0.0
    left: Array | float = 0.0
    left_s: float = 0.0
    seen: Observation | None = None
    verdict: Verdict | None = None
    known: bool = False
    next_s: float = np.inf
    breath_s: float = np.inf
    sample_s: float = np.inf
    judged_s: float = -np.inf
    uncovered_s: float | None = None
    uneven: bool = False
    attachments: tuple[Attachment, ...] = ()
    former: "Watch | None" = None

    @classmethod
    def begin(cls, panelled: Panelled, measured: Array, sigma: Array, unloaded: Array, time: float) -> "Watch":
        """Against unloaded readings (rows, columns).

        Parameters
        ----------
        measured : array
            Their mean.
        sigma : array
            Of one frame.
        unloaded : array, shape (frames, rows, columns)
            Those that are values, NaN else.
        time : float
            s, of the last one.
        """
        frames, sigma, resting = max(len(unloaded), 1), counting(sigma, measured), np.log(measured.ravel())
        frame = panelled.frame(measured, sigma, panelled.baseline(measured, sigma, frames), 0.0)
        own = np.where(np.isnan(unloaded), measured, unloaded).reshape(len(unloaded), resting.size)
        test = StepTest.of(frame, panelled.detector.search, np.log(own))
        uneven = panelled.detector.search.lies_on(frame.baseline.logarithm)
        return cls(panelled, test, sigma, resting, frames, time, resting, time, (resting, resting), uneven=uneven)

    @ONE_BLAS_THREAD
    def push(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """Return the watch after a frame, all (rows, columns); a reading without a finite σ does not count."""
        watch = self.followed(measured, sigma, time)
        if not watch.present:
            return watch
        if not watch.known and watch._calm(watch._frame(watch.mean, time)):
            return watch._gone(watch.begun)
        watch = watch._resumed(watch.mean) if time >= watch.next_s else watch
        watch = watch._recognised(time) if time >= watch.next_s and len(watch.window) >= MIN_FRAMES else watch
        if not (watch.present and watch.known):
            return watch
        watch = watch._breathed(time) if time >= watch.breath_s else watch
        return watch._pumped(time) if time >= watch.sample_s else watch

    def followed(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """Return the watch after a frame, as `push`, but nothing is recognised."""
        counts = np.isfinite(sigma).ravel()
        logarithm = np.where(counts, np.log(np.where(counts, measured.ravel(), 1.0)), self.mean)
        shown = np.median([*self.recent, logarithm], axis=0)
        sigma = counting(sigma, np.exp(self.resting).reshape(sigma.shape))
        return replace(self, recent=(self.recent[-1], logarithm), sigma=sigma)._stepped(shown, logarithm, time)

    def ended(self) -> "Watch":
        """Return the watch after the last frame: a load is recognised although it has just come."""
        return self._recognised(self.window[-1][0]) if self.present and not self.known else self

    def touched(self, unloaded: Array) -> bool:
        """Whether something came or left while the unloaded frames (frames, rows, columns) were taken."""
        medians = [np.median(np.log(unloaded[first : first + 3]), axis=0).ravel() for first in range(len(unloaded) - 2)]
        each = [np.where(np.isnan(shown), self.resting, shown) for shown in medians]
        stepped = [shown for shown in each if np.any(self.test.scores(shown - self.resting) >= self.test.least())]
        verdict = self.panelled.detector.verdict
        return any(verdict(self._frame(shown, self.rest_s + SETTLES_S)).nothing < 0.5 for shown in stepped[-1:])

    @property
    def stands_out(self) -> float:
        """Number of standard deviations by which the last frames differ from the panel at rest."""
        return float(np.max(self.test.scores(np.median([*self.recent, self.mean], axis=0) - self.resting)))

    @property
    def change(self) -> Array | None:
        """ln r/r0 (rows, columns) of the load that was recognised last; None: none was."""
        return None if self.verdict is None else self.verdict.best.change

    @property
    def doubt(self) -> str:
        """Reason for which the load on the panel is not known; '' where it is."""
        if self.present and not self.known:
            return f"something touched the panel at {self.begun:.1f} s, and has not been still for long enough"
        if self.uncovered_s is not None:
            return f"something stood on the panel in its unloaded frames, and left at {self.uncovered_s:.1f} s"
        return UNEVENLY if self.uneven else ""

    def _stepped(self, shown: Array, logarithm: Array, time: float) -> "Watch":
        """Return the watch with a frame among those since the last step, or the first after one."""
        before = self.window[-1][0] if self.window else self.begun
        scores = self.test.scores(shown - self.mean)
        fading = self.left / (1 + max(time - self.left_s, 0.0) / FOLLOWS_S)  # residue of the last load in the film
        if np.any(scores >= (self._least_step if self.present else np.maximum(self.test.least(), MIN_CHANGE * fading))):
            resumed = self._resumed(shown)
            if resumed is not self:
                return resumed._stepped(shown, logarithm, time)
            former = replace(self, former=None) if self.present else None
            watch = replace(self, mean=shown, begun=before, window=((time, logarithm),), known=False, former=former)
            watch = watch if self.present else replace(watch, present=True, seen=None)
            size = self.test.sizes(shown - self.resting)
            watch = replace(watch, next_s=before + FIRST_S, breath_s=time + MIN_WINDOW_S + 1 / MIN_RATE_HZ)
            return replace(watch, size=size, sample_s=before + BLOCK_S)
        share = min((time - before) / FOLLOWS_S, 1.0)
        follows = max(1 / (len(self.window) + 1), share)
        lately = sum(sample[0] > time - WINDOW_S for sample in self.window)
        window = (*self.window[-max(lately, MIN_FRAMES - 1) :], (time, logarithm))
        watch = replace(self, mean=self.mean + follows * (shown - self.mean), window=window)
        if self.present:
            return watch
        test = replace(self.test, loud=self.test.loud + share * (scores**2 - self.test.loud))
        return replace(watch, resting=watch.mean, rest_s=time, rested=max(1 / follows, self.rested), test=test)

    def _resumed(self, logarithm: Array) -> "Watch":
        """Return the watch over the load before the last step, with the frames since, where readings are back there."""
        former = self.former
        if former is None or np.any(former.test.scores(logarithm - former.mean) >= former._least_step):
            return self
        window = (*former.window, *self.window)
        lately = sum(at > window[-1][0] - WINDOW_S for at, _ in window)
        return replace(former, recent=self.recent, sigma=self.sigma, window=window[-max(lately, MIN_FRAMES) :])

    @property
    def _least_step(self) -> Array:
        """(discs) scores of a step while a load is present."""
        return np.maximum(self.test.least(), MIN_CHANGE * self.size)

    def _frame(self, logarithm: Array, time: float) -> Observation:
        """Return readings against the panel before the load, with the film's residue of loads that left."""
        panelled, shape = self.panelled, self.panelled.scene.panel.shape
        baseline = panelled.baseline(np.exp(self.resting).reshape(shape), self.sigma, max(self.rested, 1.0))
        frame = panelled.frame(np.exp(logarithm).reshape(shape), self.sigma, baseline, time - self.rest_s)
        covariance = baseline.covariance.copy()
        np.einsum("ii->i", covariance)[: logarithm.size] += self._keeps(frame) ** 2
        return replace(frame, baseline=replace(baseline, covariance=covariance))

    def _calm(self, frame: Observation) -> bool:
        """Return whether nothing stands out of a frame, beyond the film's residue of an earlier load."""
        return self.panelled.detector.calm(frame) is not None and self._left(frame)

    def _left(self, frame: Observation) -> bool:
        """Whether cells show less of the ln r/r0 that was recognised than a film may keep; true where nothing was.

        The change of all cells alike, of temperature, is that of the cells that were free.
        """
        if self.seen is None:
            return True
        before = self._before
        common = np.median(frame.map[before == 0]) if np.any(before == 0) else 0.0
        residue = NOISE_REACH * self.panelled.errors.residue * np.sum(before**2)
        return bool(np.sum((frame.map - common) * before) <= residue)

    def _keeps(self, frame: Observation) -> Array | float:
        """Return `film_sd` once a step has changed the recognised load: by the decrease of each cell."""
        if self.known or self.seen is None:
            return self.film_sd
        less = np.maximum(np.abs(self._before) - np.abs(frame.map), 0.0).ravel()
        return np.asarray(np.maximum(self.film_sd, self.panelled.errors.residue * less))

    @property
    def _before(self) -> Array:
        """ln r/r0 (rows, columns) of the load that was recognised since the last step; 0 without one."""
        change = None if self.seen is None else self.change
        return np.zeros(self.panelled.scene.panel.shape) if change is None else change

    def _gone(self, time: float) -> "Watch":
        """Return the watch once nothing is there any more.

        Rest is what it is now, unless nothing had been recognised.
        """
        closed = tuple(
            replace(attachment, until_s=time) if attachment.present else attachment for attachment in self.attachments
        )
        ended = replace(self, present=False, known=False, former=None, attachments=closed)
        watch = replace(ended, film_sd=0.0, next_s=np.inf, breath_s=np.inf)
        if self.seen is None:
            return replace(watch, mean=self.resting, window=())
        return replace(watch, resting=self.mean, rest_s=time, rested=float(len(self.window)), left_s=time)

    def _recognised(self, time: float) -> "Watch":
        """Return the watch with the loads that the frames of the window show."""
        again, scores = time + max(time - self.begun, FIRST_S), self.test.scores(self.mean - self.resting)
        size, clear = self.test.sizes(self.mean - self.resting), scores >= self.test.least()
        median = np.median([logarithm for _, logarithm in self.window], axis=0)
        frame = self._frame(median, time)
        verdict = self.panelled.detector.verdict(frame, self.verdict if self.known else None)
        change, before = verdict.best.change, self._before
        least = NOISE_REACH * self.panelled.errors.residue * np.sum(change * before)
        memory = not self.known and np.sum(change**2) < least  # of a load where it was
        if memory or verdict.nothing > exp(-RARE_LOG_ODDS) * (1 - verdict.nothing):  # some steps are noise
            if self._left(frame) and not (self.known and np.any(clear)):
                return self._gone(time if self.known else self.begun)
            return replace(self, known=True, next_s=again, former=None)
        if self.seen is None and self._uncovered(verdict, median, time):
            return replace(self, seen=frame, left=size, uncovered_s=self.begun)._gone(self.begun)
        loads = attachments_of(frame, verdict, self.begun)
        watch = replace(self, film_sd=self._keeps(frame), seen=frame, verdict=verdict, known=True, former=None)
        every = continued_by(self.attachments, loads, self.begun, again=self.known)
        return replace(watch, left=size, left_s=time, size=size, next_s=again, attachments=every)

    def _uncovered(self, verdict: Verdict, median: Array, time: float) -> bool:
        """Return whether the load that came is rather one that left the unloaded panel.

        It explains the frames better backwards.
        """
        field = max(fit.evidence for fit in verdict.fits if fit.candidate is FIELD)
        if field < verdict.best.evidence - IMPOSSIBLE:
            return False
        watch = replace(self, resting=median, rested=float(len(self.window)), rest_s=time)
        backwards = self.panelled.detector.verdict(watch._frame(self.resting, time))
        return backwards.evidence > verdict.evidence + RARE_LOG_ODDS

    def _breathed(self, time: float) -> "Watch":
        """Return the watch with the breath that the frames since the last full window show.

        They are judged anew until they fill a window. The last frame may be the first of a release, which the next one
        will show.
        """
        assert self.seen is not None and self.verdict is not None
        settled = [frame for frame in self.window[:-1] if frame[0] > self.judged_s]
        times, logarithms = np.array([at for at, _ in settled]), np.array([logarithm for _, logarithm in settled])
        lasted = float(times[-1] - times[0])
        full = lasted > WINDOW_S - 2.5 * lasted / max(len(times) - 1, 1)
        attachments, fit, detector = list(self.attachments), self.verdict.best, self.panelled.detector
        for place, breath in breaths(times, logarithms, self.seen, fit, self.test.whitening, detector):
            present = [number for number, attachment in enumerate(attachments) if attachment.present]
            number = min(present, key=lambda number: attachments[number].distance(place))
            own = attachments[number]
            attachments[number] = replace(own, breath=own.breath.after(breath, full=full))
        judged_s = float(times[-1]) if full else self.judged_s
        breath_s = time + (MIN_WINDOW_S + 1 / MIN_RATE_HZ if full else FIRST_S)
        return replace(self, attachments=tuple(attachments), judged_s=judged_s, breath_s=breath_s)

    def _pumped(self, time: float) -> "Watch":
        """Return the watch with one more sample of all suction, from the last BLOCK_S, of MIN_FRAMES at least."""
        assert self.seen is not None and self.verdict is not None
        block = np.array([logarithm for at, logarithm in self.window if at > self.sample_s - BLOCK_S])
        if len(block) < MIN_FRAMES:
            return self
        attachments, patterns = list(self.attachments), list[tuple[tuple[float, float], Patterns]]()
        for number, attachment in enumerate(attachments):
            if attachment.present and attachment.sucks > 0.5:
                track = attachment.track
                if track is None or track.moves != len(attachment.moved_s):
                    whitening, fit = self.test.whitening, self.verdict.best
                    patterns = patterns or patterns_of(self.seen, fit, whitening, self.panelled.detector)
                    own = min(patterns, key=lambda pair: attachment.distance(pair[0]), default=None)
                    if own is None:
                        continue
                    weights, reference = suction_weights(own[1], whitening), np.log(self.seen.measured.ravel())
                    begin = self.sample_s - BLOCK_S, len(attachment.moved_s)
                    track = Pumping.begin(weights, reference, *begin, track)
                attachments[number] = replace(attachment, track=track.after(block, time))
        return replace(self, attachments=tuple(attachments), sample_s=time + BLOCK_S)
