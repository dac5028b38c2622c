"""State of a live panel between frames: estimate, load, and the second look at a frame."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.apps.film.pressure import Force, Pressure, PressureTrack, total_force
from lampest.apps.live.message import BOTH, NOTHING, PRESSING, SUCKING, UNKNOWN, Picture
from lampest.apps.live.watcher import Scan
from lampest.estimate.estimator import Estimator
from lampest.estimate.modules import begin_stream
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.levels import OUTLIER_THRESHOLD
from lampest.inference.readings.outliers import FramesBefore
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import Scene
from lampest.posterior.track import Bars, Track
from lampest.recording.readings import Readings
from lampest.report.strongest import as_recorded, percent_change
from lampest.solvers.solution import SAME_MINIMUM

ASKED = "it was asked for"
# Change of a reading: far above the noise of any readout, and less than that by a finger.
NOTICED_PERCENT = 1.0
# Share of the strongest |ln r/r₀|: residues of penalties beside a load are smaller, the inside of a
# mouth is larger.
MIN_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Findings:
    """Findings of a second look at a frame, for later frames.

    Attributes
    ----------
    number : int
        Number of the frame.
    weights, weighed_at
        As in `Stream`.
    lower : array, shape (rows, columns), or None
        Cells in ohm of a lower minimum, or of other weights.
    force : Force or None
        Total force with its error.
    """

    number: int
    weights: tuple[float, ...] | None
    weighed_at: float
    lower: Array | None
    force: Force | None

    def apply_to(self, stream: Stream) -> Stream:
        """Return the stream with these findings applied."""
        stream = replace(stream, weights=self.weights, weighed_at=self.weighed_at)
        return stream if self.lower is None else replace(stream, previous=self.lower)


@dataclass(frozen=True, eq=False)
class SecondLook:
    """A frame to be solved again, with its own weights, all starts and error bars.

    Attributes
    ----------
    number, time : int, float
        Frame and its time in s.
    stream, load
        State before the frame.
    readings : Readings
    objective : float
        Cost of the minimum of the first solve.
    due : bool
        Whether weights or starts were left open.
    """

    number: int
    time: float
    stream: Stream
    load: PressureTrack
    readings: Readings
    objective: float
    due: bool

    def findings(self) -> Findings:
        """Solve the frame again."""
        stream, step = self.stream.push(self.readings)
        cells = step.estimate(-1)
        lower = None
        force = None
        if cells is not None:
            same_weights = stream.weights == self.stream.weights
            if not same_weights or step.solution.objective <= self.objective * (1 - SAME_MINIMUM):
                lower = cells
            if step.bars is not None and not np.isnan(stream.baseline_resistance).any():
                ratio = cells / stream.baseline_resistance
                _, force = read_load(self.load, ratio, step.bars, self.time)
        return Findings(self.number, stream.weights, stream.weighed_at, lower, force)


@dataclass(frozen=True, eq=False)
class PanelState:
    """State carried from frame to frame.

    Attributes
    ----------
    stream : Stream
    load : PressureTrack
    recent : tuple of Readings
        The newest readings.
    missing : int or None
        Frames still required for a requested zero.
    zeroed : str
        Reason for a new zero after the last frame, or ''.
    track : Track or None
        Data for the error bars of second looks, if frames are solved in haste.
    look : SecondLook or None
        Second look that the last frame requires.
    previous : FramesBefore
        Previous frames as they arrived.
    """

    stream: Stream
    load: PressureTrack
    recent: tuple[Readings, ...] = ()
    missing: int | None = None
    zeroed: str = ""
    track: Track | None = None
    look: SecondLook | None = None
    previous: FramesBefore = FramesBefore()

    @classmethod
    def begin(
        cls,
        estimator: Estimator,
        scene: Scene,
        period: float,
        resting: Readings,
        *,
        hasty: bool = False,
    ) -> "PanelState":
        """Return the state for unloaded readings; `hasty` as in `in_haste`.

        Raises InputError as `Stream.begin`. Modules are solved together and without second looks;
        they get error bars on request only.
        """
        if scene.panel.modules is not None and estimator.error_bars == "auto":
            estimator = replace(estimator, error_bars=False)
        stream = begin_stream(estimator, scene, period, resting)
        start = cls(stream, PressureTrack.begin(scene, tare=estimator.tare))
        return start.in_haste() if hasty and not stream.joined else start

    def in_haste(self) -> "PanelState":
        """Return a state that solves frames as fast as possible.

        Error bars and weights are left to second looks. The first weights are those of the
        baseline.
        """
        stream = self.stream
        baseline = stream.baseline
        if (
            stream.weights is None
            and baseline is not None
            and baseline.solution.solved
            and len(baseline.weights) == len(stream.estimator.terms)
        ):
            stream = replace(stream, weights=baseline.weights)
        track = None if stream.estimator.relative else stream.track
        kept = None if track else stream.track
        return replace(self, stream=replace(stream, keeps_weights=True, track=kept), track=track)

    def after(self, readings: Readings, ratio: Array | None, time: float) -> "PanelState":
        """Return the state after a solved frame.

        A requested zero, or an untouched panel, renews the zero.
        """
        tare = self.stream.estimator.tare
        most = max(0 if tare is None else tare.frames, len(self.recent) + 1 if self.missing else 0)
        state = replace(self, zeroed="", recent=(*self.recent, readings)[-most:] if most else ())
        state = state if ratio is None else replace(state, load=self.load.after(ratio, time))
        if self.missing is not None:
            state = replace(state, missing=self.missing - 1)
            return state if state.missing else state._zeroed(state.recent, time, ASKED)
        if ratio is None or not state.load.tared or tare is None:
            return state
        return state._zeroed(state.recent[: tare.frames // 2], time, state.load.tared)

    def second_look(
        self, number: int, time: float, readings: Readings, step: Step
    ) -> SecondLook | None:
        """Return the second look at a frame that was solved in haste; None if nothing is open."""
        stream = self.stream
        due = stream.weights_due(readings)
        is_open = due or self.track is not None
        if not (stream.keeps_weights and step.solution.solved and is_open):
            return None
        baseline = stream.baseline and stream.baseline.bare()
        stream = replace(
            stream, keeps_weights=False, prepared=None, track=self.track, baseline=baseline
        )
        return SecondLook(number, time, stream, self.load, readings, step.solution.objective, due)

    def ratio(self, step: Step) -> Array | None:
        """Return r/r_baseline (rows, columns) of a frame; None without a solution or a baseline."""
        baseline = self.stream.baseline_resistance
        if not step.solution.solved or np.isnan(baseline[~self.stream.scene.broken]).any():
            return None
        return np.asarray(step.solution.cell_resistance[-1] / baseline)

    def _zeroed(self, frames: tuple[Readings, ...], time: float, why: str) -> "PanelState":
        """Return the state with the mean of some frames as its zero.

        Frames with too few readings leave the zero unchanged.
        """
        first, *following = frames
        zero = first.together(*following).mean()
        if not zero.enough(self.stream.scene):
            return replace(self, missing=None, recent=())
        stream = replace(self.stream, track=self.track or self.stream.track).tared(zero)
        start = PanelState(stream, self.load.rebased(time), zeroed=why)
        return start.in_haste() if stream.keeps_weights else start


def solved_scan(
    state: PanelState, scan: Scan, number: int, skipped: int
) -> tuple[PanelState, Picture]:
    """Solve a frame without the readings that no cells give.

    Parameters
    ----------
    state : PanelState
        State before the frame.
    scan : Scan
        The frame.
    number : int
        Number of the frame.
    skipped : int
        Frames skipped before this one.

    Returns
    -------
    state : PanelState
        State for the next frame.
    picture : Picture
        NaN with the reason if the frame failed.
    """
    state = replace(state, look=None)
    stream = state.stream
    time = scan.time
    scene = stream.scene
    before = state.previous
    picture = _unsolved_picture(scan, scene, number, skipped)
    try:
        readings = Readings.of(scene, scan.recorded, scan.sigma)
        change = percent_change(
            *(as_recorded(frame.shown, scene) for frame in (readings, stream.resting))
        )
        picture = replace(picture, measured_change=change)
        if not stream.joined:
            state = replace(state, previous=before.after(readings))
            readings, outliers = before.without_impossible(readings, scene)
            picture = replace(picture, outliers=outliers)
        stream, step = stream.push(readings)
    except InputError as error:
        return state, replace(picture, status=str(error))
    look = state.second_look(number, time, readings, step)
    state = replace(state, stream=stream, look=look)
    picture = replace(picture, status=step.status, seconds=step.seconds)
    ratio = state.ratio(step)
    if ratio is not None:
        picture = _with_load(picture, state, readings, step, ratio)
    elif step.solution.solved:
        assert stream.baseline is not None
        picture = replace(picture, status=f"no baseline: {stream.baseline.solution.status.value}")
    return state.after(readings, ratio, time), picture


def _unsolved_picture(scan: Scan, scene: Scene, number: int, skipped: int) -> Picture:
    """Return the picture of a frame before it is solved; the numbers are those of `solved_scan`."""
    unknown = np.full(scene.panel.shape, np.nan)
    board = scan.board_log_change
    return Picture(
        number,
        scan.time,
        scan.arrived,
        unknown,
        unknown,
        unknown > 0,
        UNKNOWN,
        "",
        0.0,
        skipped,
        board_change=None if board is None else 100 * np.expm1(board.astype(float)),
    )


def _with_load(
    picture: Picture, state: PanelState, readings: Readings, step: Step, ratio: Array
) -> Picture:
    """Return the picture of a solved frame with its cells, pressures, force and verdict.

    Parameters
    ----------
    picture : Picture
    state : PanelState
        State with the stream after the frame, and the load before it.
    readings : Readings
    step : Step
    ratio : array, shape (rows, columns)
        r/r_baseline.
    """
    solution = step.solution
    pressed, force = read_load(state.load, ratio, step.bars, picture.time)
    open_cell = solution.open_cell[-1]
    verdict = verdict_of(readings, state.stream.resting, ratio, open_cell.astype(bool))
    if step.bars is None and pressed is not None and "pressing" not in verdict:
        force = Force(0.0, np.nan)
    return replace(
        picture,
        relative_change=100 * (ratio - 1),
        open_cell=open_cell,
        force=force,
        cell_resistance=solution.cell_resistance[-1],
        pressure=None if pressed is None else pressed.pressure,
        saturated=None if pressed is None else pressed.saturated,
        verdict=verdict,
    )


def read_load(
    load: PressureTrack, ratio: Array, bars: Bars | None, time: float
) -> tuple[Pressure | None, Force]:
    """Return pressures of the cells of a frame and their total force.

    Cells are saturated regardless of the errors of the estimate.

    Parameters
    ----------
    load : PressureTrack
        Pressures of the frames before.
    ratio : array
        r/r_baseline (rows, columns).
    bars : Bars or None
        Error bars of the estimate, or None.
    time : float
        s.

    Returns
    -------
    pressure : Pressure or None
        In kPa; None without a response of the film.
    force : Force
        In newtons; NaN without a response of the film.
    """
    if load.scene.response is None:
        return None, Force(np.nan, np.nan)
    pressure = load.pressure(ratio, ratio, ratio, time)
    if bars is None or bars.change is None:
        return pressure, total_force(load.scene, pressure)._replace(deviation=np.nan)
    with np.errstate(over="ignore"):
        ends = ratio * np.exp(-bars.change.below), ratio * np.exp(bars.change.above)
        barred = load.pressure(ratio, *ends, time, bars.change.own)
    return pressure, total_force(load.scene, replace(barred, saturated=pressure.saturated))


def verdict_of(readings: Readings, resting: Readings, ratio: Array, open_cell: Mask) -> str:
    """Return the verdict on a solved frame, one of `message.VERDICTS`.

    NOTHING: no reading differs from its unloaded value by more than OUTLIER_THRESHOLD standard
    deviations, after the median difference, which a drift of the supply causes, is subtracted.
    Otherwise PRESSING or SUCKING: the lowest or the highest ln r/r₀ exceeds MIN_SHARE of the
    strongest.

    Parameters
    ----------
    readings, resting : Readings
        The frame and the unloaded panel, (rows, columns).
    ratio : array, shape (rows, columns)
        r/r₀.
    open_cell : boolean array, shape (rows, columns)
        Cells that cannot be distinguished from open ones; they do not count.
    """
    # ln of readings over unloaded ones without the common change, against σ of that logarithm
    moved = np.log(readings.shown / resting.shown)
    moved -= np.nanmedian(moved)
    sigma = readings.sigma_of_values
    resting_sigma = resting.sigma_of_values
    least = np.asarray(NOTICED_PERCENT / 100)
    if sigma is not None and resting_sigma is not None:
        least = OUTLIER_THRESHOLD * np.hypot(sigma / readings.shown, resting_sigma / resting.shown)
    noticed = np.abs(moved) > least
    change = np.log(ratio[~open_cell & np.isfinite(ratio)])
    if not np.any(noticed) or not change.size:
        return NOTHING
    least_loaded = MIN_SHARE * np.max(np.abs(change))
    pressing = -np.min(change) > least_loaded
    sucking = np.max(change) > least_loaded
    if pressing and sucking:
        return BOTH
    return SUCKING if sucking else PRESSING
