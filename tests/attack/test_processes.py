"""Limits of processes and threads, and kills: one sentence, and nothing half written."""

import dataclasses
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from attack.attack import (
    PASSED,
    CompletedCommand,
    Outcomes,
    Rng,
    attack,
    called,
    command,
    environment,
    small_folder,
    solvable_recording,
    unless,
)

from lampest import (
    LogGradient,
    Misfit,
    TwoPointReadout,
    reconstruct,
    write_results,
)

LIVE = (
    "live",
    "--recording",
    "small.h5",
    "--speed",
    "1000",
    "--count",
    "1",
    "--http",
    "127.0.0.1:0",
)
RUN = ("run", "run.yaml", "--out", "out", "--jobs")
EXPORT = ("export", "results.h5", "--to", "c", "--estimator")
STRANGER = 54321  # a user without processes
SETPRIV = shutil.which("setpriv")
# The interpreter may stand where strangers cannot read.
READING = "-all,+dac_read_search,+dac_override"
LIMITED = """
import resource
resource.setrlimit(resource.RLIMIT_NPROC, ({limit}, {limit}))
from lampest.cli import main
main()
"""


@pytest.mark.slow
def test_run_needs_no_second_thread_and_live_is_refused_without_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*arguments: object) -> int:
        raise RuntimeError("can't start new thread")

    work_folder = small_folder(tmp_path)
    monkeypatch.setattr(threading, "_start_new_thread", refused)
    assert called(*RUN, "1", folder=work_folder).code == 0
    assert called(*LIVE, folder=work_folder).refused("ulimit -u") == PASSED


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or SETPRIV is None, reason="only root becomes another user")
@attack(6, 40)
def test_a_process_limit_gives_one_sentence(rng: Rng, folder: Path, count: int) -> Outcomes:
    work_folder = small_folder(folder / "work")
    folder.chmod(0o755)
    for path in (work_folder, *work_folder.rglob("*")):
        os.chown(path, STRANGER, STRANGER)
    commands = (LIVE, (*RUN, "2"), (*RUN, "1"))
    for number in range(count):
        words = commands[number % 3]
        completed = _as_stranger(int(rng.integers(1, 6)), *words, folder=work_folder)
        sentence = completed.code == 0 or (completed.code == 2 and completed.err.count("\n") == 1)
        yield unless(
            sentence and completed.plain and completed.seconds < 60, completed.described(words[0])
        )


def _as_stranger(limit: int, *words: str, folder: Path) -> CompletedCommand:
    """Run the command as another user, under a limit of that user's processes and threads."""
    become = [f"--reuid={STRANGER}", f"--regid={STRANGER}", "--clear-groups"]
    become += [f"--inh-caps={READING}", f"--ambient-caps={READING}"]
    script = [sys.executable, "-c", LIMITED.format(limit=limit), *words]
    begin = time.monotonic()
    completed = subprocess.run(
        [str(SETPRIV), *become, *script],
        cwd=folder,
        env=environment(OPENBLAS_NUM_THREADS="1", HOME=str(folder), PYTHONDONTWRITEBYTECODE="1"),
        capture_output=True,
        text=True,
        timeout=120,
    )
    return CompletedCommand(
        completed.returncode, completed.stdout, completed.stderr, time.monotonic() - begin, 0
    )


# Kills itself once so many files have got their names.
KILLED = """
import os, pathlib, signal
replace, left = pathlib.Path.replace, [{count}]
def counted(path, target):
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    left[0] -= 1
    return replace(path, target)
pathlib.Path.replace = counted
from lampest.cli import main
main()
"""


def _solved(folder: Path) -> None:
    """Write results of two estimators, without error bars.

    A sketch is made of them in two seconds.
    """
    recording = solvable_recording(TwoPointReadout(noise_lsb=0.7, readings=20))
    terms = {"LSM": (), "smooth": (LogGradient(weight=1.0),)}
    cases = []
    for name, further in terms.items():
        estimate = reconstruct(
            recording, [Misfit(weighting="noise"), *further], formulation="reduced"
        )
        cases.append(dataclasses.replace(estimate.result(name), sigma_own=None))
    folder.mkdir()
    write_results(folder / "results.h5", cases)


def _content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".part"}


@pytest.mark.slow
@attack(3, 20)
def test_a_killed_export_leaves_a_whole_sketch_folder(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """The sketch goes first and comes last, so that none is built of files of two estimators."""
    work_folder = folder / "work"
    _solved(work_folder)
    sketches = []
    for name in ("LSM", "smooth"):
        assert called(*EXPORT, name, "--out", "sketch", folder=work_folder).code == 0
        sketches.append(_content(work_folder / "sketch"))
    names = len(sketches[1])
    for number in range(count):
        script = KILLED.format(count=int(rng.integers(0, names)))
        words = [
            sys.executable,
            "-c",
            script,
            *EXPORT,
            ("LSM", "smooth")[number % 2],
            "--out",
            "sketch",
        ]
        completed = subprocess.run(
            words, cwd=work_folder, env=environment(), capture_output=True, timeout=60
        )
        content = _content(work_folder / "sketch")
        mixed = "sketch.ino" in content and content not in sketches
        yield (
            f"{completed.returncode}, of two: {sorted(content)}"
            if mixed or completed.returncode != -signal.SIGKILL
            else PASSED
        )
        repeated = called(*EXPORT, "smooth", "--out", "sketch", folder=work_folder)
        remaining = sorted(path.name for path in (work_folder / "sketch").iterdir())
        yield unless(
            remaining == sorted(sketches[1]) and _content(work_folder / "sketch") == sketches[1],
            repeated.described("again"),
        )


VERIFIED = """\
schema: 1
recordings: [small.h5]
formulation: reduced
verify: {frames: all}
estimators:
  LSM: {terms: {misfit: {weighting: noise}}}
  smooth: {terms: {misfit: {weighting: noise}, log_gradient: {weight: 1.0}}}
"""


@pytest.mark.slow
@attack(1, 20)
def test_a_run_killed_during_verification_resumes_to_the_same_results(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    work_folder = small_folder(folder / "work")
    (work_folder / "run.yaml").write_text(VERIFIED)
    begin = time.monotonic()
    whole = command("run", "run.yaml", "--out", "whole", "--jobs", "1", folder=work_folder)
    assert whole.code == 0
    seconds = time.monotonic() - begin
    expected = _verified(work_folder / "whole" / "results.h5")
    draw = random.Random(int(rng.integers(2**32)))
    for number in range(count):
        out = f"out{number}"
        words = ("run", "run.yaml", "--out", out, "--jobs", "1")
        script = [sys.executable, "-c", "from lampest.cli import main; main()", *words]
        for _ in range(2):
            with subprocess.Popen(
                script, cwd=work_folder, env=environment(), stderr=subprocess.PIPE
            ) as process:
                try:
                    process.wait(draw.uniform(0.8, 1.0) * seconds)
                except subprocess.TimeoutExpired:
                    process.kill()
            results = work_folder / out / "results.h5"
            if results.exists():
                yield (
                    PASSED if called("check", results).code == 0 else "what a kill left is damaged"
                )
        completed = command(*words, folder=work_folder)
        equal = completed.code == 0 and _verified(work_folder / out / "results.h5") == expected
        yield PASSED if equal else completed.described("the run that was killed has other results")
        yield PASSED if not [*(work_folder / out).rglob("*.part")] else "unfinished files are left"


def _verified(results: Path) -> list[bytes]:
    from lampest.runs.results import read_results

    cases = read_results(results).cases
    return [array.tobytes() for case in cases for array in (case.cell_resistance, case.verified)]
