"""Attacks as tests, their targets, and the commands that meet them."""

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from fuzz.batches import write_recording
from support import invented_case

from lampest import Panel, Readout, Recording, Scene, write_results

HOUSE = Path(__file__).parents[2]
MAX_SENTENCE = 1_000
PASSED = ""
SEED = int(os.environ.get("ATTACK_SEED", "1"))  # another one chooses other damage

Rng = np.random.Generator
Outcomes = Iterator[str]
Tries = Callable[[Rng, Path, int], Outcomes]


def attack(quick: int = 1, full: int = 1) -> Callable[[Tries], Callable[..., None]]:
    """Make a test of tries (generator, empty folder, count): PASSED or a sentence each.

    quick : count in `make test`; 0: none. full : count under the mark `soak`.
    """
    counts = [
        pytest.param(quick, marks=[] if quick else pytest.mark.soak),
        pytest.param(full, marks=pytest.mark.soak),
    ]

    def made(tries: Tries) -> Callable[..., None]:
        @pytest.mark.parametrize(
            "count", counts[: 2 if full > quick else 1] if quick else counts[1:]
        )
        def test(tmp_path: Path, count: int) -> None:
            outcomes = list(
                tries(np.random.default_rng([SEED, *tries.__name__.encode()]), tmp_path, count)
            )
            fallen = [outcome for outcome in outcomes if outcome != PASSED]
            assert outcomes and not fallen, f"{len(fallen)} of {len(outcomes)} fell: {fallen[:5]}"

        test.__doc__ = tries.__doc__
        return test

    return made


@dataclass(frozen=True)
class CompletedCommand:
    """An ended command: code, output, errors, seconds, most bytes.

    A negative code is a signal that killed it.
    """

    code: int
    out: str
    err: str
    seconds: float
    peak: int

    def refused(self, *words: str) -> str:
        """Return PASSED where it was refused: code 2, one line that holds the words."""
        sentence = (
            self.err.startswith("lampest: ")
            and self.err.count("\n") == 1
            and self.err.endswith("\n")
        )
        if (
            self.code != 2
            or not sentence
            or self.out
            or len(self.err) > MAX_SENTENCE
            or not printable(self.err)
        ):
            return self.described("was not refused in one sentence")
        missing = [word for word in words if word not in self.err]
        return self.described(f"does not say {missing}") if missing else PASSED

    def survived(self) -> str:
        """Return PASSED where it took the input, refused it, or reported that some cases failed."""
        if self.code == 2:
            return self.refused()
        return PASSED if self.code in (0, 3) and self.plain else self.described("ended badly")

    @property
    def plain(self) -> bool:
        """Whether its words do nothing to a terminal and hold no traceback."""
        return printable(self.out) and printable(self.err) and "Traceback" not in self.err

    def within(self, seconds: float, megabytes: float) -> str:
        """Return PASSED where it took no more time and memory than that."""
        if self.seconds <= seconds and self.peak <= megabytes * 1e6:
            return PASSED
        return self.described(f"took {self.seconds:.1f} s and {self.peak / 1e6:.0f} MB")

    def described(self, fault: str) -> str:
        """Return the fault with the command's words."""
        return f"{fault}: code {self.code}, {self.out[-200:]!r} {self.err[-300:]!r}"


def solvable_recording(readout: Readout) -> Recording:
    """Five frames of 3 × 4 random cells without noise, the first two unloaded."""
    scene = Scene(Panel(3, 4), readout)
    cells = np.random.default_rng(1).uniform(900, 2000, (5, 3, 4))
    recorded = scene.circuit.to_recorded(scene.circuit.exact_reading(cells), scene)
    role = np.array([0, 0, 1, 1, 1], dtype=np.uint8)
    return Recording(scene, recorded, np.arange(5.0), role)


def unless(holds: bool, fault: str) -> str:
    """Return PASSED where something holds, and else the fault."""
    return PASSED if holds else fault


def drawn(rng: np.random.Generator, tries: Sequence[Any], count: int) -> Iterator[tuple[int, Any]]:
    """Some of the tries, each with its number."""
    yield from ((int(number), tries[number]) for number in rng.permutation(len(tries))[:count])


def printable(text: str) -> bool:
    """Whether a text does nothing to a terminal."""
    return all(sign.isprintable() or sign in "\n\t" for sign in text)


def called(*arguments: str | Path, folder: Path | None = None) -> CompletedCommand:
    """Call the command within this process, in a folder, without measuring its memory."""
    from lampest import cli

    out = io.StringIO()
    err = io.StringIO()
    begin = time.monotonic()
    code = 0
    with (
        mock.patch.object(sys, "argv", ["lampest", *map(str, arguments)]),
        mock.patch.dict(os.environ),
        contextlib.chdir(folder or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            cli.main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Exception:
            code = 1
            traceback.print_exc()
    return CompletedCommand(code, out.getvalue(), err.getvalue(), time.monotonic() - begin, 0)


def environment(**changes: str) -> dict[str, str]:
    """The environment of a process that runs this source with one thread."""
    return os.environ | {"PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"} | changes


# Writes the peak of resident memory in kB at the end: the system's figure includes memory from
# before exec.
PEAK = """import atexit, pathlib, re, resource
def peak():
    own = int(re.search("VmHWM: *\\t* *([0-9]+)", pathlib.Path("/proc/self/status").read_text())[1])
    there.write_text(str(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)))
there = pathlib.Path(".peak").absolute()
atexit.register(peak)
"""


def command(
    *arguments: str | Path,
    folder: Path,
    seconds: float = 120.0,
    without: str = "",
    memory: str | None = None,
) -> CompletedCommand:
    """Run the command in a process of its own, killed after some seconds.

    without : libraries, apart by commas, that are as if not installed. memory : the variable
        LAMPEST_MEMORY.
    """
    script = (
        PEAK
        + f"import sys; sys.modules.update(dict.fromkeys({[*filter(None, without.split(','))]}))\n"
    )
    script += "from lampest.cli import main; main()"

    variables = environment(**({} if memory is None else {"LAMPEST_MEMORY": memory}))
    options = {
        "stdin": subprocess.DEVNULL,
        "cwd": folder,
        "env": variables,
        "start_new_session": True,
    }
    begin = time.monotonic()
    peak = 0
    with (folder / ".out").open("w+b") as out, (folder / ".err").open("w+b") as err:
        words = [sys.executable, "-c", script, *map(str, arguments)]
        process = subprocess.Popen(words, stdout=out, stderr=err, **options)
        while process.returncode is None:
            number, status, used = os.wait4(process.pid, os.WNOHANG)
            if number:
                process.returncode = os.waitstatus_to_exitcode(status)
                peak = used.ru_maxrss * 1024
            elif time.monotonic() > begin + seconds:
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.01)
    # Else the process was killed, and the peak includes that of this process.
    if (folder / ".peak").exists():
        peak = 1024 * int((folder / ".peak").read_text())
        (folder / ".peak").unlink()
    texts = [(folder / name).read_bytes().decode("utf-8", "replace") for name in (".out", ".err")]
    for name in (".out", ".err"):
        (folder / name).unlink()
    return CompletedCommand(process.returncode, *texts, time.monotonic() - begin, peak)


RUN = (
    "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}, formulation: "
    "reduced}}\n"
)
SIMULATION = (
    "schema: 1\nseed: 1\nframes: 2\nbaseline_frames: 1\nscene:\n"
    "  panel: {rows: 3, columns: 4}\n  readout: {kind: two_point, noise_lsb: 0.7}\n  "
    "series_resistance_ohm: 140\n"
)


def small_folder(folder: Path) -> Path:
    """Make a folder with small.h5, run.yaml, simulation.yaml, table.csv and results.h5."""
    folder.mkdir(parents=True, exist_ok=True)
    write_recording(folder / "small.h5", 2, 1)
    (folder / "run.yaml").write_text(RUN)
    (folder / "simulation.yaml").write_text(SIMULATION)
    np.savetxt(
        folder / "table.csv",
        np.random.default_rng(1).uniform(500, 5000, (6, 4)).round(2),
        delimiter=",",
    )
    write_results(folder / "results.h5", [invented_case("LSM", "small", (2, 5, 6))])
    return folder


def everything(folder: Path) -> dict[str, bytes | str]:
    """Return the content of a folder: path → bytes of a file, or its kind."""
    content: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            content[name] = f"a link to {path.readlink()}"
        else:
            content[name] = path.read_bytes() if path.is_file() else "no regular file"
    return content
