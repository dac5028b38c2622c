"""Runs from end to end: skipped, resumed, overridden and finished cases."""

import fcntl
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fuzz.batches import Batch, session
from promises import promise
from support import until

from lampest import CaseResult, read_results, read_run, term_types

ROOT = Path(__file__).parents[2]
MAX_KKT = 1e-6  # of a verified optimum
ROUNDING = 1e-9  # relative
CONVERGED = 1e-6  # relative, of cells at the end of a solve
Command = Callable[..., SimpleNamespace]
PROGRESS = r"lampest: (\d+ cases? to solve|\d+ of \d+).*\n"  # lines that a slow machine sees


def cases(folder: Path) -> tuple[CaseResult, ...]:
    return read_results(folder / "results.h5").cases


def test_a_run_writes_its_estimates(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    completed = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    assert (completed.code, completed.err) == (0, "")
    assert "3 cases solved, 0 were done before, 0 failed" in completed.out
    written = cases(out)
    names = ("LSM", "LSR-CR", "LSR-dCR")
    assert [(case.recording, case.estimator) for case in written] == [
        ("small", name) for name in names
    ]
    for case in written:
        assert case.status == ("local optimum verified",) * 2 and not case.joint_start
        assert (
            case.frame.tolist() == case.time.tolist() == [1, 2]
            and case.scene.series_resistance_ohm == 140
        )
        assert np.all(case.solve_time > 0) and np.all(case.kkt_residual < MAX_KKT)
        assert case.objective == pytest.approx(sum(case.costs.values()))
        np.testing.assert_allclose(
            disk.exact(case.cell_resistance), case.reading_model, rtol=ROUNDING
        )
        change = 100 * (case.cell_resistance / case.baseline_resistance - 1)
        np.testing.assert_allclose(case.relative_change, change, rtol=ROUNDING)
        assert case.case_id in {path.stem for path in (out / "cases").iterdir()}
        assert "recording_sha256" in case.case_yaml
    np.testing.assert_allclose(written[0].cell_resistance, written[0].truth, rtol=CONVERGED)
    penalties = ({}, {"cell_resistance"}, {"relative_change"})
    assert [set(case.costs) for case in written] == [{"misfit", *penalty} for penalty in penalties]


def test_a_second_run_solves_nothing_unless_fresh(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    words = ("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1", "--set", "check=none")
    lampest(*words)
    first_times = {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    assert "0 cases solved, 3 were done before" in lampest(*words).out
    assert {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()} == first_times
    assert "3 cases solved, 0 were done before" in lampest(*words, "--fresh").out
    fresh_times = {path: path.stat().st_mtime_ns for path in (out / "cases").iterdir()}
    assert fresh_times.keys() == first_times.keys()
    assert all(fresh_times[path] > first_times[path] for path in first_times)


@pytest.mark.slow
def test_changed_cases_are_solved_again(disk: SimpleNamespace, lampest: Command) -> None:
    """Another weight: one case. Another recording of that name: all."""
    out = disk.folder / "out"
    lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
    path = disk.run(disk.text.replace("weight: 1e-3", "weight: 2e-3"))
    assert (
        "1 case solved, 2 were done before" in lampest("run", path, "--out", out, "--jobs", "1").out
    )
    assert len(cases(out)) == 3
    disk.recording(disk.folder / "small.h5", time=np.array([0.0, 1.0, 5.0]))
    assert (
        "3 cases solved, 0 were done before"
        in lampest("run", path, "--out", out, "--jobs", "1").out
    )
    first, damaged, _ = (out / "cases" / f"{case.case_id}.h5" for case in cases(out))
    for content in (damaged.read_bytes()[:2000], first.read_bytes()):
        damaged.write_bytes(content)
        assert (
            "1 case solved, 2 were done before"
            in lampest("run", path, "--out", out, "--jobs", "1").out
        )


@promise("overview: A failed frame is NaN with a sentence.")
def test_a_failed_frame_holds_nan_and_stops_nothing(
    disk: SimpleNamespace, lampest: Command
) -> None:
    """One iteration is too few: NaN and a sentence, in a finished case."""
    terms = "verify: {frames: none}, terms: {misfit: {}, cell_resistance: {weight: 0.1}}"
    limited = (
        "  penalised: {solver: {max_iterations: 1, starts: 1}, formulation: reduced, "
        f"{terms}}}\n  LSM: {{"
    )
    path = disk.run(disk.text.replace("  LSM: {", limited) + "check: none\n")
    completed = lampest("run", path, "--out", disk.folder / "out", "--jobs", "1")
    assert (completed.code, completed.err) == (0, "")
    failed, *fine = cases(disk.folder / "out")
    assert set(failed.status) == {"the iteration limit was reached before an optimum"}
    assert (
        not np.any(failed.solved)
        and not np.any(failed.open_cell)
        and all(np.all(case.solved) for case in fine)
    )
    for values in (
        failed.cell_resistance,
        failed.relative_change,
        failed.reading_model,
        failed.objective,
    ):
        assert np.all(np.isnan(values))


@pytest.mark.slow
@promise("howto/batches: A second run in the same folder at the same time is refused.")
def test_a_folder_admits_one_run_at_a_time(disk: SimpleNamespace, lampest: Command) -> None:
    out = disk.folder / "out"
    out.mkdir()
    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        busy = lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1")
        assert (busy.code, busy.out, busy.err) == (
            2,
            "",
            f"lampest: {out}: another run is using this folder\n",
        )
        assert [path.name for path in out.iterdir()] == [".lock"]
    assert lampest("run", disk.folder / "run.yaml", "--out", out, "--jobs", "1").code == 0


@pytest.mark.slow
def test_recordings_are_relative_to_the_run_file_and_results_hold_published_figures(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The results are written where the command is called, in results/<name of the file>."""
    figures = (
        "published: {LSM: {all: {time_s: 16.45, error_percent: 1.33}}, LSR-dCR: {initial: "
        "{time_s: 58.63}}}\n"
    )
    (disk.folder / "configs").mkdir()
    (disk.folder / "configs" / "mine.yaml").write_text(
        disk.text.replace("small.h5", "../small.h5") + figures
    )
    monkeypatch.chdir(disk.folder)
    completed = lampest("run", "configs/mine.yaml", "--jobs", "1")
    assert (completed.code, completed.err) == (0, "")
    results = read_results(disk.folder / "results" / "mine" / "results.h5")
    assert len(results.cases) == 3 and results.published["LSM"].all.time_s == 16.45
    given = results.published["LSR-dCR"]
    assert given.initial.time_s == 58.63 and given.following is None


def test_the_schema_equals_the_shipped_one_and_has_every_term(lampest: Command) -> None:
    shipped = (ROOT / "configs" / "lampest.schema.json").read_text(encoding="utf-8")
    assert lampest("show", "schema").out == shipped, (
        "lampest show schema > configs/lampest.schema.json"
    )
    assert all(
        f'"{word}"' in shipped
        for word in (*term_types(), "huber", "per_pixel", "sweep", "published")
    )


@pytest.mark.parametrize("name", ["table1", "all_scenes"])
def test_shipped_runs_are_valid(name: str) -> None:
    path = ROOT / "configs" / f"{name}.yaml"
    run = read_run(path)
    recordings = {case.recording for case in run.cases}
    assert len(run.cases) == 5 * len(recordings)
    assert len(recordings) == {"table1": 2, "all_scenes": 8}[name]
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=lampest.schema.json\n")
    assert re.search(r"^formulation: (nodal$|\{kind: nodal, joint: true\})", text, re.MULTILINE)
    weights = {
        case.name: [(type(term).__name__, term.weight) for term in case.estimator.terms]
        for case in run.cases
    }
    assert weights == {
        "LSM": [("Misfit", 1)],
        "LSR-CR": [("Misfit", 1), ("CellResistance", 1e-3)],
        "LSR-dCR": [("Misfit", 1), ("RelativeChange", 10)],
        "LSR-gCR": [("Misfit", 1), ("Gradient", 1e-3)],
        "LSR-gdCR": [("Misfit", 1), ("GradientOfRelativeChange", 10)],
    }


def interrupted(path: Path, out: Path, pattern: str, count: int) -> tuple[int, str, str]:
    """Return code, output and errors of a run after Ctrl-C in all its processes.

    Ctrl-C comes once `count` files match the pattern.
    """
    run = Batch(path, count).start(out)
    until(lambda: len(list((out / "cases").glob(pattern))) >= count)
    os.killpg(run.pid, signal.SIGINT)
    stdout, stderr = run.communicate(timeout=60)
    until(lambda: not session(run.pid))  # nothing stays running
    return run.returncode, stdout, re.sub(PROGRESS, "", stderr)


def large(disk: SimpleNamespace, frames: int) -> None:
    scene = disk.scene.replace("rows: 3, columns: 4", "rows: 8, columns: 8")
    disk.recording(disk.folder / "small.h5", scene, (frames, 8, 8))


@pytest.mark.slow
@pytest.mark.parametrize(
    "executor",
    [
        "serial",
        *(
            pytest.param(f"{kind}, workers: 2", marks=pytest.mark.slow)
            for kind in ("processes", "dask")
        ),
    ],
)
def test_an_interrupt_keeps_finished_cases(executor: str, disk: SimpleNamespace) -> None:
    large(disk, 9)
    weights = [float(f"{weight:.3g}") for weight in np.geomspace(1e-5, 1e-1, 300)]
    sweep = f"sweep: {{estimators.LSR-CR.terms.cell_resistance.weight: {weights}}}\n"
    out = disk.folder / "out"
    settings = f"formulation: reduced\nexecutor: {{kind: {executor}}}\n"
    path = disk.run(disk.text + sweep + settings)
    assert interrupted(path, out, "[!.]*.h5", 3) == (
        130,
        "",
        "lampest: interrupted; what was finished is kept\n",
    )
    finished = read_results(out / "results.h5").cases
    assert 3 <= len(finished) < 302 and all(case.solved.all() for case in finished)
    assert {path.stem for path in (out / "cases").glob("[!.]*.h5")} >= {
        case.case_id for case in finished
    }


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["serial", "processes, workers: 1"])
def test_an_interrupted_case_keeps_its_finished_frames(
    executor: str, disk: SimpleNamespace
) -> None:
    large(disk, 1502)
    text = (
        disk.text[: disk.text.index("  LSR-CR")]
        + f"formulation: nodal\nexecutor: {{kind: {executor}}}\n"
    )
    out = disk.folder / "out"
    assert interrupted(disk.run(text), out, ".*_unfinished.h5", 1)[0] == 130
    (case,) = read_results(out / "results.h5").cases
    count = int(case.solved.sum())
    assert 0 < count < len(case.solved) and case.solved[:count].all()
    assert (
        np.isnan(case.cell_resistance[count:]).all()
        and np.isfinite(case.cell_resistance[:count]).all()
    )
    assert set(case.status[count:]) == {"the run was broken off before this frame"}
    assert not list((out / "cases").iterdir()), "an unfinished case is solved anew"
