"""Commands for a board on a serial port."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lampest.cli import screen
from lampest.files.errors import InputError, counted

if TYPE_CHECKING:
    from lampest.apps.board.record import Progress, Recorded
    from lampest.apps.calibration import Calibration

PORT = (
    "Serial port such as /dev/ttyACM0, or a URL. Default: the Arduino. Repeat it for each "
    "module, in order."
)
Port = Annotated[list[str] | None, screen.option(PORT)]
SceneFile = Annotated[
    Path | None, screen.option("YAML file of the scene. Default: the board's settings.")
]
Frames = Annotated[
    int | None, screen.option("Stop after this number of frames, such as 600.", min=1)
]
Period = Annotated[
    float | None,
    screen.option("Seconds between frames, such as 0.1. Default: 1.", callback=screen.positive),
]


def record(
    out: screen.Output = None,
    port: Port = None,
    count: Frames = None,
    seconds: screen.Amount = None,
    scene: SceneFile = None,
    assign: screen.AssignToScene = None,
    baseline: Annotated[int, screen.option(min=0)] = 0,
    period: Period = None,
    list_: bool = False,
) -> None:
    """Record a board until the count or the time is reached, or Ctrl-C; any key marks an event.

    Parameters
    ----------
    out
        New recording file.
    seconds
        Stop after this number of seconds, such as 60.
    baseline
        Number of unloaded frames at the beginning, such as 3.
    list_
        List the serial ports, likely ones first, and exit.
    """
    from lampest.apps.board.port import ports, pressed_keys
    from lampest.apps.board.record import record as record_board

    if list_:
        available = ports()
        for device in available:
            remark = "  (looks like an Arduino)" if device.likely else ""
            screen.say(f"{device.url}  {device.description}{remark}")
        if not available:
            screen.say("there is no serial port", to=sys.stderr)
        return
    if out is None:
        raise InputError("--out: name the new recording")
    if count is not None and seconds is not None:
        raise InputError("--count and --seconds: give one of them")
    options: dict[str, Any] = {
        "frames": count,
        "seconds": seconds,
        "baseline": baseline,
        "period": period,
    }
    recorded_scene = screen.scene_of(scene, assign)
    with pressed_keys() as keys, screen.progress("waiting for the board") as show:

        def on_progress(at: "Progress") -> None:
            time = "" if at.sample is None else f" at {at.sample.time:.1f} s"
            show(
                at.frames,
                count,
                f"{at.frames} frames{time}, {at.lost} lost{at.state and f'; {at.state}'}",
            )

        done = record_board(
            port, out, **options, scene=recorded_scene, on_progress=on_progress, keys=keys
        )
    report_recorded(done)


def calibrate(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...")],
    known: list[str] | None = None,
    loads: Path | None = None,
    from_recording: bool = False,
    tolerance: float = 0.01,
    out: screen.Output = None,
) -> None:
    """Calibrate the electronics or the film, and write a scene.

    The electronics are calibrated with known resistors or many loads, the film with known loads.
    Every number comes with its uncertainty.

    Parameters
    ----------
    files
        Recordings of shorted lines, resistors or loads.
    known
        Resistors in place of the cells, in ohm, or a .csv or .npy table; one for each file.
    loads
        YAML or CSV of known weights or pressures, to calibrate the film's response.
    from_recording
        Calibrate channels and reference from ordinary recordings under many loads.
    tolerance
        Relative tolerance of resistors or loads: 0.01 for 1 %.
    out
        Scene file to write. Default: print it.
    """
    from lampest.files.whole import write_whole

    if not 0 <= tolerance <= 0.5:
        raise InputError("--tolerance must lie between 0 and 0.5")
    if sum((loads is not None, bool(known), from_recording)) > 1:
        raise InputError(
            "--known, --loads and --from-recording are different calibrations: give one of them"
        )
    words = known or ["0"]
    if len(words) not in (1, len(files)):
        raise InputError(f"--known: give one for each of the {len(files)} files, or one for all")
    calibration = _calibrated(files, words, loads, from_recording, tolerance)
    if out is None:
        screen.say_text(calibration.text().removesuffix("\n"))
    else:
        write_whole(out, calibration.text())
        screen.say(f"{calibration.summary}: {out}")
    for warning in calibration.warnings:
        screen.warn(warning)


def _calibrated(
    files: list[Path], words: list[str], loads: Path | None, from_recording: bool, tolerance: float
) -> "Calibration":
    """Return the calibration with known loads, ordinary recordings or resistors that words name."""
    from lampest.recording.recording import Recording

    recordings = [Recording.load(file) for file in files]
    with screen.progress("calibrating"):
        if loads is not None:
            from lampest.apps.calibration.known_loads import read_known_loads
            from lampest.apps.calibration.loads import calibrate_loads

            return calibrate_loads(recordings, read_known_loads(loads), tolerance)
        if from_recording:
            from lampest.apps.calibration.channels import calibrate_channels

            return calibrate_channels(recordings)
        from lampest.apps.calibration.resistors import calibrate_resistors
        from lampest.apps.calibration.trials import known_resistors

        named = zip(recordings, words * (len(recordings) // len(words)), strict=True)
        tables = [known_resistors(word, recording.scene.panel) for recording, word in named]
        return calibrate_resistors(recordings, tables, tolerance)


def live(
    port: Port = None,
    recording: Path | None = None,
    estimator: str | None = None,
    config: Path | None = None,
    assign: screen.Assign = None,
    speed: Annotated[float, screen.option(callback=screen.positive)] = 1.0,
    http: str = "127.0.0.1:8137",
    token: Annotated[str | None, screen.option(envvar="LAMPEST_TOKEN")] = None,
    count: Frames = None,
    baseline: screen.Count = 3,
    scene: SceneFile = None,
    period: Period = None,
    out: screen.Output = None,
    publish: Annotated[list[str] | None, screen.option(metavar="WHERE")] = None,
) -> None:
    """Reconstruct frames as they arrive and show them in the browser.

    Parameters
    ----------
    recording
        A recording to replay instead.
    estimator
        Default: smooth, or the first of --config.
    config
        A run's YAML file with estimators.
    speed
        Speed of the replay relative to the recording, such as 10.
    http
        HOST:PORT of the page; 127.0.0.1 is visible on this computer only.
    token
        Access token of the page; by default one is generated.
    baseline
        Number of unloaded frames at the beginning, unless the recording marks them.
    out
        Record the board into this file as well.
    publish
        lsl, osc, mqtt or websocket, with an optional address: mqtt://localhost:1883/lampest.
        Repeatable.
    """
    from lampest.apps.live.run import LiveBoard, Outlets, Replay, chosen
    from lampest.apps.live.run import live as run_live
    from lampest.files.process import ending_signals

    if recording is not None and (port or scene or period or out):
        raise InputError("--recording: --port, --scene, --period and --out are for a board")
    if assign and config is None:
        raise InputError("--set: overrides entries of a run's file; name one with --config")
    source: LiveBoard | Replay = LiveBoard(
        tuple(port or ()), screen.scene_of(scene, None), baseline, period, out
    )
    if recording is not None:
        source = Replay(recording, speed, baseline)

    def on_address(url: str) -> None:
        screen.say(f"{url}  (Ctrl-C ends)" if url.startswith("http") else url)

    with ending_signals():  # every end of the command sends the board its command to stop
        estimators = chosen(estimator, config, tuple(assign or ()))
        outlets = Outlets(http, token, publish or ())
        done = run_live(source, estimators, outlets, count, on_address, screen.warn)
    if done is not None:
        report_recorded(done)


def report_recorded(done: "Recorded") -> None:
    """Print a summary of a recording and warnings about it.

    Raises typer.Exit with code 130 for an interrupted recording.
    """
    noise = "" if done.noise_lsb is None else f", noise of one reading {done.noise_lsb:.2f} LSB"
    screen.say(
        f"{done.frames} frames, {done.lost} lost, {done.restarts} restarts of the board{noise}: "
        f"{done.path}"
    )
    jumps = "1 jump" if done.clock_jumps == 1 else f"{done.clock_jumps} jumps"
    parted, behind = (
        f"{count} of the {done.frames} frames" for count in (done.parted, done.behind)
    )
    bare = done.scene.circuit.unit == "ohm" and not done.scene.series_resistance_ohm
    for true, sentence in (
        (
            done.clock_jumps,
            f"{jumps} of the board's clock; events mark where, and time goes on by the period",
        ),
        (
            done.clock_stopped,
            "the board's clock stood still; an event marks since when, and time goes on by this "
            "computer's clock",
        ),
        (
            done.host_clock_set,
            f"this computer's clock was set {counted(done.host_clock_set, 'time')}; events mark "
            "where, and no time of a frame depends on it",
        ),
        (done.parted, f"{parted} lack a module; events mark which was gone, and when it was back"),
        *(
            (True, f"the board did not estimate {count} of the {done.frames} frames: {reason}")
            for reason, count in done.unestimated
        ),
        (done.silent, f"no frame came in the last {done.silent:.1f} s"),
        (
            bare,
            "no series resistance is assumed, because the scene names none; two multiplexer "
            "channels have "
            "some 140 ohm, which lampest calibrate measures",
        ),
        (
            done.ended_by,
            f"{done.ended_by} ended the recording; "
            f"{f'{behind} were' if done.behind else 'no frame was'} "
            "still in the port then",
        ),
    ):
        if true:
            screen.warn(sentence)
    if done.ended_by:
        raise typer.Exit(screen.INTERRUPTED)
