"""Lines that flood or lie, long, noisy and killed recordings of a board, guests of its page, a broker that pauses."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count as from_zero
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from attack.attack import HELD, HOUSE, Outcomes, Rng, attack, command
from wild_board import Script, WildBoard, hundred_a_second, wild_board, wire

from lampest import InputError, Recording
from lampest.recording.board import port, stream
from lampest.recording.board.protocol import Hello, message
from lampest.recording.board.record import record, repair
from lampest.report.live.publish import publish_at
from tests.bodies import hello_body

pytestmark = pytest.mark.slow
DAY_FRAMES = 864_000  # of 24 h at 10 frames a second
PART = 1_000  # frames of a day's part
MORE_MEGABYTES, FRAME_BYTES = 8.0, 250  # by which a recording five times as long may grow; of a frame of 3 × 4 cells
LIMIT_S, SLACK_S = 0.5, 15.0  # how long nothing may fit here, and what the rest may take on a loaded machine
MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")


Said = Callable[[Hello, int], bytes]


def _sayings(rng: Rng) -> tuple[Said, ...]:
    """What a line may say in place of frame `number`."""
    return (
        lambda hello, number: wire(hello, number),
        lambda hello, number: wire(hello, number, shape=(int(rng.integers(1, 17)), int(rng.integers(1, 17)))),
        lambda hello, number: rng.bytes(int(rng.integers(1, 600))),
        lambda hello, number: bytes(int(rng.integers(1, 600))),
        lambda hello, number: wire(hello, int(rng.integers(0, number + 1))),
        lambda hello, number: wire(hello, number + 2**32 - 9),
        lambda hello, number: wire(hello, int(rng.integers(0, 2**32)), device_ms=int(rng.integers(0, 2**32))),
        lambda hello, number: wire(hello, number)[: int(rng.integers(1, 40))],
        lambda hello, number: message(hello_body(hello)),
    )


def _script(rng: Rng) -> Script:
    """Some of the sayings, in any mixture, at any rate up to as fast as the line takes them."""
    sayings = _sayings(rng)
    weights = rng.dirichlet(np.full(len(sayings), 0.3))
    pause = float(rng.choice([0.0, 0.001, 0.01]))

    def script(hello: Hello) -> Iterator[tuple[float, bytes]]:
        for number in from_zero():
            yield pause, sayings[rng.choice(len(sayings), p=weights)](hello, number)

    return script


@attack(3, 100)
def test_a_line_that_floods_or_lies_ends_in_time_with_counted_losses(rng: Rng, folder: Path, count: int) -> Outcomes:
    """A line of random sayings: recording ends in time, with a sentence or with frames whose losses are counted."""
    for number in range(count):
        out = folder / f"{number}.h5"
        wanted = {"frames": 30} if rng.random() < 0.5 else {"seconds": 0.5}
        with mock.patch.object(stream, "UNFIT_SECONDS", LIMIT_S), wild_board(_script(rng)) as board:
            yield _ended(board.port, out, wanted)


def _ended(port: str, out: Path, wanted: dict[str, float]) -> str:
    began, said = time.monotonic(), ""
    try:
        done = record(port, out, period=0.01, **wanted)
        # A frame whose number and clock lie alike may be believed as far as ten seconds ahead.
        if done.lost > 1200 * (done.restarts + done.frames):
            return f"{done.lost} frames are told to be lost, {done.frames} came"
    except InputError as error:
        said = str(error)
    took = time.monotonic() - began
    if took > LIMIT_S + SLACK_S:
        return f"{wanted} took {took:.0f} s ({said})"
    if out.exists() and not len(Recording.load(out).time):
        return "an empty recording was left"
    return HELD


@attack(1, 20)
def test_noise_on_the_line_and_jumps_of_the_clock_lose_no_frame(rng: Rng, folder: Path, count: int) -> Outcomes:
    """Good frames among bursts of garbage in which answers are lost, and jumps of the clock by up to 10 s."""
    for number in range(count):
        jumps: list[int] = []
        with (
            mock.patch.object(stream, "SILENCE_SECONDS", 0.2),
            mock.patch.object(port, "ANSWER_SECONDS", 0.05),
            wild_board(lambda hello, jumps=jumps: _noisy(rng, board, hello, jumps)) as board,
        ):
            done = record(board.port, folder / f"{number}.h5", frames=150, period=0.01)
        found = Recording.load(folder / f"{number}.h5")
        labels = [label for label in found.acquisition.event_label if label == "clock jump"]
        wrong = done.lost or done.restarts or np.any(np.diff(found.acquisition.sequence) != 1)
        wrong = wrong or len(labels) != sum(at < 150 for at in jumps) or not np.allclose(np.diff(found.time), 0.01)
        yield HELD if not wrong else f"{done.lost} lost, {done.restarts} restarts, {len(labels)} jumps of {jumps}"


def _noisy(rng: Rng, board: WildBoard, hello: Hello, jumps: list[int]) -> Iterator[tuple[float, bytes]]:
    ahead = 60_000
    for number in from_zero():
        chance = rng.random()
        if number > 5 and chance < 0.01:
            board.deaf = True
            yield from ((0.005, rng.bytes(int(rng.integers(1, 200)))) for _ in range(int(rng.integers(1, 150))))
            board.deaf = False
        elif number > 5 and chance < 0.03 and (not jumps or number > jumps[-1]):
            ahead += int(rng.choice((-1, 1))) * int(rng.integers(1_000, 10_000))
            jumps.append(number)
        yield 0.005, wire(hello, number, ahead + 10 * number)


@attack(1, 100)
def test_a_recorder_killed_at_any_moment_leaves_every_counted_frame(rng: Rng, folder: Path, count: int) -> Outcomes:
    """SIGKILL to a recorder at any moment: every frame that it counted is read, in order, before and after repair."""
    for number in range(count):
        yield _killed(rng, folder / f"{number}.h5")


def _killed(rng: Rng, out: Path) -> str:
    script = (
        "import sys; from pathlib import Path; from lampest.recording.board.record import record\n"
        "tell = lambda now: print(now.frames, flush=True)\n"
        "record(sys.argv[1], Path(sys.argv[2]), period=0.01, baseline=3, on_progress=tell)"
    )
    with wild_board(hundred_a_second) as board, _running("-c", script, board.port, out) as process:
        told = int(process.stdout.readline())
        time.sleep(float(rng.uniform(0, 1)))
        process.kill()
        told = max([told, *(int(line) for line in process.stdout.read().splitlines()[:-1])])
    left = Recording.load(out)
    frames = len(left.time)
    if frames < told:
        return f"{told} frames were counted, {frames} are left"
    if repair(out) != (frames, 0) or repair(out) != (frames, 0):
        return f"repair lost some of {frames} frames"
    found = Recording.load(out)
    same = found.recorded.tobytes() == left.recorded.tobytes() and np.all(np.diff(found.time) > 0)
    closed = found.role[:4].tolist() == [0, 0, 0, 1][:frames] and (frames < 4 or found.sigma is not None)
    return HELD if same and closed else "repair changed the frames, or did not say which are unloaded"


@contextmanager
def _running(*words: object) -> Iterator["subprocess.Popen[str]"]:
    """A Python process, which is killed at the end."""
    environment = os.environ | {"PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, *map(str, words)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@attack(0, 8)
def test_a_day_of_frames_at_10_a_second_is_recorded_in_constant_memory(rng: Rng, folder: Path, count: int) -> Outcomes:
    """Parts of a day at 10 frames a second, over the wrap of the board's clock, as fast as the line takes them."""
    sizes = {}
    for frames in (PART, (count + 1) * PART):
        out = folder / f"{frames}.h5"
        with wild_board(_hurried) as board:
            words = ("record", "--port", board.port, "--period", "0.1", "--count", str(frames), "--out", out.name)
            ended = command(*words, folder=folder, seconds=600)
        if ended.code:
            yield ended.said(f"{frames} frames")
            return
        sizes[frames] = ended.peak / 1e6, out.stat().st_size / frames
    found = Recording.load(out)
    (before, _), (after, each) = sizes.values()
    yield HELD if after < before + MORE_MEGABYTES * max(1, count / 4) else f"{before:.0f} MB, then {after:.0f} MB"
    yield HELD if each < FRAME_BYTES else f"{each:.0f} bytes a frame: {each * DAY_FRAMES / 1e6:.0f} MB a day"
    right = np.allclose(found.time, 0.1 * np.arange(len(found.time)), atol=1e-3) and not found.acquisition.lost.any()
    yield HELD if right and not found.acquisition.session.any() else f"time ends at {found.time[-1]:.3f} s"


def _hurried(hello: Hello) -> Iterator[tuple[float, bytes]]:
    for number in from_zero():
        yield 0.0, wire(hello, number, 2**32 - 50_000 + 100 * number)


@attack(1, 10)
def test_a_broker_that_pauses_receives_no_late_messages(rng: Rng, folder: Path, count: int) -> Outcomes:
    """A broker pauses for one to three seconds: what was sent meanwhile is lost, but for the first 0.2 s."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion
    from units.test_stalled_listeners import message as frame

    if MOSQUITTO is None:
        return
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        where = int(place.getsockname()[1])
    (folder / "conf").write_text(f"listener {where} 127.0.0.1\nallow_anonymous true\n")
    ages: list[float] = []
    ear = Client(CallbackAPIVersion.VERSION2)
    ear.on_message = lambda _, __, heard: ages.append(time.time() - json.loads(heard.payload)["health"]["sent"])
    with subprocess.Popen([MOSQUITTO, "-c", folder / "conf"], stderr=subprocess.DEVNULL) as broker:
        ear.connect_async("127.0.0.1", where)
        while not _reached(ear):
            time.sleep(0.05)
        ear.subscribe("panel")
        ear.loop_start()
        with publish_at(f"mqtt://127.0.0.1:{where}/panel").opened(lambda sentence: None) as (_, send):
            for _ in range(count):
                ages.clear()
                paused, begin = float(rng.uniform(1, 3)), time.monotonic()
                broker.send_signal(signal.SIGSTOP)
                while time.monotonic() < begin + paused + 1:
                    if time.monotonic() > begin + paused:
                        broker.send_signal(signal.SIGCONT)
                    send(frame(1, 2))
                    time.sleep(0.03)
                late = sum(age > 0.5 for age in ages)
                yield HELD if late < 15 and len(ages) > 15 else f"{late} of {len(ages)} messages came late"
        ear.disconnect()
        ear.loop_stop()
        broker.terminate()


def _reached(client: Any) -> bool:
    with suppress(OSError):
        return bool(client.reconnect() == 0)
    return False
