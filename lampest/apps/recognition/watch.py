"""Recognition over time on one panel: attachments, their times, and whether they suck and breathe.

Steps of the readings are detected by a matched filter on their logarithms (Page, Biometrika 41,
1954, for one series). Between two steps the load is recognised after 1, 2, 4 … seconds, from the
median of the latest frames against the panel before the load. A lone load leaves by a step back to
that panel, up to the film's residue. A step whose readings return to the level before it, such as a
deep breath or an outlier, is cancelled. Breath is judged through steps, because they are changes of
a load and not its end. A slow change by half of the load counts as a step, too. Without a load, the
unloaded readings follow the frames, and begin anew where a recognition finds none.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import exp

import numpy as np

from lampest.apps.recognition.attachment import Attachment, attachments_of, continued_by
from lampest.apps.recognition.breathing import MIN_WINDOW_S, WINDOW_S
from lampest.apps.recognition.detector import Verdict, is_as_before, relieved_by_departure
from lampest.apps.recognition.disc_search import StepTest
from lampest.apps.recognition.hypotheses import RARE_LOG_ODDS
from lampest.apps.recognition.leaks import Leaks, leaks_of
from lampest.apps.recognition.observation import FOLLOWS_S, Observation, counting
from lampest.apps.recognition.suction import MIN_FALL
from lampest.apps.recognition.swings import patterns_of
from lampest.apps.recognition.watch_parts import (
    MIN_FRAMES,
    Frames,
    Level,
    Look,
    UnloadedPanel,
    WatchSetup,
    latest,
    remembered,
    without_open_lines,
)
from lampest.files.levels import NOISE_REACH
from lampest.files.process import ONE_BLAS_THREAD, logged_reason
from lampest.panel.panel import Array
from lampest.recording.recording import UNEVENLY

SETTLES_S = 60.0  # duration of drift that is expected within the unloaded frames
# Of the present load's score: a larger change is another load, or the load has left.
MIN_CHANGE = 0.5
# Patterns of loads take memory for each pair of cells: 134 MB, and 2 GB on 64 × 64.
MAX_CELLS = 1024
# Score of a single unloaded frame, which scatters more, over the threshold of a median of three.
SINGLE_FRAME = 2.0
LEFT = "something stood on the panel in its unloaded frames, and left at {:.1f} s"
RELIEVED = (
    "the panel changed, and no contact is clear: no cells conduct more by five standard deviations"
)
# time until the first recognition, and the longest one between two
FIRST_S = 1.0
LOOKS_S = 60.0
LEAK_ROUNDS = 8  # linearisations of the circuit until the size of a leak is settled


@dataclass(frozen=True, eq=False)
class Watch:
    """State of the recognition after a sequence of frames.

    Readings are ln y, (cells,); times are in s.

    Attributes
    ----------
    setup : WatchSetup
    test : StepTest
    sigma : array, shape (rows, columns)
        Standard deviations of one frame's readings.
    resting_sigma : array, shape (rows, columns)
        Standard deviations of one frame's readings of the panel without a load.
    rest : Level
        The panel without a load.
    past : tuple of Level
        The panel without a load at earlier times, see `remembered`.
    level : Level
        The readings since the last step; without a load they are also the rest.
    recent : tuple of two arrays
        The last two frames.
    window : tuple of (float, array)
        Times and readings of the last frames under a load: those within WINDOW_S, and at least
        MIN_FRAMES.
    steps : tuple of float
        Times of the steps in the window.
    present : bool
        Whether a load is on the panel.
    known : bool
        Whether there was a recognition since the last step.
    next_s : float
        Time of the next recognition.
    look : Look or None
        The last recognition.
    seen : array, shape (cells,), or None
        The readings at the last look since the load arrived, ln y.
    film_sd : array, shape (cells,), or 0
        Standard deviation of ln r0 by the residue of earlier loads in the film.
    history : str
        What the unloaded frames show of a load, in words; '' for nothing.
    faults : tuple of (str, float)
        Open lines, such as 'row 3', and the times in s of the first frames in which they were.
    leaks : tuple of LineEffect
        Leaks between lines that began after the unloaded frames. `rest` has them, too.
    leaks_since_s : float
        Time of the step, or of the recognition, with which the first of them was seen, s.
    brief : tuple of (float, float)
        Times, s, of loads that came and left too soon to be recognised.
    attachments : tuple of Attachment
    unloaded : UnloadedPanel or None
        The panel before the load that is present; None without one.
    former : Watch or None
        State before the last step; None once a load was recognised since.
    """

    setup: WatchSetup
    test: StepTest
    sigma: Array
    resting_sigma: Array
    rest: Level
    level: Level
    recent: tuple[Array, ...]
    past: tuple[Level, ...] = ()
    window: Frames = ()
    steps: tuple[float, ...] = ()
    present: bool = False
    known: bool = False
    next_s: float = np.inf
    look: Look | None = None
    seen: Array | None = None
    film_sd: Array | float = 0.0
    history: str = ""
    faults: tuple[tuple[str, float], ...] = ()
    leaks: Leaks = ()
    leaks_since_s: float = np.inf
    brief: tuple[tuple[float, float], ...] = ()
    attachments: tuple[Attachment, ...] = ()
    unloaded: UnloadedPanel | None = None
    former: "Watch | None" = None

    @classmethod
    def begin(
        cls, setup: WatchSetup, measured: Array, sigma: Array, unloaded: Array, time: float
    ) -> "Watch":
        """Return the state before the first frame, from unloaded readings.

        Parameters
        ----------
        setup : WatchSetup
        measured : array, shape (rows, columns)
            Mean of the unloaded readings.
        sigma : array, shape (rows, columns)
            Standard deviations of one frame's readings.
        unloaded : array, shape (frames, rows, columns)
            The unloaded readings; NaN where they are no values.
        time : float
            Time of the last unloaded frame, s.
        """
        frames = max(len(unloaded), 1)
        sigma = counting(sigma, measured)
        resting = np.log(measured.ravel())
        baseline = setup.baseline(measured, sigma, frames)
        swaying = replace(setup, motion=np.maximum(setup.motion, setup.errors.swaying))
        filled = np.where(np.isnan(unloaded), measured, unloaded)
        search = setup.detector.search(setup.scene.panel)
        test = StepTest.of(
            swaying.frame(measured, sigma, baseline),
            search,
            np.log(filled).reshape(len(unloaded), resting.size),
        )
        intact = np.where(setup.scene.broken, np.nan, baseline.logarithm)
        history = UNEVENLY if search.lies_on(intact) else ""
        rest = Level(resting, frames, time, time)
        return cls(setup, test, sigma, sigma, rest, rest, (resting, resting), history=history)

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
        # In this order: the load may have gone, the last step may be cancelled, loads are
        # recognised, breath and suction judged.
        if not watch.known:
            frame = watch._frame(watch.level.mean, time)
            calm = watch.setup.detector.calm(frame) is not None and watch._left(frame)
            # calm readings that stand out of the baseline wait for a recognition
            if calm and not watch._stands_out_in(watch.level.mean):
                return watch._gone(watch.level.since_s)
        if time >= watch.next_s:
            watch = watch._resumed(watch.level.mean)
        if time >= watch.next_s and len(watch._since_step) >= MIN_FRAMES:
            watch = watch._looked(time)
        return watch._heard() if watch.present and watch._standing_look else watch

    def followed(self, measured: Array, sigma: Array, time: float) -> "Watch":
        """Return the watch after a frame, as `push`, with step detection only."""
        sigma = np.where(measured > 0, sigma, np.inf)
        at_rest = np.exp(self.rest.mean).reshape(measured.shape)
        opened = list[str]()
        if self.setup.scene.circuit.unit == "ohm":
            sigma, opened = without_open_lines(measured, sigma, at_rest)
        faults = dict(self.faults)
        faults |= {line: faults.get(line, time) for line in opened}
        counts = np.isfinite(sigma).ravel()
        logarithm = self.level.mean.copy()
        logarithm[counts] = np.log(measured.ravel()[counts])
        # the median of three frames, so that a single wrong reading is no step
        shown = np.median([*self.recent, logarithm], axis=0)
        watch = replace(
            self,
            recent=(self.recent[-1], logarithm),
            sigma=counting(sigma, at_rest),
            faults=tuple(faults.items()),
        )
        return watch._stepped(shown, logarithm, time)

    def ended(self) -> "Watch":
        """Return the watch after the last frame.

        A load that has just arrived in it is recognised, too.
        """
        return self._looked(self.window[-1][0]) if self.present and not self.known else self

    def touched(self, unloaded: Array) -> bool:
        """Return whether a load came or left during the unloaded frames, (frames, rows, columns).

        Medians of three frames are tested, so that a single wrong reading is no load, and the first
        and the last frame, which no median shows. The change with the largest score has to be more
        probable as a load than as none.
        """
        logarithm = np.log(unloaded).reshape(len(unloaded), -1)
        medians = [
            np.median(logarithm[first : first + 3], axis=0) for first in range(len(unloaded) - 2)
        ]
        changes = np.nan_to_num([*medians, logarithm[0], logarithm[-1]] - self.rest.mean)
        excess = np.max(self.test.scores(changes.T) / self.test.least()[:, None], axis=0)
        excess[-2:] /= SINGLE_FRAME  # of the first and the last frame
        if excess.max() < 1:
            return False
        shown = self.rest.mean + changes[np.argmax(excess)]
        frame = self._frame(shown, self.rest.until_s + SETTLES_S)
        return self.setup.detector.verdict(frame).nothing < 0.5

    @property
    def stands_out(self) -> float:
        """Largest score of the last frames against the panel at rest, in standard deviations."""
        shown = np.median([*self.recent, self.level.mean], axis=0)
        return float(np.max(self.test.scores(shown - self.rest.mean)))

    @property
    def change(self) -> Array | None:
        """ln r/r0 (rows, columns) of the last recognised load; None before any."""
        return None if self.look is None else self.look.verdict.change

    @property
    def doubt(self) -> str:
        """The reason why the load on the panel is unknown, in words; '' where it is known."""
        if self.present and not self.known:
            return (
                f"something touched the panel at {self.level.since_s:.1f} s, "
                "and has not been still for long enough"
            )
        return self.history

    @property
    def _standing_look(self) -> Look | None:
        """The last recognition of the load on the panel, also before the last step, or None."""
        return None if self.look is None or self.look.over else self.look

    @property
    def _since_step(self) -> Frames:
        """Frames of the window since the last step."""
        return tuple(frame for frame in self.window if frame[0] > self.level.since_s)

    def _stepped(self, shown: Array, logarithm: Array, time: float) -> "Watch":
        """Return the watch after a frame.

        A step back to the level before the last one continues that level, another one begins a new
        interval. Any other frame continues the present one.

        Parameters
        ----------
        shown : array, shape (cells,)
            Median of the last three frames.
        logarithm : array, shape (cells,)
            The frame.
        time : float
            s.
        """
        if not self._steps_to(shown, time):
            return self._continued(shown, logarithm, time)
        resumed = self._resumed(shown)
        if resumed is not self:
            return resumed._stepped(shown, logarithm, time)
        begun_s = self.level.until_s
        film_sd = self.film_sd
        if not self.present and self.look is not None:  # the residue of the loads that left before
            residue = self.setup.errors.residue * self.look.reached.ravel()
            film_sd = residue * self.look.fading(begun_s)
        window = latest((*self.window, (time, logarithm)))
        return replace(
            self,
            level=Level(shown, 1.0, begun_s, time, self.level.lag),
            window=window,
            steps=(*(step for step in self.steps if step >= window[0][0]), begun_s),
            present=True,
            known=False,
            next_s=begun_s + FIRST_S,
            unloaded=self.unloaded or self._unloaded_panel(),
            film_sd=film_sd,
            former=replace(self, former=None) if self.present else None,
        )

    def _continued(self, shown: Array, logarithm: Array, time: float) -> "Watch":
        """Return the watch after a frame without a step, with parameters as in `_stepped`.

        Without a load, the panel at rest and the mean squares of the scores follow, too.
        """
        level = self.level.after(shown, time)
        if self.present:
            return replace(self, level=level, window=latest((*self.window, (time, logarithm))))
        # scores of a residue that fades are not those of noise
        counts = self._least_step(time) <= self.test.least()
        share = counts * min((time - self.level.until_s) / FOLLOWS_S, 1.0)
        scores = self.test.scores(shown - self.level.expected)
        rest = replace(level, frames=max(level.frames, self.rest.frames))
        return replace(
            self,
            level=level,
            rest=rest,
            past=remembered(self.past, rest),
            test=self.test.after(scores, share),
        )

    def _resumed(self, logarithm: Array) -> "Watch":
        """Return the state before the last step with the frames since, if readings have returned.

        Otherwise the state is unchanged.
        """
        former = self.former
        if former is None or former._steps_to(logarithm, former.level.until_s):
            return self
        return replace(
            former,
            recent=self.recent,
            sigma=self.sigma,
            window=self.window,
            level=replace(former.level, until_s=self.level.until_s),
            faults=self.faults,
        )

    def _steps_to(self, logarithm: Array, time: float) -> bool:
        """Return whether readings ln y at a time in s are a step from the level.

        So are those that have changed slowly by as much since the last look at a load.
        """
        scores = self.test.scores(logarithm - self.level.expected)
        if np.any(scores >= self._least_step(time)):
            return True
        if not self.known or self.seen is None:
            return False
        return self._is_half_of_the_load(logarithm - self.seen)

    def _is_half_of_the_load(self, change: Array) -> bool:
        """Return whether ln y changes by MIN_CHANGE of the present load where that is clearest."""
        look = self._standing_look
        if look is None:
            return False
        clearest = look.size.max()
        scores = self.test.scores(change)[look.size == clearest]
        return bool(scores.max() >= MIN_CHANGE * clearest)

    def _least_step(self, time: float) -> Array:
        """Return thresholds of the scores, (discs,): parts of the load or of a fading residue."""
        look = self.look
        size: Array | float = 0.0
        if self.present and not (self.known and self._standing_look):
            size = self.test.sizes(self.level.mean - self.rest.mean)
        elif look is not None:
            size = look.size
        share = MIN_CHANGE
        if look is not None and not self.present:
            share = self.setup.errors.residue * look.fading(time)
        return np.maximum(self.test.least(), share * size)

    def _frame(self, logarithm: Array, time: float) -> Observation:
        """Return readings ln y as an observation against the panel before the load.

        The film's residue is in C.
        """
        setup, change = self.setup.without_motion(logarithm - self.rest.mean)
        unloaded = self.unloaded or self._unloaded_panel()
        # of the errors, the motion changes those of a frame's cells, and not the unloaded panel
        baseline = replace(unloaded.baseline, model_errors=setup.moved_errors)
        measured = np.exp(self.rest.mean + change).reshape(self.setup.scene.panel.shape)
        frame = setup.frame(measured, self.sigma, baseline, time - self.rest.until_s)
        covariance = baseline.covariance.copy()
        np.einsum("ii->i", covariance)[: logarithm.size] += self._keeps(frame) ** 2
        return replace(frame, baseline=replace(baseline, covariance=covariance))

    def _unloaded_panel(self) -> UnloadedPanel:
        """Return the panel at rest."""
        return UnloadedPanel(self.setup, self.rest, self.resting_sigma, self.leaks)

    def _with_leaks(self, logarithm: Array, time: float) -> tuple["Watch", Observation]:
        """Return the watch with the leaks that readings ln y show, and the frame of the readings.

        The leaks are parts of the circuit from then on. The panel at rest is that of the same cells
        with them. Leaks between lines of modules are not sought.
        """
        watch = self
        frame = watch._frame(logarithm, time)
        for _ in range(LEAK_ROUNDS if self.setup.scene.panel.modules is None else 0):
            leaks = leaks_of(frame)
            if leaks is None:
                break
            baseline = frame.baseline
            before = baseline.network().reading()
            after = replace(baseline, leaks=leaks).network().reading()
            rest = replace(watch.rest, mean=watch.rest.mean + np.log(after / before).ravel())
            watch = replace(watch, rest=rest, leaks=leaks)
            watch = replace(watch, unloaded=watch._unloaded_panel())
            frame = watch._frame(logarithm, time)
        if watch is self:
            return self, frame
        begun_s = time if self.known else self.level.since_s
        # The next sample of suction begins anew, because the readings have changed otherwise.
        loads = tuple(
            replace(load, track=load.track and replace(load.track, moves=-1))
            for load in self.attachments
        )
        leaks_since_s = min(self.leaks_since_s, begun_s)
        return replace(watch, leaks_since_s=leaks_since_s, attachments=loads), frame

    def _left(self, frame: Observation) -> bool:
        """Return whether a frame shows no more of each load than the film's residue, or of none."""
        return all(self._has_left(load, frame) for load in self._standing)

    def _has_left(self, load: Attachment, frame: Observation) -> bool:
        """Return whether a frame shows no more of one load than the film's residue."""
        if load.held is None or self.look is None:
            return True
        change = frame.free_map - self._shared(frame)
        read = self.sigma < frame.measured
        return load.held.has_left(
            change, frame.free_sd, self.look.reached, self.setup.errors.residue, read
        )

    @property
    def _standing(self) -> tuple[Attachment, ...]:
        """The attachments that are present."""
        return tuple(load for load in self.attachments if load.present)

    def _shared(self, frame: Observation) -> Array:
        """Return ln r/r0, (rows, columns), by the water's level and by what cells share beside it.

        The latter, as temperature changes it, is the median over the cells without a load.
        """
        level = frame.common_change.mean
        change = frame.free_map - level
        look = self._standing_look
        free = change if look is None else change[look.verdict.changed == 0]
        return level + (np.median(free) if free.size else 0.0)

    def _keeps(self, frame: Observation) -> Array | float:
        """Return `film_sd` after a step of the recognised load.

        The film keeps the residue of each cell's decrease from the largest |ln r/r0| it reached.
        """
        look = self._standing_look
        if self.known or look is None:
            return self.film_sd
        fall = np.maximum(look.reached - np.abs(frame.free_map), 0.0).ravel()
        return np.maximum(self.film_sd, self.setup.errors.residue * fall)

    def _gone(self, time: float) -> "Watch":
        """Return the watch after the load has left at a time in s.

        The present readings become the baseline where a load had been recognised, and where those
        of a bare panel stand out of the baseline before, as those of a level that has risen.
        """
        look = self._standing_look
        changed = look is None and self._stands_out_in(self.level.mean)
        watch = self if look or changed else self._with_brief_load()
        closed = tuple(load.ended(time) if load.present else load for load in watch.attachments)
        watch = replace(
            watch,
            present=False,
            known=False,
            former=None,
            attachments=closed,
            film_sd=0.0,
            next_s=np.inf,
            window=(),
            steps=(),
            unloaded=None,
        )
        if look is None and not changed:
            return replace(watch, level=replace(self.rest, until_s=self.level.until_s))
        rest = replace(self.level, since_s=time)
        over = look and replace(look, time_s=time, over=True)
        return replace(watch, level=rest, rest=rest, look=over or self.look)

    def _with_brief_load(self) -> "Watch":
        """Return the watch with a load that has left before it was looked at.

        On a mat its contacts are recognised, from the frames in which it stood. Suction is not
        known so soon, so on other panels only the time of the load is noted.
        """
        stood = [
            (time, logarithm)
            for time, logarithm in self.window
            if self._stands_out_in(logarithm)
            and self._stands_out_in(logarithm + self.rest.mean - self.level.mean)
        ]
        if len(stood) < MIN_FRAMES:
            return self
        times, logarithms = zip(*stood, strict=True)
        begin = times[0]
        end = self.level.since_s
        if not self.setup.detector.any_form:
            return replace(self, brief=(*self.brief, (begin, end)))
        frame = self._frame(np.median(logarithms, axis=0), begin)
        verdict = self.setup.detector.verdict(frame)
        loads = [load.ended(end) for load in attachments_of(verdict, begin, any_form=True)]
        return replace(self, attachments=(*self.attachments, *loads))

    def _looked(self, time: float) -> "Watch":
        """Return the watch after a look.

        Loads are recognised from the median of the frames since the last step. The next look
        follows after twice the time since the step, at the latest after LOOKS_S. One that fails is
        left out. So is one that shows a further leak within MIN_WINDOW_S of the step: water between
        lines stays, while the blades of a plant come and go.
        """
        # between two looks, the window has the frames of a departure that is no step
        longest = WINDOW_S if len(self._standing) > 1 else LOOKS_S
        again = time + min(max(time - self.level.since_s, FIRST_S), longest)
        median = np.median([logarithm for _, logarithm in self._since_step], axis=0)
        try:
            watch, frame = self._with_leaks(median, time)
            if len(watch.leaks) > len(self.leaks) and time - self.level.since_s < MIN_WINDOW_S:
                return replace(self, next_s=again)
            verdict = watch.setup.detector.verdict(frame)
        except (ArithmeticError, ValueError) as error:
            logged_reason(error, f"look at {time:.1f} s")
            return replace(self, next_s=again)
        return watch._after(verdict, time, again)

    def _after(self, verdict: Verdict, time: float, again: float) -> "Watch":
        """Return the watch after a verdict at a time in s; the next look is at `again`."""
        frame = verdict.frame
        since = self.level.since_s
        noise = verdict.nothing > exp(-RARE_LOG_ODDS) * (1 - verdict.nothing)  # as some steps
        quiet = noise or self._is_residue(verdict)
        look = self.look
        loads = list[Attachment]()
        seen = np.log(frame.measured).ravel()
        change = seen - self.rest.mean - frame.level_reading
        if not quiet:
            sizes = self.test.sizes(change)
            look = Look.after(self.look, verdict, sizes, time)
            first = self._standing_look is None and not self.attachments
            if first and relieved_by_departure(verdict) and self.setup.explained():
                return replace(self, look=look, history=LEFT.format(since))._gone(since)
            loads = attachments_of(
                verdict,
                since,
                patterns_of(verdict, self.test.whitening),
                any_form=self.setup.detector.any_form,
            )
            if self._standing_look is None and self._as_before(verdict):
                return self._gone(since)
        watch = replace(self, known=True, next_s=again, former=None, seen=seen)
        if not loads and not quiet and self._standing_look is None:
            watch = replace(watch, history=RELIEVED)
            return watch if time - since < WINDOW_S else watch._gone(since)
        # the readings may still show a load that was recognised since the last step
        shown = quiet and self.known and self._is_half_of_the_load(change)
        if not loads and self._left(frame) and not shown:
            return self._gone(time if self.known else since)
        has_left = partial(self._has_left, frame=frame)
        attachments = continued_by(
            self.attachments, loads, since, frame, has_left, again=self.known
        )
        return replace(
            watch,
            film_sd=self._keeps(frame),
            look=look if loads else self.look,
            attachments=tuple(
                load.departed(self.window, self.test.whitening, frame, loads)
                if self.known and has_left(load)
                else load
                for load in attachments
            ),
        )

    def _as_before(self, verdict: Verdict) -> bool:
        """Return whether the panel rather is as it was without a load at an earlier time.

        That is a time at which its readings stood out of the present baseline.
        """
        panels = (
            UnloadedPanel(self.setup, level, self.resting_sigma, self.leaks)
            for level in self.past
            if self._stands_out_in(level.mean)
        )
        return any(is_as_before(verdict, panel.baseline.logarithm) for panel in panels)

    def _stands_out_in(self, logarithm: Array) -> bool:
        """Return whether readings ln y show a load on the panel at rest."""
        scores = self.test.scores(logarithm - self.rest.mean)
        return bool(np.any(scores >= self.test.least()))

    def _is_residue(self, verdict: Verdict) -> bool:
        """Return whether a step has left no more than the film's residue of all loads.

        The cells that the loads have reached, before a slide, too, then show no more than it.
        """
        look = self._standing_look
        if self.known or look is None:
            return False
        change = verdict.changed
        remains = np.where(change != 0, change - self._shared(verdict.frame), 0.0)
        if any(load.held is not None and np.any(load.held.change < 0) for load in self._standing):
            remains = np.minimum(remains, 0.0)
        remains = np.where(np.abs(remains) > MIN_FALL, np.abs(remains), 0.0)  # less is drift
        residues = NOISE_REACH * self.setup.errors.residue * look.reached
        return bool(np.sum(remains**2) <= np.sum(remains * residues))

    def _heard(self) -> "Watch":
        """Return the watch with judged breath and suction of every load.

        A breath is judged at most once in JUDGED_S, suction once in BLOCK_S. The last frame is left
        out of a breath, because it may be the first one of a release. After a step the load may
        have left, so its breath is judged again from the next recognition on.
        """
        assert self.look is not None
        verdict = self.look.verdict
        whitening = self.test.whitening
        loads = list(self.attachments)
        for number, load in enumerate(loads):
            if load.present and load.patterns is not None:
                loads[number] = load.sampled(self.window, whitening, verdict.frame)
                if self.known:
                    loads[number] = loads[number].listened(
                        self.window[:-1], self.steps, whitening, verdict
                    )
        return replace(self, attachments=tuple(loads))
