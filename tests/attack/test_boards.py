"""Lines that flood or lie, long and killed recordings of a board, and a broker that pauses."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count as from_zero
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from apps.live.test_stalled_listeners import message as frame
from attack.attack import PASSED, Outcomes, Rng, attack, environment, unless
from contracts.test_publish import MOSQUITTO, broker, free_port
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from wild_board import Script, hundred_a_second, wild_board, wire

from lampest import InputError, Recording
from lampest.apps.board import stream
from lampest.apps.board.journal import repair
from lampest.apps.board.protocol import Hello, message
from lampest.apps.board.record import record
from lampest.apps.board.sample import Listening
from lampest.apps.live.publish import publish_at
from tests.bodies import hello_body

pytestmark = pytest.mark.slow
# without a fitting message; of everything else on a loaded machine
LIMIT_S = 0.5
SLACK_S = 15.0
RECORDER = (
    "import sys; from pathlib import Path; from lampest.apps.board.record import record\n"
    "from lampest.apps.board.sample import Listening\n"
    "tell = lambda now: print(now.frames, flush=True)\n"
    "boards = Listening((sys.argv[1],), baseline=3, period=0.01)\n"
    "record(boards, Path(sys.argv[2]), on_progress=tell)"
)


def _script(rng: Rng) -> Script:
    """Frames, and messages that flood or lie, in any mixture, at any rate up to the line's."""
    weights = rng.dirichlet(np.full(9, 0.3))
    pause = float(rng.choice([0.0, 0.001, 0.01]))

    def script(hello: Hello) -> Iterator[tuple[float, bytes]]:
        for number in from_zero():
            shape = (int(rng.integers(1, 17)), int(rng.integers(1, 17)))
            length = int(rng.integers(1, 600))
            clock = int(rng.integers(2**32))
            messages = (
                wire(hello, number),
                wire(hello, number, shape=shape),
                rng.bytes(length),
                bytes(length),
                wire(hello, int(rng.integers(0, number + 1))),
                wire(hello, number + 2**32 - 9),
                wire(hello, int(rng.integers(2**32)), device_ms=clock),
                wire(hello, number)[: int(rng.integers(1, 40))],
                message(hello_body(hello)),
            )
            yield pause, messages[rng.choice(len(messages), p=weights)]

    return script


@attack(3, 100)
def test_a_flooding_or_lying_line_ends_in_time_with_counted_losses(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """Recording ends in time, with a sentence or with frames whose losses are counted."""
    for number in range(count):
        out = folder / f"{number}.h5"
        begin = time.monotonic()
        lost = False
        limits = {"frames": 30} if rng.random() < 0.5 else {"seconds": 0.5}
        with mock.patch.object(stream, "UNFIT_SECONDS", LIMIT_S), wild_board(_script(rng)) as board:
            try:
                summary = record(Listening((board.port,), period=0.01), out, **limits)
                # A frame whose number and clock lie alike may be believed as far as ten seconds
                # ahead.
                lost = summary.lost > 1200 * (summary.restarts + summary.frames)
            except InputError:
                pass
        late = time.monotonic() - begin > LIMIT_S + SLACK_S
        empty = out.exists() and not len(Recording.load(out).time)
        yield (
            f"{limits}: late {late}, lost {lost}, empty {empty}"
            if late or lost or empty
            else PASSED
        )


@attack(1, 100)
def test_a_killed_recorder_leaves_every_counted_frame(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """Every frame that it counted is read, in order, before and after repair."""
    for number in range(count):
        out = folder / f"{number}.h5"
        with wild_board(hundred_a_second) as board:
            words = [sys.executable, "-c", RECORDER, board.port, str(out)]
            with subprocess.Popen(
                words, env=environment(), stdout=subprocess.PIPE, text=True
            ) as process:
                counted = int(process.stdout.readline())
                time.sleep(float(rng.uniform(0, 1)))
                process.kill()
                counted = max(
                    [counted, *(int(line) for line in process.stdout.read().splitlines()[:-1])]
                )
        killed = Recording.load(out)
        frames = len(killed.time)
        repaired = [repair(out), repair(out)] == [(frames, 0)] * 2
        recording = Recording.load(out)
        unchanged = recording.recorded.tobytes() == killed.recorded.tobytes() and np.all(
            np.diff(recording.time) > 0
        )
        closed = recording.role[:4].tolist() == [0, 0, 0, 1][:frames] and (
            frames < 4 or recording.sigma is not None
        )
        right = frames >= counted and repaired and unchanged and closed
        yield unless(
            right,
            f"{counted} counted, {frames} read, repaired {repaired}, same {unchanged}, closed "
            f"{closed}",
        )


def send_for(seconds: float, send: Callable[[Any], object]) -> None:
    """Send frames."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        send(frame(1, (2, 2)))
        time.sleep(0.03)


@attack(1, 10)
def test_a_paused_broker_receives_no_late_messages(rng: Rng, folder: Path, count: int) -> Outcomes:
    """A broker pauses for one to three seconds."""
    port = free_port()
    ages = list[float]()
    ear = Client(CallbackAPIVersion.VERSION2)
    ear.on_message = lambda _, __, heard: ages.append(
        time.time() - json.loads(heard.payload)["health"]["sent"]
    )
    if MOSQUITTO is None:
        return
    with broker(folder, port) as running:
        ear.connect("127.0.0.1", port)
        ear.subscribe("panel")
        ear.loop_start()
        with publish_at(f"mqtt://127.0.0.1:{port}/panel").opened(print) as (_, send):
            for _ in range(count):
                ages.clear()
                running.send_signal(signal.SIGSTOP)
                try:
                    send_for(float(rng.uniform(1, 3)), send)
                finally:  # a process that is stopped does not end
                    running.send_signal(signal.SIGCONT)
                send_for(1.0, send)
                late = sum(age > 0.5 for age in ages)
                yield unless(
                    late < 15 and len(ages) > 15, f"{late} of {len(ages)} messages came late"
                )
        ear.disconnect()
        ear.loop_stop()
