"""The command `live`."""

from pathlib import Path
from typing import Annotated

from lampest.apps.board.commands import (
    Baud,
    Frames,
    Lines,
    Period,
    Port,
    SceneFile,
    Unit,
    report_recorded,
)
from lampest.cli import screen
from lampest.files.errors import InputError

Token = Annotated[
    str | None,
    screen.option("Access token of the page; by default one is generated.", envvar="LAMPEST_TOKEN"),
]
Publish = Annotated[
    list[str] | None,
    screen.option(
        "lsl, osc, mqtt or websocket, with an optional address: mqtt://localhost:1883/lampest. "
        "Repeatable.",
        metavar="WHERE",
    ),
]


def live(
    port: Port = None,
    recording: Path | None = None,
    estimator: str | None = None,
    config: Path | None = None,
    assign: screen.Assign = None,
    speed: Annotated[float, screen.option(callback=screen.positive)] = 1.0,
    http: str = "127.0.0.1:8137",
    token: Token = None,
    count: Frames = None,
    baseline: screen.Count = 3,
    scene: SceneFile = None,
    period: Period = None,
    lines: Lines = False,
    baud: Baud = None,
    unit: Unit = None,
    out: screen.Output = None,
    publish: Publish = None,
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
    baseline
        Number of unloaded frames at the beginning, unless the recording marks them.
    out
        Record the board into this file as well.
    """
    from lampest.apps.board.sample import Listening
    from lampest.apps.live.run import Outlets, Replay, chosen
    from lampest.apps.live.run import live as run_live
    from lampest.files.process import ending_signals

    if recording is not None and (port or scene or period or out):
        raise InputError("--recording: --port, --scene, --period and --out are for a board")
    if assign and config is None:
        raise InputError("--set: overrides entries of a run's file; name one with --config")
    source: Listening | Replay
    if recording is not None:
        source = Replay(recording, speed, baseline)
    else:
        agreed = screen.scene_of(scene, None)
        source = Listening(tuple(port or ()), agreed, baseline, period, lines, baud, unit)
    with ending_signals():  # every end of the command sends the board its command to stop
        estimators = chosen(estimator, config, tuple(assign or ()))
        outlets = Outlets(http, token, publish or (), out)
        done = run_live(source, estimators, outlets, count, _say_address, screen.warn, _say_note)
    if done is not None:
        report_recorded(done)


def _say_address(url: str) -> None:
    screen.say(f"{url}  (Ctrl-C ends)" if url.startswith("http") else url)


def _say_note(sentence: str) -> None:
    screen.say(screen.as_options(sentence))
