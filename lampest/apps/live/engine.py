"""Live estimation in one solver thread.

The first frames give the baseline; then the newest frame is always the next one.
"""

import logging
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from operator import methodcaller
from queue import SimpleQueue
from threading import Event
from time import monotonic
from typing import Any

import numpy as np

from lampest.apps.live.handover import Beside, Errand, Newest
from lampest.apps.live.message import HISTORY_FRAMES, Picture, Point, View, with_detected
from lampest.apps.live.state import NOTICED_PERCENT, Findings, PanelState, solved_scan
from lampest.apps.live.watcher import News, Scan, Scans, Unloaded, watcher
from lampest.apps.recognition.detect.answer import Detected
from lampest.estimate.estimator import Estimator
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.inference.readings.judge import Cleaned
from lampest.panel.panel import Mask
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

BARS_SECONDS = 0.2  # between second looks for error bars alone, which only the eye reads
LOADED_FRAMES = 3  # for the check of the circuit: a single one may have a wrong reading


@dataclass(frozen=True)
class FrameSource:
    """Source of frames.

    Attributes
    ----------
    scene : Scene
    period : float
        Seconds between frames when they were recorded.
    state : str
        Sentence shown while frames arrive.
    """

    scene: Scene
    period: float
    state: str


class Engine:
    """Live estimator: accepts frames from one thread and solves the newest in another.

    `shown` holds the current view. A single thread solves, because CasADi solvers must not be
    shared between threads. With `beside`, a second process computes weights, searches for lower
    minima, error bars and the check of the circuit, and a third recognises loads. Otherwise every
    frame waits for these.
    """

    def __init__(
        self, name: str, method: str, estimator: Estimator, baseline: int, *, beside: bool = False
    ) -> None:
        self.shown = Newest(View(name, method, "starting"))
        self._estimator = estimator
        self._baseline = baseline
        self._unloaded: list[Scan] = []
        self._frozen: Mask = np.zeros((), dtype=bool)
        self._arrivals: Newest[Scan | None] = Newest(None)
        self._pool = ThreadPoolExecutor(1, "lampest-solver")
        self._solving: Future[None] | None = None
        self._zero_asked = Event()
        self._found: SimpleQueue[Any] = SimpleQueue()
        self._beside = (
            Beside(methodcaller("run"), Errand.queued, self._take_answer) if beside else None
        )
        self._watcher = watcher(name, self._take_detected) if beside else None

    def __enter__(self) -> "Engine":
        return self

    def __exit__(self, *error: object) -> None:
        self._arrivals.close()
        self._pool.shutdown()
        for process in (self._beside, self._watcher):
            if process is not None:
                process.close()

    def finish(self) -> None:
        """Solve the waiting frame, watch all frames and accept no more.

        Raises the error that stopped the solver.
        """
        self._arrivals.close()
        self._pool.shutdown()
        if self._solving is not None:
            self._solving.result()
        if self._watcher is not None:
            self._watcher.finish()

    def show(self, **fields: Any) -> None:
        """Change fields of the view."""
        self.shown.change(lambda view: replace(view, **fields))

    def say(self, sentence: str) -> None:
        """Show a state of the port or the recording."""
        self.show(state=sentence)

    def tare(self) -> None:
        """Replace the baseline by the mean of the next frames, as many as the first one had.

        The method is thread-safe.
        """
        self._zero_asked.set()
        self._watch(self._baseline)

    def _watch(self, news: News) -> None:
        if self._watcher is not None:
            self._watcher.ask([news])

    def _take_detected(self, detected: Detected) -> None:
        """Show an answer. An answer that has changed goes to the log with its reason."""
        previous = self.shown.item.detected
        if previous is None or previous.answer != detected.answer:
            logging.getLogger("lampest").warning("%s: %s", detected.recording, detected.sentence)
        self.shown.change(partial(with_detected, detected=detected))

    def begin(self, source: FrameSource, unloaded: Sequence[Scan]) -> None:
        """Solve against the mean of unloaded frames without outliers.

        Raises InputError where one has no readings.
        """
        panel = Unloaded(source.scene, tuple(unloaded))
        try:
            cleaned = Cleaned.of(panel.recording())
        except InputError as error:
            raise InputError(
                f"the unloaded panel is no baseline: {error}; check the scene's readout"
            ) from error
        self._frozen = cleaned.frozen
        resting = cleaned.readings.mean()
        self.show(panel=source.scene.panel, state=source.state, frames=len(unloaded))
        self._watch(panel)
        self._solving = self._pool.submit(self._solve, panel, source.period, resting)

    def take(self, source: FrameSource, scan: Scan) -> None:
        """Accept a frame without waiting for the solver.

        Raises the error that stopped the solver.
        """
        if self._solving is not None and self._solving.done():
            self._solving.result()
        self.shown.change(
            lambda view: replace(view, frames=view.frames + 1, lost=view.lost + scan.lost)
        )
        if self._solving is not None:
            scan = replace(scan, recorded=np.where(self._frozen, np.nan, scan.recorded))
            self._arrivals.put(scan)
            self._watch(scan)
            if self.shown.item.state != source.state:
                self.say(source.state)
            return
        self._unloaded.append(scan)
        count = len(self._unloaded)
        self.say(f"baseline: {count} of {self._baseline} unloaded frames; keep the panel free")
        if count == self._baseline:
            self.begin(source, self._unloaded)

    def _solve(self, unloaded: Unloaded, period: float, resting: Readings) -> None:
        """Solve the newest frame until no more come.

        Check the circuit before and with the first loaded frames.
        """
        state = PanelState.begin(
            self._estimator, unloaded.scene, period, resting, hasty=self._beside is not None
        )
        self._check(unloaded)
        number = 0
        looked = 0.0
        loaded: Scans = ()
        while (news := self._arrivals.after(number)) is not None:
            assert news.item is not None
            skipped = news.number - number - 1
            number = news.number
            state = self._with_findings(state)
            if self._zero_asked.is_set():
                self._zero_asked.clear()
                state = replace(state, recent=(), missing=self._baseline)
            state, picture = solved_scan(state, news.item, len(unloaded.scans) + number, skipped)
            self.shown.change(partial(with_picture, picture=picture, zeroed=state.zeroed))
            look = state.look
            if look is not None and self._beside is not None:
                # Requests for error bars alone are rationed, since weights and searches come first.
                moment = monotonic()
                if look.due or moment - looked >= BARS_SECONDS:
                    looked = moment
                    self._beside.ask(Errand("look", look.findings, look.due))
            change = float(np.nanmean(np.abs(picture.measured_change)))
            if len(loaded) < LOADED_FRAMES and change > NOTICED_PERCENT:
                loaded = (*loaded, news.item)
                if len(loaded) == LOADED_FRAMES:
                    self._check(unloaded, loaded)
        if 0 < len(loaded) < LOADED_FRAMES:
            self._check(unloaded, loaded)

    def _with_findings(self, state: PanelState) -> PanelState:
        """Return the state with the findings of second looks.

        If the process of second looks has died, the state solves every frame completely.
        """
        while not self._found.empty():
            findings = self._found.get()
            if isinstance(findings, Exception):
                raise findings
            state = replace(state, stream=findings.apply_to(state.stream))
        if self._beside is not None and self._beside.gone and state.stream.keeps_weights:
            track = state.track or state.stream.track
            stream = replace(state.stream, keeps_weights=False, track=track)
            return replace(state, stream=stream, track=None)
        return state

    def _check(self, unloaded: Unloaded, loaded: Scans = ()) -> None:
        """Show warnings about the frames."""
        check = Errand("check", partial(_warnings, unloaded, loaded))
        if self._beside is None or self._beside.gone:
            self._take_answer(check, check.run())
        else:
            self._beside.ask(check)

    def _take_answer(self, errand: Errand, answer: Any) -> None:
        """Show the answer of a check; keep other findings for the next frame."""
        if errand.kind == "check" and not isinstance(answer, Exception):
            self.show(model="\n".join(answer))
            return
        self._found.put(answer)
        if isinstance(answer, Findings) and answer.force is not None:
            self.show(deviation=answer.force.deviation, deviation_of=answer.number)


def _warnings(unloaded: Unloaded, loaded: Scans) -> tuple[str, ...]:
    """Return warnings about frames, or the reason why they cannot be read."""
    try:
        return Prepared(unloaded.recording(loaded)).warnings
    except InputError as error:
        return (str(error),)


def with_picture(view: View, picture: Picture, zeroed: str = "") -> View:
    """Return the view with a new picture and its force in the history.

    `zeroed` is the reason of a new zero, or ''.
    """
    number = picture.number
    point = Point(number, picture.time, picture.force.newton)
    zero = f"taken anew after frame {number}: {zeroed}" if zeroed else view.zero
    skipped = view.skipped + picture.skipped
    history = (*view.history, point)[-HISTORY_FRAMES:]
    view = replace(view, picture=picture, skipped=skipped, history=history, zero=zero)
    deviation = picture.force.deviation
    return view if np.isnan(deviation) else replace(view, deviation=deviation, deviation_of=number)
