"""How late frames of a mat that prints numbers are, and what they cost.

python -m docs.studies.printed_mat                    # 16 × 16 cells, 50 frames a second
python -m docs.studies.printed_mat --size 10 --rate 30 --estimator LSM

A board prints a frame a line, `millis,code,code,…`, to a socket, against the clock. `lampest live`
reads it, estimates every frame, and publishes over WebSocket to a listener. The latency is that
from the end of a frame's line to the listener.
"""

import argparse
import json
import resource
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from docs.studies.publish import WARM, heard_by
from lampest import Array, read_scene

BEGIN = 3  # unloaded frames
PORT = 18139
START_SECONDS = 4  # until the panel's first frames are estimated
COMMAND = [sys.executable, "-c", "from lampest.cli import main; main()"]


def codes(folder: Path, frames: int) -> Array:
    """Return codes of a round load that sways, (frames, rows, columns)."""
    scene = read_scene(folder / "scene.yaml")
    rng = np.random.default_rng(1)
    rows, columns = np.indices(scene.panel.shape)
    unloaded = 10e3 * rng.lognormal(0.0, 0.1, scene.panel.shape)
    sway = np.sin(np.arange(frames) / 20)
    middle = np.array(scene.panel.shape) / 2
    distance = np.hypot(rows - middle[0], columns - middle[1] - 2 * sway[:, None, None])
    load = np.exp(-((distance / 2) ** 2)) * (np.arange(frames) >= BEGIN)[:, None, None]
    readings = scene.circuit.exact_reading(unloaded / (1 + 4 * load))
    noise = rng.standard_normal(readings.shape)
    return np.rint(scene.circuit.steps_from_volt(readings) + noise).clip(0, 1023).astype(int)


def printed(frames: Array, rate: float, server: socket.socket) -> None:
    """Send a frame each 1/rate seconds to the first that connects."""
    connection, _ = server.accept()
    begin = time.perf_counter()
    for number, frame in enumerate(frames):
        time.sleep(max(begin + number / rate - time.perf_counter(), 0.0))
        line = ",".join(map(str, [round(1e3 * number / rate), *frame.ravel()]))
        connection.sendall(f"{line}\r\n".encode())
    connection.close()


def main() -> None:
    """Print latency, frames and processor time."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=16)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--estimator", default="smooth")
    given = parser.parse_args()
    begun = WARM + round(START_SECONDS * given.rate)
    with tempfile.TemporaryDirectory() as name, socket.create_server(("127.0.0.1", 0)) as server:
        folder = Path(name)
        size = ["--rows", str(given.size), "--columns", str(given.size)]
        subprocess.run(
            [*COMMAND, "init", *size, "--readout", "pull_downs", "--purpose", "mat", name],
            check=True,
            capture_output=True,
        )
        frames = codes(folder, BEGIN + begun + given.frames)
        board = threading.Thread(target=printed, args=(frames, given.rate, server), daemon=True)
        board.start()
        where = f"websocket://127.0.0.1:{PORT}"
        with heard_by("websocket", where, len(frames) / given.rate + 15) as listener:
            subprocess.run(
                [
                    *[*COMMAND, "live", "--port", f"tcp://127.0.0.1:{server.getsockname()[1]}"],
                    *["--scene", str(folder / "scene.yaml"), "--estimator", given.estimator],
                    *["--baseline", str(BEGIN), "--http", "127.0.0.1:0", "--publish", where],
                    *["--count", str(len(frames) - 2)],  # a board's first line may be cut
                ],
                check=True,
                capture_output=True,
            )
            board.join()
            came = json.loads(listener.communicate()[0])
    late = 1e3 * np.array([each for sequence, each, _ in came if sequence > begun])
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    median, most = np.percentile(late, [50, 99])
    print(
        f"{given.size} x {given.size} cells, {given.rate:g} frames a second, {given.estimator}: "
        f"{len(late)} of {given.frames} frames; latency: median {median:.1f} ms, "
        f"99th percentile {most:.1f} ms, largest {late.max():.1f} ms; "
        f"{spent.ru_utime + spent.ru_stime:.0f} s of a processor for "
        f"{len(frames) / given.rate:.0f} s of frames, start and listener included"
    )


if __name__ == "__main__":
    main()
