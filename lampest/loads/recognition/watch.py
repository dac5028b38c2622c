"""Recognition over time on one panel: attachments, their times, and whether they suck and breathe.

Steps of the readings are detected by a matched filter on their logarithms (Page, Biometrika 41, 1954, for one series).
Between two steps the load is recognised after 1, 2, 4 … seconds, from the median of the latest frames against the panel
before the load. A load leaves only by a step back to that panel, up to the film's residue. A step whose readings return
to the level before it, such as a deep breath or an outlier, is cancelled. Without a load, the unloaded readings follow
the frames.
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
from lampest.loads.pressure import water_pressure
from lampest.loads.recognition.attachment import Attachment, attachments_of, continued_by
from lampest.loads.recognition.breathing import (
    MIN_RATE_HZ,
    MIN_WINDOW_S,
    WINDOW_S,
    breath,
    changes_without_water,
    patterns_of,
)
from lampest.loads.recognition.candidates import FIELD, DiscSearch
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.fit import IMPOSSIBLE, RARE_LOG_ODDS, Verdict
from lampest.loads.recognition.observation import Baseline, ModelErrors, Observation, counting, patch_of
from lampest.loads.recognition.pumping import BLOCK_S, Pumping
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

NEAR_PITCHES = 3.0  # reach of a load about its place in pitches: half of the widest mouth, and a cell
FOLLOWS_S = 20.0  # time constant with which the mean follows the frames
SETTLES_S = 60.0  # duration of drift that is expected within the unloaded frames
MIN_CHANGE = 0.5  # of the present load's score: a larger change is another load, or the load has left
MAX_CELLS = 1024  # patterns of loads take memory for each pair of cells: 134 MB, and 2 GB on 64 × 64
SINGLE_FRAME = 2.0  # score of a single unloaded frame, which scatters more, over the threshold of a median of three
TOUCHED = "something touched the panel while its unloaded frames were taken"
UNEVENLY = "a load may lie on the panel in the unloaded frames: its cells are uneven in the shape of one"
FIRST_S, MIN_FRAMES = 1.0, 3  # time and least frames until the first recognition, and between judgements of breath
Frames = tuple[tuple[float, Array], ...]


def latest(window: Frames) -> Frames:
    """Return the last frames: those within WINDOW_S, and at least MIN_FRAMES."""
    return window[-max(sum(at > window[-1][0] - WINDOW_S for at, _ in window), MIN_FRAMES) :]


@dataclass(frozen=True, eq=False)
class Panelled:
    """Constants while a panel is watched.

    Attributes
    ----------
    scene : Scene
    detector : Detector
    water : array, shape (rows, columns)
        Pressure of the water, kPa.
    errors : ModelErrors
    common : callable or None
        Returns a root (cells, n) of the covariance of random errors that a frame's readings share, given the readings
        (rows, columns); None where there are none.
    """

    scene: Scene
    detector: Detector
    water: Array
    errors: ModelErrors
    common: Callable[[Array], Array] | None = None

    @classmethod
    def of(cls, scene: Scene, errors: ModelErrors, patch_mm: float | None = None) -> "Panelled":
        """Return the constants of a scene, without errors that the readings of a frame share.

        Parameters
        ----------
        scene : Scene
        errors : ModelErrors
        patch_mm : float or None
            Edge of a cell's film; None where it is not specified.
        """
        detector = Detector(patch_of(scene.panel, patch_mm), any_form=scene.purpose == "mat")
        return cls(scene, detector, water_pressure(scene.panel, scene.water), errors)

    def frame(self, measured: Array, sigma: Array, baseline: Baseline, seconds: float = 0.0) -> Observation:
        """Return the observation of a mean of frames, with the σ of one frame, because films err equally in all."""
        common = None if self.common is None else self.common(measured)
        return Observation(measured, sigma, baseline, self.water, seconds, common=common)

    def baseline(self, measured: Array, sigma: Array, frames: float) -> Baseline:
        """Return the baseline from the mean of `frames` unloaded frames; σ is that of one frame."""
        scale = frames**-0.5
        common = None if self.common is None else scale * self.common(measured)
        return Baseline.of(measured, scale * sigma, self.scene, self.errors, common)


@dataclass(frozen=True, eq=False)
class StepTest:
    """Matched filter for steps, |t_kᵀ W δ| > OUTLIER_THRESHOLD·v_k of a change δ of ln y.

    W whitens the errors of an unloaded panel; changes that all cells share have a large variance and do not count.

    Attributes
    ----------
    templates : sparse array, shape (cells, discs)
        ln r/r0 under discs; t_k = W S · template has unit length, with S = d ln y/d ln r.
    filter : array, shape (cells, cells)
        (W S)ᵀ W.
    places : integer array, shape (discs,)
        Number of the place of each disc.
    near : boolean array, shape (places, places)
        Whether two places are within NEAR_PITCHES.
    whitening : array, shape (cells, cells)
        W.
    loud : array, shape (discs,)
        v_k², the mean square score in frames without a load, which includes unspecified ripple and noise.
    """

    templates: csc_array
    filter: Array
    places: NDArray[np.intp]
    near: NDArray[np.bool_]
    whitening: Array
    loud: Array

    @classmethod
    def of(cls, frame: Observation, search: DiscSearch, unloaded: Array) -> "StepTest":
        """Return the test about a panel at rest.

        Parameters
        ----------
        frame : Observation
            Unloaded readings with the noise of one frame.
        search : DiscSearch
        unloaded : array, shape (frames, cells)
            ln y of the unloaded frames.
        """
        value, cells = frame.measured.ravel(), frame.measured.size
        slope = frame.slope() / value[:, None]
        errors = frame.baseline.model_errors
        # C = noise + drift S Sᵀ + common changes of all cells and of all readings; W = L⁻¹ of C = L Lᵀ
        settled = errors.settled**2 * slope @ slope.T
        shared = [errors.swaying * slope.sum(axis=1, keepdims=True), errors.swaying * np.ones((cells, 1))]
        shared += [] if frame.common is None else [frame.common / value[:, None]]
        columns = np.hstack(shared)
        root = cholesky(np.diag((frame.sigma.ravel() / value) ** 2) + settled + columns @ columns.T, lower=True)
        whitening = solve_triangular(root, np.eye(cells), lower=True)
        response = whitening @ slope
        templates, matched = search.matched(response), response.T @ whitening
        places, place = np.unique(search.places, axis=0, return_inverse=True)
        x, y = places.T / frame.panel.pitch_mm
        near = np.hypot(x[:, None] - x, y[:, None] - y) < NEAR_PITCHES
        scores = (templates.T @ (matched @ unloaded.T)).T
        spreads = [np.mean((first - second) ** 2) / 2 for first, second in combinations(scores, 2)]
        usual = np.quantile(spreads or [1.0], 0.25, method="lower")  # robust: an outlier frame is part of many pairs
        loud = np.full(len(place), max(float(usual), 1.0))
        return cls(templates, matched, place, near, whitening, loud)

    def scores(self, change: Array) -> Array:
        """Return |t_kᵀ W δ|, (discs,), of a change δ of ln y, (cells,)."""
        return np.asarray(np.abs(self.templates.T @ (self.filter @ change)))

    def sizes(self, change: Array) -> Array:
        """Return the largest score of a change within NEAR_PITCHES of each disc, (discs,)."""
        largest = np.zeros(len(self.near))
        np.maximum.at(largest, self.places, self.scores(change))
        return np.asarray(np.where(self.near, largest, 0.0).max(axis=1)[self.places])

    def least(self) -> Array:
        """Return the thresholds of the scores, OUTLIER_THRESHOLD·v_k, (discs,)."""
        return np.asarray(OUTLIER_THRESHOLD * np.sqrt(np.maximum(self.loud, max(1.0, float(self.loud.mean())))))


@dataclass(frozen=True, eq=False)
class Watch:
    """State of the recognition after a sequence of frames. Readings are ln y, (cells,); times are in s.

    Attributes
    ----------
    panelled : Panelled
    test : StepTest
    sigma : array, shape (rows, columns)
        Standard deviations of one frame's readings.
    resting, rested, rest_s : array, float, float
        Mean readings before the load, the number of frames in that mean, and the time of the last one.
    mean, begun : array, float
        Mean readings since the last step, and the time of that step.
    recent : tuple of two arrays
        The last two frames.
    film_sd : array, shape (cells,), or 0
        Standard deviation of ln r0 by the residue of earlier loads in the film.
    window : tuple of (float, array)
        Times and readings of the last frames since the step: those within WINDOW_S, and at least MIN_FRAMES.
    present : bool
        Whether a load is on the panel.
    size, left, left_s : array, array, float
        Scores (discs,) of the present load and of the last recognised one, and the time of that recognition.
    seen, verdict : Observation, Verdict or None
        Median frame of the last recognition of the present load, and its result.
    known : bool
        Whether there was a recognition since the last step.
    next_s, breath_s, sample_s : float
        Times of the next recognition, of the next judgement of breath, and of the next sample of suction.
    judged_s : float
        Time of the last frame of the last full window in which breath was judged.
    uncovered_s : float or None
        Time at which a load left that was present before the first frame.
    uneven : bool
        Whether a load may lie on the panel in the unloaded frames.
    attachments : tuple of Attachment
    former : Watch or None
        State before the last step; None once a load was recognised since.
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
    window: Frames = ()
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
        """Return the state before the first frame, from unloaded readings.

        Parameters
        ----------
        panelled : Panelled
        measured : array, shape (rows, columns)
            Mean of the unloaded readings.
        sigma : array, shape (rows, columns)
            Standard deviations of one frame's readings.
        unloaded : array, shape (frames, rows, columns)
            The unloaded readings; NaN where they are no values.
        time : float
            Time of the last unloaded frame, s.
        """
        frames, sigma, resting = max(len(unloaded), 1), counting(sigma, measured), np.log(measured.ravel())
        frame = panelled.frame(measured, sigma, panelled.baseline(measured, sigma, frames))
        filled = np.where(np.isnan(unloaded), measured, unloaded).reshape(len(unloaded), resting.size)
        search = panelled.detector.search(frame.panel)
        intact = np.where(panelled.scene.broken, np.nan, frame.baseline.logarithm)
        test, uneven = StepTest.of(frame, search, np.log(filled)), search.lies_on(intact)
        return cls(panelled, test, sigma, resting, frames, time, resting, time, (resting, resting), uneven=uneven)

    @ONE_BLAS_THREAD
    def push(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """Return the watch after a frame.

        Parameters
        ----------
        measured, sigma : array, shape (rows, columns)
            Readings and their standard deviations; a reading without a finite σ does not count.
        time : float
            s.
        """
        watch = self.followed(measured, sigma, time)
        if not watch.present:
            return watch
        # In this order: the load may have gone, the last step may be cancelled, loads are recognised, breath and
        # suction judged.
        if not watch.known:
            frame = watch._frame(watch.mean, time)
            if watch.panelled.detector.calm(frame) is not None and watch._left(frame):
                return watch._gone(watch.begun)
        watch = watch._resumed(watch.mean) if time >= watch.next_s else watch
        watch = watch._recognised(time) if time >= watch.next_s and len(watch.window) >= MIN_FRAMES else watch
        if not (watch.present and watch.known):
            return watch
        watch = watch._breathed(time) if time >= watch.breath_s else watch
        return watch._pumped(time) if time >= watch.sample_s else watch

    def followed(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """Return the watch after a frame, as `push`, with step detection only."""
        counts = np.isfinite(sigma).ravel()
        logarithm = np.where(counts, np.log(np.where(counts, measured.ravel(), 1.0)), self.mean)
        # the median of three frames, so that a single wrong reading is no step
        shown = np.median([*self.recent, logarithm], axis=0)
        sigma = counting(sigma, np.exp(self.resting).reshape(sigma.shape))
        return replace(self, recent=(self.recent[-1], logarithm), sigma=sigma)._stepped(shown, logarithm, time)

    def ended(self) -> "Watch":
        """Return the watch after the last frame, in which a load that has just arrived is recognised, too."""
        return self._recognised(self.window[-1][0]) if self.present and not self.known else self

    def touched(self, unloaded: Array) -> bool:
        """Return whether a load came or left during the unloaded frames, (frames, rows, columns).

        Medians of three frames are tested, so that a single wrong reading is no load, and the first and the last frame,
        which no median shows. The change with the largest score has to be more probable as a load than as none.
        """
        logarithm = np.log(unloaded).reshape(len(unloaded), -1)
        medians = [np.median(logarithm[first : first + 3], axis=0) for first in range(len(unloaded) - 2)]
        changes = np.nan_to_num([*medians, logarithm[0], logarithm[-1]] - self.resting)
        excess = np.array([np.max(self.test.scores(change) / self.test.least()) for change in changes])
        excess[-2:] /= SINGLE_FRAME
        if excess.max() < 1:
            return False
        shown = self.resting + changes[np.argmax(excess)]
        return self.panelled.detector.verdict(self._frame(shown, self.rest_s + SETTLES_S)).nothing < 0.5

    @property
    def stands_out(self) -> float:
        """Largest score of the last frames against the panel at rest, in standard deviations."""
        return float(np.max(self.test.scores(np.median([*self.recent, self.mean], axis=0) - self.resting)))

    @property
    def change(self) -> Array | None:
        """ln r/r0 (rows, columns) of the last recognised load; None before any."""
        return None if self.verdict is None else self.verdict.best.change

    @property
    def doubt(self) -> str:
        """The reason why the load on the panel is unknown, in words; '' where it is known."""
        if self.present and not self.known:
            return f"something touched the panel at {self.begun:.1f} s, and has not been still for long enough"
        if self.uncovered_s is not None:
            return f"something stood on the panel in its unloaded frames, and left at {self.uncovered_s:.1f} s"
        return UNEVENLY if self.uneven else ""

    def _stepped(self, shown: Array, logarithm: Array, time: float) -> "Watch":
        """Return the watch after a frame: a step begins a new interval, any other frame continues the present one.

        Parameters
        ----------
        shown : array, shape (cells,)
            Median of the last three frames.
        logarithm : array, shape (cells,)
            The frame.
        time : float
            s.
        """
        before = self.window[-1][0] if self.window else self.begun
        scores = self.test.scores(shown - self.mean)
        fading = self.left / (1 + max(time - self.left_s, 0.0) / FOLLOWS_S)  # score of the fading residue of a load
        if np.any(scores >= (self._least_step if self.present else np.maximum(self.test.least(), MIN_CHANGE * fading))):
            # A step: either back to the level before the last step, or the beginning of a new interval.
            resumed = self._resumed(shown)
            if resumed is not self:
                return resumed._stepped(shown, logarithm, time)
            former, seen = (replace(self, former=None), self.seen) if self.present else (None, None)
            watch = replace(self, mean=shown, begun=before, window=((time, logarithm),), known=False, former=former)
            watch = replace(watch, present=True, seen=seen, size=self.test.sizes(shown - self.resting))
            breath_s = time + MIN_WINDOW_S + 1 / MIN_RATE_HZ
            return replace(watch, next_s=before + FIRST_S, breath_s=breath_s, sample_s=before + BLOCK_S)
        # No step: running mean with the time constant FOLLOWS_S; without a load the baseline and v_k² follow, too.
        share = min((time - before) / FOLLOWS_S, 1.0)
        follows, window = max(1 / (len(self.window) + 1), share), latest((*self.window, (time, logarithm)))
        watch = replace(self, mean=self.mean + follows * (shown - self.mean), window=window)
        if self.present:
            return watch
        test = replace(self.test, loud=self.test.loud + share * (scores**2 - self.test.loud))
        return replace(watch, resting=watch.mean, rest_s=time, rested=max(1 / follows, self.rested), test=test)

    def _resumed(self, logarithm: Array) -> "Watch":
        """Return the state before the last step with the frames since, if readings have returned; else unchanged."""
        former = self.former
        if former is None or np.any(former.test.scores(logarithm - former.mean) >= former._least_step):
            return self
        window = latest((*former.window, *self.window))
        return replace(former, recent=self.recent, sigma=self.sigma, window=window)

    @property
    def _least_step(self) -> Array:
        """Thresholds of the scores while a load is present, (discs,)."""
        return np.maximum(self.test.least(), MIN_CHANGE * self.size)

    def _frame(self, logarithm: Array, time: float) -> Observation:
        """Return readings ln y as an observation against the panel before the load, with the film's residue in C."""
        panelled, shape = self.panelled, self.panelled.scene.panel.shape
        baseline = panelled.baseline(np.exp(self.resting).reshape(shape), self.sigma, max(self.rested, 1.0))
        frame = panelled.frame(np.exp(logarithm).reshape(shape), self.sigma, baseline, time - self.rest_s)
        covariance = baseline.covariance.copy()
        np.einsum("ii->i", covariance)[: logarithm.size] += self._keeps(frame) ** 2
        return replace(frame, baseline=replace(baseline, covariance=covariance))

    def _left(self, frame: Observation) -> bool:
        """Return whether a frame shows less of the recognised ln r/r0 than the film's residue; True without a load.

        The common change by temperature is the median over the cells that were free, and is subtracted.
        """
        if self.seen is None:
            return True
        before = self._before
        common = np.median(frame.map[before == 0]) if np.any(before == 0) else 0.0
        residue = NOISE_REACH * self.panelled.errors.residue * np.sum(before**2)
        return bool(np.sum((frame.map - common) * before) <= residue)

    def _keeps(self, frame: Observation) -> Array | float:
        """Return `film_sd` after a step of the recognised load: the residue of each cell's decrease of |ln r/r0|."""
        if self.known or self.seen is None:
            return self.film_sd
        fall = np.maximum(np.abs(self._before) - np.abs(frame.map), 0.0).ravel()
        return np.asarray(np.maximum(self.film_sd, self.panelled.errors.residue * fall))

    @property
    def _before(self) -> Array:
        """ln r/r0 (rows, columns) of the load before the last step; 0 without one."""
        change = None if self.seen is None else self.change
        return np.zeros(self.panelled.scene.panel.shape) if change is None else change

    def _gone(self, time: float) -> "Watch":
        """Return the watch after the load has left at a time in s.

        The present readings become the baseline, unless no load had been recognised.
        """
        closed = tuple(replace(load, until_s=time) if load.present else load for load in self.attachments)
        watch = replace(self, present=False, known=False, former=None, attachments=closed)
        watch = replace(watch, film_sd=0.0, next_s=np.inf, breath_s=np.inf)
        if self.seen is None:
            return replace(watch, mean=self.resting, window=())
        return replace(watch, resting=self.mean, rest_s=time, rested=float(len(self.window)), left_s=time)

    def _recognised(self, time: float) -> "Watch":
        """Return the watch with the loads that are recognised from the median frame of the window."""
        # Recognition of the median frame; the next one follows after twice the time since the step.
        again, scores = time + max(time - self.begun, FIRST_S), self.test.scores(self.mean - self.resting)
        size, clear = self.test.sizes(self.mean - self.resting), scores >= self.test.least()
        median = np.median([logarithm for _, logarithm in self.window], axis=0)
        frame = self._frame(median, time)
        verdict = self.panelled.detector.verdict(frame, self.verdict if self.known else None)
        change, before = verdict.best.change, self._before
        least = NOISE_REACH * self.panelled.errors.residue * np.sum(change * before)
        # No load, or only the residue of the former one: the load has left, unless its cells still show it.
        memory = not self.known and np.sum(change**2) < least  # the film's residue in the cells of the former load
        if memory or verdict.nothing > exp(-RARE_LOG_ODDS) * (1 - verdict.nothing):  # odds: some steps are noise
            if self._left(frame) and not (self.known and np.any(clear)):
                return self._gone(time if self.known else self.begun)
            return replace(self, known=True, next_s=again, former=None)
        if self.seen is None and self._uncovered(verdict, median, time):
            return replace(self, seen=frame, left=size, uncovered_s=self.begun)._gone(self.begun)
        patterns = patterns_of(frame, verdict.best, self.test.whitening, self.panelled.detector)
        loads = attachments_of(frame, verdict, self.begun, patterns)
        watch = replace(self, film_sd=self._keeps(frame), seen=frame, verdict=verdict, known=True, former=None)
        continued = continued_by(self.attachments, loads, self.begun, again=self.known)
        return replace(watch, left=size, left_s=time, size=size, next_s=again, attachments=continued)

    def _uncovered(self, verdict: Verdict, median: Array, time: float) -> bool:
        """Return whether the step is rather a load that left the panel, present since before the first frame.

        It is tested by exchanging the roles of the unloaded and the present readings, and comparing the evidence.
        """
        field = next(fit.evidence for fit in verdict.fits if fit.candidate is FIELD)
        if field < verdict.best.evidence - IMPOSSIBLE:
            return False
        watch = replace(self, resting=median, rested=float(len(self.window)), rest_s=time)
        backwards = self.panelled.detector.verdict(watch._frame(self.resting, time))
        return backwards.evidence > verdict.evidence + RARE_LOG_ODDS

    def _breathed(self, time: float) -> "Watch":
        """Return the watch with the breath by the frames since the last full window, judged until they fill a window.

        The last frame is left out, because it may be the first one of a release.
        """
        assert self.seen is not None and self.verdict is not None
        frames = [frame for frame in self.window[:-1] if frame[0] > self.judged_s]
        times, logarithms = np.array([at for at, _ in frames]), np.array([logarithm for _, logarithm in frames])
        lasted, attachments = float(times[-1] - times[0]), list(self.attachments)
        # complete if it lasts WINDOW_S but for 2.5 mean steps
        full = lasted > WINDOW_S - 2.5 * lasted / max(len(times) - 1, 1)
        changes = changes_without_water(logarithms, self.seen, self.verdict.best) @ self.test.whitening.T
        for number, load in enumerate(attachments):
            if load.present and load.patterns is not None:
                breathing = load.breath.after(breath(times, changes, load.patterns), full=full)
                attachments[number] = replace(load, breath=breathing)
        judged_s = float(times[-1]) if full else self.judged_s
        breath_s = time + (MIN_WINDOW_S + 1 / MIN_RATE_HZ if full else FIRST_S)
        return replace(self, attachments=tuple(attachments), judged_s=judged_s, breath_s=breath_s)

    def _pumped(self, time: float) -> "Watch":
        """Return the watch with one more sample of each suction, from the frames of the last BLOCK_S.

        With fewer than MIN_FRAMES frames the sample waits.
        """
        assert self.seen is not None
        block = np.array([logarithm for at, logarithm in self.window if at > self.sample_s - BLOCK_S])
        if len(block) < MIN_FRAMES:
            return self
        attachments, reference = list(self.attachments), np.log(self.seen.measured.ravel())
        for number, load in enumerate(attachments):
            if load.present and load.sucks > 0.5 and load.patterns is not None:
                track, moves = load.track, len(load.moved_s)
                if track is None or track.moves != moves:
                    weights = load.patterns.suction_weights(self.test.whitening)
                    track = Pumping.begin(weights, reference, self.sample_s - BLOCK_S, moves, track)
                attachments[number] = replace(load, track=track.after(block, time))
        return replace(self, attachments=tuple(attachments), sample_s=time + BLOCK_S)
