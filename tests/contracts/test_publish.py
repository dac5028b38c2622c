"""`lampest live` without a board: the library of each way of `--publish` receives it."""

import gc
import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import until

ROOT = Path(__file__).parents[2]
MAX_KPA = 40.0  # where the response's curve ends
NEWTON_PER_KPA = 0.1  # on a cell of 10 mm × 10 mm
ROUNDED_NEWTON = 0.02  # of a sum of rounded numbers
MAX_AGE_S = 60  # of a sample by the clock of the library
LAMPREY = ROOT / "data" / "lamprey_25mm.h5"
UNLOADED = 3  # of its frames
SCHEMA = json.loads((ROOT / "docs" / "reference" / "stream.schema.json").read_text())
MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
TOKEN = "0123456789abcdef"
Run = Callable[..., SimpleNamespace]
# paho leaves the two sockets by which its threads wake each other to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")
needs_broker = pytest.mark.skipif(
    MOSQUITTO is None, reason="there is no mosquitto here: apt-get install mosquitto"
)


@pytest.fixture(autouse=True)
def _collected() -> Iterator[None]:
    """The garbage goes before the next test."""
    yield
    gc.collect()


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Return a free port of this computer."""
    with socket.socket(socket.AF_INET, kind) as place:
        place.bind(("127.0.0.1", 0))
        return int(place.getsockname()[1])


def listens(port: int) -> bool:
    with socket.socket() as place:
        return place.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def broker(
    folder: Path, port: int, further: str = "allow_anonymous true"
) -> Iterator["subprocess.Popen[bytes]"]:
    """A real broker."""
    (folder / "broker.conf").write_text(f"listener {port} 127.0.0.1\n{further}\n")
    with subprocess.Popen(
        [MOSQUITTO, "-c", folder / "broker.conf"], stderr=subprocess.DEVNULL
    ) as running:
        try:
            until(lambda: listens(port))
            yield running
        finally:
            running.terminate()


@contextmanager
def subscribed(port: int) -> Iterator[list[dict[str, Any]]]:
    """Subscribe to the broker, and return the list of messages."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    messages: list[dict[str, Any]] = []
    heard = threading.Event()
    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = lambda _, __, message: messages.append(json.loads(message.payload))
    client.on_subscribe = lambda *_: heard.set()
    client.connect("127.0.0.1", port)
    client.subscribe("panel/one")
    client.loop_start()
    assert heard.wait(10)
    try:
        yield messages
    finally:
        client.disconnect()
        client.loop_stop()


def replayed(
    lampest: Run, receiver: str, frames: int = 6, speed: float = 10.0, *words: str
) -> SimpleNamespace:
    """A published recording."""
    source = ("--recording", LAMPREY, "--speed", speed, "--count", frames)
    return lampest("live", *source, "--http", "127.0.0.1:0", "--publish", receiver, *words)


@contextmanager
def in_thread(listen: Callable[[], None]) -> Iterator[None]:
    """A listener in a thread, which ends before the block does."""
    thread = threading.Thread(target=listen)
    thread.start()
    yield
    thread.join(60)
    assert not thread.is_alive()


def check_message(message: dict[str, Any]) -> None:
    """One message against the schema, and against itself."""
    from jsonschema import Draft202012Validator

    Draft202012Validator(SCHEMA).validate(message)
    assert len(message["cells"]) == len(message["change"]) == len(message["pressure"]) == 100
    assert message["health"]["solved"] and message["health"]["arrived"] <= message["health"]["sent"]
    pressed = sum(min(kpa, MAX_KPA) for kpa in message["pressure"] if kpa > 0)
    assert 0 < message["force"] <= pressed * NEWTON_PER_KPA + ROUNDED_NEWTON, "kPa on 10 mm × 10 mm"
    assert message["force_saturated"] <= len(message["health"]["saturated"]), (
        "a cell that sucks adds no force"
    )
    assert (message["force_saturated"] > 0) == (max(message["pressure"]) > MAX_KPA), (
        "the response's curve ends at 40 kPa"
    )
    assert message["verdict"].startswith("pressing"), "the rim of a mouth presses"


@pytest.mark.slow
@needs_broker
def test_mqtt_carries_the_message(lampest: Run, tmp_path: Path) -> None:
    port = free_port()
    with broker(tmp_path, port), subscribed(port) as messages:
        completed = replayed(lampest, f"mqtt://127.0.0.1:{port}/panel/one")
        assert completed.code == 0 and f"mqtt://127.0.0.1:{port}/panel/one\n" in completed.out
        until(lambda: messages and messages[-1]["sequence"] == UNLOADED + 6)
    numbers = [message["sequence"] for message in messages]
    assert numbers == sorted(numbers) and numbers[0] > UNLOADED, "in order, unloaded ones first"
    signs = [
        (
            message["sequence"],
            message["detection"] and message["detection"]["sentence"],
            message["alarm"],
        )
        for message in messages
    ]
    assert len(set(signs)) == len(signs), "again only once the answer or the alarm has changed"
    assert messages[-1]["detection"]["answer"] == "sucks", (
        "the last answer comes after the last frame"
    )
    for message in messages:
        check_message(message)


@pytest.mark.slow
@needs_broker
def test_live_reports_a_lost_broker_and_reconnects(lampest: Run, tmp_path: Path) -> None:
    port = free_port()
    received = list[dict[str, Any]]()
    first = ExitStack()
    first.enter_context(broker(tmp_path, port))

    def renew() -> None:
        time.sleep(3)
        first.close()
        with broker(tmp_path, port), subscribed(port) as messages:
            until(lambda: messages, 40)
            received.extend(messages)

    with in_thread(renew):
        completed = replayed(lampest, f"mqtt://127.0.0.1:{port}/panel/one", frames=20, speed=2.0)
    assert completed.code == 0, completed.err
    assert "the broker is gone" in completed.err and "the broker is back" in completed.err
    assert received and "password" not in completed.err


@pytest.mark.slow
@needs_broker
def test_a_refusing_broker_gives_one_sentence(lampest: Run, tmp_path: Path) -> None:
    port = free_port()
    with broker(tmp_path, port, "allow_anonymous false"):
        completed = replayed(lampest, f"mqtt://mouse:secret@127.0.0.1:{port}/panel/one")
    assert (
        completed.code == 2
        and "the broker refuses (Not authorized)" in completed.err
        and completed.err.count("\n") == 1
    )
    assert "secret" not in completed.err + completed.out


@pytest.mark.slow
def test_websocket_carries_the_message_to_clients_with_the_token(lampest: Run) -> None:
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    port = free_port()
    messages = []

    def listening() -> None:
        until(lambda: listens(port))
        with (
            connect(f"ws://127.0.0.1:{port}/?token={TOKEN}") as connection,
            suppress(ConnectionClosed),
        ):
            while True:
                messages.append(json.loads(connection.recv()))

    with in_thread(listening):
        completed = replayed(lampest, f"websocket://0.0.0.0:{port}", 20, 4.0, "--token", TOKEN)
    assert completed.code == 0 and f"ws://0.0.0.0:{port}/?token={TOKEN}\n" in completed.out
    assert messages[-1]["sequence"] == UNLOADED + 20, "who listens gets the last frame"
    check_message(messages[-1])


@pytest.mark.slow
def test_lsl_outlet_describes_its_stream(lampest: Run) -> None:
    import pylsl

    received: dict[str, Any] = {}

    def listening() -> None:
        (outlet,) = pylsl.resolve_byprop("name", "lampest-test", timeout=20)
        inlet = pylsl.StreamInlet(outlet)
        received["info"] = inlet.info(10)
        received["sample"], stamp = inlet.pull_sample(10)
        received["age"] = pylsl.local_clock() - stamp
        inlet.close_stream()

    with in_thread(listening):
        assert replayed(lampest, "lsl://lampest-test", frames=20, speed=2.0).code == 0
    info = received["info"]
    sample = np.array(received["sample"])
    assert (info.type(), info.channel_count(), info.channel_format()) == (
        "Pressure",
        315,
        pylsl.cf_float32,
    )
    labels = info.get_channel_labels()
    units = info.get_channel_units()
    assert (labels[1], labels[4], units[1], units[4]) == (
        "force",
        "change_0_0",
        "newton",
        "percent",
    )
    cell = info.desc().child("channels").first_child()
    while cell.child_value("label") != "pressure_3_4":
        cell = cell.next_sibling()
    place = cell.child("location")
    assert (float(place.child_value("X")), float(place.child_value("Y"))) == (0.04, 0.03)
    assert (
        sample[3] == 1
        and 0
        < sample[1]
        <= np.clip(sample[104:204], 0, MAX_KPA).sum() * NEWTON_PER_KPA + ROUNDED_NEWTON
    )
    assert 0 <= received["age"] < MAX_AGE_S


@pytest.mark.slow
def test_an_unavailable_port_gives_one_sentence_and_live_ends_after_its_frames(
    lampest: Run,
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        completed = replayed(lampest, f"websocket://127.0.0.1:{taken.getsockname()[1]}")
    assert (
        completed.code == 2
        and "cannot listen at 127.0.0.1" in completed.err
        and completed.err.count("\n") == 1
    )
    completed = lampest("live", "--port", "/nowhere/port", "--http", "127.0.0.1:0")
    assert (
        completed.code == 2
        and "/nowhere/port: cannot be opened" in completed.err
        and completed.err.count("\n") == 1
    )
    completed = replayed(lampest, f"osc://127.0.0.1:{free_port(socket.SOCK_DGRAM)}", 4, 1e6)
    assert completed.code == 0 and completed.out.startswith("http://127.0.0.1:")
