"""What an attack is, what it is directed at, and how a command is met by one."""

import contextlib
import io
import os
import resource
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

from lampest.runs.results import write_results

HOUSE = Path(__file__).parents[2]
MAIN = "from lampest.cli import main; main()"
LONGEST_SENTENCE = 1_000
HELD = ""
SEED = int(os.environ.get("ATTACK_SEED", "1"))  # another one chooses other damage

Rng = np.random.Generator
Outcomes = Iterator[str]
Tries = Callable[[Rng, Path, int], Outcomes]


def attack(quick: int = 1, full: int = 1) -> Callable[[Tries], Callable[..., None]]:
    """Make a test of tries (generator, empty folder, how many), each HELD, or a sentence on what fell.

    quick : how many in `make test`; 0: none. full : how many under the mark `soak`.
    """
    counts = [pytest.param(quick, marks=[] if quick else pytest.mark.soak), pytest.param(full, marks=pytest.mark.soak)]

    def made(tries: Tries) -> Callable[..., None]:
        @pytest.mark.parametrize("count", counts[: 2 if full > quick else 1] if quick else counts[1:])
        def test(tmp_path: Path, count: int) -> None:
            outcomes = list(tries(np.random.default_rng([SEED, *tries.__name__.encode()]), tmp_path, count))
            fallen = [outcome for outcome in outcomes if outcome != HELD]
            assert outcomes and not fallen, f"{len(fallen)} of {len(outcomes)} fell: {fallen[:5]}"

        test.__doc__ = tries.__doc__
        return test

    return made


@dataclass(frozen=True)
class Ended:
    """How a command ended: code (negative: a signal that killed it), what it said, seconds, most bytes."""

    code: int
    out: str
    err: str
    seconds: float
    peak: int

    def refused(self, *words: str) -> str:
        """HELD where it was refused: code 2, one line that holds the words."""
        sentence = self.err.startswith("lampest: ") and self.err.count("\n") == 1 and self.err.endswith("\n")
        if self.code != 2 or not sentence or self.out or len(self.err) > LONGEST_SENTENCE or not printable(self.err):
            return self.said("was not refused in one sentence")
        missing = [word for word in words if word not in self.err]
        return self.said(f"does not say {missing}") if missing else HELD

    def survived(self) -> str:
        """HELD where it ended in order, whether it took the input or refused it, or some of its cases failed."""
        if self.code == 2:
            return self.refused()
        fine = self.code in (0, 3) and "Traceback" not in self.err and printable(self.err) and printable(self.out)
        return HELD if fine else self.said("ended badly")

    def within(self, seconds: float, megabytes: float) -> str:
        """HELD where it took no more time and memory than that."""
        if self.seconds <= seconds and self.peak <= megabytes * 1e6:
            return HELD
        return self.said(f"took {self.seconds:.1f} s and {self.peak / 1e6:.0f} MB")

    def said(self, fault: str) -> str:
        """The fault with what the command said of it."""
        return f"{fault}: code {self.code}, {self.out[-200:]!r} {self.err[-300:]!r}"


def drawn(rng: np.random.Generator, tries: Sequence[Any], count: int) -> Iterator[tuple[int, Any]]:
    """Some of the tries, each with its number."""
    yield from ((int(number), tries[number]) for number in rng.permutation(len(tries))[:count])


def printable(text: str) -> bool:
    """Whether a text does nothing to a terminal."""
    return all(sign.isprintable() or sign in "\n\t" for sign in text)


def called(*arguments: str | Path, folder: Path) -> Ended:
    """The command within this process, whose most bytes say nothing; for what neither hangs nor crashes it."""
    from lampest import cli

    out, err, begin, code = io.StringIO(), io.StringIO(), time.monotonic(), 0
    with (
        mock.patch.object(sys, "argv", ["lampest", *map(str, arguments)]),
        mock.patch.dict(os.environ),
        contextlib.chdir(folder),
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
    return Ended(code, out.getvalue(), err.getvalue(), time.monotonic() - begin, 0)


def command(
    *arguments: str | Path,
    folder: Path,
    seconds: float = 120.0,
    addresses: int | None = None,
    without: str = "",
    script: str = MAIN,
    memory: str | None = None,
) -> Ended:
    """The command in a process of its own, ended after so many seconds, with at most so many bytes of addresses.

    without : libraries, apart by commas, that are as if they were not installed. script : what runs instead.
    memory : the variable LAMPEST_MEMORY.
    """
    blocked = f"import sys; sys.modules.update(dict.fromkeys({[*filter(None, without.split(','))]}))\n"

    def limits() -> None:
        if addresses is not None:
            resource.setrlimit(resource.RLIMIT_AS, (addresses, addresses))

    environment = (
        os.environ
        | {"PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"}
        | ({} if memory is None else {"LAMPEST_MEMORY": memory})
    )
    begin = time.monotonic()
    with (folder / ".out").open("w+b") as out, (folder / ".err").open("w+b") as err:
        process = subprocess.Popen(
            [sys.executable, "-c", blocked + script, *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            cwd=folder,
            env=environment,
            preexec_fn=limits,
            start_new_session=True,
        )
        code, peak = _awaited(process, begin + seconds)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
    for name in (".out", ".err"):
        (folder / name).unlink()
    return Ended(code, *texts, time.monotonic() - begin, peak)


def _awaited(process: "subprocess.Popen[bytes]", deadline: float) -> tuple[int, int]:
    """(code, most bytes in memory) of a process, which is killed at the deadline."""
    while True:
        number, status, used = os.wait4(process.pid, os.WNOHANG)
        if number:
            process.returncode = os.waitstatus_to_exitcode(status)
            return process.returncode, used.ru_maxrss * 1024
        if time.monotonic() > deadline:
            os.killpg(process.pid, signal.SIGKILL)
        time.sleep(0.01)


RUN = "schema: 1\nrecordings: [small.h5]\nestimators: {LSM: {terms: {misfit: {}}, formulation: reduced}}\n"
SIMULATION = (
    "schema: 1\nseed: 1\nframes: 2\nbaseline_frames: 1\nscene:\n"
    "  panel: {rows: 3, columns: 4}\n  readout: {kind: two_point, noise_lsb: 0.7}\n  series_resistance_ohm: 140\n"
)


def small_folder(folder: Path) -> Path:
    """A folder with small.h5, run.yaml, scene.yaml, simulation.yaml, table.csv and results.h5."""
    folder.mkdir(parents=True, exist_ok=True)
    write_recording(folder / "small.h5", 2, 1)
    (folder / "run.yaml").write_text(RUN)
    (folder / "simulation.yaml").write_text(SIMULATION)
    np.savetxt(folder / "table.csv", np.random.default_rng(1).uniform(500, 5000, (6, 4)).round(2), delimiter=",")
    write_results(folder / "results.h5", [invented_case("LSM", "small", (2, 5, 6))])
    return folder


def everything(folder: Path) -> dict[str, bytes | str]:
    """What stands in a folder: path → bytes of a file, or what else it is."""
    found: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"a link to {path.readlink()}"
        else:
            found[name] = path.read_bytes() if path.is_file() else "no regular file"
    return found
