"""A recording of a million frames, run from the disk, killed in the middle and resumed.

The study prints memory, time and results.

Run it with: python -m docs.studies.endless --frames 1000000 --formulation naive --folder
results/endless
"""

import argparse
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil

import lampest
from lampest.recording.recording import Recording
from lampest.recording.stored import PART_READINGS, save_parts
from lampest.runs import task
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import Serial

PERIOD_S = 0.1
UNLOADED = 50
RUN = """
schema: 1
recordings: [long.h5]
formulation: {formulation}
error_bars: {bars}
estimators: {{one: {{terms: {{misfit: {{weighting: noise}}{penalty}}}}}}}
"""


def parts(frames: int) -> Iterator[Recording]:
    """The shipped lamprey of 35 mm, its frames again and again, by parts.

    The frames have noise of their own.
    """
    shipped = lampest.datasets.load("lamprey_35mm")
    scene = shipped.scene
    truth = shipped.truth_cell_resistance
    rng = np.random.default_rng(5)
    assert scene.readout is not None and truth is not None
    exact = np.asarray(scene.readout.to_recorded(scene.readout.exact_reading(truth), scene))
    step = PART_READINGS // scene.panel.crossings
    for begin in range(0, frames, step):
        number = np.arange(begin, min(begin + step, frames))
        values = exact[np.where(number < UNLOADED, 0, 3 + (number // 5) % 21)]
        values = values + np.asarray(scene.readout.sigma(values)) * rng.standard_normal(
            values.shape
        )
        role = (number >= UNLOADED).astype(np.uint8)
        yield Recording(scene, values, PERIOD_S * number, role, name="long", number=number)


def run(config: Path, out: Path) -> None:
    """Run the file in this process, and say after every part how much memory there is."""
    write = task.write_carried
    begin = time.process_time()

    def report_part(path: Path, carried: object) -> None:
        seconds = time.process_time() - begin
        process = psutil.Process()
        size = process.memory_info().rss / 1e6
        files = process.num_fds()
        print(
            f"{path.stem}  {seconds:8.1f} s of the processor  {size:8.2f} MB  {files} files open",
            flush=True,
        )
        write(path, carried)

    task.write_carried = report_part
    run_batch(read_run(config), out, Serial())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"done    {time.process_time() - begin:8.1f} s of the processor, at most {peak:.1f} MB",
        flush=True,
    )


def killed(command: list[str], out: Path, after: int) -> None:
    """Run the command until so many parts are there, then kill it."""
    child = subprocess.Popen(command)
    while child.poll() is None and len(list(out.glob("cases/*.parts/??????.h5"))) < after:
        time.sleep(0.2)
    child.send_signal(signal.SIGKILL)
    print(f"killed after {after} parts: {child.wait()}", flush=True)


def main() -> None:
    """Make the recording, run it, kill it in the middle, resume it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--formulation", default="naive")
    parser.add_argument("--error-bars", action="store_true")
    parser.add_argument("--folder", type=Path, default=Path("results/endless"))
    parser.add_argument("--run", action="store_true", help="The run alone, in this process.")
    stated = parser.parse_args()
    config = stated.folder / "run.yaml"
    out = stated.folder / "out"
    if stated.run:
        run(config, out)
        return
    stated.folder.mkdir(parents=True, exist_ok=True)
    penalty = "" if stated.formulation == "naive" else ", gradient: {weight: auto}"
    bars = str(stated.error_bars).lower()
    config.write_text(RUN.format(formulation=stated.formulation, bars=bars, penalty=penalty))
    save_parts(stated.folder / "long.h5", parts(stated.frames))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{stated.folder / 'long.h5'}: {stated.frames} frames, made with at most {peak:.1f} MB",
        flush=True,
    )
    command = [
        sys.executable,
        "-m",
        "docs.studies.endless",
        "--run",
        "--folder",
        str(stated.folder),
    ]
    killed(command, out, stated.frames * 100 // PART_READINGS // 2)
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
