"""A batch in which a case breaks down, and ones that would take too long: panels, and frames."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from promises import promise

import lampest
from lampest import Estimator, Panel, Scene, Stream, TwoPointReadout
from lampest.files import process
from lampest.recording.readings import Readings
from lampest.runs import task
from lampest.runs.results import read_results
from lampest.solvers import projected_newton as newton_module
from lampest.solvers.solution import Settings
from tests.estimates import recording_of

Command = Callable[..., SimpleNamespace]
RUN = (
    "{schema: 1, recordings: [r.h5], estimators: {E: {terms: {misfit: {}, gradient: {weight: 1}}}}}"
)
# Rows and columns, memory that may be taken, words of the command, and what the refusal says.
SIZES: tuple[tuple[int, str, tuple[str, ...], tuple[str, ...]], ...] = (
    (400, "", (), ("min and", "--yes")),
    (150, "150MB", (), ("MiB of memory",)),
    (400, "", ("--yes",), ()),
    (100, "", (), ()),
)
SCENE = lampest.Scene(lampest.Panel(4, 5), lampest.TwoPointReadout(noise_lsb=0.7))
FORMULATIONS: dict[Any, tuple[Any, ...]] = {
    "reduced": (lampest.Misfit(), lampest.Gradient(weight=1e-3)),
    "nodal": (lampest.Misfit(), lampest.Gradient(weight=1e-3)),
    "per_pixel": (lampest.Misfit(), lampest.CellResistance(weight=1e-3)),
    "smoother": (lampest.Misfit(weighting="noise", loss=lampest.Student(corner=4)),),
}


@pytest.mark.slow
def test_failed_cases_stop_no_other_and_are_solved_by_the_next_run(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = task.reconstruct
    out = disk.folder / "out"

    def run(failing: Callable[[Estimator], bool]) -> SimpleNamespace:
        def sometimes(recording: Any, estimator: Any, on_frame: Any) -> Any:
            if failing(estimator):
                raise RuntimeError("out of\nluck")
            return solve(recording, estimator, on_frame)

        monkeypatch.setattr(task, "reconstruct", sometimes)
        return lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")

    all_failed = run(lambda estimator: True)
    assert (all_failed.code, (out / "results.h5").exists()) == (3, False)
    assert all_failed.out.strip() == "0 cases solved, 0 were done before, 3 failed: no results"
    plain = run(lambda estimator: len(estimator.terms) == 1)
    assert (plain.code, plain.err) == (3, "lampest: small × LSM failed: out of luck\n")
    assert "2 cases solved, 0 were done before, 1 failed" in plain.out
    assert [case.estimator for case in read_results(out / "results.h5").cases] == [
        "LSR-CR",
        "LSR-dCR",
    ]
    all_solved = run(lambda estimator: False)
    assert (all_solved.code, all_solved.err) == (
        0,
        "",
    ) and "1 case solved, 2 were done before" in all_solved.out
    assert [case.estimator for case in read_results(out / "results.h5").cases] == [
        "LSM",
        "LSR-CR",
        "LSR-dCR",
    ]


@pytest.mark.slow
def test_the_study_of_starts_uses_the_chosen_weights(disk: SimpleNamespace) -> None:
    text = "schema: 1\nrecordings: [small.h5]\nformulation: reduced\nestimators:\n"
    text += "  one: {terms: {misfit: {}, gradient: {weight: auto}}}\n"
    text += "  pair: {terms: {misfit: {}, relative_change: {weight: auto}}}\n"
    words = (disk.run(text, "starts.yaml"), "--random", "2", "--out", disk.folder / "out")
    command = [sys.executable, "-m", "docs.studies.starts", *map(str, words)]
    completed = subprocess.run(
        command, cwd=Path(__file__).parents[2], capture_output=True, text=True
    )
    assert completed.returncode == 0, completed.stderr
    assert "one" in completed.stdout and "pair" in completed.stdout
    header, *rows = (disk.folder / "out" / "starts.csv").read_text().splitlines()
    assert header == "recording,estimator,frames,best,worst_excess,most_minima,random_solved,random"
    assert [row.split(",")[:2] for row in rows] == [["small", "one"], ["small", "pair"]]


def test_a_panel_beyond_time_or_memory_is_refused_before_writing_unless_forced(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run := tmp_path / "run.yaml").write_text(RUN)
    for size, memory, words, messages in SIZES:
        scene = Scene(Panel(size, size), readout=TwoPointReadout(noise_lsb=0.7))
        recording_of(scene, np.full((2, size, size), 1500.0), 1).save(tmp_path / "r.h5")
        monkeypatch.setenv("LAMPEST_MEMORY", memory or "8GB")
        with mock.patch("lampest.runs.batch.run_batch", side_effect=KeyboardInterrupt) as started:
            completed = lampest("run", run, "--out", tmp_path / "out", *words)
        assert started.called == (not messages)
        assert all(message in completed.err for message in messages)
        assert not messages or (completed.code == 2 and not (tmp_path / "out").exists())


def test_available_memory_of_a_control_group_is_its_limit_minus_its_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(process.ALLOWED, raising=False)
    monkeypatch.setattr(process, "Path", lambda folder, name: tmp_path / name)
    for name, size in (("memory.max", "4000000"), ("memory.current", "1000000")):
        (tmp_path / name).write_text(size)
    assert process.memory_limit() == pytest.approx(0.9 * 3e6)


def test_a_call_that_returns_in_time_leaves_no_alarm() -> None:
    original = signal.getsignal(signal.SIGALRM)
    token = process.EXPENDABLE.set(True)
    try:
        with process.ended_where_hung(1.0):
            assert signal.getitimer(signal.ITIMER_REAL)[0] > process.HUNG_SECONDS
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    finally:
        process.EXPENDABLE.reset(token)
        signal.signal(signal.SIGALRM, original)


def recorded(frames: int = 4) -> Any:
    """Ohm as the divider gives it (frames, rows, columns)."""
    rng = np.random.default_rng(5)
    cells = 1000 * np.exp(
        0.3 * rng.standard_normal((1, 4, 5)) + 0.05 * rng.standard_normal((frames, 4, 5))
    )
    readout = SCENE.readout
    return readout.to_recorded(readout.exact_reading(cells), SCENE)


@promise("howto/batches: A frame that takes longer ends with NaN and the status")
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_frame_not_solved_in_time_holds_nan_and_a_status(formulation: Any) -> None:
    estimator = Estimator(
        FORMULATIONS[formulation], formulation, solver=Settings(time_limit_s=1e-9), error_bars=False
    )
    stream = Stream.begin(estimator, SCENE, 0.2, Readings.of(SCENE, recorded()[:1]).mean())
    steps = [stream.push(Readings.of(SCENE, recorded()[1]))[1]]
    # The start of plain least squares, with which the smoother begins, is an optimum already.
    steps += [] if formulation == "smoother" or stream.baseline is None else [stream.baseline]
    for step in steps:
        assert (
            step.status == "the time limit was reached before an optimum"
            and np.isnan(step.cell_resistance).all()
        )


def test_a_hanging_solve_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    original = newton_module.trust_region_step

    def slowly(*arguments: Any) -> Any:
        time.sleep(0.05)
        return original(*arguments)

    monkeypatch.setattr(newton_module, "trust_region_step", slowly)
    estimator = Estimator(
        FORMULATIONS["reduced"], "reduced", solver=Settings(time_limit_s=0.08), error_bars=False
    )
    stream = Stream.begin(estimator, SCENE, 0.2, Readings.of(SCENE, recorded()[:1]).mean())
    assert stream.baseline is not None
    assert stream.baseline.status == "the time limit was reached before an optimum"
    assert 1 <= stream.baseline.solution.iterations <= 2
