"""How late a published message is: from the last byte of a frame to a listener in another process.

python -m docs.studies.publish        # every way, 600 frames of 10 × 10 at 30 a second
python -m docs.studies.publish --kind mqtt --frames 300 --broker 127.0.0.1:1883

Frames come from a recording, at 30 a second and against the clock, as a board's would; a frame
counts as arrived when the source hands it over. mqtt needs a broker. Prints median, 99th percentile
and largest latency in ms, how many of the frames came through, and of ways with JSON how much of it
was the solve. --estimator is one of `lampest live`.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np

from lampest.apps.live.run import Outlets, Replay, chosen, live
from lampest.recording.recording import MEASURED, Recording

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
RATE = 30.0
WARM = 60  # frames until everything is loaded
PORTS = {"osc": 19000, "websocket": 18138}


def addresses(broker: str) -> dict[str, str]:
    """Kind → where it is published."""
    return {
        "lsl": "lsl://lampest-study",
        "osc": f"osc://127.0.0.1:{PORTS['osc']}",
        "mqtt": f"mqtt://{broker}/lampest-study",
        "websocket": f"websocket://127.0.0.1:{PORTS['websocket']}",
    }


def long_recording(path: Path, frames: int) -> None:
    """Return the lamprey forth and back, 30 frames a second; a step is the motion of a second."""
    lamprey = Recording.load(LAMPREY)
    first = int(np.flatnonzero(lamprey.role == MEASURED)[0])
    course = np.arange(first, len(lamprey.recorded))
    course = np.concatenate([course, course[-2:0:-1]])
    taken = np.concatenate([np.arange(first), course[np.arange(frames) % len(course)]])
    sigma = (
        lamprey.sigma if lamprey.sigma is None or lamprey.sigma.ndim == 2 else lamprey.sigma[taken]
    )
    replace(
        lamprey,
        recorded=lamprey.recorded[taken],
        time=np.arange(len(taken)) / RATE,
        role=lamprey.role[taken],
        sigma=sigma,
        truth_cell_resistance=None,
        truth_pressure=None,
        raw_sums=None,
        raw_readings=None,
    ).save(path)


def heard(kind: str, where: str, seconds: float) -> None:
    """Listen in a process of its own, and print (sequence, latency in s, solve in s) as JSON."""
    came: list[tuple[int, float, float]] = []

    def on_text(text: str | bytes) -> None:
        now = time.time()
        stated = json.loads(text)
        came.append(
            (
                stated["sequence"],
                now - stated["health"]["arrived"],
                stated["health"]["solve_seconds"],
            )
        )

    until = time.monotonic() + seconds
    address, _, topic = where.partition("://")[2].partition("/")
    host, _, port = address.partition(":")
    if kind == "mqtt":
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        client = Client(CallbackAPIVersion.VERSION2)
        client.on_message = lambda _, __, message: on_text(message.payload)
        client.connect(host, int(port))
        client.subscribe(topic)
        client.loop_start()
        time.sleep(seconds)
    elif kind == "websocket":
        from websockets.sync.client import connect

        while time.monotonic() < until:
            try:
                with connect(f"ws://{address}", compression=None) as connection:
                    for text in connection:
                        on_text(text)
                break
            except OSError:
                time.sleep(0.1)
    elif kind == "osc":
        from pythonosc.dispatcher import Dispatcher
        from pythonosc.osc_server import BlockingOSCUDPServer

        # A bundle does not carry when its frame arrived; this clock and the recording's differ by a
        # constant.
        dispatcher = Dispatcher()
        number = [0]
        dispatcher.map("/lampest/sequence", lambda _, value: number.__setitem__(0, value))
        dispatcher.map(
            "/lampest/time",
            lambda _, value: came.append((number[0], time.monotonic() - value, nan)),
        )
        with BlockingOSCUDPServer((host, int(port)), dispatcher) as server:
            server.timeout = 0.2
            while time.monotonic() < until:
                server.handle_request()
        first = min(late for _, late, _ in came)
        came = [(sequence, late - first, solve) for sequence, late, solve in came]
    else:
        import pylsl

        results = pylsl.resolve_byprop("name", "lampest-study", timeout=seconds)
        inlet = pylsl.StreamInlet(results[0])
        while time.monotonic() < until:
            sample, stamp = inlet.pull_sample(timeout=0.2)
            if sample is not None:
                came.append((int(sample[0]), pylsl.local_clock() - stamp, nan))
    print(json.dumps(came))


def heard_by(kind: str, where: str, seconds: float) -> subprocess.Popen[str]:
    """Return a process that runs `heard`."""
    command = ["-m", "docs.studies.publish", "--listen", kind, where, str(seconds)]
    return subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)


def measured(kind: str, where: str, frames: int, estimator: str) -> np.ndarray:
    """(frames, 2) latency and solve in ms of those that came, after the warm ones."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.h5"
        long_recording(path, WARM + frames)
        with heard_by(kind, where, (WARM + frames) / RATE + 12) as listener:
            time.sleep(2)
            live(
                Replay(path),
                chosen(estimator, None),
                Outlets("127.0.0.1:0", publish=(where,)),
                WARM + frames,
            )
            came = json.loads(listener.communicate()[0])
    return 1e3 * np.array([times for sequence, *times in came if sequence > WARM])


def main() -> None:
    """Print a line for every way."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kind", choices=list(addresses("")))
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--broker", default="127.0.0.1:1883")
    parser.add_argument("--estimator", default="smooth")
    parser.add_argument("--listen", nargs=3)
    given = parser.parse_args()
    if given.listen:
        heard(given.listen[0], given.listen[1], float(given.listen[2]))
        return
    for kind, where in addresses(given.broker).items():
        if given.kind in (None, kind):
            late, solves = measured(kind, where, given.frames, given.estimator).T
            median, most = np.percentile(late, [50, 99])
            solve = np.percentile(solves, [50, 99])
            print(
                f"{kind:10} {len(late)}/{given.frames} frames: median {median:.1f} ms, p99 "
                f"{most:.1f} ms, largest "
                f"{late.max():.1f} ms; the solve alone {solve[0]:.1f} and {solve[1]:.1f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
