"""The command `record`, its options, and the repair of recordings after a crash."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli import screen
from lampest.files.errors import InputError

if TYPE_CHECKING:
    from lampest.apps.board.record import Progress, Recorded

PORT = (
    "Serial port such as /dev/ttyACM0, tcp://HOST:PORT, udp://:PORT, - or a file that grows. "
    "Default: the Arduino. Repeat it for each module, in order."
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
Lines = Annotated[
    bool, screen.option("The board prints numbers as text; it is not asked for its protocol.")
]
Baud = Annotated[
    int | None,
    screen.option("Rate of the serial port, such as 115200. Default: usual ones are tried.", min=1),
]
Unit = Annotated[
    str | None,
    screen.option("Unit of printed numbers: ohm, kohm, volt, mV or code. Default: by the numbers."),
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
    lines: Lines = False,
    baud: Baud = None,
    unit: Unit = None,
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
    from lampest.apps.board.port import pressed_keys
    from lampest.apps.board.record import record as record_board
    from lampest.apps.board.sample import Listening

    if list_:
        _list_ports()
        return
    if out is None:
        raise InputError("--out: name the new recording")
    if count is not None and seconds is not None:
        raise InputError("--count and --seconds: give one of them")
    agreed = screen.scene_of(scene, assign)
    boards = Listening(tuple(port or ()), agreed, baseline, period, lines, baud, unit)
    with (
        pressed_keys(listens="-" not in (port or ())) as keys,
        screen.progress("waiting for the board") as show,
    ):
        done = record_board(
            boards,
            out,
            frames=count,
            seconds=seconds,
            on_progress=lambda at: show(at.frames, count, _progress_line(at)),
            keys=keys,
        )
    report_recorded(done)


def _progress_line(at: "Progress") -> str:
    """Return the counts of a recording so far, and what its board or disk is waited for."""
    time = "" if at.sample is None else f" at {at.sample.time:.1f} s"
    return f"{at.frames} frames{time}, {at.lost} lost{at.state and f'; {at.state}'}"


def _list_ports() -> None:
    """Print the serial ports, likely ones first."""
    from lampest.apps.board.port import ARDUINO_VENDORS, ports

    available = ports()
    for device in available:
        remark = "  (looks like an Arduino)" if device.vid in ARDUINO_VENDORS else ""
        screen.say(f"{device.device}  {device.description or ''}{remark}")
    if not available:
        screen.say("there is no serial port", to=sys.stderr)


def report_recorded(done: "Recorded") -> None:
    """Print a summary of a recording and warnings about it.

    Raises typer.Exit with code 130 for an interrupted recording.
    """
    noise = "" if done.noise_lsb is None else f", noise of one reading {done.noise_lsb:.2f} LSB"
    screen.say(
        f"{done.frames} frames, {done.lost} lost, "
        f"{done.restarts} restarts of the board{noise}: {done.path}"
    )
    if done.understood:
        screen.say(screen.as_options(f"the board prints: {done.understood}"))
    for sentence in done.warnings():
        screen.warn(sentence)
    if done.ended_by:
        raise typer.Exit(screen.INTERRUPTED)


def repaired_sentence(file: Path) -> str:
    """Repair a recording and return the outcome in words. Raises InputError if it cannot be."""
    from lampest.apps.board.journal import repair

    frames, dropped = repair(file)
    damage = f"; {dropped} damaged frames are dropped and count as lost" if dropped else ""
    if dropped == 1:
        damage = "; 1 damaged frame is dropped and counts as lost"
    return f"{frames} frames: {file}{damage}"
