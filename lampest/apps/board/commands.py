"""The command `record`, its options, and the repair of recordings after a crash."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lampest.cli import screen
from lampest.files.errors import InputError, counted

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
    from lampest.apps.board.sample import LineOptions

    if list_:
        _list_ports()
        return
    if out is None:
        raise InputError("--out: name the new recording")
    if count is not None and seconds is not None:
        raise InputError("--count and --seconds: give one of them")
    recorded_scene = screen.scene_of(scene, assign)
    with (
        pressed_keys(listens="-" not in (port or ())) as keys,
        screen.progress("waiting for the board") as show,
    ):
        done = record_board(
            port,
            out,
            frames=count,
            seconds=seconds,
            scene=recorded_scene,
            baseline=baseline,
            period=period,
            on_progress=lambda at: show(at.frames, count, _progress_line(at)),
            keys=keys,
            options=LineOptions(lines, baud, unit),
        )
    report_recorded(done)


def _progress_line(at: "Progress") -> str:
    """Return the counts of a recording so far, and what its board or disk is waited for."""
    time = "" if at.sample is None else f" at {at.sample.time:.1f} s"
    return f"{at.frames} frames{time}, {at.lost} lost{at.state and f'; {at.state}'}"


def _list_ports() -> None:
    """Print the serial ports, likely ones first."""
    from lampest.apps.board.port import ports

    available = ports()
    for device in available:
        remark = "  (looks like an Arduino)" if device.likely else ""
        screen.say(f"{device.url}  {device.description}{remark}")
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
    for sentence in _warnings(done):
        screen.warn(sentence)
    if done.ended_by:
        raise typer.Exit(screen.INTERRUPTED)


def _warnings(done: "Recorded") -> list[str]:
    """Return what went wrong while a recording was made, a sentence each."""
    jumps = "1 jump" if done.clock_jumps == 1 else f"{done.clock_jumps} jumps"
    parted, behind = (
        f"{count} of the {done.frames} frames" for count in (done.parted, done.behind)
    )
    bare = done.scene.circuit.unit == "ohm" and not done.scene.series_resistance_ohm
    sentences = (
        (
            done.damaged,
            f"{done.damaged} of the {done.frames} frames have a reading that the converter cannot "
            "give, as lost bytes make; it is missing, and events mark where",
        ),
        (
            done.cut,
            f"{done.cut} of the {done.frames} frames lack lines; events mark where",
        ),
        (
            done.too_fast,
            "lines came faster than this computer read them; "
            "the lost frames are counted, and events mark where",
        ),
        (
            done.clock_jumps,
            f"{jumps} of the board's clock; events mark where, and time goes on by the period",
        ),
        (
            done.clock_stopped,
            "the board's clock stood still; "
            "an event marks since when, and time goes on by this computer's clock",
        ),
        (
            done.host_clock_set,
            f"this computer's clock was set {counted(done.host_clock_set, 'time')}; "
            "events mark where, and no time of a frame depends on it",
        ),
        (
            done.other_board,
            "another board sends on the same line; its frames are left out, and events mark where",
        ),
        (done.parted, f"{parted} lack a module; events mark which was gone, and when it was back"),
        *(
            (True, f"the board did not estimate {count} of the {done.frames} frames: {reason}")
            for reason, count in done.unestimated
        ),
        (done.silent, f"no frame came in the last {done.silent:.1f} s"),
        (
            bare,
            "no series resistance is assumed, because the scene names none; "
            "two multiplexer channels have some 140 ohm, which lampest calibrate measures",
        ),
        (
            done.ended_by,
            f"{done.ended_by} ended the recording; "
            f"{f'{behind} were' if done.behind else 'no frame was'} still in the port then",
        ),
    )
    return [sentence for holds, sentence in sentences if holds]


def repaired_sentence(file: Path) -> str:
    """Repair a recording and return the outcome in words. Raises InputError if it cannot be."""
    from lampest.apps.board.journal import repair

    frames, dropped = repair(file)
    single = dropped == 1
    damage = (
        f"; {dropped} damaged frame{' is' if single else 's are'} dropped "
        f"and count{'s' if single else ''} as lost"
    )
    return f"{frames} frames: {file}{damage if dropped else ''}"
