"""Commands for a board on a serial port."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli.screen import (
    INTERRUPTED,
    Assign,
    AssignToScene,
    check_positive,
    option,
    progress,
    say,
    say_text,
    scene_of,
    warn,
    written,
)
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from lampest.estimate.calibration import Calibration
    from lampest.recording.board.record import Progress, Recorded

PORT = "Serial port such as /dev/ttyACM0, or a URL. Default: the Arduino. Repeat it for each module, in order."
Port = Annotated[list[str] | None, option(PORT)]
SceneFile = Annotated[Path | None, option("YAML file of the scene. Default: the board's settings.")]
Count = Annotated[int | None, option("Stop after this number of frames, such as 600.", min=1)]
TOKEN = "Access token of the page; outside 127.0.0.1 one is generated."
Token = Annotated[str | None, option(TOKEN, envvar="LAMPEST_TOKEN")]
PUBLISH = "lsl, osc, mqtt or websocket, with an optional address: mqtt://localhost:1883/lampest. Repeatable."
Publish = Annotated[list[str] | None, option(PUBLISH, metavar="WHERE")]
Period = Annotated[float | None, option("Seconds between frames, such as 0.1. Default: 1.")]


def record(
    out: Annotated[Path | None, written("--out", "New recording file.")] = None,
    port: Port = None,
    count: Count = None,
    seconds: Annotated[float | None, option("Stop after this number of seconds, such as 60.")] = None,
    scene: SceneFile = None,
    assign: AssignToScene = None,
    baseline: Annotated[int, option("Number of unloaded frames at the beginning, such as 3.", min=0)] = 0,
    period: Period = None,
    listed: Annotated[bool, option("List the serial ports, likely ones first, and exit.", "--list")] = False,
) -> None:
    """Record a board until the count or the time is reached, or Ctrl-C; any key marks an event."""
    if listed:
        from lampest.recording.board.port import ports

        available = ports()
        for device in available:
            say(f"{device.url}  {device.description}{'  (looks like an Arduino)' if device.likely else ''}")
        if not available:
            say("there is no serial port", to=sys.stderr)
        return
    if out is None:
        raise InputError("--out: name the new recording")
    from lampest.recording.board.port import pressed_keys
    from lampest.recording.board.record import record as record_board

    if count is not None and seconds is not None:
        raise InputError("--count and --seconds: give one of them")
    check_positive("--seconds", seconds)
    check_positive("--period", period)
    agreed = scene_of(scene, assign)
    with pressed_keys() as keys, progress("waiting for the board") as show:

        def on_progress(at: "Progress") -> None:
            time = "" if at.sample is None else f" at {at.sample.time:.1f} s"
            show(at.frames, count, f"{at.frames} frames{time}, {at.lost} lost{at.state and f'; {at.state}'}")

        done = record_board(
            port,
            out,
            frames=count,
            seconds=seconds,
            scene=agreed,
            baseline=baseline,
            period=period,
            on_progress=on_progress,
            keys=keys,
        )
    report_recorded(done)


def calibrate(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings of shorted lines, resistors or loads.")
    ],
    known: Annotated[
        list[str] | None, option("Resistors in place of the cells, in ohm, or a .csv or .npy table; one for each file.")
    ] = None,
    loads: Annotated[
        Path | None, option("YAML or CSV of known weights or pressures, to calibrate the film's response.")
    ] = None,
    from_recording: Annotated[
        bool, option("Calibrate channels and reference from ordinary recordings under many loads.", "--from-recording")
    ] = False,
    tolerance: Annotated[float, option("Relative tolerance of resistors or loads: 0.01 for 1 %.")] = 0.01,
    out: Annotated[Path | None, written("--out", "Scene file to write. Default: print it.")] = None,
) -> None:
    """Calibrate the electronics with known resistors or many loads, or the film with known loads, and write a scene.

    Every number comes with its uncertainty.
    """
    from lampest.files.whole import write_whole
    from lampest.recording.recording import Recording

    if not 0 <= tolerance <= 0.5:
        raise InputError("--tolerance must lie between 0 and 0.5")
    if sum((loads is not None, bool(known), from_recording)) > 1:
        raise InputError("--known, --loads and --from-recording are different calibrations: give one of them")
    words = known or ["0"]
    if len(words) not in (1, len(files)):
        raise InputError(f"--known: give one for each of the {len(files)} files, or one for all")
    recordings = [Recording.load(file) for file in files]
    calibration: Calibration
    with progress("calibrating"):
        if loads is not None:
            from lampest.estimate.calibration.known_loads import read_known_loads
            from lampest.estimate.calibration.loads import calibrate_loads

            calibration = calibrate_loads(recordings, read_known_loads(loads), tolerance)
        elif from_recording:
            from lampest.estimate.calibration.channels import calibrate_channels

            calibration = calibrate_channels(recordings)
        else:
            from lampest.estimate.calibration.resistors import calibrate_resistors
            from lampest.estimate.calibration.trials import known_resistors

            named = zip(recordings, words * (len(files) // len(words)), strict=True)
            tables = [known_resistors(word, recording.scene.panel) for recording, word in named]
            calibration = calibrate_resistors(recordings, tables, tolerance)
    if out is None:
        say_text(calibration.text().removesuffix("\n"))
    else:
        write_whole(out, calibration.text())
        say(f"{calibration.summary}: {out}")
    for warning in calibration.warnings:
        warn(warning)


def live(
    port: Port = None,
    recording: Annotated[Path | None, option("A recording to replay instead.")] = None,
    estimator: Annotated[str | None, option("Default: smooth, or the first of --config.")] = None,
    config: Annotated[Path | None, option("A run's YAML file with estimators.")] = None,
    assign: Assign = None,
    speed: Annotated[float, option("Speed of the replay relative to the recording, such as 10.")] = 1.0,
    http: Annotated[
        str, option("HOST:PORT of the page; 127.0.0.1 is visible on this computer only.")
    ] = "127.0.0.1:8137",
    token: Token = None,
    count: Count = None,
    baseline: Annotated[
        int, option("Number of unloaded frames at the beginning, unless the recording marks them.", min=1)
    ] = 3,
    scene: SceneFile = None,
    period: Period = None,
    out: Annotated[Path | None, written("--out", "Record the board into this file as well.")] = None,
    publish: Publish = None,
) -> None:
    """Reconstruct frames as they arrive and show them in the browser."""
    from lampest.files.process import ending_signals
    from lampest.report.live.run import LiveBoard, Outlets, Replay, chosen
    from lampest.report.live.run import live as run_live

    check_positive("--speed", speed)
    check_positive("--period", period)
    if recording is not None and (port or scene or period or out):
        raise InputError("--recording: --port, --scene, --period and --out are for a board")
    if assign and config is None:
        raise InputError("--set: overrides entries of a run's file; name one with --config")
    source: LiveBoard | Replay = LiveBoard(tuple(port or ()), scene_of(scene, None), baseline, period, out)
    if recording is not None:
        source = Replay(recording, speed, baseline)
    with ending_signals():  # every end of the command sends the board its command to stop
        done = run_live(
            source,
            chosen(estimator, config, tuple(assign or ())),
            Outlets(http, token, publish or ()),
            count,
            lambda url: say(f"{url}  (Ctrl-C ends)" if url.startswith("http") else url),
            warn,
        )
    if done is not None:
        report_recorded(done)


def report_recorded(done: "Recorded") -> None:
    """Print a summary of a recording and warnings about it.

    Raises typer.Exit with code 130 for an interrupted recording.
    """
    noise = "" if done.noise_lsb is None else f", noise of one reading {done.noise_lsb:.2f} LSB"
    say(f"{done.frames} frames, {done.lost} lost, {done.restarts} restarts of the board{noise}: {done.path}")
    if done.clock_jumps:
        jumps = "1 jump" if done.clock_jumps == 1 else f"{done.clock_jumps} jumps"
        warn(f"{jumps} of the board's clock; events mark where, and time goes on by the period")
    if done.clock_stopped:
        warn("the board's clock stood still; an event marks since when, and time goes on by this computer's clock")
    if done.parted:
        warn(
            f"{done.parted} of the {done.frames} frames lack a module; events mark which was gone, and when it was back"
        )
    if done.silent:
        warn(f"no frame came in the last {done.silent:.1f} s")
    if done.scene.circuit.unit == "ohm" and not done.scene.series_resistance_ohm:
        warn(
            "no series resistance is assumed, because the scene names none; two multiplexer channels have "
            "some 140 ohm, which lampest calibrate measures"
        )
    if done.ended_by:
        behind = f"{done.behind} of the {done.frames} frames were" if done.behind else "no frame was"
        warn(f"{done.ended_by} ended the recording; {behind} still in the port then")
        raise typer.Exit(INTERRUPTED)
